"""What each sensor of a log tells of the robot's motion: one table, made where the log is opened.

Whoever asks how fast a robot drove or turned, by which sensor, reads it here. Each signal has
stamps of its own, and a sample that was only logged again does not count. Means over windows bring
all signals onto one clock, whatever their delays: what the columns tell of the yaw rate says how
late one group is behind another.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.files.columns import POSE_COLUMNS
from validation.files.log import Group, Log
from validation.files.motion import (
    ENCODERS,
    SENSORS,
    Jumps,
    NewPoses,
    Told,
    Way,
    find_jumps,
    motion_by_sensor,
    new_samples,
    ways_of,
)
from validation.files.signals import centred, explain_share, fresh_poses, refreshed

_WINDOW_S = 1.0
"""Length of the windows over which signals are averaged [s]."""
_STEP_S = 0.5
"""Time between the middles of two windows [s]."""
_LAGS = np.array(sorted(np.arange(-1.5, 1.51, 0.1), key=abs))
"""Delays of a sensor or a command that are tried first [s], the least ones first."""
LONGEST_S = 60.0
"""Longest delay that is looked for [s]."""
OF_SPAN = 0.25
"""Share of a span that its delay is shorter than: of a longer one too little is left to compare."""
_EXPLAINED = 0.8
"""Share of a group that another one explains from which its delay is known [1]."""
_SHORT_S = 60.0
"""Length of a log from which the times above hold [s]; of a shorter one they are parts."""
MOST_WINDOWS = 4000
"""Number of windows that suffices."""
_VARIES = 0.25
"""Deviation of a rate over its mean from which it varies [1]."""
FEWEST_WINDOWS = 20
"""Number of windows from which they say anything of signals."""
_WINDOWED = ("wheels", "odom", "pose", "imu", "cmd")
"""Groups that tell of motion, in the order in which each is brought to the time of the first."""
Means = Mapping[str, FloatArray]
"""(N,) means over windows by column: rates; of x, y and yaw their rates of change, and `heading`,
the yaw itself [rad]. Empty where there are too few windows."""


# -------------------------------------------------------------------------------- the table
@dataclass(frozen=True, eq=False)
class Signals:
    """A log, and what its sensors tell of the motion."""

    log: Log
    radius: float | None = None
    """Radius of the wheels [m]; None where nobody knows it."""

    def without(self, columns: Iterable[str]) -> Signals:
        """Return what the log tells without some columns."""
        return replace(self, log=self.log.without(columns))

    @cached_property
    def poses(self) -> NewPoses | None:
        """The new poses; None without poses."""
        group = self.log.group_of(POSE_COLUMNS)
        if group is None:
            return None
        pose = np.column_stack([group.columns[name] for name in POSE_COLUMNS])
        new = np.flatnonzero(fresh_poses(group.t, pose))
        return NewPoses(group, new, group.t[new], pose[new])

    @cached_property
    def told(self) -> Mapping[str, Told]:
        """The motion by each sensor of rates, in the order of `SENSORS`."""
        told = {}
        for sensor in SENSORS:
            group = self.log.groups.get(sensor)
            if group is None or sensor == "pose":
                continue
            rates = dict(group.columns)
            # where sides are refreshed in turn, a row has a rate that is new and one that is old
            for name in ENCODERS if sensor == "wheels" else ():
                if name in rates:
                    new = refreshed(group.t, rates[name][:, None])
                    rates[name] = np.interp(group.t, group.t[new], rates[name][new])
            speeds, turns = motion_by_sensor(rates)
            if sensor not in turns:
                continue
            known = [part[sensor] for part in (speeds, turns) if sensor in part]
            new = np.ones(len(group.t), dtype=bool)
            if sensor != "cmd":  # a command that is repeated holds on
                new = refreshed(group.t, np.column_stack(known))
            speed = new_samples(new, speeds[sensor]) if sensor in speeds else None
            turn = new_samples(new, turns[sensor])
            told[sensor] = Told(group, new_samples(new, group.t), speed, turn)
        return told

    def as_logged(self, *sensors: str) -> Told | None:
        """Return every row of the first of some sensors that tells speeds and turns; else None."""
        for sensor in sensors:
            group = self.log.groups.get(sensor)
            if group is not None:
                speeds, turns = motion_by_sensor(group.columns)
                if sensor in speeds and sensor in turns:
                    return Told(group, group.t, speeds[sensor], turns[sensor])
        return None

    @cached_property
    def jumps(self) -> Jumps | None:
        """Jumps of the pose; None where there is none, or nothing says how fast the robot was."""
        return find_jumps(self.poses, self.as_logged("wheels", "odom", "cmd"))

    @cached_property
    def ways(self) -> Mapping[str, Way]:
        """The ways of columns of motion: integrals of rates, and x, y and yaw themselves."""
        ways = dict[str, Way]()
        for sensor in SENSORS:
            if sensor in self.log.groups:
                ways |= ways_of(self.log.groups[sensor])
        return ways

    def forget_signals(self) -> None:
        """Let go of what is made again when it is asked for: signals of hours fill the memory."""
        for name in ("poses", "told", "ways"):
            vars(self).pop(name, None)

    @cached_property
    def windows(self) -> Windows:
        """The windows, see `windows_of`."""
        return windows_of(self.log.groups, self.ways)

    @property
    def means(self) -> Means:
        """The means over windows."""
        return self.windows.means

    @cached_property
    def noise(self) -> Mapping[str, float]:
        """Noise of the rates of poses in a window, by column."""
        if self.poses is None or len(self.poses.t) < 8 or not self.means:
            return {}
        width = self.windows.width
        rough = np.median(np.abs(np.diff(self.poses.pose, 3, axis=0)), axis=0) / 3.0
        return dict(zip(POSE_COLUMNS, (1.5 * rough / width).tolist(), strict=True))

    @property
    def turning(self) -> FloatArray | None:
        """(N,) yaw rates by heading, or else by the gyro [rad/s]."""
        return self.means.get("yaw", self.means.get("gyro_z"))

    @property
    def along(self) -> FloatArray | None:
        """(N,) speeds of the pose along its heading [m/s]."""
        return motion_by_sensor(self.means, self.windows.width)[0].get("pose")

    @property
    def wheels(self) -> FloatArray | None:
        """(2, N) rates of left and right wheels [rad/s]."""
        sides = [self.means[name] for name in ENCODERS if name in self.means]
        return np.array(sides) if len(sides) == 2 else None

    def likeness(self) -> list[float]:
        """Return how alike turns and ways by wheels or odometry are to those by pose or gyro.

        These are correlations of their sizes about their means; none where nothing varies.
        """
        speeds, turns = motion_by_sensor(self.means)
        path = None
        if {"x", "y"} <= self.means.keys():
            path = np.hypot(self.means["x"], self.means["y"])  # whatever the heading
        alike = []
        for told, measured in ((turns, self.turning), (speeds, path)):
            a = told.get("wheels", told.get("odom"))
            if a is not None and measured is not None:
                # what hardly varies says nothing about its mean
                least = max(1e-4, _VARIES * abs(float(np.mean(a))))
                if np.std(measured) > 1e-4 and np.std(a) > least:
                    alike.append(centred(np.abs(a), np.abs(measured)))
        return alike


# ------------------------------------------------------------------------------------------ windows
class Windows(NamedTuple):
    """Windows of a log, N of them, in which all groups tell something."""

    t: FloatArray
    """(N,) their middles on the clock of the first group [s]."""
    at: Mapping[str, FloatArray]
    """By group, (N,) the same on its own clock [s]."""
    width: float
    """Their length [s]."""
    means: Means
    """Means of the columns."""

    @property
    def late(self) -> dict[str, float]:
        """By group, how much later it is than most others are [s]."""
        late = {name: float(np.median(at - self.t)) for name, at in self.at.items()}
        middle = len(late) // 2
        return {name: seconds - sorted(late.values())[middle] for name, seconds in late.items()}

    def means_of(
        self, ways: Mapping[str, Way], group: str, late: FloatArray | float = 0.0
    ) -> Means:
        """Return the means of other ways of a group, so much later than the group is [s]."""
        return _window_means(ways, self.at[group] + late, self.width)


_NONE = Windows(np.empty(0), {}, _WINDOW_S, {})


def windows_of(every: Mapping[str, Group], told: Mapping[str, Way]) -> Windows:
    """Return windows on the clock of the first group; none where there are too few.

    Each of the groups is brought to the time of the first. At least two groups must overlap for
    `FEWEST_WINDOWS` outside their gaps.

    Args:
        every: groups by name.
        told: ways of their columns.
    """
    there = [name for name in _WINDOWED if name in every]
    # one side of wheels alone tells neither a way nor a turn
    there.sort(key=lambda name: name == "wheels" and not {*ENCODERS} <= every[name].columns.keys())
    groups = {name: every[name] for name in there}
    if len(groups) < 2:
        return _NONE
    start = max(g.t[0] for g in groups.values())
    stop = min(g.t[-1] for g in groups.values())
    period = min(g.period for g in groups.values())
    unit = max(min(1.0, (stop - start) / _SHORT_S), 2.0 * period / _STEP_S)
    # windows that are moved by the longest lag stay within all groups
    margin = unit * (_WINDOW_S + _LAGS[-1])
    n = math.floor((stop - start - 2.0 * margin) / (unit * _STEP_S))
    if n < FEWEST_WINDOWS:
        return _NONE
    # those of a log of hours lie apart
    middles = start + margin + unit * _STEP_S * np.arange(0, n, math.ceil(n / MOST_WINDOWS))
    n = len(middles)
    means = dict[str, FloatArray]()
    clocks = dict[str, FloatArray]()
    usable = np.ones(n, dtype=bool)
    bases = list[FloatArray]()
    for name, group in groups.items():
        ways = {name: told[name] for name in group.columns if name in told}
        if not ways:
            continue
        at = middles + _find_delay(ways, middles, bases, unit)
        clocks[name] = at
        own = _window_means(ways, at, unit)
        means |= own
        usable &= ~group.in_gaps(at, -0.5 * unit) & (at > group.t[0]) & (at < group.t[-1])
        bases.append(np.column_stack(list(own.values())))
    if np.count_nonzero(usable) < FEWEST_WINDOWS:
        return _NONE
    found = {name: values[usable] for name, values in means.items()}
    kept = {name: stamps[usable] for name, stamps in clocks.items()}
    return Windows(middles[usable], kept, unit, found)


def _window_means(
    ways: Mapping[str, Way], middles: FloatArray, window: float
) -> dict[str, FloatArray]:
    """Return the channels over a `window` [s] around the (N,) middles [s]."""
    low = middles - 0.5 * window
    high = middles + 0.5 * window
    means = {}
    for name, (t, way) in ways.items():
        means[name] = (np.interp(high, t, way) - np.interp(low, t, way)) / window
    if "yaw" in ways:
        means["heading"] = np.interp(middles, *ways["yaw"])
    return means


def _find_delay(
    ways: Mapping[str, Way], middles: FloatArray, bases: Sequence[FloatArray], unit: float
) -> float:
    """Return the delay of a group [s] behind the one of others that tells most of it.

    One of them may tell another motion. A long delay is looked for in steps of a window where a
    short one explains little.
    """
    told = [_group_delay(ways, middles, basis, unit, unit * _LAGS) for basis in bases]
    share, late = max(told, default=(1.0, 0.0))
    if share > _EXPLAINED and abs(late) < 1.45 * unit:  # not the last one of `_LAGS`
        return late
    rates = bases[told.index((share, late))]
    most = min(unit * LONGEST_S, OF_SPAN * float(np.ptp(middles)))
    steps = np.arange(-most, most, unit * _STEP_S)
    about = _group_delay(ways, middles, rates, unit, steps)[1]
    longer = _group_delay(ways, middles, rates, unit, about + unit * _LAGS / 3.0)
    return longer[1] if longer[0] > max(share, _EXPLAINED) else late


def _group_delay(
    ways: Mapping[str, Way],
    middles: FloatArray,
    rates: FloatArray,
    unit: float,
    lags: FloatArray,
) -> tuple[float, float]:
    """Return how much of a group's columns another one explains, and which of some lags [s] does.

    Signs and units do not matter. Columns are explained by the (N, k) rates of another group, their
    squares and that of a speed of positions by the products of these.
    """
    pairs = np.triu_indices(rates.shape[1])
    products = rates[:, pairs[0]] * rates[:, pairs[1]]
    moved = [_window_means(ways, middles + lag, unit) for lag in lags]
    explained = []
    speeds = np.zeros((len(middles), len(lags)))
    for name in moved[0]:
        values = np.column_stack([means[name] for means in moved])
        most = np.percentile(np.abs(values), 98.0)
        values = np.clip(values, -most, most)  # a localiser that jumps tells no motion
        if name in ("x", "y"):
            speeds += values**2
        elif name != "heading":
            # where sides change places, only the square stays the same
            explained.append(explain_share(values, rates, [0])[0])
            explained.append(explain_share(values**2, products, [0])[0])
    if {"x", "y"} <= moved[0].keys():
        explained.append(explain_share(speeds, products, [0])[0])
    # a place without its other coordinate tells nothing
    shares = np.mean(explained or [np.zeros(len(lags))], axis=0)
    best = int(np.argmax(shares))
    return float(shares[best]), float(lags[best])
