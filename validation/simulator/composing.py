"""A robot's file -> MJCF: `dm_control.mjcf` composes it, with the names of models/husky.xml, or reads a hand-made one."""

from __future__ import annotations

import math
import warnings
from typing import Any

from validation.simulator.description import SIDES, WHEELS, Robot

VISUAL_GROUP = 2
"""Geoms of this group are looks; contact shapes are in another."""
SPOKES, TREADS = 3, 12
"""Spokes and tread blocks drawn on a wheel: one sees it turn."""
SHAFT_SHARE = 1e-8
"""Mass of the body that carries a virtual shaft over the robot's, and its inertia over mass times wheel radius squared [1]:
next to nothing."""
_HULL, _DARK, _RUBBER, _TREAD, _METAL = (
    [0.98, 0.76, 0.05, 1.0], [0.13, 0.13, 0.14, 1.0], [0.11, 0.11, 0.12, 1.0], [0.2, 0.2, 0.21, 1.0], [0.6, 0.61, 0.63, 1.0],
)  # fmt: skip


def compose_robot(robot: Robot) -> Any:
    """Return the MJCF tree of a robot, without ground.

    Raises:
        ValueError: a hand-made MJCF cannot be read, or lacks a part that the programs need, or no rigid body has the moments
            of inertia; the message names it.
    """
    mjcf = _dm_control()
    path = robot.mjcf_path
    if path is None:
        return _composed(mjcf, robot)
    try:
        root = mjcf.from_path(str(path))
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: this is no MJCF that can be read ({' '.join(str(error).split())})") from error
    for kind, name in _needed(robot):
        if root.find(kind, name) is None:
            raise ValueError(f"{path}: there is no {kind} '{name}'; models/husky.xml shows all the names")
    return root


def _dm_control() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control's import warns where there is no screen; nothing is drawn here
        from dm_control import mjcf
    return mjcf


def _needed(robot: Robot) -> list[tuple[str, str]]:
    """Return kind and name of every part that the programs look for."""
    parts = [("body", "base"), ("joint", "root"), ("site", "reference"), ("site", "imu")]
    for wheel in WHEELS:
        parts += [("body", wheel), ("joint", f"{wheel}_wheel"), ("geom", f"{wheel}_tire"), ("site", f"{wheel}_load")]
        parts += [("sensor", f"load_{wheel}"), ("sensor", f"torque_{wheel}")]
    for motor in robot.motors:
        parts += [("tendon", motor), ("actuator", f"{motor}_motor")]
    return parts


def _composed(mjcf: Any, robot: Robot) -> Any:
    """Return the tree that is built from the robot's numbers; `calibrate` and `set_motors` set what a profile may change."""
    g, m = robot.geometry, robot.masses
    across, spin = m.wheel_inertia
    for key, moments in (("inertia", m.inertia), ("wheel_inertia", (across, spin, across))):
        if 2.0 * max(moments) > sum(moments):
            raise ValueError(
                f"mass.{key} {list(getattr(m, key))} kg m2 is that of no rigid body: "
                "about no axis can it be more than about the two others together"
            )
    root = mjcf.RootElement(model=robot.name)
    root.compiler.set_attributes(angle="radian", autolimits=True, inertiafromgeom=False)
    root.option.set_attributes(
        timestep=robot.simulation.timestep, integrator="implicitfast", cone="elliptic", impratio=100, iterations=50,
        tolerance=1e-10,
    )  # fmt: skip
    root.option.flag.multiccd = "disable"
    base = root.worldbody.add("body", name="base", pos=[0, 0, g.base_height])
    base.add("freejoint", name="root")
    base.add("inertial", pos=list(m.com), mass=robot.base_mass, diaginertia=list(m.inertia))
    base.add("site", name="reference", pos=[0, 0, -g.base_height], size=[0.01], group=4)
    base.add("site", name="imu", pos=list(g.imu), size=[0.01], group=4)
    _add_hull(base, robot)
    for wheel in WHEELS:
        _add_wheel(base, robot, wheel)
    for side in SIDES if g.link == "belt" else ():
        root.equality.add(
            "joint", name=f"belt_{side}", joint1=f"front_{side}_wheel", joint2=f"rear_{side}_wheel",
            solref=[0.004, 1], solimp=[0.99, 0.999, 0.001, 0.5, 2],
        )  # fmt: skip
    for motor, wheels in robot.motors.items():
        tendon = root.tendon.add("fixed", name=motor)
        for wheel in wheels:
            tendon.add("joint", joint=f"{wheel}_wheel", coef=1.0 / len(wheels))
        root.actuator.add("velocity", name=f"{motor}_motor", tendon=tendon, kv=1.0, forcerange=[-1.0, 1.0])
    _add_sensors(root)
    return root


def _look(kind: str, size: list[float], colour: list[float], **more: Any) -> dict[str, Any]:
    usual = {"group": VISUAL_GROUP, "contype": 0, "conaffinity": 0, "mass": 0.0}
    return {"type": kind, "size": size, "rgba": colour, **usual, **more}


def _add_hull(base: Any, robot: Robot) -> None:
    """Add the looks of the body: a hull between the tyres, a plate on it, a nose in front, and the axles."""
    g = robot.geometry
    (length, width, height), (x, y, z) = g.body_size, g.body_centre
    half = [0.5 * length, 0.5 * width, 0.5 * height]
    base.add("geom", name="hull", pos=[x, y, z], **_look("box", half, _HULL))
    plate, nose = [0.96 * half[0], 0.96 * half[1], 0.03 * height], [0.06 * length, 0.25 * width, 0.06 * height]
    top = z + half[2]
    base.add("geom", name="plate", pos=[x, y, top + plate[2]], **_look("box", plate, _DARK))
    ahead = [x + 0.85 * half[0], y, top + 2.0 * plate[2] + nose[2]]
    base.add("geom", name="nose", pos=ahead, **_look("box", nose, _METAL))
    for name, sign in (("front", 1.0), ("rear", -1.0)):
        axle = 0.5 * sign * g.wheelbase
        ends = [axle, -0.5 * g.track, g.axle_height, axle, 0.5 * g.track, g.axle_height]
        look = _look("cylinder", [0.1 * g.wheel_radius], _METAL)
        base.add("geom", name=f"axle_{name}", fromto=ends, **look)


def _add_wheel(base: Any, robot: Robot, wheel: str) -> None:
    g, m = robot.geometry, robot.masses
    x = 0.5 * g.wheelbase * (1.0 if wheel.startswith("front") else -1.0)
    y = 0.5 * g.track * (1.0 if wheel.endswith("left") else -1.0)
    radius, half = g.wheel_radius, 0.5 * g.wheel_width
    body = base.add("body", name=wheel, pos=[x, y, g.axle_height])
    body.add("joint", name=f"{wheel}_wheel", type="hinge", axis=[0, 1, 0], armature=robot.simulation.armature)
    across, spin = m.wheel_inertia
    body.add("inertial", pos=[0, 0, 0], mass=m.wheel, diaginertia=[across, spin, across])
    body.add(
        "geom", name=f"{wheel}_tire", type="ellipsoid", size=[radius, half, radius], contype=1, conaffinity=1, condim=3,
        priority=1, group=3, rgba=[0.2, 0.6, 0.9, 0.4], friction=[robot.simulation.friction, 0.005, 0.0001], mass=0.0,
    )  # fmt: skip
    body.add("site", name=f"{wheel}_load", type="sphere", size=[1.2 * math.hypot(radius, half)], group=4)
    axle = {"zaxis": [0, 1, 0]}
    body.add("geom", name=f"{wheel}_rubber", **_look("cylinder", [radius, half], _RUBBER, **axle))
    body.add("geom", name=f"{wheel}_hub", **_look("cylinder", [0.5 * radius, 1.01 * half], _METAL, **axle))
    for k in range(SPOKES):
        spoke = _look("box", [0.45 * radius, 1.03 * half, 0.06 * radius], _DARK)
        body.add("geom", name=f"{wheel}_spoke{k}", euler=[0, math.pi * k / SPOKES, 0], **spoke)
    for k in range(TREADS):
        angle = 2.0 * math.pi * k / TREADS
        place = [0.99 * radius * math.sin(angle), 0, 0.99 * radius * math.cos(angle)]
        tread = _look("box", [0.025 * radius, 1.006 * half, 0.073 * radius], _TREAD)
        body.add("geom", name=f"{wheel}_tread{k}", pos=place, euler=[0, 0.5 * math.pi + angle, 0], **tread)


def _add_sensors(root: Any) -> None:
    root.sensor.add("gyro", name="imu_gyro", site="imu")
    root.sensor.add("accelerometer", name="imu_accelerometer", site="imu")
    for wheel in WHEELS:
        root.sensor.add("touch", name=f"load_{wheel}", site=f"{wheel}_load")
    for wheel in WHEELS:
        root.sensor.add("jointactuatorfrc", name=f"torque_{wheel}", joint=f"{wheel}_wheel")
    root.sensor.add("frameangacc", name="angular_acceleration", objtype="site", objname="reference")


def add_integral_parts(root: Any, robot: Robot) -> None:
    """Add what MuJoCo needs for a leaky integral in the speed loop of each motor to the robot's MJCF tree.

    The integral is the torsion of a spring between the mean angle of a motor's wheels and a virtual shaft, which a servo of
    limited torque turns at the wanted rate: the lasting torque of the spring slows the shaft down, so the integral leaks.
    """
    base, mass = root.find("body", "base"), SHAFT_SHARE * robot.masses.total
    inertia = mass * robot.geometry.wheel_radius**2
    for motor in robot.motors:
        shaft = base.add("body", name=f"{motor}_shaft")
        shaft.add("inertial", pos=[0, 0, 0], mass=mass, diaginertia=[inertia] * 3)
        joint = shaft.add("joint", name=f"{motor}_shaft", type="hinge", axis=[0, 1, 0], armature=1.0)
        root.actuator.add("velocity", name=f"{motor}_shaft", joint=joint, kv=1.0)
    for motor, wheels in robot.motors.items():
        spring = root.tendon.add("fixed", name=f"{motor}_spring", springlength=[0.0, 0.0])
        for wheel in wheels:
            spring.add("joint", joint=f"{wheel}_wheel", coef=-1.0 / len(wheels))
        spring.add("joint", joint=f"{motor}_shaft", coef=1.0)
        root.actuator.add("general", name=f"{motor}_spring", tendon=spring, biastype="affine", gainprm=[0.0])
