"""The driver in front of every plant, from command to wheel rates, and the motors behind it, from wheel rates to torques.

Order, as in Fig. 3.10: a command is sampled at 20 Hz and held, or gone over to in a ramp, delayed,
saturated; v and omega move towards it no faster than their limits, and are turned into wheel-rate
references with the driver's own half-track and radius, which the motor controllers follow with a
lag. All times are whole physics steps, so a run repeats to the bit.

Measured wheel rates (`Commands.kind == "wheels"`) are used as references as they are: they have
already passed a driver.

A side's motor turns both of its wheels through a gear and a belt. Its controller asks for the
torque

    tau = K_P e + y,    dy/dt = K_I (e - y / K_dc),    e = wanted rate - wheel rate,

so a lasting load tau costs a rate of tau / (K_P + K_dc), and a short one tau / K_P. K_I = 0 leaves
the proportional loop of the thesis (Eq. 2.32). A motor whose voltage is limited loses torque in
proportion to its rate: with stall torque L and no-load rate w_0 the torque lies within [-L (1 + w /
w_0), L (1 - w / w_0)]. The integral part is held within L, so that a wheel that is stuck does not
wind it up. The gear takes a dry friction torque, and rotor, gear and wheels have an inertia that
the thrust accelerates too.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import jit, jit_alone
from ssmr.errors import ParameterError
from ssmr.parameters import packed
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State, is_finite_number

WHOLE_STEPS = 1e-6
"""Distance from a whole number of physics steps that is put down to rounding [steps]."""
MOST_STEPS = 1e7
"""Most physics steps in one period: hours of the finest ones."""


def whole_steps(period: float, dt: float, what: str) -> int:
    """Return the number of physics steps of `dt` [s] that make up `period` [s]; `what` names the period in an error.

    Raises:
        ParameterError: not a whole number, less than one, or more than `MOST_STEPS`.
    """
    steps = round(period / dt) if 0.0 < period / dt < MOST_STEPS else 0
    if steps < 1 or abs(period / dt - steps) > WHOLE_STEPS:
        raise ParameterError(
            f"{what} of {period} s is not a whole number of physics steps of {dt} s"
        )
    return steps


class Sides(NamedTuple):
    """One number for the left wheels and one for the right: rates [rad/s], speeds [m/s] or torques [N m]."""

    left: float
    right: float


class DriveNumbers(NamedTuple):
    """A `Drive` for one physics step and one command period, for compiled functions."""

    v_max: float  # saturation of the linear velocity command [m/s]
    w_max: float  # saturation of the yaw-rate command [rad/s]
    half_track: float  # half-track of the driver [m]
    radius: float  # wheel radius of the driver [m]
    per_radius: float  # its reciprocal [1/m]
    change_v: float  # greatest change of v in a step [m/s]
    change_w: float  # greatest change of omega in a step [rad/s]
    # share of its way that a lagging wheel-rate reference goes in a step [1]; 1 without lag
    share: float
    delay_v: int  # delay of v in steps
    delay_w: int  # delay of omega in steps
    hold: int  # steps for which the driver holds a command
    ramp: int  # steps in which it goes over to the next command; 0: at once
    period: int  # steps of a command period


class DriveState(NamedTuple):
    """Body speeds and wheel rates that the driver asks for at one physics step."""

    v: float  # linear velocity [m/s]
    w: float  # yaw rate [rad/s]
    left: float  # reference of the left wheels' rate [rad/s]
    right: float  # reference of the right wheels' rate [rad/s]


DRIVE_TEMPLATE = DriveNumbers(*(0.0,) * 8, *(0,) * 5)
"""Template for `ssmr._jit.named_like`."""


@jit
def saturate(value: float, limit: float) -> float:
    """Clip to [-limit, limit]."""
    return min(max(value, -limit), limit)


@jit
def wheel_rates(v: Any, w: Any, half_track: float, radius: float) -> Sides:
    """Return the wheel rates [rad/s] of a body speed v [m/s] and yaw rate w [rad/s]: Eq. 2.9 solved for the wheels."""
    return Sides((v - half_track * w) / radius, (v + half_track * w) / radius)


@jit
def body_rates(left: Any, right: Any, half_track: float, radius: float) -> tuple[Any, Any]:
    """Return the body speed [m/s] and yaw rate [rad/s] of wheel rates [rad/s] (Eq. 2.9)."""
    return 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half_track


@jit
def ramp(reference: float, target: float, largest_change: float) -> float:
    """Move a reference towards its target by at most `largest_change`."""
    return reference + saturate(target - reference, largest_change)


@jit
def held_value(
    values: FloatArray, column: int, step: int, delay: int, drive: DriveNumbers, before: float
) -> float:
    """Return the value in one column of (N, 2) twists on which the driver acts: that of `delay` steps ago, as last sampled.

    `step` counts the physics steps since the first command; `before` was commanded before it.
    Within the ramp the value lies between the last sample and the one before it: the mean of the
    held values over the time of the ramp.
    """
    past = step - delay
    if past < 0:
        return before
    sample = past // drive.hold
    value: float = values[min(sample * drive.hold // drive.period, len(values) - 1), column]
    since = past - sample * drive.hold + 1
    if since >= drive.ramp:
        return value
    last: float = (
        before
        if sample == 0
        else values[min((sample - 1) * drive.hold // drive.period, len(values) - 1), column]
    )
    return last + (value - last) * (since / drive.ramp)


@jit
def follow(
    values: FloatArray,
    step: int,
    drive: DriveNumbers,
    before: tuple[float, float],
    last: DriveState,
) -> DriveState:
    """Return the references of one physics step, `step` steps after the first of the (N, 2) twist commands.

    `before` is the twist commanded before the first command, `last` holds the references of the
    last step.
    """
    v = held_value(values, 0, step, drive.delay_v, drive, before[0])
    w = held_value(values, 1, step, drive.delay_w, drive, before[1])
    return drive_on(v, w, drive, drive.share, last)


@jit
def drive_on(v: float, w: float, drive: DriveNumbers, share: float, last: DriveState) -> DriveState:
    """Return the references of one physics step from the twist that the driver holds, v [m/s] and w [rad/s].

    `share` is the drive's own, or 1 where it is known that nothing lags.
    """
    v = ramp(last.v, saturate(v, drive.v_max), drive.change_v)
    w = ramp(last.w, saturate(w, drive.w_max), drive.change_w)
    left = (v - drive.half_track * w) * drive.per_radius
    right = (v + drive.half_track * w) * drive.per_radius
    if share < 1.0:
        left = last.left + share * (left - last.left)
        right = last.right + share * (right - last.right)
    return DriveState(v, w, left, right)


@jit_alone
def rolling(wheels: Sides, drive: DriveNumbers) -> DriveState:
    """Return the references before the driver's first step, when the wheels turn at `wheels` [rad/s]."""
    v, w = body_rates(wheels.left, wheels.right, drive.half_track, drive.radius)
    return DriveState(v, w, wheels.left, wheels.right)


@jit_alone
def continue_references(
    values: FloatArray,
    drive: DriveNumbers,
    before: tuple[float, float],
    last: DriveState,
    first: int,
    out: FloatArray,
) -> DriveState:
    """Write the references of the physics steps from `first` on into `out`, (n, 2); return those of the last step.

    `last` holds the references of the step before `first`.
    """
    held = last
    for k in range(len(out)):
        held = follow(values, first + k, drive, before, held)
        out[k, 0] = held.left
        out[k, 1] = held.right
    return held


@lru_cache(maxsize=64)
def drive_numbers(drive: Drive, period: float, dt: float) -> DriveNumbers:
    """Return a drive's numbers for commands of a period [s] and physics steps `dt` [s]; delays are rounded to whole steps.

    Raises:
        ValueError: the hold or the command period is no whole number of steps.
    """
    d = packed(drive)
    return DriveNumbers(
        v_max=d.v_max,
        w_max=d.w_max,
        half_track=d.command_half_track,
        radius=d.command_radius,
        per_radius=1.0 / d.command_radius,
        change_v=d.acceleration_v * dt,
        change_w=d.acceleration_w * dt,
        # exact for a reference that is held
        share=1.0 if d.wheel_lag == 0.0 else -math.expm1(-dt / d.wheel_lag),
        delay_v=round(d.delay_v / dt),
        delay_w=round(d.delay_w / dt),
        hold=whole_steps(drive.hold, dt, "the drive's hold"),
        ramp=round(d.command_ramp / dt),
        period=whole_steps(period, dt, "the command period"),
    )


def wheel_references(commands: Commands, drive: Drive, dt: float, state: State) -> FloatArray:
    """Return the (n, 2) left and right wheel-rate references [rad/s] of every physics step `dt` [s] of a whole run.

    Ramp and lag start from the wheel rates of `state`; delays are rounded to whole steps.

    Raises:
        ValueError: the command period or the hold is no whole number of steps.
    """
    steps = commands.n * whole_steps(commands.dt, dt, "the command period")
    (references,) = reference_chunks(commands, drive, dt, state, steps)
    return references


def reference_chunks(
    commands: Commands, drive: Drive, dt: float, state: State, size: int
) -> Iterator[FloatArray]:
    """Yield what `wheel_references` returns, piece by piece: (`size`, 2) arrays, the last one shorter."""
    period = whole_steps(commands.dt, dt, "the command period")
    numbers = drive_numbers(drive, commands.dt, dt) if commands.kind == "twist" else DRIVE_TEMPLATE
    held = (
        rolling(Sides(float(state.wheel_left), float(state.wheel_right)), numbers)
        if commands.kind == "twist"
        else None
    )
    for first in range(0, commands.n * period, size):
        n = min(size, commands.n * period - first)
        if held is None:
            yield commands.values[np.arange(first, first + n) // period]
        else:
            out = np.empty((n, 2))
            held = continue_references(commands.values, numbers, commands.before, held, first, out)
            yield out


class Driver:
    """The drive as an object that takes one command at a time, for closed loops; equal to `wheel_references` to the bit."""

    def __init__(self, drive: Drive, dt: float, state: State) -> None:
        """Start at rest commands: delay lines hold zeros; ramp and lag start from the state's wheels."""
        if not isinstance(state, State):
            raise ValueError(f"state is {reprlib.repr(state)}, must be a State")
        self._drive = drive_numbers(drive, dt, dt)  # one command a physics step
        self._samples = np.empty((0, 2))
        self._asked = rolling(Sides(float(state.wheel_left), float(state.wheel_right)), self._drive)

    def references(self, command: tuple[float, float], n: int) -> FloatArray:
        """Return the (n, 2) references of the next `n` physics steps, while `command` (v [m/s], omega [rad/s]) is held."""
        if np.shape(command) != (2,) or not all(map(is_finite_number, command)):
            raise ValueError(
                f"command is {reprlib.repr(command)}, must be a finite speed [m/s] and yaw rate [rad/s]"
            )
        out = np.empty((n, 2))
        step = len(self._samples)
        self._samples = np.concatenate([self._samples, np.tile(command, (n, 1))])
        self._asked = continue_references(
            self._samples, self._drive, (0.0, 0.0), self._asked, step, out
        )
        hold = self._drive.hold
        spare = len(self._samples) - max(self._drive.delay_v, self._drive.delay_w) - 2 * hold
        if spare > 1000:  # no delay reaches these samples any more; whole holds are dropped
            self._samples = self._samples[spare // hold * hold :]
        return out


DRY_RATE = 0.05
"""Wheel rate below which the gear's dry friction is proportional to the rate [rad/s]: a planar step
knows no stuck gear."""
_PER_DRY_RATE = 1.0 / DRY_RATE


class Motor(NamedTuple):
    """Numbers of one side's motor for one physics step, for compiled functions."""

    limit: float  # greatest torque of a side at rest [N m]
    # torque that a motor at full voltage loses with its rate [N m s/rad]; 0 without a no-load rate
    braking: float
    integral_gain: float  # K_I [N m/rad]
    # change of the integral part in a step without an error, over the part itself [1]; not positive
    leaked: float
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
    return Sides(
        (v - reach * w) * vehicle.per_radius_left, (v + reach * w) * vehicle.per_radius_right
    )
