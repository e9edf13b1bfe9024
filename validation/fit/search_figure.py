"""Pictures of a search that fits and tunings have in common: its course, and what it found within its bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ssmr.types import FloatArray
from validation.fit.data import FittedParameter, SearchData
from validation.fit.table import STOPPED, effort, ending, flags, unit_text, value_text
from validation.report import drawing
from validation.report.drawing import ALARM, BESIDE_INK, DASHED, QUIET, Ink, Panel, Row
from validation.report.tables import option_text, shortened

_BESIDE = 6
"""Up to this many parameters, the correlations stand beside them, row by row; else below the convergence."""
_LEAST_CELL_IN = 0.3
"""Least size of a cell of correlations that has room for a number [in]."""
_DECADE = 10.0
"""Costs that span a greater ratio are drawn on a logarithmic scale."""
_CONVERGENCE_IN, _STRIP_IN, _STRIPS_IN = 2.7, 0.52, 0.95  # a strip's height; what their panel needs besides them
_CHARACTER_IN = 0.076  # width of a usual character at 9.5 points
_HEADER_IN, _GAP_IN, _FOOTER_IN = 0.84, 0.1, 0.26
_HEADING_IN = 9.3  # width of the heading at most
_DOUBT = "#8a5a00"


def draw_title(result: SearchData, lead: str, title: str, about: str, ax: Axes) -> None:
    """Draw the title, how the search ended, and a line about it."""
    ax.set_axis_off()
    heading = ax.text(0.0, 1.0, f"{lead}{title}", transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    drawing.narrow(heading, _HEADING_IN, lead)
    finished = result.status == "finished"
    ax.text(1.0, 1.0, ending(result), transform=ax.transAxes, ha="right", va="top", fontsize=10.5,
            fontweight="normal" if finished else "bold", color=QUIET if finished else ALARM)  # fmt: skip
    ax.text(0.0, 0.64, shortened(f"{effort(result)} · {about}", 150), transform=ax.transAxes, va="top", color="0.25")


@dataclass(frozen=True, eq=False)
class SearchLooks:
    """A search, with the words and colours that it is drawn with."""

    result: SearchData
    ink: Ink
    """Colour of the values that were found."""
    what: str
    """Name of the values: `Parameters` or `Gains`."""
    before: str
    """Name of the earlier values, such as `baseline`."""
    correlation: FloatArray | None = None
    """(n, n) correlation of the values' errors; None where it was not estimated."""
    before_cost: float = math.inf
    """Cost of the earlier values; not drawn where it is infinite."""

    @property
    def numbered(self) -> bool:
        """Return whether correlations refer to the parameters by their numbers."""
        return self.correlation is not None and len(self.result.parameters) > 1


def _draw_convergence(looks: SearchLooks, ax: Axes) -> None:
    """Draw best and median cost, generation by generation."""
    result = looks.result
    best, median = result.trace.best_cost, result.trace.median_cost
    level = np.full(1, looks.before_cost)
    known = np.concatenate([c[np.isfinite(c)] for c in (best, median, level)])
    marker = "o" if len(best) < 3 else ""
    for costs, ink, name, width in ((median, "0.6", "median", 1.2), (best, looks.ink, "best", 2.0)):
        shown = np.where(np.isfinite(costs), costs, np.nan)
        ax.plot(np.arange(len(costs)), shown, color=ink, linewidth=width, marker=marker, label=name, gid=name)
    if np.isfinite(level[0]):
        ax.axhline(level[0], color=BESIDE_INK, linewidth=1.1, linestyle=DASHED, label=looks.before, gid="before")
    stop = STOPPED.get(result.stopped_by, result.stopped_by)
    ax.axvline(len(best) - 1.0, color=QUIET if result.status == "finished" else ALARM, linestyle=":", label=stop, gid="stop")
    if len(known) and known.min() > 0.0 and known.max() > _DECADE * known.min():
        ax.set_yscale("log")
        span = known.max() / known.min()
        drawing.plain_ticks(ax.yaxis, (1.0, 2.0, 5.0) if span < 200.0 else (1.0,))
    ax.margins(x=0.02, y=0.08)
    ax.set_xlim(-0.02 * len(best) - 0.2, len(best) - 1.0 + 0.02 * len(best) + 0.2)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    ax.legend(loc="best", fontsize=8.5, frameon=True, framealpha=0.9, edgecolor="none", handlelength=1.8)
    ax.set(title=f"Cost ({result.cost_name}) by generation", xlabel="generation")


def _draw_strips(looks: SearchLooks, which: Sequence[int], places: int, ax: Axes) -> None:
    """Draw some of the parameters within their bounds, a strip each, in a panel with room for `places` strips."""
    result = looks.result
    names = [f"{i + 1}  {p.name}" if looks.numbered else p.name for i, p in enumerate(result.parameters)]
    right = max(len(f"{p.upper:.4g} {unit_text(p.unit)}") for p in result.parameters)
    drawing.inset(ax, left=_CHARACTER_IN * (max(map(len, names)) + 8) - 0.45, right=_CHARACTER_IN * right)
    ax.set(xlim=(0.0, 1.0), ylim=(places - 0.45, -0.6), xticks=[], yticks=[])
    ax.set_title(f"{looks.what} within their bounds" if which[0] == 0 else "")
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)
    members = result.trace.population[np.isfinite(result.trace.costs)]
    for row, i in enumerate(which):
        _draw_strip(result.parameters[i], row, members[:, i], looks.ink, ax)
        ax.annotate(names[i], (0.0, row), (-46.0, 0.0), textcoords="offset points", ha="right", va="center",
                    annotation_clip=False)  # fmt: skip
    parts = ["dot: found", f"tick: {looks.before}", "grey dots: last generation"]
    if any(p.interval_95 is not None for p in result.parameters):
        parts.insert(1, "bar: 95 % interval")
    legend = " · ".join(parts[:-1]) + "\n" + parts[-1] if which[0] == 0 else ""  # one line would run into the next panel
    ax.annotate(legend, (0.0, 0.0), (0.0, -6.0), xycoords="axes fraction", textcoords="offset points", va="top",
                ha="left", fontsize=8.5, color=QUIET, annotation_clip=False)  # fmt: skip


def _draw_strip(p: FittedParameter, row: int, members: FloatArray, ink: Ink, ax: Axes) -> None:
    """Draw one parameter: bounds, population, interval, value and earlier value."""
    ink = ALARM if p.at_bound else ink
    ax.plot([0.0, 1.0], [row, row], color="0.75", linewidth=1.2, marker="|", markersize=10.0, zorder=1.5, clip_on=False)
    jitter = row + 0.045 * (np.arange(len(members)) % 5 - 2.0)
    ax.plot(members, jitter, "o", color="0.55", markersize=3.0, alpha=0.45, markeredgewidth=0.0, zorder=2.0, clip_on=False)
    if p.interval_95 is not None:
        ends = np.clip([p.share(end) for end in p.interval_95], 0.0, 1.0)
        ax.plot(ends, [row, row], color=ink, linewidth=5.0, alpha=0.4, solid_capstyle="butt", zorder=2.5, clip_on=False)
    before = p.share(p.before)
    mark, at = ("|", before) if 0.0 <= before <= 1.0 else ("<", 0.0) if before < 0.0 else (">", 1.0)
    ax.plot(at, row, mark, color="0.1", markersize=13.0 if mark == "|" else 6.0, markeredgewidth=1.6, zorder=3.0,
            clip_on=False, gid=f"before {p.name}")  # fmt: skip
    x = min(max(p.share(p.value), 0.0), 1.0)
    ax.plot(x, row, "o", color=ink, markersize=8.5, markeredgecolor="white", zorder=3.5, clip_on=False, gid=p.name)
    colour = ALARM if p.at_bound else _DOUBT if flags(p) else "0.1"
    text = f"{value_text(p)} {unit_text(p.unit)}".rstrip() + "".join(f" · {flag}" for flag in flags(p))
    side = "left" if x < 0.3 else "right" if x > 0.7 else "center"
    ax.annotate(text, ({"left": 0.0, "right": 1.0}.get(side, x), row), (0.0, 7.0), textcoords="offset points", ha=side,
                va="bottom", fontsize=9.0, fontweight="bold", color=colour, annotation_clip=False)  # fmt: skip
    ends_text = ((f"{p.lower:.4g}", 0.0, -7.0, "right"), (f"{p.upper:.4g} {unit_text(p.unit)}".rstrip(), 1.0, 7.0, "left"))
    for bound, at, away, align in ends_text:
        ax.annotate(bound, (at, row), (away, 0.0), textcoords="offset points", ha=align, va="center", fontsize=8.5,
                    color="0.3", annotation_clip=False)  # fmt: skip


def _draw_correlation(looks: SearchLooks, beside: bool, ax: Axes) -> None:
    """Draw the correlations of the parameters' errors: beside their strips row by row, else with their names."""
    result, correlation = looks.result, looks.correlation
    n = len(result.parameters)
    assert correlation is not None
    if not beside:
        drawing.inset(ax, left=_CHARACTER_IN * (max(len(p.name) for p in result.parameters) + 4) - 0.5)
    colours = matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.9")  # grey where a parameter would meet itself
    others = np.ma.masked_array(correlation, np.eye(n, dtype=np.bool_))
    ax.imshow(others, cmap=colours, vmin=-1.0, vmax=1.0, aspect="auto", interpolation="nearest")
    ax.set_title("Correlation" if beside else "Correlation of the errors: red +1, blue −1")
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0.0)
    ax.set_xticks(range(n), [str(i + 1) for i in range(n)])
    ax.set_yticks(range(n), [str(i + 1) if beside else f"{p.name}  {i + 1}" for i, p in enumerate(result.parameters)])
    if beside:
        ax.set_ylim(n - 0.45, -0.6)
    figure = ax.get_figure(root=True)
    assert figure is not None
    wide, tall = np.array(ax.get_window_extent().size) / (figure.dpi * n)
    for i in range(n) if wide >= _LEAST_CELL_IN and tall >= 0.5 * _LEAST_CELL_IN else ():
        for j in range(n):
            if i != j:
                text = "0" if abs(correlation[i, j]) < 0.005 else f"{correlation[i, j]:+.2f}".replace("0.", ".")
                ax.text(j, i, text, ha="center", va="center", fontsize=7.5,
                        color="white" if abs(correlation[i, j]) > 0.65 else "0.2")  # fmt: skip


def _search_rows(looks: SearchLooks) -> list[Row]:
    """Return rows of convergence, parameters and correlations, arranged by the number of parameters."""
    n, convergence = len(looks.result.parameters), partial(_draw_convergence, looks)
    every = partial(_draw_strips, looks, range(n), n)
    if n <= _BESIDE:
        height = max(_CONVERGENCE_IN, _STRIPS_IN + _STRIP_IN * n)
        if not looks.numbered:
            return [Row(height, ((0.4, convergence), (0.6, every)))]
        return [Row(height, ((0.28, convergence), (0.5, every), (0.22, partial(_draw_correlation, looks, True))))]
    if not looks.numbered:
        half = (n + 1) // 2
        columns = [partial(_draw_strips, looks, range(half), half), partial(_draw_strips, looks, range(half, n), half)]
        strips = drawing.side_by_side(_STRIPS_IN + _STRIP_IN * half, columns)
        return [drawing.side_by_side(_CONVERGENCE_IN, [convergence]), strips]
    height = max(5.8, _STRIPS_IN + _STRIP_IN * n)
    upper = 2.0 / (height - 1.67)
    left = partial(drawing.stacked, [(upper, convergence), (1.0 - upper, partial(_draw_correlation, looks, False))])
    return [Row(height, ((0.42, left), (0.58, every)))]


def search_page(header: Panel, looks: SearchLooks, details: Sequence[Row], notes: Sequence[str]) -> Figure:
    """Put a search's picture together: header, course and values of the search, further rows, notes and footer."""
    result = looks.result
    parts = [f"profile {shortened(result.profile_label, 32)}", f"seed {result.seed}"]
    shown = [k for k in ("objective", "strategy", "population") if k in result.options]
    parts += [f"{k} {option_text(result.options[k])}" for k in shown]
    parts += [f"{k} {result.versions[k]}" for k in result.versions if k in ("ssmr-testbed", "mujoco", "numpy")]
    footer = drawing.text_row(_FOOTER_IN, partial(drawing.draw_footer, shortened(" · ".join(parts), 170)))
    rows = [drawing.text_row(_HEADER_IN, header), Row(_GAP_IN, ()), *_search_rows(looks), *details]
    return drawing.put_together([*rows, *drawing.note_rows(notes), footer])


def title_path(text: str, pad: float, beyond: float, ax: Axes) -> None:
    """Write the title of a panel `pad` points above it, shortened to end at most `beyond` [in] to the right of it."""
    figure, box = ax.get_figure(root=True), ax.get_window_extent()
    assert figure is not None
    end = min(box.x1 + beyond * figure.dpi, figure.bbox.x1 - 0.1 * figure.dpi)
    drawing.narrow(ax.set_title(text, pad=pad, fontsize=10.0), (end - box.x0) / figure.dpi)
