"""Standard errors of fitted parameters, from the derivatives that least squares use.

Errors of neighbouring windows share poses, commands and ground, so a block of time is one
observation: the sandwich H^-1 G H^-1 with the curvature H of the sum of errors that least squares
make small, and the scatter G of the blocks' gradients (P. Huber 1967; K.-Y. Liang and S. Zeger
1986). Nobody knows how long errors hang together, so blocks of twice, four times, ... the length
are tried too, and the widest result counts. Where the data say nothing, what remains is what the
bounds say. A search that has not come to its end is uncertain besides by how far least squares
would still go.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import stdtrit

from ssmr.metrics.bands import QUARTERS
from ssmr.types import FloatArray
from validation.identify.problem import IGNORANCE, PRIOR_M, PRIOR_S, FitProblem
from validation.identify.refine import NEAR_BOUND, Remembered, error_slopes, median_size
from validation.plants.table import plant_kind

_FEWEST_BLOCKS = 8  # fewer say too little about their own scatter
VAGUE = 0.2
"""A standard error of more than this share of the bounds' width says that the data hardly determine
the parameter; of the bounds alone it is 0.29."""
# correlation beyond which the data cannot tell two parameters apart, unless the standard errors of
# both are less than a share of the bounds' width
_ENTANGLED = 0.95
_WORTH_TELLING = 0.01
_WELL_KNOWN = 0.04  # share of its bounds' width to which a motion alone may determine the friction


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of fitted parameters."""

    standard_error: FloatArray
    """(n,) standard errors of the values; NaN where the motion could not be computed beside the
    optimum."""
    interval: FloatArray
    """(n, 2) 95 % intervals of the values by Student's distribution of the number of blocks, within
    the bounds."""
    correlation: FloatArray
    """(n, n) correlation of the errors."""
    share: FloatArray
    """(n,) standard error over the width of the bounds, in the unit cube [1]."""
    method: str
    """Sentence that says how they were found."""
    without: FloatArray
    """(QUARTERS, n) points of the unit cube that the data give without their first, second, ...
    part of time."""


def estimate(
    problem: FitProblem, point: FloatArray, workers: int | str = 1, driven: Remembered | None = None
) -> Uncertainty:
    """Estimate standard errors and correlations at the optimum, an (n,) point of the unit cube.

    What least squares have `driven` is not driven again: where the point is their end, only the
    other side of each difference is new. The difference between one-sided and central derivatives
    says how wrong they can be.
    """
    n = len(point)
    remembered = driven or Remembered()

    def errors_at(points: FloatArray) -> FloatArray:
        return remembered.look_up(points, lambda new: problem.residuals(new, workers))

    one_sided = error_slopes(errors_at, point)[1]
    with_prior, all_slopes = error_slopes(errors_at, point, central=True)
    # the prior is no observation: a number that no data determine gets the bounds' uncertainty
    k = len(problem.blocks)
    one_sided = one_sided[:k]
    errors = with_prior[:k]
    slopes = all_slopes[:k]
    finite = np.array(np.isfinite(slopes).all(axis=0) & np.isfinite(errors).all())
    covariance = np.full((n, n), np.nan)
    blocks = 0
    if finite.any():
        inner = np.ix_(finite, finite)
        covariance[inner], blocks = _widest(
            errors, slopes[:, finite], one_sided[:, finite], problem
        )
    # a search that was stopped is off by the rest of its way
    rest = _still_to_go(point, with_prior, all_slopes, problem)
    covariance += np.outer(rest, rest)
    share = np.sqrt(np.diag(covariance))
    scale = np.where(share > 0.0, np.outer(share, share), 1.0)
    correlation = np.where(np.isfinite(covariance), covariance / scale, 0.0)
    np.fill_diagonal(correlation, 1.0)
    reach = float(stdtrit(max(blocks - 1, 1), 0.975)) * np.nan_to_num(share)
    ends = [np.clip(point - reach, 0.0, 1.0), np.clip(point + reach, 0.0, 1.0)]
    return Uncertainty(
        share * problem.space.slopes(point),
        np.where(finite[:, None], np.stack(list(map(problem.space.values, ends)), axis=1), np.nan),
        correlation,
        share,
        f"derivatives of least squares and the scatter of {blocks} blocks of time, "
        "limited by the bounds",
        without=_without(point, with_prior, all_slopes, problem),
    )


def _soft(errors: FloatArray, robust: bool) -> tuple[FloatArray, FloatArray]:
    """Return each error's pull and stiffness in the unit of squares, of soft_l1 if robust."""
    q = 1.0 + robust * (errors / median_size(errors)) ** 2
    return errors / np.sqrt(q), q**-1.5


def _newton(slopes: FloatArray, stiffness: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the (n,) step of Newton's method down an (n,) gradient in the unit cube."""
    curvature = (slopes * stiffness[:, None]).T @ slopes
    return np.asarray(np.linalg.lstsq(curvature, -gradient)[0])


def _still_to_go(
    point: FloatArray, errors: FloatArray, slopes: FloatArray, problem: FitProblem
) -> FloatArray:
    """Return the (n,) step of Newton's method in the unit cube from the end of a search.

    It is nothing at an optimum, and 0 for a number that a bound holds.
    """
    pull, stiffness = _soft(errors, problem.robust)
    inside = np.abs(point - 0.5) < 0.5 - NEAR_BOUND
    free = np.nan_to_num(slopes[:, inside])
    step = np.zeros(len(point))
    step[inside] = _newton(free, stiffness, free.T @ pull)
    return np.clip(point + step, 0.0, 1.0) - point


def _without(
    point: FloatArray, errors: FloatArray, slopes: FloatArray, problem: FitProblem
) -> FloatArray:
    """Return (QUARTERS, n) points of the unit cube, each without a part of the time.

    They are one step of Newton's method away.
    """
    pull, stiffness = _soft(errors, problem.robust)
    slopes = np.nan_to_num(slopes)
    number = np.unique(problem.blocks, return_inverse=True)[1]
    part = number * QUARTERS // (number.max() + 1)
    prior = len(errors) - len(part)
    part = np.pad(part, (0, prior), constant_values=-1)  # the prior is in no part
    gradients = slopes * pull[:, None]
    # nothing at an optimum; where a bound holds a number, no reason to go
    gradients -= gradients.mean(axis=0)
    points = []
    for k in range(QUARTERS):
        rest = part != k
        points.append(point + _newton(slopes[rest], stiffness[rest], -gradients[~rest].sum(axis=0)))
    return np.clip(points, 0.0, 1.0)


def _widest(
    errors: FloatArray, slopes: FloatArray, one_sided: FloatArray, problem: FitProblem
) -> tuple[FloatArray, int]:
    """Return the widest (n, n) covariance in the unit cube, and its number of blocks."""
    pull, stiffness = _soft(errors, problem.robust)
    curvature = (slopes * stiffness[:, None]).T @ slopes
    gradients = slopes * pull[:, None]
    size = np.maximum((slopes**2).sum(axis=0), 1e-300)
    # a relative error of the second order is the square of that of the first
    relative = ((one_sided - slopes) ** 2).sum(axis=0) / size
    curvature_error = relative**2 * np.diag(curvature)
    _, member = np.unique(problem.blocks, return_inverse=True)
    covariances: list[tuple[FloatArray, int]] = []
    while (count := int(member.max()) + 1) >= _FEWEST_BLOCKS or not covariances:
        sums = np.zeros((count, len(curvature)))
        np.add.at(sums, member, gradients)
        covariances.append((_sandwich(curvature, curvature_error, sums), count))
        # neighbouring blocks in pairs
        member = member // 2
    return max(covariances, key=lambda one: float(np.trace(one[0])))


def _sandwich(curvature: FloatArray, curvature_error: FloatArray, sums: FloatArray) -> FloatArray:
    """Return the (n, n) covariance of a curvature and the (B, n) sums of gradients in each block.

    The curvature of the ignorance, R = (noise / IGNORANCE^2) 1, is added to H, and the ignorance
    itself to the scatter: a direction that no error sees gets IGNORANCE, one that all see is not
    touched, and none gets more: where the scatter of a few blocks claims more than the bounds
    allow, the bounds say more than it. The (n,) `curvature_error` is that of finite differences of
    the second order, whose relative error is about the square of that of the first. It counts
    too: otherwise numbers that the data cannot tell apart would be told apart by errors of the
    derivatives.
    """
    blocks = len(sums)
    centred = sums - sums.mean(axis=0)  # at an optimum of least squares the mean is nothing
    scatter = centred.T @ centred * (blocks / max(blocks - 1, 1))
    noise = float(np.trace(scatter)) / max(float(np.trace(curvature)), 1e-300)
    ridge = np.diag(np.maximum(max(noise, 1e-300) / IGNORANCE**2, curvature_error))
    inverse = np.linalg.inv(curvature + ridge)
    spread, axes = np.linalg.eigh(inverse @ (scatter + (ridge * IGNORANCE) ** 2) @ inverse)
    return (axes * np.clip(spread, 0.0, IGNORANCE**2)) @ axes.T


def sentences(problem: FitProblem, uncertainty: Uncertainty) -> list[str]:
    """Return sentences on the parameters that the data leave open or confuse, and on the prior."""
    out = []
    names = problem.space.names
    share = uncertainty.share
    touched = set[str]()
    advice = "use --fix"
    if problem.robust:
        advice = "the weak prior holds it near its value of before"
    for name, s in zip(names, share, strict=True):
        if s > VAGUE:
            touched.add(name)
            out.append(
                f"The data hardly determine {name}: its standard error is {s:.0%} of its bounds' "
                f"width; {advice}."
            )
    for i, j in combinations(range(len(names)), 2):
        r = float(uncertainty.correlation[i, j])
        if abs(r) > _ENTANGLED and max(share[i], share[j]) > _WORTH_TELLING:
            touched |= {names[i], names[j]}
            out.append(
                f"The data cannot tell {names[i]} and {names[j]} apart (correlation {r:+.2f})."
            )
    if problem.robust:
        out.append(
            "The value of each number before the fit is a weak prior: "
            f"to leave it by {IGNORANCE:.0%} of the bounds' width costs as much as "
            f"{PRIOR_M:g} m for {PRIOR_S:g} s."
        )
    if plant_kind(problem.model).torques and not problem.torques and "friction" in names:
        k = names.index("friction")
        if share[k] > _WELL_KNOWN or "friction" in touched:
            error = uncertainty.standard_error[k]
            out.append(
                "The path hardly tells friction: its standard error is "
                f"{error:.2g}. The way a robot turns determines the ratio of its friction across "
                "to that along, not the friction. The motors' torques tell it: compare those of "
                "mujoco or four_wheel, or a log's currents, for which it needs --torque-constant."
            )
    return out
