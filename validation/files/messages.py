"""Messages of bags, read by rosbags: numbers by topic, type and columns.

A child process does this, see `bags`.
"""

from __future__ import annotations

import itertools
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ssmr.geometry import quat_wxyz_to_yaw
from validation.files.columns import BESIDE_MOTION, Column
from validation.files.guarded import Answer

_MOST_COUNT = 2**53
"""Greatest number of messages that a topic may claim."""
_LATEST_NS = 2**62
"""Greatest stamp of writing [ns], in the year 2116: differences of stamps stay within 64 bits."""
TRANSFORM = "/tf:"
"""Beginning of the names of transforms, which are read as a topic for each pair of frames, such as
`/tf:map.base_link`."""
_Rows = list[tuple[str, int, dict[str, float]]]
"""Name of a topic of its own, if it has one; the header's stamp [ns], 0 for none; and the numbers
by column. A message that says nothing has no row."""


# ------------------------------------------------------------------------------------------
# messages
def _header_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _twist(twist: Any) -> dict[str, float]:
    return {"v": twist.linear.x, "w": twist.angular.z}


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    quat = [getattr(orientation, axis) for axis in "wxyz"]
    # one of zeros, a field that nobody filled, has none
    return {"x": position.x, "y": position.y, "yaw": float(quat_wxyz_to_yaw(quat))}


def _stamped(m: Any, pose: Any, numbers: Mapping[str, float] = MappingProxyType({})) -> _Rows:
    return [("", _header_ns(m), {**_pose(pose.position, pose.orientation), **numbers})]


def _odometry(m: Any) -> _Rows:
    twist = m.twist.twist
    return _stamped(m, m.pose.pose, _twist(twist) | {"v_y": twist.linear.y})


def _imu(m: Any) -> _Rows:
    rates = {f"gyro_{axis}": getattr(m.angular_velocity, axis) for axis in "xyz"}
    accelerations = {f"acc_{axis}": getattr(m.linear_acceleration, axis) for axis in "xyz"}
    return [("", _header_ns(m), rates | accelerations)]


def _joints(m: Any) -> _Rows:
    numbers = dict[str, float]()
    for part in ("velocity", "position", "effort"):
        values = getattr(m, part)
        if len(values) == len(m.name):
            numbers |= {f"{n}.{part}": float(v) for n, v in zip(m.name, values, strict=True)}
    # in one order, whatever that of the message
    return [("", _header_ns(m), dict(sorted(numbers.items())))] if numbers else []


def _transforms(m: Any) -> _Rows:
    rows = []
    for each in m.transforms:
        frames = [name.strip("/") for name in (each.header.frame_id, each.child_frame_id)]
        place = each.transform
        pose = _pose(place.translation, place.rotation)
        rows.append((TRANSFORM + ".".join(frames), _header_ns(each), pose))
    return rows


def _fix(m: Any) -> _Rows:
    if m.status.status < 0:  # worse than STATUS_FIX
        return []
    return [("", _header_ns(m), {"latitude": m.latitude, "longitude": m.longitude})]


def _fields_reader(channels: Mapping[str, Column]) -> Callable[[Any], _Rows]:
    """Return the function that reads some columns, each a field of a message."""

    def read_fields(m: Any) -> _Rows:
        numbers = {name: float(getattr(m, column.field)) for name, column in channels.items()}
        return [("", _header_ns(m) if hasattr(m, "header") else 0, numbers)]

    return read_fields


READERS: Mapping[str, Callable[[Any], _Rows]] = MappingProxyType(
    {
        "geometry_msgs/msg/Twist": lambda m: [("", 0, _twist(m))],
        "geometry_msgs/msg/TwistStamped": lambda m: [("", _header_ns(m), _twist(m.twist))],
        "geometry_msgs/msg/PoseStamped": lambda m: _stamped(m, m.pose),
        "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _stamped(m, m.pose.pose),
        "nav_msgs/msg/Odometry": _odometry,
        "sensor_msgs/msg/Imu": _imu,
        "sensor_msgs/msg/JointState": _joints,
        "sensor_msgs/msg/NavSatFix": _fix,
        "tf2_msgs/msg/TFMessage": _transforms,
        "tf/msg/tfMessage": _transforms,
        **{
            next(iter(channels.values())).message: _fields_reader(channels)
            for channels in BESIDE_MOTION.values()
        },
    }
)
"""Functions that read a message, by its type; for a further type, add a line."""


# ------------------------------------------------------------------------------------------ bags
def collect(path: str, most: int) -> Answer:
    """Return the numbers in the messages of a bag, as far as their types are known.

    Args:
        path: the bag.
        most: number of messages after which reading ends.

    Returns:
        The number of messages that were read; topic, type and names of columns of each kind of
        message; and topic, type and number of the messages that were not read. Each kind has three
        buffers: stamps of writing and of measuring [ns], 0 for none, and the numbers, message by
        message.

    Raises:
        Exception: the bag is none, or damaged; rosbags and its own readers raise errors of many
            classes.
    """
    # here: it takes a fifth of a second, and only a child process needs it
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    kinds: dict[tuple[str, str, tuple[str, ...]], tuple[array[int], array[int], array[float]]] = {}
    read = set[str]()
    count = 0
    # the type store serves bags that do not contain their message types: ROS 2 before Iron
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        connections = [c for c in reader.connections if c.msgtype in READERS]
        messages = reader.messages(connections) if connections else ()
        for connection, ns, raw in itertools.islice(messages, most):
            count += 1
            if not 0 <= ns < _LATEST_NS:
                raise ValueError(f"a message was written at {ns} ns")
            kind = connection.msgtype
            for name, header_ns, numbers in READERS[kind](reader.deserialize(raw, kind)):
                read.add(connection.topic)
                key = (name or connection.topic, kind, tuple(numbers))
                if key not in kinds:
                    kinds[key] = array("q"), array("q"), array("d")
                written, header, table = kinds[key]
                written.append(ns)
                header.append(header_ns)
                table.extend(numbers.values())
        unread: Counter[tuple[str, str]] = Counter()
        for c in reader.connections:
            if c.topic not in read and c.msgcount:
                unread[c.topic, c.msgtype] += max(0, int(c.msgcount))
    buffers = []
    if max(unread.values(), default=0) > _MOST_COUNT:
        raise ValueError(f"a topic claims to have {max(unread.values())} messages")
    for written, header, table in kinds.values():
        buffers += [memoryview(part).cast("B") for part in (written, header, table)]
    return [count, list(kinds), list(unread.items())], buffers
