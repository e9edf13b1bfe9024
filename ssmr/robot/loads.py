"""How a robot's weight is spread over its wheels: at rest as the thesis has it, and in motion from its accelerations.

Wheels in order front left, front right, rear left, rear right.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ssmr.parameters import require_in_range
from ssmr.robot.vehicle import Vehicle
from ssmr.types import FloatArray, Trajectory

DIFFERENTIATED_OVER = 0.1
"""Accelerations are slopes of speed over so much time [s]: longer than the contacts' 20 ms, shorter than a manoeuvre."""


def static_loads(vehicle: Vehicle) -> FloatArray:
    """Return the (4,) wheel loads [N] at rest on level ground, left and right alike (Eq. 2.17)."""
    weight, wheelbase = vehicle.mass * vehicle.gravity, vehicle.a + vehicle.b
    front, rear = 0.5 * weight * vehicle.a / wheelbase, 0.5 * weight * vehicle.b / wheelbase
    return np.array([front, front, rear, rear])


@dataclass(frozen=True)
class LoadModel:
    """A rigid robot on four equal springs that hardly give: the numbers that decide its wheel loads."""

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
    """Moment of inertia of all four wheels together about their axles [kg m2]; spinning up and yawing need moments."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        for f in fields(self):
            if f.name in ("com_x", "com_y", "spin_inertia"):
                require_in_range(self, f.name, -10.0 if f.name != "spin_inertia" else 0.0, 1e3)
            else:
                require_in_range(self, f.name, 0.0, 1e6, open_low=True)

    def quasi_static(
        self, acceleration: FloatArray, gravity: FloatArray, spin: FloatArray, spin_rate: FloatArray, yaw_rate: FloatArray
    ) -> FloatArray:
        """Return the wheel loads of a body with given accelerations.

        The ground pushes along its plane with F = m (a - g). About the centre of mass, with N_i at (x_i, y_i), the plane a
        height h below, and the wheels' angular momentum J W along the axles,

            sum N_i                = -m g_z
            sum (x_i - x_c) N_i    = -h F_x - J dW/dt
            sum (y_i - y_c) N_i    = -h F_y - J W omega

        Four equal springs under a rigid body take N_i = k0 + k1 x_i + k2 y_i, which makes the three equations enough.

        Args:
            acceleration: (M, 2) acceleration of the centre of mass, in the body's axes [m/s2].
            gravity: (M, 3) gravity in the body's axes [m/s2].
            spin: (M,) mean rate of the wheels, W [rad/s].
            spin_rate: (M,) rate of change of the spin [rad/s2].
            yaw_rate: (M,) yaw rate [rad/s].

        Returns:
            (M, 4) loads [N]; negative where a wheel would have to be held down: it lifts, and the formula no longer holds.
        """
        force = self.mass * (acceleration - gravity[:, :2])
        weight = -self.mass * gravity[:, 2]
        about_y = self.com_x * weight - self.com_height * force[:, 0] - self.spin_inertia * spin_rate
        about_x = self.com_y * weight - self.com_height * force[:, 1] - self.spin_inertia * spin * yaw_rate
        x = 0.5 * self.wheelbase * np.array([1.0, 1.0, -1.0, -1.0])
        y = 0.5 * self.track * np.array([1.0, -1.0, 1.0, -1.0])
        return weight[:, None] / 4.0 + np.outer(about_y, x / self.wheelbase**2) + np.outer(about_x, y / self.track**2)

    def along(self, motion: Trajectory, gravity: FloatArray, wheel_radius: float) -> FloatArray:
        """Return the (M, 4) quasi-static loads [N] over a motion of the middle between the axles.

        Speeds are differentiated over `DIFFERENTIATED_OVER`; `gravity` is (M, 3) in the body's axes [m/s2]. Where the motion
        has no wheel rates, the wheels are taken to roll with `wheel_radius` [m].
        """
        t, (v_x, v_y, w) = motion.t, motion.twist.T
        a_x = slope(t, v_x) - w * v_y - w**2 * self.com_x - slope(t, w) * self.com_y
        a_y = slope(t, v_y) + w * v_x - w**2 * self.com_y + slope(t, w) * self.com_x
        spin = motion.wheels.mean(axis=1) if np.any(motion.wheels) else v_x / wheel_radius
        return self.quasi_static(np.column_stack([a_x, a_y]), gravity, spin, slope(t, spin), w)


def slope(t: FloatArray, values: FloatArray, span: float = DIFFERENTIATED_OVER) -> FloatArray:
    """Return the (M,) rate of change of (M,) values over a centred span [s], shorter at the ends."""
    if len(t) < 2:
        return np.zeros_like(values)
    low, high = np.clip(t - 0.5 * span, t[0], t[-1]), np.clip(t + 0.5 * span, t[0], t[-1])
    return np.asarray((np.interp(high, t, values) - np.interp(low, t, values)) / (high - low))
