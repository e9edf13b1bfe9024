"""One tick of the closed loop (Sec. 3.4.4-3.4.6, 4.3.2, Fig. 4.9, 4.26): observe, compare, control, record.

At the rate of the position loop the robot is observed and the errors to the moving target become reference velocities; at
the rate at which the robot reads commands these become a command. Everything here is the robot's side of the loop, and so
alike for every plant: planar models, batches of MuJoCo robots, any `Plant` stepped slowly, and a real robot behind ROS.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit, jit_alone, named_like
from ssmr.control.law import EMPTY_MEMORY, Command, Memory, Observation
from ssmr.control.laws import position_step, velocity_step
from ssmr.control.predictor import Foresight, carry_ahead, remember
from ssmr.control.waypoints import ALPHA_SWITCH, Errors, Target, position_errors, target
from ssmr.estimation.ekf import filter_step, speed
from ssmr.estimation.settings import YAW, Belief, W, X, Y
from ssmr.robot.sensors import SensorErrors, sense
from ssmr.types import FloatArray

LOST = 3.0
"""A robot farther from its target than this has lost it, and the run ends [m]."""
SPINNING = 20.0
"""A robot that turns faster than this is out of control, and the run ends [rad/s]."""


class Truth(NamedTuple):
    """The true motion of the robot and the torques of its sides."""

    x: float
    y: float
    yaw: float
    v: float
    v_y: float
    w: float
    left: float
    right: float
    torque_left: float
    torque_right: float


class Draws(NamedTuple):
    """Standard normal numbers of one observation; also the factors that scale them."""

    x: float
    y: float
    yaw: float
    v: float
    w: float
    left: float
    right: float
    gyro: float


class Tracker(NamedTuple):
    """Everything about the robot's side of one closed loop that does not change during a run."""

    law: int
    """`Controller.number`."""
    gains: FloatArray
    """`Controller.packed()`."""
    predicts: bool
    """True if the law acts on the state one dead time ahead."""
    foresight: Foresight
    """Numbers of the predictor."""
    past: FloatArray
    """(n, 2) commands that were sent, the newest last; a predictor's tracker appends to them in place."""
    pipe: FloatArray
    """(16,) the rest of the predictor's memory, a `ssmr.control.predictor.Pipe`; it advances in place."""
    course: NDArray[np.void]
    """`Waypoints.course()`."""
    lookahead: float
    """Distance at which the robot keeps behind its target [m]."""
    by_filter: bool
    """True if the controller sees the estimate of the EKF."""
    belief: Belief
    """State of the EKF, which advances in place."""
    filter: Any
    """`EkfSettings.packed()`."""
    noise: Draws
    """Standard deviations of the feedback and of the sensors."""
    sensors: SensorErrors
    """`SensorModel.packed()`."""
    position_steps: int
    """Physics steps of the position loop's period."""
    velocity_steps: int
    """Physics steps of the velocity loop's period."""
    dt: float
    """Physics step [s]."""


class Mind(NamedTuple):
    """The state of the robot's side between two steps."""

    memory: Memory
    target: Target
    errors: Errors
    seen: Observation
    ahead: Observation
    """The robot that the law acts on: as it is seen, or one dead time ahead."""
    command: Command


class LogRow(NamedTuple):
    """The numbers that a run records at every tick of the position loop."""

    x: float
    y: float
    yaw: float
    v_x: float
    v_y: float
    yaw_rate: float
    wheel_left: float
    wheel_right: float
    torque_left: float
    torque_right: float
    target_x: float
    target_y: float
    target_yaw: float
    e_rho: float
    e_y: float
    e_alpha: float
    u_ref: float
    w_ref: float
    v_cmd: float
    w_cmd: float
    seen_x: float
    seen_y: float
    seen_yaw: float
    seen_v: float
    seen_w: float


NO_DRAWS = Draws(*(0.0,) * 8)
NO_ERRORS = SensorErrors(*(0.0,) * 5)
"""Templates for `named_like`."""
LOG_COLUMNS = LogRow._fields
"""Names of the columns of a run's log."""
FRESH_MIND = Mind(
    EMPTY_MEMORY,
    Target(0.0, 0.0, 0.0, 0.0, 0.0, 0),
    Errors(0.0, 0.0, 0.0),
    Observation(0.0, 0.0, 0.0, 0.0, 0.0),
    Observation(0.0, 0.0, 0.0, 0.0, 0.0),
    Command(0.0, 0.0),
)
"""State of a robot's side that has not seen anything yet."""


@jit
def observe(tracker: Tracker, truth: Truth, draws: Draws, elapsed: float) -> Observation:
    """Return what the controller sees of the truth; the EKF's belief, if it is used, advances by `elapsed` [s]."""
    noise = tracker.noise
    if tracker.by_filter:
        sample = sense(
            truth.left, truth.right, truth.w, (draws.left, draws.right, draws.gyro),
            tracker.sensors,
        )  # fmt: skip
        filter_step(tracker.belief, sample, elapsed, tracker.filter)
        mean = tracker.belief.mean
        return Observation(mean[X], mean[Y], mean[YAW], speed(mean, tracker.filter), mean[W])
    return Observation(
        truth.x + noise.x * draws.x,
        truth.y + noise.y * draws.y,
        truth.yaw + noise.yaw * draws.yaw,
        truth.v + noise.v * draws.v,
        truth.w + noise.w * draws.w,
    )


@jit_alone
def look(tracker: Tracker, mind: Mind, seen: Observation, t: float) -> Mind:
    """Return the mind with an observation of mission time `t` [s], the target and the errors then; no law runs."""
    aim = target(tracker.course, t, mind.target.segment)
    return Mind(mind.memory, aim, position_errors(seen, aim, ALPHA_SWITCH), seen, seen, mind.command)


@jit_alone
def observed(tracker: Tracker, k: int, truth: Truth, draws: FloatArray) -> Observation:
    """Return what the controller sees at physics step `k`, a tick of the position loop."""
    drawn = named_like(NO_DRAWS, draws[k // tracker.position_steps])
    return observe(tracker, truth, drawn, tracker.position_steps * tracker.dt if k else 0.0)


@jit_alone
def position_tick(tracker: Tracker, mind: Mind, seen: Observation, t: float, dt: float) -> Mind:
    """Return the mind after one step of the position loop at mission time `t` [s], `dt` [s] after the last.

    Behind a predictor the law takes the robot, the target and the errors of the instant at which its command will act; the
    mind keeps those of now.
    """
    now = look(tracker, mind, seen, t)
    ahead, there, off = seen, now.target, now.errors
    if tracker.predicts:
        end = t + tracker.foresight.horizon
        ahead, _ = carry_ahead(tracker.past, tracker.pipe, seen, t, end, tracker.foresight)
        there = target(tracker.course, end, there.segment)
        off = position_errors(ahead, there, ALPHA_SWITCH)
    kept = Errors(off.rho - tracker.lookahead, off.y, off.alpha)
    memory = position_step(tracker.law, tracker.gains, mind.memory, kept, there, ahead, dt)
    return Mind(memory, now.target, now.errors, seen, ahead, mind.command)


@jit_alone
def velocity_tick(tracker: Tracker, mind: Mind, t: float, dt: float) -> Mind:
    """Return the mind after one step of the velocity loop at mission time `t` [s], `dt` [s] after the last.

    The mind holds the new command.
    """
    memory, command = velocity_step(tracker.law, tracker.gains, mind.memory, mind.ahead, dt)
    if tracker.predicts:
        remember(tracker.past, tracker.pipe, command.v, command.w, t)
    return Mind(memory, mind.target, mind.errors, mind.seen, mind.ahead, command)


@jit_alone
def record(row: FloatArray, truth: Truth, mind: Mind) -> None:
    """Write a tick into `row`, in the order of `LOG_COLUMNS`."""
    aim, errors, memory, command, seen = mind.target, mind.errors, mind.memory, mind.command, mind.seen
    log = LogRow(
        truth.x, truth.y, truth.yaw, truth.v, truth.v_y, truth.w, truth.left, truth.right, truth.torque_left,
        truth.torque_right, aim.x, aim.y, aim.heading, errors.rho, errors.y, errors.alpha, memory.u_ref, memory.w_ref,
        command.v, command.w, seen.x, seen.y, seen.yaw, seen.v, seen.w,
    )  # fmt: skip
    for i, number in enumerate(log):
        row[i] = number


@jit_alone
def is_lost(x: float, y: float, yaw_rate: float, target_x: float, target_y: float) -> bool:
    """Return whether a run left its bounds; a number that is not finite counts as lost."""
    return not (math.hypot(x - target_x, y - target_y) < LOST and abs(yaw_rate) < SPINNING)


@jit_alone
def tick(tracker: Tracker, mind: Mind, k: int, truth: Truth, draws: FloatArray, log: FloatArray) -> tuple[Mind, bool]:
    """Return the mind after physics step `k`, and whether the robot is lost.

    Every closed loop calls this at all steps at which a period of the position loop or of the velocity loop begins; between
    them it changes nothing.

    Args:
        tracker: the robot's side.
        mind: its state after the last step.
        k: number of the physics step, from 0.
        truth: the robot at this step; it is read at ticks of the position loop only.
        draws: (ticks, 8) standard normal numbers.
        log: (ticks, 25) the log; a tick of the position loop writes its row.
    """
    due = k % tracker.position_steps == 0
    if due:
        period = tracker.position_steps * tracker.dt
        mind = position_tick(tracker, mind, observed(tracker, k, truth, draws), k * tracker.dt, period)
    if k % tracker.velocity_steps == 0:
        mind = velocity_tick(tracker, mind, k * tracker.dt, tracker.velocity_steps * tracker.dt)
    if due:
        record(log[k // tracker.position_steps], truth, mind)
    return mind, due and is_lost(truth.x, truth.y, truth.w, mind.target.x, mind.target.y)
