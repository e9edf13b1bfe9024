"""Signals of a log that contradict one another: signs, swapped columns, frames and units.

A log tells the yaw rate up to five times, by the difference of the wheels, gyro, heading, odometry
and commands, and the forward speed up to four times, by the mean of the wheels, the way along the
heading, odometry and commands. Where two of them contradict each other, corrections are tried: each
undoes one mistake that loggers make. The correction after which the signals agree best names the
fault; where several do as well, all their columns are named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.types import FloatArray
from validation.files.channels import FEWEST_WINDOWS, RATES, Channels, correlation
from validation.files.log import (
    COMMAND_COLUMNS,
    POSE_COLUMNS,
    UNITS,
    LogFault,
    column_of,
)

_SIMILAR = 0.65
"""Size of a correlation from which two signals tell of the same motion."""
_SURE = 0.8
"""Correlation of signals that surely tell of one motion."""
_UNRELATED_LOSS = 0.3
"""Correlation that a signal lacks, compared with the others, if it tells of no motion."""
_SLIP_LOSS = 0.7
"""Correlation that wheels may lack, compared with the other signals, because they slip."""
_SAME_SHAPE = 0.85
"""The same about their means, from which a command differs from a motion by a factor."""
_SUM = 0.97
"""Correlation of a signal with a sum of others that explains it."""
_CLEARLY = 0.2
"""Logarithm of a factor beyond the possible ones that is no noise."""
_SIDES_DIFFER = 1.5
"""Factor by which one side of wheels may turn the robot more than the other; 1.1 on ice."""
_TOGETHER = 8.0
"""Ratio of the singular values of the sides' rates from which they turn too much together."""
_LEAST_FACTOR = 0.05
"""Logarithm of a factor below which two signals are in one unit."""
_FAR = math.log(3.0)
"""Logarithm of the factor beyond the possible ones from which similar signals contradict."""
_SHARES = 60.0, 85.0
"""Percentiles of ratios of rates: of yaw rates, and of speeds, which wheels that slip lessen."""
_GAIN = 0.5
"""Gain of agreement from which a correction names a fault."""
_GAIN_OF_UNITS = 0.8
"""The same gain of a correction of units, after which signals correlate as before."""
_TIE = 0.1
"""Difference of two gains below which both corrections are as good."""
_MOST_FAULTS = 4
"""Greatest number of mistakes that are corrected one after the other."""
_MOVES = 0.1
"""Rate from which a robot moves [m/s, rad/s]."""
_FROZEN = 0.2
"""Share of the windows with motion from which a column that keeps its value is frozen [1];
localisers stall for less."""
_RADIUS = 0.165
"""Radius of a wheel where nobody says it [m], a Husky's."""
_WHEELS = COMMAND_COLUMNS["wheels"]

_Sources = dict[str, tuple[str, float]]
"""Channels that change: the channel that each is made of, and the factor [1]."""


# ------------------------------------------------------------------------------------------
# mistakes that loggers make
class _Correction(NamedTuple):
    """Change of the columns that undoes one mistake."""

    kind: str
    columns: tuple[str, ...]
    appearance: str
    """Words for the mistake, after `the columns seem to`."""
    sources: _Sources
    rotation: float = 0.0
    """Angle that is added to the heading after that [rad]."""

    def applied(self, signals: Channels) -> dict[str, FloatArray]:
        """Return the channels without the mistake."""
        changed = dict(signals)
        for name, (source, factor) in self.sources.items():
            changed[name] = factor * signals[source]
        if self.rotation:
            changed["heading"] = changed["heading"] + self.rotation
        return changed


def _scaled(factor: float, *names: str) -> _Sources:
    """Return the columns times a factor, and with yaw the heading."""
    sources = {name: (name, factor) for name in names}
    if "yaw" in names:
        sources["heading"] = ("heading", factor)
    return sources


def _corrections() -> Iterator[_Correction]:
    """Yield every correction of signs, places and frames that is tried."""
    left, right = _WHEELS
    yield _Correction("sign", _WHEELS, "have the wrong sign", _scaled(-1.0, *_WHEELS))
    for name in (*RATES, "yaw"):
        yield _Correction("sign", (name,), "have the wrong sign", _scaled(-1.0, name))
    backwards = "be half a turn apart: the robot drives backwards"
    yield _Correction("sign", POSE_COLUMNS, backwards, _scaled(-1.0, "x", "y"))
    for a, b in (_WHEELS, ("x", "y"), COMMAND_COLUMNS["twist"], ("odom_v", "odom_w")):
        yield _Correction("swapped", (a, b), "be swapped", {a: (b, 1.0), b: (a, 1.0)})
    crossed = {left: (right, -1.0), right: (left, -1.0)}
    yield _Correction("swapped", _WHEELS, "be swapped and negative", crossed)
    for mirrored in (("y",), ("x",), ("y", "yaw")):
        what = "have the wrong sign: the frame is left-handed"
        yield _Correction("handedness", mirrored, what, _scaled(-1.0, *mirrored))
    quarter = 0.5 * math.pi
    compass = "turn clockwise from north, as a compass"
    yield _Correction("handedness", ("yaw",), compass, _scaled(-1.0, "yaw"), quarter)
    for turn in (-quarter, quarter):
        what = "be a quarter turn off"
        yield _Correction("handedness", ("yaw",), what, _scaled(1.0, "yaw"), turn)
    for unit in ("min", "ms"):
        slower = {name: (name, 1.0 / UNITS[unit][1]) for name in POSE_COLUMNS}
        yield _Correction("clock", ("t",), f"be in {unit}", slower)


_SCALED: Mapping[tuple[str, ...], float] = {
    _WHEELS: 0.08,
    ("x", "y"): 0.08,
    ("yaw",): 0.03,
    ("gyro_z",): 0.03,
    ("odom_w",): 0.1,
    ("odom_v",): 0.1,
    ("cmd_w",): 0.2,
    ("cmd_v",): 0.12,
}
"""Columns that may be in another unit, together, and how well their factor is known [1]."""


def _scale_corrections(signals: Channels, radius: float | None) -> Iterator[_Correction]:
    """Yield a correction for each of `_SCALED`, by the factor that its surest partner shows."""
    for names in _SCALED:
        told = list(_factors(signals, names, radius))
        if not told or not all(name in signals for name in names):
            continue
        _, factor, partner, what = min(told)
        if abs(math.log(factor)) < _LEAST_FACTOR:
            continue
        verb = "tell" + "s" * (len(names) == 1)
        appearance = f"{verb} {factor:.3g} times the {what} that {partner} say"
        hint, exact = _unit_of(names, factor, radius)
        ways = [each for each in told if each[3] == "way"]
        if names == _WHEELS and exact is None and what == "turn" and ways:
            appearance += f", and {min(ways)[1]:.3g} times the way that {min(ways)[2]} say"
            appearance += f" of wheels of {radius or _RADIUS:.3g} m"
        factor = exact or factor
        yield _Correction("scale", names, f"{appearance}: {hint}", _scaled(1.0 / factor, *names))


def _factors(
    signals: Channels, names: tuple[str, ...], radius: float | None
) -> Iterator[tuple[float, float, str, str]]:
    """Yield how unsure a factor of columns is, the factor, and by what and of what it is told."""
    for measures, what in zip(_measures(signals, radius), ("turn", "way"), strict=True):
        for m, other in permutations(measures, 2):
            if not set(names) <= set(m.columns) or set(names) & set(other.columns):
                continue
            both = np.isfinite(m.values) & np.isfinite(other.values)
            x = m.values[both] / m.typical
            y = other.values[both] / other.typical
            if len(x) < FEWEST_WINDOWS or abs(correlation(x, y)) < _SIMILAR:
                continue
            commands = {*COMMAND_COLUMNS["twist"]}
            clipped = abs(correlation(x - x.mean(), y - y.mean())) < _SAME_SHAPE
            clipped |= _is_clipped(x, y) if commands & {*m.columns} else _is_clipped(y, x)
            if not (clipped and commands & {*m.columns, *other.columns}):
                factor = float(np.linalg.norm(x) / np.linalg.norm(y))
                unsure = math.log(m.most / m.least) + math.log(other.most / other.least)
                yield unsure, factor, " and ".join(other.columns), what


def _is_clipped(command: FloatArray, motion: FloatArray) -> bool:
    """Return whether (N,) commands are often at their bound, where the (N,) motion still varies."""
    size = np.abs(command)
    if not np.any(size):
        return False
    at_bound = size > 0.99 * np.max(size)
    there = np.abs(motion[at_bound])
    return bool(np.mean(at_bound) > 0.2 and np.std(there) > 0.25 * np.mean(there))


def _unit_of(
    names: tuple[str, ...], factor: float, radius: float | None
) -> tuple[str, float | None]:
    """Return the unit that a factor fits to its precision, as no other does, and its own factor.

    Without such a unit, return hints and None.
    """
    precision = _SCALED[names]
    unit = column_of(names[0]).unit
    units = {u: 1.0 / size for u, (base, size) in UNITS.items() if base == unit}
    known = True
    if names == _WHEELS and radius is not None:
        units |= {u: radius / size for u, (base, size) in UNITS.items() if base == "m/s"}
        units["m/s"] = radius
    elif {*_WHEELS, "x"} & {*names} and radius is None:
        known = factor > 10.0 or factor < 0.1
        known &= names != _WHEELS
        precision = 0.3
    away = sorted((abs(math.log(factor / size)), u) for u, size in units.items())
    alone = len(away) < 2 or away[1][0] > 2.0 * precision
    if known and away and away[0][0] < precision and alone:
        seem = "it seems" if len(names) == 1 else "they seem"
        return f"{seem} to be in {away[0][1]}", units[away[0][1]]
    if names != _WHEELS:
        return "is it in another unit?", None
    gear = max(factor, 1.0 / factor)
    than = "" if radius is None else f" than {radius:.3g} m"
    about = float(f"{gear:.1g}")
    return f"ticks, a gear of about {about:g}, or wheels of another radius{than}?", None


# ------------------------------------------------------------------------------------------
# agreement
class _Measure(NamedTuple):
    """One signal of a rate, and the range of its ratio to the true rate [1]."""

    columns: tuple[str, ...]
    values: FloatArray
    """(N,) numbers of the log; NaN where it tells nothing."""
    least: float
    """Smallest possible ratio."""
    typical: float
    """Ratio of most logs."""
    most: float
    """Greatest possible ratio."""


def _measures(signals: Channels, radius: float | None) -> tuple[list[_Measure], list[_Measure]]:
    """Return the measures of the yaw rate and of the forward speed, the surest first.

    The difference of the wheels' rates is 2 alpha b / r times the yaw rate, with alpha from 1.3 on
    where wheels skid: 6 to 9 where it was measured, whatever the size of the robot. Where nobody
    knows the radius, that shows the wheels' unit. Commands of turning are not what the body does,
    nor is the odometry of wheels that skid.
    """
    left, right = _WHEELS
    turning = []
    forward = []
    for name in ("gyro_z", "yaw"):
        if name in signals:
            turning.append(_Measure((name,), signals[name], 0.93, 1.0, 1.07))
    if all(name in signals for name in POSE_COLUMNS):
        heading = signals["heading"]
        along = signals["x"] * np.cos(heading) + signals["y"] * np.sin(heading)
        forward.append(_Measure(("x", "y"), along, 0.85, 1.0, 1.18))
    if "odom_w" in signals:
        turning.append(_Measure(("odom_w",), signals["odom_w"], 0.6, 1.0, 4.0))
    if "odom_v" in signals:
        forward.append(_Measure(("odom_v",), signals["odom_v"], 0.6, 1.0, 1.7))
    if left in signals and right in signals:
        least = 3.2 if radius is None else 2.0
        turning.append(_Measure(_WHEELS, signals[right] - signals[left], least, 6.3, 25.0))
        around = (1.7, 1.0 / _RADIUS, 33.0)
        if radius is not None:
            around = (0.75 / radius, 1.0 / radius, 1.25 / radius)
        forward.append(_Measure(_WHEELS, 0.5 * (signals[left] + signals[right]), *around))
    # where both commands are zero, a joystick may drive
    commands = [signals[n] != 0.0 for n in COMMAND_COLUMNS["twist"] if n in signals]
    commanded = np.any(commands, axis=0)
    if "cmd_w" in signals:
        yaw_rate = np.where(commanded, signals["cmd_w"], math.nan)
        turning.append(_Measure(("cmd_w",), yaw_rate, 0.6, 2.3, 15.0))
    if "cmd_v" in signals:
        speed = np.where(commanded, signals["cmd_v"], math.nan)
        driven = [m.values[commanded] for m in forward]
        clipped = any(_is_clipped(speed[commanded], motion) for motion in driven)
        least = 0.02 if clipped else 0.6
        forward.append(_Measure(("cmd_v",), speed, least, 1.05, 2.7))
    return turning, forward


def _agreement(signals: Channels, radius: float | None) -> float:
    """Return how well the signals agree: over all pairs, the sum of 1 if they do and -1 if not."""
    total = 0.0
    for measures, percent in zip(_measures(signals, radius), _SHARES, strict=True):
        for a, b in combinations(measures, 2):
            total += _agree(a, b, percent)
    if all(name in signals for name in POSE_COLUMNS):
        total += _alignment(signals["x"] + 1j * signals["y"], signals["heading"])
    return total


def _alignment(way: NDArray[np.complex128], heading: FloatArray) -> float:
    """Return how well displacements, x + iy, keep their angle to headings.

    It is 1 if they do, and 0 if they turn against them.
    """
    size = max(float(np.sum(np.abs(way))), 1e-12)
    # squared, a displacement is the same for both ways of driving
    doubled = way**2 / np.maximum(np.abs(way), 1e-12)
    along = abs(complex(np.sum(doubled * np.exp(-2j * heading))) / size)
    mirrored = abs(complex(np.sum(doubled * np.exp(2j * heading))) / size)
    return along if max(along, mirrored) > _SIMILAR else 0.0


def _percentile(values: FloatArray, percent: float) -> float:
    """Return a percentile of (N,) finite numbers, linear between ranks."""
    # numpy's own takes ten times as long for so few
    n = len(values)
    return float(np.interp(0.01 * percent * (n - 1), np.arange(n), np.sort(values)))


def _compared(a: _Measure, b: _Measure, percent: float) -> tuple[float, float, float]:
    """Return how two measures of one rate compare, zeros where there is too little of them.

    These are their correlation, the logarithm of a percentile of their ratio, and by how much that
    lies outside the possible range.
    """
    both = np.isfinite(a.values) & np.isfinite(b.values)
    x = a.values[both]
    y = b.values[both]
    alike = correlation(x, y)
    if abs(alike) < _SIMILAR or len(x) < FEWEST_WINDOWS:
        return 0.0, 0.0, 0.0
    size = np.abs(y)
    moving = (size >= _percentile(size, 60.0)) & (size > 0.0)
    ratios = np.abs(x[moving] / y[moving])
    ratio = math.log(max(_percentile(ratios, percent), 1e-9))
    below = math.log(a.least / b.most) - ratio
    above = ratio - math.log(a.most / b.least)
    return alike, ratio, max(0.0, below, above)


def _agree(a: _Measure, b: _Measure, percent: float) -> float:
    """Return how well two measures of one rate agree.

    That is their correlation, less 1 if this percentile of their ratio is impossible.
    """
    alike, ratio, beyond = _compared(a, b, percent)
    if not alike:
        return 0.0
    # so that of several units the most usual one is taken
    unusual = abs(ratio - math.log(a.typical / b.typical))
    impossible = 0.0
    # units change no correlation
    if abs(alike) > _SURE or beyond > _FAR:
        impossible = min(1.0, 20.0 * beyond)
    return alike - impossible - 0.02 * min(5.0, unusual)


# ------------------------------------------------------------------------------------------
# faults
def contradictions(signals: Channels, radius: float | None = None) -> list[LogFault]:
    """Return the faults of signs, places, frames and units that the channels of a log show.

    `radius` is that of the wheels [m]; None where nobody knows it, as then their unit shows in how
    they turn alone.
    """
    faults = list(_unlike_sides(signals))
    if faults:
        signals = {name: values for name, values in signals.items() if name not in _WHEELS}
    for _ in range(_MOST_FAULTS):
        corrections = _best_corrections(signals, radius)
        if not corrections:
            break
        best = corrections[0]
        signals = best.applied(signals)
        columns = tuple(dict.fromkeys(chain.from_iterable(c.columns for c in corrections)))
        words = ", or ".join(map(_words, corrections))
        sentence = f"{words}; as it stands, the log contradicts itself"
        faults.append(LogFault(best.kind, columns, sentence))
    return [*faults, *_unrelated(signals, radius)]


def _best_corrections(signals: Channels, radius: float | None) -> list[_Correction]:
    """Return the corrections that name a fault: the best, and others that are as good.

    There is one for each set of columns, and none where no correction gains enough.
    """
    now = _agreement(signals, radius)
    corrected = []
    for correction in (*_corrections(), *_scale_corrections(signals, radius)):
        if not all(name in signals for name in correction.sources):
            continue
        gain = _agreement(correction.applied(signals), radius) - now
        least = _GAIN_OF_UNITS if correction.kind in ("scale", "clock") else _GAIN
        if gain > least:
            corrected.append((gain, correction))
    corrected.sort(key=lambda pair: -pair[0])
    # reversed, so that the best of each columns stays
    good = {c.columns: c for gain, c in reversed(corrected) if gain > corrected[0][0] - _TIE}
    return list(reversed(good.values()))


def _unrelated(signals: Channels, radius: float | None) -> Iterator[LogFault]:
    """Yield a fault for each signal that resembles no other, or differs from it in size."""
    for measures, percent in zip(_measures(signals, radius), _SHARES, strict=True):
        measured = [m for m in measures if not set(m.columns) <= set(COMMAND_COLUMNS["twist"])]
        for m in measured:
            others = [o.values for o in measured if o is not m]
            sure = min((correlation(a, b) for a, b in combinations(others, 2)), default=0.0)
            if sure <= _SURE or not np.any(m.values):
                continue
            loss = _SLIP_LOSS if m.columns == _WHEELS else _UNRELATED_LOSS
            if all(abs(correlation(m.values, o)) < sure - loss for o in others):
                sentence = (
                    f"{_seem(m.columns)} to be another axis or quantity: "
                    "the other columns resemble one another, and not this"
                )
                yield LogFault("swapped", m.columns, sentence)
        for a, b in combinations(measured, 2):
            alike, ratio, beyond = _compared(a, b, percent)
            if abs(alike) <= _SURE or beyond <= _CLEARLY:
                continue
            if max(_percentile(np.abs(m.values) / m.typical, 60.0) for m in (a, b)) <= _MOVES:
                continue
            factor = math.exp(ratio) * b.typical / a.typical
            one, other = (" and ".join(m.columns) for m in (a, b))
            sentence = (
                f"the motion by {one} is {factor:.2g} times that by {other}: "
                "one of them, or t, is in another unit"
            )
            yield LogFault("scale", (*a.columns, *b.columns), sentence)


def _unlike_sides(signals: Channels) -> Iterator[LogFault]:
    """Yield a fault if the wheels of one side count for much more in how the robot turns."""
    turning = next((signals[name] for name in ("yaw", "gyro_z") if name in signals), None)
    if turning is None or not set(_WHEELS) <= set(signals):
        return
    rates = np.column_stack([signals[name] for name in _WHEELS])
    sizes = np.linalg.norm(rates, axis=0)
    if not np.all(sizes):
        return
    rates = rates / sizes
    (left, right), _, _, (most, least) = np.linalg.lstsq(rates, turning)
    explained = correlation(rates @ (left, right), turning) > _SUM
    if not explained or least * _TOGETHER <= most or not left < 0.0 < right:
        return
    ratio = -left / right * sizes[1] / sizes[0]
    if not 1.0 / _SIDES_DIFFER < ratio < _SIDES_DIFFER:
        sentence = (
            f"a rate of enc_left turns the robot {ratio:.2g} times as much as one of enc_right: "
            "one of them is in another unit, or loses samples"
        )
        yield LogFault("scale", _WHEELS, sentence)


def _words(c: _Correction) -> str:
    if c.kind == "scale":
        return f"{' and '.join(c.columns)} {c.appearance}"
    return f"{_seem(c.columns)} to {c.appearance}"


def _seem(columns: Sequence[str]) -> str:
    return f"{' and '.join(columns)} seem{'s' * (len(columns) == 1)}"


def frozen(signals: Channels) -> Iterator[LogFault]:
    """Yield a fault if columns keep their value for long while others say that the robot moves."""
    turning, forward = _measures(signals, None)
    shares = {}
    for name, rate in signals.items():
        if name not in (*POSE_COLUMNS, "gyro_z", *_WHEELS):
            continue
        measures = [*turning, *forward]
        if name in ("yaw", "gyro_z"):
            measures = turning
        elif name in ("x", "y"):
            measures = forward
        others = [np.nan_to_num(m.values) / m.typical for m in measures if name not in m.columns]
        if not others:
            continue
        moves = np.median(np.abs(others), axis=0) > _MOVES
        if name in POSE_COLUMNS:
            kept = moves & (rate == 0.0)
        else:  # a rate may stay the same where the others do
            varies = np.median(_changes(others), axis=0) > 0.3 * _MOVES
            moves &= varies | (rate == 0.0)
            kept = moves & (_changes(rate) < 1e-12)
        if name in _WHEELS:
            # where both sides are kept, they may be set points, or the robot stands and its
            # localiser does not
            other = signals.get(_WHEELS[name == _WHEELS[0]], rate)
            kept &= _changes(other) > 1e-12
        n = np.count_nonzero(kept)
        moving = np.count_nonzero(moves)
        if n > max(FEWEST_WINDOWS // 4, _FROZEN * moving):
            shares[name] = 100.0 * n / moving
    if shares:
        words = ", ".join(f"{name} for {share:.0f} %" for name, share in shares.items())
        what = f"the same value in much of the time in which the robot moves: {words}"
        yield LogFault("frozen", tuple(shares), what)


def _changes(values: ArrayLike) -> FloatArray:
    """Return the sizes of the steps of (..., N) numbers; NaN for the first."""
    return np.abs(np.diff(values, prepend=math.nan))
