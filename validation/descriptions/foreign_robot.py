"""A robot as a URDF, an SDF or an MJCF of others describes it, with its wheels found.

MuJoCo gets links and joints of a URDF without meshes, which are never looked for. An SDF is turned
into a URDF; an MJCF is read as it is, but for what `foreign.complete` leaves out.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import util
from pathlib import Path

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.descriptions import gazebo
from validation.descriptions.gazebo import NumbersByName
from validation.descriptions.sdf import urdf_of_sdf
from validation.descriptions.wheels import WheeledRobot, motor_moments
from validation.files import guarded, reading
from validation.output import one_line
from validation.simulator import foreign

_ROOT = "ssmr_world"
"""Name of a link that the robot stands on, and of its joint: MuJoCo merges the first link of all
with the world."""
LEAST_MASS = 1e-9
"""Mass that MuJoCo gives to bodies without one [kg], so that it takes them."""
_FEW_TURNS = 4.0 * np.pi
"""Range of a revolute joint beyond which it is a continuous one [rad]."""
_TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
ROUNDED = 1.1
"""Moment of inertia over the greatest that a body can have, up to which it is rounded [1]."""
_UNITS = {"kg m2": 1.0, "kg cm2": 1e-4, "kg mm2": 1e-6, "g cm2": 1e-7, "g mm2": 1e-9}
"""Units that inertia is in by mistake [kg m2]."""
_RIGHT_ANGLES = {
    "mujoco": "say the other <compiler angle>, which is degree where none is said; a right angle "
    "is 90 in degrees and 1.5708 in radians",
    "robot": "rpy of a URDF is in radians, and a right angle is 1.5708, not 90",
    "sdf": 'a <pose> is in radians, where it does not say degrees="true"; a right angle is 1.5708',
}
"""The unit of angles and a right angle in it, by the root of a file."""
_XACRO_TIME = 60.0
"""Limit of expanding a xacro file [s]."""


@dataclass(frozen=True, eq=False)
class ForeignRobot:
    """A robot of others, as its file says it."""

    file: str
    """Name of the file, in one line."""
    name: str
    """The robot's name in it, fit for a file of ours; empty for none."""
    kind: str
    """Kind of the file: `urdf`, `sdf` or `mjcf`."""
    wheeled: WheeledRobot
    """Its model, and its wheels."""
    contacts: Sequence[NumbersByName]
    """Numbers of the surfaces of the four wheels, as `contact_numbers` has them; `torsion` [m],
    `rolling` [m], the tyre's `own` friction, `misses` and
    `mixed`, of a contact that is softer by one of its two shapes (1 or 0), where MuJoCo says
    them."""
    limits: Sequence[NumbersByName]
    """Limits of the wheels' joints and motors: `effort` [N m], `velocity` [rad/s] and `range` [rad]
    of the angle, `nothing` (1) where one is 0; `gain` [N m s/rad] and `gear` of MuJoCo's motors."""
    motorised: bool
    """Whether each wheel has a motor of its own."""
    tensors: Mapping[str, tuple[float, FloatArray]]
    """Mass [kg] and (3, 3) inertia [kg m2] that the file says of its bodies, by name."""
    controller: NumbersByName
    """Separation, radius and multipliers with which a controller reckons, if any, and `held`, 1
    for a robot that is static or kinematic."""
    sides: Mapping[str, float]
    """Joints that a controller drives: 1 for one on the left, -1 for one on the right."""
    text: str
    """The file, an MJCF with all that it includes."""
    files: Mapping[str, bytes]
    """Other files of an MJCF, by name."""

    @property
    def rolls(self) -> bool:
        """Whether no wheel has a shape that is not round about its axle; meshes may be."""
        drums = [drum for drum in self.wheeled.drums if drum is not None]
        return all(drum.kind == "mesh" or not drum.flaw for drum in drums)

    def tensors_of(self, bodies: Sequence[int]) -> dict[str, tuple[float, FloatArray]]:
        """Return mass and inertia that the file says, by names of those bodies that it says it of.

        They are as those of `tensors`.
        """
        names = [self.wheeled.model.body(body).name for body in bodies]
        return {name: self.tensors[name] for name in names if name in self.tensors}


def is_description(path: str | Path) -> bool:
    """Return whether a file is XML, by its name or its first letter; false for one not there."""
    path = Path(path)
    if path.suffix.lower() in (".urdf", ".sdf", ".world", ".xml", ".mjcf", ".xacro"):
        return path.is_file()
    try:
        with reading.opened(path) as file:
            return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")
    except reading.FileError:
        return False


def read_foreign(path: str | Path, controller: str | Path | None = None) -> ForeignRobot:
    """Return the robot that a URDF, a xacro file, an SDF or an MJCF describes.

    Args:
        path: the file.
        controller: a controller's YAML, whose separation and radius count; those of the file's
            plugins if not given.

    Raises:
        ValueError: a file cannot be read, is none of these, or describes no robot with four fixed,
            plain wheels.
    """
    path = Path(path)
    text = reading.read_text(path, foreign.MOST_BYTES)
    root = foreign.xml_tree(text)
    if _is_xacro(root):
        text = _expanded(path)
        root = foreign.xml_tree(text)
    numbers, sides = gazebo.plugin_numbers(root)
    if controller is not None:
        yaml = reading.read_text(controller, foreign.MOST_BYTES)
        try:
            numbers, sides = gazebo.controller_numbers(yaml)
        except ValueError as error:
            raise ValueError(f"{controller}: {error}") from error
    if root.tag not in _RIGHT_ANGLES:
        raise ValueError(
            f"this is no URDF, SDF or MJCF: its root is <{one_line(root.tag)}>, not <robot>, <sdf> "
            "or <mujoco>"
        )
    read = partial(_of_urdf, path, text, numbers, sides)
    if root.tag == "mujoco":
        read = partial(_of_mjcf, path, text, numbers)
    found: ForeignRobot | ValueError
    try:
        found = read(False)
        if found.rolls:
            return found
    except ValueError as error:
        found = error
    with suppress(ValueError):
        if read(True).rolls:
            angle = _RIGHT_ANGLES[root.tag]
            found = ValueError(f"only with angles in the other unit its wheels can roll: {angle}")
    if isinstance(found, ValueError):
        raise found
    return found


def _plain_name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_-")[:60]


# ------------------------------------------------------------------------------------ xacro
def _is_xacro(root: ElementTree.Element) -> bool:
    """Return whether a tree has something to expand; comments are not in it."""
    for element in root.iter():
        if "xacro" in element.tag:
            return True
        words = [element.text or "", *element.attrib.values()]
        if any("${" in word or "$(" in word for word in words):
            return True
    return False


def _expanded(path: Path) -> str:
    """Return a xacro file, expanded in a child process by the package `xacro`.

    Raises:
        ValueError: it is not installed, or cannot; the message has the command.
    """
    command = f"xacro {path.name} > {path.name.removesuffix('.xacro').removesuffix('.urdf')}.urdf"
    if util.find_spec("xacro") is None:
        raise ValueError(
            f"this is a xacro file; expand it first: {command}; or install the extra `xacro`"
        )
    allowance = (_XACRO_TIME, *foreign.ALLOWANCE[1:])
    try:
        text, _ = guarded.ask(_expand_xacro, [str(path.resolve())], allowance)
    except ValueError as error:
        raise ValueError(
            f"this is a xacro file that cannot be expanded here ({one_line(error)}); "
            f"expand it first, where its packages are: {command}"
        ) from error
    return str(text)


def _expand_xacro(path: str) -> guarded.Answer:
    """Return the text of an expanded xacro file, for `guarded.ask`."""
    import xacro  # type: ignore[import-not-found, import-untyped, unused-ignore]

    return xacro.process_file(path).toxml(), ()


# ------------------------------------------------------------------------------------ URDF
def _of_urdf(
    path: Path, text: str, numbers: NumbersByName, sides: Mapping[str, float], in_degrees: bool
) -> ForeignRobot:
    """Return the robot of a URDF or an SDF; `numbers` and `sides` are its controller's.

    `in_degrees` takes its angles for degrees.

    Raises:
        ValueError: as `read_foreign`.
    """
    root = foreign.xml_tree(text)
    gazebo.require_plain_wheels(root)
    contacts = gazebo.contact_numbers(root)
    falls = root.findtext("world/gravity", "1").strip("0. -") != ""
    kind = "urdf"
    if root.tag == "sdf":
        kind = "sdf"
        for pose in root.iter("pose") if in_degrees else ():
            pose.set("degrees", "true")
        root = urdf_of_sdf(root)
    for origin in root.iter("origin") if in_degrees and kind == "urdf" else ():
        angles = [math.radians(float(word)) for word in origin.get("rpy", "").split()]
        origin.set("rpy", " ".join(map(repr, angles)))
    if root.find("link") is None:
        raise ValueError("this is no URDF: there is no <robot> with a <link>")
    motors = _motorised(root)
    limits = _limits(root)
    held = any(link.get("held", 0.0) > 0.0 for link in contacts.values())
    held |= any((part.text or "").strip() in ("1", "true") for part in root.iter("static"))
    spec = _readable(root)
    tensors = _tensors(spec)
    foreign.mend_inertia(spec)
    for body in spec.bodies:
        link = contacts.get(body.name, {})
        if link.get("weightless", 0.0) > 0.0 or not link.get("gravity", falls):
            body.gravcomp = 1.0
    wheeled = WheeledRobot(spec.compile())
    surfaces = []
    for body in wheeled.bodies:
        merged = NumbersByName()
        for part in wheeled.group(body):
            merged |= contacts.get(wheeled.model.body(part).name, {})
        surfaces.append(merged)
    joints = [wheeled.model.joint(joint).name for joint in wheeled.joints]
    torque = numbers.get("torque", np.inf)
    for joint in sides.keys() & limits.keys():
        limits[joint]["effort"] = min(torque, limits[joint].get("effort", np.inf))
    return ForeignRobot(
        file=one_line(path.name),
        name=_plain_name(root.get("name", "")),
        kind=kind,
        wheeled=wheeled,
        contacts=surfaces,
        limits=[limits.get(joint, NumbersByName()) for joint in joints],
        motorised=all(joint in motors for joint in joints),
        tensors=tensors,
        controller=numbers | {"held": float(held)},
        sides=sides,
        text=text,
        files={},
    )


def _plain_links(root: ElementTree.Element) -> list[ElementTree.Element]:
    """Return links as MuJoCo takes them: without looks, meshes and half an inertia."""
    links = root.findall("link")
    for link in links:
        for part in (*link.findall("visual"), *link.findall("collision")):
            if part.tag == "visual" or part.find(".//mesh") is not None:
                link.remove(part)
        for inertial in link.findall("inertial"):
            if inertial.find("mass") is None or inertial.find("inertia") is None:
                link.remove(inertial)
        for tensor in link.iter("inertia"):
            zeros = dict.fromkeys(_TENSOR, "0")
            tensor.attrib |= zeros | tensor.attrib
    return links


def _plain_joints(root: ElementTree.Element) -> list[ElementTree.Element]:
    """Return joints without limits on continuous ones; all that are no hinges are fixed at zero.

    Revolute joints of many turns are continuous. What one joint does of another is left out.
    """
    joints = root.findall("joint")
    for joint in joints:
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        limit = joint.find("limit")
        if joint.get("type") == "revolute" and limit is not None and _turns(limit) > _FEW_TURNS:
            joint.set("type", "continuous")
        axis = joint.find("axis")
        if axis is not None and not axis.get("xyz", "1").strip("0. -"):
            # no simulator turns it
            joint.set("type", "fixed")
        if joint.get("type") == "continuous":
            # of torque and speed; MuJoCo would take it for one of the angle
            for limit in joint.findall("limit"):
                joint.remove(limit)
        elif joint.get("type") != "revolute":
            joint.set("type", "fixed")
    return joints


def _turns(limit: ElementTree.Element) -> float:
    """Return the range of a joint [rad]; SDF's default is endless, that of a URDF is 0."""
    return _limit_number(limit, "upper") - _limit_number(limit, "lower")


def _limit_number(limit: ElementTree.Element, key: str) -> float:
    """Return a number of a <limit>; 0 where there is none."""
    word = limit.get(key, "").strip() or "0"
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"a <limit> has {key}='{one_line(word)}', wanted a number") from None


def _motorised(root: ElementTree.Element) -> set[str | None]:
    """Return the joints that have a transmission, or a command interface of ros2_control."""
    names = set()
    for owner in root.findall("transmission"):
        names |= {joint.get("name") for joint in owner.iter("joint")}
    for owner in root.findall("ros2_control"):
        for joint in owner.iter("joint"):
            if joint.find("command_interface") is not None:
                names.add(joint.get("name"))
    return names


def _limits(root: ElementTree.Element) -> dict[str, NumbersByName]:
    """Return limits of effort [N m], velocity [rad/s] and angle [rad], by joint.

    Negative ones are none, as in an SDF; of 0 there is `nothing`, for simulators differ in whether
    that is a limit.
    """
    limits = {}
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        numbers = NumbersByName()
        if limit is not None:
            if joint.get("type") == "revolute":
                numbers["range"] = _turns(limit)
            for key in {"effort", "velocity"}.intersection(limit.keys()):
                value = _limit_number(limit, key)
                if 0.0 < value < np.inf:
                    numbers[key] = value
                elif value == 0.0:
                    numbers["nothing"] = 1.0
        limits[joint.get("name", "")] = numbers
    return limits


def _readable(root: ElementTree.Element) -> mujoco.MjSpec:
    """Return the links and joints of a URDF as MuJoCo reads them; the tree loses looks and meshes.

    Moments of inertia that no body has become their mean about every axis.

    Raises:
        ValueError: MuJoCo cannot read it.
    """
    links = _plain_links(root)
    joints = _plain_joints(root)
    carried = {child.get("link") for joint in joints for child in joint.findall("child")}
    first = [link.get("name", "") for link in links if link.get("name") not in carried]
    if len(first) != 1:
        raise ValueError(
            f"links and joints are no tree: {len(first)} links hang on nothing, wanted one"
        )
    # MuJoCo merges links that cannot move with the world
    standing = ElementTree.Element("joint", name=_ROOT, type="prismatic")
    ElementTree.SubElement(standing, "parent", link=_ROOT)
    ElementTree.SubElement(standing, "child", link=first[0])
    plain = ElementTree.Element("robot", name="robot")
    settings = ElementTree.SubElement(plain, "mujoco")
    ElementTree.SubElement(
        settings,
        "compiler",
        fusestatic="false",
        discardvisual="true",
        inertiafromgeom="false",
        boundmass=repr(LEAST_MASS),
        boundinertia="1e-12",
    )
    plain.extend([ElementTree.Element("link", name=_ROOT), *links, *joints, standing])
    try:
        text = ElementTree.tostring(plain, encoding="unicode")
        foreign.try_compiling(text, tolerant=True)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"MuJoCo cannot read this URDF: {one_line(error)}") from error
    return mujoco.MjSpec.from_string(text)


def _tensors(spec: mujoco.MjSpec) -> dict[str, tuple[float, FloatArray]]:
    """Return mass and (3, 3) inertia that a file says of its bodies, by name."""
    tensors = {}
    for body in spec.bodies:
        if not body.explicitinertial or not body.name:
            continue
        tensors[body.name] = float(body.mass), foreign.inertia_tensor(body)
    return tensors


def flaw_of_inertia(tensor: FloatArray, most: float = np.inf) -> str:
    """Return why no rigid body has a (3, 3) inertia; empty for one that can be.

    `most` is the greatest moment that mass and size allow [kg m2].
    """
    moments = np.linalg.eigvalsh(tensor)
    least = float(moments[0])
    greatest = float(moments[2])
    if least < 0.0:
        return f"with its products, it is {least:.4g} about one axis"
    if 2.0 * greatest > moments.sum() * (1.0 + 1e-3):
        return "about one axis it is more than about the two others together"
    if greatest <= ROUNDED * most:
        return ""
    # of a body that is full, it is about half of that
    _, unit = min(
        (abs(np.log(2.0 * greatest * size / most)), unit) for unit, size in _UNITS.items()
    )
    asked = "" if unit == "kg m2" else f" (is it in {unit}?)"
    return f"mass and size allow {most:.4g} at most{asked}"


# ------------------------------------------------------------------------------------ MJCF
def _of_mjcf(path: Path, text: str, controller: NumbersByName, other_angle: bool) -> ForeignRobot:
    """Return the robot of an MJCF, if told so with angles in the unit that it does not say.

    Raises:
        ValueError: as `read_foreign`.
    """
    try:
        text, files = foreign.try_compiling(text, path.parent, tolerant=True)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"MuJoCo cannot read this MJCF: {one_line(error)}") from error
    root = foreign.xml_tree(text)
    gazebo.require_plain_wheels(root)
    spec = mujoco.MjSpec.from_string(text, assets=files)
    spec.compiler.degree ^= other_angle
    foreign.name_parts(spec)
    tensors = _tensors(spec)
    foreign.complete_spec(spec, files)
    wheeled = WheeledRobot(spec.compile(), any_direction=True)
    return ForeignRobot(
        file=one_line(path.name),
        name=_plain_name(root.get("model", "")) or _plain_name(path.stem),
        kind="mjcf",
        wheeled=wheeled,
        contacts=[wheeled.tyre_contact(joint) for joint in wheeled.joints],
        limits=wheeled.limits_of_motors(),
        motorised=bool(motor_moments(wheeled.model, wheeled.joints).any(axis=0).all()),
        tensors=tensors,
        controller=controller,
        sides={},
        text=text,
        files=files,
    )
