"""CSV files: tables of numbers below a header, and logs that have a column `t` [s] and any of `RECORDED` and others."""

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
from validation.store import write_atomic

_SEPARATORS = {
    ";": "semicolons separate",
    "\t": "tabs separate",
    "#": "a comment stands before",
    " ": "spaces separate",
}
"""Signs in a first line without a comma, and what they do there."""

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

    def numbers(self, place: int, known: Column) -> FloatArray:
        """Return the column at `place` as (M,) numbers; a FileError names a cell that is not finite, or too large."""
        bad = self.bad[place]
        fault = known.fault(self.columns[place])
        if bad is not None:
            fault = bad[0], f"{quoted([bad[1].strip()])}, wanted a finite number [{known.unit}]"
        elif fault is not None and math.isnan(self.columns[place][fault[0]]):
            fault = fault[0], f"nothing, wanted a finite number [{known.unit}]"
        if fault is not None:
            raise FileError(
                self.path, f"there is {fault[1]}", self.lines[fault[0]], self.header[place]
            )
        return self.columns[place]


def read_csv_table(path: Path, limits: LogLimits = USUAL) -> CsvTable:
    """Read a CSV file. A UTF-8 byte order mark, any line ending and blank lines are accepted.

    Raises: FileError: the file is no CSV file, is empty, has rows that differ in length or is
        beyond the limits.
    """
    rows = _rows(path, limits)
    header_line, header = next(rows, (0, []))
    width = len(header)
    if not width:
        raise FileError(
            path,
            "the file is empty; wanted a header line with the names of columns, and lines of numbers",
        )
    if "\0" in "".join(header):
        raise FileError(
            path, "there is a NUL byte; wanted a CSV file, which is plain UTF-8 text", header_line
        )
    if width == 1:
        what = next(
            (meaning for sign, meaning in _SEPARATORS.items() if sign in header[0]),
            "nothing separates",
        )
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
            if (
                bad[place] is None
                and not math.isfinite(value)
                and not (cell == "" or cell.isspace())
            ):
                bad[place] = (len(lines), cell)
        lines.append(line)
    numbers = [np.array(column, dtype=np.float64) for column in columns]
    return CsvTable(path, [name.strip() for name in header], header_line, lines, numbers, bad)


def _number(cell: str) -> float:
    try:
        # Python reads 1_0 as 10, which no logger writes
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _rows(path: Path, limits: LogLimits) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row that is not blank; what is not UTF-8 will be no number."""
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
    """Read a log. Columns without a name are left out; with a warning those of other names that are not numbers throughout.

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
        empty = np.isnan(table.columns[place])
        if (
            name != "t"
            and table.bad[place] is None
            and np.any(empty)
            and np.count_nonzero(~empty) > 1
        ):
            columns[name] = table.columns[place]
            continue
        try:
            columns[name] = table.numbers(
                place, Column("s", "", math.inf) if name == "t" else column_of(name)
            )
        except FileError as fault:
            if name == "t" or name in RECORDED:
                raise
            _logger.warning("%s; the column is left out", fault)
    if len(table.lines) < 2:
        some = "is one sample" if table.lines else "are no samples"
        raise FileError(path, f"there {some} after the header; a log needs at least two")
    if any(np.any(np.isnan(values)) for values in columns.values()):
        return _with_own_clocks(path, columns, options.limits)
    if time := find_time_fault(columns["t"], options.limits):
        raise FileError(path, time.what, table.lines[time.row], "t")
    return Log.of_columns(path, columns, options.limits)


def _renamed(table: CsvTable, options: ReadOptions) -> CsvTable:
    """Return a table whose columns have our names and units, where the options say which they have."""
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
    """Return a log whose columns have no sample in empty cells; those of a group meet at the stamps of all of them."""
    own: dict[str, dict[str, Group]] = {}
    for name, values in columns.items():
        there = ~np.isnan(values)
        known = column_of(name)
        if name != "t":
            if time := find_time_fault(columns["t"][there], limits):
                raise FileError(path, time.what, column=name)
            samples = unwrapped(values[there]) if known.unit == "rad" else values[there]
            own.setdefault(known.group, {})[name] = Group(
                path.name, columns["t"][there], {name: samples}
            )
    groups = {}
    for key, members in own.items():
        t = np.unique(np.concatenate([g.t for g in members.values()]))
        for g in members.values():
            t = t[(t >= g.t[0]) & (t <= g.t[-1]) & ~g.in_gaps(t)]
        if len(t) < 2:
            raise FileError(path, f"{', '.join(members)} are never known at the same time")
        at = {n: np.searchsorted(g.t, t, side="right") - 1 for n, g in members.items()}
        groups[key] = Group(path.name, t, {
            n: g.columns[n][at[n]] if key == "cmd" else np.interp(t, g.t, g.columns[n]) for n, g in members.items()
        })  # fmt: skip
    return Log(path, groups, limits=limits)


def _check_names(table: CsvTable) -> None:
    """Refuse a header without `t`, without any of `RECORDED`, or with names that are none or stand there twice."""
    names = table.header
    path = table.path
    line = table.header_line
    for wanted, some in (("column t", ("t",)), ("known column", RECORDED)):
        if not any(n in some for n in names):
            what = f"there is no {wanted} among {quoted(names)}; a log's header names t and any of {', '.join(RECORDED)}"
            what += "; --columns t=NAME,x=NAME says which columns have other names"
            raise FileError(path, what, line)
    for k, name in enumerate(names):
        if name and not is_column_name(name):
            raise FileError(
                path,
                f"{quoted([name])} names no column; wanted printable text",
                line,
                f"number {k + 1}",
            )
        if name and name in names[:k]:
            raise FileError(
                path, "the header names this column twice; each needs a name of its own", line, name
            )


def write_csv(log: Log | Mapping[str, ArrayLike], path: str | Path) -> None:
    """Write a log on one clock, or (M,) columns by name, whole or not at all; `read_csv` gets equal bits back.

    Raises:
        FileError: the log cannot be brought onto one clock, or the columns make none.
        OSError: the file cannot be written.
    """
    path = Path(path)
    made = log.on_one_clock() if isinstance(log, Log) else Log.of_columns(path, log)
    names = sorted(made.columns, key=lambda name: name not in RECORDED)
    table = [made.t.tolist(), *(made.columns[name].tolist() for name in names)]

    def write(beside: Path) -> None:
        with beside.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["t", *names])
            writer.writerows(zip(*table, strict=True))

    write_atomic(path, write)
