"""Parts of all pictures: inks, markers, rows of panels.

Everything is drawn by matplotlib's objects under a style of its own (style.mplstyle): no pyplot,
and no setting outlives a call.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import matplotlib.style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from ssmr.metrics.windows import HorizonErrors, OverlappingErrors
from ssmr.types import FloatArray
from validation.report.palette import BLACK, colour, mix
from validation.simulator.terrain import FLAT, Terrain
from validation.store import write_atomic
from validation.words import shortened

# A figure is 1600 px wide.
WIDTH_IN = 12.8
DPI = 125
EDGE_IN = 0.12
MARGINS_IN = (0.66, 0.12, 0.52, 0.3)  # left, right, below and above a panel, for its labels
STYLE = Path(__file__).with_name("style.mplstyle")

Dashes = Literal["solid"] | tuple[float, tuple[float, ...]]
Panel = Callable[[Axes], None]
Ink = str | tuple[float, float, float]

BROAD = 2.6
NARROW = 1.5
QUIET = "0.4"
ALARM = "#b00020"
DASHED: Dashes = (0.0, (4.0, 1.8))
BESIDE_INK: Ink = "0.45"
"""Ink of the baseline of a result: the plant before a fit, or the gains before a tuning."""
REFERENCE_INK: Ink = "0.1"
REFERENCE_DASHES: Dashes = (0.0, (5.0, 2.5))
"""Ink of the reference that a controller follows."""
_SECTION_IN = 0.3  # height of a heading
_LINE_IN = 0.185  # height of a line of notes
_WRAP = 160  # most characters in such a line


def ink_of(name: str) -> tuple[float, float, float]:
    """Return a plant's colour for lines on white: a little darker than for surfaces."""
    red, green, blue = mix(colour(name), BLACK, 0.1)
    return red / 255.0, green / 255.0, blue / 255.0


def joined(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """(M,) abscissae and (M, ...) ordinates of all pieces, with a NaN where the line breaks."""
    if not parts:
        return np.empty(0), np.empty(0)
    xs = list[FloatArray]()
    ys = list[FloatArray]()
    for x, y in parts:
        xs += [x, np.array([np.nan])]
        ys += [y, np.full((1, *y.shape[1:]), np.nan)]
    return np.concatenate(xs[:-1]), np.concatenate(ys[:-1])


# --- marks in a panel ---


def draw_dart(ax: Axes, pose: FloatArray, name: str, size: float) -> None:
    """Draw a triangle in a plant's colour that points along a pose (x, y [m], yaw [rad])."""
    ax.plot(
        *pose[:2],
        marker=(3, 0, math.degrees(pose[2]) - 90.0),
        markersize=size,
        color=ink_of(name),
        markeredgecolor="white",
        markeredgewidth=0.6,
        zorder=4.0,
    )


def draw_ring(ax: Axes, x: float, y: float) -> None:
    """Draw a ring where motions start."""
    ax.plot(
        x,
        y,
        "o",
        markersize=8.0,
        markerfacecolor="white",
        markeredgecolor="0.1",
        markeredgewidth=1.5,
        zorder=3.5,
    )


def draw_ellipse(
    ax: Axes,
    middle: FloatArray,
    covariance: FloatArray,
    reach: float,
    ink: tuple[float, float, float],
) -> None:
    """Draw the ellipse of `reach` standard deviations about a (2,) position [m].

    The (2, 2) covariance is in m².
    """
    variances, axes = np.linalg.eigh(covariance)
    width, height = 2.0 * reach * np.sqrt(np.maximum(variances, 0.0))
    angle = math.degrees(math.atan2(axes[1, 0], axes[0, 0]))
    centre = (float(middle[0]), float(middle[1]))
    ax.add_patch(Ellipse(centre, width, height, angle=angle, color=ink, alpha=0.13))


def equal_scales(ax: Axes, smallest: float) -> None:
    """Give a panel equal scales that show all data and at least `smallest` [m] each way."""
    ax.margins(0.09)
    ax.autoscale_view()
    for limits, set_limits in ((ax.get_xlim(), ax.set_xlim), (ax.get_ylim(), ax.set_ylim)):
        low, high = limits
        spare = max(0.0, 0.5 * (smallest - (high - low)))
        set_limits(low - spare, high + spare, auto=True)  # which equal scales may widen
    ax.set_aspect("equal", adjustable="datalim")


def at_least(ax: Axes, reach: float) -> None:
    """Widen the ordinate to show at least `reach`: rounding errors are not to fill a panel."""
    low, high = ax.get_ylim()
    spare = max(0.0, 0.5 * (reach - (high - low)))
    ax.set_ylim(low - spare, high + spare)


def corner_note(ax: Axes, text: str, ink: str = QUIET) -> None:
    """Write a remark in a panel's corner."""
    ax.text(
        0.995,
        0.02,
        text,
        transform=ax.transAxes,
        ha="right",
        va="bottom",
        fontsize=8.5,
        color=ink,
        zorder=6.0,
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0},
    )


def plain_ticks(axis: Axis, subs: Sequence[float] = (1.0,)) -> None:
    """Mark these multiples of every power of ten on a logarithmic axis, in plain numbers."""
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_header(
    ax: Axes, title: str, handles: Sequence[Artist], labels: Sequence[str], ink: str = "0.0"
) -> None:
    """Write a picture's title, and below it the legend in one line, as small as it must be."""
    ax.set_axis_off()
    ax.text(
        0.0,
        1.0,
        title,
        transform=ax.transAxes,
        fontsize=14.0,
        fontweight="bold",
        va="top",
        color=ink,
    )
    for size in (9.5, 9.0, 8.5, 8.0, 7.5, 7.0):
        legend = ax.legend(
            handles,
            labels,
            loc="lower left",
            bbox_to_anchor=(0.0, 0.0),
            ncols=len(labels),
            frameon=False,
            fontsize=size,
            borderaxespad=0.0,
            borderpad=0.0,
            handlelength=2.8,
            columnspacing=1.4,
            handletextpad=0.6,
        )
        if legend.get_window_extent().width <= ax.get_window_extent().width:
            break


def narrow(text: Text, most: float) -> None:
    """Shorten a text that is wider than `most` [in]: its end says more than its beginning."""
    whole = text.get_text()
    figure = text.get_figure(root=True)
    assert figure is not None
    n = len(whole)
    while text.get_window_extent().width / figure.dpi > most and n > 2:
        n -= 1
        text.set_text(f"…{whole[1 - n :]}")


# --- errors by horizon ---


@dataclass(frozen=True, eq=False)
class HorizonMarks:
    """Somebody's errors by horizon, and how they look."""

    name: str
    ink: Ink
    marker: str
    errors: Mapping[float, HorizonErrors]
    """Errors by horizon [s]; not empty."""
    overlapping: Mapping[float, OverlappingErrors] = field(default_factory=dict)
    """Medians over overlapping windows with their intervals, by horizon [s]."""


def draw_horizons(
    marks: Sequence[HorizonMarks], what: Literal["position", "yaw"], ax: Axes
) -> None:
    """Draw median errors by horizon with their intervals, and bars to the 95th percentiles."""
    scale = 1.0 if what == "position" else math.degrees(1.0)
    unit = "m" if what == "position" else "deg"
    ending = "m" if what == "position" else "rad"

    def values(errors: Sequence[object], name: str) -> FloatArray:
        return scale * np.array([getattr(e, f"{what}_{name}_{ending}") for e in errors])

    horizons = sorted(set().union(*(each.errors for each in marks)))
    smallest = math.inf
    for k, each in enumerate(marks):
        aside = 0.4 * (2 * k + 1 - len(marks)) / len(marks)
        at = {h: horizons.index(h) + aside for h in each.errors}
        places = [*at.values()]
        errors = [*each.errors.values()]
        median = values(errors, "median")
        high = values(errors, "p95")
        ink = each.ink
        ax.vlines(places, median, high, colors=[ink], linewidth=2.5, zorder=2.5)
        ax.plot(places, high, "_", color=ink, markersize=9.0, markeredgewidth=2.5, zorder=2.5)
        ax.plot(
            places,
            median,
            each.marker,
            color=ink,
            markersize=8.0,
            markeredgecolor="white",
            zorder=3.0,
            gid=each.name,
        )
        smallest = min(smallest, float(median.min()))
        if shared := [h for h in each.errors if h in each.overlapping]:
            overlapping = [each.overlapping[h] for h in shared]
            low = values(overlapping, "low")
            most = values(overlapping, "high")
            middles = [at[h] for h in shared]
            ax.vlines(middles, low, most, colors=[ink], linewidth=9.0, alpha=0.3, zorder=2.2)
            smallest = min(smallest, float(low.min()))
    if smallest > 0.0:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
    ax.margins(y=0.15)
    ax.set_xticks(range(len(horizons)), [_horizon_label(h, marks) for h in horizons])
    ax.grid(visible=False, axis="x")
    title = f"{what.capitalize()} error [{unit}]: median, bar to 95 %"
    if any(each.overlapping for each in marks):
        title += "; pale: its 90 % interval"
    ax.set(title=title, xlim=(-0.55, len(horizons) - 0.45))


def _horizon_label(horizon: float, marks: Sequence[HorizonMarks]) -> str:
    counts = sorted({each.errors[horizon].n for each in marks if horizon in each.errors})
    count = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"{horizon:g} s\n{count} window{'s' * (count != '1')}"


# --- rows of panels ---


def inset(ax: Axes, left: float = 0.0, right: float = 0.0) -> None:
    """Give a panel more room beside it [in], taken from its own."""
    figure = ax.get_figure(root=True)
    box = ax.get_position()
    assert figure is not None
    total = figure.get_figwidth()
    width = box.width - (left + right) / total
    ax.set_position((box.x0 + left / total, box.y0, width, box.height))


def draw_section(text: str, ax: Axes) -> None:
    """Write a heading over a row of panels."""
    ax.set_axis_off()
    ax.text(0.0, 0.0, text, transform=ax.transAxes, fontsize=10.5, fontweight="bold", va="bottom")


def draw_footer(text: str, ax: Axes) -> None:
    """Write in one line how a result was made."""
    ax.set_axis_off()
    ax.text(0.0, 0.0, text, transform=ax.transAxes, fontsize=8.5, color=QUIET, va="bottom")


@dataclass(frozen=True)
class PanelRow:
    """Panels side by side."""

    height: float
    """[in], labels included."""
    panels: tuple[tuple[float, Panel], ...]
    """Each with its share of the width."""
    bare: bool = False
    """Texts only, which need no room for labels."""

    def place(self, figure: Figure, top: float) -> None:
        """Draw the panels, from `top` [in] above the figure's lower edge downwards."""
        left, right, bottom, above = (0.0, 0.0, 0.0, 0.0) if self.bare else MARGINS_IN
        wide, tall = figure.get_size_inches()
        x = EDGE_IN
        room = wide - 2.0 * EDGE_IN
        y = top - self.height + bottom
        height = self.height - bottom - above
        for share, panel in self.panels:
            width = share * room - left - right
            box = ((x + left) / wide, y / tall, width / wide, height / tall)
            panel(figure.add_axes(box))
            x += share * room


def side_by_side(height: float, panels: Sequence[Panel]) -> PanelRow:
    """Return a row of panels of equal width."""
    return PanelRow(height, tuple((1.0 / len(panels), panel) for panel in panels))


def text_row(height: float, panel: Panel) -> PanelRow:
    """Return a row without axes."""
    return PanelRow(height, ((1.0, panel),), bare=True)


def footer_row(
    profile: str, terrain: Terrain, words: Iterable[str], versions: Mapping[str, str]
) -> PanelRow:
    """A line that says how robots were driven: by which profile, ground and versions."""
    ground = [] if terrain == FLAT else [f"terrain {terrain.spec}"]
    used = [f"{name} {versions[name]}" for name in ("ssmr-testbed", "mujoco") if name in versions]
    parts = [f"profile {shortened(profile, 32)}", *words, *ground, *used]
    return text_row(0.22, partial(draw_footer, shortened(" · ".join(parts), 170)))


def note_rows(notes: Sequence[str]) -> list[PanelRow]:
    """Sentences below a heading, each behind a bullet, in as many lines as they need."""
    lines = list[str]()
    for note in notes:
        lines += textwrap.wrap(note, _WRAP, initial_indent="• ", subsequent_indent="   ")
    if not lines:
        return []

    def draw(ax: Axes) -> None:
        ax.set_axis_off()
        for k, line in enumerate(lines):
            y = 1.0 - (k + 0.5) / len(lines)
            ax.text(0.0, y, line, transform=ax.transAxes, fontsize=9.0, va="center", color="0.2")

    heading = text_row(_SECTION_IN, partial(draw_section, "Notes"))
    return [heading, text_row(0.08 + _LINE_IN * len(lines), draw)]


def put_together(rows: Sequence[PanelRow]) -> Figure:
    """Draw rows from top to bottom into a figure 1600 px wide.

    The figure is drawn once, so that its ticks have this style too; `save_figure` writes that
    drawing.
    """
    height = 2.0 * EDGE_IN + sum(row.height for row in rows)
    with matplotlib.style.context(["default", STYLE]):
        figure = Figure(figsize=(WIDTH_IN, height), dpi=DPI)
        FigureCanvasAgg(figure)
        top = float(figure.get_size_inches()[1]) - EDGE_IN
        for row in rows:
            row.place(figure, top)
            top -= row.height
        figure.canvas.draw()
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all; the path's suffix says the format (.png, .svg, .pdf).

    Raises:
        ValueError: the format is unknown; nothing is written.
        OSError: the file cannot be written.
    """
    canvas = figure.canvas
    if path.suffix.lower() == ".png" and isinstance(canvas, FigureCanvasAgg) and not figure.stale:
        pixels = Image.fromarray(np.asarray(canvas.buffer_rgba()))
        resolution = (figure.dpi, figure.dpi)
        write_atomic(path, lambda part: pixels.save(part, dpi=resolution, compress_level=1))
        return
    with matplotlib.style.context(["default", STYLE]):
        write_atomic(path, lambda temporary: figure.savefig(temporary, dpi=figure.dpi))
