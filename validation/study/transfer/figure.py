"""The picture of a study of transfer: everybody's cost on every plant, and how well each plant chooses."""

from __future__ import annotations

import math
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation.report.drawing import (
    ALARM,
    QUIET,
    Row,
    draw_footer,
    draw_section,
    ink_of,
    inset,
    line_legend,
    narrow,
    note_rows,
    plain_ticks,
    put_together,
    text_row,
)
from validation.study.transfer.comparison import mean_costs
from validation.study.transfer.field import TransferField
from validation.study.transfer.result import TransferStudy

_LINE_IN, _MARGINS_IN, _LABELS_IN = 0.215, 1.0, 1.15  # of one controller; above and below all; names beside a panel
_COSTS, _PANEL = 0.52, 0.24  # shares of the width
_MARKERS = {"mujoco": "D", "four_wheel": "s"}
_KINDS = ((None, "o", "all controllers"), (False, "v", "without prediction"), (True, "^", "with prediction"))


def _draw_costs(field: TransferField, ax: Axes) -> None:
    """Draw the mean cost of every controller on every plant; a cross where it lost a run."""
    inset(ax, left=_LABELS_IN)
    order, judge = field.order, field.options.judge
    for plant in reversed(field.options.plant_names):
        means = dict(zip(field.names, mean_costs(field.table_of(plant)).tolist(), strict=True))
        size, ink, lost = 8.0 if plant == judge else 6.0, ink_of(plant), field.lost(plant)
        for row, name in enumerate(order):
            marker = "x" if name in lost else _MARKERS.get(plant, "o")
            ax.plot(means[name], row, marker, color=ink, markersize=size, markeredgecolor=ALARM if name in lost else "white",
                    markeredgewidth=2.0 if name in lost else 0.7, zorder=3.0, gid=f"{plant} {name}")  # fmt: skip
        ax.plot([], [], _MARKERS.get(plant, "o"), color=ink, markersize=size, label=plant)
    ax.set(xscale="log", xlabel="mean cost (Sec. 4.3.3)", ylim=(len(order) - 0.4, -0.6))
    ax.set_yticks(range(len(order)), order, fontsize=9.0)
    for label in ax.get_yticklabels():
        narrow(label, _LABELS_IN + 0.5)
    low, high = ax.get_xlim()
    plain_ticks(ax.xaxis, (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,))
    ax.set_title(f"Cost: the best on {judge} at the top")


def _rows(field: TransferField, ax: Axes, named: bool) -> None:
    ax.set_ylim(len(field.models) - 0.4, -0.6)
    ax.set_yticks(range(len(field.models)), field.models if named else [""] * len(field.models), fontsize=9.0)
    ax.grid(visible=False, axis="y")


def _draw_taus(field: TransferField, ax: Axes) -> None:
    """Draw the rank correlation of every plant with the judge, and its interval."""
    inset(ax, left=0.35)
    for row, plant in enumerate(field.models):
        for k, (kind, marker, _) in enumerate(_KINDS):
            found = field.agreement(plant, kind)
            if found is None or math.isnan(found.tau):
                continue
            at = row + 0.2 * (k - 1)
            ax.hlines(at, *found.tau_interval, color=ink_of(plant), linewidth=5.0, alpha=0.3)
            ax.plot(
                found.tau, at, marker, color=ink_of(plant), markersize=6.5, mfc=ink_of(plant) if kind is None else "white"
            )
    ax.axvline(0.0, color=QUIET, linewidth=0.8)
    ax.set(xlim=(-1.05, 1.05), xlabel="Kendall's tau", title=f"Ranks as {field.options.judge} does")
    _rows(field, ax, named=True)


def _draw_regrets(field: TransferField, ax: Axes) -> None:
    """Draw what the choice of every plant costs more on the judge, with the name of what it chooses."""
    found = [field.agreement(plant) for plant in field.models]
    regrets = [100.0 * a.regret for a in found if a is not None and math.isfinite(a.regret)]
    end = 1.15 * max([*regrets, 10.0])
    for row, (plant, a) in enumerate(zip(field.models, found, strict=True)):
        assert a is not None
        length = 100.0 * a.regret if math.isfinite(a.regret) else end
        ax.barh(row, length, height=0.6, color=ink_of(plant), alpha=0.45)
        said = f"{field.names[a.chosen]}{'' if math.isfinite(a.regret) else ', loses runs'}"
        ax.text(0.02 * end, row, said, va="center", fontsize=9.0, color=ALARM if math.isinf(a.regret) else "0.1")
    ax.set(xlim=(0.0, end), xlabel=f"regret on {field.options.judge} [%]", title="What it chooses costs more")
    _rows(field, ax, named=False)


def draw_transfer(study: TransferStudy) -> Figure:
    """Draw, for every profile, costs by controller, rank correlations and regrets by plant, 1600 px wide."""
    rows: list[Row] = []
    for field in study.fields:
        ends = [f"{pick(drive.speed for drive in field.drives):.2g}" for pick in (min, max)]
        speeds = " to ".join(dict.fromkeys(ends)) + " m/s"
        title = f"{field.label}: {len(field.drives)} references at {speeds}"
        height = _MARGINS_IN + _LINE_IN * max(len(field.names), 2 * len(field.models))
        panels = ((_COSTS, _draw_costs), (_PANEL, _draw_taus), (_PANEL, _draw_regrets))
        rows.append(text_row(0.3, partial(draw_section, title)))
        rows.append(Row(height, tuple((share, partial(panel, field)) for share, panel in panels)))

    def legend(ax: Axes) -> None:
        ax.set_axis_off()
        drawn = ax.get_figure(root=True)
        assert drawn is not None
        handles, labels = drawn.axes[1].get_legend_handles_labels()
        kinds = [
            ax.plot([], [], marker, color=QUIET, mfc=QUIET if kind is None else "white")[0] for kind, marker, _ in _KINDS
        ]
        line_legend(ax, [*handles[::-1], *kinds], [*labels[::-1], *(name for *_, name in _KINDS)])

    foot = f"{study.options.seeds_text} · bars on tau: 90 % of draws of the references · cross: lost a run"
    rows += [text_row(0.4, legend), *note_rows(study.notes()), text_row(0.3, partial(draw_footer, foot))]
    return put_together(rows)
