"""An SDF model as the links and joints of a URDF, which one reader takes for both."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ElementTree  # nosec B405 # of trees that were parsed before
from collections.abc import Iterable

import numpy as np

from ssmr.types import FloatArray
from validation.output import one_line

_MODEL = "__model__"
_TURNING = ("revolute", "continuous")
_MOST_CHAIN = 100
"""Greatest length of a chain of frames, each given in the next."""


def urdf_of_sdf(root: ElementTree.Element) -> ElementTree.Element:
    """Return the model of an SDF, or of its world, that has the most turning joints, as a URDF.

    Surfaces and plugins are left where they stand; links and joints are in the model's frame.

    Raises:
        ValueError: there is no model with a link, it holds or includes other models, or a pose is
            no pose.
    """
    models = [model for model in root.iter("model") if model.find("link") is not None]
    if not models:
        raise ValueError("this SDF has no <model> with a <link>")
    model = max(models, key=_turning_joints)
    inner = model.find("model")
    if inner is not None:
        raise ValueError(
            f"its model '{model.get('name')}' holds the model '{inner.get('name')}'; "
            "write the links and joints of both into one"
        )
    included = model.findtext("include/uri")
    if included is not None:
        raise ValueError(
            f"its model '{model.get('name')}' includes {included}; "
            "write the links and joints of that into the file"
        )
    robot = ElementTree.Element("robot", name=model.get("name", "robot"))
    robot.extend(model.findall("static"))
    frames = _Frames(model)
    joints = [joint for joint in model.findall("joint") if joint.findtext("parent") != "world"]
    carried = {_text(joint, "child"): joint for joint in joints}
    places = {}
    for link in model.findall("link"):
        name = link.get("name", "")
        # the frame of a URDF's link is that of the joint which carries it
        joint = carried.get(name)
        places[name] = frames.of(name if joint is None else joint.get("name", ""))
        robot.append(_link(link, np.linalg.inv(places[name]) @ frames.of(name)))
    for joint in joints:
        parent = _text(joint, "parent")
        child = _text(joint, "child")
        if parent not in places or child not in places:
            raise ValueError(f"joint '{joint.get('name')}' joins a link that is not there")
        robot.append(_joint(joint, np.linalg.inv(places[parent]) @ places[child], frames))
    return robot


def _turning_joints(model: ElementTree.Element) -> int:
    return sum(joint.get("type") in _TURNING for joint in model.findall("joint"))


def _text(element: ElementTree.Element, tag: str, otherwise: str = "") -> str:
    return (element.findtext(tag) or otherwise).strip()


class _Frames:
    """Places of a model's links, joints and frames in the model's frame."""

    def __init__(self, model: ElementTree.Element) -> None:
        """Collect the frames by name."""
        self.elements = {}
        for kind in ("frame", "joint", "link"):
            for element in model.findall(kind):
                self.elements[element.get("name", "")] = element
        self._known = dict[str, FloatArray]()

    def of(self, name: str, depth: int = 0) -> FloatArray:
        """Return the (4, 4) transform from a frame to the model's.

        Raises:
            ValueError: there is no such frame, or it is given in itself.
        """
        if name in ("", _MODEL):
            return np.eye(4)
        if name in self._known:
            return self._known[name]
        if name not in self.elements or depth > _MOST_CHAIN:
            raise ValueError(f"its frame '{name}' is not there, or is given in itself")
        element = self.elements[name]
        base = ""
        if element.tag == "joint":
            base = _text(element, "child")
        elif element.tag == "frame":
            base = element.get("attached_to", "")
        pose = element.find("pose")
        if pose is not None:
            base = pose.get("relative_to", base)
        self._known[name] = self.of(base, depth + 1) @ _pose(pose)
        return self._known[name]


def _pose(pose: ElementTree.Element | None) -> FloatArray:
    """Return the (4, 4) transform of a <pose>; that of none is the identity."""
    transform = np.eye(4)
    text = "" if pose is None else (pose.text or "").strip()
    if pose is None or not text:
        return transform
    from scipy.spatial.transform import Rotation  # here: it takes long to import

    numbers = _numbers(text, 6, "a pose", "x y z roll pitch yaw")
    turn = Rotation.from_euler("xyz", numbers[3:], degrees=_is_true(pose.get("degrees")))
    transform[:3, :3] = turn.as_matrix()
    transform[:3, 3] = numbers[:3]
    return transform


def _numbers(text: str, count: int, what: str, order: str) -> FloatArray:
    """Return the numbers of a text; a ValueError where they are others than wanted."""
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ValueError(f"{what} is '{one_line(text)}', wanted {count} numbers: {order}")
    return numbers


def _is_true(word: str | None) -> bool:
    return word in ("1", "true")


def _origin(transform: FloatArray) -> ElementTree.Element:
    """Return the <origin> of a transform."""
    from scipy.spatial.transform import Rotation  # here: it takes long to import

    with warnings.catch_warnings():
        # pitched by 90 degrees, roll and yaw are about one axis, and yaw is 0
        warnings.simplefilter("ignore", UserWarning)
        angles = Rotation.from_matrix(transform[:3, :3]).as_euler("xyz")
    return ElementTree.Element("origin", xyz=_row(transform[:3, 3]), rpy=_row(angles))


def _row(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _link(link: ElementTree.Element, shift: FloatArray) -> ElementTree.Element:
    """Return a URDF's link; `shift` leads from the SDF's link to it."""
    out = ElementTree.Element("link", name=link.get("name", ""))
    inertial = link.find("inertial")
    if inertial is not None:
        # SDFormat's defaults are 1 kg and 1 kg m2
        part = ElementTree.SubElement(out, "inertial")
        part.append(_origin(shift @ _pose(inertial.find("pose"))))
        ElementTree.SubElement(part, "mass", value=_text(inertial, "mass", "1"))
        tensor = {}
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            usual = "1" if key[1] == key[2] else "0"
            tensor[key] = _text(inertial, f"inertia/{key}", usual)
        ElementTree.SubElement(part, "inertia", tensor)
    for collision in link.findall("collision"):
        shape = _shape(collision.find("geometry"))
        if shape is not None:
            part = ElementTree.SubElement(out, "collision")
            part.append(_origin(shift @ _pose(collision.find("pose"))))
            ElementTree.SubElement(part, "geometry").append(shape)
    return out


def _shape(geometry: ElementTree.Element | None) -> ElementTree.Element | None:
    """Return the shape of a URDF; None for one that it does not have.

    An ellipsoid becomes the sphere around it: a wheel's radius stays.
    """
    if geometry is None:
        return None
    for shape in geometry:
        size = _texts_of(shape)
        if shape.tag in ("box", "cylinder", "sphere", "capsule"):
            return ElementTree.Element(shape.tag, size)
        if shape.tag == "ellipsoid":
            radii = _numbers(size.get("radii", ""), 3, "the radii of an ellipsoid", "x y z")
            return ElementTree.Element("sphere", radius=repr(float(radii.max())))
    return None


def _joint(joint: ElementTree.Element, place: FloatArray, frames: _Frames) -> ElementTree.Element:
    """Return a URDF's joint, whose axis is in the frame of the child."""
    name = joint.get("name", "")
    kind = joint.get("type", "fixed")
    out = ElementTree.Element("joint", name=name, type=kind)
    out.append(_origin(place))
    for end in ("parent", "child"):
        ElementTree.SubElement(out, end, link=_text(joint, end))
    axis = joint.find("axis")
    if axis is None:
        return out
    direction = _numbers(_text(axis, "xyz", "0 0 1"), 3, f"the axis of joint '{name}'", "x y z")
    xyz = axis.find("xyz")
    base = name if xyz is None else xyz.get("expressed_in", name)
    if _is_true(axis.findtext("use_parent_model_frame")):
        base = _MODEL
    turn = np.linalg.inv(frames.of(name))[:3, :3] @ frames.of(base)[:3, :3]
    ElementTree.SubElement(out, "axis", xyz=_row(turn @ direction))
    if kind == "revolute" and axis.find("limit/upper") is None:
        out.set("type", "continuous")
    for part in (*axis.findall("limit"), *axis.findall("dynamics")):
        ElementTree.SubElement(out, part.tag, _texts_of(part))
    return out


def _texts_of(element: ElementTree.Element) -> dict[str, str]:
    """Return the texts of an element's children, by tag."""
    return {child.tag: (child.text or "").strip() for child in element}
