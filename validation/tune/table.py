"""A tuning as tables, and as sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from validation.bench.mismatch import WORST, spread
from validation.bench.tracked import TRACK_METRICS, gains_text, lost_text
from validation.fit.table import effort, ending, parameter_grid
from validation.report.tables import NOTHING, Cell, Grid, judged_cells, one_line, shortened, units_of
from validation.tune.data import TuneData, TunedRun

_SHOWN = ("d_rms_m", "d_haus_m", "d_ratio", "e_rho_rms_m")
"""Measures in the table of references."""
_WORSE = 1.1
"""A cost on a held-out reference that is so many times that of before is worth a sentence."""
_LONGEST_RUN = 40
"""Greatest number of characters of a reference's name with its speed and plant."""


def run_text(run: TunedRun, most: int = _LONGEST_RUN) -> str:
    """Return reference, speed and plant, without the folders of a file, in at most `most` characters."""
    return shortened(run.label.replace(run.reference, Path(run.reference).name), most)


def cost_text(cost: float, lost: bool) -> str:
    """Return a cost as it is written; `lost` where the robot was lost."""
    return "lost" if lost else f"{cost:.4g}" if math.isfinite(cost) else NOTHING


def against(result: TuneData) -> str:
    """Return the name and cost of the gains of before, and the change of the cost."""
    if not math.isfinite(result.baseline_cost):
        return f"{one_line(result.baseline_name)}, which loses a reference"
    by = change(result.cost, result.baseline_cost)
    return f"{one_line(result.baseline_name)} at {result.baseline_cost:.4g}{f': {by}' if by else ''}"


def change(cost: float, before: float) -> str:
    """Return by how much a cost differs from the one of before; empty where one of them is not known."""
    known = before > 0.0 and math.isfinite(cost) and math.isfinite(before)
    return f"{cost / before - 1.0:+.1%}".replace("-", "−") if known else ""


def _costlier(result: TuneData) -> list[TunedRun]:
    """Return the held-out references on which the tuned gains are worse than those of before by more than a tenth."""
    return [f for f in result.held_out if not f.baseline.lost and (f.tuned.lost or f.tuned.cost > _WORSE * f.baseline.cost)]


def _transfer_notes(result: TuneData) -> list[str]:
    """Return sentences on references that were not tuned on, and on the shipped gains."""
    notes = []
    if costlier := _costlier(result):
        there = ", ".join(f"{run_text(f)} {change(f.tuned.cost, f.baseline.cost) or 'lost'}" for f in costlier)
        here = change(result.cost, result.baseline_cost)
        gained = f"cost {here} on what they were tuned on, but " if here else ""
        notes.append(
            f"Compared with {one_line(result.baseline_name)} these gains {gained}are worse on other references: {there}."
        )
    if math.isfinite(result.shipped_cost) and result.shipped_cost < result.cost:
        name, cost = one_line(result.shipped_name), result.shipped_cost
        notes.append(f"The shipped gains {name} cost less on what these were tuned on: {cost:.4g}.")
    return notes


def _score_grid(result: TuneData) -> Grid:
    """Return the tuned gains and those of before on each reference; the better of each measure is emphasised."""
    measures = [TRACK_METRICS[name] for name in _SHOWN]
    followed = (*result.train, *result.held_out)
    every = [run.metrics for f in followed for run in f.runs.values()]
    units = units_of(measures, every)
    header = [
        ("reference", ""),
        ("gains", ""),
        ("cost", ""),
        ("change", ""),
        *((m.label, u.symbol) for m, u in zip(measures, units, strict=True)),
    ]

    def rows(f: TunedRun, held_out: bool) -> tuple[tuple[Cell, ...], ...]:
        kept = {name: run for name, run in f.runs.items() if not run.lost}
        costs = {name: cost_text(run.cost, run.lost) for name, run in f.runs.items()}
        columns = [judged_cells(costs, {name: run.cost for name, run in kept.items()}, "low")]
        changes = {name: "" if name == "baseline" else change(run.cost, f.baseline.cost) for name, run in f.runs.items()}
        columns.append({name: Cell(text) for name, text in changes.items()})
        for m, unit in zip(measures, units, strict=True):
            texts = {name: unit.text(run.metrics[m.name]) for name, run in f.runs.items()}
            columns.append(judged_cells(texts, {name: run.metrics[m.name] for name, run in kept.items()}, m.wanted))
        labels = [f"{'held out: ' * held_out}{run_text(f)}", "", ""]
        return tuple(
            (Cell(label), Cell(name), *(column[name] for column in columns))
            for label, name in zip(labels, f.runs, strict=False)
        )

    groups = [rows(f, False) for f in result.train] + [rows(f, True) for f in result.held_out]
    return Grid(tuple(header), tuple(groups), left=2)


def _robots_grid(result: TuneData) -> Grid:
    """Return the spread of costs over the robots that the tuning has not seen; the least of each column is emphasised."""
    rows = {name: (spread(costs), sum(not math.isfinite(cost) for cost in costs)) for name, costs in result.scores.items()}
    columns = []
    for part in ("mean", "cvar", "worst"):
        values = {name: getattr(found, part) for name, (found, _) in rows.items()}
        texts = {name: cost_text(value, not math.isfinite(value)) for name, value in values.items()}
        columns.append(judged_cells(texts, values, "low"))
    header = (("gains", ""), ("mean", ""), ("CVaR", ""), ("worst", ""), ("robots lost", ""))
    lines = tuple((Cell(name), *(column[name] for column in columns), Cell(str(lost))) for name, (_, lost) in rows.items())
    title = f"Costs with {len(result.scored_on)} robots that the tuning has not seen"
    others = f"Tuned on {len(result.tuned_on)} others of the same distribution"
    caption = f"{others}: the cost was the mean of the worst fifth of them, as CVaR is here."
    return Grid(header, (lines,), 1, title, caption)


def tune_grids(result: TuneData) -> list[Grid]:
    """Return the gains within their bounds, and the tuned gains beside those of before on each reference."""
    caption = f"{effort(result)}\ncompared with {against(result)}\n{ending(result)}\n"
    if result.held_gains:
        caption = f"held: {gains_text(result.held_gains)}\n{caption}"
    title = f"{result.controller} tuned on {one_line(result.source)} · profile {one_line(result.profile_label)}"
    return [
        replace(parameter_grid(result.parameters, "gain", "baseline"), title=title, caption=caption),
        replace(_score_grid(result), title=f"Tuned gains compared with {one_line(result.baseline_name)}"),
        *([_robots_grid(result)] if result.scores else []),
    ]


def tune_notes(result: TuneData) -> list[str]:
    """Return what the tables do not say, or should not be overlooked in them, sentence by sentence."""
    notes = []
    if result.status != "finished":
        notes.append("The tuning was interrupted: these are the best gains so far.")
    for f in (*result.train, *result.held_out):
        for who, run in (("tuned gains lose", f.tuned), (f"gains {one_line(result.baseline_name)} lose", f.baseline)):
            if run.lost:
                notes.append(f"The {who} {run_text(f)}: {lost_text(run.run)}.")
    if result.scores:
        costs = {name: spread(costs).cvar for name, costs in result.scores.items()}
        told = ", ".join(f"{cost_text(cost, not math.isfinite(cost))} with the {name} gains" for name, cost in costs.items())
        drawn = len(result.scored_on)
        notes.append(f"Mean cost of the worst fifth of {drawn} drawn robots that the tuning has not seen: {told}.")
    return notes + _transfer_notes(result) + [one_line(note) for note in result.remarks]


def robots_dict(result: TuneData) -> dict[str, Any]:
    """Return the drawn robots as tune.json holds them; nothing for a tuning on the profile's own."""
    if not result.tuned_on:
        return {}
    drawn = {
        "worst_share": WORST,
        "tuned_on": [asdict(robot) for robot in result.tuned_on],
        "scored_on": [asdict(robot) for robot in result.scored_on],
        "costs": {name: list(costs) for name, costs in result.scores.items()},
    }
    return {"robots": drawn}


def runs_dict(runs: Sequence[TunedRun]) -> dict[str, Any]:
    """Return the runs as tune.json holds them."""
    return {
        each.label: {name: {**run.metrics, "cost": run.cost, "lost": run.lost} for name, run in each.runs.items()}
        for each in runs
    }
