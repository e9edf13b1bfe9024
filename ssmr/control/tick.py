"""One tick of the closed loop: observe, compare, control, record.

See Sec. 3.4.4-3.4.6 and 4.3.2, Fig. 4.9 and 4.26.

At the rate of the position loop the robot is observed and the errors to the moving target become
reference velocities; at the rate at which the robot reads commands these become a command.
Everything here is the robot's side of the loop, and so the same for every plant: planar models,
batches of MuJoCo robots, any `Plant` stepped slowly, and a real robot behind ROS.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit, jit_alone, write_numbers
from ssmr.control.law import EMPTY_MEMORY, Command, Memory, Observation
from ssmr.control.laws import position_step, velocity_step
from ssmr.control.predictor import LEARNT, PredictorModel, predict_ahead, remember_command
from ssmr.control.waypoints import ALPHA_SWITCH, Errors, Target, position_errors, target_at
from ssmr.estimation.ekf import filter_step
from ssmr.estimation.settings import YAW, Belief, V, W, X, Y
from ssmr.robot.drive import DriveNumbers, DriveState, Sides, follow_commands
from ssmr.robot.sensors import SensorNumbers, sense_rates
from ssmr.types import FloatArray, Motion

LOST = 3.0
"""A robot farther from its target than this has lost it, and the run ends [m]."""
SPINNING = 20.0
"""A robot that turns faster than this is out of control, and the run ends [rad/s]."""


DRAWS = 8
"""Standard normal numbers of one observation: for x, y, yaw, v, w, both wheel rates and the gyro.
"""


class Clock(NamedTuple):
    """The division of a mission into physics steps."""

    dt: float  # physics step [s]
    position: int  # steps of the position loop's period
    velocity: int  # steps of the velocity loop's period
    n: int  # steps of the whole mission, a whole number of position periods

    @property
    def ticks(self) -> int:
        """Number of ticks of the position loop."""
        return 1 + self.n // self.position


class Tracker(NamedTuple):
    """The robot's side of one closed loop but for `LoopState`; arrays advance in place."""

    law: int  # place of the law in `ssmr.control.laws.PLAIN_CONTROLLERS`
    gains: FloatArray  # `Controller.packed()`
    predicts: bool  # true if the law acts on the state one dead time ahead
    predictor: Any  # the `PredictorModel`; None where `without_unused_parts` left it out
    past: FloatArray  # (n, 2) commands that were sent, the newest last
    predictor_state: FloatArray  # the rest of the memory, `predictor.MEMORY_NUMBERS`
    course: NDArray[np.void]  # `Waypoints.course()`
    lookahead: float  # distance at which the robot keeps behind its target [m]
    by_filter: bool  # true if the controller sees the estimate of the EKF
    belief: Any  # the `Belief` of the EKF, or None
    filter: Any  # `EkfSettings.packed()`
    noise: Observation  # standard deviations of the feedback
    sensors: Any  # a packed `SensorModel`
    clock: Clock  # physics step and periods


class LoopState(NamedTuple):
    """The state of the robot's side between two steps."""

    memory: Memory
    target: Target
    errors: Errors
    seen: Observation
    ahead: Observation  # the robot that the law acts on: as it is seen, or one dead time ahead
    command: Command


NO_ERRORS = SensorNumbers(*(0.0,) * 3)
UNSEEN = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
"""Templates for `named_like`."""
INITIAL_STATE = LoopState(
    memory=EMPTY_MEMORY,
    target=Target(0.0, 0.0, 0.0, 0.0, 0.0, 0),
    errors=Errors(0.0, 0.0, 0.0),
    seen=UNSEEN,
    ahead=UNSEEN,
    command=Command(0.0, 0.0),
)
"""State of a robot's side that has not seen anything yet."""
LOG_COLUMNS = (
    *("x", "y", "yaw", "v_x", "v_y", "yaw_rate", "wheel_left", "wheel_right"),
    *("torque_left", "torque_right"),
    *("target_x", "target_y", "target_yaw", "e_rho", "e_y", "e_alpha"),
    *("u_ref", "w_ref", "v_cmd", "w_cmd"),
    *("seen_x", "seen_y", "seen_yaw", "seen_v", "seen_w"),
    "dead_time_learnt",
)
"""Names of the columns of a run's log, one row for every tick of the position loop."""


@jit_alone
def observe_truth(tracker: Tracker, k: int, truth: Motion, draws: FloatArray) -> Observation:
    """Return the controller's view of the truth at physics step `k`, a tick of the position loop.

    The EKF's belief, if it is used, advances by the time since the last tick.
    """
    noise = tracker.noise
    drawn = draws[k // tracker.clock.position]
    if tracker.by_filter:
        return _filter_observation(tracker.belief, tracker, k, truth, drawn)
    return Observation(
        x=truth.x + noise.x * drawn[0],
        y=truth.y + noise.y * drawn[1],
        yaw=truth.yaw + noise.yaw * drawn[2],
        v=truth.v + noise.v * drawn[3],
        w=truth.w + noise.w * drawn[4],
    )


@jit
def _filter_observation(
    belief: Belief | None, tracker: Tracker, k: int, truth: Motion, drawn: FloatArray
) -> Observation:
    """Return the estimate of the EKF; numba leaves out what follows where its belief is None."""
    if belief is None:
        return UNSEEN
    clock = tracker.clock
    numbers = (drawn[5], drawn[6], drawn[7])
    wheels = Sides(truth.left, truth.right)
    sample = sense_rates(k * clock.dt, wheels, truth.w, numbers, tracker.sensors)
    elapsed = clock.position * clock.dt if k else 0.0
    filter_step(belief, sample, elapsed, tracker.filter)
    mean, _ = belief
    return Observation(mean[X], mean[Y], mean[YAW], mean[V], mean[W])


@jit
def _predict_observation(
    model: PredictorModel | None, tracker: Tracker, seen: Observation, t: float
) -> tuple[Observation, float]:
    """Return the robot when its command will act, and that time [s]; see `_filter_observation`."""
    if model is None:
        return seen, t
    ahead, _, end = predict_ahead(tracker.past, tracker.predictor_state, seen, t, t, model)
    return ahead, end


def without_unused_parts(tracker: Tracker) -> Tracker:
    """Return a tracker without filter and predictor, where it uses neither of them.

    Loops for such ones compile in two thirds of the time.
    """
    if tracker.predicts or tracker.by_filter:
        return tracker
    return tracker._replace(predictor=None, belief=None, filter=None, sensors=None)


@jit_alone
def take_observation(tracker: Tracker, state: LoopState, seen: Observation, t: float) -> LoopState:
    """Return the state with an observation of mission time `t` [s], and target and errors then.

    No law runs.
    """
    aim = target_at(tracker.course, t, state.target.segment)
    errors = position_errors(seen, aim, ALPHA_SWITCH)
    return LoopState(state.memory, aim, errors, seen, seen, state.command)


@jit_alone
def position_tick(
    tracker: Tracker, state: LoopState, seen: Observation, t: float, dt: float
) -> LoopState:
    """Return the state after a step of the position loop at time `t` [s], `dt` [s] after the last.

    Behind a predictor the law takes the robot, the target and the errors of the instant at which
    its command will act; the state keeps those of now.
    """
    now = take_observation(tracker, state, seen, t)
    ahead = seen
    aim = now.target
    errors = now.errors
    if tracker.predicts:
        ahead, end = _predict_observation(tracker.predictor, tracker, seen, t)
        aim = target_at(tracker.course, end, aim.segment)
        errors = position_errors(ahead, aim, ALPHA_SWITCH)
    errors = Errors(errors.rho - tracker.lookahead, errors.y, errors.alpha)
    law_input = (state.memory, errors, aim, ahead, dt)
    memory = position_step(tracker.law, tracker.gains, *law_input)
    return LoopState(memory, now.target, now.errors, seen, ahead, state.command)


@jit_alone
def velocity_tick(tracker: Tracker, state: LoopState, t: float, dt: float) -> LoopState:
    """Return the state with a new command, after a step of the velocity loop at time `t` [s].

    The step comes `dt` [s] after the last.
    """
    memory, command = velocity_step(tracker.law, tracker.gains, state.memory, state.ahead, dt)
    if tracker.predicts:
        remember_command(tracker.past, tracker.predictor_state, command.v, command.w, t)
    return LoopState(memory, state.target, state.errors, state.seen, state.ahead, command)


@jit_alone
def record_tick(row: FloatArray, truth: Motion, state: LoopState, tracker: Tracker) -> None:
    """Write a tick into `row`, in the order of `LOG_COLUMNS`."""
    write_numbers(row, 0, 1, truth)
    aim = state.target
    write_numbers(row, 10, 1, (aim.x, aim.y, aim.heading))
    write_numbers(row, 13, 1, state.errors)
    write_numbers(row, 16, 1, (state.memory.u_ref, state.memory.w_ref))
    write_numbers(row, 18, 1, state.command)
    write_numbers(row, 20, 1, state.seen)
    row[25] = tracker.predictor_state[LEARNT] if tracker.predicts else 0.0


@jit_alone
def is_lost(x: float, y: float, yaw_rate: float, target_x: float, target_y: float) -> bool:
    """Return whether a run left its bounds; a number that is not finite counts as lost."""
    distance = math.hypot(x - target_x, y - target_y)
    return not (distance < LOST and abs(yaw_rate) < SPINNING)


LoopData = tuple[DriveNumbers, FloatArray, FloatArray, FloatArray, FloatArray]
"""The driver of one closed loop, whose command period is the velocity loop's; (ticks, 8) standard
normal numbers; and arrays that are written in place: (1 + n // velocity steps, 2) commands so far,
(position steps, 2) wheel-rate references of the next period [rad/s], and (ticks, 26) the log."""


@jit
def plan_period(
    tracker: Tracker,
    state: LoopState,
    driver: DriveState,
    k: int,
    n: int,
    truth: Motion,
    data: LoopData,
) -> tuple[LoopState, DriveState, bool]:
    """Run a tick of the position loop, and plan the references of the wheels until the next one.

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
    drive, draws, commands, references, log = data
    clock = tracker.clock
    position_dt = clock.position * clock.dt
    velocity_dt = clock.velocity * clock.dt
    seen = observe_truth(tracker, k, truth, draws)
    state = position_tick(tracker, state, seen, k * clock.dt, position_dt)
    for j in range(k, k + max(n, 1)):
        if j % clock.velocity == 0:
            state = velocity_tick(tracker, state, j * clock.dt, velocity_dt)
            i = j // clock.velocity
            commands[i, 0] = state.command.v
            commands[i, 1] = state.command.w
        if j == k:
            record_tick(log[k // clock.position], truth, state, tracker)
        if j < k + n:
            driver = follow_commands(commands, j, drive, (0.0, 0.0), driver)
            references[j - k, 0] = driver.left
            references[j - k, 1] = driver.right
    aim = state.target
    return state, driver, is_lost(truth.x, truth.y, truth.w, aim.x, aim.y)
