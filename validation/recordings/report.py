"""What a log holds, as terminal tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from rich.table import Table

from ssmr.types import FloatArray
from validation.logs.bags import Bag, Stream
from validation.logs.dead_reckoning import Reckoning
from validation.logs.signals import REST_LEAST, Groups, Offset, Rest
from validation.show.tables import DEGREES, NOTHING, Cell, Grid, Unit, rich_table

SHOWN = 5
"""Of gaps and jumps, so many are named."""
RATE, SECONDS = Unit("Hz", 1.0, 2), Unit("s", 1.0, 2)


def stream_table(bag: Bag, chosen: Mapping[str, Stream]) -> Table:
    """The topics of a bag, and what each is taken for."""
    taken = {id(stream): role for role, stream in chosen.items()}
    rows = [
        _row(s.topic, s.type.rpartition("/")[2], s.t, ", ".join(s.columns), taken.get(id(s), NOTHING)) for s in bag.streams
    ]
    rows += [
        _row(topic, kind.rpartition("/")[2], np.zeros(count), "not read", NOTHING)
        for topic, (kind, count) in bag.others.items()
    ]
    return _table(("topic", "type"), ("taken for", "columns"), rows, bag.path.name)


def group_table(name: str, groups: Groups) -> Table:
    """The columns of a recording, in groups."""
    rows = [_row(group, "", g.t, ", ".join(g.columns), "") for group, g in groups.items()]
    return _table(("group",), ("columns",), rows, name)


def _row(name: str, kind: str, t: FloatArray, columns: str, role: str) -> dict[str, str]:
    read = len(t) > 1 and t[-1] > t[0]
    return {
        "topic": name,
        "group": name,
        "type": kind,
        "samples": str(len(t)),
        "rate": RATE.text(1.0 / float(np.median(np.diff(t))) if read and np.median(np.diff(t)) > 0.0 else math.nan),
        "from": SECONDS.text(float(t[0]) if read else math.nan),
        "to": SECONDS.text(float(t[-1]) if read else math.nan),
        "columns": columns,
        "taken for": role,
    }


def _table(left: Sequence[str], right: Sequence[str], rows: Iterable[Mapping[str, str]], title: str) -> Table:
    units = {"samples": "1", "rate": "Hz", "from": "s", "to": "s"}
    names = (*left, *units, *right)
    cells = tuple(tuple(Cell(row[name]) for name in names) for row in rows)
    table = rich_table(Grid(tuple((n, units.get(n, "")) for n in names), (cells,), left=len(left)), title, "")
    for column, name in zip(table.columns, names, strict=True):
        if name in ("columns", "taken for"):
            column.justify, column.no_wrap = "left", name != "columns"
    return table


def offset_table(offsets: Sequence[Offset]) -> Table | None:
    """How late each group is behind the one with the surest clock; None where nothing could be told."""
    if not offsets:
        return None
    header = (("group", ""), ("behind", ""), ("late", "s"), ("correlation", "1"))
    rows = tuple((Cell(o.late), Cell(o.behind), Cell(f"{o.seconds:+.4f}"), Cell(f"{o.correlation:.3f}")) for o in offsets)
    return rich_table(Grid(header, (rows,), left=2), "Offsets of time, by yaw rate", "negative: early, as commands are")


def reckoning_table(reckoning: Reckoning | None) -> Table | None:
    """Ways of dead reckoning beside each other; None where the log allows none."""
    if reckoning is None:
        return None
    header = (("dead reckoning by", ""), ("rms", "m"), ("path", "m"))
    best = min(r.rms for r in reckoning.rows)
    rows = tuple((Cell(r.name), Cell(f"{r.rms:.2f}", r.rms == best), Cell(f"{r.length:.1f}")) for r in reckoning.rows)
    caption = f"against {reckoning.samples} positions of {reckoning.truth}, after rigid alignment · emphasised: the best"
    return rich_table(Grid(header, (rows,), left=1), "Dead reckoning", caption)


def log_notes(bag: Bag | None, groups: Groups, rest: Rest | None) -> list[str]:
    """What the tables do not say: jumps, late samples, gaps, and the gyro at rest."""
    notes = []
    for s in bag.streams if bag is not None else ():
        if s.jumps:
            at = ", ".join(f"{size:+.3f} s after {when:.3f} s" for when, size in s.jumps[:SHOWN])
            notes.append(f"{s.topic}: the clock jumps {_times(len(s.jumps))}: {at}{_more(len(s.jumps))}")
        if s.stamps == "bag":
            notes.append(f"{s.topic}: stamped by the bag, as it was written; its messages have no stamp of that clock")
        if s.late:
            notes.append(f"{s.topic}: {s.late} samples came late and were sorted in")
    told: dict[tuple[str, tuple[tuple[float, float], ...]], None] = {
        (g.source, tuple(g.gaps())): None for g in groups.values() if g.gaps()
    }
    for source, gaps in told:
        at = ", ".join(f"{a:.3f} to {b:.3f} s" for a, b in gaps[:SHOWN])
        notes.append(f"{source}: {len(gaps)} gap{'s' * (len(gaps) > 1)}: {at}{_more(len(gaps))}")
    if "imu" in groups and rest is None:
        notes.append(f"gyro: no bias can be told; the wheels never stand for {REST_LEAST:g} s")
    if rest is not None:
        bias = f"{rest.bias:+.5f} rad/s ({DEGREES.text(rest.bias)}°/s)"
        notes.append(f"gyro at rest, {rest.seconds:.1f} s in all: mean {bias}, scatter {rest.std:.5f} rad/s")
    return notes


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"


def _more(n: int) -> str:
    return f" and {n - SHOWN} more" if n > SHOWN else ""
