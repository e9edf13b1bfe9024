"""A comparison as one picture: where every plant went, how far off it was, and what its velocities and wheel loads did.

A short run is shown as it was driven. A run longer than `LONGEST_PATH`, or in pieces, is open-loop drift after a while:
there the paths are those of a few windows, each laid on the reference's pose at its start. Where there are errors by
horizon they take the place of errors over time.

Everything is drawn by matplotlib's objects under a style of its own: no pyplot, and no setting outlives a call.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ssmr.geometry import relative, wrap_angle
from ssmr.metrics.poses import horizon_windows, relative_pose_error
from ssmr.metrics.windows import OverlappingErrors
from ssmr.types import FloatArray
from validation.report.drawing import (
    WIDTH_IN,
    HorizonMarks,
    Interval,
    Panel,
    Row,
    Span,
    at_least,
    draw_dart,
    draw_directions,
    draw_footer,
    draw_horizons,
    draw_ring,
    draw_section,
    equal_scales,
    hold_limits,
    ink_of,
    joined,
    line_legend,
    note_rows,
    position_interval,
    put_together,
    side_by_side,
    text_row,
    yaw_degrees,
    yaw_interval,
)
from validation.report.motions import HEADLINE_HORIZON, Comparison, headline_error
from validation.report.tables import length_unit, shortened
from validation.report.time_panels import (
    COMMAND_INK,
    draw_acceleration,
    draw_loads,
    draw_velocity,
    drawn_motions,
    has_channel,
    has_speed_commands,
    is_impulsive,
    whole_span,
)
from validation.simulator.terrain import FLAT

LONGEST_PATH = 30.0
"""Runs longer than this are shown in windows [s]: open-loop errors have grown beyond reading by then."""
MAX_WINDOWS = 4
"""Number of windows shown; their errors are spread evenly from the least to the greatest."""

_LEAST_MOTION = 0.05
"""Way [m] or turn [rad] from which a plant moves in a window; a window without any motion is drawn only if all are so."""

_HEADER_IN, _SECTION_IN, _ROW_IN, _WINDOW_IN, _FOOTER_IN = 0.78, 0.28, 2.3, 3.2, 0.22
_ZOOM_IN, _PATHS_IN = 4.0, (3.0, 5.5)  # least width of the zoom; least and greatest height of the paths

_MARKERS = {
    "mujoco": "o", "improved": "s", "coulomb": "^", "linear": "D", "kinematic": "v",
    "four_wheel": "p", "ode": "P", "drake": "X",
}  # fmt: skip


def _draw_paths(comparison: Comparison, ax: Axes) -> None:
    """Draw the paths as they were driven."""
    for motion in drawn_motions(comparison):
        motion.draw(ax, *joined([(piece.pose[:, 0], piece.pose[:, 1]) for piece in motion.pieces]))
        draw_dart(ax, motion.pieces[-1].pose[-1], motion.name, 12.0)
    first = comparison.reference[0]
    draw_directions(ax, first.xy, comparison.reference_name, (0.15, 0.4, 0.65))
    draw_ring(ax, *map(float, first.xy[0]))
    equal_scales(ax, 1.0)
    ax.set(title="Paths [m] (ring: start; arrows: direction)", xlabel="x [m]", ylabel="y [m]", label="paths")


_Zoom = tuple[int, int, float, float, float]
"""Piece, sample, middle of all positions then (x, y), and their extent [m]."""


def _find_zoom(comparison: Comparison) -> _Zoom | None:
    """Return where a plant is farthest from the reference; None if that shows no more than the whole picture does."""
    worst, i, k = 0.0, 0, 0
    reference, *others = drawn_motions(comparison)
    for motion in others:
        for index, (piece, true) in enumerate(zip(motion.pieces, reference.pieces, strict=True)):
            error = np.hypot(*(piece.xy - true.xy).T)
            if error.max() > worst:
                worst, i, k = float(error.max()), index, int(np.argmax(error))
    there = np.array([motion.pieces[i].xy[k] for motion in (reference, *others)])
    low, high = there.min(axis=0), there.max(axis=0)
    size, extent = float(np.max(high - low)), float(np.max(np.ptp(reference.pieces[i].xy, axis=0)))
    if not 1e-6 < size < extent / 6.0:
        return None
    x, y = map(float, 0.5 * (low + high))
    return i, k, x, y, size


def _draw_zoom(comparison: Comparison, zoom: _Zoom, ax: Axes) -> None:
    """Draw the paths around one instant, and every robot's pose then."""
    i, k, x, y, size = zoom
    for motion in drawn_motions(comparison):
        motion.draw(ax, *joined([(piece.pose[:, 0], piece.pose[:, 1]) for piece in motion.pieces]))
        draw_dart(ax, motion.pieces[i].pose[k], motion.name, 14.0)
    half = 0.8 * size
    ax.locator_params(axis="x", nbins=6)  # asks for new limits, so before they are held
    hold_limits(ax, (x - half, x + half), (y - half, y + half))
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]", label="zoom")
    ax.set_title(f"Farthest apart, at t = {comparison.reference[i].t[k]:.2f} s [m]")


def _windows(comparison: Comparison) -> tuple[str, list[tuple[int, int, int]]]:
    """Which windows to show: what they are, in words, and (piece, first, last sample) of each, in the order of their errors.

    All windows of the horizon closest to `HEADLINE_HORIZON` in which a plant moves are put in the order of the plants' mean
    error and split into equal shares; the one in the middle of each share is shown. Where none fits, whole pieces serve.
    """
    reference, *others = drawn_motions(comparison)
    known = set(comparison.scoring) or {HEADLINE_HORIZON}
    words, cuts = "whole pieces", [(np.array([0]), np.array([len(piece) - 1])) for piece in reference.pieces]
    for horizon in sorted(known, key=lambda h: abs(h - HEADLINE_HORIZON)):
        fitting = list(comparison.scoring.get(horizon, ())) or [horizon_windows(p.t, horizon) for p in reference.pieces]
        if any(len(starts) for starts, _ in fitting):
            words, cuts = f"windows of {horizon:g} s", fitting
            break
    windows = [(i, int(a), int(b)) for i, ends in enumerate(cuts) for a, b in zip(*ends, strict=True)]
    if driven := [w for w in windows if any(_moves(motion.pieces[w[0]].pose[w[1] : w[2] + 1]) for motion in others)]:
        words, windows = words + " with motion" * (len(driven) < len(windows)), driven
    error = np.zeros(len(windows))
    for k, (i, a, b) in enumerate(windows):
        ends = np.array([a]), np.array([b])
        error[k] = sum(float(relative_pose_error(m.pieces[i].pose, reference.pieces[i].pose, *ends)[0][0]) for m in others)
    order = np.argsort(error, kind="stable")
    n = min(MAX_WINDOWS, len(windows))
    shown = [windows[order[int((k + 0.5) / n * len(windows))]] for k in range(n)]
    return f"{n} of {len(windows)} {words}" if n < len(windows) else f"all {words}", shown


def _moves(pose: FloatArray) -> bool:
    """Return whether (M, 3) poses of a plant are worth a picture."""
    return bool(np.ptp(pose, axis=0).max() > _LEAST_MOTION)


def _draw_window(comparison: Comparison, window: tuple[int, int, int], ax: Axes) -> None:
    """The paths over one window, each seen from its own pose at the window's start."""
    i, a, b = window
    for motion in drawn_motions(comparison):
        seen = relative(motion.pieces[i].pose[a], motion.pieces[i].pose[a : b + 1])
        motion.draw(ax, seen[:, 0], seen[:, 1])
        draw_dart(ax, seen[-1], motion.name, 13.0)
    draw_ring(ax, 0.0, 0.0)
    equal_scales(ax, 0.6)
    ax.locator_params(axis="x", nbins=5)
    t = comparison.reference[i].t
    ax.set_title(f"{t[a]:.1f} to {t[b]:.1f} s", fontweight="normal")
    ax.set(xlabel="ahead [m]", ylabel="to the left [m]")


def _draw_position_error(comparison: Comparison, ax: Axes) -> None:
    reference, *others = drawn_motions(comparison)
    errors = [
        joined([(r.t, np.hypot(*(p.xy - r.xy).T)) for p, r in zip(motion.pieces, reference.pieces, strict=True)])
        for motion in others
    ]
    unit = length_unit([float(np.nanmax(error)) for _, error in errors])
    for motion, (t, error) in zip(others, errors, strict=True):
        motion.draw(ax, t, error * unit.scale)
    ax.set(title=f"Position error [{unit.symbol}] at equal times", xlabel="time [s]", xlim=whole_span(comparison))
    ax.set_ylim(0.0, max(ax.get_ylim()[1], 1e-3 * unit.scale))


def _draw_yaw_error(comparison: Comparison, ax: Axes) -> None:
    reference, *others = drawn_motions(comparison)
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=1.5)
    for motion in others:
        pairs = zip(motion.pieces, reference.pieces, strict=True)
        t, error = joined([(r.t, np.degrees(wrap_angle(p.yaw - r.yaw))) for p, r in pairs])
        wraps = np.flatnonzero(np.abs(np.diff(error)) > 180.0) + 1
        motion.draw(ax, np.insert(t, wraps, np.nan), np.insert(error, wraps, np.nan))
    ax.set(title="Yaw error [deg] at equal times: plant minus reference", xlabel="time [s]", xlim=whole_span(comparison))
    at_least(ax, 0.5)


def _panels(comparison: Comparison) -> list[list[Panel]]:
    """Return the panels below the paths, row by row; those without data are left out."""
    motions = drawn_motions(comparison)
    smooth = [m for m in motions if not is_impulsive(comparison, m.name) and has_channel(m, "yaw_acceleration_rad_s2")]
    with_loads = [m for m in motions if has_channel(m, "wheel_load_N")]
    errors: list[Panel] = []
    plants = comparison.plants.items()
    if shown := {n: r for n, r in plants if r.horizons}:
        told = "by horizon [{}]: median, bar to 95th percentile"
        position, yaw = f"Position error {told.format('m')}", f"Yaw error {told.format('deg')}"

        def marks(interval: Callable[[OverlappingErrors], Interval]) -> list[HorizonMarks]:
            intervals = {n: {h: interval(e) for h, e in r.overlapping.items()} for n, r in shown.items()}
            return [HorizonMarks(n, ink_of(n), _MARKERS.get(n, "o"), r.horizons, intervals[n]) for n, r in shown.items()]

        metres, degrees = marks(position_interval), marks(yaw_interval)
        errors = [
            partial(draw_horizons, metres, position, lambda e: (e.position_median_m, e.position_p95_m)),
            partial(draw_horizons, degrees, yaw, yaw_degrees),
        ]
    elif len(motions) > 1:
        errors = [partial(_draw_position_error, comparison), partial(_draw_yaw_error, comparison)]
    told = " and command" if has_speed_commands(comparison) else ""
    turn: list[Panel] = [partial(draw_velocity, comparison, f"Yaw rate [rad/s]{told}", 2, 1)]
    if smooth:
        turn.append(partial(draw_acceleration, comparison, smooth))
    ride: list[Panel] = [partial(draw_velocity, comparison, f"Speed v_x [m/s]{told}", 0, 0)]
    if with_loads:
        ride.append(partial(draw_loads, comparison, with_loads[0]))
    return [row for row in (errors, turn, ride) if row]


def _draw_header(comparison: Comparison, ax: Axes) -> None:
    """Title, and the only legend of plants."""
    ax.set_axis_off()
    kind = "commands" if has_speed_commands(comparison) else "measured wheel rates"
    n = len(comparison.plants)
    title = shortened(Path(comparison.source).name, 48) + f": {n} plant{'s' * (n > 1)} driven by the same {kind}" * (n > 0)
    ax.text(0.0, 1.0, title, transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    marked = any(result.horizons for result in comparison.plants.values())
    handles, labels = [], []
    for motion in drawn_motions(comparison):
        marker = _MARKERS.get(motion.name, "o") if marked and not motion.is_reference else ""
        handles.append(Line2D([], [], marker=marker, **motion.look))
        labels.append(
            f"{motion.name}\n{'reference' if motion.is_reference else headline_error(comparison.plants[motion.name])}"
        )
    if has_speed_commands(comparison):
        handles.append(Line2D([], [], color=COMMAND_INK, linewidth=1.0))
        labels.append("command\nas given")
    line_legend(ax, handles, labels)


def _footer(comparison: Comparison) -> str:
    """Return in one line how the picture was made."""
    parts = [
        f"source {shortened(Path(comparison.source).name, 32)}",
        f"profile {shortened(comparison.profile_label, 32)}",
        f"reference {comparison.reference_name}",
        f"seed {comparison.seed}",
        *([] if comparison.terrain == FLAT else [f"terrain {comparison.terrain.spec}"]),
        *(name for name, value in comparison.options.items() if value is True),
        *(f"{name} {comparison.versions[name]}" for name in ("ssmr-testbed", "mujoco") if name in comparison.versions),
    ]
    return " · ".join(parts)


def _paths_size(comparison: Comparison) -> Span:
    """Width [in] and height [in] of the panel of paths, near their own proportions."""
    width, height = np.ptp(np.concatenate([piece.xy for piece in comparison.reference]), axis=0) + 0.5
    wide = WIDTH_IN - _ZOOM_IN
    tall = float(np.clip(wide * height / width, *_PATHS_IN))
    return min(wide, max(tall * float(width / height), 0.5 * WIDTH_IN)), tall


def _rows(comparison: Comparison) -> list[Row]:
    """Everything, from top to bottom."""
    rows = [text_row(_HEADER_IN, partial(_draw_header, comparison))]
    zoom, (start, stop) = _find_zoom(comparison), whole_span(comparison)
    if stop - start > LONGEST_PATH or len(comparison.reference) > 1:
        words, windows = _windows(comparison)
        heading = f"Paths over {words} [m]: all start at the same pose; from small to large errors"
        rows.append(text_row(_SECTION_IN, partial(draw_section, heading)))
        rows.append(side_by_side(_WINDOW_IN, [partial(_draw_window, comparison, window) for window in windows]))
    elif zoom is None:
        rows.append(side_by_side(_paths_size(comparison)[1], [partial(_draw_paths, comparison)]))
    else:
        wide, tall = _paths_size(comparison)
        paths, closer = partial(_draw_paths, comparison), partial(_draw_zoom, comparison, zoom)
        rows.append(Row(tall, ((wide / WIDTH_IN, paths), (1.0 - wide / WIDTH_IN, closer))))
    rows += [side_by_side(_ROW_IN, panels) for panels in _panels(comparison)]
    rows += note_rows(comparison.notes())
    rows.append(text_row(_FOOTER_IN, partial(draw_footer, _footer(comparison))))
    return rows


def comparison_figure(comparison: Comparison) -> Figure:
    """Everything about a comparison that can be seen in one look, 1600 px wide.

    Args:
        comparison: what was found.

    Returns:
        A figure with its layout done: paths, and where they are farthest apart (or windows of them), errors over time (or by
        horizon), yaw rate and yaw acceleration, speed and wheel loads. Panels for which there are no data are left out.
        Lines carry the name of their motion, or `command`, as gid.
    """
    return put_together(_rows(comparison), _outline_zoom)


def _outline_zoom(figure: Figure) -> None:
    """Mark in the paths what the zoom shows; that is settled only when it has been drawn."""
    panels = {ax.get_label(): ax for ax in figure.axes}
    if "zoom" in panels:
        (x, x_end), (y, y_end) = panels["zoom"].get_xlim(), panels["zoom"].get_ylim()
        panels["paths"].add_patch(
            Rectangle((x, y), x_end - x, y_end - y, fill=False, edgecolor="0.3", linewidth=1.0, zorder=5.0, clip_on=False)
        )
