"""An MJCF of others as a plant, by its path: its own physics behind the driver of the profile."""

from __future__ import annotations

from functools import partial

from ssmr.types import Plant
from validation.descriptions.foreign_robot import ForeignRobot, read_foreign
from validation.descriptions.own_plant import OwnNumbers, OwnPlant
from validation.plants.kind import SEEN, Free, PlantKind, PlantProfile
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.terrain import FLAT, Terrain

_BODY = ("friction", "rolling", "com_x", "com_y")
_FREE: Free = {
    "scenario": (*_BODY, "command_half_track"),
    "commands": (*_BODY, "delay", "acceleration_v", "acceleration_w", *SEEN),
    "wheels": (*_BODY, *SEEN),
}


def declare(name: str) -> PlantKind:
    """Return the declaration of the robot in an MJCF.

    Raises:
        ValueError: the file cannot be read, or is no MJCF of a robot with four wheels.
    """
    try:
        foreign = read_foreign(name)
    except ValueError as error:
        raise ValueError(f"plant {name}: {error}") from error
    if foreign.kind != "mjcf":
        raise ValueError(
            f"plant {name}: a {foreign.kind.upper()} says nothing of contacts and motors, so it is "
            "no plant; take it as --robot"
        )
    return PlantKind(
        name,
        OwnNumbers,
        lambda _: OwnNumbers(),
        partial(_build_plant, name, foreign),
        _FREE,
        colour="#7a5195",
    )


def _build_plant(
    name: str,
    foreign: ForeignRobot,
    section: PlantProfile,
    terrain: Terrain = FLAT,
    settings: PhysicsSettings = SHIPPED,
) -> Plant:
    """Return the plant; its physics are those of its file."""
    content = (foreign.text, foreign.files)
    return OwnPlant(name, content, section.parameters, section.drive, terrain)
