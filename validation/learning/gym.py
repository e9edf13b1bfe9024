"""Trajectory tracking as the Gymnasium environment `ssmr/Track-v0`, alone and as a vector (extra `learning`).

Importing this module registers it; `gymnasium.make("validation.learning.gym:ssmr/Track-v0")` does both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.learning.batch import TrackBatch
from validation.learning.episodes import TrackTask

try:
    import gymnasium
except ImportError as missing:
    raise ImportError(
        "Gymnasium is missing: install it with pip install 'ssmr-testbed[learning]' (in a source tree: '.[learning]'), "
        "or use validation.learning.tracking, which needs dm_env alone"
    ) from missing
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

TRACK_ID = "ssmr/Track-v0"
"""Name of the environment."""

FloatRow = NDArray[np.float32]


def _spaces(batch: TrackBatch) -> tuple[spaces.Box, spaces.Box]:
    one = spaces.Box(-1.0, 1.0, (len(batch.source.bounds),), np.float32)
    return one, spaces.Box(-1.0, 1.0, (2,), np.float32)


def _shares(batch: TrackBatch, observations: FloatArray) -> FloatRow:
    return (observations / batch.source.bounds).astype(np.float32)


class TrackEnv(gymnasium.Env):
    """One robot that follows a moving target; observations and actions are in shares of their bounds, in [-1, 1]."""

    metadata = {"render_modes": []}  # noqa: RUF012 # Gymnasium declares it without ClassVar

    def __init__(self, **task: Any) -> None:
        """Make the robot; `task` has the fields of `TrackTask`.

        Raises:
            ValueError: as `TrackBatch`.
        """
        self.batch = TrackBatch(TrackTask(**task), 1, 1)
        self.observation_space, self.action_space = _spaces(self.batch)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[FloatRow, dict[str, Any]]:
        """Begin an episode; with a seed, it and all that follow are those of that seed. There are no options."""
        super().reset(seed=seed)
        if seed is not None:
            self.batch.seed(0, seed)
        return _shares(self.batch, self.batch.reset())[0], {}

    def step(self, action: Any) -> tuple[FloatRow, float, bool, bool, dict[str, Any]]:
        """Advance by 50 ms; the info has `away`, the distance from the target [m].

        Raises:
            ValueError: the action is not two finite numbers; nothing has moved.
        """
        now = self.batch.step(np.asarray(action, dtype=np.float64)[None] * self.batch.source.top)
        seen = _shares(self.batch, now.observations)[0]
        return seen, float(now.rewards[0]), bool(now.lost[0]), bool(now.over[0]), {"away": float(now.away[0])}


class TrackVectorEnv(VectorEnv):
    """Many such robots on one batch; where an episode has ended, the next step begins another and ignores the action."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 # as above

    def __init__(self, num_envs: int = 64, workers: int | None = None, **task: Any) -> None:
        """Make the robots.

        Args:
            num_envs: number of robots.
            workers: threads; all cores if not given. No result depends on it.
            task: the fields of `TrackTask`.

        Raises:
            ValueError: as `TrackBatch`.
        """
        self.batch, self.num_envs = TrackBatch(TrackTask(**task), num_envs, workers), num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.batch)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatRow, dict[str, Any]]:
        """Begin an episode in every row; row i of seed s has the episodes of `TrackEnv` with seed s + i.

        Raises:
            ValueError: several seeds, but not one a row.
        """
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed or [None] * self.num_envs
        if len(seeds) != self.num_envs:
            raise ValueError(f"{self.num_envs} robots need as many seeds, got {len(seeds)}")
        for row, one in enumerate(seeds):
            if one is not None:
                self.batch.seed(row, one)
        return _shares(self.batch, self.batch.reset()), {}

    def step(self, actions: Any) -> tuple[FloatRow, FloatArray, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance every robot by 50 ms; the info has `away`, the (S,) distances from the targets [m].

        Raises:
            ValueError: actions that are not finite numbers of the right shape; nothing has moved.
        """
        now = self.batch.step(np.asarray(actions, dtype=np.float64) * self.batch.source.top)
        return _shares(self.batch, now.observations), now.rewards, now.lost, now.over, {"away": now.away}


gymnasium.register(id=TRACK_ID, entry_point=TrackEnv, vector_entry_point=TrackVectorEnv)
