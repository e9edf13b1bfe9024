"""Nonlinear model with Coulomb friction (Eq. 2.14-2.28).

It keeps x_ICR, a and b; the simplified model of Sec. 2.2.3 is the case x_ICR = 0, a = b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssmr._jit import jit
from ssmr.models.friction import sign_of
from ssmr.models.law import Advanced, PlanarLaw, PlanarRobot
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import Sides, motor_torques, side_rates, side_thrusts


@dataclass(frozen=True)
class CoulombParameters:
    """Unknowns of the model; the defaults are the published fit (Tab. 3.8)."""

    u_x: float = parameter(0.0727, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Rolling resistance coefficient [1] (printed in m)."""
    mu_c: float = parameter(0.0254, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Lateral Coulomb friction coefficient [1]."""
    gain: float = parameter(
        56.75, unit="N m s/rad", low=0.0, high=1e6, search=(0.085, 4.2), scale="log", of="gain"
    )
    """K_P of the wheel torque loop, a side [N m s/rad]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


def coulomb_constants(body: Any, parameters: Any, dt: float) -> tuple[float, float, float]:
    """Return the numbers of a law with this friction (Eq. 2.17, 2.19).

    They are the resistance of a side's two wheels [N], the resisting moment of all lateral forces
    [N m], and m x_ICR [kg m].

    A wheel resists with mu N sgn(v) (Eq. 2.18). An axle slides sideways with (b - x_ICR) omega or
    -(a + x_ICR) omega (Eq. 2.7, 2.10), and S^T R has the moment of its force about the centre of
    rotation, so its lever is also its share of the speed: the moments add up, whatever the signs.
    """
    rolling = parameters.u_x * (body.load_front + body.load_rear)
    front = abs(body.b - body.x_icr) * body.load_front
    rear = abs(body.a + body.x_icr) * body.load_rear
    skidding = 2.0 * parameters.mu_c * (front + rear)
    return rolling, skidding, body.mass * body.x_icr


@jit
def resisting_loads(v: float, w: float, robot: PlanarRobot) -> tuple[float, float]:
    """Return resisting force [N] and moment [N m] in velocity space (Eq. 2.18-2.28).

    They are S^T R = (R_x, M_r - x_ICR F_y).
    """
    c = robot.vehicle.half_track
    rolling, skidding, _ = robot.constants
    left = rolling * sign_of(v - c * w)  # wheels 1 and 4
    right = rolling * sign_of(v + c * w)  # wheels 2 and 3
    return left + right, skidding * sign_of(w) + c * (right - left)


@jit
def body_accelerations(
    v: float,
    w: float,
    wheels: Sides,
    integral: Sides,
    resist: tuple[float, float],
    robot: PlanarRobot,
) -> tuple[float, float, Sides]:
    """Return dv/dt [m/s2], d(omega)/dt [rad/s2] and the torques of both sides [N m] (Eq. 2.27).

    M = diag(m, I + m x_ICR^2), C eta = m x_ICR omega (omega, -v), E tau = (tau_L + tau_R, c (tau_R
    - tau_L)) / r.
    """
    vehicle = robot.vehicle
    aside = robot.constants[2] * w
    rates = side_rates(v, w, vehicle)
    torque = motor_torques(wheels, integral, rates, robot.parameters.gain, robot.motor)
    thrust = side_thrusts(torque, rates, vehicle, robot.motor)
    resisting_force, resisting_moment = resist
    turning = vehicle.half_track * (thrust.right - thrust.left)
    force = thrust.left + thrust.right - resisting_force - aside * w
    moment = turning - resisting_moment + aside * v
    return force * vehicle.per_moved, moment * vehicle.per_turned_aside, torque


@jit
def advance(
    v: float, w: float, wheels: Sides, integral: Sides, disturbance: float, robot: PlanarRobot
) -> Advanced:
    """Advance the velocities by one step of Heun's method.

    The signs of friction are those at the start of the step. Nothing stops the sign from flipping
    at every step near rest: the numerical artefact of Fig. 3.33 belongs to the model.
    """
    dt = robot.dt
    resist = resisting_loads(v, w, robot)
    dv, dw, torque = body_accelerations(v, w, wheels, integral, resist, robot)
    dw += disturbance
    dv2, dw2, _ = body_accelerations(v + dt * dv, w + dt * dw, wheels, integral, resist, robot)
    v_next = v + 0.5 * dt * (dv + dv2)
    w_next = w + 0.5 * dt * (dw + dw2 + disturbance)
    return v_next, w_next, torque


LAW = PlanarLaw(
    "coulomb",
    CoulombParameters,
    advance,
    lambda vehicle, parameters: vehicle.x_icr,
    coulomb_constants,
    vehicle=(
        "mass",
        "yaw_inertia",
        "wheel_radius",
        "radius_difference",
        "effective_half_track",
        "x_icr",
    ),
    colour="#d55e00",
)
