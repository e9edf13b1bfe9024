"""Chapter 4: tuned gains, tables of tracked references (Tab. 4.5-4.38), motors at their limit.

Reference against simulated: the improved model with noise and disturbance, as in the thesis'
simulations. Simulated against real: the MuJoCo robot takes the place of the real robot, with the
lab's noise and, as in the lab, without disturbance.

Some rows agree only under a supposition about what the thesis does not print. Each supposition
holds for all tables of its kind, never for a single row; docs/errata.md shows what was tried, and
what each does to every row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from scipy.spatial import cKDTree

from ssmr.metrics.declared import compare_paths
from ssmr.robot.sensors import SAMPLE_RATES_HZ
from ssmr.types import Trajectory
from validation.experiment.gains import GainSet, load_gains
from validation.experiment.tracked import find_saturated
from validation.output import Document
from validation.replicate import published
from validation.replicate.chapters import (
    Findings,
    Sections,
    Task,
    finished_results,
    standard_deviation,
    swept_rows,
    unit_of_metric,
)
from validation.replicate.verdicts import (
    RULE_OF,
    JudgedRow,
    Pair,
    Rows,
    Rule,
    judged_rows,
)
from validation.report.drawing import (
    PanelRow,
    plain_ticks,
)
from validation.report.palette import VERDICT_INKS, spell_name
from validation.report.table import Row
from validation.track import track
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
_LOGGED = f"the simulated path was logged at {PATH_RATE_HZ:g} Hz, and distances go to its samples"
_DRIVEN = (
    f"the LQR drove with K_11 = {K_11:g} and K_33 = {K_33:g} 1/s and no weight on the rates, "
    "instead of the manual column of Tab. 4.21"
)
_SATURATED = {"pid": "published", "lqr": "manual"}
"""Gains with which motors are watched, by controller."""
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
        searches.append(finished_results(tuned))
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


def _gain_rows(number: str, searches: Sequence[Document], best: Document) -> Rows:
    """The thesis' gains beside those of the best search, as tune.json has them, and its cost."""
    rows = {}
    for row, printed in published.printed_table(number)["rows"].items():
        name = printed["ours"]
        spread = standard_deviation([search["gains"][name] for search in searches])
        obstacle = "" if spread is not None else "a single search has no spread"
        searched = best["parameters"].get(name, {})
        if not searched:
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
            bounds=(searched["lower"], searched["upper"]) if searched else (),
            scale=searched.get("scale", "linear"),
            printed_bounds=printed.get("search", ()),
        )
        rows[row] = {"optimised": pair}
    spread = standard_deviation([search["cost"] for search in searches])
    baseline = best["baseline_cost"]
    beside = {} if baseline is None else {"with_the_published_gains": baseline}
    rows["cost"] = {"optimised": Pair(None, best["cost"], "none", "1", spread, beside)}
    return rows


def _measure_draw(number: str, seed: int, supposed: bool = False) -> Row:
    """Return the metrics of a table, see `RULE_OF`, with one draw of noise and disturbance.

    There are none where a robot lost the reference.

    Args:
        number: number of the table.
        seed: seed of the draw.
        supposed: whether under the supposition about what the thesis does not print, see
            `_supposition_for`.
    """
    theirs = published.printed_table(number)
    gains = load_gains(theirs["controller"], theirs.get("gains", "published"))
    if supposed and theirs["controller"] == "lqr":
        gains = supposed_gains(gains)
    follow = partial(
        track,
        theirs["controller"],
        theirs["trajectory"],
        profile=_PROFILE,
        gains=gains,
        speed=float(theirs["speed_m_s"]),
        workers=1,
    )
    robots = follow(plant=("improved",), seed=seed).robots
    motion = robots[0].run.motion
    judge = robots[0].target
    if theirs["comparison"] != "reference_vs_simulated":
        real = follow(plant=("mujoco",), seed=_REAL_SEEDS + seed, no_disturbance=True)
        robots += real.robots
        judge = real.motion("mujoco")
    elif supposed:
        motion = supposed_path(motion)
    if any(robot.run.lost for robot in robots):
        return {}
    metrics = dict(compare_paths(motion, judge))
    if supposed:
        apart, _ = cKDTree(motion.xy).query(judge.xy)
        metrics["d_rms_m"] = math.sqrt(np.mean(apart**2))
        metrics["d_haus_m"] = apart.max()
    return {name: metrics[name] for name in RULE_OF}


def track_tables(numbers: Sequence[str], task: Task) -> dict[str, Rows]:
    """Return tables of the thesis beside ours, which are means over the draws that kept to it."""
    variants = {}
    for number, seed in product(numbers, range(task.draws)):
        for supposed in (False, True) if _supposition_for(number) else (False,):
            variants[f"Tab. {number}, draw {seed}{', supposed' * supposed}"] = (
                number,
                seed,
                supposed,
            )
    measured: dict[tuple[str, bool], list[Row]] = {}
    rows = swept_rows(variants, lambda variant: _measure_draw(*variant), task)
    for (number, _, supposed), row in zip(variants.values(), rows, strict=True):
        measured.setdefault((number, supposed), []).append(row)
    return {number: _table_rows(number, measured, task.draws) for number in numbers}


def _table_rows(
    number: str, measured: Mapping[tuple[str, bool], Sequence[Row]], draws: int
) -> Rows:
    """Return a table of the thesis beside ours, from what each draw measured."""
    theirs = published.printed_table(number)
    printed: Mapping[str, float] = next(iter(theirs["rows"].values()), {})

    def find_mean(metric: str, supposed: bool) -> tuple[float | None, float | None]:
        """Return the mean of a metric and its deviation, which one draw does not tell."""
        rows = measured.get((number, supposed), ())
        values = [row[metric] for row in rows if metric in row]
        if not values:
            return None, None
        return float(np.mean(values)), float(np.std(values)) if draws > 1 else None

    pairs = {}
    for metric, rule in RULE_OF.items():
        ours, spread = find_mean(metric, False)
        under, its_spread = find_mean(metric, True)
        pair = Pair(
            printed.get(metric),
            ours,
            rule,
            unit_of_metric(metric),
            spread,
            obstacle="every seed lost the reference" if ours is None else "",
        )
        if under is not None:
            other = replace(pair, ours=under, spread=its_spread)
            pair = replace(pair, supposed=other, supposition=_supposition_for(number))
        pairs[metric] = pair
    return {f"{theirs['trajectory']}_{theirs['speed_m_s']:.2f}": pairs}


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


def _supposition_for(number: str) -> str:
    """The supposition for a table of the thesis, without a full stop; empty if there is none."""
    theirs = published.printed_table(number)
    if theirs["comparison"] != "reference_vs_simulated":
        return ""
    if theirs["trajectory"] not in _KNOWN_GEOMETRY or theirs.get("suspect"):
        return ""
    if theirs["controller"] == "lqr":
        return f"{_DRIVEN}, and {_LOGGED}"
    return _LOGGED


def _track_references(task: Task) -> Findings:
    """Track the references of chapter 4."""
    tables = track_tables(CONTROL_TABLES, task)
    # Tab. 4.37 repeats the rows of the tables against the real robot, with numbers of its own.
    repeated: dict[str, Mapping[str, Pair]] = {}
    for row, printed in published.printed_table("4.37")["rows"].items():
        controller, _, name = row.partition("_")
        for number, rows in tables.items():
            theirs = published.printed_table(number)
            if (theirs["comparison"], theirs["controller"]) == ("simulated_vs_real", controller):
                pairs = rows.get(name, {})
                again = {m: replace(p, published=float(printed[m])) for m, p in pairs.items()}
                repeated |= {row: again} if again else {}
    panels = _draw_panels(judged_rows(tables))
    return Findings({**tables, "4.37": repeated}, {"seeds": task.draws}, panels=panels)


def _draw_panels(rows: Sequence[JudgedRow]) -> list[PanelRow]:
    def draw(comparison: str, title: str, ax: Axes) -> None:
        labels = list[str]()
        for row in rows:
            theirs = published.printed_table(row.table)
            if theirs["comparison"] != comparison:
                continue
            k = len(labels)
            pair = row.pairs["d_rms_m"]
            labels.append(spell_name(f"{row.table}  {theirs['controller']} {row.name}"))
            if pair.ours is not None:
                half_bar = 1e3 * (pair.spread or 0.0)
                ink = VERDICT_INKS[row.whole.status]
                ax.errorbar(1e3 * pair.ours, k, xerr=half_bar, fmt="o", color=ink, capsize=3)
            if pair.supposed is not None and (supposed := pair.supposed.ours) is not None:
                ax.plot(1e3 * supposed, k, "o", mfc="none", color="0.3")
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


def _measure_saturation(variant: tuple[str, str, float, int]) -> Row:
    """Return the share of time at the torque's limit on the generic reference [%]."""
    plant, law, speed, seed = variant
    followed = track(
        law,
        "generic",
        (plant,),
        _PROFILE,
        gains=_SATURATED[law],
        speed=speed,
        seed=seed,
        no_disturbance=plant == "mujoco",
        workers=1,
    ).robots[0]
    name = "side_torque_limit_N_m"
    limit = {name: followed.options[name]}
    return {"percent": 100.0 * np.mean(find_saturated(followed.run, limit))}


def _find_saturation(task: Task) -> Findings:
    """Find how often motors are at their limit on the generic reference (Sec. 4.5)."""
    cases = list(product(("improved", "mujoco"), _SATURATED, (0.25, _FAST)))
    variants = {f"{case}, {k}": (*case, k) for case in cases for k in range(task.draws)}
    found = [row["percent"] for row in swept_rows(variants, _measure_saturation, task)]
    rows = {}
    for (plant, law, speed), shares in zip(cases, np.reshape(found, (len(cases), -1)), strict=True):
        rule: Rule = "words" if speed == _FAST else "none"
        pair = Pair(None, np.mean(shares), rule, "%", standard_deviation(shares))
        rows[f"{plant}, {law}, {speed:g} m/s"] = {"time_at_limit_percent": pair}
    return Findings({"Sec. 4.5, motors": rows}, {"seeds": task.draws})


CONTROL_SECTIONS: Sections = {
    **{
        f"tune-{law}": ((number,), partial(_tune_gains, law))
        for law, number in TUNED_TABLES.items()
    },
    "saturation": (("Sec. 4.5, motors",), _find_saturation),
    "tables": ((*CONTROL_TABLES, "4.37"), _track_references),
}
"""The sections on chapter 4."""
