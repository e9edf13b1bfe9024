"""Many closed loops at once: compiled planar loops, and robots that something else moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ssmr._jit import jit_alone, named_like, share_among_threads, write_numbers
from ssmr.control.law import EMPTY_MEMORY, Command
from ssmr.control.laws import AnyController
from ssmr.control.loop import (
    ClosedRun,
    LoopSettings,
    closed_run,
    common_settings,
    draw_noise,
    make_clock,
    make_trackers,
    robot_sides,
)
from ssmr.control.mission import PythonController
from ssmr.control.predictor import NO_PREDICTOR
from ssmr.control.tick import (
    INITIAL_STATE,
    LOG_COLUMNS,
    NO_ERRORS,
    UNSEEN,
    LoopState,
    Tracker,
    plan_period,
    without_unused_parts,
)
from ssmr.control.waypoints import Target, Waypoints
from ssmr.estimation.settings import NO_NUMBERS
from ssmr.models.law import PlanarRobot
from ssmr.robot.bodies import Bodies
from ssmr.robot.drive import (
    DRIVE_TEMPLATE,
    DriveNumbers,
    DriveState,
    Sides,
    continue_references,
    drive_numbers,
    rolling_references,
)
from ssmr.robot.vehicle import Drive
from ssmr.simulation import PLANAR_DT, PlanarBodies, PlanarModel, move_robot, start_of
from ssmr.types import FloatArray, Motion, State

_MOTION = State().motion
_DRIVER = DriveState(0.0, 0.0, 0.0, 0.0)


@jit_alone
def _run_planar_loop(
    tracker: Tracker,
    drive: DriveNumbers,
    robot: PlanarRobot,
    start: Motion,
    draws: FloatArray,
    disturbance: FloatArray,
    log: FloatArray,
) -> int:
    """Run a planar model in closed loop.

    Args:
        tracker: the robot's side.
        drive: the drive; its command period is the velocity loop's.
        robot: the model; the type of its parameters chooses the law of motion.
        start: the state at the start.
        draws: (ticks or more, 8) standard normal numbers.
        disturbance: (n,) yaw accelerations [rad/s2], or (1,) for the same at every step.
        log: (ticks, 26) space for the records.

    Returns:
        The number of ticks that were recorded: fewer than `log` has rows where the robot was lost
        after the last of them.
    """
    n = tracker.clock.position
    last = len(log) - 1
    commands = np.empty((1 + last * n // tracker.clock.velocity, 2))
    references = np.empty((n, 2))
    data = (drive, draws, commands, references, log)
    now, integral = start_of(start, robot.vehicle, robot.x_icr, robot.drift, robot.ideal)
    driver = rolling_references(Sides(start.left, start.right), drive)
    state = INITIAL_STATE
    for i in range(last + 1):
        first = i * n
        steps = n if i < last else 0
        state, driver, lost = plan_period(
            tracker, state, driver, k=first, n=steps, truth=now, data=data
        )
        if lost:
            return i + 1
        for j in range(steps):
            push = disturbance[first + j] if len(disturbance) > 1 else disturbance[0]
            wheels = Sides(references[j, 0], references[j, 1])
            now, integral = move_robot(now, integral, wheels, push, robot)
    return last + 1


_Carried = tuple[FloatArray, Any, FloatArray, Any]
"""S loops carry this from period to period: (S, 7) memories of the laws, (S,) segments of the
targets, (S, 4) states of the drivers, and (S,) whether they are alive; the log of a robot that was
lost grows no more."""
_Written = tuple[FloatArray, FloatArray, FloatArray]
"""(S, 1 + n // velocity steps, 2) commands so far, (S, position steps, 2) wheel rates to ask for in
the next period [rad/s], and (S, ticks, 26) logs."""


def _rows_of(
    trackers: Sequence[Tracker], drives: Sequence[DriveNumbers]
) -> tuple[Tracker, FloatArray]:
    """Return the robots' sides, with an array of S rows for each field that may differ.

    The (S, 13) numbers of their drives stand beside them.
    """
    arrays = ("predictor", "past", "predictor_state", "lookahead", "filter", "noise", "sensors")
    rows: dict[str, Any] = {
        name: np.array([getattr(t, name) for t in trackers], dtype=np.float64) for name in arrays
    }
    rows["law"] = np.array([t.law for t in trackers])
    rows["predicts"] = np.array([t.predicts for t in trackers])
    beliefs = zip(*(t.belief for t in trackers), strict=True)
    rows["belief"] = tuple(map(np.array, beliefs))
    gains = np.zeros((len(trackers), max(len(t.gains) for t in trackers)))
    for row, tracker in zip(gains, trackers, strict=True):
        row[: len(tracker.gains)] = tracker.gains
    rows["gains"] = gains
    return trackers[0]._replace(**rows), np.array(drives, dtype=np.float64)


@jit_alone
def _tracker_of(t: Any, i: int) -> Tracker:
    return Tracker(
        law=t.law[i],
        gains=t.gains[i],
        predicts=t.predicts[i],
        predictor=named_like(NO_PREDICTOR, t.predictor[i]),
        past=t.past[i],
        predictor_state=t.predictor_state[i],
        course=t.course,
        lookahead=t.lookahead[i],
        by_filter=t.by_filter,
        belief=(t.belief[0][i], t.belief[1][i]),
        filter=named_like(NO_NUMBERS, t.filter[i]),
        noise=named_like(UNSEEN, t.noise[i]),
        sensors=named_like(NO_ERRORS, t.sensors[i]),
        clock=t.clock,
    )


@jit_alone
def _plan_all(
    trackers: Tracker,
    drives: FloatArray,
    carried: _Carried,
    written: _Written,
    k: int,
    n: int,
    states: FloatArray,
    draws: FloatArray,
) -> None:
    """Plan one period of every loop that is alive, see `plan_period`.

    `trackers` and `drives` are those of `_rows_of`; `draws` (D, ticks, 8) are taken in turn.
    """
    memories, segments, drivers, alive = carried
    commands, references, logs = written
    for i in range(len(states)):
        if not alive[i]:
            continue
        sent = commands[i, max(k - 1, 0) // trackers.clock.velocity]
        state = LoopState(
            memory=named_like(EMPTY_MEMORY, memories[i]),
            target=Target(0.0, 0.0, 0.0, 0.0, 0.0, segments[i]),
            errors=INITIAL_STATE.errors,
            seen=INITIAL_STATE.seen,
            ahead=INITIAL_STATE.ahead,
            command=Command(sent[0], sent[1]),
        )
        driver = named_like(_DRIVER, drivers[i])
        truth = named_like(_MOTION, states[i])
        drive = named_like(DRIVE_TEMPLATE, drives[i])
        noise = draws[i % len(draws)]
        data = (drive, noise, commands[i], references[i], logs[i])
        tracker = _tracker_of(trackers, i)
        state, driver, lost = plan_period(tracker, state, driver, k=k, n=n, truth=truth, data=data)
        alive[i] = not lost
        segments[i] = state.target.segment
        write_numbers(memories[i], 0, 1, state.memory)
        write_numbers(drivers[i], 0, 1, driver)


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
    """Run many closed loops, whole periods of the position loop at a time.

    That is possible because the references of the wheels in a period are known at its beginning.
    `bodies_at` places the S robots, which have these `drives`, in a state; `dt` is their physics
    step [s]. The `controllers` are all compiled or all Python objects; `seeds` and `start` are
    those of `run_loops`.

    Raises:
        ControllerError: a Python object failed.
        ValueError: several kinds of feedback or disturbance, or sets of periods; periods that are
            no whole number of steps; no loops or no seeds.
    """
    first = common_settings(settings, seeds)
    if len({isinstance(law, PythonController) for law in controllers}) != 1:
        raise ValueError("a population has compiled laws or Python objects, not both")
    clock = make_clock(waypoints, first, dt)
    random = [draw_noise(clock, first, seed) for seed in seeds]
    draws = np.array([normal for normal, _ in random])
    pushes = np.array([np.resize(push, clock.n) for _, push in random])
    count = len(settings)
    turn = np.arange(count) % len(seeds)
    state = start or waypoints.start
    bodies = bodies_at(state)
    numbers = [drive_numbers(drive, first.velocity_period, dt) for drive in drives]
    trackers = make_trackers(controllers, settings, waypoints, clock, state, seeds)
    rows = _rows_of(trackers, numbers)
    wheels = Sides(state.wheel_left, state.wheel_right)
    drivers = np.array([rolling_references(wheels, drive) for drive in numbers])
    alive = np.ones(count, dtype=np.bool_)
    carried = np.tile(EMPTY_MEMORY, (count, 1)), np.zeros(count, dtype=np.int64), drivers, alive
    commands = np.zeros((count, 1 + clock.n // clock.velocity, 2))
    references = np.zeros((count, clock.position, 2))
    logs = np.empty((count, clock.ticks, len(LOG_COLUMNS)))
    written = (commands, references, logs)
    objects = isinstance(controllers[0], PythonController)
    sides = robot_sides(controllers, settings, waypoints, trackers) if objects else []
    ticks = np.full(count, clock.ticks)
    for tick in range(clock.ticks):
        k = tick * clock.position
        n = clock.position if tick < clock.ticks - 1 else 0
        before = alive.copy()
        states = bodies.states()
        if not objects:
            _plan_all(*rows, carried, written, k=k, n=n, states=states, draws=draws)
        for i in np.flatnonzero(before) if objects else ():
            truth = Motion(*map(float, states[i]))
            side = sides[i]
            due = -(-(k + 1) // clock.velocity) * clock.velocity  # the first command after step k
            for j in (k, *range(due, k + n, clock.velocity)):
                alive[i] &= not side.tick(j, truth, draws[i % len(draws)], logs[i])
                commands[i, j // clock.velocity] = side.state.command
            driver = DriveState(*drivers[i])
            out = references[i, :n]
            drivers[i] = continue_references(commands[i], numbers[i], (0.0, 0.0), driver, k, out)
        ticks[before & ~alive] = tick + 1
        references[~alive] = 0.0
        if not alive.any():
            break
        if n:
            push = pushes[turn, k : k + n]
            push[~alive] = 0.0
            bodies.advance(references, push)
            gave_up = alive & bodies.gave_up
            ticks[gave_up] = tick + 1
            alive[gave_up] = False
    return [closed_run(log[:n], clock) for log, n in zip(logs, ticks, strict=True)]


def run_loops(
    models: Sequence[PlanarModel],
    controllers: Sequence[AnyController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    seeds: Sequence[int],
    start: State | None = None,
    workers: int = 1,
) -> list[ClosedRun]:
    """Run many closed loops of one kind of planar model along one reference.

    `seeds` are taken in turn: loop i gets `seeds[i % len(seeds)]`. All begin at rest at the first
    waypoint, or in `start`. The result does not depend on `workers`.

    Raises:
        ControllerError: a Python object failed.
        ValueError: several kinds of model, of feedback or disturbance, or sets of periods; periods
            that are no whole number of steps; no loops or no seeds.
    """
    first = common_settings(settings, seeds)
    dt = PLANAR_DT
    if len({type(model.parameters) for model in models}) != 1:
        raise ValueError("a population is one kind of model")
    drives = [model.drive for model in models]
    if any(isinstance(law, PythonController) for law in controllers):
        return run_bodies(
            lambda at: PlanarBodies(models, at, dt),
            drives,
            dt,
            controllers=controllers,
            settings=settings,
            waypoints=waypoints,
            seeds=seeds,
            start=start,
        )
    clock = make_clock(waypoints, first, dt)
    state = start or waypoints.start
    made = make_trackers(controllers, settings, waypoints, clock, state, seeds)
    trackers = [without_unused_parts(tracker) for tracker in made]
    numbers = [drive_numbers(drive, first.velocity_period, dt) for drive in drives]
    robots = [model.packed(dt) for model in models]
    random = [draw_noise(clock, first, seed) for seed in seeds]
    ticks = [0] * len(models)
    logs = np.empty((len(models), clock.ticks, len(LOG_COLUMNS)))

    def run(begin: int, end: int) -> None:
        for i in range(begin, end):
            draws, disturbance = random[i % len(seeds)]
            ticks[i] = _run_planar_loop(
                trackers[i],
                numbers[i],
                robots[i],
                state.motion,
                draws=draws,
                disturbance=disturbance,
                log=logs[i],
            )

    share_among_threads(run, len(models), workers)
    return [closed_run(log[:n], clock) for log, n in zip(logs, ticks, strict=True)]
