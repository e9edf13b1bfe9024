"""The test bench of the contact study: drives that every variant makes, and measures taken from them.

How deep tyres are pressed into the ground depends on the contact settings, and so does the radius that they roll with. That
alone shall not count, so every measure is taken with tyres whose size is corrected to roll with the profile's radius.
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

from ssmr.metrics.declared import compare_paths
from ssmr.metrics.poses import horizon_windows
from ssmr.robot.vehicle import Drive
from ssmr.types import State, Trajectory
from validation.motion.driving import drive, horizons_of
from validation.motion.sources import Piece, Source, open_source
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.simulator.model import controls
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, STRAIGHT_SPEED, creep, measure_spin, rolling_radius, spin
from validation.study.contact.variants import PhysicsVariant
from validation.study.measured import Attempts, Tried

SCENARIOS = ("traj1", "traj2", "traj3", "traj4")
PUBLISHED_MODELS = ("improved", "coulomb", "linear")
"""Published models of the lab's robot."""
HORIZON = 6.0
"""Length of the windows over which errors against a recording are taken [s]."""

TURNED = 0.25 * math.pi
"""Angle by which the ground is turned under trajectory 3, which should change nothing [rad]."""
_SURGE_LEAD = 3.0
"""Start of the measurement of speed on trajectory 3, when the robot has accelerated [s]."""
UNDRIVEABLE = "straight drive"
"""Name of the first drive; where it fails, nothing else is measured."""
_TIMED = 2.0
"""Simulated time of which the processor time is taken [s]."""


@dataclass(frozen=True)
class Measures:
    """The measures of one variant; None for one that could not be taken."""

    rolling_radius_error: float | None = None
    """Error of the rolling radius before it is corrected, over the radius [1]."""
    multiplier: float | None = None
    """Yaw rate that the wheels ask for over that of the body, in whole turns on the spot [1]."""
    multiplier_expected: float | None = None
    """Multiplier by the closed form for this centre of mass, wheel shape and friction ratio [1]."""
    ripple: float | None = None
    """Range of the yaw rate on the spot over its mean [1]."""
    glide: float | None = None
    """Greatest speed of the robot's middle on the spot over that of the wheels' rims [1]; a straight drive has 1."""
    lifted_share: float | None = None
    """Share of the time on the spot in which a wheel is off the ground [1]."""
    drift_m: float | None = None
    """Distance that the robot's middle has moved after a turn on the spot, mean over whole turns [m]."""
    wander_m: float | None = None
    """Greatest distance of the robot's middle from its first place while it turns on the spot [m]."""
    surge: float | None = None
    """Greatest speed on trajectory 3 over that of the wheels straight ahead, less 1 [1]; the greater of two headings."""
    turned_ground_m: float | None = None
    """Distance that the end of trajectory 3 moves if the ground is turned by 45 degrees [m]."""
    veer: float | None = None
    """Deviation of a straight drive to the left over its length [1]."""
    creep_m_s: float | None = None
    """Sideways speed at rest on a slope of 8 degrees [m/s]."""
    halving_m: float | None = None
    """Distance that the end of trajectory 4 moves if the physics step is halved [m]."""
    d_rms_m: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    """d_rms of each published model from the robot [m], by model and scenario."""
    recording_position_m: float | None = None
    """Median position error against a recording after 6 s, driven with its wheel rates [m]."""
    recording_yaw_rad: float | None = None
    """Median yaw error against a recording after 6 s [rad]."""
    cost_s: float | None = None
    """Processor time of a physics step [s]."""

    @property
    def multiplier_error(self) -> float | None:
        """Deviation of the multiplier from its closed form, over the closed form [1]."""
        if self.multiplier is None or self.multiplier_expected is None:
            return None
        return self.multiplier / self.multiplier_expected - 1.0

    def d_rms_mean(self, model: str) -> float | None:
        """Return the mean d_rms over trajectories 1-4 [m]; None where one is missing."""
        values = list(self.d_rms_m.get(model, {}).values())
        known = [v for v in values if v is not None]
        return float(np.mean(known)) if values and len(known) == len(values) else None


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything that all variants have in common: robot, trajectories, recording."""

    profile: str
    """Name of the lab robot's profile."""
    lab: PlantProfile
    """MuJoCo robot that stands for the lab's robot."""
    scenarios: Mapping[str, Piece]
    """Trajectories 1-4."""
    models: Mapping[str, Mapping[str, Trajectory]]
    """Motions of the published models, by model and scenario."""
    recorded: PlantProfile | None = None
    """MuJoCo robot that stands for the recorded robot."""
    recording_profile: str | None = None
    """Name of the recorded robot's profile."""
    recording: Source | None = None
    """Recording, with its wheel rates as input."""


def make_bench(profile: Profile, recorded: Profile | None = None, recording: Source | None = None) -> Bench:
    """Drive the published models, and return the bench.

    Args:
        profile: robot of the lab.
        recorded: robot of the recording; None without one.
        recording: recording with its wheel rates as input; None for none.

    Raises:
        ValueError: the numbers of a profile do not fit together, or the recording has no window of 6 s.
        SsmrError: a model diverged.
    """
    scenarios = {name: open_source(name).pieces[0] for name in SCENARIOS}
    models = {}
    for model in PUBLISHED_MODELS:
        plant, localiser = make_plant(profile, model), profile.plants[model].localiser
        models[model] = {name: drive(plant, piece, localiser, SAMPLE) for name, piece in scenarios.items()}
    if recording is not None and not any(
        p.t is not None and len(p.windows(horizon_windows, p.t, HORIZON)[0]) for p in recording.pieces
    ):
        raise ValueError(f"{recording.name} has no stretch of {HORIZON:g} s without a gap or a jump of the localiser")
    bench = Bench(profile.name, profile.plants["mujoco"], scenarios, models, recording=recording)
    return bench if recorded is None else replace(bench, recorded=recorded.plants["mujoco"], recording_profile=recorded.name)


def make_variant(variant: PhysicsVariant, section: PlantProfile) -> MujocoPlant:
    """Return the robot of a profile with a variant's settings.

    Raises:
        ValueError: the parameters do not fit together.
    """
    return MujocoPlant(variant.calibration(section.parameters), section.drive, settings=variant.settings)


def surge_of(motion: Trajectory, wheel_radius: float, drive: Drive) -> float:
    """Return the greatest speed on trajectory 3, once under way, over that of the wheels straight ahead, less 1 [1]."""
    rim = STRAIGHT_SPEED * wheel_radius / drive.command_radius
    return float(motion.twist[motion.t >= _SURGE_LEAD, 0].max()) / rim - 1.0


class _Trial(Attempts):
    """A variant on the bench: it takes every measure that it can, and keeps why others failed."""

    def __init__(self, bench: Bench, variant: PhysicsVariant, stopped: Callable[[], bool]) -> None:
        super().__init__()
        self.bench, self.variant, self.stopped = bench, variant, stopped

    def attempt(self, what: str, measure: Callable[[], Mapping[str, Any]]) -> bool:
        """Take some measures unless it was stopped, and return whether that went well."""
        return not self.stopped() and super().attempt(what, measure)

    def straight(self) -> dict[str, float]:
        """Find the rolling radius in a first drive, and drive again with tyres of the right size."""
        plant = make_variant(self.variant, self.bench.lab)
        self.rolling = plant.calibration  # with the radius that the corrected robot rolls with
        wanted = self.rolling.wheel_radius
        self.excess = rolling_radius(plant)[0] - wanted
        self.plant = self.corrected(self.bench.lab)
        return {"rolling_radius_error": self.excess / wanted, "veer": rolling_radius(self.plant)[1]}

    def corrected(self, section: PlantProfile, refine: float = 1.0) -> MujocoPlant:
        """Return a robot whose tyres roll with its profile's radius, with a step divided by `refine`."""
        calibration = self.variant.calibration(section.parameters)
        calibration = replace(
            calibration, wheel_radius=calibration.wheel_radius - self.excess, timestep=calibration.timestep / refine
        )
        return MujocoPlant(calibration, section.drive, settings=self.variant.settings)

    def trajectories(self) -> dict[str, Any]:
        """Return the distances from the published models on trajectories 1-4, and what trajectory 3 shows."""
        lab, scenarios = self.bench.lab, self.bench.scenarios
        motions = {name: drive(self.plant, piece, lab.localiser, SAMPLE) for name, piece in scenarios.items()}
        turned = drive(self.plant, replace(scenarios["traj3"], start=State(yaw=TURNED)), lab.localiser, SAMPLE)
        surge = max(surge_of(motion, self.rolling.wheel_radius, lab.drive) for motion in (motions["traj3"], turned))
        apart = {
            model: {name: compare_paths(motions[name], reference)["d_rms_m"] for name, reference in paths.items()}
            for model, paths in self.bench.models.items()
        }
        self.end = motions["traj4"].xy[-1]
        c, s = math.cos(TURNED), math.sin(TURNED)
        turned_end = turned.xy @ np.array([[c, -s], [s, c]])  # in the frame of the ground
        return {
            "d_rms_m": apart,
            "surge": surge,
            "turned_ground_m": float(np.hypot(*(turned_end[-1] - motions["traj3"].xy[-1]))),
        }

    def halved(self) -> dict[str, float]:
        """Return how far the end of trajectory 4 moves with half the step."""
        fine = drive(self.corrected(self.bench.lab, 2.0), self.bench.scenarios["traj4"], self.bench.lab.localiser, SAMPLE)
        return {"halving_m": float(np.hypot(*(fine.xy[-1] - self.end)))}

    def recorded(self) -> dict[str, float]:
        """Return the errors of the robot driven with the recording's wheel rates."""
        source, section = self.bench.recording, self.bench.recorded
        assert source is not None
        assert section is not None
        plant = self.corrected(section)
        motions = [drive(plant, piece, section.localiser, source.sample_dt) for piece in source.pieces]
        errors = horizons_of([(source, motions)], [HORIZON])[HORIZON]
        return {"recording_position_m": errors.position_median_m, "recording_yaw_rad": errors.yaw_median_rad}


def measure_variant(bench: Bench, variant: PhysicsVariant, stopped: Callable[[], bool] = lambda: False) -> Tried:
    """Return all measures of a variant but the cost of a step; once `stopped()`, the rest is left out."""
    trial = _Trial(bench, variant, stopped)
    if trial.attempt(UNDRIVEABLE, trial.straight):
        ratio = variant.settings.tangent_ratio
        trial.attempt("turn on the spot", lambda: measure_spin(spin(trial.plant), trial.rolling, ratio))
        trial.attempt("slope", lambda: {"creep_m_s": creep(trial.plant)})
        if trial.attempt("trajectories", trial.trajectories):
            trial.attempt("half the step", trial.halved)
        if bench.recording is not None:
            trial.attempt("recording", trial.recorded)
    return Tried(variant, Measures(**trial.found), MappingProxyType(trial.failures))


def step_time(plant: MujocoPlant) -> float:
    """Return the processor time of a physics step, mean over `_TIMED` of a turn on the spot that has begun [s]."""
    data = mujoco.MjData(plant.model)
    count = round(_TIMED / plant.dt)
    data.ctrl[:] = controls(plant.model, np.array([-2.0, 2.0]))
    mujoco.mj_step(plant.model, data, nstep=count)
    began = time.thread_time()
    mujoco.mj_step(plant.model, data, nstep=count)
    return (time.thread_time() - began) / count
