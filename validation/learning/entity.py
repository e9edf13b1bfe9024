"""A robot as a dm_control entity: its file, calibrated by a profile, with a profile's motors."""

from __future__ import annotations

from typing import Any

from ssmr.robot.vehicle import Drive
from validation.simulator.calibration import Calibration
from validation.simulator.composing import compose_robot
from validation.simulator.description import Robot
from validation.simulator.model import set_calibration
from validation.simulator.motors import set_motors

try:
    from dm_control import composer, mjcf
except ImportError as missing:
    raise ImportError(
        "RobotEntity and ground need dm_control, which Python 3.11 and 3.12 have; "
        "the rest of validation.learning does not"
    ) from missing

_OPTIONS = "timestep integrator cone impratio iterations tolerance noslip_iterations".split()
"""Settings of the solver that a robot brings. dm_control's own noslip_iterations would stop the
motors' slips, which they take for sliding."""


class RobotEntity(composer.Entity):
    """A robot without its free joint: `Arena.add_free_entity` gives it one."""

    def _build(self, robot: Robot) -> None:
        self._model = _robot_tree(robot)
        self._model.model = robot.name
        self._model.find("joint", "root").remove()

    @property
    def mjcf_model(self) -> Any:
        """The MJCF tree."""
        return self._model

    @property
    def prefix(self) -> str:
        """Prefix of all names once the robot is attached."""
        return f"{self._model.model}/"

    def calibrate(self, physics: Any, calibration: Calibration, drive: Drive) -> None:
        """Set a calibration and the motors of a drive on compiled physics."""
        set_calibration(physics.model.ptr, calibration, self.prefix)
        set_motors(physics.model.ptr, calibration, drive, self.prefix)


def _robot_tree(robot: Robot) -> Any:
    spec = compose_robot(robot)
    spec.compile()  # only then can it be written
    return mjcf.from_xml_string(spec.to_xml())


def ground(robot: Robot) -> composer.Arena:
    """A plane under a lamp, with the robot's solver settings, which attaching does not bring."""
    arena = composer.Arena(name="ground")
    robot_tree = _robot_tree(robot)
    root = arena.mjcf_model
    own = robot_tree.option
    for name in _OPTIONS:
        setattr(root.option, name, getattr(own, name))
    for name in ("multiccd", "eulerdamp"):
        setattr(root.option.flag, name, getattr(own.flag, name))
    root.compiler.angle = "radian"
    root.worldbody.add("geom", name="plane", type="plane", size=[0, 0, 0.05], condim=3)
    root.worldbody.add(
        "light", name="sun", mode="fixed", directional=True, pos=[0, 0, 10], dir=[0.3, 0.2, -1]
    )
    return arena
