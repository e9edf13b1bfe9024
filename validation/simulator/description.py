"""The description of a robot: one short TOML file of geometry, masses, drive and sources; everything else is built from it.

A robot that comes with the package is `models/NAME.toml`; a user's own is any such file. Nothing
outside a robot's file knows its numbers. A profile adds what was fitted to one robot on one ground.
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

from ssmr.parameters import check_parameters, described, parameter
from ssmr.robot.vehicle import Drive, Vehicle
from validation.files import reading
from validation.files.reading import is_number
from validation.words import one_line

SCHEMA = "ssmr.robot/1"

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
SIDES = ("left", "right")
Link = Literal["belt", "none"]
WheelShape = Literal["ellipsoid", "cylinder", "capsule"]
GRADES = ("measured", "datasheet", "published", "fitted", "assumed")
"""Where a number can come from, best first."""
_MOST_WORDS = 2000
"""Greatest length of a text in a robot's file [characters]."""

GRAVITY = 9.81
"""[m/s2]; list of symbols of the thesis, and MuJoCo's default."""
SERVO_TIME = 0.0914
"""Time constant of a side's speed loop where a file says no gain, over sqrt(wheel radius / g) [1]:
apparent inertia of a side over K_P, as on the thesis' robot, where it is 11.9 ms."""
INTEGRAL_TIME = 1.137
"""K_P over K_I of a side's speed loop where a file says no integral_gain, over sqrt(wheel radius /
g) [1]; no leak."""
STEP_SHARE = 0.0205
"""Greatest physics step where a file does not say it, over sqrt(wheel radius / g) [1]: wheels of
less than 9.3 cm get shorter steps than 2 ms. Some of the smallest would move 1.7 % of their way off
with those, and 0.6 % with 1 ms."""
LONGEST_STEP = 0.002
"""Physics step of robots with larger wheels [s]."""
ROTOR_SHARE = 0.1
"""Rotor inertia of a wheel over mass times wheel radius squared where a file does not say it [1]
(docs/robots.md)."""
WHEEL_FILL = 1.2
"""Moments of inertia of a wheel over those of a solid cylinder where a file does not say them [1]:
a Husky's wheel has 1.18 times more about its diameter and 1.23 times more about its axle, as its
mass is mostly in the tyre."""


USUAL_ROBOT = "husky"
"""Name of the robot that is meant where none is named."""


class RobotError(ValueError):
    """A robot that cannot be found, read or built."""


@dataclass(frozen=True)
class Geometry:
    """Lengths, in the base frame: x forward, y left, z up, its origin midway between the axles and the sides."""

    wheelbase: float = parameter(unit="m", low=0.01, high=20.0)
    """Distance of the axles [m]."""
    track: float = parameter(unit="m", low=0.01, high=20.0)
    """Distance of the middles of the left and right tyres [m]."""
    wheel_radius: float = parameter(unit="m", low=0.005, high=5.0)
    """Rolling radius of the wheels [m]."""
    wheel_width: float = parameter(unit="m", low=0.001, high=5.0)
    """Width of the tyres [m]."""
    axle_height: float = parameter(0.0, unit="m", low=-5.0, high=5.0)
    """Height of the axles above the base frame's origin [m]."""
    body_size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Length, width and height of the hull [m]; what is 0 is estimated so that the hull fits
    between the tyres."""
    body_centre: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """Middle of the hull in the base frame [m]; above the axles if not given."""
    imu: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """Place of the IMU in the base frame [m]; the middle of the hull if not given."""
    link: Link = "belt"
    """Link between the wheels of a side: `belt`, they turn together and have one motor; `none`,
    each wheel has a motor."""

    def __post_init__(self) -> None:
        """Check the ranges, and fill in the hull."""
        check_parameters(self)
        if self.link not in get_args(Link):
            raise ValueError(
                f"link is {reprlib.repr(self.link)}, must be one of: {', '.join(get_args(Link))}"
            )
        usual = (
            self.wheelbase + self.wheel_radius,
            0.9 * max(self.track - self.wheel_width, 0.01),
            1.2 * self.wheel_radius,
        )
        size = tuple(
            given if given != 0.0 else u for given, u in zip(self.body_size, usual, strict=True)
        )
        above = (0.0, 0.0, self.axle_height + 0.25 * size[2])
        centre = tuple(
            u if math.isnan(c) else c for c, u in zip(self.body_centre, above, strict=True)
        )
        imu = tuple(u if math.isnan(c) else c for c, u in zip(self.imu, centre, strict=True))
        for name, value, low in (
            ("body_size", size, 0.0),
            ("body_centre", centre, -20.0),
            ("imu", imu, -20.0),
        ):
            if not all(low <= v <= 20.0 for v in value):
                raise ValueError(f"{name} is {value}, must be three numbers from {low:g} to 20 m")
            object.__setattr__(self, name, value)

    @property
    def turning_half_track(self) -> float:
        """Half the difference of the rims' speeds over the yaw rate in a turn on the spot with dry friction [m].

        With the centre of mass in the middle and one contact point a tyre, `ssmr.robot.ground` has
        this closed form: half-track (1 + (wheelbase / track)^2).
        """
        return 0.5 * self.track * (1.0 + (self.wheelbase / self.track) ** 2)

    @property
    def base_height(self) -> float:
        """Height of the base frame's origin above level ground [m]."""
        return self.wheel_radius - self.axle_height


@dataclass(frozen=True)
class Masses:
    """Masses and inertia."""

    total: float = parameter(unit="kg", low=0.1, high=1e5)
    """Mass of the whole robot, with battery [kg]."""
    wheel: float = parameter(0.0, unit="kg", low=0.0, high=1e4)
    """Mass of one wheel [kg]; 0: 3.6 % of the whole, which is a Husky's share."""
    wheel_inertia: tuple[float, float] = (0.0, 0.0)
    """Moments of inertia of a wheel about a diameter and about its axle [kg m2]; 0: estimated from
    its size and mass."""
    com: tuple[float, float, float] = (0.0, 0.0, math.nan)
    """Centre of mass of the base without wheels, in the base frame [m]; z is at half of the hull's
    height if not given."""
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Moments of inertia of the base without wheels about its centre of mass [kg m2]; 0: those of a
    box like the hull."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)
        least = {"wheel_inertia": 0.0, "inertia": 0.0, "com": -20.0}
        for name, low in least.items():
            if not all(math.isnan(v) or low <= v <= 1e6 for v in getattr(self, name)):
                raise ValueError(
                    f"{name} is {getattr(self, name)}, must be numbers from {low:g} to 1e+06"
                )


@dataclass(frozen=True)
class Simulation:
    """Tyres and motors of the simulated robot. A number that is not given follows from the robot's size."""

    friction: float = parameter(0.3, unit="1", low=0.0, high=5.0, open_low=True)
    """Sliding friction of tyre on ground [1]."""
    gain: float = parameter(0.0, unit="N m s/rad", low=0.0, high=1e7)
    """K_P of a side's speed loop [N m s/rad]; 0: such that the loop has the time constant
    `SERVO_TIME`."""
    armature: float = parameter(0.0, unit="kg m2", low=0.0, high=1e4)
    """Rotor inertia of a wheel through its gear [kg m2]; 0: `ROTOR_SHARE` of mass times wheel
    radius squared."""
    wheel_shape: WheelShape = "ellipsoid"
    """Contact shape of the tyres."""
    timestep: float = parameter(0.0, unit="s", low=0.0, high=0.01)
    """Physics step [s]; 0: 2 ms, halved until it is at most `STEP_SHARE` of sqrt(wheel radius /
    g)."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)
        if self.wheel_shape not in get_args(WheelShape):
            raise ValueError(
                f"unknown wheel shape '{self.wheel_shape}'; there are: {', '.join(get_args(WheelShape))}"
            )


@dataclass(frozen=True)
class Robot:
    """A four-wheel skid-steering robot, as its file describes it."""

    name: str
    """Name in results."""
    geometry: Geometry
    """Lengths."""
    masses: Masses
    """Masses and inertia; what the file left out is filled in."""
    simulation: Simulation
    """Tyres and motors; what the file left out is filled in."""
    drive: Drive
    """Motor controller as the robot's maker ships it."""
    vehicle: Vehicle
    """Mass and geometry for the planar models. Where the file does not say it, the effective
    half-track is `Geometry.turning_half_track`."""
    title: str = ""
    """Name for people, with the maker's."""
    description: str = ""
    """One sentence that says which robot is meant."""
    sources: tuple[tuple[str, str], ...] = ()
    """Section or `section.key`, and its grade and source."""
    given: tuple[str, ...] = field(default=(), compare=False)
    """The numbers that the file says, as `section.key`; the others were estimated."""
    mjcf: str = ""
    """Path of a hand-made MJCF of this robot, from the folder of shipped models unless it is
    absolute; empty where the model is composed from the numbers."""

    @property
    def shipped(self) -> bool:
        """Whether this is one of the robots that come with the package, which are known by their names."""
        return _loaded.get(self.name) == self

    def as_document(self) -> dict[str, Any]:
        """Return what the robot's file says, as `parse_robot` reads it."""
        texts = {key: getattr(self, key) for key in _TEXTS if getattr(self, key)}
        document: dict[str, Any] = {"schema": SCHEMA, **texts}
        parts = {"geometry": self.geometry, "mass": self.masses, "simulation": self.simulation}
        parts |= {"drive": self.drive, "vehicle": self.vehicle}
        for key in self.given:
            section, _, name = key.partition(".")
            value = getattr(parts[section], name)
            document.setdefault(section, {})[name] = (
                list(value) if isinstance(value, tuple) else value
            )
        return {**document, "sources": dict(self.sources)} if self.sources else document

    @property
    def base_mass(self) -> float:
        """Mass of the base without wheels [kg]."""
        return self.masses.total - len(WHEELS) * self.masses.wheel

    @property
    def yaw_inertia(self) -> float:
        """Moment of inertia of the whole robot about the vertical through the middle, the centre of mass being there."""
        half = 0.25 * (self.geometry.wheelbase**2 + self.geometry.track**2)
        wheels = self.masses.wheel_inertia[0] + self.masses.wheel * half
        return self.masses.inertia[2] + len(WHEELS) * wheels

    @cached_property
    def motor_drive(self) -> Drive:
        """The drive of a simulated robot: its speed loops have an integral part unless the file says `integral_gain`."""
        time = INTEGRAL_TIME * math.sqrt(self.geometry.wheel_radius / GRAVITY)
        usual = {"integral_gain": self.simulation.gain / time, "dc_stiffness": math.inf}
        return self.drive if "drive.integral_gain" in self.given else replace(self.drive, **usual)

    @property
    def motors(self) -> Mapping[str, tuple[str, ...]]:
        """The wheels that each motor turns, by the motor's name."""
        if self.geometry.link == "none":
            return MappingProxyType({wheel: (wheel,) for wheel in WHEELS})
        return MappingProxyType({side: (f"front_{side}", f"rear_{side}") for side in SIDES})

    @cached_property
    def sizes(self) -> Mapping[str, float]:
        """The sizes that default bounds of fits are multiples of (`ssmr.parameters.Declaration.of`), SI units."""
        g = self.geometry
        s = self.simulation
        return {  # no proxy: a robot travels to other processes
            "mass": self.masses.total,
            "yaw_inertia": self.yaw_inertia,
            "wheel_radius": g.wheel_radius,
            "half_track": 0.5 * g.track,
            "turning_half_track": g.turning_half_track,
            "half_wheelbase": 0.5 * g.wheelbase,
            "gain": s.gain,
            "gain_over_radius": s.gain / g.wheel_radius,
            "rotor_inertia": s.armature,
            "torque_limit": self.drive.torque_limit,
        }

    def source(self, key: str) -> tuple[str, str]:
        """Return the grade and the source of a number, `section.key`; one that the file does not say is assumed."""
        sources = dict(self.sources)
        if key not in self.given:
            return "assumed", "estimated from the other numbers"
        grade, _, where = sources.get(
            key, sources.get(key.partition(".")[0], "assumed: no source is given")
        ).partition(":")
        return grade.strip(), where.strip()


SECTIONS: Mapping[str, type] = MappingProxyType(
    {
        "geometry": Geometry,
        "mass": Masses,
        "simulation": Simulation,
        "drive": Drive,
        "vehicle": Vehicle,
    }
)
"""The sections of a robot's file, and the dataclass that each fills."""
_TEXTS = ("name", "title", "description", "mjcf")


def models_folder() -> Path:
    """Return the folder of the robots' files: inside an installed package, or in a source tree.

    Raises:
        FileNotFoundError: in neither place.
    """
    packaged = Path(str(resources.files("validation"))) / "_models"
    source = Path(__file__).resolve().parents[2] / "models"
    for path in (packaged, source):
        if (path / f"{USUAL_ROBOT}.toml").is_file():
            return path
    raise FileNotFoundError(
        f"robots' files are neither in {packaged} nor in {source}: the installation is incomplete"
    )


def shipped_robots() -> list[str]:
    """Return the names of the robots that come with the package."""
    return sorted(path.stem for path in models_folder().glob("*.toml"))


_loaded: dict[str, Robot] = {}


def load_robot(name_or_path: str | Path = USUAL_ROBOT) -> Robot:
    """Return a shipped robot by name, or the robot of a file by path.

    Raises: RobotError: there is none, or its file says something that cannot be; the message names
        file, section and key.
    """
    name = str(name_or_path)
    if name in _loaded:
        return _loaded[name]
    known = name in shipped_robots()
    path = models_folder() / f"{name}.toml" if known else Path(name)
    if not known and not os.path.exists(name):
        raise RobotError(
            f"no robot '{one_line(name)}'; there are: {', '.join(shipped_robots())}; or give the path of a robot's file"
        )
    try:
        robot = parse_robot(reading.read_toml(path), path.parent)
    except RobotError:
        raise
    except ValueError as error:
        raise RobotError(f"robot {name}: {error}") from error
    if known:
        _loaded[name] = robot
    return robot


def parse_robot(document: Mapping[str, Any], folder: Path = Path()) -> Robot:
    """Return the robot that a document describes, which is what a TOML file holds.

    Args: document: what the file says. folder: where the file lies; the path of a hand-made MJCF
        starts there, or in the folder of shipped models.

    Raises:
        ValueError: it says something that cannot be; the message names section and key.
    """
    if document.get("schema") != SCHEMA:
        raise ValueError(f"schema is {reprlib.repr(document.get('schema'))}, wanted '{SCHEMA}'")
    reading.require_known(document, {"schema", *_TEXTS, *SECTIONS, "sources"}, "the top level")
    texts = {key: _text(document, key) for key in _TEXTS}
    if not texts["name"] or not texts["name"].replace("-", "").replace("_", "").isalnum():
        raise ValueError(f"name is '{texts['name']}', wanted letters, digits, '-' and '_'")
    given = {name: _section(document, name, kind) for name, kind in SECTIONS.items()}
    geometry = Geometry(**given["geometry"])
    masses = _complete_masses(Masses(**given["mass"]), geometry)
    simulation = _complete_simulation(Simulation(**given["simulation"]), masses.total, geometry)
    half_track = 0.5 * geometry.track
    radius = geometry.wheel_radius
    usual = {
        "delay_v": 0.0,
        "delay_w": 0.0,
        "command_half_track": half_track,
        "command_radius": radius,
    }
    drive = Drive(
        **{
            **usual,
            "torque_limit": math.inf,
            "v_max": math.inf,
            "w_max": math.inf,
            **given["drive"],
        }
    )
    sources = _sources(document.get("sources", {}))
    if texts["mjcf"] and (own := (folder / texts["mjcf"]).resolve()).is_file():
        texts["mjcf"] = own.name if own.parent == models_folder() else str(own)
    parts = {"geometry": geometry, "mass": masses, "simulation": simulation, "drive": drive}
    own_keys = tuple(
        f"{section}.{key}"
        for section, numbers in given.items()
        for key, number in numbers.items()
        if number != 0.0
        or section not in parts
        or getattr(parts[section], key) == 0.0  # a 0 that was estimated says nothing
    )
    robot = Robot(
        geometry=geometry, masses=masses, simulation=simulation, drive=drive, vehicle=Vehicle(),
        sources=sources, given=own_keys, **texts,
    )  # fmt: skip
    half = 0.5 * geometry.wheelbase
    planar = {
        "mass": masses.total,
        "yaw_inertia": robot.yaw_inertia,
        "wheel_radius": radius,
        "a": half,
        "b": half,
    }
    planar |= {"half_track": half_track, "effective_half_track": geometry.turning_half_track}
    return replace(robot, vehicle=Vehicle(**{**planar, **given["vehicle"]}))


def _complete_masses(masses: Masses, geometry: Geometry) -> Masses:
    """Return the masses with estimates for what is not given."""
    wheel = masses.wheel or 0.036 * masses.total
    if len(WHEELS) * wheel >= masses.total:
        raise ValueError(
            f"[mass] four wheels of {wheel:g} kg leave nothing of {masses.total:g} kg for the base"
        )
    base, (length, width, height) = masses.total - len(WHEELS) * wheel, geometry.body_size
    radius2 = geometry.wheel_radius**2
    across = WHEEL_FILL * wheel * (radius2 / 4.0 + geometry.wheel_width**2 / 12.0)
    spin = WHEEL_FILL * wheel * radius2 / 2.0
    box = tuple(
        base * (p * p + q * q) / 12.0
        for p, q in ((width, height), (length, height), (length, width))
    )
    z = geometry.body_centre[2]
    return Masses(
        masses.total, wheel,
        (masses.wheel_inertia[0] or across, masses.wheel_inertia[1] or spin),
        (masses.com[0], masses.com[1], z if math.isnan(masses.com[2]) else masses.com[2]),
        tuple(given or estimated for given, estimated in zip(masses.inertia, box, strict=True)),  # type: ignore[arg-type]
    )  # fmt: skip


def _complete_simulation(simulation: Simulation, mass: float, geometry: Geometry) -> Simulation:
    """Return tyres and motors with what follows from the robot's size for what is not given."""
    radius2 = geometry.wheel_radius**2
    armature = simulation.armature or ROTOR_SHARE * mass * radius2
    inertia = 0.5 * mass * radius2 + 2.0 * armature  # of a side
    unit = math.sqrt(geometry.wheel_radius / GRAVITY)  # of time
    gain = simulation.gain or inertia / (SERVO_TIME * unit)
    halvings = max(0, math.ceil(math.log2(LONGEST_STEP / (STEP_SHARE * unit))))
    timestep = simulation.timestep or LONGEST_STEP / 2**halvings
    return Simulation(simulation.friction, gain, armature, simulation.wheel_shape, timestep)


def _text(document: Mapping[str, Any], key: str) -> str:
    value = document.get(key, "")
    if not isinstance(value, str) or len(value) > _MOST_WORDS:
        raise ValueError(
            f"{key} is {reprlib.repr(value)}, wanted a text of at most {_MOST_WORDS} characters"
        )
    return one_line(value)


def _section(document: Mapping[str, Any], name: str, kind: type) -> dict[str, Any]:
    """Return the numbers of one section, each of the type that its field has."""
    section = document.get(name, {})
    reading.require_known(section, {f.name for f in fields(kind)}, name)
    given: dict[str, Any] = {}
    for f in fields(kind):
        if f.name not in section:
            if f.default is MISSING:
                raise ValueError(f"{name}.{f.name} is missing; wanted {_wanted(kind, f.name)}")
            continue
        value = section[f.name]
        if isinstance(f.default, str):
            fits = isinstance(value, str)
        elif isinstance(f.default, tuple):
            fits = (
                isinstance(value, list)
                and len(value) == len(f.default)
                and all(map(is_number, value))
            )
            fits = fits and all(
                math.isnan(d) or not math.isnan(v) for v, d in zip(value, f.default, strict=True)
            )
        else:
            fits = is_number(value) and not math.isnan(value)
        if not fits:
            raise ValueError(
                f"{name}.{f.name} is {reprlib.repr(value)}, wanted {_wanted(kind, f.name)}"
            )
        # MuJoCo reads no number so small that a float has not all its digits: it becomes 0 here
        numbers = tuple(round(float(v), 300) for v in value) if isinstance(value, list) else value
        given[f.name] = numbers if isinstance(numbers, str | tuple) else round(float(numbers), 300)
    try:
        kind(**given)
    except ValueError as error:
        raise ValueError(f"[{name}] {error}") from error
    return given


def _wanted(kind: type, name: str) -> str:
    default = next(f.default for f in fields(kind) if f.name == name)
    if isinstance(default, str):
        return "a text"
    return (
        f"{len(default)} numbers"
        if isinstance(default, tuple)
        else f"a number [{described(kind)[name].unit}]"
    )


def _sources(section: Any) -> tuple[tuple[str, str], ...]:
    allowed = {
        *SECTIONS,
        *(f"{name}.{f.name}" for name, kind in SECTIONS.items() for f in fields(kind)),
    }
    reading.require_known(section, allowed, "sources")
    sources = []
    for key, value in section.items():
        if (
            not isinstance(value, str)
            or value.partition(":")[0].strip() not in GRADES
            or len(value) > _MOST_WORDS
        ):
            grades = ", ".join(GRADES)
            raise ValueError(
                f"sources.{key} is {reprlib.repr(value)}, wanted 'GRADE: source', with GRADE of {grades}"
            )
        sources.append((key, one_line(value)))
    return tuple(sources)


def with_robot(profile: str, robot: str) -> str:
    """Return the name of a profile, followed by that of its robot where the first does not tell the second."""
    return profile if robot == USUAL_ROBOT or robot in profile else f"{profile} of {robot}"
