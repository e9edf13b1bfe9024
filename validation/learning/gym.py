"""Trajectory tracking as the Gymnasium environment `ssmr/Track-v0` (extra `learning`).

Importing this module registers it; `gymnasium.make("validation.learning.gym:ssmr/Track-v0")` does
both.
"""

from __future__ import annotations

import inspect
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
        "Gymnasium is missing: install it with pip install 'ssmr-testbed[learning]' "
        "(in a source tree: '.[learning]'), "
        "or use validation.learning.tracking, which needs dm_env alone"
    ) from missing
from gymnasium import spaces

TRACK_ID = "ssmr/Track-v0"
"""Name of the environment."""

FloatRow = NDArray[np.float32]


class TrackEnv(gymnasium.Env):
    """One robot that follows a moving target; observations and actions are shares in [-1, 1]."""

    metadata = {"render_modes": []}  # noqa: RUF012 # Gymnasium declares it without ClassVar
    __signature__ = inspect.signature(TrackTask)

    def __init__(self, **task: Any) -> None:
        """Make the robot; `task` has the fields of `TrackTask`.

        Raises:
            ValueError: as `TrackBatch`.
        """
        self.batch = TrackBatch(TrackTask(**task), 1, 1)
        self.observation_space = spaces.Box(-1.0, 1.0, (len(self.batch.source.bounds),), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatRow, dict[str, Any]]:
        """Begin an episode; a seed decides it and all that follow. There are no options."""
        super().reset(seed=seed)
        if seed is not None:
            self.batch.seed(0, seed)
        return self._shares(self.batch.reset()), {}

    def step(self, action: Any) -> tuple[FloatRow, float, bool, bool, dict[str, Any]]:
        """Advance by 50 ms; the info has `away`, the distance from the target [m].

        Raises:
            ValueError: the action is not two finite numbers; nothing has moved.
        """
        now = self.batch.step(np.asarray(action, dtype=np.float64)[None] * self.batch.source.top)
        seen = self._shares(now.observations)
        reward = float(now.rewards[0])
        return seen, reward, bool(now.lost[0]), bool(now.over[0]), {"away": float(now.away[0])}

    def _shares(self, observations: FloatArray) -> FloatRow:
        return (observations[0] / self.batch.source.bounds).astype(np.float32)


gymnasium.register(id=TRACK_ID, entry_point=TrackEnv)
