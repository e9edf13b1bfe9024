"""A fit as one picture: how the search went, what it found and how well that is known, and the fitted plant's motion.

Motions over one stretch of at most `LONGEST_PATH` are shown as they were driven. Of longer ones, or ones in pieces, that
stretch is shown whose error is the median of all, laid on the truth's pose at its start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from ssmr.geometry import relative
from ssmr.metrics.paths import HorizonErrors, compare_pieces, horizon_windows, relative_pose_error
from ssmr.types import FloatArray, Trajectory
from validation.compare.table import HEADLINE_HORIZON
from validation.fit.report import (
    STOPPED,
    Search,
    cube_share,
    effort,
    ending,
    fit_notes,
    flags,
    label_text,
    unit_text,
    value_text,
)
from validation.fit.result import FitResult, FittedParameter, Scored
from validation.show.drawing import (
    ALARM,
    BESIDE_INK,
    BROAD,
    DASHED,
    NARROW,
    QUIET,
    Dashes,
    HorizonMarks,
    Ink,
    Panel,
    Row,
    corner_note,
    draw_dart,
    draw_footer,
    draw_horizons,
    draw_ring,
    draw_section,
    equal_scales,
    ink_of,
    inset,
    joined,
    line_legend,
    narrow,
    note_rows,
    put_together,
    side_by_side,
    stacked,
    text_row,
    yaw_degrees,
)
from validation.show.tables import length_unit, option_text, shortened

LONGEST_PATH = 30.0
"""Longer motions, and ones in pieces, are shown over a stretch of this length [s]."""
MAX_TRAIN, MAX_HELD_OUT, MAX_ABREAST = 4, 3, 4
"""How many sources have a panel of their path, and how many panels stand in a row."""
BESIDE = 6
"""Up to so many parameters the correlations stand beside them, row by row; else below the convergence."""
LEAST_CELL_IN = 0.3
"""Cells of correlations hold a number if they are as large as this [in]."""
DECADE = 10.0
"""Costs that span more are drawn on a logarithmic scale."""

_HEADER_IN, _GAP_IN, _SECTION_IN, _LEGEND_IN, _HORIZON_IN, _FOOTER_IN = 0.84, 0.1, 0.3, 0.24, 2.4, 0.26
_PATHS_IN = {1: 3.7, 2: 3.6, 3: 3.4, 4: 3.1}  # height of a row of paths by how many stand in it
_CONVERGENCE_IN, _STRIP_IN, _STRIPS_IN = 2.7, 0.52, 0.95  # a strip's height; what their panel needs besides them
_CHARACTER_IN = 0.076  # width of a usual character at 9.5 points
_HEADING_IN = 9.3  # width of the heading at most
_DOUBT = "#8a5a00"


def _truth_key(result: FitResult, scored: Scored) -> str:
    """Whose colour the truth has: its own plant's, unless that is the one fitted."""
    return "truth" if scored.reference_name == result.model else scored.reference_name


# --- header, notes, footer ---


def _draw_header(result: FitResult, ax: Axes) -> None:
    """Title, what it took, how it ended, and the legend of all motions."""
    ax.set_axis_off()
    names = [Path(part.strip()).name for part in result.source.split(",")]
    more = f" and {len(names) - 1} more" * (len(names) > 1)
    lead = f"{result.model} fitted to "
    title = f"{lead}{shortened(names[0], 80)}{more}"
    heading = ax.text(0.0, 1.0, title, transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    narrow(heading, _HEADING_IN, lead)
    finished = result.status == "finished"
    ax.text(1.0, 1.0, ending(result), transform=ax.transAxes, ha="right", va="top", fontsize=10.5,
            fontweight="normal" if finished else "bold", color=QUIET if finished else ALARM)  # fmt: skip
    about = f"{effort(result)} · begun with profile {shortened(result.profile, 32)}"
    ax.text(0.0, 0.64, about, transform=ax.transAxes, va="top", color="0.25")
    handles, labels = [], []
    for key, name in {_truth_key(result, s): s.reference_name for s in (*result.train, *result.held_out)}.items():
        handles.append(Line2D([], [], color=ink_of(key), linewidth=BROAD))
        labels.append(f"{name}: the truth")
    handles.append(Line2D([], [], color=ink_of(result.model), linewidth=NARROW))
    labels.append(f"{result.model}, fitted")
    if any(s.before for s in (*result.train, *result.held_out)):
        handles.append(Line2D([], [], color=BESIDE_INK, linewidth=1.1, linestyle=DASHED))
        labels.append(f"{result.model} before the fit")
    line_legend(ax, handles, labels)


def footer_text(result: Search) -> str:
    """How a search was made."""
    options = [
        f"{k} {option_text(result.options[k])}" for k in ("objective", "strategy", "population") if k in result.options
    ]
    versions = [
        f"{name} {version}" for name, version in result.versions.items() if name in ("ssmr-testbed", "mujoco", "numpy")
    ]
    parts = [f"profile {shortened(result.profile, 24)}", f"seed {result.seed}", *options, *versions]
    return shortened(" · ".join(parts), 170)


# --- how the search went ---


@dataclass(frozen=True, eq=False)
class SearchLooks:
    """A search, and how it is shown."""

    result: Search
    ink: Ink
    """Of what was found."""
    what: str
    """What was searched for: `Parameters`, `Gains`."""
    before: str
    """What the search is held against, in words."""
    correlation: FloatArray | None = None
    """(n, n) of the errors of what was found; None where it was not estimated."""
    before_cost: float = math.inf
    """The cost of that; not drawn where it is infinite."""

    @property
    def numbered(self) -> bool:
        """Whether correlations refer to the parameters by their numbers."""
        return self.correlation is not None and len(self.result.parameters) > 1


def _draw_convergence(looks: SearchLooks, ax: Axes) -> None:
    """Best and median cost, generation by generation."""
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
    if len(known) and known.min() > 0.0 and known.max() > DECADE * known.min():
        ax.set_yscale("log")
        span = known.max() / known.min()
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if span < 200.0 else (1.0,)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
    ax.margins(x=0.02, y=0.08)
    ax.set_xlim(-0.02 * len(best) - 0.2, len(best) - 1.0 + 0.02 * len(best) + 0.2)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    ax.legend(loc="best", fontsize=8.5, frameon=True, framealpha=0.9, edgecolor="none", handlelength=1.8)
    ax.set(title=f"Cost ({result.cost_name}) by generation", xlabel="generation")


# --- what was found ---


def _draw_strips(looks: SearchLooks, which: Sequence[int], places: int, ax: Axes) -> None:
    """Some of the parameters within their bounds, a strip each, with room for so many."""
    result = looks.result
    names = [f"{i + 1}  {p.name}" if looks.numbered else p.name for i, p in enumerate(result.parameters)]
    right = max(len(f"{p.upper:g} {unit_text(p.unit)}") for p in result.parameters)
    inset(ax, left=_CHARACTER_IN * (max(map(len, names)) + 8) - 0.45, right=_CHARACTER_IN * right)
    ax.set(xlim=(0.0, 1.0), ylim=(places - 0.45, -0.6), xticks=[], yticks=[])
    ax.set_title(f"{looks.what} within their bounds" if which[0] == 0 else "")
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)
    members = result.trace.population[np.isfinite(result.trace.costs)]
    for row, i in enumerate(which):
        _draw_strip(result.parameters[i], row, members[:, i], looks.ink, ax)
        ax.annotate(names[i], (0.0, row), (-46.0, 0.0), textcoords="offset points", ha="right", va="center",
                    annotation_clip=False)  # fmt: skip
    parts = ["dot: found", f"tick: {looks.before}", "grey: last population"]
    if any(p.interval_95 is not None for p in result.parameters):
        parts.insert(1, "bar: 95 %")
    legend = " · ".join(parts) if which[0] == 0 else ""
    ax.annotate(legend, (0.0, 0.0), (0.0, -6.0), xycoords="axes fraction", textcoords="offset points", va="top",
                ha="left", fontsize=8.5, color=QUIET, annotation_clip=False)  # fmt: skip


def _draw_strip(p: FittedParameter, row: int, members: FloatArray, ink: Ink, ax: Axes) -> None:
    """One parameter: bounds, population, interval, value and what it was before."""
    ink = ALARM if p.at_bound else ink
    ax.plot([0.0, 1.0], [row, row], color="0.75", linewidth=1.2, marker="|", markersize=10.0, zorder=1.5, clip_on=False)
    jitter = row + 0.045 * (np.arange(len(members)) % 5 - 2.0)
    ax.plot(members, jitter, "o", color="0.55", markersize=3.0, alpha=0.45, markeredgewidth=0.0, zorder=2.0, clip_on=False)
    if p.interval_95 is not None:
        ends = np.clip([cube_share(p, end) for end in p.interval_95], 0.0, 1.0)
        ax.plot(ends, [row, row], color=ink, linewidth=5.0, alpha=0.4, solid_capstyle="butt", zorder=2.5, clip_on=False)
    before = cube_share(p, p.before)
    mark, at = ("|", before) if 0.0 <= before <= 1.0 else ("<", 0.0) if before < 0.0 else (">", 1.0)
    ax.plot(at, row, mark, color="0.1", markersize=13.0 if mark == "|" else 6.0, markeredgewidth=1.6, zorder=3.0,
            clip_on=False, gid=f"before {p.name}")  # fmt: skip
    x = min(max(cube_share(p, p.value), 0.0), 1.0)
    ax.plot(x, row, "o", color=ink, markersize=8.5, markeredgecolor="white", zorder=3.5, clip_on=False, gid=p.name)
    colour = ALARM if p.at_bound else _DOUBT if flags(p) else "0.1"
    text = f"{value_text(p)} {unit_text(p.unit)}".rstrip() + "".join(f" · {flag}" for flag in flags(p))
    side = "left" if x < 0.3 else "right" if x > 0.7 else "center"
    ax.annotate(text, ({"left": 0.0, "right": 1.0}.get(side, x), row), (0.0, 7.0), textcoords="offset points", ha=side,
                va="bottom", fontsize=9.0, fontweight="bold", color=colour, annotation_clip=False)  # fmt: skip
    ends_text = ((f"{p.lower:g}", 0.0, -7.0, "right"), (f"{p.upper:g} {unit_text(p.unit)}".rstrip(), 1.0, 7.0, "left"))
    for bound, at, away, align in ends_text:
        ax.annotate(bound, (at, row), (away, 0.0), textcoords="offset points", ha=align, va="center", fontsize=8.5,
                    color="0.3", annotation_clip=False)  # fmt: skip


def _draw_correlation(looks: SearchLooks, beside: bool, ax: Axes) -> None:
    """Correlations of the parameters' errors; beside their strips row by row, else with their names."""
    result, correlation = looks.result, looks.correlation
    n = len(result.parameters)
    assert correlation is not None
    if not beside:
        inset(ax, left=_CHARACTER_IN * (max(len(p.name) for p in result.parameters) + 4) - 0.5)
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
    for i in range(n) if wide >= LEAST_CELL_IN and tall >= 0.5 * LEAST_CELL_IN else ():
        for j in range(n):
            if i != j:
                text = "0" if abs(correlation[i, j]) < 0.005 else f"{correlation[i, j]:+.2f}".replace("0.", ".")
                ax.text(j, i, text, ha="center", va="center", fontsize=7.5,
                        color="white" if abs(correlation[i, j]) > 0.65 else "0.2")  # fmt: skip


def search_rows(looks: SearchLooks) -> list[Row]:
    """Convergence, parameters and their correlations, arranged by how many there are."""
    n, convergence = len(looks.result.parameters), partial(_draw_convergence, looks)
    every = partial(_draw_strips, looks, range(n), n)
    if n <= BESIDE:
        height = max(_CONVERGENCE_IN, _STRIPS_IN + _STRIP_IN * n)
        if not looks.numbered:
            return [Row(height, ((0.4, convergence), (0.6, every)))]
        return [Row(height, ((0.28, convergence), (0.5, every), (0.22, partial(_draw_correlation, looks, True))))]
    if not looks.numbered:
        half = (n + 1) // 2
        columns = [partial(_draw_strips, looks, range(half), half), partial(_draw_strips, looks, range(half, n), half)]
        return [side_by_side(_CONVERGENCE_IN, [convergence]), side_by_side(_STRIPS_IN + _STRIP_IN * half, columns)]
    height = max(5.8, _STRIPS_IN + _STRIP_IN * n)
    upper = 2.0 / (height - 1.67)
    left = partial(stacked, [(upper, convergence), (1.0 - upper, partial(_draw_correlation, looks, False))])
    return [Row(height, ((0.42, left), (0.58, every)))]


# --- fitted against the truth ---


@dataclass(frozen=True, eq=False)
class _Stretch:
    """What of a source is shown."""

    scored: Scored
    held_out: bool
    piece: int
    first: int
    last: int
    whole: bool


def _stretch(scored: Scored, held_out: bool) -> _Stretch:
    """All of a short motion, else the stretch of `LONGEST_PATH`, or of the longest piece, of median error."""
    lengths = [float(piece.t[-1] - piece.t[0]) for piece in scored.truth]
    if len(lengths) == 1 and lengths[0] <= LONGEST_PATH:
        return _Stretch(scored, held_out, 0, 0, len(scored.truth[0]) - 1, whole=True)
    length = min(LONGEST_PATH, max(lengths))
    found = []
    for k, (motion, truth) in enumerate(zip(scored.motion, scored.truth, strict=True)):
        starts, ends = horizon_windows(truth.t, length) if length > 0.0 else (np.array([0]), np.array([0]))
        errors = relative_pose_error(motion.pose, truth.pose, starts, ends)[0]
        found += [(float(e), k, int(a), int(b)) for e, a, b in zip(errors, starts, ends, strict=True)]
    _, k, a, b = sorted(found)[len(found) // 2]
    return _Stretch(scored, held_out, k, a, b, whole=False)


def _quality(stretch: _Stretch) -> str:
    """How good the fit is on a source, in few words."""
    scored, before = stretch.scored, stretch.scored.before
    if not stretch.whole:
        t = scored.truth[stretch.piece].t
        text = f"{t[stretch.first]:.0f} to {t[stretch.last]:.0f} s"
        if scored.horizons:
            horizon = min(scored.horizons, key=lambda h: abs(h - HEADLINE_HORIZON))
            errors = scored.horizons[horizon]
            text += (
                f" · {1e3 * errors.position_median_m:.0f} mm, {math.degrees(errors.yaw_median_rad):.1f}° in {horizon:g} s"
            )
        return text
    was = compare_pieces(before, scored.truth).d_rms_m if before else math.nan
    unit = length_unit([scored.metrics.d_rms_m, was])
    text = f"d_rms {unit.text(scored.metrics.d_rms_m)} {unit.symbol}"
    return text + (f", before {unit.text(was)} {unit.symbol}" if before else "")


def _draw_path(result: FitResult, stretch: _Stretch, ax: Axes) -> None:
    """The truth, the fitted plant and the plant before, each seen from its own start where it is no whole motion."""
    scored, k = stretch.scored, stretch.piece
    inset(ax, above=0.22)

    def seen(piece: Trajectory) -> FloatArray:
        if stretch.whole:
            return piece.pose
        return relative(piece.pose[stretch.first], piece.pose[stretch.first : stretch.last + 1])

    key = _truth_key(result, scored)
    truth, motion = seen(scored.truth[k]), seen(scored.motion[k])
    if scored.before:
        before = seen(scored.before[k])
        ax.plot(*before[:, :2].T, color=BESIDE_INK, linewidth=1.1, linestyle=DASHED, zorder=2.2, gid="before")
    ax.plot(*truth[:, :2].T, color=ink_of(key), linewidth=BROAD, zorder=2.0, gid="truth")
    ax.plot(*motion[:, :2].T, color=ink_of(result.model), linewidth=NARROW, zorder=2.5, gid="fitted")
    draw_dart(ax, truth[-1], key, 12.0)
    draw_dart(ax, motion[-1], result.model, 12.0)
    draw_ring(ax, *map(float, truth[0, :2]))
    equal_scales(ax, 0.6)
    ax.locator_params(nbins=6)
    names = ("x [m]", "y [m]") if stretch.whole else ("ahead [m]", "to the left [m]")
    figure = ax.get_figure(root=True)
    assert figure is not None
    box = ax.get_window_extent()
    title = ax.set_title(label_text(scored, 80), pad=19.0, fontsize=10.0)
    narrow(title, (min(box.x1 + 0.5 * figure.dpi, figure.bbox.x1 - 0.1 * figure.dpi) - box.x0) / figure.dpi)
    if stretch.held_out:
        corner_note(ax, "held out")
    ax.set(xlabel=names[0], ylabel=names[1], label="held out" if stretch.held_out else "train")
    ax.annotate(_quality(stretch), (0.0, 1.0), (0.0, 5.0), xycoords="axes fraction", textcoords="offset points", va="bottom",
                fontsize=8.5, color="0.25")  # fmt: skip


def _draw_position_error(result: FitResult, scored: Scored, ax: Axes) -> None:
    """Distance from the truth at the same instant, fitted and before."""
    inset(ax, above=0.22)
    looks: list[tuple[Sequence[Trajectory], Ink, Dashes, str]] = [(scored.motion, ink_of(result.model), "solid", "fitted")]
    if scored.before:
        looks.append((scored.before, BESIDE_INK, DASHED, "before"))
    curves = []
    for pieces, _, _, _ in looks:
        curves.append(joined([(r.t, np.hypot(*(p.xy - r.xy).T)) for p, r in zip(pieces, scored.truth, strict=True)]))
    unit = length_unit([float(np.nanmax(error)) for _, error in curves])
    for (_, ink, dashes, gid), (t, error) in zip(looks, curves, strict=True):
        ax.plot(t, error * unit.scale, color=ink, linestyle=dashes, linewidth=NARROW if gid == "fitted" else 1.1, gid=gid)
    ax.margins(x=0.0)
    ax.set_ylim(0.0, max(ax.get_ylim()[1], 1e-3 * unit.scale))
    ax.set(xlabel="time [s]", label="position error")
    ax.set_title(f"Position error [{unit.symbol}]", pad=19.0)
    ax.annotate("distance at the same instant", (0.0, 1.0), (0.0, 5.0), xycoords="axes fraction",
                textcoords="offset points", va="bottom", fontsize=8.5, color="0.25")  # fmt: skip


def _path_rows(result: FitResult) -> tuple[list[Row], list[str]]:
    """Rows of paths, and in words what found no room."""
    shown = [_stretch(s, False) for s in result.train[:MAX_TRAIN]]
    shown += [_stretch(s, True) for s in result.held_out[:MAX_HELD_OUT]]
    panels: list[Panel] = [partial(_draw_path, result, stretch) for stretch in shown]
    if shown[0].whole and len(panels) < MAX_ABREAST:
        panels.insert(1, partial(_draw_position_error, result, shown[0].scored))
    abreast = math.ceil(len(panels) / math.ceil(len(panels) / MAX_ABREAST))
    rows = [text_row(_SECTION_IN, partial(draw_section, _path_heading(shown)))]
    for k in range(0, len(panels), abreast):
        part = panels[k : k + abreast]
        if len(part) == 2 and len(panels) == 2 and shown[0].whole:
            share = _path_share(shown[0])
            rows.append(Row(_PATHS_IN[2], ((share, part[0]), (1.0 - share, part[1]))))
        else:
            rows.append(side_by_side(_PATHS_IN[len(part)], part))
    without = [label_text(s) for s in (*result.train[MAX_TRAIN:], *result.held_out[MAX_HELD_OUT:])]
    return rows, [f"Without a picture of their own: {', '.join(without)}."] if without else []


def _path_share(stretch: _Stretch) -> float:
    """Share of the width that a path beside one other panel takes, by its own proportions."""
    width, height = np.ptp(stretch.scored.truth[stretch.piece].xy, axis=0) + 0.5
    return float(np.clip(0.06 + 0.2 * width / height, 0.36, 0.64))


def _path_heading(shown: Sequence[_Stretch]) -> str:
    if all(stretch.whole for stretch in shown):
        return "The fitted plant's paths [m]"
    return "The fitted plant's paths over the stretch of median error, all laid on the same pose at its start [m]"


# --- errors by horizon ---


def _horizon_rows(result: FitResult) -> list[Row]:
    """Position and yaw error by horizon, of what was fitted to and of what was held out."""
    ink = ink_of(result.model)
    darker: Ink = (0.55 * ink[0], 0.55 * ink[1], 0.55 * ink[2])
    marks = [
        HorizonMarks("before the fit", BESIDE_INK, "X", result.before_horizons),
        HorizonMarks("what was fitted to", ink, "o", result.train_horizons),
    ]
    for scored, marker in zip(result.held_out, "DsvP" * len(result.held_out), strict=False):
        marks.append(
            HorizonMarks(
                f"held out: {label_text(scored, 32 if len(result.held_out) < 3 else 20)}", darker, marker, scored.horizons
            )
        )
    marks = [each for each in marks if each.errors]
    if not marks:
        return []
    bar = "median, bar to 95th percentile"
    panels: list[Panel] = [
        partial(draw_horizons, marks, f"Position error by horizon [mm]: {bar}", _position_mm),
        partial(draw_horizons, marks, f"Yaw error by horizon [deg]: {bar}", yaw_degrees),
    ]
    return [side_by_side(_HORIZON_IN, panels), text_row(_LEGEND_IN, partial(_draw_marks, marks))]


def _position_mm(errors: HorizonErrors) -> tuple[float, float]:
    return 1e3 * errors.position_median_m, 1e3 * errors.position_p95_m


def _draw_marks(marks: Sequence[HorizonMarks], ax: Axes) -> None:
    """Whose marks are whose."""
    ax.set_axis_off()
    handles = [
        Line2D([], [], color=m.ink, marker=m.marker, markersize=8.0, markeredgecolor="white", linewidth=2.5) for m in marks
    ]
    line_legend(ax, handles, [m.name for m in marks])


def fit_figure(result: FitResult) -> Figure:
    """Everything about a fit that can be seen in one look, 1600 px wide.

    Args:
        result: what was found.

    Returns:
        A figure with its layout done: convergence, parameters within their bounds, their correlation, paths of the truth,
        the fitted plant and the plant before the fit, errors by horizon where there are recordings, and notes.
    """
    paths, left_out = _path_rows(result)
    rows = [text_row(_HEADER_IN, partial(_draw_header, result)), Row(_GAP_IN, ())]
    looks = SearchLooks(result, ink_of(result.model), "Parameters", "before the fit", result.correlation)
    rows += [*search_rows(looks), *paths, *_horizon_rows(result), *note_rows([*fit_notes(result), *left_out])]
    rows.append(text_row(_FOOTER_IN, partial(draw_footer, footer_text(result))))
    return put_together(rows)
