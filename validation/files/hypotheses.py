"""What may be wrong in a log: hypotheses that compete to explain it.

Each changes some columns, by which one mistake is undone, for the whole log or for a part of it.
The one after which all signals agree best is named, if it beats those that blame other columns by
enough; else the log cannot say which of them is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr.geometry import integrate_rates
from ssmr.types import FloatArray
from validation.files.columns import POSE_COLUMNS, UNITS, column_of
from validation.files.explanation import Evidence, is_ordinary
from validation.files.log import LogFault
from validation.files.motion import ENCODERS, ODOMETRY, RATES, STOCK, TWIST, Way
from validation.files.sensors import FEWEST_WINDOWS, LONGEST_S, Signals
from validation.files.signals import correlation, sturdy_fit


class Idea(NamedTuple):
    """A hypothesis, as far as a log tells it."""

    kind: str
    columns: tuple[str, ...]
    """Columns that it blames."""
    words: str
    """Sentence on it."""
    after: Evidence
    """What the log tells without the mistake."""
    freedom: float = 1.0
    """Number of parameters that are fitted for it."""
    parts: bool = False
    """Whether it may hold for a part of a log."""


# ------------------------------------------------------------------------------------------ places
class _Swap(NamedTuple):
    """Columns that are others, or have another sign."""

    kind: str
    columns: tuple[str, ...]
    words: str
    sources: Mapping[str, tuple[str, float]]
    """Columns that change: the column that each is made of, and the factor [1]."""
    rotation: float = 0.0
    """Angle that is added to the heading after that [rad]."""


def _negated(*names: str) -> Mapping[str, tuple[str, float]]:
    return {name: (name, -1.0) for name in names}


def _list_swaps() -> Iterator[_Swap]:
    left, right = ENCODERS
    negative = "to have the wrong sign"
    for names in (ENCODERS, TWIST, ODOMETRY, *((name,) for name in (*RATES, "yaw"))):
        yield _Swap("sign", names, negative, _negated(*names))
    backwards = "to be half a turn apart: the robot drives backwards"
    yield _Swap("sign", POSE_COLUMNS, backwards, _negated("x", "y"))
    for a, b in (ENCODERS, ("x", "y"), TWIST, ODOMETRY):
        yield _Swap("swapped", (a, b), "to be swapped", {a: (b, 1.0), b: (a, 1.0)})
    crossed = {left: (right, -1.0), right: (left, -1.0)}
    yield _Swap("swapped", ENCODERS, "to be swapped and negative", crossed)
    for names in (("y",), ("x",), ("y", "yaw")):
        what = f"{negative}: the frame is left-handed"
        yield _Swap("handedness", names, what, _negated(*names))
    quarter = 0.5 * math.pi
    off = "to be a quarter turn off"
    compass = "to turn clockwise from north, as a compass"
    for sign, turn, what in ((-1.0, quarter, compass), (1.0, -quarter, off), (1.0, quarter, off)):
        yield _Swap("handedness", ("yaw",), what, {"yaw": ("yaw", sign)}, turn)


def swaps(e: Evidence) -> Iterator[Idea]:
    """Signs, places and frames."""
    for swap in _list_swaps():
        if not swap.sources.keys() <= e.means.keys():
            continue
        changed = {}
        for name, (source, factor) in swap.sources.items():
            changed[name] = factor * e.means[source]
        if "yaw" in swap.sources:
            changed["heading"] = swap.sources["yaw"][1] * e.means["heading"] + swap.rotation
        words = f"{_seem(swap.columns)} {swap.words}"
        yield Idea(swap.kind, swap.columns, words, e.but(changed), 1.0, parts=True)


def _seem(names: Sequence[str]) -> str:
    """Return the subject and the verb of a sentence on columns."""
    return f"{' and '.join(names)} seem{'s' * (len(names) == 1)}"


def turned_path(e: Evidence) -> Iterator[Idea]:
    """A path at an angle to its heading, or counted along the robot."""
    if not {*POSE_COLUMNS} <= e.means.keys():
        return
    x, y, heading = (e.means[name] for name in ("x", "y", "heading"))
    step = x + 1j * y
    ahead = np.sign(_way_of_others(e, "pose", x * np.cos(heading) + y * np.sin(heading)))
    off = ahead * step * np.exp(-1j * heading)
    moves = np.abs(step) > 0.2 * np.percentile(np.abs(step), 90.0)
    wrong = moves & (np.abs(np.angle(off)) > math.radians(8.0))
    # a localiser ahead of the middle moves sideways in turns
    wrong &= np.abs(e.means["yaw"]) < 2.0 * np.abs(step)
    if np.count_nonzero(wrong) > 10:
        angle = float(np.median(np.unwrap(np.angle(off[wrong] / np.sum(off[wrong])))))
        angle += float(np.angle(np.sum(off[wrong])))
        degrees = abs(math.degrees(math.remainder(angle, math.tau)))
        words = (
            f"path and heading are {degrees:.0f} deg apart: the localiser is mounted at an angle, "
            "or x, y and yaw are of different frames"
        )
        if abs(math.remainder(angle, 0.5 * math.pi)) > math.radians(8.0):
            turned = e.but({"heading": heading + angle})
            yield Idea("frame", POSE_COLUMNS, words, turned, 2.0, parts=True)
    if np.ptp(heading) > 1.5:
        words = (
            "x grows and y does not, wherever the robot heads: they are counted along the robot, "
            "not in a fixed frame"
        )
        fixed = step * np.exp(1j * heading)
        yield Idea("frame", ("x", "y"), words, e.but({"x": fixed.real, "y": fixed.imag}), 1.0)


def _way_of_others(e: Evidence, sensor: str, otherwise: FloatArray) -> FloatArray:
    """Return the speed by another sensor, or what stands for it where there is none."""
    speeds = e.told[0]
    others = [name for name in ("pose", "odom", "wheels", "cmd") if name in speeds]
    told = next((speeds[name] for name in others if name != sensor), otherwise)
    return np.where(np.isfinite(told), told, otherwise)


def _fit(columns: Sequence[FloatArray], values: FloatArray) -> FloatArray:
    """Return the factors of K columns that sum up to (N,) values where all are known.

    They are zeros where too little is.
    """
    design = np.column_stack(columns)
    known = np.isfinite(design).all(axis=1) & np.isfinite(values)
    if np.count_nonzero(known) < FEWEST_WINDOWS // 2:
        return np.zeros(design.shape[1])
    return sturdy_fit(design[known], values[known])


# ------------------------------------------------------------------------------------------ units
_SENSORS: Mapping[tuple[str, ...], tuple[tuple[str, str], ...]] = {
    ("yaw",): (("turn", "pose"),),
    ("gyro_z",): (("turn", "imu"),),
    ("odom_w",): (("turn", "odom"),),
    ("cmd_w",): (("turn", "cmd"),),
    ("x", "y"): (("way", "pose"),),
    ("odom_v",): (("way", "odom"),),
    ("cmd_v",): (("way", "cmd"),),
    ENCODERS: (("turn", "wheels"), ("way", "wheels")),
}
"""What columns tell, and by which sensor."""


def _told(names: tuple[str, ...], e: Evidence) -> Iterator[tuple[str, float, str]]:
    """Yield by each pair what columns tell, their factor, and by which sensor that is told."""
    for what, sensor in _SENSORS[names]:
        for pair in e.pairs:
            if pair.what == what and sensor in (pair.a, pair.b):
                first = sensor == pair.a
                other = pair.b if first else pair.a
                yield what, (pair.factor if first else 1.0 / pair.factor), other


def units(e: Evidence) -> Iterator[Idea]:
    """Columns that are a factor too large or too small."""
    for names in _SENSORS:
        if not {*names} <= e.means.keys():
            continue
        told = [(what, f, by) for what, f, by in _told(names, e) if 1e-7 < f < 1e9]
        odd = [f for what, f, _ in told if not is_ordinary(what, _SENSORS[names][0][1], f)]
        for factor in {f"{f:.2g}": f for f in odd}.values():
            changed = {name: e.means[name] / factor for name in names}
            if names == ("yaw",):
                changed["heading"] = e.means["heading"] / factor
            words = _words_of_unit(names, told, factor, e)
            # wheels have any radius and any gear; of others, an odd factor is less likely
            likely = names == ENCODERS or bool(_fitting_unit(names, factor, e.signals.radius))
            yield Idea("scale", names, words, e.but(changed), 2.0 if likely else 4.0, parts=True)


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
_COLUMNS_OF = {("turn", "imu"): "gyro_z", ("turn", "pose"): "yaw", ("way", "pose"): "x and y"}
_COLUMNS_OF |= {("turn", "odom"): "odom_w", ("way", "odom"): "odom_v"}
_COLUMNS_OF |= {("turn", "cmd"): "cmd_w", ("way", "cmd"): "cmd_v"}
_COLUMNS_OF |= dict.fromkeys((("turn", "wheels"), ("way", "wheels")), " and ".join(ENCODERS))


def _words_of_unit(
    names: tuple[str, ...], told: Sequence[tuple[str, float, str]], factor: float, e: Evidence
) -> str:
    """Return words for the factor of columns, and for the unit that they may be in."""
    radius = e.signals.radius
    tell = "tells" if len(names) == 1 else "tell"
    near = dict[str, tuple[float, str]]()
    for what, f, by in told:
        # of several, the most exact one stands first
        near.setdefault(what, (f, _COLUMNS_OF[what, by]))
    parts = [f"{f:.3g} times the {what} that {by} say" for what, (f, by) in near.items()]
    words = f"{' and '.join(names)} {tell} {', and '.join(parts)}"
    factor = next(iter(near.values()))[0]
    unit = _fitting_unit(names, factor, radius)
    if unit:
        return f"{words}: it seems to be in {unit}"
    if names == ("yaw",) and abs(math.log(2.0 * factor)) < 0.05:
        return f"{words}: is it half of the angle, as in a quaternion?"
    if names == ("gyro_z",) and 0.8 < factor < 1.25:
        return f"{words}: its scale is off"
    if names != ENCODERS:
        return f"{words}: is it in another unit?"
    factors = [f for f, _ in near.values()]
    gears = sorted({float(f"{max(f, 1.0 / f):.1g}") for f in factors})
    gear = " to ".join(f"{gear:g}" for gear in gears)
    wheel = f"wheels of another radius than {radius or STOCK.radius:.3g} m"
    if "way" in near:
        wheel += f" (cured by a wheel_radius_multiplier of {1.0 / near['way'][0]:.3g})"
    return f"{words}: ticks, a gear of about {gear}, or {wheel}?"


def _fitting_unit(names: tuple[str, ...], factor: float, radius: float | None) -> str:
    """Return the unit that a factor fits to its precision, as no other does; nothing for none."""
    precision = _PRECISIONS[names]
    base = column_of(names[0]).unit
    sizes = {unit: 1.0 / size for unit, (of, size) in UNITS.items() if of == base}
    if "x" in names:
        sizes["degrees of latitude and longitude"] = 1.0 / 111e3
    if names == ENCODERS and radius is not None:
        sizes |= {unit: radius / size for unit, (of, size) in UNITS.items() if of == "m/s"}
        sizes["m/s"] = radius
    elif names == ENCODERS or (radius is None and "x" in names and 0.1 <= factor <= 10.0):
        return ""
    elif "x" in names and radius is None:
        precision = 0.3  # it is told by wheels of some size
    away = sorted((abs(math.log(factor / size)), unit) for unit, size in sizes.items())
    alone = len(away) < 2 or away[1][0] > 2.0 * precision
    return away[0][1] if away and away[0][0] < precision and alone else ""


def one_axis(e: Evidence) -> Iterator[Idea]:
    """One of x and y in another unit, or one of the two sides of wheels."""
    speeds, turns = e.told
    way = next((speeds[name] for name in ("odom", "wheels", "cmd") if name in speeds), None)
    if way is not None and {"x", "y"} <= e.means.keys():
        sizes = _fit([e.means["x"] ** 2, e.means["y"] ** 2], way**2)
        if np.all(sizes > 0.0):
            for name, factor in (("x", sizes[1] / sizes[0]), ("y", sizes[0] / sizes[1])):
                factor = math.sqrt(factor)
                rounded = float(f"{factor:.1g}")
                unit = _fitting_unit(("x", "y"), rounded, 1.0)
                unit = f": it seems to be in {unit}" if unit else ""
                words = (
                    f"{name} tells some {rounded:g} times the way that the other axis says{unit}"
                )
                yield Idea("scale", (name,), words, e.but({name: e.means[name] / factor}), 2.0)
    if e.signals.wheels is None or "pose" not in speeds:
        return
    sides = np.array([e.means[name] for name in ENCODERS])
    factors = np.array([_fit([speeds["pose"], turns["pose"]], side)[0] for side in sides])
    if np.all(np.abs(factors) > 1e-9):
        for k, name in enumerate(ENCODERS):
            ratio = float(abs(factors[k] / factors[1 - k]))
            if abs(math.log(ratio)) < 0.3:
                continue
            other = ENCODERS[1 - k]
            words = (
                f"{name} is {ratio:.2g} times as fast as {other} when the robot drives straight: "
                "it is in another unit, or loses samples"
            )
            yield Idea("scale", (name,), words, e.but({name: sides[k] / ratio}), 2.0, parts=True)


def drifting_scale(e: Evidence) -> Iterator[Idea]:
    """A way by the pose that is told by a factor that grows through the log."""
    speeds, _ = e.told
    for names, sensor in ((("x", "y"), "pose"), (ENCODERS, "wheels")):
        others = [name for name in ("wheels", "odom", "cmd", "pose") if name in speeds]
        others = [name for name in others if name != sensor]
        if sensor not in speeds or not others:
            continue
        a, b = speeds[sensor], speeds[others[0]]
        share = np.linspace(-0.5, 0.5, len(a))
        flat, steep = _fit([b, share * b], a)
        if abs(flat) < 1e-9 or abs(steep / flat) > 1.9:
            continue
        trend = 1.0 + share * steep / flat
        times = trend[-1] / trend[0]
        words = (
            f"{' and '.join(names)} tell a way that grows to {times:.2f} times what it is at first "
            f"beside {_COLUMNS_OF['way', others[0]]}"
        )
        changed = {name: e.means[name] / trend for name in names}
        yield Idea("scale", names, words, e.but(changed), 2.0)


# ------------------------------------------------------------------------------------------ gyro
_OFFSET = 0.025
"""Offset of a gyro from which it is a fault: a sound one on tile has 0.016 [rad/s]."""
_DRIFT = 0.04
"""Change of such an offset through a log from which it is a fault [rad/s]."""


def gyro_at_rest(e: Evidence) -> Iterator[Idea]:
    """A gyro that has an offset, or drifts."""
    if "gyro_z" not in e.means:
        return
    turns = e.told[1]
    other = next((turns[name] for name in ("pose", "odom", "wheels") if name in turns), None)
    if other is None:
        return
    gyro = e.means["gyro_z"]
    trend = np.linspace(-0.5, 0.5, len(gyro))
    slope = float(_fit([np.ones(len(gyro)), trend, other], gyro)[1])
    c = float(_fit([np.ones(len(gyro)), other], gyro)[0])
    if abs(c) > _OFFSET:
        words = (
            f"gyro_z less the yaw rate is {c:.2g} rad/s throughout: the gyro has an offset; where "
            "the robot stands, `recordings convert --unbias` takes it out"
        )
        yield Idea("offset", ("gyro_z",), words, e.but({"gyro_z": gyro - c}), 1.0, parts=True)
    if abs(slope) > _DRIFT:
        words = f"gyro_z less the yaw rate grows by {slope:.2f} rad/s through the log: it drifts"
        yield Idea("drift", ("gyro_z",), words, e.but({"gyro_z": gyro - c - slope * trend}), 2.0)


# ------------------------------------------------------------------------------------------ time
def time_unit(e: Evidence) -> Iterator[Idea]:
    """Time in another unit: turns and ways of the pose are too fast by the same factor."""
    if not {*POSE_COLUMNS} <= e.means.keys():
        return
    told = dict[str, float]()
    for names in (("yaw",), ("x", "y")):
        for what, factor, by in _told(names, e):
            if by in ("imu", "wheels", "odom"):
                told.setdefault(what, factor)
    if len(told) < 2 or min(told.values()) <= 0.0:
        return
    rows = all(np.all(np.diff(group.t) == 1.0) for group in e.signals.log.groups.values())
    turn, way = told["turn"], told["way"]
    factor = turn
    if max(factor, 1.0 / factor) < 1.3 or not 0.33 < way / turn < 3.0:
        return
    changed = {name: e.means[name] / factor for name in POSE_COLUMNS}
    words = (
        f"the pose turns and drives {factor:.3g} times as fast as the other sensors say: "
        f"t is not in seconds{', but grows by one a row: it seems to count rows' * rows}"
    )
    yield Idea("clock", ("t", *POSE_COLUMNS), words, e.but(changed), 2.0)


def other_clock(e: Evidence) -> Iterator[Idea]:
    """Poses that are late by more than any delay, or later and later."""
    turns = e.signals.turns
    if turns is None or not {*POSE_COLUMNS} <= e.means.keys():
        return
    ways = {name: e.signals.ways[name] for name in POSE_COLUMNS}
    now = np.median(e.signals.windows.at["pose"] - e.signals.windows.t)
    late, alike = turns.delays(slice(None), LONGEST_S)
    best = float(late[np.argmax(alike)])
    if abs(best) > 1.5:
        order = "after" if best > 0.0 else "before"
        words = (
            f"yaw tells of turns about {abs(best):.1f} s {order} {turns.sensor}: "
            "their clocks differ, and no delay so long is taken out"
        )
        changed = e.signals.windows.means_of(ways, "pose", best - now)
        yield Idea("clock", POSE_COLUMNS, words, e.but(changed), 2.0)
    yield from _growing_delay(e)


def _growing_delay(e: Evidence) -> Iterator[Idea]:
    """Yield a clock that runs at another rate."""
    from scipy import stats  # here: it takes a tenth of a second to import

    turns = e.signals.turns
    assert turns is not None
    if np.ptp(turns.t) < 48.0:
        return
    parts = max(6, round(np.ptp(turns.t) / 20.0))
    times = []
    delays = []
    for start, stop in pairwise(np.linspace(0, len(turns.t), parts + 1).astype(int)):
        late, alike = turns.delays(slice(start, stop), LONGEST_S)
        if np.max(alike) > 0.9:
            times.append(turns.t[(start + stop) // 2])
            delays.append(late[np.argmax(alike)])
    if len(times) < max(5, parts // 2):
        return
    # Theil and Sen's: one part may tell nonsense
    slope, start, *_ = stats.theilslopes(delays, times)
    first, last = (start + slope * at for at in (times[0], times[-1]))
    if abs(last - first) < 0.3:
        return
    words = (
        f"yaw is {first:.2f} s behind {turns.sensor} at first and {last:.2f} s at last: one of "
        f"their clocks runs {100.0 * abs(slope):.1f} % faster"
    )
    ways = {name: e.signals.ways[name] for name in POSE_COLUMNS}
    t = e.signals.windows.t
    late = slope * (t - np.mean(t))
    changed = e.signals.windows.means_of(ways, "pose", late)
    yield Idea("clock", POSE_COLUMNS, words, e.but(changed), 2.0)


_LAGS = np.array(sorted(np.round(np.arange(-2.0, 2.01, 0.05), 2), key=abs))


def _motion(e: Evidence) -> FloatArray | None:
    """Return (N, 2) speeds and yaw rates by another sensor than the wheels; None without one."""
    speeds, turns = e.told
    sensor = next((name for name in ("pose", "odom", "cmd") if name in speeds), "")
    if not sensor or sensor not in turns:
        return None
    return np.column_stack([speeds[sensor], turns[sensor]])


def _best_lag(e: Evidence, ways: Mapping[str, Way]) -> float:
    """Return the delay of wheels [s] at which other sensors tell most of their rates."""
    moved = _motion(e)
    if moved is None:
        return 0.0
    known = np.isfinite(moved).all(axis=1)
    basis = np.linalg.qr(moved[known])[0]

    def rest(lag: float) -> float:
        means = e.signals.windows.means_of(ways, "wheels", lag)
        sides = np.array([side[known] for side in means.values()])
        told = np.sum((sides @ basis) ** 2, axis=1)
        return -float(np.sum(told / np.maximum(np.sum(sides**2, axis=1), 1e-12)))

    return min(_LAGS.tolist(), key=rest)


def late_side(e: Evidence) -> Iterator[Idea]:
    """One side of wheels that is late behind the other."""
    if e.signals.wheels is None or _motion(e) is None:
        return
    ways = [{name: e.signals.ways[name]} for name in ENCODERS]
    late = [_best_lag(e, way) for way in ways]
    k = int(np.argmax(np.abs(late)))
    apart = late[k] - late[1 - k]
    if abs(apart) < 0.15:
        return
    words = f"{ENCODERS[k]} is {abs(apart):.1f} s {'behind' if apart > 0 else 'ahead of'} "
    changed = dict[str, FloatArray]()
    for way, lag in zip(ways, late, strict=True):
        changed |= e.signals.windows.means_of(way, "wheels", lag)
    yield Idea("clock", ENCODERS, words + ENCODERS[1 - k], e.but(changed), 2.0)


_WIDTHS_S = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Times over which a smoothed signal may be averaged [s]."""


def smoothed(e: Evidence) -> Iterator[Idea]:
    """A signal that is averaged over seconds, or follows late as a low-pass does."""
    turns = e.told[1]
    for names, sensor in ((("gyro_z",), "imu"), (POSE_COLUMNS, "pose")):
        others = [name for name in ("imu", "pose", "wheels", "odom") if name in turns]
        others = [name for name in others if name != sensor]
        if sensor not in turns or not others:
            continue
        a, b = (np.nan_to_num(turns[name]) for name in (sensor, others[0]))
        best = dict[str, tuple[float, float, FloatArray]]()
        for width in _WIDTHS_S:
            for how, kernel in _kernels(width / e.period):
                if 3 * len(kernel) > 2 * len(a):
                    continue
                half = len(kernel) // 2
                mean = np.convolve(np.pad(b, half, mode="edge"), kernel, mode="valid")
                for shift in range(-4, 5):
                    alike = correlation(a, np.roll(mean, shift))
                    if alike > best.get(how, (0.0,))[0]:
                        best[how] = alike, width, _moved(kernel, shift)
        for how, (_, width, kernel) in best.items():
            words = (
                f"{' and '.join(names[-1:])} follows {how} of {_COLUMNS_OF['turn', others[0]]} "
                f"over some {width:g} s: it is smoothed, and fast turns are lost in it"
            )
            yield Idea("smoothed", names, words, e.but({}, {sensor: kernel}), 4.0)


def _kernels(samples: float) -> Iterator[tuple[str, FloatArray]]:
    """Yield means over so many windows, about the middle one and with a tail to the past."""
    width = max(3, 2 * round(0.5 * samples) + 1)
    yield "the mean", np.full(width, 1.0 / width)
    reach = math.ceil(4.0 * samples)
    tail = np.exp(-np.arange(reach + 1) / samples)
    yield "a low-pass", np.concatenate([np.zeros(reach), tail / tail.sum()])


def _moved(kernel: FloatArray, shift: int) -> FloatArray:
    """Return a kernel of odd length that is late by so many windows."""
    size = abs(shift)
    padded = np.pad(kernel, size)
    return np.roll(padded, shift)


# --------------------------------------------------------------------------- meanings of columns
def other_meanings(e: Evidence) -> Iterator[Idea]:
    """Columns that tell another quantity than their names say."""
    means = e.means
    for v, w in (TWIST, ODOMETRY):
        if {v, w} <= means.keys():
            words = f"{w} follows the curvature of the path: times {v} it tells the turn"
            yield Idea("curvature", (w,), words, e.but({w: means[v] * means[w]}), 1.0)
    sides = e.signals.wheels
    if {*TWIST} <= means.keys():
        left, right = (means[name] for name in TWIST)
        twist = {"cmd_v": 0.5 * (left + right), "cmd_w": 0.5 * (right - left)}
        words = "cmd_v and cmd_w follow the left and the right wheel: they command wheels"
        if sides is not None:
            size = STOCK.radius / STOCK.half_track
            twist = {"cmd_v": STOCK.radius * twist["cmd_v"], "cmd_w": size * twist["cmd_w"]}
        yield Idea("swapped", TWIST, words, e.but(twist), 1.0)
    if {"x", "y"} <= means.keys():
        group = e.signals.log.groups["pose"]
        ways = {n: (group.t, integrate_rates(group.t, group.columns[n])) for n in ("x", "y")}
        words = "the size of x and y follows the speed of the wheels: they are speeds"
        yield Idea("swapped", ("x", "y"), words, e.but(e.signals.windows.means_of(ways, "pose")))


def unsigned(e: Evidence) -> Iterator[Idea]:
    """Rates that tell no direction: never negative, although the robot drives backwards."""
    speeds, turns = e.told
    for name, sensor in (("cmd_v", "cmd"), ("odom_v", "odom")):
        values = e.signals.log.columns.get(name)
        others = [each for each in ("pose", "wheels", "odom") if each in speeds and each != sensor]
        if values is None or values.min() < -0.01 * values.max() or not others:
            continue
        sign = np.sign(np.nan_to_num(speeds[others[0]], nan=1.0))
        words = f"{name} is never negative, although the robot drives backwards: it has no sign"
        yield Idea("sign", (name,), words, e.but({name: sign * e.means[name]}), -1.0)
    raw = [e.signals.log.columns[name] for name in ENCODERS if e.signals.log.has((name,))]
    if e.signals.wheels is None or "pose" not in speeds:
        return
    if any(values.min() < -0.01 * values.max() for values in raw):
        return
    v, w = speeds["pose"], turns["pose"]
    changed = {}
    for name in ENCODERS:
        side = e.means[name]
        # a rim's speed is v -+ b w; its square is linear in these
        squares = np.column_stack([v**2, v * w, w**2])
        known = np.isfinite(squares).all(axis=1) & np.isfinite(side)
        factors = np.linalg.lstsq(squares[known], side[known] ** 2)[0]
        if factors[0] <= 0.0:
            return
        changed[name] = side * np.sign(v + 0.5 * factors[1] / factors[0] * w)
    words = (
        "enc_left and enc_right are never negative, although the pose says that wheels turned "
        "backwards: they tell no direction"
    )
    yield Idea("sign", ENCODERS, words, e.but(changed), -1.0)


def positions(e: Evidence) -> Iterator[Idea]:
    """Columns of wheels that are positions: their slopes tell the motion."""
    group = e.signals.log.groups.get("wheels")
    table = None if group is None else group.table(ENCODERS)
    if group is None or table is None or not {*ENCODERS} <= e.means.keys():
        return
    # a counter wraps by its whole range
    span = np.ptp(table, axis=0)
    wraps = np.abs(np.diff(table, axis=0)) > 0.5 * span
    wrapped = bool(np.any(wraps) and np.mean(wraps) < 0.05)
    ways = {}
    for name, values, period in zip(ENCODERS, table.T, span, strict=True):
        way = np.unwrap(values, period=period) if wrapped else values
        steps = np.abs(np.diff(way))
        if np.ptp(way) <= 0.0 or np.percentile(steps, 90.0) > 0.05 * np.ptp(way):
            return
        ways[name] = group.t, way
    words = (
        "enc_left and enc_right are positions, which add up, and not rates: their slopes tell "
        "the motion; --columns enc_left=NAME:rad (or :turns, :deg, :ticks) takes those"
    )
    if wrapped:
        words += "; and they wrap: count on instead"
    slopes = e.signals.windows.means_of(ways, "wheels", _best_lag(e, ways))
    # in whatever unit they are
    moved = _motion(e)
    if moved is not None:
        known = np.isfinite(moved).all(axis=1)
        both = np.abs(sum(each[known] for each in slopes.values()))
        size = 2.0 * np.sum(np.abs(moved[known, 0])) / max(float(np.sum(both)), 1e-12)
        slopes = {name: size / STOCK.radius * each for name, each in slopes.items()}
    kind = "counter" if wrapped else "positions"
    yield Idea(kind, ENCODERS, words, e.but(slopes), 2.0)


def single_samples(e: Evidence) -> Iterator[Idea]:
    """Counters that wrap, spikes and dropouts: single samples that no wheel reaches."""
    for name, least in (("enc_left", 5.0), ("enc_right", 5.0), ("gyro_z", 2.0)):
        group = e.signals.log.group_of((name,))
        if group is None or name not in e.means:
            continue
        values = group.columns[name]
        before, middle, after = sliding_window_view(np.pad(values, 1, "edge"), 3).T
        off = np.abs(middle - 0.5 * (before + after))
        alone = np.abs(before - after) < 0.3 * off
        spikes = alone & (off > max(8.0 * np.percentile(off, 85.0), least))
        zeros = (middle == 0.0) & (before * after > 0.25)
        lost = np.count_nonzero(zeros)
        size = np.max(off[spikes], initial=0.0)
        if lost >= 5 and lost > 0.7 * np.count_nonzero(spikes):
            spikes = zeros
            kind = "spikes"
            words = (
                f"{name} falls to zero for single samples, {lost} times: lost messages stand as "
                "zeros; leave them out"
            )
        elif np.count_nonzero(spikes) >= 3:
            wraps = np.ptp(off[spikes]) < 0.1 * size and size > 20.0 * least
            kind = "counter" if wraps else "spikes"
            why = "a counter wraps" if wraps else "no wheel does that"
            words = (
                f"{name} jumps for single samples, {np.count_nonzero(spikes)} times, by {size:.3g} "
                f"rad/s within {1e3 * group.period:.0f} ms: {why}"
            )
        else:
            continue
        t = group.t[~spikes]
        way = {name: (t, integrate_rates(t, values[~spikes]))}
        changed = e.signals.windows.means_of(way, column_of(name).group)
        yield Idea(kind, (name,), words, e.but(changed), 2.0)


def corrections(e: Evidence) -> Iterator[Idea]:
    """Steps of the pose that no wheel made, too small to be jumps of any log."""
    poses = e.signals.poses
    if poses is None or len(poses.t) < 40 or not {*POSE_COLUMNS} <= e.means.keys():
        return
    steps = np.diff(poses.pose[:, :2], axis=0)
    near = sliding_window_view(np.pad(steps, ((2, 2), (0, 0)), mode="edge"), 5, axis=0)
    off = steps - np.median(near, axis=-1)
    size = np.hypot(*off.T)
    at = size > max(_OUTSTANDS * float(np.median(size)), 0.03)
    known = e.signals.jumps
    if known is not None:
        at &= ~np.isin(poses.rows[1:], known.index)
    n = int(np.count_nonzero(at))
    if not 0 < n < 0.02 * len(at):
        return
    moved = np.cumulative_sum(np.where(at[:, None], off, 0.0), axis=0, include_initial=True)
    ways = {name: (poses.t, poses.pose[:, k] - moved[:, k]) for k, name in enumerate(("x", "y"))}
    words = (
        f"x and y make {n} step{'s' * (n > 1)} of {np.median(size[at]):.2g} m, the first at "
        f"{poses.t[1:][at][0]:.1f} s, that no wheel made: the localiser corrects itself"
    )
    changed = e.signals.windows.means_of(ways, "pose")
    yield Idea("jumps", ("x", "y"), words, e.but(changed), 1.0)


_OUTSTANDS = 12.0
"""Size of a correction over the median difference between a step and those beside it [1]."""


# ------------------------------------------------------------------------------- tells nothing
def clipped(e: Evidence) -> Iterator[Idea]:
    """Rates that stay at a bound where the motion is beyond it."""
    speeds, turns = e.told
    changed = {}
    levels = []
    for name, design in (
        *((name, [speeds.get("pose"), turns.get("imu", turns.get("pose"))]) for name in ENCODERS),
        ("gyro_z", [turns.get("pose", turns.get("wheels"))]),
    ):
        group = e.signals.log.group_of((name,))
        others = [each for each in design if each is not None]
        if group is None or name not in e.means or len(others) < len(design):
            continue
        values = group.columns[name]
        most = float(np.max(np.abs(values)))
        at = (np.abs(values) > (1.0 - 1e-4) * most).astype(np.float64)
        if most <= 0.0 or np.mean(at) < 0.02:
            continue
        way = {name: (group.t, integrate_rates(group.t, at))}
        share = e.signals.windows.means_of(way, column_of(name).group)[name]
        mean = e.means[name]
        free = np.where(share < 0.01, mean, math.nan)
        told = np.column_stack(others) @ _fit(others, free)
        # what would be beyond the bound is explained, whatever it is
        beyond = (share > 0.01) & (told * np.sign(mean) > 0.95 * np.abs(mean))
        changed[name] = np.where(beyond, told, mean)
        levels.append(most)
    for blamed in (ENCODERS, ("gyro_z",)):
        own = [name for name in blamed if name in changed]
        if own:
            words = (
                f"{' and '.join(own)} stay{'s' * (len(own) == 1)} at +-{max(levels):.3g} "
                "rad/s where the other signals say more: clipped"
            )
            after = e.but({name: changed[name] for name in own})
            yield Idea("clipped", tuple(own), words, after, 2.0)


_SLIPPED = 1.2
"""Cost of each window in which wheels slip: a residual of 1.5 times the noise."""


def slipping(e: Evidence) -> Iterator[Idea]:
    """Wheels that turn while the robot stands, or stand while it moves."""
    speeds, turns = e.told
    if e.signals.wheels is None or "pose" not in speeds:
        return
    moved = [speeds["pose"], turns["pose"]]
    sides = np.array([e.means[name] for name in ENCODERS])
    told = np.array([np.column_stack(moved) @ _fit(moved, side) for side in sides])
    known = np.isfinite(told).all(axis=0) & np.isfinite(sides).all(axis=0)
    if not np.any(known):
        return
    size = np.percentile(np.abs(sides[:, known]), 80.0)
    off = np.abs(sides - told)
    more = np.abs(sides) - np.abs(told)
    slips = off > np.maximum(0.35 * np.maximum(np.abs(sides), np.abs(told)), 0.25 * size)
    fast = slips & (more > 0.0)
    for columns, where in (
        (ENCODERS[:1], fast[0] & ~slips[1]),
        (ENCODERS[1:], fast[1] & ~slips[0]),
        (ENCODERS, slips.any(axis=0)),
    ):
        where = where & known
        if np.count_nonzero(where) < 8:
            continue
        share = 100.0 * np.mean(where)
        if len(columns) == 1:
            words = (
                f"{columns[0]} turns faster than the robot moves in {share:.0f} % of the time, "
                "and the other side does not: its wheels slip, or are lifted"
            )
        elif np.median(more.sum(axis=0)[where]) > 0.0:
            words = (
                f"the wheels turn in {share:.0f} % of the time in another way than the robot "
                "moves: they slip"
            )
        else:
            words = (
                f"the robot moves in {share:.0f} % of the time although its wheels stand: is it "
                "pushed or carried?"
            )
        own = [ENCODERS.index(name) for name in columns]
        changed = {ENCODERS[k]: np.where(where, told[k], sides[k]) for k in own}
        # each window costs as much as if nothing were told in it
        freedom = 3.0 + _SLIPPED * np.count_nonzero(where) / math.log(len(where))
        yield Idea("slip", columns, words, e.but(changed), freedom)


def unrelated(e: Evidence) -> Iterator[Idea]:
    """Signals that resemble nothing that the robot did: no more than at another time."""
    for sensor, names in (("cmd", TWIST), ("imu", ("gyro_z",)), ("odom", ODOMETRY)):
        if not {*names} <= e.means.keys():
            continue
        n = len(e.signals.windows.t)
        at_random = []
        for share in (0.25, 0.4, 0.55, 0.7):
            rolled = e.but({name: np.roll(e.means[name], round(share * n)) for name in names})
            costs = [pair.cost for pair in rolled.pairs if sensor in (pair.a, pair.b)]
            at_random.append(np.nanmean(np.concatenate([*costs, [0.0]])))
        nothing = e.but({name: np.full(n, math.nan) for name in names})
        words = f"{_seem(names)} to be another axis or quantity: the other columns resemble one "
        words += "another, and not this"
        kind = "swapped"
        if sensor == "cmd":
            words = f"{' and '.join(names)} resemble nothing that the robot did: they may be those "
            words += "of another drive"
            kind = "unrelated"
        after = replace(nothing, untold=0.6 * float(np.median(at_random)))
        yield Idea(kind, names, words, after, 1.0)


ROWS: Sequence[Callable[[Evidence], Iterator[Idea]]] = (
    *(swaps, turned_path, units, one_axis, drifting_scale, gyro_at_rest, time_unit, other_clock),
    *(late_side, smoothed, other_meanings, unsigned, positions, single_samples, clipped),
    *(corrections, slipping, unrelated),
)
"""The hypotheses."""


# ------------------------------------------------------------------------------------------ judge
_LEAST = 8.0
"""Gain from which something is no accident [nats]."""
_LEAST_EACH = 0.05
"""The same of each window of the log."""
_WHOLE = 0.85
"""Share of a log from which a span is the whole."""
_EXPLAINED = 0.5
"""Share of what is left over that a hypothesis may leave."""
_ORDINARY = 0.3
"""Cost of a pair of sound signals in a window."""
_TIE = 0.1
"""Share of the best gain by which the second one must be worse."""
_MOST_FAULTS = 3


class Verdict(NamedTuple):
    """A hypothesis and how much it explains."""

    gain: float
    idea: Idea
    span: slice
    """Windows for which it holds."""


def verdicts(e: Evidence) -> list[Verdict]:
    """Return the hypotheses by what they explain, the best first."""
    found = []
    n = len(e.signals.windows.t)
    for row in ROWS:
        for idea in row(e):
            gains = 0.5 * idea.after.gain_over(e)  # windows overlap by half
            span = _best_span(gains) if idea.parts else slice(0, n)
            if span.stop - span.start > _WHOLE * n:
                span = slice(0, n)
            partly = span.stop - span.start < n
            price = 4.0 + 0.5 * math.log(n) * (idea.freedom + 2.0 * partly)
            gain = float(gains[span].sum()) - price
            if gain > max(_LEAST, _LEAST_EACH * n) and _explains(e, idea, span):
                found.append(Verdict(gain, idea, span))
    return sorted(found, key=lambda v: -v.gain)


def _explains(e: Evidence, idea: Idea, span: slice) -> bool:
    """Return whether little is left over between the signals that a hypothesis changes."""
    changed = [k for k, pair in enumerate(e.pairs) if pair is not idea.after.pairs[k]]
    before = float(np.mean(np.nan_to_num(e.costs)[changed, span]))
    left = float(np.mean(np.nan_to_num(idea.after.costs)[changed, span]))
    partly = span.stop - span.start < e.costs.shape[1]
    return bool(left < max((_EXPLAINED / 2.0 if partly else _EXPLAINED) * before, _ORDINARY))


def _best_span(gains: FloatArray) -> slice:
    """Return the windows in a row whose gains have the greatest sum."""
    so_far = np.cumulative_sum(gains, include_initial=True)
    low = np.minimum.accumulate(so_far)
    stop = int(np.argmax(so_far - low))
    start = int(np.argmin(so_far[: stop + 1]))
    return slice(start, stop)


def _corrected(e: Evidence, best: Verdict) -> Evidence:
    """Return what a log tells with the mistake undone where it was made."""
    inside = np.zeros(len(e.signals.windows.t), dtype=bool)
    inside[best.span] = True
    changed = {}
    for name, values in best.idea.after.means.items():
        if values is not e.means[name]:
            changed[name] = np.where(inside, values, e.means[name])
    after = e.but(changed, best.idea.after.kernels)
    return replace(after, untold=best.idea.after.untold)


def judged(signals: Signals) -> Iterator[LogFault]:
    """Yield what the signals of a log show to be wrong."""
    if not signals.means:
        return
    e = Evidence.of_log(signals)
    if not e.pairs:
        return
    blamed = set[str]()
    for _ in range(_MOST_FAULTS):
        found = [v for v in verdicts(e) if not blamed & {*v.idea.columns}]
        if not found:
            break
        best = found[0]
        rivals = {best.idea.columns: best}
        for other in found[1:]:
            near = other.gain > (1.0 - _TIE) * best.gain
            if near and not {*best.idea.columns} & {*other.idea.columns}:
                rivals.setdefault(other.idea.columns, other)
        yield _fault(signals, list(rivals.values()))
        if "t" in best.idea.columns:
            return  # whatever else there is, is of that
        blamed |= {*chain(*rivals)}
        e = _corrected(e, best)


def _fault(signals: Signals, rivals: Sequence[Verdict]) -> LogFault:
    """Return the fault of one hypothesis, or of several that are as good."""
    best = rivals[0]
    t = signals.windows.t
    start = end = None
    when = ""
    if best.span.stop - best.span.start < len(t):
        start, end = float(t[best.span.start]), float(t[best.span.stop - 1])
        when = f" from {start:.0f} to {end:.0f} s"
        if best.span.stop == len(t):
            when = f" from {start:.0f} s on"
    words = ", or ".join(v.idea.words for v in rivals)
    kinds = {v.idea.kind for v in rivals}
    kind = best.idea.kind if len(kinds) == 1 else "disagree"
    if len(rivals) > 1:
        words += "; the log cannot say which"
    columns = tuple(dict.fromkeys(chain(*(v.idea.columns for v in rivals))))
    return LogFault(kind, columns, f"{words}{when and f';{when}'}", start, end)
