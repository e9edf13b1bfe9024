"""Signals of a log over windows of time, on one clock whatever the delays of its groups.

What the columns tell of the yaw rate says how late one group is behind another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ssmr.geometry import integral
from ssmr.types import FloatArray
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Group, Log
from validation.files.signals import centred, correlations, fresh_poses, refreshed

_WINDOW_S = 1.0
"""Length of the windows over which signals are averaged [s]."""
_STEP_S = 0.5
"""Time between the middles of two windows [s]."""
_LAGS = sorted(np.arange(-1.5, 1.51, 0.1).tolist(), key=abs)
"""Delays of a sensor or a command that are tried [s], the least ones first."""
_SHORT_S = 60.0
"""Length of a log from which the times above hold [s]; of a shorter one they are parts."""
_MOST = 4000
"""Number of windows that suffices, and length of the headings that are compared [s]."""
_FINE_S = 0.1
"""Time between the headings that are compared [s]."""
LONGEST_S = 60.0
"""Longest difference of two clocks that is looked for [s]."""
FEWEST_WINDOWS = 20
"""Number of windows from which they say anything of signals."""
ENCODERS = COMMAND_COLUMNS["wheels"]
TWIST = COMMAND_COLUMNS["twist"]
RATES = (*ENCODERS, "odom_v", "odom_w", "gyro_z", *TWIST)
"""Columns that are rates."""
Channels = Mapping[str, FloatArray]
"""(N,) means over windows by column: rates; of x, y and yaw their rates of change, and `heading`,
the yaw itself [rad]. Empty where there are too few windows."""
_Ways = dict[str, tuple[FloatArray, FloatArray]]
"""By column, (K,) stamps [s] and the way since the first of them."""


class Turns(NamedTuple):
    """Headings, and turns by another sensor, at N instants that are `_FINE_S` apart."""

    t: FloatArray
    """(N,) instants [s]."""
    yaw: FloatArray
    """(N,) headings [rad]."""
    way: FloatArray
    """(N,) turns by the other sensor, times a factor."""
    sensor: str
    """What tells these turns, `gyro_z` or `wheels`."""
    period: float
    """Median time between new headings [s]."""

    def delays(self, part: slice, longest: float) -> tuple[FloatArray, FloatArray]:
        """Return (K,) delays of headings up to `longest` [s], and the correlations at them [1]."""
        wide = round(_STEP_S / _FINE_S)
        yaw = self.yaw[part]
        way = self.way[part]
        a = way[wide:] - way[:-wide]
        b = yaw[wide:] - yaw[:-wide]
        most = min(round(longest / _FINE_S), len(a) // 2)
        late = np.asarray(_FINE_S * np.arange(-most, most + 1))
        return late, np.abs(correlations(a, b, most))

    def averaged(self, seconds: float) -> Turns:
        """Return them with the other sensor's turns averaged over so many seconds."""
        samples = round(seconds / _FINE_S)
        means = np.convolve(self.way, np.full(samples, 1.0 / samples), mode="valid")
        start = (samples - 1) // 2
        cut = slice(start, start + len(means))
        return self._replace(t=self.t[cut], yaw=self.yaw[cut], way=means)


@dataclass(frozen=True, eq=False)
class LogSignals:
    """A log, and what its columns tell of the motion."""

    log: Log
    radius: float | None = None
    """Radius of the wheels [m]; None where nobody knows it."""

    @cached_property
    def signals(self) -> Channels:
        """Means over windows."""
        return channels(self.log)

    @property
    def turning(self) -> FloatArray | None:
        """(N,) yaw rates by heading, or else by the gyro [rad/s]."""
        return self.signals.get("yaw", self.signals.get("gyro_z"))

    @property
    def along(self) -> FloatArray | None:
        """(N,) speeds of the pose along its heading [m/s]."""
        return speed_along(self.signals)

    @property
    def wheels(self) -> FloatArray | None:
        """(2, N) rates of left and right wheels [rad/s]."""
        sides = [self.signals[name] for name in ENCODERS if name in self.signals]
        return np.array(sides) if len(sides) == 2 else None

    def likeness(self) -> list[float]:
        """Return how alike turns and ways by wheels or odometry are to those by pose or gyro.

        These are correlations of their sizes about their means; none where nothing varies.
        """
        s = self.signals
        told = [s.get("odom_w"), s.get("odom_v")]
        if self.wheels is not None:
            told = [self.wheels[1] - self.wheels[0], self.wheels[1] + self.wheels[0]]
        alike = []
        for a, b in zip(told, (self.turning, self.along), strict=True):
            if a is not None and b is not None and min(np.std(a), np.std(b)) > 1e-4:
                alike.append(centred(np.abs(a), np.abs(b)))
        return alike

    @cached_property
    def turns(self) -> Turns | None:
        """Headings and the turns by gyro or wheels; None without both."""
        sums = _Ways()
        for group in self.log.groups.values():
            sums |= _sums(group)
        if {*ENCODERS} <= sums.keys():
            t, left = sums[ENCODERS[0]]
            sums["wheels"] = t, np.interp(t, *sums[ENCODERS[1]]) - left
        sensor = next((name for name in ("gyro_z", "wheels") if name in sums), "")
        if not sensor or "yaw" not in sums:
            return None
        stamps, yaw = sums["yaw"]
        t, way = sums[sensor]
        start = max(t[0], stamps[0])
        grid = np.arange(start, min(t[-1], stamps[-1], start + _MOST), _FINE_S)
        if len(grid) < 2 * FEWEST_WINDOWS:
            return None
        period = float(np.median(np.diff(stamps)))
        return Turns(grid, np.interp(grid, stamps, yaw), np.interp(grid, t, way), sensor, period)


def speed_along(signals: Channels) -> FloatArray | None:
    """Return the (N,) speeds of the pose along its heading [m/s]; None without a pose."""
    if not {*POSE_COLUMNS} <= signals.keys():
        return None
    heading = signals["heading"]
    return np.asarray(signals["x"] * np.cos(heading) + signals["y"] * np.sin(heading))


def channels(log: Log) -> Channels:
    """Return the channels of a log on the clock of the first group; none where there are too few.

    Each group is brought to the time of the first. At least two groups must overlap for
    `FEWEST_WINDOWS` outside their gaps.
    """
    names = ("wheels", "odom", "imu", "cmd", "pose")
    groups = [log.groups[name] for name in names if name in log.groups]
    if len(groups) < 2:
        return {}
    start = max(g.t[0] for g in groups)
    stop = min(g.t[-1] for g in groups)
    period = min(g.period for g in groups)
    unit = max(min(1.0, (stop - start) / _SHORT_S), 2.0 * period / _STEP_S)
    # windows that are moved by the longest lag stay within all groups
    margin = unit * (_WINDOW_S + abs(_LAGS[-1]))
    n = min(_MOST, math.floor((stop - start - 2.0 * margin) / (unit * _STEP_S)))
    if n < FEWEST_WINDOWS:
        return {}
    middles = start + margin + unit * _STEP_S * np.arange(n)
    means = dict[str, FloatArray]()
    usable = np.ones(n, dtype=bool)
    bases = list[FloatArray]()
    for group in groups:
        sums = _sums(group)
        at = middles + (_lag(sums, middles, bases, unit) if means else 0.0)
        means |= _means(sums, at, unit)
        usable &= ~group.in_gaps(at, -0.5 * unit)
        if means and not bases:
            rates = np.column_stack(list(means.values()))
            products = np.einsum("ni,nj->nij", rates, rates).reshape(n, -1)
            bases = [np.linalg.qr(basis)[0] for basis in (rates, products)]
    if np.count_nonzero(usable) < FEWEST_WINDOWS:
        return {}
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
    """Return the delay of a group's columns [s] at which the others explain most of them.

    Signs and units do not matter. Rates are explained by the rates of another group, the square of
    a speed of positions by their products; `bases` has an orthonormal basis of each.
    """

    def share(values: FloatArray, basis: FloatArray) -> float:
        return float(np.sum((values @ basis) ** 2)) / max(float(values @ values), 1e-12)

    def explained(lag: float) -> float:
        means = _means(sums, middles + unit * lag, unit)
        rates = [means[name] for name in means if name not in ("x", "y", "heading")]
        of_speed = 0.0
        if {"x", "y"} <= means.keys():
            of_speed = share(means["x"] ** 2 + means["y"] ** 2, bases[1])
        return of_speed + sum(share(values, bases[0]) for values in rates)

    return unit * max(_LAGS, key=explained)
