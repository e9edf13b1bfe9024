"""Small bags for tests, of any generation of ROS, written through rosbags itself and not through our writer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000
"""Unix time of bags [s]."""
KINDS = ("ros1", "sqlite", "mcap folder", "mcap")
"""What `write` can make."""
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)

Message = tuple[str, float, Any]
"""Topic, instant of writing [s] after START, message."""


class Maker:
    """Makes messages of one generation."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.types = ROS1 if kind == "ros1" else ROS2

    def __call__(self, name: str, /, **fields: Any) -> Any:
        package, _, short = name.partition("/")
        return self.types.types[f"{package}/msg/{short}"](**fields)

    def header(self, t: float | None, frame: str = "") -> Any:
        """Stamped at `t` [s] after START; None: not at all."""
        ns = 0 if t is None else round((START + t) * 1e9)
        stamp = self("builtin_interfaces/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        return self("std_msgs/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.types is ROS1 else {}))

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        return self("geometry_msgs/Vector3", x=x, y=y, z=z)

    def twist(self, v: float, w: float) -> Any:
        return self("geometry_msgs/Twist", linear=self.vector(v), angular=self.vector(z=w))

    def twist_stamped(self, t: float | None, v: float, w: float) -> Any:
        return self("geometry_msgs/TwistStamped", header=self.header(t), twist=self.twist(v, w))

    def quaternion(self, yaw: float) -> Any:
        return self("geometry_msgs/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))

    def pose(self, x: float, y: float, yaw: float) -> Any:
        point = self("geometry_msgs/Point", x=x, y=y, z=0.0)
        return self("geometry_msgs/Pose", position=point, orientation=self.quaternion(yaw))

    def pose_stamped(self, t: float | None, x: float, y: float, yaw: float) -> Any:
        return self("geometry_msgs/PoseStamped", header=self.header(t, "map"), pose=self.pose(x, y, yaw))

    def odometry(self, t: float | None, pose: tuple[float, float, float], v: float, w: float) -> Any:
        covariance = np.zeros(36)
        return self(
            "nav_msgs/Odometry",
            header=self.header(t, "odom"),
            child_frame_id="base_link",
            pose=self("geometry_msgs/PoseWithCovariance", pose=self.pose(*pose), covariance=covariance),
            twist=self("geometry_msgs/TwistWithCovariance", twist=self.twist(v, w), covariance=covariance),
        )

    def imu(self, t: float | None, rates: Sequence[float], acceleration: Sequence[float] = (0.0, 0.0, 9.81)) -> Any:
        nine = np.zeros(9)
        return self(
            "sensor_msgs/Imu",
            header=self.header(t),
            orientation=self.quaternion(0.0),
            orientation_covariance=nine,
            angular_velocity=self.vector(*rates),
            angular_velocity_covariance=nine,
            linear_acceleration=self.vector(*acceleration),
            linear_acceleration_covariance=nine,
        )

    def joints(self, t: float | None, rates: Mapping[str, float]) -> Any:
        values, nothing = np.array(list(rates.values())), np.zeros(0)
        return self(
            "sensor_msgs/JointState",
            header=self.header(t),
            name=list(rates),
            position=nothing,
            velocity=values,
            effort=nothing,
        )

    def fix(self, t: float | None, latitude: float, longitude: float, status: int = 0) -> Any:
        return self(
            "sensor_msgs/NavSatFix",
            header=self.header(t),
            status=self("sensor_msgs/NavSatStatus", status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=0.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    def text(self, what: str) -> Any:
        return self("std_msgs/String", data=what)


def write(folder: Path, kind: str, messages: Callable[[Maker], Sequence[Message]], name: str = "drive") -> Path:
    """A bag of messages; what `messages` makes with the maker of that kind."""
    make = Maker(kind)
    made = messages(make)
    if kind == "ros1":
        path = folder / f"{name}.bag"
        with Writer1(path) as writer:
            _fill(writer, made, ROS1, ROS1.serialize_ros1)
        return path
    path = folder / name
    plugin = StoragePlugin.SQLITE3 if kind == "sqlite" else StoragePlugin.MCAP
    with Writer2(path, version=9, storage_plugin=plugin) as writer2:
        _fill(writer2, made, ROS2, ROS2.serialize_cdr)
    return next(path.glob("*.mcap")) if kind == "mcap" else path


def _fill(writer: Any, messages: Sequence[Message], types: Any, serialize: Callable[[Any, str], Any]) -> None:
    connections: dict[str, Any] = {}
    for topic, t, message in messages:
        kind = message.__msgtype__
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(connections[topic], round((START + t) * 1e9), serialize(message, kind))


def circle(make: Maker, n: int = 60, dt: float = 0.05, late: float = 0.01) -> list[Message]:
    """Every type that is read, of a robot on a circle, 0.5 m/s and 0.4 rad/s; written `late` [s] after its stamps."""
    v, w, messages = 0.5, 0.4, []
    for k in range(n):
        t = 1.0 + dt * k
        yaw = w * t
        x, y = v / w * math.sin(yaw), v / w * (1.0 - math.cos(yaw))
        wheels = {
            "front_left_wheel": 2.0,
            "front_right_wheel": 4.0,
            "rear_left_wheel": 2.5,
            "rear_right_wheel": 4.5,
            "arm": 9.0,
        }
        messages += [
            ("/cmd_vel", make.twist(v, w)),
            ("/husky_velocity_controller/odom", make.odometry(t, (x, y, yaw), v, w)),
            ("/joint_states", make.joints(t, wheels)),
            ("/imu/data", make.imu(t, (0.0, w, 0.0), (0.0, 9.81, 0.0))),  # lies on its side
            ("/vrpn_client_node/husky/pose", make.pose_stamped(t, x, y, yaw)),
            ("/fix", make.fix(t, 45.0 + y / 111_131.78, 7.0 + x / 78_846.8)),
            ("/rosout", make.text("hello")),
        ]
    return [(topic, 1.0 + dt * (k // 7) + late, message) for k, (topic, message) in enumerate(messages)]


def poses_at(make: Maker, n: int = 20, jump: float = 0.0) -> list[Message]:
    """Poses at 10 Hz; the clock of their stamps jumps [s] after the tenth."""
    stamps = [0.1 * k + (jump if k >= 10 else 0.0) for k in range(n)]
    return [("/pose", 0.1 * k, make.pose_stamped(t, 0.1 * k, 0.0, 0.0)) for k, t in enumerate(stamps)]
