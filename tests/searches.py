"""Searches for the friction of robots of MuJoCo, beside each other: `python -m tests.searches`.

Each seed draws a robot and the noise of its sensors (`tests.recovery`), and every search looks for
its friction and the two numbers that hide it most, within the default bounds, from random
candidates of the same seed. A line is printed for each search as soon as it is known;
`python -m tests.searches summary < LINES` makes the table of docs/identification.md of them. CMA-ES
needs the package cmaes, which the project does not.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from ssmr.types import FloatArray
from tests.recovery import drawn, noisy_target
from validation.fit import Fit
from validation.identify.objective import FitCost
from validation.identify.problem import FitProblem
from validation.identify.search import SETTINGS, Method, search_for
from validation.plants.profile import load_profile
from validation.plants.searchable import make_space, with_values

ROBOTS = 10
FREE = ("friction", "com_x", "dc_stiffness")
SECONDS = 4.0
"""Length of the drive, the first bends of trajectory 4 [s]: every search drives it some hundred
times."""
EQUAL = 150
"""Candidates after which all searches are compared: as many as `hybrid` usually takes."""
MOST = 600
"""Greatest number of candidates of any search."""


class Counted(FitProblem):
    """A fit that counts the candidates it drives and keeps the least cost after each."""

    def __init__(self, *given: Any) -> None:
        """Begin to count."""
        super().__init__(*given)
        self.count = 0
        self.trace = list[tuple[int, float, list[float]]]()

    def costs(self, points: FloatArray, *given: Any) -> FloatArray:
        """Return costs, and count them."""
        costs = super().costs(points, *given)
        for point, cost in zip(points, costs, strict=True):
            self.count += 1
            if not self.trace or cost < self.trace[-1][1]:
                self.trace.append((self.count, float(cost), point.tolist()))
        return costs

    def residuals(self, points: FloatArray, *given: Any) -> FloatArray:
        """Return errors, and count the candidates."""
        self.count += len(points)
        return super().residuals(points, *given)

    def after(self, most: float) -> tuple[float, float]:
        """Return the least cost after so many candidates, and its friction."""
        _, cost, point = max((one for one in self.trace if one[0] <= most), key=lambda one: one[0])
        return cost, float(self.space.values(np.array(point))[self.space.names.index("friction")])


def counted_problem(seed: int) -> Counted:
    """Return the fit of a robot that was drawn."""
    base = load_profile("thesis-lab").section("mujoco")
    numbers = drawn(seed)
    base = with_values("mujoco", base, list(numbers), numbers.values())
    space = make_space("mujoco", FREE, {}, base.robot)
    target = noisy_target(numbers, seed, SECONDS)
    return Counted("mujoco", base, space, [target], FitCost(yaw_weight=0.2))


def by_the_program(problem: Counted, seed: int, method: Method, **settings: Any) -> None:
    """Search as `fit` does."""
    chosen = replace(SETTINGS[method][1], **settings)
    asked = Fit("mujoco", "traj4@mujoco", workers=1, seed=seed)
    search_for(problem, chosen, asked, None, method)


def by_scipy(problem: Counted, seed: int) -> None:
    """Search by scipy's differential evolution, without its polish, with its own end."""
    n = len(problem.space)
    differential_evolution(
        lambda points: problem.costs(points.T),
        [(0.0, 1.0)] * n,
        init=np.random.default_rng(seed).random((20, n)),
        maxiter=MOST // 20 - 1,
        rng=seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        tol=1e-3,
    )


def by_cma(problem: Counted, seed: int) -> None:
    """Search by CMA-ES from the middle of the bounds, with its own end."""
    n = len(problem.space)
    cmaes: Any = importlib.import_module("cmaes")
    bounds = np.tile([0.0, 1.0], (n, 1))
    search = cmaes.CMA(mean=np.full(n, 0.5), sigma=0.3, bounds=bounds, seed=seed)
    while problem.count < MOST and not search.should_stop():
        points = np.array([search.ask() for _ in range(search.population_size)])
        search.tell(list(zip(points, problem.costs(points), strict=True)))


WAYS: dict[str, Callable[[Counted, int], None]] = {
    "lsq": partial(by_the_program, method="lsq"),
    "hybrid": partial(by_the_program, method="hybrid"),
    "descents": partial(by_the_program, method="descents"),
    "jde": partial(by_the_program, method="jde", generations=MOST // 20 - 1),
    "jDE, F and CR not lowered": partial(
        by_the_program, method="jde", generations=MOST // 20 - 1, slope=0.0
    ),
    "scipy's differential evolution": by_scipy,
    "CMA-ES": by_cma,
}


def print_summary(lines: list[str]) -> None:
    """Print the table of what the lines say."""
    found = [json.loads(line) for line in lines]
    for name in WAYS:
        own = [one for one in found if one["search"] == name]
        if own:
            equal = [1e3 * one["equal"][0] for one in own]
            end = [1e3 * one["end"][0] for one in own]
            off = [abs(one["end"][1] - one["friction"]) for one in own]
            off_equal = [abs(one["equal"][1] - one["friction"]) for one in own]
            counts = [one["count"] for one in own]
            print(
                f"| {name} | {len(own)} | {median(equal):.3f} | {max(off_equal):.4f} "
                f"| {median(end):.3f}, {min(end):.3f}–{max(end):.3f} | {max(off):.4f} "
                f"| {median(counts):.0f}, {min(counts)}–{max(counts)} |"
            )


def main() -> None:
    """Print a line of what each search finds of each robot."""
    if sys.argv[1:] == ["summary"]:
        print_summary(sys.stdin.readlines())
        return
    names = sys.argv[1:] or list(WAYS)
    for seed in range(ROBOTS):
        for name in names:
            problem = counted_problem(seed)
            WAYS[name](problem, seed)
            line = {
                "seed": seed,
                "search": name,
                "friction": drawn(seed)["friction"],
                "equal": problem.after(EQUAL),
                "end": problem.after(np.inf),
                "count": problem.count,
            }
            print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
