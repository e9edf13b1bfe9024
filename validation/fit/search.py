"""Run a search: generations, checkpoints, interruption and progress, for a fit and for a tuning alike."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ssmr.errors import SsmrError
from ssmr.parameters import MOST_SEED, require_within
from ssmr.search.jde import MOST_COST, Crossover, Jde, JdeSettings, Strategy
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation import store
from validation.fit.checkpoint import CheckpointError, damaged, read_arrays, write_arrays
from validation.fit.data import SearchTrace
from validation.fit.executors import costs_by
from validation.fit.refine import Remembered, Residuals, arrivals
from validation.progress import Progress, Report, silent

CHECKPOINT = "checkpoint.npz"
"""Name of the file that programs keep a search's state in."""
MOST_WORKERS = 4096
"""Greatest number of threads that a computation can be asked to use."""
_ANY_SIZE = JdeSettings().population, JdeSettings().generations
_SHOWN_VALUES = 4
"""Number of the best candidate's values in a line of progress."""


Evaluate = Callable[[FloatArray, FloatArray, Callable[[float], object] | None], FloatArray]
"""A function that rates a generation: points, limits and `on_share`, see `SearchProblem.costs`."""


class RefinableProblem(Residuals, Protocol):
    """A problem with residuals and costs."""

    def costs(
        self, points: FloatArray, limits: FloatArray | None, workers: int, on_share: Callable[[float], object] | None
    ) -> FloatArray:
        """Return the (S,) costs, see `SearchProblem.costs`."""
        ...


class SearchProblem(Protocol):
    """Everything that a search needs to know of what is searched."""

    @property
    def space(self) -> ParameterSpace:
        """The parameters with their bounds."""
        ...

    def costs(
        self, points: FloatArray, limits: FloatArray | None, workers: int, on_share: Callable[[float], object] | None
    ) -> FloatArray:
        """Return the (S,) costs of (S, n) points of the unit cube; infinite for one that is impossible or fails.

        Args:
            points: the candidates.
            limits: (S,) costs; a candidate whose partial sum exceeds its limit is abandoned, and that sum is returned.
            workers: number of threads; the result does not depend on it.
            on_share: called, from any thread, with the share of the work that is done.
        """
        ...

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name: a checkpoint belongs to a search of equal identity."""
        ...


@dataclass(frozen=True)
class SearchOptions:
    """Options of the search itself.

    None takes the sizes that are usual for what is searched, no target, every processor, and no checkpoint.
    """

    population: int | None = None
    """Number of candidates in a generation."""
    generations: int | None = None
    """Greatest number of generations after the first population."""
    strategy: Strategy = "best/2"
    """Mutation: best/2 converges fast; rand/1 is slower and leaves local minima."""
    crossover: Crossover = "bin"
    """Crossover: binomial or exponential."""
    df: float = 1e-3
    """The search stops when the best cost improves by no more than this share over `patience` generations."""
    patience: int = 30
    """Number of generations over which the improvement of the cost is judged."""
    target: float | None = None
    """Cost at which the search stops."""
    seed: int = 0
    """Seed of the random numbers; equal seeds give equal results."""
    workers: int | None = None
    """Number of threads; the result does not depend on it."""
    executor: Executor | None = None
    """What rates the candidates of jDE in the place of threads, in `workers` shares: a `ProcessPoolExecutor` that spawns its
    processes, or dask's `client.get_executor(pure=False)`. The result does not depend on it."""
    checkpoint: Path | None = None
    """File in which the search's state is kept after every generation."""
    resume: bool = False
    """Continue from the checkpoint."""

    def __post_init__(self) -> None:
        """Check the numbers that the optimiser's settings do not see, or see only when the work has begun.

        Raises:
            ValueError: a number is out of its range.
        """
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)
        require_within(self, ("workers",), 1, MOST_WORKERS, whole=True)
        require_within(self, ("target",), -MOST_COST, MOST_COST)
        self.settings(*_ANY_SIZE)

    @property
    def threads(self) -> int:
        """Number of threads."""
        return self.workers or os.cpu_count() or 1

    def settings(self, population: int, generations: int) -> JdeSettings:
        """Return the optimiser's settings, with these sizes where none are given.

        Raises:
            ValueError: a number is out of its range.
        """
        usual = {"population": population, "generations": generations, "target": -math.inf}
        chosen = {f.name: getattr(self, f.name) for f in fields(JdeSettings) if hasattr(self, f.name)}
        return JdeSettings(**chosen | {k: v for k, v in usual.items() if chosen[k] is None})

    def record(self, settings: JdeSettings) -> dict[str, Any]:
        """Return what a result file holds of the search's settings."""
        return {k: v for k, v in asdict(settings).items() if k != "target" or self.target is not None}


@dataclass(frozen=True)
class FreeParameters:
    """The numbers that are searched, and their bounds."""

    free: tuple[str, ...] | None = None
    """Names of the parameters to search. None takes the usual ones."""
    fix: Mapping[str, float] = field(default_factory=dict)
    """Values to hold, by name; these parameters are not searched."""
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lower and upper bound of the search, by name; the others have their usual bounds."""


def put_options(given: Mapping[str, Any], *groups: Any) -> tuple[Any, ...]:
    """Return the groups of options with each given option put into the group that has a field of its name.

    Raises:
        TypeError: no group has an option of that name.
    """
    known = [{f.name for f in fields(group)} for group in groups]
    for name in given:
        if not any(name in names for names in known):
            raise TypeError(f"there is no option '{name}'; there are: {', '.join(sorted(set().union(*known)))}")
    return tuple(
        replace(group, **{k: v for k, v in given.items() if k in names}) for group, names in zip(groups, known, strict=True)
    )


@dataclass
class Search:
    """A search under way: the optimiser, and what is remembered of its generations."""

    jde: Jde
    """The optimiser."""
    identity: Mapping[str, str]
    """Digests of all that decides the outcome, by what they are digests of."""
    space: ParameterSpace | None = None
    """The parameters, for progress texts."""
    best_cost: list[float] = field(default_factory=list)
    median_cost: list[float] = field(default_factory=list)
    wall_s: float = 0.0
    """Time that the search took [s], over all its runs."""
    interrupted: bool = False
    starts: int = 0
    """Number of starts of least squares that are to follow the optimiser."""
    driven: Remembered = field(default_factory=Remembered)
    """What least squares have driven after the optimiser."""
    refined: tuple[FloatArray, float] | None = None
    """The best point that least squares found, and its cost; None where they found none that is better."""
    ends: int = 0
    """Number of points at which least squares have ended; each was rated by its cost too."""

    @property
    def best(self) -> FloatArray:
        """(n,) the best point of the unit cube so far."""
        return self.jde.best if self.refined is None else self.refined[0]

    @property
    def best_cost_of_all(self) -> float:
        """Its cost."""
        return self.jde.best_cost if self.refined is None else self.refined[1]

    def run(
        self, evaluate: Evaluate, checkpoint: Path | None = None, progress: Report = silent, most: int | None = None
    ) -> None:
        """Search until a stop rule holds, `most` generations are done or Ctrl-C is pressed; what was found stays.

        The checkpoint is written, and `progress` called with the best candidate, after every generation.
        """
        began, before, rated = time.perf_counter(), self.wall_s, self.jde.evaluations

        def tell(share: float) -> None:
            rate = (self.jde.evaluations - rated) / max(time.perf_counter() - began, 1e-9)
            total = self.jde.settings.generations + 1 + self.starts
            progress(Progress(len(self.best_cost) + share, total, f"{self._best_text()}, {rate:.1f} candidates/s"))

        try:
            while not self.jde.finished and (most is None or len(self.best_cost) <= most):
                costs = evaluate(self.jde.ask(), self.jde.costs, tell)
                self.jde.tell(costs)
                self.remember()
                self.wall_s = before + time.perf_counter() - began
                if checkpoint is not None:
                    self.save(checkpoint)
                tell(0.0)
        except KeyboardInterrupt:
            self.interrupted = True
        self.wall_s = before + time.perf_counter() - began

    def refine(
        self, problem: RefinableProblem, threads: int, checkpoint: Path | None = None, progress: Report = silent
    ) -> None:
        """Go on by least squares: from the best candidate and others far from it, or with one start from the first.

        A search that has reached its target is over.
        """
        began, before = time.perf_counter(), self.wall_s
        if self.jde.finished == "target":
            return
        points, costs, before_all = self.jde.population, self.jde.costs, self.jde.settings.generations + 1
        if self.starts == 1 and np.isfinite(costs[0]):
            points, costs = points[:1], costs[:1]

        def step() -> None:
            self.wall_s = before + time.perf_counter() - began
            if checkpoint is not None:
                self.save(checkpoint)
            text = f"least squares, start {self.ends + 1} of {self.starts}: cost {self.best_cost_of_all:.5g}"
            done, total = before_all + self.ends, before_all + self.starts
            progress(Progress(done, total, f"{text}, {len(self.driven)} motions"))

        try:
            for end in arrivals(problem, points, costs, self.starts, self.driven, threads, step):
                self.ends += 1
                cost = float(problem.costs(end[None], None, threads, None)[0])
                if cost < self.best_cost_of_all:
                    self.refined = end, cost
        except KeyboardInterrupt:
            self.interrupted = True
        self.wall_s = before + time.perf_counter() - began

    def remember(self) -> None:
        """Note the costs of the generation that the optimiser was told last."""
        finite = self.jde.costs[np.isfinite(self.jde.costs)]
        self.best_cost.append(float(self.jde.best_cost))
        self.median_cost.append(float(np.median(finite)) if len(finite) else np.nan)

    def _best_text(self) -> str:
        text = f"cost {self.jde.best_cost:.5g}"
        if self.space is None or not np.isfinite(self.jde.best_cost):
            return text
        values = [f"{n} {v:.4g}" for n, v in zip(self.space.names, self.space.values(self.jde.best), strict=True)]
        return f"{text}: {', '.join(values[:_SHOWN_VALUES])}{', …' * (len(values) > _SHOWN_VALUES)}"

    def save(self, path: Path) -> None:
        """Write a checkpoint, whole or not at all."""
        own = {
            "fit_identity": np.array(json.dumps(dict(self.identity))),
            "fit_versions": np.array(json.dumps(store.versions())),
            "fit_best_cost": np.array(self.best_cost),
            "fit_median_cost": np.array(self.median_cost),
            "fit_wall_s": np.array(self.wall_s),
        }
        if len(self.driven):
            own |= {"lsq_points": np.array(self.driven.points), "lsq_errors": np.array(self.driven.errors)}
        write_arrays(path, {**own, **{f"jde_{k}": v for k, v in self.jde.state().items()}})

    @classmethod
    def load(cls, path: Path, identity: Mapping[str, str]) -> tuple[Search, dict[str, str]]:
        """Return the search of a checkpoint, which must have this identity, and the package versions that it began with.

        Raises:
            CheckpointError: there is none, it is damaged, or it is of another search; the message says what differs.
        """
        data = read_arrays(path)
        try:
            was, versions = (dict(json.loads(str(data[name]))) for name in ("fit_identity", "fit_versions"))
            jde = Jde.restore({k.removeprefix("jde_"): v for k, v in data.items() if k.startswith("jde_")})
            best_cost, median_cost, wall_s = (
                data[f"fit_{name}"].tolist() for name in ("best_cost", "median_cost", "wall_s")
            )
            driven = Remembered(list(data.get("lsq_points", ())), list(data.get("lsq_errors", ())))
        except (LookupError, ValueError, TypeError) as error:
            raise damaged(path, error) from error
        differs = [name for name in identity if was.get(name) != identity[name]]
        if differs:
            raise CheckpointError(
                f"{path} is the checkpoint of another search: it differs in {', '.join(differs)}; "
                "ask for the same search again, or begin anew without resume"
            )
        return cls(jde, identity, None, best_cost, median_cost, wall_s, driven=driven), versions

    def outcome(self) -> dict[str, Any]:
        """Return the fields of a `SearchData` that only the search decides."""
        jde, squares = self.jde, len(self.driven) + self.ends
        return {
            "status": "interrupted" if self.interrupted else "finished",
            "stopped_by": "interrupt" if self.interrupted else ("least squares" if len(self.driven) else jde.finished),
            "cost": float(self.best_cost_of_all),
            "evaluations": jde.evaluations + squares,
            "evaluations_by_stage": {"jde": jde.evaluations, "lsq": squares},
            "generations": jde.generation,
            "wall_s": self.wall_s,
            "trace": SearchTrace(np.array(self.best_cost), np.array(self.median_cost), jde.population, jde.costs),
            "versions": store.versions(),
        }


def search_for(
    problem: SearchProblem,
    settings: JdeSettings,
    options: SearchOptions,
    start: FloatArray | None = None,
    progress: Report = silent,
    starts: int = 0,
) -> Search:
    """Search from the beginning, or from a checkpoint, until a stop rule holds, or Ctrl-C.

    Of so many `starts` of least squares that follow, one needs no generation after the first population.

    The (k, n) `start` are candidates for the first population. The search that is returned has at least one candidate of
    finite cost.

    Raises:
        ValueError: settings that make no sense, or the checkpoint of another search.
        UnusableFolder: the folder of the checkpoint cannot be made or written.
        OSError: the checkpoint cannot be written.
        KeyboardInterrupt: it was interrupted before it found anything.
        SsmrError: every candidate was impossible or failed, or the executor was lost; what was rated before is kept.
    """
    plain = {**problem.identity(), "settings of the search": asdict(settings)}
    plain |= {"start": None if start is None else start.tolist(), "seed": options.seed}
    identity = {name: hashlib.sha256(repr(value).encode()).hexdigest() for name, value in plain.items()}
    search = None
    if options.resume:
        if options.checkpoint is None:
            raise ValueError("resume needs a checkpoint to continue from")
        search = _loaded(options.checkpoint, identity, len(problem.space), settings)
    search = search or Search(Jde(len(problem.space), settings, options.seed, start), identity)
    search.space, search.starts = problem.space, starts
    if options.checkpoint is not None:
        store.make_folder(options.checkpoint.parent)

    def evaluate(points: FloatArray, limits: FloatArray, on_share: Callable[[float], object] | None) -> FloatArray:
        if options.executor is None:
            return problem.costs(points, limits, options.threads, on_share)
        return costs_by(options.executor, options.threads, problem.costs, points, limits)

    try:
        search.run(evaluate, options.checkpoint, progress, 0 if starts == 1 else None)
    except SsmrError as error:
        if options.checkpoint is None or not search.best_cost:
            raise
        kept = f"{len(search.best_cost)} generations are kept in {options.checkpoint}, and resume goes on from there"
        raise SsmrError(f"{error}; {kept}", **error.evidence) from error
    if not np.isfinite(search.jde.best_cost):
        if search.interrupted:
            raise KeyboardInterrupt
        raise SsmrError("every candidate was impossible or failed; change the bounds, or the values that are held")
    return search


def _loaded(checkpoint: Path, identity: Mapping[str, str], n: int, settings: JdeSettings) -> Search | None:
    """Return the search that a checkpoint holds; None where there is no such file."""
    log = logging.getLogger("validation.fit")
    if not checkpoint.is_file():
        log.warning("there is no %s to resume from; the search begins anew", checkpoint)
        return None
    search, versions = Search.load(checkpoint, identity)
    if (search.jde.n, search.jde.settings) != (n, settings):
        raise damaged(checkpoint, ValueError("its population is that of another search"))
    now = store.versions()
    differs = [f"{package} {was}, now {now.get(package)}" for package, was in versions.items() if was != now.get(package)]
    if differs:
        log.warning("the search began with other versions, so its course may differ: %s", "; ".join(differs))
    return search
