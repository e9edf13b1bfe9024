"""The picture of a replication: how many rows of each section have which verdict."""

from __future__ import annotations

from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation.show.drawing import draw_section, inset, put_together, side_by_side, text_row
from validation.show.tables import Grid

_INKS = {"agrees": "#5fb894", "nearer": "#7fb0e6", "differs": "#e8935c", "not compared": "#c8c8ce"}
"""Colours of the verdicts: those of the HTML page, a little darker."""


def _draw_bars(summary: Grid, ax: Axes) -> None:
    rows = [row for group in summary.groups for row in group]
    left = [0.0] * len(rows)
    for column, (status, _) in enumerate(summary.header[1:], 1):
        counts = [float(row[column].text) for row in rows]
        ax.barh(range(len(rows)), counts, left=left, color=_INKS.get(status, "0.5"), label=status)
        left = [start + count for start, count in zip(left, counts, strict=True)]
    inset(ax, left=3.2)
    ax.set_yticks(range(len(rows)), [row[0].text for row in rows], fontsize=9.0)
    ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="rows that the thesis prints")
    ax.legend(loc="lower right", frameon=False)


def draw_summary(summary: Grid) -> Figure:
    """Draw the summary of a replication as bars, 1600 px wide."""
    rows = sum(map(len, summary.groups))
    heading = text_row(0.35, partial(draw_section, summary.title))
    return put_together([heading, side_by_side(0.8 + 0.3 * rows, [partial(_draw_bars, summary)])])
