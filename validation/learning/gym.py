"""Trajectory tracking as the Gymnasium environment `ssmr/Track-v0` (extra `learning`).

Importing this module registers it; `gymnasium.make("validation.learning.gym:ssmr/Track-v0")` does
both, and so does `gymnasium.make_vec`, whose robots are one batch.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.learning.batch import TrackBatch
from validation.learning.episodes import TrackTask
from validation.output import Document
from validation.simulator.calibration import Calibration
from validation.simulator.model import on_ground

try:
    import gymnasium
except ImportError as missing:
    raise ImportError(
        "Gymnasium is missing: install it with pip install 'ssmr-testbed[learning]' "
        "(in a source tree: '.[learning]'), "
        "or use validation.learning.tracking, which needs dm_env alone"
    ) from missing
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

_TRACK_ID = "ssmr/Track-v0"
"""Name of the environment."""

FloatRow = NDArray[np.float32]
# variables of the environment by which MuJoCo draws on Linux
_DRAWS_BY = {"DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"}


class TrackEnv(gymnasium.Env):
    """One robot that follows a moving target; observations and actions are shares in [-1, 1]."""

    # Gymnasium declares it without ClassVar
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012
    __signature__ = inspect.signature(TrackTask)

    def __init__(self, render_mode: str | None = None, **task: Any) -> None:
        """Make the robot; `task` has the fields of `TrackTask`.

        Raises:
            ValueError: as `TrackBatch`.
        """
        self.render_mode = render_mode
        self._renderer: mujoco.Renderer | None = None
        self._one = TrackVectorEnv(1, 1, **task)
        self.batch = self._one.batch
        self.observation_space = self._one.single_observation_space
        self.action_space = self._one.single_action_space

    def reset(
        self, *, seed: int | None = None, options: Document | None = None
    ) -> tuple[FloatRow, Document]:
        """Begin an episode; a seed decides it and all that follow. There are no options."""
        super().reset(seed=seed)
        return self._one.reset(seed=[seed])[0][0], {}

    def step(self, action: Any) -> tuple[FloatRow, float, bool, bool, Document]:
        """Advance by 50 ms; the info has `away`, the distance from the target [m].

        Raises:
            ValueError: the action is not two finite numbers; nothing has moved.
        """
        *told, info = self._one.step([action])
        seen, reward, lost, over = (each[0] for each in told)
        return seen, float(reward), bool(lost), bool(over), {"away": float(info["away"][0])}

    def render(self) -> NDArray[np.uint8] | None:
        """Return a (240, 320, 3) picture of the robot if the mode is `rgb_array`, else None.

        Raises:
            RuntimeError: there is neither a display nor a choice of how to draw without one.
        """
        if self.render_mode is None:
            return None
        if self._renderer is None:
            # MuJoCo chooses when it is imported, and fails with a message of X11's
            if sys.platform == "linux" and _DRAWS_BY.isdisjoint(os.environ):
                raise RuntimeError(
                    "there is no display to draw on; set MUJOCO_GL=egl, or osmesa, in the "
                    "environment before Python starts"
                )
            self._renderer = mujoco.Renderer(
                _picture_model(self.batch.source.sections[0].parameters)
            )
        model = self._renderer.model
        data = mujoco.MjData(model)
        data.qpos[:] = self.batch.place_of(0)
        mujoco.mj_forward(model, data)
        camera = mujoco.MjvCamera()
        camera.lookat[:] = data.qpos[:3]
        camera.distance = 4.0 * self.batch.source.track
        camera.elevation = -30.0
        self._renderer.update_scene(data, camera)
        return self._renderer.render()

    def close(self) -> None:
        """Give back the memory of the pictures."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class TrackVectorEnv(VectorEnv):
    """Many robots that follow a target each, as one batch.

    Row i of a seed s is a `TrackEnv` of the seed s + i. A row whose episode has ended begins
    another at its next step, which does not look at the action.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - as above

    def __init__(self, num_envs: int = 1, workers: int | None = None, **task: Any) -> None:
        """Make the robots, on all cores or so many `workers`; `task` as for `TrackEnv`.

        Raises:
            ValueError: as `TrackBatch`.
        """
        self.num_envs = num_envs
        self.batch = TrackBatch(TrackTask(**task), num_envs, workers)
        numbers = len(self.batch.source.bounds)
        self.single_observation_space = spaces.Box(-1.0, 1.0, (numbers,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Document | None = None,
    ) -> tuple[FloatRow, Document]:
        """Begin an episode in every row; a seed, or one for each row, decides all that follow."""
        rows = range(self.num_envs)
        seeds: Any = seed
        if np.ndim(seeds) == 0:
            seeds = [seed if seed is None else seeds + row for row in rows]
        for row, own in zip(rows, seeds, strict=True):
            if own is not None:
                self.batch.seed(row, own)
        return self._as_shares(self.batch.reset()), {}

    def step(self, actions: Any) -> tuple[FloatRow, FloatArray, Any, Any, Document]:
        """Advance every row by 50 ms; the info has `away`, the distances from the targets [m].

        Raises:
            ValueError: the actions are not two finite numbers a row; nothing has moved.
        """
        now = self.batch.step(np.asarray(actions, dtype=np.float64) * self.batch.source.top)
        seen = self._as_shares(now.observations)
        return seen, now.rewards, now.lost, now.over, {"away": now.away, "_away": ~now.began}

    def _as_shares(self, observations: FloatArray) -> FloatRow:
        return (observations / self.batch.source.bounds).astype(np.float32)


def _picture_model(robot: Calibration) -> mujoco.MjModel:
    """Return a robot with its looks, which plants do without, on a grey floor under a lamp."""
    spec = on_ground(robot.robot, robot.wheel_shape)
    spec.geom("ground").rgba = [0.75, 0.75, 0.75, 1.0]
    sun = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.worldbody.add_light(type=sun, pos=[0.0, 0.0, 10.0], dir=[0.3, 0.2, -1.0], castshadow=False)
    return spec.compile()


gymnasium.register(id=_TRACK_ID, entry_point=TrackEnv, vector_entry_point=TrackVectorEnv)
