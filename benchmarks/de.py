"""How good and how fast the search is, beside its peers: `python -m benchmarks.de [--out FILE.json]`.

Four functions in 30 dimensions, from one population size and one number of generations, hence evaluations, for everybody;
no early stop. Ours search the unit cube; pygmo and scipy the box itself.

- Ours: `best/2` with CR in [0.5, 1], 0.9 at first, since on Rosenbrock genes that depend upon each other must change
  together, and `rand/1` with CR in [0, 1]; both without the descent (slope 0), all else as `JdeSettings` has it. The thesis'
  own settings, with the descent, stand beside them for the record, and so does its printed rule for F and CR.
- pygmo's sade with jDE's adaptation, best/2/bin and rand/1/bin, calls Python for each vector. The same algorithm on pygmo's
  compiled functions, where it has them, shows what that costs, and is cheap enough for as many runs as ours.
- scipy's differential_evolution, best2bin, on the whole generation at once.

Runs differ in their seeds, and on Rosenbrock much: the function has a second minimum (3.98662 in 30 dimensions), where
about a fifth of the best/2 runs end, ours and pygmo's alike (9 of 45 and 17 of 93), and the rest is anywhere between
1e-29 and 1e-5. So medians are taken, and pygmo's runs of one algorithm are pooled over both ways of calling the function.
A count of 15 says little about how often the second minimum is met.

The settings of our best/2 were chosen on Rosenbrock, with other seeds; they make it worse on Rastrigin and Ackley, which
are rand/1's. On Rosenbrock 30 fresh seeds gave a median of 2e-20 with them, 4e-12 with CR in [0, 1] from 0.8, and 9 with
the thesis' descent as well. CPU times are judged among searches that call
the numpy function; pygmo on its compiled ones needs less than ours.

The floor: a coordinate near the middle of the unit cube is rounded to 1e-16, so in a box of width w it is off by 1e-16 w.
On the sphere (w = 200) that costs up to 30 (2e-14)^2, some 1e-26, and on Rosenbrock (w = 15), curved a thousand times as
much, about as much. What is at or below 1e-25 is therefore zero for a search in the cube, and counts as 1e-25 in ratios,
for peers alike. Ackley's values themselves are rounded at 4e-15; no floor is applied there.
"""

from __future__ import annotations

import importlib
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import ArrayLike
from rich.table import Table
from scipy.optimize import differential_evolution

from benchmarks.rows import MissingError, optional
from ssmr.search.jde import Jde, JdeSettings
from ssmr.types import FloatArray
from validation import cli, store

FLOOR = 1e-25
"""At or below this a cost is the optimum (module's head)."""
WITHIN = 10.0
"""Ours over the best peer's median: an order of magnitude."""
PYGMO = {"best/2/bin": 9, "rand/1/bin": 7}
"""Numbers of sade's variants."""


@dataclass(frozen=True)
class Function:
    """A test function, whose optimum is 0."""

    name: str
    """What it is called."""
    values: Callable[[FloatArray], FloatArray]
    """(..., n) points -> (...) values."""
    bounds: tuple[float, float]
    """Of every coordinate."""
    generations: int
    """What everybody gets after the initial population."""


def sphere(x: FloatArray) -> FloatArray:
    """Sum of x^2."""
    return np.sum(x * x, axis=-1)


def rosenbrock(x: FloatArray) -> FloatArray:
    """Sum of 100 (x_k+1 - x_k^2)^2 + (1 - x_k)^2."""
    a, b = x[..., :-1], x[..., 1:]
    return np.sum(100.0 * (b - a * a) ** 2 + (1.0 - a) ** 2, axis=-1)


def rastrigin(x: FloatArray) -> FloatArray:
    """Sum of x^2 + 10 (1 - cos 2 pi x)."""
    return np.sum(x * x + 10.0 * (1.0 - np.cos(2.0 * np.pi * x)), axis=-1)


def ackley(x: FloatArray) -> FloatArray:
    """20 (1 - exp(-0.2 rms x)) + e - exp(mean cos 2 pi x)."""
    root, wave = np.sqrt(np.mean(x * x, axis=-1)), np.mean(np.cos(2.0 * np.pi * x), axis=-1)
    return 20.0 + math.e - 20.0 * np.exp(-0.2 * root) - np.exp(wave)


FUNCTIONS = (
    Function("sphere", sphere, (-100.0, 100.0), 1500),
    Function("rosenbrock", rosenbrock, (-5.0, 10.0), 3000),
    Function("rastrigin", rastrigin, (-5.12, 5.12), 5000),
    Function("ackley", ackley, (-15.0, 30.0), 1500),
)

OURS = {
    "ours best/2": JdeSettings(strategy="best/2", slope=0.0, cr_bounds=(0.5, 1.0), cr_init=0.9),
    "ours rand/1": JdeSettings(strategy="rand/1", slope=0.0),
}
"""Our two strategies."""
RECORD = {"ours best/2, thesis' settings": JdeSettings()}


class PrintedJde(Jde):
    """The printed rule for F and CR (Sec. 3.5.1): they go on from generation to generation whether or not their trial wins.

    Its settings must let F reach F_min + F_max.
    """

    def tell(self, costs: ArrayLike) -> None:
        """Select as ever, and keep the F and CR of every trial."""
        super().tell(costs)
        self._f, self._cr = self._trial_f, self._trial_cr


PRINTED = JdeSettings(f_bounds=(0.1, 1.0))
"""The thesis' settings with F drawn as F_min + F_max rand."""


@dataclass(frozen=True)
class Row:
    """One contestant on one function."""

    function: str
    """Which."""
    contestant: str
    """Whose search."""
    finals: tuple[float, ...]
    """Final cost of each run, less the optimum."""
    cpu_s: float
    """Mean CPU time of a run [s]."""

    @property
    def median(self) -> float:
        """Of the finals."""
        return float(np.median(self.finals))


@dataclass(frozen=True)
class Verdict:
    """The better of ours against the best peer on one function."""

    function: str
    """Which."""
    ours: str
    """The better of our two."""
    peer: str
    """The peer of least median."""
    cost_ratio: float
    """Ours over the peer's median, both raised to the floor."""
    fastest: str
    """The peer of least CPU time that calls the same Python function."""
    cpu_ratio: float
    """CPU time of the slower of our two over that peer's."""
    ok: bool
    """Whether both bounds are kept."""


def timed(search: Callable[[int], float], runs: int) -> tuple[tuple[float, ...], float]:
    """Final costs with the seeds 0, 1, ... and the mean CPU time [s]."""
    began = time.process_time()
    finals = tuple(search(seed) for seed in range(runs))
    return finals, (time.process_time() - began) / runs


def run_ours(function: Function, settings: JdeSettings, n: int, population: int, seed: int, kind: type[Jde] = Jde) -> float:
    """One search in the unit cube, to the last generation."""
    g = function.generations
    search = kind(n, replace(settings, population=population, generations=g, patience=g + 1), seed)
    low, high = function.bounds
    while not search.finished:
        search.tell(function.values(low + (high - low) * search.ask()))
    return search.best_cost


class _PygmoProblem:
    """A function as pygmo wants it: one vector at a time."""

    def __init__(self, function: Function, n: int) -> None:
        self.function, self.n = function, n

    def fitness(self, x: FloatArray) -> list[float]:
        """Value at (n,) x."""
        return [float(self.function.values(x))]

    def get_bounds(self) -> tuple[list[float], list[float]]:
        """Of every coordinate."""
        low, high = self.function.bounds
        return [low] * self.n, [high] * self.n


def run_pygmo(pg: Any, problem: Any, variant: int, generations: int, population: int, seed: int) -> float:
    """One search by sade, which stops at the last generation only."""
    algorithm = pg.algorithm(pg.sade(gen=generations, variant=variant, variant_adptv=1, ftol=0.0, xtol=0.0, seed=seed))
    return float(algorithm.evolve(pg.population(problem, population, seed=seed)).champion_f[0])


def run_scipy(function: Function, n: int, population: int, seed: int) -> float:
    """One search by scipy, best2bin on whole generations, not polished."""
    rng = np.random.default_rng(seed)
    low, high = function.bounds
    found = differential_evolution(
        lambda x: function.values(x.T), [function.bounds] * n, strategy="best2bin", maxiter=function.generations, tol=0.0,
        rng=rng, polish=False, init=rng.uniform(low, high, (population, n)), updating="deferred", vectorized=True,
    )  # fmt: skip
    return float(found.fun)


def compiled_problem(pg: Any, function: Function, n: int) -> Any:
    """Pygmo's own problem of this name, or None where it has none or one of other bounds."""
    maker = getattr(pg, function.name, None)
    if maker is None:
        return None
    problem = pg.problem(maker(n))
    low, high = problem.get_bounds()
    return problem if (low[0], high[0]) == function.bounds else None


def _elsewhere(search: Callable[[int], float], seed: int) -> float:
    """With seeds of its own, since runs of one algorithm are pooled."""
    return search(1000 + seed)


def measure(pg: Any, function: Function, n: int, population: int, runs: int, fast_runs: int) -> list[Row]:
    """Let all contestants search on one function; `pg` is pygmo, or None where it is not installed."""
    searches: list[tuple[str, int, Callable[[int], float]]] = [
        (name, fast_runs, partial(run_ours, function, settings, n, population)) for name, settings in (OURS | RECORD).items()
    ]
    printed = partial(run_ours, function, PRINTED, n, population, kind=PrintedJde)
    searches.append(("ours best/2, printed rule for F and CR", fast_runs, printed))
    if pg is not None:
        searches += pygmo_searches(pg, function, n, population, runs, fast_runs)
    searches.append(("scipy best2bin", runs, partial(run_scipy, function, n, population)))
    return [Row(function.name, name, *timed(search, count)) for name, count, search in searches]


def pygmo_searches(
    pg: Any, function: Function, n: int, population: int, runs: int, fast_runs: int
) -> list[tuple[str, int, Callable[[int], float]]]:
    """Return pygmo's contestants: name, number of runs, and a search by seed."""
    searches: list[tuple[str, int, Callable[[int], float]]] = []
    problem, compiled = pg.problem(_PygmoProblem(function, n)), compiled_problem(pg, function, n)
    g = function.generations
    for name, number in PYGMO.items():
        searches.append((f"pygmo {name}", runs, partial(run_pygmo, pg, problem, number, g, population)))
        if compiled is not None:
            run = partial(run_pygmo, pg, compiled, number, g, population)
            searches.append((f"pygmo {name}, compiled function", fast_runs, partial(_elsewhere, run)))
    return searches


def judge(rows: Sequence[Row]) -> Verdict:
    """The rows of one function -> whether ours keep up."""
    pooled: dict[str, list[float]] = {}
    for row in rows:
        pooled.setdefault(row.contestant.removesuffix(", compiled function"), []).extend(row.finals)
    medians = {name: max(FLOOR, float(np.median(finals))) for name, finals in pooled.items()}
    ours = min(OURS, key=lambda name: medians[name])
    peers = {name: value for name, value in medians.items() if not name.startswith("ours")}
    peer = min(peers, key=lambda name: peers[name])
    cpu = {row.contestant: row.cpu_s for row in rows}
    fastest = min(peers, key=lambda name: cpu[name])
    cost_ratio, cpu_ratio = medians[ours] / peers[peer], max(cpu[name] for name in OURS) / cpu[fastest]
    ok = cost_ratio <= WITHIN and cpu_ratio <= 1.0
    return Verdict(rows[0].function, ours, peer, cost_ratio, fastest, cpu_ratio, ok)


def _shown(cost: float) -> str:
    return f"{cost:.1e}{' *' if cost <= FLOOR else ''}"


def row_table(rows: Sequence[Row]) -> Table:
    """Every contestant, for the terminal."""
    table = Table(title=f"benchmarks/de: final cost less the optimum (* at or below {FLOOR:g}: zero, but for rounding)")
    for column in ("function", "search", "runs", "median", "best", "worst", "CPU a run [s]"):
        table.add_column(column, justify="left" if column in ("function", "search") else "right")
    for row in rows:
        costs = [_shown(c) for c in (row.median, min(row.finals), max(row.finals))]
        table.add_row(row.function, row.contestant, str(len(row.finals)), *costs, f"{row.cpu_s:.2f}")
    return table


def verdict_table(verdicts: Sequence[Verdict]) -> Table:
    """The ratios, for the terminal."""
    table = Table(title=f"ours / peer: median cost, asked <= {WITHIN:g}; CPU of our slower one / fastest peer, asked <= 1")
    for column in ("function", "ours", "best peer", "cost ratio", "fastest peer", "CPU ratio", ""):
        table.add_column(column, justify="right" if "ratio" in column else "left")
    for v in verdicts:
        verdict = "ok" if v.ok else "FALLS SHORT"
        table.add_row(v.function, v.ours, v.peer, f"{v.cost_ratio:.2g}", v.fastest, f"{v.cpu_ratio:.2g}", verdict)
    return table


def import_pygmo() -> Any:
    """Return pygmo.

    Raises:
        MissingError: it is not installed.
    """
    try:
        return importlib.import_module("pygmo")
    except ImportError as error:
        raise MissingError("pygmo is not installed; install this project with the extra 'bench'") from error


def main(
    out: Path = Path("runs/benchmarks/de.json"),
    dimensions: int = 30,
    population: int = 100,
    runs: int = 3,
    fast_runs: int = 15,
    quick: bool = False,
) -> None:
    """Let every search run on every function; print costs, CPU times and ratios and write them as JSON.

    Args:
        out: JSON file to write.
        dimensions: Number of coordinates of the functions.
        population: Vectors in a generation, for everybody.
        runs: Seeds of the slow peers: scipy, and pygmo where it calls Python.
        fast_runs: Seeds of ours, and of pygmo on compiled functions.
        quick: Take one seed, five dimensions and a hundredth of the generations: a check that everything runs.
    """
    if dimensions < 2 or population < 7 or runs < 1 or fast_runs < 1:
        raise cli.UserError("--dimensions must be at least 2, --population 7, --runs and --fast-runs 1")
    if quick:
        dimensions, population, runs, fast_runs = 5, 20, 1, 1
    pg = optional(quick, import_pygmo)
    functions = [replace(f, generations=f.generations // 100) if quick else f for f in FUNCTIONS]
    results = [measure(pg, function, dimensions, population, runs, fast_runs) for function in functions]
    verdicts = [judge(rows) for rows in results]
    rows = [row for part in results for row in part]
    console = cli.report_console()
    console.print(row_table(rows))
    console.print(verdict_table(verdicts))
    document: dict[str, Any] = {
        "schema": "ssmr.benchmark/1",
        "versions": store.versions() | ({"pygmo": pg.__version__} if pg is not None else {}),
        "dimensions": dimensions,
        "population": population,
        "generations": {f.name: f.generations for f in functions},
        "floor": FLOOR,
        "rows": [asdict(row) | {"median": row.median} for row in rows],
        "verdicts": [asdict(v) for v in verdicts],
    }
    cli.output_folder(out.parent)
    store.write_json(out, document)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.de")
