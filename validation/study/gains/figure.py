"""The picture of a gains study: the cost of each set of gains, by reference and plant."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.laws import CONTROLLERS
from validation.show.drawing import (
    controller_ink,
    draw_footer,
    inset,
    line_legend,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.study.gains.result import GainStudy


def _draw(study: GainStudy, plant: str, ax: Axes) -> None:
    rows = study.by_reference(plant)
    marks = {"published": "s", "manual": "D", "tuned": "o", "robust": "^"}
    for name in study.sets:
        controller = max((c for c in CONTROLLERS if name.startswith(f"{c}-")), key=len)
        kind = name.removeprefix(f"{controller}-")
        points = [
            (s.cost, k) for k, (_, scores) in enumerate(rows) for s in scores if s.gains == name and s.cost is not None
        ]
        if points:
            ink = controller_ink(controller)
            face = ink if kind == "tuned" else "white"
            ax.plot(*zip(*points, strict=True), marks.get(kind, "v"), color=ink, mfc=face, ms=7, mew=1.5, label=name)
    inset(ax, left=1.0)
    ax.set_yticks(range(len(rows)), [label for label, _ in rows])
    ax.set(xscale="log", xlabel="cost, Sec. 4.3.3", ylim=(len(rows) - 0.5, -0.5))
    plain_ticks(ax.xaxis)
    ax.set_title(plant, loc="left", fontsize=11)
    ax.grid(axis="both", which="major", alpha=0.3)
    ax.spines[["top", "right"]].set_visible(False)


def draw_gains(study: GainStudy) -> Figure:
    """Draw the costs by reference, with a panel for each plant, 1600 px wide."""
    panels = [lambda ax, plant=plant: _draw(study, plant, ax) for plant in study.plants]

    def legend(ax: Axes) -> None:
        ax.set_axis_off()
        drawn = ax.get_figure(root=True)
        assert drawn is not None
        handles, labels = drawn.axes[0].get_legend_handles_labels()
        line_legend(ax, handles, labels)

    foot = f"means over {study.options.seeds} seeds of noise that no tuning has used · {study.of_profile(study.profile)}"
    return put_together([side_by_side(3.8, panels), text_row(0.45, legend), text_row(0.3, lambda ax: draw_footer(foot, ax))])
