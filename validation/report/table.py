"""Tables of rows, whose keys say how columns are written, for the terminal and as markdown."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

import rich.table
from rich import box
from rich.cells import cell_len
from rich.console import Console, Group
from rich.measure import Measurement
from rich.text import Text

from ssmr.metrics.declared import Metric
from validation.output import each_line, markdown_text, one_line
from validation.report.columns import DECLARED, NOTHING, Unit, heading_of, is_length, unit_of

Row = Mapping[str, Any]
"""A row by key: texts, numbers [SI], None for what there is not, or (median, low, high) for a
number with its interval."""


class _TableColumn(NamedTuple):
    """A column as it is written, a text for each row."""

    heading: str
    """Heading without the unit."""
    unit: str
    """Symbol of the unit; empty for words and pure numbers."""
    texts: Sequence[str]
    best: frozenset[int]
    """Rows whose values are the best of their groups."""
    holds_words: bool
    """Whether no value is a number."""


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

    @property
    def groups(self) -> list[list[int]]:
        """Return the indices of the rows of each group."""
        groups = list[list[int]]()
        of_group = [row.get(self.group or "") for row in self.rows]
        for i, name in enumerate(of_group):
            if i == 0 or name != of_group[i - 1]:
                groups.append([])
            groups[-1].append(i)
        return groups

    def columns(self) -> list[_TableColumn]:
        """Return the table as it is written, column by column."""
        numbers = {key: _finite_numbers(row.get(key) for row in self.rows) for key in self.keys}
        lengths = list(chain.from_iterable(numbers[key] for key in filter(is_length, numbers)))
        columns = []
        for key, of_key in numbers.items():
            values = [row.get(key) for row in self.rows]
            words = all(isinstance(value, str | None) for value in values)
            unit = self.units.get(key) or unit_of(key, of_key, lengths)
            texts = [_cell_text(value, unit) for value in values]
            best = frozenset[int]()
            if self.best and key in DECLARED:
                best = self._best_of(DECLARED[key], texts)
            heading = self.headings.get(key, heading_of(key))
            columns.append(_TableColumn(heading, "" if words else unit.symbol, texts, best, words))
        return columns

    def _best_of(self, metric: Metric, texts: Sequence[str]) -> frozenset[int]:
        """Rows with the best of two or more values of their group; equal texts are all best."""
        best = set[int]()
        for group in self.groups:
            badness = {}
            for i in group:
                row = self.rows[i]
                value = row.get(metric.name)
                if not isinstance(value, float) or not math.isfinite(value):
                    continue
                if metric.direction == "high" or next(iter(row.values())) != self.reference:
                    badness[i] = _cell_badness(value, metric.direction)
            if len(badness) > 1:
                least = min(badness, key=badness.__getitem__)
                best.update(i for i in badness if texts[i] == texts[least])
        return frozenset(best)


def _cell_badness(value: float, direction: str) -> float:
    if direction == "low":
        return value
    if direction == "high":
        return -value
    return abs(math.log(value)) if value > 0.0 else math.inf


def _finite_numbers(values: Iterable[Any]) -> list[float]:
    parts = list[Any]()
    for value in values:
        parts += value if isinstance(value, tuple) else [value]
    return [float(n) for n in parts if isinstance(n, int | float) and not isinstance(n, bool)]


def _cell_text(value: Any, unit: Unit) -> str:
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
"""Width down to which the last column, if it holds sentences, is wrapped."""


def _rich_table(table: Table, width: int | None = None) -> Group:
    """Draw a table for the terminal, its caption below; foreign texts are no markup.

    Args:
        table: what to draw.
        width: columns of the terminal; where the table has too little room, words are wrapped and
            then the last columns of numbers are left out, which the caption names. None draws all
            columns.
    """
    columns = table.columns()
    last = columns[-1]
    # The first column of numbers, those before it, and the last one of words stay.
    first = next((k for k, column in enumerate(columns) if not column.holds_words), len(columns))
    droppable = [c for c in columns[first + 1 :] if c is not last or not c.holds_words]
    missing = list[str]()
    console = Console(width=10_000)
    drawn = _terminal_table(table, columns)
    while width is not None and droppable:
        if Measurement.get(console, console.options, drawn).minimum <= width:
            break
        dropped = droppable.pop()
        missing.insert(0, one_line(dropped.heading))
        columns = [column for column in columns if column is not dropped]
        drawn = _terminal_table(table, columns)
    caption = table.caption
    if missing:
        caption = f"left out for want of room: {', '.join(missing)}\n{caption}".rstrip()
    if not caption:
        return Group(drawn)
    return Group(drawn, Text(each_line(caption), style="table.caption"))


def _terminal_table(table: Table, columns: Sequence[_TableColumn]) -> rich.table.Table:
    drawn = rich.table.Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        title_justify="left",
        title=Text(each_line(table.title), style="bold"),
    )
    for column in columns:
        heading = one_line(column.heading)
        most = _PROSE if column is columns[-1] else _LABEL
        if not column.holds_words:
            heading = heading.replace(" ", "\n")
        if column.unit:
            heading += f"\n[{one_line(column.unit)}]"
        least = max(map(cell_len, [*heading.split("\n"), *map(one_line, column.texts)]))
        drawn.add_column(
            Text(heading),
            justify="left" if column.holds_words else "right",
            min_width=min(least, most) if column.holds_words else least,
            no_wrap=not column.holds_words,
            overflow="fold",
            vertical="bottom",
        )
    for group in table.groups:
        for i in group:
            styles = ["bold green" if i in column.best else "" for column in columns]
            texts = [one_line(column.texts[i]) for column in columns]
            drawn.add_row(*map(Text, texts, styles), end_section=i == group[-1])
    return drawn


def text_tables(
    tables: Iterable[Table], notes: Iterable[str] = (), width: int = 110, verdict: str = ""
) -> str:
    """Return a verdict, tables, and sentences below them, as text of at most `width` columns."""
    out = io.StringIO()
    # a notebook would show it at once, and give no text
    console = Console(file=out, width=width, color_system=None, force_jupyter=False)
    print_tables(console, tables, notes, verdict)
    return out.getvalue()


def print_tables(
    console: Console, tables: Iterable[Table], notes: Iterable[str], verdict: str = ""
) -> None:
    """Print a verdict, tables that have rows, and sentences below them."""
    if verdict:
        console.print(Text(each_line(f"{verdict}\n"), style="bold"))
    for table in tables:
        if table.rows:
            console.print(_rich_table(table, console.width))
    for note in notes:
        console.print(Text(each_line(note)))


# --- as markdown ---


def markdown_table(table: Table) -> list[str]:
    """Draw a table as the lines of a table of GitHub-flavoured markdown."""

    def line(cells: Iterable[str]) -> str:
        return "| " + " | ".join(map(one_line, cells)) + " |"

    columns = table.columns()
    header = [f"{c.heading} [{c.unit}]" if c.unit else c.heading for c in columns]
    sides = [":---" if c.holds_words else "---:" for c in columns]
    lines = [line(header), "|" + "|".join(sides) + "|"]
    for i in range(len(table.rows)):
        cells = [f"**{c.texts[i]}**" if i in c.best else c.texts[i] for c in columns]
        lines.append(line(cells))
    return lines


def draw_section(table: Table) -> list[str]:
    """Draw a table below its title and above its caption, as lines of markdown."""
    lines = [f"## {markdown_text(table.title)}", "", *markdown_table(table)]
    return [*lines, "", markdown_text(table.caption)] if table.caption else lines


def html_of(text: str) -> str:
    """Return markdown as a piece of HTML; no foreign text in it is markup."""
    from markdown_it import MarkdownIt

    return MarkdownIt("commonmark", {"html": False}).enable("table").render(each_line(text))


def image_html(png: bytes, title: str) -> str:
    """Return a picture as a piece of HTML that needs no other file."""
    data = base64.b64encode(png).decode()
    return f'<img alt="{html.escape(title)}" src="data:image/png;base64,{data}">\n'
