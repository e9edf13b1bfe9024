"""Many closed loops at once: fused loops of planar models, and the robots' side where something else moves the bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit, jit_alone, named_like, share_among_threads
from ssmr.control.law import EMPTY_MEMORY, Command
from ssmr.control.laws import Controller
from ssmr.control.loop import (
    Batch,
    ClosedRun,
    LoopSettings,
    Trackers,
    closed_run,
    common_settings,
    draw,
    make_clock,
    make_trackers,
    tracker_of,
    true_state,
)
from ssmr.control.mission import PythonController
from ssmr.control.steered import PlanarBodies, SteeredPopulation, new_batch
from ssmr.control.tick import FRESH_MIND, LOG_COLUMNS, Mind, Tracker, Truth, tick
from ssmr.control.waypoints import Target, Waypoints
from ssmr.models.law import PlanarRobot
from ssmr.robot.drive import DRIVE_TEMPLATE, Driven, DriveNumbers, Sides, drive_numbers, follow, rolling
from ssmr.robot.vehicle import Drive
from ssmr.simulation import PLANAR_DT, PlanarModel, PlanarMotion, move, robot_from_row, robot_row, turning_wheels
from ssmr.types import FloatArray, State

_TRUTH = Truth(*(0.0,) * 10)
_DRIVEN = Driven(0.0, 0.0, 0.0, 0.0)


@jit
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
        The number of ticks that were recorded: fewer than `log` has rows where the robot was lost after the last of them.
    """
    n = (len(log) - 1) * tracker.position_steps
    commands = np.empty((1 + n // tracker.velocity_steps, 2))
    now = PlanarMotion(start.x, start.y, start.yaw, start.v, start.w, 0.0, 0.0, 0.0, 0.0)
    asked, mind = rolling(Sides(start.left, start.right), drive), FRESH_MIND
    for k in range(n + 1):
        if k % tracker.position_steps == 0 or k % tracker.velocity_steps == 0:
            left, right = turning_wheels(now, Sides(asked.left, asked.right), robot)
            truth = Truth(
                now.x, now.y, now.yaw, now.v, -robot.x_icr * now.w, now.w, left, right, now.torque_left, now.torque_right
            )
            mind, lost = tick(tracker, mind, k, truth, draws, log)
            if lost:
                return 1 + k // tracker.position_steps
        if k % tracker.velocity_steps == 0:
            commands[k // tracker.velocity_steps, 0] = mind.command.v
            commands[k // tracker.velocity_steps, 1] = mind.command.w
        if k == n:
            break
        asked = follow(commands, k, drive, (0.0, 0.0), asked)
        push = disturbance[k] if len(disturbance) > 1 else disturbance[0]
        now = move(now, Sides(asked.left, asked.right), push, tracker.dt, robot)
    return len(log)


class PlanarRows(NamedTuple):
    """S planar robots of one kind as arrays, and what is random about their runs."""

    drives: FloatArray
    """(S, 13) `DriveNumbers`."""
    robots: FloatArray
    """(S, k) rows of `robot_row`."""
    draws: FloatArray
    """(D, ticks, 8) standard normal numbers, taken in turn."""
    disturbances: FloatArray
    """(D, n) or (D, 1) yaw accelerations [rad/s2], taken in turn."""


@jit_alone
def run_planar_loops(
    first: int,
    last: int,
    trackers: Trackers,
    kind: Any,
    rows: PlanarRows,
    start: Truth,
    ticks: Any,
    logs: FloatArray,
) -> None:
    """Run planar loops one after another.

    Args:
        first: first loop to run.
        last: the loop after the last one to run.
        trackers: the robots' side.
        kind: template of the model's parameters.
        rows: the drives, the robots, their noise and disturbances.
        start: the robots at the start.
        ticks: (S,) space for the number of ticks that each loop recorded.
        logs: (S, ticks, 25) space for what is recorded.
    """
    for i in range(first, last):
        ticks[i] = run_planar_loop(
            tracker_of(trackers, i),
            named_like(DRIVE_TEMPLATE, rows.drives[i]),
            robot_from_row(kind, rows.robots[i]),
            start,
            rows.draws[i % len(rows.draws)],
            rows.disturbances[i % len(rows.disturbances)],
            logs[i],
        )


@jit_alone
def plan_period(
    trackers: Trackers, k: int, n: int, drives: FloatArray, states: FloatArray, draws: FloatArray, batch: Batch
) -> None:
    """Plan one period of the position loop for robots that something else moves.

    The wheel rates to ask for until the next tick depend on nothing that happens meanwhile, so the whole period is planned
    at once.

    Args:
        trackers: the robots' side.
        k: physics step at which the period begins, a tick of the position loop.
        n: physics steps to plan; 0 at the end of the mission.
        drives: (S, 13) `DriveNumbers`.
        states: (S, 10) the fields of `Truth`.
        draws: (D, ticks, 8) standard normal numbers, taken in turn.
        batch: state of the loops, advanced in place.
    """
    for i in range(len(states)):
        if not batch.alive[i]:
            continue
        tracker, drive = tracker_of(trackers, i), named_like(DRIVE_TEMPLATE, drives[i])
        truth = named_like(_TRUTH, states[i])
        last = batch.commands[i, max(k - 1, 0) // tracker.velocity_steps]
        mind = Mind(
            named_like(EMPTY_MEMORY, batch.memories[i]),
            Target(0.0, 0.0, 0.0, 0.0, 0.0, batch.segments[i]),
            FRESH_MIND.errors,
            FRESH_MIND.seen,
            FRESH_MIND.ahead,
            Command(last[0], last[1]),
        )
        asked = named_like(_DRIVEN, batch.asked[i])
        for j in range(k, k + max(n, 1)):
            if j == k or j % tracker.velocity_steps == 0:
                mind, lost = tick(tracker, mind, j, truth, draws[i % len(draws)], batch.logs[i])
                batch.alive[i] &= not lost
            if j % tracker.velocity_steps == 0:
                batch.commands[i, j // tracker.velocity_steps, 0] = mind.command.v
                batch.commands[i, j // tracker.velocity_steps, 1] = mind.command.w
            if j < k + n:
                asked = follow(batch.commands[i], j, drive, (0.0, 0.0), asked)
                batch.references[i, j - k, 0], batch.references[i, j - k, 1] = asked.left, asked.right
        batch.segments[i] = mind.target.segment
        for j, number in enumerate(mind.memory):
            batch.memories[i, j] = number
        for j, number in enumerate(asked):
            batch.asked[i, j] = number


class Bodies(Protocol):
    """S robots that something else moves, each with its own physics."""

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots whose physics failed since the last tick."""
        ...

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `Truth`."""
        ...

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take (S, n, 2) wheel-rate references [rad/s] and (S, n) yaw accelerations [rad/s2] through n physics steps."""
        ...


def run_bodies(
    bodies_at: Callable[[State], Bodies],
    drives: Sequence[Drive],
    dt: float,
    controllers: Sequence[Controller | PythonController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    seeds: Sequence[int],
    start: State | None = None,
) -> list[ClosedRun]:
    """Run many closed loops, whole periods of the position loop at a time: what is asked of the wheels is known ahead.

    Args:
        bodies_at: function that places the S robots in a state.
        drives: their drives.
        dt: physics step [s].
        controllers: their laws.
        settings: feedback, noise and periods of each.
        waypoints: the reference.
        seeds: seeds of noise and disturbance, taken in turn: loop i gets `seeds[i % len(seeds)]`.
        start: state to start in; at rest at the first waypoint if not given.

    Raises:
        ValueError: several kinds of feedback or disturbance, or sets of periods; periods that are no whole number of steps;
            no loops or no seeds.
    """
    first, count = common_settings(settings, seeds), len(settings)
    clock = make_clock(waypoints, first, dt)
    drawn = [draw(clock, first, seed) for seed in seeds]
    draws, pushes = np.array([d for d, _ in drawn]), np.array([np.resize(d, clock.n) for _, d in drawn])
    turn, state = np.arange(count) % len(seeds), start or waypoints.start
    bodies, numbers = bodies_at(state), [drive_numbers(drive, first.velocity_period, dt) for drive in drives]
    batch = new_batch(clock, numbers, state)
    trackers, rows = make_trackers(controllers, settings, waypoints, clock, state), np.array(numbers, dtype=np.float64)
    if any(isinstance(c, PythonController) for c in controllers):
        plan: Callable[..., None] = SteeredPopulation(controllers, settings, trackers, waypoints).plan_period
    else:
        plan = partial(plan_period, trackers)
    ticks = np.full(count, clock.ticks)
    for tick_number in range(clock.ticks):
        k, n = tick_number * clock.position, clock.position if tick_number < clock.ticks - 1 else 0
        before = batch.alive.copy()
        plan(k, n, rows, bodies.states(), draws, batch)
        ticks[before & ~batch.alive] = tick_number + 1
        batch.references[~batch.alive] = 0.0
        if not batch.alive.any():
            break
        if n:
            bodies.advance(batch.references, np.where(batch.alive[:, None], pushes[turn, k : k + n], 0.0))
            gave_up = batch.alive & bodies.gave_up
            ticks[gave_up], batch.alive[gave_up] = tick_number + 1, False
    return [closed_run(log[:n], clock) for log, n in zip(batch.logs, ticks, strict=True)]


@dataclass(frozen=True)
class Loop:
    """One closed loop of a population: a controller around a planar model."""

    model: PlanarModel
    """The robot."""
    controller: Controller | PythonController
    """The law."""
    settings: LoopSettings
    """Feedback, noise and periods; feedback, disturbance and periods must be equal throughout a population."""


def run_loops(
    loops: Sequence[Loop],
    waypoints: Waypoints,
    seeds: Sequence[int],
    dt: float = PLANAR_DT,
    start: State | None = None,
    workers: int = 1,
) -> list[ClosedRun]:
    """Run many closed loops of one kind of planar model along one reference.

    Args:
        loops: S loops.
        waypoints: the reference.
        seeds: seeds of noise and disturbance, taken in turn: loop i gets `seeds[i % len(seeds)]`.
        dt: physics step [s].
        start: state to start in; at rest at the first waypoint if not given.
        workers: threads; the result does not depend on it.

    Raises:
        ValueError: several kinds of model, of feedback or disturbance, or sets of periods; periods that are no whole number
            of steps; no loops or no seeds.
    """
    settings = common_settings([p.settings for p in loops], seeds)
    if len({type(p.model.parameters) for p in loops}) != 1:
        raise ValueError("a population is one kind of model")
    controllers, around = [p.controller for p in loops], [p.settings for p in loops]
    if any(isinstance(c, PythonController) for c in controllers):
        models = [p.model for p in loops]
        drives = [model.drive for model in models]
        return run_bodies(lambda at: PlanarBodies(models, at, dt), drives, dt, controllers, around, waypoints, seeds, start)
    clock = make_clock(waypoints, settings, dt)
    drawn = [draw(clock, settings, seed) for seed in seeds]
    state = start or waypoints.start
    robots = [p.model.packed(dt) for p in loops]
    rows = PlanarRows(
        np.array([drive_numbers(p.model.drive, settings.velocity_period, dt) for p in loops], dtype=np.float64),
        np.array([robot_row(r) for r in robots]),
        *(np.array(column) for column in zip(*drawn, strict=True)),
    )
    ticks = np.zeros(len(loops), dtype=np.int64)
    logs = np.empty((len(loops), clock.ticks, len(LOG_COLUMNS)))
    trackers, at = make_trackers(controllers, around, waypoints, clock, state), true_state(state)

    def run(first: int, last: int) -> None:
        run_planar_loops(first, last, trackers, robots[0].parameters, rows, at, ticks, logs)

    share_among_threads(run, len(loops), workers)
    return [closed_run(log[:n], clock) for log, n in zip(logs, ticks, strict=True)]
