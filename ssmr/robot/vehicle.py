"""The robot's mass and geometry, and the drive between a command and its wheels."""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import dataclass, replace
from typing import Any

from ssmr.parameters import check_parameters, numbers_of, parameter, require_in_range


@dataclass(frozen=True)
class Vehicle:
    """Mass and geometry of a four-wheel skid-steering robot (Fig. 2.3).

    The defaults are those of the thesis' robot (Tab. 3.1).
    """

    mass: float = parameter(
        73.30, unit="kg", low=0.0, high=1e6, open_low=True, search=(0.55, 2.05), of="mass"
    )
    """Total mass m [kg]; Tab. 3.1, weighed with battery."""
    yaw_inertia: float = parameter(
        2.16, unit="kg m2", low=0.0, high=1e6, open_low=True, search=(0.25, 2.3), of="yaw_inertia"
    )
    """Moment of inertia I about the vertical through the centre of gravity [kg m2]; Tab. 3.1."""
    wheel_radius: float = parameter(
        0.1651, unit="m", low=0.0, high=1e6, open_low=True, search=(0.85, 1.09), of="wheel_radius"
    )
    """Effective rolling radius r [m]; the maker's robot description."""
    radius_difference: float = parameter(
        0.0, unit="m", low=-0.1, high=0.1, search=(-0.073, 0.073), of="wheel_radius"
    )
    """Effective rolling radius of the left wheels less that of the right [m]: tyres are not pumped
    alike. Thesis: none."""
    spin_inertia: float = parameter(0.0, unit="kg m2", low=0.0, high=1e3)
    """Inertia of what spins with the wheels of one side: rotor and gear as they act at the wheels,
    and two wheels [kg m2]. The thesis leaves it out."""
    half_track: float = parameter(0.275, unit="m", low=0.0, high=1e6, open_low=True)
    """c, lever of the longitudinal wheel forces [m]; half of the 0.55 m of Tab. 3.1 (the maker has
    0.2854)."""
    effective_half_track: float = parameter(
        0.275,
        unit="m",
        low=0.0,
        high=1e6,
        open_low=True,
        search=(0.7, 1.5516),
        of=("half_track", "turning_half_track"),
    )
    """Half-track that links yaw rate to wheel rates [m]: wheels of a skidding robot slip, so v_R -
    v_L = 2 c_eff omega with c_eff larger than c. The thesis sets both to c (Eq. 2.9)."""
    a: float = parameter(0.256, unit="m", low=0.0, high=1e6, open_low=True)
    """Distance of the rear axle from the centre of gravity [m]; half of the maker's wheelbase, not
    in the thesis."""
    b: float = parameter(0.256, unit="m", low=0.0, high=1e6, open_low=True)
    """Distance of the front axle from the centre of gravity [m]; half of the maker's wheelbase, not
    in the thesis."""
    x_icr: float = parameter(
        0.0, unit="m", low=-1e6, high=1e6, search=(-0.98, 0.98), of="half_wheelbase"
    )
    """Longitudinal coordinate of the instantaneous centre of rotation [m] (Eq. 2.4, 2.10); 0 by
    Sec. 2.2.3."""
    gravity: float = parameter(9.81, unit="m/s2", low=0.0, high=1e6, open_low=True)
    """g [m/s2]; list of symbols."""

    def __post_init__(self) -> None:
        """Check the ranges: the ICR lies within (-a, b) (Sec. 2.2.1), both radii are positive."""
        check_parameters(self)
        require_in_range(self, "radius_difference", -self.wheel_radius, self.wheel_radius)
        require_in_range(self, "x_icr", -self.a, self.b)


_VehicleNumbers = numbers_of(Vehicle)
_DERIVED = (
    "radius_left",
    "radius_right",
    "per_radius_left",
    "per_radius_right",
    "load_front",
    "load_rear",
    "load_levers",
    "moved",
    "turned",
    "per_moved",
    "per_turned",
    "per_turned_aside",
)
VehicleBody = namedtuple("VehicleBody", [*_VehicleNumbers._fields, *_DERIVED])  # type: ignore[misc]
"""A vehicle in compiled functions: its numbers, and those that the laws of motion derive from them
once instead of at every step.

- `radius_left`, `radius_right`: effective rolling radii of the sides [m]; `per_radius_...`: their
  reciprocals [1/m].
- `load_front`, `load_rear`: load of each wheel of an axle at rest [N] (Eq. 2.17).
- `load_levers`: sum over the wheels of load times lever [N m] (Eq. 2.17, 2.19).
- `moved` [kg], `turned` [kg m2]: mass and yaw inertia that the thrusts accelerate, of the body and
  of what spins with the wheels: a side of spinning inertia J keeps J dOmega/dt of its torque, with
  Omega = (v -+ c_eff omega) / r, at the lever c. `per_moved`, `per_turned`: their reciprocals;
  `per_turned_aside`: that of turned + m x_ICR^2.
"""


def vehicle_body(v: Any) -> Any:
    """Return the `VehicleBody` of packed numbers, each a float or an array over robots."""
    left = v.wheel_radius + 0.5 * v.radius_difference
    right = v.wheel_radius - 0.5 * v.radius_difference
    weight = v.mass * v.gravity
    base = v.a + v.b
    spin = 2.0 * v.spin_inertia / (v.wheel_radius * v.wheel_radius)
    moved = v.mass + spin
    turned = v.yaw_inertia + spin * v.half_track * v.effective_half_track
    kind: Any = VehicleBody
    return kind(
        *v,
        radius_left=left,
        radius_right=right,
        per_radius_left=1.0 / left,
        per_radius_right=1.0 / right,
        load_front=weight * v.a / (2.0 * base),  # N_1 = N_2
        load_rear=weight * v.b / (2.0 * base),  # N_3 = N_4
        load_levers=weight * 2.0 * v.a * v.b / base,
        moved=moved,
        turned=turned,
        per_moved=1.0 / moved,
        per_turned=1.0 / turned,
        per_turned_aside=1.0 / (turned + v.mass * v.x_icr * v.x_icr),
    )


@dataclass(frozen=True, kw_only=True)
class WheeledBody:
    """The numbers of a body on four wheels that a fit may move, in whatever it is simulated.

    Which mass the centre and the inertia belong to, a simulation says.
    """

    mass: float = parameter(unit="kg", low=0.1, high=1e5, search=(0.68, 1.64), of="mass")
    """Total mass m [kg]."""
    yaw_inertia: float = parameter(
        unit="kg m2", low=0.0, high=1e6, open_low=True, search=(0.73, 1.2), of="yaw_inertia"
    )
    """Moment of inertia I of the whole robot about a vertical [kg m2]."""
    half_track: float = parameter(unit="m", low=0.005, high=10.0)
    """Half the distance between left and right wheels [m]."""
    wheel_radius: float = parameter(
        unit="m", low=0.005, high=5.0, search=(0.85, 1.09), of="wheel_radius"
    )
    """Effective rolling radius r [m]."""
    com_x: float = parameter(
        unit="m", low=-10.0, high=10.0, search=(-0.59, 0.59), of="half_wheelbase"
    )
    """Centre of mass ahead of the middle between the axles [m]."""
    com_y: float = parameter(unit="m", low=-10.0, high=10.0, search=(-0.53, 0.53), of="half_track")
    """Centre of mass to the left of that middle [m]."""
    gain: float = parameter(
        unit="N m s/rad",
        low=0.0,
        high=1e10,
        open_low=True,
        search=(0.25, 25.0),
        scale="log",
        of="gain",
    )
    """K_P of a side's velocity servo [N m s/rad]."""
    armature: float = parameter(
        unit="kg m2",
        low=0.0,
        high=1e7,
        open_low=True,
        search=(0.17, 6.7),
        scale="log",
        of="rotor_inertia",
    )
    """Rotor inertia of a wheel through the gearbox [kg m2]. Light wheels behind a stiff servo make
    the answer depend on the time step; heavy ones add armature / wheel_radius^2 of apparent mass
    each."""
    friction: float = parameter(0.3, unit="1", low=0.0, high=5.0, open_low=True, search=(0.02, 1.2))
    """Friction of tyre on ground, mu [1]."""
    radius_difference: float = parameter(
        0.0, unit="m", low=-0.5, high=0.5, search=(-0.073, 0.073), of="wheel_radius"
    )
    """Effective rolling radius of the left wheels less that of the right [m]: tyres are not pumped
    alike."""
    rolling_resistance: float = parameter(0.0, unit="1", low=0.0, high=1.0, search=(0.0, 0.3))
    """Rolling resistance over wheel load [1]."""


@dataclass(frozen=True)
class Drive:
    """The part of the robot between a command and the wheel torques (Fig. 3.10, 3.11)."""

    v_max: float = parameter(1.0, unit="m/s", low=0.0, open_low=True)
    """Saturation of the linear velocity command [m/s]; Sec. 3.4."""
    w_max: float = parameter(2.0, unit="rad/s", low=0.0, open_low=True)
    """Saturation of the yaw-rate command [rad/s]; Sec. 3.4."""
    delay_v: float = parameter(0.22, unit="s", low=0.0, high=10.0, search=(0.0, 0.6))
    """Dead time of the linear velocity command [s]; Tab. 3.8."""
    delay_w: float = parameter(0.22, unit="s", low=0.0, high=10.0, search=(0.0, 0.6))
    """Dead time of the yaw-rate command [s]; Tab. 3.8."""
    hold: float = parameter(0.05, unit="s", low=0.0, open_low=True)
    """The robot reads its command every `hold` seconds and keeps it [s]; Tab. 3.5, 20 Hz."""
    command_half_track: float = parameter(
        0.275,
        unit="m",
        low=0.0,
        open_low=True,
        search=(0.7, 1.5516),
        of=("half_track", "turning_half_track"),
    )
    """Half-track that the driver uses to turn omega into wheel rates [m]: half of (separation x
    multiplier). The thesis: c."""
    command_radius: float = parameter(
        0.1651, unit="m", low=0.0, open_low=True, search=(0.85, 1.15), of="wheel_radius"
    )
    """Wheel radius that the driver uses to turn v into wheel rates [m]."""
    acceleration_v: float = parameter(
        math.inf, unit="m/s2", low=0.0, open_low=True, search=(0.3, 60.0), scale="log"
    )
    """Greatest rate of change of the linear velocity that the driver asks of its wheels [m/s2]; off
    (infinite) by default. ROS' diff_drive_controller, which drives a Husky, limits v and omega one
    by one."""
    acceleration_w: float = parameter(
        math.inf, unit="rad/s2", low=0.0, open_low=True, search=(0.5, 60.0), scale="log"
    )
    """Greatest rate of change of the yaw rate that the driver asks of its wheels [rad/s2]; off by
    default."""
    wheel_lag: float = parameter(0.0, unit="s", low=0.0, high=10.0, search=(0.0, 0.5))
    """Time constant with which the motor controllers follow a wheel-rate reference [s], where the
    wheel torque loop does not describe it; 0: at once."""
    command_ramp: float = parameter(0.0, unit="s", low=0.0, high=10.0)
    """Time in which the driver goes from one command that it reads to the next, in a straight line
    [s]; at most `hold`; 0: at once. Steps of the reference reach the contacts as blows."""
    torque_limit: float = parameter(
        7.0, unit="N m", low=0.0, open_low=True, search=(0.28, 14.0), scale="log", of="torque_limit"
    )
    """Greatest torque of one wheel [N m]; a side has twice that. Tab. 3.8, whose value only works
    per wheel (docs/errata.md)."""
    no_load_rate: float = parameter(math.inf, unit="rad/s", low=0.0, open_low=True)
    """Wheel rate at which a motor at its greatest voltage has no torque left [rad/s]; off
    (infinite) by default."""
    integral_gain: float = parameter(
        0.0, unit="N m/rad", low=0.0, high=1e6, search=(0.5, 50.0), scale="log", of="gain"
    )
    """K_I of a side's speed loop [N m/rad]; 0: the proportional loop of the thesis."""
    dc_stiffness: float = parameter(
        1000.0, unit="N m s/rad", low=0.0, open_low=True, search=(1.0, 50.0), scale="log", of="gain"
    )
    """K_dc, lasting torque of a side's integral part over the rate error that it leaves [N m
    s/rad]: the integral part leaks at the rate K_I / K_dc."""
    torque_constant: float = parameter(0.0, unit="N m/A", low=0.0, high=1e4)
    """Torque of one side's wheels per ampere of its motor [N m/A], by which a log's currents are
    torques; 0: unknown. No motion depends on it."""
    gear_loss: float = parameter(0.0, unit="N m", low=0.0, high=1e3)
    """Dry friction torque of a side's gear and bearings at the wheels [N m]."""

    def __post_init__(self) -> None:
        """Check the ranges; the ramp must have ended when the next command is read."""
        check_parameters(self)
        require_in_range(self, "command_ramp", 0.0, self.hold)

    def later(self, seconds: float) -> Drive:
        """Return the same driver with that much more dead time [s], at least none."""
        v = max(self.delay_v + seconds, 0.0)
        w = max(self.delay_w + seconds, 0.0)
        return replace(self, delay_v=v, delay_w=w)
