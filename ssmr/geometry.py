"""Angles, planar poses, paths and quaternions: the one place where conventions are written.

A pose is (x, y, yaw): it takes body coordinates to world coordinates by rotating through yaw
(Eq. 2.1) and adding (x, y). Quaternions are named for their order: `wxyz` is MuJoCo's, `xyzw` is
rerun's and ROS'.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray, State


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """Wrap angles [rad] into (-pi, pi]."""
    a = np.asarray(angle, dtype=np.float64)
    return np.pi - np.mod(np.pi - a, 2.0 * np.pi)


def rotate_body_to_world(vector: ArrayLike, yaw: ArrayLike) -> FloatArray:
    """Rotate (..., 2) body vectors by (...) yaw [rad] into the world (Eq. 2.1, 2.2)."""
    v = np.asarray(vector, dtype=np.float64)
    c = np.cos(yaw)
    s = np.sin(yaw)
    x = c * v[..., 0] - s * v[..., 1]
    y = s * v[..., 0] + c * v[..., 1]
    return np.stack([x, y], axis=-1)


def rotate_world_to_body(vector: ArrayLike, yaw: ArrayLike) -> FloatArray:
    """Rotate (..., 2) world vectors by (...) yaw [rad] into the body."""
    return rotate_body_to_world(vector, -np.asarray(yaw, dtype=np.float64))


def compose_poses(pose_a_to_w: ArrayLike, pose_b_to_a: ArrayLike) -> FloatArray:
    """Return the pose of b in w from the poses of a in w and of b in a, each (..., 3)."""
    a = np.asarray(pose_a_to_w, dtype=np.float64)
    b = np.asarray(pose_b_to_a, dtype=np.float64)
    b_xy = rotate_body_to_world(b[..., :2], a[..., 2])
    xy = a[..., :2] + b_xy
    yaw = a[..., 2:] + b[..., 2:]
    return np.concatenate([xy, yaw], axis=-1)


def invert_pose(pose_a_to_b: ArrayLike) -> FloatArray:
    """Return the inverse of (..., 3) poses: composed with the pose it gives zero."""
    a = np.asarray(pose_a_to_b, dtype=np.float64)
    xy = -rotate_world_to_body(a[..., :2], a[..., 2])
    return np.concatenate([xy, -a[..., 2:]], axis=-1)


def relative_pose(pose_a_to_w: ArrayLike, pose_b_to_w: ArrayLike) -> FloatArray:
    """Return the (..., 3) pose of b seen from a; the yaw difference is not wrapped."""
    return compose_poses(invert_pose(pose_a_to_w), pose_b_to_w)


def shift_reference(pose: ArrayLike, offset: ArrayLike) -> FloatArray:
    """Move the reference point of (..., 3) poses by `offset` (x, y) [m], fixed in the body."""
    p = np.asarray(pose, dtype=np.float64)
    xy = p[..., :2]
    shift = rotate_body_to_world(np.broadcast_to(offset, xy.shape), p[..., 2])
    return np.concatenate([xy + shift, p[..., 2:]], axis=-1)


def shift_state(state: State, offset: tuple[float, float]) -> State:
    """Return the state of the point at `offset` (x, y) [m] in the body, from the body's state."""
    x, y, yaw = shift_reference([state.x, state.y, state.yaw], offset)
    v_x = state.v_x - state.yaw_rate * offset[1]
    v_y = state.v_y + state.yaw_rate * offset[0]
    return replace(state, x=float(x), y=float(y), yaw=float(yaw), v_x=v_x, v_y=v_y)


def integrate_rates(t: ArrayLike, rate: ArrayLike) -> FloatArray:
    """Return the (M, ...) integral of (M, ...) rates over (M,) instants [s], by trapezoids."""
    r = np.asarray(rate, dtype=np.float64)
    dt = np.diff(t).reshape(-1, *(1,) * (r.ndim - 1))
    steps = 0.5 * (r[1:] + r[:-1]) * dt
    return np.cumulative_sum(steps, axis=0, include_initial=True)


def yaw_to_quat_wxyz(yaw: ArrayLike) -> FloatArray:
    """Return (..., 4) unit quaternions, w first, of rotations by (...) yaw [rad] about z."""
    half = 0.5 * np.asarray(yaw, dtype=np.float64)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def quat_wxyz_to_yaw(quat: ArrayLike) -> FloatArray:
    """Return the (...) heading in (-pi, pi] of (..., 4) quaternions, w first.

    It is the direction of the rotated x axis, whatever their lengths; NaN for a length of 0.
    """
    q = np.asarray(quat, dtype=np.float64)
    size = np.max(np.abs(q), axis=-1, keepdims=True)
    # so that no square is too large or too small
    w, x, y, z = np.moveaxis(q / np.where((size > 0.0) & (size < np.inf), size, np.nan), -1, 0)
    sine = 2.0 * (w * z + x * y)
    cosine = w * w + x * x - y * y - z * z
    return np.asarray(np.arctan2(sine, cosine))


def quat_wxyz_to_xyzw(quat: ArrayLike) -> FloatArray:
    """Move w from first to last in (..., 4) quaternions."""
    return np.roll(np.asarray(quat, dtype=np.float64), -1, axis=-1)
