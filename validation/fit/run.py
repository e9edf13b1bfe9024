"""`python -m validation.fit MODEL --to SOURCE`: a plant's parameters from a motion, by differential evolution."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation import cli, store
from validation.fit.fitting import as_document, fitted_profile
from validation.fit.objective import CostName, Problem
from validation.fit.result import FitResult
from validation.plants.profile import PlantProfile, Profile, dump
from validation.plants.searchable import find, with_values

POPULATION = {"mujoco": 32}
"""Default size of the population where it is not that of Tab. 3.7."""
GENERATIONS = {"mujoco": 60}
"""Default number of generations likewise."""

COSTS: dict[str, CostName] = {"scenario": "path", "recording": "horizon"}
"""What is made small unless the user says otherwise."""


def first_points(space: ParameterSpace, model: str, base: PlantProfile, start: str | None) -> FloatArray | None:
    """(1, n) the candidate to begin with, in the unit cube: the profile's values, and others where given.

    Raises:
        ValueError: a start outside the bounds, or of a parameter that is not free.
    """
    if start is None:
        return None
    given = {} if start == "profile" else cli.parse_values(start, "--start")
    for name in given:
        find(model, name)
        if name not in space.names:
            raise ValueError(f"--start names {name}, which is not free")
    values = [given.get(name, find(model, name).read(base)) for name in space.names]
    return space.points(np.array(values)[None])


def require_possible(problem: Problem, model: str) -> None:
    """Refuse what no candidate can be: the profile's own numbers, and bounds of the inertia that no body has.

    Raises:
        ValueError: the plant cannot be built; the message says why.
    """
    from validation.robots.plant import MujocoPlant

    if model != "mujoco":
        return
    ends: list[dict[str, float]] = [{}]
    ends += [
        {p.name: end} for p in problem.space.parameters if p.name in ("yaw_inertia", "mass") for end in (p.lower, p.upper)
    ]
    for end in ends:
        plant = with_values(model, problem.base, list(end), list(end.values()))
        try:
            MujocoPlant(plant.parameters, plant.drive)
        except ValueError as error:
            what = f"bounds of {next(iter(end))}: " if end else ""
            raise ValueError(f"{what}{error}") from error


def write(
    result: FitResult, point: FloatArray, problem: Problem, base: Profile, name: str, folder: Path, *, rerun: bool
) -> list[Path]:
    """Write fit.png, profile.toml, fit.rrd (if wanted) and, last, fit.json; return what was written."""
    from validation.compare.figure import save_figure
    from validation.fit.figure import fit_figure

    written = [folder / "fit.png"]
    save_figure(fit_figure(result), written[0])
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    text = dump(fitted_profile(result, base, problem, point, name, date))
    written.append(folder / "profile.toml")
    store.write_atomic(written[-1], lambda temporary: temporary.write_text(text, encoding="utf-8"))
    if rerun:
        from validation.fit.rerun import write_fit_recording

        written.append(folder / "fit.rrd")
        write_fit_recording(result, written[-1])
    written.append(folder / "fit.json")
    store.write_json(written[-1], as_document(result))
    return written
