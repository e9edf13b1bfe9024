"""The picture of a terrain study: errors along four axes, without and with feedback, and wheel loads of a manoeuvre."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from validation.report.drawing import (
    QUIET,
    Row,
    controller_ink,
    draw_footer,
    draw_section,
    ink_of,
    line_legend,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.simulator.description import WHEELS
from validation.simulator.wheel_loads import MEASURED, QUASI_STATIC
from validation.study.terrain.findings import AXES, BASE, PLANAR, AxisName, LoadRun
from validation.study.terrain.result import TerrainStudy

_DASHES: dict[str, Any] = dict(zip(PLANAR, ("-", (0, (4, 1.5)), (0, (5, 1.2, 1, 1.2)), (0, (1, 1))), strict=True))


def _scales(axis: AxisName, label: str, values: list[float], ax: Axes) -> None:
    """Set a logarithmic ordinate with plain numbers and room around positive values, and mark the thesis' conditions."""
    name, unit, scale = AXES[axis]
    limits = (0.8 * min(values), 1.25 * max(values)) if values else (1.0, 10.0)
    ax.set(yscale="log", ylim=limits, xlabel=f"{name} [{unit}]")
    plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))
    ax.axvline(scale * BASE[axis], color=QUIET, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1.5)
    if axis == next(iter(AXES)):
        ax.set_ylabel(label)


def _draw_open(study: TerrainStudy, axis: AxisName, ax: Axes) -> None:
    """Draw the planar models' position errors along an axis."""
    for plant in PLANAR:
        line = [(AXES[axis][2] * p.value, 1e3 * p.position_m) for p in study.line(axis, plant) if p.position_m]
        if line:
            ax.plot(*np.array(line).T, color=ink_of(plant), linestyle=_DASHES[plant], marker="o", ms=4.0, gid=plant)
    _scales(axis, "position error [mm]", [1e3 * p.position_m for p in study.models if p.position_m], ax)


def _draw_closed(study: TerrainStudy, axis: AxisName, ax: Axes) -> None:
    """Draw the trackers' d_rms along an axis, with a cross where the reference was lost on a ground."""
    for controller in study.options.axes.controllers:
        found = [f for f in study.trackers if f.axis == axis and f.controller == controller and f.d_rms_m]
        line = np.array([(AXES[axis][2] * f.value, 1e3 * (f.d_rms_m or math.nan)) for f in found])
        if len(line):
            ax.plot(*line.T, color=controller_ink(controller), marker="s", ms=4.0, gid=controller)
            lost = line[[f.lost > 0 for f in found]]
            ax.plot(*lost.T, "x", color="black", ms=8.0, zorder=3.0)
    _scales(axis, "d_rms, tracked [mm]", [1e3 * f.d_rms_m for f in study.trackers if f.d_rms_m], ax)


def _wheel_style(wheel: str) -> dict[str, Any]:
    return {
        "color": ink_of("mujoco") if wheel.startswith("front") else "0.2",
        "linestyle": "-" if wheel.endswith("left") else (0, (5, 1.5)),
    }


def _draw_loads(study: TerrainStudy, run: LoadRun, ax: Axes) -> None:
    """Draw simulated loads, the loads by the formula (dotted) and the static loads."""
    motion = run.motion
    for k, wheel in enumerate(WHEELS):
        ax.plot(motion.t, motion.channels[MEASURED][:, k], **_wheel_style(wheel), linewidth=1.2, gid=wheel)
        formula = motion.channels[QUASI_STATIC][:, k]
        ax.plot(motion.t, formula, color=ink_of("improved"), linestyle=(0, (1, 1)), linewidth=1.1, zorder=3.0)
    for share in np.unique(study.static.round(6)):
        ax.axhline(share, color=QUIET, linewidth=0.9, zorder=1.5)
    ax.set(xlabel="time [s]", xlim=(0.0, motion.t[-1]))
    ax.set_title(f"Wheel loads on {run.terrain.words} [N]")


def _legend_row(lines: Sequence[dict[str, Any]], labels: Sequence[str]) -> Row:
    def draw(ax: Axes) -> None:
        ax.set_axis_off()
        line_legend(ax, [Line2D([], [], **style) for style in lines], labels)

    return text_row(0.4, draw)


def draw_terrain(study: TerrainStudy) -> Figure:
    """Draw errors without feedback, errors of trackers, and wheel loads, 1600 px wide."""
    top = (
        f"Planar models against the MuJoCo robot: median position error after {study.options.horizon:g} s "
        "(dashed line: as in the thesis)"
    )
    below = "Trackers that know nothing of the ground: distance of the path from the reference (cross: lost on a ground)"
    at_the_end = "Wheel loads while speeding up, turning left, driving straight, braking and turning on the spot"
    trackers = study.options.axes.controllers
    wheels = [_wheel_style(w) for w in WHEELS]
    wheels += [{"color": ink_of("improved"), "linestyle": (0, (1, 1))}, {"color": QUIET}]
    rows = [
        text_row(0.3, partial(draw_section, top)),
        _legend_row([{"color": ink_of(p), "linestyle": _DASHES[p], "marker": "o", "ms": 4.0} for p in PLANAR], PLANAR),
        side_by_side(3.0, [partial(_draw_open, study, axis) for axis in AXES]),
        text_row(0.3, partial(draw_section, below)),
        _legend_row(
            [{"color": controller_ink(c), "marker": "s", "ms": 4.0} for c in trackers], [f"{c}, tuned" for c in trackers]
        ),
        side_by_side(2.6, [partial(_draw_closed, study, axis) for axis in AXES]),
        text_row(0.3, partial(draw_section, at_the_end)),
        _legend_row(wheels, [*(w.replace("_", " ") for w in WHEELS), "quasi-static formula", "static load, Eq. 2.17"]),
        side_by_side(3.2, [partial(_draw_loads, study, run) for run in study.loads]),
        text_row(0.3, partial(draw_footer, f"{study.heading()} · mujoco {study.versions.get('mujoco', '?')}")),
    ]
    return put_together(rows)
