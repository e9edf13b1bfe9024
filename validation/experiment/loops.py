"""Closed loops around any plant of a profile, alone and by the hundred."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ssmr.control.feasible import (
    DEVIATION,
    MotionLimits,
    make_feasible,
    require_manoeuvres,
    turn_in_waits,
)
from ssmr.control.law import SPOT_TURN, Law
from ssmr.control.laws import AnyController, design_controller
from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.mission import PythonController
from ssmr.control.population import run_bodies, run_loops
from ssmr.control.waypoints import Waypoints
from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.models.linear import state_space_matrices
from ssmr.robot.vehicle import Drive
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, Plant, State
from validation.descriptions.own_plant import OwnPlant
from validation.engines.plant import EnginePlant
from validation.experiment.gains import GainSet, load_gains
from validation.experiment.user_law import is_user_law, load_user_law
from validation.experiment.waypoint_files import REFERENCES, open_reference, split_speed
from validation.plants.profile import Profile, make_plant
from validation.simulator.parts import mujoco_failures
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.workers import threads_of

_SECONDS = 6.0
"""Time for which a command is driven [s]."""
_LAST = 1.0
"""Last part of that time, over which the motion is averaged [s]."""
_SAMPLE_DT = 0.01
"""Time between two samples of the motion [s]."""
_EASY_TURN = 0.25
"""Share of the greatest yaw rate up to which a reference asks for so little that nothing is
measured."""
_EASY_SPEED = 0.8
"""Share of the greatest speed up to which nothing is measured either."""
_AS_FAST = 0.98
"""Share of a reference's mean speed from which a feasible path counts as fast as it is."""
JUDGE = "mujoco"
"""Plant that stands for the robot where controllers and gains are judged."""
_PRACTICABLE = 0.9
"""Share of the robot's greatest motion that a path may ask for; what is left is for corrections."""


@dataclass(frozen=True, eq=False)
class ClosedLoopRobot:
    """A plant that is built and can be driven in closed loops any number of times."""

    name: str
    """Name of the plant."""
    body: PlanarModel | FourWheelPlant | MujocoPlant | EnginePlant | OwnPlant
    """The planar model, or the robot itself."""
    known: Drive | None = None
    """The drive as controllers know it, where that is not the robot's own."""

    @property
    def drive(self) -> Drive:
        """The drive between command and wheels."""
        return self.body.drive

    @property
    def plant(self) -> Plant:
        """A plant of this model, or the robot itself."""
        return PlanarPlant(self.body) if isinstance(self.body, PlanarModel) else self.body

    @property
    def terrain(self) -> Terrain:
        """The ground of a MuJoCo robot; flat for a planar model."""
        return self.body.terrain if isinstance(self.body, MujocoPlant) else FLAT

    @property
    def limits(self) -> dict[str, float]:
        """Limits of torque and command, by their names among the options of a result."""
        return {
            "side_torque_limit_N_m": 2.0 * self.drive.torque_limit,
            "v_max_m_s": self.drive.v_max,
            "w_max_rad_s": self.drive.w_max,
        }


def make_robot(
    profile: Profile, plant: str, terrain: Terrain = FLAT, late: float = 0.0
) -> ClosedLoopRobot:
    """Return the plant of that name with the profile's numbers; only MuJoCo has a terrain.

    It acts on commands `late` [s] later than controllers know.

    Raises:
        ValueError: an unknown name, or numbers that do not go together.
    """
    robot = make_plant(profile, plant, terrain, late=late)
    if isinstance(robot, MujocoPlant | FourWheelPlant | EnginePlant | OwnPlant):
        return ClosedLoopRobot(plant, robot, robot.drive.later(-late))
    section = profile.section(plant)
    body = PlanarModel(section.parameters, section.vehicle, section.drive.later(late))
    return ClosedLoopRobot(plant, body, section.drive)


def make_controller(profile: Profile, gains: GainSet) -> AnyController:
    """Return the controller with these gains, designed on the profile's linear model.

    Raises:
        ValueError: the gains are refused.
    """
    linear = profile.plants["linear"]
    a, b = state_space_matrices(linear.vehicle, linear.parameters, linear.drive)
    return design_controller(gains.controller, gains.values, a, b, linear.drive)


def chosen_controller(
    controller: str | type, profile: Profile, gains: GainSet | str | Path | None = None
) -> tuple[AnyController, GainSet | None]:
    """Return a controller and its gains, by its name, a user's class, or `FILE.py:NAME`.

    A user's class has no gains.

    Raises:
        ValueError: there is no such controller, file, class or set of gains, or they do not go
            together.
    """
    if isinstance(controller, type) or is_user_law(controller):
        if gains is not None:
            raise ValueError(f"gains are for the shipped controllers; {controller} brings its own")
        name, make, manoeuvres = load_user_law(controller)
        linear = profile.plants["linear"]
        system = state_space_matrices(linear.vehicle, linear.parameters, linear.drive)
        a, b = (tuple(map(tuple, m.tolist())) for m in system)
        return PythonController(name, make, a, b, linear.drive, manoeuvres), None
    if not isinstance(gains, GainSet):
        gains = load_gains(controller, str(gains) if gains else None, profile.name)
    if gains.controller != controller:
        raise ValueError(f"gains belong to {gains.controller}, wanted {controller}")
    return make_controller(profile, gains), gains


@mujoco_failures()
def run_robots(
    robots: Sequence[ClosedLoopRobot],
    controllers: Sequence[AnyController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    seeds: Sequence[int],
    workers: int | str | None = None,
    start: State | None = None,
) -> list[ClosedRun]:
    """Run closed loops of one kind of plant along one reference, all at once.

    Args:
        robots: S robots; several may be the same.
        controllers: S controllers; each gets the drive of its robot, as far as it is known.
        settings: S settings.
        waypoints: the reference.
        seeds: seeds of noise and disturbance; loop i gets `seeds[i % len(seeds)]`.
        workers: threads, see `threads_of`; the result does not depend on it.
        start: state to start in; at rest at the first waypoint if not given.

    Raises:
        ValueError: several kinds of plant in one population, or settings that do not go together.
    """
    designed = [c.on(r.known or r.drive) for r, c in zip(robots, controllers, strict=True)]
    threads = threads_of(workers)
    bodies: list[Any] = [r.body for r in robots]
    if len({type(body) for body in bodies}) != 1:
        raise ValueError("a population is one kind of plant")
    first = bodies[0]
    if isinstance(first, PlanarModel):
        return run_loops(bodies, designed, settings, waypoints, seeds, start=start, workers=threads)
    return run_bodies(
        partial(first.make_bodies, bodies, workers=threads),
        [body.drive for body in bodies],
        first.dt,
        designed,
        settings,
        waypoints=waypoints,
        seeds=seeds,
        start=start,
    )


# ------------------------------------------------------------------------------------------
# demands of a reference
def _step_response(plant: Plant, v: float, w: float, column: int) -> tuple[float, float]:
    """Return the motion that a step of the command settles at, and how fast it gets there.

    The plant is reset first. The mean rate is that from a quarter to three quarters of the way.

    Args:
        plant: the robot.
        v: commanded speed [m/s].
        w: commanded yaw rate [rad/s].
        column: 0 for the speed [m/s; m/s^2], 2 for the yaw rate [rad/s; rad/s^2].
    """
    commands = Commands(_SAMPLE_DT, np.tile([v, w], (round(_SECONDS / _SAMPLE_DT), 1)))
    motion = plant.run(commands, State(), _SAMPLE_DT).twist[:, column]
    settled = float(np.mean(motion[-round(_LAST / _SAMPLE_DT) :]))
    share = motion / settled if settled else motion
    ticks = max(1, int(np.argmax(share > 0.75)) - int(np.argmax(share > 0.25)))
    return settled, 0.5 * settled / (ticks * _SAMPLE_DT)


def _greatest_turn(drive: Drive, speed: float) -> float:
    """Return the greatest yaw-rate command [rad/s] on a path that is driven at a speed [m/s].

    A driver without a limit turns its wheels no faster than they roll there.
    """
    if math.isfinite(drive.w_max):
        return drive.w_max
    return min(speed, drive.v_max) / drive.command_half_track


def limits_of(robots: Sequence[ClosedLoopRobot], speed: float, part: float = 1.0) -> MotionLimits:
    """Return `part` of the motion that all of these robots can do, from steps of their commands.

    Turning is measured at a quarter of the `speed` [m/s] of a path: tight bends are driven slowly.
    Where a driver has no limit of speed the motion has none.
    """
    limits = MotionLimits(*(math.inf,) * 4)
    for robot in robots:
        drive = robot.drive
        able = list(limits)
        if math.isfinite(drive.v_max):
            straight = _step_response(robot.plant, drive.v_max, 0.0, 0)
            able[0] = min(able[0], part * straight[0])
            able[2] = min(able[2], part * straight[1])
        v = 0.25 * min(speed, drive.v_max)
        most = _greatest_turn(drive, speed)
        for w in (most, -most):
            turn = _step_response(robot.plant, v, w, 2)
            able[1] = min(able[1], part * abs(turn[0]))
            able[3] = min(able[3], part * abs(turn[1]))
        limits = MotionLimits(*able)
    return limits


def demand_of(waypoints: Waypoints, robot: ClosedLoopRobot, profile: str, what: str) -> str | None:
    """Return a sentence on a reference that asks for more than the robot can do; else None.

    `profile` and `what` name the robot's profile and the reference in the sentence.
    """
    drive = robot.drive
    turn = _EASY_TURN * _greatest_turn(drive, waypoints.speed)
    gentle = MotionLimits(_EASY_SPEED * drive.v_max, turn, math.inf, math.inf)
    if _keeps_speed(waypoints, make_feasible(waypoints, gentle, at_rest=False)):
        return None
    limits = limits_of([robot], waypoints.speed)
    slowed = make_feasible(waypoints, limits, at_rest=False)
    if _keeps_speed(waypoints, slowed):
        return None
    return (
        f"{what} at {waypoints.speed:.3g} m/s asks {robot.name} of {profile} for more than "
        f"{limits.speed:.2f} m/s, {limits.yaw_rate:.2f} rad/s or {limits.yaw_acceleration:.2f} "
        f"rad/s^2, which it can do; slowed where it must be, it takes {slowed.duration:.1f} s "
        f"instead of {waypoints.duration:.1f} s."
    )


def _keeps_speed(waypoints: Waypoints, slowed: Waypoints) -> bool:
    """Return whether a feasible path is as fast as the reference that it was made from.

    It also waits no longer, for turns on the spot.
    """
    waits, asked = (path.duration - path.length / path.speed for path in (slowed, waypoints))
    return slowed.speed > _AS_FAST * waypoints.speed and waits < asked + _SAMPLE_DT


def slowed_to_feasible(waypoints: Waypoints, robot: ClosedLoopRobot) -> Waypoints:
    """Return the reference as `_PRACTICABLE` of the robot's motion can follow it.

    It is the reference itself where that is not too fast.
    """
    limits = limits_of([robot], waypoints.speed, _PRACTICABLE)
    if _keeps_speed(waypoints, make_feasible(waypoints, limits, at_rest=False)):
        return waypoints
    return make_feasible(waypoints, limits)


def open_path(
    reference: str | Waypoints,
    speed: float | None,
    robots: Sequence[ClosedLoopRobot],
    law: Law | AnyController,
) -> tuple[str, Waypoints, list[str]]:
    """Return name and waypoints of a reference, see `open_reference`, and sentences on them.

    The `law` is asked whether it can follow them.

    Waypoints or a file that are given a speed [m/s] are a path without times: it becomes what
    `_PRACTICABLE` of the motion of all the robots can follow. A reference that has a name, and
    waypoints that keep their times, stay as they are, but for turns on the spot: these are made in
    their waits, which may become longer.

    Raises:
        ValueError: as `open_reference`; a segment is faster than a driver's limit; or the law
            cannot follow the path.
    """
    if isinstance(reference, Waypoints):
        label = "waypoints"
        waypoints = reference
        name = label
        if speed is not None:
            waypoints = reference.at_speed(speed)
    else:
        label, waypoints = open_reference(reference, speed)
        name, named_speed = split_speed(reference)
        speed = named_speed if speed is None else speed
    try:
        manoeuvres = require_manoeuvres(waypoints, law)
    except ValueError as error:
        raise ValueError(f"{label}: {error}") from error
    if name in REFERENCES or speed is None:
        k = np.argmax(waypoints.segment_speeds)
        asked = waypoints.segment_speeds[k]
        able = min(robot.drive.v_max for robot in robots)
        if asked > able:
            raise ValueError(
                f"{label} asks for {asked:.3g} m/s between waypoints {k + 1} and {k + 2}; "
                f"the robot's limit is {able:g} m/s"
            )
        if SPOT_TURN not in manoeuvres:
            return label, waypoints, []
        asked = waypoints.duration
        waypoints = turn_in_waits(waypoints, limits_of(robots, waypoints.speed, _PRACTICABLE))
        if waypoints.duration < asked + _SAMPLE_DT:
            return label, waypoints, []
        longer = f"{waypoints.duration:.1f} s instead of {asked:.1f} s"
        return label, waypoints, [f"{label} takes {longer}, because it turns on the spot."]
    limits = limits_of(robots, speed, _PRACTICABLE)
    path = make_feasible(waypoints, limits)
    sentence = (
        f"{label} is driven in {path.duration:.1f} s, from rest to rest, at up to {speed:.3g} m/s: "
        f"its corners are rounded by at most {1e3 * DEVIATION:.0f} mm and driven within "
        f"{limits.yaw_rate:.2f} rad/s."
    )
    return label, path, [sentence]
