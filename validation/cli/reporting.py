"""What a program says while it works and when it is done: progress, warnings, tables."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from rich.console import Console
from rich.text import Text

from validation.progress import Progress, Report
from validation.report.table import Grid, least_width, rich_table
from validation.words import abridged, each_line, one_line, visible

LOG_EVERY_S = 5.0
"""Time between two lines of progress where standard error is no terminal [s]."""
LONGEST_LINE = 700
"""Length of a line on standard error: a list of names fits, and whoever gave a longer text knows it."""


@contextlib.contextmanager
def shown(title: str) -> Iterator[Report]:
    """Within, a progress bar on standard error; yield the callback that moves it.

    Where standard error is no terminal, a line every few seconds says the same: how much is done, what, and the time left.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    began = last = time.perf_counter()
    first: float | None = None  # steps that were done before, where work is resumed
    console = Console(stderr=True)
    columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    words = TextColumn("{task.description}", markup=False)
    bar = Bar(words, *columns, console=console, transient=True, disable=not console.is_terminal)

    def show(now: Progress) -> None:
        nonlocal last, first
        first = now.done if first is None else first
        bar.update(task, completed=now.done, total=now.total, description=one_line(f"{title}: {now.text}"))
        clock = time.perf_counter()
        if bar.disable and clock - last > LOG_EVERY_S and now.done > first:
            last = clock
            left = (now.total - now.done) / (now.done - first) * (clock - began)
            say(f"{title}: {now.done:.0f} of {now.total:.0f}, {now.text}; {left:.0f} s left")

    with bar:
        task = bar.add_task(one_line(title), total=None)
        yield show


class _Output(Console):
    """Standard output, which falls silent when its reader leaves: the files are written all the same."""

    def on_broken_pipe(self) -> None:
        """Print nothing more."""
        self.quiet = True


PLAIN_WIDTH = 110
"""Width of what is no terminal; a table that needs more gets it."""


def _has_width(console: Console) -> bool:
    """Return whether somebody says how wide standard output is: a terminal, or the variable COLUMNS."""
    return console.is_terminal or os.environ.get("COLUMNS", "").isdigit()


def report_console() -> Console:
    """Return standard output for tables, wide enough for them where nothing says how wide it is."""
    console = _Output()
    return console if _has_width(console) else _Output(width=PLAIN_WIDTH)


class Reportable(Protocol):
    """A finding that has tables and sentences below them."""

    def grids(self) -> Sequence[Grid]:
        """Return its tables."""

    def notes(self) -> Sequence[str]:
        """Return its sentences."""


def report_result(result: Reportable, written: Iterable[Path] = ()) -> None:
    """Print a result's tables and notes, and the paths of what was written, on standard output."""
    console = report_console()
    given = console.width if _has_width(console) else None
    for grid in result.grids():
        console.width = given or max(PLAIN_WIDTH, least_width(grid))
        console.print(rich_table(grid, console.width))
    console.width = given or PLAIN_WIDTH
    for note in result.notes():
        console.print(Text(each_line(note)))
    if files := ", ".join(map(visible, written)):
        console.print(Text(f"written: {files}"), soft_wrap=True)


def warn(text: str) -> None:
    """Print one line on standard error."""
    say(f"warning: {text}")


def say(text: str) -> None:
    """Print one line on standard error; nothing happens where nobody listens any more."""
    with contextlib.suppress(OSError, ValueError):
        print(abridged(text, LONGEST_LINE), file=sys.stderr, flush=True)
