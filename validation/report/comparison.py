"""A comparison: motions with one picture of paths, errors, velocities and wheel loads.

Everything is drawn by matplotlib's objects under a style of its own: no pyplot, and no setting
outlives a call.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ssmr.geometry import compose_poses, relative_pose, rotate_body_to_world
from ssmr.metrics.windows import horizon_windows, relative_pose_error
from ssmr.types import FloatArray, Trajectory
from validation.experiment.scores import HEADLINE_HORIZON
from validation.output import Document, shorten_text
from validation.report.columns import DEGREES, length_unit
from validation.report.drawing import (
    KEY,
    QUIET,
    Curve,
    Panel,
    PanelRow,
    draw_curves,
    draw_ellipse,
    draw_horizons,
    draw_page,
    draw_paths,
    how_driven,
    ink_of,
)
from validation.report.driven import MARKERS
from validation.report.motions import Motions, headline_error
from validation.report.scene_robots import Track
from validation.simulator.description import WHEELS
from validation.simulator.wheel_loads import QUASI_STATIC

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LONGEST_PATH = 30.0
"""Runs longer than this are shown in windows [s]: open-loop errors have grown beyond reading by
then."""
_WINDOWS = 4
"""Number of windows shown; their errors are spread evenly from the least to the greatest."""
_LEAST_MOTION = 0.05
"""Way [m] or turn [rad] from which a plant moves in a window."""
_MEAN_TIME = 0.25
"""Time over which wheel loads are averaged [s]: five periods of the driver's commands."""
_Window = tuple[int, int]
"""First and last sample of a window."""


class Comparison(Motions):
    """Every plant beside the reference on one source."""

    def figure(self) -> Figure:
        """Return everything that can be seen of it in one look, 1600 px wide.

        It shows paths (or windows of a long run, all from one pose), errors by horizon (or over
        time), speed and yaw rate, and wheel loads. Panels for which there are no data are left out.
        Lines carry the name of their motion, or `command`, as gid.
        """
        rows = []
        start, stop = self.span
        if stop - start > _LONGEST_PATH or len(self.truth) > 1:
            words, windows = self._windows()
            heading = f"Paths over {words} [m]: all start at one pose; from small to large errors"
            if any(scores.band for scores in self.scores.values()):
                heading += "; shaded: 90 % band"
            panels = [partial(self._draw_window, window) for window in windows]
            rows.append(PanelRow(3.5, panels, heading=heading))
        else:
            path = self.truth[0].xy
            width, height = np.ptp(path, axis=0) + 0.5
            tall = np.clip(10.0 * height / width, 3.0, 5.5)
            rows.append(PanelRow(tall, [self._draw_paths]))
        flags = [name for name, value in self.options.items() if value is True]
        made = [f"reference {self.reference}", f"seed {self.seed}", *flags]
        kind = "commands" if self.commanded() else "measured wheel rates"
        marked = any(scores.overlapping for scores in self.scores.values())
        all_rms = [scores.metrics["d_rms_m"] for scores in self.scores.values()]
        about = {name: headline_error(scores, all_rms) for name, scores in self.scores.items()}
        about[self.reference] = "reference"
        n = len(self.runs)
        title = shorten_text(Path(self.source.name).stem, 48)
        return draw_page(
            f"{title}: {n} simulation{'s' * (n > 1)} driven by the same {kind}",
            [*rows, *self._panels()],
            legend=self.legend(about, marked),
            notes=[*filter(None, [self.verdict()]), *self.notes()],
            foot=how_driven(self.profile_label, self.terrain, made, self.versions),
        )

    def _panels(self) -> list[PanelRow]:
        """Panels below the paths, row by row; those without data are left out."""
        tracks = self.drawn
        rows = []
        marks = []
        for name, scores in self.scores.items():
            if scores.overlapping:
                look = {"label": name, "color": ink_of(name), "marker": MARKERS.get(name, "o")}
                marks.append((scores.overlapping, look))
        if marks:
            position = partial(draw_horizons, marks, "position")
            rows.append(PanelRow(2.3, [position, partial(draw_horizons, marks, "yaw")]))
        elif len(tracks) > 1:
            rows.append(self._error_panels(tracks[1:]))
        rows.append(PanelRow(2.3, self.velocity_panels()))
        loaded = [track for track in tracks if track.channel("wheel_load_N") is not None]
        if loaded:
            rows.append(PanelRow(2.3, [partial(self._draw_loads, loaded[0])]))
        return rows

    # --- paths ---

    def _draw_paths(self, ax: Axes) -> None:
        """Draw the paths as they were driven."""
        for track in self.drawn:
            self._draw_band(track, (0, len(track.pose) - 1), track.pose[0], ax)
        self.draw_whole_paths(1.0, ax)

    def _draw_window(self, window: _Window, ax: Axes) -> None:
        """Draw the paths over one window, from its first to its last sample.

        Each is seen from its own pose at the window's start.
        """
        a, b = window
        curves = []
        ends = {}
        for track in self.drawn:
            path = relative_pose(track.pose[a], track.pose[a : b + 1])
            curves.append((path[:, 0], path[:, 1], self.look_of(track)))
            ends[track.name] = path[-1]
            self._draw_band(track, window, np.zeros(3), ax)
        draw_paths(curves, ends, 0.6, ax)
        ax.locator_params(axis="x", nbins=5)
        start, end = self.drawn[0].t[[a, b]] - self.span[0]
        ax.set_title(f"{start:.1f} to {end:.1f} s", fontweight="normal")
        ax.set(xlabel="ahead [m]", ylabel="to the left [m]")

    def _draw_band(self, track: Track, window: _Window, at: FloatArray, ax: Axes) -> None:
        """Draw a plant's 90 % ellipses, every second of a window that starts `at` a pose."""
        scores = self.scores.get(track.name)
        if scores is None or scores.band is None or track.reference is None:
            return
        a, b = window
        ends = np.searchsorted(track.t, np.arange(track.t[b], track.t[a], -1.0))
        covariance = scores.band.covariance(track.pose, np.full(len(ends), a), ends)
        middles = compose_poses(at, relative_pose(track.pose[a], track.pose[ends]))[:, :2]
        axes = rotate_body_to_world(np.eye(2), at[2]).T
        reach = scores.band.reach_position
        for middle, one in zip(middles, covariance, strict=True):
            draw_ellipse(ax, middle, axes @ one @ axes.T, reach, ink_of(track.name))

    def _windows(self) -> tuple[str, list[_Window]]:
        """A heading for the windows shown, and the first and last sample of each by error.

        All windows of the horizon closest to `HEADLINE_HORIZON` in which a plant moves are put in
        the order of the plants' mean error, and some that are spread evenly are shown. Where none
        fits, whole pieces serve.
        """
        reference, *others = self.drawn
        begins = np.cumsum([0, *map(len, self.truth)])
        words = "whole pieces"
        windows = np.stack([begins[:-1], begins[1:] - 1])
        horizons = self.horizons or [HEADLINE_HORIZON]
        for horizon in sorted(horizons, key=lambda h: abs(h - HEADLINE_HORIZON)):
            cuts = []
            for piece, motion, begin in zip(self.source.pieces, self.truth, begins, strict=False):
                cuts.append(begin + np.stack(piece.windows(horizon_windows, motion.t, horizon)))
            fitting = np.hstack(cuts)
            if fitting.size:
                words = f"windows of {horizon:g} s"
                windows = fitting
                break

        def moves(window: _Window) -> bool:
            a, b = window
            paths = [track.pose[a : b + 1] for track in others]
            return any(np.ptp(path, axis=0).max() > _LEAST_MOTION for path in paths)

        every = list(zip(*windows.tolist(), strict=True))
        shown = list(filter(moves, every)) or every
        ends = np.array(shown).T
        errors = [relative_pose_error(track.pose, reference.pose, *ends)[0] for track in others]
        ranked = [shown[k] for k in np.argsort(np.sum(errors, axis=0), kind="stable")]
        n = min(_WINDOWS, len(ranked))
        spread = [ranked[int((k + 0.5) / n * len(ranked))] for k in range(n)]
        return f"{n} of {len(every)} {words}", spread

    # --- over time ---

    def _error_panels(self, tracks: Sequence[Track]) -> PanelRow:
        """Return panels of the motions' errors at equal times."""
        begin, end = self.span
        gaps = np.cumsum([len(piece) for piece in self.truth])[:-1]
        units = {"Position": length_unit([track.errors[0].max() for track in tracks])}
        units["Yaw"] = DEGREES
        panels = list[Panel]()
        for which, (what, unit) in enumerate(units.items()):
            curves = list[Curve]()
            for track in tracks:
                errors = np.split(unit.scale * track.errors[which], gaps)
                for true, error in zip(self.truth, errors, strict=True):
                    curves.append((true.t - begin, error, self.look_of(track)))
            title = f"{what} error [{unit.symbol}] at equal times"
            axis: Document = {"xlabel": "time [s]", "xlim": (0.0, end - begin)}
            panels.append(partial(draw_curves, curves, 1e-3, title=title, **axis))
        return PanelRow(2.3, panels)

    def _draw_loads(self, track: Track, ax: Axes) -> None:
        """Draw the loads of the four wheels, averaged over 0.25 s, and the verdict on them."""
        curves = []
        for k, wheel in enumerate(WHEELS):
            curves += self.curves_of(
                track,
                partial(_mean_load, "wheel_load_N", k),
                color=ink_of(track.name) if wheel.startswith("front") else "0.25",
                linestyle=(0.0, (4.0, 1.5)) if wheel.endswith("right") else "solid",
                gid=wheel,
                label=wheel.replace("_", " "),
            )
            if track.channel(QUASI_STATIC) is not None:
                curves += self.curves_of(
                    track,
                    partial(_mean_load, QUASI_STATIC, k),
                    color=QUIET,
                    linewidth=1.0,
                    linestyle=(0.0, (1.0, 1.0)),
                    gid=f"{wheel} quasi-static",
                )
        title = "Wheel loads [N] (dotted: quasi-static)"
        draw_curves(curves, 10.0, ax, title=title, **self.time_axis)
        ax.legend(loc="lower right", bbox_to_anchor=(1.01, 0.95), ncols=4, **KEY)


def _mean_load(channel: str, wheel: int, piece: Trajectory) -> FloatArray:
    period = np.median(np.diff(piece.t)) if len(piece) > 1 else _MEAN_TIME
    loads = piece.channels[channel][:, wheel]
    size = max(1, round(_MEAN_TIME / period))
    padded = np.pad(loads, (size // 2, (size - 1) // 2), mode="edge")
    return np.convolve(padded, np.full(size, 1.0 / size), mode="valid")
