"""Faults that a log shows by itself: a localiser that jumps, driving without commands, dead columns, numbers of no robot.

`LogLimits` refuses what cannot be. Nothing here is certain enough to refuse a log; it says what is not to be trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ssmr.geometry import integral
from ssmr.types import FloatArray, IndexArray
from validation.logs.groups import Groups, stacked_columns
from validation.logs.recording import COMMAND_COLUMNS, POSE_COLUMNS, fresh_poses
from validation.logs.rest import ASKS_FOR_MOTION, STOCK, WHEELS_MEAN_S, WHEELS_TURN, moving_mean, wheel_twist

JUMP_M = 0.2
"""Step of position beyond what the wheels explain from which it is a jump [m]: over twenty times the noise of lidar odometry
(6 to 9 mm), under what a robot of this size drives in a third of a second."""
JUMP_RAD = 0.2
"""Step of heading beyond what the wheels explain from which it is a jump [rad]: ten times the noise of lidar odometry."""
_CLOCKS_S = 1.0
"""Time around a step in which the wheels' fastest motion counts [s]: clocks of a log may be that far apart."""
_BIN_S = 0.1
"""Width of the bins in which the fastest motion is looked for [s]."""
_FASTER = 1.25
"""Speeds may be this many times those of the wheels: their radius is known roughly, and a robot slides on."""
AFTER_COMMAND_S = 2.0
"""Time after a command in which wheels may still turn because of it [s]: a dead time of 0.4 s, and a ramp of 1 m/s² from the
speed of a fast robot."""
_BEFORE_COMMAND_S = 0.5
"""Time before a command in which wheels may turn because of it [s], where clocks of a log differ."""
_TURNED = 0.3
"""Change of heading from which a robot has turned [rad]; noise and a gyro's drift stay below it."""
_SLOW_RATE, _FAST_RATE = 2.0, 2000.0
"""Sampling rates of measured groups between which they are of use [Hz]: a skid-steered robot starts and stops within half a
second, and no controller of one runs faster."""
_PLAUSIBLE: Mapping[str, tuple[float, str, str]] = {
    **dict.fromkeys(("cmd_v", "odom_v"), (10.0, "m/s", "mm/s or km/h")),
    **dict.fromkeys(("cmd_w", "odom_w", "gyro_z"), (15.0, "rad/s", "degrees per second")),
    **dict.fromkeys(("enc_left", "enc_right"), (100.0, "rad/s", "rpm, ticks or degrees per second")),
    **dict.fromkeys(("acc_x", "acc_y", "acc_z"), (160.0, "m/s²", "mg")),
    **dict.fromkeys(("current_left", "current_right"), (1000.0, "A", "mA")),
    **dict.fromkeys(("voltage_left", "voltage_right"), (200.0, "V", "mV")),
}
"""Greatest size that a column of a ground robot has, its unit, and the units that it may be in if it is beyond."""
_MEASURED = tuple(name for name in _PLAUSIBLE if not name.startswith(("cmd", "gyro", "enc")))
"""Columns that always change a little while a robot moves, because noise is in them."""


_TOO_FAR = 8.0
"""Ratio of two measures of the same motion from which one of them may be in another unit [1]: wheels of half or twice the
size, and wheels that slip by three quarters, stay below it; millimetres (1000) and degrees (57) do not."""
_RATIO_S = 1.0
"""Length of the intervals over which motions are compared [s], long enough that the localiser's noise does not count."""
_RATIO_LEAST, _RATIO_COUNT = 0.1, 10
"""Least motion of the wheels in such an interval [m, rad], and least number of such intervals."""


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


@dataclass(frozen=True, eq=False)
class LogHealth:
    """Faults of a log."""

    jumps: Jumps | None
    """Jumps of the pose; None where there is no pose, or nothing says how fast the robot was."""
    uncommanded_share: float | None
    """Share of the time in which wheels turn without a command [1]; None without commands or wheels."""
    dead_columns: tuple[str, ...]
    """Columns that stay the same although the robot moves."""
    implausible: tuple[str, ...]
    """Sentences about rates and magnitudes that no robot of this kind has."""

    def sentences(self) -> list[str]:
        """Return what is wrong with the log, a sentence each; none for a sound one."""
        found = []
        if self.jumps is not None and (n := len(self.jumps.t)):
            worst = f"up to {self.jumps.metres.max():.2f} m and {self.jumps.radians.max():.2f} rad"
            what = "once" if n == 1 else f"{n} times"
            found.append(f"the localiser jumps {what}, {worst}, first at {self.jumps.t[0]:.2f} s: no window spans a jump")
        if (share := self.uncommanded_share) is not None and share >= 0.01:
            found.append(f"the wheels turn without a command for {100.0 * share:.0f} % of the time, as by joystick")
        if self.dead_columns:
            found.append(f"the same number all the time, although the robot moves: {', '.join(self.dead_columns)}")
        return [*found, *self.implausible]


def find_faults(groups: Groups) -> LogHealth:
    """Return what is wrong with a log, from its groups; for a recording those of `groups_of`."""
    implausible = tuple(_implausible(groups)) or tuple(_mismatches(groups))
    return LogHealth(find_jumps(groups), _uncommanded_share(groups), _dead_columns(groups), implausible)


def find_jumps(groups: Groups) -> Jumps | None:
    """Return the jumps of the pose.

    A step from one new pose to the next is a jump if it is longer than the fastest wheel's path in that time by `JUMP_M`, or
    turns further than the wheels by `JUMP_RAD`; slipping wheels only make a robot slower. Gaps are no steps. Without wheels
    the commands say how fast the robot was.
    """
    found = ((g, stacked_columns(g.columns, POSE_COLUMNS)) for g in groups.values())
    group, pose = next(((g, pose) for g, pose in found if pose is not None), (None, None))
    speeds = _greatest_speeds(groups)
    if group is None or pose is None or speeds is None:
        return None
    new = np.flatnonzero(fresh_poses(group.t, pose))
    t, steps = group.t[new], np.diff(pose[new], axis=0)
    metres, radians, dt = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2]), np.diff(t)
    stamps, rim, turning = speeds
    path = _FASTER * _scale(rim, stamps, t, metres) * _greatest_around(t, stamps, rim) * dt
    turn = _FASTER * _greatest_around(t, stamps, turning) * dt
    beyond = (metres - path > JUMP_M) | (radians - turn > JUMP_RAD)
    piece = np.cumulative_sum(np.diff(group.t) > group.longest_step(), include_initial=True)[new]
    at = np.flatnonzero(beyond & (np.diff(piece) == 0))
    return Jumps(new[at + 1], t[at + 1], metres[at], radians[at])


def _greatest_speeds(groups: Groups) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return (M,) stamps [s], and bounds of speed [m/s] and yaw rate [rad/s]; None where nothing tells them.

    No point between the wheels is faster than the faster side, for a stock Husky's size.
    """
    found = wheel_twist(groups)
    if found is None and "cmd" in groups and all(name in groups["cmd"].columns for name in COMMAND_COLUMNS["twist"]):
        command = groups["cmd"]
        found = command.t, command.columns["cmd_v"], command.columns["cmd_w"]
    if found is None:
        return None
    t, v, w = found
    return t, np.abs(v) + STOCK.half_track * np.abs(w), np.abs(w)


def _scale(rim: FloatArray, stamps: FloatArray, t: FloatArray, metres: FloatArray) -> float:
    """Return how many times faster than a stock Husky with these wheel rates the robot is, at least 1.

    Wheels of another robot are larger. The median of the driven steps' own ratios says by how much, jumps or not.
    """
    at = np.interp(0.5 * (t[1:] + t[:-1]), stamps, rim)
    driven = at > 0.5 * np.percentile(rim, 90.0)
    if not np.any(driven & (at > 0.0)):
        return 1.0
    return max(1.0, float(np.median(metres[driven] / np.diff(t)[driven] / at[driven])))


def _greatest_around(t: FloatArray, stamps: FloatArray, values: FloatArray) -> FloatArray:
    """Return the (K - 1,) greatest of (M,) values at `stamps` within `_CLOCKS_S` of the steps between (K,) instants [s]."""
    from scipy import ndimage  # here: it takes a tenth of a second to import

    bins = ((stamps - stamps[0]) / _BIN_S).astype(np.intp)
    greatest = np.zeros(bins[-1] + 1)
    np.maximum.at(greatest, bins, values)
    around = ndimage.maximum_filter1d(greatest, 2 * round(_CLOCKS_S / _BIN_S) + 3, mode="nearest")
    at = np.clip((t - stamps[0]) / _BIN_S, 0, bins[-1]).astype(np.intp)
    ends = np.maximum(around[at], np.interp(t, stamps, values))
    return np.maximum(ends[:-1], ends[1:])


def _fastest_wheel(groups: Groups) -> tuple[FloatArray, FloatArray] | None:
    """Return (M,) stamps [s] and the rate of the faster side [rad/s]; None without wheels."""
    group = groups.get("wheels")
    rates = None if group is None else stacked_columns(group.columns, COMMAND_COLUMNS["wheels"])
    if group is None or rates is None:
        return None
    sides = [moving_mean(group.t, side, WHEELS_MEAN_S) for side in rates.T]
    return group.t, np.abs(sides).max(axis=0)


def _uncommanded_share(groups: Groups) -> float | None:
    """Return the share of time in which wheels turn although nothing was commanded for `AFTER_COMMAND_S`."""
    wheels = _fastest_wheel(groups)
    command = None if "cmd" not in groups else stacked_columns(groups["cmd"].columns, COMMAND_COLUMNS["twist"])
    if wheels is None or command is None:
        return None
    t, rate = wheels
    driven = groups["cmd"].t[np.abs(command).max(axis=1) > ASKS_FOR_MOTION]
    at = np.concatenate([[-np.inf], driven, [np.inf]])
    after = np.searchsorted(at, t, side="right")
    quiet = (t - at[after - 1] > AFTER_COMMAND_S + WHEELS_MEAN_S) & (
        at[np.minimum(after, len(at) - 1)] - t > _BEFORE_COMMAND_S
    )
    return float(np.mean(quiet & (rate > WHEELS_TURN)))


def _dead_columns(groups: Groups) -> tuple[str, ...]:
    """Return the names of columns that stay the same although others say that the robot moves or turns."""
    there = {name: values for group in groups.values() for name, values in group.columns.items()}
    wheels, twist = _fastest_wheel(groups), wheel_twist(groups)
    pose = stacked_columns(there, POSE_COLUMNS)
    drives = wheels is not None and bool(np.mean(wheels[1] > WHEELS_TURN) > 0.05)
    moved = pose is not None and bool(np.ptp(pose[:, :2], axis=0).max() > 0.5)
    wheels_turn_it = twist is not None and _turns(twist[0], twist[2])
    turned = pose is not None and bool(np.ptp(pose[:, 2]) > _TURNED)
    asked = any(np.abs(there[name]).max() > ASKS_FOR_MOTION for name in COMMAND_COLUMNS["twist"] if name in there)

    def dead(*names: str) -> list[str]:
        return list(names) if all(n in there and np.ptp(there[n]) == 0.0 for n in names) else []

    def zero(*names: str) -> list[str]:
        return list(names) if all(n in there and not np.any(there[n]) for n in names) else []

    found = zero(*COMMAND_COLUMNS["twist"]) if drives or moved else []
    for name in COMMAND_COLUMNS["wheels"] if moved or asked else ():
        found += zero(name)
    if wheels_turn_it or turned:
        found += dead("gyro_z")
    if drives:
        found += dead("x", "y")
    if wheels_turn_it:
        found += dead("yaw")
    for name in _MEASURED if drives or moved else ():
        found += dead(name)
    return tuple(found)


def _turns(t: FloatArray, rate: FloatArray) -> bool:
    """Return whether (M,) yaw rates [rad/s] add up to a turn."""
    return bool(np.ptp(integral(t, rate)) > _TURNED)


def _implausible(groups: Groups) -> list[str]:
    """Return sentences about rates and magnitudes that no robot of this kind has."""
    found = []
    for name, group in groups.items():
        rate = 1.0 / group.period
        if name in ("pose", "wheels", "odom", "imu") and not _SLOW_RATE <= rate <= _FAST_RATE:
            found.append(f"{name} has {rate:.4g} samples a second, where {_SLOW_RATE:g} to {_FAST_RATE:g} are of use")
        for column in (c for c in _PLAUSIBLE if c in group.columns):
            most, unit, other = _PLAUSIBLE[column]
            if (greatest := float(np.abs(group.columns[column]).max())) > most:
                found.append(f"{column} reaches {greatest:.4g} {unit}, more than {most:g}: it may be in {other}")
    return found


def _mismatches(groups: Groups) -> list[str]:
    """Return sentences about measures of the same motion that no slip and no size of wheels can tell so differently."""
    wheels = wheel_twist(groups)
    if wheels is None:
        return []
    t, v, w = wheels
    path, turn = integral(t, np.abs(v)), integral(t, w)
    there = {name: (group.t, values) for group in groups.values() for name, values in group.columns.items()}
    grid = np.arange(t[0], t[-1], _RATIO_S)
    of_wheels = {"path": np.diff(np.interp(grid, t, path)), "turn": np.abs(np.diff(np.interp(grid, t, turn)))}
    found = []
    if "x" in there and "y" in there:
        x, y = (np.diff(np.interp(grid, *there[name])) for name in ("x", "y"))
        ratio = _median_ratio(np.hypot(x, y), of_wheels["path"])
        if ratio > _TOO_FAR:
            found.append(f"x and y move {ratio:.3g} times as far as the wheels roll: they may be in mm or cm")
        elif ratio < 1.0 / _TOO_FAR:
            found.append(
                f"the wheels roll {1.0 / ratio:.3g} times as far as x and y move: rates may be in rpm or degrees per second"
            )
    if "yaw" in there:
        ratio = _median_ratio(np.abs(np.diff(np.interp(grid, *there["yaw"]))), of_wheels["turn"])
        if ratio > _TOO_FAR:
            found.append(f"yaw turns {ratio:.3g} times as far as the wheels say: it may be in degrees")
    if "gyro_z" in there:
        stamps, rate = there["gyro_z"]
        turned = np.abs(np.diff(np.interp(grid, stamps, integral(stamps, rate))))
        ratio = _median_ratio(turned, of_wheels["turn"])
        if ratio > _TOO_FAR:
            found.append(f"gyro_z turns {ratio:.3g} times as far as the wheels say: it may be in degrees per second")
    return found


def _median_ratio(moved: FloatArray, wheels: FloatArray) -> float:
    """Return the median of the ratio over the intervals in which the wheels move [1]; 1 where there are few."""
    driven = wheels > _RATIO_LEAST
    if np.count_nonzero(driven) < _RATIO_COUNT:
        return 1.0
    return max(float(np.median(moved[driven] / wheels[driven])), 1e-9)
