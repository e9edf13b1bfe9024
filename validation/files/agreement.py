"""How well the signals of a log agree: one motion, told by several witnesses.

A log tells the yaw rate up to five times, by gyro, heading, odometry, the difference of the wheels
and commands, the speed up to four times, and that a robot does not drive sideways once. Each
witness tells the same motion, times a factor and plus an offset within what robots and sensors do.
What is left over between two of them is judged by their ordinary noise: what they show of their
own, a share of the motion, for wheels slip, and a lateness. `Agreement.costs` has the negative
logarithm of the likelihood of it in each window, of a distribution with long tails.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.files.columns import column_of
from validation.files.motion import ENCODERS, STOCK, motion_by_sensor
from validation.files.sensors import FEWEST_WINDOWS, Means, Signals
from validation.files.signals import correlation, sturdy_fit

UNTOLD = 2.0
"""Cost of a window in which a signal tells nothing: a residual of 2.5 times the noise."""
_FLOOR = 0.03
"""Noise of every witness, over the motion that nine of ten windows stay below [1]."""
_STANDS = {"turn": 0.01, "way": 0.005, "side": 0.005}
"""The same of a robot that stands [rad/s, m/s]."""
_LEVER_M = 0.5
"""Distance of a localiser from the middle of the robot that is nothing unusual [m]."""
_PIVOT_M = 0.3
"""Way of the point about which a robot that skids turns [m]."""
_MOUNT = 0.14
"""Angle between a path and its heading that is nothing unusual [rad]."""
_ROUNDS = 6
_RELATED = 0.5
"""Correlation from which the ratio of two signals tells something."""
_BEYOND = 3.0
"""Cost of each window of a ratio beyond the possible ones by a factor of e."""
_MOST_BEYOND = 2.5
"""Logarithm of a ratio from which a greater one costs no more."""


class _Bounds(NamedTuple):
    """What a witness ordinarily does."""

    columns: tuple[str, ...]
    ratios: tuple[float, float, float]
    """Least, typical and greatest ratio to the true rate."""
    share: float
    """Noise over the rate [1]."""
    late: float
    """Lateness that varies [s]."""
    offset: float = 0.0
    """Greatest offset."""


_TURNS = {
    "imu": _Bounds(("gyro_z",), (0.93, 1.0, 1.07), 0.04, 0.1, 0.025),
    "pose": _Bounds(("yaw",), (0.93, 1.0, 1.07), 0.04, 0.1),
    "odom": _Bounds(("odom_w",), (0.6, 1.0, 4.0), 0.15, 0.2),
    "wheels": _Bounds(ENCODERS, (0.78, 1.89, 7.5), 0.15, 0.2),
    "cmd": _Bounds(("cmd_w",), (0.6, 1.0, 15.0), 0.35, 0.6),
}
"""By sensor, what it does as a witness of the yaw rate.

The difference of the wheels' rates is 2 alpha b / r times the yaw rate, with alpha from 1.3 on
where wheels skid: 6 to 9 where it was measured, whatever the size of the robot, and a stock Husky's
b and r make a yaw rate of it. Commands of turning are not what the body does, nor is the odometry
of wheels that skid."""
_WAYS = {
    "pose": _Bounds(("x", "y"), (0.85, 1.0, 1.18), 0.04, 0.1),
    "odom": _Bounds(("odom_v",), (0.6, 1.0, 1.7), 0.12, 0.2),
    "wheels": _Bounds(ENCODERS, (0.8, 1.0, 1.25), 0.12, 0.2),
    "cmd": _Bounds(("cmd_v",), (0.6, 1.05, 2.7), 0.35, 0.6),
}
"""The same of the forward speed."""
_BOUNDS = {"turn": _TURNS, "way": _WAYS}
_ANY_WHEEL = 0.28, 1.0, 5.4
"""Ratios of wheels where the robot is not known and they are taken for a Husky's."""


_SIDE = frozenset({"x", "y", "yaw", "heading"})


class SignalPair(NamedTuple):
    """Two witnesses of one rate."""

    what: str
    """`turn`, `way` or `side`."""
    a: str
    b: str
    columns: frozenset[str]
    """Columns that tell it."""
    factor: float
    """Ratio of a to b over the typical one, whether possible or not; 1 where a is noise [1]."""
    cost: FloatArray
    """(N,) cost of what is left over in each window; NaN where one tells nothing."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """What the signals tell in windows, and how well that agrees."""

    signals: Signals
    means: Means
    known: Mapping[tuple[str, str, str], SignalPair]
    """Pairs that are as they were."""
    untold: float = UNTOLD
    """Cost of a window in which a signal tells nothing."""

    @classmethod
    def of_log(cls, signals: Signals) -> Agreement:
        """Return what a log tells as it stands."""
        return cls(signals, signals.means, {})

    def but(self, columns: Mapping[str, FloatArray]) -> Agreement:
        """Return the same with other means of some columns; a heading follows its yaw rate."""
        if "yaw" in columns and "heading" not in columns:
            steps = np.nan_to_num(columns["yaw"] - self.means["yaw"])
            turned = np.cumsum(steps * np.gradient(self.signals.windows.t))
            columns = {**columns, "heading": self.means["heading"] + turned}
        changed = {*columns}
        known = {}
        for pair in self.pairs:
            if not changed & pair.columns:
                known[pair.what, pair.a, pair.b] = pair
        return replace(self, means={**self.means, **columns}, known=known)

    @property
    def period(self) -> float:
        """Time between two windows [s]."""
        return 0.5 * self.signals.windows.width

    @cached_property
    def told(self) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """The forward speeds and the yaw rates by sensor."""
        speeds, turns = motion_by_sensor(self.means, self.signals.windows.width)
        for told in (speeds, turns):
            if "cmd" in told:
                told["cmd"] = np.where(self.commanded, told["cmd"], math.nan)
        if "wheels" in speeds:
            radius = self.signals.radius or STOCK.radius
            speeds["wheels"] = speeds["wheels"] * (radius / STOCK.radius)
        return speeds, turns

    @cached_property
    def commanded(self) -> FloatArray:
        """Where commands are not zero: elsewhere a joystick may drive."""
        asked = [self.means[name] for name in ("cmd_v", "cmd_w") if name in self.means]
        return np.any(np.nan_to_num(asked, nan=1.0) != 0.0, axis=0)

    def basis_of(self, name: str) -> FloatArray | None:
        """Return (N, k) rates of which others make a column, each times a factor; None without."""
        parts = []
        for told, bounds in zip(self.told, (_WAYS, _TURNS), strict=True):
            own = column_of(name).group
            rates = [told[sensor] for sensor in bounds if sensor != own and sensor in told]
            if name in ENCODERS or any(name in each.columns for each in bounds.values()):
                if not rates:
                    return None
                parts.append(np.nan_to_num(rates[0]))
        if name in ("x", "y") and "heading" in self.means:
            parts[0] = parts[0] * (np.cos if name == "x" else np.sin)(self.means["heading"])
        return np.column_stack(parts)

    @cached_property
    def pairs(self) -> tuple[SignalPair, ...]:
        """All pairs of witnesses."""
        speeds, turns = self.told
        found = []
        for what, told in (("turn", turns), ("way", speeds)):
            for a, b in combinations([each for each in _BOUNDS[what] if each in told], 2):
                pair = self.known.get((what, a, b))
                found.append(pair or self._compared(what, a, b, told))
        if "pose" in speeds:
            pair = self.known.get(("side", "pose", "pose"))
            found.append(pair or self._sideways(speeds["pose"], turns["pose"]))
        return tuple(found)

    @cached_property
    def costs(self) -> FloatArray:
        """(P, N) costs of all pairs."""
        return np.array([pair.cost for pair in self.pairs])

    def gain_over(self, other: Agreement) -> FloatArray:
        """Return (N,) how much less this costs than another explanation of the same log."""
        theirs = other.costs
        ours = np.where(np.isnan(theirs), 0.0, np.nan_to_num(self.costs, nan=self.untold))
        return np.sum(np.nan_to_num(theirs) - ours, axis=0)

    # -----------------------------------------------------------------------------------------
    def _compared(self, what: str, a: str, b: str, told: Mapping[str, FloatArray]) -> SignalPair:
        one, other = (_BOUNDS[what][each] for each in (a, b))
        columns = frozenset({*one.columns, *other.columns})
        if what == "way" and "pose" in (a, b):
            columns |= {"heading"}
        if what == "way" and self.signals.radius is None:
            # a robot that is not known is taken for a Husky
            one, other = (
                each._replace(ratios=_ANY_WHEEL) if each.columns == ENCODERS else each
                for each in (one, other)
            )
        usual = one.ratios[1] / other.ratios[1]
        low = usual * math.exp(-math.hypot(_reach(one)[0], _reach(other)[1]))
        high = usual * math.exp(math.hypot(_reach(one)[1], _reach(other)[0]))
        both = np.isfinite(told[a]) & np.isfinite(told[b])
        cost = np.full(len(both), math.nan)
        x, y = told[a][both], told[b][both]
        if len(x) < 10:
            return SignalPair(what, a, b, columns, 1.0, cost)
        noise = 0.0
        if "pose" in (a, b):
            noise = self.signals.noise.get("yaw" if what == "turn" else "x", 0.0)
        rim = np.zeros(len(x))
        if what == "way" and a == "pose":
            # a localiser to the side is slower in turns to it
            turn = self.told[1][a][both]
            lever = sturdy_fit(np.column_stack([y, turn]), x)[1]
            x = x - np.clip(lever, -_LEVER_M, _LEVER_M) * turn
            rim = STOCK.half_track * np.abs(turn)
        share = math.hypot(one.share, other.share)
        late = max(one.late, other.late)
        offset = max(one.offset, other.offset)
        alike = correlation(x, y)
        step_x, step_y = np.abs(np.gradient([x, y], self.period, axis=1))

        related = alike > _RELATED

        def fit_factor(factor: float, free: bool) -> tuple[FloatArray, float]:
            """Return the costs with any factor, or one of those that are possible, and the best."""
            c = 0.0
            for _ in range(_ROUNDS):
                possible = min(max(factor, low), high)
                fitted = factor if free else possible
                z = x - c - fitted * y
                size = np.max([np.abs(x), np.abs(fitted * y), rim], axis=0)
                step = np.maximum(step_x, fitted * step_y)
                floor = _FLOOR * _ranked(size, 0.9) + _STANDS[what]
                variance = floor**2 + noise**2 + (share * size) ** 2 + (late * step) ** 2
                costs = np.log1p(z**2 / variance)
                weights = 1.0 / (variance + z**2)
                of_y = float(np.sum(weights * y * y))
                of_x = float(np.sum(weights * (x - c) ** 2))
                if np.sum(weights * (x - c) * y) > 0.0:
                    factor = math.sqrt(of_x / max(of_y, 1e-12))
                c = float(np.sum(weights * (x - fitted * y)) / np.sum(weights))
                c = min(max(c, -offset), offset)
            # a factor beyond the possible ones, as far as it is sure
            error = math.sqrt(2.0 * max(max(alike, _RELATED) ** -2 - 1.0, 0.0) / len(x))
            beyond = max(0.0, abs(math.log(max(factor, 1e-9) / possible)) - 2.0 * error)
            return costs + related * _BEYOND * min(beyond, _MOST_BEYOND), factor

        costs, factor = found = fit_factor(_middle_ratio(x, y), free=related)
        if related and not low < factor < high:
            # it may be that of the greater part of a log, in which one of them stands
            able = fit_factor(usual, free=False)
            costs, factor = min(found, able, key=lambda fit: float(fit[0].sum()))
        cost[both] = costs
        # what noise explains has no ratio
        ratio = max(factor, 1e-9) / usual if related or np.mean(costs) > math.log(2.0) else 1.0
        return SignalPair(what, a, b, columns, ratio, cost)

    def _sideways(self, along: FloatArray, turn: FloatArray) -> SignalPair:
        """Compare the way to the side with none, but for a lever and a small angle."""
        heading = self.means["heading"]
        side = self.means["y"] * np.cos(heading) - self.means["x"] * np.sin(heading)
        cost = np.full(len(side), math.nan)
        known = np.isfinite(side) & np.isfinite(turn)
        u, v, w = side[known], along[known], turn[known]
        if len(u) < 10:
            return SignalPair("side", "pose", "pose", _SIDE, 1.0, cost)
        design = np.column_stack([w, v])
        most = np.array([_LEVER_M, _MOUNT])
        size = np.hypot(u, v)
        noise = self.signals.noise.get("x", 0.0)
        floor = _FLOOR * _ranked(size, 0.9) + _STANDS["side"]
        variance = floor**2 + noise**2 + (0.12 * size) ** 2 + (_PIVOT_M * w) ** 2
        scale = np.sqrt(variance)
        best = sturdy_fit(design / scale[:, None], u / scale)
        z = u - design @ np.clip(best, -most, most)
        cost[known] = np.log1p(z**2 / variance)
        return SignalPair("side", "pose", "pose", _SIDE, 1.0, cost)


def _reach(bounds: _Bounds) -> tuple[float, float]:
    """Return the logarithms of how far a ratio may be below and above the typical one."""
    least, typical, most = bounds.ratios
    return math.log(typical / least), math.log(most / typical)


def columns_of(what: str, sensor: str) -> tuple[str, ...]:
    """Return the columns by which a sensor tells turns or ways."""
    return _BOUNDS[what][sensor].columns


def is_ordinary(what: str, sensor: str, factor: float) -> bool:
    """Return whether a sensor may tell a rate times such a factor of the typical one."""
    below, above = _reach(_BOUNDS[what][sensor])
    return -below < math.log(factor) < above


def fit_factors(basis: FloatArray, values: FloatArray) -> FloatArray:
    """Return the (k,) factors of (N, k) rates that sum up to (N,) values where all are known.

    They are zeros where too little is.
    """
    known = np.isfinite(basis).all(axis=1) & np.isfinite(values)
    if np.count_nonzero(known) < FEWEST_WINDOWS // 2:
        return np.zeros(basis.shape[1])
    return sturdy_fit(basis[known], values[known])


def _ranked(values: FloatArray, share: float) -> float:
    """Return the number below which a share of (N,) numbers lies."""
    return float(np.sort(values)[int(share * (len(values) - 1))])


def _middle_ratio(x: FloatArray, y: FloatArray) -> float:
    """Return the middle ratio of the sizes of two rates where they are large."""
    size = np.abs(y)
    moving = (size >= _ranked(size, 0.6)) & (size > 0.0)
    if not np.any(moving):
        return 1.0
    middle = float(np.median(np.abs(x[moving] / y[moving])))
    # most of a coarse signal's windows may be zero
    return middle or float(np.sum(np.abs(x[moving])) / np.sum(size[moving]))
