"""Spreadsheets (xlsx) as tables of cells. Such a file is a zip of XML; both are looked at before a library unpacks them."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

from validation.logs.csv_table import CellTable, make_table
from validation.logs.files import DAMAGE, TableError, read_regular
from validation.logs.limits import USUAL, LogLimits
from validation.words import shortened

_ROWS = 1_048_576
"""Number of rows of the largest sheet that a spreadsheet program makes."""
_HEADER_WITHIN = 100
"""Number of rows at the beginning among which the header is."""
_PARTS = 1000
"""Greatest number of files in the zip."""
_ELEMENTS = 700_000
"""Greatest number of XML elements in all parts: those of 100 000 rows of three cells."""
_CELLS = frozenset({"row", "c", "v", "f", "is", "t", "si", "r"})
"""Elements that rows and texts consist of; others, such as styles, are made into objects and take much longer."""
_OTHERS = 70_000
"""Greatest number of other elements; a spreadsheet program allows 64 000 styles."""
_DEPTH = 100
"""Greatest depth of XML elements in one another."""


class _RefusedError(Exception):
    """The file may be a spreadsheet, but is not read."""


def read_sheet(path: Path, error: type[TableError], limits: LogLimits = USUAL) -> CellTable:
    """Return the first sheet as text, all rows as wide as the header; blank rows are left out.

    Raises:
        TableError: an `error`, if the file is no spreadsheet, its first sheet is empty, or it is beyond the limits.
    """
    try:
        import openpyxl
    except ImportError:
        raise error(
            path, "reading xlsx files needs openpyxl: pip install 'ssmr-testbed[xlsx]', or save it as .csv"
        ) from None
    data = read_regular(path, error, limits)
    try:
        _inspect(data, limits)
        with warnings.catch_warnings(action="ignore"):  # of styles, pictures and other things that are no numbers
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            rows = _filled(book.worksheets[0], limits) if book.worksheets else iter(())
            table = make_table(path, rows, error, limits)
    except TableError:
        raise
    except _RefusedError as cause:
        raise error(path, str(cause)) from None
    except (zipfile.BadZipFile, expat.ExpatError, *DAMAGE) as cause:
        raise error(path, f"this is no xlsx file, or a damaged one ({shortened(cause, 60)!r})") from cause
    if table is None:
        raise error(path, f"the first sheet is empty; {error.header}")
    return table


def _filled(sheet: Any, limits: LogLimits) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row of a sheet that holds something; `repr` of a number reads back to the same bits."""
    sheet.reset_dimensions()  # what a file claims of its size may be wrong
    widest = int(min(limits.columns, 1e6)) + 1
    header = width = 0
    for k, values in enumerate(sheet.iter_rows(max_row=_HEADER_WITHIN, max_col=widest, values_only=True), start=1):
        cells = _texts(values)
        if any(cells):
            header, width = k, max(j for j, cell in enumerate(cells, start=1) if cell)
            yield k, cells[:width]
            break
    if not header:
        return
    rows = sheet.iter_rows(min_row=header + 1, max_row=_ROWS + 1, max_col=width, values_only=True)
    for k, values in enumerate(rows, start=header + 1):
        if k > _ROWS:
            raise _RefusedError(f"there is a row beyond {_ROWS}, the last one of a sheet")
        if values.count(None) < len(values) and any(cells := _texts(values)):
            yield k, cells


def _texts(values: tuple[Any, ...]) -> list[str]:
    return ["" if v is None else (repr(v) if isinstance(v, float) else str(v)).strip() for v in values]


def _inspect(data: bytes, limits: LogLimits) -> None:
    """Refuse a zip that unpacks to too much, and XML that declares entities or nests or repeats elements without end."""
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        parts = packed.infolist()
        size = sum(part.file_size for part in parts)  # no more than that is read of each, whatever is packed there
        if len(parts) > _PARTS or size > limits.bytes_of("sheet_size"):
            what = f"there are {size / 1e6:.6g} MB in {len(parts)} files once it is unpacked"
            raise _RefusedError(f"{what}, but {limits.says('sheet_size')}, in {_PARTS} files")
        count = others = 0
        for part in parts:
            more, other = _elements(packed.read(part), part.filename)
            count, others = count + more, others + other
            if count > _ELEMENTS or others > _OTHERS:
                raise _RefusedError(_TOO_MANY)


_TOO_MANY = (
    f"there are more than {_ELEMENTS} elements of XML, or {_OTHERS} besides those of cells, or {_DEPTH} in one another"
)


def _elements(text: bytes, name: str) -> tuple[int, int]:
    """Return how many elements an XML text has, and how many besides `_CELLS`; what is no XML may not be named like XML."""
    count = others = depth = 0

    def start(element: str, _: object) -> None:
        nonlocal count, others, depth
        count, others, depth = count + 1, others + (element.rpartition(":")[2] not in _CELLS), depth + 1
        if count > _ELEMENTS or others > _OTHERS or depth > _DEPTH:
            raise _RefusedError(_TOO_MANY)

    def end(*_: object) -> None:
        nonlocal depth
        depth -= 1

    def declared(*_: object) -> None:
        raise _RefusedError(f"{shortened(name, 40)} declares a type of document, which no spreadsheet program writes")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler, parser.StartDoctypeDeclHandler = start, end, declared
    try:
        parser.Parse(text, True)
    except expat.ExpatError:
        if name.endswith((".xml", ".rels")):
            raise
    return count, others
