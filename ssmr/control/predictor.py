"""The robot one dead time ahead: where it will be when the next command acts.

A law that acts on the state of now controls a robot that has moved on when its command arrives. The
predictor (O. Smith, 1957) carries the state over the dead time: the driver's references follow from
the commands that were sent already, and speed and yaw rate follow these by the linear model
(Eq. 2.46). The law then acts on that state and on its target. As it drives, the predictor learns
which share of the model's speed and yaw rate the robot has, how it slips in bends, and how much
later than its model it answers.

The last is found by least squares that forget. The model's speed and yaw rate, shifted by 0.05 s
to earlier up to 0.3 s to later, are compared with those of the robot. The likeliest
shift is taken, with a prior of mean 0. Both signals are differences
over a tenth of a second, each shift with the gain that suits it best: a wrong gain, a slip or
motors too weak for a start are not read as delay.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssmr._jit import jit, jit_alone, python_source, write_numbers
from ssmr.control.law import Command, Observation
from ssmr.robot.drive import body_rates, clip_to_limit, ramp_towards
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, State

PREDICTION_STEP = 0.01
"""Longest step of a prediction [s]."""
_ROUNDING = 1e-9
"""Times nearer than this are one instant [s]."""
_MEMORY = 1.0
"""Time over which a predictor averages how the robot differs from its model [s]: longer than the
robot's own time constants, and about that of a bend."""
_LONG = 10.0
"""Time of the means from which those over `_MEMORY` begin [s]: a model that is wrong from the first
bend to the last shows there even at yaw rates that one bend alone does not tell from pushes."""
_LEAST_V = 0.1
"""Speed from which on the robot's differences count for more than the model [m/s]."""
_LEAST_W = 0.2
"""Yaw rate from which on the robot's differences count for more than the model [rad/s]."""
_STEADY_V = 0.5
"""Change of speed at which an observation counts half [m/s2]."""
_STEADY_W = 3.0
"""Change of yaw rate at which an observation counts half [rad/s2]."""
_GAINS_V = (0.8, 1.2)
_GAINS_W = (0.2, 5.0)
_SLIPS = (-0.3, 0.3)
"""Bounds of the learnt gains of speed and of yaw rate [1] and of the learnt slip [m]. Tyres roll on
up to 13 % less than the driver's radius. A robot with less than 0.8 of its model's speed still
gathers speed, as far as its torques allow."""
GRID = 0.01
"""Time between the samples by which the delay is learnt, and between the delays that are tried
[s]."""
_EARLIEST = 0.05
"""Time by which a robot may answer earlier than its model [s]."""
_LATEST = 0.3
"""Time by which it may answer later [s]."""
_PROMPT = round(_EARLIEST / GRID)
_SHIFTS = 1 + _PROMPT + round(_LATEST / GRID)
_BACK = round(0.1 / GRID)
"""Samples between the two speeds of a difference. It must be shorter than any dead time that is
tried: a law feeds back the noise of what it saw, and its commands must not answer the older one."""
_KEPT = _SHIFTS + _BACK
LATE_FEEDBACK = 0.5
"""Greatest time between an observation and a command that is told to a predictor [s]."""
_FORGETTING = 6.0
"""Time constant with which samples are forgotten [s]: some bends of a path."""
_PRIOR = 0.08
"""Standard deviation of the delay that is not known [s]."""
_WEIGHTS = (GRID / 0.05 / 0.05**2, GRID / 0.05 / 0.03**2)
"""Weights of a sample of speed [s2/m2] and of yaw rate [s2/rad2]: differences deviate by no less
than 0.05 m/s and 0.03 rad/s, and those nearer than 0.05 s are not independent."""
_GAIN_PRIOR = 20.0
"""Weight of the gain 1 beside the samples, in their unit."""
_GAINS = (0.3, 1.5)
"""Bounds of the gain of a shift."""
_LEARNING_RATE = 0.4
"""Greatest change of the learnt delay [s/s]: a plan follows it without a jolt."""


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
    margin: float  # time by which the driver is taken to act later than was learnt [s]


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
LEARNT = 16
_EARLY = 17
_GRID_AT = 23
_SEEN = 24
_SQUARES = 26
_LASTING = 29
_HISTORY = 34
_SUMS = _HISTORY + 2 * _KEPT + 2 * (1 + _BACK)
MEMORY_NUMBERS = _SUMS + 4 * _SHIFTS
"""Length of the row of numbers that a predictor remembers beside the commands, in this order:

- references of speed and yaw rate after the driver's limits, then after the lag of the wheels too
- mission times of all this, and of the newest command [s]
- speed and yaw rate of the model without feedback
- mean square of that speed, mean product of it and the robot's speed; the same of yaw rates
- mean product of the model's yaw rate and the robot's lateral speed
- pose of the robot when it was seen last
- time by which the robot answers later than its model, as it was learnt [s]
- a model that answers `_EARLIEST` before: its four references, speed and yaw rate
- time of the newest sample of this model [s]
- speed and yaw rate of the robot when it was seen last
- sums of the squares of the robot's differences, of speed and of yaw rate, and of samples
- the five means over `_LONG`
- newest samples, the newest first: (2, `_KEPT`) of this model, (2, 1 + `_BACK`) of the robot
- (2, 2, `_SHIFTS`) for speed and yaw rate sums of this model's squares, and of its products with
  the robot's.
"""
_DRIVER = 0
_AT = 4
_SENT_AT = 5
MODEL_V = 6
MODEL_W = 7
_VV = 8
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
        margin=0.0,
    )


def commands_under_way(model: PredictorModel) -> int:
    """Return how many commands a predictor must remember, also of a robot that answers later."""
    return math.ceil((model.horizon + _LATEST + LATE_FEEDBACK) / model.period) + 3


def predictor_start(state: State, drive: Drive, period: float) -> FloatArray:
    """Return the memory of a predictor whose robot has rolled as in `state` before the start."""
    half_track = drive.command_half_track
    # the compiled one would be compiled anew at every start, which takes longer than a run
    of_wheels = python_source(body_rates)
    rates = of_wheels(state.wheel_left, state.wheel_right, half_track, drive.command_radius)
    memory = np.zeros(MEMORY_NUMBERS)
    memory[:_AT] = np.tile(rates, 2)
    memory[_SENT_AT] = -period
    memory[MODEL_V] = state.v_x
    memory[MODEL_W] = state.yaw_rate
    memory[_POSE:LEARNT] = state.x, state.y, state.yaw
    memory[_EARLY:_GRID_AT] = *memory[:_AT], state.v_x, state.yaw_rate
    memory[_SEEN:_SQUARES] = state.v_x, state.yaw_rate
    before = memory[_HISTORY:_SUMS]
    before[:_KEPT] = before[2 * _KEPT : 2 * _KEPT + _BACK + 1] = state.v_x
    before[_KEPT : 2 * _KEPT] = before[2 * _KEPT + _BACK + 1 :] = state.yaw_rate
    return memory


@jit
def command_in_effect(
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
def approach_target(value: float, target: float, share: float) -> float:
    """Return a value that has gone a share of its way to a target."""
    return value + share * (target - value)


@jit
def _advance_driver(
    past: FloatArray,
    sent_at: float,
    t: float,
    dt: float,
    before: DriverEstimate,
    model: PredictorModel,
    late: float,
) -> DriverEstimate:
    """Return the driver's references after a step from `t` to `t + dt` [s].

    See `command_in_effect`; the driver acts `late` [s] later than the model's.
    """
    when = t + (dt if model.ramp > 0.0 else 0.5 * dt)  # a ramp has gone on to the end of the step
    sampled_v = when - max(model.delay_v + late, 0.0)
    sampled_w = when - max(model.delay_w + late, 0.0)
    v = clip_to_limit(command_in_effect(past, 0, sent_at, sampled_v, model), model.v_max)
    w = clip_to_limit(command_in_effect(past, 1, sent_at, sampled_w, model), model.w_max)
    v = ramp_towards(before.v, v, model.acceleration_v * dt)
    w = ramp_towards(before.w, w, model.acceleration_w * dt)
    share = -math.expm1(-dt / model.lag) if model.lag > 0.0 else 1.0
    return DriverEstimate(
        v=v,
        w=w,
        lagged_v=approach_target(before.lagged_v, v, share),
        lagged_w=approach_target(before.lagged_w, w, share),
        gain_v=before.gain_v,
        gain_w=before.gain_w,
        slip=before.slip,
    )


@jit
def _relax_exactly(x: float, rate: float, drive: float, dt: float) -> float:
    """Return x after an exact step of dx/dt = -rate x + drive, for a constant drive."""
    if rate * dt < 1e-12:
        return x + dt * drive
    return x + math.expm1(-rate * dt) * (x - drive / rate)


@jit
def _respond_linearly(
    v: float, w: float, driver: DriverEstimate, dt: float, model: PredictorModel
) -> tuple[float, float]:
    """Return speed and yaw rate after a step of the linear model with the learnt gains."""
    drive_v = model.push_v * driver.gain_v * driver.lagged_v
    drive_w = model.push_w * driver.gain_w * driver.lagged_w
    return _relax_exactly(v, model.rate_v, drive_v, dt), _relax_exactly(
        w, model.rate_w, drive_w, dt
    )


@jit
def learn_response(memory: FloatArray, changes: Command, seen: Observation, elapsed: float) -> None:
    """Take in the robot's motion in the `elapsed` time [s] beside that of the model, in place.

    These are least squares that forget. Gains are lasting ones, so what is seen while the model's
    speeds change, by `changes` in this time, counts for less.
    """
    v = memory[MODEL_V]
    w = memory[MODEL_W]
    change_v = changes.v / (elapsed * _STEADY_V)
    change_w = changes.w / (elapsed * _STEADY_W)
    x = memory[_POSE]
    y = memory[_POSE + 1]
    heading = 0.5 * (memory[_POSE + 2] + seen.yaw)
    aside = math.cos(heading) * (seen.y - y) - math.sin(heading) * (seen.x - x)
    v_y = aside / elapsed
    seen_v = ((v * v, change_v), (v * seen.v, change_v))
    seen_w = ((w * w, change_w), (w * seen.w, change_w), (w * v_y, change_w))
    for k, (product, change) in enumerate(seen_v + seen_w):
        for first, time in ((_VV, _MEMORY), (_LASTING, _LONG)):
            share = min(elapsed / time, 1.0) / (1.0 + change * change)
            memory[first + k] = approach_target(memory[first + k], product, share)
    write_numbers(memory, _POSE, 1, (seen.x, seen.y, seen.yaw))


@jit
def learnt_references(memory: FloatArray) -> DriverEstimate:
    """Return the driver's references with the learnt gains and slip.

    A robot that hardly moved has those of the model.
    """
    gain_v = gain_w = 1.0
    slip = 0.0
    for first, time in ((_LASTING, _LONG), (_VV, _MEMORY)):
        least_v = _LEAST_V * _LEAST_V * _MEMORY / time
        least_w = _LEAST_W * _LEAST_W * _MEMORY / time
        w_seen = memory[first + 3]
        gain_v = (memory[first + 1] + least_v * gain_v) / (memory[first] + least_v)
        gain_w = (w_seen + least_w * gain_w) / (memory[first + 2] + least_w)
        slip = (memory[first + 4] + least_w * slip) / (max(w_seen, 0.0) + least_w)
    return DriverEstimate(
        memory[_DRIVER],
        memory[_DRIVER + 1],
        memory[_DRIVER + 2],
        memory[_DRIVER + 3],
        gain_v=min(max(gain_v, _GAINS_V[0]), _GAINS_V[1]),
        gain_w=min(max(gain_w, _GAINS_W[0]), _GAINS_W[1]),
        slip=min(max(slip, _SLIPS[0]), _SLIPS[1]),
    )


def modelled_speeds(memory: FloatArray) -> FloatArray:
    """Return (2, n) speeds and yaw rates of the model now, one for each delay that is tried."""
    return memory[_HISTORY : _HISTORY + 2 * _KEPT].reshape(2, _KEPT)[:, :_SHIFTS]


def stop_model(past: FloatArray, memory: FloatArray, t: float, pose: Observation) -> None:
    """Let a predictor's robot stand at a `pose` at time `t` [s], in place; what it learnt stays."""
    past[:] = 0.0
    memory[: MODEL_W + 1] = 0.0
    memory[[_AT, _SENT_AT, _GRID_AT]] = t
    memory[_POSE:LEARNT] = pose.x, pose.y, pose.yaw
    memory[_EARLY:_GRID_AT] = 0.0
    memory[_SEEN:_SQUARES] = 0.0
    memory[_HISTORY:_SUMS] = 0.0


@jit
def _nominal_driver(memory: FloatArray, first: int) -> DriverEstimate:
    """Return the driver's references, kept from the number `first` on, without learnt gains."""
    return DriverEstimate(
        memory[first],
        memory[first + 1],
        memory[first + 2],
        memory[first + 3],
        gain_v=1.0,
        gain_w=1.0,
        slip=0.0,
    )


@jit
def _sample_early(past: FloatArray, memory: FloatArray, model: PredictorModel) -> None:
    """Take the model that answers `_EARLIEST` before on by one sample, in place."""
    at = memory[_GRID_AT]
    driver = _nominal_driver(memory, _EARLY)
    sent_at = memory[_SENT_AT]
    driver = _advance_driver(past, sent_at, at, GRID, driver, model=model, late=-_EARLIEST)
    v, w = _respond_linearly(memory[_EARLY + 4], memory[_EARLY + 5], driver, GRID, model)
    early = (driver.v, driver.w, driver.lagged_v, driver.lagged_w, v, w, at + GRID)
    write_numbers(memory, _EARLY, 1, early)


@jit
def _push_sample(samples: FloatArray, newest: float) -> None:
    """Put the newest sample first, in place; the oldest one drops out."""
    for k in range(len(samples) - 1, 0, -1):
        samples[k] = samples[k - 1]
    samples[0] = newest


@jit
def _learn_delay(
    past: FloatArray, memory: FloatArray, seen: Observation, t: float, model: PredictorModel
) -> None:
    """Take in speed and yaw rate of time `t` [s], and learn how late the robot answers, in place.

    Between two observations they are taken as linear in time.
    """
    history = memory[_HISTORY:_SUMS]
    modelled = history[: 2 * _KEPT].reshape(2, _KEPT)
    robot = history[2 * _KEPT :].reshape(2, 1 + _BACK)
    sums = memory[_SUMS:].reshape(2, 2, _SHIFTS)
    before = memory[_AT]
    delays = (model.delay_v, model.delay_w)
    now = (seen.v, seen.w)
    keep = math.exp(-GRID / _FORGETTING)
    while memory[_GRID_AT] + GRID <= t + _ROUNDING:
        _sample_early(past, memory, model)
        memory[_SQUARES + 2] = keep * memory[_SQUARES + 2] + GRID / 0.05
        part = (memory[_GRID_AT] - before) / (t - before)
        for j in range(2):
            _push_sample(modelled[j], memory[_EARLY + 4 + j])
            _push_sample(robot[j], approach_target(memory[_SEEN + j], now[j], part))
            y = robot[j, 0] - robot[j, _BACK]
            memory[_SQUARES + j] = keep * memory[_SQUARES + j] + _WEIGHTS[j] * y * y
            # a model with less dead time than that cannot answer so early
            less = round(max(_EARLIEST - delays[j], 0.0) / GRID)
            for i in range(_SHIFTS):
                k = max(i - less, 0)
                x = modelled[j, k] - modelled[j, k + _BACK]
                sums[j, 0, i] = keep * sums[j, 0, i] + _WEIGHTS[j] * x * x
                sums[j, 1, i] = keep * sums[j, 1, i] + _WEIGHTS[j] * x * y
    write_numbers(memory, _SEEN, 1, now)
    most = _LEARNING_RATE * (t - before)
    best = max(_best_delay(sums, memory[_SQUARES:_HISTORY]), -model.horizon)
    memory[LEARNT] += clip_to_limit(best - memory[LEARNT], most)


@jit
def _delay_misfit(sums: FloatArray, squares: FloatArray, i: int) -> float:
    """Return how badly delay number `i` explains the samples: -2 log of its likelihood.

    The variance of what is not explained is not known: pushes and dry friction count less.
    """
    delay = (i - _PROMPT) * GRID
    cost = (delay / _PRIOR) ** 2
    for j in range(2):
        square = sums[j, 0, i]
        product = sums[j, 1, i]
        gain = (product + _GAIN_PRIOR) / (square + _GAIN_PRIOR)
        gain = min(max(gain, _GAINS[0]), _GAINS[1])
        rest = max(squares[j] + gain * (gain * square - 2.0 * product), 0.0)
        cost += squares[2] * math.log1p(rest / squares[2])
    return cost


@jit
def _best_delay(sums: FloatArray, squares: FloatArray) -> float:
    """Return the delay [s] of the least _misfit, by the parabola through the best three."""
    best = 0
    least = _delay_misfit(sums, squares, 0)
    for i in range(1, _SHIFTS):
        cost = _delay_misfit(sums, squares, i)
        if cost < least:
            best = i
            least = cost
    delay = (best - _PROMPT) * GRID
    if best == 0 or best == _SHIFTS - 1:
        return delay
    below = _delay_misfit(sums, squares, best - 1)
    above = _delay_misfit(sums, squares, best + 1)
    bend = below - 2.0 * least + above
    return delay + 0.5 * GRID * (below - above) / bend if bend > 0.0 else delay


@jit_alone
def predict_ahead(
    past: FloatArray,
    memory: FloatArray,
    seen: Observation,
    t: float,
    sends: float,
    model: PredictorModel,
) -> tuple[Observation, DriverEstimate, float]:
    """Return the robot when a command that is sent at mission time `sends` [s] begins to act.

    The references of its driver then and that time [s] stand beside it. The robot was `seen` at
    time `t` [s], to which the memory advances in place: `MEMORY_NUMBERS` beside the (n, 2) `past`
    commands, the newest last.
    """
    before = memory[_AT]
    if t - before > _ROUNDING:
        _learn_delay(past, memory, seen, t, model)
    late = memory[LEARNT] + model.margin
    end = sends + max(model.horizon + late, 0.0)
    at = before
    sent_at = memory[_SENT_AT]
    v = memory[MODEL_V]
    w = memory[MODEL_W]
    driver = _nominal_driver(memory, _DRIVER)
    while at < t - _ROUNDING:
        dt = min(model.step, t - at)
        driver = _advance_driver(past, sent_at, at, dt, driver, model=model, late=late)
        v, w = _respond_linearly(v, w, driver, dt, model)
        at += dt
    changes = Command(v - memory[MODEL_V], w - memory[MODEL_W])
    references = (driver.v, driver.w, driver.lagged_v, driver.lagged_w, at)
    write_numbers(memory, _DRIVER, 1, references)
    memory[MODEL_V] = v
    memory[MODEL_W] = w
    if t - before > _ROUNDING:
        learn_response(memory, changes, seen, t - before)
    driver = learnt_references(memory)
    x, y, yaw, v, w = seen
    while at < end - _ROUNDING:
        dt = min(model.step, end - at)
        driver = _advance_driver(past, sent_at, at, dt, driver, model=model, late=late)
        v_next, w_next = _respond_linearly(v, w, driver, dt, model)
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
    return Observation(x, y, yaw, v, w), driver, end


@jit_alone
def remember_command(past: FloatArray, memory: FloatArray, v: float, w: float, t: float) -> None:
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
