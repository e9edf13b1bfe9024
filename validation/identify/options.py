"""Options that a fit and a tuning share."""

from __future__ import annotations

import os
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import tyro

from ssmr.parameters import MOST_SEED, require_within
from ssmr.search.jde import JdeSettings
from validation import cli

CHECKPOINT = "checkpoint.npz"
"""Name of the file in the folder of the results that a search's state is kept in."""
_LEFT_OUT = {
    *("model", "to", "controller", "references", "profile", "robot", "limits", "bounds", "seed"),
    *("out", "workers", "progress", "executor", "resume", "name"),
}  # options that a result file has at other places, or that decide no number
MOST_WORKERS = 4096
"""Greatest number of threads that a search can be told to use."""


@dataclass(frozen=True, kw_only=True)
class Searching(cli.Common):
    """Options of a program that searches for numbers."""

    free: Annotated[cli.Names | None, cli.option(metavar="NAME,...", default="the usual ones")] = None
    """Numbers to search, separated by commas. A wrong name lists all."""
    fix: Annotated[cli.Values, cli.option(default="none")] = field(default_factory=dict)
    """Values to hold, such as friction=0.4,com_y=0; these numbers are not searched."""
    bounds: Annotated[cli.Bounds, cli.option(default="the usual ones")] = field(default_factory=dict)
    """Bounds of the search, such as friction=0.2:0.8,delay=0:0.5."""
    population: Annotated[cli.Count, cli.option(default="what is usual for the plant or the controller")] = None
    """Number of candidates in a generation of differential evolution (jDE)."""
    generations: Annotated[cli.Count, cli.option(default="what is usual for the plant or the controller")] = None
    """Greatest number of generations of jDE after its first population."""
    patience: Annotated[int, cli.option(metavar="N")] = 30
    """Number of generations over which the best cost must improve by a thousandth, or jDE stops."""
    resume: cli.Flag = False
    """Continue from the checkpoint in the folder of --out."""
    name: Annotated[str | None, cli.option(metavar="NAME", default="that of what it began with, and what was done")] = None
    """Name of the profile or the gain set that is written."""
    executor: Annotated[Executor | None, tyro.conf.Suppress, tyro.conf.Fixed] = None
    """What rates the candidates of jDE in the place of threads, in `workers` shares: a `ProcessPoolExecutor` that spawns its
    processes, or dask's `client.get_executor(pure=False)`. The result does not depend on it."""

    def __post_init__(self) -> None:
        """Check the numbers, before any work.

        Raises:
            ValueError: a number is out of its range.
        """
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)
        require_within(self, ("workers",), 1, MOST_WORKERS, whole=True)
        self.settings(JdeSettings.population, JdeSettings.generations)

    @property
    def threads(self) -> int:
        """Number of threads."""
        return self.workers or os.cpu_count() or 1

    @property
    def checkpoint(self) -> Path | None:
        """File in the folder `out` in which the search's state is kept; None where no folder is named."""
        return None if self.out is None else self.out / CHECKPOINT

    def settings(self, population: int, generations: int) -> JdeSettings:
        """Return the optimiser's settings, with these sizes where none are given.

        Raises:
            ValueError: a number is out of its range.
        """
        size = population if self.population is None else self.population
        return JdeSettings(size, generations if self.generations is None else self.generations, patience=self.patience)

    def chosen(self, settings: JdeSettings) -> dict[str, Any]:
        """Return the options that result files hold: those that decide numbers, with the sizes that the search had."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _LEFT_OUT}
        return {**values, "population": settings.population, "generations": settings.generations}
