"""Drive planar models, the MuJoCo robot and trackers as speed, slope, roughness and loss of grip grow.

Without feedback, all plants get the commands of trajectories 1-4. With feedback, trackers follow a reference and know
nothing of the ground. Besides, the loads of the four wheels are compared with formulas through one manoeuvre.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from ssmr.control.loop import LoopSettings
from ssmr.errors import SsmrError
from ssmr.metrics.declared import compare_paths
from ssmr.metrics.poses import horizon_windows, relative_pose_error
from ssmr.robot.loads import static_loads
from ssmr.robot.localiser import Localiser
from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.bench.gains import load_gains
from validation.bench.loops import ClosedLoopRobot, make_controller, make_robot, rate, run_robots
from validation.bench.waypoint_files import open_reference
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile, make_plant
from validation.progress import Progress, Report, silent
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.wheel_loads import with_quasi_static
from validation.study.result import keeping, profile_of
from validation.study.terrain.findings import (
    AXES,
    BASE,
    PLANAR,
    TRACKED,
    AxisName,
    LoadRun,
    ModelErrors,
    TerrainOptions,
    TrackerErrors,
)
from validation.study.terrain.result import TerrainStudy


def study_terrain(
    options: TerrainOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> TerrainStudy:
    """Measure the errors of planar models and trackers as speed, slope, roughness and loss of grip grow.

    Args:
        options: profile, horizon, seeds and values; the defaults if not given.
        workers: number of threads, all processors if not given; the result does not depend on it.
        progress: called after each value of each axis.

    Raises:
        ValueError: the profile does not exist, or its numbers do not fit together.
    """
    o = options or TerrainOptions()
    profile = profile_of(o.profile, o.robot)
    planar = {v: _drive_planar(profile, v) for v in dict.fromkeys((BASE["speed"], *o.axes.speeds))}
    found = list[tuple[list[ModelErrors], list[TrackerErrors]]]()
    with keeping(found) as course, ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        jobs = [
            (axis, value, speed, [pool.submit(_driven, profile, ground, speed) for ground in o.grounds(axis, value)])
            for axis in AXES
            for value in o.axes.values(axis)
            for speed in [value if axis == "speed" else BASE["speed"]]
        ]
        try:
            for k, (axis, value, speed, driven) in enumerate(jobs):
                progress(Progress(k, len(jobs), f"{axis} {AXES[axis][2] * value:g} {AXES[axis][1]}"))
                robots, truths = zip(*(job.result() for job in driven), strict=True)
                modelled = model_errors(axis, value, list(itertools.chain(*truths)), planar[speed], o.horizon)
                found.append((list(modelled), list(_track(profile, axis, value, robots, o, workers))))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    loads = []
    for terrain in (FLAT, Terrain("ramp", slope=math.radians(10.0))):
        robot = make_plant(profile, "mujoco", terrain)
        assert isinstance(robot, MujocoPlant)
        loads.append(LoadRun(terrain, with_quasi_static(robot.run(manoeuvre(), State(), SAMPLE_DT), robot, Localiser())))
    static = static_loads(replace(profile.robot.vehicle, mass=profile.plants["mujoco"].parameters.mass))
    models, trackers = (tuple(itertools.chain(*parts)) for parts in zip(*found, strict=True))
    made = models, trackers, tuple(loads), static
    return TerrainStudy(profile.name, o, *made, robot=profile.robot.name, status=course.status)


def manoeuvre() -> Commands:
    """Return commands that move load about without jolts: speed up, turn left, drive straight, brake, turn on the spot."""
    corners = np.array([
        (0.0, 0.8, 0.0), (3.0, 0.8, 0.0), (4.0, 0.8, 0.6), (7.0, 0.8, 0.6), (8.0, 0.8, 0.0),
        (10.0, 0.8, 0.0), (10.05, 0.0, 0.0), (12.0, 0.0, 0.0), (13.0, 0.0, -0.6), (16.0, 0.0, -0.6),
    ])  # fmt: skip
    t = COMMAND_PERIOD * np.arange(round(corners[-1, 0] / COMMAND_PERIOD))
    return Commands(COMMAND_PERIOD, np.column_stack([np.interp(t, corners[:, 0], c) for c in corners.T[1:]]))


def _commands_at(speed: float) -> list[Commands]:
    """Return trajectories 1-4 at another speed [m/s]."""
    return [replace(scenario, speed=speed).commands() for scenario in TRAJECTORIES.values()]


def _drive_planar(profile: Profile, speed: float) -> dict[str, list[Trajectory]]:
    """Return the planar models' motions on trajectories 1-4; the ground does not change them."""
    made = {name: make_plant(profile, name) for name in PLANAR}
    return {name: [p.run(c, State(), SAMPLE_DT) for c in _commands_at(speed)] for name, p in made.items()}


def _driven(profile: Profile, terrain: Terrain, speed: float) -> tuple[ClosedLoopRobot, list[Trajectory | None]]:
    """Return a MuJoCo robot and its motions on trajectories 1-4.

    A motion is None where the robot fell over or the simulator gave up.
    """
    robot = make_robot(profile, "mujoco", terrain)
    assert isinstance(robot.body, MujocoPlant)
    motions: list[Trajectory | None] = []
    for commands in _commands_at(speed):
        try:
            motions.append(robot.body.run(commands, State(), SAMPLE_DT))
        except SsmrError:
            motions.append(None)
    return robot, motions


def model_errors(
    axis: AxisName,
    value: float,
    truths: Sequence[Trajectory | None],
    planar: Mapping[str, Sequence[Trajectory]],
    horizon: float,
) -> Iterable[ModelErrors]:
    """Yield the errors of each planar model against all runs of the MuJoCo robot at one value.

    Args:
        axis: quantity that grows.
        value: its value [SI].
        truths: the MuJoCo robot's motions, ground by ground, trajectory by trajectory; None for one that failed.
        planar: the models' motions by name, one for each trajectory.
        horizon: time after which relative poses are compared [s].
    """
    failed = sum(truth is None for truth in truths)
    for plant, motions in planar.items():
        position, yaw, distances = list[FloatArray](), list[FloatArray](), list[float]()
        for truth, motion in zip(truths, itertools.cycle(motions), strict=False):
            if truth is not None:
                errors = relative_pose_error(motion.pose, truth.pose, *horizon_windows(truth.t, horizon))
                position.append(errors[0])
                yaw.append(errors[1])
                distances.append(compare_paths(motion, truth)["d_rms_m"])
        if distances:
            medians = float(np.median(np.concatenate(position))), float(np.median(np.concatenate(yaw)))
            yield ModelErrors(axis, value, plant, *medians, float(np.mean(distances)), failed)
        else:
            yield ModelErrors(axis, value, plant, None, None, None, failed)


def _track(
    profile: Profile,
    axis: AxisName,
    value: float,
    robots: Sequence[ClosedLoopRobot],
    options: TerrainOptions,
    workers: int | None,
) -> Iterable[TrackerErrors]:
    """Yield the errors of tuned trackers on the generic reference, with the lab's noise.

    They drive at 0.25 m/s, unless speed is the quantity that grows.
    """
    names = options.axes.controllers
    if not names:
        return
    _, waypoints = open_reference(TRACKED, value if axis == "speed" else 0.25)
    loop = LoopSettings("noisy", filter=odometry_of(robots[0].drive))
    laws = [make_controller(profile, load_gains(name, "tuned")) for name in names]
    n = len(laws)
    runs = [(r, run_robots([r] * n, laws, [loop] * n, waypoints, [options.seed], workers)) for r in robots]
    for k, name in enumerate(names):
        distances = [rate(each[k], waypoints, robot)["d_rms_m"] for robot, each in runs if not each[k].lost]
        yield TrackerErrors(axis, value, name, float(np.mean(distances)) if distances else None, len(runs) - len(distances))
