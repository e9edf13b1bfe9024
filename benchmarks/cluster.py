"""What a second machine brings: `python -m benchmarks.cluster [--out FILE.json]` (extra `cluster`).

Worker processes of one thread each take the place of machines. Per generation of a fit, and for a study of many surfaces
(docs/examples/surfaces.py): one worker against two, and one worker against this process, which shows what the cluster costs.
"""

from __future__ import annotations

import importlib
import itertools
import logging
import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numba
import numpy as np

from benchmarks.fit import LAB_FREE, problem_of
from benchmarks.rows import MissingError, Row, alternate, at_least, optional, report
from validation import cli
from validation.fit.cluster import Cluster
from validation.fit.objective import FitCost
from validation.fit.problem import FitProblem

POPULATION = 24
SURFACES = Path(__file__).resolve().parents[1] / "docs" / "examples" / "surfaces.py"


SHORT_S = 0.5
"""What takes this process less needs no cluster [s]."""
Call = Callable[[], object]


def rows_of(what: str, here: Call, one: Call, two: Call, repeats: int) -> list[Row]:
    """One worker against this process, and one against two; tasks of a few milliseconds are only for the record."""
    t_here, t_one, t_two = alternate(here, one, two, repeats=repeats)
    return [
        at_least(f"{what}: this process, one thread, over one worker", t_one, t_here),
        at_least(f"{what}: one worker over two", t_two, t_one, 1.6 if t_here > SHORT_S else None),
    ]


def generation_rows(clients: tuple[Any, Any], problem: FitProblem, population: int, repeats: int) -> list[Row]:
    """Time a generation of a fit."""
    points = np.random.default_rng(0).random((population, len(problem.space)))
    limits = np.full(population, np.inf)
    with ExitStack() as stack:
        one, two = (stack.enter_context(Cluster(c.scheduler.address, problem)) for c in clients)
        what = f"generation of {population}, {problem.model} on traj4"
        return rows_of(
            what, lambda: problem.costs(points, limits), lambda: one(points, limits), lambda: two(points, limits), repeats
        )


def surface_rows(clients: tuple[Any, Any], repeats: int) -> list[Row]:
    """The example's surfaces, one task each."""
    example = _example()
    surfaces = list(itertools.product(example.FRICTIONS, example.TERRAINS))
    for client in clients:
        client.upload_file(str(SURFACES))
    columns = list(zip(*surfaces, strict=True))

    def spread(client: Any) -> Callable[[], object]:
        return lambda: client.gather(client.map(example.one_surface, *columns, pure=False))

    def here() -> object:
        return [example.one_surface(*surface) for surface in surfaces]

    return rows_of(f"{len(surfaces)} surfaces", here, spread(clients[0]), spread(clients[1]), repeats)


def _example() -> ModuleType:
    """The example as a module that workers can import by the same name."""
    import sys

    sys.path.insert(0, str(SURFACES.parent))
    return importlib.import_module(SURFACES.stem)


def measure(sizes: tuple[int, int], repeats: int, quick: bool) -> list[Row]:
    """Time everything over two clusters of as many worker processes as `sizes` says.

    Raises:
        MissingError: dask.distributed is not installed.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise MissingError("dask.distributed is not installed: pip install 'ssmr-testbed[cluster]'") from error
    logging.getLogger("distributed").setLevel(logging.WARNING)
    options = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    planar = problem_of("improved", "traj4@mujoco", ("u_x", "mu_s", "mu_d", "gain"), FitCost("path"))
    with ExitStack() as stack:
        one, two = (stack.enter_context(Client(stack.enter_context(LocalCluster(n_workers=n, **options)))) for n in sizes)
        if quick:
            return generation_rows((one, two), planar, 4, 1)
        husky = problem_of("mujoco", "traj4@improved", LAB_FREE, FitCost("sync"))
        rows = [row for p in (husky, planar) for row in generation_rows((one, two), p, POPULATION, repeats)]
        return rows + surface_rows((one, two), max(1, repeats // 2))


def main(repeats: int = 3, out: Path = Path("runs/benchmarks/cluster.json"), quick: bool = False) -> None:
    """Measure what a second worker brings.

    Args:
        repeats: Number of times that each is measured; the fastest counts.
        out: JSON file to write.
        quick: Time one small generation once: a check that everything runs.
    """
    numba.set_num_threads(1)
    rows = optional(quick, lambda: measure((1, 2), repeats, quick)) or []
    report("What a second worker brings", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.cluster")
