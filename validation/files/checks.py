"""What a person would look at in a log: a list of small tests, each with a sentence.

Each test gets what is known of a log, and says what is wrong, or nothing. `CHECKS` has them in the
order in which they are asked. Columns that one of them names are left out of what comes later, and
nothing comes after a fault of the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr.types import FloatArray
from validation.files.agreement import (
    MOVES,
    angle_between,
    contradictions,
    measures,
    other_axis,
    units,
)
from validation.files.circular import circular
from validation.files.columns import BESIDE_MOTION, POSE_COLUMNS, column_of
from validation.files.log import LogFault
from validation.files.motion import ENCODERS, TWIST
from validation.files.sensors import FEWEST_WINDOWS, LONGEST_S, Signals
from validation.files.signals import centred, correlation, moving_mean, sturdy_fit
from validation.files.topics import rates_of_positions

_FEW = 5
"""Number of windows or samples from which something is no accident."""
_OFFSET = 0.025
"""Offset of a gyro from which it is a fault: a sound one on tile has 0.016 [rad/s]."""
_DRIFT = 0.04
"""Change of such an offset through a log from which it is a fault [rad/s]."""
_SCALE = 0.1
"""Error of its scale from which it is a fault [1]."""
_ALIKE = 0.6
"""Correlation from which encoders tell the speeds of the wheels' rims."""
_SLIPS = 1.5
"""Rate by which wheels that slip are faster than the others say [rad/s]."""
_SIGMAS = 5.0
"""Standard errors from which a number is no accident."""
_SIDES_DIFFER = 1.5
"""Factor by which one side of wheels may turn the robot more than the other; 1.1 on ice."""
_TOGETHER = 8.0
"""Condition number of ways and turns from which a robot drives one circle."""
_WIDTHS_S = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
"""Times over which a smoothed pose may be averaged [s]."""
_EXPLAINED = 0.99
"""Correlation from which smoothing explains what a heading tells: noise makes it smaller."""
_FROZEN = 0.2
"""Share of the windows with motion from which a column that keeps its value is frozen [1];
localisers stall for less."""
_SAME = 0.9
"""Correlation of signals that differ by noise alone."""
_CLOCKS_GAIN = 0.1
"""Correlation that a difference of clocks must gain [1]."""
_NEAR_S = 1.5
"""Delay that is taken out before signals are compared [s]."""
_PARTS = 6
"""Least number of parts of a log whose delays are compared."""
_PART_S = 8.0
"""Shortest of them [s]."""
_LONG_PART_S = 20.0
"""Usual length of those of a long log [s]: a delay that grows would blur what is compared."""


# ------------------------------------------------------------------------------------------ time
def _time_unit(e: Signals) -> Iterator[LogFault]:
    """Time in another unit: turns and ways of the pose are too fast by the same factor."""
    rows = all(np.all(np.diff(group.t) == 1.0) for group in e.log.groups.values())
    factors = []
    for told in measures(e.means, e.radius):
        values = {m.columns: np.nan_to_num(m.values) / m.typical for m in told}
        pose = values.get(("yaw",), values.get(("x", "y")))
        other = values.get(("gyro_z",), values.get(ENCODERS))
        if pose is not None and other is not None and np.any(other):
            if rows or abs(correlation(pose, other)) > _SAME:
                factors.append(float(np.linalg.norm(pose) / np.linalg.norm(other)))
    if len(factors) < 2:
        return
    turn, way = factors
    if max(turn, 1.0 / turn) > 1.6 and 0.33 < way / turn < 3.0:
        sentence = (
            f"the pose turns and drives {turn:.3g} times as fast as the other sensors say: "
            f"t is not in seconds{', but grows by one a row: it seems to count rows' * rows}"
        )
        yield LogFault("clock", ("t", *POSE_COLUMNS), sentence)


def _other_clock(e: Signals) -> Iterator[LogFault]:
    """Headings that are so late behind the gyro or the wheels that no delay explains it."""
    if e.turns is None:
        return
    late, alike = e.turns.delays(slice(None), LONGEST_S)
    best = int(np.argmax(alike))
    near = np.max(alike[np.abs(late) <= _NEAR_S + 1e-6])
    if alike[best] > max(_SAME, near + _CLOCKS_GAIN):
        order = "after" if late[best] > 0.0 else "before"
        sentence = (
            f"yaw tells of turns about {abs(late[best]):.1f} s {order} {e.turns.sensor}: "
            "their clocks differ, and no delay so long is taken out"
        )
        yield LogFault("clock", POSE_COLUMNS, sentence)


def _growing_delay(e: Signals) -> Iterator[LogFault]:
    """A clock that runs at another rate: the delay of headings grows through the log."""
    from scipy import stats  # here: it takes a tenth of a second to import

    turns = e.turns
    if turns is None or np.ptp(turns.t) < _PARTS * _PART_S:
        return
    parts = max(_PARTS, round(np.ptp(turns.t) / _LONG_PART_S))
    times = []
    delays = []
    for start, stop in pairwise(np.linspace(0, len(turns.t), parts + 1).astype(int)):
        late, alike = turns.delays(slice(start, stop), LONGEST_S)
        if np.max(alike) > _SAME:
            times.append(turns.t[(start + stop) // 2])
            delays.append(late[np.argmax(alike)])
    if len(times) < max(_PARTS - 1, parts // 2):
        return
    # Theil and Sen's: one part may tell nonsense
    slope = stats.theilslopes(delays, times).slope
    starts = np.array(delays) - slope * np.array(times)
    ends = np.median(starts) + slope * np.array([times[0], times[-1]])
    rest = np.percentile(np.abs(starts - np.median(starts)), 80.0)
    if np.ptp(ends) > max(0.5, 4.0 * rest):
        sentence = (
            f"yaw is {ends[0]:.2f} s behind {turns.sensor} at first and {ends[1]:.2f} s at last: "
            f"one of their clocks runs {100.0 * abs(slope):.1f} % faster"
        )
        yield LogFault("clock", POSE_COLUMNS, sentence)


def smoothed(e: Signals) -> Iterator[LogFault]:
    """A heading that is averaged over seconds: the mean of the gyro or the wheels tells it."""
    turns = e.turns
    if turns is None:
        return
    now = np.max(turns.delays(slice(None), _NEAR_S)[1])
    alike = {0.0: 0.0}
    for width in _WIDTHS_S:
        # between rare poses, headings are means as well
        if width > 2.0 * turns.period and turns.t[-1] - turns.t[0] > 6.0 * width:
            means = turns.averaged(width)
            alike[width] = float(np.max(means.delays(slice(None), _NEAR_S)[1]))
    width = max(alike, key=lambda width: alike[width])
    # the mean of a steady swing is one as well
    if now < _EXPLAINED < alike[width] and 1.0 - alike[width] < 0.4 * (1.0 - now):
        sentence = (
            f"yaw follows the mean of {turns.sensor} over some {width:g} s: "
            "the pose is smoothed, and fast turns are lost in it"
        )
        yield LogFault("smoothed", POSE_COLUMNS, sentence)


# ------------------------------------------------------------------------------------------
# columns of wheels
def _same_columns(e: Signals) -> Iterator[LogFault]:
    """Both wheels from one column, although the robot turns."""
    if e.wheels is not None and e.turning is not None and np.array_equal(*e.wheels):
        if np.mean(np.abs(e.turning) > MOVES) > 0.1:
            sentence = "enc_left and enc_right are the same numbers, although the robot turns"
            yield LogFault("same", ENCODERS, sentence)


def positions(e: Signals) -> Iterator[LogFault]:
    """Columns of wheels that are positions: their slopes tell the motion, and they do not."""
    group = e.log.groups.get("wheels")
    table = None if group is None else group.table(ENCODERS)
    if group is None or table is None:
        return
    # a counter wraps by its whole range
    span = np.ptp(table, axis=0)
    wraps = np.abs(np.diff(table, axis=0)) > 0.5 * span
    wrapped = bool(np.any(wraps) and np.mean(wraps) < 0.05)
    slopes = {}
    for name, values, period in zip(ENCODERS, table.T, span, strict=True):
        way = np.unwrap(values, period=period) if wrapped else values
        steps = np.abs(np.diff(way))
        if np.ptp(way) < 10.0 or np.percentile(steps, 90.0) > 0.05 * np.ptp(way):
            return
        slopes[name] = rates_of_positions(group.t, way)
    turned = Signals(e.log.changed("wheels", slopes))
    alike = min(turned.likeness(), default=0.0)
    if alike > max(0.5, min(e.likeness(), default=0.0) + 0.2):
        sentence = (
            "enc_left and enc_right are positions, which add up, and not rates: their slopes tell "
            "the motion; --columns enc_left=NAME:rad (or :turns, :deg, :ticks) takes those"
        )
        if wrapped:
            sentence += "; and they wrap: count on instead"
        yield LogFault("counter" if wrapped else "positions", ENCODERS, sentence)


def _single_samples(e: Signals) -> Iterator[LogFault]:
    """Counters that wrap, spikes and dropouts: single samples that no wheel reaches."""
    for name, least in (("enc_left", 5.0), ("enc_right", 5.0), ("gyro_z", 2.0)):
        group = e.log.group_of((name,))
        if group is None:
            continue
        before, middle, after = sliding_window_view(np.pad(group.columns[name], 1, "edge"), 3).T
        off = np.abs(middle - 0.5 * (before + after))
        alone = np.abs(before - after) < 0.3 * off
        spikes = off[alone & (off > max(8.0 * np.percentile(off, 85.0), least))]
        lost = np.count_nonzero((middle == 0.0) & (before * after > 0.25))
        if lost >= _FEW and lost > 0.7 * len(spikes):
            sentence = (
                f"{name} falls to zero for single samples, {lost} times: lost "
                "messages stand as zeros; leave them out"
            )
            yield LogFault("spikes", (name,), sentence)
        elif len(spikes) >= 3:
            size = np.max(spikes)
            what = f"by {size:.3g} rad/s within {1e3 * group.period:.0f} ms"
            wraps = np.ptp(spikes) < 0.1 * size and size > 20.0 * least
            why = "a counter wraps" if wraps else "no wheel does that"
            sentence = f"{name} jumps for single samples, {len(spikes)} times, {what}: {why}"
            yield LogFault("counter" if wraps else "spikes", (name,), sentence)


def _unsigned_wheels(e: Signals) -> Iterator[LogFault]:
    """Encoders that tell no direction: never negative, although the robot drives backwards."""
    raw = [e.log.columns[name] for name in ENCODERS if e.log.has((name,))]
    v = e.along
    if e.wheels is None or v is None or any(values.min() < -0.01 * values.max() for values in raw):
        return
    w = e.means["yaw"]
    backwards = np.zeros(len(v), dtype=bool)
    for side in e.wheels:
        # a rim's speed is v -+ b w; its square is linear in these
        squares = np.column_stack([v**2, v * w, w**2])
        factors = np.linalg.lstsq(squares, side**2)[0]
        if centred(squares @ factors, side**2) < _ALIKE or factors[0] <= 0.0:
            return
        rate = np.sqrt(factors[0]) * (v + 0.5 * factors[1] / factors[0] * w)
        backwards |= (rate < -0.2) & (side > -0.5 * rate)
    if np.count_nonzero(backwards) >= _FEW:
        sentence = (
            "enc_left and enc_right are never negative, although the pose says that wheels turned "
            f"backwards in {100.0 * np.mean(backwards):.0f} % of the time: they tell no direction"
        )
        yield LogFault("sign", ENCODERS, sentence)


def set_points(e: Signals) -> Iterator[LogFault]:
    """Wheel rates that follow from the commands exactly, as set points do."""
    wheels = e.log.groups.get("wheels")
    commands = e.log.groups.get("cmd")
    if wheels is None or commands is None or not e.log.has((*ENCODERS, *TWIST)):
        return
    now = np.searchsorted(commands.t, wheels.t, side="right") - 1
    rates = np.column_stack([wheels.columns[name] for name in ENCODERS])[now >= 0]
    twists = np.column_stack([commands.columns[name] for name in TWIST])
    size = np.std(rates, axis=0)
    for late in (0, 1):
        asked = twists[np.maximum(now[now >= 0] - late, 0)]
        rest = np.abs(asked @ np.linalg.lstsq(asked, rates)[0] - rates)
        if np.all(size > 0.1) and np.all(np.percentile(rest, 98.0, axis=0) < 1e-3 * size):
            sentence = (
                "enc_left and enc_right follow from cmd_v and cmd_w exactly: they are set points, "
                "and not what encoders measured"
            )
            yield LogFault("setpoints", ENCODERS, sentence)
            return


def pushed(e: Signals) -> Iterator[LogFault]:
    """A robot that moves while its wheels stand."""
    if e.wheels is None or e.along is None:
        return
    fastest = np.max(np.abs(e.wheels), axis=0)
    moves = np.hypot(e.means["x"], e.means["y"]) > 2.0 * MOVES
    n = np.count_nonzero((fastest < MOVES) & moves)
    # slower wheels are in another unit
    if n > max(2 * _FEW, 0.05 * len(moves)) and np.percentile(fastest, 90.0) > 10.0 * MOVES:
        sentence = (
            f"the robot moves in {100.0 * n / len(moves):.0f} % of the time although its wheels "
            "stand: is it pushed or carried?"
        )
        yield LogFault("slip", ENCODERS, sentence)


def _unlike_sides(e: Signals) -> Iterator[LogFault]:
    """Wheels of one side that are faster than the robot moves, always or while they slip."""
    if e.wheels is None or e.along is None:
        return
    moved = np.column_stack([e.along, e.means["yaw"]])
    sizes = np.linalg.norm(moved, axis=0)
    if not np.all(sizes):
        return
    factors = np.array([sturdy_fit(moved, side) for side in e.wheels])
    told = factors @ moved.T
    alike = min(map(correlation, told, e.wheels))
    apart = np.linalg.cond(moved / sizes) < _TOGETHER
    left, right = np.abs(factors)
    differ = np.all(left > _SIDES_DIFFER * right) or np.all(right > _SIDES_DIFFER * left)
    if alike > 0.97 and apart and differ:
        sentence = (
            f"enc_left is {left[0] / right[0]:.2g} times as fast as enc_right when the robot "
            "drives straight: one of them is in another unit, or loses samples"
        )
        yield LogFault("scale", ENCODERS, sentence)
        return
    more = np.abs(e.wheels) - np.abs(told)
    fast = more > np.maximum(0.5 * np.abs(told), _SLIPS)
    sound = np.abs(e.wheels - told) < 0.3 * np.maximum(np.abs(told), 1.0)
    for k, name in enumerate(ENCODERS):
        share = np.mean(fast[k] & sound[1 - k])
        if share > max(2.0 * _FEW / len(moved), 0.05, 5.0 * np.mean(fast[1 - k])):
            sentence = (
                f"{name} turns faster than the robot moves in {100.0 * share:.0f} % of "
                "the time, and the other side does not: its wheels slip, or are lifted"
            )
            yield LogFault("slip", (name,), sentence)


# ------------------------------------------------------------------------------------------
# commands, gyro and pose
def _commands_of_wheels(e: Signals) -> Iterator[LogFault]:
    """Commands that are those of two wheels."""
    asked = [e.means[name] for name in TWIST if name in e.means]
    if e.wheels is None or e.turning is None or len(asked) < 2:
        return
    if min(map(correlation, asked, e.wheels)) > 0.95 and correlation(asked[1], e.turning) < 0.8:
        sentence = "cmd_v and cmd_w follow the left and the right wheel: they command wheels"
        yield LogFault("swapped", TWIST, sentence)


def _other_commands(e: Signals) -> Iterator[LogFault]:
    """Commands that resemble nothing that the robot did."""
    along = e.along
    if along is None and e.wheels is not None:
        along = np.sum(e.wheels, axis=0)
    if not {*TWIST} <= e.means.keys() or e.turning is None or along is None:
        return
    asked = np.array([e.means[name] for name in TWIST])
    did = np.array([along, e.turning])
    commanded = np.any(asked != 0.0, axis=0)
    moves = np.any(np.abs(did) > MOVES, axis=0)
    if np.count_nonzero(commanded) < 4 * _FEW or not np.any(moves):
        return
    alike = []
    for command, motion in zip(asked[:, commanded], did[:, commanded], strict=True):
        # one that hardly varies says nothing about its mean
        about = centred if np.std(command) > 0.2 * np.mean(np.abs(command)) else correlation
        alike.append(abs(about(command, motion)))
    swapped = max(abs(correlation(asked[k], did[1 - k])) for k in range(2))
    if swapped < 0.6 and max(alike) < 0.5 < np.mean(commanded[moves]):
        sentence = (
            "cmd_v and cmd_w resemble nothing that the robot did (correlations of "
            f"{alike[0]:.2f} and {alike[1]:.2f}): they may be those of another drive"
        )
        yield LogFault("unrelated", TWIST, sentence)


def _gyro_against_heading(e: Signals) -> Iterator[LogFault]:
    """A gyro that differs from the heading's rate by an offset, more and more, or by a factor."""
    gyro = e.means.get("gyro_z")
    turning = e.means.get("yaw")
    if gyro is None or turning is None or correlation(gyro, turning) < 0.3:
        return
    if not 0.5 < np.linalg.norm(gyro) / np.linalg.norm(turning) < 2.0:
        return  # it is in another unit
    less = gyro - turning
    design = [np.ones(len(less)), np.linspace(-0.5, 0.5, len(less))]
    if np.std(turning) > 0.3 * abs(np.mean(turning)):
        design.append(turning)  # else a scale cannot be told from an offset
    told = np.column_stack(design)
    best = np.linalg.lstsq(told, less)[0]
    rest = less - told @ best
    # windows overlap by half
    errors = np.sqrt(2.0 * np.mean(rest**2) * np.diag(np.linalg.inv(told.T @ told)))
    sure = np.abs(best) > np.maximum(_SIGMAS * errors, (_OFFSET, _DRIFT, _SCALE)[: len(best)])
    parts = [np.median(part) for part in np.array_split(rest + best[0], 4)]
    if sure[1] and abs(best[1]) > 4.0 * np.median(np.abs(rest)):
        sentence = (
            f"gyro_z less the yaw rate grows by {best[1]:.2f} rad/s through the log: the gyro "
            "drifts"
        )
        yield LogFault("drift", ("gyro_z",), sentence)
    elif sure[0] and min(parts / best[0]) > 0.5:
        sentence = (
            f"gyro_z less the yaw rate is {best[0]:.2g} rad/s throughout: the gyro has an offset; "
            "where the robot stands, `recordings convert --unbias` takes it out"
        )
        yield LogFault("offset", ("gyro_z",), sentence)
    elif sure[-1] and len(sure) > 2 and correlation(gyro, turning) > 0.97:
        sentence = (
            f"gyro_z tells {1.0 + best[2]:.2f} times the turn that yaw says: its scale is off"
        )
        yield LogFault("scale", ("gyro_z",), sentence)


def _turned_path(e: Signals) -> Iterator[LogFault]:
    """A path that goes at an angle to its heading, or is counted along the robot."""
    s = e.means
    if e.along is None or not (np.any(s["x"]) and np.any(s["y"])):
        return
    step = s["x"] + 1j * s["y"]
    # a localiser ahead of the middle moves sideways in turns
    moves = (np.abs(step) > MOVES) & (np.abs(s["yaw"]) < 2.0 * np.abs(step))
    if np.count_nonzero(moves) < 2 * _FEW:
        return
    heading = s["heading"][moves]
    to_robot = angle_between(step[moves], heading)
    to_world = angle_between(step[moves], 0.0)
    angle = abs(0.5 * math.degrees(math.atan2(to_robot.imag, to_robot.real)))
    if abs(to_robot) > 0.85 and 8.0 < angle < 80.0:
        sentence = (
            f"path and heading are {angle:.0f} deg apart: the localiser is mounted at an "
            "angle, or x, y and yaw are of different frames"
        )
        yield LogFault("frame", POSE_COLUMNS, sentence)
    elif to_world.real > 0.9 and abs(to_robot) < 0.7 and np.ptp(heading) > 1.5:
        sentence = (
            "x grows and y does not, wherever the robot heads: they are counted along the robot, "
            "not in a fixed frame"
        )
        yield LogFault("frame", ("x", "y"), sentence)


def _speeds_for_places(e: Signals) -> Iterator[LogFault]:
    """Positions that are speeds: their size follows the wheels."""
    pose = e.log.groups.get("pose")
    wheels = e.log.groups.get("wheels")
    if pose is None or wheels is None or not e.log.has((*ENCODERS, "x", "y")):
        return
    if e.along is not None and e.wheels is not None:
        if abs(correlation(e.along, np.sum(e.wheels, axis=0))) > 0.5:
            return  # their slopes are the speeds
    rates = [np.interp(pose.t, wheels.t, wheels.columns[name]) for name in ENCODERS]
    size = moving_mean(pose.t, np.hypot(pose.columns["x"], pose.columns["y"]), 0.5)
    mean = moving_mean(pose.t, np.abs(rates[0] + rates[1]), 0.5)
    if np.std(mean) > 0.2 and centred(size, mean) > 0.85:
        sentence = "the size of x and y follows the speed of the wheels: they are speeds"
        yield LogFault("swapped", ("x", "y"), sentence)


# ------------------------------------------------------------------------------------------ any
def frozen(e: Signals) -> Iterator[LogFault]:
    """Columns that keep their value for long while others say that the robot moves."""
    turning, forward = measures(e.means, e.radius)
    shares = {}
    for name, values in e.log.columns.items():
        told = [m for m in (*turning, *forward) if name not in m.columns]
        others = [np.nan_to_num(m.values) / m.typical for m in told]
        known = column_of(name).usual < math.inf or name in POSE_COLUMNS
        if not others or not known or name in TWIST:  # joysticks command nothing
            continue
        rate = e.means.get(name)
        if rate is None:
            if np.ptp(values) > 0.0:
                continue
            # currents and accelerations are noisy
            rate = np.zeros(len(others[0]))
        moves = np.median(np.abs(others), axis=0) > MOVES
        kept = rate == 0.0
        if name not in POSE_COLUMNS:  # a rate may stay the same where the others do
            varies = np.median(_changes(others), axis=0) > 0.3 * MOVES
            moves &= varies | kept
            kept = _changes(rate) < 1e-12
        if name in ENCODERS:
            # where both sides are kept, they may be set points, or the robot stands and its
            # localiser does not
            kept &= _changes(e.means.get(ENCODERS[name == ENCODERS[0]], rate)) > 1e-12
        n = np.count_nonzero(moves & kept)
        moving = np.count_nonzero(moves)
        if n > max(FEWEST_WINDOWS // 4, _FROZEN * moving):
            shares[name] = 100.0 * n / moving
    if shares:
        words = ", ".join(f"{name} for {share:.0f} %" for name, share in shares.items())
        what = f"the same value in much of the time in which the robot moves: {words}"
        yield LogFault("frozen", tuple(shares), what)


def _changes(values: object) -> FloatArray:
    """Return the sizes of the steps of (..., N) numbers; NaN for the first."""
    return np.abs(np.diff(np.asarray(values, dtype=np.float64), prepend=math.nan))


def _too_large(e: Signals) -> Iterator[LogFault]:
    """Numbers that are larger than a robot's can be."""
    for name, values in e.log.columns.items():
        column = column_of(name)
        greatest = float(np.abs(values).max())
        if greatest > column.usual:
            sentence = (
                f"{name} reaches {greatest:.4g} {column.unit}, "
                f"more than {column.usual:g}: it may be in {column.others}"
            )
            yield LogFault("scale", (name,), sentence)


Check = Callable[[Signals], Iterator[LogFault]]
CHECKS: Mapping[Check, float] = {
    circular: 0.0,
    _time_unit: 0.0,
    _other_clock: 0.0,
    positions: 6.0,
    _same_columns: 6.0,
    _unsigned_wheels: 6.0,
    set_points: 6.0,
    _single_samples: 0.0,
    frozen: 6.0,
    _commands_of_wheels: 20.0,
    _other_commands: 20.0,
    _growing_delay: 20.0,
    smoothed: 20.0,
    _gyro_against_heading: 20.0,
    _turned_path: 20.0,
    _speeds_for_places: 6.0,
    pushed: 6.0,
    _unlike_sides: 6.0,
    units: 6.0,
    contradictions: 6.0,
    other_axis: 6.0,
    _too_large: 0.0,
}
"""The tests, in their order, and the shortest log that each says anything of [s]. A new one is a
function and its line here."""


def checked(e: Signals) -> Iterator[LogFault]:
    """Yield what the tests say of a log."""
    groups = [group for name, group in e.log.groups.items() if name not in BESIDE_MOTION]
    span = min(float(group.t[-1] - group.t[0]) for group in groups)
    for check, shortest in CHECKS.items():
        if span < shortest:
            continue
        while found := list(check(e)):
            yield from found
            columns = {*chain(*(fault.columns for fault in found))}
            if "t" in columns or columns >= e.log.columns.keys():
                return
            e = e.without(columns)
