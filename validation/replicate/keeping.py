"""Findings of sections on disk, so that an interrupted replication goes on; each is written whole or not at all.

A section's file holds a digest of everything that decides the findings, see `Section.digest`. Where that is another, or the
file or a picture cannot be read, the section is run again.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from ssmr.errors import SsmrError
from validation import store
from validation.files import reading
from validation.replicate.evidence import FIGURE_FOLDER, SECTION_FOLDER, Answer, Context, Findings, Section

_log = logging.getLogger(__name__)
_SCHEMA = "ssmr.evidence/2"
_MOST_BYTES = 1 << 26
"""Greatest size of a section's file, and of a picture; they have some hundred thousand bytes."""


def keep(context: Context, answer: Answer) -> None:
    """Write a section's findings, whole or not at all, and remove the states of its searches."""
    section = answer.section
    document = {
        "schema": _SCHEMA,
        "section": section.key,
        "digest": context.digest,
        "settings": {name: getattr(context.settings, name) for name in section.needs},
        "versions": store.versions(),
        "effort": {"wall_s": answer.wall_s, "cpu_s": answer.cpu_s},
        "findings": asdict(answer.findings),
    }
    store.write_json(_file(context.folder, section), store.plain(document))
    for state in (context.folder / SECTION_FOLDER).glob(f"{section.key}-*.npz"):
        state.unlink(missing_ok=True)


def kept(folder: Path, section: Section, digest: str) -> Answer | None:
    """Return a section's kept findings; None if there are none of this digest, or they cannot be read."""
    path = _file(folder, section)
    if not path.exists():
        return None
    try:
        document = reading.read_json(path, _MOST_BYTES)
        if (document["schema"], document["digest"]) != (_SCHEMA, digest):
            return None  # of other settings, inputs, code or versions
        answer = Answer(section, _built(Findings, document["findings"]), **document["effort"])
        for picture in answer.findings.pictures:
            picture_bytes(folder / FIGURE_FOLDER, picture.file)
    except (LookupError, TypeError, AttributeError, ValueError, SsmrError) as error:
        _log.warning("%s cannot be used (%s: %s); the section is run again", path, type(error).__name__, error)
        return None
    return answer


def _file(folder: Path, section: Section) -> Path:
    return folder / SECTION_FOLDER / f"{section.key}.json"


def picture_bytes(figures: Path, file: str) -> bytes:
    """Return what a picture's file holds.

    Raises:
        SsmrError: it is missing, or cannot be read.
    """
    try:
        return reading.read_file(figures / file, _MOST_BYTES)
    except ValueError as error:
        raise SsmrError(str(error)) from error


def _built(kind: Any, data: Any) -> Any:
    """Return data from JSON as a value of this type: dataclasses, mappings, tuples and what they are made of."""
    origin, inner = get_origin(kind), get_args(kind)
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(**{name: _built(hints[name], value) for name, value in data.items()})  # type: ignore[operator]
    if origin is Mapping:
        return {key: _built(inner[1], value) for key, value in data.items()}
    if origin is tuple:
        kinds = inner[:1] * len(data) if inner[1:] == (...,) else inner
        return tuple(_built(each, value) for each, value in zip(kinds, data, strict=True))
    if origin in (Union, UnionType) and data is not None:
        return _built(next(each for each in inner if each is not NoneType), data)
    return data
