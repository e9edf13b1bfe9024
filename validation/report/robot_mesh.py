"""The looks of a robot as triangles: one flat-shaded mesh for each body of its MJCF, and how its wheels turn."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.types import FloatArray
from validation.report.palette import Rgb
from validation.simulator.composing import VISUAL_GROUP, compose_robot
from validation.simulator.description import WHEELS, Robot
from validation.simulator.failures import mujoco_failures

SEGMENTS = 36
"""Flat faces around whatever is round."""
RINGS = 6
"""Flat faces from the equator of a cap to its pole."""
USUAL_SIZE = (0.984, 0.689, 0.363)
"""Length, width and height of the robot for which distances in scenes are given [m]: a Husky's."""
SMALLEST_FACE = 1e-12
"""A triangle of less area has no normal [m2]: what a profile leaves where it meets its axis."""


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """One body's triangles: every three rows are one, counter-clockwise seen from outside."""

    vertices: FloatArray
    """(3 T, 3) corners in the body's frame [m]."""
    normals: FloatArray
    """(3 T, 3) unit normals, the same at the three corners of a triangle."""
    colours: NDArray[np.uint8]
    """(3 T, 4) red, green, blue, opacity."""


@dataclass(frozen=True, eq=False)
class RobotMesh:
    """The bodies of the robot, and where each lies when the robot stands at the origin and no wheel has turned."""

    bodies: Mapping[str, BodyMesh]
    """`base` and the four wheels."""
    places: Mapping[str, FloatArray]
    """(3,) of each body, seen from the reference point on the ground below the middle between the axles [m]."""

    @cached_property
    def box(self) -> FloatArray:
        """(2, 3) lowest and highest coordinates of the whole robot [m]."""
        corners = np.concatenate([self.places[name] + mesh.vertices for name, mesh in self.bodies.items()])
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    @cached_property
    def scale(self) -> FloatArray:
        """(3,) length, width and height of the whole robot over `USUAL_SIZE`."""
        return np.asarray((self.box[1] - self.box[0]) / USUAL_SIZE)


@lru_cache(maxsize=8)
@mujoco_failures()
def robot_mesh(robot: Robot) -> RobotMesh:
    """Return the looks of a robot.

    Raises:
        MemoryError: there is not enough memory for its model.
        ValueError: its hand-made MJCF cannot be read, or has looks that are not drawn here.
    """
    model = compose_robot(robot).compile()
    base = -np.array(model.site("reference").pos)
    places = {"base": base} | {wheel: base + model.body(wheel).pos for wheel in WHEELS}
    return RobotMesh({name: body_mesh(model, name) for name in places}, places)


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
    solids = [_placed(model, g) for g in visual]
    colours = [np.tile(np.round(255.0 * model.geom_rgba[g]), (3 * len(s), 1)) for g, s in zip(visual, solids, strict=True)]
    triangles = np.concatenate(solids)
    cross = _cross(triangles)
    normals = cross / np.linalg.norm(cross, axis=-1, keepdims=True)
    return BodyMesh(triangles.reshape(-1, 3), np.repeat(normals, 3, axis=0), np.concatenate(colours).astype(np.uint8))


def _placed(model: mujoco.MjModel, geom: int) -> FloatArray:
    """(T, 3, 3) triangles of a geom in the frame of its body."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return _solid(model, geom) @ rotation.reshape(3, 3).T + model.geom_pos[geom]


def _solid(model: mujoco.MjModel, geom: int) -> FloatArray:
    """(T, 3, 3) triangles of a geom in its own frame. Sizes are half lengths and radii; what is round stands along z."""
    size, kind = model.geom_size[geom], mujoco.mjtGeom(int(model.geom_type[geom]))
    latitude = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 2 * RINGS + 1)
    circle = np.column_stack([np.cos(latitude), np.sin(latitude)])
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
    raise ValueError(f"geom '{model.geom(geom).name}' is a {kind.name}; boxes, cylinders, capsules and ellipsoids are drawn")


def box(half: FloatArray) -> FloatArray:
    """(12, 3, 3) triangles of a box with (3,) half lengths [m]."""
    square = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])[[[0, 1, 2], [0, 2, 3]]]
    faces = [np.roll(square, k, axis=-1) for k in range(3)]  # a cyclic exchange of axes turns, it does not mirror
    return np.concatenate([*faces, *(-face[:, ::-1] for face in faces)]) * half


def revolve(profile: FloatArray) -> FloatArray:
    """(T, 3, 3) triangles of the solid that a (K, 2) profile of radius and z [m], from the bottom up, sweeps around z."""
    angle = np.linspace(0.0, 2.0 * math.pi, SEGMENTS, endpoint=False)
    radius, z = profile[:, :1], profile[:, 1:]
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z, (len(z), SEGMENTS))], axis=-1)
    ahead = np.roll(rings, -1, axis=1)
    lower = np.stack([rings[:-1], ahead[:-1], ahead[1:]], axis=2)
    upper = np.stack([rings[:-1], ahead[1:], rings[1:]], axis=2)
    triangles = np.concatenate([lower, upper]).reshape(-1, 3, 3)
    return triangles[np.linalg.norm(_cross(triangles), axis=-1) > 2.0 * SMALLEST_FACE]


def _cross(triangles: FloatArray) -> FloatArray:
    """(T, 3) outward normals of (T, 3, 3) triangles, twice as long as the area [m2]."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def tinted(colours: NDArray[np.uint8], rgb: Rgb, darkest: float) -> NDArray[np.uint8]:
    """(V, 4) colours printed in shades of one: black becomes `darkest` times `rgb`, bright becomes `rgb`; opacity stays."""
    luma = colours[:, :3] @ [0.299, 0.587, 0.114] / 255.0  # ITU-R BT.601
    out = colours.copy()
    out[:, :3] = np.round(np.minimum(darkest + luma, 1.0)[:, None] * np.array(rgb))
    return out


def wheel_quat_wxyz(turn: ArrayLike) -> FloatArray:
    """(..., 4) unit quaternions, w first, of turns by (...) angles [rad] about y, the axle: a positive one rolls forward."""
    half = 0.5 * np.asarray(turn, dtype=np.float64)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1)
