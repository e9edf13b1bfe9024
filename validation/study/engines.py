"""The same robot in MuJoCo, ODE and Drake, with their own settings, Gazebo's and the best (docs/engines.md)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.metrics.declared import compare_paths
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation import cli
from validation.bench.sources import Piece, Source, drive, horizons_of, open_source
from validation.engines import ode_library
from validation.engines.body import EngineMissingError
from validation.engines.drake import DrakeBody, DrakeSettings
from validation.engines.ode import GAZEBO, HUSKY, MAKERS_HUSKY, OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.plants.table import SECOND_OPINIONS, STANDARD
from validation.progress import Report as Progressing
from validation.report import drawing
from validation.report.columns import MILLIMETRES, Unit
from validation.report.report import Report
from validation.report.table import Row
from validation.simulator.description import GRAVITY, with_robot
from validation.simulator.health import LIFT_SHARE
from validation.simulator.physics import MUJOCO_IMPEDANCE, SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.turning import SAMPLE, TURNED, closed_form, surge
from validation.study.options import HORIZON, RecordedOptions
from validation.study.sweep import meaning_tables, sweep

ENGINES = (STANDARD, *SECOND_OPINIONS)
"""Names of the engines that are compared."""
RIM_RATE, _SPIN_TIME, _LEAD = 2.0, 16.0, 2.0
"""Turn on the spot at given wheel rates [rad/s], its length, and the start of the measurement [s]."""
BINS = 24
"""Sectors of the heading in which the yaw rate is averaged."""
_SLOPE, _STAND = math.radians(8.0), 4.0
_SLIDE, _SLIDE_TIME = 1.0, 1.5
"""Speed from which locked wheels slide to a stop [m/s], on a heading of half a radian to it, and the time for it [s]."""

_DASHES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (1, 3)), (0, (6, 1, 1, 1, 1, 1)))
"""Lines of the picture, as many as an engine has settings."""

ENGINE_MEASURES: Mapping[str, Mapping[str, str]] = {
    "Turning on the spot at given wheel rates": {
        "multiplier": "yaw rate that the wheels suggest over that of the body, over the whole turn",
        "cone": "closed form with Coulomb's friction cone for these wheels and this centre of mass",
        "least": "least multiplier over a sector of 15° of the heading",
        "most": "greatest multiplier over a sector of 15° of the heading",
        "wander_m": "greatest distance of the robot's middle from its first place within 14 s",
        "cone's_wander_m": "what the closed form has for it: twice the distance of the centre of rotation",
        "lifted_share": "share of the time in which a wheel is off the ground",
        "loads_N": "root mean square deviation of the loads' sum from the weight",
        "gave_up_share": "share of steps in which the solver said that it gave up",
        "step_us": "processor time of a physics step with the Python loop around it (MuJoCo's loop is compiled)",
    },
    "At rest, sliding, on trajectories and on the recording": {
        "creep_m_s": "speed down a slope of 8° with locked wheels, the greater of two headings",
        "slide": "distance of a slide to a stop over v²/2μg",
        "step_halved_m": "distance that the end of trajectory 4 moves if the physics step is halved",
        "surge_share": "greatest speed on trajectory 3, at either of two headings, over that of its wheels, less 1",
        **{f"{name}_m": f"d_rms from the improved model on {name}" for name in TRAJECTORIES},
        "wheels_m": "median error of the relative position after 6 s against the recording, driven with its wheel rates",
        "commands_m": "as wheels, driven with its commands",
    },
}
"""What is measured, by table."""
_UNITS = {c: MILLIMETRES for some in ENGINE_MEASURES.values() for c in some if c.endswith("_m")}
_UNITS["creep_m_s"] = Unit("mm/s", 1e3, 3)


@dataclass(frozen=True)
class EngineSetting:
    """An engine with settings."""

    settings: PhysicsSettings | OdeSettings | DrakeSettings
    """Settings of the engine; their type says which it is."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `Calibration` that change too."""
    scored: bool = False
    """Whether it is driven over recordings."""

    @property
    def engine(self) -> str:
        """Name of the engine."""
        return ENGINES[(PhysicsSettings, OdeSettings, DrakeSettings).index(type(self.settings))]

    def plant(self, section: PlantProfile, terrain: Terrain = FLAT, steps: float = 1.0) -> EnginePlant | MujocoPlant:
        """Return a profile's robot, with `steps` times as many physics steps.

        Raises:
            ValueError: the engine is missing, or cannot have these numbers.
        """
        c, s = replace(section.parameters, **dict(self.changes)), self.settings
        c = replace(c, timestep=c.timestep / steps)
        if isinstance(s, OdeSettings):
            return EnginePlant(self.engine, lambda numbers: OdeBody(numbers, s), c, section.drive, terrain)
        if isinstance(s, DrakeSettings):
            return EnginePlant(self.engine, lambda numbers: DrakeBody(numbers, s), c, section.drive, terrain)
        return MujocoPlant(c, section.drive, terrain=terrain, settings=s)


_CONE = replace(GAZEBO, friction_law="cone")
ENGINE_SETTINGS: Mapping[str, EngineSetting] = {
    "mujoco: as shipped": EngineSetting(SHIPPED, scored=True),
    "mujoco: its own defaults": EngineSetting(
        PhysicsSettings("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")
    ),
    "ode: its own defaults": EngineSetting(OdeSettings("pyramid", "world", "quick", 20, soft=False, cfm=1e-10)),
    "ode: Gazebo's Husky": EngineSetting(GAZEBO, MAKERS_HUSKY, True),
    "ode: Gazebo's Husky, centre in the middle": EngineSetting(GAZEBO, HUSKY),
    "ode: Gazebo's Husky, emulated cone": EngineSetting(_CONE, MAKERS_HUSKY),
    "ode: Gazebo's Husky, emulated cone, centred": EngineSetting(_CONE, HUSKY),
    "ode: best, emulated cone, exact solver": EngineSetting(OdeSettings(), scored=True),
    "drake: its own defaults": EngineSetting(DrakeSettings(stiffness=-1.0, stiction=1e-3)),
    "drake: best, stiction 0.1 mm/s": EngineSetting(DrakeSettings(), scored=True),
}
"""What is tried, by engine and name; what is not said is as in the profile."""


def chosen_engines(engines: Sequence[str]) -> dict[str, EngineSetting]:
    """Return the settings of some engines, of all if none is named.

    Raises:
        ValueError: there is no such engine.
    """
    if unknown := [name for name in engines if name not in ENGINES]:
        raise ValueError(f"unknown engine '{', '.join(unknown)}' in engines; there are: {', '.join(ENGINES)}")
    return {name: s for name, s in ENGINE_SETTINGS.items() if not engines or s.engine in engines}


@dataclass(frozen=True, kw_only=True)
class EnginesStudy(RecordedOptions):
    """Options of the study of engines."""

    engines: Annotated[cli.Names, cli.option(metavar="ENGINE,...", default="all")] = ()
    """Engines to try: mujoco, ode, drake."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown engine, or a time without a recording."""
        chosen_engines(self.engines)
        super().__post_init__()


class EngineBench(NamedTuple):
    """Everything that all engines have in common."""

    lab: Profile
    """Robot of the lab."""
    improved: Mapping[str, Trajectory]
    """Motion of the improved model on each trajectory."""
    pieces: Mapping[str, Piece]
    """The trajectories."""
    recorded: Profile | None = None
    """Robot of the recording; None without one."""
    sources: Sequence[Source] = ()
    """Recording with its wheel rates, and with its commands as input."""


def make_engine_bench(lab: Profile, recorded: Profile | None, sources: Sequence[Source]) -> EngineBench:
    """Drive the improved model, and return the bench."""
    pieces = {name: open_source(name).pieces[0] for name in TRAJECTORIES}
    plant, localiser = make_plant(lab, "improved"), lab.plants["improved"].localiser
    return EngineBench(
        lab, {name: drive(plant, piece, localiser, SAMPLE) for name, piece in pieces.items()}, pieces, recorded, sources
    )


class EngineTrial:
    """An engine's robot on the bench."""

    def __init__(self, bench: EngineBench, setting: EngineSetting) -> None:
        """Take over a setting."""
        self.bench, self.setting, self.section = bench, setting, bench.lab.section(setting.engine)
        self.by_heading = np.full(BINS, np.nan)

    @cached_property
    def plant(self) -> EnginePlant | MujocoPlant:
        """The robot; an EngineMissingError says that there is no such engine."""
        return self.setting.plant(self.section)

    def hold(self, plant: EnginePlant | MujocoPlant, rates: tuple[float, float], seconds: float, start: State) -> Trajectory:
        """Return a drive with given wheel rates [rad/s]."""
        return plant.run(Commands(0.05, np.tile(rates, (round(seconds / 0.05), 1)), "wheels"), start, SAMPLE)

    def turn(self) -> Row:
        """Return what a turn on the spot with given wheel rates shows."""
        c, before, began = self.plant.calibration, ode_library.failures, time.thread_time()
        motion = self.hold(self.plant, (-RIM_RATE, RIM_RATE), _SPIN_TIME, State())
        spent, steps = time.thread_time() - began, round(_SPIN_TIME / self.plant.dt)
        tail = motion.t >= _LEAD
        t, xy, yaw, rate = motion.t[tail], motion.xy[tail], motion.yaw[tail], motion.twist[tail, 2]
        weight = c.mass * GRAVITY
        loads, asked = motion.channels["wheel_load_N"][tail], c.wheel_radius * RIM_RATE / c.half_track
        sector = np.floor(yaw % (2.0 * math.pi) / (2.0 * math.pi) * BINS).astype(int) % BINS
        for k in range(BINS):
            mean = float(rate[sector == k].mean()) if (sector == k).any() else 0.0
            self.by_heading[k] = asked / mean if mean > 1e-3 * asked else np.nan
        known, closed = self.by_heading[np.isfinite(self.by_heading)].tolist(), closed_form(c)
        return {
            "multiplier": asked / (float(yaw[-1] - yaw[0]) / float(t[-1] - t[0])),
            "cone": closed.multiplier,
            "least": min(known, default=None),
            "most": max(known, default=None),
            "wander_m": float(np.hypot(*(xy - xy[0]).T).max()),
            "cone's_wander_m": 2.0 * math.hypot(*closed.centre),
            "lifted_share": float((loads < LIFT_SHARE * loads.mean(axis=0)).any(axis=1).mean()),
            "loads_N": float(np.sqrt(np.mean((loads.sum(axis=1) - weight) ** 2))),
            "gave_up_share": (ode_library.failures - before) / steps,
            "step_us": spent / steps,
        }

    def slope(self) -> Row:
        """Return what standing on a slope with locked wheels shows."""
        plant, speeds = self.setting.plant(self.section, Terrain("ramp", slope=_SLOPE)), []
        for yaw in (0.0, 0.25 * math.pi):
            xy = self.hold(plant, (0.0, 0.0), _STAND, State(yaw=yaw)).xy
            speeds.append(float(np.hypot(*(xy[-1] - xy[len(xy) // 2]))) / (0.5 * _STAND))
        return {"creep_m_s": max(speeds)}

    def slide(self) -> Row:
        """Return what a slide with locked wheels to a stop shows."""
        start = State(yaw=0.5, v_x=_SLIDE * math.cos(0.5), v_y=-_SLIDE * math.sin(0.5))
        end = self.hold(self.plant, (0.0, 0.0), _SLIDE_TIME, start).xy[-1]
        return {"slide": float(np.hypot(*end)) * 2.0 * self.plant.calibration.friction * GRAVITY / _SLIDE**2}

    def trajectories(self) -> Row:
        """Return what trajectories 1-4 show."""
        pieces, localiser, improved = self.bench.pieces, self.section.localiser, self.bench.improved
        motions = {name: drive(self.plant, piece, localiser, SAMPLE) for name, piece in pieces.items()}
        end = drive(self.setting.plant(self.section, steps=2.0), pieces["traj4"], localiser, SAMPLE).xy[-1]
        turned = drive(self.plant, replace(pieces["traj3"], start=State(yaw=TURNED)), localiser, SAMPLE)
        return {
            "surge_share": max(
                surge(m, self.plant.calibration.wheel_radius, self.section.drive) for m in (motions["traj3"], turned)
            ),
            "step_halved_m": float(np.hypot(*(end - motions["traj4"].xy[-1]))),
            **{f"{name}_m": compare_paths(motion, improved[name])["d_rms_m"] for name, motion in motions.items()},
        }

    def recording(self) -> Row:
        """Return the errors against the recording."""
        found: dict[str, float] = {}
        if self.bench.recorded is not None and self.setting.scored:
            section = self.bench.recorded.section(self.setting.engine)
            plant = self.setting.plant(section)
            for measure, source in zip(("wheels_m", "commands_m"), self.bench.sources, strict=True):
                motions = [drive(plant, piece, section.localiser, source.sample_dt) for piece in source.pieces]
                found[measure] = horizons_of([(source, motions)], [HORIZON])[HORIZON].position_median_m
        return found


ENGINE_DRIVES = {
    "turn on the spot": EngineTrial.turn,
    "slope": EngineTrial.slope,
    "slide": EngineTrial.slide,
    "trajectories": EngineTrial.trajectories,
    "recording": EngineTrial.recording,
}
"""What every setting goes through."""


def try_engines(bench: EngineBench, chosen: Mapping[str, EngineSetting], progress: Progressing) -> Report:
    """Measure some settings on a bench; those of an engine that is missing are left out, and the report says so.

    Raises:
        EngineMissingError: no engine of any setting is installed.
        ValueError: an engine cannot have the robot's numbers.
    """
    trials, missing = {name: EngineTrial(bench, setting) for name, setting in chosen.items()}, dict[str, str]()
    for trial in trials.values():
        try:
            trial.plant.reset(State())
        except EngineMissingError as error:
            missing[trial.setting.engine] = f"{error}."
    there = {name: trial for name, trial in trials.items() if trial.setting.engine not in missing}
    if not there:
        raise EngineMissingError("; ".join(missing.values()))
    swept = sweep(there, ENGINE_DRIVES, workers=1, progress=progress)  # one after another: processor time is measured
    changes = {name: {**asdict(s.settings), **s.changes} for name, s in chosen.items()}
    lab, recording = bench.lab, bench.sources[0].name if bench.sources else None
    facts = {"schema": "ssmr.study.engines/2", "study": "engines", "robot": lab.robot.name, "profile": lab.name}
    return Report(
        program="study", title=f"One robot in several engines, profile {with_robot(lab.name, lab.robot.name)}",
        tables=meaning_tables(swept.rows, ENGINE_MEASURES, _UNITS), status=swept.status, options={"recording": recording},
        sentences=[
            *missing.values(), *swept.notes,
            "Gazebo itself was not run: its Husky's settings were given to the distribution's ODE.",
            "ODE has no friction cone; where one is emulated, the name says so.",
        ],
        document={**facts, "missing": list(missing), "changes": changes}, has_text=True,
        draw=partial(_draw, {row["variant"]: there[row["variant"]].by_heading for row in swept.rows}),
    )  # fmt: skip


@cli.program(EnginesStudy)
def study_engines(o: EnginesStudy) -> Report:
    """Drive the same robot in several engines with several settings.

    Raises:
        ValueError: profile or recording do not exist, or none of the engines is installed.
        SsmrError: the improved model diverged.
    """
    lab, (recorded, sources) = o.robot_profile(), o.opened("wheels", "twist")
    return try_engines(make_engine_bench(lab, recorded, sources), chosen_engines(o.engines), o.progress)


def _draw(headings: Mapping[str, FloatArray], study: Report) -> Figure:
    """Return the picture: the multiplier over the heading."""

    def draw(ax: Axes) -> None:
        at = (np.arange(BINS) + 0.5) * 360.0 / BINS
        for k, (name, by_heading) in enumerate(headings.items()):
            ink = drawing.ink_of(name.partition(":")[0])
            ax.plot(at, by_heading, linestyle=_DASHES[k % len(_DASHES)], color=ink, label=name, gid=name)
        ax.set(xlabel="heading [deg]", ylabel="wheels' yaw rate over the robot's", xlim=(0.0, 360.0), ylim=(0.8, 5.5))
        ax.set_xticks(range(0, 361, 45))
        ax.legend(fontsize=8.5, loc="upper left", ncols=3)

    rows = [
        drawing.text_row(0.3, partial(drawing.draw_section, "Multiplier over the heading, turning on the spot")),
        drawing.side_by_side(4.6, [draw]),
        *drawing.note_rows(study.notes()),
        drawing.text_row(0.26, partial(drawing.draw_footer, f"{study.title} · {study.made_by}")),
    ]
    return drawing.put_together(rows)
