"""The table of plants. A new engine is a folder in this package and a line here; planar models come by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from ssmr.models.law import PLANAR_MODELS

if TYPE_CHECKING:
    from validation.plants.kind import PlantKind

_ENGINES: Mapping[str, str] = {
    "mujoco": "validation.plants.mujoco",
}
"""Module of each simulated plant, which declares it as `KIND`; imported when the plant is first used."""

SIMULATED = tuple(_ENGINES)
"""Plants that are simulated in space: they stand on terrain and obey physics settings."""
STANDARD = SIMULATED[0]
"""The plant that stands for the robot where the user names none."""
USUAL_PLANTS = (*SIMULATED, *PLANAR_MODELS)
"""Plants that programs drive unless told otherwise, in the order of tables."""
_TYRED = {"four_wheel": "validation.plants.four_wheel"}
PLANTS = (*USUAL_PLANTS, *_TYRED)
"""Names of the plants that profiles hold numbers of, in the order of tables."""
SECOND_OPINIONS = ("ode", "drake")
"""Other engines' robots: they have the numbers of the standard plant, and need packages that this one does not bring."""
ALL_PLANTS = (*PLANTS, *SECOND_OPINIONS)
"""Names of all plants."""

_kinds: dict[str, PlantKind] = {}


def plant_kind(name: str) -> PlantKind:
    """Return the declaration of a plant.

    Raises:
        ValueError: there is no such plant; the message lists the names.
    """
    if name not in ALL_PLANTS:
        raise ValueError(f"unknown plant '{name}'; there are: {', '.join(ALL_PLANTS)}")
    if name not in _kinds:
        families = (("validation.plants.planar", PLANAR_MODELS), ("validation.plants.engines", SECOND_OPINIONS))
        family = next((module for module, names in families if name in names), None)
        own = {**_ENGINES, **_TYRED}
        _kinds[name] = import_module(family).declare(name) if family else import_module(own[name]).KIND
    return _kinds[name]
