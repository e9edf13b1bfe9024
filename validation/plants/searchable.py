"""What of each plant a fit may move: names, units, default bounds, and where the number stands in a plant's profile."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ssmr.parameters import Scale, described
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.search.space import Parameter, ParameterSpace
from validation.plants.profile import PARAMETERS, PlantProfile

Occasion = Literal["scenario", "recording"]


@dataclass(frozen=True)
class Searchable:
    """A number that a fit may move."""

    name: str
    """What the command line and the result call it."""
    places: tuple[str, ...]
    """Where it stands in a `PlantProfile`: `section.field`, or `tracked_point.0`."""
    unit: str
    """Of the number."""
    lower: float
    """Default bound."""
    upper: float
    """Default bound."""
    scale: Scale = "linear"
    """How the space between the bounds is searched."""

    def parameter(self, bounds: tuple[float, float] | None = None) -> Parameter:
        """The number with its default bounds, or with others.

        Raises:
            ValueError: bounds that are reversed or not finite.
        """
        lower, upper = bounds or (self.lower, self.upper)
        return Parameter(self.name, self.unit, lower, upper, self.scale)

    def read(self, plant: PlantProfile) -> float:
        """Its value in a profile; of several places the first."""
        section, _, field = self.places[0].partition(".")
        owner = getattr(plant, section)
        return float(owner[int(field)] if section == "tracked_point" else getattr(owner, field))


def _declared(section: str, kind: type, allowed: Container[str]) -> tuple[Searchable, ...]:
    """Return the numbers of one section of a plant's profile that have declared search bounds and are allowed."""
    return tuple(
        Searchable(name, (f"{section}.{name}",), d.unit, *d.search, d.scale)
        for name, d in described(kind).items()
        if d.search is not None and name in allowed
    )


_DYNAMICS = ("mass", "yaw_inertia", "wheel_radius", "effective_half_track")
_VEHICLE = {"coulomb": (*_DYNAMICS, "x_icr"), "improved": _DYNAMICS, "linear": _DYNAMICS, "kinematic": ("wheel_radius",)}
"""What each planar model uses of the vehicle."""
_DELAY = described(Drive)["delay_v"]
_ANYWHERE = (
    Searchable("delay", ("drive.delay_v", "drive.delay_w"), _DELAY.unit, *(_DELAY.search or (0.0, 0.0))),
    Searchable("tracked_x", ("tracked_point.0",), "m", -0.4, 0.4),
    Searchable("tracked_y", ("tracked_point.1",), "m", -0.2, 0.2),
)

SEARCHABLE: Mapping[str, tuple[Searchable, ...]] = {
    name: (
        *_declared("parameters", kind, described(kind)),
        *_declared("vehicle", Vehicle, _VEHICLE.get(name, ())),
        *_declared("drive", Drive, set(described(Drive)) - ({"torque_limit"} if name == "kinematic" else set())),
        *_ANYWHERE,
    )
    for name, kind in PARAMETERS.items()
}
"""By plant, every number that a fit may move."""

_THESIS = {
    "coulomb": ("u_x", "mu_c", "gain"),
    "improved": ("u_x", "mu_s", "mu_d", "gain"),
    "linear": ("k_u", "k_y", "gain"),
    "kinematic": ("alpha_l", "alpha_r", "y_l", "y_r", "x_icr"),
}
"""What Sec. 3.5.4-3.5.6 searched; the baseline has its five constants."""
_DYNAMIC = tuple(name for name in _THESIS if name != "kinematic")
_READ_OFF = ("effective_half_track", "delay", "acceleration_v")
"""What the thesis read off response curves or took for given."""
_DRIVEN = ("delay", "acceleration_v", "acceleration_w")
_POINT_NAMES = ("tracked_x", "tracked_y")

DEFAULT_FREE: Mapping[Occasion, Mapping[str, tuple[str, ...]]] = {
    "scenario": {
        **{name: (*_THESIS[name], *_READ_OFF) for name in _DYNAMIC},
        "kinematic": _THESIS["kinematic"],
        "mujoco": ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x"),
    },
    "recording": {
        **{name: (*_THESIS[name], "wheel_radius", "effective_half_track", *_DRIVEN, *_POINT_NAMES) for name in _DYNAMIC},
        "kinematic": ("alpha_l", "alpha_r", "y_l", "y_r", *_DRIVEN, "wheel_lag", "tracked_x"),
        "mujoco": (
            *("friction", "wheel_radius", "radius_difference", "com_x", "com_y"),
            *(*_DRIVEN, "wheel_lag", *_POINT_NAMES),
        ),
    },
}
"""What is searched unless the user says otherwise."""


def find(model: str, name: str) -> Searchable:
    """A plant's searchable number by name.

    Raises:
        ValueError: it has none of that name; the message lists those there are.
    """
    for searchable in SEARCHABLE[model]:
        if searchable.name == name:
            return searchable
    raise ValueError(f"{model} has no parameter '{name}' to fit; there are: {', '.join(s.name for s in SEARCHABLE[model])}")


def make_space(model: str, names: Iterable[str], bounds: Mapping[str, tuple[float, float]]) -> ParameterSpace:
    """The space that `names` span, with default bounds or those given.

    Raises:
        ValueError: an unknown name, bounds for what is not free, one number under two names, or bounds that make no sense.
    """
    chosen = [find(model, name) for name in names]
    for name in bounds:
        find(model, name)
        if name not in [s.name for s in chosen]:
            raise ValueError(f"bounds are given for {name}, which is not free")
    taken: dict[str, str] = {}
    for searchable in chosen:
        for place in searchable.places:
            if place in taken:
                raise ValueError(f"{taken[place]} and {searchable.name} move the same number")
            taken[place] = searchable.name
    return ParameterSpace(tuple(s.parameter(bounds.get(s.name)) for s in chosen))


def with_values(model: str, plant: PlantProfile, names: Sequence[str], values: Iterable[float]) -> PlantProfile:
    """A copy of a plant's profile with some numbers in place.

    Raises:
        ValueError: an unknown name, or numbers that the plant cannot have.
    """
    sections: dict[str, dict[str, float]] = {"parameters": {}, "vehicle": {}, "drive": {}, "tracked_point": {}}
    for name, value in zip(names, values, strict=True):
        for place in find(model, name).places:
            section, _, field = place.partition(".")
            sections[section][field] = float(value)
    point = list(plant.tracked_point)
    for axis, value in sections["tracked_point"].items():
        point[int(axis)] = value
    changed = {s: replace(getattr(plant, s), **given) for s, given in sections.items() if given and s != "tracked_point"}
    return replace(plant, tracked_point=(point[0], point[1]), **changed)
