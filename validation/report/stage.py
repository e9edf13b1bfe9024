"""Robots on their ground for MuJoCo's own renderer and viewer: looks alone, put where a motion says, without physics."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ssmr.geometry import roll_pitch_yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.report.palette import BLACK, mix
from validation.report.tracks import GROUND, bright, looks_of, tinted
from validation.simulator.description import WHEELS, Robot
from validation.simulator.terrain import FLAT, Terrain

_GHOST_OPACITY, _GHOST_SIZE = 0.45, 0.985
"""Opacity of a ghost, and its size over the robot's: where it stands just as the solid one does, it hides inside."""
_SIDES = np.array([0 if wheel.endswith("left") else 1 for wheel in WHEELS])
_NET_POINTS = 300
"""Points of the net over rough ground along each of its sides."""


class Stage:
    """Robots of one kind: the first one solid in its own colours, the others translucent in those of their plants."""

    def __init__(
        self, robot: Robot, names: Sequence[str], terrain: Terrain = FLAT, corners: FloatArray | None = None
    ) -> None:
        """Put all robots to the origin.

        Args:
            robot: what they look like.
            names: plants; the first one's robot is solid.
            terrain: ground.
            corners: (2, 2) corners of the ground that is drawn where it is rough [m]; 40 m by 40 m around the origin if not
                given. Other grounds have no end.
        """
        self.looks, self.names, self.terrain, self._frame = looks_of(robot), tuple(names), terrain, robot.geometry
        spec, scale = mujoco.MjSpec(), self.looks.scale
        spec.stat.extent, spec.visual.global_.offwidth, spec.visual.global_.offheight = 4.0 * scale, 1920, 1080
        spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.25] * 3
        _lay_ground(spec, terrain, np.array([[-20.0, -20.0], [20.0, 20.0]]) if corners is None else corners)
        for rank, name in enumerate(names):
            self._add_robot(spec, rank, name)
        sun = spec.body("0").add_light(pos=[0.0, 0.0, 6.0 * scale], dir=[0.3, 0.25, -1.0], diffuse=[0.5] * 3)
        sun.castshadow = False  # coarse, and a third of the time
        sun.type, sun.mode = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, mujoco.mjtCamLight.mjCAMLIGHT_TRACK
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.settle()

    def _add_robot(self, spec: mujoco.MjSpec, rank: int, name: str) -> None:
        places = self.looks.places
        base = spec.worldbody.add_body(name=str(rank), mocap=True)
        for part in ("base", *WHEELS):
            body, offset = base, places["base"]
            if part != "base":
                body, offset = base.add_body(name=f"{rank}_{part}", pos=places[part]), np.zeros(3)
                body.add_joint(name=f"{rank}_{part}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0])
            for solid in self.looks.solids[part]:
                rgba, size = solid.rgba, 1.0
                if rank:
                    rgba, size = np.append(tinted(rgba, bright(name), 0.5)[:3], _GHOST_OPACITY), _GHOST_SIZE
                body.add_geom(
                    type=getattr(mujoco.mjtGeom, f"mjGEOM_{solid.kind}"), size=size * solid.size, rgba=rgba,
                    pos=offset + size * solid.position, quat=solid.quat_wxyz, contype=0, conaffinity=0,
                )  # fmt: skip

    def place(self, rank: int, pose: FloatArray, turns: FloatArray, raised: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Put a robot somewhere; `settle` shows it there.

        Args:
            rank: index of the robot.
            pose: (3,) pose of the body's reference point [m, m, rad].
            turns: (2,) angles through which left and right wheels have turned [rad].
            raised: height [m], roll and pitch [rad] on uneven ground.
        """
        self.data.mocap_pos[rank] = *pose[:2], raised[0]
        self.data.mocap_quat[rank] = roll_pitch_yaw_to_quat_wxyz(raised[1], raised[2], pose[2])
        self.data.qpos[len(WHEELS) * rank : len(WHEELS) * (rank + 1)] = np.asarray(turns)[_SIDES]

    def lie(self, pose: FloatArray) -> FloatArray:
        """Return (3,) height [m], roll and pitch [rad] with which a robot's wheels lie on the ground at a (3,) pose."""
        return self.terrain.lie(pose[None], self._frame.wheelbase, self._frame.track)[0]

    def settle(self) -> None:
        """Move all bodies to where the robots were put."""
        mujoco.mj_fwdPosition(self.model, self.data)


def _lay_ground(spec: mujoco.MjSpec, terrain: Terrain, corners: FloatArray) -> None:
    """Add sky and ground: squares of a metre; rough ground without squares."""
    pale, dark = (np.array(rgb) / 255.0 for rgb in (GROUND, mix(GROUND, BLACK, 0.12)))
    sky, builtin = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=sky, builtin=builtin, rgb1=[0.75, 0.84, 0.94], rgb2=[1.0, 1.0, 1.0], width=256, height=1536)
    untouched = {"contype": 0, "conaffinity": 0}
    if terrain.kind == "rough":
        x, y = (np.linspace(low, high, _NET_POINTS) for low, high in zip(*corners, strict=True))
        heights = terrain.height_at(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
        low, rise = float(heights.min()), max(float(np.ptp(heights)), 1e-6)
        half, middle = 0.5 * (corners[1] - corners[0]), corners.mean(axis=0)
        spec.add_hfield(
            name="rough", nrow=_NET_POINTS, ncol=_NET_POINTS, size=[*half, rise, 0.1], userdata=(heights - low) / rise
        )
        kind = mujoco.mjtGeom.mjGEOM_HFIELD
        spec.worldbody.add_geom(type=kind, hfieldname="rough", pos=[*middle, low], rgba=[*pale, 1.0], **untouched)
        return
    squares = {"type": mujoco.mjtTexture.mjTEXTURE_2D, "builtin": mujoco.mjtBuiltin.mjBUILTIN_CHECKER}
    spec.add_texture(name="squares", rgb1=pale, rgb2=dark, width=256, height=256, **squares)
    floor = spec.add_material(name="floor", texuniform=True, texrepeat=[0.5, 0.5])
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05], material="floor", **untouched)
