"""A log's motor currents in steady driving: their sensor, and the samples to be believed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from ssmr.robot.vehicle import Vehicle
from ssmr.types import CURRENTS, TORQUES, VOLTAGES, FloatArray, Trajectory
from validation.files.formats import read_log
from validation.files.log import Log
from validation.output import Document
from validation.plants.kind import PlantProfile
from validation.plants.profile import Profile
from validation.simulator.description import GRAVITY

FIT_SHARE = 2.0 / 3.0
"""Share of a log that is fitted where no other log is held out."""
_SETTLE = 1.2
_LEAST = 1.0
_MOST = 6.2
"""A steady window leaves out so much of its beginning, has at least so much left, and is at most so
long [s]."""
# wheel rates that differ by less are steady [rad/s]: two steps of a Husky's set points
_STEADY_RATE = 0.13
_LONG_STEP = 0.3  # a step of time longer than this ends a window [s]
_STANDING = 0.15  # wheels whose rates add up to less stand [rad/s]
# a current that is refreshed less often is used value by value, and not in windows [s]
_SLOW_SENSOR = 0.5
_SLOW_RATE = 0.06  # a side that turns slower than this may have its bridge off [rad/s]
_SEEN = 0.7
_CALM = 1.0
_FEWEST = 5
"""A slow sensor's value belongs to the wheel rates of so much time before it [s], if they vary by
less [rad/s] in so many rows or more."""
_TOGETHER = 0.05  # so much later a row may still hold what was measured with a value [s]
_BATTERY_ON, _USUAL_VOLTAGE = 1.0, 24.0  # lower voltages are not yet measured [V]; where none is


def chassis_of(profile: Profile, mass: float | None = None) -> PlantProfile:
    """Return the nominal numbers of a profile's robot, with another total mass [kg] if given.

    Its vehicle has mass, rolling radius and half distances of the wheels, and its drive the radius
    of commands and the greatest speed of a rim. Nothing of them is fitted.
    """
    plant = profile.plants["mujoco"]
    body = plant.parameters
    half = 0.5 * profile.robot.wheelbase
    vehicle = Vehicle(
        mass or body.mass,
        wheel_radius=body.wheel_radius,
        half_track=body.half_track,
        a=half,
        b=half,
    )
    return replace(plant, vehicle=vehicle, drive=profile.robot.drive)


def loss_of(plant: PlantProfile) -> float:
    """Return what gear and rolling take of a side's torque in a plant on wheels [N m]."""
    body = plant.parameters
    side = 0.5 * body.mass * GRAVITY
    return plant.drive.gear_loss + body.rolling_resistance * side * body.wheel_radius


UNKNOWN = np.empty((2, 0))
"""A signal of both sides that the log does not have: an array without samples."""


@dataclass(frozen=True, eq=False)
class DriveLog:
    """The signals of a recording that tell of the drive train, M samples; pairs: left, right."""

    name: str  # name of the log
    t: FloatArray  # (M,) time [s]
    rates: FloatArray  # (2, M) wheel rates [rad/s]
    commands: FloatArray  # (2, M) commanded speed [m/s] and yaw rate [rad/s], or `UNKNOWN`
    currents: FloatArray  # (2, M) currents [A], or torques [N m]; NaN or `UNKNOWN` where unknown
    voltages: FloatArray  # (2, M) voltages [V], or `UNKNOWN`
    # whether the robot drove, as far as the log tells: it has a heading, or a gyro that shows
    # something
    on_ground: bool
    unit: Literal["A", "N m"] = "A"  # that of the currents

    @property
    def signed(self) -> bool:
        """True if currents can be negative."""
        negative = np.count_nonzero(self.currents < -0.5)
        return self.unit == "N m" or bool(negative > 0.01 * self.currents.size)

    def divided(self) -> tuple[DriveLog, DriveLog]:
        """Return its first two thirds, to be fitted, and its last third, which judges."""
        end = np.searchsorted(self.t, self.t[0] + FIT_SHARE * (self.t[-1] - self.t[0]))
        return self._part("first two thirds", slice(end)), self._part(
            "last third", slice(end, None)
        )

    def _part(self, which: str, rows: slice) -> DriveLog:
        columns: Document = {
            name: value[..., rows]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray)
        }
        return replace(self, name=f"{self.name}, {which}", **columns)


def drive_log(source: str | Log) -> DriveLog:
    """Return what tells of the drive train in a recording, or in the file at a path.

    Raises:
        ValueError: it has no wheel rates.
    """
    log = source if isinstance(source, Log) else read_log(source).on_one_clock()
    columns = log.columns

    def pair(*names: str) -> FloatArray:
        known = columns.keys() >= set(names)
        return np.stack([columns[name] for name in names]) if known else UNKNOWN

    rates = pair("enc_left", "enc_right")
    if rates is UNKNOWN:
        raise ValueError(
            f"recording {log.name} has no wheel rates (enc_left, enc_right); "
            f"it has {', '.join(columns)}"
        )
    turned = "yaw" in columns or bool(np.ptp(columns.get("gyro_z", np.zeros(1))) > 0.0)
    currents = pair("current_left", "current_right")
    voltages = pair("voltage_left", "voltage_right")
    commands = pair("cmd_v", "cmd_w")
    return DriveLog(log.name, log.t, rates, commands, currents, voltages, on_ground=turned)


def log_of_motions(name: str, motions: Sequence[Trajectory]) -> DriveLog | None:
    """Return stretches of a recording as one log, with its torques or else its currents.

    Where it has neither, it is None.
    """

    def joined(channel: str) -> FloatArray:
        known = [motion.channels[channel] for motion in motions if channel in motion.channels]
        return np.concatenate(known).T if len(known) == len(motions) else UNKNOWN

    t = np.concatenate([motion.t for motion in motions])
    rates = np.concatenate([motion.wheels for motion in motions]).T
    log = DriveLog(name, t, rates, UNKNOWN, joined(CURRENTS), joined(VOLTAGES), on_ground=True)
    torques = joined(TORQUES)
    if torques.size:
        return replace(log, currents=torques, unit="N m")
    return log if log.currents.size else None


def require_currents(log: DriveLog) -> FloatArray:
    """Return the (2, M) currents of a log [A]; a ValueError refuses none, or constant ones."""
    if not log.currents.size:
        raise ValueError(f"{log.name} has no currents (current_left, current_right)")
    if not np.ptp(log.currents) > 0.0:
        raise ValueError(f"{log.name} has currents that never change")
    return log.currents


class Sensor(NamedTuple):
    """Properties of a log's current sensor that show without a fit."""

    kind: str  # `windows` if it is sampled in steady windows, `values` if each new value is one
    ripple: float  # standard deviation of a steady current about its mean [A]
    idle: float  # mean reading of a bridge that does not drive [A]
    signed: bool  # true if readings can be negative


def sensor_of(log: DriveLog) -> Sensor:
    """Return what a log shows of its currents' sensor; a ValueError says that it has none."""
    currents = require_currents(log)
    steps = [np.diff(log.t[1:][np.diff(current) != 0.0]) for current in currents]
    known = np.concatenate(steps)
    kind = "windows" if len(known) and np.median(known) < _SLOW_SENSOR else "values"
    if log.signed:
        return Sensor(kind, 0.0, 0.0, signed=True)
    sizes = np.abs(currents[currents != 0.0])
    idle = 0.5 * sizes.min() if sizes.min() < 0.1 * sizes.max() else 0.0
    inside = [current[window] for window in _steady_windows(log) for current in currents]
    ripples = [current.std() for current in inside if current.mean() > 5.0 * max(idle, 0.1)]
    return Sensor(kind, np.median(ripples or [1.0]), idle, signed=False)


def _steady_windows(log: DriveLog) -> list[slice]:
    """Return the windows of a log in which the wheels turn steadily, each without its beginning."""
    t = log.t
    windows = []
    first = 0
    while first < len(t) - 1:
        stop = np.searchsorted(t, t[first] + _MOST, side="right")
        start = log.rates[:, first, None]
        moved = np.abs(log.rates[:, first:stop] - start).max(axis=0) >= _STEADY_RATE
        moved[1:] |= np.diff(t[first:stop]) >= _LONG_STEP
        if moved.any():
            stop = first + np.argmax(moved)
        settled = t[first] + _SETTLE
        if t[stop - 1] - settled >= _LEAST and np.abs(start).sum() > _STANDING:
            windows.append(slice(np.searchsorted(t, settled), stop))
        first = stop
    return windows


def _sensor_refreshes(log: DriveLog) -> Iterator[tuple[int, slice, int]]:
    """Yield the side of each new value of a slow sensor, what samples it tells of, and its own.

    It tells of those just before it, where the rates hardly change.
    """
    t = log.t
    for side, current in enumerate(require_currents(log)):
        for k in np.flatnonzero(np.diff(current)) + 1:
            ends = np.searchsorted(t, [t[k] - _SEEN, t[k] + _TOGETHER], side="right")
            span = slice(*ends.tolist())
            rates = log.rates[:, span]
            gap = rates.shape[1] < _FEWEST or np.diff(t[span]).max() >= _LONG_STEP
            turns = np.abs(rates.mean(axis=1)).sum() > 2.0 * _STANDING
            if turns and not gap and np.ptp(rates, axis=1).max() < _CALM:
                yield side, span, int(k)


def steady_samples(log: DriveLog) -> tuple[DriveLog, DriveLog]:
    """Return a log's currents in steady driving: M samples, and the means of what belongs together.

    That is a steady window, or a value of a slow sensor, of which the other side is unknown. The
    currents of sides that stand are unknown too: bridges may be off.

    Raises:
        ValueError: it has no currents.
    """
    currents = require_currents(log)
    windows = [(slice(None), window, window) for window in _steady_windows(log)]
    voltages = np.full_like(log.rates, _USUAL_VOLTAGE)
    if (on := log.voltages > _BATTERY_ON).any():
        voltages = np.where(on, log.voltages, np.median(log.voltages[on]))
    known = np.full_like(currents, np.nan)
    rows = []
    for sides, span, read in (
        windows if sensor_of(log).kind == "windows" else _sensor_refreshes(log)
    ):
        known[sides, span] = currents[sides, read]
        own = np.full((2, 1), np.nan)
        own[sides] = known[sides, span].mean(axis=-1, keepdims=True)
        columns = (log.t[None, span], log.rates[:, span], own, voltages[:, span])
        rows.append(np.concatenate([column.mean(axis=1) for column in columns]))
    t, *pairs = np.array(rows).reshape(-1, 7).T
    rates, own, volts = np.array(pairs).reshape(3, 2, -1)
    return (
        replace(log, currents=_of_turning(known, log.rates), voltages=voltages),
        replace(log, t=t, rates=rates, currents=_of_turning(own, rates), voltages=volts),
    )


def _of_turning(currents: FloatArray, rates: FloatArray) -> FloatArray:
    return np.where(np.abs(rates) >= _SLOW_RATE, currents, np.nan)
