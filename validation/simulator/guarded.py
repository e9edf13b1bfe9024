"""A foreign MJCF or URDF: MuJoCo tries it in a child process that can open no file, and neither lasts nor grows for long.

MuJoCo's reader answers no signal while it works. A file that the child has read is as quick for this process.
"""
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import base64
import json
import os
import subprocess  # nosec B404 # it runs this file
import sys
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Mapping
from pathlib import Path

MOST_SECONDS, MOST_MEMORY = 10, 2 << 30
"""Time [s] and memory [bytes] that reading and compiling may take."""
MOST_BYTES = 1 << 22
"""Greatest size of a text [bytes]; large ones of manipulators have a few hundred thousand."""
_MOST_FILES, _MOST_SIZE = 1000, 1 << 26
"""Greatest number and total size [bytes] of the files that an MJCF brings."""


def xml_tree(text: str) -> ElementTree.Element:
    """Return the tree of an XML text.

    Raises:
        ValueError: it is none, or declares entities, which could grow.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("the file declares a document type or entities, which no robot has a use for; take them out")
    try:
        return ElementTree.fromstring(text)  # nosec B314 # without declarations there are no entities to grow
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"this is no XML ({error})") from error


def own_files(text: str, folder: Path) -> dict[str, bytes]:
    """Return the files that an MJCF names, by these names: those that lie in `folder` or below, and those that they include.

    Raises:
        ValueError: one lies elsewhere, is no regular file or no XML, or they are too many or too large.
    """
    files, folder = dict[str, bytes](), folder.resolve()
    waiting, places = [text], {""}
    while waiting:
        root = xml_tree(waiting.pop())
        for compiler in root.iter("compiler"):
            places |= {compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")}
        wanted = [(part.tag, v) for part in root.iter() for k, v in part.attrib.items() if k.startswith("file") and v]
        for tag, name in wanted:
            paths = [(folder / place / name).resolve() for place in ({""} if tag == "include" else places)]
            path = next((p for p in paths if p.is_relative_to(folder) and p.is_file()), None)
            if path is None:
                raise ValueError(f"there is no file '{name}' in its folder, and files from elsewhere are not read")
            if name not in files:
                size = path.stat().st_size + sum(map(len, files.values()))
                if size > _MOST_SIZE or len(files) >= _MOST_FILES:
                    raise ValueError(f"it brings more than {_MOST_FILES} files or {_MOST_SIZE >> 20} MiB")
                files[name] = path.read_bytes()
                waiting += [files[name].decode("utf-8", "replace")] if tag == "include" else []
    return files


def require_readable(text: str, files: Mapping[str, bytes] = {}) -> None:
    """Let MuJoCo read and compile an MJCF or a URDF in a child process, with these files by name and no others.

    Raises:
        ValueError: it cannot, or not within `MOST_SECONDS` and `MOST_MEMORY`.
    """
    given = json.dumps({"text": text, "files": {name: base64.b64encode(data).decode() for name, data in files.items()}})
    lean = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
    limits = f"{MOST_SECONDS} s and {MOST_MEMORY >> 30} GiB"
    try:
        ran = subprocess.run(  # nosec B603 # the arguments are our own
            [sys.executable, "-P", __file__], input=given.encode(), capture_output=True, timeout=MOST_SECONDS, env=lean
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"MuJoCo does not come to an end with it in {MOST_SECONDS} s") from error
    if ran.returncode == 1 and ran.stdout:
        raise ValueError(ran.stdout.decode("utf-8", "replace"))
    if ran.returncode:
        raise ValueError(f"MuJoCo gives it up within {limits}: does it repeat something without end?")


def _try() -> None:
    """Read what comes on standard input; what is wrong goes to standard output, with exit status 1."""
    import mujoco

    given = json.load(sys.stdin)
    files = {name: base64.b64decode(data) for name, data in given["files"].items()}
    if os.name == "posix":
        import resource

        for what, most in (("CORE", 0), ("NOFILE", 0), ("CPU", MOST_SECONDS), ("AS", MOST_MEMORY)):
            resource.setrlimit(getattr(resource, f"RLIMIT_{what}"), (most, most))
    try:
        mujoco.MjSpec.from_string(given["text"], include=files, assets=files).compile()
    except (ValueError, MemoryError, RuntimeError, mujoco.FatalError) as error:
        print(error, end="")
        sys.exit(1)


if __name__ == "__main__":
    _try()
