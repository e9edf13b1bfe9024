"""A foreign MJCF or URDF: MuJoCo tries it in a child process, which has only the files of its folder.

MuJoCo's reader answers no signal while it works. A file that the child has read is as quick for
this process.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Mapping
from pathlib import Path

import mujoco

from validation.files import guarded

ALLOWANCE = guarded.Allowance(seconds=10.0, memory=2 << 30)
"""What reading and compiling may use, with all files that are included."""
MOST_BYTES = 1 << 22
"""Greatest size of a text [bytes]; large ones of manipulators have a few hundred thousand."""
_MOST_FILES = 1000
_MOST_SIZE = 1 << 26
"""Greatest number and total size [bytes] of the files that an MJCF brings."""


def xml_tree(text: str) -> ElementTree.Element:
    """Return the tree of an XML text.

    Raises:
        ValueError: it is none, or declares entities, which could grow.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError(
            "the file declares a document type or entities, which no robot has a use for; take them out"
        )
    try:
        return ElementTree.fromstring(text)  # nosec B314 # without declarations there are no entities to grow
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"this is no XML ({error})") from error


def _own_files(text: str, folder: Path) -> dict[str, bytes]:
    """Return the files that an MJCF names, by these names: those that lie in `folder` or below, and those that they include.

    Raises: ValueError: one lies elsewhere, is no regular file or no XML, or they are too many or
        too large.
    """
    files = dict[str, bytes]()
    folder = folder.resolve()
    waiting = [text]
    places = {""}
    while waiting:
        root = xml_tree(waiting.pop())
        for compiler in root.iter("compiler"):
            places |= {compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")}
        wanted = [
            (part.tag, v)
            for part in root.iter()
            for k, v in part.attrib.items()
            if k.startswith("file") and v
        ]
        for tag, name in wanted:
            paths = [
                (folder / place / name).resolve()
                for place in ({""} if tag == "include" else places)
            ]
            path = next((p for p in paths if p.is_relative_to(folder) and p.is_file()), None)
            if path is None:
                raise ValueError(
                    f"there is no file '{name}' in its folder, and files from elsewhere are not read"
                )
            if name not in files:
                size = path.stat().st_size + sum(map(len, files.values()))
                if size > _MOST_SIZE or len(files) >= _MOST_FILES:
                    raise ValueError(
                        f"it brings more than {_MOST_FILES} files or {_MOST_SIZE >> 20} MiB"
                    )
                files[name] = path.read_bytes()
                waiting += [files[name].decode("utf-8", "replace")] if tag == "include" else []
    return files


def tried_files(text: str, folder: Path | None = None) -> Mapping[str, bytes]:
    """Let MuJoCo read and compile an MJCF or a URDF in a child process, and return the files that it brings, by name.

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
    """Compile a text with the files of a folder and no others; return the files' names, and what is in them."""
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
