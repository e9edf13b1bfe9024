"""Chapter 4: tuned gains, tables of tracked references (Tab. 4.5-4.38), motors at their limit.

Reference against simulated: the improved model with noise and disturbance, as in the thesis'
simulations. Simulated against real: the MuJoCo robot takes the place of the real robot, with the
lab's noise and, as in the lab, without disturbance.

Some rows agree only under a supposition about what the thesis does not print. Each supposition
holds for all tables of its kind, never for a single row; docs/tracking.md shows what was tried, and
what each does to every row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.metrics.declared import compare_paths
from ssmr.robot.sensors import SAMPLE_RATES_HZ
from ssmr.types import FloatArray, Trajectory
from validation.experiment.gains import GainSet, load_gains
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.experiment.tracked import reference_of, saturated
from validation.experiment.waypoint_files import open_reference
from validation.output import Progress
from validation.plants.profile import Profile, load_profile
from validation.replicate import published
from validation.replicate.chapters import (
    Findings,
    Section,
    Task,
    deviation,
    finished,
    unit_of_metric,
)
from validation.replicate.verdicts import (
    RULE_OF,
    JudgedRow,
    Pair,
    Rows,
    Rule,
    Supposed,
    judged_rows,
)
from validation.report.drawing import (
    PanelRow,
    plain_ticks,
)
from validation.report.palette import VERDICT_INKS
from validation.tune import tune

_PROFILE = "thesis-lab"
CONTROL_TABLES = tuple(f"4.{i}" for i in (*range(5, 20), *range(22, 37)))
"""Numbers of the tables of single references; 4.37 repeats them, and 4.38 follows from it."""
TUNED_TABLES: Mapping[str, str] = {"pid": "4.4", "lqr": "4.21"}
"""Tables of gains by controller."""
_FAST = 0.5
"""Speed at which, says Sec. 4.5, motors were often at their limit [m/s]."""
_KNOWN_GEOMETRY = ("line", "circle")
"""References whose geometry the thesis gives, so that a supposition about anything else can be
tested."""
PATH_RATE_HZ = SAMPLE_RATES_HZ["command"]
"""Supposed rate at which the simulated path was logged before it was compared with a reference
[Hz]: that of commands."""
K_11 = 4.0
"""Supposed gain of the LQR from the error along the path to speed [1/s]."""
K_33 = 2.75
"""Supposed gain of the LQR from the error of heading to yaw rate [1/s]."""
_LOGGED = f"the simulated path was logged at {PATH_RATE_HZ:g} Hz"
_DRIVEN = (
    f"the LQR drove with K_11 = {K_11:g} and K_33 = {K_33:g} 1/s and no weight on the rates, "
    "instead of the manual column of Tab. 4.21"
)
_REAL_SEEDS = 1000
"""First seed of the MuJoCo robot's noise, since the real robot's noise was not the simulation's."""


def _tune_gains(controller: str, task: Task) -> Findings:
    """Search a controller's gains as Sec. 4.3.3 and 4.4.3 did."""
    population, generations = task.tune or (None, None)
    searches = []
    for seed in range(task.seed, task.seed + task.searches):
        tuned = tune(
            controller,
            ("generic@0.25",),
            _PROFILE,
            plant=("improved",),
            held_out=(),
            gains="published",
            from_scratch=True,
            cost="path",
            guard=0.0,
            noise_seed=0,
            population=population,
            generations=generations,
            seed=seed,
            workers=task.workers,
            progress=task.progress,
        )
        searches.append(finished(tuned))
    number = TUNED_TABLES[controller]
    best = min(searches, key=lambda search: search["cost"])
    baseline = best["baseline_cost"]
    words = {
        "law": controller.upper(),
        "number": number,
        "costs": ", ".join(f"{search['cost']:.3f}" for search in searches),
        "baseline": math.nan if baseline is None else baseline,
        "generations": best["generations"],
    }
    return Findings({number: _gain_rows(number, searches, best)}, words)


def _gain_rows(number: str, searches: Sequence[Mapping[str, Any]], best: Mapping[str, Any]) -> Rows:
    """The thesis' gains beside those of the best search, as tune.json has them, and its cost."""
    rows: dict[str, dict[str, Pair]] = {}
    for row, printed in published.printed(number)["rows"].items():
        name = printed["ours"]
        spread = deviation([search["gains"][name] for search in searches])
        obstacle = "" if spread is not None else "a single search has no spread"
        if name not in best["parameters"]:
            obstacle = "set by hand in the thesis; taken over"
        beside = {}
        if "manual" in printed:
            beside["set_by_hand_in_the_thesis"] = float(printed["manual"])
        pair = Pair(
            float(printed.get("optimised", printed.get("value"))),
            best["gains"][name],
            "spread",
            printed["unit"],
            spread,
            beside,
            obstacle=obstacle,
            bounds=printed.get("search", ()),
            printed_bounds=printed.get("search", ()),
        )
        rows[row] = {"optimised": pair}
    spread = deviation([search["cost"] for search in searches])
    baseline = best["baseline_cost"]
    beside = {} if baseline is None else {"with_the_published_gains": baseline}
    rows["cost"] = {"optimised": Pair(None, best["cost"], "none", "1", spread, beside)}
    return rows


class TrackedTables:
    """The runs along the references of the thesis' tables, each driven once, and their rows."""

    def __init__(self, profile: Profile, seeds: int, workers: int | str | None = None) -> None:
        """Build the robots.

        Args:
            profile: robot of both plants.
            seeds: number of draws of noise and disturbance for each row.
            workers: number of threads, None for all processors; the result does not depend on it.
        """
        self._profile = profile
        self._seeds = seeds
        self._workers = workers
        self._robots = {plant: make_robot(profile, plant) for plant in ("improved", "mujoco")}
        self._runs: dict[tuple[str, str, float, str], list[ClosedRun]] = {}

    def _drive(self, gains: GainSet, reference: str, speed: float, plant: str) -> list[ClosedRun]:
        """Return the runs with some gains along a reference at a speed [m/s] with a plant."""
        key = gains.name, reference, speed, plant
        if key not in self._runs:
            n = self._seeds
            first = _REAL_SEEDS if plant == "mujoco" else 0
            loops = [LoopSettings(disturbance=plant != "mujoco")] * n
            laws = [make_controller(self._profile, gains)] * n
            waypoints = open_reference(reference, speed)[1]
            seeds = range(first, first + n)
            robots = [self._robots[plant]] * n
            self._runs[key] = run_robots(robots, laws, loops, waypoints, seeds, self._workers)
        return self._runs[key]

    def compared(self, number: str, supposed: bool = False) -> FloatArray:
        """Return (n, 3) metrics of a table, see `RULE_OF`, of the runs that kept the reference.

        Args:
            number: number of the table.
            supposed: whether under the supposition about what the thesis does not print, see
                `supposition`.
        """
        theirs = published.printed(number)
        gains = load_gains(theirs["controller"], theirs.get("gains", "published"))
        if supposed and theirs["controller"] == "lqr":
            gains = supposed_gains(gains)
        where = theirs["trajectory"], float(theirs["speed_m_s"])
        simulated = self._drive(gains, *where, "improved")
        if theirs["comparison"] == "reference_vs_simulated":
            reference = reference_of(simulated[0], open_reference(*where)[1], whole=True)
            motions = [run.motion for run in simulated if not run.lost]
            if supposed:
                motions = [supposed_path(motion) for motion in motions]
            measured = [compare_paths(motion, reference) for motion in motions]
        else:
            both = zip(simulated, self._drive(gains, *where, "mujoco"), strict=True)
            kept = [(s.motion, r.motion) for s, r in both if not (s.lost or r.lost)]
            measured = [compare_paths(*motions) for motions in kept]
        numbers = [[m[name] for name in RULE_OF] for m in measured]
        return np.array(numbers).reshape(-1, len(RULE_OF))

    def rows(self, number: str) -> Rows:
        """A table of the thesis beside ours, which are means over the seeds that kept to it."""
        theirs = published.printed(number)
        ours = self._means(self.compared(number))
        text = supposition(number)
        under = self._means(self.compared(number, supposed=True)) if text else {}
        printed: Mapping[str, float] = next(iter(theirs["rows"].values()), {})
        pairs = {}
        for metric, rule in RULE_OF.items():
            value, spread = ours.get(metric, (None, None))
            pairs[metric] = Pair(
                printed.get(metric),
                value,
                rule,
                unit_of_metric(metric),
                spread,
                obstacle="" if ours else "every seed lost the reference",
                supposed=Supposed(*under[metric], text) if under else None,
            )
        return {f"{theirs['trajectory']}_{theirs['speed_m_s']:.2f}": pairs}

    def _means(self, measured: FloatArray) -> dict[str, tuple[float, float | None]]:
        """Mean and deviation of each metric over (n, 3) runs; of one seed it is not known."""
        means = {}
        for metric, values in zip(RULE_OF, measured.T, strict=True):
            if len(values):
                spread = float(values.std()) if self._seeds > 1 else None
                means[metric] = (float(values.mean()), spread)
        return means


def supposed_gains(gains: GainSet) -> GainSet:
    """An LQR's set with the supposed K_11 = sqrt(Q_11 / R_11) and K_33 = sqrt(Q_33 / R_22)."""
    old = gains.values
    new = {"q_x": K_11**2 * old["r_v"], "q_yaw": K_33**2 * old["r_w"], "q_v": 0.0, "q_w": 0.0}
    return GainSet(gains.controller, f"{gains.name}, supposed", {**old, **new})


def supposed_path(motion: Trajectory) -> Trajectory:
    """A motion as logged at `PATH_RATE_HZ`: samples are the first at or after their instants."""
    times = np.arange(motion.t[0], motion.t[-1], 1.0 / PATH_RATE_HZ)
    first = np.searchsorted(motion.t, times - 1e-9)  # rounding must not skip a sample
    k = np.unique(np.append(first, len(motion.t) - 1))
    return Trajectory(motion.t[k], motion.pose[k], motion.twist[k], motion.wheels[k])


def supposition(number: str) -> str:
    """The supposition for a table of the thesis, without a full stop; empty if there is none."""
    theirs = published.printed(number)
    if theirs["comparison"] != "reference_vs_simulated":
        return ""
    if theirs["trajectory"] not in _KNOWN_GEOMETRY or theirs.get("suspect"):
        return ""
    if theirs["controller"] == "lqr":
        return f"{_DRIVEN}, and {_LOGGED}"
    return _LOGGED


def _track_references(task: Task) -> Findings:
    runs = TrackedTables(load_profile(_PROFILE), task.draws, task.workers)
    tables = dict[str, Rows]()
    for number in CONTROL_TABLES:
        tables[number] = runs.rows(number)
        task.progress(Progress(len(tables), len(CONTROL_TABLES), f"Tab. {number}"))
    # Tab. 4.37 repeats the rows of the tables against the real robot, with numbers of its own.
    real_rows: dict[str, Mapping[str, Pair]] = {}
    for number, rows in tables.items():
        theirs = published.printed(number)
        if theirs["comparison"] == "simulated_vs_real":
            for row, pairs in rows.items():
                real_rows[f"{theirs['controller']}_{row}"] = pairs
    repeated = {}
    for row, printed in published.printed("4.37")["rows"].items():
        pairs = real_rows[row]
        repeated[row] = {m: replace(p, published=float(printed[m])) for m, p in pairs.items()}
    words = {"seeds": task.draws}
    return Findings({**tables, "4.37": repeated}, words, panels=_panels(judged_rows(tables)))


def _panels(rows: Sequence[JudgedRow]) -> list[PanelRow]:
    def draw(comparison: str, title: str, ax: Axes) -> None:
        labels = list[str]()
        for row in rows:
            theirs = published.printed(row.table)
            if theirs["comparison"] != comparison:
                continue
            k = len(labels)
            pair = row.pairs["d_rms_m"]
            labels.append(f"{row.table}  {theirs['controller']} {row.name.replace('_', ' ')}")
            if pair.ours is not None:
                half_bar = 1e3 * (pair.spread or 0.0)
                ink = VERDICT_INKS[row.whole.status]
                ax.errorbar(1e3 * pair.ours, k, xerr=half_bar, fmt="o", color=ink, capsize=3)
            if pair.supposed is not None:
                ax.plot(1e3 * pair.supposed.value, k, "o", mfc="none", color="0.3")
            if pair.published is not None:
                ax.plot(1e3 * pair.published, k, "|", color="black", ms=14, mew=2)
        ax.set(xscale="log", xlabel="d_rms [mm]", ylim=(len(labels) - 0.5, -0.5), title=title)
        ax.set_yticks(range(len(labels)), labels)
        plain_ticks(ax.xaxis)

    heading = (
        "Tracked references. Bar: printed; dot: ours, with the deviation over seeds; "
        "ring: ours under the supposition"
    )
    names = {
        "reference_vs_simulated": "Reference against simulated",
        "simulated_vs_real": "Simulated against real",
    }
    panels = [partial(draw, comparison, title) for comparison, title in names.items()]
    return [PanelRow(5.5, panels, heading=heading)]


def _saturation(task: Task) -> Findings:
    """Find how often motors are at their limit on the generic reference (Sec. 4.5)."""
    profile = load_profile(_PROFILE)
    n = task.draws
    rows: dict[str, dict[str, Pair]] = {}
    for plant in ("improved", "mujoco"):
        robot = make_robot(profile, plant)
        limit = {"side_torque_limit_N_m": robot.limits["side_torque_limit_N_m"]}
        loops = [LoopSettings(disturbance=plant != "mujoco")] * n
        for law, gains in (("pid", "published"), ("lqr", "manual")):
            laws = [make_controller(profile, load_gains(law, gains))] * n
            for speed in (0.25, 0.5):
                waypoints = open_reference("generic", speed)[1]
                runs = run_robots([robot] * n, laws, loops, waypoints, range(n), task.workers)
                shares = [100.0 * float(np.mean(saturated(run, limit))) for run in runs]
                rule: Rule = "words" if speed == _FAST else "none"
                pair = Pair(None, float(np.mean(shares)), rule, "%", deviation(shares))
                rows[f"{plant}, {law}, {speed:g} m/s"] = {"time_at_limit_percent": pair}
    return Findings({"Sec. 4.5, motors": rows}, {"seeds": n})


CONTROL_SECTIONS = (
    *(
        Section(f"tune-{law}", (number,), partial(_tune_gains, law))
        for law, number in TUNED_TABLES.items()
    ),
    Section("saturation", ("Sec. 4.5, motors",), _saturation),
    Section("tables", (*CONTROL_TABLES, "4.37"), _track_references),
)
"""The sections on chapter 4."""
