"""The drive in front of every plant: saturation, hold, dead time, acceleration limits, wheel kinematics, lag, torque loop.

Order, as in Fig. 3.10: a command is sampled at 20 Hz and held, delayed, saturated; v and omega move towards it no faster
than their limits, and are turned into wheel-rate references with the driver's own half-track and radius, which the motor
controllers follow with a lag. All times are whole physics steps, so a run repeats to the bit.

Measured wheel rates (`Commands.kind == "wheels"`) are references as they are: the driver has already had its say.
"""

from __future__ import annotations

import math

import numpy as np

from ssmr._jit import jit
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State

WHOLE_STEPS = 1e-6
"""How far, in steps, a period may lie from a whole number of physics steps and still count as one."""
MOST_STEPS = 1e7
"""In one period: hours of the finest steps."""


def whole_steps(period: float, dt: float, what: str) -> int:
    """How many physics steps of `dt` make up `period`.

    Raises:
        ValueError: not a whole number, less than one, or more than `MOST_STEPS`.
    """
    steps = round(period / dt) if 0.0 < period / dt < MOST_STEPS else 0
    if steps < 1 or abs(period / dt - steps) > WHOLE_STEPS:
        raise ValueError(f"{what} of {period} s is not a whole number of physics steps of {dt} s")
    return steps


@jit
def saturate(value, limit):
    """Clip to [-limit, limit]."""
    return min(max(value, -limit), limit)


@jit
def wheel_rates(v, w, half_track, radius):
    """Left and right wheel rate [rad/s] of a body speed v [m/s] and yaw rate w [rad/s]: Eq. 2.9 solved for the wheels."""
    return (v - half_track * w) / radius, (v + half_track * w) / radius


@jit
def body_rates(left, right, half_track, radius):
    """Body speed [m/s] and yaw rate [rad/s] of wheel rates [rad/s] (Eq. 2.9)."""
    return 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half_track


@jit
def ramp(reference, target, largest_change):
    """Move a reference towards its target by at most `largest_change`."""
    return reference + saturate(target - reference, largest_change)


@jit
def wheel_torques(ref_left, ref_right, left, right, gain, side_limit):
    """Torques of the two sides [N m]: proportional loop on the wheel rates (Eq. 2.32), saturated (Fig. 3.11)."""
    return saturate(gain * (ref_left - left), side_limit), saturate(gain * (ref_right - right), side_limit)


@jit
def held_value(values, column, step, delay_steps, hold_steps, period_steps, before):
    """What the driver acts on: the command of `delay` ago, as last sampled; `before` where there was none."""
    past = step - delay_steps
    if past < 0:
        return before
    return values[min((past // hold_steps) * hold_steps // period_steps, len(values) - 1), column]


@jit
def follow(values, step, limits, steps, before, state):
    """Advance the driver by one physics step.

    Args:
        values: (N, 2) twist commands.
        step: which physics step since the first command.
        limits: v_max [m/s], w_max [rad/s], command half-track [m], command radius [m], greatest change of v [m/s] and of
            omega [rad/s] in a step, share of its way that a wheel-rate reference goes in a step [1].
        steps: delays of v and of omega, hold, command period, in physics steps.
        before: the twist commanded before the first.
        state: v [m/s] and omega [rad/s] asked for, references of the left and the right wheels [rad/s], at the last step.

    Returns:
        The state at this step.
    """
    v = saturate(held_value(values, 0, step, steps[0], steps[2], steps[3], before[0]), limits[0])
    w = saturate(held_value(values, 1, step, steps[1], steps[2], steps[3], before[1]), limits[1])
    v, w = ramp(state[0], v, limits[4]), ramp(state[1], w, limits[5])
    left, right = wheel_rates(v, w, limits[2], limits[3])
    if limits[6] < 1.0:
        left, right = state[2] + limits[6] * (left - state[2]), state[3] + limits[6] * (right - state[3])
    return v, w, left, right


@jit
def fill_references(values, limits, steps, before, left, right, out):
    """Wheel-rate references of `len(out)` physics steps, from wheels that turn at (left, right); writes (n, 2) `out`."""
    v, w = body_rates(left, right, limits[2], limits[3])
    state = (v, w, left, right)
    for k in range(len(out)):
        state = follow(values, k, limits, steps, before, state)
        out[k, 0] = state[2]
        out[k, 1] = state[3]


def packed(drive: Drive, period: float, dt: float) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """What the compiled loops want of a drive.

    Returns:
        The `limits` and the `steps` of `follow`.

    Raises:
        ValueError: the hold or the command period is no whole number of steps; delays are rounded.
    """
    share = 1.0 if drive.wheel_lag == 0.0 else -math.expm1(-dt / drive.wheel_lag)  # exact for a reference that is held
    limits = (
        drive.v_max,
        drive.w_max,
        drive.command_half_track,
        drive.command_radius,
        drive.acceleration_v * dt,
        drive.acceleration_w * dt,
        share,
    )
    steps = (
        round(drive.delay_v / dt),
        round(drive.delay_w / dt),
        whole_steps(drive.hold, dt, "the drive's hold"),
        whole_steps(period, dt, "the command period"),
    )
    return limits, steps


def wheel_references(commands: Commands, drive: Drive, dt: float, state: State) -> FloatArray:
    """Wheel-rate references of every physics step.

    Args:
        commands: what is commanded, over `commands.duration`.
        drive: the driver; delays are rounded to whole steps.
        dt: physics step [s].
        state: where the robot starts; ramp and lag start from its wheel rates.

    Returns:
        (n, 2) left and right [rad/s].

    Raises:
        ValueError: the command period or the hold is no whole number of steps.
    """
    period_steps = whole_steps(commands.dt, dt, "the command period")
    if commands.kind == "wheels":
        return np.repeat(commands.values, period_steps, axis=0)
    out = np.empty((commands.n * period_steps, 2))
    limits, steps = packed(drive, commands.dt, dt)
    fill_references(commands.values, limits, steps, commands.before, state.wheel_left, state.wheel_right, out)
    return out


class Driver:
    """The same drive, one command at a time, for closed loops; equal to `wheel_references` to the bit."""

    def __init__(self, drive: Drive, dt: float, state: State, before: tuple[float, float] = (0.0, 0.0)) -> None:
        """Start with empty delay lines: `before` was commanded until now; ramp and lag start from the state's wheels."""
        self._limits, self._steps = packed(drive, dt, dt)  # one command a physics step
        self._before = before
        self._samples: list[tuple[float, float]] = []
        left, right = state.wheel_left, state.wheel_right
        self._state = (*body_rates(left, right, drive.command_half_track, drive.command_radius), left, right)

    def references(self, command: tuple[float, float], n: int) -> FloatArray:
        """(n, 2) references of the next `n` physics steps, while `command` (v [m/s], omega [rad/s]) is held."""
        step = len(self._samples)
        self._samples.extend([command] * n)
        values = np.array(self._samples, dtype=np.float64)
        out = np.empty((n, 2))
        for k in range(n):
            self._state = follow(values, step + k, self._limits, self._steps, self._before, self._state)
            out[k] = self._state[2:]
        self._forget()
        return out

    def _forget(self) -> None:
        """Drop, a whole number of holds at a time, the samples that no delay reaches any more."""
        hold = self._steps[2]
        spare = len(self._samples) - max(self._steps[0], self._steps[1]) - hold
        if spare > 1000:
            del self._samples[: spare // hold * hold]
