"""Run a program: parse its command line, call it, and leave with an exit status.

A failure is one line on standard error.
"""

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
import shutil
import signal
import sys
import textwrap
import threading
import traceback
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Annotated, Any

import tyro
from tyro import _docstrings

from ssmr.errors import SsmrError
from validation import store
from validation.cli.options import NUMBERS, UserError
from validation.words import abridged, each_line, one_line, shortened

EXIT_FAILED_RUN = 1
"""The work was begun, and cannot be ended."""
EXIT_USER_ERROR = 2
EXIT_FAULT = 70
"""The program itself is at fault; BSD calls it EX_SOFTWARE."""
EXIT_INTERRUPTED = 130
_COLOUR = re.compile(r"\x1b\[[\d;]*m")
_LONGEST_LINE = 700
"""Length of a line on standard error, at most: a list of names fits, and whoever gave a longer text
knows it."""
_read_docstring = _docstrings.get_field_docstring


def field_text(kind: type, name: str, markers: Any = ()) -> str | None:
    """Return the docstring below a field in one line; tyro leaves the line breaks in it."""
    text = _read_docstring(kind, name, markers)
    return None if text is None else " ".join(text.split())


def run(
    main: Callable[..., Any] | Mapping[str, Callable[..., Any]],
    program: str,
    arguments: Sequence[str] | None = None,
) -> None:
    """Parse a command line, call the program, and leave with the exit status that says how it went.

    Args:
        main: a function that takes one dataclass of options, or such functions by the name of
            their subcommand. The function's docstring is the description in the help text.
        program: how usage texts call the program, such as `python -m validation.compare`.
        arguments: the command line; by default that of this process.
    """
    main = getattr(main, "command", lambda: main)()  # of a `Program`
    _prepare()
    message = ""
    status = 0
    try:
        called, options = _parse(main, program, arguments)
        called(options)
        sys.stdout.flush()
        return
    except UserError as error:
        message = f"error: {error}"
        status = EXIT_USER_ERROR
    except SsmrError as error:
        message = f"run failed: {error}"
        status = EXIT_FAILED_RUN
    except BrokenPipeError:  # a reader that has gone, as `| head` does, is no failure
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        message = f"run failed: {error.strerror or error}{where}; what was written before is whole"
        status = EXIT_FAILED_RUN
    except MemoryError:
        message = "run failed: there is not enough memory"
        status = EXIT_FAILED_RUN
    except KeyboardInterrupt:
        # else Python ends by a signal where an interrupt passed through code that numba made
        exec("")  # nosec B102
        message = "interrupted"
        status = EXIT_INTERRUPTED
    except Exception:  # noqa: BLE001 - the last resort
        traceback.print_exc()
        versions = ", ".join(f"{name} {version}" for name, version in store.versions().items())
        message = f"{program} has a fault; please send its makers the lines above ({versions})"
        status = EXIT_FAULT
    if message:
        say(message)
    sys.exit(status)


def say(text: str) -> None:
    """Print one line on standard error; nothing happens where nobody listens any more."""
    with contextlib.suppress(OSError, ValueError):
        print(abridged(text, _LONGEST_LINE), file=sys.stderr, flush=True)


@contextlib.contextmanager
def mistakes_are_users() -> Iterator[None]:
    """Within, a `ValueError` that this project raises is the user's mistake.

    Another library's is a fault of the program.
    """
    try:
        yield
    except UserError:
        raise
    except ValueError as error:
        *_, (frame, _) = traceback.walk_tb(error.__traceback__)
        module = frame.f_globals.get("__name__", "")
        if module.partition(".")[0] not in ("ssmr", "validation", "__main__"):
            raise
        raise UserError(one_line(error)) from error
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise UserError(f"a path is too long: {shortened(error.filename, 40)}") from error


class _Lines(logging.Handler):
    """Messages of this project as harmless lines on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        say(f"{level}{each_line(record.getMessage())}")


def _prepare() -> None:
    """Prepare streams, messages and signals of this process.

    Standard streams take every text, messages are lines, and SIGTERM and SIGHUP end work as Ctrl-C
    does.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.basicConfig(handlers=[_Lines()])
    logging.getLogger("validation").setLevel(logging.INFO)  # of other packages only warnings
    # imports make many objects that stay, and Python would look through them all the time
    gc.set_threshold(50_000, 20, 100)
    logging.captureWarnings(True)
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            # under nohup one stays ignored
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, signal.default_int_handler)
    # it has the same arguments
    _docstrings.get_field_docstring = field_text  # type: ignore[assignment]
    warnings.filterwarnings("ignore", "Glyph .* missing from font")  # matplotlib draws a box


def _parse(
    main: Any, program: str, arguments: Sequence[str] | None
) -> tuple[Callable[[Any], Any], Any]:
    """Return the function to call and the options to call it with.

    Raises:
        UserError: the command line cannot be read.
        SystemExit: it asked for help.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if isinstance(main, Mapping) and words:
        first = words[0]
        if not first.startswith("-") and first not in main:
            raise UserError(
                f"there is no '{program} {shortened(first, 40)}'; there are: {', '.join(main)}"
            )
    errors = io.StringIO()
    shown = io.StringIO()
    read = functools.partial(
        tyro.cli, prog=program, args=words, config=(tyro.conf.DisallowNone,), registry=NUMBERS
    )
    try:
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(shown):
            if isinstance(main, Mapping):
                options = read(options_type(main))
                functions = {_options_of(function): function for function in main.values()}
                return functions[type(options)], options
            if (kind := options_type(main)) is not None:
                return main, read(kind, description=inspect.getdoc(main))
            read_only = functools.wraps(main)(
                lambda *given, **named: functools.partial(main, *given, **named)
            )
            return (lambda ready: ready()), read(read_only)
    except SystemExit as left:
        if left.code:
            raise UserError(_mistake_in(errors.getvalue())) from None
        print("\n".join(map(_folded, shown.getvalue().splitlines())))
        raise


def _folded(line: str) -> str:
    """Return a line of the help text in lines that fit the terminal.

    Tyro folds the texts of options so, and not descriptions.
    """
    indent = "    " if line.startswith("usage: ") else ""
    width = shutil.get_terminal_size().columns
    return textwrap.fill(
        line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _mistake_in(box: str) -> str:
    """Return in one line the message in the box that tyro draws, in colours on a terminal."""
    lines = [line.strip("│|+ ") for line in _COLOUR.sub("", box).strip().splitlines()[1:]]
    rule = [set(line) <= {"─", "-"} for line in lines]
    start = rule.index(False) if False in rule else 0
    message = itertools.takewhile(
        lambda line: not set(line) <= {"─", "-"} or not line, lines[start:]
    )
    text = one_line(" ".join(message))
    text = re.sub(r"^Error parsing ([^ :]+):", r"\1:", text)
    return text or "the command line cannot be read; see --help"


def options_type(main: Callable[..., Any] | Mapping[str, Callable[..., Any]]) -> Any:
    """Return the type of a program's command line: its options, or a union of its subcommands'.

    None where the arguments of `main` are the options themselves.
    """
    if not isinstance(main, Mapping):
        return _options_of(main)
    kinds = [
        Annotated[
            _options_of(function),
            tyro.conf.subcommand(name, prefix_name=False, description=inspect.getdoc(function)),
        ]
        for name, function in main.items()
    ]
    return typing.Union[tuple(kinds)]  # noqa: UP007 - of a list


def _options_of(main: Callable[..., Any]) -> Any:
    """Return the dataclass that a program takes; None where its arguments are the options."""
    names = list(inspect.signature(main).parameters) if inspect.isfunction(main) else []
    kind = typing.get_type_hints(main).get(names[0]) if len(names) == 1 else None
    return kind if is_dataclass(kind) else None
