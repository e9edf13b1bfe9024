"""Errors of poses: at equal times, and of the relative pose over windows of a horizon.

A candidate is the simulated motion, a reference the measured or wanted one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ssmr._jit import jit
from ssmr.geometry import relative, wrap_angle
from ssmr.types import FloatArray, IndexArray, frozen_array, increasing_times

TIME_TOLERANCE = 1e-9
"""Stamps closer than this are the same instant [s]: rounding of k * dt, far under any sampling period."""


@jit
def _wrapped(angle: float) -> float:
    """An angle [rad] less whole turns, within [-pi, pi]; the sign at half a turn does not matter to a size."""
    wrapped: float = angle - 2.0 * math.pi * np.rint(angle / (2.0 * math.pi))
    return wrapped


@jit
def sync_rms_kernel(
    candidate_t: FloatArray, candidate_pose: FloatArray, reference_t: FloatArray, reference_pose: FloatArray
) -> tuple[float, float, int]:
    """Return RMS errors at equal stamps, for use from other kernels: it never raises.

    Stamps [s] increase strictly; poses are (N, 3) and (M, 3) x [m], y [m], yaw [rad]. The candidate is interpolated
    linearly, yaw the short way round; the reference's stamps beyond its span are left out. A stamp that both have is
    compared as it is.

    Returns:
        Position RMS [m], yaw RMS [rad] (of wrapped differences), and the number of stamps they are taken over; with none of
        them, NaN and NaN.
    """
    last = candidate_t.shape[0] - 1
    position, heading, n, k = 0.0, 0.0, 0, 0
    for i in range(reference_t.shape[0]):
        t = reference_t[i]
        if not (last >= 0 and candidate_t[0] - TIME_TOLERANCE <= t <= candidate_t[last] + TIME_TOLERANCE):
            continue
        while k < last and candidate_t[k + 1] <= t:
            k += 1
        x, y, yaw = candidate_pose[k, 0], candidate_pose[k, 1], candidate_pose[k, 2]
        if k < last and t > candidate_t[k]:
            weight = (t - candidate_t[k]) / (candidate_t[k + 1] - candidate_t[k])
            x += weight * (candidate_pose[k + 1, 0] - x)
            y += weight * (candidate_pose[k + 1, 1] - y)
            yaw += weight * _wrapped(candidate_pose[k + 1, 2] - yaw)
        position += (x - reference_pose[i, 0]) ** 2 + (y - reference_pose[i, 1]) ** 2
        heading += _wrapped(yaw - reference_pose[i, 2]) ** 2
        n += 1
    return (math.sqrt(position / n), math.sqrt(heading / n), n) if n > 0 else (math.nan, math.nan, 0)


@dataclass(frozen=True)
class HorizonErrors:
    """Relative pose errors over all windows of one horizon, summed up."""

    n: int
    """Number of windows."""
    position_median_m: float
    """Median of the position errors [m]."""
    position_p95_m: float
    """95th percentile of the position errors, linear between ranks [m]."""
    yaw_median_rad: float
    """Median of the yaw errors [rad]."""
    yaw_p95_rad: float
    """95th percentile of the yaw errors, linear between ranks [rad]."""


def relative_pose_error(
    candidate_pose: ArrayLike, reference_pose: ArrayLike, starts: ArrayLike, ends: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Error of the motion from index i to index j, whatever the error at i: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).

    P is the candidate and Q the reference. The error of a dead reckoning over a horizon, free of the drift before it.

    Args:
        candidate_pose: (M, 3) x [m], y [m], yaw [rad].
        reference_pose: (M, 3) likewise, at the same instants.
        starts: (W,) indices i.
        ends: (W,) indices j.

    Returns:
        (W,) sizes of E's translation [m] and (W,) of its rotation [rad, within 0 and pi].

    Raises:
        ValueError: shapes do not match, or a number is not finite.
    """
    p = frozen_array(candidate_pose, "candidate_pose", (None, 3))
    q = frozen_array(reference_pose, "reference_pose", (len(p), 3))
    i, j = np.asarray(starts, dtype=np.intp), np.asarray(ends, dtype=np.intp)
    error = relative(relative(q[i], q[j]), relative(p[i], p[j]))
    return np.hypot(error[:, 0], error[:, 1]), np.abs(wrap_angle(error[:, 2]))


def horizon_windows(t: ArrayLike, horizon: float, usable: ArrayLike | None = None) -> tuple[IndexArray, IndexArray]:
    """Cut a gap-free record into consecutive windows of one length.

    The first window starts at the first usable sample; each ends at the first usable sample at least `horizon` later (less
    `TIME_TOLERANCE`), where the next one starts. What is left at the end is no window.

    Args:
        t: (M,) strictly increasing stamps [s].
        horizon: the length wanted [s].
        usable: (M,) which samples may begin or end a window, such as those with a fresh pose; None for all.

    Returns:
        (W,) start indices and (W,) end indices; empty where not even one window fits.

    Raises:
        ValueError: the horizon is not positive, time does not increase, or `usable` is no mask of M.
    """
    stamps = increasing_times(t)
    if not (math.isfinite(horizon) and horizon > TIME_TOLERANCE):
        raise ValueError(f"the horizon must be longer than {TIME_TOLERANCE} s, got {horizon} s")
    mask = np.ones(len(stamps), dtype=np.bool_) if usable is None else np.asarray(usable)
    if mask.shape != stamps.shape or mask.dtype != np.bool_:
        raise ValueError(f"usable must be {len(stamps)} booleans, got {mask.dtype} of shape {mask.shape}")
    index = np.flatnonzero(mask)
    at = stamps[index]
    edges = [0] if len(index) > 0 else []
    while edges:
        k = int(np.searchsorted(at, at[edges[-1]] + horizon - TIME_TOLERANCE))
        if k == len(index):
            break
        edges.append(k)
    return index[edges[:-1]], index[edges[1:]]


def horizon_errors(position: ArrayLike, yaw: ArrayLike) -> HorizonErrors:
    """Sum up the (n,) position [m] and yaw errors [rad] of all windows of one horizon: medians and 95th percentiles.

    Raises:
        ValueError: there is no window, lengths differ, or a number is not finite.
    """
    p = frozen_array(position, "position errors", (None,))
    if len(p) == 0:
        raise ValueError("there is no window to sum up")
    r = frozen_array(yaw, "yaw errors", (len(p),))
    position_median, position_p95 = np.percentile(p, (50.0, 95.0))
    yaw_median, yaw_p95 = np.percentile(r, (50.0, 95.0))
    return HorizonErrors(len(p), float(position_median), float(position_p95), float(yaw_median), float(yaw_p95))
