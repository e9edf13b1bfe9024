"""Tune a controller's gains by differential evolution."""

from __future__ import annotations

import datetime
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ssmr.control.laws import LAWS
from ssmr.control.loop import LoopSettings
from ssmr.types import FloatArray
from validation.bench.gains import DEFAULT, GainSet, load_gains, names, origin_sentence, shipped_gains
from validation.bench.loops import ClosedLoopRobot, demand_of, make_controller, make_robot, require_practicable
from validation.bench.mismatch import SCORING, TUNING, Mismatch, draw_mismatches
from validation.bench.waypoint_files import open_reference, split_speed
from validation.fit.search import Search, SearchOptions, put_options, search_for
from validation.fit.uncertainty import bound_sentences, found_parameters
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile, choose_profile
from validation.plants.table import SIMULATED
from validation.progress import Progress, Report, silent
from validation.tune.cost import TuneCost
from validation.tune.options import TuneParameters, TuneTask
from validation.tune.problem import TuneCase, TuneProblem, make_tuning_space, widened_sentences
from validation.tune.result import TuneResult

_logger = logging.getLogger(__name__)

_SIMULATED_SIZE = (24, 20)  # population and generations: a simulated run costs a hundred times that of a planar model
HELD_OUT = ("line", "circle", "generic", "slalom", "square", "u-turn", "stop-and-go")
"""References that a tuning is judged on unless others are named: paths of every kind, without those that it is tuned on, at
the greatest speed that it is tuned on."""


def tune(
    controller: str,
    references: str | Sequence[str] = "generic",
    profile: Profile | str | Path | None = None,
    *,
    task: TuneTask | None = None,
    parameters: TuneParameters | None = None,
    cost: TuneCost | None = None,
    search: SearchOptions | None = None,
    progress: Report = silent,
    **options: Any,
) -> TuneResult:
    """Tune a controller by self-adaptive differential evolution (jDE), and compare it with the gains it began with.

    Every field of the four groups of options can be given by its own name too: `tune("lqr", "circle@0.5",
    generations=5, plants=("improved", "mujoco"))`. Ctrl-C ends the search; the result then holds the best found so far.

    Args:
        controller: name of the controller.
        references: the reference it must follow, or several: `generic`, `circle@0.5` with its speed [m/s], or a file's path.
        profile: the plants' parameters, or the name or path of a profile; None for `thesis-lab`, or the robot's own numbers
            if that is of another robot than `robot`.
        task: plants, held-out references, and noise.
        parameters: the gains to search, with their bounds.
        cost: what is made small.
        search: sizes, seed, threads and checkpoint of the search.
        progress: called as the search goes on.
        options: fields of the four groups by name.

    Raises:
        ValueError: a name, number or file that cannot be used; the message says which.
        TypeError: an unknown option.
        SsmrError: every candidate lost a reference or failed the stability guard.
        OSError: the checkpoint cannot be written.
        KeyboardInterrupt: interrupted before any candidate was rated.
    """
    task, parameters, cost, search = put_options(
        options, task or TuneTask(), parameters or TuneParameters(), cost or TuneCost(), search or SearchOptions()
    )
    chosen = choose_profile(profile, task.robot, "thesis-lab")
    base = _base_gains(controller, parameters, chosen)
    begun = None if parameters.from_scratch else base.values
    space = make_tuning_space(controller, parameters.free, parameters.all, parameters.bounds, parameters.fix, begun)
    settings = search.settings(*_usual_size(controller, task.plants))
    plants = [make_robot(chosen, name) for name in task.plants]
    wanted = _references([references] if isinstance(references, str) else references, task.speed)
    if not (cases := _cases(wanted, plants, task.loop())):
        raise ValueError("no reference is named; name one such as generic or circle@0.5")
    held_out = _cases(_judged(task, wanted, cases), plants, task.loop())
    cost = replace(cost, k_u=LAWS[controller].k_u if cost.k_u is None else cost.k_u, seeds=cost.seeds or (search.seed,))
    shipped = shipped_gains(controller, chosen.name)
    other = shipped if shipped is not None and shipped.values != base.values else None
    robots = [draw_mismatches(task.drawn, search.seed, use, chosen.robot) for use in (TUNING, SCORING)]
    problem, said = TuneProblem(chosen, base, space, cases, cost, other, robots[0]), _said(chosen.name, base, cases)
    start = None if begun is None else space.points([base.values[name] for name in space.names])[None]
    found = search_for(problem, settings, search, start, progress)
    threads, total = search.threads, settings.generations + 1
    progress(Progress(total, total, "tuned and earlier gains on every reference"))
    kept = _better(problem, found, begun is not None, threads)
    result = TuneResult(
        controller=controller,
        begun_with=chosen.name,
        robot=chosen.robot.name,
        gain_set=kept.gains,
        seed=search.seed,
        cost_name=cost.cost,
        baseline_name=base.name,
        baseline_cost=kept.baseline_cost,
        shipped_name="" if shipped is None else shipped.name,
        shipped_cost=math.nan if shipped is None else problem.cost_of(shipped, threads),
        **_scored(problem, kept.gains, robots[1], threads),
        worse_than_start=kept.start_cost < kept.cost,
        parameters=found_parameters(space, kept.point, [base.values[name] for name in space.names]),
        remarks=(*said, *kept.remarks, *bound_sentences(space, kept.point)),
        train=tuple(problem.compared(case, kept.gains, threads) for case in cases),
        held_out=tuple(problem.compared(case, kept.gains, threads) for case in held_out),
        options=_record(cost, task, parameters, search.record(settings)),
        **{**found.outcome(), "cost": kept.cost},
    )
    return replace(result, gain_set=_with_provenance(result))


def _scored(problem: TuneProblem, tuned: GainSet, robots: tuple[Mismatch, ...], threads: int) -> dict[str, Any]:
    """Return the robots that a tuning used and has not seen, and what all gains cost with the latter."""
    p = problem
    if not robots:
        return {}
    judge = TuneProblem(p.profile, p.base, p.space, p.cases, p.cost, mismatches=robots)
    sets = {"tuned": tuned, "baseline": p.base, **({} if p.shipped is None else {"shipped": p.shipped})}
    costs = {name: tuple(judge.costs_by_robot(gains, threads).tolist()) for name, gains in sets.items()}
    return {"tuned_on": p.mismatches, "scored_on": robots, "scores": costs}


def _usual_size(controller: str, plants: Sequence[str]) -> tuple[int, int]:
    """Return the usual population and generations of a search."""
    law = LAWS[controller]
    return _SIMULATED_SIZE if any(name in SIMULATED for name in plants) else (law.population, law.generations)


class _Kept(NamedTuple):
    """The gains that a tuning ends with."""

    point: FloatArray
    """(n,) of the unit cube."""
    gains: GainSet
    """All gains."""
    cost: float
    """Their cost, with the guard."""
    start_cost: float
    """Cost of the gains that the search began with, with the guard; infinite where it began from scratch."""
    baseline_cost: float
    """Cost of the gains of before, without the guard."""
    remarks: tuple[str, ...]
    """Sentences on how it came to this."""


def _better(problem: TuneProblem, found: Search, begun: bool, threads: int) -> _Kept:
    """Return the better of what a search found and what it began with, if it did not begin from scratch."""
    base, space, best = problem.base, problem.space, float(found.best_cost_of_all)
    point, before = found.jde.best, problem.cost_of(problem.base, threads)
    if not begun:
        return _Kept(point, problem.gains(point), best, math.inf, before, ())
    least, remarks = problem.cost_of(base, threads, guarded=True), widened_sentences(base.controller, space, base.values)
    if least <= best:
        remarks.append(f"No candidate costs less than {base.name}, with which the search began: those gains are kept.")
        point = space.points([base.values[name] for name in space.names])
        return _Kept(point, base, least, least, before, tuple(remarks))
    if not np.isfinite(least) and np.isfinite(before):
        remarks.append(
            f"{base.name}, with which the search began, fails the stability guard, so the search had to leave it."
        )
    return _Kept(point, problem.gains(point), best, least, before, tuple(remarks))


def _said(profile: str, base: GainSet, cases: Sequence[TuneCase]) -> list[str]:
    """Log, and return, sentences on gains of another profile and on references that ask for more than a robot can do."""
    told = [origin_sentence(base, profile), *(demand_of(c.waypoints, c.robot, profile, c.reference) for c in cases)]
    said = [sentence for sentence in told if sentence is not None]
    for sentence in said:
        _logger.warning(sentence)
    return said


def _judged(task: TuneTask, wanted: Sequence[tuple[str, float]], cases: Sequence[TuneCase]) -> list[tuple[str, float]]:
    """Return names and speeds of the held-out references."""
    if task.held_out is not None:
        return _references(task.held_out, task.speed)
    fastest, tuned_on = max(case.waypoints.speed for case in cases), [name for name, _ in wanted]
    return [(name, fastest) for name in HELD_OUT if name not in tuned_on]


def _base_gains(controller: str, parameters: TuneParameters, profile: Profile) -> GainSet:
    """Return the gains that a tuning begins with: those named, else the published, else the defaults; with those held."""
    if controller not in LAWS:
        raise ValueError(f"unknown controller '{controller}'; there are: {', '.join(LAWS)}")
    published = f"{controller}-published" in names(controller)
    base = load_gains(controller, parameters.gains or ("published" if published else DEFAULT))
    unknown = [name for name in parameters.fix if name not in base.values]
    if unknown:
        raise ValueError(f"{controller} has no gain '{unknown[0]}'; there are: {', '.join(base.values)}")
    base = replace(base, values={**base.values, **parameters.fix}) if parameters.fix else base
    make_controller(profile, base)
    return base


def _references(wanted: Sequence[str], speed: float) -> list[tuple[str, float]]:
    """Return names and speeds [m/s] of references such as `circle@0.5`; `speed` where none is named."""
    pairs = [split_speed(text) for text in wanted]
    return [(name, speed if own is None else own) for name, own in pairs]


def _cases(
    wanted: Sequence[tuple[str, float]], robots: Sequence[ClosedLoopRobot], settings: LoopSettings
) -> tuple[TuneCase, ...]:
    """Return every robot on every reference."""
    out = []
    for name, speed in wanted:
        label, waypoints = open_reference(name, speed)
        for robot in robots:
            require_practicable(waypoints, robot.drive, label)
            around = replace(settings, filter=odometry_of(robot.drive))
            out.append(TuneCase(f"{label} at {waypoints.speed:.3g} m/s, {robot.name}", name, waypoints, robot, around))
    return tuple(out)


def _record(cost: TuneCost, task: TuneTask, parameters: TuneParameters, search: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options as a result file holds them."""
    weights = {"name": cost.cost, **{k: v for k, v in asdict(cost).items() if k not in ("cost", "seeds")}}
    around = task.loop()
    return {
        **weights,
        "noise_seeds": list(cost.seeds or ()),
        "feedback": around.feedback,
        "disturbance": around.disturbance,
        "lookahead_m": around.lookahead,
        "robots": task.robots,
        "fixed": dict(parameters.fix) or None,
        **search,
        "from_scratch": parameters.from_scratch,
    }


def _robust_provenance(result: TuneResult) -> dict[str, Any]:
    """Return what a set of gains says of the drawn robots that it was tuned and scored on."""
    if not result.tuned_on:
        return {}
    kept = {name: [cost for cost in costs if math.isfinite(cost)] for name, costs in result.scores.items()}
    scores = {name: {"lost": len(result.scores[name]) - len(c), "costs": c} for name, c in kept.items()}
    return {"robots": [robot.label for robot in result.tuned_on], "other_robots": scores}


def _with_provenance(result: TuneResult) -> GainSet:
    """Return the tuned gains as a set that says how it was found."""
    followed: dict[str, Any] = {
        run.label: {"d_rms_m": run.tuned.metrics["d_rms_m"], "cost": run.tuned.cost}
        for run in (*result.train, *result.held_out)
        if not run.tuned.lost
    }
    searched = [p.name for p in result.parameters]
    provenance = {
        "tuned_on": [run.label for run in result.train],
        "searched": searched,
        "by_hand": [n for n in result.gains if n not in searched],
        "profile": result.begun_with,
        "robot": result.robot,
        "cost_name": result.cost_name,
        "cost": result.cost,
        **_robust_provenance(result),
        "baseline": result.baseline_name,
        **({"baseline_cost": result.baseline_cost} if np.isfinite(result.baseline_cost) else {}),
        "status": result.status,
        "seed": result.seed,
        "evaluations": result.evaluations,
        "generations": result.generations,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "options": {k: v for k, v in result.options.items() if v is not None},
        "versions": dict(result.versions),
        "followed": followed,
    }
    source = f"tuned by validation.tune on {', '.join(run.label for run in result.train)}"
    return GainSet(result.controller, f"{result.controller}-tuned", result.gains, provenance, source)
