"""Standard errors of fitted parameters, from the derivatives that least squares use.

Errors of neighbouring windows share poses, commands and ground, so a block of time is one
observation: the jackknife takes out each, by one step of Newton's method (M. Quenouille 1956; J.
Tukey 1958). Nobody knows how long errors hang together, so blocks of twice, four times, ... the
length are tried too, and the widest result counts. Where the data say nothing, what remains is what
the bounds or the profile's prior say. A search that has not come to its end is uncertain besides by
how far least squares would still go. Where torques are compared, the shape of the tyres is a guess
that counts too: lines push with some hundredths more than points of the same friction.

A robot is not quite the same on two days. With four logs or more each number is drawn for each log
around the robot's (random effects): its spread is what the logs' own numbers differ by beyond their
own errors (R. Paule and J. Mandel 1982).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import stdtrit

from ssmr.metrics.bands import QUARTERS
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray, IndexArray
from validation.identify.problem import IGNORANCE, NORMAL, FitProblem
from validation.identify.refine import (
    NEAR_BOUND,
    STEP,
    Remembered,
    error_slopes,
    median_size,
)
from validation.plants.searchable import own_indices
from validation.plants.table import plant_kind

_FEWEST_BLOCKS = 8  # fewer say too little about their own scatter
VAGUE = 0.7
"""A standard error of more than this share of what is known without the data, by the bounds or the
profile's prior, says that the data hardly determine the parameter."""
# correlation beyond which the data cannot tell two parameters apart, unless the standard errors of
# both are less than a share of the bounds' width
_ENTANGLED = 0.95
_WORTH_TELLING = 0.01
# error of a sum of delays over the largest of theirs below which only the sum is told: that of two
# with a correlation of -0.9
_TOGETHER = 0.45
_SHIFT = {"delay": 1.0, "position_late": -1.0, "yaw_late": -1.0}
"""Delays that may change together without any change in a log: a robot that answers later, and a
localiser that is as much earlier."""
_WELL_KNOWN = 0.04  # share of its bounds' width to which a motion alone may determine the friction
FEWEST_DAYS = 4
"""Fewest logs that tell how much a robot's body differs from day to day."""
_ROUNDS = 20
"""Number of times that the errors of a day are weighted anew."""
USUAL_SPREAD = 0.03
"""Standard deviation of most numbers from day to day where no logs tell it, as a share of their
bounds' width [1]."""
_USUAL_SPREADS = {
    **dict.fromkeys(("alpha_l", "alpha_r"), 0.0067),
    **dict.fromkeys(("y_l", "y_r"), 0.02),
    "drift": 0.083,
    "tracked_yaw": 0.01,
    **dict.fromkeys(("position_late", "yaw_late"), 0.04),
}
"""The same of the kinematic plant's: on eight days of a Warthog 0.006 of the radius, 2.5 cm of a
centre of rotation, 0.05 s of drift, 6 mrad of the mount and 0.08 s of lateness."""


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
    untold: NDArray[np.bool_]
    """(n,) numbers that the data hardly determine: their standard errors are about as large as
    what is known without data."""
    method: str
    """Sentence that says how they were found."""
    without: FloatArray
    """(P, n) points of the unit cube that the data give without their first, second, ... part: one
    of the `QUARTERS` of time, or with `FEWEST_DAYS` logs or more one log."""
    spread: Mapping[str, float]
    """Standard deviation of each number from one day to another, by name; empty of scenarios."""


def estimate_uncertainty(
    problem: FitProblem,
    point: FloatArray,
    workers: int | str = 1,
    driven: Remembered | None = None,
    foreseen: bool = False,
) -> Uncertainty:
    """Estimate standard errors and correlations at the optimum, an (n,) point of the unit cube.

    With `foreseen` a search begins at the point, and errors are those to which derivatives lead.
    What least squares have `driven` is not driven again: where they took differences within a step
    of it, only their other sides are new. One-sided less central derivatives: how wrong these are.
    """
    n = len(point)
    remembered = driven or Remembered()

    def errors_at(points: FloatArray) -> FloatArray:
        return remembered.look_up(points, lambda new: problem.residuals(new, workers))

    at = remembered.around
    if np.abs(at - point).max() >= STEP:
        at = point
    one_sided = error_slopes(errors_at, at)[1]
    all_slopes = error_slopes(errors_at, at, central=True)[1]
    here = with_prior = errors_at(point[None])[0]
    k = len(problem.blocks)
    if foreseen:
        ahead, _ = _of_a_day(here[:k], all_slopes[:k], problem.blocks)
        with_prior = here + all_slopes @ ahead
    # all in the unit of the pulls, the median size of errors
    unit = np.ones(len(with_prior))
    unit[:k] = median_size(with_prior, problem)
    with_prior = with_prior / unit
    all_slopes = all_slopes / unit[:, None]
    one_sided = (one_sided / unit[:, None])[:k]
    # the prior is no observation: a number that no data determine gets the bounds' uncertainty
    errors = with_prior[:k]
    slopes = all_slopes[:k]
    finite = np.array(np.isfinite(slopes).all(axis=0) & np.isfinite(errors).all())
    covariance = np.full((n, n), np.nan)
    blocks = 0
    if finite.any():
        inner = np.ix_(finite, finite)
        covariance[inner], blocks = _widest_covariance(
            errors,
            slopes[:, finite],
            one_sided[:, finite],
            problem,
            _prior_deviations(problem)[finite],
        )
    # a search that was stopped is off by the rest of its way
    rest = _still_to_go(point, with_prior, all_slopes, problem)
    offs = [rest, _shift_deviations(point, problem)]
    method = f"derivatives of least squares and the scatter of {blocks} blocks of time"
    other = problem.with_other_tyres()
    if other is not None:
        change = (other.residuals(point[None], workers)[0] - here) / unit
        offs.append(_step_against(change, with_prior, all_slopes, problem))
        method += ", and what tyres of another shape would change"
    for off in offs:
        covariance += np.outer(off, off)
    spread: dict[str, float] = {}
    if problem.robust:
        covariance, spread = _with_days(point, errors, slopes, covariance, problem)
    share = np.sqrt(np.diag(covariance))
    scale = np.where(share > 0.0, np.outer(share, share), 1.0)
    correlation = np.where(np.isfinite(covariance), covariance / scale, 0.0)
    np.fill_diagonal(correlation, 1.0)
    reach = stdtrit(max(blocks - 1, 1), 0.975) * np.nan_to_num(share)
    ends = [np.clip(point - reach, 0.0, 1.0), np.clip(point + reach, 0.0, 1.0)]
    return Uncertainty(
        share * problem.space.slopes(point),
        np.where(finite[:, None], np.stack(list(map(problem.space.values, ends)), axis=1), np.nan),
        correlation,
        share,
        share >= VAGUE * _prior_deviations(problem),
        f"{method}, limited by the bounds",
        without=_points_without_parts(point, with_prior, all_slopes, problem),
        spread=spread,
    )


def usual_spread(name: str) -> float:
    """Return the standard deviation of a number from day to day, in the unit cube [1]."""
    return _USUAL_SPREADS.get(name.partition("@")[0], USUAL_SPREAD)


def _prior_deviations(problem: FitProblem) -> FloatArray:
    """Return the (n,) standard deviations of numbers without any data, in the unit cube."""
    return np.minimum(IGNORANCE, problem.spread)


def _shift_deviations(point: FloatArray, problem: FitProblem) -> FloatArray:
    """Return how far `_SHIFT` may be, as (n,) deviations in the unit cube.

    The driver reads commands at instants of its own, so the cost has a valley each 0.05 s along it:
    derivatives see one of these, and nothing but the bounds tells them apart.
    """
    names = [name.partition("@")[0] for name in problem.space.names]
    if not set(_SHIFT) <= set(names):
        return np.zeros(len(point))
    second = np.array([_SHIFT.get(name, 0.0) for name in names]) / problem.space.slopes(point)
    return IGNORANCE / np.linalg.norm(second) * second


def _pull_and_stiffness(errors: FloatArray, robust: bool) -> tuple[FloatArray, FloatArray]:
    """Return each error's pull and stiffness in the unit of squares, of soft_l1 if robust."""
    q = 1.0 + robust * errors**2
    return errors / np.sqrt(q), q**-1.5


def _newton_step(slopes: FloatArray, stiffness: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the (n,) step of Newton's method down an (n,) gradient in the unit cube."""
    curvature = (slopes * stiffness[:, None]).T @ slopes
    return np.asarray(np.linalg.lstsq(curvature, -gradient)[0])


def _still_to_go(
    point: FloatArray, errors: FloatArray, slopes: FloatArray, problem: FitProblem
) -> FloatArray:
    """Return the (n,) step of Newton's method in the unit cube from the end of a search.

    It is nothing at an optimum, and 0 for a number that a bound holds.
    """
    pull, stiffness = _pull_and_stiffness(errors, problem.robust)
    inside = np.abs(point - 0.5) < 0.5 - NEAR_BOUND
    free = np.nan_to_num(slopes[:, inside])
    step = np.zeros(len(point))
    step[inside] = _newton_step(free, stiffness, free.T @ pull)
    return np.clip(point + step, 0.0, 1.0) - point


def _step_against(
    change: FloatArray, errors: FloatArray, slopes: FloatArray, problem: FitProblem
) -> FloatArray:
    """Return the (n,) step in the unit cube that makes up best for a (K,) change of the errors.

    Each error counts as much as the loss lets it at the optimum.
    """
    weight = (1.0 + problem.robust * errors**2) ** -0.25
    weighted = np.nan_to_num(slopes) * weight[:, None]
    return np.asarray(-np.linalg.lstsq(weighted, weight * change)[0])


def _points_without_parts(
    point: FloatArray, errors: FloatArray, slopes: FloatArray, problem: FitProblem
) -> FloatArray:
    """Return (P, n) points of the unit cube, each without a part of the time, or without a log.

    They are one step of Newton's method away.
    """
    pull, stiffness = _pull_and_stiffness(errors, problem.robust)
    slopes = np.nan_to_num(slopes)
    number = np.unique(problem.blocks, return_inverse=True)[1]
    part = number * QUARTERS // (number.max() + 1)
    if len(problem.days) >= FEWEST_DAYS:
        part = problem.day_numbers
    prior = len(errors) - len(part)
    part = np.pad(part, (0, prior), constant_values=-1)  # the prior is in no part
    gradients = slopes * pull[:, None]
    # nothing at an optimum; where a bound holds a number, no reason to go
    gradients -= gradients.mean(axis=0)
    steps = [
        _newton_step(slopes[part != k], stiffness[part != k], -gradients[part == k].sum(axis=0))
        for k in range(part.max() + 1)
    ]
    return np.clip(point + np.array(steps), 0.0, 1.0)


def _with_days(
    point: FloatArray,
    errors: FloatArray,
    slopes: FloatArray,
    covariance: FloatArray,
    problem: FitProblem,
) -> tuple[FloatArray, dict[str, float]]:
    """Return the covariance of the robot's numbers, and how far another day's may be from them.

    The former is in the unit cube, with what the mean of days leaves open; the latter are standard
    deviations in each number's unit, by name. Numbers of single logs differ by themselves; of the
    body every log has an estimate of its own.
    """
    slopes = np.nan_to_num(slopes)
    values = np.tile(point, (len(problem.days), 1))
    variances = np.full(values.shape, IGNORANCE**2)
    for k, day in enumerate(problem.days):
        rows = np.flatnonzero(problem.day_numbers == k)
        columns = list(day.columns)
        own = slopes[rows][:, columns]
        step, own_covariance = _of_a_day(errors[rows], own, problem.blocks[rows])
        values[k, columns] += step
        variances[k, columns] = np.diag(own_covariance)
    wider = covariance.copy()
    units = problem.space.slopes(point)
    spread = {}
    for name, places in own_indices(problem.space.names, ()).items():
        k = places[0]
        several = point[places]
        own_variances = np.diag(covariance)[places]
        if len(places) == 1:
            several = np.clip(values[:, k], 0.0, 1.0)
            own_variances = variances[:, k]
        # a few days may be alike by chance: what is usual counts as one more
        square = usual_spread(name) ** 2
        if len(places) > 1 or len(values) >= FEWEST_DAYS:
            count = len(several)
            square = (square + (count - 1) * _beyond_errors(several, own_variances) ** 2) / count
        if name in problem.space.names and len(values) >= FEWEST_DAYS:
            wider[k, k] += square / len(values)
        size = math.sqrt(square + np.nan_to_num(np.diag(wider)[places]).min())
        spread[name] = float(f"{size * units[k]:.3g}")
    return wider, spread


def _of_a_day(
    errors: FloatArray, slopes: FloatArray, blocks: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) step to a day's own optimum and its (n, n) covariance, in the unit cube.

    Where (K,) errors are linear with (K, n) slopes, weights that follow the errors find the optimum
    of soft_l1, with the ignorance as a prior.
    """
    _, member = np.unique(blocks, return_inverse=True)
    count = member.max() + 1
    prior = NORMAL**2 * len(errors) / count / IGNORANCE**2 * np.eye(slopes.shape[1])
    rest = errors
    for _ in range(_ROUNDS):
        size = max(np.median(np.abs(rest)), 1e-12)
        weighted = slopes / (size**2 * np.sqrt(1.0 + (rest / size) ** 2))[:, None]
        step = -np.linalg.solve(weighted.T @ slopes + prior, weighted.T @ errors)
        rest = errors + slopes @ step
    known = np.full(len(step), IGNORANCE)
    return step, _jackknife_covariance(
        slopes / size, _pull_and_stiffness(rest / size, True), member, 0.0 * known, known
    )


def _beyond_errors(values: FloatArray, variances: FloatArray) -> float:
    """Return the standard deviation of (D,) values beyond what their own variances explain."""
    most = len(values) * np.ptp(values) ** 2

    def excess(between: float) -> float:
        weights = 1.0 / (variances + between + 1e-12)
        mean = np.average(values, weights=weights)
        return float(weights @ (values - mean) ** 2) - len(values) + 1.0

    if not np.isfinite(variances).all() or excess(0.0) <= 0.0:
        return 0.0
    return np.sqrt(brentq(excess, 0.0, most))


def _widest_covariance(
    errors: FloatArray,
    slopes: FloatArray,
    one_sided: FloatArray,
    problem: FitProblem,
    known: FloatArray,
) -> tuple[FloatArray, int]:
    """Return the widest (n, n) covariance in the unit cube, and its number of blocks."""
    size = np.maximum((slopes**2).sum(axis=0), 1e-300)
    # a relative error of the second order is the square of that of the first
    relative = ((one_sided - slopes) ** 2).sum(axis=0) / size
    _, member = np.unique(problem.blocks, return_inverse=True)
    covariances: list[tuple[FloatArray, int]] = []
    while (count := member.max() + 1) >= _FEWEST_BLOCKS or not covariances:
        soft = _pull_and_stiffness(errors, problem.robust)
        covariances.append((_jackknife_covariance(slopes, soft, member, relative**2, known), count))
        # neighbouring blocks in pairs
        member = member // 2
    widest, count = max(covariances, key=lambda one: np.trace(one[0]))
    # each number has its own widest error: some are known by few blocks
    own = np.max([np.diag(one) for one, _ in covariances], axis=0)
    scale = np.sqrt(own / np.maximum(np.diag(widest), 1e-300))
    return widest * np.outer(scale, scale), count


def _jackknife_covariance(
    slopes: FloatArray,
    soft: tuple[FloatArray, FloatArray],
    member: IndexArray,
    doubt: FloatArray,
    known: FloatArray,
) -> FloatArray:
    """Return the (n, n) covariance of numbers by what they do without one block after the other.

    The `soft` are pull and stiffness of the errors with (K, n) slopes, which are members of blocks.
    The curvature of what is `known` without data, R = noise / known^2 of (n,) deviations, is added
    to that of the errors, and these deviations to the scatter: a direction that no error sees keeps
    them, one that all see is not touched, and none gets more than the bounds allow. The (n,)
    `doubt` is the relative error of the curvature by finite differences. It counts too: otherwise
    numbers that the data cannot tell apart would be told apart by errors of the derivatives.
    """
    pull, stiffness = soft
    count = member.max() + 1
    sums = np.zeros((count, slopes.shape[1]))
    np.add.at(sums, member, slopes * pull[:, None])
    centred = sums - sums.mean(axis=0)  # at an optimum of least squares the mean is nothing
    firm = slopes * stiffness[:, None]
    curvature = firm.T @ slopes
    noise = float((centred**2).sum()) / max(float(np.trace(curvature)), 1e-300)
    ridge = np.maximum(max(noise, 1e-300) / known**2, doubt * np.diag(curvature))
    curvature = curvature + np.diag(ridge)
    steps = []
    for k in range(count):
        own = member == k
        steps.append(np.linalg.solve(curvature - firm[own].T @ slopes[own], centred[k]))
    scatter = (1.0 - 1.0 / count) * np.transpose(steps) @ np.array(steps)
    inverse = np.linalg.inv(curvature)
    unseen = inverse @ np.diag((ridge * known) ** 2) @ inverse
    spread, axes = np.linalg.eigh(scatter + unseen)
    return (axes * np.clip(spread, 0.0, IGNORANCE**2)) @ axes.T


def _known_sums(space: ParameterSpace, uncertainty: Uncertainty, point: FloatArray) -> list[str]:
    """Return the sums of delays that are known much better than each of these, with their errors.

    A driver's dead time and lag and the lateness of a localiser all make a log later.
    """
    sums = []
    values = space.values(point)
    late = [name for name in space.names if name.startswith(("position_late", "yaw_late"))]
    for own in late or [""]:
        group = [k for k, n in enumerate(space.names) if n in ("delay", "wheel_lag", own)]
        errors = uncertainty.standard_error[group]
        square = errors @ uncertainty.correlation[np.ix_(group, group)] @ errors
        error = math.sqrt(abs(square))
        if len(group) > 1 and error < _TOGETHER * errors.max():
            total = " + ".join(space.names[k] for k in group)
            sums.append(f"{total} = {values[group].sum():.3f} ± {error:.3f} s")
    return sums


def uncertainty_sentences(
    problem: FitProblem, uncertainty: Uncertainty, point: FloatArray
) -> list[str]:
    """Return sentences on the parameters that the data leave open or confuse, and on the prior."""
    out = []
    names = problem.space.names
    sums = ", ".join(_known_sums(problem.space, uncertainty, point))
    share = uncertainty.share
    touched = set()
    advice = "it is little more than a guess" if problem.robust else "use --fix"
    known = _prior_deviations(problem) * problem.space.slopes(point)
    for k in np.flatnonzero(uncertainty.untold).tolist():
        p = problem.space.parameters[k]
        touched.add(p.name)
        errors = [p.text(float(f"{e:.2g}")) for e in (uncertainty.standard_error[k], known[k])]
        out.append(
            f"The data hardly determine {p.name}: its standard error is {errors[0]}, and "
            f"{errors[1]} would be the spread of one drawn from its bounds; {advice}."
        )
    for i, j in combinations(range(len(names)), 2):
        r = uncertainty.correlation[i, j]
        if names[i] in sums and names[j] in sums:
            continue
        if abs(r) > _ENTANGLED and max(share[i], share[j]) > _WORTH_TELLING:
            touched |= {names[i], names[j]}
            out.append(
                f"The data cannot tell {names[i]} and {names[j]} apart (correlation {r:+.2f})."
            )
    if sums:
        out.append(
            f"Delays are known together only, their parts are not: {sums}. Half of the assumed "
            f"hold of {problem.base.drive.hold:g} s is in each sum."
        )
    if plant_kind(problem.model).torques and not problem.torques and "friction" in names:
        k = names.index("friction")
        if share[k] > _WELL_KNOWN or "friction" in touched:
            error = uncertainty.standard_error[k]
            out.append(
                "The path hardly tells friction: its standard error is "
                f"{error:.2g}. The way a robot turns determines the ratio of its friction across "
                "to that along, not the friction. The motors' torques tell it: compare those of "
                "mujoco or four_wheel, or a log's (torque_left, torque_right, or currents, which "
                "need --torque-constant)."
            )
    return out
