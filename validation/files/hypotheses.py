"""What may be wrong in a log: hypotheses that compete to explain it.

Each changes some columns, by which one mistake is undone, for the whole log or for a part of it.
The one after which all signals agree best is named, if it beats those that blame other columns by
enough; else the log cannot say which of them is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.files.agreement import Agreement, is_ordinary
from validation.files.columns import POSE_COLUMNS, UNITS, column_of
from validation.files.motion import ENCODERS, ODOMETRY, RATES, STOCK, TWIST, Way
from validation.files.sensors import FEWEST_WINDOWS, LONGEST_S
from validation.files.signals import correlation, sturdy_fit


class Idea(NamedTuple):
    """A hypothesis, as far as a log tells it."""

    kind: str
    columns: tuple[str, ...]
    """Columns that it blames."""
    words: str
    """Sentence on it."""
    after: Agreement
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


def _swapped_columns(e: Agreement) -> Iterator[Idea]:
    """Signs, places and frames."""
    for swap in _list_swaps():
        if not swap.sources.keys() <= e.means.keys():
            continue
        changed = {}
        for name, (source, factor) in swap.sources.items():
            changed[name] = factor * e.means[source]
        if "yaw" in swap.sources:
            changed["heading"] = swap.sources["yaw"][1] * e.means["heading"] + swap.rotation
        words = f"{seem(swap.columns)} {swap.words}"
        yield Idea(swap.kind, swap.columns, words, e.but(changed), 1.0, parts=True)


def seem(names: Sequence[str]) -> str:
    """Return the subject and the verb of a sentence on columns."""
    return f"{' and '.join(names)} seem{'s' * (len(names) == 1)}"


def _turned_path(e: Agreement) -> Iterator[Idea]:
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


def _way_of_others(e: Agreement, sensor: str, otherwise: FloatArray) -> FloatArray:
    """Return the speed by another sensor, or what stands for it where there is none."""
    speeds = e.told[0]
    others = [name for name in ("pose", "odom", "wheels", "cmd") if name in speeds]
    told = next((speeds[name] for name in others if name != sensor), otherwise)
    return np.where(np.isfinite(told), told, otherwise)


def fit_factors(columns: Sequence[FloatArray], values: FloatArray) -> FloatArray:
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


def _told(names: tuple[str, ...], e: Agreement) -> Iterator[tuple[str, float, str]]:
    """Yield by each pair what columns tell, their factor, and by which sensor that is told."""
    for what, sensor in _SENSORS[names]:
        for pair in e.pairs:
            if pair.what == what and sensor in (pair.a, pair.b):
                first = sensor == pair.a
                other = pair.b if first else pair.a
                yield what, (pair.factor if first else 1.0 / pair.factor), other


def _other_units(e: Agreement) -> Iterator[Idea]:
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
    names: tuple[str, ...], told: Sequence[tuple[str, float, str]], factor: float, e: Agreement
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


def _one_axis(e: Agreement) -> Iterator[Idea]:
    """One of x and y in another unit, or one of the two sides of wheels."""
    speeds, turns = e.told
    way = next((speeds[name] for name in ("odom", "wheels", "cmd") if name in speeds), None)
    if way is not None and {"x", "y"} <= e.means.keys():
        sizes = fit_factors([e.means["x"] ** 2, e.means["y"] ** 2], way**2)
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
    factors = np.array([fit_factors([speeds["pose"], turns["pose"]], side)[0] for side in sides])
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


def _drifting_scale(e: Agreement) -> Iterator[Idea]:
    """A way by the pose that is told by a factor that grows through the log."""
    speeds, _ = e.told
    for names, sensor in ((("x", "y"), "pose"), (ENCODERS, "wheels")):
        others = [name for name in ("wheels", "odom", "cmd", "pose") if name in speeds]
        others = [name for name in others if name != sensor]
        if sensor not in speeds or not others:
            continue
        a, b = speeds[sensor], speeds[others[0]]
        share = np.linspace(-0.5, 0.5, len(a))
        flat, steep = fit_factors([b, share * b], a)
        if abs(flat) < 1e-9 or abs(steep / flat) > 1.9:
            continue
        trend = 1.0 + share * steep / flat
        times = trend[-1] / trend[0]
        words = (
            f"{' and '.join(names)} tell a way that grows to {times:.2f} times what it is at first "
            f"beside {_COLUMNS_OF['way', others[0]]}"
        )
        # a factor that it has from the first on is another cause
        changed = {name: e.means[name] * trend[0] / trend for name in names}
        yield Idea("scale", names, words, e.but(changed), 2.0)


# ------------------------------------------------------------------------------------------ gyro
_OFFSET = 0.025
"""Offset of a gyro from which it is a fault: a sound one on tile has 0.016 [rad/s]."""
_DRIFT = 0.04
"""Change of such an offset through a log from which it is a fault [rad/s]."""


def _gyro_at_rest(e: Agreement) -> Iterator[Idea]:
    """A gyro that has an offset, or drifts."""
    if "gyro_z" not in e.means:
        return
    turns = e.told[1]
    other = next((turns[name] for name in ("pose", "odom", "wheels") if name in turns), None)
    if other is None:
        return
    gyro = e.means["gyro_z"]
    trend = np.linspace(-0.5, 0.5, len(gyro))
    slope = float(fit_factors([np.ones(len(gyro)), trend, other], gyro)[1])
    c = float(fit_factors([np.ones(len(gyro)), other], gyro)[0])
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
def _time_unit(e: Agreement) -> Iterator[Idea]:
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
    yield Idea("clock", ("t", *POSE_COLUMNS), words, e.but(changed), 2.0 if rows else 4.0)


def _other_clock(e: Agreement) -> Iterator[Idea]:
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


def _growing_delay(e: Agreement) -> Iterator[Idea]:
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


def other_motion(e: Agreement) -> FloatArray | None:
    """Return (N, 2) speeds and yaw rates by another sensor than the wheels; None without one."""
    speeds, turns = e.told
    sensor = next((name for name in ("pose", "odom", "cmd") if name in speeds), "")
    if not sensor or sensor not in turns:
        return None
    return np.column_stack([speeds[sensor], turns[sensor]])


def best_lag(e: Agreement, ways: Mapping[str, Way]) -> float:
    """Return the delay of wheels [s] at which other sensors tell most of their rates."""
    moved = other_motion(e)
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


def _late_side(e: Agreement) -> Iterator[Idea]:
    """One side of wheels that is late behind the other."""
    if e.signals.wheels is None or other_motion(e) is None:
        return
    ways = [{name: e.signals.ways[name]} for name in ENCODERS]
    late = [best_lag(e, way) for way in ways]
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


def _smoothed_signals(e: Agreement) -> Iterator[Idea]:
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


SIGNS_UNITS_AND_CLOCKS = (
    _swapped_columns,
    _turned_path,
    _other_units,
    _one_axis,
    _drifting_scale,
    _gyro_at_rest,
    _time_unit,
    _other_clock,
    _late_side,
    _smoothed_signals,
)
"""The hypotheses on signs, places, frames, units and time."""
