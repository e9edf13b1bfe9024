"""Small bags for tests, of any generation of ROS, written through rosbags itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000
"""Unix time of bags [s]."""
KINDS = ("ros1", "sqlite", "mcap folder", "mcap")
"""Topics and messages that most people record."""
PACKINGS = {
    "messages": CompressionMode.MESSAGE,
    "file": CompressionMode.FILE,
    "zstd": CompressionMode.STORAGE,
    "lz4": CompressionMode.STORAGE,
}
PACKED_KINDS = ("ros1 bz2", "ros1 lz4", "sqlite messages", "sqlite file", "mcap zstd", "mcap lz4")
"""Bags that are packed: whole, by chunk, or by message."""
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)

Made = tuple[str, Mapping[str, Any]]
"""Message type, and fields."""
Message = tuple[str, float, Made]
"""Topic, instant of writing [s] after START, message."""


def stamped(t: float, **fields: Any) -> dict[str, Any]:
    """Fields below a header of `t` [s] after START."""
    ns = round((START + t) * 1e9)
    return {"header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}, **fields}


def twist_of(v: float, w: float) -> dict[str, Any]:
    return {"linear": {"x": v}, "angular": {"z": w}}


def pose_of(x: float, y: float, yaw: float) -> dict[str, Any]:
    return {
        "position": {"x": x, "y": y},
        "orientation": {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
    }


def twist(v: float, w: float) -> Made:
    return "geometry_msgs/msg/Twist", twist_of(v, w)


def twist_stamped(t: float, v: float, w: float) -> Made:
    return "geometry_msgs/msg/TwistStamped", stamped(t, twist=twist_of(v, w))


def pose_stamped(t: float, x: float, y: float = 0.0, yaw: float = 0.0) -> Made:
    return "geometry_msgs/msg/PoseStamped", stamped(t, pose=pose_of(x, y, yaw))


def odometry(t: float, pose: tuple[float, float, float], v: float, w: float) -> Made:
    return "nav_msgs/msg/Odometry", stamped(
        t, pose={"pose": pose_of(*pose)}, twist={"twist": twist_of(v, w)}
    )


def imu(t: float, rates: Sequence[float], acceleration: Sequence[float] = (0.0, 0.0, 9.81)) -> Made:
    vectors = {"angular_velocity": rates, "linear_acceleration": acceleration}
    return "sensor_msgs/msg/Imu", stamped(
        t, **{n: dict(zip("xyz", v, strict=True)) for n, v in vectors.items()}
    )


def joints(t: float, rates: Mapping[str, float], efforts: Sequence[float] = ()) -> Made:
    return "sensor_msgs/msg/JointState", stamped(
        t, name=list(rates), velocity=np.array(list(rates.values())), effort=np.array(efforts)
    )


def fix(t: float, latitude: float, longitude: float) -> Made:
    return "sensor_msgs/msg/NavSatFix", stamped(t, latitude=latitude, longitude=longitude)


def transform(t: float, parent: str, child: str, pose: tuple[float, float, float]) -> Made:
    place = pose_of(*pose)
    moved = {"translation": place["position"], "rotation": place["orientation"]}
    fields = stamped(t, child_frame_id=child, transform=moved)
    fields["header"]["frame_id"] = parent
    return "tf2_msgs/msg/TFMessage", {"transforms": [fields]}


def text(what: str) -> Made:
    return "std_msgs/msg/String", {"data": what}


def write(folder: Path, kind: str, messages: Sequence[Message], name: str = "drive") -> Path:
    """A bag of messages, packed where the kind says how."""
    storage, _, packed = kind.partition(" ")
    if storage == "ros1":
        path = folder / f"{name}.bag"
        writer = Writer1(path)
        if packed:
            writer.set_compression(Writer1.CompressionFormat[packed.upper()])
        with writer:
            _fill(writer, messages, ROS1, ROS1.serialize_ros1)
        return path
    path = folder / name
    plugin = StoragePlugin.SQLITE3 if storage == "sqlite" else StoragePlugin.MCAP
    writer2 = Writer2(path, version=9, storage_plugin=plugin)
    if packed in PACKINGS:
        writer2.set_compression(PACKINGS[packed], CompressionFormat.ZSTD)
    with writer2:
        if packed == "lz4":
            chunks: Any = writer2.storage
            chunks.compression = packed
            chunks.compressor = lz4.frame.compress
        _fill(writer2, messages, ROS2, ROS2.serialize_cdr)
    return next(path.glob("*.mcap")) if storage == "mcap" and packed != "folder" else path


def _fill(writer: Any, messages: Sequence[Message], types: Any, serialize: Any) -> None:
    connections: dict[str, Any] = {}
    for topic, t, (kind, fields) in messages:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(
            connections[topic],
            round((START + t) * 1e9),
            serialize(message_of(types, kind, fields), kind),
        )


def circle(n: int = 60, dt: float = 0.05, late: float = 0.01) -> list[Message]:
    """Every type that is read, of a robot on a circle, 0.5 m/s and 0.4 rad/s.

    Written `late` [s] after its stamps.
    """
    v = 0.5
    w = 0.4
    messages = list[Message]()
    rates = {
        "front_left_wheel": 2.0,
        "front_right_wheel": 4.0,
        "rear_left_wheel": 2.5,
        "rear_right_wheel": 4.5,
        "arm": 9.0,
    }
    for t in (1.0 + dt * np.arange(n)).tolist():
        yaw = w * t
        x = v / w * math.sin(yaw)
        y = v / w * (1.0 - math.cos(yaw))
        made = {
            "/cmd_vel": twist(v, w),
            "/husky_velocity_controller/odom": odometry(t, (x, y, yaw), v, w),
            "/joint_states": joints(t, rates),
            "/imu/data": imu(t, (0.0, w, 0.0), (0.0, 9.81, 0.0)),  # lies on its side
            "/vrpn_client_node/husky/pose": pose_stamped(t, x, y, yaw),
            "/fix": fix(t, 45.0 + y / 111_131.78, 7.0 + x / 78_846.8),
            "/rosout": text("hello"),
        }
        messages += [(topic, t + late, message) for topic, message in made.items()]
    return messages


def poses_at(n: int = 20, jump: float = 0.0, value: float | None = None) -> list[Message]:
    """Poses at 10 Hz; the clock of their stamps jumps [s] after the tenth."""
    ticks = [(0.1 * k, 0.1 * k + (jump if k >= 10 else 0.0)) for k in range(n)]
    return [
        ("/pose", written, pose_stamped(t, written if value is None else value))
        for written, t in ticks
    ]


def message_of(types: Any, kind: str, fields: Any) -> Any:
    """Return a message of a type of a rosbags type store.

    Fields that are not given are zero or empty.
    """
    from rosbags.interfaces import Nodetype

    entries = {}
    for name, (node, detail) in types.fielddefs[kind][1]:
        given = fields.get(name)
        if node is Nodetype.NAME:
            entries[name] = message_of(types, detail, given or {})
        elif node is Nodetype.BASE:
            entries[name] = given or ("" if detail[0] == "string" else 0)
        elif detail[0][0] is Nodetype.NAME:
            entries[name] = [message_of(types, detail[0][1], each) for each in given or ()]
        else:
            entries[name] = np.zeros(detail[1]) if given is None else given
    return types.types[kind](**entries)
