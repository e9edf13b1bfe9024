"""A new robot's file, of a few numbers, or of a URDF by MuJoCo's own reader: what is known, and what had to be guessed.

MuJoCo gets links and joints without meshes, which are never looked for; tyres and hull are read off the shapes of collision.
"""

from __future__ import annotations

import re
import textwrap
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import tomli_w
from mujoco import mjtGeom

from ssmr.parameters import described
from ssmr.types import FloatArray
from validation import store
from validation.files import reading
from validation.simulator import guarded
from validation.simulator.checking import is_smaller_than_a_wheel, spot_turn
from validation.simulator.description import SCHEMA, SECTIONS, WHEELS, Robot, RobotError, parse_robot, shipped_robots
from validation.words import one_line

_ROOT = "ssmr_world"
"""Name of a link that the robot stands on: MuJoCo merges the first link of all with the world."""
_LEAST_MASS = 1e-9
"""Mass that MuJoCo gives to links without one [kg], so that it takes them."""
_PARALLEL, _UPRIGHT = 0.985, 0.9
"""Least share of y in the axis of a wheel (ten degrees), and of z in that of a joint that steers [1]."""
_ASKEW = 0.05
"""Greatest distance of a wheel from the corner of a rectangle, over its shorter side [1]."""
_MOTORS = ("transmission", "ros2_control")
"""Elements of a URDF that say which joints have motors."""
_SIDEWAYS_WORDS = re.compile(r"mecanum|omni_?wheel|swedish")
SURE_FRICTION = 1.0
"""Friction of ground on which motors whose torque nobody knows are taken to turn the robot on the spot [1]."""
_UNITS_OF_LISTS = dict.fromkeys(("body_size", "body_centre", "imu", "com"), "m")
_UNITS_OF_LISTS |= dict.fromkeys(("wheel_inertia", "inertia"), "kg m2")
_NEXT = (
    "next: weigh each of the four wheels (com), measure the hull between the tyres (body_size, body_centre), count the "
    "wheels' turns over a metre (wheel_radius), and drag the robot sideways with a spring scale (friction)"
)
_HEADING = (
    "What this file does not say is estimated; `python -m validation.robots check` shows it. Measure a number, write it "
    "into its section, and say in [sources] where it is from."
)


class Entry(NamedTuple):
    """A number or word of a new robot's file."""

    key: str  # section and name, such as `geometry.track`
    value: float | str | Sequence[float]  # in SI units
    source: str  # `GRADE: where it is from`


@dataclass(frozen=True, eq=False)
class RobotDraft:
    """A new robot's file, before it is written."""

    robot: Robot
    """The robot that the file describes."""
    text: str
    """What the file says."""
    remarks: Sequence[str]
    """What was estimated or guessed, and what to do next."""

    def save(self, path: str | Path) -> Path:
        """Write the file, whole or not at all; return its path.

        Raises:
            ValueError: there is something of that name already.
            OSError: the file cannot be written.
        """
        target = Path(path)
        if target.exists() or target.is_symlink():
            raise ValueError(f"{path}: there is such a file already, and it is not overwritten; name another")
        target.parent.mkdir(parents=True, exist_ok=True)
        store.write_text(target, self.text)
        return target


def unit_of_key(key: str) -> str:
    """Return the unit of a number of a robot's file, `section.key`; empty for a word."""
    section, _, name = key.partition(".")
    declared = described(SECTIONS[section])
    return declared[name].unit if name in declared else _UNITS_OF_LISTS.get(name, "")


def draft_robot(name: str, known: Mapping[str, float]) -> RobotDraft:
    """Return the file of a robot of which a tape measure and a scale know a few numbers.

    Args:
        name: its name.
        known: numbers by `section.key` [SI]: at least wheelbase, track, radius and width of the wheels, and the mass.

    Raises:
        ValueError: the name is taken or cannot be one, or a number cannot be.
    """
    entries = [Entry(key, float(value), "measured: given to `new`") for key, value in known.items()]
    entries.append(Entry("geometry.link", "belt", "assumed: as most such robots"))
    remarks = ("estimated from the size: com, inertia and wheels of [mass], the hull, gain and armature", _NEXT)
    return _drafted(name, "", entries, remarks)


def _drafted(name: str, description: str, entries: Sequence[Entry], remarks: Sequence[str]) -> RobotDraft:
    """Return the file of a new robot; where no entry says a torque limit, one is added that surely turns it on the spot.

    Raises:
        ValueError: the name is taken, or the entries say something that cannot be; the message names section and key.
    """
    if name in shipped_robots():
        raise ValueError(f"name '{one_line(name)}' belongs to a robot that comes with the package; take another")
    document = _document(name, description, entries)
    robot = parse_robot(document)
    spot = spot_turn(robot)
    if "drive.torque_limit" not in robot.said and spot is not None:
        torque = float(f"{0.5 * SURE_FRICTION * spot.side_torque:.3g}")
        source = f"assumed: enough to turn on the spot on ground of friction {SURE_FRICTION:g}"
        document = _document(name, description, [*entries, Entry("drive.torque_limit", torque, source)])
        robot = parse_robot(document)
    heading = "".join(f"# {line}\n" for line in textwrap.wrap(_HEADING, 120))
    return RobotDraft(robot, heading + tomli_w.dumps(store.encodable(document)), remarks)


def _document(name: str, description: str, entries: Sequence[Entry]) -> dict[str, Any]:
    """Return what the file says, as TOML has it; numbers have nine digits."""
    sections: dict[str, dict[str, Any]] = {}
    for entry in entries:
        section, _, key = entry.key.partition(".")
        sections.setdefault(section, {})[key] = _rounded(entry.value)
    texts = {"name": name, "description": one_line(description)} if description else {"name": name}
    return {"schema": SCHEMA, **texts, **sections, "sources": {entry.key: one_line(entry.source) for entry in entries}}


def _rounded(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return float(f"{value:.9g}") if isinstance(value, float | int) else [_rounded(v) for v in value]


def import_robot(
    path: str | Path, name: str | None = None, wheel_radius: float | None = None, wheel_width: float | None = None
) -> RobotDraft:
    """Return a robot's file made of a URDF.

    A wheel is a link on a continuous joint about the y axis.

    Args:
        path: the URDF of a robot that drives along x; a xacro file must be expanded before.
        name: the robot's name; the URDF's own if not given.
        wheel_radius: rolling radius of the wheels [m], measured; that of their cylinders if not given.
        wheel_width: width of the tyres [m], measured; that of their cylinders if not given.

    Raises:
        RobotError: the file cannot be read, is no URDF, or describes no robot with four fixed, plain wheels, or the name is
            taken.
    """
    try:
        text = reading.read_text(path, guarded.MOST_BYTES)
    except ValueError as error:
        raise RobotError(str(error)) from error
    try:
        root = _parsed(text)
        work = _Import(one_line(Path(path).name), *_compiled(root), _motorised(root))
        work.say_wheels(wheel_radius, wheel_width)
        work.say_masses()
        work.say_hull()
        own = re.sub(r"[^A-Za-z0-9_-]+", "_", root.get("name", "")).strip("_-")[:60]
        return work.finished(name or own or "robot")
    except ValueError as error:
        raise RobotError(f"{path}: {one_line(error)}") from error


def _parsed(text: str) -> ElementTree.Element:
    """Return the tree of a URDF's text.

    Raises:
        ValueError: it is no URDF, or its wheels are no plain ones.
    """
    root = guarded.xml_tree(text)
    if root.tag != "robot" or root.find("link") is None:
        raise ValueError("this is no URDF: there is no <robot> with a <link>")
    if any("xacro" in element.tag for element in root.iter()):
        raise ValueError("this is a xacro file; expand it first: xacro FILE.xacro > FILE.urdf")
    if _SIDEWAYS_WORDS.search(text.lower()):
        raise ValueError("its wheels are mecanum or omni wheels, which roll sideways; a skid-steering robot has plain ones")
    return root


def _plain(root: ElementTree.Element) -> tuple[list[ElementTree.Element], list[ElementTree.Element]]:
    """Return links and joints as MuJoCo takes them: without looks, meshes and half an inertia; only wheels can turn."""
    links, joints = root.findall("link"), root.findall("joint")
    for link in links:
        for part in (*link.findall("visual"), *link.findall("collision")):
            if part.tag == "visual" or part.find(".//mesh") is not None:
                link.remove(part)
        for inertial in link.findall("inertial"):
            if inertial.find("mass") is None or inertial.find("inertia") is None:
                link.remove(inertial)
        for tensor in link.iter("inertia"):
            tensor.attrib |= dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0") | tensor.attrib
    for joint in joints:
        if joint.get("type") not in ("continuous", "revolute"):
            joint.set("type", "fixed")  # what moves in other ways than a wheel is taken where it stands at zero
    return links, joints


def _motorised(root: ElementTree.Element) -> frozenset[str]:
    """Return the names of the joints that have a transmission or a command interface of ros2_control."""
    joints = [(owner.tag, joint) for owner in root for joint in owner.iter("joint") if owner.tag in _MOTORS]
    return frozenset(
        joint.get("name", "")
        for tag, joint in joints
        if tag == "transmission" or joint.find("command_interface") is not None
    )


def _compiled(root: ElementTree.Element) -> tuple[mujoco.MjModel, Mapping[str, str]]:
    """Return what MuJoCo makes of the links and joints of a URDF, and the types of the joints by name.

    Moments of inertia that no body has become their mean about every axis. The tree's links lose what MuJoCo shall not see.

    Raises:
        ValueError: MuJoCo cannot read it.
    """
    links, joints = _plain(root)
    carried = {child.get("link") for joint in joints for child in joint.findall("child")}
    first = [link.get("name", "") for link in links if link.get("name") not in carried]
    if len(first) != 1:
        raise ValueError(f"links and joints are no tree: {len(first)} links hang on nothing, wanted one")
    standing = ElementTree.Element("joint", name=_ROOT, type="fixed")
    ElementTree.SubElement(standing, "parent", link=_ROOT)
    ElementTree.SubElement(standing, "child", link=first[0])
    plain = ElementTree.Element("robot", name="robot")
    ElementTree.SubElement(
        ElementTree.SubElement(plain, "mujoco"), "compiler", fusestatic="false", discardvisual="true",
        inertiafromgeom="false", boundmass=repr(_LEAST_MASS), boundinertia="1e-12", balanceinertia="true",
    )  # fmt: skip
    plain.extend([ElementTree.Element("link", name=_ROOT), *links, *joints, standing])
    try:
        text = ElementTree.tostring(plain, encoding="unicode")
        guarded.require_readable(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"MuJoCo cannot read this URDF: {one_line(error)}") from error
    return mujoco.MjModel.from_xml_string(text), {joint.get("name", ""): joint.get("type", "") for joint in joints}


class _Import:
    """An import under way. Places are in the frame of the first link [m]."""

    def __init__(self, file: str, model: mujoco.MjModel, kinds: Mapping[str, str], motorised: frozenset[str]) -> None:
        """Compute where everything is, and find the four wheels.

        Raises:
            ValueError: there are not four, they do not stand at the corners of a rectangle, or one can be steered.
        """
        self.file, self.model, self.kinds = file, model, kinds
        self.guesses, self.entries, self.motorised = list[str](), list[Entry](), motorised
        self.data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        wheels = self._corners(self._four_joints())
        owner: dict[int, int | None] = {0: None}  # the wheel that each body belongs to; parents come first
        for body in range(1, model.nbody):
            owner[body] = body if body in wheels else owner[int(model.body_parentid[body])]
        self.parts = [[body for body in owner if owner[body] == wheel] for wheel in wheels]
        self.base = [body for body in owner if owner[body] is None]

    def _four_joints(self) -> list[int]:
        """Return the joints of four wheels."""
        model, axes = self.model, self.data.xaxis
        four = [
            j for j in range(model.njnt)
            if self.kinds[model.joint(j).name] == "continuous" and abs(axes[j, 1]) > _PARALLEL
        ]  # fmt: skip
        if len(four) != 4:
            raise ValueError(
                f"it has {len(four)} joints that look like wheels, and a skid-steering robot has four, continuous and about "
                f"the y axis: {self._names(four)}"
            )
        for j in four:
            if steering := [up for up in self._above(model.jnt_bodyid[j]) if abs(axes[up, 2]) > _UPRIGHT]:
                raise ValueError(
                    f"wheel '{self._names([j])}' can be steered by joint '{self._names(steering)}'; the wheels of a "
                    "skid-steering robot cannot"
                )
        return four

    def _above(self, body: int) -> list[int]:
        model, found = self.model, list[int]()
        while body := int(model.body_parentid[body]):
            found += range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        return found

    def _names(self, joints: Iterable[int]) -> str:
        names = [one_line(self.model.joint(j).name) for j in joints]
        return ", ".join(names[:8]) + (", …" if len(names) > 8 else "") or "none"

    def _corners(self, joints: Sequence[int]) -> list[int]:
        """Return the wheels' bodies in the order of `WHEELS`, and say wheelbase and track.

        The base frame lies midway between the axles, at the height of base_link.
        """
        model, places = self.model, self.data.xanchor[list(joints)]
        ahead, aside, _ = (places - places.mean(axis=0)).T
        named = {
            f"{'front' if x > 0.0 else 'rear'}_{'left' if y > 0.0 else 'right'}": k
            for k, (x, y) in enumerate(zip(ahead, aside, strict=True))
        }
        if set(named) != set(WHEELS):
            raise ValueError(f"the four wheels do not stand at the corners of a rectangle: {self._names(joints)}")
        order = [named[wheel] for wheel in WHEELS]
        x, y = np.abs(ahead).mean(), np.abs(aside).mean()
        wheelbase, track = 2.0 * float(x), 2.0 * float(y)
        askew = float(np.abs([np.abs(ahead) - x, np.abs(aside) - y]).max())
        if askew > _ASKEW * min(wheelbase, track):
            raise ValueError(
                f"the four wheels do not stand at the corners of a rectangle: one is {1e3 * askew:.0f} mm away from that of "
                f"{wheelbase:.3f} by {track:.3f} m"
            )
        where = f"joints {self._names(joints[k] for k in order)}"
        self.read("geometry.wheelbase", wheelbase, where)
        self.read("geometry.track", track, where)
        level = next((body.xpos[2] for body in map(self.data.body, range(model.nbody)) if body.name == "base_link"), 0.0)
        middle = places.mean(axis=0)
        self.origin = np.array([*middle[:2], level])
        self.read("geometry.axle_height", float(middle[2] - level), "the same joints above base_link")
        if all(model.joint(j).name in self.motorised for j in joints):
            self.entries.append(Entry("geometry.link", "none", f"published: {self.file}, a motor for each of the {where}"))
        else:
            self.entries.append(Entry("geometry.link", "belt", "assumed: a URDF does not say it"))
            self.guesses.append("guessed geometry.link: belt, the wheels of a side turn together")
        return [int(model.jnt_bodyid[joints[k]]) for k in order]

    def read(self, key: str, value: float | FloatArray, where: str) -> None:
        """Say a number that the file says."""
        said = value if isinstance(value, float) else value.tolist()
        self.entries.append(Entry(key, said, f"published: {self.file}, {where}"))

    def say_wheels(self, radius: float | None, width: float | None) -> None:
        """Say radius and width of the tyres: given, or those of their cylinders of collision.

        Raises:
            ValueError: neither.
        """
        model, found = self.model, []
        for bodies in self.parts:
            drums = [g for g in range(model.ngeom) if model.geom_bodyid[g] in bodies]
            drums = [g for g in drums if model.geom_type[g] == mjtGeom.mjGEOM_CYLINDER]
            drums = [g for g in drums if abs(self.data.geom_xmat[g].reshape(3, 3)[1, 2]) > _PARALLEL]
            found += [model.geom_size[g] for g in sorted(drums, key=lambda g: -float(model.geom_size[g, 0]))[:1]]
        for key, given, column, twice in (("wheel_radius", radius, 0, 1.0), ("wheel_width", width, 1, 2.0)):
            if given is not None:
                self.entries.append(Entry(f"geometry.{key}", given, "measured: given to `import`"))
            elif found:
                self.read(f"geometry.{key}", twice * float(np.mean(found, axis=0)[column]), "cylinders of the tyres")
            else:
                raise ValueError("its tyres are no cylinders: measure them, and give --wheel-radius and --wheel-width")

    def _lumped(self, bodies: Sequence[int]) -> tuple[float, FloatArray, FloatArray]:
        """Return mass, centre of mass in the base frame, and inertia about it, of several bodies together."""
        model, data = self.model, self.data
        heavy = [b for b in bodies if model.body_mass[b] > 2.0 * _LEAST_MASS]
        mass = float(model.body_mass[heavy].sum())
        if mass == 0.0:
            return 0.0, np.zeros(3), np.zeros((3, 3))
        com = model.body_mass[heavy] @ data.xipos[heavy] / mass
        tensor = np.zeros((3, 3))
        for b in heavy:
            away, turn = data.xipos[b] - com, data.ximat[b].reshape(3, 3)
            tensor += turn @ np.diag(model.body_inertia[b]) @ turn.T
            tensor += model.body_mass[b] * (away @ away * np.eye(3) - np.outer(away, away))
        return mass, com - self.origin, tensor

    def say_masses(self) -> None:
        """Say masses, centre of mass and moments of inertia.

        Raises:
            ValueError: the body has no mass.
        """
        mass, com, tensor = self._lumped(self.base)
        if mass <= 0.0:
            raise ValueError("its body has no mass: a URDF for pictures only; use `new` with the mass of the robot")
        lumps = [self._lumped(bodies) for bodies in self.parts]
        each = [lump[0] for lump in lumps]
        wheel, moments = float(np.mean(each)), np.mean([np.diag(lump[2]) for lump in lumps], axis=0)
        self.read("mass.total", mass + sum(each), "sum of all masses; weigh it: files leave out batteries and computers")
        if wheel > 0.0:
            self.read("mass.wheel", wheel, "mean of the four wheels")
            across = 0.5 * (moments[0] + moments[2])
            self.read("mass.wheel_inertia", np.array([across, moments[1]]), "mean of the four wheels")
        else:
            self.guesses.append("the wheels have no mass; it is estimated")
        self.read("mass.com", com, "everything but the wheels together")
        self.read("mass.inertia", np.diag(tensor), "everything but the wheels about its common centre")
        products = float(np.abs(tensor - np.diag(np.diag(tensor))).max())
        if products > 0.02 * np.diag(tensor).max():
            self.guesses.append(f"products of inertia up to {products:.2g} kg m2 are left out")

    def say_hull(self) -> None:
        """Say the box around the plain shapes of the body."""
        model, signs = self.model, np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        corners = [
            self.data.geom_xpos[g] + self.data.geom_xmat[g].reshape(3, 3) @ (aabb[:3] + sign * aabb[3:]) - self.origin
            for g, aabb in enumerate(model.geom_aabb.reshape(-1, 6)) if model.geom_bodyid[g] in self.base for sign in signs
        ]  # fmt: skip
        if not corners:
            self.guesses.append("the hull is estimated: the body has no plain shapes; say body_size and body_centre")
            return
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        known: dict[str, Any] = {entry.key: entry.value for entry in self.entries}
        if is_smaller_than_a_wheel(high - low, known["geometry.wheel_radius"], known["geometry.wheel_width"]):
            box = " x ".join(f"{length:.3g}" for length in high - low)
            self.guesses.append(f"the hull is estimated: the body's plain shapes fill {box} m, less than a wheel")
        else:
            self.read("geometry.body_size", high - low, "box around the body's plain shapes")
            self.read("geometry.body_centre", 0.5 * (high + low), "box around the body's plain shapes")

    def finished(self, name: str) -> RobotDraft:
        """Return the file."""
        self.guesses += [
            "guessed drive.torque_limit: enough to turn on the spot on ground of friction 1",
            "no URDF says friction, gain, rotor inertia, or how the driver makes wheel rates of commands",
        ]
        return _drafted(name, f"Imported from {self.file}.", self.entries, self.guesses)
