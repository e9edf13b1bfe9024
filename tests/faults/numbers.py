"""Numbers: every constructor that takes numbers, arrays, texts with numbers, and every plant, with extreme ones."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import random
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.faults.damage import EXTREMES, WHOLE_EXTREMES
from tests.faults.doors import call
from tests.faults.judge import USUAL as STATUSES
from tests.faults.judge import Outcome, visible
from tests.faults.pool import Part

TERRAIN_WORDS = (
    "flat", "ramp", "rough", "split", ":", "=", ",", "5", "nan", "1e9", "slope_deg", "seed", "-1", "height_mm", " ", "ü",
    "inf", "1e-9", "ramp:5", "rough:20", "split:0.5", "seed=" + "9" * 400, "\n", "\x00",
)  # fmt: skip


@functools.cache
def constructors() -> Mapping[str, type]:
    """Return every public dataclass of numbers whose fields all have defaults, and which checks them."""
    from tests.test_architecture import modules

    found = {}
    for name in sorted(modules()):
        module = importlib.import_module(name)
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if kind.__module__ != name or not dataclasses.is_dataclass(kind) or kind.__name__.startswith("_"):
                continue
            fields = [f for f in dataclasses.fields(kind) if f.init]
            defaults = all(f.default is not dataclasses.MISSING for f in fields)
            if defaults and any(type(f.default) in (int, float) for f in fields) and "__post_init__" in vars(kind):
                found[f"{name}.{kind.__name__}"] = kind
    return found


def extremes(kind: type, rng: random.Random, most: int) -> dict[str, Any]:
    """Return one to `most` of a dataclass' numbers, by extreme ones."""
    fields = [f for f in dataclasses.fields(kind) if f.init and type(f.default) in (int, float)]
    chosen = rng.sample(fields, rng.randint(1, min(most, len(fields))))
    return {f.name: rng.choice(WHOLE_EXTREMES if type(f.default) is int else EXTREMES) for f in chosen}


def _arrays() -> Mapping[str, Callable[[np.ndarray], Any]]:
    from ssmr.control.waypoints import Waypoints
    from ssmr.types import Commands, Trajectory

    return {
        "Commands": lambda a: Commands(0.05, a[:, :2]),
        "Trajectory": lambda a: Trajectory(np.arange(len(a), dtype=float), a, a, a[:, :2]),
        "Waypoints": lambda a: Waypoints(a[:, 0], a[:, 1:3]),
    }


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases of each kind there are: a third of all inputs."""
    from validation.plants.profile import PLANTS

    unit = 0.35 * inputs
    made = dict.fromkeys([f"class {name}" for name in constructors()], max(1, round(0.55 * unit / len(constructors()))))
    made |= dict.fromkeys([f"array {name}" for name in _arrays()], max(1, round(0.06 * unit)))
    made |= {"terrain": max(1, round(0.08 * unit))}
    return made | dict.fromkeys([f"plant {name}" for name in PLANTS], max(1, round(0.19 * unit / len(PLANTS))))


def run(name: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Make or drive something with extreme numbers."""
    what, _, which = name.partition(" ")
    if what == "class":
        values = extremes(constructors()[which], rng, 3)
        return call(f"{which} {values}", partial(constructors()[which], **values)), STATUSES
    if what == "array":
        table = np.cumsum(np.random.default_rng(rng.randrange(2**32)).random((rng.randint(1, 6), 3)), axis=0)
        for _ in range(rng.randint(1, 3)):
            table[rng.randrange(len(table)), rng.randrange(3)] = rng.choice(EXTREMES)
        return call(f"{which} {table.tolist()}", partial(_arrays()[which], table)), STATUSES
    if what == "terrain":
        from validation.simulator.terrain import parse_terrain

        text = "".join(rng.choice(TERRAIN_WORDS) for _ in range(rng.randint(1, 7)))
        return call(visible(f"terrain {text!r}"), partial(parse_terrain, text)), STATUSES
    part = rng.choice(("parameters", "parameters", "vehicle", "drive"))
    values = extremes(type(getattr(_lab().plants[which], part)), rng, 2)
    return call(f"{which} {part} {values}", partial(drive_changed, which, part, values)), STATUSES


@functools.cache
def _lab() -> Any:
    from validation.plants.profile import load_profile

    return load_profile("thesis-lab")


def drive_changed(name: str, part: str, values: Mapping[str, Any]) -> Any:
    """Return a second of a plant's motion with some numbers of its profile changed."""
    from ssmr.types import Commands, State
    from validation.plants.profile import make_plant

    lab, section = _lab(), _lab().plants[name]
    changed = dataclasses.replace(section, **{part: dataclasses.replace(getattr(section, part), **values)})
    other = dataclasses.replace(lab, plants={**lab.plants, name: changed})
    return make_plant(other, name).run(Commands(0.05, np.tile([0.5, 0.4], (20, 1))), State(), 0.05)


PART = Part(plan, run)
