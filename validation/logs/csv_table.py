"""Tables of text cells, as CSV files hold them, read into columns of numbers."""

from __future__ import annotations

import codecs
import csv
import io
import logging
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ssmr.types import FloatArray
from validation.logs.files import TableError, quoted, read_regular
from validation.logs.limits import USUAL, Bound, LogLimits

_logger = logging.getLogger(__name__)

_AT_ONCE = 200_000
"""Cells that are held as text at a time."""
_COMMAS = 100
"""A line may have this many times as many commas as columns are allowed, for text may hold some."""


@dataclass
class _Cells:
    """The cells of one column as numbers, and where they are none."""

    parts: list[FloatArray] = field(default_factory=list)
    count: int = 0
    bad: int = 0
    """Number of cells that are no finite numbers."""
    first_bad: tuple[int, str] | None = None
    """Row and text of the first of them."""
    first_text: tuple[int, str] | None = None
    """Row and text of the first that is neither a number nor empty."""

    def add(self, cells: Sequence[str]) -> None:
        """Take in the cells of the next rows."""
        values = _numbers(cells)
        bad = np.flatnonzero(~np.isfinite(values)).tolist()
        if len(bad) and self.first_bad is None:
            self.first_bad = (self.count + bad[0], cells[bad[0]])
        if len(bad) and self.first_text is None:
            text = next((k for k in bad if _number(cells[k]) is None and cells[k].strip()), None)
            self.first_text = None if text is None else (self.count + text, cells[text])
        self.parts.append(values)
        self.count += len(cells)
        self.bad += len(bad)


@dataclass(frozen=True)
class CellTable:
    """Columns of cells below a header; blank lines are left out."""

    path: Path
    header: Sequence[str]
    """Names of the columns, as they are written."""
    header_line: int
    """Line on which the header begins, counted from 1."""
    cells: Sequence[_Cells]
    lines: Sequence[int]
    """Line on which each row begins."""
    error: type[TableError]
    """The error that names this kind of file."""

    def numbers(self, place: int, name: str, units: Mapping[str, str], bound: Bound | None = None) -> FloatArray | None:
        """Return a column as (M,) numbers.

        Args:
            place: index of the column.
            name: its name in messages.
            units: the units of the columns that must be numbers throughout. Another column may be text or have holes; then
                it is left out with a warning.
            bound: greatest size of its numbers; none if not given.

        Returns:
            The numbers; None for a column that is left out.

        Raises:
            TableError: a cell that is no finite number or beyond the bound, in a column of `units`; or text in one that
                otherwise holds numbers.
        """
        cells = self.cells[place]
        if cells.first_bad is None:
            values = np.concatenate(cells.parts) if cells.parts else np.zeros(0)
            beyond = None if bound is None else bound.first_beyond(values)
            if bound is None or beyond is None:
                return values
            if name in units:
                what = f"there is {values[beyond]:g} {units[name]}, but {bound.says}"
                raise self.error(self.path, what, self.lines[beyond], name)
            self._leave_out(beyond, name, f"{values[beyond]:g}, but {bound.says}")
            return None
        if name in units or (cells.first_text is not None and cells.bad < cells.count):
            row, cell = cells.first_text if name not in units and cells.first_text else cells.first_bad
            what = "nothing" if not cell.strip() else quoted([cell.strip()])
            unit = f" [{units[name]}]" if name in units else ""
            raise self.error(self.path, f"there is {what}, wanted a finite number{unit}", self.lines[row], name)
        self._leave_out(cells.first_bad[0], name, "text" if cells.first_text else "no finite number")
        return None

    def _leave_out(self, row: int, name: str, what: str) -> None:
        _logger.warning(
            "%s, line %d, column %s: there is %s; the channel is left out", self.path, self.lines[row], name, what
        )


def _make_table(
    path: Path, rows: Iterable[tuple[int, Sequence[str]]], error: type[TableError], limits: LogLimits
) -> CellTable | None:
    """Return a table of rows, of which the first is the header; None where there are no rows.

    Args:
        path: the file.
        rows: line and cells of each row that is not blank.
        error: the error to raise.
        limits: the limits in force.

    Raises:
        TableError: an `error`, if rows differ in length from the header, semicolons separate the columns, or there are more
            rows or columns than the limits allow.
    """
    numbered = iter(rows)
    header_line, header = next(numbered, (0, ()))
    width = len(header)
    if not width:
        return None
    if width == 1 and ";" in header[0]:
        what = "semicolons separate the columns; wanted commas between them, and points in numbers"
        raise error(path, what, header_line)
    if width > limits.columns:
        raise error(path, f"there are {width} columns, but {limits.says('columns')}", header_line)
    most, at_once = min(limits.samples, limits.cells // width), math.ceil(_AT_ONCE / width)
    columns = [_Cells() for _ in header]
    lines = array("q")
    waiting: list[Sequence[str]] = []
    for line, row in numbered:
        if len(row) != width:
            raise error(path, f"there are {len(row)} fields, wanted {width} as in the header", line)
        if len(lines) >= most:
            raise error(
                path, f"there are too many rows: {limits.says('samples' if most == limits.samples else 'cells')}", line
            )
        lines.append(line)
        waiting.append(row)
        if len(waiting) >= at_once:
            _take_in(columns, waiting)
    _take_in(columns, waiting)
    return CellTable(path, header, header_line, columns, lines, error)


def _take_in(columns: Sequence[_Cells], waiting: list[Sequence[str]]) -> None:
    for cells, column in zip(columns, zip(*waiting, strict=True), strict=False):
        cells.add(column)
    waiting.clear()


def read_csv_table(path: Path, error: type[TableError], limits: LogLimits = USUAL) -> CellTable:
    """Read a CSV file. A UTF-8 byte order mark, any line ending and blank lines are accepted.

    Raises:
        TableError: an `error`, if the file is no CSV file, is empty, has rows that differ in length or is beyond the limits.
    """
    data = _checked_text(path, read_regular(path, error, limits), error)
    table = _make_table(path, _csv_rows(path, data, error, limits), error, limits)
    if table is None:
        raise error(path, f"the file is empty; {error.header}")
    return table


def _csv_rows(path: Path, data: BinaryIO, error: type[TableError], limits: LogLimits) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row that is not blank."""
    most = _COMMAS * limits.columns

    def narrow(lines: Iterable[str]) -> Iterator[str]:
        for k, text in enumerate(lines, start=1):
            if len(text) > most and text.count(",") > most:
                raise error(path, f"there are {text.count(',')} commas, but {limits.says('columns')}", k)
            yield text

    line = 1
    try:
        reader = csv.reader(narrow(io.TextIOWrapper(data, encoding="utf-8", newline="")), strict=True)
        for row in reader:
            if len(row) > 1 or any(map(str.strip, row)):
                yield line, row
            line = reader.line_num + 1
    except csv.Error as cause:
        raise error(path, f"this is no CSV: {cause}", line) from cause


def _checked_text(path: Path, data: bytes, error: type[TableError]) -> BinaryIO:
    """Return the bytes of a UTF-8 text without its byte order mark."""
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        data.decode("utf-8")
        bad, what = data.find(b"\0"), "a NUL byte"
    except UnicodeDecodeError as cause:
        bad, what = cause.start, "a byte that is not UTF-8"
    if bad >= 0:
        line = data.count(b"\n", 0, bad) + 1
        raise error(path, f"there is {what}; wanted a CSV file, which is plain UTF-8 text", line)
    return io.BytesIO(data)


def _numbers(cells: Sequence[str]) -> FloatArray:
    """Return the numbers that cells hold, NaN where they hold none."""
    try:
        if "_" not in "".join(cells):
            return np.array([float(cell) for cell in cells], dtype=np.float64)
    except ValueError:
        pass
    found = map(_number, cells)
    return np.array([math.nan if value is None else value for value in found], dtype=np.float64)


def _number(cell: str) -> float | None:
    """Return the number that a cell holds, None where it holds none."""
    try:
        return None if "_" in cell else float(cell)  # Python reads 1_0 as 10, which no logger writes
    except ValueError:
        return None
