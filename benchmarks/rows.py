"""Parts that the benchmarks share: timing side by side, rows of a table, and the file."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.table import Table

from validation import cli, output

T = TypeVar("T")
Row = Mapping[str, Any]
"""Numbers and texts by the name of their column, whose ending is the unit."""


class MissingError(ValueError):
    """Something that a part of a benchmark needs is not installed here."""


def optional(quick: bool, measure: Callable[[], T]) -> T | None:
    """Return what `measure` returns; a quick run leaves out parts that are not installed."""
    try:
        return measure()
    except MissingError as error:
        if not quick:
            raise
        cli.warn(f"left out: {error}")
        return None


def alternate(*calls: Callable[[], object], repeats: int) -> list[float]:
    """The fastest processor time of each call [s]; calls take turns, so load hurts them alike."""
    times = np.empty((repeats + 1, len(calls)))
    for i in range(repeats + 1):  # the first round compiles
        for j, call in enumerate(calls):
            began = time.process_time()
            call()
            times[i, j] = time.process_time() - began
    return [float(t) for t in times[1:].min(axis=0)]


def spent(*arguments: str, **variables: str) -> float:
    """Return the processor time of a new Python with these arguments [s].

    `variables` are added to its environment. A CalledProcessError says that it failed.
    """
    command = [sys.executable, *arguments]
    nowhere = subprocess.DEVNULL
    before = sum(os.times()[2:4])
    subprocess.run(command, check=True, env={**os.environ, **variables}, stdout=nowhere)
    return sum(os.times()[2:4]) - before


@cache
def imports() -> float:
    """Return the processor time that the libraries take to be imported [s]: the machine's unit."""
    code = "import numpy, numba, mujoco, matplotlib, rerun"
    return min(spent("-c", code) for _ in range(3))


def ratio(
    what: str, above_s: float, below_s: float, most: float = np.inf, least: float = 0.0
) -> Row:
    """Return the row of one time over another, which must lie within two bounds."""
    value = above_s / below_s
    limit = f"<= {most:g}" if most < np.inf else f">= {least:g}"
    ok = "yes" if least <= value <= most else "FALLS SHORT"
    return {
        "what": what,
        "above_ms": 1e3 * above_s,
        "below_ms": 1e3 * below_s,
        "ratio": value,
        "asked": limit,
        "kept": ok,
    }


def report(title: str, rows: Sequence[Row], out: Path) -> None:
    """Print the rows, whose columns are those of the first, and write them as JSON."""
    table = Table(*(rows[0] if rows else ()), title=title)
    for row in rows:
        numbers = row.values()
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else str(x) for x in numbers))
    cli.report_console().print(table)
    output.make_folder(out.parent)
    document = {
        "schema": "ssmr.benchmark/1",
        "versions": output.versions(),
        "cores": os.cpu_count(),
        "rows": [*rows],
    }
    output.write_json(out, output.plain(document))
