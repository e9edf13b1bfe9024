"""Writing results to disk, whole or not at all."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Callable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("ssmr-testbed", "mujoco", "dm-control", "numpy", "scipy", "numba", "control", "rerun-sdk")
"""Packages whose versions a result records."""


def versions() -> dict[str, str]:
    """Return the versions of this project, Python and the packages that decide numbers."""
    return {"python": platform.python_version(), **{package: _version(package) for package in PACKAGES}}


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file beside `path`, then put it in its place; a failure leaves what was there before.

    Args:
        path: where the file shall be; its folder must exist.
        write: gets the temporary path, whose suffix is that of `path`.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def plain(value: Any) -> Any:
    """Return a value as JSON has it: mappings and sequences all the way down, null for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document as JSON.

    Raises:
        ValueError: it holds a number that is not finite; nothing is written.
    """
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def make_folder(path: Path) -> Path:
    """Make a folder that files can be written into, and return it.

    Raises:
        ValueError: it cannot be made or written; the message says why.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{path}: the folder cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK):
        raise ValueError(f"{path}: the folder cannot be written; name another")
    return path
