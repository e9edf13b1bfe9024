"""Checkpoints: named arrays in an .npz file, written whole and read without pickle."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation import store
from validation.files import reading

_MOST_BYTES = 1 << 28
"""Greatest size of a checkpoint; one of a thousand candidates and generations has less than a million."""


class CheckpointError(ValueError):
    """A checkpoint that cannot be read, or that belongs to another search."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to an .npz file, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    store.write_atomic(path, lambda temporary: np.savez(temporary, allow_pickle=False, **arrays))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file of `write_arrays`.

    Raises:
        CheckpointError: it cannot be read, is too large, or is damaged.
    """
    try:
        data = reading.read_file(path, _MOST_BYTES)
    except ValueError as error:
        raise CheckpointError(str(error)) from error
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return dict(file)
    except (zipfile.BadZipFile, *reading.DAMAGE) as error:
        raise damaged(path, error) from error


def damaged(path: Path, error: Exception) -> CheckpointError:
    """Return the error of a checkpoint that cannot be used because of another error."""
    return CheckpointError(f"{path} is no checkpoint of a search, or it is damaged ({str(error)[:100]!a})")
