"""A new robot's file, of a few numbers, or of a URDF by MuJoCo's own reader.

It separates numbers that were given from those that had to be guessed.
MuJoCo gets links and joints without meshes, which are never looked for; tyres and hull are read off
the shapes of collision.
"""

from __future__ import annotations

import re
import textwrap
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import tomli_w
from mujoco import mjtGeom

from ssmr.parameters import declaration
from ssmr.robot.ground import FRONT, LEFT
from ssmr.types import FloatArray
from validation import store
from validation.files import reading
from validation.simulator import foreign
from validation.simulator.checking import spot_turn, turning_torque
from validation.simulator.description import (
    SCHEMA,
    SECTIONS,
    Robot,
    RobotError,
    parse_robot,
    shipped_robots,
)
from validation.words import one_line

_ROOT = "ssmr_world"
"""Name of a link that the robot stands on, and of its joint: MuJoCo merges the first link of all
with the world."""
_LEAST_MASS = 1e-9
"""Mass that MuJoCo gives to bodies without one [kg], so that it takes them."""
_PARALLEL = 0.985
"""Least share of y in the axis of a wheel [1]: ten degrees."""
_UPRIGHT = 0.9
"""Least share of z in the axis of a joint that steers [1]."""
_SAME_SIZE = 0.02
"""Greatest difference of two tyres of one size, over the larger [1]."""
_ASKEW = 0.05
"""Greatest distance of a wheel from the corner of a rectangle, over its shorter side [1]."""
_SIDEWAYS_WORDS = re.compile(r"mecanum|omni_?wheel|swedish")
SURE_FRICTION = 1.0
"""Friction of ground on which motors whose torque nobody knows are taken to turn the robot on the
spot [1]."""
_UNITS_OF_LISTS = dict.fromkeys(("body_size", "body_centre", "imu", "com"), "m")
_UNITS_OF_LISTS |= dict.fromkeys(("wheel_inertia", "inertia"), "kg m2")
_NEXT = (
    "next: weigh each of the four wheels (com), measure the hull between the tyres (body_size, "
    "body_centre), count the wheels' turns over a metre (wheel_radius), and drag the robot "
    "sideways with a spring scale (friction)"
)
_HEADING = (
    "What this file does not say is estimated; `python -m validation.robots check` shows it. "
    "Measure a number, write it into its section, and say in [sources] where it is from."
)
Entries = dict[str, tuple[float | str | Sequence[float], str]]
"""Numbers [SI] and words of a new robot's file by section and name, such as `geometry.track`, with
`GRADE: source`."""


class RobotDraft(NamedTuple):
    """A new robot's file, before it is written."""

    robot: Robot
    """The robot that the file describes."""
    text: str
    """The robot as the file describes it."""
    remarks: Sequence[str]
    """Sentences on estimates and guesses, and on the next measurements."""


def unit_of_key(key: str) -> str:
    """Return the unit of a number of a robot's file, `section.key`; empty for a text."""
    section, _, name = key.partition(".")
    declared = declaration(SECTIONS[section][name])
    return _UNITS_OF_LISTS.get(name, "") if declared is None else declared.unit


def draft_robot(name: str, numbers: Mapping[str, float]) -> RobotDraft:
    """Return the file of a robot of which a tape measure and a scale gave a few numbers.

    Args:
        name: its name.
        numbers: numbers by `section.key` [SI]: at least wheelbase, track, radius and width of the
            wheels, and the mass.

    Raises:
        ValueError: the name is taken or cannot be one, or a number cannot be.
    """
    entries = Entries()
    for key, value in numbers.items():
        entries[key] = float(value), "measured: given to `new`"
    entries["geometry.link"] = "belt", "assumed: as most such robots"
    estimates = (
        "estimated from the size: com, inertia and wheels of [mass], the hull, gain and armature"
    )
    return _drafted(name, "", entries, (estimates, _NEXT))


def _drafted(name: str, description: str, entries: Entries, remarks: Sequence[str]) -> RobotDraft:
    """Return the file of a new robot.

    Where no entry says a torque limit, one is added that surely turns the robot on the spot.

    Raises:
        ValueError: the name is taken, or the entries say something that cannot be; the message
            names section and key.
    """
    if name in shipped_robots():
        raise ValueError(
            f"name '{one_line(name)}' belongs to a robot that comes with the package; take another"
        )
    document = _document(name, description, entries)
    robot = parse_robot(document)
    spot = spot_turn(robot)
    if "drive.torque_limit" not in robot.given and spot is not None:
        torque = float(f"{0.5 * SURE_FRICTION * turning_torque(robot, spot):.3g}")
        source = f"assumed: enough to turn on the spot on ground of friction {SURE_FRICTION:g}"
        document = _document(name, description, {**entries, "drive.torque_limit": (torque, source)})
        robot = parse_robot(document)
    heading = "".join(f"# {line}\n" for line in textwrap.wrap(_HEADING, 120))
    text = tomli_w.dumps(store.encodable(document))
    return RobotDraft(robot, heading + text, remarks)


def _document(name: str, description: str, entries: Entries) -> dict[str, Any]:
    """Return the content of the file, as TOML has it; numbers have nine digits."""
    document: dict[str, Any] = {"schema": SCHEMA, "name": name}
    if description:
        document["description"] = description
    sources = {}
    nine_digits = np.vectorize(lambda number: float(f"{number:.9g}"))
    for at, (value, source) in entries.items():
        section, _, key = at.partition(".")
        numbers = document.setdefault(section, {})
        numbers[key] = value if isinstance(value, str) else nine_digits(value).tolist()
        sources[at] = one_line(source)
    return document | {"sources": sources}


def import_robot(
    path: str | Path,
    name: str | None = None,
    wheel_radius: float | None = None,
    wheel_width: float | None = None,
) -> RobotDraft:
    """Return a robot's file made of a URDF.

    A wheel is a link on a continuous joint about the y axis.

    Args:
        path: the URDF of a robot that drives along x; a xacro file must be expanded before.
        name: the robot's name; the URDF's own if not given.
        wheel_radius: rolling radius of the wheels [m], measured; that of their cylinders if not
            given.
        wheel_width: width of the tyres [m], measured; that of their cylinders if not given.

    Raises:
        RobotError: the file cannot be read, is no URDF, or describes no robot with four fixed,
            plain wheels, or the name is taken.
    """
    try:
        text = reading.read_text(path, foreign.MOST_BYTES)
    except ValueError as error:
        raise RobotError(str(error)) from error
    try:
        root = _parsed(text)
        motors = _motorised(root)
        work = _Import(one_line(Path(path).name), _readable(root))
        work.add_link(motors)
        work.add_wheels(wheel_radius, wheel_width)
        work.add_masses()
        work.add_hull()
        urdf_name = re.sub(r"[^A-Za-z0-9_-]+", "_", root.get("name", "")).strip("_-")[:60]
        return work.finished(name or urdf_name or "robot")
    except ValueError as error:
        raise RobotError(f"{path}: {one_line(error)}") from error


def _parsed(text: str) -> ElementTree.Element:
    """Return the tree of a URDF's text.

    Raises:
        ValueError: it is no URDF, or its wheels are no plain ones.
    """
    root = foreign.xml_tree(text)
    if root.tag != "robot" or root.find("link") is None:
        raise ValueError("this is no URDF: there is no <robot> with a <link>")
    if "${" in text or any("xacro" in element.tag for element in root.iter()):
        raise ValueError("this is a xacro file; expand it first: xacro FILE.xacro > FILE.urdf")
    if _SIDEWAYS_WORDS.search(text.lower()):
        raise ValueError(
            "its wheels are mecanum or omni wheels, which roll sideways; "
            "a skid-steering robot has plain ones"
        )
    return root


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
            zeros = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
            tensor.attrib |= zeros | tensor.attrib
    return links


def _plain_joints(root: ElementTree.Element) -> list[ElementTree.Element]:
    """Return joints without limits on continuous ones; all that are no hinges are fixed at zero."""
    joints = root.findall("joint")
    for joint in joints:
        if joint.get("type") == "continuous":
            # of torque and speed; MuJoCo would take it for one of the angle
            for limit in joint.findall("limit"):
                joint.remove(limit)
        elif joint.get("type") != "revolute":
            joint.set("type", "fixed")
    return joints


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
        boundmass=repr(_LEAST_MASS),
        boundinertia="1e-12",
        balanceinertia="true",
    )
    plain.extend([ElementTree.Element("link", name=_ROOT), *links, *joints, standing])
    try:
        text = ElementTree.tostring(plain, encoding="unicode")
        foreign.tried_files(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"MuJoCo cannot read this URDF: {one_line(error)}") from error
    return mujoco.MjSpec.from_string(text)


class _Import:
    """An import under way: all that is no wheel is one body to MuJoCo.

    Places are in the frame of the first link [m].
    """

    def __init__(self, file: str, spec: mujoco.MjSpec) -> None:
        """Find the four wheels, and compute where everything is.

        Raises:
            ValueError: there are not four, they do not stand at the corners of a rectangle, or one
                can be steered.
        """
        self.file = file
        self.guesses = list[str]()
        self.entries = Entries()
        self._compile(spec)
        wheels = [self.model.joint(j).name for j in self._four_joints()]
        named = spec.body("base_link")
        level = 0.0 if named is None else float(self.data.xpos[named.id, 2])
        for joint in list(spec.joints):
            if joint.name not in (_ROOT, *wheels):
                spec.delete(joint)
        spec.compiler.fusestatic = True
        self._compile(spec)
        self.wheels = self._corners([self.model.joint(name).id for name in wheels], level)
        self.base = int(self.model.joint(_ROOT).bodyid[0])

    def _compile(self, spec: mujoco.MjSpec) -> None:
        """Make the model, and a state in which all joints stand at zero."""
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)

    def _four_joints(self) -> list[int]:
        """Return the joints of the four wheels; a ValueError says why they are none of a robot."""
        model = self.model
        axes = self.data.xaxis
        four = []
        for j in range(model.njnt):
            if not model.jnt_limited[j] and abs(axes[j, 1]) > _PARALLEL:
                four.append(j)
        if len(four) != 4:
            raise ValueError(
                f"it has {len(four)} joints that look like wheels, and a skid-steering robot has "
                f"four, continuous and about the y axis: {self._names(four)}"
            )
        for j in four:
            body = model.jnt_bodyid[j]
            while body := model.body_parentid[body]:
                up = model.body_jntadr[body]
                if up >= 0 and abs(axes[up, 2]) > _UPRIGHT:
                    raise ValueError(
                        f"wheel '{self._names([j])}' can be steered by joint "
                        f"'{self._names([up])}'; the wheels of a skid-steering robot cannot"
                    )
        return four

    def _names(self, joints: Iterable[int]) -> str:
        """Return the names of joints for a message, at most eight."""
        names = [one_line(self.model.joint(j).name) for j in joints]
        if len(names) > 8:
            names[8:] = ["…"]
        return ", ".join(names) or "none"

    def _corners(self, joints: Sequence[int], level: float) -> list[int]:
        """Return the wheels' bodies in the order of `WHEELS`, and add wheelbase and track.

        The base frame lies midway between the axles, at the height of base_link, `level`.
        """
        model = self.model
        places = self.data.xanchor[list(joints)]
        middle = places.mean(axis=0)
        ahead, aside, _ = (places - middle).T
        order = np.lexsort((-aside, ahead < 0.0)).tolist()
        x = np.abs(ahead).mean()
        y = np.abs(aside).mean()
        wheelbase = 2.0 * float(x)
        track = 2.0 * float(y)
        askew = float(np.abs([ahead[order] - x * FRONT, aside[order] - y * LEFT]).max())
        if askew > _ASKEW * min(wheelbase, track):
            raise ValueError(
                "the four wheels do not stand at the corners of a rectangle: of "
                f"{self._names(joints)} one is {1e3 * askew:.0f} mm away from that of "
                f"{wheelbase:.3f} by {track:.3f} m"
            )
        where = f"joints {self._names(joints[k] for k in order)}"
        self.add("geometry.wheelbase", wheelbase, where)
        self.add("geometry.track", track, where)
        self.origin = np.array([*middle[:2], level])
        height = float(middle[2] - level)
        self.add("geometry.axle_height", height, "the same joints above base_link")
        return [int(model.jnt_bodyid[joints[k]]) for k in order]

    def add(self, key: str, value: float | FloatArray, where: str) -> None:
        """Add a number that the URDF says."""
        plain = value if isinstance(value, float) else value.tolist()
        self.entries[key] = plain, f"published: {self.file}, {where}"

    def add_link(self, motors: Container[str | None]) -> None:
        """Add whether each wheel has a motor, or the wheels of a side turn together."""
        model = self.model
        if all(model.joint(model.body_jntadr[wheel]).name in motors for wheel in self.wheels):
            source = f"published: {self.file}, each wheel has a motor"
            self.entries["geometry.link"] = "none", source
            return
        self.entries["geometry.link"] = "belt", "assumed: a URDF does not say it"
        self.guesses.append("guessed geometry.link: belt, the wheels of a side turn together")

    def add_wheels(self, radius: float | None, width: float | None) -> None:
        """Add radius and width of the tyres: given, or those of their cylinders of collision.

        Raises:
            ValueError: neither, or cylinders of different sizes.
        """
        sizes = [size for wheel in self.wheels if (size := self._drum_size(wheel)) is not None]
        for key, given, column, factor in (
            ("wheel_radius", radius, 0, 1.0),
            ("wheel_width", width, 1, 2.0),
        ):
            if given is not None:
                self.entries[f"geometry.{key}"] = given, "measured: given to `import`"
                continue
            if not sizes:
                raise ValueError(
                    "its tyres are no cylinders: measure them, and give --wheel-radius and "
                    "--wheel-width"
                )
            each = factor * np.array(sizes)[:, column]
            if np.ptp(each) > _SAME_SIZE * each.max():
                option = key.replace("_", "-")
                raise ValueError(
                    f"its tyres have a {key} from {each.min():.4g} to {each.max():.4g} m; "
                    f"here all four have the same: give --{option}"
                )
            self.add(f"geometry.{key}", float(each.mean()), "cylinders of the tyres")

    def _drum_size(self, wheel: int) -> FloatArray | None:
        """Return radius and half the width of a wheel's largest cylinder about its axle [m]."""
        model = self.model
        sizes = []
        for g in range(model.ngeom):
            across = abs(self.data.geom_xmat[g].reshape(3, 3)[1, 2]) > _PARALLEL
            is_cylinder = model.geom_type[g] == mjtGeom.mjGEOM_CYLINDER
            if model.geom_bodyid[g] == wheel and is_cylinder and across:
                sizes.append(model.geom_size[g])
        return max(sizes, key=lambda size: float(size[0]), default=None)

    def _tensor(self, body: int) -> FloatArray:
        """Return a body's (3, 3) inertia about its centre, along the first link's axes [kg m2]."""
        turn = self.data.ximat[body].reshape(3, 3)
        return np.asarray(turn @ np.diag(self.model.body_inertia[body]) @ turn.T)

    def add_masses(self) -> None:
        """Add masses, centre of mass and moments of inertia.

        Raises:
            ValueError: the body has no mass.
        """
        masses = self.model.body_mass
        if masses[self.base] <= 2.0 * _LEAST_MASS:
            raise ValueError(
                "its body has no mass: a URDF for pictures only; use `new` with the mass of the "
                "robot"
            )
        weigh = "sum of all masses; weigh it: files leave out batteries and computers"
        self.add("mass.total", float(masses.sum()), weigh)
        wheel = float(masses[self.wheels].mean())
        if wheel > 2.0 * _LEAST_MASS:
            self.add("mass.wheel", wheel, "mean of the four wheels")
            moments = np.mean([np.diag(self._tensor(body)) for body in self.wheels], axis=0)
            across = 0.5 * (moments[0] + moments[2])
            inertia = np.array([across, moments[1]])
            self.add("mass.wheel_inertia", inertia, "mean of the four wheels")
        else:
            self.guesses.append("the wheels have no mass; it is estimated")
        com = self.data.xipos[self.base] - self.origin
        self.add("mass.com", com, "everything but the wheels together")
        tensor = self._tensor(self.base)
        diagonal = np.diag(tensor)
        self.add("mass.inertia", diagonal, "everything but the wheels about its common centre")
        products = float(np.abs(tensor - np.diag(diagonal)).max())
        if products > 0.02 * diagonal.max():
            self.guesses.append(f"products of inertia up to {products:.2g} kg m2 are left out")

    def add_hull(self) -> None:
        """Add the box around the plain shapes of the body."""
        model = self.model
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        corners = []
        for g, box in enumerate(model.geom_aabb.reshape(-1, 6)):
            if model.geom_bodyid[g] == self.base:
                place = self.data.geom_xpos[g]
                turn = self.data.geom_xmat[g].reshape(3, 3)
                for sign in signs:
                    corners.append(place + turn @ (box[:3] + sign * box[3:]) - self.origin)
        if not corners:
            corners = [np.zeros(3)]
        low = np.min(corners, axis=0)
        high = np.max(corners, axis=0)
        radius, _ = self.entries["geometry.wheel_radius"]
        width, _ = self.entries["geometry.wheel_width"]
        # an antenna, say
        if np.any(high - low < np.array([2.0, 1.0, 0.2]) * [radius, width, radius]):
            self.guesses.append(
                "the hull is estimated: the body's plain shapes fill less than a wheel; "
                "say body_size and body_centre"
            )
            return
        self.add("geometry.body_size", high - low, "box around the body's plain shapes")
        self.add("geometry.body_centre", 0.5 * (high + low), "box around the body's plain shapes")

    def finished(self, name: str) -> RobotDraft:
        """Return the file."""
        self.guesses += [
            "guessed drive.torque_limit: enough to turn on the spot on ground of friction 1",
            "no URDF says friction, gain, rotor inertia, or how the driver makes wheel rates of "
            "commands",
        ]
        return _drafted(name, f"Imported from {self.file}.", self.entries, self.guesses)
