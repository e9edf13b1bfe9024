"""Many closed loops at once: compiled loops of planar models, and the robots' side where something else moves the bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit_alone, named_like, share_among_threads
from ssmr.control.law import EMPTY_MEMORY, Command
from ssmr.control.laws import AnyController
from ssmr.control.loop import (
    Clock,
    ClosedRun,
    LoopSettings,
    closed_run,
    common_settings,
    draw,
    make_clock,
    make_trackers,
    robot_sides,
)
from ssmr.control.mission import PythonController
from ssmr.control.predictor import NO_PREDICTOR
from ssmr.control.tick import (
    INITIAL_STATE,
    LOG_COLUMNS,
    NO_DRAWS,
    NO_ERRORS,
    LoopData,
    LoopState,
    Tracker,
    Truth,
    plan_period,
)
from ssmr.control.waypoints import Target, Waypoints
from ssmr.estimation.settings import NO_NUMBERS, Belief
from ssmr.models.law import PlanarRobot
from ssmr.robot.drive import (
    DRIVE_TEMPLATE,
    DriveNumbers,
    DriveState,
    Sides,
    continue_references,
    drive_numbers,
    rolling,
)
from ssmr.robot.vehicle import Drive
from ssmr.simulation import (
    PLANAR_COLUMNS,
    PLANAR_DT,
    PlanarModel,
    PlanarMotion,
    move,
    run_planar,
    sideways,
    turning_wheels,
)
from ssmr.types import FloatArray, State

_TRUTH = Truth(*(0.0,) * 10)
_DRIVER = DriveState(0.0, 0.0, 0.0, 0.0)


@jit_alone
def run_planar_loop(
    tracker: Tracker,
    drive: DriveNumbers,
    robot: PlanarRobot,
    start: Truth,
    draws: FloatArray,
    disturbance: FloatArray,
    log: FloatArray,
) -> int:
    """Run a planar model in closed loop.

    Args:
        tracker: the robot's side.
        drive: the drive; its command period is the velocity loop's.
        robot: the model; the type of its parameters chooses the law of motion.
        start: the robot at the start.
        draws: (ticks or more, 8) standard normal numbers.
        disturbance: (n,) yaw accelerations [rad/s2], or (1,) for the same at every step.
        log: (ticks, 25) space for what is recorded.

    Returns:
        The number of ticks that were recorded: fewer than `log` has rows where the robot was lost
        after the last of them.
    """
    n, last = tracker.position_steps, len(log) - 1
    data = LoopData(
        drive, draws, np.empty((1 + last * n // tracker.velocity_steps, 2)), np.empty((n, 2)), log
    )
    now = PlanarMotion(start.x, start.y, start.yaw, start.v, start.w, 0.0, 0.0, 0.0, 0.0)
    driver, state = rolling(Sides(start.left, start.right), drive), INITIAL_STATE
    for i in range(last + 1):
        left, right = turning_wheels(now, Sides(driver.left, driver.right), robot)
        aside = sideways(now.v, now.w, robot)
        truth = Truth(
            now.x,
            now.y,
            now.yaw,
            now.v,
            aside,
            now.w,
            left,
            right,
            now.torque_left,
            now.torque_right,
        )
        steps = n if i < last else 0
        state, driver, lost = plan_period(tracker, state, driver, i * n, steps, truth, data)
        if lost:
            return i + 1
        for j in range(steps):
            push = disturbance[i * n + j] if len(disturbance) > 1 else disturbance[0]
            now = move(
                now, Sides(data.references[j, 0], data.references[j, 1]), push, tracker.dt, robot
            )
    return last + 1


class Batch(NamedTuple):
    """S closed loops whose robots something else moves, as arrays."""

    trackers: (
        Tracker  # the robots' sides: an array of S rows in the place of each field that may differ
    )
    drives: FloatArray  # (S, 13) `DriveNumbers`
    memories: FloatArray  # (S, 7) memories of the laws
    segments: Any  # (S,) segments of the targets
    drivers: FloatArray  # (S, 4) states of the drivers
    alive: Any  # (S,) bool; the log of a robot that was lost grows no more
    commands: FloatArray  # (S, 1 + n // velocity steps, 2) commands so far
    references: (
        FloatArray  # (S, position steps, 2) wheel rates to ask for in the next period [rad/s]
    )
    logs: FloatArray  # (S, ticks, 25) logs


def _batch_of(
    trackers: Sequence[Tracker], drives: Sequence[DriveNumbers], clock: Clock, state: State
) -> Batch:
    """Return the closed loops that begin, with robots that roll as in `state`."""
    count = len(trackers)
    rows: dict[str, Any] = {
        name: np.array([getattr(t, name) for t in trackers], dtype=np.float64)
        for name in (
            "predictor",
            "past",
            "predictor_state",
            "lookahead",
            "filter",
            "noise",
            "sensors",
        )
    }
    rows["law"], rows["predicts"] = (
        np.array([t.law for t in trackers]),
        np.array([t.predicts for t in trackers]),
    )
    rows["belief"] = Belief(
        *(np.array(arrays) for arrays in zip(*(t.belief for t in trackers), strict=True))
    )
    rows["gains"] = np.zeros((count, max(len(t.gains) for t in trackers)))
    for row, tracker in zip(rows["gains"], trackers, strict=True):
        row[: len(tracker.gains)] = tracker.gains
    return Batch(
        trackers=trackers[0]._replace(**rows),
        drives=np.array(drives, dtype=np.float64),
        memories=np.tile(EMPTY_MEMORY, (count, 1)),
        segments=np.zeros(count, dtype=np.int64),
        drivers=np.array([rolling(Sides(state.wheel_left, state.wheel_right), d) for d in drives]),
        alive=np.ones(count, dtype=np.bool_),
        commands=np.zeros((count, 1 + clock.n // clock.velocity, 2)),
        references=np.zeros((count, clock.position, 2)),
        logs=np.empty((count, clock.ticks, len(LOG_COLUMNS))),
    )


@jit_alone
def _tracker_of(t: Any, i: int) -> Tracker:
    return Tracker(
        t.law[i], t.gains[i], t.predicts[i], named_like(NO_PREDICTOR, t.predictor[i]), t.past[i], t.predictor_state[i],
        t.course, t.lookahead[i], t.by_filter, Belief(t.belief.mean[i], t.belief.covariance[i]),
        named_like(NO_NUMBERS, t.filter[i]), named_like(NO_DRAWS, t.noise[i]), named_like(NO_ERRORS, t.sensors[i]),
        t.position_steps, t.velocity_steps, t.dt,
    )  # fmt: skip


@jit_alone
def _plan_batch(b: Batch, k: int, n: int, states: FloatArray, draws: FloatArray) -> None:
    """Plan one period of every loop that is alive, see `plan_period`; `draws` (D, ticks, 8) are taken in turn."""
    for i in range(len(states)):
        if not b.alive[i]:
            continue
        sent = b.commands[i, max(k - 1, 0) // b.trackers.velocity_steps]
        state = LoopState(
            named_like(EMPTY_MEMORY, b.memories[i]),
            Target(0.0, 0.0, 0.0, 0.0, 0.0, b.segments[i]),
            INITIAL_STATE.errors,
            INITIAL_STATE.seen,
            INITIAL_STATE.ahead,
            Command(sent[0], sent[1]),
        )
        state, driver, lost = plan_period(
            _tracker_of(b.trackers, i), state, named_like(_DRIVER, b.drivers[i]), k, n, named_like(_TRUTH, states[i]),
            LoopData(
                named_like(DRIVE_TEMPLATE, b.drives[i]), draws[i % len(draws)], b.commands[i], b.references[i], b.logs[i]
            ),
        )  # fmt: skip
        b.alive[i] = not lost
        b.segments[i] = state.target.segment
        for j, number in enumerate(state.memory):
            b.memories[i, j] = number
        for j, number in enumerate(driver):
            b.drivers[i, j] = number


class Bodies(Protocol):
    """S robots that something else moves, each with its own physics."""

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots whose physics failed since the last tick."""
        ...

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.control.tick.Truth`."""
        ...

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take (S, n, 2) wheel-rate references [rad/s] and (S, n) yaw accelerations [rad/s2] through n physics steps."""
        ...


class PlanarBodies:
    """Planar robots that are moved period by period."""

    def __init__(self, models: Sequence[PlanarModel], state: State, dt: float) -> None:
        """Place every robot in `state`; `dt` is the physics step [s]."""
        self._robots, self._dt = [model.packed(dt) for model in models], dt
        self._now = [
            PlanarMotion(*map(float, (state.x, state.y, state.yaw, state.v_x, state.yaw_rate)))
        ] * len(models)
        self._states, self._failed = np.empty((len(models), 10)), np.full(len(models), -1)
        self.advance(np.empty((len(models), 0, 2)), np.zeros((len(models), 1)))
        for row, robot in zip(self._states, self._robots, strict=True):
            if robot.ideal:
                row[6:8] = state.wheel_left, state.wheel_right

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots whose numbers were no longer finite in the last run."""
        return np.asarray(self._failed >= 0)

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.control.tick.Truth`."""
        return self._states.copy()

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take (S, n, 2) references [rad/s] and (S, n) yaw accelerations [rad/s2] through n physics steps."""
        n = references.shape[1]
        for i, robot in enumerate(self._robots):
            out = np.empty((2 if n else 1, PLANAR_COLUMNS))
            failed, end = run_planar(
                references[i], pushes[i], self._dt, max(n, 1), robot, self._now[i], out
            )
            self._now[i], self._failed[i], self._states[i] = (
                PlanarMotion(*end),
                failed,
                out[-1, :10],
            )


def run_bodies(
    bodies_at: Callable[[State], Bodies],
    drives: Sequence[Drive],
    dt: float,
    controllers: Sequence[AnyController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    seeds: Sequence[int],
    start: State | None = None,
) -> list[ClosedRun]:
    """Run many closed loops, whole periods of the position loop at a time: what is asked of the wheels is known ahead.

    `bodies_at` places the S robots, which have these `drives`, in a state; `dt` is their physics
    step [s]. The `controllers` are all compiled or all Python objects; `seeds` and `start` are
    those of `run_loops`.

    Raises:
        ControllerError: a Python object failed.
        ValueError: several kinds of feedback or disturbance, or sets of periods; periods that are
            no whole number of steps; no loops or no seeds.
    """
    first, count = common_settings(settings, seeds), len(settings)
    if len({isinstance(law, PythonController) for law in controllers}) != 1:
        raise ValueError("a population has compiled laws or Python objects, not both")
    clock = make_clock(waypoints, first, dt)
    drawn = [draw(clock, first, seed) for seed in seeds]
    draws, pushes = (
        np.array([d for d, _ in drawn]),
        np.array([np.resize(d, clock.n) for _, d in drawn]),
    )
    turn, state = np.arange(count) % len(seeds), start or waypoints.start
    bodies, numbers = (
        bodies_at(state),
        [drive_numbers(drive, first.velocity_period, dt) for drive in drives],
    )
    trackers = make_trackers(controllers, settings, waypoints, clock, state)
    batch = _batch_of(trackers, numbers, clock, state)
    objects = isinstance(controllers[0], PythonController)
    sides = robot_sides(controllers, settings, waypoints, trackers) if objects else []
    ticks = np.full(count, clock.ticks)
    for tick_number in range(clock.ticks):
        k, n = tick_number * clock.position, clock.position if tick_number < clock.ticks - 1 else 0
        before, states = batch.alive.copy(), bodies.states()
        if not objects:
            _plan_batch(batch, k, n, states, draws)
        for i in np.flatnonzero(before) if objects else ():
            truth = Truth(*map(float, states[i]))
            for j in (
                k,
                *range(-(-(k + 1) // clock.velocity) * clock.velocity, k + n, clock.velocity),
            ):
                batch.alive[i] &= not sides[i].tick(j, truth, draws[i % len(draws)], batch.logs[i])
                batch.commands[i, j // clock.velocity] = sides[i].state.command
            driver, references = DriveState(*batch.drivers[i]), batch.references[i, :n]
            batch.drivers[i] = continue_references(
                batch.commands[i], numbers[i], (0.0, 0.0), driver, k, references
            )
        ticks[before & ~batch.alive] = tick_number + 1
        batch.references[~batch.alive] = 0.0
        if not batch.alive.any():
            break
        if n:
            bodies.advance(
                batch.references, np.where(batch.alive[:, None], pushes[turn, k : k + n], 0.0)
            )
            gave_up = batch.alive & bodies.gave_up
            ticks[gave_up], batch.alive[gave_up] = tick_number + 1, False
    return [closed_run(log[:n], clock) for log, n in zip(batch.logs, ticks, strict=True)]


def run_loops(
    models: Sequence[PlanarModel],
    controllers: Sequence[AnyController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    seeds: Sequence[int],
    start: State | None = None,
    workers: int = 1,
) -> list[ClosedRun]:
    """Run many closed loops of one kind of planar model along one reference; the result does not depend on `workers`.

    `seeds` are taken in turn: loop i gets `seeds[i % len(seeds)]`. All begin at rest at the first
    waypoint, or in `start`.

    Raises:
        ControllerError: a Python object failed.
        ValueError: several kinds of model, of feedback or disturbance, or sets of periods; periods
            that are no whole number of steps; no loops or no seeds.
    """
    first, dt = common_settings(settings, seeds), PLANAR_DT
    if len({type(model.parameters) for model in models}) != 1:
        raise ValueError("a population is one kind of model")
    drives = [model.drive for model in models]
    if any(isinstance(law, PythonController) for law in controllers):
        return run_bodies(
            lambda at: PlanarBodies(models, at, dt),
            drives,
            dt,
            controllers,
            settings,
            waypoints,
            seeds,
            start,
        )
    clock, state = make_clock(waypoints, first, dt), start or waypoints.start
    trackers = make_trackers(controllers, settings, waypoints, clock, state)
    numbers, robots = (
        [drive_numbers(d, first.velocity_period, dt) for d in drives],
        [m.packed(dt) for m in models],
    )
    random = [draw(clock, first, seed) for seed in seeds]
    ticks, began = [0] * len(models), Truth(*map(float, (*astuple(state), 0.0, 0.0)))
    logs = np.empty((len(models), clock.ticks, len(LOG_COLUMNS)))

    def run(begin: int, end: int) -> None:
        for i in range(begin, end):
            draws, disturbance = random[i % len(seeds)]
            ticks[i] = run_planar_loop(
                trackers[i], numbers[i], robots[i], began, draws, disturbance, logs[i]
            )

    share_among_threads(run, len(models), workers)
    return [closed_run(log[:n], clock) for log, n in zip(logs, ticks, strict=True)]
