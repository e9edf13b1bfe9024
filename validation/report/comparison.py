"""A comparison: motions with one picture of paths, errors, velocities and wheel loads.

Everything is drawn by matplotlib's objects under a style of its own: no pyplot, and no setting
outlives a call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ssmr.geometry import compose, relative, rotate_body_to_world, wrap_angle
from ssmr.metrics.windows import horizon_windows, relative_pose_error
from ssmr.types import FloatArray, Trajectory
from validation.experiment.scores import HEADLINE_HORIZON
from validation.output import shortened
from validation.report.columns import DEGREES, length_unit
from validation.report.drawing import (
    ALARM,
    BROAD,
    COMMAND_LOOK,
    NARROW,
    QUIET,
    Curve,
    Dashes,
    HorizonMarks,
    Panel,
    PanelRow,
    corner_note,
    draw_curves,
    draw_ellipse,
    draw_horizons,
    draw_page,
    draw_paths,
    how_driven,
    ink_of,
    join_pieces,
    key_line,
)
from validation.report.motions import Motions, headline_error
from validation.report.scene_robots import Track
from validation.simulator.description import WHEELS
from validation.simulator.health import verdict
from validation.simulator.wheel_loads import QUASI_STATIC

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_LONGEST_PATH = 30.0
"""Runs longer than this are shown in windows [s]: open-loop errors have grown beyond reading by
then."""
_WINDOWS = 4
"""Number of windows shown; their errors are spread evenly from the least to the greatest."""
_LEAST_MOTION = 0.05
"""Way [m] or turn [rad] from which a plant moves in a window."""
_LONGEST_SHOWN = 60.0
"""Runs longer than this show velocities over a part only [s]: more would be a smear."""
_STRETCH = 36.0
"""Length of that part [s]."""
_MEAN_TIME = 0.25
"""Time over which wheel loads are averaged [s]: five periods of the driver's commands."""
_MARKERS = {
    "mujoco": "o",
    "improved": "s",
    "coulomb": "^",
    "linear": "D",
    "kinematic": "v",
    "four_wheel": "p",
    "ode": "P",
    "drake": "X",
}
_DASHES: dict[str, Dashes] = {
    "improved": (0.0, (6.0, 1.5)),
    "coulomb": (0.0, (1.5, 1.0)),
    "linear": (0.0, (7.0, 1.5, 1.5, 1.5)),
    "kinematic": (0.0, (3.0, 1.2)),
    "four_wheel": (0.0, (9.0, 1.2)),
}


def _look_of(track: Track) -> dict[str, Any]:
    """Return the properties of a motion's line: the reference's is broad, and behind the others."""
    is_reference = track.reference is None
    return {
        "color": ink_of(track.name),
        "linestyle": _DASHES.get(track.name, "solid"),
        "linewidth": BROAD if is_reference else NARROW,
        "zorder": 2.0 if is_reference else 2.5,
        "gid": track.name,
    }


class Comparison(Motions):
    """Every plant beside the reference on one source."""

    def figure(self) -> Figure:
        """Return everything that can be seen of it in one look, 1600 px wide.

        It shows paths (or windows of a long run, all from one pose), errors by horizon (or over
        time), speed and yaw rate, and wheel loads. Panels for which there are no data are left out.
        Lines carry the name of their motion, or `command`, as gid.
        """
        rows = list[PanelRow]()
        start, stop = self._span
        if stop - start > _LONGEST_PATH or len(self.truth) > 1:
            words, windows = self._windows()
            heading = f"Paths over {words} [m]: all start at one pose; from small to large errors"
            if any(scores.band for scores in self.scores.values()):
                heading += "; shaded: 90 % band"
            panels = [partial(self._draw_window, window) for window in windows]
            rows.append(PanelRow(3.5, panels, heading=heading))
        else:
            path = np.concatenate([piece.xy for piece in self.truth])
            width, height = np.ptp(path, axis=0) + 0.5
            tall = float(np.clip(10.0 * height / width, 3.0, 5.5))
            rows.append(PanelRow(tall, [self._draw_paths]))
        flags = [name for name, value in self.options.items() if value is True]
        made = [f"reference {self.reference}", f"seed {self.seed}", *flags]
        kind = "commands" if self._by_speed else "measured wheel rates"
        n = len(self.runs)
        title = shortened(Path(self.source.name).name, 48)
        return draw_page(
            f"{title}: {n} simulation{'s' * (n > 1)} driven by the same {kind}",
            [*rows, *self._panels()],
            legend=self._legend(),
            notes=[*filter(None, [self.verdict()]), *self.notes()],
            foot=how_driven(self.profile_label, self.terrain, made, self.versions),
        )

    def _panels(self) -> list[PanelRow]:
        """Panels below the paths, row by row; those without data are left out."""
        tracks = self.tracks()
        rows = list[PanelRow]()
        marks = []
        for name, scores in self.scores.items():
            if scores.overlapping:
                marker = _MARKERS.get(name, "o")
                marks.append(HorizonMarks(name, ink_of(name), marker, scores.overlapping))
        if marks:
            position = partial(draw_horizons, marks, "position")
            rows.append(PanelRow(2.3, [position, partial(draw_horizons, marks, "yaw")]))
        elif len(tracks) > 1:
            rows.append(self._error_panels(tracks[1:]))
        command = " and command" if self._by_speed else ""
        velocities = [
            partial(self._draw_velocity, f"Speed v_x [m/s]{command}", 0, 0),
            partial(self._draw_velocity, f"Yaw rate [rad/s]{command}", 2, 1),
        ]
        rows.append(PanelRow(2.3, velocities))
        loaded = [track for track in tracks if track.channel("wheel_load_N") is not None]
        if loaded:
            rows.append(PanelRow(2.3, [partial(self._draw_loads, loaded[0])]))
        return rows

    def _legend(self) -> list[Line2D]:
        """Return the only legend of plants."""
        marked = any(scores.overlapping for scores in self.scores.values())
        legend = []
        for track in self.tracks():
            marker = ""
            about = "reference"
            if track.reference is not None:
                about = headline_error(self.scores[track.name])
                if marked:
                    marker = _MARKERS.get(track.name, "o")
            label = f"{track.name}\n{about}"
            legend.append(key_line(label, marker=marker, **_look_of(track)))
        if self._by_speed:
            label = "command\nas given"
            legend.append(key_line(label, **COMMAND_LOOK))
        return legend

    # --- paths ---

    def _draw_paths(self, ax: Axes) -> None:
        """Draw the paths as they were driven."""
        curves = list[Curve]()
        ends = {}
        for track in self.tracks():
            paths = [(piece.pose[:, 0], piece.pose[:, 1]) for piece in track.pieces]
            curves.append((*join_pieces(paths), _look_of(track)))
            ends[track.name] = track.pieces[-1].pose[-1]
            first = track.pieces[0]
            self._draw_band(track, (0, 0, len(first) - 1), first.pose[0], ax)
        draw_paths(curves, ends, 1.0, ax)
        ax.set(title="Paths [m] (ring: start)", xlabel="x [m]", ylabel="y [m]")

    def _draw_window(self, window: tuple[int, int, int], ax: Axes) -> None:
        """Draw the paths over one window, each seen from its own pose at the window's start."""
        i, a, b = window
        curves = list[Curve]()
        ends = {}
        for track in self.tracks():
            pose = track.pieces[i].pose
            x, y, yaw = relative(pose[a], pose[a : b + 1]).T
            curves.append((x, y, _look_of(track)))
            ends[track.name] = np.array([x[-1], y[-1], yaw[-1]])
            self._draw_band(track, window, np.zeros(3), ax)
        draw_paths(curves, ends, 0.6, ax)
        ax.locator_params(axis="x", nbins=5)
        t = self.truth[i].t - self._span[0]
        ax.set_title(f"{t[a]:.1f} to {t[b]:.1f} s", fontweight="normal")
        ax.set(xlabel="ahead [m]", ylabel="to the left [m]")

    def _draw_band(
        self, track: Track, window: tuple[int, int, int], at: FloatArray, ax: Axes
    ) -> None:
        """Draw a plant's 90 % ellipses, every second of a window that starts `at` a pose."""
        scores = self.scores.get(track.name)
        if scores is None or scores.band is None or track.reference is None:
            return
        i, a, b = window
        t = track.pieces[i].t
        pose = track.pieces[i].pose
        ends = np.searchsorted(t, np.arange(t[b], t[a], -1.0))
        covariance = scores.band.covariance(pose, np.full(len(ends), a), ends)
        middles = compose(at, relative(pose[a], pose[ends]))[:, :2]
        axes = rotate_body_to_world(np.eye(2), at[2]).T
        reach = scores.band.reach_position
        for middle, one in zip(middles, covariance, strict=True):
            draw_ellipse(ax, middle, axes @ one @ axes.T, reach, ink_of(track.name))

    def _windows(self) -> tuple[str, list[tuple[int, int, int]]]:
        """A heading for the windows shown, and (piece, first, last sample) of each by error.

        All windows of the horizon closest to `HEADLINE_HORIZON` in which a plant moves are put in
        the order of the plants' mean error, and some that are spread evenly are shown. Where none
        fits, whole pieces serve.
        """
        reference, *others = self.tracks()
        words = "whole pieces"
        windows = [(i, 0, len(piece) - 1) for i, piece in enumerate(reference.pieces)]
        horizons = self.horizons or [HEADLINE_HORIZON]
        for horizon in sorted(horizons, key=lambda h: abs(h - HEADLINE_HORIZON)):
            pairs = zip(self.source.pieces, reference.pieces, strict=True)
            cuts = [piece.windows(horizon_windows, motion.t, horizon) for piece, motion in pairs]
            fitting = list[tuple[int, int, int]]()
            for i, (first, last) in enumerate(cuts):
                fitting.extend((i, int(a), int(b)) for a, b in zip(first, last, strict=True))
            if fitting:
                words = f"windows of {horizon:g} s"
                windows = fitting
                break

        def moves(window: tuple[int, int, int]) -> bool:
            i, a, b = window
            paths = [track.pieces[i].pose[a : b + 1] for track in others]
            return any(np.ptp(path, axis=0).max() > _LEAST_MOTION for path in paths)

        shown = list(filter(moves, windows)) or windows
        number, first, last = np.array(shown).T
        errors = np.zeros(len(shown))
        for i, piece in enumerate(reference.pieces):
            inside = number == i
            ends = (first[inside], last[inside])
            for track in others:
                errors[inside] += relative_pose_error(track.pieces[i].pose, piece.pose, *ends)[0]
        ranked = [shown[k] for k in np.argsort(errors, kind="stable")]
        n = min(_WINDOWS, len(ranked))
        spread = [ranked[int((k + 0.5) / n * len(ranked))] for k in range(n)]
        return f"{n} of {len(windows)} {words}", spread

    # --- over time ---

    @property
    def _by_speed(self) -> bool:
        """Whether the plants were driven by speed and yaw rate, not by wheel rates."""
        return all(piece.commands.kind == "twist" for piece in self.source.pieces)

    @property
    def _span(self) -> tuple[float, float]:
        return float(self.truth[0].t[0]), float(self.truth[-1].t[-1])

    @cached_property
    def _shown_span(self) -> tuple[float, float]:
        """The span over which velocities are shown [s]: the liveliest of the longest piece."""
        start, stop = self._span
        if stop - start <= _LONGEST_SHOWN:
            return start, stop
        longest = max(self.truth, key=lambda piece: float(piece.t[-1] - piece.t[0]))
        t = longest.t
        steps = np.abs(np.diff(longest.pose, axis=0)).sum(axis=1)
        way = np.concatenate([[0.0], np.cumsum(steps)])
        begins = np.arange(t[0], max(t[-1] - _STRETCH, t[0] + 0.5), 1.0)
        ways = np.interp(begins + _STRETCH, t, way) - np.interp(begins, t, way)
        begin = min(float(begins[np.argmax(ways)]), stop - _STRETCH)
        return begin, begin + _STRETCH

    def _over_time(
        self, track: Track, values: Callable[[Trajectory], FloatArray], **look: Any
    ) -> Curve:
        """Return a quantity of a motion over the span of velocities; `look` may differ from its."""
        low, high = self._shown_span
        parts = []
        for piece in track.pieces:
            k = (piece.t >= low) & (piece.t <= high)
            parts.append((piece.t[k] - self._span[0], values(piece)[k]))
        return *join_pieces(parts), _look_of(track) | look

    @cached_property
    def _time_axis(self) -> dict[str, Any]:
        """The axis of the span of velocities."""
        begin, end = self._span
        low, high = self._shown_span
        label = "time [s]"
        if begin:
            label += f" after {begin:.1f} s of the log"
        if (low, high) != (begin, end):
            label += f", part of {end - begin:.0f} s"
        return {"xlim": (low - begin, high - begin), "xlabel": label}

    def _draw_velocity(self, title: str, column: int, command: int, ax: Axes) -> None:
        """Draw one component of every robot's velocity, and of the command if it is a velocity."""
        curves = [
            self._over_time(track, lambda piece: piece.twist[:, column]) for track in self.tracks()
        ]
        if self._by_speed:
            parts = [(t - self._span[0], values[:, command]) for t, values in self.given()]
            curves.append((*join_pieces(parts), COMMAND_LOOK))
        draw_curves(curves, 0.1, ax, title=title, **self._time_axis)

    def _error_panels(self, tracks: Sequence[Track]) -> PanelRow:
        """Return panels of the motions' errors at equal times."""
        positions = list[Curve]()
        yaws = list[Curve]()
        begin, end = self._span
        for track in tracks:
            pairs = list(zip(track.pieces, self.truth, strict=True))
            off = [(true.t - begin, np.hypot(*(piece.xy - true.xy).T)) for piece, true in pairs]
            positions.append((*join_pieces(off), _look_of(track)))
            off = [(true.t - begin, wrap_angle(piece.yaw - true.yaw)) for piece, true in pairs]
            yaws.append((*join_pieces(off), _look_of(track)))
        length = length_unit([float(np.nanmax(errors)) for _, errors, _ in positions])
        panels = list[Panel]()
        for what, unit, curves in (("Position", length, positions), ("Yaw", DEGREES, yaws)):
            scaled = [(t, unit.scale * errors, look) for t, errors, look in curves]
            title = f"{what} error [{unit.symbol}] at equal times"
            axis: dict[str, Any] = {"xlabel": "time [s]", "xlim": (0.0, end - begin)}
            panels.append(partial(draw_curves, scaled, 1e-3, title=title, **axis))
        return PanelRow(2.3, panels)

    def _draw_loads(self, track: Track, ax: Axes) -> None:
        """Draw the loads of the four wheels, averaged over 0.25 s, and the verdict on them."""
        curves = []
        for k, wheel in enumerate(WHEELS):
            look: dict[str, Any] = {
                "color": ink_of(track.name) if wheel.startswith("front") else "0.25",
                "linestyle": (0.0, (4.0, 1.5)) if wheel.endswith("right") else "solid",
                "gid": wheel,
                "label": wheel.replace("_", " "),
            }
            curves.append(self._over_time(track, partial(_mean_load, "wheel_load_N", k), **look))
            if track.channel(QUASI_STATIC) is not None:
                look = {
                    "color": QUIET,
                    "linewidth": 1.0,
                    "linestyle": (0.0, (1.0, 1.0)),
                    "gid": f"{wheel} quasi-static",
                }
                curves.append(self._over_time(track, partial(_mean_load, QUASI_STATIC, k), **look))
        title = f"Wheel loads [N]: means over {_MEAN_TIME:g} s; dotted: quasi-static"
        draw_curves(curves, 10.0, ax, title=title, **self._time_axis)
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1.01, 0.98),
            ncols=4,
            frameon=False,
            fontsize=9.0,
            handlelength=1.8,
            columnspacing=1.2,
            borderaxespad=0.0,
        )
        low, high = ax.get_ylim()
        ax.set_ylim(low - 0.3 * (high - low), high)  # room for the verdict
        run = self.runs.get(track.name)
        if run is not None and (health := run.health) is not None:
            state = verdict(health)
            words = state if health["ok"] else state.upper()
            note = (
                f"{track.name} {words}: lowest load {health['lowest_load_share']:.0%} "
                f"of a wheel's mean, deviation {health['load_deviation']:.1%}"
            )
            corner_note(ax, note, ALARM if health["advice"] else QUIET)


def _mean_load(channel: str, wheel: int, piece: Trajectory) -> FloatArray:
    size = 1
    if len(piece) > 1:
        period = float(np.median(np.diff(piece.t)))
        size = max(1, round(_MEAN_TIME / period))
    ends = (size // 2, size - 1 - size // 2)
    loads = np.pad(piece.channels[channel][:, wheel], ends, mode="edge")
    return np.convolve(loads, np.full(size, 1.0 / size), mode="valid")
