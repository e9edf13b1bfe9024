"""ROS bags as streams of numbers: ROS 1 `.bag` files, ROS 2 folders (sqlite or MCAP) and single `.mcap` files.

Of every topic whose type is known, what a planar robot is about is kept, in SI units; other topics are only counted. A
message has two stamps: the header's, when it was measured, and the bag's, when it was written. The header's are preferred;
where there are none, or where they are of another clock, the bag's are used, and `Stream.stamps` says so.

tf is split into a stream a pair of frames, whose topic is `/tf:PARENT->CHILD`. Joint states are the wheels' alone: joints
whose names have `wheel` and `left` or `right` in them, the mean of each side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import FloatArray
from validation.logs.recording import DAMAGE, RecordingError, shown

Stamps = Literal["header", "bag"]

ENDINGS = (".bag", ".mcap")
"""Of files that are read as bags; a folder is one if `METADATA` lies in it."""
METADATA = "metadata.yaml"

CLOCK_JUMP = 1.0
"""A header's stamp that steps by so much more or less than the bag's is a jump of its clock [s]; what is written late steps
by less, and is sorted."""
OTHER_CLOCK = 60.0
"""Stamps further from the bag's than this are of another clock, such as time since switching on [s]."""

UNITS: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("v", "vy"), "m/s")
    | dict.fromkeys(("w", "gyro_x", "gyro_y", "gyro_z", "rate_left", "rate_right"), "rad/s")
    | dict.fromkeys(("x", "y"), "m")
    | dict.fromkeys(("yaw", "angle_left", "angle_right"), "rad")
    | dict.fromkeys(("acc_x", "acc_y", "acc_z"), "m/s²")
    | dict.fromkeys(("latitude", "longitude"), "°")
)
"""The columns that streams have, each with its unit: v forward, vy to the left, w about the vertical; rates and angles of
wheels by side; of an IMU, along its own axes."""


@dataclass(frozen=True, eq=False)
class Stream:
    """What one topic brought, M samples of it, sorted by time; read-only."""

    topic: str
    type: str
    """As ROS 2 writes it, such as nav_msgs/msg/Odometry."""
    t: FloatArray
    """(M,) not decreasing, after the bag's epoch [s]."""
    columns: Mapping[str, FloatArray]
    """Some of `UNITS`, each (M,), as they came: also NaN."""
    stamps: Stamps
    """Which clock `t` is of."""
    jumps: tuple[tuple[float, float], ...] = ()
    """Where its clock jumped: when, on the bag's clock after its epoch, and by how much [s]."""
    late: int = 0
    """Samples that had to be sorted."""

    def __len__(self) -> int:
        """How many samples there are, M."""
        return len(self.t)

    @property
    def period(self) -> float:
        """Median step of time [s]; NaN of fewer than two samples."""
        return float(np.median(np.diff(self.t))) if len(self) > 1 else math.nan


@dataclass(frozen=True, eq=False)
class Bag:
    """What a bag holds of a planar robot."""

    path: Path
    epoch_ns: int
    """Unix time of its first stamp [ns]; times of streams count from here."""
    streams: tuple[Stream, ...]
    """By topic."""
    others: Mapping[str, tuple[str, int]]
    """Type and count of the topics that are left out: types that are not known, or no sample of use."""

    def stream(self, topic: str) -> Stream:
        """A stream by its topic.

        Raises:
            RecordingError: there is none.
        """
        for stream in self.streams:
            if stream.topic == topic:
                return stream
        if topic in self.others:
            kind, count = self.others[topic]
            raise RecordingError(self.path, f"nothing can be read from topic {topic}: {count} messages of {kind}")
        there = ", ".join(s.topic for s in self.streams) or "none that can be read"
        raise RecordingError(self.path, f"there is no topic {topic}; there are: {there}")


Row = tuple[str, int, dict[str, float]]
"""What is appended to the topic, the header's stamp [ns] (0: none), and the numbers."""


def _header_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _twist(twist: Any) -> dict[str, float]:
    return {"v": twist.linear.x, "vy": twist.linear.y, "w": twist.angular.z}


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    quat = [getattr(orientation, axis) for axis in "wxyz"]
    # a quaternion of zeros is a field that nobody filled
    yaw = float(quat_wxyz_to_yaw(quat)) if any(quat) and all(map(math.isfinite, quat)) else math.nan
    return {"x": position.x, "y": position.y, "yaw": yaw}


def _odometry(m: Any) -> Iterator[Row]:
    yield "", _header_ns(m), _pose(m.pose.pose.position, m.pose.pose.orientation) | _twist(m.twist.twist)


def _imu(m: Any) -> Iterator[Row]:
    rates = {f"gyro_{axis}": getattr(m.angular_velocity, axis) for axis in "xyz"}
    yield "", _header_ns(m), rates | {f"acc_{axis}": getattr(m.linear_acceleration, axis) for axis in "xyz"}


def _joints(m: Any) -> Iterator[Row]:
    """The wheels' mean rate of each side, or their mean angle where a driver gives no rates; nothing of other joints."""
    name, values = ("rate", m.velocity) if len(m.velocity) else ("angle", m.position)
    if len(values) != len(m.name):
        return
    sides: dict[str, list[float]] = {"left": [], "right": []}
    for joint, value in zip(m.name, values, strict=True):
        for side, found in sides.items():
            if "wheel" in joint.lower() and side in joint.lower():
                found.append(float(value))
    if all(sides.values()):
        yield "", _header_ns(m), {f"{name}_{side}": sum(found) / len(found) for side, found in sides.items()}


def _fix(m: Any) -> Iterator[Row]:
    if m.status.status >= 0:  # STATUS_FIX and better
        yield "", _header_ns(m), {"latitude": m.latitude, "longitude": m.longitude}


def _tf(m: Any) -> Iterator[Row]:
    for one in m.transforms:
        frames = f":{one.header.frame_id.lstrip('/')}->{one.child_frame_id.lstrip('/')}"
        yield frames, _header_ns(one), _pose(one.transform.translation, one.transform.rotation)


READERS: Mapping[str, Callable[[Any], Iterator[Row]]] = MappingProxyType(
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
    }
)
"""What can be read, by type of message."""


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: by its ending, or as a folder that describes itself as one."""
    return (path / METADATA).is_file() if path.is_dir() else path.suffix.lower() in ENDINGS


def read_bag(path: str | Path, stamps: Stamps = "header") -> Bag:
    """Read all streams of a bag.

    Args:
        path: a `.bag` or `.mcap` file, or the folder of a ROS 2 bag.
        stamps: `header`: as the module says; `bag`: the instants of writing, for bags whose clocks jumped.

    Raises:
        RecordingError: there is no such bag, it is damaged, or it is empty.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(path, "there is no such file; wanted a bag (.bag, .mcap, or a ROS 2 bag's folder)")
    if path.is_dir() and not is_bag(path):
        raise RecordingError(path, f"this folder is no ROS 2 bag: there is no {METADATA} in it")
    collected, others = _collect(path)
    if not collected and not others:
        raise RecordingError(path, "the bag is empty: there is no message in it")
    epoch = min((ns for rows in collected.values() for ns in _preferred(rows, stamps)[0].tolist()), default=0)
    return Bag(path, epoch, tuple(_stream(*key, collected[key], stamps, epoch) for key in sorted(collected)), others)


_Rows = list[tuple[int, int, dict[str, float]]]
"""Of one stream: the bag's stamp, the header's [ns] and the numbers of each message."""


def _collect(path: Path) -> tuple[dict[tuple[str, str], _Rows], dict[str, tuple[str, int]]]:
    """All rows by topic and type, and the topics that are left out with their type and count."""
    try:
        import apsw  # here: they take a fifth of a second, which only those who read bags shall wait
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag1 import ReaderError as ReaderError1
        from rosbags.rosbag2 import ReaderError as ReaderError2
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_typestore
    except ImportError as missing:
        raise RecordingError(path, f"reading bags needs rosbags: pip install rosbags ({missing})") from None
    rows: dict[tuple[str, str], _Rows] = {}
    others: dict[str, tuple[str, int]] = {}
    faults = (*DAMAGE, apsw.Error, AnyReaderError, ReaderError1, ReaderError2, SerdeError, TypesysError)
    try:
        # the types of bags that do not bring them: ROS 2 before Iron
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            known = [c for c in reader.connections if c.msgtype in READERS]
            for connection, ns, raw in reader.messages(known) if known else ():
                message = reader.deserialize(raw, connection.msgtype)
                for suffix, header_ns, numbers in READERS[connection.msgtype](message):
                    rows.setdefault((connection.topic + suffix, connection.msgtype), []).append((ns, header_ns, numbers))
            used = {topic.partition(":")[0] for topic, _ in rows}
            for connection in reader.connections:
                if connection.topic not in used and connection.msgcount:
                    count = others.get(connection.topic, ("", 0))[1] + connection.msgcount
                    others[connection.topic] = (connection.msgtype, count)
    except faults as cause:
        what = " ".join(str(cause).split()) or type(cause).__name__
        raise RecordingError(path, f"this is no bag that can be read, or a damaged one: {what[:200]}") from cause
    return rows, others


def _preferred(rows: _Rows, stamps: Stamps) -> tuple[NDArray[np.int64], Stamps]:
    """(M,) stamps of a stream [ns] and which clock they are of."""
    bag, header = (np.array([row[k] for row in rows], dtype=np.int64) for k in (0, 1))
    apart = abs(float(np.median(header - bag))) * 1e-9
    return (header, "header") if stamps == "header" and header.all() and apart < OTHER_CLOCK else (bag, "bag")


def _stream(topic: str, kind: str, rows: _Rows, stamps: Stamps, epoch: int) -> Stream:
    ns, clock = _preferred(rows, stamps)
    written = np.array([row[0] for row in rows], dtype=np.int64)
    odd = (np.diff(ns) - np.diff(written)) * 1e-9
    jumps = tuple((float(written[k + 1] - epoch) * 1e-9, float(odd[k])) for k in np.flatnonzero(np.abs(odd) > CLOCK_JUMP))
    order = np.argsort(ns, kind="stable")
    late = int(np.count_nonzero(np.diff(ns) < 0))
    names = {name: None for _, _, numbers in rows for name in numbers}
    columns = {n: np.array([numbers.get(n, math.nan) for _, _, numbers in rows], dtype=np.float64)[order] for n in names}
    t = np.asarray((ns[order] - epoch) * 1e-9, dtype=np.float64)
    for array in (t, *columns.values()):
        array.setflags(write=False)
    return Stream(topic, kind, t, MappingProxyType(columns), clock, jumps, late)


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
"""What a stream can be to a recording, and the columns that it must have for that; of wheels, rates or angles."""

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
"""By role, the types that are taken for it, and parts of topics that are preferred."""

TF_PARENTS = ("map", "world", "mocap", "vicon", "optitrack")
TF_CHILDREN = ("base_link", "base_footprint")
"""A transform is guessed to be the pose only from one of these frames to one of those: odom to base_link is odometry."""


def fits(stream: Stream, role: str) -> bool:
    """Whether a stream has the columns that the role needs."""
    if role == "wheels":
        return any(all(f"{kind}_{side}" in stream.columns for side in ("left", "right")) for kind in ("rate", "angle"))
    return all(name in stream.columns for name in ROLES[role])


def guess_topics(streams: Iterable[Stream]) -> dict[str, Stream]:
    """Which stream is what, by its type.

    Of several, a topic with a preferred part in its name goes before others, then a type that `GUESSED` lists earlier, then
    the topic with more samples, then the first in the alphabet. A stream of fewer than two samples is nothing.
    """
    found: dict[str, Stream] = {}
    for role, (types, parts) in GUESSED.items():
        able = [s for s in streams if s.type in types and fits(s, role) and len(s) > 1 and _is_global(s)]
        if able:
            found[role] = min(
                able, key=lambda s: (not any(p in s.topic for p in parts), types.index(s.type), -len(s), s.topic)
            )
    return found


def _is_global(stream: Stream) -> bool:
    """Whether a transform is that of the robot in a map; other streams are."""
    parent, arrow, child = stream.topic.partition(":")[2].partition("->")
    return not arrow or (parent in TF_PARENTS and child.split("/")[-1] in TF_CHILDREN)


def choose_topics(bag: Bag, named: Mapping[str, str] = MappingProxyType({})) -> dict[str, Stream]:
    """Which stream is what: as named, and guessed for the roles that are not.

    Args:
        bag: what there is.
        named: topics by role; `none`: none at all.

    Raises:
        RecordingError: an unknown role, a topic that is not there, or that cannot be what it is named.
    """
    unknown = [role for role in named if role not in ROLES]
    if unknown:
        raise RecordingError(bag.path, f"unknown role {shown(unknown)}; there are: {', '.join(ROLES)}")
    chosen = {role: s for role, s in guess_topics(bag.streams).items() if role not in named}
    for role, topic in named.items():
        if topic == "none":
            continue
        stream = bag.stream(topic)
        if not fits(stream, role):
            raise RecordingError(bag.path, f"topic {topic} of {stream.type} cannot be {role}: {_wanted(role)}")
        chosen[role] = stream
    return {role: chosen[role] for role in ROLES if role in chosen}


def _wanted(role: str) -> str:
    types: Sequence[str] = GUESSED[role][0]
    return f"wanted {' or '.join(ROLES[role]) or 'wheels'}, as of {types[0]}"
