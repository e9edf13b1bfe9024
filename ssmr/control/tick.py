"""One tick of the closed loop (Sec. 3.4.4-3.4.6, 4.3.2, Fig. 4.9, 4.26): observe, compare, control, record.

At the rate of the position loop the robot is observed and the errors to the moving target become
reference velocities; at the rate at which the robot reads commands these become a command.
Everything here is the robot's side of the loop, and so alike for every plant: planar models,
batches of MuJoCo robots, any `Plant` stepped slowly, and a real robot behind ROS.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit, jit_alone, named_like
from ssmr.control.law import EMPTY_MEMORY, Command, Memory, Observation
from ssmr.control.laws import position_step, velocity_step
from ssmr.control.predictor import PredictorModel, predict_ahead, remember
from ssmr.control.waypoints import ALPHA_SWITCH, Errors, Target, position_errors, target
from ssmr.estimation.ekf import filter_step
from ssmr.estimation.settings import YAW, Belief, V, W, X, Y
from ssmr.robot.drive import DriveNumbers, DriveState, follow
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
    """Everything about the robot's side of one closed loop but `LoopState`; arrays advance in place."""

    law: int  # place of the law in `ssmr.control.laws.PLAIN_CONTROLLERS`
    gains: FloatArray  # `Controller.packed()`
    predicts: bool  # true if the law acts on the state one dead time ahead
    predictor: PredictorModel  # numbers of the predictor
    past: FloatArray  # (n, 2) commands that were sent, the newest last
    predictor_state: FloatArray  # (16,) the rest of the predictor's memory, a `PredictorState`
    course: NDArray[np.void]  # `Waypoints.course()`
    lookahead: float  # distance at which the robot keeps behind its target [m]
    by_filter: bool  # true if the controller sees the estimate of the EKF
    belief: Belief  # state of the EKF
    filter: Any  # `EkfSettings.packed()`
    noise: Draws  # standard deviations of the feedback and of the sensors
    sensors: SensorErrors  # `SensorModel.packed()`
    position_steps: int  # physics steps of the position loop's period
    velocity_steps: int  # physics steps of the velocity loop's period
    dt: float  # physics step [s]


class LoopState(NamedTuple):
    """The state of the robot's side between two steps."""

    memory: Memory
    target: Target
    errors: Errors
    seen: Observation
    ahead: Observation  # the robot that the law acts on: as it is seen, or one dead time ahead
    command: Command


NO_DRAWS, NO_ERRORS = Draws(*(0.0,) * 8), SensorErrors(*(0.0,) * 3)
"""Templates for `named_like`."""
_UNSEEN = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
INITIAL_STATE = LoopState(
    EMPTY_MEMORY,
    Target(0.0, 0.0, 0.0, 0.0, 0.0, 0),
    Errors(0.0, 0.0, 0.0),
    _UNSEEN,
    _UNSEEN,
    Command(0.0, 0.0),
)
"""State of a robot's side that has not seen anything yet."""
LOG_COLUMNS = (
    *(
        "x",
        "y",
        "yaw",
        "v_x",
        "v_y",
        "yaw_rate",
        "wheel_left",
        "wheel_right",
        "torque_left",
        "torque_right",
    ),
    *(
        "target_x",
        "target_y",
        "target_yaw",
        "e_rho",
        "e_y",
        "e_alpha",
        "u_ref",
        "w_ref",
        "v_cmd",
        "w_cmd",
    ),
    *("seen_x", "seen_y", "seen_yaw", "seen_v", "seen_w"),
)
"""Names of the columns of a run's log, one row for every tick of the position loop."""


@jit_alone
def observed(tracker: Tracker, k: int, truth: Truth, draws: FloatArray) -> Observation:
    """Return what the controller sees of the truth at physics step `k`, a tick of the position loop.

    The EKF's belief, if it is used, advances by the time since the last tick.
    """
    noise, drawn = tracker.noise, named_like(NO_DRAWS, draws[k // tracker.position_steps])
    if tracker.by_filter:
        sample = sense(
            truth.left, truth.right, truth.w, (drawn.left, drawn.right, drawn.gyro), tracker.sensors
        )
        filter_step(
            tracker.belief,
            sample,
            tracker.position_steps * tracker.dt if k else 0.0,
            tracker.filter,
        )
        mean = tracker.belief.mean
        return Observation(mean[X], mean[Y], mean[YAW], mean[V], mean[W])
    return Observation(
        truth.x + noise.x * drawn.x,
        truth.y + noise.y * drawn.y,
        truth.yaw + noise.yaw * drawn.yaw,
        truth.v + noise.v * drawn.v,
        truth.w + noise.w * drawn.w,
    )


@jit_alone
def see(tracker: Tracker, state: LoopState, seen: Observation, t: float) -> LoopState:
    """Return the state with an observation of mission time `t` [s], the target and the errors then; no law runs."""
    aim = target(tracker.course, t, state.target.segment)
    return LoopState(
        state.memory, aim, position_errors(seen, aim, ALPHA_SWITCH), seen, seen, state.command
    )


@jit_alone
def position_tick(
    tracker: Tracker, state: LoopState, seen: Observation, t: float, dt: float
) -> LoopState:
    """Return the state after one step of the position loop at mission time `t` [s], `dt` [s] after the last.

    Behind a predictor the law takes the robot, the target and the errors of the instant at which
    its command will act; the state keeps those of now.
    """
    now = see(tracker, state, seen, t)
    ahead, aim, errors = seen, now.target, now.errors
    if tracker.predicts:
        end = t + tracker.predictor.horizon
        ahead, _ = predict_ahead(
            tracker.past, tracker.predictor_state, seen, t, end, tracker.predictor
        )
        aim = target(tracker.course, end, aim.segment)
        errors = position_errors(ahead, aim, ALPHA_SWITCH)
    kept = Errors(errors.rho - tracker.lookahead, errors.y, errors.alpha)
    memory = position_step(tracker.law, tracker.gains, state.memory, kept, aim, ahead, dt)
    return LoopState(memory, now.target, now.errors, seen, ahead, state.command)


@jit_alone
def velocity_tick(tracker: Tracker, state: LoopState, t: float, dt: float) -> LoopState:
    """Return the state, with a new command, after one step of the velocity loop at time `t` [s], `dt` [s] after the last."""
    memory, command = velocity_step(tracker.law, tracker.gains, state.memory, state.ahead, dt)
    if tracker.predicts:
        remember(tracker.past, tracker.predictor_state, command.v, command.w, t)
    return LoopState(memory, state.target, state.errors, state.seen, state.ahead, command)


@jit_alone
def record(row: FloatArray, truth: Truth, state: LoopState) -> None:
    """Write a tick into `row`, in the order of `LOG_COLUMNS`."""
    aim, errors, memory, command = state.target, state.errors, state.memory, state.command
    for i, number in enumerate(truth):
        row[i] = number
    row[10], row[11], row[12], row[13], row[14], row[15] = (
        aim.x,
        aim.y,
        aim.heading,
        errors.rho,
        errors.y,
        errors.alpha,
    )
    row[16], row[17], row[18], row[19] = memory.u_ref, memory.w_ref, command.v, command.w
    for i, number in enumerate(state.seen):
        row[20 + i] = number


@jit_alone
def is_lost(x: float, y: float, yaw_rate: float, target_x: float, target_y: float) -> bool:
    """Return whether a run left its bounds; a number that is not finite counts as lost."""
    return not (math.hypot(x - target_x, y - target_y) < LOST and abs(yaw_rate) < SPINNING)


class LoopData(NamedTuple):
    """The driver of one closed loop, its noise, and arrays that are written in place."""

    drive: DriveNumbers  # the driver; its command period is the velocity loop's
    draws: FloatArray  # (ticks, 8) standard normal numbers
    commands: FloatArray  # (1 + n // velocity steps, 2) commands so far
    references: FloatArray  # (position steps, 2) wheel rates to ask for in the next period of the position loop [rad/s]
    log: FloatArray  # (ticks, 25) the log


@jit
def plan_period(
    tracker: Tracker,
    state: LoopState,
    driver: DriveState,
    k: int,
    n: int,
    truth: Truth,
    data: LoopData,
) -> tuple[LoopState, DriveState, bool]:
    """Run a tick of the position loop, and plan what is asked of the wheels until the next one.

    That depends on nothing that happens meanwhile, so the whole period is planned at once.

    Args:
        tracker: the robot's side.
        state: its state after the last period.
        driver: state of the driver likewise.
        k: physics step at which the period begins.
        n: physics steps to plan; 0 at the end of the mission.
        truth: the robot at this step.
        data: the driver and the noise; commands, references and log are written.

    Returns:
        The states of the robot's side and of the driver at the end of the period, and whether the
        robot is lost.
    """
    period, between = tracker.position_steps * tracker.dt, tracker.velocity_steps * tracker.dt
    state = position_tick(
        tracker, state, observed(tracker, k, truth, data.draws), k * tracker.dt, period
    )
    for j in range(k, k + max(n, 1)):
        if j % tracker.velocity_steps == 0:
            state = velocity_tick(tracker, state, j * tracker.dt, between)
            i = j // tracker.velocity_steps
            data.commands[i, 0], data.commands[i, 1] = state.command.v, state.command.w
        if j == k:
            record(data.log[k // tracker.position_steps], truth, state)
        if j < k + n:
            driver = follow(data.commands, j, data.drive, (0.0, 0.0), driver)
            data.references[j - k, 0], data.references[j - k, 1] = driver.left, driver.right
    return state, driver, is_lost(truth.x, truth.y, truth.w, state.target.x, state.target.y)
