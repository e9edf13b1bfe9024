"""An answer in one line to what goes wrong while a program is still being loaded; it must itself load next to nothing."""

from __future__ import annotations

import os
import sys
from types import TracebackType

EXIT_FAULT = 70
"""The program itself is at fault; BSD calls it EX_SOFTWARE."""

_LEAST_BYTES = 550_000_000
"""Least limit on the address space of a program: with less, a library that is loaded asks for memory again for ever."""


def require_address_space() -> None:
    """End the program with one line and status 1 where its address space is limited to less than it takes to load it."""
    try:
        import resource
    except ImportError:  # there are no such limits on Windows
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_BYTES:
        said = f"a limit of {limit / 1e6:.0f} MB of address space, at least {_LEAST_BYTES / 1e6:.0f} MB are needed"
        print(f"run failed: there is not enough memory: {said}", file=sys.stderr, flush=True)
        sys.exit(1)


def answer(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say in one line what keeps the program from starting, instead of a traceback; see `sys.excepthook`."""
    from validation.cli.process import write_report
    from validation.words import one_line

    if sys.stderr is not None:
        said = f"the program cannot be started ({kind.__name__}: {one_line(error)}); {write_report(error)}"
        print(said, file=sys.stderr, flush=True)
    os._exit(EXIT_FAULT)
