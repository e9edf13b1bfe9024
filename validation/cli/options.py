"""The options of command lines: annotations, how their texts are read, and the groups that several programs share.

A program declares its options as a frozen dataclass, in groups that are dataclasses too; a group's field name is its
heading in the help text. Every number is checked here, before any work: it is finite, and fits into 64 bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from ssmr.parameters import MOST_SEED
from validation.files.limits import USUAL, LogLimits
from validation.plants.profile import Profile
from validation.simulator.description import Robot
from validation.simulator.terrain import Terrain, parse_terrain
from validation.words import shortened

T = TypeVar("T")

MOST_COUNT = 2**31 - 1
"""Greatest number of anything that is counted."""


class UserError(ValueError):
    """The user asked for something that cannot be; the message is one line that says what was wrong and what is right."""


def option(
    name: str | None = None, *, metavar: str | None = None, default: str | None = None, help: str | None = None
) -> object:
    """Return what to annotate an option with.

    Args:
        name: the option's name where the field cannot have it, such as `from`.
        metavar: what stands for its value in the help text.
        default: the default in words, where the value itself does not say it.
        help: the help text; else the docstring below the field.
    """
    hint = None if default is None else f"(default: {default})"
    return tyro.conf.arg(name=name, metavar=metavar, help=help, help_behavior_hint=hint, prefix_name=False)


def one_of(names: Iterable[str]) -> Any:
    """Return what to annotate an argument with that is one of these names: the help lists them, others are refused."""
    return tyro.conf.arg(constructor=tyro.extras.literal_type_from_choices(names), prefix_name=False)


def controller_and_reference(controller: str, reference: str | None, own: str | None) -> tuple[str, str]:
    """Return controller and reference of a command line `CONTROLLER REFERENCE`, or `--controller FILE.py:NAME REFERENCE`.

    Raises:
        UserError: one of the two is missing, or there are two controllers.
    """
    if own is None and reference is None:
        raise UserError(f"'{shortened(controller, 40)}' stands alone; wanted a controller and a reference")
    if own is not None and reference is not None:
        raise UserError(f"there are two controllers, '{shortened(controller, 40)}' and --controller {shortened(own, 60)}")
    return (controller, reference) if reference is not None else (own or "", controller)


def parsed(parse: Callable[[str], T], metavar: str, write: Callable[[T], str] = str) -> object:
    """Return what to annotate an option with whose text `parse` reads; a `ValueError` of it is the user's mistake."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: parse(texts[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: [write(value)],
    )


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _comma_names(text: str) -> tuple[str, ...]:
    found = tuple(_parts(text))
    if len(set(found)) != len(found):
        raise UserError(f"a name stands twice in '{text}'")
    return found


def _comma_numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, _parts(text)))
    except ValueError as error:
        raise UserError(f"'{text}' is no list of numbers such as 2,6,30,60") from error
    if any(not 0.0 < n < math.inf for n in numbers) or any(b <= a for a, b in pairwise(numbers)):
        raise UserError(f"'{text}' must be positive numbers that increase, such as 2,6,30,60")
    return numbers


def _comma_pairs(text: str, read: Callable[[str], T], form: str) -> dict[str, T]:
    """Return NAME=SOMETHING,... as a dictionary; a UserError refuses another form, and a name that stands twice."""
    found: dict[str, T] = {}
    for part in _parts(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        try:
            if not equals or not name or name in found:
                raise ValueError
            found[name] = read(value)
        except ValueError as error:
            raise UserError(f"'{part}' must be {form}, each name once") from error
    return found


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


def read_values(text: str) -> dict[str, float]:
    """Return NAME=NUMBER,... as a dictionary.

    Raises:
        UserError: a part has another form, or a name stands twice.
    """
    return _comma_pairs(text, _finite, "NAME=NUMBER such as friction=0.4")


def _whole(least: int, most: int = MOST_COUNT) -> Callable[[str], int]:
    def parse(text: str) -> int:
        try:
            number = int(text) if len(text) < 40 else most + 1
        except ValueError:
            number = least - 1
        if number < least:
            raise UserError(f"'{shortened(text, 40)}' must be a whole number from {least} on")
        if number > most:
            raise UserError(f"'{shortened(text, 40)}' must be a whole number up to {most}")
        return number

    return parse


NUMBERS = tyro.constructors.ConstructorRegistry()
"""Rules for numbers of every option that says no more than its type."""


@NUMBERS.primitive_rule
def _number_rule(kind: tyro.constructors.PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read a float as a finite number, and an int as one that 64 bits hold."""
    readers: dict[object, Callable[[str], Any]] = {float: _finite, int: _whole(-MOST_SEED, MOST_SEED)}
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


Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(prefix_name=False, help_behavior_hint="")]
"""An option without a value, off unless given."""
Names = Annotated[tuple[str, ...], parsed(_comma_names, "A,B,...", ",".join)]
"""Comma-separated names, none twice. The function that gets them knows which there are."""
Numbers = Annotated[tuple[float, ...], parsed(_comma_numbers, "X,Y,...", lambda v: ",".join(f"{x:g}" for x in v))]
"""Comma-separated positive numbers that increase."""
Values = Annotated[
    Mapping[str, float], parsed(read_values, "NAME=X,...", lambda v: ",".join(f"{k}={x:g}" for k, x in v.items()))
]
"""NAME=NUMBER,... as a mapping."""
Bounds = Annotated[
    Mapping[str, tuple[float, float]],
    parsed(
        lambda text: _comma_pairs(text, _span, "NAME=LOW:HIGH such as friction=0.2:0.8"),
        "NAME=LOW:HIGH,...",
        lambda v: ",".join(f"{k}={a:g}:{b:g}" for k, (a, b) in v.items()),
    ),
]
"""NAME=LOW:HIGH,... as a mapping to pairs."""
Topics = Annotated[
    Mapping[str, str],
    parsed(lambda text: _comma_pairs(text, _some, "ROLE=TOPIC such as odom=/odometry/filtered"), "ROLE=TOPIC,..."),
]
"""ROLE=TOPIC,... as a mapping."""
Number = Annotated[float | None, parsed(_finite, "X", lambda v: "" if v is None else f"{v:g}")]
"""A finite number, or None where the option is not given."""
Count = Annotated[int | None, parsed(_whole(1), "N", lambda v: "" if v is None else str(v))]
"""A whole number from 1 on, or None where the option is not given."""
Seed = Annotated[
    int, parsed(_whole(0, MOST_SEED), "N"), option(help="Seed of everything random. Equal seeds give equal results.")
]
"""The seed of a program, not negative."""
Workers = Annotated[
    int | None,
    parsed(_whole(1), "N", lambda v: "" if v is None else str(v)),
    option(default="all processors", help="Threads that compute. The result does not depend on how many there are."),
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
View = Annotated[Flag, option(help="Open the recording in the rerun viewer afterwards.", default="off")]
ViewWeb = Annotated[
    Flag,
    option(
        help="Serve the recording to a browser on this machine afterwards, until Ctrl-C; --view web is the same.",
        default="off",
    ),
]
NoRerun = Annotated[Flag, option(help="Do not write the rerun recording (.rrd).", default="off")]


RobotName = Annotated[
    str | None,
    option(metavar="ROBOT", default="the profile's", help="Name of a shipped robot, or path of a robot's file (.toml)."),
]
"""The robot, by name or path; None for that of the profile."""


def text_of(metavar: str) -> object:
    """Return what to annotate an option with that is a text on the command line and may be an object in Python."""
    return parsed(str, metavar, lambda value: "" if value is None else str(value))


AnyRobot = Annotated[
    Robot | str | Path | None,
    text_of("ROBOT"),
    option(default="the profile's", help="Name of a shipped robot, or path of a robot's file (.toml)."),
]
"""The robot: itself, its name or its path; None for that of the profile."""
AnyProfile = Annotated[Profile | str | Path | None, text_of("PROFILE")]
"""The plants' parameters: themselves, their name or their path; with a `profile_option` beside it."""
Ground = Annotated[
    Terrain,
    parsed(parse_terrain, "GROUND", lambda terrain: terrain.spec),
    option(help="Ground under the MuJoCo robot: flat, ramp:DEG or rough:MM; docs/terrain.md has more keys."),
]
"""Ground of the MuJoCo robot."""


def profile_option(default: str) -> object:
    """Return the annotation of `--profile`; `default` says in words which profile is taken without it and `--robot`."""
    hint = f"{default}; for another --robot the numbers of its file"
    return option(metavar="PROFILE", default=hint, help="Name of a shipped profile, or path of a profile (.toml).")


def out_option(default: str) -> object:
    """Return the annotation of `--out`; `default` is the folder without it, such as runs/compare/SOURCE."""
    return option(metavar="DIR", default=f"the folder {default}", help="Folder that the files are written to.")


def require_rerun(what: str, remedy: str = "install it") -> None:
    """Refuse what needs rerun where it is not installed.

    Raises:
        UserError: there is no rerun.
    """
    if find_spec("rerun") is None:
        raise UserError(f"{what} needs the package rerun-sdk, which is missing: {remedy}")
