"""The numbers of each plant that a fit may move: names, units and default bounds.

They are declared at their fields; their places are in a `PlantProfile`.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

from ssmr.parameters import described
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.search.space import Parameter, ParameterSpace
from validation.plants.kind import PARTS, PlantProfile
from validation.plants.table import plant_kind
from validation.simulator.description import Robot

_DELAY = described(Drive)["delay_v"].search or (0.0, 0.0)
_BOTH_DELAYS = Parameter(
    "delay", "s", *_DELAY, least=0.0, places=("drive.delay_v", "drive.delay_w")
)
"""A number that is no single field: one delay for both commands."""


def _declared(
    section: str, kind: type, allowed: Container[str], robot: Robot
) -> tuple[Parameter, ...]:
    """Return the numbers of one part of a plant that have finite default bounds."""
    out = []
    for name, d in described(kind).items():
        bounds = d.bounds(robot.sizes)
        # the bounds of a limit that is off for this robot are infinite
        if name in allowed and bounds is not None and all(map(math.isfinite, bounds)):
            s = Parameter(name, d.unit, *bounds, scale=d.scale, least=d.low, greatest=d.high)
            out.append(replace(s, places=(f"{section}.{name}",)))
    return tuple(out)


FOLLOWED = 15.0
"""Greatest acceleration that a search tries for a body on tyres [m/s2]: 1.5 g, the most that a
friction of 1.5 can follow. Beyond some 20 m/s2 its motions are alike, and searches end on that
plain. A planar model without limits of its motors follows any."""


def _followed(number: Parameter) -> Parameter:
    if number.name != "acceleration_v":
        return number
    return replace(number, upper=min(number.upper, FOLLOWED))


@lru_cache(maxsize=64)
def searchable(plant: str, robot: Robot) -> tuple[Parameter, ...]:
    """Return every number of a plant that a fit may move; default bounds scale with the robot.

    Raises:
        ValueError: there is no such plant.
    """
    kind = plant_kind(plant)
    drive = _declared("drive", Drive, kind.drive, robot)
    if kind.torques:
        drive = tuple(map(_followed, drive))
    return (
        *_declared("parameters", kind.parameters, described(kind.parameters), robot),
        *_declared("vehicle", Vehicle, kind.vehicle, robot),
        *drive,
        _BOTH_DELAYS,
        *_declared("localiser", Localiser, described(Localiser), robot),
    )


@lru_cache(maxsize=1024)
def find(plant: str, name: str, robot: Robot) -> Parameter:
    """Return a plant's searchable number by name.

    Raises:
        ValueError: there is no such plant or number; the message lists those there are.
    """
    numbers = {s.name: s for s in searchable(plant, robot)}
    if name not in numbers:
        raise ValueError(
            f"{plant} has no parameter '{name}' to fit; there are: {', '.join(numbers)}"
        )
    return numbers[name]


def make_space(
    plant: str, names: Iterable[str], bounds: Mapping[str, tuple[float, float]], robot: Robot
) -> ParameterSpace:
    """Return the space that `names` span, with default bounds or those given.

    Raises:
        ValueError: an unknown name, bounds for a number that is not free, one number under two
            names, or bounds that make no sense.
    """
    chosen = [find(plant, name, robot) for name in names]
    for name in bounds:
        find(plant, name, robot)
        if name not in [s.name for s in chosen]:
            raise ValueError(f"bounds are given for {name}, which is not free")
    # two names of one number, such as delay and delay_v, would undo each other
    taken: dict[str, str] = {}
    for number in chosen:
        for place in number.places:
            if place in taken:
                raise ValueError(f"{taken[place]} and {number.name} move the same number")
            taken[place] = number.name
    parameters = []
    for s in chosen:
        lower, upper = bounds.get(s.name, (s.lower, s.upper))
        parameters.append(replace(s, lower=lower, upper=upper))
    return ParameterSpace(tuple(parameters))


def with_values(
    name: str, plant: PlantProfile, names: Sequence[str], values: Iterable[float]
) -> PlantProfile:
    """Return a copy of the profile of the plant called `name` with some numbers in place.

    Raises:
        ValueError: an unknown name, or numbers that the plant cannot have.
    """
    sections: dict[str, dict[str, float]] = {part: {} for part in PARTS}
    for number, value in zip(names, values, strict=True):
        for place in find(name, number, plant.robot).places:
            section, _, field = place.partition(".")
            sections[section][field] = float(value)
    changed = {}
    for section, given in sections.items():
        if given:
            changed[section] = replace(getattr(plant, section), **given)
    return replace(plant, **changed)
