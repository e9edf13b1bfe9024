"""An answer in one line to what goes wrong while a program is still being loaded; it must itself load next to nothing."""

from __future__ import annotations

import os
import sys
from types import TracebackType

EXIT_FAILED_RUN = 1
"""The work was begun, and cannot be ended."""
EXIT_FAULT = 70
"""The program itself is at fault; BSD calls it EX_SOFTWARE."""

_LEAST_BYTES = 550_000_000
"""Least limit on the address space of a program: with less, a library that is loaded asks for memory again for ever."""
_LEAST_FILES = 20
"""Least limit on open files, which POSIX promises to everybody: with fewer, rerun ends the process when it is loaded."""


def require_resources() -> None:
    """End the program with one line and status 1 where its address space or its open files are limited to too little."""
    try:
        import resource
    except ImportError:  # there are no such limits on Windows
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_BYTES:
        least = f"at least {_LEAST_BYTES / 1e6:.0f} MB are needed"
        _refuse(f"there is not enough memory: a limit of {limit / 1e6:.0f} MB of address space, {least}")
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_FILES:
        _refuse(f"too few files may be open at once: a limit of {limit}, at least {_LEAST_FILES} are needed")


def _refuse(said: str) -> None:
    if sys.stderr is not None:
        print(f"run failed: {said}", file=sys.stderr, flush=True)
    sys.exit(EXIT_FAILED_RUN)


def is_short_of_memory(error: BaseException) -> bool:
    """Return whether memory was short; the system's loader of libraries says so in the words of an `ImportError` alone."""
    words = ("failed to map segment", "cannot allocate memory", "cannot map zero-fill pages")
    return isinstance(error, MemoryError) or (isinstance(error, ImportError) and any(w in str(error).lower() for w in words))


def answer(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say in one line what keeps the program from starting, instead of a traceback; see `sys.excepthook`."""
    if is_short_of_memory(error):
        if sys.stderr is not None:
            print("run failed: there is not enough memory to load the program", file=sys.stderr, flush=True)
        os._exit(EXIT_FAILED_RUN)
    from validation.cli.process import write_report
    from validation.words import one_line

    if sys.stderr is not None:
        said = f"the program cannot be started ({kind.__name__}: {one_line(error)}); {write_report(error)}"
        print(said, file=sys.stderr, flush=True)
    os._exit(EXIT_FAULT)
