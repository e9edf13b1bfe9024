"""The numbers beside a robot's picture."""

from __future__ import annotations

import math

from matplotlib.axes import Axes

from validation.robots.data import CheckedRobot
from validation.robots.mechanics import tyre_hull_overlap
from validation.show.drawing import ALARM
from validation.show.tables import NOTHING

_LINE_IN = 0.27
"""Height of a line of numbers [in]."""


def _facts(check: CheckedRobot) -> list[tuple[str, str, bool]]:
    """Return name, value and whether something is wrong, line by line; a name alone is a heading."""
    robot, found, spot = check.robot, check.measured, check.spot
    g, m, mu = robot.geometry, robot.masses, robot.simulation.friction
    gap = g.wheelbase - 2.0 * g.wheel_radius
    overlaps = [max(-across, -round_) for across, round_ in tyre_hull_overlap(robot).values()]
    lines = [
        ("Masses", "", False),
        ("whole robot", f"{m.total:.4g} kg", False),
        ("one wheel", f"{m.wheel:.3g} kg", False),
        ("apparent mass", NOTHING if found is None else f"{found.apparent_mass:.4g} kg", False),
        ("Room", "", False),
        ("front to rear tyre", f"{1e3 * gap:.0f} mm", gap <= 0.0),
        ("tyre to hull", f"{1e3 * min(overlaps):.0f} mm", min(overlaps) < -1e-6),
        ("hull above ground", f"{1e3 * (g.body_centre[2] - 0.5 * g.body_size[2] + g.base_height):.0f} mm", False),
        ("Turn on the spot", "", False),
        ("multiplier in MuJoCo", _plain(found.multiplier if found else None), False),
        ("multiplier by mechanics", _plain(spot.turn.multiplier if spot else None), False),
        ("ripple of the yaw rate", NOTHING if not found or found.ripple is None else f"{100.0 * found.ripple:.2f} %", False),
        ("friction of the ground", f"{mu:g}", False),
    ]
    if spot is not None:
        needed, has = mu * spot.side_torque + robot.drive.gear_loss, 2.0 * robot.drive.torque_limit
        lines.append(("torque that a side needs", f"{needed:.3g} N m", needed > has))
        lines.append(("torque that a side has", f"{has:.3g} N m" if math.isfinite(has) else "no limit", needed > has))
    return lines


def _plain(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"


def draw_facts(check: CheckedRobot, ax: Axes) -> None:
    """Draw the numbers of a check, one a line."""
    ax.set_axis_off()
    figure, box = ax.get_figure(root=True), ax.get_position()
    assert figure is not None
    tall = float(box.height * figure.get_size_inches()[1])
    ax.set(xlim=(0.0, 1.0), ylim=(tall, 0.0))
    lines = _facts(check)
    each = min(_LINE_IN, (tall - 0.3) / len(lines))
    for k, (name, value, wrong) in enumerate(lines):
        y = 0.12 + (k + 0.5) * each
        if not value:
            ax.text(0.0, y, name, va="center", fontsize=9.5, fontweight="bold")
            continue
        ax.text(0.04, y, name, va="center", fontsize=9.5, color="0.25")
        ax.text(1.0, y, value, va="center", ha="right", fontsize=9.5, color=ALARM if wrong else "0.05", gid=name)
        ax.plot([0.04, 1.0], [y + 0.5 * each] * 2, color="0.92", linewidth=0.7)
