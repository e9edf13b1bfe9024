"""A robot, its ground and a calibration -> MjModel.

`_compile_model` builds the structure (robot, ground, wheel shape); `set_calibration` and
`set_motors` set the numbers on a compiled model and are the only places that do, so a fit that
edits one model in place and a profile that is loaded from disk mean the same robot.
"""

from __future__ import annotations

import math
from functools import lru_cache

import mujoco
import numpy as np

from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray
from validation.simulator.calibration import Calibration
from validation.simulator.composing import compose_robot, contact_settings
from validation.simulator.description import GRAVITY, SIDES, WHEELS, Robot, WheelShape
from validation.simulator.motors import set_motors
from validation.simulator.parts import mujoco_failures, robot_parts
from validation.simulator.physics import SHIPPED, Impedance, PhysicsSettings, apply_settings
from validation.simulator.terrain import FLAT, Terrain

_CONTACT_POINTS = {"ellipsoid": 1, "cylinder": 2, "capsule": 2}
"""Points in which each shape of tyre touches level ground."""
_BELT_TIME = 0.030834
"""Time constant of the belts over sqrt(wheel radius / g) [1], a fifth of the contact's; 4 ms for a
Husky."""
_READ_SENSORS = frozenset(f"load_{w}" for w in WHEELS) | {f"torque_{w}" for w in WHEELS}
"""Sensors of the simulated robot. The other channels of a run follow from its states, and the IMU
from a state (`MujocoPlant.imu`); accelerometers would make MuJoCo compute all bodies' accelerations
at each step."""
_NET_FORCE = [1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1]
"""Output of a sensor of contacts: the force, of all contacts together (MuJoCo's `netforce`), as
one."""
_CLOSE = 1e-8
"""Last relative step of Newton's method for a depth, beyond which rounding remains."""
_LEAST_SHARE = 0.02
"""Least load that a tyre's depth is computed for, over a quarter of the weight [1]: a wheel that
carries nothing sinks nowhere."""


@lru_cache(maxsize=64)
def _compile_model(robot: Robot, shape: WheelShape) -> mujoco.MjModel:
    """Return robot and ground without calibration, looks and sensors that nobody reads.

    Those cost time. Tyres and ground are contact pairs, so MuJoCo need not look for others.
    """
    spec = on_ground(robot, shape)
    looks = [geom for geom in spec.geoms if not geom.name.endswith(("_tire", "ground"))]
    unread = [sensor for sensor in spec.sensors if sensor.name not in _READ_SENSORS]
    for part in looks + unread:
        spec.delete(part)
    pair_with_ground(spec)
    for wheel in WHEELS:
        force = spec.add_sensor(name=f"force_{wheel}", intprm=_NET_FORCE)
        force.type = mujoco.mjtSensor.mjSENS_CONTACT
        force.objtype = force.reftype = mujoco.mjtObj.mjOBJ_GEOM
        force.objname = "ground"
        force.refname = f"{wheel}_tire"
    return spec.compile()


def on_ground(robot: Robot, shape: WheelShape) -> mujoco.MjSpec:
    """Return a robot with tyres of a shape on level ground, and motors without integral parts.

    Raises:
        ValueError: as `compose_robot`.
    """
    spec = compose_robot(robot)
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
    radius = robot.wheel_radius
    half = 0.5 * robot.wheel_width
    for wheel in WHEELS:
        tire = spec.geom(f"{wheel}_tire")
        tire.type = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
        tire.size = [radius, half, radius]
        if shape != "ellipsoid":
            tire.alt.type = mujoco.mjtOrientation.mjORIENTATION_ZAXIS
            tire.alt.zaxis = [0, 1, 0]
    return spec


def pair_with_ground(spec: mujoco.MjSpec) -> None:
    """Make contact pairs of ground and tyres, which touch nothing else then.

    A pair can have two tangential frictions.
    """
    for wheel in WHEELS:
        tire = spec.geom(f"{wheel}_tire")
        tire.contype = 0
        tire.conaffinity = 0
        spec.add_pair(geomname1="ground", geomname2=tire.name, condim=3)


FREE_DRIVE = Drive(torque_limit=math.inf)
"""Motors of the thesis without a limit: those of a model that is driven without a `Drive`."""


@mujoco_failures()
def robot_model(
    calibration: Calibration,
    terrain: Terrain = FLAT,
    settings: PhysicsSettings = SHIPPED,
    drive: Drive = FREE_DRIVE,
) -> mujoco.MjModel:
    """Return a compiled and calibrated model with the motors of `drive`; the caller may change it.

    Raises:
        ValueError: a calibration whose inertia no body can have.
    """
    compiled = _compile_model(calibration.robot, calibration.wheel_shape)
    model = mujoco.MjModel.__copy__(compiled)
    model.opt.gravity = terrain.gravity(GRAVITY)
    adjust_model(model, calibration, drive, settings)
    return model


def adjust_model(
    model: mujoco.MjModel,
    calibration: Calibration,
    drive: Drive,
    settings: PhysicsSettings = SHIPPED,
) -> None:
    """Set calibration, motors and solver on a compiled model of a robot and its ground, in place.

    Raises:
        ValueError: as `set_motors` and `set_calibration`.
    """
    set_calibration(model, calibration)
    set_motors(model, calibration, drive)
    apply_settings(model, settings, robot_parts(model).tires, calibration.friction_ratio)


def pressed_in(model: mujoco.MjModel, calibration: Calibration, prefix: str = "") -> FloatArray:
    """Return the (4,) depths of the tyres in the soft contact at rest on level ground [m].

    The contact point lies halfway, so the rolling radius is half of it less than the geom's.
    """
    contact = contact_settings(calibration.robot)
    shares = np.maximum(calibration.static_shares, 0.25 * _LEAST_SHARE)
    loads = shares * calibration.mass * GRAVITY
    points = _CONTACT_POINTS[calibration.wheel_shape]
    weights = model.body_invweight0[robot_parts(model, prefix).wheels, 0].tolist()
    depths = []
    for load, weight in zip(loads, weights, strict=True):
        depths.append(_resting_depth(load / points * weight, *contact))
    return np.array(depths)


def _resting_depth(give: float, solref: tuple[float, float], solimp: Impedance) -> float:
    """Return how deep a soft contact is pressed in at rest [m].

    A contact with the depth delta has an impedance d(delta), a curve of two power laws, and gives
    way by A (1 - d) / d for each newton, where A is its inverse mass (docs/physics.md, "Why the
    contact is soft"). With the load N

        N A (1 - d) / d = k d delta,  k = 1 / (d_max T)^2 for a damping ratio of one

    Args:
        give: N A [m/s2]: the load, times `body_invweight0` of the wheel.
        solref: time constant T [s] and damping ratio [1], as MuJoCo has them.
        solimp: impedance, as MuJoCo has it.
    """
    time, ratio = solref
    least, most, width, middle, power = solimp
    stiffness = 1.0 / (most * time * ratio) ** 2

    def impedance(depth: float) -> tuple[float, float]:
        """Return d(depth) [1] and its slope [1/m]."""
        x = min(depth / width, 1.0)
        if x == 1.0:
            return most, 0.0
        if x <= middle:
            slope = power * (x / middle) ** (power - 1.0)
            y = slope * x / power
        else:
            slope = power * ((1.0 - x) / (1.0 - middle)) ** (power - 1.0)
            y = 1.0 - slope * (1.0 - x) / power
        return least + y * (most - least), slope * (most - least) / width

    low = 0.0
    high = math.inf
    depth = 0.5 * width
    while True:  # Newton's method, where that leaves the bracket a bisection
        d, rise = impedance(depth)
        value = stiffness * d * depth - give * (1.0 - d) / d
        slope = stiffness * (d + rise * depth) + give * rise / d**2
        if value > 0.0:
            high = depth
        else:
            low = depth
        step = value / slope
        if abs(step) <= _CLOSE * depth:
            return depth - step
        if low < depth - step < high:
            depth -= step
        else:
            depth = min(0.5 * (low + high), 2.0 * depth)


def set_calibration(model: mujoco.MjModel, calibration: Calibration, prefix: str = "") -> None:
    """Set the numbers of `calibration` on a compiled model, in place; `set_motors` sets its motors.

    `prefix` stands in front of the robot's names in a larger model.

    Raises:
        ValueError: an inertia that no rigid body has; the model is untouched then.
    """
    robot = calibration.robot
    parts = robot_parts(model, prefix)
    # first, for it may raise
    inertia = calibration.base_inertia
    model.body_mass[parts.base] = calibration.base_mass
    model.body_inertia[parts.base] = inertia
    model.body_ipos[parts.base] = calibration.com
    model.body_pos[parts.wheels] = calibration.wheel_places
    model.body_mass[parts.wheels] = robot.wheel_mass
    model.body_inertia[parts.wheels] = robot.wheel_moments
    model.dof_armature[parts.dofs] = calibration.armature
    model.opt.timestep = calibration.timestep
    # the inverse masses, on which the depths of the tyres depend
    mujoco.mj_setConst(model, mujoco.MjData(model))
    _set_tires(model, calibration, prefix)
    solref, solimp = contact_settings(robot)
    for motor in robot.motors:
        model.tendon_solref_fri[model.tendon(f"{prefix}{motor}").id] = solref  # of its dry friction
    for side in SIDES:
        belt = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_EQUALITY, f"{prefix}belt_{side}")
        if belt >= 0:
            model.eq_solref[belt] = _BELT_TIME * math.sqrt(robot.wheel_radius / GRAVITY), 1.0
    if model.npair:
        # A capsule's contact frame on a plane: first tangent across the rolling direction, second
        # along it.
        model.pair_friction[:, 0] = calibration.friction * calibration.friction_ratio
        model.pair_friction[:, 1] = calibration.friction
        model.pair_solref[:] = solref
        model.pair_solimp[:] = solimp


def _set_tires(model: mujoco.MjModel, calibration: Calibration, prefix: str) -> None:
    """Set size, friction and contact of the tyres, and the sites of their load sensors."""
    robot = calibration.robot
    parts = robot_parts(model, prefix)
    tires = parts.tires
    half_width = 0.5 * robot.wheel_width
    half = half_width
    if calibration.wheel_shape == "capsule":
        half = calibration.capsule_half_width
    radii = calibration.radii + 0.5 * pressed_in(model, calibration, prefix)
    # third half-axis and bounding radius, which MuJoCo computes at compilation only
    third = np.zeros(len(tires))
    bounds = radii + half
    if calibration.wheel_shape == "ellipsoid":
        third = radii
        bounds = np.maximum(radii, half)
    model.geom_size[tires] = np.column_stack([radii, np.full(len(tires), half), third])
    model.geom_rbound[tires] = bounds
    model.geom_aabb[tires, 3:] = bounds[:, None]
    model.geom_friction[tires, 0] = calibration.friction
    model.geom_solref[tires], model.geom_solimp[tires] = contact_settings(robot)
    model.site_size[parts.sites] = 1.2 * np.hypot(radii, half_width)[:, None]
