"""Offsets of time between the sensors of a log: the delay of one signal behind another.

Yaw rates tell the delays of wheels, odometry, commands and of the pose's heading. The delay of its
position shows in the speed along the heading: a localiser may filter the two differently, so they
are measured, and taken out, one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ssmr.types import FloatArray
from validation.files.columns import POSE_COLUMNS
from validation.files.log import Group, Log
from validation.files.motion import SENSORS, NewPoses
from validation.files.sensors import Signals
from validation.files.signals import BoolArray, find_peak, held

_OFFSET_STEP = 0.01
"""Period on which signals are correlated [s]; a parabola through the best three lags is finer."""
_OFFSET_SMOOTHING = 0.1
"""Standard deviation of the Gaussian that smooths both signals first [s]: the slope of a noisy pose
is noisier."""
_OFFSET_LIMIT = 5.0
"""Longest offset that is looked for [s]."""
_OFFSET_SPAN = 5.0
"""Shortest overlap of two signals that are correlated [s]."""
_OFFSET_SAMPLES = 1_000_000
"""Greatest number of periods that are correlated: of a log that is longer than three hours, the
beginning suffices."""
_OFFSET_CORRELATION = 0.5
"""Least correlation from which an offset is taken; below it the two signals differ too much."""
_BLOCK_S = 30.0
"""Length of the blocks of time whose errors are taken as independent [s]."""
_BLOCKS = 8
"""Number of blocks of a log that is too short for so many of that length."""
_SHORTEST_BLOCK_S = 3.0
"""Length of the shortest block [s]: within less, errors of two blocks are correlated."""


@dataclass(frozen=True)
class Offset:
    """Delay of one signal behind another."""

    late: str
    """Group that is late, if `seconds` is positive; of a pose `pose_yaw`, its heading, or
    `position`."""
    behind: str
    """Group that it is compared with."""
    seconds: float
    """Delay [s]."""
    correlation: float
    """Correlation of the two signals at that delay [1]; equal signals have 1."""
    standard_error: float | None = None
    """Standard error, by leaving out one block of the log after the other [s]; None for a log that
    is too short for that."""


@dataclass(frozen=True, eq=False)
class _Rate:
    """Rate that a sensor tells, M samples."""

    t: FloatArray
    """(M,) stamps [s]."""
    values: FloatArray
    """(M,) rates."""
    group: Group
    """Group whose gaps are its own."""
    jumps: Sequence[tuple[float, float]] = ()
    """Beginnings and ends of jumps of the localiser, in which it tells nothing [s]."""

    def smoothed(self, grid: FloatArray) -> FloatArray:
        """Return the (N,) smoothed rates at instants `grid` [s]; NaN where it tells nothing."""
        from scipy import ndimage  # here: it takes a tenth of a second to import

        if "cmd_w" in self.group.columns:
            # commands are held; on stamps that the grid meets, one side would be half a step early
            half = 0.5 * _OFFSET_STEP
            sides = [held(grid + side, self.t, self.values) for side in (-half, half)]
            rates = 0.5 * (sides[0] + sides[1])
        else:
            rates = np.interp(grid, self.t, self.values)
        width = _OFFSET_SMOOTHING / _OFFSET_STEP
        smooth = ndimage.gaussian_filter1d(rates, width, mode="nearest")
        smooth[self.group.in_gaps(grid)] = math.nan
        for start, stop in self.jumps:
            smooth[np.searchsorted(grid, start) : np.searchsorted(grid, stop)] = math.nan
        return np.asarray(smooth)


def _of_steps(poses: NewPoses, jumped: BoolArray, rates: FloatArray) -> _Rate:
    """Return (M - 1,) rates of the steps between poses; jumps tell nothing."""
    t = poses.t
    spans = [(float(t[k]), float(t[k + 1])) for k in np.flatnonzero(jumped)]
    return _Rate(0.5 * (t[1:] + t[:-1])[~jumped], rates[~jumped], poses.group, spans)


def _slopes(poses: NewPoses) -> FloatArray:
    """Return the (M - 1, 3) rates of change of the steps between poses."""
    return np.diff(poses.pose, axis=0) / np.diff(poses.t)[:, None]


def _steps_of(signals: Signals) -> tuple[NewPoses, BoolArray] | None:
    """Return the new poses of a log, and (M - 1,) whether the localiser jumped between them."""
    poses = signals.poses
    if poses is None or len(poses.t) < 3:
        return None
    jumps = signals.jumps
    return poses, np.isin(poses.rows[1:], () if jumps is None else jumps.index)


def why_without_stamps(log: Log) -> str:
    """Return why the commands of a log have no stamps of their own; nothing where they do."""
    return "".join(topic.remark for topic in log.topics if topic.role == "cmd")


def estimate_offsets(signals: Signals) -> list[Offset]:
    """Estimate delays behind the first sensor of `SENSORS`.

    The delay is the lag at which the correlation of two rates is greatest, refined by a parabola.
    Yaw rates are compared with the first sensor's; the speed of the pose's position along its
    heading with that of the wheels, whose own delay is added. The delay of commands is negative,
    because a robot follows them. Signals that do not resemble the first, or are zero, are left out.
    Samples that were only logged again do not count, nor do jumps of the localiser.
    Commands that have no stamps of their own, and would come after what they cause, have none.
    """
    steps = _steps_of(signals)
    has_no_stamps = bool(why_without_stamps(signals.log))
    turning = {name: _Rate(each.t, each.turn, each.group) for name, each in signals.told.items()}
    if steps is not None:
        turning["pose"] = _of_steps(*steps, _slopes(steps[0])[:, 2])
    reference, *others = [name for name in SENSORS if name in turning] or [""]
    offsets = []
    for name in others:
        lag = _delay_between(turning[reference], turning[name])
        comes_after = name == "cmd" and has_no_stamps and lag is not None and lag[0] > 0.0
        if lag is not None and not comes_after:
            offsets.append(Offset("pose_yaw" if name == "pose" else name, reference, *lag))
    for name in ("wheels", "odom"):
        told = signals.told.get(name)
        if steps is not None and told is not None and told.speed is not None:
            speed = _Rate(told.t, told.speed, told.group)
            position = _position_offset(name, speed, steps, offsets)
            return offsets if position is None else [*offsets, position]
    return offsets


def _position_offset(
    wheels: str,
    speed: _Rate,
    steps: tuple[NewPoses, BoolArray],
    offsets: Sequence[Offset],
) -> Offset | None:
    """Return the delay of positions behind the first clock, or the wheels if those have none."""
    poses, jumped = steps
    known = {offset.late: offset for offset in offsets}
    first = known.get(wheels, Offset(wheels, wheels, 0.0, 1.0, 0.0))
    yaw_delay = known["pose_yaw"].seconds - first.seconds if "pose_yaw" in known else 0.0
    lag: tuple[float, float, float | None] = (yaw_delay, 0.0, None)
    middle = 0.5 * (poses.t[1:] + poses.t[:-1])
    x, y, _ = _slopes(poses).T
    # the heading at the time of a position is known once the delay between them is
    for _ in range(3):
        yaw = np.interp(middle + yaw_delay - lag[0], poses.t, poses.pose[:, 2])
        found = _delay_between(speed, _of_steps(poses, jumped, x * np.cos(yaw) + y * np.sin(yaw)))
        if found is None:
            return None
        lag = found
    late, alike, error = lag
    both = None
    if error is not None and first.standard_error is not None:
        both = math.hypot(error, first.standard_error)
    return Offset("position", first.behind, late + first.seconds, alike, both)


def lateness_of_first(offsets: Sequence[Offset]) -> float:
    """Return how late the clock is that others are behind [s].

    Nothing measures a motion before it happens: if all others do, that clock is late.
    """
    early = [-offset.seconds for offset in offsets if offset.late != "cmd"]
    return max(0.0, min(early, default=0.0))


def take_out_offsets(signals: Signals, offsets: Sequence[Offset]) -> Log:
    """Return the log with offsets taken out of the measurements.

    Commands keep the delay that is the robot's, and go with the first clock where that is late.
    Positions and headings are corrected one by one, and stay together: at each corrected stamp of a
    position the heading is interpolated between new ones. Samples that would need a heading from a
    gap or from beyond the ends are left out. Where only one of the two delays is known, it is that
    of both.
    """
    late = {offset.late: offset.seconds for offset in offsets}
    late["cmd"] = -lateness_of_first(offsets)
    log = signals.log
    groups = {name: replace(g, t=g.t - late.get(name, 0.0)) for name, g in log.groups.items()}
    delays = [late[name] for name in ("position", "pose_yaw") if name in late]
    steps = _steps_of(signals)
    if steps is not None and delays:
        groups["pose"] = _moved(*steps, delays[0], delays[-1])
    return replace(log, groups=groups)


def _moved(poses: NewPoses, jumped: BoolArray, position: float, yaw: float) -> Group:
    """Return the group of poses whose positions and headings were late by so much [s]."""
    group = poses.group
    keep = np.ones(len(group.t), dtype=bool)
    columns = dict(group.columns)
    delays = (0.0, 0.0, yaw - position)
    for name, delay, values in zip(POSE_COLUMNS, delays, poses.pose.T, strict=True):
        at = group.t + delay
        keep &= (at >= poses.t[0]) & (at <= poses.t[-1]) & ~group.in_gaps(at)
        last = np.searchsorted(poses.t, at, side="right") - 1
        before = np.clip(last, 0, len(poses.t) - 2)
        jumps = jumped[before] & (at < poses.t[before + 1])  # a jump stays one step
        columns[name] = np.where(jumps, values[before], np.interp(at, poses.t, values))
    return replace(group, t=group.t - position, columns=columns).where(keep)


def _delay_between(a: _Rate, b: _Rate) -> tuple[float, float, float | None] | None:
    """Return the delay of b behind a [s], the correlation there and the standard error [s].

    None if the two are too short, or not correlated.
    """
    if not (len(a.t) and len(b.t)):  # a localiser may jump at every step
        return None
    start = max(a.t[0], b.t[0])
    stop = min(a.t[-1], b.t[-1], start + _OFFSET_SAMPLES * _OFFSET_STEP)
    if stop - start < _OFFSET_SPAN:
        return None
    grid = np.arange(start, stop, _OFFSET_STEP)
    sums = _block_sums(a.smoothed(grid), b.smoothed(grid))
    total = sums.sum(axis=0)
    best = _peak(total)
    if best is None:
        return None
    # the jackknife: the lags that are found without one block after the other
    n = len(sums)
    peaks = [_peak(total - block) for block in sums]
    lags = np.array([peak[0] for peak in peaks if peak is not None])
    if n < _BLOCKS // 2 or len(lags) < n:
        return *best, None
    return *best, math.sqrt((n - 1) * float(np.var(lags)))


def _peak(sums: FloatArray) -> tuple[float, float] | None:
    """Return the lag of greatest correlation [s] and the correlation; None if it is too small.

    `sums` are the (6, L) sums of products of `_block_sums`.
    """
    most = sums.shape[1] // 2
    mean_x, mean_y, square_x, square_y, product = sums[1:] / np.maximum(sums[0], 1.0)
    variance = (square_x - mean_x**2) * (square_y - mean_y**2)
    tiny = 1e-12  # rates of a millionth: standing
    scale = np.sqrt(np.maximum(variance, tiny))
    alike = np.where(variance > tiny, (product - mean_x * mean_y) / scale, 0.0)
    best = find_peak(alike)
    at = float(np.max(alike))
    if at < _OFFSET_CORRELATION or math.isnan(best):
        return None
    return (best - most) * _OFFSET_STEP, at


def _block_sums(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the (B, 6, L) sums of products over blocks of time, by lags of y behind x.

    They are the number of pairs, and sums of x, y, x^2, y^2 and xy, of (N,) series where both are
    numbers.
    """
    from scipy import fft  # here: it takes a tenth of a second to import

    most = round(_OFFSET_LIMIT / _OFFSET_STEP)
    span = len(x) * _OFFSET_STEP
    blocks = max(1, round(span / min(_BLOCK_S, max(_SHORTEST_BLOCK_S, span / _BLOCKS))))
    late = np.pad(y, most, constant_values=math.nan)
    edges = np.linspace(0, len(x), blocks + 1).astype(int)
    size = fft.next_fast_len(int(np.diff(edges).max()) + 2 * most, real=True)
    sums = np.empty((blocks, 6, 2 * most + 1))
    for k, (a, b) in enumerate(pairwise(edges)):
        # correlations of all powers of a block at once, each power transformed once
        powers = []
        for values in (x[a:b], late[a : b + 2 * most]):
            rates = np.nan_to_num(values)
            powers.append(fft.rfft([np.isfinite(values), rates, rates**2], size))
        first = powers[0][[0, 1, 0, 2, 0, 1]]
        second = powers[1][[0, 0, 1, 0, 2, 1]]
        sums[k] = fft.irfft(first.conj() * second, size)[:, : 2 * most + 1]
    return sums
