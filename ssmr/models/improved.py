"""Nonlinear model with the improved dry friction (Sec. 2.2.4, Fig. 3.13).

Driving and turning are two decoupled motions. Each sticks at standstill, breaks away above stiction, and stops where its
velocity changes sign (zero-crossing detection). Simplifications of Sec. 2.2.3: v_y = 0, equal loads if a = b. The end stops
of the published law are left out: a robot on a floor meets none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from ssmr._jit import jit
from ssmr.errors import ParameterError
from ssmr.models.friction import improved_friction, stop_at_zero_crossing
from ssmr.models.law import Advanced, PlanarLaw, PlanarRobot
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import Sides, Wanted, motor_torques, side_rates, thrusts


@dataclass(frozen=True)
class ImprovedParameters:
    """Unknowns of the model; the defaults are the published fit (Tab. 3.11)."""

    u_x: float = parameter(0.1282, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Rolling resistance coefficient, at rest and in motion [1] (printed in m)."""
    mu_s: float = parameter(0.0972, unit="1", low=0.0, high=5.0, search=(0.0, 0.15))
    """Static lateral friction coefficient [1]."""
    mu_d: float = parameter(0.0409, unit="1", low=0.0, high=5.0, search=(0.0, 0.15))
    """Dynamic lateral friction coefficient [1]."""
    gain: float = parameter(118.04, unit="N m s/rad", low=0.0, high=1e6, search=(0.085, 4.2), scale="log", of="gain")
    """K_P of the wheel torque loop, a side [N m s/rad]."""

    def __post_init__(self) -> None:
        """Check the ranges, and that sliding does not grip more than standing."""
        check_parameters(self)
        if self.mu_d > self.mu_s:
            raise ParameterError(f"mu_d {self.mu_d:g} exceeds mu_s {self.mu_s:g}: sliding would grip more than standing")


class ImprovedConstants(NamedTuple):
    """Numbers that the law derives from its parameters."""

    rolling: float  # resistance of all wheels, at rest and in motion [N]
    sticking: float  # greatest resisting moment at rest [N m] (Eq. 2.17, 2.19)
    skidding: float  # resisting moment in motion [N m]


def _constants(body: Any, parameters: Any, dt: float) -> ImprovedConstants:
    p = parameters
    return ImprovedConstants(p.u_x * body.mass * body.gravity, p.mu_s * body.load_levers, p.mu_d * body.load_levers)


@jit
def active(v: float, w: float, wheels: Wanted, robot: PlanarRobot) -> tuple[float, float, Sides]:
    """Return the active force [N] and moment [N m] (Eq. 2.21), and the torques of both sides [N m] (Eq. 2.32)."""
    rates = side_rates(v, w, robot.vehicle)
    torque = motor_torques(wheels, rates, robot.parameters.gain, robot.motor)
    thrust = thrusts(torque, rates, robot.vehicle, robot.motor)
    return thrust.left + thrust.right, robot.vehicle.half_track * (thrust.right - thrust.left), torque


@jit
def advance(v: float, w: float, wheels: Wanted, disturbance: float, dt: float, robot: PlanarRobot) -> Advanced:
    """Advance the velocities by one step of Heun's method on the active forces.

    Friction (Eq. 2.29) sticks, breaks away or slides as it did at the start of the step, and a velocity that changes sign
    stops at zero (Eq. 2.31). A disturbing yaw acceleration is an active moment, so stiction resists it too.
    """
    vehicle, k = robot.vehicle, robot.constants
    force, moment, torque = active(v, w, wheels, robot)
    moment += vehicle.turned * disturbance
    friction = improved_friction(force, k.rolling, k.rolling, v)
    friction_moment = improved_friction(moment, k.sticking, k.skidding, w)
    stuck = v == 0.0 and friction == -force
    stuck_yaw = w == 0.0 and friction_moment == -moment
    dv = 0.0 if stuck else (force + friction) * vehicle.per_moved
    dw = 0.0 if stuck_yaw else (moment + friction_moment) * vehicle.per_turned
    force2, moment2, _ = active(v + dt * dv, w + dt * dw, wheels, robot)
    dv2 = 0.0 if stuck else (force2 + friction) * vehicle.per_moved
    dw2 = 0.0 if stuck_yaw else (moment2 + friction_moment) * vehicle.per_turned + disturbance
    v_next = stop_at_zero_crossing(v + 0.5 * dt * (dv + dv2), v)
    w_next = stop_at_zero_crossing(w + 0.5 * dt * (dw + dw2), w)
    return Advanced(v_next, w_next, torque.left, torque.right)


LAW = PlanarLaw("improved", ImprovedParameters, advance, constants=_constants, colour="#0072b2")
