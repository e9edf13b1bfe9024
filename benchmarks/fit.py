"""What a fit costs beside what it cannot do without, and beside its peers: `python -m benchmarks.fit [--out FILE.json]`.

- Rating candidates against simulating them; the search's own share of a fit; a fit of the thesis' size against its 1500
  Simulink runs of 2.75 s (Sec. 3.6, another machine, 2019).
- The MuJoCo fit of profile thesis-lab against `mujoco.sysid`: the same plant, parameters, bounds and residuals (position and
  0.2 times yaw at every sample of trajectory 4 as the improved model drives it), the same rollout threads, from five random
  starts each. sysid descends from one point, jDE begins with a population that holds that point. A run succeeds if it comes
  within a quarter of the least cost that any of them found; both rates and times are printed.
"""

from __future__ import annotations

import importlib
import os
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numba
import numpy as np
from rich.table import Table

from benchmarks.rows import MissingError, Row, alternate, optional, report
from ssmr.search.jde import Jde, JdeSettings
from ssmr.simulation import SAMPLE_DT, PlanarModel, run_population
from ssmr.types import FloatArray, State
from validation import cli
from validation.fit.objective import FitCost
from validation.fit.problem import FitProblem
from validation.fit.search import Search
from validation.fit.targets import FitSources, open_targets
from validation.plants.profile import PlantProfile, load_profile
from validation.plants.searchable import make_space
from validation.progress import Progress
from validation.simulator.plant import MujocoPlant

SIMULINK_RUN_S = 2.75
"""Sec. 3.6: the Coulomb model on trajectory 4, on the authors' machine [s]."""
THESIS_EVALUATIONS = 1500
"""Sec. 3.5.4: thirty generations of fifty."""
STARTS = 5
SLACK = 1.25
"""A run that comes within this factor of the least cost found by any has succeeded."""
LAB_FREE = ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x")


def problem_of(model: str, source: str, free: tuple[str, ...], cost: FitCost) -> FitProblem:
    """A fit to a scenario with the lab's profile."""
    profile = load_profile("thesis-lab")
    return FitProblem(
        model,
        profile.plants[model],
        make_space(model, free, {}, profile.robot),
        open_targets([source], profile, FitSources())[0],
        cost,
    )


def candidates_of(problem: FitProblem, size: int) -> tuple[FloatArray, list[PlantProfile]]:
    """Points near the profile's own, and the plants they mean."""
    rng = np.random.default_rng(0)
    points: list[FloatArray] = []
    plants: list[PlantProfile] = []
    while len(points) < size:
        point = rng.random(len(problem.space))
        if (plant := problem.candidate(point)) is not None:
            points.append(point)
            plants.append(plant)
    return np.array(points), plants


def rating_rows(repeats: int, population: int) -> list[Row]:
    """Time rating a population against simulating it, for planar models and MuJoCo."""
    rows, threads = [], numba.get_num_threads()
    for model, free in (("coulomb", ("u_x", "mu_c", "gain")), ("improved", ("u_x", "mu_s", "mu_d", "gain"))):
        problem = problem_of(model, "traj4@mujoco", free, FitCost("path"))
        points, plants = candidates_of(problem, population)
        models = [PlanarModel(p.parameters, p.vehicle, p.drive) for p in plants]
        commands = problem.targets[0].source.pieces[0].commands
        rated, simulated = alternate(
            partial(problem.costs, points, workers=threads),
            partial(run_population, models, commands, [State()] * len(models), SAMPLE_DT),
            repeats=repeats,
        )
        what = f"{model}: rating {population} candidates by Eq. 3.1 / simulating them"
        rows.append(Row(what, rated / simulated, "<= 1.5", rated, simulated, rated <= 1.5 * simulated))
    problem = problem_of("mujoco", "traj4@improved", LAB_FREE, FitCost("sync"))
    points, plants = candidates_of(problem, 2)
    made = [MujocoPlant(p.parameters, p.drive) for p in plants]
    commands = problem.targets[0].source.pieces[0].commands
    rated, simulated = alternate(
        lambda: problem.costs(points, workers=1),
        lambda: [plant.run(commands, State(), SAMPLE_DT) for plant in made],
        repeats=min(repeats, max(3, repeats // 4)),
    )
    what = "mujoco: building and rating 2 candidates / simulating them"
    return [*rows, Row(what, rated / simulated, "<= 1.5", rated, simulated, rated <= 1.5 * simulated)]


def search_rows(population: int, seeds: int) -> list[Row]:
    """Time the search's own share of a fit, and a fit of the thesis' size against the thesis' time."""
    problem = problem_of("coulomb", "traj4@mujoco", ("u_x", "mu_c", "gain"), FitCost("path"))
    generations = (THESIS_EVALUATIONS if seeds > 1 else 3 * population) // population - 1
    evaluations = population * (generations + 1)
    settings = JdeSettings(population=population, generations=generations, patience=1000)
    threads = numba.get_num_threads()
    rating = [0.0]

    def rate(points: FloatArray, limits: FloatArray, on_share: object) -> FloatArray:
        began = time.perf_counter()
        costs = problem.costs(points, limits, threads)
        rating[0] += time.perf_counter() - began
        return costs

    Search(Jde(3, settings, 0), {}).run(rate)  # compiles
    walls, ratings = [], []
    for seed in range(seeds):
        rating[0] = 0.0
        search = Search(Jde(3, settings, seed), {})
        search.run(rate)
        walls.append(search.wall_s)
        ratings.append(rating[0])
    best = int(np.argmin(walls))
    own, wall = walls[best] - ratings[best], walls[best]
    simulink = evaluations * SIMULINK_RUN_S
    what = f"jDE itself / a fit of Tab. 3.7 (coulomb, NP {population})"
    return [
        Row(what, own / wall, "<= 0.05", own, wall, own <= 0.05 * wall),
        Row(
            f"{evaluations} evaluations: the thesis' time / ours", simulink / wall, ">= 300", wall, simulink,
            simulink >= 300.0 * wall,
        ),
    ]  # fmt: skip


@dataclass
class Course:
    """How a search went from one start."""

    who: str
    seconds: list[float]
    costs: list[float]
    """Least cost known at those times [m]."""

    def reaches(self, cost: float) -> float:
        """When it came to a cost [s]; infinite if never."""
        return next((t for t, c in zip(self.seconds, self.costs, strict=True) if c <= cost), np.inf)


class Residual:
    """The residual both searches make small, and a clock over all calls of it."""

    def __init__(self, who: str, problem: FitProblem, threads: int) -> None:
        self.problem, self.threads = problem, threads
        self.course, self.began = Course(who, [], []), time.perf_counter()

    def __call__(self, points: FloatArray) -> FloatArray:
        """(S, K) residuals [m] of (S, n) points of the unit cube."""
        found = self.problem.errors(np.clip(points, 0.0, 1.0), self.threads)
        yaw = self.problem.cost.yaw_weight * found.yaw
        rows = np.concatenate([found.position.reshape(len(points), -1), yaw], axis=1)
        rows = np.where(np.isfinite(rows), rows, 1e3) / np.sqrt(found.yaw.shape[1])
        least = float(np.sqrt((rows**2).sum(axis=1).min()))
        self.course.costs.append(min([least, *self.course.costs[-1:]]))
        self.course.seconds.append(time.perf_counter() - self.began)
        return rows


def by_sysid(problem: FitProblem, start: FloatArray, threads: int) -> Course:
    """mujoco.sysid's own least squares, from a start."""
    sysid = importlib.import_module("mujoco.sysid")
    residual = Residual("mujoco.sysid", problem, threads)
    parameters = sysid.ParameterDict(
        {n: sysid.Parameter(n, x, 0.0, 1.0) for n, x in zip(problem.space.names, start, strict=True)}
    )

    def vectorised(x: FloatArray, _: object) -> tuple[list[FloatArray], None, None]:
        columns = np.asarray(x).reshape(len(start), -1)
        rows = residual(columns.T).T
        return [rows[:, 0] if np.asarray(x).ndim == 1 else rows], None, None

    sysid.optimize(parameters, vectorised, optimizer="mujoco", verbose=False)
    return residual.course


def by_jde(problem: FitProblem, start: FloatArray, seed: int, generations: int, threads: int) -> Course:
    """jDE/best/2 with the start in its first population."""
    residual = Residual("jDE/best/2", problem, threads)
    jde = Jde(len(start), JdeSettings(population=20, generations=generations), seed, start[None])
    while not jde.finished:
        jde.tell(np.sqrt((residual(jde.ask()) ** 2).sum(axis=1)))
    return residual.course


def sysid_courses(generations: int, threads: int, starts: int) -> list[Course]:
    """Both searches from each of the starts, in turn.

    Raises:
        MissingError: mujoco.sysid is not installed.
    """
    try:
        if not hasattr(importlib.import_module("mujoco.sysid"), "Parameter"):
            raise ImportError("without its extra the module imports as an empty one")
    except ImportError as error:
        raise MissingError("mujoco.sysid is not installed: pip install -e '.[bench]', or pass --no-sysid") from error
    problem = problem_of("mujoco", "traj4@improved", LAB_FREE, FitCost("sync", yaw_weight=0.2))
    places = np.random.default_rng(7).random((starts, len(problem.space)))
    courses = []
    with cli.shown("sysid and jDE") as progress:
        for seed, start in enumerate(places):
            courses.append(by_sysid(problem, start, threads))
            courses.append(by_jde(problem, start, seed, generations, threads))
            progress(Progress(len(courses), 2 * starts, f"start {seed + 1}"))
    return courses


def sysid_table(courses: list[Course]) -> tuple[Table, list[dict[str, Any]]]:
    """Success and time to reach the same cost, by search; and the same for the file."""
    goal = SLACK * min(course.costs[-1] for course in courses)
    title = f"fit of thesis-lab from {len(courses) // 2} random starts: success is a cost of at most {1e3 * goal:.2f} mm"
    table, document = Table(title=title), []
    for column in ("search", "success", "median time to success [s]", "final costs [mm]", "time in all [s]"):
        table.add_column(column, justify="left" if column == "search" else "right")
    for who in dict.fromkeys(course.who for course in courses):
        mine = [course for course in courses if course.who == who]
        times = [t for course in mine if np.isfinite(t := course.reaches(goal))]
        finals = [course.costs[-1] for course in mine]
        total = sum(course.seconds[-1] for course in mine)
        median = float(np.median(times)) if times else None
        table.add_row(
            who, f"{len(times)} of {len(mine)}", "never" if median is None else f"{median:.1f}",
            ", ".join(f"{1e3 * c:.2f}" for c in finals), f"{total:.0f}",
        )  # fmt: skip
        document.append(
            {
                "search": who,
                "successes": len(times),
                "runs": len(mine),
                "median_s": median,
                "final_costs_m": finals,
                "goal_m": goal,
            }
        )
    return table, document


def main(
    out: Path = Path("runs/benchmarks/fit.json"),
    repeats: int = 15,
    generations: int = 40,
    sysid: bool = True,
    workers: int = 0,
    quick: bool = False,
) -> None:
    """Time fits beside what they cannot do without and beside their peers; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each pair is timed; the fastest counts.
        generations: Generations of the MuJoCo fit by jDE.
        sysid: Compare with mujoco.sysid too (some minutes).
        workers: Threads of the MuJoCo fits; all cores if 0.
        quick: Time small populations once, and searches from one start: a check that everything runs.
    """
    if repeats < 1 or generations < 1 or workers < 0:
        raise cli.UserError("--repeats and --generations must be positive, --workers must not be negative")
    often, population, seeds, starts = (1, 6, 1, 1) if quick else (repeats, 50, 5, STARTS)
    rows = [*rating_rows(often, population), *search_rows(population, seeds)]
    comparison: list[dict[str, Any]] = []

    def beside_sysid() -> list[Row]:
        courses = sysid_courses(1 if quick else generations, workers or os.cpu_count() or 1, starts)
        table, document = sysid_table(courses)
        cli.report_console().print(table)
        comparison.extend(document)
        return []

    if sysid:
        optional(quick, beside_sysid)
    report("benchmarks/fit: ratios of the fastest times, measured side by side", rows, out, sysid=comparison)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.fit")
