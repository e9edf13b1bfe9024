"""The problem of a fit: points of the unit cube in, costs and errors out.

A cost is a sum over the pieces of all targets, and no term is negative. So a candidate whose sum
over the first pieces exceeds its parent's whole cost can never be selected, and the rest of it need
not be driven: the outcome is the same.

A log may hardly excite some number, which then runs away with its noise. So the horizon objective
has a weak prior: the profile's values, as far off as the bounds allow on average, count as one
block of time with an ordinary error.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from itertools import chain
from typing import Any

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.experiment.sources import RECORDING, Source
from validation.experiment.user_law import add_model_of, model_file
from validation.identify.objective import (
    FitCost,
    Objective,
    make_raters,
    true_motion,
    usual_torque_weight,
)
from validation.plants.kind import PlantProfile, Population
from validation.plants.searchable import find, with_values
from validation.plants.table import plant_kind
from validation.workers import rate_there

OnShare = Callable[[float], object] | None
"""Callback from any thread, with the share of a generation that is rated."""
IGNORANCE = 12.0**-0.5
"""Standard deviation of a number of which only the bounds are known, in the unit cube [1]."""
PRIOR_S = 6.0
"""Time that a deviation of `IGNORANCE` from the profile's value counts as [s]."""
PRIOR_M = 0.05
"""Error of the relative pose that such a deviation counts as in that time [m]."""


class FitProblem:
    """Problem of a fit: candidates of one plant are rated by their distance from true motions."""

    def __init__(
        self,
        model: str,
        base: PlantProfile,
        space: ParameterSpace,
        sources: Sequence[Source],
        cost: FitCost,
    ) -> None:
        """Begin with the numbers of `base`; an objective of None is chosen for the sources.

        Raises:
            ValueError: the sources are too short.
        """
        self.model = model
        self.base = base
        self.space = space
        self.sources = tuple(sources)
        kind = plant_kind(model)
        objective: Objective = "sync" if kind.torques else "path"  # paths do not say when
        if any(source.reference == RECORDING for source in sources):
            objective = "horizon"
        self.cost = replace(cost, objective=cost.objective or objective)
        # torques of planar models are numbers of a fit, and say nothing of a body
        if not kind.torques:
            self.cost = replace(self.cost, torque_weight=0.0)
        elif cost.torque_weight is None:
            told = "friction" in space.names
            weight = usual_torque_weight(base.robot) if told else 0.0
            self.cost = replace(self.cost, torque_weight=weight)
        self._together = kind.together is not None  # one compiled loop drives all candidates
        self._periods: list[float] = []
        pieces = list(chain.from_iterable(source.pieces for source in sources))
        for source in sources:
            self._periods += [source.sample_dt] * len(source.pieces)
        self._raters = make_raters(self.cost, pieces)
        seconds = sum(piece.commands.duration for piece in pieces)
        rows = sum(len(rater.pose_blocks) for rater in self._raters)
        self._priors = 0
        if self.robust:
            # where a robot mostly stands, the median of all errors is one of the data
            most = 2 * rows // (3 * len(space.names))
            # copies as small as other errors
            self._priors = max(1, min(round(seconds / PRIOR_S), most))
        self._prior = PRIOR_M / max(self._priors, 1) * self.robust
        values = np.array([find(model, name, base.robot).read(base) for name in space.names])
        # a value of before may lie outside the bounds; its nearest point is the prior's centre
        self._before = space.points(np.clip(values, space.lower, space.upper)[None])[0]

    def __reduce__(self) -> tuple[Any, ...]:
        """Let the file of a user's own model be run in another process before the rest arrives."""
        return _arriving, (model_file(self.model),), self.__dict__

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name."""
        data = hashlib.sha256()
        for source in self.sources:
            data.update(source.name.rpartition("/")[2].encode(errors="surrogatepass"))
            for piece in source.pieces:
                truth = true_motion(piece)
                arrays = [piece.commands.values, truth.t, truth.pose, piece.headings, piece.torques]
                for array in arrays:
                    if array is not None:
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
        """Return the plant at an (n,) point of the unit cube; None where numbers are impossible."""
        try:
            values = self.space.values(point).tolist()
            return with_values(self.model, self.base, self.space.names, values)
        except ValueError:
            return None

    @property
    def robust(self) -> bool:
        """Whether errors beyond their median count by size, not by square: those of recordings."""
        return self.cost.objective == "horizon"

    @property
    def cheap(self) -> bool:
        """Whether many motions cost little: those of planar models along scenarios."""
        return self._together and self.cost.objective != "horizon"

    @property
    def blocks(self) -> FloatArray:
        """(K,) number of the block of time that each residual belongs to."""
        return np.concatenate([rater.blocks for rater in self._raters])

    @property
    def torques(self) -> bool:
        """Whether torques are compared."""
        return any(rater.torques is not None for rater in self._raters)

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int | str = 1,
        on_share: OnShare = None,
    ) -> FloatArray:
        """Return the (S,) costs of (S, n) points of the unit cube; infinite for a failed one.

        A candidate whose partial sum exceeds its own of (S,) `limits` is abandoned, and that sum is
        returned. The result does not depend on `workers`: threads, or a scheduler's address.
        `on_share` is called with the share of the work that is done.
        """
        bounds = np.full(len(points), np.inf) if limits is None else limits
        if isinstance(workers, str):
            return rate_there(workers, self, "costs", (points, bounds), on_share)
        away = (points - self._before) / IGNORANCE
        seconds = sum(rater.piece.commands.duration for rater in self._raters)
        total = seconds * len(points)
        # a list, which threads can add to
        done = [0.0]

        def rate(population: Population, which: slice, threads: int) -> FloatArray:
            costs = 0.5 * self._prior * (away[which] ** 2).sum(axis=1)
            for rater, dt in zip(self._raters, self._periods, strict=True):
                promising = np.isfinite(costs) & (costs <= bounds[which])
                live = np.flatnonzero((costs == 0.0) | promising)
                if len(live):
                    motions = population.motions(list(live), rater.piece, dt)
                    terms = rater.cost(motions, threads)
                    costs[live] += np.where(np.isfinite(terms), terms, np.inf)
                done[0] += rater.piece.commands.duration * len(costs) / total
                if on_share is not None:
                    on_share(done[0])
            return costs

        return self._side_by_side(rate, points, workers)

    def residuals(self, points: FloatArray, workers: int | str = 1) -> FloatArray:
        """Return (S, K) errors whose squares least squares make small; NaN for an impossible point.

        The `blocks` number the errors of motions; those of the prior follow.
        """
        if isinstance(workers, str):
            return rate_there(workers, self, "residuals", (points,))
        pulls = self._prior * (points - self._before) / IGNORANCE

        def rate(population: Population, which: slice, threads: int) -> FloatArray:
            every = range(which.stop - which.start)
            residuals = []
            for rater, dt in zip(self._raters, self._periods, strict=True):
                motions = population.motions(every, rater.piece, dt)
                residuals.append(rater.residuals(motions, threads))
            residuals.append(np.tile(pulls[which], self._priors))
            return np.concatenate(residuals, axis=1)

        return self._side_by_side(rate, points, workers)

    def _side_by_side(
        self, rate: Callable[[Population, slice, int], FloatArray], points: FloatArray, workers: int
    ) -> FloatArray:
        """Rate (S, n) points, all at once or each on a thread of its own.

        An interrupt drops those that have not begun.
        """
        candidates = [self.candidate(point) for point in points]
        size = len(points) if self._together else 1

        def share(first: int) -> FloatArray:
            which = slice(first, first + size)
            population = plant_kind(self.model).population(candidates[which], workers)
            return rate(population, which, workers if size > 1 else 1)

        # a compiled loop has threads of its own; a simulator's plants are driven side by side
        pool = ThreadPoolExecutor(1 if self._together else workers)
        try:
            return np.concatenate(list(pool.map(share, range(0, len(points), max(size, 1)))))
        finally:
            pool.shutdown(cancel_futures=True)


def _arriving(file: tuple[str, str, str] | None) -> FitProblem:
    if file is not None:
        add_model_of(file)
    return FitProblem.__new__(FitProblem)
