"""A robot's description -> a URDF, as `robot_description` has it: plain shapes, four wheels on continuous joints, an IMU."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree  # nosec B405 # only written
from collections.abc import Iterable, Mapping

from validation.simulator.description import WHEELS, Robot


def urdf_text(robot: Robot, joints: Mapping[str, str], base: str = "base_link", imu: str = "imu_link") -> str:
    """Return a robot's URDF, in SI units.

    The hull and its inertia stand in a link `chassis_link`, fixed to the base, because programs that read URDFs refuse
    inertia in the first link. Products of inertia are 0, as in a robot's file.

    Args:
        robot: the robot.
        joints: names of the wheels' joints, by wheel; a link has its joint's name with `_link` in the place of `_joint`.
        base: name of the base's link.
        imu: name of the IMU's link.
    """
    g, m = robot.geometry, robot.masses
    root = ElementTree.Element("robot", name=robot.name)
    ElementTree.SubElement(root, "link", name=base)
    hull = _link(root, "chassis_link", robot.base_mass, m.com, m.inertia)
    _shape(hull, g.body_centre, (0.0, 0.0, 0.0), "box", size=_row(g.body_size))
    _joint(root, "chassis_joint", "fixed", (base, "chassis_link"), (0.0, 0.0, 0.0))
    ElementTree.SubElement(root, "link", name=imu)
    _joint(root, "imu_joint", "fixed", (base, imu), g.imu)
    across, spin = m.wheel_inertia
    for wheel in WHEELS:
        x, y = (0.5 if "front" in wheel else -0.5) * g.wheelbase, (0.5 if "left" in wheel else -0.5) * g.track
        name = f"{joints[wheel].removesuffix('_joint')}_link"
        link = _link(root, name, m.wheel, (0.0, 0.0, 0.0), (across, spin, across))
        lying = (0.5 * math.pi, 0.0, 0.0)
        _shape(link, (0.0, 0.0, 0.0), lying, "cylinder", radius=repr(g.wheel_radius), length=repr(g.wheel_width))
        joint = _joint(root, joints[wheel], "continuous", (base, name), (x, y, g.axle_height))
        ElementTree.SubElement(joint, "axis", xyz="0 1 0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _row(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _link(
    root: ElementTree.Element, name: str, mass: float, com: Iterable[float], moments: tuple[float, float, float]
) -> ElementTree.Element:
    link = ElementTree.SubElement(root, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_row(com))
    ElementTree.SubElement(inertial, "mass", value=repr(mass))
    tensor = dict.fromkeys(("ixy", "ixz", "iyz"), "0") | dict(zip(("ixx", "iyy", "izz"), map(repr, moments), strict=True))
    ElementTree.SubElement(inertial, "inertia", tensor)
    return link


def _shape(link: ElementTree.Element, at: Iterable[float], rpy: Iterable[float], kind: str, **sizes: str) -> None:
    for use in ("visual", "collision"):
        part = ElementTree.SubElement(link, use)
        ElementTree.SubElement(part, "origin", xyz=_row(at), rpy=_row(rpy))
        ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), kind, sizes)


def _joint(
    root: ElementTree.Element, name: str, kind: str, links: tuple[str, str], at: Iterable[float]
) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    for end, link in zip(("parent", "child"), links, strict=True):
        ElementTree.SubElement(joint, end, link=link)
    ElementTree.SubElement(joint, "origin", xyz=_row(at))
    return joint
