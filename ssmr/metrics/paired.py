"""Paired comparison of candidates: is one better than another, or did chance make it look so?

Errors of all candidates belong to the same windows of one recording, so what is hard for both
counts for neither. Neighbouring windows share data, so whole blocks of them are resampled. Of many
pairs some differ by chance, so probabilities are corrected for their number (Holm, Scand. J.
Statist. 6 (1979) 65).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray, frozen_array, increasing_times

SIGNIFICANCE = 0.05
"""Corrected probability below which two candidates are told apart [1]."""
_DRAWS = 1000
"""Number of resampled series."""
_FEWEST_BLOCKS = 4
"""Fewest blocks that are resampled."""


def chance_of_difference(one: ArrayLike, other: ArrayLike, times: ArrayLike, block: float) -> float:
    """Return the probability that equally good candidates have medians as far apart as these [1].

    Args:
        one: (W,) errors of a candidate.
        other: (W,) errors of another one in the same windows.
        times: (W,) beginnings of the windows, increasing [s].
        block: least duration of a resampled block, such as the length of the windows [s].

    Returns:
        Two-sided probability by Student's distribution for the number of blocks; 1 where there are
        fewer than four.

    Raises:
        ValueError: lengths differ, times do not increase, or a number is not finite.
    """
    from scipy.special import stdtr  # here: it takes long to import

    t = increasing_times(times)
    n = len(t)
    pair = np.stack([frozen_array(values, "errors", (n,)) for values in (one, other)])
    neighbours = np.searchsorted(t, t + block) - np.arange(n)
    together = np.max(neighbours, initial=1)
    if n < _FEWEST_BLOCKS * together:
        return 1.0
    blocks = n / together
    starts = np.random.default_rng(0).integers(0, n, (_DRAWS, math.ceil(blocks)))
    series = (starts[:, :, None] + np.arange(together)) % n
    drawn = series.reshape(_DRAWS, -1)[:, :n]
    apart = np.subtract(*np.median(pair, axis=-1))
    spread = np.subtract(*np.median(pair[:, drawn], axis=-1))
    error = np.std(spread, ddof=1) * math.sqrt(blocks / (blocks - 1.0))
    if error > 0.0:
        return float(2.0 * stdtr(blocks - 1.0, -abs(apart) / error))
    return float(apart == 0.0)


def correct_by_holm(chances: Sequence[float]) -> FloatArray:
    """Return probabilities corrected for their number by Holm's rule, each in its place [1]."""
    p = np.asarray(chances, dtype=np.float64)
    order = np.argsort(p)
    ranks = np.arange(len(p), 0, -1)
    raised = np.maximum.accumulate(p[order] * ranks)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(raised, 1.0)
    return adjusted
