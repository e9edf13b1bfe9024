"""models/husky.xml + ground + calibration -> MjModel: dm_control.mjcf composes, mujoco runs.

`_compose` builds what has structure (ground, robot, wheel shape); `calibrate` and `set_motors` set the numbers on a
compiled model and are the only places that do, so a fit that edits one model in place and a profile that is loaded from disk
mean the same robot.
"""

from __future__ import annotations

import math
import warnings
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ssmr.robot.motor import motor_numbers
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray
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


def _compose(shape: WheelShape, anisotropic: bool, integral: bool, terrain: Terrain) -> str:
    """Return robot and ground as MJCF text, without looks: recordings have them from husky.xml, and here they cost time.

    `anisotropic` adds contact pairs, whose two tangential frictions may differ; `integral` the motors' integral parts.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control's import warns where there is no screen; nothing is drawn here
        from dm_control import mjcf

    arena = mjcf.from_path(str(xml_path()))
    if integral:
        add_integral_parts(arena)
    for geom in arena.find_all("geom"):
        if not geom.name.endswith("_tire"):
            geom.remove()
    ground = _lay_ground(arena, terrain)
    for wheel in WHEELS:
        tire = arena.find("geom", f"{wheel}_tire")
        radius, width = 0.1651, 0.05715
        if shape == "cylinder":
            tire.set_attributes(type="cylinder", size=[radius, width], zaxis=[0, 1, 0])
        elif shape == "capsule":
            tire.set_attributes(type="capsule", size=[radius, HuskyCalibration.capsule_half_width], zaxis=[0, 1, 0])
        if terrain.kind == "rough":
            patch = arena.worldbody.add("body", name=f"{wheel}_ground", mocap=True)
            ground = patch.add("geom", type="plane", size=[0.3, 0.3, 0.05], contype=0, conaffinity=0)
        if anisotropic or terrain.kind == "rough":
            arena.contact.add(
                "pair", geom1=ground, geom2=tire, condim=3, solref=[0.02, 1], solimp=[0.1, 0.95, 0.005, 0.5, 2]
            )
    return arena.to_xml_string()


def _lay_ground(arena: Any, terrain: Terrain) -> Any:
    """Add the ground; return the geom that is named so, if there is one."""
    whole: dict[str, Any] = {"name": "ground", "condim": 3}
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
        right = {**whole, **slab, **contact, "name": _OTHER_GROUND}
        arena.worldbody.add("geom", pos=left * (terrain.edge_offset - half) + down, **right)
        return arena.worldbody.add("geom", pos=left * (terrain.edge_offset + half) + down, **slab, **whole)
    return arena.worldbody.add("geom", type="plane", size=[0, 0, 0.05], **whole)


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

SHAFT_MASS = 1e-6
"""Mass [kg] and inertia [kg m2] of the body that carries a virtual shaft: next to nothing."""


def add_integral_parts(robot: Any) -> None:
    """Add what MuJoCo needs for a leaky integral in the speed loop of each side to the robot's MJCF tree.

    The integral is the torsion of a spring between the mean angle of a side's wheels and a virtual shaft, which a servo of
    limited torque turns at the wanted rate: the lasting torque of the spring slows the shaft down, so the integral leaks.
    """
    base = robot.find("body", "base")
    for side in SIDES:
        shaft = base.add("body", name=f"{side}_shaft")
        shaft.add("inertial", pos=[0, 0, 0], mass=SHAFT_MASS, diaginertia=[SHAFT_MASS] * 3)
        joint = shaft.add("joint", name=f"{side}_shaft", type="hinge", axis=[0, 1, 0], armature=1.0)
        robot.actuator.add("velocity", name=f"{side}_shaft", joint=joint, kv=1.0)
    for side in SIDES:
        spring = robot.tendon.add("fixed", name=f"{side}_spring", springlength=[0.0, 0.0])
        for name, share in ((f"front_{side}_wheel", -0.5), (f"rear_{side}_wheel", -0.5), (f"{side}_shaft", 1.0)):
            spring.add("joint", joint=name, coef=share)
        robot.actuator.add("general", name=f"{side}_spring", tendon=spring, biastype="affine", gainprm=[0.0])


def controls(model: mujoco.MjModel, references: FloatArray) -> FloatArray:
    """Return the (..., nu) inputs of all actuators for (..., 2) wheel-rate references [rad/s] of the left and right side.

    The servos of the motors and, with integral parts, of their shafts have the reference; the springs have no input.
    """
    if model.nu == len(SIDES):
        return references
    return np.concatenate([references, references, np.zeros_like(references)], axis=-1)


_models: dict[tuple[str, bool, bool, Terrain], mujoco.MjModel] = {}


FREE_DRIVE = Drive(torque_limit=math.inf)
"""Motors of the thesis without a limit: what a model has that is driven without a `Drive`."""


@mujoco_failures()
def husky_model(
    calibration: HuskyCalibration, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED, drive: Drive = FREE_DRIVE
) -> mujoco.MjModel:
    """Return a compiled and calibrated model, which belongs to the caller; its motors are those of `drive`.

    Raises:
        ValueError: a calibration whose inertia no body can have, or tyres that the terrain cannot have.
    """
    if calibration.friction_ratio != 1.0 and terrain.kind == "split":
        raise ValueError(f"friction_ratio {calibration.friction_ratio} cannot be had on {terrain.words}: it needs one plane")
    anisotropic = calibration.friction_ratio != 1.0 or settings.tangent_ratio is not None
    key = (calibration.wheel_shape, anisotropic, drive.integral_gain > 0.0, terrain)
    if key not in _models:
        _models[key] = mujoco.MjModel.from_xml_string(_compose(*key))
    model = mujoco.MjModel.__copy__(_models[key])
    model.opt.gravity = terrain.gravity(GRAVITY)
    if terrain.kind == "split":
        model.geom_friction[model.geom(_OTHER_GROUND).id, 0] = calibration.friction * terrain.friction_ratio
    calibrate(model, calibration)
    set_motors(model, calibration, drive)
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
    """Set every number of `calibration` on a compiled model, in place, but for those of the motors (`set_motors`).

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
    model.opt.timestep = calibration.timestep
    mujoco.mj_setConst(model, mujoco.MjData(model))


def set_motors(model: mujoco.MjModel, calibration: HuskyCalibration, drive: Drive, prefix: str = "") -> None:
    """Set the motors of `drive` (`ssmr.robot.motor`), with the calibration's gain, on a calibrated model, in place.

    An integral part K_I, leaking to a stiffness K_dc, is a shaft of inertia J behind a servo of gain D and a spring of
    stiffness k. The spring has a damper q of up to half the gain K_P, which the direct servo has less: without it the shaft
    would swing on its spring once its servo has reached its limit. Without J the side's torque is exactly that of the motor,

        tau = (K_P' - q) e + k s + q ds/dt,  D (e - ds/dt) = k s + q ds/dt,  e = wanted rate - wheel rate,  s = torsion,

    with K_P = K_P' - q^2 / (D + q), K_I = k D^2 / (D + q)^2 and K_dc = D^2 / (D + q). J makes the shaft late by half a step.

    Raises:
        ValueError: the drive has an integral part and the model has none, or the other way round.
    """
    motor, dt = motor_numbers(drive), calibration.timestep
    if (motor.integral_gain > 0.0) != (model.nu > len(SIDES)):
        raise ValueError("the model and the drive must both have an integral part in the speed loop, or neither")
    weight = calibration.mass * GRAVITY
    lost = calibration.rolling_resistance * 0.5 * weight * calibration.wheel_radius + motor.gear_loss
    limited = math.isfinite(motor.limit)
    for wheel in WHEELS:
        joint = model.joint(f"{prefix}{wheel}_wheel").id
        model.dof_damping[model.jnt_dofadr[joint]] = 0.5 * motor.braking
        model.jnt_actfrclimited[joint] = limited and motor.integral_gain > 0.0  # of the servo's and the spring's sum
        model.jnt_actfrcrange[joint] = (-0.5 * motor.limit, 0.5 * motor.limit) if limited else 0.0
    for side in SIDES:
        direct, limit = calibration.gain, motor.limit
        if motor.integral_gain > 0.0:
            stiffness, shaft = drive.dc_stiffness, model.joint(f"{prefix}{side}_shaft").id
            inertia = 0.5 * stiffness * dt
            damper = min(0.5 * calibration.gain, 2.0 * math.sqrt(motor.integral_gain * inertia))
            servo = 0.5 * (stiffness + math.sqrt(stiffness * (stiffness + 4.0 * damper)))
            spring = motor.integral_gain * ((servo + damper) / servo) ** 2
            direct += damper * damper / (servo + damper) - damper
            model.dof_armature[model.jnt_dofadr[shaft]] = inertia
            _set_actuator(model, f"{prefix}{side}_spring", 0.0, -spring, -damper)
            _set_actuator(model, f"{prefix}{side}_shaft", servo, 0.0, -servo, motor.limit)
            limit = math.inf  # the joints limit the sum
        _set_actuator(model, f"{prefix}{side}_motor", direct, 0.0, motor.braking - direct, limit)
        model.tendon_frictionloss[model.tendon(f"{prefix}{side}").id] = lost


def _set_actuator(
    model: mujoco.MjModel, name: str, gain: float, by_length: float, by_rate: float, limit: float = math.inf
) -> None:
    """Set the gain of an actuator, the affine terms of its force, and its greatest force."""
    number = int(model.actuator(name).id)
    model.actuator_gainprm[number, 0] = gain
    model.actuator_biasprm[number, :3] = 0.0, by_length, by_rate
    model.actuator_forcelimited[number] = math.isfinite(limit)
    if math.isfinite(limit):
        model.actuator_forcerange[number] = -limit, limit
