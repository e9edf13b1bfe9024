"""Drive every controller with the same robots that differ from their profile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from ssmr.control.laws import LAWS
from ssmr.control.loop import make_clock
from validation.bench.gains import DEFAULT, GainSet, load_gains, sets_of
from validation.bench.loops import make_controller, require_practicable, run_robots
from validation.bench.mismatch import mismatched
from validation.bench.waypoint_files import open_reference
from validation.progress import Progress, Report, silent
from validation.study.result import keeping, profile_of
from validation.study.robustness.cases import RobustnessOptions, draw_cases
from validation.study.robustness.outcomes import ControllerRuns, RunErrors, errors_of, health_of
from validation.study.robustness.result import Robustness

_BATCH = 64
"""Greatest number of robots that are driven at once."""


def study_robustness(
    options: RobustnessOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> Robustness:
    """Drive MuJoCo robots that differ from the robot of their profile, with every controller.

    Args:
        options: controllers, reference, profile and number of runs; the defaults if not given.
        workers: number of threads, all processors if not given; the result does not depend on it.
        progress: called with the number of finished runs.

    Raises:
        SsmrError: the nominal robot cannot be driven.
        ValueError: gains, profile, step or reference do not exist or do not fit together.
    """
    o = options or RobustnessOptions()
    profile = profile_of(o.profile, o.robot)
    name, waypoints = open_reference(o.reference, o.speed) if isinstance(o.reference, str) else ("waypoints", o.reference)
    sets, remarks = (dict(o.gains), []) if isinstance(o.gains, Mapping) else _chosen_gains(o.controllers, o.gains)
    laws = {controller: make_controller(profile, gains) for controller, gains in sets.items()}
    require_practicable(waypoints, profile.plants["mujoco"].drive, name)
    ticks = make_clock(waypoints, o.loop(), o.timestep).ticks
    cases = draw_cases(o.runs, o.seeds, o.seed, profile.robot)
    robots = {m: mismatched(profile, "mujoco", m, o.timestep) for m in {c.mismatch for c in cases}}
    found: dict[str, ControllerRuns] = {}
    with keeping(found) as course:
        for k, (controller, law) in enumerate(laws.items()):
            errors: list[RunErrors] = []
            health = None
            for first in range(0, len(cases), _BATCH):
                part = cases[first : first + _BATCH]
                crew = [robots[c.mismatch] for c in part]
                loops = [o.loop(robots[c.mismatch].drive) for c in part]
                progress(Progress(k * len(cases) + first, len(laws) * len(cases), controller))
                runs = run_robots(crew, [law] * len(part), loops, waypoints, [c.seed for c in part], workers)
                errors += [errors_of(run, waypoints, robot, ticks) for run, robot in zip(runs, crew, strict=True)]
                health = health or health_of(runs[0], waypoints, crew[0], loops[0], part[0].seed)
            assert health is not None
            found[controller] = ControllerRuns(sets[controller], tuple(errors), health)
    parameters, by_name = profile.as_dict()["mujoco"], MappingProxyType(found)
    speed, duration = waypoints.speed, waypoints.duration
    made, ended = (tuple(cases), by_name, tuple(remarks)), course.status
    whose = profile.robot.name
    return Robustness(profile.name, parameters, name, speed, duration, o, *made, robot=whose, status=ended)


def _chosen_gains(controllers: Sequence[str], wanted: Sequence[str]) -> tuple[dict[str, GainSet], list[str]]:
    """Return the sets that each controller has of those that are wanted, by name, and remarks on those that have none.

    Raises:
        GainsError: no controller has such a set, or a file's is not this controller's.
    """
    chosen: dict[str, GainSet] = {}
    remarks = []
    for name in wanted:
        somewhere = any(name in sets_of(c) for c in LAWS)
        for controller in controllers:
            if name in sets_of(controller) or not somewhere:
                own = load_gains(controller, name)
                chosen[own.name] = own
    for controller in controllers:
        if controller not in {own.controller for own in chosen.values()}:
            own = load_gains(controller, DEFAULT)
            chosen[own.name] = own
            remarks.append(f"{controller} has no gains '{', '.join(wanted)}'; its defaults are used.")
    order = sorted(chosen, key=lambda name: controllers.index(chosen[name].controller))
    return {name: chosen[name] for name in order}, remarks
