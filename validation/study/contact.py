"""Contact study: what physics settings and engines do to the simulated robot (docs/why_drift.md).

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
from typing import Annotated, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.metrics.declared import compare_paths
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation import cli
from validation.bench.sources import Piece, drive, open_source
from validation.engines.drake import DrakeBody
from validation.engines.ode import GAZEBO, HUSKY, MAKERS_HUSKY, OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.plants.table import SECOND_OPINIONS
from validation.report import drawing
from validation.report.columns import MILLIMETRES, Unit, heading_of
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.simulator.calibration import Calibration
from validation.simulator.description import Robot, load_robot, with_robot
from validation.simulator.physics import MUJOCO_IMPEDANCE, SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.turning import (
    SAMPLE,
    TURNED,
    creep,
    measure_spin,
    rolling_radius,
    spin,
    surge,
)
from validation.study.sweep import StudyOptions, picture, sweep

BASELINE = "as shipped"
"""Setting that all others are compared with."""
MODELS = ("improved", "coulomb", "linear")
"""Published models of the lab's robot, which the robot is compared with on trajectories 1-4."""
_RAMP = Terrain(math.radians(8.0))  # on which other engines stand; MuJoCo's gravity is tilted
CONTACT_MEASURES: Mapping[str, Mapping[str, str]] = {
    "Turning on the spot": {
        "multiplier": "yaw rate that the wheels ask for over that of the body, turning on the spot",
        "off_closed_form_share": "deviation of the multiplier from its closed form",
        "ripple_share": "range of the yaw rate on the spot over its mean",
        "lifted_share": "share of the time on the spot in which a wheel is off the ground; if any, trust two digits",
        "glide_share": "greatest speed of the robot's middle on the spot over that of the wheels' rims",
        "wander_m": "greatest distance of the robot's middle from its first place in 36 s on the spot",
        "drift_m": "distance of the robot's middle from its place after a whole turn, mean",
    },
    "Straight ahead, at rest, and on trajectories": {
        "veer_share": "deviation to the left of a straight drive, over its length",
        "creep_m_s": "sideways speed at rest on a slope of 8°",
        "surge_share": "greatest speed on trajectory 3 above the speed that the wheels ask for",
        "ground_turned_m": "distance that the end of trajectory 3 moves if the ground is turned by 45°",
        "step_halved_m": "distance that the end of trajectory 4 moves if the physics step is halved",
        "to_improved_m": "d_rms from the improved model, mean over trajectories 1–4",
        "to_coulomb_m": "d_rms from the Coulomb model, mean over trajectories 1–4",
        "to_linear_m": "d_rms from the linear model, mean over trajectories 1–4",
    },
}
"""Measures by table, and their meaning."""


class Setting(NamedTuple):
    """A setting to be tried."""

    # settings of MuJoCo or ODE; None for Drake, which has none
    physics: PhysicsSettings | OdeSettings | None
    robot: Mapping[str, Any]  # fields of `Calibration` that change too

    def plant(
        self,
        section: PlantProfile,
        wheels: float = 0.0,
        steps: float = 1.0,
        terrain: Terrain = FLAT,
    ) -> MujocoPlant | EnginePlant:
        """Return a profile's robot with wheels larger by `wheels` [m] and `steps` times as many steps.

        Raises:
            ValueError: the parameters do not fit together, or the engine is not installed.
        """
        c = replace(section.parameters, **self.robot)
        s = self.physics
        c = replace(c, wheel_radius=c.wheel_radius + wheels, timestep=c.timestep / steps)
        if isinstance(s, OdeSettings):
            return EnginePlant(
                "ode", lambda numbers: OdeBody(numbers, s), c, section.drive, terrain
            )
        if s is None:
            return EnginePlant("drake", DrakeBody, c, section.drive, terrain)
        return MujocoPlant(c, section.drive, terrain=terrain, settings=s)


def all_settings(robot: Robot | None = None) -> dict[str, Setting]:
    """Return what is tried, by name, of which the words before a colon are the group.

    The maker's centre of mass is that of a Husky's description, at the same place between the
    wheels of any robot. Near ODE, the contact is as hard as a step of 1 ms lets it be.
    """
    own = (robot or load_robot()).geometry
    usual = load_robot().geometry
    s = PhysicsSettings
    makers = {
        "com_x": -0.00065 * own.wheelbase / usual.wheelbase,
        "com_y": -0.085 * own.track / usual.track,
    }
    plain = s("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")
    ode = s(
        "pyramidal", 1.0, solimp=(0.99, 0.999, 0.001, 0.5, 2.0), solref=(0.004, 1.0), solver="PGS", iterations=50,
        integrator="Euler",
    )  # fmt: skip
    soft = replace(ode, cone="elliptic", solimp=None, solref=None)
    cylinders = {"wheel_shape": "cylinder"}
    fine = {**cylinders, "timestep": 0.001}
    return {
        BASELINE: Setting(SHIPPED, {}),
        "cone: pyramidal": Setting(s(cone="pyramidal"), {}),
        "cone: pyramidal, impratio 1": Setting(s(cone="pyramidal", impratio=1.0), {}),
        "impedance: impratio 1": Setting(s(impratio=1.0), {}),
        "impedance: MuJoCo's default": Setting(s(solimp=MUJOCO_IMPEDANCE), {}),
        "solver: PGS, 1 sweep": Setting(s(solver="PGS", iterations=1), {}),
        "solver: PGS, 50 sweeps": Setting(s(solver="PGS", iterations=50), {}),
        "time step: 5 ms": Setting(SHIPPED, {"timestep": 0.005}),
        "centre of mass: maker's": Setting(SHIPPED, makers),
        "centre of mass: maker's, pyramidal": Setting(s(cone="pyramidal"), makers),
        "defaults: MuJoCo's": Setting(plain, cylinders),
        "near ODE: maker's centre": Setting(ode, {**fine, **makers}),
        "near ODE: also elliptic cone": Setting(replace(ode, cone="elliptic"), {**fine, **makers}),
        "near ODE: also soft contact": Setting(soft, {**fine, **makers}),
        "near ODE: also centre in the middle": Setting(soft, fine),
        "ode: its own defaults": Setting(
            OdeSettings("pyramid", "world", "quick", 20, soft=False, cfm=1e-10), {}
        ),
        "ode: Gazebo's Husky": Setting(GAZEBO, MAKERS_HUSKY),
        "ode: Gazebo's Husky, centre in the middle": Setting(GAZEBO, HUSKY),
        "ode: Gazebo's Husky, emulated cone": Setting(
            replace(GAZEBO, friction_law="cone"), MAKERS_HUSKY
        ),
        "ode: Gazebo's Husky, emulated cone, centred": Setting(
            replace(GAZEBO, friction_law="cone"), HUSKY
        ),
        "ode: best, emulated cone, exact solver": Setting(OdeSettings(), {}),
        "drake: best, stiction 0.1 mm/s": Setting(None, {}),
    }


def chosen_settings(only: Sequence[str], robot: Robot | None = None) -> dict[str, Setting]:
    """Return the baseline and the settings of some groups, all of MuJoCo if none is named; a ValueError lists the groups."""
    every = all_settings(robot)
    groups = dict.fromkeys(name.partition(":")[0] for name in every if name != BASELINE)
    if unknown := [name for name in only if name not in groups]:
        raise ValueError(
            f"unknown group '{', '.join(unknown)}' in only; there are: {', '.join(groups)}"
        )
    wanted = only or [group for group in groups if group not in SECOND_OPINIONS]
    return {n: s for n, s in every.items() if n == BASELINE or n.partition(":")[0] in wanted}


@dataclass(frozen=True, kw_only=True)
class ContactStudy(StudyOptions):
    """Options of the study of physics settings."""

    only: Annotated[cli.Names, cli.option(default="all groups of MuJoCo")] = ()
    """Groups to try besides what is shipped: cone, impedance, solver, time step, centre of mass,
    defaults, near ODE, and the other engines, ode and drake."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown group."""
        super().__post_init__()
        chosen_settings(self.only)


class Bench(NamedTuple):
    """Inputs that all settings have in common."""

    lab: PlantProfile  # muJoCo robot that stands for the lab's robot
    pieces: Mapping[str, Piece]  # trajectories 1-4
    # motions of the published models, by model and trajectory
    models: Mapping[str, Mapping[str, Trajectory]]


def make_bench(lab: Profile) -> Bench:
    """Drive the published models, and return the bench."""
    pieces = {name: open_source(name).pieces[0] for name in TRAJECTORIES}
    models = {
        m: {
            name: drive(make_plant(lab, m), piece, lab.plants[m].localiser, SAMPLE)
            for name, piece in pieces.items()
        }
        for m in MODELS
    }
    return Bench(lab.section("mujoco"), pieces, models)


@dataclass(frozen=True, eq=False)
class Trial:
    """A setting on the bench, with tyres that roll with the profile's radius."""

    bench: Bench
    setting: Setting

    @cached_property
    def uncorrected(self) -> tuple[Calibration, float]:
        """The robot's numbers, with the radius that the corrected robot rolls with, and what its tyres roll too far [m]."""
        plant = self.setting.plant(self.bench.lab)
        return plant.calibration, rolling_radius(plant)[0] - plant.calibration.wheel_radius

    def plant(self, steps: float = 1.0, terrain: Terrain = FLAT) -> MujocoPlant | EnginePlant:
        """Return the corrected robot."""
        return self.setting.plant(self.bench.lab, -self.uncorrected[1], steps, terrain)

    def straight(self) -> Row:
        """Return what a straight drive shows."""
        return {"veer_share": rolling_radius(self.plant())[1]}

    def spot(self) -> Row:
        """Return what whole turns on the spot show."""
        measured = measure_spin(spin(self.plant()), self.uncorrected[0])
        known = {"ripple_share": measured.get("ripple"), "glide_share": measured["glide"]}
        if "multiplier" in measured:
            known["off_closed_form_share"] = (
                measured["multiplier"] / measured["multiplier_expected"] - 1.0
            )
        return {
            **known,
            **{k: measured.get(k) for k in ("multiplier", "lifted_share", "wander_m", "drift_m")},
        }

    def slope(self) -> Row:
        """Return what standing on a slope shows."""
        plant = self.plant()
        if isinstance(plant, MujocoPlant):
            return {"creep_m_s": creep(plant)}
        still = Commands(0.05, np.zeros((80, 2)), "wheels")
        xy = self.plant(terrain=_RAMP).run(still, State(yaw=0.5 * math.pi), SAMPLE).xy
        return {"creep_m_s": _apart(xy, xy[: len(xy) // 2 + 1]) / (0.5 * still.duration)}

    def trajectories(self) -> Row:
        """Return the distances from the published models, and what trajectories 3 and 4 show."""
        pieces = self.bench.pieces
        localiser = self.bench.lab.localiser
        numbers = self.uncorrected[0]
        plant = self.plant()
        motions = {name: drive(plant, piece, localiser, SAMPLE) for name, piece in pieces.items()}
        turned = drive(plant, replace(pieces["traj3"], start=State(yaw=TURNED)), localiser, SAMPLE)
        fine = drive(self.plant(steps=2.0), pieces["traj4"], localiser, SAMPLE)
        c = math.cos(TURNED)
        s = math.sin(TURNED)
        apart = {
            f"to_{model}_m": float(
                np.mean(
                    [compare_paths(motions[name], path)["d_rms_m"] for name, path in paths.items()]
                )
            )
            for model, paths in self.bench.models.items()
        }
        return {
            "surge_share": max(
                surge(m, numbers.wheel_radius, self.bench.lab.drive)
                for m in (motions["traj3"], turned)
            ),
            # in the ground's frame
            "ground_turned_m": _apart(turned.xy @ np.array([[c, -s], [s, c]]), motions["traj3"].xy),
            "step_halved_m": _apart(fine.xy, motions["traj4"].xy),
            **apart,
        }


def _apart(one: FloatArray, other: FloatArray) -> float:
    """Return the distance of the ends of two (M, 2) paths [m]."""
    return float(np.hypot(*(one[-1] - other[-1])))


CONTACT_DRIVES = {
    "straight drive": Trial.straight,
    "turn on the spot": Trial.spot,
    "slope": Trial.slope,
    "trajectories": Trial.trajectories,
}
"""Measures that every setting goes through."""
_UNITS = {
    "creep_m_s": Unit("mm/s", 1e3, 2),
    **{c: MILLIMETRES for some in CONTACT_MEASURES.values() for c in some if c.endswith("_m")},
}


@cli.program(ContactStudy)
def study_contact(o: ContactStudy) -> Report:
    """Measure what physics settings of MuJoCo, and other engines, do to the simulated robot.

    Raises:
        ValueError: the profile does not exist, or does not fit the settings.
        SsmrError: a published model diverged.
    """
    lab = o.robot_profile()
    bench = make_bench(lab)
    chosen = chosen_settings(o.only, lab.robot)
    trials = {name: Trial(bench, setting) for name, setting in chosen.items()}
    swept = sweep(trials, CONTACT_DRIVES, workers=o.workers, progress=o.progress)
    numbers = {name: asdict(s.physics) if s.physics else {} for name, s in chosen.items()}
    changed = {
        name: {k: v for k, v in given.items() if v is not None} for name, given in numbers.items()
    }
    tables = []
    for title, columns in CONTACT_MEASURES.items():
        rows = [
            {key: row[key] for key in ("variant", *columns) if key in row} for row in swept.rows
        ]
        caption = "\n".join(f"{heading_of(key)}: {meaning}" for key, meaning in columns.items())
        tables.append(Table(title, rows, caption, units=_UNITS))
    return Report(
        program="study", title=f"Physics settings, profile {with_robot(lab.name, lab.robot.name)}", draw=_draw,
        tables=tables, sentences=swept.notes, status=swept.status,
        document={
            "schema": "ssmr.study.contact/2", "study": "contact", "robot": lab.robot.name, "profile": lab.name,
            "changes": {name: {**changed[name], **setting.robot} for name, setting in chosen.items()},
        },
        has_text=True,
    )  # fmt: skip


def _draw(study: Report) -> Figure:
    """Return the picture: what tells settings apart, a bar for each."""
    rows = {
        row["variant"]: {**row, **more}
        for row, more in zip(*(table.rows for table in study.tables), strict=True)
    }

    def draw(column: str, title: str, first: bool, ax: Axes) -> None:
        values = [row.get(column) or 0.0 for row in rows.values()]
        ax.barh(range(len(rows)), [max(abs(value), 1e-4) for value in values], gid=column)
        ax.set(xscale="log", title=title, ylim=(len(rows) - 0.4, -0.6))
        drawing.plain_ticks(ax.xaxis)
        ax.set_yticks(range(len(rows)), list(rows) if first else [""] * len(rows), fontsize=8.0)
        if first:
            drawing.inset(ax, left=1.6)

    panels = (
        (0.4, "ripple_share", "ripple of the yaw rate [1]"),
        (0.2, "wander_m", "wander [m]"),
        (0.2, "ground_turned_m", "ground turned [m]"),
        (0.2, "to_improved_m", "to improved [m]"),
    )
    bars = tuple(
        (share, partial(draw, column, title, k == 0))
        for k, (share, column, title) in enumerate(panels)
    )
    return picture(study, [drawing.PanelRow(1.2 + 0.22 * len(rows), bars)])
