"""The picture of a contact study: settings as rows, measures as columns, the redder the worse."""

from __future__ import annotations

import math
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from validation.report.drawing import ALARM, QUIET, Row, draw_footer, note_rows, put_together, text_row
from validation.report.palette import Rgb, mix
from validation.study.contact.result import ContactStudy
from validation.study.contact.variants import BASELINE
from validation.study.measured import MeasureColumn, Tried

_GOOD: Rgb = (255, 255, 255)
_BAD: Rgb = (213, 94, 0)
"""Colours of a good and of a bad cell: red, green, blue, 0-255."""

_HEADER_IN, _NAMES_IN, _ROW_IN, _GAP_IN, _FOOTER_IN = 0.62, 0.75, 0.235, 0.09, 0.26
_LABEL_IN = 3.3
"""Distance of the numbers from the left edge."""


def badness(column: MeasureColumn, value: float | None) -> float | None:
    """Return where a value lies between its column's limits, on a logarithmic scale from 0 (good) to 1 (bad).

    None where the column is not judged, or there is no value.
    """
    if column.limits is None or value is None:
        return None
    good, bad = column.limits
    return min(max(math.log(max(abs(value), 1e-300) / good) / math.log(bad / good), 0.0), 1.0)


def _heights(study: ContactStudy) -> list[tuple[float, Tried]]:
    """Return the distance of each row's middle from the top of the table [in]."""
    found, y = [], 0.0
    for tried in study.by_group().values():
        for outcome in tried:
            found.append((y + 0.5 * _ROW_IN, outcome))
            y += _ROW_IN
        y += _GAP_IN
    return found


def _draw_table(study: ContactStudy, ax: Axes) -> None:
    ax.set_axis_off()
    figure = ax.get_figure(root=True)
    assert figure is not None
    size, box = figure.get_size_inches(), ax.get_position()
    wide, tall = float(box.width * size[0]), float(box.height * size[1])
    ax.set(xlim=(0.0, wide), ylim=(tall, 0.0))
    each = (wide - _LABEL_IN) / max(len(study.columns()), 1)
    for k, column in enumerate(study.columns()):
        words = column.name.replace(" ", "\n") + f"\n[{column.unit.symbol}]"
        middle = _LABEL_IN + (k + 0.5) * each
        ax.text(middle, _NAMES_IN - 0.05, words, ha="center", va="bottom", fontsize=8.0, linespacing=1.05)
    last = ""
    for below, outcome in _heights(study):
        y, variant = _NAMES_IN + below, outcome.variant
        baseline = variant == BASELINE
        weight = "bold" if baseline else "normal"
        if variant.group != last:
            ax.text(0.0, y, variant.group, va="center", fontsize=9.5, fontweight="bold", wrap=False)
            ax.plot([0.0, wide], [y - 0.5 * _ROW_IN - 0.5 * _GAP_IN] * 2, color="0.8", linewidth=0.6)
            last = variant.group
        ax.text(_LABEL_IN - 0.06, y, variant.name, va="center", ha="right", fontsize=9.5, fontweight=weight)
        for k, column in enumerate(study.columns()):
            bad = badness(column, column.value(outcome.measures))
            left = _LABEL_IN + k * each
            if bad is not None:
                fill = [value / 255.0 for value in mix(_GOOD, _BAD, bad)]
                ax.add_patch(
                    Rectangle((left, y - 0.5 * _ROW_IN), each, _ROW_IN, facecolor=fill, edgecolor="white", linewidth=0.7)
                )
            ax.text(left + 0.5 * each, y, column.text(outcome.measures), va="center", ha="center", fontsize=9.5,
                    fontweight=weight, gid=f"{variant.key}, {column.name}", color="0.1")  # fmt: skip
        if outcome.failures:
            ax.text(_LABEL_IN - 0.02, y, "!", va="center", ha="center", fontsize=8.0, fontweight="bold", color=ALARM)
        if baseline:
            ax.add_patch(Rectangle((0.0, y - 0.5 * _ROW_IN), wide, _ROW_IN, fill=False, edgecolor="0.1", linewidth=1.1))


def _draw_header(study: ContactStudy, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "What physics settings do to a simulated robot", transform=ax.transAxes, fontsize=14.0,
            fontweight="bold", va="top")  # fmt: skip
    ax.text(0.0, 0.5, f"{study.heading()} · shipped settings (framed), then one change at a time, then several", va="top",
            transform=ax.transAxes, color="0.25")  # fmt: skip
    ax.text(0.0, 0.14, "white: good · the redder, the worse (logarithmic scale) · –: could not be measured · !: see notes",
            transform=ax.transAxes, va="top", fontsize=8.5, color=QUIET)  # fmt: skip


def draw_contact(study: ContactStudy) -> Figure:
    """Draw every measure of every variant, 1600 px wide."""
    below = _heights(study)[-1][0] + 0.5 * _ROW_IN
    rows = [
        text_row(_HEADER_IN, partial(_draw_header, study)),
        Row(0.1, ()),
        text_row(_NAMES_IN + below + 0.1, partial(_draw_table, study)),
        *note_rows(study.notes()),
        text_row(_FOOTER_IN, partial(draw_footer, study.made_by)),
    ]
    return put_together(rows)
