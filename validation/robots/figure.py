"""The picture of a robot: from above and from its right side, with dimensions, loads, and what was found out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle, Wedge

from ssmr.robot.skid_turn import FRONT, LEFT
from ssmr.types import FloatArray
from validation.robots.data import CheckedRobot
from validation.robots.mechanics import robot_outline, tyre_hull_overlap, whole_com
from validation.robots.panels import draw_facts
from validation.show.drawing import ALARM, EDGE_IN, WIDTH_IN, Panel, Row, draw_footer, note_rows, put_together, text_row
from validation.simulator.description import WHEELS, Robot
from validation.words import abridged

_HEADER_IN, _FOOTER_IN, _BESIDE = 0.62, 0.28, 0.3
"""Heights of the heading and the footer [in], and the share of the width that numbers have."""
_ACROSS_IN, _ABOVE_IN, _BELOW_IN = 1.0, 0.42, 0.62
"""Room for dimensions at each side of a view, above and below it [in]."""
_TALLEST_IN = 4.6
"""Greatest height of the robot in a view [in]."""
_FRAME_IN, _COM_IN = 0.62, 0.1
"""Length of the base frame's arrows, and radius of the mark of the centre of mass [in]."""
_LETTER_IN = 0.078
"""Width of a letter of a dimension [in]."""
_DIMENSION, _HULL, _GROUND = "0.25", "#0072b2", "0.35"
_X, _Y, _Z = "#c0392b", "#1e8449", "#1f5fbf"


@dataclass(frozen=True, eq=False)
class _View:
    """One way to look at the robot."""

    name: str
    axes: tuple[int, int]
    """Coordinates along the abscissa and the ordinate."""
    inches: float
    """Scale [in/m]."""
    box: FloatArray
    """(2, 3) lowest and highest coordinates of the robot in the base frame [m]."""

    def metres(self, inches: float) -> float:
        """Return a length on paper in metres of the robot."""
        return inches / self.inches


def _scale(box: FloatArray) -> float:
    """Return the scale [in/m] at which both views fit into their column."""
    wide = (1.0 - _BESIDE) * (WIDTH_IN - 2.0 * EDGE_IN) - 2.0 * _ACROSS_IN
    size = box[1] - box[0]
    return float(min(wide / size[0], _TALLEST_IN / size[1], _TALLEST_IN / size[2]))


def _rectangle(view: _View, ax: Axes, centre: FloatArray, size: FloatArray, **look: object) -> None:
    a, b = view.axes
    corner = (centre[a] - 0.5 * size[a], centre[b] - 0.5 * size[b])
    ax.add_patch(Rectangle(corner, size[a], size[b], **look))  # type: ignore[arg-type]


def _draw_shapes(view: _View, robot: Robot, ax: Axes) -> None:
    """Draw hull and tyres; those that overlap have a red edge."""
    g = robot.geometry
    overlaps = tyre_hull_overlap(robot)
    wrong = {wheel: min(both) > 1e-6 or 2.0 * g.wheel_radius >= g.wheelbase for wheel, both in overlaps.items()}
    dashed = {"edgecolor": _HULL, "linewidth": 1.0, "linestyle": (0, (5, 2))}
    centre, size = np.array(g.body_centre), np.array(g.body_size)
    _rectangle(view, ax, centre, size, facecolor="#f6e3a1", edgecolor="none", zorder=1.5)
    _rectangle(view, ax, centre, size, fill=False, **dashed, zorder=3.0, gid="hull")
    for wheel, front, left in zip(WHEELS, FRONT, LEFT, strict=True):
        middle = np.array([0.5 * front * g.wheelbase, 0.5 * left * g.track, g.axle_height])
        ink, wide = (ALARM, 2.2) if wrong[wheel] else ("0.1", 0.9)
        look = {"facecolor": "0.62", "edgecolor": ink, "linewidth": wide, "zorder": 1.6, "gid": wheel}
        if view.axes == (0, 1):
            _rectangle(view, ax, middle, np.array([2.0 * g.wheel_radius, g.wheel_width, 0.0]), **look)
        else:
            ax.add_patch(Circle((float(middle[0]), float(middle[2])), g.wheel_radius, **look))


def _draw_frame(view: _View, ax: Axes) -> None:
    """Draw the axes of the base frame."""
    names = {0: ("x", _X), 1: ("y", _Y), 2: ("z", _Z)}
    length = view.metres(_FRAME_IN)
    for axis, step in zip(view.axes, ((length, 0.0), (0.0, length)), strict=True):
        word, ink = names[axis]
        ax.annotate(
            "",
            step,
            (0.0, 0.0),
            zorder=4.6,
            arrowprops={"arrowstyle": "-|>", "color": ink, "lw": 1.8, "shrinkA": 0, "shrinkB": 0},
        )
        beyond = [1.16 * v for v in step]
        _label(ax, beyond[0], beyond[1], word, color=ink, fontweight="bold", ha="center", va="center", fontsize=9.0)


def _draw_com(view: _View, robot: Robot, ax: Axes) -> None:
    """Draw the centre of mass of the whole robot as a circle of four quarters, and the IMU."""
    place = [whole_com(robot)[k] for k in view.axes]
    radius = view.metres(_COM_IN)
    for k in range(4):
        ink = "black" if k % 2 else "white"
        ax.add_patch(
            Wedge((place[0], place[1]), radius, 90.0 * k, 90.0 * k + 90.0, facecolor=ink, edgecolor="none", zorder=5.0)
        )
    ax.add_patch(Circle((place[0], place[1]), radius, fill=False, edgecolor="black", linewidth=1.2, zorder=5.1, gid="com"))
    imu = [robot.geometry.imu[k] for k in view.axes]
    if "geometry.imu" in robot.said:
        ax.plot(*imu, "D", markersize=5.0, color="#7d3c98", markeredgecolor="white", zorder=4.8, gid="imu")
        _label(
            ax,
            imu[0] - view.metres(0.09),
            imu[1] - view.metres(0.09),
            "IMU",
            ha="right",
            va="top",
            fontsize=8.0,
            color="#7d3c98",
        )


def _label(ax: Axes, x: float, y: float, text: str, **look: object) -> None:
    box = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}
    ax.text(x, y, text, zorder=6.0, bbox=box, **look)  # type: ignore[arg-type]


def _dimension(
    ax: Axes, view: _View, ends: tuple[float, float], at: float, text: str, *, upright: bool = False, of: float | None = None
) -> None:
    """Draw a dimension line between two coordinates, with thin lines from `of`, the edge of what is measured.

    A text that is longer than the line stands beside it.
    """
    inches = abs(ends[1] - ends[0]) * view.inches
    style = "|-|,widthA=0.25,widthB=0.25" if inches < 0.32 else "<|-|>"
    look = {"arrowstyle": style, "color": _DIMENSION, "lw": 0.9, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
    points = [(at, e) if upright else (e, at) for e in ends]
    ax.annotate("", points[1], points[0], arrowprops=look, zorder=4.0)
    for end in ends if of is not None else ():
        line = ([of, at], [end, end]) if upright else ([end, end], [of, at])
        ax.plot(*line, color=_DIMENSION, linewidth=0.5, zorder=2.9)
    middle, inside = 0.5 * (ends[0] + ends[1]), _LETTER_IN * len(text) + 0.35 < inches
    if inside:
        x, y = (at, middle) if upright else (middle, at)
        turn, across, along = 90.0 if upright else 0.0, "center", "center"
    elif upright:
        away = view.metres(0.07) if at > 0.0 else -view.metres(0.07)
        x, y, turn, across, along = at + away, middle, 0.0, "left" if at > 0.0 else "right", "center"
    else:
        x, y, turn, across, along = middle, at - view.metres(0.07), 0.0, "center", "top"
    ax.text(x, y, text, ha=across, va=along, rotation=turn, fontsize=9.0, color="0.1", zorder=6.0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5 if inside else 0.0})  # fmt: skip


def _limits(view: _View, ax: Axes) -> None:
    """Set the panel's limits so that the robot stands in its middle at the view's scale."""
    figure, box = ax.get_figure(root=True), ax.get_position()
    assert figure is not None
    size = figure.get_size_inches()
    wide, tall = float(box.width * size[0]), float(box.height * size[1])
    a, b = view.axes
    x = 0.5 * float(view.box[0, a] + view.box[1, a])
    low = float(view.box[0, b]) - view.metres(_BELOW_IN)
    ax.set(xlim=(x - 0.5 * view.metres(wide), x + 0.5 * view.metres(wide)), ylim=(low, low + view.metres(tall)))
    ax.set_axis_off()
    ax.text(0.0, 1.0, view.name, transform=ax.transAxes, fontsize=10.5, fontweight="bold", va="top")


def _draw_top(check: CheckedRobot, view: _View, ax: Axes) -> None:
    robot, g = check.robot, check.robot.geometry
    _limits(view, ax)
    _draw_shapes(view, robot, ax)
    _draw_frame(view, ax)
    _draw_com(view, robot, ax)
    low, high = view.box
    outer = 0.5 * (g.track + g.wheel_width)
    half, off = 0.5 * g.wheelbase, view.metres
    _dimension(ax, view, (-half, half), low[1] - off(0.34), f"wheelbase {g.wheelbase:.4g} m", of=-outer)
    _dimension(
        ax,
        view,
        (-0.5 * g.track, 0.5 * g.track),
        low[0] - off(0.42),
        f"track {g.track:.4g} m",
        upright=True,
        of=-half - g.wheel_radius,
    )
    centre, size = g.body_centre, g.body_size
    hull = (centre[1] - 0.5 * size[1], centre[1] + 0.5 * size[1])
    _dimension(ax, view, hull, high[0] + off(0.42), f"hull {size[1]:.3g} m", upright=True, of=centre[0] + 0.5 * size[0])
    tyre = (0.5 * g.track - 0.5 * g.wheel_width, outer)
    _dimension(ax, view, tyre, high[0] + off(0.42), f"{g.wheel_width:.3g} m", upright=True, of=half + g.wheel_radius)
    total = sum(check.static_loads)
    for load, front, left in zip(check.static_loads, FRONT, LEFT, strict=True):
        share = f"{100.0 * load / total:.0f} %" if total > 0.0 else ""
        ink = ALARM if load <= 0.0 else "0.05"
        words = f"{load:.0f} N\n{share}"
        _label(ax, front * half, 0.5 * left * g.track, words, ha="center", va="center", fontsize=8.5, color=ink)


def _draw_side(check: CheckedRobot, view: _View, ax: Axes) -> None:
    robot, g = check.robot, check.robot.geometry
    _limits(view, ax)
    _draw_shapes(view, robot, ax)
    off, half = view.metres, 0.5 * g.wheelbase
    ground = g.axle_height - g.wheel_radius
    low, high = view.box
    ax.plot([low[0] - off(0.9), high[0] + off(0.9)], [ground, ground], color=_GROUND, linewidth=1.4, zorder=1.2)
    ax.add_patch(Rectangle((low[0] - off(0.9), ground - off(0.07)), high[0] - low[0] + off(1.8), off(0.07), facecolor="0.9",
                           edgecolor="0.6", hatch="////", linewidth=0.0, zorder=1.1))  # fmt: skip
    _draw_frame(view, ax)
    _draw_com(view, robot, ax)
    _dimension(ax, view, (ground, g.axle_height), low[0] - off(0.2), f"r {g.wheel_radius:.4g} m", upright=True, of=-half)
    com, at = whole_com(robot), high[0] + off(0.3)
    _dimension(ax, view, (ground, com[2]), at, "", upright=True, of=com[0])
    ax.text(at + off(0.08), 0.5 * (ground + com[2]), f"{com[2] - ground:.3g} m\ncentre\nof mass", ha="left", va="center",
            fontsize=8.5, color="0.1", linespacing=1.15)  # fmt: skip
    _dimension(
        ax,
        view,
        (-half - g.wheel_radius, -half + g.wheel_radius),
        ground - off(0.32),
        f"⌀ {2.0 * g.wheel_radius:.4g} m",
        of=ground,
    )
    gap = g.wheelbase - 2.0 * g.wheel_radius
    if gap > 0.0:
        _dimension(ax, view, (-0.5 * gap, 0.5 * gap), ground - off(0.32), f"gap {1e3 * gap:.0f} mm", of=ground)


def _draw_heading(check: CheckedRobot, ax: Axes) -> None:
    ax.set_axis_off()
    robot = check.robot
    title, words = abridged(robot.title or robot.name, 60), abridged(robot.description or f"The robot {robot.name}.", 130)
    ax.text(0.0, 1.0, title, transform=ax.transAxes, fontsize=15.0, fontweight="bold", va="top")
    ax.text(0.0, 0.36, words, transform=ax.transAxes, va="top", color="0.25")
    faults = sum(each.fault for each in check.advice)
    said, ink = ("✔ nothing is wrong", "#1e8449") if check.ok else (f"✘ {faults} fault{'s' * (faults > 1)}", ALARM)
    ax.text(1.0, 1.0, said, transform=ax.transAxes, fontsize=13.0, fontweight="bold", va="top", ha="right", color=ink)


def draw_robot(check: CheckedRobot) -> Figure:
    """Draw a robot from above and from the right, its loads, what was found out, and the advice; 1600 px wide."""
    box = robot_outline(check.robot)
    scale = _scale(box)
    top = _View("From above", (0, 1), scale, box)
    side = _View("From its right side", (0, 2), scale, box)
    size = box[1] - box[0]
    heights = [scale * size[1] + _ABOVE_IN + _BELOW_IN, max(scale * size[2] + _ABOVE_IN + _BELOW_IN, 2.3)]
    rows = [
        text_row(_HEADER_IN, partial(_draw_heading, check)),
        _row(heights[0], partial(_draw_top, check, top), partial(draw_facts, check)),
        _row(heights[1], partial(_draw_side, check, side), lambda ax: ax.set_axis_off()),
        *note_rows([("fault: " if each.fault else "hint: ") + each.text for each in check.advice]),
        text_row(_FOOTER_IN, partial(draw_footer, _footer(check))),
    ]
    return put_together(rows)


def _row(height: float, view: Panel, beside: Panel) -> Row:
    return Row(height, ((1.0 - _BESIDE, view), (_BESIDE, beside)), bare=True)


def _footer(check: CheckedRobot) -> str:
    v = check.versions
    return (
        f"loads at rest on level ground · dashed: hull between the tyres · black and white: centre of mass · mujoco "
        f"{v.get('mujoco', '?')} · ssmr-testbed {v.get('ssmr-testbed', '?')} · python -m validation.robots check "
        f"{check.robot.name}"
    )
