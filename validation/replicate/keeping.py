"""Findings of sections on disk, so that an interrupted replication goes on: written whole, read with suspicion.

A section's file holds two digests. One is of everything that decides the findings, see `Section.digest`; the other is of the
findings themselves and of their pictures' bytes. Where either is another, the section is run again.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ssmr.errors import SsmrError
from validation import reading, store
from validation.replicate.evidence import (
    FIGURE_FOLDER,
    SECTION_FOLDER,
    Answer,
    Context,
    Findings,
    Section,
    require_picture_name,
)

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
    document = store.plain(document)
    document["content"] = _content(document, context.folder)
    store.write_json(_file(context.folder, section), document)
    for state in (context.folder / SECTION_FOLDER).glob(f"{section.key}-*.npz"):
        state.unlink(missing_ok=True)


def kept(folder: Path, section: Section, digest: str) -> Answer | None:
    """Return a section's kept findings; None if there are none of this digest, or they were changed."""
    path = _file(folder, section)
    if not path.exists():
        return None
    try:
        document = reading.read_json(path, _MOST_BYTES)
        if not isinstance(document, dict) or document.get("schema") != _SCHEMA:
            raise ValueError(f"{path}: these are not the findings of a section")
        if document.get("digest") != digest:
            return None  # of other settings, inputs, code or versions
        effort = built(Mapping[str, float], document.get("effort"))
        answer = Answer(section, built(Findings, document.get("findings")), **effort)
        _require_drawable(answer)
        if document.get("section") != section.key or document.get("content") != _content(document, folder):
            raise ValueError(f"{path}: findings or pictures were changed after they were written")
    except (ValueError, TypeError, SsmrError) as error:
        _log.warning("%s; the section is run again", error)
        return None
    return answer


def _file(folder: Path, section: Section) -> Path:
    return folder / SECTION_FOLDER / f"{section.key}.json"


def _content(document: Mapping[str, Any], folder: Path) -> str:
    """Return a digest of what was found and of its pictures; `digest` stands for all that it was found with."""
    whole = {key: document[key] for key in ("section", "digest", "effort", "findings")}
    digest = hashlib.sha256(json.dumps(whole, sort_keys=True).encode())
    for picture in document["findings"]["pictures"]:
        digest.update(hashlib.sha256(picture_bytes(folder / FIGURE_FOLDER, picture["file"])).digest())
    return digest.hexdigest()


def _require_drawable(answer: Answer) -> None:
    """Refuse findings that no section makes and no report can show.

    Raises:
        ValueError: a table is not the section's or is empty, a rule lacks its number, or a row is not as wide as its header.
    """
    tables, grids = answer.findings.tables, answer.findings.grids.values()
    rows = [pairs for table in tables.values() for pairs in (table.rows.values() or [{}])]
    pairs = [pair for row in rows for pair in row.values()]
    fits = (
        set(tables) <= set(answer.section.tables)
        and all(rows)
        and all("at_least" in pair.beside for pair in pairs if pair.rule == "at_least")
        and all(("lower" in pair.beside) == ("upper" in pair.beside) for pair in pairs)
        and all(len(row) == len(grid.header) for grid in grids for group in grid.groups for row in group)
    )
    if not fits:
        raise ValueError(f"section {answer.section.key}: its findings are incomplete")


def picture_bytes(figures: Path, file: str) -> bytes:
    """Return what a picture's file holds, which must lie in this folder itself.

    Raises:
        SsmrError: it is missing, cannot be read, or leads out of the folder.
        ValueError: this is no name of a picture.
    """
    require_picture_name(file)
    path = figures / file
    try:
        if path.resolve().parent != figures.resolve():
            raise ValueError(f"{path}: this leads out of the folder of pictures")
        return reading.read_file(path, _MOST_BYTES)
    except (ValueError, OSError, RuntimeError) as error:  # a ring of links is a RuntimeError
        raise SsmrError(str(error)) from error


def built(kind: Any, data: Any) -> Any:
    """Return data from JSON as a value of this type: dataclasses, mappings, tuples and what they are made of.

    Raises:
        ValueError: the data have another form, or the dataclass refuses them.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if is_dataclass(kind) and isinstance(data, dict):
        hints = get_type_hints(kind)
        if set(data) == set(hints):
            return kind(**{name: built(hint, data[name]) for name, hint in hints.items()})  # type: ignore[operator]
    elif origin is Mapping and isinstance(data, dict):
        return {key: built(inner[1], value) for key, value in data.items()}
    elif origin is tuple and isinstance(data, list):
        kinds = inner[:1] * len(data) if inner[1:] == (...,) else inner
        if len(kinds) == len(data):
            return tuple(built(each, value) for each, value in zip(kinds, data, strict=True))
    elif origin in (Union, UnionType):
        return None if data is None else built(next(each for each in inner if each is not NoneType), data)
    elif kind is Any or (origin is Literal and data in inner):
        return data
    elif isinstance(data, (int, float) if kind is float else kind) and (kind is bool or not isinstance(data, bool)):
        return data
    raise ValueError(f"findings have another form: {str(data)[:40]!a}, wanted {getattr(kind, '__name__', kind)}")
