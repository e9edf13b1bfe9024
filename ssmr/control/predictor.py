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

from ssmr._jit import jit, jit_alone, named_like
from ssmr.control.law import Observation
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


class PredictorState(NamedTuple):
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


NO_PREDICTOR = PredictorModel(*(0.0,) * len(PredictorModel._fields))
_NO_PREDICTION = PredictorState(*(0.0,) * len(PredictorState._fields))
"""Templates for `named_like`."""
_SENT_AT = PredictorState._fields.index("sent_at")


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


def predictor_start(state: State, drive: Drive, period: float) -> PredictorState:
    """Return the memory of a predictor whose robot has rolled as in `state` before the start."""
    half_track = drive.command_half_track
    rates = body_rates(state.wheel_left, state.wheel_right, half_track, drive.command_radius)
    v, w = map(float, rates)
    return _NO_PREDICTION._replace(
        v=v,
        w=w,
        lagged_v=v,
        lagged_w=w,
        sent_at=-period,
        model_v=state.v_x,
        model_w=state.yaw_rate,
        x=state.x,
        y=state.y,
        yaw=state.yaw,
    )


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
def learn(
    p: PredictorState, before: PredictorState, seen: Observation, elapsed: float
) -> PredictorState:
    """Return the memory with the motion in the `elapsed` time [s] beside that of the model.

    These are least squares that forget. Gains are lasting ones, so what is seen while the model's
    speeds change from those of `before` counts for less.
    """
    share = min(elapsed / MEMORY, 1.0)
    v = p.model_v
    w = p.model_w
    change_v = (v - before.model_v) / (elapsed * STEADY_V)
    change_w = (w - before.model_w) / (elapsed * STEADY_W)
    share_v = share / (1.0 + change_v * change_v)
    share_w = share / (1.0 + change_w * change_w)
    heading = 0.5 * (p.yaw + seen.yaw)
    dx = seen.x - p.x
    dy = seen.y - p.y
    aside = math.cos(heading) * dy - math.sin(heading) * dx
    v_y = aside / elapsed
    return PredictorState(
        v=p.v,
        w=p.w,
        lagged_v=p.lagged_v,
        lagged_w=p.lagged_w,
        at=p.at,
        sent_at=p.sent_at,
        model_v=v,
        model_w=w,
        vv=approach(p.vv, v * v, share_v),
        v_seen=approach(p.v_seen, v * seen.v, share_v),
        ww=approach(p.ww, w * w, share_w),
        w_seen=approach(p.w_seen, w * seen.w, share_w),
        w_aside=approach(p.w_aside, w * v_y, share_w),
        x=seen.x,
        y=seen.y,
        yaw=seen.yaw,
    )


@jit
def learnt(p: PredictorState) -> DriverEstimate:
    """Return the driver's references with the learnt gains and slip.

    A robot that hardly moved has those of the model.
    """
    least_v = LEAST_V * LEAST_V
    least_w = LEAST_W * LEAST_W
    gain_v = (p.v_seen + least_v) / (p.vv + least_v)
    gain_w = (p.w_seen + least_w) / (p.ww + least_w)
    slip = p.w_aside / (p.w_seen + least_w) if p.w_seen > 0.0 else 0.0
    return DriverEstimate(
        v=p.v,
        w=p.w,
        lagged_v=p.lagged_v,
        lagged_w=p.lagged_w,
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
    `t` [s], to which the memory advances in place: (16,) numbers of a `PredictorState` beside the
    (n, 2) `past` commands, the newest last.
    """
    p = named_like(_NO_PREDICTION, memory)
    at = p.at
    v = p.model_v
    w = p.model_w
    driver = DriverEstimate(p.v, p.w, p.lagged_v, p.lagged_w, gain_v=1.0, gain_w=1.0, slip=0.0)
    while at < t - _ROUNDING:
        dt = min(model.step, t - at)
        driver = advance_driver(past, p.sent_at, at, dt, driver, model)
        v, w = respond(v, w, driver, dt, model)
        at += dt
    now = PredictorState(
        v=driver.v,
        w=driver.w,
        lagged_v=driver.lagged_v,
        lagged_w=driver.lagged_w,
        at=at,
        sent_at=p.sent_at,
        model_v=v,
        model_w=w,
        vv=p.vv,
        v_seen=p.v_seen,
        ww=p.ww,
        w_seen=p.w_seen,
        w_aside=p.w_aside,
        x=p.x,
        y=p.y,
        yaw=p.yaw,
    )
    if t - p.at > _ROUNDING:
        now = learn(now, p, seen, t - p.at)
    for k, number in enumerate(now):
        memory[k] = number
    driver = learnt(now)
    x, y, yaw, v, w = seen
    while at < end - _ROUNDING:
        dt = min(model.step, end - at)
        driver = advance_driver(past, p.sent_at, at, dt, driver, model)
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
