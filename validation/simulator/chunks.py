"""A run in chunks: the samples of each are kept and its steps are forgotten, so that hours fit into memory.

A chunk goes on from the last one's state and with what its solver started from, so results do not depend on how long chunks
are, to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from ssmr.errors import DivergedError
from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import FloatArray

CHUNK = 2000
"""Physics steps of a chunk: enough that starting one costs nothing beside them."""
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Samples:
    """Every `stride`-th step of a chunk."""

    states: FloatArray
    """(m, 1 + nq + nv) time, positions and velocities before the step."""
    sensors: FloatArray
    """(m, nsensordata) of the step."""
    yaw: FloatArray
    """(m,) heading before the step, unwrapped from the run's start [rad]."""
    yaw_acceleration: FloatArray
    """(m,) change of the yaw rate in the step over its length [rad/s2]."""


def sampled(
    model: mujoco.MjModel,
    start: FloatArray,
    inputs: Iterable[FloatArray],
    spec: int,
    stride: int,
) -> Iterator[Samples]:
    """Simulate chunk by chunk, and yield the samples of each.

    Args:
        model: the robot on its ground; its first joint is free.
        start: (1 + nq + nv) state before the first step.
        inputs: (n, ...) inputs of the n steps of each chunk.
        spec: kind of the inputs, of `mujoco.mjtState`.
        stride: steps from one sample to the next; the first step is one.

    Raises:
        DivergedError: the simulator gave up; with the time and, as far as the chunk reaches back, the states until then.
    """
    dt, nq, data = float(model.opt.timestep), model.nq, mujoco.MjData(model)
    state, warm, first, turns = start, np.zeros(model.nv), 0, 0
    for given in inputs:
        batch = rollout.rollout(model, data, state[None], given[None], control_spec=spec, initial_warmstart=warm[None])
        after, sensors = batch[0][0], batch[1][0]
        before = np.vstack([state, after[:-1]])
        # A diverged simulation resets itself: its clock jumps back.
        bad = np.flatnonzero((after[:, 0] <= before[:, 0]) | ~np.isfinite(after).all(axis=1))
        if len(bad):
            t = (first + int(bad[0])) * dt
            raise DivergedError(f"mujoco gave up at t = {t:.3f} s: no finite state", t=t, states=before[: int(bad[0]) + 1])
        yaw = quat_wxyz_to_yaw(np.vstack([before[:, 4:8], after[-1:, 4:8]]))
        whole = turns - np.cumulative_sum(np.rint(np.diff(yaw) / _TURN).astype(np.int64), include_initial=True)
        at = slice(-first % stride, len(after), stride)
        change = (after[at, 1 + nq + 5] - before[at, 1 + nq + 5]) / dt
        yield Samples(np.array(before[at]), np.array(sensors[at]), yaw[:-1][at] + _TURN * whole[:-1][at], change)
        state, warm, first, turns = after[-1], np.array(data.qacc_warmstart), first + len(after), int(whole[-1])
