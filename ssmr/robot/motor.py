"""The motor of each side: a speed loop with a leaky integral part, limits of torque and voltage, gear, and spinning inertia.

A side's motor turns both of its wheels through a gear and a belt. Its controller asks for the torque

    tau = K_P e + y,    dy/dt = K_I (e - y / K_dc),    e = wanted rate - wheel rate,

so a lasting load tau costs a rate of tau / (K_P + K_dc), and a short one tau / K_P. K_I = 0 leaves the proportional loop of
the thesis (Eq. 2.32). A motor whose voltage is limited loses torque in proportion to its rate: with stall torque L and
no-load rate w_0 the torque lies within [-L (1 + w / w_0), L (1 - w / w_0)]. The integral part is held within L, so that a
wheel that is stuck does not wind it up. The gear takes a dry friction torque, and rotor, gear and wheels have an inertia
that the thrust accelerates too.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

from ssmr._jit import jit
from ssmr.parameters import packed
from ssmr.robot.drive import Sides, saturate
from ssmr.robot.vehicle import Drive

DRY_RATE = 0.05
"""Wheel rate below which the gear's dry friction is proportional to the rate [rad/s]: a planar step knows no stuck gear."""
_PER_DRY_RATE = 1.0 / DRY_RATE


class Motor(NamedTuple):
    """Numbers of one side's motor for one physics step, for compiled functions."""

    limit: float  # greatest torque of a side at rest [N m]
    braking: float  # torque that a motor at full voltage loses with its rate [N m s/rad]; 0 without a no-load rate
    integral_gain: float  # K_I [N m/rad]
    leaked: float  # change of the integral part in a step without an error, over the part itself [1]; not positive
    gained: float  # change of the integral part in a step, over a constant rate error [N m s/rad]
    gear_loss: float  # dry friction torque of a side's gear [N m]


class Wanted(NamedTuple):
    """The references and the integral torques of both sides' controllers at one physics step."""

    left: float  # reference of the left wheels' rate [rad/s]
    right: float  # reference of the right wheels' rate [rad/s]
    integral_left: float  # integral part of the left side's torque [N m]
    integral_right: float  # integral part of the right side's torque [N m]


@lru_cache(maxsize=64)
def motor_numbers(drive: Drive, dt: float) -> Motor:
    """Return the numbers of a drive's motors for physics steps `dt` [s]."""
    d = packed(drive)
    limit = 2.0 * d.torque_limit
    braking = 0.0 if math.isinf(d.no_load_rate) or math.isinf(limit) else limit / d.no_load_rate
    leaked, share = exact_step(d.integral_gain / d.dc_stiffness, dt)
    return Motor(limit, braking, d.integral_gain, leaked, share * d.integral_gain, d.gear_loss)


def exact_step(rate: float, dt: float) -> tuple[float, float]:
    """Return the numbers (a, b) with which a step `dt` [s] of dx/dt = -rate x + u is exactly x + a x + b u for a constant u.

    a is expm1(-rate dt) [1] and b is -a / rate, or dt where there is hardly a rate [s].
    """
    decay = math.expm1(-rate * dt)
    return decay, -decay / rate if rate * dt > 1e-12 else dt


@jit
def side_torque(wanted: float, actual: float, integral: float, gain: float, motor: Motor) -> float:
    """Return the torque of a side's motor at its wheels [N m], before the gear's loss.

    The controller makes up for the voltage that the motor's rate takes, as far as there is voltage.
    """
    torque = gain * (wanted - actual)
    if motor.integral_gain > 0.0:
        torque += integral
    if motor.braking > 0.0:
        back = motor.braking * actual
        return saturate(torque + back, motor.limit) - back
    return saturate(torque, motor.limit)


@jit
def motor_torques(wanted: Wanted, actual: Sides, gain: float, motor: Motor) -> Sides:
    """Return the torques of both sides' motors at the wheels [N m]; `actual` are the wheel rates [rad/s]."""
    return Sides(
        side_torque(wanted.left, actual.left, wanted.integral_left, gain, motor),
        side_torque(wanted.right, actual.right, wanted.integral_right, gain, motor),
    )


@jit
def gear_loss(rate: float, motor: Motor) -> float:
    """Return the torque that the gear of a side takes at a wheel rate [N m], in the direction of the rate."""
    return motor.gear_loss * saturate(rate * _PER_DRY_RATE, 1.0) if motor.gear_loss > 0.0 else 0.0


@jit
def thrusts(torque: Sides, actual: Sides, vehicle: Any, motor: Motor) -> Sides:
    """Return the forces [N] with which both sides push on the ground, but for what spins the wheels up."""
    return Sides(
        (torque.left - gear_loss(actual.left, motor)) * vehicle.per_radius_left,
        (torque.right - gear_loss(actual.right, motor)) * vehicle.per_radius_right,
    )


@jit
def advance_integral(integral: float, error: float, motor: Motor) -> float:
    """Return the integral part of a side's torque [N m] after a physics step with a mean rate error [rad/s].

    The step is exact for a constant error.
    """
    return saturate(integral + (motor.leaked * integral + motor.gained * error), motor.limit)


@jit
def side_rates(v: float, w: float, vehicle: Any) -> Sides:
    """Return the wheel rates [rad/s] of a body speed [m/s] and yaw rate [rad/s]: Eq. 2.9, each side with its own radius."""
    reach = vehicle.effective_half_track
    return Sides((v - reach * w) * vehicle.per_radius_left, (v + reach * w) * vehicle.per_radius_right)
