"""A log as the study of the drive train sees it: wheel rates, currents, and what is known of its robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ssmr.robot.drivetrain import SkidGeometry
from ssmr.types import FloatArray
from validation.files.formats import read_log
from validation.files.log import Log
from validation.plants.profile import Profile, choose_profile
from validation.simulator.description import Robot

MOST_SECONDS = 36_000.0
"""Longest log that is studied [s]: the driver is computed a hundred times a second."""


@dataclass(frozen=True)
class Chassis:
    """Nominal numbers of a robot; nothing of them is fitted."""

    name: str
    geometry: SkidGeometry
    mass: float
    """Total mass [kg]."""
    command_radius: float
    """Wheel radius with which the robot's driver turns speeds into wheel rates [m]."""
    speed_limit: float
    """Greatest speed of a rim that the driver allows [m/s]."""
    profile: str
    """Profile that mass and rolling radius are of."""


USUAL_PROFILE = "husky-tile"
"""Profile of a Husky that says how large its loaded tyres roll."""
_HUSKY_BATTERY = 35.0
"""A battery with more than this is no Husky's, whose has 24 V [V]."""


@dataclass(frozen=True, eq=False)
class DriveLog:
    """The columns of a recording that the study uses, M samples."""

    name: str
    t: FloatArray
    """(M,) time [s]."""
    rates: FloatArray
    """(2, M) wheel rates, left and right [rad/s]."""
    commands: FloatArray | None
    """(2, M) commanded speed [m/s] and yaw rate [rad/s]."""
    currents: FloatArray | None
    """(2, M) currents, left and right [A]."""
    voltages: FloatArray | None
    """(2, M) voltages, left and right [V]."""
    yaw: FloatArray | None
    """(M,) unwrapped heading [rad]; a log without one is taken for one with its wheels up."""
    gyro: FloatArray | None
    """(M,) yaw rate [rad/s]; None for a gyro that shows nothing."""

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def on_ground(self) -> bool:
        """True if the robot drove, as far as the log tells: it has a heading or a gyro."""
        return self.yaw is not None or self.gyro is not None

    @property
    def signed(self) -> bool:
        """True if currents can be negative."""
        return self.currents is not None and bool((self.currents < -0.5).mean() > 0.01)

    @property
    def battery(self) -> float:
        """Median voltage of the battery [V]; 24 where there is none."""
        known = None if self.voltages is None else self.voltages[self.voltages > 1.0]
        return 24.0 if known is None or not len(known) else float(np.median(known))

    def between(self, start: float, stop: float) -> DriveLog:
        """Return the samples with `start` <= t < `stop` [s]."""
        keep = (self.t >= start) & (self.t < stop)
        cut = {n: None if (a := getattr(self, n)) is None else a[..., keep] for n in _COLUMNS}
        return replace(self, **cut)  # type: ignore[arg-type]

    def divided(self) -> tuple[DriveLog, DriveLog]:
        """Return its first two thirds, to be fitted, and its last third, which judges."""
        where = float(self.t[0]) + FIT_SHARE * self.duration
        return self.between(-math.inf, where), self.between(where, math.inf)


FIT_SHARE = 2.0 / 3.0
"""Share of a log that is fitted where no other log is held out."""
_BELIEVED: Mapping[str, float] = {
    **dict.fromkeys(("enc_left", "enc_right", "cmd_v", "cmd_w", "gyro_z"), 1e3),
    **dict.fromkeys(("current_left", "current_right", "voltage_left", "voltage_right"), 1e4),
    "yaw": 1e7,
}
"""Greatest sizes of columns that a robot may have [SI]."""
_COLUMNS = ("t", "rates", "commands", "currents", "voltages", "yaw", "gyro")


def drive_log(source: str | Log) -> DriveLog:
    """Return the columns of a recording, or of the file at a path, that the study uses.

    Raises:
        ValueError: it cannot be read, has no wheel rates, has numbers of no robot, or is longer than `MOST_SECONDS`.
    """
    recording = source if isinstance(source, Log) else read_log(source).on_one_clock()
    columns = recording.columns

    def pair(first: str, second: str) -> FloatArray | None:
        both = first in columns and second in columns
        return np.stack([columns[first], columns[second]]) if both else None

    rates = pair("enc_left", "enc_right")
    if rates is None:
        raise ValueError(f"recording {recording.name} has no wheel rates (enc_left, enc_right); it has {', '.join(columns)}")
    for name, most in _BELIEVED.items():
        if name in columns and np.abs(columns[name]).max() > most:
            raise ValueError(
                f"recording {recording.name} has a {name} of {np.abs(columns[name]).max():g}; wanted at most {most:g}"
            )
    if recording.t[-1] - recording.t[0] > MOST_SECONDS:
        raise ValueError(f"recording {recording.name} is longer than {MOST_SECONDS:g} s; cut it")
    gyro, yaw = columns.get("gyro_z"), columns.get("yaw")
    return DriveLog(
        recording.name,
        recording.t,
        rates,
        pair("cmd_v", "cmd_w"),
        pair("current_left", "current_right"),
        pair("voltage_left", "voltage_right"),
        None if yaw is None else np.unwrap(yaw),
        None if gyro is None or not np.ptp(gyro) > 0.0 else gyro,
    )


def guessed_robot(log: DriveLog) -> tuple[str, str]:
    """Return the name of the robot whose battery a log shows, and a sentence that says so."""
    robot = "warthog" if log.battery > _HUSKY_BATTERY else "husky"
    return robot, f"No robot was named: by its battery of {log.battery:.0f} V {log.name} is taken for a log of a {robot}."


def chassis_of(robot: str | Robot | None = None, profile: str | Profile | None = None, mass: float | None = None) -> Chassis:
    """Return the nominal numbers of a robot.

    Args:
        robot: the robot, its name or its path; None for that of the profile.
        profile: profile whose MuJoCo robot has its mass and its rolling radius; None for husky-tile, or the robot's own
            numbers if that is of another robot.
        mass: total mass [kg] in the place of the profile's.

    Raises:
        ValueError: there is no such robot or profile, or the two do not belong together.
    """
    chosen = choose_profile(profile, robot, USUAL_PROFILE)
    body, nominal, drive = chosen.plants["mujoco"].parameters, chosen.robot.geometry, chosen.robot.drive
    geometry = SkidGeometry(body.wheel_radius, body.half_track, 0.5 * nominal.wheelbase)
    total = body.mass if mass is None else mass
    return Chassis(chosen.robot.name, geometry, total, drive.command_radius, drive.v_max, chosen.name)


class Resampling(NamedTuple):
    """How standard errors are found: by fits to resampled data."""

    rng: np.random.Generator
    draws: int
    """Number of resampled fits."""
    tick: Callable[[], object]
    """Function that is called after each fit."""
