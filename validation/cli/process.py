"""This process as its surroundings see it: its streams, the signals that end it, and the report on a fault of its own."""

from __future__ import annotations

import codecs
import contextlib
import os
import select
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from types import FrameType
from typing import Any

from validation import store
from validation.words import ascii_text, one_line

ENDING_SIGNALS = ("SIGTERM", "SIGHUP")
"""Signals that end the work as Ctrl-C does, so that what was found is kept; not every system has both."""
_AGAIN_S = 0.05
"""Time after which a signal that was put off comes again [s]."""


def prepare_streams() -> None:
    """Make standard streams take every text: a closed one swallows it, and one that knows only ASCII gets it spelt out."""
    with contextlib.suppress(OSError):
        while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:  # else the next file that is opened would become a stream
            pass
        os.close(spare)
    codecs.register_error("spelt", _spell)
    for name in ("stdout", "stderr"):
        stream: Any = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="spelt")


def _spell(error: UnicodeError) -> tuple[str, int]:
    """Return what to write instead of characters that a stream's encoding lacks; see `codecs.register_error`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return ascii_text(error.object[error.start : error.end]), error.end


def finish_output() -> None:
    """Write out what standard output still holds; that its reader has gone, as `| head` does, is no failure."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        silence_output()


def output_is_read() -> bool:
    """Return whether somebody still reads standard output."""
    try:
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        return not poll.poll(0)
    except (AttributeError, OSError, ValueError):  # no such call on this system, or a stream without a file
        return True


def silence_output() -> None:
    """Lead standard output nowhere, so that Python does not complain when it ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def signals_end_work() -> Iterator[list[int]]:
    """Within, signals raise `KeyboardInterrupt`: Ctrl-C whenever it is pressed, each of `ENDING_SIGNALS` once.

    A signal that was to be ignored, as under nohup, stays so. While numba compiles, a signal is put off: its compiler would
    swallow the interrupt, and the work would go on or break. An interrupt that Python itself swallows, because it met the
    end of an object's life, comes again.

    Yields:
        The list to which the number of each signal is added when it comes.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        if _compiles(frame):
            _send_again(number)
            return
        came.append(number)
        if number != signal.SIGINT:
            for one in set(before) - {signal.SIGINT}:
                signal.signal(one, signal.SIG_IGN)  # the result is being kept now
        raise KeyboardInterrupt

    came: list[int] = []
    before: dict[int, Any] = {}
    hook = sys.unraisablehook
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name) for name in ("SIGINT", *ENDING_SIGNALS) if hasattr(signal, name)):
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = signal.signal(number, interrupt)
        sys.unraisablehook = _again_if_swallowed
    try:
        yield came
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _send_again(number: int) -> None:
    """Let a signal come again in a moment."""
    again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), number))
    again.daemon = True
    again.start()


def _again_if_swallowed(unraisable: Any) -> None:
    """Let an interrupt come again that Python swallows, and report any other error that it does, as it usually does."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _send_again(signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)


def _compiles(frame: FrameType | None) -> bool:
    """Return whether numba is at work in a frame or in one of those that called it."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] in ("numba", "llvmlite"):
            return True
        frame = frame.f_back
    return False


def forget_interrupt() -> None:
    """Let this process leave with the status that it asks for.

    Where an interrupt has passed through code that was made at run time, as numba's is, Python remembers it, and at the end
    of `python -m` kills itself by SIGINT whatever the status. Running any other code makes it forget.
    """
    exec("")  # nosec B102


def write_report(error: BaseException) -> str:
    """Write versions, command and traceback into a file that only this user can read; return a sentence that says where."""
    versions = ", ".join(f"{name} {version}" for name, version in store.versions().items())
    lines = [
        f"command: {' '.join(map(one_line, sys.orig_argv))}",
        f"versions: {versions}",
        f"platform: {sys.platform}",
        "",
        *traceback.format_exception(error),
    ]
    try:
        handle, path = tempfile.mkstemp(prefix="ssmr-report-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write("\n".join(lines))
    except OSError as cause:
        return f"no report could be written ({cause.strerror or cause})"
    return f"{one_line(path)} says where; please send it to the makers"
