"""A controller of the user's own: a class in a Python file, named `FILE.py:NAME`, that is loaded and run as it is.

The file is a program that the user chose to run: nothing keeps it from doing what any program of theirs can do. What goes
wrong in it is said in one line with its file and line.
"""

from __future__ import annotations

import importlib.util
import inspect
import math
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from ssmr.control.mission import ControllerInput, Mission
from ssmr.errors import ControllerError
from validation.words import one_line, shortened

_MESSAGE = 160


def is_user_law(name: str) -> bool:
    """Return whether the name of a controller is a file's, `FILE.py:NAME`."""
    path, colon, _ = name.rpartition(":")
    return name.endswith(".py") or (bool(colon) and path.endswith(".py"))


@dataclass(frozen=True)
class UserLaw:
    """A user's class, which makes a controller for a mission; it is called like the class itself."""

    name: str
    """The class's name."""
    path: Path
    """Its file."""
    kind: Callable[[Mission], Any]
    """The class, or a function that makes the object."""

    def __call__(self, mission: Mission) -> Any:
        """Return the object for a mission, with its faults said in one line.

        Raises:
            ControllerError: it cannot be made, or has no method `command`.
        """
        made = _guarded(self, "__init__", lambda: self.kind(mission), None)
        return _Guarded(self, made) if not callable(getattr(made, "observe", None)) else _GuardedObserver(self, made)


class _Guarded:
    """A user's object: it is called, and what it returns is checked."""

    def __init__(self, law: UserLaw, made: Any) -> None:
        self._law, self._made = law, made
        if not callable(getattr(made, "command", None)):
            raise ControllerError(f"{_place(law, law.kind)}: {law.name} has no method command(self, now)")

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the object's command.

        Raises:
            ControllerError: it failed, or returned something else than two finite numbers.
        """
        given = _guarded(self._law, "command", lambda: self._made.command(now), now.t)
        try:
            v, w = (float(number) for number in given)
        except (TypeError, ValueError):
            v = w = math.nan
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ControllerError(
                f"{_place(self._law, self._made.command)}: command returned {shortened(one_line(repr(given)), 60)} at "
                f"t = {now.t:.2f} s; wanted speed [m/s] and yaw rate [rad/s], two finite numbers"
            )
        return v, w


class _GuardedObserver(_Guarded):
    """A user's object that wants every observation."""

    def observe(self, now: ControllerInput) -> None:
        """Show the object an observation.

        Raises:
            ControllerError: it failed.
        """
        _guarded(self._law, "observe", lambda: self._made.observe(now), now.seen_at)


def _place(law: UserLaw, what: Any) -> str:
    """Return file and line of a class or a function of the user's."""
    try:
        return f"{law.path}:{inspect.getsourcelines(what)[1]}"
    except (OSError, TypeError):
        return str(law.path)


def _fault(path: Path, error: BaseException) -> str:
    """Return file, line and words of an error: the last line of the user's own file that led to it."""
    lines = [line for frame, line in traceback.walk_tb(error.__traceback__) if frame.f_code.co_filename == str(path)]
    if isinstance(error, SyntaxError) and error.filename == str(path):
        lines = [error.lineno or 1]
        said = f"{type(error).__name__}: {error.msg}"
    else:
        said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{path}:{lines[-1] if lines else 1}: {shortened(one_line(said), _MESSAGE)}"


def _guarded(law: UserLaw, method: str, call: Callable[[], Any], t: float | None) -> Any:
    """Return what a call of the user's code returns; a ControllerError says what it raised, or that it wanted to end."""
    try:
        return call()
    except (Exception, SystemExit) as error:  # a user's code may raise anything
        when = f"{law.name}.{method}" + ("" if t is None else f" at t = {t:.2f} s")
        raise ControllerError(f"{_fault(law.path, error)} (in {when})") from error


def load_user_law(name: str) -> UserLaw:
    """Return the class that `FILE.py:NAME` names; the file is run as a module, with its own folder on the path of imports.

    Raises:
        ValueError: there is no such file or class, or the file cannot be run; one line that names file and line.
    """
    text, colon, wanted = name.rpartition(":")
    if not colon or not wanted.isidentifier():
        raise ValueError(f"'{name}' names no class; wanted FILE.py:NAME, such as mine.py:Mine")
    path = Path(text).resolve()
    if not path.is_file():
        raise ValueError(f"there is no file '{text}'")
    module = _run(path)
    kind = getattr(module, wanted, None)
    if kind is None:
        own = [n for n, v in vars(module).items() if isinstance(v, type) and v.__module__ == module.__name__]
        raise ValueError(f"{path} has no class '{wanted}'; it has: {', '.join(own) or 'none'}")
    if not callable(kind):
        raise ValueError(f"{path}: {wanted} is {shortened(one_line(repr(kind)), 40)}, wanted a class")
    law = UserLaw(wanted, path, kind)
    if isinstance(kind, type) and not callable(getattr(kind, "command", None)):
        raise ValueError(f"{_place(law, kind)}: class {wanted} has no method command(self, now)")
    return law


def _run(path: Path) -> ModuleType:
    """Return a file as a module; a ValueError says that it is no Python, or that running it fails."""
    module_name = f"user_controller_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look their module up there
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # a user's file may raise anything
        del sys.modules[module_name]
        raise ValueError(_fault(path, error)) from error
    return module
