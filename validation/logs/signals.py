"""What a log holds as groups of columns, each group at its own stamps, and what brings them onto one clock.

What was measured is interpolated linearly, angles unwrapped; what was commanded is held, and is zero once it is older than
`COMMAND_TIMEOUT`, as a robot's driver has it. Where a group has a gap, the recording has one too. Groups that share their
stamps keep them, unless another rate is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from ssmr.estimation.ekf import EkfSettings
from ssmr.geometry import relative
from ssmr.robot.drive import body_rates
from ssmr.types import FloatArray
from validation.logs.recording import POSE, TIME_ROUNDOFF, Recording, RecordingError

GROUPS: Mapping[str, tuple[str, ...]] = {
    "pose": POSE,
    "wheels": ("enc_left", "enc_right"),
    "odom": ("odom_v", "odom_w", "odom_x", "odom_y", "odom_yaw"),
    "imu": ("gyro_z",),
    "gps": ("gps_east", "gps_north"),
    "cmd": ("cmd_v", "cmd_w"),
}
"""Which columns belong together. The first group that there is gives a recording its rate, unless one is asked for."""
OTHERS = "channels"
"""The group of all other columns."""
POSES = (POSE, ("odom_x", "odom_y", "odom_yaw"))
"""Columns that are x [m], y [m] and yaw [rad] of one motion."""

COMMAND_TIMEOUT = 0.5
"""An older command no longer counts [s]: drivers stop a robot that nobody commands any more."""
GAP_FACTOR = 2.5
"""A step longer than this many periods, of the group or of the recording, is a gap; as in `Recording`."""
MOST_SAMPLES = 10_000_000
"""Of a recording: more is a mistaken rate, or a mistaken clock."""

OFFSET_STEP = 0.01
"""Period on which yaw rates are correlated [s]; a parabola through the best three lags does better than that."""
OFFSET_SMOOTHING = 0.1
"""Standard deviation of the Gaussian that smooths both yaw rates first [s]: the slope of a noisy yaw is noisier."""
OFFSET_LIMIT = 1.0
"""The longest offset that is looked for [s]."""
OFFSET_SPAN = 5.0
"""Groups that overlap for less are not correlated [s]."""
OFFSET_CORRELATION = 0.5
"""A lower one is no likeness, and tells nothing."""

REST_V = 0.01
"""A robot stands if its wheels' speed, averaged over `2 REST_MARGIN`, is less [m/s]; noisy encoders show a third."""
REST_W = 0.02
"""The same of their yaw rate [rad/s]."""
REST_MARGIN = 0.5
"""What lies nearer to a motion is not taken for rest [s]: odometry may be late."""
REST_LEAST = 2.0
"""Less rest than this tells no bias [s]."""


@dataclass(frozen=True, eq=False)
class Group:
    """Columns that were sampled together, M samples."""

    source: str
    """The topic or the file that they are from."""
    t: FloatArray
    """(M,) strictly increasing [s]; M at least 2."""
    columns: Mapping[str, FloatArray]
    """Each (M,), finite; angles unwrapped."""

    @property
    def period(self) -> float:
        """Median step of time [s]."""
        return float(np.median(np.diff(self.t)))

    def longest_step(self, period: float = 0.0) -> float:
        """A longer step of time is a gap [s], at the group's own period or a longer one [s]."""
        return GAP_FACTOR * max(self.period, period) + TIME_ROUNDOFF

    def gaps(self) -> list[tuple[float, float]]:
        """From where to where nothing was measured [s]."""
        at = np.flatnonzero(np.diff(self.t) > self.longest_step())
        return [(float(self.t[k]), float(self.t[k + 1])) for k in at]


Groups = Mapping[str, Group]


def groups_of(recording: Recording, source: str) -> dict[str, Group]:
    """The columns of a recording, grouped; yaw unwrapped."""
    there = {**recording.columns, **recording.channels}
    for name in (names[2] for names in POSES):
        if name in there:
            there[name] = np.unwrap(there[name])
    groups = {}
    for name, members in GROUPS.items():
        columns = {member: there.pop(member) for member in members if member in there}
        if columns:
            groups[name] = Group(source, recording.t, columns)
    return {**groups, **({OTHERS: Group(source, recording.t, there)} if there else {})}


# ------------------------------------------------------------------------------------------ one clock
def merge(path: Path, groups: Groups, rate: float | None = None) -> Recording:
    """Groups on one clock.

    Args:
        path: where they are from; the recording is called after it, and errors name it.
        groups: by name.
        rate: samples a second [Hz]; None: the groups' common stamps, or as many as the first of `GROUPS` has.

    Raises:
        RecordingError: the groups do not overlap, leave nothing between their gaps, or hold no known column.
    """
    t = _clock(path, groups, rate)
    period = float(np.median(np.diff(t)))
    keep = np.ones(len(t), dtype=bool)
    columns: dict[str, FloatArray] = {}
    for name, group in groups.items():
        if name == "cmd":
            columns |= {n: _held(t, group.t, values) for n, values in group.columns.items()}
            continue
        for start, stop in _gaps(group, period):
            keep &= (t <= start + TIME_ROUNDOFF) | (t >= stop - TIME_ROUNDOFF)
        columns |= {n: np.interp(t, group.t, values) for n, values in group.columns.items()}
    if np.count_nonzero(keep) < 2:
        raise RecordingError(path, f"nothing is left between the gaps: {_spans(groups.values())}")
    try:
        return Recording.from_columns(path.stem, {"t": t[keep], **{n: a[keep] for n, a in columns.items()}}, GAP_FACTOR)
    except ValueError as cause:
        raise RecordingError(path, str(cause)) from cause


def _gaps(group: Group, period: float) -> list[tuple[float, float]]:
    """Gaps of a group that a recording of that period [s] shows too."""
    return [(a, b) for a, b in group.gaps() if b - a > group.longest_step(period)]


def _spans(groups: Iterable[Group]) -> str:
    return ", ".join(f"{g.source} {g.t[0]:.6g} to {g.t[-1]:.6g} s" for g in groups)


def _clock(path: Path, groups: Groups, rate: float | None) -> FloatArray:
    """(N,) the instants of a recording: common stamps, or a grid over the time that all measured groups have."""
    measured = [g for name, g in groups.items() if name != "cmd"] or list(groups.values())
    if not measured:
        raise RecordingError(path, "there is nothing of use: wanted commands, odometry, wheels, an IMU, a pose or GPS")
    first = next(groups[name] for name in (*GROUPS, OTHERS) if name in groups)
    if rate is None and all(np.array_equal(g.t, first.t) for g in measured):
        return first.t
    dt = first.period if rate is None else 1.0 / rate
    start, stop = max(float(g.t[0]) for g in measured), min(float(g.t[-1]) for g in measured)
    if stop - start < dt:
        raise RecordingError(path, f"the topics do not overlap: {_spans(measured)}; --topics ROLE=none leaves one out")
    n = (stop - start) / dt + TIME_ROUNDOFF
    if n > MOST_SAMPLES:
        many = f"{stop - start:.6g} s at {1.0 / dt:.6g} Hz are too many samples"
        raise RecordingError(path, f"{many}; ask for a lower --rate")
    return np.asarray(start + dt * np.arange(int(n) + 1), dtype=np.float64)


def _held(t: FloatArray, stamps: FloatArray, values: FloatArray) -> FloatArray:
    """(N,) the last command at or before each instant, zero where there is none or it is too old."""
    last = np.searchsorted(stamps, t + TIME_ROUNDOFF, side="right") - 1
    age = t - stamps[np.maximum(last, 0)]
    return np.where((last >= 0) & (age <= COMMAND_TIMEOUT + TIME_ROUNDOFF), values[np.maximum(last, 0)], 0.0)


def smoothed(t: FloatArray, values: FloatArray, sigma: float, longest_step: float = math.inf) -> FloatArray:
    """Gaussian-weighted moving average (Sec. 3.5.2), by time; the window is cut off at three sigma, at the ends and at gaps.

    Args:
        t: (M,) stamps [s].
        values: (M,) what to smooth.
        sigma: standard deviation [s]; 0: nothing is done.
        longest_step: a longer one is a gap [s].
    """
    if sigma == 0.0:
        return values
    piece = np.concatenate([[0], np.cumsum(np.diff(t) > longest_step)])
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
    """The groups with what was measured smoothed, see `smoothed`; commands as they were given."""

    def smooth(g: Group) -> Group:
        return replace(g, columns={n: smoothed(g.t, a, sigma, g.longest_step()) for n, a in g.columns.items()})

    return {name: g if name == "cmd" else smooth(g) for name, g in groups.items()}


def cut_groups(path: Path, groups: Groups, start: float | None, stop: float | None) -> dict[str, Group]:
    """What was logged at `start` <= t <= `stop` [s]; None leaves that end as it is. Groups that end before are left out.

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
    """(M,) columns with every pose among them seen from its own first one (Sec. 4.2): the world begins there."""
    found = dict(columns)
    for names in POSES:
        pose = selected(columns, names)
        if pose is not None:
            found |= dict(zip(names, relative(pose[0], pose).T, strict=True))
    return found


# ------------------------------------------------------------------------------------------ the gyro's bias
@dataclass(frozen=True)
class Rest:
    """What a gyro shows while the wheels stand."""

    bias: float
    """Its mean [rad/s]."""
    std: float
    """Scatter of single samples about it [rad/s]."""
    seconds: float
    """How long they stood [s]."""


def wheel_twist(groups: Groups) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """(M,) stamps [s], v [m/s] and yaw rate [rad/s] as wheels have them, from encoders or else odometry; None without.

    Encoders are converted with the default radius and half-track of the state filter, a stock Husky's.
    """
    for name, (a, b) in (("wheels", ("enc_left", "enc_right")), ("odom", ("odom_v", "odom_w"))):
        group = groups.get(name)
        if group is not None and a in group.columns and b in group.columns:
            first, second = group.columns[a], group.columns[b]
            if name == "wheels":
                first, second = body_rates.py_func(first, second, EkfSettings.half_track, EkfSettings.radius)
            return group.t, first, second
    return None


def standing(groups: Groups, t: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether the robot stood at instants `t` [s], by its wheels; nowhere, where there are none."""
    wheels = wheel_twist(groups)
    if wheels is None:
        return np.zeros(len(t), dtype=bool)
    stamps, v, w = wheels
    low = np.searchsorted(stamps, stamps - REST_MARGIN - TIME_ROUNDOFF)
    high = np.searchsorted(stamps, stamps + REST_MARGIN + TIME_ROUNDOFF)
    mean = [np.diff(np.concatenate([[0.0], np.cumsum(a)])[np.stack([low, high])], axis=0)[0] / (high - low) for a in (v, w)]
    moving = stamps[(np.abs(mean[0]) > REST_V) | (np.abs(mean[1]) > REST_W)]
    at = np.concatenate([[-math.inf], moving, [math.inf]])
    after = np.searchsorted(at, t, side="right")
    margin = np.minimum(t - at[after - 1], at[np.minimum(after, len(at) - 1)] - t)
    return (margin > REST_MARGIN) & (t >= stamps[0]) & (t <= stamps[-1])


def find_rest(groups: Groups) -> Rest | None:
    """What the gyro shows while the wheels stand; None where that cannot be told."""
    if "imu" not in groups:
        return None
    imu = groups["imu"]
    still = standing(groups, imu.t)
    seconds = float(np.count_nonzero(still)) * imu.period
    if seconds < REST_LEAST:
        return None
    shown = imu.columns["gyro_z"][still]
    return Rest(float(np.mean(shown)), float(np.std(shown)), seconds)


def unbiased(path: Path, groups: Groups) -> dict[str, Group]:
    """The groups with the gyro's mean at rest taken out.

    Raises:
        RecordingError: it cannot be told.
    """
    rest = find_rest(groups)
    if rest is None:
        raise RecordingError(path, f"--unbias needs a gyro, and wheels that stand for {REST_LEAST:g} s in all")
    imu = groups["imu"]
    return {**groups, "imu": replace(imu, columns={"gyro_z": imu.columns["gyro_z"] - rest.bias})}


# ------------------------------------------------------------------------------------------ offsets of time
@dataclass(frozen=True)
class Offset:
    """How late one group's yaw rate is behind another's."""

    late: str
    """The group that is late, if `seconds` is positive."""
    behind: str
    """The group it is held against."""
    seconds: float
    """[s]."""
    correlation: float
    """Of the two yaw rates at that lag: 1 is alike."""


def yaw_rate(groups: Groups, name: str) -> FloatArray | None:
    """(M,) yaw rate of a group at its stamps [rad/s]; None where it has none. A pose's is the slope of its yaw."""
    group = groups.get(name)
    if group is None:
        return None
    if name in ("wheels", "odom"):
        wheels = wheel_twist({name: group})
        return None if wheels is None else wheels[2]
    if name == "pose":
        yaw = group.columns.get("yaw")
        return None if yaw is None else np.asarray(np.gradient(yaw, group.t), dtype=np.float64)
    return group.columns.get({"imu": "gyro_z", "cmd": "cmd_w"}.get(name, ""))


REFERENCES = ("imu", "wheels", "odom", "pose")
"""The first of these that there is has the clock that others are held against: a gyro measures its yaw rate at once."""


def estimate_offsets(groups: Groups) -> list[Offset]:
    """How late each group's yaw rate is behind that of the first of `REFERENCES`; groups unlike it, or still, are left out.

    The lag at which the correlation is greatest, refined by a parabola. The lateness of commands is negative: a robot
    follows them.
    """
    rates = {name: rate for name in (*REFERENCES, "cmd") if (rate := yaw_rate(groups, name)) is not None}
    reference = next((name for name in REFERENCES if name in rates), None)
    found: list[Offset] = []
    for name in rates:
        if reference is None or name == reference:
            continue
        lag = _lag(groups[reference], rates[reference], groups[name], rates[name], held=name == "cmd")
        if lag is not None:
            found.append(Offset(name, reference, *lag))
    return found


def _lag(a: Group, rate_a: FloatArray, b: Group, rate_b: FloatArray, *, held: bool) -> tuple[float, float] | None:
    """By how much b is later than a [s], and the correlation there; None where that says nothing."""
    start, stop = max(a.t[0], b.t[0]), min(a.t[-1], b.t[-1])
    if stop - start < OFFSET_SPAN:
        return None
    grid = np.arange(start, min(stop, start + MOST_SAMPLES * OFFSET_STEP), OFFSET_STEP)
    x, y = np.interp(grid, a.t, rate_a), np.interp(grid, b.t, rate_b)
    if held:  # on both sides of each instant: on stamps that the grid meets, one side would be half a step early
        y = 0.5 * (_held(grid - 0.5 * OFFSET_STEP, b.t, rate_b) + _held(grid + 0.5 * OFFSET_STEP, b.t, rate_b))
    x, y = (ndimage.gaussian_filter1d(rate, OFFSET_SMOOTHING / OFFSET_STEP, mode="nearest") for rate in (x, y))
    lags, likeness = _correlations(x, y, _covered(grid, a), _covered(grid, b))
    best = int(np.argmax(likeness))
    if likeness[best] < OFFSET_CORRELATION or best in (0, len(lags) - 1):
        return None
    before, at, after = likeness[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    refined = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(lags[best] + refined) * OFFSET_STEP, float(at)


def _covered(grid: FloatArray, group: Group) -> FloatArray:
    """(N,) 1 where a group was sampled, 0 in its gaps."""
    covered = np.ones(len(grid))
    for start, stop in group.gaps():
        covered[(grid > start) & (grid < stop)] = 0.0
    return covered


def _correlations(x: FloatArray, y: FloatArray, of_x: FloatArray, of_y: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Lags of y behind x, in samples, and Pearson's correlation over what both have, of (N,) series with masks."""
    x, y = (x - x.mean()) * of_x, (y - y.mean()) * of_y
    most = round(OFFSET_LIMIT / OFFSET_STEP)
    window = slice(len(x) - 1 - most, len(x) + most)

    def summed(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(signal.correlate(v, u, mode="full", method="fft")[window], dtype=np.float64)

    n = np.maximum(summed(of_x, of_y), 1.0)
    mean_x, mean_y = summed(x, of_y) / n, summed(of_x, y) / n
    variance = (summed(x * x, of_y) / n - mean_x**2) * (summed(of_x, y * y) / n - mean_y**2)
    tiny = 1e-12  # (rad/s)^4: a millionth of a rad/s, standing
    likeness = np.where(variance > tiny, (summed(x, y) / n - mean_x * mean_y) / np.sqrt(np.maximum(variance, tiny)), 0.0)
    return np.arange(-most, most + 1), likeness


def synchronised(groups: Groups, offsets: Iterable[Offset]) -> dict[str, Group]:
    """The groups with offsets taken out of what was measured; a command's lateness is the robot's, and stays."""
    late = {offset.late: offset.seconds for offset in offsets if offset.late != "cmd"}
    return {name: replace(g, t=g.t - late.get(name, 0.0)) for name, g in groups.items()}


def selected(columns: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray | None:
    """(M, len(names)) columns side by side; None where one is missing."""
    return np.column_stack([columns[n] for n in names]) if all(n in columns for n in names) else None
