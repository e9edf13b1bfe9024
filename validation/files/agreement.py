"""Signals of a log that contradict one another: wrong signs, swapped columns, left-handed frames and wrong units.

A log tells the yaw rate up to five times, by the difference of the wheels, gyro, heading, odometry
and commands, and the forward speed up to four times, by the mean of the wheels, the way along the
heading, odometry and commands. Where two of them contradict each other, corrections are tried: each
undoes one mistake that loggers make. The correction after which the signals agree best names the
fault; where several do as well, all their columns are named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr.geometry import integral
from ssmr.types import FloatArray
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, UNITS, Group, Log
from validation.files.signals import fresh_poses, refreshed

_WINDOW_S = 1.0
_STEP_S = 0.5
"""Length of the windows over which signals are averaged, and time between the middles of two
[s]."""
_LAGS = np.arange(-1.5, 1.51, 0.1)
"""Delays of a sensor or a command that are tried [s]."""
# length of a log from which the times above hold [s]; of a shorter one they are parts
_SHORT_S = 60.0
_FEWEST = 20
_MOST = 4000
"""Number of windows that say anything of signals, and number of them that suffices."""
_ALIKE = 0.65
"""Size of a correlation from which two signals tell of the same motion."""
_SURE = 0.8
_LESS_ALIKE = 0.3
_SLIPS = 0.7
"""Correlation of signals that surely tell of one motion, and how much less a signal has that tells
of none, or wheels that slip."""
_SAME = 0.9
_SUM = 0.97
_CLEARLY = 0.2
"""Correlations of signals that differ by noise alone, and of one with a sum of others; and the
logarithm of a factor beyond what can be that is no noise."""
_SIDES_DIFFER = 1.5
_TOGETHER = 8.0
"""Factor by which one side of wheels may count for more than the other in how the robot turns, 1.1
on ice; and ratio of the singular values of their rates from which they turn together too much to
tell."""
_MOST_LAG = 120
_CLOCKS_GAIN = 0.1
"""Longest difference of two clocks that is looked for, in steps, and what correlation must gain by
it [1]."""
_FAR = math.log(3.0)
"""Logarithm of the factor beyond what can be from which signals contradict each other that are only
alike, as on ice."""
_SHARES = 60.0, 85.0
"""Percentiles of ratios of rates: of yaw rates, and of speeds, which wheels that slip make smaller,
as on ice."""
_GAIN = 0.5
_GAIN_OF_UNITS = 0.8
"""Gains of agreement from which a correction names a fault: of signals that were unlike, and of one
in another unit."""
_TIE = 0.1  # difference of two gains below which both corrections are as good
_MOST_FAULTS = 4
_MOVES = 0.1  # rate from which a robot moves [m/s, rad/s]
_FROZEN = 0.2
"""Share of the windows with motion from which a column that keeps its value is frozen [1];
localisers stall for less."""
_RADIUS = 0.165  # radius of a wheel where nobody says it [m], a Husky's
_RATES = (*COMMAND_COLUMNS["wheels"], "odom_v", "odom_w", "gyro_z", *COMMAND_COLUMNS["twist"])

Channels = Mapping[str, FloatArray]
"""(N,) means over windows by column: rates; of x, y and yaw their rates of change, and `heading`,
the yaw itself [rad]."""


@dataclass(frozen=True)
class LogFault:
    """Something in a log that is not what the names of its columns say."""

    kind: str
    """`sign`, `swapped`, `scale`, `handedness`, `frozen` or `clock`."""
    columns: tuple[str, ...]
    """Columns that it is in, or may be in."""
    sentence: str
    """Sentence that says what is wrong."""


# ------------------------------------------------------------------------------------------
# mistakes that loggers make
class _Correction(NamedTuple):
    """Change of the columns that undoes one mistake."""

    kind: str
    columns: tuple[str, ...]
    what: str
    """Words that say what the columns seem to do or be."""
    sources: Mapping[str, tuple[str, float]]
    """Channels that change: the channel that each is made of, and the factor [1]."""
    turned: float = 0.0
    """Angle that is added to the heading after that [rad]."""

    def applied(self, signals: Channels) -> dict[str, FloatArray]:
        """Return the channels without the mistake."""
        changed = {
            name: factor * signals[source] for name, (source, factor) in self.sources.items()
        }
        if self.turned:
            changed["heading"] = changed["heading"] + self.turned
        return {**signals, **changed}


def _times(factor: float, *names: str) -> dict[str, tuple[str, float]]:
    """Return the columns times a factor, and with yaw the heading."""
    return {name: (name, factor) for name in (*names, *(("heading",) if "yaw" in names else ()))}


def _corrections(radius: float) -> Iterator[_Correction]:
    left, right = wheels = COMMAND_COLUMNS["wheels"]
    for signed in (wheels, *((name,) for name in (*_RATES, "yaw"))):
        yield _Correction("sign", signed, "have the wrong sign", _times(-1.0, *signed))
    yield _Correction(
        "sign",
        POSE_COLUMNS,
        "be half a turn apart: the robot drives backwards",
        _times(-1.0, "x", "y"),
    )
    for a, b in (wheels, ("x", "y"), COMMAND_COLUMNS["twist"], ("odom_v", "odom_w")):
        yield _Correction("swapped", (a, b), "be swapped", {a: (b, 1.0), b: (a, 1.0)})
    yield _Correction(
        "swapped", wheels, "be swapped and negative", {left: (right, -1.0), right: (left, -1.0)}
    )
    for mirrored in (("y",), ("x",), ("y", "yaw")):
        what = "have the wrong sign: the frame is left-handed"
        yield _Correction("handedness", mirrored, what, _times(-1.0, *mirrored))
    quarter = 0.5 * math.pi
    yield _Correction(
        "handedness",
        ("yaw",),
        "turn clockwise from north, as a compass",
        _times(-1.0, "yaw"),
        quarter,
    )
    for turned in (-quarter, quarter):
        yield _Correction(
            "handedness", ("yaw",), "be a quarter turn off", _times(1.0, "yaw"), turned
        )
    rates, speeds, ways, angles = (
        {unit: factor for unit, (base, factor) in UNITS.items() if base == wanted}
        for wanted in ("rad/s", "m/s", "m", "rad")
    )
    rims = {**{unit: factor / radius for unit, factor in {"m/s": 1.0, **speeds}.items()}, **rates}
    del rims["m/min"]  # nobody logs it, and of a Husky it is rpm within 4 %
    units: dict[tuple[str, ...], dict[str, float]] = {
        **dict.fromkeys((wheels, (left,), (right,)), rims),
        **dict.fromkeys((("gyro_z",), ("cmd_w",), ("odom_w",)), rates),
        **dict.fromkeys((("cmd_v",), ("odom_v",)), speeds),
        ("x", "y"): ways,
        ("yaw",): angles,
    }
    for names, there in units.items():
        for unit, factor in there.items():
            yield _Correction("scale", names, f"be in {unit}", _times(factor, *names))
    for unit in ("min", "ms"):
        moved = {name: (name, 1.0 / UNITS[unit][1]) for name in POSE_COLUMNS}
        yield _Correction("clock", ("t",), f"be in {unit}", moved)


# ------------------------------------------------------------------------------------------ what
# the columns tell
def channels(log: Log) -> Channels | None:
    """Return the channels of a log, each brought to the time of the first; None where there is too little to compare."""
    groups = [
        g
        for name in ("wheels", "odom", "imu", "cmd", "pose")
        if (g := log.groups.get(name)) is not None
    ]
    start = max((g.t[0] for g in groups), default=0.0)
    stop = min((g.t[-1] for g in groups), default=0.0)
    period = min((g.period for g in groups), default=0.0)
    unit = max(min(1.0, max(0.0, stop - start) / _SHORT_S), 2.0 * period / _STEP_S)
    margin = unit * (_WINDOW_S + float(_LAGS[-1]))
    step = unit * _STEP_S
    if len(groups) < 2 or (stop - start - 2.0 * margin) < _FEWEST * step:
        return None
    middles = (
        start
        + margin
        + step * np.arange(min(_MOST, math.floor((stop - start - 2.0 * margin) / step)))
    )
    means = dict[str, FloatArray]()
    known = np.ones(len(middles), dtype=bool)
    explaining = list[FloatArray]()
    for group in groups:
        sums = _sums(group)
        lag = unit * _lag(sums, middles, explaining, unit) if means else 0.0
        means |= _means(sums, middles + lag, unit)
        for edge in (-0.5, 0.0, 0.5):
            known &= ~group.in_gaps(middles + lag + edge * unit)
        if means and not explaining:
            rates = np.column_stack(list(means.values()))
            products = np.einsum("ni,nj->nij", rates, rates).reshape(len(rates), -1)
            explaining = [np.linalg.qr(basis)[0] for basis in (rates, products)]
    return (
        {name: values[known] for name, values in means.items()}
        if np.count_nonzero(known) >= _FEWEST
        else None
    )


def _sums(group: Group) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return stamps [s] of a group's new samples by column, and the way since the first: integrals of rates; x, y, yaw."""
    sums = dict[str, tuple[FloatArray, FloatArray]]()
    pose = group.table(POSE_COLUMNS)
    for name in (n for n in group.columns if n in (*POSE_COLUMNS, *_RATES)):
        values = group.columns[name][:, None]
        new = (
            fresh_poses(group.t, values if pose is None else pose)
            if name in POSE_COLUMNS
            else refreshed(group.t, values)
        )
        t = group.t[new]
        way = values[new, 0]
        sums[name] = t, way if name in POSE_COLUMNS else integral(t, way)
    return sums


def _means(
    sums: Mapping[str, tuple[FloatArray, FloatArray]], middles: FloatArray, window: float
) -> dict[str, FloatArray]:
    """Return the channels over a `window` [s] around the (N,) middles [s]."""
    low = middles - 0.5 * window
    high = middles + 0.5 * window
    means = {
        name: (np.interp(high, t, way) - np.interp(low, t, way)) / window
        for name, (t, way) in sums.items()
    }
    return means | ({"heading": np.interp(middles, *sums["yaw"])} if "yaw" in sums else {})


def _lag(
    sums: Mapping[str, tuple[FloatArray, FloatArray]],
    middles: FloatArray,
    explaining: Sequence[FloatArray],
    unit: float,
) -> float:
    """Return the delay of a group's columns [`unit`], whatever signs and units: where others explain most of what they tell.

    Rates are explained by the rates of another group, the square of a speed of positions by their
    products; `explaining` has an orthonormal basis of each.
    """

    def share(values: FloatArray, basis: FloatArray) -> float:
        return float(np.sum((values @ basis) ** 2)) / max(float(values @ values), 1e-12)

    best = 0.0
    most = 0.0
    for lag in _LAGS:
        means = _means(sums, middles + unit * lag, unit)
        explained = sum(
            share(a, explaining[0])
            for name, a in means.items()
            if name not in ("x", "y", "heading")
        )
        if "x" in means and "y" in means:
            explained += share(means["x"] ** 2 + means["y"] ** 2, explaining[1])
        if explained > most:
            best = float(lag)
            most = explained
    return best


def apart(log: Log) -> Iterator[LogFault]:
    """Yield a fault if headings come so much earlier or later than gyro or wheels that no delay can be taken out."""
    sums = {name: way for group in log.groups.values() for name, way in _sums(group).items()}
    left, right = (sums.get(name) for name in COMMAND_COLUMNS["wheels"])
    if left and right:
        sums["wheels"] = left[0], np.interp(left[0], *right) - left[1]
    first = next((name for name in ("gyro_z", "wheels") if name in sums), "")
    yaw = sums.get("yaw")
    if not first or not yaw:
        return
    (t, way), start = sums[first], max(sums[first][0][0], yaw[0][0])
    grid = np.arange(start, min(t[-1], yaw[0][-1], start + _MOST), _STEP_S)
    a, b = (np.diff(np.interp(grid, *each)) for each in ((t, way), yaw))
    most = min(_MOST_LAG, len(a) // 3)
    alike = [
        abs(_likeness(a[max(0, -k) : len(a) - max(0, k)], b[max(0, k) : len(b) + min(0, k)]))
        for k in range(-most, most + 1)
    ]
    near = round(_LAGS[-1] / _STEP_S)
    late = _STEP_S * (int(np.argmax(alike)) - most)
    if max(alike) > max(_SAME, max(alike[max(0, most - near) : most + near + 1]) + _CLOCKS_GAIN):
        what = f"yaw tells of turns about {abs(late):.1f} s {'after' if late > 0.0 else 'before'} {first}"
        yield LogFault(
            "clock", ("t",), f"{what}: their clocks differ, and no delay so long is taken out"
        )


# ------------------------------------------------------------------------------------------ do they
# agree
class _Measure(NamedTuple):
    """One signal of a rate, with how many times the true rate it is: at least, usually and at most."""

    columns: tuple[str, ...]
    values: FloatArray
    """(N,) numbers of the log; NaN where it tells nothing."""
    least: float
    usual: float
    most: float


def _measures(signals: Channels, radius: float | None) -> tuple[list[_Measure], list[_Measure]]:
    """Return what tells the yaw rate and the forward speed, the surest first.

    The difference of the wheels' rates is 2 alpha b / r times the yaw rate, with alpha from 1.3 on
    where wheels skid: 6 to 9 where it was measured, whatever the size of the robot. Where nobody
    knows the radius, that shows the wheels' unit. Commands of turning are not what the body does,
    nor is the odometry of wheels that skid.
    """
    left, right = wheels = COMMAND_COLUMNS["wheels"]
    turning = [
        _Measure((name,), signals[name], 0.93, 1.0, 1.07)
        for name in ("gyro_z", "yaw")
        if name in signals
    ]
    forward = list[_Measure]()
    if all(name in signals for name in POSE_COLUMNS):
        along = signals["x"] * np.cos(signals["heading"]) + signals["y"] * np.sin(
            signals["heading"]
        )
        forward.append(_Measure(("x", "y"), along, 0.85, 1.0, 1.18))
    if "odom_w" in signals:
        turning.append(_Measure(("odom_w",), signals["odom_w"], 0.6, 1.0, 4.0))
    if "odom_v" in signals:
        forward.append(_Measure(("odom_v",), signals["odom_v"], 0.6, 1.0, 1.7))
    if left in signals and right in signals:
        least = 3.2 if radius is None else 2.0
        turning.append(_Measure(wheels, signals[right] - signals[left], least, 6.3, 25.0))
        around = (
            (1.7, 1.0 / _RADIUS, 33.0)
            if radius is None
            else (0.75 / radius, 1.0 / radius, 1.25 / radius)
        )
        forward.append(_Measure(wheels, 0.5 * (signals[left] + signals[right]), *around))
    # else by joystick
    commanded = np.any(
        [signals[n] != 0.0 for n in COMMAND_COLUMNS["twist"] if n in signals], axis=0
    )
    if "cmd_w" in signals:
        turning.append(
            _Measure(("cmd_w",), np.where(commanded, signals["cmd_w"], math.nan), 0.6, 2.3, 15.0)
        )
    if "cmd_v" in signals:
        forward.append(
            _Measure(("cmd_v",), np.where(commanded, signals["cmd_v"], math.nan), 0.6, 1.05, 2.7)
        )
    return turning, forward


def _agreement(signals: Channels, radius: float | None) -> float:
    """Return how well the signals agree: a sum over pairs, 1 where they agree and -1 where they contradict each other."""
    total = sum(
        _agree(a, b, share)
        for measures, share in zip(_measures(signals, radius), _SHARES, strict=True)
        for a, b in combinations(measures, 2)
    )
    if all(name in signals for name in POSE_COLUMNS):
        total += _alignment(signals["x"] + 1j * signals["y"], signals["heading"])
    return total


def _alignment(way: NDArray[np.complex128], heading: FloatArray) -> float:
    """Return how well displacements, x + iy, keep their angle to headings: 1 if they do, 0 if they turn against them."""
    size = max(float(np.sum(np.abs(way))), 1e-12)
    doubled = way**2 / np.maximum(np.abs(way), 1e-12)  # alike for both ways of driving
    along, mirrored = (
        complex(np.sum(doubled * np.exp(sign * 2j * heading))) / size for sign in (-1.0, 1.0)
    )
    return abs(along) if max(abs(along), abs(mirrored)) > _ALIKE else 0.0


def _likeness(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two rates about zero [1]; 0 where one of them is zero throughout."""
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 1e-9 else 0.0


def _percentile(values: FloatArray, percent: float) -> float:
    """Return a percentile of (N,) finite numbers, linear between ranks: numpy's own takes ten times as long for so few."""
    return float(
        np.interp(0.01 * percent * (len(values) - 1), np.arange(len(values)), np.sort(values))
    )


def _compared(a: _Measure, b: _Measure, share: float) -> tuple[float, float, float]:
    """Return how two measures of one rate compare, zeros where there is too little of them.

    These are their likeness, the logarithm of the percentile `share` of their ratio, and by how
    much it cannot be.
    """
    both = np.isfinite(a.values) & np.isfinite(b.values)
    x = a.values[both]
    y = b.values[both]
    alike = _likeness(x, y)
    if abs(alike) < _ALIKE or len(x) < _FEWEST:
        return 0.0, 0.0, 0.0
    size = np.abs(y)
    moving = (size >= _percentile(size, 60.0)) & (size > 0.0)
    ratio = math.log(max(_percentile(np.abs(x[moving] / y[moving]), share), 1e-9))
    return (
        alike,
        ratio,
        max(0.0, math.log(a.least / b.most) - ratio, ratio - math.log(a.most / b.least)),
    )


def _agree(a: _Measure, b: _Measure, share: float) -> float:
    """Return how well two measures of one rate agree: their likeness, less 1 if this percentile of their ratio cannot be."""
    alike, ratio, beyond = _compared(a, b, share)
    if not alike:
        return 0.0
    # so that of several units the most usual one is taken
    unusual = abs(ratio - math.log(a.usual / b.usual))
    # units change no likeness
    impossible = min(1.0, 20.0 * beyond) if abs(alike) > _SURE or beyond > _FAR else 0.0
    return alike - impossible - 0.02 * min(5.0, unusual)


def contradictions(signals: Channels, radius: float | None = None) -> list[LogFault]:
    """Return the faults of signs, places, frames and units that the channels of a log show.

    `radius` is that of the wheels [m]; None where nobody knows it, as then their unit shows in how
    they turn alone.
    """
    wheels = COMMAND_COLUMNS["wheels"]
    turns = np.abs(signals.get("yaw", signals.get("gyro_z", 0.0))) > _MOVES
    if (
        set(wheels) <= set(signals)
        and np.array_equal(signals[wheels[0]], signals[wheels[1]])
        and np.mean(turns) > 0.1
    ):
        return [
            LogFault(
                "swapped",
                wheels,
                "enc_left and enc_right are the same numbers, although the robot turns",
            )
        ]
    faults = list[LogFault]()
    now = _agreement(signals, radius)
    for _ in range(_MOST_FAULTS):
        corrected = [
            (_agreement(correction.applied(signals), radius) - now, correction)
            for correction in _corrections(radius or _RADIUS)
            if all(name in signals for name in correction.sources)
        ]
        least = {"scale": _GAIN_OF_UNITS, "clock": _GAIN_OF_UNITS}
        corrected = [pair for pair in corrected if pair[0] > least.get(pair[1].kind, _GAIN)]
        corrected.sort(key=lambda pair: -pair[0])
        if not corrected:
            break
        # the best of each columns
        good = {c.columns: c for gain, c in reversed(corrected) if gain > corrected[0][0] - _TIE}
        best, *others = reversed(good.values())
        signals = best.applied(signals)
        now = _agreement(signals, radius)
        columns = tuple(dict.fromkeys(name for names in (best, *others) for name in names.columns))
        words = ", or ".join(f"{_seem(c.columns)} to {c.what}" for c in (best, *others))
        if radius is not None and best.kind == "scale" and {*wheels, "x"} & set(columns):
            words += f", or its wheels to be others than those of {radius:.3g} m"
        faults.append(
            LogFault(best.kind, columns, f"{words}; as it stands, the log contradicts itself")
        )
    return [*faults, *_strangers(signals, radius), *_unlike_sides(signals)]


def _strangers(signals: Channels, radius: float | None) -> Iterator[LogFault]:
    """Yield a fault for each signal that resembles none of the others, although they resemble one another."""
    for measures, share in zip(_measures(signals, radius), _SHARES, strict=True):
        measured = [m for m in measures if not set(m.columns) <= set(COMMAND_COLUMNS["twist"])]
        for m in measured:
            others = [o.values for o in measured if o is not m]
            sure = min((_likeness(a, b) for a, b in combinations(others, 2)), default=0.0)
            less = _SLIPS if m.columns == COMMAND_COLUMNS["wheels"] else _LESS_ALIKE
            unlike = all(abs(_likeness(m.values, o)) < sure - less for o in others)
            if sure > _SURE and unlike and np.any(m.values):
                what = "be another axis or quantity: the other columns resemble one another, and not this"
                yield LogFault("swapped", m.columns, f"{_seem(m.columns)} to {what}")
        for a, b in combinations(measured, 2):
            alike, ratio, beyond = _compared(a, b, share)
            moves = max(_percentile(np.abs(m.values) / m.usual, 60.0) for m in (a, b)) > _MOVES
            if abs(alike) > _SURE and beyond > _CLEARLY and moves:
                factor = math.exp(ratio) * b.usual / a.usual
                one, other = (" and ".join(m.columns) for m in (a, b))
                words = f"the motion by {one} is {factor:.2g} times that by {other}"
                yield LogFault(
                    "scale",
                    (*a.columns, *b.columns),
                    f"{words}: one of them, or t, is in another unit",
                )


def _unlike_sides(signals: Channels) -> Iterator[LogFault]:
    """Yield a fault if a rate of one side's wheels counts for much more than one of the other's in how the robot turns."""
    wheels = COMMAND_COLUMNS["wheels"]
    turning = next((signals[name] for name in ("yaw", "gyro_z") if name in signals), None)
    if turning is None or not set(wheels) <= set(signals):
        return
    rates = np.column_stack([signals[name] for name in wheels])
    (left, right), _, _, (most, least) = np.linalg.lstsq(rates, turning)
    tells = _likeness(rates @ (left, right), turning) > _SUM and least * _TOGETHER > most
    if tells and left < 0.0 < right and not 1.0 / _SIDES_DIFFER < -left / right < _SIDES_DIFFER:
        what = f"a rate of enc_left turns the robot {-left / right:.2g} times as much as one of enc_right"
        yield LogFault("scale", wheels, f"{what}: one of them is in another unit, or loses samples")


def _seem(columns: Sequence[str]) -> str:
    return f"{' and '.join(columns)} seem{'s' * (len(columns) == 1)}"


def frozen(signals: Channels) -> Iterator[LogFault]:
    """Yield a fault if columns keep their value for long while others say that the robot moves."""
    turning, forward = _measures(signals, None)
    shares = dict[str, float]()
    wheels = COMMAND_COLUMNS["wheels"]
    for name in (n for n in signals if n in (*POSE_COLUMNS, "gyro_z", *wheels)):
        kinds = (
            [turning]
            if name in ("yaw", "gyro_z")
            else [forward]
            if name in ("x", "y")
            else [turning, forward]
        )
        others = [
            np.nan_to_num(m.values) / m.usual
            for measures in kinds
            for m in measures
            if name not in m.columns
        ]
        if not others:
            continue
        rate = signals[name]
        change = np.abs(np.diff(rate, prepend=math.nan))
        moves = np.median(np.abs(others), axis=0) > _MOVES
        if name not in POSE_COLUMNS:  # a rate may stay the same where the others do
            varies = np.median(np.abs(np.diff(others, prepend=math.nan)), axis=0) > 0.3 * _MOVES
            moves &= varies | (rate == 0.0)
        kept = moves & (rate == 0.0 if name in POSE_COLUMNS else change < 1e-12)
        # where both are kept, they may be set points, or the robot stands and its localiser does
        # not
        if name in wheels:
            other = signals.get(wheels[name == wheels[0]], rate)
            kept &= np.abs(np.diff(other, prepend=math.nan)) > 1e-12
        if np.count_nonzero(kept) > max(_FEWEST // 4, _FROZEN * np.count_nonzero(moves)):
            shares[name] = 100.0 * np.count_nonzero(kept) / np.count_nonzero(moves)
    if shares:
        words = ", ".join(f"{name} for {share:.0f} %" for name, share in shares.items())
        yield LogFault(
            "frozen",
            tuple(shares),
            f"the same value in much of the time in which the robot moves: {words}",
        )
