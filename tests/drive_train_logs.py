"""Synthetic logs of a robot whose driver, friction, losses and inertia are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr.robot.drivetrain import _quasi_static_twist, battery_current, side_forces
from ssmr.types import FloatArray
from validation.files.log import Log
from validation.identify.blocks import FitNumbers
from validation.identify.driver import driven_rates
from validation.identify.motor_logs import chassis_of
from validation.plants.kind import PlantProfile
from validation.plants.profile import choose_profile, load_profile

HUSKY, WARTHOG = (
    chassis_of(load_profile("husky-tile")),
    chassis_of(choose_profile(None, "warthog", "husky-tile"), mass=470.0),
)


LAW = {
    "dead_time": 0.08,
    "gain": 1.04,
    "half_track": 0.29,
    "yaw_rate_limit": 1.0,
    "acceleration": 2.2,
    "yaw_acceleration": 1.9,
    "lag": 0.04,
}
FRICTION, LOSSES, SLIP, RHO, INERTIA = 11.0, (2.0, 2.8), 0.09, 0.15, 0.2
"""Friction, losses [A], slip scale [1], resistance over voltage constant [rad/s per A], inertia [A
s^2/rad]."""
TORQUE, LOSS_TORQUES, HEAT, EFFICIENCY = 450.0, (40.0, 60.0), 0.003, 0.93
"""Friction and losses [N m], resistance over torque constant squared [W/(N m)^2], efficiency [1] of
a Warthog."""
AIR_LOSSES, RIPPLE, IDLE = (0.3, 1.1), 0.8, 0.59
"""Losses with wheels in the air, ripple on the ground, and readings of a bridge that does not drive
[A]."""
_FINE, _ROWS, _MESSAGES = 0.01, 0.05, 0.15
"""Periods of the computation, of the log's rows and of the robot's messages [s]."""


class Motion(NamedTuple):
    """A drive on a fine grid."""

    t: FloatArray
    commands: FloatArray
    """(n, 2) speeds [m/s] and yaw rates [rad/s]."""
    rates: FloatArray
    """(2, n) wheel rates [rad/s]."""


def random_drive(
    seed: int, commands: int, chassis: PlantProfile, law: FitNumbers = LAW, most: float = 0.7
) -> Motion:
    """Return random commands of 6 s each after 3 s of rest, and the wheel rates of a driver."""
    rng = np.random.default_rng(seed)
    chosen = np.vstack([np.zeros((1, 2)), rng.uniform([-most, -1.8], [most, 1.8], (commands, 2))])
    held = np.repeat(chosen, [300, *[600] * commands], axis=0)
    late = round(law["dead_time"] / _FINE)
    rates = driven_rates(held, _FINE, law, chassis.drive)[:, : len(held) - late]
    rates = np.hstack([np.zeros((2, 1 + late)), rates])
    return Motion(np.arange(len(held) + 1) * _FINE, np.vstack([held, held[-1:]]), rates)


def bridge_log(
    name: str, motion: Motion, current: FloatArray, ripple: float, seed: int, yaw: FloatArray | None
) -> Log:
    """Return the log of a Husky: set points in steps, and |I| while the bridge drives."""
    rng = np.random.default_rng(seed)
    chassis = HUSKY
    step = 0.01 / chassis.drive.command_radius
    sent = np.arange(0.0, motion.t[-1] - _ROWS, _MESSAGES)
    sent += rng.uniform(0.0, _ROWS, len(sent))  # at no fixed time from the rows
    at = np.rint(sent / _FINE).astype(int)
    rates = np.trunc(motion.rates[:, at] / step) * step
    true = current[:, at] + ripple * rng.standard_normal((2, len(at)))
    drives = true * (motion.rates[:, at] + RHO * true) > 0.0
    idle = IDLE * (rng.random((2, len(at))) < 0.5) if yaw is not None else IDLE
    readings = np.where(drives, np.abs(true) + (0.0 if yaw is not None else IDLE), idle)
    power = (motion.rates[:, at] * true + RHO * true**2).sum(axis=0)
    voltage = 25.0 - 0.014 * power + 0.005 * rng.standard_normal(len(at))
    rows = np.arange(0.0, motion.t[-1] - _FINE, _ROWS)
    last = np.maximum(np.searchsorted(sent, rows) - 1, 0)
    now = np.searchsorted(motion.t, rows)
    columns = {
        "t": rows, "cmd_v": motion.commands[now, 0], "cmd_w": motion.commands[now, 1],
        "enc_left": rates[0, last], "enc_right": rates[1, last],
        "current_left": readings[0, last], "current_right": readings[1, last],
        "voltage_left": voltage[last], "voltage_right": voltage[last],
    }  # fmt: skip
    if yaw is not None:
        columns["yaw"] = yaw[now] + 0.005 * rng.standard_normal(len(rows))
    return Log.of_columns(f"{name}.csv", columns)


def in_the_air(seed: int = 1, commands: int = 30, name: str = "up") -> Log:
    """Return a log of a Husky whose wheels are in the air."""
    motion = random_drive(seed, commands, HUSKY)
    slope = np.gradient(motion.rates, _FINE, axis=1)
    current = np.array(AIR_LOSSES)[:, None] * np.sign(motion.rates) + INERTIA * slope
    return bridge_log(name, motion, current, 0.05, seed, None)


def on_grass(seed: int = 2, commands: int = 40, name: str = "grass", slip: float = SLIP) -> Log:
    """Return a log of a Husky on grass that does not accelerate."""
    chassis = HUSKY
    motion = random_drive(seed, commands, chassis, most=0.5)
    effort, yaw = _effort(motion.rates, chassis, slip)
    current = FRICTION * effort + np.array(LOSSES)[:, None] * np.sign(motion.rates)
    return bridge_log(name, motion, current, RIPPLE, seed, yaw)


def warthog_on_grass(seed: int = 3, commands: int = 40, name: str = "warthog") -> Log:
    """Return a log of a Warthog: measured rates, a gyro, and battery currents once a second."""
    rng = np.random.default_rng(seed)
    chassis = WARTHOG
    motion = random_drive(
        seed, commands, chassis, {**LAW, "yaw_rate_limit": 3.0, "half_track": 0.55}, most=1.2
    )
    effort, yaw = _effort(motion.rates, chassis, SLIP)
    torque = TORQUE * effort + np.array(LOSS_TORQUES)[:, None] * np.sign(motion.rates)
    current = battery_current(torque, motion.rates, np.full_like(torque, 47.0), HEAT, EFFICIENCY)
    rows = np.arange(0.0, motion.t[-1] - 1.1, _ROWS)
    now = np.searchsorted(motion.t, rows)
    seen = now - now % 100
    rates = motion.rates[:, now] + 0.08 * rng.standard_normal((2, len(rows)))
    noise = rng.standard_normal((2, len(motion.t)))[:, seen]
    drawn = current[:, seen] + noise
    voltage = 47.0 - 0.01 * drawn.sum(axis=0)
    columns = {
        "t": rows,
        "cmd_v": motion.commands[now, 0],
        "cmd_w": motion.commands[now, 1],
        "enc_left": rates[0],
        "enc_right": rates[1],
        "gyro_z": np.gradient(yaw, _FINE)[now],
        "current_left": drawn[0],
        "current_right": drawn[1],
        "voltage_left": voltage,
        "voltage_right": voltage,
    }
    return Log.of_columns(f"{name}.csv", columns)


def _effort(rates: FloatArray, chassis: PlantProfile, slip: float) -> tuple[FloatArray, FloatArray]:
    """Return (2, n) forces over friction limits, (n,) headings of a robot without acceleration."""
    twist = _quasi_static_twist(rates, chassis.vehicle, slip)
    return side_forces(rates, chassis.vehicle, slip), np.cumsum(twist[2]) * _FINE
