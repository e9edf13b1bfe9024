"""The field's baseline: wheel rates and five constants give the body's velocity, through instantaneous centres of rotation.

J. L. Martinez, A. Mandow, J. Morales, S. Pedraza, A. Garcia-Cerezo, "Approximating kinematics for tracked mobile robots",
Int. J. Robotics Research 24(10), 2005; A. Mandow et al., "Experimental kinematics for wheeled skid-steer mobile robots",
IROS 2007. No masses and no friction: the body has the velocity at once.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssmr._jit import jit
from ssmr.parameters import check_parameters, parameter


@dataclass(frozen=True)
class KinematicParameters:
    """Five constants of a robot on one ground. The defaults say: no slip, the thesis' half-track, centre at the origin."""

    alpha_l: float = parameter(1.0, unit="1", low=0.0, high=2.0, open_low=True, search=(0.8, 1.1))
    """Share of the left wheels' speed that moves the robot [1]: rolling radius over nominal radius, less slip."""
    alpha_r: float = parameter(1.0, unit="1", low=0.0, high=2.0, open_low=True, search=(0.8, 1.1))
    """The same on the right [1]."""
    x_icr: float = parameter(0.0, unit="m", low=-5.0, high=5.0, search=(-0.25, 0.25))
    """Longitudinal coordinate of the centres of rotation [m]: v_y = -x_ICR omega (Eq. 2.10)."""
    y_l: float = parameter(0.275, unit="m", low=0.0, high=50.0, open_low=True, search=(0.2, 0.9))
    """Lateral coordinate of the left side's centre of rotation [m], positive to the left."""
    y_r: float = parameter(-0.275, unit="m", low=-50.0, high=0.0, search=(-0.9, -0.2))
    """The same of the right side [m], negative."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


@jit
def body_velocity(left, right, alpha_l, alpha_r, x_icr, y_l, y_r):
    """v_x [m/s], v_y [m/s], omega [rad/s] of wheel speeds [m/s].

    The body's point at y_l moves forward as the left wheels do: v_x - omega y_l = alpha_l left; on the right the same.
    """
    w = (alpha_r * right - alpha_l * left) / (y_l - y_r)
    return alpha_l * left + w * y_l, -x_icr * w, w


@jit
def advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit):
    """The velocities that the references give; masses and limits are there for the common signature.

    Returns:
        v [m/s], omega [rad/s], and zero torques.
    """
    r = vehicle[2]
    v_next, _, w_next = body_velocity(
        r * reference[0], r * reference[1], parameters[0], parameters[1], parameters[2], parameters[3], parameters[4]
    )
    return v_next, w_next, 0.0, 0.0
