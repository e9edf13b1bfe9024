"""A picture of robots on a reference: paths, velocities and errors (Fig. 4.10-4.41)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ssmr.control.waypoints import ALPHA_SWITCH
from ssmr.geometry import relative, wrap_angle
from ssmr.types import Trajectory
from validation.experiment.tracked import Followed, lost_text, saturated
from validation.output import shortened
from validation.report.columns import DEGREES, Unit, length_unit
from validation.report.drawing import (
    ALARM,
    COMMAND_LOOK,
    NARROW,
    REFERENCE_LOOK,
    Curve,
    Panel,
    PanelRow,
    draw_curves,
    draw_page,
    draw_paths,
    ink_of,
    key_line,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDE = 2.6  # a reference wider than so many times its height has a row of its own
_SPEEDS = {
    "Speed u [m/s]": (0, "v_x", "u_ref", "v_cmd"),
    "Yaw rate [rad/s]": (2, "yaw_rate", "w_ref", "w_cmd"),
}
_ERRORS = {
    "e_rho": "how far ahead the target is",
    "e_y": "its offset to the left",
    "e_alpha": "its heading",
}
_REQUEST = {"linewidth": 0.8, "alpha": 0.6, "zorder": 1.8}
_SATURATED: dict[str, Any] = {"color": "#d9534f", "alpha": 0.12, "zorder": 0.5, "gid": "saturated"}


def longest_target(robots: Sequence[Followed]) -> Trajectory:
    """Return the target that was followed for the longest time."""
    return max((robot.target for robot in robots), key=len)


def error_units(robots: Sequence[Followed]) -> dict[str, Unit]:
    """Return the units of the errors to the moving target, by column."""
    reach = [np.abs(r.run.columns("e_rho", "e_y")).max() for r in robots if len(r.run.t)]
    length = length_unit([float(max(reach, default=0.0))])
    return dict(zip(_ERRORS, (length, length, DEGREES), strict=True))


def _look_of(robot: Followed) -> dict[str, Any]:
    """Return how a robot's line looks; of one that was lost at once there is only a point."""
    marker = "o" if len(robot.run.t) < 2 else ""
    look = {"linewidth": NARROW, "marker": marker, "zorder": 2.5, "gid": robot.plant}
    return {"color": ink_of(robot.plant), **look}


def _velocities(
    robots: Sequence[Followed], column: int, done: str, wanted: str, commanded: str
) -> list[Curve]:
    """Return the actual and the wanted velocity of each robot, and that of the reference.

    Of a single robot the command is there too.
    """
    target = longest_target(robots)
    curves: list[Curve] = [(target.t[:-1], target.twist[:-1, column], REFERENCE_LOOK)]
    for r in robots:
        look = _look_of(r)
        request = {**_REQUEST, "color": look["color"], "gid": f"{r.plant} wanted"}
        curves += [(r.run.t, r.run.column(done), look), (r.run.t, r.run.column(wanted), request)]
    if len(robots) == 1:
        curves.append((r.run.t, r.run.column(commanded), COMMAND_LOOK))
    return curves


def _true_errors(robots: Sequence[Followed], name: str, unit: Unit) -> list[Curve]:
    """Return an error of the robots themselves, not of what they see, and what it should reach."""
    goal = robots[0].options.get("lookahead_m", 0.0) if name == "e_rho" else 0.0
    t = longest_target(robots).t[[0, -1]]
    curves: list[Curve] = [(t, np.full(2, goal * unit.scale), {**REFERENCE_LOOK, "gid": "goal"})]
    for r in robots:
        aim = r.run.columns("target_x", "target_y", "target_yaw")
        x, y, yaw = relative(r.run.columns("x", "y", "yaw"), aim).T
        turn = np.where(np.hypot(x, y) <= ALPHA_SWITCH, wrap_angle(yaw), 0.0)
        error = dict(zip(_ERRORS, (x, y, turn), strict=True))[name]
        curves.append((r.run.t, unit.scale * error, _look_of(r)))
    return curves


def _draw_over_time(
    robots: Sequence[Followed], curves: Sequence[Curve], title: str, least: float, ax: Axes
) -> None:
    """Draw lines over time, and mark where robots were lost, or the only one at its limits."""
    last = max((float(r.run.t[-1]) for r in robots if len(r.run.t)), default=0.0)
    draw_curves(curves, least, ax, title=title, xlim=(0.0, max(last, 0.5)), xlabel="time [s]")
    ax.locator_params(axis="y", nbins=6)
    for r in robots:
        if r.run.lost and len(r.run.t):
            ax.axvline(r.run.t[-1], color=ALARM, linewidth=1.0, linestyle=":", zorder=1.9)
    run = robots[0].run
    at_limit = saturated(run, robots[0].options)
    if len(robots) == 1 and at_limit.any():
        # a tick stands for the time until the next
        lasting = at_limit | np.append(False, at_limit[:-1])
        across = ax.get_xaxis_transform()
        ax.fill_between(
            run.t,
            0.0,
            1.0,
            where=lasting,
            step="post",
            transform=across,
            linewidth=0.0,
            **_SATURATED,
        )


def _draw_robot_paths(robots: Sequence[Followed], ax: Axes) -> None:
    """Draw the reference, from its ring to its square, and the robots' paths, ended by darts."""
    reference = longest_target(robots).xy
    x, y = reference.T
    curves: list[Curve] = [(x, y, {**REFERENCE_LOOK, "zorder": 2.8})]
    square = {"marker": "s", "markersize": 6.5, "color": "0.1", "mfc": "white", "zorder": 3.4}
    curves.append((x[-1:], y[-1:], square))
    ends = {}
    for r in robots:
        x, y, yaw = r.run.columns("x", "y", "yaw").T
        curves.append((x, y, _look_of(r)))
        if len(x):
            ends[r.plant] = np.array([x[-1], y[-1], yaw[-1]])
        if r.run.lost:
            cross = {"marker": "x", "color": ALARM, "markersize": 10.0, "mew": 2.1, "zorder": 4.5}
            curves.append((x[-1:], y[-1:], cross))
    draw_paths(curves, ends, 0.6, ax)
    ax.set(title="Paths [m] (ring: start; square: end)", xlabel="x [m]", ylabel="y [m]")


def draw_track(robots: Sequence[Followed], title: str, gains: str, foot: str) -> Figure:
    """Return the picture of robots that followed one reference, 1600 px wide.

    It shows paths, speed and yaw rate with what the position loop wanted and what was commanded,
    and the three true errors of up to five robots. Lines carry their plant as gid, or
    `PLANT wanted`, `reference`.

    Args:
        robots: the robots.
        title: what they did.
        gains: the controller's gains, in words.
        foot: how they were driven.
    """
    panels = list[Panel]()
    for name, unit in error_units(robots).items():
        heading = f"{name}: {_ERRORS[name]} [{unit.symbol}]"
        least = 1.0 if unit is DEGREES else 0.01 * unit.scale
        curves = _true_errors(robots, name, unit)
        panels.append(partial(_draw_over_time, robots, curves, heading, least))
    speeds = list[Panel]()
    for heading, columns in _SPEEDS.items():
        curves = _velocities(robots, *columns)
        speeds.append(partial(_draw_over_time, robots, curves, heading, 0.1))
    paths = partial(_draw_robot_paths, robots)
    places = [r.target.xy for r in robots] + [r.run.columns("x", "y") for r in robots]
    width, height = np.ptp(np.concatenate(places), axis=0) + 0.3
    rows = [PanelRow(3.6, [paths, *speeds], (0.3, 0.35, 0.35))]
    if width > _WIDE * height:
        tall = float(np.clip(12.0 * height / width + 0.75, 1.5, 2.25))
        rows = [PanelRow(tall, [paths]), PanelRow(2.0, speeds)]
    plants = robots[0].plant if len(robots) == 1 else f"{len(robots)} simulations"
    heading = f"{title} · {plants}"
    lost = [r for r in robots if r.run.lost]
    if lost:
        heading += f" · LOST: {', '.join(r.plant for r in lost)}"
    unit = length_unit([r.metrics["d_rms_m"] for r in robots])
    looks: dict[str, Any] = {}
    for r in robots:
        d_rms = f"d_rms {unit.text(r.metrics['d_rms_m'])} {unit.symbol}"
        looks[f"{r.plant}\n{d_rms}"] = _look_of(r)
    looks |= {"reference\n": REFERENCE_LOOK, "pale: speed\nrequest": {**_REQUEST, "color": "0.5"}}
    if len(robots) == 1:
        looks["command to\nthe drive"] = COMMAND_LOOK
        looks["a torque or the\ncommand at its limit"] = {**_SATURATED, "linewidth": 7.0}
    return draw_page(
        shortened(heading, 100),
        [*rows, PanelRow(2.0, panels)],
        legend=[key_line(label, **look) for label, look in looks.items()],
        notes=[*(f"{r.plant} was {lost_text(r.run)}" for r in lost), gains],
        foot=foot,
        ink=ALARM if lost else "0.0",
    )
