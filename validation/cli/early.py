"""An answer in one line to what goes wrong while a program is still being loaded; it must itself load next to nothing."""

from __future__ import annotations

import os
import sys
from types import TracebackType

EXIT_FAULT = 70
"""The program itself is at fault; BSD calls it EX_SOFTWARE."""


def answer(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say in one line what keeps the program from starting, instead of a traceback; see `sys.excepthook`."""
    from validation.cli.process import write_report
    from validation.words import one_line

    if sys.stderr is not None:
        said = f"the program cannot be started ({kind.__name__}: {one_line(error)}); {write_report(error)}"
        print(said, file=sys.stderr, flush=True)
    os._exit(EXIT_FAULT)
