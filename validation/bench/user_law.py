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
from typing import Any

from ssmr.control.mission import ControllerInput, Mission
from ssmr.errors import ControllerError
from validation.words import one_line, shortened


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
        made = self.guarded("__init__", lambda: self.kind(mission))
        if not callable(getattr(made, "command", None)):
            raise ControllerError(f"{self.place(self.kind)}: {self.name} has no method command(self, now)")
        return _Guarded(self, made)

    def place(self, what: Any) -> str:
        """Return file and line of a class or a function of the user's."""
        try:
            return f"{self.path}:{inspect.getsourcelines(what)[1]}"
        except (OSError, TypeError):
            return str(self.path)

    def guarded(self, method: str, call: Callable[[], Any], t: float | None = None) -> Any:
        """Return what a call of the user's code returns, at mission time `t` [s].

        Raises:
            ControllerError: it raised something, or wanted to end the program.
        """
        try:
            return call()
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            when = f"{self.name}.{method}" + ("" if t is None else f" at t = {t:.2f} s")
            raise ControllerError(f"{_fault(self.path, error)} (in {when})") from error


class _Guarded:
    """A user's object: it is called, and what it returns is checked."""

    def __init__(self, law: UserLaw, made: Any) -> None:
        self._law, self._made = law, made
        if callable(see := getattr(made, "observe", None)):
            self.observe = lambda now: law.guarded("observe", lambda: see(now), now.seen_at)

    def command(self, now: ControllerInput) -> tuple[float, float]:
        given = self._law.guarded("command", lambda: self._made.command(now), now.t)
        try:
            v, w = map(float, given)
        except (TypeError, ValueError):
            v = w = math.nan
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ControllerError(
                f"{self._law.place(self._made.command)}: command returned {shortened(one_line(repr(given)), 60)} at "
                f"t = {now.t:.2f} s; wanted speed [m/s] and yaw rate [rad/s], two finite numbers"
            )
        return v, w


def _fault(path: Path, error: BaseException) -> str:
    """Return file, line and words of an error: the last line of the user's own file that led to it."""
    lines = [line for frame, line in traceback.walk_tb(error.__traceback__) if frame.f_code.co_filename == str(path)]
    what: object = error
    if isinstance(error, SyntaxError) and error.filename == str(path):
        lines, what = [error.lineno or 1], error.msg
    words = f"{type(error).__name__}: {what}" if str(what) else type(error).__name__
    return f"{path}:{lines[-1] if lines else 1}: {shortened(words, 160)}"


def load_user_law(name: str) -> UserLaw:
    """Return the class that `FILE.py:NAME` names; the file is run as a module, with its own folder on the path of imports.

    Raises:
        ValueError: there is no such file or class, or the file cannot be run; one line that names file and line.
    """
    text, colon, wanted = name.rpartition(":")
    if not colon or not wanted.isidentifier():
        raise ValueError(f"'{name}' names no class; wanted FILE.py:NAME, such as mine.py:Mine")
    path = Path(text).resolve()
    spec = importlib.util.spec_from_file_location(f"user_controller_{path.stem}", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"there is no file '{text}'")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # a user's file may raise anything
        del sys.modules[spec.name]
        raise ValueError(_fault(path, error)) from error
    kind = getattr(module, wanted, None)
    if kind is None:
        own = [n for n, v in vars(module).items() if isinstance(v, type) and v.__module__ == module.__name__]
        raise ValueError(f"{path} has no class '{wanted}'; it has: {', '.join(own) or 'none'}")
    if not callable(kind):
        raise ValueError(f"{path}: {wanted} is {shortened(one_line(repr(kind)), 40)}, wanted a class")
    law = UserLaw(wanted, path, kind)
    if isinstance(kind, type) and not callable(getattr(kind, "command", None)):
        raise ValueError(f"{law.place(kind)}: class {wanted} has no method command(self, now)")
    return law
