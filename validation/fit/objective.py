"""How far a candidate's motion lies from the truth, as one number, and the fit's problem as a whole: points in, costs out.

A cost is a sum over the pieces of all targets, and no term is negative. So a candidate whose sum over the first pieces
exceeds its parent's whole cost can never be selected, and the rest of it need not be driven: the outcome is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar, get_args

import numba
import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit_parallel
from ssmr.geometry import relative, wrap_angle
from ssmr.metrics.paths import IndexArray, horizon_windows, one_sided_kernel
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray, Trajectory
from validation.motion.sources import Piece, Source
from validation.plants.population import Population, make_population, shares
from validation.plants.profile import PlantProfile
from validation.plants.searchable import with_values

CostName = Literal["path", "sync", "horizon"]
_T = TypeVar("_T")

WINDOW_STRIDE = 1.0
"""Windows of the horizon cost begin this far apart [s]: they overlap, so that noise of single poses averages out."""
BLOCK_S = 6.0
"""Residuals that begin within one block of time count as one observation [s]: such windows share poses, commands and
ground."""
SCENARIO_BLOCK_S = 1.0
"""The same on the twenty seconds of a scenario [s]."""
SYNC_STRIDE_S = 0.1
"""Time between the residuals taken of a synchronised comparison [s]."""


@dataclass(frozen=True)
class CostSettings:
    """Which distance is made small."""

    name: CostName = "path"
    """`path`: Eq. 3.1; `sync`: errors at equal times; `horizon`: errors of the relative pose after some seconds."""
    k_rms: float = 20.0
    """K_rms of Eq. 3.1 [1/m]; Tab. 3.7."""
    k_haus: float = 8.0
    """K_haus of Eq. 3.1 [1/m]; Tab. 3.7."""
    k_ratio: float = 5.0
    """K_dratio of Eq. 3.1 [1]; Tab. 3.7. It weighs |1 - d_ratio|: as printed, standing still would be rewarded."""
    yaw_weight: float = 1.0
    """What a radian of yaw error counts beside a metre of position error, in `sync` and `horizon` [m/rad]."""
    horizons: tuple[float, ...] = (2.0, 6.0)
    """Of the horizon cost [s]."""

    def __post_init__(self) -> None:
        """Check names and weights.

        Raises:
            ValueError: an unknown cost, or a weight that is negative or not finite.
        """
        if self.name not in get_args(CostName):
            raise ValueError(f"unknown cost '{self.name}'; there are: {', '.join(get_args(CostName))}")
        for name in ("k_rms", "k_haus", "k_ratio", "yaw_weight"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"the weight {name} must be a number that is not negative, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class Target:
    """A motion that candidates shall make."""

    label: str
    """The source as the user named it, with the input where it is a recording."""
    source: Source
    """What drives the candidates."""
    truth: tuple[Trajectory, ...]
    """The motion wanted, piece by piece."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Signed errors of S candidates, for what a cost cannot say: how well its minimum is determined."""

    position: FloatArray
    """(S, K, 2) [m]."""
    yaw: FloatArray
    """(S, K) [rad]."""
    weight: FloatArray
    """(K,) what each counts in the cost."""
    block: FloatArray
    """(K,) number of the block of time it belongs to, counted over all pieces."""


class Rater(Protocol):
    """The share of one piece in the cost."""

    def cost(self, poses: FloatArray) -> FloatArray:
        """(S,) terms of the cost of (S, M, 3) poses; NaN where a pose is."""
        ...

    def residuals(self, poses: FloatArray) -> Residuals:
        """What the cost is made of, or stands for."""
        ...


@jit_parallel
def path_costs(poses, truth, k_rms, k_haus, k_ratio):
    """(S,) K_rms d_rms + K_haus d_haus + K_dratio |1 - d_ratio| (Eq. 3.1) of (S, M, 3) poses against (N, 3)."""
    out = np.empty(len(poses))
    for i in numba.prange(len(poses)):
        metrics = one_sided_kernel(poses[i], truth)
        out[i] = k_rms * metrics[0] + k_haus * metrics[1] + k_ratio * abs(1.0 - metrics[2])
    return out


class SyncRater:
    """RMS of position and yaw errors at the truth's stamps."""

    def __init__(self, truth: Trajectory, settings: CostSettings, weight: float, block: int) -> None:
        """Keep the truth; `weight` is the piece's share, `block` the number of its first block."""
        self._truth, self._settings, self._weight, self._block = truth, settings, weight, block
        self._every = max(1, round(SYNC_STRIDE_S / float(np.median(np.diff(truth.t)))))

    def _errors(self, poses: FloatArray, every: int = 1) -> tuple[FloatArray, FloatArray]:
        error = poses[:, ::every] - self._truth.pose[::every]
        return error[..., :2], wrap_angle(error[..., 2])

    def cost(self, poses: FloatArray) -> FloatArray:
        """See `Rater`."""
        position, yaw = self._errors(poses)
        rms = np.sqrt((position**2).sum(axis=2).mean(axis=1)), np.sqrt((yaw**2).mean(axis=1))
        return self._weight * (rms[0] + self._settings.yaw_weight * rms[1])

    def residuals(self, poses: FloatArray) -> Residuals:
        """Errors at equal times, every tenth of a second."""
        position, yaw = self._errors(poses, self._every)
        t = self._truth.t[:: self._every]
        weight = np.full(len(t), self._weight / len(t))
        return Residuals(position, yaw, weight, self._block + np.floor((t - t[0]) / SCENARIO_BLOCK_S))


class PathRater(SyncRater):
    """Eq. 3.1. Its residuals are those of the synchronised cost: distances between curves have no sign."""

    def cost(self, poses: FloatArray) -> FloatArray:
        """See `Rater`."""
        s = self._settings
        return self._weight * path_costs(np.ascontiguousarray(poses), self._truth.pose, s.k_rms, s.k_haus, s.k_ratio)


class HorizonRater:
    """Mean size of relative pose errors over windows that begin every `WINDOW_STRIDE`, see `ssmr.metrics`."""

    def __init__(self, truth: Trajectory, piece: Piece, settings: CostSettings, counts: Sequence[int], block: int) -> None:
        """Cut the windows; `counts` are those of all pieces, by horizon, `block` numbers the piece's first block."""
        self._settings = settings
        found = [windows(truth.t, horizon, piece.fresh) for horizon in settings.horizons]
        self._starts, self._ends = (np.concatenate([f[end] for f in found]) for end in (0, 1))
        horizons = len(settings.horizons)
        shares = [np.full(len(f[0]), 1.0 / (n * horizons)) for f, n in zip(found, counts, strict=True)]
        self._weight = np.concatenate(shares)
        self._block = block + np.floor((truth.t[self._starts] - truth.t[0]) / BLOCK_S)
        self._wanted = relative(truth.pose[self._starts], truth.pose[self._ends])

    def _errors(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        moved = relative(poses[:, self._starts], poses[:, self._ends])
        error = relative(np.broadcast_to(self._wanted, moved.shape), moved)
        return error[..., :2], wrap_angle(error[..., 2])

    def cost(self, poses: FloatArray) -> FloatArray:
        """See `Rater`."""
        position, yaw = self._errors(poses)
        size = np.hypot(position[..., 0], position[..., 1]) + self._settings.yaw_weight * np.abs(yaw)
        return (size * self._weight).sum(axis=1)  # no matrix product: its rounding depends on how many candidates there are

    def residuals(self, poses: FloatArray) -> Residuals:
        """Errors of the relative pose."""
        position, yaw = self._errors(poses)
        return Residuals(position, yaw, self._weight, self._block)


def windows(t: FloatArray, horizon: float, fresh: NDArray[np.bool_] | None) -> tuple[IndexArray, IndexArray]:
    """Overlapping windows of a gap-free record: those of `ssmr.metrics.horizon_windows`, begun every `WINDOW_STRIDE`.

    Returns:
        (W,) start indices and (W,) end indices, each window once, in order of start.
    """
    found: set[tuple[int, int]] = set()
    for offset in np.arange(0.0, horizon, WINDOW_STRIDE):
        first = int(np.searchsorted(t, t[0] + offset - 1e-9))
        if first >= len(t) - 1:
            break
        starts, ends = horizon_windows(t[first:], horizon, None if fresh is None else fresh[first:])
        found |= {(first + int(a), first + int(b)) for a, b in zip(starts, ends, strict=True)}
    pairs = np.array(sorted(found), dtype=np.intp).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def make_raters(settings: CostSettings, targets: Sequence[Target]) -> list[list[Rater]]:
    """A rater for every piece of every target.

    Raises:
        ValueError: the horizon cost is asked for and no window fits.
    """
    pieces = [pair for target in targets for pair in zip(target.source.pieces, target.truth, strict=True)]
    raters: list[Rater] = []
    block = 0
    if settings.name == "horizon":
        per_piece = [[len(windows(truth.t, h, piece.fresh)[0]) for h in settings.horizons] for piece, truth in pieces]
        counts = np.sum(per_piece, axis=0)
        if not counts.all():
            longest = max(float(truth.t[-1] - truth.t[0]) for _, truth in pieces)
            raise ValueError(
                f"no window of {settings.horizons[int(np.argmin(counts))]:g} s fits into the sources, whose longest stretch "
                f"without a gap has {longest:.1f} s; name shorter --horizons"
            )
        for piece, truth in pieces:
            raters.append(HorizonRater(truth, piece, settings, list(counts), block))
            block += 1 + int((truth.t[-1] - truth.t[0]) / BLOCK_S)
    else:
        total = sum(float(truth.t[-1] - truth.t[0]) for _, truth in pieces)
        make = {"path": PathRater, "sync": SyncRater}[settings.name]
        for _, truth in pieces:
            raters.append(make(truth, settings, float(truth.t[-1] - truth.t[0]) / total, block))
            block += 1 + int((truth.t[-1] - truth.t[0]) / SCENARIO_BLOCK_S)
    split = iter(raters)
    return [[next(split) for _ in target.source.pieces] for target in targets]


class Problem:
    """Everything that turns points of the unit cube into costs."""

    def __init__(
        self, model: str, base: PlantProfile, space: ParameterSpace, targets: Sequence[Target], settings: CostSettings
    ) -> None:
        """Prepare the windows.

        Args:
            model: the plant that is fitted.
            base: its numbers where they are not searched.
            space: what is searched.
            targets: what it is fitted to.
            settings: what distance means.

        Raises:
            ValueError: sources too short for the cost.
        """
        self.model, self.base, self.space, self.targets, self.settings = model, base, space, tuple(targets), settings
        self._raters = make_raters(settings, self.targets)

    def candidate(self, point: FloatArray) -> PlantProfile | None:
        """The plant that an (n,) point of the unit cube means; None where its numbers are impossible."""
        try:
            return with_values(self.model, self.base, self.space.names, self.space.values(point))
        except ValueError:
            return None

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int = 1,
        on_piece: Callable[[float], object] | None = None,
    ) -> FloatArray:
        """Rate candidates.

        Args:
            points: (S, n) of the unit cube.
            limits: (S,) a candidate whose partial sum exceeds its limit is abandoned; that sum is its answer then.
            workers: threads; the result does not depend on it.
            on_piece: told, from any thread, what share of the driving is done.

        Returns:
            (S,) costs, infinite for a candidate that is impossible or diverges.
        """
        candidates = [self.candidate(p) for p in points]
        bounds = np.full(len(points), np.inf) if limits is None else limits
        done = [0.0]

        def tell(share: float) -> None:
            done[0] += share
            if on_piece is not None:
                on_piece(done[0])

        def rate(which: Sequence[int]) -> FloatArray:
            population = make_population(self.model, [candidates[i] for i in which], workers)
            return self._costs_of(population, bounds[np.array(which)], lambda s: tell(s * len(which) / len(points)))

        costs = np.empty(len(points))
        for which, found in self._side_by_side(rate, len(points), workers):
            costs[which] = found
        return costs

    def _costs_of(self, population: Population, limits: FloatArray, tell: Callable[[float], object]) -> FloatArray:
        """Costs of a population, driven piece by piece; `tell` is told the share of each piece when it is done."""
        costs = np.zeros(len(limits))
        total = sum(piece.commands.duration for target in self.targets for piece in target.source.pieces)
        for target, raters in zip(self.targets, self._raters, strict=True):
            for piece, rater in zip(target.source.pieces, raters, strict=True):
                live = np.flatnonzero((costs == 0.0) | (np.isfinite(costs) & (costs <= limits)))
                if len(live):
                    terms = rater.cost(population.poses(list(live), piece, target.source.sample_dt))
                    costs[live] += np.where(np.isfinite(terms), terms, np.inf)
                tell(piece.commands.duration / total)
        return costs

    def _side_by_side(self, work: Callable[[Sequence[int]], _T], size: int, workers: int) -> list[tuple[Sequence[int], _T]]:
        """Let `work` do the shares of `size` candidates; an interrupt drops those that have not begun."""
        parts, at_once = shares(self.model, size, workers)
        pool = ThreadPoolExecutor(at_once)
        try:
            return list(zip(parts, pool.map(work, parts), strict=True))
        finally:
            pool.shutdown(cancel_futures=True)

    def residuals(self, points: FloatArray, workers: int = 1) -> Residuals:
        """Signed errors of candidates over all pieces; NaN for one that is impossible or diverges."""
        candidates = [self.candidate(p) for p in points]

        def drive_all(which: Sequence[int]) -> list[Residuals]:
            population = make_population(self.model, [candidates[i] for i in which], workers)
            return [
                rater.residuals(population.poses(range(len(which)), piece, target.source.sample_dt))
                for target, raters in zip(self.targets, self._raters, strict=True)
                for piece, rater in zip(target.source.pieces, raters, strict=True)
            ]

        by_share = [found for _, found in self._side_by_side(drive_all, len(points), workers)]
        pieces = by_share[0]
        return Residuals(
            np.concatenate([np.concatenate([p.position for p in found], axis=1) for found in by_share]),
            np.concatenate([np.concatenate([p.yaw for p in found], axis=1) for found in by_share]),
            np.concatenate([p.weight for p in pieces]),
            np.concatenate([p.block for p in pieces]),
        )
