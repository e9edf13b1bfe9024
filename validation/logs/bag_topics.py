"""Roles of a bag's topics: which one holds the commands, the odometry, the wheels, the IMU, the pose and the GPS fixes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from validation.logs.bags import Bag, Stream
from validation.logs.csv_table import quoted
from validation.logs.recording import RecordingError

ROLES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "cmd": ("v", "w"),
        "odom": ("v", "w"),
        "wheels": (),
        "imu": ("gyro_x", "gyro_y", "gyro_z"),
        "pose": ("x", "y", "yaw"),
        "gps": ("latitude", "longitude"),
    }
)
"""Columns that a stream must have for each role; wheels need rates or angles of both sides."""

GUESSED: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = MappingProxyType(
    {
        "cmd": (("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"), ("cmd_vel",)),
        "odom": (("nav_msgs/msg/Odometry",), ("controller", "wheel")),
        "wheels": (("sensor_msgs/msg/JointState",), ()),
        "imu": (("sensor_msgs/msg/Imu",), ("imu/data",)),
        "pose": (("geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"), ()),
        "gps": (("sensor_msgs/msg/NavSatFix",), ()),
    }
)
"""Message types that are taken for each role, and parts of topic names that are preferred."""

_TF_PARENTS = ("map", "world", "mocap", "vicon", "optitrack")
_TF_CHILDREN = ("base_link", "base_footprint")
"""A transform is taken for the pose only from one of these parents to one of these children: odom to base_link is
odometry."""


def fits(stream: Stream, role: str) -> bool:
    """Return whether a stream has the columns that the role needs."""
    if role == "wheels":
        return any(all(f"{kind}_{side}" in stream.columns for side in ("left", "right")) for kind in ("rate", "angle"))
    return all(name in stream.columns for name in ROLES[role])


def guess_topics(streams: Iterable[Stream]) -> dict[str, Stream]:
    """Return the stream of each role, by message type.

    Among several, a topic with a preferred part in its name goes first, then a type that `GUESSED` lists earlier, then the
    topic with more samples, then the alphabet. A stream of fewer than two samples gets no role.
    """
    found: dict[str, Stream] = {}
    for role, (types, parts) in GUESSED.items():
        able = [s for s in streams if s.type in types and fits(s, role) and len(s) > 1 and _is_global(s)]
        if able:
            found[role] = min(
                able, key=lambda s: (not any(p in s.topic for p in parts), types.index(s.type), -len(s), s.topic)
            )
    return found


def _is_global(stream: Stream) -> bool:
    """Return False for a transform that does not place the robot in a map; True for it, and for all other streams."""
    parent, arrow, child = stream.topic.partition(":")[2].partition("->")
    return not arrow or (parent in _TF_PARENTS and child.split("/")[-1] in _TF_CHILDREN)


def choose_topics(bag: Bag, named: Mapping[str, str] = MappingProxyType({})) -> dict[str, Stream]:
    """Return the stream of each role: as named, and guessed for the roles that are not.

    Args:
        bag: the bag.
        named: topics by role; `none` leaves the role empty.

    Raises:
        RecordingError: an unknown role, a topic that is not there, or a topic without the columns of its role.
    """
    unknown = [role for role in named if role not in ROLES]
    if unknown:
        raise RecordingError(bag.path, f"unknown role {quoted(unknown)}; there are: {', '.join(ROLES)}")
    chosen = {role: s for role, s in guess_topics(bag.streams).items() if role not in named}
    for role, topic in named.items():
        if topic == "none":
            continue
        stream = bag.stream(topic)
        if not fits(stream, role):
            wanted = f"wanted {' or '.join(ROLES[role]) or 'wheels'}, as of {GUESSED[role][0][0]}"
            raise RecordingError(bag.path, f"topic {topic} of {stream.type} cannot be {role}: {wanted}")
        chosen[role] = stream
    return {role: chosen[role] for role in ROLES if role in chosen}
