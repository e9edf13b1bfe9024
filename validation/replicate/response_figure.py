"""The picture of yaw accelerations (Fig. 3.33) and of step responses, for all models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.types import FloatArray, Trajectory
from validation.show.drawing import QUIET, Panel, draw_footer, ink_of, line_legend, put_together, side_by_side, text_row

_SHOWN = 0.5
"""Duration of the part of the trajectory that is drawn, around a reversal of the turn [s]."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Motions to draw."""

    driven: Mapping[str, Trajectory]
    """Motion on trajectory 4 by plant, at every physics step."""
    speed: Mapping[str, Trajectory]
    """Response to a step of the speed command, by plant."""
    yaw_rate: Mapping[str, Trajectory]
    """Response to a step of the yaw rate command, by plant."""
    step: tuple[float, float]
    """Commanded speed [m/s] and yaw rate [rad/s]."""
    profile: str
    """Name of the profile."""


def _reversal(motion: Trajectory) -> float:
    """Return the time at which the yaw rate changes its sign nearest to the middle of the run [s]."""
    rate, t = motion.twist[:, 2], motion.t
    crossings = t[:-1][rate[1:] * rate[:-1] < 0.0]
    return float(crossings[np.argmin(np.abs(crossings - 0.5 * t[-1]))]) if len(crossings) else 0.5 * float(t[-1])


def _seen(drawn: Responses, name: str) -> tuple[FloatArray, FloatArray]:
    """Return stamps [s] and yaw accelerations [rad/s2] of a plant around the first plant's reversal."""
    motion, middle = drawn.driven[name], _reversal(next(iter(drawn.driven.values())))
    inside = np.abs(motion.t - middle) <= 0.5 * _SHOWN
    return motion.t[inside], motion.channels["yaw_acceleration_rad_s2"][inside]


def _draw_acceleration(drawn: Responses, name: str, reach: tuple[float, float], ax: Axes) -> None:
    t, values = _seen(drawn, name)
    ax.plot(t, values, color=ink_of(name), linewidth=1.0, gid=name)
    ax.set(title=name, xlim=(float(t[0]), float(t[-1])), ylim=reach, xlabel="time [s]")


def _draw_step(drawn: Mapping[str, Trajectory], column: int, command: float, title: str, ax: Axes) -> None:
    for k, (name, motion) in enumerate(drawn.items()):
        ax.plot(motion.t, motion.twist[:, column], color=ink_of(name), linewidth=2.2 - 0.4 * k, gid=name)
    ax.axhline(command, color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0)))
    ax.set(title=title, xlim=(0.0, 1.5), xlabel="time since the command [s]")


def _reach(drawn: Responses) -> tuple[float, float]:
    """Return the limits of the common ordinate [rad/s2]."""
    every = np.concatenate([_seen(drawn, name)[1] for name in drawn.driven])
    spare = 0.06 * float(np.ptp(every))
    return float(every.min()) - spare, float(every.max()) + spare


def draw_responses(drawn: Responses) -> Figure:
    """Draw the accelerations of each plant side by side on one scale, and below them the step responses."""
    reach = _reach(drawn)
    above: list[Panel] = [partial(_draw_acceleration, drawn, name, reach) for name in drawn.driven]
    below: list[Panel] = [
        partial(_draw_step, drawn.speed, 0, drawn.step[0], f"speed [m/s] after a command of {drawn.step[0]:g}"),
        partial(_draw_step, drawn.yaw_rate, 2, drawn.step[1], f"yaw rate [rad/s] after a command of {drawn.step[1]:g}"),
    ]

    def legend(ax: Axes) -> None:
        ax.set_axis_off()
        handles = [Line2D([], [], color=ink_of(name), linewidth=2.0) for name in drawn.driven]
        handles.append(Line2D([], [], color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0))))
        line_legend(ax, handles, [*drawn.driven, "command"])

    def heading(ax: Axes) -> None:
        ax.set_axis_off()
        ax.text(0.0, 0.3, "Yaw acceleration [rad/s²] on trajectory 4, where the turn reverses", fontsize=11.5,
                fontweight="bold", va="bottom", transform=ax.transAxes)  # fmt: skip

    foot = f"every physics step is drawn: 1 ms, mujoco 2 ms · peaks every 50 ms: a new command · profile {drawn.profile}"
    rows = [text_row(0.4, heading), side_by_side(3.0, above), text_row(0.3, legend), side_by_side(3.0, below)]
    return put_together([*rows, text_row(0.3, lambda ax: draw_footer(foot, ax))])
