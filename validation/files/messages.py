"""Messages of bags, read by rosbags: numbers by topic, type and columns.

A child process does this, see `bags`.
"""

from __future__ import annotations

import itertools
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from validation.files.columns import BESIDE_MOTION
from validation.files.guarded import Answer

_MOST_COUNT = 2**53
"""Greatest number of messages that a topic may claim."""
_LATEST_NS = 2**62
"""Greatest stamp of writing [ns], in the year 2116: differences of stamps stay within 64 bits."""
TRANSFORM = "/tf:"
"""Beginning of the names of transforms, which are read as a topic for each pair of frames, such as
`/tf:map.base_link`."""
_Row = tuple[str, int, dict[str, float]]
"""Name of a topic of its own, if it has one; the header's stamp [ns], 0 for none; and the numbers
by column."""


# ------------------------------------------------------------------------------------------
# messages
_JOINTS = ("velocity", "position", "effort")
_POSE = "x={0}.x y={0}.y qw={1}.w qx={1}.x qy={1}.y qz={1}.z "
_VECTOR = "{0}_x={1}.x {0}_y={1}.y {0}_z={1}.z "
_TWIST = "v={0}linear.x w={0}angular.z "
_TRANSFORMS = _POSE.format("transform.translation", "transform.rotation")
MESSAGE_FIELDS: Mapping[str, str] = MappingProxyType(
    {
        "geometry_msgs/msg/Twist": _TWIST.format(""),
        "geometry_msgs/msg/TwistStamped": _TWIST.format("twist."),
        "geometry_msgs/msg/PoseStamped": _POSE.format("pose.position", "pose.orientation"),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE.format(
            "pose.pose.position", "pose.pose.orientation"
        ),
        "nav_msgs/msg/Odometry": _POSE.format("pose.pose.position", "pose.pose.orientation")
        + _TWIST.format("twist.twist.")
        + "v_y=twist.twist.linear.y",
        "sensor_msgs/msg/Imu": _VECTOR.format("gyro", "angular_velocity")
        + _VECTOR.format("acc", "linear_acceleration"),
        "sensor_msgs/msg/JointState": "",
        "sensor_msgs/msg/NavSatFix": "latitude=latitude longitude=longitude",
        "tf2_msgs/msg/TFMessage": _TRANSFORMS,
        "tf/msg/tfMessage": _TRANSFORMS,
        **{
            next(iter(channels.values())).message: " ".join(
                f"{name}={column.field}" for name, column in channels.items()
            )
            for channels in BESIDE_MOTION.values()
        },
    }
)
"""Columns, each with its field, of the messages that are read, by their type; of transforms, those
of each. Joints are by name instead. For a further type, add a line."""


def _rows_of(message: Any, reads: Mapping[str, Callable[[Any], float]]) -> Iterator[_Row]:
    """Yield the rows of a message; one that says nothing has none."""
    for part in getattr(message, "transforms", (message,)):
        name = ""
        if part is not message:
            frames = (part.header.frame_id, part.child_frame_id)
            name = TRANSFORM + ".".join(frame.strip("/") for frame in frames)
        stamp = part.header.stamp if hasattr(part, "header") else None
        ns = 0 if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec
        numbers = {column: float(read(part)) for column, read in reads.items()}
        if hasattr(part, "effort"):
            # in one order, whatever that of the message
            numbers = dict(sorted(_joint_numbers(part)))
        if "latitude" in numbers and part.status.status < 0:  # worse than STATUS_FIX
            continue
        if numbers:
            yield name, ns, numbers


def _joint_numbers(message: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers of each joint, with a name such as `wheel.velocity`."""
    for part in _JOINTS:
        values = getattr(message, part)
        if len(values) == len(message.name):
            for name, value in zip(message.name, values, strict=True):
                yield f"{name}.{part}", float(value)


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
    reads = {}
    for kind, text in MESSAGE_FIELDS.items():
        pairs = (field.split("=") for field in text.split())
        reads[kind] = {column: attrgetter(path) for column, path in pairs}
    read = set[str]()
    count = 0
    # the type store serves bags that do not contain their message types: ROS 2 before Iron
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        connections = [c for c in reader.connections if c.msgtype in MESSAGE_FIELDS]
        messages = reader.messages(connections) if connections else ()
        for connection, ns, raw in itertools.islice(messages, most):
            count += 1
            if not 0 <= ns < _LATEST_NS:
                raise ValueError(f"a message was written at {ns} ns")
            kind = connection.msgtype
            for name, header_ns, numbers in _rows_of(reader.deserialize(raw, kind), reads[kind]):
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
