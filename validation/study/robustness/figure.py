"""A study of robustness as one picture: how errors spread for each controller, and which mismatch breaks which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from validation.show.drawing import (
    ALARM,
    QUIET,
    Ink,
    Panel,
    Row,
    draw_footer,
    draw_section,
    inset,
    line_legend,
    note_rows,
    put_together,
    side_by_side,
    text_row,
)
from validation.show.palette import Rgb, mix
from validation.study.robustness.run import CVAR_LEVEL, NOMINAL, Outcome, Robustness, alone, cvar, heading, remarks

HUES: Mapping[str, Rgb] = MappingProxyType(
    {"pid": (213, 94, 0), "lqr": (0, 114, 178), "lqr-scheduled": (0, 158, 115), "smc": (204, 121, 167)}
)
"""Red, green, blue, 0-255, by controller."""

_HEADER_IN, _SECTION_IN, _SPREAD_IN, _FOOTER_IN, _LABELS_IN = 0.84, 0.3, 3.2, 0.26, 0.95
_ALONE_IN, _LINE_IN = 0.95, 0.19  # a row of single mismatches: what it needs besides them, and for each

Value = Callable[[Outcome], float]
MEASURES: tuple[tuple[str, Value], ...] = (("d_rms", lambda o: o.d_rms_m), ("e_rho rms", lambda o: o.e_rho_rms_m))


def ink_of(controller: str) -> Ink:
    """A controller's colour for lines on white."""
    red, green, blue = mix(HUES.get(controller, (128, 128, 128)), (0, 0, 0), 0.1)
    return red / 255.0, green / 255.0, blue / 255.0


def _draw_header(study: Robustness, ax: Axes) -> None:
    ax.set_axis_off()
    ax.text(0.0, 1.0, "Trackers on robots that are not the one they expect", transform=ax.transAxes, fontsize=14.0,
            fontweight="bold", va="top")  # fmt: skip
    ax.text(0.0, 0.64, heading(study), transform=ax.transAxes, va="top", color="0.25")
    handles: list[Artist] = [Line2D([], [], color=ink_of(name), linewidth=2.0) for name in study.tested]
    labels = []
    for name, tested in study.tested.items():
        grid = study.outcomes(name, "grid")
        own = tested.gains.name.removeprefix(f"{name}-")
        labels.append(f"{name}, {own}: {study.failures(grid)} of {len(grid)} failed")
    line_legend(ax, handles, labels)


def _logarithmic(ax: Axes, values: Sequence[float]) -> None:
    """A logarithmic abscissa in millimetres that shows values [m] and some room."""
    low, high = 1e3 * max(min(values), 1e-4), 1e3 * max(*values, 2e-4)
    ax.set_xscale("log")
    ax.set_xlim(low / 1.35, high * 1.35)
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 20.0 * low else (1.0, 3.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def _draw_spread(study: Robustness, name: str, value: Value, ax: Axes) -> None:
    """Share of the sample of the grid whose error is at most so great; a diamond at the mean of the worse half."""
    every = []
    for controller in study.tested:
        outcomes = sorted(study.outcomes(controller, "grid"), key=value)
        errors = [value(o) for o in outcomes]
        share = np.arange(1, len(errors) + 1) / len(errors)
        every += errors
        ax.step([1e3 * errors[0], *(1e3 * e for e in errors)], [0.0, *share], where="post", color=ink_of(controller),
                linewidth=1.7, gid=controller)  # fmt: skip
        lost = [(1e3 * e, s) for e, s, o in zip(errors, share, outcomes, strict=True) if o.lost_at_s is not None]
        if lost:
            ax.plot(*np.array(lost).T, "x", color=ALARM, markersize=5.0, zorder=3.0, gid=f"{controller} lost")
        ax.plot(1e3 * cvar(errors), 0.5 * (1.0 + CVAR_LEVEL), "D", color=ink_of(controller), markersize=6.5,
                markeredgecolor="white", markeredgewidth=0.8, zorder=3.5)  # fmt: skip
    _logarithmic(ax, every)
    bound = 1e3 * study.settings.bound
    if ax.get_xlim()[1] > bound:
        ax.axvline(bound, color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0)), zorder=1.8)
    ax.set(xlabel=f"{name} [mm]", ylim=(0.0, 1.02), ylabel="share of runs")


def _draw_alone(study: Robustness, controller: str, value: Value, name: str, first: bool, ax: Axes) -> None:
    """A controller's errors under each mismatch alone, from those of the nominal robot on."""
    cases: list[tuple[str, list[Outcome]]] = [(NOMINAL, study.outcomes(controller, "nominal"))]
    cases += [(m.label, study.outcomes(controller, "alone", m)) for m in alone()]
    centre = 1e3 * float(np.mean([value(o) for o in cases[0][1]]))
    ax.axvline(centre, color="0.25", linewidth=1.0, zorder=1.9)
    for row, (_, outcomes) in enumerate(cases):
        errors = [value(o) for o in outcomes]
        mean = 1e3 * float(np.mean(errors))
        ax.barh(row, mean - centre, left=centre, height=0.62, color=ink_of(controller), alpha=0.55, zorder=2.0)
        for outcome, error in zip(outcomes, errors, strict=True):
            failed = outcome.failed(study.settings.bound)
            ax.plot(1e3 * error, row, "x" if failed else ".", color=ALARM if failed else "0.15", zorder=3.0,
                    markersize=5.0 if failed else 4.0)  # fmt: skip
    _logarithmic(ax, [value(o) for c in study.tested for kind in ("nominal", "alone") for o in study.outcomes(c, kind)])
    ax.set(xlabel=f"{name} [mm]", ylim=(len(cases) - 0.4, -0.6))
    ax.set_title(controller, color=ink_of(controller))
    ax.set_yticks(range(len(cases)), [label for label, _ in cases] if first else [""] * len(cases), fontsize=9.0)
    ax.grid(visible=False, axis="y")


def _alone_row(study: Robustness, name: str, value: Value) -> Row:
    """A panel for each controller, the first with what the rows mean."""
    count = len(study.tested)
    labels = _LABELS_IN / 12.5
    share = (1.0 - labels) / count
    panels: list[tuple[float, Panel]] = []
    for k, controller in enumerate(study.tested):

        def draw(ax: Axes, k: int = k, controller: str = controller) -> None:
            if k == 0:
                inset(ax, left=_LABELS_IN)
            _draw_alone(study, controller, value, name, k == 0, ax)

        panels.append((share + labels if k == 0 else share, draw))
    return Row(_ALONE_IN + _LINE_IN * (1 + len(alone())), tuple(panels))


def draw_robustness(study: Robustness) -> Figure:
    """Everything about a study of robustness that can be seen in one look, 1600 px wide."""
    spreads: list[Panel] = [partial(_draw_spread, study, name, value) for name, value in MEASURES]
    grid = sum(c.kind == "grid" for c in study.cases)
    title = (
        f"All mismatches together, {grid} points of the grid: share of runs below an error; diamond: mean of the worse "
        "half, cross: lost, dashed: failed beyond"
    )
    rows = [
        text_row(_HEADER_IN, partial(_draw_header, study)),
        Row(0.1, ()),
        text_row(_SECTION_IN, partial(draw_section, title)),
        side_by_side(_SPREAD_IN, spreads),
    ]
    for name, value in MEASURES:
        title = (
            f"{name} under each mismatch alone, from the nominal robot's on: mean over {study.settings.seeds} seeds, "
            "a dot each, a cross where it failed"
        )
        rows += [text_row(_SECTION_IN, partial(draw_section, title)), _alone_row(study, name, value)]
    s, versions = study.settings, study.versions
    footer = (
        f"profile {study.profile} · step {s.timestep:g} s · {s.feedback} feedback · seed {s.seed} · "
        f"mujoco {versions.get('mujoco', '?')} · ssmr-testbed {versions.get('ssmr-testbed', '?')}"
    )
    rows += note_rows([f"{remark}." for remark in remarks(study)])
    rows.append(text_row(_FOOTER_IN, partial(draw_footer, footer)))
    return put_together(rows)
