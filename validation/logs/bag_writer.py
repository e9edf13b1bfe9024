"""Bags that other tools open: MCAP files with ROS 2 messages (PlotJuggler, rerun, Foxglove) and ROS 1 bags.

Every group becomes a topic with its own stamps: /cmd_vel (TwistStamped), /joint_states (JointState), /odom (Odometry),
/imu/data (Imu), /pose (PoseStamped). Columns that fit no such message become a topic of Float64 each, and one message says
which columns the topics hold: so all of them are read back, the yaw but for full turns, and times from the first stamp on.
In MCAP files viewers find /tf besides, from the pose or else from odometry, and /robot_description if the robot is known.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.logs.bags import CHANNEL, MAP_TOPIC, TEXT
from validation.logs.files import quoted
from validation.logs.groups import GROUPS, POSES, Groups
from validation.store import temporary_beside, write_atomic

EPOCH = 1_000_000_000
"""Unix time that stands for t = 0 in bags [s], 2001-09-09: a stamp of zero would mean that there is none. A log whose stamps
all are later than this has Unix time, and keeps it."""
_LATEST = 2**31
"""Second at which the stamps of bags end; those of ROS 1 would go on, but not every tool has them without a sign."""
_LONGEST_NAME = 200
"""Greatest length of a topic's name; DDS has room for some fifty more."""
_WORLD, _BASE, _ODOM = "map", "base_link", "odom"
_TF, DESCRIPTION = "tf2_msgs/msg/TFMessage", "/robot_description"
_SHOWN = 8
"""Number of renamed columns that a sentence lists."""
_UNKNOWN = -1.0
"""First element of the covariance of something that was not measured (sensor_msgs/Imu)."""


@dataclass(frozen=True)
class _Store:
    """Makes messages of one generation of ROS."""

    types: Any
    ros1: bool

    def make(self, kind: str, **fields: Any) -> Any:
        return self.types.types[kind](**fields)

    def header(self, t: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=t // 10**9, nanosec=t % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros1 else {}))

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        return self.make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def turned(self, yaw: float) -> Any:
        w, i, j, k = map(float, yaw_to_quat_wxyz(yaw))
        return self.make("geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w)

    def twist(self, v: float, w: float) -> Any:
        return self.make("geometry_msgs/msg/Twist", linear=self.vector(v), angular=self.vector(z=w))

    def pose(self, x: float, y: float, yaw: float) -> Any:
        point = self.make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=self.turned(yaw))

    def frame(self, parent: str, child: str, t: int, pose: FloatArray) -> Any:
        kind, x, y = "geometry_msgs/msg/Transform", float(pose[0]), float(pose[1])
        transform = self.make(kind, translation=self.vector(x, y), rotation=self.turned(float(pose[2])))
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped", header=self.header(t, parent), child_frame_id=child, transform=transform
        )
        return self.make(_TF, transforms=[stamped])


def _cmd(s: _Store, t: int, row: FloatArray) -> Any:
    return s.make("geometry_msgs/msg/TwistStamped", header=s.header(t, _BASE), twist=s.twist(row[0], row[1]))


def _joints(s: _Store, t: int, row: FloatArray) -> Any:
    names = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
    known = {"name": names, "position": np.zeros(0), "velocity": np.tile(row[:2], 2), "effort": np.zeros(0)}
    return s.make("sensor_msgs/msg/JointState", header=s.header(t, ""), **known)


def _odometry(s: _Store, t: int, row: FloatArray) -> Any:
    nothing = np.zeros(36)
    pose = s.make("geometry_msgs/msg/PoseWithCovariance", pose=s.pose(*row[2:5]), covariance=nothing)
    twist = s.make("geometry_msgs/msg/TwistWithCovariance", twist=s.twist(row[0], row[1]), covariance=nothing)
    return s.make("nav_msgs/msg/Odometry", header=s.header(t, _ODOM), child_frame_id=_BASE, pose=pose, twist=twist)


def _imu(s: _Store, t: int, row: FloatArray) -> Any:
    unknown = np.array([_UNKNOWN, *[0.0] * 8])
    return s.make(
        "sensor_msgs/msg/Imu",
        header=s.header(t, _BASE),
        orientation=s.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=s.vector(z=row[0]),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=s.vector(),
        linear_acceleration_covariance=unknown,
    )


def _pose(s: _Store, t: int, row: FloatArray) -> Any:
    return s.make("geometry_msgs/msg/PoseStamped", header=s.header(t, _WORLD), pose=s.pose(*row))


_TOPICS: Mapping[str, tuple[str, str, Callable[[_Store, int, FloatArray], Any]]] = {
    "cmd": ("/cmd_vel", "geometry_msgs/msg/TwistStamped", _cmd),
    "wheels": ("/joint_states", "sensor_msgs/msg/JointState", _joints),
    "odom": ("/odom", "nav_msgs/msg/Odometry", _odometry),
    "imu": ("/imu/data", "sensor_msgs/msg/Imu", _imu),
    "pose": ("/pose", "geometry_msgs/msg/PoseStamped", _pose),
}
"""Topic, message type and maker of each group; a maker gets the store, the stamp [ns] and the group's columns in order."""


_RESERVED = {topic for topic, _, _ in _TOPICS.values()} | {MAP_TOPIC, DESCRIPTION, "/tf", "/tf_static", "/clock", "/rosout"}
"""Topics with a meaning of their own, which no channel takes."""
_ODOMETRY = dict(zip(*POSES, strict=True))
"""Names of odometry's pose by those of a pose: in a log without another pose, odometry's columns are x, y, yaw."""


@dataclass(frozen=True)
class _Plan:
    """A topic that is to be written."""

    topic: str
    kind: str
    """Message type."""
    group: str
    columns: tuple[str, ...]
    """Columns of the group that its messages hold, in the order of the maker."""
    make: Callable[[_Store, int, FloatArray], Any]


def _plans(groups: Groups) -> list[_Plan]:
    """Return the topics of a log, with names that differ."""
    taken = set(_RESERVED)
    plans = []
    for name, group in groups.items():
        known = {_ODOMETRY.get(n, n) if name == "odom" else n: n for n in group.columns}
        whole: tuple[str, ...] = ()
        if name in _TOPICS and all(column in known for column in GROUPS[name]):
            whole = tuple(known[column] for column in GROUPS[name])
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


def bag_losses(groups: Groups, path: Path) -> list[str]:
    """Return sentences about what a bag holds in another way than the log: names of columns, and Unix times that do not fit.

    Raises:
        ValueError: the stamps do not fit into a bag.
    """
    renamed = [(plan.columns[0], plan.topic) for plan in _plans(groups) if plan.kind == CHANNEL]
    named = [f"{quoted([column])} as {topic}" for column, topic in renamed if topic != f"/{column}"]
    more = f" and {len(named) - _SHOWN} more" if len(named) > _SHOWN else ""
    said = [f"columns that cannot name a topic are written under others: {', '.join(named[:_SHOWN])}{more}"] if named else []
    start = min(float(g.t[0]) for g in groups.values())
    if _epoch(groups, path) not in (0, EPOCH):
        said.append(f"stamps begin with 2001-09-09, for {start:.9g} s does not fit into those of a bag")
    return said


def _epoch(groups: Groups, path: Path) -> int:
    """Return the Unix time that stands for t = 0 [s]; a ValueError where the log is longer than the stamps."""
    start, stop = min(float(g.t[0]) for g in groups.values()), max(float(g.t[-1]) for g in groups.values())
    for epoch in (0 if start >= EPOCH else EPOCH, EPOCH - math.floor(start)):
        if 1.0 <= start + epoch and stop + epoch < _LATEST:
            return epoch
    raise ValueError(f"{start:.9g} to {stop:.9g} s do not fit into {path.name}, whose stamps end after {_LATEST} s")


def _stamps(t: FloatArray, epoch: int) -> list[int]:
    """Return (M,) times [s] as Unix time [ns]; whole seconds apart, for a double has no nanoseconds of Unix time.

    Raises:
        ValueError: two of them are the same.
    """
    found = [(epoch + math.floor(s)) * 10**9 + round((s - math.floor(s)) * 1e9) for s in t.tolist()]
    if any(b <= a for a, b in pairwise(found)):
        raise ValueError("samples lie closer together than the nanosecond that stamps of bags resolve")
    return found


def _is_ros1(path: Path) -> bool:
    return path.suffix.lower() == ".bag"


def _number(s: _Store, _: int, row: FloatArray) -> Any:
    return s.make(CHANNEL, data=float(row[0]))


def write_bag(groups: Groups, path: Path, description: str = "") -> None:
    """Write a log as a bag, whole or not at all: ROS 1 for a path that ends in .bag, ROS 2 for .mcap.

    A `description`, the robot's URDF, becomes /robot_description of an MCAP file.

    Raises:
        ValueError: the stamps do not fit into a bag.
        OSError: the file cannot be written.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if _is_ros1(path) else Stores.ROS2_HUMBLE)
    store = _Store(types, _is_ros1(path))
    messages = _messages(store, groups, _epoch(groups, path), description)

    def write(beside: Path) -> None:
        if store.ros1:
            with Writer1(beside) as writer:
                _fill(writer, store, messages, types.serialize_ros1)
            return
        # a ROS 2 bag is a folder; its one .mcap file is complete in itself
        folder = temporary_beside(path.with_suffix(""))
        folder.mkdir()
        try:
            with Writer2(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer2:
                _fill(writer2, store, messages, types.serialize_cdr)
            next((folder / "bag").glob("*.mcap")).replace(beside)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    write_atomic(path, write)


_Message = tuple[int, str, str, Callable[[], Any]]
"""Stamp [ns], topic, type, and the function that makes the message."""


def _fill(writer: Any, store: _Store, messages: Sequence[_Message], serialize: Callable[[Any, str], Any]) -> None:
    """Write all messages in the order of time, as a recorder does."""
    kinds = {topic: kind for _, topic, kind, _ in messages}
    connected = {topic: writer.add_connection(topic, kind, typestore=store.types) for topic, kind in kinds.items()}
    for ns, topic, kind, make in messages:
        writer.write(connected[topic], ns, serialize(make(), kind))


def _messages(store: _Store, groups: Groups, epoch: int, description: str) -> list[_Message]:
    """Return all messages, sorted by time."""
    plans = _plans(groups)
    stamps = {name: _stamps(group.t, epoch) for name, group in groups.items()}
    said = json.dumps({plan.topic: [plan.group, list(plan.columns)] for plan in plans})
    first = min(ns[0] for ns in stamps.values())
    found: list[_Message] = [(first, MAP_TOPIC, TEXT, partial(store.make, TEXT, data=said))]
    if description and not store.ros1:
        found.append((first, DESCRIPTION, TEXT, partial(store.make, TEXT, data=description)))
    whole = {plan.topic for plan in plans}
    parents = {} if store.ros1 else {"/pose": _WORLD} if "/pose" in whole else {"/odom": _ODOM}
    if (
        parents and {"/pose", "/odom"} <= whole
    ):  # a body has one parent: odometry's frame begins where that of the poses does
        found.append((first, "/tf_static", _TF, partial(store.frame, _WORLD, _ODOM, first, np.zeros(3))))
    for plan in plans:
        table = np.column_stack([groups[plan.group].columns[column] for column in plan.columns])
        rows = list(zip(stamps[plan.group], table, strict=True))
        found += [(ns, plan.topic, plan.kind, partial(plan.make, store, ns, row)) for ns, row in rows]
        if parent := parents.get(plan.topic):
            found += [(ns, "/tf", _TF, partial(store.frame, parent, _BASE, ns, row[-3:])) for ns, row in rows]
    return sorted(found, key=lambda message: message[0])
