"""The options of command lines: annotations, and how their texts are read.

A program declares its options as a frozen dataclass, whose docstrings below the fields are the
help. Every number is checked here, before any work: it is finite, and fits into 64 bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from ssmr.models.law import PlanarLaw
from ssmr.parameters import MOST_SEED
from validation.files.limits import USUAL, LogLimits
from validation.plants.profile import Profile
from validation.simulator.description import Robot
from validation.simulator.terrain import Terrain, parse_terrain
from validation.words import shortened

T = TypeVar("T")


class UserError(ValueError):
    """The user asked for something impossible.

    The message is one line that says what was wrong and what would be right.
    """


def option(
    name: str | None = None,
    *,
    metavar: str | None = None,
    default: str | None = None,
    help: str | None = None,
) -> object:
    """Return the annotation of an option.

    Args:
        name: the option's name where the field cannot have it, such as `from`.
        metavar: name of its value in the help text.
        default: the default in words, where the value itself does not say it.
        help: the help text; else the docstring below the field.
    """
    hint = None if default is None else f"(default: {default})"
    return tyro.conf.arg(
        name=name, metavar=metavar, help=help, help_behavior_hint=hint, prefix_name=False
    )


def parsed(parse: Callable[[str], T], metavar: str, write: Callable[[T], str] = str) -> object:
    """Return the annotation of an option whose text `parse` reads.

    A `ValueError` of `parse` is the user's mistake.
    """
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: parse(texts[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: ["" if value is None else write(value)],
    )


def text_of(metavar: str) -> object:
    """Return the annotation of a text on the command line that may be an object in Python."""
    return parsed(str, metavar)


def profile_option(default: str) -> object:
    """Return the annotation of `--profile`.

    `default` says in words which profile is taken without it and `--robot`.
    """
    hint = f"{default}; for another --robot the numbers of its file"
    return option(
        metavar="PROFILE",
        default=hint,
        help="Name of a shipped profile, or path of a profile (.toml).",
    )


def controller_and_reference(
    controller: str, reference: str | None, user_class: str | None
) -> tuple[str, str]:
    """Return controller and reference of a command line.

    It says `CONTROLLER REFERENCE` or `--controller FILE.py:NAME REFERENCE`.

    Raises:
        UserError: one of the two is missing, or there are two controllers.
    """
    first = shortened(controller, 40)
    if user_class is None:
        if reference is None:
            raise UserError(f"'{first}' stands alone; wanted a controller and a reference")
        return controller, reference
    if reference is not None:
        second = shortened(user_class, 60)
        raise UserError(f"there are two controllers, '{first}' and --controller {second}")
    # the only text without a name is the reference
    return user_class, controller


# --- how texts are read ---


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _names(text: str) -> tuple[str, ...]:
    names = tuple(_parts(text))
    if len(set(names)) != len(names):
        raise UserError(f"a name stands twice in '{text}'")
    return names


def _increasing(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, _parts(text)))
    except ValueError as error:
        raise UserError(f"'{text}' is no list of numbers such as 2,6,30,60") from error
    if any(not 0.0 < n < math.inf for n in numbers) or any(b <= a for a, b in pairwise(numbers)):
        raise UserError(f"'{text}' must be positive numbers that increase, such as 2,6,30,60")
    return numbers


def _pairs(read: Callable[[str], T], form: str) -> Callable[[str], dict[str, T]]:
    """Return a function that reads NAME=SOMETHING,... as a dictionary, each name once."""

    def parse(text: str) -> dict[str, T]:
        values: dict[str, T] = {}
        for part in _parts(text):
            name, equals, value = (piece.strip() for piece in part.partition("="))
            try:
                if not equals or not name or name in values:
                    raise ValueError
                values[name] = read(value)
            except ValueError as error:
                raise UserError(f"'{part}' must be {form}, each name once") from error
        return values

    return parse


def _finite(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UserError(f"'{shortened(text, 40)}' must be a finite number")
    return number


def _span(text: str) -> tuple[float, float]:
    low, high = text.split(":")
    return float(low), float(high)


def _some(text: str) -> str:
    if not text:
        raise ValueError
    return text


def _column(text: str) -> tuple[str, str]:
    name, _, unit = _some(text).rpartition(":") if ":" in text else (text, "", "")
    return name.strip(), unit.strip()


def _digits(number: float) -> str:
    return f"{number:.15g}"


def values_text(values: Mapping[str, float]) -> str:
    """Return numbers by name as the command line takes them."""
    return ",".join(f"{name}={_digits(number)}" for name, number in values.items())


def _bounds_text(bounds: Mapping[str, tuple[float, float]]) -> str:
    return ",".join(
        f"{name}={_digits(low)}:{_digits(high)}" for name, (low, high) in bounds.items()
    )


def _columns_text(columns: Mapping[str, tuple[str, str]]) -> str:
    return ",".join(f"{name}={column}:{unit}" for name, (column, unit) in columns.items())


def _whole(least: int, most: int = 2**31 - 1) -> Callable[[str], int]:
    def parse(text: str) -> int:
        try:
            number = int(text) if len(text) < 40 else most + 1
        except ValueError:
            number = least - 1
        if not least <= number <= most:
            bound = f"from {least} on" if number < least else f"up to {most}"
            raise UserError(f"'{shortened(text, 40)}' must be a whole number {bound}")
        return number

    return parse


NUMBERS = tyro.constructors.ConstructorRegistry()
"""Rules for numbers of every option that says no more than its type."""


@NUMBERS.primitive_rule
def _number_rule(kind: tyro.constructors.PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read a float as a finite number, and an int as one that 64 bits hold."""
    readers: dict[object, Callable[[str], Any]] = {
        float: _finite,
        int: _whole(-MOST_SEED, MOST_SEED),
    }
    if kind.type not in readers:
        return None
    read = readers[kind.type]
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=kind.type.__name__.upper(),
        instance_from_str=lambda texts: read(texts[0]),
        is_instance=lambda value: isinstance(value, int | float),
        str_from_instance=lambda value: [str(value)],
    )


# --- types of options ---

read_values = _pairs(_finite, "NAME=NUMBER such as friction=0.4")
"""Function that reads NAME=NUMBER,... as a dictionary."""
_BOUNDS = _pairs(_span, "NAME=LOW:HIGH such as friction=0.2:0.8")
_COLUMNS = _pairs(_column, "NAME=COLUMN or NAME=COLUMN:UNIT such as yaw=heading:deg")
_TOPICS = _pairs(_some, "ROLE=TOPIC such as odom=/odometry/filtered")

Flag = Annotated[
    bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(prefix_name=False, help_behavior_hint="")
]
"""An option without a value, off unless given."""
Names = Annotated[tuple[str, ...], parsed(_names, "A,B,...", ",".join)]
"""Comma-separated names, none twice. The function that gets them knows which there are."""
Numbers = Annotated[
    tuple[float, ...], parsed(_increasing, "X,Y,...", lambda v: ",".join(map(_digits, v)))
]
"""Comma-separated positive numbers that increase."""
Values = Annotated[Mapping[str, float], parsed(read_values, "NAME=X,...", values_text)]
"""NAME=NUMBER,... as a mapping."""
Bounds = Annotated[
    Mapping[str, tuple[float, float]], parsed(_BOUNDS, "NAME=LOW:HIGH,...", _bounds_text)
]
"""NAME=LOW:HIGH,... as a mapping to pairs."""
Topics = Annotated[
    Mapping[str, str],
    parsed(_TOPICS, "ROLE=TOPIC,...", lambda v: ",".join(map("=".join, v.items()))),
]
"""ROLE=TOPIC,... as a mapping."""
Number = Annotated[float | None, parsed(_finite, "X", _digits)]
"""A finite number, or None where the option is not given."""
Count = Annotated[int | None, parsed(_whole(1), "N")]
"""A whole number from 1 on, or None where the option is not given."""
Seed = Annotated[
    int,
    parsed(_whole(0, MOST_SEED), "N"),
    option(help="Seed of everything random. Equal seeds give equal results."),
]
"""The seed of a program, not negative."""
Workers = Annotated[
    Count,
    option(
        default="all processors",
        help="Threads that compute. The result does not depend on how many there are.",
    ),
]
"""The number of threads; None for as many as there are processors."""
Limits = Annotated[
    LogLimits,
    parsed(lambda text: USUAL.changed(read_values(text)), "NAME=X,...", lambda limits: ""),
    option(
        default="those of docs/logs.md",
        help="Other limits of a recording, such as span=1e7,gap=1e4. A wrong name lists all.",
    ),
]
"""NAME=NUMBER,... as limits of a log that replace the usual ones."""
Columns = Annotated[
    Mapping[str, tuple[str, str]],
    parsed(_COLUMNS, "NAME=COLUMN[:UNIT],...", _columns_text),
    option(
        default="our names and units",
        help="Columns of a CSV file with other names or units: "
        "x=pos_x,yaw=heading:deg,t=stamp:ms,enc_left=wl:m/s.",
    ),
]
"""NAME=COLUMN:UNIT,... as a mapping to names in a file and units."""
AnyRobot = Annotated[
    Robot | str | Path | None,
    text_of("ROBOT"),
    option(
        default="the profile's", help="Name of a shipped robot, or path of a robot's file (.toml)."
    ),
]
"""The robot: itself, its name or its path; None for that of the profile."""
AnyProfile = Annotated[Profile | str | Path | None, text_of("PROFILE")]
"""The plants' parameters: themselves, their name or their path; with a `profile_option` beside
it."""
OwnModel = Annotated[
    PlanarLaw | str | None,
    text_of("FILE.py:NAME"),
    option(
        "model",
        default="none",
        help="A plant of your own: a PlanarLaw in a Python file, which is run.",
    ),
]
"""A planar model of the user's own."""
OwnMetric = Annotated[
    Callable[..., float] | str | None,
    text_of("FILE.py:NAME"),
    option(
        "metric",
        default="none",
        help="A column of your own: a function in a Python file, which is run.",
    ),
]
"""A metric of the user's own: a function of a motion and its reference."""
Ground = Annotated[
    Terrain,
    parsed(parse_terrain, "GROUND", lambda terrain: terrain.spec),
    option(help="Ground under the MuJoCo robot: flat, or ramp:DEG; docs/physics.md has more keys."),
]
"""Ground of the MuJoCo robot."""
