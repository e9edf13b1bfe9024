"""Measure what planar fits cost in one version of this project; `benchmarks.fit` starts this process for each version.

It is run with the version's sources on PYTHONPATH and takes all that it times from there, by names that every version since
1.0 has. A line of standard input asks, a line of standard output answers, both in JSON.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

CANDIDATES = 50
"""Candidates of a generation: the population of Tab. 3.7."""


def processor_s(work: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    began = time.process_time()
    work()
    return time.process_time() - began


class Planar:
    """A fit of a planar model to trajectory 4 as MuJoCo drives it, with the profile of the lab."""

    def __init__(self, model: str, free: list[str]) -> None:
        """Prepare the problem and one generation of candidates."""
        self._version: Any = importlib.import_module("benchmarks.fit")
        cost = getattr(self._version, "FitCost", None) or self._version.CostSettings
        self._problem = self._version.problem_of(model, "traj4@mujoco", tuple(free), cost("path"))
        self._points, plants = self._version.candidates_of(self._problem, CANDIDATES)
        self._models = [self._version.PlanarModel(p.parameters, p.vehicle, p.drive) for p in plants]
        self._commands = self._problem.targets[0].source.pieces[0].commands

    def simulate(self) -> None:
        """Drive the candidates, and no more."""
        starts = [self._version.State()] * len(self._models)
        self._version.run_population(self._models, self._commands, starts, self._version.SAMPLE_DT)

    def rate(self) -> None:
        """Rate the candidates: build, drive and compare them."""
        self._problem.costs(self._points, workers=1)

    def fit(self, generations: int) -> None:
        """Search by jDE."""
        v = self._version
        settings = v.JdeSettings(population=CANDIDATES, generations=generations, patience=1000)
        search = v.Search(v.Jde(len(self._problem.space), settings, 0), {})
        search.run(lambda points, limits, on_share: self._problem.costs(points, limits, 1))


def main() -> None:
    """Answer every question with processor times a candidate [s] of simulating it, of its whole cost, and of a fit."""
    known: dict[str, Planar] = {}
    for line in sys.stdin:
        asked = json.loads(line)
        if asked["model"] not in known:
            planar = known[asked["model"]] = Planar(asked["model"], asked["free"])
            planar.fit(1)
            planar.simulate()
        planar, generations = known[asked["model"]], asked["generations"]
        times = {
            "simulating": processor_s(planar.simulate) / CANDIDATES,
            "rated": processor_s(planar.rate) / CANDIDATES,
            "fit": processor_s(lambda: planar.fit(generations)) / (CANDIDATES * (1 + generations)),  # noqa: B023
        }
        print(json.dumps(times), flush=True)


if __name__ == "__main__":
    main()
