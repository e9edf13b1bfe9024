"""Run a program: parse its command line, call it, and leave with an exit status.

tyro reads the command line, and says in its own manner what is wrong with it. Every other failure
is one line on standard error.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import functools
import gc
import inspect
import io
import logging
import os
import signal
import sys
import threading
import traceback
import typing
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import tyro

from ssmr.errors import SsmrError
from validation import output
from validation.cli.config import options_from
from validation.cli.options import REGISTRY, Options
from validation.output import abridge_text, each_line, one_line, shorten_text

_EXIT_FAILED_RUN = 1
"""The work was begun, and cannot be ended."""
EXIT_USER_ERROR = 2
EXIT_FAULT = 70
"""The program itself is at fault; BSD calls it EX_SOFTWARE."""
EXIT_INTERRUPTED = 130
ENDING = tuple(s for s in signal.Signals if s.name in ("SIGINT", "SIGTERM", "SIGHUP"))
"""Signals that end work as Ctrl-C does, as far as the system has them."""
_OURS = ("ssmr", "validation", "benchmarks", "__main__")
"""Packages whose `ValueError` is the user's mistake; another's is a fault of the program."""
_LONGEST_LINE = 700
"""Length of a line on standard error, at most: a list of names fits, and whoever gave a longer text
knows it."""
_STYLE = (
    tyro.conf.DisallowNone,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.OmitArgPrefixes,
    tyro.conf.PositionalMetavarFromFieldName,
)


def run_command(command: Any, program: str, arguments: Sequence[str] | None = None) -> None:
    """Parse a command line, make the call, and leave with the exit status that says how it went.

    Args:
        command: what `parse_command` takes.
        program: how usage texts call the program, such as `python -m validation.compare`.
        arguments: the command line; by default that of this process.
    """
    _prepare_process()
    message = ""
    status = _EXIT_FAILED_RUN
    try:
        parse_command(command, program, arguments)()
        sys.stdout.flush()
        return
    except SsmrError as error:
        message = f"run failed: {error}"
    except BrokenPipeError:  # a reader that has gone, as `| head` does, is no failure
        status = 0
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except MemoryError:
        message = "run failed: there is not enough memory"
    except KeyboardInterrupt:
        # else Python ends by a signal where an interrupt passed through code that numba made
        exec("")  # nosec B102
        message = "interrupted"
        status = EXIT_INTERRUPTED
    except Exception as error:  # noqa: BLE001 - the last resort
        *_, (frame, _) = traceback.walk_tb(error.__traceback__)
        origin = frame.f_globals.get("__name__", "").partition(".")[0]
        if isinstance(error, ValueError) and origin in _OURS:
            message = f"error: {one_line(error)}"
            status = EXIT_USER_ERROR
        elif isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            message = f"error: a path is too long: {shorten_text(error.filename, 40)}"
            status = EXIT_USER_ERROR
        elif isinstance(error, OSError):
            where = f" ({error.filename})" if error.filename else ""
            reason = error.strerror or error
            message = f"run failed: {reason}{where}; what was written before is whole"
        else:
            traceback.print_exc()
            versions = ", ".join(f"{name} {at}" for name, at in output.list_versions().items())
            message = f"{program} has a fault; please send its makers the lines above ({versions})"
            status = EXIT_FAULT
    if message:
        say_line(message)
    sys.exit(status)


def parse_command(
    command: Any, program: str, arguments: Sequence[str] | None = None
) -> Callable[[], Any]:
    """Return the call that a command line asks for; nothing is called yet.

    Args:
        command: a `Program`, a function whose arguments are the options, or these by the name of
            their subcommand.
        program: how usage texts call the program.
        arguments: the command line; by default that of this process.

    Raises:
        SystemExit: it asked for help, or tyro has said what is wrong with it.
    """
    given = sys.argv[1:] if arguments is None else arguments
    given = _place_controller(given, isinstance(command, Mapping))
    wanted = read_as(command, given)
    call = tyro.cli(wanted, prog=program, args=given, config=_STYLE, registry=REGISTRY)
    return call


def _place_controller(given: Sequence[str], at: int) -> Sequence[str]:
    """Return a command line with the class of `--controller FILE.py:NAME` as its word `at`.

    That is the place of CONTROLLER; other values of such an option stay.
    """
    found = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    found.add_argument("--controller", nargs="?")
    known, rest = found.parse_known_args(given)
    own = known.controller or ""
    return [*rest[:at], own, *rest[at:]] if ".py:" in own else given


def read_as(command: Any, given: Sequence[str] = ()) -> Any:
    """Return the type that tyro reads a command line as; its value is the call.

    `command` is what `parse_command` takes, `given` its command line, which may name a run to
    repeat.
    """
    if not isinstance(command, Mapping):
        return _defer_call(command, given)
    choices = []
    for name, each in command.items():
        its = given[1:] if name in given[:1] else ()
        about = "" if isinstance(each, Mapping) else None
        choice = tyro.conf.subcommand(
            name, constructor_factory=functools.partial(read_as, each, its), description=about
        )
        choices.append(Annotated[Any, choice])
    return typing.Union[tuple(choices)]  # noqa: UP007


def _defer_call(command: Any, given: Sequence[str]) -> Callable[..., Any]:
    """Return a function of the same options that returns the call itself.

    Options of the file that --config names are its defaults.
    """
    main = getattr(command, "command", command)
    call = functools.wraps(main)(lambda *its, **named: functools.partial(main, *its, **named))
    found = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    found.add_argument("--config", nargs="?")
    path = found.parse_known_args(given)[0].config
    for name, hint in typing.get_type_hints(main, include_extras=True).items() if path else ():
        kind = next(iter(typing.get_args(hint)), None)
        if inspect.isclass(kind) and issubclass(kind, Options):
            made = options_from(path, main.__name__, kind)
            options = inspect.signature(main).parameters[name].replace(default=made)
            call.__signature__ = inspect.Signature([options])  # type: ignore[attr-defined]
    return call


def say_line(text: str) -> None:
    """Print one line on standard error; nothing happens where nobody listens any more."""
    with contextlib.suppress(OSError, ValueError):
        print(abridge_text(text, _LONGEST_LINE), file=sys.stderr, flush=True)


class _Lines(logging.Handler):
    """Messages of this project as harmless lines on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        say_line(f"{level}{each_line(record.getMessage())}")


def _prepare_process() -> None:
    """Prepare streams, messages and signals of this process.

    Standard streams take every text, messages are lines, and SIGTERM and SIGHUP end work as Ctrl-C
    does.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.basicConfig(handlers=[_Lines()])
    for ours in _OURS:  # of other packages only warnings
        logging.getLogger(ours).setLevel(logging.INFO)
    # imports make many objects that stay, and Python would look through them all the time
    gc.set_threshold(50_000, 20, 100)
    logging.captureWarnings(True)
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            # under nohup one stays ignored
            if signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, signal.default_int_handler)
    warnings.filterwarnings("ignore", "Glyph .* missing from font")  # matplotlib draws a box
