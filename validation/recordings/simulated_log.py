"""Logs of simulated drives: every sensor has its own rate and noise, and the localiser is late."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorModel, simulate_sensors, tracker_swing
from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State
from validation.logs.groups import Group
from validation.logs.recording import POSE_COLUMNS
from validation.motion.driving import drive
from validation.motion.sources import Piece
from validation.plants.profile import Profile, make_plant
from validation.plants.table import ALL_PLANTS, STANDARD
from validation.simulator.terrain import FLAT, Terrain

_STANDING = 5.0
"""Time at rest before and after a logged drive [s], in which the gyro's bias shows."""


@dataclass(frozen=True)
class LogSettings:
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


def scenarios() -> Mapping[str, Commands]:
    """Return the commands that can be driven, by name."""
    return {**{name: made.commands() for name, made in TRAJECTORIES.items()}, "varied": varied()}


def is_simulated(name: str) -> bool:
    """Return whether a name is a drive to be simulated, SCENARIO or SCENARIO@PLANT."""
    return name.partition("@")[0] in scenarios()


def simulated_log(name: str, profile: Profile, seed: int, settings: LogSettings | None = None) -> dict[str, Group]:
    """Drive a plant and log it.

    Args:
        name: SCENARIO@PLANT; mujoco if no plant is named.
        profile: parameters of the plant.
        seed: seed of all noise.
        settings: faults of the log; `LogSettings()` if not given.

    Returns:
        Groups of columns: commands at 20 Hz, wheels and gyro at 50 Hz, poses of the tracked point at 125 Hz.

    Raises:
        ValueError: an unknown scenario or plant.
        SsmrError: the plant diverged.
    """
    scenario, _, plant = name.partition("@")
    plant = plant or STANDARD
    if scenario not in scenarios() or plant not in ALL_PLANTS:
        raise ValueError(
            f"no drive '{name}'; there are: {', '.join(scenarios())}, each with @ and any of {', '.join(ALL_PLANTS)}"
        )
    return log_of_drive(scenarios()[scenario], plant, profile, seed, settings)


def log_of_drive(
    driven: Commands,
    plant: str,
    profile: Profile,
    seed: int,
    settings: LogSettings | None = None,
    terrain: Terrain = FLAT,
) -> dict[str, Group]:
    """Drive a plant from the origin, at rest before and after, and log it.

    Args:
        driven: commands.
        plant: name of the plant.
        profile: parameters of the plant.
        seed: seed of all noise.
        settings: faults of the log; `LogSettings()` if not given.
        terrain: ground of MuJoCo's robot.

    Returns:
        Groups of columns: commands at their own rate, wheels and gyro at 50 Hz, poses of the tracked point at 125 Hz.

    Raises:
        SsmrError: the plant diverged.
    """
    faults = settings or LogSettings()
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
    return {
        "cmd": Group("commands", stamps, dict(zip(("cmd_v", "cmd_w"), commands.values.T, strict=True))),
        "wheels": Group("encoders", shown.t, {"enc_left": shown.left, "enc_right": shown.right}),
        "imu": Group("gyro", shown.t, {"gyro_z": shown.gyro}),
        "pose": Group("localiser", motion.t + faults.pose_late, dict(zip(POSE_COLUMNS, pose.T, strict=True))),
    }
