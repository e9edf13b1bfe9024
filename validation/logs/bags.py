"""ROS bags as streams of numbers: ROS 1 `.bag` files, ROS 2 folders (sqlite or MCAP) and single `.mcap` files.

Topics with a known message type are read: the planar quantities in them, in SI units. Other topics are only counted. A
message has two stamps: the header's, when it was measured, and the bag's, when it was written. The header's is preferred.
Where there is none, or where it comes from another clock, the bag's is used, and `Stream.stamps` says so.

A tf topic is split into one stream for each pair of frames, named `/tf:PARENT->CHILD`. From joint states only wheels are
read: joints with `wheel` and `left` or `right` in their names, averaged over each side.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import sqlite3
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import FloatArray
from validation.logs.files import DAMAGE, open_regular
from validation.logs.limits import USUAL, LogLimits
from validation.logs.log import Stamps
from validation.logs.recording import RecordingError
from validation.reading import parse_json
from validation.words import shortened

_DATABASE = b"SQLite format 3\0"
"""What files of SQLite begin with."""
METADATA = "metadata.yaml"
"""File that describes the folder of a ROS 2 bag."""
_CLOCK_JUMP = 1.0
"""Difference between the steps of the header's and the bag's stamps from which the header's clock has jumped [s]; a message
that is only written late differs by less, and is sorted."""
_OTHER_CLOCK = 60.0
"""Median distance from the bag's stamps from which a header's clock is another one, such as the time since start-up [s]."""
_LATEST_NS = 2**62
"""Greatest stamp of writing [ns], in the year 2116: differences of stamps stay within 64 bits."""
_QUATERNION = 1e3
"""Greatest element of a quaternion; a unit quaternion has none beyond 1, but not every driver normalises."""
MAP_TOPIC = "/recording/columns"
"""Topic of the one message that says which columns the topics of a bag hold, for bags that this project wrote."""
SHOWN = 5
"""Number of jumps or gaps that a sentence lists."""

UNITS: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("v", "vy"), "m/s")
    | dict.fromkeys(("w", "gyro_x", "gyro_y", "gyro_z", "rate_left", "rate_right"), "rad/s")
    | dict.fromkeys(("x", "y"), "m")
    | dict.fromkeys(("yaw", "angle_left", "angle_right"), "rad")
    | dict.fromkeys(("acc_x", "acc_y", "acc_z"), "m/s²")
    | dict.fromkeys(("latitude", "longitude"), "°")
)
"""Units of the columns of streams: v is forward, vy to the left, w about the vertical; rates and angles are those of the
wheels on each side; those of an IMU are along its own axes."""


@dataclass(frozen=True, eq=False)
class Stream:
    """Samples of one topic, M of them, sorted by time; read-only."""

    topic: str
    type: str
    """Message type as ROS 2 writes it, such as nav_msgs/msg/Odometry."""
    t: FloatArray
    """(M,) not decreasing, counted from the bag's epoch [s]."""
    columns: Mapping[str, FloatArray]
    """Some of the columns of `UNITS`, each (M,), as they were sent: NaN is possible."""
    stamps: Stamps
    """Clock that `t` comes from."""
    jumps: tuple[tuple[float, float], ...] = ()
    """Jumps of its clock: the time on the bag's clock, counted from the epoch, and the size [s]."""
    late: int = 0
    """Number of samples that had to be sorted."""

    def __len__(self) -> int:
        """Return the number of samples, M."""
        return len(self.t)

    def remarks(self) -> list[str]:
        """Return sentences about its clock: jumps, stamps of writing, late samples."""
        found, many = [], len(self.jumps)
        if many:
            at = ", ".join(f"{size:+.3f} s after {when:.3f} s" for when, size in self.jumps[:SHOWN])
            times = "once" if many == 1 else f"{many} times"
            more = f" and {many - SHOWN} more" if many > SHOWN else ""
            found.append(f"{self.topic}: the clock jumps {times}: {at}{more}")
        if self.stamps == "bag":
            found.append(f"{self.topic}: stamps are those of writing; the messages have none of that clock")
        if self.late:
            found.append(f"{self.topic}: {self.late} samples came late and were sorted in")
        return found


@dataclass(frozen=True, eq=False)
class Bag:
    """Streams of a bag."""

    path: Path
    streams: tuple[Stream, ...]
    """Streams in the order of their topics; times are counted from the first stamp of all."""
    others: Mapping[str, tuple[str, int]]
    """Type and message count of the topics that are left out: their type is unknown, or no message is of use."""
    written: Mapping[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    """Group and columns of each topic, in a bag that this project wrote."""

    def stream(self, topic: str) -> Stream:
        """Return the stream of a topic.

        Raises:
            RecordingError: there is no such stream.
        """
        found = next((s for s in self.streams if s.topic == topic), None)
        if found is not None:
            return found
        if topic in self.others:
            kind, count = self.others[topic]
            raise RecordingError(self.path, f"nothing can be read from topic {topic}: {count} messages of {kind}")
        there = ", ".join(s.topic for s in self.streams) or "none that can be read"
        raise RecordingError(self.path, f"there is no topic {topic}; there are: {there}")


_Row = tuple[str, int, dict[str, float]]
"""Suffix of the topic, the header's stamp [ns] (0 for none), and the numbers by column."""


def _header_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _twist(twist: Any) -> dict[str, float]:
    return {"v": twist.linear.x, "vy": twist.linear.y, "w": twist.angular.z}


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    quat = [getattr(orientation, axis) for axis in "wxyz"]
    # a quaternion of zeros is a field that nobody filled
    yaw = float(quat_wxyz_to_yaw(quat)) if any(quat) and all(abs(q) < _QUATERNION for q in quat) else math.nan
    return {"x": position.x, "y": position.y, "yaw": yaw}


def _odometry(m: Any) -> Iterator[_Row]:
    yield "", _header_ns(m), _pose(m.pose.pose.position, m.pose.pose.orientation) | _twist(m.twist.twist)


def _imu(m: Any) -> Iterator[_Row]:
    rates = {f"gyro_{axis}": getattr(m.angular_velocity, axis) for axis in "xyz"}
    yield "", _header_ns(m), rates | {f"acc_{axis}": getattr(m.linear_acceleration, axis) for axis in "xyz"}


def _joints(m: Any) -> Iterator[_Row]:
    """Yield the mean rate of each side's wheels, or their mean angle where a driver sends no rates."""
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
    }
)
"""Functions that read a message, by its type; for a further type, add a line."""
TEXT = "std_msgs/msg/String"
"""Type of the message of `MAP_TOPIC`."""
CHANNEL = "std_msgs/msg/Float64"
"""Type of the messages that hold one number; they are read where `MAP_TOPIC` says which column that is."""


def _channel(m: Any) -> Iterator[_Row]:
    yield "", 0, {"value": m.data}


class _BagError(RecordingError):
    """A file is no bag."""

    wanted = "a bag (.bag, .mcap, or a ROS 2 bag's folder)"


@dataclass
class _Messages:
    """Messages of one stream in the order of writing, as columns that grow."""

    written_ns: array[int] = field(default_factory=lambda: array("q"))
    """Stamps of writing [ns]."""
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    """Stamps of measuring [ns], 0 for none."""
    columns: dict[str, array[float]] = field(default_factory=dict)

    def add(self, written_ns: int, header_ns: int, numbers: Mapping[str, float]) -> None:
        """Take in a message; a column that it lacks is NaN there."""
        count = len(self.written_ns)
        for name, value in numbers.items():
            column = self.columns.setdefault(name, array("d"))
            column.extend([math.nan] * (count - len(column)))
            column.append(value)
        self.written_ns.append(written_ns)
        self.header_ns.append(header_ns)

    def column(self, name: str) -> FloatArray:
        """Return a column, (M,)."""
        values = np.array(self.columns[name], dtype=np.float64)
        return np.concatenate([values, np.full(len(self.written_ns) - len(values), math.nan)])


def read_bag(path: str | Path, stamps: Stamps = "header", limits: LogLimits = USUAL) -> Bag:
    """Read all streams of a bag.

    Args:
        path: a `.bag` or `.mcap` file, or the folder of a ROS 2 bag.
        stamps: `header` prefers the stamps of measuring; `bag` takes those of writing, for bags whose clocks jumped.
        limits: greatest sizes and numbers of messages; the usual ones if not given.

    Raises:
        RecordingError: there is no such bag, it is damaged, empty or beyond the limits.
    """
    path = Path(path)
    _check_files(path, limits)
    collected, others, written = _collect(path, limits)
    if not collected and not others:
        raise RecordingError(path, "the bag is empty: there is no message in it")
    clocks = {key: _preferred(collected[key], stamps) for key in sorted(collected)}
    epoch = min((int(ns.min()) for ns, _ in clocks.values()), default=0)
    streams = tuple(_stream(*key, collected[key], *clock, epoch) for key, clock in clocks.items())
    return Bag(path, streams, others, written)


def _check_files(path: Path, limits: LogLimits) -> None:
    """Refuse what is no bag by its files, before any library opens them."""
    if not path.is_dir():
        with open_regular(path, _BagError, limits, "bag_size"):
            return
    if not (path / METADATA).exists():
        raise RecordingError(path, f"this folder is no ROS 2 bag: there is no {METADATA} in it")
    try:
        files = sorted(p for p in path.iterdir() if not p.is_dir())
    except OSError as cause:
        raise RecordingError(path, f"the folder cannot be read: {cause.strerror or cause}") from cause
    size = 0
    for file in files:
        with open_regular(file, _BagError, limits, "table_size" if file.name == METADATA else "bag_size") as opened:
            size += os.fstat(opened.fileno()).st_size
            database = opened.read(len(_DATABASE)) == _DATABASE
        if database:
            _check_database(file)
    if size > limits.bytes_of("bag_size"):
        raise RecordingError(path, f"its files have {size / 1e6:.6g} MB, but {limits.says('bag_size')}")


def _check_database(path: Path) -> None:
    """Refuse a database of SQLite that computes what it gives: a view may have rows without end."""
    try:
        with contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            parts = database.execute("SELECT type, name, coalesce(sql, '') FROM sqlite_master LIMIT 1000").fetchall()
    except (sqlite3.Error, ValueError) as cause:
        raise RecordingError(path, f"this is a damaged database: {shortened(cause, 200)}") from cause
    for kind, name, sql in parts:
        if kind not in ("table", "index") or re.search(r"\b(as|virtual)\b", str(sql), re.IGNORECASE):
            raise RecordingError(path, f"this is no bag: {shortened(name, 40)!r} is no plain table, and is not read")


_Written = Mapping[str, tuple[str, tuple[str, ...]]]
"""Group and columns by topic."""
_Collected = dict[tuple[str, str], _Messages]
"""Messages by topic and type."""


def _collect(path: Path, limits: LogLimits) -> tuple[_Collected, Mapping[str, tuple[str, int]], _Written]:
    """Return the messages, the topics that are left out with their type and count, and what was written by this project."""
    try:
        import apsw  # here: these imports take a fifth of a second
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag1 import ReaderError as ReaderError1
        from rosbags.rosbag2 import ReaderError as ReaderError2
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_typestore
    except ImportError as missing:
        raise RecordingError(path, f"reading bags needs rosbags: pip install rosbags ({missing})") from None
    faults = (*DAMAGE, apsw.Error, AnyReaderError, ReaderError1, ReaderError2, SerdeError, TypesysError)
    try:
        # the type store serves bags that do not contain their message types: ROS 2 before Iron
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            written = _written(reader)
            found = _messages(path, reader, written, limits)
            used = {topic.partition(":")[0] for topic, _ in found} | {MAP_TOPIC}
            others: dict[str, tuple[str, int]] = {}
            for connection in reader.connections:
                if connection.topic not in used and connection.msgcount:
                    count = others.get(connection.topic, ("", 0))[1] + int(connection.msgcount)
                    others[str(connection.topic)] = (str(connection.msgtype), max(0, count))
    except RecordingError:
        raise
    except faults as cause:
        what = shortened(cause, 200) or type(cause).__name__
        raise RecordingError(path, f"this is no bag that can be read, or a damaged one: {what}") from cause
    return found, others, written


def _written(reader: Any) -> _Written:
    """Return what the message of `MAP_TOPIC` says, nothing without one; any error is that of a damaged bag."""
    maps = [c for c in reader.connections if c.topic == MAP_TOPIC and c.msgtype == TEXT]
    for connection, _, raw in reader.messages(maps) if maps else ():
        said = parse_json(reader.deserialize(raw, connection.msgtype).data, MAP_TOPIC)
        if not all(isinstance(columns, list) for _, columns in said.values()):
            raise ValueError(f"{MAP_TOPIC} is no map of topics to groups and columns")
        return {topic: (str(group), tuple(map(str, columns))) for topic, (group, columns) in said.items()}
    return {}


def _messages(path: Path, reader: Any, written: _Written, limits: LogLimits) -> _Collected:
    """Return all messages that can be read; a RecordingError says that there are more than the limits allow."""
    found: _Collected = {}
    known = [c for c in reader.connections if c.msgtype in READERS or (c.msgtype == CHANNEL and c.topic in written)]
    for count, (connection, ns, raw) in enumerate(reader.messages(known) if known else ()):
        for name, many in (("samples", count + 1), ("columns", len(found))):
            if many > getattr(limits, name):
                raise RecordingError(path, f"there are too many messages or topics: {limits.says(name)}")
        if not 0 <= ns < _LATEST_NS:
            raise ValueError(f"a message was written at {ns} ns")
        kind = connection.msgtype
        read = _channel if kind == CHANNEL else READERS[kind]
        for suffix, header_ns, numbers in read(reader.deserialize(raw, kind)):
            found.setdefault((connection.topic + suffix, kind), _Messages()).add(ns, header_ns, numbers)
    return found


def _preferred(messages: _Messages, stamps: Stamps) -> tuple[NDArray[np.int64], Stamps]:
    """Return the (M,) stamps of a stream [ns] and the clock that they come from."""
    bag, header = (np.array(ns, dtype=np.int64) for ns in (messages.written_ns, messages.header_ns))
    apart = abs(float(np.median(header - bag))) * 1e-9
    return (header, "header") if stamps == "header" and header.all() and apart < _OTHER_CLOCK else (bag, "bag")


def _stream(topic: str, kind: str, messages: _Messages, ns: NDArray[np.int64], clock: Stamps, epoch: int) -> Stream:
    written = np.array(messages.written_ns, dtype=np.int64)
    odd = (np.diff(ns) - np.diff(written)) * 1e-9
    jumps = tuple((float(written[k + 1] - epoch) * 1e-9, float(odd[k])) for k in np.flatnonzero(np.abs(odd) > _CLOCK_JUMP))
    order, late = np.argsort(ns, kind="stable"), int(np.count_nonzero(np.diff(ns) < 0))
    columns = {name: messages.column(name)[order] for name in messages.columns}
    t = np.asarray((ns[order] - epoch) * 1e-9, dtype=np.float64)
    for array_ in (t, *columns.values()):
        array_.setflags(write=False)
    return Stream(topic, kind, t, MappingProxyType(columns), clock, jumps, late)
