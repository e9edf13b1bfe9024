"""The looks of a robot: the visual solids of its MuJoCo model, body by body, for the scenes of rerun and of MuJoCo."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.report.palette import Rgb
from validation.simulator.composing import VISUAL_GROUP, compose_robot
from validation.simulator.description import WHEELS, Robot

_USUAL_SIZE = (0.984, 0.689, 0.363)  # length, width and height of the robot for which distances in scenes are given [m]
_DRAWN = ("BOX", "CYLINDER", "CAPSULE", "ELLIPSOID")


@dataclass(frozen=True, eq=False)
class Solid:
    """One solid in the frame of its body; what is round stands along its own z."""

    kind: str
    """`BOX`, `CYLINDER`, `CAPSULE` or `ELLIPSOID`."""
    size: FloatArray
    """(3,) half lengths, or radius and half length, as MuJoCo has them [m]."""
    position: FloatArray
    """(3,) middle [m]."""
    quat_wxyz: FloatArray
    """(4,) orientation, w first."""
    rgba: FloatArray
    """(4,) colour and opacity, 0 to 1."""


@dataclass(frozen=True, eq=False)
class Looks:
    """The bodies of a robot, and where each lies when the robot stands at the origin and no wheel has turned."""

    solids: dict[str, list[Solid]]
    """Solids of `base` and of the four wheels."""
    places: dict[str, FloatArray]
    """(3,) of each body, seen from the reference point on the ground below the middle between the axles [m]."""
    box: FloatArray
    """(2, 3) lowest and highest coordinates of the whole robot [m]."""

    @property
    def scale(self) -> FloatArray:
        """(3,) length, width and height of the robot over those of a Husky."""
        return np.asarray((self.box[1] - self.box[0]) / _USUAL_SIZE)


@lru_cache(maxsize=8)
def looks_of(robot: Robot) -> Looks:
    """Return the looks of a robot.

    Raises:
        ValueError: its hand-made MJCF cannot be read, or has looks that are not drawn here.
    """
    model = compose_robot(robot).compile()
    base = -np.array(model.site("reference").pos)
    places = {"base": base} | {wheel: base + model.body(wheel).pos for wheel in WHEELS}
    solids = {name: _solids(model, name) for name in places}
    corners = [place + corner for name, place in places.items() for s in solids[name] for corner in _corners(s)]
    return Looks(solids, places, np.stack([np.min(corners, axis=0), np.max(corners, axis=0)]))


def _solids(model: mujoco.MjModel, name: str) -> list[Solid]:
    """Return the visual solids of one body.

    Raises:
        ValueError: the body has none, or one of a shape that is not drawn here.
    """
    body = model.body(name)
    first, count = int(body.geomadr[0]), int(body.geomnum[0])
    solids = []
    for g in range(first, first + count):
        if model.geom_group[g] == VISUAL_GROUP:
            kind = mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_")
            if kind not in _DRAWN:
                raise ValueError(f"geom '{model.geom(g).name}' is a {kind}; {', '.join(_DRAWN)} are drawn")
            numbers = (model.geom_size[g], model.geom_pos[g], model.geom_quat[g], model.geom_rgba[g])
            solids.append(Solid(kind, *(np.array(v, dtype=np.float64) for v in numbers)))
    if not solids:
        raise ValueError(f"body '{name}' has no geom of group {VISUAL_GROUP}: there is nothing to draw")
    return solids


def _corners(solid: Solid) -> FloatArray:
    """(8, 3) corners of the box around a solid, in the frame of its body [m]."""
    size, rotation = solid.size, np.empty(9)
    half = {"CYLINDER": size[[0, 0, 1]], "CAPSULE": size[[0, 0, 1]] + (0.0, 0.0, size[0])}.get(solid.kind, size)
    mujoco.mju_quat2Mat(rotation, solid.quat_wxyz)
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(solid.position + (signs * half) @ rotation.reshape(3, 3).T)


def tinted(rgba: FloatArray, rgb: Rgb, darkest: float) -> FloatArray:
    """Return a (4,) colour as a shade of another: black becomes `darkest` times `rgb`, bright becomes `rgb`."""
    luma = float(rgba[:3] @ [0.299, 0.587, 0.114])  # ITU-R BT.601
    return np.append(min(darkest + luma, 1.0) * np.array(rgb) / 255.0, rgba[3])
