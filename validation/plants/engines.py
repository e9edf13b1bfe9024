"""ODE and Drake as plants: second opinions on the robot that MuJoCo simulates, with MuJoCo's numbers."""

from __future__ import annotations

from collections.abc import Callable

from validation.engines.body import EngineBody, RigidNumbers
from validation.engines.drake import DrakeBody, DrakeSettings
from validation.engines.ode import OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.kind import PlantKind, PlantProfile
from validation.plants.one_by_one import OneByOne
from validation.plants.table import STANDARD, plant_kind
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.terrain import FLAT, Terrain

_BODIES: dict[str, tuple[Callable[[RigidNumbers], EngineBody], str]] = {
    "ode": (lambda numbers: OdeBody(numbers, OdeSettings()), "#8c510a"),
    "drake": (lambda numbers: DrakeBody(numbers, DrakeSettings()), "#35978f"),
}
"""For each engine, what builds the robot in it with the best settings that were found, and its colour."""


def declare(name: str) -> PlantKind:
    """Return the declaration of an engine's robot; the engine itself is loaded when one is built.

    Raises:
        KeyError: there is no such engine.
    """
    make, colour = _BODIES[name]
    standard = plant_kind(STANDARD)

    def build(section: PlantProfile, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED) -> EnginePlant:
        """Return the plant; `settings` are MuJoCo's and say nothing here."""
        return EnginePlant(name, make, section.parameters, section.drive, terrain)

    def population(candidates: object, workers: int) -> OneByOne[EnginePlant]:
        return OneByOne(build, candidates, workers)  # type: ignore[arg-type]

    return PlantKind(name, standard.parameters, standard.defaults, build, population, standard.free, colour, together=False)
