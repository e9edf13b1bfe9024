"""Transfer study: does a model choose the right controller for the MuJoCo robot?

See docs/controllers.md.
Every controller follows every reference on every plant, under the same noise. MuJoCo is the judge:
it stands for the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import kendalltau

from ssmr.control.laws import PLAIN_CONTROLLERS, Controller
from ssmr.control.loop import LoopSettings
from ssmr.control.waypoints import Waypoints
from ssmr.parameters import require_one_of
from ssmr.types import FloatArray
from validation import cli, output
from validation.experiment.gains import DEFAULT, GainSet, load_gains, shipped_sets
from validation.experiment.loops import (
    JUDGE,
    AnyController,
    ClosedLoopRobot,
    make_controller,
    make_robot,
    run_robots,
    slowed_to_feasible,
)
from validation.experiment.tracked import track_metrics
from validation.experiment.waypoint_files import REFERENCES, split_speed
from validation.identify.tuning import TARGET_SHARE, TuneCost, costs_of
from validation.output import Document, shorten_text
from validation.plants.profile import PLANTS, Profile
from validation.report import drawing
from validation.report.palette import spell_name
from validation.report.table import Row, Table
from validation.simulator.description import with_robot
from validation.study.common import Study, StudyOptions
from validation.sweep import sweep

_REFERENCES = (
    "eight",
    "u-turn",
    "stop-and-go",
    "slalom",
    "square",
    "spiral",
    "sine",
    "generic",
    "circle",
    "line",
)
"""References of a study that names none; a quick study has the first three."""
_SPEEDS = (0.25, 0.5)
"""Speeds of the thesis [m/s]; a quick study has the last."""
_SAME_COST = TuneCost(guard=0.0)
"""Cost of Sec. 4.3.3 without the LQR's additional term: the same for all laws, so that they can be
compared."""
_METRES = TuneCost("metres", guard=0.0)
"""Measure that ranks controllers [m], which `tune` minimises."""
_MEANS = ("metres", "cost", "d_rms_m", "sync_rms_m")
"""Measures of a controller on a reference, of which study.json has the means too."""
_DRAWS = 400
"""Drawings of the references, with repeats, from which intervals of 90 % are taken."""


@dataclass(frozen=True, kw_only=True)
class TransferStudy(StudyOptions):
    """Options of the study of transfer."""

    plants: Sequence[str] = PLANTS
    """Plants that are to choose for MuJoCo's robot, which is driven too."""
    controllers: Sequence[str] = (
        *PLAIN_CONTROLLERS,
        "lqr+predictor",
        "lqr-scheduled+predictor",
        "mpc",
    )
    """Controllers with all their shipped gains; pid:tuned is one with one set, pid:FILE.toml one
    with gains of your own."""
    references: Sequence[str] = ()
    """References by name; circle@0.4 has its own speed [m/s], others 0.25 and 0.5, or 0.5 alone if
    quick. What the robot cannot drive in MuJoCo is driven more slowly."""
    quick: bool = False
    """Take three references where none are named, and one speed."""

    def __post_init__(self) -> None:
        """Raise a ValueError where there is no plant besides MuJoCo."""
        super().__post_init__()
        if not set(self.plants) - {JUDGE}:
            raise ValueError(
                f"plants names none besides {JUDGE}; name one that is to choose for it"
            )

    @property
    def noise_seed(self) -> int:
        """Seed of noise and pushes: no shipped set was tuned with one of this size."""
        return self.seed + 11


Contenders = Mapping[str, tuple[AnyController, GainSet]]
"""Controllers with their gains, by the name that they have in tables."""


def _contenders_of(o: TransferStudy, profile: Profile) -> Contenders:
    """Controllers on a profile, whose own gains take the place of the shipped tuned ones.

    Raises:
        ValueError: an unknown controller, gains or file, one name for two, or fewer than two
            contenders.
    """
    contenders = {}
    for named in o.controllers:
        controller, colon, kind_named = named.partition(":")
        kinds = [kind_named]
        sets = shipped_sets(controller)
        if not colon:
            kinds = [name for name, path in sets.items() if path.stem != controller]
        for kind in kinds or [DEFAULT]:
            tuned_here = kind == "tuned" and profile.name in sets
            gains = load_gains(controller, profile.name if tuned_here else kind)
            name = controller if kind == DEFAULT else f"{controller} {Path(kind).stem}"
            if name in contenders:
                raise ValueError(
                    f"two controllers are called '{name}'; leave out '{named}', or rename it"
                )
            contenders[name] = (make_controller(profile, gains), gains)
    if len(contenders) < 2:
        names_found = ", ".join(contenders) or "no controllers"
        raise ValueError(f"there is no choice among {names_found}; name two or more")
    return contenders


def missions_of(o: TransferStudy, robot: ClosedLoopRobot) -> dict[str, tuple[str, Waypoints]]:
    """References and their names, each at every speed, or as fast as the robot can drive it.

    Raises:
        ValueError: an unknown reference; the message lists them.
    """
    missions: dict[str, tuple[str, Waypoints]] = {}
    references = _REFERENCES[:3] if o.quick else _REFERENCES
    speeds = _SPEEDS[-1:] if o.quick else _SPEEDS
    for named in o.references or references:
        name, speed_named = split_speed(named)
        require_one_of(name, REFERENCES, f"no reference '{name}'")
        for speed in speeds if speed_named is None else (speed_named,):
            slowed = slowed_to_feasible(REFERENCES[name](speed), robot)
            # two speeds that the robot cannot drive are one
            missions.setdefault(f"{name} {slowed.speed:.3f}", (name, slowed))
    return missions


_CostsByGains = Mapping[str, float | int | None]
"""Metres, cost (Sec. 4.3.3) and errors of a controller on a reference, None if it lost it; `lost`.
"""


def _score_controllers(
    o: TransferStudy, robot: ClosedLoopRobot, laws: Sequence[AnyController], waypoints: Waypoints
) -> list[_CostsByGains]:
    """Drive every controller along a reference, with the same noise and disturbance.

    Compiled laws are driven as one population and Python objects, such as mpc, as another.
    """
    target = waypoints.trajectory(LoopSettings().position_period)
    scores = {}
    for compiled in (True, False):
        ranks = [k for k, law in enumerate(laws) if isinstance(law, Controller) is compiled]
        if not ranks:
            continue
        n = len(ranks)
        chosen = [laws[k] for k in ranks]
        settings = [LoopSettings()] * n
        runs = run_robots([robot] * n, chosen, settings, waypoints, [o.noise_seed], o.workers)
        costs = costs_of(runs, target, waypoints.rms_speed, _SAME_COST)
        metres = costs_of(runs, target, waypoints.rms_speed, _METRES)
        for k, run, cost, m in zip(ranks, runs, costs, metres, strict=True):
            errors = {**track_metrics(run, waypoints, robot.limits), "cost": cost, "metres": m}
            # errors of a robot that was lost end early, and would look small
            found = {name: None if run.lost else float(errors[name]) for name in _MEANS}
            scores[k] = {**found, "lost": int(run.lost)}
    return [scores[k] for k in range(len(laws))]


# Costs of several references are (R, C) arrays, a column for each controller; infinite where the
# robot was lost.


def mean_costs(costs: FloatArray) -> FloatArray:
    """The (C,) mean costs over the references that were kept; NaN if a controller lost all."""
    kept = np.isfinite(costs)
    count = kept.sum(axis=0)
    totals = np.where(kept, costs, 0.0).sum(axis=0)
    return np.where(count > 0, totals / np.maximum(count, 1), np.nan)


def rank_places(costs: FloatArray) -> NDArray[np.intp]:
    """Return the (C,) places of controllers, 0 for the best; equal ones share a place.

    Who loses fewer references is placed before who loses more, whatever the cost; among equals the
    mean cost of the references that were kept decides.
    """
    keys = np.column_stack([np.isinf(costs).sum(axis=0), np.nan_to_num(mean_costs(costs))])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


def rank_correlation(costs: FloatArray, others: FloatArray) -> float:
    """Kendall's tau-b between the places on two plants [-1 to 1].

    NaN where one of them has all controllers in one place.
    """
    return kendalltau(rank_places(costs), rank_places(others)).statistic


def chosen_column(costs: FloatArray, truth: FloatArray) -> int:
    """Column of the controller in the first place; of several there, the worst in truth."""
    first = np.flatnonzero(rank_places(costs) == 0)
    return int(first[np.argmax(rank_places(truth)[first])])


def regret_of_choice(costs: FloatArray, truth: FloatArray) -> float:
    """Excess in `truth` of the choice by `costs` over the best choice, as a share of its cost.

    It is infinite where the choice loses more references than the best; of choices that lose as
    many, kept references count.
    """
    chosen = chosen_column(costs, truth)
    best = chosen_column(truth, truth)
    # a lost robot costs more than any error
    lost = np.isinf(truth).sum(axis=0)
    if lost[chosen] > lost[best]:
        return math.inf
    means = mean_costs(truth)
    if not means[best] > 0.0:
        return 0.0
    return means[chosen] / means[best] - 1.0


def _resampled_intervals(
    values: Callable[[NDArray[np.intp]], Any], rows: int, seed: int
) -> FloatArray:
    """Return the (2, ...) ends of the 90 % intervals of what `rows` references give.

    References are drawn anew, with repeats: `values` gives the same numbers for (rows,) drawn ones.
    A number that a drawing does not give (NaN) is left out; without any the interval is NaN.
    """
    rng = np.random.default_rng(seed)
    drawn = np.array([values(rng.integers(rows, size=rows)) for _ in range(_DRAWS)], np.float64)
    ends = np.full((2, *drawn.shape[1:]), np.nan)
    known = ~np.isnan(drawn).all(axis=0)
    ends[:, known] = np.nanquantile(drawn[:, known], (0.05, 0.95), axis=0, method="nearest")
    return ends


def cost_agreement(costs: FloatArray, truth: FloatArray, seed: int = 0) -> Document:
    """Return how a model's costs agree with the true ones.

    That is `tau`, the rank correlation; `chosen`, the column of the choice; its `regret`; and
    `same_winner`, the number of references on which both have the same best controller. The first
    and the third have intervals, `tau_low` to `tau_high` and `regret_low` to `regret_high`.
    """

    def drawn(rows: NDArray[np.intp]) -> tuple[float, float]:
        return rank_correlation(costs[rows], truth[rows]), regret_of_choice(
            costs[rows], truth[rows]
        )

    low, high = _resampled_intervals(drawn, len(costs), seed)
    same = 0
    for row, true in zip(costs[:, None], truth[:, None], strict=True):
        same += chosen_column(row, true) == chosen_column(true, true)
    return {
        "tau": rank_correlation(costs, truth),
        "tau_low": low[0],
        "tau_high": high[0],
        "chosen": chosen_column(costs, truth),
        "regret": regret_of_choice(costs, truth),
        "regret_low": low[1],
        "regret_high": high[1],
        "same_winner": same,
    }


def _list_findings(
    profile: Profile, contenders: Contenders, drives: Sequence[Row], seed: int
) -> Document:
    """Findings as study.json has them, from rows of `reference`, `speed_m_s` and `scores`."""
    names = list(contenders)

    def table_of(plant: str, measure: str = "metres") -> FloatArray:
        scores = [drive["scores"][plant] for drive in drives]
        rows = [[each[name][measure] for name in names] for each in scores]
        table = np.array(rows, dtype=np.float64)
        return np.where(np.isnan(table), np.inf, table)

    tables = {plant: table_of(plant) for plant in drives[0]["scores"]}
    truth = tables[JUDGE]
    plants = {}
    for plant, costs in tables.items():
        agreed = cost_agreement(costs, truth, seed)
        low, high = _resampled_intervals(partial(_drawn_means, costs), len(costs), seed)
        means = {measure: mean_costs(table_of(plant, measure)) for measure in _MEANS}
        # sums over different references cannot be compared
        kept = np.isfinite(costs).all(axis=0) & np.isfinite(truth).all(axis=0)
        gaps = np.where(kept, mean_costs(costs) / mean_costs(truth) - 1.0, np.nan)
        ranked = 1 + rank_places(costs)
        each = {}
        for k, name in enumerate(names):
            scores = [drive["scores"][plant][name] for drive in drives]
            each[name] = {
                **{measure: values[k] for measure, values in means.items()},
                "metres_low": low[k],
                "metres_high": high[k],
                "gap": gaps[k],
                "place": ranked[k],
                "lost": sum(score["lost"] for score in scores),
                "by_reference": scores,
            }
        plants[plant] = {
            "all": {**agreed, "chosen": names[agreed["chosen"]]},
            "tau_with": {p: rank_correlation(costs, other) for p, other in tables.items()},
            "contenders": each,
        }
    gains = {name: g for name, (_, g) in contenders.items()}
    return {
        "robot": profile.robot.name,
        "contenders": {
            name: {"gains": {"controller": g.controller, "name": g.name, **g.values}}
            for name, g in gains.items()
        },
        "references": [{"name": r["reference"], "speed_m_s": r["speed_m_s"]} for r in drives],
        "plants": plants,
    }


def _drawn_means(costs: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
    return mean_costs(costs[rows])


def _ranked_names(result: Document) -> list[str]:
    judged = result["plants"][JUDGE]["contenders"]
    return sorted(judged, key=lambda name: judged[name]["place"])


def _make_tables(label: str, result: Document) -> list[Table]:
    plants = result["plants"]
    choices = [
        {
            "plant": plant,
            **{key: found["all"][key] for key in ("tau", "tau_low", "tau_high", "same_winner")},
            "regret_share": found["all"]["regret"],
            "regret_high_share": found["all"]["regret_high"],
            "chooses": found["all"]["chosen"],
        }
        for plant, found in plants.items()
    ]
    costs = []
    for name in _ranked_names(result):
        by_plant = {plant: found["contenders"][name] for plant, found in plants.items()}
        row = {"controller": name}
        row |= {f"{plant}_m": each["metres"] for plant, each in by_plant.items()}
        judged = by_plant[JUDGE]
        row |= {f"{JUDGE}_low_m": judged["metres_low"], f"{JUDGE}_high_m": judged["metres_high"]}
        row |= {measure: judged[measure] for measure in ("d_rms_m", "sync_rms_m", "cost")}
        costs.append({**row, "lost_runs": sum(each["lost"] for each in by_plant.values())})
    caption = (
        f"{len(costs)} controllers, {len(result['references'])} references. "
        f"tau: Kendall's rank correlation with {JUDGE}.\n"
        f"same winner: number of references on which the simulation chooses as {JUDGE} does.\n"
        f"regret: by how much more metres the choice over all references has on {JUDGE}; "
        "none where it loses runs there.\n"
        "low, high: 90 % interval, from references drawn anew."
    )
    below = (
        f"Metres: distance to the path (d_rms) and {TARGET_SHARE:g} of that to the moving target "
        "(sync), which tune minimises; mean over the references.\n"
        f"d_rms, sync and cost, that of Sec. 4.3.3: on {JUDGE}. "
        "Controllers are ranked by lost runs first, then by metres."
    )
    return [
        Table(f"{label}: choosing a controller for {JUDGE}", choices, caption),
        Table(f"{label}: metres", costs, below),
    ]


@cli.make_program(TransferStudy)
def study_transfer(o: TransferStudy) -> Study:
    """Let every controller follow every reference on every plant, and compare the choices.

    Does a model choose the right controller for MuJoCo's robot?

    Raises:
        ValueError: a profile, plant, controller, gains or reference do not exist or do not go
            together.
    """
    profile = o.robot_profile()
    robots = {plant: make_robot(profile, plant) for plant in dict.fromkeys((JUDGE, *o.plants))}
    contenders = _contenders_of(o, profile)
    laws = [law for law, _ in contenders.values()]
    options = o
    if isinstance(o.workers, str):
        options = replace(o, workers=1, progress=output.ignore_progress)

    def follow(mission: tuple[str, Waypoints]) -> Row:
        name, waypoints = mission
        scores = {}
        for plant, robot in robots.items():
            of_laws = _score_controllers(options, robot, laws, waypoints)
            scores[plant] = dict(zip(contenders, of_laws, strict=True))
        return {"reference": name, "speed_m_s": waypoints.speed, "scores": scores}

    # a drive is a population on all threads here, and each is one task of a scheduler
    missions = missions_of(o, robots[JUDGE])
    workers = o.workers if isinstance(o.workers, str) else 1
    swept = sweep(missions, {"drive": follow}, workers=workers, progress=o.progress)
    drives = [row for row in swept.rows if "scores" in row]
    result = _list_findings(profile, contenders, drives, o.noise_seed)
    label = with_robot(profile.name, profile.robot.name)
    return Study(
        title=f"Transfer, {label}: {len(swept.rows)} references",
        shown=_make_tables(label, result),
        remarks=swept.notes,
        status=swept.status,
        panels=_draw_panels(label, result),
        options={"judge": JUDGE, "seed": o.seed},
        about={
            "schema": "ssmr.study/1",
            "study": "transfer",
            "judge": JUDGE,
            "robot": profile.robot.name,
            "seeds": [o.noise_seed],
            "profiles": {profile.name: result},
        },
    )


def _draw_panels(label: str, result: Document) -> list[drawing.PanelRow]:
    order = _ranked_names(result)

    def draw(ax: Axes) -> None:
        for plant, found in result["plants"].items():
            ink = drawing.ink_of(plant)
            marker = "D" if plant == JUDGE else "o"
            for row, name in enumerate(order):
                each = found["contenders"][name]
                shape = "x" if each["lost"] else marker
                ax.plot(each["metres"], row, shape, color=ink, gid=f"{plant} {name}")
                if plant == JUDGE:
                    ends = [each["metres_low"], each["metres_high"]]
                    ax.plot(ends, [row, row], color=ink, linewidth=1.2)
            ax.plot([], [], marker, color=ink, label=spell_name(plant))
        ax.set(
            xscale="log",
            xlabel="path error + distance to the moving target / 10 [m] (cross: lost on a run)",
        )
        ax.set_title(f"{label}: the best on {spell_name(JUDGE)} at the top")
        ax.set_ylim(len(order) - 0.4, -0.6)
        names = [shorten_text(spell_name(name), 30) for name in order]
        ax.set_yticks(range(len(order)), names, fontsize=9.0)
        drawing.plain_ticks(ax.xaxis, (1.0, 2.0, 5.0))
        ax.legend(fontsize=8.0)

    return [drawing.PanelRow(1.2 + 0.25 * len(order), [draw])]
