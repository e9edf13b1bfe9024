"""Waypoints from CSV and xlsx files, and by the name of a reference trajectory.

A file has a header that names x and y [m] and, where it brings its times, t [s]; other columns are ignored. In an xlsx file
that is the first sheet.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ssmr.control.references import circle, line, sine
from ssmr.control.waypoints import Waypoints, find_fault
from validation.logs.csv_table import DAMAGE, CellTable, TableError, quoted, read_bytes, read_csv_table

_UNITS = {"x": "m", "y": "m", "t": "s"}

DEFAULT_SPEED = 0.25
"""Speed of the sample trajectories where none is given [m/s]; the slower of the thesis' two."""


class WaypointError(TableError):
    """A file has no waypoints that a robot could follow."""

    wanted = "waypoints (.csv or .xlsx)"
    header = "a file of waypoints begins with a header that names x and y [m] and, if it brings its times, t [s]"


class _SheetError(WaypointError):
    """A spreadsheet has no waypoints that a robot could follow."""

    counted = "row"


def read_waypoints(path: str | Path, speed: float | None = None) -> Waypoints:
    """Read waypoints (Alg. 5, lines 1-7).

    In a CSV file, a UTF-8 byte order mark, any line ending and blank lines are fine. Upper and lower case of a column's
    name mean the same.

    Args:
        path: a CSV or xlsx file.
        speed: reference speed [m/s]: it gives the times, and replaces those of the file. None: the file's own.

    Raises:
        WaypointError: the file cannot be read, has no waypoints, or no times while there is no speed.
        ValueError: the speed is not positive and finite.
    """
    path = Path(path)
    ending = path.suffix.lower()
    error: type[WaypointError] = _SheetError if ending == ".xlsx" else WaypointError
    if ending not in (".csv", ".xlsx") and not path.is_dir():
        raise error(path, f"files ending in '{path.suffix}' are not read; wanted {error.wanted}")
    table = _read_sheet(path) if ending == ".xlsx" else read_csv_table(path, error)
    columns = {}
    for name, place in _places_of_columns(table, ("x", "y", "t") if speed is None else ("x", "y")).items():
        values = table.numbers(place, name, _UNITS)
        assert values is not None  # x, y and t are numbers, or an error
        columns[name] = values
    if len(table.rows) < 2:
        some = "is one waypoint" if table.rows else "are no waypoints"
        raise error(path, f"there {some} after the header; a trajectory needs at least two")
    xy = np.column_stack([columns["x"], columns["y"]])
    fault = find_fault(columns.get("t", np.arange(len(xy), dtype=np.float64)), xy)
    if fault is not None:
        raise error(path, fault.what, table.lines[fault.row], fault.column)
    return Waypoints(columns["t"], xy) if speed is None else Waypoints.from_path(xy, speed)


def generic(speed: float) -> Waypoints:
    """The generic trajectory: a lab's tight corners, practicable at 0.25 m/s and hardly at 0.5 (docs/references.md).

    The thesis' own (Fig. 4.5) is lost. The reference speed is in m/s.

    Raises:
        ValueError: the speed is not positive and finite.
    """
    with resources.as_file(resources.files("validation.track").joinpath("references", "generic.csv")) as path:
        return read_waypoints(path, speed)


REFERENCES: Mapping[str, Callable[[float], Waypoints]] = MappingProxyType(
    {"line": line, "circle": circle, "sine": sine, "generic": generic}
)
"""The four sample trajectories of Sec. 4.1.3 by name, each a function of the reference speed [m/s]."""


def open_reference(name_or_path: str, speed: float | None = None) -> tuple[str, Waypoints]:
    """Return what to follow: a sample trajectory by name, or the waypoints of a file.

    Args:
        name_or_path: a name of `REFERENCES`, or the path of a CSV or xlsx file.
        speed: reference speed [m/s]; None for the times of the file, or `DEFAULT_SPEED` for a sample trajectory.

    Returns:
        The name in tables and pictures, and the waypoints.

    Raises:
        ValueError: an unknown name, a file without times where there is no speed, or one that cannot be read.
    """
    if name_or_path in REFERENCES:
        return name_or_path, REFERENCES[name_or_path](DEFAULT_SPEED if speed is None else speed)
    path = Path(name_or_path)
    if not path.suffix and not path.exists():
        raise ValueError(
            f"no reference '{name_or_path}'; there are: {', '.join(REFERENCES)}, and paths of .csv and .xlsx files"
        )
    return path.stem, read_waypoints(path, speed)


def _places_of_columns(table: CellTable, wanted: tuple[str, ...]) -> dict[str, int]:
    path, line, error = table.path, table.header_line, table.error
    names = [cell.strip().lower() for cell in table.header]
    for name in ("x", "y"):
        if name not in names:
            what = f"there is no column {name} among {quoted(map(str.strip, table.header))}; {error.header}"
            raise error(path, what, line)
    if "t" in wanted and "t" not in names:
        raise error(path, "there is no column t [s]: add one, or give the reference speed, such as 0.25 m/s", line)
    for name in wanted:
        if names.count(name) > 1:
            raise error(path, "the header names this column twice; each needs a name of its own", line, name)
    return {name: names.index(name) for name in wanted}


def _read_sheet(path: Path) -> CellTable:
    """Return the first sheet as text, all rows as wide as the header; blank rows are left out."""
    try:
        import openpyxl
    except ImportError:
        raise _SheetError(
            path, "reading xlsx files needs openpyxl: pip install 'ssmr-testbed[xlsx]', or save it as .csv"
        ) from None
    data = read_bytes(path, _SheetError)
    try:
        with warnings.catch_warnings(action="ignore"):  # of styles, pictures and other things that are no numbers
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            table = list(_filled(book.worksheets[0])) if book.worksheets else []
    except (zipfile.BadZipFile, *DAMAGE) as cause:
        raise _SheetError(path, f"this is no xlsx file, or a damaged one ({quoted([str(cause)])})") from cause
    if not table:
        raise _SheetError(path, f"the first sheet is empty; {_SheetError.header}")
    (line, header), *others = table
    rows = [(cells + [""] * len(header))[: len(header)] for _, cells in others]
    return CellTable(path, header, line, rows, [k for k, _ in others], _SheetError)


def _filled(sheet: Any) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row of a sheet that holds something; `repr` of a number reads back to the same bits."""
    sheet.reset_dimensions()  # what a file claims of its size may be wrong
    for k, values in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells = ["" if v is None else repr(v) if isinstance(v, float) else str(v) for v in values]
        if any(map(str.strip, cells)):
            yield k, cells
