"""Bags that other tools open: MCAP files with ROS 2 messages (PlotJuggler, rerun, Foxglove) and ROS 1 bags.

Every group becomes a topic with its own stamps: /cmd_vel (TwistStamped), /joint_states (JointState), /odom (Odometry),
/imu/data (Imu), /pose (PoseStamped). Columns that fit no such message become a topic of Float64 each; these are not read
back.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.logs.groups import GROUPS, POSES, Groups
from validation.store import temporary_beside, write_atomic

EPOCH_NS = 1_000_000_000 * 10**9
"""Unix time that stands for t = 0 in bags [ns], 2001-09-09: a stamp of zero would mean that there is none."""
_WORLD, _BASE = "map", "base_link"
_FLOAT = "std_msgs/msg/Float64"
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

    def twist(self, v: float, w: float) -> Any:
        return self.make("geometry_msgs/msg/Twist", linear=self.vector(v), angular=self.vector(z=w))

    def pose(self, x: float, y: float, yaw: float) -> Any:
        point = self.make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)
        w, i, j, k = map(float, yaw_to_quat_wxyz(yaw))
        turned = self.make("geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=turned)


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
    return s.make("nav_msgs/msg/Odometry", header=s.header(t, "odom"), child_frame_id=_BASE, pose=pose, twist=twist)


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


def write_bag(groups: Groups, path: Path) -> None:
    """Write a log as a bag, whole or not at all: ROS 1 for a path that ends in .bag, ROS 2 for .mcap.

    Raises:
        OSError: the file cannot be written.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    ros1 = path.suffix.lower() == ".bag"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store = _Store(types, ros1)

    def write(beside: Path) -> None:
        if ros1:
            with Writer1(beside) as writer:
                _fill(writer, store, groups, types.serialize_ros1)
            return
        # a ROS 2 bag is a folder; its one .mcap file is complete in itself
        folder = temporary_beside(path.with_suffix(""))
        folder.mkdir()
        try:
            with Writer2(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer2:
                _fill(writer2, store, groups, types.serialize_cdr)
            next((folder / "bag").glob("*.mcap")).replace(beside)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    write_atomic(path, write)


_ODOMETRY = dict(zip(*POSES, strict=True))
"""Names of odometry's pose by those of a pose: in a log without another pose, odometry's columns are x, y, yaw."""
_Message = tuple[int, str, str, Callable[[], Any]]
"""Stamp [ns], topic, type, and the function that makes the message."""


def _fill(writer: Any, store: _Store, groups: Groups, serialize: Callable[[Any, str], Any]) -> None:
    """Write all messages in the order of time, as a recorder does."""
    messages = sorted(_messages(store, groups), key=lambda m: m[0])
    kinds = {topic: kind for _, topic, kind, _ in messages}
    connected = {topic: writer.add_connection(topic, kind, typestore=store.types) for topic, kind in kinds.items()}
    for ns, topic, kind, make in messages:
        writer.write(connected[topic], ns, serialize(make(), kind))


def _messages(store: _Store, groups: Groups) -> Iterator[_Message]:
    for name, group in groups.items():
        stamps = [EPOCH_NS + round(float(t) * 1e9) for t in group.t]
        loose = {_ODOMETRY.get(n, n) if name == "odom" else n: values for n, values in group.columns.items()}
        if name in _TOPICS and all(column in loose for column in GROUPS[name]):
            topic, kind, make = _TOPICS[name]
            table = np.column_stack([loose.pop(column) for column in GROUPS[name]])
            for ns, row in zip(stamps, table, strict=True):
                yield ns, topic, kind, partial(make, store, ns, row)
        for column, values in loose.items():
            topic = "/" + "".join(c if c.isascii() and c.isalnum() else "_" for c in column)
            for ns, value in zip(stamps, values.tolist(), strict=True):
                yield ns, topic, _FLOAT, partial(store.make, _FLOAT, data=value)
