"""Tables and sentences about a log."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssmr.types import FloatArray
from validation.logs.bags import SHOWN
from validation.logs.dead_reckoning import Reckoning
from validation.logs.groups import Groups
from validation.logs.health import LogHealth
from validation.logs.log import Log, Topic
from validation.logs.offsets import Offset
from validation.logs.rest import REST_LEAST, Rest
from validation.report.tables import DEGREES, NOTHING, Cell, Grid, Unit

_RATE, _SECONDS = Unit("Hz", 1.0, 2), Unit("s", 1.0, 2)
_SAMPLING = (("samples", "1"), ("rate", "Hz"), ("from", "s"), ("to", "s"))


def topic_grid(name: str, topics: Sequence[Topic]) -> Grid:
    """Return the topics of a log, their types, rates and columns, and the role of each."""
    header = (("topic", ""), ("type", ""), *_SAMPLING, ("taken for", ""), ("columns", ""))
    rows = tuple(
        (
            Cell(topic.name),
            Cell(topic.type.rpartition("/")[2]),
            *_sampling(topic.t),
            Cell(topic.role or NOTHING),
            Cell("not read" if topic.columns is None else ", ".join(topic.columns)),
        )
        for topic in topics
    )
    return Grid(header, (rows,), left=2, title=name, trailing=2)


def group_grid(name: str, groups: Groups) -> Grid:
    """Return the groups of columns of a log, and their rates."""
    rows = tuple((Cell(group), *_sampling(g.t), Cell(", ".join(g.columns))) for group, g in groups.items())
    return Grid((("group", ""), *_SAMPLING, ("columns", "")), (rows,), left=1, title=name, trailing=1)


def _sampling(t: FloatArray) -> tuple[Cell, ...]:
    """Return the number of samples, their rate, and the first and the last stamp."""
    read = len(t) > 1 and t[-1] > t[0]
    period = float(np.median(np.diff(t))) if read else 0.0
    rate = 1.0 / period if period > 0.0 else math.nan
    first, last = (float(t[0]), float(t[-1])) if read else (math.nan, math.nan)
    return (Cell(str(len(t))), Cell(_RATE.text(rate)), Cell(_SECONDS.text(first)), Cell(_SECONDS.text(last)))


def health_grid(health: LogHealth) -> Grid | None:
    """Return what the log says about itself; None where it has nothing that could be looked at."""
    rows = []
    if health.jumps is not None:
        t, steps, turns = health.jumps.t, health.jumps.metres, health.jumps.radians
        worst = f"up to {steps.max():.2f} m and {DEGREES.text(turns.max())}°, {t[0]:.2f} to {t[-1]:.2f} s" if len(t) else ""
        rows.append((Cell("jumps of the localiser"), Cell(str(len(t))), Cell(worst)))
    if health.uncommanded_share is not None:
        share = Cell(f"{100.0 * health.uncommanded_share:.1f} %")
        rows.append((Cell("time in which wheels turn without a command"), share, Cell("")))
    if rows or health.dead_columns:
        dead = Cell(", ".join(health.dead_columns))
        rows.append((Cell("columns that stay the same while it moves"), Cell(str(len(health.dead_columns))), dead))
    header = (("fault", ""), ("found", ""), ("where", ""))
    return Grid(header, (tuple(rows),), 1, "Health of the log", trailing=1) if rows else None


def offset_grid(offsets: Sequence[Offset]) -> Grid | None:
    """Return the delay of each signal behind the one with the surest clock; None where no delay is known."""
    if not offsets:
        return None
    header = (("signal", ""), ("behind", ""), ("late", "s"), ("standard error", "s"), ("correlation", "1"))
    rows = tuple(
        (
            Cell(o.late),
            Cell(o.behind),
            Cell(f"{o.seconds:+.4f}"),
            Cell(NOTHING if o.standard_error is None else f"{o.standard_error:.4f}"),
            Cell(f"{o.correlation:.3f}"),
        )
        for o in offsets
    )
    caption = "From yaw rates, for the position from speeds. Negative: early, as commands are."
    return Grid(header, (rows,), 2, "Offsets of time", caption)


def reckoning_grid(reckoning: Reckoning | None) -> Grid | None:
    """Return ways of dead reckoning beside each other; None where the log allows none."""
    if reckoning is None:
        return None
    header = (("dead reckoning by", ""), ("rms", "m"), ("path", "m"))
    best = min(r.rms for r in reckoning.rows)
    rows = tuple((Cell(r.name), Cell(f"{r.rms:.2f}", r.rms == best), Cell(f"{r.length:.1f}")) for r in reckoning.rows)
    caption = (
        f"Distance from {reckoning.samples} positions of {reckoning.truth} after rigid alignment; the best is emphasised."
    )
    return Grid(header, (rows,), 1, "Dead reckoning", caption)


def log_notes(log: Log, rest: Rest | None) -> list[str]:
    """Return sentences about the clocks and gaps of a log, and about its gyro at rest."""
    notes = list(log.remarks)
    gaps_by_source = {(g.source, tuple(g.gaps())): None for g in log.groups.values() if g.gaps()}
    for source, gaps in gaps_by_source:
        at = ", ".join(f"{a:.3f} to {b:.3f} s" for a, b in gaps[:SHOWN])
        more = f" and {len(gaps) - SHOWN} more" if len(gaps) > SHOWN else ""
        notes.append(f"{source}: {len(gaps)} gap{'s' * (len(gaps) > 1)}: {at}{more}")
    if "imu" in log.groups and rest is None:
        notes.append(f"gyro: its bias is unknown, because the wheels never stand for {REST_LEAST:g} s in all")
    if rest is not None:
        bias = f"{rest.bias:+.5f} rad/s ({DEGREES.text(rest.bias)}°/s)"
        notes.append(f"gyro at rest, {rest.seconds:.1f} s in all: mean {bias}, standard deviation {rest.std:.5f} rad/s")
    return notes
