"""The options of a run as its JSON file has them, and a run that is repeated by that file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from validation.cli.options import Options, text_of
from validation.files.limits import USUAL, LogLimits
from validation.files.reading import FileError, quoted, read_text
from validation.output import Document
from validation.simulator.terrain import Terrain

_MOST_JSON = 1 << 26
"""Greatest size of a result [bytes]."""
_OF_A_CALL = {"config", "out", "overwrite", "progress", "view", "workers", "json", "resume"}
"""Options that say where results go and how a run is watched; a run that repeats it has its own."""
_ONLY_IN_PYTHON = "an object of Python"
"""Value in the file of an option that no text can say."""


def read_result(path: str | Path) -> Document:
    """Return the JSON document of a program of ours.

    Raises:
        FileError: the file cannot be read, or is no result of a program.
    """
    try:
        document = json.loads(read_text(path, _MOST_JSON))
    except (json.JSONDecodeError, RecursionError) as error:
        raise FileError(path, f"the file is no JSON ({error})") from error
    if not isinstance(document, dict) or not str(document.get("schema")).startswith("ssmr."):
        raise FileError(path, "the file is no result of a program; compare.json is one")
    return document


def config_of(program: str, options: Any) -> Document:
    """Return the options of a run as its JSON file has them, without those that are not given."""
    kept = {"program": program}
    for option in fields(options):
        value = _storable_value(getattr(options, option.name))
        if option.name not in _OF_A_CALL and value not in (None, {}, text_of(USUAL)):
            kept[option.name] = value
    return kept


def _storable_value(value: Any) -> Any:
    """Return a value in a form that JSON holds and `Options` takes."""
    if isinstance(value, Mapping):
        return {name: _storable_value(part) for name, part in value.items()}
    if isinstance(value, tuple):
        return [_storable_value(part) for part in value]
    if isinstance(value, Path | Terrain | LogLimits):
        return text_of(value)
    if isinstance(value, str | bool | int | float | None):
        return value
    return _ONLY_IN_PYTHON


def options_in(path: str | Path, program: str, options: Any) -> Document:
    """Return the options of a run by name.

    Args:
        path: its JSON file.
        program: name of the program that shall repeat it.
        options: dataclass of its options.

    Raises:
        FileError: the file is none, another program's, or has an option that cannot be had.
    """
    kept = read_result(path).get("config")
    if not isinstance(kept, dict):
        raise FileError(path, "it does not have the options of its run, which 2.1 and later write")
    of = kept.pop("program", None)
    if of != program:
        raise FileError(path, f"it has the options of {of}, wanted those of {program}")
    there = [option.name for option in fields(options) if option.name not in _OF_A_CALL]
    if unknown := [name for name in kept if name not in there]:
        raise FileError(
            path, f"{program} has no option {quoted(unknown)}; there are: {', '.join(there)}"
        )
    for name, value in kept.items():
        if value == _ONLY_IN_PYTHON:
            raise FileError(path, f"{name} was {value}, which no file can name")
    return kept


def options_from(path: str | Path, program: str, options: Any) -> Options:
    """Return the options of a run; arguments and errors are those of `options_in`."""
    kept = options_in(path, program, options)
    for option in fields(options):
        is_needed = option.default is MISSING and option.default_factory is MISSING
        if is_needed and option.name not in kept:
            raise FileError(path, f"the options have no {option.name}, which {program} needs")
    try:
        made = options(**kept)
    except ValueError as error:
        raise FileError(path, str(error)) from error
    return made
