"""Errors over overlapping windows, and how far chance may have moved their medians.

Consecutive windows are few, and where the first one begins moves their median. Windows that begin every second use every
part of a recording, but neighbours share data: an interval for their median comes from resampling whole blocks of
neighbours (moving-block bootstrap; Kuensch, Ann. Statist. 17 (1989) 1217), as long as a window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ssmr.metrics.poses import TIME_TOLERANCE
from ssmr.types import FloatArray, IndexArray, frozen_array

EVERY_S = 1.0
"""Time between the beginnings of two overlapping windows [s]."""
SHARE = 0.90
"""Probability that an interval shall have."""
SHORTEST_BLOCK_S = 6.0
"""Least length of a resampled block [s]: commands of a test drive are often held for some seconds."""
FEWEST_BLOCKS = 4
"""Number of blocks that a recording must hold for resampling; below it the interval is that of all errors."""
_DRAWS = 1000
"""Number of resampled series."""


def overlapping_windows(t: ArrayLike, horizon: float, usable: ArrayLike | None = None) -> tuple[IndexArray, IndexArray]:
    """Return windows of one length that begin every `EVERY_S` in a gap-free record.

    A window begins at the first usable sample at or after its time, and ends at the first usable one at least `horizon`
    after that.

    Args:
        t: (M,) strictly increasing stamps [s].
        horizon: the length wanted [s].
        usable: (M,) booleans, the samples that may begin or end a window; None for all.

    Returns:
        (W,) start indices, each once, and (W,) end indices; empty where not even one window fits.

    Raises:
        ValueError: the horizon is not positive.
    """
    stamps = frozen_array(t, "t", (None,))
    if not (math.isfinite(horizon) and horizon > TIME_TOLERANCE):
        raise ValueError(f"the horizon must be longer than {TIME_TOLERANCE} s, got {horizon} s")
    index = np.arange(len(stamps)) if usable is None else np.flatnonzero(usable)
    at = stamps[index]
    if len(at) == 0:
        return index, index
    begins = np.arange(at[0], max(at[-1] - horizon, at[0]) + TIME_TOLERANCE, EVERY_S)
    starts = np.unique(np.searchsorted(at, begins - TIME_TOLERANCE))
    ends = np.searchsorted(at, at[starts] + horizon - TIME_TOLERANCE)
    inside = ends < len(at)
    return index[starts[inside]], index[ends[inside]]


@dataclass(frozen=True, eq=False)
class WindowErrors:
    """Errors of the relative pose over the overlapping windows of one horizon, in the order of time."""

    horizon: float
    """Length of the windows [s]."""
    position: FloatArray
    """(W,) position errors [m]."""
    yaw: FloatArray
    """(W,) sizes of the yaw errors [rad]."""

    def __post_init__(self) -> None:
        """Check; ValueError where there is no window, or the lengths differ."""
        position = frozen_array(self.position, "position errors", (None,))
        if len(position) == 0:
            raise ValueError("there is no window to sum up")
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "yaw", frozen_array(self.yaw, "yaw errors", (len(position),)))

    def summary(self) -> OverlappingErrors:
        """Return medians with their intervals."""
        draws = self._draws()
        position, yaw = (_interval(values, draws) for values in (self.position, self.yaw))
        return OverlappingErrors(len(self.position), *position, *yaw)

    def differs_from(self, other: WindowErrors) -> tuple[bool, bool]:
        """Return whether the medians of position and of yaw differ from those of another plant by more than chance.

        Both are resampled alike, so that what is hard for both does not count. Windows must be the same.

        Raises:
            ValueError: the numbers of windows differ.
        """
        if len(other.position) != len(self.position):
            raise ValueError(f"there are {len(self.position)} windows here and {len(other.position)} there")
        draws = self._draws()
        if draws is None:
            return False, False
        pairs = ((self.position, other.position), (self.yaw, other.yaw))
        position, yaw = (np.median(a[draws], axis=1) - np.median(b[draws], axis=1) for a, b in pairs)
        return _excludes_zero(position), _excludes_zero(yaw)

    def _draws(self) -> IndexArray | None:
        """Return (draws, W) indices of resampled series; None where the recording is too short for that."""
        n, block = len(self.position), math.ceil(max(self.horizon, SHORTEST_BLOCK_S) / EVERY_S)
        if n < FEWEST_BLOCKS * block:
            return None
        starts = np.random.default_rng(0).integers(0, n, (_DRAWS, math.ceil(n / block)))
        series = (starts[:, :, None] + np.arange(block)) % n  # in a circle, so that every window counts alike
        return series.reshape(_DRAWS, -1)[:, :n]


@dataclass(frozen=True)
class OverlappingErrors:
    """Medians over overlapping windows, each with the interval that holds it with a probability of `SHARE`."""

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


def _interval(values: FloatArray, draws: IndexArray | None) -> tuple[float, float, float]:
    """Return the median of (W,) values and its interval; that of all values where nothing was resampled."""
    median = float(np.median(values))
    tail = 50.0 * (1.0 - SHARE)
    of = values if draws is None else np.median(values[draws], axis=1)
    low, high = np.percentile(of, (tail, 100.0 - tail))
    return median, min(float(low), median), max(float(high), median)


def _excludes_zero(differences: FloatArray) -> bool:
    tail = 50.0 * (1.0 - SHARE)
    low, high = np.percentile(differences, (tail, 100.0 - tail))
    return bool(low > 0.0 or high < 0.0)
