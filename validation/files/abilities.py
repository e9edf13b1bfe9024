"""A log is looked at once, where it is opened.

That finds what it shows by itself, and for what it is good enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ssmr.types import FloatArray
from validation.files.circular import new_poses
from validation.files.faults import Faults, Rest, find_faults, find_rest
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Group, Log, LogFault
from validation.files.offsets import Offset, estimate_offsets

FATAL = (
    *("sign", "swapped", "scale", "handedness", "circular", "positions", "setpoints"),
    *("unrelated", "same", "frame", "counter"),
)
"""Kinds of faults with which no fit makes sense, as long as they are not put right."""
_WINDOW_S = 6.0
"""Length of the windows over which predictions are judged [s]."""
_PARTS = 3.0
"""A log is fitted on all but one of so many parts of it, and judged on that."""
_STEP_S = 0.5
"""Time between the poses that are compared [s]."""
_STANDS = 0.3
"""Way [m] and turn [rad] of a whole log below which the robot stands."""
_TURNED = 0.4
"""Change of heading below which a log hardly turns [rad]."""
_SLOW = 0.03
"""Speed below which wheels and localisers tell little but noise [m/s]."""
_STEADY = 0.05
"""Deviation of speed and yaw rate, over their means, of a constant circle [1]."""


@dataclass(frozen=True, eq=False)
class Inspected:
    """A log, and what it shows by itself."""

    log: Log
    """The log that was looked at."""
    faults: Faults
    """Its faults."""
    offsets: tuple[Offset, ...]
    """Delays between its signals."""
    rest: Rest | None
    """The gyro's readings while the robot stands; None without any."""


def inspect(log: Log, radius: float | None = None) -> Inspected:
    """Look at a log; `radius` is that of the robot's wheels [m], None where it is unknown."""
    return Inspected(log, find_faults(log, radius), tuple(estimate_offsets(log)), find_rest(log))


def too_short(group: Group) -> str:
    """Return a sentence on a group of poses that has no window between its gaps; else nothing."""
    edges = [float(group.t[0]), *np.ravel(group.gaps()), float(group.t[-1])]
    longest = float(np.max(np.diff(edges)[::2]))
    if longest >= _WINDOW_S:
        return ""
    return (
        f"{longest:.3g} s without a gap are too short for a window of {_WINDOW_S:g} s: "
        "drive for a minute or more"
    )


def lacks(log: Log) -> Iterator[str]:
    """Yield a sentence for each thing that a log with poses cannot tell, and what to drive."""
    poses = new_poses(log)
    if poses is None or len(poses.t) < 3:
        return
    t = poses.t
    whole = float(t[-1] - t[0])
    short = too_short(poses.group)
    if short:
        yield short
        return
    if whole < _PARTS * _WINDOW_S:
        yield (
            f"the last third of {whole:.3g} s is too short to judge on: drive for a minute or more"
        )
    grid = np.arange(t[0], t[-1], _STEP_S)
    x, y, yaw = (np.interp(grid, t, column) for column in poses.pose.T)
    speed = np.hypot(np.diff(x), np.diff(y)) / _STEP_S
    rate = np.diff(yaw) / _STEP_S
    extent = max(np.ptp(x), np.ptp(y))
    turned = np.ptp(yaw)
    if extent < _STANDS and turned < _STANDS:
        yield "the robot stands: drive ahead, back, and curves to both sides"
    elif turned < _TURNED:
        yield (
            "the log never turns, so how the robot turns cannot be determined: "
            "drive curves to both sides, and turn on the spot"
        )
    elif extent < _STANDS:
        yield "the robot only turns on the spot: drive ahead and curves too"
    else:
        yield from _monotonous(speed, rate)


def _monotonous(speed: FloatArray, rate: FloatArray) -> Iterator[str]:
    """Yield what is too uniform in (N,) speeds [m/s] and yaw rates [rad/s] of a log."""
    moving = speed > _SLOW
    if np.mean(moving) < 0.2 and np.percentile(speed, 98.0) < 2.0 * _SLOW:
        yield f"the robot is slower than {_SLOW:g} m/s, so noise hides its motion: drive faster"
        return
    v = speed[moving]
    w = rate[moving]
    turns = float(np.mean(np.abs(w)))
    if turns > 0.02 and np.std(v) < _STEADY * np.mean(v) and np.std(w) < _STEADY * turns:
        yield "the robot drives one constant circle: change speed and radius, and turn both ways"
        return
    sides = [float(np.sum(w[w > 0.0])), -float(np.sum(w[w < 0.0]))]
    if min(sides) < 0.02 * max(sides):
        yield "the robot turns to one side only, so left and right wheels are mixed: turn both ways"


def good_for(log: Log, faults: Sequence[LogFault]) -> dict[str, bool]:
    """Return whether a fit by `wheels`, by `commands`, and a look at the `gyro` make sense."""
    spoiled = set[str]()
    for fault in faults:
        if fault.kind in FATAL and fault not in log.faults:
            spoiled.update(fault.columns)
    sound = log.has(POSE_COLUMNS) and not spoiled & {*POSE_COLUMNS} and not any(lacks(log))
    needs = {"commands": COMMAND_COLUMNS["twist"], "wheels": COMMAND_COLUMNS["wheels"]}
    good = {"gyro": bool(sound and log.has(("gyro_z",)) and "gyro_z" not in spoiled)}
    for name, columns in needs.items():
        good[name] = bool(sound and log.has(columns) and not spoiled & {*columns})
    return good
