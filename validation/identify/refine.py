"""The later stages of a fit: bounded least squares on the errors themselves, and a simplex.

Least squares begin at the best candidate of the first stage, and at others far from it.

A cost is one number; the errors that it is made of are thousands, and how each changes with each
parameter says where the optimum lies. `scipy.optimize.least_squares` (trust region, within the unit
cube) goes there in some tens of motions. The derivatives of a step are finite differences of one
population. Where a motion is dear, they are differences where a descent begins, and a rank-one
update learns from each long step how errors changed (C. G. Broyden 1965); another descent follows
with new differences. What was driven is remembered, so a search that was interrupted goes on by
driving only what is new, and comes to the same end.

What a cost has beyond its errors' squares, the greatest distance between two paths say, least
squares do not see. There the simplex of J. Nelder and R. Mead (1965) goes on by the cost alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np
from scipy.optimize import Bounds, least_squares, minimize

from ssmr.types import FloatArray

STARTS = 3
"""Greatest number of starts: the best candidate, and others far from where least squares have
been."""
APART = 0.25
"""Least distance of a start from the earlier ones and from where they led, in the unit cube's
widest direction [1]."""
STEP = 0.02
"""Step of the finite differences, in the unit cube. Delays are rounded to steps of the physics, 2
ms of usually 0.6 s, so a much smaller one would measure the rounding."""
_INSIDE = 1e-6
"""Distance from the bounds that the search keeps, in the unit cube."""
NEAR_BOUND = 1e-3
"""Distance from a bound within which it holds a parameter, in the unit cube."""
_TOLERANCE = 1e-4
"""Relative change of the sum of squares, or of the point, at which least squares end."""
FINE = 1e-6
"""The same where motions are cheap."""
_MOST_DESCENT = 25
"""Greatest number of steps from one start, with one scale."""
_MOST_FINE = 60
"""The same where motions are cheap."""
_TRIAL = 10
"""Number of steps after which a later start may be given up."""
HOPELESS = 2.0
"""Ratio of its errors to those at the best end before, beyond which it is given up [1]."""
_MOST_SCALES = 5
"""Greatest number of times that robust least squares begin with a new scale, the errors' median
size: far from the optimum all errors are large, and the scale with them. Errors that count by their
square have one scale; where derivatives are guessed on the way, a second descent has new ones."""
_SIMPLEX = 0.05
"""Length of a simplex that begins, in the unit cube."""
_SIMPLEX_END = 1e-3
"""Length in the unit cube, and share of the cost, at which a simplex ends; the least share of the
cost that it must gain for another to follow."""
_MOST_SIMPLICES = 8
"""Greatest number of simplices, each of which begins where the last one ended."""
_SAME_SCALE = 0.8
"""Ratio of a scale to the one before, beyond which there is no new one [1]."""


ErrorsAt = Callable[[FloatArray], FloatArray]
"""A function that returns (S, K) errors of (S, n) points of the unit cube."""


class Residuals(Protocol):
    """A problem whose errors are known one by one, such as a `FitProblem`."""

    @property
    def robust(self) -> bool:
        """Whether errors beyond their median count by size, not by square (`soft_l1`)."""

    @property
    def cheap(self) -> bool:
        """Whether many motions cost little, so that the optimum may be found finely."""

    @property
    def dear(self) -> bool:
        """Whether a motion costs so much that derivatives are guessed from those of before."""

    @property
    def pulls(self) -> int:
        """Number of the last errors, those of a prior in the unit of the others' median size."""

    def residuals(self, points: FloatArray, workers: int | str) -> FloatArray:
        """Return (S, K) errors of (S, n) points of the unit cube; NaN for an impossible one."""


class Remembered(dict[bytes, FloatArray]):
    """Errors that least squares have driven: (K,) by the bytes of their (n,) point."""

    around: FloatArray = np.array(math.inf)
    """(n,) point at which differences were taken last; infinite where none were."""

    def correct(self, point: FloatArray) -> None:
        """Learn how wrong errors are around an (n,) point where a descent begins: not at all."""

    def look_up(self, points: FloatArray, drive: ErrorsAt) -> FloatArray:
        """Return (S, K) errors of (S, n) points; `drive` is called with the new ones alone."""
        new = {point.tobytes(): point for point in points if point.tobytes() not in self}
        if new:
            driven = drive(np.array(list(new.values())))
            self.update(zip(new, map(np.array, driven), strict=True))
        return np.array([self[point.tobytes()] for point in points])


class Corrected(Remembered):
    """Errors of a problem that costs less, with the true ones where a descent begins.

    Nearby they differ from the true ones by what both have changed since, and that is little: the
    true problem is driven once for each descent, and derivatives are those of the other.
    """

    shift: FloatArray | float = 0.0
    """(K,) true errors less the others, where the last descent began."""

    def __init__(
        self,
        other: ErrorsAt,
        true: ErrorsAt,
    ) -> None:
        """Begin with functions that return (S, K) errors of (S, n) points."""
        super().__init__()
        self._other = other
        self._true = true

    def look_up(self, points: FloatArray, drive: ErrorsAt) -> FloatArray:
        """Return (S, K) corrected errors, see `Remembered`."""
        return super().look_up(points, drive) + self.shift

    def correct(self, point: FloatArray) -> None:
        """Correct errors from now on by the true ones at an (n,) point."""
        self.shift = (self._true(point[None]) - super().look_up(point[None], self._other))[0]


def descent_ends(
    problem: Residuals,
    points: FloatArray,
    costs: FloatArray,
    starts: int,
    driven: Remembered,
    workers: int | str,
    on_step: Callable[[], object],
) -> Iterator[FloatArray]:
    """Yield the (n,) ends of least squares from some of (S, n) candidates with (S,) costs.

    The first start is the best candidate. A later one is the end before it with some parameters
    reset to mid-range, see `_restart_in_middle`, or else the best candidate that is far from all
    that was visited. What was `driven` before is not driven again, and `on_step` is called after
    every population. An interrupt passes through.
    """

    def errors_at(new: FloatArray) -> FloatArray:
        return driven.look_up(new, lambda unseen: problem.residuals(unseen, workers))

    visited: list[FloatArray] = []
    least = math.inf
    start = _next_start(points, costs, visited)
    for k in range(starts):
        if start is None:
            return
        end, size = descend_from(problem, start, driven, workers, on_step, least)
        visited += [start, end]
        least = min(least, size)
        yield end
        start = None
        if k + 1 < starts and math.isfinite(size):
            errors, slopes = error_slopes(errors_at, end)
            errors = _in_one_unit(errors, problem, median_size(errors, problem))
            start = _restart_in_middle(errors, slopes, end, visited)
        if start is None:
            start = _next_start(points, costs, visited)


def _next_start(
    points: FloatArray, costs: FloatArray, visited: Sequence[FloatArray]
) -> FloatArray | None:
    """Return the (n,) best of (S, n) candidates far from all visited points; None for none."""
    for i in np.argsort(costs, kind="stable"):
        if np.isfinite(costs[i]) and _is_far(points[i], visited):
            return points[i]
    return None


def _restart_in_middle(
    errors: FloatArray, slopes: FloatArray, end: FloatArray, visited: Sequence[FloatArray]
) -> FloatArray | None:
    """Return an (n,) end of least squares with what misled them reset to mid-range.

    None stands for a point that is not far from all that was visited.

    An insensitive parameter (an acceleration limit so high that it is never reached, say) has no
    slope to follow, but may do much elsewhere. It does nothing where its (K,) slopes over the whole
    width of its bounds are less than the errors. A parameter at a bound led the descent out of the
    cube: the candidates mostly crowd in the same corner, and starts from there end there again.
    """
    insensitive = np.linalg.norm(slopes, axis=0) < np.linalg.norm(errors)
    at_bound = np.abs(end - 0.5) > 0.5 - NEAR_BOUND
    moved = np.where(insensitive | at_bound, 0.5, end)
    if _is_far(moved, visited):
        return moved
    return None


def _is_far(point: FloatArray, visited: Sequence[FloatArray]) -> bool:
    """Return whether an (n,) point is at least `APART` from all others."""
    return all(np.abs(point - other).max() >= APART for other in visited)


def error_slopes(
    errors_at: ErrorsAt, point: FloatArray, central: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return (K,) errors at an (n,) point of the unit cube, and their (K, n) derivatives.

    The derivatives are finite differences into the cube, of one population of n + 1; NaN beside an
    impossible point. With those of the other side too (`central`) they are exact to second order.
    """
    n = len(point)
    steps = np.where(point + STEP <= 1.0, STEP, -STEP)
    # the step goes inwards near an upper bound, and the other side may lie outside the cube
    has_other_side = (point - steps >= 0.0) & (point - steps <= 1.0)
    back = np.where(has_other_side & central, -steps, 0.0)
    errors = errors_at(np.vstack([point[None], point + np.diag(steps), point + np.diag(back)]))
    ahead = errors[1 : n + 1]
    behind = errors[n + 1 :]
    dead = ~np.isfinite(ahead).all(axis=1) & has_other_side
    # an impossible neighbour, such as dynamic friction above static: the other side tells the slope
    if dead.any():
        ahead[dead] = errors_at((point - np.diag(steps))[dead])
        behind[dead] = errors[0]
        steps = np.where(dead, -steps, steps)
        back = np.where(dead, 0.0, back)
    return errors[0], ((ahead - behind) / (steps - back)[:, None]).T


_Slopes = tuple[FloatArray, FloatArray, FloatArray]
"""An (n,) point of the unit cube, (K,) errors there and their (K, n) derivatives."""


def _slopes_at(
    point: FloatArray,
    known: _Slopes | None,
    errors_at: ErrorsAt,
    driven: Remembered,
) -> _Slopes:
    """Return what is known of the errors at an (n,) point: differences, if nothing was before.

    A way shorter than the steps of these would tell the rounding of delays, and nothing is learnt.
    """
    if known is None:
        driven.around = point
        at, slopes = error_slopes(errors_at, point)
        # an impossible neighbour says nothing
        return point, at, np.where(np.isfinite(slopes).all(axis=0), slopes, 0.0)
    before, errors_before, slopes = known
    step = point - before
    if np.abs(step).max() < STEP:
        return known
    errors = errors_at(point[None])[0]
    off = errors - errors_before - slopes @ step
    return point, errors, slopes + np.outer(off, step / (step @ step))


def descend_from(
    problem: Residuals,
    start: FloatArray,
    driven: Remembered,
    workers: int | str,
    on_step: Callable[[], object],
    goal: float = math.inf,
) -> tuple[FloatArray, float]:
    """Return the (n,) point where least squares from a start end, and the size of errors there.

    An interrupt passes through. The arguments are those of `descent_ends`, and `goal` is the least
    size of the errors at the ends of earlier starts: a start that does not come near it is given
    up.
    """
    n = len(start)
    robust = problem.robust
    known = None

    def errors_at(points: FloatArray) -> FloatArray:
        before = len(driven)
        errors = driven.look_up(points, lambda new: problem.residuals(new, workers))
        if len(driven) > before:
            on_step()
        return errors

    def errors(point: FloatArray) -> FloatArray:
        return _in_one_unit(errors_at(point[None])[0], problem, unit)

    def jacobian(point: FloatArray) -> FloatArray:
        nonlocal known
        known = _slopes_at(point, known if problem.dear else None, errors_at, driven)
        return _in_one_unit(known[2].T, problem, unit).T

    # least squares want a start strictly within the bounds
    begin = np.clip(start, 2.0 * _INSIDE, 1.0 - 2.0 * _INSIDE)
    first = errors_at(begin[None])[0]
    if not np.isfinite(first).all():
        return start, math.inf
    scale = median_size(first, problem)
    # a prior whose unit were the large errors of a start would hold the search there
    unit = 0.0
    end = begin
    box = (np.full(n, _INSIDE), np.full(n, 1.0 - _INSIDE))
    tolerance = _TOLERANCE
    descent = _MOST_DESCENT
    if problem.cheap:
        tolerance = FINE
        descent = _MOST_FINE
    descents = [descent] * (_MOST_SCALES if robust else 1 + problem.dear)
    if math.isfinite(goal):
        descents.insert(0, _TRIAL)
    for most in descents:
        driven.correct(begin)
        known = None
        end = least_squares(
            errors,
            begin,
            jac=jacobian,
            bounds=box,
            method="trf",
            loss="soft_l1" if robust else "linear",
            f_scale=scale,
            xtol=tolerance,
            ftol=tolerance,
            gtol=None,
            max_nfev=most,
        ).x
        begin = np.clip(end, 2.0 * _INSIDE, 1.0 - 2.0 * _INSIDE)
        before = scale
        last = errors_at(end[None])[0]
        scale = median_size(last, problem)
        size = _total_size(_in_one_unit(last, problem, scale), robust)
        hopeless = size > HOPELESS * goal
        # a trial has too few steps to judge its scale by
        settled = robust and most != _TRIAL and scale > _SAME_SCALE * before
        if hopeless or (settled and (unit or not problem.pulls)):
            break
        unit = scale
    return end, size


def simplex_end(cost_at: Callable[[FloatArray], float], start: FloatArray) -> FloatArray:
    """Return the (n,) point of the unit cube where simplices from a start end.

    A simplex may fold and end anywhere, so another begins at its end until one gains nothing. An
    interrupt passes through.
    """
    cube = Bounds(np.zeros(len(start)), np.ones(len(start)))
    end = start
    cost = cost_at(start)
    for _ in range(_MOST_SIMPLICES):
        # inwards, as a simplex outside the cube would be flat
        steps = np.where(end < 0.5, _SIMPLEX, -_SIMPLEX)
        settings = {
            "initial_simplex": np.vstack([end, end + np.diag(steps)]),
            "xatol": _SIMPLEX_END,
            "fatol": _SIMPLEX_END * cost,
            "adaptive": True,
        }
        found = minimize(cost_at, end, method="Nelder-Mead", bounds=cube, options=settings)
        before = cost
        end = found.x
        cost = found.fun
        if cost >= (1.0 - _SIMPLEX_END) * before:
            break
    return end


def _total_size(errors: FloatArray, robust: bool) -> float:
    """Return the size of all errors: the root of the sum of squares, or the sum of sizes."""
    if robust:
        return np.abs(errors).sum()
    return float(np.linalg.norm(errors))


def median_size(errors: FloatArray, problem: Residuals) -> float:
    """Return the median size of a problem's (K,) errors without the pulls; it is positive."""
    return max(np.median(np.abs(errors[: len(errors) - problem.pulls])), 1e-12)


def _in_one_unit(errors: FloatArray, problem: Residuals, size: float) -> FloatArray:
    """Return a problem's (..., K) errors with the pulls in the unit of the others, their size."""
    scaled = errors.copy()
    scaled[..., errors.shape[-1] - problem.pulls :] *= size
    return scaled
