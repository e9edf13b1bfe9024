"""Faults that a log shows by itself: jumps of a localiser, missing commands, dead columns.

`read_log` refuses impossible numbers. Nothing here is certain enough to refuse a log; it warns of
columns that are not to be trusted. The wheels say when the robot moves, and the gyro's mean while
it stands is the gyro's bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np

from ssmr._jit import source
from ssmr.estimation.settings import EkfSettings
from ssmr.robot.drive import body_rates
from ssmr.types import FloatArray, IndexArray
from validation.files.checks import checked
from validation.files.circular import new_poses
from validation.files.log import (
    COMMAND_COLUMNS,
    Group,
    Log,
    LogFault,
)
from validation.files.reading import FileError
from validation.files.signals import TIME_ROUNDOFF, BoolArray, moving_mean, nearest

STOCK = EkfSettings()
"""The state filter of a stock Husky, whose wheel radius and half-track convert encoders of a robot
that nobody named."""
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
JUMP_M = 0.2
"""Step of position beyond what the wheels explain from which it is a jump [m]: over twenty times
the noise of lidar odometry (6 to 9 mm), under what a robot of this size drives in a third of a
second."""
JUMP_RAD = 0.2
"""Step of heading beyond what the wheels explain from which it is a jump [rad]: ten times the noise
of lidar odometry."""
_CLOCKS_S = 1.0
"""Time around a step in which the wheels' fastest motion counts [s], for clocks of a log may be
that far apart."""
_BIN_S = 0.1
"""Width of the bins in which the fastest motion is looked for [s]."""
_SLIDES_S = 2.0
"""Time for which a robot may slide on ice after its wheels slow down [s]."""
_SLIDES_V = 2.0
"""Speed from which a robot slides for so long [m/s]."""
_STALL_S = 4.0
"""Time in which a localiser may stall and then catch up [s]."""
_STAMPS_S = 0.4
"""Error of a localiser's stamps [s]."""
_SLOW = 0.9
"""Rate above which a robot is so fast that late poses look like jumps [m/s, rad/s]."""
_FASTER = 1.25
"""Ratio that speeds may have to those of the wheels [1]: their radius is known roughly, and a robot
slides on."""
AFTER_COMMAND_S = 2.0
"""Time after a command in which wheels may still turn because of it [s]: a dead time of 0.4 s, and
a ramp of 1 m/s² from the speed of a fast robot."""
_BEFORE_COMMAND_S = 0.5
"""The same time before a command [s], as clocks of a log differ."""
_TWIST = COMMAND_COLUMNS["twist"]
WheelTwist = tuple[FloatArray, FloatArray, FloatArray]
"""(M,) stamps [s], speed [m/s] and yaw rate [rad/s]."""


# ------------------------------------------------------------------------------------------
# motion by the wheels
def twist_of(group: Group | None) -> WheelTwist | None:
    """Return the motion by a group's encoders, odometry or commands; None without any.

    Encoders are converted with the radius and half-track of a stock Husky's driver.
    """
    if group is None:
        return None
    rates = group.table(COMMAND_COLUMNS["wheels"])
    if rates is not None:
        left, right = rates.T
        return group.t, *source(body_rates)(left, right, STOCK.half_track, STOCK.radius)
    for names in (("odom_v", "odom_w"), COMMAND_COLUMNS["twist"]):
        table = group.table(names)
        if table is not None:
            return group.t, *table.T
    return None


def _wheel_twist(log: Log) -> WheelTwist | None:
    """Return the motion by a log's encoders or else its odometry; None without either."""
    return twist_of(log.groups.get("wheels")) or twist_of(log.groups.get("odom"))


def standing(log: Log, t: FloatArray) -> BoolArray:
    """Return (N,) whether the robot stood at instants `t` [s], by its wheels; False without any."""
    wheels = _wheel_twist(log)
    if wheels is None:
        return np.zeros(len(t), dtype=bool)
    stamps, v, w = wheels
    drives = np.abs(moving_mean(stamps, v, _REST_MARGIN)) > _REST_V
    turns = np.abs(moving_mean(stamps, w, _REST_MARGIN)) > _REST_W
    before, after = nearest(stamps[drives | turns], t)
    covered = (t >= stamps[0]) & (t <= stamps[-1])
    return (np.minimum(before, after) > _REST_MARGIN) & covered


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
    """Return the gyro's readings at rest; None without a gyro or `REST_LEAST` of standing."""
    imu = log.groups.get("imu")
    if imu is None:
        return None
    still = standing(log, imu.t)
    seconds = float(np.count_nonzero(still)) * imu.period
    if seconds < REST_LEAST:
        return None
    readings = imu.columns["gyro_z"][still]
    return Rest(float(np.mean(readings)), float(np.std(readings)), seconds)


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
    late: BoolArray
    """(M,) which samples of that group are late, for the localiser stalled before it caught up."""

    def sentences(self) -> list[str]:
        """Return a sentence on stalls and one on jumps, where there are any."""
        notes = []
        if self.caught_up:
            notes.append(
                f"the localiser stalls and catches up {self.caught_up} times: "
                "its poses are late there, and no jumps"
            )
        n = len(self.t)
        if n:
            times = "once" if n == 1 else f"{n} times"
            what = (
                f"the localiser jumps {times}, "
                f"up to {self.metres.max():.2f} m and {self.radians.max():.2f} rad, "
                f"first at {self.t[0]:.2f} s"
            )
            notes.append(f"{what}: no window spans a jump")
        return notes


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
        """Return a sentence for each fault of the log, with or without the `named` ones."""
        notes = [fault.sentence for fault in self.named if named]
        if self.jumps is not None:
            notes += self.jumps.sentences()
        share = self.uncommanded_share
        if share is not None and share >= 0.01:
            notes.append(
                f"the wheels turn with no command for {100.0 * share:.0f} % of the log "
                "(joystick?); use --input wheels"
            )
        return notes


def find_faults(log: Log, radius: float | None = None) -> Faults:
    """Return the faults of a log; `radius` is that of the wheels [m], None where it is unknown."""
    faults = (*log.faults, *checked(log, radius))
    share = _uncommanded_share(log)
    frozen = chain(*(fault.columns for fault in faults if fault.kind == "frozen"))
    dead = [*frozen, *(_TWIST if share and log.has(_TWIST) else ())]
    same = tuple(name for name in dead if np.ptp(log.columns[name]) == 0.0)
    return Faults(faults, find_jumps(log), share, same)


def find_jumps(log: Log) -> Jumps | None:
    """Return the jumps of the pose.

    A step from one new pose to the next is a jump if it is longer than the fastest wheel's path in
    that time by `JUMP_M`, or turns further than the wheels by `JUMP_RAD`; slipping wheels only make
    a robot slower. Of a fast robot, the localiser may catch up the way that it missed in `_STALL_S`
    before, while it stalled, and its stamps may be wrong. Gaps are no steps. Without wheels the
    commands say how fast the robot was. Wheels of another robot than a stock Husky are larger: the
    median ratio of the driven steps to the wheels' paths says by how much, jumps or not.
    """
    poses = new_poses(log)
    twist = _wheel_twist(log) or twist_of(log.groups.get("cmd"))
    if poses is None or twist is None:
        return None
    group, new, t, pose = poses
    stamps, v, w = twist
    turning = np.abs(w)
    # no point between the wheels is faster, for a stock Husky's size
    rim = np.abs(v) + STOCK.half_track * turning
    steps = np.diff(pose, axis=0)
    metres = np.hypot(steps[:, 0], steps[:, 1])
    radians = np.abs(steps[:, 2])
    dt = np.diff(t)
    middles = 0.5 * (t[1:] + t[:-1])
    speed = np.interp(middles, stamps, rim)
    yaw_rate = np.interp(middles, stamps, turning)
    driven = (speed > 0.5 * np.percentile(rim, 90.0)) & (speed > 0.0)
    larger = 1.0
    if np.any(driven):
        larger = max(1.0, float(np.median(metres[driven] / dt[driven] / speed[driven])))
    near = larger * _greatest_around(t, stamps, rim, _CLOCKS_S)
    sliding = larger * _greatest_around(t, stamps, rim, _SLIDES_S)
    fastest = np.where(sliding > _SLIDES_V, sliding, near)
    fastest_turn = _greatest_around(t, stamps, turning, _CLOCKS_S)
    # wheels that skid turn a robot by less than they say
    skids = min(1.0, float(radians.sum() / max((yaw_rate * dt).sum(), 1e-9)))
    sizes = (
        (metres, fastest, larger * speed, JUMP_M),
        (radians, fastest_turn, skids * yaw_rate, JUMP_RAD),
    )
    gaps = np.diff(group.t) > group.longest_step()
    piece = np.cumulative_sum(gaps, include_initial=True)[new]
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
        index=new[at + 1],
        t=t[at + 1],
        metres=metres[at],
        radians=radians[at],
        caught_up=int(np.count_nonzero(caught)),
        late=late,
    )


def _missed(t: FloatArray, expected: FloatArray, change: FloatArray) -> FloatArray:
    """Return (K - 1,) the change that a stall left out in `_STALL_S` before each step.

    `t` are the (K,) instants between which the steps lie [s], `expected` and `change` the (K - 1,)
    changes by the wheels and by the localiser.
    """
    missing = np.where(change < 0.5 * expected, expected - change, 0.0)
    so_far = np.cumulative_sum(missing, include_initial=True)
    start = t[:-1]
    return so_far[:-1] - so_far[np.searchsorted(start, start - _STALL_S)]


def _greatest_around(
    t: FloatArray, stamps: FloatArray, values: FloatArray, back: float
) -> FloatArray:
    """Return the (K - 1,) largest values around steps between (K,) instants `t` [s].

    Around means from `back` [s] before a step to `_CLOCKS_S` after it; `stamps` [s] are those of
    the values.
    """
    shifts = np.arange(-back, _CLOCKS_S + _BIN_S, _BIN_S)
    ends = np.max([np.interp(t + shift, stamps, values) for shift in shifts], axis=0)
    return np.maximum(ends[:-1], ends[1:])


def _fastest_wheel(log: Log) -> tuple[FloatArray, FloatArray] | None:
    """Return (M,) stamps [s] and the rate of the faster side [rad/s]; None without wheels."""
    names = COMMAND_COLUMNS["wheels"]
    group = log.group_of(names)
    if group is None:
        return None
    means = [moving_mean(group.t, group.columns[name], WHEELS_MEAN_S) for name in names]
    return group.t, np.abs(means).max(axis=0)


def _uncommanded_share(log: Log) -> float | None:
    """Return the share of time in which wheels turn `AFTER_COMMAND_S` or more after a command."""
    wheels = _fastest_wheel(log)
    command = twist_of(log.groups.get("cmd"))
    if wheels is None or command is None:
        return None
    t, rate = wheels
    stamps, v, w = command
    commanded = np.maximum(np.abs(v), np.abs(w)) > LEAST_COMMAND
    since, until = nearest(stamps[commanded], t)
    quiet = (since > AFTER_COMMAND_S + WHEELS_MEAN_S) & (until > _BEFORE_COMMAND_S)
    return float(np.mean(quiet & (rate > WHEELS_TURN)))
