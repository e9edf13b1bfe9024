"""Names, fields, frames and units of live ROS messages, which no other module knows.

Frames follow REP 103 and 105: x forward, y left, z up; poses in `odom`, twists in `base_link`.
Covariances are 6 x 6 by rows in the order x, y, z, roll, pitch, yaw. A message to be sent is a
mapping from its fields to values, in which a field that is left out is zero or empty. A message
that came is any object with the fields; whatever is read of it is checked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np

from ssmr.control.law import Observation
from ssmr.geometry import compose_poses, quat_wxyz_to_yaw, relative_pose, yaw_to_quat_wxyz
from ssmr.types import FloatArray

FILTERED_TOPIC = "/platform/odom/filtered"
"""Topic of the robot's state filter."""
STOP_TOPIC = "/platform/emergency_stop"
"""Topic of std_msgs/Bool that says whether the emergency stop is on."""
RESTART_TOPIC = "/platform/confirm_restart"
"""Topic of std_msgs/Bool on which somebody confirms that a held robot may go on."""
WHEELS_TOPIC = "/platform/odom"
"""Topic of the odometry by the wheels alone."""
IMU_TOPIC = "/sensors/imu_0/data"
"""Topic of the robot's IMU."""
STOPS_KEPT = 32
"""Messages of the emergency stop that wait for a loop: none that stops may be lost. Of others the
last one counts."""
# Frames of dead reckoning, of the robot, of its IMU and of the tracking system.
ODOM = "odom"
BASE = "base_link"
IMU = "imu_link"
WORLD = "world"
_MOST_DISTANCE = 1e6
"""Greatest plausible coordinate in a message [m]; doubles keep 0.1 nm there."""
MOST_RATE = 100.0
"""Greatest plausible speed [m/s] and yaw rate [rad/s] in a message; no robot of this kind comes
near them."""
_MOST_STAMP = 2.0**32
"""End of the times that a stamp of ROS can hold [s]."""
_LEAST_LENGTH = 1e-6
"""Least length of a quaternion that is normalised here."""
_MOST_COMPONENT = 1e3
"""Greatest size of a quaternion's numbers."""
_FLAT_VARIANCE = 1e-6
"""Variance of z, roll and pitch of a robot on a plane [m2, rad2 and per s2]; small, but it keeps a
covariance invertible."""
_MOST_FRAMES = 1000
"""Frames that are remembered: whoever reaches the graph can send any number."""
_LONGEST_NAME = 200
"""Most characters of a frame's name."""
_PLANAR = np.ix_((0, 1, 5), (0, 1, 5))
_NANO = 1_000_000_000

Fields = dict[str, Any]
"""Values of a message by its fields."""
Twist = tuple[float, float]
"""v [m/s] and omega [rad/s]."""
STAND_STILL: Twist = (0.0, 0.0)
Transform = tuple[str, str, FloatArray]
"""Frames of parent and child, and the child's (3,) pose there [m, m, rad]."""


def ros_name(robot: str) -> str:
    """A robot's name as names of ROS have it: letters, digits and underscores, a letter first."""
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in robot)
    if name[:1].isalpha():
        return name
    return f"robot_{name}"


def tracking_topic(robot: str) -> str:
    """Return the topic of a tracking system (vrpn_mocap) for the robot of a name."""
    return f"/vrpn_mocap/{ros_name(robot)}/pose"


def _stamp_fields(seconds: float) -> Fields:
    whole, rest = divmod(round(seconds * _NANO), _NANO)
    return {"sec": whole, "nanosec": rest}


def _header_fields(stamp: float, frame: str) -> Fields:
    return {"stamp": _stamp_fields(stamp), "frame_id": frame}


def _vector_fields(values: Sequence[float] | FloatArray, axes: str = "xyz") -> Fields:
    return dict(zip(axes, map(float, values), strict=True))


def _quaternion_fields(yaw: float) -> Fields:
    return _vector_fields(yaw_to_quat_wxyz(yaw), "wxyz")


def _pose_fields(pose: FloatArray) -> Fields:
    return {
        "position": _vector_fields((pose[0], pose[1], 0.0)),
        "orientation": _quaternion_fields(pose[2]),
    }


def _covariance_36(planar: FloatArray) -> list[float]:
    """Return a (3, 3) covariance of x, y, yaw, or of their rates, as the 36 numbers of ROS."""
    full = _FLAT_VARIANCE * np.eye(6)
    full[_PLANAR] = planar
    return [float(value) for value in full.ravel()]


def clock_message(stamp: float) -> Fields:
    """Return a rosgraph_msgs/Clock of a time [s], not negative, to the nanosecond."""
    return {"clock": _stamp_fields(stamp)}


def twist_message(v: float, w: float) -> Fields:
    """Return a geometry_msgs/Twist [m/s, rad/s]."""
    return {"linear": {"x": v}, "angular": {"z": w}}


def pose_message(stamp: float, frame: str, pose: FloatArray) -> Fields:
    """Return a geometry_msgs/PoseStamped of (3,) x, y [m], yaw [rad]."""
    return {"header": _header_fields(stamp, frame), "pose": _pose_fields(pose)}


def odometry_message(
    stamp: float,
    pose: FloatArray,
    twist: Twist,
    pose_covariance: FloatArray,
    twist_covariance: FloatArray,
) -> Fields:
    """Return a nav_msgs/Odometry.

    It takes the time [s], the base's (3,) pose in `odom` [m, m, rad], its v [m/s] and omega
    [rad/s], and the (3, 3) covariances of x, y, yaw and of v_x, v_y, omega.
    """
    return {
        "header": _header_fields(stamp, ODOM),
        "child_frame_id": BASE,
        "pose": {"pose": _pose_fields(pose), "covariance": _covariance_36(pose_covariance)},
        "twist": {"twist": twist_message(*twist), "covariance": _covariance_36(twist_covariance)},
    }


def imu_message(
    stamp: float, rates: FloatArray, forces: FloatArray, variances: tuple[float, float]
) -> Fields:
    """Return a raw sensor_msgs/Imu as in REP 145: without orientation, with gravity.

    It takes the time [s], the (3,) angular velocity [rad/s], the (3,) specific force [m/s2], which
    is (0, 0, g) at rest, and the variances of each rate [rad2/s2] and of each force [m2/s4].
    """
    of_rates, of_forces = variances
    return {
        "header": _header_fields(stamp, IMU),
        "orientation": _quaternion_fields(0.0),
        "orientation_covariance": [-1.0, *[0.0] * 8],
        "angular_velocity": _vector_fields(rates),
        "angular_velocity_covariance": (of_rates * np.eye(3)).ravel().tolist(),
        "linear_acceleration": _vector_fields(forces),
        "linear_acceleration_covariance": (of_forces * np.eye(3)).ravel().tolist(),
    }


def joint_message(
    stamp: float, names: Sequence[str], angles: FloatArray, rates: FloatArray
) -> Fields:
    """Return a sensor_msgs/JointState with (N,) angles [rad] and rates [rad/s] of named joints."""
    return {
        "header": _header_fields(stamp, ""),
        "name": list(names),
        "position": angles.tolist(),
        "velocity": rates.tolist(),
    }


def transform_message(
    stamp: float, frames: tuple[str, str], pose: FloatArray, z: float = 0.0
) -> Fields:
    """Return a tf2_msgs/TFMessage with one transform.

    It takes the time [s], the frames of parent and child, and the child's (3,) pose [m, m, rad] and
    height [m] there.
    """
    parent, child = frames
    transform = {
        "header": _header_fields(stamp, parent),
        "child_frame_id": child,
        "transform": {
            "translation": _vector_fields((pose[0], pose[1], z)),
            "rotation": _quaternion_fields(pose[2]),
        },
    }
    return {"transforms": [transform]}


def check_plausible(name: str, value: Any, most: float, least: float = -math.inf) -> float:
    """Return the number in a field of a message, checked; a ValueError says what is wrong."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} is no number") from None
    low = max(-most, least)
    if not low <= number <= most:
        raise ValueError(f"{name} is {number:g}; plausible is {low:g} to {most:g}")
    return number


def read_twist(message: Any) -> Twist:
    """Speed [m/s] and yaw rate [rad/s] of a geometry_msgs/Twist or TwistStamped.

    Raises:
        ValueError: they are not plausible.
    """
    twist = getattr(message, "twist", message)
    v = check_plausible("linear.x", twist.linear.x, MOST_RATE)
    w = check_plausible("angular.z", twist.angular.z, MOST_RATE)
    return v, w


def read_odometry(message: Any) -> tuple[float, Observation, str, str]:
    """Stamp [s], pose and speeds of a nav_msgs/Odometry, its frame and that of what moves.

    Raises:
        ValueError: they are not plausible.
    """
    stamp, twist = read_wheels(message)
    seen = Observation(*_read_pose(message.pose.pose), *twist)
    moves = _read_frame(message.child_frame_id)
    return stamp, seen, _read_frame(message.header.frame_id), moves


def read_wheels(message: Any) -> tuple[float, Twist]:
    """Stamp [s] and speeds of a nav_msgs/Odometry; a ValueError if they are not plausible."""
    return _read_stamp(message), read_twist(message.twist)


def read_gyro(message: Any) -> tuple[float, float]:
    """Stamp [s] and yaw rate [rad/s] of a sensor_msgs/Imu; a ValueError if not plausible."""
    w = check_plausible("angular_velocity.z", message.angular_velocity.z, MOST_RATE)
    return _read_stamp(message), w


def read_pose(message: Any) -> tuple[float, Observation, str]:
    """Stamp [s], pose and frame of a geometry_msgs/PoseStamped or PoseWithCovarianceStamped.

    The speeds are NaN.

    Raises:
        ValueError: they are not plausible.
    """
    pose = _read_pose(getattr(message.pose, "pose", message.pose))
    seen = Observation(*pose, math.nan, math.nan)
    return _read_stamp(message), seen, _read_frame(message.header.frame_id)


def read_path(message: Any) -> tuple[str, FloatArray]:
    """Frame and (N, 3) poses [m, m, rad] of a nav_msgs/Path, whose neighbours differ in place.

    Raises:
        ValueError: they are not plausible, or fewer than two.
    """
    poses = (_read_pose(stamped.pose) for stamped in message.poses)
    places = [next(same) for _, same in groupby(poses, key=lambda pose: pose[:2])]
    if len(places) < 2:
        raise ValueError("a path has at least two places")
    return _read_frame(message.header.frame_id), np.array(places)


def read_transforms(message: Any) -> list[Transform]:
    """Transforms of a tf2_msgs/TFMessage; a ValueError if one is not plausible."""
    transforms = []
    for each in message.transforms:
        pose = np.array(_read_place(each.transform.translation, each.transform.rotation))
        parent = _read_frame(each.header.frame_id)
        transforms.append((parent, _read_frame(each.child_frame_id), pose))
    return transforms


def _read_frame(name: Any) -> str:
    """Return a frame's name, without the stroke before it that ROS 1 had."""
    if not (isinstance(name, str) and name.isprintable() and len(name) <= _LONGEST_NAME):
        raise ValueError("a frame_id is no name")
    return name.removeprefix("/")


def _read_stamp(message: Any) -> float:
    stamp = message.header.stamp
    seconds = check_plausible("header.stamp.sec", stamp.sec, _MOST_STAMP, 0.0)
    nano = check_plausible("header.stamp.nanosec", stamp.nanosec, _MOST_STAMP, 0.0)
    return seconds + nano / _NANO


def _read_pose(pose: Any) -> tuple[float, float, float]:
    return _read_place(pose.position, pose.orientation)


def _read_place(position: Any, orientation: Any) -> tuple[float, float, float]:
    """Return x, y [m] and yaw [rad] of a place and a quaternion."""
    x = check_plausible("position.x", position.x, _MOST_DISTANCE)
    y = check_plausible("position.y", position.y, _MOST_DISTANCE)
    numbers = [(f"orientation.{axis}", getattr(orientation, axis)) for axis in "wxyz"]
    quat = np.array([check_plausible(name, value, _MOST_COMPONENT) for name, value in numbers])
    length = float(np.linalg.norm(quat))
    if not length > _LEAST_LENGTH:
        raise ValueError(f"orientation has length {length:g}: it is no quaternion")
    return x, y, float(quat_wxyz_to_yaw(quat))


class FrameTree:
    """Poses of frames in their parents, the newest of each."""

    def __init__(self) -> None:
        """Begin without a frame."""
        self._parents: dict[str, tuple[str, FloatArray]] = {}

    def take(self, transforms: list[Transform]) -> None:
        """Take poses (3,) of frames in their parents [m, m, rad]."""
        for parent, child, pose in transforms:
            if child in self._parents or len(self._parents) < _MOST_FRAMES:
                self._parents[child] = (parent, pose)

    def pose_in(self, target: str, frame: str) -> FloatArray:
        """Return the (3,) pose of a frame in another [m, m, rad].

        Raises:
            ValueError: nothing connects them; the message names the frames that are seen.
        """
        ours = self._poses_above(frame)
        for shared, pose in self._poses_above(target).items():
            if shared in ours:
                return relative_pose(pose, ours[shared])
        seen = sorted({frame, *self._parents, *dict(self._parents.values())})
        raise ValueError(
            f"nobody says where {frame} is in {target}; frames that are seen: {', '.join(seen)}"
        )

    def _poses_above(self, frame: str) -> dict[str, FloatArray]:
        """Return the poses of a frame in itself, in its parent, and so on."""
        poses = {frame: np.zeros(3)}
        # until there is no parent, or they go in a circle
        while (link := self._parents.get(frame)) and link[0] not in poses:
            poses[link[0]] = compose_poses(link[1], poses[frame])
            frame = link[0]
        return poses
