"""The table of plants. A new engine is a module and a line here; planar models come by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from ssmr.models.law import PLANAR_MODELS

if TYPE_CHECKING:
    from validation.plants.kind import PlantKind

_SIMULATED: Mapping[str, str] = {
    "mujoco": "validation.plants.simulated",
}
"""Module of each simulated plant, whose function `declare` declares it; imported when the plant is first used."""

SIMULATED = tuple(_SIMULATED)
"""Plants that are simulated in space: they stand on terrain and obey physics settings."""
STANDARD = SIMULATED[0]
"""The plant that stands for the robot where the user names none."""
USUAL_PLANTS = (*SIMULATED, *PLANAR_MODELS)
"""Plants that programs drive unless told otherwise, in the order of tables."""
PLANTS = (*USUAL_PLANTS, "four_wheel")
"""Names of the plants that profiles hold numbers of, in the order of tables."""
SECOND_OPINIONS = ("ode", "drake")
"""Other engines' robots: they have the numbers of the standard plant, and need packages that this one does not bring."""
ALL_PLANTS = (*PLANTS, *SECOND_OPINIONS)
"""Names of all plants."""


@cache
def plant_kind(name: str) -> PlantKind:
    """Return the declaration of a plant, whose module is imported when the plant is first used.

    Raises:
        ValueError: there is no such plant; the message lists the names.
    """
    if name not in ALL_PLANTS:
        raise ValueError(f"unknown plant '{name}'; there are: {', '.join(ALL_PLANTS)}")
    others = dict.fromkeys(SECOND_OPINIONS, "validation.plants.simulated")
    kind: PlantKind = import_module({**_SIMULATED, **others}.get(name, "validation.plants.planar")).declare(name)
    return kind
