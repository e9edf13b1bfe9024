"""The picture of a search: its course, and what it found within its bounds."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ssmr.types import FloatArray
from validation.identify.found import FittedParameter, SearchReport
from validation.report import drawing
from validation.report.drawing import ALARM, QUIET, Ink, Row
from validation.words import shortened

_LEAST_IN, _STRIP_IN, _STRIPS_IN = 2.7, 0.52, 0.8  # height of the first row; of a strip, and what their panel needs besides


def search_figure(found: SearchReport, ink: Ink, before: str, rows: Sequence[Row] = ()) -> Figure:
    """Draw a search, 1600 px wide: course, values within their bounds, further rows, notes and footer.

    Args:
        found: the report.
        ink: colour of what was found.
        before: name of the values of before.
        rows: further rows of panels.
    """
    height = max(_LEAST_IN, _STRIPS_IN + _STRIP_IN * len(found.parameters))
    first = ((0.36, partial(_draw_course, found, ink)), (0.64, partial(_draw_strips, found, ink, before)))
    versions = (f"{name} {found.versions[name]}" for name in ("ssmr-testbed", "mujoco", "numpy"))
    page = [
        drawing.text_row(0.3, partial(drawing.draw_section, shortened(found.title, 110))),
        drawing.text_row(0.25, partial(drawing.draw_footer, found.effort)),
        Row(height, first),
        *rows,
        *drawing.note_rows(found.notes()),
        drawing.text_row(0.26, partial(drawing.draw_footer, " · ".join([f"seed {found.document['seed']}", *versions]))),
    ]
    return drawing.put_together(page)


def _draw_course(found: SearchReport, ink: Ink, ax: Axes) -> None:
    """Draw best and median cost, generation by generation."""
    curves = {"median": (found.course.median_cost, "0.6"), "best": (found.course.best_cost, ink)}
    for name, (costs, colour) in curves.items():
        shown = np.where(np.isfinite(costs), costs, np.nan)
        ax.plot(np.arange(len(costs)), shown, color=colour, marker="o", markersize=2.5, label=name, gid=name)
    known = [cost for costs, _ in curves.values() for cost in costs if np.isfinite(cost)]
    if min(known) > 0.0 and max(known) > 10.0 * min(known):
        ax.set_yscale("log")
        drawing.plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    ax.legend(loc="best", fontsize=8.5, framealpha=0.9, edgecolor="none")
    ax.set(title="Cost by generation", xlabel="generation")


def _draw_strips(found: SearchReport, ink: Ink, before: str, ax: Axes) -> None:
    """Draw the parameters within their bounds, a strip each."""
    drawing.inset(ax, left=1.3, right=1.0)
    ax.set(xlim=(0.0, 1.0), ylim=(len(found.parameters) - 0.45, -0.6), xticks=[], title="Values within their bounds")
    ax.set_yticks(range(len(found.parameters)), [p.name for p in found.parameters])
    ax.tick_params(length=0.0, pad=46.0)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)
    said = f"dot: found · bar: 95 % interval · tick: {before} · grey: last generation"
    ax.annotate(said, (0.0, 0.0), (0.0, -4.0), xycoords="axes fraction", textcoords="offset points", va="top", fontsize=8.5,
                color=QUIET, annotation_clip=False)  # fmt: skip
    members = found.course.jde.population[np.isfinite(found.course.jde.costs)]
    for row, p in enumerate(found.parameters):
        _draw_strip(p, row, members[:, row], ink, ax)


def _draw_strip(p: FittedParameter, row: int, members: FloatArray, ink: Ink, ax: Axes) -> None:
    """Draw one parameter: bounds, population, interval, value and earlier value."""
    ink = ALARM if p.at_bound else ink
    ax.plot([0.0, 1.0], [row, row], color="0.75", linewidth=1.2, marker="|", markersize=10.0, clip_on=False)
    ax.plot(members, np.full(len(members), row), "o", color="0.55", markersize=3.0, alpha=0.45, clip_on=False)
    if p.interval_95 is not None:
        ends = np.clip([p.share(end) for end in p.interval_95], 0.0, 1.0)
        ax.plot(ends, [row, row], color=ink, linewidth=5.0, alpha=0.4, solid_capstyle="butt", clip_on=False)
    was, x = (min(max(p.share(value), 0.0), 1.0) for value in (p.before, p.value))
    ax.plot(was, row, "|", color="0.1", markersize=13.0, markeredgewidth=1.6, clip_on=False, gid=f"before {p.name}")
    ax.plot(x, row, "o", color=ink, markersize=8.5, markeredgecolor="white", zorder=3.5, clip_on=False, gid=p.name)
    error = "" if p.standard_error is None else f" ± {p.standard_error:.2g}"
    unit = "" if p.unit == "1" else f" {p.unit}"
    beside = f"{p.value:.4g}{error}{unit}{f' · {p.warning}' if p.warning else ''}"
    for text, at, away, align in (
        (beside, x, (0.0, 7.0), "left" if x < 0.3 else "right" if x > 0.7 else "center"),
        (f"{p.lower:.4g}", 0.0, (-7.0, -3.0), "right"),
        (f"{p.upper:.4g}{unit}", 1.0, (7.0, -3.0), "left"),
    ):
        colour = ALARM if p.warning and text == beside else "0.2"
        ax.annotate(text, (at, row), away, textcoords="offset points", ha=align, fontsize=8.5, color=colour,
                    annotation_clip=False)  # fmt: skip
