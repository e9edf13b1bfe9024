"""Logs in tables: files and frames with `t` [s] and any of `RECORDED`."""

from __future__ import annotations

import logging
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import MOTOR_COLUMNS, TORQUES, FloatArray
from validation.files.columns import (
    COMMAND_COLUMNS,
    RECORDED,
    Column,
    column_of,
    count_on,
    parse_unit,
    to_local,
    unit_factor,
    unwrapped,
)
from validation.files.limits import LogLimits, find_time_fault
from validation.files.log import PLAIN, DataFrame, Group, Log, ReadOptions
from validation.files.names import Columns, as_option, taken_by_name, without_unit
from validation.files.reading import FileError, quoted
from validation.files.tables import CsvTable, part_rows, read_csv_table, read_rows
from validation.files.topics import rates_of_positions
from validation.output import write_atomic

_LARGE = {"ns": 1e17, "us": 1e14, "ms": 1e11}
"""Units of Unix time, and the number from which a time is in them."""
_logger = logging.getLogger(__name__)


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
            read = read_rows(path, None, [name], rows, options.limits)
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
    table, wanted, remarks = _rename_columns(table, options, radius)
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
    anew = np.zeros(len(lines), dtype=bool)
    anew[0] = True
    for values in columns.values():
        both = np.isnan(values[1:]) & np.isnan(values[:-1])
        anew[1:] |= (values[1:] != values[:-1]) & ~both
    if not np.all(anew):
        remarks.append(f"{np.count_nonzero(~anew)} rows repeat the one before, and are left out")
        columns = {name: values[anew] for name, values in columns.items()}
    log = _of_columns(table, columns, lines[anew], options.limits, wanted.get("t", "t")[0])
    return replace(log, remarks=remarks)


def _of_columns(
    table: CsvTable,
    columns: Mapping[str, FloatArray],
    lines: FloatArray,
    limits: LogLimits,
    stamps: str,
) -> Log:
    """Return a log of columns, NaN where they have no sample; `lines` are those of its rows.

    Its `stamps` are called so in the table.
    """
    path = table.path
    if any(np.any(np.isnan(values)) for values in columns.values()):
        return _with_own_clocks(path, columns, limits, stamps)
    late = find_time_fault(columns["t"], limits, stamps)
    if late is not None:
        row, what = late
        if table.header_line and "must increase" in what:
            what += part_rows(table, stamps)
        raise FileError(path, what, int(lines[row]), "t")
    return Log.of_columns(path, columns, limits)


def _rename_columns(
    table: CsvTable, options: ReadOptions, radius: float | None
) -> tuple[CsvTable, Columns, list[str]]:
    """Return a table whose columns have our names and units, theirs, and what was guessed.

    The options say what they are, by names or numbers from 1; of others, the names do that
    themselves.
    """
    _check_twice(table)
    tidy = [without_unit(name) for name in table.header]
    wanted, remarks = _choose_columns(table, options)
    places = {str(k + 1): k for k in range(len(tidy))}
    places |= {name: k for k, (name, _) in enumerate(tidy)}
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
        if parse_unit(unit) is None and name not in options.columns:
            what = f"the unit of {quoted([theirs])} is not understood: it counts as that of {name}"
            remarks.append(f"{what}; --columns {name}=NAME:UNIT says another")
            unit = ""
        taken[name] = at, unit
    used = set[int]().union(*(at for at, _ in taken.values()))
    for k, name in enumerate(table.header):
        if k not in used and name not in wanted:
            taken[name] = [k], ""
    _check_names(table, [*taken])
    columns = dict[str, FloatArray]()
    bad = []
    for name in sorted(taken, key=lambda name: name != "t"):
        at, unit = taken[name]
        try:
            parts_of = [table.columns[k] for k in at]
            values, remark = _in_our_unit(name, parts_of, unit, columns, options, radius)
        except ValueError as error:
            if name == "t" or name in options.columns:
                raise FileError(table.path, f"--columns: {error}") from error
            remarks.append(f"{error}; without that, {name} is left out")
            continue
        remarks += remark
        columns[name] = values
        bad.append(next((table.bad[k] for k in at if table.bad[k] is not None), None))
    ours = replace(table, header=list(columns), columns=list(columns.values()), bad=bad)
    return ours, wanted, remarks


def _choose_columns(table: CsvTable, options: ReadOptions) -> tuple[Columns, list[str]]:
    """Return the columns that are taken for ours, by the options or by their names; and why."""
    header = table.header
    named = {
        part for theirs, _ in options.columns.values() for part in (theirs, *theirs.split("+"))
    }
    foreign = taken_by_name([name for name in header if name not in named])
    guessed = {name: foreign[name] for name in foreign if name not in (*options.columns, *header)}
    wanted = guessed | dict(options.columns)
    remarks = []
    if guessed:
        option = shlex.quote(as_option(wanted))
        remarks.append(f"columns were taken by their names: --columns {option}")
    if len(set(wanted.values())) < len(wanted):
        raise FileError(table.path, "--columns takes one column for two")
    return wanted, remarks


def _in_our_unit(
    name: str,
    parts: Sequence[FloatArray],
    unit: str,
    columns: Mapping[str, FloatArray],
    options: ReadOptions,
    radius: float | None,
) -> tuple[FloatArray, list[str]]:
    """Return the (M,) numbers of a column of ours from those of one or more of theirs; remarks.

    Four are a quaternion, two of a time are seconds and nanoseconds, torques of a side add up, and
    others are averaged. Positions of wheels become rates, with counters counted on where they wrap.
    A ValueError says which units there are.
    """
    if name == "yaw" and len(parts) == 4:
        return quat_wxyz_to_yaw(np.column_stack([parts[3], *parts[:3]])), []
    if name == "t" and len(parts) == 2:
        return parts[0] + 1e-9 * parts[1], []
    if name in ("x", "y") and unit == "deg" and len(parts) == 2:
        # each from both, its own degrees first
        latitude, longitude = parts if name == "y" else reversed(parts)
        return to_local(latitude, longitude)[name == "y"], []
    factor, leads_to = unit_factor(name, unit, radius, options.ticks_per_turn)
    remarks = []
    if name in COMMAND_COLUMNS["wheels"] and leads_to == "rad":
        if "t" not in columns:
            raise ValueError("positions of wheels need a column t")
        rates = []
        for part in parts:
            there = np.isfinite(part)
            whole = 2.0 * math.pi if unit in ("rad", "radians") else 1.0
            on, size = count_on(part[there], whole)
            if size:
                remarks.append(f"{name} counts to {size:.6g}, and is counted on from there")
            rate = np.full(len(part), math.nan)
            rate[there] = rates_of_positions(columns["t"][there], on)
            rates.append(rate)
        parts = rates
    values = parts[0]
    if len(parts) > 1:
        values = np.sum(parts, axis=0) / (1 if name in MOTOR_COLUMNS[TORQUES] else len(parts))
    return values * factor if factor != 1.0 else values, remarks


def _with_own_clocks(
    path: Path, columns: Mapping[str, FloatArray], limits: LogLimits, stamps: str
) -> Log:
    """Return a log whose columns have no sample in empty cells.

    Columns of a group are interpolated, or held, at the stamps of all of them.
    """
    members: dict[str, list[Group]] = {}
    for name, values in columns.items():
        if name == "t":
            continue
        filled = ~np.isnan(values)
        t = columns["t"][filled]
        fault = find_time_fault(t, limits, stamps)
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


def _check_names(table: CsvTable, names: Sequence[str]) -> None:
    """Refuse a table whose columns, by these names, are not `t` and any of `RECORDED`."""
    for kind, some in (("column t", ("t",)), ("known column", RECORDED)):
        if not {*some} & {*names}:
            what = f"there is no {kind} among {quoted(table.header)}"
            need = f"a log's header names t and any of {', '.join(RECORDED)}"
            says = "--columns t=NAME,x=NAME"
            if "t" in some:
                says = " or ".join(_offer_times(table)) or says
            what = (
                f"{what}; {need}; {says} says which columns have other names (numbers count from 1)"
            )
            raise FileError(table.path, what, table.header_line)


def _offer_times(table: CsvTable) -> Iterator[str]:
    """Yield options that take a column for `t`: one that increases, not as numbers of rows do."""
    for place, name in enumerate(table.header):
        steps = np.diff(table.columns[place])
        if name not in RECORDED and np.all(steps > 0.0) and np.any(steps != 1.0):
            yield f"--columns {shlex.quote(f't={name or place + 1}')}"


def _check_twice(table: CsvTable) -> None:
    """Refuse names of columns that are repeated."""
    for k, name in enumerate(table.header):
        if name and name in table.header[:k]:
            what = "the header names this column twice; each needs a name of its own"
            raise FileError(table.path, what, table.header_line, name)


def write_csv(log: Log | Mapping[str, ArrayLike], path: str | Path) -> None:
    """Write a log on one clock, or (M,) columns by name, whole or not at all.

    `read_csv` gets equal bits back.

    Raises:
        FileError: the log cannot be brought onto one clock, or the columns make none.
        OSError: the file cannot be written.
    """
    import pandas

    path = Path(path)
    common = log.on_one_clock() if isinstance(log, Log) else Log.of_columns(path, log)
    columns = {"t": common.t, **common.columns}
    names = sorted(columns, key=lambda name: name != "t" and 1 + (name not in RECORDED))
    table = pandas.DataFrame(columns)[names]
    write_atomic(path, partial(table.to_csv, index=False, lineterminator="\n"))
