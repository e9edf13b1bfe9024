"""Every option is checked against its annotation here, from Python and the command line alike."""

from __future__ import annotations

import math
import re
import reprlib
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from typeguard import CollectionCheckStrategy, TypeCheckError, check_type
from tyro.constructors import PrimitiveConstructorSpec

_WORDS = {
    int: "a whole number",
    float: "a number",
    str: "a text",
    Path: "a path",
    type(None): "None",
}


class Checked:
    """Base of every dataclass of options."""

    def __post_init__(self) -> None:
        """Check all options.

        A text is read as the command line reads it, and a list stands for a tuple.

        Raises:
            ValueError: an option is of another type than its annotation says, or out of its
                range; the message names it.
        """
        options: Any = self
        kind: Any = type(options)
        hints = hints_of(kind)
        for option in fields(options):
            value = _accepted(option.name, getattr(options, option.name), hints[option.name])
            object.__setattr__(options, option.name, value)


@cache
def hints_of(options: Any) -> Mapping[str, Any]:
    """Return the annotation of each option of a dataclass, with its markers."""
    return typing.get_type_hints(options, include_extras=True)


def _accepted(name: str, given: Any, hint: Any) -> Any:
    """Return the first form of a given value that its annotation admits."""
    kind = without_markers(hint)
    readers = [marker for marker in _markers(hint) if isinstance(marker, PrimitiveConstructorSpec)]
    for value in _forms(name, given, readers):
        if _is_of(kind, value):
            _require_readable(name, value, readers)
            return value
    choices = choices_of(kind)
    if choices:
        raise ValueError(f"unknown {name} {reprlib.repr(given)}; there are: {', '.join(choices)}")
    raise ValueError(f"{name} is {reprlib.repr(given)}, wanted {_words(kind)}")


def _forms(
    name: str, given: Any, readers: Iterable[PrimitiveConstructorSpec[Any]]
) -> Iterator[Any]:
    yield given
    if isinstance(given, np.generic):
        yield given.item()
    if isinstance(given, list):
        yield tuple(given)
    if isinstance(given, str):
        yield Path(given)
        for reader in readers:
            yield _read(name, given, reader)


def _require_readable(
    name: str, value: Any, readers: Iterable[PrimitiveConstructorSpec[Any]]
) -> None:
    """Refuse values that the command line would refuse, such as seeds below zero."""
    parts = value if isinstance(value, tuple) else (value,)
    if any(isinstance(part, float) and math.isnan(part) for part in parts):
        raise ValueError(f"{name} must be a finite number, got {value}")
    if all(isinstance(part, int | float | str | Mapping) for part in parts):
        for reader in readers:
            _read(name, reader.str_from_instance(value)[0], reader)


def _read(name: str, text: str, reader: PrimitiveConstructorSpec[Any]) -> Any:
    try:
        return reader.instance_from_str([text])
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _is_of(kind: Any, value: Any) -> bool:
    if isinstance(value, bool) and bool not in (kind, *typing.get_args(kind)):
        return False  # to Python a truth value is a whole number
    try:
        check_type(value, kind, collection_check_strategy=CollectionCheckStrategy.ALL_ITEMS)
    except TypeCheckError:
        return False
    return True


def _markers(hint: Any) -> list[Any]:
    """Return the markers of a type and of the members of its union."""
    if typing.get_origin(hint) is typing.Annotated:
        return [*_markers(hint.__origin__), *hint.__metadata__]
    members = typing.get_args(hint) if _is_union(hint) else ()
    return [marker for member in members for marker in _markers(member)]


def without_markers(hint: Any) -> Any:
    """Return the type that an annotation stands for, and so of each member of a union."""
    if typing.get_origin(hint) is typing.Annotated:
        return without_markers(hint.__origin__)
    if _is_union(hint):
        members = map(without_markers, typing.get_args(hint))
        return typing.Union[tuple(members)]  # noqa: UP007 - of a list
    return hint


def _is_union(hint: Any) -> bool:
    return typing.get_origin(hint) in (typing.Union, types.UnionType)


def _words(kind: Any) -> str:
    """Return the name of a type as a message has it."""
    if _is_union(kind):
        return " or ".join(map(_words, typing.get_args(kind)))
    name = kind.__name__ if isinstance(kind, type) and not typing.get_args(kind) else str(kind)
    return _WORDS.get(kind) or re.sub(r"\b(\w+\.)+", "", name)


def choices_of(kind: Any) -> list[str]:
    """Return the texts that a type of choices, or of choices or nothing, admits."""
    choices: list[str] = []
    for member in typing.get_args(kind) if _is_union(kind) else (kind,):
        if typing.get_origin(member) is typing.Literal:
            choices += map(str, member.__args__)
    return choices
