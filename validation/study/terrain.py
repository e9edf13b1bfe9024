"""Up to which speed and slope planar models and trackers hold (docs/terrain.md).

Without feedback, all plants get the commands of trajectories 1-4. With feedback, trackers follow a reference and know
nothing of the ground.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.loop import LoopSettings
from ssmr.errors import SsmrError
from ssmr.metrics.windows import horizon_windows, relative_pose_error
from ssmr.models.law import PLANAR_MODELS as PLANAR
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State, Trajectory
from validation import cli
from validation.bench.gains import load_gains
from validation.bench.loops import make_controller, make_robot, rate, run_robots
from validation.bench.waypoint_files import open_reference
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile, make_plant
from validation.report import drawing
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.simulator.description import with_robot
from validation.simulator.terrain import FLAT, Terrain
from validation.study.options import StudyOptions
from validation.study.sweep import picture, sweep

AxisName = Literal["speed", "slope"]
AXES: Mapping[AxisName, tuple[str, str, float, float]] = {
    "speed": ("Speed on level ground", "m/s", 1.0, 0.5),
    "slope": ("Slope", "°", 180.0 / math.pi, 0.0),
}
"""Each quantity that grows: its name, the unit in which it is shown, how many of those make one SI unit, and the value that
the thesis' experiments have [SI]."""
TRACKED = "generic"
"""Reference of the closed loops."""
_Fixed = Annotated[tuple[float, ...], tyro.conf.Suppress, tyro.conf.Fixed]  # values that only Python changes


@dataclass(frozen=True, kw_only=True)
class TerrainStudy(StudyOptions):
    """Options of the study of terrain."""

    horizon: float = 6.0
    """Time after which relative poses are compared [s]."""
    controllers: Annotated[cli.Names, cli.option()] = ("pid", "lqr")
    """Trackers, with their tuned gains."""
    speed: _Fixed = (0.2, 0.35, 0.5, 0.7, 0.85, 1.0)
    """Speeds on level ground [m/s]."""
    slope: _Fixed = tuple(map(math.radians, (0.0, 1.0, 2.0, 4.0, 7.0, 10.0)))
    """Slopes of ramps [rad]."""
    directions: _Fixed = tuple(map(math.radians, (0.0, 90.0, 180.0, 270.0)))
    """Headings in which ramps rise [rad]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a horizon longer than the trajectories."""
        if not 0.0 < self.horizon <= 20.0:
            raise ValueError(f"horizon {self.horizon:g} s must be positive and within the trajectories' 20 s")

    def grounds(self, axis: AxisName, value: float) -> list[Terrain]:
        """Return the grounds that belong to one value: ramps in every direction."""
        if axis == "slope" and value > 0.0:
            return [Terrain("ramp", slope=value, toward=d) for d in self.directions]
        return [FLAT]


class Case(NamedTuple):
    """One value of one axis."""

    axis: AxisName  # quantity that grows
    value: float  # its value [SI]


@cli.program(TerrainStudy)
def study_terrain(o: TerrainStudy) -> Report:
    """Measure the errors of planar models and trackers as speed and slope grow.

    Raises:
        ValueError: the profile does not exist, or its numbers do not fit together.
    """
    profile = o.robot_profile()
    planar = {v: _drive_planar(profile, v) for v in dict.fromkeys((AXES["speed"][3], *o.speed))}
    cases = {f"{axis} {words_of(axis, v)}": Case(axis, v) for axis in AXES for v in getattr(o, axis)}
    drives = {"models": partial(_open_loop, o, profile, planar), "trackers": partial(_track, o, profile)}
    swept = sweep(cases, drives, workers=o.workers, progress=o.progress)
    rows = [{**cases[row["variant"]]._asdict(), **row} for row in swept.rows]
    by_axis = {axis: [row for row in rows if row["axis"] == axis] for axis in AXES}
    at = {plant: {axis: doubled_at(axis, plant, some) for axis, some in by_axis.items()} for plant in PLANAR}
    doubled = [
        {"model": p, **{a: None if v is None else words_of(a, v) for a, v in found.items()}} for p, found in at.items()
    ]
    whose = with_robot(profile.name, profile.robot.name)
    return Report(
        program="study", title=f"Terrain, profile {whose}; errors after {o.horizon:g} s, {TRACKED} tracked", draw=_draw,
        tables=[
            *(Table(AXES[axis][0], some, hidden=frozenset({"axis", "value"})) for axis, some in by_axis.items()),
            Table("Where a planar model's position error has doubled", doubled),
        ],
        sentences=swept.notes, status=swept.status, options={"seed": o.seed, "horizon": o.horizon},
        document={
            "schema": "ssmr.study/1", "study": "terrain", "robot": profile.robot.name, "profile": profile.name,
            "axes": {axis: getattr(o, axis) for axis in AXES}, "doubled_at": at,
        },
        has_text=True,
    )  # fmt: skip


def words_of(axis: AxisName, value: float) -> str:
    """Return a value [SI] of an axis as tables show it."""
    return f"{AXES[axis][2] * value:.3g} {AXES[axis][1]}"


def _commands_at(speed: float) -> list[Commands]:
    """Return trajectories 1-4 at another speed [m/s]."""
    return [replace(scenario, speed=speed).commands() for scenario in TRAJECTORIES.values()]


def _drive_planar(profile: Profile, speed: float) -> dict[str, list[Trajectory]]:
    """Return the planar models' motions on trajectories 1-4; the ground does not change them."""
    made = {name: make_plant(profile, name) for name in PLANAR}
    return {name: [p.run(c, State(), SAMPLE_DT) for c in _commands_at(speed)] for name, p in made.items()}


def _open_loop(
    o: TerrainStudy, profile: Profile, planar: Mapping[float, Mapping[str, Sequence[Trajectory]]], case: Case
) -> Row:
    """Return the errors of planar models; a run counts as failed where the robot fell over or the simulator gave up."""
    speed = case.value if case.axis == "speed" else AXES["speed"][3]
    motions: list[Trajectory | None] = []
    for terrain in o.grounds(*case):
        body = make_plant(profile, "mujoco", terrain)
        for commands in _commands_at(speed):
            try:
                motions.append(body.run(commands, State(), SAMPLE_DT))
            except SsmrError:
                motions.append(None)
    return model_errors(motions, planar[speed], o.horizon)


def model_errors(
    truths: Sequence[Trajectory | None], planar: Mapping[str, Sequence[Trajectory]], horizon: float
) -> dict[str, Any]:
    """Return the errors of each planar model against all runs of the MuJoCo robot at one value.

    Args:
        truths: the MuJoCo robot's motions, ground by ground, trajectory by trajectory; None for one that failed.
        planar: the models' motions by name, one for each trajectory.
        horizon: time after which relative poses are compared [s].

    Returns:
        By model the medians of the errors of position [m] and heading [rad] after the horizon; None where every run failed.
        `failed` is the number of those runs.
    """
    found: dict[str, Any] = {f"{plant}{what}": None for what in ("_m", "_yaw_rad") for plant in planar}
    for plant, motions in planar.items():
        pairs = [(t, m) for t, m in zip(truths, itertools.cycle(motions), strict=False) if t is not None]
        if pairs:
            errors = [relative_pose_error(m.pose, t.pose, *horizon_windows(t.t, horizon)) for t, m in pairs]
            for k, what in enumerate(("_m", "_yaw_rad")):
                found[plant + what] = float(np.median(np.concatenate([each[k] for each in errors])))
    return {**found, "failed": sum(truth is None for truth in truths)}


def _track(o: TerrainStudy, profile: Profile, case: Case) -> Row:
    """Return by tracker the mean d_rms on the reference with the lab's noise [m], and on how many grounds it was lost.

    They drive at 0.25 m/s, unless speed is the quantity that grows.
    """
    if not (names := o.controllers):
        return {}
    _, waypoints = open_reference(TRACKED, case.value if case.axis == "speed" else 0.25)
    robots = [make_robot(profile, "mujoco", terrain) for terrain in o.grounds(*case)]
    loop = LoopSettings("noisy", filter=odometry_of(robots[0].drive))
    laws = [make_controller(profile, load_gains(name, "tuned")) for name in names]
    n, found = len(laws), dict[str, Any]()
    runs = [(r, run_robots([r] * n, laws, [loop] * n, waypoints, [o.seed], 1)) for r in robots]
    for k, name in enumerate(names):
        distances = [rate(each[k], waypoints, robot)["d_rms_m"] for robot, each in runs if not each[k].lost]
        found[f"{name}_tracks_m"] = float(np.mean(distances)) if distances else None
        found[f"{name}_lost"] = len(runs) - len(distances)
    return found


def doubled_at(axis: AxisName, plant: str, rows: Sequence[Row]) -> float | None:
    """Return the value at which a model's position error is twice that under the thesis' conditions [SI].

    It is interpolated linearly between the driven values; None where the error stays below that on the whole axis.
    """
    line = [(r["value"], r[f"{plant}_m"]) for r in rows if r[f"{plant}_m"] is not None and r["value"] >= AXES[axis][3]]
    for (value, error), (next_value, next_error) in itertools.pairwise(line):
        limit = 2.0 * line[0][1]
        if next_error > limit:
            share = (limit - error) / (next_error - error)
            return float(value + max(share, 0.0) * (next_value - value))
    return None


def _draw(study: Report) -> Figure:
    """Return the picture: errors along the axes, without and with feedback; dashed: as in the thesis."""
    rows = {axis: study.tables[k].rows for k, axis in enumerate(AXES)}
    columns = dict.fromkeys(c for some in rows.values() for row in some for c in row)
    open_loop = {f"{plant}_m": (plant, drawing.ink_of(plant)) for plant in PLANAR}
    trackers = [c.removesuffix("_tracks_m") for c in columns if c.endswith("_tracks_m")]
    closed = {f"{name}_tracks_m": (f"{name}, tuned", drawing.controller_ink(name)) for name in trackers}
    parts = {
        "Planar models: median position error [mm]": open_loop,
        "Trackers that know nothing of the ground: distance from the reference [mm] (cross: lost on one)": closed,
    }
    drawn: list[drawing.Row] = []
    for title, lines in parts.items():
        drawn.append(drawing.text_row(0.3, partial(drawing.draw_section, title)))
        drawn.append(drawing.side_by_side(3.2, [partial(_draw_axis, axis, rows, lines) for axis in AXES]))
    return picture(study, drawn)


def _draw_axis(
    axis: AxisName, rows: Mapping[AxisName, Sequence[Row]], columns: Mapping[str, tuple[str, Any]], ax: Axes
) -> None:
    """Draw errors along an axis, on the scale that all four axes have."""
    name, unit, scale, base = AXES[axis]
    for column, (label, ink) in columns.items():
        found = [row for row in rows[axis] if row.get(column) is not None]
        ax.plot([scale * r["value"] for r in found], [1e3 * r[column] for r in found], "o-", color=ink, ms=4.0, label=label,
                gid=label)  # fmt: skip
        lost = [row for row in found if row.get(column.replace("_tracks_m", "_lost"), 0) > 0 and "_tracks" in column]
        ax.plot([scale * row["value"] for row in lost], [1e3 * row[column] for row in lost], "kx", ms=8.0)
    every = [1e3 * row[c] for some in rows.values() for row in some for c in columns if row.get(c)]
    ax.set(yscale="log", xlabel=f"{name} [{unit}]", ylim=(0.8 * min(every), 1.25 * max(every)) if every else (1.0, 10.0))
    drawing.plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))
    ax.axvline(scale * base, color=drawing.QUIET, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1.5)
    if axis == "speed" and columns:
        ax.legend(fontsize=8.0)
