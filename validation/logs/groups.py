"""Columns of a log in groups, each group with its own time stamps, and the way to bring them onto one clock.

On the common clock, measurements are interpolated linearly (angles are unwrapped first) between samples that were not only
logged again. Commands are held until the next one, and count as zero once they are older than `_COMMAND_TIMEOUT`, as in a
robot's driver. A gap in a group becomes a gap in the recording. Groups that share their time stamps keep them, unless
another rate is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssmr.geometry import relative
from ssmr.types import FloatArray
from validation.logs.limits import USUAL, LogLimits
from validation.logs.recording import POSE_COLUMNS, TIME_ROUNDOFF, Recording, RecordingError, fresh_poses, refreshed

GROUPS: Mapping[str, tuple[str, ...]] = {
    "pose": POSE_COLUMNS,
    "wheels": ("enc_left", "enc_right"),
    "odom": ("odom_v", "odom_w", "odom_x", "odom_y", "odom_yaw"),
    "imu": ("gyro_z",),
    "gps": ("gps_east", "gps_north"),
    "cmd": ("cmd_v", "cmd_w"),
}
"""Columns of each group. The first group that a log has sets the rate of its recording, unless a rate is asked for."""
_OTHERS = "channels"
"""Name of the group that holds all other columns."""
POSES = (POSE_COLUMNS, ("odom_x", "odom_y", "odom_yaw"))
"""Triples of columns that are x [m], y [m] and yaw [rad] of one motion."""

_COMMAND_TIMEOUT = 0.5
"""Age from which a command no longer counts [s]: a driver stops a robot that gets no commands any more."""
_GAP_FACTOR = 2.5
"""A step longer than this many periods, of the group or of the recording, is a gap; as in `Recording`."""


@dataclass(frozen=True, eq=False)
class Group:
    """Columns that were sampled together, M samples."""

    source: str
    """Topic or file that the samples come from."""
    t: FloatArray
    """(M,) strictly increasing [s]; M is at least 2."""
    columns: Mapping[str, FloatArray]
    """Columns by name, each (M,), finite; angles are unwrapped."""

    @property
    def period(self) -> float:
        """Median step of time [s]."""
        return float(np.median(np.diff(self.t)))

    def longest_step(self, period: float = 0.0) -> float:
        """Return the longest step of time [s] that is no gap, at the group's own period or at a longer `period` [s]."""
        return _GAP_FACTOR * max(self.period, period) + TIME_ROUNDOFF

    def gaps(self) -> list[tuple[float, float]]:
        """Return the beginning and the end of each gap [s]."""
        at = np.flatnonzero(np.diff(self.t) > self.longest_step())
        return [(float(self.t[k]), float(self.t[k + 1])) for k in at]

    def in_gaps(self, t: FloatArray, margin: float = 0.0, least: float = 0.0) -> NDArray[np.bool_]:
        """Return (N,) whether instants `t` [s] lie in gaps.

        Args:
            t: (N,) instants [s].
            margin: time after the beginning and before the end of a gap that does not count as in it [s].
            least: shorter gaps, or equal ones, do not count [s].
        """
        at = np.flatnonzero(np.diff(self.t) > max(self.longest_step(), least))
        if not len(at):
            return np.zeros(len(t), dtype=bool)
        start, stop = self.t[at] + margin, self.t[at + 1] - margin
        last = np.searchsorted(start, t, side="left") - 1
        return (last >= 0) & (t < stop[last])


Groups = Mapping[str, Group]
_MOST_SMOOTHING = 1e10
"""Greatest number of pairs of samples that are averaged in smoothing."""


def groups_of(recording: Recording, source: str) -> dict[str, Group]:
    """Return the columns of a recording in groups, with yaw unwrapped; `source` is the file that they come from."""
    there = {**recording.columns, **recording.channels}
    for _, _, yaw in POSES:
        if yaw in there:
            there[yaw] = np.unwrap(there[yaw])
    groups = {}
    for name, members in GROUPS.items():
        columns = {member: there.pop(member) for member in members if member in there}
        if columns:
            groups[name] = Group(source, recording.t, columns)
    return {**groups, **({_OTHERS: Group(source, recording.t, there)} if there else {})}


def stacked_columns(columns: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray | None:
    """Return (M, len(names)) columns side by side; None where one is missing."""
    return np.column_stack([columns[n] for n in names]) if all(n in columns for n in names) else None


# ------------------------------------------------------------------------------------------ one clock
def merge(path: Path, groups: Groups, rate: float | None = None, limits: LogLimits = USUAL) -> Recording:
    """Bring groups onto one clock.

    Args:
        path: file of the log; the recording takes its name, and errors name it.
        groups: groups by name.
        rate: samples a second [Hz]. None: the time stamps that the groups share, or the rate of the first group of `GROUPS`.
        limits: greatest number of samples, and of samples times columns; the usual ones if not given.

    Raises:
        RecordingError: the groups do not overlap, leave nothing between their gaps, hold no known column, or make more
            samples than the limits allow.
    """
    t = _clock(path, groups, rate, limits)
    period = float(np.median(np.diff(t)))
    keep = np.ones(len(t), dtype=bool)
    columns: dict[str, FloatArray] = {}
    for name, group in groups.items():
        if name == "cmd":
            columns |= {n: held(t, group.t, values) for n, values in group.columns.items()}
            continue
        keep &= ~group.in_gaps(t, TIME_ROUNDOFF, group.longest_step(period))  # gaps at the recording's period as well
        new = slice(None) if np.array_equal(t, group.t) else _measured(name, group)
        columns |= {n: np.interp(t, group.t[new], values[new]) for n, values in group.columns.items()}
    if np.count_nonzero(keep) < 2:
        raise RecordingError(path, f"nothing is left between the gaps: {_spans(groups.values())}")
    try:
        return Recording.from_columns(path.stem, {"t": t[keep], **{n: a[keep] for n, a in columns.items()}}, _GAP_FACTOR)
    except ValueError as cause:
        raise RecordingError(path, str(cause)) from cause


def _measured(name: str, group: Group) -> NDArray[np.bool_]:
    """Return (M,) where a group's samples were measured anew, or stand beside a gap.

    A localiser or encoder that is slower than its log repeats its last value. To interpolate between repetitions would make
    it late, by half of the time for which it is repeated.
    """
    if name not in ("pose", "wheels", "odom"):
        return np.ones(len(group.t), dtype=bool)
    new = (fresh_poses if name == "pose" else refreshed)(group.t, np.column_stack(list(group.columns.values())))
    gap = np.diff(group.t) > group.longest_step()
    return new | np.append(gap, True) | np.append(True, gap)


def _spans(groups: Iterable[Group]) -> str:
    return ", ".join(f"{g.source} {g.t[0]:.6g} to {g.t[-1]:.6g} s" for g in groups)


def _clock(path: Path, groups: Groups, rate: float | None, limits: LogLimits) -> FloatArray:
    """Return the (N,) instants of a recording: shared stamps, or a grid over the time that all measured groups cover."""
    measured = [g for name, g in groups.items() if name != "cmd"] or list(groups.values())
    if not measured:
        raise RecordingError(path, "there is nothing of use: wanted commands, odometry, wheels, an IMU, a pose or GPS")
    first = next(groups[name] for name in (*GROUPS, _OTHERS) if name in groups)
    if rate is None and all(np.array_equal(g.t, first.t) for g in measured):
        return first.t
    dt = first.period if rate is None else 1.0 / rate
    start, stop = max(float(g.t[0]) for g in measured), min(float(g.t[-1]) for g in measured)
    if stop - start < dt:
        raise RecordingError(path, f"the topics do not overlap: {_spans(measured)}; leave one out with topics ROLE=none")
    n = (stop - start) / dt + TIME_ROUNDOFF
    width = sum(len(g.columns) for g in groups.values())
    for limit, many in (("samples", n), ("cells", n * width)):
        if many > getattr(limits, limit):
            many_samples = f"{stop - start:.6g} s at {1.0 / dt:.6g} Hz are too many samples"
            raise RecordingError(path, f"{many_samples} of {width} columns, for {limits.says(limit)}; ask for a lower rate")
    return np.asarray(start + dt * np.arange(int(n) + 1), dtype=np.float64)


def held(t: FloatArray, stamps: FloatArray, values: FloatArray) -> FloatArray:
    """Return the (N,) last commands at or before `t` [s]; zero where there is none or it is too old.

    Args:
        t: (N,) instants [s].
        stamps: (M,) instants of the commands [s].
        values: (M,) the commands.
    """
    last = np.searchsorted(stamps, t + TIME_ROUNDOFF, side="right") - 1
    age = t - stamps[np.maximum(last, 0)]
    return np.where((last >= 0) & (age <= _COMMAND_TIMEOUT + TIME_ROUNDOFF), values[np.maximum(last, 0)], 0.0)


# ------------------------------------------------------------------------------------------ steps of a conversion
def smoothed(t: FloatArray, values: FloatArray, sigma: float, longest_step: float = math.inf) -> FloatArray:
    """Return a Gaussian-weighted moving average over time (Sec. 3.5.2), cut off at three sigma, at the ends and at gaps.

    Args:
        t: (M,) stamps [s].
        values: (M,) values to smooth.
        sigma: standard deviation [s]; 0 changes nothing.
        longest_step: a longer step is a gap [s].
    """
    if sigma == 0.0:
        return values
    piece = np.cumulative_sum(np.diff(t) > longest_step, include_initial=True)
    total, weights = values.copy(), np.ones_like(values)
    for lag in range(1, len(t)):
        step = t[lag:] - t[:-lag]
        near = (step <= 3.0 * sigma) & (piece[lag:] == piece[:-lag])
        if not np.any(near):
            break
        weight = np.where(near, np.exp(-0.5 * np.minimum(step / sigma, 4.0) ** 2), 0.0)
        total[lag:] += weight * values[:-lag]
        total[:-lag] += weight * values[lag:]
        weights[lag:] += weight
        weights[:-lag] += weight
    return total / weights


def smoothed_groups(groups: Groups, sigma: float) -> dict[str, Group]:
    """Return the groups with measurements smoothed, see `smoothed`; commands stay as they were given.

    Raises:
        ValueError: so many samples lie within three sigma of each other that it would take minutes.
    """
    for g in groups.values():
        if 3.0 * sigma / g.period * len(g.t) * len(g.columns) > _MOST_SMOOTHING:
            raise ValueError(
                f"smooth {sigma:g} s is too wide for {len(g.t)} samples of {g.source} at {1.0 / g.period:.6g} Hz"
            )

    def smooth(g: Group) -> Group:
        return replace(g, columns={n: smoothed(g.t, a, sigma, g.longest_step()) for n, a in g.columns.items()})

    return {name: g if name == "cmd" else smooth(g) for name, g in groups.items()}


def cut_groups(path: Path, groups: Groups, start: float | None, stop: float | None) -> dict[str, Group]:
    """Return the samples with `start` <= t <= `stop` [s]; None leaves that end as it is. Groups without samples drop out.

    Raises:
        RecordingError: nothing is left.
    """
    low, high = (-math.inf if start is None else start), (math.inf if stop is None else stop)
    found = {}
    for name, g in groups.items():
        keep = (g.t >= low) & (g.t <= high)
        if np.count_nonzero(keep) > 1:
            found[name] = replace(g, t=g.t[keep], columns={n: a[keep] for n, a in g.columns.items()})
    if not found:
        raise RecordingError(path, f"nothing was logged in {low:g} to {high:g} s; there is {_spans(groups.values())}")
    return found


def aligned(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return (M,) columns with every pose among them relative to its own first one (Sec. 4.2)."""
    found = dict(columns)
    for names in POSES:
        pose = stacked_columns(columns, names)
        if pose is not None:
            found |= dict(zip(names, relative(pose[0], pose).T, strict=True))
    return found
