"""Faults that a log shows by itself: a localiser that jumps, driving without commands, dead columns, numbers of no robot.

`read_log` refuses what cannot be. Nothing here is certain enough to refuse a log; it says what is
not to be trusted. The wheels say when the robot moves, and what the gyro shows while it stands is
the gyro's bias.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import source
from ssmr.estimation.settings import EkfSettings
from ssmr.geometry import integral
from ssmr.robot.drive import body_rates
from ssmr.types import FloatArray, IndexArray
from validation.files.agreement import LogFault, apart, channels, contradictions, frozen
from validation.files.log import ANY_COLUMN, COLUMNS, COMMAND_COLUMNS, POSE_COLUMNS, Group, Log
from validation.files.reading import FileError
from validation.files.signals import TIME_ROUNDOFF, fresh_poses, moving_mean, nearest

STOCK = EkfSettings()
"""The state filter of a stock Husky, whose wheel radius and half-track convert encoders of a robot
that nobody named."""
_REST_V = 0.01
"""A robot stands if its wheels' speed, averaged over `2 _REST_MARGIN`, is below this [m/s]; noisy
encoders show a third."""
_REST_W = 0.02  # a robot stands if its wheels' yaw rate, averaged likewise, is below this [rad/s]
# samples that lie nearer to a motion than this do not count as rest [s]: odometry may be late
_REST_MARGIN = 0.5
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
JUMP_M = 0.2
"""Step of position beyond what the wheels explain from which it is a jump [m]: over twenty times
the noise of lidar odometry (6 to 9 mm), under what a robot of this size drives in a third of a
second."""
JUMP_RAD = 0.2
"""Step of heading beyond what the wheels explain from which it is a jump [rad]: ten times the noise
of lidar odometry."""
_CLOCKS_S = 1.0
_BIN_S = 0.1
"""Time around a step in which the wheels' fastest motion counts [s], for clocks of a log may be
that far apart; and the width of the bins in which it is looked for [s]."""
_SLIDES_S = 2.0
_SLIDES_V = 2.0
"""Time for which a robot may slide on ice after its wheels slow down [s], and speed from which it
does so for long [m/s]."""
_STALL_S = 4.0  # time in which a localiser may stall and then catch up [s]
_STAMPS_S = 0.4
_SLOW = 0.9
"""Error of a localiser's stamps [s], and rate above which a robot is fast: late poses look like
jumps [m/s, rad/s]."""
# speeds may be this many times those of the wheels: their radius is known roughly, and a robot
# slides on
_FASTER = 1.25
AFTER_COMMAND_S = 2.0
_BEFORE_COMMAND_S = 0.5
"""Time after a command in which wheels may still turn because of it [s]: a dead time of 0.4 s, and
a ramp of 1 m/s² from the speed of a fast robot. And before it, where clocks of a log differ."""
# change of heading from which a robot has turned [rad]; noise and a gyro's drift stay below it
_TURNED = 0.3
_DEAD = "the same number all the time, although the robot moves"
_MEASURED = ("pose", "wheels", "odom", "imu")
_FAST_RATE = 2000.0  # sampling rate of a measured group that no robot has [Hz]
WheelTwist = tuple[FloatArray, FloatArray, FloatArray]
"""(M,) stamps [s], speed [m/s] and yaw rate [rad/s]."""


# ------------------------------------------------------------------------------------------ what
# the wheels say
def twist_of(group: Group | None) -> WheelTwist | None:
    """Return the motion by a group's encoders, odometry or commands; None without any.

    Encoders are converted with the radius and half-track of a stock Husky's driver.
    """
    if group is None:
        return None
    if (rates := group.table(COMMAND_COLUMNS["wheels"])) is not None:
        left, right = rates.T
        return group.t, *source(body_rates)(left, right, STOCK.half_track, STOCK.radius)
    tables = [group.table(names) for names in (("odom_v", "odom_w"), COMMAND_COLUMNS["twist"])]
    return next(((group.t, *table.T) for table in tables if table is not None), None)


def wheel_twist(log: Log) -> WheelTwist | None:
    """Return the motion by a log's encoders or else its odometry; None without either."""
    return twist_of(log.groups.get("wheels")) or twist_of(log.groups.get("odom"))


def standing(log: Log, t: FloatArray) -> NDArray[np.bool_]:
    """Return (N,) whether the robot stood at instants `t` [s], by its wheels; False throughout where there are none."""
    wheels = wheel_twist(log)
    if wheels is None:
        return np.zeros(len(t), dtype=bool)
    stamps, v, w = wheels
    mean = [moving_mean(stamps, a, _REST_MARGIN) for a in (v, w)]
    before, after = nearest(stamps[(np.abs(mean[0]) > _REST_V) | (np.abs(mean[1]) > _REST_W)], t)
    return (np.minimum(before, after) > _REST_MARGIN) & (t >= stamps[0]) & (t <= stamps[-1])


@dataclass(frozen=True)
class Rest:
    """Readings of a gyro while the wheels stand."""

    bias: float
    """Mean of the readings [rad/s]."""
    std: float
    """Standard deviation of single readings [rad/s]."""
    seconds: float
    """Total time at rest [s]."""


def find_rest(log: Log) -> Rest | None:
    """Return the gyro's readings at rest; None without a gyro, or where the wheels stand for less than `REST_LEAST`."""
    imu = log.groups.get("imu")
    if imu is None:
        return None
    still = standing(log, imu.t)
    seconds = float(np.count_nonzero(still)) * imu.period
    shown = imu.columns["gyro_z"][still]
    return (
        Rest(float(np.mean(shown)), float(np.std(shown)), seconds)
        if seconds >= REST_LEAST
        else None
    )


def unbiased(log: Log) -> Log:
    """Return a log with the gyro's mean at rest taken out; a FileError says that it is unknown."""
    rest = find_rest(log)
    if rest is None:
        raise FileError(
            log.path, f"unbias needs a gyro, and wheels that stand for {REST_LEAST:g} s in all"
        )
    return log.changed("imu", {"gyro_z": log.columns["gyro_z"] - rest.bias})


# ------------------------------------------------------------------------------------------ faults
@dataclass(frozen=True, eq=False)
class Jumps:
    """Steps of a localiser's pose that the robot's speed cannot explain, K of them."""

    index: IndexArray
    """(K,) indices, in the group that holds x, y and yaw, of the first sample after each jump."""
    t: FloatArray
    """(K,) stamps of these samples [s]."""
    metres: FloatArray
    """(K,) lengths of the steps [m]."""
    radians: FloatArray
    """(K,) sizes of the turns [rad]."""
    caught_up: int
    """Number of steps with which the localiser caught up after it had stalled; they are no
    jumps."""
    late: NDArray[np.bool_]
    """(M,) which samples of that group are late, for the localiser stalled before it caught up."""


@dataclass(frozen=True, eq=False)
class Faults:
    """Faults of a log."""

    named: tuple[LogFault, ...]
    """Columns that are not what their names say."""
    jumps: Jumps | None
    """Jumps of the pose; None where there is no pose, or nothing says how fast the robot was."""
    uncommanded_share: float | None
    """Share of the time in which wheels turn without a command [1]; None without commands or
    wheels."""
    dead_columns: tuple[str, ...]
    """Columns that stay the same although the robot moves."""

    def sentences(self, *, named: bool = True) -> list[str]:
        """Return what is wrong with the log, a sentence each, with or without the `named` faults; none for a sound one."""
        notes = [fault.sentence for fault in self.named if named]
        if self.jumps is not None and (n := self.jumps.caught_up):
            notes.append(
                f"the localiser stalls and catches up {n} times: its poses are late there, and no jumps"
            )
        if self.jumps is not None and (n := len(self.jumps.t)):
            worst = f"up to {self.jumps.metres.max():.2f} m and {self.jumps.radians.max():.2f} rad"
            what = "once" if n == 1 else f"{n} times"
            notes.append(
                f"the localiser jumps {what}, {worst}, first at {self.jumps.t[0]:.2f} s: no window spans a jump"
            )
        if (share := self.uncommanded_share) is not None and share >= 0.01:
            percent = f"{100.0 * share:.0f} %"
            notes.append(
                f"the wheels turn with no command for {percent} of the log (joystick?); use --input wheels"
            )
        if unsaid := [
            name
            for name in self.dead_columns
            if not any(name in fault.columns for fault in self.named)
        ]:
            notes.append(f"{_DEAD}: {', '.join(unsaid)}")
        return notes


def find_faults(log: Log, radius: float | None = None) -> Faults:
    """Return what is wrong with a log; `radius` is that of the robot's wheels [m], None where nobody knows it."""
    named = tuple(_named(log, radius))
    dead = _dead_columns(log)
    return Faults(named, find_jumps(log), _uncommanded_share(log), dead)


def find_jumps(log: Log) -> Jumps | None:
    """Return the jumps of the pose.

    A step from one new pose to the next is a jump if it is longer than the fastest wheel's path in
    that time by `JUMP_M`, or turns further than the wheels by `JUMP_RAD`; slipping wheels only make
    a robot slower. Of a fast robot, the localiser may catch up what it missed in `_STALL_S` before,
    while it stalled, and its stamps may be wrong. Gaps are no steps. Without wheels the commands
    say how fast the robot was. Wheels of another robot than a stock Husky are larger: the median
    ratio of the driven steps to the wheels' paths says by how much, jumps or not.
    """
    group = next((g for g in log.groups.values() if g.table(POSE_COLUMNS) is not None), None)
    pose = None if group is None else group.table(POSE_COLUMNS)
    twist = wheel_twist(log) or twist_of(log.groups.get("cmd"))
    if group is None or pose is None or twist is None:
        return None
    stamps, v, w = twist
    turning = np.abs(w)
    # no point between the wheels is faster, for a stock Husky's size
    rim = np.abs(v) + STOCK.half_track * turning
    new = np.flatnonzero(fresh_poses(group.t, pose))
    t = group.t[new]
    steps = np.diff(pose[new], axis=0)
    metres = np.hypot(steps[:, 0], steps[:, 1])
    radians = np.abs(steps[:, 2])
    dt = np.diff(t)
    middle = np.interp(0.5 * (t[1:] + t[:-1]), stamps, rim)
    about = np.interp(0.5 * (t[1:] + t[:-1]), stamps, turning)
    driven = (middle > 0.5 * np.percentile(rim, 90.0)) & (middle > 0.0)
    larger = (
        max(1.0, float(np.median(metres[driven] / dt[driven] / middle[driven])))
        if np.any(driven)
        else 1.0
    )
    near, slid = (
        larger * _greatest_around(t, stamps, rim, back) for back in (_CLOCKS_S, _SLIDES_S)
    )
    # it turns by less than the wheels say
    skids = min(1.0, float(radians.sum() / max((about * dt).sum(), 1e-9)))
    sizes = (
        (metres, np.where(slid > _SLIDES_V, slid, near), larger * middle, JUMP_M),
        (radians, _greatest_around(t, stamps, turning, _CLOCKS_S), skids * about, JUMP_RAD),
    )
    piece = np.cumulative_sum(np.diff(group.t) > group.longest_step(), include_initial=True)[new]
    beyond, jumped, stalled = np.zeros((3, len(dt)), dtype=bool)
    for change, most, expected, least in sizes:
        stalled |= change < 0.5 * expected * dt
        excess = change - _FASTER * most * dt - least
        beyond |= excess > 0.0
        late_by = _missed(t, expected * dt, change) + _STAMPS_S * (most - _SLOW)
        jumped |= excess > np.where(most > _SLOW, late_by, 0.0)
    inside = np.diff(piece) == 0
    at = np.flatnonzero(jumped & inside)
    caught = beyond & ~jumped & inside
    until = nearest(t[:-1][caught], t[1:])[1]
    late = np.zeros(len(group.t), dtype=bool)
    late[new[1:]] = (until <= TIME_ROUNDOFF) | (stalled & (until < _STALL_S))
    return Jumps(
        new[at + 1], t[at + 1], metres[at], radians[at], int(np.count_nonzero(caught)), late
    )


def _missed(t: FloatArray, wanted: FloatArray, change: FloatArray) -> FloatArray:
    """Return (K - 1,) how much of the wanted a stall left out in `_STALL_S` before each step between (K,) instants [s]."""
    so_far = np.cumulative_sum(
        np.where(change < 0.5 * wanted, wanted - change, 0.0), include_initial=True
    )
    return so_far[:-1] - so_far[np.searchsorted(t[:-1], t[:-1] - _STALL_S)]


def _greatest_around(
    t: FloatArray, stamps: FloatArray, values: FloatArray, back: float
) -> FloatArray:
    """Return (K - 1,) largest values at `stamps` from `back` before steps between (K,) instants to `_CLOCKS_S` after [s]."""
    from scipy import ndimage  # here: it takes a tenth of a second to import

    bins = ((stamps - stamps[0]) / _BIN_S).astype(np.intp)
    greatest = np.zeros(bins[-1] + 1)
    np.maximum.at(greatest, bins, values)
    after, earlier = (round(seconds / _BIN_S) for seconds in (_CLOCKS_S, back - _CLOCKS_S))
    around = ndimage.maximum_filter1d(
        greatest, 2 * after + 3 + earlier, mode="nearest", origin=earlier // 2
    )
    at = np.clip((t - stamps[0]) / _BIN_S, 0, bins[-1]).astype(np.intp)
    ends = np.maximum(around[at], np.interp(t, stamps, values))
    return np.maximum(ends[:-1], ends[1:])


def _fastest_wheel(log: Log) -> tuple[FloatArray, FloatArray] | None:
    """Return (M,) stamps [s] and the rate of the faster side [rad/s]; None without wheels."""
    group = log.groups.get("wheels")
    rates = None if group is None else group.table(COMMAND_COLUMNS["wheels"])
    if group is None or rates is None:
        return None
    return group.t, np.abs([moving_mean(group.t, side, WHEELS_MEAN_S) for side in rates.T]).max(
        axis=0
    )


def _uncommanded_share(log: Log) -> float | None:
    """Return the share of time in which wheels turn although nothing was commanded for `AFTER_COMMAND_S`."""
    wheels = _fastest_wheel(log)
    command = twist_of(log.groups.get("cmd"))
    if wheels is None or command is None:
        return None
    t, rate = wheels
    stamps, v, w = command
    since, until = nearest(stamps[np.maximum(np.abs(v), np.abs(w)) > LEAST_COMMAND], t)
    quiet = (since > AFTER_COMMAND_S + WHEELS_MEAN_S) & (until > _BEFORE_COMMAND_S)
    return float(np.mean(quiet & (rate > WHEELS_TURN)))


def _dead_columns(log: Log) -> tuple[str, ...]:
    """Return the names of columns that stay the same although others say that the robot moves or turns."""
    there = log.columns
    wheels = _fastest_wheel(log)
    twist = wheel_twist(log)
    drives = wheels is not None and np.mean(wheels[1] > WHEELS_TURN) > 0.05
    posed = log.has(POSE_COLUMNS)
    moved = posed and max(np.ptp(there["x"]), np.ptp(there["y"])) > 0.5
    wheels_turn = twist is not None and np.ptp(integral(twist[0], twist[2])) > _TURNED
    turned = wheels_turn or (posed and np.ptp(there["yaw"]) > _TURNED)
    commanded = any(
        np.abs(there[name]).max() > LEAST_COMMAND
        for name in COMMAND_COLUMNS["twist"]
        if name in there
    )
    noisy = [
        name
        for name, known in COLUMNS.items()
        if known.usual < math.inf and known.group in ("odom", "channels")
    ]
    suspects = [
        (COMMAND_COLUMNS["twist"], drives or moved),
        *(((name,), moved or commanded) for name in COMMAND_COLUMNS["wheels"]),
        (("gyro_z",), turned),
        (("x", "y"), drives),
        (("yaw",), wheels_turn),
        *(((name,), drives or moved) for name in noisy),
    ]
    # a robot may be driven, but not by nothing
    zero = {name for names in COMMAND_COLUMNS.values() for name in names}
    dead = list[str]()
    for names, moves in suspects:
        if (
            moves
            and log.has(names)
            and all(np.ptp(there[n]) == 0.0 and not (n in zero and there[n][0]) for n in names)
        ):
            dead += names
    return tuple(dead)


def _named(log: Log, radius: float | None) -> Iterator[LogFault]:
    """Yield faults of columns: what the sampling rates say, what contradicts itself, what is dead and what is too large."""
    fast = [
        name
        for name in _MEASURED
        if name in log.groups and log.groups[name].period * _FAST_RATE < 1.0
    ]
    if fast:
        often = f"{1.0 / log.groups[fast[0]].period:.4g} samples a second"
        yield LogFault(
            "clock", ("t",), f"{fast[0]} has {often}, as no robot has: t may not be in seconds"
        )
        return
    signals = channels(log)
    faults = list[LogFault]()
    if signals is not None:
        faults = [*apart(log), *contradictions(signals, radius), *frozen(signals)]
    # joysticks command nothing
    dead = tuple(name for name in _dead_columns(log) if name not in COMMAND_COLUMNS["twist"])
    if unsaid := tuple(name for name in dead if not any(name in fault.columns for fault in faults)):
        faults.append(LogFault("frozen", unsaid, f"{_DEAD}: {', '.join(unsaid)}"))
    yield from faults
    for name, values in log.columns.items():
        known = COLUMNS.get(name, ANY_COLUMN)
        greatest = float(np.abs(values).max())
        if greatest > known.usual and not any(name in fault.columns for fault in faults):
            more = f"more than {known.usual:g}: it may be in {known.others}"
            yield LogFault("scale", (name,), f"{name} reaches {greatest:.4g} {known.unit}, {more}")
