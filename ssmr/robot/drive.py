"""The driver and the motors of every plant: from command to wheel rates, and on to torques.

Order, as in Fig. 3.10: a command is sampled at 20 Hz and held, or gone over to in a ramp, delayed,
saturated; v and omega move towards it no faster than their limits, and are turned into wheel-rate
references with the driver's own half-track and radius, which the motor controllers follow with a
lag. All times are whole physics steps, so a run repeats to the bit.

Measured wheel rates (`Commands.kind == "wheels"`) are used as references as they are: they have
already passed a driver.

A side's motor turns both of its wheels through a gear and a belt. Its controller asks for the
torque

    tau = K_P e + y,    dy/dt = K_I (e - y / K_dc),    e = reference - wheel rate,

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
from ssmr.parameters import pack_numbers
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State, is_finite_number

_WHOLE_STEPS = 1e-6
"""Distance from a whole number of physics steps that is put down to rounding [steps]."""
_MOST_STEPS = 1e7
"""Most physics steps in one period: hours of the finest ones."""


def whole_steps(period: float, dt: float, name: str) -> int:
    """Return the number of physics steps of `dt` [s] in `period` [s], which errors call `name`.

    Raises:
        ParameterError: not a whole number, less than one, or more than `_MOST_STEPS`.
    """
    steps = round(period / dt) if 0.0 < period / dt < _MOST_STEPS else 0
    if steps < 1 or abs(period / dt - steps) > _WHOLE_STEPS:
        raise ParameterError(
            f"{name} of {period} s is not a whole number of physics steps of {dt} s"
        )
    return steps


class Sides(NamedTuple):
    """A number for each side's wheels: rates [rad/s], speeds [m/s] or torques [N m]."""

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
def clip_to_limit(value: float, limit: float) -> float:
    """Clip to [-limit, limit]."""
    return min(max(value, -limit), limit)


@jit
def wheel_rates(v: Any, w: Any, half_track: float, radius: float) -> Sides:
    """Return the wheel rates [rad/s] of a body speed v [m/s] and yaw rate w [rad/s] (Eq. 2.9)."""
    return Sides((v - half_track * w) / radius, (v + half_track * w) / radius)


@jit
def body_rates(left: Any, right: Any, half_track: float, radius: float) -> tuple[Any, Any]:
    """Return the body speed [m/s] and yaw rate [rad/s] of wheel rates [rad/s] (Eq. 2.9)."""
    return 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half_track


@jit
def ramp_towards(reference: float, target: float, largest_change: float) -> float:
    """Move a reference towards its target by at most `largest_change`."""
    return reference + clip_to_limit(target - reference, largest_change)


@jit
def held_value(
    values: FloatArray, column: int, step: int, delay: int, drive: DriveNumbers, before: float
) -> float:
    """Return the value on which the driver acts, from one column of (N, 2) twists.

    It is that of `delay` steps ago, as last sampled. `step` counts the physics steps since the
    first command; `before` was commanded before it. Within the ramp the value lies between the last
    sample and the one before it: the mean of the held values over the time of the ramp.
    """
    past = step - delay
    if past < 0:
        return before
    final = len(values) - 1
    sample = past // drive.hold
    value: float = values[min(sample * drive.hold // drive.period, final), column]
    since = past - sample * drive.hold + 1
    if since >= drive.ramp:
        return value
    part = since / drive.ramp
    if sample == 0:
        return before + (value - before) * part
    last: float = values[min((sample - 1) * drive.hold // drive.period, final), column]
    return last + (value - last) * part


@jit
def follow_commands(
    values: FloatArray,
    step: int,
    drive: DriveNumbers,
    before: tuple[float, float],
    last: DriveState,
) -> DriveState:
    """Return the references of one physics step, `step` steps after the first command.

    `values` are (N, 2) twists. `before` is the twist commanded before the first command, `last`
    holds the references of the last step.
    """
    v = held_value(values, 0, step, drive.delay_v, drive, before[0])
    w = held_value(values, 1, step, drive.delay_w, drive, before[1])
    return drive_on(v, w, drive, drive.share, last)


@jit
def drive_on(v: float, w: float, drive: DriveNumbers, share: float, last: DriveState) -> DriveState:
    """Return the references of one physics step from the held twist, v [m/s] and w [rad/s].

    `share` is that of the drive, or 1 where nothing lags.
    """
    v = ramp_towards(last.v, clip_to_limit(v, drive.v_max), drive.change_v)
    w = ramp_towards(last.w, clip_to_limit(w, drive.w_max), drive.change_w)
    left = (v - drive.half_track * w) * drive.per_radius
    right = (v + drive.half_track * w) * drive.per_radius
    if share < 1.0:
        left = last.left + share * (left - last.left)
        right = last.right + share * (right - last.right)
    return DriveState(v, w, left, right)


@jit_alone
def rolling_references(wheels: Sides, drive: DriveNumbers) -> DriveState:
    """Return the references before the driver's first step, for the wheels' rates [rad/s]."""
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
    """Write the references of the steps from `first` on into (n, 2) `out`; return the last ones.

    `last` holds the references of the step before `first`.
    """
    held = last
    for k in range(len(out)):
        held = follow_commands(values, first + k, drive, before, held)
        out[k, 0] = held.left
        out[k, 1] = held.right
    return held


@lru_cache(maxsize=64)
def drive_numbers(drive: Drive, period: float, dt: float) -> DriveNumbers:
    """Return a drive's numbers for commands of a period [s] and physics steps `dt` [s].

    Delays are rounded to whole steps.

    Raises:
        ValueError: the hold or the command period is no whole number of steps.
    """
    d = pack_numbers(drive)
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
    """Return the (n, 2) wheel-rate references [rad/s] of all physics steps `dt` [s] of a run.

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
    """Yield the `wheel_references` in pieces: (`size`, 2) arrays, the last one shorter."""
    period = whole_steps(commands.dt, dt, "the command period")
    steps = commands.n * period
    if commands.kind == "wheels":
        for first in range(0, steps, size):
            step = np.arange(first, min(first + size, steps))
            yield commands.values[step // period]
        return
    numbers = drive_numbers(drive, commands.dt, dt)
    held = rolling_references(_wheel_rates(state), numbers)
    for first in range(0, steps, size):
        out = np.empty((min(size, steps - first), 2))
        held = continue_references(commands.values, numbers, commands.before, held, first, out)
        yield out


def _wheel_rates(state: State) -> Sides:
    return Sides(float(state.wheel_left), float(state.wheel_right))


def step_pushes(disturbance: FloatArray | None, steps: int) -> FloatArray:
    """Return the yaw accelerations of a run's physics steps [rad/s2]; (1,) 0 without any.

    Raises:
        ValueError: there is not one for each step.
    """
    if disturbance is None:
        return np.zeros(1)
    if len(disturbance) != steps:
        raise ValueError(f"{len(disturbance)} disturbances for {steps} physics steps")
    return np.ascontiguousarray(disturbance, dtype=np.float64)


class Driver:
    """The drive one command at a time, for closed loops; equal to `wheel_references` to the bit."""

    def __init__(self, drive: Drive, dt: float, state: State) -> None:
        """Start with delay lines full of zeros; ramp and lag start from the state's wheels."""
        if not isinstance(state, State):
            raise ValueError(f"state is {reprlib.repr(state)}, must be a State")
        self._drive = drive_numbers(drive, dt, dt)  # one command a physics step
        self._samples = np.empty((0, 2))
        self._last = rolling_references(_wheel_rates(state), self._drive)

    def references(self, command: tuple[float, float], n: int) -> FloatArray:
        """Return the (n, 2) references of the next `n` steps, while `command` is held.

        A command is v [m/s] and omega [rad/s].
        """
        if np.shape(command) != (2,) or not all(map(is_finite_number, command)):
            raise ValueError(
                f"command is {reprlib.repr(command)}, must be a finite speed [m/s] "
                "and yaw rate [rad/s]"
            )
        out = np.empty((n, 2))
        step = len(self._samples)
        drive = self._drive
        self._samples = np.concatenate([self._samples, np.tile(command, (n, 1))])
        self._last = continue_references(self._samples, drive, (0.0, 0.0), self._last, step, out)
        spare = len(self._samples) - max(drive.delay_v, drive.delay_w) - 2 * drive.hold
        # No delay reaches these samples any more. Whole holds go, so that none begins elsewhere.
        if spare > 1000:
            self._samples = self._samples[spare // drive.hold * drive.hold :]
        return out


_DRY_RATE = 0.05
"""Wheel rate below which the gear's dry friction is proportional to the rate [rad/s]: a planar step
knows no stuck gear."""
_PER_DRY_RATE = 1.0 / _DRY_RATE


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


@lru_cache(maxsize=64)
def motor_numbers(drive: Drive, dt: float) -> Motor:
    """Return the numbers of a drive's motors for physics steps `dt` [s]."""
    d = pack_numbers(drive)
    limit = 2.0 * d.torque_limit
    # an infinite no-load rate gives 0
    braking = 0.0 if math.isinf(limit) else limit / d.no_load_rate
    leaked, share = exact_step(d.integral_gain / d.dc_stiffness, dt)
    gained = share * d.integral_gain
    return Motor(limit, braking, d.integral_gain, leaked, gained, d.gear_loss)


def exact_step(rate: float, dt: float) -> tuple[float, float]:
    """Return (a, b) of an exact step `dt` [s] of dx/dt = -rate x + u for a constant u.

    The step ends at x + a x + b u: a is expm1(-rate dt) [1] and b is -a / rate, or dt where there
    is hardly a rate [s].
    """
    decay = math.expm1(-rate * dt)
    if rate * dt > 1e-12:
        return decay, -decay / rate
    return decay, dt


@jit
def side_torque(
    reference: float, actual: float, integral: float, gain: float, motor: Motor
) -> float:
    """Return the torque of a side's motor at its wheels [N m], before the gear's loss.

    The controller makes up for the voltage that the motor's rate takes, as far as there is voltage.
    """
    torque = gain * (reference - actual)
    if motor.integral_gain > 0.0:
        torque += integral
    if motor.braking > 0.0:
        back = motor.braking * actual
        return clip_to_limit(torque + back, motor.limit) - back
    return clip_to_limit(torque, motor.limit)


@jit
def motor_torques(
    wheels: Sides, integral: Sides, actual: Sides, gain: float, motor: Motor
) -> Sides:
    """Return the torques of both motors at the wheels [N m].

    The wheels turn at `actual` rates and are to turn at `wheels` [rad/s]; `integral` are the
    integral parts of the torques [N m].
    """
    return Sides(
        side_torque(wheels.left, actual.left, integral.left, gain, motor),
        side_torque(wheels.right, actual.right, integral.right, gain, motor),
    )


@jit
def gear_loss(rate: float, motor: Motor) -> float:
    """Return the torque that a side's gear takes at a wheel rate [N m]; it has the rate's sign."""
    if motor.gear_loss > 0.0:
        return motor.gear_loss * clip_to_limit(rate * _PER_DRY_RATE, 1.0)
    return 0.0


@jit
def side_thrusts(torque: Sides, actual: Sides, vehicle: Any, motor: Motor) -> Sides:
    """Return the forces [N] of both sides on the ground, as if wheels had no inertia."""
    left = torque.left - gear_loss(actual.left, motor)
    right = torque.right - gear_loss(actual.right, motor)
    return Sides(left * vehicle.per_radius_left, right * vehicle.per_radius_right)


@jit
def advance_integral(integral: float, error: float, motor: Motor) -> float:
    """Return the integral part of a side's torque [N m] after a physics step.

    The step is exact for a constant rate error, here the mean one [rad/s].
    """
    return clip_to_limit(integral + (motor.leaked * integral + motor.gained * error), motor.limit)


@jit
def side_rates(v: float, w: float, vehicle: Any) -> Sides:
    """Return the wheel rates [rad/s] of a body speed [m/s] and yaw rate [rad/s].

    It is Eq. 2.9, each side with its own radius.
    """
    reach = vehicle.effective_half_track
    left = v - reach * w
    right = v + reach * w
    return Sides(left * vehicle.per_radius_left, right * vehicle.per_radius_right)
