"""A fit as one picture: the course of the search, the parameters with their uncertainty, and the fitted plant's motion.

Motions over one stretch of at most `_LONGEST_STRETCH` are shown as they were driven. Of longer ones, or ones in pieces, that
stretch is shown whose error is the median of all, laid on the true pose at its start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.geometry import relative
from ssmr.metrics.declared import compare_pieces
from ssmr.metrics.poses import HorizonErrors, horizon_windows, relative_pose_error
from ssmr.metrics.windows import OverlappingErrors, WindowErrors
from ssmr.types import FloatArray, Trajectory
from validation.fit.data import FitData, Scored
from validation.fit.search_figure import SearchLooks, draw_title, search_page, title_path
from validation.fit.table import fit_notes, source_text
from validation.report import drawing
from validation.report.drawing import BESIDE_INK, BROAD, DASHED, NARROW, Dashes, HorizonMarks, Ink, Interval, Panel, Row
from validation.report.motions import HEADLINE_HORIZON
from validation.report.tables import length_unit, shortened

_LONGEST_STRETCH = 30.0
"""Longer motions, and ones in pieces, are shown over a stretch of this length [s]."""
MAX_TRAIN, MAX_HELD_OUT, MAX_ABREAST = 4, 3, 4
"""Greatest numbers of sources with a panel of their path, and of panels in a row."""

_SECTION_IN, _LEGEND_IN, _HORIZON_IN = 0.3, 0.24, 2.4
_PATHS_IN = {1: 3.7, 2: 3.6, 3: 3.4, 4: 3.1}  # height of a row of paths by how many stand in it


def _truth_key(result: FitData, scored: Scored) -> str:
    """Return the key of the true motion's colour: that of its own plant, unless that is the fitted one."""
    return "truth" if scored.reference_name == result.model else scored.reference_name


def _draw_header(result: FitData, ax: Axes) -> None:
    """Draw the title, how the search ended, and the legend of all motions."""
    names = [Path(part.strip()).name for part in result.source.split(",")]
    more = f" and {len(names) - 1} more" * (len(names) > 1)
    about = f"begun with profile {shortened(result.profile_label, 40)}"
    draw_title(result, f"{result.model} fitted to ", f"{shortened(names[0], 80)}{more}", about, ax)
    handles, labels = [], []
    for key, name in {_truth_key(result, s): s.reference_name for s in (*result.train, *result.held_out)}.items():
        handles.append(Line2D([], [], color=drawing.ink_of(key), linewidth=BROAD))
        labels.append(f"{name}, the true motion")
    handles.append(Line2D([], [], color=drawing.ink_of(result.model), linewidth=NARROW))
    labels.append(f"{result.model}, fitted")
    if any(s.before for s in (*result.train, *result.held_out)):
        handles.append(Line2D([], [], color=BESIDE_INK, linewidth=1.1, linestyle=DASHED))
        labels.append(f"{result.model} before the fit")
    drawing.line_legend(ax, handles, labels)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """The part of a source that is shown."""

    scored: Scored
    held_out: bool
    piece: int
    first: int
    last: int
    whole: bool


def _stretch(scored: Scored, held_out: bool) -> _Stretch:
    """Return all of a short motion, else the stretch of `_LONGEST_STRETCH`, or of the longest piece, of median error.

    No stretch spans a jump of the localiser; where none is as long as that, the longest between jumps is shown.
    """
    lengths = [float(piece.t[-1] - piece.t[0]) for piece in scored.truth]
    if len(lengths) == 1 and lengths[0] <= _LONGEST_STRETCH:
        return _Stretch(scored, held_out, 0, 0, len(scored.truth[0]) - 1, whole=True)
    length = min(_LONGEST_STRETCH, max(lengths))
    found: list[tuple[float, int, int, int]] = []
    longest = (-1.0, 0, 0, 0)
    for k, (motion, truth) in enumerate(zip(scored.motion, scored.truth, strict=True)):
        cuts = (0, *(scored.jumps[k] if scored.jumps else ()), len(truth.t))
        between = [(a, b) for a, b in pairwise(cuts) if b > a]
        longest = max(longest, max((float(truth.t[b - 1] - truth.t[a]), k, a, b - 1) for a, b in between))
        for a, b in between:
            starts, ends = horizon_windows(truth.t[a:b], length) if length > 0.0 else (np.array([0]), np.array([0]))
            errors = relative_pose_error(motion.pose, truth.pose, a + starts, a + ends)[0]
            found += [(float(e), k, a + int(i), a + int(j)) for e, i, j in zip(errors, starts, ends, strict=True)]
    k, a, b = sorted(found)[len(found) // 2][1:] if found else longest[1:]
    return _Stretch(scored, held_out, k, a, b, whole=False)


def _quality(stretch: _Stretch) -> str:
    """Return the errors of the fit on a source, in few words."""
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
    was = compare_pieces(before, scored.truth)["d_rms_m"] if before else math.nan
    unit = length_unit([scored.metrics["d_rms_m"], was])
    text = f"d_rms {unit.text(scored.metrics['d_rms_m'])} {unit.symbol}"
    return text + (f", before {unit.text(was)} {unit.symbol}" if before else "")


def _draw_path(result: FitData, stretch: _Stretch, ax: Axes) -> None:
    """Draw the true motion, the fitted plant and the plant before, laid on one start where only a part is shown."""
    scored, k = stretch.scored, stretch.piece
    drawing.inset(ax, above=0.22)

    def seen(piece: Trajectory) -> FloatArray:
        if stretch.whole:
            return piece.pose
        return relative(piece.pose[stretch.first], piece.pose[stretch.first : stretch.last + 1])

    key = _truth_key(result, scored)
    truth, motion = seen(scored.truth[k]), seen(scored.motion[k])
    if scored.before:
        before = seen(scored.before[k])
        ax.plot(*before[:, :2].T, color=BESIDE_INK, linewidth=1.1, linestyle=DASHED, zorder=2.2, gid="before")
    ax.plot(*truth[:, :2].T, color=drawing.ink_of(key), linewidth=BROAD, zorder=2.0, gid="truth")
    ax.plot(*motion[:, :2].T, color=drawing.ink_of(result.model), linewidth=NARROW, zorder=2.5, gid="fitted")
    drawing.draw_dart(ax, truth[-1], key, 12.0)
    drawing.draw_dart(ax, motion[-1], result.model, 12.0)
    drawing.draw_ring(ax, *map(float, truth[0, :2]))
    drawing.equal_scales(ax, 0.6)
    ax.locator_params(nbins=6)
    names = ("x [m]", "y [m]") if stretch.whole else ("ahead [m]", "to the left [m]")
    title_path(source_text(scored, 80), 19.0, 0.5, ax)
    if stretch.held_out:
        drawing.corner_note(ax, "held out")
    ax.set(xlabel=names[0], ylabel=names[1], label="held out" if stretch.held_out else "train")
    ax.annotate(_quality(stretch), (0.0, 1.0), (0.0, 5.0), xycoords="axes fraction", textcoords="offset points", va="bottom",
                fontsize=8.5, color="0.25")  # fmt: skip


def _draw_position_error(result: FitData, scored: Scored, ax: Axes) -> None:
    """Draw the distance from the true motion at the same instant, of the fitted plant and of the plant before."""
    drawing.inset(ax, above=0.22)
    fitted = drawing.ink_of(result.model)
    looks: list[tuple[Sequence[Trajectory], Ink, Dashes, str]] = [(scored.motion, fitted, "solid", "fitted")]
    if scored.before:
        looks.append((scored.before, BESIDE_INK, DASHED, "before"))
    curves = []
    for pieces, _, _, _ in looks:
        curves.append(drawing.joined([(r.t, np.hypot(*(p.xy - r.xy).T)) for p, r in zip(pieces, scored.truth, strict=True)]))
    unit = length_unit([float(np.nanmax(error)) for _, error in curves])
    for (_, ink, dashes, gid), (t, error) in zip(looks, curves, strict=True):
        ax.plot(t, error * unit.scale, color=ink, linestyle=dashes, linewidth=NARROW if gid == "fitted" else 1.1, gid=gid)
    ax.margins(x=0.0)
    ax.set_ylim(0.0, max(ax.get_ylim()[1], 1e-3 * unit.scale))
    ax.set(xlabel="time [s]", label="position error")
    ax.set_title(f"Position error [{unit.symbol}]", pad=19.0)
    ax.annotate("distance at the same instant", (0.0, 1.0), (0.0, 5.0), xycoords="axes fraction",
                textcoords="offset points", va="bottom", fontsize=8.5, color="0.25")  # fmt: skip


def _path_rows(result: FitData) -> tuple[list[Row], list[str]]:
    """Return rows of paths, and a sentence on what found no room."""
    shown = [_stretch(s, False) for s in result.train[:MAX_TRAIN]]
    shown += [_stretch(s, True) for s in result.held_out[:MAX_HELD_OUT]]
    panels: list[Panel] = [partial(_draw_path, result, stretch) for stretch in shown]
    if shown[0].whole and len(panels) < MAX_ABREAST:
        panels.insert(1, partial(_draw_position_error, result, shown[0].scored))
    abreast = math.ceil(len(panels) / math.ceil(len(panels) / MAX_ABREAST))
    heading = "Paths [m]"
    if not all(stretch.whole for stretch in shown):
        heading = "Paths over the stretch of median error, all laid on the same pose at its start [m]"
    rows = [drawing.text_row(_SECTION_IN, partial(drawing.draw_section, heading))]
    for k in range(0, len(panels), abreast):
        part = panels[k : k + abreast]
        if len(part) == 2 and len(panels) == 2 and shown[0].whole:
            width, height = np.ptp(shown[0].scored.truth[shown[0].piece].xy, axis=0) + 0.5
            share = float(np.clip(0.06 + 0.2 * width / height, 0.36, 0.64))  # by the path's own proportions
            rows.append(Row(_PATHS_IN[2], ((share, part[0]), (1.0 - share, part[1]))))
        else:
            rows.append(drawing.side_by_side(_PATHS_IN[len(part)], part))
    without = [source_text(s) for s in (*result.train[MAX_TRAIN:], *result.held_out[MAX_HELD_OUT:])]
    return rows, [f"Without a picture of their own: {', '.join(without)}."] if without else []


def _horizon_rows(result: FitData) -> list[Row]:
    """Return panels of position and yaw error by horizon, on sources that were fitted to and held out."""
    ink = drawing.ink_of(result.model)
    darker: Ink = (0.55 * ink[0], 0.55 * ink[1], 0.55 * ink[2])
    most = 32 if len(result.held_out) < 3 else 20
    shown: list[tuple[HorizonMarks, Mapping[float, WindowErrors]]] = [
        (HorizonMarks("before the fit", BESIDE_INK, "X", result.before_horizons), {}),
        (HorizonMarks("fitted to", ink, "o", result.train_horizons), result.train_windows),
    ]
    for scored, marker in zip(result.held_out, "DsvP" * len(result.held_out), strict=False):
        name = f"held out: {source_text(scored, most)}"
        shown.append((HorizonMarks(name, darker, marker, scored.horizons), scored.windows))
    shown = [(marks, windows) for marks, windows in shown if marks.errors]
    if not shown:
        return []
    bar = "median, bar to 95th percentile"

    def marks(interval: Callable[[OverlappingErrors], Interval]) -> list[HorizonMarks]:
        return [replace(m, intervals={h: interval(e.summary()) for h, e in windows.items()}) for m, windows in shown]

    def millimetres(errors: HorizonErrors) -> tuple[float, float]:
        return 1e3 * errors.position_median_m, 1e3 * errors.position_p95_m

    panels: list[Panel] = [
        partial(drawing.draw_horizons, marks(_millimetre_interval), f"Position error by horizon [mm]: {bar}", millimetres),
        partial(
            drawing.draw_horizons, marks(drawing.yaw_interval), f"Yaw error by horizon [deg]: {bar}", drawing.yaw_degrees
        ),
    ]
    return [
        drawing.side_by_side(_HORIZON_IN, panels),
        drawing.text_row(_LEGEND_IN, partial(_draw_marks, [m for m, _ in shown])),
    ]


def _millimetre_interval(errors: OverlappingErrors) -> Interval:
    median, low, high = drawing.position_interval(errors)
    return 1e3 * median, 1e3 * low, 1e3 * high


def _draw_marks(marks: Sequence[HorizonMarks], ax: Axes) -> None:
    """Draw the legend of the marks."""
    ax.set_axis_off()
    handles = [
        Line2D([], [], color=m.ink, marker=m.marker, markersize=8.0, markeredgecolor="white", linewidth=2.5) for m in marks
    ]
    drawing.line_legend(ax, handles, [m.name for m in marks])


def fit_figure(result: FitData) -> Figure:
    """Draw a fit, 1600 px wide: course of the search, parameters, correlations, paths, errors by horizon, notes."""
    paths, left_out = _path_rows(result)
    looks = SearchLooks(result, drawing.ink_of(result.model), "Parameters", "before the fit", result.correlation)
    details = [*paths, *_horizon_rows(result)]
    return search_page(partial(_draw_header, result), looks, details, [*fit_notes(result), *left_out])
