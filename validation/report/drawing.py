"""Parts of all pictures: inks, markers, rows of panels.

Everything is drawn by matplotlib's objects under a style of its own (style.mplstyle): no pyplot,
and no setting outlives a call. matplotlib is imported where something is drawn: it takes a third of
the time that a program needs to start.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ssmr.metrics.windows import OverlappingErrors
from ssmr.types import FloatArray
from validation.output import abridge_text, shorten_text
from validation.report.columns import DEGREES, METRES
from validation.report.palette import BLACK, WHITE, mix_colours, plant_colour, spell_name
from validation.simulator.terrain import FLAT, Terrain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

# A figure is 1600 px wide.
_WIDTH_IN = 12.8
_DPI = 125
_EDGE_IN = 0.12

Dashes = Literal["solid"] | tuple[float, tuple[float, ...]]
Panel = Callable[["Axes"], None]
Ink = str | tuple[float, float, float]
Look = Mapping[str, Any]
"""Properties of a line, a text or a legend, as matplotlib names them."""
Curve = tuple[FloatArray, FloatArray, Look]
"""Abscissae and ordinates of a line, and how it looks; a NaN breaks it."""

BROAD = 2.6
NARROW = 1.5
QUIET = "0.4"
ALARM = "#b00020"
DASHED: Dashes = (0.0, (4.0, 1.8))
BESIDE_INK: Ink = "0.45"
"""Ink of the baseline of a result: the plant before a fit, or the gains before a tuning."""
REFERENCE_LOOK: Look = {
    "color": "0.1",
    "linewidth": 1.0,
    "linestyle": (0.0, (5.0, 2.5)),
    "zorder": 2.8,
    "gid": "reference",
}
"""Line of the reference that a controller follows."""
_TITLE_IN = 0.42  # height of a title
_FOOT_IN = 0.26  # height of the line below all
_LINE_IN = 0.185  # height of a line of words
_WRAP = 160  # most characters in such a line
_KEY_IN = 0.75  # width of an entry of a legend without its words
_CHARACTER_IN = 0.077  # width of a character there
_TITLE = {"fontsize": 14.0, "fontweight": "bold"}
_HEADING = {"fontsize": 10.5, "fontweight": "bold"}
KEY: Look = {
    "frameon": False,
    "fontsize": 9.0,
    "borderaxespad": 0.4,
    "handlelength": 2.8,
    "columnspacing": 1.4,
}
"""Look of a legend."""


def ink_of(name: str, pale: float = 0.0) -> tuple[float, float, float]:
    """Return a plant's colour for lines on white: a little darker than for surfaces.

    What was before is `pale`, by a share of 0 to 1 of the way to white.
    """
    dark = mix_colours(plant_colour(name), BLACK, 0.1)
    red, green, blue = mix_colours(dark, WHITE, pale)
    return red / 255.0, green / 255.0, blue / 255.0


# --- marks in a panel ---


def key_line(label: str = "", **look: Any) -> Line2D:
    """Return a line that a legend shows."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **look)


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
    from matplotlib.patches import Ellipse

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


def draw_curves(curves: Iterable[Curve], least: float, ax: Axes, **settings: Any) -> None:
    """Draw lines in a panel that shows at least `least` of the ordinate; `settings` are its own.

    Rounding errors are not to fill a panel.
    """
    for x, y, look in curves:
        ax.plot(x, y, **look)
    ax.set(**settings)
    low, high = ax.get_ylim()
    spare = max(0.0, 0.5 * (least - (high - low)))
    ax.set_ylim(low - spare, high + spare)


def draw_paths(
    curves: Sequence[Curve], ends: Mapping[str, FloatArray], smallest: float, ax: Axes
) -> None:
    """Draw paths from the ring at their start to darts in the colours of the plants.

    Args:
        curves: the paths; the first one is that of the reference.
        ends: (3,) pose of each plant at its path's end, by name.
        smallest: least extent of the panel [m].
        ax: the panel, which gets equal scales.
    """
    for x, y, look in curves:
        ax.plot(x, y, **look)
    x, y, _ = curves[0]
    ax.plot(x[0], y[0], "o", ms=8.0, mfc="white", mec="0.1", mew=1.5, zorder=3.5)
    for name, (*place, yaw) in ends.items():
        dart = (3, 0, math.degrees(yaw) - 90.0)
        ax.plot(*place, marker=dart, ms=12.0, color=ink_of(name), mec="white", mew=0.6, zorder=4.0)
    equal_scales(ax, smallest)


def plain_ticks(axis: Axis, subs: Sequence[float] = (1.0,)) -> None:
    """Mark these multiples of every power of ten on a logarithmic axis, in plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


# --- errors by horizon ---


HorizonMarks = tuple[Mapping[float, OverlappingErrors], Look]
"""Medians over windows that begin every second, with their intervals, by horizon [s], not empty;
and how they look: `label`, `color` and `marker`."""


def draw_horizons(
    marks: Sequence[HorizonMarks], what: Literal["position", "yaw"], ax: Axes
) -> None:
    """Draw median errors by horizon, each in the band of its 90 % interval."""
    unit, ending = (METRES, "m") if what == "position" else (DEGREES, "rad")
    horizons = sorted(set().union(*(errors for errors, _ in marks)))
    for k, (errors, look) in enumerate(marks):
        aside = 0.8 * ((k + 0.5) / len(marks) - 0.5)
        places = [horizons.index(h) + aside for h in errors]
        median, low, high = (
            [unit.scale * getattr(e, f"{what}_{part}_{ending}") for e in errors.values()]
            for part in ("median", "low", "high")
        )
        ax.vlines(places, low, high, colors=[look["color"]], linewidth=9.0, alpha=0.3, zorder=2.2)
        ax.plot(
            places,
            median,
            linestyle="none",
            markersize=8.0,
            markeredgecolor="white",
            zorder=3.0,
            gid=look["label"],
            **look,
        )
    if ax.dataLim.ymin > 0.0:
        ax.set_yscale("log")
        plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))
    ax.margins(y=0.15)
    ax.set_xticks(range(len(horizons)), [_horizon_label(h, marks) for h in horizons])
    ax.grid(visible=False, axis="x")
    title = f"{what.capitalize()} error [{unit.symbol}]: median, in its 90 % interval"
    ax.set(title=title, xlim=(-0.55, len(horizons) - 0.45))


def _horizon_label(horizon: float, marks: Sequence[HorizonMarks]) -> str:
    counts = sorted({errors[horizon].n for errors, _ in marks if horizon in errors})
    count = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"{horizon:g} s\n{count} window{'s' * (count != '1')}"


# --- pages ---


@dataclass(frozen=True)
class PanelRow:
    """Panels side by side."""

    height: float
    """[in], labels included."""
    panels: Sequence[Panel]
    """Functions that each draw into axes."""
    shares: Sequence[float] | None = None
    """Shares of the width; equal ones if not given."""
    heading: str = ""
    """Words over all of them."""


_LONGEST_TITLE = 105
"""Characters that the width has room for."""


def draw_page(
    title: str,
    rows: Sequence[PanelRow],
    *,
    legend: Sequence[Line2D] = (),
    notes: Sequence[str] = (),
    foot: str = "",
    ink: str = "0.0",
) -> Figure:
    """Draw rows of panels from top to bottom into a figure 1600 px wide.

    The figure is drawn once, so that its ticks have this style too; `png_of` gives that drawing.

    Args:
        title: its heading.
        rows: rows of panels, each as high as it says.
        legend: lines with their labels, below the title.
        notes: sentences below the panels, each behind a bullet.
        foot: how it was made, in one line below all.
        ink: colour of the title.
    """
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from validation.report.picture import STYLE, WORDS, Picture

    labels = [str(line.get_label()) for line in legend]
    longest = max((len(line) for label in labels for line in label.split("\n")), default=1)
    across = max(1, min(len(labels), int(_WIDTH_IN / (_KEY_IN + _CHARACTER_IN * longest))))
    lines_of_label = max((1 + label.count("\n") for label in labels), default=0)
    deep = math.ceil(len(labels) / across) * lines_of_label
    text = "\n".join(map(_wrap_note, notes))
    below = _LINE_IN * (text.count("\n") + 2.2) if notes else 0.0
    heights = [_TITLE_IN + _LINE_IN * deep, *(row.height for row in rows)]
    with matplotlib.style.context(["default", STYLE]):
        tall = sum(heights) + below + _FOOT_IN
        layout = ConstrainedLayoutEngine()
        figure = Picture(figsize=(_WIDTH_IN, tall), dpi=_DPI, layout=layout)
        FigureCanvasAgg(figure)
        heights.append(below + _FOOT_IN)
        head, *parts, tail = figure.subfigures(
            len(heights), 1, height_ratios=heights, squeeze=False
        ).flat
        edge = _EDGE_IN / _WIDTH_IN
        heading = abridge_text(spell_name(title), _LONGEST_TITLE)
        y = 1.0 - _EDGE_IN / heights[0]
        head.text(edge, y, heading, va="top", color=ink, gid=WORDS, **_TITLE)
        if legend:
            head.legend(handles=legend, loc="lower left", ncols=across, **KEY)
        for part, row in zip(parts, rows, strict=True):
            if row.heading:
                part.suptitle(row.heading, x=edge, ha="left", **_HEADING)
            axes = part.subplots(1, len(row.panels), width_ratios=row.shares, squeeze=False)
            for ax, panel in zip(axes.flat, row.panels, strict=True):
                panel(ax)
        if notes:
            tail.text(edge, 1.0, "Notes", va="top", gid=WORDS, **_HEADING)
            top = 1.0 - 1.3 * _LINE_IN / heights[-1]
            look = {"fontsize": 9.0, "linespacing": 1.35, "color": "0.2"}
            tail.text(edge, top, text, va="top", gid=WORDS, **look)
        y = 0.06 / heights[-1]
        tail.text(edge, y, foot, fontsize=8.5, color=QUIET, va="bottom", gid=WORDS)
        layout.execute(figure)
        # the layout's solver errs by rounding, and equal reports are to give equal pixels
        figure.set_layout_engine("none")
        for ax in figure.axes:
            left, lower, width, height = np.round(ax.get_position().bounds, 6)
            ax.set_position((left, lower, width, height))
        figure.canvas.draw()
    return figure


def _wrap_note(note: str) -> str:
    return textwrap.fill(note, _WRAP, initial_indent="• ", subsequent_indent="   ")


def how_driven(
    profile: str, terrain: Terrain, words: Iterable[str], versions: Mapping[str, str]
) -> str:
    """Return a line that says how robots were driven: by which profile, ground and versions."""
    ground = [] if terrain == FLAT else [f"terrain {terrain.spec}"]
    used = [f"{name} {versions[name]}" for name in ("ssmr-testbed", "mujoco") if name in versions]
    parts = [f"profile {shorten_text(profile, 32)}", *words, *ground, *used]
    return shorten_text(" · ".join(parts), 170)
