"""Many episodes of trajectory tracking at once, on one batch of MuJoCo robots.

Each row has a generator of its own, so an episode is the same to the bit whatever stands in the other rows.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ssmr.control.loop import VELOCITY_PERIOD
from ssmr.control.tick import SPINNING
from ssmr.robot.drive import Sides, drive_numbers, rolling
from ssmr.types import FloatArray
from validation.learning.episodes import AHEAD_TICKS, Episode, EpisodeSource, TrackTask
from validation.learning.kernels import ERRORS, EpisodeRows, observe_rows, plan_ticks
from validation.simulator.failures import mujoco_failures
from validation.simulator.loops import MujocoBodies
from validation.words import shortened

WIDTH = 0.1
"""Distance from the target at which the reward has fallen to a half [m]."""


class Ticked(NamedTuple):
    """What a tick of all rows brought."""

    observations: FloatArray
    """(S, n) in SI units, within `EpisodeSource.bounds`."""
    rewards: FloatArray
    """(S,) in [0, 1]; 0 where an episode has just begun."""
    lost: NDArray[np.bool_]
    """(S,) whether the robot was lost: too far from its target, spinning, or given up by the simulator."""
    over: NDArray[np.bool_]
    """(S,) whether the episode's time is over, and the robot was not lost."""
    began: NDArray[np.bool_]
    """(S,) whether an episode began at this tick: the action was not looked at."""
    away: FloatArray
    """(S,) distances from the targets [m]."""


class TrackBatch:
    """S robots, each in an episode of its own; a tick is 50 ms. Where an episode has ended, the next tick begins another."""

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
        self._plants = [source.make_plant() for _ in range(count)]
        for plant in self._plants:
            plant.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)  # nobody reads them here
        self._bodies = MujocoBodies(self._plants, workers or os.cpu_count() or 1)
        self._generators = [np.random.default_rng() for _ in range(count)]
        self._bounds, self._ahead = source.bounds, np.array(AHEAD_TICKS)
        most = source.most_ticks
        self._rows = EpisodeRows(
            ticks=np.zeros(count, dtype=np.int64),
            drives=np.zeros((count, 13)),
            asked=np.zeros((count, 4)),
            before=np.zeros((count, 2)),
            commands=np.zeros((count, most, 2)),
            targets=np.zeros((count, most + 1 + max(AHEAD_TICKS), ERRORS)),
            noise=np.zeros((count, most + 1, 5)),
        )
        self._pushes = np.zeros((count, most, source.steps))
        self._lengths, self._ended = np.zeros(count, dtype=np.int64), np.ones(count, dtype=np.bool_)

    def __len__(self) -> int:
        """Return S, the number of robots."""
        return len(self._plants)

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
            actions: (S, 2) speeds [m/s] and yaw rates [rad/s]; beyond the drives' limits they are as the limits.

        Raises:
            ValueError: actions that are not finite numbers of this shape; nothing has moved.
        """
        wanted = self._checked(actions)
        began = self._ended.copy()
        self._begin(np.flatnonzero(began))
        going = np.flatnonzero(~began).astype(np.int32)
        if len(going):
            references = np.empty((len(going), self.source.steps, 2))
            pushes = self._pushes[going, self._rows.ticks[going]]
            plan_ticks(self._rows, going, wanted[going], references)
            self._bodies.advance(references, pushes, None if len(going) == len(self) else going)
        bodies, observations, away = self._bodies, np.empty((len(self), len(self._bounds))), np.empty(len(self))
        observe_rows(self._rows, bodies.qpos, bodies.qvel, self._ahead, self._bounds, observations, away)
        lost = ~began & ~((away < self.source.lost) & (np.abs(bodies.qvel[:, 5]) < SPINNING) & ~bodies.gave_up)
        over = ~began & ~lost & (self._rows.ticks >= self._lengths)
        self._ended = lost | over
        rewards = np.where(began | lost, 0.0, 1.0 / (1.0 + (away / WIDTH) ** 2))
        return Ticked(observations, rewards, lost, over, began, away)

    def _checked(self, actions: Any) -> FloatArray:
        try:
            numbers = np.asarray(actions, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            numbers = np.empty(0)
        if numbers.shape != (len(self), 2) or not np.all(np.isfinite(numbers)):
            one = "action must be (2,) finite numbers, v [m/s] and omega [rad/s]"
            many = f"actions must be ({len(self)}, 2) finite numbers, v [m/s] and omega [rad/s] of each robot"
            raise ValueError(f"{one if len(self) == 1 else many}; got {shortened(actions, 60)}")
        return np.clip(numbers, -self.source.top, self.source.top)

    @mujoco_failures()
    def _begin(self, which: NDArray[np.int64]) -> None:
        """Draw an episode for each of these rows and put its robot on the ground."""
        if not len(which):
            return
        drawn = [self.source.draw_episode(self._generators[i]) for i in which]
        for i, episode in zip(which, drawn, strict=True):
            self._plants[i].renumber(episode.calibration, episode.drive)
            self._enter(int(i), episode)
        self._bodies.place(which.tolist(), [episode.start for episode in drawn])

    def _enter(self, i: int, episode: Episode) -> None:
        """Write an episode into a row."""
        rows, start, dt = self._rows, episode.start, self._plants[i].dt
        numbers = drive_numbers(episode.drive, VELOCITY_PERIOD, dt)
        rows.drives[i], rows.ticks[i] = numbers, 0
        rows.asked[i] = rolling(Sides(start.wheel_left, start.wheel_right), numbers)
        rows.before[i] = episode.before
        rows.targets[i, : len(episode.targets)] = episode.targets
        rows.noise[i, : len(episode.noise)] = episode.noise
        self._pushes[i, : episode.ticks], self._lengths[i] = episode.pushes, episode.ticks
