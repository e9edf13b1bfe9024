"""Where the parts of a robot lie in the arrays of a compiled model, and a state of the simulator to compute in.

Both are the same for all copies of a model, and cost more than a few steps of simulation: they are kept.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import mujoco

from validation.simulator.description import WHEELS

_MOST_KEPT = 64
"""Kinds of models whose parts are kept."""
_MOST_STATES = 8
"""Kinds of models for which a thread keeps a state."""


@dataclass(frozen=True)
class Parts:
    """Indices of a robot's parts; those of wheels in the order of `WHEELS`."""

    base: int
    """Body of the base."""
    wheels: list[int]
    """Bodies of the wheels."""
    joints: list[int]
    """Joints of the wheels."""
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
        if len(_parts) >= _MOST_KEPT:
            _parts.clear()
        joints = [model.joint(f"{prefix}{wheel}_wheel") for wheel in WHEELS]
        _parts[key] = Parts(
            base=model.body(f"{prefix}base").id,
            wheels=[model.body(f"{prefix}{wheel}").id for wheel in WHEELS],
            joints=[joint.id for joint in joints],
            dofs=[int(joint.dofadr[0]) for joint in joints],
            tires=[model.geom(f"{prefix}{wheel}_tire").id for wheel in WHEELS],
            sites=[model.site(f"{prefix}{wheel}_load").id for wheel in WHEELS],
            loads=[int(model.sensor(f"{prefix}load_{wheel}").adr[0]) for wheel in WHEELS],
            torques=[int(model.sensor(f"{prefix}torque_{wheel}").adr[0]) for wheel in WHEELS],
        )
    return _parts[key]


class _States(threading.local):
    """The states of a thread, by the signature of the models that they fit."""

    def __init__(self) -> None:
        self.kept: dict[int, mujoco.MjData] = {}


_states = _States()


def scratch(model: mujoco.MjModel) -> mujoco.MjData:
    """Return a state of the simulator to compute in, reset; it is this thread's until it asks for another."""
    kept = _states.kept
    if model.signature not in kept:
        if len(kept) >= _MOST_STATES:
            kept.clear()
        kept[model.signature] = mujoco.MjData(model)
    data = kept[model.signature]
    mujoco.mj_resetData(model, data)
    return data
