"""The problem of a fit: points of the unit cube in, costs out.

A cost is a sum over the pieces of all targets, and no term is negative. So a candidate whose sum over the first pieces
exceeds its parent's whole cost can never be selected, and the rest of it need not be driven: the outcome is the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from typing import TypeVar

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.identify.objective import FitCost, FitTarget, make_raters
from validation.plants.kind import PlantProfile, Population
from validation.plants.searchable import with_values
from validation.plants.table import plant_kind

_T = TypeVar("_T")


class FitProblem:
    """A `SearchProblem`: how well candidates of one plant make the targets' motions."""

    def __init__(
        self, model: str, base: PlantProfile, space: ParameterSpace, targets: Sequence[FitTarget], cost: FitCost
    ) -> None:
        """Prepare the scoring windows of a fit that begins with the numbers of `base`; targets choose an objective of None.

        Raises:
            ValueError: the sources are too short for the cost.
        """
        self.model, self.base, self.space, self.targets = model, base, space, tuple(targets)
        recorded = any(target.source.reference == "recording" for target in self.targets)
        self.cost = replace(cost, objective=cost.objective or ("horizon" if recorded else "path"))
        self._raters = make_raters(self.cost, self.targets)

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name."""
        data = hashlib.sha256()
        for target in self.targets:
            data.update(target.label.rpartition("/")[2].encode(errors="surrogatepass"))
            for piece, truth in zip(target.source.pieces, target.truth, strict=True):
                for array in (piece.commands.values, truth.t, truth.pose):
                    data.update(np.ascontiguousarray(array).tobytes())
        return {
            "model": self.model,
            "parameters or bounds": self.space.limits(),
            "profile": self.base.numbers(),
            "robot": self.base.robot.as_document(),
            "objective": asdict(self.cost),
            "sources": data.hexdigest(),
        }

    def candidate(self, point: FloatArray) -> PlantProfile | None:
        """Return the plant that an (n,) point of the unit cube stands for; None where its numbers are impossible."""
        return self.candidates(point[None])[0]

    def candidates(self, points: FloatArray) -> list[PlantProfile | None]:
        """Return the plants that (S, n) points of the unit cube stand for; None for numbers that are impossible."""
        found: list[PlantProfile | None] = []
        for values in self.space.values(points).tolist():
            try:
                found.append(with_values(self.model, self.base, self.space.names, values))
            except ValueError:
                found.append(None)
        return found

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int = 1,
        on_share: Callable[[float], object] | None = None,
    ) -> FloatArray:
        """Rate candidates, see `SearchProblem.costs`."""
        candidates = self.candidates(points)
        bounds = np.full(len(points), np.inf) if limits is None else limits
        done = [0.0]

        def tell(share: float) -> None:
            done[0] += share
            if on_share is not None:
                on_share(done[0])

        def rate(which: Sequence[int]) -> FloatArray:
            population = plant_kind(self.model).population([candidates[i] for i in which], workers)
            threads = workers if len(which) > 1 else 1  # each of single candidates has a thread already
            return self._costs_of(population, bounds[np.array(which)], threads, lambda s: tell(s * len(which) / len(points)))

        costs = np.empty(len(points))
        for which, found in self._side_by_side(rate, len(points), workers):
            costs[which] = found
        return costs

    def _costs_of(
        self, population: Population, limits: FloatArray, threads: int, tell: Callable[[float], object]
    ) -> FloatArray:
        """Drive a population piece by piece and return its costs; `tell` gets the share of each piece when it is done."""
        costs = np.zeros(len(limits))
        total = sum(piece.commands.duration for target in self.targets for piece in target.source.pieces)
        for target, raters in zip(self.targets, self._raters, strict=True):
            for piece, rater in zip(target.source.pieces, raters, strict=True):
                live = np.flatnonzero((costs == 0.0) | (np.isfinite(costs) & (costs <= limits)))
                if len(live):
                    terms = rater.cost(population.poses(list(live), piece, target.source.sample_dt), threads)
                    costs[live] += np.where(np.isfinite(terms), terms, np.inf)
                tell(piece.commands.duration / total)
        return costs

    def _side_by_side(self, work: Callable[[Sequence[int]], _T], size: int, workers: int) -> list[tuple[Sequence[int], _T]]:
        """Let `work` do the shares of `size` candidates; an interrupt drops those that have not begun."""
        together = plant_kind(self.model).together  # its compiled loop is itself spread over the workers
        parts = [list(range(size))] if together else [[i] for i in range(size)]
        pool = ThreadPoolExecutor(1 if together else workers)
        try:
            return list(zip(parts, pool.map(work, parts), strict=True))
        finally:
            pool.shutdown(cancel_futures=True)

    @property
    def robust(self) -> bool:
        """Return whether errors beyond their median count by their size, and not by its square: those of recordings."""
        return self.cost.objective == "horizon"

    @property
    def cheap(self) -> bool:
        """Return whether many motions cost little: those of planar models along scenarios."""
        return plant_kind(self.model).together and self.cost.objective != "horizon"

    @property
    def blocks(self) -> FloatArray:
        """(K,) number of the block of time that each residual belongs to."""
        return np.concatenate([rater.blocks for raters in self._raters for rater in raters])

    def residuals(self, points: FloatArray, workers: int = 1) -> FloatArray:
        """Return (S, K) errors whose squares add up to what least squares make small; NaN for one that is impossible."""
        candidates = self.candidates(points)

        def drive_all(which: Sequence[int]) -> FloatArray:
            population = plant_kind(self.model).population([candidates[i] for i in which], workers)
            threads = workers if len(which) > 1 else 1
            found = [
                rater.residuals(population.poses(range(len(which)), piece, target.source.sample_dt), threads)
                for target, raters in zip(self.targets, self._raters, strict=True)
                for piece, rater in zip(target.source.pieces, raters, strict=True)
            ]
            return np.concatenate(found, axis=1)

        return np.concatenate([found for _, found in self._side_by_side(drive_all, len(points), workers)])
