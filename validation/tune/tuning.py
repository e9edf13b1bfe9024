"""What a tuning makes small: closed loops along references, rated by the thesis' costs; and its outcome as a result."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args

import numba
import numpy as np
from threadpoolctl import threadpool_limits

from ssmr._jit import jit_parallel
from ssmr.control.laws import Controller
from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.metrics.paths import BENDING_FLOOR, bend_ratio_kernel, bending_energy, one_sided_kernel
from ssmr.parameters import require_in_range
from ssmr.search.jde import JdeSettings
from ssmr.search.space import Parameter, ParameterSpace
from ssmr.types import FloatArray, Trajectory
from validation import store
from validation.fit.result import FittedParameter
from validation.fit.search import Search
from validation.plants.profile import Profile
from validation.robots.plant import MujocoPlant
from validation.track.gains import GainSet
from validation.track.tracking import Robot, make_controller, rate, run_robots
from validation.tune.result import Followed, TuneResult

CostName = Literal["path", "time"]
PUBLISHED_BOUNDS: Mapping[str, Mapping[str, tuple[float, float, str]]] = {
    "pid": {
        **{f"k_p_{e}": (0.0, 6.0, u) for e, u in (("rho", "1/s"), ("y", "rad/(m s)"), ("alpha", "1/s"))},
        **{f"k_i_{e}": (0.0, 2.0, u) for e, u in (("rho", "1/s2"), ("y", "rad/(m s2)"), ("alpha", "1/s2"))},
        **{f"k_{b}_{e}": (0.0, 2.0, u) for e in ("u", "w") for b, u in (("p", "1"), ("i", "1/s"))},
    },
    "lqr": {
        "q_x": (2.0, 5.0, "1/m2"),
        "q_v": (0.0, 0.05, "s2/m2"),
        "q_yaw": (5.0, 15.0, "1/rad2"),
        "q_w": (0.0, 0.1, "s2/rad2"),
        "r_v": (0.3, 0.7, "s2/m2"),
        "r_w": (0.4, 0.9, "s2/rad2"),
    },
}
"""Search ranges of Tab. 4.4 and 4.21, with units."""
SEARCHED: Mapping[str, Mapping[str, tuple[float, float, str]]] = {
    **PUBLISHED_BOUNDS,
    "lqr-scheduled": {
        **{q: (0.01, 100.0, "1/m2") for q in ("q_x", "q_y")},
        "q_alpha": (0.01, 100.0, "1/rad2"),
        "q_v": (0.0, 10.0, "s2/m2"),
        "q_w": (0.0, 10.0, "s2/rad2"),
        "r_w": (0.05, 10.0, "s2/rad2"),
    },
    "smc": {
        "k_x": (0.0, 6.0, "1/s"),
        "eta_x": (0.0, 0.5, "m/s"),
        "phi_x": (0.005, 0.5, "m"),
        "slope": (0.2, 10.0, "rad/m"),
        "k_a": (0.0, 10.0, "1/s"),
        "eta_a": (0.0, 2.0, "rad/s"),
        "phi_a": (0.02, 1.0, "rad"),
    },
}
"""What is searched unless the user says otherwise, with bounds and units."""
BESIDE: Mapping[str, Mapping[str, tuple[float, float, str]]] = {
    "pid": {"ff_u": (0.0, 2.0, "1"), "ff_w": (0.0, 2.0, "1")},
    "lqr": {"k_alpha": (0.0, 3.0, "1"), "k_y": (0.0, 3.0, "rad/m"), "k_i_rho": (0.0, 0.5, "1/s")},
    "lqr-scheduled": {"r_v": (0.05, 10.0, "s2/m2"), "k_i_rho": (0.0, 0.5, "1/s")},
    "smc": {
        **{f"k_{b}_{e}": (0.0, 2.0, u) for e in ("u", "w") for b, u in (("p", "1"), ("i", "1/s"))},
        "ff_u": (0.0, 2.0, "1"),
        "ff_w": (0.0, 2.0, "1"),
    },
}
"""What the thesis sets by hand, and its like of the other controllers; searched too with `--all`."""


@dataclass(frozen=True)
class TuneCost:
    """What is made small, over all references and plants together."""

    name: CostName = "path"
    """`path`: the thesis' (Sec. 4.3.3, 4.4.3), blind to time; `time`: errors at equal times in the place of distances
    between paths, which the thesis wishes for (Sec. 5)."""
    k_rms: float = 100.0
    """Of d_rms, or of the RMS position error at equal times [1/m]; Tab. 4.3, 4.20."""
    k_haus: float = 15.0
    """Of d_haus, or of the greatest position error at equal times [1/m]."""
    k_ratio: float = 10.0
    """Of |1 - d_ratio|."""
    k_bend: float = 10.0
    """Of |1 - e_bend_ratio|."""
    k_u: float = 0.0
    """Of |1 - u_RMS|, the speed's RMS over the reference's mean speed; 50 for the LQR (Tab. 4.20)."""
    guard: float = 0.1
    """Stability guard: with so much more delay [s] the robot must still stay within `GUARD_DISTANCE` of its target; 0 is
    off."""
    seeds: tuple[int, ...] = (0,)
    """Of noise and disturbance; the cost is the mean over them."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: an unknown cost, a negative weight, no seed.
        """
        if self.name not in get_args(CostName):
            raise ValueError(f"unknown cost '{self.name}'; there are: {', '.join(get_args(CostName))}")
        for weight in ("k_rms", "k_haus", "k_ratio", "k_bend", "k_u", "guard"):
            require_in_range(self, weight, 0.0, 1e6)
        if not self.seeds:
            raise ValueError("a cost needs at least one seed")


GUARD_DISTANCE = 1.0
"""See `TuneCost.guard` [m]."""


@dataclass(frozen=True, eq=False)
class Case:
    """One robot on one reference."""

    label: str
    """In words: `generic at 0.25 m/s, improved`."""
    reference: str
    """As the user named it."""
    waypoints: Waypoints
    """The reference."""
    robot: Robot
    """The plant."""
    settings: LoopSettings
    """What stands around it."""


@jit_parallel
def _path_measures(poses, truth):
    """(S, 4) d_rms, d_haus, d_ratio and e_bend_ratio of (S, M, 3) poses against (N, 3)."""
    out = np.empty((len(poses), 4))
    for i in numba.prange(len(poses)):
        out[i, 0], out[i, 1], out[i, 2] = one_sided_kernel(poses[i], truth)
        out[i, 3] = bend_ratio_kernel(poses[i], truth)
    return out


def costs_of(runs: Sequence[ClosedRun], target: Trajectory, speed: float, cost: TuneCost) -> FloatArray:
    """(S,) costs of runs along one reference; infinite for a robot that was lost."""
    out = np.full(len(runs), np.inf)
    kept = [i for i, run in enumerate(runs) if not run.lost]
    if not kept:
        return out
    poses = np.array([runs[i].table[:, :3] for i in kept])
    measures = _path_measures(poses, target.pose)
    d_rms, d_haus = measures[:, 0], measures[:, 1]
    if cost.name == "time":
        apart = np.hypot(*np.moveaxis(poses[:, : len(target.t), :2] - target.pose[None, : poses.shape[1], :2], 2, 0))
        d_rms, d_haus = np.sqrt(np.mean(apart**2, axis=1)), apart.max(axis=1)
    u_rms = np.array([np.sqrt(np.mean(runs[i].column("v_x") ** 2)) for i in kept]) / max(speed, 1e-9)
    found = cost.k_rms * d_rms + cost.k_haus * d_haus + cost.k_ratio * np.abs(1.0 - measures[:, 2])
    found += cost.k_u * np.abs(1.0 - u_rms)
    if bending_energy(target.xy) >= BENDING_FLOOR:  # of a straight reference there is no ratio
        found += cost.k_bend * np.abs(1.0 - measures[:, 3])
    out[kept] = np.where(np.isfinite(found), found, np.inf)
    return out


def delayed(robot: Robot, more: float) -> Robot:
    """The same robot, which acts on its commands `more` later [s]."""
    late = replace(robot.drive, delay_v=robot.drive.delay_v + more, delay_w=robot.drive.delay_w + more)
    body = robot.body
    if isinstance(body, MujocoPlant):
        return replace(robot, body=MujocoPlant(body.calibration, late))
    return replace(robot, body=replace(body, drive=late))


class TuneProblem:
    """Everything that turns points of the unit cube into costs."""

    def __init__(
        self, profile: Profile, base: GainSet, space: ParameterSpace, cases: Sequence[Case], cost: TuneCost
    ) -> None:
        """Keep what is to be tuned, and delay each robot for the guard."""
        self.profile, self.base, self.space, self.cases, self.cost = profile, base, space, tuple(cases), cost
        self._targets = [reference_of_case(case) for case in self.cases]
        self._late = [delayed(case.robot, cost.guard) if cost.guard > 0.0 else None for case in self.cases]

    def gains(self, point: FloatArray) -> GainSet:
        """All gains that an (n,) point of the unit cube means."""
        found = dict(zip(self.space.names, map(float, self.space.values(point)), strict=True))
        return GainSet(self.base.controller, "tuned", {**self.base.values, **found})

    def controller(self, point: FloatArray) -> Controller | None:
        """The law that an (n,) point means; None where there is none."""
        try:
            return make_controller(self.profile, self.gains(point))
        except ValueError:
            return None

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int = 1,
        on_share: Callable[[float], object] | None = None,
    ) -> FloatArray:
        """Rate candidates, reference by reference.

        Args:
            points: (S, n) of the unit cube.
            limits: (S,) a candidate whose partial sum exceeds its limit is abandoned; that sum is its answer then.
            workers: threads; the result does not depend on it.
            on_share: told what share of the driving is done.

        Returns:
            (S,) means over the cases, infinite for a candidate that loses one, or fails the guard.
        """
        with threadpool_limits(1, user_api="blas"):
            laws = [self.controller(p) for p in points]
        bounds = np.full(len(points), np.inf) if limits is None else limits * len(self.cases)
        sums = np.array([np.inf if law is None else 0.0 for law in laws])
        total = float(sum(case.waypoints.duration for case in self.cases))
        done = 0.0
        for case, target, late in zip(self.cases, self._targets, self._late, strict=True):
            live = [i for i in range(len(points)) if np.isfinite(sums[i]) and (sums[i] == 0.0 or sums[i] <= bounds[i])]
            if live:
                sums[live] += self._case_costs(case, target, late, [law for i in live if (law := laws[i])], workers)
            done += case.waypoints.duration / total
            if on_share is not None:
                on_share(done)
        return sums / len(self.cases)

    def _case_costs(
        self, case: Case, target: Trajectory, late: Robot | None, laws: Sequence[Controller], workers: int
    ) -> FloatArray:
        """(S,) costs of candidates on one case, the mean over the seeds."""
        cost, found = self.cost, np.zeros(len(laws))
        n = len(laws)
        for seed in cost.seeds:
            runs = run_robots([case.robot] * n, laws, [case.settings] * n, case.waypoints, [seed], workers)
            found += costs_of(runs, target, case.waypoints.speed, cost) / len(cost.seeds)
        if late is not None:
            some = [i for i in range(n) if np.isfinite(found[i])]
            if some:
                again = run_robots(
                    [late] * len(some), [laws[i] for i in some], [case.settings] * len(some), case.waypoints,
                    cost.seeds[:1], workers,
                )  # fmt: skip
                for i, run in zip(some, again, strict=True):
                    if run.lost or float(np.abs(run.column("e_rho")).max()) > GUARD_DISTANCE:
                        found[i] = np.inf
        return found

    def identity(self, settings: JdeSettings, seed: int, start: FloatArray | None) -> dict[str, str]:
        """Digests of all that decides a search's outcome, by what they are of."""
        plain = {
            "controller": self.base.controller,
            "gains that are held": sorted((k, v) for k, v in self.base.values.items() if k not in self.space.names),
            "parameters or bounds": [(p.name, p.lower, p.upper, p.scale) for p in self.space.parameters],
            "profile": [(name, asdict(plant)) for name, plant in sorted(self.profile.plants.items())],
            "references or plants": [
                (
                    case.reference,
                    case.robot.name,
                    case.waypoints.t.tobytes(),
                    case.waypoints.xy.tobytes(),
                    repr(case.settings),
                )
                for case in self.cases
            ],
            "cost": asdict(self.cost),
            "settings of the search": asdict(settings),
            "start": None if start is None else start.tolist(),
            "seed": seed,
        }
        return {name: hashlib.sha256(repr(value).encode()).hexdigest() for name, value in plain.items()}


def reference_of_case(case: Case) -> Trajectory:
    """The whole reference of a case, sampled at the ticks of the position loop."""
    return case.waypoints.trajectory(case.settings.position_period)


def make_tuning_space(
    controller: str, free: Sequence[str] | None, everything: bool, bounds: Mapping[str, tuple[float, float]]
) -> ParameterSpace:
    """The gains that are searched, with default bounds or those given.

    Raises:
        ValueError: an unknown gain, bounds for what is not free, or bounds that make no sense.
    """
    known = {**SEARCHED[controller], **BESIDE.get(controller, {})}
    names = list(free) if free is not None else list(known if everything else SEARCHED[controller])
    for name in (*names, *bounds):
        if name not in known:
            raise ValueError(f"{controller} has no gain '{name}' to tune; there are: {', '.join(known)}")
    for name in bounds:
        if name not in names:
            raise ValueError(f"bounds are given for {name}, which is not free")
    return ParameterSpace(tuple(Parameter(name, known[name][2], *bounds.get(name, known[name][:2])) for name in names))


def follow(problem: TuneProblem, case: Case, tuned: GainSet, workers: int) -> Followed:
    """One case with the tuned gains and with the baseline's, the first seed's noise."""
    target = reference_of_case(case)
    runs, measures, costs = [], [], []
    for gains in (tuned, problem.base):
        law = make_controller(problem.profile, gains)
        (run,) = run_robots([case.robot], [law], [case.settings], case.waypoints, problem.cost.seeds[:1], workers)
        runs.append(run)
        measures.append(rate(run, case.waypoints, case.robot))
        costs.append(float(costs_of([run], target, case.waypoints.speed, problem.cost)[0]))
    return Followed(
        case.label, case.reference, case.waypoints.speed, case.robot.name, target, runs[0], measures[0], costs[0], runs[1],
        measures[1], costs[1],
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Asked:
    """What a tuning was asked for, besides its problem."""

    held_out: tuple[Case, ...]
    """What it is judged on."""
    seed: int
    """Of the search."""
    options: Mapping[str, object]
    """For the record."""


def conclude(search: Search, problem: TuneProblem, asked: Asked, workers: int) -> TuneResult:
    """Make of a search's outcome a result.

    Raises:
        SsmrError: no candidate kept its references.
    """
    jde = search.jde
    if not np.isfinite(jde.best_cost):
        raise SsmrError("every candidate lost a reference or failed the stability guard; look at --bounds and --guard")
    tuned = problem.gains(jde.best)
    baseline = TuneProblem(problem.profile, problem.base, problem.space, problem.cases, replace(problem.cost, guard=0.0))
    law = make_controller(problem.profile, problem.base)
    before = [float(baseline._case_costs(case, reference_of_case(case), None, [law], workers)[0]) for case in problem.cases]
    train = tuple(follow(problem, case, tuned, workers) for case in problem.cases)
    held_out = tuple(follow(problem, case, tuned, workers) for case in asked.held_out)
    values, at_bound = problem.space.values(jde.best), problem.space.at_bound(jde.best)
    parameters = tuple(
        FittedParameter(p.name, p.unit, float(v), p.lower, p.upper, p.scale, float(problem.base.values[p.name]), bool(b))
        for p, v, b in zip(problem.space.parameters, values, at_bound, strict=True)
    )
    return TuneResult(
        controller=problem.base.controller,
        profile=problem.profile.name,
        seed=asked.seed,
        status="interrupted" if search.interrupted else "finished",
        stopped_by=jde.finished or "interrupt",
        cost=float(jde.best_cost),
        baseline_name=problem.base.name,
        baseline_cost=float(np.mean(before)),
        cost_name=problem.cost.name,
        evaluations=jde.evaluations,
        generations=jde.generation,
        wall_s=search.wall_s,
        parameters=parameters,
        gains=dict(tuned.values),
        notes=tuple(_notes(parameters, (*train, *held_out))),
        train=train,
        held_out=held_out,
        trace=search.trace(),
        options=asked.options,
        versions=store.versions(),
    )


def _notes(parameters: Sequence[FittedParameter], followed: Sequence[Followed]) -> list[str]:
    """What a user of the gains must know, in plain words."""
    out = []
    for p in parameters:
        if p.at_bound:
            end, bound = ("lower", p.lower) if p.value - p.lower < p.upper - p.value else ("upper", p.upper)
            out.append(f"{p.name} ended at its {end} bound, {bound:g} {p.unit}: widen its --bounds, or fix it.")
    for f in followed:
        if f.tuned.lost:
            out.append(f"The tuned gains lose {f.label}, after {f.tuned.t[-1]:.1f} s.")
    return out


def tuned_gains(result: TuneResult, name: str, date: str) -> GainSet:
    """The found gains as a set with provenance."""
    worse: dict[str, Any] = {
        f.label: {"d_rms_m": f.tuned_metrics.path.d_rms_m, "cost": f.tuned_cost}
        for f in (*result.train, *result.held_out)
        if not f.tuned.lost
    }
    return GainSet(
        result.controller,
        name,
        result.gains,
        {
            "tuned_on": [f.label for f in result.train],
            "searched": [p.name for p in result.parameters],
            "by_hand": [n for n in result.gains if n not in {p.name for p in result.parameters}],
            "profile": result.profile,
            "cost_name": result.cost_name,
            "cost": result.cost,
            "baseline": result.baseline_name,
            **({"baseline_cost": result.baseline_cost} if np.isfinite(result.baseline_cost) else {}),
            "status": result.status,
            "seed": result.seed,
            "evaluations": result.evaluations,
            "generations": result.generations,
            "date": date,
            "options": {k: v for k, v in result.options.items() if v is not None},
            "versions": dict(result.versions),
            "followed": worse,
        },
        f"tuned by python -m validation.tune on {', '.join(f.label for f in result.train)}",
    )
