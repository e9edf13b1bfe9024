"""What physics settings of MuJoCo do to the simulated robot, one at a time and together (docs/contact.md).

The thesis tried friction models, iterations, steps and contact layers of ODE in Gazebo (Sec. 3.7) without success. These are
the settings of MuJoCo that correspond to them. How deep tyres are pressed into the ground depends on the contact; so does
the radius that they roll with. Hence every measure is taken with tyres whose size is corrected to the profile's radius.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from ssmr.metrics.declared import compare_paths
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import FloatArray, State, Trajectory
from validation import cli
from validation.bench.sources import Piece, Source, drive, horizons_of, open_source
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.report import drawing
from validation.report.columns import MILLIMETRES, Unit, heading_of, unit_of
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.simulator.calibration import Calibration
from validation.simulator.description import Robot, load_robot, with_robot
from validation.simulator.physics import MUJOCO_IMPEDANCE, SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, TURNED, creep, measure_spin, rolling_radius, spin, surge
from validation.study.options import HORIZON, RecordedOptions
from validation.study.sweep import meaning_tables, sweep

BASELINE = "as shipped"
"""Setting that all others are compared with."""
MODELS = ("improved", "coulomb", "linear")
"""Published models of the lab's robot, which the robot is compared with on trajectories 1-4."""
CONTACT_MEASURES: Mapping[str, Mapping[str, tuple[str, tuple[float, float] | None]]] = {
    "Turning on the spot": {
        "multiplier": ("yaw rate that the wheels ask for over that of the body, turning on the spot", None),
        "off_closed_form_share": ("deviation of the multiplier from its closed form", (0.01, 0.4)),
        "ripple_share": ("range of the yaw rate on the spot over its mean", (0.01, 1.0)),
        "lifted_share": ("share of the time on the spot in which a wheel is off the ground", (0.005, 0.5)),
        "glide_share": ("greatest speed of the robot's middle on the spot over that of the wheels' rims", (0.02, 1.0)),
        "wander_m": ("greatest distance of the robot's middle from its first place in 36 s on the spot", (0.01, 0.6)),
        "drift_m": ("distance of the robot's middle from its place after a whole turn, mean", (0.001, 0.06)),
    },
    "Straight ahead, at rest, and on trajectories": {
        "veer_share": ("deviation to the left of a straight drive, over its length", (0.001, 0.03)),
        "creep_m_s": ("sideways speed at rest on a slope of 8°", (1e-4, 5e-3)),
        "surge_share": ("greatest speed on trajectory 3 above the speed that the wheels ask for", (0.02, 0.4)),
        "ground_turned_m": ("distance that the end of trajectory 3 moves if the ground is turned by 45°", (0.005, 1.0)),
        "step_halved_m": ("distance that the end of trajectory 4 moves if the physics step is halved", (0.01, 0.5)),
        "to_improved_m": ("d_rms from the improved model, mean over trajectories 1–4", (0.025, 0.5)),
        "to_coulomb_m": ("d_rms from the Coulomb model, mean over trajectories 1–4", (0.035, 0.5)),
        "to_linear_m": ("d_rms from the linear model, mean over trajectories 1–4", (0.025, 0.5)),
        "recording_m": ("median error of the relative position after 6 s against the recording", (0.045, 0.3)),
        "recording_yaw_rad": ("median error of the relative yaw after 6 s against the recording", (0.035, 0.3)),
    },
}
"""What is measured, by table: what it means, and the value up to which it is good and that from which on it is bad [SI]."""


class Setting(NamedTuple):
    """A setting to be tried."""

    physics: PhysicsSettings
    """Settings of the physics engine."""
    robot: Mapping[str, Any]
    """Fields of `Calibration` that change too."""

    def plant(self, section: PlantProfile, wheels: float = 0.0, steps: float = 1.0) -> MujocoPlant:
        """Return a profile's robot with wheels larger by `wheels` [m] and `steps` times as many steps.

        Raises:
            ValueError: the parameters do not fit together.
        """
        c = replace(section.parameters, **self.robot)
        c = replace(c, wheel_radius=c.wheel_radius + wheels, timestep=c.timestep / steps)
        return MujocoPlant(c, section.drive, settings=self.physics)


def tried_settings(robot: Robot | None = None) -> dict[str, Setting]:
    """Return what is tried, by name, of which the words before a colon are the group.

    The maker's centre of mass is that of a Husky's description, at the same place between the wheels of any robot. Near ODE,
    the contact is as hard as a step of 1 ms lets it be.
    """
    own, usual, s = (robot or load_robot()).geometry, load_robot().geometry, PhysicsSettings
    makers = {"com_x": -0.00065 * own.wheelbase / usual.wheelbase, "com_y": -0.085 * own.track / usual.track}
    plain = s("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")
    ode = s(
        "pyramidal", 1.0, solimp=(0.99, 0.999, 0.001, 0.5, 2.0), solref=(0.004, 1.0), solver="PGS", iterations=50,
        integrator="Euler",
    )  # fmt: skip
    soft, cylinders = replace(ode, cone="elliptic", solimp=None, solref=None), {"wheel_shape": "cylinder"}
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
    }


def chosen_settings(only: Sequence[str], robot: Robot | None = None) -> dict[str, Setting]:
    """Return the baseline and a robot's settings of some groups; all if none is named.

    Raises:
        ValueError: an unknown group.
    """
    every = tried_settings(robot)
    groups = list(dict.fromkeys(name.partition(":")[0] for name in every if name != BASELINE))
    if unknown := [name for name in only if name not in groups]:
        raise ValueError(f"unknown group '{', '.join(unknown)}' in only; there are: {', '.join(groups)}")
    return {n: s for n, s in every.items() if not only or n == BASELINE or n.partition(":")[0] in only}


@dataclass(frozen=True, kw_only=True)
class ContactStudy(RecordedOptions):
    """Options of the study of physics settings."""

    only: Annotated[cli.Names, cli.option(default="all groups")] = ()
    """Groups to try besides what is shipped: cone, impedance, solver, time step, centre of mass, defaults, near ODE."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown group, or a time without a recording."""
        chosen_settings(self.only)
        super().__post_init__()


class Bench(NamedTuple):
    """What all settings have in common."""

    lab: PlantProfile
    """MuJoCo robot that stands for the lab's robot."""
    pieces: Mapping[str, Piece]
    """Trajectories 1-4."""
    models: Mapping[str, Mapping[str, Trajectory]]
    """Motions of the published models, by model and trajectory."""
    recorded: PlantProfile | None
    """MuJoCo robot that stands for the recorded robot; None without a recording."""
    recording: Source | None
    """Recording, with its wheel rates as input."""


def make_bench(lab: Profile, recorded: Profile | None = None, recording: Source | None = None) -> Bench:
    """Drive the published models, and return the bench."""
    pieces = {name: open_source(name).pieces[0] for name in TRAJECTORIES}
    models = {
        m: {name: drive(make_plant(lab, m), piece, lab.plants[m].localiser, SAMPLE) for name, piece in pieces.items()}
        for m in MODELS
    }
    return Bench(lab.section("mujoco"), pieces, models, None if recorded is None else recorded.section("mujoco"), recording)


class Trial:
    """A setting on the bench, with tyres that roll with the profile's radius."""

    def __init__(self, bench: Bench, setting: Setting) -> None:
        """Take over a setting."""
        self.bench, self.setting, self.localiser = bench, setting, bench.lab.localiser

    @cached_property
    def uncorrected(self) -> tuple[Calibration, float]:
        """The robot's numbers, with the radius that the corrected robot rolls with, and what its tyres roll too far [m]."""
        plant = self.setting.plant(self.bench.lab)
        return plant.calibration, rolling_radius(plant)[0] - plant.calibration.wheel_radius

    @cached_property
    def plant(self) -> MujocoPlant:
        """The corrected robot."""
        return self.setting.plant(self.bench.lab, -self.uncorrected[1])

    def straight(self) -> Row:
        """Return what a straight drive shows."""
        return {"veer_share": rolling_radius(self.plant)[1]}

    def spot(self) -> Row:
        """Return what whole turns on the spot show."""
        found = measure_spin(spin(self.plant), self.uncorrected[0])
        known = {"ripple_share": found.get("ripple"), "glide_share": found["glide"]}
        if "multiplier" in found:
            known["off_closed_form_share"] = found["multiplier"] / found["multiplier_expected"] - 1.0
        return {**known, **{k: found.get(k) for k in ("multiplier", "lifted_share", "wander_m", "drift_m")}}

    def slope(self) -> Row:
        """Return what standing on a slope shows."""
        return {"creep_m_s": creep(self.plant)}

    def trajectories(self) -> Row:
        """Return the distances from the published models, and what trajectories 3 and 4 show."""
        pieces, driver, (numbers, excess) = self.bench.pieces, self.bench.lab.drive, self.uncorrected
        motions = {name: drive(self.plant, piece, self.localiser, SAMPLE) for name, piece in pieces.items()}
        turned = drive(self.plant, replace(pieces["traj3"], start=State(yaw=TURNED)), self.localiser, SAMPLE)
        fine = drive(self.setting.plant(self.bench.lab, -excess, 2.0), pieces["traj4"], self.localiser, SAMPLE)
        c, s = math.cos(TURNED), math.sin(TURNED)
        apart = {
            f"to_{model}_m": float(np.mean([compare_paths(motions[name], path)["d_rms_m"] for name, path in paths.items()]))
            for model, paths in self.bench.models.items()
        }
        return {
            "surge_share": max(surge(motion, numbers.wheel_radius, driver) for motion in (motions["traj3"], turned)),
            "ground_turned_m": _apart(turned.xy @ np.array([[c, -s], [s, c]]), motions["traj3"].xy),  # in the ground's frame
            "step_halved_m": _apart(fine.xy, motions["traj4"].xy),
            **apart,
        }

    def recording(self) -> Row:
        """Return the errors of the robot driven with the recording's wheel rates."""
        source, section = self.bench.recording, self.bench.recorded
        if source is None or section is None:
            return {}
        plant = self.setting.plant(section, -self.uncorrected[1])
        motions = [drive(plant, piece, section.localiser, source.sample_dt) for piece in source.pieces]
        errors = horizons_of([(source, motions)], [HORIZON])[HORIZON]
        return {"recording_m": errors.position_median_m, "recording_yaw_rad": errors.yaw_median_rad}


def _apart(one: FloatArray, other: FloatArray) -> float:
    """Return the distance of the ends of two (M, 2) paths [m]."""
    return float(np.hypot(*(one[-1] - other[-1])))


CONTACT_DRIVES = {
    "straight drive": Trial.straight,
    "turn on the spot": Trial.spot,
    "slope": Trial.slope,
    "trajectories": Trial.trajectories,
    "recording": Trial.recording,
}
"""What every setting goes through."""
_UNITS = {
    "creep_m_s": Unit("mm/s", 1e3, 2),
    **{c: MILLIMETRES for some in CONTACT_MEASURES.values() for c in some if c.endswith("_m")},
}


@cli.program(ContactStudy)
def study_contact(o: ContactStudy) -> Report:
    """Measure what physics settings of MuJoCo do to the simulated robot, one at a time and together.

    Raises:
        ValueError: profile or recording do not exist, or do not fit the settings.
        SsmrError: a published model diverged.
    """
    lab, (recorded, sources) = o.robot_profile(), o.opened("wheels")
    bench, chosen = make_bench(lab, recorded, *sources), chosen_settings(o.only, lab.robot)
    trials = {name: Trial(bench, setting) for name, setting in chosen.items()}
    swept = sweep(trials, CONTACT_DRIVES, workers=o.workers, progress=o.progress)
    meanings = {title: {c: meaning for c, (meaning, _) in columns.items()} for title, columns in CONTACT_MEASURES.items()}
    changes = {name: {**_changed(s.physics), **s.robot} for name, s in chosen.items()}
    facts = {"schema": "ssmr.study.contact/2", "study": "contact", "robot": lab.robot.name, "profile": lab.name}
    return Report(
        program="study", title=f"Physics settings, profile {with_robot(lab.name, lab.robot.name)}", draw=_draw,
        tables=meaning_tables(swept.rows, meanings, _UNITS), sentences=swept.notes, status=swept.status,
        options={"recording": sources[0].name if sources else None}, document={**facts, "changes": changes}, has_text=True,
    )  # fmt: skip


def _changed(settings: PhysicsSettings) -> dict[str, Any]:
    """Return the fields that settings change."""
    return {name: value for name, value in asdict(settings).items() if value is not None}


def badness(value: float | None, limits: tuple[float, float] | None) -> float:
    """Return where a value lies between limits, on a logarithmic scale from 0 (good) to 1 (bad); NaN without either."""
    if limits is None or value is None:
        return math.nan
    good, bad = limits
    return min(max(math.log(max(abs(value), 1e-300) / good) / math.log(bad / good), 0.0), 1.0)


def _draw(study: Report) -> Figure:
    """Return the picture: settings as rows, measures as columns, the redder the worse."""
    title = "What physics settings do to a simulated robot (white: good; the redder, the worse, on a logarithmic scale)"
    rows = [
        drawing.text_row(0.3, partial(drawing.draw_section, title)),
        drawing.Row(1.2 + 0.26 * len(study.tables[0].rows), ((1.0, partial(_draw_rows, study.tables)),)),
        *drawing.note_rows(study.notes()),
        drawing.text_row(0.26, partial(drawing.draw_footer, f"{study.title} · {study.made_by}")),
    ]
    return drawing.put_together(rows)


def _draw_rows(tables: Sequence[Table], ax: Axes) -> None:
    rows = [{k: v for part in parts for k, v in part.items()} for parts in zip(*(t.rows for t in tables), strict=True)]
    limits = {c: limit for some in CONTACT_MEASURES.values() for c, (_, limit) in some.items()}
    columns = [c for c in limits if any(row.get(c) is not None for row in rows)]
    units = [_UNITS.get(c) or unit_of(c, ()) for c in columns]
    drawing.inset(ax, left=1.9, above=0.55)
    bad = np.array([[badness(row.get(c), limits[c]) for c in columns] for row in rows])
    ax.imshow(bad, LinearSegmentedColormap.from_list("worse", ["white", "#d55e00"]), vmin=0.0, vmax=1.0, aspect="auto")
    for y, row in enumerate(rows):
        for x, (column, unit) in enumerate(zip(columns, units, strict=True)):
            text = "–" if row.get(column) is None else unit.text(row[column])
            ax.text(x, y, text, ha="center", va="center", gid=f"{row['variant']}, {column}")
    ax.set_yticks(range(len(rows)), [row["variant"] for row in rows])
    heads = [heading_of(c).replace(" ", "\n") + f"\n[{unit.symbol}]" for c, unit in zip(columns, units, strict=True)]
    ax.set_xticks(range(len(columns)), heads, fontsize=8.0)
    ax.tick_params(labeltop=True, labelbottom=False, length=0.0)
    ax.grid(visible=False)
