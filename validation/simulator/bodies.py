"""MuJoCo's robots in a batch: one robot or a whole population, each with its own body.

A batch advances by many steps at once, as fast as an open-loop rollout.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.robot.drive import motor_numbers
from ssmr.types import FloatArray, State
from validation.simulator.motors import actuator_inputs

_TURN = 2.0 * np.pi
_READING = 0.1
"""Longest time between two readings of yaw [s], so that no half turn lies between them."""


class MujocoBodies:
    """A batch of robots of one structure, each with its own numbers, and their planar states."""

    qpos: FloatArray
    """(S, nq) MuJoCo's positions, the free joint's first; a view."""
    qvel: FloatArray
    """(S, nv) MuJoCo's velocities; a view."""

    def __init__(self, plants: Sequence[Any], workers: int = 1, state: State | None = None) -> None:
        """Make room for robots that move as `MujocoPlant`s do, several of which may be one.

        They share `workers` threads. `place` puts each on its ground, which is done here if a
        `state` is given.

        Raises:
            ValueError: several time steps, terrains or shapes of tyre.
        """
        kinds = set()
        for plant in plants:
            model = plant.model
            shape = plant.calibration.wheel_shape
            kinds.add((plant.dt, plant.terrain, shape, model.npair, model.nu))
        if len(kinds) != 1:
            raise ValueError(
                "a population of Huskies has one time step, one terrain and one shape of tyre"
            )
        first = self._first = plants[0]
        self._plants = list(plants)
        self._batch = batch.Batch(first.model, len(plants), workers)
        self.qpos = self._batch.bind("qpos")
        self.qvel = self._batch.bind("qvel")
        self._force = self._batch.bind("qfrc_actuator")
        self._inertia = np.empty(len(plants))
        self._braking = np.empty((len(plants), 1))
        self._yaw = np.empty(len(plants))
        self._spec = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        self._width = first.model.nu + first.model.nv
        # room for a copy of one state; to make it takes ten times as long as to read an IMU
        self._probe = mujoco.MjData(first.model)
        # left and right in front, then behind: the order of `WHEELS`
        self._wheels = first.parts.dofs
        if state is not None:
            self.place(range(len(plants)), [state] * len(plants))

    def place(
        self, rows: Sequence[int], states: Sequence[State], plants: Sequence[Any] = ()
    ) -> None:
        """Put the robots of some rows into states, with no memory of former motion.

        They move as other `plants` from then on, if these are given.
        """
        for row, plant in zip(rows, plants, strict=False):
            self._plants[row] = plant
        self._batch.set_models([p.model for p in self._plants])
        no_stage = mujoco.mjtStage.mjSTAGE_NONE.value
        self._batch.reset(np.asarray(rows, dtype=np.int32), stage=no_stage)
        nq = self._first.model.nq
        nv = self._first.model.nv
        for row, state in zip(rows, states, strict=True):
            plant = self._plants[row]
            start = plant.placed(state)
            self.qpos[row] = start[1 : 1 + nq]
            self.qvel[row] = start[1 + nq : 1 + nq + nv]
            self._inertia[row] = plant.yaw_inertia
            self._yaw[row] = state.yaw
            self._braking[row] = motor_numbers(plant.drive, plant.dt).braking

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots that the simulator warned of: it stops, and resets diverged ones."""
        return self._batch.warning[:, :, 1].any(axis=1)

    def states(self) -> FloatArray:
        """Return (S, 10) fields of `ssmr.types.Motion`; yaw goes on from the last reading."""
        self._read_yaw()
        planar = self._first.parts.planar(self.qpos, self.qvel, self._yaw)
        force = self._force[:, self._wheels]
        torques = force[:, :2] + force[:, 2:] - self._braking * planar[:, 6:8]
        return np.hstack([planar, torques])

    def _read_yaw(self) -> None:
        yaw = quat_wxyz_to_yaw(self.qpos[:, 3:7])
        self._yaw = yaw + _TURN * np.round((self._yaw - yaw) / _TURN)

    def data_of(self, row: int) -> mujoco.MjData:
        """Return a copy of a robot's state in the simulator, until the next one is asked for."""
        return self._batch.get_data(row, self._probe)

    def advance(
        self, references: FloatArray, pushes: FloatArray, rows: NDArray[np.int32] | None = None
    ) -> None:
        """Take n physics steps with wheel-rate references and yaw accelerations.

        Args:
            references: (S, n, 2) wheel-rate references [rad/s], or (k, n, 2) of the k `rows`.
            pushes: (S, n) yaw accelerations [rad/s2], or (k, n).
            rows: (k,) robots that move; all if not given.
        """
        control = np.zeros((*references.shape[:2], self._width))
        nu = self._first.model.nu
        control[:, :, :nu] = actuator_inputs(self._first.model, references)
        inertia = self._inertia if rows is None else self._inertia[rows]
        control[:, :, nu + 5] = inertia[:, None] * pushes
        most = max(1, round(_READING / self._first.dt))
        for first in range(0, references.shape[1], most):
            if first:
                self._read_yaw()
            part = np.ascontiguousarray(control[:, first : first + most])
            self._batch.rollout(part.shape[1], part, control_spec=self._spec, record=(), ids=rows)
