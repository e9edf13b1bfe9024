"""The second stage of a fit: bounded least squares on the errors themselves, from the best of the first and from others.

A cost is one number; the errors that it is made of are thousands, and how each changes with each parameter says where the
optimum lies. `scipy.optimize.least_squares` (trust region, within the unit cube) goes there in some tens of motions. The
derivatives of a step are finite differences of one population. What was driven is remembered, so a search that was
interrupted goes on by driving only what is new, and comes to the same end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from ssmr.types import FloatArray

STARTS = 3
"""Greatest number of starts: the best candidate, and others far from it."""
APART = 0.25
"""Least distance between two starts, in the unit cube's widest direction [1]."""
STEP = 0.004
"""Step of the finite differences, in the unit cube."""
INSIDE = 1e-6
"""Distance from the bounds that the search keeps, in the unit cube."""
TOLERANCE = 1e-4
"""Relative change of the sum of squares, or of the point, at which least squares end."""
MOST_DESCENT = 25
"""Greatest number of steps from one start, with one scale."""
MOST_SCALES, SAME_SCALE = 5, 0.8
"""Robust least squares begin anew with the errors' median size as the scale, at most so often, and while it shrinks so much
[1]: far from the optimum all errors are large, and the scale with them."""


class Residuals(Protocol):
    """A problem whose errors are known one by one."""

    def residuals(self, points: FloatArray, workers: int) -> FloatArray:
        """Return (S, K) errors of (S, n) points of the unit cube, in the cost's unit; NaN for one that is impossible."""
        ...


@dataclass
class Remembered:
    """Everything that least squares have driven: points of the unit cube, and their errors."""

    points: list[FloatArray] = field(default_factory=list)
    """(n,) each."""
    errors: list[FloatArray] = field(default_factory=list)
    """(K,) each."""
    _known: dict[bytes, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.points)

    def look_up(self, points: FloatArray, drive: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return (S, K) errors of (S, n) points; `drive` is asked only for those that are not known yet."""
        if len(self._known) != len(self.points):
            self._known = {point.tobytes(): i for i, point in enumerate(self.points)}
        new = [i for i, point in enumerate(points) if point.tobytes() not in self._known]
        if new:
            for point, errors in zip(points[new], drive(points[new]), strict=True):
                self._known[point.tobytes()] = len(self.points)
                self.points.append(np.array(point))
                self.errors.append(np.array(errors))
        return np.array([self.errors[self._known[point.tobytes()]] for point in points])


def choose_starts(points: FloatArray, costs: FloatArray) -> FloatArray:
    """Return the (k, n) starts among (S, n) candidates: the best, then the best of those far from all chosen before."""
    chosen: list[int] = []
    for i in np.argsort(costs, kind="stable"):
        far = all(np.abs(points[i] - points[j]).max() >= APART for j in chosen)
        if np.isfinite(costs[i]) and far and len(chosen) < STARTS:
            chosen.append(int(i))
    return points[chosen]


def descend(
    problem: Residuals,
    start: FloatArray,
    driven: Remembered,
    workers: int,
    robust: bool,
    on_step: Callable[[], object],
) -> FloatArray:
    """Return the (n,) point of the unit cube where least squares from a start end; an interrupt passes through.

    Args:
        problem: what is fitted.
        start: (n,) point of the unit cube, of a candidate that can be driven.
        driven: what was driven before; what is driven now is added.
        workers: number of threads; the result does not depend on it.
        robust: errors count by their size and not by its square (`soft_l1`) beyond the median.
        on_step: called after every population.
    """
    n = len(start)

    def errors_at(points: FloatArray) -> FloatArray:
        before = len(driven)
        found = driven.look_up(points, lambda new: problem.residuals(new, workers))
        if len(driven) > before:
            on_step()
        return found

    def errors(point: FloatArray) -> FloatArray:
        return np.asarray(errors_at(point[None])[0])

    def jacobian(point: FloatArray) -> FloatArray:
        steps = np.where(point + STEP <= 1.0, STEP, -STEP)
        beside = errors_at(point + np.diag(steps))
        slopes = (beside - errors(point)) / steps[:, None]
        return np.where(
            np.isfinite(slopes).all(axis=1, keepdims=True), slopes, 0.0
        ).T  # an impossible neighbour says nothing

    begin = np.clip(start, 2.0 * INSIDE, 1.0 - 2.0 * INSIDE)
    first = errors(begin)
    if not np.isfinite(first).all():
        return start
    scale, box = _size(first), (np.full(n, INSIDE), np.full(n, 1.0 - INSIDE))
    for _ in range(MOST_SCALES if robust else 1):
        end = least_squares(
            errors, begin, jac=jacobian, bounds=box, method="trf", loss="soft_l1" if robust else "linear", f_scale=scale,
            xtol=TOLERANCE, ftol=TOLERANCE, gtol=None, max_nfev=MOST_DESCENT,
        )  # fmt: skip
        begin, before, scale = np.clip(end.x, 2.0 * INSIDE, 1.0 - 2.0 * INSIDE), scale, _size(errors(end.x))
        if scale > SAME_SCALE * before:
            break
    return np.asarray(end.x)


def _size(errors: FloatArray) -> float:
    """Return the median size of errors; it is positive."""
    return max(float(np.median(np.abs(errors))), 1e-12)
