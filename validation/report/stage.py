"""Robots on their ground for MuJoCo's own renderer and viewer: looks alone, put where a motion says, without physics."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.types import FloatArray
from validation.report.palette import BLACK, mix
from validation.report.tracks import GROUND, bright, looks_of, tinted
from validation.simulator.description import WHEELS, Robot

_GHOST_OPACITY, _GHOST_SIZE = 0.45, 0.985
"""Opacity of a ghost, and its size over the robot's: where it stands just as the solid one does, it hides inside."""
_SIDES = np.array([0 if wheel.endswith("left") else 1 for wheel in WHEELS])


class Stage:
    """Robots of one kind: the first one solid in its own colours, the others translucent in those of their plants."""

    def __init__(self, robot: Robot, names: Sequence[str]) -> None:
        """Put all robots to the origin.

        Args:
            robot: what they look like.
            names: plants; the first one's robot is solid.
        """
        self.looks, self.names = looks_of(robot), tuple(names)
        spec, scale = mujoco.MjSpec(), self.looks.scale
        spec.stat.extent, spec.visual.global_.offwidth, spec.visual.global_.offheight = 4.0 * scale, 1920, 1080
        spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.25] * 3
        _lay_ground(spec)
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

    def place(self, rank: int, pose: FloatArray, turns: FloatArray) -> None:
        """Put a robot somewhere; `settle` shows it there.

        Args:
            rank: index of the robot.
            pose: (3,) pose of the body's reference point [m, m, rad].
            turns: (2,) angles through which left and right wheels have turned [rad].
        """
        self.data.mocap_pos[rank] = *pose[:2], 0.0
        self.data.mocap_quat[rank] = yaw_to_quat_wxyz(pose[2])
        self.data.qpos[len(WHEELS) * rank : len(WHEELS) * (rank + 1)] = np.asarray(turns)[_SIDES]

    def settle(self) -> None:
        """Move all bodies to where the robots were put."""
        mujoco.mj_fwdPosition(self.model, self.data)


def _lay_ground(spec: mujoco.MjSpec) -> None:
    """Add sky and ground: squares of a metre."""
    pale, dark = (np.array(rgb) / 255.0 for rgb in (GROUND, mix(GROUND, BLACK, 0.12)))
    sky, builtin = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=sky, builtin=builtin, rgb1=[0.75, 0.84, 0.94], rgb2=[1.0, 1.0, 1.0], width=256, height=1536)
    untouched = {"contype": 0, "conaffinity": 0}
    squares = {"type": mujoco.mjtTexture.mjTEXTURE_2D, "builtin": mujoco.mjtBuiltin.mjBUILTIN_CHECKER}
    spec.add_texture(name="squares", rgb1=pale, rgb2=dark, width=256, height=256, **squares)
    floor = spec.add_material(name="floor", texuniform=True, texrepeat=[0.5, 0.5])
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05], material="floor", **untouched)
