"""Signals of a log over windows of time, on one clock whatever the delays of its groups.

What the columns tell of the yaw rate says how late one group is behind another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ssmr.geometry import integral
from ssmr.types import FloatArray
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Group, Log, LogFault
from validation.files.signals import fresh_poses, refreshed

_WINDOW_S = 1.0
"""Length of the windows over which signals are averaged [s]."""
_STEP_S = 0.5
"""Time between the middles of two windows [s]."""
_LAGS = np.arange(-1.5, 1.51, 0.1)
"""Delays of a sensor or a command that are tried [s]."""
_SHORT_S = 60.0
"""Length of a log from which the times above hold [s]; of a shorter one they are parts."""
_MOST = 4000
"""Number of windows that suffices."""
_SAME = 0.9
"""Correlation of signals that differ by noise alone."""
_FINE_S = 0.1
"""Time between the delays that are compared [s]."""
_LONGEST_S = 60.0
"""Longest difference of two clocks that is looked for [s]."""
_PARTS = 6
"""Least number of parts of a log whose delays are compared."""
_PART_S = 8.0
"""Shortest of them [s]."""
_LONG_PART_S = 20.0
"""Usual length of those of a long log [s]."""
_CLOCKS_GAIN = 0.1
"""Correlation that a difference of clocks must gain [1]."""
FEWEST_WINDOWS = 20
"""Number of windows from which they say anything of signals."""
_WHEELS = COMMAND_COLUMNS["wheels"]
RATES = (*_WHEELS, "odom_v", "odom_w", "gyro_z", *COMMAND_COLUMNS["twist"])
"""Columns that are rates."""
Channels = Mapping[str, FloatArray]
"""(N,) means over windows by column: rates; of x, y and yaw their rates of change, and `heading`,
the yaw itself [rad]."""
_Ways = dict[str, tuple[FloatArray, FloatArray]]
"""By column, (K,) stamps [s] and the way since the first of them."""


def correlation(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two rates about zero [1]; 0 where one of them is zero."""
    size = float(np.sqrt((x @ x) * (y @ y)))
    if size <= 1e-9:
        return 0.0
    return float(x @ y) / size


def channels(log: Log) -> Channels | None:
    """Return the channels of a log on the clock of the first; None where there are too few.

    Each group is brought to the time of the first. At least two groups must overlap for
    `FEWEST_WINDOWS` outside their gaps.
    """
    names = ("wheels", "odom", "imu", "cmd", "pose")
    groups = [log.groups[name] for name in names if name in log.groups]
    if len(groups) < 2:
        return None
    start = max(g.t[0] for g in groups)
    stop = min(g.t[-1] for g in groups)
    period = min(g.period for g in groups)
    unit = max(min(1.0, max(0.0, stop - start) / _SHORT_S), 2.0 * period / _STEP_S)
    # windows that are moved by the longest lag stay within all groups
    margin = unit * (_WINDOW_S + float(_LAGS[-1]))
    step = unit * _STEP_S
    length = stop - start - 2.0 * margin
    if length < FEWEST_WINDOWS * step:
        return None
    n = min(_MOST, math.floor(length / step))
    middles = start + margin + step * np.arange(n)
    means = dict[str, FloatArray]()
    usable = np.ones(n, dtype=bool)
    bases = list[FloatArray]()
    for group in groups:
        sums = _sums(group)
        lag = unit * _lag(sums, middles, bases, unit) if means else 0.0
        at = middles + lag
        means |= _means(sums, at, unit)
        for edge in (-0.5, 0.0, 0.5):
            usable &= ~group.in_gaps(at + edge * unit)
        if means and not bases:
            rates = np.column_stack(list(means.values()))
            products = np.einsum("ni,nj->nij", rates, rates).reshape(n, -1)
            bases = [np.linalg.qr(basis)[0] for basis in (rates, products)]
    if np.count_nonzero(usable) < FEWEST_WINDOWS:
        return None
    return {name: values[usable] for name, values in means.items()}


def _sums(group: Group) -> _Ways:
    """Return the ways of a group's columns, of new samples: integrals of rates; x, y and yaw."""
    sums = {}
    pose = group.table(POSE_COLUMNS)
    for name, values in group.columns.items():
        column = values[:, None]
        if name in POSE_COLUMNS:
            new = fresh_poses(group.t, column if pose is None else pose)
            sums[name] = group.t[new], values[new]
        elif name in RATES:
            new = refreshed(group.t, column)
            t = group.t[new]
            sums[name] = t, integral(t, values[new])
    return sums


def _means(sums: _Ways, middles: FloatArray, window: float) -> dict[str, FloatArray]:
    """Return the channels over a `window` [s] around the (N,) middles [s]."""
    low = middles - 0.5 * window
    high = middles + 0.5 * window
    means = {}
    for name, (t, way) in sums.items():
        means[name] = (np.interp(high, t, way) - np.interp(low, t, way)) / window
    if "yaw" in sums:
        means["heading"] = np.interp(middles, *sums["yaw"])
    return means


def _lag(sums: _Ways, middles: FloatArray, bases: Sequence[FloatArray], unit: float) -> float:
    """Return the delay of a group's columns [`unit`] at which the others explain most of them.

    Signs and units do not matter. Rates are explained by the rates of another group, the square of
    a speed of positions by their products; `bases` has an orthonormal basis of each.
    """

    def share(values: FloatArray, basis: FloatArray) -> float:
        return float(np.sum((values @ basis) ** 2)) / max(float(values @ values), 1e-12)

    best = 0.0
    most = 0.0
    for lag in _LAGS:
        means = _means(sums, middles + unit * lag, unit)
        rates = [means[name] for name in means if name not in ("x", "y", "heading")]
        explained = sum(share(values, bases[0]) for values in rates)
        if "x" in means and "y" in means:
            explained += share(means["x"] ** 2 + means["y"] ** 2, bases[1])
        if explained > most:
            best = float(lag)
            most = explained
    return best


def headings_and_turns(log: Log) -> tuple[FloatArray, FloatArray, FloatArray, str] | None:
    """Return instants, headings and turns by gyro or wheels at them, and which these are."""
    sums = _Ways()
    for group in log.groups.values():
        sums |= _sums(group)
    left, right = (sums.get(name) for name in _WHEELS)
    if left and right:
        sums["wheels"] = left[0], np.interp(left[0], *right) - left[1]
    clock = next((name for name in ("gyro_z", "wheels") if name in sums), "")
    yaw = sums.get("yaw")
    if not clock or not yaw:
        return None
    t, way = sums[clock]
    start = max(t[0], yaw[0][0])
    stop = min(t[-1], yaw[0][-1], start + _MOST)
    grid = np.arange(start, stop, _FINE_S)
    return grid, np.interp(grid, *yaw), np.interp(grid, t, way), clock


def _delay(yaw: FloatArray, way: FloatArray, longest: float) -> tuple[float, float, float]:
    """Return the delay of headings behind turns [s], the correlation there, and the best nearby.

    Both are (N,) angles on a grid of `_FINE_S`; nearby are delays that `channels` takes out.
    """
    wide = round(_STEP_S / _FINE_S)
    a = way[wide:] - way[:-wide]
    b = yaw[wide:] - yaw[:-wide]
    n = len(a)
    most = min(round(longest / _FINE_S), n // 2)
    correlations = []
    for k in range(-most, most + 1):
        x = a[max(0, -k) : n - max(0, k)]
        y = b[max(0, k) : n + min(0, k)]
        correlations.append(abs(correlation(x, y)))
    near = round(float(_LAGS[-1]) / _FINE_S)
    nearest = max(correlations[max(0, most - near) : most + near + 1])
    best = int(np.argmax(correlations))
    return _FINE_S * (best - most), correlations[best], nearest


def apart(log: Log) -> tuple[LogFault, float] | None:
    """Return a fault, and the delay of headings behind gyro or wheels [s], if no lag explains it.

    None where their clocks go together.
    """
    found = headings_and_turns(log)
    if found is None or len(found[0]) < 2 * FEWEST_WINDOWS:
        return None
    _, yaw, way, clock = found
    late, best, nearest = _delay(yaw, way, _LONGEST_S)
    if best <= max(_SAME, nearest + _CLOCKS_GAIN):
        return None
    order = "after" if late > 0.0 else "before"
    sentence = (
        f"yaw tells of turns about {abs(late):.1f} s {order} {clock}: "
        "their clocks differ, and no delay so long is taken out"
    )
    return LogFault("clock", ("t",), sentence), late


def delays(log: Log) -> tuple[FloatArray, FloatArray, str] | None:
    """Return the middles of parts of a log, the delays of headings there [s], and behind what.

    None where there are too few parts in which gyro or wheels and headings resemble one another.
    """
    found = headings_and_turns(log)
    if found is None or len(found[0]) * _FINE_S < _PARTS * _PART_S:
        return None
    grid, yaw, way, clock = found
    times = []
    late = []
    # in a longer part, a delay that grows would blur what is compared
    parts = max(_PARTS, round(len(grid) * _FINE_S / _LONG_PART_S))
    for part in np.array_split(np.arange(len(grid)), parts):
        delay, best, _ = _delay(yaw[part], way[part], _LONGEST_S)
        if best > _SAME:
            times.append(float(np.mean(grid[part])))
            late.append(delay)
    if len(times) < max(_PARTS - 1, parts // 2):
        return None
    return np.array(times), np.array(late), clock
