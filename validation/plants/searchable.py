"""What of each plant a fit may move: names, units, default bounds, and where the number stands in a plant's profile."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ssmr.search.space import Parameter, ParameterSpace, Scale
from validation.plants.profile import PlantProfile

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


def _s(name: str, section: str, unit: str, lower: float, upper: float, scale: Scale = "linear") -> Searchable:
    return Searchable(name, (f"{section}.{name}",), unit, lower, upper, scale)


_DRIVE = (
    Searchable("delay", ("drive.delay_v", "drive.delay_w"), "s", 0.0, 0.6),
    _s("delay_v", "drive", "s", 0.0, 0.6),
    _s("delay_w", "drive", "s", 0.0, 0.6),
    _s("command_half_track", "drive", "m", 0.2, 0.8),
    _s("command_radius", "drive", "m", 0.14, 0.19),
    _s("acceleration_v", "drive", "m/s2", 0.3, 60.0, "log"),
    _s("acceleration_w", "drive", "rad/s2", 0.5, 60.0, "log"),
    _s("wheel_lag", "drive", "s", 0.0, 0.5),
    _s("torque_limit", "drive", "N m", 2.0, 100.0, "log"),
)
_POINT = (
    Searchable("tracked_x", ("tracked_point.0",), "m", -0.4, 0.4),
    Searchable("tracked_y", ("tracked_point.1",), "m", -0.2, 0.2),
)
_VEHICLE = (
    _s("mass", "vehicle", "kg", 40.0, 150.0),
    _s("yaw_inertia", "vehicle", "kg m2", 1.0, 10.0),
    _s("wheel_radius", "vehicle", "m", 0.14, 0.18),
    _s("effective_half_track", "vehicle", "m", 0.2, 0.8),
    _s("x_icr", "vehicle", "m", -0.25, 0.25),
)
_GAIN = _s("gain", "parameters", "N m s/rad", 10.0, 500.0, "log")

SEARCHABLE: Mapping[str, tuple[Searchable, ...]] = {
    "coulomb": (
        _s("u_x", "parameters", "1", 0.0, 0.2), _s("mu_c", "parameters", "1", 0.0, 0.2), _GAIN, *_VEHICLE, *_DRIVE, *_POINT,
    ),
    "improved": (
        _s("u_x", "parameters", "1", 0.0, 0.2), _s("mu_s", "parameters", "1", 0.0, 0.15),
        _s("mu_d", "parameters", "1", 0.0, 0.15), _GAIN, *_VEHICLE[:-1], *_DRIVE, *_POINT,
    ),
    "linear": (
        _s("k_u", "parameters", "s/m", 0.0, 0.05), _s("k_y", "parameters", "s", 0.0, 0.1),
        _s("gain", "parameters", "N m s/m", 50.0, 500.0, "log"), *_VEHICLE[:-1], *_DRIVE, *_POINT,
    ),
    "kinematic": (
        _s("alpha_l", "parameters", "1", 0.8, 1.1), _s("alpha_r", "parameters", "1", 0.8, 1.1),
        _s("y_l", "parameters", "m", 0.2, 0.9), _s("y_r", "parameters", "m", -0.9, -0.2),
        _s("x_icr", "parameters", "m", -0.25, 0.25), *_VEHICLE[2:3], *_DRIVE[:-1], *_POINT,
    ),
    "mujoco": (
        _s("friction", "parameters", "1", 0.1, 1.2), _s("rolling_resistance", "parameters", "1", 0.0, 0.3),
        _s("wheel_radius", "parameters", "m", 0.14, 0.18), _s("radius_difference", "parameters", "m", -0.012, 0.012),
        _s("gain", "parameters", "N m s/rad", 30.0, 3000.0, "log"), _s("armature", "parameters", "kg m2", 0.05, 2.0, "log"),
        _s("mass", "parameters", "kg", 50.0, 120.0), _s("com_x", "parameters", "m", -0.15, 0.15),
        _s("com_y", "parameters", "m", -0.15, 0.15), _s("com_z", "parameters", "m", 0.0, 0.3),
        _s("yaw_inertia", "parameters", "kg m2", 3.2, 5.3), *_DRIVE, *_POINT,
    ),
}  # fmt: skip
"""By plant. Default bounds are wide: what is known of the field, not of one robot. Those of the dynamic models hold Tab.
3.8, 3.11 and 3.13. Larger viscous coefficients would eat up the torque, and a fit mistakes that for the start."""

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
    made = replace(plant, tracked_point=(point[0], point[1]), **changed)
    if model == "improved" and made.parameters.mu_d > made.parameters.mu_s:
        mu_d, mu_s = made.parameters.mu_d, made.parameters.mu_s
        raise ValueError(f"mu_d {mu_d:g} exceeds mu_s {mu_s:g}: sliding would grip more than standing")
    return made
