"""The explanation of a log: the hypothesis after which its signals agree best.

It is named if it beats those that blame other columns by enough; else the log cannot say which of
them is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr.geometry import integrate_rates
from ssmr.types import FloatArray, IndexArray
from validation.files.agreement import UNTOLD, Agreement, fit_factors
from validation.files.columns import POSE_COLUMNS, column_of
from validation.files.hypotheses import (
    GYRO,
    MISTAKES,
    PLACE,
    UNITS_ALONE,
    Blamed,
    Idea,
    Mistake,
    find_delays,
    join_names,
    list_bases,
    list_sensors,
    offer_unit,
)
from validation.files.log import LogFault
from validation.files.motion import ENCODERS, ODOMETRY, STOCK, TWIST, Way
from validation.files.plain_faults import stuck_samples
from validation.files.sensors import Signals

# ------------------------------------------------------------------------------------------ samples
_LOST_IN_A_ROW = 8
"""Samples from one told rate to the next between which others are lost."""


def _without_zeros(t: FloatArray, values: FloatArray) -> tuple[Way, str] | None:
    """Zeros, one or a few in a row, between rates of one sign."""
    told = np.flatnonzero(values != 0.0)
    if not len(told):
        return None
    after = np.searchsorted(told, np.arange(len(values)))
    last, later = told[np.clip([after - 1, after], 0, len(told) - 1)]
    lost = (values == 0.0) & (later - last < _LOST_IN_A_ROW) & (values[last] * values[later] > 0.0)
    n = np.count_nonzero(lost)
    way = t[~lost], integrate_rates(t[~lost], values[~lost])
    words = f"zero for single samples, {n} times: lost messages stand as zeros; leave them out"
    return (way, words) if n > max(5.0, 0.01 * len(values)) else None


def _without_spikes(t: FloatArray, values: FloatArray) -> tuple[Way, str] | None:
    """Single samples that no robot reaches."""
    before, middle, after = sliding_window_view(np.pad(values, 1, "edge"), 3).T
    off = np.abs(middle - 0.5 * (before + after))
    spikes = off > max(8.0 * float(np.percentile(off, 85.0)), 0.5 * float(np.std(values)))
    spikes &= np.abs(before - after) < 0.3 * off
    n = np.count_nonzero(spikes)
    words = (
        f"beside itself for single samples, {n} times, by {np.max(off[spikes], initial=0.0):.3g} "
        "within a sample: nothing does that"
    )
    way = t[~spikes], integrate_rates(t[~spikes], values[~spikes])
    return (way, words) if 3 <= n < 0.2 * len(values) else None


def _unwrap_rates(t: FloatArray, values: FloatArray) -> tuple[Way, str] | None:
    """Rates that go on at the other end of their range."""
    period = float(np.ptp(values))
    n = np.count_nonzero(np.abs(np.diff(values)) > 0.5 * period)
    beyond = np.unwrap(values, period=period or 1.0) - values
    # most samples are within the range, though the first one may not be
    way = t, integrate_rates(t, values + beyond - np.median(beyond))
    words = f"at the other end of its range of {period:.3g} {n} times: a counter wraps"
    return (way, words) if n >= 3 else None


def _positions_as_rates(t: FloatArray, values: FloatArray) -> tuple[Way, str] | None:
    """Positions, which add up."""
    span = float(np.ptp(values))
    if np.percentile(np.abs(np.diff(values)), 90.0) >= 0.05 * span:
        return None
    wraps = np.count_nonzero(np.abs(np.diff(values)) > 0.5 * span)
    words = "a position, which adds up, and not a rate: its slope tells the motion"
    words += "; it wraps, and is then counted on" * bool(wraps)
    return (t, np.unwrap(values, period=span)), words


def _summed_speeds(t: FloatArray, values: FloatArray) -> tuple[Way, str]:
    """Positions that are speeds."""
    return (t, integrate_rates(t, values)), "a speed, and no position"


_FOLLOWS = 0.6
"""Share of the slopes of positions that others explain, at least [1]."""
_Reading = Callable[[FloatArray, FloatArray], tuple[Way, str] | None]
_READINGS: Sequence[tuple[str, _Reading]] = (
    ("spikes", _without_zeros),
    ("spikes", _without_spikes),
    ("counter", _unwrap_rates),
    ("positions", _positions_as_rates),
    ("swapped", _summed_speeds),
)
"""Kinds, and how samples of columns are read instead."""


def _other_readings(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Blamed whose samples mean something else, or nothing at times."""
    group = e.signals.log.groups[column_of(names[0]).group]
    for kind, read in _READINGS:
        if (kind == "swapped") != (names == PLACE):
            continue
        found = {name: read(group.t, group.columns[name]) for name in names}
        ways = {name: each[0] for name, each in found.items() if each is not None}
        said = [each[1] for each in found.values() if each is not None]
        if not ways or (kind == "positions" and len(ways) < len(names)):
            continue
        words = f"{' and '.join(ways)}: {said[0]}"
        late = 0.0
        if kind in ("positions", "counter"):
            # the delay of the group was that of other readings
            (late,), (sure,) = find_delays(e, ways, [0])
            if not sure > _FOLLOWS:
                continue
        changed = dict(e.signals.windows.means_of(ways, column_of(names[0]).group, late))
        if kind == "positions":
            # in whatever unit they are
            wheel = e.signals.radius or STOCK.radius
            ticks = []
            for name, basis in list_bases(e, names).items():
                slope = fit_factors(basis, changed[name])[0] or 1.0
                changed[name] = changed[name] / (slope * (wheel if name in ENCODERS else 1.0))
                ticks.append(math.tau * wheel * abs(slope))
            size = np.mean(ticks)
            turn = (
                f" --ticks-per-turn {float(f'{size:.3g}'):g} (the sides differ by "
                f"{np.ptp(ticks) / size:.1%}; for wheels of {wheel:.3g} m that do not slip; "
                "6.28 is that of :rad, 360 of :deg)"
            )
            words += offer_unit(e, names, "ticks", turn) if names == ENCODERS else ""
        kind_said = "counter" if "wraps" in said[0] else kind
        yield Idea(kind_said, (*ways,), words, e.but(changed), 2.0)


_OUTSTANDS = 12.0
"""Size of a correction over the median difference between a step and those beside it [1]."""


def _small_jumps(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Steps of the pose that no wheel made, too small to be jumps of any log."""
    from scipy import ndimage  # here: it takes a tenth of a second to import

    poses = e.signals.poses
    if poses is None or len(poses.t) < 40:
        return
    steps = np.diff(poses.pose[:, :2], axis=0)
    off = steps - ndimage.median_filter(steps, (5, 1), mode="nearest")
    size = np.hypot(*off.T)
    at = size > max(_OUTSTANDS * float(np.median(size)), 0.03)
    if e.signals.jumps is not None:
        at &= ~np.isin(poses.rows[1:], e.signals.jumps.index)
    n = int(np.count_nonzero(at))
    if not 0 < n < 0.02 * len(at):
        return
    moved = np.cumulative_sum(np.where(at[:, None], off, 0.0), axis=0, include_initial=True)
    ways = {name: (poses.t, poses.pose[:, k] - moved[:, k]) for k, name in enumerate(names)}
    words = (
        f"x and y make {n} step{'s' * (n > 1)} of {np.median(size[at]):.2g} m, the first at "
        f"{poses.t[1:][at][0]:.1f} s, that no wheel made: the localiser corrects itself"
    )
    yield Idea("jumps", names, words, e.but(e.signals.windows.means_of(ways, "pose")))


# ------------------------------------------------------------------------------- tells nothing
_TOUCHED = 0.01
"""Share of a window from which it is one of those in which a column is stuck [1]."""
_ROUNDS = 8
"""Rounds in which others tell what lies beyond a bound, and what does not tells their factors."""


def _stuck_columns(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Rates that stay at a bound, or the same for a while, where the others vary."""
    bases = list_bases(e, names)
    for kind in ("frozen", "clipped"):
        at = {name: stuck_samples(e.signals, name, kind) > _TOUCHED for name in bases}
        if kind == "frozen" and names != GYRO:
            # a robot whose wheels stand without a command may be pushed
            both = ENCODERS if names[0] in ENCODERS else names
            moves = np.any([e.means[name] for name in both], axis=0) | e.commanded
            at = dict.fromkeys(names, np.all([*at.values()], axis=0) & moves)
        changed = {}
        for name, basis in bases.items():
            mean = e.means[name]
            stuck = at[name]
            for _ in range(_ROUNDS):
                told = basis @ fit_factors(basis, np.where(stuck, math.nan, mean))
                # what would be beyond a bound is explained, whatever it is; below, it is not stuck
                stuck = at[name] & ((kind == "frozen") | (told * np.sign(mean) > np.abs(mean)))
            changed[name] = np.where(stuck, told, mean)
        if changed and np.mean([*at.values()]) > 0.03:
            words = f"{join_names(names, 'keep')} a value, though the others vary: {kind}"
            yield Idea(kind, names, words, e.but(changed), 1.0 + len(names))


_GROUND = 0.25
"""Share of its mean that slip of both sides has in each third of a log where it is the ground's,
and no fault [1]."""
_SLIPPED = 1.2
"""Cost of each window in which wheels slip: a residual of 1.5 times the noise."""


def _slipping_wheels(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Wheels that turn while the robot stands, or stand while it moves."""
    if "pose" not in e.told[0]:
        return
    every = {
        name: basis @ fit_factors(basis, e.means[name])
        for name, basis in list_bases(e, (*names, *TWIST)).items()
        if name in e.means
    }
    sides = np.array([e.means[name] for name in names])
    told = np.array([every[name] for name in names])
    size = np.percentile(np.abs(sides), 80.0)
    most = np.maximum(0.35 * np.maximum(np.abs(sides), np.abs(told)), 0.25 * size)
    slips = np.abs(sides - told) > most
    more = np.abs(sides) - np.abs(told)
    fast = slips & (more > 0.0)
    # commands of wheels that slip may tell as little
    for blamed, others, where in (
        (names[:1], (), fast[0] & ~slips[1]),
        (names[1:], (), fast[1] & ~slips[0]),
        (names, (), slips.any(axis=0)),
        (names, TWIST, slips.any(axis=0)),
    ):
        thirds = np.histogram(np.flatnonzero(where), 3, (0, len(where)))[0]
        if sum(thirds) < 8 or (blamed == names and min(thirds) > _GROUND * np.mean(thirds)):
            continue
        how = "although its wheels stand: is it pushed or carried?"
        if len(blamed) == 1:
            how = f"slower than {blamed[0]} alone tells: its wheels slip, or are lifted"
        elif np.median(more.sum(axis=0)[where]) > 0.0:
            how = "in another way than its wheels turn: they slip"
        words = f"the robot moves in {100.0 * np.mean(where):.0f} % of the time {how}"
        changed = {
            name: np.where(where, every[name], e.means[name])
            for name in (*blamed, *others)
            if name in every
        }
        # each window costs as much as if nothing were told in it
        price = _SLIPPED * (1.0 + 0.75 * len(others))
        freedom = 3.0 + len(others) + price * sum(thirds) / math.log(len(where))
        yield Idea("slip", blamed, words, e.but(changed), freedom)


def _unrelated_signals(e: Agreement, names: Blamed) -> Iterator[Idea]:
    """Signals that resemble nothing that the robot did: no more than at another time."""
    n = len(e.signals.windows.t)
    sensor = column_of(names[0]).group
    own = {*names, "heading"} if names == POSE_COLUMNS else {*names}
    at_random = []
    for share in (0.25, 0.4, 0.55, 0.7):
        rolled = e.but({name: np.roll(e.means[name], round(share * n)) for name in own})
        mine = [sensor in (pair.a, pair.b) for pair in rolled.pairs]
        at_random.append(np.nanmean(rolled.costs[mine]))
    words = (
        f"{join_names(names, 'resemble')} nothing that the robot did, while the other columns "
        "resemble one another: another axis or quantity, or those of another drive?"
    )
    nothing = e.but({name: np.full(n, math.nan) for name in own})
    after = replace(nothing, untold=0.6 * float(np.median(at_random)))
    kind = "swapped" if sensor == "imu" else "unrelated"
    yield Idea(kind, names, words, after, parts=names == TWIST)


_OF_SAMPLES: Sequence[Mistake] = (
    (_other_readings, (GYRO, PLACE, ENCODERS, ODOMETRY)),
    (_small_jumps, (PLACE,)),
    (_stuck_columns, (GYRO, ENCODERS, ENCODERS[:1], ENCODERS[1:], ODOMETRY)),
    (_slipping_wheels, (ENCODERS,)),
    (_unrelated_signals, (GYRO, POSE_COLUMNS, ENCODERS, ODOMETRY, TWIST)),
)
"""The mistakes of samples, and the columns that each may be in."""


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
    """Return the hypotheses by what they explain, the best first.

    Where something is wrong, each is tried together with another unit too, which must explain more
    than a single mistake does.
    """
    ideas = [*_list_ideas(e, MISTAKES)]
    found = [*_weigh_ideas(e, ideas)]
    most = max((v.gain for v in found), default=0.0)
    found += _weigh_ideas(e, _list_ideas(e, _OF_SAMPLES))
    if found:
        pairs = _weigh_ideas(e, chain.from_iterable(_list_pairs(idea) for idea in ideas))
        found += [v for v in pairs if (1.0 - _TIE) * v.gain > most]
    return sorted(found, key=lambda v: -v.gain)


def _weigh_ideas(e: Agreement, ideas: Iterable[Idea]) -> Iterator[Explanation]:
    """Yield those hypotheses that explain enough."""
    n = len(e.signals.windows.t)
    for idea in ideas:
        gains = 0.5 * idea.after.gain_over(e)  # windows overlap by half
        span = _best_span(gains) if idea.parts else slice(0, n)
        if span.stop - span.start > _WHOLE * n:
            span = slice(0, n)
        partly = span.stop - span.start < n
        price = 4.0 + 0.5 * math.log(n) * (idea.freedom + 2.0 * partly)
        gain = float(gains[span].sum()) - price
        if gain > max(_LEAST, _LEAST_EACH * n) and _explains_span(e, idea, span):
            yield Explanation(gain, idea, span)


def _list_pairs(first: Idea) -> Iterator[Idea]:
    """Yield a hypothesis together with another unit of columns of the same sensors."""
    for then in _list_ideas(first.after, UNITS_ALONE):
        if list_sensors(then.columns) == list_sensors(first.columns):
            columns = tuple(dict.fromkeys((*first.columns, *then.columns)))
            words = f"{first.words}; and {then.words}"
            freedom = first.freedom + then.freedom
            yield Idea(then.kind, columns, words, then.after, freedom, first.parts)


_QUIET = 0.1
"""Cost of a pair of sound signals in a window."""
_NOTICED = 6.0
"""Cost beyond that from which columns are looked at [nats]."""


def _list_ideas(e: Agreement, mistakes: Sequence[Mistake]) -> Iterator[Idea]:
    """Yield the hypotheses on columns that do not agree with the others."""
    for explain, subjects in mistakes:
        for names in subjects:
            own = [bool(pair.columns & {*names}) for pair in e.pairs]
            beyond = np.maximum(np.nan_to_num(e.costs[own]) - _QUIET, 0.0)
            if {*names} <= e.means.keys() and 0.5 * float(np.sum(beyond)) > _NOTICED:
                yield from explain(e, names)


def _best_span(gains: FloatArray) -> slice:
    """Return the windows in a row whose (N,) gains have the greatest sum."""
    so_far = np.cumulative_sum(gains, include_initial=True)
    low = np.minimum.accumulate(so_far)
    stop = int(np.argmax(so_far - low))
    start = int(np.argmin(so_far[: stop + 1]))
    return slice(start, stop)


def _explains_span(e: Agreement, idea: Idea, span: slice) -> bool:
    """Return whether little is left over between the signals that a hypothesis changes."""
    changed = [was is not now for was, now in zip(e.pairs, idea.after.pairs, strict=True)]
    before, left = (
        float(np.mean(np.nan_to_num(told.costs)[changed, span])) for told in (e, idea.after)
    )
    partly = span.stop - span.start < e.costs.shape[1]
    return bool(left < max((_EXPLAINED / 2.0 if partly else _EXPLAINED) * before, _ORDINARY))


def _correct_signals(e: Agreement, best: Explanation) -> Agreement:
    """Return what a log tells with the mistake undone where it was made."""
    inside = np.zeros(len(e.signals.windows.t), dtype=bool)
    inside[best.span] = True
    changed = {
        name: np.where(inside, values, e.means[name])
        for name, values in best.idea.after.means.items()
        if values is not e.means[name]
    }
    return replace(e.but(changed), untold=best.idea.after.untold)


def judged(signals: Signals) -> Iterator[LogFault]:
    """Yield what the signals of a log show to be wrong."""
    e = Agreement.of_log(signals)
    if not e.pairs:
        return
    blamed = set[str]()
    for _ in range(_MOST_FAULTS):
        found = [v for v in explanations(e) if not blamed & {*v.idea.columns}]
        if not found:
            yield from _say_unexplained_rest(e, blamed)
            return
        near = [v for v in found if v.gain > (1.0 - _TIE) * found[0].gain]
        # of those that explain as much, those of fewer sensors
        fewest = min(len(list_sensors(v.idea.columns)) for v in near)
        best, *others = [v for v in near if len(list_sensors(v.idea.columns)) == fewest]
        rivals = {best.idea.columns: best}
        for other in others:
            if not {*best.idea.columns} & {*other.idea.columns}:
                rivals.setdefault(other.idea.columns, other)
        yield _make_fault(signals, list(rivals.values()))
        if "t" in best.idea.columns:
            return  # whatever else there is, is of that
        blamed |= {*chain(*rivals)}
        e = _correct_signals(e, best)


def _say_unexplained_rest(e: Agreement, blamed: set[str]) -> Iterator[LogFault]:
    """Yield what is left over between two sensors, if it is more than if one told nothing."""
    # of a pair that tells nothing, no cost
    rest = {float(np.mean(np.nan_to_num(p.cost))): p for p in e.pairs if not blamed & p.columns}
    cost = max(rest, default=0.0)
    if cost < UNTOLD:
        return
    worst = rest[cost]
    columns = tuple(name for name in e.signals.log.columns if name in worst.columns)
    times = math.sqrt(math.expm1(cost))
    words = (
        f"{' and '.join(columns)} disagree by {times:.2g} times their ordinary noise throughout, "
        "and no mistake that is looked for explains it; the log cannot say which is wrong"
    )
    yield LogFault("disagree", columns, words)


def _make_fault(signals: Signals, rivals: Sequence[Explanation]) -> LogFault:
    """Return the fault of one hypothesis, or of several that are as good."""
    best = rivals[0]
    t = signals.windows.t
    start = end = None
    when = ""
    if best.span.stop - best.span.start < len(t):
        start, end = float(t[best.span.start]), float(t[best.span.stop - 1])
        when = f"; from {start:.0f} to {end:.0f} s"
        if best.span.stop == len(t):
            when = f"; from {start:.0f} s on"
    words = ", or ".join(v.idea.words for v in rivals)
    kinds = {v.idea.kind for v in rivals}
    kind = best.idea.kind if len(kinds) == 1 else "disagree"
    if len(rivals) > 1:
        words += "; the log cannot say which"
    columns = tuple(dict.fromkeys(chain(*(v.idea.columns for v in rivals))))
    return LogFault(kind, columns, words + when, start, end)


# ------------------------------------------------------------------------------------------ parts
_PART_S = 10.0
"""Length of a part of a log [s]; those of a long log are longer."""
_MOST_PARTS = 40
"""Most parts of a log."""
_SURE = 0.8
"""Share of yaw rates that is explained from which a part tells a delay [1]."""
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
    edges = np.linspace(t[0], t[-1] + 1e-6, n + 1)
    parts = []
    for start, stop, late in zip(edges, edges[1:], _late_headings(agreement, edges), strict=False):
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
                "delay_s": late,
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
    if np.sqrt(np.mean(v**2)) < _DRIVES:
        return None, None, None
    # r_l l + b w = v, and r_r r - b w = v
    rows = np.block([[left, 0.0 * v], [0.0 * v, right], [w, -w]])
    known = rows if np.mean(np.abs(w)) > _TURNS else rows[:2]
    sizes = np.linalg.lstsq(known.T, np.tile(v, 2))[0].tolist()
    return (*sizes, None)[:3]


def _late_headings(e: Agreement, edges: FloatArray) -> list[float | None]:
    """Return how late headings are behind gyro or wheels in parts [s]; None where untold."""
    windows = e.signals.windows
    first = next((name for name in ("imu", "wheels") if name in windows.at), "")
    if not first or not {*POSE_COLUMNS} <= e.means.keys():
        return [None] * (len(edges) - 1)
    starts = np.searchsorted(windows.t, edges[:-1])
    late, sure = find_delays(e, {"yaw": e.signals.ways["yaw"]}, starts.tolist())
    taken = windows.late["pose"] - windows.late[first]
    known = (sure > _SURE) & np.isfinite(late)
    return [float(taken + lag) if told else None for lag, told in zip(late, known, strict=True)]


def _residuals_of_part(e: Agreement, inside: IndexArray) -> dict[str, float | None]:
    """Return by signal what is left over beside the others, over its noise, in the median."""
    names = {"imu": "gyro", "pose": "pose", "odom": "odometry", "wheels": "wheels"}
    found = dict[str, float | None]()
    for sensor, name in {**names, "cmd": "commands"}.items():
        costs = [pair.cost[inside] for pair in e.pairs if sensor in (pair.a, pair.b)]
        if costs:
            told = np.extract(np.isfinite(costs), costs)
            found[name] = float(np.sqrt(np.expm1(np.median(told)))) if len(told) else None
    return found
