"""The pictures of a replication's sections: step responses and accelerations, and errors by speed and yaw rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ssmr.types import FloatArray, Trajectory
from validation.replicate.tracked import TableEntry
from validation.report.drawing import (
    QUIET,
    Panel,
    Row,
    draw_footer,
    draw_section,
    ink_of,
    inset,
    line_legend,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.report.palette import VERDICT_INKS

_SHOWN = 0.5
"""Duration of the part of the trajectory that is drawn, around a reversal of the turn [s]."""
_DARK = 0.6
"""Share of the greatest error from which on numbers are written in white."""


def _draw_step(drawn: Mapping[str, Trajectory], column: int, command: float, title: str, ax: Axes) -> None:
    for k, (name, motion) in enumerate(drawn.items()):
        ax.plot(motion.t, motion.twist[:, column], color=ink_of(name), linewidth=2.2 - 0.4 * k, gid=name)
    ax.axhline(command, color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0)))
    ax.set(title=title, xlim=(0.0, 1.5), xlabel="time since the command [s]")


def draw_responses(
    driven: Mapping[str, Trajectory], steps: Sequence[Mapping[str, Trajectory]], size: tuple[float, float], profile: str
) -> Figure:
    """Draw the accelerations of each plant side by side on one scale, and below them the step responses.

    The accelerations are those around the time nearest to the middle of the run at which the first plant's turn reverses.

    Args:
        driven: motions on trajectory 4 by plant, at every physics step.
        steps: responses to a step of the speed command, and to one of the yaw rate command, by plant.
        size: speed [m/s] and yaw rate [rad/s] of those commands.
        profile: name of the profile.
    """
    first = next(iter(driven.values()))
    crossings = first.t[:-1][first.twist[1:, 2] * first.twist[:-1, 2] < 0.0]
    middle = 0.5 * float(first.t[-1])
    if len(crossings):
        middle = float(crossings[np.argmin(np.abs(crossings - middle))])
    seen = {}
    for name, motion in driven.items():
        inside = np.abs(motion.t - middle) <= 0.5 * _SHOWN
        seen[name] = motion.t[inside], motion.channels["yaw_acceleration_rad_s2"][inside]
    every = np.concatenate([values for _, values in seen.values()])
    reach = np.array([every.min(), every.max()]) + np.array([-0.06, 0.06]) * np.ptp(every)

    def accelerations(name: str, ax: Axes) -> None:
        t, values = seen[name]
        ax.plot(t, values, color=ink_of(name), linewidth=1.0, gid=name)
        ax.set(title=name, xlim=(t[0], t[-1]), ylim=reach, xlabel="time [s]")

    def legend(ax: Axes) -> None:
        ax.set_axis_off()
        handles = [Line2D([], [], color=ink_of(name), linewidth=2.0) for name in driven]
        handles.append(Line2D([], [], color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0))))
        line_legend(ax, handles, [*driven, "command"])

    below: list[Panel] = [
        partial(_draw_step, steps[0], 0, size[0], f"speed [m/s] after a command of {size[0]:g}"),
        partial(_draw_step, steps[1], 2, size[1], f"yaw rate [rad/s] after a command of {size[1]:g}"),
    ]
    heading = "Yaw acceleration [rad/s²] on trajectory 4, where the turn reverses"
    foot = f"every physics step is drawn: 1 ms, mujoco 2 ms · peaks every 50 ms: a new command · profile {profile}"
    return put_together(
        [
            text_row(0.4, partial(draw_section, heading)),
            side_by_side(3.0, [partial(accelerations, name) for name in driven]),
            text_row(0.3, legend),
            side_by_side(3.0, below),
            text_row(0.3, partial(draw_footer, foot)),
        ]
    )


@dataclass(frozen=True, eq=False)
class BinnedErrors:
    """Median errors of plants by speed and yaw rate."""

    speeds: tuple[float, ...]
    """(R + 1,) edges [m/s]."""
    yaw_rates: tuple[float, ...]
    """(C + 1,) edges [rad/s]."""
    count: NDArray[np.int64]
    """(R, C) number of windows in each bin."""
    medians: Mapping[str, FloatArray]
    """(2, R, C) median sizes of position [m] and yaw errors [rad] by plant; NaN where there are few windows."""
    window: float
    """Length of a window [s]."""


def _draw_bins(residuals: BinnedErrors, values: FloatArray | None, most: float, name: str, ax: Axes) -> None:
    """Draw a plant's errors in every bin; with no values, the number of windows, and the names of the bins."""
    counts = values is None
    shown = residuals.count if values is None else values
    colours = np.zeros(shown.shape) if counts else shown
    ax.imshow(colours, origin="lower", cmap="Greys" if counts else "YlOrBr", vmin=0.0, vmax=most, aspect="auto")
    for (i, j), value in np.ndenumerate(shown):
        if not np.isnan(value):
            ink = "0.45" if counts else "white" if value > _DARK * most else "0.15"
            ax.text(j, i, f"{value:.0f}", ha="center", va="center", fontsize=9.0, color=ink)
    rates, speeds = residuals.yaw_rates, residuals.speeds
    ax.set_xticks(np.arange(len(rates)) - 0.5, [f"{r:g}" for r in rates], fontsize=8.0)
    ax.set_yticks(np.arange(len(speeds)) - 0.5, [f"{s:g}" if counts else "" for s in speeds], fontsize=8.0)
    ax.grid(visible=False)
    ax.set(xlabel="yaw rate [rad/s]", ylabel="speed [m/s]" if counts else "")
    ax.set_title(name, color="black" if counts else ink_of(name))


def draw_residuals(residuals: BinnedErrors, how: str) -> Figure:
    """Draw position errors above and yaw errors below: the number of windows, then a map for each plant."""
    rows: list[Row] = []
    for k, what in enumerate(("Position, median error after {:g} s [mm], {}", "Yaw, median error after {:g} s [mrad], {}")):
        maps = {name: 1e3 * m[k] for name, m in residuals.medians.items()}
        most = float(max((v for m in maps.values() for v in m[~np.isnan(m)]), default=1.0))
        panels: list[Panel] = [partial(_draw_bins, residuals, None, 1.0, "windows")]
        panels += [partial(_draw_bins, residuals, values, most, name) for name, values in maps.items()]
        heading = what.format(residuals.window, how)
        rows += [text_row(0.3, partial(draw_section, heading)), side_by_side(3.0, panels)]
    foot = "bins with few windows are left empty · the darker, the greater the error; one scale for each row"
    return put_together([*rows, text_row(0.3, partial(draw_footer, foot))])


_TRAJECTORY_INKS = {"traj1": "#d55e00", "traj2": "#56b4e9", "traj3": "#009e73", "traj4": "#444444"}


def draw_causes(
    d_rms: Mapping[str, Mapping[str, float]],
    printed: Mapping[str, float],
    paths: tuple[Trajectory, Trajectory],
    shown: str,
) -> Figure:
    """Draw d_rms [m] by cause and trajectory below the printed one, and, of the cause that is shown, both paths."""
    rows = {"printed (Tab. 3.12)": printed, **d_rms}

    def errors(ax: Axes) -> None:
        for k, by in enumerate(rows.values()):
            for name, value in by.items():
                ax.plot(1e3 * value, k, "o" if k else "D", color=_TRAJECTORY_INKS[name], ms=7, label=name if not k else None)
        ax.set_yticks(range(len(rows)), list(rows), fontsize=9.0)
        ax.set(xscale="log", ylim=(len(rows) - 0.5, -0.5), xlabel="d_rms [mm]")
        ax.axhline(0.5, color=QUIET, linewidth=1.0)
        ax.grid(axis="x", which="both", alpha=0.25)
        inset(ax, left=2.9)
        plain_ticks(ax.xaxis)
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, fontsize=8.0, frameon=False)

    def driven(ax: Axes) -> None:
        for motion, ink, label in zip(
            paths, ("#444444", "#0072b2"), ("robot on four tyres", "improved, fitted"), strict=True
        ):
            ax.plot(motion.xy[:, 0], motion.xy[:, 1], color=ink, linewidth=1.8, label=label)
        ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        inset(ax, left=0.8)
        ax.legend(loc="best", fontsize=8.0)
        ax.set_title(f"Trajectory 1: {shown}")

    heading = "Distance of the fitted improved model from a robot on four tyres, by what is added to that robot"
    return put_together([text_row(0.3, partial(draw_section, heading)), side_by_side(4.6, [errors, driven])])


def _draw_rows(entries: Sequence[TableEntry], title: str, ax: Axes) -> None:
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


def draw_tracked(entries: Sequence[TableEntry], profile: str, seeds: int) -> Figure:
    """Draw printed and own d_rms of each table, both comparisons side by side."""
    panels = []
    for comparison in dict.fromkeys(e.comparison for e in entries):
        some = [e for e in entries if e.comparison == comparison]
        title = f"{comparison.replace('_', ' ').replace('vs', 'against')}, profile {profile}"
        panels.append(partial(_draw_rows, some, title))
    foot = (
        f"bar: printed · dot: ours, mean and deviation of {seeds} seeds · ring: ours under the supposition · "
        "the row: green agrees, light green agrees if, blue nearer, orange differs, grey not compared"
    )
    return put_together([side_by_side(5.2, panels), text_row(0.3, partial(draw_footer, foot))])
