"""The MuJoCo robot as a plant. Another simulation engine is a folder beside this file with a declaration like this one."""

from __future__ import annotations

from functools import partial

from validation.plants.kind import PlantKind, PlantProfile
from validation.plants.one_by_one import OneByOne, Workshop
from validation.simulator.calibration import Calibration
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain

_DRIVEN = ("delay", "acceleration_v", "acceleration_w")


def _build(section: PlantProfile, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED) -> MujocoPlant:
    return MujocoPlant(section.parameters, section.drive, terrain=terrain, settings=settings)


def _renumber(plant: MujocoPlant, section: PlantProfile) -> None:
    plant.renumber(section.parameters, section.drive)


_WORKSHOP = Workshop(_build, _renumber)
"""Where a fit's candidates are made: of those of the generation before, at half the cost of new ones."""

KIND = PlantKind(
    "mujoco",
    Calibration,
    Calibration.of,
    _build,
    partial(OneByOne, _WORKSHOP.make, done_with=_WORKSHOP.done_with),
    free={
        "scenario": ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x"),
        "recording": (
            *("friction", "wheel_radius", "radius_difference", "com_x", "com_y"),
            *(*_DRIVEN, "wheel_lag", "tracked_x", "tracked_y"),
        ),
    },
    colour="#e69f00",  # amber: the Husky is yellow
    together=False,
)
