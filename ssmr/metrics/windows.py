"""Errors of the relative pose over windows of a horizon, and intervals for their medians.

A candidate is the simulated motion, a reference the measured or desired one. Consecutive windows
are few, and where the first one begins moves their median. Windows that begin every second use
every part of a recording, but neighbours share data: an interval for their median comes from
resampling whole blocks of neighbours (moving-block bootstrap; Kuensch, Ann. Statist. 17 (1989)
1217), as long as a window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from ssmr.geometry import relative_pose, wrap_angle
from ssmr.types import FloatArray, IndexArray, frozen_array, increasing_times

TIME_TOLERANCE = 1e-9
"""Stamps closer than this are the same instant [s]: rounding of k * dt, far under any sampling
period."""
EVERY_S = 1.0
"""Time between the beginnings of two overlapping windows [s]."""
SHARE = 0.90
"""Probability that an interval shall have."""
SHORTEST_BLOCK_S = 6.0
"""Least length of a resampled block [s]: commands of a test drive are often held for some
seconds."""
_FEWEST_BLOCKS = 4
"""Number of blocks that a recording must hold for resampling; below it the interval is that of all
errors."""
_DRAWS = 1000
"""Number of resampled series."""
_AT_ONCE = 128
"""Windows for which all of these are held at once; of more, which fill the memory, a part of them
is."""
_TAILS = 50.0 * (1.0 - SHARE), 50.0 * (1.0 + SHARE)
"""Percentiles at which an interval ends."""


def relative_pose_error(
    candidate_pose: ArrayLike, reference_pose: ArrayLike, starts: ArrayLike, ends: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the error of the motion from index i to index j, whatever the error at i.

    It is E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j). P is the candidate and Q the reference, (M, 3) x [m],
    y [m], yaw [rad] at the same instants; `starts` and `ends` are (W,) indices i and j.

    Returns:
        (W,) sizes of E's translation [m] and (W,) of its rotation [rad, within 0 and pi].

    Raises:
        ValueError: shapes do not match, or a number is not finite.
    """
    p = frozen_array(candidate_pose, "candidate_pose", (None, 3))
    q = frozen_array(reference_pose, "reference_pose", (len(p), 3))
    i = np.asarray(starts, dtype=np.intp)
    j = np.asarray(ends, dtype=np.intp)
    motion = relative_pose(p[i], p[j])
    error = relative_pose(relative_pose(q[i], q[j]), motion)
    position = np.hypot(error[:, 0], error[:, 1])
    return position, np.abs(wrap_angle(error[:, 2]))


def horizon_windows(
    t: ArrayLike, horizon: float, usable: ArrayLike | None = None
) -> tuple[IndexArray, IndexArray]:
    """Cut a gap-free record into consecutive windows of one length.

    The first window starts at the first usable sample; each ends at the first usable sample at
    least `horizon` later (less `TIME_TOLERANCE`), where the next one starts. What is left at the
    end is no window.

    Args:
        t: (M,) strictly increasing stamps [s].
        horizon: length of each window [s].
        usable: (M,) which samples may begin or end a window, such as those with a fresh pose; None
            for all.

    Returns:
        (W,) start indices and (W,) end indices; empty where not even one window fits.

    Raises:
        ValueError: the horizon is not positive, time does not increase, or `usable` is no mask of
            M.
    """
    index, at = _usable_samples(t, horizon, usable)
    edges = [0] if len(index) > 0 else []
    while edges:
        end = at[edges[-1]] + horizon
        k = np.searchsorted(at, end - TIME_TOLERANCE)
        if k == len(index):
            break
        edges.append(k)
    return index[edges[:-1]], index[edges[1:]]


def overlapping_windows(
    t: ArrayLike, horizon: float, usable: ArrayLike | None = None
) -> tuple[IndexArray, IndexArray]:
    """Windows of one length that begin every `EVERY_S` in a gap-free record, each start once.

    A window begins at the first usable sample at or after its time, and ends at the first usable
    one at least `horizon` after that. Arguments, results and errors are those of `horizon_windows`.
    """
    index, at = _usable_samples(t, horizon, usable)
    if len(at) == 0:
        return index, index
    last = max(at[-1] - horizon, at[0])
    begins = np.arange(at[0], last + TIME_TOLERANCE, EVERY_S)
    starts = np.unique(np.searchsorted(at, begins - TIME_TOLERANCE))
    ends = np.searchsorted(at, at[starts] + horizon - TIME_TOLERANCE)
    inside = ends < len(at)
    return index[starts[inside]], index[ends[inside]]


def _usable_samples(
    t: ArrayLike, horizon: float, usable: ArrayLike | None
) -> tuple[IndexArray, FloatArray]:
    """Return indices and stamps [s] of the usable samples."""
    stamps = increasing_times(t)
    if not (math.isfinite(horizon) and horizon > TIME_TOLERANCE):
        raise ValueError(f"the horizon must be longer than {TIME_TOLERANCE} s, got {horizon} s")
    mask = np.ones(len(stamps), dtype=np.bool_) if usable is None else np.asarray(usable)
    if mask.shape != stamps.shape or mask.dtype != np.bool_:
        given = f"{mask.dtype} of shape {mask.shape}"
        raise ValueError(f"usable must be {len(stamps)} booleans, got {given}")
    index = np.flatnonzero(mask)
    return index, stamps[index]


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
    n_standing: int = 0
    """Number of further windows in which the robot stood throughout; they count in none of the
    numbers above."""


def horizon_errors(position: ArrayLike, yaw: ArrayLike, n_standing: int = 0) -> HorizonErrors:
    """Return medians and 95th percentiles of the errors of all windows of one horizon.

    There are (n,) position errors [m] and yaw errors [rad]. `n_standing` is the number of windows
    that were left out because the robot stood.

    Raises:
        ValueError: there is no window, lengths differ, or a number is not finite.
    """
    sizes = _error_sizes(position, yaw)
    (p50, p95), (r50, r95) = np.percentile(sizes, (50.0, 95.0), axis=1).T.tolist()
    return HorizonErrors(len(sizes[0]), p50, p95, r50, r95, n_standing)


def _error_sizes(position: ArrayLike, yaw: ArrayLike) -> tuple[FloatArray, FloatArray]:
    p = frozen_array(position, "position errors", (None,))
    if len(p) == 0:
        raise ValueError("there is no window to sum up")
    return p, frozen_array(yaw, "yaw errors", (len(p),))


@dataclass(frozen=True)
class OverlappingErrors:
    """Medians over overlapping windows, each with its interval of probability `SHARE`."""

    n: int
    """Number of windows."""
    position_median_m: float
    """Median of the position errors [m]."""
    position_low_m: float
    """Lower end of its interval [m]."""
    position_high_m: float
    """Upper end of its interval [m]."""
    yaw_median_rad: float
    """Median of the yaw errors [rad]."""
    yaw_low_rad: float
    """Lower end of its interval [rad]."""
    yaw_high_rad: float
    """Upper end of its interval [rad]."""


@dataclass(frozen=True, eq=False)
class WindowErrors:
    """Relative pose errors over the overlapping windows of one horizon, in the order of time."""

    horizon: float
    """Length of the windows [s]."""
    position: FloatArray
    """(W,) position errors [m]."""
    yaw: FloatArray
    """(W,) sizes of the yaw errors [rad]."""

    def __post_init__(self) -> None:
        """Check; ValueError where there is no window, or the lengths differ."""
        position, yaw = _error_sizes(self.position, self.yaw)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "yaw", yaw)

    def summary(self) -> OverlappingErrors:
        """Return medians with their intervals, those of all errors if nothing can be resampled.

        The few blocks of a log scatter less among themselves than new ones will, so intervals are
        widened as Student's distribution for their number is wider than the normal one.
        """
        from scipy.special import ndtri, stdtrit  # here: they take long to import

        n = len(self.position)
        block = math.ceil(max(self.horizon, SHORTEST_BLOCK_S) / EVERY_S)
        blocks = n / block
        tail = 0.5 * (1.0 + SHARE)
        numbers = []
        for values in (self.position, self.yaw):
            median = float(np.median(values))
            spread = values
            if blocks >= _FEWEST_BLOCKS:
                rng = np.random.default_rng(0)
                # In a circle, so that every window has the same weight.
                circle = sliding_window_view(np.append(values, values[: block - 1]), block)
                drawn = np.empty(_DRAWS)
                for some in np.array_split(drawn, min(_DRAWS, 1 + n // _AT_ONCE)):
                    starts = rng.integers(0, n, (len(some), math.ceil(blocks)))
                    some[:] = np.median(circle[starts].reshape(len(some), -1)[:, :n], axis=1)
                quantiles = stdtrit(blocks - 1.0, tail) / ndtri(tail)
                wider = quantiles * math.sqrt(blocks / (blocks - 1.0))
                spread = median + wider * (drawn - median)
            low, high = map(float, np.percentile(spread, _TAILS))
            numbers += [median, min(max(low, 0.0), median), max(high, median)]
        return OverlappingErrors(n, *numbers)
