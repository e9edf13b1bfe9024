"""Offsets of time between the groups of a log, from the lag at which their yaw rates agree best."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.logs.groups import Group, Groups, held
from validation.logs.rest import wheel_twist

_OFFSET_STEP = 0.01
"""Period on which yaw rates are correlated [s]; a parabola through the best three lags is finer than that."""
_OFFSET_SMOOTHING = 0.1
"""Standard deviation of the Gaussian that smooths both yaw rates first [s]: the slope of a noisy yaw is noisier."""
_OFFSET_LIMIT = 1.0
"""Longest offset that is looked for [s]."""
_OFFSET_SPAN = 5.0
"""Shortest overlap of two groups that are correlated [s]."""
_OFFSET_SAMPLES = 1_000_000
"""Greatest number of periods that are correlated: of a log that is longer than three hours, the beginning suffices."""
_OFFSET_CORRELATION = 0.5
"""Least correlation from which an offset is taken; below it the two yaw rates are not alike enough."""
_CLOCK_ORDER = ("imu", "wheels", "odom", "pose")
"""The first of these groups that a log has is the clock for the others: a gyro measures its yaw rate at once."""


@dataclass(frozen=True)
class Offset:
    """Delay of one group's yaw rate behind another's."""

    late: str
    """Group that is late, if `seconds` is positive."""
    behind: str
    """Group that it is compared with."""
    seconds: float
    """Delay [s]."""
    correlation: float
    """Correlation of the two yaw rates at that delay [1]; equal signals have 1."""


def yaw_rate(groups: Groups, name: str) -> FloatArray | None:
    """Return the (M,) yaw rate of a group at its stamps [rad/s]: for a pose the slope of yaw; None where it has none."""
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


def estimate_offsets(groups: Groups) -> list[Offset]:
    """Estimate the delay of each group behind the first group of `_CLOCK_ORDER`.

    The delay is the lag at which the correlation of the yaw rates is greatest, refined by a parabola. The delay of commands
    is negative, because a robot follows them. Groups whose yaw rate does not resemble the first one's, or is zero, are left
    out.
    """
    rates = {name: rate for name in (*_CLOCK_ORDER, "cmd") if (rate := yaw_rate(groups, name)) is not None}
    reference, *others = list(rates) or [""]
    found: list[Offset] = []
    for name in others:
        lag = _lag(groups[reference], rates[reference], groups[name], rates[name], is_held=name == "cmd")
        if lag is not None:
            found.append(Offset(name, reference, *lag))
    return found


def synchronised(groups: Groups, offsets: Iterable[Offset]) -> dict[str, Group]:
    """Return the groups with offsets taken out of the measurements; commands stay, for their delay is the robot's."""
    late = {offset.late: offset.seconds for offset in offsets if offset.late != "cmd"}
    return {name: replace(g, t=g.t - late.get(name, 0.0)) for name, g in groups.items()}


def _lag(a: Group, rate_a: FloatArray, b: Group, rate_b: FloatArray, *, is_held: bool) -> tuple[float, float] | None:
    """Return the delay of b behind a [s] and the correlation there; None where the two are not alike."""
    from scipy import ndimage  # here: it takes a tenth of a second to import

    start, stop = max(a.t[0], b.t[0]), min(a.t[-1], b.t[-1])
    if stop - start < _OFFSET_SPAN:
        return None
    grid = np.arange(start, min(stop, start + _OFFSET_SAMPLES * _OFFSET_STEP), _OFFSET_STEP)
    x, y = np.interp(grid, a.t, rate_a), np.interp(grid, b.t, rate_b)
    if is_held:  # on both sides of each instant: on stamps that the grid meets, one side would be half a step early
        y = 0.5 * (held(grid - 0.5 * _OFFSET_STEP, b.t, rate_b) + held(grid + 0.5 * _OFFSET_STEP, b.t, rate_b))
    x, y = (ndimage.gaussian_filter1d(rate, _OFFSET_SMOOTHING / _OFFSET_STEP, mode="nearest") for rate in (x, y))
    lags, likeness = _correlations(x, y, ~a.in_gaps(grid), ~b.in_gaps(grid))
    best = int(np.argmax(likeness))
    if likeness[best] < _OFFSET_CORRELATION or best in (0, len(lags) - 1):
        return None
    before, at, after = likeness[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    refined = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(lags[best] + refined) * _OFFSET_STEP, float(at)


def _correlations(
    x: FloatArray, y: FloatArray, x_known: NDArray[np.bool_], y_known: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return lags of y behind x, in samples, and Pearson's correlation at each; both are (N,) series, known in places."""
    from scipy import signal

    of_x, of_y = x_known.astype(np.float64), y_known.astype(np.float64)
    x, y = (x - x.mean()) * of_x, (y - y.mean()) * of_y
    most = round(_OFFSET_LIMIT / _OFFSET_STEP)
    window = slice(len(x) - 1 - most, len(x) + most)

    def summed(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(signal.correlate(v, u, mode="full", method="fft")[window], dtype=np.float64)

    n = np.maximum(summed(of_x, of_y), 1.0)
    mean_x, mean_y = summed(x, of_y) / n, summed(of_x, y) / n
    variance = (summed(x * x, of_y) / n - mean_x**2) * (summed(of_x, y * y) / n - mean_y**2)
    tiny = 1e-12  # (rad/s)^4: yaw rates of a millionth of a rad/s, standing
    likeness = np.where(variance > tiny, (summed(x, y) / n - mean_x * mean_y) / np.sqrt(np.maximum(variance, tiny)), 0.0)
    return np.arange(-most, most + 1), likeness
