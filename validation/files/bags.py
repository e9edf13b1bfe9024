"""ROS bags as logs: ROS 1 `.bag` files, ROS 2 folders (sqlite or MCAP) and single files of these.

Topics with a known message type are read: the planar quantities in them, in SI units. Other topics
are only counted. Their stamps are brought onto one clock, see `clocks`, and counted from the first.

Topics get roles, see `topics`, and become columns: cmd_v, cmd_w from the role `cmd`; enc_left,
enc_right from `wheels`; gyro_z from `imu`, about the vertical that its accelerometer shows; x, y,
yaw from `pose`, which may be the topic of `odom`; odom_v and odom_w from `odom` (and odom_x,
odom_y, odom_yaw where `pose` is another topic); and gps_east, gps_north from `gps`, metres from its
first fix.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import numpy as np

from ssmr.geometry import (
    integrate_rates,
    quat_wxyz_to_yaw,
    rotate_body_to_world,
    rotate_world_to_body,
)
from ssmr.types import FloatArray
from validation.files import guarded
from validation.files.clocks import Timed, on_one_clock
from validation.files.columns import BESIDE_MOTION, POSE_COLUMNS, to_local
from validation.files.limits import LogLimits
from validation.files.log import Group, Log, LogFault, ReadOptions, Topic, check_group
from validation.files.messages import collect
from validation.files.reading import FileError, opened
from validation.files.topics import ROLES, choose_topics, wheels_of

_METADATA = "metadata.yaml"
"""File that describes the folder of a ROS 2 bag."""
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
_JOINTS = "sensor_msgs/msg/JointState"
_QUATERNION = ("qw", "qx", "qy", "qz")
_SPAN_S = 1.0
"""Length of the spans over which speeds are compared with ways [s]."""
_TURNED = 0.5
"""Change of heading from which a speed shows its frame [rad]."""
_MUCH_BETTER = 0.3
"""Ratio of the errors of two frames below which the better one is right [1]."""
_GRAVITY_SPAN = (8.8, 10.8)
"""Range of a mean acceleration that is taken for gravity and shows the vertical [m/s2]; outside it,
z is the vertical."""


# ------------------------------------------------------------------------------------------ topics
def read_topics(path: Path, options: ReadOptions) -> tuple[list[Topic], str]:
    """Return the topics of a bag, and a sentence on its clock if that is unusual.

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
    if count > limits.samples:
        raise FileError(path, f"there are too many messages: {limits.says('samples')}")
    if not kinds and not others:
        raise FileError(path, "the bag is empty: there is no message in it")
    stamps = [np.frombuffer(part, np.int64) for part in parts]
    pairs = list(zip(stamps[::3], stamps[1::3], strict=True))
    timed, sentence = on_one_clock([name for name, _, _ in kinds], pairs)
    epoch = min((int(each.ns.min()) for each in timed), default=0)
    topics = [_topic(*read, epoch) for read in zip(kinds, parts[2::3], timed, strict=True)]
    topics = [wheels_of(t, options.columns) if t.type == _JOINTS else t for t in topics]
    for (name, kind), many in others:
        topics.append(Topic(name, kind, np.broadcast_to(0.0, many), None))
    return topics, sentence


def _allowance(path: Path) -> guarded.Allowance:
    """Return the allowance for reading a bag, by the size of its files, which no library opens.

    Raises:
        FileError: this is no bag by its files.
    """
    files = [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if not file.is_dir()]
        if not (path / _METADATA).exists():
            raise FileError(path, f"this folder is no ROS 2 bag: there is no {_METADATA} in it")
    size = 0
    for file in files:
        with opened(file) as stream:
            size += os.fstat(stream.fileno()).st_size
    return (
        _SECONDS + _SECONDS_PER_BYTE * size,
        _MEMORY + _MEMORY_PER_BYTE * size,
        _DISK + _DISK_PER_BYTE * size,
    )


def _topic(key: tuple[str, str, Sequence[str]], numbers: bytes, timed: Timed, epoch: int) -> Topic:
    """Return messages as a topic, sorted by their stamps, in seconds from the epoch [ns] on."""
    name, kind, columns = key
    order = np.argsort(timed.ns, kind="stable")
    table = np.frombuffer(numbers).reshape(-1, len(columns))[timed.kept][order]
    t = np.asarray((timed.ns[order] - epoch) * 1e-9, dtype=np.float64)
    values = dict(zip(columns, np.ascontiguousarray(table.T), strict=True))
    quaternion = [values.pop(name) for name in _QUATERNION if name in values]
    if quaternion:
        # one of zeros, a field that nobody filled, has no yaw
        values["yaw"] = quat_wxyz_to_yaw(np.column_stack(quaternion))
        values = {name: values[name] for name in (*POSE_COLUMNS, *values)}
    return Topic(name, kind, t, values, timed.remark, fault=timed.fault)


# ------------------------------------------------------------------------------------------ groups
def _role_group(path: Path, role: str, topic: Topic, is_pose: bool, limits: LogLimits) -> Group:
    """Return a topic as the group of its role, the first sample of each stamp.

    Odometry that is the log's pose has that in the pose's group, other odometry in its own. A
    FileError says what cannot be used.
    """
    first = np.concatenate([[True], np.diff(topic.t) > 0.0])
    t = topic.t[first]
    columns = {name: values[first] for name, values in (topic.columns or {}).items()}
    if len(t) < 2:
        raise FileError(path, f"topic {topic.name} has fewer than two samples")
    with np.errstate(all="ignore"):  # numbers that are not finite then are refused below
        converted = _converted(role, columns)
    if role == "pose" or (role == "odom" and not is_pose and ROLES["pose"].fits(topic)):
        prefix = "" if role == "pose" else "odom_"
        for name in ("x", "y"):
            converted[prefix + name] = columns[name]
        converted[f"{prefix}yaw"] = np.unwrap(columns["yaw"])
    group = Group(topic.name, t, converted)
    check_group(path, group, limits)
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


def read_bag(path: Path, options: ReadOptions, radius: float | None = None) -> Log:
    """Read a bag.

    Raises:
        FileError: there is no such bag, it is damaged, empty or beyond the limits, or a topic
            cannot be used.
    """
    topics, clock = read_topics(path, options)
    longest = max((topic.t for topic in topics if topic.columns), key=len, default=np.empty(0))
    if len(longest) > 1 and longest[0] == longest[-1]:
        raise FileError(path, "all messages have one and the same time, so nothing moves")
    finite = {topic.name: _finite(topic) for topic in topics}
    able = [topic for topic, _ in finite.values()]
    chosen, sentences = choose_topics(path, able, options.topics)
    remarks = [clock] if clock else []
    roles = dict[Topic, list[str]]()
    for role, topic in chosen.items():
        roles.setdefault(topic, []).append(role)
    for t in roles:
        remarks += [f"{t.name}: {t.remark}, so the times of writing count"] * bool(t.remark)
    remarks += [*sentences, *filter(None, [topic.unread for topic in topics])]
    if not chosen:
        there = ", ".join(f"{s.name} ({s.type})" for s in topics if s.columns is not None)
        found = there or "no topic of a type that can be read"
        raise FileError(
            path,
            f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {found}",
        )
    groups = dict[str, Group]()
    faults = []
    for topic, own in roles.items():
        _, remark = finite.get(topic.name, (topic, ""))
        remarks += [remark] * bool(remark)
        converted = topic
        if "odom" in own:
            converted, sentence = _in_the_body(topic)
            if sentence:
                faults.append(LogFault("frame", ("odom_v",), sentence))
        made, left_out = _groups_of(path, converted, own, options)
        remarks += left_out
        groups |= made
        if topic.fault:
            columns = chain(*(group.columns for group in made.values()))
            faults.append(LogFault("clock", tuple(columns), topic.fault))
    words = {topic.name: ", ".join(own) for topic, own in roles.items()}
    known = {topic.name for topic in topics}
    listed = [replace(topic, role=words.get(topic.name, "")) for topic in topics]
    listed += [replace(t, role=words[t.name]) for t in roles if t.name not in known]
    in_order = {role: groups[role] for role in chosen if role in groups}
    return Log(path, in_order, listed, remarks, options.limits, faults)


def _groups_of(
    path: Path, topic: Topic, roles: Sequence[str], options: ReadOptions
) -> tuple[dict[str, Group], list[str]]:
    """Return the groups of a topic by its roles, and a sentence on each that is left out.

    A battery that says nothing, say, is no reason to refuse a log.
    """
    groups = {}
    left_out = []
    for role in roles:
        try:
            groups[role] = _role_group(path, role, topic, "pose" in roles, options.limits)
        except FileError as fault:
            if role not in BESIDE_MOTION or role in options.topics:
                what = f"{fault.what}; topics {role}=none leaves it out"
                raise FileError(path, what) from fault
            left_out.append(f"{role} is left out: {fault.what}")
    return groups, left_out


def _finite(topic: Topic) -> tuple[Topic, str]:
    """Return a topic without samples that are no numbers, and a sentence if there were any.

    Where that leaves less than half, it stays as it is.
    """
    if not topic.columns:
        return topic, ""
    table = np.column_stack(list(topic.columns.values()))
    finite = np.all(np.isfinite(table), axis=1)
    lost = np.count_nonzero(~finite)
    if not 0 < 2 * lost < len(finite):
        return topic, ""
    columns = {name: values[finite] for name, values in topic.columns.items()}
    sentence = f"{topic.name}: {lost} samples have something that is no number, and are left out"
    return replace(topic, t=topic.t[finite], columns=columns), sentence


def _in_the_body(topic: Topic) -> tuple[Topic, str]:
    """Return odometry with the speed along the body, and a sentence if it was the world's."""
    columns = topic.columns or {}
    if not {*POSE_COLUMNS, "v_y"} <= columns.keys():
        return topic, ""
    yaw = np.unwrap(columns["yaw"])
    speed = np.column_stack([columns["v"], columns["v_y"]])
    ends = np.searchsorted(topic.t, np.arange(topic.t[0], topic.t[-1], _SPAN_S))
    moved = np.diff(np.column_stack([columns["x"], columns["y"]])[ends], axis=0)
    as_body, as_world = (
        float(np.sum(np.abs(np.diff(integrate_rates(topic.t, velocity)[ends], axis=0) - moved)))
        for velocity in (rotate_body_to_world(speed, yaw), speed)
    )
    if np.ptp(yaw) < _TURNED or as_world > _MUCH_BETTER * as_body:
        return topic, ""
    along = rotate_world_to_body(speed, yaw)[:, 0]
    sentence = (
        f"the linear speed of {topic.name} is in the frame of its pose, not in that of the robot "
        "(child_frame_id): it was turned by yaw"
    )
    return replace(topic, columns={**columns, "v": along}), sentence
