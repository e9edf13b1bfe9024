"""Tables of rows, whose keys say how columns are written, for the terminal and as markdown."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, groupby
from typing import Any

import rich.table
from rich import box
from rich.cells import cell_len
from rich.console import Console, Group
from rich.measure import Measurement
from rich.text import Text

from validation.report.columns import DECLARED, NOTHING, Unit, heading_of, is_length, unit_of
from validation.words import each_line, markdown_cell, one_line

Row = Mapping[str, Any]
"""A row by key: texts, numbers [SI], None for what there is not, or (median, low, high) for a
number with its interval."""


@dataclass(frozen=True)
class Cell:
    """One entry as it is written, and whether it is the best of its kind."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Grid:
    """A table cell by cell, as the terminal and markdown write it."""

    header: tuple[tuple[str, str], ...]
    """Name and unit of each column; the unit may be empty."""
    groups: tuple[tuple[tuple[Cell, ...], ...], ...]
    """Rows, in groups that a line separates."""
    left: int
    """Number of first columns that hold words."""
    title: str = ""
    """Heading above the table."""
    caption: str = ""
    """Explanation below the table."""
    trailing: int = 0
    """Number of last columns that hold words too; the very last one may be wrapped."""


@dataclass(frozen=True, eq=False)
class Table:
    """Rows under one title."""

    title: str
    """Heading above the table."""
    rows: Sequence[Row]
    """Rows; a column is a key of any of them, in the order of their first appearance."""
    caption: str = ""
    """Sentences below the table."""
    group: str | None = None
    """Key of a column whose change begins a new group of rows, in which the best value is looked
    for."""
    best: bool = False
    """Whether the best value of each declared column is emphasised."""
    reference: str | None = None
    """First text of the row that the others are measured from; it is judged by its speed alone."""
    hidden: frozenset[str] = frozenset()
    """Keys that the JSON file has and the table does not show."""
    units: Mapping[str, Unit] = field(default_factory=dict)
    """Units of columns whose keys do not say theirs, or not with the digits that are wanted."""
    headings: Mapping[str, str] = field(default_factory=dict)
    """Headings of columns whose keys do not say theirs."""

    @property
    def keys(self) -> list[str]:
        """Return the keys of the columns that are shown."""
        keys = dict.fromkeys(chain.from_iterable(self.rows))
        return [key for key in keys if key not in self.hidden]

    def grid(self) -> Grid:
        """Return the table as it is written, cell by cell."""
        keys = self.keys
        words = [all(isinstance(row.get(key), str | None) for row in self.rows) for key in keys]
        left = words.index(False) if False in words else len(words)
        numbers = {key: _numbers(row.get(key) for row in self.rows) for key in keys}
        lengths = list(chain.from_iterable(numbers[key] for key in filter(is_length, keys)))
        units = {key: self.units.get(key) or unit_of(key, numbers[key], lengths) for key in keys}
        header = []
        for key, holds_words in zip(keys, words, strict=True):
            heading = self.headings.get(key, heading_of(key))
            header.append((heading, "" if holds_words else units[key].symbol))
        groups = []
        for _, members in groupby(self.rows, lambda row: row.get(self.group or "")):
            rows = list(members)
            columns = [self._column(key, rows, units[key]) for key in keys]
            groups.append(tuple(zip(*columns, strict=True)))
        trailing = next((n for n, word in enumerate(reversed(words[left:])) if not word), 0)
        return Grid(tuple(header), tuple(groups), left, self.title, self.caption, trailing)

    def _column(self, key: str, rows: Sequence[Row], unit: Unit) -> list[Cell]:
        """A column's cells in a group of rows, the best of two or more emphasised, ties too."""
        texts = [_text(row.get(key), unit) for row in rows]
        declared = DECLARED.get(key)
        if not self.best or declared is None:
            return [Cell(text) for text in texts]

        def badness(value: float) -> float:
            if declared.direction == "one":
                if value > 0.0:
                    return abs(math.log(value))
                return math.inf
            if declared.direction == "low":
                return value
            return -value

        judged = dict[int, float]()
        for i, row in enumerate(rows):
            value = row.get(key)
            if not isinstance(value, float) or not math.isfinite(value):
                continue
            if declared.direction == "high" or next(iter(row.values())) != self.reference:
                judged[i] = badness(value)
        best = texts[min(judged, key=lambda i: judged[i])] if len(judged) > 1 else None
        return [Cell(text, i in judged and text == best) for i, text in enumerate(texts)]


def _numbers(values: Iterable[Any]) -> list[float]:
    parts = list[Any]()
    for value in values:
        parts += value if isinstance(value, tuple) else [value]
    return [float(n) for n in parts if isinstance(n, int | float) and not isinstance(n, bool)]


def _text(value: Any, unit: Unit) -> str:
    if isinstance(value, tuple):
        median, low, high = (unit.text(v) for v in value)
        return f"{median} ({low}–{high})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and unit.symbol in ("", "1"):
        return str(value)
    if isinstance(value, int | float):
        if unit.symbol or not math.isfinite(value):
            return unit.text(float(value))
        return f"{value:.{unit.significant}g}"
    if value is None:
        return NOTHING
    return str(value)


# --- for the terminal ---

_LABEL = 16
"""Width down to which a column of labels is wrapped."""
_PROSE = 30
"""Width down to which a column of sentences is wrapped."""


def rich_table(grid: Grid, width: int | None = None) -> Group:
    """Draw a grid for the terminal, its caption below; foreign texts are no markup.

    Args:
        grid: what to draw.
        width: columns of the terminal; where the table has too little room, words are wrapped and
            then the last columns of numbers are left out, which the caption names. None draws all
            columns.
    """
    n = len(grid.header)
    columns = list(range(n))
    missing = list[int]()
    # The first column of numbers and the last of words stay.
    droppable = [*range(grid.left + 1, n - grid.trailing), *range(n - grid.trailing, n - 1)]
    console = Console(width=10_000)
    while width is not None and droppable:
        table = _terminal_table(grid, columns)
        if Measurement.get(console, console.options, table).minimum <= width:
            break
        missing.insert(0, droppable.pop())
        columns.remove(missing[0])
    names = ", ".join(one_line(grid.header[k][0]) for k in missing)
    left_out = f"left out for want of room: {names}\n" if missing else ""
    caption = (left_out + grid.caption).rstrip()
    table = _terminal_table(grid, columns)
    if not caption:
        return Group(table)
    return Group(table, Text(each_line(caption), style="table.caption"))


def _terminal_table(grid: Grid, columns: Iterable[int]) -> rich.table.Table:
    table = rich.table.Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        title_justify="left",
        title=Text(each_line(grid.title), style="bold"),
    )
    last = len(grid.header) - 1
    rows = list(chain.from_iterable(grid.groups))
    for k in columns:
        name, unit = map(one_line, grid.header[k])
        is_text = k < grid.left or k > last - grid.trailing
        heading = name if k < grid.left else name.replace(" ", "\n")
        with_unit = f"{heading}\n[{unit}]"
        cells = [one_line(row[k].text) for row in rows]
        least = max(map(cell_len, [*with_unit.split("\n"), *cells]))
        if is_text:
            least = min(least, _PROSE if k == last else _LABEL)
        table.add_column(
            Text(with_unit if unit else heading),
            justify="left" if is_text else "right",
            min_width=least,
            no_wrap=not is_text,
            overflow="fold",
            vertical="bottom",
        )
    for group in grid.groups:
        for i, row in enumerate(group):
            table.add_row(*(_rich_text(row[k]) for k in columns), end_section=i + 1 == len(group))
    return table


def _rich_text(cell: Cell) -> Text:
    return Text(one_line(cell.text), style="bold green" if cell.best else "")


def text_tables(grids: Iterable[Grid], notes: Iterable[str] = (), width: int = 110) -> str:
    """Return grids, and sentences below them, as plain text of at most `width` columns."""
    out = io.StringIO()
    console = Console(file=out, width=width, color_system=None)
    for grid in grids:
        console.print(rich_table(grid, width))
    for note in notes:
        console.print(Text(each_line(note)))
    return out.getvalue()


# --- as markdown ---


def markdown_table(grid: Grid) -> list[str]:
    """Draw a grid as the lines of a table of GitHub-flavoured markdown."""

    def line(cells: Iterable[str]) -> str:
        return "| " + " | ".join(map(markdown_cell, cells)) + " |"

    header = [f"{name} [{unit}]" if unit else name for name, unit in grid.header]
    sides = [":---" if k < grid.left else "---:" for k in range(len(grid.header))]
    lines = [line(header), line(sides)]
    for row in chain.from_iterable(grid.groups):
        lines.append(line(f"**{cell.text}**" if cell.best else cell.text for cell in row))
    return lines
