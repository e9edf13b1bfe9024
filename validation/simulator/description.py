"""The description of a robot: one short TOML file, from which everything else is built.

It has geometry, masses, drive and sources.

A robot that comes with the package is `models/NAME.toml`; a user's own is any such file. Nothing
outside a robot's file knows its numbers. A profile adds numbers fitted to one robot on one ground.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cached_property, partial
from importlib import resources
from operator import not_
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args

import numpy as np
from msgspec import Meta

from ssmr.parameters import check_parameters, declaration_of, parameter
from ssmr.robot.ground import FRONT, LEFT
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import FloatArray
from validation.files import reading
from validation.output import Document, one_line

SCHEMA = "ssmr.robot/1"
"""Kind and version of a robot's file."""
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""Names of the wheels, in the order of all arrays of wheels: left and right take turns."""
SIDES = ("left", "right")
"""Names of the sides, in the order of all arrays of sides."""
Link = Literal["belt", "none"]
"""Links between the wheels of a side."""
WheelShape = Literal["ellipsoid", "cylinder", "capsule"]
"""Contact shapes of tyres."""
Vector3 = tuple[float, float, float]
"""Coordinates or moments of inertia along x, y and z."""
GRADES = ("measured", "datasheet", "published", "fitted", "assumed")
"""Grades of the source of a number, best first."""

GRAVITY = 9.81
"""[m/s2]; list of symbols of the thesis, and MuJoCo's default."""
_SERVO_TIME = 0.0914
"""Time constant of a side's speed loop where a file says no gain, over sqrt(wheel radius / g) [1]:
apparent inertia of a side over K_P, as on the thesis' robot, where it is 11.9 ms."""
_INTEGRAL_TIME = 1.137
"""K_P over K_I of a side's speed loop where a file says no integral_gain, over sqrt(wheel radius /
g) [1]; no leak."""
_STEP_SHARE = 0.0205
"""Greatest physics step where a file does not say it, over sqrt(wheel radius / g) [1]: wheels of
less than 9.3 cm get shorter steps than 2 ms. Some of the smallest would move 1.7 % of their way off
with those, and 0.6 % with 1 ms."""
_LONGEST_STEP = 0.002
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


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A four-wheel skid-steering robot, as its file describes it; estimates fill the file's gaps.

    Places are in the base frame. Its axes are x forward, y left and z up, its origin is midway
    between the axles and the sides.
    """

    name: str
    """Name in results."""
    title: str = ""
    """Name for people, with the maker's."""
    description: str = ""
    """One sentence that says which robot is meant."""
    mjcf: str = ""
    """Path of a hand-made MJCF of this robot, from the folder of shipped models unless it is
    absolute; empty where the model is composed from the numbers."""
    sources: tuple[tuple[str, str], ...] = ()
    """Section or `section.key`, and its grade and source."""
    given: tuple[str, ...] = field(default=(), compare=False)
    """The numbers that the file says, as `section.key`; the others were estimated."""
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
    body_size: Vector3 = (0.0, 0.0, 0.0)
    """Length, width and height of the hull [m]; a 0 is estimated so that the hull fits
    between the tyres."""
    body_centre: Vector3 = (math.nan, math.nan, math.nan)
    """Middle of the hull [m]; above the axles if not given."""
    imu: Vector3 = (math.nan, math.nan, math.nan)
    """Place of the IMU [m]; the middle of the hull if not given."""
    joints: str = ""
    """Names of the wheels' joints in the robot's URDF, in the order of `WHEELS`, separated by
    commas; `front_left_wheel_joint` and so on if empty."""
    link: Link = "belt"
    """Link between the wheels of a side: `belt`, they turn together and have one motor; `none`,
    each wheel has a motor."""
    mass: float = parameter(unit="kg", low=0.1, high=1e5)
    """Mass of the whole robot, with battery [kg]."""
    wheel_mass: float = parameter(0.0, unit="kg", low=0.0, high=1e4)
    """Mass of one wheel [kg]; 0: 3.6 % of the whole, which is a Husky's share."""
    wheel_inertia: tuple[float, float] = (0.0, 0.0)
    """Moments of inertia of a wheel about a diameter and about its axle [kg m2]; 0: estimated from
    its size and mass."""
    com: Vector3 = (0.0, 0.0, math.nan)
    """Centre of mass of the base without wheels [m]; z is at half of the hull's height if not
    given."""
    inertia: Vector3 = (0.0, 0.0, 0.0)
    """Moments of inertia of the base without wheels about its centre of mass [kg m2]; 0: those of a
    box like the hull."""
    friction: float = parameter(0.3, unit="1", low=0.0, high=5.0, open_low=True)
    """Sliding friction of tyre on ground [1]."""
    gain: float = parameter(0.0, unit="N m s/rad", low=0.0, high=1e7)
    """K_P of a side's speed loop [N m s/rad]; 0: such that the loop has the time constant
    `_SERVO_TIME`."""
    armature: float = parameter(0.0, unit="kg m2", low=0.0, high=1e4)
    """Rotor inertia of a wheel through its gear [kg m2]; 0: `ROTOR_SHARE` of mass times wheel
    radius squared."""
    wheel_shape: WheelShape = "ellipsoid"
    """Contact shape of the tyres."""
    timestep: float = parameter(0.0, unit="s", low=0.0, high=0.01)
    """Physics step [s]; 0: 2 ms, halved until it is at most `_STEP_SHARE` of sqrt(wheel radius /
    g)."""
    drive: Drive = field(default_factory=Drive)
    """Motor controller as the robot's maker ships it."""
    vehicle: Vehicle = field(default_factory=Vehicle)
    """Mass and geometry for the planar models. Where the file does not say it, the effective
    half-track is `turning_half_track`."""

    def __post_init__(self) -> None:
        """Check the numbers, and estimate those that are not given."""
        check_parameters(self)
        for name, words in (("link", get_args(Link)), ("wheel_shape", get_args(WheelShape))):
            value = getattr(self, name)
            if value not in words:
                text = reprlib.repr(value)
                raise ValueError(f"{name} is {text}, must be one of: {', '.join(words)}")
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not all(math.isnan(v) or low <= v <= high for v in value):
                raise ValueError(f"{name} is {value}, must be numbers from {low:g} to {high:g}")
        if self.joints and len(set(self.wheel_joints)) != len(WHEELS):
            raise ValueError(f"joints is '{self.joints}', must be four different names")
        for complete in (_complete_body, _complete_masses, _complete_motors):
            for name, value in complete(self).items():
                object.__setattr__(self, name, value)

    @property
    def wheel_joints(self) -> list[str]:
        """Names of the wheels' joints, in the order of `WHEELS`."""
        if self.joints:
            return [name.strip() for name in self.joints.split(",")]
        return [f"{wheel}_wheel_joint" for wheel in WHEELS]

    @property
    def turning_half_track(self) -> float:
        """Half the difference of the rims' speeds over the yaw rate in a turn on the spot [m].

        Friction is dry. With the centre of mass in the middle and one contact point a tyre,
        `ssmr.robot.ground` has this closed form: half-track (1 + (wheelbase / track)^2).
        """
        return 0.5 * self.track * (1.0 + (self.wheelbase / self.track) ** 2)

    @property
    def base_height(self) -> float:
        """Height of the base frame's origin above level ground [m]."""
        return self.wheel_radius - self.axle_height

    @property
    def wheel_moments(self) -> Vector3:
        """Moments of inertia of a wheel about the axes x, y and z [kg m2]."""
        across, spin = self.wheel_inertia
        return across, spin, across

    @property
    def shipped(self) -> bool:
        """Whether this is one of the robots that come with the package."""
        return _loaded.get(self.name) == self

    def as_document(self) -> Document:
        """Return the content of the robot's file, as `parse_robot` reads it."""
        texts = {key: getattr(self, key) for key in _TEXTS if getattr(self, key)}
        document = {"schema": SCHEMA, **texts}
        for key in self.given:
            section, _, name = key.partition(".")
            value = self.number(key)
            numbers = document.setdefault(section, {})
            numbers[name] = list(value) if isinstance(value, tuple) else value
        if self.sources:
            document["sources"] = dict(self.sources)
        return document

    def number(self, key: str) -> Any:
        """Return what the file says, or what was estimated, of a `section.key`."""
        section, _, name = key.partition(".")
        owner = {"drive": self.drive, "vehicle": self.vehicle}.get(section, self)
        return getattr(owner, SECTIONS[section][name].name)

    @property
    def base_mass(self) -> float:
        """Mass of the base without wheels [kg]."""
        return self.mass - len(WHEELS) * self.wheel_mass

    @property
    def yaw_inertia(self) -> float:
        """Moment of inertia of the whole robot about the vertical through the middle [kg m2].

        The centre of mass is taken to be there.
        """
        half = 0.25 * (self.wheelbase**2 + self.track**2)
        wheels = self.wheel_inertia[0] + self.wheel_mass * half
        return self.inertia[2] + len(WHEELS) * wheels

    @cached_property
    def motor_drive(self) -> Drive:
        """The drive of a simulated robot.

        Its speed loops have an integral part unless the file says `integral_gain`.
        """
        if "drive.integral_gain" in self.given:
            return self.drive
        time = _INTEGRAL_TIME * math.sqrt(self.wheel_radius / GRAVITY)
        integral_gain = self.gain / time
        return replace(self.drive, integral_gain=integral_gain, dc_stiffness=math.inf)

    @property
    def motors(self) -> Mapping[str, tuple[str, ...]]:
        """The wheels that each motor turns, by the motor's name."""
        if self.link == "none":
            return MappingProxyType({wheel: (wheel,) for wheel in WHEELS})
        return MappingProxyType({side: (f"front_{side}", f"rear_{side}") for side in SIDES})

    @property
    def wheel_places(self) -> FloatArray:
        """(4, 3) middles of the wheels in the base frame [m]."""
        x = 0.5 * FRONT * self.wheelbase
        y = 0.5 * LEFT * self.track
        return np.column_stack([x, y, np.full(len(WHEELS), self.axle_height)])

    @property
    def motor_groups(self) -> list[list[int]]:
        """Indices in `WHEELS` of the wheels that each motor turns; a belt ties those of one."""
        return [list(map(WHEELS.index, wheels)) for wheels in self.motors.values()]

    @cached_property
    def sizes(self) -> Mapping[str, float]:
        """The sizes of which fits' bounds are multiples, `ssmr.parameters.Declaration.of` [SI]."""
        return {  # no proxy: a robot travels to other processes
            "mass": self.mass,
            "yaw_inertia": self.yaw_inertia,
            "wheel_radius": self.wheel_radius,
            "half_track": 0.5 * self.track,
            "turning_half_track": self.turning_half_track,
            "half_wheelbase": 0.5 * self.wheelbase,
            "gain": self.gain,
            "gain_over_radius": self.gain / self.wheel_radius,
            "rotor_inertia": self.armature,
            "torque_limit": self.drive.torque_limit,
        }

    def source(self, key: str) -> tuple[str, str]:
        """Return grade and source of a number, `section.key`; one that is not given is assumed."""
        if key not in self.given:
            return "assumed", "estimated from the other numbers"
        sources = dict(self.sources)
        section = key.partition(".")[0]
        of_section = sources.get(section, "assumed: no source is given")
        grade, _, where = sources.get(key, of_section).partition(":")
        return grade.strip(), where.strip()


_RANGES = {
    "body_size": (0.0, 20.0),
    "body_centre": (-20.0, 20.0),
    "imu": (-20.0, 20.0),
    "com": (-20.0, 1e6),
    "wheel_inertia": (0.0, 1e6),
    "inertia": (0.0, 1e6),
}
"""Least and greatest value of the numbers of each list."""


def _file_keys(kind: type, *names: str) -> dict[str, Field[Any]]:
    """Return fields of a dataclass by the keys that a file has for them; all if none is named.

    A name is the field's, or `key=field` where the file has another.
    """
    declared = {f.name: f for f in fields(kind)}
    keys = {}
    for name in names or declared:
        key, _, own = name.partition("=")
        keys[key] = declared[own or key]
    return keys


_LENGTHS = ("wheelbase", "track", "wheel_radius", "wheel_width", "axle_height")
SECTIONS: Mapping[str, Mapping[str, Field[Any]]] = MappingProxyType(
    {
        "geometry": _file_keys(
            Robot, *_LENGTHS, "body_size", "body_centre", "imu", "joints", "link"
        ),
        "mass": _file_keys(
            Robot, "total=mass", "wheel=wheel_mass", "wheel_inertia", "com", "inertia"
        ),
        "drive": _file_keys(Drive),
        "simulation": _file_keys(Robot, "friction", "gain", "armature", "wheel_shape", "timestep"),
        "vehicle": _file_keys(Vehicle),
    }
)
"""The sections of a robot's file, and the field that each key fills."""
_TEXTS = ("name", "title", "description", "mjcf")
"""Keys of the texts at the top level of a robot's file."""
_KINDS = {
    "schema": Annotated[Literal["ssmr.robot/1"], Meta(description=f"'{SCHEMA}'")],
    **dict.fromkeys(_TEXTS, reading.TomlText),
    **dict.fromkeys((*SECTIONS, "sources"), reading.TomlTable),
}
"""Types of the values at the top level of a robot's file."""
_SOURCE = Annotated[
    str,
    Meta(
        max_length=2000,
        pattern=rf"^\s*({'|'.join(GRADES)})\s*(:|$)",
        description=f"'GRADE: source', with GRADE of {', '.join(GRADES)}",
    ),
]
"""Type of the source of a number in a robot's file."""


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
"""The shipped robots that were read, by name."""


def read_robot(name_or_path: str | Path = USUAL_ROBOT) -> Robot:
    """Return a shipped robot by name, or the robot of a file by path.

    Raises:
        ValueError: there is none, or its file says something that cannot be; the message names
            file, section and key.
    """
    name = str(name_or_path)
    if name in _loaded:
        return _loaded[name]
    shipped = {known: models_folder() / f"{known}.toml" for known in shipped_robots()}
    folder = shipped.get(name, Path(name)).parent
    robot = reading.load_named("robot", name, shipped, partial(parse_robot, folder=folder))
    if name in shipped:
        _loaded[name] = robot
    return robot


def parse_robot(document: Document, folder: Path = Path()) -> Robot:
    """Return the robot that a document, the content of a TOML file, describes.

    Args:
        document: the content of the file.
        folder: where the file lies; the path of a hand-made MJCF starts there, or in the folder of
            shipped models.

    Raises:
        ValueError: it says something that cannot be; the message names section and key.
    """
    found = reading.typed({"schema": None, **document}, _KINDS)
    texts: Document = {key: one_line(found.get(key, "")) for key in _TEXTS}
    name = texts["name"]
    if not name.replace("-", "").replace("_", "").isalnum():
        raise ValueError(f"name is '{name}', wanted letters, digits, '-' and '_'")
    given = {section: _read_section(found.get(section, {}), section) for section in SECTIONS}
    texts["mjcf"] = _mjcf_path(texts["mjcf"], folder)
    own: Document = {"sources": _check_sources(found.get("sources", {})), **texts}
    for section in ("geometry", "mass", "simulation"):
        own |= given[section]
    robot = Robot(**own)
    half_wheelbase = 0.5 * robot.wheelbase
    planar = {
        "mass": robot.mass,
        "yaw_inertia": robot.yaw_inertia,
        "wheel_radius": robot.wheel_radius,
        "a": half_wheelbase,
        "b": half_wheelbase,
        "half_track": 0.5 * robot.track,
        "effective_half_track": robot.turning_half_track,
    }
    parts: Document = {}
    for section, usual in (("drive", free_drive(robot)), ("vehicle", Vehicle(**planar))):
        try:
            parts[section] = replace(usual, **given[section])
        except ValueError as error:
            raise ValueError(f"[{section}] {error}") from error
    robot = replace(robot, **parts)
    return replace(robot, given=_given_keys(document, robot))


def free_drive(robot: Robot) -> Drive:
    """Return motors without limits and delays, which a file's drive changes."""
    return Drive(
        v_max=math.inf,
        w_max=math.inf,
        delay_v=0.0,
        delay_w=0.0,
        command_half_track=0.5 * robot.track,
        command_radius=robot.wheel_radius,
        torque_limit=math.inf,
    )


def _mjcf_path(text: str, folder: Path) -> str:
    """Return the path of an MJCF named in `folder`, as `Robot.mjcf` has it."""
    path = (folder / text).resolve()
    if not text or not path.is_file():
        return text
    return path.name if path.parent == models_folder() else str(path)


def _given_keys(document: Document, robot: Robot) -> tuple[str, ...]:
    """Return the numbers that a robot's file says, as `section.key`."""
    keys = []
    for section in SECTIONS:
        for name, number in document.get(section, {}).items():
            key = f"{section}.{name}"
            # a 0 that was estimated says nothing
            if number != 0.0 or robot.number(key) == 0.0:
                keys.append(key)
    return tuple(keys)


def _fill_missing(
    numbers: Sequence[float],
    estimates: Sequence[float],
    is_missing: Callable[[float], bool] = math.isnan,
) -> tuple[float, ...]:
    """Return numbers, with an estimate in place of each that is missing."""
    filled = []
    for number, estimate in zip(numbers, estimates, strict=True):
        filled.append(estimate if is_missing(number) else number)
    return tuple(filled)


def _complete_body(robot: Robot) -> Document:
    """Return the hull; what is not given fits between the tyres."""
    length = robot.wheelbase + robot.wheel_radius
    width = 0.9 * max(robot.track - robot.wheel_width, 0.01)
    size = _fill_missing(robot.body_size, (length, width, 1.2 * robot.wheel_radius), not_)
    centre = _fill_missing(robot.body_centre, (0.0, 0.0, robot.axle_height + 0.25 * size[2]))
    com = _fill_missing(robot.com, centre)
    return {
        "body_size": size,
        "body_centre": centre,
        "imu": _fill_missing(robot.imu, centre),
        "com": com,
    }


def _complete_masses(robot: Robot) -> Document:
    """Return masses and inertia; what is not given follows from the sizes."""
    wheel = robot.wheel_mass or 0.036 * robot.mass
    base = robot.mass - len(WHEELS) * wheel
    if base <= 0.0:
        raise ValueError(
            f"[mass] four wheels of {wheel:g} kg leave nothing of {robot.mass:g} kg for the base"
        )
    radius2 = robot.wheel_radius**2
    across = WHEEL_FILL * wheel * (radius2 / 4.0 + robot.wheel_width**2 / 12.0)
    spin = WHEEL_FILL * wheel * radius2 / 2.0
    length2, width2, height2 = (size * size for size in robot.body_size)
    box = []
    for squares in (width2 + height2, length2 + height2, length2 + width2):
        box.append(base * squares / 12.0)
    return {
        "wheel_mass": wheel,
        "wheel_inertia": _fill_missing(robot.wheel_inertia, (across, spin), not_),
        "inertia": _fill_missing(robot.inertia, box, not_),
    }


def _complete_motors(robot: Robot) -> Document:
    """Return motors and time step; what is not given follows from the robot's size."""
    radius2 = robot.wheel_radius**2
    armature = robot.armature or ROTOR_SHARE * robot.mass * radius2
    inertia = 0.5 * robot.mass * radius2 + 2.0 * armature  # of a side
    unit = math.sqrt(robot.wheel_radius / GRAVITY)  # of time
    # halves of the longest step, so that the step divides the periods of commands and samples
    halvings = max(0, math.ceil(math.log2(_LONGEST_STEP / (_STEP_SHARE * unit))))
    return {
        "armature": armature,
        "gain": robot.gain or inertia / (_SERVO_TIME * unit),
        "timestep": robot.timestep or _LONGEST_STEP / 2**halvings,
    }


def _value_kind(f: Field[Any]) -> Any:
    """Return the type of a field's value in a file."""
    if isinstance(f.default, tuple):
        # NaN stands for a number to estimate, where the default is NaN
        kinds = tuple(float if math.isnan(d) else reading.TomlNumber for d in f.default)
        numbers = tuple.__class_getitem__(kinds)
        return Annotated[numbers, Meta(description=f"{len(kinds)} numbers")]
    declared = declaration_of(f)
    if declared is None:
        return reading.TomlText
    return Annotated[reading.TomlNumber, Meta(description=f"a number [{declared.unit}]")]


def _read_section(section: Document, name: str) -> Document:
    """Return the numbers of one section by field, each of the type that its field has."""
    kinds = {key: _value_kind(f) for key, f in SECTIONS[name].items()}
    values = reading.typed(section, kinds, name)
    given = {}
    for key, f in SECTIONS[name].items():
        declared = declaration_of(f)
        if key in values:
            given[f.name] = _round_tiny(values[key])
            if declared is not None:
                declared.check(f"[{name}] {key}", given[f.name])
        elif f.default is MISSING:
            unit = "" if declared is None else f" [{declared.unit}]"
            raise ValueError(f"{name}.{key} is missing; wanted a number{unit}")
    return given


def _round_tiny(value: Any) -> Any:
    """Return a value from a file with 0 for numbers so small that a float has not all its digits.

    MuJoCo does not read those.
    """
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return tuple(map(_round_tiny, value))
    return round(value, 300)


def _check_sources(section: Document) -> tuple[tuple[str, str], ...]:
    """Return keys and texts of the sources, checked."""
    kinds = dict.fromkeys(SECTIONS, _SOURCE)
    for name, keys in SECTIONS.items():
        kinds |= {f"{name}.{key}": _SOURCE for key in keys}
    texts = reading.typed(section, kinds, "sources")
    return tuple((key, one_line(text)) for key, text in texts.items())


def with_robot(profile: str, robot: str) -> str:
    """Return a profile's name, and that of its robot where the first does not contain it."""
    if robot == USUAL_ROBOT or robot in profile:
        return profile
    return f"{profile} of {robot}"
