"""The drives that every engine makes, and the measures taken from them."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ssmr.metrics.declared import compare_paths
from ssmr.robot.skid_turn import turn_on_the_spot
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.engines import ode_library
from validation.motion.driving import drive, horizons_of
from validation.motion.sources import Piece, Source, open_source
from validation.plants.profile import Profile, make_plant
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, WHEELS
from validation.simulator.health import LIFT_SHARE
from validation.simulator.terrain import Terrain
from validation.study.contact.bench import HORIZON, SCENARIOS, TURNED, surge_of
from validation.study.engines.variants import EngineVariant
from validation.study.measured import Attempts, Tried

RIM_RATE, _SPIN_TIME, _LEAD, _SAMPLE = 2.0, 16.0, 2.0, 0.01
"""Turn on the spot at given wheel rates [rad/s], its length, the start of the measurement and the period of samples [s]."""
BINS = 24
"""Sectors of the heading in which the yaw rate is averaged."""
_SLOPE, _STAND = math.radians(8.0), 4.0
_SLIDE, _SLIDE_TIME = 1.0, 1.5
"""Speed from which locked wheels slide to a stop [m/s], on a heading of half a radian to it, and the time for it [s]."""
_DRIVEN_RATE, _DRIVEN_TIME, _DRIVEN_LEAD = 0.3, 5.0, 3.0


@dataclass(frozen=True)
class EngineMeasures:
    """The measures of one variant; None for one that could not be taken."""

    multiplier: float | None = None
    """Yaw rate that the wheels suggest over that of the body, over the whole turn [1]."""
    multiplier_low: float | None = None
    """Its least mean over a sector of the heading [1]."""
    multiplier_high: float | None = None
    """Its greatest mean over a sector of the heading [1]."""
    multiplier_expected: float | None = None
    """Closed form with Coulomb's cone for these wheels and this centre of mass [1]."""
    wander_m: float | None = None
    """Greatest distance of the robot's middle from its first place in 14 s of turning on the spot [m]."""
    wander_expected_m: float | None = None
    """What the closed form has for it [m]: twice the distance of the centre of rotation."""
    lifted_share: float | None = None
    """Share of the turn in which a wheel is off the ground [1]."""
    load_sum_rms_n: float | None = None
    """Deviation of the loads' sum from the weight, root mean square over the turn [N]."""
    gave_up_share: float | None = None
    """Share of the turn's steps in which the solver said that it gave up [1]."""
    creep_m_s: float | None = None
    """Speed down a slope of 8 degrees with locked wheels, the greater of two headings [m/s]."""
    slide_ratio: float | None = None
    """Distance of a slide to a stop over v^2 / (2 mu g) [1]."""
    slide_aside_rad: float | None = None
    """Direction of that slide to the side of the velocity it began with [rad]."""
    energy_error: float | None = None
    """Power of the motors in a slow turn over what friction takes, less 1 [1]."""
    halving_m: float | None = None
    """Distance that the end of trajectory 4 moves if the physics step is halved [m]."""
    surge: float | None = None
    """Greatest speed on trajectory 3 over that of the wheels straight ahead, less 1 [1]; the greater of two headings."""
    d_rms_m: Mapping[str, float] = field(default_factory=dict)
    """d_rms from the improved model, by trajectory [m]."""
    wheels_m: float | None = None
    """Median position error against a recording after 6 s, driven with its wheel rates [m]."""
    commands_m: float | None = None
    """The same, driven with its commands [m]."""
    step_s: float | None = None
    """Processor time of a physics step, with the loop around it [s]."""


@dataclass(frozen=True, eq=False)
class TriedEngine(Tried):
    """A variant with its measures."""

    timestep: float
    """Physics step [s]."""
    by_heading: FloatArray
    """(BINS,) multiplier by sector of the heading, from 0 to a turn [1]; NaN where the robot never pointed."""
    path: FloatArray
    """(M, 2) path of the robot's middle in the turn on the spot [m]."""


@dataclass(frozen=True, eq=False)
class EngineBench:
    """Everything that all variants have in common."""

    lab: Profile
    """Robot of the lab."""
    improved: Mapping[str, Trajectory]
    """Motion of the improved model on each trajectory."""
    pieces: Mapping[str, Piece]
    """The trajectories."""
    recorded: Profile | None = None
    """Robot of the recording; None without one."""
    sources: Mapping[str, Source] = field(default_factory=dict)
    """Recording with its wheel rates and with its commands as input, by measure."""


def make_engine_bench(lab: Profile, recorded: Profile | None, sources: Mapping[str, Source]) -> EngineBench:
    """Drive the improved model, and return the bench."""
    pieces = {name: open_source(name).pieces[0] for name in SCENARIOS}
    plant, localiser = make_plant(lab, "improved"), lab.plants["improved"].localiser
    improved = {name: drive(plant, piece, localiser, _SAMPLE) for name, piece in pieces.items()}
    return EngineBench(lab, improved, pieces, recorded, sources)


def _given(rates: tuple[float, float], seconds: float) -> Commands:
    return Commands(0.05, np.tile(rates, (round(seconds / 0.05), 1)), "wheels")


class _Trial(Attempts):
    def __init__(self, bench: EngineBench, variant: EngineVariant) -> None:
        super().__init__()
        section = bench.lab.section(variant.group)
        self.bench, self.variant, self.section = bench, variant, section
        self.plant = variant.plant(section.parameters, section.drive)
        self.numbers: Calibration = self.plant.calibration  # type: ignore[attr-defined]
        self.by_heading, self.path = np.full(BINS, np.nan), np.zeros((1, 2))

    def turn(self) -> dict[str, float | None]:
        c, before = self.numbers, ode_library.failures
        began = time.thread_time()
        motion = self.plant.run(_given((-RIM_RATE, RIM_RATE), _SPIN_TIME), State(), _SAMPLE)
        spent, steps = time.thread_time() - began, round(_SPIN_TIME / self.plant.dt)
        tail = motion.t >= _LEAD
        loads, yaw, rate = motion.channels["wheel_load_N"][tail], motion.yaw[tail], motion.twist[tail, 2]
        asked = c.wheel_radius * RIM_RATE / c.half_track
        sector = np.floor(yaw % (2.0 * math.pi) / (2.0 * math.pi) * BINS).astype(int) % BINS
        for k in range(BINS):
            mean = float(rate[sector == k].mean()) if (sector == k).any() else 0.0
            self.by_heading[k] = asked / mean if mean > 1e-3 * asked else np.nan
        known = self.by_heading[np.isfinite(self.by_heading)].tolist()
        self.path = motion.xy[tail] - motion.xy[tail][0]
        weight = c.mass * GRAVITY
        turned = float(yaw[-1] - yaw[0]) / float(motion.t[tail][-1] - motion.t[tail][0])
        share = 1.0 - len(WHEELS) * c.robot.masses.wheel / c.mass
        half = 0.5 * c.robot.geometry.wheel_width if c.wheel_shape == "cylinder" else 0.0
        closed = turn_on_the_spot(
            c.robot.geometry.wheelbase, 2.0 * c.half_track, share * c.com_x, share * c.com_y, half_width=half
        )
        reach = math.hypot(*closed.centre)
        return {
            "multiplier": asked / turned,
            "multiplier_low": min(known, default=None),
            "multiplier_high": max(known, default=None),
            "multiplier_expected": closed.multiplier,
            "wander_m": float(np.hypot(*self.path.T).max()),
            "wander_expected_m": 2.0 * reach,
            "lifted_share": float((loads < LIFT_SHARE * loads.mean(axis=0)).any(axis=1).mean()),
            "load_sum_rms_n": float(np.sqrt(np.mean((loads.sum(axis=1) - weight) ** 2))),
            "gave_up_share": (ode_library.failures - before) / steps,
            "step_s": spent / steps,
        }

    def slope(self) -> dict[str, float]:
        plant = self.variant.plant(self.section.parameters, self.section.drive, Terrain("ramp", slope=_SLOPE))
        speeds = []
        for yaw in (0.0, 0.25 * math.pi):
            motion = plant.run(_given((0.0, 0.0), _STAND), State(yaw=yaw), _SAMPLE)
            half = len(motion) // 2
            speeds.append(float(np.hypot(*(motion.xy[-1] - motion.xy[half]))) / (0.5 * _STAND))
        return {"creep_m_s": max(speeds)}

    def slide(self) -> dict[str, float]:
        heading = 0.5
        start = State(yaw=heading, v_x=_SLIDE * math.cos(heading), v_y=-_SLIDE * math.sin(heading))
        motion = self.plant.run(_given((0.0, 0.0), _SLIDE_TIME), start, _SAMPLE)
        end = motion.xy[-1]
        ideal = _SLIDE**2 / (2.0 * self.numbers.friction * GRAVITY)
        return {"slide_ratio": float(np.hypot(*end)) / ideal, "slide_aside_rad": float(math.atan2(end[1], end[0]))}

    def energy(self) -> dict[str, float]:
        """Compare the motors' power with friction's on a cone at the slips of a slow driven turn."""
        c, drv = self.numbers, self.section.drive
        asked = Commands(0.05, np.tile([0.0, _DRIVEN_RATE], (round(_DRIVEN_TIME / 0.05), 1)))
        motion = self.plant.run(asked, State(), _SAMPLE)
        tail = motion.t >= _DRIVEN_LEAD
        torque, rate, yaw_rate = motion.channels["torque_N_m"][tail], motion.wheels[tail], motion.twist[tail, 2]
        along = c.half_track * yaw_rate - 0.5 * c.wheel_radius * (rate[:, 1] - rate[:, 0])
        slip = np.hypot(along, 0.5 * c.robot.geometry.wheelbase * yaw_rate)
        weight = c.mass * GRAVITY
        dry = (c.rolling_resistance * 0.5 * weight * c.wheel_radius + drv.gear_loss) * np.abs(rate).sum(axis=1)
        taken = float((c.friction * weight * slip + dry).mean())
        return {"energy_error": float((torque * rate).sum(axis=1).mean()) / taken - 1.0}

    def trajectories(self) -> dict[str, Any]:
        b, localiser = self.bench, self.section.localiser
        motions = {name: drive(self.plant, piece, localiser, _SAMPLE) for name, piece in b.pieces.items()}
        fine = self.variant.plant(self.section.parameters, self.section.drive, step=0.5)
        end = drive(fine, b.pieces["traj4"], localiser, _SAMPLE).xy[-1]
        turned = drive(self.plant, replace(b.pieces["traj3"], start=State(yaw=TURNED)), localiser, _SAMPLE)
        surges = [surge_of(m, self.numbers.wheel_radius, self.section.drive) for m in (motions["traj3"], turned)]
        return {
            "surge": max(surges),
            "d_rms_m": {name: compare_paths(motions[name], b.improved[name])["d_rms_m"] for name in SCENARIOS},
            "halving_m": float(np.hypot(*(end - motions["traj4"].xy[-1]))),
        }

    def recording(self) -> dict[str, float]:
        assert self.bench.recorded is not None
        section, found = self.bench.recorded.section(self.variant.group), {}
        plant = self.variant.plant(section.parameters, section.drive)
        for measure, source in self.bench.sources.items():
            motions = [drive(plant, piece, section.localiser, source.sample_dt) for piece in source.pieces]
            found[measure] = horizons_of([(source, motions)], [HORIZON])[HORIZON].position_median_m
        return found


def measure_engine(bench: EngineBench, variant: EngineVariant) -> TriedEngine:
    """Return all measures of a variant.

    Raises:
        ValueError: the engine is missing or cannot have the robot's numbers.
    """
    trial = _Trial(bench, variant)
    trial.attempt("turn on the spot", trial.turn)
    trial.attempt("slope", trial.slope)
    trial.attempt("slide", trial.slide)
    centred = trial.numbers.com_x == trial.numbers.com_y == 0.0 and trial.numbers.wheel_shape != "cylinder"
    if centred:
        trial.attempt("energy", trial.energy)
    trial.attempt("trajectories", trial.trajectories)
    if bench.recorded is not None and variant.scored:
        trial.attempt("recording", trial.recording)
    tried = variant, EngineMeasures(**trial.found), MappingProxyType(trial.failures)
    return TriedEngine(*tried, trial.plant.dt, trial.by_heading, trial.path)
