"""Diseases and sound variations of robots' files, invented without a look at what judges them.

A table of diseases is put into sound models in URDF, SDF and MJCF, and a table of sound variations
beside it; `robots check` says what it finds. `python -m tests.test_robot_diseases` prints which
were named, left open, passed over or blamed wrongly; `--only NAME` takes some, `--seed N` others.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import re
import runpy
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pytest

from tests.blind_robots import (
    CORNERS,
    SPECS,
    Spec,
    words,
    write_mjcf,
    write_sdf,
    write_urdf,
)
from tests.test_blind_log_faults import (
    BLAMED,
    FINE,
    NAMED,
    OPEN,
    SILENT,
    WRONG,
    Verdict,
    print_table,
    share_of,
)

Change = Callable[[Element, Spec], None]
"""Makes a description ill, in place."""
ENDS = {"urdf": "urdf", "sdf": "sdf", "mjcf": "xml"}
WRITERS = {"urdf": write_urdf, "sdf": write_sdf, "mjcf": write_mjcf}
GAZEBO = ("urdf", "sdf")
ALL = ("urdf", "sdf", "mjcf")
MJCF = ("mjcf",)


@dataclass(frozen=True)
class Disease:
    """What ails a model, and how it may be named."""

    name: str
    formats: tuple[str, ...]
    change: Change
    kinds: tuple[str, ...]
    """Documented kinds that are a right name."""
    says: str
    """Words of a right cause or change, whatever its kind, or of a refusal: a pattern."""


# ------------------------------------------------------------------------ changes to XML


def find_all(root: Element, tag: str, **attributes: str) -> list[Element]:
    """Elements by tag and attributes.

    Returns:
        Those whose attributes match these patterns.
    """
    return [
        item
        for item in root.iter(tag)
        if all(re.search(want, item.get(name, "")) for name, want in attributes.items())
    ]


def put(root: Element, _: Spec, *, tag: str, which: str = "", **values: str) -> None:
    for item in find_all(root, tag, **({"name": which} if which else {})):
        for name, value in values.items():
            item.set(name, value)


def put_text(root: Element, _: Spec, *, tag: str, value: str) -> None:
    for item in list(root.iter(tag)):
        item.text = value


def is_mjcf(root: Element) -> bool:
    return root.tag == "mujoco"


def base_of(root: Element) -> Element:
    """The body of the robot.

    Returns:
        Its element.
    """
    tag = "body" if is_mjcf(root) else "link"
    return next(item for item in root.iter(tag) if item.get("name") in ("base", "base_link"))


def inertial_of(root: Element, name: str) -> Element:
    """The inertia of one link.

    Returns:
        Its element.
    """
    tag = "body" if is_mjcf(root) else "link"
    link = next(item for item in root.iter(tag) if item.get("name", "").startswith(name))
    found = link.find("inertial")
    assert found is not None
    return found


def move_weight(root: Element, spec: Spec, *, x: float = 0, y: float = 0, z: float = 0) -> None:
    """By shares of half a wheelbase, of half a track, and by metres up."""
    place = x * spec.wheelbase / 2, y * spec.track / 2, spec.high + z
    inertial = inertial_of(root, "base")
    origin, pose = inertial.find("origin"), inertial.find("pose")
    if origin is not None:
        origin.set("xyz", words(*place))
    elif pose is not None:
        pose.text = words(*place, 0, 0, 0)
    else:
        inertial.set("pos", words(*place))


def weigh(root: Element, _: Spec, *, name: str, mass: float, inertia: float = 1.0) -> None:
    """Multiply a mass, and the moments of inertia."""
    for item in {inertial_of(root, name)}:
        if is_mjcf(root):
            item.set("mass", words(float(item.get("mass", "0")) * mass))
            old = [float(part) for part in item.get("diaginertia", "").split()]
            item.set("diaginertia", words(*(part * inertia for part in old)))
            continue
        for child in item.iter():
            if child.tag == "mass":
                scale_value(child, mass)
            elif child.tag == "inertia":
                for key in ("ixx", "iyy", "izz"):
                    if key in child.attrib:
                        child.set(key, words(float(child.attrib[key]) * inertia))
            elif child.tag in ("ixx", "iyy", "izz"):
                child.text = words(float(child.text or 0) * inertia)


def scale_value(item: Element, by: float) -> None:
    if "value" in item.attrib:
        item.set("value", words(float(item.attrib["value"]) * by))
    else:
        item.text = words(float(item.text or 0) * by)


def weigh_wheels(root: Element, spec: Spec, *, mass: float, inertia: float) -> None:
    for corner in CORNERS:
        weigh(root, spec, name=corner, mass=mass, inertia=inertia)


def heavy_wheels(root: Element, spec: Spec) -> None:
    """Nearly all of the mass is in the wheels."""
    weigh(root, spec, name="base", mass=0.06, inertia=0.06)
    weigh_wheels(root, spec, mass=0.9 * spec.mass / spec.wheel_mass / 4, inertia=6.0)


def move_wheels(root: Element, spec: Spec, *, corners: tuple[str, ...], up: float) -> None:
    """Lift axles, by shares of the radius."""
    for corner in corners:
        x, y, _ = spec.place(corner)
        place = words(x, y, up * spec.radius)
        for joint in find_all(root, "joint", name=f"^{corner}"):
            origin = joint.find("origin")
            if origin is not None:
                origin.set("xyz", place)
        for link in [
            *find_all(root, "link", name=f"^{corner}"),
            *find_all(root, "body", name=f"^{corner}"),
        ]:
            pose = link.find("pose")
            if pose is not None:
                pose.text = place + " 0 0 0"
            elif is_mjcf(root):
                link.set("pos", place)


def resize_wheel(root: Element, spec: Spec, *, corner: str, by: float) -> None:
    radius = words(spec.radius * by)
    if is_mjcf(root):
        tyre = find_all(root, "geom", name=f"^{corner}_tyre")[0]
        tyre.set("size", words(spec.radius * by, spec.radius * by, spec.width / 2))
        return
    link = find_all(root, "link", name=f"^{corner}")[0]
    for cylinder in link.iter("cylinder"):
        size = cylinder.find("radius")
        if size is None:
            cylinder.set("radius", radius)
        else:
            size.text = radius


def turn_axes(root: Element, _: Spec, *, corners: tuple[str, ...], axis: str) -> None:
    for corner in corners:
        for joint in find_all(root, "joint", name=f"^{corner}"):
            item = joint.find("axis")
            if item is None:
                joint.set("axis", axis)
            elif "xyz" in item.attrib:
                item.set("xyz", axis)
            else:
                put_text(item, _, tag="xyz", value=axis)


def swap_names(root: Element, _: Spec) -> None:
    """Left joints and wheels are called right."""
    for item in root.iter():
        for key in ("name", "link", "reference", "joint"):
            if key in item.attrib:
                item.set(key, exchange(item.attrib[key]))
        if item.tag in ("child",) and item.text:
            item.text = exchange(item.text)


def exchange(text: str) -> str:
    """Left for right.

    Returns:
        The text with both exchanged.
    """
    sides = {"left": "right", "right": "left"}
    return re.sub("left|right", lambda found: sides[found.group()], text)


def in_millimetres(root: Element, spec: Spec) -> None:
    """Lengths in mm, as drawing programs export them."""
    for item in root.iter():
        for key in ("xyz", "size", "radius", "length", "pos"):
            if key in item.attrib and item.tag != "axis":
                numbers = [float(part) * 1000 for part in item.attrib[key].split()]
                item.set(key, words(*numbers))
        if item.tag in ("radius", "length", "size", "pose") and item.text:
            numbers = [float(part) for part in item.text.split()]
            item.text = words(*(part * 1000 for part in numbers[:3]), *numbers[3:])


def limit_joints(
    root: Element,
    spec: Spec,
    *,
    effort: float | None = None,
    velocity: float | None = None,
    share: float | None = None,
) -> None:
    """Effort and velocity of the joints' limits; `share` is of the torque that a turn takes."""
    effort = spec.torque * share if share is not None else effort
    for limit in root.iter("limit"):
        for tag, value in (("effort", effort), ("velocity", velocity)):
            if value is None:
                continue
            child = limit.find(tag)
            if child is None:
                limit.set(tag, words(value))
            else:
                child.text = words(value)


def close_joints(root: Element, _: Spec) -> None:
    """Wheels may turn by half a radian."""
    for joint in root.iter("joint"):
        joint.set("type", "revolute")
        for limit in joint.iter("limit"):
            if limit.find("lower") is None:
                limit.attrib.update(lower="-0.5", upper="0.5")
            else:
                put_text(limit, _, tag="lower", value="-0.5")
                put_text(limit, _, tag="upper", value="0.5")


def add_dynamics(root: Element, spec: Spec, *, damping: float = 0.0, friction: float = 0.0) -> None:
    """Of axles: damping in shares of the torque at 1 rad/s, friction in shares of it."""
    values = {"damping": words(damping * spec.torque), "friction": words(friction * spec.torque)}
    for joint in root.iter("joint"):
        axis = joint.find("axis")
        assert axis is not None
        if "xyz" in axis.attrib:
            SubElement(joint, "dynamics", values)
        else:
            dynamics = SubElement(axis, "dynamics")
            for tag, value in values.items():
                SubElement(dynamics, tag).text = value


def put_friction(root: Element, _: Spec, *, mu1: str, mu2: str, side: str = "") -> None:
    for item in root.iter():
        if item.tag == "gazebo" and side in item.get("reference", ""):
            for tag, value in (("mu1", mu1), ("mu2", mu2)):
                put_text(item, _, tag=tag, value=value)
        if item.tag == "link" and side in item.get("name", ""):
            for tag, value in (("mu", mu1), ("mu2", mu2)):
                put_text(item, _, tag=tag, value=value)


def add_surface(root: Element, _: Spec, **values: str) -> None:
    """Gazebo's numbers of a contact, such as fdir1 and slip1."""
    for item in root.iter():
        if (item.tag == "gazebo" and item.get("reference")) or (
            item.tag == "ode" and item.find("mu") is not None
        ):
            for tag, value in values.items():
                SubElement(item, tag).text = value


def soften(root: Element, spec: Spec) -> None:
    """Contacts give way by half a radius."""
    value = words(spec.total * 9.81 / 4 / (0.5 * spec.radius))
    put_text(root, spec, tag="kp", value=value)


def flag_model(root: Element, _: Spec, *, tag: str, value: str, link: bool) -> None:
    """A flag of an SDF's model or link, or of a URDF's <gazebo>."""
    if root.tag == "robot":
        reference = {"reference": "base_link"} if link else {}
        SubElement(SubElement(root, "gazebo", reference), tag).text = value
    elif link:
        SubElement(base_of(root), tag).text = value
    else:
        model = root.find("model")
        assert model is not None
        SubElement(model, tag).text = value


def all_links(root: Element, _: Spec, *, tag: str, value: str) -> None:
    for link in list(root.iter("link")):
        if root.tag == "robot":
            reference = {"reference": link.get("name", "")}
            SubElement(SubElement(root, "gazebo", reference), tag).text = value
        else:
            SubElement(link, tag).text = value


def change_plugin(root: Element, _: Spec, *, joints: Callable[[str, str], str | None]) -> None:
    """Give the plugin other joints: of a side and a joint's name, the new one or none."""
    plugin = next(root.iter("plugin"))
    for side in ("left", "right"):
        for item in plugin.findall(f"{side}_joint"):
            name = joints(side, item.text or "")
            if name is None:
                plugin.remove(item)
            else:
                item.text = name


def cross(side: str, name: str) -> str:
    """The rear joints of the sides change places.

    Returns:
        The new name.
    """
    return exchange(name) if name.startswith("rear") else name


def scale_plugin(root: Element, _: Spec, *, tag: str, by: float) -> None:
    for item in next(root.iter("plugin")).iter(tag):
        item.text = words(float(item.text or 0) * by)


def add_torque(root: Element, spec: Spec) -> None:
    """Gazebo classic's plugin, with a tenth of the torque that a turn takes."""
    ros_1_plugin(root, spec)
    put_text(root, spec, tag="torque", value=words(0.1 * spec.torque))


def move_hull(root: Element, spec: Spec) -> None:
    """The hull hangs into the ground."""
    low = -spec.radius
    for item in base_of(root).iter("collision"):
        origin, pose = item.find("origin"), item.find("pose")
        if origin is not None:
            origin.set("xyz", words(0, 0, low))
        if pose is not None:
            pose.text = words(0, 0, low, 0, 0, 0)
    if is_mjcf(root):
        hull = {"pos": words(0, 0, low), "contype": "1", "conaffinity": "1"}
        put(root, spec, tag="geom", which="^hull", **hull)


def twist_inertia(root: Element, spec: Spec) -> None:
    """A wheel's moments are what no body has."""
    for corner in CORNERS:
        for item in inertial_of(root, corner).iter():
            big = words(12 * spec.wheel_mass * spec.radius**2)
            if item.tag == "inertia" and "ixx" in item.attrib:
                item.set("ixx", big)
            if item.tag == "ixx":
                item.text = big


def drop_inertial(root: Element, _: Spec) -> None:
    base = base_of(root)
    base.remove(inertial_of(root, "base"))


def toe(root: Element, spec: Spec, *, angle: float) -> None:
    """The front wheels point inwards."""
    for corner, side in (("front_left", -1), ("front_right", 1)):
        turned = words(0, 0, side * angle)
        for item in find_all(root, "body", name=f"^{corner}"):
            item.set("euler", words(0, 0, math.degrees(side * angle)))
        for item in find_all(root, "joint", name=f"^{corner}"):
            origin = item.find("origin")
            if origin is not None:
                origin.set("rpy", turned)
        for item in find_all(root, "link", name=f"^{corner}"):
            pose = item.find("pose")
            if pose is not None:
                pose.text = words(*spec.place(corner)) + f" {turned}"


# ------------------------------------------------------------------- changes to an MJCF


def hinge(
    root: Element, spec: Spec, *, which: str = "hinge$", share: bool = True, **values: float
) -> None:
    """Attributes of hinges, in shares of the torque that a turn takes."""
    for joint in find_all(root, "joint", name=which):
        for name, value in values.items():
            joint.set(name, words(value * (spec.torque if share else 1.0)))


def servo(
    root: Element, spec: Spec, *, which: str = "servo$", by: float = 1.0, **values: str
) -> None:
    for item in find_all(root, "velocity", name=which):
        item.set("kv", words(float(item.get("kv", "1")) * by))
        for name, value in values.items():
            item.set(name, value)


def weak(root: Element, spec: Spec, *, share: float, which: str = "servo$") -> None:
    limit = share * spec.torque
    servo(root, spec, which=which, forcerange=words(-limit, limit))


def damp_base(root: Element, spec: Spec) -> None:
    """A free joint with damping, of the size of the turn's own torque."""
    base = base_of(root)
    base.remove(base.findall("freejoint")[0])
    damping = words(6 * spec.torque / spec.radius * spec.track)
    base.insert(0, Element("joint", {"name": "root", "type": "free", "damping": damping}))


def hold_base(root: Element, _: Spec) -> None:
    base = base_of(root)
    base.remove(base.findall("freejoint")[0])


def tie(root: Element, _: Spec, *, first: str, second: str) -> None:
    equality = SubElement(root, "equality")
    SubElement(equality, "joint", joint1=f"{first}_hinge", joint2=f"{second}_hinge")


def weld(root: Element, _: Spec) -> None:
    SubElement(SubElement(root, "equality"), "weld", body1="base")


def cross_motor(root: Element, spec: Spec, *, motor: str, joint: str) -> None:
    servo(root, spec, which=f"^{motor}", joint=f"{joint}_hinge")


def drop_motor(root: Element, _: Spec, *, which: str) -> None:
    actuator = root.find("actuator")
    assert actuator is not None
    for item in find_all(actuator, "velocity", name=which):
        actuator.remove(item)


def flag(root: Element, _: Spec, **values: str) -> None:
    option = root.find("option")
    assert option is not None
    SubElement(option, "flag", values)


def option(root: Element, _: Spec, **values: str) -> None:
    item = root.find("option")
    assert item is not None
    item.attrib.update(values)


def tyres(root: Element, _: Spec, *, which: str = "_tyre$", **values: str) -> None:
    put(root, _, tag="geom", which=which, **values)


def torsion(root: Element, spec: Spec, *, condim: str = "6") -> None:
    """Tyres that hold against turning, as a patch of half a wheelbase would."""
    rolling = "0.0001"
    friction = words(spec.mu, 0.5 * spec.wheelbase) + f" {rolling}"
    tyres(root, spec, condim=condim, friction=friction)
    put(root, spec, tag="geom", which="ground", condim=condim, friction=friction)


def hard_contacts(root: Element, _: Spec) -> None:
    """MuJoCo's own contact and its pyramid, as nobody sets anything."""
    for tyre in find_all(root, "geom", name="_tyre$"):
        for name in ("solimp", "priority"):
            tyre.attrib.pop(name, None)
    option(root, _, cone="pyramidal", impratio="1")


def box_tyres(root: Element, spec: Spec) -> None:
    size = words(spec.radius * 0.9, spec.radius * 0.9, spec.width / 2)
    tyres(root, spec, type="box", size=size)


def offset_tyres(root: Element, spec: Spec, *, share: float) -> None:
    """Tyres that are not round about their axles."""
    tyres(root, spec, pos=words(share * spec.radius, 0, 0))


def lean_ground(root: Element, spec: Spec) -> None:
    put(root, spec, tag="geom", which="ground", euler="0 9 0")


def hang_spring(root: Element, spec: Spec) -> None:
    """Hinges that a spring turns back."""
    hinge(root, spec, stiffness=1.5)


def in_grams(root: Element, spec: Spec) -> None:
    """Masses in grams, inertia in kg m2."""
    weigh(root, spec, name="base", mass=1e3)
    weigh_wheels(root, spec, mass=1e3, inertia=1.0)


def mix_angles(root: Element, spec: Spec) -> None:
    """Wheels that stand upright by angles in radians, in a file in degrees."""
    for corner in CORNERS:
        for body in find_all(root, "body", name=f"^{corner}"):
            body.set("euler", words(math.pi / 2, 0, 0))
    put(root, spec, tag="joint", which="_hinge$", axis="0 0 -1")
    put(root, spec, tag="geom", which="_tyre$", zaxis="0 0 1")


LEFT, RIGHT = ("front_left", "rear_left"), ("front_right", "rear_right")
DISEASES = (
    Disease(
        "weight_ahead", ALL, partial(move_weight, x=0.5), ("weight_off",), "weight|centre of mass"
    ),
    Disease(
        "weight_left", ALL, partial(move_weight, y=0.5), ("weight_off",), "weight|centre of mass"
    ),
    Disease(
        "weight_outside",
        ALL,
        partial(move_weight, x=-1.6),
        ("weight_off",),
        "weight|outside|centre of mass",
    ),
    Disease(
        "base_weighs_nothing",
        GAZEBO,
        drop_inertial,
        ("mass_in_wheels", "inertia", "weight_off"),
        "mass|inertia",
    ),
    Disease("mass_in_wheels", ALL, heavy_wheels, ("mass_in_wheels",), "mass is in the wheels"),
    Disease(
        "inertia_huge",
        ALL,
        partial(weigh, name="base", mass=1, inertia=60),
        ("inertia",),
        "inertia",
    ),
    Disease(
        "inertia_tiny",
        ALL,
        partial(weigh, name="base", mass=1, inertia=1e-4),
        ("inertia",),
        "inertia",
    ),
    Disease(
        "wheel_inertia_30_times",
        ALL,
        partial(weigh_wheels, mass=1, inertia=30),
        ("inertia",),
        "inertia",
    ),
    Disease("wheel_inertia_no_body", GAZEBO, twist_inertia, ("inertia",), "inertia|no wheel"),
    Disease(
        "one_wheel_high",
        ALL,
        partial(move_wheels, corners=("rear_right",), up=0.08),
        ("unlike_wheels",),
        "high|stands on|axle",
    ),
    Disease(
        "two_wheels_in_the_air",
        ALL,
        partial(move_wheels, corners=("front_left", "front_right"), up=0.5),
        ("unlike_wheels",),
        "high|ground|axle|stands",
    ),
    Disease(
        "one_wheel_larger",
        ALL,
        partial(resize_wheel, corner="front_left", by=1.06),
        ("unlike_wheels",),
        "radi|larger|size",
    ),
    Disease(
        "left_axes_flipped",
        ALL,
        partial(turn_axes, corners=LEFT, axis="0 -1 0"),
        ("axes",),
        "ax[ie]s",
    ),
    Disease(
        "one_axis_flipped",
        ALL,
        partial(turn_axes, corners=("rear_left",), axis="0 -1 0"),
        ("axes",),
        "ax[ie]s",
    ),
    Disease(
        "axes_point_up",
        ALL,
        partial(turn_axes, corners=CORNERS, axis="0 0 1"),
        ("axes",),
        "ax[ie]s|steer|wheels",
    ),
    Disease("names_swapped", ALL, swap_names, ("names", "controller"), "left|right"),
    Disease("millimetres", ALL, in_millimetres, (), "mm|millimet|metres"),
    Disease("grams", ALL, in_grams, (), "grams"),
    Disease("angles_mixed", MJCF, mix_angles, (), "<compiler angle>"),
    Disease("wheel_inertia_g_cm2", ALL, partial(weigh_wheels, mass=1, inertia=1e7), (), "g cm2"),
    Disease("step_20_us", MJCF, partial(option, timestep="2e-5"), (), "times slower"),
    Disease("margin", MJCF, partial(tyres, margin="0.03"), (), "margin"),
    Disease(
        "masks_apart",
        MJCF,
        partial(tyres, contype="2", conaffinity="4"),
        ("contact",),
        "contype",
    ),
    Disease("hull_in_ground", ALL, move_hull, ("hull",), "hull|ground|body"),
    Disease(
        "toe_in",
        ALL,
        partial(toe, angle=0.14),
        ("axes", "unlike_wheels"),
        "toe|parallel|point|skew|ax[ie]s",
    ),
    Disease(
        "effort_0", GAZEBO, partial(limit_joints, effort=0.0), ("effort", "motor_weak"), "effort"
    ),
    Disease(
        "effort_low",
        GAZEBO,
        partial(limit_joints, share=0.15),
        ("effort", "motor_weak"),
        "effort|weak|torque",
    ),
    Disease("velocity_0", GAZEBO, partial(limit_joints, velocity=0.0), ("velocity",), "velocity"),
    Disease("joints_end", GAZEBO, close_joints, (), "revolute|limit|range|continuous"),
    Disease("axle_damping", GAZEBO, partial(add_dynamics, damping=6.0), ("damping",), "damping"),
    Disease(
        "axle_friction", GAZEBO, partial(add_dynamics, friction=5.0), ("friction",), "friction"
    ),
    Disease("mu_0", GAZEBO, partial(put_friction, mu1="0", mu2="0"), ("friction",), "mu|friction"),
    Disease(
        "mu_by_heading",
        GAZEBO,
        partial(put_friction, mu1="1.0", mu2="0.1"),
        ("friction_by_heading",),
        "mu1|heading",
    ),
    Disease(
        "mu_0_on_one_side",
        GAZEBO,
        partial(put_friction, mu1="0.02", mu2="0.02", side="left"),
        ("unlike_wheels", "friction"),
        "friction|mu",
    ),
    Disease(
        "fdir1", GAZEBO, partial(add_surface, fdir1="1 0 0"), ("friction_by_heading",), "fdir1"
    ),
    Disease("slip", GAZEBO, partial(add_surface, slip1="2", slip2="2"), ("slip",), "slip"),
    Disease("sinks", GAZEBO, soften, ("sinks",), "kp|sink"),
    Disease(
        "static",
        GAZEBO,
        partial(flag_model, tag="static", value="true", link=False),
        ("static",),
        "static",
    ),
    Disease(
        "kinematic",
        GAZEBO,
        partial(flag_model, tag="kinematic", value="true", link=True),
        ("kinematic",),
        "kinematic",
    ),
    Disease(
        "no_gravity",
        GAZEBO,
        partial(flag_model, tag="gravity", value="0", link=True),
        ("gravity",),
        "gravity",
    ),
    Disease(
        "no_gravity_at_all",
        ("sdf",),
        partial(all_links, tag="gravity", value="false"),
        ("gravity",),
        "gravity",
    ),
    Disease(
        "plugin_sides_swapped",
        GAZEBO,
        partial(change_plugin, joints=lambda side, name: exchange(name)),
        ("controller", "names", "plugin"),
        "left|right|side",
    ),
    Disease(
        "plugin_sides_crossed",
        GAZEBO,
        partial(change_plugin, joints=cross),
        ("controller", "names", "plugin"),
        "left|right|side",
    ),
    Disease(
        "plugin_front_only",
        GAZEBO,
        partial(
            change_plugin, joints=lambda side, name: name if name.startswith("front") else None
        ),
        ("controller", "plugin"),
        "two|front|half|drives|rear",
    ),
    Disease(
        "plugin_one_side",
        GAZEBO,
        partial(change_plugin, joints=lambda side, name: name if side == "left" else None),
        ("controller", "plugin"),
        "right|side|drives",
    ),
    Disease(
        "plugin_unknown_joint",
        GAZEBO,
        partial(change_plugin, joints=lambda side, name: f"base_to_{name}"),
        ("controller", "names", "plugin"),
        "joint|not there|no such",
    ),
    Disease(
        "plugin_half_separation",
        GAZEBO,
        partial(scale_plugin, tag="wheel_separation", by=0.5),
        ("controller",),
        "separation",
    ),
    Disease(
        "plugin_twice_separation",
        GAZEBO,
        partial(scale_plugin, tag="wheel_separation", by=2.0),
        ("controller",),
        "separation",
    ),
    Disease(
        "plugin_diameter",
        GAZEBO,
        partial(scale_plugin, tag="wheel_radius", by=2.0),
        ("controller",),
        "radius",
    ),
    Disease("plugin_torque", GAZEBO, add_torque, ("effort", "motor_weak"), "torque"),
    Disease("hinge_damping", MJCF, partial(hinge, damping=4.0), ("damping",), "damping"),
    Disease(
        "hinge_friction",
        MJCF,
        partial(hinge, frictionloss=4.0),
        ("frictionloss",),
        "friction ?loss|dry friction",
    ),
    Disease("hinge_spring", MJCF, hang_spring, ("stiffness",), "stiff|spring"),
    Disease(
        "hinge_limits",
        MJCF,
        partial(put, tag="joint", which="hinge$", range="-40 40"),
        ("limits",),
        "range|limit",
    ),
    Disease(
        "hinge_armature",
        MJCF,
        partial(hinge, share=False, armature=60.0),
        ("armature", "inertia"),
        "armature|inertia",
    ),
    Disease("base_damping", MJCF, damp_base, ("damping",), "damping"),
    Disease("base_welded", MJCF, weld, ("equality",), "weld|equality|held"),
    Disease("base_without_freejoint", MJCF, hold_base, (), "free ?joint|free joint|world|fixed"),
    Disease(
        "sides_tied",
        MJCF,
        partial(tie, first="front_left", second="front_right"),
        ("equality",),
        "equality|tie",
    ),
    Disease(
        "rear_sides_tied",
        MJCF,
        partial(tie, first="rear_right", second="rear_left"),
        ("equality",),
        "equality|tie",
    ),
    Disease(
        "ctrlrange_forward", MJCF, partial(servo, ctrlrange="0 12"), ("ctrlrange",), "ctrlrange"
    ),
    Disease(
        "ctrlrange_tiny", MJCF, partial(servo, ctrlrange="-0.05 0.05"), ("ctrlrange",), "ctrlrange"
    ),
    Disease(
        "one_gear_back", MJCF, partial(servo, which="^rear_left", gear="-1"), ("gear",), "gear"
    ),
    Disease("servo_soft", MJCF, partial(servo, by=0.01), ("servo_soft",), "kv|soft|servo"),
    Disease(
        "one_servo_soft",
        MJCF,
        partial(servo, which="^front_right", by=0.01),
        ("servo_soft", "unlike_wheels"),
        "front_right|kv|soft",
    ),
    Disease("motors_weak", MJCF, partial(weak, share=0.4), ("motor_weak",), "forcerange|weak"),
    Disease(
        "one_motor_weak",
        MJCF,
        partial(weak, share=0.2, which="^rear_right"),
        ("motor_weak",),
        "forcerange|weak",
    ),
    Disease(
        "motor_on_wrong_joint",
        MJCF,
        partial(cross_motor, motor="front_right", joint="rear_right"),
        ("motors",),
        "motor|drives|two|joint|actuator",
    ),
    Disease(
        "no_rear_motors",
        MJCF,
        partial(drop_motor, which="^rear"),
        ("motors",),
        "motor|drives|actuator",
    ),
    Disease("torsional", MJCF, torsion, ("torsion",), "torsion|condim"),
    Disease(
        "torsional_condim_4", MJCF, partial(torsion, condim="4"), ("torsion",), "torsion|condim"
    ),
    Disease(
        "rolling_friction",
        MJCF,
        partial(tyres, condim="6", friction="0.8 0.005 0.05"),
        ("rolling",),
        "rolling|condim",
    ),
    Disease(
        "mu_0_mjcf",
        MJCF,
        partial(tyres, friction="0.0001 0.005 0.0001"),
        ("friction",),
        "friction|grip",
    ),
    Disease(
        "one_mu_low",
        MJCF,
        partial(tyres, which="^front_left_tyre", friction="0.05 0.005 0.0001"),
        ("unlike_wheels",),
        "friction",
    ),
    Disease("condim_1", MJCF, partial(tyres, condim="1"), ("condim",), "condim|friction"),
    Disease(
        "tyres_miss_ground",
        MJCF,
        partial(tyres, contype="0", conaffinity="0"),
        ("contact",),
        "contype|contact|conaffinity|carry|touch",
    ),
    Disease(
        "one_tyre_misses",
        MJCF,
        partial(tyres, which="^rear_left_tyre", contype="0", conaffinity="0"),
        ("contact",),
        "contype|contact|conaffinity|carries|touch",
    ),
    Disease("contacts_off", MJCF, partial(flag, contact="disable"), ("contact",), "contact"),
    Disease("gravity_off", MJCF, partial(option, gravity="0 0 0"), ("gravity",), "gravity"),
    Disease("gravity_leans", MJCF, partial(option, gravity="2 0 -9.6"), ("gravity",), "gravity"),
    Disease(
        "actuation_off",
        MJCF,
        partial(flag, actuation="disable"),
        ("actuation",),
        "actuation|disable",
    ),
    Disease(
        "gravcomp",
        MJCF,
        partial(put, tag="body", which="^base$", gravcomp="0.85"),
        ("gravcomp",),
        "gravcomp",
    ),
    Disease(
        "water",
        MJCF,
        partial(option, density="1000", viscosity="1"),
        ("medium",),
        "density|viscosity|medium|liquid|water",
    ),
    Disease("ground_leans", MJCF, lean_ground, ("slope",), "slope|lean|level|tilt|steep"),
    Disease(
        "step_20_ms", MJCF, partial(option, timestep="0.02", integrator="Euler"), ("step",), "step"
    ),
    Disease(
        "one_sweep",
        MJCF,
        partial(option, solver="PGS", iterations="1"),
        ("creep", "solver"),
        "iteration|sweep|Newton|solver",
    ),
    Disease(
        "nobody_set_contacts",
        MJCF,
        hard_contacts,
        ("pyramid", "hopping", "creep"),
        "cone|solimp|impratio",
    ),
    Disease(
        "soft_tyres",
        MJCF,
        partial(tyres, solref="0.3 1", solimp="0.01 0.2 0.1 0.5 2"),
        ("sinks", "creep"),
        "solref|solimp|sink|soft",
    ),
    Disease("box_tyres", MJCF, box_tyres, ("wheel_shape", "hopping"), "box|shape"),
    Disease(
        "eccentric_tyres",
        MJCF,
        partial(offset_tyres, share=0.12),
        ("wheel_shape", "unlike_wheels"),
        "centre|axle|round|eccentric|middle",
    ),
    Disease(
        "grippy_ground",
        MJCF,
        partial(
            put,
            tag="geom",
            which="^ground",
            friction="2 0.005 0.0001",
            solimp="0.1 0.95 0.005 0.5 2",
            priority="2",
        ),
        ("which_friction",),
        "friction|priority",
    ),
)


# ----------------------------------------------------------------------- sound variations


@dataclass(frozen=True)
class Sound:
    """A model as it should be, written another way."""

    name: str
    formats: tuple[str, ...]
    change: Change = lambda root, spec: None
    specs: tuple[str, ...] = tuple(SPECS)
    other: Callable[[Spec], Spec] = lambda spec: spec
    draws: int = 2
    shape: str = "ellipsoid"


def start_turned(root: Element, spec: Spec, *, angle: float) -> None:
    if is_mjcf(root):
        base_of(root).set("euler", words(0, 0, math.degrees(angle)))
    elif root.tag == "sdf":
        pose = root.find("model/pose")
        assert pose is not None
        pose.text = words(2, -1, spec.radius, 0, 0, angle)


def drop_ground(root: Element, _: Spec) -> None:
    world = root.find("worldbody")
    assert world is not None
    world.remove(find_all(root, "geom", name="^ground$")[0])


def lay_field(root: Element, spec: Spec) -> None:
    """A height field that is flat."""
    drop_ground(root, spec)
    asset, world = root.find("asset"), root.find("worldbody")
    assert asset is not None
    assert world is not None
    SubElement(asset, "hfield", name="field", nrow="10", ncol="10", size="20 20 1 0.5")
    friction = words(spec.mu, 0.005, 0.0001)
    SubElement(world, "geom", name="ground", type="hfield", hfield="field", friction=friction)


def lay_slab(root: Element, spec: Spec) -> None:
    put(root, spec, tag="geom", which="^ground$", type="box", size="12 12 0.5", pos="0 0 -0.5")


def add_suspension(root: Element, spec: Spec) -> None:
    """Wheels on slides with springs that give way by a few millimetres."""
    base = base_of(root)
    stiff = spec.total * 9.81 / 4 / (0.05 * spec.radius)
    for corner in CORNERS:
        wheel = find_all(root, "body", name=f"^{corner}$")[0]
        arm = SubElement(base, "body", name=f"{corner}_arm", pos=wheel.get("pos", ""))
        SubElement(
            arm,
            "inertial",
            pos="0 0 0",
            mass=words(0.3 * spec.wheel_mass),
            diaginertia=words(*spec.wheel_inertia()),
        )
        slide = {"type": "slide", "axis": "0 0 1", "stiffness": words(stiff)}
        damping = words(1.4 * math.sqrt(stiff * spec.total / 4))
        SubElement(arm, "joint", name=f"{corner}_slide", **slide, damping=damping)
        wheel.set("pos", "0 0 0")
        base.remove(wheel)
        arm.append(wheel)


def add_sensors(root: Element, spec: Spec) -> None:
    """A lidar on top and a camera in front."""
    if is_mjcf(root):
        lidar = SubElement(
            base_of(root), "body", name="lidar", pos=words(0, 0, spec.high + spec.body[2])
        )
        size = {"type": "cylinder", "size": "0.03 0.02", "mass": "0.1"}
        SubElement(lidar, "geom", **size, contype="0", conaffinity="0")
        SubElement(base_of(root), "site", name="imu", pos="0 0 0.02")
    elif root.tag == "robot":
        SubElement(root, "link", name="laser_frame")
        joint = SubElement(root, "joint", name="laser_joint", type="fixed")
        SubElement(joint, "parent", link="base_link")
        SubElement(joint, "child", link="laser_frame")
        SubElement(joint, "origin", xyz=words(0.1, 0, spec.high + spec.body[2]))
    else:
        SubElement(base_of(root), "sensor", name="imu", type="imu")


def add_footprint(root: Element, spec: Spec) -> None:
    """A URDF whose root is a frame on the ground, as navigation wants it."""
    SubElement(root, "link", name="base_footprint")
    joint = SubElement(root, "joint", name="base_joint", type="fixed")
    SubElement(joint, "parent", link="base_footprint")
    SubElement(joint, "child", link="base_link")
    SubElement(joint, "origin", xyz=words(0, 0, spec.radius))


def own_names(root: Element, _: Spec) -> None:
    """Names as others give them: wheel_FL and the like."""
    short = {"front_left": "FL", "front_right": "FR", "rear_left": "RL", "rear_right": "RR"}

    def rename(text: str) -> str:
        for long, name in short.items():
            text = text.replace(long, f"wheel_{name}")
        return text

    for item in root.iter():
        for key in ("name", "link", "reference", "joint"):
            if key in item.attrib:
                item.set(key, rename(item.attrib[key]))
        if item.text and item.text.strip():
            item.text = rename(item.text)


def ros_1_plugin(root: Element, spec: Spec) -> None:
    """The skid-steering plugin of Gazebo classic."""
    plugin = next(root.iter("plugin"))
    plugin.clear()
    plugin.attrib.update(filename="libgazebo_ros_skid_steer_drive.so", name="drive")
    for corner, tag in zip(
        CORNERS, ("leftFront", "rightFront", "leftRear", "rightRear"), strict=True
    ):
        SubElement(plugin, f"{tag}Joint").text = f"{corner}_joint"
    SubElement(plugin, "wheelSeparation").text = words(spec.track * spec.multiplier)
    SubElement(plugin, "wheelDiameter").text = words(2 * spec.radius)
    SubElement(plugin, "torque").text = words(8 * spec.torque)


def drop_plugin(root: Element, _: Spec) -> None:
    for parent in list(root.iter()):
        for plugin in parent.findall("plugin"):
            parent.remove(plugin)
    for gazebo in root.findall("gazebo"):
        if not gazebo.get("reference"):
            root.remove(gazebo)


def two_plugins(root: Element, spec: Spec) -> None:
    """Joint states beside the drive."""
    parent = next(item for item in root.iter() if item.find("plugin") is not None)
    name = {"filename": "gz-sim-joint-state-publisher-system"}
    SubElement(parent, "plugin", name="gz::sim::systems::JointStatePublisher", **name)


def plain_contacts(root: Element, spec: Spec) -> None:
    """Soft contact through <default>, and frictions through it."""
    default = Element("default")
    root.insert(1, default)
    tyre = SubElement(default, "default", {"class": "tyre"})
    solimp = {"solimp": "0.1 0.95 0.005 0.5 2", "priority": "1"}
    SubElement(tyre, "geom", friction=words(spec.mu, 0.005, 0.0001), **solimp)
    for item in find_all(root, "geom", name="_tyre$"):
        for name in ("solimp", "priority", "friction"):
            item.attrib.pop(name)
        item.set("class", "tyre")


def use_general(root: Element, _: Spec) -> None:
    """Servos as <general>."""
    for item in find_all(root, "velocity"):
        gain = item.attrib.pop("kv")
        item.tag = "general"
        item.attrib.update(gainprm=gain, biastype="affine", biasprm=f"0 0 -{gain}")


def use_motors(root: Element, spec: Spec) -> None:
    for item in find_all(root, "velocity"):
        item.tag = "motor"
        item.attrib.pop("kv")
        limit = words(-4 * spec.torque, 4 * spec.torque)
        item.attrib.update(ctrlrange=limit)


def drop_actuators(root: Element, _: Spec) -> None:
    actuator = root.find("actuator")
    assert actuator is not None
    root.remove(actuator)


def strong_ranges(root: Element, spec: Spec) -> None:
    limit = 4 * spec.torque
    servo(root, spec, forcerange=words(-limit, limit), ctrlrange="-30 30")


def rest_higher(root: Element, spec: Spec) -> None:
    base_of(root).set("pos", words(0, 0, spec.radius + 0.02))


def tip_z(spec: Spec) -> Spec:
    return replace(spec, high=spec.high + 0.3 * spec.radius)


def scaled(spec: Spec, *, by: float) -> Spec:
    """The same robot, larger.

    Returns:
        Lengths times `by`, masses times its cube.
    """
    lengths = ("wheelbase", "track", "radius", "width", "high")
    masses = ("mass", "wheel_mass")
    body = tuple(by * length for length in spec.body)
    changes = {name: by * getattr(spec, name) for name in lengths}
    changes |= {name: by**3 * getattr(spec, name) for name in masses}
    return replace(spec, **changes, body=body)


SOUND = (
    Sound("as it is", ALL, draws=4),
    Sound("turned 40", ("sdf", "mjcf"), partial(start_turned, angle=0.7)),
    Sound("turned 90", ("sdf", "mjcf"), partial(start_turned, angle=math.pi / 2)),
    Sound("turned 180", ("sdf", "mjcf"), partial(start_turned, angle=math.pi)),
    Sound("ice", ALL, other=lambda spec: replace(spec, mu=0.1)),
    Sound("low friction", ALL, other=lambda spec: replace(spec, mu=0.35)),
    Sound("rubber", ALL, other=lambda spec: replace(spec, mu=1.1)),
    Sound("half as large", ALL, other=partial(scaled, by=0.6)),
    Sound("larger", ALL, other=partial(scaled, by=1.3)),
    Sound("higher weight", ALL, other=tip_z),
    Sound("short", ALL, other=lambda spec: replace(spec, wheelbase=0.9 * spec.wheelbase)),
    Sound("wide", ALL, other=lambda spec: replace(spec, track=1.25 * spec.track)),
    Sound("sensors", ALL, add_sensors),
    Sound("weight 3 % ahead", ALL, partial(move_weight, x=0.03)),
    Sound("names", ALL, own_names),
    Sound("footprint", ("urdf",), add_footprint),
    Sound("classic plugin", GAZEBO, ros_1_plugin),
    Sound("no plugin", GAZEBO, drop_plugin),
    Sound("two plugins", GAZEBO, two_plugins),
    Sound("light damping", GAZEBO, partial(add_dynamics, damping=0.01, friction=0.02)),
    Sound("no ground", MJCF, drop_ground),
    Sound("height field", MJCF, lay_field),
    Sound("slab", MJCF, lay_slab),
    Sound("suspension", MJCF, add_suspension, draws=3),
    Sound("cylinders", MJCF, shape="cylinder", draws=3),
    Sound("spheres", MJCF, shape="sphere"),
    Sound("defaults", MJCF, plain_contacts),
    Sound("general servos", MJCF, use_general),
    Sound("motors", MJCF, use_motors),
    Sound("no actuators", MJCF, drop_actuators),
    Sound("strong motors", MJCF, strong_ranges),
    Sound("falls 2 cm", MJCF, rest_higher),
    Sound("1 ms", MJCF, partial(option, timestep="0.001")),
    Sound("light frictionloss", MJCF, partial(hinge, frictionloss=0.02)),
    Sound("condim 4", MJCF, partial(tyres, condim="4")),
)


# --------------------------------------------------------------------------------- judging


@dataclass(frozen=True)
class Checked:
    """What `robots check` found."""

    status: int
    said: str
    info: dict

    @property
    def findings(self) -> list[dict]:
        """Kind, severity, cause and change of each."""
        return self.info.get("findings", [])


def check_robot(root: Element, form: str, folder: Path) -> Checked:
    """Run `python -m validation.robots check` in this process.

    Returns:
        What it wrote and said.
    """
    path, out = folder / f"stranger.{ENDS[form]}", folder / "out"
    found = out / "robot.json"
    found.unlink(missing_ok=True)
    path.write_bytes(tostring(root))
    said = io.StringIO()
    arguments = ["robots", "check", str(path), "--out", str(out), "--overwrite", "--workers", "1"]
    kept, sys.argv, status = sys.argv, arguments, 0
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "'validation", RuntimeWarning)
        try:
            runpy.run_module("validation.robots", run_name="__main__", alter_sys=True)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            sys.argv = kept
    info = json.loads(found.read_text()) if found.is_file() else {}
    return Checked(status, said.getvalue(), info)


def describe_checked(checked: Checked) -> str:
    """One line of what was said.

    Returns:
        Findings, or how it ended.
    """
    parts = [f"{item['kind']}/{item['severity']}: {item['cause']}" for item in checked.findings]
    if checked.status not in (0, 1) or (checked.status and not parts):
        parts.append(f"exit {checked.status}: {' '.join(checked.said.split())[-250:]}")
    return " | ".join(parts) or "nothing"


def judge_disease(disease: Disease, checked: Checked) -> str:
    """Compare what was said with what was done.

    Returns:
        One of the four outcomes. A wrong fault beside the right one is wrong: it is advice too.
    """
    if checked.status not in (0, 1, 2):
        return WRONG
    if checked.status == 2:
        return NAMED if re.search(disease.says, checked.said) else SILENT
    right = [
        item
        for item in checked.findings
        if item["kind"] in disease.kinds
        or re.search(disease.says, f"{item['cause']} {item.get('change') or ''}")
    ]
    left_open = [item for item in checked.findings if item["kind"] == "unexplained"]
    faults = [item for item in checked.findings if item["severity"] == "fault"]
    if any(item not in right and item not in left_open for item in faults):
        return WRONG
    named = [item for item in right if item["kind"] != "unexplained"]
    return NAMED if named else OPEN if left_open else SILENT


def judge_sound(checked: Checked) -> str:
    """Whether a sound model passes.

    Returns:
        `fine`, or `blamed` where it was refused or has a fault.
    """
    faults = [item for item in checked.findings if item["severity"] == "fault"]
    return BLAMED if checked.status or faults else FINE


def try_diseases(seed: int, only: str, folder: Path) -> Iterator[Verdict]:
    """Put every disease into a sound model of each of its formats.

    Yields:
        A verdict a file.
    """
    for number, disease in enumerate(DISEASES):
        if only not in disease.name:
            continue
        rng = np.random.default_rng([seed, number])
        for form in disease.formats:
            name = str(rng.choice(list(SPECS)))
            root = WRITERS[form](SPECS[name])
            disease.change(root, SPECS[name])
            checked = check_robot(root, form, folder)
            outcome = judge_disease(disease, checked)
            yield Verdict(disease.name, f"{name}.{form}", outcome, describe_checked(checked))


def try_sound(seed: int, only: str, folder: Path) -> Iterator[Verdict]:
    """Write every sound variation of some robots.

    Yields:
        A verdict a file.
    """
    for number, sound in enumerate(SOUND):
        if only not in sound.name:
            continue
        rng = np.random.default_rng([seed, 1000 + number])
        for form in sound.formats:
            for name in rng.permutation(sound.specs)[: sound.draws]:
                spec = sound.other(SPECS[str(name)])
                root = write_mjcf(spec, sound.shape) if form == "mjcf" else WRITERS[form](spec)
                sound.change(root, spec)
                checked = check_robot(root, form, folder)
                detail = describe_checked(checked)
                yield Verdict(sound.name, f"{name}.{form}", judge_sound(checked), detail)


@pytest.mark.slow
def test_diseases_are_named_or_shown(tmp_path: Path) -> None:
    """Of diseases that nobody fitted, most are named, and none by a wrong cause."""
    verdicts = list(try_diseases(0, "", tmp_path))
    assert len(DISEASES) >= 60
    print_table(verdicts, (NAMED, OPEN, SILENT, WRONG), (WRONG, SILENT))
    assert share_of(verdicts, WRONG) == 0
    assert share_of(verdicts, NAMED, OPEN) >= 0.85


@pytest.mark.slow
def test_sound_robots_are_not_blamed(tmp_path: Path) -> None:
    """Models that do as mechanics says have no fault."""
    verdicts = list(try_sound(0, "", tmp_path))
    assert len(verdicts) >= 100
    print_table(verdicts, (FINE, BLAMED), (BLAMED,))
    assert share_of(verdicts, BLAMED) == 0


def main() -> None:
    """Print the table of diseases and that of sound models."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of a disease's or a variation's name")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ill = show_each(try_diseases(options.seed, options.only, Path(folder)), (FINE, NAMED))
        sound = show_each(try_sound(options.seed, options.only, Path(folder)), (FINE, NAMED))
    if ill:
        print_table(ill, (NAMED, OPEN, SILENT, WRONG), ())
    if sound:
        print_table(sound, (FINE, BLAMED), ())


def show_each(verdicts: Iterator[Verdict], good: tuple[str, ...]) -> list[Verdict]:
    """Print the line of each that is not good, as soon as it is known.

    Returns:
        All of them.
    """
    kept = []
    for verdict in verdicts:
        kept.append(verdict)
        if verdict.outcome not in good:
            where = f"{verdict.outcome}: {verdict.name} @ {verdict.base}"
            print(f"{where}: {verdict.detail}", flush=True)
    return kept


if __name__ == "__main__":
    main()
