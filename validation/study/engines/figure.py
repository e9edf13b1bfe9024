"""The picture of a study of engines: multiplier over heading, paths on the spot, distances on trajectories."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation.report.drawing import (
    Ink,
    Row,
    draw_footer,
    ink_of,
    inset,
    note_rows,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.study.engines.bench import BINS, TriedEngine
from validation.study.engines.result import EnginesStudy

_HEADER_IN, _PANEL_IN, _FOOTER_IN, _ROW_IN = 0.62, 3.6, 0.26, 0.2
_DASHES = ("-", "--", ":", "-.")


def _draw_header(study: EnginesStudy, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "One robot in several engines", transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    ax.text(0.0, 0.45, study.heading(), va="top", transform=ax.transAxes, color="0.25")


def _lines(study: EnginesStudy) -> list[tuple[TriedEngine, str, Ink]]:
    """Return the variants that have a multiplier, each with a line style and a shade that differ within its engine."""
    seen: dict[str, int] = {}
    found: list[tuple[TriedEngine, str, Ink]] = []
    for t in study.tried:
        if t.measures.multiplier is not None:
            seen[t.variant.group] = seen.get(t.variant.group, -1) + 1
            again, style = divmod(seen[t.variant.group], len(_DASHES))
            red, green, blue = (1.0 - (1.0 - part) / (1.0 + 0.8 * again) for part in ink_of(t.variant.group))
            found.append((t, _DASHES[style], (red, green, blue)))
    return found


def _draw_headings(study: EnginesStudy, ax: Axes) -> None:
    at = (np.arange(BINS) + 0.5) * 360.0 / BINS
    for t, dashes, ink in _lines(study):
        ax.plot(at, t.by_heading, dashes, color=ink, linewidth=1.3, gid=f"heading {t.variant.key}")
    ax.set(xlabel="heading [deg]", xlim=(0.0, 360.0), xticks=range(0, 361, 45), ylim=(0.8, 4.0))
    ax.set_title("multiplier over the heading, on the spot", fontsize=9.5)


def _draw_paths(study: EnginesStudy, ax: Axes) -> None:
    for t, dashes, ink in _lines(study):
        ax.plot(100.0 * t.path[:, 0], 100.0 * t.path[:, 1], dashes, color=ink, linewidth=1.1)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x of the robot's middle [cm]", ylabel="y [cm]")
    ax.set_title("path of the middle, 14 s on the spot", fontsize=9.5)


def _draw_distances(study: EnginesStudy, ax: Axes) -> None:
    """Draw what lies on a logarithmic scale: d_rms from the improved model, and errors against the recording."""
    inset(ax, left=2.4)
    for row, t in enumerate(study.tried):
        ink, m = ink_of(t.variant.group), t.measures
        each = [1e3 * d for d in m.d_rms_m.values()]
        ax.plot(each, [row] * len(each), "o", color=ink, markersize=5.0, alpha=0.75, markeredgewidth=0.0)
        for value, marker in ((m.wheels_m, "s"), (m.commands_m, "D")):
            if value is not None:
                ax.plot([1e3 * value], [row + 0.22], marker, color="0.15", markersize=4.5, fillstyle="none")
    ax.set_xscale("log")
    plain_ticks(ax.xaxis, (1.0, 2.0, 5.0))
    labels = [t.variant.key for t in study.tried]
    ax.set_yticks(range(len(labels)), labels, fontsize=8.0)
    ax.set(ylim=(len(labels) - 0.4, -0.6))
    ax.set_xlabel(
        "[mm]; dots: d_rms from the improved model on trajectories 1–4; squares, diamonds: recording by wheels, commands"
    )
    ax.grid(visible=False, axis="y")


def _draw_key(study: EnginesStudy, ax: Axes) -> None:
    ax.set_axis_off()
    for row, (t, dashes, ink) in enumerate(_lines(study)):
        y = 1.0 - (row + 0.7) / (len(study.tried) + 0.5)
        ax.plot([0.0, 0.1], [y, y], dashes, color=ink, linewidth=1.6, transform=ax.transAxes, clip_on=False)
        ax.text(0.13, y, t.variant.key, transform=ax.transAxes, va="center", fontsize=7.5)


def draw_engines(study: EnginesStudy) -> Figure:
    """Return the picture, 1600 px wide."""
    rows = [
        text_row(_HEADER_IN, partial(_draw_header, study)),
        Row(0.1, ()),
        side_by_side(_PANEL_IN, [partial(f, study) for f in (_draw_headings, _draw_paths, _draw_key)]),
        side_by_side(1.2 + 1.5 * _ROW_IN * len(study.tried), [partial(_draw_distances, study)]),
        *note_rows(study.notes()),
        text_row(_FOOTER_IN, partial(draw_footer, study.made_by)),
    ]
    return put_together(rows)
