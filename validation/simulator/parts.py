"""Indices of a robot's parts in the arrays of a compiled model, and MuJoCo's own failures."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import mujoco
import numpy as np
from mujoco import rollout

from ssmr.errors import DivergedError, SsmrError
from ssmr.geometry import rotate_world_to_body
from ssmr.types import FloatArray
from validation.simulator.description import WHEELS


class Parts:
    """Indices of a robot's parts in a compiled model; those of wheels in the order of `WHEELS`."""

    base: int
    """Body of the base."""
    wheels: list[int]
    """Bodies of the wheels."""
    dofs: list[int]
    """Degrees of freedom of the wheels."""
    tires: list[int]
    """Contact geoms of the wheels."""
    sites: list[int]
    """Sites of the load sensors."""
    loads: list[int]
    """Columns of the wheel loads among the sensors' numbers."""
    torques: list[int]
    """Columns of the actuators' torques on the wheels among the sensors' numbers."""

    def __init__(self, model: mujoco.MjModel, prefix: str) -> None:
        """Look them up, see `robot_parts`."""
        names = [f"{prefix}{wheel}" for wheel in WHEELS]
        self.base = model.body(f"{prefix}base").id
        self.wheels = [model.body(name).id for name in names]
        self.dofs = [int(model.joint(f"{name}_wheel").dofadr[0]) for name in names]
        self.tires = [model.geom(f"{name}_tire").id for name in names]
        self.sites = [model.site(f"{name}_load").id for name in names]
        self.loads = [int(model.sensor(f"{prefix}load_{wheel}").adr[0]) for wheel in WHEELS]
        self.torques = [int(model.sensor(f"{prefix}torque_{wheel}").adr[0]) for wheel in WHEELS]

    @property
    def sides(self) -> tuple[list[int], list[int]]:
        """Degrees of freedom of the left and of the right wheels; `WHEELS` takes turns."""
        return self.dofs[::2], self.dofs[1::2]

    def planar(self, qpos: FloatArray, qvel: FloatArray, yaw: FloatArray) -> FloatArray:
        """Return the (M, 8) fields of `ssmr.State` of a robot whose first joint is free.

        Args:
            qpos: (M, nq) positions.
            qvel: (M, nv) velocities.
            yaw: (M,) headings, unwrapped [rad].
        """
        velocity = rotate_world_to_body(qvel[:, :2], yaw)
        wheels = [qvel[:, dofs].mean(axis=1) for dofs in self.sides]
        return np.column_stack([qpos[:, :2], yaw, velocity, qvel[:, 5], *wheels])


# looking names up costs more than a few steps
_parts: dict[tuple[int, bytes, str], Parts] = {}


def robot_parts(model: mujoco.MjModel, prefix: str = "") -> Parts:
    """Return where the parts of a robot are in a compiled model.

    Args:
        model: the model.
        prefix: text in front of the robot's names in a larger model.

    Raises:
        KeyError: the model lacks a part.
    """
    key = (model.signature, model.names, prefix)
    if key not in _parts:
        _parts[key] = Parts(model, prefix)
    return _parts[key]


def rolled_out(
    data: mujoco.MjData, start: FloatArray, inputs: FloatArray, spec: int, first: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return the states after n physics steps, and the sensors' numbers of these.

    Args:
        data: the simulation, with the warm start of its solver, which goes on.
        start: state before the first step.
        inputs: (n, ...) inputs of the steps.
        spec: kind of the inputs, of `mujoco.mjtState`.
        first: number of steps before, for the time of a failure.

    Raises:
        DivergedError: the simulator gave up; with the time and the states until then.
    """
    model = data.model
    warm = np.array(data.qacc_warmstart)
    states, readings = rollout.rollout(
        model,
        data,
        start[None],
        inputs[None],
        control_spec=spec,
        initial_warmstart=warm[None],
    )
    after = states[0]
    before = np.vstack([start, after[:-1]])
    # A diverged simulation resets itself: its clock jumps back.
    bad = np.flatnonzero((after[:, 0] <= before[:, 0]) | ~np.isfinite(after).all(axis=1))
    if len(bad):
        end = int(bad[0])
        t = (first + end) * model.opt.timestep
        raise DivergedError(
            f"mujoco gave up at t = {t:.3f} s: no finite state", t=t, states=before[: end + 1]
        )
    return after, readings[0]


@contextlib.contextmanager
def mujoco_failures() -> Iterator[None]:
    """Within, or in a function that this decorates, a simulator that gives up is a failed run.

    Raises:
        SsmrError: it gave up, as where contacts do not fit into its arena, or memory is short.
    """
    try:
        yield
    except mujoco.FatalError as error:
        raise SsmrError(f"mujoco gave up: {' '.join(str(error).split())}") from error
