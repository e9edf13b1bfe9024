"""Conversion between ROS messages and numbers: the only module that knows the fields and units of live messages.

Frames follow REP 103 and 105: x forward, y left, z up; poses in `odom`, twists in `base_link`. Covariances are 6 x 6 by rows
in the order x, y, z, roll, pitch, yaw. Messages are filled and read by their fields alone, so their classes may be those of
ROS or of a test.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ssmr.geometry import quat_wxyz_to_xyzw, quat_wxyz_to_yaw, yaw_to_quat_wxyz
from ssmr.types import FloatArray

ODOM, BASE, IMU, WORLD = "odom", "base_link", "imu_link", "world"
"""Frames of dead reckoning, of the robot, of its IMU and of the tracking system."""
_FLAT_VARIANCE = 1e-6
"""Variance of z, roll and pitch of a robot on a plane [m2, rad2 and per s2]; small, but it keeps a covariance invertible."""

_PLANAR = (0, 1, 5)
_NANO = 1_000_000_000


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
    stamp.secs, stamp.nsecs = divmod(round(seconds * 1e9), _NANO)


def get_stamp(stamp: Any) -> float:
    """Return the time of a stamp [s]."""
    return float(stamp.secs + 1e-9 * stamp.nsecs)


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
        ValueError: the quaternion is zero or not finite.
    """
    quat = np.array([orientation.w, orientation.x, orientation.y, orientation.z], dtype=np.float64)
    length = float(np.linalg.norm(quat)) if np.all(np.isfinite(quat)) else math.nan
    if not length > 1e-6:
        raise ValueError(f"the orientation {quat[1:].tolist() + quat[:1].tolist()} (x, y, z, w) is no quaternion")
    return float(quat_wxyz_to_yaw(quat / length))


def covariance_36(planar: FloatArray) -> list[float]:
    """Return a (3, 3) covariance of x, y, yaw, or of their rates, as the 36 numbers of ROS."""
    full = _FLAT_VARIANCE * np.eye(6)
    full[np.ix_(_PLANAR, _PLANAR)] = planar
    return [float(value) for value in full.ravel()]


def planar_covariance(covariance: Any) -> FloatArray:
    """Return the (3, 3) covariance of x, y, yaw from the 36 numbers of ROS.

    Raises:
        ValueError: not 36 finite numbers, or a negative variance.
    """
    full = np.array(covariance, dtype=np.float64)
    if full.shape != (36,) or not np.all(np.isfinite(full)):
        raise ValueError("a covariance must be 36 finite numbers")
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
    """Return v [m/s] and omega [rad/s] of a geometry_msgs/Twist."""
    return float(message.linear.x), float(message.angular.z)


def read_odometry(message: Any) -> Seen:
    """Return pose and speeds of a nav_msgs/Odometry.

    Raises:
        ValueError: a number is not finite, or there is no orientation.
    """
    twist = message.twist.twist
    return _finite(_read_pose(message, message.pose.pose)._replace(v=float(twist.linear.x), w=float(twist.angular.z)))


def read_pose_stamped(message: Any) -> Seen:
    """Return the pose of a geometry_msgs/PoseStamped; it has no speeds.

    Raises:
        ValueError: a number is not finite, or there is no orientation.
    """
    return _finite(_read_pose(message, message.pose)._replace(v=0.0, w=0.0))._replace(v=math.nan, w=math.nan)


def _read_pose(message: Any, pose: Any) -> Seen:
    at = pose.position
    return Seen(get_stamp(message.header.stamp), float(at.x), float(at.y), get_yaw(pose.orientation), math.nan, math.nan)


def _finite(seen: Seen) -> Seen:
    if not all(map(math.isfinite, seen)):
        raise ValueError(f"a number is not finite: {seen}")
    return seen
