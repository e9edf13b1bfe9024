"""A controller around any plant of a profile: closed loops, alone and by the hundred, and how well they followed."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from ssmr._jit import config
from ssmr.control.laws import Controller, make_gains
from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.population import Loop, run_loops
from ssmr.control.waypoints import Waypoints
from ssmr.estimation.ekf import EkfSettings
from ssmr.metrics.declared import Metrics, compare_paths
from ssmr.models.linear import matrices
from ssmr.models.table import PLANAR_MODELS
from ssmr.robot.vehicle import Drive
from ssmr.simulation import PlanarModel
from ssmr.types import Trajectory
from validation import store
from validation.plants.profile import PlantProfile, Profile, ProfileError, make_plant
from validation.robots.loops import HuskyLoop, run_husky_loops
from validation.robots.plant import MujocoPlant
from validation.robots.terrain import FLAT, Terrain
from validation.track.gains import GainSet
from validation.track.result import TrackResult

AT_LIMIT = 0.999
"""From this share of a limit on, a torque or a command counts as saturated."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A plant ready to be driven in a closed loop; build once, drive often."""

    name: str
    """Of the plant."""
    body: PlanarModel | MujocoPlant
    """The model, or the simulator."""

    @property
    def drive(self) -> Drive:
        """What stands between command and wheels."""
        return self.body.drive

    @property
    def terrain(self) -> Terrain:
        """What it stands on."""
        return self.body.terrain if isinstance(self.body, MujocoPlant) else FLAT

    @property
    def side_limit(self) -> float:
        """Greatest torque of a side [N m]."""
        return 2.0 * self.drive.torque_limit


def make_robot(profile: Profile, plant: str, terrain: Terrain = FLAT) -> Robot:
    """The plant of that name with the profile's numbers, on a terrain if it is the MuJoCo Husky.

    Raises:
        ProfileError: an unknown name, or numbers that do not go together.
    """
    made = make_plant(profile, plant, terrain)
    p: PlantProfile = profile.plants[plant]
    if isinstance(made, MujocoPlant):
        return Robot(plant, made)
    if plant not in PLANAR_MODELS:
        raise ProfileError(f"plant '{plant}' has no closed loops in populations; ssmr.control.loop.run_loop drives it")
    return Robot(plant, PlanarModel(p.parameters, p.vehicle, p.drive))


def make_controller(profile: Profile, gains: GainSet) -> Controller:
    """The law with these gains; model-based ones are designed on the profile's linear model.

    Raises:
        ValueError: gains that the law refuses.
    """
    linear = profile.plants["linear"]
    a, b = matrices(linear.vehicle, linear.parameters, linear.drive)
    law = Controller(
        make_gains(gains.controller, gains.values), tuple(map(tuple, a.tolist())), tuple(map(tuple, b.tolist()))
    )
    law.packed()
    return law


def odometry_of(drive: Drive) -> EkfSettings:
    """A state filter whose wheel odometry is the driver's own."""
    return EkfSettings(radius=drive.command_radius, half_track=drive.command_half_track)


def run_robots(
    robots: Sequence[Robot],
    controllers: Sequence[Controller],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    seeds: Sequence[int],
    workers: int | None = None,
) -> list[ClosedRun]:
    """Closed loops of one kind of plant along one reference, all at once; loop i gets `seeds[i % len(seeds)]`.

    The result does not depend on `workers`.
    """
    each = list(zip(robots, controllers, settings, strict=True))
    planar = [Loop(r.body, c, s) for r, c, s in each if isinstance(r.body, PlanarModel)]
    huskies = [HuskyLoop(r.body, c, s) for r, c, s in each if isinstance(r.body, MujocoPlant)]
    if planar and huskies:
        raise ValueError("a population is one kind of plant")
    if huskies:
        return run_husky_loops(huskies, waypoints, seeds, workers)
    numba.set_num_threads(min(workers or os.cpu_count() or 1, config.NUMBA_NUM_THREADS))
    return run_loops(planar, waypoints, seeds)


def reference_of(run: ClosedRun, waypoints: Waypoints, *, whole: bool = False) -> Trajectory:
    """The reference at a run's ticks, as far as it came; `whole`: to its end."""
    period = float(run.t[1] - run.t[0]) if len(run.t) > 1 else waypoints.duration
    full = waypoints.trajectory(period)
    return full if whole else _first(full, len(run.t))


def _first(motion: Trajectory, n: int) -> Trajectory:
    return Trajectory(motion.t[:n], motion.pose[:n], motion.twist[:n], motion.wheels[:n])


def rate(run: ClosedRun, waypoints: Waypoints, robot: Robot) -> Metrics:
    """How well a run followed its reference; one that was lost is held against the whole of it all the same."""
    return rate_within(run, waypoints, robot.side_limit, robot.drive.v_max, robot.drive.w_max)


def rate_within(run: ClosedRun, waypoints: Waypoints, side_limit: float, v_max: float, w_max: float) -> Metrics:
    """The same by the limits of a side's torque [N m], of speed [m/s] and of yaw rate [rad/s]."""
    target = reference_of(run, waypoints, whole=True)
    rms = lambda name: float(np.sqrt(np.mean(np.square(run.column(name)))))  # noqa: E731
    torque = np.abs(run.columns("torque_left", "torque_right")) >= AT_LIMIT * side_limit
    asked = (np.abs(run.column("v_cmd")) >= AT_LIMIT * v_max) | (np.abs(run.column("w_cmd")) >= AT_LIMIT * w_max)
    return Metrics(
        {
            **compare_paths(run.motion, target),
            "e_rho_rms_m": rms("e_rho"),
            "e_y_rms_m": rms("e_y"),
            "e_alpha_rms_rad": rms("e_alpha"),
            "u_rms_ratio": rms("v_x") / max(waypoints.speed, 1e-9),
            "saturated_fraction": float(np.mean(torque.any(axis=1) | asked)),
        }
    )


def track(
    robot: Robot,
    profile: Profile,
    gains: GainSet,
    reference: str,
    waypoints: Waypoints,
    settings: LoopSettings,
    seed: int,
    workers: int | None = None,
) -> TrackResult:
    """Let a robot follow a reference.

    Raises:
        LostError: the loop left its bounds.
        ValueError: gains that the law refuses, periods that do not fit the plant's step.
    """
    controller = make_controller(profile, gains)
    began = time.perf_counter()
    (run,) = run_robots([robot], [controller], [settings], waypoints, [seed], workers)
    wall = time.perf_counter() - began
    run.require_kept(f"{controller.name} on {reference} with the plant {robot.name}")
    return TrackResult(
        controller.name,
        gains.name,
        dict(gains.values),
        reference,
        waypoints.speed,
        robot.name,
        profile.name,
        seed,
        run,
        reference_of(run, waypoints),
        rate(run, waypoints, robot),
        wall,
        {
            "feedback": settings.feedback,
            "disturbance": settings.disturbance,
            "lookahead_m": settings.lookahead,
            "side_torque_limit_N_m": robot.side_limit,
            "v_max_m_s": robot.drive.v_max,
            "w_max_rad_s": robot.drive.w_max,
            "position_period_s": settings.position_period,
            "velocity_period_s": settings.velocity_period,
            "terrain": robot.terrain.spec,
        },
        store.versions(),
        robot.terrain,
    )


def require_practicable(waypoints: Waypoints, drive: Drive, what: str) -> None:
    """Refuse a reference that no wheel can follow.

    Raises:
        ValueError: a segment faster than the driver's limit; the message says where.
    """
    speeds = waypoints.segment_speeds
    worst = int(np.argmax(speeds))
    if speeds[worst] > drive.v_max:
        raise ValueError(
            f"{what} asks for {speeds[worst]:.3g} m/s between waypoints {worst + 1} and {worst + 2}; "
            f"the robot's limit is {drive.v_max:g} m/s"
        )
