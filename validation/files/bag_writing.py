"""MCAP files with ROS 2 messages, which PlotJuggler, rerun and Foxglove open.

Every group becomes a topic with its own stamps: /cmd_vel (TwistStamped), /joint_states (JointState), /odom (Odometry),
/imu/data (Imu), /pose (PoseStamped). Columns that fit no such message become a topic `/columns/GROUP/NAME` of Float64 each.
So all of them are read back, the yaw but for full turns, and times from the first stamp on. Viewers find /tf besides, from
the pose or else from odometry.
"""

from __future__ import annotations

import heapq
import math
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.files.bags import CHANNEL, CHANNELS
from validation.files.log import GROUPS, POSES, Group, Log
from validation.store import temporary_beside, write_atomic

EPOCH = 1_000_000_000
"""Unix time that stands for t = 0 in bags [s], 2001-09-09: a stamp of zero would mean that there is none. A log whose stamps
all are later than this has Unix time, and keeps it."""
_LATEST = 2**31  # second at which the stamps of bags end
_WORLD, _BASE, _ODOM = "map", "base_link", "odom"
_UNKNOWN = np.array([-1.0, *[0.0] * 8])  # covariance of something that was not measured (sensor_msgs/Imu)
_WHEELS = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]

_Fields = Mapping[str, Any]
"""Fields of a message by name, those of messages inside it likewise; what is not there is zero or empty."""


class _Topic(NamedTuple):
    """A topic that is to be written."""

    name: str
    kind: str
    """Message type."""
    frame: str
    """Frame that the messages name in their header."""
    make: Callable[..., _Fields]
    """Function that makes a message from its header and the numbers of its columns."""


def _turned(yaw: float) -> _Fields:
    return dict(zip("wxyz", yaw_to_quat_wxyz(yaw).tolist(), strict=True))


def _twist(v: float, w: float) -> _Fields:
    return {"linear": {"x": v}, "angular": {"z": w}}


def _pose(x: float, y: float, yaw: float) -> _Fields:
    return {"position": {"x": x, "y": y}, "orientation": _turned(yaw)}


def _odometry(header: _Fields, v: float, w: float, *pose: float) -> _Fields:
    inside = {"pose": {"pose": _pose(*pose)}, "twist": {"twist": _twist(v, w)}}
    return {"header": header, "child_frame_id": _BASE, **inside}


def _imu(header: _Fields, w: float) -> _Fields:
    unknown = {"orientation_covariance": _UNKNOWN, "linear_acceleration_covariance": _UNKNOWN}
    return {"header": header, "orientation": {"w": 1.0}, "angular_velocity": {"z": w}, **unknown}


def _frame(header: _Fields, *row: float) -> _Fields:
    x, y, yaw = row[-3:]
    transform = {"translation": {"x": x, "y": y}, "rotation": _turned(yaw)}
    return {"transforms": [{"header": header, "child_frame_id": _BASE, "transform": transform}]}


_TOPICS: Mapping[str, _Topic] = {
    "cmd": _Topic(
        "/cmd_vel", "geometry_msgs/msg/TwistStamped", _BASE, lambda header, *row: {"header": header, "twist": _twist(*row)}
    ),
    "wheels": _Topic(
        "/joint_states", "sensor_msgs/msg/JointState", "",
        lambda header, *row: {"header": header, "name": _WHEELS, "velocity": np.tile(row, 2)},
    ),
    "odom": _Topic("/odom", "nav_msgs/msg/Odometry", _ODOM, _odometry),
    "imu": _Topic("/imu/data", "sensor_msgs/msg/Imu", _BASE, _imu),
    "pose": _Topic(
        "/pose", "geometry_msgs/msg/PoseStamped", _WORLD, lambda header, *row: {"header": header, "pose": _pose(*row)}
    ),
}  # fmt: skip
"""Topic of each group, whose columns are those of `GROUPS` in their order."""


def _topics(log: Log) -> Iterator[tuple[_Topic, Group, FloatArray]]:
    """Yield the topics of a log, each with its group and the (M, k) numbers of its messages."""
    body = "pose" if "pose" in log.groups else "odom"  # what says where the body is
    used = set[str]()
    for name, group in log.groups.items():
        wanted = GROUPS.get(name, ())
        if name == "odom" and "x" in group.columns:  # in a log without another pose, odometry's columns are x, y, yaw
            wanted = tuple(dict(zip(POSES[1], POSES[0], strict=True)).get(n, n) for n in wanted)
        table = group.table(wanted) if name in _TOPICS else None
        if table is not None:
            yield _TOPICS[name], group, table
            if name == body:
                yield _Topic("/tf", "tf2_msgs/msg/TFMessage", _TOPICS[name].frame, _frame), group, table
        for column, values in group.columns.items():
            if table is not None and column in wanted:
                continue
            topic = CHANNELS + re.sub(r"[^A-Za-z0-9_/]", "_", f"{name}/{column}")  # what names of topics are made of
            if topic in used:
                raise ValueError(f"two columns would be written as topic {topic}; rename '{column}'")
            used.add(topic)
            yield _Topic(topic, CHANNEL, "", lambda _, value: {"data": value}), group, values[:, None]


def _stamps(t: FloatArray, epoch: int) -> list[int]:
    """Return (M,) times [s] as Unix time [ns]; whole seconds apart, for a double has no nanoseconds of Unix time."""
    found = [(epoch + math.floor(s)) * 10**9 + round((s - math.floor(s)) * 1e9) for s in t.tolist()]
    if any(b <= a for a, b in pairwise(found)):
        raise ValueError("samples lie closer together than the nanosecond that stamps of bags resolve")
    return found


def write_bag(log: Log, path: Path) -> None:
    """Write a log as an MCAP file, whole or not at all.

    Raises:
        ValueError: the stamps do not fit into a bag, or two columns would have the same topic.
        OSError: the file cannot be written.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    start, stop = min(float(g.t[0]) for g in log.groups.values()), max(float(g.t[-1]) for g in log.groups.values())
    epoch = 0 if start >= EPOCH else EPOCH
    if not (1.0 <= start + epoch and stop + epoch < _LATEST):
        raise ValueError(f"{start:.9g} to {stop:.9g} s do not fit into {path.name}, whose stamps end after {_LATEST} s")
    topics = [(topic, _stamps(group.t, epoch), table.tolist()) for topic, group, table in _topics(log)]
    types = get_typestore(Stores.ROS2_HUMBLE)

    def messages(topic: _Topic, stamps: Sequence[int], rows: Sequence[Sequence[float]]) -> Iterator[tuple[int, _Topic, Any]]:
        for ns, row in zip(stamps, rows, strict=True):
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": topic.frame}
            yield ns, topic, types.serialize_cdr(message_of(types, topic.kind, topic.make(header, *row)), topic.kind)

    def write(beside: Path) -> None:
        # a ROS 2 bag is a folder; its one .mcap file is complete in itself
        folder = temporary_beside(path.with_suffix(""))
        folder.mkdir()
        try:
            with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                connected = {t: writer.add_connection(t.name, t.kind, typestore=types) for t, _, _ in topics}
                for ns, topic, raw in heapq.merge(*(messages(*each) for each in topics), key=lambda message: message[0]):
                    writer.write(connected[topic], ns, raw)
            next((folder / "bag").glob("*.mcap")).replace(beside)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    write_atomic(path, write)


def message_of(types: Any, kind: str, fields: _Fields) -> Any:
    """Return a message of a type of a rosbags type store; fields that are not given are zero or empty."""
    from rosbags.interfaces import Nodetype

    found = {}
    for name, (node, detail) in types.fielddefs[kind][1]:
        given = fields.get(name)
        if node is Nodetype.NAME:
            found[name] = message_of(types, detail, given or {})
        elif node is Nodetype.BASE:
            found[name] = given or ("" if detail[0] == "string" else 0)
        elif detail[0][0] is Nodetype.NAME:
            found[name] = [message_of(types, detail[0][1], each) for each in given or ()]
        else:
            found[name] = np.zeros(detail[1]) if given is None else given
    return types.types[kind](**found)
