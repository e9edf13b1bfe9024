"""A log is looked at once, where it is opened.

That finds what it shows by itself, faults and the gyro's readings at rest, and for what it is good
enough. `read_log` refuses impossible numbers. Nothing here is certain enough to refuse a log; it
warns of columns that are not to be trusted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import chain, pairwise
from typing import Any

import numpy as np

from ssmr.types import FloatArray
from validation.files.columns import POSE_COLUMNS
from validation.files.explanation import find_parts, judged
from validation.files.formats import AnyLog, read_log
from validation.files.hypotheses import TAKEN_OUT, say_late
from validation.files.log import PLAIN, Group, Log, LogFault, ReadOptions
from validation.files.motion import ENCODERS, TWIST
from validation.files.offsets import Offset, estimate_offsets
from validation.files.plain_faults import FACTS, too_large
from validation.files.reading import FileError
from validation.files.sensors import Signals
from validation.files.signals import COMMAND_TIMEOUT, BoolArray, moving_mean, nearest

_REST_V = 0.01
"""A robot stands if its wheels' speed, averaged over `2 _REST_MARGIN`, is below this [m/s]; noisy
encoders show a third."""
_REST_W = 0.02
"""A robot stands if its wheels' yaw rate, averaged likewise, is below this [rad/s]."""
_REST_MARGIN = 0.5
"""Samples that lie nearer to a motion than this do not count as rest [s]: odometry may be late."""
REST_LEAST = 2.0
"""Shortest total rest from which a bias is taken [s]."""
WHEELS_MEAN_S = 0.25
"""Time before and after an instant over which wheel rates are averaged, against the noise of
encoders [s]."""
WHEELS_TURN = 0.1
"""Wheel rate above which a wheel turns [rad/s]: 16 mm/s of a Husky, well above the noise of means
of encoders."""
LEAST_COMMAND = 0.01
"""Size of a command above which it asks for motion [m/s, rad/s]."""
AFTER_COMMAND_S = 2.0
"""Time after a command in which wheels may still turn because of it [s]: a dead time of 0.4 s, and
a ramp of 1 m/s² from the speed of a fast robot."""
_BEFORE_COMMAND_S = 0.5
"""The same time before a command [s], as clocks of a log differ."""
_FATAL = (
    *("sign", "swapped", "scale", "handedness", "circular", "positions", "setpoints"),
    *("unrelated", "same", "frame", "counter", "disagree", "curvature", "clipped"),
)
"""Kinds of faults with which no fit makes sense, as long as they are not put right."""
_WINDOW_S = 6.0
"""Length of the windows over which predictions are judged [s]."""
_PARTS = 3.0
"""A log is fitted on all but one of so many parts of it, and judged on that."""
_STEP_S = 0.5
"""Time between the poses that are compared [s]."""
_STANDS = 0.3
"""Way [m] and turn [rad] of a whole log below which the robot stands."""
_TURNED = 0.4
"""Change of heading below which a log hardly turns [rad]."""
_SLOW = 0.03
"""Speed below which wheels and localisers tell little but noise [m/s]."""
_UNSURE = 0.02
"""Error of the robot's width, over it, from which turns to one side do not suffice [1]."""
_STEADY = 0.05
"""Deviation of speed and yaw rate, over their means, of a constant circle [1]."""


# ------------------------------------------------------------------------------------------ rest
def standing(signals: Signals, t: FloatArray) -> BoolArray:
    """Return (N,) whether the robot stood at instants `t` [s], by its wheels; False without any."""
    wheels = signals.as_logged("wheels", "odom")
    if wheels is None or wheels.speed is None:
        return np.zeros(len(t), dtype=bool)
    stamps = wheels.t
    drives = np.abs(moving_mean(stamps, wheels.speed, _REST_MARGIN)) > _REST_V
    turns = np.abs(moving_mean(stamps, wheels.turn, _REST_MARGIN)) > _REST_W
    before, after = nearest(stamps[drives | turns], t)
    covered = (t >= stamps[0]) & (t <= stamps[-1])
    return (np.minimum(before, after) > _REST_MARGIN) & covered


Rest = Mapping[str, float]
"""Readings of a gyro while the wheels stand: their mean, `bias`, and the standard deviation of
single ones, `std` [rad/s], and the time at rest, `seconds`."""


def find_rest(signals: Signals) -> Rest | None:
    """Return the gyro's readings at rest; None without a gyro or `REST_LEAST` of standing."""
    imu = signals.log.groups.get("imu")
    if imu is None:
        return None
    still = standing(signals, imu.t)
    seconds = float(np.count_nonzero(still)) * imu.period
    if seconds < REST_LEAST:
        return None
    readings = imu.columns["gyro_z"][still]
    bias = float(np.mean(readings))
    return {"bias": bias, "std": float(np.std(readings)), "seconds": seconds}


def unbiased(log: Log, rest: Rest | None) -> Log:
    """Return a log with the gyro's mean at rest taken out; a FileError says that it is unknown."""
    if rest is None:
        raise FileError(
            log.path, f"unbias needs a gyro, and wheels that stand for {REST_LEAST:g} s in all"
        )
    return log.changed("imu", {"gyro_z": log.columns["gyro_z"] - rest["bias"]})


# ------------------------------------------------------------------------------------------ faults
def _list_faults(signals: Signals) -> Iterator[LogFault]:
    """Yield what single columns show, and then what explains all that are left."""
    for fact in FACTS:
        for fault in fact(signals):
            yield fault
            if signals.log.columns.keys() <= {*fault.columns}:
                return
            signals = signals.without(fault.columns)
    wheels = signals.log.group_of(ENCODERS)
    if wheels is not None and standing(signals, wheels.t)[1:-1].all():
        return  # noise of a robot that stands agrees with nothing
    found = [*judged(signals)]
    yield from found
    blamed = {*chain(*(fault.columns for fault in found))}
    for sensor, seconds in signals.windows.late.items():
        names = tuple(signals.log.groups[sensor].columns)
        if abs(seconds) > TAKEN_OUT and not blamed & {"t", *names}:
            yield LogFault("clock", names, say_late(names, seconds))
    for fault in too_large(signals):
        if not blamed & {*fault.columns}:
            yield fault


def _uncommanded_share(signals: Signals) -> float | None:
    """Return the share of time in which wheels turn `AFTER_COMMAND_S` or more after a command."""
    wheels = signals.log.group_of(ENCODERS)
    command = signals.as_logged("cmd")
    if wheels is None or command is None or command.speed is None:
        return None
    t = wheels.t
    means = [moving_mean(t, wheels.columns[name], WHEELS_MEAN_S) for name in ENCODERS]
    asked = np.maximum(np.abs(command.speed), np.abs(command.turn))
    since, until = nearest(command.t[asked > LEAST_COMMAND], t)
    quiet = (since > AFTER_COMMAND_S + WHEELS_MEAN_S) & (until > _BEFORE_COMMAND_S)
    return float(np.mean(quiet & (np.abs(means).max(axis=0) > WHEELS_TURN)))


# ------------------------------------------------------------------------------------------ the log
class Inspected(Signals):
    """A log as it was read, and what it shows by itself, each looked for once.

    A part of it is no other log: its clocks, its gyro and its columns are those of the whole.
    """

    @cached_property
    def faults(self) -> tuple[LogFault, ...]:
        """Columns that are not what their names say."""
        return (*self.log.faults, *_list_faults(self))

    @cached_property
    def uncommanded_share(self) -> float | None:
        """Share of the time in which wheels turn without a command [1].

        None without commands or wheels.
        """
        return _uncommanded_share(self)

    @cached_property
    def dead_columns(self) -> tuple[str, ...]:
        """Columns that stay the same although the robot moves."""
        log = self.log
        dead = [*chain(*(fault.columns for fault in self.faults if fault.kind == "frozen"))]
        if self.uncommanded_share and log.has(TWIST):
            dead += TWIST
        return tuple(name for name in dead if np.ptp(log.columns[name]) == 0.0)

    def sentences(self) -> list[str]:
        """Return what is to be known before its numbers are used, besides its `faults`."""
        jumps = self.jumps
        notes = [] if jumps is None else jumps.sentences()
        share = self.uncommanded_share
        if share is not None and share >= 0.01:
            notes.append(
                f"the wheels turn with no command for {100.0 * share:.0f} % of the log "
                "(joystick?); use --input wheels"
            )
        return notes

    @cached_property
    def parts(self) -> list[dict[str, Any]]:
        """What each part of it tells of the robot, see `find_parts`."""
        return find_parts(self)

    @cached_property
    def offsets(self) -> tuple[Offset, ...]:
        """Delays between its signals."""
        return tuple(estimate_offsets(self))

    @cached_property
    def rest(self) -> Rest | None:
        """The gyro's readings while the robot stands; None without any."""
        return find_rest(self)

    @cached_property
    def lacks(self) -> tuple[str, ...]:
        """A sentence for each thing that it cannot tell, and what to drive."""
        return tuple(_find_lacks(self))

    @property
    def unsolved(self) -> list[LogFault]:
        """Its faults but those that were put right when it was read."""
        return [fault for fault in self.faults if fault not in self.log.faults]

    @property
    def fatal(self) -> list[LogFault]:
        """Those of them with which no fit makes sense."""
        return [
            fault
            for fault in self.unsolved
            if fault.kind in _FATAL or (fault.kind, fault.columns) == ("drift", ("yaw",))
        ]

    @cached_property
    def sound_part(self) -> tuple[float, float] | None:
        """Start and end of the longest part without a fatal fault [s].

        None where the whole has none, a fault has no ends, or the rest tells too little. When a
        fault begins and ends is known to the width of a window.
        """
        margin = self.windows.width
        first = float(min(group.t[0] for group in self.log.groups.values()))
        last = float(max(group.t[-1] for group in self.log.groups.values()))
        faulty = [
            (
                first if fault.from_s is None else fault.from_s - margin,
                last if fault.to_s is None else fault.to_s + margin,
            )
            for fault in self.fatal
        ]
        edges = sorted({first, last, *chain.from_iterable(faulty)})
        rest = [
            (a, b) for a, b in pairwise(edges) if all(b <= low or high <= a for low, high in faulty)
        ]
        start, end = max(rest, key=lambda part: part[1] - part[0], default=(first, first))
        if not faulty or end - start < margin:
            return None
        part = Inspected(self.log.cut(start, end), self.radius)
        return None if part.fatal or part.lacks else (start, end)

    def good_for(self) -> dict[str, bool]:
        """Return whether a fit by `wheels`, by `commands`, and a look at the `gyro` make sense.

        A fit makes sense where it does for a part.
        """
        spoiled = {*chain(*(fault.columns for fault in self.fatal))}
        needs = {"gyro": ("gyro_z",), "commands": TWIST, "wheels": ENCODERS}
        good = {}
        for name, columns in needs.items():
            used = {*POSE_COLUMNS, *columns}
            is_sound = not spoiled & used or (name != "gyro" and self.sound_part is not None)
            good[name] = self.log.has(used) and is_sound and not self.lacks
        return good

    @cached_property
    def common(self) -> Log:
        """The log on one clock, see `Log.on_one_clock`."""
        return self.log.on_one_clock()


def open_log(given: AnyLog, options: ReadOptions = PLAIN, radius: float | None = None) -> Inspected:
    """Open a log, once for all that a program does with it.

    The arguments and errors are those of `read_log`.
    """
    return Inspected(_with_held_commands(read_log(given, options, radius)), radius)


def _with_held_commands(log: Log) -> Log:
    """Return a log whose commands are logged at least every quarter of a second.

    Where none is like the one before, and they are rare, they were logged when they changed, and
    each holds until the next one.
    """
    group = log.groups.get("cmd")
    if group is None or group.period < COMMAND_TIMEOUT:
        return log
    table = np.column_stack(list(group.columns.values()))
    if np.any(np.all(table[1:] == table[:-1], axis=1)):
        return log
    between = np.arange(group.t[0], group.t[-1], 0.5 * COMMAND_TIMEOUT)
    t = np.union1d(group.t, between)
    last = np.searchsorted(group.t, t, side="right") - 1
    columns = {name: values[last] for name, values in group.columns.items()}
    remark = (
        f"commands were logged when they changed, every {group.period:.2g} s in the median: each "
        "is held until the next one"
    )
    groups = {**log.groups, "cmd": Group(group.source, t, columns)}
    return replace(log, groups=groups, remarks=(*log.remarks, remark))


def too_short(longest: float) -> list[str]:
    """Return a sentence on a log whose longest stretch without a gap [s] has no window."""
    if longest >= _WINDOW_S:
        return []
    return [
        f"{longest:.3g} s without a gap are too short for a window of {_WINDOW_S:g} s: "
        "drive for a minute or more, or let recordings convert --rate 10 bridge gaps up to 0.25 s"
    ]


def _find_lacks(signals: Signals) -> Iterator[str]:
    """Yield a sentence for each thing that a log with poses cannot tell, and what to drive."""
    poses = signals.poses
    if poses is None:
        return
    edges = [float(poses.group.t[0]), *np.ravel(poses.group.gaps()), float(poses.group.t[-1])]
    if short := too_short(float(np.max(np.diff(edges)[::2]))):
        yield from short
        return
    t = poses.t
    stands = "the robot stands: drive ahead, back, and curves to both sides"
    if len(t) < 3:
        yield stands
        return
    whole = float(t[-1] - t[0])
    if whole < _PARTS * _WINDOW_S:
        yield (
            f"the last third of {whole:.3g} s is too short to judge on: drive for a minute or more"
        )
    grid = np.arange(t[0], t[-1], _STEP_S)
    x, y, yaw = (np.interp(grid, t, column) for column in poses.pose.T)
    speed = np.hypot(np.diff(x), np.diff(y)) / _STEP_S
    rate = np.diff(yaw) / _STEP_S
    extent = max(np.ptp(x), np.ptp(y))
    turned = np.ptp(yaw)
    if extent < _STANDS and turned < _STANDS:
        yield stands
    elif turned < _TURNED:
        yield (
            "the pose's heading never turns, so how the robot turns cannot be determined: drive "
            "curves to both sides, and turn on the spot, or take a heading that follows the robot"
        )
    elif extent < _STANDS:
        yield "the robot only turns on the spot: drive ahead and curves too"
    else:
        yield from _uniform_motions(signals, speed, rate)


def _unsure_width(signals: Signals) -> float:
    """Return the standard error of the robot's width, over it, that wheels and poses leave [1]."""
    if signals.wheels is None or signals.along is None:
        return math.inf
    moved = np.column_stack([signals.along, signals.means["yaw"]])
    errors = []
    for side in signals.wheels:
        factors = np.linalg.lstsq(moved, side)[0]
        # windows overlap by half
        variance = 2.0 * np.mean((side - moved @ factors) ** 2)
        spread = math.sqrt(variance * np.linalg.pinv(moved.T @ moved)[1, 1])
        errors.append(spread / max(abs(float(factors[1])), 1e-9))
    return max(errors)


def _uniform_motions(signals: Signals, speed: FloatArray, rate: FloatArray) -> Iterator[str]:
    """Yield what is too uniform in (N,) speeds [m/s] and yaw rates [rad/s] of a log."""
    moving = speed > _SLOW
    if np.mean(moving) < 0.2 and np.percentile(speed, 98.0) < 2.0 * _SLOW:
        yield f"the robot is slower than {_SLOW:g} m/s, so noise hides its motion: drive faster"
        return
    v = speed[moving]
    w = rate[moving]
    turns = float(np.mean(np.abs(w)))
    if turns > 0.02 and np.std(v) < _STEADY * np.mean(v) and np.std(w) < _STEADY * turns:
        yield "the robot drives one constant circle: change speed and radius, and turn both ways"
        return
    sides = [float(np.sum(w[w > 0.0])), -float(np.sum(w[w < 0.0]))]
    if min(sides) < 0.02 * max(sides) and _unsure_width(signals) > _UNSURE:
        yield "the robot turns to one side only, so left and right wheels are mixed: turn both ways"
