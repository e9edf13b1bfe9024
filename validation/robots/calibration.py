"""The numbers of the MuJoCo Husky: what a fit may move, and what a profile keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from ssmr.parameters import check_parameters, parameter, require_in_range

WheelShape = Literal["ellipsoid", "cylinder", "capsule"]


@dataclass(frozen=True)
class HuskyCalibration:
    """The numbers of the MuJoCo Husky that a fit may move. What drives it is a `ssmr.vehicle.Drive`, as for every plant."""

    friction: float = parameter(0.3, unit="1", low=0.0, high=5.0, open_low=True, search=(0.1, 1.2))
    """Sliding friction of tyre on ground [1] -> geom_friction[0]; with anisotropic wheels the longitudinal one. Assumed:
    above 0.356 a robot of these numbers cannot turn on the spot with the 7 N m a wheel of Tab. 3.8 (docs/physics.md)."""
    friction_ratio: float = parameter(1.0, unit="1", low=0.0, high=10.0, open_low=True)
    """Lateral over longitudinal friction [1] -> pair_friction; other than 1 only with capsule wheels, whose contact frame
    turns with the robot (for other shapes MuJoCo lays the tangents along the world's axes)."""
    wheel_radius: float = parameter(0.1651, unit="m", low=0.0, high=1.0, open_low=True, search=(0.14, 0.18))
    """Effective rolling radius [m] -> geom_size, larger by half of what the contact lets the tyre in (`PRESSED_IN`); the
    maker's robot description."""
    radius_difference: float = parameter(0.0, unit="m", low=-0.1, high=0.1, search=(-0.012, 0.012))
    """Effective rolling radius of the left wheels less that of the right [m]: tyres are not pumped alike -> geom_size."""
    rolling_resistance: float = parameter(0.0, unit="1", low=0.0, high=1.0, search=(0.0, 0.3))
    """Rolling resistance over wheel load [1] -> tendon_frictionloss of a side, coefficient x half the weight x radius."""
    gain: float = parameter(118.04, unit="N m s/rad", low=0.0, high=1e7, open_low=True, search=(30.0, 3000.0), scale="log")
    """K_P of a side's velocity servo [N m s/rad] -> actuator_gainprm; Tab. 3.11."""
    armature: float = parameter(0.3, unit="kg m2", low=0.0, high=100.0, open_low=True, search=(0.05, 2.0), scale="log")
    """Rotor inertia of a wheel through the gearbox [kg m2] -> dof_armature; assumed. Light wheels behind a stiff servo
    make the answer depend on the time step; heavy ones add armature / wheel_radius^2 of apparent mass each."""
    mass: float = parameter(73.30, unit="kg", low=15.0, high=1000.0, search=(50.0, 120.0))
    """Total mass [kg] -> body_mass of the base, less the wheels; Tab. 3.1."""
    com_x: float = parameter(0.0, unit="m", low=-0.25, high=0.25, search=(-0.15, 0.15))
    """Centre of mass of the base ahead of the middle between the axles [m] -> body_ipos; assumed, see husky.xml."""
    com_y: float = parameter(0.0, unit="m", low=-0.25, high=0.25, search=(-0.15, 0.15))
    """Centre of mass of the base to the left of the middle [m] -> body_ipos."""
    com_z: float = parameter(0.062, unit="m", low=0.0, high=1.0, search=(0.0, 0.3))
    """Centre of mass of the base above the bottom plate [m] -> body_ipos; the maker's robot description."""
    yaw_inertia: float = parameter(4.42, unit="kg m2", low=0.0, high=1e3, open_low=True, search=(3.2, 5.3))
    """Moment of inertia of the whole robot about the vertical through the middle [kg m2], the centre of mass being there
    -> body_inertia; derived from the maker's, see husky.xml."""
    half_track: float = parameter(0.2854, unit="m", low=0.15, high=1.0)
    """Half the distance between left and right wheels [m] -> body_pos of the wheels; the maker's robot description (the
    thesis prints 0.275)."""
    wheel_shape: WheelShape = "ellipsoid"
    """Contact shape of the tyres: `ellipsoid` (one point), `cylinder` (a line) or `capsule` (two points)."""
    capsule_half_width: float = parameter(0.00715, unit="m", low=1e-4, high=0.05)
    """Half the distance between the two contact points of a capsule wheel [m] -> geom_size[1]; assumed. It is small, so that
    the contact stays nearly one point; where friction along the wheel is much greater than across, it must be smaller."""
    timestep: float = parameter(0.002, unit="s", low=1e-5, high=0.01)
    """Physics step [s] -> opt.timestep; halving it moves the end of trajectories 1-4 by less than 2 mm."""

    def __post_init__(self) -> None:
        """Check the ranges, the wheel shape, and whether the shape can have the friction."""
        check_parameters(self)
        require_in_range(self, "radius_difference", -0.1 * self.wheel_radius, 0.1 * self.wheel_radius)
        if self.wheel_shape not in get_args(WheelShape):
            raise ValueError(f"unknown wheel shape '{self.wheel_shape}'; there are: {', '.join(get_args(WheelShape))}")
        if self.friction_ratio != 1.0 and self.wheel_shape != "capsule":
            raise ValueError(f"friction_ratio {self.friction_ratio} needs wheel_shape 'capsule', not '{self.wheel_shape}'")
