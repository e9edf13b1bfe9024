"""A smooth, periodic surface of heights, and where wheels that roll over it touch it.

A surface is a bicubic spline through heights on a square grid: height, slope and curvature are continuous, so a wheel that
rolls over it is lifted smoothly. A wheel touches it where its rim and the surface have the same normal; there is one such
place as long as the surface is nowhere curved upward as tightly as the wheel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from ssmr._jit import jit, jit_alone
from ssmr.types import FloatArray, frozen_array

TOUCH_ITERATIONS = 3
"""Fixed-point steps to the place where a wheel touches; each gains a factor of radius times curvature, a tenth or so."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights on a square grid that repeats itself in x and y."""

    heights: FloatArray
    """(n, n) [m]: rows along y, columns along x; the first is at `origin`."""
    cell: float
    """Distance of two neighbours [m]."""
    origin: float = 0.0
    """x and y of the first height [m]."""

    def __post_init__(self) -> None:
        """Check and freeze."""
        heights = frozen_array(self.heights, "heights", (None, None))
        if heights.shape[0] != heights.shape[1] or len(heights) < 4:
            raise ValueError(f"heights have shape {heights.shape}, wanted a square of at least 4x4")
        if not (np.isfinite(self.cell) and self.cell > 0.0):
            raise ValueError(f"the cell must be positive, got {self.cell} m")
        object.__setattr__(self, "heights", heights)

    @cached_property
    def coefficients(self) -> FloatArray:
        """(n, n) weights of the cubic B-splines that pass through the heights [m]."""
        return np.ascontiguousarray(ndimage.spline_filter(self.heights, order=3, mode="grid-wrap"))

    def at(self, xy: ArrayLike) -> FloatArray:
        """Return (M, 3) height [m] and slopes along x and y [1] at (M, 2) positions [m]."""
        points = np.ascontiguousarray(xy, dtype=np.float64).reshape(-1, 2)
        out = np.empty((len(points), 3))
        _sample(self.coefficients, self.cell, self.origin, points, out)
        return out

    def tangent_planes(self, poses: FloatArray, wheels: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
        """Return the planes on which wheels of a radius [m] stand, as (S, 4, 3) points [m] and (S, 4, 4) quaternions.

        Points are where planes touch the surface; quaternions (w first) turn z to the planes' normals. `poses` are (S, 7)
        positions [m] and quaternions (w first) of the bodies, `wheels` the (4, 3) wheel centres in the body [m].
        """
        places, turns = np.empty((len(poses), len(wheels), 3)), np.empty((len(poses), len(wheels), 4))
        _tangent_planes(
            self.coefficients, self.cell, self.origin, np.ascontiguousarray(poses), wheels, radius, places, turns
        )
        return places, turns


@jit
def _surface(c: FloatArray, cell: float, origin: float, x: float, y: float) -> tuple[float, float, float]:
    """Return height [m] and slopes along x and y [1] at one place."""
    n = len(c)
    u, v = (x - origin) / cell, (y - origin) / cell
    i, j = np.floor(u), np.floor(v)
    a, b = u - i, v - j
    # the four cubic B-splines that reach here, along x and along y, and their slopes
    wx = ((1 - a) ** 3 / 6, (3 * a**3 - 6 * a**2 + 4) / 6, (-3 * a**3 + 3 * a**2 + 3 * a + 1) / 6, a**3 / 6)
    wy = ((1 - b) ** 3 / 6, (3 * b**3 - 6 * b**2 + 4) / 6, (-3 * b**3 + 3 * b**2 + 3 * b + 1) / 6, b**3 / 6)
    dx = (-((1 - a) ** 2) / 2, (3 * a**2 - 4 * a) / 2, (-3 * a**2 + 2 * a + 1) / 2, a**2 / 2)
    dy = (-((1 - b) ** 2) / 2, (3 * b**2 - 4 * b) / 2, (-3 * b**2 + 2 * b + 1) / 2, b**2 / 2)
    height, along_x, along_y = 0.0, 0.0, 0.0
    for k in range(4):
        row = int(j + k - 1) % n
        value, slope = 0.0, 0.0
        for m in range(4):
            weight = c[row, int(i + m - 1) % n]
            value += wx[m] * weight
            slope += dx[m] * weight
        height += wy[k] * value
        along_x += wy[k] * slope
        along_y += dy[k] * value
    return height, along_x / cell, along_y / cell


@jit_alone
def _sample(c: FloatArray, cell: float, origin: float, points: FloatArray, out: FloatArray) -> None:
    for k in range(len(points)):
        out[k, 0], out[k, 1], out[k, 2] = _surface(c, cell, origin, points[k, 0], points[k, 1])


@jit_alone
def _tangent_planes(
    c: FloatArray, cell: float, origin: float, poses: FloatArray, wheels: FloatArray, radius: float,
    places: FloatArray, turns: FloatArray,
) -> None:  # fmt: skip
    for s in range(len(poses)):
        px, py, _, qw, qx, qy, qz = poses[s]
        for k in range(len(wheels)):
            a, b, d = wheels[k]
            # the wheel's centre: rotate by the quaternion, of which only x and y matter
            centre_x = px + (1 - 2 * (qy * qy + qz * qz)) * a + 2 * (qx * qy - qw * qz) * b + 2 * (qx * qz + qw * qy) * d
            centre_y = py + 2 * (qx * qy + qw * qz) * a + (1 - 2 * (qx * qx + qz * qz)) * b + 2 * (qy * qz - qw * qx) * d
            x, y = centre_x, centre_y
            h, gx, gy = _surface(c, cell, origin, x, y)
            for _ in range(TOUCH_ITERATIONS):
                size = np.sqrt(1.0 + gx * gx + gy * gy)
                x, y = centre_x + radius * gx / size, centre_y + radius * gy / size  # a radius against the normal
                h, gx, gy = _surface(c, cell, origin, x, y)
            size = np.sqrt(1.0 + gx * gx + gy * gy)
            normal_x, normal_y, normal_z = -gx / size, -gy / size, 1.0 / size
            places[s, k, 0], places[s, k, 1], places[s, k, 2] = x, y, h
            w = np.sqrt(0.5 * (1.0 + normal_z))  # half of the angle between z and the normal, about z x normal
            turns[s, k, 0], turns[s, k, 1], turns[s, k, 2], turns[s, k, 3] = w, -normal_y / (2 * w), normal_x / (2 * w), 0.0
