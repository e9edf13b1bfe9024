"""Simulated robots as plants: MuJoCo's, and those of other engines as second opinions on it.

ODE and Drake have the same numbers.
"""

from __future__ import annotations

from ssmr.types import Plant
from validation.engines.body import MakeBody
from validation.engines.drake import DrakeBody
from validation.engines.ode import OdeBody
from validation.engines.plant import EnginePlant
from validation.plants.kind import CAUSES, SEEN, Free, PlantKind, PlantProfile
from validation.simulator.calibration import Calibration
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain

_BODY = (
    "friction",
    "friction_ratio",
    "wheel_radius",
    "radius_difference",
    "com_x",
    "com_y",
)
_FREE: Free = {
    "scenario": CAUSES,
    "commands": (*_BODY, "delay", "acceleration_v", "acceleration_w", "wheel_lag", *SEEN),
    "wheels": (*_BODY, *SEEN),
}
_ENGINES: dict[str, MakeBody] = {"ode": OdeBody, "drake": DrakeBody}
"""Function of each other engine that builds the robot in it, with the best settings found."""
_COLOURS = {"mujoco": "#e69f00", "ode": "#8c510a", "drake": "#35978f"}  # amber: the Husky is yellow


def declare(name: str) -> PlantKind:
    """Return the declaration of an engine's robot.

    An engine besides MuJoCo is loaded when its robot is built.
    """

    def build(
        section: PlantProfile, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED
    ) -> Plant:
        numbers = section.parameters
        if name == "mujoco":
            return MujocoPlant(numbers, section.drive, terrain=terrain, settings=settings)
        return EnginePlant(name, _ENGINES[name], numbers, section.drive, terrain)

    def held(numbers: Calibration) -> tuple[str, ...]:
        """Return which one of the two numbers that say how easily a robot turns is held."""
        has_ratio = name == "mujoco" and numbers.wheel_shape == "capsule"
        return ("com_x" if has_ratio else "friction_ratio",)

    return PlantKind(
        name,
        Calibration,
        Calibration.of,
        build,
        _FREE,
        colour=_COLOURS[name],
        held=held,
        torques=True,
    )
