"""The report on robots that followed a reference: tables, sentences, JSON and recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ssmr.control.waypoints import ALPHA_SWITCH
from ssmr.metrics.declared import Metrics
from validation.experiment.tracked import (
    OF_THE_LOOP,
    OF_THE_PATH,
    TRACK_METRICS,
    TrackedRobot,
    headline,
    lost_text,
)
from validation.report.columns import REAL_TIME, declare
from validation.report.palette import BLACK, GREY, WHITE, mix
from validation.report.report import Report
from validation.report.scene_robots import Track, bright
from validation.report.table import Row, Table
from validation.report.track_panels import draw_track, error_units, longest_target
from validation.simulator.terrain import FLAT
from validation.words import one_line

SCHEMA = "ssmr.track/1"
_MUCH_SATURATED = 0.05
"""Share of time at its limits above which a robot follows these rather than its controller."""
_UNSETTLED = 0.5
"""A speed whose RMS differs from the reference's by a greater share is pointed out."""
declare(*TRACK_METRICS.values())


@dataclass(frozen=True, eq=False, kw_only=True)
class Tracked(Report):
    """Robots that followed one reference under one controller; the first is the report's own."""

    robots: tuple[TrackedRobot, ...]
    """The robots, each another plant."""

    @property
    def metrics(self) -> Metrics:
        """Metrics of the first robot by name, such as `metrics["d_rms_m"]`."""
        return self.robots[0].metrics

    def require_complete(self) -> None:
        """Do nothing if every robot came to the end of its reference.

        Raises:
            LostError: one was lost; the message says which, when and where.
        """
        if self.failure is not None:
            raise self.failure


def tracking_report(
    robots: Sequence[TrackedRobot], remarks: Sequence[str] = (), **more: Any
) -> Tracked:
    """Return the report on robots that followed one reference.

    Args:
        robots: one robot or several, each another plant, on the same reference.
        remarks: sentences on what was known before the run.
        more: other fields of the report.
    """
    first = robots[0]
    caption = f"gains {one_line(first.gains_name)} · seed {first.seed}"
    if (feedback := first.options.get("feedback")) is not None:
        caption += f" · feedback {one_line(feedback)}"
    if first.filter is not None:
        caption += " · the thesis' filter"
    labels = [f"{r.plant} (lost)" if r.run.lost else r.plant for r in robots]
    path = list[Row]()
    loop = list[Row]()
    for label, r in zip(labels, robots, strict=True):
        undeclared = [name for name in r.metrics if name not in TRACK_METRICS]
        of_the_path = {name: r.metrics[name] for name in (*OF_THE_PATH, *undeclared)}
        path.append({"plant": label, **of_the_path})
        of_the_loop = {name: r.metrics[name] for name in OF_THE_LOOP}
        loop.append({"plant": label, **of_the_loop, REAL_TIME.name: r.real_time_factor})
    lost = next((r for r in robots if r.run.lost), None)
    title = headline(first)
    about: dict[str, Any] = {
        "program": "track",
        "title": title,
        "tables": [
            Table(f"{title} · profile {one_line(first.profile_label)}", path),
            Table("Errors to the moving target", loop, caption),
        ],
        "document": _document(robots),
        "sentences": [*remarks, *track_notes(robots)],
        "options": first.options,
        "versions": first.versions,
        "draw": _draw,
        "record": write_track_recording,
        "failure": None if lost is None else lost.failure(),
        "robots": tuple(robots),
    }
    return Tracked(**(about | more))


def _document(robots: Sequence[TrackedRobot]) -> dict[str, Any]:
    """Content of track.json: the first robot, and the others under `beside`, by plant."""
    first, *others = robots
    fields = first.as_dict()
    document = {
        "schema": SCHEMA,
        "controller": first.controller,
        "reference": first.reference,
        "speed_m_s": first.speed,
        "plant": first.plant,
        "profile": first.profile,
        "robot": first.body.name,
        "gains_name": first.gains_name,
        "gains": dict(first.gains),
        "seed": first.seed,
        "metrics": {**{name: fields.pop(name) for name in first.metrics}, "lost": first.run.lost},
        **fields,
    }
    if first.filter is not None:
        document["filter"] = {"name": "thesis", **asdict(first.filter)}
    if others:
        document["beside"] = {r.plant: r.as_dict() for r in others}
    return document


def track_notes(robots: Sequence[TrackedRobot]) -> list[str]:
    """Return sentences that add to the tables or point out striking numbers in them."""
    notes = []
    for r in robots:
        m = r.metrics
        if r.run.lost:
            notes.append(
                f"{r.plant} was {lost_text(r.run)}: its numbers cover only the time before that."
            )
        if m["saturated_fraction"] > _MUCH_SATURATED:
            notes.append(
                f"{r.plant}: a torque or the command was at its limit "
                f"{m['saturated_fraction']:.0%} of the time."
            )
        if not r.run.lost and abs(m["u_rms_ratio"] - 1.0) > _UNSETTLED:
            notes.append(
                f"{r.plant}: its speed was {m['u_rms_ratio']:.2f} times "
                "that of the reference, by root mean square."
            )
        far = np.abs(r.run.column("e_rho")) > ALPHA_SWITCH
        beyond = float(np.mean(far)) if len(far) else 0.0
        if beyond > 0.0:
            notes.append(
                f"{r.plant}: the target was farther than {ALPHA_SWITCH:g} m "
                f"for {max(beyond, 0.001):.1%} of the time, "
                "where errors of heading count as zero."
            )
    begin = robots[0].options.get("start")
    if isinstance(begin, list) and any(begin):
        x, y, yaw = begin
        notes.append(
            f"The robot begins {math.hypot(x, y):.3g} m from the start of the reference "
            f"and turned by {math.degrees(yaw):.3g} degrees."
        )
    lookahead = robots[0].options.get("lookahead_m")
    if isinstance(lookahead, float) and lookahead > 0.0:
        notes.append(
            f"The robot keeps {lookahead:g} m behind its target by intention: "
            "e_rho should become that, not zero."
        )
    return notes


def scene_tracks(robots: Sequence[TrackedRobot]) -> list[Track]:
    """Return the robots and, last, the target that they follow."""
    # Planar models stand on no ground.
    ground = next((r.terrain for r in robots if r.terrain != FLAT), FLAT)
    longest = longest_target(robots)
    motions = [*((r.plant, r.run.motion) for r in robots), ("reference", longest)]
    body = robots[0].body
    return [Track(name, (motion,), None, terrain=ground, robot=body) for name, motion in motions]


def _draw(report: Tracked) -> Figure:
    return draw_track([robot.thinned() for robot in report.robots])


def write_track_recording(report: Tracked, path: Path) -> None:
    """Write robots, moving target and signals as a rerun recording, whole or not at all.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    from validation.report.scene import Scene, Series, write_scene

    thinned = [robot.thinned() for robot in report.robots]
    *robots, target = scene_tracks(thinned)
    (motion,) = target.pieces
    plots = dict[str, Series]()
    for quantity, unit, column in (("speed", "m/s", 0), ("yaw_rate", "rad/s", 2)):
        values = motion.twist[:-1, column]
        plots[f"{quantity}/reference"] = Series(["reference"], unit, [GREY], motion.t[:-1], values)
    units = error_units(thinned)
    for r in thinned:
        ink = bright(r.plant)
        inks = [mix(ink, WHITE, 0.5), mix(ink, BLACK, 0.3)]
        names = [f"{r.plant} wanted", f"{r.plant} command"]
        for quantity, unit, *columns in (
            ("speed", "m/s", "u_ref", "v_cmd"),
            ("yaw_rate", "rad/s", "w_ref", "w_cmd"),
        ):
            both = r.run.columns(*columns)
            plots[f"{quantity}/{r.plant}_wanted"] = Series(
                names, unit, inks, r.run.t, both, held=True
            )
        for error, error_unit in units.items():
            values = error_unit.scale * r.run.column(error)
            plots[f"{error}/{r.plant}"] = Series(
                [r.plant], error_unit.symbol, [ink], r.run.t, values
            )
    title = f"{report.title}, profile {report.robots[0].profile_label}"
    scene = Scene(
        program="track",
        title=title,
        tracks=robots,
        report=report.markdown(),
        plots=plots,
        target=target,
    )
    write_scene(scene, path)
