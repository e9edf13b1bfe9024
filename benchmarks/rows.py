"""Parts that the benchmarks share: the table of pairs, their timing side by side, and the file."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.table import Table

from validation import cli, output

T = TypeVar("T")
Row = Mapping[str, Any]
"""Numbers and texts by the name of their column, whose ending is the unit."""
Pair = tuple[Callable[[], object], Callable[[], object], str]
"""Two calls, and the limit that is asked of the first one's time over the second one's: `<= 1.1`.
"""


class MissingError(ValueError):
    """Something that a part of a benchmark needs is not installed here."""


def measure_if_installed(quick: bool, measure: Callable[[], T]) -> T | None:
    """Return what `measure` returns; a quick run leaves out parts that are not installed."""
    try:
        return measure()
    except MissingError as error:
        if not quick:
            raise
        cli.warn_user(f"left out: {error}")
        return None


def processor_time() -> float:
    """Return the processor time that this process and its ended children have taken [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def run_python(*arguments: str, **variables: str) -> None:
    """Run a new Python with these arguments, and `variables` in its environment.

    Raises:
        CalledProcessError: it failed.
    """
    environment = {**os.environ, **variables}
    command = [sys.executable, *arguments]
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)


IMPORTS = partial(run_python, "-c", "import numpy, numba, mujoco, matplotlib, rerun")
"""The machine's unit: what the libraries take to be imported."""


def time_pairs(pairs: Mapping[str, Pair], repeats: int) -> list[Row]:
    """Return a row for each pair: the fastest processor times, and their ratio beside its limit.

    The calls of a pair take turns, so that load hurts both alike; the first turn compiles.
    """
    rows = list[Row]()
    for what, (above, below, asked) in pairs.items():
        times = np.empty((repeats + 1, 2))
        for turn in times:
            for k, call in enumerate((above, below)):
                began = processor_time()
                call()
                turn[k] = processor_time() - began
        first, second = times[1:].min(axis=0).tolist()
        ratio = first / second
        compare, limit = asked.split()
        kept = ratio <= float(limit) if compare == "<=" else ratio >= float(limit)
        numbers = {"above_ms": 1e3 * first, "below_ms": 1e3 * second, "ratio": ratio}
        row = {"what": what, **numbers, "asked": asked, "kept": "yes" if kept else "FALLS SHORT"}
        rows.append(row)
    return rows


def report_rows(title: str, rows: Sequence[Row], out: Path) -> None:
    """Print the rows, whose columns are those of the first, and write them as JSON."""
    table = Table(*(rows[0] if rows else ()), title=title)
    for row in rows:
        numbers = row.values()
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else str(x) for x in numbers))
    cli.report_console().print(table)
    output.make_folder(out.parent)
    document = {
        "schema": "ssmr.benchmark/1",
        "versions": output.list_versions(),
        "cores": os.cpu_count(),
        "rows": [*rows],
    }
    output.write_json(out, output.plain_value(document))
