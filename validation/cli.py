"""What every program's command line has in common: exit status, one-line errors, progress on standard error."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.logging import RichHandler
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table

from ssmr.errors import SsmrError
from validation.progress import Progress, Report

EXIT_FAILED_RUN = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130

LOG_EVERY_S = 5.0
"""How often progress is told where standard error is no terminal [s]."""
REPORT_WIDTH = 110
"""Columns of a table where standard output is no terminal."""


class UserError(ValueError):
    """What the user asked for cannot be; the message is one line that says what was wrong and what would be right."""


@contextlib.contextmanager
def mistakes_are_users() -> Iterator[None]:
    """Within, a `ValueError` is the user's mistake: names, numbers and files are being read, nothing is computed yet."""
    try:
        yield
    except UserError:
        raise
    except ValueError as error:
        raise UserError(" ".join(str(error).split())) from error


def output_folder(path: Path) -> Path:
    """Make the folder that results go to.

    Raises:
        UserError: it cannot be made or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out {path}: the folder cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK):
        raise UserError(f"--out {path}: the folder cannot be written; name another")
    return path


def one_of(names: Iterable[str]) -> Any:
    """What to annotate an argument with that is one of these names: the help text lists them, others are refused."""
    return tyro.conf.arg(constructor=tyro.extras.literal_type_from_choices(names))


def parse_names(text: str, known: tuple[str, ...], what: str) -> tuple[str, ...]:
    """Comma-separated names, each known, none twice.

    Raises:
        UserError: an unknown or repeated name, or none at all.
    """
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise UserError(f"unknown {what} '{', '.join(unknown)}'; there are: {', '.join(known)}")
    if len(set(names)) != len(names):
        raise UserError(f"a {what} is named twice in '{text}'")
    return names


def parse_numbers(text: str, what: str) -> tuple[float, ...]:
    """Comma-separated positive numbers, increasing.

    Raises:
        UserError: one is no positive number, or they do not increase.
    """
    try:
        numbers = tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError as error:
        raise UserError(f"{what} '{text}' is no list of numbers such as 2,6,30,60") from error
    if not numbers or any(not 0.0 < n < float("inf") for n in numbers) or any(b <= a for a, b in pairwise(numbers)):
        raise UserError(f"{what} '{text}' must be positive numbers that increase, such as 2,6,30,60")
    return numbers


def parse_values(text: str, what: str) -> dict[str, float]:
    """`name=value,name=value` as numbers.

    Raises:
        UserError: something else.
    """
    out: dict[str, float] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, equals, value = part.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not equals or not math.isfinite(number) or name.strip() in out:
            raise UserError(f"{what} '{part}' is no NAME=NUMBER of its own, such as friction=0.4")
        out[name.strip()] = number
    return out


def parse_bounds(text: str) -> dict[str, tuple[float, float]]:
    """`name=low:high,...` as pairs of numbers.

    Raises:
        UserError: something else.
    """
    out: dict[str, tuple[float, float]] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, equals, span = part.partition("=")
        low, colon, high = span.partition(":")
        try:
            pair = (float(low), float(high))
        except ValueError:
            colon = ""
        if not equals or not colon or name.strip() in out:
            raise UserError(f"--bounds '{part}' is no NAME=LOW:HIGH of its own, such as friction=0.2:0.8")
        out[name.strip()] = pair
    return out


def progress() -> Bar:
    """A progress bar on standard error, gone when done; silent where standard error is no terminal."""
    console = Console(stderr=True)
    return Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


@contextlib.contextmanager
def shown(title: str) -> Iterator[Report]:
    """Within, a progress bar on standard error; yield the callback that moves it.

    Where standard error is no terminal, a line every few seconds says the same: how much is done, what, and the time left.
    """
    began = last = time.perf_counter()
    bar = progress()

    def show(now: Progress) -> None:
        nonlocal last
        bar.update(task, completed=now.done, total=now.total, description=escape(f"{title}: {now.text}"))
        clock = time.perf_counter()
        if bar.disable and clock - last > LOG_EVERY_S and now.done > 0.0:
            last = clock
            left = (now.total - now.done) / now.done * (clock - began)
            print(f"{title}: {now.done:.0f} of {now.total:.0f}, {now.text}; {left:.0f} s left", file=sys.stderr, flush=True)

    with bar:
        task = bar.add_task(escape(title), total=None)
        yield show


def report_console() -> Console:
    """Standard output for tables, wide enough for them where it is no terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=REPORT_WIDTH)


def report(tables: Iterable[Table], notes: Iterable[str], written: Iterable[Path]) -> None:
    """What a program has found, on standard output: tables, sentences, and where its files are."""
    console = report_console()
    for table in tables:
        console.print(table)
    for note in notes:
        console.print(note, highlight=False)
    console.print("written: " + ", ".join(map(str, written)), highlight=False, soft_wrap=True)


def warn(text: str) -> None:
    """One line on standard error."""
    print(f"warning: {text}", file=sys.stderr)


def run(main: Callable[..., Any], program: str) -> None:
    """Parse the command line into `main`'s arguments, run it, and leave with the exit status that says how it went.

    Args:
        main: a typed function whose docstring documents its arguments.
        program: what usage texts call the program.
    """
    console = Console(stderr=True)
    logging.basicConfig(format="%(message)s", handlers=[RichHandler(console=console, show_path=False, show_time=False)])
    logging.getLogger("validation").setLevel(logging.INFO)  # of other packages only warnings
    try:
        tyro.cli(main, prog=program)
    except UserError as error:
        sys.exit(_complain(f"error: {error}", EXIT_USER_ERROR))
    except SsmrError as error:
        sys.exit(_complain(f"run failed: {error}", EXIT_FAILED_RUN))
    except (OSError, MemoryError) as error:
        sys.exit(_complain(f"run failed: {_circumstance(error)}", EXIT_FAILED_RUN))
    except KeyboardInterrupt:
        sys.exit(_complain("interrupted", EXIT_INTERRUPTED))


def _circumstance(error: OSError | MemoryError) -> str:
    """What the machine refused, in one line."""
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    where = f" ({error.filename})" if error.filename else ""
    return f"{error.strerror or error}{where}; what was written before is whole"


def _complain(text: str, status: int) -> int:
    print(text, file=sys.stderr)
    return status
