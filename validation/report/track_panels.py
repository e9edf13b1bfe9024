"""Robots that followed a reference, as one picture: paths, wanted and actual velocities, errors (Fig. 4.10-4.41)."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ssmr.control.waypoints import ALPHA_SWITCH
from validation.bench.tracked import (
    OF_THE_LOOP,
    OF_THE_PATH,
    TRACK_METRICS,
    TrackedRobot,
    gains_text,
    headline,
    lost_text,
    require_comparable,
)
from validation.report.drawing import (
    ALARM,
    NARROW,
    QUIET,
    REFERENCE_DASHES,
    REFERENCE_INK,
    Dashes,
    Panel,
    Row,
    at_least,
    corner_note,
    draw_dart,
    draw_directions,
    draw_footer,
    draw_loss,
    draw_reference,
    equal_scales,
    ink_of,
    line_legend,
    narrow,
    put_together,
    side_by_side,
    stacked,
    text_row,
)
from validation.report.tables import DEGREES, Unit, length_unit, shortened, units_of
from validation.simulator.terrain import FLAT

_SHOWN = [TRACK_METRICS[name] for name in (*OF_THE_PATH, *OF_THE_LOOP)]
_WIDE = 2.6  # a reference wider than so many times its height has a row of its own
_TITLE_IN, _TABLE_LINE_IN, _GAINS_LINE_IN, _LEGEND_IN, _FOOTER_IN = 0.34, 0.2, 0.17, 0.26, 0.22
_WIDE_IN, _TALL_IN, _ERRORS_IN, _SPEEDS_IN = (1.5, 2.25), 4.0, 2.0, 2.0
_HEADING_IN = (9.0, 7.0)  # width of the heading at most, and where somebody was lost
_GAINS_WRAP = 195  # characters in a line of gains
_NAMES_SHARE = 0.17  # of the width, for the robots' names in the table of measures
_LEAST_TIME = 0.5  # of a time axis [s]
_WANTED_DASHES: Dashes = (0.0, (3.5, 1.4))
_WANTED, _COMMAND, _SEEN, _SHADE, _SHADE_ALPHA = "0.2", "0.6", "0.8", "#d9534f", 0.11
_STRIP = 0.035  # of a panel's height, for each robot's strip of saturation where there are several


# --- header, footer ---


def _draw_title(results: Sequence[TrackedRobot], ax: Axes) -> None:
    """Draw the title, and whether a robot was lost."""
    ax.set_axis_off()
    first = results[0]
    who = f"plant {first.plant}" if len(results) == 1 else f"{len(results)} plants"
    title = f"{headline(first)} · {who}"
    heading = ax.text(0.0, 1.0, title, transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    lost = [r for r in results if r.run.lost]
    narrow(heading, _HEADING_IN[bool(lost)])
    if len(lost) == 1:
        word = f"{lost[0].plant} LOST{lost_text(lost[0].run).removeprefix('lost')}"
    else:
        word = f"LOST: {', '.join(f'{r.plant} at {r.run.t[-1]:.2f} s' for r in lost)}"
    word = word if lost else f"profile {shortened(first.profile_label, 32)} · seed {first.seed}"
    ax.text(1.0, 1.0, word, transform=ax.transAxes, ha="right", va="top", fontsize=10.5,
            fontweight="bold" if lost else "normal", color=ALARM if lost else QUIET)  # fmt: skip


def _draw_gains(lines: Sequence[str], ax: Axes) -> None:
    ax.set_axis_off()
    for k, line in enumerate(lines):
        text = ax.text(0.0, 1.0 - (k + 0.5) / len(lines), line, transform=ax.transAxes, va="center", color="0.25")
        for size in (8.5, 8.0, 7.5, 7.0, 6.5):
            text.set_fontsize(size)
            if text.get_window_extent().width <= ax.get_window_extent().width:
                break


def _draw_measures(results: Sequence[TrackedRobot], ax: Axes) -> None:
    """Draw a row of measures for each robot; it is the legend of the plants too."""
    ax.set_axis_off()
    ax.set(xlim=(0.0, 1.0), ylim=(len(results) + 0.5, -1.5))
    units = units_of(_SHOWN, [r.metrics for r in results])
    step = (1.0 - _NAMES_SHARE) / len(_SHOWN)
    for k, (measure, unit) in enumerate(zip(_SHOWN, units, strict=True)):
        right = _NAMES_SHARE + (k + 1) * step
        words = "\n".join(filter(None, measure.label.rpartition(" ")[::2]))
        symbol = "" if unit.symbol == "1" else f"{' ' if ' ' in measure.label else chr(10)}[{unit.symbol}]"
        ax.text(right, 0.36, f"{words}{symbol}", ha="right", va="bottom", fontsize=8.0, color=QUIET, linespacing=1.1)
        for row, r in enumerate(results, start=1):
            ax.text(right, row, unit.text(r.metrics[measure.name]), ha="right", va="center", fontsize=9.5)
    ax.axhline(0.44, color="0.8", linewidth=0.7)
    for row, r in enumerate(results, start=1):
        ax.plot([0.002, 0.03], [row, row], color=ink_of(r.plant), linewidth=2.4, clip_on=False)
        name = f"{r.plant}{' (LOST)' * r.run.lost}"
        ax.text(0.037, row, name, va="center", fontsize=9.5, fontweight="bold", color=ALARM if r.run.lost else "0.1")


def _draw_legend(results: Sequence[TrackedRobot], ax: Axes) -> None:
    """Draw the legend of everything but the robots."""
    ax.set_axis_off()
    alone = len(results) == 1
    handles: list[Artist] = [
        Line2D([], [], color=REFERENCE_INK, linewidth=0.9, linestyle=REFERENCE_DASHES),
        Line2D([], [], color=_WANTED if alone else "0.5", linewidth=0.9, linestyle="solid" if alone else _WANTED_DASHES),
    ]
    labels = ["reference", "wanted by the position loop"]
    if alone:
        handles.append(Line2D([], [], color=_COMMAND, linewidth=1.0))
        labels.append("command to the drive")
        if _shows_seen(results[0]):
            handles.append(Line2D([], [], color=_SEEN, linewidth=2.0))
            labels.append("as the controller sees it")
    if any(r.saturated.any() for r in results):
        handles.append(Patch(facecolor=_SHADE, alpha=1.5 * _SHADE_ALPHA) if alone else Patch(facecolor="0.5", alpha=0.8))
        labels.append("a torque or the command at its limit" + ": strips below speed and yaw rate" * (not alone))
    line_legend(ax, handles, labels)


def _footer_text(result: TrackedRobot) -> str:
    parts = [f"profile {shortened(result.profile_label, 32)}", f"seed {result.seed}"]
    options = (("feedback", "feedback {}"), ("lookahead_m", "look-ahead {:g} m"))
    parts += [text.format(result.options[k]) for k, text in options if k in result.options]
    parts += [] if result.terrain == FLAT else [f"terrain {result.terrain.spec}"]
    parts += ["yaw disturbed"] * (result.options.get("disturbance") is True)
    parts += [f"{k} {result.versions[k]}" for k in ("ssmr-testbed", "mujoco", "numpy") if k in result.versions]
    return shortened(" · ".join(parts), 170)


# --- over time ---


def _shows_seen(result: TrackedRobot) -> bool:
    """Return whether the controller saw something else than the truth."""
    return len(result.run.t) > 0 and not np.array_equal(
        result.run.columns("seen_v", "seen_w"), result.run.columns("v_x", "yaw_rate")
    )


def _finish_time(results: Sequence[TrackedRobot], strips: bool, ax: Axes) -> None:
    """Set the time axis, and mark losses and saturation; with several robots saturation is a strip for each."""
    alone = len(results) == 1
    last = max((float(r.run.t[-1]) for r in results if len(r.run.t)), default=0.0)
    ax.set(xlim=(0.0, max(last, _LEAST_TIME)), xlabel="time [s]")
    ax.locator_params(axis="y", nbins=6)
    for row, r in enumerate(results):
        t = r.run.t
        if r.run.lost and len(t):
            ax.axvline(t[-1], color=ALARM, linewidth=1.0, linestyle=":", zorder=1.9, gid=f"{r.plant} lost")
        at_limit = r.saturated
        if not at_limit.any() or not (strips or alone):
            continue
        lasting = at_limit | np.concatenate([[False], at_limit[:-1]])  # a tick stands for the time until the next
        below = (len(results) - 1 - row) * _STRIP
        low, high = (0.0, 1.0) if alone else (below, below + _STRIP)
        ink, alpha = (_SHADE, _SHADE_ALPHA) if alone else (ink_of(r.plant), 0.8)
        ax.fill_between(
            t, low, high, where=lasting, step="post", transform=ax.get_xaxis_transform(), color=ink, alpha=alpha,
            linewidth=0.0, zorder=0.5, gid=f"{r.plant} saturated",
        )  # fmt: skip


def _marker(result: TrackedRobot) -> str:  # of a robot that was lost before there is a line to show
    return "o" if len(result.run.t) < 2 else ""


def _draw_speed(
    results: Sequence[TrackedRobot], title: str, names: tuple[str, str, str, str], target: int, least: float, ax: Axes
) -> None:
    """Draw the actual, wanted and commanded velocity, and that of the reference, whose last sample stands for no time.

    `names` are the columns of the actual, the wanted, the commanded and the observed velocity.
    """
    done, wanted, commanded, seen = names
    longest = max(results, key=lambda r: len(r.target))
    t, wanted_by = longest.target.t[:-1], longest.target.twist[:-1, target]
    ax.plot(t, wanted_by, color=REFERENCE_INK, linewidth=0.9, linestyle=REFERENCE_DASHES, zorder=2.2, gid="reference")
    alone = len(results) == 1
    for r in results:
        t = r.run.t
        if alone and _shows_seen(r):
            ax.plot(t, r.run.column(seen), color=_SEEN, linewidth=0.6, alpha=0.7, zorder=1.2, gid=f"{r.plant} seen")
        if alone:
            ax.plot(t, r.run.column(commanded), color=_COMMAND, linewidth=0.9, drawstyle="steps-post", zorder=1.5,
                    gid=f"{r.plant} command")  # fmt: skip
        ink = _WANTED if alone else ink_of(r.plant)
        ax.plot(t, r.run.column(wanted), color=ink, linewidth=0.8, linestyle="solid" if alone else _WANTED_DASHES,
                alpha=1.0 if alone else 0.45, zorder=1.8, gid=f"{r.plant} wanted")  # fmt: skip
        ax.plot(t, r.run.column(done), color=ink_of(r.plant), linewidth=NARROW, marker=_marker(r), zorder=2.5, gid=r.plant)
    ax.set_title(title)
    at_least(ax, least)
    if not alone:
        low, high = ax.get_ylim()
        ax.set_ylim(low - len(results) * _STRIP * (high - low), high)  # room for the strips
    _finish_time(results, True, ax)


def _draw_error(results: Sequence[TrackedRobot], title: str, column: str, unit: Unit, least: float, ax: Axes) -> None:
    """Draw one of the errors that the controller sees, and the value that it should reach."""
    lookahead = results[0].options.get("lookahead_m")
    goal = float(lookahead) if column == "e_rho" and isinstance(lookahead, int | float) else 0.0
    ax.axhline(goal * unit.scale, color=REFERENCE_INK, linewidth=0.9, linestyle=REFERENCE_DASHES, zorder=1.8, gid="goal")
    for r in results:
        error = r.run.column(column) * unit.scale
        ax.plot(r.run.t, error, color=ink_of(r.plant), linewidth=1.2, marker=_marker(r), zorder=2.5, gid=r.plant)
    ax.set_title(f"{title} [{unit.symbol}]")
    at_least(ax, least * unit.scale)
    if column == "e_alpha" and any(np.any(np.abs(r.run.column("e_rho")) > ALPHA_SWITCH) for r in results):
        corner_note(ax, f"zero if the target is farther than {ALPHA_SWITCH:g} m")
    _finish_time(results, False, ax)


# --- paths ---


def _draw_paths(results: Sequence[TrackedRobot], ax: Axes) -> None:
    """Draw the reference, from its ring to its square, and the paths of the robots, which end in darts."""
    longest = max(results, key=lambda r: len(r.target)).target
    draw_reference(ax, longest.xy)
    for r in results:
        x, y = r.run.columns("x", "y").T
        ax.plot(x, y, color=ink_of(r.plant), linewidth=2.0, zorder=2.5, gid=r.plant)
        if not len(x):
            continue
        draw_dart(ax, r.run.columns("x", "y", "yaw")[-1], r.plant, 13.0)
        if r.run.lost:
            draw_loss(ax, x[-1], y[-1], f"{r.plant} lost")
    if len(results) == 1 and len(results[0].run.t):
        draw_directions(ax, results[0].run.columns("x", "y"), results[0].plant, (0.25, 0.55))
    equal_scales(ax, 0.6)
    ax.set(title="Paths [m] (ring: start; square: end)", xlabel="x [m]", ylabel="y [m]", label="paths")


# --- all of it ---


def _motion_rows(results: Sequence[TrackedRobot]) -> list[Row]:
    """Return the panels of paths, velocities and errors in rows, arranged by the width of the paths."""
    reach = [np.abs(r.run.columns("e_rho", "e_y")).max() for r in results if len(r.run.t)]
    length = length_unit([float(max(reach, default=0.0))])
    speeds: list[Panel] = [
        partial(_draw_speed, results, "Speed u [m/s]", ("v_x", "u_ref", "v_cmd", "seen_v"), 0, 0.1),
        partial(_draw_speed, results, "Yaw rate [rad/s]", ("yaw_rate", "w_ref", "w_cmd", "seen_w"), 2, 0.1),
    ]
    errors: list[Panel] = [
        partial(_draw_error, results, "e_rho: distance to the target", "e_rho", length, 0.01),
        partial(_draw_error, results, "e_y: offset to the left", "e_y", length, 0.01),
        partial(_draw_error, results, "e_alpha: heading", "e_alpha", DEGREES, math.radians(1.0)),
    ]
    paths = partial(_draw_paths, results)
    every = np.concatenate([xy for r in results for xy in (r.target.xy, r.run.columns("x", "y"))])
    width, height = np.ptp(every, axis=0) + 0.3
    if width > _WIDE * height:
        tall = float(np.clip(12.0 * height / width + 0.75, *_WIDE_IN))
        return [Row(tall, ((1.0, paths),)), side_by_side(_SPEEDS_IN, speeds), side_by_side(_ERRORS_IN, errors)]
    share = float(np.clip(0.07 + 0.27 * width / height, 0.3, 0.46))
    beside = partial(stacked, [(0.5, panel) for panel in speeds])
    return [Row(_TALL_IN, ((share, paths), (1.0 - share, beside))), side_by_side(_ERRORS_IN, errors)]


def draw_track(results: Sequence[TrackedRobot]) -> Figure:
    """Return the picture of robots that followed one reference, 1600 px wide.

    It shows measures, paths, speed and yaw rate with what the position loop wanted and what was commanded, and the three
    errors of up to five robots. Lines carry their plant as gid, or `PLANT wanted`, `PLANT command`, `PLANT seen`,
    `reference`.

    Raises:
        ValueError: robots that cannot be shown beside one another.
    """
    require_comparable(results)
    gains_line = f"gains {shortened(results[0].gains_name, 40)}: {gains_text(results[0].gains)}"
    gains = textwrap.wrap(gains_line, _GAINS_WRAP, break_on_hyphens=False)
    rows = [
        text_row(_TITLE_IN, partial(_draw_title, results)),
        text_row(_GAINS_LINE_IN * len(gains), partial(_draw_gains, gains)),
        text_row(_TABLE_LINE_IN * (len(results) + 2), partial(_draw_measures, results)),
        text_row(_LEGEND_IN, partial(_draw_legend, results)),
        Row(0.1, ()),
        *_motion_rows(results),
        text_row(_FOOTER_IN, partial(draw_footer, _footer_text(results[0]))),
    ]
    return put_together(rows)
