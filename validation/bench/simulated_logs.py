"""Logs of simulated drives: every sensor has its own rate and noise, and the localiser is late."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorModel, simulate_sensors, tracker_swing
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

_STANDING = 5.0  # time at rest before and after a logged drive [s], in which the gyro's bias shows


@dataclass(frozen=True)
class SensorFaults:
    """Faults of a simulated log, besides the noise of encoders and gyro."""

    gyro_bias: float = -0.0156
    """Reading of the gyro at rest [rad/s]; a real Husky's on tile."""
    pose_std: float = 0.002
    """Standard deviation of the localiser's x and y [m]; motion capture."""
    yaw_std: float = 0.002
    """Standard deviation of the localiser's yaw [rad]."""
    pose_late: float = 0.05
    """Delay of a pose's stamp behind its measurement [s]."""
    missed_left: float = 0.0
    """Share of their ticks that damaged encoders of the left side miss [1] (Sec. 4.5)."""
    missed_right: float = 0.0
    """Share of their ticks that damaged encoders of the right side miss [1] (Sec. 4.5)."""
    swing: float = 0.0
    """Amplitude of an oscillation of the localiser that is no motion of the robot [m] (Sec. 4.5)."""
    swing_hz: float = 1.0
    """Frequency of that oscillation [Hz]."""


def varied() -> Commands:
    """Return a minute of commands for identification: 0.1 to 0.7 m/s, turns to both sides that never repeat; 20 Hz."""
    t = np.arange(round(60.0 / COMMAND_PERIOD)) * COMMAND_PERIOD
    v = 0.4 + 0.3 * np.sin(0.31 * t)
    return Commands(COMMAND_PERIOD, np.column_stack([v, 0.5 * np.sin(0.7 * t) + 0.4 * np.sin(1.9 * t)]))


def log_of_drive(
    path: Path,
    driven: Commands,
    plant: str,
    profile: Profile,
    seed: int,
    faults: SensorFaults | None = None,
    terrain: Terrain = FLAT,
) -> Log:
    """Drive a plant of a profile from the origin, at rest before and after, and log it as `path`.

    `seed` is that of all noise; the log has `SensorFaults()` if no faults are given; `terrain` is for MuJoCo's robot.

    Returns:
        Commands at their own rate, wheels and gyro at 50 Hz, poses of the tracked point at 125 Hz.

    Raises:
        SsmrError: the plant diverged.
    """
    faults = faults or SensorFaults()
    rest = np.zeros((math.ceil(_STANDING / driven.dt), 2))
    commands = Commands(driven.dt, np.concatenate([rest, driven.values, rest]))
    piece = Piece(commands, State(), None, None)
    motion = drive(make_plant(profile, plant, terrain), piece, profile.section(plant).localiser, SAMPLE_DT)
    rng = np.random.default_rng(seed)
    sensors = SensorModel(gyro_bias=faults.gyro_bias, missed_left=faults.missed_left, missed_right=faults.missed_right)
    shown = simulate_sensors(motion, rng, sensors, SAMPLE_RATES_HZ["ekf"])
    pose = motion.pose + rng.standard_normal(motion.pose.shape) * [faults.pose_std, faults.pose_std, faults.yaw_std]
    pose[:, :2] += tracker_swing(motion.t, faults.swing, faults.swing_hz, np.random.default_rng([seed, 1]))
    stamps = np.asarray(np.arange(len(commands.values)) * commands.dt, dtype=np.float64)
    groups = {
        "cmd": Group("commands", stamps, dict(zip(COMMAND_COLUMNS["twist"], commands.values.T, strict=True))),
        "wheels": Group("encoders", shown.t, {"enc_left": shown.left, "enc_right": shown.right}),
        "imu": Group("gyro", shown.t, {"gyro_z": shown.gyro}),
        "pose": Group("localiser", motion.t + faults.pose_late, dict(zip(POSE_COLUMNS, pose.T, strict=True))),
    }
    return Log(path, groups)


def open_log(
    source: str | Path,
    options: ReadOptions | None = None,
    profile: str | Path | Profile | None = None,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
    faults: SensorFaults | None = None,
) -> Log:
    """Read a log with its options, or drive a plant and log it, see `log_of_drive`.

    Args:
        source: path of a log, or a drive to be simulated: traj1 to traj4 or varied, with @ and a plant (mujoco if none is
            named).
        options: choices for logs with topics; all guessed if not given.
        profile: profile of the plant that is driven; None for `thesis-lab`, or the robot's own numbers if that is of another
            robot than `robot`.
        seed: seed of its sensors' noise.
        robot: the robot that is driven; None for that of the profile.
        faults: faults of its log.

    Raises:
        ValueError: the log cannot be opened, there is no such plant, or the seed is negative.
        SsmrError: the plant diverged.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} must not be negative")
    scenario, _, plant = str(source).partition("@")
    if scenario not in (*TRAJECTORIES, "varied"):
        return read_log(source, options)
    if (plant or STANDARD) not in ALL_PLANTS:
        raise ValueError(f"no plant '{plant}' in '{source}'; there are: {', '.join(ALL_PLANTS)}")
    commands = TRAJECTORIES[scenario].commands() if scenario in TRAJECTORIES else varied()
    used = choose_profile(profile, robot, "thesis-lab")
    return log_of_drive(Path(source), commands, plant or STANDARD, used, seed, faults)
