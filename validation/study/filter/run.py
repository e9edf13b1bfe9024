"""Drive MuJoCo robots on several grounds, and let state filters estimate the pose from simulated sensors.

A regulator that sees the true state keeps the robot on the reference, and the filters only listen. Distance and turns are
therefore the same on every ground, if every robot can follow the reference, and between seeds nothing differs but the
sensors' noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import cast

import numpy as np

from ssmr.control.loop import ClosedRun, Feedback, LoopSettings, make_clock
from ssmr.control.waypoints import Waypoints
from ssmr.estimation.ekf import run_ekf
from ssmr.estimation.settings import EkfSettings, zeroed
from ssmr.geometry import travelled
from ssmr.robot.sensors import SensorModel, gyro_at_rest, simulate_sensors
from ssmr.types import State, Trajectory
from validation.bench.commissioning import TRACKER, commissioned
from validation.bench.gains import DEFAULT, load_gains
from validation.bench.loops import make_controller, require_practicable, run_robots
from validation.bench.waypoint_files import open_reference
from validation.progress import Progress, Report, silent
from validation.study.filter.doubt import Doubt, doubt_of
from validation.study.filter.findings import (
    CURVE,
    DRIFT_STRETCH,
    FilterGround,
    FilterOptions,
    GroundDrive,
    VariantDrift,
    drift_of,
    filter_variants,
    grounds_of,
)
from validation.study.filter.result import FilterStudy
from validation.study.result import keeping, profile_of

USUAL_PROFILES = ("thesis-lab", "husky-tile")
"""Profiles whose grounds are driven if none is named."""
_TICK = 0.01
"""Period of the tracker, and of the truth's samples [s]: two of them are the filter's 20 ms."""


def study_filter(
    options: FilterOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> FilterStudy:
    """Measure the drift of dead reckoning on several grounds, with several sensors.

    Args:
        options: references, profiles, frictions, noise; the defaults if not given.
        workers: number of threads, all processors if not given; the result does not depend on it.
        progress: called after each drive.

    Raises:
        LostError: a robot left the reference.
        ValueError: a profile or a reference cannot be read, or numbers do not go together.
    """
    o = options or FilterOptions()
    usual = [profile_of(None, o.robot, name) for name in USUAL_PROFILES] if not o.profiles else []
    chosen = {profile.name: profile for profile in (*(profile_of(name, o.robot) for name in o.profiles), *usual)}
    grounds = grounds_of(list(chosen.values()), o.frictions)
    missions = dict(open_reference(name, o.speed) for name in o.references)
    return drive_missions(grounds, missions, o, workers=workers, progress=progress)


def drive_missions(
    grounds: Sequence[FilterGround],
    missions: Mapping[str, Waypoints],
    options: FilterOptions,
    *,
    workers: int | None = None,
    progress: Report = silent,
) -> FilterStudy:
    """Make the study with these grounds and references, of one speed, in place of those of the options."""
    loop = LoopSettings("truth", disturbance=False, position_period=_TICK)
    robots = [g.robot(options.timestep) for g in grounds]
    for name, waypoints in missions.items():
        make_clock(waypoints, loop, options.timestep)
        for robot in robots:
            require_practicable(waypoints, robot.drive, name)
        if waypoints.speed * waypoints.duration < 1.1 * DRIFT_STRETCH:
            raise ValueError(f"{name} is shorter than the {DRIFT_STRETCH:g} m over which drift is taken, with some to spare")
    tracker = load_gains(TRACKER, DEFAULT)
    laws = [make_controller(g.profile, tracker) for g in grounds]
    of_name = {g.profile.name: g.profile for g in grounds}
    cases = [(p, plant, seen) for p in of_name.values() for plant in options.plants for seen in options.feedbacks]
    drives, doubts, steps = list[GroundDrive](), list[Doubt](), len(grounds) * len(missions) + len(cases)
    with keeping(drives) as course:
        known = {name: commissioned(profile, "mujoco") for name, profile in of_name.items()}
        for name, waypoints in missions.items():
            runs = list[ClosedRun]()
            for profile in of_name.values():  # robots of one profile are one kind
                kind = [k for k, g in enumerate(grounds) if g.profile is profile]
                of_kind = [robots[k] for k in kind], [laws[k] for k in kind], [loop] * len(kind)
                runs += run_robots(*of_kind, waypoints, [0], workers)
            for ground, run in zip(grounds, runs, strict=True):
                truth = run.require_kept(f"{TRACKER} on {name}, {ground.name},").motion
                drives.append(_estimate(ground, name, truth, options, known[ground.profile.name]))
                progress(Progress(len(drives), steps, f"{name}, {ground.name}"))
        for profile, plant, seen in cases:
            doubts.append(doubt_of(profile, plant, cast(Feedback, seen), options.runs, options.seed, workers))
            progress(Progress(len(drives) + len(doubts), steps, f"{plant} of {profile.name}, {seen}"))
    speed = next(iter(missions.values())).speed
    references = tuple(dict.fromkeys(drive.reference for drive in drives))
    studied = ", ".join(dict.fromkeys(ground.profile.robot.name for ground in grounds))
    return FilterStudy(
        tuple(grounds), references, speed, options, tuple(drives), tuple(doubts), robot=studied, status=course.status
    )


def _estimate(
    ground: FilterGround, reference: str, truth: Trajectory, options: FilterOptions, known: EkfSettings
) -> GroundDrive:
    """Return the errors of all filters with all draws of the noise along one drive."""
    along, filters = travelled(truth.xy), {}
    (x, y, yaw), (v, _, w) = truth.pose[0].tolist(), truth.twist[0].tolist()
    start = State(x, y, yaw, v_x=v, yaw_rate=w)
    for variant in filter_variants(options.bias):
        drifts, errors = [], []
        for k in range(options.seeds):
            rng = np.random.default_rng([options.seed, k])
            sensors = SensorModel(gyro_bias=variant.bias)
            log = simulate_sensors(truth, rng, sensors)
            settings = zeroed(ground.filter_settings(variant, known), gyro_at_rest(sensors.packed(), rng, options.stands))
            gyro = log.gyro if variant.gyro else None
            believed = run_ekf(log.t, log.left, log.right, gyro, settings, start)
            seen = np.searchsorted(truth.t, log.t - 1e-9)
            then = Trajectory(truth.t[seen], truth.pose[seen], truth.twist[seen], truth.wheels[seen])
            drifts.append(drift_of(believed, then))
            off = np.hypot(*(believed.xy - then.xy).T)
            errors.append(np.interp(np.linspace(0.0, along[-1], CURVE), along[seen], off))
        filters[variant.name] = VariantDrift(tuple(drifts), np.array(errors))
    slide = math.sqrt(np.mean(np.square(truth.twist[:, 1])) / np.mean(np.square(truth.twist[:, 0])))
    turned = float(np.abs(np.diff(truth.pose[:, 2])).sum())
    return GroundDrive(ground.name, reference, float(along[-1]), turned, slide, MappingProxyType(filters))
