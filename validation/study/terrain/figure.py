"""The study of terrain as one picture: errors along four axes, open and closed loop, and wheel loads through a manoeuvre."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from validation.robots.husky import WHEELS
from validation.robots.wheel_loads import MEASURED, QUASI_STATIC
from validation.show.drawing import (
    QUIET,
    draw_footer,
    draw_section,
    ink_of,
    line_legend,
    put_together,
    side_by_side,
    text_row,
)
from validation.study.robustness.figure import ink_of as controller_ink
from validation.study.terrain.run import AXES, BASE, PLANAR, Axis, Ride, TerrainStudy, heading

_DASHES: dict[str, Any] = dict(zip(PLANAR, ("-", (0, (4, 1.5)), (0, (5, 1.2, 1, 1.2)), (0, (1, 1))), strict=True))


def _scales(study: TerrainStudy, axis: Axis, label: str, ax: Axes) -> None:
    """A logarithmic ordinate with plain numbers, the thesis' conditions marked."""
    name, unit, scale = AXES[axis]
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.axvline(scale * BASE[axis], color=QUIET, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1.5)
    ax.set_xlabel(f"{name} [{unit}]")
    if axis == next(iter(AXES)):
        ax.set_ylabel(label)


def _draw_open(study: TerrainStudy, axis: Axis, limits: tuple[float, float], ax: Axes) -> None:
    """The planar models' position errors along an axis."""
    for plant in PLANAR:
        line = [(AXES[axis][2] * p.value, 1e3 * p.position_m) for p in study.line(axis, plant) if p.position_m]
        if line:
            ax.plot(*np.array(line).T, color=ink_of(plant), linestyle=_DASHES[plant], marker="o", ms=4.0, gid=plant)
    _scales(study, axis, "position error [mm]", ax)
    ax.set_ylim(limits)


def _draw_closed(study: TerrainStudy, axis: Axis, limits: tuple[float, float], ax: Axes) -> None:
    """The trackers' d_rms along an axis; a cross where a ground was lost."""
    for controller in study.settings.controllers:
        found = [f for f in study.followed if f.axis == axis and f.controller == controller and f.d_rms_m]
        line = np.array([(AXES[axis][2] * f.value, 1e3 * (f.d_rms_m or math.nan)) for f in found])
        if len(line):
            ax.plot(*line.T, color=controller_ink(controller), marker="s", ms=4.0, gid=controller)
            lost = line[[f.lost > 0 for f in found]]
            ax.plot(*lost.T, "x", color="black", ms=8.0, zorder=3.0)
    _scales(study, axis, "d_rms, tracked [mm]", ax)
    ax.set_ylim(limits)


def _limits(values: list[float]) -> tuple[float, float]:
    """Room for all of some positive numbers on a logarithmic axis."""
    return (0.8 * min(values), 1.25 * max(values)) if values else (1.0, 10.0)


def _draw_loads(study: TerrainStudy, ride: Ride, ax: Axes) -> None:
    """Simulated loads, dotted what the formula says, and the static shares."""
    motion = ride.motion
    for k, wheel in enumerate(WHEELS):
        ink = ink_of("mujoco") if wheel.startswith("front") else "0.2"
        style = "-" if wheel.endswith("left") else (0, (5, 1.5))
        ax.plot(motion.t, motion.channels[MEASURED][:, k], color=ink, linestyle=style, linewidth=1.2, gid=wheel)
        formula = motion.channels[QUASI_STATIC][:, k]
        ax.plot(motion.t, formula, color=ink_of("improved"), linestyle=(0, (1, 1)), linewidth=1.1, zorder=3.0)
    for share in np.unique(study.static.round(6)):
        ax.axhline(share, color=QUIET, linewidth=0.9, zorder=1.5)
    ax.set(xlabel="time [s]", xlim=(0.0, motion.t[-1]))
    ax.set_title(f"Wheel loads on {ride.terrain.words} [N]")


def _legend(ax: Axes) -> None:
    ax.set_axis_off()
    handles = [Line2D([], [], color=ink_of(p), linestyle=_DASHES[p], marker="o", ms=4.0) for p in PLANAR]
    line_legend(ax, handles, list(PLANAR))


def _load_legend(ax: Axes) -> None:
    ax.set_axis_off()
    handles = [
        Line2D([], [], color=ink_of("mujoco") if w.startswith("front") else "0.2",
               linestyle="-" if w.endswith("left") else (0, (5, 1.5)))
        for w in WHEELS
    ]  # fmt: skip
    handles += [Line2D([], [], color=ink_of("improved"), linestyle=(0, (1, 1))), Line2D([], [], color=QUIET)]
    line_legend(ax, handles, [*(w.replace("_", " ") for w in WHEELS), "quasi-static formula", "static share, Eq. 2.17"])


def _closed_legend(study: TerrainStudy, ax: Axes) -> None:
    ax.set_axis_off()
    handles = [Line2D([], [], color=controller_ink(c), marker="s", ms=4.0) for c in study.settings.controllers]
    line_legend(ax, handles, [f"{c}, tuned" for c in study.settings.controllers])


def draw_terrain(study: TerrainStudy) -> Figure:
    """Everything in one look, 1600 px wide."""
    opened = _limits([1e3 * p.position_m for p in study.points if p.position_m])
    closed = _limits([1e3 * f.d_rms_m for f in study.followed if f.d_rms_m])
    s = study.settings
    top = f"Planar models against the MuJoCo Husky: median position error after {s.horizon:g} s; upright: as in the thesis"
    below = "The same ground under trackers that do not know of it: distance of the MuJoCo Husky's path from the reference"
    rows = [
        text_row(0.3, partial(draw_section, top)),
        text_row(0.4, _legend),
        side_by_side(3.0, [partial(_draw_open, study, axis, opened) for axis in AXES]),
        text_row(0.3, partial(draw_section, below)),
        text_row(0.4, partial(_closed_legend, study)),
        side_by_side(2.6, [partial(_draw_closed, study, axis, closed) for axis in AXES]),
        text_row(0.3, partial(draw_section, "Speeding up, turning left, straight, braking, turning on the spot")),
        text_row(0.4, _load_legend),
        side_by_side(3.2, [partial(_draw_loads, study, ride) for ride in study.rides]),
        text_row(0.3, partial(draw_footer, f"{heading(study)} · mujoco {study.versions.get('mujoco', '?')}")),
    ]
    return put_together(rows)
