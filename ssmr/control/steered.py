"""Closed loops of controllers that are Python objects: the same ticks, clock, noise and log as the compiled loops.

They are slower: a tick costs some tens of microseconds, where a compiled one costs one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ssmr._jit import jit_alone
from ssmr.control.law import EMPTY_MEMORY, Command, Observation
from ssmr.control.loop import Batch, Clock, LoopSettings, Trackers, tracker_of
from ssmr.control.mission import Mission, Moment, PythonController
from ssmr.control.predictor import carry_ahead, remember
from ssmr.control.tick import FRESH_MIND, LOG_COLUMNS, Mind, Tracker, Truth, is_lost, look, observed, record
from ssmr.control.waypoints import Waypoints
from ssmr.errors import ControllerError
from ssmr.models.law import PlanarRobot
from ssmr.robot.drive import Driven, DriveNumbers, Sides, continue_references, rolling
from ssmr.simulation import PlanarModel, PlanarMotion, move, turning_wheels
from ssmr.types import FloatArray, State


def mission_of(controller: PythonController, waypoints: Waypoints, settings: LoopSettings) -> Mission:
    """Return what a controller is told before it starts."""
    return Mission(
        waypoints, controller.drive, controller.a, controller.b, settings.velocity_period, settings.position_period,
        settings.lookahead,
    )  # fmt: skip


class Steered:
    """The robot's side of one closed loop whose controller is a Python object."""

    def __init__(self, tracker: Tracker, controller: PythonController, mission: Mission) -> None:
        """Make the controller's object.

        Raises:
            ControllerError: the controller cannot be made.
        """
        self._tracker, self._name = tracker, controller.name
        self._steering: Any = controller.steering(mission)
        self._observe = getattr(self._steering, "observe", None)
        self._seen_at = 0.0
        self.mind: Mind = FRESH_MIND
        """The state that it keeps between two commands: the last estimate, the errors and the command it gave."""

    def _moment(self, t: float) -> Moment:
        mind, tracker = self.mind, self._tracker
        end = t + tracker.foresight.horizon
        ahead, asked = carry_ahead(tracker.past, tracker.pipe, mind.seen, self._seen_at, end, tracker.foresight)
        past = tracker.past.copy()
        return Moment(t, self._seen_at, mind.seen, mind.target, mind.errors, ahead, asked, past)

    def see(self, seen: Observation, t: float) -> None:
        """Take an observation of mission time `t` [s].

        Raises:
            ControllerError: the controller failed.
        """
        self.mind, self._seen_at = look(self._tracker, self.mind, seen, t), t
        if self._observe is not None:
            self._observe(self._moment(t))

    def command(self, t: float) -> Command:
        """Return the command of mission time `t` [s].

        Raises:
            ControllerError: the controller failed, or its command is no two finite numbers.
        """
        given = self._steering.command(self._moment(t))
        try:
            v, w = map(float, given)
        except (TypeError, ValueError):
            raise ControllerError(f"{self._name} commands {given!r:.60}, wanted speed and yaw rate, two numbers") from None
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ControllerError(f"{self._name} commands {v:g} m/s and {w:g} rad/s at t = {t:.2f} s, wanted finite numbers")
        memory = self.mind.memory._replace(u_ref=v, w_ref=w)
        self.mind = self.mind._replace(memory=memory, command=Command(v, w))
        remember(self._tracker.past, self._tracker.pipe, v, w, t)
        return self.mind.command

    def tick(self, k: int, truth: Truth, draws: FloatArray, log: FloatArray) -> bool:
        """Run physics step `k` as `ssmr.control.tick.tick` does; return whether the robot is lost.

        Raises:
            ControllerError: the controller failed.
        """
        tracker, t = self._tracker, k * self._tracker.dt
        due = k % tracker.position_steps == 0
        if due:
            self.see(observed(tracker, k, truth, draws), t)
        if k % tracker.velocity_steps == 0:
            self.command(t)
        if due:
            record(log[k // tracker.position_steps], truth, self.mind)
        return due and is_lost(truth.x, truth.y, truth.w, self.mind.target.x, self.mind.target.y)


class SteeredPopulation:
    """The robots' side of many closed loops whose controllers are Python objects."""

    def __init__(
        self, controllers: Sequence[Any], settings: Sequence[LoopSettings], trackers: Trackers, waypoints: Waypoints
    ) -> None:
        """Make the controllers' objects.

        Raises:
            ControllerError: a controller cannot be made.
            ValueError: one of the controllers is a compiled law.
        """
        if not all(isinstance(c, PythonController) for c in controllers):
            raise ValueError("a population has compiled laws or Python objects, not both")
        self._period = trackers.velocity_steps
        self._robots = [
            Steered(tracker_of(trackers, i), law, mission_of(law, waypoints, around))
            for i, (law, around) in enumerate(zip(controllers, settings, strict=True))
        ]

    def plan_period(self, k: int, n: int, drives: FloatArray, states: FloatArray, draws: FloatArray, batch: Batch) -> None:
        """Plan one period of the position loop; the arguments are those of `ssmr.control.population.plan_period`.

        Raises:
            ControllerError: a controller failed.
        """
        later = range(-(-(k + 1) // self._period) * self._period, k + n, self._period)
        for i, robot in enumerate(self._robots):
            if not batch.alive[i]:
                continue
            truth = Truth(*map(float, states[i]))
            for j in (k, *later):
                batch.alive[i] &= not robot.tick(j, truth, draws[i % len(draws)], batch.logs[i])
                batch.commands[i, j // self._period] = robot.mind.command
            drive, asked = DriveNumbers(*drives[i][:8], *map(int, drives[i][8:])), Driven(*batch.asked[i])
            batch.asked[i] = continue_references(batch.commands[i], drive, (0.0, 0.0), asked, k, batch.references[i, :n])


@jit_alone
def roll_on(row: FloatArray, references: FloatArray, pushes: FloatArray, dt: float, robot: PlanarRobot) -> None:
    """Advance a planar robot in place, a (9,) row of `PlanarMotion`, by (n, 2) references and (n,) yaw accelerations."""
    now = PlanarMotion(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])
    for j in range(len(references)):
        now = move(now, Sides(references[j, 0], references[j, 1]), pushes[j], dt, robot)
    for j, number in enumerate(now):
        row[j] = number


@jit_alone
def truth_of(row: FloatArray, asked: FloatArray, robot: PlanarRobot) -> Truth:
    """Return the motion of a planar robot, a (9,) row of `PlanarMotion`; its driver asks for (2,) wheel rates [rad/s]."""
    now = PlanarMotion(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])
    left, right = turning_wheels(now, Sides(asked[0], asked[1]), robot)
    return Truth(now.x, now.y, now.yaw, now.v, -robot.x_icr * now.w, now.w, left, right, now.torque_left, now.torque_right)


def new_batch(clock: Clock, drives: Sequence[DriveNumbers], state: State) -> Batch:
    """Return the state of closed loops that begin, with robots that roll as in `state`."""
    n = len(drives)
    return Batch(
        np.tile(EMPTY_MEMORY, (n, 1)),
        np.zeros(n, dtype=np.int64),
        np.array([rolling(Sides(state.wheel_left, state.wheel_right), d) for d in drives]),
        np.zeros((n, 1 + clock.n // clock.velocity, 2)),
        np.ones(n, dtype=np.bool_),
        np.empty((n, clock.ticks, len(LOG_COLUMNS))),
        np.zeros((n, clock.position, 2)),
    )


class PlanarBodies:
    """Planar robots that are moved period by period."""

    def __init__(self, models: Sequence[PlanarModel], state: State, dt: float) -> None:
        """Place every robot in `state`; `dt` is the physics step [s]."""
        self._robots, self._dt = [model.packed(dt) for model in models], dt
        self._rows = np.zeros((len(models), len(PlanarMotion._fields)))
        self._rows[:, :5] = state.x, state.y, state.yaw, state.v_x, state.yaw_rate
        self._asked = np.tile([float(state.wheel_left), float(state.wheel_right)], (len(models), 1))
        self.gave_up = np.zeros(len(models), dtype=np.bool_)
        """(S,) all false: the closed loop finds a robot whose motion is not finite."""

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.control.tick.Truth`."""
        return np.array([truth_of(*each) for each in zip(self._rows, self._asked, self._robots, strict=True)])

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take (S, n, 2) wheel-rate references [rad/s] and (S, n) yaw accelerations [rad/s2] through n physics steps."""
        for row, asked, push, robot in zip(self._rows, references, pushes, self._robots, strict=True):
            roll_on(row, asked, push, self._dt, robot)
        self._asked = references[:, -1].copy()
