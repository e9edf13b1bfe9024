"""The formulas of self-adaptive differential evolution, as functions of arrays: mutation, repair, crossover, selection.

Sources: thesis Sec. 3.5.1; J. Brest et al. 2006, doi 10.1109/TEVC.2006.872133. Symbols: S vectors (NP) of n genes, i one of
them; F scales differences, CR is the share of genes crossed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray

Strategy = Literal["best/2", "rand/1", "best/1"]
Crossover = Literal["bin", "exp"]
_Indices = NDArray[np.intp]
_Mask = NDArray[np.bool_]

PARTNERS: Mapping[str, int] = {"best/2": 4, "rand/1": 3, "best/1": 2}
"""Number of vectors, distinct and other than i, that a strategy draws (nr of Tab. 3.7)."""
CROSSOVERS = ("bin", "exp")


def adapt(values: FloatArray, draws: FloatArray, bounds: tuple[float, float], tau: float, descent: float) -> FloatArray:
    """Return (S,) F or CR of the trials (Sec. 3.5.1): drawn anew with probability tau, else lowered, not below the least.

    The first row of the (2, S) draws, uniform in [0, 1), decides whether to draw anew, the second gives the new value;
    `descent` is slp (ng - 1) / ng_max.
    """
    low, high = bounds
    return np.where(draws[0] < tau, low + (high - low) * draws[1], np.maximum(values - values * descent, low))


def distinct_partners(draws: FloatArray) -> _Indices:
    """Return, for each i, k indices that differ from each other and from i; every ordered choice is equally likely.

    The j-th index is drawn from the S - 1 - j that are left, then counted past the taken ones in increasing order. Draws
    are (k, S), uniform in [0, 1), and k < S; column i of the (k, S) indices belongs to vector i.
    """
    k, size = draws.shape
    left = (size - 1 - np.arange(k, dtype=np.float64))[:, np.newaxis]
    indices: _Indices = (draws * left).astype(np.intp)
    taken = [np.arange(size)]  # increasing, for each column
    for j in range(k):
        index = indices[j]
        for t in taken:
            index += index >= t
        if j + 1 < k:
            carried = index
            for m, t in enumerate(taken):
                taken[m], carried = np.minimum(t, carried), np.maximum(t, carried)
            taken.append(carried)
    return indices


def mutate(
    strategy: Strategy, population: FloatArray, best: FloatArray, f: FloatArray, partners: _Indices
) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) or (S, n) base vectors, and the (S, n) donors V_i that start from them and may leave the cube.

    best/2: V = X_best + F (X_r1 - X_r2) + F (X_r3 - X_r4) (Sec. 3.5.1); best/1: V = X_best + F (X_r1 - X_r2);
    rand/1: V = X_r1 + F (X_r2 - X_r3). The (k, S) partners are the indices r1 to rk.
    """
    x = population[partners]
    if strategy == "rand/1":
        base, difference = x[0], x[1] - x[2]
    else:
        base, difference = best, x[0] - x[1]
        if strategy == "best/2":
            difference += x[2]
            difference -= x[3]
    difference *= f[:, np.newaxis]
    difference += base
    return base, difference


def repair(donors: FloatArray, base: FloatArray) -> FloatArray:
    """Return (S, n) donors whose genes beyond a bound of the cube lie midway between the base vector's and that bound."""
    inside = np.where(donors < 0.0, 0.5 * base, donors)
    return np.where(donors > 1.0, 0.5 + 0.5 * base, inside)


def binomial_mask(cr: FloatArray, draws: FloatArray, first: _Indices) -> _Mask:
    """Return an (S, n) mask of the genes that come from the donor: each with probability CR, and gene `first` always.

    The (S, n) draws are uniform in [0, 1).
    """
    mask = draws < cr[:, np.newaxis]
    mask[np.arange(len(cr)), first] = True
    return mask


def exponential_mask(cr: FloatArray, draws: FloatArray, first: _Indices, n: int) -> _Mask:
    """Return an (S, n) mask of the genes that come from the donor: a run from `first` that wraps around the end.

    The p-th gene after `first` belongs to the run with probability CR^p; the (S,) draws are uniform in [0, 1).
    """
    after = (np.arange(n) - first[:, np.newaxis]) % n
    return draws[:, np.newaxis] < cr[:, np.newaxis] ** after


def replaces(trial_costs: FloatArray, parent_costs: FloatArray) -> _Mask:
    """Return (S,) whether each trial replaces its parent: it does if its cost is finite and not worse."""
    return np.isfinite(trial_costs) & (trial_costs <= parent_costs)
