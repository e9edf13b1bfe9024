"""The table of plants: an engine is a name here, and a planar model comes with its law."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from ssmr._jit import stop_saving
from ssmr.models.law import OWN_MODELS, PLANAR_MODELS, PlanarLaw

if TYPE_CHECKING:
    from validation.plants.kind import PlantKind


_SIMULATED = {
    "mujoco": "validation.plants.simulated",
}
"""Module of each simulated plant, whose function `declare` declares it; imported when the plant is
first used."""

SIMULATED = tuple(_SIMULATED)
"""Plants that are simulated in space: they stand on terrain and obey physics settings."""
STANDARD = SIMULATED[0]
"""The plant that stands for the robot where the user names none."""
USUAL_PLANTS = (*SIMULATED, *PLANAR_MODELS)
"""Plants that programs drive by default, in the order of tables."""
PLANTS = (*USUAL_PLANTS, "four_wheel")
"""Names of the plants that profiles hold numbers of, in the order of tables."""
SECOND_OPINIONS = ("ode", "drake")
"""Other engines' robots: they have the numbers of the standard plant, and need packages that this
one does not bring."""
ALL_PLANTS = (*PLANTS, *SECOND_OPINIONS)
"""Names of all plants."""


def known_plants() -> tuple[str, ...]:
    """Return the names of all plants, those of the user's own last."""
    return (*ALL_PLANTS, *OWN_MODELS)


def is_plant(name: str) -> bool:
    """Return whether a plant has this name, or it is the path of an MJCF."""
    return name in known_plants() or is_foreign(name)


def is_foreign(name: str) -> bool:
    """Return whether a plant's name is the path of an MJCF of others."""
    return name.lower().endswith((".xml", ".mjcf"))


def add_model(law: PlanarLaw) -> None:
    """Make a planar model of the user's own a plant of this process.

    It takes the place of an earlier one of its name.

    Raises:
        ValueError: the name is a shipped plant's, or none.
    """
    if law.name in ALL_PLANTS or not law.name.isidentifier():
        raise ValueError(
            f"a model cannot be named '{law.name}'; take another name than {', '.join(ALL_PLANTS)}"
        )
    # compiled loops that call the user's law are not kept on disk, as its file may change
    stop_saving()
    OWN_MODELS[law.name] = law
    plant_kind.cache_clear()


@cache
def plant_kind(name: str) -> PlantKind:
    """Return the declaration of a plant, whose module is imported when the plant is first used.

    Raises:
        ValueError: there is no such plant; the message lists the names.
    """
    if not is_plant(name):
        raise ValueError(
            f"unknown plant '{name}'; there are: {', '.join(known_plants())}; or give the path of "
            "an MJCF (.xml)"
        )
    modules = {**_SIMULATED, **dict.fromkeys(SECOND_OPINIONS, "validation.plants.simulated")}
    module = modules.get(name, "validation.plants.planar")
    if is_foreign(name):
        module = "validation.plants.foreign"
    kind = import_module(module).declare(name)
    return kind
