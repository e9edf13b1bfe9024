"""Distances between paths of a candidate and a reference, for the thesis' metrics (Sec. 1.6).

Which way round. The candidate is the simulated motion, the reference the measured or desired one.
The thesis leaves it open (Sec. 1.6 writes d_B / d_A), so it is fixed here once, as Sec. 3.5.3 and
Algorithm 2 use it:

- ratios are candidate / reference: d_ratio = 1.0312 says that the simulated path is 3.12 % longer
than the real one;
- d_rms and d_haus are one-sided, from each sample of the reference to the candidate's path:
  Algorithm 2 loops over the points of the reference trajectory. They do not punish a candidate that
  covers the reference and then strays; the `_symmetric` metrics take both directions, and do.

The candidate's path is the polyline through its samples. Algorithm 2 goes to the closest sample
instead: samples h apart keep a floor of up to h / 2 between equal paths, and a distance that jumps
from sample to sample is no cost that a search can descend.

Kernels read columns 0 and 1 of their arguments, so (M, 3) poses serve as paths without a copy.

For the search for the closest segment, the path is cut into leaves of `_LEAF` consecutive segments.
A leaf has a box, the least that holds them, and so has every two neighbouring leaves, every two
such pairs, and so on up to the whole path: a tree of boxes, because a path is mostly near itself.
Consecutive points lie close together too, so `_BATCH` of them go down that tree at once, and take
the nearest segments from each leaf that they enter.

A box is passed over where even its nearest edge is as far from the box of the batch as each point's
closest segment yet: the answer is that of the search over all pairs, but for rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssmr._jit import jit, jit_alone
from ssmr.types import FloatArray

_BENDING_SPACING = 0.1
"""Distance between the points at which curvature is taken [m]: noise of size s adds about 6 s^2 /
d^4 per metre, so with the 0.5 mm of a tracking system a tenth of a metre is the least that leaves a
gentle path its own bending energy."""
LENGTH_FLOOR = 1e-3
"""A path shorter than this has no length to compare with [m]: a robot that stands still."""
BENDING_FLOOR = 1e-3
"""A path of less bending energy is straight [1/m]: 10 m along a circle of 100 m radius."""
_NO_LENGTH = 1e-300
"""A segment of less squared length is a point [m^2]."""
LARGEST = 1e75
"""Coordinates beyond this count as not finite [m]: their fourth powers would overflow."""


@jit_alone
def _step_sums(xy: FloatArray) -> tuple[float, float]:
    """Return the sum of the steps between samples [m], and the sum of their squares [m^2]."""
    total = 0.0
    squares = 0.0
    for i in range(xy.shape[0] - 1):
        dx = xy[i + 1, 0] - xy[i, 0]
        dy = xy[i + 1, 1] - xy[i, 1]
        square = dx * dx + dy * dy
        total += math.sqrt(square)
        squares += square
    return total, squares


@jit_alone
def path_length(xy: FloatArray) -> float:
    """Return the length of an (M, 2) or wider path [m].

    It is NaN where the path has no sample, or one that is not finite or beyond `LARGEST`.
    """
    for i in range(xy.shape[0]):
        x = xy[i, 0]
        y = xy[i, 1]
        if not (abs(x) <= LARGEST and abs(y) <= LARGEST):
            return math.nan
    return _step_sums(xy)[0] if len(xy) > 0 else math.nan


@jit_alone
def bending_energy(xy: FloatArray) -> float:
    """Return the total bending energy, sum of c_i^2 d_i (Sec. 1.6) [1/m].

    It is the integral of curvature squared along the path. The (M, 2) or wider path [m] is first
    laid out afresh: from its first sample on, the next point is where the polyline first gets the
    distance d away from the last point, so that all chords are d long. The local curvature c_i is
    the turn between two chords over d. Thus the outcome depends neither on the sampling rate nor on
    the speed, and a robot that stands still, or turns on the spot, adds nothing even while its
    measured position jitters by less than d. Each end takes the curvature of its neighbour, and so
    does what is left after the last chord. A path shorter than two chords has none.

    d is `_BENDING_SPACING`, or the mean step between samples (weighted by length) where that is
    longer: points laid closer than the samples would find all turning at the samples and none
    between them. A reversal is a turn by pi: pi^2 / d.
    """
    total, squares = _step_sums(xy)
    if not total > 0.0:
        return 0.0
    # At most M - 1 chords fit: total^2 <= (M - 1) squares.
    d = max(_BENDING_SPACING, squares / total)
    last_x = xy[0, 0]
    last_y = xy[0, 1]
    chord_x = 0.0
    chord_y = 0.0
    chords = 0
    energy = 0.0
    first = 0.0
    latest = 0.0
    for i in range(1, xy.shape[0]):
        end_x = xy[i, 0]
        end_y = xy[i, 1]
        # Within d of the last point, unlike the end if a chord ends here.
        from_x = xy[i - 1, 0]
        from_y = xy[i - 1, 1]
        while (end_x - last_x) ** 2 + (end_y - last_y) ** 2 >= d * d:
            # from + s (end - from) leaves the circle of radius d about the last point where
            # a s^2 + 2 b s + c = 0, s > 0.
            step_x = end_x - from_x
            step_y = end_y - from_y
            inside_x = from_x - last_x
            inside_y = from_y - last_y
            a = step_x * step_x + step_y * step_y
            b = step_x * inside_x + step_y * inside_y
            c = min(inside_x * inside_x + inside_y * inside_y - d * d, 0.0)
            root = math.sqrt(b * b - a * c)
            s = -c / (b + root) if b > 0.0 else (root - b) / a
            s = min(s, 1.0)
            from_x += s * step_x
            from_y += s * step_y
            before_x = chord_x
            before_y = chord_y
            chord_x = from_x - last_x
            chord_y = from_y - last_y
            last_x = from_x
            last_y = from_y
            chords += 1
            if chords == 1:
                continue
            sine = before_x * chord_y - before_y * chord_x
            cosine = before_x * chord_x + before_y * chord_y
            turn = math.atan2(sine, cosine)
            latest = turn * turn / d  # c_i^2 d_i with c_i = turn / d
            energy += latest
            if chords == 2:
                first = latest
    if chords < 2:
        return 0.0
    end = xy[-1]
    rest = math.hypot(end[0] - last_x, end[1] - last_y)
    return energy + 0.5 * first + (0.5 + rest / d) * latest


@jit
def _finite_ratio(candidate: float, reference: float, floor: float) -> float:
    """Return candidate over reference, always finite.

    It is 1 where both are under the floor, which otherwise is the least divisor.
    """
    if candidate < floor and reference < floor:
        return 1.0
    return candidate / max(reference, floor)


@jit
def _mean_and_largest(squares: FloatArray) -> tuple[float, float]:
    """Return mean and maximum of squares; numpy's take longer to compile than this module's."""
    total = 0.0
    largest = 0.0
    for square in squares:
        total += square
        largest = max(largest, square)
    return total / len(squares), largest


@jit
def one_sided_kernel(
    candidate_xy: FloatArray, reference_xy: FloatArray, reference_length: float
) -> tuple[float, float, float]:
    """Return d_rms [m], d_haus [m] and d_ratio (Eq. 3.1), for use from other kernels.

    This is half the work of all metrics. Paths are (N, 2) and (M, 2) positions [m];
    `reference_length` is `path_length` of the reference. It never raises: all are NaN where a path
    cannot be measured.
    """
    candidate_length = path_length(candidate_xy)
    if math.isnan(candidate_length + reference_length):
        return math.nan, math.nan, math.nan
    mean, largest = _mean_and_largest(nearest_squared(reference_xy, candidate_xy))
    lengths = _finite_ratio(candidate_length, reference_length, LENGTH_FLOOR)
    return math.sqrt(mean), math.sqrt(largest), lengths


@jit
def bend_ratio_kernel(candidate_xy: FloatArray, reference_xy: FloatArray) -> float:
    """Return e_bend_ratio of (N, 2) and (M, 2) paths, for use from other kernels.

    They are paths that `one_sided_kernel` could measure.
    """
    return _finite_ratio(bending_energy(candidate_xy), bending_energy(reference_xy), BENDING_FLOOR)


class PathMeasures(NamedTuple):
    """All that the metrics of two paths are made of."""

    d_rms: float  # root mean square distance from the reference's samples to the path [m]
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
    lengths = (path_length(candidate), path_length(reference))
    if math.isnan(lengths[0] + lengths[1]):
        none = (math.nan, math.nan)
        return PathMeasures(math.nan, math.nan, math.nan, math.nan, none, none)
    mean, largest = _mean_and_largest(nearest_squared(reference, candidate))
    other_mean, other_largest = _mean_and_largest(nearest_squared(candidate, reference))
    return PathMeasures(
        d_rms=math.sqrt(mean),
        d_haus=math.sqrt(largest),
        d_rms_symmetric=math.sqrt(0.5 * (mean + other_mean)),
        d_haus_symmetric=math.sqrt(max(largest, other_largest)),
        lengths=lengths,
        bendings=(bending_energy(candidate), bending_energy(reference)),
    )


_LEAF = 16  # segments of a leaf; of 8, 16 and 32 the fastest for 2500 samples
_BATCH = 32  # points of a batch; of 8, 16 and 32 the fastest for 2500 samples
_DEEP = 128  # room for nodes that wait, two of each level at most: more than any tree in memory has


_Box = tuple[float, float, float, float]
"""The least and greatest x, and the least and greatest y of points [m]."""
_EMPTY = (math.inf, -math.inf, math.inf, -math.inf)
"""A box without points."""


@jit
def _stretch_box(box: _Box, x: float, y: float) -> _Box:
    """Return the least box that holds a box and a point."""
    low_x, high_x, low_y, high_y = box
    return min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)


@jit
def squared_distance(x: float, y: float, segment: FloatArray) -> tuple[float, float, float]:
    """Return the squared distance of a place from a segment, and the vector to its nearest point.

    The segment is a row of x and y of its beginning, x and y of its way to the end [m], and the
    inverse of the square of its length [1/m^2], 0 for one without a length.
    """
    to_x = segment[0] - x
    to_y = segment[1] - y
    share = -(to_x * segment[2] + to_y * segment[3]) * segment[4]
    share = min(max(share, 0.0), 1.0)
    to_x += share * segment[2]
    to_y += share * segment[3]
    return to_x * to_x + to_y * to_y, to_x, to_y


@jit_alone
def path_segments(path: FloatArray) -> FloatArray:
    """Return the (M, 5) segments of an (M, 2) or wider path, see `squared_distance`.

    The last sample is one without a length, so that each lies on the path to the last bit.
    """
    out = np.zeros((len(path), 5))
    for j in range(len(path)):
        k = min(j + 1, len(path) - 1)
        step_x = path[k, 0] - path[j, 0]
        step_y = path[k, 1] - path[j, 1]
        square = step_x * step_x + step_y * step_y
        out[j, 0] = path[j, 0]
        out[j, 1] = path[j, 1]
        out[j, 2] = step_x
        out[j, 3] = step_y
        # the inverse of a length of 1e-160 m would be infinite
        if square > _NO_LENGTH:
            out[j, 4] = 1.0 / square
    return out


@jit
def _enter_leaf(segments: FloatArray, first: int, batch: FloatArray) -> float:
    """Update squares of a batch's distances by the leaf of segments from `first` on.

    `batch` holds x, y and squared distance of each point, in three rows one after the other. The
    largest square is returned [m^2].
    """
    for j in range(first, min(first + _LEAF, len(segments))):
        segment = segments[j]
        for i in range(_BATCH):  # becomes vector instructions
            square, _, _ = squared_distance(batch[i], batch[_BATCH + i], segment)
            least = batch[2 * _BATCH + i]
            batch[2 * _BATCH + i] = square if square < least else least
    largest = 0.0
    for i in range(_BATCH):
        largest = max(largest, batch[2 * _BATCH + i])
    return largest


@jit
def _grow_tree(path: FloatArray) -> tuple[int, FloatArray]:
    """Return the tree over a path's segments: its number of leaves, and the boxes of all nodes.

    The leaves are a power of two. Node 1 is the whole path, and node n has the children 2 n and
    2 n + 1. A row of the boxes is a `_Box`; that of a leaf without segments is infinitely far from
    anywhere.
    """
    count = len(path)
    leaves = 1
    while leaves * _LEAF < count:
        leaves *= 2
    boxes = np.empty((2 * leaves, 4))
    for leaf in range(leaves):
        box = _EMPTY
        first = leaf * _LEAF
        if first < count:
            # the last segment ends where the next leaf begins
            for j in range(first, min(first + _LEAF, count - 1) + 1):
                box = _stretch_box(box, path[j, 0], path[j, 1])
        for side, number in enumerate(box):
            boxes[leaves + leaf, side] = number
    for node in range(leaves - 1, 0, -1):
        one = boxes[2 * node]
        other = boxes[2 * node + 1]
        for low in (0, 2):
            boxes[node, low] = min(one[low], other[low])
            boxes[node, low + 1] = max(one[low + 1], other[low + 1])
    return leaves, boxes


@jit
def _squared_gap(node: FloatArray, box: _Box) -> float:
    """Return the square of the distance between a node's box, a row, and another one [m^2]."""
    low_x, high_x, low_y, high_y = box
    gap_x: float = max(max(node[0] - high_x, low_x - node[1]), 0.0)
    gap_y: float = max(max(node[2] - high_y, low_y - node[3]), 0.0)
    return gap_x * gap_x + gap_y * gap_y


@jit
def _gather_points(points: FloatArray, first: int, count: int, batch: FloatArray) -> _Box:
    """Write `count` points into a batch, at no known distance yet; return their box.

    The batch is filled up with the last one.
    """
    box = _EMPTY
    for i in range(_BATCH):
        k = first + min(i, count - 1)
        batch[i] = points[k, 0]
        batch[_BATCH + i] = points[k, 1]
        batch[2 * _BATCH + i] = np.inf
        box = _stretch_box(box, points[k, 0], points[k, 1])
    return box


@jit_alone
def nearest_squared(points: FloatArray, path: FloatArray) -> FloatArray:
    """Return (N,) squares of the distances from (N, 2) points to an (M, 2) path [m^2].

    A distance is that to the closest segment. The nearer of two boxes is entered first, after the
    leaf that the last batch ended in. There must be a sample, and all numbers must be finite.
    """
    n = points.shape[0]
    leaves, boxes = _grow_tree(path)
    segments = path_segments(path)
    out = np.empty(n)
    batch = np.empty(3 * _BATCH)
    nodes = np.empty(_DEEP, dtype=np.int64)
    gaps = np.empty(_DEEP)
    latest = 0
    for first in range(0, n, _BATCH):
        count = min(_BATCH, n - first)
        box = _gather_points(points, first, count, batch)
        begun = latest
        bound = _enter_leaf(segments, begun * _LEAF, batch)
        nodes[0] = 1
        gaps[0] = 0.0
        waiting = 1
        while waiting > 0:
            waiting -= 1
            node = nodes[waiting]
            if gaps[waiting] >= bound or node == leaves + begun:
                continue
            if node < leaves:
                one = _squared_gap(boxes[2 * node], box)
                other = _squared_gap(boxes[2 * node + 1], box)
                near = 2 * node + (1 if other < one else 0)
                for child, gap in ((near ^ 1, max(one, other)), (near, min(one, other))):
                    if gap < bound:
                        nodes[waiting] = child
                        gaps[waiting] = gap
                        waiting += 1
                continue
            before = batch[2 * _BATCH + count - 1]
            bound = _enter_leaf(segments, (node - leaves) * _LEAF, batch)
            if batch[2 * _BATCH + count - 1] < before:
                latest = node - leaves
        for i in range(count):
            out[first + i] = batch[2 * _BATCH + i]
    return out
