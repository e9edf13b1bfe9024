"""A comparison as one picture: where every plant went, how far off it was, and what its velocities and wheel loads did.

A short run is shown as it was driven. A run longer than `LONGEST_PATH`, or in pieces, is open-loop drift after a while:
there the paths are those of a few windows, each laid on the reference's pose at its start. Where there are errors by
horizon they take the place of errors over time.

Everything is drawn by matplotlib's objects under a style of its own: no pyplot, and no setting outlives a call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ssmr.geometry import relative, wrap_angle
from ssmr.metrics.poses import horizon_windows, relative_pose_error
from ssmr.types import FloatArray, Trajectory
from validation.compare.data import ComparisonData
from validation.compare.table import HEADLINE_HORIZON, headline
from validation.robots.husky import WHEELS
from validation.robots.terrain import FLAT
from validation.robots.wheel_loads import QUASI_STATIC
from validation.show.drawing import (
    ALARM,
    BROAD,
    NARROW,
    QUIET,
    WIDTH_IN,
    Dashes,
    HorizonMarks,
    Panel,
    Row,
    Span,
    at_least,
    corner_note,
    draw_dart,
    draw_directions,
    draw_horizons,
    draw_ring,
    draw_section,
    equal_scales,
    hold_limits,
    ink_of,
    joined,
    line_legend,
    put_together,
    side_by_side,
    text_row,
    yaw_degrees,
)
from validation.show.drawing import save_figure as save_figure
from validation.show.tables import length_unit, shortened

LONGEST_PATH = 30.0
"""Runs longer than this are shown in windows [s]: open-loop errors have grown beyond reading by then."""
LONGEST_SHOWN = 60.0
"""Runs longer than this show velocities over a stretch only [s]: more would be a smear."""
STRETCH = 36.0
"""How long that stretch is [s]."""
MAX_WINDOWS = 4
"""How many windows are shown, one from the middle of each share of the errors."""
ZOOM_TIME = 0.6
"""What the yaw acceleration is shown over [s]: a dozen of the driver's 20 Hz holds, each of them visible."""
ZOOM_SAMPLES = 40
"""The zoom is as wide as this many samples, if that is more."""
MEAN_TIME = 0.25
"""What wheel loads are averaged over [s]: five of the driver's holds."""
CLIP_PERCENTILE = 99.0
"""How much of its own acceleration a plant may leave behind before it counts as a spike [%]."""
CLIP_RATIO = 3.0
"""A spike so many times beyond that, and beyond all other plants, is cut off, and said."""
CLIP_FLOOR = 0.1
"""Where nothing else exceeds this [rad/s2], there is nothing to be hidden by a spike, and nothing is cut off."""
TURN_FLOOR = 0.01
"""A yaw rate that changes by less is noise and reverses no turn [rad/s]."""
IMPULSIVE = frozenset({"kinematic"})
"""Plants without inertia: their yaw rate steps, and their acceleration is impulses that say nothing."""
CHATTERING = "coulomb"
"""The plant whose acceleration is drawn thin and behind the others, for it may fill the panel."""

_HEADER_IN, _SECTION_IN, _ROW_IN, _WINDOW_IN, _FOOTER_IN = 0.78, 0.28, 2.3, 3.2, 0.22
_ZOOM_IN, _PATHS_IN = 4.0, (3.0, 5.5)  # least width of the zoom; least and greatest height of the paths
Series = Callable[[Trajectory], FloatArray]

_DASHES: dict[str, Dashes] = {
    "improved": (0.0, (6.0, 1.5)),
    "coulomb": (0.0, (1.5, 1.0)),
    "linear": (0.0, (7.0, 1.5, 1.5, 1.5)),
    "kinematic": (0.0, (3.0, 1.2)),
}
_MARKERS = {"mujoco": "o", "improved": "s", "coulomb": "^", "linear": "D", "kinematic": "v"}
_SIDES: tuple[Dashes, Dashes] = ("solid", (0.0, (4.0, 1.5)))
_COMMAND = "0.5"


@dataclass(frozen=True, eq=False)
class _Motion:
    """One of the motions to draw: the reference's or a plant's."""

    name: str
    pieces: tuple[Trajectory, ...]
    is_reference: bool

    def draw(self, ax: Axes, x: FloatArray, y: FloatArray) -> None:
        """Draw a line of its own look: the reference broad and behind, the others on top of it."""
        broad = self.is_reference
        ax.plot(
            x,
            y,
            color=ink_of(self.name),
            linestyle=_DASHES.get(self.name, "solid"),
            linewidth=BROAD if broad else NARROW,
            zorder=2.0 if broad else 2.5,
            gid=self.name,
        )


def _motions(comparison: ComparisonData) -> list[_Motion]:
    """The reference, then the other plants in their order."""
    others = [_Motion(n, r.pieces, False) for n, r in comparison.plants.items() if n != comparison.reference_name]
    return [_Motion(comparison.reference_name, comparison.reference, True), *others]


def _over_time(pieces: Sequence[Trajectory], series: Series, span: Span) -> tuple[FloatArray, FloatArray]:
    """Stamps [s] and values of a series within a time span, broken at gaps."""
    kept = [(piece, (piece.t >= span[0]) & (piece.t <= span[1])) for piece in pieces]
    return joined([(piece.t[keep], series(piece)[keep]) for piece, keep in kept if keep.any()])


def _period(t: FloatArray) -> float:
    """Usual step between stamps [s]."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 1.0


def _has(motion: _Motion, channel: str) -> bool:
    return all(channel in piece.channels for piece in motion.pieces)


def _whole(comparison: ComparisonData) -> Span:
    """First and last stamp [s]."""
    return float(comparison.reference[0].t[0]), float(comparison.reference[-1].t[-1])


def _stretch(comparison: ComparisonData) -> Span:
    """What the velocities are shown over [s]: all of a run, or the middle of the longest piece of a long one."""
    start, stop = _whole(comparison)
    if stop - start <= LONGEST_SHOWN:
        return start, stop
    longest = max(comparison.reference, key=lambda piece: float(piece.t[-1] - piece.t[0]))
    middle = 0.5 * float(longest.t[0] + longest.t[-1])
    begin = min(max(float(longest.t[0]), middle - 0.5 * STRETCH), stop - STRETCH)
    return begin, begin + STRETCH


def _in_windows(comparison: ComparisonData) -> bool:
    """Whether the paths are shown in windows."""
    start, stop = _whole(comparison)
    return stop - start > LONGEST_PATH or len(comparison.reference) > 1


def _draw_paths(comparison: ComparisonData, ax: Axes) -> None:
    """The paths as they were driven."""
    for motion in _motions(comparison):
        motion.draw(ax, *joined([(piece.pose[:, 0], piece.pose[:, 1]) for piece in motion.pieces]))
        draw_dart(ax, motion.pieces[-1].pose[-1], motion.name, 12.0)
    first = comparison.reference[0]
    draw_directions(ax, first.xy, comparison.reference_name, (0.15, 0.4, 0.65))
    draw_ring(ax, *map(float, first.xy[0]))
    equal_scales(ax, 1.0)
    ax.set(title="Paths [m] (ring: start; arrows: direction)", xlabel="x [m]", ylabel="y [m]", label="paths")


@dataclass(frozen=True)
class _Zoom:
    """Where a plant is farthest from the reference."""

    piece: int
    sample: int
    centre: tuple[float, float]
    """Middle of all positions at that time [m]."""
    size: float
    """Extent of those positions [m]."""


def _find_zoom(comparison: ComparisonData) -> _Zoom | None:
    """Where to look closer; None where that shows no more than the whole does."""
    worst, i, k = 0.0, 0, 0
    reference, *others = _motions(comparison)
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
    return _Zoom(i, k, (x, y), size)


def _draw_zoom(comparison: ComparisonData, zoom: _Zoom, ax: Axes) -> None:
    """The paths around one instant, and every robot's pose then."""
    for motion in _motions(comparison):
        motion.draw(ax, *joined([(piece.pose[:, 0], piece.pose[:, 1]) for piece in motion.pieces]))
        draw_dart(ax, motion.pieces[zoom.piece].pose[zoom.sample], motion.name, 14.0)
    (x, y), half = zoom.centre, 0.8 * zoom.size
    ax.locator_params(axis="x", nbins=6)  # asks for new limits, so before they are held
    hold_limits(ax, (x - half, x + half), (y - half, y + half))
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]", label="zoom")
    ax.set_title(f"Farthest apart, at t = {comparison.reference[zoom.piece].t[zoom.sample]:.2f} s [m]")


def _windows(comparison: ComparisonData) -> tuple[str, list[tuple[int, int, int]]]:
    """Which windows to show: what they are, in words, and (piece, first, last sample) of each, in the order of their errors.

    All windows of the horizon closest to `HEADLINE_HORIZON` are put in the order of the plants' mean error and split into
    equal shares; the one in the middle of each share is shown. Where no window fits, whole pieces serve.
    """
    reference, *others = _motions(comparison)
    known = {h for result in comparison.plants.values() for h in result.horizons} or {HEADLINE_HORIZON}
    words, cuts = "whole pieces", [(np.array([0]), np.array([len(piece) - 1])) for piece in reference.pieces]
    for horizon in sorted(known, key=lambda h: abs(h - HEADLINE_HORIZON)):
        fitting = [horizon_windows(piece.t, horizon) for piece in reference.pieces]
        if any(len(starts) for starts, _ in fitting):
            words, cuts = f"windows of {horizon:g} s", fitting
            break
    windows = [(i, int(a), int(b)) for i, ends in enumerate(cuts) for a, b in zip(*ends, strict=True)]
    error = np.zeros(len(windows))
    for motion in others:
        pairs = zip(motion.pieces, reference.pieces, cuts, strict=True)
        error += np.concatenate([relative_pose_error(p.pose, r.pose, *ends)[0] for p, r, ends in pairs])
    order = np.argsort(error, kind="stable")
    n = min(MAX_WINDOWS, len(windows))
    shown = [windows[order[int((k + 0.5) / n * len(windows))]] for k in range(n)]
    return f"{n} of {len(windows)} {words}" if n < len(windows) else f"all {words}", shown


def _draw_window(comparison: ComparisonData, window: tuple[int, int, int], ax: Axes) -> None:
    """The paths over one window, each seen from its own pose at the window's start."""
    i, a, b = window
    for motion in _motions(comparison):
        seen = relative(motion.pieces[i].pose[a], motion.pieces[i].pose[a : b + 1])
        motion.draw(ax, seen[:, 0], seen[:, 1])
        draw_dart(ax, seen[-1], motion.name, 13.0)
    draw_ring(ax, 0.0, 0.0)
    equal_scales(ax, 0.6)
    ax.locator_params(axis="x", nbins=5)
    t = comparison.reference[i].t
    ax.set_title(f"{t[a]:.1f} to {t[b]:.1f} s", fontweight="normal")
    ax.set(xlabel="ahead [m]", ylabel="to the left [m]")


def _draw_position_error(comparison: ComparisonData, ax: Axes) -> None:
    reference, *others = _motions(comparison)
    errors = [
        joined([(r.t, np.hypot(*(p.xy - r.xy).T)) for p, r in zip(motion.pieces, reference.pieces, strict=True)])
        for motion in others
    ]
    unit = length_unit([float(np.nanmax(error)) for _, error in errors])
    for motion, (t, error) in zip(others, errors, strict=True):
        motion.draw(ax, t, error * unit.scale)
    ax.set(title=f"Position error [{unit.symbol}] at equal times", xlabel="time [s]", xlim=_whole(comparison))
    ax.set_ylim(0.0, max(ax.get_ylim()[1], 1e-3 * unit.scale))


def _draw_yaw_error(comparison: ComparisonData, ax: Axes) -> None:
    reference, *others = _motions(comparison)
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=1.5)
    for motion in others:
        pairs = zip(motion.pieces, reference.pieces, strict=True)
        t, error = joined([(r.t, np.degrees(wrap_angle(p.yaw - r.yaw))) for p, r in pairs])
        wraps = np.flatnonzero(np.abs(np.diff(error)) > 180.0) + 1
        motion.draw(ax, np.insert(t, wraps, np.nan), np.insert(error, wraps, np.nan))
    ax.set(title="Yaw error [deg] at equal times: plant minus reference", xlabel="time [s]", xlim=_whole(comparison))
    at_least(ax, 0.5)


def _horizon_marks(comparison: ComparisonData) -> list[HorizonMarks]:
    return [
        HorizonMarks(name, ink_of(name), _MARKERS.get(name, "o"), result.horizons)
        for name, result in comparison.plants.items()
        if result.horizons
    ]


def _time_axis(comparison: ComparisonData, ax: Axes, remark: str = "") -> None:
    """The same stretch of time in all panels, said where it is not all."""
    span, (start, stop) = _stretch(comparison), _whole(comparison)
    ax.set_xlim(*span)
    part = "" if span == (start, stop) else f", part of {start:.0f} to {stop:.0f} s"
    ax.set_xlabel(f"time [s]{part}{remark}")


def _draw_velocity(comparison: ComparisonData, title: str, column: int, command: int, ax: Axes) -> None:
    """Draw one component of every robot's velocity, and of the command if it is a velocity."""
    span = _stretch(comparison)
    for motion in _motions(comparison):
        motion.draw(ax, *_over_time(motion.pieces, lambda piece: piece.twist[:, column], span))
    if _commanded(comparison):
        parts = []
        for commands, piece in zip(comparison.commands, comparison.reference, strict=True):
            t = piece.t[0] + commands.dt * np.arange(commands.n + 1)
            keep = (t >= span[0] - commands.dt) & (t <= span[1])
            values = np.append(commands.values[:, command], commands.values[-1, command])
            if keep.any():
                parts.append((t[keep], values[keep]))
        t, values = joined(parts)
        ax.plot(t, values, color=_COMMAND, linewidth=1.0, drawstyle="steps-post", zorder=1.8, gid="command")
    ax.set_title(title)
    at_least(ax, 0.1)
    _time_axis(comparison, ax)


def _commanded(comparison: ComparisonData) -> bool:
    return all(commands.kind == "twist" for commands in comparison.commands)


def _impulsive(comparison: ComparisonData, name: str) -> bool:
    """Whether a plant's yaw rate steps: without inertia, or, but for the simulator, with wheels that do as they are told."""
    return name in IMPULSIVE or (not _commanded(comparison) and name not in ("mujoco", comparison.reference_name))


def _draw_acceleration(comparison: ComparisonData, motions: Sequence[_Motion], ax: Axes) -> None:
    """Yaw accelerations around the swiftest reversal of the turn, where friction changes its sign."""
    leader = next((motion for motion in motions if motion.name == CHATTERING), motions[0])
    reverses, i, t = _swiftest_turn(leader)
    stamps = leader.pieces[i].t
    half = 0.5 * max(ZOOM_TIME, ZOOM_SAMPLES * _period(stamps))
    begin = max(float(stamps[0]), min(t - half, float(stamps[-1]) - 2.0 * half))
    span = begin, min(begin + 2.0 * half, float(stamps[-1]))
    curves = {}
    for motion in motions:
        x, y = _over_time([motion.pieces[i]], lambda piece: piece.channels["yaw_acceleration_rad_s2"], span)
        curves[motion.name] = y
        if motion.name == CHATTERING:
            band = _reach(motion.pieces[i], span)
            curves[f"{motion.name} between samples"] = band.ravel()
            ax.fill_between(
                x, band[:, 0], band[:, 1], color=ink_of(motion.name), alpha=0.2, linewidth=0.0, step="pre", zorder=1.6
            )
            ax.plot(x, y, color=ink_of(motion.name), linewidth=0.9, zorder=1.7, gid=motion.name)
        else:
            motion.draw(ax, x, y)
    low, high, cut = _clip(curves)
    left_out = [motion.name for motion in _motions(comparison) if _impulsive(comparison, motion.name)]
    where = "where the turn reverses" if reverses else "where the turn changes most"
    ax.set(title=f"Yaw acceleration [rad/s²] {where}", xlim=span, ylim=(low, high))
    ax.set_xlabel(f"time [s], a sample every {1e3 * _period(stamps):.3g} ms")
    shaded = [f"{leader.name}: its range is shaded"] if leader.name == CHATTERING else []
    corner_note(ax, "; ".join([*cut, *shaded, *(f"{name}: impulses, not drawn" for name in left_out)]))


def _reach(piece: Trajectory, span: Span) -> FloatArray:
    """(M, 2) least and greatest yaw acceleration since the sample before [rad/s2]: what chatter hides between samples."""
    inside = (piece.t >= span[0]) & (piece.t <= span[1])
    return piece.channels["yaw_acceleration_range_rad_s2"][inside]


def _clip(curves: Mapping[str, FloatArray]) -> tuple[float, float, list[str]]:
    """Limits of an axis that hold zero and each curve, less lonely spikes; and the spikes that are cut off, in words."""
    peaks = {name: float(np.max(np.abs(y))) for name, y in curves.items()}
    low, high, cut = 0.0, 0.0, []
    for name, y in curves.items():
        usual = max(
            float(np.percentile(np.abs(y), CLIP_PERCENTILE, method="lower")),
            *(peak for other, peak in peaks.items() if other != name),
            0.0,
        )
        if usual > CLIP_FLOOR and peaks[name] > CLIP_RATIO * usual:
            cut.append(f"{name}, which reaches {peaks[name]:.3g}, is cut off")
            y = np.clip(y, -usual, usual)
        low, high = min(low, float(y.min())), max(high, float(y.max()))
    reach = max(high - low, CLIP_FLOOR)
    return low - 0.25 * reach, high + 0.05 * reach, cut


def _swiftest_turn(motion: _Motion) -> tuple[bool, int, float]:
    """Whether a yaw rate changes its sign, and where it does so most swiftly: piece and time [s].

    Where it never does: where its acceleration is greatest.
    """
    best = (False, -1.0, 0, 0.0)
    for i, piece in enumerate(motion.pieces):
        rate, reach = piece.twist[:, 2], max(1, round(0.1 / _period(piece.t)))
        k = np.arange(len(piece))
        change = np.abs(rate[np.minimum(k + reach, len(piece) - 1)] - rate[np.maximum(k - reach, 0)])
        crossing = np.append(rate[1:] * rate[:-1] < 0.0, False) & (change > TURN_FLOOR)
        for found, score in (
            (True, np.where(crossing, change, -1.0)),
            (False, np.abs(piece.channels["yaw_acceleration_rad_s2"])),
        ):
            m = int(np.argmax(score))
            if score[m] >= 0.0:
                best = max(best, (found, float(score[m]), i, float(piece.t[m])))
    return best[0], best[2], best[3]


def _running_mean(t: FloatArray, values: FloatArray) -> FloatArray:
    """Means of (M, k) values over `MEAN_TIME` around each sample, or over what of that there is."""
    reach = int(0.5 * MEAN_TIME / _period(t))
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    k = np.arange(len(t))
    low, high = np.maximum(k - reach, 0), np.minimum(k + reach + 1, len(t))
    return (total[high] - total[low]) / (high - low)[:, None]


def _draw_loads(comparison: ComparisonData, motion: _Motion, ax: Axes) -> None:
    """The loads of the four wheels, and what they say about the run."""
    span = _stretch(comparison)
    t, loads = _over_time(motion.pieces, lambda piece: piece.channels["wheel_load_N"], span)
    _, means = _over_time(motion.pieces, lambda piece: _running_mean(piece.t, piece.channels["wheel_load_N"]), span)
    for k, wheel in enumerate(WHEELS):
        ink, name = ink_of(motion.name) if wheel.startswith("front") else "0.25", wheel.replace("_", " ")
        ax.plot(t, loads[:, k], color=ink, linewidth=0.6, alpha=0.35, zorder=1.8)
        ax.plot(t, means[:, k], color=ink, linestyle=_SIDES[wheel.endswith("right")], linewidth=1.6, label=name, gid=wheel)
    told = f"; lines are means over {MEAN_TIME:g} s"
    if _has(motion, QUASI_STATIC):
        _, formula = _over_time(motion.pieces, lambda piece: piece.channels[QUASI_STATIC], span)
        ax.plot(t, formula, color=QUIET, linestyle=(0, (1, 1)), linewidth=1.0, zorder=2.5)
        told += ", dotted: quasi-static"
    ax.legend(loc="lower right", bbox_to_anchor=(1.01, 0.98), ncols=4, frameon=False, fontsize=9.0, handlelength=1.8,
              columnspacing=1.2, borderaxespad=0.0)  # fmt: skip
    ax.set_title("Wheel loads [N]")
    _time_axis(comparison, ax, told)
    at_least(ax, 10.0)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.2 * (high - low), high)  # room for the verdict
    result = comparison.plants.get(motion.name)
    if result is not None and result.health is not None:
        health = result.health
        verdict = "healthy" if health.ok else "UNHEALTHY"
        shares = f"lowest load {health.lowest_load_share:.0%} of a wheel's mean, deviation {health.load_deviation:.1%}"
        corner_note(ax, f"{motion.name} {verdict}: {shares}, whole run", QUIET if health.ok else ALARM)


def _panels(comparison: ComparisonData) -> list[list[Panel]]:
    """What is drawn below the paths, row by row; panels for which there is nothing are left out."""
    motions = _motions(comparison)
    with_acceleration = [m for m in motions if not _impulsive(comparison, m.name) and _has(m, "yaw_acceleration_rad_s2")]
    with_loads = [m for m in motions if _has(m, "wheel_load_N")]
    errors: list[Panel] = []
    if any(result.horizons for result in comparison.plants.values()):
        errors = [
            partial(
                draw_horizons,
                _horizon_marks(comparison),
                "Position error by horizon [m]: median, bar to 95th percentile",
                lambda e: (e.position_median_m, e.position_p95_m),
            ),
            partial(
                draw_horizons,
                _horizon_marks(comparison),
                "Yaw error by horizon [deg]: median, bar to 95th percentile",
                yaw_degrees,
            ),
        ]
    elif len(motions) > 1:
        errors = [partial(_draw_position_error, comparison), partial(_draw_yaw_error, comparison)]
    told = " and command" if _commanded(comparison) else ""
    turn: list[Panel] = [partial(_draw_velocity, comparison, f"Yaw rate [rad/s]{told}", 2, 1)]
    if with_acceleration:
        turn.append(partial(_draw_acceleration, comparison, with_acceleration))
    ride: list[Panel] = [partial(_draw_velocity, comparison, f"Speed v_x [m/s]{told}", 0, 0)]
    if with_loads:
        ride.append(partial(_draw_loads, comparison, with_loads[0]))
    return [row for row in (errors, turn, ride) if row]


def _draw_header(comparison: ComparisonData, ax: Axes) -> None:
    """Title, and the only legend of plants."""
    ax.set_axis_off()
    kind = "commands" if _commanded(comparison) else "measured wheel rates"
    n = len(comparison.plants)
    title = shortened(Path(comparison.source).name, 48) + f": {n} plant{'s' * (n > 1)} driven by the same {kind}" * (n > 0)
    ax.text(0.0, 1.0, title, transform=ax.transAxes, fontsize=14.0, fontweight="bold", va="top")
    marked = any(result.horizons for result in comparison.plants.values())
    handles, labels = [], []
    for motion in _motions(comparison):
        marker = _MARKERS.get(motion.name, "o") if marked and not motion.is_reference else ""
        width = BROAD if motion.is_reference else NARROW
        handles.append(
            Line2D(
                [],
                [],
                color=ink_of(motion.name),
                linestyle=_DASHES.get(motion.name, "solid"),
                linewidth=width,
                marker=marker,
            )
        )
        labels.append(f"{motion.name}\n{'reference' if motion.is_reference else headline(comparison, motion.name)}")
    if _commanded(comparison):
        handles.append(Line2D([], [], color=_COMMAND, linewidth=1.0))
        labels.append("command\nas given")
    line_legend(ax, handles, labels)


def _draw_footer(comparison: ComparisonData, ax: Axes) -> None:
    """How it was made."""
    ax.set_axis_off()
    parts = [
        f"source {shortened(Path(comparison.source).name, 32)}",
        f"profile {shortened(comparison.profile, 20)}",
        f"reference {comparison.reference_name}",
        f"seed {comparison.seed}",
        *([] if comparison.terrain == FLAT else [f"terrain {comparison.terrain.spec}"]),
        *(name for name, value in comparison.options.items() if value is True),
        *(f"{name} {comparison.versions[name]}" for name in ("ssmr-testbed", "mujoco") if name in comparison.versions),
    ]
    ax.text(0.0, 0.0, " · ".join(parts), transform=ax.transAxes, fontsize=8.5, color=QUIET, va="bottom")


def _paths_size(comparison: ComparisonData) -> Span:
    """Width [in] and height [in] of the panel of paths, near their own proportions."""
    width, height = np.ptp(np.concatenate([piece.xy for piece in comparison.reference]), axis=0) + 0.5
    wide = WIDTH_IN - _ZOOM_IN
    tall = float(np.clip(wide * height / width, *_PATHS_IN))
    return min(wide, max(tall * float(width / height), 0.5 * WIDTH_IN)), tall


def _rows(comparison: ComparisonData) -> list[Row]:
    """Everything, from top to bottom."""
    rows = [text_row(_HEADER_IN, partial(_draw_header, comparison))]
    zoom = _find_zoom(comparison)
    if _in_windows(comparison):
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
    rows.append(text_row(_FOOTER_IN, partial(_draw_footer, comparison)))
    return rows


def comparison_figure(comparison: ComparisonData) -> Figure:
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
