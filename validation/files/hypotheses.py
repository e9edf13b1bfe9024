"""Mistakes that a log may have, and the signals that each may be in.

Each row of a table is one mistake, written once for every signal. It undoes the mistake from what
the other sensors tell of that signal, and the judge of `explanation` sees how well all agree after.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.files.agreement import Agreement, columns_of, fit_factors, is_ordinary
from validation.files.columns import POSE_COLUMNS, UNITS, column_of
from validation.files.motion import ENCODERS, ODOMETRY, STOCK, TWIST, Way
from validation.files.names import as_option
from validation.files.sensors import LONGEST_S, OF_SPAN
from validation.files.signals import explain_share, find_peak, sturdy_fit

ComplexArray = NDArray[np.complex128]
Blamed = tuple[str, ...]
PLACE = ("x", "y")
GYRO: Blamed = ("gyro_z",)
SUBJECTS: tuple[Blamed, ...] = (
    *(("gyro_z",), ("yaw",), PLACE, POSE_COLUMNS, ENCODERS, ODOMETRY, TWIST),
    *((name,) for name in (*ENCODERS, *ODOMETRY, *TWIST)),
)
"""Blamed that a mistake may be in at once."""


class Idea(NamedTuple):
    """A hypothesis, as far as a log tells it."""

    kind: str
    columns: Blamed
    """Blamed that it blames."""
    words: str
    """Sentence on it."""
    after: Agreement
    """What the log tells without the mistake."""
    freedom: float = 1.0
    """Number of parameters that are fitted for it."""
    parts: bool = False
    """Whether it may hold for a part of a log."""


Mistake = tuple[Callable[[Agreement, Blamed], Iterator[Idea]], Sequence[Blamed]]
"""A function that looks for a mistake in columns, and the columns that it may be in."""


def join_names(names: Sequence[str], verb: str = "seem") -> str:
    """Return the subject and the verb of a sentence on columns."""
    return f"{' and '.join(names)} {verb}{'s' * (len(names) == 1)}"


def list_sensors(names: Blamed) -> set[str]:
    """Return the sensors whose columns these are; time is of none."""
    return {column_of(name).group for name in names if name != "t"}


def list_bases(e: Agreement, names: Blamed) -> dict[str, FloatArray]:
    """Return by column what others tell of it, if they do; of a whole pose, by its yaw alone."""
    alone = ("yaw",) if "yaw" in names else names
    return {name: basis for name in alone if (basis := e.basis_of(name)) is not None}


# ------------------------------------------------------------------------------------------ places
_Sources = Mapping[str, Mapping[str, float]]
"""Blamed that change: by column the factors of those that it is made of [1]."""


def _list_swaps() -> Iterator[tuple[str, Blamed, str, _Sources, float | None]]:
    """Yield kinds, columns, words, what they are made of, and a turn of the heading [rad].

    Where that is None, the path tells it.
    """

    def signed(*names: str) -> _Sources:
        return {name: {name: -1.0} for name in names}

    negative = "to have the wrong sign"
    for names in SUBJECTS:
        if names[0] not in POSE_COLUMNS:
            yield "sign", names, negative, signed(*names), 0.0
    clockwise = "to turn clockwise, as a compass"
    yield "sign", ("yaw",), clockwise, signed("yaw"), 0.0
    backwards = "to be half a turn apart: the robot drives backwards"
    yield "sign", POSE_COLUMNS, backwards, signed(*PLACE), 0.0
    reverse = "to go backwards while the heading is right: t runs backwards, from the last row on"
    heads = {"heading": {"heading": 1.0}}
    yield "sign", POSE_COLUMNS, reverse, {**signed(*POSE_COLUMNS), **heads}, 0.0
    for a, b in (ENCODERS, PLACE, TWIST, ODOMETRY):
        yield "swapped", (a, b), "to be swapped", {a: {b: 1.0}, b: {a: 1.0}}, 0.0
    left, right = ENCODERS
    crossed = {left: {right: -1.0}, right: {left: -1.0}}
    yield "swapped", ENCODERS, "to be swapped and negative", crossed, 0.0
    v, w = TWIST
    for size in (1.0, STOCK.radius):
        half = 0.5 * size
        turn = half / STOCK.half_track
        sides = {v: {v: half, w: half}, w: {v: -turn, w: turn}}
        yield "swapped", TWIST, "to command the left and the right wheels", sides, 0.0
    for names in (("y",), ("x",), ("y", "yaw"), ("y", "yaw", *GYRO)):
        down = ", or its z points down" * (len(names) > 1)
        words = f"{negative}: the frame is left-handed{down}"
        yield "handedness", names, words, signed(*names), 0.0
    for names in (("yaw",), ("yaw", *GYRO)):
        yield "handedness", names, clockwise, signed(*names), None
    quarter = 0.5 * math.pi
    for turn in (-quarter, quarter):
        yield "handedness", ("yaw",), "to be a quarter turn off", {"yaw": {"yaw": 1.0}}, turn


def _swapped_columns(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Signs, places and frames."""
    for kind, blamed, words, sources, rotation in _list_swaps():
        if blamed != names or not sources.keys() <= e.means.keys():
            continue
        changed = {
            name: np.sum([factor * e.means[source] for source, factor in parts.items()], axis=0)
            for name, parts in sources.items()
        }
        if "yaw" in sources and "heading" not in sources:
            heading = sources["yaw"]["yaw"] * e.means["heading"]
            turn = _path_angle(e, heading) if rotation is None else rotation
            changed["heading"] = heading + (turn or 0.0)
        freedom = float(len(names)) + (rotation is None)
        yield Idea(kind, names, f"{join_names(names)} {words}", e.but(changed), freedom, True)


def _path_angle(e: Agreement, heading: FloatArray) -> float | None:
    """Return the angle from headings to the path [rad]; None where it is none, or unusual."""
    if not {*PLACE} <= e.means.keys():
        return None
    step = e.means["x"] + 1j * e.means["y"]
    off = _seen_ahead(e, step * np.exp(-1j * heading))
    wrong = np.abs(off) > 0.2 * np.percentile(np.abs(step), 90.0)
    wrong &= np.abs(np.angle(off)) > _ANGLE
    # a localiser ahead of the middle moves sideways in turns
    wrong &= np.abs(e.means["yaw"]) < 2.0 * np.abs(step)
    if np.count_nonzero(wrong) <= 10:
        return None
    apart = off[wrong] / np.abs(off[wrong])
    return float(np.angle(np.median(apart.real) + 1j * np.median(apart.imag)))


def _seen_ahead(e: Agreement, seen: ComplexArray) -> ComplexArray:
    """Return (N,) velocities in the robot's frame, turned round where it drives backwards."""
    speeds = e.told[0]
    return seen * np.sign(speeds.get("wheels", speeds.get("odom", seen.real)))


_ROUNDS = 6
"""Number of times that the directions of a path and what moves it are fitted to one another."""
_ANGLE = math.radians(8.0)
"""Angle between path and heading from which it is unusual [rad]."""


def _turned_path(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """A path at an angle to its heading, or counted along the robot."""
    heading = e.means["heading"]
    angle = _path_angle(e, heading)
    if angle is not None and abs(math.remainder(angle, 0.5 * math.pi)) > _ANGLE:
        words = (
            f"path and heading are {abs(math.degrees(angle)):.0f} deg "
            "apart: the localiser is mounted at an angle, or x, y and yaw are of different frames"
        )
        yield Idea("frame", names, words, e.but({"heading": heading + angle}), 2.0, True)
    if np.ptp(heading) > 1.5:
        words = (
            "x grows and y does not, wherever the robot heads: they are counted along the robot, "
            "not in a fixed frame"
        )
        fixed = (e.means["x"] + 1j * e.means["y"]) * np.exp(1j * heading)
        yield Idea("frame", PLACE, words, e.but({"x": fixed.real, "y": fixed.imag}))


def _turning_frames(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Places and headings that are counted in frames that turn evenly."""
    t = e.signals.windows.at["pose"]
    one = np.ones(len(t))
    line = np.column_stack([t, one])
    x, y = (np.interp(t, *e.signals.ways[name]) for name in PLACE)
    heading = e.means["heading"]
    path = step = e.means["x"] + 1j * e.means["y"]
    # such a frame moves what is in it, about whatever point
    moves = np.column_stack([1j * (x - x.mean()) - (y - y.mean()), 1j * one, one])
    for _ in range(_ROUNDS):
        off = _seen_ahead(e, path * np.exp(-1j * heading))
        fast = np.abs(off) > np.median(np.abs(off))
        apart = fit_factors(line[fast], np.unwrap(np.angle(off[fast])))
        still = heading + line @ apart
        seen = np.exp(-1j * still)
        turn = fit_factors((moves * seen[:, None]).imag, (step * seen).imag)
        path = step - moves @ turn
    own = turn[0] - apart[0]
    if max(abs(turn[0]), abs(own)) * np.ptp(t) < _ANGLE:
        return  # on a slope a robot slides down wherever it heads
    words = (
        f"x and y turn by {turn[0]:z.3f} rad/s against the others, and yaw by {own:z.3f}, evenly: "
        "the localiser's frame turns, or its heading adds up a gyro's offset"
    )
    even = {"yaw": e.means["yaw"] - own}
    yield Idea("drift", ("yaw",), words, e.but(even), 1.0)  # from a heading that was right
    changed = {"x": path.real, "y": path.imag, **even, "heading": still}
    yield Idea("frame", names, words, e.but(changed), 5.0)


def _curved_rates(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Yaw rates that are curvatures of the path."""
    v, w = names
    words = f"{w} follows the curvature of the path: times {v} it tells the turn"
    yield Idea("curvature", (w,), words, e.but({w: e.means[v] * e.means[w]}))


def _unsigned_columns(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Blamed that tell no direction: never negative, although the robot drives backwards."""
    raw = [e.signals.log.columns[name] for name in names]
    if any(values.min() < -0.01 * values.max() for values in raw):
        return
    changed = dict[str, FloatArray]()
    for name, basis in list_bases(e, names).items():
        # of a side of wheels, the direction is that of v -+ b w
        levers = np.linspace(-1.5, 1.5, 31) if basis.shape[1] > 1 else np.zeros(1)
        ahead = np.sign(basis[:, :1] + basis[:, -1:] * levers)
        told = ahead * e.means[name][:, None]
        changed[name] = told[:, np.argmax(explain_share(told, basis, [0]))]
    words = (
        f"{join_names(names, 'tell')} no direction: never negative, although the other signals say "
        "that the robot turns or drives backwards"
    )
    yield Idea("sign", names, words, e.but(changed), -1.0)


# ------------------------------------------------------------------------------------------ units
_PRECISIONS: Mapping[Blamed, float] = {
    ("yaw",): 0.03,
    ("gyro_z",): 0.02,
    ("odom_w",): 0.1,
    ("cmd_w",): 0.02,
    PLACE: 0.08,
    ("odom_v",): 0.1,
    ("cmd_v",): 0.12,
    ENCODERS: 0.08,
}
"""How well the factor of columns that are in another unit is known [1]."""


def _pair_factors(names: Blamed, e: Agreement) -> Iterator[tuple[str, float, str]]:
    """Yield by each pair what columns tell, their factor, and by which sensor that is told."""
    sensor = column_of(names[0]).group
    for pair in e.pairs:
        if sensor in (pair.a, pair.b) and {*names} <= pair.columns and pair.a != pair.b:
            first = sensor == pair.a
            factor = pair.factor if first else 1.0 / pair.factor
            yield pair.what, factor, pair.b if first else pair.a


def _other_units(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Blamed that are a factor too large or too small."""
    told = [(what, f, by) for what, f, by in _pair_factors(names, e) if 1e-7 < f < 1e9]
    odd = [f for what, f, _ in told if not is_ordinary(what, column_of(names[0]).group, f)]
    for factor in {f"{f:.2g}": f for f in odd}.values():
        changed = {name: e.means[name] / factor for name in names}
        if names == ("yaw",):
            heading = e.means["heading"] / factor
            changed["heading"] = heading
            changed["heading"] = heading + (_path_angle(e.but(changed), heading) or 0.0)
        words = _words_of_unit(names, told, e)
        # wheels have any radius and any gear; of others, an odd factor is less likely
        likely = names == ENCODERS or bool(_fitting_unit(names, [factor], e.signals.radius))
        yield Idea("scale", names, words, e.but(changed), 2.0 if likely else 4.0, True)


def _words_of_unit(names: Blamed, told: Sequence[tuple[str, float, str]], e: Agreement) -> str:
    """Return words for the factor of columns, and for the unit that they may be in."""
    radius = e.signals.radius
    near = dict[str, tuple[float, str]]()
    for what, f, by in told:
        # of several, the most exact one stands first
        near.setdefault(what, (f, join_names(columns_of(what, by), "say")))
    parts = [f"{f:.3g} times the {what} that {by}" for what, (f, by) in near.items()]
    words = f"{join_names(names, 'tell')} {', and '.join(parts)}"
    factors = [f for f, _ in near.values()]
    factor = factors[-1]
    unit = _fitting_unit(names, factors, radius)
    if unit:
        return f"{words}: it seems to be in {unit}{offer_unit(e, names, unit)}"
    if names == ("yaw",) and abs(math.log(2.0 * factor)) < 0.05:
        return f"{words}: is it half of the angle, as in a quaternion?"
    if names == ("gyro_z",) and 0.8 < factor < 1.25:
        return f"{words}: its scale is off"
    if names != ENCODERS:
        return f"{words}: is it in {'percent or ' * (names[0] in TWIST)}another unit?"
    gear = float(f"{max(factor, 1.0 / factor):.1g}")
    wheel = f"wheels of another radius than {radius or STOCK.radius:.3g} m"
    if "way" in near:
        wheel += f" (cured by a wheel_radius_multiplier of {1.0 / near['way'][0]:.3g})"
    return f"{words}: ticks, a gear of about {gear:g}, or {wheel}?"


def offer_unit(e: Agreement, names: Blamed, unit: str, ticks: str = "") -> str:
    """Return the end of a sentence with the options that take columns of a table in a unit."""
    option = shlex.quote(as_option({name: (name, unit) for name in names}))
    return "" if e.signals.log.topics else f": --columns {option}{ticks}"


def _fitting_unit(names: Blamed, factors: Sequence[float], radius: float | None) -> str:
    """Return the unit that fits the last of some factors to its precision, as no other does.

    Of several it is the one that lies between the factors. Nothing for none.
    """
    precision = _PRECISIONS[names]
    base = column_of(names[0]).unit
    sizes = {unit: 1.0 / size for unit, (of, size) in UNITS.items() if of == base}
    if names == ENCODERS and radius is not None:
        sizes |= {unit: radius / size for unit, (of, size) in UNITS.items() if of == "m/s"}
        sizes["m/s"] = radius
    elif names == ENCODERS or (radius is None and "x" in names and 0.1 <= factors[0] <= 10.0):
        return ""
    elif "x" in names and radius is None:
        precision = 0.3  # it is told by wheels of some size
    off = {unit: abs(math.log(factors[-1] / size)) for unit, size in sizes.items()}
    near = [unit for unit in off if off[unit] < 2.0 * precision]
    if len(near) > 1:
        # to three digits, as factors are said
        low, high = 0.995 * min(factors), 1.005 * max(factors)
        near = [unit for unit in near if low <= sizes[unit] <= high]
    return near[0] if len(near) == 1 and off[near[0]] < precision else ""


def _one_of_two(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """One of x and y in another unit, or one of the two sides of wheels."""
    sizes = {
        name: 1e-9 + abs(fit_factors(basis, e.means[name])[0])
        for name, basis in list_bases(e, names).items()
        if explain_share(e.means[name][:, None], basis, [0]) > _SURE
    }
    for name, other in permutations(sizes, 2):
        ratio = sizes[name] / sizes[other]
        if not 0.1 < abs(math.log(ratio)) < 15.0:
            continue
        unit = _fitting_unit(PLACE, [float(f"{ratio:.1g}")], 1.0) if names == PLACE else ""
        words = (
            f"{name} tells some {float(f'{ratio:.2g}'):g} times the way that {other} says beside "
            f"the other signals: it is in {unit or 'another unit, or loses samples'}"
        )
        yield Idea("scale", (name,), words, e.but({name: e.means[name] / ratio}), 2.0, True)


_OFFSET = 0.025
"""Offset of a gyro from which it is a fault: a sound one on tile has 0.016 [rad/s]."""
_DRIFT = 0.04
"""Change of such an offset through a log from which it is a fault [rad/s]."""


def _trends_of_columns(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Blamed whose factor grows through the log; rates of turning that are shifted, or drift."""
    share = np.linspace(-0.5, 0.5, len(e.signals.windows.t))
    one = np.ones(len(share))
    growths = []
    for name, basis in list_bases(e, names).items():
        values = e.means[name]
        factors = fit_factors(np.hstack([basis, share[:, None] * basis]), values)
        if explain_share(values[:, None], basis, [0]) > _SURE:
            growths.append(factors[basis.shape[1]] / (factors[0] or 1.0))
        if len(names) > 1:
            continue
        level, slope, *_ = fit_factors(np.column_stack([one, share, basis]), values)
        if abs(level) > _OFFSET:
            words = (
                f"{name} less the yaw rate is {level:.2g} rad/s throughout: it has an offset; "
                "where the robot stands, `recordings convert --unbias` takes a gyro's out"
            )
            yield Idea("offset", names, words, e.but({name: values - level}), 1.0, True)
        if abs(slope) > _DRIFT:
            words = f"{name} less the yaw rate grows by {slope:.2f} rad/s in the log: it drifts"
            yield Idea("drift", names, words, e.but({name: values - level - slope * share}), 2.0)
    growth = float(np.mean(growths)) if growths else 0.0
    if 0.05 < abs(growth) < 1.9:
        # a factor that it has from the first on is another cause
        trend = (1.0 + share * growth) / (1.0 - 0.5 * growth)
        words = (
            f"{join_names(names, 'tell')} a motion that grows to {trend[-1]:.2f} times what it is "
            "at first beside the other signals"
        )
        yield Idea("scale", names, words, e.but({n: e.means[n] / trend for n in names}), 2.0)


# ------------------------------------------------------------------------------------------ time
def _time_unit(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Time in another unit: turns and ways of the pose are too fast by the same factor."""
    told = dict[str, float]()
    for what, factor, by in chain(_pair_factors(("yaw",), e), _pair_factors(PLACE, e)):
        if by in ("imu", "wheels", "odom"):
            told.setdefault(what, factor)
    factor = told.get("turn", 1.0)
    if max(factor, 1.0 / factor) < 1.3 or not 0.33 < told.get("way", 0.0) / factor < 3.0:
        return
    rows = all(np.all(np.diff(group.t) == 1.0) for group in e.signals.log.groups.values())
    changed = {name: e.means[name] / factor for name in names}
    words = (
        f"the pose turns and drives {factor:.3g} times as fast as the other sensors say: "
        f"t is not in seconds{', but grows by one a row: it seems to count rows' * rows}"
    )
    changed["heading"] = e.means["heading"]
    yield Idea("clock", ("t", *names), words, e.but(changed), 2.0 if rows else 4.0)


_LONG = 0.002
"""Share of a column that a delay must explain for each second that it is longer [1/s]."""
TAKEN_OUT = 1.5
"""Delay of all columns of a sensor up to which it is taken out, and no fault [s]."""
_LATE = 0.3
"""Delay of some of them behind the others from which it is a fault [s]."""
_SURE = 0.8
"""Share of a column that others explain from which its delay or its size is known [1]."""


def find_delays(
    e: Agreement, ways: Mapping[str, Way], starts: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return how late ways of columns are in parts of a log, and how well that is known.

    Signs and units of the columns do not matter.

    Args:
        e: what the log tells.
        ways: ways of columns of one group.
        starts: (P,) indices of the first window of each part.

    Returns:
        (P,) delays beyond those that windows take out [s], and (P,) shares of the columns that
        others explain then [1]; NaN and 0 where nothing does.
    """
    windows = e.signals.windows
    bases = list_bases(e, tuple(ways))
    most = min(round(LONGEST_S / e.period), len(windows.t))  # later, nothing is left to compare
    shifts = np.arange(-most, most + 1)
    # windows begin and end where others have their middles
    rows = np.rint((windows.t - windows.t[0]) / e.period).astype(int)[:, None] + shifts + most
    first = windows.at[column_of(next(iter(ways))).group][0]
    edges = first + e.period * np.arange(-most - 1, rows[-1, -1] - most + 2)
    # of two that are as good, the shorter one
    found = np.tile(-_LONG * e.period * np.abs(shifts), (len(starts), 1))
    for name, basis in bases.items():
        way = np.interp(edges, *ways[name])
        values = (way[rows + 2] - way[rows]) / windows.width
        found += explain_share(values, basis, starts) / len(bases)
    late = [e.period * (find_peak(shares) - most) for shares in found]
    return np.array(late), found.max(axis=1)


def say_late(names: Blamed, seconds: float) -> str:
    """Return the words for columns that are late by so much [s], or early."""
    when = "after" if seconds > 0.0 else "before"
    return (
        f"{join_names(names, 'tell')} of motions {abs(seconds):.1f} s {when} the others do: their "
        "clocks differ"
    )


def _other_clocks(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Blamed that are late, by some time or by more and more."""
    t = e.signals.windows.t
    group = column_of(names[0]).group
    ways = {name: e.signals.ways[name] for name in names}
    mates = e.signals.log.groups[group].columns
    others = tuple(name for name in mates if name in e.means and name not in names)
    taken = e.signals.windows.late[group]
    least = _LATE if others else TAKEN_OUT
    parts = max(6, round(float(np.ptp(t)) / 20.0))
    starts = np.linspace(0, len(t), parts + 1).astype(int)[:-1]
    late, sure = find_delays(e, ways, starts.tolist())
    whole, explained = find_delays(e, ways, [0])
    longest = OF_SPAN * float(np.ptp(t))
    known = (sure > _SURE) & (np.abs(late) < longest / parts)
    near = (np.abs(whole) < longest) & (explained > 0.5)
    lags = [*late[known][:1], *late[known][-1:], *whole[near]]
    # the delay that is taken out of a group may be between those of its columns
    mates_ways = {name: e.signals.ways[name] for name in others}
    of_mates = find_delays(e, mates_ways, [0])[0].tolist() if others else []
    ahead = next((lag for lag in of_mates if abs(lag) < longest), -taken)
    for lag in {round(lag, 1): lag for lag in np.array(lags).tolist()}.values():
        off = lag - ahead
        if not abs(off) > least:
            continue
        blamed = names
        if abs(taken + lag) < abs(taken + ahead):
            # of the two, that one is late that is later than the other sensors
            blamed, off = others, -off
        words = say_late(blamed, off)
        told = {
            **e.signals.windows.means_of(mates_ways, group, ahead),
            **e.signals.windows.means_of(ways, group, lag),
        }
        yield Idea("clock", blamed, words, e.but(told), 2.0, True)
    if np.count_nonzero(known) < max(5, parts // 2):
        return
    # by least absolute errors: one part may tell nonsense
    one = np.ones(np.count_nonzero(known))
    start, slope = sturdy_fit(np.column_stack([one, t[starts][known]]), late[known])
    first, last = taken + start + slope * t[[0, -1]]
    if np.ptp(t) > 45.0 and abs(last - first) > 0.3:
        words = (
            f"{join_names(names, 'tell')} of motions {first:.2f} s after the others do at first "
            f"and {last:.2f} s at last: one of their clocks runs {100.0 * abs(slope):.1f} % faster"
        )
        middles = start + slope * (t - 0.5 * np.ptp(t) / parts)
        yield Idea(
            "clock", names, words, e.but(e.signals.windows.means_of(ways, group, middles)), 3.0
        )


_WIDTHS_S = (2.0, 3.0, 4.0, 6.0, 8.0)
"""Times over which a smoothed signal may be averaged [s]."""


def _smoothed_columns(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Blamed that are averaged over seconds, or follow late as a low-pass does."""
    bases = list_bases(e, names)
    if names == ENCODERS and "gyro_z" not in e.means:
        return  # a localiser is too noisy to show how much faster the robot turns
    best = dict[str, tuple[float, float, FloatArray]]()
    for how, width, kernel in _list_kernels(e.period):
        if 3 * len(kernel) > 2 * len(e.signals.windows.t):
            continue
        alike = 0.0
        for name, basis in bases.items():
            values = e.means[name][:, None]
            alike += float(explain_share(values, _blur_columns(basis, kernel), [0])[0, 0])
        if alike > best.get(how, (0.0,))[0]:
            best[how] = alike, width, kernel
    for how, (_, width, kernel) in best.items():
        after = e
        for name in sorted(names, reverse=True):  # positions need the heading
            told = after.basis_of(name)
            if told is None:
                continue
            blurred = _blur_columns(told, kernel)
            # what the column cannot tell is as others tell it
            lost = (told - blurred) @ fit_factors(blurred, e.means[name])
            after = after.but({name: e.means[name] + lost})
        words = (
            f"{join_names(names, 'follow')} {how} of what the others tell over some {width:g} s: "
            "smoothed, and fast turns are lost in it"
        )
        yield Idea("smoothed", names, words, after, 4.0)


def _list_kernels(period: float) -> Iterator[tuple[str, float, FloatArray]]:
    """Yield means over some time [s], about the middle one and with a tail to the past."""
    for seconds in _WIDTHS_S:
        width = 2 * round(0.5 * seconds / period) + 1
        reach = math.ceil(4.0 * seconds / period)
        tail = np.exp(-np.arange(reach + 1) * period / seconds)
        kernels = {
            "the mean": np.full(width, 1.0 / width),
            "a low-pass": np.concatenate([np.zeros(reach), tail / tail.sum()]),
        }
        for how, kernel in kernels.items():
            # the delay that smoothing makes is taken out of its group
            for shift in range(-4, 5):
                yield how, seconds, np.roll(np.pad(kernel, abs(shift)), shift)


def _blur_columns(columns: FloatArray, kernel: FloatArray) -> FloatArray:
    """Return (N, k) rates smoothed with a kernel of odd length."""
    from scipy import ndimage  # here: it takes a tenth of a second to import

    return np.asarray(ndimage.convolve1d(columns, kernel, axis=0, mode="nearest"))


UNITS_ALONE: Sequence[Mistake] = ((_other_units, (*_PRECISIONS,)),)
"""Other units, which columns may have beside another mistake."""
MISTAKES: Sequence[Mistake] = (
    *UNITS_ALONE,
    (_swapped_columns, tuple(dict.fromkeys(swap[1] for swap in _list_swaps()))),
    (_turned_path, (POSE_COLUMNS,)),
    (_turning_frames, (POSE_COLUMNS,)),
    (_curved_rates, (TWIST, ODOMETRY)),
    (_unsigned_columns, tuple(names for names in SUBJECTS if names != PLACE)),
    (_one_of_two, (PLACE, ENCODERS)),
    (_trends_of_columns, (GYRO, ("odom_w",), PLACE, ENCODERS)),
    (_time_unit, (POSE_COLUMNS,)),
    (_other_clocks, (*SUBJECTS, ("x",), ("y",))),
    (_smoothed_columns, (GYRO, PLACE, POSE_COLUMNS, ENCODERS, ODOMETRY, ("yaw",))),
)
"""The mistakes of meaning and of time, and the columns that each may be in."""
