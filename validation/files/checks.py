"""What a person would look at in a log: a list of small tests, each with a sentence.

Each test gets the log and its signals, means over windows of a second, and says what is wrong, or
nothing. `CHECKS` has them in the order in which they are asked. Columns that one of them names are
left out of what comes later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.files.channels import (
    Channels,
    channels,
    correlation,
    delays,
    headings_and_turns,
)
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Log, LogFault
from validation.files.signals import fresh_poses, moving_mean
from validation.files.topics import rates_of_positions

_WHEELS = COMMAND_COLUMNS["wheels"]
_TWIST = COMMAND_COLUMNS["twist"]
_FEW = 5
"""Number of windows or samples from which something is no accident."""
_MOVES = 0.1
"""Speed [m/s] and yaw rate [rad/s] from which a robot moves."""
_OFFSET = 0.025
"""Offset of a gyro from which it is a fault: a sound one on tile has 0.016 [rad/s]."""
_ALIKE = 0.6
"""Correlation from which encoders tell the speeds of the wheels' rims."""
_SLIPS = 1.5
"""Rate by which wheels that slip are faster than the others say [rad/s]."""
_PARTS = 4
"""Parts of a log in which an offset must show."""
_SIGMAS = 5.0
"""Standard errors from which a number is no accident."""
_WIDTHS_S = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
"""Times over which a smoothed pose may be averaged [s]."""
_EXPLAINED = 0.99
"""Correlation from which smoothing explains what a heading tells: noise makes it smaller."""


class LogSignals(NamedTuple):
    """A log, and its signals over windows."""

    log: Log
    signals: Channels
    """(N,) means by column, empty where groups hardly overlap."""

    def turning(self) -> FloatArray | None:
        """Return the (N,) yaw rates by heading, or else by the gyro [rad/s]."""
        return self.signals.get("yaw", self.signals.get("gyro_z"))

    def along(self) -> FloatArray | None:
        """Return the (N,) speeds of the pose along its heading [m/s]."""
        if not {*POSE_COLUMNS} <= self.signals.keys():
            return None
        s = self.signals
        return np.asarray(s["x"] * np.cos(s["heading"]) + s["y"] * np.sin(s["heading"]))

    def wheels(self) -> tuple[FloatArray, FloatArray] | None:
        """Return the (N,) rates of left and right wheels [rad/s]."""
        left, right = (self.signals.get(name) for name in _WHEELS)
        return None if left is None or right is None else (left, right)


Check = Callable[[LogSignals], Iterator[LogFault]]


def _likeness(e: LogSignals) -> float:
    """Return the smaller correlation of turns and of speeds by wheels and by poses [1]."""
    wheels = e.wheels()
    if wheels is None:
        return 0.0
    left, right = wheels
    both = [(e.turning(), right - left), (e.along(), right + left)]
    return min((correlation(a, b) for a, b in both if a is not None), default=0.0)


def rows_for_time(e: LogSignals) -> Iterator[LogFault]:
    """Time that counts rows: every step is one, and the turns of gyro and heading differ."""
    s = e.signals
    steps = [np.diff(group.t) for group in e.log.groups.values()]
    if all(np.all(step == 1.0) for step in steps) and {"gyro_z", "yaw"} <= s.keys():
        ratio = float(np.linalg.norm(s["gyro_z"]) / max(float(np.linalg.norm(s["yaw"])), 1e-9))
        if ratio > 2.0:
            sentence = (
                f"t grows by one a row, and the gyro turns {ratio:.3g} times as fast as yaw: "
                "t seems to be the number of the row, not seconds"
            )
            yield LogFault("clock", ("t", "yaw", "gyro_z"), sentence)


def positions(e: LogSignals) -> Iterator[LogFault]:
    """Columns of wheels that are positions: their slopes tell the motion, and they do not."""
    group = e.log.groups.get("wheels")
    table = None if group is None else group.table(_WHEELS)
    if group is None or table is None:
        return
    # a counter wraps by its whole range
    span = np.ptp(table, axis=0)
    wraps = np.abs(np.diff(table, axis=0)) > 0.5 * span
    wrapped = bool(np.any(wraps)) and np.mean(wraps) < 0.05
    if wrapped:
        table = np.column_stack(
            [np.unwrap(c, period=p) for c, p in zip(table.T, span, strict=True)]
        )
    steps = np.abs(np.diff(table, axis=0))
    smooth = np.percentile(steps, 90.0, axis=0) < 0.05 * np.ptp(table, axis=0)
    if not np.all(smooth & (np.ptp(table, axis=0) > 10.0)):
        return
    sides = zip(_WHEELS, table.T, strict=True)
    slopes = {name: rates_of_positions(group.t, values) for name, values in sides}
    turned = LogSignals(e.log, channels(e.log.changed("wheels", slopes)) or {})
    if _likeness(turned) > max(0.8, _likeness(e) + 0.2):
        sentence = (
            "enc_left and enc_right are positions, which add up, and not rates: their slopes tell "
            "the motion; --columns enc_left=NAME:rad (or :turns, :deg, :ticks) takes those"
        )
        if wrapped:
            sentence += "; and they wrap: count on instead"
        yield LogFault("counter" if wrapped else "positions", _WHEELS, sentence)


def counters(e: LogSignals) -> Iterator[LogFault]:
    """Counters that wrap, spikes and dropouts: single samples that no wheel reaches."""
    for name, least in (("enc_left", 5.0), ("enc_right", 5.0), ("gyro_z", 2.0)):
        group = next((g for g in e.log.groups.values() if name in g.columns), None)
        if group is None or len(group.t) < 20:
            continue
        values = group.columns[name]
        before = values[:-2]
        middle = values[1:-1]
        after = values[2:]
        off = middle - 0.5 * (before + after)
        noise = float(np.percentile(np.abs(off), 85.0))
        alone = np.abs(before - after) < 0.3 * np.abs(off)
        spikes = off[alone & (np.abs(off) > max(8.0 * noise, least))]
        lost = (middle == 0.0) & (np.minimum(before * after, np.abs(before)) > 0.5)
        n = len(spikes)
        if np.count_nonzero(lost) >= _FEW and np.count_nonzero(lost) > 0.7 * n:
            sentence = (
                f"{name} falls to zero for single samples, {np.count_nonzero(lost)} times: lost "
                "messages stand as zeros; leave them out"
            )
            yield LogFault("spikes", (name,), sentence)
        elif n >= 3:
            size = float(np.max(np.abs(spikes)))
            what = f"{size:.3g} rad/s within {1e3 * group.period:.0f} ms"
            if np.ptp(np.abs(spikes)) < 0.1 * size and size > 20.0 * least:
                sentence = f"{name} jumps {n} times by {what}: a counter wraps"
                yield LogFault("counter", (name,), sentence)
            else:
                sentence = (
                    f"{name} has {n} samples that no wheel reaches from one sample to the next "
                    f"({what})"
                )
                yield LogFault("spikes", (name,), sentence)


def same_columns(e: LogSignals) -> Iterator[LogFault]:
    """Both wheels from one column, although the robot turns."""
    wheels = e.wheels()
    turning = e.turning()
    if wheels is None or turning is None or not np.array_equal(*wheels):
        return
    if np.mean(np.abs(turning) > _MOVES) > 0.1:
        sentence = "enc_left and enc_right are the same numbers, although the robot turns"
        yield LogFault("same", _WHEELS, sentence)


def unsigned_wheels(e: LogSignals) -> Iterator[LogFault]:
    """Encoders that tell no direction: never negative, although the robot drives backwards."""
    wheels = e.wheels()
    along = e.along()
    if wheels is None or along is None:
        return
    raw = [e.log.columns[name] for name in _WHEELS]
    if any(values.min() < -0.01 * values.max() for values in raw):
        return
    turning = e.signals["yaw"]
    sides = np.array(wheels)
    best = _ALIKE
    n = 0
    for half_track in np.geomspace(0.05, 2.0, 25):
        rims = np.array([along - half_track * turning, along + half_track * turning])
        sizes = np.abs(rims)
        alike = min(map(_centred, sizes, sides))
        if alike > best:
            best = alike
            radius = float(np.sum(sizes * sides) / np.sum(sides**2))
            backwards = (rims < -0.2 * radius) & (radius * sides > 0.5 * sizes)
            n = int(np.count_nonzero(np.any(backwards, axis=0)))
    if n >= _FEW:
        sentence = (
            "enc_left and enc_right are never negative, although the pose says that wheels turned "
            f"backwards in {100.0 * n / len(along):.0f} % of the time: they tell no direction"
        )
        yield LogFault("sign", _WHEELS, sentence)


def set_points(e: LogSignals) -> Iterator[LogFault]:
    """Wheel rates that follow from the commands exactly, as set points do."""
    wheels = e.log.groups.get("wheels")
    commands = e.log.groups.get("cmd")
    if wheels is None or commands is None or not e.log.has((*_WHEELS, *_TWIST)):
        return
    now = np.searchsorted(commands.t, wheels.t, side="right") - 1
    there = now >= 0
    rates = np.column_stack([wheels.columns[name][there] for name in _WHEELS])
    for late in (0, 1):
        at = np.maximum(now[there] - late, 0)
        asked = np.column_stack([commands.columns[name][at] for name in _TWIST])
        rest = asked @ np.linalg.lstsq(asked, rates)[0] - rates
        size = np.std(rates, axis=0)
        if np.all(size > 0.1) and np.all(np.percentile(np.abs(rest), 98.0, axis=0) < 1e-3 * size):
            sentence = (
                "enc_left and enc_right follow from cmd_v and cmd_w exactly: they are set points, "
                "and not what encoders measured"
            )
            yield LogFault("setpoints", _WHEELS, sentence)
            return


def other_commands(e: LogSignals) -> Iterator[LogFault]:
    """Commands that resemble nothing that the robot did, or are those of two wheels."""
    s = e.signals
    if not {*_TWIST} <= s.keys():
        return
    commanded = (s["cmd_v"] != 0.0) | (s["cmd_w"] != 0.0)
    turning = e.turning()
    along = e.along()
    wheels = e.wheels()
    if along is None and wheels is not None:
        along = wheels[0] + wheels[1]
    if turning is None or along is None or np.count_nonzero(commanded) < 4 * _FEW:
        return
    moves = (np.abs(turning) > _MOVES) | (np.abs(along) > _MOVES)
    alike = []
    for name, motion in (("cmd_v", along), ("cmd_w", turning)):
        asked = s[name][commanded]
        # one that hardly varies says nothing about its mean
        about = _centred if np.std(asked) > 0.2 * np.mean(np.abs(asked)) else correlation
        alike.append(abs(about(asked, motion[commanded])))
    if wheels is not None:
        sides = [correlation(s[n], side) for n, side in zip(_TWIST, wheels, strict=True)]
        if min(sides) > 0.95 and alike[1] < 0.8:
            sentence = "cmd_v and cmd_w follow the left and the right wheel: they command wheels"
            yield LogFault("swapped", _TWIST, sentence)
            return
    crossed = [correlation(s["cmd_v"], turning), correlation(s["cmd_w"], along)]
    if max(map(abs, crossed)) > 0.6:
        return  # they are swapped
    if np.any(moves) and np.mean(commanded[moves]) > 0.5 and max(alike) < 0.5:
        sentence = (
            "cmd_v and cmd_w resemble nothing that the robot did (correlations of "
            f"{alike[0]:.2f} and {alike[1]:.2f}): they may be those of another drive"
        )
        yield LogFault("unrelated", _TWIST, sentence)


def _centred(a: FloatArray, b: FloatArray) -> float:
    return correlation(a - np.mean(a), b - np.mean(b))


def gyro_offset(e: LogSignals) -> Iterator[LogFault]:
    """A gyro that differs from the heading's rate by an offset, or by more and more."""
    s = e.signals
    if not {"gyro_z", "yaw"} <= s.keys() or correlation(s["gyro_z"], s["yaw"]) < 0.3:
        return
    if np.mean(np.abs(np.diff(s["gyro_z"])) < 1e-12) > 0.2:
        return  # it is frozen
    turning = s["yaw"]
    if not 0.5 < np.linalg.norm(s["gyro_z"]) / np.linalg.norm(turning) < 2.0:
        return  # they are in two units
    less = s["gyro_z"] - turning
    design = [np.ones(len(less)), np.linspace(-0.5, 0.5, len(less))]
    if np.std(turning) > 0.3 * abs(np.mean(turning)):
        design.append(turning)  # else a scale cannot be told from an offset
    told = np.column_stack(design)
    best = np.linalg.lstsq(told, less)[0]
    rest = less - told @ best
    # windows overlap by half
    errors = np.sqrt(2.0 * np.mean(rest**2) * np.diag(np.linalg.inv(told.T @ told)))
    offset, drift = best[:2]
    noise = float(np.median(np.abs(rest)))
    parts = np.array([np.median(part) for part in np.array_split(rest + offset, _PARTS)])
    if abs(drift) > max(0.04, 4.0 * noise, _SIGMAS * errors[1]):
        sentence = (
            f"gyro_z less the yaw rate grows by {drift:.2f} rad/s through the log: the gyro drifts"
        )
        yield LogFault("drift", ("gyro_z",), sentence)
    elif abs(offset) > max(_OFFSET, _SIGMAS * errors[0]) and min(parts / offset) > 0.5:
        sentence = (
            f"gyro_z less the yaw rate is {offset:.2g} rad/s throughout: the gyro has an offset; "
            "where the robot stands, `recordings convert --unbias` takes it out"
        )
        yield LogFault("offset", ("gyro_z",), sentence)


def growing_delay(e: LogSignals) -> Iterator[LogFault]:
    """A clock that runs at another rate: the delay of headings grows through the log."""
    from scipy import stats  # here: it takes a tenth of a second to import

    found = delays(e.log)
    if found is None:
        return
    times, late, name = found
    # Theil and Sen's: one part may tell nonsense
    slope = float(stats.theilslopes(late, times).slope)
    start = float(np.median(late - slope * times))
    rest = float(np.percentile(np.abs(late - slope * times - start), 80.0))
    grown = slope * (times[-1] - times[0])
    if abs(grown) > max(0.5, 4.0 * rest):
        sentence = (
            f"yaw is {start + slope * times[0]:.2f} s behind {name} at first and "
            f"{start + slope * times[-1]:.2f} s at last: one of "
            f"their clocks runs {100.0 * abs(slope):.1f} % faster"
        )
        yield LogFault("clock", POSE_COLUMNS, sentence)


def smoothed(e: LogSignals) -> Iterator[LogFault]:
    """A heading that is averaged over seconds: the mean of the gyro or the wheels tells it."""
    found = headings_and_turns(e.log)
    if found is None or "yaw" not in e.signals:
        return
    grid, yaw, way, clock = found
    dt = float(grid[1] - grid[0])
    pose = next(group for group in e.log.groups.values() if "yaw" in group.columns)
    changes = pose.t[fresh_poses(pose.t, pose.columns["yaw"][:, None])]
    now = _alike_at_some_delay(yaw, way, round(0.5 / dt))
    alike = {}
    for width in _WIDTHS_S:
        samples = round(width / dt)
        # between rare poses, headings are means as well
        if width > 2.0 * float(np.median(np.diff(changes))) and len(grid) > 8 * samples:
            sums = np.cumulative_sum(way, include_initial=True)
            mean = (sums[samples:] - sums[:-samples]) / samples
            start = (samples - 1) // 2
            cut = yaw[start : start + len(mean)]
            alike[width] = _alike_at_some_delay(cut, mean, round(0.5 / dt))
    width = max(alike, key=lambda width: alike[width], default=0.0)
    # the mean of a steady swing is one as well
    if now < _EXPLAINED < alike.get(width, 0.0) and 1.0 - alike[width] < 0.4 * (1.0 - now):
        sentence = (
            f"yaw follows the mean of {clock} over some {width:g} s: "
            "the pose is smoothed, and fast turns are lost in it"
        )
        yield LogFault("smoothed", POSE_COLUMNS, sentence)


def _alike_at_some_delay(yaw: FloatArray, way: FloatArray, step: int) -> float:
    """Return the correlation of the changes of (N,) angles in `step` samples, at the best delay."""
    a = way[step:] - way[:-step]
    b = yaw[step:] - yaw[:-step]
    n = len(a)
    best = 0.0
    for k in range(-3 * step, 3 * step + 1):
        x = a[max(0, -k) : n - max(0, k)]
        best = max(best, abs(correlation(x, b[max(0, k) : n + min(0, k)])))
    return best


def turned_path(e: LogSignals) -> Iterator[LogFault]:
    """A path that goes at an angle to its heading, or is counted along the robot."""
    s = e.signals
    if not {*POSE_COLUMNS} <= s.keys():
        return
    step = s["x"] + 1j * s["y"]
    # a localiser ahead of the middle moves sideways in turns
    moves = (np.abs(step) > _MOVES) & (np.abs(s["yaw"]) < 2.0 * np.abs(step))
    if np.count_nonzero(moves) < 2 * _FEW or not np.all([np.any(s["x"]), np.any(s["y"])]):
        return
    step = step[moves]
    heading = s["heading"][moves]
    # squared, a displacement is the same for both ways of driving
    doubled = step**2 / np.abs(step)
    size = float(np.sum(np.abs(step)))
    to_robot = complex(np.sum(doubled * np.exp(-2j * heading))) / size
    to_world = complex(np.sum(doubled)) / size
    angle = 0.5 * math.degrees(math.atan2(to_robot.imag, to_robot.real))
    if abs(to_robot) > 0.85 and 8.0 < abs(angle) < 80.0:
        sentence = (
            f"path and heading are {abs(angle):.0f} deg apart: the localiser is mounted at an "
            "angle, or x, y and yaw are of different frames"
        )
        yield LogFault("frame", POSE_COLUMNS, sentence)
    elif to_world.real > 0.9 and abs(to_robot) < 0.7 and np.ptp(heading) > 1.5:
        sentence = (
            "x grows and y does not, wherever the robot heads: they are counted along the robot, "
            "not in a fixed frame"
        )
        yield LogFault("frame", ("x", "y"), sentence)


def speeds_for_places(e: LogSignals) -> Iterator[LogFault]:
    """Positions that are speeds: their size follows the wheels, and stays small."""
    pose = e.log.groups.get("pose")
    wheels = e.log.groups.get("wheels")
    if pose is None or wheels is None or not e.log.has((*_WHEELS, "x", "y")):
        return
    means = e.wheels()
    along = e.along()
    if means is not None and along is not None:
        if abs(correlation(along, means[0] + means[1])) > 0.5:
            return  # their slopes are the speeds
    rates = [np.interp(pose.t, wheels.t, wheels.columns[name]) for name in _WHEELS]
    size = moving_mean(pose.t, np.hypot(pose.columns["x"], pose.columns["y"]), 0.5)
    mean = moving_mean(pose.t, np.abs(0.5 * (rates[0] + rates[1])), 0.5)
    if np.std(mean) > 0.1 and _centred(size, mean) > 0.85:
        sentence = "the size of x and y follows the speed of the wheels: they are speeds"
        yield LogFault("swapped", ("x", "y"), sentence)


def pushed(e: LogSignals) -> Iterator[LogFault]:
    """A robot that moves while its wheels stand."""
    wheels = e.wheels()
    along = e.along()
    if wheels is None or along is None:
        return
    fastest = np.maximum(np.abs(wheels[0]), np.abs(wheels[1]))
    if np.percentile(fastest, 90.0) < 10.0 * _MOVES:
        return  # they are in another unit
    stand = fastest < _MOVES
    n = np.count_nonzero(stand & (np.hypot(e.signals["x"], e.signals["y"]) > 2.0 * _MOVES))
    if n > max(2 * _FEW, 0.05 * len(along)):
        share = 100.0 * n / len(along)
        sentence = (
            f"the robot moves in {share:.0f} % of the time although its wheels stand: "
            "is it pushed or carried?"
        )
        yield LogFault("slip", _WHEELS, sentence)


def slipping_side(e: LogSignals) -> Iterator[LogFault]:
    """Wheels of one side that turn faster than the robot moves, while the other's do not."""
    wheels = e.wheels()
    along = e.along()
    if wheels is None or along is None:
        return
    moved = np.column_stack([along, e.signals["yaw"]])
    fast = []
    sound = []
    for side in wheels:
        told = moved @ _sturdy_fit(moved, side)
        more = np.abs(side) - np.abs(told)
        kept = np.abs(np.diff(side, prepend=0.0)) < 1e-12  # it is frozen
        fast.append((more > 0.5 * np.abs(told)) & (more > _SLIPS) & ~kept)
        sound.append(np.abs(side - told) < 0.3 * np.maximum(np.abs(told), 1.0))
    for name, one, other in ((_WHEELS[0], 0, 1), (_WHEELS[1], 1, 0)):
        n = int(np.count_nonzero(fast[one] & sound[other]))
        both = int(np.count_nonzero(fast[other]))
        if n > max(2.0 * _FEW, 0.05 * len(along), 5.0 * both):
            sentence = (
                f"{name} turns faster than the robot moves in {100.0 * n / len(along):.0f} % of "
                "the time, and the other side does not: its wheels slip, or are lifted"
            )
            yield LogFault("slip", (name,), sentence)


def _sturdy_fit(of: FloatArray, values: FloatArray) -> FloatArray:
    """Return the factors of (N, k) columns that sum up to (N,) values, by least absolute errors."""
    weights: FloatArray = np.ones(len(values))
    factors: FloatArray = np.zeros(of.shape[1])
    for _ in range(15):  # of weighted least squares
        factors = np.asarray(np.linalg.lstsq(of * weights[:, None], values * weights)[0])
        errors = np.abs(values - of @ factors)
        weights = 1.0 / np.sqrt(np.maximum(errors, np.median(errors) + 1e-6))
    return factors


CHECKS: tuple[Check, ...] = (
    rows_for_time,
    positions,
    same_columns,
    unsigned_wheels,
    set_points,
    counters,
    other_commands,
    growing_delay,
    smoothed,
    gyro_offset,
    turned_path,
    speeds_for_places,
    pushed,
    slipping_side,
)
"""The tests, in their order. A new one is a function and its name here."""
_OF_LONG = (smoothed, gyro_offset, turned_path, other_commands)
"""Those that need a log of at least `_LONG_S`."""
_LONG_S = 20.0
"""Length of a log from which means say anything [s]."""


def checked(log: Log) -> Iterator[tuple[LogFault, Log]]:
    """Yield what the tests say of a log, each with the log without the columns that it names."""
    e = LogSignals(log, channels(log) or {})
    span = min(float(group.t[-1] - group.t[0]) for group in log.groups.values())
    for check in CHECKS:
        if check in _OF_LONG and span < _LONG_S:
            continue
        found = list(check(e))
        for fault in found:
            e = LogSignals(e.log.without(fault.columns), {})
            yield fault, e.log
        if found:  # what is wrong told the delays of the others
            e = LogSignals(e.log, channels(e.log) or {})
