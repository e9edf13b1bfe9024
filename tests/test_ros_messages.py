"""Fields, units and conventions of messages, and what is refused of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.geometry import wrap_angle
from tests.conftest import ROUNDOFF
from tests.ros_fakes import message, odometry, twist
from validation.ros import messages as msg

NUMBERS = st.floats(-1e3, 1e3)
RATES = st.floats(-msg.MOST_RATE, msg.MOST_RATE)
COVARIANCE = np.array([[0.3, 0.1, 0.02], [0.1, 0.4, 0.03], [0.02, 0.03, 0.5]])


@given(NUMBERS, NUMBERS, st.floats(-20.0, 20.0), RATES, RATES, st.integers(0, 10**10))
def test_odometry_there_and_back(
    x: float, y: float, yaw: float, v: float, w: float, nanoseconds: int
) -> None:
    at = np.array([x, y, yaw])
    came = message(
        msg.odometry_message(1e-9 * nanoseconds, at, (v, w), COVARIANCE, 2.0 * COVARIANCE)
    )
    stamp, seen, *frames = msg.read_odometry(came)
    assert (seen.x, seen.y, seen.v, seen.w) == (x, y, v, w)
    assert abs(float(wrap_angle(seen.yaw - yaw))) < 100 * ROUNDOFF
    assert came.header.stamp.sec * 10**9 + came.header.stamp.nanosec == nanoseconds
    assert stamp == pytest.approx(1e-9 * nanoseconds, rel=ROUNDOFF)
    assert frames == ["odom", "base_link"]
    assert came.pose.covariance == msg._covariance_36(COVARIANCE)
    assert came.twist.covariance == msg._covariance_36(2.0 * COVARIANCE)


def test_a_covariance_stands_where_ros_reads_it() -> None:
    full = np.reshape(msg._covariance_36(COVARIANCE), (6, 6))
    np.testing.assert_array_equal(full[np.ix_([0, 1, 5], [0, 1, 5])], COVARIANCE)
    assert np.linalg.eigvalsh(full).min() > 0.0, "the plane's own certainty leaves it invertible"


def test_an_orientation_is_normalised_and_a_pose_has_no_speeds() -> None:
    came = message(msg.pose_message(1.5, "world", np.array([1.0, 2.0, 0.0])))
    # a quarter turn to the left, unnormalised
    came.pose.orientation.z = came.pose.orientation.w = 0.1
    stamp, seen, frame = msg.read_pose(came)
    assert frame == "world"
    assert (stamp, seen.x, seen.y, seen.yaw) == pytest.approx((1.5, 1.0, 2.0, math.pi / 2))
    assert math.isnan(seen.v)
    assert math.isnan(seen.w)
    localised = message(
        {"header": vars(came.header), "pose": {"pose": 0, "covariance": [0.0] * 36}}
    )
    localised.pose.pose = came.pose
    assert msg.read_pose(localised)[1][:3] == seen[:3]


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("pose.orientation.w", 0.0, "no quaternion"),
        ("pose.orientation.w", math.nan, r"orientation\.w is nan; plausible"),
        ("pose.position.x", math.inf, r"position\.x is inf; plausible"),
        ("pose.position.y", 1e7, r"position\.y is 1e\+07; plausible is -1e\+06 to 1e\+06"),
        ("pose.position.x", "far", r"position\.x is no number"),
        *[
            (f"header.stamp.{name}", n, r"header\.stamp")
            for name, n in (("sec", -1), ("nanosec", -1), ("sec", 10**12))
        ],
        ("header.stamp.nanosec", 10**400, r"header\.stamp"),
    ],
)
def test_what_cannot_be_is_refused_by_the_name_of_its_field(
    field: str, value: Any, why: str
) -> None:
    came = message(msg.pose_message(0.0, "world", np.zeros(3)))
    put(came, field, value)
    with pytest.raises(ValueError, match=why):
        msg.read_pose(came)


ANYTHING = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from([10**400, None, "1.0", "x", b"", 1e300, -1e300, 5e-324, True, [], {}]),
)
"""What a field of a damaged message may hold."""
READERS: tuple[tuple[Any, Callable[[Any], Any]], ...] = (
    (odometry(1.0), msg.read_odometry),
    (message(msg.pose_message(1.0, "world", np.zeros(3))), msg.read_pose),
    (twist(0.1, 0.2), msg.read_twist),
)


def put(came: Any, path: str, value: Any) -> None:
    """Put a value into a field."""
    *way, last = path.split(".")
    for name in way:
        came = getattr(came, name)
    setattr(came, last, value)


def numeric_fields(came: Any, path: str = "") -> Iterator[str]:
    """Paths of all numbers in a message."""
    for name, value in vars(came).items():
        if isinstance(value, float | int):
            yield f"{path}{name}"
        elif hasattr(value, "__dict__"):
            yield from numeric_fields(value, f"{path}{name}.")


@given(st.data())
def test_whatever_a_field_holds_a_message_is_read_as_plausible_numbers_or_refused(
    data: st.DataObject,
) -> None:
    """The law of the entrance: a `ValueError` of one line, or finite numbers within limits."""
    whole, read = data.draw(st.sampled_from(READERS))
    came = message(as_fields(whole))
    for path in data.draw(
        st.lists(st.sampled_from(sorted(numeric_fields(came))), min_size=1, max_size=3)
    ):
        put(came, path, data.draw(ANYTHING))
    measured = None
    why = ""
    try:
        measured = read(came)
    except ValueError as error:
        why = str(error)
    assert why.isprintable()
    if measured is None:
        return
    numbers = np.concatenate(
        [np.ravel(np.array(p, dtype=np.float64)) for p in measured if not isinstance(p, str)]
    )
    # speeds are not known there
    known = numbers[~np.isnan(numbers)] if read is msg.read_pose else numbers
    assert np.all(np.abs(known) <= 2.0**32)


def as_fields(came: Any) -> Any:
    """The fields of a message, copied."""
    return (
        {name: as_fields(value) for name, value in vars(came).items()}
        if hasattr(came, "__dict__")
        else came
    )
