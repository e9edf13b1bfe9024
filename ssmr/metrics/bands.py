"""Bands: where a prediction says that the robot will be, with a probability of nine tenths.

Errors of a prediction have few causes, and each grows in its own manner with the way driven and the
angle turned. A wrong heading at one place moves all later positions sideways by the distance from
there: to first order, an error d of the heading at the position p(s) moves the end p by J (p -
p(s)) d, with J a quarter turn to the left. So the covariance of the pose after any motion is a sum
over causes, each a known function of the predicted path times one variance, and these few variances
can be estimated from the errors over windows of several lengths, all at once.

How well bands keep their word is judged by a proper score, which is least for the true quantiles
(T. Gneiting and A. E. Raftery, J. Am. Stat. Assoc. 102 (2007) 359): a band that is too wide pays
for its width, and one that is too narrow for what lies outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ssmr.metrics.windows import SHARE
from ssmr.parameters import check_parameters, parameter
from ssmr.types import FloatArray, IndexArray, frozen_array

_ROUNDS = 30
"""Number of times that squares are weighted anew by the variances found so far."""
_MOST_SQUARES = 9.0
"""Squares of errors beyond so many variances count as these: a few odd windows must not widen the
band everywhere."""
QUARTERS = 4
"""Number of parts of a log's time each of which is predicted by numbers that the others give."""
NEW_GROUND = 1.2
"""Factor of the reach where parts of data are as few as days. An error that lasts as long as a part
shows itself a few times only: if all did, Student's quantile of three degrees of freedom would ask
for 1.385, and if none did, for 1. Measured: with 1.15, bands of three days of a robot hold 90 to
92 % of the positions and 89 to 93 % of the headings of a fourth, after 2, 6 and 30 s."""
_PRIOR = np.array([0.015, 0.01, 0.03, 0.02, 0.015])
"""Standard deviations of the causes on public runs, in the order of `Band`: how errors grow where a
log hardly tells it."""
_PRIOR_SQUARES = 30.0
"""Number of squares that the prior counts for. With 2, bands follow the few long windows of a log
too closely, and the interval score on what comes after is worse."""
_FEWEST_WINDOWS = 40
"""Fewest windows that a band is estimated from."""


@dataclass(frozen=True)
class Band:
    """Standard deviations of the causes of a prediction's error, and the reach of nine tenths."""

    position_noise: float = parameter(1e-4, unit="m", low=0.0, open_low=True)
    """Error of the difference of two logged positions, whatever the way between them [m]."""
    yaw_noise: float = parameter(1e-4, unit="rad", low=0.0, open_low=True)
    """Error of the difference of two logged headings [rad]."""
    way_walk: float = parameter(0.0, unit="m/m^0.5", low=0.0)
    """Random walk of the position with the way driven: its deviation after a metre [m]."""
    turn_walk: float = parameter(0.0, unit="rad/rad^0.5", low=0.0)
    """Random walk of the heading with the angle turned: its deviation after a radian [rad]."""
    turn_scale: float = parameter(0.0, unit="1", low=0.0)
    """Lasting relative error of angles [1]."""
    reach_position: float = parameter(0.0, unit="1", low=0.0)
    """Size of the ellipse of positions that holds nine tenths of the errors, in standard
    deviations [1]."""
    reach_yaw: float = parameter(0.0, unit="1", low=0.0)
    """Half width of the headings' interval that holds nine tenths, in standard deviations [1]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)

    def covariance(self, pose: ArrayLike, starts: ArrayLike, ends: ArrayLike) -> FloatArray:
        """Return how uncertain the predicted motion over windows is.

        Args:
            pose: (M, 3) predicted path: x [m], y [m], yaw [rad, unwrapped].
            starts: (W,) indices at which windows begin, where the pose is known.
            ends: (W,) indices at which they end.

        Returns:
            (W, 2, 2) covariance of the position at the end, in the frame of the start [m²].
        """
        trace, square, _ = _variance_growth(pose, starts, ends) @ np.square(astuple(self)[:_CAUSES])
        rows = [trace.real + square.real, square.imag, square.imag, trace.real - square.real]
        return 0.5 * np.stack(rows, -1).reshape(-1, 2, 2)

    def edges(
        self, pose: ArrayLike, starts: ArrayLike, ends: ArrayLike, error: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return how far the band reaches over windows.

        `error` has (W, 3) errors x, y [m] in the frame of the start, and yaw [rad]; the others are
        those of `covariance`.

        Returns:
            (W,) distances from the middle of the band to its edge in the direction of each error of
            position [m], and (W,) half widths of the headings' interval [rad].
        """
        variances = np.square(astuple(self)[:_CAUSES])
        position, yaw = _window_deviations(
            _variance_growth(pose, starts, ends), variances, np.asarray(error)
        )
        return position * self.reach_position, yaw * self.reach_yaw


def interval_score(error: ArrayLike, edge: ArrayLike) -> float:
    """Return the mean interval score of central intervals of probability `SHARE`, see Eq. 43.

    It is the width of an interval and 2 / (1 - SHARE) times the distance of what lies outside, in
    the unit of the (n,) errors, which have (n,) intervals from -edge to edge. Of two bands, the one
    with the smaller score is better. Eq. 43: Gneiting and Raftery 2007.
    """
    outside = np.maximum(np.abs(error) - edge, 0.0)
    return float(np.mean(2.0 * np.asarray(edge) + 2.0 / (1.0 - SHARE) * outside))


_CAUSES = len(fields(Band)) - 2


def _variance_growth(pose: ArrayLike, starts: ArrayLike, ends: ArrayLike) -> Any:
    """Return (3, W, causes) complex variances over a window by a unit variance of each cause.

    These are xx + yy, xx - yy + 2i xy, and that of the heading: |w|^2 and w^2, where a vector is a
    complex number w. Integrals over a window of levers p - p(s) and of their products, p its end,
    come from running sums over the whole path.
    """
    path = frozen_array(pose, "pose", (None, 3))
    i = np.asarray(starts, dtype=np.intp)
    j = np.asarray(ends, dtype=np.intp)
    point = path[:, 0] + 1j * path[:, 1]
    turn = np.diff(path[:, 2])
    place = 0.5 * (point[1:] + point[:-1])
    end = point[j]
    aside = 1j * np.exp(-1j * path[i, 2])  # a quarter turn, and to the frame of the start

    def over(rate: Any) -> Any:
        """Return the sum of a rate over each window."""
        sums = np.cumulative_sum(rate, include_initial=True)
        return sums[j] - sums[i]

    chord = aside * (end - point[i])
    # a random walk of the heading, whose variance grows by each step: levers are squared and summed
    size = np.abs(turn)
    total = over(size)
    first = over(size * place)
    second = over(size * np.abs(place) ** 2)
    trace = np.abs(end) ** 2 * total - 2.0 * (end.conj() * first).real + second
    products = aside**2 * (end**2 * total - 2.0 * end * first + over(size * place**2))
    # a lasting error of angles: levers are summed and squared
    turned = over(turn)
    lever = aside * (end * turned - over(turn * place))
    zero = np.zeros(len(i))
    causes = [
        (zero + 2.0, zero, zero),
        (0.5 * np.abs(chord) ** 2, 0.5 * chord**2, zero + 1.0),  # half is noise at the start
        (2.0 * over(np.abs(np.diff(point))), zero, zero),
        (trace, products, total),
        (np.abs(lever) ** 2, lever**2, turned**2),
    ]
    return np.moveaxis(np.array(causes), 0, -1)


def _window_deviations(
    growth: Any, variances: FloatArray, error: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (W,) standard deviations of position in the direction of errors, and of heading.

    Along a unit vector u the edge of an ellipse S is at (u' S^-1 u)^-1/2.
    """
    trace, square, yaw = growth @ variances
    direction = np.arctan2(error[:, 1], error[:, 0])
    along = trace.real - (square * np.exp(-2j * direction)).real
    four_determinants = trace.real**2 - np.abs(square) ** 2
    return np.sqrt(0.5 * four_determinants / along), np.sqrt(yaw.real)


_LEAST = 1e-8
"""Least variance of the noise of positions [m²] and headings [rad²]: a simulation without any has a
band too."""


def _fit_variances(growth: Any, error: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the (causes,) variances that explain squares of errors best.

    Each square is weighted by its own expectation, and each of the windows counts as much as its
    `weight` (W,). The prior counts as a few squares more.
    """
    from scipy.optimize import nnls  # here: it takes long to import, and few programs need it

    trace, square, yaw = growth * _PRIOR**2
    design = np.concatenate([0.5 * (trace + square), 0.5 * (trace - square), yaw]).real
    squares = np.square(error.T).ravel()
    root = np.tile(np.sqrt(weight), 3)
    firm = math.sqrt(_PRIOR_SQUARES)
    shares = np.ones(_CAUSES)
    for _ in range(_ROUNDS):
        expected = design @ shares
        clipped = np.minimum(squares, _MOST_SQUARES * expected)
        rows = np.vstack([design * (root / expected)[:, None], firm * np.eye(_CAUSES)])
        values = np.append(clipped * root / expected, np.full(_CAUSES, firm))
        shares = nnls(rows, values)[0]
        shares[:2] = np.maximum(shares[:2], _LEAST / _PRIOR[:2] ** 2)
    return np.asarray(shares * _PRIOR**2)


def estimated_band(
    windows: Sequence[tuple[float, FloatArray, IndexArray, IndexArray, FloatArray]],
    new_ground: float = NEW_GROUND,
) -> Band | None:
    """Return a plant's band from its errors over windows on ground that its numbers never saw.

    It is None if there are too few windows. Windows of h seconds that begin every second overlap,
    so each counts as 1/h among the causes. The reach holds nine tenths of the errors, where all
    lengths have the same weight, times `new_ground`.

    Args:
        windows: length [s], (M, 3) predicted path, (W,) starts and ends, and (W, 3) errors x, y [m]
            in the frame of the start and yaw [rad], predicted less true; for each length and each
            gap-free piece.
        new_ground: factor of the reach for what the next day changes; 1 where errors have it in
            them.
    """
    if sum(len(starts) for _, _, starts, _, _ in windows) < _FEWEST_WINDOWS:
        return None
    growth = np.concatenate([_variance_growth(pose, i, j) for _, pose, i, j, _ in windows], axis=1)
    error = np.concatenate([e for *_, e in windows])
    length = np.concatenate([np.full(len(e), h) for h, *_, e in windows])
    variances = _fit_variances(growth, error, 1.0 / np.maximum(length, 1.0))
    edges = _window_deviations(growth, variances, error)
    sizes = [np.hypot(error[:, 0], error[:, 1]) / edges[0], np.abs(error[:, 2]) / edges[1]]
    _, member, counts = np.unique(length, return_inverse=True, return_counts=True)
    weights = 1.0 / counts[member]
    reach = np.quantile(sizes, SHARE, axis=1, weights=weights, method="inverted_cdf")
    return Band(*np.sqrt(variances).tolist(), *(new_ground * reach).tolist())
