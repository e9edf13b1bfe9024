"""The numbers of a hand-made MJCF with the names of models/husky.xml, in the form of a robot's TOML file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.files import reading

MOST_MJCF = 1 << 20
"""Greatest size of a MJCF file [bytes]; models/husky.xml has 21 000."""
_SQUARE = 1e-3
"""How far wheels may lie off a rectangle around the base's origin [m]."""


def read_mjcf(path: Path, wheels: Sequence[str]) -> dict[str, Any]:
    """Return what a hand-made MJCF says of its robot, as `parse_robot` reads it.

    Args:
        path: the file.
        wheels: names of the wheels' bodies: front left, front right, rear left, rear right.

    Raises:
        ValueError: it cannot be read, lacks a part, or its wheels are no rectangle around the origin of `base`.
    """
    text = reading.read_text(path, MOST_MJCF)
    try:
        model = mujoco.MjModel.from_xml_string(text) if "<include" not in text else mujoco.MjModel.from_xml_path(str(path))
        bodies = [model.body(name) for name in wheels]
        tires = [model.geom(f"{name}_tire") for name in wheels]
        base, joint = model.body("base"), model.joint(f"{wheels[0]}_wheel")
    except (ValueError, KeyError) as error:
        raise ValueError(f"{path}: this is no MJCF of a robot ({' '.join(str(error).split())})") from error
    places = np.array([body.pos for body in bodies])
    wheelbase, track = 2.0 * float(places[0, 0]), 2.0 * float(places[0, 1])
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    if np.abs(places[:, :2] - 0.5 * signs * [wheelbase, track]).max() > _SQUARE or np.ptp(places[:, 2]) > _SQUARE:
        raise ValueError(f"{path}: the wheels must be a rectangle around the origin of the body 'base', at one height")
    inertia, spin = _in_body(model, base.id), _in_body(model, bodies[0].id)
    belted = any(model.equality(k).name.startswith("belt_") for k in range(model.neq))
    motor = [
        model.actuator(k)
        for k in range(model.nu)
        if model.actuator(k).name == ("left_motor" if belted else f"{wheels[0]}_motor")
    ]
    share = 1.0 if belted else 2.0  # of a side's motors
    total = float(base.mass[0] + sum(body.mass[0] for body in bodies))
    document: dict[str, Any] = {
        "schema": "ssmr.robot/1",
        "name": re.sub(r"\W+", "-", path.stem).strip("-_") or "robot",
        "mjcf": path.name,
        "geometry": {
            "wheelbase": wheelbase,
            "track": track,
            "wheel_radius": float(tires[0].size[0]),
            "wheel_width": 2.0 * float(tires[0].size[1]),
            "axle_height": float(places[0, 2]),
            "link": "belt" if belted else "none",
        },
        "mass": {
            "total": total,
            "wheel": float(bodies[0].mass[0]),
            "wheel_inertia": [float(spin[0]), float(spin[1])],
            "com": base.ipos.tolist(),
            "inertia": inertia.tolist(),
        },
        "simulation": {
            "friction": float(tires[0].friction[0]),
            "armature": float(model.dof_armature[joint.dofadr[0]]),
            "timestep": float(model.opt.timestep),
        },
        "sources": {name: f"assumed: read from {path.name}" for name in ("geometry", "mass", "simulation")},
    }
    if motor and motor[0].gainprm[0] > 0.0:
        document["simulation"]["gain"] = share * float(motor[0].gainprm[0])
    if motor and model.actuator_forcelimited[motor[0].id]:
        document["drive"] = {"torque_limit": 0.5 * share * float(motor[0].forcerange[1])}
    return document


def _in_body(model: mujoco.MjModel, body: int) -> FloatArray:
    """Return the (3,) moments of inertia of a body along its own axes; products of inertia are left out."""
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.body_iquat[body])
    rotation = turned.reshape(3, 3)
    return np.asarray(np.diag(rotation @ np.diag(model.body_inertia[body]) @ rotation.T))
