"""Conversion between ROS messages and numbers: the only module that knows the fields and units of live messages.

Frames follow REP 103 and 105: x forward, y left, z up; poses in `odom`, twists in `base_link`. Covariances are 6 x 6 by rows
in the order x, y, z, roll, pitch, yaw. Messages are filled and read by their fields alone, so their classes may be those of
ROS or of a test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ssmr.geometry import quat_wxyz_to_xyzw, quat_wxyz_to_yaw, yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.words import shortened

ODOM, BASE, IMU, WORLD = "odom", "base_link", "imu_link", "world"
"""Frames of dead reckoning, of the robot, of its IMU and of the tracking system."""
_FLAT_VARIANCE = 1e-6
"""Variance of z, roll and pitch of a robot on a plane [m2, rad2 and per s2]; small, but it keeps a covariance invertible."""

MOST_DISTANCE = 1e6
"""Greatest plausible coordinate in a message [m]; doubles keep 0.1 nm there."""
MOST_RATE = 100.0
"""Greatest plausible speed [m/s] and yaw rate [rad/s] in a message; no robot of this kind comes near them."""
MOST_VARIANCE = MOST_DISTANCE**2
"""Greatest plausible variance in a message [m2, rad2]; some senders write 1e9 for an unknown value."""
_MOST_STAMP = 2.0**32
"""End of the times that a stamp of ROS can hold [s]."""
_QUATERNION = (1e-6, 1e3)
"""Least and greatest length of a quaternion that is normalised here."""

_PLANAR = (0, 1, 5)
_NANO = 1_000_000_000


def plausible(name: str, value: Any, most: float, least: float | None = None) -> float:
    """Return a number of a message: the one check of everything that comes in.

    Args:
        name: field of the message, for the error.
        value: what it holds.
        most: greatest plausible number.
        least: least one; `-most` if not given.

    Raises:
        ValueError: it is no number, not finite, or out of that range.
    """
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} is no number") from None
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number}, which is not finite")
    low = -most if least is None else least
    if not low <= number <= most:
        raise ValueError(f"{name} is {number:g}; plausible is {low:g} to {most:g}")
    return number


class Seen(NamedTuple):
    """Pose and speeds of a planar robot in one message."""

    stamp: float
    """Time of the measurement by the sender's clock [s]."""
    x: float
    """Position [m]."""
    y: float
    """Position [m]."""
    yaw: float
    """Heading in (-pi, pi] [rad]."""
    v: float
    """Forward speed [m/s]; NaN if the message has none."""
    w: float
    """Yaw rate [rad/s]; NaN if the message has none."""


def set_stamp(stamp: Any, seconds: float) -> None:
    """Write a time [s], not negative, into a message's stamp, to the nanosecond."""
    stamp.sec, stamp.nanosec = divmod(round(seconds * 1e9), _NANO)


def get_stamp(stamp: Any) -> float:
    """Return the time of a stamp [s].

    Raises:
        ValueError: it is negative, or later than a stamp of ROS can hold.
    """
    seconds, nano = (
        plausible(f"header.stamp.{name}", getattr(stamp, name), _MOST_STAMP, 0.0) for name in ("sec", "nanosec")
    )
    return seconds + 1e-9 * nano


def set_pose(pose: Any, x: float, y: float, yaw: float, z: float = 0.0) -> None:
    """Write a planar pose [m, rad] into a geometry_msgs/Pose."""
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    set_quaternion(pose.orientation, yaw_to_quat_wxyz(yaw))


def set_quaternion(orientation: Any, quat_wxyz: FloatArray) -> None:
    """Write a (4,) unit quaternion, w first, into a geometry_msgs/Quaternion."""
    orientation.x, orientation.y, orientation.z, orientation.w = map(float, quat_wxyz_to_xyzw(quat_wxyz))


def get_yaw(orientation: Any) -> float:
    """Return the heading of a geometry_msgs/Quaternion [rad]; it need not be normalised.

    Raises:
        ValueError: the quaternion is zero, not finite or too long.
    """
    least, most = _QUATERNION
    quat = np.array([plausible(f"orientation.{axis}", getattr(orientation, axis), most) for axis in "wxyz"])
    length = float(np.linalg.norm(quat))
    if not length > least:
        raise ValueError(f"orientation has length {length:g}: it is no quaternion")
    return float(quat_wxyz_to_yaw(quat / length))


def covariance_36(planar: FloatArray) -> list[float]:
    """Return a (3, 3) covariance of x, y, yaw, or of their rates, as the 36 numbers of ROS."""
    full = _FLAT_VARIANCE * np.eye(6)
    full[np.ix_(_PLANAR, _PLANAR)] = planar
    return [float(value) for value in full.ravel()]


def planar_covariance(covariance: Any) -> FloatArray:
    """Return the (3, 3) covariance of x, y, yaw from the 36 numbers of ROS.

    Raises:
        ValueError: not 36 plausible numbers, or a negative variance.
    """
    if len(covariance) != 36:
        raise ValueError(f"covariance has {len(covariance)} numbers; it must have 36")
    full = np.array([plausible(f"covariance[{k}]", c, MOST_VARIANCE) for k, c in enumerate(covariance)])
    part: FloatArray = full.reshape(6, 6)[np.ix_(_PLANAR, _PLANAR)]
    if np.any(np.diag(part) < 0.0):
        raise ValueError(f"variances of x, y and yaw must not be negative, got {np.diag(part).tolist()}")
    return part


def fill_odometry(
    message: Any, stamp: float, pose: FloatArray, twist: tuple[float, float], pose_cov: FloatArray, twist_cov: FloatArray
) -> None:
    """Fill a nav_msgs/Odometry.

    It takes the time [s], the base's (3,) pose in `odom` [m, m, rad], its v [m/s] and omega [rad/s], and the (3, 3)
    covariances of x, y, yaw and of v_x, v_y, omega.
    """
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id, message.child_frame_id = ODOM, BASE
    set_pose(message.pose.pose, *map(float, pose))
    message.pose.covariance = covariance_36(pose_cov)
    message.twist.twist.linear.x, message.twist.twist.angular.z = twist
    message.twist.covariance = covariance_36(twist_cov)


def fill_pose_stamped(message: Any, stamp: float, frame: str, pose: FloatArray) -> None:
    """Fill a geometry_msgs/PoseStamped with (3,) x, y [m], yaw [rad]."""
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = frame
    set_pose(message.pose, *map(float, pose))


def fill_imu(message: Any, stamp: float, rates: FloatArray, forces: FloatArray, variances: tuple[float, float]) -> None:
    """Fill a raw sensor_msgs/Imu as in REP 145: without orientation, with gravity.

    It takes the time [s], the (3,) angular velocity [rad/s], the (3,) specific force [m/s2], which is (0, 0, g) at rest, and
    the variances of each rate [rad2/s2] and of each force [m2/s4].
    """
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = IMU
    for field, values in ((message.angular_velocity, rates), (message.linear_acceleration, forces)):
        field.x, field.y, field.z = map(float, values)
    message.orientation_covariance = [-1.0, *[0.0] * 8]
    message.angular_velocity_covariance = [float(v) for v in (variances[0] * np.eye(3)).ravel()]
    message.linear_acceleration_covariance = [float(v) for v in (variances[1] * np.eye(3)).ravel()]


def fill_joints(message: Any, stamp: float, names: Sequence[str], angles: FloatArray, rates: FloatArray) -> None:
    """Fill a sensor_msgs/JointState with (N,) angles [rad] and rates [rad/s] of named joints; there are no efforts."""
    set_stamp(message.header.stamp, stamp)
    message.name, message.position, message.velocity = list(names), angles.tolist(), rates.tolist()


def fill_transform(message: Any, stamp: float, frames: tuple[str, str], at: tuple[float, float, float], yaw: float) -> None:
    """Fill a geometry_msgs/TransformStamped with a child's position [m] and heading [rad] in its parent.

    `frames` names the parent and the child; `stamp` is in seconds.
    """
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id, message.child_frame_id = frames
    move = message.transform.translation
    move.x, move.y, move.z = at
    set_quaternion(message.transform.rotation, yaw_to_quat_wxyz(yaw))


def fill_twist(message: Any, v: float, w: float) -> None:
    """Fill a geometry_msgs/Twist [m/s, rad/s]."""
    message.linear.x, message.angular.z = v, w


def read_twist(message: Any) -> tuple[float, float]:
    """Return v [m/s] and omega [rad/s] of a geometry_msgs/Twist.

    Raises:
        ValueError: one of them is not plausible.
    """
    return plausible("linear.x", message.linear.x, MOST_RATE), plausible("angular.z", message.angular.z, MOST_RATE)


def read_lock(message: Any) -> bool:
    """Return the value of a std_msgs/Bool."""
    return bool(message.data)


def read_set_pose(message: Any) -> tuple[FloatArray, FloatArray]:
    """Return the (3,) pose in `odom` [m, m, rad] and its (3, 3) covariance of a geometry_msgs/PoseWithCovarianceStamped.

    Raises:
        ValueError: another frame, a number that is not plausible, or no orientation.
    """
    frame = str(message.header.frame_id).lstrip("/")
    if frame not in ("", ODOM):
        raise ValueError(f"a pose in the frame '{shortened(frame, 40)}'; it must be '{ODOM}'")
    return np.array(_read_place(message.pose.pose)), planar_covariance(message.pose.covariance)


def read_odometry(message: Any) -> Seen:
    """Return pose and speeds of a nav_msgs/Odometry.

    Raises:
        ValueError: a number is not plausible, or there is no orientation.
    """
    return Seen(get_stamp(message.header.stamp), *_read_place(message.pose.pose), *read_twist(message.twist.twist))


def read_pose_stamped(message: Any) -> Seen:
    """Return the pose of a geometry_msgs/PoseStamped; it has no speeds.

    Raises:
        ValueError: a number is not plausible, or there is no orientation.
    """
    return Seen(get_stamp(message.header.stamp), *_read_place(message.pose), math.nan, math.nan)


def _read_place(pose: Any) -> tuple[float, float, float]:
    x, y = (plausible(f"position.{axis}", getattr(pose.position, axis), MOST_DISTANCE) for axis in "xy")
    return x, y, get_yaw(pose.orientation)
