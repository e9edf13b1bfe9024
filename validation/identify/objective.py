"""Costs of a fit: the distance between two motions as one number, and the errors behind it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from typing import Literal

import numpy as np

from ssmr._jit import jit_alone, share_among_threads
from ssmr.geometry import relative_pose, wrap_angle
from ssmr.metrics.paths import (
    one_sided_kernel,
    path_length,
    path_segments,
    squared_distance,
)
from ssmr.metrics.windows import overlapping_windows
from ssmr.parameters import require_within
from ssmr.types import FloatArray, Trajectory
from validation.experiment.sources import Piece, Source
from validation.plants.kind import side_torques
from validation.simulator.description import GRAVITY, Robot

Objective = Literal["path", "sync", "horizon"]
"""Objective of a fit, see `FitCost`."""

# errors that begin within one block of time [s] count as one observation, as they share poses and
# ground
_BLOCK_S = 6.0
_SCENARIO_BLOCK_S = 1.0  # length of a block on the twenty seconds of a scenario [s]
_FAINT = 0.02  # weight of errors at equal times beside distances between paths
_SYNC_STRIDE_S = 0.1  # time between the signed errors of a comparison at equal times [s]


_WEIGHT_ON_A_RADIUS = 1.2
"""Position error that counts as much as a torque of a robot's weight on its wheels' radius [m]: for
a Husky 1 cm and 1 N m weigh alike, and models of it are off by some of both."""


def usual_torque_weight(robot: Robot) -> float:
    """Return the position error that counts as much as a newton metre of torque [m/(N m)]."""
    return _WEIGHT_ON_A_RADIUS / (robot.mass * GRAVITY * robot.wheel_radius)


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
    torque_weight: float | None = None
    """Position error that counts as much as a newton metre of torque error [m/(N m)]; 0 leaves
    torques out. None is `usual_torque_weight` where friction is free, and else 0: a wrong friction
    that is held would push the body's numbers away from what the motion tells."""
    k_rms: float = 20.0
    """K_rms of Eq. 3.1 [1/m]; Tab. 3.7."""
    k_haus: float = 8.0
    """K_haus of Eq. 3.1 [1/m]; Tab. 3.7."""
    k_ratio: float = 5.0
    """K_dratio of Eq. 3.1 [1]; Tab. 3.7. It weighs |1 - d_ratio|: as printed, standing still would
    be rewarded."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range, or weights that are all 0."""
        weights = ("yaw_weight", "position_weight", "torque_weight")
        require_within(self, (*weights, "k_rms", "k_haus", "k_ratio"), 0.0, 1e6)
        # a distance of positions alone has nothing that a weight could be relative to
        if self.objective == "path" and self.position_weight != 1.0:
            raise ValueError(
                "position_weight belongs to the objectives sync and horizon; "
                "path is a distance of positions"
            )
        if self.yaw_weight == self.position_weight == 0.0:
            raise ValueError(
                "position_weight and yaw_weight are both 0, which leaves nothing to fit to"
            )
        if not self.horizons:
            raise ValueError("horizons must be one or more numbers")
        require_within(self, ("horizons",), 1e-3, 1e5)


def torque_errors(pieces: Sequence[Piece], motions: Sequence[Trajectory]) -> FloatArray:
    """Return (K,) errors of the `TORQUES` of a plant's motions [N m], where both are known."""
    errors = [np.empty(0)]
    for piece, motion in zip(pieces, motions, strict=True):
        torques = side_torques(motion)
        if torques is not None and piece.torques is not None:
            errors.append((torques - piece.torques).ravel())
    every = np.concatenate(errors)
    return every[np.isfinite(every)]


def _error_stride(t: FloatArray) -> int:
    """Return the number of samples between errors at equal times, of (M,) stamps [s]."""
    period = np.median(np.diff(t))
    return max(1, round(_SYNC_STRIDE_S / period))


class Rater(ABC):
    """Rates candidates along one piece of motion; a subclass defines the errors of their poses."""

    def __init__(self, piece: Piece, cost: FitCost, weight: FloatArray, blocks: FloatArray) -> None:
        """Keep the piece, and (K,) weights and blocks of time of the errors of its poses."""
        self.piece = piece
        self.torques: TorqueRater | None = None
        self._cost = cost
        self._weight = weight
        self._blocks = blocks

    @property
    def blocks(self) -> FloatArray:
        """(K,) number of the block of time of each residual, counted over all pieces."""
        if self.torques is None:
            return self.pose_blocks
        return np.concatenate([self.pose_blocks, self.torques.blocks])

    def cost(self, motions: FloatArray, workers: int = 1) -> FloatArray:
        """Return the (S,) terms of the cost of (S, M, 3 or 5) motions; NaN where one is NaN.

        See `Population.motions`.
        """
        terms = self.pose_cost(motions[..., :3], workers)
        if self.torques is None:
            return terms
        return terms + self.torques.cost(motions[..., 3:])

    def residuals(self, motions: FloatArray, workers: int = 1) -> FloatArray:
        """Return the (S, K) errors that least squares make small, each times its weight's root."""
        errors = self.pose_residuals(motions[..., :3], workers)
        if self.torques is None:
            return errors
        return np.hstack([errors, self.torques.residuals(motions[..., 3:])])

    @property
    def pose_blocks(self) -> FloatArray:
        """Number of the block of each residual of poses."""
        columns = 2 * (self._cost.position_weight > 0.0) + (self._cost.yaw_weight > 0.0)
        return np.tile(self._blocks, columns)

    @property
    def ends(self) -> FloatArray:
        """(K,) stamp at which each residual of poses is known [s]; only windows have one."""
        raise NotImplementedError

    @abstractmethod
    def errors(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (S, K, 2) errors of positions [m] and (S, K) of yaw [rad] of (S, M, 3) poses."""

    @abstractmethod
    def pose_cost(self, poses: FloatArray, workers: int) -> FloatArray:
        """Return the (S,) terms of the cost of (S, M, 3) poses."""

    def pose_residuals(self, poses: FloatArray, workers: int) -> FloatArray:
        """Return the weighted errors of (S, M, 3) poses; those that weigh nothing are left out."""
        position, yaw = self.errors(poses)
        root = np.sqrt(self._weight)
        weight = self._cost.position_weight
        columns = []
        if weight > 0.0:
            columns += [weight * root * position[..., 0], weight * root * position[..., 1]]
        if self._cost.yaw_weight > 0.0:
            columns.append(self._cost.yaw_weight * root * yaw)
        return np.concatenate(columns, axis=1)


class _SyncRater(Rater):
    """The sync objective: RMS of position and yaw errors at equal times.

    Least squares see the errors of every tenth of a second.
    """

    def __init__(self, piece: Piece, cost: FitCost, share: float, block: int) -> None:
        """Keep the piece's share in the cost, and count its blocks of time from `block`."""
        truth = true_motion(piece)
        self._share = share
        self._truth = truth.pose
        self._every = _error_stride(truth.t)
        blocks = block + np.floor((truth.t[:: self._every] - truth.t[0]) / _SCENARIO_BLOCK_S)
        weight = np.full(len(blocks), share / len(blocks))
        super().__init__(piece, cost, weight, blocks)

    def errors(self, poses: FloatArray, every: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the errors at every so many samples, see `Rater.errors`."""
        k = every or self._every
        error = poses[:, ::k] - self._truth[::k]
        return error[..., :2], wrap_angle(error[..., 2])

    def pose_cost(self, poses: FloatArray, workers: int) -> FloatArray:
        """Return the weighted sum of the RMS of position and of yaw errors."""
        position, yaw = self.errors(poses, 1)
        far = np.sqrt((position**2).sum(axis=2).mean(axis=1))
        turned = np.sqrt((yaw**2).mean(axis=1))
        return self._share * (self._cost.position_weight * far + self._cost.yaw_weight * turned)


@jit_alone
def _path_costs(poses, truth, k_rms, k_haus, k_ratio, out):
    """Write the (S,) costs of (S, M, 3) poses against the (N, 3) true ones, by Eq. 3.1.

    A cost is K_rms d_rms + K_haus d_haus + K_dratio |1 - d_ratio|.
    """
    length = path_length(truth)
    for i in range(len(poses)):
        d_rms, d_haus, d_ratio = one_sided_kernel(poses[i], truth, length)
        out[i] = k_rms * d_rms + k_haus * d_haus + k_ratio * abs(1.0 - d_ratio)


@jit_alone
def _path_offsets(poses, truth, every, out):
    """Write (S, N, 2) vectors [m] from true positions to the nearest points of (S, L, 3) paths.

    The true positions are every `every`-th of (M, 3) poses.
    """
    for i in range(len(poses)):
        segments = path_segments(poses[i])
        for k in range(out.shape[1]):
            best = math.inf
            # stays NaN where the candidate's path is NaN
            out[i, k] = math.nan
            for segment in segments:
                square, to_x, to_y = squared_distance(
                    truth[k * every, 0], truth[k * every, 1], segment
                )
                if square < best:
                    best = square
                    out[i, k, 0] = to_x
                    out[i, k, 1] = to_y


class PathRater(_SyncRater):
    """The path objective, Eq. 3.1.

    Least squares see the offsets from the true path to the candidate's and the error of the length,
    whose squares add up to (K_rms d_rms)^2 + (K_dratio (1 - d_ratio))^2; the greatest distance has
    no derivative. A path does not say when the robot was where, so faint errors at equal times
    choose between equal paths.
    """

    @property
    def pose_blocks(self) -> FloatArray:
        """Number of the block of each residual; the error of the length has a block to itself."""
        length = [self._blocks[-1] + 1.0]
        return np.concatenate([np.repeat(self._blocks, 2), length, super().pose_blocks])

    def pose_residuals(self, poses: FloatArray, workers: int) -> FloatArray:
        """Return offsets, error of the length and faint errors of time."""
        s = self._cost
        root = math.sqrt(self._share)
        truth = self._truth
        poses = np.ascontiguousarray(poses)
        offsets = np.empty((len(poses), len(self._blocks), 2))

        def write(i: int, k: int) -> None:
            _path_offsets(poses[i:k], truth, self._every, offsets[i:k])

        share_among_threads(write, len(poses), workers)
        share = s.k_rms / math.sqrt(offsets.shape[1])
        steps = [np.diff(path[..., :2], axis=-2) for path in (poses, truth[None])]
        length, true_length = (np.hypot(*step.T).sum(axis=0) for step in steps)
        ratio = s.k_ratio * (1.0 - length / true_length)
        timing = _FAINT * s.k_rms * super().pose_residuals(poses, workers)
        columns = [root * share * offsets.reshape(len(poses), -1), root * ratio[:, None], timing]
        return np.concatenate(columns, axis=1)

    def pose_cost(self, poses: FloatArray, workers: int) -> FloatArray:
        """Return K_rms d_rms + K_haus d_haus + K_dratio |1 - d_ratio| of each candidate."""
        s = self._cost
        truth = self._truth
        poses = np.ascontiguousarray(poses)
        costs = np.empty(len(poses))

        def write(i: int, k: int) -> None:
            _path_costs(poses[i:k], truth, s.k_rms, s.k_haus, s.k_ratio, costs[i:k])

        share_among_threads(write, len(poses), workers)
        return self._share * costs


class _HorizonRater(Rater):
    """The horizon objective: mean size of relative pose errors over windows, one every second."""

    def __init__(self, piece: Piece, cost: FitCost, counts: Sequence[int], block: int) -> None:
        """Cut the windows.

        `counts` are the numbers of windows by horizon that weigh 1 together, and `block` is the
        piece's first block of time.
        """
        truth = true_motion(piece)
        windows = [piece.windows(overlapping_windows, truth.t, h) for h in cost.horizons]
        self._starts = np.concatenate([starts for starts, _ in windows])
        self._ends = np.concatenate([ends for _, ends in windows])
        weights = [
            np.full(len(starts), 1.0 / (count * len(windows)))
            for (starts, _), count in zip(windows, counts, strict=True)
        ]
        self._moved = relative_pose(truth.pose[self._starts], truth.pose[self._ends])
        # a gyro may judge turns better than the poses do
        heading = truth.yaw if piece.headings is None else piece.headings
        self._moved[:, 2] = heading[self._ends] - heading[self._starts]
        blocks = block + np.floor((truth.t[self._starts] - truth.t[0]) / _BLOCK_S)
        super().__init__(piece, cost, np.concatenate(weights), blocks)

    @property
    def ends(self) -> FloatArray:
        """(K,) stamp at which the window of each residual of poses ends [s]."""
        stamps = true_motion(self.piece).t[self._ends]
        # a piece may be too short for any window
        return np.tile(stamps, len(self.pose_blocks) // max(len(stamps), 1))

    def errors(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors of the relative pose over each window, see `Rater.errors`."""
        moved = relative_pose(poses[:, self._starts], poses[:, self._ends])
        error = relative_pose(np.broadcast_to(self._moved, moved.shape), moved)
        return error[..., :2], wrap_angle(error[..., 2])

    def pose_cost(self, poses: FloatArray, workers: int) -> FloatArray:
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

        A mean is over the finite samples; a tenth of a second without any is left out.
        """
        every = _error_stride(t)
        self._first = np.arange(0, len(t), every)
        self._finite = np.isfinite(torques)
        count = np.add.reduceat(self._finite, self._first, axis=0)
        self._kept = count > 0
        # those without a sample are dropped after the division
        self._count = np.maximum(count, 1)
        self._share = share
        self._size = cost.torque_weight or 0.0
        self._robust = cost.objective == "horizon"
        length = _BLOCK_S if self._robust else _SCENARIO_BLOCK_S
        number = block + np.floor((t[self._first] - t[0]) / length)
        self.blocks = np.broadcast_to(number[:, None], count.shape)[self._kept]
        self._true_means = self._means(torques[None])

    def _means(self, torques: FloatArray) -> FloatArray:
        """Return (S, K) means of (S, M, 2) torques over each tenth of a second's finite samples."""
        finite = np.where(self._finite, torques, 0.0)
        sums = np.add.reduceat(finite, self._first, axis=1)
        return (sums / self._count)[:, self._kept]

    def cost(self, torques: FloatArray) -> FloatArray:
        """Return the weighted RMS of the errors of (S, M, 2) torques, or their mean size."""
        error = self._means(torques) - self._true_means
        if self._robust:
            size = np.abs(error).mean(axis=1)
        else:
            size = np.sqrt((error**2).mean(axis=1))
        return self._share * self._size * size

    def residuals(self, torques: FloatArray) -> FloatArray:
        """Return the weighted errors of (S, M, 2) torques, whose squares add up as in a rater's."""
        root = math.sqrt(self._share / len(self.blocks))
        error = self._means(torques) - self._true_means
        return root * self._size * error


def true_motion(piece: Piece) -> Trajectory:
    """Return the motion that candidates are compared with over a piece."""
    assert piece.reference is not None  # sources of a fit know it, see `open_sources`
    return piece.reference


def make_raters(cost: FitCost, sources: Sequence[Source]) -> list[Rater]:
    """Return a rater for every piece of the sources, in their order.

    Poses weigh by a piece's share of all time; for the horizon objective every source weighs the
    same, as a day does however long, and so does every window of a horizon within a source. Torques
    weigh by a piece's share of the time in which they are known.

    Raises:
        ValueError: no window of the horizon objective fits into them.
    """
    pieces = list(chain.from_iterable(source.pieces for source in sources))
    seconds = [np.ptp(true_motion(piece).t) for piece in pieces]
    length = _BLOCK_S if cost.objective == "horizon" else _SCENARIO_BLOCK_S
    # one more for a last block that is not full, and one for the error of a path's length
    blocks = list(accumulate((2 + int(s / length) for s in seconds), initial=0))[:-1]
    raters: list[Rater] = []
    if cost.objective == "horizon":
        first = iter(blocks)
        for counts, source in zip(_window_counts(cost, sources), sources, strict=True):
            shares = [len(sources) * count for count in counts]
            for piece in source.pieces:
                raters.append(_HorizonRater(piece, cost, shares, next(first)))
    else:
        make = PathRater if cost.objective == "path" else _SyncRater
        for piece, s, block in zip(pieces, seconds, blocks, strict=True):
            raters.append(make(piece, cost, s / sum(seconds), block))
    known = [p.torques is not None and bool(np.isfinite(p.torques).any()) for p in pieces]
    total = sum(s for s, is_known in zip(seconds, known, strict=True) if is_known)
    for rater, s, block, is_known in zip(raters, seconds, blocks, known, strict=True):
        torques = rater.piece.torques
        if torques is not None and is_known and cost.torque_weight:
            t = true_motion(rater.piece).t
            rater.torques = TorqueRater(t, torques, cost, s / total, block)
    return raters


def _window_counts(cost: FitCost, sources: Sequence[Source]) -> list[list[int]]:
    """Return each source's number of windows of each horizon; a ValueError says one has none."""
    counts = []
    for source in sources:
        own = []
        for horizon in cost.horizons:
            cuts = [
                p.windows(overlapping_windows, true_motion(p).t, horizon) for p in source.pieces
            ]
            own.append(sum(len(starts) for starts, _ in cuts))
        counts.append(own)
    total = [sum(column) for column in zip(*counts, strict=True)]
    if all(total):
        return counts
    pieces = list(chain.from_iterable(source.pieces for source in sources))
    if not any(piece.moves is None or piece.moves.any() for piece in pieces):
        raise ValueError(
            "the robot stands all the time, so nothing tells how it moves; record a drive"
        )
    horizon = cost.horizons[total.index(min(total))]
    longest = max(np.ptp(true_motion(piece).t) for piece in pieces)
    raise ValueError(
        f"no window of {horizon:g} s in which the robot moves fits between gaps and "
        f"jumps; the longest stretch without a gap has {longest:.1f} s: "
        "record a longer drive"
    )
