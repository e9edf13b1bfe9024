"""The sections on chapter 4: gains tuned as in the thesis, and its tables of tracked references."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ssmr.control.loop import LoopSettings
from validation.bench.gains import load_gains
from validation.bench.loops import make_controller, make_robot, run_robots
from validation.bench.tracked import saturated
from validation.bench.waypoint_files import open_reference
from validation.fit.search import SearchOptions
from validation.plants.profile import load_profile
from validation.progress import Progress
from validation.replicate.evidence import Context, Findings, Section, Table, searched
from validation.replicate.figures import draw_tracked
from validation.replicate.tracked import ALL_LOST, CONTROL_TABLES, TABLE_METRICS, TableEntry, tracked_tables
from validation.thesis import published
from validation.thesis.verdicts import Pair, Rule
from validation.tune.result import TuneResult
from validation.tune.run import tune

_PROFILE, _PLANT = "thesis-lab", "improved"
_TUNED_ON = ("generic", 0.25)
"""Reference and speed [m/s] that gains are tuned on (Sec. 4.3.3)."""
_NOISE_SEED = 0
"""Seed of noise and disturbance in the loop that is tuned; the searches have seeds of their own."""
_OFTEN, _FAST = 20.0, 0.5
"""Share of time [%] that Sec. 4.5 is taken to mean by "often", and the speed that it says so of [m/s]."""
TUNED_TABLES: Mapping[str, str] = {"pid": "4.4", "lqr": "4.21"}
GAIN_NAMES: Mapping[str, Mapping[str, str]] = {
    "pid": {
        "K_P_rho": "k_p_rho", "K_I_rho": "k_i_rho", "K_P_y": "k_p_y", "K_I_y": "k_i_y", "K_P_alpha": "k_p_alpha",
        "K_I_alpha": "k_i_alpha", "K_P_u": "k_p_u", "K_I_u": "k_i_u", "K_P_omega": "k_p_w", "K_I_omega": "k_i_w",
        "K_P_FF_u": "ff_u", "K_P_FF_omega": "ff_w",
    },
    "lqr": {
        "Q_11": "q_x", "Q_22": "q_v", "Q_33": "q_yaw", "Q_44": "q_w", "R_11": "r_v", "R_22": "r_w", "K_alpha": "k_alpha",
        "K_y": "k_y", "K_I_rho": "k_i_rho",
    },
}  # fmt: skip
"""Names of the thesis' gains in our gain sets, by controller."""
_CAPTIONS: Mapping[str, str] = {
    "reference_vs_simulated": "the improved model against the reference (beside it the MuJoCo Husky against the reference)",
    "simulated_vs_real": "the improved model against the robot (ours: against the MuJoCo Husky)",
}


def _tune_section(controller: str) -> Section:
    """Return the section that searches a controller's gains as Sec. 4.3.3 and 4.4.3 did."""
    number = TUNED_TABLES[controller]

    def search(seed: int, context: Context) -> TuneResult:
        settings, (name, speed) = context.settings, _TUNED_ON
        return searched(
            context,
            f"search-{seed}",
            lambda search, progress: tune(
                controller, f"{name}@{speed:g}", _PROFILE, plants=(_PLANT,), held_out=(), gains="published",
                from_scratch=True, guard=0.0, seeds=(_NOISE_SEED,), population=settings.tune_population,
                generations=settings.tune_generations, search=SearchOptions(**search, seed=seed), progress=progress,
            ),
        )  # fmt: skip

    def run(context: Context) -> Findings:
        seeds = range(context.settings.seed, context.settings.seed + context.settings.tune_seeds)
        results = [search(seed, context) for seed in seeds]
        best = min(results, key=lambda r: r.cost)
        caption = f"The {controller.upper()} with the gains of the best search, beside the published ones."
        picture = context.picture("tune", best.figure(), caption)
        reduced = " (reduced: --quick)" if context.settings.quick else ""
        notes = (
            f"{len(results)} search{'es' * (len(results) > 1)}{reduced}, cost "
            f"{', '.join(f'{r.cost:.3f}' for r in results)}; with the published gains {best.baseline_cost:.3f}. "
            f"Population {best.options['population']}, at most {best.options['generations']} generations, generic "
            f"reference at {_TUNED_ON[1]:g} m/s, the improved model with noise and disturbance. Ours are the gains of "
            "the search with the lowest cost; the spread is the standard deviation over all searches.",
            *best.notes(),
        )
        numbers = {"searches": [{"seed": r.seed, "cost": r.cost, "gains": dict(r.gains)} for r in results]}
        return Findings({number: gain_table(controller, results)}, notes=notes, pictures=(picture,), numbers=numbers)

    needs = ("quick", "seed", "tune_seeds", "tune_population", "tune_generations")
    return Section(f"tune-{controller}", f"Gains of the {controller.upper()}, tuned", (number,), needs, run)


def gain_table(controller: str, results: list[TuneResult]) -> Table:
    """Return the thesis' gains beside those of the search with the lowest cost, and below them the cost."""
    number = TUNED_TABLES[controller]
    best = min(results, key=lambda r: r.cost)
    searched = {p.name: p for p in best.parameters}
    rows: dict[str, dict[str, Pair]] = {}
    for row, printed in published.table(number)["rows"].items():
        name, unit = GAIN_NAMES[controller][row], printed["unit"]
        published_value = float(printed.get("optimised", printed.get("value", math.nan)))
        spread = _deviation([float(r.gains[name]) for r in results])
        if name not in searched:
            obstacle = "set by hand in the thesis; taken over"
        elif spread is None:
            obstacle = "a single search has no spread"
        else:
            obstacle = ""
        rows[row] = {"optimised": Pair(published_value, float(best.gains[name]), "spread", unit, spread, {}, obstacle)}
        if "manual" in printed:
            rows[row]["manual"] = Pair(float(printed["manual"]), None, "none", unit)
    costs = [r.cost for r in results]
    beside = {"with_the_published_gains": best.baseline_cost} if math.isfinite(best.baseline_cost) else {}
    rows["cost"] = {"optimised": Pair(None, best.cost, "none", "1", _deviation(costs), beside)}
    return Table(f"Gains of the {controller.upper()}, tuned on the generic reference", rows)


def _deviation(values: list[float]) -> float | None:
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def _tracked(context: Context) -> Findings:
    """Make Tab. 4.5-4.19 and 4.22-4.38."""
    seeds, entries = context.settings.noise_seeds, list[TableEntry]()
    for entry in tracked_tables(load_profile(_PROFILE), seeds, workers=context.workers):
        entries.append(entry)
        context.progress(Progress(len(entries), len(CONTROL_TABLES), f"Tab. {entry.table}"))
    found = {
        e.table: Table(
            f"{e.controller.upper()}, {e.reference} at {e.speed:g} m/s: {_CAPTIONS[e.comparison]}", {e.row: e.pairs}
        )
        for e in entries
    }
    by_place = {(e.controller, e.reference, e.speed): e for e in entries if e.comparison == "simulated_vs_real"}
    repeated: dict[str, dict[str, Pair]] = {}
    for row, printed in published.table("4.37")["rows"].items():
        own = by_place[printed["controller"], printed["trajectory"], float(printed["speed_m_s"])].pairs
        repeated[row] = {metric: replace(pair, published=float(printed[metric])) for metric, pair in own.items()}
    found["4.37"] = Table("Simulated against real, both controllers: repeats Tab. 4.13-4.19 and 4.30-4.36", repeated)
    changes: dict[str, dict[str, Pair]] = {}
    for row, printed in published.table("4.38")["rows"].items():
        reference, _, speed = row.partition("_")
        pid, lqr = (by_place[law, reference, float(speed)] for law in ("pid", "lqr"))
        changes[row] = {}
        for metric in TABLE_METRICS:
            name = f"{metric.removesuffix('_m')}_change_percent"
            change, spread = change_percent(pid, lqr, metric)
            obstacle = "" if change is not None else ALL_LOST
            changes[row][name] = Pair(float(printed[name]), change, "spread", "%", spread, {}, obstacle)
    found["4.38"] = Table("LQR against PID, change of Tab. 4.37 in percent", changes)
    note = (
        f"Means over {seeds} seeds of noise, each with its standard deviation; the thesis prints a single run. "
        "The PID has its published gains, the LQR the manual column of Tab. 4.21 (Sec. 4.4.3). The simulation is disturbed "
        "at random as in the thesis; the MuJoCo Husky, which takes the robot's place, is not."
    )
    lost = [f"{e.table}: {e.lost} of {e.n} seeds lost the reference." for e in entries if e.lost]
    caption = f"d_rms printed (bar) and ours (dot, with the standard deviation of {seeds} seeds), one table a row."
    picture = context.picture("d_rms", draw_tracked(entries, _PROFILE, seeds), caption)
    return Findings(found, notes=(note, *lost), pictures=(picture,))


def change_percent(before: TableEntry, after: TableEntry, metric: str) -> tuple[float | None, float | None]:
    """Return the change of a mean [%], and the standard deviation that follows from those of single runs [%]."""
    if not (before.mean and after.mean and before.mean[metric] > 0.0):
        return None, None
    ratio = after.mean[metric] / before.mean[metric]
    share = [e.deviation[metric] / e.mean[metric] for e in (before, after) if e.n > 1 and e.mean[metric] > 0.0]
    return 100.0 * (ratio - 1.0), 100.0 * ratio * math.hypot(*share) if len(share) == 2 else None


def _saturation(context: Context) -> Findings:
    """Find how often motors are at their limit on the generic reference (Sec. 4.5)."""
    profile, n = load_profile(_PROFILE), context.settings.noise_seeds
    rows: dict[str, dict[str, Pair]] = {}
    for plant in (_PLANT, "mujoco"):
        robot = make_robot(profile, plant)
        limit = {"side_torque_limit_N_m": robot.limits["side_torque_limit_N_m"]}
        loops = [LoopSettings(disturbance=plant != "mujoco")] * n
        for law, gains in (("pid", "published"), ("lqr", "manual")):
            control = make_controller(profile, load_gains(law, gains))
            for speed in (0.25, 0.5):
                waypoints = open_reference(_TUNED_ON[0], speed)[1]
                runs = run_robots([robot] * n, [control] * n, loops, waypoints, range(n), context.workers)
                shares = [100.0 * float(np.mean(saturated(run, limit))) for run in runs]
                rule: Rule = "at_least" if speed == _FAST else "none"
                beside = {"at_least": _OFTEN} if speed == _FAST else {}
                pair = Pair(None, float(np.mean(shares)), rule, "%", _deviation(shares), beside)
                rows[f"{plant}, {law}, {speed:g} m/s"] = {"time_at_limit_percent": pair}
    note = (
        "The thesis says that on the generic path at 0.5 m/s the motors were often at their greatest torque, and that the "
        f"robot can drive the path at 0.25 m/s. Often is taken to mean at least {_OFTEN:g} % of the time. Means over {n} "
        "seeds; the improved model is pushed at random, the MuJoCo Husky is not. The path is ours."
    )
    table = Table("Share of time with a motor at its limit, generic reference", rows)
    return Findings({"Sec. 4.5, motors": table}, notes=(note,))


CONTROL_SECTIONS = (
    *(_tune_section(controller) for controller in TUNED_TABLES),
    Section("saturation", "Motors at their limit", ("Sec. 4.5, motors",), ("noise_seeds",), _saturation),
    Section("tables", "Tracked references", (*CONTROL_TABLES, "4.37", "4.38"), ("noise_seeds",), _tracked),
)
"""The sections on chapter 4."""
