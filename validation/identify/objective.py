"""Costs of a fit: the distance of a candidate's motion from the true one as one number, and its errors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ssmr._jit import jit_alone, share_among_threads
from ssmr.geometry import relative, wrap_angle
from ssmr.metrics.paths import one_sided_kernel, path_length
from ssmr.metrics.windows import overlapping_windows
from ssmr.parameters import require_within
from ssmr.types import FloatArray, Trajectory
from validation.bench.gyro import GyroJudge
from validation.bench.sources import Piece, Source
from validation.plants.kind import side_torques

Objective = Literal["path", "sync", "horizon"]

# errors that begin within one block of time count as one observation [s]: they share poses and
# ground
_BLOCK_S = 6.0
_SCENARIO_BLOCK_S = 1.0  # length of a block on the twenty seconds of a scenario [s]
_FAINT = 0.02  # weight of errors at equal times beside distances between paths
_SYNC_STRIDE_S = 0.1  # time between the signed errors of a comparison at equal times [s]


@dataclass(frozen=True)
class FitCost:
    """The distance between motions that a fit makes small."""

    objective: Objective | None = None
    """path (Eq. 3.1), sync (errors at equal times) or horizon (errors of the relative pose after
    some seconds). None takes path for scenarios and horizon for recordings."""
    horizons: tuple[float, ...] = (2.0, 6.0)
    """Horizons of the horizon objective [s]."""
    yaw_weight: float = 1.0
    """Position error that counts as much as a radian of yaw error, in the sync and horizon
    objectives [m/rad]."""
    position_weight: float = 1.0
    """Weight of position errors in the sync and horizon objectives [1]; 0 fits the heading alone,
    where positions are not to be trusted."""
    torque_weight: float = 0.01
    """Position error that counts as much as a newton metre of torque error [m/(N m)]; 0 leaves
    torques out. By default 1 cm and 1 N m weigh alike: models of real robots are off by some of
    both."""
    k_rms: float = 20.0
    """K_rms of Eq. 3.1 [1/m]; Tab. 3.7."""
    k_haus: float = 8.0
    """K_haus of Eq. 3.1 [1/m]; Tab. 3.7."""
    k_ratio: float = 5.0
    """K_dratio of Eq. 3.1 [1]; Tab. 3.7. It weighs |1 - d_ratio|: as printed, standing still would
    be rewarded."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown objective, a number out of its range, or weights that are all 0."""
        if self.objective is not None and self.objective not in get_args(Objective):
            raise ValueError(
                f"unknown objective '{self.objective}'; there are: {', '.join(get_args(Objective))}"
            )
        weights = ("yaw_weight", "position_weight", "torque_weight")
        require_within(self, (*weights, "k_rms", "k_haus", "k_ratio"), 0.0, 1e6)
        if self.objective == "path" and self.position_weight != 1.0:
            raise ValueError(
                "position_weight belongs to the objectives sync and horizon; path is a distance of positions"
            )
        if self.yaw_weight == self.position_weight == 0.0:
            raise ValueError(
                "position_weight and yaw_weight are both 0, which leaves nothing to fit to"
            )
        if not self.horizons:
            raise ValueError("horizons must be one or more numbers")
        require_within(self, ("horizons",), 1e-3, 1e5)


@dataclass(frozen=True, eq=False)
class FitTarget:
    """A true motion, and the inputs that candidates are driven with."""

    label: str
    """The source as the user named it, with the input where it is a recording."""
    source: Source
    """Inputs, start and stamps."""
    truth: tuple[Trajectory, ...]
    """The true motion, piece by piece."""
    gyro: GyroJudge | None = None
    """Better judge of turns than the truth's headings; None where these are as good."""
    torques: tuple[FloatArray, ...] | None = None
    """(M, 2) true torques of the left and the right motors, piece by piece [N m]; NaN where nobody
    knows them. None where the source has none that can be believed."""

    def torque_errors(self, motions: Sequence[Trajectory]) -> FloatArray:
        """Return (K,) errors of the `TORQUES` of a plant's motions [N m], where both are known."""
        known = self.torques or ()
        pairs = [(side_torques(motion), true) for motion, true in zip(motions, known, strict=False)]
        errors = [(torques - true).ravel() for torques, true in pairs if torques is not None]
        every = np.concatenate([*errors, np.empty(0)])
        return every[np.isfinite(every)]


class Rater:
    """Rates candidates along one piece of motion; a subclass says what their errors are."""

    def __init__(
        self, truth: Trajectory, cost: FitCost, weight: FloatArray, blocks: FloatArray
    ) -> None:
        """Keep the true motion, the (K,) weights of its errors, and the (K,) numbers of their blocks of time."""
        self._truth = truth
        self._cost = cost
        self._weight = weight
        self._blocks = blocks

    @property
    def blocks(self) -> FloatArray:
        """Number of the block of time that each residual belongs to, counted over all pieces."""
        return np.tile(
            self._blocks, 2 * (self._cost.position_weight > 0.0) + (self._cost.yaw_weight > 0.0)
        )

    def errors(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (S, K, 2) errors of positions [m] and (S, K) of yaw [rad] of (S, M, 3) poses."""
        raise NotImplementedError

    def cost(self, poses: FloatArray, workers: int = 1) -> FloatArray:
        """Return the (S,) terms of the cost of (S, M, 3) poses, rated on so many threads; NaN where a pose is NaN."""
        raise NotImplementedError

    def residuals(self, poses: FloatArray, workers: int = 1) -> FloatArray:
        """Return the errors that least squares make small, each times the root of its weight; none that weighs nothing."""
        (position, yaw), root, cost = self.errors(poses), np.sqrt(self._weight), self._cost
        columns = (
            [cost.position_weight * root * position[..., i] for i in (0, 1)]
            if cost.position_weight > 0.0
            else []
        )
        return np.concatenate(
            [*columns, *([cost.yaw_weight * root * yaw] if cost.yaw_weight > 0.0 else [])], axis=1
        )


class SyncRater(Rater):
    """The sync objective: RMS of position and yaw errors at equal times; least squares see every tenth of a second."""

    def __init__(self, truth: Trajectory, cost: FitCost, share: float, block: int) -> None:
        """Keep the piece's share in the cost, and count its blocks of time from `block`."""
        self._share = share
        self._every = max(1, round(_SYNC_STRIDE_S / float(np.median(np.diff(truth.t)))))
        blocks = block + np.floor((truth.t[:: self._every] - truth.t[0]) / _SCENARIO_BLOCK_S)
        super().__init__(truth, cost, np.full(len(blocks), share / len(blocks)), blocks)

    def errors(self, poses: FloatArray, every: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the errors at every so many samples, see `Rater.errors`."""
        k = every or self._every
        error = poses[:, ::k] - self._truth.pose[::k]
        return error[..., :2], wrap_angle(error[..., 2])

    def cost(self, poses: FloatArray, workers: int = 1) -> FloatArray:
        """Return the weighted sum of the RMS of position and of yaw errors."""
        position, yaw = self.errors(poses, 1)
        rms = np.sqrt((position**2).sum(axis=2).mean(axis=1)), np.sqrt((yaw**2).mean(axis=1))
        return self._share * (self._cost.position_weight * rms[0] + self._cost.yaw_weight * rms[1])


@jit_alone
def path_costs(poses, truth, k_rms, k_haus, k_ratio, out):
    """Write (S,) K_rms d_rms + K_haus d_haus + K_dratio |1 - d_ratio| (Eq. 3.1) of (S, M, 3) poses against (N, 3)."""
    length = path_length(truth)
    for i in range(len(poses)):
        metrics = one_sided_kernel(poses[i], truth, length)
        out[i] = k_rms * metrics[0] + k_haus * metrics[1] + k_ratio * abs(1.0 - metrics[2])


@jit_alone
def path_offsets(poses, truth, every, out):
    """Write (S, N, 2) vectors [m] from every `every`-th of (M, 3) true positions to the nearest of (S, L, 3) paths."""
    for i in range(len(poses)):
        path = poses[i]
        for k in range(out.shape[1]):
            x = truth[k * every, 0]
            y = truth[k * every, 1]
            best = math.inf
            out[i, k] = math.nan
            for j in range(len(path) - 1):
                ax = path[j, 0] - x
                ay = path[j, 1] - y
                bx = path[j + 1, 0] - path[j, 0]
                by = path[j + 1, 1] - path[j, 1]
                length = bx * bx + by * by
                share = min(max(-(ax * bx + ay * by) / length, 0.0), 1.0) if length > 0.0 else 0.0
                dx = ax + share * bx
                dy = ay + share * by
                if dx * dx + dy * dy < best:
                    best = dx * dx + dy * dy
                    out[i, k, 0] = dx
                    out[i, k, 1] = dy


class PathRater(SyncRater):
    """The path objective, Eq. 3.1.

    Least squares see the offsets from the true path to the candidate's and the error of the length,
    whose squares add up to (K_rms d_rms)^2 + (K_dratio (1 - d_ratio))^2; the greatest distance has
    no derivative. A path does not say when the robot was where, so faint errors at equal times
    choose between equal paths.
    """

    @property
    def blocks(self) -> FloatArray:
        """Number of the block of time that each residual belongs to; the error of the length has one of its own."""
        return np.concatenate(
            [np.repeat(self._blocks, 2), [self._blocks[-1] + 1.0], super().blocks]
        )

    def residuals(self, poses: FloatArray, workers: int = 1) -> FloatArray:
        """Return offsets, error of the length and faint errors of time."""
        s = self._cost
        root = math.sqrt(self._share)
        truth = self._truth.pose
        poses, offsets = np.ascontiguousarray(poses), np.empty((len(poses), len(self._blocks), 2))
        share_among_threads(
            lambda i, k: path_offsets(poses[i:k], truth, self._every, offsets[i:k]), len(poses), workers
        )  # fmt: skip
        share = s.k_rms / math.sqrt(offsets.shape[1])
        lengths = [
            np.hypot(*np.diff(p[..., :2], axis=-2).T).sum(axis=0) for p in (poses, truth[None])
        ]
        ratio = s.k_ratio * (1.0 - lengths[0] / lengths[1])
        timing = _FAINT * s.k_rms * super().residuals(poses)
        return np.concatenate(
            [root * share * offsets.reshape(len(poses), -1), root * ratio[:, None], timing], axis=1
        )

    def cost(self, poses: FloatArray, workers: int = 1) -> FloatArray:
        """Return K_rms d_rms + K_haus d_haus + K_dratio |1 - d_ratio| of each candidate."""
        s = self._cost
        truth = self._truth.pose
        poses, costs = np.ascontiguousarray(poses), np.empty(len(poses))
        share_among_threads(
            lambda i, k: path_costs(poses[i:k], truth, s.k_rms, s.k_haus, s.k_ratio, costs[i:k]), len(poses), workers
        )  # fmt: skip
        return self._share * costs


class HorizonRater(Rater):
    """The horizon objective: mean size of relative pose errors over windows that begin every second."""

    def __init__(
        self,
        truth: Trajectory,
        heading: FloatArray,
        piece: Piece,
        cost: FitCost,
        counts: Sequence[int],
        block: int,
    ) -> None:
        """Cut the windows; the (M,) `heading` [rad] says how far the robot turned in each.

        `counts` are the numbers of windows of all pieces by horizon, and `block` is the piece's
        first block of time.
        """
        windows = [
            piece.windows(overlapping_windows, truth.t, horizon) for horizon in cost.horizons
        ]
        self._starts, self._ends = (np.concatenate([f[end] for f in windows]) for end in (0, 1))
        self._wanted = relative(truth.pose[self._starts], truth.pose[self._ends])
        self._wanted[:, 2] = heading[self._ends] - heading[self._starts]
        weight = np.concatenate(
            [
                np.full(len(f[0]), 1.0 / (n * len(windows)))
                for f, n in zip(windows, counts, strict=True)
            ]
        )
        super().__init__(
            truth, cost, weight, block + np.floor((truth.t[self._starts] - truth.t[0]) / _BLOCK_S)
        )

    def errors(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors of the relative pose over each window, see `Rater.errors`."""
        moved = relative(poses[:, self._starts], poses[:, self._ends])
        error = relative(np.broadcast_to(self._wanted, moved.shape), moved)
        return error[..., :2], wrap_angle(error[..., 2])

    def cost(self, poses: FloatArray, workers: int = 1) -> FloatArray:
        """Return the weighted sum of the sizes of all errors."""
        position, yaw = self.errors(poses)
        far = np.hypot(position[..., 0], position[..., 1])
        size = self._cost.position_weight * far + self._cost.yaw_weight * np.abs(yaw)
        # no matrix product: its rounding depends on how many candidates there are
        return (size * self._weight).sum(axis=1)


class TorqueRater:
    """The torques of both sides, as means over tenths of a second: RMS, or mean size for logs."""

    def __init__(
        self, t: FloatArray, torques: FloatArray, cost: FitCost, share: float, block: int
    ) -> None:
        """Keep the (M, 2) true torques at stamps [s], the piece's share, and its first block.

        A mean is over the samples that are known, and a tenth of a second without any is left out.
        """
        every = max(1, round(_SYNC_STRIDE_S / float(np.median(np.diff(t)))))
        self._first = np.arange(0, len(t), every)
        self._known = np.isfinite(torques)
        count = np.add.reduceat(self._known, self._first, axis=0)
        self._kept = count > 0
        self._count = np.maximum(count, 1)
        self._share = share
        self._size = cost.torque_weight
        self._robust = cost.objective == "horizon"
        length = _BLOCK_S if self._robust else _SCENARIO_BLOCK_S
        number = block + np.floor((t[self._first] - t[0]) / length)
        self._of_block = np.broadcast_to(number[:, None], count.shape)[self._kept]
        self._wanted = self._means(torques[None])

    @property
    def blocks(self) -> FloatArray:
        """Number of the block of time that each residual belongs to."""
        return self._of_block

    def _means(self, torques: FloatArray) -> FloatArray:
        """Return (S, K) means of (S, M, 2) torques over what is known of each tenth of a second."""
        known = np.where(self._known, torques, 0.0)
        sums = np.add.reduceat(known, self._first, axis=1)
        return np.asarray((sums / self._count)[:, self._kept])

    def cost(self, torques: FloatArray) -> FloatArray:
        """Return the weighted RMS of the errors of (S, M, 2) torques, or their mean size."""
        error = self._means(torques) - self._wanted
        if self._robust:
            size = np.abs(error).mean(axis=1)
        else:
            size = np.sqrt((error**2).mean(axis=1))
        return np.asarray(self._share * self._size * size)

    def residuals(self, torques: FloatArray) -> FloatArray:
        """Return the weighted errors of (S, M, 2) torques, whose squares add up as in a rater's."""
        root = math.sqrt(self._share / len(self._of_block))
        return np.asarray(root * self._size * (self._means(torques) - self._wanted))


def _spans(cost: FitCost, targets: Sequence[FitTarget]) -> tuple[list[float], list[int]]:
    """Return the length of each piece of each target [s], and its first block of time."""
    seconds = [float(truth.t[-1] - truth.t[0]) for target in targets for truth in target.truth]
    length = _BLOCK_S if cost.objective == "horizon" else _SCENARIO_BLOCK_S
    counts = [2 + int(s / length) for s in seconds]
    return seconds, list(itertools.accumulate(counts[:-1], initial=0))


def make_torque_raters(cost: FitCost, targets: Sequence[FitTarget]) -> list[TorqueRater | None]:
    """Return a rater of torques for every piece of every target; None for one without torques.

    A piece weighs by its share of the time in which torques are known.
    """
    seconds, blocks = _spans(cost, targets)
    known = [
        torques if torques is not None and np.isfinite(torques).any() else None
        for target in targets
        for torques in target.torques or [None] * len(target.truth)
    ]
    total = sum(s for s, torques in zip(seconds, known, strict=True) if torques is not None)
    stamps = [truth.t for target in targets for truth in target.truth]
    out = list[TorqueRater | None]()
    for t, torques, s, block in zip(stamps, known, seconds, blocks, strict=True):
        if torques is None or cost.torque_weight == 0.0:
            out.append(None)
        else:
            out.append(TorqueRater(t, torques, cost, s / total, block))
    return out


def make_raters(cost: FitCost, targets: Sequence[FitTarget]) -> list[Rater]:
    """Return a rater for every piece of every target, in their order; a ValueError says that no window fits into them."""
    pieces = [
        pair for target in targets for pair in zip(target.source.pieces, target.truth, strict=True)
    ]
    seconds, blocks = _spans(cost, targets)
    if cost.objective != "horizon":
        make = PathRater if cost.objective == "path" else SyncRater
        return [
            make(r, cost, s / sum(seconds), b)
            for (_, r), s, b in zip(pieces, seconds, blocks, strict=True)
        ]
    counts = np.sum(
        [
            [len(p.windows(overlapping_windows, r.t, h)[0]) for h in cost.horizons]
            for p, r in pieces
        ],
        axis=0,
    )
    if not counts.all():
        if not any(piece.moves is None or piece.moves.any() for piece, _ in pieces):
            raise ValueError(
                "the robot stands all the time, so nothing tells how it moves; record a drive"
            )
        raise ValueError(
            f"no window of {cost.horizons[int(np.argmin(counts))]:g} s in which the robot moves fits between gaps and "
            f"jumps; the longest stretch without a gap has {max(seconds):.1f} s: record a longer drive"
        )
    headings = [
        h
        for t in targets
        for h in (t.gyro.late if t.gyro else [motion.pose[:, 2] for motion in t.truth])
    ]
    return [
        HorizonRater(r, h, p, cost, list(counts), b)
        for (p, r), h, b in zip(pieces, headings, blocks, strict=True)
    ]
