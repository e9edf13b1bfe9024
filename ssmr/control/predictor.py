"""The robot one dead time ahead: where it will be when the next command acts.

A law that acts on the state of now controls a robot that has moved on when its command arrives. The predictor (O. Smith,
1957) carries the state over the dead time: the driver's references follow from the commands that were sent already, and
speed and yaw rate follow these by the linear model (Eq. 2.46). The law then acts on that state and on its target.
As it drives, the predictor learns which share of the model's speed and yaw rate the robot has, and how it slips in bends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ssmr._jit import jit, jit_alone, named_like
from ssmr.control.law import Observation
from ssmr.robot.drive import body_rates, ramp, saturate
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, State

PREDICTION_STEP = 0.01
"""Longest step of a prediction [s]."""
_ROUNDING = 1e-9
"""Times nearer than this are one instant [s]."""


class Foresight(NamedTuple):
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
    memory: float  # time over which the robot's differences from the model are averaged [s]


class Asked(NamedTuple):
    """The references of the driver at one instant: after its limits, and after the lag of the wheels."""

    v: float
    w: float
    lagged_v: float
    lagged_w: float
    gain_v: float
    """Share of the model's speed that the robot really has [1]."""
    gain_w: float
    """Share of the model's yaw rate that the robot really has [1]."""
    slip: float
    """Lateral speed to the left over yaw rate [m]: wheels that carry a robot round a bend slip outwards."""


class Pipe(NamedTuple):
    """The memory of a predictor beside the commands."""

    v: float  # reference of the speed after the driver's limits [m/s]
    w: float  # reference of the yaw rate after the driver's limits [rad/s]
    lagged_v: float  # the same after the lag of the wheels [m/s]
    lagged_w: float  # the same after the lag of the wheels [rad/s]
    at: float  # mission time of all this [s]
    sent_at: float  # mission time of the newest command [s]
    model_v: float  # speed of the model without feedback [m/s]
    model_w: float  # yaw rate of the model without feedback [rad/s]
    vv: float  # mean square of the model's speed
    v_seen: float  # mean product of the model's speed and the robot's
    ww: float  # mean square of the model's yaw rate
    w_seen: float  # mean product of the model's yaw rate and the robot's
    w_aside: float  # mean product of the model's yaw rate and the robot's lateral speed
    x: float  # the robot when it was seen last
    y: float
    yaw: float


NO_FORESIGHT = Foresight(*(0.0,) * len(Foresight._fields))
NO_PIPE = Pipe(*(0.0,) * len(Pipe._fields))
"""Templates for `named_like`."""
MEMORY = 1.0
"""Time over which a predictor averages how the robot differs from its model [s]: longer than the robot's own time constants,
and about that of a bend."""
LEAST_V, LEAST_W = 0.1, 0.2
"""Speed [m/s] and yaw rate [rad/s] from which on the robot's differences count for more than the model."""
STEADY_V, STEADY_W = 0.5, 3.0
"""Change of speed [m/s2] and of yaw rate [rad/s2] at which an observation counts half."""
GAINS_V, GAINS_W, SLIPS = (0.8, 1.2), (0.5, 1.5), (-0.3, 0.3)
"""Bounds of the learnt gains of speed and of yaw rate [1] and of the learnt slip [m]. Tyres roll on up to 13 % less than the
driver's radius. A robot with less than 0.8 of its model's speed still gathers speed, as far as its torques allow."""


def foresight(a: FloatArray, b: FloatArray, drive: Drive, period: float) -> Foresight:
    """Return the numbers of a predictor.

    Args:
        a: (4, 4) of the linear model (Eq. 2.46).
        b: (4, 2) of the linear model.
        drive: the driver between command and wheels, as far as it is known.
        period: time between commands [s].
    """
    return Foresight(
        max(drive.delay_v, drive.delay_w), -float(a[1][1]), float(b[1][0]), -float(a[3][3]), float(b[3][1]),
        drive.delay_v, drive.delay_w, period, drive.command_ramp, drive.v_max, drive.w_max, drive.acceleration_v,
        drive.acceleration_w, drive.wheel_lag, PREDICTION_STEP, MEMORY,
    )  # fmt: skip


def commands_under_way(numbers: Foresight) -> int:
    """Return how many commands a predictor must remember."""
    return math.ceil(numbers.horizon / numbers.period) + 3


def new_pipe(state: State, drive: Drive, period: float) -> Pipe:
    """Return the memory of a predictor whose robot has rolled as in `state` before the start."""
    v, w = map(float, body_rates(state.wheel_left, state.wheel_right, drive.command_half_track, drive.command_radius))
    return Pipe(v, w, v, w, 0.0, -period, state.v_x, state.yaw_rate, 0.0, 0.0, 0.0, 0.0, 0.0, state.x, state.y, state.yaw)


@jit
def commanded(past: FloatArray, column: int, sent_at: float, when: float, numbers: Foresight) -> float:
    """Return the value on which the driver acts that samples at time `when` [s], without dead time.

    Args:
        past: (n, 2) commands, the newest last, which was sent at `sent_at` [s].
        column: 0 for the speed, 1 for the yaw rate.
        sent_at: time of the newest command [s].
        when: time of the sample [s].
        numbers: the predictor's numbers.
    """
    back = max(math.ceil((sent_at - when) / numbers.period - _ROUNDING), 0)
    k = max(len(past) - 1 - back, 0)
    value: float = past[k, column]
    since = max(when - (sent_at - back * numbers.period), 0.0)  # rounding makes it negative
    if k == 0 or since >= numbers.ramp:
        return value
    last: float = past[k - 1, column]
    return last + (value - last) * (since / numbers.ramp)


@jit
def ask(past: FloatArray, sent_at: float, t: float, dt: float, asked: Asked, numbers: Foresight) -> Asked:
    """Return the driver's references after a step from `t` to `t + dt` [s], see `commanded`."""
    when = t + (dt if numbers.ramp > 0.0 else 0.5 * dt)  # a ramp has gone on to the end of the step
    v = saturate(commanded(past, 0, sent_at, when - numbers.delay_v, numbers), numbers.v_max)
    w = saturate(commanded(past, 1, sent_at, when - numbers.delay_w, numbers), numbers.w_max)
    v, w = ramp(asked.v, v, numbers.acceleration_v * dt), ramp(asked.w, w, numbers.acceleration_w * dt)
    share = -math.expm1(-dt / numbers.lag) if numbers.lag > 0.0 else 1.0
    lagged_v, lagged_w = asked.lagged_v + share * (v - asked.lagged_v), asked.lagged_w + share * (w - asked.lagged_w)
    return Asked(v, w, lagged_v, lagged_w, asked.gain_v, asked.gain_w, asked.slip)


@jit
def relax(x: float, rate: float, drive: float, dt: float) -> float:
    """Return x after an exact step of dx/dt = -rate x + drive, for a constant drive."""
    if rate * dt < 1e-12:
        return x + dt * drive
    return x + math.expm1(-rate * dt) * (x - drive / rate)


@jit
def respond(v: float, w: float, asked: Asked, dt: float, numbers: Foresight) -> tuple[float, float]:
    """Return speed and yaw rate after a step of the linear model with the learnt gains."""
    v = relax(v, numbers.rate_v, numbers.push_v * asked.gain_v * asked.lagged_v, dt)
    return v, relax(w, numbers.rate_w, numbers.push_w * asked.gain_w * asked.lagged_w, dt)


@jit
def learn(p: Pipe, before: Pipe, seen: Observation, elapsed: float, memory: float) -> Pipe:
    """Return the memory with what the robot did in the `elapsed` time [s] beside its model: least squares that forget.

    Gains are lasting ones, so what is seen while the model's speeds change from those of `before` counts for less.
    """
    share = min(elapsed / memory, 1.0)
    hurry_v = (p.model_v - before.model_v) / (elapsed * STEADY_V)
    hurry_w = (p.model_w - before.model_w) / (elapsed * STEADY_W)
    share_v, share_w = share / (1.0 + hurry_v * hurry_v), share / (1.0 + hurry_w * hurry_w)
    heading = 0.5 * (p.yaw + seen.yaw)
    aside = (math.cos(heading) * (seen.y - p.y) - math.sin(heading) * (seen.x - p.x)) / elapsed
    return Pipe(
        p.v, p.w, p.lagged_v, p.lagged_w, p.at, p.sent_at, p.model_v, p.model_w,
        p.vv + share_v * (p.model_v * p.model_v - p.vv), p.v_seen + share_v * (p.model_v * seen.v - p.v_seen),
        p.ww + share_w * (p.model_w * p.model_w - p.ww), p.w_seen + share_w * (p.model_w * seen.w - p.w_seen),
        p.w_aside + share_w * (p.model_w * aside - p.w_aside), seen.x, seen.y, seen.yaw,
    )  # fmt: skip


@jit
def learnt(p: Pipe) -> Asked:
    """Return the driver's references with the learnt gains and slip; a robot that hardly moved has those of the model."""
    least_v, least_w = LEAST_V * LEAST_V, LEAST_W * LEAST_W
    gain_v, gain_w = (p.v_seen + least_v) / (p.vv + least_v), (p.w_seen + least_w) / (p.ww + least_w)
    slip = p.w_aside / (p.w_seen + least_w) if p.w_seen > 0.0 else 0.0
    return Asked(
        p.v, p.w, p.lagged_v, p.lagged_w, min(max(gain_v, GAINS_V[0]), GAINS_V[1]), min(max(gain_w, GAINS_W[0]), GAINS_W[1]),
        min(max(slip, SLIPS[0]), SLIPS[1]),
    )  # fmt: skip


@jit_alone
def carry_ahead(
    past: FloatArray, pipe: FloatArray, seen: Observation, t: float, end: float, numbers: Foresight
) -> tuple[Observation, Asked]:
    """Return the robot at mission time `end` [s], and the references of its driver then.

    Args:
        past: (n, 2) commands, the newest last.
        pipe: (16,) the rest of the memory, a `Pipe`, which advances to `t` in place.
        seen: the robot at time `t`.
        t: mission time [s].
        end: mission time of the prediction, `numbers.horizon` after that of the next command [s].
        numbers: the predictor's numbers.
    """
    p = named_like(NO_PIPE, pipe)
    at, v, w = p.at, p.model_v, p.model_w
    asked = Asked(p.v, p.w, p.lagged_v, p.lagged_w, 1.0, 1.0, 0.0)
    while at < t - _ROUNDING:
        dt = min(numbers.step, t - at)
        asked = ask(past, p.sent_at, at, dt, asked, numbers)
        v, w = respond(v, w, asked, dt, numbers)
        at += dt
    now = Pipe(
        asked.v, asked.w, asked.lagged_v, asked.lagged_w, at, p.sent_at, v, w, p.vv, p.v_seen, p.ww, p.w_seen, p.w_aside,
        p.x, p.y, p.yaw,
    )  # fmt: skip
    if t - p.at > _ROUNDING:
        now = learn(now, p, seen, t - p.at, numbers.memory)
    for k, number in enumerate(now):
        pipe[k] = number
    asked = learnt(now)
    x, y, yaw, v, w = seen
    while at < end - _ROUNDING:
        dt = min(numbers.step, end - at)
        asked = ask(past, p.sent_at, at, dt, asked, numbers)
        v_next, w_next = respond(v, w, asked, dt, numbers)
        v_mid, w_mid = 0.5 * (v + v_next), 0.5 * (w + w_next)
        heading, aside = yaw + 0.5 * dt * w_mid, asked.slip * w_mid
        x += dt * (v_mid * math.cos(heading) - aside * math.sin(heading))
        y += dt * (v_mid * math.sin(heading) + aside * math.cos(heading))
        yaw, v, w, at = yaw + dt * w_mid, v_next, w_next, at + dt
    return Observation(x, y, yaw, v, w), asked


@jit_alone
def remember(past: FloatArray, pipe: FloatArray, v: float, w: float, t: float) -> None:
    """Append the command that is sent at time `t` [s] to a predictor's memory, in place; the oldest one drops out."""
    for k in range(len(past) - 1):
        past[k, 0], past[k, 1] = past[k + 1, 0], past[k + 1, 1]
    past[len(past) - 1, 0], past[len(past) - 1, 1] = v, w
    pipe[5] = t
