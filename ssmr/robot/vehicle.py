"""What the robot is, and what stands between a command and its wheels. SI units and radians."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from ssmr.types import FloatArray


def require_in_range(owner: object, name: str, low: float, high: float = math.inf, *, open_low: bool = False) -> None:
    """Check one number of a parameter set.

    Args:
        owner: the dataclass instance that holds it.
        name: the field.
        low: least value allowed.
        high: greatest value allowed; infinity itself is allowed where `high` is infinite.
        open_low: `low` itself is not allowed.

    Raises:
        ValueError: it is outside, or not a number; the message names the parameter and the range.
    """
    value = getattr(owner, name)
    if math.isnan(value) or value > high or value < low or (open_low and value <= low):
        bracket = "(" if open_low else "["
        raise ValueError(f"{type(owner).__name__}.{name} = {value} lies outside {bracket}{low}, {high}]")


@dataclass(frozen=True)
class Vehicle:
    """Mass and geometry of a four-wheel skid-steering robot (Fig. 2.3, Tab. 3.1)."""

    mass: float = 73.30
    """Total mass m [kg]; Tab. 3.1, weighed with battery."""
    yaw_inertia: float = 2.16
    """Moment of inertia I about the vertical through the centre of gravity [kg m2]; Tab. 3.1."""
    wheel_radius: float = 0.1651
    """Effective rolling radius r [m]; the maker's robot description."""
    half_track: float = 0.275
    """c, lever of the longitudinal wheel forces [m]; half of the 0.55 m of Tab. 3.1 (the maker has 0.2854)."""
    effective_half_track: float = 0.275
    """Half-track that links yaw rate to wheel rates [m]: wheels of a skidding robot slip, so v_R - v_L = 2 c_eff omega
    with c_eff larger than c. The thesis sets both to c (Eq. 2.9)."""
    a: float = 0.256
    """Distance of the rear axle from the centre of gravity [m]; half of the maker's wheelbase, not in the thesis."""
    b: float = 0.256
    """Distance of the front axle from the centre of gravity [m]; the same."""
    x_icr: float = 0.0
    """Longitudinal coordinate of the instantaneous centre of rotation [m] (Eq. 2.4, 2.10); 0 by Sec. 2.2.3."""
    gravity: float = 9.81
    """g [m/s2]; list of symbols."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a length, mass or inertia that is not positive, or an ICR outside (-a, b), see Sec. 2.2.1.
        """
        for f in fields(self):
            if f.name != "x_icr":
                require_in_range(self, f.name, 0.0, 1e6, open_low=True)
        require_in_range(self, "x_icr", -self.a, self.b)

    @property
    def lateral_lever(self) -> float:
        """Lever of lateral friction spread over the wheels by load, 2ab/(a+b) [m]; a where a = b (Eq. 2.17, 2.19)."""
        return 2.0 * self.a * self.b / (self.a + self.b)

    def packed(self) -> FloatArray:
        """(9,) the fields in their order, for the compiled loops."""
        return np.array([getattr(self, f.name) for f in fields(self)], dtype=np.float64)


@dataclass(frozen=True)
class Drive:
    """From a command (v, omega) to wheel torques: the part of the robot in front of every plant (Fig. 3.10, 3.11)."""

    v_max: float = 1.0
    """Saturation of the linear velocity command [m/s]; Sec. 3.4."""
    w_max: float = 2.0
    """Saturation of the yaw-rate command [rad/s]; Sec. 3.4."""
    delay_v: float = 0.22
    """Dead time of the linear velocity command [s]; Tab. 3.8."""
    delay_w: float = 0.22
    """Dead time of the yaw-rate command [s]; Tab. 3.8."""
    hold: float = 0.05
    """The robot reads its command every `hold` seconds and keeps it [s]; Tab. 3.5, 20 Hz."""
    command_half_track: float = 0.275
    """Half-track that the driver uses to turn omega into wheel rates [m]: half of (separation x multiplier). The thesis:
    c."""
    command_radius: float = 0.1651
    """Wheel radius that the driver uses to turn v into wheel rates [m]."""
    acceleration_v: float = math.inf
    """Greatest rate of change of the linear velocity that the driver asks of its wheels [m/s2]; off (infinite) by default.
    ROS' diff_drive_controller, which drives a Husky, limits v and omega one by one."""
    acceleration_w: float = math.inf
    """The same of the yaw rate [rad/s2]."""
    wheel_lag: float = 0.0
    """Time constant with which the motor controllers follow a wheel-rate reference [s], where the wheel torque loop does
    not describe it; 0: at once."""
    torque_limit: float = 7.0
    """Greatest torque of one wheel [N m]; a side has twice that. Tab. 3.8, whose value only works per wheel
    (docs/errata.md)."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a limit, a period or a length that is not positive, or a negative delay.
        """
        for name in ("v_max", "w_max", "hold", "command_half_track", "command_radius", "torque_limit"):
            require_in_range(self, name, 0.0, open_low=True)
        for name in ("acceleration_v", "acceleration_w"):
            require_in_range(self, name, 0.0, open_low=True)
        for name in ("delay_v", "delay_w", "wheel_lag"):
            require_in_range(self, name, 0.0, 10.0)
