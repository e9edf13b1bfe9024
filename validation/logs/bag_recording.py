"""The bag format of logs: streams of a bag get roles and become groups of columns.

The columns are cmd_v, cmd_w from the role `cmd`; enc_left, enc_right from `wheels`; gyro_z from `imu`; and x, y, yaw from
`pose` or, without one, from `odom`. Channels are odom_v [m/s], odom_w [rad/s] from `odom` (and odom_x, odom_y, odom_yaw
where there is a `pose`), and gps_east, gps_north [m] from `gps`. Times are counted from the bag's epoch.

The yaw rate is taken about the vertical that the IMU's accelerometer shows, however the IMU is mounted. Positions of a
satellite receiver become metres east and north of the first fix.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray
from validation.logs.bag_writer import bag_losses, write_bag
from validation.logs.bags import CHANNEL, UNITS, Bag, Stream, read_bag
from validation.logs.files import quoted
from validation.logs.groups import Group
from validation.logs.limits import LogLimits, find_time_fault
from validation.logs.log import Log, LogFormat, ReadOptions, Topic
from validation.logs.recording import RecordingError, is_channel_name

ROLES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "cmd": ("v", "w"),
        "odom": ("v", "w"),
        "wheels": (),
        "imu": ("gyro_x", "gyro_y", "gyro_z"),
        "pose": ("x", "y", "yaw"),
        "gps": ("latitude", "longitude"),
    }
)
"""Columns that a stream must have for each role; wheels need rates or angles of both sides."""

GUESSED: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = MappingProxyType(
    {
        "cmd": (("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"), ("cmd_vel",)),
        "odom": (("nav_msgs/msg/Odometry",), ("controller", "wheel")),
        "wheels": (("sensor_msgs/msg/JointState",), ()),
        "imu": (("sensor_msgs/msg/Imu",), ("imu/data",)),
        "pose": (("geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"), ()),
        "gps": (("sensor_msgs/msg/NavSatFix",), ()),
    }
)
"""Message types that are taken for each role, and parts of topic names that are preferred."""

_TF_PARENTS = ("map", "world", "mocap", "vicon", "optitrack")
_TF_CHILDREN = ("base_link", "base_footprint")
"""A transform is taken for the pose only from one of these parents to one of these children: odom to base_link is
odometry."""

_GRAVITY_SPAN = (8.8, 10.8)
"""Range of a mean acceleration that is taken for gravity and shows the vertical [m/s2]; outside it, z is the vertical."""

_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563
"""Semi-major axis [m] and flattening [1] of the WGS 84 ellipsoid."""


# ------------------------------------------------------------------------------------------ roles of topics
def _wheel_columns(columns: Mapping[str, FloatArray]) -> tuple[str, str]:
    return ("rate_left", "rate_right") if "rate_left" in columns else ("angle_left", "angle_right")


def _fits(stream: Stream, role: str) -> bool:
    """Return whether a stream has the columns that the role needs."""
    return all(n in stream.columns for n in (_wheel_columns(stream.columns) if role == "wheels" else ROLES[role]))


def _guess(bag: Bag, role: str) -> Stream | None:
    """Return the stream of a role by its message type; None where no stream has at least two samples of such a type.

    Among several, a topic with a preferred part in its name goes first, then a type that `GUESSED` lists earlier, then the
    topic with more samples, then the alphabet.
    """
    types, parts = GUESSED[role]
    able = [s for s in bag.streams if s.type in types and _fits(s, role) and len(s) > 1 and _is_global(s)]
    return min(
        able, key=lambda s: (not any(p in s.topic for p in parts), types.index(s.type), -len(s), s.topic), default=None
    )


def _is_global(stream: Stream) -> bool:
    """Return False for a transform that does not place the robot in a map; True for it, and for all other streams."""
    parent, arrow, child = stream.topic.partition(":")[2].partition("->")
    return not arrow or (parent in _TF_PARENTS and child.split("/")[-1] in _TF_CHILDREN)


def choose_topics(bag: Bag, named: Mapping[str, str] = MappingProxyType({})) -> dict[str, Stream]:
    """Return the stream of each role: as named, and guessed for the roles that are not.

    Args:
        bag: the bag.
        named: topics by role; `none` leaves the role empty.

    Raises:
        RecordingError: an unknown role, a topic that is not there, or a topic without the columns of its role.
    """
    unknown = [role for role in named if role not in ROLES]
    if unknown:
        raise RecordingError(bag.path, f"unknown role {quoted(unknown)}; there are: {', '.join(ROLES)}")
    chosen = {role: _guess(bag, role) for role in ROLES if role not in named}
    for role, topic in named.items():
        if topic == "none":
            continue
        chosen[role] = stream = bag.stream(topic)
        if not _fits(stream, role):
            wanted = f"wanted {' or '.join(ROLES[role]) or 'wheels'}, as of {GUESSED[role][0][0]}"
            raise RecordingError(bag.path, f"topic {topic} of {stream.type} cannot be {role}: {wanted}")
    return {role: found for role in ROLES if (found := chosen.get(role)) is not None}


# ------------------------------------------------------------------------------------------ columns of a stream
def _samples(bag: Bag, stream: Stream, limits: LogLimits, leave: str) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return stamps and columns of a stream, the first sample of each stamp; `leave` ends the sentences of errors."""
    if stream.jumps:
        when, size = stream.jumps[0]
        many = f", and {len(stream.jumps) - 1} times more" if len(stream.jumps) > 1 else ""
        what = f"the clock of topic {stream.topic} jumps by {size:+.3f} s after {when:.3f} s{many}"
        raise RecordingError(bag.path, f"{what}; stamps bag takes the times of writing{leave}")
    first = np.concatenate([[True], np.diff(stream.t) > 0.0])
    if np.count_nonzero(first) < 2:
        raise RecordingError(bag.path, f"topic {stream.topic} has fewer than two samples{leave}")
    t = stream.t[first]
    fault = find_time_fault(t, limits)
    if fault is not None:
        raise RecordingError(bag.path, f"topic {stream.topic}, sample {fault.row + 1}: {fault.what}{leave}")
    return t, {name: values[first] for name, values in stream.columns.items()}


def _check_numbers(
    bag: Bag, topic: str, t: FloatArray, columns: Mapping[str, FloatArray], limits: LogLimits, leave: str
) -> None:
    """Refuse numbers that are not finite or beyond the limits."""
    for name, values in columns.items():
        bound = limits.of_column(name)
        k = bound.first_beyond(values)
        if k is not None:
            wanted = f"but {bound.says}" if math.isfinite(values[k]) else "wanted a finite number"
            unit = f" [{UNITS[name]}]" if name in UNITS else ""
            raise RecordingError(bag.path, f"topic {topic}, {t[k]:.3f} s: {name} is {values[k]:g}, {wanted}{unit}{leave}")


def _as_group(bag: Bag, role: str, stream: Stream, has_pose: bool, limits: LogLimits) -> Group:
    """Return one stream as a group of checked columns; `has_pose` says whether the bag has another pose than odometry's."""
    leave = f"; topics {role}=none leaves it out"
    t, columns = _samples(bag, stream, limits, leave)
    posed = role == "pose" or (role == "odom" and _fits(stream, "pose"))
    used = (
        *(_wheel_columns(columns) if role == "wheels" else ROLES[role]),
        *(ROLES["pose"] if posed else ()),
        *(name for name in ("acc_x", "acc_y", "acc_z") if role == "imu" and name in columns),
    )
    _check_numbers(bag, stream.topic, t, {name: columns[name] for name in used}, limits, leave)
    out = _converted(role, t, columns)
    if posed:
        named = bag.written.get(stream.topic, ("", ()))[1]
        prefix = "odom_" if role == "odom" and (has_pose or "odom_x" in named) else ""
        out |= {f"{prefix}{n}": np.unwrap(columns[n]) if n == "yaw" else columns[n] for n in ROLES["pose"]}
    _check_numbers(bag, stream.topic, t, out, limits, leave)
    return Group(stream.topic, t, out)


def _with_channels(bag: Bag, groups: dict[str, Group], stream: Stream, limits: LogLimits) -> dict[str, Group]:
    """Return the groups with a stream of single numbers as the column that it was written from."""
    name, columns = bag.written[stream.topic]
    there = {column for group in groups.values() for column in group.columns}
    if len(columns) != 1 or columns[0] == "t" or not is_channel_name(columns[0]) or columns[0] in there:
        raise RecordingError(bag.path, f"topic {stream.topic} cannot be column {quoted(columns)} of group {quoted([name])}")
    t, values = _samples(bag, stream, limits, "")
    _check_numbers(bag, stream.topic, t, {columns[0]: values["value"]}, limits, "")
    group = groups.get(name, Group(stream.topic, t, {}))
    if not np.array_equal(group.t, t):
        raise RecordingError(bag.path, f"topic {stream.topic} has other stamps than its group {quoted([name])}")
    return {**groups, name: Group(group.source, group.t, {**group.columns, columns[0]: values["value"]})}


def _converted(role: str, t: FloatArray, columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the columns of a group that a role has besides a pose."""
    if role in ("cmd", "odom"):
        return {f"{role}_v": columns["v"], f"{role}_w": columns["w"]}
    if role == "wheels":
        left, right = (columns[name] for name in _wheel_columns(columns))
        if "rate_left" not in columns:
            left, right = (np.asarray(np.gradient(np.unwrap(a), t), dtype=np.float64) for a in (left, right))
        return {"enc_left": left, "enc_right": right}
    if role == "imu":
        return {"gyro_z": np.column_stack([columns[f"gyro_{axis}"] for axis in "xyz"]) @ vertical(columns)}
    if role == "gps":
        return dict(zip(("gps_east", "gps_north"), to_local(columns["latitude"], columns["longitude"]), strict=True))
    return {}


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
    bag = read_bag(path, options.stamps, options.limits)
    chosen = choose_topics(bag, options.topics)
    channels = [s for s in bag.streams if s.type == CHANNEL]
    if not chosen and not channels and not options.lenient:
        there = ", ".join(f"{s.topic} ({s.type})" for s in bag.streams) or "no topic of a type that can be read"
        raise RecordingError(bag.path, f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {there}")
    groups: dict[str, Group] = {}
    faults = []
    for role, stream in (*chosen.items(), *(("", stream) for stream in channels)):
        try:
            if role:
                groups[role] = _as_group(bag, role, stream, "pose" in chosen, options.limits)
            else:
                groups = _with_channels(bag, groups, stream, options.limits)
        except RecordingError as error:
            if not options.lenient:
                raise
            faults.append(str(error))
    roles = {id(stream): role for role, stream in chosen.items()}
    roles |= {id(stream): bag.written[stream.topic][0] for stream in channels}
    topics = [Topic(s.topic, s.type, s.t, tuple(s.columns), roles.get(id(s), "")) for s in bag.streams]
    topics += [Topic(name, kind, np.broadcast_to(0.0, count), None) for name, (kind, count) in bag.others.items()]
    remarks = [remark for s in bag.streams if s.type != CHANNEL for remark in s.remarks()]
    return Log(path, groups, None, topics, remarks, faults, options.limits)


BAG = LogFormat(
    "bag",
    (".bag", ".mcap"),
    read=_read,
    write=lambda log, path: write_bag(log.groups, path, log.description),
    losses=lambda log, path: bag_losses(log.groups, path),
    folder="the folder of a ROS 2 bag",
)
