"""A picture of robots on a reference: paths, velocities and errors (Fig. 4.10-4.41)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ssmr.control.loop import ClosedRun
from ssmr.control.waypoints import ALPHA_SWITCH
from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray, Trajectory
from validation.experiment.tracked import Followed, lost_text, saturated
from validation.output import shortened
from validation.report.columns import DEGREES, Unit, length_unit
from validation.report.drawing import (
    ALARM,
    NARROW,
    REFERENCE_DASHES,
    REFERENCE_INK,
    PanelRow,
    at_least,
    draw_dart,
    draw_page,
    draw_ring,
    equal_scales,
    ink_of,
    key_line,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_WIDE = 2.6  # a reference wider than so many times its height has a row of its own
_SPEEDS = (
    ("Speed u [m/s]", ("v_x", "u_ref", "v_cmd"), 0),
    ("Yaw rate [rad/s]", ("yaw_rate", "w_ref", "w_cmd"), 2),
)
_WANTED = "0.6"
_COMMAND = "#6a3d9a"
_ERRORS = ("e_rho", "e_y", "e_alpha")
_SATURATED = "#d9534f"
_REFERENCE: dict[str, Any] = {
    "color": REFERENCE_INK,
    "linewidth": 1.0,
    "linestyle": REFERENCE_DASHES,
}


def longest_target(robots: Sequence[Followed]) -> Trajectory:
    """Return the target that was followed for the longest time."""
    return max((robot.target for robot in robots), key=len)


def _legend(robots: Sequence[Followed]) -> list[Line2D]:
    unit = length_unit([r.metrics["d_rms_m"] for r in robots])
    looks: dict[str, dict[str, Any]] = {}
    for r in robots:
        d_rms = f"d_rms {unit.text(r.metrics['d_rms_m'])} {unit.symbol}"
        looks[f"{r.plant}\n{d_rms}"] = {"color": ink_of(r.plant), "linewidth": 2.4}
    looks["reference\n"] = _REFERENCE
    # several robots' requests have their own colours, but pale
    request = "speed\nrequest" if len(robots) == 1 else "pale: speed\nrequest"
    looks[request] = {"color": _WANTED, "linewidth": 0.8, "alpha": 0.6}
    if len(robots) == 1:
        looks["command to\nthe drive"] = {"color": _COMMAND}
        saturated = {"color": _SATURATED, "linewidth": 7.0, "alpha": 0.2}
        looks["a torque or the\ncommand at its limit"] = saturated
    return [key_line(label, **look) for label, look in looks.items()]


def _finish_time(robots: Sequence[Followed], ax: Axes) -> None:
    """Set the time axis, and mark where robots were lost, or the only one at its limits."""
    last = max((float(r.run.t[-1]) for r in robots if len(r.run.t)), default=0.0)
    ax.set(xlim=(0.0, max(last, 0.5)), xlabel="time [s]")
    ax.locator_params(axis="y", nbins=6)
    for r in robots:
        if r.run.lost and len(r.run.t):
            ax.axvline(
                r.run.t[-1],
                color=ALARM,
                linewidth=1.0,
                linestyle=":",
                zorder=1.9,
                gid=f"{r.plant} lost",
            )
    run = robots[0].run
    at_limit = saturated(run, robots[0].options)
    if len(robots) == 1 and at_limit.any():
        # A tick stands for the time until the next.
        lasting = at_limit | np.append(False, at_limit[:-1])
        ax.fill_between(
            run.t,
            0.0,
            1.0,
            where=lasting,
            step="post",
            transform=ax.get_xaxis_transform(),
            color=_SATURATED,
            alpha=0.12,
            linewidth=0.0,
            zorder=0.5,
            gid="saturated",
        )


def _marker(robot: Followed) -> str:  # of a robot that was lost before there is a line to show
    if len(robot.run.t) < 2:
        return "o"
    return ""


def _draw_speed(
    robots: Sequence[Followed], title: str, names: tuple[str, str, str], column: int, ax: Axes
) -> None:
    """Draw the actual, wanted and commanded velocity, and that of the reference."""
    done, wanted, commanded = names
    target = longest_target(robots)
    ax.plot(
        target.t[:-1],
        target.twist[:-1, column],
        **_REFERENCE,
        zorder=2.2,
        gid="reference",
    )
    for r in robots:
        run = r.run
        ink = _WANTED if len(robots) == 1 else ink_of(r.plant)
        if len(robots) == 1:
            ax.plot(
                run.t,
                run.column(commanded),
                color=_COMMAND,
                linewidth=0.9,
                drawstyle="steps-post",
                zorder=1.5,
            )
        ax.plot(
            run.t,
            run.column(wanted),
            color=ink,
            linewidth=0.8,
            alpha=0.6,
            zorder=1.8,
            gid=f"{r.plant} wanted",
        )
        ax.plot(
            run.t,
            run.column(done),
            color=ink_of(r.plant),
            linewidth=NARROW,
            marker=_marker(r),
            zorder=2.5,
            gid=r.plant,
        )
    ax.set_title(title)
    at_least(ax, 0.1)
    _finish_time(robots, ax)


def _draw_error(
    robots: Sequence[Followed], title: str, column: str, unit: Unit, least: float, ax: Axes
) -> None:
    """Draw one of the errors, without noise, and the value that it should reach."""
    lookahead = robots[0].options.get("lookahead_m")
    goal = float(lookahead) if column == "e_rho" and isinstance(lookahead, int | float) else 0.0
    ax.axhline(
        goal * unit.scale,
        **_REFERENCE,
        zorder=1.8,
        gid="goal",
    )
    for r in robots:
        error = _true_errors(r.run)[:, _ERRORS.index(column)] * unit.scale
        ax.plot(
            r.run.t,
            error,
            color=ink_of(r.plant),
            linewidth=1.2,
            marker=_marker(r),
            zorder=2.5,
            gid=r.plant,
        )
    ax.set_title(f"{title} [{unit.symbol}]")
    at_least(ax, least * unit.scale)
    _finish_time(robots, ax)


def _draw_paths(robots: Sequence[Followed], ax: Axes) -> None:
    """Draw the reference, from its ring to its square, and the robots' paths, ended by darts."""
    reference = longest_target(robots).xy
    ax.plot(
        *reference.T,
        **_REFERENCE,
        zorder=2.8,
        gid="reference",
    )
    ax.plot(
        *reference[-1],
        "s",
        markersize=6.5,
        markerfacecolor="white",
        markeredgecolor=REFERENCE_INK,
        zorder=3.4,
    )
    draw_ring(ax, *map(float, reference[0]))
    for r in robots:
        x, y = r.run.columns("x", "y").T
        ax.plot(x, y, color=ink_of(r.plant), linewidth=2.0, zorder=2.5, gid=r.plant)
        if not len(x):
            continue
        draw_dart(ax, r.run.columns("x", "y", "yaw")[-1], r.plant, 12.0)
        if r.run.lost:
            ax.plot(
                x[-1],
                y[-1],
                "x",
                color=ALARM,
                markersize=10.0,
                markeredgewidth=2.1,
                zorder=4.5,
                gid=f"{r.plant} lost",
            )
    equal_scales(ax, 0.6)
    ax.set(title="Paths [m] (ring: start; square: end)", xlabel="x [m]", ylabel="y [m]")


def _true_errors(run: ClosedRun) -> FloatArray:
    """Return (M, 3) e_rho, e_y [m] and e_alpha [rad] of the robot itself, not of what it sees."""
    x, y, yaw, *aim = run.columns("x", "y", "yaw", "target_x", "target_y", "target_yaw").T
    dx = aim[0] - x
    dy = aim[1] - y
    along = np.cos(yaw) * dx + np.sin(yaw) * dy
    aside = np.cos(yaw) * dy - np.sin(yaw) * dx
    turn = np.where(np.hypot(dx, dy) <= ALPHA_SWITCH, wrap_angle(aim[2] - yaw), 0.0)
    return np.column_stack([along, aside, turn])


def error_units(robots: Sequence[Followed]) -> dict[str, Unit]:
    """Return the units of the errors to the moving target, by column."""
    reach = [np.abs(r.run.columns("e_rho", "e_y")).max() for r in robots if len(r.run.t)]
    length = length_unit([float(max(reach, default=0.0))])
    return dict(zip(_ERRORS, (length, length, DEGREES), strict=True))


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
    titles = ("how far ahead the target is", "its offset to the left", "its heading")
    units = error_units(robots)
    panels = []
    for error, (column, unit) in zip(titles, units.items(), strict=True):
        least = math.radians(1.0) if unit is DEGREES else 0.01
        panels.append(partial(_draw_error, robots, f"{column}: {error}", column, unit, least))
    speeds = [partial(_draw_speed, robots, *speed) for speed in _SPEEDS]
    paths = partial(_draw_paths, robots)
    places = list[FloatArray]()
    for r in robots:
        places += [r.target.xy, r.run.columns("x", "y")]
    width, height = np.ptp(np.concatenate(places), axis=0) + 0.3
    if width > _WIDE * height:
        tall = float(np.clip(12.0 * height / width + 0.75, 1.5, 2.25))
        rows = [PanelRow(tall, [paths]), PanelRow(2.0, speeds)]
    else:
        rows = [PanelRow(3.6, [paths, *speeds], (0.3, 0.35, 0.35))]
    plants = robots[0].plant if len(robots) == 1 else f"{len(robots)} simulations"
    heading = f"{title} · {plants}"
    lost = [r for r in robots if r.run.lost]
    if lost:
        heading += f" · LOST: {', '.join(r.plant for r in lost)}"
    return draw_page(
        shortened(heading, 100),
        [*rows, PanelRow(2.0, panels)],
        legend=_legend(robots),
        notes=[*(f"{r.plant} was {lost_text(r.run)}" for r in lost), gains],
        foot=foot,
        ink=ALARM if lost else "0.0",
    )
