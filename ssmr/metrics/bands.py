"""Bands: where a prediction says that the robot will be, with a probability of nine tenths.

Errors of a prediction have few causes, and each grows in its own manner with the way driven and the
angle turned. A wrong heading at one place moves all later positions sideways by the distance from
there: to first order, an error d of the heading at the position p(s) moves the end p by J (p -
p(s)) d, with J a quarter turn to the left. So the covariance of the pose after any motion is a sum
over causes, each a known function of the predicted path times one variance, and these few variances
can be estimated from the errors over windows of several lengths, all at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields

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
_FEW_PARTS = 2.353 / 1.645 * math.sqrt(1.0 - QUARTERS**-2)
"""Factor of the reach, 1.385: an error that lasts as long as a part shows itself four times only,
so Student's quantile of three degrees of freedom stands for the normal one. The root is what errors
on new ground are to those of a part left out."""
_PRIOR = np.array([0.015, 0.01, 0.03, 0.02, 0.02, 0.015, 0.01, 0.002])
"""Standard deviations of the causes on public runs, in the order of `Band`: a prior for those that
a log hardly excites."""
_PRIOR_SQUARES = 2.0
"""Number of squares that the prior counts for."""
_FEWEST_WINDOWS = 40
"""Fewest windows that a band is estimated from."""


@dataclass(frozen=True)
class Band:
    """Standard deviations of the causes of a prediction's error, and the reach of nine tenths."""

    position_noise: float = parameter(0.0, unit="m", low=0.0)
    """Error of the difference of two logged positions, whatever the way between them [m]."""
    yaw_noise: float = parameter(0.0, unit="rad", low=0.0)
    """Error of the difference of two logged headings [rad]."""
    way_walk: float = parameter(0.0, unit="m/m^0.5", low=0.0)
    """Random walk of the position with the way driven: its deviation after a metre [m]."""
    way_scale: float = parameter(0.0, unit="1", low=0.0)
    """Lasting relative error of lengths [1]."""
    turn_walk: float = parameter(0.0, unit="rad/rad^0.5", low=0.0)
    """Random walk of the heading with the angle turned: its deviation after a radian [rad]."""
    turn_scale: float = parameter(0.0, unit="1", low=0.0)
    """Lasting relative error of angles [1]."""
    bend_walk: float = parameter(0.0, unit="rad/m^0.5", low=0.0)
    """Random walk of the heading with the way driven: its deviation after a metre [rad]."""
    bend_scale: float = parameter(0.0, unit="rad/m", low=0.0)
    """Lasting bend of a path that is meant to be straight [rad/m]."""
    reach_position: float = parameter(0.0, unit="1", low=0.0)
    """Size of the ellipse of positions that holds nine tenths of the errors, in standard
    deviations [1]."""
    reach_yaw: float = parameter(0.0, unit="1", low=0.0)
    """Half width of the headings' interval that holds nine tenths, in standard deviations [1]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)

    def covariance(
        self, pose: ArrayLike, starts: ArrayLike, ends: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return how uncertain the predicted motion over windows is.

        Args:
            pose: (M, 3) predicted path: x [m], y [m], yaw [rad, unwrapped].
            starts: (W,) indices at which windows begin, where the pose is known.
            ends: (W,) indices at which they end.

        Returns:
            (W, 2, 2) covariance of the position at the end, in the frame of the start [m²], and
            (W,) variance of its heading [rad²].
        """
        growth = _growth(pose, starts, ends)
        xx, yy, turned, xy = growth @ np.square(astuple(self)[:_CAUSES])
        rows = [np.stack([xx, xy], -1), np.stack([xy, yy], -1)]
        return np.stack(rows, -1), turned

    def sizes(
        self, pose: ArrayLike, starts: ArrayLike, ends: ArrayLike, error: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return (W,) sizes of errors of position and of heading, 1 at the edge of the band.

        `error` has (W, 3) errors x, y [m] in the frame of the start, and yaw [rad]; the others are
        those of `covariance`.
        """
        variances = np.square(astuple(self)[:_CAUSES])
        position, yaw = _sizes(_growth(pose, starts, ends), variances, np.asarray(error))
        return position / self.reach_position, yaw / self.reach_yaw


_CAUSES = len(fields(Band)) - 2


def _growth(pose: ArrayLike, starts: ArrayLike, ends: ArrayLike) -> FloatArray:
    """Return (4, W, causes) variances over a window by a unit variance of each cause.

    These are xx, yy, that of the heading, and xy. Integrals over a window of levers p - p(s) and of
    their products, p its end, come from running sums over the whole path.
    """
    path = frozen_array(pose, "pose", (None, 3))
    i = np.asarray(starts, dtype=np.intp)
    j = np.asarray(ends, dtype=np.intp)
    step = np.diff(path[:, :2], axis=0)
    turn = np.diff(path[:, 2])
    place = path[:-1, :2] + 0.5 * step
    heading = path[:-1, 2] + 0.5 * turn
    dx, dy = step.T
    way = dx * np.cos(heading) + dy * np.sin(heading)
    end = path[j, :2]
    c = np.cos(path[i, 2])
    s = np.sin(path[i, 2])
    rows = [np.stack([c, s], -1), np.stack([-s, c], -1)]
    ahead = np.stack(rows, -2)  # from the world to the frame of the start
    aside = ahead @ np.array([[0.0, -1.0], [1.0, 0.0]])  # and a quarter turn

    def over(rate: FloatArray) -> FloatArray:
        """Return the sum of a rate over each window."""
        sums = np.cumulative_sum(rate, axis=0, include_initial=True)
        return np.asarray(sums[j] - sums[i])

    def squared(vector: FloatArray) -> FloatArray:
        return vector[:, :, None] * vector[:, None, :]

    def lasting(rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variances by an error that turns the heading in proportion to a signed rate.

        That of the position is the square of summed levers.
        """
        total = over(rate)
        lever = end * total[:, None] - over(place * rate[:, None])
        lever_aside = aside @ lever[:, :, None]
        return squared(lever_aside[:, :, 0]), total**2

    def walking(rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variances by a random walk of the heading, whose variance grows by a rate.

        That of the position is the sum of squared levers.
        """
        total = over(rate)
        first = over(place * rate[:, None])
        second = over(squared(place) * rate[:, None, None])
        mixed = end[:, :, None] * first[:, None, :]
        levers = squared(end) * total[:, None, None]
        levers = levers - mixed - mixed.transpose(0, 2, 1) + second
        return aside @ levers @ aside.transpose(0, 2, 1), total

    chord = (end - path[i, :2])[:, :, None]
    chord_ahead = (ahead @ chord)[:, :, 0]
    chord_aside = (aside @ chord)[:, :, 0]
    zero = np.zeros(len(i))
    unit = np.broadcast_to(np.eye(2), (len(i), 2, 2))
    causes = [
        (unit, zero),
        (0.5 * squared(chord_aside), zero + 1.0),  # half of it is noise of the heading at the start
        (unit * over(np.abs(way))[:, None, None], zero),
        (squared(chord_ahead), zero),
        walking(np.abs(turn)),
        lasting(turn),
        walking(np.abs(way)),
        lasting(way),
    ]
    growth = [(xy[:, 0, 0], xy[:, 1, 1], yaw, xy[:, 0, 1]) for xy, yaw in causes]
    return np.moveaxis(np.array(growth), 0, -1)


def _sizes(
    growth: FloatArray, variances: FloatArray, error: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the (W,) sizes of errors of position and of heading, in standard deviations."""
    xx, yy, turned, xy = growth @ variances
    x, y, yaw = error.T
    determinant = xx * yy - xy * xy
    squares = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
    return np.sqrt(squares), np.abs(yaw) / np.sqrt(turned)


_LEAST = np.square([1e-4, 1e-4])
"""Least variances of the noise of positions [m²] and headings [rad²]: a simulation without any has
a band too."""


def _variances(growth: FloatArray, error: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the (causes,) variances that explain squares of errors best.

    Each square is weighted by its own expectation, and each of the windows counts as much as its
    `weight` (W,). The prior counts as a few squares more.
    """
    from scipy.optimize import nnls  # here: it takes long to import, and few programs need it

    design = growth[:3].reshape(-1, _CAUSES)
    squares = np.square(error.T).ravel()
    mean_squares = np.average(np.square(error), 0, weight)
    expected = np.repeat(mean_squares + 1e-12, len(error))
    root = np.tile(np.sqrt(weight), 3)
    prior = _PRIOR**2
    prior_rows = math.sqrt(_PRIOR_SQUARES) * np.eye(_CAUSES)
    prior_values = np.full(_CAUSES, math.sqrt(_PRIOR_SQUARES))
    variances = np.zeros(_CAUSES)
    for _ in range(_ROUNDS):
        clipped = np.minimum(squares, _MOST_SQUARES * expected)
        scaled = design * prior * (root / expected)[:, None]
        rows = np.vstack([scaled, prior_rows])
        values = np.concatenate([clipped * root / expected, prior_values])
        shares, _ = nnls(rows, values)
        variances = shares * prior
        variances[:2] = np.maximum(variances[:2], _LEAST)
        expected = design @ variances
    return variances


def estimated_band(
    windows: Mapping[float, Sequence[tuple[FloatArray, IndexArray, IndexArray, FloatArray]]],
) -> Band | None:
    """Return a plant's band from its errors over windows on ground that its numbers never saw.

    It is None if there are too few windows. Windows of h seconds that begin every second overlap,
    so each counts as 1/h among the causes. The reach holds nine tenths of the errors, where all
    lengths have the same weight, and is greater by `_FEW_PARTS`, as there are few parts.

    Args:
        windows: for each length [s] and each gap-free piece: its (M, 3) predicted path, (W,) starts
            and ends, and (W, 3) errors x, y [m] in the frame of the start and yaw [rad], predicted
            less true.
    """
    pieces = [piece for length in windows.values() for piece in length]
    counts = [sum(len(starts) for _, starts, _, _ in length) for length in windows.values()]
    if sum(counts) < _FEWEST_WINDOWS:
        return None
    growth = np.concatenate([_growth(pose, i, j) for pose, i, j, _ in pieces], axis=1)
    error = np.concatenate([e for *_, e in pieces])
    overlaps = np.maximum(list(windows), 1.0)
    variances = _variances(growth, error, 1.0 / np.repeat(overlaps, counts))
    sizes = np.array(_sizes(growth, variances, error))
    weights = 1.0 / np.repeat(counts, counts)
    reach = np.quantile(sizes, SHARE, axis=1, weights=weights, method="inverted_cdf")
    return Band(*np.sqrt(variances).tolist(), *(_FEW_PARTS * reach).tolist())
