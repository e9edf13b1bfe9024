"""A small simulator of skid-steering robots and of what their sensors write, for blind tests.

It shares nothing with the project: twists come from wheel rates, slip and a half-track of turning;
every sensor has its own rate, noise and delay. `tests/test_blind_log_faults.py` breaks its logs.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
DATA = Path(os.environ.get("SSMR_DATA", Path(__file__).parents[2] / "shared" / "data"))
STEP = 0.005
"""Time between two samples of the true motion [s]."""


@dataclass(frozen=True)
class Robot:
    """One robot: metres, seconds, radians."""

    radius: float
    half_track: float
    """Half-track with which rolling wheels would give the robot's yaw rate."""
    driver_half_track: float
    speed: float
    turn: float
    lag: float
    dead_time: float
    slip: float
    """Share of the speed by which slip varies at random, over a second or so."""


@dataclass(frozen=True)
class Localiser:
    """A source of poses has noise [m, rad], a rate [Hz] and a delay [s]."""

    noise: float
    yaw_noise: float
    rate: float
    late: float


ROBOTS = {
    "mini": Robot(0.04, 0.115, 0.08, 0.15, 0.8, 0.05, 0.04, 0.02),
    "leo": Robot(0.0625, 0.30, 0.17, 0.35, 0.9, 0.10, 0.08, 0.02),
    "jackal": Robot(0.098, 0.29, 0.19, 0.9, 1.2, 0.08, 0.06, 0.015),
    "husky": Robot(0.165, 0.50, 0.28, 0.8, 0.8, 0.15, 0.12, 0.02),
    "warthog": Robot(0.30, 0.95, 0.575, 2.0, 0.9, 0.25, 0.20, 0.03),
    "farm": Robot(0.25, 0.76, 0.45, 1.4, 0.6, 0.30, 0.15, 0.03),
}
LOCALISERS = {
    "mocap": Localiser(0.0004, 0.0015, 100.0, 0.01),
    "lidar": Localiser(0.008, 0.008, 10.0, 0.10),
    "slam": Localiser(0.015, 0.010, 20.0, 0.25),
    "rtk": Localiser(0.015, 0.010, 5.0, 0.15),
}


@dataclass(frozen=True)
class Setup:
    """All that a log depends on."""

    robot: Robot
    localiser: Localiser
    drive: str = "joystick"
    seconds: float = 60.0
    rate: float = 50.0
    seed: int = 0
    gyro_noise: float = 0.008
    gyro_bias: float = -0.006
    gyro_scale: float = 1.0
    wheel_noise: float = 0.02
    """Standard deviation of wheel rates, as a share of those of full speed."""
    wheel_late: float = 0.0
    wheel_resolution: float = 0.0
    """Turn of a wheel in one tick [rad]; 0 is perfectly fine."""
    pace: float = 1.0
    left_grip: float = 1.0
    """Way of the left side over that which its rate and radius say."""
    start: tuple[float, float, float] = (0.0, 0.0, 0.3)
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    centre: float = 0.03
    """The robot turns about a point so far behind the tracked origin [m]."""
    limit: float = np.inf
    """Yaw acceleration that the driver allows [rad/s^2]."""


@dataclass
class Log:
    """A table as it is written, and the truth behind it."""

    table: pd.DataFrame
    truth: pd.DataFrame
    """Index-free, every STEP: t, v, w, left, right, x, y, yaw, cmd_v, cmd_w."""
    robot: Robot
    options: list[str] = field(default_factory=list)
    jumps: int = 0
    """Its localiser may have made so many jumps of the pose."""

    def copied(self) -> Log:
        """Return the same log with a table that may be changed.

        Returns:
            A log with a table of its own.
        """
        return replace(self, table=self.table.copy())

    @property
    def t(self) -> Array:
        """Stamps [s], (rows,)."""
        return self.table["t"].to_numpy(float)

    @property
    def half(self) -> Array:
        """Rows of the second half, (rows,) of booleans."""
        t = self.t
        return t > (t[0] + t[-1]) / 2

    def at(self, name: str, t: Array) -> Array:
        """A true signal at other times.

        Returns:
            Its values, one a time; before the log and after it those of the ends.
        """
        return np.interp(t, self.truth["t"], self.truth[name])


def joystick(rng: np.random.Generator, seconds: float) -> list[tuple[float, float, float]]:
    """Somebody plays: every 1.5 to 5 s another speed and turn, sometimes a stop.

    Returns:
        Parts: duration [s], speed and turn as shares of the robot's.
    """
    parts = [(2.0, 0.0, 0.0)]
    while sum(part[0] for part in parts) < seconds - 2:
        speed = rng.choice([1.0, 0.7, 0.4, -0.6, 0.0], p=[0.3, 0.25, 0.15, 0.2, 0.1])
        parts.append((rng.uniform(1.5, 5.0), speed, rng.uniform(-1, 1)))
    return [*parts, (5.0, 0.0, 0.0)]


def lawnmower(rng: np.random.Generator, seconds: float) -> list[tuple[float, float, float]]:
    """Lanes with turns of half a circle to either side.

    Returns:
        Parts as those of `joystick`.
    """
    parts = [(3.0, 0.0, 0.0)]
    side = 1.0
    while sum(part[0] for part in parts) < seconds - 2:
        parts += [(rng.uniform(6, 9), 0.9, rng.normal(0, 0.03)), (rng.uniform(4, 6), 0.4, side)]
        side = -side
    return [*parts, (4.0, 0.0, 0.0)]


def eights(rng: np.random.Generator, seconds: float) -> list[tuple[float, float, float]]:
    """Figures of eight whose loops differ.

    Returns:
        Parts as those of `joystick`.
    """
    parts = [(1.0, 0.0, 0.0)]
    side = 1.0
    while sum(part[0] for part in parts) < seconds:
        parts.append((rng.uniform(6, 10), rng.uniform(0.5, 1.0), side * rng.uniform(0.6, 1.0)))
        side = -side
    return parts


def docking(rng: np.random.Generator, seconds: float) -> list[tuple[float, float, float]]:
    """Forth and back to a place, with stops and turns on the spot.

    Returns:
        Parts as those of `joystick`.
    """
    parts = [(2.0, 0.0, 0.0)]
    while sum(part[0] for part in parts) < seconds:
        bend = rng.uniform(-0.5, 0.5)
        spot = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 0.9)
        parts += [(4.0, 0.6, bend), (2.0, 0.25, -bend), (2.5, 0.0, 0.0)]
        parts += [(3.5, -0.5, bend / 2), (rng.uniform(1.5, 4), 0.0, spot), (1.0, 0.0, 0.0)]
    return parts


def left_only(rng: np.random.Generator, seconds: float) -> list[tuple[float, float, float]]:
    """Speeds and bends vary, but every bend is to the left.

    Returns:
        Parts as those of `joystick`.
    """
    parts = [(2.0, 0.0, 0.0)]
    while sum(part[0] for part in parts) < seconds:
        parts.append((rng.uniform(2, 5), rng.uniform(0.3, 1.0), rng.uniform(0.0, 1.0)))
    return parts


def mostly_straight(rng: np.random.Generator, seconds: float) -> list[tuple[float, float, float]]:
    """A long road with four bends.

    Returns:
        Parts as those of `joystick`.
    """
    parts = [(2.0, 0.0, 0.0)]
    for side in (1, -1, -1, 1):
        parts += [(seconds / 5, rng.uniform(0.6, 1.0), 0.0), (3.0, 0.5, 0.7 * side)]
    return parts


DRIVES = {
    drive.__name__: drive
    for drive in (joystick, lawnmower, eights, docking, left_only, mostly_straight)
}


def vary_slowly(rng: np.random.Generator, count: int, share: float) -> Array:
    """Noise that changes within about a second.

    Returns:
        (count,), of standard deviation `share`.
    """
    keep = np.exp(-STEP / 1.0)
    white = rng.normal(0, share * np.sqrt(1 - keep**2), count)
    return np.asarray(lfilter([1.0], [1.0, -keep], white))


def follow(command: Array, lag: float) -> Array:
    """A first-order lag.

    Returns:
        (n,), the answer, from rest.
    """
    keep = np.exp(-STEP / lag)
    return np.asarray(lfilter([1 - keep], [1.0, -keep], command))


def simulate_truth(setup: Setup, rng: np.random.Generator) -> pd.DataFrame:
    """Drive the robot.

    Returns:
        A row every STEP: t, v, w, left, right, x, y, yaw, cmd_v, cmd_w, angle_left, angle_right.
    """
    robot = setup.robot
    t = np.arange(0.0, setup.seconds + STEP / 2, STEP)
    parts = DRIVES[setup.drive](rng, setup.seconds)
    ends = np.cumsum([part[0] for part in parts])
    which = np.minimum(np.searchsorted(ends, t, side="right"), len(parts) - 1)
    cmd_v = np.array([part[1] for part in parts])[which] * robot.speed * setup.pace
    cmd_w = np.array([part[2] for part in parts])[which] * robot.turn * setup.pace
    cmd_v, cmd_w = follow(cmd_v, 0.15), follow(cmd_w, 0.15)  # a hand is not a step
    cmd_v[np.abs(cmd_v) < 0.002 * robot.speed] = 0
    cmd_w[np.abs(cmd_w) < 0.002 * robot.turn] = 0
    late = round(robot.dead_time / STEP)
    v_asked = np.concatenate([np.zeros(late), cmd_v])[: len(t)]
    w_asked = np.concatenate([np.zeros(late), cmd_w])[: len(t)]
    left = follow((v_asked - w_asked * robot.driver_half_track) / robot.radius, robot.lag)
    right = follow((v_asked + w_asked * robot.driver_half_track) / robot.radius, robot.lag)
    still = 1e-3 * robot.speed / robot.radius
    left[np.abs(left) < still] = 0
    right[np.abs(right) < still] = 0
    grip_left = setup.left_grip * (1 + vary_slowly(rng, len(t), robot.slip))
    grip_right = 1 + vary_slowly(rng, len(t), robot.slip)
    truth = pd.DataFrame({"t": t, "cmd_v": cmd_v, "cmd_w": cmd_w, "left": left, "right": right})
    go_left, go_right = left * grip_left, right * grip_right
    return add_motion(truth, setup, go_left, go_right)


def add_motion(truth: pd.DataFrame, setup: Setup, go_left: Array, go_right: Array) -> pd.DataFrame:
    """Integrate the motion of a robot whose sides go with these rates over ground.

    Returns:
        `truth` with v, w, x, y, yaw of the tracked point and the angles of the wheels.
    """
    robot = setup.robot
    v = robot.radius * (go_left + go_right) / 2
    w = robot.radius * (go_right - go_left) / (2 * robot.half_track)
    yaw = setup.start[2] + np.concatenate([[0.0], np.cumsum(w[:-1] * STEP)])
    aside = -setup.centre * w
    vx = v * np.cos(yaw) - aside * np.sin(yaw)
    vy = v * np.sin(yaw) + aside * np.cos(yaw)
    x = setup.start[0] + np.concatenate([[0.0], np.cumsum(vx[:-1] * STEP)])
    y = setup.start[1] + np.concatenate([[0.0], np.cumsum(vy[:-1] * STEP)])
    ahead, beside, turned = setup.mount
    x = x + ahead * np.cos(yaw) - beside * np.sin(yaw)
    y = y + ahead * np.sin(yaw) + beside * np.cos(yaw)
    for side in ("left", "right"):
        truth[f"angle_{side}"] = np.cumsum(truth[side]) * STEP
    return truth.assign(v=v, w=w, x=x, y=y, yaw=yaw + turned, true_yaw=yaw)


def write_signals(setup: Setup, truth: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return what the sensors of this robot write, on one common clock.

    Returns:
        A table with our names; cells are empty where a slower sensor has nothing new.
    """
    t = np.arange(0.0, setup.seconds, 1 / setup.rate)
    table = pd.DataFrame({"t": t})

    def at(name: str, times: Array) -> Array:
        return np.interp(times, truth["t"], truth[name])

    steps = np.minimum((t / STEP).astype(int), len(truth) - 1)
    table["cmd_v"] = truth["cmd_v"].to_numpy()[steps]
    table["cmd_w"] = truth["cmd_w"].to_numpy()[steps]
    period = max(1 / setup.rate, 0.02)
    for side in ("left", "right"):
        now = t - setup.wheel_late
        angles = at(f"angle_{side}", now), at(f"angle_{side}", now - period)
        tick = setup.wheel_resolution
        if tick:
            angles = np.floor(angles[0] / tick) * tick, np.floor(angles[1] / tick) * tick
        noise = rng.normal(0, setup.wheel_noise * setup.robot.speed / setup.robot.radius, len(t))
        moving = np.abs(at(side, now)) > 0
        table[f"enc_{side}"] = (angles[0] - angles[1]) / period + noise * moving * (tick == 0)
    gyro = setup.gyro_scale * at("w", t) + setup.gyro_bias
    table["gyro_z"] = gyro + rng.normal(0, setup.gyro_noise, len(t))
    every = max(1, round(setup.rate / setup.localiser.rate))
    fresh = np.arange(len(t)) % every == 0
    for name in ("x", "y", "yaw"):
        noise = setup.localiser.yaw_noise if name == "yaw" else setup.localiser.noise
        measured = at(name, t - setup.localiser.late) + rng.normal(0, noise, len(t))
        table[name] = np.where(fresh, measured, np.nan)
    return table


def make_log(setup: Setup) -> Log:
    """Drive and write.

    Returns:
        A sound log.
    """
    rng = np.random.default_rng(setup.seed)
    truth = simulate_truth(setup, rng)
    return Log(write_signals(setup, truth, rng), truth, setup.robot)


@dataclass(frozen=True)
class Cut:
    """A part of a real recording."""

    file: str
    begin: float
    seconds: float
    gyro_sign: float = 1.0


REAL = {
    "tile_a": Cut("husky_tile/husky_tile_train.csv", 10, 80),
    "tile_b": Cut("husky_tile/husky_tile_train.csv", 200, 80),
    "tile_c": Cut("husky_tile/husky_tile_train.csv", 420, 90),
    "grass": Cut("warthog_grass/warthog_grass_train.csv", 60, 90),
    "grass_b": Cut("warthog_grass/warthog_grass_train.csv", 150, 90),
    "grass_2": Cut("drive_runs/warthog_grass_2_train.csv", 5, 90),
    "asphalt": Cut("drive_runs/warthog_asphalt_train.csv", 128, 90),
    "asphalt_slow": Cut("drive_runs/warthog_asphalt_slow_train.csv", 60, 90),
    "unnamed": Cut("drive_runs/husky_unnamed_train.csv", 100, 90, -1.0),
}
NAMES = ("t", "cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z", "x", "y", "yaw")


@cache
def read_real(name: str) -> pd.DataFrame | None:
    """A part of a recording from `SSMR_DATA`.

    Returns:
        Its table with our columns, or None where the file is missing.
    """
    cut = REAL[name]
    if not (DATA / cut.file).is_file():
        return None
    whole = pd.read_csv(DATA / cut.file)[list(NAMES)]
    part = whole[(whole["t"] >= cut.begin) & (whole["t"] <= cut.begin + cut.seconds)]
    return part.assign(gyro_z=part["gyro_z"] * cut.gyro_sign).reset_index(drop=True)


def make_real_log(name: str) -> Log | None:
    """A part of a recording as a log, whose truth is what its pose and gyro say.

    Returns:
        The log, or None where the file is missing.
    """
    table = read_real(name)
    if table is None:
        return None
    t = np.arange(table["t"].iloc[0], table["t"].iloc[-1], STEP)
    truth = pd.DataFrame({"t": t})
    sources = {"left": "enc_left", "right": "enc_right", "w": "gyro_z"}
    for name_, column in {**{key: key for key in NAMES[1:]}, **sources}.items():
        truth[name_] = np.interp(t, table["t"], table[column])
    radius = 0.3 if "warthog" in REAL[name].file else 0.155
    robot = replace(ROBOTS["warthog" if radius > 0.2 else "husky"], radius=radius)
    truth["v"] = radius * (truth["left"] + truth["right"]) / 2
    return Log(table.copy(), truth, robot, jumps=3)


BASES: dict[str, Setup] = {
    "mini_mocap": Setup(ROBOTS["mini"], LOCALISERS["mocap"], "joystick", 60, 100, 1),
    "leo_lidar": Setup(ROBOTS["leo"], LOCALISERS["lidar"], "docking", 70, 50, 2),
    "jackal_slam": Setup(ROBOTS["jackal"], LOCALISERS["slam"], "joystick", 60, 50, 3),
    "jackal_mow": Setup(ROBOTS["jackal"], LOCALISERS["lidar"], "lawnmower", 80, 20, 4),
    "husky_eights": Setup(ROBOTS["husky"], LOCALISERS["slam"], "eights", 70, 20, 5),
    "husky_joy": Setup(ROBOTS["husky"], LOCALISERS["mocap"], "joystick", 70, 50, 6),
    "warthog_rtk": Setup(ROBOTS["warthog"], LOCALISERS["rtk"], "joystick", 80, 20, 7),
    "farm_rtk": Setup(ROBOTS["farm"], LOCALISERS["rtk"], "lawnmower", 90, 10, 8),
}
BACKWARDS = ("mini_mocap", "leo_lidar", "jackal_slam", "husky_joy", "warthog_rtk")
"""Bases that drive backwards for a while."""


def base_log(name: str) -> Log | None:
    """A sound log by its name.

    Returns:
        The log, or None where a recording is missing.
    """
    return make_log(BASES[name]) if name in BASES else make_real_log(name)
