"""Controllers, planar models and metrics of the user's own: Python objects, or `FILE.py:NAME`.

The file is a program that the user chose to run: it is loaded and run as it is, and nothing
restricts it. An error in it is said in one line with its file and line.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import re
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from ssmr.control.mission import ControllerInput, Mission
from ssmr.errors import ControllerError, SsmrError
from ssmr.metrics.declared import METRICS, SIGNALS, Metrics
from ssmr.models.law import PlanarLaw
from ssmr.parameters import require_one_of
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, State, Trajectory
from validation.files.reading import read_text
from validation.output import one_line, shorten_text
from validation.plants.table import add_model


def is_user_law(name: str) -> bool:
    """Return whether the name of a controller is a file's, `FILE.py:NAME`."""
    path, colon, _ = name.rpartition(":")
    return name.endswith(".py") or (bool(colon) and path.endswith(".py"))


def _place_of(what: Any, path: Path) -> str:
    """Return file and line of a class or a function of the user's."""
    try:
        return f"{path}:{inspect.getsourcelines(what)[1]}"
    except (OSError, TypeError):
        return str(path)


def _make_guarded(name: str, path: Path, kind: Callable[[Mission], Any], mission: Mission) -> Any:
    """Return the user's controller for a mission, whose errors are one line.

    Args:
        name: the name of the class.
        path: its file.
        kind: the class, or a function that makes the object.
        mission: its task.

    Raises:
        ControllerError: it cannot be made, or has no `command`.
    """
    with _errors_as(path, f"in {name}.__init__"):
        controller = kind(mission)
    method = getattr(controller, "command", None)
    if not callable(method):
        raise ControllerError(f"{_place_of(kind, path)}: {name} has no method command(self, now)")

    def command(now: ControllerInput) -> tuple[float, float]:
        """Return the user's command; a ControllerError says that it is none."""
        with _errors_as(path, f"in {name}.command at t = {now.t:.2f} s"):
            answer = method(now)
        try:
            v, w = map(float, answer)
        except (TypeError, ValueError):
            v = w = math.nan
        if not (math.isfinite(v) and math.isfinite(w)):
            returned = f"command returned {shorten_text(one_line(repr(answer)), 60)}"
            need = "wanted speed [m/s] and yaw rate [rad/s], two finite numbers"
            place = _place_of(method, path)
            raise ControllerError(f"{place}: {returned} at t = {now.t:.2f} s; {need}")
        return v, w

    guarded = SimpleNamespace(command=command)
    if callable(watch := getattr(controller, "observe", None)):

        def observe(now: ControllerInput) -> None:
            with _errors_as(path, f"in {name}.observe at t = {now.seen_at:.2f} s"):
                watch(now)

        guarded.observe = observe
    return guarded


@contextlib.contextmanager
def _errors_as(path: Path, where: str, kind: type[Exception] = ControllerError) -> Iterator[None]:
    """Turn whatever the user's code raises into one line, with the file's line and `where`."""
    try:
        yield
    except (Exception, SystemExit) as error:  # a user's code may raise anything
        raise kind(f"{_describe_fault(path, error)} ({where})") from error


def _describe_fault(path: Path, error: BaseException) -> str:
    """Return file, line and words of an error, at the last line of the user's file before it."""
    line = 1
    for frame, number in traceback.walk_tb(error.__traceback__):
        if frame.f_code.co_filename == str(path):
            line = number
    what = str(error)
    # numba's words
    plain = re.sub(r"\x1b\[[0-9;]*m", "", what)
    match = re.search(rf'([^\n]+)\n\s*File "[^"]*{re.escape(path.name)}", line (\d+)', plain)
    if match:
        return f"{path}:{match[2]}: {shorten_text(match[1].strip(), 160)}"
    if isinstance(error, SyntaxError) and error.filename == str(path):
        line = error.lineno or 1
        what = error.msg
    words = type(error).__name__
    if what:
        words += f": {what}"
    return f"{path}:{line}: {shorten_text(words, 160)}"


def _load_user_object(name: str) -> tuple[Any, Path]:
    """Return the object that `FILE.py:NAME` names, and its file.

    The file is run as a module, with its own folder on the path of imports.

    Raises:
        ValueError: there is no such file or name, or the file cannot be run; one line that names
            file and line.
    """
    text, colon, attribute = name.rpartition(":")
    if not colon or not attribute.isidentifier():
        raise ValueError(
            f"'{name}' names nothing in a file; wanted FILE.py:NAME, such as mine.py:Mine"
        )
    path = Path(text).resolve()
    program = read_text(path)
    module = ModuleType(f"user_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look their module up there
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    try:
        # not imported: Python takes a file edited within a second for the old one
        code = compile(program, str(path), "exec", dont_inherit=True)
        exec(code, vars(module))  # nosec B102 # which the user chose to run
    except (Exception, SystemExit) as error:  # a user's file may raise anything
        del sys.modules[module.__name__]
        raise ValueError(_describe_fault(path, error)) from error
    # what it imports is not its own
    own = [n for n, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__]
    if not hasattr(module, attribute):
        require_one_of(attribute, own, f"{path} has no '{attribute}'")
    return getattr(module, attribute), path


def _file_of(item: Any) -> Path:
    """Return the file of a class or a function that Python code gave, or the name of its module."""
    try:
        return Path(inspect.getsourcefile(item) or item.__module__)
    except TypeError:
        return Path(item.__module__)


def _load_object(given: Any) -> tuple[Any, Path]:
    """Return a user's class or function, itself or by `FILE.py:NAME`, and its file."""
    if isinstance(given, str):
        return _load_user_object(given)
    return given, _file_of(given)


def _show_value(value: object) -> str:
    return shorten_text(one_line(repr(value)), 40)


def load_user_law(given: str | type) -> tuple[str, Callable[[Mission], Any], tuple[str, ...]]:
    """Return the name of the user's class, itself or by `FILE.py:NAME`, and what makes its object.

    Also what its attribute `manoeuvres` says that it can follow, see `ssmr.control.law.Law`.

    Raises:
        ValueError: it is no such class.
    """
    kind, path = _load_object(given)
    if not callable(kind):
        raise ValueError(f"{path}: {given} is {_show_value(kind)}, wanted a class")
    name = kind.__name__
    if isinstance(kind, type) and not callable(getattr(kind, "command", None)):
        raise ValueError(f"{_place_of(kind, path)}: class {name} has no method command(self, now)")
    return name, partial(_make_guarded, name, path, kind), getattr(kind, "manoeuvres", ())


_MODEL_FILES: dict[str, tuple[str, str, str]] = {}
"""Name, text and attribute of the file that each model of the user's own was read from."""


def model_file(model: str) -> tuple[str, str, str] | None:
    """Return name, text and attribute of the file of a user's own model; None for any other."""
    return _MODEL_FILES.get(model)


def add_model_of(file: tuple[str, str, str]) -> None:
    """Make the model of a `model_file` from another process a plant of this one."""
    name, text, attribute = file
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        add_user_model(f"{path}:{attribute}")


def add_user_model(given: PlanarLaw | str | None) -> list[str]:
    """Make the user's planar model, itself or by `FILE.py:NAME`, a plant; return the names added.

    Raises:
        ValueError: an error of `_load_user_object`, it is no `PlanarLaw`, or it cannot be compiled
            and driven.
    """
    if given is None:
        return []
    law = given
    if isinstance(given, PlanarLaw):
        path = Path(given.name)
    else:
        law, path = _load_user_object(given)
    if not isinstance(law, PlanarLaw):
        raise ValueError(f"{path}: {given} is {_show_value(law)}, wanted a PlanarLaw")
    add_model(law)
    if isinstance(given, str):
        attribute = given.rpartition(":")[2]
        _MODEL_FILES[law.name] = path.name, read_text(path), attribute
    with _errors_as(path, f"model {law.name}", ValueError):  # also code that numba cannot compile
        plant = PlanarPlant(PlanarModel(law.parameters(), Vehicle(), Drive()))
        plant.run(Commands(0.05, np.full((2, 2), 0.1)), State(), 0.05)
    return [law.name]


UserMetric = Callable[[Metrics, Sequence[Trajectory], Sequence[Trajectory]], Metrics]
"""Function of metrics, motions and references that adds a metric of the user's: its mean over all
pieces by their samples. It raises an SsmrError where that failed."""


def load_user_metric(given: Callable[[Trajectory, Trajectory], float] | str) -> UserMetric:
    """Return the user's metric: the function itself, or by `FILE.py:NAME`.

    Raises:
        ValueError: an error of `_load_user_object`, it is no function, or its name is that of
            another metric.
    """
    rate, path = _load_object(given)
    if not inspect.isfunction(rate):
        raise ValueError(
            f"{path}: {given} is {_show_value(rate)}, "
            "wanted a function of a motion and its reference"
        )
    name = rate.__name__
    if name in {**METRICS, **SIGNALS}:
        raise ValueError(f"{path}: there is a metric {name} already; take another name")

    def added(
        metrics: Metrics, motions: Sequence[Trajectory], references: Sequence[Trajectory]
    ) -> Metrics:
        with _errors_as(path, f"in {name}", SsmrError):
            pairs = zip(motions, references, strict=True)
            values = [float(rate(motion, reference)) for motion, reference in pairs]
            value = float(np.average(values, weights=[len(r) for r in references]))
        if not math.isfinite(value):
            raise SsmrError(f"{path}: {name} returned {value}, wanted a finite number")
        return Metrics({**metrics, name: value})

    return added
