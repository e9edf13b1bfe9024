"""Tables of numbers below a header, as spreadsheets and loggers write them."""

from __future__ import annotations

import codecs
import contextlib
import csv
import io
import itertools
import math
import re
import shlex
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.files.columns import COLUMNS, Column, parse_unit
from validation.files.limits import USUAL, LogLimits
from validation.files.names import name_echoed, taken_by_name
from validation.files.reading import FileError, opened, quoted

_SEPARATORS = "\t;,| "
"""Signs between columns; of two that split the lines equally well the first one counts."""
_HEAD = 1 << 16
"""Size of the beginning of a file that shows how it is written [bytes]."""
_LOOKED_AT = 30
"""Number of its rows that are looked at."""
_COMMENTS = ("#", "%", "//")
"""Signs before a header that is a comment to others."""
_NOTHING = ("", *"nan nat na n/a #n/a <na> null nil none - -- ?".split())
"""Words, in lower case, of cells in which there is no number."""
_QUICK = 1 << 22
"""Size from which on pyarrow, which takes a tenth of a second to import, is quicker [bytes]."""
_BLOCK = 1 << 17
"""Size of the blocks of lines that it reads at a time [bytes]."""
_FEWEST = 3
"""Numbers that a column has at least where such a word, which is not blank, is a gap in it."""
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[ T]")
_ZONE = re.compile(r"(Z|[+-]\d\d:?\d\d)$")
"""Beginning of a date with a time, and the zone at its end, which all rows share."""
_DURATION = re.compile(r"\s*(?:(\d+) days? )?(?:(\d+):)?(\d+):(\d\d(?:\.\d+)?)\s*")
"""Days, hours, minutes and seconds of a duration, or of a time of the day."""
_GROUPED = re.compile(r"[+-]?\d{1,3}([\s'\u2019.,])\d{3}(?:\1\d{3})*(?:(?!\1)[.,]\d+)?")
"""A number whose digits are in groups of three, and the sign between these."""


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
        fault = column.fault(self.columns[place])
        if (bad := self.bad[place]) is not None:
            row, text = bad
            fault = row, f"{quoted([text.strip()])}, wanted a finite number [{column.unit}]"
        if fault is None:
            return self.columns[place]
        row, what = fault
        what = f"there is {what}".replace("is nan,", "is nothing,")
        raise FileError(self.path, what, self.lines[row], self.header[place])


def read_csv_table(path: Path, limits: LogLimits = USUAL) -> CsvTable:
    """Read a CSV file. A UTF-8 byte order mark, any line ending and blank lines are accepted.

    Raises:
        FileError: the file is no CSV file, is empty, has rows that differ in length or is beyond
            the limits.
    """
    with opened(path, limits.bytes_of("table_size"), "table_size") as file:
        layout = _find_layout(path, file)
        plain = _read_plain_table(path, layout, limits.samples)
        rows = _read_lines(path, file, layout)
        return plain or read_rows(path, layout.line, layout.header, rows, limits)


def read_rows(
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
    decimals: dict[str, str] = {}
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
            if math.isfinite(value):
                _note_decimal_sign(path, decimals, line, cell)
            elif bad[place] is None and (word := cell.strip()):
                if word.lower() not in _NOTHING:
                    bad[place] = (len(lines), cell)
                words.setdefault(place, (len(lines), cell))
        lines.append(line)
    for place, word_at in words.items():
        if np.count_nonzero(np.isfinite(columns[place])) < _FEWEST and bad[place] is None:
            bad[place] = word_at
    return CsvTable(
        path=path,
        header=header,
        header_line=header_line,
        lines=lines,
        columns=[np.array(column, dtype=np.float64) for column in columns],
        bad=bad,
    )


def part_rows(table: CsvTable, stamps: str) -> str:
    """Return the end of a sentence on a file whose first column, its stamps, does not increase.

    It is a command that keeps rows whose stamps do: those with one word in a column that tells them
    apart, or else those before time goes back, or the first of each stamp. It is empty where there
    is none. The stamps are called so in the file.
    """
    import pandas

    t = pandas.Series(table.columns[0])
    keep = says = ""
    if not t.is_monotonic_increasing:
        keep = f"NR < {table.lines[int(np.argmax(t.diff() < 0.0))]}"
        says = "what is before"
    with opened(table.path) as file:
        layout = _find_layout(table.path, file)
        rows = [cells for _, cells in _read_lines(table.path, file, layout)]
    if not keep and stamps in layout.header:
        cell = f"${layout.header.index(stamps) + 1}"
        keep = f"{cell} != last; {{last = {cell}}}"
        says = "the first row of each stamp"
    for place, words in enumerate(zip(*rows, strict=True)):
        if _is_text(words[0]) and t.groupby([*words]).diff().min() > 0.0:
            keep = f'NR <= {layout.skipped} || ${place + 1} ~ "{words[0]}"'
            says = f"one of those that column {layout.header[place]} tells apart"
    command = f"awk -F{layout.separator!r} '{keep}' {shlex.quote(str(table.path))} > part.csv"
    return f"; {command} keeps {says}" if keep else ""


def _note_decimal_sign(path: Path, found: dict[str, str], line: int, cell: str) -> None:
    """Keep the first number with a decimal point or a comma; one with the other is refused."""
    sign = "," if cell.rfind(",") > cell.rfind(".") else "."
    if sign in cell and ":" not in cell:
        found.setdefault(sign, cell)
    if len(found) == 2:
        what = f"there are {quoted(found.values())}: write all decimals with the same sign"
        raise FileError(path, what, line)


def _read_plain_table(path: Path, layout: _Layout, most: float) -> CsvTable | None:
    """Return a large table whose cells are all finite numbers or empty; None for any other.

    pyarrow reads it several times as fast as what reads others with care.
    """
    if path.stat().st_size < _QUICK or layout.separator == " " or layout.encoding != "utf-8-sig":
        return None
    columns = _parse_quickly(path, layout, ".") or _parse_quickly(path, layout, ",")
    if columns is None or not 0 < len(columns[0]) <= most:
        return None
    first = layout.skipped + 1
    lines = range(first, first + len(columns[0]))
    return CsvTable(path, layout.header, layout.line, lines, columns, [None] * len(columns))


def _parse_quickly(path: Path, layout: _Layout, point: str) -> list[FloatArray] | None:
    """Return the read-only columns of a table with this sign in its decimals.

    None where pyarrow is missing, or finds what is neither a finite number nor an empty cell.
    """
    try:
        from pyarrow import OSFile, default_memory_pool, float64
        from pyarrow import csv as quick
    except ImportError:
        return None
    names = [str(k) for k in range(len(layout.header))]
    with opened(path, path.stat().st_size) as file:
        blocks = iter(partial(file.read, _BLOCK), b"")
        lines = sum(block.count(b"\n") + block.count(b"\r") for block in blocks)
    columns = [np.empty(lines + 1) for _ in names]
    n = 0
    try:
        # Block by block: all at once, it would hold the text of all of it. pyarrow reads ahead on a
        # thread of its own, also after an error, so it has the file for itself.
        for block in quick.open_csv(
            OSFile(str(path)),
            quick.ReadOptions(
                use_threads=False,
                block_size=_BLOCK,
                skip_rows=layout.skipped,
                column_names=names,
            ),
            quick.ParseOptions(delimiter=layout.separator, ignore_empty_lines=False),
            quick.ConvertOptions(
                column_types=dict.fromkeys(names, float64()), null_values=[""], decimal_point=point
            ),
        ):
            _write_numbers([column[n : n + len(block)] for column in columns], block.columns)
            n += len(block)
    except (OSError, ValueError):  # which is said by what reads with care
        return None
    default_memory_pool().release_unused()
    for column in columns:
        column.resize(n, refcheck=False)  # in place, so that the column owns its numbers
        column.setflags(write=False)
    return columns


def _write_numbers(columns: Sequence[FloatArray], block: Sequence[Any]) -> None:
    """Write a block of pyarrow; a ValueError: a line is blank or a number is not finite."""
    blank: Any = True
    for column, more in zip(columns, block, strict=True):
        # by its buffers: its own conversion and its own functions take 40 MB to import
        known, numbers = more.buffers()
        column[:] = np.frombuffer(numbers)[: len(column)]
        if more.null_count:
            bits = np.unpackbits(np.frombuffer(known, np.uint8), bitorder="little")
            column[bits[: len(column)] == 0] = math.nan
        empty = ~np.isfinite(column)
        if np.count_nonzero(empty) != more.null_count:
            raise ValueError
        blank &= empty
    # to pyarrow a blank line is a row of nothing
    if np.any(blank):
        raise ValueError


class _Layout(NamedTuple):
    """How a table is written."""

    encoding: str
    separator: str
    line: int
    """Line on which the header begins, counted from 1."""
    skipped: int
    """Number of lines before the first row of numbers."""
    header: list[str]
    """Names of the columns."""


class _Row(NamedTuple):
    """A row of a table."""

    line: int
    """Line on which it begins, counted from 1."""
    end: int
    """Line on which it ends."""
    cells: list[str]


def _find_layout(path: Path, file: BinaryIO) -> _Layout:
    """Return how a table is written, by its beginning.

    The sign between the columns is the one that splits most rows into equally many cells, and the
    header is the first such row. Units may stand in a row below it. What `ros2 topic echo --csv`
    writes has no header; the number of columns tells the message.
    """
    head = file.read(_HEAD)
    encoding = "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else ""
    encoding = encoding or "utf-8-sig"
    lines = list(io.StringIO(head.decode(encoding, _errors_in(encoding)), newline=""))
    if len(head) == _HEAD:
        lines.pop()
    separator, rows = max(
        ((sign, _first_rows(lines, sign)) for sign in _SEPARATORS),
        key=lambda found: _span_of_alike_rows(found[1])[0],
    )
    if not rows:
        what = "a header line with the names of columns, and lines of numbers"
        raise FileError(path, f"the file is empty; wanted {what}")
    if "\0" in "".join(rows[0].cells):
        what = "there is a NUL byte; wanted a CSV file, which is plain UTF-8 text"
        raise FileError(path, what, rows[0].line)
    _, width = _span_of_alike_rows(rows)
    if width == 1:
        what = "nothing separates the columns; wanted commas, semicolons, tabs or spaces"
        raise FileError(path, what, rows[0].line)
    first = next(k for k, row in enumerate(rows) if len(row.cells) == width)
    header, skipped = _find_header(path, rows[max(first - 1, 0) :], width)
    names = [_as_text(name).strip() for name in header.cells]
    return _Layout(encoding, separator, header.line, skipped, names)


def _first_rows(lines: Iterable[str], separator: str) -> list[_Row]:
    """Return the first rows of a table, if this sign separates its columns."""
    rows = list[_Row]()
    with contextlib.suppress(csv.Error):
        rows.extend(itertools.islice(_split_rows(lines, separator), _LOOKED_AT))
    return rows


def _span_of_alike_rows(rows: Sequence[_Row]) -> tuple[int, int]:
    """Return how many rows have the usual number of cells, none if that is one, and the number."""
    usual = Counter(len(row.cells) for row in rows).most_common(1)
    width, count = usual[0] if usual else (1, 0)
    return count * (width > 1), width


def _find_header(path: Path, rows: Sequence[_Row], width: int) -> tuple[_Row, int]:
    """Return the header and the number of lines before the first numbers.

    Of several rows of words it is the one that names most columns of ours; others may tell units.
    The first row that has the usual `width` is the first or the second.
    """
    wide = len(rows[0].cells) != width
    first = rows[wide]
    echoed = name_echoed([*itertools.takewhile(_is_text, first.cells[3:])], width)
    if echoed and not _is_text(first.cells[0]) and _is_text(first.cells[2]):
        return _Row(first.line, first.line - 1, echoed), first.line - 1
    if not any(_is_text(cell) for cell in first.cells if cell.strip()):
        header = rows[0]
        if not wide or len(header.cells) == 1:
            what = "there are numbers where the names of the columns should be; put a line"
            raise FileError(path, f"{what} such as t,x,y,yaw above them", first.line)
        return header, header.end
    words = list(itertools.takewhile(lambda row: _is_of_words(row, width), rows[wide:]))
    units = [row for row in words if all(map(parse_unit, row.cells))]
    header = max((row for row in words if row not in units), key=_count_ours, default=first)
    if not words or len(words) == len(rows[wide:]):
        return header, header.end
    for row in units:
        cells = zip(header.cells, (cell.strip(" []()") for cell in row.cells), strict=True)
        header = header._replace(cells=[f"{name} [{unit}]" for name, unit in cells])
    return header, words[-1].end


def _is_of_words(row: _Row, width: int) -> bool:
    """Return whether a row of the usual width has words, and no number."""
    filled = [cell for cell in row.cells if cell.strip().lower() not in _NOTHING]
    return len(row.cells) == width and bool(filled) and all(map(_is_text, filled))


def _count_ours(row: _Row) -> int:
    """Return how many columns of ours the cells of a row name."""
    return len({"t", *COLUMNS}.intersection(row.cells)) + len(taken_by_name(row.cells))


def _errors_in(encoding: str) -> str:
    """Return what becomes of bytes that are no text: signs that are no number."""
    return "replace" if encoding == "utf-16" else "surrogateescape"


def _as_text(name: str) -> str:
    """Return a name whose bytes are no UTF-8 as older spreadsheets mean it."""
    if name.isascii() or not any("\udc80" <= sign <= "\udcff" for sign in name):
        return name
    return name.encode("utf-8", "surrogateescape").decode("cp1252", "replace")


def _split_rows(lines: Iterable[str], separator: str, skipped: int = 0) -> Iterator[_Row]:
    """Yield the rows of (the rest of) a table that are not blank; a csv.Error says what is none."""
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=separator == " ", strict=True)
    line = skipped + 1
    for row in reader:
        cells = row[1:] if row and row[0].strip() in _COMMENTS else row
        if separator == " " and cells and not cells[-1]:
            cells = cells[:-1]
        end = skipped + reader.line_num
        is_remark = len(cells) == 1 and cells[0].lstrip().startswith(_COMMENTS)
        if not is_remark and (len(cells) > 1 or any(map(str.strip, cells))):
            yield _Row(line, end, cells)
        line = end + 1


def _is_text(cell: str) -> bool:
    return math.isnan(_number(cell))


def _number(cell: str) -> float:
    try:
        # Python reads 1_0 as 10, which no logger writes
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        pass
    if "." not in cell and cell.count(",") == 1:
        return _number(cell.replace(",", "."))
    if _DATE.match(cell):
        return _date(cell)
    if duration := _DURATION.fullmatch(cell):
        parts = zip((86400.0, 3600.0, 60.0, 1.0), duration.groups("0"), strict=True)
        return sum(size * float(part) for size, part in parts)
    # Swedish Excel has a minus of its own; MATLAB writes durations as "0.02 sec"
    plain = cell.replace("\u2212", "-").removesuffix(" sec")
    if plain != cell:
        return _number(plain)
    if grouped := _GROUPED.fullmatch(cell.strip()):
        return _number(cell.replace(grouped[1], ""))
    return math.nan


def _date(cell: str) -> float:
    """Return a date as pandas and ISO 8601 write it, in seconds of Unix time; NaN for none."""
    try:
        return float(np.datetime64(_ZONE.sub("", cell.strip()), "ns").astype(np.int64)) * 1e-9
    except ValueError:
        return math.nan


def _read_lines(path: Path, file: BinaryIO, layout: _Layout) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row below the header; bad UTF-8 will be no number."""
    line = layout.skipped
    file.seek(0)
    errors = _errors_in(layout.encoding)
    text = io.TextIOWrapper(file, encoding=layout.encoding, errors=errors, newline="")
    below = itertools.islice(text, layout.skipped, None)
    try:
        for row in _split_rows(below, layout.separator, layout.skipped):
            line = row.end
            yield row.line, row.cells
    except csv.Error as cause:
        raise FileError(path, f"this is no CSV: {cause}", line + 1) from cause
