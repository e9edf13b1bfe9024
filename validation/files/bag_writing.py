"""Bags that other tools open: MCAP files with ROS 2 messages (PlotJuggler, rerun, Foxglove) and ROS 1 bags.

Every group becomes a topic with its own stamps: /cmd_vel (TwistStamped), /joint_states (JointState), /odom (Odometry),
/imu/data (Imu), /pose (PoseStamped). Columns that fit no such message become a topic of Float64 each, and one message says
which columns the topics hold: so all of them are read back, the yaw but for full turns, and times from the first stamp on.
In MCAP files viewers find /tf besides, from the pose or else from odometry, and /robot_description if the robot is known.
"""

from __future__ import annotations

import heapq
import itertools
import json
import math
import re
import shutil
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.files.bags import CHANNEL, MAP_TOPIC, TEXT
from validation.files.log import GROUPS, POSES, Group, Log
from validation.files.reading import quoted
from validation.store import temporary_beside, write_atomic

EPOCH = 1_000_000_000
"""Unix time that stands for t = 0 in bags [s], 2001-09-09: a stamp of zero would mean that there is none. A log whose stamps
all are later than this has Unix time, and keeps it."""
_LATEST = 2**31
"""Second at which the stamps of bags end; those of ROS 1 would go on, but not every tool has them without a sign."""
_LONGEST_NAME = 200  # greatest length of a topic's name; DDS has room for some fifty more
_WORLD, _BASE, _ODOM = "map", "base_link", "odom"
_TF, DESCRIPTION = "tf2_msgs/msg/TFMessage", "/robot_description"
_SHOWN = 8  # number of renamed columns that a sentence lists
_UNKNOWN = np.array([-1.0, *[0.0] * 8])  # covariance of something that was not measured (sensor_msgs/Imu)

_Fields = Mapping[str, Any]
"""_Fields of a message by name, those of messages inside it likewise; what is not there is zero or empty."""


def _header(t: int, frame: str) -> _Fields:
    return {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": frame}


def _turned(yaw: float) -> _Fields:
    return dict(zip("wxyz", yaw_to_quat_wxyz(yaw).tolist(), strict=True))


def _twist(v: float, w: float) -> _Fields:
    return {"linear": {"x": v}, "angular": {"z": w}}


def _pose(x: float, y: float, yaw: float) -> _Fields:
    return {"position": {"x": x, "y": y}, "orientation": _turned(yaw)}


def _cmd(t: int, row: Sequence[float]) -> _Fields:
    return {"header": _header(t, _BASE), "twist": _twist(row[0], row[1])}


def _joints(t: int, row: Sequence[float]) -> _Fields:
    names = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
    return {"header": _header(t, ""), "name": names, "velocity": np.tile(row, 2)}


def _odometry(t: int, row: Sequence[float]) -> _Fields:
    pose, twist = {"pose": _pose(*row[2:5])}, {"twist": _twist(row[0], row[1])}
    return {"header": _header(t, _ODOM), "child_frame_id": _BASE, "pose": pose, "twist": twist}


def _imu(t: int, row: Sequence[float]) -> _Fields:
    unknown = {"orientation_covariance": _UNKNOWN, "linear_acceleration_covariance": _UNKNOWN}
    return {"header": _header(t, _BASE), "orientation": {"w": 1.0}, "angular_velocity": {"z": row[0]}, **unknown}


def _pose_stamped(t: int, row: Sequence[float]) -> _Fields:
    return {"header": _header(t, _WORLD), "pose": _pose(*row)}


def _number(_: int, row: Sequence[float]) -> _Fields:
    return {"data": row[0]}


_Maker = Callable[[int, Sequence[float]], _Fields]
"""Function that makes a message from its stamp [ns] and the numbers of its columns."""
_TOPICS: Mapping[str, tuple[str, str, _Maker]] = {
    "cmd": ("/cmd_vel", "geometry_msgs/msg/TwistStamped", _cmd),
    "wheels": ("/joint_states", "sensor_msgs/msg/JointState", _joints),
    "odom": ("/odom", "nav_msgs/msg/Odometry", _odometry),
    "imu": ("/imu/data", "sensor_msgs/msg/Imu", _imu),
    "pose": ("/pose", "geometry_msgs/msg/PoseStamped", _pose_stamped),
}
"""Topic, message type and maker of each group, whose columns are those of `GROUPS` in their order."""
_RESERVED = {topic for topic, _, _ in _TOPICS.values()} | {MAP_TOPIC, DESCRIPTION, "/tf", "/tf_static", "/clock", "/rosout"}
"""Topics with a meaning of their own, which no channel takes."""
_ODOMETRY = dict(zip(*POSES, strict=True))
"""Names of odometry's pose by those of a pose: in a log without another pose, odometry's columns are x, y, yaw."""


class _Plan(NamedTuple):
    """A topic that is to be written."""

    topic: str
    kind: str
    """Message type."""
    group: str
    columns: Sequence[str]
    """Columns of the group that its messages hold, in the order of the maker."""
    make: _Maker


def _plans(groups: Mapping[str, Group]) -> list[_Plan]:
    """Return the topics of a log, with names that differ."""
    taken = set(_RESERVED)
    plans = []
    for name, group in groups.items():
        known = {_ODOMETRY.get(n, n) if name == "odom" else n: n for n in group.columns}
        whole: Sequence[str] = ()
        if name in _TOPICS and all(column in known for column in GROUPS[name]):
            whole = [known[column] for column in GROUPS[name]]
            topic, kind, make = _TOPICS[name]
            plans.append(_Plan(topic, kind, name, whole, make))
        for column in group.columns:
            if column not in whole:
                plans.append(_Plan(_topic_of(column, taken), CHANNEL, name, (column,), _number))
    return plans


def _topic_of(column: str, taken: set[str]) -> str:
    """Return a topic for a column, a name that ROS allows and nothing else has; it is taken from now on."""
    plain = unicodedata.normalize("NFKD", column).encode("ascii", "ignore").decode()
    name = re.sub("[^A-Za-z0-9]+", "_", plain).strip("_")[:_LONGEST_NAME] or "channel"
    name = f"/{name}" if name[0].isalpha() else f"/channel_{name}"
    topic = next(t for t in itertools.chain([name], (f"{name}_{k}" for k in itertools.count(2))) if t not in taken)
    taken.add(topic)
    return topic


def bag_losses(log: Log, path: Path) -> list[str]:
    """Return a sentence about the columns that a bag holds under other names than the log.

    Raises:
        ValueError: the stamps do not fit into a bag.
    """
    _epoch(log, path)
    renamed = [(plan.columns[0], plan.topic) for plan in _plans(log.groups) if plan.kind == CHANNEL]
    named = [f"{quoted([column])} as {topic}" for column, topic in renamed if topic != f"/{column}"]
    more = f" and {len(named) - _SHOWN} more" if len(named) > _SHOWN else ""
    return [f"columns that cannot name a topic are written under others: {', '.join(named[:_SHOWN])}{more}"] if named else []


def _epoch(log: Log, path: Path) -> int:
    """Return the Unix time that stands for t = 0 [s]; a ValueError where the stamps do not fit into a bag."""
    start, stop = min(float(g.t[0]) for g in log.groups.values()), max(float(g.t[-1]) for g in log.groups.values())
    epoch = 0 if start >= EPOCH else EPOCH
    if not (1.0 <= start + epoch and stop + epoch < _LATEST):
        raise ValueError(f"{start:.9g} to {stop:.9g} s do not fit into {path.name}, whose stamps end after {_LATEST} s")
    return epoch


def _stamps(t: FloatArray, epoch: int) -> list[int]:
    """Return (M,) times [s] as Unix time [ns]; whole seconds apart, for a double has no nanoseconds of Unix time.

    Raises:
        ValueError: two of them are the same.
    """
    found = [(epoch + math.floor(s)) * 10**9 + round((s - math.floor(s)) * 1e9) for s in t.tolist()]
    if any(b <= a for a, b in pairwise(found)):
        raise ValueError("samples lie closer together than the nanosecond that stamps of bags resolve")
    return found


_Message = tuple[int, str, str, _Fields]
"""Stamp [ns], topic, type and fields."""


def _messages(log: Log, epoch: int, ros1: bool) -> Iterator[_Message]:
    """Return all messages in the order of time, made one by one."""
    plans = _plans(log.groups)
    stamps = {name: _stamps(group.t, epoch) for name, group in log.groups.items()}
    first = min(ns[0] for ns in stamps.values())
    document = json.dumps({plan.topic: [plan.group, list(plan.columns)] for plan in plans})
    begin: list[_Message] = [(first, MAP_TOPIC, TEXT, {"data": document})]
    if log.description and not ros1:
        begin.append((first, DESCRIPTION, TEXT, {"data": log.description}))
    whole = {plan.topic for plan in plans}
    parents = {} if ros1 else {"/pose": _WORLD} if "/pose" in whole else {"/odom": _ODOM}
    if (
        parents and {"/pose", "/odom"} <= whole
    ):  # a body has one parent: odometry's frame begins where that of the poses does
        begin.append((first, "/tf_static", _TF, _frame(_WORLD, _ODOM, first, (0.0, 0.0, 0.0))))
    streams: list[Iterable[_Message]] = [begin]
    for plan in plans:
        table = np.column_stack([log.groups[plan.group].columns[column] for column in plan.columns]).tolist()
        streams.append(_stream(plan.topic, plan.kind, plan.make, stamps[plan.group], table))
        if parent := parents.get(plan.topic):
            poses = [row[-3:] for row in table]
            streams.append(_stream("/tf", _TF, partial(_frame, parent, _BASE), stamps[plan.group], poses))
    return heapq.merge(*streams, key=lambda message: message[0])


def _stream(
    topic: str, kind: str, make: _Maker, stamps: Sequence[int], rows: Sequence[Sequence[float]]
) -> Iterator[_Message]:
    """Yield the messages of one topic."""
    for ns, row in zip(stamps, rows, strict=True):
        yield ns, topic, kind, make(ns, row)


def _frame(parent: str, child: str, t: int, pose: Sequence[float]) -> _Fields:
    x, y, yaw = pose
    transform = {"translation": {"x": x, "y": y}, "rotation": _turned(yaw)}
    return {"transforms": [{"header": _header(t, parent), "child_frame_id": child, "transform": transform}]}


def write_bag(log: Log, path: Path) -> None:
    """Write a log as a bag, whole or not at all: ROS 1 for a path that ends in .bag, ROS 2 for .mcap.

    Raises:
        ValueError: the stamps do not fit into a bag.
        OSError: the file cannot be written.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    ros1 = path.suffix.lower() == ".bag"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    messages = _messages(log, _epoch(log, path), ros1)

    def write(beside: Path) -> None:
        if ros1:
            with Writer1(beside) as writer:
                _fill(writer, types, messages, types.serialize_ros1)
            return
        # a ROS 2 bag is a folder; its one .mcap file is complete in itself
        folder = temporary_beside(path.with_suffix(""))
        folder.mkdir()
        try:
            with Writer2(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer2:
                _fill(writer2, types, messages, types.serialize_cdr)
            next((folder / "bag").glob("*.mcap")).replace(beside)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    write_atomic(path, write)


def _fill(writer: Any, types: Any, messages: Iterable[_Message], serialize: Callable[[Any, str], Any]) -> None:
    """Write all messages."""
    connected: dict[str, Any] = {}
    for ns, topic, kind, fields in messages:
        if topic not in connected:
            connected[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(connected[topic], ns, serialize(_made(types, kind, fields), kind))


def _made(types: Any, kind: str, fields: _Fields) -> Any:
    """Return a message of a type."""
    from rosbags.interfaces import Nodetype

    found = {}
    for name, (node, detail) in types.fielddefs[kind][1]:
        given = fields.get(name)
        if node is Nodetype.NAME:
            found[name] = _made(types, detail, given or {})
        elif node is Nodetype.BASE:
            found[name] = given or ("" if detail[0] == "string" else 0)
        elif detail[0][0] is Nodetype.NAME:
            found[name] = [_made(types, detail[0][1], each) for each in given or ()]
        else:
            found[name] = np.zeros(detail[1]) if given is None else given
    return types.types[kind](**found)
