"""CSV files: tables of numbers below a header, and logs with `t` [s] and any of `RECORDED`."""

from __future__ import annotations

import csv
import io
import logging
import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray
from validation.files.limits import USUAL, LogLimits, find_time_fault
from validation.files.log import (
    RECORDED,
    Column,
    Group,
    Log,
    ReadOptions,
    column_of,
    is_column_name,
    unwrapped,
)
from validation.files.reading import FileError, opened, quoted
from validation.output import write_atomic

_SEPARATORS = {
    ";": "semicolons separate",
    "\t": "tabs separate",
    "#": "a comment stands before",
    " ": "spaces separate",
}
"""Signs in a first line without a comma, and their effect there."""

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class CsvTable:
    """Columns of numbers below a header; blank lines are left out."""

    path: Path
    header: Sequence[str]
    """Names of the columns."""
    header_line: int
    """Line on which the header begins, counted from 1."""
    lines: Sequence[int]
    """Line on which each row begins."""
    columns: Sequence[FloatArray]
    """(M,) numbers of each column, not finite where there is none, NaN where the cell is empty."""
    bad: Sequence[tuple[int, str] | None]
    """Row and text of each column's first cell that is no finite number, and not empty; None for a
    column without one."""

    def numbers(self, place: int, column: Column) -> FloatArray:
        """Return the column at `place` as (M,) numbers.

        Raises:
            FileError: a cell is not finite, or too large.
        """
        values = self.columns[place]
        bad = self.bad[place]
        fault = column.fault(values)
        if bad is None and fault is None:
            return values
        if bad is not None:
            row, text = bad
            what = f"{quoted([text.strip()])}, wanted a finite number [{column.unit}]"
        elif fault is not None:
            row, what = fault
            if math.isnan(values[row]):
                what = f"nothing, wanted a finite number [{column.unit}]"
        raise FileError(self.path, f"there is {what}", self.lines[row], self.header[place])


def read_csv_table(path: Path, limits: LogLimits = USUAL) -> CsvTable:
    """Read a CSV file. A UTF-8 byte order mark, any line ending and blank lines are accepted.

    Raises:
        FileError: the file is no CSV file, is empty, has rows that differ in length or is beyond
            the limits.
    """
    rows = _rows(path, limits)
    header_line, header = next(rows, (0, []))
    width = len(header)
    if not width:
        raise FileError(
            path,
            "the file is empty; wanted "
            "a header line with the names of columns, and lines of numbers",
        )
    if "\0" in "".join(header):
        raise FileError(
            path, "there is a NUL byte; wanted a CSV file, which is plain UTF-8 text", header_line
        )
    if width == 1:
        signs = (words for sign, words in _SEPARATORS.items() if sign in header[0])
        what = next(signs, "nothing separates")
        raise FileError(
            path,
            f"{what} the columns; wanted commas between them, and points in numbers",
            header_line,
        )
    if width > limits.columns:
        raise FileError(
            path, f"there are {width} columns, but {limits.says('columns')}", header_line
        )
    most = min(limits.samples, limits.cells // width)
    columns = [array("d") for _ in header]
    lines = array("q")
    bad: list[tuple[int, str] | None] = [None] * width
    for line, row in rows:
        if len(row) != width:
            raise FileError(
                path, f"there are {len(row)} fields, wanted {width} as in the header", line
            )
        if len(lines) >= most:
            what = limits.says("samples" if most == limits.samples else "cells")
            raise FileError(path, f"there are too many rows: {what}", line)
        for place, cell in enumerate(row):
            value = _number(cell)
            columns[place].append(value)
            # a cell of blanks is no number, but no fault either
            if not math.isfinite(value) and bad[place] is None and cell.strip():
                bad[place] = (len(lines), cell)
        lines.append(line)
    return CsvTable(
        path=path,
        header=[name.strip() for name in header],
        header_line=header_line,
        lines=lines,
        columns=[np.array(column, dtype=np.float64) for column in columns],
        bad=bad,
    )


def _number(cell: str) -> float:
    try:
        # Python reads 1_0 as 10, which no logger writes
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _rows(path: Path, limits: LogLimits) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row that is not blank; bad UTF-8 will be no number."""
    line = 1
    with opened(path, limits.bytes_of("table_size"), "table_size") as file:
        try:
            text = io.TextIOWrapper(
                file, encoding="utf-8-sig", errors="surrogateescape", newline=""
            )
            reader = csv.reader(text, strict=True)
            for row in reader:
                if len(row) > 1 or any(map(str.strip, row)):
                    yield line, row
                line = reader.line_num + 1
        except csv.Error as cause:
            raise FileError(path, f"this is no CSV: {cause}", line) from cause


def read_csv(path: str | Path, options: ReadOptions | None = None) -> Log:
    """Read a log.

    Columns without a name are left out, and so are those whose name is not in `RECORDED` and that
    are not numbers throughout, with a warning.

    Raises:
        FileError: the file cannot be read, is no valid log or is beyond the limits.
    """
    path = Path(path)
    options = options or ReadOptions()
    if options.topics:
        raise FileError(
            path, "topics names the topics of a bag; this is a CSV file, whose columns have names"
        )
    table = _renamed(read_csv_table(path, options.limits), options)
    _check_names(table)
    columns: dict[str, FloatArray] = {}
    for place, name in enumerate(table.header):
        if not name:  # an index, as pandas writes it, or a comma at the end of each line
            continue
        values = table.columns[place]
        # empty cells are the samples of a column on a slower clock
        samples = np.count_nonzero(~np.isnan(values))
        if name != "t" and table.bad[place] is None and 1 < samples < len(values):
            columns[name] = values
            continue
        column = Column("s", "", math.inf) if name == "t" else column_of(name)
        try:
            columns[name] = table.numbers(place, column)
        except FileError as fault:
            if name == "t" or name in RECORDED:
                raise
            _logger.warning("%s; the column is left out", fault)
    if len(table.lines) < 2:
        some = "is one sample" if table.lines else "are no samples"
        raise FileError(path, f"there {some} after the header; a log needs at least two")
    if any(np.any(np.isnan(values)) for values in columns.values()):
        return _with_own_clocks(path, columns, options.limits)
    late = find_time_fault(columns["t"], options.limits)
    if late is not None:
        raise FileError(path, late.what, table.lines[late.row], "t")
    return Log.of_columns(path, columns, options.limits)


def _renamed(table: CsvTable, options: ReadOptions) -> CsvTable:
    """Return a table whose columns have our names and units, as far as the options map them."""
    header = list(table.header)
    columns = list(table.columns)
    if len({theirs for theirs, _ in options.columns.values()}) < len(options.columns):
        raise FileError(table.path, "--columns takes one column for two")
    for name, (theirs, unit) in options.columns.items():
        if theirs not in table.header:
            raise FileError(
                table.path, f"there is no column {quoted([theirs])} among {quoted(table.header)}"
            )
        place = table.header.index(theirs)
        try:
            header[place] = name
            columns[place] = columns[place] * options.factor(name, unit)
        except ValueError as error:
            raise FileError(table.path, f"--columns: {error}") from error
    return replace(table, header=header, columns=columns)


def _with_own_clocks(path: Path, columns: Mapping[str, FloatArray], limits: LogLimits) -> Log:
    """Return a log whose columns have no sample in empty cells.

    Columns of a group are interpolated, or held, at the stamps of all of them.
    """
    members: dict[str, dict[str, Group]] = {}
    for name, values in columns.items():
        if name == "t":
            continue
        filled = ~np.isnan(values)
        t = columns["t"][filled]
        fault = find_time_fault(t, limits)
        if fault is not None:
            raise FileError(path, fault.what, column=name)
        column = column_of(name)
        samples = values[filled]
        if column.unit == "rad":
            samples = unwrapped(samples)
        members.setdefault(column.group, {})[name] = Group(path.name, t, {name: samples})
    groups = {}
    for key, parts in members.items():
        t = np.unique(np.concatenate([part.t for part in parts.values()]))
        for part in parts.values():
            t = t[(t >= part.t[0]) & (t <= part.t[-1]) & ~part.in_gaps(t)]
        if len(t) < 2:
            raise FileError(path, f"{', '.join(parts)} are never known at the same time")
        common = {}
        for name, part in parts.items():
            samples = part.columns[name]
            if key == "cmd":
                common[name] = samples[np.searchsorted(part.t, t, side="right") - 1]
            else:
                common[name] = np.interp(t, part.t, samples)
        groups[key] = Group(path.name, t, common)
    return Log(path, groups, limits=limits)


def _check_names(table: CsvTable) -> None:
    """Refuse a header without `t` or any of `RECORDED`, or with names that are bad or repeated."""
    names = table.header
    path = table.path
    line = table.header_line
    for kind, some in (("column t", ("t",)), ("known column", RECORDED)):
        if not any(n in some for n in names):
            what = f"there is no {kind} among {quoted(names)}"
            need = f"a log's header names t and any of {', '.join(RECORDED)}"
            raise FileError(
                path,
                f"{what}; {need}; --columns t=NAME,x=NAME says which columns have other names",
                line,
            )
    for k, name in enumerate(names):
        if not name:
            continue
        if not is_column_name(name):
            what = f"{quoted([name])} names no column; wanted printable text"
            raise FileError(path, what, line, f"number {k + 1}")
        if name in names[:k]:
            raise FileError(
                path, "the header names this column twice; each needs a name of its own", line, name
            )


def write_csv(log: Log | Mapping[str, ArrayLike], path: str | Path) -> None:
    """Write a log on one clock, or (M,) columns by name, whole or not at all.

    `read_csv` gets equal bits back.

    Raises:
        FileError: the log cannot be brought onto one clock, or the columns make none.
        OSError: the file cannot be written.
    """
    path = Path(path)
    common = log.on_one_clock() if isinstance(log, Log) else Log.of_columns(path, log)
    columns = common.columns
    names = sorted(columns, key=lambda name: name not in RECORDED)
    table = [common.t.tolist(), *(columns[name].tolist() for name in names)]

    def write(beside: Path) -> None:
        with beside.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["t", *names])
            writer.writerows(zip(*table, strict=True))

    write_atomic(path, write)
