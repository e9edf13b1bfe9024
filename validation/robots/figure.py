"""The picture of a robot: from above and from its right side to scale, with loads, and what it does in numbers."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from ssmr.robot.ground import FRONT, LEFT
from validation.report.drawing import (
    ALARM,
    EDGE_IN,
    MARGINS_IN,
    WIDTH_IN,
    Row,
    draw_footer,
    equal_scales,
    note_rows,
    put_together,
    text_row,
)
from validation.robots.data import CheckedRobot
from validation.robots.mechanics import robot_outline, tyre_hull_overlap, whole_com
from validation.robots.table import check_grid
from validation.simulator.description import WHEELS
from validation.words import abridged

_VIEWS, _TALLEST_IN = 0.62, 4.6
"""Share of the width that the views have, and greatest height of the robot in a view [in]."""
_LINE_IN = 0.27
"""Height of a line of numbers [in]."""


def draw_robot(check: CheckedRobot) -> Figure:
    """Draw a robot from above and from the right, its loads, what it does, and the advice; 1600 px wide."""
    size = np.diff(robot_outline(check.robot), axis=0)[0]
    wide = _VIEWS * (WIDTH_IN - 2.0 * EDGE_IN) - MARGINS_IN[0] - MARGINS_IN[1]
    scale = 0.8 * min(wide / size[0], _TALLEST_IN / size[1], _TALLEST_IN / size[2])  # [in/m]
    top, side = (max(1.25 * scale * size[k], 1.6) + MARGINS_IN[2] + MARGINS_IN[3] for k in (1, 2))
    v = check.versions
    footer = (
        f"loads at rest on level ground · dashed: hull · cross: centre of mass · mujoco {v.get('mujoco', '?')} · "
        f"ssmr-testbed {v.get('ssmr-testbed', '?')} · python -m validation.robots check {check.robot.name}"
    )
    return put_together(
        [
            text_row(0.62, partial(_draw_heading, check)),
            Row(top, ((_VIEWS, partial(_draw_view, check, 1)), (1.0 - _VIEWS, partial(_draw_numbers, check)))),
            Row(side, ((_VIEWS, partial(_draw_view, check, 2)), (1.0 - _VIEWS, lambda ax: ax.set_axis_off()))),
            *note_rows([("fault: " if each.fault else "hint: ") + each.text for each in check.advice]),
            text_row(0.28, partial(draw_footer, footer)),
        ]
    )


def _draw_heading(check: CheckedRobot, ax: Axes) -> None:
    ax.set_axis_off()
    robot = check.robot
    title, words = abridged(robot.title or robot.name, 60), abridged(robot.description or f"The robot {robot.name}.", 130)
    ax.text(0.0, 1.0, title, transform=ax.transAxes, fontsize=15.0, fontweight="bold", va="top")
    ax.text(0.0, 0.36, words, transform=ax.transAxes, va="top", color="0.25")
    faults = sum(each.fault for each in check.advice)
    said, ink = ("✔ nothing is wrong", "#1e8449") if check.ok else (f"✘ {faults} fault{'s' * (faults > 1)}", ALARM)
    ax.text(1.0, 1.0, said, transform=ax.transAxes, fontsize=13.0, fontweight="bold", va="top", ha="right", color=ink)


def _draw_view(check: CheckedRobot, up: int, ax: Axes) -> None:
    """Draw x over y (`up` is 1) or over z (2) in the base frame: hull, tyres with their loads, and the centre of mass.

    Tyres that reach into the hull or into one another have a red edge.
    """
    robot, g = check.robot, check.robot.geometry
    width, height = g.body_size[0], g.body_size[up]
    corner = (g.body_centre[0] - 0.5 * width, g.body_centre[up] - 0.5 * height)
    ax.add_patch(
        Rectangle(corner, width, height, facecolor="#f6e3a1a0", edgecolor="#0072b2", linestyle="--", zorder=1.8, gid="hull")
    )
    overlaps = tyre_hull_overlap(robot)
    for wheel, front, left, load in zip(WHEELS, FRONT, LEFT, check.static_loads, strict=True):
        wrong = min(overlaps[wheel]) > 1e-6 or 2.0 * g.wheel_radius >= g.wheelbase
        x, y = 0.5 * front * g.wheelbase, 0.5 * left * g.track
        tyre = (
            Rectangle((x - g.wheel_radius, y - 0.5 * g.wheel_width), 2.0 * g.wheel_radius, g.wheel_width)
            if up == 1
            else Circle((x, g.axle_height), g.wheel_radius)
        )
        tyre.set(
            facecolor="0.8", edgecolor=ALARM if wrong else "0.1", linewidth=2.2 if wrong else 0.9, zorder=1.6, gid=wheel
        )
        ax.add_patch(tyre)
        if up == 1:
            ax.text(x, y, f"{load:.0f} N", ha="center", va="center", color=ALARM if load <= 0.0 else "0.05", zorder=6.0)
    if up == 2:
        ax.axhline(g.axle_height - g.wheel_radius, color="0.35", linewidth=1.4)
    com = whole_com(robot)
    ax.plot(com[0], com[up], "P", markersize=9.0, color="black", markeredgecolor="white", zorder=5.0, gid="com")
    if "geometry.imu" in robot.said:
        ax.plot(g.imu[0], g.imu[up], "D", markersize=5.0, color="#7d3c98", markeredgecolor="white", zorder=4.8, gid="imu")
        ax.annotate("IMU", (g.imu[0], g.imu[up]), (-5, -5), textcoords="offset points", ha="right", va="top", fontsize=8.0)
    equal_scales(ax, 0.0)
    sizes = (
        f"wheelbase {g.wheelbase:.4g} m, track {g.track:.4g} m, hull {g.body_size[1]:.3g} m, tyres {g.wheel_width:.3g} m"
        if up == 1
        else f"wheel radius {g.wheel_radius:.4g} m, {1e3 * (g.wheelbase - 2.0 * g.wheel_radius):.0f} mm between the tyres"
    )
    view = "From above" if up == 1 else "From its right side"
    ax.set(xlabel="x, forward [m]", ylabel="y, to the left [m]" if up == 1 else "z, upward [m]", title=f"{view}: {sizes}")


def _draw_numbers(check: CheckedRobot, ax: Axes) -> None:
    """Draw the table of what the robot does, one number a line."""
    ax.set_axis_off()
    figure, grid = ax.get_figure(root=True), check_grid(check)
    assert figure is not None
    tall = float(ax.get_position().height * figure.get_size_inches()[1])
    ax.set(xlim=(0.0, 1.0), ylim=(tall, 0.0))
    lines = [tuple(name for name, _ in grid.header), *(tuple(cell.text for cell in row) for row in grid.groups[0])]
    each = min(_LINE_IN, tall / len(lines))
    for k, texts in enumerate(lines):
        for text, x, side in zip(texts, (-0.13, 0.73, 0.94, 0.96), ("left", "right", "right", "left"), strict=True):
            ax.text(x, (k + 0.5) * each, text, va="center", ha=side, fontsize=8.2, color="0.05" if k else "0.4")
