"""The topic of each role: by its message type and name, and a pose by what it shows.

A bag may hold several poses: of motion capture, a filter, a controller's odometry, a goal. The one
that is taken moves as the wheels say, does not follow from them, and comes from the most
independent source. Transforms between frames are chained to such poses.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ssmr.geometry import compose_poses
from ssmr.types import MOTOR_COLUMNS, TORQUES, FloatArray
from validation.files.columns import BESIDE_MOTION, POSE_COLUMNS, WHEEL_SIDES, side_of, trust_in
from validation.files.log import Group, Log, Topic
from validation.files.messages import TRANSFORM
from validation.files.motion import ENCODERS
from validation.files.plain_faults import circular
from validation.files.reading import FileError, quoted
from validation.files.sensors import Signals

_GOALS = re.compile(r"goal|target|waypoint|initial_?pose|set_?pose|desired|set_?point|_ref\b|plan")
"""Parts of the names of poses where nobody is."""
_MOVED_M = 0.3
"""Extent of the poses of a robot that moves [m]."""
_STILL = 0.05
"""Range of the rates of wheels or odometry [rad/s, m/s] below which they tell no motion."""
_ALIKE = 0.5
"""Correlation of the motions that two topics of one robot tell [1]."""
_ODOMETRY = {"odom_v": "v", "odom_w": "w"}
"""Columns of odometry by our names, and there."""
_BASE = re.compile(r"(^|[/_])base(_link|_footprint|$)|(^|/)chassis")
_ROOT = re.compile(r"(^|/)(map|world|odom|earth|mocap)$")
"""Names of the frames of a robot, and of those in which it moves."""


_EFFORT = ".effort"
"""End of the names of joints' torques."""


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
        "wheels": Role(ENCODERS, ("sensor_msgs/msg/JointState",)),
        "imu": Role(("gyro_x", "gyro_y", "gyro_z"), ("sensor_msgs/msg/Imu",), ("imu/data",)),
        "pose": Role(POSE_COLUMNS, ("geometry_msgs/msg/PoseStamped",)),
        "gps": Role(("latitude", "longitude"), ("sensor_msgs/msg/NavSatFix",)),
        **{
            group: Role(tuple(channels), tuple({column.message for column in channels.values()}))
            for group, channels in BESIDE_MOTION.items()
        },
    }
)
"""Roles that topics can have, in the order of their groups."""


def choose_topics(
    path: Path, topics: Sequence[Topic], named: Mapping[str, str]
) -> tuple[dict[str, Topic], list[str]]:
    """Return the topic of each role, as named or else guessed, and a sentence on the pose.

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
        if role in named:
            if named[role] != "none":
                chosen[role] = _named_topic(path, topics, named[role], role)
        elif role != "pose":
            guess = _guess(topics, needs)
            if guess is not None:
                chosen[role] = guess
    if "pose" in named:
        return chosen, []
    pose, sentences = _best_pose([*topics, *_chained(topics)], chosen)
    pose = pose or chosen.get("odom")
    if pose is not None and ROLES["pose"].fits(pose):
        chosen["pose"] = pose
    return {role: chosen[role] for role in ROLES if role in chosen}, sentences


def _named_topic(path: Path, topics: Sequence[Topic], name: str, role: str) -> Topic:
    """Return the topic of that name; a FileError says why it cannot have the role."""
    needs = ROLES[role]
    there = [topic for topic in (*topics, *_chained(topics, name)) if topic.name == name]
    topic = min(there, key=lambda topic: not needs.fits(topic), default=None)
    if topic is None:
        names = ", ".join(topic.name for topic in topics if topic.columns is not None)
        names = names or "none that can be read"
        raise FileError(path, f"there is no topic {name}; there are: {names}")
    if topic.columns is None:
        raise FileError(
            path, f"nothing can be read from topic {name}: {len(topic.t)} messages of {topic.type}"
        )
    if not needs.fits(topic):
        raise FileError(
            path,
            f"topic {name} of {topic.type} cannot be {role}: "
            f"wanted {' or '.join(needs.columns)}, as of {needs.types[0]}",
        )
    return topic


def _guess(topics: Sequence[Topic], role: Role) -> Topic | None:
    """Return the topic of a role by its message type; None where there is none.

    It has at least two samples, and is no ground truth. Among several, one with a preferred part in
    its name goes first, then a type that the role lists earlier, then the one with more samples,
    then the alphabet.
    """

    def rank(topic: Topic) -> tuple[bool, int, int, str]:
        preferred = any(part in topic.name for part in role.preferred)
        return not preferred, role.types.index(topic.type), -len(topic.t), topic.name

    able = [t for t in topics if t.type in role.types and role.fits(t) and len(t.t) > 1]
    return min((t for t in able if trust_in(t.name) > 0), key=rank, default=None)


# ------------------------------------------------------------------------------------------ poses
def _best_pose(
    topics: Sequence[Topic], chosen: Mapping[str, Topic]
) -> tuple[Topic | None, list[str]]:
    """Return the topic that tells best where the robot was, and a sentence on the others."""
    poses = [t for t in topics if ROLES["pose"].fits(t) and len(t.t) > 1 and t.name != "/tf"]
    poses = [t for t in poses if not t.name.startswith(TRANSFORM) or _is_robot(t.name)]
    extents = [_extent(topic) for topic in poses]
    moves = max(extents, default=0.0) > _MOVED_M
    judged = []
    for topic, extent in zip(poses, extents, strict=True):
        trust = float(trust_in(topic.name))
        against = ""
        if _GOALS.search(topic.name.lower()):
            against = "is a goal by its name"
        elif extent < _MOVED_M and (moves or topic.type in ROLES["odom"].types):
            against = "stands still"
        elif max(_signals_of_poses(topic, chosen).likeness(), default=1.0) < _ALIKE:
            against = "tells another motion than the wheels"
        elif "wheels" in chosen and any(circular(_signals_of_poses(topic, chosen))):
            against = "follows from the wheels alone"
            trust += 5.0
        # what lies between transforms is odometry
        trust += 0.5 * topic.name.startswith(TRANSFORM)
        left_out = bool(against) and trust < 5.0
        judged.append((left_out, trust, -len(topic.t), topic.name, against))
    order = sorted(range(len(poses)), key=judged.__getitem__)
    if not order or judged[order[0]][0]:
        return None, []
    best = poses[order[0]]
    others = []
    for k in order[1:]:
        if not poses[k].name.startswith(TRANSFORM):
            others.append(f"{poses[k].name} {judged[k][4] or 'is less independent of the wheels'}")
    if not others:
        return best, []
    return best, [f"the pose is that of {best.name}: {', '.join(others)}"]


def _extent(topic: Topic) -> float:
    """Return how far apart a topic's poses lie [m]."""
    columns = topic.columns or {}
    spans = []
    for values in (columns["x"], columns["y"]):
        finite = values[np.isfinite(values)]
        spans.append(float(np.ptp(finite)) if len(finite) else 0.0)
    return max(spans)


def _signals_of_poses(poses: Topic, chosen: Mapping[str, Topic]) -> Signals:
    """Return what a topic of poses tells, and the wheels beside it, or else the odometry."""
    groups = {"pose": _named_group(poses, {name: name for name in POSE_COLUMNS})}
    for role, names in (
        ("wheels", dict(zip(ENCODERS, ENCODERS, strict=True))),
        ("odom", _ODOMETRY),
    ):
        topic = chosen.get(role)
        if len(groups) < 2 and topic is not None and topic is not poses:
            group = _named_group(topic, names)
            # what tells no motion at all is no witness
            if any(np.ptp(values) > _STILL for values in group.columns.values()):
                groups[role] = group
    return Signals(Log(Path(poses.name), groups))


def _named_group(topic: Topic, names: Mapping[str, str]) -> Group:
    """Return columns of a topic by our names."""
    columns = {}
    for ours, theirs in names.items():
        values = np.nan_to_num((topic.columns or {}).get(theirs, np.zeros(len(topic.t))))
        columns[ours] = np.unwrap(values) if ours == "yaw" else values
    return Group(topic.name, topic.t, columns)


# ------------------------------------------------------------------------------------- transforms
def _is_robot(name: str) -> bool:
    """Return whether a pair of frames is a robot in a frame in which it moves."""
    parent, _, child = name.removeprefix(TRANSFORM).partition(".")
    return bool(_ROOT.search(parent) and _BASE.search(child))


def _chained(topics: Sequence[Topic], named: str = "") -> Iterator[Topic]:
    """Yield poses of a robot, or of `named` frames, by one transform after another."""
    pairs = {}
    for topic in topics:
        if topic.name.startswith(TRANSFORM):
            parent, _, child = topic.name.removeprefix(TRANSFORM).partition(".")
            pairs[child] = (parent, topic)
    for child, (parent, topic) in pairs.items():
        whole = topic
        seen = {child}
        while parent in pairs and parent not in seen:
            seen.add(parent)
            parent, above = pairs[parent]
            whole = _composed(above, whole, f"{TRANSFORM}{parent}.{child}")
            if _is_robot(whole.name) or whole.name == named:
                yield whole


def _composed(above: Topic, below: Topic, name: str) -> Topic:
    """Return a transform after another, at the stamps of the one that changes more often."""
    often = max(above, below, key=lambda topic: len(topic.t))
    poses = []
    for topic in (above, below):
        assert topic.columns is not None
        x, y, yaw = (topic.columns[name] for name in POSE_COLUMNS)
        parts = [np.interp(often.t, topic.t, each) for each in (x, y, np.unwrap(yaw))]
        poses.append(np.column_stack(parts))
    columns = dict(zip(POSE_COLUMNS, compose_poses(*poses).T, strict=True))
    return replace(often, name=name, columns=columns, remark="", fault="")


# ------------------------------------------------------------------------------------------ wheels
def wheels_of(topic: Topic, named: Mapping[str, tuple[str, str]]) -> Topic:
    """Return joint states as the mean rate of the wheels of each side [rad/s], and their torque.

    The torque of a side is the sum of its wheels' efforts [N m], where these tell something.

    A joint's name says its side, or `named` does: `enc_left` and `enc_right`, each with the joints
    between plus signs. Casters and arms are left out. Without velocities, positions are
    differentiated. Where no joint has a side, the topic stays as it is, with a remark.
    """
    columns = topic.columns or {}
    moving = [name for name in columns if not name.endswith(_EFFORT)]
    joints = dict.fromkeys(name.rpartition(".")[0] for name in moving)
    sides = {}
    torques = {}
    names = zip(WHEEL_SIDES, ENCODERS, MOTOR_COLUMNS[TORQUES], strict=True)
    for side, column, torque in names:
        if column in named:
            members = named[column][0].split("+")
        else:
            members = [name for name in joints if side_of(name) == side]
            wheels = [name for name in members if "wheel" in name.lower()]
            members = wheels or members
        members = [name for name in members if name in joints]
        if members:
            sides[column] = np.mean([_rate(topic, name) for name in members], axis=0)
            torques[torque] = sum(columns.get(name + _EFFORT, math.nan) for name in members)
    if len(sides) == 2:
        # drivers that know none leave zeros or NaN
        if all(np.ptp(each) > 0.0 for each in torques.values()):
            sides |= torques
        return replace(topic, columns=sides)
    remark = (
        f"{topic.name}: no side shows in the names of the joints {quoted(joints)}; "
        "--columns enc_left=JOINT+JOINT,enc_right=JOINT+JOINT says which wheels are where"
    )
    return replace(topic, columns=columns, unread=remark)


def _rate(topic: Topic, joint: str) -> FloatArray:
    """Return the (M,) rates of a joint [rad/s]: its velocities, or else slopes of its positions."""
    columns = topic.columns or {}
    velocity = columns.get(f"{joint}.velocity")
    position = columns.get(f"{joint}.position")
    tells = velocity is not None and bool(np.any(np.nan_to_num(velocity)))
    if velocity is not None and (tells or position is None):
        return velocity
    assert position is not None
    if np.ptp(position) <= 2.0 * np.pi:
        position = np.unwrap(position)
    return rates_of_positions(topic.t, position)


def rates_of_positions(t: FloatArray, position: FloatArray) -> FloatArray:
    """Return the (M,) rates of (M,) positions: slopes from the sample before to the one after."""
    way, times = np.pad([position, t], [(0, 0), (1, 1)], mode="edge")
    return (way[2:] - way[:-2]) / np.maximum(times[2:] - times[:-2], 1e-9)
