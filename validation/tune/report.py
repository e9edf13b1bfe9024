"""A tuning as terminal and markdown tables, as sentences, and as the document for a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from validation import store
from validation.fit.report import effort, ending, parameter_grid
from validation.show.tables import NOTHING, Cell, Grid, best_of, one_line, rich_table, shortened
from validation.track.report import MEASURES, gains_text, lost_text, metrics_document, units_of
from validation.track.result import TrackMetrics
from validation.tune.result import Followed, TuneResult

SCHEMA = "ssmr.tune/1"
SHOWN = ("d_rms", "d_haus", "d_ratio", "e_rho rms", "saturated")
"""Measures in the table of references."""
LONGEST_LABEL = 40
"""Characters of a reference's name with its speed and plant."""
LOST = "lost"


def label_text(followed: Followed, most: int = LONGEST_LABEL) -> str:
    """What was followed, without the folders it lies in, in at most `most` characters."""
    name = Path(followed.reference).name
    return shortened(followed.label.replace(followed.reference, name), most)


def cost_text(cost: float, lost: bool) -> str:
    """A cost as it is written; `lost` where the robot was."""
    return LOST if lost else f"{cost:.4g}" if math.isfinite(cost) else NOTHING


def against(result: TuneResult) -> str:
    """The gains that the tuning is held against, their cost, and by how much the found one differs."""
    if not math.isfinite(result.baseline_cost):
        return f"{one_line(result.baseline_name)}, which loses a reference"
    known = result.baseline_cost > 0.0 and math.isfinite(result.cost)
    change = f": {result.cost / result.baseline_cost - 1.0:+.1%}".replace("-", "−") if known else ""
    return f"{one_line(result.baseline_name)} at {result.baseline_cost:.4g}{change}"


def _score_grid(result: TuneResult) -> Grid:
    """Per reference the tuned gains and those they are held against; the better of each is emphasised."""
    measures = [m for m in MEASURES if m.name in SHOWN]
    every = [metrics for f in (*result.train, *result.held_out) for metrics in (f.tuned_metrics, f.baseline_metrics)]
    units = units_of(measures, every)
    wanted = {"d_ratio": "one"}
    header = [
        ("reference", ""),
        ("gains", ""),
        ("cost", "1"),
        *((m.name, u.symbol) for m, u in zip(measures, units, strict=True)),
    ]

    def rows(f: Followed, held_out: bool) -> tuple[tuple[Cell, ...], ...]:
        pair: dict[str, tuple[float, bool, TrackMetrics]] = {
            "tuned": (f.tuned_cost, f.tuned.lost, f.tuned_metrics),
            "baseline": (f.baseline_cost, f.baseline.lost, f.baseline_metrics),
        }
        kept = [name for name, (_, lost, _) in pair.items() if not lost]
        costs = {name: cost_text(cost, lost) for name, (cost, lost, _) in pair.items()}
        best = best_of(costs, {name: pair[name][0] for name in kept}, "low")
        columns = [{name: Cell(text, name in best) for name, text in costs.items()}]
        for m, unit in zip(measures, units, strict=True):
            values = {name: m.value(metrics) for name, (_, _, metrics) in pair.items()}
            texts = {name: unit.text(value) for name, value in values.items()}
            best = best_of(texts, {name: values[name] for name in kept}, "one" if wanted.get(m.name) else "low")
            columns.append({name: Cell(text, name in best) for name, text in texts.items()})
        label = f"{'held out: ' * held_out}{label_text(f)}"
        return tuple(
            (Cell(label if k == 0 else ""), Cell(name), *(column[name] for column in columns)) for k, name in enumerate(pair)
        )

    groups = [rows(f, False) for f in result.train] + [rows(f, True) for f in result.held_out]
    return Grid(tuple(header), tuple(groups), left=2)


def _title(result: TuneResult) -> str:
    return f"{result.controller} tuned on {one_line(source(result))} · profile {one_line(result.profile)}"


def source(result: TuneResult) -> str:
    """The references that the cost is made of, each once."""
    return ",".join(dict.fromkeys(f.reference for f in result.train))


def held_gains(result: TuneResult) -> dict[str, float]:
    """The gains that were not searched."""
    searched = {p.name for p in result.parameters}
    return {name: value for name, value in result.gains.items() if name not in searched}


def tune_tables(result: TuneResult) -> list[Table]:
    """A tuning for a terminal of 110 columns or more.

    Args:
        result: what was found.

    Returns:
        The gains within their bounds; and on each reference, trained on and held out, the tuned gains against the baseline,
        the better of each column emphasised where neither was lost.
    """
    grid = parameter_grid(result.parameters, "gain", "baseline")
    held = held_gains(result)
    caption = f"{effort(result)}\nagainst {against(result)}\n{ending(result)}\n"
    if held:
        caption = f"held: {gains_text(held)}\n{caption}"
    return [
        rich_table(grid, _title(result), caption),
        rich_table(_score_grid(result), f"Tuned against {one_line(result.baseline_name)}", ""),
    ]


def tune_notes(result: TuneResult) -> list[str]:
    """What the tables do not say, or should not be overlooked in them, sentence by sentence.

    Args:
        result: what was found.

    Returns:
        That it was interrupted, if it was; which references were lost, when and where; the tuning's own notes.
    """
    notes = []
    if result.status != "finished":
        notes.append("The tuning was interrupted: these are the best gains so far.")
    for f in (*result.train, *result.held_out):
        for who, run in (("tuned gains lose", f.tuned), (f"gains {one_line(result.baseline_name)} lose", f.baseline)):
            if run.lost:
                notes.append(f"The {who} {label_text(f)}: {lost_text(run)}.")
    return notes + [one_line(note) for note in result.notes]


# --- the document ---


def _followed_document(every: Sequence[Followed]) -> dict[str, Any]:
    return {
        f.label: {
            "tuned": {**metrics_document(f.tuned_metrics), "cost": f.tuned_cost, "lost": f.tuned.lost},
            "baseline": {**metrics_document(f.baseline_metrics), "cost": f.baseline_cost, "lost": f.baseline.lost},
        }
        for f in every
    }


def tune_document(result: TuneResult) -> dict[str, Any]:
    """tune.json: null stands for every number that is not finite, as the cost of a lost reference."""
    document = {
        "schema": SCHEMA,
        "controller": result.controller,
        "source": source(result),
        "profile": result.profile,
        "seed": result.seed,
        "status": result.status,
        "stopped_by": result.stopped_by,
        "cost": result.cost,
        "cost_name": result.cost_name,
        "baseline": result.baseline_name,
        "baseline_cost": result.baseline_cost,
        "evaluations": result.evaluations,
        "generations": result.generations,
        "wall_s": result.wall_s,
        "parameters": {
            p.name: {
                "value": p.value,
                "unit": p.unit,
                "lower": p.lower,
                "upper": p.upper,
                "scale": p.scale,
                "at_bound": p.at_bound,
                "standard_error": None,
                "before": p.before,
            }
            for p in result.parameters
        },
        "gains": dict(result.gains),
        "notes": list(result.notes),
        "train": _followed_document(result.train),
        "held_out": _followed_document(result.held_out),
        "options": dict(result.options),
        "versions": dict(result.versions),
        "best_cost_by_generation": result.trace.best_cost[np.isfinite(result.trace.best_cost)].tolist(),
    }
    found: dict[str, Any] = store.plain(document)
    return found
