"""Nonlinear model with Coulomb friction (Eq. 2.14-2.28).

x_ICR and a, b are kept; the simplified model of Sec. 2.2.3 is the case x_ICR = 0, a = b.

"""

from __future__ import annotations

from dataclasses import dataclass

from ssmr._jit import jit
from ssmr.models.friction import coulomb
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import wheel_torques


@dataclass(frozen=True)
class CoulombParameters:
    """What is unknown in the model, with the published fit as default (Tab. 3.8)."""

    u_x: float = parameter(0.0727, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Rolling resistance coefficient [1] (printed in m)."""
    mu_c: float = parameter(0.0254, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Lateral Coulomb friction coefficient [1]."""
    gain: float = parameter(56.75, unit="N m s/rad", low=0.0, high=1e6, search=(10.0, 500.0), scale="log")
    """K_P of the wheel torque loop, a side [N m s/rad]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


@jit
def resistance(v, w, vehicle, u_x, mu_c):
    """Resistive force and moment in velocity space, S^T R = (R_x, M_r - x_ICR F_y) (Eq. 2.18-2.20, 2.28) [N, N m]."""
    mass, _, _, c, _, a, b, x_icr, g = vehicle
    front = mass * g * a / (2.0 * (a + b))  # N_1 = N_2, Eq. 2.17
    rear = mass * g * b / (2.0 * (a + b))  # N_3 = N_4
    v_left, v_right = v - c * w, v + c * w  # Eq. 2.7
    v_front, v_rear = (b - x_icr) * w, (-a - x_icr) * w
    left = coulomb(u_x, front, v_left) + coulomb(u_x, rear, v_left)  # wheels 1, 4
    right = coulomb(u_x, front, v_right) + coulomb(u_x, rear, v_right)  # wheels 2, 3
    lateral_front = 2.0 * coulomb(mu_c, front, v_front)
    lateral_rear = 2.0 * coulomb(mu_c, rear, v_rear)
    moment = b * lateral_front - a * lateral_rear + c * (right - left)  # Eq. 2.19
    return left + right, moment - x_icr * (lateral_front + lateral_rear)


@jit
def accelerations(v, w, reference, resist, vehicle, parameters, side_limit):
    """dv/dt [m/s2], d(omega)/dt [rad/s2] and the torques of both sides [N m] (Eq. 2.27).

    M = diag(m, I + m x_ICR^2), C eta = m x_ICR omega (omega, -v), E tau = (tau_L + tau_R, c (tau_R - tau_L)) / r.
    """
    mass, inertia, r, c, c_eff, _, _, x_icr, _ = vehicle
    torque_left, torque_right = wheel_torques(
        reference[0], reference[1], (v - c_eff * w) / r, (v + c_eff * w) / r, parameters[2], side_limit
    )
    force = (torque_left + torque_right) / r - resist[0] - mass * x_icr * w * w
    moment = c * (torque_right - torque_left) / r - resist[1] + mass * x_icr * w * v
    return force / mass, moment / (inertia + mass * x_icr * x_icr), torque_left, torque_right


@jit
def advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit):
    """One step of the velocities: Heun's method, the friction's signs frozen at the start of the step.

    Nothing stops the sign from flipping at every step near rest: the numerical artefact of Fig. 3.33 belongs to the model.

    Returns:
        v [m/s], omega [rad/s] after the step, torques of both sides at its start [N m].
    """
    resist = resistance(v, w, vehicle, parameters[0], parameters[1])
    dv, dw, left, right = accelerations(v, w, reference, resist, vehicle, parameters, side_limit)
    dw += disturbance
    dv2, dw2, _, _ = accelerations(v + dt * dv, w + dt * dw, reference, resist, vehicle, parameters, side_limit)
    return v + 0.5 * dt * (dv + dv2), w + 0.5 * dt * (dw + dw2 + disturbance), left, right
