"""A table of rows, whose columns say by their keys how they are written; and its grid, which any medium draws."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

from validation.report.columns import DECLARED, NOTHING, Unit, heading_of, is_length, unit_of
from validation.report.tables import Cell, Grid, judged_cells

Row = Mapping[str, Any]
"""A row by key: texts, numbers [SI], None for what there is not, or (median, low, high) for a number with its interval."""


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
            self._cells(list(rows), keys, units) for _, rows in groupby(self.rows, lambda row: row.get(self.group or ""))
        ]
        trailing = next((n for n, word in enumerate(reversed(words[left:])) if not word), 0)
        return Grid(tuple(header), tuple(groups), left, self.title, self.caption, trailing)

    def _cells(self, rows: Sequence[Row], keys: Sequence[str], units: Mapping[str, Unit]) -> tuple[tuple[Cell, ...], ...]:
        """Return the cells of a group of rows."""
        columns = []
        for key in keys:
            texts = {str(i): _text(row.get(key), units[key]) for i, row in enumerate(rows)}
            declared = DECLARED.get(key)
            if not self.best or declared is None:
                columns.append([Cell(text) for text in texts.values()])
                continue
            judged = {
                str(i): row[key]
                for i, row in enumerate(rows)
                if isinstance(row.get(key), float)
                and (declared.wanted == "high" or next(iter(row.values())) != self.reference)
            }
            columns.append(list(judged_cells(texts, judged, declared.wanted).values()))
        return tuple(zip(*columns, strict=True))


def _numbers(values: Any) -> list[float]:
    """Return the numbers among the values of a column, those of intervals too."""
    flat = [part for value in values for part in (value if isinstance(value, tuple) else (value,))]
    return [float(n) for n in flat if isinstance(n, int | float) and not isinstance(n, bool)]


def _text(value: Any, unit: Unit) -> str:
    """Return a value as it is written in a column of this unit."""
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
