"""Tables of text cells, as CSV files hold them, and the one-line errors that say where such a file is wrong."""

from __future__ import annotations

import codecs
import csv
import io
import logging
import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ssmr.types import FloatArray

_logger = logging.getLogger(__name__)

DAMAGE = (
    OSError,
    EOFError,
    struct.error,
    zlib.error,
    SyntaxError,  # what Python's XML parser raises
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
    counted: ClassVar[str] = "line"
    """Word for the lines of such a file in an editor."""

    def __init__(self, path: Path, what: str, line: int | None = None, column: str | None = None) -> None:
        """Keep where it went wrong: the file, the line as an editor counts it and the column's name, where there is one."""
        super().__init__(path, what, line, column)
        self.path, self.what, self.line, self.column = path, what, line, column

    def __str__(self) -> str:
        line = "" if self.line is None else f", {self.counted} {self.line}"
        column = "" if self.column is None else f", column {self.column}"
        return f"{self.path}{line}{column}: {self.what}"


def quoted(texts: Iterable[str]) -> str:
    """Return foreign texts for a message: quoted, shortened and on one line."""
    short = [repr(s if len(s) <= 30 else s[:27] + "...") for s in texts]
    return ", ".join(short if len(short) <= 12 else [*short[:12], "..."])


@dataclass(frozen=True)
class CellTable:
    """Rows of text cells, all as long as the header; blank lines are left out."""

    path: Path
    header: Sequence[str]
    """Names of the columns, as they are written."""
    header_line: int
    """Line on which the header begins, counted from 1."""
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    """Line on which each row begins."""
    error: type[TableError]
    """The error that names this kind of file."""

    def numbers(self, place: int, name: str, units: Mapping[str, str]) -> FloatArray | None:
        """Return a column as (M,) numbers.

        Args:
            place: index of the column.
            name: its name in messages.
            units: the units of the columns that must be numbers throughout. Another column may be text or have holes; then
                it is left out with a warning.

        Returns:
            The numbers; None for a column that is left out.

        Raises:
            TableError: a cell that is no finite number, in a column of `units` or in one that otherwise holds numbers.
        """
        cells = [row[place] for row in self.rows]
        values = [_number(cell) for cell in cells]
        bad = [k for k, v in enumerate(values) if v is None or not math.isfinite(v)]
        if not bad:
            return np.array(values, dtype=np.float64)
        text = [k for k in bad if values[k] is None and cells[k].strip()]
        if name in units or (text and len(bad) < len(cells)):
            k = bad[0] if name in units else text[0]
            what = "nothing" if not cells[k].strip() else quoted([cells[k].strip()])
            unit = f" [{units[name]}]" if name in units else ""
            raise self.error(self.path, f"there is {what}, wanted a finite number{unit}", self.lines[k], name)
        _logger.warning(
            "%s, line %d, column %s: there is %s; the channel is left out",
            self.path, self.lines[bad[0]], name, "text" if text else "no finite number",
        )  # fmt: skip
        return None


def read_bytes(path: Path, error: type[TableError]) -> bytes:
    """Return the bytes of a file.

    Raises:
        TableError: an `error`, if the file cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise error(path, f"there is no such file; wanted {error.wanted}") from None
    except IsADirectoryError:
        raise error(path, f"this is a folder; wanted {error.wanted}") from None
    except OSError as cause:
        raise error(path, f"the file cannot be read: {cause.strerror or cause}") from cause


def read_csv_table(path: Path, error: type[TableError]) -> CellTable:
    """Read a CSV file. A UTF-8 byte order mark, any line ending and blank lines are accepted.

    Raises:
        TableError: an `error`, if the file is no CSV file, is empty, or has rows that differ in length.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    reader = csv.reader(io.StringIO(_read_text(path, error), newline=""), strict=True)
    line = 1
    try:
        for row in reader:
            if len(row) > 1 or any(map(str.strip, row)):
                if rows and len(row) != len(rows[0]):
                    raise error(path, f"there are {len(row)} fields, wanted {len(rows[0])} as in the header", line)
                rows.append(row)
                lines.append(line)
            line = reader.line_num + 1
    except csv.Error as cause:
        raise error(path, f"this is no CSV: {cause}", line) from cause
    if not rows:
        raise error(path, f"the file is empty; {error.header}")
    return CellTable(path, rows[0], lines[0], rows[1:], lines[1:], error)


def _read_text(path: Path, error: type[TableError]) -> str:
    """Return the text of a file without its byte order mark."""
    data = read_bytes(path, error).removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode("utf-8")
        bad, what = data.find(b"\0"), "a NUL byte"
    except UnicodeDecodeError as cause:
        text, bad, what = "", cause.start, "a byte that is not UTF-8"
    if bad >= 0:
        line = data.count(b"\n", 0, bad) + 1
        raise error(path, f"there is {what}; wanted a CSV file, which is plain UTF-8 text", line)
    return text


def _number(cell: str) -> float | None:
    """Return the number that a cell holds, None where it holds none."""
    try:
        return None if "_" in cell else float(cell)  # Python reads 1_0 as 10, which no logger writes
    except ValueError:
        return None
