"""Checkpoints: named arrays in an .npz file, written whole with a digest, and read with suspicion.

`numpy.load` would make arrays of whatever shape a header claims, and unpack whatever a zip file holds. Here the sizes are
checked first, and what was read is compared with the digest.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
import struct
import sys
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation import reading, store

_MOST_BYTES = 1 << 28
"""Greatest size of a checkpoint, packed or not; one of a thousand candidates and generations has less than a million."""
_MOST_ARRAYS = 100
_DIGEST = "digest"
"""Name of the array that holds the digest of all others."""
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '([<>|=][biufU]\d{1,9})', 'fortran_order': False, 'shape': \(([\d, ]*)\), \} *\n",
    re.DOTALL,
)
"""Header of an array as numpy writes it; numpy itself evaluates headers as Python."""
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, OverflowError, RuntimeError, ValueError,
    TypeError,
)  # fmt: skip
"""Errors that zip files end in when their bytes are changed."""


class CheckpointError(ValueError):
    """A checkpoint that cannot be read, or that belongs to another search."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to an .npz file, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    whole = {**arrays, _DIGEST: np.array(_digest(arrays))}
    store.write_atomic(path, lambda temporary: np.savez(temporary, allow_pickle=False, **whole))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file of `write_arrays`; they are read-only.

    Raises:
        CheckpointError: it cannot be read, is too large, is damaged, or was changed after it was written.
    """
    try:
        data = reading.read_file(path, _MOST_BYTES)
    except ValueError as error:
        raise CheckpointError(str(error)) from error
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if len(members) > _MOST_ARRAYS or sum(member.file_size for member in members) > _MOST_BYTES:
                raise ValueError("it is too large")
            if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
                raise ValueError("it is packed in a strange way")
            arrays = {member.filename.removesuffix(".npy"): _array(archive.read(member)) for member in members}
        said = str(arrays.pop(_DIGEST, ""))
        if said != _digest(arrays):
            raise ValueError("its digest is another")
    except _DAMAGE as error:
        raise damaged(path, error) from error
    return arrays


def damaged(path: Path, error: Exception) -> CheckpointError:
    """Return the error of a checkpoint that cannot be used because of another error."""
    return CheckpointError(f"{path} is no checkpoint of a search, or it is damaged ({str(error)[:100]!a})")


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _array(data: bytes) -> NDArray[Any]:
    """Return the array of an .npy file, which has exactly the bytes that its shape needs.

    Raises:
        ValueError: the header is no header, or the array holds objects, more or less than it says, or what is no text.
    """
    found = _HEADER.match(data)
    if found is None:
        raise ValueError("an array has no header that numpy writes")
    dtype, body = np.dtype(found[1].decode()), data[found.end() :]
    shape = tuple(int(length) for length in found[2].split(b",") if length.strip())
    if math.prod(shape) * dtype.itemsize != len(body):
        raise ValueError("an array has another size than its header says")
    if dtype.kind == "U":
        codes = np.frombuffer(body, dtype=np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if codes.max(initial=0) > sys.maxunicode:
            raise ValueError("an array holds what is no text")
    return np.frombuffer(body, dtype=dtype).reshape(shape)
