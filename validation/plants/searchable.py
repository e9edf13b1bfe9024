"""The numbers of each plant that a fit may move: names, units and default bounds.

They are declared at their fields; their places are in a `PlantProfile`. NAME@TAG is the number of
those logs alone that have the tag: a log's own name, or that of its ground.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ssmr.parameters import describe_parameters, require_one_of
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.search.space import Parameter, ParameterSpace
from validation.plants.kind import PARTS, PlantProfile
from validation.plants.table import plant_kind
from validation.simulator.description import Robot

_DELAY = describe_parameters(Drive)["delay_v"].search or (0.0, 0.0)
_BOTH_DELAYS = Parameter(
    "delay", "s", *_DELAY, least=0.0, places=("drive.delay_v", "drive.delay_w")
)
"""A number that is no single field: one delay for both commands."""


def _declared_numbers(
    section: str, kind: type, allowed: Container[str], robot: Robot
) -> tuple[Parameter, ...]:
    """Return the numbers of one part of a plant that have finite default bounds."""
    out = []
    for name, d in describe_parameters(kind).items():
        bounds = d.bounds(robot.sizes)
        # the bounds of a limit that is off for this robot are infinite
        if name in allowed and bounds is not None and all(map(math.isfinite, bounds)):
            s = Parameter(name, d.unit, *bounds, scale=d.scale, least=d.low, greatest=d.high)
            out.append(replace(s, places=(f"{section}.{name}",)))
    return tuple(out)


_FOLLOWED = 15.0
"""Greatest acceleration that a search tries for a body on tyres [m/s2]: 1.5 g, the most that a
friction of 1.5 can follow. Beyond some 20 m/s2 its motions are alike, and searches end on that
plain. A planar model without limits of its motors follows any."""


def _follow_declaration(number: Parameter) -> Parameter:
    if number.name != "acceleration_v":
        return number
    return replace(number, upper=min(number.upper, _FOLLOWED))


@lru_cache(maxsize=64)
def searchable_numbers(plant: str, robot: Robot) -> tuple[Parameter, ...]:
    """Return every number of a plant that a fit may move; default bounds scale with the robot.

    Raises:
        ValueError: there is no such plant.
    """
    kind = plant_kind(plant)
    drive = _declared_numbers("drive", Drive, kind.drive, robot)
    if kind.torques:
        drive = tuple(map(_follow_declaration, drive))
    return (
        *_declared_numbers(
            "parameters", kind.parameters, describe_parameters(kind.parameters), robot
        ),
        *_declared_numbers("vehicle", Vehicle, kind.vehicle, robot),
        *drive,
        _BOTH_DELAYS,
        *_declared_numbers("localiser", Localiser, describe_parameters(Localiser), robot),
    )


OF_A_LOG = ("tracked_yaw", "position_late", "yaw_late")
"""Numbers of the localiser that differ from log to log: its mount, and how late it is."""
_OF_A_GROUND = ("friction", "mu_c", "mu_s", "mu_d", "k_y", "rolling_resistance", "u_x", "k_u")
"""Numbers that differ from ground to ground: each plant's friction and rolling resistance."""


@lru_cache(maxsize=1024)
def find_number(plant: str, name: str, robot: Robot) -> Parameter:
    """Return a plant's searchable number by its name, with or without a tag.

    Raises:
        ValueError: there is no such plant or number; the message lists those there are.
    """
    numbers = {s.name: s for s in searchable_numbers(plant, robot)}
    number = name.partition("@")[0]
    require_one_of(number, numbers, f"{plant} has no parameter '{number}' to fit")
    return replace(numbers[number], name=name)


_Places = dict[str, list[int]]
"""Where numbers stand in a space, by their names without tags."""


def own_indices(names: Sequence[str], tags: Container[str]) -> _Places:
    """Return where each number of a log with some tags stands in `names`.

    A number of other logs alone has the places of all of these.
    """
    own: _Places = {}
    others: _Places = {}
    for k, name in enumerate(names):
        number, _, tag = name.partition("@")
        places = own if not tag or tag in tags else others
        places.setdefault(number, []).append(k)
    return {**others, **own}


def split_by_log(
    names: Iterable[str], logs: Iterable[str], grounds: Iterable[str]
) -> tuple[str, ...]:
    """Return names of numbers, of which those of a log or of a ground have a tag for each."""
    split: list[str] = []
    for name in names:
        tags: Iterable[str] = ()
        if name in OF_A_LOG:
            tags = logs
        elif name in _OF_A_GROUND:
            tags = grounds
        split += [f"{name}@{tag}" for tag in tags] or [name]
    return tuple(split)


def make_space(
    plant: str, names: Iterable[str], bounds: Mapping[str, tuple[float, float]], robot: Robot
) -> ParameterSpace:
    """Return the space that `names` span, with default bounds or those given.

    Bounds of a number hold for it on each log that has no bounds of its own.

    Raises:
        ValueError: an unknown name, bounds for a number that is not free, one number under two
            names, or bounds that make no sense.
    """
    chosen = [find_number(plant, name, robot) for name in names]
    for name in bounds:
        find_number(plant, name, robot)
        if name not in {*(s.name for s in chosen), *(s.name.partition("@")[0] for s in chosen)}:
            raise ValueError(f"bounds are given for {name}, which is not free")
    # two names of one number, such as delay and delay_v, would undo each other
    taken: dict[str, str] = {}
    for number in chosen:
        base, at, _ = number.name.partition("@")
        for place in number.places:
            if taken.setdefault(place, base + at) != base + at:
                first = taken[place].rstrip("@")
                raise ValueError(f"{first} and {number.name} move the same number")
    parameters = []
    for s in chosen:
        usual = bounds.get(s.name.partition("@")[0], (s.lower, s.upper))
        lower, upper = bounds.get(s.name, usual)
        parameters.append(replace(s, lower=lower, upper=upper))
    return ParameterSpace(tuple(parameters))


def with_values(
    name: str,
    plant: PlantProfile,
    names: Sequence[str],
    values: Iterable[float],
    tags: Container[str] = (),
    weights: Sequence[float] | None = None,
) -> PlantProfile:
    """Return a copy of the profile of the plant called `name` with some numbers in place.

    They are those of a log with some `tags`; a number of other logs alone is their mean by the
    `weights`, which are equal if not given.

    Raises:
        ValueError: an unknown name, or numbers that the plant cannot have.
    """
    sections: dict[str, dict[str, float]] = {part: {} for part in PARTS}
    given = list(values)
    shares = weights or [1.0] * len(given)
    for number, places in own_indices(names, tags).items():
        value = given[places[0]]  # one alone stays as it is, to the last bit
        if len(places) > 1:
            own = [shares[k] for k in places]
            value = float(np.average([given[k] for k in places], weights=own))
        for place in find_number(name, number, plant.robot).places:
            section, _, field = place.partition(".")
            sections[section][field] = float(value)
    changed = {}
    for section, numbers in sections.items():
        if numbers:
            changed[section] = replace(getattr(plant, section), **numbers)
    return replace(plant, **changed)
