"""The options of a program: the fields of a frozen dataclass, given in Python or as texts.

The docstrings below the fields are the help. tyro reads whole numbers, numbers, choices and flags;
the other types, and how their texts are read, are in `_TEXTS`; a list of texts has commas.
"""

from __future__ import annotations

import inspect
import math
import re
import reprlib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, asdict, fields
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import tyro
from docstring_parser import parse_from_object
from typeguard import CollectionCheckStrategy, TypeCheckError, check_type
from tyro.constructors import (
    MISSING_NONPROP,
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from ssmr.scenarios import TRAJECTORIES
from validation.files.csv_logs import with_frames_apart
from validation.files.limits import USUAL, LogLimits
from validation.output import one_line, shorten_text
from validation.plants.profile import Profile
from validation.simulator.description import Robot
from validation.simulator.terrain import Terrain, parse_terrain

T = TypeVar("T")
AnyRobot = Robot | str | Path | None
"""The robot: itself, its name or its path; None for that of the profile."""
AnyProfile = Profile | str | Path | None
"""The plants' parameters: themselves, their name or their path."""
AnyPath = str | Path | None
"""The path of a file or a folder."""
Since = Annotated[float | None, tyro.conf.arg(name="from")]
"""The time before which a log is left out; `from` is no name in Python."""


class Options:
    """Base of every dataclass of options."""

    def __post_init__(self) -> None:
        """Check all options.

        A list stands for a tuple, and a text is read as on the command line.

        Raises:
            ValueError: an option is of another type than its annotation says, or not finite; the
                message names it.
        """
        kinds = kinds_of(type(self))  # type: ignore[arg-type]
        # a frame may not pass for a scenario
        frames = dict.fromkeys(TRAJECTORIES)
        for name, kind in kinds.items():
            value = _admit_value(with_frames_apart(getattr(self, name), frames), kind)
            _require_kind(name, value, kind)
            object.__setattr__(self, name, value)


@cache
def kinds_of(options: Any) -> Mapping[str, Any]:
    """Return the type of each option of a dataclass."""
    hints = typing.get_type_hints(options)
    return {option.name: hints[option.name] for option in fields(options)}


def _admit_value(value: Any, kind: Any) -> Any:
    """Return a given value in the form that its type asks for."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list):
        return tuple(value)
    if isinstance(value, Mapping):
        # JSON has no tuples
        return {name: _admit_value(part, Any) for name, part in value.items()}
    if not isinstance(value, str) or value in chain(*map(_choices_of, _union_members(kind))):
        return value
    if kind == AnyPath:
        return Path(value)
    form = _form_of(kind)
    if form is None:
        return value
    try:
        return form[1](value)
    except ValueError as error:
        raise ValueError(f"'{shorten_text(value, 40)}' must be {form[0]}: {error}") from error


def read_value(value: T | str) -> T:
    """Return the value of an option, of which `Options` made a `T` if it was given as a text."""
    assert not isinstance(value, str)
    return value


def words_of(kind: Any) -> str:
    """Return a type as people read it, without the modules of its parts."""
    text = kind if isinstance(kind, str) else inspect.formatannotation(kind)
    return re.sub(r"\b(\w+\.)+", "", text)


def _require_kind(name: str, value: Any, kind: Any) -> None:
    """Raise a ValueError for an option that is not of its type, or no finite number."""
    try:
        check_type(value, kind, collection_check_strategy=CollectionCheckStrategy.ALL_ITEMS)
        if isinstance(value, bool) and bool not in _union_members(kind):
            raise TypeCheckError("to Python a truth value is a whole number")
    except TypeCheckError as error:
        given = one_line(reprlib.repr(value))
        raise ValueError(f"{name} is {given}, wanted {words_of(kind)}") from error
    parts = value if isinstance(value, tuple) else (value,)
    if any(isinstance(part, float) and math.isnan(part) for part in parts):
        raise ValueError(f"{name} is {value}, wanted a finite number")
    if Sequence[float] in _union_members(kind) and [0.0, *parts] != sorted({0.0, *parts}):
        raise ValueError(f"{name} is {text_of(value)}, wanted positive numbers that increase")


def _union_members(kind: Any) -> tuple[Any, ...]:
    """Return the members of a union; a type that is none is its only member."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return tuple(map(_as_list, typing.get_args(kind)))
    return (_as_list(kind),)


def _as_list(kind: Any) -> Any:
    """Return the type of a list for that of a tuple of any length."""
    parts = typing.get_args(kind)
    is_endless = typing.get_origin(kind) is tuple and parts[-1:] == (...,)
    return typing.cast(Any, Sequence)[parts[0]] if is_endless else kind


# --- how texts are read ---


def _split_names(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(",") if part.strip())
    if len(set(names)) < len(names):
        raise ValueError("a name stands twice")
    return names


def _read_numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(",") if part.strip())


def _pairs_reader(read: Callable[[str], T]) -> Callable[[str], dict[str, T]]:
    """Return a function that reads NAME=SOMETHING,... as a dictionary, each name once."""

    def parse(text: str) -> dict[str, T]:
        values = {}
        for part in _split_names(text):
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not equals or not name or name in values:
                raise ValueError(f"'{part}' is no pair, or its name stands twice")
            values[name] = read(value)
        return values

    return parse


def _read_span(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    return float(low), float(high)


def _read_column(text: str) -> tuple[str, str]:
    name, _, unit = text.rpartition(":") if ":" in text else (text, "", "")
    if not name:
        raise ValueError("a column has no name")
    return name.strip(), unit.strip()


_TEXTS = {
    Sequence[float]: ("X,Y,...", _read_numbers),
    tuple[float, float, float]: ("X,Y,YAW", _read_numbers),
    Mapping[str, float]: ("NAME=X,...", _pairs_reader(float)),
    Mapping[str, tuple[float, float]]: ("NAME=LOW:HIGH,...", _pairs_reader(_read_span)),
    Mapping[str, tuple[str, str]]: ("NAME=COLUMN[:UNIT],...", _pairs_reader(_read_column)),
    Mapping[str, str]: ("ROLE=TOPIC,...", _pairs_reader(str)),
    LogLimits: ("NAME=X,...", lambda text: USUAL.changed(_pairs_reader(float)(text))),
    Terrain: ("GROUND", parse_terrain),
}
"""Form of the text of each type, and the function that reads it."""


def _is_list(kind: Any) -> bool:
    return typing.get_origin(kind) is Sequence


def _choices_of(kind: Any) -> tuple[Any, ...]:
    """Return the choices of a type; none of a type that has no list of them."""
    return typing.get_args(kind) if typing.get_origin(kind) is typing.Literal else ()


def _form_of(kind: Any) -> tuple[str, Callable[[str], Any]] | None:
    """Return the form of the text of a type, and the function that reads it; None without one."""
    members = _union_members(kind)
    for member in members:
        if member in _TEXTS:
            return _TEXTS[member]
        # where a text may stay one, it names a single thing
        if (
            str not in members
            and _is_list(member)
            and str in _union_members(*typing.get_args(member))
        ):
            return "A,B,...", _split_names
    return None


def text_of(value: Any) -> str:
    """Return a value as the command line takes it."""
    if isinstance(value, Mapping):
        return ",".join(f"{name}={text_of(part)}" for name, part in value.items())
    if isinstance(value, tuple):
        return ",".join(map(text_of, value))
    if value == USUAL:
        return "those of docs/logs.md"
    if isinstance(value, LogLimits):
        return text_of({name: x for name, x in asdict(value).items() if x != getattr(USUAL, name)})
    return str(getattr(value, "spec", value))


REGISTRY = ConstructorRegistry()
"""How tyro reads and prints the types of our options."""


@REGISTRY.primitive_rule
def _text_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read a type of `_TEXTS`; an object that Python may give has its name on the command line."""
    kind = info.type
    members = _union_members(kind)
    form = _form_of(kind)
    metavar = "NAME|PATH" if Path in members else "NAME"
    if kind == AnyPath:
        metavar = "PATH"
    elif form is not None:
        choices = [f"{{{','.join(names)}}}" for names in map(_choices_of, members) if names]
        metavar = "|".join([*choices, form[0]])
    elif len(members) == 1 or str not in members:
        return None
    # one after the other where nothing else can follow
    many = tyro.conf.Positional in info.markers and any(map(_is_list, members))
    return PrimitiveConstructorSpec(
        nargs="*" if many else 1,
        metavar=metavar,
        instance_from_str=lambda texts: tuple(texts) if many else _admit_value(texts[0], kind),
        is_instance=lambda value: True,
        str_from_instance=lambda value: [text_of(value)],
    )


@cache
def meanings_of(command: Any) -> Mapping[str, str]:
    """Return what each option of a dataclass or a function means, in one line each."""
    meanings = {}
    # of a class those of its bases first, but for object, which has none
    for kind in command.__mro__[-2::-1] if inspect.isclass(command) else [command]:
        for option in parse_from_object(kind).params:
            meanings[option.arg_name] = " ".join((option.description or "").split())
    return meanings


def _meaning_of(command: Any, name: str) -> str | None:
    return meanings_of(command).get(name)


@REGISTRY.struct_rule
def _options_rule(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Describe the options of a dataclass or a function, with defaults that say something."""
    command: Any = info.type
    kind = inspect.unwrap(command)
    if not inspect.isfunction(kind) and not (inspect.isclass(kind) and issubclass(kind, Options)):
        return None
    options = inspect.signature(command).parameters.values()
    if any(option.kind is option.POSITIONAL_ONLY for option in options):
        return None  # tyro gives such a rule's options by name
    hints = typing.get_type_hints(kind, include_extras=True)
    described = []
    for option in options:
        default = _default_of(option, info)
        is_silent = default is None or default is False or default is MISSING_NONPROP
        says = "" if is_silent else text_of(default)
        hint = tyro.conf.arg(help_behavior_hint=f"(default: {says})" if says else "")
        hinted: Any = Annotated[hints[option.name], hint]
        # meanings are read from the source, when somebody asks for help
        means = partial(_meaning_of, command, option.name)
        described.append(StructFieldSpec(option.name, hinted, default, means))
    return StructConstructorSpec(command, tuple(described))


def _default_of(option: inspect.Parameter, info: StructTypeInfo) -> Any:
    """Return the default of an option; what tyro has for none where it must be given."""
    if isinstance(info.default, Options):
        return getattr(info.default, option.name)
    declared = getattr(info.type, "__dataclass_fields__", {}).get(option.name)
    if declared is not None and declared.default_factory is not MISSING:
        return declared.default_factory()
    return MISSING_NONPROP if option.default is option.empty else option.default
