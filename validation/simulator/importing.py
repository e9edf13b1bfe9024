"""A URDF -> a robot's file, by MuJoCo's own reader: what the URDF says, what follows from it, and what had to be guessed.

MuJoCo gets links and joints without meshes, which are never looked for; tyres and hull are read off the shapes of collision.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from mujoco import mjtGeom

from ssmr.types import FloatArray
from validation.files import reading
from validation.simulator.checking import body_inertia, wheel_inertia
from validation.simulator.description import GRAVITY, WHEELS, RobotError, shipped_robots
from validation.simulator.drafting import Entry, RobotDraft, drafted, require_free_name
from validation.words import one_line

MOST_BYTES = 1 << 22
"""Greatest size of a URDF [bytes]; large ones of manipulators have a few hundred thousand."""
_ROOT = "ssmr_world"
"""Name of a link that the robot stands on: MuJoCo merges the first link of all with the world."""
_LEAST_MASS = 1e-9
"""Mass that MuJoCo gives to links without one [kg], so that it takes them."""
_UPRIGHT, _LEVEL, _PARALLEL = 0.9, 0.17, 0.985
"""Least vertical part of the axis of a joint that steers, greatest one of an axle (ten degrees), and least cosine between
two axles [1]."""
_ASKEW = 0.05
"""Greatest distance of a wheel from the corner of a rectangle, over its shorter side [1]."""
_USUAL_RADIUS, _USUAL_WIDTH = 0.33, 0.5
"""Wheel radius over the wheelbase, and width over the radius, where nothing says them [1]: as of a Husky or a Warthog."""
_PLAUSIBLE_GRIP = (0.15, 5.0)
"""Thrust of all wheels over the weight that a limit of torque may mean [1]; what is outside is a placeholder."""
_CLEARANCE = 0.98
"""Width of a hull over the room between the tyres where its shapes reach beyond them [1]."""
_WHEEL_WORDS = re.compile(r"wheel|tire|tyre|rueda|roue|\brad\b")
_SIDEWAYS_WORDS = re.compile(r"mecanum|omni_?wheel|swedish")


def import_robot(
    path: str | Path, name: str | None = None, wheel_radius: float | None = None, wheel_width: float | None = None
) -> RobotDraft:
    """Return a robot's file made of a URDF.

    A wheel is a link on a continuous or revolute joint whose axis is level, parallel to those of the others, and that
    carries no other wheel. Names only decide where there are more than four, and which end is the front where x is not.

    Args:
        path: the URDF; a xacro file must be expanded before.
        name: the robot's name; the URDF's own if not given.
        wheel_radius: rolling radius of the wheels [m], measured; read or guessed if not given.
        wheel_width: width of the tyres [m], measured; read or guessed if not given.

    Raises:
        RobotError: the file cannot be read, is no URDF, or describes no robot with four fixed, plain wheels.
        ValueError: the name belongs to a robot that comes with the package.
    """
    if name is not None:
        require_free_name(name)
    try:
        text = reading.read_text(path, MOST_BYTES)
    except ValueError as error:
        raise RobotError(str(error)) from error
    try:
        root = _parsed(text)
        work = _Import(one_line(Path(path).name), root, *_compiled(root))
        work.find_wheels()
        work.say_geometry(wheel_radius, wheel_width)
        work.say_masses()
        work.say_hull()
        return work.finished(name)
    except ValueError as error:
        raise RobotError(f"{path}: {one_line(error)}") from error


def _parsed(text: str) -> ElementTree.Element:
    """Return the tree of a URDF's text.

    Raises:
        ValueError: it is no URDF, or its wheels are no plain ones.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("the file declares a document type or entities, which a URDF has no use for; take them out")
    try:
        root = ElementTree.fromstring(text)  # nosec B314 # without declarations there are no entities to grow
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"this is no XML ({one_line(error)})") from error
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


def _compiled(root: ElementTree.Element, balance: bool = False) -> tuple[mujoco.MjModel, list[str]]:
    """Return what MuJoCo makes of the links and joints of a URDF, its meshes left out, and remarks.

    Args:
        root: its tree, whose links lose what MuJoCo shall not see.
        balance: replace moments of inertia that no body has by their mean about every axis.

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
        inertiafromgeom="false", boundmass=repr(_LEAST_MASS), boundinertia="1e-12", balanceinertia=str(balance).lower(),
    )  # fmt: skip
    plain.extend([ElementTree.Element("link", name=_ROOT), *links, *joints, standing])
    try:
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(plain, encoding="unicode"))
    except (ValueError, RecursionError) as error:
        if not balance and "balanceinertia" in str(error):
            return _compiled(root, balance=True)
        raise ValueError(f"MuJoCo cannot read this URDF: {one_line(error)}") from error
    return model, ["moments of inertia that no body has were replaced by their mean about every axis"] if balance else []


@dataclass
class _Import:
    """An import under way. Places are along the axes in which the robot drives, from the first link's origin [m]."""

    file: str
    root: ElementTree.Element
    model: mujoco.MjModel
    guesses: list[str]
    entries: list[Entry] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Compute where everything is."""
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.axes = np.eye(3)  # forward, left and up as rows
        self.joints = {joint.get("name"): joint for joint in self.root.findall("joint")}

    def read(self, key: str, value: float | FloatArray, where: str) -> None:
        """Say a number that the file says."""
        said = value if isinstance(value, float) else value.tolist()
        self.entries.append(Entry(key, said, f"published: {self.file}, {where}"))

    def guess(self, key: str, value: float | str, why: str) -> None:
        """Say a number that the file does not say."""
        self.entries.append(Entry(key, value, f"assumed: {why}"))
        self.guesses.append(f"guessed {key}: {why}")

    # --------------------------------------------------------------------------------------- the wheels
    def find_wheels(self) -> None:
        """Find the four wheels and the axes in which the robot drives.

        Raises:
            ValueError: there are not four, they do not stand at the corners of a rectangle, or one can be steered.
        """
        model, data = self.model, self.data
        level = [j for j in range(model.njnt) if abs(data.xaxis[j, 2]) < _LEVEL]
        if not level:
            raise ValueError(
                "it has no wheels: wanted four continuous joints whose axes lie level; its joints that turn are "
                + self._names(range(model.njnt))
            )
        carriers = {up for j in level for up in self._above(model.jnt_bodyid[j])}
        leaves = [j for j in level if j not in carriers]
        four = max(([a for a in leaves if abs(data.xaxis[a] @ data.xaxis[b]) > _PARALLEL] for b in leaves), key=len)
        for keep in (
            lambda j: self.joints[model.joint(j).name].get("type") == "continuous",
            lambda j: _WHEEL_WORDS.search(self._label(j)) is not None,
        ):
            fewer = [j for j in four if keep(j)]
            if len(four) > 4 and len(fewer) >= 4:
                four = fewer
        if len(four) != 4:
            raise ValueError(
                f"it has {len(four)} joints that look like wheels, and a skid-steering robot has four: {self._names(four)}"
            )
        for j in four:
            steering = [up for up in self._above(model.jnt_bodyid[j]) if abs(data.xaxis[up, 2]) > _UPRIGHT]
            if steering:
                raise ValueError(
                    f"wheel '{self._names([j])}' can be steered by joint '{self._names(steering)}'; the wheels of a "
                    "skid-steering robot cannot"
                )
        self._turn_forward(four)
        wheels = {int(model.jnt_bodyid[j]): j for j in four}
        owner: dict[int, int | None] = {0: None}  # the wheel that each body belongs to; parents come first
        for body in range(1, model.nbody):
            owner[body] = body if body in wheels else owner[int(model.body_parentid[body])]
        self.parts = {wheel: [b for b in owner if owner[b] == wheel] for wheel in wheels}
        self.base = [b for b in owner if owner[b] is None]
        self.tyres = {wheel: self._tyre(wheel) for wheel in wheels}
        places = {w: self._place(data.xpos[w] if t is None else data.geom_xpos[t]) for w, t in self.tyres.items()}
        self._stand_at_corners(places, wheels)

    def _above(self, body: int) -> list[int]:
        """Return the joints that a body hangs on, the nearest first, its own left out."""
        model, found = self.model, list[int]()
        while body := int(model.body_parentid[body]):
            found += range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        return found

    def _label(self, joint: int) -> str:
        return f"{self.model.joint(joint).name} {self.model.body(self.model.jnt_bodyid[joint]).name}".lower()

    def _names(self, joints: Iterable[int]) -> str:
        names = [one_line(self.model.joint(j).name) for j in joints]
        return ", ".join(names[:8]) + (", …" if len(names) > 8 else "") or "none"

    def _turn_forward(self, four: list[int]) -> None:
        """Find the axes forward, left and up; forward is the file's x axis where the axles allow it."""
        axle = np.array([*self.data.xaxis[four[0], :2], 0.0])
        left = axle / np.linalg.norm(axle)
        forward = np.cross(left, [0.0, 0.0, 1.0])
        sign = 1.0 if forward[0] >= 0.0 else -1.0
        if abs(forward[0]) < 0.7:
            ahead = self.data.xanchor[four] @ forward
            ends = [("front" in self._label(j)) - ("rear" in self._label(j) or "back" in self._label(j)) for j in four]
            named = float((ahead - ahead.mean()) @ ends)
            sign = float(np.sign(named) or np.sign(forward[1]))
            turned = np.degrees(np.arctan2(sign * forward[1], sign * forward[0]))
            self.guesses.append(
                f"forward is {turned:.0f}° from the file's x axis, for its axles lie so; which end is the front is "
                + ("by the names of the wheels" if named else "a guess")
            )
        self.axes = np.array([sign * forward, sign * left, [0.0, 0.0, 1.0]])

    def _place(self, xyz: FloatArray) -> FloatArray:
        return np.asarray(self.axes @ xyz)

    def _tyre(self, wheel: int) -> int | None:
        """Return the geom of a tyre: the greatest cylinder about the axle, or sphere; None where there is only a mesh."""
        model, round_ = self.model, []
        for geom in np.flatnonzero(np.isin(model.geom_bodyid, self.parts[wheel])).tolist():
            about = abs(self.data.geom_xmat[geom].reshape(3, 3)[:, 2] @ self.axes[1]) > _PARALLEL
            if model.geom_type[geom] == mjtGeom.mjGEOM_SPHERE or (
                model.geom_type[geom] == mjtGeom.mjGEOM_CYLINDER and about
            ):
                round_.append(geom)
        return max(round_, key=lambda geom: float(model.geom_size[geom, 0]), default=None)

    def _stand_at_corners(self, places: Mapping[int, FloatArray], wheels: Mapping[int, int]) -> None:
        """Say wheelbase and track, and where the base frame lies: midway between the axles, at the height of base_link.

        Raises:
            ValueError: the wheels do not stand at the corners of a rectangle.
        """
        middle = np.mean(list(places.values()), axis=0)
        corners = {}
        for wheel, place in places.items():
            ahead, aside, _ = place - middle
            corners[f"{'front' if ahead > 0.0 else 'rear'}_{'left' if aside > 0.0 else 'right'}"] = wheel
        if set(corners) != set(WHEELS):
            raise ValueError(f"the four wheels do not stand at the corners of a rectangle: {self._names(wheels.values())}")
        stand = np.array([places[corners[wheel]] for wheel in WHEELS])
        self.wheelbase = float(stand[:2, 0].mean() - stand[2:, 0].mean())
        self.track = float(stand[::2, 1].mean() - stand[1::2, 1].mean())
        signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
        askew = float(np.abs(stand[:, :2] - middle[:2] - 0.5 * signs * [self.wheelbase, self.track]).max())
        if askew > _ASKEW * min(self.wheelbase, self.track):
            raise ValueError(
                f"the four wheels do not stand at the corners of a rectangle: one is {1e3 * askew:.0f} mm away from that of "
                f"{self.wheelbase:.3f} by {self.track:.3f} m"
            )
        if askew > 1e-4:
            self.guesses.append(f"the wheels stand up to {1e3 * askew:.1f} mm beside the corners of the rectangle")
        where = f"joints {self._names(wheels[corners[wheel]] for wheel in WHEELS)}"
        self.read("geometry.wheelbase", self.wheelbase, where)
        self.read("geometry.track", self.track, where)
        bodies = [self.model.body(b).name for b in range(self.model.nbody)]
        ground = float(self.data.body("base_link").xpos[2]) if "base_link" in bodies else 0.0
        self.origin, self.axle = np.array([*middle[:2], ground]), float(middle[2] - ground)
        self.read("geometry.axle_height", self.axle, "the same joints above base_link")
        footprints = [float(self.data.xpos[b, 2]) for b, name in enumerate(bodies) if "footprint" in name.lower()]
        self.above_ground = float(middle[2]) - footprints[0] if footprints else 0.0
        imu = next((b for b, name in enumerate(bodies) if re.search(r"(^|_)imu(_|\d|$)", name.lower())), None)
        if imu is not None:
            self.read("geometry.imu", self._place(self.data.xpos[imu]) - self.origin, f"link {one_line(bodies[imu])}")
        self.guess("geometry.link", "belt", "the wheels of a side turn together; a URDF does not say it")

    def say_geometry(self, radius: float | None, width: float | None) -> None:
        """Say radius and width of the tyres: given, read off their shapes, or guessed."""
        model, shapes = self.model, [geom for geom in self.tyres.values() if geom is not None]
        drums = [geom for geom in shapes if model.geom_type[geom] == mjtGeom.mjGEOM_CYLINDER]
        given = "measured: given to `import`"
        if radius is not None:
            self.entries.append(Entry("geometry.wheel_radius", radius, given))
        elif shapes:
            radius = float(model.geom_size[shapes, 0].mean())
            self.read("geometry.wheel_radius", radius, "shapes of the tyres")
        elif 0.0 < self.above_ground < 0.5 * self.wheelbase:
            radius = self.above_ground
            self.guess("geometry.wheel_radius", radius, "height of the axles above the link that lies on the ground")
        else:
            radius = _USUAL_RADIUS * self.wheelbase
            words = f"{_USUAL_RADIUS:g} of the wheelbase; its tyres are no plain shapes: measure it, give --wheel-radius"
            self.guess("geometry.wheel_radius", radius, words)
        if width is not None:
            self.entries.append(Entry("geometry.wheel_width", width, given))
        elif drums:
            width = 2.0 * float(model.geom_size[drums, 1].mean())
            self.read("geometry.wheel_width", width, "cylinders of the tyres")
        else:
            width = _USUAL_WIDTH * radius
            words = f"{_USUAL_WIDTH:g} of the wheel radius; its tyres are no cylinders: measure it, give --wheel-width"
            self.guess("geometry.wheel_width", width, words)
        self.radius, self.width = radius, width

    # --------------------------------------------------------------------------------------- masses, torque and hull
    def _lumped(self, bodies: list[int]) -> tuple[float, FloatArray, FloatArray]:
        """Return mass, centre of mass, and inertia about it along the driving axes, of several bodies together."""
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
        return mass, self._place(com) - self.origin, self.axes @ tensor @ self.axes.T

    def say_masses(self) -> None:
        """Say masses, centre of mass, moments of inertia and the torque that the wheels' joints allow.

        Raises:
            ValueError: the body has no mass.
        """
        mass, com, tensor = self._lumped(self.base)
        if mass <= 0.0:
            raise ValueError("its body has no mass: a URDF for pictures only; use `new` with the mass of the robot")
        lumps = [self._lumped(parts) for parts in self.parts.values()]
        each = [lump[0] for lump in lumps]
        total, wheel = mass + sum(each), float(np.mean(each))
        self.read("mass.total", total, "sum of all masses; weigh it: files leave out batteries and computers")
        if wheel > 0.0:
            self.read("mass.wheel", wheel, "mean of the four wheels")
            if np.ptp(each) > 0.01 * wheel:
                self.guesses.append(f"wheels of {min(each):.3g} to {max(each):.3g} kg became four of {wheel:.3g} kg")
            moments = np.mean([np.diag(lump[2]) for lump in lumps], axis=0)
            self.read(
                "mass.wheel_inertia", np.array([0.5 * (moments[0] + moments[2]), moments[1]]), "mean of the four wheels"
            )
        else:
            self.guesses.append("the wheels have no mass; it is estimated")
        self.read("mass.com", com, "everything but the wheels together")
        moments = np.diag(tensor)
        self.read("mass.inertia", moments, "everything but the wheels about its common centre")
        products = float(np.abs(tensor - np.diag(moments)).max())
        if products > 0.02 * moments.max():
            self.guesses.append(f"products of inertia up to {products:.2g} kg m2 are left out")
        limits = [self.joints[self.model.joint(self.model.body_jntadr[wheel]).name].find("limit") for wheel in self.parts]
        effort = min(0.0 if limit is None else float(limit.get("effort", 0.0)) for limit in limits)
        grip = 4.0 * effort / (self.radius * total * GRAVITY)
        if _PLAUSIBLE_GRIP[0] <= grip <= _PLAUSIBLE_GRIP[1]:
            self.read("drive.torque_limit", effort, "effort limit of the wheels' joints")
        elif effort > 0.0:
            self.guesses.append(
                f"left out the effort limit of {effort:g} N m: four such wheels push with {grip:.2g} of the weight"
            )

    def say_hull(self) -> None:
        """Say the box around the plain shapes of the body, no wider than the room between the tyres beside them."""
        model, signs = self.model, np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        corners = [
            self._place(self.data.geom_xpos[g] + self.data.geom_xmat[g].reshape(3, 3) @ (aabb[:3] + sign * aabb[3:]))
            for g, aabb in enumerate(model.geom_aabb.reshape(-1, 6)) if model.geom_bodyid[g] in self.base for sign in signs
        ]  # fmt: skip
        if not corners:
            self.guesses.append("the hull is estimated: the body has no plain shapes; say body_size and body_centre")
            return
        low, high = np.min(corners, axis=0) - self.origin, np.max(corners, axis=0) - self.origin
        room, where = 0.5 * (self.track - self.width), "box around the body's plain shapes"
        beside = low[2] < self.axle + self.radius and high[2] > self.axle - self.radius
        if beside and max(high[1], -low[1]) > room > 0.0:
            high[1], low[1] = min(high[1], _CLEARANCE * room), max(low[1], -_CLEARANCE * room)
            where += ", cut to what lies between the tyres"
            self.guesses.append("the hull was cut to what lies between the tyres")
        if np.any(high - low <= 1e-3) or np.any(np.abs([low, high]) > 20.0):
            self.guesses.append("the hull is estimated: the shapes of the body are no box of a robot's size")
            return
        self.read("geometry.body_size", high - low, where)
        self.read("geometry.body_centre", 0.5 * (high + low), where)

    def finished(self, name: str | None) -> RobotDraft:
        """Return the file, with what no body or wheel can have left out."""
        own = re.sub(r"[^A-Za-z0-9_-]+", "_", self.root.get("name", "")).strip("_-")[:60] or "robot"
        name = name or (f"{own}-urdf" if own in shipped_robots() else own)
        texts = {"name": name, "description": f"Imported from {self.file}."}
        for key, judge in (("mass.wheel_inertia", wheel_inertia), ("mass.inertia", body_inertia)):
            wrong = [words for applies, _, words in judge(drafted(texts, self.entries, (), ()).robot) if applies]
            if wrong and key in {entry.key for entry in self.entries}:
                self.entries = [entry for entry in self.entries if entry.key != key]
                self.guesses.append(f"left out {key}, which is estimated: {wrong[0]}")
        if not any(entry.key == "drive.torque_limit" for entry in self.entries):
            self.guesses.append("guessed drive.torque_limit: enough to turn on the spot on ground of friction 1")
        self.guesses.append("no URDF says friction, gain, rotor inertia, or how the driver makes wheel rates of commands")
        heading = (
            f"The robot {name}, imported from {self.file} by `python -m validation.robots import`. Lines that begin with # "
            "are estimates. What had to be guessed:",
            *(f"- {words}" for words in self.guesses),
        )
        return drafted(texts, self.entries, tuple(self.guesses), heading)
