"""Writing results to disk, whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import platform
import secrets
from collections.abc import Callable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("ssmr-testbed", "mujoco", "numpy", "scipy", "numba", "control", "rerun-sdk")
"""Packages whose versions a result records."""


def versions() -> dict[str, str]:
    """Return the versions of this project, Python and the packages that decide numbers."""
    packages = {package: _version(package) for package in PACKAGES}
    return {"python": platform.python_version(), **packages}


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file beside `path`, then move it there; a failure leaves the old one.

    The file and its folder are synchronised with the disk, so that after a power cut there is the
    old file or the new one, whole.

    Args:
        path: where the file shall be; its folder must exist.
        write: gets the temporary path, whose suffix is that of `path`; there is no file there yet.

    Raises:
        OSError: the file cannot be written.
    """
    # Hidden, and nothing is there.
    temporary = path.with_name(f".ssmr-{secrets.token_hex(8)}.part{path.suffix}")
    try:
        write(temporary)
        _synchronise(temporary, os.O_RDWR)
        os.replace(temporary, path)
        _synchronise(path.parent, os.O_RDONLY)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _synchronise(path: Path, how: int) -> None:
    """Wait until a file or folder is on the disk; not every file system can do that for folders."""
    try:
        descriptor = os.open(path, how)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
            raise
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all; half a surrogate pair becomes an escape."""
    data = text.encode("utf-8", "backslashreplace")
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def plain(value: Any) -> Any:
    """A value as JSON has it: mappings and sequences throughout, null for a non-finite number."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document as JSON, or nothing and a ValueError if a number is not finite."""
    write_text(path, json.dumps(encodable(document), indent=2, allow_nan=False) + "\n")


def encodable(value: Any) -> Any:
    """A document of Unicode texts throughout: half a surrogate pair is a byte of no text."""
    if isinstance(value, Mapping):
        return {encodable(k): encodable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [encodable(v) for v in value]
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    return value


class UnusableFolder(OSError, ValueError):
    """A folder cannot be made or written: first its namer's mistake, later a failed run."""


def make_folder(path: Path) -> Path:
    """Make a folder to write into, and return it; an UnusableFolder says why it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableFolder(f"{path}: the folder cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK):
        raise UnusableFolder(f"{path}: the folder cannot be written; name another")
    return path
