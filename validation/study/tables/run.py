"""Make the thesis' tables of tracked references (Tab. 4.5-4.36) with the improved model and the MuJoCo robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.metrics.declared import compare_paths
from ssmr.types import FloatArray, Trajectory
from validation.progress import Progress, Report, silent
from validation.study.result import keeping, profile_of
from validation.study.tables.result import TABLE_METRICS, ControlTables, TableEntry, TablesOptions
from validation.study.tables.suppositions import supposed_gains, supposed_path, supposition
from validation.thesis import published
from validation.thesis.verdicts import Supposed
from validation.track.data import reference_of
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
    comparison, gains = content["comparison"], load_gains(controller, content.get("gains", "published"))
    _, waypoints = open_reference(reference, speed)

    def compare(gains: GainSet, path_of: Callable[[Trajectory], Trajectory]) -> FloatArray:
        """Return (n, 3) metrics of the runs that kept the reference."""
        simulated = drive(gains, reference, speed, "improved")
        if comparison == "reference_vs_simulated":
            wanted = reference_of(simulated[0], waypoints, whole=True)
            found = [compare_paths(path_of(s.motion), wanted) for s in simulated if not s.lost]
        else:
            both = zip(simulated, drive(gains, reference, speed, "mujoco"), strict=True)
            found = [compare_paths(s.motion, r.motion) for s, r in both if not (s.lost or r.lost)]
        return np.array([[m[name] for name in TABLE_METRICS] for m in found]).reshape(-1, len(TABLE_METRICS))

    table = compare(gains, lambda motion: motion)
    supposed, mujoco = dict[str, Supposed](), dict[str, float]()
    if text := supposition(content):
        under = compare(supposed_gains(gains) if controller == "lqr" else gains, supposed_path)
        spreads = under.std(axis=0) if seeds > 1 else [None] * len(TABLE_METRICS)
        if len(under):
            of_each = zip(TABLE_METRICS, map(float, under.mean(axis=0)), spreads, strict=True)
            supposed = {m: Supposed(v, None if s is None else float(s), text, "tracking.md") for m, v, s in of_each}
    if comparison == "reference_vs_simulated":
        driven = [rate(r, waypoints, robots["mujoco"]) for r in drive(gains, reference, speed, "mujoco") if not r.lost]
        mujoco = {name: float(np.mean([m[name] for m in driven])) for name in TABLE_METRICS} if driven else {}
    rows = list(content["rows"])
    return TableEntry(
        number,
        comparison,
        controller,
        gains.name,
        reference,
        speed,
        {m: published.value(number, rows[0], m) for m in TABLE_METRICS} if rows else {},
        dict(zip(TABLE_METRICS, map(float, table.mean(axis=0)), strict=True)) if len(table) else {},
        dict(zip(TABLE_METRICS, map(float, table.std(axis=0)), strict=True)) if len(table) else {},
        seeds - len(table),
        seeds,
        mujoco,
        supposed,
    )
