"""The picture of a robustness study: how each controller's errors spread, and what each mismatch alone does to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from validation.show.drawing import (
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
from validation.study.robustness.cases import NOMINAL, single_mismatches
from validation.study.robustness.outcomes import CVAR_LEVEL, RunErrors, cvar
from validation.study.robustness.result import Robustness

_HEADER_IN, _SECTION_IN, _SPREAD_IN, _FOOTER_IN, _LABELS_IN = 0.84, 0.3, 3.2, 0.26, 0.95
_ALONE_IN, _LINE_IN = 0.95, 0.19  # a row of single mismatches: what it needs besides them, and for each

_Value = Callable[[RunErrors], float]
_MEASURES: tuple[tuple[str, _Value], ...] = (("d_rms", lambda o: o.d_rms_m), ("e_rho rms", lambda o: o.e_rho_rms_m))


def _draw_header(study: Robustness, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "Trackers on robots that differ from their profile", transform=ax.transAxes, fontsize=14.0,
            fontweight="bold", va="top")  # fmt: skip
    ax.text(0.0, 0.64, study.heading(), transform=ax.transAxes, va="top", color="0.25")
    handles: list[Artist] = [Line2D([], [], color=controller_ink(name), linewidth=2.0) for name in study.controllers]
    labels = []
    for name, tested in study.controllers.items():
        grid = study.errors(name, "grid")
        own = tested.gains.name.removeprefix(f"{name}-")
        labels.append(f"{name}, {own}: {study.failures(grid)} of {len(grid)} failed")
    line_legend(ax, handles, labels)


def _logarithmic(ax: Axes, values: Sequence[float]) -> None:
    """Set a logarithmic abscissa in millimetres that covers values [m] with some room."""
    low, high = 1e3 * max(min(values), 1e-4), 1e3 * max(*values, 2e-4)
    ax.set_xscale("log")
    ax.set_xlim(low / 1.35, high * 1.35)
    plain_ticks(ax.xaxis, (1.0, 2.0, 5.0) if high < 20.0 * low else (1.0, 3.0))


def _draw_spread(study: Robustness, name: str, value: _Value, ax: Axes) -> None:
    """Draw the share of runs whose error is below each abscissa, with a diamond at the mean of the worse half."""
    every = []
    for controller in study.controllers:
        outcomes = sorted(study.errors(controller, "grid"), key=value)
        errors = [value(o) for o in outcomes]
        share = np.arange(1, len(errors) + 1) / len(errors)
        every += errors
        ax.step([1e3 * errors[0], *(1e3 * e for e in errors)], [0.0, *share], where="post", color=controller_ink(controller),
                linewidth=1.7, gid=controller)  # fmt: skip
        lost = [(1e3 * e, s) for e, s, o in zip(errors, share, outcomes, strict=True) if o.lost_at_s is not None]
        if lost:
            ax.plot(*np.array(lost).T, "x", color=ALARM, markersize=5.0, zorder=3.0, gid=f"{controller} lost")
        ax.plot(1e3 * cvar(errors), 0.5 * (1.0 + CVAR_LEVEL), "D", color=controller_ink(controller), markersize=6.5,
                markeredgecolor="white", markeredgewidth=0.8, zorder=3.5)  # fmt: skip
    _logarithmic(ax, every)
    bound = 1e3 * study.options.bound
    if ax.get_xlim()[1] > bound:
        ax.axvline(bound, color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0)), zorder=1.8)
    ax.set(xlabel=f"{name} [mm]", ylim=(0.0, 1.02), ylabel="share of runs")


def _draw_alone(study: Robustness, controller: str, value: _Value, name: str, first: bool, ax: Axes) -> None:
    """Draw a controller's errors under each mismatch alone, as bars from the nominal robot's mean."""
    if first:
        inset(ax, left=_LABELS_IN)
    cases: list[tuple[str, list[RunErrors]]] = [(NOMINAL, study.errors(controller, "nominal"))]
    cases += [(m.label, study.errors(controller, "alone", m)) for m in single_mismatches(study.levels)]
    centre = 1e3 * float(np.mean([value(o) for o in cases[0][1]]))
    ax.axvline(centre, color="0.25", linewidth=1.0, zorder=1.9)
    for row, (_, outcomes) in enumerate(cases):
        errors = [value(o) for o in outcomes]
        mean = 1e3 * float(np.mean(errors))
        ax.barh(row, mean - centre, left=centre, height=0.62, color=controller_ink(controller), alpha=0.55, zorder=2.0)
        for outcome, error in zip(outcomes, errors, strict=True):
            failed = outcome.failed(study.options.bound)
            ax.plot(1e3 * error, row, "x" if failed else ".", color=ALARM if failed else "0.15", zorder=3.0,
                    markersize=5.0 if failed else 4.0)  # fmt: skip
    _logarithmic(ax, [value(o) for c in study.controllers for kind in ("nominal", "alone") for o in study.errors(c, kind)])
    ax.set(xlabel=f"{name} [mm]", ylim=(len(cases) - 0.4, -0.6))
    ax.set_title(controller, color=controller_ink(controller))
    ax.set_yticks(range(len(cases)), [label for label, _ in cases] if first else [""] * len(cases), fontsize=9.0)
    ax.grid(visible=False, axis="y")


def _alone_row(study: Robustness, name: str, value: _Value) -> Row:
    """Return a row with a panel for each controller; the first names the mismatches."""
    labels = _LABELS_IN / 12.5
    share = (1.0 - labels) / len(study.controllers)
    panels: list[tuple[float, Panel]] = []
    for k, controller in enumerate(study.controllers):
        panels.append((share + labels * (k == 0), partial(_draw_alone, study, controller, value, name, k == 0)))
    return Row(_ALONE_IN + _LINE_IN * (1 + len(single_mismatches(study.levels))), tuple(panels))


def draw_robustness(study: Robustness) -> Figure:
    """Draw the spread of each controller's errors, and its errors under each mismatch alone, 1600 px wide."""
    spreads: list[Panel] = [partial(_draw_spread, study, name, value) for name, value in _MEASURES]
    title = (
        f"{study.combined} combinations of mismatches: share of runs below an error. Diamond: mean of the worse half; "
        "cross: lost; dashed line: beyond it a run counts as failed"
    )
    rows = [
        text_row(_HEADER_IN, partial(_draw_header, study)),
        Row(0.1, ()),
        text_row(_SECTION_IN, partial(draw_section, title)),
        side_by_side(_SPREAD_IN, spreads),
    ]
    for name, value in _MEASURES:
        title = (
            f"{name} under each mismatch alone. Bar: from the nominal robot's mean to the mean of {study.options.seeds} "
            "seeds; dot: one seed; cross: failed"
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
