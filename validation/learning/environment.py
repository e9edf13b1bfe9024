"""Trajectory tracking as a `dm_env` environment."""

from __future__ import annotations

from inspect import Parameter, Signature, signature
from typing import Any

import dm_env
import numpy as np
from dm_env import specs

from ssmr.types import FloatArray
from validation.learning.batch import TrackBatch
from validation.learning.episodes import TrackTask

_SEED = Parameter("seed", Parameter.KEYWORD_ONLY, default=None)


class Tracking(dm_env.Environment):
    """One robot that follows a moving target.

    An action is a command, v [m/s] and omega [rad/s], read every 50 ms. The reward is 1 / (1 +
    (distance / 0.1 m)^2). An episode ends with discount 0 where the robot is lost, and with
    discount 1 where its time is over.
    """

    __signature__ = Signature([*signature(TrackTask).parameters.values(), _SEED])

    def __init__(self, *task: Any, seed: int | None = None, **more: Any) -> None:
        """Make the robot, and draw all episodes by a seed.

        Args:
            task: fields of `TrackTask` in their order: profiles, reference, speed, robot.
            seed: seed of all draws.
            more: other fields of `TrackTask`, by name.

        Raises:
            ValueError: profiles or waypoints that cannot be read, or do not go together.
        """
        self.batch = TrackBatch(TrackTask(*task, **more), 1, 1)
        self.batch.seed(0, seed)

    def reset(self) -> dm_env.TimeStep:
        """Begin an episode."""
        return dm_env.restart(self._by_name(self.batch.reset()[0]))

    def step(self, action: Any) -> dm_env.TimeStep:
        """Advance by 50 ms, or begin an episode where none is under way.

        Raises:
            ValueError: the action is not two finite numbers; nothing has moved.
        """
        now = self.batch.step([action])
        seen = self._by_name(now.observations[0])
        if now.began[0]:
            return dm_env.restart(seen)
        reward = float(now.rewards[0])
        if now.lost[0]:
            return dm_env.termination(reward, seen)
        if now.over[0]:
            return dm_env.truncation(reward, seen)
        return dm_env.transition(reward, seen)

    def _by_name(self, row: FloatArray) -> dict[str, FloatArray]:
        slices = self.batch.source.slices
        return {name: row[part].reshape(shape) for name, (part, shape) in slices.items()}

    def observation_spec(self) -> dict[str, specs.BoundedArray]:
        """Return shape and bounds of each part of an observation."""
        named = self._by_name(self.batch.source.bounds)
        return {n: specs.BoundedArray(b.shape, np.float64, -b, b, name=n) for n, b in named.items()}

    def action_spec(self) -> specs.BoundedArray:
        """Return the action (2,): v and omega within the drive's limits."""
        top = self.batch.source.top
        return specs.BoundedArray((2,), np.float64, -top, top, name="v\tomega")

    def reward_spec(self) -> specs.BoundedArray:
        """Return the reward's bounds, 0 and 1."""
        return specs.BoundedArray((), np.float64, 0.0, 1.0, name="reward")


tracking = Tracking
"""Constructor of the environment, under the name that it is imported by."""
