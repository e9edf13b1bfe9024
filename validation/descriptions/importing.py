"""A new robot's file, of a few numbers, or of a description by others.

It separates numbers that were given from those that had to be guessed. Tyres and hull are read off
the shapes of collision.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w

from ssmr.parameters import declaration_of
from ssmr.types import FloatArray
from validation import output
from validation.descriptions.foreign_robot import (
    LEAST_MASS,
    ForeignRobot,
    flaw_of_inertia,
    read_foreign,
)
from validation.descriptions.gazebo import driver_sizes
from validation.output import Document, one_line
from validation.simulator.checking import spot_turn, turning_torque
from validation.simulator.description import (
    SCHEMA,
    SECTIONS,
    WHEELS,
    Robot,
    parse_robot,
    shipped_robots,
)

_SAME_SIZE = 0.02
"""Greatest difference of two tyres of one size, over the larger [1]."""
_MISSING_SIZE = (
    "its tyres have no shape whose radius and width can be read (are they meshes?): measure them, "
    "and give --wheel-radius and --wheel-width to `import`"
)
"""Words of the error where neither the file nor the user tells the size of the wheels."""
_MOST_FRICTION = 5.0
"""Greatest friction that a robot's file may have [1]."""
_SURE_FRICTION = 1.0
"""Friction of ground on which motors whose torque nobody knows are taken to turn the robot on the
spot [1]."""
_DENSITIES = (1.2, 22_590.0)
"""Masses over the cube of the mean distance of the wheels, of air and of osmium [kg/m3]."""
_USUAL_DENSITY = 400.0
"""A usual mass over the cube of that distance: robots from toys to lorries are near it [kg/m3]."""
_WRONG_UNITS = {
    "lengths are in millimetres (mm), wanted metres": 1e9,
    "lengths are in centimetres (cm), or in mm with masses in grams, wanted m and kg": 1e6,
    "lengths are in inches, wanted metres": 0.0254**-3,
    "masses are in tonnes, wanted kilograms (kg)": 1e3,
    "masses are in grams (g), wanted kilograms (kg)": 1e-3,
}
"""Units by mistake, and the density in right ones over that in these [1]."""
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
    foreign: ForeignRobot | None = None
    """The description that it was made of; None for numbers that were given."""


def unit_of_key(key: str) -> str:
    """Return the unit of a number of a robot's file, `section.key`; empty for a text."""
    section, _, name = key.partition(".")
    declared = declaration_of(SECTIONS[section][name])
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
    document = _file_document(name, description, entries)
    robot = parse_robot(document)
    spot = spot_turn(robot)
    if "drive.torque_limit" not in robot.given and spot is not None:
        # rounded to three digits, it must still be enough
        friction = max(_SURE_FRICTION, 1.1 * robot.friction)
        torque = float(f"{0.5 * friction * turning_torque(robot, spot):.3g}")
        source = f"assumed: enough to turn on the spot on ground of friction {friction:.2g}"
        document = _file_document(
            name, description, {**entries, "drive.torque_limit": (torque, source)}
        )
        robot = parse_robot(document)
    heading = "".join(f"# {line}\n" for line in textwrap.wrap(_HEADING, 120))
    text = tomli_w.dumps(output.make_encodable(document))
    return RobotDraft(robot, heading + text, remarks)


def _file_document(name: str, description: str, entries: Entries) -> Document:
    """Return the content of the file, as TOML has it; numbers have nine digits."""
    document: Document = {"schema": SCHEMA, "name": name}
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
    controller: str | Path | None = None,
) -> RobotDraft:
    """Return a robot's file made of a URDF, an SDF or an MJCF.

    A wheel is a body on a hinge joint that turns without end about the y axis; an MJCF may drive
    along any direction.

    Args:
        path: the file. A xacro file is expanded where the package `xacro` is installed.
        name: the robot's name; the file's own if not given.
        wheel_radius: rolling radius of the wheels [m], measured; that of their shapes if not given.
        wheel_width: width of the tyres [m], measured; that of their shapes if not given.
        controller: a controller's YAML, whose separation and radius the robot's driver has.

    Raises:
        ValueError: the file cannot be read, is none of these, or describes no robot with four
            fixed, plain wheels, or the name is taken.
    """
    try:
        foreign = read_foreign(path, controller)
    except ValueError as error:
        raise ValueError(_located(path, error)) from error
    try:
        return _draft_of(foreign, name, wheel_radius, wheel_width)
    except ValueError as error:
        raise ValueError(_located(path, error)) from error


def _located(path: str | Path, error: ValueError) -> str:
    """Return an error's text in a line that begins with the file."""
    text = one_line(error)
    return text if text.startswith(str(path)) else f"{path}: {text}"


def _draft_of(
    foreign: ForeignRobot, name: str | None, radius: float | None, width: float | None
) -> RobotDraft:
    """Return the file of a foreign robot."""
    work = _Import(foreign)
    work.require_units()
    work.add_places()
    work.add_link()
    work.add_wheels(radius, width)
    work.add_masses()
    work.add_hull()
    work.add_drive()
    usual = foreign.name or "robot"
    if usual in shipped_robots():
        usual = f"{usual}_imported"
    return work.finished(name or usual)


class _Import:
    """An import under way: all that is no wheel is one body.

    Places are in the frame of `WheeledRobot` [m].
    """

    def __init__(self, foreign: ForeignRobot) -> None:
        """Begin an import without entries."""
        self.foreign = foreign
        self.wheeled = foreign.wheeled
        self.guesses = list[str]()
        self.entries = Entries()

    def add(self, key: str, value: float | FloatArray, where: str) -> None:
        """Add a number that the file says."""
        plain = value if isinstance(value, float) else value.tolist()
        self.entries[key] = plain, f"published: {self.foreign.file}, {where}"

    @property
    def radius(self) -> float:
        """Radius of the wheels [m], which is known before masses."""
        return float(np.ravel(self.entries["geometry.wheel_radius"][0])[0])

    def require_units(self) -> None:
        """Raise a ValueError where the robot is lighter than air, or heavier than any matter."""
        wheeled = self.wheeled
        mass, _, _ = wheeled.lump(wheeled.group(wheeled.root))
        density = mass / (wheeled.wheelbase * wheeled.track) ** 1.5
        if _DENSITIES[0] < density < _DENSITIES[1] or mass < 1e-6:
            return
        _, wrong = min(
            (abs(math.log(density * share / _USUAL_DENSITY)), unit)
            for unit, share in _WRONG_UNITS.items()
        )
        raise ValueError(
            f"its wheels stand {wheeled.wheelbase:.4g} by {wheeled.track:.4g} m apart and carry "
            f"{mass:.3g} kg: {wrong}"
        )

    def add_places(self) -> None:
        """Add wheelbase, track and the height of the axles."""
        wheeled = self.wheeled
        where = f"joints {', '.join(wheeled.names)}"
        self.add("geometry.wheelbase", wheeled.wheelbase, where)
        self.add("geometry.track", wheeled.track, where)
        self.add("geometry.axle_height", wheeled.axle_height, "the same joints above base_link")
        names = [name.replace(",", "") for name in wheeled.names]
        self.entries["geometry.joints"] = ", ".join(names), f"published: {self.foreign.file}"

    def add_link(self) -> None:
        """Add whether each wheel has a motor, or the wheels of a side turn together."""
        if self.foreign.motorised:
            source = f"published: {self.foreign.file}, each wheel has a motor"
            self.entries["geometry.link"] = "none", source
            return
        self.entries["geometry.link"] = "belt", "assumed: the file does not say it"
        self.guesses.append("guessed geometry.link: belt, the wheels of a side turn together")

    def add_wheels(self, radius: float | None, width: float | None) -> None:
        """Add radius and width of the tyres: given, or those of their shapes.

        Raises:
            ValueError: neither.
        """
        drums = [drum for drum in self.foreign.wheeled.drums if drum is not None]
        for key, given, sizes in (
            ("wheel_radius", radius, [drum.radius for drum in drums]),
            ("wheel_width", width, [2.0 * drum.half_width for drum in drums]),
        ):
            if given is not None:
                self.entries[f"geometry.{key}"] = given, "measured: given to `import`"
                continue
            if not sizes:
                raise ValueError(_MISSING_SIZE)
            if key == "wheel_width" and drums[0].kind in ("sphere", "capsule"):
                each = 0.6 * np.array([drum.radius for drum in drums])
                source = "assumed: a Husky's share of the radius, for these shapes have no tread"
                self.entries["geometry.wheel_width"] = float(each.mean()), source
                self.guesses.append("the width of the tyres is estimated: they are round")
                continue
            each = np.array(sizes)
            if np.ptp(each) > _SAME_SIZE * each.max():
                self.guesses.append(
                    f"its tyres have a {key} from {each.min():.4g} to {each.max():.4g} m; here all "
                    "four have the same, the mean"
                )
            self.add(f"geometry.{key}", float(each.mean()), "shapes of the tyres")

    def add_masses(self) -> None:
        """Add masses, centre of mass and moments of inertia.

        Raises:
            ValueError: the body has no mass.
        """
        wheeled = self.wheeled
        base, com, tensor = wheeled.lump(wheeled.base)
        if base <= 2.0 * LEAST_MASS * len(wheeled.base):
            raise ValueError(
                "its body has no mass: a file for pictures only; use `new` with the mass of the "
                "robot"
            )
        wheels = [wheeled.lump(wheeled.group(body)) for body in wheeled.bodies]
        masses = [mass for mass, _, _ in wheels]
        weigh = "sum of all masses; weigh it: files leave out batteries and computers"
        self.add("mass.total", base + sum(masses), weigh)
        wheel = float(np.mean(masses))
        if wheel > 2.0 * LEAST_MASS:
            self.add("mass.wheel", wheel, "mean of the four wheels")
            self._add_wheel_inertia(np.mean([np.diag(part) for _, _, part in wheels], axis=0))
        else:
            self.guesses.append("the wheels have no mass; it is estimated")
        self.add("mass.com", com, "everything but the wheels together")
        diagonal = np.diag(tensor)
        reach = math.hypot(wheeled.wheelbase, wheeled.track) + 2.0 * self.radius
        if flaw_of_inertia(np.diag(diagonal), base * reach**2):
            self.guesses.append("the body's inertia is that of no body; it is estimated")
        else:
            self.add("mass.inertia", diagonal, "everything but the wheels about its common centre")
        products = float(np.abs(tensor - np.diag(diagonal)).max())
        if products > 0.02 * diagonal.max():
            self.guesses.append(f"products of inertia up to {products:.2g} kg m2 are left out")

    def _add_wheel_inertia(self, moments: FloatArray) -> None:
        """Add the inertia of a wheel; one that no body has is estimated, and it says so."""
        for mass, tensor in self.foreign.tensors_of(self.wheeled.bodies).values():
            if flaw_of_inertia(tensor, mass * self.radius**2):
                self.guesses.append("a wheel's inertia is that of no body; it is estimated")
                return
        inertia = np.array([0.5 * (moments[0] + moments[2]), moments[1]])
        self.add("mass.wheel_inertia", inertia, "mean of the four wheels")

    def add_hull(self) -> None:
        """Add the box around the plain shapes of the body."""
        outline = self.wheeled.outline()
        low, high = np.zeros((2, 3)) if outline is None else outline
        radius = self.radius
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

    def add_drive(self) -> None:
        """Add friction, the limits of the motors, and the sizes that a controller reckons with."""
        foreign = self.foreign
        frictions = [numbers["mu1"] for numbers in foreign.contacts if "mu1" in numbers]
        if frictions and 0.0 < min(frictions) <= max(frictions) <= _MOST_FRICTION:
            where = "mean of the tyres, a simulator's setting"
            self.add("simulation.friction", float(np.mean(frictions)), where)
        efforts = [numbers["effort"] for numbers in foreign.limits if "effort" in numbers]
        if len(efforts) == len(WHEELS) and min(efforts) > 0.0:
            self.add("drive.torque_limit", min(efforts), "limits of the wheels' joints")
        speeds = [numbers["velocity"] for numbers in foreign.limits if "velocity" in numbers]
        if len(speeds) == len(WHEELS) and min(speeds) > 0.0:
            where = "limits of the wheels' joints times their radius"
            self.add("drive.v_max", min(speeds) * self.radius, where)
        half, radius = driver_sizes(foreign.controller)
        if half is not None:
            self.add("drive.command_half_track", half, "half of the controller's wheel separation")
        if radius is not None:
            self.add("drive.command_radius", radius, "the controller's wheel radius")

    def finished(self, name: str) -> RobotDraft:
        """Return the file."""
        missing = ["gain", "rotor inertia", "how the driver makes wheel rates of commands"]
        if "simulation.friction" not in self.entries:
            missing.insert(0, "friction")
        if "drive.torque_limit" not in self.entries:
            self.guesses.append(
                "guessed drive.torque_limit: enough to turn on the spot on its ground, and where "
                "friction is 1"
            )
        self.guesses.append(f"the file does not say: {', '.join(missing)}")
        heading = f"Imported from {self.foreign.file}."
        draft = _drafted(name, heading, self.entries, self.guesses)
        return draft._replace(foreign=self.foreign)
