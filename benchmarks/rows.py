"""What the benchmarks share: a measured ratio, timing side by side, the table and the file."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.table import Table

from validation import cli, store

T = TypeVar("T")


@dataclass(frozen=True)
class Row:
    """One measured ratio."""

    what: str
    """What is compared with what."""
    ratio: float
    """Ours over the peer's time, or a speed."""
    bound: str
    """What was asked for; empty where it is only for the record."""
    ours_s: float
    """Fastest time of ours [s]."""
    peer_s: float
    """Fastest time of the peer [s]."""
    ok: bool
    """Whether the bound is kept."""


def at_most(what: str, ours_s: float, peer_s: float, limit: float | None = None) -> Row:
    """Return our time over the peer's, which must not pass a limit; without one it is only for the record."""
    ratio = ours_s / peer_s
    return Row(what, ratio, "" if limit is None else f"<= {limit:g}", ours_s, peer_s, limit is None or ratio <= limit)


def at_least(what: str, ours_s: float, peer_s: float, limit: float | None = None) -> Row:
    """Return the peer's time over ours, which must reach a limit; without one it is only for the record."""
    ratio = peer_s / ours_s
    return Row(what, ratio, "" if limit is None else f">= {limit:g}", ours_s, peer_s, limit is None or ratio >= limit)


def alternate(*calls: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> list[float]:
    """Fastest time of each call [s] by a clock, all called in turn so that a busy machine hurts them alike."""
    for call in calls:
        call()
    times = np.empty((repeats, len(calls)))
    for i in range(repeats):
        for j, call in enumerate(calls):
            began = clock()
            call()
            times[i, j] = clock() - began
    return [float(t) for t in times.min(axis=0)]


class MissingError(cli.UserError):
    """Something that a part of a benchmark needs is not installed here."""


def optional(quick: bool, measure: Callable[[], T]) -> T | None:
    """Return what `measure` returns, or None after one line that says what a quick run has to leave out.

    Raises:
        MissingError: something is not installed, and the run is not a quick one.
    """
    try:
        return measure()
    except MissingError as error:
        if not quick:
            raise
        cli.warn(f"left out: {error}")
        return None


def as_table(title: str, rows: Sequence[Row]) -> Table:
    """The rows for the terminal."""
    table = Table(title=title)
    for column in ("what", "ratio", "asked", "ours [ms]", "peer [ms]", ""):
        table.add_column(column, justify="left" if column in ("what", "") else "right")
    for row in rows:
        verdict = "" if not row.bound else "ok" if row.ok else "FALLS SHORT"
        table.add_row(row.what, f"{row.ratio:.3g}", row.bound, f"{1e3 * row.ours_s:.3f}", f"{1e3 * row.peer_s:.3f}", verdict)
    return table


def report(title: str, rows: Sequence[Row], out: Path, **more: Any) -> None:
    """Print the rows and write them, with what else is to be recorded, as JSON."""
    cli.report_console().print(as_table(title, rows))
    machine = {"machine": platform.machine(), "cores": os.cpu_count(), "load": os.getloadavg()[0]}
    document: dict[str, Any] = {
        "schema": "ssmr.benchmark/1",
        "versions": store.versions(),
        **machine,
        "rows": [vars(r) for r in rows],
        **more,
    }
    cli.output_folder(out.parent)
    store.write_json(out, document)
