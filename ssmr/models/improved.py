"""Nonlinear model with the improved dry friction (Sec. 2.2.4, Fig. 3.13).

Two decoupled motions, each with stiction,
breakaway, standstill kept and zero-crossing detection. Simplifications of Sec. 2.2.3: v_y = 0, equal loads if a = b.
End stops, which the law also knows, do not occur in a robot on a floor and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssmr._jit import jit
from ssmr.models.friction import improved, stop_at_zero_crossing
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import wheel_torques


@dataclass(frozen=True)
class ImprovedParameters:
    """What is unknown in the model, with the published fit as default (Tab. 3.11)."""

    u_x: float = parameter(0.1282, unit="1", low=0.0, high=5.0, search=(0.0, 0.2))
    """Rolling resistance coefficient, at rest and in motion [1] (printed in m)."""
    mu_s: float = parameter(0.0972, unit="1", low=0.0, high=5.0, search=(0.0, 0.15))
    """Static lateral friction coefficient [1]."""
    mu_d: float = parameter(0.0409, unit="1", low=0.0, high=5.0, search=(0.0, 0.15))
    """Dynamic lateral friction coefficient [1]."""
    gain: float = parameter(118.04, unit="N m s/rad", low=0.0, high=1e6, search=(10.0, 500.0), scale="log")
    """K_P of the wheel torque loop, a side [N m s/rad]."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a number lies outside its range, or sliding would grip more than standing.
        """
        check_parameters(self)
        if self.mu_d > self.mu_s:
            raise ValueError(f"mu_d {self.mu_d:g} exceeds mu_s {self.mu_s:g}: sliding would grip more than standing")


@jit
def active(v, w, reference, vehicle, gain, side_limit):
    """Active force [N] and moment [N m] (Eq. 2.21), torques of both sides [N m] (Eq. 2.32)."""
    _, _, r, c, c_eff, _, _, _, _ = vehicle
    left, right = wheel_torques(reference[0], reference[1], (v - c_eff * w) / r, (v + c_eff * w) / r, gain, side_limit)
    return (left + right) / r, c * (right - left) / r, left, right


@jit
def advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit):
    """One step of the velocities by Heun's method on the active forces.

    Friction (Eq. 2.29) sticks, breaks away or slides
    as it did at the start of the step, and a velocity that changes sign stops at zero (Eq. 2.31).

    A disturbing yaw acceleration is an active moment, so stiction resists it too.

    Returns:
        v [m/s], omega [rad/s] after the step, torques of both sides at its start [N m].
    """
    mass, inertia, _, _, _, a, b, _, g = vehicle
    u_x, mu_s, mu_d, gain = parameters[0], parameters[1], parameters[2], parameters[3]
    lever_load = mass * g * 2.0 * a * b / (a + b)  # sum of N_i times lever (Eq. 2.17, 2.19)
    force, moment, left, right = active(v, w, reference, vehicle, gain, side_limit)
    moment += inertia * disturbance
    friction = improved(force, u_x * mass * g, u_x * mass * g, v)
    friction_moment = improved(moment, mu_s * lever_load, mu_d * lever_load, w)
    stuck = v == 0.0 and friction == -force
    stuck_yaw = w == 0.0 and friction_moment == -moment
    dv = 0.0 if stuck else (force + friction) / mass
    dw = 0.0 if stuck_yaw else (moment + friction_moment) / inertia
    force2, moment2, _, _ = active(v + dt * dv, w + dt * dw, reference, vehicle, gain, side_limit)
    dv2 = 0.0 if stuck else (force2 + friction) / mass
    dw2 = 0.0 if stuck_yaw else (moment2 + friction_moment) / inertia + disturbance
    v_next = stop_at_zero_crossing(v + 0.5 * dt * (dv + dv2), v)
    w_next = stop_at_zero_crossing(w + 0.5 * dt * (dw + dw2), w)
    return v_next, w_next, left, right
