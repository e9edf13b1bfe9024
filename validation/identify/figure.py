"""The picture of a search: its course, what it found within its bounds, and the paths that this leads to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ssmr.types import FloatArray
from validation.identify.found import FittedParameter, SearchReport
from validation.report import drawing
from validation.report.drawing import ALARM, QUIET, Dashes, Ink, Row
from validation.words import shortened

_LEAST_IN, _STRIP_IN, _STRIPS_IN = 2.7, 0.52, 0.8  # height of the first row; of a strip, and what their panel needs besides
_PATHS_IN, _ABREAST, _MOST_PATHS = 3.1, 4, 12  # height of a row of paths, panels in it, and panels in all


class Line(NamedTuple):
    """A path of (M, 2) positions [m], its name for the legend, its looks, and whether the robot was lost at its end."""

    name: str
    xy: FloatArray
    ink: Ink
    width: float = drawing.NARROW
    dashes: Dashes = "solid"
    lost: bool = False


class Paths(NamedTuple):
    """The paths along one source, the lowest one first, with its name, and what is said of them below it."""

    title: str
    text: str
    lines: Sequence[Line]
    held_out: bool


def search_figure(
    found: SearchReport, ink: Ink, before: str, paths: Sequence[Paths] = (), rows: Sequence[Row] = ()
) -> Figure:
    """Draw a search, 1600 px wide: course, values within their bounds, paths, further rows, notes and footer.

    Args:
        found: the report.
        ink: colour of what was found.
        before: name of the values of before.
        paths: panels of paths; those that find no room are left out.
        rows: further rows of panels.
    """
    height = max(_LEAST_IN, _STRIPS_IN + _STRIP_IN * len(found.parameters))
    first = ((0.36, partial(_draw_course, found, ink)), (0.64, partial(_draw_strips, found, ink, before)))
    versions = (f"{name} {found.versions[name]}" for name in ("ssmr-testbed", "mujoco", "numpy"))
    page = [
        drawing.text_row(0.3, partial(drawing.draw_section, shortened(found.title, 110))),
        drawing.text_row(0.25, partial(drawing.draw_footer, found.effort)),
        Row(height, first),
        *_path_rows(paths[:_MOST_PATHS]),
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


def legend_row(lines: Mapping[str, Line2D]) -> Row:
    """Return a row with the legend of some lines."""

    def draw(ax: Axes) -> None:
        ax.set_axis_off()
        drawing.line_legend(ax, list(lines.values()), list(lines))

    return drawing.text_row(0.3, draw)


def _path_rows(paths: Sequence[Paths]) -> list[Row]:
    """Return panels of paths side by side, below one legend."""
    lines = {a.name: Line2D([], [], color=a.ink, linewidth=a.width, linestyle=a.dashes) for p in paths for a in p.lines}
    rows = [legend_row(lines)] if lines else []
    for k in range(0, len(paths), _ABREAST):
        rows.append(drawing.side_by_side(_PATHS_IN, [partial(_draw_paths, each) for each in paths[k : k + _ABREAST]]))
    return rows


def _draw_paths(paths: Paths, ax: Axes) -> None:
    """Draw the paths along one source."""
    drawing.inset(ax, above=0.3)
    for line in paths.lines:
        ax.plot(*line.xy.T, color=line.ink, linewidth=line.width, linestyle=line.dashes, gid=line.name)
        if line.lost and len(line.xy):
            drawing.draw_loss(ax, line.xy[-1, 0], line.xy[-1, 1], f"{line.name} lost")
    drawing.draw_ring(ax, *map(float, paths.lines[0].xy[0]))
    drawing.equal_scales(ax, 0.6)
    ax.locator_params(nbins=5)
    ax.set(xlabel="x [m]", ylabel="y [m]", label="held out" if paths.held_out else "train")
    drawing.narrow(ax.set_title(paths.title, pad=19.0, fontsize=10.0), 2.9)
    ax.annotate(paths.text, (0.0, 1.0), (0.0, 5.0), xycoords="axes fraction", textcoords="offset points", fontsize=8.5,
                color=QUIET)  # fmt: skip
    if paths.held_out:
        drawing.corner_note(ax, "held out")
