"""Contact study: effects of physics settings and engines on the simulated robot.

See docs/why_drift.md.
The thesis tried friction models, iterations, steps and contact layers of ODE in Gazebo (Sec. 3.7)
without success. These are the settings of MuJoCo that correspond to them, and ODE and Drake
themselves. How deep tyres are pressed into the ground depends on the contact; so does the radius
that they roll with. Hence every measure is taken with tyres whose size is corrected to the
profile's radius.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ssmr.errors import DivergedError
from ssmr.metrics.declared import compare_paths
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from validation import cli
from validation.descriptions.loading import load_robot
from validation.engines.drake import DrakeBody
from validation.engines.ode import GAZEBO, HUSKY, MAKERS_HUSKY, OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Piece, open_source
from validation.output import Document
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.plants.table import SECOND_OPINIONS
from validation.report import drawing
from validation.report.columns import MILLIMETRES, Unit, heading_of
from validation.report.table import Row, Table
from validation.simulator.description import GRAVITY, Robot, with_robot
from validation.simulator.physics import MUJOCO_IMPEDANCE, SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.turning import (
    SAMPLE,
    STRAIGHT_SPEED,
    held_twist,
    measure_spin,
    spin_on_spot,
)
from validation.study.common import Study, StudyOptions
from validation.sweep import sweep

BASELINE = "as shipped"
"""Setting that all others are compared with."""
MODELS = ("improved", "coulomb", "linear")
"""Published models of the lab's robot, which the robot is compared with on trajectories 1-4."""
_RAMP = Terrain(math.radians(8.0))
"""Slope on which other engines stand; for MuJoCo the gravity is tilted instead."""
_STRAIGHT_TIME = 8.0
"""Duration of the straight drive [s]."""
_STRAIGHT_LEAD = 3.0
"""Time in the straight drive at which the measurement starts [s]."""
_STRAIGHT_YAW = 0.4
"""Heading of the straight drive, which is none of the ground's axes [rad]."""
TURNED = 0.25 * math.pi
"""Angle by which the ground is turned under trajectory 3, which should change nothing [rad]."""
_SURGE_LEAD = 3.0
"""Time in trajectory 3 from which on its speed is measured [s]."""
_SLOPE = math.radians(8.0)
"""Side slope on which the robot stands [rad]."""
_SLOPE_TIME = 6.0
"""Duration of standing on the slope [s]."""
_SLOPE_LEAD = 2.0
"""Time on the slope at which the measurement starts [s]."""
CONTACT_MEASURES: Mapping[str, Mapping[str, str]] = {
    "Turning on the spot": {
        "multiplier": "yaw rate that the wheels ask for over that of the body, turning on the spot",
        "off_closed_form_share": "deviation of the multiplier from its closed form",
        "ripple_share": "range of the yaw rate on the spot over its mean",
        "lifted_share": "share of the time on the spot in which a wheel is off the ground; "
        "if any, trust two digits",
        "glide_share": "greatest speed of the robot's middle on the spot "
        "over that of the wheels' rims",
        "wander_m": "greatest distance of the robot's middle from its first place "
        "in 36 s on the spot",
        "drift_m": "distance of the robot's middle from its place after a whole turn, mean",
    },
    "Straight ahead, at rest, and on trajectories": {
        "veer_share": "deviation to the left of a straight drive, over its length",
        "creep_m_s": "sideways speed at rest on a slope of 8°",
        "surge_share": "greatest speed on trajectory 3 above the speed that the wheels ask for",
        "ground_turned_m": "distance that the end of trajectory 3 moves "
        "if the ground is turned by 45°",
        "step_halved_m": "distance that the end of trajectory 4 moves "
        "if the physics step is halved",
        "to_improved_m": "d_rms from the improved model, mean over trajectories 1–4",
        "to_coulomb_m": "d_rms from the Coulomb model, mean over trajectories 1–4",
        "to_linear_m": "d_rms from the linear model, mean over trajectories 1–4",
    },
}
"""Measures by table, and their meaning."""


class Setting(NamedTuple):
    """A setting to be tried."""

    physics: PhysicsSettings | OdeSettings | None
    """Settings of MuJoCo or ODE; None for Drake, which has none."""
    robot: Mapping[str, Any] = MappingProxyType({})
    """Fields of `Calibration` that change too."""

    def plant(
        self,
        section: PlantProfile,
        wheels: float = 0.0,
        steps: float = 1.0,
        terrain: Terrain = FLAT,
    ) -> MujocoPlant | EnginePlant:
        """A profile's robot with wheels larger by `wheels` [m] and `steps` times as many steps.

        Raises:
            ValueError: the parameters do not fit together, or the engine is not installed.
        """
        numbers = replace(section.parameters, **self.robot)
        numbers = replace(
            numbers,
            wheel_radius=numbers.wheel_radius + wheels,
            timestep=numbers.timestep / steps,
        )
        physics = self.physics
        if isinstance(physics, PhysicsSettings):
            return MujocoPlant(numbers, section.drive, terrain=terrain, settings=physics)
        if physics is None:
            return EnginePlant("drake", DrakeBody, numbers, section.drive, terrain)
        body = partial(OdeBody, settings=physics)
        return EnginePlant("ode", body, numbers, section.drive, terrain)


def all_settings(robot: Robot | None = None) -> dict[str, Setting]:
    """Settings to try, by name; the words before a colon are the group.

    The maker's centre of mass is that of a Husky's description, at the same place between the
    wheels of any robot. Near ODE, the contact is as hard as a step of 1 ms lets it be.
    """
    husky = load_robot()
    robot = robot or husky
    makers = {
        "com_x": -0.00065 * robot.wheelbase / husky.wheelbase,
        "com_y": -0.085 * robot.track / husky.track,
    }
    cylinders = {"wheel_shape": "cylinder"}
    fine = {**cylinders, "timestep": 0.001}
    fine_makers = {**fine, **makers}
    s = PhysicsSettings
    pyramidal = s(cone="pyramidal")
    plain = s("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")
    # contacts as hard as in ODE, as far as the time step of 1 ms allows
    near_ode = s(
        "pyramidal",
        1.0,
        solimp=(0.99, 0.999, 0.001, 0.5, 2.0),
        solref=(0.004, 1.0),
        solver="PGS",
        iterations=50,
        integrator="Euler",
    )
    elliptic = replace(near_ode, cone="elliptic")
    soft = replace(elliptic, solimp=None, solref=None)
    settings = {
        BASELINE: Setting(SHIPPED),
        "cone: pyramidal": Setting(pyramidal),
        "cone: pyramidal, impratio 1": Setting(s(cone="pyramidal", impratio=1.0)),
        "impedance: impratio 1": Setting(s(impratio=1.0)),
        "impedance: MuJoCo's default": Setting(s(solimp=MUJOCO_IMPEDANCE)),
        "solver: PGS, 1 sweep": Setting(s(solver="PGS", iterations=1)),
        "solver: PGS, 50 sweeps": Setting(s(solver="PGS", iterations=50)),
        "time step: 5 ms": Setting(SHIPPED, {"timestep": 0.005}),
        "centre of mass: maker's": Setting(SHIPPED, makers),
        "centre of mass: maker's, pyramidal": Setting(pyramidal, makers),
        "defaults: MuJoCo's": Setting(plain, cylinders),
        "near ODE: maker's centre": Setting(near_ode, fine_makers),
        "near ODE: also elliptic cone": Setting(elliptic, fine_makers),
        "near ODE: also soft contact": Setting(soft, fine_makers),
        "near ODE: also centre in the middle": Setting(soft, fine),
    }
    return settings | _engine_settings()


def _engine_settings() -> dict[str, Setting]:
    """Settings of the other engines, by name."""
    defaults = OdeSettings("pyramid", "world", "quick", 20, soft=False, cfm=1e-10)
    cone = replace(GAZEBO, friction_law="cone")
    return {
        "ode: its own defaults": Setting(defaults),
        "ode: Gazebo's Husky": Setting(GAZEBO, MAKERS_HUSKY),
        "ode: Gazebo's Husky, centre in the middle": Setting(GAZEBO, HUSKY),
        "ode: Gazebo's Husky, emulated cone": Setting(cone, MAKERS_HUSKY),
        "ode: Gazebo's Husky, emulated cone, centred": Setting(cone, HUSKY),
        "ode: best, emulated cone, exact solver": Setting(OdeSettings()),
        "drake: best, stiction 0.1 mm/s": Setting(None),
    }


def chosen_settings(only: Sequence[str], robot: Robot | None = None) -> dict[str, Setting]:
    """The baseline and the settings of some groups, all of MuJoCo if none is named.

    Raises:
        ValueError: an unknown group; the message lists them.
    """
    settings = all_settings(robot)
    groups = dict.fromkeys(map(_group_of, settings))
    del groups[BASELINE]
    if unknown := ", ".join(name for name in only if name not in groups):
        raise ValueError(f"unknown group '{unknown}' in only; there are: {', '.join(groups)}")
    if not only:
        only = [group for group in groups if group not in SECOND_OPINIONS]
    kept = {BASELINE, *only}
    return {name: setting for name, setting in settings.items() if _group_of(name) in kept}


def _group_of(name: str) -> str:
    return name.partition(":")[0]


@dataclass(frozen=True, kw_only=True)
class ContactStudy(StudyOptions):
    """Options of the study of physics settings."""

    only: Sequence[str] = ()
    """Groups to try besides what is shipped: cone, impedance, solver, time step, centre of mass,
    defaults, near ODE, and the other engines, ode and drake."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown group."""
        super().__post_init__()
        chosen_settings(self.only)


def balanced_robot(section: PlantProfile) -> PlantProfile:
    """Return a robot with its weight in the middle, so that any drift is that of the physics."""
    return replace(section, parameters=replace(section.parameters, com_x=0.0, com_y=0.0))


def _drive_all(
    plant: Plant, pieces: Mapping[str, Piece], localiser: Localiser
) -> dict[str, Trajectory]:
    """Motions of a plant on all trajectories, by name."""
    return {name: drive_piece(plant, piece, localiser, SAMPLE) for name, piece in pieces.items()}


def rolling_radius(plant: Plant, speed: float = STRAIGHT_SPEED) -> tuple[float, float]:
    """Drive straight ahead at a commanded speed [m/s].

    Returns:
        Rolling radius of the tyres [m], and deviation to the left over the length [1].

    Raises:
        DivergedError: the simulator gave up.
    """
    motion = plant.run(held_twist(speed, 0.0, _STRAIGHT_TIME), State(yaw=_STRAIGHT_YAW), SAMPLE)
    tail = motion.t >= _STRAIGHT_LEAD
    along = np.array([math.cos(_STRAIGHT_YAW), math.sin(_STRAIGHT_YAW)])
    way = motion.xy[-1] - motion.xy[tail][0]
    seconds = motion.t[-1] - motion.t[tail][0]
    ahead = along @ way
    aside = along[0] * way[1] - along[1] * way[0]
    turned = motion.wheels[tail].mean() * seconds
    if not (ahead > 0.0 and turned > 0.0):
        raise DivergedError("a drive straight ahead went nowhere")
    return ahead / turned, aside / ahead


def creep_speed(plant: MujocoPlant) -> float:
    """Return the speed at which a robot at rest slides down a side slope [m/s].

    Raises:
        DivergedError: the simulator gave up.
    """
    gravity = plant.model.opt.gravity
    level = np.array(gravity)
    gravity[:] = 0.0, GRAVITY * math.sin(_SLOPE), -GRAVITY * math.cos(_SLOPE)
    try:
        motion = plant.run(held_twist(0.0, 0.0, _SLOPE_TIME), State(), SAMPLE)
    finally:
        gravity[:] = level
    tail = motion.t >= _SLOPE_LEAD
    way = motion.xy[-1] - motion.xy[tail][0]
    return np.hypot(*way) / (motion.t[-1] - motion.t[tail][0])


def surge_share(motion: Trajectory, wheel_radius: float, drive: Drive) -> float:
    """Return the greatest speed on trajectory 3, once under way, over that of the rims, less 1 [1].

    The rims' speed is that of a straight drive.
    """
    rim = STRAIGHT_SPEED * wheel_radius / drive.command_radius
    speeds = motion.twist[motion.t >= _SURGE_LEAD, 0]
    return speeds.max() / rim - 1.0


@dataclass(frozen=True, eq=False)
class Trial:
    """A setting on the bench, with tyres that roll with the profile's radius."""

    lab: PlantProfile
    """MuJoCo's robot that stands for the lab's robot."""
    pieces: Mapping[str, Piece]
    """Trajectories 1-4."""
    models: Mapping[str, Mapping[str, Trajectory]]
    """Motions of the published models, by model and trajectory."""
    setting: Setting
    """The setting that is tried."""

    @cached_property
    def uncorrected(self) -> MujocoPlant | EnginePlant:
        """The robot with tyres of the profile's size, which roll with another radius.

        Its numbers have the radius that the corrected robot rolls with.
        """
        return self.setting.plant(self.lab)

    @cached_property
    def excess(self) -> float:
        """Rolling radius of the uncorrected tyres less the profile's [m]."""
        plant = self.uncorrected
        return rolling_radius(plant)[0] - plant.calibration.wheel_radius

    def plant(self, steps: float = 1.0, terrain: Terrain = FLAT) -> MujocoPlant | EnginePlant:
        """The corrected robot."""
        return self.setting.plant(self.lab, -self.excess, steps, terrain)

    def straight(self) -> Row:
        """Deviation of a straight drive."""
        return {"veer_share": rolling_radius(self.plant())[1]}

    def spot(self) -> Row:
        """Measures of whole turns on the spot."""
        measured = measure_spin(spin_on_spot(self.plant()), self.uncorrected.calibration)
        row = {
            "ripple_share": measured.get("ripple"),
            "glide_share": measured["glide"],
        }
        for key in ("multiplier", "lifted_share", "wander_m", "drift_m"):
            row[key] = measured.get(key)
        if "multiplier" in measured:
            ratio = measured["multiplier"] / measured["multiplier_expected"]
            row["off_closed_form_share"] = ratio - 1.0
        return row

    def slope(self) -> Row:
        """Sideways speed while the robot stands across a slope."""
        plant = self.plant()
        if isinstance(plant, MujocoPlant):
            return {"creep_m_s": creep_speed(plant)}
        still = Commands(0.05, np.zeros((80, 2)), "wheels")
        xy = self.plant(terrain=_RAMP).run(still, State(yaw=0.5 * math.pi), SAMPLE).xy
        # the first half lets the robot settle
        first_half = xy[: len(xy) // 2 + 1]
        return {"creep_m_s": _end_distance(xy, first_half) / (0.5 * still.duration)}

    def trajectories(self) -> Row:
        """Distances from the published models, and measures of trajectories 3 and 4."""
        pieces = self.pieces
        lab = self.lab
        plant = self.plant()
        motions = _drive_all(plant, pieces, lab.localiser)
        third = motions["traj3"]
        # the same motion in turned axes: any difference comes from the contact model
        from_turned = replace(pieces["traj3"], start=State(yaw=TURNED))
        turned = drive_piece(plant, from_turned, lab.localiser, SAMPLE)
        fine = drive_piece(self.plant(steps=2.0), pieces["traj4"], lab.localiser, SAMPLE)
        radius = self.uncorrected.calibration.wheel_radius
        row = {"surge_share": max(surge_share(m, radius, lab.drive) for m in (third, turned))}
        c = math.cos(TURNED)
        s = math.sin(TURNED)
        in_ground_frame = turned.xy @ np.array([[c, -s], [s, c]])
        row["ground_turned_m"] = _end_distance(in_ground_frame, third.xy)
        row["step_halved_m"] = _end_distance(fine.xy, motions["traj4"].xy)
        for model, paths in self.models.items():
            scores = [compare_paths(motions[name], path) for name, path in paths.items()]
            row[f"to_{model}_m"] = float(np.mean([score["d_rms_m"] for score in scores]))
        return row


def make_trials(lab: Profile, settings: Mapping[str, Setting]) -> dict[str, Trial]:
    """Drive the published models, and return the trial of each setting."""
    pieces = {name: open_source(name).pieces[0] for name in TRAJECTORIES}
    models = {}
    for model in MODELS:
        models[model] = _drive_all(make_plant(lab, model), pieces, lab.plants[model].localiser)
    robot = balanced_robot(lab.section("mujoco"))
    return {name: Trial(robot, pieces, models, setting) for name, setting in settings.items()}


def _end_distance(one: FloatArray, other: FloatArray) -> float:
    """Return the distance of the ends of two (M, 2) paths [m]."""
    return np.hypot(*(one[-1] - other[-1]))


CONTACT_DRIVES = {
    "straight drive": Trial.straight,
    "turn on the spot": Trial.spot,
    "slope": Trial.slope,
    "trajectories": Trial.trajectories,
}
"""Measures that every setting goes through."""
_UNITS = {"creep_m_s": Unit("mm/s", 1e3, 2)}
for _measures in CONTACT_MEASURES.values():
    _UNITS |= {key: MILLIMETRES for key in _measures if key.endswith("_m")}


@cli.make_program(ContactStudy)
def study_contact(o: ContactStudy) -> Study:
    """Measure what physics settings of MuJoCo, and other engines, do to the simulated robot.

    Raises:
        ValueError: the profile does not exist, or does not fit the settings.
        SsmrError: a published model diverged.
    """
    lab = o.robot_profile()
    chosen = chosen_settings(o.only, lab.robot)
    swept = sweep(make_trials(lab, chosen), CONTACT_DRIVES, workers=o.workers, progress=o.progress)
    tables = []
    for title, columns in CONTACT_MEASURES.items():
        keys = ("variant", *columns)
        rows = [{key: row[key] for key in keys if key in row} for row in swept.rows]
        caption = "\n".join(f"{heading_of(key)}: {meaning}" for key, meaning in columns.items())
        tables.append(Table(title, rows, caption, units=_UNITS))
    return Study(
        title=f"Physics settings, profile {with_robot(lab.name, lab.robot.name)}",
        panels=_draw_panels(tables),
        shown=tables,
        remarks=swept.notes,
        status=swept.status,
        about={
            "schema": "ssmr.study.contact/2",
            "study": "contact",
            "robot": lab.robot.name,
            "profile": lab.name,
            "changes": {name: _changes_of(setting) for name, setting in chosen.items()},
        },
    )


def _changes_of(setting: Setting) -> Document:
    """Physics settings that are given, and the numbers of the robot that change."""
    physics = {} if setting.physics is None else asdict(setting.physics)
    return {k: v for k, v in physics.items() if v is not None} | dict(setting.robot)


def _draw_panels(tables: Sequence[Table]) -> list[drawing.PanelRow]:
    """Return panels of the measures that tell settings apart, a bar for each setting."""
    rows = {}
    for row, more in zip(*(table.rows for table in tables), strict=True):
        rows[row["variant"]] = {**row, **more}

    def draw(column: str, title: str, ax: Axes) -> None:
        values = [row.get(column) or 0.0 for row in rows.values()]
        # zero has no place on a logarithmic axis
        lengths = [max(abs(value), 1e-4) for value in values]
        ax.barh(range(len(rows)), lengths, gid=column)
        ax.set(xscale="log", title=title, ylim=(len(rows) - 0.4, -0.6))
        drawing.plain_ticks(ax.xaxis)
        # the first panel has the names
        names = list(rows) if column == "ripple_share" else [""] * len(rows)
        ax.set_yticks(range(len(rows)), names, fontsize=8.0)

    titles = {
        "ripple_share": "ripple of the yaw rate [1]",
        "wander_m": "wander [m]",
        "ground_turned_m": "ground turned [m]",
        "to_improved_m": "to improved [m]",
    }
    panels = [partial(draw, column, title) for column, title in titles.items()]
    return [drawing.PanelRow(1.2 + 0.22 * len(rows), panels)]
