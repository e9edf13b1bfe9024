"""ROS bags as logs: ROS 1 `.bag` files, ROS 2 folders (sqlite or MCAP) and single `.mcap` files.

Topics with a known message type are read: the planar quantities in them, in SI units. Other topics
are only counted. A message has two stamps: the header's, when it was measured, and the bag's, when
it was written. The header's is preferred. Where there is none, or where it comes from another clock
or one that jumps, the bag's is used. Times are counted from the bag's first stamp.

Topics get roles, and become groups of columns: cmd_v, cmd_w from the role `cmd`; enc_left,
enc_right from `wheels`; gyro_z from `imu`, about the vertical that its accelerometer shows; x, y,
yaw from `pose` or, without one, from `odom`; odom_v and odom_w from `odom` (and odom_x, odom_y,
odom_yaw where there is a `pose`); and gps_east, gps_north from `gps`, metres from its first fix.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.types import FloatArray
from validation.files import guarded
from validation.files.limits import LogLimits
from validation.files.log import (
    COMMAND_COLUMNS,
    POSE_COLUMNS,
    Group,
    Log,
    ReadOptions,
    Topic,
    check_group,
)
from validation.files.messages import collect
from validation.files.reading import FileError, opened, quoted

_METADATA = "metadata.yaml"
"""File that describes the folder of a ROS 2 bag."""
_CLOCK_JUMP = 1.0
"""Difference between the steps of the header's and the bag's stamps from which the header's clock
has jumped [s]; a message that is only written late differs by less, and is sorted."""
_OTHER_CLOCK = 60.0
"""Median distance from the bag's stamps from which a header's clock is another one, such as the
time since start-up [s]."""
_LATEST = 2**62
"""Greatest number of messages for which anybody can ask."""
_SECONDS = 4.0
"""Time that reading an empty bag may take [s]."""
_MEMORY = 2 << 30
"""Memory that reading an empty bag may take [bytes]."""
_DISK = 1 << 28
"""Size of a file that an empty bag may be unpacked to [bytes]."""
_SECONDS_PER_BYTE = 5e-6
"""Time that each byte of a bag adds [s]; small messages take 0.06 s a megabyte, and packed ones ten
times as much."""
_MEMORY_PER_BYTE = 8
"""Memory that each byte of a bag adds [bytes]."""
_DISK_PER_BYTE = 32
"""Size of an unpacked file that each byte of a bag adds [bytes]."""
_GRAVITY_SPAN = (8.8, 10.8)
"""Range of a mean acceleration that is taken for gravity and shows the vertical [m/s2]; outside it,
z is the vertical."""
_EQUATOR = 6378137.0
"""Semi-major axis of the WGS 84 ellipsoid [m]."""
_FLATTENING = 1.0 / 298.257223563
"""Flattening of the WGS 84 ellipsoid [1]."""
_Stamps = NDArray[np.int64]
"""(M,) stamps [ns]."""


class Role(NamedTuple):
    """Requirements that a topic meets for a role."""

    columns: tuple[str, ...]
    """Columns that it must have."""
    types: tuple[str, ...]
    """Message types that are taken for it, the better ones first."""
    preferred: tuple[str, ...] = ()
    """Parts of topics' names that are preferred."""

    def fits(self, topic: Topic) -> bool:
        """Return whether a topic has the columns that the role needs."""
        return all(n in (topic.columns or ()) for n in self.columns)


_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "cmd": Role(("v", "w"), _TWISTS, ("cmd_vel",)),
        "odom": Role(("v", "w"), ("nav_msgs/msg/Odometry",), ("controller", "wheel")),
        "wheels": Role(COMMAND_COLUMNS["wheels"], ("sensor_msgs/msg/JointState",)),
        "imu": Role(("gyro_x", "gyro_y", "gyro_z"), ("sensor_msgs/msg/Imu",), ("imu/data",)),
        "pose": Role(POSE_COLUMNS, ("geometry_msgs/msg/PoseStamped",)),
        "gps": Role(("latitude", "longitude"), ("sensor_msgs/msg/NavSatFix",)),
    }
)
"""Roles that topics can have, in the order of their groups."""


# ------------------------------------------------------------------------------------------ topics
def read_topics(path: Path, options: ReadOptions) -> list[Topic]:
    """Read the topics of a bag.

    Raises:
        FileError: there is no bag, or it is damaged, empty or beyond the limits.
    """
    if find_spec("rosbags") is None:
        raise FileError(path, "reading bags needs rosbags: pip install rosbags")
    allowed = _allowance(path)
    limits = options.limits
    most = int(min(limits.samples, _LATEST))
    try:
        answer, parts = guarded.ask(collect, [str(path), most + 1], allowed)
    except ValueError as error:
        raise FileError(
            path, f"this is no bag that can be read, or a damaged one: {error}"
        ) from error
    count, kinds, others = answer
    for name, many in (("samples", count), ("columns", len(kinds))):
        if many > getattr(limits, name):
            raise FileError(path, f"there are too many messages or topics: {limits.says(name)}")
    if not kinds and not others:
        raise FileError(path, "the bag is empty: there is no message in it")
    stamps = [np.frombuffer(part, np.int64) for part in parts]
    clocks = list(map(_clock, stamps[::3], stamps[1::3]))
    epoch = min((int(ns.min()) for ns, _ in clocks), default=0)
    topics = [_topic(*read, epoch) for read in zip(kinds, parts[2::3], clocks, strict=True)]
    for (name, kind), many in others:
        topics.append(Topic(name, kind, np.broadcast_to(0.0, many), None))
    return topics


def _allowance(path: Path) -> guarded.Allowance:
    """Return the allowance for reading a bag, by the size of its files, which no library opens.

    Raises:
        FileError: this is no bag by its files.
    """
    if path.is_dir() and not (path / _METADATA).exists():
        raise FileError(path, f"this folder is no ROS 2 bag: there is no {_METADATA} in it")
    size = 0
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_dir():
            continue
        with opened(file) as stream:
            size += os.fstat(stream.fileno()).st_size
    return guarded.Allowance(
        _SECONDS + _SECONDS_PER_BYTE * size,
        _MEMORY + _MEMORY_PER_BYTE * size,
        _DISK + _DISK_PER_BYTE * size,
    )


def _clock(written: _Stamps, header: _Stamps) -> tuple[_Stamps, str]:
    """Return the stamps of messages, or of writing, and then why."""
    if not header.all():
        return written, "the messages have no stamps"
    if abs(float(np.median(header - written))) * 1e-9 > _OTHER_CLOCK:
        return written, "the messages' clock is another one than the bag's"
    jumps = np.abs(np.diff(header) - np.diff(written))
    jump = float(np.max(jumps, initial=0)) * 1e-9
    if jump < _CLOCK_JUMP:
        return header, ""
    return written, f"the messages' clock jumps by {jump:.3f} s"


def _topic(
    key: tuple[str, str, Sequence[str]], numbers: bytes, clock: tuple[_Stamps, str], epoch: int
) -> Topic:
    """Return messages as a topic, sorted by their stamps, in seconds from the epoch [ns] on."""
    name, kind, columns = key
    ns, remark = clock
    order = np.argsort(ns, kind="stable")
    table = np.frombuffer(numbers).reshape(len(ns), len(columns))[order]
    t = np.asarray((ns[order] - epoch) * 1e-9, dtype=np.float64)
    values = np.ascontiguousarray(table.T)
    return Topic(name, kind, t, dict(zip(columns, values, strict=True)), remark)


def choose_topics(
    path: Path, topics: Sequence[Topic], named: Mapping[str, str]
) -> dict[str, Topic]:
    """Return the topic of each role: as named, or else guessed by its message type.

    Args:
        path: the bag.
        topics: its topics.
        named: topics by role; `none` leaves the role empty.

    Raises:
        FileError: an unknown role, a topic that is not there, or a topic without the columns of its
            role.
    """
    unknown = [role for role in named if role not in ROLES]
    if unknown:
        raise FileError(path, f"unknown role {quoted(unknown)}; there are: {', '.join(ROLES)}")
    chosen = {}
    for role, needs in ROLES.items():
        if role not in named:
            guess = _guess(topics, needs)
            if guess is not None:
                chosen[role] = guess
        elif named[role] != "none":
            chosen[role] = _named_topic(path, topics, named[role], role)
    return chosen


def _named_topic(path: Path, topics: Sequence[Topic], name: str, role: str) -> Topic:
    """Return the topic of that name; a FileError says why it cannot have the role."""
    topic = next((topic for topic in topics if topic.name == name), None)
    if topic is None:
        names = ", ".join(topic.name for topic in topics if topic.columns is not None)
        names = names or "none that can be read"
        raise FileError(path, f"there is no topic {name}; there are: {names}")
    if topic.columns is None:
        raise FileError(
            path, f"nothing can be read from topic {name}: {len(topic.t)} messages of {topic.type}"
        )
    needs = ROLES[role]
    if not needs.fits(topic):
        raise FileError(
            path,
            f"topic {name} of {topic.type} cannot be {role}: "
            f"wanted {' or '.join(needs.columns)}, as of {needs.types[0]}",
        )
    return topic


def _guess(topics: Sequence[Topic], role: Role) -> Topic | None:
    """Return the topic of a role by its message type; None where there is none.

    It has at least two samples. Among several, one with a preferred part in its name goes first,
    then a type that the role lists earlier, then the one with more samples, then the alphabet.
    """

    def rank(topic: Topic) -> tuple[bool, int, int, str]:
        preferred = any(part in topic.name for part in role.preferred)
        return not preferred, role.types.index(topic.type), -len(topic.t), topic.name

    able = [t for t in topics if t.type in role.types and role.fits(t) and len(t.t) > 1]
    return min(able, key=rank, default=None)


# ------------------------------------------------------------------------------------------ groups
def _group(path: Path, role: str, topic: Topic, prefix: str, limits: LogLimits) -> Group:
    """Return a topic as the group of its role, the first sample of each stamp.

    `prefix` begins the names of the columns of odometry's pose. A FileError says what cannot be
    used.
    """
    first = np.concatenate([[True], np.diff(topic.t) > 0.0])
    t = topic.t[first]
    columns = {name: values[first] for name, values in (topic.columns or {}).items()}
    try:
        if len(t) < 2:
            raise FileError(path, f"topic {topic.name} has fewer than two samples")
        with np.errstate(all="ignore"):  # numbers that are not finite then are refused below
            converted = _converted(role, columns)
        if role in ("pose", "odom") and ROLES["pose"].fits(topic):
            for name in ("x", "y"):
                converted[prefix + name] = columns[name]
            converted[f"{prefix}yaw"] = np.unwrap(columns["yaw"])
        group = Group(topic.name, t, converted)
        check_group(path, group, limits)
    except FileError as fault:
        raise FileError(path, f"{fault.what}; topics {role}=none leaves it out") from fault
    return group


def _converted(role: str, columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    if role in ("cmd", "odom"):
        return {f"{role}_v": columns["v"], f"{role}_w": columns["w"]}
    if role == "imu":
        rates = np.column_stack([columns[f"gyro_{axis}"] for axis in "xyz"])
        return {"gyro_z": rates @ _vertical(columns)}
    if role == "gps":
        east, north = to_local(columns["latitude"], columns["longitude"])
        return {"gps_east": east, "gps_north": north}
    if role == "pose":
        return {}
    return dict(columns)


def _vertical(columns: Mapping[str, FloatArray]) -> FloatArray:
    """Return the (3,) unit vector that points up in an IMU's axes: along its acceleration, or z."""
    mean = np.array([np.mean(columns[f"acc_{axis}"]) for axis in "xyz"])
    size = float(np.linalg.norm(mean))
    if _GRAVITY_SPAN[0] < size < _GRAVITY_SPAN[1]:
        return mean / size
    return np.array([0.0, 0.0, 1.0])


def to_local(latitude: ArrayLike, longitude: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return (M,) metres east and north of the first of (M,) positions [deg].

    The plane touches the ellipsoid there. The result is good to some centimetres within a
    kilometre: terms of second order in the distance over the radius are left out. Beyond the poles
    there are no metres, but NaN.
    """
    degrees = np.asarray(latitude, dtype=np.float64)
    lon = np.asarray(longitude, dtype=np.float64)
    lat = np.radians(np.where(np.abs(degrees) <= 90.0, degrees, math.nan))
    eccentricity2 = _FLATTENING * (2.0 - _FLATTENING)
    root = math.sqrt(1.0 - eccentricity2 * math.sin(lat[0]) ** 2)
    # radii of curvature
    meridian = _EQUATOR * (1.0 - eccentricity2) / root**3
    transverse = _EQUATOR / root
    # differences of longitude, also across the date line
    turned = np.radians(np.mod(lon - lon[0] + 180.0, 360.0) - 180.0)
    east = transverse * math.cos(lat[0]) * turned
    north = meridian * (lat - lat[0])
    return east, north


def read_bag(path: Path, options: ReadOptions) -> Log:
    """Read a bag.

    Raises:
        FileError: there is no such bag, it is damaged, empty or beyond the limits, or a topic
            cannot be used.
    """
    topics = read_topics(path, options)
    chosen = choose_topics(path, topics, options.topics)
    if not chosen:
        there = ", ".join(f"{s.name} ({s.type})" for s in topics if s.columns is not None)
        found = there or "no topic of a type that can be read"
        raise FileError(
            path,
            f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {found}",
        )
    groups = {}
    for role, topic in chosen.items():
        # a pose takes the names x, y and yaw from the odometry
        prefix = "odom_" if role == "odom" and "pose" in chosen else ""
        groups[role] = _group(path, role, topic, prefix, options.limits)
    roles = {id(topic): role for role, topic in chosen.items()}
    listed = [replace(topic, role=roles.get(id(topic), "")) for topic in topics]
    remarks = [f"{t.name}: {t.remark}, so the times of writing count" for t in topics if t.remark]
    return Log(path, groups, listed, remarks, options.limits)
