"""Signals of a log that contradict one another: signs, swapped columns, frames and units.

A log tells the yaw rate up to five times, by the difference of the wheels, gyro, heading, odometry
and commands, and the forward speed up to four times, by the mean of the wheels, the way along the
heading, odometry and commands. Two that tell of one motion have the same sign, and a ratio within
what robots can do. Where signs contradict each other, corrections are tried: each undoes one
mistake that loggers make, and the one after which the signals agree best names the fault.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.files.columns import POSE_COLUMNS, UNITS, column_of
from validation.files.log import LogFault
from validation.files.motion import ENCODERS, RATES, STOCK, TWIST, motion_by_sensor
from validation.files.sensors import FEWEST_WINDOWS, Means, Signals
from validation.files.signals import centred, correlation

_SIMILAR = 0.65
"""Size of a correlation from which two signals tell of the same motion."""
_SURE = 0.8
"""Correlation of signals that surely tell of one motion."""
_UNRELATED_LOSS = 0.3
"""Correlation that a signal lacks, compared with the others, if it tells of no motion."""
_SLIP_LOSS = 0.7
"""Correlation that wheels may lack, compared with the other signals, because they slip."""
_CLEARLY = 0.05
"""Logarithm of a factor beyond the possible ones that is no noise."""
_FAR = math.log(5.0)
"""The same of signals that are only similar."""
_GAIN = 0.5
"""Gain of agreement from which a correction names a fault."""
_TIE = 0.1
"""Difference of two gains below which both corrections are as good."""
_TIE_OF_UNITS = 0.03
"""The same of two votes for the columns that are in another unit."""
MOVES = 0.1
"""Rate from which a robot moves [m/s, rad/s]."""


# ------------------------------------------------------------------------------------------
# what tells a rate
class RateMeasure(NamedTuple):
    """One signal of a rate, and the range of its ratio to the true rate [1]."""

    columns: tuple[str, ...]
    values: FloatArray
    """(N,) rates; NaN where it tells nothing."""
    least: float
    """Smallest possible ratio."""
    typical: float
    """Ratio of most logs."""
    most: float
    """Greatest possible ratio."""


_Ranges = Mapping[str, tuple[tuple[str, ...], float, float, float]]
_TURNS: _Ranges = {
    "imu": (("gyro_z",), 0.93, 1.0, 1.07),
    "pose": (("yaw",), 0.93, 1.0, 1.07),
    "odom": (("odom_w",), 0.6, 1.0, 4.0),
    "wheels": (ENCODERS, 0.78, 1.89, 7.5),
    "cmd": (("cmd_w",), 0.6, 2.3, 15.0),
}
"""By sensor, the columns that tell the yaw rate, and the least, the typical and the greatest ratio
to it.

The difference of the wheels' rates is 2 alpha b / r times the yaw rate, with alpha from 1.3 on
where wheels skid: 6 to 9 where it was measured, whatever the size of the robot, and a stock Husky's
b and r make a yaw rate of it. Commands of turning are not what the body does, nor is the odometry
of wheels that skid."""
_WAYS: _Ranges = {
    "pose": (("x", "y"), 0.85, 1.0, 1.18),
    "odom": (("odom_v",), 0.6, 1.0, 1.7),
    "wheels": (ENCODERS, 0.75, 1.0, 1.25),
    "cmd": (("cmd_v",), 0.6, 1.05, 2.7),
}
"""The same of the forward speed."""
_WAYS_OF_ANY: _Ranges = {**_WAYS, "wheels": (ENCODERS, 0.28, 1.0, 5.4)}
"""These ranges hold where the robot is not known and its wheels are taken for a Husky's."""


def measures(means: Means, radius: float | None) -> tuple[list[RateMeasure], list[RateMeasure]]:
    """Return the measures of the yaw rate and of the forward speed."""
    speeds, turns = motion_by_sensor(means)
    # where both commands are zero, a joystick may drive
    commanded = np.any([told["cmd"] != 0.0 for told in (speeds, turns) if "cmd" in told], axis=0)
    for told in (speeds, turns):
        if "cmd" in told:
            told["cmd"] = np.where(commanded, told["cmd"], math.nan)
    if radius is not None and "wheels" in speeds:
        speeds["wheels"] = speeds["wheels"] * (radius / STOCK.radius)
    found = []
    for told, ranges in ((turns, _TURNS), (speeds, _WAYS if radius else _WAYS_OF_ANY)):
        measured = []
        for sensor, (columns, *ratios) in ranges.items():
            if sensor in told:
                measured.append(RateMeasure(columns, told[sensor], *ratios))
        found.append(measured)
    return found[0], found[1]


class _Pair(NamedTuple):
    """How two measures of one rate compare."""

    a: RateMeasure
    b: RateMeasure
    alike: float
    """Their correlation about zero."""
    sure: float
    """How sure it is that only a factor lies between them [1]."""
    factor: float
    """Their ratio, over the typical one."""
    beyond: float
    """Logarithm of the factor by which a high percentile of it is outside the possible range."""

    @property
    def is_bad(self) -> bool:
        """True if one of them is in another unit."""
        return self.beyond > (_CLEARLY if self.sure > _SURE else _FAR)


def _pairs(told: Sequence[RateMeasure], share: float) -> list[_Pair]:
    """Return the pairs that tell of one motion; `share` says which percentile of ratios counts."""
    pairs = []
    for a, b in combinations(told, 2):
        both = np.isfinite(a.values) & np.isfinite(b.values)
        x = a.values[both]
        y = b.values[both]
        alike = correlation(x, y)
        if abs(alike) > _SIMILAR and len(x) >= FEWEST_WINDOWS:
            moving = (np.abs(y) >= ranked(np.abs(y), 0.6)) & (y != 0.0)
            ratio = max(ranked(np.abs(x[moving] / y[moving]), share), 1e-9)
            beyond = max(a.least / b.most / ratio, ratio / (a.most / b.least), 1.0)
            factor = float(np.linalg.norm(x) / np.linalg.norm(y)) * b.typical / a.typical
            sure = abs(alike)
            if {*TWIST} & {*b.columns}:  # commands stand last
                sure = abs(centred(x, y))
                beyond = 1.0 if _is_clipped(y, x) else beyond
            pairs.append(_Pair(a, b, alike, sure, factor, math.log(beyond)))
    return pairs


def _is_clipped(command: FloatArray, motion: FloatArray) -> bool:
    """Return whether commands are often at their bound, where the motion still varies."""
    at_bound = np.abs(command) > 0.99 * np.max(np.abs(command))
    there = np.abs(motion[at_bound])
    return bool(np.mean(at_bound) > 0.2 and np.std(there) > 0.25 * np.mean(there))


def ranked(values: FloatArray, share: float) -> float:
    """Return the number below which a share of (N,) numbers lies."""
    # numpy's quantile takes ten times as long for so few
    return float(np.sort(values)[int(share * (len(values) - 1))])


_SHARES = 0.6, 0.85
"""Shares of ratios of rates: of yaw rates, and of speeds, which wheels that slip lessen."""


# ------------------------------------------------------------------------------------------
# signs, places and frames
class _Correction(NamedTuple):
    """Change of the columns that undoes one mistake."""

    kind: str
    columns: tuple[str, ...]
    words: str
    """Words for the mistake, after the columns' names."""
    sources: Mapping[str, tuple[str, float]]
    """Columns that change: the column that each is made of, and the factor [1]."""
    rotation: float = 0.0
    """Angle that is added to the heading after that [rad]."""

    def applied(self, means: Means) -> Means:
        """Return the means without the mistake."""
        changed = dict(means)
        for name, (source, factor) in self.sources.items():
            changed[name] = factor * means[source]
        if "yaw" in self.sources:
            changed["heading"] = self.sources["yaw"][1] * changed["heading"] + self.rotation
        return changed


def _negated(*names: str) -> Mapping[str, tuple[str, float]]:
    return {name: (name, -1.0) for name in names}


def _corrections() -> Iterator[_Correction]:
    """Yield every correction that is tried."""
    left, right = ENCODERS
    negative = "to have the wrong sign"
    for names in (ENCODERS, *((name,) for name in (*RATES, "yaw"))):
        yield _Correction("sign", names, negative, _negated(*names))
    backwards = "to be half a turn apart: the robot drives backwards"
    yield _Correction("sign", POSE_COLUMNS, backwards, _negated("x", "y"))
    for a, b in (ENCODERS, ("x", "y"), TWIST, ("odom_v", "odom_w")):
        yield _Correction("swapped", (a, b), "to be swapped", {a: (b, 1.0), b: (a, 1.0)})
    crossed = {left: (right, -1.0), right: (left, -1.0)}
    yield _Correction("swapped", ENCODERS, "to be swapped and negative", crossed)
    for names in (("y",), ("x",), ("y", "yaw")):
        what = f"{negative}: the frame is left-handed"
        yield _Correction("handedness", names, what, _negated(*names))
    quarter = 0.5 * math.pi
    off = "to be a quarter turn off"
    compass = "to turn clockwise from north, as a compass"
    for sign, turn, what in ((-1.0, quarter, compass), (1.0, -quarter, off), (1.0, quarter, off)):
        yield _Correction("handedness", ("yaw",), what, {"yaw": ("yaw", sign)}, turn)


def _sum_of_correlations(means: Means) -> float:
    """Return how well signs and frames agree: over all pairs, the sum of their correlations."""
    total = 0.0
    for told, share in zip(measures(means, None), _SHARES, strict=True):
        total += sum(pair.alike for pair in _pairs(told, share))
    if {*POSE_COLUMNS} <= means.keys():
        step = means["x"] + 1j * means["y"]
        along = abs(angle_between(step, means["heading"]))
        mirrored = abs(angle_between(step, -means["heading"]))
        total += along if max(along, mirrored) > _SIMILAR else 0.0
    return total


def angle_between(step: NDArray[np.complex128], heading: FloatArray | float) -> complex:
    """Return twice the angle of (N,) displacements x + iy to headings, as a complex number.

    Its size is 1 if they keep that angle, and 0 if they turn against them. Doubled, the angle is
    the same for both ways of driving.
    """
    size = np.maximum(np.abs(step), 1e-12)
    return complex(np.sum(step**2 / size * np.exp(-2j * np.asarray(heading))) / np.sum(size))


def contradictions(e: Signals) -> Iterator[LogFault]:
    """Signs, places and frames with which the signals contradict each other."""
    now = _sum_of_correlations(e.means)
    gains = []
    for correction in _corrections():
        if correction.sources.keys() <= e.means.keys():
            gain = _sum_of_correlations(correction.applied(e.means)) - now
            if gain > _GAIN:
                gains.append((gain, correction))
    gains.sort(key=lambda pair: -pair[0])
    # the best one of each columns, and others that are as good
    good = dict[tuple[str, ...], _Correction]()
    for gain, correction in gains:
        if gain > gains[0][0] - _TIE:
            good.setdefault(correction.columns, correction)
    if good:
        seem = [f"{_seem(names)} {c.words}" for names, c in good.items()]
        sentence = f"{', or '.join(seem)}; as it stands, the log contradicts itself"
        columns = tuple(dict.fromkeys(chain(*good)))
        yield LogFault(gains[0][1].kind, columns, sentence)


def _seem(names: Sequence[str]) -> str:
    """Return the subject and the verb of a sentence on columns."""
    return f"{' and '.join(names)} seem{'s' * (len(names) == 1)}"


def other_axis(e: Signals) -> Iterator[LogFault]:
    """A signal that resembles no other, while the others resemble one another."""
    for told in measures(e.means, e.radius):
        measured = [m for m in told if not {*m.columns} <= {*TWIST} and np.any(m.values)]
        pairs = _pairs(measured, 0.5)
        paired = {*chain(*((pair.a.columns, pair.b.columns) for pair in pairs))}
        # wheels may slip
        alone = {m.columns for m in measured} - paired - {ENCODERS}
        if len(alone) == 1 and pairs and min(pair.alike for pair in pairs) > _SURE:
            (names,) = alone
            sentence = (
                f"{_seem(names)} to be another axis or quantity: "
                "the other columns resemble one another, and not this"
            )
            yield LogFault("swapped", names, sentence)


# ------------------------------------------------------------------------------------------
# units
_PRECISIONS: Mapping[tuple[str, ...], float] = {
    ENCODERS: 0.08,
    ("x", "y"): 0.08,
    ("yaw",): 0.03,
    ("gyro_z",): 0.03,
    ("odom_w",): 0.1,
    ("odom_v",): 0.1,
    ("cmd_w",): 0.2,
    ("cmd_v",): 0.12,
}
"""How well the factor of columns that are in another unit is known [1]."""


def units(e: Signals) -> Iterator[LogFault]:
    """Units of columns that tell the yaw rate, or else the speed."""
    turning, forward = measures(e.means, e.radius)
    pairs = {"turn": _pairs(turning, _SHARES[0]), "way": _pairs(forward, _SHARES[1])}
    for what, some in pairs.items():
        blamed = _blamed(some)
        if blamed:
            words = ", or ".join(_words(names, what, pairs, e.radius) for names in blamed)
            sentence = f"{words}; as it stands, the log contradicts itself"
            yield LogFault("scale", tuple(chain(*blamed)), sentence)
            return


def _blamed(pairs: Sequence[_Pair]) -> list[tuple[str, ...]]:
    """Return those columns that most of the bad pairs have in common."""
    votes = Counter[tuple[str, ...]]()
    for pair in pairs:
        # of two, the one that differs more from the others as well
        vote = (1.0 if pair.is_bad else -1.0) + 0.1 * abs(math.log(pair.factor))
        votes.update({pair.a.columns: vote, pair.b.columns: vote})
    bad = [(pair.a.columns, pair.b.columns) for pair in pairs if pair.is_bad]
    accused = dict.fromkeys(chain(*bad))
    worst = max((votes[names] for names in accused), default=0.0)
    return [names for names in accused if votes[names] > worst - _TIE_OF_UNITS]


def _words(
    names: tuple[str, ...], what: str, pairs: Mapping[str, list[_Pair]], radius: float | None
) -> str:
    """Return words for the factor of columns, and for the unit that they may be in."""
    factor, by = min(_told(names, pairs[what]))[1:]
    tell = "tells" if len(names) == 1 else "tell"
    words = f"{' and '.join(names)} {tell} {factor:.3g} times the {what} that {by} say"
    unit = _fitting_unit(names, factor, radius)
    if unit or names != ENCODERS:
        return f"{words}: {f'it seems to be in {unit}' if unit else 'is it in another unit?'}"
    factors = [factor]
    ways = list(_told(names, pairs["way"]))
    if what == "turn" and ways:
        factor, by = min(ways)[1:]
        factors.append(factor)
        words += f", and {factor:.3g} times the way that {by} say"
    gears = sorted({float(f"{max(factor, 1.0 / factor):.1g}") for factor in factors})
    gear = " to ".join(f"{gear:g}" for gear in gears)
    wheel = f"wheels of another radius than {radius or STOCK.radius:.3g} m"
    if ways:
        wheel += f" (cured by a wheel_radius_multiplier of {1.0 / factor:.3g})"
    return f"{words}: ticks, a gear of about {gear}, or {wheel}?"


def _told(names: tuple[str, ...], pairs: Sequence[_Pair]) -> Iterator[tuple[float, float, str]]:
    """Yield how unsure a factor of columns is, the factor, and by which columns it is told."""
    for a, b, _, _, factor, _ in pairs:
        for m, other, size in ((a, b, factor), (b, a, 1.0 / factor)):
            if m.columns == names:
                yield other.most / other.least, size, " and ".join(other.columns)


def _fitting_unit(names: tuple[str, ...], factor: float, radius: float | None) -> str:
    """Return the unit that a factor fits to its precision, as no other does; nothing for none."""
    precision = _PRECISIONS[names]
    base = column_of(names[0]).unit
    units = {unit: 1.0 / size for unit, (of, size) in UNITS.items() if of == base}
    if names == ENCODERS and radius is not None:
        units |= {unit: radius / size for unit, (of, size) in UNITS.items() if of == "m/s"}
        units["m/s"] = radius
    elif names == ENCODERS or (radius is None and "x" in names and 0.1 <= factor <= 10.0):
        return ""
    elif "x" in names and radius is None:
        precision = 0.3  # it is told by wheels of some size
    away = sorted((abs(math.log(factor / size)), unit) for unit, size in units.items())
    alone = len(away) < 2 or away[1][0] > 2.0 * precision
    return away[0][1] if away and away[0][0] < precision and alone else ""
