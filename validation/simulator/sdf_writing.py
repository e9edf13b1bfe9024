"""A robot's description -> an SDF model for Gazebo: plain shapes, four wheels on revolute joints, friction of the tyres."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree  # nosec B405 # only written
from collections.abc import Iterable

from validation.simulator.description import WHEELS, Robot

_VERSION = "1.7"
"""Version of the format: Gazebo Classic 11 and all of the new Gazebo read it."""
_ENDLESS = 1e16
"""Limit of a joint that turns without end, as SDFormat has it [rad]."""


def sdf_text(robot: Robot) -> str:
    """Return a robot's SDF model, in SI units, which stands with its tyres on the plane z = 0.

    Tyres are cylinders with the robot's friction in both directions and without `fdir1`. A joint's effort is limited to half
    of what a side's motors give. SDF has no word for belts, rotors and speed loops: those are left out.
    """
    g, m = robot.geometry, robot.masses
    root = ElementTree.Element("sdf", version=_VERSION)
    model = ElementTree.SubElement(root, "model", name=robot.name)
    _say(model, "pose", (0.0, 0.0, g.base_height, 0.0, 0.0, 0.0))
    base = _link(model, "base_link", robot.base_mass, m.com, m.inertia)
    for use in ("visual", "collision"):
        _say(_geometry(base, use, (*g.body_centre, 0.0, 0.0, 0.0), "box"), "size", g.body_size)
    imu = ElementTree.SubElement(model, "frame", {"name": "imu_link", "attached_to": "base_link"})
    _say(imu, "pose", (*g.imu, 0.0, 0.0, 0.0))
    across, spin = m.wheel_inertia
    for wheel in WHEELS:
        x, y = (0.5 if "front" in wheel else -0.5) * g.wheelbase, (0.5 if "left" in wheel else -0.5) * g.track
        link = _link(model, f"{wheel}_wheel_link", m.wheel, (0.0, 0.0, 0.0), (across, spin, across))
        place = ElementTree.Element("pose", relative_to="base_link")
        place.text = _row((x, y, g.axle_height, 0.0, 0.0, 0.0))
        link.insert(0, place)
        for use in ("visual", "collision"):
            shape = _geometry(link, use, (0.0, 0.0, 0.0, 0.5 * math.pi, 0.0, 0.0), "cylinder")
            _say(shape, "radius", (g.wheel_radius,))
            _say(shape, "length", (g.wheel_width,))
        surface = ElementTree.SubElement(link.findall("collision")[0], "surface")
        ode = ElementTree.SubElement(ElementTree.SubElement(surface, "friction"), "ode")
        for direction in ("mu", "mu2"):
            _say(ode, direction, (robot.simulation.friction,))
        joint = ElementTree.SubElement(model, "joint", name=f"{wheel}_wheel_joint", type="revolute")
        ElementTree.SubElement(joint, "parent").text = "base_link"
        ElementTree.SubElement(joint, "child").text = f"{wheel}_wheel_link"
        axis = ElementTree.SubElement(joint, "axis")
        _say(axis, "xyz", (0.0, 1.0, 0.0))
        limit = ElementTree.SubElement(axis, "limit")
        _say(limit, "lower", (-_ENDLESS,))
        _say(limit, "upper", (_ENDLESS,))
        if math.isfinite(robot.drive.torque_limit):
            _say(limit, "effort", (0.5 * robot.drive.torque_limit,))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _row(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _say(parent: ElementTree.Element, name: str, numbers: Iterable[float]) -> None:
    ElementTree.SubElement(parent, name).text = _row(numbers)


def _link(
    model: ElementTree.Element, name: str, mass: float, com: Iterable[float], moments: tuple[float, float, float]
) -> ElementTree.Element:
    link = ElementTree.SubElement(model, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    _say(inertial, "pose", (*com, 0.0, 0.0, 0.0))
    _say(inertial, "mass", (mass,))
    inertia = ElementTree.SubElement(inertial, "inertia")
    for key, moment in zip(("ixx", "iyy", "izz"), moments, strict=True):
        _say(inertia, key, (moment,))
    return link


def _geometry(link: ElementTree.Element, use: str, pose: Iterable[float], kind: str) -> ElementTree.Element:
    part = ElementTree.SubElement(link, use, name=f"{link.get('name')}_{use}")
    _say(part, "pose", pose)
    return ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), kind)
