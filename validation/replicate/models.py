"""Chapter 3: models fitted to trajectory 4 and judged on all four, and accelerations.

The MuJoCo Husky of profile `thesis-lab` takes the place of the thesis' robot, whose measured motion is not published.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import FloatArray, State
from validation.fit import fit
from validation.plants.profile import load_profile, make_plant
from validation.replicate.chapters import Findings, Section, Task
from validation.thesis import published
from validation.thesis.verdicts import RULE_OF, Pair, Rows

_PROFILE = "thesis-lab"
_FITS: Mapping[str, tuple[str, str]] = {"coulomb": ("3.8", "3.9"), "improved": ("3.11", "3.12"), "linear": ("3.14", "3.15")}
"""Tables of each model: parameters and distances."""
_NAMES: Mapping[str, str] = {
    "delay_u_s": "delay", "delay_w_s": "delay", "u_x": "u_x", "mu_c": "mu_c", "mu_s": "mu_s", "mu_d": "mu_d", "K_u": "k_u",
    "K_y": "k_y", "K_P_tau": "gain",
}  # fmt: skip
"""Names of the thesis' parameters in a fit, which has one delay for both of the thesis'."""
_DRIVEN = ("coulomb", "improved", "linear", "mujoco")
_JUDGED = ("coulomb", "improved")
"""Models of whose accelerations the thesis says something in words."""


def _fitted(model: str, task: Task) -> Findings:
    """Fit a model's parameters as Sec. 3.5.4-3.5.6 did."""
    (population, generations), (parameters, distances) = task.budget.fit, _FITS[model]
    fitted = fit(
        model, "traj4@mujoco", _PROFILE, held_out=("traj1", "traj2", "traj3"), objective="path", population=population,
        generations=generations, search="jde", seed=task.seed, workers=task.workers, progress=task.progress,
    ).as_dict()  # fmt: skip
    if fitted["status"] == "interrupted":
        raise KeyboardInterrupt
    words = {
        "called": "Coulomb" if model == "coulomb" else model,
        "parameters": parameters,
        "distances": distances,
        "population": population,
        **{name: fitted[name] for name in ("evaluations", "generations", "cost", "seed")},
    }
    return Findings(
        {parameters: parameter_rows(parameters, model, fitted), distances: distance_rows(distances, fitted)}, words
    )


def parameter_rows(number: str, model: str, fitted: Mapping[str, Any]) -> Rows:
    """Return the thesis' parameters beside those of fit.json."""
    numbers: Mapping[str, Mapping[str, Any]] = fitted["parameters"]
    rows: dict[str, dict[str, Pair]] = {}
    for row, printed in published.table(number)["rows"].items():
        unit, value = printed["unit"], float(printed["value"])
        if row in _NAMES:
            p = numbers[_NAMES[row]]
            error, bounds = p["standard_error"], (float(p["lower"]), float(p["upper"]))
            obstacle = "no standard error could be estimated" if error is None else ""
            searched = printed.get("search", ())
            rows[row] = {"value": Pair(value, p["value"], "spread", unit, error, {}, obstacle, None, bounds, searched)}
        else:
            held = load_profile(_PROFILE).plants[model].drive.torque_limit
            rows[row] = {"value": Pair(value, held, "spread", unit, obstacle="taken from the thesis, not searched")}
    return rows


def distance_rows(number: str, fitted: Mapping[str, Any]) -> Rows:
    """Return the distances of the fitted model from the robot, for us the MuJoCo Husky, on trajectories 1-4."""
    scored = {name.partition("@")[0]: metrics for name, metrics in fitted["held_out"].items()} | {"traj4": fitted["train"]}
    return {
        row: {m: Pair(printed.get(m), scored[row][m], rule, "m" if m.endswith("_m") else "1") for m, rule in RULE_OF.items()}
        for row, printed in published.table(number)["rows"].items()
    }


def _accelerations(task: Task) -> Findings:
    """Find how often yaw accelerations alternate on trajectory 4 (Fig. 3.33)."""
    plants = {name: make_plant(load_profile(_PROFILE), name) for name in _DRIVEN}
    driven = {name: plant.run(TRAJECTORIES["traj4"].commands(), State(), plant.dt) for name, plant in plants.items()}
    rows: dict[str, dict[str, Pair]] = {}
    for name, motion in driven.items():
        share = alternations(motion.channels["yaw_acceleration_rad_s2"]) / (len(motion) - 2)
        rows[name] = {"alternating_percent": Pair(None, 100.0 * share, "words" if name in _JUDGED else "none", "%")}
    return Findings({"Fig. 3.33": rows})


def alternations(acceleration: FloatArray) -> int:
    """Return how many samples of an (M,) acceleration have another sign than both neighbours, as they do in chatter."""
    sign = np.sign(acceleration)
    return int(np.sum((sign[1:-1] * sign[:-2] < 0.0) & (sign[1:-1] * sign[2:] < 0.0)))


MODEL_SECTIONS = (
    *(Section(f"fit-{model}", tables, partial(_fitted, model)) for model, tables in _FITS.items()),
    Section("accelerations", ("Fig. 3.33",), _accelerations),
)
"""The sections on chapter 3."""
