"""CSV recordings: a header line, a column `t` [s] that increases, and any columns of `RECORDING_COLUMNS` and others."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from numpy.typing import ArrayLike

from ssmr.types import FloatArray
from validation.logs.csv_table import CellTable, read_csv_table
from validation.logs.files import quoted
from validation.logs.limits import USUAL, LogLimits, find_time_fault
from validation.logs.log import Log, LogFormat, ReadOptions
from validation.logs.recording import RECORDING_COLUMNS, Recording, RecordingError, is_channel_name
from validation.store import write_atomic


def read_csv(path: str | Path, gap_factor: float = 2.5, limits: LogLimits = USUAL) -> Recording:
    """Read a recording.

    A UTF-8 byte order mark, any line ending and blank lines are accepted. A channel that holds no number, or that has
    missing or infinite numbers or some beyond the limit `channel`, is left out with a warning.

    Args:
        path: a CSV file.
        gap_factor: a step longer than this many periods is a gap.
        limits: greatest sizes and numbers; the usual ones if not given.

    Raises:
        RecordingError: the file cannot be read, is no valid recording or is beyond the limits.
    """
    path = Path(path)
    table = read_csv_table(path, RecordingError, limits)
    columns: dict[str, FloatArray] = {}
    for place, name in enumerate(_names(table)):
        bound = None if name == "t" else limits.of_column(name)
        values = table.numbers(place, name, {"t": "s", **RECORDING_COLUMNS}, bound)
        if values is not None:
            columns[name] = values
    if len(table.lines) < 2:
        some = "is one sample" if table.lines else "are no samples"
        raise RecordingError(path, f"there {some} after the header; a recording needs at least two")
    fault = find_time_fault(columns["t"], limits)
    if fault is not None:
        raise RecordingError(path, fault.what, table.lines[fault.row], "t")
    return Recording.from_columns(path.stem, columns, gap_factor)


def write_csv(recording: Recording | Mapping[str, ArrayLike], path: str | Path) -> None:
    """Write a recording, or (M,) columns by name with `t` among them, whole or not at all; `read_csv` gets equal bits back.

    Raises:
        ValueError: the columns are no valid recording.
        OSError: the file cannot be written.
    """
    path = Path(path)
    made = recording if isinstance(recording, Recording) else Recording.from_columns(path.stem, recording)
    columns = made.all_columns()

    def write(beside: Path) -> None:
        with beside.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(a.tolist() for a in columns.values()), strict=True))

    write_atomic(path, write)


def _names(table: CellTable) -> list[str]:
    """Return the names of the columns: `t`, at least one that is known, none twice."""
    names = [cell.strip() for cell in table.header]
    path, line = table.path, table.header_line
    for wanted, some in (("column t", ("t",)), ("known column", RECORDING_COLUMNS)):
        if not any(n in some for n in names):
            raise RecordingError(path, f"there is no {wanted} among {quoted(names)}; {RecordingError.header}", line)
    seen: set[str] = set()
    for k, name in enumerate(names):
        if not is_channel_name(name):
            what = f"{quoted([name])} names no column; wanted printable text"
            raise RecordingError(path, what, line, f"number {k + 1}")
        if name in seen:
            raise RecordingError(path, "the header names this column twice; each needs a name of its own", line, name)
        seen.add(name)
    return names


def _read(path: Path, options: ReadOptions) -> Log:
    if options.topics:
        raise RecordingError(path, "topics names the topics of a bag; this is a CSV file, whose columns have names")
    return Log.of_recording(path, read_csv(path, limits=options.limits), options.limits)


CSV = LogFormat("CSV recording", (".csv",), read=_read, write=lambda log, path: write_csv(log.recording(), path))
