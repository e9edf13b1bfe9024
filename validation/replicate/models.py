"""Chapter 3: models fitted to trajectory 4 and judged on all four, and accelerations.

The MuJoCo Husky of profile `thesis-lab` takes the place of the thesis' robot, whose measured motion
is not published.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import FloatArray, State
from validation.fit import fit
from validation.output import Document
from validation.plants.profile import load_profile, make_plant
from validation.plants.table import plant_kind
from validation.replicate import published
from validation.replicate.chapters import Findings, Sections, Task, finished_results, unit_of_metric
from validation.replicate.verdicts import FACTOR, RULE_OF, UNCONVERGED, Pair, Rows, Rule

_PROFILE = "thesis-lab"
_FITS = {
    "coulomb": ("3.8", "3.9"),
    "improved": ("3.11", "3.12"),
    "linear": ("3.14", "3.15"),
}
"""Tables of each model: parameters and distances."""
_PLANTS = ("coulomb", "improved", "linear", "mujoco")
_JUDGED = ("coulomb", "improved")
"""Models of whose accelerations the thesis says something in words."""


def _fit_model(model: str, task: Task) -> Findings:
    """Fit a model's parameters as Sec. 3.5.4-3.5.6 did."""
    population, generations = task.fit
    parameters, distances = _FITS[model]
    fitted = fit(
        model,
        "traj4@mujoco",
        _PROFILE,
        held_out=("traj1", "traj2", "traj3"),
        free=plant_kind(model).free["scenario"],  # as there, though one amplitude tells too little
        objective="path",
        population=population,
        generations=generations,
        search="jde",
        seed=task.seed,
        workers=task.workers,
        progress=task.progress,
    )
    found = finished_results(fitted)
    # what the thesis' search left is not told by its own end, but by another search
    again = fit(
        model,
        "traj4@mujoco",
        _PROFILE,
        free=plant_kind(model).free["scenario"],
        seed=task.seed,
        workers=task.workers,
        progress=task.progress,
    )
    reached = float(finished_results(again)["cost"])
    obstacle = ""
    if found["cost"] > FACTOR * reached:
        costs = f"its cost is {found['cost']:.3g}, and another search reaches {reached:.3g}"
        obstacle = f"{UNCONVERGED}: {costs}"
    words = {
        "called": "Coulomb" if model == "coulomb" else model,
        "parameters": parameters,
        "distances": distances,
        "population": population,
        **{name: found[name] for name in ("evaluations", "generations", "cost", "seed")},
    }
    tables = {
        parameters: _parameter_rows(parameters, model, found, obstacle),
        distances: _distance_rows(distances, found, obstacle),
    }
    return Findings(tables, words)


def _parameter_rows(number: str, model: str, fitted: Document, obstacle: str) -> Rows:
    """Return the thesis' parameters beside those of fit.json."""
    limit = load_profile(_PROFILE).plants[model].drive.torque_limit
    rows = {}
    for row, printed in published.printed_table(number)["rows"].items():
        pair = Pair(
            float(printed["value"]),
            limit,
            "spread",
            printed["unit"],
            obstacle=obstacle or "taken from the thesis, not searched",
        )
        if "ours" in printed:
            p = fitted["parameters"][printed["ours"]]
            unknown = "no standard error could be estimated" if p["standard_error"] is None else ""
            pair = replace(
                pair,
                ours=p["value"],
                spread=p["standard_error"],
                obstacle=obstacle or unknown,
                bounds=(p["lower"], p["upper"]),
                scale=p["scale"],
                printed_bounds=printed.get("search", ()),
            )
        rows[row] = {"value": pair}
    return rows


def _distance_rows(number: str, fitted: Document, obstacle: str) -> Rows:
    """Distances of the fitted model from the robot, our MuJoCo Husky, on trajectories 1-4."""
    scores = {**fitted["held_out"], "traj4": fitted["train"]}
    by_trajectory = {name.partition("@")[0]: metrics for name, metrics in scores.items()}
    rows = {}
    for row, printed in published.printed_table(number)["rows"].items():
        pairs = {}
        for metric, rule in RULE_OF.items():
            ours = by_trajectory[row][metric]
            unit = unit_of_metric(metric)
            pairs[metric] = Pair(printed.get(metric), ours, rule, unit, obstacle=obstacle)
        rows[row] = pairs
    return rows


def _count_alternations(task: Task) -> Findings:
    """Find how often yaw accelerations alternate on trajectory 4 (Fig. 3.33)."""
    profile = load_profile(_PROFILE)
    commands = TRAJECTORIES["traj4"].commands()
    rows = {}
    for name in _PLANTS:
        plant = make_plant(profile, name)
        motion = plant.run(commands, State(), plant.dt)
        share = alternating_samples(motion.channels["yaw_acceleration_rad_s2"]) / (len(motion) - 2)
        rule: Rule = "words" if name in _JUDGED else "none"
        rows[name] = {"alternating_percent": Pair(None, 100.0 * share, rule, "%")}
    return Findings({"Fig. 3.33": rows})


def alternating_samples(acceleration: FloatArray) -> int:
    """How many samples of an (M,) acceleration differ in sign from both neighbours, as chatter."""
    sign = np.sign(acceleration)
    changes = sign[1:] * sign[:-1] < 0.0
    return int(np.sum(changes[:-1] & changes[1:]))


MODEL_SECTIONS: Sections = {
    **{f"fit-{name}": (tables, partial(_fit_model, name)) for name, tables in _FITS.items()},
    "accelerations": (("Fig. 3.33",), _count_alternations),
}
"""The sections on chapter 3."""
