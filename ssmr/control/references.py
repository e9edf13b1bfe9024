"""Reference trajectories that a formula gives, as dense waypoints.

A line, a circle and a sine are sample trajectories of Sec. 4.1.3; the others are this project's,
and the curvature of each is continuous. All begin at the origin. `speed` is that of the target
while it moves [m/s]: the thesis ran each at 0.25 and 0.50 m/s. A number that is not positive and
finite is a ValueError.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from ssmr.control.waypoints import Waypoints
from ssmr.geometry import integrate_rates
from ssmr.types import FloatArray

SPACING = 0.02
"""Greatest arc length between neighbouring waypoints [m]; a tenth of a second at 0.2 m/s, and a
heading step of 0.08 rad in the tightest corner that is practicable at 0.5 m/s."""
_GAUSS = np.polynomial.legendre.leggauss(5)
"""Nodes and weights of the rule that integrates the direction of a step."""
_REFINEMENT = 20
"""Steps in which the arc length of a sine is summed, for each waypoint: its error is below 1e-6 of
the length."""


def line(speed: float, length: float = 10.8) -> Waypoints:
    """Return a straight line along x of this `length` [m].

    docs/errata.md derives the thesis' length from its tables.
    """
    _require_positive(length=length)
    x = _arc_lengths(length)
    return Waypoints.from_path(np.column_stack([x, np.zeros(len(x))]), speed)


def circle(speed: float, radius: float = 1.5, turns: float = 1.0) -> Waypoints:
    """Return a circle to the left, which begins along x.

    `radius` is that of the circle [m], by default that of the captions of Tab. 4.7 and 4.8; it is
    driven `turns` times.
    """
    _require_positive(radius=radius, turns=turns)
    angle = _arc_lengths(2.0 * math.pi * radius * turns) / radius
    places = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    return Waypoints.from_path(places, speed)


def sine(
    speed: float, amplitude: float = 0.5, wavelength: float = 4.0, periods: float = 2.0
) -> Waypoints:
    """Return a sine along x, y = A sin(2 pi x / lambda).

    Its geometry is not in the thesis: amplitude, wavelength and periods are our choice. The
    greatest curvature A (2 pi / lambda)^2 = 1.23 1/m asks for 0.62 rad/s at 0.5 m/s, under a third
    of the 2 rad/s that saturate.

    `amplitude` is A [m], `wavelength` lambda [m]; the path is `periods` wavelengths long.
    """
    _require_positive(amplitude=amplitude, wavelength=wavelength, periods=periods)
    k = 2.0 * math.pi / wavelength
    end = periods * wavelength
    bound = end * math.hypot(1.0, amplitude * k)  # no arc is longer
    x = np.linspace(0.0, end, _REFINEMENT * _step_count(bound) + 1)
    slope = np.hypot(1.0, amplitude * k * np.cos(k * x))
    arc = integrate_rates(x, slope)
    along = np.interp(_arc_lengths(float(arc[-1])), arc, x)
    aside = amplitude * np.sin(k * along)
    return Waypoints.from_path(np.column_stack([along, aside]), speed)


def eight(speed: float, half_width: float = 1.25) -> Waypoints:
    """Return the lemniscate of Bernoulli, once around both loops, the first to the left.

    It begins at its crossing. With r the distance from the crossing and a the half width, its
    curvature is 3 r / a^2: zero at the crossing, and at most 3 / a = 2.40 1/m. The path is
    x = a cos(u) / (1 + sin(u)^2), y = x sin(u), and its arc ds = a du / sqrt(1 + sin(u)^2).

    `half_width` is a, the distance from the crossing to each end [m].
    """
    _require_positive(half_width=half_width)
    steps = 2 * _REFINEMENT * _step_count(6.0 * half_width)  # 5.244 a is its length
    u = np.linspace(-0.5 * math.pi, 1.5 * math.pi, steps + 1)
    rate = half_width / np.hypot(1.0, np.sin(u))
    arc = integrate_rates(u, rate)
    at = np.interp(_arc_lengths(float(arc[-1])), arc, u)
    sine = np.sin(at)
    x = half_width * np.cos(at) / (1.0 + sine**2)
    x[[0, -1]] = 0.0  # the cosine of a rounded right angle is not quite zero
    return Waypoints.from_path(np.column_stack([x, x * sine]), speed)


def square(speed: float, side: float = 2.0, curvature: float = 3.0) -> Waypoints:
    """Return a square to the left with rounded corners, from the middle of a side once around.

    In a corner the curvature grows linearly, and falls as it grew (two clothoids of a turn by 45
    degrees each).

    `side` is the length of a side, measured to the sharp corner that is cut [m]; `curvature` is the
    greatest curvature, in the middle of a corner [1/m].

    Raises:
        ValueError: corners that do not fit between the sides.
    """
    _require_positive(side=side, curvature=curvature)
    ramp = 0.5 * math.pi / curvature
    corner = [(ramp, 0.0, curvature), (ramp, curvature, 0.0)]
    x, y = _places_along(corner)[-1]
    cut = 0.5 * (x + y)  # both are the part of a side that a corner takes, up to rounding
    if not cut < 0.5 * side:
        raise ValueError(
            f"corners take {2.0 * cut:.3g} m of a side of {side:g} m; "
            "lengthen it, or raise the curvature"
        )
    straight = (0.5 * side - cut, 0.0, 0.0)
    return Waypoints.from_path(_places_along([straight, *corner, straight] * 4), speed)


def spiral(speed: float, length: float = 10.0, curvature: float = 2.5) -> Waypoints:
    """Return a clothoid: a spiral to the left whose curvature grows evenly from zero.

    It begins along x. `length` is the length of the path [m]; `curvature` is that at the end [1/m].
    """
    _require_positive(length=length, curvature=curvature)
    return Waypoints.from_path(_places_along([(length, 0.0, curvature)]), speed)


def u_turn(speed: float, width: float = 0.8, straight: float = 2.0) -> Waypoints:
    """Return a straight along x, a turn to the left by 180 degrees, and as long a straight back.

    Over the first quarter of the turn's length the curvature grows evenly; then it stays; over the
    last quarter it falls.

    `width` is the distance between the straights, `straight` the length of each [m].
    """
    _require_positive(width=width, straight=straight)
    wide = float(_places_along(_half_turn(1.0))[-1, 1])
    way = (straight, 0.0, 0.0)
    return Waypoints.from_path(_places_along([way, *_half_turn(wide / width), way]), speed)


def stop_and_go(speed: float, leg: float = 1.5, wait: float = 2.0, legs: int = 4) -> Waypoints:
    """Return a straight along x in legs; after each of them the target waits.

    `leg` is the length between stops [m], `wait` the time at each stop [s], `legs` the number of
    legs.
    """
    _require_positive(leg=leg, wait=wait, legs=legs)
    one = line(speed, leg)
    t = np.append(one.t, one.duration + wait)
    xy = np.vstack([one.xy, one.xy[-1:]])
    times = [t[:1]]
    places = [xy[:1]]
    for k in range(legs):
        times.append(t[1:] + k * t[-1])
        places.append(xy[1:] + np.array([k * leg, 0.0]))
    return Waypoints(np.concatenate(times), np.vstack(places))


def winding_path(speed: float, curvatures: Sequence[float], piece: float = 0.8) -> Waypoints:
    """Return a path whose curvature goes evenly from each given one to the next, first along x.

    There are two or more `curvatures`, positive to the left [1/m]; `piece` is the arc length from
    one to the next [m].

    Raises:
        ValueError: fewer than two curvatures.
    """
    _require_positive(piece=piece)
    if len(curvatures) < 2:
        raise ValueError(f"a winding path has two curvatures or more, got {len(curvatures)}")
    pieces = [(piece, a, b) for a, b in itertools.pairwise(curvatures)]
    return Waypoints.from_path(_places_along(pieces), speed)


def _half_turn(curvature: float) -> list[tuple[float, float, float]]:
    """Return the pieces of a turn by 180 degrees, see `u_turn`; `curvature` is its greatest."""
    quarter = math.pi / curvature / 3.0
    middle = (2.0 * quarter, curvature, curvature)
    return [(quarter, 0.0, curvature), middle, (quarter, curvature, 0.0)]


def _places_along(pieces: Sequence[tuple[float, float, float]]) -> FloatArray:
    """Return (N, 2) places [m] along pieces whose curvature is linear in their arc length.

    The path begins at the origin along x. Each piece is divided evenly. A step's chord is the
    integral of its direction, by a Gauss rule whose error is far below rounding at these lengths.

    `pieces` are the length [m] of each piece, and the curvature at its begin and its end [1/m].
    """
    steps = []
    begins = []
    ends = []
    for length, begin, end in pieces:
        n = _step_count(length)
        edges = np.linspace(begin, end, n + 1)
        steps.append(np.full(n, length / n))
        begins.append(edges[:-1])
        ends.append(edges[1:])
    ds, k0, k1 = map(np.concatenate, (steps, begins, ends))
    turns = 0.5 * (k0 + k1) * ds
    headings = np.cumsum(turns) - turns
    nodes, weights = _GAUSS
    u = 0.5 * (1.0 + nodes)
    slopes = 0.5 * (k1 - k0)
    bends = k0[:, None] * u + slopes[:, None] * u**2
    along = headings[:, None] + ds[:, None] * bends
    cosines = np.cos(along) @ weights
    sines = np.sin(along) @ weights
    directions = np.column_stack([cosines, sines])
    return np.cumulative_sum(0.5 * ds[:, None] * directions, axis=0, include_initial=True)


def _require_positive(**numbers: float) -> None:
    for name, number in numbers.items():
        if not (math.isfinite(number) and number > 0.0):
            raise ValueError(f"{name} must be positive and finite, got {number}")


def _step_count(length: float) -> int:
    """Return the number of steps of at most `SPACING` in a length [m]."""
    return max(1, math.ceil(length / SPACING - 1e-9))


def _arc_lengths(length: float) -> FloatArray:
    """Return arc lengths from 0 to `length` [m], evenly and densely spread."""
    return np.linspace(0.0, length, _step_count(length) + 1)
