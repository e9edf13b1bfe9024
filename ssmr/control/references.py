"""The sample trajectories of Sec. 4.1.3 that a formula gives: a line, a circle and a sine, as dense waypoints.

All begin at the origin. Speeds are those of the caller: the thesis ran each at 0.25 and 0.50 m/s.
"""

from __future__ import annotations

import math

import numpy as np

from ssmr.control.waypoints import Waypoints
from ssmr.types import FloatArray

SPACING = 0.02
"""Greatest arc length between neighbouring waypoints [m]; a tenth of a second at 0.2 m/s, and a heading step of 0.08 rad in
the tightest corner that is practicable at 0.5 m/s."""
_REFINEMENT = 20
"""Steps in which the arc length of a sine is summed, for each waypoint: its error is below 1e-6 of the length."""


def line(speed: float, length: float = 10.8) -> Waypoints:
    """Return a straight line along x.

    The length is not in the thesis. The simulated robot stays short of the end by d_haus, which is the share 1 - d_ratio of
    the length: Tab. 4.6 gives 0.0729 m / 0.0067 = 10.9 m. The printed digits of all four tables of the line (4.5, 4.6,
    4.22, 4.23) leave 10.79 to 10.85 m; 10.8 m is the round number among them.

    Args:
        speed: reference speed [m/s].
        length: of the line [m].

    Raises:
        ValueError: a number that is not positive and finite.
    """
    _require_positive(length=length)
    return Waypoints.from_path(np.column_stack([_spread(length), np.zeros(_count(length) + 1)]), speed)


def circle(speed: float, radius: float = 1.5, turns: float = 1.0) -> Waypoints:
    """Return a circle to the left, which begins along x; its radius is that of the captions of Tab. 4.7 and 4.8.

    Args:
        speed: reference speed [m/s].
        radius: of the circle [m].
        turns: how often it is driven.

    Raises:
        ValueError: a number that is not positive and finite.
    """
    _require_positive(radius=radius, turns=turns)
    angle = _spread(2.0 * math.pi * radius * turns) / radius
    return Waypoints.from_path(radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]), speed)


def sine(speed: float, amplitude: float = 0.5, wavelength: float = 4.0, periods: float = 2.0) -> Waypoints:
    """Return a sine along x, y = A sin(2 pi x / lambda).

    Its geometry is not in the thesis: amplitude, wavelength and periods are our choice. The greatest curvature
    A (2 pi / lambda)^2 = 1.23 1/m asks for 0.62 rad/s at 0.5 m/s, under a third of the 2 rad/s that saturate.

    Args:
        speed: reference speed [m/s].
        amplitude: A [m].
        wavelength: lambda [m].
        periods: how many wavelengths long.

    Raises:
        ValueError: a number that is not positive and finite.
    """
    _require_positive(amplitude=amplitude, wavelength=wavelength, periods=periods)
    k = 2.0 * math.pi / wavelength
    end = periods * wavelength
    bound = end * math.hypot(1.0, amplitude * k)  # no arc is longer
    x = np.linspace(0.0, end, _REFINEMENT * _count(bound) + 1)
    slope = np.hypot(1.0, amplitude * k * np.cos(k * x))
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x))])
    along = np.interp(_spread(float(arc[-1])), arc, x)
    return Waypoints.from_path(np.column_stack([along, amplitude * np.sin(k * along)]), speed)


def _require_positive(**numbers: float) -> None:
    for name, number in numbers.items():
        if not (math.isfinite(number) and number > 0.0):
            raise ValueError(f"{name} must be positive and finite, got {number}")


def _count(length: float) -> int:
    """Return the number of steps of at most `SPACING` in a length [m]."""
    return max(1, math.ceil(length / SPACING - 1e-9))


def _spread(length: float) -> FloatArray:
    """Return arc lengths from 0 to `length` [m], evenly and densely spread."""
    return np.linspace(0.0, length, _count(length) + 1)
