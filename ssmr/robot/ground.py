"""Closed forms of how a robot turns on the spot and how its wheels are loaded.

In the closed form of a turn (see docs/physics.md and docs/why_drift.md) rigid tyres slide on the
ground, left and right ones turning equally fast against each other; nothing accelerates. The robot
then moves so that the forces and the moments of friction cancel, which is where what friction
dissipates is least: that is convex in the motion, so there is nothing to search.

Wheels are in the order front left, front right, rear left, rear right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssmr.types import FloatArray, Trajectory

FRONT = np.array([1.0, 1.0, -1.0, -1.0])
"""Sides of the wheels along the robot: 1 in front, -1 behind."""
LEFT = np.array([1.0, -1.0, 1.0, -1.0])
"""Sides of the wheels across the robot: 1 on the left, -1 on the right."""


@dataclass(frozen=True)
class SkidTurn:
    """A quasi-static turn on the spot: the tyres' rims roll at 1 m/s, the right ones forward."""

    forward: float
    """Speed of the middle between the axles ahead [m/s]."""
    across: float
    """Speed of the middle between the axles to the left [m/s]."""
    yaw_rate: float
    """Yaw rate [rad/s]; 0 for a robot that drives straight although its sides turn against each
    other."""
    track: float
    """Distance of the sides [m]."""
    slip: float
    """Power that friction of 1 dissipates, over the weight [m/s]: the tyres' mean sliding speed by
    their loads."""

    @property
    def multiplier(self) -> float:
        """Yaw rate of the wheels over that of the body [1]; infinite for none."""
        return 2.0 / (self.track * self.yaw_rate) if self.yaw_rate > 0.0 else math.inf


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
        half_width: half the distance of a tyre's two contact points, which share its load [m]; 0
            for one point.
        shift: loads that differ from those at rest: shares of the weight that move from the rear
            to the front wheels, from right to left, and from one pair of diagonal wheels to the
            one with the front left; and the share of its load that a tyre's inner contact point
            gives to the outer one [1].
    """
    unit = 0.5 * track  # of length: the search sees the same numbers for every size of robot
    ends = (0.0,) if half_width == 0.0 else (-half_width / unit, half_width / unit)
    # of each contact point
    front = np.tile(FRONT, len(ends))
    left = np.tile(LEFT, len(ends))
    half_base = 0.5 * (wheelbase / unit)
    at_x = half_base * front
    at_y = left + np.repeat(ends, len(LEFT))
    # equal springs
    at_rest = 0.25 * (1.0 + (x / unit) * front / half_base + (y / unit) * left) / len(ends)
    ahead, aside, diagonal, outwards = shift
    moved = (ahead * front + aside * left + diagonal * front * left) / len(left)
    outer = np.sign(np.abs(at_y) - 1.0)  # -1 for an inner point, 0 where a tyre has only one
    load = (at_rest + moved) * (1.0 + outwards * outer)

    # slip speeds of all points, ahead and then aside, by the motion; the rims roll at 1 m/s, the
    # left ones backward; a slip aside counts as its friction does
    one = np.ones_like(at_x)
    ahead_of = np.column_stack([one, 0.0 * one, -at_y])
    aside_of = ratio * np.column_stack([0.0 * one, one, at_x])
    by_motion = np.vstack([ahead_of, aside_of])
    rims = np.concatenate([left, 0.0 * left])
    motion = np.array([0.0, 0.0, 0.55])
    # a least sum of distances comes by weighted least squares again and again (Weiszfeld 1937)
    for _ in range(10_000):
        slips = (by_motion @ motion + rims).reshape(2, -1)
        size = np.sqrt((slips**2).sum(axis=0) + 1e-16)
        weighted = np.tile(load / size, 2) * by_motion.T
        last = motion
        motion = np.linalg.lstsq(weighted @ by_motion, -weighted @ rims)[0]
        if np.abs(motion - last).max() < 1e-12:
            break
    forward, across, rate = map(float, motion)
    return SkidTurn(forward, across, rate / unit, track, float(load @ size))


_DIFFERENTIATED_OVER = 0.1
"""Accelerations are slopes of speed over so much time [s]: longer than the contacts' 20 ms, shorter
than a manoeuvre."""


@dataclass(frozen=True)
class LoadModel:
    """Numbers that decide the wheel loads of a rigid robot on four stiff, equal springs."""

    mass: float
    """Total mass [kg]."""
    com_x: float
    """Distance of the centre of mass ahead of the middle between the axles [m]."""
    com_y: float
    """Distance of the centre of mass to the left of that middle [m]."""
    com_height: float
    """Height of the centre of mass above the ground [m]."""
    wheelbase: float
    """Distance of the axles, L [m]."""
    track: float
    """Distance of left and right wheels, B [m]."""
    spin_inertia: float = 0.0
    """Moment of inertia of all four wheels together about their axles [kg m2]; spinning up and
    yawing need moments."""

    def quasi_static(
        self,
        acceleration: FloatArray,
        gravity: FloatArray,
        spin: FloatArray,
        spin_rate: FloatArray,
        yaw_rate: FloatArray,
    ) -> FloatArray:
        """Return the wheel loads of a body with given accelerations.

        The ground pushes along its plane with F = m (a - g). About the centre of mass, with N_i at
        (x_i, y_i), the plane a height h below, and the wheels' angular momentum J W along the
        axles,

            sum N_i                = -m g_z
            sum (x_i - x_c) N_i    = -h F_x - J dW/dt
            sum (y_i - y_c) N_i    = -h F_y - J W omega

        Four equal springs under a rigid body take N_i = k0 + k1 x_i + k2 y_i, which makes the three
        equations enough.

        `acceleration` (M, 2) is that of the centre of mass and `gravity` (M, 3) gravity, both in
        the body's axes [m/s2]; `spin` (M,) is the mean rate of the wheels W [rad/s], `spin_rate`
        (M,) its rate of change [rad/s2], and `yaw_rate` (M,) omega [rad/s].

        Returns:
            (M, 4) loads [N]; negative where a wheel would have to be held down: it lifts, and the
            formula no longer holds.
        """
        force = self.mass * (acceleration - gravity[:, :2])
        weight = -self.mass * gravity[:, 2]
        spinning_up = self.spin_inertia * spin_rate
        gyroscopic = self.spin_inertia * spin * yaw_rate
        about_y = self.com_x * weight - self.com_height * force[:, 0] - spinning_up
        about_x = self.com_y * weight - self.com_height * force[:, 1] - gyroscopic
        x = 0.5 * self.wheelbase * FRONT
        y = 0.5 * self.track * LEFT
        ahead = np.outer(about_y, x / self.wheelbase**2)
        aside = np.outer(about_x, y / self.track**2)
        return weight[:, None] / 4.0 + ahead + aside

    def along(self, motion: Trajectory, gravity: FloatArray, wheel_radius: float) -> FloatArray:
        """Return the (M, 4) quasi-static loads [N] over a motion of the middle between the axles.

        Speeds are differentiated over 0.1 s; `gravity` is (M, 3) in the body's axes [m/s2]. Where
        the motion has no wheel rates, the wheels are taken to roll with `wheel_radius` [m].
        """
        t = motion.t
        v_x, v_y, w = motion.twist.T
        turn = _rate_of_change(t, w)
        a_x = _rate_of_change(t, v_x) - w * v_y - w**2 * self.com_x - turn * self.com_y
        a_y = _rate_of_change(t, v_y) + w * v_x - w**2 * self.com_y + turn * self.com_x
        spin = v_x / wheel_radius
        if np.any(motion.wheels):
            spin = motion.wheels.mean(axis=1)
        return self.quasi_static(
            np.column_stack([a_x, a_y]), gravity, spin, _rate_of_change(t, spin), w
        )


def _rate_of_change(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the (M,) rates of change of (M,) values.

    They are differences over a centred `_DIFFERENTIATED_OVER`, shorter at the ends.
    """
    if len(t) < 2:
        return np.zeros_like(values)
    span = _DIFFERENTIATED_OVER
    low = np.clip(t - 0.5 * span, t[0], t[-1])
    high = np.clip(t + 0.5 * span, t[0], t[-1])
    change = np.interp(high, t, values) - np.interp(low, t, values)
    return change / (high - low)
