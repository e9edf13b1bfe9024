"""Samples at stamps of their own: new ones, held ones, means over time, and how alike two are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray

BoolArray = NDArray[np.bool_]
TIME_ROUNDOFF = 1e-6
"""Instants closer than this are the same one: well over rounding, well under any sample step
[s]."""
COMMAND_TIMEOUT = 0.5
"""Age from which a command no longer counts [s]: a driver stops a robot that gets no commands any
more."""
_STILL_AFTER = 1.0
"""A pose that repeats for longer means that the robot stands, not that the localiser is slower than
the log [s]."""


def held(t: FloatArray, stamps: FloatArray, values: FloatArray) -> FloatArray:
    """Return the (N,) last commands at or before `t` [s]; zero before the first, or if too old.

    Args:
        t: (N,) instants [s].
        stamps: (M,) instants of the commands [s].
        values: (M,) the commands.
    """
    last = np.searchsorted(stamps, t + TIME_ROUNDOFF, side="right") - 1
    at = np.maximum(last, 0)
    age = t - stamps[at]
    return np.where((last >= 0) & (age <= COMMAND_TIMEOUT + TIME_ROUNDOFF), values[at], 0.0)


def fresh_poses(t: FloatArray, pose: FloatArray) -> BoolArray:
    """Return (M,) bool, True for rows of (M, 3) poses that are new.

    A pose equal to the one before, bit for bit, was only logged again. If that goes on for more
    than `_STILL_AFTER`, the robot stands, and the samples after that time are new. The first sample
    is always new.
    """
    changed, last = _last_change(t, pose)
    return changed | (t - last > _STILL_AFTER + TIME_ROUNDOFF)


def refreshed(t: FloatArray, values: FloatArray) -> BoolArray:
    """Return (M,) bool, True for rows of (M, k) values that were measured anew.

    The others were only logged again. A row equal to the one before counts as new if nothing new
    came for longer than a usual refresh takes, or for longer than `_STILL_AFTER`: then the value
    stayed the same.
    """
    changed, last = _last_change(t, values)
    times = t[changed]
    refresh = 0.0
    if len(times) > 1:
        refresh = min(float(np.median(np.diff(times))), _STILL_AFTER)
    return changed | (t - last >= refresh - TIME_ROUNDOFF)


def _last_change(t: FloatArray, values: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Return (M,) where rows differ from the one before, and the stamp of the last such row [s]."""
    changed = np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    last = np.maximum.accumulate(np.where(changed, np.arange(len(t)), 0))
    return changed, t[last]


def moving_mean(t: FloatArray, values: FloatArray, half: float) -> FloatArray:
    """Return the (M,) means of the values within `half` [s] of each of the (M,) stamps."""
    low = np.searchsorted(t, t - half - TIME_ROUNDOFF)
    high = np.searchsorted(t, t + half + TIME_ROUNDOFF)
    sums = np.cumulative_sum(values, include_initial=True)
    return np.asarray((sums[high] - sums[low]) / (high - low))


def nearest(stamps: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (N,) the times since the last and until the next stamp [s]; infinite without one."""
    at = np.concatenate([[-math.inf], stamps, [math.inf]])
    after = np.searchsorted(at, t, side="right")
    since = t - at[after - 1]
    until = at[np.minimum(after, len(at) - 1)] - t
    return since, until


def correlation(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two rates about zero [1]; 0 where one of them is zero."""
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 1e-9 else 0.0


def centred(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two rates about their means [1]; 0 where one stays the same."""
    return correlation(x - np.mean(x), y - np.mean(y))


def find_peak(values: FloatArray) -> float:
    """Return where the greatest of (L,) values lies, by the parabola through it and those beside.

    It is an index with a fraction; NaN where the greatest is the first or the last.
    """
    best = int(np.argmax(values))
    if best in (0, len(values) - 1):
        return math.nan
    before, at, after = values[best - 1 : best + 2]
    bend = min(before - 2.0 * at + after, -1e-12)
    return float(best + 0.5 * (before - after) / bend)


def explain_share(values: FloatArray, basis: FloatArray, starts: Sequence[int]) -> FloatArray:
    """Return the (P, L) shares of (N, L) values in parts that factors of (N, k) rates explain [1].

    Each part begins at one of the (P,) indices `starts` and has factors of its own.
    """
    squares = np.add.reduceat(basis[:, :, None] * basis[:, None, :], starts)
    squares += 1e-9 * np.eye(basis.shape[1])
    both = np.add.reduceat(basis[:, :, None] * values[:, None, :], starts)
    size = np.maximum(np.add.reduceat(values**2, starts), 1e-12)
    return np.asarray(np.sum(np.linalg.solve(squares, both) * both, axis=1) / size)


def sturdy_fit(of: FloatArray, values: FloatArray) -> FloatArray:
    """Return the factors of (N, k) columns that sum up to (N,) values, by least absolute errors."""
    weights: FloatArray = np.ones(len(values))
    factors: FloatArray = np.zeros(of.shape[1])
    for _ in range(15):  # of weighted least squares
        factors = np.asarray(np.linalg.lstsq(of * weights[:, None], values * weights)[0])
        errors = np.abs(values - of @ factors)
        weights = 1.0 / np.sqrt(np.maximum(errors, np.median(errors) + 1e-6))
    return factors
