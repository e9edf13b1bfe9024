"""Linear state-space model with hyperviscous friction (Eq. 2.41-2.47).

State x = (x, dx/dt, theta, dtheta/dt), input u = (v, omega). Printed against used (docs/errata.md):
A_22 is printed as -2 K_P/(r m) - m g K_u. The unit asks for g K_u; the published parameters ask for
4 g K_u, the load mg under each of four wheels as Eq. 2.18 has it: with it the three published
models agree on trajectory 4, with g K_u they do not. K_P belongs to wheel speeds in m/s (N m s/m),
because Eq. 2.44 leaves out 1/r; with wheels of unlike radii a side's torque is K_P r times the rate
error of its wheels. The yaw resistance keeps its printed lever c, to which the published K_y
belongs. The torque limit (Tab. 3.14) lies in front of the linear system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ssmr._jit import jit
from ssmr.models.law import Advanced, PlanarLaw, PlanarRobot
from ssmr.parameters import check_parameters, pack_numbers, parameter
from ssmr.robot.drive import Sides, exact_step, motor_torques, side_rates, side_thrusts
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.types import FloatArray


@dataclass(frozen=True)
class LinearParameters:
    """Unknowns of the model; the defaults are the published fit (Tab. 3.14)."""

    k_u: float = parameter(0.0277, unit="s/m", low=0.0, high=1e3, search=(0.0, 0.05))
    """K_u, longitudinal viscous coefficient [s/m]."""
    k_y: float = parameter(0.0298, unit="s", low=0.0, high=1e3, search=(0.0, 0.1))
    """K_y, lateral viscous coefficient, with the printed lever [s] (by Eq. 2.40 it would be
    s/m)."""
    gain: float = parameter(
        229.58,
        unit="N m s/m",
        low=0.0,
        high=1e6,
        open_low=True,
        search=(0.07, 0.7),
        scale="log",
        of="gain_over_radius",
    )
    """K_P of the wheel torque loop, a side, per wheel speed in m/s [N m s/m]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


LOAD_SUM = 4.0
"""Loads mg that the longitudinal friction of the published fit carries, one under each wheel (see
the module's text)."""


def rate_coefficients(body: Any, parameters: Any) -> tuple[float, float, float, float]:
    """Return loop and friction [1/s], loop_yaw [1/(m s)] and friction_yaw [1/s] of Eq. 2.46.

    A_22 = -(loop + friction), B_21 = loop; A_44 = -(loop_yaw c_eff + friction_yaw), B_42 = loop_yaw
    c. With the driver's half-track and c_eff equal to c they are those of the thesis, whose t is
    the track, 2c.
    """
    moved = body.moved
    turned = body.turned
    mass = body.mass
    r = body.wheel_radius
    c = body.half_track
    g = body.gravity
    k_u = parameters.k_u
    k_y = parameters.k_y
    gain = parameters.gain
    loop = 2.0 * gain / (r * moved)
    friction = LOAD_SUM * g * k_u * (mass / moved)
    loop_yaw = 2.0 * gain * c / (r * turned)
    return loop, friction, loop_yaw, mass * g * k_y * c / turned


def _pack_constants(body: Any, parameters: Any, dt: float) -> tuple[float, ...]:
    """Return how the velocities change in a step `dt` [s], and what slows and drives them.

    Six numbers say the former, over the accelerations at its start. Four are for a robot whose
    torques are within their limits: of v over dv/dt [s] and over d(omega)/dt [m s], of omega
    likewise [s/m] and [s]; unlike radii couple driving and turning. Two are for one with a torque
    at its limit, where only friction feeds back: of v and of omega [s]. Then come the rates at
    which friction slows both [1/s], and the gain on wheel rates that the loop's gain means
    [N m s/rad].
    """
    loop, friction, loop_yaw, friction_yaw = rate_coefficients(body, parameters)
    left = body.per_radius_left**2
    right = body.per_radius_right**2
    both = 0.5 * body.wheel_radius**2 * (left + right)
    uneven = 0.5 * body.wheel_radius**2 * (right - left)
    reach = body.effective_half_track
    matrix = [
        [-(loop * both + friction), -loop * uneven * reach],
        [-loop_yaw * uneven, -(loop_yaw * both * reach + friction_yaw)],
    ]
    free = _exact_push(matrix, dt)
    held = _exact_push([[-friction, 0.0], [0.0, -friction_yaw]], dt)
    numbers = (
        *free.ravel(),
        *held.diagonal(),
        friction,
        friction_yaw,
        parameters.gain * body.wheel_radius,
    )
    return tuple(map(float, numbers))


def _exact_push(matrix: Sequence[Sequence[float]], dt: float) -> FloatArray:
    """Return the (2, 2) matrix P of an exact step `dt` [s] of dx/dt = A x + u for a constant u.

    The step ends at x + P (A x + u). P is the integral of exp(A s) over the step; A must have real
    eigenvalues.
    """
    rates, modes = np.linalg.eig(np.array(matrix))
    pushes = [exact_step(-rate, dt)[1] for rate in rates.tolist()]
    return (modes * pushes) @ np.linalg.inv(modes)


def state_space_matrices(
    vehicle: Vehicle, parameters: LinearParameters, drive: Drive
) -> tuple[FloatArray, FloatArray]:
    """Return A (4, 4) and B (4, 2) of Eq. 2.46.

    The drive's half-track and radius turn the input into wheel speeds; in the thesis both are the
    vehicle's. Controllers are designed on a robot whose wheels have the mean radius on both sides.
    """
    body = vehicle_body(pack_numbers(vehicle))
    loop, friction, loop_yaw, friction_yaw = rate_coefficients(body, pack_numbers(parameters))
    stretch = vehicle.wheel_radius / drive.command_radius
    a = np.zeros((4, 4))
    b = np.zeros((4, 2))
    a[0, 1] = 1.0
    a[2, 3] = 1.0
    a[1, 1] = -(loop + friction)
    b[1, 0] = loop * stretch
    a[3, 3] = -(loop_yaw * vehicle.effective_half_track + friction_yaw)
    b[3, 1] = loop_yaw * drive.command_half_track * stretch
    return a, b


@jit
def advance(
    v: float, w: float, wheels: Sides, integral: Sides, disturbance: float, robot: PlanarRobot
) -> Advanced:
    """Advance the velocities exactly for constant references (matrix exponential, Eq. 2.44).

    A side has the torque K_P r e, with the rate error e of its wheels, and thrusts with it over its
    own radius. Where a torque is at its limit, both are held over the step and friction alone is
    stepped exactly.
    """
    body = robot.vehicle
    motor = robot.motor
    free_v, free_v_by_w, free_w_by_v, free_w, held_v, held_w = robot.constants[:6]
    friction, friction_yaw, gain = robot.constants[6:]
    actual = side_rates(v, w, body)
    torque = motor_torques(wheels, integral, actual, gain, motor)
    thrust = side_thrusts(torque, actual, body, motor)
    dv = (thrust.left + thrust.right) * body.per_moved - friction * v
    turning = body.half_track * (thrust.right - thrust.left)
    dw = turning * body.per_turned - friction_yaw * w + disturbance
    free_left = abs(torque.left + motor.braking * actual.left) < motor.limit
    free_right = abs(torque.right + motor.braking * actual.right) < motor.limit
    if free_left and free_right:
        v_step = free_v * dv + free_v_by_w * dw
        w_step = free_w_by_v * dv + free_w * dw
    else:
        v_step = held_v * dv
        w_step = held_w * dw
    return v + v_step, w + w_step, torque


LAW = PlanarLaw("linear", LinearParameters, advance, constants=_pack_constants, colour="#009e73")
