"""The thesis' tables of tracked references (Tab. 4.5-4.36), each printed row beside what this project gets.

Reference against simulated: the improved model with noise and disturbance, as in the thesis' simulations. Simulated against
real: the MuJoCo robot takes the place of the real robot, with the lab's noise and, as in the lab, without disturbance.

Some rows agree only under a supposition about what the thesis does not print. Each supposition holds for all tables of its
kind, never for a single row; docs/tracking.md shows what was tried, and what each does to every row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.metrics.declared import compare_paths
from ssmr.robot.sensors import SAMPLE_RATES_HZ
from ssmr.types import FloatArray, Trajectory
from validation.bench.gains import GainSet, load_gains
from validation.bench.loops import ClosedLoopRobot, make_controller, make_robot, rate, run_robots
from validation.bench.tracked import reference_of
from validation.bench.waypoint_files import open_reference
from validation.plants.profile import Profile
from validation.thesis import published
from validation.thesis.verdicts import RULE_OF, Pair, RowVerdict, Supposed, judge_rows, row_verdict

CONTROL_TABLES = tuple(f"4.{i}" for i in (*range(5, 20), *range(22, 37)))
"""Numbers of the tables of single references; 4.37 and 4.38 repeat them."""
TABLE_METRICS = tuple(RULE_OF)
"""Metrics of each row."""
ALL_LOST = "every seed lost the reference"
"""Reason why a row without any number of ours cannot be compared."""
KNOWN_GEOMETRY = ("line", "circle")
"""References whose geometry the thesis gives, so that a supposition about anything else can be tested."""
PATH_RATE_HZ = SAMPLE_RATES_HZ["command"]
"""Supposed rate at which the simulated path was logged before it was compared with a reference [Hz]: that of commands."""
K_11, K_33 = 4.0, 2.75
"""Supposed gains of the LQR from the error along the path to speed, and from that of heading to yaw rate [1/s]."""
_LOGGED = f"the simulated path was logged at {PATH_RATE_HZ:g} Hz, so that its samples lie {{spacing:g}} mm apart"
_DRIVEN = (
    f"the LQR drove with K_11 = {K_11:g} and K_33 = {K_33:g} 1/s and no weight on the rates, instead of the manual column "
    "of Tab. 4.21"
)
_REAL_SEEDS = 1000
"""First seed of the MuJoCo robot's noise, since the real robot's noise was not the simulation's."""

TableComparison = Literal["reference_vs_simulated", "simulated_vs_real"]
_Drive = Callable[[GainSet, str, float, str], list[ClosedRun]]
"""Function that returns the runs with some gains along a reference at a speed [m/s] with a plant."""


@dataclass(frozen=True)
class TableEntry:
    """The row of one table."""

    table: str
    """Number of the table."""
    comparison: TableComparison
    """Which motions are compared."""
    controller: str
    """`pid` or `lqr`."""
    gains: str
    """Name of the gain set."""
    reference: str
    """Name of the reference."""
    speed: float
    """Speed along the reference [m/s]."""
    printed: Mapping[str, float]
    """Printed numbers by metric; empty if the table is lost."""
    mean: Mapping[str, float]
    """Means by metric over the seeds that kept the reference; empty if none did."""
    deviation: Mapping[str, float]
    """Standard deviations by metric over the seeds that kept the reference."""
    lost: int
    """Number of seeds that lost the reference."""
    n: int
    """Number of seeds."""
    mujoco: Mapping[str, float]
    """Reference against simulated: means by metric of the MuJoCo robot, without disturbance; else empty."""
    supposed: Mapping[str, Supposed] = field(default_factory=dict)
    """Numbers by metric under the supposition for this table, see `SUPPOSITIONS`; empty if there is none."""

    @property
    def row(self) -> str:
        """Name of the row, as the thesis' tables of several references call it."""
        return f"{self.reference}_{self.speed:.2f}"

    @property
    def pairs(self) -> Mapping[str, Pair]:
        """Printed and own numbers by metric, ready to be judged."""
        return {
            metric: Pair(
                self.printed.get(metric),
                self.mean.get(metric),
                rule,
                "m" if metric.endswith("_m") else "1",
                self.deviation.get(metric) if self.n > 1 else None,
                {"mujoco": self.mujoco[metric]} if metric in self.mujoco else {},
                "" if self.mean else ALL_LOST,
                self.supposed.get(metric),
            )
            for metric, rule in RULE_OF.items()
        }

    @property
    def verdict(self) -> RowVerdict:
        """Verdict on the row, by the rules that a replication has too."""
        return row_verdict(self.pairs, judge_rows(self.table, {self.row: self.pairs})[self.row])


def tracked_tables(
    profile: Profile, seeds: int, numbers: Sequence[str] = CONTROL_TABLES, workers: int | None = None
) -> Iterator[TableEntry]:
    """Make the thesis' tables of tracked references, one after another.

    Args:
        profile: robot of both plants.
        seeds: number of draws of noise and disturbance for each row.
        numbers: numbers of the tables to make.
        workers: number of threads, all processors if not given; the result does not depend on it.
    """
    robots = {plant: make_robot(profile, plant) for plant in ("improved", "mujoco")}
    known: dict[tuple[str, str, float, str], list[ClosedRun]] = {}

    def drive(gains: GainSet, reference: str, speed: float, plant: str) -> list[ClosedRun]:
        key = gains.name, reference, speed, plant
        if key not in known:
            law = make_controller(profile, gains)
            real, waypoints = plant == "mujoco", open_reference(reference, speed)[1]
            first = _REAL_SEEDS if real else 0
            loops = [LoopSettings(disturbance=not real)] * seeds
            known[key] = run_robots(
                [robots[plant]] * seeds, [law] * seeds, loops, waypoints, range(first, first + seeds), workers
            )
        return known[key]

    for number in numbers:
        yield _entry(number, seeds, robots, drive)


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


def supposed_gains(gains: GainSet) -> GainSet:
    """Return an LQR's set with the supposed K_11 and K_33: K_11 = sqrt(Q_11 / R_11), K_33 = sqrt(Q_33 / R_22)."""
    old = gains.values
    new = {"q_x": K_11**2 * old["r_v"], "q_yaw": K_33**2 * old["r_w"], "q_v": 0.0, "q_w": 0.0}
    return GainSet(gains.controller, f"{gains.name}, supposed", {**old, **new})


def supposed_path(motion: Trajectory) -> Trajectory:
    """Return a motion as it is logged at `PATH_RATE_HZ`: each sample is the first of the motion at or after its time."""
    times = np.arange(motion.t[0], motion.t[-1], 1.0 / PATH_RATE_HZ)
    k = np.unique(np.append(np.searchsorted(motion.t, times - 1e-9), len(motion.t) - 1))
    return Trajectory(motion.t[k], motion.pose[k], motion.twist[k], motion.wheels[k])


def supposition(content: Mapping[str, object]) -> str:
    """Return the supposition for one of the thesis' tables in words, without a full stop; empty if there is none."""
    if content["trajectory"] not in KNOWN_GEOMETRY or content.get("suspect"):
        return ""
    logged = _LOGGED.format(spacing=1e3 * float(str(content["speed_m_s"])) / PATH_RATE_HZ)
    driven = [_DRIVEN] * (content["controller"] == "lqr")
    return ", and ".join(driven + [logged] * (content["comparison"] == "reference_vs_simulated"))
