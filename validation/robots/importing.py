"""A robot's file from a URDF: what the file says, what follows from it, and what had to be guessed."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ssmr.types import FloatArray
from validation.robots.advice import advice_on_masses
from validation.robots.drafting import require_free_name, say_sure_torque
from validation.robots.mechanics import WEIGHT_PER_KG
from validation.robots.result import DraftedRobot
from validation.robots.urdf import UrdfLink, UrdfTree, read_urdf
from validation.robots.wheels import FoundWheels, find_wheels
from validation.robots.writing import RobotDraft, drafted_text
from validation.simulator.description import RobotError, shipped_robots
from validation.words import one_line

_USUAL_RADIUS, _USUAL_WIDTH = 0.33, 0.5
"""Wheel radius over the wheelbase, and width over the radius, where nothing says them [1]: as of a Husky or a Warthog."""
_PLAUSIBLE_GRIP = (0.15, 5.0)
"""Thrust of all wheels over the weight that a limit of torque may mean [1]; what is outside is a placeholder."""
_PLAUSIBLE_SPEED = (0.1, 15.0)
"""Speed that a limit of a wheel's rate may mean [m/s]."""
_CLEARANCE = 0.98
"""Width of a hull over the room between the tyres where its shapes reach beyond them [1]."""


@dataclass
class _Import:
    """An import under way."""

    tree: UrdfTree
    wheels: FoundWheels
    draft: RobotDraft
    file: str
    guesses: list[str] = field(default_factory=list)
    radius: float = 0.0
    width: float = 0.0

    def read(self, key: str, value: object, where: str, remark: str = "") -> None:
        self.draft.say(key, value, f"published: {self.file}, {where}", remark)

    def guess(self, key: str, value: object, why: str) -> None:
        self.draft.say(key, value, f"assumed: {why}", "assumed")
        self.guesses.append(f"guessed {key}: {why}")

    def in_base(self, place: FloatArray) -> FloatArray:
        """Return a place in the base frame [m]: midway between axles and sides, at the height of base_link."""
        level = self.tree.links["base_link"].place[2] if "base_link" in self.tree.links else 0.0
        origin = np.array([*self.wheels.middle[:2], level])
        moved: FloatArray = self.wheels.axes @ (place - origin)
        return moved


def import_robot(
    path: str | Path, name: str | None = None, wheel_radius: float | None = None, wheel_width: float | None = None
) -> DraftedRobot:
    """Return a robot's file made of a URDF.

    Args:
        path: the URDF; a xacro file must be expanded before.
        name: the robot's name; the URDF's own if not given.
        wheel_radius: rolling radius of the wheels [m], measured; read or guessed if not given.
        wheel_width: width of the tyres [m], measured; read or guessed if not given.

    Raises:
        RobotError: the file cannot be read, is no URDF, or describes no robot with four fixed, plain wheels.
        ValueError: the name belongs to a robot that comes with the package, or cannot be one.
    """
    tree = read_urdf(path)
    try:
        wheels = find_wheels(tree)
        draft = RobotDraft(_name(tree, name), description=f"Imported from {one_line(Path(path).name)}.")
        work = _Import(tree, wheels, draft, one_line(Path(path).name))
        work.guesses += wheels.remarks
        _say_geometry(work, wheel_radius, wheel_width)
        _say_masses(work)
        _say_hull(work)
        _say_drive(work)
        return _finished(work)
    except RobotError:
        raise
    except ValueError as error:
        raise RobotError(f"{path}: {error}") from error


def _name(tree: UrdfTree, given: str | None) -> str:
    if given is not None:
        require_free_name(given)
        return given
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", tree.name).strip("_-")[:60] or "robot"
    return f"{name}-urdf" if name in shipped_robots() else name


def _say_geometry(work: _Import, radius: float | None, width: float | None) -> None:
    wheels = work.wheels
    joints = ", ".join(one_line(link.joint) for link in wheels.links.values())
    askew = f"; the wheels stand up to {1e3 * wheels.askew:.1f} mm beside these corners" if wheels.askew > 1e-4 else ""
    work.read("geometry.wheelbase", wheels.wheelbase, f"joints {joints}{askew}", "between the axles")
    work.read("geometry.track", wheels.track, "the same joints", "between the middles of the left and right tyres")
    if askew:
        work.guesses.append(askew.removeprefix("; "))
    _say_radius(work, radius)
    _say_width(work, width)
    height = float(work.in_base(wheels.middle)[2])
    work.read(
        "geometry.axle_height", height, "the same joints above base_link", "of the axles above the base frame's origin"
    )
    imu = next((link for link in work.tree.links.values() if re.search(r"(^|_)imu(_|\d|$)", link.name.lower())), None)
    if imu is not None:
        work.read("geometry.imu", work.in_base(imu.place).tolist(), f"link {one_line(imu.name)}")
    work.guess("geometry.link", "belt", "the wheels of a side turn together; a URDF does not say it")


def _say_radius(work: _Import, given: float | None) -> None:
    wheels = work.wheels
    shapes = [shape for shape in wheels.tyres.values() if shape is not None]
    ground = [link.place[2] for link in work.tree.links.values() if "footprint" in link.name.lower()]
    mass, _, spin = _mean_wheel(work)
    by_inertia = float(np.sqrt(2.0 * spin / mass)) if mass > 0.0 and spin > 0.0 else 0.0
    most = 0.5 * wheels.wheelbase
    if given is not None:
        work.radius = given
        work.draft.say("geometry.wheel_radius", given, "measured: given to `import`", "rolling radius")
    elif shapes:
        work.radius = float(np.mean([shape.size[0] for shape in shapes]))
        work.read("geometry.wheel_radius", work.radius, f"{shapes[0].kind} of the tyres")
    elif ground and 0.0 < wheels.middle[2] - ground[0] < most:
        work.radius = float(wheels.middle[2] - ground[0])
        work.guess("geometry.wheel_radius", work.radius, "height of the axles above the link that lies on the ground")
    elif 0.2 * most < by_inertia < most:
        work.radius = by_inertia
        work.guess("geometry.wheel_radius", by_inertia, "that of a solid cylinder with the mass and inertia of a wheel")
    else:
        work.radius = _USUAL_RADIUS * wheels.wheelbase
        words = f"{_USUAL_RADIUS:g} of the wheelbase; its tyres are meshes: measure it and give --wheel-radius"
        work.guess("geometry.wheel_radius", work.radius, words)


def _say_width(work: _Import, given: float | None) -> None:
    shapes = [shape for shape in work.wheels.tyres.values() if shape is not None and shape.kind == "cylinder"]
    mass, across, _ = _mean_wheel(work)
    squared = 12.0 * across / mass - 3.0 * work.radius**2 if mass > 0.0 else 0.0
    by_inertia = float(np.sqrt(max(squared, 0.0)))
    if given is not None:
        work.width = given
        work.draft.say("geometry.wheel_width", given, "measured: given to `import`")
    elif shapes:
        work.width = 2.0 * float(np.mean([shape.size[2] for shape in shapes]))
        work.read("geometry.wheel_width", work.width, "cylinder of the tyres")
    elif 0.2 * work.radius < by_inertia < 1.5 * work.radius:
        work.width = by_inertia
        work.guess("geometry.wheel_width", by_inertia, "that of a solid cylinder with the mass and inertia of a wheel")
    else:
        work.width = _USUAL_WIDTH * work.radius
        words = f"{_USUAL_WIDTH:g} of the wheel radius; its tyres are no plain shapes: measure it and give --wheel-width"
        work.guess("geometry.wheel_width", work.width, words)


def _mean_wheel(work: _Import) -> tuple[float, float, float]:
    """Return mass [kg] and moments of inertia about a diameter and the axle [kg m2] of a wheel, the mean of the four."""
    masses, across, spin = [], [], []
    for wheel in work.wheels.links.values():
        mass, _, tensor = _lumped(work.tree.below(wheel.name))
        turned = np.diag(work.wheels.axes @ tensor @ work.wheels.axes.T)
        masses.append(mass)
        across.append(0.5 * (turned[0] + turned[2]))
        spin.append(turned[1])
    return float(np.mean(masses)), float(np.mean(across)), float(np.mean(spin))


def _lumped(links: list[UrdfLink]) -> tuple[float, FloatArray, FloatArray]:
    """Return mass, centre of mass and inertia about it of several links together."""
    mass = sum(link.mass for link in links)
    if mass <= 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    com = sum((link.mass * link.com for link in links), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for link in links:
        away = link.com - com
        tensor += link.inertia + link.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return mass, com, tensor


def _say_masses(work: _Import) -> None:
    tree, draft = work.tree, work.draft
    of_wheels = {link.name for wheel in work.wheels.links.values() for link in tree.below(wheel.name)}
    base = [link for link in tree.links.values() if link.name not in of_wheels]
    total = sum(link.mass for link in tree.links.values())
    mass, com, tensor = _lumped(base)
    if mass <= 0.0:
        raise ValueError("its body has no mass: a URDF for pictures only; use `new` with the mass of the robot")
    work.read("mass.total", total, "sum of all masses", "weigh it: files leave out batteries and computers")
    wheel, across, spin = _mean_wheel(work)
    each = [sum(link.mass for link in tree.below(w.name)) for w in work.wheels.links.values()]
    if wheel > 0.0:
        work.read("mass.wheel", wheel, "mean of the four wheels")
        if np.ptp(each) > 0.01 * wheel:
            work.guesses.append(f"wheels of {min(each):.3g} to {max(each):.3g} kg became four of {wheel:.3g} kg")
        r2, w2 = work.radius**2, work.width**2
        slack = 1.0 + 1e-9
        if (
            0.0 < spin <= wheel * r2 * slack
            and 0.0 < across <= wheel * (r2 / 2.0 + w2 / 4.0) * slack
            and spin <= 2.0 * across * slack
        ):
            work.read("mass.wheel_inertia", [across, spin], "mean of the four wheels", "about a diameter, about the axle")
        else:
            work.guesses.append(
                f"left out the wheels' inertia, {across:.3g} kg m2 about a diameter and {spin:.3g} about the axle: no "
                "wheel of "
                f"{wheel:.3g} kg and {work.radius:.3g} m has it"
            )
    else:
        work.guesses.append("the wheels have no mass; it is estimated")
    work.read(
        "mass.com", work.in_base(com).tolist(), f"{len([b for b in base if b.mass > 0.0])} parts without the wheels together"
    )
    turned = work.wheels.axes @ tensor @ work.wheels.axes.T
    moments = np.diag(turned)
    products = float(np.abs(turned - np.diag(moments)).max())
    left = f"; products of inertia up to {products:.2g} kg m2 are left out" if products > 0.02 * moments.max() else ""
    odd = [name for name in tree.impossible if name not in of_wheels]
    if odd:
        words = f"no body has the inertia of {', '.join(map(one_line, odd[:4]))}; its mean about every axis was taken"
        work.guesses.append(words)
    draft.say("mass.inertia", moments.tolist(), f"published: {work.file}, the same parts about their common centre{left}")
    if left:
        work.guesses.append(left.removeprefix("; "))


def _say_hull(work: _Import) -> None:
    """Say the box around the plain shapes of the body, no wider than the room between the tyres beside them."""
    of_wheels = {link.name for wheel in work.wheels.links.values() for link in work.tree.below(wheel.name)}
    shapes = [shape for link in work.tree.links.values() if link.name not in of_wheels for shape in link.shapes]
    shapes = [shape for shape in shapes if shape.collides] or [shape for shape in shapes if shape.kind == "box"]
    if not shapes:
        work.guesses.append(
            "the hull is estimated: its shapes are meshes, which are not read; say body_size and body_centre"
        )
        return
    signs = np.array([[a, b, c] for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)])
    corners = np.concatenate([[work.in_base(s.centre + s.rotation @ (sign * s.size)) for sign in signs] for s in shapes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if np.any(high - low <= 1e-3) or np.any(np.abs([low, high]) > 20.0):
        work.guesses.append("the hull is estimated: the shapes of the body are no box of a robot's size")
        return
    where = "box around the body's plain shapes"
    room = 0.5 * (work.wheels.track - work.width)
    axle = float(work.in_base(work.wheels.middle)[2])
    beside = low[2] < axle + work.radius and high[2] > axle - work.radius
    if beside and max(high[1], -low[1]) > room > 0.0:
        high[1], low[1] = min(high[1], _CLEARANCE * room), max(low[1], -_CLEARANCE * room)
        where += ", cut to what lies between the tyres"
        work.guesses.append("the hull was cut to what lies between the tyres")
    if low[1] < high[1]:
        work.read("geometry.body_size", (high - low).tolist(), where)
        work.read("geometry.body_centre", (0.5 * (high + low)).tolist(), where)


def _say_drive(work: _Import) -> None:
    links = list(work.wheels.links.values())
    effort, rate = min(link.effort for link in links), min(link.velocity for link in links)
    weight = WEIGHT_PER_KG * sum(link.mass for link in work.tree.links.values())
    grip, speed = 4.0 * effort / (work.radius * weight), rate * work.radius
    sensible = _PLAUSIBLE_GRIP[0] <= grip <= _PLAUSIBLE_GRIP[1]
    if sensible:
        work.read("drive.torque_limit", effort, "effort limit of the wheels' joints", "of one wheel")
    elif effort > 0.0:
        work.guesses.append(
            f"left out the effort limit of {effort:g} N m: four such wheels push with {grip:.2g} of the weight"
        )
    if rate > 0.0 and _PLAUSIBLE_SPEED[0] <= speed <= _PLAUSIBLE_SPEED[1] and (sensible or effort == 0.0):
        work.read("drive.v_max", speed, "velocity limit of the wheels' joints times the radius")


def _finished(work: _Import) -> DraftedRobot:
    """Return the file, with what no robot has left out and a torque where there is none."""
    draft = work.draft
    robot, _ = drafted_text(draft)
    wrong = [each.text for each in advice_on_masses(robot) if "inertia" in each.text and "wheel" not in each.text]
    if wrong:
        del draft.sections["mass"]["inertia"], draft.sources["mass.inertia"]
        work.guesses.append(f"left out the inertia of the body, a box like the hull stands in: {wrong[0]}")
    if "torque_limit" not in draft.sections.get("drive", {}):
        say_sure_torque(draft)
        work.guesses.append(f"guessed drive.torque_limit: {draft.sources['drive.torque_limit'].removeprefix('assumed: ')}")
    work.guesses.append("no URDF says friction, gain, rotor inertia, or how the driver makes wheel rates of commands")
    draft.heading = (
        f"The robot {draft.name}, imported from {work.file} by `python -m validation.robots import`. Lines that begin "
        "with # are",
        "estimates. What had to be guessed:",
        *(f"- {words}" for words in work.guesses),
    )
    robot, text = drafted_text(draft)
    return DraftedRobot(robot, text, tuple(work.guesses))
