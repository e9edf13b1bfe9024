"""Group laws of planar poses, and each convention's round trip."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ssmr.geometry import (
    compose_poses,
    integrate_rates,
    invert_pose,
    quat_wxyz_to_xyzw,
    quat_wxyz_to_yaw,
    relative_pose,
    rotate_body_to_world,
    rotate_world_to_body,
    shift_reference,
    wrap_angle,
    yaw_to_quat_wxyz,
)

angles = st.floats(-50.0, 50.0)
poses = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), angles).map(np.array)
NEAR = 1e-12 * 100  # twenty metres, tens of operations


@given(angle=angles)
def test_wrapping_keeps_the_direction_and_lands_in_the_half_open_interval(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert abs(np.exp(1j * wrapped) - np.exp(1j * angle)) < 1e-12


def test_half_a_turn_is_plus_pi() -> None:
    assert wrap_angle(np.pi) == np.pi
    assert wrap_angle(-np.pi) == np.pi


@given(a=poses, b=poses, c=poses)
def test_composition_is_associative(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    assert np.allclose(
        compose_poses(compose_poses(a, b), c), compose_poses(a, compose_poses(b, c)), atol=NEAR
    )


@given(a=poses, b=poses)
def test_inverse_and_relative_pose(a: np.ndarray, b: np.ndarray) -> None:
    assert np.allclose(compose_poses(a, invert_pose(a)), 0.0, atol=NEAR)
    assert np.allclose(compose_poses(a, relative_pose(a, b)), b, atol=NEAR)


@given(a=poses, x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0))
def test_shifting_the_reference_is_composition_with_a_pure_offset(
    a: np.ndarray, x: float, y: float
) -> None:
    assert np.allclose(
        shift_reference(a, (x, y)), compose_poses(a, np.array([x, y, 0.0])), atol=NEAR
    )


def test_body_x_points_where_yaw_says() -> None:
    assert np.allclose(rotate_body_to_world([1.0, 0.0], np.pi / 2), [0.0, 1.0])
    # left of north is west
    assert np.allclose(rotate_body_to_world([0.0, 1.0], np.pi / 2), [-1.0, 0.0])
    assert np.allclose(
        rotate_world_to_body(rotate_body_to_world([0.3, -2.0], 1.1), 1.1), [0.3, -2.0]
    )


@given(yaw=st.floats(-3.1, 3.1))
def test_yaw_and_quaternion_agree_with_mujoco(yaw: float) -> None:
    quat = yaw_to_quat_wxyz(yaw)
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    assert np.allclose(matrix.reshape(3, 3)[:2, 0], [np.cos(yaw), np.sin(yaw)], atol=1e-12)
    assert abs(float(quat_wxyz_to_yaw(quat)) - yaw) < 1e-12


def test_the_order_of_a_quaternion_is_in_its_name() -> None:
    assert np.array_equal(quat_wxyz_to_xyzw([1.0, 2.0, 3.0, 4.0]), [2.0, 3.0, 4.0, 1.0])


def test_the_integral_of_straight_rates_is_exact() -> None:
    t = np.linspace(2.0, 5.0, 301) ** 1.1
    measured = integrate_rates(t, np.column_stack([2.0 * t, np.full(len(t), -3.0)]))
    assert np.abs(measured - np.column_stack([t**2 - t[0] ** 2, -3.0 * (t - t[0])])).max() <= 1e-10


@given(
    quat=st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    length=st.floats(1e-300, 1e300) | st.floats(0.1, 10.0),
)
def test_scaling_a_quaternion_turns_nothing(
    quat: tuple[float, float, float, float], length: float
) -> None:
    """Many drivers do not normalise; the heading is that of the rotated x axis."""
    unit = np.array(quat) / np.linalg.norm(quat)
    w, x, y, z = unit
    ahead = np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)])
    assume(np.hypot(*ahead) > 1e-3)  # else it points up, and has no heading
    yaw = float(quat_wxyz_to_yaw(length * unit))
    turned = np.array([np.cos(yaw), np.sin(yaw)])
    assert turned @ ahead / np.hypot(*ahead) == pytest.approx(1.0, abs=1e-12)


def test_a_quaternion_without_length_has_no_heading() -> None:
    quats = [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0], [np.inf, 0.0, 0.0, 1.0]]
    assert np.all(np.isnan(quat_wxyz_to_yaw(quats)))
