"""The looks of the robot as triangles: one flat-shaded mesh for each body of an MjModel, made from its visual geoms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray

VISUAL_GROUP = 2
"""Geoms of this group are looks; husky.xml says so."""
SEGMENTS = 36
"""Flat faces around whatever is round."""
RINGS = 6
"""Flat faces from the pole to the equator of a cap."""


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """One body's triangles: every three rows are a triangle, counter-clockwise seen from outside."""

    position: FloatArray
    """(3,) where the body's frame lies in its parent's [m]."""
    vertices: FloatArray
    """(3 T, 3) corners in the body's frame [m]."""
    normals: FloatArray
    """(3 T, 3) unit normals, the same at the three corners of a triangle."""
    colours: NDArray[np.uint8]
    """(3 T, 4) red, green, blue, opacity."""


def body_mesh(model: mujoco.MjModel, name: str) -> BodyMesh:
    """Triangulate the visual geoms of one body.

    Args:
        model: a compiled model.
        name: the body's name.

    Returns:
        The mesh, in the frame of that body.

    Raises:
        ValueError: the body has no visual geom, or one of a shape that is not drawn here.
    """
    body = model.body(name)
    first, count = int(body.geomadr[0]), int(body.geomnum[0])
    visual = [g for g in range(first, first + count) if model.geom_group[g] == VISUAL_GROUP]
    if not visual:
        raise ValueError(f"body '{name}' has no geom of group {VISUAL_GROUP}: there is nothing to draw")
    triangles = [_placed(model, g) for g in visual]
    colours = [np.tile(np.round(255.0 * model.geom_rgba[g]), (3 * len(t), 1)) for g, t in zip(visual, triangles, strict=True)]
    corners = np.concatenate(triangles)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return BodyMesh(np.array(body.pos), corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), np.concatenate(colours).astype(np.uint8))


def _placed(model: mujoco.MjModel, geom: int) -> FloatArray:
    """(T, 3, 3) triangles of a geom in the frame of its body."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return _solid(model, geom) @ rotation.reshape(3, 3).T + model.geom_pos[geom]


def _solid(model: mujoco.MjModel, geom: int) -> FloatArray:
    """(T, 3, 3) triangles of a geom in its own frame: MuJoCo's sizes are half lengths and radii, round things stand along z."""
    size, kind = model.geom_size[geom], mujoco.mjtGeom(int(model.geom_type[geom]))
    arc = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 2 * RINGS + 1)
    circle = np.column_stack([np.cos(arc), np.sin(arc)])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return box(size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = size[:2]
        return revolve(np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]]))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        shift = np.array([0.0, size[1]])
        return revolve(np.concatenate([size[0] * circle[: RINGS + 1] - shift, size[0] * circle[RINGS:] + shift]))
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return revolve(circle) * size
    raise ValueError(f"geom '{model.geom(geom).name}' is a {kind.name}; only boxes, cylinders, capsules and ellipsoids are drawn")


def box(half: FloatArray) -> FloatArray:
    """(12, 3, 3) triangles of a box with half lengths `half` [m]."""
    square = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])[[[0, 1, 2], [0, 2, 3]]]
    cyclic = [np.roll(square, k, axis=-1) for k in range(3)]  # a cyclic exchange of axes turns, it does not mirror
    return np.concatenate([*cyclic, *(-f[:, ::-1] for f in cyclic)]) * half


def revolve(profile: FloatArray) -> FloatArray:
    """(T, 3, 3) triangles of the solid that a (K, 2) profile of radius and z [m], from the bottom up, sweeps around z."""
    angle = np.linspace(0.0, 2.0 * math.pi, SEGMENTS, endpoint=False)
    radius, z = profile[:, :1], profile[:, 1:]
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z, (len(z), SEGMENTS))], axis=-1)
    ahead = np.roll(rings, -1, axis=1)
    low, low_ahead, high, high_ahead = rings[:-1], ahead[:-1], rings[1:], ahead[1:]
    triangles = np.concatenate([np.stack([low, low_ahead, high_ahead], axis=2), np.stack([low, high_ahead, high], axis=2)])
    triangles = triangles.reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=-1)
    return triangles[area > 1e-12]  # on the axis a face has no second triangle


def tinted(colours: NDArray[np.uint8], rgb: tuple[int, int, int], darkest: float = 0.25) -> NDArray[np.uint8]:
    """(V, 4) colours printed in shades of one: black becomes `darkest` times `rgb`, what is bright `rgb`; opacity is kept."""
    brightness = colours[:, :3] @ [0.299, 0.587, 0.114] / 255.0  # luma, ITU-R BT.601
    out = colours.copy()
    out[:, :3] = np.round(np.minimum(darkest + brightness, 1.0)[:, None] * np.array(rgb))
    return out
