"""The table of planar models. A new model is a file beside this one, named like the model, and a name in this table."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ssmr.models.law import PlanarLaw

PLANAR_MODELS = ("improved", "coulomb", "linear", "kinematic")
"""Names of the planar models, in the order of tables. A model's file is imported, and compiled, when it is first used."""


def planar_law(name: str) -> PlanarLaw:
    """Return the planar model of a name: the `LAW` of its file.

    Raises:
        ValueError: there is no such model; the message lists the names.
    """
    if name not in PLANAR_MODELS:
        raise ValueError(f"unknown planar model '{name}'; there are: {', '.join(PLANAR_MODELS)}")
    law: PlanarLaw = import_module(f"ssmr.models.{name}").LAW
    return law
