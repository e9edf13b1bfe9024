"""Options of a search, and its course: generations, checkpoints and interruption.

Fits and tunings have these in common.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ssmr.errors import SsmrError
from ssmr.search.jde import Jde, JdeSettings
from ssmr.types import FloatArray, frozen_array
from validation import cli, output
from validation.files.reading import opened
from validation.identify.problem import FitProblem
from validation.identify.refine import (
    STARTS,
    Corrected,
    Remembered,
    descent_ends,
    simplex_end,
)
from validation.identify.tuning import TuneProblem
from validation.output import Document, Progress
from validation.plants.table import SIMULATED

_CHECKPOINT = "checkpoint.npz"
"""Name of the file in the results' folder that keeps a search's state."""
# options that a result file has at other places, or that decide no number
_LEFT_OUT = {
    "model",
    "to",
    "controller",
    "reference",
    "profile",
    "robot",
    "limits",
    "bounds",
    "seed",
    "out",
    "workers",
    "progress",
    "resume",
    "name",
}
# options that are settings of the optimiser
_SIZES = ("population", "generations", "patience")
Method = Literal["jde", "hybrid", "descents", "lsq"]
"""Searches of a fit: differential evolution; a short one, then least squares; least squares from
random starts, then a simplex; or least squares from one start."""
SETTINGS: Mapping[Method, tuple[JdeSettings, JdeSettings]] = {
    "jde": (JdeSettings(50, 300), JdeSettings(20, 90)),
    "hybrid": (JdeSettings(20, 10), JdeSettings(20, 4)),
    "descents": (JdeSettings(20, 1),) * 2,  # of which only the first population is drawn
    "lsq": (JdeSettings(5, 1),) * 2,  # of which only the first candidate is rated
}
"""Usual settings of jDE for planar models (`jde`: Tab. 3.7 of the thesis) and simulated bodies."""
STARTS_OF: Mapping[Method, int] = {"jde": 0, "hybrid": STARTS, "descents": STARTS + 1, "lsq": 1}
"""Greatest number of starts of least squares."""
_SAVED_EVERY = 50
"""Number of candidates of a simplex after which a checkpoint is written."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Searching(cli.Common):
    """Options of a program that searches for numbers."""

    free: Sequence[str] | None = None
    """Numbers to search, separated by commas; the usual ones if not given. A wrong name lists
    all."""
    fix: Mapping[str, float] | str = field(default_factory=dict)
    """Values to hold, such as friction=0.4,com_y=0; these numbers are not searched."""
    bounds: Mapping[str, tuple[float, float]] | str = field(default_factory=dict)
    """Bounds of the search, such as friction=0.2:0.8,delay=0:0.5, where they are not the usual
    ones."""
    population: int | None = None
    """Number of candidates in a generation of differential evolution (jDE); what is usual for the
    plant or the controller if not given."""
    generations: int | None = None
    """Greatest number of generations of jDE after its first population; what is usual for the plant
    or the controller if not given."""
    patience: int | None = None
    """Number of generations over which the best cost must improve by a thousandth, or jDE stops;
    30 if not given."""
    resume: bool = False
    """Continue from the checkpoint in the folder of --out."""
    name: str | None = None
    """Name of the profile or the gain set that is written."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range."""
        super().__post_init__()
        self.settings(JdeSettings())

    @property
    def raters(self) -> int | str:
        """Number of threads that rate candidates, or a scheduler's address."""
        return self.workers or os.cpu_count() or 1

    @property
    def checkpoint(self) -> Path | None:
        """File in the folder `out` that keeps the search's state; None without a folder."""
        return None if self.out is None else Path(self.out) / _CHECKPOINT

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        result = "profile.toml" if self.folder().parts[1] == "fit" else "gains.toml"
        return (*super().writes(), result, _CHECKPOINT)

    def settings(self, usual: JdeSettings) -> JdeSettings:
        """Return the optimiser's settings: the usual ones, with the sizes that are given.

        Raises:
            ValueError: a setting is out of its range.
        """
        given = {name: getattr(self, name) for name in _SIZES}
        return replace(usual, **{name: size for name, size in given.items() if size is not None})

    def chosen(self, settings: JdeSettings) -> Document:
        """Return the options that decide numbers, with the sizes that the search had."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _LEFT_OUT}
        return values | {name: getattr(settings, name) for name in _SIZES}


def usual_search(o: Searching, problem: FitProblem) -> Method:
    """Return the search of a fit that names none (docs/identification.md compares them)."""
    if o.population is not None or o.generations is not None:
        return "jde"
    # many motions of a simulated body, one after the other, would take long
    is_path = problem.cost.objective == "path" and problem.model not in SIMULATED
    return "descents" if is_path else "hybrid"


@dataclass
class Search:
    """A search under way: the optimiser, and the state of its stages."""

    jde: Jde
    """The optimiser."""
    identity: Mapping[str, str]
    """Digests of all that decides the outcome, by name."""
    checkpoint: Path | None = None
    """File that the state is written to after every generation."""
    method: Method = "jde"
    """What it is made of."""
    wall_s: float = 0.0
    """Time that the search took [s], over all its runs."""
    interrupted: bool = False
    """Whether Ctrl-C ended it."""
    driven: Remembered = field(default_factory=Remembered)
    """Errors of all candidates that least squares have driven after the optimiser."""
    coarser: FitProblem | None = None
    """The problem with a longer physics step; None where all candidates have the profile's."""
    refined: tuple[FloatArray, float] | None = None
    """The best point that least squares found, and its cost; None where they found none that is
    better."""
    ends: int = 0
    """Number of points at which least squares have ended; each was rated by its cost too."""
    rated: Remembered = field(default_factory=Remembered)
    """Costs of all candidates of simplices, by their points."""

    @property
    def starts(self) -> int:
        """Greatest number of starts of least squares that follow the optimiser."""
        return STARTS_OF[self.method]

    @property
    def best(self) -> FloatArray:
        """(n,) the best point of the unit cube so far."""
        if self.refined is None:
            return self.jde.best
        return self.refined[0]

    @property
    def cost(self) -> float:
        """Its cost."""
        if self.refined is None:
            return float(self.jde.best_cost)
        return self.refined[1]

    @property
    def by_stage(self) -> dict[str, int]:
        """Number of candidates that each stage rated."""
        least_squares = len(self.driven) + self.ends
        return {
            "jde": 1 if self.method == "lsq" else self.jde.evaluations,
            "lsq": least_squares,
            "simplex": len(self.rated),
        }

    @property
    def evaluations(self) -> int:
        """Number of candidates that were rated."""
        return sum(self.by_stage.values())

    @property
    def stopped_by(self) -> str:
        """`generations`, `improvement`, `least squares`, `simplex` or `interrupt`."""
        if self.interrupted:
            return "interrupt"
        if self.rated:
            return "simplex"
        if self.driven:
            return "least squares"
        return self.jde.finished

    def evolve(self, problem: FitProblem | TuneProblem, o: Searching) -> None:
        """Go on with differential evolution until a stop rule holds or Ctrl-C is pressed.

        What was found stays. The checkpoint is written, and the best candidate shown as progress,
        after every generation. Some searches need its first population alone.
        """
        began = time.perf_counter()
        before = self.jde.evaluations

        def tell(share: float) -> None:
            rate = (self.jde.evaluations - before) / max(time.perf_counter() - began, 1e-9)
            total = self.jde.settings.generations + 1 + self.starts
            text = "rates the first candidates"
            if rate:
                text = f"cost {self.jde.best_cost:.5g}, {rate:.1f} candidates/s"
            o.progress(Progress(len(self.jde.history) + share, total, text))

        with self._timed() as save:
            draws = self.method in ("descents", "lsq")
            while not (self.jde.finished or (draws and len(self.jde.history))):
                points = self.jde.ask()
                costs = np.full(len(points), np.inf)
                # least squares begin at the user's candidate, be it the best or not
                rated = slice(1 if self.method == "lsq" else None)
                costs[rated] = problem.costs(points[rated], self.jde.costs[rated], o.raters, tell)
                self.jde.tell(costs)
                save()
                tell(0.0)

    def take_longer_steps(self, problem: FitProblem, workers: int | str) -> None:
        """Rate candidates with a longer physics step where the problem allows it."""
        coarser = problem.coarser()
        if coarser is not None:
            rate = partial(coarser.residuals, workers=workers)
            memory = Corrected(rate, partial(problem.residuals, workers=workers))
            memory.update(self.driven)
            self.driven = memory
            self.coarser = coarser

    def refine(self, problem: FitProblem, o: Searching) -> None:
        """Go on by least squares, from the best candidate and others far from it, and a simplex.

        With a longer physics step errors are corrected where each descent begins, and costs of ends
        are those of the profile's step.
        """
        before = self.jde.settings.generations + 1

        with self._timed() as save:

            def step() -> None:
                save()
                start = f"least squares, start {self.ends + 1} of {self.starts}"
                text = f"{start}: cost {self.cost:.5g}, {len(self.driven)} motions"
                o.progress(Progress(before + self.ends, before + self.starts, text))

            rough = self.coarser or problem
            if rough is not problem:
                best = self.jde.best
                self.refined = best, float(problem.costs(best[None], None, o.raters)[0])
            ends = descent_ends(
                rough,
                self.jde.population,
                self.jde.costs,
                self.starts,
                self.driven,
                workers=o.raters,
                on_step=step,
            )
            for end in ends:
                self.ends += 1
                # least squares see errors alone; the cost decides between ends
                cost = float(problem.costs(end[None], None, o.raters)[0])
                if cost < self.cost:
                    self.refined = end, cost

            if self.method == "descents":
                simplex_end(partial(self._cost_at, problem, o, save), self.best)
            self.driven.correct(self.best)

    def _cost_at(
        self, problem: FitProblem, o: Searching, save: Callable[[], object], point: FloatArray
    ) -> float:
        """Return the cost of a simplex's (n,) candidate, which is rated once and kept if best."""

        def rate(new: FloatArray) -> FloatArray:
            if len(self.rated) % _SAVED_EVERY == 0:
                save()
                total = self.jde.settings.generations + 1 + self.starts
                text = f"simplex: cost {self.cost:.5g}, {len(self.rated)} candidates"
                o.progress(Progress(total, total, text))
            return problem.costs(new, None, o.raters)[:, None]

        cost = float(self.rated.look_up(point[None], rate)[0, 0])
        if cost < self.cost:
            self.refined = point.copy(), cost
        return cost

    @contextlib.contextmanager
    def _timed(self) -> Iterator[Callable[[], None]]:
        """Count the time of a stage, which Ctrl-C ends; the function given writes a checkpoint."""
        # the clock at which the search would have begun without interruptions
        zero = time.perf_counter() - self.wall_s

        def save() -> None:
            self.wall_s = time.perf_counter() - zero
            if self.checkpoint is not None:
                self.save(self.checkpoint)

        try:
            yield save
        except KeyboardInterrupt:
            self.interrupted = True
        self.wall_s = time.perf_counter() - zero

    def save(self, path: Path) -> None:
        """Write a checkpoint, whole or not at all."""
        arrays = {
            "identity": np.array(json.dumps(dict(self.identity))),
            "wall_s": np.array(self.wall_s),
            **{f"jde_{name}": value for name, value in self.jde.state().items()},
        }
        for name, memory in (("lsq", self.driven), ("simplex", self.rated)):
            if len(memory):
                arrays[f"{name}_points"] = np.array([np.frombuffer(point) for point in memory])
                arrays[f"{name}_errors"] = np.array(list(memory.values()))
        output.write_atomic(
            path, lambda temporary: np.savez(temporary, allow_pickle=False, **arrays)
        )

    @classmethod
    def load(cls, path: Path, identity: Mapping[str, str]) -> Search:
        """Return the search of a checkpoint of this identity.

        Raises:
            ValueError: the file is damaged, or of another search; the message names the difference.
        """
        try:
            with opened(path) as content, np.load(content, allow_pickle=False) as file:
                data = dict(file)
            was = dict(json.loads(str(data["identity"])))
            state = {
                name.removeprefix("jde_"): value
                for name, value in data.items()
                if name.startswith("jde_")
            }
            jde = Jde.restore(state)
            wall_s = float(frozen_array(data["wall_s"], "wall_s", ()))
            memories = []
            for name in ("lsq", "simplex"):
                points = [point.tobytes() for point in data.get(f"{name}_points", ())]
                errors = data.get(f"{name}_errors", ())
                memories.append(Remembered(zip(points, errors, strict=True)))
        except Exception as error:  # a damaged file may raise anything
            raise ValueError(
                f"{path} is no checkpoint of a search, or it is damaged ({str(error)[:100]!a})"
            ) from error
        if differs := [name for name in identity if was.get(name) != identity[name]]:
            raise ValueError(
                f"{path} is the checkpoint of another search: it differs in {', '.join(differs)}; "
                "ask for the same search again, or begin anew without resume"
            )
        driven, rated = memories
        return cls(jde, identity, driven=driven, rated=rated, wall_s=wall_s)


def search_for(
    problem: FitProblem | TuneProblem,
    settings: JdeSettings,
    o: Searching,
    start: FloatArray | None = None,
    method: Method = "jde",
) -> Search:
    """Search by a method, whose differential evolution has some settings; return what was found.

    It is begun anew or goes on from a checkpoint, and ends by a stop rule or by Ctrl-C. The (k, n)
    `start` are candidates for the first population.

    Raises:
        ValueError: settings that make no sense, or the checkpoint of another search.
        OSError: the checkpoint cannot be written.
        KeyboardInterrupt: it was interrupted before it found anything.
        SsmrError: every candidate was impossible or failed.
    """
    plain = {**problem.identity(), "settings of the search": asdict(settings)}
    plain |= {"start": None if start is None else start.tolist(), "seed": o.seed, "search": method}
    identity = {
        name: hashlib.sha256(repr(value).encode()).hexdigest() for name, value in plain.items()
    }
    search = Search(Jde(len(problem.space), settings, o.seed, start), identity)
    if o.resume and o.checkpoint is None:
        raise ValueError("resume needs the folder out, with a checkpoint to continue from")
    if o.checkpoint is not None:
        output.make_folder(o.checkpoint.parent)
        if o.resume and o.checkpoint.is_file():
            search = Search.load(o.checkpoint, identity)
        elif o.resume:
            _log.warning("there is no %s to resume from; the search begins anew", o.checkpoint)
    search.method = method
    search.checkpoint = o.checkpoint
    # candidates that differential evolution alone rates have the profile's step
    if search.starts and isinstance(problem, FitProblem):
        search.take_longer_steps(problem, o.raters)
    search.evolve(search.coarser or problem, o)
    if not math.isfinite(search.jde.best_cost):
        if search.interrupted:
            raise KeyboardInterrupt
        raise SsmrError(
            "every candidate was impossible or failed; "
            "change the bounds, or the values that are held"
        )
    if search.starts and not search.interrupted and isinstance(problem, FitProblem):
        search.refine(problem, o)
    return search
