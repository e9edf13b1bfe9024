"""The field's baseline: six constants turn wheel rates into the body's velocity.

They are the instantaneous centres of rotation of the body and of both treads, and the shares of
wheel speed that move the treads. J. L. Martinez, A. Mandow, J. Morales, S. Pedraza, A.
Garcia-Cerezo, "Approximating kinematics for tracked mobile robots", Int. J. Robotics Research
24(10), 2005; A. Mandow et al., "Experimental kinematics for wheeled skid-steer mobile robots", IROS
2007. No masses and no friction: the body has the velocity at once.

Tyres give way to the centripetal force m v omega of a bend, so the body slips outwards: v_y = -k v
omega. In a left bend (omega > 0, v > 0) that is to the right. The centres of rotation thus move
ahead by k v.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssmr._jit import jit
from ssmr.models.law import Advanced, PlanarLaw, PlanarRobot
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import Sides


@dataclass(frozen=True)
class KinematicParameters:
    """Six constants of a robot on one ground.

    The defaults mean no slip, the thesis' half-track and a centre of rotation at the origin.
    """

    alpha_l: float = parameter(1.0, unit="1", low=0.0, high=2.0, open_low=True, search=(0.3, 1.2))
    """Share of the left wheels' speed that moves the robot [1]: rolling radius over nominal radius,
    less slip."""
    alpha_r: float = parameter(1.0, unit="1", low=0.0, high=2.0, open_low=True, search=(0.3, 1.2))
    """Share of the right wheels' speed that moves the robot [1]."""
    x_icr: float = parameter(
        0.0, unit="m", low=-5.0, high=5.0, search=(-0.98, 0.98), of="half_wheelbase"
    )
    """Longitudinal coordinate of the centres of rotation in slow turns [m]: v_y = -(x_ICR + k v)
    omega (Eq. 2.10)."""
    y_l: float = parameter(
        0.275,
        unit="m",
        low=0.0,
        high=50.0,
        open_low=True,
        search=(0.7, 1.7456),
        of=("half_track", "turning_half_track"),
    )
    """Lateral coordinate of the left side's centre of rotation [m], positive to the left."""
    y_r: float = parameter(
        -0.275,
        unit="m",
        low=-50.0,
        high=0.0,
        search=(-1.7456, -0.7),
        of=("turning_half_track", "half_track"),
    )
    """Lateral coordinate of the right side's centre of rotation [m], negative."""
    drift: float = parameter(0.0, unit="s", low=-2.0, high=2.0, search=(-0.1, 0.5))
    """Outward drift k in bends [s]: speed to the outside over forward speed times yaw rate."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


def _pack_constants(body: Any, parameters: Any, dt: float) -> tuple[float, float, float]:
    """Return the ways of both sides over their wheels' turn [m/rad], and 1 / (y_l - y_r) [1/m]."""
    p = parameters
    r = body.wheel_radius
    return p.alpha_l * r, p.alpha_r * r, 1.0 / (p.y_l - p.y_r)


@jit
def _body_velocity(left: float, right: float, robot: PlanarRobot) -> tuple[float, float]:
    """Return v_x [m/s] and omega [rad/s] for wheel rates [rad/s].

    The body's point at y_l moves forward as the left wheels do: v_x - omega y_l = alpha_l r left;
    on the right likewise.
    """
    rolled_left, rolled_right, per_width = robot.constants
    v_left = rolled_left * left
    w = (rolled_right * right - v_left) * per_width
    return v_left + w * robot.parameters.y_l, w


@jit
def advance(
    v: float, w: float, wheels: Sides, integral: Sides, disturbance: float, robot: PlanarRobot
) -> Advanced:
    """Return the velocities that the references give at once.

    Torques are zero, and disturbances have no effect.
    """
    v_next, w_next = _body_velocity(wheels.left, wheels.right, robot)
    return v_next, w_next, Sides(0.0, 0.0)


LAW = PlanarLaw(
    "kinematic",
    KinematicParameters,
    advance,
    lambda vehicle, parameters: parameters.x_icr,
    _pack_constants,
    vehicle=("wheel_radius",),
    colour="#cc79a7",
    ideal=True,
    drift=lambda parameters: parameters.drift,
)
