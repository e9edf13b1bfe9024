"""Whether a model ranks controllers as the robot does: places, rank correlation, and the regret of a choice.

Costs are (R, C) arrays, a row for each reference and a column for each controller; infinite where the robot was lost.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau

from ssmr.types import FloatArray


def mean_costs(costs: FloatArray) -> FloatArray:
    """Return the (C,) mean costs over the references that were kept; NaN for a controller that lost all."""
    kept = np.isfinite(costs)
    count = kept.sum(axis=0)
    return np.where(count > 0, np.where(kept, costs, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def places(costs: FloatArray) -> NDArray[np.intp]:
    """Return the (C,) places of controllers, 0 for the best; equal ones share a place.

    Who loses fewer references is placed before who loses more, whatever the cost; among equals the mean cost of the
    references that were kept decides.
    """
    keys = np.column_stack([np.isinf(costs).sum(axis=0), np.nan_to_num(mean_costs(costs))])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


def rank_correlation(costs: FloatArray, others: FloatArray) -> float:
    """Return Kendall's tau-b between the places on two plants [-1 to 1]; NaN where one of them has all in one place."""
    return float(kendalltau(places(costs), places(others)).statistic)


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
        return math.inf
    means = mean_costs(truth)
    return float(means[chosen] / means[best] - 1.0) if means[best] > 0.0 else 0.0


def agreement(costs: FloatArray, truth: FloatArray) -> dict[str, Any]:
    """Compare a model's (R, C) costs with the true ones.

    Returns:
        `tau`, the rank correlation of the controllers; `chosen`, the column of the one that the model puts first; `regret`
        of that choice as a share; and `same_winner`, the number of references on which both have the same best controller.
    """
    same = sum(choice(costs[[k]], truth[[k]]) == choice(truth[[k]], truth[[k]]) for k in range(len(truth)))
    tau, chosen = rank_correlation(costs, truth), choice(costs, truth)
    return {"tau": tau, "chosen": chosen, "regret": regret(costs, truth), "same_winner": same}
