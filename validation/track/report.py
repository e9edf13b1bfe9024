"""Robots that followed a reference, as terminal and markdown tables, as sentences, and as the document for a file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ssmr.control.loop import ClosedRun
from ssmr.control.waypoints import ALPHA_SWITCH
from validation import store
from validation.compare.table import REAL_TIME
from validation.show.tables import (
    Cell,
    Grid,
    code_span,
    markdown_table,
    meanings,
    one_line,
    option_text,
    rich_table,
    unit_of,
    units_of,
)
from validation.track.result import TRACK_METRICS, TrackResult

SCHEMA = "ssmr.track/1"
MOST = 5
"""So many robots at most are told apart in one picture or recording."""
MUCH_SATURATED = 0.05
"""A robot at its limits for a greater share of time than this follows them rather than its controller."""
UNSETTLED = 0.5
"""Speeds whose root mean square is off the reference's by a greater share than this are not those that were asked for."""
SHOWN_METRICS = tuple(TRACK_METRICS[name] for name in (
    "d_rms_m", "d_haus_m", "d_ratio", "e_bend_ratio", "sync_rms_m", "yaw_rms_rad",
    "e_rho_rms_m", "e_y_rms_m", "e_alpha_rms_rad", "u_rms_ratio", "saturated_fraction",
))  # fmt: skip
"""Metrics of each robot in tables and pictures."""
_OF_THE_PATH = 6  # so many of them compare the robot's motion with the reference's


def require_comparable(results: Sequence[TrackResult]) -> None:
    """Refuse robots that cannot be shown beside one another.

    Raises:
        ValueError: none of them or too many, different references or speeds, or one plant twice.
    """
    if not 1 <= len(results) <= MOST:
        raise ValueError(f"1 to {MOST} robots can be shown beside one another, got {len(results)}")
    references = sorted({f"{r.reference} at {r.speed:.6g} m/s" for r in results})
    if len(references) > 1:
        raise ValueError(f"robots beside one another follow one reference, got {', '.join(references)}")
    plants = [r.plant for r in results]
    if len(set(plants)) < len(plants):
        raise ValueError(f"robots beside one another are different plants, got {', '.join(plants)}")


def headline(result: TrackResult) -> str:
    """Who follows what."""
    return f"{result.controller} follows {Path(one_line(result.reference)).name} at {result.speed:.3g} m/s"


def gains_text(gains: Mapping[str, float]) -> str:
    """All gains in one line."""
    return " · ".join(f"{name} {value:.4g}" for name, value in gains.items())


def lost_text(run: ClosedRun) -> str:
    """When and where a robot was lost; empty for one that was not."""
    if not run.lost:
        return ""
    if not len(run.t):
        return "lost at once"
    away = math.hypot(*(run.columns("target_x", "target_y")[-1] - run.columns("x", "y")[-1]))
    return f"lost at t = {run.t[-1]:.2f} s, {away:.2f} m from its target"


def _grids(results: Sequence[TrackResult]) -> tuple[Grid, Grid]:
    """The path and the pace; what the controller sees, and what it costs."""
    labels = [Cell(f"{r.plant} (lost)" if r.run.lost else r.plant) for r in results]
    metrics = [r.metrics for r in results]
    units = units_of(SHOWN_METRICS, metrics)
    columns = [
        ((m.label, unit.symbol), [Cell(unit.text(of[m.name])) for of in metrics])
        for m, unit in zip(SHOWN_METRICS, units, strict=True)
    ]
    factors = [real_time_factor(r) for r in results]
    columns.append((("real time", "×"), [Cell(unit_of("×", factors).text(f)) for f in factors]))

    def grid(which: Sequence[tuple[tuple[str, str], list[Cell]]]) -> Grid:
        header = (("plant", ""), *(name for name, _ in which))
        return Grid(header, (tuple(zip(labels, *(cells for _, cells in which), strict=True)),), left=1)

    return grid(columns[:_OF_THE_PATH]), grid(columns[_OF_THE_PATH:])


def track_tables(results: Sequence[TrackResult]) -> list[Table]:
    """How well each robot followed, for a terminal of 110 columns or more.

    Args:
        results: one robot or several on one reference.

    Returns:
        Two tables with robots as rows and measures as columns: the path; the errors that the controller sees.
    """
    first, (path, errors) = results[0], _grids(results)
    title = f"{headline(first)} · profile {one_line(first.profile)}"
    caption = f"gains {one_line(first.gains_name)} · seed {first.seed}"
    feedback = first.options.get("feedback")
    if feedback is not None:
        caption += f" · feedback {one_line(feedback)}"
    return [rich_table(path, title, ""), rich_table(errors, "Errors to the moving target", caption)]


def track_notes(results: Sequence[TrackResult]) -> list[str]:
    """What the tables do not say, or should not be overlooked in them, sentence by sentence."""
    notes = []
    for r in results:
        m = r.metrics
        if r.run.lost:
            notes.append(f"{r.plant} was {lost_text(r.run)}: its numbers are those of the time before.")
        if m["saturated_fraction"] > MUCH_SATURATED:
            notes.append(f"{r.plant}: a torque or the command was at its limit {m['saturated_fraction']:.0%} of the time.")
        if not r.run.lost and abs(m["u_rms_ratio"] - 1.0) > UNSETTLED:
            notes.append(f"{r.plant}: the root mean square of its speed was {m['u_rms_ratio']:.2f} times the reference's.")
        beyond = float(np.mean(np.abs(r.run.column("e_rho")) > ALPHA_SWITCH)) if len(r.run.t) else 0.0
        if beyond > 0.0:
            notes.append(
                f"{r.plant}: the target was farther than {ALPHA_SWITCH:g} m for {max(beyond, 0.001):.1%} of the time, "
                "where errors of heading count as zero."
            )
    lookahead = results[0].options.get("lookahead_m")
    if isinstance(lookahead, float) and lookahead > 0.0:
        notes.append(f"The robot is told to keep {lookahead:g} m behind its target: e_rho is to become that, not zero.")
    return notes


def track_markdown(results: Sequence[TrackResult]) -> str:
    """Everything in words as GitHub-flavoured markdown.

    Args:
        results: one robot or several on one reference.

    Returns:
        How it was run, the tables of `track_tables`, the sentences of `track_notes`, and what each measure means.
    """
    first, (path, errors) = results[0], _grids(results)
    options = ", ".join(f"{one_line(k)} {option_text(v)}" for k, v in first.options.items() if v is not None)
    versions = ", ".join(f"{one_line(k)} {one_line(v)}" for k, v in first.versions.items())
    lines = [
        "# Tracking",
        "",
        f"- controller: {code_span(first.controller)}",
        f"- gains: {code_span(first.gains_name)}, {code_span(gains_text(first.gains))}",
        f"- reference: {code_span(first.reference)} at {first.speed:.3g} m/s",
        f"- profile: {code_span(first.profile)}",
        f"- seed: {first.seed}",
        f"- options: {code_span(options) if options else 'none'}",
        f"- versions: {code_span(versions) if versions else 'unknown'}",
        "",
        "## How well it was followed",
        "",
        *markdown_table(path),
        "",
        *markdown_table(errors),
    ]
    notes = track_notes(results)
    if notes:
        lines += ["", "## Notes", "", *(f"- {one_line(note)}" for note in notes)]
    lines += ["", "## What the metrics mean", "", *meanings((*SHOWN_METRICS, REAL_TIME))]
    return "\n".join(lines) + "\n"


# --- the document ---


def real_time_factor(result: TrackResult) -> float:
    """Simulated over wall time; infinite where no time was taken."""
    simulated = float(result.run.t[-1]) if len(result.run.t) else 0.0
    return simulated / result.wall_s if result.wall_s > 0.0 else math.inf


def _of_one(result: TrackResult) -> dict[str, Any]:
    """What else differs from robot to robot."""
    return {"lost": result.run.lost, "wall_s": result.wall_s, "real_time_factor": real_time_factor(result)}


def as_document(results: Sequence[TrackResult]) -> dict[str, Any]:
    """track.json: the first robot is the document, others stand under `beside`, by plant.

    Raises:
        ValueError: robots that do not belong beside one another.
    """
    require_comparable(results)
    first, *others = results
    document = {
        "schema": SCHEMA,
        "controller": first.controller,
        "reference": first.reference,
        "speed_m_s": first.speed,
        "plant": first.plant,
        "profile": first.profile,
        "gains_name": first.gains_name,
        "gains": dict(first.gains),
        "seed": first.seed,
        "metrics": dict(first.metrics),
        **_of_one(first),
        "options": dict(first.options),
        "versions": dict(first.versions),
    }
    if others:
        document["beside"] = {r.plant: {**r.metrics, **_of_one(r)} for r in others}
    found: dict[str, Any] = store.plain(document)
    return found
