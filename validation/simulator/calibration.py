"""The numbers of a simulated robot that a fit may move and a profile keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from ssmr.errors import ParameterError
from ssmr.parameters import check_parameters, parameter, require_in_range
from ssmr.robot.ground import FRONT, LEFT
from ssmr.robot.vehicle import WheeledBody
from ssmr.types import FloatArray
from validation.simulator.description import GRAVITY, WHEELS, Robot, Vector3, WheelShape


@dataclass(frozen=True)
class Calibration(WheeledBody):
    """The numbers of a MuJoCo robot that a fit may move.

    Its motors are a `ssmr.Drive`, as for every plant. `Calibration.of(robot)` has the numbers of
    the robot's file. Centre of mass is that of the base without wheels; moment of inertia is that
    of the whole robot about the middle, the centre of mass being there.

    In the model, mass becomes body_mass of the base, less the wheels; yaw_inertia body_inertia;
    half_track body_pos of the wheels; wheel_radius and radius_difference geom_size, larger by half
    of what the contact lets the tyre in; com_x, com_y and com_z body_ipos; gain
    actuator_gainprm; armature dof_armature; friction geom_friction[0], with anisotropic wheels the
    longitudinal one; and rolling_resistance tendon_frictionloss of a side, coefficient x half the
    weight x radius.
    """

    robot: Robot
    """The robot that is calibrated."""
    com_z: float = parameter(unit="m", low=-10.0, high=10.0, search=(0.0, 1.82), of="wheel_radius")
    """Centre of mass of the base above its frame's origin [m]."""
    capsule_half_width: float = parameter(unit="m", low=1e-5, high=1.0)
    """Half the distance between the two contact points of a capsule wheel [m] -> geom_size[1];
    assumed. It is small, so that the contact stays nearly one point; where friction along the wheel
    is much greater than across, it must be smaller."""
    timestep: float = parameter(unit="s", low=1e-5, high=0.01)
    """Physics step [s] -> opt.timestep; halving a Husky's moves the end of trajectories 1-4 by less
    than 2 mm."""
    wheel_shape: WheelShape = "ellipsoid"
    """Contact shape of the tyres: `ellipsoid` (one point), `cylinder` (a line) or `capsule` (two
    points)."""
    friction_ratio: float = parameter(
        1.0, unit="1", low=0.0, high=10.0, open_low=True, search=(0.5, 1.5)
    )
    """Lateral over longitudinal friction [1] -> pair_friction; other than 1 only with capsule
    wheels, whose contact frame turns with the robot (for other shapes MuJoCo lays the tangents
    along the world's axes)."""

    def __post_init__(self) -> None:
        """Check ranges, room for the tyres, and whether the wheel shape can have the friction."""
        check_parameters(self)
        most = 0.1 * self.wheel_radius
        require_in_range(self, "radius_difference", -most, most)
        base = self.robot.wheelbase
        width = self.robot.wheel_width
        if 2.0 * self.wheel_radius + abs(self.radius_difference) >= base:
            raise ParameterError(
                f"wheel_radius {self.wheel_radius:g} m makes front and rear tyres touch: with a "
                f"wheelbase of {base:g} m it must be less than {0.5 * base:g}"
            )
        if 2.0 * self.half_track <= width:
            raise ParameterError(
                f"half_track {self.half_track:g} m makes left and right tyres touch: with tyres "
                f"{width:g} m wide it must be more than {0.5 * width:g}"
            )
        wheel = self.robot.wheel_mass
        if self.base_mass <= 0.0:
            raise ParameterError(
                f"mass {self.mass:g} kg is not more than that of four wheels of {wheel:g} kg"
            )
        shapes = get_args(WheelShape)
        if self.wheel_shape not in shapes:
            raise ParameterError(
                f"unknown wheel shape '{self.wheel_shape}'; there are: {', '.join(shapes)}"
            )
        if self.friction_ratio != 1.0 and self.wheel_shape != "capsule":
            raise ParameterError(
                f"friction_ratio {self.friction_ratio} needs wheel_shape 'capsule', "
                f"not '{self.wheel_shape}'"
            )

    @property
    def base_mass(self) -> float:
        """Mass of the base without wheels [kg]."""
        return self.mass - len(WHEELS) * self.robot.wheel_mass

    @property
    def com(self) -> Vector3:
        """Centre of mass of the base without wheels, in the base frame [m]."""
        return self.com_x, self.com_y, self.com_z

    @property
    def wheel_places(self) -> FloatArray:
        """(4, 3) middles of the wheels in the base frame [m]."""
        places = self.robot.wheel_places
        places[:, 1] = LEFT * self.half_track
        return places

    @property
    def radii(self) -> FloatArray:
        """(4,) effective rolling radii of the wheels [m]."""
        return self.wheel_radius + 0.5 * LEFT * self.radius_difference

    @property
    def base_height(self) -> float:
        """Height of the base frame's origin where tyres just touch the ground [m]."""
        return self.wheel_radius - self.robot.axle_height

    @property
    def static_shares(self) -> FloatArray:
        """(4,) wheel loads over the weight [1] on equal, stiff springs and level ground."""
        # wheels balance one another
        share = 1.0 - len(WHEELS) * self.robot.wheel_mass / self.mass
        x = share * self.com_x / (0.5 * self.robot.wheelbase)
        y = share * self.com_y / self.half_track
        return 0.25 * (1.0 + x * FRONT + y * LEFT)

    @property
    def base_inertia(self) -> FloatArray:
        """(3,) moments of inertia of the base about its centre of mass [kg m2].

        Roll and pitch inertia scale with the base's mass; the yaw inertia is the whole robot's less
        that of the wheels.

        Raises:
            ParameterError: an inertia that is not positive, or that no rigid body has (each is at
                most the sum of the others).
        """
        robot = self.robot
        lever = (0.5 * robot.wheelbase) ** 2 + self.half_track**2
        from_wheels = len(WHEELS) * (robot.wheel_inertia[0] + robot.wheel_mass * lever)
        scale = self.base_mass / robot.base_mass
        ixx = robot.inertia[0] * scale
        iyy = robot.inertia[1] * scale
        inertia = np.array([ixx, iyy, self.yaw_inertia - from_wheels])
        if inertia[2] <= 0.0 or 2.0 * inertia.max() > inertia.sum() * (1.0 + 1e-9):
            low = abs(ixx - iyy) + from_wheels
            high = ixx + iyy + from_wheels
            raise ParameterError(
                f"yaw_inertia {self.yaw_inertia:g} kg m2 leaves the base {inertia.round(3)}, "
                f"which no rigid body has; with mass {self.mass:g} kg it must lie between "
                f"{low:.3f} and {high:.3f}"
            )
        return inertia

    @property
    def rolling_torque(self) -> float:
        """Torque that rolling takes of a side [N m]."""
        weight = 0.5 * self.mass * GRAVITY
        return self.rolling_resistance * weight * self.wheel_radius

    @classmethod
    def of(cls, robot: Robot, **changes: Any) -> Calibration:
        """Return the numbers of a robot's file, with some changed.

        Raises:
            ValueError: a change that the robot cannot have.
        """
        com_x, com_y, com_z = robot.com
        numbers = {
            "mass": robot.mass,
            "yaw_inertia": robot.yaw_inertia,
            "half_track": 0.5 * robot.track,
            "wheel_radius": robot.wheel_radius,
            "com_x": com_x,
            "com_y": com_y,
            "com_z": com_z,
            "gain": robot.gain,
            "armature": robot.armature,
            "capsule_half_width": contact_half_width(robot, "capsule"),
            "timestep": robot.timestep,
            "wheel_shape": robot.wheel_shape,
            "friction": robot.friction,
        }
        return cls(robot, **{**numbers, **changes})


_WIDTHS = {"ellipsoid": 0.0, "cylinder": 0.5, "capsule": 1.0 / 16.0}
"""Half the distance between a tyre's contact points over its width [1]; a capsule's is assumed."""


def contact_half_width(robot: Robot, shape: WheelShape) -> float:
    """Return half the distance between the contact points of a robot's tyres of a shape [m]."""
    return _WIDTHS[shape] * robot.wheel_width
