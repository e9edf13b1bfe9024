"""How far planar models hold: their errors against the MuJoCo Husky as speed, slope, roughness and loss of friction grow.

Open loop, trajectories 1-4 with the same commands for everybody; closed loop, trackers that know nothing of the ground. And
the loads of the four wheels through one manoeuvre, beside what formulas say.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ssmr.control.loop import LoopSettings
from ssmr.errors import SsmrError
from ssmr.metrics.paths import compare_paths, horizon_windows, relative_pose_error
from ssmr.robot.loads import static_loads
from ssmr.robot.vehicle import Vehicle
from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulate import SAMPLE_DT
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation import store
from validation.plants.profile import PLANTS, Profile, make_plant
from validation.robots.plant import MujocoPlant
from validation.robots.terrain import FLAT, Terrain
from validation.robots.wheel_loads import MEASURED, QUASI_STATIC, with_quasi_static
from validation.show.tables import NOTHING, Cell, Grid, markdown_table
from validation.track.gains import load_gains
from validation.track.tracking import make_controller, make_robot, odometry_of, rate, run_robots
from validation.track.waypoint_files import open_reference

SCHEMA = "ssmr.study/1"
PLANAR = tuple(name for name in PLANTS if name != "mujoco")
Axis = Literal["speed", "slope", "roughness", "friction"]

AXES: Mapping[Axis, tuple[str, str, float]] = {
    "speed": ("speed on level ground", "m/s", 1.0),
    "slope": ("slope", "deg", 180.0 / math.pi),
    "roughness": ("rms height of rough ground", "mm", 1e3),
    "friction": ("friction lost right of an edge", "%", 100.0),
}
"""What grows: its name, its unit where people read it, and how many of those make one SI unit."""
BASE: Mapping[Axis, float] = {"speed": 0.5, "slope": 0.0, "roughness": 0.0, "friction": 0.0}
"""Where each axis has the thesis' own conditions."""
TRACKED = "generic"
"""The reference of the closed loops."""


@dataclass(frozen=True)
class TerrainSettings:
    """How the study is run."""

    speeds: tuple[float, ...] = (0.2, 0.35, 0.5, 0.7, 0.85, 1.0)
    """[m/s]."""
    slopes: tuple[float, ...] = tuple(map(math.radians, (0.0, 1.0, 2.0, 4.0, 7.0, 10.0)))
    """[rad]."""
    heights: tuple[float, ...] = (0.0, 0.0005, 0.001, 0.002, 0.004, 0.008)
    """Root mean square [m]."""
    lost: tuple[float, ...] = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8)
    """Share of the friction that one side has lost [1]."""
    directions: tuple[float, ...] = tuple(map(math.radians, (0.0, 90.0, 180.0, 270.0)))
    """In which ramps rise [rad]."""
    seeds: int = 3
    """How many rough grounds."""
    seed: int = 0
    """Of the first of them, and of noise."""
    horizon: float = 6.0
    """After which relative poses are compared [s]."""
    controllers: tuple[str, ...] = ("pid", "lqr")
    """With tuned gains."""

    def __post_init__(self) -> None:
        """Check.

        Raises:
            ValueError: no values on an axis, no seeds, or a horizon that no trajectory has.
        """
        if self.seeds < 1 or self.seed < 0:
            raise ValueError(f"seeds {self.seeds} must be positive and seed {self.seed} must not be negative")
        if not 0.0 < self.horizon <= 20.0:
            raise ValueError(f"the horizon must lie within the trajectories' 20 s, got {self.horizon} s")
        for axis in AXES:
            if not self.values(axis):
                raise ValueError(f"there are no values of {axis}")

    def values(self, axis: Axis) -> tuple[float, ...]:
        """All on an axis."""
        by_axis = {"speed": self.speeds, "slope": self.slopes, "roughness": self.heights, "friction": self.lost}
        return by_axis[axis]

    def grounds(self, axis: Axis, value: float) -> list[Terrain]:
        """What the robot is driven on at one value: every direction, or several grounds of the same statistics."""
        if axis == "slope" and value > 0.0:
            return [Terrain("ramp", slope=value, toward=d) for d in self.directions]
        if axis == "roughness" and value > 0.0:
            return [Terrain("rough", height=value, seed=self.seed + k) for k in range(self.seeds)]
        if axis == "friction" and value > 0.0:  # left and right change sides where the edge runs the other way
            return [Terrain("split", friction_ratio=1.0 - value, edge_heading=h) for h in (0.0, math.pi)]
        return [FLAT]


@dataclass(frozen=True)
class Point:
    """One plant at one value of one axis."""

    axis: Axis
    """What grew."""
    value: float
    """To what, in SI."""
    plant: str
    """Which planar model."""
    position_m: float | None
    """Median error of the position after the horizon [m]; None where no MuJoCo run came through."""
    yaw_rad: float | None
    """The same of the heading [rad]."""
    d_rms_m: float | None
    """Mean of the thesis' distance over whole runs [m]."""
    failed: int
    """Runs of the MuJoCo Husky that did not come through."""


@dataclass(frozen=True)
class Followed:
    """One tracker on the MuJoCo Husky at one value of one axis."""

    axis: Axis
    """What grew."""
    value: float
    """To what, in SI."""
    controller: str
    """Which law, with tuned gains."""
    d_rms_m: float | None
    """Mean over the grounds; None where all were lost."""
    lost: int
    """Grounds on which it lost the reference."""


@dataclass(frozen=True, eq=False)
class Ride:
    """The wheel loads of one manoeuvre."""

    terrain: Terrain
    """On what."""
    motion: Trajectory
    """Of the MuJoCo Husky, with simulated and quasi-static loads as channels."""


@dataclass(frozen=True, eq=False)
class TerrainStudy:
    """Everything that was found."""

    profile: str
    """Name of the profile."""
    settings: TerrainSettings
    """How it was run."""
    points: tuple[Point, ...]
    """By axis, value and plant."""
    followed: tuple[Followed, ...]
    """By axis, value and controller."""
    rides: tuple[Ride, ...]
    """Level, and on a ramp."""
    static: FloatArray
    """(4,) static shares (Eq. 2.17) [N]."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""

    def line(self, axis: Axis, plant: str) -> list[Point]:
        """A plant's points along an axis."""
        return [p for p in self.points if p.axis == axis and p.plant == plant]


def manoeuvre() -> Commands:
    """Speed up, turn left, drive straight, brake, turn on the spot: everything that moves load about, with no jolts."""
    corners = np.array([
        (0.0, 0.8, 0.0), (3.0, 0.8, 0.0), (4.0, 0.8, 0.6), (7.0, 0.8, 0.6), (8.0, 0.8, 0.0),
        (10.0, 0.8, 0.0), (10.05, 0.0, 0.0), (12.0, 0.0, 0.0), (13.0, 0.0, -0.6), (16.0, 0.0, -0.6),
    ])  # fmt: skip
    t = COMMAND_PERIOD * np.arange(round(corners[-1, 0] / COMMAND_PERIOD))
    return Commands(COMMAND_PERIOD, np.column_stack([np.interp(t, corners[:, 0], c) for c in corners.T[1:]]))


def commands_at(speed: float) -> list[Commands]:
    """Trajectories 1-4 at another speed."""
    return [replace(scenario, speed=speed).commands() for scenario in TRAJECTORIES.values()]


def study_terrain(
    profile: Profile,
    settings: TerrainSettings,
    workers: int | None = None,
    tell: Callable[[str], None] = lambda what: None,
) -> TerrainStudy:
    """Drive everybody on everything.

    Args:
        profile: whose robots.
        settings: what to vary.
        workers: threads; the result does not depend on it.
        tell: called with a word after each value of each axis, `steps` times.

    Raises:
        ValueError: numbers that do not go together.
    """
    points, followed = list[Point](), list[Followed]()
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        planar = {v: _planar(profile, v) for v in dict.fromkeys((BASE["speed"], *settings.speeds))}
        for axis in AXES:
            for value in settings.values(axis):
                speed = value if axis == "speed" else BASE["speed"]
                grounds = settings.grounds(axis, value)
                jobs = list(itertools.product(grounds, commands_at(speed)))
                truths = list(pool.map(lambda job: _husky(profile, *job), jobs))
                points += _points(axis, value, truths, planar[speed], settings)
                followed += _follow(profile, axis, value, grounds, settings, workers)
                tell(f"{axis} {AXES[axis][2] * value:g} {AXES[axis][1]}")
    rides = tuple(_ride(profile, terrain) for terrain in (FLAT, Terrain("ramp", slope=math.radians(10.0))))
    static = static_loads(Vehicle(mass=profile.plants["mujoco"].parameters.mass))
    return TerrainStudy(profile.name, settings, tuple(points), tuple(followed), rides, static, store.versions())


def steps(settings: TerrainSettings) -> int:
    """How often `study_terrain` tells."""
    return sum(len(settings.values(axis)) for axis in AXES)


def _planar(profile: Profile, speed: float) -> dict[str, list[Trajectory]]:
    """The planar models' motions on trajectories 1-4; no ground changes them."""
    made = {name: make_plant(profile, name) for name in PLANAR}
    return {name: [p.run(c, State(), SAMPLE_DT) for c in commands_at(speed)] for name, p in made.items()}


def _husky(profile: Profile, terrain: Terrain, commands: Commands) -> Trajectory | None:
    """The MuJoCo Husky's motion; None where it fell over or worse."""
    try:
        return make_plant(profile, "mujoco", terrain).run(commands, State(), SAMPLE_DT)
    except SsmrError:
        return None


def _points(
    axis: Axis,
    value: float,
    truths: Sequence[Trajectory | None],
    planar: Mapping[str, Sequence[Trajectory]],
    settings: TerrainSettings,
) -> Iterable[Point]:
    """Each plant against all runs of the MuJoCo Husky, which come ground by ground, trajectory by trajectory."""
    for plant, motions in planar.items():
        position, yaw, distances = list[FloatArray](), list[FloatArray](), list[float]()
        for truth, motion in zip(truths, itertools.cycle(motions), strict=False):
            if truth is not None:
                windows = horizon_windows(truth.t, settings.horizon)
                errors = relative_pose_error(motion.pose, truth.pose, *windows)
                position.append(errors[0])
                yaw.append(errors[1])
                distances.append(compare_paths(motion, truth).d_rms_m)
        failed = sum(truth is None for truth in truths)
        if distances:
            medians = float(np.median(np.concatenate(position))), float(np.median(np.concatenate(yaw)))
            yield Point(axis, value, plant, *medians, float(np.mean(distances)), failed)
        else:
            yield Point(axis, value, plant, None, None, None, failed)


def _follow(
    profile: Profile, axis: Axis, value: float, grounds: Sequence[Terrain], settings: TerrainSettings, workers: int | None
) -> Iterable[Followed]:
    """Tuned trackers on the generic reference, with the lab's noise; at 0.25 m/s unless speed is what grows."""
    if not settings.controllers:
        return
    _, waypoints = open_reference(TRACKED, value if axis == "speed" else 0.25)
    robots = [make_robot(profile, "mujoco", terrain) for terrain in grounds]
    loop = LoopSettings("noisy", filter=odometry_of(robots[0].drive))
    laws = [make_controller(profile, load_gains(name, "tuned")) for name in settings.controllers]
    n = len(laws)
    runs = [(r, run_robots([r] * n, laws, [loop] * n, waypoints, [settings.seed], workers)) for r in robots]
    for k, name in enumerate(settings.controllers):
        distances = [rate(each[k], waypoints, robot).path.d_rms_m for robot, each in runs if not each[k].lost]
        yield Followed(axis, value, name, float(np.mean(distances)) if distances else None, len(runs) - len(distances))


def _ride(profile: Profile, terrain: Terrain) -> Ride:
    plant = make_plant(profile, "mujoco", terrain)
    assert isinstance(plant, MujocoPlant)
    return Ride(terrain, with_quasi_static(plant.run(manoeuvre(), State(), SAMPLE_DT), plant, (0.0, 0.0)))


# --- what it says ---


def doubled_at(study: TerrainStudy, axis: Axis, plant: str) -> float | None:
    """Where a plant's median position error has grown to twice that under the thesis' conditions, linear between values.

    None where it never does within the axis.
    """
    line = [p for p in study.line(axis, plant) if p.position_m is not None and p.value >= BASE[axis]]
    for before, after in itertools.pairwise(line):
        assert before.position_m is not None
        assert after.position_m is not None
        limit = 2.0 * float(line[0].position_m or 0.0)
        if after.position_m > limit:
            share = (limit - before.position_m) / (after.position_m - before.position_m)
            return before.value + max(share, 0.0) * (after.value - before.value)
    return None


def grid(study: TerrainStudy, axis: Axis) -> Grid:
    """Errors along an axis: planar models after the horizon, and trackers."""
    _, unit, scale = AXES[axis]
    header = [(axis if axis != "friction" else "lost", unit), *((plant, "mm") for plant in PLANAR)]
    header += [*((f"{plant} yaw", "deg") for plant in PLANAR), *((f"{c} tracks", "mm") for c in study.settings.controllers)]
    rows = []
    for value in study.settings.values(axis):
        points = [p for plant in PLANAR for p in study.line(axis, plant) if p.value == value]
        cells = [Cell(f"{scale * value:g}"), *(Cell(_text(p.position_m, 1e3, 0)) for p in points)]
        cells += [Cell(_text(p.yaw_rad, 180.0 / math.pi, 1)) for p in points]
        for f in study.followed:
            if f.axis == axis and f.value == value:
                cells.append(Cell(_text(f.d_rms_m, 1e3, 0) + (f" ({f.lost} lost)" if f.lost else "")))
        rows.append(tuple(cells))
    return Grid(tuple(header), (tuple(rows),), left=1)


def _text(value: float | None, scale: float, digits: int) -> str:
    return NOTHING if value is None else f"{scale * value:.{digits}f}"


def heading(study: TerrainStudy) -> str:
    """What was driven, in one line."""
    s = study.settings
    return f"profile {study.profile}; trajectories 1-4 open loop, median over windows of {s.horizon:g} s; {TRACKED} tracked"


def holds(study: TerrainStudy) -> Grid:
    """Where each planar model's error has doubled."""
    header = [("error doubled at", ""), *((axis, unit) for axis, (_, unit, _) in AXES.items())]
    rows = []
    for plant in PLANAR:
        found = [(axis, doubled_at(study, axis, plant)) for axis in AXES]
        cells = [NOTHING if at is None else f"{AXES[axis][2] * at:.2g}" for axis, at in found]
        rows.append((Cell(plant), *map(Cell, cells)))
    return Grid(tuple(header), (tuple(rows),), left=1)


def load_errors(ride: Ride, static: FloatArray) -> tuple[float, float, float]:
    """Root mean squares [N] of simulated loads about their mean, less the static share, and less the quasi-static loads."""
    simulated = ride.motion.channels[MEASURED]
    rms = [float(np.sqrt(np.mean((simulated - other) ** 2))) for other in (static, ride.motion.channels[QUASI_STATIC])]
    return float(np.sqrt(np.mean((simulated - simulated.mean()) ** 2))), rms[0], rms[1]


def load_grid(study: TerrainStudy) -> Grid:
    """How much of the wheel loads each formula explains."""
    rows = []
    for ride in study.rides:
        spread, static, quasi = load_errors(ride, study.static)
        rows.append((Cell(ride.terrain.words), *(Cell(f"{n:.1f}") for n in (spread, static, quasi))))
    header = (("manoeuvre on", ""), ("spread of loads", "N"), ("less static share", "N"), ("less quasi-static", "N"))
    return Grid(header, (tuple(rows),), left=1)


def tables(study: TerrainStudy) -> list[tuple[Grid, str]]:
    """All tables with their titles."""
    each = [(grid(study, axis), f"As {AXES[axis][0]} grows") for axis in AXES]
    return [*each, (holds(study), "Where planar models stop to hold"), (load_grid(study), "Wheel loads, rms")]


def markdown(study: TerrainStudy) -> list[str]:
    """All tables, in markdown."""
    out = [f"{heading(study)}.", ""]
    for table, title in tables(study):
        out += [f"**{title}**", "", *markdown_table(table), ""]
    return out


def as_document(study: TerrainStudy) -> dict[str, Any]:
    """study.json."""
    plain = store.plain(
        {
            "schema": SCHEMA,
            "study": "terrain",
            "profile": study.profile,
            "settings": vars(study.settings),
            "versions": dict(study.versions),
            "open_loop": [vars(p) for p in study.points],
            "doubled_at": {axis: {plant: doubled_at(study, axis, plant) for plant in PLANAR} for axis in AXES},
            "closed_loop": [vars(f) for f in study.followed],
            "wheel_loads": {
                ride.terrain.spec: dict(
                    zip(("spread_N", "static_rms_N", "quasi_static_rms_N"), load_errors(ride, study.static), strict=True)
                )
                for ride in study.rides
            },
        }
    )
    assert isinstance(plain, dict)
    return plain
