"""Make the thesis' tables of tracked references (Tab. 4.5-4.36) with the improved model and the MuJoCo robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.metrics.declared import Metrics, compare_paths
from validation.progress import Progress, Report, silent
from validation.study.result import keeping, profile_of
from validation.study.tables.result import TABLE_METRICS, ControlTables, TableEntry, TablesOptions
from validation.thesis import published
from validation.track.gains import GainSet, load_gains
from validation.track.loops import ClosedLoopRobot, make_controller, make_robot, rate, run_robots
from validation.track.waypoint_files import open_reference

_REAL_SEEDS = 1000
"""First seed of the MuJoCo robot's noise, since the real robot's noise was not the simulation's."""

_Drive = Callable[[GainSet, str, float, str], list[ClosedRun]]
"""Function that returns the runs with some gains along a reference at a speed [m/s] with a plant."""


def study_tables(
    options: TablesOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> ControlTables:
    """Make the thesis' tables of tracked references.

    Args:
        options: profile, seeds and tables; the defaults if not given.
        workers: number of threads, all processors if not given; the result does not depend on it.
        progress: called after each table.

    Raises:
        ValueError: the profile does not exist, or its numbers do not fit together.
    """
    o = options or TablesOptions()
    profile = profile_of(o.profile, o.robot)
    robots = {plant: make_robot(profile, plant) for plant in ("improved", "mujoco")}
    known: dict[tuple[str, str, float, str], list[ClosedRun]] = {}

    def drive(gains: GainSet, reference: str, speed: float, plant: str) -> list[ClosedRun]:
        key = gains.name, reference, speed, plant
        if key not in known:
            law = make_controller(profile, gains)
            real, waypoints = plant == "mujoco", open_reference(reference, speed)[1]
            seeds = range(_REAL_SEEDS, _REAL_SEEDS + o.seeds) if real else range(o.seeds)
            loops = [LoopSettings(disturbance=not real)] * o.seeds
            known[key] = run_robots([robots[plant]] * o.seeds, [law] * o.seeds, loops, waypoints, seeds, workers)
        return known[key]

    entries = list[TableEntry]()
    with keeping(entries) as course:
        for done, number in enumerate(o.numbers):
            progress(Progress(done, len(o.numbers), f"Tab. {number}"))
            entries.append(_entry(number, o.seeds, robots, drive))
    return ControlTables(profile.name, o.seeds, tuple(entries), robot=profile.robot.name, status=course.status)


def _entry(number: str, seeds: int, robots: Mapping[str, ClosedLoopRobot], drive: _Drive) -> TableEntry:
    """Return the row of one table."""
    content = published.table(number)
    controller, reference, speed = content["controller"], content["trajectory"], float(content["speed_m_s"])
    gains = load_gains(controller, content.get("gains", "published"))
    _, waypoints = open_reference(reference, speed)
    simulated, real = (drive(gains, reference, speed, plant) for plant in ("improved", "mujoco"))
    simulated_robot: list[Metrics] = []
    if content["comparison"] == "reference_vs_simulated":
        found = [rate(run, waypoints, robots["improved"]) for run in simulated if not run.lost]
        simulated_robot = [rate(run, waypoints, robots["mujoco"]) for run in real if not run.lost]
    else:
        both = zip(simulated, real, strict=True)
        found = [compare_paths(s.motion, r.motion) for s, r in both if not (s.lost or r.lost)]
    table = np.array([[m[name] for name in TABLE_METRICS] for m in found]).reshape(-1, len(TABLE_METRICS))
    rows = list(content["rows"])
    suspect = content.get("note", "") if content.get("suspect") else ""
    if number == "4.23":
        suspect = "its gap is not that of the printed gains (docs/errata.md, 43)"
    return TableEntry(
        number,
        content["comparison"],
        controller,
        gains.name,
        reference,
        speed,
        {m: published.value(number, rows[0], m) for m in TABLE_METRICS} if rows else {},
        suspect,
        dict(zip(TABLE_METRICS, map(float, table.mean(axis=0)), strict=True)) if len(table) else {},
        dict(zip(TABLE_METRICS, map(float, table.std(axis=0)), strict=True)) if len(table) else {},
        seeds - len(table),
        seeds,
        {name: float(np.mean([m[name] for m in simulated_robot])) for name in TABLE_METRICS} if simulated_robot else {},
    )
