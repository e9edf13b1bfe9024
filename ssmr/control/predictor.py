"""The robot one dead time ahead: where it will be when the next command acts.

A law that acts on the state of now controls a robot that has moved on when its command arrives. The
predictor (O. Smith, 1957) carries the state over the dead time: the driver's references follow from
the commands that were sent already, and speed and yaw rate follow these by the linear model
(Eq. 2.46). The law then acts on that state and on its target. As it drives, the predictor learns
which share of the model's speed and yaw rate the robot has, and how it slips in bends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssmr._jit import jit, jit_alone
from ssmr.control.law import Command, Observation
from ssmr.robot.drive import body_rates, ramp, saturate
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, State

PREDICTION_STEP = 0.01
"""Longest step of a prediction [s]."""
_ROUNDING = 1e-9
"""Times nearer than this are one instant [s]."""
MEMORY = 1.0
"""Time over which a predictor averages how the robot differs from its model [s]: longer than the
robot's own time constants, and about that of a bend."""
LEAST_V = 0.1
"""Speed from which on the robot's differences count for more than the model [m/s]."""
LEAST_W = 0.2
"""Yaw rate from which on the robot's differences count for more than the model [rad/s]."""
STEADY_V = 0.5
"""Change of speed at which an observation counts half [m/s2]."""
STEADY_W = 3.0
"""Change of yaw rate at which an observation counts half [rad/s2]."""
GAINS_V = (0.8, 1.2)
GAINS_W = (0.5, 1.5)
SLIPS = (-0.3, 0.3)
"""Bounds of the learnt gains of speed and of yaw rate [1] and of the learnt slip [m]. Tyres roll on
up to 13 % less than the driver's radius. A robot with less than 0.8 of its model's speed still
gathers speed, as far as its torques allow."""


class PredictorModel(NamedTuple):
    """The numbers by which a robot's motion is predicted, for compiled functions."""

    horizon: float  # time that is looked ahead [s]: the longer of the two dead times
    rate_v: float  # rate at which the speed settles [1/s]
    push_v: float  # acceleration by a reference of 1 m/s [1/s]
    rate_w: float  # rate at which the yaw rate settles [1/s]
    push_w: float  # yaw acceleration by a reference of 1 rad/s [1/s]
    delay_v: float  # dead time of the speed command [s]
    delay_w: float  # dead time of the yaw-rate command [s]
    period: float  # time between commands [s]
    ramp: float  # time in which the driver goes from one command to the next [s]
    v_max: float  # saturation of the speed command [m/s]
    w_max: float  # saturation of the yaw-rate command [rad/s]
    acceleration_v: float  # greatest rate of change of the speed's reference [m/s2]
    acceleration_w: float  # greatest rate of change of the yaw rate's reference [rad/s2]
    lag: float  # time constant with which the wheels follow their references [s]
    step: float  # longest step of the prediction [s]


class DriverEstimate(NamedTuple):
    """The references of the driver at one instant, and the learnt gains and slip.

    The references are those after its limits, and those after the lag of the wheels too.
    """

    v: float
    w: float
    lagged_v: float
    lagged_w: float
    gain_v: float  # share of the model's speed that the robot really has [1]
    gain_w: float  # share of the model's yaw rate that the robot really has [1]
    slip: float  # lateral speed to the left over yaw rate [m]: in bends wheels slip outwards


NO_PREDICTOR = PredictorModel(*(0.0,) * len(PredictorModel._fields))
"""Template for `named_like`."""
MEMORY_NUMBERS = 16
"""Length of the row of numbers that a predictor remembers beside the commands, in this order:

- references of speed and yaw rate after the driver's limits, then after the lag of the wheels too
- mission times of all this, and of the newest command [s]
- speed and yaw rate of the model without feedback
- mean square of that speed, mean product of it and the robot's speed; the same of yaw rates
- mean product of the model's yaw rate and the robot's lateral speed
- pose of the robot when it was seen last.
"""
_DRIVER = 0
_AT = 4
_SENT_AT = 5
_MODEL_V = 6
_MODEL_W = 7
_VV = 8
_V_SEEN = 9
_WW = 10
_W_SEEN = 11
_W_ASIDE = 12
_POSE = 13


def predictor_model(a: FloatArray, b: FloatArray, drive: Drive, period: float) -> PredictorModel:
    """Return a predictor's numbers from (4, 4) `a` and (4, 2) `b` of the linear model (Eq. 2.46).

    `drive` is the driver between command and wheels, as far as it is known, `period` the time
    between commands [s].
    """
    return PredictorModel(
        horizon=max(drive.delay_v, drive.delay_w),
        rate_v=-float(a[1][1]),
        push_v=float(b[1][0]),
        rate_w=-float(a[3][3]),
        push_w=float(b[3][1]),
        delay_v=drive.delay_v,
        delay_w=drive.delay_w,
        period=period,
        ramp=drive.command_ramp,
        v_max=drive.v_max,
        w_max=drive.w_max,
        acceleration_v=drive.acceleration_v,
        acceleration_w=drive.acceleration_w,
        lag=drive.wheel_lag,
        step=PREDICTION_STEP,
    )


def commands_under_way(model: PredictorModel) -> int:
    """Return how many commands a predictor must remember."""
    return math.ceil(model.horizon / model.period) + 3


def predictor_start(state: State, drive: Drive, period: float) -> FloatArray:
    """Return the memory of a predictor whose robot has rolled as in `state` before the start."""
    half_track = drive.command_half_track
    rates = body_rates(state.wheel_left, state.wheel_right, half_track, drive.command_radius)
    memory = np.zeros(MEMORY_NUMBERS)
    memory[:_AT] = np.tile(rates, 2)
    memory[_SENT_AT] = -period
    memory[_MODEL_V] = state.v_x
    memory[_MODEL_W] = state.yaw_rate
    memory[_POSE:] = state.x, state.y, state.yaw
    return memory


@jit
def commanded(
    past: FloatArray, column: int, sent_at: float, when: float, model: PredictorModel
) -> float:
    """Return the value on which the driver acts that samples at time `when` [s], without dead time.

    Column 0 of the (n, 2) `past` commands is the speed, column 1 the yaw rate; the newest one, the
    last, was sent at `sent_at` [s].
    """
    back = max(math.ceil((sent_at - when) / model.period - _ROUNDING), 0)
    k = max(len(past) - 1 - back, 0)
    value: float = past[k, column]
    since = max(when - (sent_at - back * model.period), 0.0)  # rounding makes it negative
    if k == 0 or since >= model.ramp:
        return value
    last: float = past[k - 1, column]
    return last + (value - last) * (since / model.ramp)


@jit
def approach(value: float, target: float, share: float) -> float:
    """Return a value that has gone a share of its way to a target."""
    return value + share * (target - value)


@jit
def advance_driver(
    past: FloatArray,
    sent_at: float,
    t: float,
    dt: float,
    before: DriverEstimate,
    model: PredictorModel,
) -> DriverEstimate:
    """Return the driver's references after a step from `t` to `t + dt` [s], see `commanded`."""
    when = t + (dt if model.ramp > 0.0 else 0.5 * dt)  # a ramp has gone on to the end of the step
    v = saturate(commanded(past, 0, sent_at, when - model.delay_v, model), model.v_max)
    w = saturate(commanded(past, 1, sent_at, when - model.delay_w, model), model.w_max)
    v = ramp(before.v, v, model.acceleration_v * dt)
    w = ramp(before.w, w, model.acceleration_w * dt)
    share = -math.expm1(-dt / model.lag) if model.lag > 0.0 else 1.0
    return DriverEstimate(
        v=v,
        w=w,
        lagged_v=approach(before.lagged_v, v, share),
        lagged_w=approach(before.lagged_w, w, share),
        gain_v=before.gain_v,
        gain_w=before.gain_w,
        slip=before.slip,
    )


@jit
def relax(x: float, rate: float, drive: float, dt: float) -> float:
    """Return x after an exact step of dx/dt = -rate x + drive, for a constant drive."""
    if rate * dt < 1e-12:
        return x + dt * drive
    return x + math.expm1(-rate * dt) * (x - drive / rate)


@jit
def respond(
    v: float, w: float, driver: DriverEstimate, dt: float, model: PredictorModel
) -> tuple[float, float]:
    """Return speed and yaw rate after a step of the linear model with the learnt gains."""
    drive_v = model.push_v * driver.gain_v * driver.lagged_v
    drive_w = model.push_w * driver.gain_w * driver.lagged_w
    return relax(v, model.rate_v, drive_v, dt), relax(w, model.rate_w, drive_w, dt)


@jit
def learn(memory: FloatArray, changes: Command, seen: Observation, elapsed: float) -> None:
    """Take in the robot's motion in the `elapsed` time [s] beside that of the model, in place.

    These are least squares that forget. Gains are lasting ones, so what is seen while the model's
    speeds change, by `changes` in this time, counts for less.
    """
    share = min(elapsed / MEMORY, 1.0)
    v = memory[_MODEL_V]
    w = memory[_MODEL_W]
    change_v = changes.v / (elapsed * STEADY_V)
    change_w = changes.w / (elapsed * STEADY_W)
    share_v = share / (1.0 + change_v * change_v)
    share_w = share / (1.0 + change_w * change_w)
    x = memory[_POSE]
    y = memory[_POSE + 1]
    heading = 0.5 * (memory[_POSE + 2] + seen.yaw)
    aside = math.cos(heading) * (seen.y - y) - math.sin(heading) * (seen.x - x)
    v_y = aside / elapsed
    memory[_VV] = approach(memory[_VV], v * v, share_v)
    memory[_V_SEEN] = approach(memory[_V_SEEN], v * seen.v, share_v)
    memory[_WW] = approach(memory[_WW], w * w, share_w)
    memory[_W_SEEN] = approach(memory[_W_SEEN], w * seen.w, share_w)
    memory[_W_ASIDE] = approach(memory[_W_ASIDE], w * v_y, share_w)
    memory[_POSE] = seen.x
    memory[_POSE + 1] = seen.y
    memory[_POSE + 2] = seen.yaw


@jit
def learnt(memory: FloatArray) -> DriverEstimate:
    """Return the driver's references with the learnt gains and slip.

    A robot that hardly moved has those of the model.
    """
    least_v = LEAST_V * LEAST_V
    least_w = LEAST_W * LEAST_W
    w_seen = memory[_W_SEEN]
    gain_v = (memory[_V_SEEN] + least_v) / (memory[_VV] + least_v)
    gain_w = (w_seen + least_w) / (memory[_WW] + least_w)
    slip = memory[_W_ASIDE] / (w_seen + least_w) if w_seen > 0.0 else 0.0
    return DriverEstimate(
        memory[_DRIVER],
        memory[_DRIVER + 1],
        memory[_DRIVER + 2],
        memory[_DRIVER + 3],
        gain_v=min(max(gain_v, GAINS_V[0]), GAINS_V[1]),
        gain_w=min(max(gain_w, GAINS_W[0]), GAINS_W[1]),
        slip=min(max(slip, SLIPS[0]), SLIPS[1]),
    )


@jit_alone
def predict_ahead(
    past: FloatArray,
    memory: FloatArray,
    seen: Observation,
    t: float,
    end: float,
    model: PredictorModel,
) -> tuple[Observation, DriverEstimate]:
    """Return the robot at mission time `end` [s], and the references of its driver then.

    `end` is `model.horizon` after the time of the next command. The robot was `seen` at time
    `t` [s], to which the memory advances in place: (16,) `MEMORY_NUMBERS` beside the (n, 2) `past`
    commands, the newest last.
    """
    before = memory[_AT]
    at = before
    sent_at = memory[_SENT_AT]
    v = memory[_MODEL_V]
    w = memory[_MODEL_W]
    driver = DriverEstimate(
        memory[_DRIVER],
        memory[_DRIVER + 1],
        memory[_DRIVER + 2],
        memory[_DRIVER + 3],
        gain_v=1.0,
        gain_w=1.0,
        slip=0.0,
    )
    while at < t - _ROUNDING:
        dt = min(model.step, t - at)
        driver = advance_driver(past, sent_at, at, dt, driver, model)
        v, w = respond(v, w, driver, dt, model)
        at += dt
    changes = Command(v - memory[_MODEL_V], w - memory[_MODEL_W])
    memory[_DRIVER] = driver.v
    memory[_DRIVER + 1] = driver.w
    memory[_DRIVER + 2] = driver.lagged_v
    memory[_DRIVER + 3] = driver.lagged_w
    memory[_AT] = at
    memory[_MODEL_V] = v
    memory[_MODEL_W] = w
    if t - before > _ROUNDING:
        learn(memory, changes, seen, t - before)
    driver = learnt(memory)
    x, y, yaw, v, w = seen
    while at < end - _ROUNDING:
        dt = min(model.step, end - at)
        driver = advance_driver(past, sent_at, at, dt, driver, model)
        v_next, w_next = respond(v, w, driver, dt, model)
        v_mid = 0.5 * (v + v_next)
        w_mid = 0.5 * (w + w_next)
        heading = yaw + 0.5 * dt * w_mid
        aside = driver.slip * w_mid
        c = math.cos(heading)
        s = math.sin(heading)
        x += dt * (v_mid * c - aside * s)
        y += dt * (v_mid * s + aside * c)
        yaw += dt * w_mid
        v = v_next
        w = w_next
        at += dt
    return Observation(x, y, yaw, v, w), driver


@jit_alone
def remember(past: FloatArray, memory: FloatArray, v: float, w: float, t: float) -> None:
    """Append the command that is sent at time `t` [s] to a predictor's memory, in place.

    The oldest one drops out.
    """
    last = len(past) - 1
    for k in range(last):
        past[k, 0] = past[k + 1, 0]
        past[k, 1] = past[k + 1, 1]
    past[last, 0] = v
    past[last, 1] = w
    memory[_SENT_AT] = t
