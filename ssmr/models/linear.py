"""Linear state-space model with hyperviscous friction (Eq. 2.41-2.47): x = (x, dx/dt, theta, dtheta/dt), u = (v, omega).

Printed against used (docs/errata.md): A_22 is printed as -2 K_P/(r m) - m g K_u. The unit asks for g K_u; the published
parameters ask for 4 g K_u, the load mg under each of four wheels as Eq. 2.18 has it: with it the three published models
agree on trajectory 4, with g K_u they do not. K_P belongs to wheel speeds in m/s (N m s/m), because Eq. 2.44 leaves out
1/r. The yaw resistance keeps its printed lever c, to which the published K_y belongs. The torque limit (Tab. 3.14) lies
in front of the linear system.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import control
import numpy as np

from ssmr._jit import jit
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import wheel_torques
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import FloatArray

Form = Literal["used", "single", "printed"]


@dataclass(frozen=True)
class LinearParameters:
    """What is unknown in the model, with the published fit as default (Tab. 3.14)."""

    k_u: float = parameter(0.0277, unit="s/m", low=0.0, high=1e3, search=(0.0, 0.05))
    """K_u, longitudinal viscous coefficient [s/m]."""
    k_y: float = parameter(0.0298, unit="s", low=0.0, high=1e3, search=(0.0, 0.1))
    """K_y, lateral viscous coefficient, with the printed lever [s] (by Eq. 2.40 it would be s/m)."""
    gain: float = parameter(229.58, unit="N m s/m", low=0.0, high=1e6, open_low=True, search=(50.0, 500.0), scale="log")
    """K_P of the wheel torque loop, a side, per wheel speed in m/s [N m s/m]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


LOAD_SUM = 4.0
"""How many times mg the longitudinal friction of the published fit carries, see above; the kernels and `matrices` share
it."""


@jit
def coefficients(vehicle, k_u, k_y, gain):
    """The rates of Eq. 2.46 [1/s]: loop and friction of v, loop (per half-track) and friction of omega.

    A_22 = -(loop + friction), B_21 = loop; A_44 = -(loop_yaw c_eff + friction_yaw), B_42 = loop_yaw c_command. With
    c_command = c_eff = c they are those of the thesis, whose t is the track, 2c.
    """
    mass, inertia, r, c, _, _, _, _, g = vehicle
    return 2.0 * gain / (r * mass), LOAD_SUM * g * k_u, 2.0 * gain * c / (r * inertia), mass * g * k_y * c / inertia


def matrices(
    vehicle: Vehicle, parameters: LinearParameters, drive: Drive, form: Form = "used"
) -> tuple[FloatArray, FloatArray]:
    """A (4, 4) and B (4, 2) of Eq. 2.46.

    Args:
        vehicle: mass and geometry.
        parameters: viscous coefficients and loop gain.
        drive: its half-track and radius turn the input into wheel speeds; in the thesis both are the vehicle's.
        form: `printed` takes A_22 as it stands in print and `single` one load mg in it, for the errata's tests.
    """
    loop, friction, loop_yaw, friction_yaw = coefficients(
        tuple(vehicle.packed()), parameters.k_u, parameters.k_y, parameters.gain
    )
    friction = {"used": friction, "single": friction / LOAD_SUM, "printed": friction / LOAD_SUM * vehicle.mass}[form]
    stretch = vehicle.wheel_radius / drive.command_radius
    a, b = np.zeros((4, 4)), np.zeros((4, 2))
    a[0, 1] = a[2, 3] = 1.0
    a[1, 1], b[1, 0] = -(loop + friction), loop * stretch
    a[3, 3], b[3, 1] = (
        -(loop_yaw * vehicle.effective_half_track + friction_yaw),
        loop_yaw * drive.command_half_track * stretch,
    )
    return a, b


def state_space(vehicle: Vehicle, parameters: LinearParameters, drive: Drive) -> control.StateSpace:
    """The model as a `control.StateSpace` with named signals (Eq. 2.43, 2.47: C = identity, D = 0)."""
    a, b = matrices(vehicle, parameters, drive)
    names = ["x", "v", "yaw", "yaw_rate"]
    return control.StateSpace(
        a, b, np.eye(4), np.zeros((4, 2)), states=names, outputs=names, inputs=["v_cmd", "yaw_rate_cmd"], name="husky_linear"
    )


@jit
def relax(x, rate, drive, dt):
    """Exact step of dx/dt = -rate x + drive for a constant drive."""
    if rate * dt < 1e-12:
        return x + dt * drive
    return x + math.expm1(-rate * dt) * (x - drive / rate)


@jit
def advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit):
    """One step of the velocities, exact for a reference that is constant over it (the zero-order hold's matrix exponential).

    Where a side's torque is at its limit, both torques are held over the step and the friction alone is stepped exactly.

    Returns:
        v [m/s], omega [rad/s] after the step, torques of both sides at its start [N m] (Eq. 2.44).
    """
    mass, inertia, r, c, c_eff, _, _, _, _ = vehicle
    gain = parameters[2]
    loop, friction, loop_yaw, friction_yaw = coefficients(vehicle, parameters[0], parameters[1], gain)
    v_left, v_right = r * reference[0], r * reference[1]  # commanded wheel speeds [m/s]
    torque_left, torque_right = wheel_torques(v_left, v_right, v - c_eff * w, v + c_eff * w, gain, side_limit)
    if abs(torque_left) < side_limit and abs(torque_right) < side_limit:
        v_next = relax(v, loop + friction, loop * 0.5 * (v_left + v_right), dt)
        w_next = relax(w, loop_yaw * c_eff + friction_yaw, loop_yaw * 0.5 * (v_right - v_left) + disturbance, dt)
    else:
        v_next = relax(v, friction, (torque_left + torque_right) / (r * mass), dt)
        w_next = relax(w, friction_yaw, c * (torque_right - torque_left) / (r * inertia) + disturbance, dt)
    return v_next, w_next, torque_left, torque_right
