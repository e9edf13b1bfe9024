"""The picture of a study of a drive train: wheel rates, currents, the slip law, and the charge of transients."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.robot.drivetrain import grip
from validation.report.drawing import (
    DASHED,
    Ink,
    Panel,
    Row,
    corner_note,
    draw_footer,
    draw_section,
    inset,
    line_legend,
    put_together,
    side_by_side,
    text_row,
)
from validation.study.drivetrain.inertia import INERTIA_GRID, InertiaFit
from validation.study.drivetrain.obedience import RateFit
from validation.study.drivetrain.result import DriveTrainStudy
from validation.study.drivetrain.selection import CurrentFit

_LOGGED: Ink = "0.55"
_SIDES: tuple[Ink, Ink] = ("#0072b2", "#d55e00")
_HELD_OUT: Ink = "#009e73"
_BREAK = 1.0
"""Samples further apart than this are not joined by a line [s]."""
_HEADER_IN, _SECTION_IN, _TRACE_IN, _ROW_IN, _FOOTER_IN = 0.84, 0.3, 2.3, 3.1, 0.26


def _draw_header(study: DriveTrainStudy, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "The drive train", transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    ax.text(0.0, 0.64, study.heading(), transform=ax.transAxes, va="top", color="0.25")
    handles: list[Artist] = [Line2D([], [], color=_LOGGED, linewidth=3.5)]
    handles += [Line2D([], [], color=ink, linewidth=1.5) for ink in _SIDES]
    words = ["logged", "predicted, left", "predicted, right"]
    if study.friction is not None:
        handles += [Line2D([], [], color=ink, marker="o", linestyle="none", markersize=5.0) for ink in (_LOGGED, _HELD_OUT)]
        words += ["fitted", "held out"]
    line_legend(ax, handles, words)


def _draw_rates(fit: RateFit, ax: Axes) -> None:
    t, logged, predicted = fit.shown
    for side in (0, 1):
        ax.plot(t, logged[side], color=_LOGGED, linewidth=3.5, alpha=0.6, zorder=2.0, gid="logged")
        ax.plot(t, predicted[side], color=_SIDES[side], linewidth=1.3, zorder=2.5, gid="predicted")
    ax.set(xlabel="time [s]", ylabel="wheel rate [rad/s]", xlim=(t[0], t[-1]))


def _draw_current_trace(fit: CurrentFit, ax: Axes) -> None:
    samples, predicted = fit.rows
    for side in (0, 1):
        mine = samples.side == side
        t = samples.t[mine]
        apart = np.flatnonzero(np.diff(t) > (_BREAK if fit.windows else 3.0 * _BREAK)) + 1
        for values, ink, width in ((samples.current, _LOGGED, 2.5), (predicted, _SIDES[side], 1.5)):
            joined, at = np.insert(values[mine], apart, np.nan), np.insert(t, apart, np.nan)
            ax.plot(at, joined, color=ink, linewidth=width, alpha=0.6 if ink == _LOGGED else 1.0, gid="current")
    ax.set(xlabel="time [s]", ylabel="current [A]", xlim=(samples.t.min(), samples.t.max()))


def _draw_currents(fit: CurrentFit, ax: Axes) -> None:
    for (measured, predicted), ink in zip(fit.shown, (_LOGGED, _HELD_OUT), strict=True):
        ax.plot(measured, predicted, "o", color=ink, markersize=5.0, alpha=0.8, markeredgecolor="white", markeredgewidth=0.4)
    ends = [min(x.min() for pair in fit.shown for x in pair), max(x.max() for pair in fit.shown for x in pair)]
    ax.plot(ends, ends, color="0.2", linewidth=0.8, linestyle=DASHED)
    ax.set(title="Currents in steady driving", xlabel="measured [A]", ylabel="predicted [A]")
    corner_note(ax, f"R² {fit.best.held_out:.2f} held out")


def _draw_rules(fit: CurrentFit, ax: Axes) -> None:
    inset(ax, left=1.5)
    for k, s in enumerate(fit.scores):
        ax.barh(k, s.held_out, height=0.6, color=_HELD_OUT, alpha=1.0 if s is fit.best else 0.45)
        ax.text(max(s.held_out, 0.0) + 0.02, k, f"{s.held_out:.2f}", va="center", fontsize=9.0)
    ax.set_yticks(range(len(fit.scores)), [s.rule.name.replace(", ", ",\n") for s in fit.scores], fontsize=8.5)
    least = min(0.0, *(s.held_out for s in fit.scores))
    ax.set(title="Whose currents?", xlabel="R² held out", xlim=(max(least, -1.0), 1.18), ylim=(len(fit.scores) - 0.4, -0.6))
    ax.grid(visible=False, axis="y")


def _draw_slip(fit: CurrentFit, ax: Axes) -> None:
    scale, error = fit.numbers["slip_scale"], fit.errors["slip_scale"]
    slip = np.linspace(0.0, max(0.5, 5.0 * scale), 200)
    ax.plot(slip, grip(slip, scale), color=_SIDES[0], linewidth=1.8, gid="slip law")
    low, high = (grip(slip, max(scale + sign * error, 0.1 * scale)) for sign in (1.96, -1.96))
    ax.fill_between(slip, low, high, color=_SIDES[0], alpha=0.25, linewidth=0.0)
    ax.plot([0.0, 0.0, slip[-1]], [0.0, 1.0, 1.0], color="0.2", linewidth=1.0, linestyle=DASHED)
    ax.text(slip[-1], 0.97, "Coulomb", ha="right", va="top", fontsize=9.0)
    ax.set(title="Contacts that give way", xlabel="slip over rolling speed", ylabel="force over its limit", ylim=(0.0, 1.08))
    corner_note(ax, f"slip scale {scale:.3f} ± {error:.3f}")


def _draw_inertia(fit: InertiaFit, ax: Axes) -> None:
    for x in fit.transients:
        charge = x.measured - x.predicted[0]
        ink = _SIDES[1] if x.reversal else _SIDES[0]
        ax.plot([x.change], [charge], "v" if x.reversal else "^", color=ink, markersize=5.5, alpha=0.8, gid="transient")
    reach = np.array([0.0, max(x.change for x in fit.transients)])
    for reversal, ink in ((False, _SIDES[0]), (True, _SIDES[1])):
        some = [x for x in fit.transients if x.reversal == reversal]
        if some:
            change = np.array([x.change for x in some])
            charge = np.array([np.interp(fit.value, INERTIA_GRID, x.predicted) - x.predicted[0] for x in some])
            ax.plot(reach, float(charge @ change / (change @ change)) * reach, color=ink, linewidth=1.3)
    ax.set(title="▲ speeding up, ▼ reversing", xlabel="change of wheel rate [rad/s]", ylabel="charge above losses [A s]")
    ax.margins(y=0.2)
    corner_note(ax, f"J/K {fit.value:.2f} ± {fit.standard_error:.2f} A s²/rad")


def draw_drivetrain(study: DriveTrainStudy) -> Figure:
    """Return the picture of a study of a drive train, 1600 px wide."""
    driver, friction, inertia = study.driver, study.friction, study.inertia
    rows = [text_row(_HEADER_IN, partial(_draw_header, study)), Row(0.1, ())]
    if driver is not None:
        words = f"Wheel rates from commands, held out: {driver.rms:.3f} rad/s rms"
        rows.append(text_row(_SECTION_IN, partial(draw_section, words)))
        rows.append(side_by_side(_TRACE_IN, [partial(_draw_rates, driver)]))
    panels: list[tuple[float, Panel]] = []
    if friction is not None:
        words = f"Currents in steady driving, held out: R² {friction.best.rows:.2f}, sample by sample"
        rows.append(text_row(_SECTION_IN, partial(draw_section, words)))
        rows.append(side_by_side(_TRACE_IN, [partial(_draw_current_trace, friction)]))
        panels += [(1.0, partial(_draw_currents, friction)), (1.35, partial(_draw_rules, friction))]
        if "slip_scale" in friction.numbers:
            panels.append((0.95, partial(_draw_slip, friction)))
    if inertia is not None:
        panels.append((1.0, partial(_draw_inertia, inertia)))
    if panels:
        whole = sum(share for share, _ in panels)
        rows += [Row(0.1, ()), Row(_ROW_IN, tuple((share / whole, panel) for share, panel in panels))]
    versions = study.versions
    footer = (
        f"{study.options.resamples} resamples, seed {study.options.seed} · ssmr-testbed "
        f"{versions.get('ssmr-testbed', '?')} · python -m validation.study drivetrain"
    )
    return put_together([*rows, text_row(_FOOTER_IN, partial(draw_footer, footer))])
