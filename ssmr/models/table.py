"""The table of planar models. A new model is a file beside this one and a line here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ssmr.models import coulomb, improved, kinematic, linear
from ssmr.models.law import PlanarLaw

MODELS: Mapping[str, PlanarLaw] = MappingProxyType(
    {
        "improved": improved.LAW,
        "coulomb": coulomb.LAW,
        "linear": linear.LAW,
        "kinematic": kinematic.LAW,
    }
)
"""By name, in the order of tables."""

PLANAR_MODELS = tuple(MODELS)
"""Names of the planar models."""


def name_of(parameters: object) -> str:
    """Return the name of the model that a parameter set belongs to.

    Raises:
        ValueError: the parameter set belongs to no model of the table.
    """
    for name, law in MODELS.items():
        if type(parameters) is law.parameters:
            return name
    raise ValueError(f"{type(parameters).__name__} belongs to no planar model; there are: {', '.join(MODELS)}")
