"""What a MuJoCo Husky does under some physics settings: the same drives for each, and what comes out of them.

Every measure is taken with a robot whose tyres roll with the profile's radius: how deep they are pressed in depends on the
settings (`validation.husky.PRESSED_IN` holds for the shipped ones), and that alone is not to count.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from ssmr.errors import DivergedError, SsmrError
from ssmr.metrics.paths import compare_paths
from ssmr.robot.skid_turn import TRACK, turn_on_the_spot
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.motion.driving import drive, score_horizons
from validation.motion.sources import Piece, Source, open_source
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.robots.husky import CAPSULE_HALF_LENGTH, GRAVITY, WHEELS, HuskyCalibration
from validation.robots.physics import SHIPPED, PhysicsSettings
from validation.robots.plant import LIFT_SHARE, MujocoPlant

HALF_WIDTH: Mapping[str, float] = MappingProxyType({"ellipsoid": 0.0, "capsule": CAPSULE_HALF_LENGTH, "cylinder": 0.05715})
"""Half the distance of a wheel's outermost contact points [m], by shape."""
SCENARIOS = ("traj1", "traj2", "traj3", "traj4")
MODELS = ("improved", "coulomb", "linear")
"""The published models of the lab's robot."""
HORIZON = 6.0
"""After which errors against a recording are taken [s]."""

WHEEL_MASS = 2.637
"""Of models/husky.xml [kg]."""
SAMPLE = 0.01
"""Period of samples [s]: a whole number of all steps up to 10 ms that divide it."""
SPIN_RATE, SPIN_TIME, SPIN_LEAD = 0.6, 38.0, 2.0
"""Yaw rate commanded on the spot [rad/s], for how long, and from when on it counts [s]: three turns at most settings."""
STRAIGHT_SPEED, STRAIGHT_TIME, STRAIGHT_LEAD, STRAIGHT_YAW = 0.5, 8.0, 3.0, 0.4
"""Speed commanded ahead [m/s], for how long, from when on it counts [s], and heading [rad]: along no axis of the world."""
SLOPE, SLOPE_TIME, SLOPE_LEAD = math.radians(8.0), 6.0, 2.0
"""Of the side slope, for how long the robot stands on it, and from when on it counts [s]."""
TURNED = 0.25 * math.pi
"""By what the ground is turned to see whether that matters [rad]."""
SURGE_LEAD = 3.0
"""From when on speed counts on trajectory 3 [s]: the start is over."""
UNDRIVEABLE = "straight drive"
"""What has to go well for anything else to be measured."""
TIMED = 1.0
"""What is simulated to take the time of [s]."""


@dataclass(frozen=True)
class Variant:
    """Settings to be tried."""

    group: str
    """What is varied."""
    name: str
    """What tables call it; unique in its group."""
    settings: PhysicsSettings = SHIPPED
    """Of the physics."""
    changes: Mapping[str, float | str] = field(default_factory=dict)
    """Of the calibration: fields of `HuskyCalibration` that are part of the question."""

    def calibration(self, base: HuskyCalibration) -> HuskyCalibration:
        """A robot's numbers with the changes in place.

        Raises:
            ValueError: they do not go together.
        """
        return replace(base, **dict(self.changes))  # type: ignore[arg-type]

    @property
    def key(self) -> str:
        """Group and name."""
        return f"{self.group}: {self.name}"


@dataclass(frozen=True)
class Measures:
    """What was measured; None where nothing could be."""

    rolling_radius_error: float | None = None
    """Of tyres made for the shipped contact, over their radius [1]; corrected in all that follows."""
    multiplier: float | None = None
    """Yaw rate of the wheels over the body's on the spot, over whole turns [1]."""
    multiplier_expected: float | None = None
    """The same by the closed form of the robot's centre of mass, wheels and anisotropy [1]."""
    ripple: float | None = None
    """Range of the yaw rate on the spot over its mean [1]."""
    glide: float | None = None
    """Greatest speed of the middle of the robot on the spot over that of the wheels' rims [1]; 1 for a straight drive."""
    lifted_share: float | None = None
    """Of the time on the spot with a wheel off the ground [1]."""
    drift_m: float | None = None
    """How far the middle of the robot has moved after a turn on the spot, mean over whole turns [m]."""
    wander_m: float | None = None
    """How far it comes from where it was while it turns on the spot [m]."""
    surge: float | None = None
    """Greatest speed on trajectory 3 over what its wheels give straight ahead, less 1 [1]; the greater of two headings 45
    degrees apart."""
    turned_ground_m: float | None = None
    """How far the end of trajectory 3 moves on the robot's map where the ground is turned by 45 degrees [m]."""
    veer: float | None = None
    """Deviation to the left of a straight drive over its length [1]."""
    creep_m_s: float | None = None
    """Sideways on a slope of 8 degrees at rest [m/s]."""
    halving_m: float | None = None
    """How far the end of trajectory 4 moves where the step is halved [m]."""
    d_rms_m: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    """Of each published model's trajectories 1-4 to the robot's [m], by model and scenario."""
    recording_position_m: float | None = None
    """Median error of the relative pose to a recording after 6 s, driven with its wheel rates [m]."""
    recording_yaw_rad: float | None = None
    """The same of yaw [rad]."""
    cost_s: float | None = None
    """Of a step [s]."""

    @property
    def multiplier_error(self) -> float | None:
        """Of the multiplier, over that of the closed form [1]."""
        if self.multiplier is None or self.multiplier_expected is None:
            return None
        return self.multiplier / self.multiplier_expected - 1.0

    def d_rms_mean(self, model: str) -> float | None:
        """Over trajectories 1-4 [m]; None where one is missing."""
        values = list(self.d_rms_m.get(model, {}).values())
        known = [v for v in values if v is not None]
        return float(np.mean(known)) if values and len(known) == len(values) else None


@dataclass(frozen=True, eq=False)
class Bench:
    """The drives that all variants have in common."""

    profile: str
    """Name of the lab's profile."""
    lab: PlantProfile
    """The MuJoCo Husky that stands for the lab's robot."""
    scenarios: Mapping[str, Piece]
    """Trajectories 1-4."""
    models: Mapping[str, Mapping[str, Trajectory]]
    """The published models' motions, by model and scenario."""
    recorded: PlantProfile | None = None
    """The MuJoCo Husky that stands for the recorded robot."""
    recording_profile: str | None = None
    """Name of its profile."""
    recording: Source | None = None
    """A recording with its wheel rates as input."""


def make_bench(profile: Profile, recorded: Profile | None = None, recording: Source | None = None) -> Bench:
    """Drive the published models.

    Args:
        profile: the lab's robot.
        recorded: the robot of the recording.
        recording: driven by its wheel rates, or None for none.

    Raises:
        ValueError: a profile whose numbers do not go together.
        SsmrError: a model diverged.
    """
    scenarios = {name: open_source(name).pieces[0] for name in SCENARIOS}
    models = {}
    for model in MODELS:
        plant, tracked = make_plant(profile, model), profile.plants[model].tracked_point
        models[model] = {name: drive(plant, piece, tracked, SAMPLE) for name, piece in scenarios.items()}
    section = None if recorded is None else recorded.plants["mujoco"]
    return Bench(
        profile.name,
        profile.plants["mujoco"],
        scenarios,
        models,
        section,
        None if recorded is None else recorded.name,
        recording,
    )


def make_variant(variant: Variant, section: PlantProfile) -> MujocoPlant:
    """The robot of a profile under a variant's settings.

    Raises:
        ValueError: numbers that do not go together.
    """
    return MujocoPlant(variant.calibration(section.parameters), section.drive, settings=variant.settings)


def _twist(v: float, w: float, seconds: float) -> Commands:
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)))


def rolling_radius(plant: MujocoPlant) -> tuple[float, float]:
    """A drive straight ahead.

    Returns:
        What the tyres roll with [m], and the deviation to the left over the length [1].

    Raises:
        DivergedError: the simulator gave up.
    """
    motion = plant.run(_twist(STRAIGHT_SPEED, 0.0, STRAIGHT_TIME), State(yaw=STRAIGHT_YAW), SAMPLE)
    tail = motion.t >= STRAIGHT_LEAD
    along = np.array([math.cos(STRAIGHT_YAW), math.sin(STRAIGHT_YAW)])
    first, last = motion.xy[tail][0], motion.xy[-1]
    ahead = float(along @ (last - first))
    aside = float(along[0] * (last - first)[1] - along[1] * (last - first)[0])
    turned = float(motion.wheels[tail].mean()) * float(motion.t[-1] - motion.t[tail][0])
    if not (ahead > 0.0 and turned > 0.0):
        raise DivergedError("a drive straight ahead went nowhere")
    return ahead / turned, aside / ahead


def creep(plant: MujocoPlant) -> float:
    """Speed at which a robot at rest slides down a side slope [m/s].

    Raises:
        DivergedError: the simulator gave up.
    """
    level = np.array(plant.model.opt.gravity)
    plant.model.opt.gravity[:] = 0.0, GRAVITY * math.sin(SLOPE), -GRAVITY * math.cos(SLOPE)
    try:
        motion = plant.run(_twist(0.0, 0.0, SLOPE_TIME), State(), SAMPLE)
    finally:
        plant.model.opt.gravity[:] = level
    tail = motion.t >= SLOPE_LEAD
    first, last = motion.xy[tail][0], motion.xy[-1]
    return float(np.hypot(*(last - first)) / (motion.t[-1] - motion.t[tail][0]))


@dataclass(frozen=True, eq=False)
class Spin:
    """A robot told to turn on the spot."""

    motion: Trajectory
    """All of it, sampled every `SAMPLE`."""
    turns: float
    """Made from `SPIN_LEAD` on [1]."""


def spin(plant: MujocoPlant, seconds: float = SPIN_TIME) -> Spin:
    """Tell a robot to turn on the spot.

    Raises:
        DivergedError: the simulator gave up.
    """
    motion = plant.run(_twist(0.0, SPIN_RATE, seconds), State(), SAMPLE)
    start = int(np.searchsorted(motion.t, SPIN_LEAD - 1e-9))
    return Spin(motion, float(motion.yaw[-1] - motion.yaw[start]) / (2.0 * math.pi))


def closed_form(calibration: HuskyCalibration, ratio: float | None = None) -> float:
    """The multiplier that mechanics asks of a robot with this centre of mass and these wheels [1].

    Args:
        calibration: its numbers.
        ratio: lateral over longitudinal friction, if not the calibration's [1].
    """
    share = (calibration.mass - len(WHEELS) * WHEEL_MASS) / calibration.mass
    return turn_on_the_spot(
        share * calibration.com_x,
        share * calibration.com_y,
        calibration.friction_ratio if ratio is None else ratio,
        HALF_WIDTH[calibration.wheel_shape],
    ).multiplier


def measure_spin(found: Spin, calibration: HuskyCalibration, tangent_ratio: float | None = None) -> dict[str, float]:
    """What a turn on the spot tells, by fields of `Measures`; what needs whole turns is left out where there is none."""
    motion, expected = found.motion, closed_form(calibration, tangent_ratio)
    tail = motion.t >= SPIN_LEAD - 1e-9
    loads, rate = motion.channels["wheel_load_N"][tail], motion.twist[tail, 2]
    wheels = motion.wheels[tail, 1] - motion.wheels[tail, 0]
    xy, yaw = motion.xy[tail], motion.yaw[tail]
    out = {
        "multiplier_expected": expected,
        "lifted_share": float((loads < LIFT_SHARE * loads.mean(axis=0)).any(axis=1).mean()),
        "glide": float(np.hypot(*motion.twist[tail, :2].T).max() / (0.5 * calibration.wheel_radius * wheels.mean())),
        "wander_m": float(np.hypot(*(xy - xy[0]).T).max()),
    }
    whole = math.floor(found.turns + 1e-9)
    if whole >= 1:
        end = int(np.argmax(yaw - yaw[0] >= 2.0 * math.pi * whole))
        span = slice(0, max(end, 1))
        out["multiplier"] = float(calibration.wheel_radius * wheels[span].mean() / (TRACK * rate[span].mean()))
        out["ripple"] = float(np.ptp(rate[span]) / rate[span].mean())
        out["drift_m"] = float(np.hypot(*(xy[end] - xy[0]))) / whole
    return out


@dataclass(frozen=True, eq=False)
class Outcome:
    """A variant that was tried."""

    variant: Variant
    """Which one."""
    measures: Measures
    """What was measured."""
    failures: Mapping[str, str]
    """Why, by what could not be measured."""


class _Trial:
    """A variant on the bench: measures what can be measured, and keeps why the rest cannot."""

    def __init__(self, bench: Bench, variant: Variant, stopped: Callable[[], bool]) -> None:
        self.bench, self.variant, self.stopped = bench, variant, stopped
        self.found: dict[str, Any] = {}
        self.failures: dict[str, str] = {}

    def attempt(self, what: str, measure: Callable[[], Mapping[str, Any]]) -> bool:
        """Measure, and say whether that went well."""
        if self.stopped():
            return False
        try:
            self.found.update(measure())
        except (SsmrError, ValueError) as error:
            self.failures[what] = " ".join(str(error).split())
        return what not in self.failures

    def straight(self) -> dict[str, float]:
        """A first drive tells the tyres' radius; the second is driven with tyres that roll as they should."""
        plant = make_variant(self.variant, self.bench.lab)
        wanted = plant.calibration.wheel_radius
        self.excess = rolling_radius(plant)[0] - wanted
        self.plant = self.corrected(self.bench.lab)
        return {"rolling_radius_error": self.excess / wanted, "veer": rolling_radius(self.plant)[1]}

    def corrected(self, section: PlantProfile, refine: float = 1.0) -> MujocoPlant:
        """A robot whose tyres roll with its profile's radius; its step divided by `refine`."""
        calibration = self.variant.calibration(section.parameters)
        calibration = replace(
            calibration, wheel_radius=calibration.wheel_radius - self.excess, timestep=calibration.timestep / refine
        )
        return MujocoPlant(calibration, section.drive, settings=self.variant.settings)

    def spin(self) -> dict[str, float]:
        """Turn on the spot."""
        return measure_spin(spin(self.plant), self.rolling, self.variant.settings.tangent_ratio)

    @property
    def rolling(self) -> HuskyCalibration:
        """The robot's numbers, its radius that which it rolls with."""
        return self.variant.calibration(self.bench.lab.parameters)

    def trajectories(self) -> dict[str, Any]:
        """All four against the published models, and what else is taken from them."""
        lab, scenarios = self.bench.lab, self.bench.scenarios
        motions = {name: drive(self.plant, piece, lab.tracked_point, SAMPLE) for name, piece in scenarios.items()}
        turned = drive(self.plant, replace(scenarios["traj3"], start=State(yaw=TURNED)), lab.tracked_point, SAMPLE)
        rim = STRAIGHT_SPEED * self.rolling.wheel_radius / lab.drive.command_radius
        ahead = [motion.twist[motion.t >= SURGE_LEAD, 0].max() for motion in (motions["traj3"], turned)]
        apart = {
            model: {name: compare_paths(motions[name], reference).d_rms_m for name, reference in paths.items()}
            for model, paths in self.bench.models.items()
        }
        self.end = motions["traj4"].xy[-1]
        return {
            "d_rms_m": apart,
            "surge": float(max(ahead)) / rim - 1.0,
            "turned_ground_m": float(np.hypot(*(_on_map(turned, TURNED)[-1] - motions["traj3"].xy[-1]))),
        }

    def halved(self) -> dict[str, float]:
        """Trajectory 4 with half the step."""
        fine = drive(
            self.corrected(self.bench.lab, 2.0), self.bench.scenarios["traj4"], self.bench.lab.tracked_point, SAMPLE
        )
        return {"halving_m": float(np.hypot(*(fine.xy[-1] - self.end)))}

    def recorded(self) -> dict[str, float]:
        """The recording's wheel rates, and how far off the robot is after a while."""
        source, section = self.bench.recording, self.bench.recorded
        assert source is not None
        assert section is not None
        plant = self.corrected(section)
        motions = [drive(plant, piece, section.tracked_point, source.sample_dt) for piece in source.pieces]
        errors = score_horizons(motions, source, [HORIZON])[HORIZON]
        return {"recording_position_m": errors.position_median_m, "recording_yaw_rad": errors.yaw_median_rad}


def measure(bench: Bench, variant: Variant, stopped: Callable[[], bool] = lambda: False) -> Outcome:
    """Everything but the cost of a step; what is left undone where `stopped` says so is not to be used."""
    trial = _Trial(bench, variant, stopped)
    if trial.attempt(UNDRIVEABLE, trial.straight):
        trial.attempt("turn on the spot", trial.spin)
        trial.attempt("slope", lambda: {"creep_m_s": creep(trial.plant)})
        if trial.attempt("trajectories", trial.trajectories):
            trial.attempt("half the step", trial.halved)
        if bench.recording is not None:
            trial.attempt("recording", trial.recorded)
    return Outcome(variant, Measures(**trial.found), MappingProxyType(trial.failures))


def _on_map(motion: Trajectory, heading: float) -> FloatArray:
    """(M, 2) path as a robot maps it that started at the origin with this heading [m]."""
    c, s = math.cos(heading), math.sin(heading)
    return motion.xy @ np.array([[c, -s], [s, c]])


def step_time(plant: MujocoPlant) -> float:
    """Processor time of a step, mean over `TIMED` of a turn on the spot that has begun [s]."""
    data = mujoco.MjData(plant.model)
    count = round(TIMED / plant.dt)
    data.ctrl[:] = -2.0, 2.0
    mujoco.mj_step(plant.model, data, nstep=count)
    began = time.thread_time()
    mujoco.mj_step(plant.model, data, nstep=count)
    return (time.thread_time() - began) / count
