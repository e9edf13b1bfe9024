"""Whether a model ranks controllers as the robot does: places, rank correlation, and the regret of a choice.

Costs are (R, C) arrays, a row for each reference and a column for each controller; infinite where the robot was lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau

from ssmr.types import FloatArray

RESAMPLES = 300
"""Number of times that the references are drawn anew for an interval."""
_TAIL = 0.05
"""Share of the draws beyond each end of an interval."""

Interval90 = tuple[float, float]
"""The ends of an interval that holds 90 % of the draws."""


def places(costs: FloatArray) -> NDArray[np.int64]:
    """Return the (C,) places of controllers, 0 for the best; equal ones share a place.

    Who loses fewer references is placed before who loses more, whatever the cost; among equals the mean cost of the
    references that were kept decides.
    """
    lost, means = np.isinf(costs).sum(axis=0), mean_costs(costs)
    keys = [(int(n), float(mean)) for n, mean in zip(lost, np.nan_to_num(means), strict=True)]
    order = {key: place for place, key in enumerate(sorted(set(keys)))}
    return np.array([order[key] for key in keys], dtype=np.int64)


def mean_costs(costs: FloatArray) -> FloatArray:
    """Return the (C,) mean costs over the references that were kept; NaN for a controller that lost all."""
    kept = np.isfinite(costs)
    count = kept.sum(axis=0)
    return np.where(count > 0, np.where(kept, costs, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def rank_correlation(costs: FloatArray, others: FloatArray) -> float:
    """Return Kendall's tau-b between the places on two plants [-1 to 1]; NaN where one of them has all in one place."""
    a, b = places(costs), places(others)
    if len(set(a.tolist())) < 2 or len(set(b.tolist())) < 2:
        return float("nan")
    return float(kendalltau(a, b).statistic)


def choice(costs: FloatArray, truth: FloatArray) -> int:
    """Return the column of the controller in the first place; of several there, the one that is worst in truth."""
    first = np.flatnonzero(places(costs) == 0)
    return int(first[np.argmax(places(truth)[first])])


def regret(costs: FloatArray, truth: FloatArray) -> float:
    """Return how much more the choice by `costs` costs in `truth` than the best choice, as a share of that one's cost.

    It is infinite where the choice loses more references than the best; of choices that lose as many, kept references count.
    """
    chosen, best = choice(costs, truth), choice(truth, truth)
    if np.isinf(truth[:, chosen]).sum() > np.isinf(truth[:, best]).sum():
        return float("inf")
    means = mean_costs(truth)
    return float(means[chosen] / means[best] - 1.0) if means[best] > 0.0 else 0.0


@dataclass(frozen=True)
class Agreement:
    """The agreement of a model with the truth on which controller is better."""

    tau: float
    """Kendall's rank correlation of the controllers; NaN where there is none."""
    tau_interval: Interval90
    """Its interval, over references drawn anew."""
    chosen: int
    """Column of the controller that the model chooses over all references."""
    regret: float
    """Additional cost of that choice, as a share; infinite where it loses references that the best keeps."""
    regret_interval: Interval90
    """Its interval, over references drawn anew."""
    same_winner: int
    """Number of references on which model and truth have the same best controller."""


def agreement(
    costs: FloatArray, truth: FloatArray, names: Sequence[str], seed: int, resamples: int = RESAMPLES
) -> Agreement:
    """Compare a model's costs with the true ones.

    Args:
        costs: (R, C) of the model.
        truth: (R, C) of the robot.
        names: R names of the references; those of one name, at several speeds, are drawn together.
        seed: seed of the draws.
        resamples: number of draws; with none the intervals are NaN.
    """
    rng, groups = np.random.default_rng(seed), list(dict.fromkeys(names))
    rows = [np.flatnonzero(np.array(names) == name) for name in groups]
    drawn = [np.concatenate([rows[k] for k in rng.integers(len(rows), size=len(rows))]) for _ in range(resamples)]
    taus = [rank_correlation(costs[some], truth[some]) for some in drawn]
    regrets = [regret(costs[some], truth[some]) for some in drawn]
    same = sum(choice(costs[[k]], truth[[k]]) == choice(truth[[k]], truth[[k]]) for k in range(len(truth)))
    return Agreement(
        rank_correlation(costs, truth), _interval(taus),
        choice(costs, truth), regret(costs, truth), _interval(regrets), same,
    )  # fmt: skip


def _interval(values: Sequence[float]) -> Interval90:
    known = sorted(value for value in values if not np.isnan(value))
    if not known:
        return float("nan"), float("nan")
    at = [round(share * (len(known) - 1)) for share in (_TAIL, 1.0 - _TAIL)]
    return known[at[0]], known[at[1]]
