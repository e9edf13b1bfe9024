"""The problem of a fit: points of the unit cube in, costs and errors out.

A cost is a sum over the pieces of all targets, and no term is negative. So a candidate whose sum
over the first pieces exceeds its parent's whole cost can never be selected, and the rest of it need
not be driven: the outcome is the same.

A log may hardly excite some number, which then runs away with its noise. So the horizon objective
has a weak prior: the profile's values, as far off as the bounds allow on average, count as one
block of time with a usual error.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.bench.sources import RECORDING, Piece
from validation.identify.objective import (
    FitCost,
    FitTarget,
    Objective,
    Rater,
    TorqueRater,
    make_raters,
    make_torque_raters,
)
from validation.plants.kind import PlantProfile, Population
from validation.plants.searchable import find, with_values
from validation.plants.table import plant_kind

OnShare = Callable[[float], object] | None
"""Callback from any thread, with the share of a generation that is rated."""


IGNORANCE = 12.0**-0.5
"""Standard deviation of a number of which only the bounds are known, in the unit cube [1]."""
PRIOR_S = 6.0
PRIOR_M = 0.05
"""Time [s] and error of the relative pose [m] that a deviation of `IGNORANCE` from the profile's
value counts as."""


class RatedPiece(NamedTuple):
    """One piece of motion with what rates candidates along it."""

    piece: Piece
    """Commands, start and stamps."""
    dt: float
    """Period at which plants are sampled [s]."""
    poses: Rater
    """Rater of poses."""
    torques: TorqueRater | None
    """Rater of torques; None where they are not compared."""

    @property
    def blocks(self) -> FloatArray:
        """(K,) number of the block of time of each residual."""
        return np.concatenate([r.blocks for r in (self.poses, self.torques) if r is not None])

    def cost(self, motions: FloatArray, workers: int) -> FloatArray:
        """Return (S,) terms of the cost of (S, M, 3 or 5) motions, see `Population.motions`."""
        terms = self.poses.cost(motions[..., :3], workers)
        return terms if self.torques is None else terms + self.torques.cost(motions[..., 3:])

    def residuals(self, motions: FloatArray, workers: int) -> FloatArray:
        """Return (S, K) residuals of (S, M, 3 or 5) motions."""
        errors = self.poses.residuals(motions[..., :3], workers)
        if self.torques is None:
            return errors
        return np.hstack([errors, self.torques.residuals(motions[..., 3:])])


class FitProblem:
    """Problem of a fit: candidates of one plant are rated by how well they make the targets' motions."""

    def __init__(
        self,
        model: str,
        base: PlantProfile,
        space: ParameterSpace,
        targets: Sequence[FitTarget],
        cost: FitCost,
    ) -> None:
        """Begin with `base`; the targets choose an objective of None, and a ValueError says that they are too short."""
        self.model = model
        self.base = base
        self.space = space
        self.targets = tuple(targets)
        kind = plant_kind(model)
        usual: Objective = "sync" if kind.torques else "path"  # paths do not say when
        if any(target.source.reference == RECORDING for target in targets):
            usual = "horizon"
        self.cost = replace(cost, objective=cost.objective or usual)
        if not kind.torques:
            self.cost = replace(self.cost, torque_weight=0.0)
        self._together = kind.together  # one compiled loop drives all candidates
        pieces = [piece for target in self.targets for piece in target.source.pieces]
        periods = [t.source.sample_dt for t in self.targets for _ in t.source.pieces]
        raters = make_raters(self.cost, targets), make_torque_raters(self.cost, targets)
        self._pieces = list(map(RatedPiece, pieces, periods, *raters))
        seconds = sum(rated.piece.commands.duration for rated in self._pieces)
        rows = sum(len(rated.poses.blocks) for rated in self._pieces)
        # where a robot mostly stands, the median of all errors is one of the data
        most = 2 * rows // (3 * len(space.names))
        # copies as small as other errors
        self._priors = max(1, min(round(seconds / PRIOR_S), most)) if self.robust else 0
        self._prior = PRIOR_M / max(self._priors, 1) * self.robust
        values = np.array([find(model, name, base.robot).read(base) for name in space.names])
        self._usual = space.points(np.clip(values, space.lower, space.upper)[None])[0]

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name."""
        data = hashlib.sha256()
        for target in self.targets:
            data.update(target.label.rpartition("/")[2].encode(errors="surrogatepass"))
            for piece, truth in zip(target.source.pieces, target.truth, strict=True):
                for array in (piece.commands.values, truth.t, truth.pose):
                    data.update(np.ascontiguousarray(array).tobytes())
            for array in target.torques or ():
                data.update(np.ascontiguousarray(array).tobytes())
            data.update(
                b"".join(heading.tobytes() for heading in (target.gyro.late if target.gyro else ()))
            )
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
        try:
            return with_values(
                self.model, self.base, self.space.names, self.space.values(point).tolist()
            )
        except ValueError:
            return None

    @property
    def robust(self) -> bool:
        """Whether errors beyond their median count by their size, and not by its square: those of recordings."""
        return self.cost.objective == "horizon"

    @property
    def cheap(self) -> bool:
        """Whether many motions cost little: those of planar models along scenarios."""
        return self._together and self.cost.objective != "horizon"

    @property
    def blocks(self) -> FloatArray:
        """(K,) number of the block of time that each residual belongs to."""
        return np.concatenate([rated.blocks for rated in self._pieces])

    @property
    def torques(self) -> bool:
        """Whether torques are compared."""
        return any(rated.torques is not None for rated in self._pieces)

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int = 1,
        on_share: OnShare = None,
    ) -> FloatArray:
        """Return the (S,) costs of (S, n) points of the unit cube; infinite for one that is impossible or fails.

        A candidate whose partial sum exceeds its own of (S,) `limits` is abandoned, and that sum is
        returned. The result does not depend on the number of threads, `workers`. `on_share` is
        called with the share of the work that is done.
        """
        bounds = np.full(len(points), np.inf) if limits is None else limits
        away = (points - self._usual) / IGNORANCE
        seconds = [rated.piece.commands.duration for rated in self._pieces]
        total = sum(seconds) * len(points)
        done = [0.0]

        def rate(population: Population, which: slice, threads: int) -> FloatArray:
            costs = 0.5 * self._prior * (away[which] ** 2).sum(axis=1)
            for rated in self._pieces:
                live = np.flatnonzero(
                    (costs == 0.0) | (np.isfinite(costs) & (costs <= bounds[which]))
                )
                if len(live):
                    motions = population.motions(list(live), rated.piece, rated.dt)
                    terms = rated.cost(motions, threads)
                    costs[live] += np.where(np.isfinite(terms), terms, np.inf)
                done[0] += rated.piece.commands.duration * len(costs) / total
                if on_share is not None:
                    on_share(done[0])
            return costs

        return self._side_by_side(rate, points, workers)

    def residuals(self, points: FloatArray, workers: int = 1) -> FloatArray:
        """Return (S, K) errors whose squares add up to what least squares make small; NaN for one that is impossible.

        The `blocks` number the errors of motions; those of the prior follow.
        """
        pulls = self._prior * (points - self._usual) / IGNORANCE

        def rate(population: Population, which: slice, threads: int) -> FloatArray:
            every = range(which.stop - which.start)
            residuals = [
                rated.residuals(population.motions(every, rated.piece, rated.dt), threads)
                for rated in self._pieces
            ]
            return np.concatenate([*residuals, np.tile(pulls[which], self._priors)], axis=1)

        return self._side_by_side(rate, points, workers)

    def _side_by_side(
        self, rate: Callable[[Population, slice, int], FloatArray], points: FloatArray, workers: int
    ) -> FloatArray:
        """Rate (S, n) points: all at once, or each on a thread of its own; an interrupt drops those that have not begun."""
        candidates = [self.candidate(point) for point in points]
        size = len(points) if self._together else 1

        def share(first: int) -> FloatArray:
            which = slice(first, first + size)
            population = plant_kind(self.model).population(candidates[which], workers)
            return rate(population, which, workers if size > 1 else 1)

        pool = ThreadPoolExecutor(1 if self._together else workers)
        try:
            return np.concatenate(list(pool.map(share, range(0, len(points), max(size, 1)))))
        finally:
            pool.shutdown(cancel_futures=True)
