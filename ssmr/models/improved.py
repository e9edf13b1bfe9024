"""Nonlinear model with the improved dry friction (Sec. 2.2.4, Fig. 3.13).

Driving and turning are two decoupled motions. Each sticks at standstill, breaks away above
stiction, and stops where its velocity reaches zero (zero-crossing detection), at that instant of a
step. Simplifications of Sec. 2.2.3: v_y = 0, equal loads if a = b. The end stops of the published
law are left out: a robot on a floor meets none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssmr._jit import jit, multiply_add
from ssmr.errors import ParameterError
from ssmr.models.friction import improved_friction
from ssmr.models.law import Advanced, PlanarLaw, PlanarRobot
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import Sides, motor_torques, side_rates, side_thrusts


@dataclass(frozen=True)
class ImprovedParameters:
    """Unknowns of the model; the defaults are the published fit (Tab. 3.11)."""

    u_x: float = parameter(0.1282, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Rolling resistance coefficient, at rest and in motion [1] (printed in m)."""
    mu_s: float = parameter(0.0972, unit="1", low=0.0, high=5.0, search=(0.0, 0.15))
    """Static lateral friction coefficient [1]."""
    mu_d: float = parameter(0.0409, unit="1", low=0.0, high=5.0, search=(0.0, 0.15))
    """Dynamic lateral friction coefficient [1]."""
    gain: float = parameter(
        118.04, unit="N m s/rad", low=0.0, high=1e6, search=(0.085, 4.2), scale="log", of="gain"
    )
    """K_P of the wheel torque loop, a side [N m s/rad]."""

    def __post_init__(self) -> None:
        """Check the ranges, and that sliding does not grip more than standing."""
        check_parameters(self)
        if self.mu_d > self.mu_s:
            numbers = f"mu_d {self.mu_d:g} exceeds mu_s {self.mu_s:g}"
            raise ParameterError(f"{numbers}: sliding would grip more than standing")


def _pack_constants(body: Any, parameters: Any, dt: float) -> tuple[float, float, float]:
    """Return the resistance of all wheels, at rest and in motion [N], and resisting moments.

    The latter are the greatest at rest and that in motion [N m] (Eq. 2.17, 2.19).
    """
    p = parameters
    levers = body.load_levers
    return p.u_x * body.mass * body.gravity, p.mu_s * levers, p.mu_d * levers


@jit
def _active_loads(
    v: float, w: float, wheels: Sides, integral: Sides, robot: PlanarRobot
) -> tuple[float, float, Sides]:
    """Return the active force [N] and moment [N m], and the torques of both sides [N m].

    Force and moment are those of Eq. 2.21, the torques those of Eq. 2.32.
    """
    rates = side_rates(v, w, robot.vehicle)
    torque = motor_torques(wheels, integral, rates, robot.parameters.gain, robot.motor)
    thrust = side_thrusts(torque, rates, robot.vehicle, robot.motor)
    moment = robot.vehicle.half_track * (thrust.right - thrust.left)
    return thrust.left + thrust.right, moment, torque


@jit
def slide_step(
    v: float, start: float, end: float, gain: float, static: float, dynamic: float
) -> float:
    """Return a velocity after a step of Heun's method.

    A velocity that reaches zero within the step stays there if friction at rest holds the active
    force (Eq. 2.31). Else the rest of the step drives it on: what lies beyond zero changes by the
    ratio of the accelerations at rest and before. What sticks at the start sticks for the step.

    Args:
        v: velocity at the start.
        start: active force or moment there.
        end: that at the end of the step.
        gain: time step over mass or inertia.
        static: greatest friction at rest, FSJ.
        dynamic: friction in motion, FDJ.
    """
    friction = improved_friction(start, static, dynamic, v)
    slid = multiply_add(0.5 * gain, end, v + gain * (0.5 * start + friction))
    holds = abs(start) <= static
    if slid < 0.0 < v or v < 0.0 < slid:  # not slid * v < 0: a product of tiny numbers is 0
        at_rest = improved_friction(start, static, dynamic, 0.0)
        return 0.0 if holds else slid * ((start + at_rest) / (start + friction))
    return 0.0 if v == 0.0 and holds else slid


@jit
def _break_away(start: float, end: float, gain: float, static: float, dynamic: float) -> float:
    """Return the velocity after a step of what sticks at its start.

    For the arguments see `slide_step`. The active force is linear in time, and motion begins where
    it exceeds stiction. This matters where friction falls at that instant; else waiting for the
    next step is of second order too.
    """
    excess = abs(end) - static
    if excess <= 0.0:
        return 0.0
    rest = excess / abs(end - start)
    speed = gain * rest * (0.5 * excess + static - dynamic)
    return speed if end > 0.0 else -speed


@jit
def advance(
    v: float, w: float, wheels: Sides, integral: Sides, disturbance: float, robot: PlanarRobot
) -> Advanced:
    """Advance the velocities by one step of Heun's method on the active forces, see `slide_step`.

    It is of second order, whatever sticks, breaks away or stops within the step, so that motors at
    their limit, which take no lost velocity back, cost no more than others. A disturbing yaw
    acceleration is an active moment, so stiction resists it too.
    """
    vehicle = robot.vehicle
    rolling, sticking, skidding = robot.constants
    per_moved = robot.dt * vehicle.per_moved
    per_turned = robot.dt * vehicle.per_turned
    pushed = vehicle.turned * disturbance
    force, moment, torque = _active_loads(v, w, wheels, integral, robot)
    moment += pushed
    friction = improved_friction(force, rolling, rolling, v)
    friction_moment = improved_friction(moment, sticking, skidding, w)
    v_there = multiply_add(per_moved, force + friction, v)
    w_there = multiply_add(per_turned, moment + friction_moment, w)
    force_there, moment_there, _ = _active_loads(v_there, w_there, wheels, integral, robot)
    moment_there += pushed
    v_next = slide_step(v, force, force_there, per_moved, rolling, rolling)
    w_next = slide_step(w, moment, moment_there, per_turned, sticking, skidding)
    if w == 0.0 and abs(moment) <= sticking:
        w_next = _break_away(moment, moment_there, per_turned, sticking, skidding)
    return v_next, w_next, torque


LAW = PlanarLaw(
    "improved", ImprovedParameters, advance, constants=_pack_constants, colour="#0072b2"
)
