"""Two rules for F and CR of jDE beside each other: `python -m benchmarks.draws [--out FILE.json] [--tasks functions|fits]`.

- Ours: F within [0.1, 0.9] as Tab. 3.7 bounds it; F and CR belong to the vector, so a trial that loses takes its own along.
- Printed: F drawn as F_min + F_max rand, up to 1.0; F and CR go on from generation to generation whether or not the trial
  wins, as the equations of Sec. 3.5.1 read without the sentence before them.

Everything else is the thesis': best/2/bin, the descent, Tab. 3.7. Equal budgets and equal seeds, no early stop. Quartiles of
the final cost and a two-sided Mann-Whitney test say whether one is better. Rastrigin is asked twice, since the printed rule
lets CR descend: then genes change one by one, which pays only where they do not depend on each other.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.table import Table
from scipy.stats import mannwhitneyu

from benchmarks.de import FUNCTIONS, Function, rastrigin
from ssmr.control.loop import LoopSettings
from ssmr.search.jde import Jde, JdeSettings
from ssmr.types import FloatArray
from validation import cli, store
from validation.fit.objective import FitCost
from validation.fit.problem import FitProblem
from validation.fit.targets import FitSources, open_targets
from validation.plants.filters import odometry_of
from validation.plants.profile import load_profile
from validation.plants.searchable import make_space
from validation.plants.table import plant_kind
from validation.track.gains import load_gains
from validation.track.loops import make_robot
from validation.track.waypoint_files import open_reference
from validation.tune.cost import TuneCost
from validation.tune.problem import TuneCase, TuneProblem, make_tuning_space

SIGNIFICANT = 0.05
"""Below this probability of a difference as great by chance one rule is called better."""
SIZES = ((6, 40), (6, 300), (10, 300))
"""Dimensions and generations of the functions."""
_ROTATION_SEED = 7


class PrintedJde(Jde):
    """The printed rule; its settings must let F reach F_min + F_max."""

    def tell(self, costs: object) -> None:
        """Select as ever, and keep the F and CR of every trial."""
        super().tell(costs)  # type: ignore[arg-type]
        self._f, self._cr = self._trial_f, self._trial_cr


RULES: dict[str, tuple[type[Jde], tuple[float, float]]] = {"ours": (Jde, (0.1, 0.9)), "printed": (PrintedJde, (0.1, 1.0))}
"""Search and bounds of F by rule."""


@dataclass(frozen=True)
class Task:
    """Something to minimise."""

    name: str
    """The name by which tables show it."""
    n: int
    """Number of parameters."""
    population: int
    """Vectors in a generation."""
    generations: int
    """Generations after the first population."""
    costs: Callable[[FloatArray, FloatArray], FloatArray]
    """(S, n) points of the unit cube and (S,) limits, above which a lower bound will do -> (S,) costs."""


@dataclass(frozen=True)
class Comparison:
    """Final costs of both rules."""

    task: str
    """The name of the task that was searched."""
    finals: dict[str, tuple[float, ...]]
    """By rule, one for each seed."""
    p: float
    """Probability of such a difference by chance."""

    @property
    def better(self) -> str:
        """The rule of the lower median if the difference is significant, else a dash."""
        low = min(self.finals, key=lambda rule: float(np.median(self.finals[rule])))
        return low if self.p < SIGNIFICANT else "–"


def rotated_rastrigin(n: int) -> Function:
    """Rastrigin's function in axes that are turned at random: its genes depend on each other."""
    turn, _ = np.linalg.qr(np.random.default_rng(_ROTATION_SEED).normal(size=(n, n)))
    return Function("rastrigin, rotated", lambda x: rastrigin(x @ turn), (-5.12, 5.12), 0)


def function_tasks(share: float) -> list[Task]:
    """The functions of benchmarks.de in few dimensions, with the thesis' population."""

    def task(function: Function, n: int, generations: int) -> Task:
        low, high = function.bounds
        name = f"{function.name}, {n}-D, 50 × {generations}"
        return Task(name, n, 50, max(1, round(share * generations)), lambda x, _: function.values(low + (high - low) * x))

    return [task(f, n, generations) for n, generations in SIZES for f in (*FUNCTIONS, rotated_rastrigin(n))]


def fit_tasks(share: float) -> list[Task]:
    """Two fits of models and a tuning of gains, with budgets that a user would wait for."""
    lab, tasks = load_profile("thesis-lab"), list[Task]()
    for model, source in (("improved", "traj4@mujoco"), ("linear", "traj4@improved")):
        space = make_space(model, plant_kind(model).free["scenario"], {}, lab.robot)
        fitted = FitProblem(model, lab.plants[model], space, open_targets((source,), lab, FitSources())[0], FitCost("path"))
        name = f"{model} to {source}, {len(space)}-D, 50 × 40"
        tasks.append(Task(name, len(space), 50, max(1, round(share * 40)), fitted.costs))
    gains = make_tuning_space("pid", None, False, {}, {})
    robot, (label, waypoints) = make_robot(lab, "improved"), open_reference("generic", 0.25)
    loop = LoopSettings(filter=odometry_of(robot.drive))
    case = TuneCase(label, label, waypoints, robot, loop)
    tuned = TuneProblem(lab, load_gains("pid", "published"), gains, [case], TuneCost(guard=0.0, seeds=(0,), k_u=0.0))
    tasks.append(Task(f"gains of the PID, {len(gains)}-D, 30 × 40", len(gains), 30, max(1, round(share * 40)), tuned.costs))
    return tasks


def final_cost(task: Task, rule: str, seed: int) -> float:
    """Search to the last generation."""
    kind, bounds = RULES[rule]
    g = task.generations
    search = kind(task.n, JdeSettings(task.population, g, f_bounds=bounds, patience=g + 1), seed)
    while not search.finished:
        limits = search.costs
        search.tell(task.costs(search.ask(), limits))
    return search.best_cost


def compare(task: Task, seeds: int) -> Comparison:
    """Let both rules search with the same seeds."""
    finals = {rule: tuple(final_cost(task, rule, seed) for seed in range(seeds)) for rule in RULES}
    return Comparison(task.name, finals, float(mannwhitneyu(finals["ours"], finals["printed"]).pvalue))


def comparison_table(found: list[Comparison], seeds: int) -> Table:
    """Medians and quartiles, for the terminal."""
    table = Table(title=f"benchmarks/draws: final cost, median (quartiles) of {seeds} seeds; better: p < {SIGNIFICANT:g}")
    for column in ("task", *RULES, "p", "better"):
        table.add_column(column, justify="left" if column == "task" else "right")
    for c in found:
        quartiles = [np.percentile(c.finals[rule], (50.0, 25.0, 75.0)) for rule in RULES]
        table.add_row(c.task, *("{:.3g} ({:.3g}–{:.3g})".format(*q) for q in quartiles), f"{c.p:.2g}", c.better)
    return table


def main(
    out: Path = Path("runs/benchmarks/draws.json"),
    tasks: Literal["functions", "fits", "all"] = "functions",
    seeds: int = 25,
    quick: bool = False,
) -> None:
    """Search with both rules; print medians, quartiles and p, and write the final costs as JSON.

    Args:
        out: JSON file to write.
        tasks: The functions of benchmarks.de (some seconds), or fits and a tuning (minutes), or all.
        seeds: Number of searches of each rule.
        quick: Take three seeds and a twentieth of the generations: a check that everything runs.
    """
    if seeds < 3:
        raise cli.UserError("--seeds must be at least 3")
    share = 0.05 if quick else 1.0
    seeds = 3 if quick else seeds
    chosen = [*(function_tasks(share) if tasks != "fits" else []), *(fit_tasks(share) if tasks != "functions" else [])]
    found = [compare(task, seeds) for task in chosen]
    cli.report_console().print(comparison_table(found, seeds))
    document = {
        "schema": "ssmr.benchmark/1",
        "versions": store.versions(),
        "seeds": seeds,
        "rows": [asdict(c) | {"better": c.better} for c in found],
    }
    cli.output_folder(out.parent)
    store.write_json(out, document)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.draws")
