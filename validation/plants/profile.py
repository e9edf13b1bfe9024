"""Calibrated parameter sets: TOML files with provenance, shipped or the user's own.

A profile names its robot (`robot = "husky"`, which is also meant where none is named) or has its
whole file as `[robot]`. It has a common `[vehicle]` and `[drive]`, and for each plant
`[plants.NAME]` with `parameters`, and where they differ from the common ones its own `vehicle` and
`drive`, `localiser`, the frame in the plant's body that is compared, and its delays, `bands`,
which say for each input how sure the plant's predictions are, and `spread`, how much its numbers
differ from day to day. `[fitted_at]` says how fast the
fitted motions were. What a profile does not say is as in the robot's file; planar models have the
thesis' published values, scaled to the robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
import tomli_w
from msgspec import Meta

from ssmr.errors import ParameterError
from ssmr.estimation.settings import EkfSettings
from ssmr.metrics.bands import Band
from ssmr.models.law import OWN_MODELS
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, Plant
from validation import output
from validation.descriptions.loading import load_robot
from validation.files import reading
from validation.output import Document, one_line
from validation.plants.kind import PARTS, PlantProfile
from validation.plants.searchable import searchable_numbers
from validation.plants.table import PLANTS, SECOND_OPINIONS, STANDARD, is_foreign, plant_kind
from validation.simulator.description import USUAL_ROBOT, Robot, parse_robot
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.terrain import FLAT, Terrain

SCHEMA = "ssmr.profile/1"
"""Schema of profiles' files."""
_KINDS = {
    "schema": Annotated[Literal["ssmr.profile/1"], Meta(description=f"'{SCHEMA}'")],
    "robot": Annotated[str | Document, Meta(description="a name or a table")],
    **dict.fromkeys(("name", "description"), reading.TomlText),
    **dict.fromkeys(("vehicle", "drive", "plants", "provenance", "fitted_at"), reading.TomlTable),
}
"""Types of the values at the top level of a profile."""
_SPREAD = Annotated[float, Meta(gt=0.0, description="a positive number")]
_MOVES = 0.05  # speed [m/s] and yaw rate [rad/s] from which a robot moves
_BEYOND = 2.0  # ratio of paces from which a motion is clearly beyond the fitted ones [1]
_ODOMETRY_HZ = 50.0
"""Rate of diff_drive_controller's odometry, unless its file says another [Hz]."""
_UNSEEN = 1e6
"""Variance of height, roll and pitch, which wheels tell nothing of [m², rad²]."""

T = TypeVar("T")


@dataclass(frozen=True)
class Pace:
    """Pace of motions: 95 % of the time in motion, a robot stays below it."""

    speed: float = 0.0
    """Speed [m/s]."""
    lateral_acceleration: float = 0.0
    """Speed times yaw rate [m/s²]."""

    @classmethod
    def of(cls, v: FloatArray, w: FloatArray) -> Pace:
        """Return the pace of motions with (M,) speeds [m/s] and yaw rates [rad/s]."""
        moving = (np.abs(v) > _MOVES) | (np.abs(w) > _MOVES)
        if not moving.any():
            return cls()
        return cls(*(float(np.percentile(np.abs(x[moving]), 95.0)) for x in (v, v * w)))

    def text(self) -> str:
        """Return both numbers with their units."""
        return f"{self.speed:.2g} m/s and {self.lateral_acceleration:.2g} m/s² sideways"


@dataclass(frozen=True, eq=False)
class Profile:
    """A calibrated robot: one parameter set for every plant."""

    name: str
    """Name in results."""
    description: str
    """One sentence that says which robot and which ground are meant."""
    plants: Mapping[str, PlantProfile] = field(repr=False)
    """Numbers of each plant, by name."""
    provenance: Document = field(repr=False)
    """For each plant, the source of its numbers: the data, seed and cost of a fit, as the file has
    them."""
    fitted_at: Pace | None = None
    """Pace of the motions that its plants were fitted to; None where nobody knows."""

    def too_fast(self, pace: Pace, motion: str) -> list[str]:
        """Return a sentence where the pace of the named motion is clearly beyond the fit's."""
        most = self.fitted_at
        if most is None:
            return []
        is_slow = pace.speed <= _BEYOND * most.speed
        is_straight = pace.lateral_acceleration <= _BEYOND * most.lateral_acceleration
        if is_slow and is_straight:
            return []
        return [
            f"{motion} reaches {pace.text()}; {self.name} was fitted at {most.text()}, "
            "and may be wrong beyond"
        ]

    def unfitted(self, plants: Iterable[str]) -> list[str]:
        """Return a sentence on those of some plants that nothing was fitted to."""
        bare = [name for name in plants if name in self.plants and name not in self.provenance]
        if not bare:
            return []
        return [
            f"nothing was fitted to {', '.join(bare)}: the profile {one_line(self.name)} has the "
            "numbers of the robot's file"
        ]

    def origins(self, plants: Iterable[str], scenario: str) -> list[str]:
        """Return sentences on what plants were fitted to, where the scenario's distance is known.

        `[provenance.PLANT]` has the distances from its source as `d_rms_m`, by scenario.
        """
        sentences = []
        for name in plants:
            origin = self.provenance.get(name)
            known = origin.get("d_rms_m") if isinstance(origin, Mapping) else None
            if not isinstance(known, Mapping) or scenario not in known:
                continue
            numbers = {at: d for at, d in known.items() if isinstance(d, int | float)}
            listed = ", ".join(f"{1e3 * d:.1f} mm on {at}" for at, d in numbers.items())
            source = self.provenance[name].get("source")
            fitted = f"{name} was fitted to {source}; its d_rms from there: {listed}."
            sentences.append(one_line(fitted))
        return sentences

    @property
    def robot(self) -> Robot:
        """The robot that the profile is of."""
        return next(iter(self.plants.values())).robot

    def section(self, plant: str) -> PlantProfile:
        """Return the numbers of a plant, of any of `known_plants`.

        Other engines' robots have those of the standard plant. Models of the user's own, of which
        the profile says nothing, have their defaults.

        Raises:
            KeyError: there is no such plant.
        """
        if (plant in OWN_MODELS or is_foreign(plant)) and plant not in self.plants:
            return _default_plant(plant, self.robot)
        return self.plants[STANDARD if plant in SECOND_OPINIONS else plant]

    def with_(self, **changes: Document) -> Profile:
        """Return the profile with other numbers of plants, such as `mujoco={"friction": 0.4}`.

        A number has the name that a profile's file has for it, in whatever section of the plant.

        Raises:
            ValueError: there is no such plant or number, or it cannot have the value.
        """
        plants = dict(self.plants)
        reading.require_known(changes, plants, self.name)
        for plant, values in changes.items():
            section = plants[plant]
            homes = dict[str, str]()
            for part, numbers in reversed(section.numbers().items()):
                homes |= dict.fromkeys(numbers, part)
            reading.require_known(values, homes, plant)
            for name, value in values.items():
                home = homes[name]
                changed = _fill_fields(getattr(section, home), {name: value}, plant)
                section = replace(section, **{home: changed})
            plants[plant] = section
        return replace(self, name=f"{self.name}-changed", plants=plants)

    def as_dict(self, plants: Iterable[str] | None = None) -> Document:
        """Return all numbers, or those of some plants, for a result to record."""
        names = self.plants if plants is None else plants
        return {name: output.plain_value(self.section(name).numbers()) for name in names}

    def save(self, path: str | Path) -> Path:
        """Write a TOML file without the numbers that the robot has anyway; return its path.

        `load_profile` reads it back. The file's folder is made if it is not there.
        """
        plants = {}
        for name, plant in self.plants.items():
            section = {}
            bare = _default_plant(name, plant.robot).numbers()
            for part, numbers in plant.numbers().items():
                section[part] = {k: v for k, v in numbers.items() if v != bare[part][k]}
            section["bands"] = {kind: _round_numbers(band, 4) for kind, band in plant.bands.items()}
            section["spread"] = dict(plant.spread)
            # a table without entries would only make the file longer
            section = {part: values for part, values in section.items() if values}
            if section:
                plants[name] = section
        robot = self.robot.name if self.robot.shipped else self.robot.as_document()
        document = {
            "schema": SCHEMA,
            "name": self.name,
            "description": self.description,
            "robot": robot,
            "plants": plants,
        }
        if self.fitted_at is not None:
            document["fitted_at"] = _round_numbers(self.fitted_at, 3)
        document["provenance"] = dict(self.provenance)
        text = tomli_w.dumps(output.make_encodable(document))
        path = Path(path)
        output.make_folder(path.parent)
        output.write_text(path, text)
        return path


def _round_numbers(numbers: Band | Pace, digits: int) -> dict[str, float]:
    """Return all fields with so many digits, as a file has them."""
    return {name: float(f"{value:.{digits}g}") for name, value in asdict(numbers).items()}


def shipped_profiles() -> dict[str, Path]:
    """Return the files of the profiles that come with the package, by name."""
    folder = Path(str(resources.files("validation.plants"))) / "profiles"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def _default_plant(name: str, robot: Robot) -> PlantProfile:
    """Return the numbers of a robot's plant that nothing was fitted to."""
    kind = plant_kind(name)
    drive = robot.motor_drive if kind.torques else robot.drive
    return PlantProfile(kind.defaults(robot), robot.vehicle, drive, robot)


def bare_profile(robot: Robot) -> Profile:
    """Return the profile of a robot that nothing was fitted to: its file's numbers for all plants.

    Raises:
        ValueError: numbers that do not go together.
    """
    try:
        plants = {name: _default_plant(name, robot) for name in PLANTS}
    except ValueError as error:
        raise ValueError(f"robot {robot.name}: {error}") from error
    words = f"{robot.title or robot.name} as its file has it"
    return Profile(robot.name, words, plants, {})


def choose_profile(
    profile: str | Path | Profile | None, robot: str | Path | Robot | None, default: str
) -> Profile:
    """Return the profile that a user means.

    A robot that the profile without either is not of has its bare profile.

    Args:
        profile: name, path or profile; None for the one named `default`.
        robot: name, path or robot; None for the profile's.
        default: name of the profile without either.

    Raises:
        ValueError: the profile or the robot cannot be had, or the profile is of another robot.
    """
    if isinstance(profile, str | Path):
        profile = load_profile(profile)
    if robot is None:
        return profile or load_profile(default)
    chosen = load_robot(robot)
    if profile is None:
        common = load_profile(default)
        return common if common.robot == chosen else bare_profile(chosen)
    if profile.robot != chosen:
        raise ValueError(
            f"profile {profile.name} is of the robot {profile.robot.name}, not of {chosen.name}"
        )
    return profile


def load_profile(name_or_path: str | Path) -> Profile:
    """Return a shipped profile by name, or the profile of a TOML file by path.

    Raises:
        ValueError: there is none, or it says something that cannot be; the message names file,
            section and key.
    """
    return reading.load_named("profile", str(name_or_path), shipped_profiles(), _parse_profile)


def _parse_profile(document: Document) -> Profile:
    """Return the profile that a file's document holds; a ValueError says where it is wrong."""
    found = reading.typed({"schema": None, **document}, _KINDS)
    entry = found.get("robot", USUAL_ROBOT)
    try:
        robot = load_robot(entry) if isinstance(entry, str) else parse_robot(entry)
    except ValueError as error:
        raise ValueError(f"[robot] {error}") from error
    vehicle = _fill_fields(robot.vehicle, found.get("vehicle", {}), "vehicle")
    sections = found.get("plants", {})
    foreign = {name for name in sections if is_foreign(name)}
    reading.require_known(sections, {*PLANTS, *OWN_MODELS, *foreign}, "plants")
    plants = {}
    for plant in (*PLANTS, *(model for model in (*OWN_MODELS, *foreign) if model in sections)):
        section = sections.get(plant, {})
        defaults = replace(_default_plant(plant, robot), vehicle=vehicle)
        drive = _fill_fields(defaults.drive, found.get("drive", {}), "drive")
        plants[plant] = _parse_plant(replace(defaults, drive=drive), section, f"plants.{plant}")
    fitted_at = None
    if "fitted_at" in found:
        fitted_at = _fill_fields(Pace(), found["fitted_at"], "fitted_at")
    return Profile(
        found.get("name", "unnamed"),
        found.get("description", ""),
        plants,
        found.get("provenance", {}),
        fitted_at,
    )


def _parse_plant(common: PlantProfile, section: Document, where: str) -> PlantProfile:
    """Return a plant's numbers: those of its section, and the common ones that it does not have."""
    reading.require_known(section, {*PARTS, "bands", "spread"}, where)
    parts = {}
    for part in PARTS:
        parts[part] = _fill_fields(getattr(common, part), section.get(part, {}), f"{where}.{part}")
    entries = section.get("bands", {})
    reading.require_known(entries, {"commands", "wheels"}, f"{where}.bands")
    bands = {}
    for kind, entry in entries.items():
        # bands of version 2.0 had more causes, and say nothing of today's
        if not (isinstance(entry, dict) and "bend_walk" in entry):
            bands[kind] = _fill_fields(Band(), entry, f"{where}.bands.{kind}")
    spread = section.get("spread", {})
    if spread:
        plant = where.removeprefix("plants.")
        known = (number.name for number in searchable_numbers(plant, common.robot))
        spread = reading.typed(spread, dict.fromkeys(known, _SPREAD), f"{where}.spread")
    return replace(common, bands=bands, spread=spread, **parts)


def _fill_fields(default: T, values: Document, where: str) -> T:
    """Return a copy of `default` with `values` in place, each of the type its field has."""
    kinds = {}
    for f in fields(default):  # type: ignore[arg-type]
        if f.name != "robot":
            is_text = isinstance(getattr(default, f.name), str)
            kinds[f.name] = reading.TomlText if is_text else reading.TomlNumber
    given = reading.typed(values, kinds, where)
    try:
        return replace(default, **given)  # type: ignore[type-var]
    except ValueError as error:
        raise ValueError(f"[{where}] {error}") from error


def odometry_of(drive: Drive) -> EkfSettings:
    """Return the thesis' state filter, whose wheel odometry is the driver's own."""
    return EkfSettings(radius=drive.command_radius, half_track=drive.command_half_track)


def odometry_variances(profile: Profile) -> dict[str, list[float]]:
    """Return variances of odometry by wheels as the kinematic plant's band has them.

    Those of the twist make, summed up message by message, the band's random walk at the pace of
    the fit, and its lasting error of angles; those of the pose are its uncertainty after a second.
    Without a band or a pace there are none.
    """
    band = profile.section("kinematic").bands.get("wheels")
    pace = profile.fitted_at
    if band is None or pace is None or pace.speed == 0.0:
        return {}
    rate = pace.lateral_acceleration / pace.speed
    walks = band.way_walk**2 * pace.speed, band.turn_walk**2 * rate
    lasting = (band.turn_scale * rate) ** 2
    pose = [band.position_noise**2 + walks[0], band.yaw_noise**2 + walks[1] + lasting]
    twist = [walks[0] * _ODOMETRY_HZ, walks[1] * _ODOMETRY_HZ + lasting]
    variances = {}
    for name, (place, heading) in (("pose", pose), ("twist", twist)):
        diagonal = [place, place, _UNSEEN, _UNSEEN, _UNSEEN, heading]
        variances[f"{name}_covariance_diagonal"] = diagonal
    return variances


def fitted_errors(profile: Profile, plant: str) -> tuple[dict[str, float], str]:
    """Return the standard errors of a plant's fitted numbers by their names, and their source.

    A fit moves the dead times of both commands as one.
    """
    origin = profile.provenance.get(plant)
    known = origin.get("standard_errors") if isinstance(origin, Mapping) else None
    errors = {}
    if isinstance(known, Mapping):
        both = {"delay_v": known.get("delay"), "delay_w": known.get("delay")}
        errors = {k: e for k, e in {**both, **known}.items() if isinstance(e, int | float)}
    source = f"the profile {profile.name}, {plant}: {profile.description}"
    return errors, one_line(source)


def make_plant(
    profile: Profile,
    name: str,
    terrain: Terrain = FLAT,
    settings: PhysicsSettings = SHIPPED,
    late: float = 0.0,
) -> Plant:
    """Return the plant of that name with the profile's numbers.

    Args:
        profile: the numbers.
        name: name of the plant.
        terrain: ground of a simulated plant; the planar models know only level ground of one
            friction.
        settings: physics settings of a simulated plant.
        late: time by which it acts on commands later than the profile says [s].

    Raises:
        ValueError: an unknown name, or numbers that do not go together.
    """
    kind = plant_kind(name)
    section = profile.section(name)
    section = replace(section, drive=section.drive.later(late))
    try:
        return kind.build(section, terrain, settings)
    except ParameterError as error:
        raise ValueError(f"profile {profile.name}, plant {name}: {error}") from error
