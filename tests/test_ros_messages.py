"""Fields, units and conventions of messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.geometry import wrap_angle
from tests.conftest import ROUNDOFF
from tests.ros_fakes import make
from validation.ros import messages as msg

NUMBERS = st.floats(-1e3, 1e3)
RATES = st.floats(-msg.MOST_RATE, msg.MOST_RATE)
COVARIANCE = np.array([[0.3, 0.1, 0.02], [0.1, 0.4, 0.03], [0.02, 0.03, 0.5]])


@given(NUMBERS, NUMBERS, st.floats(-20.0, 20.0), RATES, RATES, st.integers(0, 10**10))
def test_odometry_there_and_back(x: float, y: float, yaw: float, v: float, w: float, nanoseconds: int) -> None:
    message = make("nav_msgs/Odometry")
    msg.fill_odometry(message, 1e-9 * nanoseconds, np.array([x, y, yaw]), (v, w), COVARIANCE, 2.0 * COVARIANCE)
    seen = msg.read_odometry(message)
    assert (seen.x, seen.y, seen.v, seen.w) == (x, y, v, w)
    assert abs(float(wrap_angle(seen.yaw - yaw))) < 100 * ROUNDOFF
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == nanoseconds
    assert seen.stamp == pytest.approx(1e-9 * nanoseconds, rel=ROUNDOFF)
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    np.testing.assert_array_equal(msg.planar_covariance(message.pose.covariance), COVARIANCE)
    np.testing.assert_array_equal(msg.planar_covariance(message.twist.covariance), 2.0 * COVARIANCE)


def test_a_covariance_stands_where_ros_reads_it() -> None:
    full = np.reshape(msg.covariance_36(COVARIANCE), (6, 6))
    assert full[0, 5] == full[5, 0] == COVARIANCE[0, 2]
    assert full[1, 5] == COVARIANCE[1, 2]
    assert full[5, 5] == COVARIANCE[2, 2]
    assert np.linalg.eigvalsh(full).min() > 0.0, "the plane's own certainty leaves it invertible"


@pytest.mark.parametrize("bad", [[0.0] * 35, [math.nan] * 36, [-1.0, *[0.0] * 35]])
def test_covariances_that_cannot_be_are_refused(bad: list[float]) -> None:
    with pytest.raises(ValueError, match=r"has 35 numbers|covariance\[0\] is nan|negative"):
        msg.planar_covariance(bad)


def test_an_orientation_is_normalised_or_refused() -> None:
    message = make("geometry_msgs/PoseStamped")
    with pytest.raises(ValueError, match="no quaternion"):
        msg.read_pose_stamped(message)
    message.pose.orientation.z = message.pose.orientation.w = 0.1  # a quarter turn to the left, unnormalised
    assert msg.read_pose_stamped(message).yaw == pytest.approx(math.pi / 2)
    message.pose.orientation.w = math.nan
    with pytest.raises(ValueError, match=r"orientation\.w is nan, which is not finite"):
        msg.read_pose_stamped(message)
    message.pose.orientation.w, message.pose.position.x = 1.0, math.inf
    with pytest.raises(ValueError, match=r"position\.x is inf, which is not finite"):
        msg.read_pose_stamped(message)


def test_a_tracked_pose_says_nothing_of_speeds() -> None:
    message = make("geometry_msgs/PoseStamped")
    msg.fill_pose_stamped(message, 1.5, "world", np.array([1.0, 2.0, -3.0]))
    seen = msg.read_pose_stamped(message)
    assert math.isnan(seen.v)
    assert math.isnan(seen.w)
    assert (seen.stamp, seen.x, seen.y) == (1.5, 1.0, 2.0)
    assert seen.yaw == pytest.approx(-3.0)


def test_an_imu_says_that_it_has_no_orientation() -> None:
    message = make("sensor_msgs/Imu")
    msg.fill_imu(message, 2.0, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 9.81]), (1e-4, 1e-2))
    assert message.orientation_covariance[0] == -1.0
    assert message.angular_velocity_covariance == [1e-4, 0, 0, 0, 1e-4, 0, 0, 0, 1e-4]
    assert (message.angular_velocity.z, message.linear_acceleration.z) == (0.3, 9.81)
    assert message.header.frame_id == "imu_link"


def test_a_twist_is_speed_forward_and_yaw_rate() -> None:
    message = make("geometry_msgs/Twist")
    msg.fill_twist(message, 0.3, -0.4)
    assert (message.linear.x, message.angular.z) == (0.3, -0.4)
    assert msg.read_twist(message) == (0.3, -0.4)


def test_a_transform_is_the_childs_pose_in_its_parent() -> None:
    message = make("geometry_msgs/TransformStamped")
    msg.fill_transform(message, 0.25, ("odom", "base_link"), (1.0, 2.0, 0.0), math.pi)
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert message.transform.rotation.z == pytest.approx(1.0)
    assert message.header.stamp.nanosec == 250_000_000


ANYTHING = st.one_of(
    st.floats(), st.integers(), st.sampled_from([10**400, None, "1.0", "x", b"", 1e300, -1e300, 5e-324, True, [], {}])
)
"""What a field of a damaged message may hold."""


def attempt(read: Callable[[Any], Any], message: Any) -> tuple[Any, str]:
    """What is read from a message, or None and the reason why it is refused."""
    try:
        return read(message), ""
    except ValueError as error:
        return None, str(error)


def every_number(message: Any, path: str = "") -> list[str]:
    """Paths of all numbers in a message."""
    found = []
    for name, value in vars(message).items():
        if isinstance(value, float | int) and not isinstance(value, bool):
            found.append(f"{path}{name}")
        elif hasattr(value, "__dict__"):
            found += every_number(value, f"{path}{name}.")
    return found


READERS = (
    ("nav_msgs/Odometry", msg.read_odometry),
    ("geometry_msgs/PoseStamped", msg.read_pose_stamped),
    ("geometry_msgs/PoseWithCovarianceStamped", msg.read_set_pose),
)


@given(st.data())
def test_whatever_a_field_holds_a_message_is_read_as_plausible_numbers_or_refused(data: st.DataObject) -> None:
    """The law of the entrance: a `ValueError` of one line, or nothing but finite numbers within the limits."""
    kind, read = data.draw(st.sampled_from(READERS))
    message = make(kind)
    for at in (message.pose, getattr(message.pose, "pose", None)):
        if hasattr(at, "orientation"):
            at.orientation.w = 1.0
    for path in data.draw(st.lists(st.sampled_from(every_number(message)), min_size=1, max_size=3)):
        *way, last = path.split(".")
        place = message
        for name in way:
            place = getattr(place, name)
        setattr(place, last, data.draw(ANYTHING))
    found, why = attempt(read, message)
    assert why.isprintable()
    if found is None:
        return
    numbers = np.concatenate([np.ravel(part) for part in found]) if kind.endswith("CovarianceStamped") else np.array(found)
    known = numbers[~np.isnan(numbers)] if kind == "geometry_msgs/PoseStamped" else numbers  # speeds are not known there
    assert np.all(np.abs(known) <= 2.0**32)


@given(ANYTHING, ANYTHING)
def test_a_command_is_plausible_or_refused(v: Any, w: Any) -> None:
    message = make("geometry_msgs/Twist")
    message.linear.x, message.angular.z = v, w
    found, why = attempt(msg.read_twist, message)
    assert why.startswith(("linear.x is", "angular.z is")) if found is None else max(map(abs, found)) <= msg.MOST_RATE


@pytest.mark.parametrize("frame", ["map", "m\x1b[31map\x07", "\n" * 5 + "x" * 10_000, "\ud800", "\u202eodom"])
def test_a_foreign_frame_is_named_in_a_short_line_without_control_characters(frame: str) -> None:
    message = make("geometry_msgs/PoseWithCovarianceStamped")
    message.header.frame_id = frame
    with pytest.raises(ValueError, match="it must be 'odom'") as refused:
        msg.read_set_pose(message)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 100


@pytest.mark.parametrize(("seconds", "nanoseconds"), [(-1, 0), (0, -1), (10**12, 0), (0, 10**400)])
def test_a_time_that_no_stamp_can_hold_is_refused(seconds: int, nanoseconds: int) -> None:
    message = make("geometry_msgs/PoseStamped")
    message.pose.orientation.w = 1.0
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    with pytest.raises(ValueError, match=r"header\.stamp"):
        msg.read_pose_stamped(message)
