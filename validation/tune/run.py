"""`python -m validation.tune CONTROLLER`: a controller's gains by differential evolution, along references, on any plant."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ssmr.control.loop import LoopSettings
from ssmr.types import FloatArray
from validation import cli, store
from validation.track.gains import DEFAULT, GainSet, dump_gains, load_gains, names
from validation.track.tracking import Robot, odometry_of, require_practicable
from validation.track.waypoint_files import open_reference
from validation.tune.report import tune_document
from validation.tune.result import TuneResult
from validation.tune.tuning import Case, TuneProblem, tuned_gains

SIZES = {"pid": (100, 150), "lqr": (50, 300), "smc": (100, 150)}
"""Default population and generations; Tab. 4.3, 4.20."""
USUAL_SIZE = (50, 150)
"""Those of any other controller."""
MUJOCO_SIZE = (24, 20)
"""The same where a MuJoCo Husky is among the plants: a run of it costs a hundred times that of a planar model."""
K_U = {"lqr": 50.0}
"""Weight of |1 - u_RMS|; Tab. 4.20. The PID's cost has no such term."""
HELD_OUT = ("line@0.25", "line@0.5", "circle@0.25", "circle@0.5", "sine@0.25", "sine@0.5", "generic@0.25", "generic@0.5")
"""What a tuning is judged on unless the user says otherwise, but for what it is tuned on."""


def parse_references(text: str, speed: float | None) -> tuple[tuple[str, float | None], ...]:
    """`circle@0.5,generic` as names with speeds [m/s]; `speed` for those without.

    Raises:
        UserError: an empty list, or something that is no speed.
    """
    out = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, at, given = part.rpartition("@")
        if not at:
            out.append((part, speed))
            continue
        try:
            number = float(given)
        except ValueError as error:
            raise cli.UserError(f"'{part}' is no REFERENCE@SPEED such as circle@0.5") from error
        out.append((name, number))
    if not out:
        raise cli.UserError(f"no reference is named in '{text}'; such as generic or circle@0.5,sine@0.25")
    return tuple(out)


def make_cases(
    wanted: Sequence[tuple[str, float | None]], robots: Sequence[Robot], settings: LoopSettings
) -> tuple[Case, ...]:
    """Every robot on every reference.

    Raises:
        ValueError: a reference that cannot be read, or that no wheel can follow.
    """
    out = []
    for name, speed in wanted:
        label, waypoints = open_reference(name, speed)
        for robot in robots:
            require_practicable(waypoints, robot.drive, label)
            around = replace(settings, filter=odometry_of(robot.drive))
            out.append(Case(f"{label} at {waypoints.speed:.3g} m/s, {robot.name}", name, waypoints, robot, around))
    return tuple(out)


def baseline_of(controller: str, gains: str | None, held: dict[str, float]) -> GainSet:
    """The gains that a tuning begins with: those named, else the published, else the defaults; with those that are held.

    Raises:
        ValueError: unknown gains.
    """
    published = f"{controller}-published" in names(controller)
    base = load_gains(controller, gains or ("published" if published else DEFAULT))
    unknown = [name for name in held if name not in base.values]
    if unknown:
        raise ValueError(f"{controller} has no gain '{unknown[0]}'; there are: {', '.join(base.values)}")
    return GainSet(controller, base.name, {**base.values, **held}) if held else base


def first_point(problem: TuneProblem) -> FloatArray:
    """(1, n) the gains it begins with, moved into the bounds where they lie outside."""
    values = np.array([problem.base.values[name] for name in problem.space.names])
    return problem.space.points(np.clip(values, problem.space.lower, problem.space.upper))[None]


def write(result: TuneResult, name: str, folder: Path) -> list[Path]:
    """Write tune.png, gains.toml and, last, tune.json; return what was written."""
    from validation.compare.figure import save_figure
    from validation.tune.figure import draw_tune

    written = [folder / "tune.png", folder / "gains.toml", folder / "tune.json"]
    save_figure(draw_tune(result), written[0])
    text = dump_gains(tuned_gains(result, name, datetime.datetime.now(datetime.UTC).date().isoformat()))
    store.write_atomic(written[1], lambda temporary: temporary.write_text(text, encoding="utf-8"))
    store.write_json(written[2], tune_document(result))
    return written
