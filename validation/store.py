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
    return {"python": platform.python_version(), **{package: _version(package) for package in PACKAGES}}


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file beside `path`, then put it in its place; a failure leaves what was there before.

    The file and its folder are synchronised with the disk, so that after a power cut there is the old file or the new one,
    whole.

    Args:
        path: where the file shall be; its folder must exist.
        write: gets the temporary path, whose suffix is that of `path`; there is no file there yet.

    Raises:
        OSError: the file cannot be written.
    """
    temporary = path.with_name(f".ssmr-{secrets.token_hex(8)}.part{path.suffix}")  # hidden, and nothing is there
    try:
        write(temporary)
        _synchronise(temporary, os.O_RDWR)
        os.replace(temporary, path)
        _synchronise(path.parent, os.O_RDONLY)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _synchronise(path: Path, how: int) -> None:
    """Wait until a file or folder is on the disk; some file systems cannot do that for folders, and need not."""
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
    """Write a text as UTF-8, whole or not at all, see `write_atomic`; half a surrogate pair is written as an escape."""
    data = text.encode("utf-8", "backslashreplace")
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def plain(value: Any) -> Any:
    """Return a value as JSON has it: mappings and sequences all the way down, null for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document as JSON; a ValueError says that a number is not finite, and nothing is written."""
    write_text(path, json.dumps(encodable(document), indent=2, allow_nan=False) + "\n")


def encodable(value: Any) -> Any:
    """Return a document whose texts are Unicode throughout: in a file's name, half a surrogate pair is a byte of no text."""
    if isinstance(value, Mapping):
        return {encodable(k): encodable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [encodable(v) for v in value]
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


class UnusableFolder(OSError, ValueError):
    """A folder cannot be made or written: before the work that is a mistake of whoever named it, later a failed run."""


def make_folder(path: Path) -> Path:
    """Make a folder that files can be written into, and return it; an UnusableFolder says why it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableFolder(f"{path}: the folder cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK):
        raise UnusableFolder(f"{path}: the folder cannot be written; name another")
    return path
