"""The problem of a tuning: gains as points of the unit cube in, costs of closed loops out."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ssmr._jit import jit_alone, share_among_threads
from ssmr.control.laws import LAWS
from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.waypoints import Waypoints
from ssmr.metrics.declared import compare_paths
from ssmr.metrics.paths import (
    BENDING_FLOOR,
    bend_ratio_kernel,
    bending_energy,
    one_sided_kernel,
    path_length,
)
from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.parameters import MOST_SEED, describe_parameters, require_one_of, require_within
from ssmr.search.space import ParameterSpace, declared_parameter
from ssmr.simulation import PlanarModel
from ssmr.types import FloatArray, Trajectory
from validation.experiment.gains import GainSet
from validation.experiment.loops import AnyController, ClosedLoopRobot, make_controller, run_robots
from validation.experiment.tracked import Followed
from validation.identify.problem import OnShare
from validation.plants.profile import Profile
from validation.simulator.plant import MujocoPlant
from validation.workers import rate_there

TuneMeasure = Literal["metres", "path", "time"]
"""Measure of a tuning, see `TuneCost`."""
TARGET_SHARE = 0.1
"""Weight of the distance to the moving target in the measure `metres`, beside that to the path: a
robot that keeps to its path and comes late is preferred to one that hurries and leaves it."""
_GUARD_DISTANCE = 1.0
"""Distance from its target within which the robot must stay for the stability guard [m]."""


@dataclass(frozen=True)
class TuneCost:
    """The cost that a tuning makes small, over all references and plants together."""

    cost: TuneMeasure = "path"
    """metres: d_rms and `TARGET_SHARE` of the RMS distance to the moving target; path (Sec. 4.3.3,
    4.4.3), which is blind to time; or time: errors at equal times in the place of distances between
    paths (Sec. 5)."""
    guard: float = 0.1
    """Candidates that lose the reference with this much more delay are refused [s]; 0 turns this
    off."""
    worse_path: float = 1.1
    """Candidates whose path error is greater than so many times that of the gains before are
    refused, whatever they cost; infinite where none are."""
    seed: int = 0
    """Seed of noise and disturbance."""
    k_rms: float = 100.0
    """Weight of d_rms, or of the RMS position error at equal times [1/m]; Tab. 4.3, 4.20."""
    k_haus: float = 15.0
    """Weight of d_haus, or of the greatest position error at equal times [1/m]."""
    k_ratio: float = 10.0
    """Weight of |1 - d_ratio|."""
    k_bend: float = 10.0
    """Weight of |1 - e_bend_ratio|."""
    k_u: float = 0.0
    """Weight of |1 - u_RMS|, the speed's RMS over that of the reference; Tab. 4.20 has 50 for the
    LQR."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a guard or seed out of its range."""
        require_within(self, ("guard",), 0.0, 10.0)
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)


@jit_alone
def _path_measures(poses, truth, out):
    """Write (S, 4) d_rms, d_haus, d_ratio and e_bend_ratio of (S, M, 3) poses against (N, 3)."""
    length = path_length(truth)
    for i in range(len(poses)):
        out[i, 0], out[i, 1], out[i, 2] = one_sided_kernel(poses[i], truth, length)
        out[i, 3] = bend_ratio_kernel(poses[i], truth)


def costs_of(
    runs: Sequence[ClosedRun],
    target: Trajectory,
    speed: float,
    cost: TuneCost,
    workers: int = 1,
    worst: float = math.inf,
) -> FloatArray:
    """Return the (S,) costs of runs along one reference; infinite where a robot was lost.

    Args:
        runs: S runs.
        target: the reference at their ticks.
        speed: RMS of the reference's speed [m/s].
        cost: what counts.
        workers: threads; the costs do not depend on their number.
        worst: a greater path error costs infinity [m].
    """
    out = np.full(len(runs), np.inf)
    kept = [i for i, run in enumerate(runs) if not run.lost]
    if not kept:
        return out
    poses = np.array([runs[i].table[:, :3] for i in kept])
    measures = np.empty((len(poses), 4))

    def write(i: int, k: int) -> None:
        _path_measures(poses[i:k], target.pose, measures[i:k])

    share_among_threads(write, len(poses), workers)
    d_rms = measures[:, 0]
    d_haus = measures[:, 1]
    refused = d_rms > worst
    if cost.cost != "path":
        # the run may go on after the reference's end, or stop before it
        errors = poses[:, : len(target.t), :2] - target.pose[None, : poses.shape[1], :2]
        apart = np.hypot(*np.moveaxis(errors, 2, 0))
        behind = np.sqrt(np.mean(apart**2, axis=1))
        if cost.cost == "metres":
            out[kept] = np.where(refused, np.inf, d_rms + TARGET_SHARE * behind)
            return out
        d_rms = behind
        d_haus = apart.max(axis=1)
    speeds = np.array([np.sqrt(np.mean(runs[i].column("v_x") ** 2)) for i in kept])
    u_rms = speeds / max(speed, 1e-9)
    costs = cost.k_rms * d_rms + cost.k_haus * d_haus + cost.k_ratio * np.abs(1.0 - measures[:, 2])
    costs += cost.k_u * np.abs(1.0 - u_rms)
    if bending_energy(target.xy) >= BENDING_FLOOR:  # a straight reference has no ratio
        costs += cost.k_bend * np.abs(1.0 - measures[:, 3])
    out[kept] = np.where(np.isfinite(costs) & ~refused, costs, np.inf)
    return out


def make_tuning_space(
    controller: str,
    free: Sequence[str] | None,
    everything: bool,
    bounds: Mapping[str, tuple[float, float]],
    fixed: Collection[str] = (),
    start: Mapping[str, float] | None = None,
) -> ParameterSpace:
    """Return the gains that are searched, with their default bounds or those given.

    They are those that are free, or the default ones, or `everything`, also those that the thesis
    sets by hand; without the fixed. Default bounds that leave out the gains to `start` with are
    widened beyond them.

    Raises:
        ValueError: an unknown gain, bounds for a gain that is not free, or bounds that make no
            sense or leave out the start.
    """
    law = LAWS[controller]
    searchable = {
        name: d for name, d in describe_parameters(law.gains).items() if d.search is not None
    }
    if free is None:
        free = law.searched
        if everything:
            free = (*free, *(name for name in searchable if name not in free))
    names = [name for name in free if name not in fixed]
    for name in (*names, *bounds):
        require_one_of(name, searchable, f"{controller} has no gain '{name}' to tune")
        if name not in names:
            raise ValueError(f"bounds are given for {name}, which is not free")
    parameters = []
    for name in names:
        parameter = declared_parameter(searchable[name], bounds.get(name))
        value = parameter.lower if start is None else start[name]
        # gains to begin with may lie outside the default bounds
        if not parameter.lower <= value <= parameter.upper:
            if name in bounds:
                raise ValueError(
                    f"the bounds of {name}, {parameter.lower:g} to {parameter.upper:g}, leave out "
                    f"{value:g}, where the search begins; widen them, begin with other gains, or "
                    "begin from scratch"
                )
            # two digits, for tables and pictures
            low, high = (float(f"{share * value:.2g}") for share in (0.5, 1.5))
            parameter = replace(
                parameter, lower=min(parameter.lower, low), upper=max(parameter.upper, high)
            )
        parameters.append(parameter)
    return ParameterSpace(tuple(parameters))


@dataclass(frozen=True, eq=False)
class TuneCase:
    """One robot on one reference, and how the loop is closed."""

    label: str
    """Label in words, such as `generic at 0.25 m/s, improved`."""
    reference: str
    """Name or file of the reference."""
    waypoints: Waypoints
    """The reference."""
    robot: ClosedLoopRobot
    """The robot that follows it."""
    settings: LoopSettings
    """Feedback, noise and disturbance."""

    @property
    def target(self) -> Trajectory:
        """The whole reference, sampled at the ticks of the position loop."""
        return self.waypoints.trajectory(self.settings.position_period)


def delay_robot(robot: ClosedLoopRobot, more: float) -> ClosedLoopRobot:
    """Return the same robot in the same place, acting on its commands `more` later [s].

    Raises:
        ValueError: its plant is another engine's or a description by others.
    """
    drive = robot.drive
    late = replace(drive, delay_v=drive.delay_v + more, delay_w=drive.delay_w + more)
    body = robot.body
    if isinstance(body, MujocoPlant):
        body = MujocoPlant(body.calibration, late, terrain=body.terrain, settings=body.settings)
    elif isinstance(body, FourWheelPlant):
        body = FourWheelPlant(body.parameters, late)
    elif isinstance(body, PlanarModel):
        body = replace(body, drive=late)
    else:
        raise ValueError(f"plant '{robot.name}' cannot be made to answer later")
    return replace(robot, body=body, known=robot.known or drive)  # no controller knows of the delay


class TuneProblem:
    """Problem of a tuning: gains are rated by how well a controller follows references."""

    def __init__(
        self,
        profile: Profile,
        base: GainSet,
        space: ParameterSpace,
        cases: Sequence[TuneCase],
        cost: TuneCost,
    ) -> None:
        """Sample the references, and delay each robot for the stability guard.

        The profile gives model-based laws their model, and `base` the gains that are not searched.
        """
        self.profile = profile
        self.base = base
        self.space = space
        self.cases = tuple(cases)
        self.cost = cost
        self._targets = [case.target for case in self.cases]
        self._late: list[ClosedLoopRobot] = []
        if cost.guard > 0.0:
            self._late = [delay_robot(case.robot, cost.guard) for case in self.cases]

    @cached_property
    def _worst(self) -> list[float]:
        """Greatest path error that is not refused, by case [m]."""
        worst = []
        if not math.isfinite(self.cost.worse_path):
            return [math.inf] * len(self.cases)
        law = make_controller(self.profile, self.base)
        for case, target in zip(self.cases, self._targets, strict=True):
            (run,) = self._runs(case, case.robot, [law], 1)
            error = math.inf
            if not run.lost:
                error = self.cost.worse_path * compare_paths(run.motion, target)["d_rms_m"]
            worst.append(error)
        return worst

    def gains(self, point: FloatArray) -> GainSet:
        """Return all gains that an (n,) point of the unit cube stands for."""
        values = dict(zip(self.space.names, map(float, self.space.values(point)), strict=True))
        return GainSet(self.base.controller, "tuned", {**self.base.values, **values})

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int | str = 1,
        on_share: OnShare = None,
    ) -> FloatArray:
        """Rate candidates case by case, see `FitProblem.costs`.

        Returns:
            (S,) means over the cases; infinite for a candidate that loses a reference, or fails the
            guard.
        """
        bounds = np.full(len(points), np.inf) if limits is None else limits
        if isinstance(workers, str):
            return rate_there(workers, self, "costs", (points, bounds), on_share)
        # Riccati equations are too small for the threads of a linear algebra library
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            laws = [_controller_with(self.profile, self.gains(point)) for point in points]
        bounds = bounds * len(self.cases)
        sums = np.array([np.inf if law is None else 0.0 for law in laws])
        total = sum(case.waypoints.duration for case in self.cases)
        done = 0.0
        for k, case in enumerate(self.cases):
            # a case before may have failed a candidate, or raised its sum beyond its parent's
            promising = np.isfinite(sums) & ((k == 0) | (sums <= bounds))
            live = np.flatnonzero(promising)
            if len(live):
                drivers = [law for i in live if (law := laws[i])]
                # rounding shall not spare one that wins
                most = bounds[live] * (1.0 + 1e-9) - sums[live]
                sums[live] += self._case_costs(k, drivers, workers, most)
            done += case.waypoints.duration / total
            if on_share is not None:
                on_share(done)
        return sums / len(self.cases)

    def _case_costs(
        self,
        k: int,
        laws: Sequence[AnyController],
        workers: int,
        most: FloatArray | float = -math.inf,
    ) -> FloatArray:
        """Return the (S,) costs of candidates on one case.

        The guard is asked where a cost is at most (S,) `most`: another one wins nothing in a
        search.
        """
        case = self.cases[k]
        runs = self._runs(case, case.robot, laws, workers)
        searching = np.max(most) > -math.inf
        worst = self._worst[k] if searching else math.inf
        speed = case.waypoints.rms_speed
        costs = costs_of(runs, self._targets[k], speed, self.cost, workers, worst=worst)
        kept = np.flatnonzero(np.isfinite(costs) & (costs <= most)).tolist()
        if self._late and kept:
            runs = self._runs(case, self._late[k], [laws[i] for i in kept], workers)
            for i, run in zip(kept, runs, strict=True):
                if run.lost or np.abs(run.column("e_rho")).max() > _GUARD_DISTANCE:
                    costs[i] = np.inf
        return costs

    def _runs(
        self, case: TuneCase, robot: ClosedLoopRobot, laws: Sequence[AnyController], workers: int
    ) -> Sequence[ClosedRun]:
        """Drive a robot along a case's reference, once with each controller."""
        robots = [robot] * len(laws)
        settings = [case.settings] * len(laws)
        return run_robots(robots, laws, settings, case.waypoints, [self.cost.seed], workers)

    def cost_of(self, gains: GainSet, workers: int, guarded: bool = False) -> float:
        """Return the cost of gains; infinite where they lose a reference or, guarded, fail."""
        law = make_controller(self.profile, gains)
        most = math.inf if guarded else -math.inf
        costs = [self._case_costs(k, [law], workers, most)[0] for k in range(len(self.cases))]
        return float(np.mean(costs))

    def rated(
        self, case: TuneCase, sets: Mapping[str, GainSet], workers: int
    ) -> dict[str, Followed]:
        """Drive one case with several sets of gains; return their runs by the same names."""
        laws = [make_controller(self.profile, gains) for gains in sets.values()]
        runs = self._runs(case, case.robot, laws, workers)
        speed = case.waypoints.rms_speed
        costs = costs_of(runs, case.target, speed, self.cost)
        by_thesis = costs_of(runs, case.target, speed, replace(self.cost, cost="path"))
        rated = {}
        for name, run, cost, thesis in zip(sets, runs, costs, by_thesis, strict=True):
            followed = Followed.of(case.robot.name, run, case.waypoints, case.robot.limits)
            followed.metrics["cost"] = float(cost)
            followed.metrics["thesis_cost"] = float(thesis)
            rated[name] = followed
        return rated

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name."""
        plants = sorted(self.profile.plants.items())
        references = []
        for case in self.cases:
            w = case.waypoints
            place = (case.reference, case.robot.name, repr(case.robot.terrain))
            references.append((*place, w.t.tobytes(), w.xy.tobytes()))
        return {
            "controller": self.base.controller,
            "gains before": sorted(self.base.values.items()),
            "parameters or bounds": self.space.limits(),
            "robot": self.profile.robot.as_document(),
            "profile": [(name, plant.numbers()) for name, plant in plants],
            "references or plants": references,
            "feedback, noise or disturbance": [repr(case.settings) for case in self.cases],
            "cost": asdict(self.cost),
        }


def _controller_with(profile: Profile, gains: GainSet) -> AnyController | None:
    """Return the controller with these gains; None where no controller can have them."""
    try:
        return make_controller(profile, gains)
    except ValueError:
        return None
