"""Tables of rows, whose columns say by their keys how they are written, for the terminal (rich) and as markdown."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
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
"""A row by key: texts, numbers [SI], None for what there is not, or (median, low, high) for a number with its interval."""


@dataclass(frozen=True)
class Cell:
    """One entry as it is written, and whether it is the best of its kind."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Grid:
    """A table as it is written: what the terminal and markdown have in common."""

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
    """Key of a column whose change begins a new group of rows, in which the best value is looked for."""
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
        return [key for key in dict.fromkeys(k for row in self.rows for k in row) if key not in self.hidden]

    def grid(self) -> Grid:
        """Return the table as it is written, cell by cell."""
        keys = self.keys
        words = [all(isinstance(row.get(key), str | None) for row in self.rows) for key in keys]
        left = words.index(False) if False in words else len(words)
        numbers = {key: _numbers(row.get(key) for row in self.rows) for key in keys}
        lengths = [n for key in keys if is_length(key) for n in numbers[key]]
        units = {key: self.units.get(key) or unit_of(key, numbers[key], lengths) for key in keys}
        header = [
            (self.headings.get(k, heading_of(k)), "" if w else units[k].symbol) for k, w in zip(keys, words, strict=True)
        ]
        groups = [
            tuple(zip(*(self._column(key, list(rows), units[key]) for key in keys), strict=True))
            for rows in ([*alike] for _, alike in groupby(self.rows, lambda row: row.get(self.group or "")))
        ]
        trailing = next((n for n, word in enumerate(reversed(words[left:])) if not word), 0)
        return Grid(tuple(header), tuple(groups), left, self.title, self.caption, trailing)

    def _column(self, key: str, rows: Sequence[Row], unit: Unit) -> list[Cell]:
        """Return a column's cells in a group of rows, the best emphasised: of no less than two, ties as written included."""
        texts, declared = [_text(row.get(key), unit) for row in rows], DECLARED.get(key)
        if not self.best or declared is None:
            return [Cell(text) for text in texts]

        def badness(value: float) -> float:
            if declared.direction == "one":
                return abs(math.log(value)) if value > 0.0 else math.inf
            return value if declared.direction == "low" else -value

        judged = {
            i: badness(row[key])
            for i, row in enumerate(rows)
            if isinstance(row.get(key), float)
            and math.isfinite(row[key])
            and (declared.direction == "high" or next(iter(row.values())) != self.reference)
        }
        best = texts[min(judged, key=lambda i: judged[i])] if len(judged) > 1 else None
        return [Cell(text, i in judged and text == best) for i, text in enumerate(texts)]


def _numbers(values: Iterable[Any]) -> list[float]:
    flat = [part for value in values for part in (value if isinstance(value, tuple) else (value,))]
    return [float(n) for n in flat if isinstance(n, int | float) and not isinstance(n, bool)]


def _text(value: Any, unit: Unit) -> str:
    if isinstance(value, tuple):
        median, low, high = (unit.text(v) for v in value)
        return f"{median} ({low}–{high})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and unit.symbol in ("", "1"):
        return str(value)
    if isinstance(value, int | float):
        return unit.text(float(value)) if unit.symbol or not math.isfinite(value) else f"{value:.{unit.significant}g}"
    return NOTHING if value is None else str(value)


# --- for the terminal ---

_LABEL, _PROSE = 16, 30
"""Widths down to which a column of labels and one of sentences are wrapped."""


def rich_table(grid: Grid, width: int | None = None) -> Group:
    """Draw a grid for the terminal, its caption below. Foreign texts go in as they are, never as markup.

    Args:
        grid: what to draw.
        width: columns of the terminal; where the table has too little room, words are wrapped and then the last columns of
            numbers are left out, which the caption names. None draws all columns.
    """
    n = len(grid.header)
    shown, missing = list(range(n)), list[int]()
    droppable = [*range(grid.left + 1, n - grid.trailing), *range(n - grid.trailing, n)[: grid.trailing - 1]]
    console = Console(width=10_000)
    while width is not None and droppable:
        if Measurement.get(console, console.options, _drawn(grid, shown)).minimum <= width:
            break
        missing.insert(0, droppable.pop())
        shown.remove(missing[0])
    names = ", ".join(one_line(grid.header[k][0]) for k in missing)
    left_out = f"left out for want of room: {names}\n" if missing else ""
    caption = (left_out + grid.caption).rstrip()
    return Group(_drawn(grid, shown), *([Text(each_line(caption), style="table.caption")] if caption else []))


def _drawn(grid: Grid, shown: Iterable[int]) -> rich.table.Table:
    table = rich.table.Table(
        box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, title_justify="left",
        title=Text(each_line(grid.title), style="bold"),
    )  # fmt: skip
    last = len(grid.header) - 1
    for k in shown:
        name, unit = map(one_line, grid.header[k])
        is_text = k < grid.left or k > last - grid.trailing
        heading = name if k < grid.left else name.replace(" ", "\n")
        cells = [one_line(row[k].text) for group in grid.groups for row in group]
        least = max(map(cell_len, [*f"{heading}\n[{unit}]".split("\n"), *cells]))
        if is_text:
            least = min(least, _PROSE if k == last else _LABEL)
        table.add_column(
            Text(f"{heading}\n[{unit}]" if unit else heading), justify="left" if is_text else "right", min_width=least,
            no_wrap=not is_text, overflow="fold", vertical="bottom",
        )  # fmt: skip
    for group in grid.groups:
        for i, row in enumerate(group):
            texts = [Text(one_line(row[k].text), style="bold green" if row[k].best else "") for k in shown]
            table.add_row(*texts, end_section=i + 1 == len(group))
    return table


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

    rows = [row for group in grid.groups for row in group]
    return [
        line(f"{name} [{unit}]" if unit else name for name, unit in grid.header),
        line(":---" if k < grid.left else "---:" for k in range(len(grid.header))),
        *(line(f"**{cell.text}**" if cell.best else cell.text for cell in row) for row in rows),
    ]
