"""The picture of a robustness study: how each controller's errors spread, and what each mismatch alone does to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from validation.bench.mismatch import NOMINAL, WORST, worst_mean
from validation.report.drawing import (
    ALARM,
    QUIET,
    Panel,
    Row,
    controller_ink,
    draw_footer,
    draw_section,
    inset,
    line_legend,
    note_rows,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.study.robustness.outcomes import RunErrors
from validation.study.robustness.result import Robustness

_HEADER_IN, _LEGEND_IN, _SECTION_IN, _SPREAD_IN, _FOOTER_IN, _LABELS_IN = 0.56, 0.24, 0.3, 3.2, 0.26, 1.2
_ALONE_IN, _LINE_IN = 0.95, 0.19  # a row of single mismatches: what it needs besides them, and for each

_Value = Callable[[RunErrors], float]
_MEASURES: tuple[tuple[str, _Value], ...] = (("d_rms", lambda o: o.d_rms_m), ("e_rho rms", lambda o: o.e_rho_rms_m))


_LINES = ("-", (0.0, (1.0, 1.2)), (0.0, (4.0, 1.6)), (0.0, (4.0, 1.5, 1.0, 1.5)))
_MARKS = ("o", "s", "D", "v")
"""Lines and marks of a controller's sets of gains: the last set has the first of them."""


def _places(study: Robustness) -> dict[str, int]:
    """Return the place of each set of gains among its controller's, counted from the last."""
    places: dict[str, int] = {}
    count: dict[str, int] = {}
    for name, runs in reversed(list(study.controllers.items())):
        places[name] = count.get(runs.gains.controller, 0) % len(_LINES)
        count[runs.gains.controller] = places[name] + 1
    return places


def _draw_header(study: Robustness, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "Trackers on robots that differ from their profile", transform=ax.transAxes, fontsize=14.0,
            fontweight="bold", va="top")  # fmt: skip
    ax.text(0.0, 0.64, study.heading(), transform=ax.transAxes, va="top", color="0.25")


def _draw_legend(study: Robustness, names: Sequence[str], ax: Axes) -> None:
    """Draw lines and marks of some sets of gains, with the number of drawn robots that each failed with."""
    ax.set_axis_off()
    handles: list[Artist] = []
    labels, places = [], _places(study)
    for name in names:
        runs, drawn, place = study.controllers[name], study.errors(name, "drawn"), places[name]
        ink, face = controller_ink(runs.gains.controller), "white" if place else None
        looks: dict[str, Any] = {"linestyle": _LINES[place], "marker": _MARKS[place], "markerfacecolor": face}
        handles.append(Line2D([], [], color=ink, linewidth=2.0, markersize=6.0, **looks))
        lost = sum(e.lost_at_s is not None for e in drawn)
        labels.append(f"{runs.gains.name}: {lost} lost, {study.failures(drawn)} of {len(drawn)} failed")
    line_legend(ax, handles, labels)


def _logarithmic(ax: Axes, values: Sequence[float]) -> None:
    """Set a logarithmic abscissa in millimetres that covers values [m] with some room."""
    low, high = 1e3 * max(min(values), 1e-4), 1e3 * max(*values, 2e-4)
    ax.set_xscale("log")
    ax.set_xlim(low / 1.35, high * 1.35)
    plain_ticks(ax.xaxis, (1.0, 2.0, 5.0) if high < 20.0 * low else (1.0, 3.0))


def _draw_spread(study: Robustness, name: str, value: _Value, ax: Axes) -> None:
    """Draw the share of runs whose error is below each abscissa, with a mark at the mean of the worst fifth."""
    every, places = [], _places(study)
    for which, runs in study.controllers.items():
        outcomes = sorted(study.errors(which, "drawn"), key=value)
        errors = [value(o) for o in outcomes]
        share = np.arange(1, len(errors) + 1) / len(errors)
        every += errors
        ink, place = controller_ink(runs.gains.controller), places[which]
        ax.step([1e3 * errors[0], *(1e3 * e for e in errors)], [0.0, *share], where="post", color=ink,
                linewidth=1.7, linestyle=_LINES[place], gid=which)  # fmt: skip
        lost = [(1e3 * e, s) for e, s, o in zip(errors, share, outcomes, strict=True) if o.lost_at_s is not None]
        if lost:
            ax.plot(*np.array(lost).T, "x", color=ALARM, markersize=5.0, zorder=3.0, gid=f"{which} lost")
        ax.plot(1e3 * float(worst_mean(errors)), 1.0 - 0.5 * WORST, _MARKS[place], color=ink, markersize=6.5, zorder=3.5,
                markerfacecolor="white" if place else ink)  # fmt: skip
    _logarithmic(ax, every)
    bound = 1e3 * study.options.bound
    if ax.get_xlim()[1] > bound:
        ax.axvline(bound, color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0)), zorder=1.8)
    ax.set(xlabel=f"{name} [mm]", ylim=(0.0, 1.02), ylabel="share of runs")


def _draw_alone(study: Robustness, controller: str, value: _Value, name: str, first: bool, ax: Axes) -> None:
    """Draw the mean errors of a controller's sets of gains under each mismatch alone."""
    if first:
        inset(ax, left=_LABELS_IN)
    labels, places, every = [NOMINAL, *(m.label for m in study.single)], _places(study), []
    for which, runs in study.controllers.items():
        groups = [study.errors(which, "nominal"), *(study.errors(which, "alone", m) for m in study.single)]
        means = [float(np.mean([value(o) for o in outcomes])) for outcomes in groups]
        every += means
        if runs.gains.controller != controller:
            continue
        for row, (mean, outcomes) in enumerate(zip(means, groups, strict=True)):
            ink = ALARM if study.failures(outcomes) else controller_ink(controller)
            ax.plot(1e3 * mean, row, _MARKS[places[which]], color=ink, markersize=5.5, zorder=3.0 - 0.1 * places[which],
                    markerfacecolor="white" if places[which] else ink, gid=which)  # fmt: skip
    _logarithmic(ax, every)
    ax.set(xlabel=f"{name} [mm]", ylim=(len(labels) - 0.4, -0.6))
    ax.set_title(controller, color=controller_ink(controller))
    ax.set_yticks(range(len(labels)), labels if first else [""] * len(labels), fontsize=9.0)


def _alone_row(study: Robustness, name: str, value: _Value) -> Row:
    """Return a row with a panel for each controller; the first names the mismatches."""
    labels = _LABELS_IN / 12.5
    controllers = list(dict.fromkeys(runs.gains.controller for runs in study.controllers.values()))
    share = (1.0 - labels) / len(controllers)
    panels: list[tuple[float, Panel]] = []
    for k, controller in enumerate(controllers):
        panels.append((share + labels * (k == 0), partial(_draw_alone, study, controller, value, name, k == 0)))
    return Row(_ALONE_IN + _LINE_IN * (1 + len(study.single)), tuple(panels))


def draw_robustness(study: Robustness) -> Figure:
    """Draw the spread of each set's errors, and its errors under each mismatch alone, 1600 px wide."""
    spreads: list[Panel] = [partial(_draw_spread, study, name, value) for name, value in _MEASURES]
    title = (
        f"{study.drawn} robots drawn at random: share of runs below an error. Mark: mean of the worst fifth; cross: lost; "
        "dashed line: beyond it a run counts as failed"
    )
    names: dict[str, list[str]] = {}
    for name, runs in study.controllers.items():
        names.setdefault(runs.gains.controller, []).append(name)
    rows = [
        text_row(_HEADER_IN, partial(_draw_header, study)),
        *(text_row(_LEGEND_IN, partial(_draw_legend, study, some)) for some in names.values()),
        text_row(_SECTION_IN, partial(draw_section, title)),
        side_by_side(_SPREAD_IN, spreads),
    ]
    for name, value in _MEASURES:
        title = (
            f"{name} under each mismatch alone: mean over seeds of noise ({study.options.seeds}); red: one of them failed"
        )
        rows += [text_row(_SECTION_IN, partial(draw_section, title)), _alone_row(study, name, value)]
    o, versions = study.options, study.versions
    footer = (
        f"{study.of_profile(study.profile)} · step {o.timestep:g} s · {o.feedback} feedback · seed {o.seed} · "
        f"mujoco {versions.get('mujoco', '?')} · ssmr-testbed {versions.get('ssmr-testbed', '?')}"
    )
    rows += note_rows(study.notes())
    rows.append(text_row(_FOOTER_IN, partial(draw_footer, footer)))
    return put_together(rows)
