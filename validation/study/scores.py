"""How well controllers follow one reference on one plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssmr.control.laws import Controller
from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.waypoints import Waypoints
from validation.bench.loops import AnyController, ClosedLoopRobot, rate, run_robots
from validation.tune.cost import TuneCost, costs_of

SAME_COST = TuneCost(guard=0.0)
"""Cost of Sec. 4.3.3 without the LQR's additional term: the same for all laws, so that they can be compared."""


@dataclass(frozen=True, kw_only=True)
class FollowedScore:
    """The score of a controller on a reference: means over the seeds, None if the reference was lost under one of them."""

    cost: float | None
    """Cost (Sec. 4.3.3) [1]."""
    d_rms_m: float | None
    """Distance from the reference to the robot's path, root mean square [m]."""
    sync_rms_m: float | None
    """Distance of the robot from its moving target, root mean square [m]."""
    e_rho_rms_m: float | None
    """Distance of the moving target ahead, as the controller sees it, root mean square [m]."""
    lost: int
    """Number of seeds under which the reference was lost."""


def score_all(
    robot: ClosedLoopRobot,
    laws: Sequence[AnyController],
    waypoints: Waypoints,
    seeds: Sequence[int],
    workers: int | None = None,
) -> list[FollowedScore]:
    """Drive every controller along a reference, with noise and disturbance of every seed, and return their scores.

    Compiled laws are driven as one population and Python objects as another; a score does not depend on the others.

    Args:
        robot: the plant.
        laws: the controllers.
        waypoints: the reference.
        seeds: seeds of noise and disturbance, the same for all controllers.
        workers: threads; the result does not depend on it.

    Raises:
        ControllerError: a controller that is a Python object failed.
    """
    runs: dict[int, list[ClosedRun]] = {}
    for compiled in (True, False):
        own = [k for k, law in enumerate(laws) if isinstance(law, Controller) is compiled]
        if own:
            each = [laws[k] for k in own for _ in seeds]
            driven = run_robots([robot] * len(each), each, [LoopSettings()] * len(each), waypoints, seeds, workers)
            runs |= {k: driven[j * len(seeds) : (j + 1) * len(seeds)] for j, k in enumerate(own)}
    return [_score(runs[k], waypoints, robot) for k in range(len(laws))]


def _score(runs: Sequence[ClosedRun], waypoints: Waypoints, robot: ClosedLoopRobot) -> FollowedScore:
    lost = sum(run.lost for run in runs)
    if lost:
        return FollowedScore(cost=None, d_rms_m=None, sync_rms_m=None, e_rho_rms_m=None, lost=lost)
    target = waypoints.trajectory(LoopSettings().position_period)
    rated = [rate(run, waypoints, robot) for run in runs]
    d_rms, sync, e_rho = (float(np.mean([r[m] for r in rated])) for m in ("d_rms_m", "sync_rms_m", "e_rho_rms_m"))
    cost = float(np.mean(costs_of(runs, target, waypoints.rms_speed, SAME_COST)))
    return FollowedScore(cost=cost, d_rms_m=d_rms, sync_rms_m=sync, e_rho_rms_m=e_rho, lost=0)
