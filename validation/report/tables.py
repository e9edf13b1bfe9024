"""Tables before they are drawn, and the two ways of drawing them: for the terminal (rich) and as markdown."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from validation.report.columns import DEGREES as DEGREES
from validation.report.columns import METRES as METRES
from validation.report.columns import MILLIMETRES as MILLIMETRES
from validation.report.columns import NEWTONS as NEWTONS
from validation.report.columns import NOTHING as NOTHING
from validation.report.columns import PERCENT as PERCENT
from validation.report.columns import Unit as Unit
from validation.report.columns import length_unit as length_unit
from validation.report.columns import unit_by_kind
from validation.simulator.description import with_robot as with_robot
from validation.words import code_span as code_span
from validation.words import each_line as each_line
from validation.words import markdown as markdown
from validation.words import markdown_cell
from validation.words import one_line as one_line
from validation.words import shortened as shortened

if TYPE_CHECKING:
    from ssmr.metrics.declared import Metric
    from ssmr.metrics.windows import OverlappingErrors

BEST_STYLE = "bold green"
"""Style of the best value in a terminal."""


@dataclass(frozen=True)
class Cell:
    """One entry as it is written, and whether it is the best of its kind."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Grid:
    """A table before it is drawn: everything that the terminal and the report have in common."""

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


_INTERVAL_CAPTION = (
    "in brackets: an interval that holds the median with 90 %; in logs of less than four horizons, the range of the errors"
)


def _with_interval(unit: Unit, median: float, low: float, high: float) -> str:
    return f"{unit.text(median)} ({unit.text(low)}–{unit.text(high)})"


def interval_grid(who: str, found: Sequence[tuple[str, Mapping[float, OverlappingErrors]]], title: str) -> Grid | None:
    """Return medians over overlapping windows with their intervals, by horizon [s]; None where there is none.

    Args:
        who: heading of the column of names.
        found: names, and the errors of each by horizon.
        title: heading of the table.
    """
    groups = []
    for horizon in sorted({h for _, errors in found for h in errors}):
        rows = []
        for name, errors in found:
            if (e := errors.get(horizon)) is not None:
                position = _with_interval(METRES, e.position_median_m, e.position_low_m, e.position_high_m)
                yaw = _with_interval(DEGREES, e.yaw_median_rad, e.yaw_low_rad, e.yaw_high_rad)
                rows.append(tuple(map(Cell, (f"{horizon:g}", name, str(e.n), position, yaw))))
        groups.append(tuple(rows))
    header = (
        ("horizon", "s"),
        (who, ""),
        ("windows", "1"),
        ("position median", METRES.symbol),
        ("yaw median", DEGREES.symbol),
    )
    return Grid(header, tuple(groups), 2, title, _INTERVAL_CAPTION) if groups else None


def units_of(metrics: Iterable[Metric], rows: Sequence[Mapping[str, float]]) -> list[Unit]:
    """Return how to write each metric in a table of these rows; all lengths alike."""
    listed = list(metrics)
    lengths = [row[m.name] for m in listed if m.unit == "m" for row in rows]
    return [unit_by_kind(m.unit, [row[m.name] for row in rows], lengths) for m in listed]


def meanings(metrics: Iterable[Metric]) -> list[str]:
    """Return the legend of a report: one line of markdown for each metric."""
    return [f"- **{metric.label}**: {metric.meaning}." for metric in metrics]


def judged_cells(
    texts: Mapping[str, str], values: Mapping[str, float], wanted: Literal["low", "one", "high"]
) -> dict[str, Cell]:
    """Return a column's entries by name, the best of the values emphasised: no less than two, ties as written included."""

    def badness(value: float) -> float:
        if wanted == "one":
            return abs(math.log(value)) if value > 0.0 else math.inf
        return value if wanted == "low" else -value

    finite = {name: badness(value) for name, value in values.items() if math.isfinite(value)}
    best = texts[min(finite, key=lambda name: finite[name])] if len(finite) > 1 else None
    return {name: Cell(text, name in finite and text == best) for name, text in texts.items()}


def text_tables(grids: Iterable[Grid], notes: Iterable[str] = (), width: int = 110) -> str:
    """Return grids, and sentences below them, as plain text of at most `width` columns."""
    out = io.StringIO()
    console = Console(file=out, width=width, color_system=None)
    for grid in grids:
        console.print(rich_table(grid, width))
    for note in notes:
        console.print(Text(each_line(note)))
    return out.getvalue()


_GAP, _EDGES = 3, 4
"""Blanks between two columns, and outside of both outer ones, in a table that has room."""
_TIGHT_GAP = 2
"""Blanks between two columns in a table without room; nothing stands outside of it."""
_LABEL, _PROSE = 16, 30
"""Widths that a column of labels and one of sentences may be wrapped to."""


@dataclass(frozen=True)
class _Fit:
    """The columns and the spacing with which a table fits a width."""

    widths: Mapping[int, int]
    """Width of each column that is shown, by its place in the grid."""
    wrapped: frozenset[int]
    """Columns that are narrower than what stands in them."""
    tight: bool
    """Whether columns stand closer than usual."""


def _spans(grid: Grid) -> list[tuple[int, int]]:
    """Return the full width of each column, and the least one that it may be wrapped to: numbers keep all digits."""
    last = len(grid.header) - 1
    spans = []
    for k, (name, unit) in enumerate(grid.header):
        words = one_line(name).split(" ") if k >= grid.left else [one_line(name)]
        cells = [one_line(row[k].text) for group in grid.groups for row in group]
        full = max(map(cell_len, [*words, f"[{one_line(unit)}]" if unit else "", *cells]))
        longest = max(map(cell_len, [part for cell in [*words, *cells] for part in cell.split(" ")]))
        least = full
        if k < grid.left:
            least = max(_LABEL, min(longest, 2 * _LABEL))
        elif grid.trailing > 0 and k == last:
            least = max(min(longest, _PROSE), min(full // 3, _PROSE))
        spans.append((full, min(full, least)))
    return spans


def least_width(grid: Grid) -> int:
    """Return the width at which a table has all its columns, with the usual blanks between them."""
    return sum(least for _, least in _spans(grid)) + _GAP * (len(grid.header) - 1) + _EDGES


def _fit(grid: Grid, width: int) -> _Fit:
    """Return how a table gets into a width: columns move together, words wrap, and then the last numbers are left out."""
    spans = _spans(grid)
    shown = list(range(len(spans)))
    full = sum(most for most, _ in spans)
    if full + _GAP * (len(shown) - 1) + _EDGES <= width:
        return _Fit({k: most for k, (most, _) in enumerate(spans)}, frozenset(), False)
    tight = full + _TIGHT_GAP * (len(shown) - 1) <= width or least_width(grid) > width
    gap, edges = (_TIGHT_GAP, 0) if tight else (_GAP, _EDGES)
    words = [*range(grid.left), *range(len(spans) - grid.trailing, len(spans))]
    numbers = [k for k in shown if k not in words]
    droppable = [*reversed(numbers[1:]), *reversed(words[grid.left :])]
    while droppable and sum(spans[k][1] for k in shown) + gap * (len(shown) - 1) + edges > width:
        shown.remove(droppable.pop(0))
    widths = {k: spans[k][0] for k in shown}
    while (over := sum(widths.values()) + gap * (len(shown) - 1) + edges - width) > 0:
        slack = {k: widths[k] - spans[k][1] for k in shown}
        widest = max(slack, key=lambda k: slack[k])
        if slack[widest] <= 0:
            break
        widths[widest] -= min(over, max(1, slack[widest] // 2))
    return _Fit(widths, frozenset(k for k in shown if widths[k] < spans[k][0]), tight)


def rich_table(grid: Grid, width: int | None = None) -> Table:
    """Draw a grid for the terminal. Foreign texts go in as they are, never as markup.

    Args:
        grid: what to draw.
        width: columns of the terminal; where the table has too little room, the last columns of numbers are left out, and
            the caption names them. None draws all columns.
    """
    fit = None if width is None else _fit(grid, width)
    shown = range(len(grid.header)) if fit is None else sorted(fit.widths)
    caption = grid.caption
    if missing := ", ".join(one_line(name) for k, (name, _) in enumerate(grid.header) if k not in shown):
        caption = f"left out for want of room: {missing}" + f"\n{caption}" * bool(caption)
    table = Table(box=box.SIMPLE_HEAD, title=Text(each_line(grid.title), style="bold"), caption=Text(each_line(caption)))
    table.title_justify = table.caption_justify = "left"
    if fit is not None and fit.tight:
        table.show_edge = table.pad_edge = False
        table.padding = (0, 1, 0, 0)
    for k in shown:
        name, unit = map(one_line, grid.header[k])
        words = name.replace(" ", "\n") if k >= grid.left else name
        heading = Text(f"{words}\n[{unit}]" if unit else words)
        is_text = k < grid.left or k >= len(grid.header) - grid.trailing
        wraps = k in fit.wrapped if fit is not None else grid.trailing > 0 and k == len(grid.header) - 1
        table.add_column(
            heading, justify="left" if is_text else "right", no_wrap=not wraps, vertical="bottom",
            overflow="fold" if wraps else "ellipsis", width=fit.widths[k] if fit is not None else None,
        )  # fmt: skip
    for group in grid.groups:
        for i, row in enumerate(group):
            cells = [Text(one_line(row[k].text), style=BEST_STYLE if row[k].best else "") for k in shown]
            table.add_row(*cells, end_section=i + 1 == len(group))
    return table


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


def option_text(value: object) -> str:
    """Return an option as it is written; several values, such as horizons, are joined by commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ",".join(map(option_text, value))
    return f"{value:g}" if isinstance(value, float) else one_line(value)


def report_markdown(
    title: str, facts: Mapping[str, object], grids: Iterable[Grid], notes: Sequence[str], legend: Sequence[str]
) -> str:
    """Return a report as GitHub-flavoured markdown.

    Args:
        title: its heading.
        facts: how it was made, by name; a mapping, such as of options, stands in one line, without what is None.
        grids: tables.
        notes: sentences below the tables.
        legend: lines that say what the columns mean, see `meanings`.
    """
    lines = [f"# {title}", ""]
    for name, fact in facts.items():
        if isinstance(fact, Mapping):
            fact = ", ".join(f"{one_line(k)} {option_text(v)}" for k, v in fact.items() if v is not None) or "none"
        lines.append(f"- {name}: {fact if isinstance(fact, int) else code_span(fact)}")
    for grid in grids:
        lines += ["", f"## {markdown(grid.title)}", "", *markdown_table(grid)]
        lines += ["", markdown(grid.caption)] if grid.caption else []
    lines += ["", "## Notes", "", *(f"- {markdown(note)}" for note in notes)] if notes else []
    return "\n".join([*lines, "", "## What the metrics mean", "", *legend]) + "\n"
