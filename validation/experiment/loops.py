"""Closed loops around any plant of a profile, alone and by the hundred."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ssmr.control.laws import AnyController, design
from ssmr.control.loop import ClosedRun, LoopSettings, run_loop
from ssmr.control.mission import PythonController
from ssmr.control.population import Bodies, run_bodies, run_loops
from ssmr.control.waypoints import Waypoints
from ssmr.models.four_wheel_plant import FourWheelBodies, FourWheelPlant
from ssmr.models.linear import matrices
from ssmr.robot.vehicle import Drive
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, Plant, State
from validation.descriptions.own_plant import OwnPlant
from validation.engines.plant import EnginePlant
from validation.experiment.gains import GainSet, load_gains
from validation.experiment.user_law import is_user_law, load_user_law
from validation.output import shortened
from validation.plants.profile import Profile, make_plant
from validation.simulator.loops import MujocoBodies
from validation.simulator.parts import mujoco_failures
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.workers import threads_of

_SECONDS = 6.0
"""Time for which a command is driven [s]."""
_LAST = 1.0
"""Last part of that time, over which the motion is averaged [s]."""
_SAMPLE_DT = 0.05
"""Time between two samples of the motion [s]."""
_EASY_TURN = 0.25
"""Share of the greatest yaw rate up to which a reference asks for so little that nothing is
measured."""
_EASY_SPEED = 0.8
"""Share of the greatest speed up to which nothing is measured either."""


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


def make_robot(profile: Profile, plant: str, terrain: Terrain = FLAT) -> ClosedLoopRobot:
    """Return the plant of that name with the profile's numbers; only MuJoCo has a terrain.

    Raises:
        ValueError: an unknown name, or numbers that do not go together.
    """
    body = make_plant(profile, plant, terrain)
    if isinstance(body, MujocoPlant | FourWheelPlant | EnginePlant | OwnPlant):
        return ClosedLoopRobot(plant, body)
    section = profile.section(plant)
    return ClosedLoopRobot(plant, PlanarModel(section.parameters, section.vehicle, section.drive))


def make_controller(profile: Profile, gains: GainSet) -> AnyController:
    """Return the controller with these gains, designed on the profile's linear model.

    Raises:
        ValueError: the gains are refused.
    """
    linear = profile.plants["linear"]
    a, b = matrices(linear.vehicle, linear.parameters, linear.drive)
    return design(gains.controller, gains.values, a, b, linear.drive)


def controller_and_reference(controller: Any, reference: Any, own: str | None) -> tuple[Any, Any]:
    """Return controller and reference of a program's options.

    They are both given, or a controller of the user's `own` stands beside them; then the only
    other one is the reference.

    Raises:
        ValueError: one of the two is missing, or there are two controllers.
    """
    first = shortened(controller, 40)
    if own is None and reference is None:
        raise ValueError(f"'{first}' stands alone; wanted a controller and a reference")
    if own is None:
        return controller, reference
    if reference is not None:
        second = shortened(own, 60)
        raise ValueError(f"there are two controllers, '{first}' and --controller {second}")
    return own, controller


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
        law = load_user_law(controller)
        linear = profile.plants["linear"]
        system = matrices(linear.vehicle, linear.parameters, linear.drive)
        a, b = (tuple(map(tuple, m.tolist())) for m in system)
        return PythonController(law.name, law, a, b, linear.drive), None
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
    planar = [r.body for r in robots if isinstance(r.body, PlanarModel)]
    simulated = [r.body for r in robots if isinstance(r.body, MujocoPlant)]
    tyred = [r.body for r in robots if isinstance(r.body, FourWheelPlant)]
    others = [r.body for r in robots if isinstance(r.body, EnginePlant | OwnPlant)]
    if len(robots) not in (len(planar), len(simulated), len(tyred), len(others)):
        raise ValueError("a population is one kind of plant")
    if others:
        # they have no compiled population: the slow loop drives one after another
        return [
            run_loop(body, law, waypoints, how, seeds[i % len(seeds)], start)
            for i, (body, law, how) in enumerate(zip(others, designed, settings, strict=True))
        ]
    make: Callable[[State], Bodies]
    if simulated:
        make = partial(MujocoBodies, simulated, threads)
        drives = [plant.drive for plant in simulated]
        dt = simulated[0].dt
    elif tyred:
        make = partial(FourWheelBodies, tyred)
        drives = [plant.drive for plant in tyred]
        dt = tyred[0].dt
    else:
        return run_loops(planar, designed, settings, waypoints, seeds, start=start, workers=threads)
    return run_bodies(
        make, drives, dt, designed, settings, waypoints=waypoints, seeds=seeds, start=start
    )


# ------------------------------------------------------------------------------------------
# demands of a reference
def require_practicable(waypoints: Waypoints, drive: Drive, what: str) -> None:
    """Raise a ValueError for a reference with a segment that is faster than the driver's limit."""
    speeds = waypoints.segment_speeds
    worst = int(np.argmax(speeds))
    if speeds[worst] > drive.v_max:
        demand = f"{what} asks for {speeds[worst]:.3g} m/s"
        raise ValueError(
            f"{demand} between waypoints {worst + 1} and {worst + 2}; "
            f"the robot's limit is {drive.v_max:g} m/s"
        )


def settled_motion(plant: Plant, v: float, w: float) -> tuple[float, float]:
    """Return the speed [m/s] and yaw rate [rad/s] of a plant after some seconds of commands.

    The plant is reset first.
    """
    n = round(_SECONDS / _SAMPLE_DT)
    commands = Commands(_SAMPLE_DT, np.tile([v, w], (n, 1)))
    motion = plant.run(commands, State(), _SAMPLE_DT)
    last = motion.twist[-round(_LAST / _SAMPLE_DT) :]
    return float(np.mean(last[:, 0])), float(np.mean(last[:, 2]))


def _possible(waypoints: Waypoints, robot: ClosedLoopRobot, part: float) -> tuple[float, list[str]]:
    """Return the speed [m/s] at which a robot can follow a reference, and the demands beyond it.

    The robot may use `part` of its greatest speed and yaw rate.
    """
    plant = robot.plant
    v_max = robot.drive.v_max
    w_max = robot.drive.w_max
    course = waypoints.course()
    k = int(np.argmax(np.abs(course["w"])))
    w = float(course["w"][k])
    turn = abs(w)
    fastest = float(np.max(waypoints.segment_speeds))
    share = 1.0
    demands = []
    if turn > _EASY_TURN * w_max and math.isfinite(w_max):
        v = float(course["v"][k])
        possible = abs(settled_motion(plant, v, math.copysign(w_max, w))[1])
        if turn > part * possible:
            share = min(share, part * possible / turn)
            demands.append(
                f"a yaw rate of {turn:.2f} rad/s where {possible:.2f} rad/s are possible"
            )
    if fastest > _EASY_SPEED * v_max:
        possible = settled_motion(plant, v_max, 0.0)[0]
        if fastest > part * possible:
            share = min(share, part * possible / fastest)
            demands.append(f"{fastest:.2f} m/s where {possible:.2f} m/s are possible")
    return math.floor(100.0 * share * waypoints.speed) / 100.0, demands


def demand_of(waypoints: Waypoints, robot: ClosedLoopRobot, profile: str, what: str) -> str | None:
    """Return a sentence on a reference that asks for more than the robot can do; else None.

    `profile` and `what` name the robot's profile and the reference in the sentence.
    """
    speed, demands = _possible(waypoints, robot, 1.0)
    if not demands:
        return None
    demand = (
        f"{what} at {waypoints.speed:.3g} m/s asks {robot.name} of {profile} "
        f"for {' and '.join(demands)}"
    )
    return f"{demand}; at {speed:.2f} m/s it could be followed."


def slowed_to_feasible(waypoints: Waypoints, robot: ClosedLoopRobot, part: float) -> Waypoints:
    """Return the reference, slowed to `part` of the robot's greatest speed and yaw rate."""
    speed, demands = _possible(waypoints, robot, part)
    if not demands:
        return waypoints
    return waypoints.at_speed(speed)
