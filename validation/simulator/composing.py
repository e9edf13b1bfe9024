"""A robot's file -> MuJoCo's `MjSpec`: composed of its numbers, or read from a hand-made MJCF."""

# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import mujoco
from mujoco import mjtGeom, mjtObj, mjtSensor

from validation.files import reading
from validation.simulator import foreign
from validation.simulator.description import GRAVITY, SIDES, WHEELS, Robot, models_folder
from validation.simulator.motors import add_integral_parts
from validation.simulator.physics import Impedance

VISUAL_GROUP = 2
"""Geoms of this group are looks; contact shapes are in another."""
_SPOKES = 3
"""Spokes drawn on a wheel: one sees it turn."""
IMPEDANCE = (0.1, 0.95)
"""Impedance of the soft contact at the surface and at full depth [1]. A hard one would let skidding
wheels hop, and the robot would turn at a rate that depends on the time step (docs/physics.md)."""
CONTACT_DEPTH = 0.030285
"""Depth at which the contact reaches its full impedance, over the radius of the wheel [1]; 5 mm for
a Husky."""
CONTACT_TIME = 0.15417
"""Time constant of the contact over sqrt(wheel radius / g) [1]; 20 ms for a Husky. With depths that
grow as the radius and times that grow as its root, robots of one shape move in the same way
whatever their size (Froude's similarity)."""
_HULL = [0.98, 0.76, 0.05, 1.0]
_DARK = [0.13, 0.13, 0.14, 1.0]
_RUBBER = [0.11, 0.11, 0.12, 1.0]
_METAL = [0.6, 0.61, 0.63, 1.0]


def contact_settings(robot: Robot) -> tuple[tuple[float, float], Impedance]:
    """Return `solref` and `solimp` of the tyres' contact, which follow from the wheels' radius."""
    radius = robot.wheel_radius
    solref = (CONTACT_TIME * math.sqrt(radius / GRAVITY), 1.0)
    solimp = (*IMPEDANCE, CONTACT_DEPTH * radius, 0.5, 2.0)
    return solref, solimp


def compose_robot(robot: Robot) -> mujoco.MjSpec:
    """Return the parts of a robot, without ground.

    They can be changed, and `compile()` makes a model of them. `set_calibration` and `set_motors`
    set the numbers that a profile may change.

    Raises:
        ValueError: no rigid body has the moments of inertia, or a hand-made MJCF cannot be read or
            lacks a part that the programs need; the message names it.
    """
    for key, moments in (("inertia", robot.inertia), ("wheel_inertia", robot.wheel_moments)):
        if 2.0 * max(moments) > sum(moments):
            raise ValueError(
                f"mass.{key} {list(getattr(robot, key))} kg m2 is that of no rigid body: "
                "about no axis can it be more than about the two others together"
            )
    if robot.mjcf:
        return _hand_made(robot)
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = False
    _set_options(spec.option, robot.timestep)
    base = _add_body(
        spec.worldbody, "base", [0, 0, robot.base_height], robot.base_mass, robot.com, robot.inertia
    )
    base.add_freejoint(name="root")
    mark = {"size": [0.01, 0.005, 0.005], "group": 4}
    base.add_site(name="reference", pos=[0, 0, -robot.base_height], **mark)
    base.add_site(name="imu", pos=robot.imu, **mark)
    _add_hull(base, robot)
    for wheel, place in zip(WHEELS, robot.wheel_places.tolist(), strict=True):
        _add_wheel(base, robot, wheel, place)
    if robot.link == "belt":
        _add_belts(spec)
    for motor, wheels in robot.motors.items():
        _add_motor(spec, motor, wheels)
    add_integral_parts(spec, robot)
    _add_sensors(spec)
    return spec


def _set_options(option: Any, timestep: float) -> None:
    """Set the physics of a composed robot; models/husky.xml has the same."""
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 100
    option.iterations = 50
    option.tolerance = 1e-10
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD


def _add_belts(spec: mujoco.MjSpec) -> None:
    """Add the constraints by which the wheels of a side turn together."""
    for side in SIDES:
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            name=f"belt_{side}",
            name1=f"front_{side}_wheel",
            name2=f"rear_{side}_wheel",
            solref=[0.004, 1],
            solimp=[0.99, 0.999, 0.001, 0.5, 2],
        )


def _add_motor(spec: mujoco.MjSpec, motor: str, wheels: tuple[str, ...]) -> None:
    """Add a velocity servo on the mean angle of a motor's wheels."""
    tendon = spec.add_tendon(name=motor)
    for wheel in wheels:
        tendon.wrap_joint(f"{wheel}_wheel", 1.0 / len(wheels))
    servo = spec.add_actuator(name=f"{motor}_motor", target=motor, forcerange=[-1.0, 1.0])
    servo.trntype = mujoco.mjtTrn.mjTRN_TENDON
    servo.set_to_velocity(kv=1.0)


def _hand_made(robot: Robot) -> mujoco.MjSpec:
    """Return the robot's hand-made MJCF, which has all the names that the programs look for."""
    path = models_folder() / robot.mjcf
    try:
        text = reading.read_text(path, foreign.MOST_BYTES)
        # those that come with the package need no trial in a child process, and bring no files
        files: Mapping[str, bytes] = {}
        if path.parent != models_folder():
            text, files = foreign.try_compiling(text, path.parent)
        spec = mujoco.MjSpec.from_string(text, include=files, assets=files)
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: this is no MJCF that can be read ({reason})") from error
    for kind, name in _required_parts(robot):
        if getattr(spec, kind)(name) is None:
            raise ValueError(
                f"{path}: there is no {kind} '{name}'; models/husky.xml shows all the names"
            )
    x, y, _ = spec.body("front_left").pos
    if not (math.isclose(2.0 * x, robot.wheelbase) and math.isclose(2.0 * y, robot.track)):
        raise ValueError(
            f"{path} has a wheelbase of {2.0 * x:g} m and a track of {2.0 * y:g} m, the robot's "
            f"file {robot.wheelbase:g} and {robot.track:g} m; without the line 'mjcf' the model is "
            "made of the file's numbers"
        )
    add_integral_parts(spec, robot)
    return spec


def _required_parts(robot: Robot) -> list[tuple[str, str]]:
    """Return kinds and names of the parts that the programs look for."""
    parts = [("body", "base"), ("joint", "root"), ("site", "reference"), ("site", "imu")]
    for wheel in WHEELS:
        parts += [("body", wheel), ("joint", f"{wheel}_wheel")]
        parts += [("geom", f"{wheel}_tire"), ("site", f"{wheel}_load")]
        parts += [("sensor", f"load_{wheel}"), ("sensor", f"torque_{wheel}")]
    for motor in robot.motors:
        parts += [("tendon", motor), ("actuator", f"{motor}_motor")]
    return parts


def _add_body(parent: Any, name: str, at: Any, mass: float, com: Any, moments: Any) -> Any:
    return parent.add_body(
        name=name, pos=at, mass=mass, ipos=com, inertia=moments, explicitinertial=True
    )


def _look_of(kind: mjtGeom, size: list[float], colour: list[float], **more: Any) -> dict[str, Any]:
    """Return the properties of a geom that is seen and touches nothing."""
    massless = {"group": VISUAL_GROUP, "contype": 0, "conaffinity": 0, "mass": 0.0}
    three_sizes = [*size, 0.0, 0.0][:3]
    return {"type": kind, "size": three_sizes, "rgba": colour, **massless, **more}


def _add_hull(base: Any, robot: Robot) -> None:
    """Add the looks of the body: a hull between the tyres, and a nose in front."""
    length, width, height = robot.body_size
    x, y, z = robot.body_centre
    half = [0.5 * length, 0.5 * width, 0.5 * height]
    nose = [0.06 * length, 0.25 * width, 0.06 * height]
    base.add_geom(name="hull", pos=[x, y, z], **_look_of(mjtGeom.mjGEOM_BOX, half, _HULL))
    ahead = [x + 0.85 * half[0], y, z + half[2] + nose[2]]
    base.add_geom(name="nose", pos=ahead, **_look_of(mjtGeom.mjGEOM_BOX, nose, _METAL))


def _add_wheel(base: Any, robot: Robot, wheel: str, place: list[float]) -> None:
    """Add a wheel: its joint, the tyre that touches the ground, the site of its load, its looks."""
    radius = robot.wheel_radius
    half = 0.5 * robot.wheel_width
    solref, solimp = contact_settings(robot)
    body = _add_body(base, wheel, place, robot.wheel_mass, [0, 0, 0], robot.wheel_moments)
    body.add_joint(name=f"{wheel}_wheel", axis=[0, 1, 0], armature=robot.armature)
    body.add_geom(
        name=f"{wheel}_tire",
        type=mjtGeom.mjGEOM_ELLIPSOID,
        size=[radius, half, radius],
        contype=1,
        conaffinity=1,
        condim=3,
        priority=1,
        group=3,
        rgba=[0.2, 0.6, 0.9, 0.4],
        friction=[robot.friction, 0.005, 0.0001],
        mass=0.0,
        solref=solref,
        solimp=solimp,
    )
    # a touch sensor sums the forces at points inside its site, which encloses the tyre
    reach = 1.2 * math.hypot(radius, half)
    body.add_site(name=f"{wheel}_load", size=[reach] * 3, group=4)
    drum = mjtGeom.mjGEOM_CYLINDER
    rubber = _look_of(drum, [radius, half], _RUBBER, zaxis=[0, 1, 0])
    hub = _look_of(drum, [0.5 * radius, 1.01 * half], _METAL, zaxis=[0, 1, 0])
    spoke = _look_of(mjtGeom.mjGEOM_BOX, [0.45 * radius, 1.03 * half, 0.06 * radius], _DARK)
    body.add_geom(name=f"{wheel}_rubber", **rubber)
    body.add_geom(name=f"{wheel}_hub", **hub)
    for k in range(_SPOKES):
        body.add_geom(name=f"{wheel}_spoke{k}", euler=[0, math.pi * k / _SPOKES, 0], **spoke)


def _add_sensors(spec: mujoco.MjSpec) -> None:
    """Add the IMU, the wheels' loads and torques, and the angular acceleration of the body."""

    def add(name: str, kind: mjtSensor, part: str, part_kind: mjtObj = mjtObj.mjOBJ_SITE) -> None:
        spec.add_sensor(name=name, type=kind, objtype=part_kind, objname=part)

    add("imu_gyro", mjtSensor.mjSENS_GYRO, "imu")
    add("imu_accelerometer", mjtSensor.mjSENS_ACCELEROMETER, "imu")
    for wheel in WHEELS:
        add(f"load_{wheel}", mjtSensor.mjSENS_TOUCH, f"{wheel}_load")
    torque = mjtSensor.mjSENS_JOINTACTFRC
    for wheel in WHEELS:
        add(f"torque_{wheel}", torque, f"{wheel}_wheel", mjtObj.mjOBJ_JOINT)
    add("angular_acceleration", mjtSensor.mjSENS_FRAMEANGACC, "reference")
