"""A log's motor currents in steady driving: what its sensor is, and the samples that can be believed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr.robot.drivetrain import SkidGeometry
from ssmr.types import FloatArray, IndexArray, Trajectory
from validation.bench.sources import CURRENTS, VOLTAGES
from validation.files.formats import read_log
from validation.files.log import Log
from validation.plants.kind import PlantProfile
from validation.plants.profile import Profile
from validation.simulator.description import GRAVITY

FIT_SHARE = 2.0 / 3.0
"""Share of a log that is fitted where no other log is held out."""
_SETTLE, _LEAST, _MOST = 1.2, 1.0, 6.2
"""A steady window leaves out so much of its beginning, has at least so much left, and is at most so long [s]."""
_STEADY_RATE = (
    0.13  # wheel rates that differ by less are steady [rad/s]: two steps of a Husky's set points
)
_LONG_STEP = 0.3  # a step of time longer than this ends a window [s]
_STANDING = 0.15  # wheels whose rates add up to less stand [rad/s]
_SLOW_SENSOR = (
    0.5  # a current that is refreshed less often is used value by value, and not in windows [s]
)
_SLOW_RATE = 0.06  # a side that turns slower than this may have its bridge off [rad/s]
_SEEN, _CALM, _FEWEST = 0.7, 1.0, 5
"""A slow sensor's value belongs to the wheel rates of so much time before it [s], if they vary by less [rad/s] in so many
rows or more."""
_BLOCK = 6.0  # length of a block of the bootstrap [s], where no windows make blocks: as long as a command usually is


class Chassis(NamedTuple):
    """Nominal numbers of a robot; nothing of them is fitted."""

    name: str  # name of the robot
    geometry: SkidGeometry  # rolling radius and half distances of its wheels
    mass: float  # total mass [kg]
    command_radius: (
        float  # wheel radius with which the robot's driver turns speeds into wheel rates [m]
    )
    speed_limit: float  # greatest speed of a rim that the driver allows [m/s]


def chassis_of(profile: Profile, mass: float | None = None) -> Chassis:
    """Return the nominal numbers of a profile's robot, with another total mass [kg] where one is given."""
    body, robot = profile.plants["mujoco"].parameters, profile.robot
    geometry = SkidGeometry(body.wheel_radius, body.half_track, 0.5 * robot.geometry.wheelbase)
    return Chassis(
        robot.name, geometry, mass or body.mass, robot.drive.command_radius, robot.drive.v_max
    )


def loss_of(plant: PlantProfile) -> float:
    """Return what gear and rolling take of a side's torque in a plant on wheels [N m]."""
    body = plant.parameters
    side = 0.5 * body.mass * GRAVITY
    return float(plant.drive.gear_loss + body.rolling_resistance * side * body.wheel_radius)


@dataclass(frozen=True, eq=False)
class DriveLog:
    """The columns of a recording that the study uses, M samples."""

    name: str  # name of the log
    t: FloatArray  # (M,) time [s]
    rates: FloatArray  # (2, M) wheel rates, left and right [rad/s]
    commands: FloatArray | None  # (2, M) commanded speed [m/s] and yaw rate [rad/s]
    currents: FloatArray | None  # (2, M) currents, left and right [A]
    voltages: FloatArray | None  # (2, M) voltages, left and right [V]
    on_ground: bool  # whether the robot drove, as far as the log tells: it has a heading, or a gyro that shows something

    @property
    def signed(self) -> bool:
        """True if currents can be negative."""
        return self.currents is not None and bool((self.currents < -0.5).mean() > 0.01)

    def divided(self) -> tuple[DriveLog, DriveLog]:
        """Return its first two thirds, to be fitted, and its last third, which judges."""
        first = self.t < self.t[0] + FIT_SHARE * (self.t[-1] - self.t[0])
        columns = {
            name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        parts: list[dict[str, Any]] = [
            {n: c[..., keep] for n, c in columns.items()} for keep in (first, ~first)
        ]
        return replace(self, **parts[0]), replace(self, **parts[1])


def drive_log(source: str | Log) -> DriveLog:
    """Return what the study uses of a recording, or of the file at a path; a ValueError says that it has no wheel rates."""
    log = source if isinstance(source, Log) else read_log(source).on_one_clock()
    columns = log.columns

    def pair(first: str, second: str) -> FloatArray | None:
        return (
            np.stack([columns[first], columns[second]])
            if first in columns and second in columns
            else None
        )

    rates = pair("enc_left", "enc_right")
    if rates is None:
        raise ValueError(
            f"recording {log.name} has no wheel rates (enc_left, enc_right); it has {', '.join(columns)}"
        )
    turned = "yaw" in columns or bool(np.ptp(columns.get("gyro_z", np.zeros(1))) > 0.0)
    currents, voltages = (
        pair("current_left", "current_right"),
        pair("voltage_left", "voltage_right"),
    )
    return DriveLog(log.name, log.t, rates, pair("cmd_v", "cmd_w"), currents, voltages, turned)


def log_of_motions(name: str, motions: Sequence[Trajectory]) -> DriveLog | None:
    """Return stretches of a recording as one log; None where they have no currents."""
    if not all(CURRENTS in motion.channels for motion in motions):
        return None
    t = np.concatenate([motion.t for motion in motions])
    rates = np.concatenate([motion.wheels for motion in motions]).T
    currents = np.concatenate([motion.channels[CURRENTS] for motion in motions]).T
    volts = [motion.channels[VOLTAGES] for motion in motions if VOLTAGES in motion.channels]
    voltages = np.concatenate(volts).T if len(volts) == len(motions) else None
    return DriveLog(name, t, rates, None, currents, voltages, on_ground=True)


def require_currents(log: DriveLog) -> FloatArray:
    """Return the (2, M) currents of a log [A]; a ValueError says that it has none, or that they never change."""
    if log.currents is None:
        raise ValueError(f"{log.name} has no currents (current_left, current_right)")
    if not np.ptp(log.currents) > 0.0:
        raise ValueError(f"{log.name} has currents that never change")
    return log.currents


class Sensor(NamedTuple):
    """Properties of a log's current sensor that show without a fit."""

    ripple: float  # standard deviation of a steady current about its mean [A]
    idle: float  # mean reading of a bridge that does not drive [A]
    signed: bool  # true if readings can be negative


def sensor_of(log: DriveLog) -> Sensor:
    """Return what a log shows of its currents' sensor: the ripple of steady currents, and what it reads when idle."""
    currents = require_currents(log)
    if log.signed:
        return Sensor(0.0, 0.0, signed=True)
    least = float(np.abs(currents)[currents != 0.0].min(initial=np.inf))
    idle = 0.5 * least if math.isfinite(least) and least < 0.1 * np.abs(currents).max() else 0.0
    inside = [currents[:, window] for window in steady_windows(log)]
    ripples = [c.std(axis=1)[c.mean(axis=1) > 5.0 * max(idle, 0.1)] for c in inside]
    known = np.concatenate(ripples) if ripples else np.empty(0)
    return Sensor(float(np.median(known)) if len(known) else 1.0, idle, signed=False)


class CurrentSamples(NamedTuple):
    """Currents of one side each, in steady driving, n of them."""

    block: IndexArray  # (n,) which block of the bootstrap each belongs to
    side: IndexArray  # (n,) 0 for the left side, 1 for the right one
    rates: FloatArray  # (2, n) wheel rates, left and right [rad/s]
    rate: FloatArray  # (n,) wheel rate of each sample's own side [rad/s]
    current: FloatArray  # (n,) current of that side [A]
    voltage: FloatArray  # (n,) voltage of the battery [V]

    def resampled(self, rng: np.random.Generator) -> CurrentSamples:
        """Return as many blocks as there are, drawn with replacement."""
        members = [np.flatnonzero(self.block == b) for b in np.unique(self.block)]
        drawn = np.concatenate([members[k] for k in rng.integers(0, len(members), len(members))])
        some: list[Any] = [column[..., drawn] for column in self]
        return CurrentSamples(*some)


def steady_windows(log: DriveLog) -> list[NDArray[np.bool_]]:
    """Return the windows of a log in which the wheels turn steadily, each as (M,) bool without its beginning."""
    t, rates, windows, i = log.t, log.rates, [], 0
    while i < len(t) - 1:
        stop = int(np.searchsorted(t, t[i] + _MOST, side="right"))
        moved = np.abs(rates[:, i:stop] - rates[:, i : i + 1]).max(axis=0) >= _STEADY_RATE
        moved[1:] |= np.diff(t[i:stop]) >= _LONG_STEP
        j = i + (int(np.argmax(moved)) if moved.any() else len(moved)) - 1
        if t[j] - t[i] >= _SETTLE + _LEAST and np.abs(rates[:, i]).sum() > _STANDING:
            windows.append((t >= t[i] + _SETTLE) & (t <= t[j]))
        i = j + 1
    return windows


def window_samples(log: DriveLog, *, means: bool = True) -> CurrentSamples:
    """Return the currents of a log's steady windows: two means of each window, or all samples; a window is a block."""
    currents, rows = require_currents(log), []
    for k, window in enumerate(steady_windows(log)):
        voltage = _voltage(log, window)
        for part in [window] if means else np.flatnonzero(window)[:, None]:
            rates, read = log.rates[:, part].mean(axis=1), currents[:, part].mean(axis=1)
            rows += [(k, side, *rates, read[side], voltage) for side in (0, 1)]
    return _samples(rows)


def _refreshed(log: DriveLog) -> Iterator[tuple[int, int, NDArray[np.bool_]]]:
    """Yield side and sample of each new value of a slow sensor, and the (M,) samples that it tells of.

    Those are the samples just before it, where the rates hardly change.
    """
    t = log.t
    currents = require_currents(log)
    for side in (0, 1):
        for k in np.flatnonzero(np.diff(currents[side]) != 0.0) + 1:
            seen = (t > t[k] - _SEEN) & (t <= t[k] + 0.05)
            rates = log.rates[:, seen]
            gap = seen.sum() < _FEWEST or np.diff(t[seen]).max() >= _LONG_STEP
            calm = not gap and np.ptp(rates, axis=1).max() < _CALM
            if calm and np.abs(rates.mean(axis=1)).sum() > 2.0 * _STANDING:
                yield side, int(k), seen


def _refreshed_values(log: DriveLog) -> CurrentSamples:
    """Return each new value of a slow sensor with the mean wheel rates before it; some seconds are a block."""
    currents = require_currents(log)
    rows = list[tuple[float, ...]]()
    for side, k, seen in _refreshed(log):
        rates = log.rates[:, seen].mean(axis=1)
        block = log.t[k] // _BLOCK
        rows.append((block, side, *rates, currents[side, k], _voltage(log, seen)))
    return _samples(rows)


def steady_currents(log: DriveLog) -> FloatArray:
    """Return (2, M) currents in steady driving [A]; NaN elsewhere and of sides that stand."""
    currents = require_currents(log)
    known = np.full_like(currents, np.nan)
    if sampled_in_windows(log):
        for window in steady_windows(log):
            known[:, window] = currents[:, window]
    else:
        for side, k, seen in _refreshed(log):
            known[side, seen] = currents[side, k]
    return np.where(np.abs(log.rates) >= _SLOW_RATE, known, np.nan)


def sampled_in_windows(log: DriveLog) -> bool:
    """Return whether a log's currents are taken in steady windows, and not value by value of a slow sensor."""
    steps = [np.diff(log.t[np.flatnonzero(np.diff(c) != 0.0) + 1]) for c in require_currents(log)]
    known = np.concatenate(steps)
    return len(known) > 0 and float(np.median(known)) < _SLOW_SENSOR


def current_samples(log: DriveLog) -> CurrentSamples:
    """Return a log's currents in steady driving; a ValueError says that it has none."""
    return window_samples(log) if sampled_in_windows(log) else _refreshed_values(log)


def _samples(rows: list[tuple[float, ...]]) -> CurrentSamples:
    """Return rows of block, side, both rates, current and voltage; sides that stand are left out: bridges may be off."""
    block, side, left, right, current, voltage = np.array(rows, dtype=np.float64).reshape(-1, 6).T
    rates, own = np.stack([left, right]), np.where(side == 0.0, left, right)
    turns = np.abs(own) >= _SLOW_RATE
    columns: list[Any] = [block.astype(np.intp), side.astype(np.intp), rates, own, current, voltage]
    return CurrentSamples(*(column[..., turns] for column in columns))


def _voltage(log: DriveLog, which: NDArray[np.bool_]) -> float:
    """Return the mean voltage of both sides; where nothing was measured yet the log's median, or 24 V."""
    if log.voltages is None:
        return 24.0
    here, every = log.voltages[:, which], log.voltages[log.voltages > 1.0]
    if (here > 1.0).any():
        return float(here[here > 1.0].mean())
    return float(np.median(every)) if len(every) else 24.0
