"""The search for the closest sample of a path, for many points at once.

The path is cut into leaves of `_LEAF` consecutive samples. A leaf has a box, the least that holds its samples, and so has
every two neighbouring leaves, every two such pairs, and so on up to the whole path: a tree of boxes, because a path is
mostly near itself. Consecutive points lie close together too, so `_BATCH` of them go down that tree at once, and take
from each leaf that they enter what is nearest, in vector instructions.

A box is passed over where even its nearest edge is as far from the box of the batch as each point's closest sample yet.
Subtraction, multiplication and addition round monotonically, so the computed distance of boxes is never more than that of
a point and a sample in them: the answer is that of the search over all pairs, to the last bit, with no slack.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types

from ssmr._jit import built_in, jit, jit_alone
from ssmr.types import FloatArray

_LEAF = 16
"""Samples of a leaf; of 8, 16 and 32 the fastest for 2500 samples."""
_BATCH = 32
"""Points of a batch; of 8, 16 and 32 the fastest for 2500 samples."""
_PATIENCE = 16
"""Leaves that a batch enters, or twice as many as the last one, before it is asked whether its points belong together."""
_DEEP = 128
"""Room for nodes that wait, two of each level at most: more than any tree in memory has."""


@built_in
def _enter(typing: Any, x: Any, y: Any, at: Any, points: Any) -> Any:
    """Update the square of a batch's distances by the samples from `at` on, and return the largest of them [m^2].

    `points` holds x, y and squared distance of each point, in three rows one after the other.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double = ir.DoubleType()
        lanes = ir.VectorType(double, _BATCH)
        first = ir.Constant(ir.VectorType(ir.IntType(32), _BATCH), [0] * _BATCH)
        empty = ir.Constant(lanes, ir.Undefined)
        data = [context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 1, 3)]

        def row(k: int) -> Any:
            start = builder.gep(data[2], [context.get_constant(types.intp, k * _BATCH)])
            return builder.bitcast(start, lanes.as_pointer())

        def of_all(samples: Any, k: Any) -> Any:
            number = builder.insert_element(empty, builder.load(builder.gep(samples, [k])), ir.Constant(ir.IntType(32), 0))
            return builder.shuffle_vector(number, empty, first)

        here_x, here_y, least = (builder.load(row(k), align=8) for k in range(3))
        for j in range(_LEAF):
            k = builder.add(arguments[2], context.get_constant(types.intp, j))
            dx, dy = builder.fsub(here_x, of_all(data[0], k)), builder.fsub(here_y, of_all(data[1], k))
            square = builder.fadd(builder.fmul(dx, dx), builder.fmul(dy, dy))
            least = builder.select(builder.fcmp_ordered("<", square, least), square, least)
        builder.store(least, row(2), align=8)
        name = f"llvm.vector.reduce.fmax.v{_BATCH}f64"
        largest = builder.module.declare_intrinsic(name, (), ir.FunctionType(double, [lanes]))
        return builder.call(largest, [least], fastmath=("nnan",))

    return types.float64(x, y, types.intp, points), build


@jit
def _grow(path: FloatArray) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Return the tree of a path: the number of leaves, a power of two, the boxes of all nodes, and the samples' x and y.

    Node 1 is the whole path, and node n has the children 2 n and 2 n + 1. A box is the least x, the largest, and y likewise.
    The last leaf is filled up with the last sample; the box of a leaf without samples is infinitely far from anywhere.
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
def _gap(boxes: FloatArray, node: int, low_x: float, high_x: float, low_y: float, high_y: float) -> float:
    """Return the square of the distance between a node's box and another one [m^2]."""
    gap_x: float = max(max(boxes[node, 0] - high_x, low_x - boxes[node, 1]), 0.0)
    gap_y: float = max(max(boxes[node, 2] - high_y, low_y - boxes[node, 3]), 0.0)
    return gap_x * gap_x + gap_y * gap_y


@jit
def _gather(points: FloatArray, first: int, count: int, batch: FloatArray) -> tuple[float, float, float, float]:
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
    """Square of the distance from each of (N, 2) points to the closest sample of the (M, 2) path, (N,) [m^2].

    The nearer of two boxes is entered first, after the leaf that the last batch ended in. A batch whose points lie far from
    each other, as they do beside a jump, enters far more leaves than each of them alone would; it is halved until they
    belong together, or a half enters as many all the same. There must be a sample, and all numbers must be finite.
    """
    n = points.shape[0]
    leaves, boxes, x, y = _grow(path)
    out, batch = np.empty(n), np.empty(3 * _BATCH)
    nodes, gaps = np.empty(_DEEP, dtype=np.int64), np.empty(_DEEP)
    first, size, latest, patience = 0, _BATCH, 0, _PATIENCE
    while first < n:
        count = min(size, n - first)
        low_x, high_x, low_y, high_y = _gather(points, first, count, batch)
        spread = (high_x - low_x) ** 2 + (high_y - low_y) ** 2
        begun, entered, scattered = latest, 0, False
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
            entered += 1
            scattered = entered > patience and count > 1 and 4.0 * spread > bound
            if scattered:
                break
            before = batch[2 * _BATCH + count - 1]
            bound = _enter(x, y, (node - leaves) * _LEAF, batch)
            if batch[2 * _BATCH + count - 1] < before:
                latest = node - leaves
        size = min(2 * size, _BATCH)
        if scattered:
            size = count // 2
        else:
            out[first : first + count] = batch[2 * _BATCH : 2 * _BATCH + count]
            first, patience = first + count, max(_PATIENCE, 2 * entered)
    return out
