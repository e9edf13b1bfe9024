"""Searches of one fit, beside each other: `python -m benchmarks.fit [--out FILE.json]`.

The MuJoCo Husky of profile thesis-lab on trajectory 4 as the improved model drives it: the same
five parameters, bounds, residuals (position and 0.2 times yaw at tenths of a second), threads and
random starts for everybody. `hybrid` and `jDE` are those of `validation.fit`; mujoco.sysid and
scipy's least squares descend from the start, the latter with the finite differences of `hybrid`.
The least cost that is known is 3.1955 mm.
"""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.rows import MissingError, Row, optional, report
from ssmr.search.jde import Jde, JdeSettings
from ssmr.types import FloatArray
from validation import cli
from validation.identify.objective import FitCost
from validation.identify.problem import FitProblem
from validation.identify.refine import STARTS, Remembered, arrivals, error_slopes
from validation.identify.targets import open_sources
from validation.plants.profile import load_profile
from validation.plants.searchable import make_space

_THREADS = os.cpu_count() or 1
_LAB_FREE = ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x")


class Run:
    """One run of a search: its residuals, its random start, and its effort."""

    def __init__(self, problem: FitProblem, seed: int) -> None:
        self.problem = problem
        self.robust = problem.robust
        self.cheap = problem.cheap
        self.pulls = problem.pulls
        self.seed = seed
        self.start = np.random.default_rng(7).random((seed + 1, len(problem.space)))[seed]
        self.motions = 0
        self.least = np.inf
        self.began = time.process_time()

    def residuals(self, points: FloatArray, workers: int | str = _THREADS) -> FloatArray:
        """(S, K) residuals [m] of (S, n) points of the unit cube; an impossible one has 1 km."""
        residuals = self.problem.residuals(np.clip(points, 0.0, 1.0), workers)
        residuals = np.where(np.isfinite(residuals), residuals, 1e3 / np.sqrt(residuals.shape[1]))
        self.motions += len(points)
        self.least = min(self.least, float(np.linalg.norm(residuals, axis=1).min()))
        return residuals


def _by_jde(run: Run, generations: int = 14) -> Jde:
    """Run jDE/best/2 with 20 candidates, the start among them; 14 generations cost a hybrid."""
    settings = JdeSettings(population=20, generations=generations)
    jde = Jde(len(run.start), settings, run.seed, run.start[None])
    while not jde.finished:
        jde.tell(np.linalg.norm(run.residuals(jde.ask()), axis=1))
    return jde


def _by_hybrid(run: Run) -> None:
    """Run `validation.fit --search hybrid`, with its sizes for simulated bodies."""
    jde = _by_jde(run, generations=4)
    list(
        arrivals(
            run, jde.population, jde.costs, STARTS, Remembered(), _THREADS, on_step=lambda: None
        )
    )


def _by_sysid(run: Run) -> None:
    """Run mujoco.sysid's own least squares; a MissingError says that it is not installed."""
    try:
        sysid: Any = importlib.import_module("mujoco.sysid")
        parameters = sysid.ParameterDict()
        for name, start in zip(run.problem.space.names, run.start, strict=True):
            parameters.add(sysid.Parameter(name, start, 0.0, 1.0))
    # Without its extra the module imports as an empty one.
    except (ImportError, AttributeError) as error:
        raise MissingError("mujoco.sysid is not installed: pip install -e '.[bench]'") from error

    def vectorised(x: FloatArray, _: object) -> tuple[list[FloatArray], None, None]:
        rows = run.residuals(np.asarray(x).reshape(len(run.start), -1).T).T
        return [rows[:, 0] if np.asarray(x).ndim == 1 else rows], None, None

    sysid.optimize(parameters, vectorised, optimizer="mujoco", verbose=False)


def _by_scipy(run: Run) -> None:
    """Run bounded least squares of scipy, with its own tolerances."""

    def residuals(x: FloatArray) -> FloatArray:
        return run.residuals(x[None])[0]

    def slopes(x: FloatArray) -> FloatArray:
        return error_slopes(run.residuals, x)[1]

    inside = np.clip(run.start, 1e-6, 1.0 - 1e-6)
    least_squares(residuals, inside, jac=slopes, bounds=(0.0, 1.0))


_SEARCHES: dict[str, Callable[[Run], object]] = {
    "hybrid": _by_hybrid,
    "jDE": _by_jde,
    "scipy": _by_scipy,
    "sysid": _by_sysid,
}


def rows_of(name: str, problem: FitProblem, seeds: Iterable[int]) -> list[Row]:
    """Return the least cost and the effort of a search from each start."""
    rows = list[Row]()
    for run in (Run(problem, seed) for seed in seeds):
        _SEARCHES[name](run)
        spent = time.process_time() - run.began
        row = {
            "search": name,
            "motions": run.motions,
            "processor_s": spent,
            "cost_mm": 1e3 * run.least,
        }
        rows.append(row)
    return rows


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
    rows = list[Row]()
    seeds = range(1 if quick else starts)
    targets = open_sources(["traj4@improved"], profile)[0]
    cost = FitCost("sync", yaw_weight=0.2)
    space = make_space(model, free, {}, profile.robot)
    problem = FitProblem(model, profile.plants[model], space, targets, cost)
    for name in _SEARCHES:
        rows += optional(quick, partial(rows_of, name, problem, seeds)) or []
    report(f"benchmarks/fit: {model} on trajectory 4", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.fit")
