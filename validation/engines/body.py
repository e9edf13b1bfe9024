"""The interface of a rigid-body engine: its description of a robot, and its methods for a plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ssmr.errors import ParameterError
from ssmr.robot.ground import LEFT
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, WHEELS
from validation.simulator.model import base_inertia, static_shares
from validation.simulator.terrain import Terrain

SINK_SHARE = 1e-3
"""Depth to which a tyre sinks at rest where no stiffness is given, over its radius [1]; radii are
larger by as much."""


class EngineMissingError(ValueError):
    """An engine is not installed; the message says in one line how to get it."""


class Rigid(NamedTuple):
    """Motion of a robot's bodies, in the world's axes; wheels are in the order of `WHEELS`."""

    position: FloatArray
    """(3,) of the base frame's origin [m]."""
    quat_wxyz: FloatArray
    """(4,) of the base."""
    velocity: FloatArray
    """(3,) of the base frame's origin [m/s]."""
    spin: FloatArray
    """(3,) angular velocity of the base [rad/s]."""
    wheels: FloatArray
    """(4,) wheel rates [rad/s]."""

    @classmethod
    def at_rest(cls, height: float) -> Rigid:
        """Return the robot at rest, level, at a height [m] above the origin."""
        position = np.array([0.0, 0.0, height])
        level = np.array([1.0, 0.0, 0.0, 0.0])
        return cls(position, level, np.zeros(3), np.zeros(3), np.zeros(len(WHEELS)))


@dataclass(frozen=True, eq=False)
class RigidNumbers:
    """A calibrated robot on its ground, and what follows from its numbers in every engine."""

    calibration: Calibration
    """Masses, sizes and friction."""
    gravity: FloatArray
    """(3,) gravity along the axes of the ground [m/s2]."""
    base_inertia: FloatArray
    """(3,) moments of inertia of the base without wheels about its centre of mass [kg m2]."""
    places: FloatArray
    """(4, 3) middles of the wheels in the base frame [m]."""
    radii: FloatArray
    """(4,) rolling radii [m]."""
    loads: FloatArray
    """(4,) wheel loads at rest on level ground [N]."""
    dry: float
    """Dry friction torque of a wheel: rolling resistance and its share of the gear's loss [N m]."""
    groups: tuple[tuple[int, ...], ...]
    """Indices of the wheels that each motor turns; a belt ties those of one motor."""

    @classmethod
    def of(cls, calibration: Calibration, drive: Drive, terrain: Terrain) -> RigidNumbers:
        """Return the numbers of a calibrated robot on even ground.

        Raises:
            ParameterError: friction that depends on direction, or an inertia that no body has.
        """
        c = calibration
        if c.friction_ratio != 1.0:
            raise ParameterError(
                f"friction_ratio {c.friction_ratio:g}: this engine's tyres have one friction"
            )
        return cls(
            calibration=c,
            gravity=terrain.gravity(GRAVITY),
            base_inertia=base_inertia(c),
            places=c.wheel_places,
            radii=c.wheel_radius + 0.5 * LEFT * c.radius_difference,
            loads=np.maximum(static_shares(c), 0.0) * (c.mass * GRAVITY),
            dry=0.5 * (c.rolling_torque + drive.gear_loss),
            groups=tuple(tuple(map(WHEELS.index, w)) for w in c.robot.motors.values()),
        )

    @property
    def height(self) -> float:
        """Height of the base frame's origin where tyres just touch the ground [m]."""
        return self.calibration.wheel_radius - self.calibration.robot.axle_height

    @property
    def cylinders(self) -> bool:
        """Whether tyres are cylinders; otherwise each touches the ground in one point."""
        return self.calibration.wheel_shape == "cylinder"


class EngineBody(Protocol):
    """A robot inside an engine; its wheels are numbered as `WHEELS`."""

    def place(self, motion: Rigid) -> None:
        """Put the robot into a motion, without memory of former ones; wheel angles are 0."""

    def motion(self) -> Rigid:
        """Return how the robot moves now."""

    def advance(self, torques: FloatArray, yaw_torque: float) -> None:
        """Take a physics step under (4,) wheel torques [N m] and a base torque about z [N m]."""

    def advance_turning(self, rates: FloatArray, yaw_torque: float) -> None:
        """Take a physics step with wheels that turn at (4,) given rates [rad/s]."""

    def wheel_loads(self) -> FloatArray:
        """Return the (4,) normal forces on the wheels [N], as the last step had them."""
