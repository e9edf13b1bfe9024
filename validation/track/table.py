"""Robots that followed a reference, as tables and as sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ssmr.control.loop import ClosedRun
from ssmr.control.waypoints import ALPHA_SWITCH
from validation.report.columns import REAL_TIME
from validation.report.tables import (
    Cell,
    Grid,
    meanings,
    one_line,
    report_markdown,
    units_of,
)
from validation.track.data import TRACK_METRICS, TrackedRobot

_MOST = 5  # robots that can be told apart in one picture or recording
_MUCH_SATURATED = 0.05  # a robot at its limits for a greater share of time follows them rather than its controller
_UNSETTLED = 0.5  # a speed whose root mean square differs from the reference's by a greater share is pointed out

SHOWN_METRICS = tuple(TRACK_METRICS[name] for name in (
    "d_rms_m", "d_haus_m", "d_ratio", "e_bend_ratio", "sync_rms_m", "yaw_rms_rad",
    "cross_track_max_m", "e_rho_rms_m", "e_y_rms_m", "e_alpha_rms_rad", "u_rms_ratio", "saturated_fraction",
    "command_effort", "command_jerk",
))  # fmt: skip
"""Metrics of each robot in tables and pictures."""
_COLUMNS = (*SHOWN_METRICS, REAL_TIME)
_OF_THE_PATH = 7  # so many of them compare the robot's motion with the reference


def require_comparable(results: Sequence[TrackedRobot]) -> None:
    """Refuse robots that cannot be shown beside one another.

    Raises:
        ValueError: none of them or too many, different references or speeds, or one plant twice.
    """
    if not 1 <= len(results) <= _MOST:
        raise ValueError(f"1 to {_MOST} robots can be shown beside one another, got {len(results)}")
    references = sorted({f"{r.reference} at {r.speed:.6g} m/s" for r in results})
    if len(references) > 1:
        raise ValueError(f"robots beside one another follow one reference, got {', '.join(references)}")
    plants = [r.plant for r in results]
    if len(set(plants)) < len(plants):
        raise ValueError(f"robots beside one another are different plants, got {', '.join(plants)}")


def headline(result: TrackedRobot) -> str:
    """Return a title: the controller, the reference and its speed."""
    return f"{result.controller} follows {Path(one_line(result.reference)).name} at {result.speed:.3g} m/s"


def gains_text(gains: Mapping[str, float]) -> str:
    """Return all gains in one line."""
    return " · ".join(f"{name} {value:.4g}" for name, value in gains.items())


def lost_text(run: ClosedRun) -> str:
    """Return when and where a robot was lost; empty for one that was not."""
    if not run.lost or not len(run.t):
        return "lost at once" if run.lost else ""
    away = math.hypot(*(run.columns("target_x", "target_y")[-1] - run.columns("x", "y")[-1]))
    return f"lost at t = {run.t[-1]:.2f} s, {away:.2f} m from its target"


def track_grids(robots: Sequence[TrackedRobot]) -> list[Grid]:
    """Return two tables of robots on one reference, a row each: measures of the path; errors that the controller sees."""
    labels = [Cell(f"{r.plant} (lost)" if r.run.lost else r.plant) for r in robots]
    metrics = [{**r.metrics, REAL_TIME.name: r.real_time_factor} for r in robots]
    columns = [
        ((m.label, unit.symbol), [Cell(unit.text(of[m.name])) for of in metrics])
        for m, unit in zip(_COLUMNS, units_of(_COLUMNS, metrics), strict=True)
    ]

    def grid(which: Sequence[tuple[tuple[str, str], list[Cell]]], title: str, caption: str = "") -> Grid:
        header = (("plant", ""), *(name for name, _ in which))
        return Grid(header, (tuple(zip(labels, *(cells for _, cells in which), strict=True)),), 1, title, caption)

    first = robots[0]
    title = f"{headline(first)} · profile {one_line(first.profile_label)}"
    caption = f"gains {one_line(first.gains_name)} · seed {first.seed}"
    feedback = first.options.get("feedback")
    if feedback is not None:
        caption += f" · feedback {one_line(feedback)}"
    if first.filter is not None:
        caption += f" · filter {one_line(first.filter.name)}"
    return [grid(columns[:_OF_THE_PATH], title), grid(columns[_OF_THE_PATH:], "Errors to the moving target", caption)]


def track_notes(results: Sequence[TrackedRobot]) -> list[str]:
    """Return sentences on what the tables do not say, or what should not be overlooked in them."""
    notes = []
    for r in results:
        m = r.metrics
        if r.run.lost:
            notes.append(f"{r.plant} was {lost_text(r.run)}: its numbers cover only the time before that.")
        if m["saturated_fraction"] > _MUCH_SATURATED:
            notes.append(f"{r.plant}: a torque or the command was at its limit {m['saturated_fraction']:.0%} of the time.")
        if not r.run.lost and abs(m["u_rms_ratio"] - 1.0) > _UNSETTLED:
            notes.append(
                f"{r.plant}: its speed was {m['u_rms_ratio']:.2f} times that of the reference, by root mean square."
            )
        beyond = float(np.mean(np.abs(r.run.column("e_rho")) > ALPHA_SWITCH)) if len(r.run.t) else 0.0
        if beyond > 0.0:
            notes.append(
                f"{r.plant}: the target was farther than {ALPHA_SWITCH:g} m for {max(beyond, 0.001):.1%} of the time, "
                "where errors of heading count as zero."
            )
    notes += [f"{r.plant}: {r.filter.sentence()}" for r in results if r.filter and r.filter.settings.learns]
    begin = results[0].options.get("start")
    if isinstance(begin, list) and any(begin):
        x, y, yaw = begin
        apart = f"{math.hypot(x, y):.3g} m from the start of the reference and turned by {math.degrees(yaw):.3g} degrees"
        notes.append(f"The robot begins {apart}.")
    lookahead = results[0].options.get("lookahead_m")
    if isinstance(lookahead, float) and lookahead > 0.0:
        notes.append(f"The robot is told to keep {lookahead:g} m behind its target: so e_rho should become that, not zero.")
    return notes


def track_facts(robot: TrackedRobot) -> dict[str, str | int | float]:
    """Return how a robot was driven, by name."""
    r = robot
    return {
        "controller": r.controller,
        "gains": f"{r.gains_name}: {gains_text(r.gains)}",
        "reference": r.reference,
        "speed_m_s": r.speed,
        "profile": r.profile,
        "robot": r.body.name,
        "seed": r.seed,
    }


def track_markdown(results: Sequence[TrackedRobot]) -> str:
    """Return the whole report on robots on one reference as markdown."""
    facts = {**track_facts(results[0]), "options": results[0].options, "versions": results[0].versions}
    legend = meanings(_COLUMNS)
    return report_markdown("Tracking", facts, track_grids(results), track_notes(results), legend)
