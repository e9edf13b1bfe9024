"""The entrance for files from outside: regular files only, of a limited size, and errors of one line that say where."""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, ClassVar

from validation.logs.limits import LogLimits
from validation.reading import opened
from validation.words import one_line

DAMAGE = (
    OSError,
    EOFError,
    struct.error,
    zlib.error,
    SyntaxError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    NotImplementedError,
    RuntimeError,
    MemoryError,
)
"""Errors that readers of foreign formats raise on damaged files, besides their own; they promise nothing narrower."""


class TableError(ValueError):
    """A file is not the table it should be: what is wrong, where, and what would be right, in one line."""

    wanted: ClassVar[str]
    """The kind of file that was expected, with its ending."""
    header: ClassVar[str]
    """A sentence about what the first line should name."""

    def __init__(self, path: Path, what: str, line: int | None = None, column: str | None = None) -> None:
        """Keep where it went wrong: the file, the line as an editor counts it and the column's name, where there is one."""
        super().__init__(path, what, line, column)
        self.path, self.what, self.line, self.column = path, what, line, column

    def __str__(self) -> str:
        line = "" if self.line is None else f", line {self.line}"
        column = "" if self.column is None else f", column {self.column}"
        return one_line(f"{self.path}{line}{column}: {self.what}")


def quoted(texts: Iterable[str]) -> str:
    """Return foreign texts for a message: quoted, shortened and on one line."""
    short = [repr(s if len(s) <= 30 else s[:27] + "...") for s in texts]
    return ", ".join(short if len(short) <= 12 else [*short[:12], "..."])


def exists(path: Path) -> bool:
    """Return whether there is a file or folder of that name; False for a name that there cannot be."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


@contextlib.contextmanager
def open_regular(path: Path, error: type[TableError], limits: LogLimits, size: str) -> Iterator[BinaryIO]:
    """Yield a regular file, open for reading; whatever else may wait or never end is refused.

    Args:
        path: the file; links are followed.
        error: the error to raise.
        limits: the limits in force.
        size: name of the limit of its size.

    Raises:
        TableError: an `error`, if there is no such file, or it is no regular file, too large or cannot be read.
    """
    with _named(path, error, size), opened(path, limits.bytes_of(size)) as file:
        yield file


def read_regular(path: Path, error: type[TableError], limits: LogLimits, size: str = "table_size") -> bytes:
    """Return the bytes of a regular file, as many as it had at first; arguments and errors are those of `open_regular`."""
    with open_regular(path, error, limits, size) as file:
        return file.read(os.fstat(file.fileno()).st_size)


@contextlib.contextmanager
def _named(path: Path, error: type[TableError], size: str) -> Iterator[None]:
    """Within, what cannot be opened is refused with an `error`, which says what was wanted."""
    try:
        yield
    except TableError:
        raise
    except ValueError as cause:
        what = str(cause).removeprefix(f"{path}: ").removesuffix(", wanted a file")
        allowed = f" (limit {size})" if what.endswith("allowed") else ""
        raise error(path, f"{what}{allowed}; wanted {error.wanted}") from cause
