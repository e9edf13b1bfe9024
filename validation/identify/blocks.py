"""Bounded least squares whose standard errors come from the scatter of blocks of data."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import least_squares

from ssmr.types import FloatArray

_MOST = 100  # most evaluations of a search, besides those for its derivatives
FitNumbers = Mapping[str, float]
"""FitNumbers of a fit by their names."""


Estimate = Mapping[str, FloatArray]
"""(2,) value and standard error of each number that a fit has found, by its name; the error is 0
where a bound holds the number or nothing depends on it."""


def values_of(found: Estimate) -> FitNumbers:
    """Return the values alone."""
    return {name: float(value) for name, (value, _) in found.items()}


def fit_in_blocks(
    residuals: Callable[[FitNumbers], FloatArray],
    numbers: Mapping[str, tuple[float, float, float]],
    blocks: FloatArray,
    size: float,
) -> Estimate:
    """Return the numbers within bounds whose residuals are least.

    Residuals beyond `size` count less than their square (`soft_l1`). Those of one block hang
    together, so a block is one observation. Standard errors are those of the jackknife: what the
    numbers do when one block after the other is left out, each by one step of Newton's method (M.
    Quenouille 1956; J. Tukey 1958).

    Args:
        residuals: function of the numbers that returns (K,) residuals.
        numbers: start, least and greatest value of each; the start is of the usual size.
        blocks: (K,) name of the block of each residual.
        size: see above, in the residuals' unit.
    """
    start, low, high = np.array(list(numbers.values())).T

    def named(values: FloatArray) -> FitNumbers:
        return dict(zip(numbers, values.tolist(), strict=True))

    end = least_squares(
        lambda x: residuals(named(x)),
        start,
        bounds=(low, high),
        x_scale=start,
        loss="soft_l1",
        f_scale=size,
        diff_step=1e-3,
        max_nfev=_MOST,
    )
    # scipy's Jacobian is scaled such that its square is the curvature of the loss
    slopes = np.where(end.active_mask == 0, end.jac * start, 0.0)
    pulls = end.fun * (1.0 + (end.fun / size) ** 2) ** 0.25
    curvature = slopes.T @ slopes
    steps = []
    for block in np.unique(blocks):
        own = slopes[blocks == block]
        without = np.linalg.pinv(curvature - own.T @ own, hermitian=True)
        steps.append(without @ (pulls[blocks == block] @ own))
    errors = start * np.sqrt((1.0 - 1.0 / len(steps)) * np.sum(np.square(steps), axis=0))
    return dict(zip(numbers, np.column_stack([end.x, errors]), strict=True))
