"""Controllers as Python objects: their knowledge of a mission, and their observations.

A controller is made once for a mission, and asked for a command 20 times a second:

    class Mine:
        def __init__(self, mission: Mission) -> None: ...

        def command(self, now: ControllerInput) -> tuple[float, float]: ...

The command is a speed [m/s] and a yaw rate [rad/s].
If it has a method `observe(now)` too, that is called at every tick of the position loop, before any
command. It may keep whatever it likes. The same object drives every plant, alone and in
populations, and robots behind ROS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ssmr.control.law import Matrix, Observation
from ssmr.control.predictor import DriverEstimate, PredictorModel, predictor_model
from ssmr.control.waypoints import Errors, Target, Waypoints, target_at, targets_at
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray


class ControllerInput(NamedTuple):
    """Everything that a controller may know when it is asked for a command."""

    t: float
    """Mission time, zero when the reference begins [s]."""
    seen_at: float
    """Mission time at which the robot was observed, a few milliseconds earlier [s]."""
    seen: Observation
    """The estimate of pose and velocities: `x`, `y` [m], `yaw` [rad, unwrapped], `v` [m/s] and
    `w` [rad/s]."""
    target: Target
    """The moving target at that time: `x`, `y` [m], `heading` [rad], `v` [m/s] and `w` [rad/s]."""
    errors: Errors
    """The errors to that target: `rho` [m], `y` [m] and `alpha` [rad] (Eq. 4.1, 4.2)."""
    ahead: Observation
    """The robot when this command begins to act, as the planar model predicts it."""
    acts_at: float
    """Mission time of that: the dead time later that was learnt on the way [s]."""
    driver: DriverEstimate
    """The references of its driver by then, and the gains and the slip learnt on the way."""
    past: FloatArray
    """(n, 2) the newest commands that were sent, the newest last; zero where there were none
    yet."""


@dataclass(frozen=True)
class Mission:
    """The task of a controller."""

    waypoints: Waypoints
    """The reference."""
    drive: Drive
    """The driver between command and wheels, as far as it is known: dead times, limits, hold."""
    a: Matrix
    """(4, 4) of the linear model of the robot (Eq. 2.46)."""
    b: Matrix
    """(4, 2) of the linear model."""
    period: float
    """Time between commands [s]."""
    position_period: float
    """Time between observations [s]."""
    lookahead: float = 0.0
    """Distance that the robot is to keep behind its target [m]."""

    @cached_property
    def _course(self) -> Any:
        return self.waypoints.course()

    @cached_property
    def model(self) -> PredictorModel:
        """The predictor's numbers: rates and gains of the linear model, dead times and limits."""
        return predictor_model(np.array(self.a), np.array(self.b), self.drive, self.period)

    @property
    def dead_time(self) -> float:
        """Time from a command to its effect by the drive, the longer of the two [s].

        `ControllerInput.acts_at` has what was learnt on the way.
        """
        return self.model.horizon

    def target(self, t: float) -> Target:
        """Return the target at a mission time [s]; before the start and after the end it waits."""
        return target_at(self._course, float(t), 0)

    def preview(self, times: FloatArray) -> FloatArray:
        """Return the target at (n,) increasing times [s].

        The columns of the (n, 5) array are x, y [m], heading [rad], v [m/s] and w [rad/s].
        """
        return targets_at(self._course, np.asarray(times, dtype=np.float64))


@dataclass(frozen=True)
class PythonController:
    """A controller that runs as a Python object."""

    name: str
    """Name in results."""
    make: Callable[[Mission], Any]
    """Function, or class, that makes the object for a mission."""
    a: Matrix
    """(4, 4) of the linear model (Eq. 2.46) that it knows."""
    b: Matrix
    """(4, 2) of the linear model."""
    drive: Drive = field(default_factory=Drive)
    """The driver between command and wheels, as the controller knows it."""
    manoeuvres: tuple[str, ...] = ()
    """Manoeuvres beside bends that it can follow, named as in `ssmr.control.law.Law`."""
    predictor: ClassVar[bool] = True
    number: ClassVar[int] = 0

    def packed(self) -> FloatArray:
        """Return no gains: no compiled law runs."""
        return np.zeros(0)

    def on(self, drive: Drive) -> PythonController:
        """Return the same controller with knowledge of another driver."""
        return replace(self, drive=drive)
