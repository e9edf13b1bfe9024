"""Drive every controller with the same mismatched robots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from ssmr.control.laws import LAWS
from ssmr.control.loop import make_clock
from validation.progress import Progress, Report, silent
from validation.study.result import keeping, profile_of
from validation.study.robustness.cases import Mismatch, RobustnessOptions, draw_cases, levels_of, mismatched
from validation.study.robustness.outcomes import ControllerRuns, RunErrors, errors_of, health_of, torque_needed
from validation.study.robustness.result import Robustness
from validation.track import gains as gain_sets
from validation.track.gains import DEFAULT, GainSet, load_gains
from validation.track.loops import make_controller, require_practicable, run_robots
from validation.track.waypoint_files import open_reference

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
    sets, remarks = _chosen_gains(o.controllers, o.gains) if isinstance(o.gains, str) else (dict(o.gains), [])
    laws = {controller: make_controller(profile, gains) for controller, gains in sets.items()}
    require_practicable(waypoints, profile.plants["mujoco"].drive, name)
    ticks = make_clock(waypoints, o.loop(Mismatch()), o.timestep).ticks
    levels = levels_of(profile.robot)
    cases = draw_cases(o.runs, o.seeds, o.seed, levels)
    nominal = mismatched(profile, Mismatch(), o.timestep, math.inf)
    torque = torque_needed(nominal, waypoints)
    others = dict.fromkeys(c.mismatch for c in cases if c.mismatch != Mismatch())
    robots = {Mismatch(): nominal, **{m: mismatched(profile, m, o.timestep, torque) for m in others}}
    found: dict[str, ControllerRuns] = {}
    with keeping(found) as course:
        for k, (controller, law) in enumerate(laws.items()):
            errors: list[RunErrors] = []
            health = None
            for first in range(0, len(cases), _BATCH):
                part = cases[first : first + _BATCH]
                crew = [robots[c.mismatch] for c in part]
                loops = [o.loop(c.mismatch, robots[c.mismatch].drive) for c in part]
                progress(Progress(k * len(cases) + first, len(laws) * len(cases), controller))
                runs = run_robots(crew, [law] * len(part), loops, waypoints, [c.seed for c in part], workers)
                errors += [errors_of(run, waypoints, robot, ticks) for run, robot in zip(runs, crew, strict=True)]
                health = health or health_of(runs[0], waypoints, crew[0], loops[0], part[0].seed)
            assert health is not None
            found[controller] = ControllerRuns(sets[controller], tuple(errors), health)
    parameters, by_name = profile.as_dict()["mujoco"], MappingProxyType(found)
    speed, duration = waypoints.speed, waypoints.duration
    made, ended = (tuple(cases), by_name, tuple(remarks), levels), course.status
    whose = profile.robot.name
    return Robustness(profile.name, parameters, name, speed, duration, torque, o, *made, robot=whose, status=ended)


def _chosen_gains(controllers: tuple[str, ...], name_or_path: str) -> tuple[Mapping[str, GainSet], list[str]]:
    """Return each controller's gains of that name, and remarks on those that have none and get their class's defaults.

    Raises:
        GainsError: no controller has such a set, or a file's is not this controller's.
    """
    known = {full.removeprefix(f"{c}-") for c in LAWS for full in gain_sets.names(c)} | {DEFAULT}
    chosen, remarks = {}, []
    for controller in controllers:
        if name_or_path in known and f"{controller}-{name_or_path}" not in gain_sets.names(controller):
            chosen[controller] = load_gains(controller, DEFAULT)
            if name_or_path != DEFAULT:
                remarks.append(f"{controller} has no gains '{name_or_path}'; its defaults are used.")
        else:
            chosen[controller] = load_gains(controller, name_or_path)
    return chosen, remarks
