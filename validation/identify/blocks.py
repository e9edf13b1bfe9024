"""Bounded least squares whose standard errors come from the scatter of blocks of data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ssmr.types import FloatArray

_MOST = 100  # most evaluations of a search, besides those for its derivatives
Numbers = Mapping[str, float]
"""Numbers of a fit by their names."""


class Estimate(NamedTuple):
    """Numbers that a fit has found."""

    values: Numbers  # the numbers
    errors: Numbers  # their standard errors; 0 where a bound holds the number or nothing depends on it

    def pairs(self) -> dict[str, FloatArray]:
        """Return (2,) value and standard error of each number by its name."""
        return {name: np.array([value, self.errors[name]]) for name, value in self.values.items()}


def fit_in_blocks(
    residuals: Callable[[Numbers], FloatArray],
    numbers: Mapping[str, tuple[float, float, float]],
    blocks: FloatArray,
    size: float,
) -> Estimate:
    """Return the numbers within bounds whose residuals are least.

    Residuals beyond `size` count less than their square (`soft_l1`). Those of one block hang together,
    so a block is one observation: standard errors are those of the sandwich H^-1 G H^-1, with the
    curvature H of the sum of errors and the scatter G of the blocks' gradients (P. Huber 1967).

    Args:
        residuals: function of the numbers that returns (K,) residuals.
        numbers: start, least and greatest value of each; the start is of the usual size.
        blocks: (K,) name of the block of each residual.
        size: see above, in the residuals' unit.
    """
    start, low, high = np.array(list(numbers.values())).T

    def named(values: FloatArray) -> Numbers:
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
    pulls = end.fun * (1.0 + (end.fun / size) ** 2) ** 0.25
    slopes = np.where(end.active_mask == 0, end.jac, 0.0)
    own = blocks[:, None] == np.unique(blocks)
    scatter = own.T @ (slopes * pulls[:, None])
    steps = scatter @ np.linalg.pinv(slopes.T @ slopes)
    errors = np.sqrt((steps**2).sum(axis=0) * len(steps) / (len(steps) - 1.0))
    return Estimate(named(end.x), named(errors))
