"""The interface of a rigid-body engine: its description of a robot, and its methods for a plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from ssmr.types import FloatArray
from validation.simulator.calibration import Calibration
from validation.simulator.description import WHEELS

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


MakeBody = Callable[[Calibration, FloatArray, float], EngineBody]
"""Function that builds a robot in an engine.

It takes its numbers, (3,) gravity along the axes of the ground [m/s2], and the dry friction torque
of a wheel [N m]: rolling resistance and its share of the gear's loss.
"""
