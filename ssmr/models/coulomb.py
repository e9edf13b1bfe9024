"""Nonlinear model with Coulomb friction (Eq. 2.14-2.28).

It keeps x_ICR, a and b; the simplified model of Sec. 2.2.3 is the case x_ICR = 0, a = b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssmr._jit import jit
from ssmr.models.friction import coulomb_friction
from ssmr.models.law import Advanced, PlanarLaw, PlanarRobot
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import Sides
from ssmr.robot.motor import Wanted, apparent_inertia, motor_torques, side_radii, side_rates, thrusts


@dataclass(frozen=True)
class CoulombParameters:
    """Unknowns of the model; the defaults are the published fit (Tab. 3.8)."""

    u_x: float = parameter(0.0727, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Rolling resistance coefficient [1] (printed in m)."""
    mu_c: float = parameter(0.0254, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Lateral Coulomb friction coefficient [1]."""
    gain: float = parameter(56.75, unit="N m s/rad", low=0.0, high=1e6, search=(0.085, 4.2), scale="log", of="gain")
    """K_P of the wheel torque loop, a side [N m s/rad]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


@jit
def resistance(v: float, w: float, vehicle: Any, parameters: Any) -> tuple[float, float]:
    """Return resisting force [N] and moment [N m] in velocity space: S^T R = (R_x, M_r - x_ICR F_y) (Eq. 2.18-2.28)."""
    a, b, c, weight = vehicle.a, vehicle.b, vehicle.half_track, vehicle.mass * vehicle.gravity
    front = weight * a / (2.0 * (a + b))  # N_1 = N_2, Eq. 2.17
    rear = weight * b / (2.0 * (a + b))  # N_3 = N_4
    v_left, v_right = v - c * w, v + c * w  # Eq. 2.7
    v_front, v_rear = (b - vehicle.x_icr) * w, (-a - vehicle.x_icr) * w
    u_x, mu_c = parameters.u_x, parameters.mu_c
    left = coulomb_friction(u_x, front, v_left) + coulomb_friction(u_x, rear, v_left)  # wheels 1, 4
    right = coulomb_friction(u_x, front, v_right) + coulomb_friction(u_x, rear, v_right)  # wheels 2, 3
    lateral_front = 2.0 * coulomb_friction(mu_c, front, v_front)
    lateral_rear = 2.0 * coulomb_friction(mu_c, rear, v_rear)
    moment = b * lateral_front - a * lateral_rear + c * (right - left)  # Eq. 2.19
    return left + right, moment - vehicle.x_icr * (lateral_front + lateral_rear)


@jit
def accelerations(
    v: float, w: float, wheels: Wanted, resist: tuple[float, float], robot: PlanarRobot
) -> tuple[float, float, Sides]:
    """Return dv/dt [m/s2], d(omega)/dt [rad/s2] and the torques of both sides [N m] (Eq. 2.27).

    M = diag(m, I + m x_ICR^2), C eta = m x_ICR omega (omega, -v), E tau = (tau_L + tau_R, c (tau_R - tau_L)) / r.
    """
    vehicle = robot.vehicle
    mass, x_icr = vehicle.mass, vehicle.x_icr
    rates = side_rates(v, w, vehicle)
    torque = motor_torques(wheels, rates, robot.parameters.gain, robot.motor)
    thrust = thrusts(torque, rates, side_radii(vehicle), robot.motor)
    resisting_force, resisting_moment = resist
    force = thrust.left + thrust.right - resisting_force - mass * x_icr * w * w
    moment = vehicle.half_track * (thrust.right - thrust.left) - resisting_moment + mass * x_icr * w * v
    moved, turned = apparent_inertia(vehicle)
    return force / moved, moment / (turned + mass * x_icr * x_icr), torque


@jit
def advance(v: float, w: float, wheels: Wanted, disturbance: float, dt: float, robot: PlanarRobot) -> Advanced:
    """Advance the velocities by one step of Heun's method, with the signs of friction as they are at the start of the step.

    Nothing stops the sign from flipping at every step near rest: the numerical artefact of Fig. 3.33 belongs to the model.
    """
    resist = resistance(v, w, robot.vehicle, robot.parameters)
    dv, dw, torque = accelerations(v, w, wheels, resist, robot)
    dw += disturbance
    dv2, dw2, _ = accelerations(v + dt * dv, w + dt * dw, wheels, resist, robot)
    return Advanced(v + 0.5 * dt * (dv + dv2), w + 0.5 * dt * (dw + dw2 + disturbance), torque.left, torque.right)


LAW = PlanarLaw(
    "coulomb",
    CoulombParameters,
    advance,
    lambda vehicle, parameters: vehicle.x_icr,
    vehicle=("mass", "yaw_inertia", "wheel_radius", "radius_difference", "effective_half_track", "x_icr"),
    colour="#d55e00",
)
