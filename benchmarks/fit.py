"""Searches of one fit, beside each other: `python -m benchmarks.fit [--out FILE.json]`.

The MuJoCo Husky of profile thesis-lab on trajectory 4 as the improved model drives it: the same
five parameters, bounds, residuals (position and 0.2 times yaw at tenths of a second) and random
starts for everybody. `hybrid`, `jde` and `lsq` (least squares of scipy) are those of the program
`fit`, its standard errors included; mujoco.sysid descends from the start by least squares of its
own. The least cost that is known is 3.1955 mm.
"""

from __future__ import annotations

import importlib
import os
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from benchmarks.rows import (
    MissingError,
    Row,
    measure_if_installed,
    processor_time,
    report_rows,
)
from ssmr.search.jde import JdeSettings
from ssmr.types import FloatArray
from validation import cli
from validation.fit import fit
from validation.identify.objective import FitCost
from validation.identify.problem import FitProblem
from validation.identify.search import Method
from validation.identify.targets import open_sources
from validation.plants.profile import load_profile
from validation.plants.searchable import make_space

_SOURCE = "traj4@improved"
_YAW_WEIGHT = 0.2
_LAB_FREE = ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x")
_JDE = JdeSettings(population=20, generations=14)
"""Sizes with which jDE costs as much as the hybrid search."""


def _search_by_sysid(problem: FitProblem, start: FloatArray) -> tuple[int, float]:
    """Return the motions that mujoco.sysid's own least squares take from a start, and their cost.

    Raises:
        MissingError: it is not installed.
    """
    try:
        sysid = importlib.import_module("mujoco.sysid")
        parameters = sysid.ParameterDict()
        for name, value in zip(problem.space.names, start, strict=True):
            parameters.add(sysid.Parameter(name, value, 0.0, 1.0))
    # Without its extra the module imports as an empty one.
    except (ImportError, AttributeError) as error:
        raise MissingError("mujoco.sysid is not installed: pip install -e '.[bench]'") from error
    costs = []

    def find_residuals(x: FloatArray, _: object) -> tuple[list[FloatArray], None, None]:
        points = np.clip(np.reshape(x, (len(start), -1)).T, 0.0, 1.0)
        rows = problem.residuals(points, os.cpu_count() or 1)
        rows = np.where(np.isfinite(rows), rows, 1e3 / np.sqrt(rows.shape[1]))
        costs.extend(np.linalg.norm(rows, axis=1).tolist())
        return [rows[0] if np.ndim(x) == 1 else rows.T], None, None

    sysid.optimize(parameters, find_residuals, optimizer="mujoco", verbose=False)
    return len(costs), min(costs)


def _measure_search(name: Method | Literal["sysid"], problem: FitProblem, seed: int) -> Row:
    """Return the least cost and the effort of a search from a random start."""
    names = problem.space.names
    point = np.random.default_rng(7).random((seed + 1, len(names)))[seed]
    began = processor_time()
    if name == "sysid":
        motions, cost = _search_by_sysid(problem, point)
    else:
        values = problem.space.values(point).tolist()
        fitted = fit(
            problem.model,
            _SOURCE,
            "thesis-lab",
            free=names,
            guess=dict(zip(names, values, strict=True)),
            objective="sync",
            yaw_weight=_YAW_WEIGHT,
            search=name,
            seed=seed,
            population=_JDE.population if name == "jde" else None,
            generations=_JDE.generations if name == "jde" else None,
        )
        motions = fitted.course.evaluations
        cost = fitted.cost
    spent = processor_time() - began
    return {"search": name, "motions": motions, "processor_s": spent, "cost_mm": 1e3 * cost}


def main(
    out: Path = Path("runs/benchmarks/fit.json"), starts: int = 5, quick: bool = False
) -> None:
    """Let every search fit from the same random starts; print and write their successes.

    Args:
        out: JSON file to write.
        starts: Number of random starts.
        quick: Fit a planar model from one start: a check that everything runs.
    """
    model, free = ("kinematic", ("y_l", "y_r")) if quick else ("mujoco", _LAB_FREE)
    profile = load_profile("thesis-lab")
    problem = FitProblem(
        model,
        profile.plants[model],
        make_space(model, free, {}, profile.robot),
        open_sources([_SOURCE], profile)[0],
        FitCost("sync", yaw_weight=_YAW_WEIGHT),
    )
    rows = []
    for name in (*get_args(Method), "sysid"):
        for seed in range(1 if quick else starts):
            row = measure_if_installed(quick, partial(_measure_search, name, problem, seed))
            rows += [] if row is None else [row]
    report_rows(f"benchmarks/fit: {model} on trajectory 4", rows, out)


if __name__ == "__main__":
    cli.run_command(main, "python -m benchmarks.fit")
