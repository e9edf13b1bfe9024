"""ROS bags as logs: ROS 1 `.bag` files, ROS 2 folders (sqlite or MCAP) and single `.mcap` files.

Topics with a known message type are read: the planar quantities in them, in SI units. Other topics are only counted. A
message has two stamps: the header's, when it was measured, and the bag's, when it was written. The header's is preferred.
Where there is none, or where it comes from another clock or one that jumps, the bag's is used. Times are counted from the
bag's first stamp.

From joint states only wheels are read: joints with `wheel` and `left` or `right` in their names, averaged over each side.

Topics get roles, and become groups of columns: cmd_v, cmd_w from the role `cmd`; enc_left, enc_right from `wheels`; gyro_z
from `imu`, about the vertical that its accelerometer shows; x, y, yaw from `pose` or, without one, from `odom`; odom_v and
odom_w from `odom` (and odom_x, odom_y, odom_yaw where there is a `pose`); and gps_east, gps_north from `gps`, metres from
its first fix.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import FloatArray
from validation.files.limits import LogLimits
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Group, Log, ReadOptions, Topic, check_group
from validation.files.reading import DAMAGE, FileError, opened, quoted
from validation.words import shortened

_METADATA = "metadata.yaml"  # file that describes the folder of a ROS 2 bag
_CLOCK_JUMP = 1.0
"""Difference between the steps of the header's and the bag's stamps from which the header's clock has jumped [s]; a message
that is only written late differs by less, and is sorted."""
_OTHER_CLOCK = 60.0
"""Median distance from the bag's stamps from which a header's clock is another one, such as the time since start-up [s]."""
_LATEST_NS = 2**62  # greatest stamp of writing [ns], in the year 2116: differences of stamps stay within 64 bits
_GRAVITY_SPAN = (8.8, 10.8)
"""Range of a mean acceleration that is taken for gravity and shows the vertical [m/s2]; outside it, z is the vertical."""
_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # semi-major axis [m] and flattening [1] of the WGS 84 ellipsoid


class Role(NamedTuple):
    """Requirements that a topic meets for a role."""

    columns: tuple[str, ...]
    """Columns that it must have."""
    types: tuple[str, ...]
    """Message types that are taken for it, the better ones first."""
    preferred: tuple[str, ...] = ()
    """Parts of topics' names that are preferred."""

    def fits(self, topic: Topic) -> bool:
        """Return whether a topic has the columns that the role needs."""
        return all(n in (topic.columns or ()) for n in self.columns)


ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "cmd": Role(("v", "w"), ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"), ("cmd_vel",)),
        "odom": Role(("v", "w"), ("nav_msgs/msg/Odometry",), ("controller", "wheel")),
        "wheels": Role(COMMAND_COLUMNS["wheels"], ("sensor_msgs/msg/JointState",)),
        "imu": Role(("gyro_x", "gyro_y", "gyro_z"), ("sensor_msgs/msg/Imu",), ("imu/data",)),
        "pose": Role(POSE_COLUMNS, ("geometry_msgs/msg/PoseStamped",)),
        "gps": Role(("latitude", "longitude"), ("sensor_msgs/msg/NavSatFix",)),
    }
)
"""Roles that topics can have, in the order of their groups."""

_Row = tuple[int, dict[str, float]] | None
"""The header's stamp [ns] (0 for none), and the numbers by column; None for a message that says nothing."""


# ------------------------------------------------------------------------------------------ messages
def _header_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _twist(twist: Any) -> dict[str, float]:
    return {"v": twist.linear.x, "w": twist.angular.z}


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    quat = [getattr(orientation, axis) for axis in "wxyz"]
    # a quaternion of zeros is a field that nobody filled; not every driver normalises
    yaw = float(quat_wxyz_to_yaw(quat)) if any(quat) and all(abs(q) < 1e3 for q in quat) else math.nan
    return {"x": position.x, "y": position.y, "yaw": yaw}


def _odometry(m: Any) -> _Row:
    return _header_ns(m), _pose(m.pose.pose.position, m.pose.pose.orientation) | _twist(m.twist.twist)


def _imu(m: Any) -> _Row:
    rates = {f"gyro_{axis}": getattr(m.angular_velocity, axis) for axis in "xyz"}
    return _header_ns(m), rates | {f"acc_{axis}": getattr(m.linear_acceleration, axis) for axis in "xyz"}


def _joints(m: Any) -> _Row:
    wheels = [(name.lower(), float(rate)) for name, rate in zip(m.name, m.velocity, strict=False) if "wheel" in name.lower()]
    sides = [[rate for joint, rate in wheels if side in joint] for side in ("left", "right")]
    if len(m.velocity) != len(m.name) or not all(sides):
        return None
    return _header_ns(m), {n: sum(side) / len(side) for n, side in zip(COMMAND_COLUMNS["wheels"], sides, strict=True)}


def _fix(m: Any) -> _Row:
    has_fix = m.status.status >= 0  # STATUS_FIX and better
    return (_header_ns(m), {"latitude": m.latitude, "longitude": m.longitude}) if has_fix else None


READERS: Mapping[str, Callable[[Any], _Row]] = MappingProxyType(
    {
        "geometry_msgs/msg/Twist": lambda m: (0, _twist(m)),
        "geometry_msgs/msg/TwistStamped": lambda m: (_header_ns(m), _twist(m.twist)),
        "geometry_msgs/msg/PoseStamped": lambda m: (_header_ns(m), _pose(m.pose.position, m.pose.orientation)),
        "nav_msgs/msg/Odometry": _odometry,
        "sensor_msgs/msg/Imu": _imu,
        "sensor_msgs/msg/JointState": _joints,
        "sensor_msgs/msg/NavSatFix": _fix,
    }
)
"""Functions that read a message, by its type; for a further type, add a line."""


# ------------------------------------------------------------------------------------------ topics
@dataclass
class _Messages:
    """Messages of one topic and type that have the same columns, in the order of writing."""

    written_ns: array[int] = field(default_factory=lambda: array("q"))
    """Stamps of writing [ns]."""
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    """Stamps of measuring [ns], 0 for none."""
    numbers: array[float] = field(default_factory=lambda: array("d"))
    """Numbers, message by message."""

    def stamps(self) -> tuple[NDArray[np.int64], str]:
        """Return the (M,) stamps [ns] of the messages, or of writing, and then why."""
        bag, header = (np.array(ns, dtype=np.int64) for ns in (self.written_ns, self.header_ns))
        if not header.all():
            return bag, "the messages have no stamps"
        if abs(float(np.median(header - bag))) * 1e-9 > _OTHER_CLOCK:
            return bag, "the messages' clock is another one than the bag's"
        jump = float(np.max(np.abs(np.diff(header) - np.diff(bag)), initial=0)) * 1e-9
        return (header, "") if jump < _CLOCK_JUMP else (bag, f"the messages' clock jumps by {jump:.3f} s")


_Collected = dict[tuple[str, str, tuple[str, ...]], _Messages]
"""Messages by topic, type and columns."""


def read_topics(path: Path, options: ReadOptions) -> list[Topic]:
    """Read the topics of a bag; a FileError says that there is none, or that it is damaged, empty or beyond the limits."""
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
        _check_files(path)
        # the type store serves bags that do not contain their message types: ROS 2 before Iron
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            collected = _messages(path, reader, options.limits)
            used = {topic for topic, _, _ in collected}
            counts: dict[tuple[str, str], int] = {}
            for c in reader.connections:
                if c.topic not in used and c.msgcount:
                    counts[c.topic, c.msgtype] = counts.get((c.topic, c.msgtype), 0) + max(0, int(c.msgcount))
    except FileError:
        raise
    except (AnyReaderError, ReaderError1, ReaderError2, SerdeError, TypesysError, apsw.Error, *DAMAGE) as cause:
        what = shortened(cause, 200) or type(cause).__name__
        raise FileError(path, f"this is no bag that can be read, or a damaged one: {what}") from cause
    if not collected and not counts:
        raise FileError(path, "the bag is empty: there is no message in it")
    clocks = {key: collected[key].stamps() for key in sorted(collected)}
    epoch = min((int(ns.min()) for ns, _ in clocks.values()), default=0)
    topics = [_topic(*key, collected[key], *clock, epoch) for key, clock in clocks.items()]
    return [*topics, *(Topic(*key, np.broadcast_to(0.0, many), None) for key, many in counts.items())]


def _check_files(path: Path) -> None:
    """Refuse what is no bag by its files, before any library opens them."""
    if path.is_dir() and not (path / _METADATA).exists():
        raise FileError(path, f"this folder is no ROS 2 bag: there is no {_METADATA} in it")
    for file in sorted(p for p in path.iterdir() if not p.is_dir()) if path.is_dir() else [path]:
        with opened(file):
            pass


def _messages(path: Path, reader: Any, limits: LogLimits) -> _Collected:
    """Return all messages that can be read; a FileError says that there are more than the limits allow."""
    collected: _Collected = {}
    known = [c for c in reader.connections if c.msgtype in READERS]
    for count, (connection, ns, raw) in enumerate(reader.messages(known) if known else ()):
        for name, many in (("samples", count + 1), ("columns", len(collected))):
            if many > getattr(limits, name):
                raise FileError(path, f"there are too many messages or topics: {limits.says(name)}")
        if not 0 <= ns < _LATEST_NS:
            raise ValueError(f"a message was written at {ns} ns")
        kind = connection.msgtype
        if row := READERS[kind](reader.deserialize(raw, kind)):
            messages = collected.setdefault((connection.topic, kind, tuple(row[1])), _Messages())
            messages.written_ns.append(ns)
            messages.header_ns.append(row[0])
            messages.numbers.extend(row[1].values())
    return collected


def _topic(
    name: str, kind: str, names: Sequence[str], messages: _Messages, ns: NDArray[np.int64], remark: str, epoch: int
) -> Topic:
    """Return messages as a topic, sorted by their stamps [ns], which become seconds from the epoch [ns] on."""
    order = np.argsort(ns, kind="stable")
    table = np.array(messages.numbers, dtype=np.float64).reshape(len(ns), len(names))[order]
    t = np.asarray((ns[order] - epoch) * 1e-9, dtype=np.float64)
    return Topic(name, kind, t, dict(zip(names, np.ascontiguousarray(table.T), strict=True)), remark)


def choose_topics(path: Path, topics: Sequence[Topic], named: Mapping[str, str]) -> dict[str, Topic]:
    """Return the topic of each role: as named, and guessed by its message type for the roles that are not.

    Args:
        path: the bag.
        topics: its topics.
        named: topics by role; `none` leaves the role empty.

    Raises:
        FileError: an unknown role, a topic that is not there, or a topic without the columns of its role.
    """
    if unknown := [role for role in named if role not in ROLES]:
        raise FileError(path, f"unknown role {quoted(unknown)}; there are: {', '.join(ROLES)}")
    chosen = {role: _guess(topics, ROLES[role]) for role in ROLES if role not in named}
    for role, name in named.items():
        if name == "none":
            continue
        chosen[role] = topic = next((topic for topic in topics if topic.name == name), None)
        if topic is None:
            there = ", ".join(topic.name for topic in topics if topic.columns is not None) or "none that can be read"
            raise FileError(path, f"there is no topic {name}; there are: {there}")
        if topic.columns is None:
            raise FileError(path, f"nothing can be read from topic {name}: {len(topic.t)} messages of {topic.type}")
        if not ROLES[role].fits(topic):
            wanted = f"wanted {' or '.join(ROLES[role].columns)}, as of {ROLES[role].types[0]}"
            raise FileError(path, f"topic {name} of {topic.type} cannot be {role}: {wanted}")
    return {role: pick for role in ROLES if (pick := chosen.get(role)) is not None}


def _guess(topics: Sequence[Topic], role: Role) -> Topic | None:
    """Return the topic of a role by its message type; None where none of such a type has at least two samples.

    Among several, one with a preferred part in its name goes first, then a type that the role lists earlier, then the one
    with more samples, then the alphabet.
    """

    def rank(topic: Topic) -> tuple[bool, int, int, str]:
        preferred = any(part in topic.name for part in role.preferred)
        return not preferred, role.types.index(topic.type), -len(topic.t), topic.name

    able = [t for t in topics if t.type in role.types and role.fits(t) and len(t.t) > 1]
    return min(able, key=rank, default=None)


# ------------------------------------------------------------------------------------------ groups of columns
def _group(path: Path, role: str, topic: Topic, prefix: str, limits: LogLimits) -> Group:
    """Return a topic as the group of its role, the first sample of each stamp.

    `prefix` begins the names of the columns of odometry's pose. A FileError says what cannot be used.
    """
    first = np.concatenate([[True], np.diff(topic.t) > 0.0])
    t, columns = topic.t[first], {name: values[first] for name, values in (topic.columns or {}).items()}
    try:
        if len(t) < 2:
            raise FileError(path, f"topic {topic.name} has fewer than two samples")
        with np.errstate(all="ignore"):  # what is not finite then is refused below
            converted = _converted(role, columns)
        if role in ("pose", "odom") and ROLES["pose"].fits(topic):
            converted |= {f"{prefix}{n}": np.unwrap(columns[n]) if n == "yaw" else columns[n] for n in POSE_COLUMNS}
        group = Group(topic.name, t, converted)
        check_group(path, group, limits)
    except FileError as fault:
        raise FileError(path, f"{fault.what}; topics {role}=none leaves it out") from fault
    return group


def _converted(role: str, columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    if role in ("cmd", "odom"):
        return {f"{role}_v": columns["v"], f"{role}_w": columns["w"]}
    if role == "imu":
        return {"gyro_z": np.column_stack([columns[f"gyro_{axis}"] for axis in "xyz"]) @ _vertical(columns)}
    if role == "gps":
        return dict(zip(("gps_east", "gps_north"), to_local(columns["latitude"], columns["longitude"]), strict=True))
    return {} if role == "pose" else dict(columns)


def _vertical(columns: Mapping[str, FloatArray]) -> FloatArray:
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


def read_bag(path: Path, options: ReadOptions) -> Log:
    """Read a bag.

    Raises:
        FileError: there is no such bag, it is damaged, empty or beyond the limits, or a topic cannot be used.
    """
    topics = read_topics(path, options)
    chosen = choose_topics(path, topics, options.topics)
    if not chosen:
        there = ", ".join(f"{s.name} ({s.type})" for s in topics if s.columns is not None)
        unread = there or "no topic of a type that can be read"
        raise FileError(path, f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {unread}")
    prefixes = {"odom": "odom_"} if "pose" in chosen else {}
    groups = {role: _group(path, role, t, prefixes.get(role, ""), options.limits) for role, t in chosen.items()}
    roles = {id(topic): role for role, topic in chosen.items()}
    listed = [replace(topic, role=roles.get(id(topic), "")) for topic in topics]
    remarks = [f"{t.name}: {t.remark}, so the times of writing count" for t in topics if t.remark]
    return Log(path, groups, listed, remarks, options.limits)
