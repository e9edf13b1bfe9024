"""CSV files: tables of numbers below a header, and logs with `t` [s] and any of `RECORDED`."""

from __future__ import annotations

import csv
import io
import itertools
import logging
import math
import re
import shlex
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import MOTOR_COLUMNS, TORQUES, FloatArray
from validation.files.columns import (
    COLUMNS,
    COMMAND_COLUMNS,
    ECHOED,
    POSITIONS,
    RECORDED,
    UNITS,
    Column,
    as_option,
    column_of,
    has_other_names,
    is_column_name,
    taken_by_name,
    unit_factor,
    unwrapped,
    without_unit,
)
from validation.files.limits import USUAL, LogLimits, find_time_fault
from validation.files.log import PLAIN, DataFrame, Group, Log, ReadOptions
from validation.files.reading import FileError, opened, quoted
from validation.files.topics import rates_of_positions
from validation.output import write_atomic

_SEPARATORS = {
    ";": "semicolons separate",
    "\t": "tabs separate",
    "#": "a comment stands before",
    " ": "spaces separate",
}
"""Signs in a first line without a comma, and their effect there."""

_NOTHING = ("", "nan", "na", "n/a", "null", "none")
"""Words, in lower case, of cells in which there is no number."""
_QUICK = 1 << 22
"""Size from which on pyarrow, which takes a tenth of a second to import, is quicker [bytes]."""
_FEWEST = 3
"""Numbers that a column has at least where such a word, which is not blank, is a gap in it."""
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[ T]")
_LARGE = {"ns": 1e17, "us": 1e14, "ms": 1e11}
"""Units of Unix time, and the number from which a time is in them."""
_ZONE = re.compile(r"(Z|[+-]\d\d:?\d\d)$")
"""Beginning of a date with a time, and the zone at its end, which all rows share."""

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class CsvTable:
    """Columns of numbers below a header; blank lines are left out."""

    path: Path
    header: Sequence[str]
    """Names of the columns."""
    header_line: int | None
    """Line on which the header begins, counted from 1; None in a frame, which has no lines."""
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
    header_line, header, rows = _header(path, limits)
    plain = _read_plain_table(path, header_line, header, limits.samples)
    return plain or _read_rows(path, header_line, header, rows, limits)


def _read_rows(
    path: Path,
    header_line: int | None,
    header: Sequence[str],
    rows: Iterable[tuple[int, list[str]]],
    limits: LogLimits,
) -> CsvTable:
    """Read the rows of any table, cell by cell."""
    width = len(header)
    columns = [array("d") for _ in header]
    lines = array("q")
    bad: list[tuple[int, str] | None] = [None] * width
    words: dict[int, tuple[int, str]] = {}
    for line, row in rows:
        if len(row) != width:
            raise FileError(
                path, f"there are {len(row)} fields, wanted {width} as in the header", line
            )
        if len(lines) >= limits.samples:
            raise FileError(path, f"there are too many rows: {limits.says('samples')}", line)
        for place, cell in enumerate(row):
            value = _number(cell)
            columns[place].append(value)
            if math.isfinite(value) or bad[place] is not None:
                continue
            word = cell.strip().lower()
            if word not in _NOTHING:
                bad[place] = (len(lines), cell)
            elif word:
                words.setdefault(place, (len(lines), cell))
        lines.append(line)
    for place, word_at in words.items():
        if np.count_nonzero(np.isfinite(columns[place])) < _FEWEST and bad[place] is None:
            bad[place] = word_at
    return CsvTable(
        path=path,
        header=[name.strip() for name in header],
        header_line=header_line,
        lines=lines,
        columns=[np.array(column, dtype=np.float64) for column in columns],
        bad=bad,
    )


def _read_plain_table(
    path: Path, header_line: int, header: Sequence[str], most: float
) -> CsvTable | None:
    """Return a large table whose cells are all finite numbers or empty; None for any other.

    pyarrow reads it several times as fast as what reads others with care.
    """
    names = [str(k) for k in range(len(header))]
    columns = []
    try:
        if header_line > 1 or path.stat().st_size < _QUICK:
            return None
        from pyarrow import csv as quick
        from pyarrow import float64

        table = quick.read_csv(
            path,
            quick.ReadOptions(column_names=names, skip_rows=1),
            quick.ParseOptions(ignore_empty_lines=False),
            quick.ConvertOptions(column_types=dict.fromkeys(names, float64()), null_values=[""]),
        )
        for column in table.columns:
            # through dlpack, as its own conversion imports pandas
            chunks = [np.from_dlpack(chunk) for chunk in column.fill_null(math.nan).chunks]
            columns.append(np.concatenate(chunks))
    except (ImportError, OSError, ValueError):  # which is said by what reads with care
        return None
    empty = [~np.isfinite(column) for column in columns]
    nulls = [column.null_count for column in table.columns]
    # to pyarrow a blank line is a row of nothing
    if list(map(np.count_nonzero, empty)) != nulls or np.all(empty, axis=0).any():
        return None
    if len(columns[0]) > most:
        return None
    lines = range(2, len(columns[0]) + 2)
    return CsvTable(path, [n.strip() for n in header], 1, lines, columns, [None] * len(header))


def _header(
    path: Path, limits: LogLimits
) -> tuple[int, list[str], Iterator[tuple[int, list[str]]]]:
    """Return the line and the names of the header, and an iterator of the rows below it.

    What `ros2 topic echo --csv` writes has no header; the number of columns tells the message.
    """
    rows = _rows(path, limits)
    header_line, header = next(rows, (0, []))
    width = len(header)
    if width in ECHOED and not math.isnan(_number(header[0])):
        rows = itertools.chain([(header_line, header)], rows)
        header = [name or f"_{k}" for k, name in enumerate(ECHOED[width])]
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
    return header_line, header, rows


def _number(cell: str) -> float:
    try:
        # Python reads 1_0 as 10, which no logger writes
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return _date(cell) if _DATE.match(cell) else math.nan


def _date(cell: str) -> float:
    """Return a date as pandas and ISO 8601 write it, in seconds of Unix time; NaN for none."""
    try:
        return float(np.datetime64(_ZONE.sub("", cell.strip()), "ns").astype(np.int64)) * 1e-9
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


def read_csv(path: str | Path, options: ReadOptions = PLAIN, radius: float | None = None) -> Log:
    """Read a log.

    Columns without a name are left out, and so are those whose name is not in `RECORDED` and that
    are not numbers throughout, with a warning.

    Raises:
        FileError: the file cannot be read, is no valid log or is beyond the limits.
    """
    return _log_of_table(read_csv_table(Path(path), options.limits), options, radius)


def frame_path(frame: DataFrame) -> Path:
    """Return the path that a frame stands for: the name in its `attrs`, else `frame`."""
    return Path(str(frame.attrs.get("name", "frame")))


def with_frames_apart(given: Any, names: dict[str, Any]) -> Any:
    """Return an object, or a list of some, with frames of pandas whose names are in `names` once.

    Parts of a frame have its name, and most frames have none: others are called NAME-2 and so on. A
    frame that is given twice is one; those that are returned are added to `names`.
    """
    if type(given) in (list, tuple):
        return tuple(with_frames_apart(each, names) for each in given)
    if not isinstance(given, DataFrame):
        return given
    first = str(frame_path(given))
    name = first
    number = 1
    while names.setdefault(name, given) is not given:
        number += 1
        name = f"{first}-{number}"
    if name == first:
        return given
    renamed = given.copy(deep=False)
    renamed.attrs["name"] = name
    return renamed


def read_frame(frame: DataFrame, options: ReadOptions, radius: float | None) -> Log:
    """Return the log in a frame of pandas: the one that a CSV file of it would give.

    An index with a name is a column, and errors count rows from 0, as `iloc` does.

    Raises:
        FileError: the frame is no valid log or is beyond the limits.
    """
    from pandas.api.types import is_numeric_dtype

    if frame.index.name not in (None, *frame.columns):
        frame = frame.reset_index()
    path = frame_path(frame)
    header = [str(name).strip() for name in frame.columns]
    columns = []
    bad = []
    for place, name in enumerate(header):
        cells = frame.iloc[:, place]
        numbers = np.full(len(cells), math.inf)
        if is_numeric_dtype(cells):
            numbers = cells.to_numpy(np.float64, na_value=math.nan)
        first = None
        if np.any(np.isinf(numbers)):
            texts = cells.astype(object).where(cells.notna(), "").astype(str)
            rows = ((row, [text]) for row, text in enumerate(texts))
            read = _read_rows(path, None, [name], rows, options.limits)
            numbers = read.columns[0]
            first = read.bad[0]
        columns.append(numbers)
        bad.append(first)
    table = CsvTable(path, header, None, range(len(frame)), columns, bad)
    return _log_of_table(table, options, radius)


def _log_of_table(table: CsvTable, options: ReadOptions, radius: float | None) -> Log:
    """Return the log in a table, as `read_csv` does."""
    path = table.path
    if options.topics:
        raise FileError(
            path, "topics names the topics of a bag; this is a table, whose columns have names"
        )
    table, remarks = _rename_columns(table, options, radius)
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
    lines = np.asarray(table.lines)
    if len(lines) < 2:
        some = "is one sample" if len(lines) else "are no samples"
        raise FileError(path, f"there {some} after the header; a log needs at least two")
    cells = np.column_stack(list(columns.values()))
    same = (cells[1:] == cells[:-1]) | (np.isnan(cells[1:]) & np.isnan(cells[:-1]))
    anew = np.append(True, ~np.all(same, axis=1))
    if not np.all(anew):
        remarks.append(f"{np.count_nonzero(~anew)} rows repeat the one before, and are left out")
    columns = {name: values[anew] for name, values in columns.items()}
    log = _of_columns(path, columns, lines[anew], options.limits)
    return replace(log, remarks=remarks)


def _of_columns(
    path: Path, columns: Mapping[str, FloatArray], lines: FloatArray, limits: LogLimits
) -> Log:
    """Return a log of columns, NaN where they have no sample; `lines` are those of its rows."""
    if any(np.any(np.isnan(values)) for values in columns.values()):
        return _with_own_clocks(path, columns, limits)
    late = find_time_fault(columns["t"], limits)
    if late is not None:
        row, what = late
        raise FileError(path, what, int(lines[row]), "t")
    return Log.of_columns(path, columns, limits)


def _rename_columns(
    table: CsvTable, options: ReadOptions, radius: float | None
) -> tuple[CsvTable, list[str]]:
    """Return a table whose columns have our names and units, and sentences on what was guessed.

    The options say what they are; of a foreign table, the names do that themselves.
    """
    tidy = [without_unit(name) for name in table.header]
    header = [name for name, _ in tidy]
    _check_twice(table, header)
    wanted, remarks = _wanted(table, header, options)
    places = {name: k for k, name in enumerate(header)}
    places |= {name: k for k, name in enumerate(table.header)}
    taken = {}
    for name, (theirs, unit) in wanted.items():
        parts = [theirs] if theirs in places else theirs.split("+")
        missing = [part for part in parts if part not in places]
        if missing:
            what = f"there is no column {quoted(missing)} among {quoted(table.header)}"
            raise FileError(table.path, what)
        at = [places[part] for part in parts]
        unit = unit or tidy[at[0]][1]
        if name == "t" and not unit:
            most = float(np.nanmax(table.columns[at[0]], initial=0.0))
            unit = next((unit for unit, least in _LARGE.items() if most > least), "")
        taken[name] = at, unit
    used = set[int]().union(*(at for at, _ in taken.values()))
    for k, (name, unit) in enumerate(tidy):
        if k not in used and name not in wanted:
            known = name == "t" or name in COLUMNS
            taken[name if known else table.header[k]] = [k], unit * known
    columns = dict[str, FloatArray]()
    bad = []
    for name in sorted(taken, key=lambda name: name != "t"):
        at, unit = taken[name]
        parts_of = [table.columns[k] for k in at]
        try:
            t = columns.get("t")
            columns[name] = _in_our_unit(name, parts_of, unit, t, options, radius)
        except ValueError as error:
            raise FileError(table.path, f"--columns: {error}") from error
        bad.append(next((table.bad[k] for k in at if table.bad[k] is not None), None))
    ours = replace(table, header=list(columns), columns=list(columns.values()), bad=bad)
    return ours, remarks


def _wanted(
    table: CsvTable, header: Sequence[str], options: ReadOptions
) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Return the columns that are taken for ours, by the options or by their names; and why."""
    guessed = taken_by_name(header)
    guessed = {name: theirs for name, theirs in guessed.items() if name not in options.columns}
    wheels = {name: guessed[name] for name in COMMAND_COLUMNS["wheels"] if name in guessed}
    wanted = dict(options.columns)
    remarks = []
    if has_other_names([*header, *wanted]):
        wanted = guessed | wanted
        if guessed:
            option = shlex.quote(as_option(wanted))
            remarks.append(f"columns were taken by their names: --columns {option}")
    else:
        wanted |= {name: guessed[name] for name in ("t", "yaw") if name in guessed}
        if wheels:
            remarks.append(f"it may have wheels: --columns {as_option(wheels)} takes their means")
    if len(set(wanted.values())) < len(wanted):
        raise FileError(table.path, "--columns takes one column for two")
    return wanted, remarks


def _in_our_unit(
    name: str,
    parts: Sequence[FloatArray],
    unit: str,
    t: FloatArray | None,
    options: ReadOptions,
    radius: float | None,
) -> FloatArray:
    """Return the (M,) numbers of a column of ours from those of one or more of theirs.

    Four are a quaternion, two of a time are seconds and nanoseconds, torques of a side add up, and
    others are averaged. Positions of wheels become rates. A ValueError says which units there are.
    """
    if name == "yaw" and len(parts) == 4:
        return quat_wxyz_to_yaw(np.column_stack([parts[3], *parts[:3]]))
    if name == "t":
        if len(parts) == 2:
            return parts[0] + 1e-9 * parts[1]
        return parts[0] * unit_factor("t", unit if unit in UNITS else "", None)
    values = parts[0]
    if len(parts) > 1:
        values = np.sum(parts, axis=0) / (1 if name in MOTOR_COLUMNS[TORQUES] else len(parts))
    if unit not in UNITS and unit not in ("ticks", "rad") and name not in options.columns:
        return values  # a header may say anything in brackets
    if name in COMMAND_COLUMNS["wheels"] and unit in ("ticks", *POSITIONS):
        angles = values * options.angle(unit)
        if t is None:
            raise ValueError("positions of wheels need a column t")
        return rates_of_positions(t, angles)
    return values * unit_factor(name, unit, radius)


def _with_own_clocks(path: Path, columns: Mapping[str, FloatArray], limits: LogLimits) -> Log:
    """Return a log whose columns have no sample in empty cells.

    Columns of a group are interpolated, or held, at the stamps of all of them.
    """
    members: dict[str, list[Group]] = {}
    for name, values in columns.items():
        if name == "t":
            continue
        filled = ~np.isnan(values)
        t = columns["t"][filled]
        fault = find_time_fault(t, limits)
        if fault is not None:
            raise FileError(path, fault[1], column=name)
        column = column_of(name)
        samples = unwrapped(values[filled]) if column.unit == "rad" else values[filled]
        members.setdefault(column.group, []).append(Group(path.name, t, {name: samples}))
    groups = {}
    for key, parts in members.items():
        t = np.unique(np.concatenate([part.t for part in parts]))
        for part in parts:
            t = t[(t >= part.t[0]) & (t <= part.t[-1]) & ~part.in_gaps(t)]
        common = {}
        for part in parts:
            for name, samples in part.columns.items():
                common[name] = np.interp(t, part.t, samples)
                if key == "cmd":
                    common[name] = samples[np.searchsorted(part.t, t, side="right") - 1]
        if len(t) < 2:
            raise FileError(path, f"{', '.join(common)} are never known at the same time")
        groups[key] = Group(path.name, t, common)
    return Log(path, groups, limits=limits)


def _check_names(table: CsvTable) -> None:
    """Refuse a header without `t` or any of `RECORDED`."""
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


def _check_twice(table: CsvTable, names: Sequence[str]) -> None:
    """Refuse names of columns that are bad or repeated."""
    path = table.path
    line = table.header_line
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
