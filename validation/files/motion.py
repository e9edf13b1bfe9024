"""Speed and yaw rate of a robot, by the sensor that tells them, each at stamps of its own.

A gyro tells turns; wheels, odometry and commands tell ways and turns; a localiser tells poses, and
jumps where these change by more than a robot's speed explains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ssmr._jit import python_source
from ssmr.estimation.settings import EkfSettings
from ssmr.geometry import integrate_rates
from ssmr.robot.drive import body_rates
from ssmr.types import FloatArray, IndexArray
from validation.files.columns import COMMAND_COLUMNS, POSE_COLUMNS
from validation.files.log import Group
from validation.files.signals import TIME_ROUNDOFF, BoolArray, fresh_poses, nearest, refreshed

STOCK = EkfSettings()
"""The state filter of a stock Husky, whose wheel radius and half-track convert encoders of a robot
that nobody named."""
ENCODERS = COMMAND_COLUMNS["wheels"]
TWIST = COMMAND_COLUMNS["twist"]
ODOMETRY = ("odom_v", "odom_w")
RATES = (*ENCODERS, *ODOMETRY, "gyro_z", *TWIST)
"""Columns that are rates."""
SENSORS = ("imu", "wheels", "odom", "pose", "cmd")
"""Groups that tell of motion; a gyro measures its yaw rate at once, and is the clock of others."""
_TURNS = {"imu": "gyro_z", "odom": "odom_w", "pose": "yaw", "cmd": "cmd_w"}
_SPEEDS = {"odom": "odom_v", "cmd": "cmd_v"}
_HALF_TURN = 0.5 * np.pi
"""Half of the greatest turn in a window whose arc follows from its chord [rad]; a robot that turns
by a whole circle ends where it began."""
Way = tuple[FloatArray, FloatArray]
"""(K,) stamps [s], and the way of a column since the first of them."""
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


# ------------------------------------------------------------------------------------------ rates
def motion_by_sensor(
    rates: Mapping[str, FloatArray], window: float = 0.0
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return the speeds [m/s] and the yaw rates [rad/s] that columns tell, by sensor.

    Wheels are those of a stock Husky, whatever the robot. Poses tell a speed where there is a
    `heading`.

    Args:
        rates: (N,) rates by column, or rates of change of x, y and yaw.
        window: time over which rates of change are means [s].
    """
    speeds = {sensor: rates[name] for sensor, name in _SPEEDS.items() if name in rates}
    turns = {sensor: rates[name] for sensor, name in _TURNS.items() if name in rates}
    if {*ENCODERS} <= rates.keys():
        left, right = (rates[name] for name in ENCODERS)
        of_wheels = python_source(body_rates)(left, right, STOCK.half_track, STOCK.radius)
        speeds["wheels"], turns["wheels"] = of_wheels
    if {*POSE_COLUMNS, "heading"} <= rates.keys():
        heading = rates["heading"]
        chord = rates["x"] * np.cos(heading) + rates["y"] * np.sin(heading)
        # of a quick turn, the chord is shorter than the arc that wheels tell
        half = np.clip(0.5 * window * rates["yaw"], -_HALF_TURN, _HALF_TURN)
        speeds["pose"] = chord / np.sinc(half / np.pi)
    return speeds, turns


class Told(NamedTuple):
    """The motion that rates of a sensor tell, M samples that were measured anew."""

    group: Group
    """Group that they are of, whose gaps are the sensor's."""
    t: FloatArray
    """(M,) stamps [s]."""
    speed: FloatArray | None
    """(M,) speeds [m/s]; None of a gyro."""
    turn: FloatArray
    """(M,) yaw rates [rad/s]."""


class NewPoses(NamedTuple):
    """Poses of a log that are new, M of them."""

    group: Group
    """Group that they are of."""
    rows: IndexArray
    """(M,) their indices in it."""
    t: FloatArray
    """(M,) stamps [s]."""
    pose: FloatArray
    """(M, 3) x, y [m] and yaw [rad]."""


def ways_of(group: Group) -> dict[str, Way]:
    """Return the ways of a group's columns, of new samples."""
    ways = {}
    pose = group.table(POSE_COLUMNS)
    for name, values in group.columns.items():
        column = values[:, None]
        if name in POSE_COLUMNS:
            new = fresh_poses(group.t, column if pose is None else pose)
        elif name in RATES:
            new = refreshed(group.t, column)
        else:
            continue
        t = new_samples(new, group.t)
        way = new_samples(new, values)
        if name in TWIST:  # which hold until the next one
            way = np.cumulative_sum(way[:-1] * np.diff(t), include_initial=True)
        elif name in RATES:
            way = integrate_rates(t, way)
        ways[name] = t, way
    return ways


def new_samples(new: BoolArray, values: FloatArray) -> FloatArray:
    """Return the values of new samples: where all are new, themselves, for logs may be large."""
    return values if np.all(new) else values[new]


# ------------------------------------------------------------------------------------------ jumps
@dataclass(frozen=True, eq=False)
class Jumps:
    """Steps of a localiser's pose that the robot's speed cannot explain, K of them."""

    index: IndexArray
    """(K,) indices, in the group that holds x, y and yaw, of the first sample after each jump."""
    t: FloatArray
    """(K,) stamps of these samples [s]."""
    since: FloatArray
    """(K,) stamps of the new poses before them [s]."""
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
                f"stalls after which the localiser catches up: {self.caught_up}; "
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


def find_jumps(poses: NewPoses | None, wheels: Told | None) -> Jumps | None:
    """Return the jumps of the pose.

    A step from one new pose to the next is a jump if it is longer than the fastest wheel's path in
    that time by `JUMP_M`, or turns further than the wheels by `JUMP_RAD`; slipping wheels only make
    a robot slower. Of a fast robot, the localiser may catch up the way that it missed in `_STALL_S`
    before, while it stalled, and its stamps may be wrong. Gaps are no steps. Without wheels the
    commands say how fast the robot was. Wheels of another robot than a stock Husky are larger: the
    median ratio of the driven steps to the wheels' paths says by how much, jumps or not.
    """
    if poses is None or wheels is None or wheels.speed is None:
        return None
    group, new, t, pose = poses
    stamps = wheels.t
    turning = np.abs(wheels.turn)
    # no point between the wheels is faster, for a stock Husky's size
    rim = np.abs(wheels.speed) + STOCK.half_track * turning
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
    piece = np.cumulative_sum(group.breaks(), include_initial=True)[new]
    beyond, jumped, stalled = np.zeros((3, len(dt)), dtype=bool)
    for change, most, expected, least in sizes:
        stalled |= change < 0.5 * expected * dt
        excess = change - _FASTER * most * dt - least
        beyond |= excess > 0.0
        late_by = _missed_change(t, expected * dt, change) + _STAMPS_S * (most - _SLOW)
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
        since=t[at],
        metres=metres[at],
        radians=radians[at],
        caught_up=int(np.count_nonzero(caught)),
        late=late,
    )


def _missed_change(t: FloatArray, expected: FloatArray, change: FloatArray) -> FloatArray:
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
    ends = np.full(len(t), -np.inf)
    for shift in shifts:
        np.maximum(ends, np.interp(t + shift, stamps, values), out=ends)
    return np.maximum(ends[:-1], ends[1:])
