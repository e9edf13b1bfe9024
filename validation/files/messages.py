"""Messages of bags, read by rosbags: numbers by topic, type and columns.

A child process does this, see `bags`. From joint states only wheels are read: joints with `wheel`
and `left` or `right` in their names, averaged over each side.
"""

from __future__ import annotations

import itertools
import math
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ssmr.geometry import quat_wxyz_to_yaw
from validation.files.guarded import Answer
from validation.files.log import COMMAND_COLUMNS

_MOST_COUNT = 2**53
"""Greatest number of messages that a topic may claim."""
_LATEST_NS = 2**62
"""Greatest stamp of writing [ns], in the year 2116: differences of stamps stay within 64 bits."""
_Row = tuple[int, dict[str, float]] | None
"""The header's stamp [ns] (0 for none), and the numbers by column; None for a message that says
nothing."""


# ------------------------------------------------------------------------------------------
# messages
def _header_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _twist(twist: Any) -> dict[str, float]:
    return {"v": twist.linear.x, "w": twist.angular.z}


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    quat = [getattr(orientation, axis) for axis in "wxyz"]
    # a quaternion of zeros is a field that nobody filled; not every driver normalises
    yaw = math.nan
    if any(quat) and all(abs(q) < 1e3 for q in quat):
        yaw = float(quat_wxyz_to_yaw(quat))
    return {"x": position.x, "y": position.y, "yaw": yaw}


def _pose_stamped(m: Any) -> _Row:
    return _header_ns(m), _pose(m.pose.position, m.pose.orientation)


def _odometry(m: Any) -> _Row:
    pose = m.pose.pose
    return _header_ns(m), _pose(pose.position, pose.orientation) | _twist(m.twist.twist)


def _imu(m: Any) -> _Row:
    rates = {f"gyro_{axis}": getattr(m.angular_velocity, axis) for axis in "xyz"}
    accelerations = {f"acc_{axis}": getattr(m.linear_acceleration, axis) for axis in "xyz"}
    return _header_ns(m), rates | accelerations


def _joints(m: Any) -> _Row:
    if len(m.velocity) != len(m.name):
        return None
    means = {}
    for column, side in zip(COMMAND_COLUMNS["wheels"], ("left", "right"), strict=True):
        rates = []
        for name, rate in zip(m.name, m.velocity, strict=True):
            joint = name.lower()
            if "wheel" in joint and side in joint:
                rates.append(float(rate))
        if not rates:
            return None
        means[column] = sum(rates) / len(rates)
    return _header_ns(m), means


def _fix(m: Any) -> _Row:
    if m.status.status < 0:  # worse than STATUS_FIX
        return None
    return _header_ns(m), {"latitude": m.latitude, "longitude": m.longitude}


READERS: Mapping[str, Callable[[Any], _Row]] = MappingProxyType(
    {
        "geometry_msgs/msg/Twist": lambda m: (0, _twist(m)),
        "geometry_msgs/msg/TwistStamped": lambda m: (_header_ns(m), _twist(m.twist)),
        "geometry_msgs/msg/PoseStamped": _pose_stamped,
        "nav_msgs/msg/Odometry": _odometry,
        "sensor_msgs/msg/Imu": _imu,
        "sensor_msgs/msg/JointState": _joints,
        "sensor_msgs/msg/NavSatFix": _fix,
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
            row = READERS[kind](reader.deserialize(raw, kind))
            if row is None:
                continue
            header_ns, numbers = row
            key = (connection.topic, kind, tuple(numbers))
            if key not in kinds:
                kinds[key] = array("q"), array("q"), array("d")
            written, header, table = kinds[key]
            written.append(ns)
            header.append(header_ns)
            table.extend(numbers.values())
        read = {topic for topic, _, _ in kinds}
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
