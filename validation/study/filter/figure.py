"""The picture of a study of dead reckoning: growth of the errors on every ground, and drift per metre and radian."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.types import FloatArray
from validation.report.drawing import (
    Dashes,
    Ink,
    Panel,
    Row,
    draw_footer,
    draw_section,
    inset,
    line_legend,
    put_together,
    side_by_side,
    text_row,
)
from validation.report.palette import Rgb, mix
from validation.study.filter.findings import CURVE, DRIFT_STRETCH, GroundDrive, filter_variants
from validation.study.filter.result import FilterStudy

_HUES: tuple[Rgb, ...] = ((213, 94, 0), (0, 114, 178), (204, 121, 167), (0, 158, 115), (86, 180, 233), (230, 159, 0))
_INKS: tuple[Ink, ...] = tuple(
    (red / 255.0, green / 255.0, blue / 255.0) for red, green, blue in (mix(hue, (0, 0, 0), 0.1) for hue in _HUES)
)
_DASHES: tuple[Dashes, ...] = ("solid", "solid", (0.0, (5.0, 1.5)), (0.0, (1.8, 1.0)), "solid", (0.0, (5.0, 1.5)))
"""Line styles of the filters, in the order of `filter_variants`."""
_LEAST_M = 1e-3
"""Least error that is drawn [m]: the filter starts with none, and zero has no logarithm."""
_MOST_ABREAST = 5
"""Greatest number of panels beside one another."""

_HEADER_IN, _SECTION_IN, _ROW_IN, _BARS_IN, _FOOTER_IN = 0.84, 0.3, 2.6, 3.0, 0.26


def _draw_header(study: FilterStudy, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "Dead reckoning of the state filter against MuJoCo's truth", transform=ax.transAxes, fontsize=14.0,
            fontweight="bold", va="top")  # fmt: skip
    ax.text(0.0, 0.64, f"{study.heading()} · line: median over seeds, band: all of them", transform=ax.transAxes, va="top",
            color="0.25")  # fmt: skip
    handles: list[Artist] = [
        Line2D([], [], color=ink, linestyle=dashes, linewidth=1.8) for ink, dashes in zip(_INKS, _DASHES, strict=True)
    ]
    line_legend(ax, handles, [_words(study, k) for k in range(len(_INKS))])


def _words(study: FilterStudy, k: int) -> str:
    """Return the name of a filter in the legend."""
    v = filter_variants(study.options.bias)[k]
    if v.bias:
        return f"{'commissioned' if v.commissioned else 'wheels + gyro'}, {v.bias:+g} rad/s of bias"
    if v.radius_known:
        return "wheels + gyro, rolling radius known"
    return v.name if v.gyro else "wheels only"


def _draw_errors(drive: GroundDrive, first: bool, ax: Axes) -> None:
    """Draw the error of the position over the distance, for every filter."""
    along = np.linspace(0.0, drive.distance, CURVE)
    for (name, reckoned), ink, dashes in zip(drive.filters.items(), _INKS, _DASHES, strict=True):
        errors: FloatArray = np.maximum(reckoned.errors, _LEAST_M)
        ax.fill_between(along, errors.min(axis=0), errors.max(axis=0), color=ink, alpha=0.22, linewidth=0.0, zorder=2.0)
        ax.plot(along, np.median(errors, axis=0), color=ink, linestyle=dashes, linewidth=1.5, zorder=2.5, gid=name)
    ax.set_yscale("log")
    ax.set(xlabel="driven [m]", xlim=(0.0, drive.distance), ylim=(_LEAST_M, 5.0))
    ax.set_title(drive.surface.replace(", friction", ", μ"), fontsize=9.5)
    ax.yaxis.set_major_formatter(lambda y, _: f"{y:g}")
    if first:
        ax.set_ylabel("position error [m]")
    else:
        ax.tick_params(labelleft=False)


def _draw_bars(study: FilterStudy, field: str, title: str, ax: Axes) -> None:
    """Draw the drift in percent by drive and filter, on a logarithmic scale."""
    inset(ax, left=1.35)
    drives, names = study.drives, [v.name for v in filter_variants(study.options.bias)]
    for row, drive in enumerate(drives):
        for k, name in enumerate(names):
            mean = 100.0 * drive.filters[name].mean(field)
            if math.isfinite(mean) and mean > 0.0:
                y = row + 0.14 * (k - 0.5 * (len(names) - 1))
                ax.plot([mean], [y], "o", color=_INKS[k], markersize=5.5, markeredgecolor="white", markeredgewidth=0.5)
                ax.plot([1e-3, mean], [y, y], color=_INKS[k], linewidth=0.9, alpha=0.45, zorder=1.8)
    ax.set_xscale("log")
    ax.set(xlim=(0.03, 300.0), xlabel=title, ylim=(len(drives) - 0.4, -0.6))
    labels = [f"{d.reference} · {d.surface.replace(', friction', ', μ')}" for d in drives]
    ax.set_yticks(range(len(drives)), labels, fontsize=8.5)
    ax.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    ax.grid(visible=False, axis="y")


def _drive_rows(study: FilterStudy, reference: str) -> list[Row]:
    """Return a heading and the panels of one reference."""
    drives = [d for d in study.drives if d.reference == reference]
    rows = [text_row(_SECTION_IN, partial(draw_section, f"{reference}, {drives[0].distance:.1f} m: error of the position"))]
    for k in range(0, len(drives), _MOST_ABREAST):
        panels: list[Panel] = [partial(_draw_errors, d, i == 0) for i, d in enumerate(drives[k : k + _MOST_ABREAST])]
        rows.append(side_by_side(_ROW_IN, panels))
    return rows


def draw_filter(study: FilterStudy) -> Figure:
    """Return the picture of a study of dead reckoning, 1600 px wide."""
    bars: list[Panel] = [
        partial(_draw_bars, study, "position", "position [% of the distance]"),
        partial(_draw_bars, study, "yaw", "yaw [% of what was turned]"),
    ]
    height = _BARS_IN * max(1.0, len(study.drives) / 10.0)
    versions = study.versions
    footer = (
        f"step {study.options.timestep:g} s · mujoco {versions.get('mujoco', '?')} · "
        f"ssmr-testbed {versions.get('ssmr-testbed', '?')} · python -m validation.study filter"
    )
    rows = [
        text_row(_HEADER_IN, partial(_draw_header, study)),
        Row(0.1, ()),
        *(row for reference in study.references for row in _drive_rows(study, reference)),
        text_row(_SECTION_IN, partial(draw_section, f"Drift over stretches of {DRIFT_STRETCH:g} m")),
        side_by_side(height, bars),
        text_row(_FOOTER_IN, partial(draw_footer, footer)),
    ]
    return put_together(rows)
