"""A search under way: generations, checkpoints, interruption, progress. What is searched for is its callers' business."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from rich.progress import Progress as Bar

from ssmr.search.jde import Jde, JdeSettings
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation import cli, store
from validation.fit.result import FitTrace

LOG_EVERY_S = 10.0
"""Where standard error is no terminal, a line of progress appears this often [s]."""
CHECKPOINT = "checkpoint.npz"


class CheckpointError(ValueError):
    """A checkpoint that cannot be read, or belongs to another search."""


class Evaluate(Protocol):
    """Whatever rates a generation: this process, or a cluster."""

    def __call__(self, points: FloatArray, limits: FloatArray, on_progress: Callable[[float], object] | None) -> FloatArray:
        """(S, n) points and (S,) limits -> (S,) costs, see `Problem.costs`."""
        ...


@dataclass
class Progress:
    """What the search tells while it runs."""

    generation: int = 0
    """Completed ones."""
    share: float = 0.0
    """Of the present one that is done."""
    best_cost: float = np.inf
    """Least yet."""
    best: FloatArray = field(default_factory=lambda: np.empty(0))
    """(n,) the candidate that has it, in the unit cube."""
    evaluations: int = 0
    """Candidates rated."""
    wall_s: float = 0.0
    """Since the fit began, over all its runs [s]."""


@dataclass
class Search:
    """A search under way: the optimiser and what is remembered of its generations."""

    jde: Jde
    identity: Mapping[str, str]
    """Digests of all that decides the outcome, by what they are of."""
    best_cost: list[float] = field(default_factory=list)
    median_cost: list[float] = field(default_factory=list)
    best: list[FloatArray] = field(default_factory=list)
    wall_s: float = 0.0
    interrupted: bool = False

    def run(
        self,
        evaluate: Evaluate,
        checkpoint: Path | None = None,
        on_progress: Callable[[Progress], object] | None = None,
    ) -> None:
        """Search until a stop rule holds or Ctrl-C is pressed; either way what was found stays.

        Args:
            evaluate: rates a generation.
            checkpoint: file to write after every generation.
            on_progress: told how far it is.
        """
        began, before = time.perf_counter(), self.wall_s
        try:
            while not self.jde.finished:

                def tell(share: float) -> None:
                    if on_progress is not None:
                        on_progress(self._progress(share, before + time.perf_counter() - began))

                costs = evaluate(self.jde.ask(), self.jde.costs, tell)
                self.jde.tell(costs)
                self._remember()
                self.wall_s = before + time.perf_counter() - began
                if checkpoint is not None:
                    self.save(checkpoint)
                tell(0.0)
        except KeyboardInterrupt:
            self.interrupted = True
        self.wall_s = before + time.perf_counter() - began

    def _remember(self) -> None:
        finite = self.jde.costs[np.isfinite(self.jde.costs)]
        self.best_cost.append(float(self.jde.best_cost))
        self.median_cost.append(float(np.median(finite)) if len(finite) else np.nan)
        self.best.append(self.jde.best)

    def _progress(self, share: float, wall_s: float) -> Progress:
        best = self.jde.best if np.isfinite(self.jde.best_cost) else np.empty(0)
        return Progress(len(self.best_cost), share, float(self.jde.best_cost), best, self.jde.evaluations, wall_s)

    def save(self, path: Path) -> None:
        """Write a checkpoint, whole or not at all."""
        own = {
            "fit_identity": np.array(json.dumps(dict(self.identity))),
            "fit_versions": np.array(json.dumps(store.versions())),
            "fit_best_cost": np.array(self.best_cost),
            "fit_median_cost": np.array(self.median_cost),
            "fit_best": np.array(self.best),
            "fit_wall_s": np.array(self.wall_s),
        }
        state = {f"jde_{k}": v for k, v in self.jde.state().items()}
        store.write_atomic(path, lambda temporary: np.savez(temporary, allow_pickle=False, **own, **state))

    @classmethod
    def load(cls, path: Path, identity: Mapping[str, str]) -> tuple[Search, dict[str, str]]:
        """Continue from a checkpoint.

        Args:
            path: the file.
            identity: what the fit asked for now is; the checkpoint must be of the same.

        Returns:
            The search, and the versions that it began with.

        Raises:
            CheckpointError: no checkpoint, a damaged one, or that of another fit; the message says what differs.
        """
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                data = {name: file[name] for name in file.files}
            was = json.loads(str(data["fit_identity"]))
            differs = [name for name in identity if was.get(name) != identity[name]]
            if differs:
                raise CheckpointError(
                    f"{path} is the checkpoint of another fit: it differs in {', '.join(differs)}; "
                    "ask for the same again, or leave out --resume to begin anew"
                )
            jde = Jde.restore({k.removeprefix("jde_"): v for k, v in data.items() if k.startswith("jde_")})
            search = cls(
                jde,
                identity,
                list(data["fit_best_cost"]),
                list(data["fit_median_cost"]),
                list(data["fit_best"]),
                float(data["fit_wall_s"]),
            )
            return search, json.loads(str(data["fit_versions"]))
        except CheckpointError:
            raise
        except Exception as error:  # a damaged archive fails in many ways, all of which mean the same
            raise CheckpointError(f"{path} is no checkpoint of a fit, or a damaged one ({str(error)[:100]!a})") from error

    def trace(self) -> FitTrace:
        """How it went."""
        return FitTrace(
            np.array(self.best_cost), np.array(self.median_cost), np.array(self.best), self.jde.population, self.jde.costs
        )


def begin(
    checkpoint: Path,
    who: Mapping[str, str],
    size: int,
    settings: JdeSettings,
    seed: int,
    first: FloatArray | None,
    resume: bool,
) -> Search:
    """A new search, or the one that a checkpoint holds.

    Args:
        checkpoint: the file.
        who: digests of all that decides the outcome, by what they are of.
        size: how many parameters there are.
        settings: of the optimiser.
        seed: of the optimiser.
        first: (k, n) candidates for the first population.
        resume: whether to continue from the file.

    Raises:
        ValueError: settings that make no sense, or the checkpoint of another search.
    """
    if not resume:
        return Search(Jde(size, settings, seed, first), who)
    if not checkpoint.is_file():
        cli.warn(f"there is no {checkpoint} to resume from; the search begins anew")
        return Search(Jde(size, settings, seed, first), who)
    search, versions = Search.load(checkpoint, who)
    now = store.versions()
    differs = [f"{package} {was}, now {now.get(package)}" for package, was in versions.items() if was != now.get(package)]
    if differs:
        cli.warn(f"the search began with other versions, so its course may differ: {'; '.join(differs)}")
    return search


@contextlib.contextmanager
def shown(space: ParameterSpace, settings: JdeSettings) -> Iterator[Callable[[Progress], None]]:
    """A progress bar on a terminal, a line every few seconds elsewhere: generation, cost, best values, speed."""
    bar: Bar = cli.progress()
    began, last, first = time.perf_counter(), [time.perf_counter()], [-1]

    def show(progress: Progress) -> None:
        if first[0] < 0:
            first[0] = progress.evaluations
        rate = (progress.evaluations - first[0]) / max(time.perf_counter() - began, 1e-9)
        text = f"cost {progress.best_cost:.5g}"
        if len(progress.best):
            values = space.values(progress.best)
            few = ", ".join(f"{n} {v:.4g}" for n, v in list(zip(space.names, values, strict=True))[:4])
            text += f"  {few}{', …' if len(space) > 4 else ''}  {rate:.1f}/s"
        bar.update(task, completed=progress.generation + progress.share, description=text)
        if bar.disable and time.perf_counter() - last[0] > LOG_EVERY_S:
            last[0] = time.perf_counter()
            left = (
                (settings.generations + 1 - progress.generation - progress.share)
                / max(progress.generation + progress.share, 1e-9)
                * progress.wall_s
            )
            done = f"generation {max(progress.generation - 1, 0)} of {settings.generations}"
            print(f"{done}  {text}  at most {left:.0f} s left", file=sys.stderr, flush=True)

    with bar:
        task = bar.add_task("first generation", total=settings.generations + 1)
        yield show
