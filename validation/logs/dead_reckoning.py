"""Where a log's wheels and gyro say that the robot went, by odometry and by the state filter, beside what knew better."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ssmr.estimation.ekf import EkfSettings, learn_bias, run_ekf
from ssmr.geometry import align_rigidly
from ssmr.metrics.paths import path_length
from ssmr.robot.drive import wheel_rates
from ssmr.types import FloatArray, State, Trajectory
from validation.logs.signals import POSES, Group, Groups, selected, standing, wheel_twist

TRUTHS = (("gps", ("gps_east", "gps_north")), ("pose", ("x", "y")))
"""What dead reckoning is held against: the first that there is."""


@dataclass(frozen=True)
class Reckoned:
    """One way of dead reckoning."""

    name: str
    """What tables call it."""
    rms: float
    """Root mean square distance from the truth after rigid alignment [m]."""
    length: float
    """Of its path over the truth's duration [m]."""


@dataclass(frozen=True)
class Reckoning:
    """Ways of dead reckoning beside each other."""

    truth: str
    """The topic or file, and the group, that they are held against."""
    samples: int
    """How many positions of it there are."""
    rows: tuple[Reckoned, ...]
    """At least one."""


def run_filter(groups: Groups, *, gyro: bool = True, bias: bool = True) -> Trajectory | None:
    """The state filter over a log, from pose 0 on; None without wheels or, if wanted, without a gyro.

    It runs at the gyro's stamps, where there is one, and takes the wheels' rates linearly between theirs.

    Args:
        groups: the log.
        gyro: whether it listens to the gyro.
        bias: whether the gyro's bias is learned whenever the robot stands, see `learn_bias`, and taken off from then on.
    """
    wheels, imu = wheel_twist(groups), groups.get("imu")
    if wheels is None or (gyro and imu is None):
        return None
    stamps, v, w = wheels
    turning, t = None, stamps
    if gyro and imu is not None:
        within = (imu.t >= stamps[0]) & (imu.t <= stamps[-1])
        t, turning = imu.t[within], imu.columns["gyro_z"][within]
        if len(t) < 2:
            return None
        if bias:
            turning = turning - learn_bias(t, turning, standing(groups, t))[:, 0]
    settings = EkfSettings()
    rates = [np.interp(t, stamps, a) for a in (v, w)]
    left, right = wheel_rates.py_func(*rates, settings.half_track, settings.radius)
    return run_ekf(t, left, right, turning, settings, State())


def integrated(groups: Groups) -> Group | None:
    """Positions from the wheels' speed along the gyro's plain integral, midpoint rule; None without either."""
    wheels, imu = wheel_twist(groups), groups.get("imu")
    if wheels is None or imu is None:
        return None
    stamps, v, _ = wheels
    within = (imu.t >= stamps[0]) & (imu.t <= stamps[-1])
    t, rate = imu.t[within], imu.columns["gyro_z"][within]
    if len(t) < 2:
        return None
    dt = np.diff(t)
    yaw = _summed(dt * 0.5 * (rate[1:] + rate[:-1]))
    speed, heading = np.interp(t[:-1] + 0.5 * dt, stamps, v), 0.5 * (yaw[1:] + yaw[:-1])
    return Group("", t, {"x": _summed(dt * speed * np.cos(heading)), "y": _summed(dt * speed * np.sin(heading))})


def _summed(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


def reckon(groups: Groups) -> Reckoning | None:
    """All ways of dead reckoning that a log allows, held against its satellite or localiser's positions.

    Returns:
        None where there is no truth, or no wheels.
    """
    found = next(((n, names) for n, names in TRUTHS if n in groups and selected(groups[n].columns, names) is not None), None)
    tracks = list(_tracks(groups, found[0])) if found is not None else []
    if found is None or not tracks:
        return None
    truth = groups[found[0]]
    points = selected(truth.columns, found[1])
    start, stop = max(t[0] for _, t, _ in tracks), min(t[-1] for _, t, _ in tracks)
    within = (truth.t >= start) & (truth.t <= stop)
    if points is None or np.count_nonzero(within) < 3:
        return None
    at, points = truth.t[within], points[within]
    rows = []
    for name, t, xy in tracks:
        there = np.column_stack([np.interp(at, t, column) for column in xy.T])
        away = align_rigidly(there, points) - points
        driven = xy[(t >= at[0]) & (t <= at[-1])]
        rows.append(Reckoned(name, float(np.sqrt(np.mean(np.sum(away**2, axis=1)))), path_length(driven)))
    return Reckoning(f"{truth.source} ({found[0]})", len(at), tuple(rows))


def _tracks(groups: Groups, truth: str) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Name, stamps [s] and positions [m] of each way; the odometry's own pose first."""
    odom = groups.get("odom")
    for names in POSES if odom is not None else ():
        xy = selected(odom.columns, names[:2]) if odom is not None else None
        if odom is not None and xy is not None:
            yield "odometry's own pose", odom.t, xy
    filters: tuple[tuple[str, dict[str, bool]], ...] = (
        ("filter of wheels", {"gyro": False}),
        ("filter of wheels and gyro", {"bias": False}),
        ("the same, bias learned at rest", {}),
    )
    plain = integrated(groups)
    if plain is not None:
        yield "wheels' speed, gyro's heading", plain.t, np.column_stack(list(plain.columns.values()))
    for name, options in filters:
        motion = run_filter(groups, **options)
        if motion is not None:
            yield name, motion.t, motion.pose[:, :2]


def with_filter(groups: Groups) -> dict[str, Group] | None:
    """The log with the filter's pose as its x, y, yaw; what it had as these is called odom_x ... or pose_x ...

    None without wheels.
    """
    motion = run_filter(groups) or run_filter(groups, gyro=False)
    if motion is None:
        return None
    renamed = {
        name: replace(g, columns={(f"{name}_{n}" if n in POSES[0] else n): a for n, a in g.columns.items()})
        for name, g in groups.items()
    }
    old = renamed.pop("pose", None)
    pose = dict(zip(POSES[0], motion.pose.T, strict=True))
    return {"pose": Group("state filter", motion.t, pose), **renamed, **({"localiser": old} if old is not None else {})}
