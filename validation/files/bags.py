"""ROS bags as logs: ROS 1 `.bag` files, ROS 2 folders (sqlite or MCAP) and single `.mcap` files.

Topics with a known message type are read: the planar quantities in them, in SI units. Other topics are only counted. A
message has two stamps: the header's, when it was measured, and the bag's, when it was written. The header's is preferred.
Where there is none, or where it comes from another clock, the bag's is used. Times are counted from the bag's first stamp.

A tf topic is split into one for each pair of frames, named `/tf:PARENT->CHILD`. From joint states only wheels are read:
joints with `wheel` and `left` or `right` in their names, averaged over each side.

Topics get roles, and become groups of columns: cmd_v, cmd_w from the role `cmd`; enc_left, enc_right from `wheels`; gyro_z
from `imu`, about the vertical that its accelerometer shows; x, y, yaw from `pose` or, without one, from `odom`; odom_v and
odom_w from `odom` (and odom_x, odom_y, odom_yaw where there is a `pose`); and gps_east, gps_north from `gps`, metres from
its first fix.
"""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import FloatArray
from validation.files.limits import LogLimits
from validation.files.log import POSE_COLUMNS, Group, Log, ReadOptions, Stamps, Topic, check_group, is_column_name
from validation.files.reading import DAMAGE, FileError, opened, parse_json, quoted
from validation.words import shortened

METADATA = "metadata.yaml"
"""File that describes the folder of a ROS 2 bag."""
MAP_TOPIC = "/recording/columns"
"""Topic of the one message that says which columns the topics of a bag hold, for bags that this project wrote."""
TEXT = "std_msgs/msg/String"
"""Type of the message of `MAP_TOPIC`."""
CHANNEL = "std_msgs/msg/Float64"
"""Type of the messages that hold one number; they are read where `MAP_TOPIC` says which column that is."""
_CLOCK_JUMP = 1.0
"""Difference between the steps of the header's and the bag's stamps from which the header's clock has jumped [s]; a message
that is only written late differs by less, and is sorted."""
_OTHER_CLOCK = 60.0
"""Median distance from the bag's stamps from which a header's clock is another one, such as the time since start-up [s]."""
_LATEST_NS = 2**62  # greatest stamp of writing [ns], in the year 2116: differences of stamps stay within 64 bits
SHOWN = 5
"""Number of jumps or gaps that a sentence lists."""
_TF_PARENTS, _TF_CHILDREN = ("map", "world", "mocap", "vicon", "optitrack"), ("base_link", "base_footprint")
"""A transform is taken for the pose only from one of these parents to one of these children: odom to base_link is
odometry."""
_GRAVITY_SPAN = (8.8, 10.8)
"""Range of a mean acceleration that is taken for gravity and shows the vertical [m/s2]; outside it, z is the vertical."""
_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # semi-major axis [m] and flattening [1] of the WGS 84 ellipsoid


class Role(NamedTuple):
    """What a topic must be for a role."""

    columns: tuple[str, ...]
    """Columns that it must have; wheels need rates or angles of both sides."""
    types: tuple[str, ...]
    """Message types that are taken for it, the better ones first."""
    preferred: tuple[str, ...] = ()
    """Parts of topics' names that are preferred."""


_RATES, _ANGLES = ("rate_left", "rate_right"), ("angle_left", "angle_right")
ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "cmd": Role(("v", "w"), ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"), ("cmd_vel",)),
        "odom": Role(("v", "w"), ("nav_msgs/msg/Odometry",), ("controller", "wheel")),
        "wheels": Role((), ("sensor_msgs/msg/JointState",)),
        "imu": Role(("gyro_x", "gyro_y", "gyro_z"), ("sensor_msgs/msg/Imu",), ("imu/data",)),
        "pose": Role(POSE_COLUMNS, ("geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")),
        "gps": Role(("latitude", "longitude"), ("sensor_msgs/msg/NavSatFix",)),
    }
)
"""Roles that topics can have, in the order of their groups."""

_Row = tuple[str, int, dict[str, float]]
"""Suffix of the topic, the header's stamp [ns] (0 for none), and the numbers by column."""


def _header_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _twist(twist: Any) -> dict[str, float]:
    return {"v": twist.linear.x, "w": twist.angular.z}


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    quat = [getattr(orientation, axis) for axis in "wxyz"]
    # a quaternion of zeros is a field that nobody filled; not every driver normalises
    yaw = float(quat_wxyz_to_yaw(quat)) if any(quat) and all(abs(q) < 1e3 for q in quat) else math.nan
    return {"x": position.x, "y": position.y, "yaw": yaw}


def _odometry(m: Any) -> Iterator[_Row]:
    yield "", _header_ns(m), _pose(m.pose.pose.position, m.pose.pose.orientation) | _twist(m.twist.twist)


def _imu(m: Any) -> Iterator[_Row]:
    rates = {f"gyro_{axis}": getattr(m.angular_velocity, axis) for axis in "xyz"}
    yield "", _header_ns(m), rates | {f"acc_{axis}": getattr(m.linear_acceleration, axis) for axis in "xyz"}


def _joints(m: Any) -> Iterator[_Row]:
    """Yield the mean rate of each side's wheels, or their mean angle where a driver sends no rates."""
    names, values = (_RATES, m.velocity) if len(m.velocity) else (_ANGLES, m.position)
    if len(values) != len(m.name):
        return
    wheels = [(joint.lower(), float(value)) for joint, value in zip(m.name, values, strict=True) if "wheel" in joint.lower()]
    sides = [[value for joint, value in wheels if side in joint] for side in ("left", "right")]
    if all(sides):
        yield "", _header_ns(m), {name: sum(side) / len(side) for name, side in zip(names, sides, strict=True)}


def _fix(m: Any) -> Iterator[_Row]:
    if m.status.status >= 0:  # STATUS_FIX and better
        yield "", _header_ns(m), {"latitude": m.latitude, "longitude": m.longitude}


def _tf(m: Any) -> Iterator[_Row]:
    for one in m.transforms:
        frames = f":{one.header.frame_id.lstrip('/')}->{one.child_frame_id.lstrip('/')}"
        yield frames, _header_ns(one), _pose(one.transform.translation, one.transform.rotation)


READERS: Mapping[str, Callable[[Any], Iterator[_Row]]] = MappingProxyType(
    {
        "geometry_msgs/msg/Twist": lambda m: iter([("", 0, _twist(m))]),
        "geometry_msgs/msg/TwistStamped": lambda m: iter([("", _header_ns(m), _twist(m.twist))]),
        "geometry_msgs/msg/PoseStamped": lambda m: iter([("", _header_ns(m), _pose(m.pose.position, m.pose.orientation))]),
        "nav_msgs/msg/Odometry": _odometry,
        "sensor_msgs/msg/Imu": _imu,
        "sensor_msgs/msg/JointState": _joints,
        "sensor_msgs/msg/NavSatFix": _fix,
        "tf2_msgs/msg/TFMessage": _tf,
        "tf/msg/tfMessage": _tf,
        CHANNEL: lambda m: iter([("", 0, {"value": m.data})]),
    }
)
"""Functions that read a message, by its type; for a further type, add a line."""


@dataclass
class _Messages:
    """Messages of one topic and type that have the same columns, in the order of writing."""

    written_ns: array[int] = field(default_factory=lambda: array("q"))
    """Stamps of writing [ns]."""
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    """Stamps of measuring [ns], 0 for none."""
    numbers: array[float] = field(default_factory=lambda: array("d"))
    """Numbers, message by message."""

    def stamps(self, wanted: Stamps) -> tuple[NDArray[np.int64], Stamps]:
        """Return the (M,) stamps [ns] and the clock that they come from."""
        bag, header = (np.array(ns, dtype=np.int64) for ns in (self.written_ns, self.header_ns))
        apart = abs(float(np.median(header - bag))) * 1e-9
        return (header, "header") if wanted == "header" and header.all() and apart < _OTHER_CLOCK else (bag, "bag")


_Collected = dict[tuple[str, str, tuple[str, ...]], _Messages]
"""Messages by topic, type and columns."""
_Written = Mapping[str, tuple[str, tuple[str, ...]]]
"""Group and columns by topic, in a bag that this project wrote."""


def _check_files(path: Path, limits: LogLimits) -> None:
    """Refuse what is no bag by its files, before any library opens them."""
    if path.is_dir() and not (path / METADATA).exists():
        raise FileError(path, f"this folder is no ROS 2 bag: there is no {METADATA} in it")
    size, most = 0, limits.bytes_of("bag_size")
    for file in sorted(p for p in path.iterdir() if not p.is_dir()) if path.is_dir() else [path]:
        with opened(file, most, "bag_size") as stream:
            size += os.fstat(stream.fileno()).st_size
    if size > most:
        raise FileError(path, f"its files have {size / 1e6:.6g} MB, but {limits.says('bag_size')}")


def read_topics(path: Path, options: ReadOptions) -> tuple[list[Topic], _Written]:
    """Read the topics of a bag, and the groups and columns by topic that it says, if this project wrote it.

    Raises:
        FileError: there is no such bag, it is damaged, empty or beyond the limits.
    """
    try:
        import apsw  # here: these imports take a fifth of a second
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag1 import ReaderError as ReaderError1
        from rosbags.rosbag2 import ReaderError as ReaderError2
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_typestore
    except ImportError as missing:
        raise FileError(path, f"reading bags needs rosbags: pip install rosbags ({missing})") from None
    try:
        _check_files(path, options.limits)
        # the type store serves bags that do not contain their message types: ROS 2 before Iron
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            written = _written(reader)
            found = _messages(path, reader, written, options.limits)
            used = {topic.partition(":")[0] for topic, _, _ in found} | {MAP_TOPIC}
            counts: dict[tuple[str, str], int] = {}
            for c in reader.connections:
                if c.topic not in used and c.msgcount:
                    counts[c.topic, c.msgtype] = counts.get((c.topic, c.msgtype), 0) + max(0, int(c.msgcount))
    except FileError:
        raise
    except (AnyReaderError, ReaderError1, ReaderError2, SerdeError, TypesysError, apsw.Error, *DAMAGE) as cause:
        what = shortened(cause, 200) or type(cause).__name__
        raise FileError(path, f"this is no bag that can be read, or a damaged one: {what}") from cause
    if not found and not counts:
        raise FileError(path, "the bag is empty: there is no message in it")
    clocks = {key: found[key].stamps(options.stamps) for key in sorted(found)}
    epoch = min((int(ns.min()) for ns, _ in clocks.values()), default=0)
    topics = [_topic(*key, found[key], *clock, epoch) for key, clock in clocks.items()]
    return [*topics, *(Topic(*key, np.broadcast_to(0.0, many), None) for key, many in counts.items())], written


def _written(reader: Any) -> _Written:
    """Return what the message of `MAP_TOPIC` says, nothing without one; any error is that of a damaged bag."""
    maps = [c for c in reader.connections if c.topic == MAP_TOPIC and c.msgtype == TEXT]
    for connection, _, raw in reader.messages(maps) if maps else ():
        document = parse_json(reader.deserialize(raw, connection.msgtype).data, MAP_TOPIC)
        return {topic: (str(group), tuple(map(str, columns))) for topic, (group, columns) in document.items()}
    return {}


def _messages(path: Path, reader: Any, written: _Written, limits: LogLimits) -> _Collected:
    """Return all messages that can be read; a FileError says that there are more than the limits allow."""
    found: _Collected = {}
    known = [c for c in reader.connections if c.msgtype in READERS and (c.msgtype != CHANNEL or c.topic in written)]
    for count, (connection, ns, raw) in enumerate(reader.messages(known) if known else ()):
        for name, many in (("samples", count + 1), ("columns", len(found))):
            if many > getattr(limits, name):
                raise FileError(path, f"there are too many messages or topics: {limits.says(name)}")
        if not 0 <= ns < _LATEST_NS:
            raise ValueError(f"a message was written at {ns} ns")
        kind = connection.msgtype
        for suffix, header_ns, numbers in READERS[kind](reader.deserialize(raw, kind)):
            messages = found.setdefault((connection.topic + suffix, kind, tuple(numbers)), _Messages())
            messages.written_ns.append(ns)
            messages.header_ns.append(header_ns)
            messages.numbers.extend(numbers.values())
    return found


def _topic(
    name: str, kind: str, names: Sequence[str], messages: _Messages, ns: NDArray[np.int64], clock: Stamps, epoch: int
) -> Topic:
    """Return messages as a topic, sorted by their stamps [ns], which become seconds from the epoch [ns] on."""
    written = np.array(messages.written_ns, dtype=np.int64)
    odd = (np.diff(ns) - np.diff(written)) * 1e-9
    jumps = [(float(written[k + 1] - epoch) * 1e-9, float(odd[k])) for k in np.flatnonzero(np.abs(odd) > _CLOCK_JUMP)]
    order, late = np.argsort(ns, kind="stable"), int(np.count_nonzero(np.diff(ns) < 0))
    table = np.array(messages.numbers, dtype=np.float64).reshape(len(ns), len(names))[order]
    t = np.asarray((ns[order] - epoch) * 1e-9, dtype=np.float64)
    return Topic(name, kind, t, dict(zip(names, np.ascontiguousarray(table.T), strict=True)), clock, jumps, late)


# ------------------------------------------------------------------------------------------ roles of topics
def _fits(topic: Topic, role: str) -> bool:
    """Return whether a topic has the columns that the role needs."""
    if role == "wheels":
        return any(name in (topic.columns or ()) for name in (_RATES[0], _ANGLES[0]))
    return all(name in (topic.columns or ()) for name in ROLES[role].columns)


def _guess(topics: Sequence[Topic], role: str) -> Topic | None:
    """Return the topic of a role by its message type; None where none of such a type has at least two samples.

    Among several, one with a preferred part in its name goes first, then a type that the role lists earlier, then the one
    with more samples, then the alphabet. A transform that does not place the robot in a map has no role.
    """
    types, parts = ROLES[role].types, ROLES[role].preferred
    able = []
    for topic in topics:
        parent, arrow, child = topic.name.partition(":")[2].partition("->")
        placed = not arrow or (parent in _TF_PARENTS and child.split("/")[-1] in _TF_CHILDREN)
        if topic.type in types and _fits(topic, role) and len(topic.t) > 1 and placed:
            rank = (not any(p in topic.name for p in parts), types.index(topic.type), -len(topic.t), topic.name)
            able.append((rank, topic))
    return min(able, key=lambda ranked: ranked[0])[1] if able else None


def choose_topics(path: Path, topics: Sequence[Topic], named: Mapping[str, str]) -> dict[str, Topic]:
    """Return the topic of each role: as named, and guessed for the roles that are not.

    Args:
        path: the bag.
        topics: its topics.
        named: topics by role; `none` leaves the role empty.

    Raises:
        FileError: an unknown role, a topic that is not there, or a topic without the columns of its role.
    """
    if unknown := [role for role in named if role not in ROLES]:
        raise FileError(path, f"unknown role {quoted(unknown)}; there are: {', '.join(ROLES)}")
    chosen = {role: _guess(topics, role) for role in ROLES if role not in named}
    for role, name in named.items():
        if name == "none":
            continue
        chosen[role] = topic = next((topic for topic in topics if topic.name == name), None)
        if topic is None:
            there = ", ".join(topic.name for topic in topics if topic.columns is not None) or "none that can be read"
            raise FileError(path, f"there is no topic {name}; there are: {there}")
        if topic.columns is None:
            raise FileError(path, f"nothing can be read from topic {name}: {len(topic.t)} messages of {topic.type}")
        if not _fits(topic, role):
            wanted = f"wanted {' or '.join(ROLES[role].columns) or 'wheels'}, as of {ROLES[role].types[0]}"
            raise FileError(path, f"topic {name} of {topic.type} cannot be {role}: {wanted}")
    return {role: found for role in ROLES if (found := chosen.get(role)) is not None}


# ------------------------------------------------------------------------------------------ groups of columns
def _samples(path: Path, topic: Topic) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return stamps and columns of a topic, the first sample of each stamp; a FileError says why there are none."""
    if topic.jumps:
        when, size = topic.jumps[0]
        many = f", and {len(topic.jumps) - 1} times more" if len(topic.jumps) > 1 else ""
        what = f"the clock of topic {topic.name} jumps by {size:+.3f} s after {when:.3f} s{many}"
        raise FileError(path, f"{what}; stamps bag takes the times of writing")
    first = np.concatenate([[True], np.diff(topic.t) > 0.0])
    if np.count_nonzero(first) < 2:
        raise FileError(path, f"topic {topic.name} has fewer than two samples")
    return topic.t[first], {name: values[first] for name, values in (topic.columns or {}).items()}


def _group(path: Path, role: str, topic: Topic, prefix: str, limits: LogLimits) -> Group:
    """Return a topic as the group of its role; `prefix` begins the names of the columns of odometry's pose."""
    try:
        t, columns = _samples(path, topic)
        with np.errstate(all="ignore"):  # what is not finite then is refused below
            found = _converted(role, t, columns)
        if role in ("pose", "odom") and _fits(topic, "pose"):
            found |= {f"{prefix}{n}": np.unwrap(columns[n]) if n == "yaw" else columns[n] for n in POSE_COLUMNS}
        group = Group(topic.name, t, found)
        check_group(path, group, limits)
    except FileError as fault:
        raise FileError(path, f"{fault.what}; topics {role}=none leaves it out") from fault
    return group


def _converted(role: str, t: FloatArray, columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the columns of a group that a role has besides a pose."""
    if role in ("cmd", "odom"):
        return {f"{role}_v": columns["v"], f"{role}_w": columns["w"]}
    if role == "wheels" and _RATES[0] in columns:
        return {"enc_left": columns[_RATES[0]], "enc_right": columns[_RATES[1]]}
    if role == "wheels":
        left, right = (np.asarray(np.gradient(np.unwrap(columns[name]), t), dtype=np.float64) for name in _ANGLES)
        return {"enc_left": left, "enc_right": right}
    if role == "imu":
        return {"gyro_z": np.column_stack([columns[f"gyro_{axis}"] for axis in "xyz"]) @ vertical(columns)}
    if role == "gps":
        return dict(zip(("gps_east", "gps_north"), to_local(columns["latitude"], columns["longitude"]), strict=True))
    return {}


def _with_channel(
    path: Path, groups: dict[str, Group], topic: Topic, written: _Written, limits: LogLimits
) -> dict[str, Group]:
    """Return the groups with a topic of single numbers as the column that it was written from."""
    name, columns = written[topic.name]
    taken = {column for group in groups.values() for column in group.columns}
    if len(columns) != 1 or columns[0] == "t" or not is_column_name(columns[0]) or columns[0] in taken:
        raise FileError(path, f"topic {topic.name} cannot be column {quoted(columns)} of group {quoted([name])}")
    t, values = _samples(path, topic)
    group = Group(topic.name, t, {columns[0]: values["value"]})
    check_group(path, group, limits)
    if name not in groups:
        return {**groups, name: group}
    if not np.array_equal(groups[name].t, t):
        raise FileError(path, f"topic {topic.name} has other stamps than its group {quoted([name])}")
    return {**groups, name: replace(groups[name], columns={**groups[name].columns, **group.columns})}


def vertical(columns: Mapping[str, FloatArray]) -> FloatArray:
    """Return the (3,) unit vector that points up in an IMU's own axes: along its mean acceleration, or z."""
    mean = np.array([np.mean(columns[f"acc_{axis}"]) for axis in "xyz"])
    size = float(np.linalg.norm(mean))
    return mean / size if _GRAVITY_SPAN[0] < size < _GRAVITY_SPAN[1] else np.array([0.0, 0.0, 1.0])


def to_local(latitude: ArrayLike, longitude: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return (M,) metres east and north of the first of (M,) positions [deg].

    The plane touches the ellipsoid there. The result is good to some centimetres within a kilometre: terms of second order
    in the distance over the radius are left out. Beyond the poles there are no metres, but NaN.
    """
    degrees, lon = np.asarray(latitude, dtype=np.float64), np.asarray(longitude, dtype=np.float64)
    lat = np.radians(np.where(np.abs(degrees) <= 90.0, degrees, math.nan))
    eccentricity2 = _FLATTENING * (2.0 - _FLATTENING)
    root = math.sqrt(1.0 - eccentricity2 * math.sin(lat[0]) ** 2)
    meridian, transverse = _EQUATOR * (1.0 - eccentricity2) / root**3, _EQUATOR / root  # radii of curvature
    turned = np.radians(np.mod(lon - lon[0] + 180.0, 360.0) - 180.0)  # also across the date line
    return transverse * math.cos(lat[0]) * turned, meridian * (lat - lat[0])


def _remarks(topic: Topic) -> list[str]:
    """Return sentences about a topic's clock: jumps, stamps of writing, late samples."""
    found = []
    if many := len(topic.jumps):
        at = ", ".join(f"{size:+.3f} s after {when:.3f} s" for when, size in topic.jumps[:SHOWN])
        more = f" and {many - SHOWN} more" if many > SHOWN else ""
        found.append(f"{topic.name}: the clock jumps {'once' if many == 1 else f'{many} times'}: {at}{more}")
    if topic.stamps == "bag":
        found.append(f"{topic.name}: stamps are those of writing; the messages have none of that clock")
    if topic.late:
        found.append(f"{topic.name}: {topic.late} samples came late and were sorted in")
    return found


def read_bag(path: Path, options: ReadOptions) -> Log:
    """Read a bag.

    Raises:
        FileError: there is no such bag, it is damaged, empty or beyond the limits, or a topic cannot be used.
    """
    topics, written = read_topics(path, options)
    chosen = choose_topics(path, topics, options.topics)
    channels = [topic for topic in topics if topic.type == CHANNEL and topic.columns is not None]
    if not chosen and not channels and not options.lenient:
        there = ", ".join(f"{s.name} ({s.type})" for s in topics if s.columns is not None)
        found = there or "no topic of a type that can be read"
        raise FileError(path, f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {found}")
    groups: dict[str, Group] = {}
    left_out = []
    for role, topic in (*chosen.items(), *(("", topic) for topic in channels)):
        try:
            if role:
                odometrys = role == "odom" and ("pose" in chosen or "odom_x" in written.get(topic.name, ("", ()))[1])
                groups[role] = _group(path, role, topic, "odom_" if odometrys else "", options.limits)
            else:
                groups = _with_channel(path, groups, topic, written, options.limits)
        except FileError as fault:
            if not options.lenient:
                raise
            left_out.append(str(fault))
    roles = {id(topic): role for role, topic in chosen.items()} | {id(t): written[t.name][0] for t in channels}
    listed = [replace(topic, role=roles.get(id(topic), "")) for topic in topics]
    remarks = [remark for topic in topics if topic.type != CHANNEL for remark in _remarks(topic)]
    return Log(path, groups, listed, remarks, left_out, options.limits)
