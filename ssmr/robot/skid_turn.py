"""Closed form of a turn on the spot, without any simulation; docs/physics.md and docs/contact.md derive it.

Rigid tyres slide on the ground, left and right ones turning alike and against each other; nothing accelerates. The robot
then moves so that the forces and the moments of friction cancel, which is where what friction dissipates is least: that is
convex in the motion, so there is nothing to search.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ssmr.types import FloatArray

FRONT = np.array([1.0, 1.0, -1.0, -1.0])
LEFT = np.array([1.0, -1.0, 1.0, -1.0])
"""Which wheels are in front (1) and behind (-1), and on the left (1) and the right (-1): front left, front right, rear left,
rear right."""


@dataclass(frozen=True)
class SkidTurn:
    """A quasi-static turn on the spot, for tyres whose rims roll at 1 m/s, the right ones forward."""

    forward: float
    """Speed of the middle between the axles ahead [m/s]."""
    across: float
    """Speed of the middle between the axles to the left [m/s]."""
    yaw_rate: float
    """Yaw rate [rad/s]; 0 for a robot that drives straight although its sides turn against each other."""
    track: float
    """Distance of the sides [m]."""

    @property
    def multiplier(self) -> float:
        """Yaw rate of the wheels over that of the body [1]; infinite for none."""
        return 2.0 / (self.track * self.yaw_rate) if self.yaw_rate > 0.0 else math.inf

    @property
    def centre(self) -> tuple[float, float]:
        """Centre of rotation: x ahead of the middle, y to its left [m]; infinitely far for a robot that drives straight."""
        if self.yaw_rate <= 0.0:
            return math.inf, math.inf
        return -self.across / self.yaw_rate, self.forward / self.yaw_rate


class _Contacts(NamedTuple):
    x: FloatArray
    y: FloatArray
    load: FloatArray
    rolling: FloatArray


def _contacts(wheelbase: float, track: float, x: float, y: float, half_width: float) -> _Contacts:
    """Return the contact points, their shares of the load (linear in the place: equal springs) and rolling speeds [m/s]."""
    wheel_x, wheel_y = 0.5 * wheelbase * FRONT, 0.5 * track * LEFT
    load = 0.25 * (1.0 + x * FRONT / (0.5 * wheelbase) + y * LEFT / (0.5 * track))
    rolling = -LEFT
    if half_width == 0.0:
        return _Contacts(wheel_x, wheel_y, load, rolling)
    y_twice = np.concatenate([wheel_y - half_width, wheel_y + half_width])
    return _Contacts(np.tile(wheel_x, 2), y_twice, np.tile(0.5 * load, 2), np.tile(rolling, 2))


def turn_on_the_spot(
    wheelbase: float,
    track: float,
    x: float = 0.0,
    y: float = 0.0,
    ratio: float = 1.0,
    half_width: float = 0.0,
    shift: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
) -> SkidTurn:
    """Return the turn with Coulomb friction, each tyre touching at one point or at two.

    Args:
        wheelbase: distance of the axles [m].
        track: distance of the sides [m].
        x: distance of the centre of mass ahead of the middle between the axles [m].
        y: distance of the centre of mass to the left of that middle [m].
        ratio: lateral over longitudinal friction [1].
        half_width: half the distance of a tyre's two contact points, which share its load [m]; 0 for one point.
        shift: loads that differ from those at rest: shares of the weight that move from the rear to the front wheels, from
            right to left, and from one pair of diagonal wheels to the one with the front left; and the share of its load
            that a tyre's inner contact point gives to the outer one [1].
    """
    unit = 0.5 * track  # of length: the search sees the same numbers for every size of robot
    c = _contacts(wheelbase / unit, 2.0, x / unit, y / unit, half_width / unit)
    front, left = np.sign(c.x), np.resize(LEFT, len(c.x))
    ahead, aside, across, outwards = shift
    outer = np.sign(np.abs(c.y) - 1.0)  # -1 for an inner point, 0 where a tyre has only one
    load = (c.load + (ahead * front + aside * left + across * front * left) / len(c.x)) * (1.0 + outwards * outer)
    c = c._replace(load=load)

    def power(motion: FloatArray) -> tuple[float, FloatArray]:
        v_x, v_y, rate = motion
        s_x, s_y = v_x - rate * c.y - c.rolling, v_y + rate * c.x
        size = np.sqrt(s_x**2 + (ratio * s_y) ** 2 + 1e-16)
        f_x, f_y = c.load * s_x / size, c.load * ratio**2 * s_y / size
        return float(c.load @ size), np.array([f_x.sum(), f_y.sum(), (c.x * f_y - c.y * f_x).sum()])

    found = minimize(power, np.array([0.0, 0.0, 0.55]), jac=True, method="BFGS", options={"gtol": 1e-10})
    forward, across, rate = (float(value) for value in found.x)
    return SkidTurn(forward, across, rate / unit, track)
