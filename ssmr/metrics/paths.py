"""How far a candidate motion lies from a reference: the thesis' metrics (Sec. 1.6), synchronised and relative pose errors.

Which way round. The candidate is the simulated motion, the reference the measured or wanted one. The thesis leaves it open
(Sec. 1.6 writes d_B / d_A), so it is fixed here once, as Sec. 3.5.3 and Algorithm 2 use it:

- ratios are candidate / reference: d_ratio = 1.0312 says that the simulated path is 3.12 % longer than the real one;
- d_rms and d_haus are one-sided, from each sample of the reference to the closest sample of the candidate: Algorithm 2 loops
  over the points of the reference trajectory. They do not punish a candidate that covers the reference and then strays; the
  `_symmetric` metrics take both directions, and do.

Distances are between samples, as printed, not between curves: a path sampled every h keeps a floor of up to h / 2.

Kernels compiled with `jit` read columns 0 and 1 of what they are given, so (M, 3) poses serve as paths without a copy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr._jit import jit
from ssmr.geometry import relative, wrap_angle
from ssmr.types import FloatArray, Trajectory, frozen_array

IndexArray = NDArray[np.intp]

BENDING_SPACING = 0.1
"""Distance between the points at which curvature is taken [m]: noise of size s adds about 6 s^2 / d^4 per metre, so with
the 0.5 mm of a tracking system a tenth of a metre is the least that leaves a gentle path its own bending energy."""
LENGTH_FLOOR = 1e-3
"""A path shorter than this has no length to compare with [m]: a robot that stands still."""
BENDING_FLOOR = 1e-3
"""A path of less bending energy is straight [1/m]: 10 m along a circle of 100 m radius."""
TIME_TOLERANCE = 1e-9
"""Stamps closer than this are the same instant [s]: rounding of k * dt, far under any sampling period."""

_BATCH = 32
"""Neighbouring points that share one walk along the path; of 8, 16, 24 and 32 the fastest for 1000 samples."""
_SLACK = 1e-12
"""Relative slack of a bound on distances: thousands of roundings wide, and too thin to cost a visit."""
_LARGEST = 1e75
"""Coordinates beyond this count as not finite [m]: their fourth powers would overflow."""


@jit
def _wrapped(angle: float) -> float:
    """An angle [rad] less whole turns, within [-pi, pi]; the sign at half a turn does not matter to a size."""
    return angle - 2.0 * math.pi * np.rint(angle / (2.0 * math.pi))


@jit
def _is_measurable(xy: FloatArray) -> bool:
    """Whether a path has samples and all of them are finite."""
    for i in range(xy.shape[0]):
        if not (abs(xy[i, 0]) <= _LARGEST and abs(xy[i, 1]) <= _LARGEST):
            return False
    return xy.shape[0] > 0


@jit
def _steps(xy: FloatArray) -> tuple[float, float, float]:
    """Of the steps between samples: their sum [m], the sum of their squares [m^2], the longest [m]."""
    total, squares, longest = 0.0, 0.0, 0.0
    for i in range(xy.shape[0] - 1):
        dx, dy = xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1]
        square = dx * dx + dy * dy
        step = math.sqrt(square)
        total += step
        squares += square
        longest = max(longest, step)
    return total, squares, longest


@jit
def _nearest_squared(points: FloatArray, path: FloatArray, longest_step: float) -> FloatArray:
    """Square of the distance from each of (N, 2) points to the closest sample of the (M, 2) path, (N,) [m^2].

    Consecutive points lie close together, so a batch of them shares one walk: from the sample nearest to the previous batch
    outwards in both directions. Let c be the batch's middle point, r its radius about c and b the distance from c to the
    closest sample seen yet. A sample farther than b + 2 r from c is nearest to no point of the batch, because for each of
    them that closest sample is at most b + r away and this one more than b + r. And by the triangle inequality a sample k
    places on is nearer to c by at most k longest steps, so from a sample at distance d > b + 2 r the walk may pass over
    floor((d - b - 2 r) / longest step) samples unseen. Every bound gives way by `_SLACK`, so the answer is that of the
    search over all pairs, to the last bit.
    """
    n = points.shape[0]
    m = path.shape[0] if longest_step > 0.0 else 1  # samples that all coincide are one sample
    per_step = (1.0 - _SLACK) / longest_step if longest_step > 0.0 else 0.0
    squared = np.empty(n)
    x, y = path[:m, 0].copy(), path[:m, 1].copy()
    batch_x, batch_y, batch = np.empty(_BATCH), np.empty(_BATCH), np.empty(_BATCH)
    nearest = 0
    for first in range(0, n, _BATCH):
        for i in range(_BATCH):  # the last batch is filled up with the last point: a fixed length compiles to vector code
            k = min(first + i, n - 1)
            batch_x[i], batch_y[i], batch[i] = points[k, 0], points[k, 1], np.inf
        centre_x, centre_y = batch_x[_BATCH // 2], batch_y[_BATCH // 2]
        radius_squared = 0.0
        for i in range(_BATCH):
            dx, dy = batch_x[i] - centre_x, batch_y[i] - centre_y
            radius_squared = max(radius_squared, dx * dx + dy * dy)
        margin = 2.0 * math.sqrt(radius_squared) * (1.0 + _SLACK)

        start = _descend(centre_x, centre_y, x, y, nearest)
        dx, dy = centre_x - x[start], centre_y - y[start]
        best = math.sqrt(dx * dx + dy * dy)
        nearest = start
        for direction in (-1, 1):
            j = start if direction < 0 else start + 1
            while 0 <= j < m:
                dx, dy = centre_x - x[j], centre_y - y[j]
                distance = math.sqrt(dx * dx + dy * dy)
                beyond = distance * (1.0 - _SLACK) - (best + margin)
                if beyond > 0.0:
                    j += direction * (1 + int(min(beyond * per_step, float(m))))
                    continue
                if distance < best:
                    best = distance
                    nearest = j
                sample_x, sample_y = x[j], y[j]
                for i in range(_BATCH):
                    dx, dy = batch_x[i] - sample_x, batch_y[i] - sample_y
                    square = dx * dx + dy * dy
                    batch[i] = square if square < batch[i] else batch[i]
                j += direction
        for i in range(min(_BATCH, n - first)):
            squared[first + i] = batch[i]
    return squared


@jit
def _descend(at_x: float, at_y: float, x: FloatArray, y: FloatArray, start: int) -> int:
    """Index of the sample at which the distance to a point stops falling, going from `start` forwards, else backwards."""
    k = start
    best = (at_x - x[k]) ** 2 + (at_y - y[k]) ** 2
    for direction in (1, -1):
        while 0 <= k + direction < x.shape[0]:
            square = (at_x - x[k + direction]) ** 2 + (at_y - y[k + direction]) ** 2
            if not square < best:
                break
            best = square
            k += direction
    return k


@jit
def nearest_distances(points: FloatArray, path: FloatArray) -> FloatArray:
    """Distance from each point to the closest sample of a path. Exact; fast where the points are themselves a path.

    A `jit` kernel, so other kernels may call it.

    Args:
        points: (N, 2) positions [m].
        path: (M, 2) positions [m], in order.

    Returns:
        (N,) distances [m].

    Raises:
        ValueError: the path has no sample, or a coordinate is not finite.
    """
    if not _is_measurable(path):
        raise ValueError("the path must have samples, all of them finite")
    if points.shape[0] > 0 and not _is_measurable(points):
        raise ValueError("the points must be finite")
    return np.sqrt(_nearest_squared(points, path, _steps(path)[2]))


@jit
def _bending(xy: FloatArray, spacing: float) -> float:
    """`bending_energy` without its checks."""
    total, squares, _ = _steps(xy)
    if not total > 0.0:
        return 0.0
    d = max(spacing, squares / total)  # hence at most M - 1 chords, however long the path: total^2 <= (M - 1) squares
    last_x, last_y = xy[0, 0], xy[0, 1]
    chord_x, chord_y = 0.0, 0.0
    chords = 0
    energy, first, latest = 0.0, 0.0, 0.0
    for i in range(1, xy.shape[0]):
        end_x, end_y = xy[i, 0], xy[i, 1]
        from_x, from_y = xy[i - 1, 0], xy[i - 1, 1]  # within d of the last point, unlike the end if a chord ends here
        while (end_x - last_x) ** 2 + (end_y - last_y) ** 2 >= d * d:
            # from + s (end - from) leaves the circle of radius d about the last point where a s^2 + 2 b s + c = 0, s > 0
            step_x, step_y = end_x - from_x, end_y - from_y
            inside_x, inside_y = from_x - last_x, from_y - last_y
            a = step_x * step_x + step_y * step_y
            b = step_x * inside_x + step_y * inside_y
            c = min(inside_x * inside_x + inside_y * inside_y - d * d, 0.0)
            root = math.sqrt(b * b - a * c)
            s = min(-c / (b + root) if b > 0.0 else (root - b) / a, 1.0)
            from_x, from_y = from_x + s * step_x, from_y + s * step_y
            before_x, before_y = chord_x, chord_y
            chord_x, chord_y = from_x - last_x, from_y - last_y
            last_x, last_y = from_x, from_y
            chords += 1
            if chords > 1:
                turn = math.atan2(before_x * chord_y - before_y * chord_x, before_x * chord_x + before_y * chord_y)
                latest = turn * turn / d  # c_i^2 d_i with c_i = turn / d
                energy += latest
                if chords == 2:
                    first = latest
    if chords < 2:
        return 0.0
    rest = math.hypot(xy[-1, 0] - last_x, xy[-1, 1] - last_y)
    return energy + 0.5 * first + (0.5 + rest / d) * latest


@jit
def _ratio(candidate: float, reference: float, floor: float) -> float:
    """Candidate over reference, always finite: 1 where both are under the floor, which else is the least divisor."""
    if candidate < floor and reference < floor:
        return 1.0
    return candidate / max(reference, floor)


@jit
def one_sided_kernel(candidate_xy: FloatArray, reference_xy: FloatArray) -> tuple[float, float, float]:
    """What Eq. 3.1 is made of, for use from other kernels: half the work of all metrics; it never raises.

    Args:
        candidate_xy: (N, 2) positions [m].
        reference_xy: (M, 2) positions [m].

    Returns:
        d_rms [m], d_haus [m], d_ratio; all NaN where a path has no sample or one that is not finite (or beyond 1e75 m).
    """
    if not (_is_measurable(candidate_xy) and _is_measurable(reference_xy)):
        return math.nan, math.nan, math.nan
    candidate_length, _, candidate_step = _steps(candidate_xy)
    reference_length, _, _ = _steps(reference_xy)
    to_candidate = _nearest_squared(reference_xy, candidate_xy, candidate_step)
    ratio = _ratio(candidate_length, reference_length, LENGTH_FLOOR)
    return math.sqrt(np.mean(to_candidate)), math.sqrt(np.max(to_candidate)), ratio


@jit
def bend_ratio_kernel(candidate_xy: FloatArray, reference_xy: FloatArray) -> float:
    """e_bend_ratio of paths that `one_sided_kernel` could measure, for use from other kernels."""
    return _ratio(_bending(candidate_xy, BENDING_SPACING), _bending(reference_xy, BENDING_SPACING), BENDING_FLOOR)


@jit
def path_metrics_kernel(
    candidate_xy: FloatArray, reference_xy: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """The geometric metrics of `PathMetrics`, for use from other kernels: it never raises.

    Args:
        candidate_xy: (N, 2) positions [m].
        reference_xy: (M, 2) positions [m].

    Returns:
        d_rms [m], d_haus [m], d_ratio, e_bend_ratio, d_rms_symmetric [m], d_haus_symmetric [m]. All are NaN where a path has
        no sample or one that is not finite (or beyond 1e75 m), as a diverged candidate has.
    """
    if not (_is_measurable(candidate_xy) and _is_measurable(reference_xy)):
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    candidate_length, _, candidate_step = _steps(candidate_xy)
    reference_length, _, reference_step = _steps(reference_xy)
    to_candidate = _nearest_squared(reference_xy, candidate_xy, candidate_step)
    to_reference = _nearest_squared(candidate_xy, reference_xy, reference_step)
    mean, largest = np.mean(to_candidate), np.max(to_candidate)
    return (
        math.sqrt(mean),
        math.sqrt(largest),
        _ratio(candidate_length, reference_length, LENGTH_FLOOR),
        bend_ratio_kernel(candidate_xy, reference_xy),
        math.sqrt(0.5 * (mean + np.mean(to_reference))),
        math.sqrt(max(largest, np.max(to_reference))),
    )


@jit
def sync_rms_kernel(
    candidate_t: FloatArray, candidate_pose: FloatArray, reference_t: FloatArray, reference_pose: FloatArray
) -> tuple[float, float, int]:
    """RMS errors at equal stamps, for use from other kernels: it never raises.

    Args:
        candidate_t: (N,) strictly increasing stamps [s].
        candidate_pose: (N, 3) x [m], y [m], yaw [rad]; interpolated linearly, yaw the short way round.
        reference_t: (M,) strictly increasing stamps [s]; those beyond the candidate's span are left out.
        reference_pose: (M, 3) x [m], y [m], yaw [rad].

    Returns:
        Position RMS [m], yaw RMS [rad] (of wrapped differences), and the number of stamps they are taken over; with none of
        them, NaN and NaN. A stamp that both have is compared as it is, without interpolation.
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


@jit
def _compare(
    candidate_t: FloatArray, candidate_pose: FloatArray, reference_t: FloatArray, reference_pose: FloatArray
) -> tuple[tuple[float, float, float, float, float, float], tuple[float, float, int]]:
    """All of `compare_paths` in one call."""
    return (
        path_metrics_kernel(candidate_pose, reference_pose),
        sync_rms_kernel(candidate_t, candidate_pose, reference_t, reference_pose),
    )


@dataclass(frozen=True)
class PathMetrics:
    """A candidate against a reference; the module's head says which way round."""

    d_rms_m: float
    """RMS over the reference's samples of the distance to the closest sample of the candidate (Sec. 1.6) [m]."""
    d_haus_m: float
    """The largest of those distances: the one-sided Hausdorff distance (Sec. 1.6) [m]."""
    d_ratio: float
    """Length of the candidate / length of the reference; 1 where both stand still (`LENGTH_FLOOR`), and finite always."""
    e_bend_ratio: float
    """Bending energy likewise; 1 where both are straight (`BENDING_FLOOR`), and finite always."""
    d_rms_symmetric_m: float
    """Root of the mean of both directions' mean squares [m]: each direction weighs the same, however many its samples."""
    d_haus_symmetric_m: float
    """The larger of both directions' Hausdorff distances [m]."""
    sync_rms_m: float
    """RMS of the distance between both at the same instant [m]."""
    yaw_rms_rad: float
    """RMS of the wrapped difference of headings at the same instant [rad]."""


@dataclass(frozen=True)
class HorizonErrors:
    """What relative pose errors over windows of one horizon come to."""

    n: int
    """How many windows there are."""
    position_median_m: float
    """Median of the position errors [m]."""
    position_p95_m: float
    """95th percentile of the position errors, linear between ranks [m]."""
    yaw_median_rad: float
    """Median of the yaw errors [rad]."""
    yaw_p95_rad: float
    """95th percentile of the yaw errors, linear between ranks [rad]."""


def path_length(xy: ArrayLike) -> float:
    """Sum of the distances between consecutive samples of an (M, 2) path [m].

    Raises:
        ValueError: the shape is another one, or a number is not finite.
    """
    return float(_steps(frozen_array(xy, "xy", (None, 2)))[0])


def bending_energy(xy: ArrayLike, spacing: float = BENDING_SPACING) -> float:
    """Total bending energy, sum of c_i^2 d_i (Sec. 1.6): the integral of curvature squared along the path.

    The path is first laid out afresh: from its first sample on, the next point is where the polyline first gets the distance
    d away from the last point, so that all chords are d long. The local curvature c_i is the turn between two chords over d.
    Thus the outcome depends neither on the sampling rate nor on the speed, and a robot that stands still, or turns on the
    spot, adds nothing even while its measured position jitters by less than d. Each end takes the curvature of its
    neighbour, and so does what is left after the last chord.

    d is `spacing`, or the mean step between samples (weighted by length) where that is longer: points laid closer than the
    samples would find all turning at the samples and none between them. Noise of size s adds about 6 s^2 / d^4 per metre,
    so paths measured with noise need a larger spacing or smoothing. A reversal is a turn by pi: finite, pi^2 / d.

    Args:
        xy: (M, 2) positions [m].
        spacing: the least d [m].

    Returns:
        The energy [1/m]; zero for a path shorter than two chords.

    Raises:
        ValueError: `spacing` is not positive, the shape is another one, or a number is not finite.
    """
    if not (math.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"the spacing must be positive, got {spacing} m")
    return float(_bending(frozen_array(xy, "xy", (None, 2)), float(spacing)))


def _synchronised(candidate: Trajectory, reference: Trajectory) -> tuple[float, float]:
    position, heading, n = sync_rms_kernel(candidate.t, candidate.pose, reference.t, reference.pose)
    _require_common_stamps(candidate, reference, n)
    return float(position), float(heading)


def _require_common_stamps(candidate: Trajectory, reference: Trajectory, n: int) -> None:
    if n == 0:
        raise ValueError(
            f"no stamp of the reference, {reference.t[0]} to {reference.t[-1]} s, "
            f"lies within the candidate's span, {candidate.t[0]} to {candidate.t[-1]} s"
        )


def sync_rms(candidate: Trajectory, reference: Trajectory) -> float:
    """RMS of the distance between both at the reference's stamps [m], over their common span.

    The candidate is interpolated linearly, unless it has the very stamp.

    Raises:
        ValueError: no stamp of the reference lies within the candidate's span.
    """
    return _synchronised(candidate, reference)[0]


def yaw_rms(candidate: Trajectory, reference: Trajectory) -> float:
    """RMS of the wrapped difference of headings at the reference's stamps [rad], over their common span.

    The candidate is interpolated linearly, the short way round, unless it has the very stamp.

    Raises:
        ValueError: no stamp of the reference lies within the candidate's span.
    """
    return _synchronised(candidate, reference)[1]


def compare_paths(candidate: Trajectory, reference: Trajectory) -> PathMetrics:
    """All metrics of a candidate against a reference.

    The geometric ones compare the whole paths, whatever their stamps; the synchronised ones their common span.

    Raises:
        ValueError: no stamp of the reference lies within the candidate's span, or a coordinate is beyond 1e75 m.
    """
    geometric, (sync, yaw, n) = _compare(candidate.t, candidate.pose, reference.t, reference.pose)
    _require_common_stamps(candidate, reference, n)
    if math.isnan(geometric[0]):
        raise ValueError(f"a coordinate is beyond {_LARGEST} m")
    rms, haus, ratio, bending, rms_symmetric, haus_symmetric = geometric
    return PathMetrics(rms, haus, ratio, bending, rms_symmetric, haus_symmetric, sync, yaw)


def compare_pieces(candidates: Sequence[Trajectory], references: Sequence[Trajectory]) -> PathMetrics:
    """The metrics over several stretches that nothing joins: a recording with gaps.

    Mean squares are weighted by the reference's samples, Hausdorff distances are the greatest of all, lengths and bending
    energies are added up before their ratios are taken. One piece gives what `compare_paths` gives.

    Raises:
        ValueError: not as many candidates as references, none at all, or what `compare_paths` raises.
    """
    pairs = list(zip(candidates, references, strict=True))
    if not pairs:
        raise ValueError("there is nothing to compare")
    parts = [compare_paths(candidate, reference) for candidate, reference in pairs]
    if len(parts) == 1:
        return parts[0]
    weights = np.array([len(reference) for reference in references], dtype=np.float64)

    def pooled(name: str) -> float:
        return math.sqrt(np.average([getattr(part, name) ** 2 for part in parts], weights=weights))

    lengths = np.sum([[path_length(m.xy) for m in pair] for pair in pairs], axis=0)
    energies = np.sum([[bending_energy(m.xy) for m in pair] for pair in pairs], axis=0)
    return PathMetrics(
        d_rms_m=pooled("d_rms_m"),
        d_haus_m=max(part.d_haus_m for part in parts),
        d_ratio=_ratio(lengths[0], lengths[1], LENGTH_FLOOR),
        e_bend_ratio=_ratio(energies[0], energies[1], BENDING_FLOOR),
        d_rms_symmetric_m=pooled("d_rms_symmetric_m"),
        d_haus_symmetric_m=max(part.d_haus_symmetric_m for part in parts),
        sync_rms_m=pooled("sync_rms_m"),
        yaw_rms_rad=pooled("yaw_rms_rad"),
    )


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
        ValueError: shapes do not match, a number is not finite, or an index is out of range.
    """
    p = frozen_array(candidate_pose, "candidate_pose", (None, 3))
    q = frozen_array(reference_pose, "reference_pose", (len(p), 3))
    i, j = _indices(starts, "starts", len(p)), _indices(ends, "ends", len(p))
    if len(i) != len(j):
        raise ValueError(f"there are {len(i)} starts and {len(j)} ends")
    error = relative(relative(q[i], q[j]), relative(p[i], p[j]))
    return np.hypot(error[:, 0], error[:, 1]), np.abs(wrap_angle(error[:, 2]))


def _indices(values: ArrayLike, name: str, size: int) -> IndexArray:
    array = np.asarray(values)
    if array.ndim != 1 or (array.size > 0 and not np.issubdtype(array.dtype, np.integer)):
        raise ValueError(f"{name} must be a list of integers")
    if array.size > 0 and not (array.min() >= 0 and array.max() < size):
        raise ValueError(f"{name} must lie within 0 and {size - 1}, got {array.min()} to {array.max()}")
    return array.astype(np.intp)


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
    stamps = frozen_array(t, "t", (None,))
    if np.any(np.diff(stamps) <= 0.0):
        raise ValueError("t must increase")
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
    """Sum up the relative pose errors of all windows of one horizon.

    Args:
        position: (n,) position errors [m], of all segments together.
        yaw: (n,) yaw errors [rad] of the same windows.

    Returns:
        Medians and 95th percentiles.

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
