"""Dead reckoning on a log: the path by its wheels and gyro, compared with the positions of a better sensor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ssmr._jit import source
from ssmr.estimation.ekf import aiding_by, run_ekf
from ssmr.estimation.settings import EkfSettings, commission, learning, zeroed
from ssmr.geometry import align_rigidly
from ssmr.metrics.paths import path_length
from ssmr.robot.drive import Sides, wheel_rates
from ssmr.types import FloatArray, State, Trajectory
from validation.files.faults import STOCK, WheelTwist, standing, wheel_twist
from validation.files.log import POSE_COLUMNS, POSES, Group, Log
from validation.files.reading import FileError, quoted
from validation.files.signals import smoothed

_UNKNOWN_SPEED = (0.0, 0.0, 0.0, 1.0, 1.0)
"""Standard deviations of the start of a filter that learns [m, m, rad, m/s, rad/s]: a log may begin while the robot
moves, and a yaw rate that is taken for none would be believed to be the gyro's bias."""
_PIECES = 10  # number of pieces of a log whose means tell how sure a gyro's bias is
_SMOOTHING, _LEAST_STRETCH = 0.15, 2.0
"""Standard deviation of the Gaussian that smooths poses before they are differentiated, and the least stretch without a gap
from which a robot is commissioned [s]."""
_TRUTHS = {"gps": ("gps_east", "gps_north"), "pose": ("x", "y")}
"""Groups and columns whose positions dead reckoning is compared with: the first that a log has."""


@dataclass(frozen=True)
class ReckonedPath:
    """Result of one way of dead reckoning."""

    name: str
    """Name in tables."""
    rms: float
    """Root mean square distance from the better positions, after rigid alignment [m]."""
    length: float
    """Length of its path over the same time [m]."""


@dataclass(frozen=True)
class Reckoning:
    """Results of several ways of dead reckoning."""

    truth: str
    """Topic or file, and group, of the positions that they are compared with."""
    samples: int
    """Number of these positions."""
    rows: tuple[ReckonedPath, ...]
    """At least one."""


def filtered_motion(log: Log, settings: EkfSettings = STOCK, *, bias: bool = True) -> Trajectory | None:
    """Run the state filter over a log, from pose 0 on.

    It runs at the gyro's stamps, where there is one, and interpolates the wheels' rates linearly between theirs.

    Args:
        log: the log.
        settings: the filter's, with wheel radius and half-track of the robot's driver.
        bias: True if what the gyro shows whenever the robot stands tells its bias, see `zeroed`, from the log's beginning.
            The bias is subtracted, or a filter that learns begins with it.

    Returns:
        The filter's motion; None without wheels.
    """
    wheels = wheel_twist(log, settings)
    if wheels is None:
        return None
    t, turning = _gyro_within(log, wheels[0]) or (wheels[0], None)
    left, right = _rates_at(t, wheels, settings)
    still = standing(log, t)
    if turning is not None and bias and settings.learns:
        settings, turning = zeroed(settings, turning[still]), np.where(still, np.nan, turning)
    elif turning is not None and bias:
        turning = turning - zeroed(learning(settings), turning[still]).bias
    std = _UNKNOWN_SPEED if settings.learns else (0.0,) * 5
    return run_ekf(t, left, right, turning, settings, State(), std, aiding_by(still) if settings.learns else None)


def _rates_at(t: FloatArray, wheels: WheelTwist, settings: EkfSettings) -> Sides:
    """Return the (N,) rates of the left and right wheels at instants [s], interpolated."""
    stamps, v, w = wheels
    return source(wheel_rates)(np.interp(t, stamps, v), np.interp(t, stamps, w), settings.half_track, settings.radius)


def _gyro_within(log: Log, stamps: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the gyro's stamps [s] and yaw rates [rad/s] within `stamps` [s]; None for fewer than two."""
    imu = log.groups.get("imu")
    if imu is None:
        return None
    within = (imu.t >= stamps[0]) & (imu.t <= stamps[-1])
    return (imu.t[within], imu.columns["gyro_z"][within]) if np.count_nonzero(within) > 1 else None


def commissioned_on(log: Log, odometry: EkfSettings = STOCK) -> EkfSettings:
    """Return a filter that knows the constants of the robot of a log, from its wheels and the poses of a better sensor.

    Poses are smoothed, and gaps left out. Offsets of time have to be taken out before. Where there is a gyro, its bias is
    the mean of what it shows beside the poses, with the standard error of such means over pieces of the log.

    Args:
        log: the log.
        odometry: wheel radius and half-track of the robot's driver.

    Raises:
        ValueError: there are no wheels, or no poses at the same time, or the robot does not move, or does not turn.
    """
    wheels, pose = wheel_twist(log, odometry), log.groups.get("pose")
    columns = None if pose is None else pose.table(POSE_COLUMNS)
    drives, off = list[Trajectory](), list[FloatArray]()
    if wheels is not None and pose is not None and columns is not None:
        gyro, rims = _gyro_within(log, wheels[0]), np.column_stack(_rates_at(pose.t, wheels, odometry))
        within = (pose.t >= wheels[0][0]) & (pose.t <= wheels[0][-1])
        for part in np.split(np.arange(len(pose.t)), np.flatnonzero(np.diff(pose.t) > pose.longest_step()) + 1):
            kept = part[within[part]]
            t = pose.t[kept]
            if len(t) and t[-1] - t[0] > _LEAST_STRETCH:
                found = np.column_stack([smoothed(t, column, _SMOOTHING) for column in columns[kept].T])
                x, y, turn = np.gradient(found, t, axis=0).T
                c, s = np.cos(found[:, 2]), np.sin(found[:, 2])
                drives.append(Trajectory(t, found, np.column_stack([c * x + s * y, c * y - s * x, turn]), rims[kept]))
                off += [] if gyro is None else [np.interp(t, *gyro) - turn]
    if not drives:
        raise FileError(log.path, "commissioning needs wheels or odometry, and poses x, y, yaw of a better sensor")
    settings = commission(drives, odometry)
    if not off:
        return settings
    means = [np.mean(part) for part in np.array_split(np.concatenate(off), _PIECES)]
    return replace(settings, bias=float(np.mean(means)), bias_std=float(np.std(means) / np.sqrt(_PIECES - 1)))


def reckon(
    log: Log, settings: EkfSettings = STOCK, more: Mapping[str, EkfSettings] = MappingProxyType({})
) -> Reckoning | None:
    """Compare ways of dead reckoning with a log's positions by satellite or by a localiser.

    `settings` of the filter have wheel radius and half-track of the robot's driver; `more` has further filters, by name.

    Returns:
        None where the log has no such positions, or no wheels.
    """
    positions = {n: log.groups[n].table(names) for n, names in _TRUTHS.items() if n in log.groups}
    name, points = next(((n, xy) for n, xy in positions.items() if xy is not None), ("", None))
    tracks = list(_tracks(log, settings, more)) if points is not None else []
    if points is None or not tracks:
        return None
    truth = log.groups[name]
    start, stop = max(t[0] for _, t, _ in tracks), min(t[-1] for _, t, _ in tracks)
    within = (truth.t >= start) & (truth.t <= stop)
    if np.count_nonzero(within) < 3:
        return None
    at, points = truth.t[within], points[within]
    rows = []
    for way, t, xy in tracks:
        there = np.column_stack([np.interp(at, t, column) for column in xy.T])
        away = align_rigidly(there, points) - points
        driven = xy[(t >= at[0]) & (t <= at[-1])]
        rows.append(ReckonedPath(way, float(np.sqrt(np.mean(np.sum(away**2, axis=1)))), path_length(driven)))
    return Reckoning(f"{truth.source} ({name})", len(at), tuple(rows))


def _tracks(
    log: Log, settings: EkfSettings, more: Mapping[str, EkfSettings]
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield name, stamps [s] and positions [m] of each way; the odometry's own pose comes first."""
    for names in POSES:
        xy = log.groups["odom"].table(names[:2]) if "odom" in log.groups else None
        if xy is not None:
            yield "odometry's own pose", log.groups["odom"].t, xy
    ways = [("filter of wheels", settings, False)]
    if "imu" in log.groups:
        ways = [("filter of wheels and gyro", settings, False), ("filter, bias learned at rest", settings, True)]
        ways += [(name, further, True) for name, further in more.items()]
    for name, used, bias in ways:
        if (motion := filtered_motion(log, used, bias=bias)) is not None:
            yield name, motion.t, motion.xy


def with_filter(log: Log, settings: EkfSettings = STOCK) -> Log:
    """Return the log with the filter's pose as its x, y, yaw, see `filtered_motion`.

    Columns that had these names before are called odom_x ... or pose_x ... in the result.

    Raises:
        ValueError: there are no wheels, or there is a column of such a name already.
    """
    motion = filtered_motion(log, settings)
    if motion is None:
        raise FileError(log.path, "ekf needs wheels or odometry, which the log has none of")
    groups = {
        name: replace(g, columns={(f"{name}_{n}" if n in POSE_COLUMNS else n): a for n, a in g.columns.items()})
        for name, g in log.groups.items()
    }
    named = [name for group in groups.values() for name in group.columns]
    if twice := sorted({name for name in named if named.count(name) > 1}):
        raise FileError(log.path, f"there is a column {quoted(twice)} already, which the former pose needs; rename it")
    old = {"localiser": groups.pop("pose")} if "pose" in groups else {}
    pose = Group("state filter", motion.t, dict(zip(POSE_COLUMNS, motion.pose.T, strict=True)))
    return replace(log, groups={"pose": pose, **groups, **old})
