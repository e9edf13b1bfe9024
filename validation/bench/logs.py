"""Logs of simulated drives, and logs by their paths."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorModel, simulate_sensors
from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State
from validation.bench.sources import Piece, drive
from validation.files.formats import read_log
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Group, Log, ReadOptions
from validation.plants.profile import Profile, choose_profile, make_plant
from validation.plants.table import ALL_PLANTS, STANDARD
from validation.simulator.description import Robot
from validation.simulator.terrain import FLAT, Terrain

GYRO_BIAS = -0.0156
"""Reading of the gyro of simulated logs at rest [rad/s]; a real Husky's on tile."""
POSE_STD, YAW_STD = 0.002, 0.002
"""Standard deviations of their localiser's x and y [m] and yaw [rad]; motion capture."""
POSE_LATE = 0.05
"""Delay of their poses' stamps behind the measurements [s]."""
_REST = 5.0  # time at rest before and after a logged drive [s], in which the gyro's bias shows


def varied() -> Commands:
    """Return a minute of commands for identification: 0.1 to 0.7 m/s, turns to both sides that never repeat; 20 Hz."""
    t = np.arange(round(60.0 / COMMAND_PERIOD)) * COMMAND_PERIOD
    v = 0.4 + 0.3 * np.sin(0.31 * t)
    return Commands(COMMAND_PERIOD, np.column_stack([v, 0.5 * np.sin(0.7 * t) + 0.4 * np.sin(1.9 * t)]))


def log_of_drive(path: Path, driven: Commands, plant: str, profile: Profile, seed: int, terrain: Terrain = FLAT) -> Log:
    """Drive a plant of a profile from the origin, at rest before and after, and log it as `path`.

    `seed` is that of all noise; `terrain` is for MuJoCo's robot.

    Returns:
        Commands at their own rate, wheels and gyro at 50 Hz, poses of the tracked point at 125 Hz.

    Raises:
        SsmrError: the plant diverged.
    """
    rest = np.zeros((math.ceil(_REST / driven.dt), 2))
    commands = Commands(driven.dt, np.concatenate([rest, driven.values, rest]))
    piece = Piece(commands, State(), None, None)
    motion = drive(make_plant(profile, plant, terrain), piece, profile.section(plant).localiser, SAMPLE_DT)
    rng = np.random.default_rng(seed)
    shown = simulate_sensors(motion, rng, SensorModel(gyro_bias=GYRO_BIAS), SAMPLE_RATES_HZ["ekf"])
    pose = motion.pose + rng.standard_normal(motion.pose.shape) * [POSE_STD, POSE_STD, YAW_STD]
    stamps = np.asarray(np.arange(len(commands.values)) * commands.dt, dtype=np.float64)
    groups = {
        "cmd": Group("commands", stamps, dict(zip(COMMAND_COLUMNS["twist"], commands.values.T, strict=True))),
        "wheels": Group("encoders", shown.t, {"enc_left": shown.left, "enc_right": shown.right}),
        "imu": Group("gyro", shown.t, {"gyro_z": shown.gyro}),
        "pose": Group("localiser", motion.t + POSE_LATE, dict(zip(POSE_COLUMNS, pose.T, strict=True))),
    }
    return Log(path, groups)


def open_log(
    name: str | Path,
    options: ReadOptions | None = None,
    profile: str | Path | Profile | None = None,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
) -> Log:
    """Read a log with its options, or drive a plant and log it, see `log_of_drive`.

    Args:
        name: path of a log, or a drive to be simulated: traj1 to traj4 or varied, with @ and a plant (mujoco if none is
            named).
        options: choices for logs with topics; all guessed if not given.
        profile: profile of the plant that is driven; None for `thesis-lab`, or the robot's own numbers if that is of another
            robot than `robot`.
        seed: seed of its sensors' noise.
        robot: the robot that is driven; None for that of the profile.

    Raises:
        ValueError: the log cannot be opened, there is no such plant, or the seed is negative.
        SsmrError: the plant diverged.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} must not be negative")
    scenario, _, plant = str(name).partition("@")
    if scenario not in (*TRAJECTORIES, "varied"):
        return read_log(name, options)
    if (plant or STANDARD) not in ALL_PLANTS:
        raise ValueError(f"no plant '{plant}' in '{name}'; there are: {', '.join(ALL_PLANTS)}")
    commands = TRAJECTORIES[scenario].commands() if scenario in TRAJECTORIES else varied()
    return log_of_drive(Path(name), commands, plant or STANDARD, choose_profile(profile, robot, "thesis-lab"), seed)
