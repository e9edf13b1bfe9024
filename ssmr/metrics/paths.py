"""Distances between the path of a candidate motion and that of a reference: what the thesis' metrics (Sec. 1.6) are made of.

Which way round. The candidate is the simulated motion, the reference the measured or wanted one.
The thesis leaves it open (Sec. 1.6 writes d_B / d_A), so it is fixed here once, as Sec. 3.5.3 and
Algorithm 2 use it:

- ratios are candidate / reference: d_ratio = 1.0312 says that the simulated path is 3.12 % longer
than the real one;
- d_rms and d_haus are one-sided, from each sample of the reference to the closest sample of the
  candidate: Algorithm 2 loops over the points of the reference trajectory. They do not punish a
  candidate that covers the reference and then strays; the `_symmetric` metrics take both
  directions, and do.

Distances are between samples, as printed, not between curves: a path sampled every h keeps a floor
of up to h / 2.

Kernels read columns 0 and 1 of what they are given, so (M, 3) poses serve as paths without a copy.

For the search for the closest sample, the path is cut into leaves of `_LEAF` consecutive samples. A
leaf has a box, the least that holds its samples, and so has every two neighbouring leaves, every
two such pairs, and so on up to the whole path: a tree of boxes, because a path is mostly near
itself. Consecutive points lie close together too, so `_BATCH` of them go down that tree at once,
and take from each leaf that they enter what is nearest.

A box is passed over where even its nearest edge is as far from the box of the batch as each point's
closest sample yet. Subtraction, multiplication and addition round monotonically, so the computed
distance of boxes is never more than that of a point and a sample in them: the answer is that of the
search over all pairs, to the last bit, with no slack.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssmr._jit import jit, jit_alone
from ssmr.types import FloatArray

BENDING_SPACING = 0.1
"""Distance between the points at which curvature is taken [m]: noise of size s adds about 6 s^2 /
d^4 per metre, so with the 0.5 mm of a tracking system a tenth of a metre is the least that leaves a
gentle path its own bending energy."""
LENGTH_FLOOR = 1e-3
"""A path shorter than this has no length to compare with [m]: a robot that stands still."""
BENDING_FLOOR = 1e-3
"""A path of less bending energy is straight [1/m]: 10 m along a circle of 100 m radius."""
LARGEST = 1e75
"""Coordinates beyond this count as not finite [m]: their fourth powers would overflow."""


@jit_alone
def _steps(xy: FloatArray) -> tuple[float, float]:
    """Return the sum of the steps between samples [m], and the sum of their squares [m^2]."""
    total, squares = 0.0, 0.0
    for i in range(xy.shape[0] - 1):
        dx, dy = xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1]
        square = dx * dx + dy * dy
        total += math.sqrt(square)
        squares += square
    return total, squares


@jit_alone
def path_length(xy: FloatArray) -> float:
    """Return the length of an (M, 2) or wider path [m]: NaN where it has no sample or one beyond `LARGEST` or not finite."""
    for i in range(xy.shape[0]):
        if not (abs(xy[i, 0]) <= LARGEST and abs(xy[i, 1]) <= LARGEST):
            return math.nan
    return _steps(xy)[0] if len(xy) > 0 else math.nan


@jit_alone
def bending_energy(xy: FloatArray) -> float:
    """Return the total bending energy, sum of c_i^2 d_i (Sec. 1.6) [1/m]: the integral of curvature squared along the path.

    The (M, 2) or wider path [m] is first laid out afresh: from its first sample on, the next point
    is where the polyline first gets the distance d away from the last point, so that all chords are
    d long. The local curvature c_i is the turn between two chords over d. Thus the outcome depends
    neither on the sampling rate nor on the speed, and a robot that stands still, or turns on the
    spot, adds nothing even while its measured position jitters by less than d. Each end takes the
    curvature of its neighbour, and so does what is left after the last chord. A path shorter than
    two chords has none.

    d is `BENDING_SPACING`, or the mean step between samples (weighted by length) where that is
    longer: points laid closer than the samples would find all turning at the samples and none
    between them. A reversal is a turn by pi: pi^2 / d.
    """
    total, squares = _steps(xy)
    if not total > 0.0:
        return 0.0
    d = max(
        BENDING_SPACING, squares / total
    )  # hence at most M - 1 chords: total^2 <= (M - 1) squares
    last_x, last_y = xy[0, 0], xy[0, 1]
    chord_x, chord_y = 0.0, 0.0
    chords = 0
    energy, first, latest = 0.0, 0.0, 0.0
    for i in range(1, xy.shape[0]):
        end_x, end_y = xy[i, 0], xy[i, 1]
        from_x, from_y = (
            xy[i - 1, 0],
            xy[i - 1, 1],
        )  # within d of the last point, unlike the end if a chord ends here
        while (end_x - last_x) ** 2 + (end_y - last_y) ** 2 >= d * d:
            # from + s (end - from) leaves the circle of radius d about the last point where a s^2 + 2 b s + c = 0, s > 0
            step_x, step_y = end_x - from_x, end_y - from_y
            inside_x, inside_y = from_x - last_x, from_y - last_y
            a = step_x * step_x + step_y * step_y
            b = step_x * inside_x + step_y * inside_y
            c = min(inside_x * inside_x + inside_y * inside_y - d * d, 0.0)
            root = math.sqrt(b * b - a * c)
            s = min(-c / (b + root) if b > 0.0 else (root - b) / a, 1.0)
            from_x, from_y = from_x + s * step_x, from_y + s * step_y
            before_x, before_y = chord_x, chord_y
            chord_x, chord_y = from_x - last_x, from_y - last_y
            last_x, last_y = from_x, from_y
            chords += 1
            if chords > 1:
                turn = math.atan2(
                    before_x * chord_y - before_y * chord_x, before_x * chord_x + before_y * chord_y
                )
                latest = turn * turn / d  # c_i^2 d_i with c_i = turn / d
                energy += latest
                if chords == 2:
                    first = latest
    if chords < 2:
        return 0.0
    rest = math.hypot(xy[-1, 0] - last_x, xy[-1, 1] - last_y)
    return energy + 0.5 * first + (0.5 + rest / d) * latest


@jit
def _ratio(candidate: float, reference: float, floor: float) -> float:
    """Candidate over reference, always finite: 1 where both are under the floor, which else is the least divisor."""
    if candidate < floor and reference < floor:
        return 1.0
    return candidate / max(reference, floor)


@jit
def one_sided_kernel(
    candidate_xy: FloatArray, reference_xy: FloatArray, reference_length: float
) -> tuple[float, float, float]:
    """Return d_rms [m], d_haus [m] and d_ratio (Eq. 3.1), for use from other kernels: half the work of all metrics.

    Paths are (N, 2) and (M, 2) positions [m]; `reference_length` is `path_length` of the reference.
    It never raises: all are NaN where a path cannot be measured.
    """
    candidate_length = path_length(candidate_xy)
    if math.isnan(candidate_length + reference_length):
        return math.nan, math.nan, math.nan
    to_candidate = nearest_squared(reference_xy, candidate_xy)
    lengths = _ratio(candidate_length, reference_length, LENGTH_FLOOR)
    return math.sqrt(np.mean(to_candidate)), math.sqrt(np.max(to_candidate)), lengths


@jit
def bend_ratio_kernel(candidate_xy: FloatArray, reference_xy: FloatArray) -> float:
    """Return e_bend_ratio of (N, 2) and (M, 2) paths that `one_sided_kernel` could measure, for use from other kernels."""
    return _ratio(bending_energy(candidate_xy), bending_energy(reference_xy), BENDING_FLOOR)


class PathMeasures(NamedTuple):
    """All that the metrics of two paths are made of."""

    d_rms: float  # root mean square distance from the reference's samples to the closest of the candidate's [m]
    d_haus: float  # the largest of those distances [m]
    d_rms_symmetric: float  # root of the mean of both directions' mean squares [m]
    d_haus_symmetric: float  # the larger of both directions' largest distances [m]
    lengths: tuple[float, float]  # lengths of candidate and reference [m]
    bendings: tuple[float, float]  # bending energies of candidate and reference [1/m]


@jit_alone
def measure_paths(candidate: FloatArray, reference: FloatArray) -> PathMeasures:
    """Measure an (N, 2) or wider path [m] against an (M, 2) one.

    All are NaN where a path has no sample or one that is not finite (or beyond `LARGEST`), as a
    diverged candidate has.
    """
    lengths = path_length(candidate), path_length(reference)
    if math.isnan(lengths[0] + lengths[1]):
        none = (math.nan, math.nan)
        return PathMeasures(math.nan, math.nan, math.nan, math.nan, none, none)
    to_candidate, to_reference = (
        nearest_squared(reference, candidate),
        nearest_squared(candidate, reference),
    )
    mean, largest = np.mean(to_candidate), np.max(to_candidate)
    rms_both, largest_both = (
        math.sqrt(0.5 * (mean + np.mean(to_reference))),
        math.sqrt(max(largest, np.max(to_reference))),
    )
    bendings = bending_energy(candidate), bending_energy(reference)
    return PathMeasures(
        math.sqrt(mean), math.sqrt(largest), rms_both, largest_both, lengths, bendings
    )


_LEAF = 16  # samples of a leaf; of 8, 16 and 32 the fastest for 2500 samples
_BATCH = 32  # points of a batch; of 8, 16 and 32 the fastest for 2500 samples
_DEEP = 128  # room for nodes that wait, two of each level at most: more than any tree in memory has


@jit
def _enter(x: FloatArray, y: FloatArray, first: int, batch: FloatArray) -> float:
    """Update the square of a batch's distances by the leaf of samples from `first` on; return the largest of them [m^2].

    `batch` holds x, y and squared distance of each point, in three rows one after the other.
    """
    for j in range(first, first + _LEAF):
        here_x, here_y = x[j], y[j]
        for i in range(_BATCH):  # becomes vector instructions
            dx, dy = batch[i] - here_x, batch[_BATCH + i] - here_y
            square = dx * dx + dy * dy
            batch[2 * _BATCH + i] = (
                square if square < batch[2 * _BATCH + i] else batch[2 * _BATCH + i]
            )
    largest = 0.0
    for i in range(_BATCH):
        largest = max(largest, batch[2 * _BATCH + i])
    return largest


@jit
def _grow(path: FloatArray) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Return the tree of a path: the number of leaves, a power of two, the boxes of all nodes, and the samples' x and y.

    Node 1 is the whole path, and node n has the children 2 n and 2 n + 1. A box is the least x, the
    largest, and y likewise. The last leaf is filled up with the last sample; the box of a leaf
    without samples is infinitely far from anywhere.
    """
    m = path.shape[0]
    used, leaves = (m + _LEAF - 1) // _LEAF, 1
    while leaves < used:
        leaves *= 2
    boxes, x, y = np.empty((2 * leaves, 4)), np.empty(used * _LEAF), np.empty(used * _LEAF)
    for leaf in range(leaves):
        low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
        for j in range(leaf * _LEAF, min(leaf + 1, used) * _LEAF):
            k = min(j, m - 1)
            x[j], y[j] = path[k, 0], path[k, 1]
            low_x, high_x = min(low_x, x[j]), max(high_x, x[j])
            low_y, high_y = min(low_y, y[j]), max(high_y, y[j])
        box = boxes[leaves + leaf]
        box[0], box[1], box[2], box[3] = low_x, high_x, low_y, high_y
    for node in range(leaves - 1, 0, -1):
        one, other, box = boxes[2 * node], boxes[2 * node + 1], boxes[node]
        box[0], box[1] = min(one[0], other[0]), max(one[1], other[1])
        box[2], box[3] = min(one[2], other[2]), max(one[3], other[3])
    return leaves, boxes, x, y


@jit
def _gap(
    boxes: FloatArray, node: int, low_x: float, high_x: float, low_y: float, high_y: float
) -> float:
    """Return the square of the distance between a node's box and another one [m^2]."""
    gap_x: float = max(max(boxes[node, 0] - high_x, low_x - boxes[node, 1]), 0.0)
    gap_y: float = max(max(boxes[node, 2] - high_y, low_y - boxes[node, 3]), 0.0)
    return gap_x * gap_x + gap_y * gap_y


@jit
def _gather(
    points: FloatArray, first: int, count: int, batch: FloatArray
) -> tuple[float, float, float, float]:
    """Write `count` points into a batch, filled up with the last one, at no known distance yet; return their box."""
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    for i in range(_BATCH):
        k = first + min(i, count - 1)
        batch[i], batch[_BATCH + i], batch[2 * _BATCH + i] = points[k, 0], points[k, 1], np.inf
        low_x, high_x = min(low_x, points[k, 0]), max(high_x, points[k, 0])
        low_y, high_y = min(low_y, points[k, 1]), max(high_y, points[k, 1])
    return low_x, high_x, low_y, high_y


@jit_alone
def nearest_squared(points: FloatArray, path: FloatArray) -> FloatArray:
    """Return (N,) squares of the distances from (N, 2) points to the closest sample of the (M, 2) path [m^2].

    The nearer of two boxes is entered first, after the leaf that the last batch ended in. There
    must be a sample, and all numbers must be finite.
    """
    n = points.shape[0]
    leaves, boxes, x, y = _grow(path)
    out, batch = np.empty(n), np.empty(3 * _BATCH)
    nodes, gaps = np.empty(_DEEP, dtype=np.int64), np.empty(_DEEP)
    latest = 0
    for first in range(0, n, _BATCH):
        count = min(_BATCH, n - first)
        low_x, high_x, low_y, high_y = _gather(points, first, count, batch)
        begun = latest
        bound = _enter(x, y, begun * _LEAF, batch)
        nodes[0], gaps[0], waiting = 1, 0.0, 1
        while waiting > 0:
            waiting -= 1
            node = nodes[waiting]
            if gaps[waiting] >= bound or node == leaves + begun:
                continue
            if node < leaves:
                one = _gap(boxes, 2 * node, low_x, high_x, low_y, high_y)
                other = _gap(boxes, 2 * node + 1, low_x, high_x, low_y, high_y)
                near = 2 * node + (1 if other < one else 0)
                for child, gap in ((near ^ 1, max(one, other)), (near, min(one, other))):
                    if gap < bound:
                        nodes[waiting], gaps[waiting] = child, gap
                        waiting += 1
                continue
            before = batch[2 * _BATCH + count - 1]
            bound = _enter(x, y, (node - leaves) * _LEAF, batch)
            if batch[2 * _BATCH + count - 1] < before:
                latest = node - leaves
        for i in range(count):
            out[first + i] = batch[2 * _BATCH + i]
    return out
