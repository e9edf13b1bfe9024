"""The problem of a tuning: points of the unit cube in, costs of closed loops along references out."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ssmr.control.laws import LAWS
from ssmr.control.loop import LoopSettings
from ssmr.control.waypoints import Waypoints
from ssmr.parameters import described
from ssmr.search.space import ParameterSpace, declared
from ssmr.types import FloatArray, Trajectory
from validation.bench.gains import GainSet
from validation.bench.loops import AnyController, ClosedLoopRobot, make_controller, rate, run_robots
from validation.bench.mismatch import Mismatch, mismatched, worst_mean
from validation.plants.profile import Profile
from validation.simulator.plant import MujocoPlant
from validation.tune.cost import GUARD_DISTANCE, TuneCost, costs_of
from validation.tune.data import Followed, TunedRun


def make_tuning_space(
    controller: str,
    free: Sequence[str] | None,
    everything: bool,
    bounds: Mapping[str, tuple[float, float]],
    fixed: Collection[str] = (),
    start: Mapping[str, float] | None = None,
) -> ParameterSpace:
    """Return the gains that are searched, with their usual bounds or those given.

    They are those that are free, or the usual ones, or `everything`, also what the thesis sets by hand; without the fixed.
    Usual bounds that leave out the gains to `start` with are widened beyond them.

    Raises:
        ValueError: an unknown gain, bounds for a gain that is not free, or bounds that make no sense or leave out the start.
    """
    law = LAWS[controller]
    known = {name: d for name, d in described(law.gains).items() if d.search is not None}
    rest = [name for name in known if everything and name not in law.searched]
    names = [name for name in ((*law.searched, *rest) if free is None else free) if name not in fixed]
    for name in (*names, *bounds):
        if name not in known:
            raise ValueError(f"{controller} has no gain '{name}' to tune; there are: {', '.join(known)}")
        if name not in names:
            raise ValueError(f"bounds are given for {name}, which is not free")
    found = []
    for name in names:
        usual = declared(known[name], bounds.get(name))
        value = usual.lower if start is None else start[name]
        if usual.lower <= value <= usual.upper:
            found.append(usual)
        elif name in bounds:
            own = f"the bounds of {name}, {usual.lower:g} to {usual.upper:g}, leave out {value:g}, where the search begins"
            raise ValueError(f"{own}; widen them, begin with other gains, or begin from scratch")
        else:
            found.append(
                replace(usual, lower=min(usual.lower, _rounded(0.5 * value)), upper=max(usual.upper, _rounded(1.5 * value)))
            )
    return ParameterSpace(tuple(found))


def _rounded(value: float) -> float:
    """Return a number with two digits, which a table and a picture have room for."""
    return float(f"{value:.2g}")


def widened_sentences(controller: str, space: ParameterSpace, start: Mapping[str, float]) -> list[str]:
    """Return a sentence for each gain whose usual bounds had to be widened to hold the `start`."""
    usual = described(LAWS[controller].gains)
    out = []
    for p in space.parameters:
        low, high = usual[p.name].search or (p.lower, p.upper)
        value = start[p.name]
        wide = (low, _rounded(1.5 * value)) if value > high else (_rounded(0.5 * value), high)
        if not low <= value <= high and (p.lower, p.upper) == wide:
            was = f"its usual bounds, {low:g} to {high:g}, leave out {p.text(value)}, which the search began with"
            out.append(f"{p.name} was searched from {p.lower:g} to {p.upper:g}: {was}.")
    return out


@dataclass(frozen=True, eq=False)
class TuneCase:
    """One robot on one reference."""

    label: str
    """Reference, speed and plant in words: `generic at 0.25 m/s, improved`."""
    reference: str
    """The reference as the user named it."""
    waypoints: Waypoints
    """The reference itself."""
    robot: ClosedLoopRobot
    """The plant."""
    settings: LoopSettings
    """Feedback, noise, disturbance and periods of the loop."""

    @property
    def target(self) -> Trajectory:
        """The whole reference, sampled at the ticks of the position loop."""
        return self.waypoints.trajectory(self.settings.position_period)


def delayed(robot: ClosedLoopRobot, more: float) -> ClosedLoopRobot:
    """Return the same robot, on the same ground and with the same physics, that acts on its commands `more` later [s]."""
    late = replace(robot.drive, delay_v=robot.drive.delay_v + more, delay_w=robot.drive.delay_w + more)
    body = robot.body
    slow = body.with_drive(late) if isinstance(body, MujocoPlant) else replace(body, drive=late)
    return replace(robot, body=slow, known=robot.known or robot.drive)  # no controller knows of the delay


class TuneProblem:
    """A `SearchProblem`: how well candidates for a controller's gains follow references."""

    def __init__(
        self,
        profile: Profile,
        base: GainSet,
        space: ParameterSpace,
        cases: Sequence[TuneCase],
        cost: TuneCost,
        shipped: GainSet | None = None,
        mismatches: Sequence[Mismatch] = (),
    ) -> None:
        """Sample the references, and delay each robot for the stability guard, or make the robots with `mismatches`.

        The profile gives model-based laws their model; the tuned gains are compared with those of `base`, and with those
        that are `shipped` if these are others. With mismatches, costs are means over the worst fifth of those robots.
        """
        self.profile, self.base, self.space, self.cases, self.cost = profile, base, space, tuple(cases), cost
        self.shipped, self.mismatches = shipped, tuple(mismatches)
        self._seeds = cost.seeds or (0,)
        self._targets = [case.target for case in self.cases]
        guarded = cost.guard > 0.0 and not self.mismatches
        self._late = [delayed(case.robot, cost.guard) if guarded else None for case in self.cases]
        drawn = {
            name: [mismatched(profile, name, m) for m in self.mismatches] for name in {c.robot.name for c in self.cases}
        }
        self._robots = [drawn[case.robot.name] or [case.robot] for case in self.cases]

    def gains(self, point: FloatArray) -> GainSet:
        """Return all gains that an (n,) point of the unit cube stands for."""
        found = dict(zip(self.space.names, map(float, self.space.values(point)), strict=True))
        return GainSet(self.base.controller, "tuned", {**self.base.values, **found})

    def controller(self, point: FloatArray) -> AnyController | None:
        """Return the law that an (n,) point stands for; None where there is none."""
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
        """Rate candidates case by case, see `SearchProblem.costs`.

        Returns:
            (S,) means over the cases, and over the worst fifth of drawn robots; infinite for a candidate that loses a
            reference, or fails the guard.
        """
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            laws = [self.controller(p) for p in points]
        bounds = np.full(len(points), np.inf) if limits is None else limits * len(self.cases)
        sums = np.tile([np.inf if law is None else 0.0 for law in laws], (len(self._robots[0]), 1))  # by robot
        total = float(sum(case.waypoints.duration for case in self.cases))
        done = 0.0
        for k, case in enumerate(self.cases):
            worst, share, driven = worst_mean(sums), case.waypoints.duration / total, itertools.count(1)

            def on_robot(begun: float = done, part: float = share / len(sums), driven: Iterator[int] = driven) -> None:
                if on_share is not None:
                    on_share(begun + part * next(driven))

            live = [i for i in range(len(points)) if np.isfinite(worst[i]) and (k == 0 or worst[i] <= bounds[i])]
            if live:
                sums[:, live] += self._case_costs(k, [law for i in live if (law := laws[i])], workers, on_robot=on_robot)
            done += share
            if on_share is not None and not live:
                on_share(done)
        return worst_mean(sums) / len(self.cases)

    def _case_costs(
        self,
        k: int,
        laws: Sequence[AnyController],
        workers: int,
        searching: bool = True,
        on_robot: Callable[[], object] | None = None,
    ) -> FloatArray:
        """Return the (R, S) costs of candidates with each robot on one case, means over the seeds.

        In a search the guard is asked, and a candidate that lost one robot is not driven on: its costs with the next are
        infinite.
        """
        case, late = self.cases[k], self._late[k]
        found = np.full((len(self._robots[k]), len(laws)), np.inf)
        kept = list(range(len(laws)))
        for row, robot in zip(found, self._robots[k], strict=True):
            if kept:
                row[kept] = self._robot_costs(k, robot, [laws[i] for i in kept], workers)
            kept = [i for i in kept if np.isfinite(row[i])] if searching else kept
            if on_robot is not None:
                on_robot()
        if late is not None and searching and kept:
            some, around = [laws[i] for i in kept], [case.settings] * len(kept)
            runs = run_robots([late] * len(kept), some, around, case.waypoints, self._seeds[:1], workers)
            for i, run in zip(kept, runs, strict=True):
                if run.lost or float(np.abs(run.column("e_rho")).max()) > GUARD_DISTANCE:
                    found[:, i] = np.inf
        return found

    def _robot_costs(self, k: int, robot: ClosedLoopRobot, laws: Sequence[AnyController], workers: int) -> FloatArray:
        """Return the (S,) costs of candidates with one robot on one case, the means over the seeds."""
        case, found, n = self.cases[k], np.zeros(len(laws)), len(laws)
        for seed in self._seeds:
            runs = run_robots([robot] * n, laws, [case.settings] * n, case.waypoints, [seed], workers)
            found += costs_of(runs, self._targets[k], case.waypoints.rms_speed, self.cost, workers) / len(self._seeds)
        return found

    def costs_by_robot(self, gains: GainSet, workers: int, guarded: bool = False) -> FloatArray:
        """Return the (R,) costs of gains with each robot, means over the cases; infinite where they lose a reference.

        With the guard, all are infinite where they lose one robot, or fail it.
        """
        law = make_controller(self.profile, gains)
        costs = [self._case_costs(k, [law], workers, guarded)[:, 0] for k in range(len(self.cases))]
        return np.asarray(np.mean(costs, axis=0))

    def cost_of(self, gains: GainSet, workers: int, guarded: bool = False) -> float:
        """Return the cost of gains, by default without the guard; infinite where they lose a reference or fail the guard."""
        return float(worst_mean(self.costs_by_robot(gains, workers, guarded)))

    def compared(self, case: TuneCase, tuned: GainSet, workers: int) -> TunedRun:
        """Drive one case with the tuned gains, those of before and the shipped ones, with the first seed's noise."""
        sets = [tuned, self.base, *([] if self.shipped is None else [self.shipped])]
        laws, n = [make_controller(self.profile, gains) for gains in sets], len(sets)
        runs = run_robots([case.robot] * n, laws, [case.settings] * n, case.waypoints, self._seeds[:1], workers)
        costs = costs_of(runs, case.target, case.waypoints.rms_speed, self.cost)
        followed = [
            Followed(run, rate(run, case.waypoints, case.robot), float(cost)) for run, cost in zip(runs, costs, strict=True)
        ]
        return TunedRun(case.label, case.reference, case.waypoints.speed, case.robot.name, case.target, *followed)

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name."""
        return {
            "controller": self.base.controller,
            "gains that are held": sorted((k, v) for k, v in self.base.values.items() if k not in self.space.names),
            "parameters or bounds": self.space.limits(),
            "robot": self.profile.robot.as_document(),
            "profile": [(name, plant.numbers()) for name, plant in sorted(self.profile.plants.items())],
            "references or plants": [
                (c.reference, c.robot.name, repr(c.robot.terrain), c.waypoints.t.tobytes(), c.waypoints.xy.tobytes())
                for c in self.cases
            ],
            "feedback, noise or disturbance": [repr(case.settings) for case in self.cases],
            "robots": [asdict(m) for m in self.mismatches],
            "cost": asdict(self.cost),
        }
