"""A URDF -> what MuJoCo's reader makes of it: bodies with their places, masses and shapes, and joints.

Only numbers go to MuJoCo: links, joints, moments of inertia and plain shapes are written into a new text, so that no mesh,
plug-in or entity of the file is ever looked for.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.files import reading
from validation.simulator.description import RobotError
from validation.words import one_line

MOST_BYTES = 1 << 22
"""Greatest size of a URDF [bytes]; large ones of manipulators have a few hundred thousand."""
MOST_LINKS = 2000
"""Greatest number of links."""
_MOST_DEPTH = 50
"""Greatest depth of elements inside one another."""
_SHAPES: Mapping[str, tuple[str, ...]] = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
"""Plain shapes and their attributes; meshes are left out."""
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_TINY = 1e-30
"""Numbers below this in size are zero: MuJoCo reads none below those that a double holds with all its digits."""
_LEAST_MASS = 1e-9
"""Mass that MuJoCo gives to links without one [kg], so that it takes them."""
_ROOT = "ssmr_world"
"""Name of a link that the robot stands on: MuJoCo merges the first link of all with the world."""


@dataclass(frozen=True, eq=False)
class UrdfShape:
    """A plain shape of a link."""

    kind: str
    """`box`, `cylinder` or `sphere`."""
    centre: FloatArray
    """(3,) middle [m]."""
    rotation: FloatArray
    """(3, 3) axes as columns; a cylinder's is the last."""
    collides: bool
    """Whether it is a shape of collision."""
    size: FloatArray
    """(3,) half lengths [m] of the box around it, along its own axes."""


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link where it is when all joints are at zero, in the frame of the first link."""

    name: str
    """Name of the link."""
    parent: str
    """Name of the link that it hangs on; empty for the first."""
    joint: str
    """Name of the joint between them; empty for the first."""
    joint_type: str
    """`continuous`, `revolute`, `fixed` and so on."""
    place: FloatArray
    """(3,) origin of its frame [m]."""
    rotation: FloatArray
    """(3, 3) axes of its frame as columns."""
    axis: FloatArray
    """(3,) unit vector of the joint's axis."""
    mass: float
    """Mass [kg]."""
    com: FloatArray
    """(3,) centre of mass [m]."""
    inertia: FloatArray
    """(3, 3) inertia tensor about the centre of mass, along the axes of the first link [kg m2]."""
    shapes: tuple[UrdfShape, ...]
    """Its plain shapes; those of collision before those that are only looked at."""
    effort: float
    """Greatest torque that the joint's limit says [N m]; 0 for none."""
    velocity: float
    """Greatest rate that the joint's limit says [rad/s]; 0 for none."""


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """All links of a URDF."""

    name: str
    """Name of the robot in the file."""
    links: Mapping[str, UrdfLink]
    """Links by name."""
    meshes: tuple[str, ...]
    """Names of the links whose shapes are meshes, which are not read."""
    impossible: tuple[str, ...]
    """Names of the links with moments of inertia that no body has; MuJoCo takes their mean about every axis."""
    words: str
    """Names of links, joints and mesh files, in small letters, in which kinds of wheels are named."""

    def above(self, name: str) -> Iterator[UrdfLink]:
        """Yield the links that a link hangs on, the nearest first."""
        link = self.links[name]
        while link.parent:
            link = self.links[link.parent]
            yield link

    def below(self, name: str) -> list[UrdfLink]:
        """Return a link and all that hang on it."""
        return [
            link for link in self.links.values() if link.name == name or any(up.name == name for up in self.above(link.name))
        ]


def read_urdf(path: str | Path) -> UrdfTree:
    """Return the links of a URDF as MuJoCo reads them.

    Raises:
        RobotError: the file cannot be read, is no URDF, or says something that cannot be; the message is one line.
    """
    try:
        text = reading.read_text(path, MOST_BYTES)
    except ValueError as error:
        raise RobotError(str(error)) from error
    try:
        return parse_urdf(text)
    except ValueError as error:
        raise RobotError(f"{path}: {one_line(error)}") from error


def parse_urdf(text: str) -> UrdfTree:
    """Return the links of a URDF's text as MuJoCo reads them.

    Raises:
        ValueError: it is no URDF, or says something that cannot be.
    """
    root = _parsed(text)
    plain, joints, meshes = _plain_text(root)
    model = _compiled(plain)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    links = {name: _link(model, data, name, joints.get(name)) for name in _names(root.findall("link"), "link")}
    names = [*links, *(link.joint for link in links.values()), *(mesh.get("filename", "") for mesh in root.iter("mesh"))]
    return UrdfTree(one_line(root.get("name", "")), links, meshes, _impossible(root), " ".join(names).lower())


def _impossible(root: ElementTree.Element) -> tuple[str, ...]:
    """Return the names of links with moments of inertia that no body has."""
    found = []
    for link in root.findall("link"):
        tensor = link.find("inertial/inertia")
        if tensor is not None:
            xx, xy, xz, yy, yz, zz = (float(_numbers(tensor, key, "0", 1)) for key in _MOMENTS)
            moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
            if moments[0] < -1e-9 * abs(moments[2]) or moments[0] + moments[1] < moments[2] * (1.0 - 1e-6):
                found.append(link.get("name", ""))
    return tuple(found)


def _parsed(text: str) -> ElementTree.Element:
    """Return the tree of a URDF's text.

    Raises:
        ValueError: it declares entities, is no XML, is nested too deep, or is another kind of document.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("the file declares a document type or entities, which a URDF has no use for; take them out")
    try:
        root = ElementTree.fromstring(text)  # nosec B314 # without declarations there are no entities to grow
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"this is no XML ({one_line(error)})") from error
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > _MOST_DEPTH:
            raise ValueError(f"elements lie more than {_MOST_DEPTH} deep inside one another")
    if root.tag != "robot" or root.find("link") is None:
        raise ValueError("this is no URDF: there is no <robot> with a <link>")
    if any("xacro" in element.tag for element in root.iter()):
        raise ValueError("this is a xacro file; expand it first: xacro FILE.xacro > FILE.urdf")
    if len(root.findall("link")) > MOST_LINKS:
        raise ValueError(f"there are more than {MOST_LINKS} links")
    return root


def _names(elements: list[ElementTree.Element], kind: str) -> list[str]:
    """Return the names of elements.

    Raises:
        ValueError: one has none, or one stands twice.
    """
    names = [element.get("name", "") for element in elements]
    if "" in names:
        raise ValueError(f"a {kind} has no name")
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"there are two {kind}s '{twice}'")
    return names


def _numbers(element: ElementTree.Element | None, key: str, usual: str, count: int) -> str:
    """Return numbers of an attribute as text, checked.

    Raises:
        ValueError: they are not as many finite numbers.
    """
    text = usual if element is None else element.get(key, usual)
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(v) and abs(v) < 1e6 for v in values):
        tag = "" if element is None else f"<{element.tag}> "
        raise ValueError(f"{tag}{key} is '{one_line(text)[:60]}', wanted {count} number{'s' * (count > 1)}")
    return " ".join(f"{v if abs(v) > _TINY else 0.0!r}" for v in values)


@dataclass(frozen=True, eq=False)
class _Joint:
    name: str
    kind: str
    parent: str
    effort: float
    velocity: float


def _plain_text(root: ElementTree.Element) -> tuple[str, dict[str, _Joint], tuple[str, ...]]:
    """Return a URDF that holds only what is needed, the joints by the link that they carry, and links with meshes.

    Raises:
        ValueError: a number is none, or links and joints are no tree.
    """
    names = _names(root.findall("link"), "link")
    if _ROOT in names:
        raise ValueError(f"a link has the name '{_ROOT}', which is needed here")
    robot = ElementTree.Element("robot", name="robot")
    settings = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(
        settings, "compiler", inertiafromgeom="false", fusestatic="false", discardvisual="false", strippath="true",
        boundmass=repr(_LEAST_MASS), boundinertia=repr(1e-12), balanceinertia="true",
    )  # fmt: skip
    ElementTree.SubElement(robot, "link", name=_ROOT)
    meshes = []
    for link in root.findall("link"):
        copy = ElementTree.SubElement(robot, "link", name=link.get("name", ""))
        if link.find(".//mesh") is not None:
            meshes.append(link.get("name", ""))
        _copy_inertial(link, copy)
        for part in (*link.findall("collision"), *link.findall("visual")):
            _copy_shape(part, copy)
    joints = {}
    elements = [joint for joint in root.findall("joint") if joint.get("type")]
    _names(elements, "joint")
    for joint in elements:
        copied = _copy_joint(joint, robot, names)
        child = copied.find("child")
        assert child is not None
        carried = child.get("link", "")
        if carried in joints:
            raise ValueError(f"link '{carried}' hangs on two joints")
        joints[carried] = _joint_facts(joint, copied)
    first = [name for name in names if name not in joints]
    if len(first) != 1:
        raise ValueError(f"links and joints are no tree: {len(first)} links hang on nothing, wanted one")
    _require_tree(joints, names)
    standing = ElementTree.SubElement(robot, "joint", name=_ROOT, type="fixed")
    ElementTree.SubElement(standing, "parent", link=_ROOT)
    ElementTree.SubElement(standing, "child", link=first[0])
    return ElementTree.tostring(robot, encoding="unicode"), joints, tuple(meshes)


def _require_tree(joints: Mapping[str, _Joint], names: list[str]) -> None:
    for name in names:
        passed, at = set[str](), name
        while at in joints:
            if at in passed:
                raise ValueError(f"link '{name}' hangs on itself")
            passed.add(at)
            at = joints[at].parent


def _copy_origin(source: ElementTree.Element, target: ElementTree.Element) -> None:
    origin = source.find("origin")
    ElementTree.SubElement(
        target, "origin", xyz=_numbers(origin, "xyz", "0 0 0", 3), rpy=_numbers(origin, "rpy", "0 0 0", 3)
    )


def _copy_inertial(link: ElementTree.Element, copy: ElementTree.Element) -> None:
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return
    value = _numbers(mass, "value", "0", 1)
    if float(value) < 0.0:
        raise ValueError(f"link '{link.get('name')}' has a mass of {float(value):g} kg")
    if float(value) == 0.0:
        return
    target = ElementTree.SubElement(copy, "inertial")
    _copy_origin(inertial, target)
    ElementTree.SubElement(target, "mass", value=value)
    tensor = inertial.find("inertia")
    ElementTree.SubElement(target, "inertia", {key: _numbers(tensor, key, "0", 1) for key in _MOMENTS})


def _copy_shape(part: ElementTree.Element, copy: ElementTree.Element) -> None:
    geometry = part.find("geometry")
    for kind, attributes in _SHAPES.items():
        shape = None if geometry is None else geometry.find(kind)
        if shape is None:
            continue
        sizes = {key: _numbers(shape, key, "", 3 if kind == "box" else 1) for key in attributes}
        if any(float(v) <= 0.0 for text in sizes.values() for v in text.split()):
            continue  # a shape without a size, as some files have it for nothing at all
        target = ElementTree.SubElement(copy, part.tag)
        _copy_origin(part, target)
        ElementTree.SubElement(ElementTree.SubElement(target, "geometry"), kind, sizes)


def _copy_joint(joint: ElementTree.Element, robot: ElementTree.Element, names: list[str]) -> ElementTree.Element:
    kind, name = joint.get("type", ""), joint.get("name", "")
    if kind not in ("fixed", "continuous", "revolute", "prismatic", "planar", "floating"):
        raise ValueError(f"joint '{one_line(name)}' has the type '{one_line(kind)}', which URDF does not know")
    # what moves in other ways than a wheel is taken where it stands at zero
    copy = ElementTree.SubElement(
        robot, "joint", name=name, type="continuous" if kind in ("continuous", "revolute") else "fixed"
    )
    _copy_origin(joint, copy)
    for end in ("parent", "child"):
        element = joint.find(end)
        link = "" if element is None else element.get("link", "")
        if link not in names:
            raise ValueError(f"joint '{one_line(name)}' names the {end} '{one_line(link)}', and there is no such link")
        ElementTree.SubElement(copy, end, link=link)
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0", 3)
    if not any(map(float, axis.split())):
        axis = "1.0 0.0 0.0"
    ElementTree.SubElement(copy, "axis", xyz=axis)
    return copy


def _joint_facts(joint: ElementTree.Element, copy: ElementTree.Element) -> _Joint:
    limit, parent = joint.find("limit"), copy.find("parent")
    assert parent is not None
    effort, velocity = (float(_numbers(limit, key, "0", 1)) for key in ("effort", "velocity"))
    return _Joint(joint.get("name", ""), joint.get("type", ""), parent.get("link", ""), max(effort, 0.0), max(velocity, 0.0))


def _compiled(text: str) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise ValueError(f"MuJoCo cannot read this URDF: {one_line(error)}") from error


def _link(model: mujoco.MjModel, data: mujoco.MjData, name: str, joint: _Joint | None) -> UrdfLink:
    body = model.body(name).id
    first = int(model.body(name).rootid[0])
    turn = data.xmat[first].reshape(3, 3).T  # into the first link's frame
    origin = data.xpos[first]
    mass = float(model.body_mass[body])
    principal = turn @ data.ximat[body].reshape(3, 3)
    tensor = principal @ np.diag(model.body_inertia[body]) @ principal.T
    axis = np.array([1.0, 0.0, 0.0])
    if joint is not None and model.body_jntnum[body] == 1 and first != body:
        axis = turn @ data.xaxis[model.body_jntadr[body]]
    geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    collided = sorted(geoms, key=lambda g: model.geom_contype[g] == 0)
    empty = mass <= 2.0 * _LEAST_MASS
    return UrdfLink(
        name, "" if joint is None else joint.parent, "" if joint is None else joint.name,
        "" if joint is None else joint.kind, turn @ (data.xpos[body] - origin), turn @ data.xmat[body].reshape(3, 3), axis,
        0.0 if empty else mass, turn @ (data.xipos[body] - origin), np.zeros((3, 3)) if empty else tensor,
        tuple(_shape(model, data, g, turn, origin) for g in collided), 0.0 if joint is None else joint.effort,
        0.0 if joint is None else joint.velocity,
    )  # fmt: skip


def _shape(model: mujoco.MjModel, data: mujoco.MjData, geom: int, turn: FloatArray, origin: FloatArray) -> UrdfShape:
    size, kind = model.geom_size[geom], mujoco.mjtGeom(int(model.geom_type[geom]))
    centre, rotation = turn @ (data.geom_xpos[geom] - origin), turn @ data.geom_xmat[geom].reshape(3, 3)
    names = {mujoco.mjtGeom.mjGEOM_BOX: "box", mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder"}
    half = {"box": size, "cylinder": size[[0, 0, 1]]}.get(names.get(kind, ""), np.full(3, size[0]))
    collides = bool(model.geom_contype[geom] != 0)
    return UrdfShape(names.get(kind, "sphere"), centre, rotation, collides, np.array(half))
