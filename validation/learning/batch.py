"""Many episodes of trajectory tracking at once, on one batch of MuJoCo robots.

Each row has a generator of its own, so an episode is the same to the bit whatever stands in the
other rows.
"""

from __future__ import annotations

import math
import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit_alone, named_like, write_numbers
from ssmr.control.law import Observation
from ssmr.control.loop import VELOCITY_PERIOD
from ssmr.control.tick import SPINNING
from ssmr.control.waypoints import Target, position_errors
from ssmr.robot.drive import (
    DRIVE_TEMPLATE,
    DriveState,
    Sides,
    drive_numbers,
    follow_commands,
    rolling_references,
)
from ssmr.types import FloatArray
from validation.learning.episodes import AHEAD_TICKS, ERRORS, EpisodeSource, TrackTask
from validation.output import shorten_text
from validation.simulator.bodies import MujocoBodies
from validation.simulator.parts import mujoco_failures

WIDTH = 0.1
"""Distance from the target at which the reward has fallen to a half [m]."""
_DRIVEN = DriveState(0.0, 0.0, 0.0, 0.0)


class _EpisodeRows(NamedTuple):
    """State of S episodes of at most T ticks each; kernels write in place."""

    ticks: Any
    """(S,) number of ticks so far."""
    drives: FloatArray
    """(S, 13) `DriveNumbers`."""
    held: FloatArray
    """(S, 4) states of the drives."""
    before: FloatArray
    """(S, 2) command until the beginning [m/s, rad/s]."""
    commands: FloatArray
    """(S, T, 2) commands so far [m/s, rad/s]."""
    targets: FloatArray
    """(S, T + 1 + the farthest preview, 5) x, y, heading, speed and yaw rate of the target at each
    tick."""
    noise: FloatArray
    """(S, T + 1, 5) errors of the feedback in x, y, yaw, v and yaw rate at each tick."""


@jit_alone
def _plan_ticks(
    rows: _EpisodeRows, which: Any, actions: FloatArray, references: FloatArray
) -> None:
    """Record (k, 2) commands of the robots `which`; write their (k, n, 2) wheel rates to come."""
    for j in range(len(which)):
        i = which[j]
        k = rows.ticks[i]
        commands = rows.commands[i]
        drive = named_like(DRIVE_TEMPLATE, rows.drives[i])
        commands[k, 0] = actions[j, 0]
        commands[k, 1] = actions[j, 1]
        held = named_like(_DRIVEN, rows.held[i])
        before = (rows.before[i, 0], rows.before[i, 1])
        for n in range(references.shape[1]):
            held = follow_commands(commands, k * drive.period + n, drive, before, held)
            references[j, n, 0] = held.left
            references[j, n, 1] = held.right
        write_numbers(rows.held[i], 0, 1, held)
        rows.ticks[i] += 1


@jit_alone
def write_view(
    seen: Observation, targets: FloatArray, commands: FloatArray, out: FloatArray
) -> None:
    """Write an observation: v and yaw rate, the `ERRORS` to each target, and the last commands.

    Args:
        seen: the robot as it is seen.
        targets: (p, 5) x, y, heading, speed and yaw rate of the targets, the present one first.
        commands: (m, 2) the last commands, the newest last [m/s, rad/s].
        out: (2 + 5 p + 2 m,) space for the observation.
    """
    out[0] = seen.v
    out[1] = seen.w
    at = 2
    for p in range(len(targets)):
        t = targets[p]
        errors = position_errors(seen, Target(t[0], t[1], t[2], t[3], t[4], 0), math.inf)
        write_numbers(out, at, 1, errors)
        write_numbers(out, at + 3, 1, (t[3], t[4]))
        at += 5
    for m in range(len(commands)):
        out[at] = commands[m, 0]
        out[at + 1] = commands[m, 1]
        at += 2


@jit_alone
def _observe_rows(
    rows: _EpisodeRows,
    qpos: FloatArray,
    qvel: FloatArray,
    ahead: Any,
    bounds: FloatArray,
    out: FloatArray,
    away: FloatArray,
) -> None:
    """Write the bounded observations of all robots, and their true distances to their targets.

    Args:
        rows: the episodes.
        qpos: (S, nq) MuJoCo's positions; the first seven are the base's place and quaternion.
        qvel: (S, nv) MuJoCo's velocities; the first six are the base's, of which the linear ones
            are along the world's axes.
        ahead: (p,) ticks from now to each target that is seen.
        bounds: (n,) greatest size of each number of an observation.
        out: (S, n) space for observations.
        away: (S,) space for distances [m]; infinite where the robot is nowhere.
    """
    seen_targets = np.empty((len(ahead), ERRORS))
    past = np.empty(((len(bounds) - 2 - ERRORS * len(ahead)) // 2, 2))
    for i in range(len(out)):
        k = rows.ticks[i]
        off = rows.noise[i, k]
        x = qpos[i, 0]
        y = qpos[i, 1]
        qw = qpos[i, 3]
        qx = qpos[i, 4]
        qy = qpos[i, 5]
        qz = qpos[i, 6]
        yaw = math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
        v = math.cos(yaw) * qvel[i, 0] + math.sin(yaw) * qvel[i, 1]
        seen = Observation(x + off[0], y + off[1], yaw + off[2], v + off[3], qvel[i, 5] + off[4])
        for p, c in np.ndindex(seen_targets.shape):
            seen_targets[p, c] = rows.targets[i, k + ahead[p], c]
        for m, c in np.ndindex(past.shape):
            since = k - len(past) + m
            past[m, c] = rows.commands[i, since, c] if since >= 0 else rows.before[i, c]
        write_view(seen, seen_targets, past, out[i])
        for n in range(len(bounds)):
            number = out[i, n]
            bounded = min(max(number, -bounds[n]), bounds[n])
            out[i, n] = bounded if math.isfinite(number) else 0.0
        distance = math.hypot(x - rows.targets[i, k, 0], y - rows.targets[i, k, 1])
        away[i] = distance if math.isfinite(distance) else math.inf


class Ticked(NamedTuple):
    """Result of one tick of all rows."""

    observations: FloatArray
    """(S, n) in SI units, within `EpisodeSource.bounds`."""
    rewards: FloatArray
    """(S,) in [0, 1]; 0 where an episode has just begun."""
    lost: NDArray[np.bool_]
    """(S,) whether the robot was lost: too far from its target, spinning, or given up by the
    simulator."""
    over: NDArray[np.bool_]
    """(S,) whether the episode's time is over, and the robot was not lost."""
    began: NDArray[np.bool_]
    """(S,) whether an episode began at this tick: the action was not looked at."""
    away: FloatArray
    """(S,) distances from the targets [m]."""


class TrackBatch:
    """S robots, each in an episode of its own, which another follows; a tick is 50 ms."""

    @mujoco_failures()
    def __init__(self, task: TrackTask, count: int = 1, workers: int | None = None) -> None:
        """Make the robots; no episode has begun.

        Args:
            task: what the episodes are about.
            count: S, the number of robots.
            workers: threads; all cores if not given. No result depends on it.

        Raises:
            ValueError: no robots, or as `EpisodeSource`.
        """
        if count < 1:
            raise ValueError(f"a batch has at least one robot, not {count}")
        self.source = source = EpisodeSource(task)
        first = source.sections[0]
        self._plants = [source.make_plant(first.parameters, first.drive) for _ in range(count)]
        self._bodies = MujocoBodies(self._plants, workers or os.cpu_count() or 1)
        self._generators = [np.random.default_rng() for _ in range(count)]
        self._bounds = source.bounds
        self._ahead = np.array(AHEAD_TICKS)
        most = source.most_ticks
        self._rows = _EpisodeRows(
            ticks=np.zeros(count, dtype=np.int64),
            drives=np.zeros((count, 13)),
            held=np.zeros((count, 4)),
            before=np.zeros((count, 2)),
            commands=np.zeros((count, most, 2)),
            targets=np.zeros((count, most + 1 + max(AHEAD_TICKS), ERRORS)),
            noise=np.zeros((count, most + 1, 5)),
        )
        self._pushes = np.zeros((count, most, source.steps))
        self._lengths = np.zeros(count, dtype=np.int64)
        self._ended = np.ones(count, dtype=np.bool_)

    def __len__(self) -> int:
        """Return S, the number of robots."""
        return len(self._plants)

    def place_of(self, row: int) -> FloatArray:
        """Return the (nq,) positions of a row's robot in MuJoCo, to draw it."""
        return self._bodies.qpos[row].copy()

    def seed(self, row: int, seed: Any) -> None:
        """Give a row a generator of this seed, for its next episode and all that follow."""
        self._generators[row] = np.random.default_rng(seed)

    def reset(self) -> FloatArray:
        """Begin an episode in every row; return (S, n) the observations."""
        self._ended[:] = True
        return self.step(np.zeros((len(self), 2))).observations

    def step(self, actions: Any) -> Ticked:
        """Advance every episode by a tick, or begin another where it has ended.

        Args:
            actions: (S, 2) speeds [m/s] and yaw rates [rad/s]; beyond the drives' limits they are
                as the limits.

        Raises:
            ValueError: actions that are not finite numbers of this shape; nothing has moved.
        """
        commands = self._commands(actions)
        began = self._ended.copy()
        self._begin(np.flatnonzero(began))
        going = np.flatnonzero(~began).astype(np.int32)
        if len(going):
            references = np.empty((len(going), self.source.steps, 2))
            pushes = self._pushes[going, self._rows.ticks[going]]
            _plan_ticks(self._rows, going, commands[going], references)
            some = None if len(going) == len(self) else going
            self._bodies.advance(references, pushes, some)
        bodies = self._bodies
        observations = np.empty((len(self), len(self._bounds)))
        away = np.empty(len(self))
        _observe_rows(
            self._rows,
            bodies.qpos,
            bodies.qvel,
            ahead=self._ahead,
            bounds=self._bounds,
            out=observations,
            away=away,
        )
        near = away < self.source.lost
        steady = np.abs(bodies.qvel[:, 5]) < SPINNING
        lost = ~began & ~(near & steady & ~bodies.gave_up)
        over = ~began & ~lost & (self._rows.ticks >= self._lengths)
        self._ended = lost | over
        rewards = np.where(began | lost, 0.0, 1.0 / (1.0 + (away / WIDTH) ** 2))
        return Ticked(observations, rewards, lost, over, began, away)

    def _commands(self, actions: Any) -> FloatArray:
        """Return actions as (S, 2) commands within the drives' limits."""
        try:
            numbers = np.asarray(actions, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            numbers = np.empty(0)
        if numbers.shape != (len(self), 2) or not np.all(np.isfinite(numbers)):
            shape = "action must be (2,)" if len(self) == 1 else f"actions must be ({len(self)}, 2)"
            raise ValueError(
                f"{shape} finite numbers, v [m/s] and omega [rad/s]; "
                f"got {shorten_text(actions, 60)}"
            )
        top = self.source.top
        commands = np.clip(numbers, -top, top)
        if self.source.of_wheels:  # the faster side's turn at most as fast as they can
            commands /= np.maximum(np.abs(commands / top).sum(axis=1, keepdims=True), 1.0)
        return commands

    @mujoco_failures()
    def _begin(self, which: NDArray[np.int64]) -> None:
        """Draw an episode for each of these rows and put its robot on the ground."""
        if not len(which):
            return
        rows = self._rows
        starts = []
        for i in which:
            drawn = self.source.draw_episode(self._generators[i])
            calibration, drive, start, targets, noise, pushes = drawn
            self._plants[i] = self.source.make_plant(calibration, drive)
            starts.append(start)
            numbers = drive_numbers(drive, VELOCITY_PERIOD, self._plants[i].dt)
            rows.drives[i] = numbers
            rows.ticks[i] = 0
            wheels = Sides(start.wheel_left, start.wheel_right)
            rows.held[i] = rolling_references(wheels, numbers)
            rows.before[i] = (start.v_x, 0.0)
            rows.targets[i, : len(targets)] = targets
            rows.noise[i, : len(noise)] = noise
            self._lengths[i] = len(pushes)
            self._pushes[i, : len(pushes)] = pushes
        self._bodies.place(which.tolist(), starts, [self._plants[i] for i in which])
