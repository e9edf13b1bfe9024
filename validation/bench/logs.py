"""Logs of simulated drives, and dead reckoning on any log: the path by its wheels and gyro beside a better sensor's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr._jit import source
from ssmr.estimation.ekf import run_ekf
from ssmr.estimation.settings import EkfSettings
from ssmr.geometry import align_rigidly
from ssmr.metrics.paths import path_length
from ssmr.robot.drive import Sides, wheel_rates
from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorModel, simulate_sensors
from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.bench.sources import Piece, drive
from validation.files.faults import STOCK, WheelTwist, standing, wheel_twist
from validation.files.formats import read_log
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, POSES, Group, Log, ReadOptions
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
_BIAS_STD = 0.02
"""Standard deviation of a small gyro's bias at start-up [rad/s]: 1 degree/s, as data sheets say."""
_TRUTHS = {"gps": ("gps_east", "gps_north"), "pose": ("x", "y")}
"""Groups and columns whose positions dead reckoning is compared with: the first that a log has."""


# ------------------------------------------------------------------------------------------ simulated logs
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


# ------------------------------------------------------------------------------------------ the state filter on a log
def filtered_motion(log: Log, settings: EkfSettings = STOCK, *, bias: bool = True) -> Trajectory | None:
    """Run the state filter over a log, from pose 0 on.

    It runs at the gyro's stamps, where there is one, and interpolates the wheels' rates linearly between theirs.

    Args:
        log: the log.
        settings: the filter's, with wheel radius and half-track of the robot's driver.
        bias: True if what the gyro shows whenever the robot stands tells its bias, from the log's beginning.
            It is subtracted.

    Returns:
        The filter's motion; None without wheels.
    """
    wheels = wheel_twist(log, settings)
    if wheels is None:
        return None
    t, turning = _gyro_within(log, wheels[0]) or (wheels[0], None)
    left, right = _rates_at(t, wheels, settings)
    if turning is not None and bias:
        turning = turning - _bias_at_rest(turning[standing(log, t)])
    return run_ekf(t, left, right, turning, settings, State())


def _bias_at_rest(shown: FloatArray) -> float:
    """Return the bias of a gyro [rad/s] that showed these yaw rates while its robot stood; none where there are none."""
    prior, noise = _BIAS_STD**2, SensorModel().variance_gyro
    return prior / (len(shown) * prior + noise) * float(np.sum(shown))


def _rates_at(t: FloatArray, wheels: WheelTwist, settings: EkfSettings) -> Sides:
    """Return the (N,) rates of the left and right wheels at instants [s], interpolated."""
    stamps, v, w = wheels
    return source(wheel_rates)(np.interp(t, stamps, v), np.interp(t, stamps, w), settings.half_track, settings.radius)


def _gyro_within(log: Log, stamps: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the gyro's stamps [s] and yaw rates [rad/s] within `stamps` [s]; None for fewer than two."""
    imu = log.groups.get("imu")
    if imu is None:
        return None
    within = (imu.t >= stamps[0]) & (imu.t <= stamps[-1])
    return (imu.t[within], imu.columns["gyro_z"][within]) if np.count_nonzero(within) > 1 else None


# ------------------------------------------------------------------------------------------ dead reckoning
@dataclass(frozen=True)
class ReckonedPath:
    """Result of one way of dead reckoning."""

    name: str
    """Name in tables."""
    rms: float
    """Root mean square distance from the better positions, after rigid alignment [m]."""
    length: float
    """Length of its path over the same time [m]."""


@dataclass(frozen=True)
class Reckoning:
    """Results of several ways of dead reckoning."""

    truth: str
    """Topic or file, and group, of the positions that they are compared with."""
    samples: int
    """Number of these positions."""
    rows: tuple[ReckonedPath, ...]
    """At least one."""


def reckon(log: Log, settings: EkfSettings = STOCK) -> Reckoning | None:
    """Compare ways of dead reckoning with a log's positions by satellite or by a localiser.

    `settings` of the filter have wheel radius and half-track of the robot's driver.

    Returns:
        None where the log has no such positions, or no wheels.
    """
    positions = {n: log.groups[n].table(names) for n, names in _TRUTHS.items() if n in log.groups}
    name, points = next(((n, xy) for n, xy in positions.items() if xy is not None), ("", None))
    if points is None:
        return None
    ways = [("filter of wheels", settings, False)]
    if "imu" in log.groups:
        ways = [("filter of wheels and gyro", settings, False), ("filter, bias learned at rest", settings, True)]
    tracks = dict[str, tuple[FloatArray, FloatArray]]()  # stamps [s] and positions [m]; the odometry's own pose first
    for names in POSES:
        if "odom" in log.groups and (xy := log.groups["odom"].table(names[:2])) is not None:
            tracks["odometry's own pose"] = log.groups["odom"].t, xy
    for way, used, bias in ways:
        if (motion := filtered_motion(log, used, bias=bias)) is not None:
            tracks[way] = motion.t, motion.xy
    if not tracks:
        return None
    truth = log.groups[name]
    start, stop = max(t[0] for t, _ in tracks.values()), min(t[-1] for t, _ in tracks.values())
    within = (truth.t >= start) & (truth.t <= stop)
    if np.count_nonzero(within) < 3:
        return None
    at, points = truth.t[within], points[within]
    rows = []
    for way, (t, xy) in tracks.items():
        away = align_rigidly(np.column_stack([np.interp(at, t, column) for column in xy.T]), points) - points
        driven = xy[(t >= at[0]) & (t <= at[-1])]
        rows.append(ReckonedPath(way, float(np.sqrt(np.mean(np.sum(away**2, axis=1)))), path_length(driven)))
    return Reckoning(f"{truth.source} ({name})", len(at), tuple(rows))
