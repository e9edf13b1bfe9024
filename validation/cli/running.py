"""Run a program: parse its command line, call it, and leave with the exit status and the one line that say how it went."""

from __future__ import annotations

import contextlib
import errno
import functools
import gc
import inspect
import io
import itertools
import logging
import os
import re
import signal
import sys
import time
import traceback
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from ssmr.errors import SsmrError
from validation import store
from validation.cli import process
from validation.cli.options import NUMBERS, UserError
from validation.cli.reporting import say, warn
from validation.words import each_line, one_line, shortened

EXIT_FAILED_RUN = 1
"""The work was begun, and cannot be ended."""
EXIT_USER_ERROR = 2
EXIT_FAULT = 70
"""The program itself is at fault; BSD calls it EX_SOFTWARE."""
EXIT_INTERRUPTED = 130
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


@contextlib.contextmanager
def mistakes_are_users() -> Iterator[None]:
    """Within, a `ValueError` that this project raises is the user's mistake; another library's is a fault of the program."""
    try:
        yield
    except UserError:
        raise
    except ValueError as error:
        if not _is_ours(error):
            raise
        raise UserError(one_line(error)) from error
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise UserError(f"a path is too long: {shortened(error.filename, 40)}") from error


def _is_ours(error: BaseException) -> bool:
    """Return whether an error was raised by this project's own code."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return frames[-1].f_globals.get("__name__", "").partition(".")[0] in ("ssmr", "validation", "__main__")


def output_folder(path: Path) -> Path:
    """Make the folder that results go to.

    Raises:
        UserError: it cannot be made or written.
    """
    try:
        return store.make_folder(path)
    except ValueError as error:
        raise UserError(f"--out {error}") from error


def require_writable(folder: Path) -> None:
    """Refuse a folder that could not be made or written, before hours of work.

    Raises:
        UserError: the nearest folder that exists cannot be written.
    """
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise UserError(f"--out {folder}: {nearest} is no folder that can be written; name another")


@contextlib.contextmanager
def writes(option: str, path: Path) -> Iterator[None]:
    """Within, a file that cannot be written is the user's mistake, who named it by this option."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{option} {path}: the file cannot be written ({error.strerror or error})") from error


@contextlib.contextmanager
def search_kept_in(checkpoint: Path) -> Iterator[None]:
    """Within, an interruption says how to go on, if a search wrote its checkpoint there meanwhile."""
    began = time.time() - 0.1  # clocks of file systems are coarse
    try:
        yield
    except KeyboardInterrupt:
        with contextlib.suppress(OSError):
            if checkpoint.stat().st_mtime >= began:
                warn(f"the search is kept in {checkpoint}; the same command with --resume goes on from there")
        raise


def run(
    main: Callable[..., Any] | Mapping[str, Callable[..., Any]], program: str, arguments: Sequence[str] | None = None
) -> None:
    """Parse a command line, call the program, and leave with the exit status that says how it went.

    Args:
        main: a function that takes one dataclass of options, or such functions by the name of their subcommand. The
            function's docstring is the description in the help text.
        program: how usage texts call the program, such as `python -m validation.compare`.
        arguments: the command line; by default that of this process.
    """
    main = getattr(main, "command", lambda: main)()  # of a `Program`
    process.prepare_streams()
    _prepare_log()
    _prepare_warnings()
    gc.set_threshold(50_000, 20, 100)  # imports make many objects that stay, and Python would look through them all the time
    said, status, came = "", 0, list[int]()
    try:
        with process.signals_end_work() as came:
            called, options = _parse(main, program, arguments)
            called(options)
            process.finish_output()
        return
    except UserError as error:
        said, status = f"error: {error}", EXIT_USER_ERROR
    except SsmrError as error:
        said, status = f"run failed: {error}", EXIT_FAILED_RUN
    except OSError as error:
        if isinstance(error, BrokenPipeError) and not process.output_is_read():
            process.silence_output()
            return
        where = f" ({error.filename})" if error.filename else ""
        said, status = f"run failed: {error.strerror or error}{where}; what was written before is whole", EXIT_FAILED_RUN
    except KeyboardInterrupt:
        said, status = _ended_by(came)
    except Exception as error:  # noqa: BLE001 - the last resort: a user shall never see a bare traceback
        said, status = _last_resort(error, program, came)
    if said:
        say(said)
    sys.exit(status)


def _last_resort(error: Exception, program: str, signals: Sequence[int]) -> tuple[str, int]:
    """Return what to say of an error that nobody foresaw, and the exit status."""
    if isinstance(error, MemoryError):
        return "run failed: there is not enough memory", EXIT_FAILED_RUN
    if signals and (isinstance(error, ImportError | SystemError) or not _is_ours(error)):  # so a library says that it came
        return _ended_by(signals)
    return f"{program} has a fault ({type(error).__name__}: {error}); {process.write_report(error)}", EXIT_FAULT


def _ended_by(signals: Sequence[int]) -> tuple[str, int]:
    """Return what to say of signals that ended the work, and the exit status; Ctrl-C where none was noted."""
    process.forget_interrupt()
    number = next((n for n in signals if n != signal.SIGINT), signal.SIGINT)
    return "interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}", 128 + number


class _Harmless(logging.Formatter):
    """Messages as they are, but with what is foreign in them made harmless; rich would pass escape sequences on."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the message of a record, each of its lines harmless."""
        return each_line(super().format(record))


def _prepare_log() -> None:
    """Let log messages of this project go to standard error."""
    from rich.logging import RichHandler

    handler = RichHandler(console=Console(stderr=True), show_path=False, show_time=False)
    handler.setFormatter(_Harmless("%(message)s"))
    logging.basicConfig(handlers=[handler])
    logging.getLogger("validation").setLevel(logging.INFO)  # of other packages only warnings


def _prepare_warnings() -> None:
    """Let each warning of a library be one harmless line on standard error; numba colours its own with escape sequences."""

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: object = None, line: object = None
    ) -> None:
        warn(f"{category.__name__}: {_COLOUR.sub('', str(message))} ({Path(filename).name}, line {lineno})")

    warnings.showwarning = show
    warnings.filterwarnings("ignore", "Glyph .* missing from font")  # matplotlib draws a box


def _parse(main: Any, program: str, arguments: Sequence[str] | None) -> tuple[Callable[[Any], Any], Any]:
    """Return the function to call and the options to call it with.

    Raises:
        UserError: the command line says something that cannot be.
        SystemExit: it asked for help.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    for at in [i for i, pair in enumerate(itertools.pairwise(words)) if pair == ("--view", "web")]:
        words[at : at + 2] = ["--view-web"]
    if isinstance(main, Mapping) and words and not words[0].startswith("-") and words[0] not in main:
        raise UserError(f"there is no '{program} {shortened(words[0], 40)}'; there are: {', '.join(main)}")
    said = io.StringIO()
    read = functools.partial(tyro.cli, prog=program, args=words, config=(tyro.conf.DisallowNone,), registry=NUMBERS)
    try:
        with contextlib.redirect_stderr(said):
            if isinstance(main, Mapping):
                options = read(options_type(main))
                return next(function for function in main.values() if _options_of(function) is type(options)), options
            if (kind := options_type(main)) is not None:
                return main, read(kind, description=inspect.getdoc(main))
            read_only = functools.wraps(main)(lambda *given, **named: functools.partial(main, *given, **named))
            return (lambda ready: ready()), read(read_only)
    except SystemExit as left:
        if left.code:
            raise UserError(_mistake_in(said.getvalue())) from None
        raise


def _mistake_in(box: str) -> str:
    """Return the message in the box that tyro draws around it, in colours on a terminal, in one line."""
    lines = [line.strip("│|+ ") for line in _COLOUR.sub("", box).strip().splitlines()[1:]]
    rule = [set(line) <= {"─", "-"} for line in lines]
    start = rule.index(False) if False in rule else 0
    said = itertools.takewhile(lambda line: not set(line) <= {"─", "-"} or not line, lines[start:])
    text = one_line(" ".join(said))
    return re.sub(r"^Error parsing ([^ :]+):", r"\1:", text) or "the command line cannot be read; see --help"


def options_type(main: Callable[..., Any] | Mapping[str, Callable[..., Any]]) -> Any:
    """Return the type that reads a program's command line: its options, or one of those of its subcommands.

    None where the arguments of `main` are the options themselves.
    """
    if not isinstance(main, Mapping):
        return _options_of(main)
    kinds = [
        Annotated[_options_of(function), tyro.conf.subcommand(name, prefix_name=False, description=inspect.getdoc(function))]
        for name, function in main.items()
    ]
    return typing.Union[tuple(kinds)]  # noqa: UP007 - of a list that is known at run time only


def _options_of(main: Callable[..., Any]) -> Any:
    """Return the dataclass that a program takes; None where its arguments are the options themselves."""
    names = list(inspect.signature(main).parameters) if inspect.isfunction(main) else []
    kind = typing.get_type_hints(main).get(names[0]) if len(names) == 1 else None
    return kind if is_dataclass(kind) else None
