"""models/husky.xml + ground + calibration -> MjModel: dm_control.mjcf composes, mujoco runs.

`_compose` builds what has structure (ground, robot, wheel shape, marker); `calibrate` sets the numbers on a compiled model
and is the only place that does, so a fit that edits one model in place and a profile that is loaded from disk mean the
same robot.
"""

from __future__ import annotations

import math
import warnings
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from validation.robots.calibration import HuskyCalibration, WheelShape
from validation.robots.failures import mujoco_failures
from validation.robots.physics import SHIPPED, PhysicsSettings, apply_settings
from validation.robots.terrain import FLAT, Terrain

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
SIDES = ("left", "right")

GRAVITY = 9.81
"""[m/s2]; list of symbols of the thesis, and MuJoCo's default."""


def xml_path() -> Path:
    """Return the path of husky.xml: inside an installed package, or beside it in a source tree.

    Raises:
        FileNotFoundError: in neither place.
    """
    packaged = Path(str(resources.files("validation"))) / "_models" / "husky.xml"
    source = Path(__file__).resolve().parents[2] / "models" / "husky.xml"
    for path in (packaged, source):
        if path.is_file():
            return path
    raise FileNotFoundError(f"husky.xml is neither at {packaged} nor at {source}: the installation is incomplete")


def _compose(shape: WheelShape, anisotropic: bool, terrain: Terrain) -> str:
    """Return robot and ground as MJCF text; `anisotropic` adds contact pairs, whose two tangential frictions may differ."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control's import warns where there is no screen; nothing is drawn here
        from dm_control import mjcf

    arena = mjcf.from_path(str(xml_path()))
    arena.visual.headlight.set_attributes(ambient=[0.45] * 3, diffuse=[0.35] * 3, specular=[0.1] * 3)
    getattr(arena.visual, "global").set_attributes(offwidth=1280, offheight=960)
    arena.asset.add("texture", name="tiles", type="2d", builtin="checker", width=256, height=256,
                    rgb1=[0.86, 0.87, 0.88], rgb2=[0.79, 0.80, 0.82])  # fmt: skip
    arena.asset.add("material", name="tiles", texture="tiles", texrepeat=[1, 1], texuniform=True)
    ground = _lay_ground(arena, terrain)
    arena.worldbody.add("light", name="sun", mode="fixed", directional=True, pos=[0, 0, 10], dir=[0.3, 0.2, -1])
    arena.worldbody.add("site", name="start", type="cylinder", size=[0.03, 0.001], rgba=[0.1, 0.5, 0.9, 0.8])
    for wheel in WHEELS:
        tire = arena.find("geom", f"{wheel}_tire")
        radius, width = 0.1651, 0.05715
        if shape == "cylinder":
            tire.set_attributes(type="cylinder", size=[radius, width], zaxis=[0, 1, 0])
        elif shape == "capsule":
            tire.set_attributes(type="capsule", size=[radius, HuskyCalibration.capsule_half_width], zaxis=[0, 1, 0])
        if terrain.kind == "rough":
            patch = arena.worldbody.add("body", name=f"{wheel}_ground", mocap=True)
            ground = patch.add("geom", type="plane", size=[0.3, 0.3, 0.05], material="tiles", contype=0, conaffinity=0)
        if anisotropic or terrain.kind == "rough":
            arena.contact.add(
                "pair", geom1=ground, geom2=tire, condim=3, solref=[0.02, 1], solimp=[0.1, 0.95, 0.005, 0.5, 2]
            )
    return arena.to_xml_string()


def _lay_ground(arena: Any, terrain: Terrain) -> Any:
    """Add the ground; return the geom that is named so, if there is one."""
    looks: dict[str, Any] = {"name": "ground", "material": "tiles", "condim": 3}
    if terrain.kind == "rough":
        return None  # each wheel has a plane of its own, which `MujocoPlant` lays under it
    if terrain.kind == "split":
        # Two slabs side by side: planes have no edge. Of two geoms that touch, the one of higher priority says friction and
        # softness: the slippery slab's above the tyre's, the tyre's above the other slab's.
        tire, half = arena.find("default", "tire").geom, 0.5 * SLAB_SIZE
        slab = {"type": "box", "size": [half, half, 0.5 * GROUND_DEPTH], "euler": [0, 0, terrain.edge_heading]}
        left = np.array([-math.sin(terrain.edge_heading), math.cos(terrain.edge_heading), 0.0])
        down = np.array([0.0, 0.0, -0.5 * GROUND_DEPTH])
        contact = {"solref": tire.solref, "solimp": tire.solimp, "priority": int(tire.priority) + 1}
        right = {**looks, **slab, **contact, "name": _OTHER_GROUND, "rgba": [0.55, 0.68, 0.80, 1]}
        arena.worldbody.add("geom", pos=left * (terrain.edge_offset - half) + down, **right)
        return arena.worldbody.add("geom", pos=left * (terrain.edge_offset + half) + down, **slab, **looks)
    return arena.worldbody.add("geom", type="plane", size=[0, 0, 0.05], **looks)


_OTHER_GROUND = "other_ground"
"""The part of a two-friction floor that lies right of its edge."""
GROUND_DEPTH = 0.5
"""Depth of a two-friction floor's slabs [m]: far deeper than any tyre sinks."""
SLAB_SIZE = 200.0
"""Size of each half of a two-friction floor [m]: farther than any run goes."""

PRESSED_IN: dict[str, float] = {"ellipsoid": 0.00283, "cylinder": 0.00252, "capsule": 0.00252}
"""Depth to which each shape of tyre sinks into the soft contact at rest [m], whatever the load: MuJoCo scales a
contact by the inertia behind it. The contact point lies halfway, so the rolling radius is half of it less than the
geom's."""

_models: dict[tuple[str, bool, Terrain], mujoco.MjModel] = {}


@mujoco_failures()
def husky_model(
    calibration: HuskyCalibration, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED
) -> mujoco.MjModel:
    """Return a compiled and calibrated model, which belongs to the caller.

    Raises:
        ValueError: a calibration whose inertia no body can have, or tyres that the terrain cannot have.
    """
    if calibration.friction_ratio != 1.0 and terrain.kind == "split":
        raise ValueError(f"friction_ratio {calibration.friction_ratio} cannot be had on {terrain.words}: it needs one plane")
    key = (calibration.wheel_shape, calibration.friction_ratio != 1.0 or settings.tangent_ratio is not None, terrain)
    if key not in _models:
        _models[key] = mujoco.MjModel.from_xml_string(_compose(*key))
    model = mujoco.MjModel.__copy__(_models[key])
    model.opt.gravity = terrain.gravity(GRAVITY)
    if terrain.kind == "split":
        model.geom_friction[model.geom(_OTHER_GROUND).id, 0] = calibration.friction * terrain.friction_ratio
    calibrate(model, calibration)
    apply_settings(model, settings, wheel_geoms(model))
    return model


def wheel_geoms(model: mujoco.MjModel, prefix: str = "") -> list[int]:
    """Return the ids of the four contact geoms, in the order of `WHEELS`; `prefix` as in `calibrate`."""
    return [model.geom(f"{prefix}{wheel}_tire").id for wheel in WHEELS]


MAKER_BASE_MASS = 46.034
MAKER_ROLL_INERTIA = 0.6022
MAKER_PITCH_INERTIA = 1.7386
"""Mass [kg] and inertia [kg m2] of the base in the maker's robot description (husky_description)."""


def calibrate(model: mujoco.MjModel, calibration: HuskyCalibration, prefix: str = "") -> None:
    """Set every number of `calibration` on a compiled model, in place.

    Roll and pitch inertia of the base scale with its mass; its yaw inertia is the whole robot's less that of the wheels,
    which stand off the middle by the half-track. `prefix` stands in front of the robot's names in a larger model.

    Raises:
        ValueError: an inertia that is not positive, or that no rigid body has (each is at most the sum of the others); the
            model is untouched then.
    """
    wheels = [model.body(f"{prefix}{wheel}") for wheel in WHEELS]
    base_mass = calibration.mass - sum(float(w.mass[0]) for w in wheels)
    half_track = calibration.half_track
    from_wheels = sum(float(w.inertia[2] + w.mass[0] * (w.pos[0] ** 2 + half_track**2)) for w in wheels)
    scale = base_mass / MAKER_BASE_MASS
    inertia = np.array([MAKER_ROLL_INERTIA * scale, MAKER_PITCH_INERTIA * scale, calibration.yaw_inertia - from_wheels])
    if inertia[2] <= 0.0 or 2.0 * inertia.max() > inertia.sum():
        low, high = abs(inertia[0] - inertia[1]) + from_wheels, inertia[0] + inertia[1] + from_wheels
        raise ValueError(
            f"yaw_inertia {calibration.yaw_inertia} kg m2 leaves the base {inertia.round(3)}, which no rigid body has; "
            f"with mass {calibration.mass} kg it must lie between {low:.3f} and {high:.3f}"
        )
    base = model.body(f"{prefix}base").id
    model.body_mass[base] = base_mass
    model.body_inertia[base] = inertia
    model.body_ipos[base] = calibration.com_x, calibration.com_y, calibration.com_z
    for wheel, geom in zip(WHEELS, wheel_geoms(model, prefix), strict=True):
        sign = 1.0 if wheel.endswith("left") else -1.0
        pressed_in = PRESSED_IN[calibration.wheel_shape]
        radius = calibration.wheel_radius + 0.5 * sign * calibration.radius_difference + 0.5 * pressed_in
        model.body_pos[model.body(f"{prefix}{wheel}").id, 1] = sign * half_track
        model.geom_friction[geom, 0] = calibration.friction
        model.geom_size[geom, 0] = radius
        if calibration.wheel_shape == "ellipsoid":
            model.geom_size[geom, 2] = radius
        elif calibration.wheel_shape == "capsule":
            model.geom_size[geom, 1] = calibration.capsule_half_width
        model.geom_rbound[geom] = calibration.wheel_radius + calibration.capsule_half_width + 0.06
    if model.npair:
        # A capsule's contact frame on a plane: first tangent across the rolling direction, second along it.
        model.pair_friction[:, 0] = calibration.friction * calibration.friction_ratio
        model.pair_friction[:, 1] = calibration.friction
    for wheel in WHEELS:
        model.dof_armature[model.joint(f"{prefix}{wheel}_wheel").dofadr[0]] = calibration.armature
    for side in SIDES:
        motor, tendon = model.actuator(f"{prefix}{side}_motor").id, model.tendon(f"{prefix}{side}").id
        model.actuator_gainprm[motor, 0] = calibration.gain
        model.actuator_biasprm[motor, 2] = -calibration.gain
        resistance = calibration.rolling_resistance * 0.5 * calibration.mass * GRAVITY * calibration.wheel_radius
        model.tendon_frictionloss[tendon] = resistance
    model.opt.timestep = calibration.timestep
    mujoco.mj_setConst(model, mujoco.MjData(model))


def limit_torque(model: mujoco.MjModel, wheel_limit: float, prefix: str = "") -> None:
    """Set the greatest torque of one wheel [N m]; a side has twice that. Infinity switches the limit off."""
    for side in SIDES:
        motor = model.actuator(f"{prefix}{side}_motor").id
        limit = 2.0 * wheel_limit
        model.actuator_forcelimited[motor] = math.isfinite(limit)
        if math.isfinite(limit):
            model.actuator_forcerange[motor] = -limit, limit
