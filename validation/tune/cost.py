"""Costs of a tuning: how badly runs followed a reference, as one number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ssmr._jit import jit_alone, share_among_threads
from ssmr.control.loop import ClosedRun
from ssmr.metrics.paths import BENDING_FLOOR, bend_ratio_kernel, bending_energy, measured_length, one_sided_kernel
from ssmr.parameters import MOST_SEED, require_within
from ssmr.types import FloatArray, Trajectory

TuneMeasure = Literal["path", "time"]
MOST_SEEDS = 10_000
"""Greatest number of draws of noise that a cost is the mean of."""
GUARD_DISTANCE = 1.0
"""Distance from its target within which the robot must stay for the stability guard [m]."""


@dataclass(frozen=True)
class TuneCost:
    """The cost that a tuning makes small, over all references and plants together.

    A `k_u` of None is 50 for the LQR (Tab. 4.20), and 0 for other controllers.
    """

    cost: TuneMeasure = "path"
    """path (Sec. 4.3.3, 4.4.3), which is blind to time, or time: errors at equal times in the place of distances between
    paths (Sec. 5)."""
    guard: float = 0.1
    """Stability guard: candidates that lose the reference with this much more delay are refused [s]; 0 turns it off. Drawn
    robots have delays of their own, and no guard."""
    seeds: Sequence[int] | None = None
    """Seeds of noise and disturbance; the cost is the mean over them. None takes the seed of the search."""
    k_rms: float = 100.0
    """Weight of d_rms, or of the RMS position error at equal times [1/m]; Tab. 4.3, 4.20."""
    k_haus: float = 15.0
    """Weight of d_haus, or of the greatest position error at equal times [1/m]."""
    k_ratio: float = 10.0
    """Weight of |1 - d_ratio|."""
    k_bend: float = 10.0
    """Weight of |1 - e_bend_ratio|."""
    k_u: float | None = None
    """Weight of |1 - u_RMS|, the speed's RMS over that of the reference."""

    def __post_init__(self) -> None:
        """Check names and weights.

        Raises:
            ValueError: an unknown cost, a weight out of its range, no seed, too many, or one out of its range.
        """
        if self.cost not in get_args(TuneMeasure):
            raise ValueError(f"unknown cost '{self.cost}'; there are: {', '.join(get_args(TuneMeasure))}")
        require_within(self, ("k_rms", "k_haus", "k_ratio", "k_bend", "k_u"), 0.0, 1e6)
        require_within(self, ("guard",), 0.0, 10.0)
        if self.seeds is not None:
            if not 1 <= len(self.seeds) <= MOST_SEEDS:
                raise ValueError(f"seeds must name 1 to {MOST_SEEDS} seeds")
            object.__setattr__(self, "seeds", tuple(self.seeds))
            require_within(self, ("seeds",), 0, MOST_SEED, whole=True)


@jit_alone
def _path_measures(poses, truth, out):
    """Write (S, 4) d_rms, d_haus, d_ratio and e_bend_ratio of (S, M, 3) poses against (N, 3)."""
    length = measured_length(truth)
    for i in range(len(poses)):
        out[i, 0], out[i, 1], out[i, 2] = one_sided_kernel(poses[i], truth, length)
        out[i, 3] = bend_ratio_kernel(poses[i], truth)


def costs_of(runs: Sequence[ClosedRun], target: Trajectory, speed: float, cost: TuneCost, workers: int = 1) -> FloatArray:
    """Return the (S,) costs of runs along one reference, whose speed has this RMS [m/s]; infinite where a robot was lost.

    The runs are rated on `workers` threads; the costs do not depend on their number.
    """
    out = np.full(len(runs), np.inf)
    kept = [i for i, run in enumerate(runs) if not run.lost]
    if not kept:
        return out
    poses = np.array([runs[i].table[:, :3] for i in kept])
    measures = np.empty((len(poses), 4))
    share_among_threads(lambda i, k: _path_measures(poses[i:k], target.pose, measures[i:k]), len(poses), workers)
    d_rms, d_haus = measures[:, 0], measures[:, 1]
    if cost.cost == "time":
        apart = np.hypot(*np.moveaxis(poses[:, : len(target.t), :2] - target.pose[None, : poses.shape[1], :2], 2, 0))
        d_rms, d_haus = np.sqrt(np.mean(apart**2, axis=1)), apart.max(axis=1)
    u_rms = np.array([np.sqrt(np.mean(runs[i].column("v_x") ** 2)) for i in kept]) / max(speed, 1e-9)
    found = cost.k_rms * d_rms + cost.k_haus * d_haus + cost.k_ratio * np.abs(1.0 - measures[:, 2])
    found += (cost.k_u or 0.0) * np.abs(1.0 - u_rms)
    if bending_energy(target.xy) >= BENDING_FLOOR:  # a straight reference has no ratio
        found += cost.k_bend * np.abs(1.0 - measures[:, 3])
    out[kept] = np.where(np.isfinite(found), found, np.inf)
    return out
