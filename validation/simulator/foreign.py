"""A foreign MJCF or URDF: MuJoCo tries it in a child process with only the files of its folder.

MuJoCo's reader answers no signal while it works. A file that the child has read is as quick for
this process.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Iterable, Mapping
from pathlib import Path

import mujoco

from validation.files import guarded

ALLOWANCE = guarded.Allowance(seconds=10.0, memory=2 << 30)
"""Limits of reading and compiling a model, with all files that it includes."""
MOST_BYTES = 1 << 22
"""Greatest size of a text [bytes]; large ones of manipulators have a few hundred thousand."""
_MOST_FILES = 1000
"""Greatest number of the files that an MJCF brings."""
_MOST_SIZE = 1 << 26
"""Greatest total size of these files [bytes]."""


def xml_tree(text: str) -> ElementTree.Element:
    """Return the tree of an XML text.

    Raises:
        ValueError: it is none, or declares entities, which could grow.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError(
            "the file declares a document type or entities, which no robot has a use for; "
            "take them out"
        )
    try:
        # without declarations there are no entities to grow
        return ElementTree.fromstring(text)  # nosec B314
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"this is no XML ({error})") from error


def _own_files(text: str, folder: Path) -> dict[str, bytes]:
    """Return the files that an MJCF names and those that they include, by these names.

    Raises:
        ValueError: one lies outside of `folder`, is no regular file or no XML, or they are too many
            or too large.
    """
    files = dict[str, bytes]()
    folder = folder.resolve()
    waiting = [text]
    places = {""}
    while waiting:
        root = xml_tree(waiting.pop())
        for compiler in root.iter("compiler"):
            places |= {compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")}
        for part in root.iter():
            is_include = part.tag == "include"
            for name in [v for k, v in part.attrib.items() if k.startswith("file") and v]:
                path = _found(name, folder, {""} if is_include else places)
                if name in files:
                    continue
                size = path.stat().st_size + sum(map(len, files.values()))
                if size > _MOST_SIZE or len(files) >= _MOST_FILES:
                    raise ValueError(
                        f"it brings more than {_MOST_FILES} files or {_MOST_SIZE >> 20} MiB"
                    )
                files[name] = path.read_bytes()
                if is_include:
                    waiting.append(files[name].decode("utf-8", "replace"))
    return files


def _found(name: str, folder: Path, places: Iterable[str]) -> Path:
    """Return the path of a file that lies in one of the places below `folder`."""
    for place in places:
        path = (folder / place / name).resolve()
        if path.is_relative_to(folder) and path.is_file():
            return path
    raise ValueError(
        f"there is no file '{name}' in its folder, and files from elsewhere are not read"
    )


def tried_files(text: str, folder: Path | None = None) -> Mapping[str, bytes]:
    """Return the files of an MJCF or a URDF, by name, once a child process has compiled it.

    Args:
        text: the MJCF or URDF.
        folder: folder of its files; None for a text that may have none.

    Raises:
        ValueError: MuJoCo cannot, or not within `ALLOWANCE`, or a file is not to be had.
    """
    place = None if folder is None else str(folder.resolve())
    names, parts = guarded.ask(compile_foreign, [text, place], ALLOWANCE)
    return dict(zip(names, parts, strict=True))


def compile_foreign(text: str, folder: str | None) -> guarded.Answer:
    """Compile a text with the files of a folder and no others; return their names and contents."""
    files = {} if folder is None else _own_files(text, Path(folder))
    if os.name == "posix":
        import resource

        resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
    warnings = list[str]()
    mujoco.set_mju_user_warning(warnings.append)
    mujoco.MjSpec.from_string(text, include=files, assets=files).compile()
    if any("NaN" in warning for warning in warnings):
        raise ValueError("it contains a NaN, but every number must be finite")
    return list(files), list(files.values())
