"""The explanation of a log: the hypothesis after which its signals agree best.

Those of `hypotheses` on signs, units and clocks compete with these, on what columns mean and on
samples that tell nothing. One is named if it beats those that blame other columns by enough; else
the log cannot say which of them is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr.geometry import integrate_rates
from ssmr.types import FloatArray, IndexArray
from validation.files.agreement import Agreement
from validation.files.columns import POSE_COLUMNS, column_of
from validation.files.hypotheses import (
    SIGNS_UNITS_AND_CLOCKS,
    Idea,
    best_lag,
    fit_factors,
    other_motion,
    seem,
)
from validation.files.log import LogFault
from validation.files.motion import ENCODERS, ODOMETRY, STOCK, TWIST
from validation.files.sensors import FEWEST_WINDOWS, Signals


# --------------------------------------------------------------------------- meanings of columns
def _other_meanings(e: Agreement) -> Iterator[Idea]:
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


def _unsigned_rates(e: Agreement) -> Iterator[Idea]:
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


def _positions_of_wheels(e: Agreement) -> Iterator[Idea]:
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
    slopes = e.signals.windows.means_of(ways, "wheels", best_lag(e, ways))
    # in whatever unit they are
    moved = other_motion(e)
    if moved is not None:
        known = np.isfinite(moved).all(axis=1)
        both = np.abs(sum(each[known] for each in slopes.values()))
        size = 2.0 * np.sum(np.abs(moved[known, 0])) / max(float(np.sum(both)), 1e-12)
        slopes = {name: size / STOCK.radius * each for name, each in slopes.items()}
    kind = "counter" if wrapped else "positions"
    yield Idea(kind, ENCODERS, words, e.but(slopes), 2.0)


_LOST_IN_A_ROW = 8
"""Samples from one told rate to the next between which others are lost."""


def _single_samples(e: Agreement) -> Iterator[Idea]:
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
        # zeros, one or a few in a row, between rates of one sign
        told = np.flatnonzero(values != 0.0)
        after_it = np.searchsorted(told, np.arange(len(values)))
        last = told[np.clip(after_it - 1, 0, len(told) - 1)] if len(told) else after_it
        later = told[np.clip(after_it, 0, len(told) - 1)] if len(told) else after_it
        zeros = (middle == 0.0) & (later - last < _LOST_IN_A_ROW) & (later > last)
        zeros &= values[last] * values[later] > 0.25
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


def _small_jumps(e: Agreement) -> Iterator[Idea]:
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
def _clipped_rates(e: Agreement) -> Iterator[Idea]:
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
        told = np.column_stack(others) @ fit_factors(others, free)
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


def _slipping_wheels(e: Agreement) -> Iterator[Idea]:
    """Wheels that turn while the robot stands, or stand while it moves."""
    speeds, turns = e.told
    if e.signals.wheels is None or "pose" not in speeds:
        return
    moved = [speeds["pose"], turns["pose"]]
    sides = np.array([e.means[name] for name in ENCODERS])
    told = np.array([np.column_stack(moved) @ fit_factors(moved, side) for side in sides])
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


def _unrelated_signals(e: Agreement) -> Iterator[Idea]:
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
        words = f"{seem(names)} to be another axis or quantity: the other columns resemble one "
        words += "another, and not this"
        kind = "swapped"
        if sensor == "cmd":
            words = f"{' and '.join(names)} resemble nothing that the robot did: they may be those "
            words += "of another drive"
            kind = "unrelated"
        after = replace(nothing, untold=0.6 * float(np.median(at_random)))
        yield Idea(kind, names, words, after, 1.0)


_MEANINGS = (
    _other_meanings,
    _unsigned_rates,
    _positions_of_wheels,
    _single_samples,
    _clipped_rates,
    _small_jumps,
    _slipping_wheels,
    _unrelated_signals,
)
"""The hypotheses on meanings and on samples."""


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


class Explanation(NamedTuple):
    """A hypothesis and how much it explains."""

    gain: float
    idea: Idea
    span: slice
    """Windows for which it holds."""


def explanations(e: Agreement) -> list[Explanation]:
    """Return the hypotheses by what they explain, the best first."""
    found = []
    n = len(e.signals.windows.t)
    for row in (*SIGNS_UNITS_AND_CLOCKS, *_MEANINGS):
        for idea in row(e):
            gains = 0.5 * idea.after.gain_over(e)  # windows overlap by half
            span = _best_span(gains) if idea.parts else slice(0, n)
            if span.stop - span.start > _WHOLE * n:
                span = slice(0, n)
            partly = span.stop - span.start < n
            price = 4.0 + 0.5 * math.log(n) * (idea.freedom + 2.0 * partly)
            gain = float(gains[span].sum()) - price
            if gain > max(_LEAST, _LEAST_EACH * n) and _explains_span(e, idea, span):
                found.append(Explanation(gain, idea, span))
    return sorted(found, key=lambda v: -v.gain)


def _explains_span(e: Agreement, idea: Idea, span: slice) -> bool:
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


def _correct_signals(e: Agreement, best: Explanation) -> Agreement:
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
    e = Agreement.of_log(signals)
    if not e.pairs:
        return
    blamed = set[str]()
    for _ in range(_MOST_FAULTS):
        found = [v for v in explanations(e) if not blamed & {*v.idea.columns}]
        if not found:
            break
        best = found[0]
        rivals = {best.idea.columns: best}
        for other in found[1:]:
            near = other.gain > (1.0 - _TIE) * best.gain
            if near and not {*best.idea.columns} & {*other.idea.columns}:
                rivals.setdefault(other.idea.columns, other)
        yield _make_fault(signals, list(rivals.values()))
        if "t" in best.idea.columns:
            return  # whatever else there is, is of that
        blamed |= {*chain(*rivals)}
        e = _correct_signals(e, best)


def _make_fault(signals: Signals, rivals: Sequence[Explanation]) -> LogFault:
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


# ------------------------------------------------------------------------------------------ parts
_PART_S = 10.0
"""Length of a part of a log [s]; those of a long log are longer."""
_MOST_PARTS = 40
"""Most parts of a log."""
_SURE = 0.9
"""Correlation from which a part tells a delay [1]."""
_DRIVES = 0.05
"""Speed from which a part tells radii [m/s]."""
_TURNS = 0.1
"""Mean yaw rate from which it tells a width [rad/s]."""


def find_parts(signals: Signals) -> list[dict[str, Any]]:
    """Return what each part of a log tells of the robot, as the JSON file has it.

    Rows have `from_s`, `to_s`, `wheel_radius_left`, `wheel_radius_right`, `half_track` [m],
    `delay_s`, how late headings are behind gyro or wheels, and `residuals` by signal, over its
    ordinary noise; None for what a part does not tell.
    """
    t = signals.windows.t
    if not len(t):
        return []
    agreement = Agreement.of_log(signals)
    n = min(_MOST_PARTS, max(1, round(float(np.ptp(t)) / _PART_S)))
    parts = []
    for start, stop in pairwise(np.linspace(t[0], t[-1] + 1e-6, n + 1)):
        inside = np.flatnonzero((t >= start) & (t < stop))
        if not len(inside):
            continue
        left, right, half_track = _sizes_of_part(agreement, inside)
        parts.append(
            {
                "from_s": float(start),
                "to_s": float(stop),
                "wheel_radius_left": left,
                "wheel_radius_right": right,
                "half_track": half_track,
                "delay_s": _delay_of_part(signals, start, stop),
                "residuals": _residuals_of_part(agreement, inside),
            }
        )
    return parts


def _sizes_of_part(e: Agreement, inside: IndexArray) -> tuple[float | None, ...]:
    """Return both radii and the effective half-track [m] in some windows; None where untold."""
    speeds, turns = e.told
    if e.signals.wheels is None or "pose" not in speeds or len(inside) < 4:
        return None, None, None
    v = speeds["pose"][inside]
    w = turns.get("imu", turns["pose"])[inside]
    left, right = e.signals.wheels[:, inside]
    zero = np.zeros(len(v))
    # r_l l + b w = v, and r_r r - b w = v
    rows = np.concatenate([np.column_stack([left, zero, w]), np.column_stack([zero, right, -w])])
    if np.sqrt(np.mean(v**2)) < _DRIVES:
        return None, None, None
    turns_enough = float(np.mean(np.abs(w))) > _TURNS
    known = rows if turns_enough else rows[:, :2]
    sizes = np.linalg.lstsq(known, np.concatenate([v, v]))[0].tolist()
    return sizes[0], sizes[1], sizes[2] if turns_enough else None


def _delay_of_part(signals: Signals, start: float, stop: float) -> float | None:
    """Return how late headings are behind gyro or wheels in a part [s]; None where untold."""
    turns = signals.turns
    if turns is None:
        return None
    part = slice(*np.searchsorted(turns.t, (start, stop)).tolist())
    if part.stop - part.start < 2 * FEWEST_WINDOWS:
        return None
    late, alike = turns.delays(part, 1.5)
    best = int(np.argmax(alike))
    if alike[best] < _SURE or best in (0, len(late) - 1):
        return None
    # the vertex of the parabola through the best three
    before, at, after = alike[best - 1 : best + 2]
    bend = min(before - 2.0 * at + after, -1e-12)
    return float(late[best] + 0.5 * (before - after) / bend * (late[1] - late[0]))


def _residuals_of_part(e: Agreement, inside: IndexArray) -> dict[str, float | None]:
    """Return by signal what is left over beside the others, over its noise, in the median."""
    names = {"imu": "gyro", "pose": "pose", "odom": "odometry", "wheels": "wheels"}
    found = dict[str, float | None]()
    for sensor, name in {**names, "cmd": "commands"}.items():
        costs = [pair.cost[inside] for pair in e.pairs if sensor in (pair.a, pair.b)]
        told = np.concatenate([*costs, []])
        told = told[np.isfinite(told)]
        if costs:
            found[name] = float(np.sqrt(np.expm1(np.median(told)))) if len(told) else None
    return found
