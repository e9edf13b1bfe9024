"""The bag format of logs: streams of a bag become groups of columns.

The columns are cmd_v, cmd_w from the role `cmd`; enc_left, enc_right from `wheels`; gyro_z from `imu`; and x, y, yaw from
`pose` or, without one, from `odom`. Channels are odom_v [m/s], odom_w [rad/s] from `odom` (and odom_x, odom_y, odom_yaw
where there is a `pose`), and gps_east, gps_north [m] from `gps`. Times are counted from the bag's epoch.

The yaw rate is taken about the vertical that the IMU's accelerometer shows, however the IMU is mounted. Positions of a
satellite receiver become metres east and north of the first fix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray
from validation.logs.bag_topics import ROLES, choose_topics, fits
from validation.logs.bag_writer import write_bag
from validation.logs.bags import UNITS, Bag, Stream, read_bag
from validation.logs.groups import Group
from validation.logs.log import Log, LogFormat, ReadOptions, Topic
from validation.logs.recording import RecordingError

_GRAVITY_SPAN = (8.8, 10.8)
"""Range of a mean acceleration that is taken for gravity and shows the vertical [m/s2]; outside it, z is the vertical."""

_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563
"""Semi-major axis [m] and flattening [1] of the WGS 84 ellipsoid."""


def groups_of_bag(bag: Bag, chosen: Mapping[str, Stream]) -> dict[str, Group]:
    """Return the streams, by role, as groups of columns.

    Raises:
        RecordingError: no stream was chosen, a number is not finite, a clock jumped, or a stream has fewer than two samples.
    """
    if not chosen:
        there = ", ".join(f"{s.topic} ({s.type})" for s in bag.streams) or "no topic of a type that can be read"
        raise RecordingError(bag.path, f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {there}")
    return {role: as_group(bag, role, stream, "pose" in chosen) for role, stream in chosen.items()}


def as_group(bag: Bag, role: str, stream: Stream, has_pose: bool) -> Group:
    """Return one stream as a group of checked columns; `has_pose` says whether the bag has another pose than odometry's.

    Raises:
        RecordingError: a number is not finite, the clock jumped, or there are fewer than two samples.
    """
    leave = f"topics {role}=none leaves it out"
    if stream.jumps:
        when, size = stream.jumps[0]
        many = f", and {len(stream.jumps) - 1} times more" if len(stream.jumps) > 1 else ""
        what = f"the clock of topic {stream.topic} jumps by {size:+.3f} s after {when:.3f} s{many}"
        raise RecordingError(bag.path, f"{what}; stamps bag takes the times of writing, {leave}")
    first = np.concatenate([[True], np.diff(stream.t) > 0.0])  # the first sample of each stamp
    if np.count_nonzero(first) < 2:
        raise RecordingError(bag.path, f"topic {stream.topic} has fewer than two samples; {leave}")
    t, columns = stream.t[first], {name: values[first] for name, values in stream.columns.items()}
    for name in _used(role, stream):
        bad = np.flatnonzero(~np.isfinite(columns[name]))
        if len(bad):
            what = f"topic {stream.topic}, {t[bad[0]]:.3f} s: {name} is {columns[name][bad[0]]}"
            raise RecordingError(bag.path, f"{what}, wanted a finite number [{UNITS[name]}]; {leave}")
    out = _CONVERTERS[role](t, columns)
    if role == "odom" and fits(stream, "pose"):
        prefix = "odom_" if has_pose else ""
        out |= {f"{prefix}{n}": values for n, values in _pose(t, columns).items()}
    return Group(stream.topic, t, out)


def _used(role: str, stream: Stream) -> tuple[str, ...]:
    """Return the names of the columns that a recording is made of."""
    if role == "wheels":
        return _wheel_columns(stream.columns)
    pose = ROLES["pose"] if role == "odom" and fits(stream, "pose") else ()
    return (*ROLES[role], *pose, *(n for n in ("acc_x", "acc_y", "acc_z") if role == "imu" and n in stream.columns))


def _wheel_columns(columns: Mapping[str, FloatArray]) -> tuple[str, str]:
    kind = "rate" if "rate_left" in columns else "angle"
    return f"{kind}_left", f"{kind}_right"


_Columns = Mapping[str, FloatArray]


def _cmd(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"cmd_v": columns["v"], "cmd_w": columns["w"]}


def _odom(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"odom_v": columns["v"], "odom_w": columns["w"]}


def _wheels(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    left, right = (columns[name] for name in _wheel_columns(columns))
    if "rate_left" not in columns:
        left, right = (np.asarray(np.gradient(np.unwrap(a), t), dtype=np.float64) for a in (left, right))
    return {"enc_left": left, "enc_right": right}


def _imu(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"gyro_z": np.column_stack([columns[f"gyro_{axis}"] for axis in "xyz"]) @ vertical(columns)}


def _pose(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"x": columns["x"], "y": columns["y"], "yaw": np.unwrap(columns["yaw"])}


def _gps(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    east, north = to_local(columns["latitude"], columns["longitude"])
    return {"gps_east": east, "gps_north": north}


_CONVERTERS: Mapping[str, Callable[[FloatArray, _Columns], dict[str, FloatArray]]] = MappingProxyType(
    {"cmd": _cmd, "odom": _odom, "wheels": _wheels, "imu": _imu, "pose": _pose, "gps": _gps}
)


def vertical(columns: Mapping[str, FloatArray]) -> FloatArray:
    """Return the (3,) unit vector that points up in an IMU's own axes: along its mean acceleration, or z."""
    up = np.array([0.0, 0.0, 1.0])
    if all(f"acc_{axis}" in columns for axis in "xyz"):
        mean = np.array([np.mean(columns[f"acc_{axis}"]) for axis in "xyz"])
        size = float(np.linalg.norm(mean))
        if _GRAVITY_SPAN[0] < size < _GRAVITY_SPAN[1]:
            up = mean / size
    return up


def to_local(latitude: ArrayLike, longitude: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return (M,) metres east and north of the first of (M,) positions [deg].

    The plane touches the ellipsoid there. The result is good to some centimetres within a kilometre: terms of second order
    in the distance over the radius are left out.
    """
    lat, lon = np.radians(np.asarray(latitude, dtype=np.float64)), np.asarray(longitude, dtype=np.float64)
    eccentricity2 = _FLATTENING * (2.0 - _FLATTENING)
    root = math.sqrt(1.0 - eccentricity2 * math.sin(lat[0]) ** 2)
    meridian, transverse = _EQUATOR * (1.0 - eccentricity2) / root**3, _EQUATOR / root  # radii of curvature
    turned = np.radians(np.mod(lon - lon[0] + 180.0, 360.0) - 180.0)  # also across the date line
    return transverse * math.cos(lat[0]) * turned, meridian * (lat - lat[0])


def _read(path: Path, options: ReadOptions) -> Log:
    bag = read_bag(path, options.stamps)
    chosen = choose_topics(bag, options.topics)
    groups: dict[str, Group] = {}
    faults = []
    if options.lenient:
        for role, stream in chosen.items():
            try:
                groups[role] = as_group(bag, role, stream, "pose" in chosen)
            except RecordingError as error:
                faults.append(str(error))
    else:
        groups = groups_of_bag(bag, chosen)
    roles = {id(stream): role for role, stream in chosen.items()}
    topics = [Topic(s.topic, s.type, s.t, tuple(s.columns), roles.get(id(s), "")) for s in bag.streams]
    topics += [Topic(name, kind, np.zeros(count), None) for name, (kind, count) in bag.others.items()]
    return Log(path, groups, None, topics, [remark for s in bag.streams for remark in s.remarks()], faults)


BAG = LogFormat(
    "bag",
    (".bag", ".mcap"),
    read=_read,
    write=lambda log, path: write_bag(log.groups, path),
    recognises=lambda log_format, path: path.is_dir() or path.suffix.lower() in log_format.endings,
    folder="the folder of a ROS 2 bag",
)
