"""The picture of a tables study: printed and own d_rms, one table in each row."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation.show.drawing import draw_footer, inset, plain_ticks, put_together, side_by_side, text_row
from validation.show.palette import VERDICT_INKS
from validation.study.tables.result import TABLE_CAPTIONS, ControlTables, TableEntry


def _draw(entries: Sequence[TableEntry], title: str, ax: Axes) -> None:
    for k, e in enumerate(entries):
        ink = VERDICT_INKS[e.verdict.status]
        if e.mean:
            ax.errorbar(e.mean["d_rms_m"] * 1e3, k, xerr=e.deviation["d_rms_m"] * 1e3, fmt="o", color=ink, ms=6, capsize=3)
        if e.supposed:
            ax.plot(e.supposed["d_rms_m"].value * 1e3, k, "o", mfc="none", color="#444444", ms=6)
        if e.printed:
            ax.plot(e.printed["d_rms_m"] * 1e3, k, "|", color="black", ms=14, mew=2)
    ax.set_yticks(range(len(entries)), [f"{e.table}  {e.controller} {e.reference} {e.speed:g} m/s" for e in entries])
    ax.set(xscale="log", xlabel="d_rms [mm]", ylim=(max(len(entries), 1) - 0.5, -0.5))
    inset(ax, left=1.7)
    plain_ticks(ax.xaxis)
    ax.set_title(title, loc="left", fontsize=11)
    ax.grid(axis="x", which="both", alpha=0.25)
    ax.spines[["top", "right"]].set_visible(False)


def draw_tables(study: ControlTables) -> Figure:
    """Draw printed and own d_rms, both comparisons side by side, 1600 px wide."""
    panels = []
    for comparison in TABLE_CAPTIONS:
        some = [e for e in study.entries if e.comparison == comparison]
        title = f"{comparison.replace('_', ' ').replace('vs', 'against')}, {study.of_profile(study.profile)}"
        panels.append(lambda ax, some=some, title=title: _draw(some, title, ax))
    foot = (
        f"bar: printed · dot: ours, mean and deviation of {study.seeds} seeds · ring: ours under the supposition · "
        "the row: green agrees, light green agrees if, blue nearer, orange differs, grey not compared"
    )
    return put_together([side_by_side(5.2, panels), text_row(0.3, lambda ax: draw_footer(foot, ax))])
