"""How good and how fast the search is beside scipy's differential evolution: `python -m benchmarks.de [--out FILE.json]`.

Everybody gets one population, number of generations and list of seeds on functions whose optimum is 0. The median counts: a
run on Rosenbrock may end in its second minimum (3.99). Ours search the unit cube, where rounding leaves 1e-26 on the sphere.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution, rosen

from benchmarks.rows import Row, report
from ssmr.search.jde import Jde, JdeSettings
from ssmr.types import FloatArray
from validation import cli


class Function(NamedTuple):
    """A test function of (S, n) points, its bounds, and what everybody gets to search it with."""

    name: str
    values: Callable[[FloatArray], FloatArray]
    bounds: tuple[float, float]
    generations: int
    n: int = 30
    population: int = 100


FUNCTIONS = (
    Function("sphere", lambda x: np.sum(x * x, axis=1), (-100.0, 100.0), 1500),
    Function("rosenbrock", lambda x: rosen(x.T), (-5.0, 10.0), 3000),
    Function("rastrigin", lambda x: np.sum(x * x + 10.0 * (1.0 - np.cos(2.0 * np.pi * x)), axis=1), (-5.12, 5.12), 5000),
)


def by_ours(f: Function, seed: int) -> float:
    """Return the least cost of a search in the unit cube that runs to the last generation."""
    settings = JdeSettings(f.population, f.generations, patience=f.generations + 1)
    search, (low, high) = Jde(f.n, settings, seed), f.bounds
    while not search.finished:
        search.tell(f.values(low + (high - low) * search.ask()))
    return search.best_cost


def by_scipy(strategy: str, f: Function, seed: int) -> float:
    """Return the least cost of scipy's search, which takes whole generations and is not polished."""
    rng = np.random.default_rng(seed)
    found = differential_evolution(
        lambda x: f.values(x.T), [f.bounds] * f.n, strategy=strategy, maxiter=f.generations, tol=0.0, polish=False,
        init=rng.uniform(*f.bounds, (f.population, f.n)), rng=rng, updating="deferred", vectorized=True,
    )  # fmt: skip
    return float(found.fun)


SEARCHES: dict[str, Callable[[Function, int], float]] = {
    "ours": by_ours,
    "scipy best2bin": partial(by_scipy, "best2bin"),
    "scipy rand1bin": partial(by_scipy, "rand1bin"),
}


def main(out: Path = Path("runs/benchmarks/de.json"), runs: int = 5, quick: bool = False) -> None:
    """Let every search run on every function; print costs and processor times and write them as JSON.

    Args:
        out: JSON file to write.
        runs: Number of seeds.
        quick: Take one seed, five numbers and a hundredth of the generations: a check that everything runs.
    """
    rows = list[Row]()
    for full in FUNCTIONS:
        f = full._replace(n=5, population=20, generations=full.generations // 100) if quick else full
        for name, search in SEARCHES.items():
            began = time.process_time()
            finals = [search(f, seed) for seed in range(1 if quick else max(runs, 1))]
            spent = (time.process_time() - began) / len(finals)
            costs = {"median": float(np.median(finals)), "best": min(finals), "worst": max(finals)}
            rows.append({"function": f.name, "search": name, **costs, "processor_s": spent})
    report("benchmarks/de: final costs, whose optimum is 0, and processor time of a run", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.de")
