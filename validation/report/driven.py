"""Robots that were driven beside a reference: what comparisons and tracked references share.

That is their motions by name, the recording, and panels of paths and of velocities over time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ssmr.parameters import require_one_of
from ssmr.types import FloatArray, Trajectory
from validation.output import Document
from validation.plants.profile import Profile
from validation.report.drawing import (
    BROAD,
    NARROW,
    Curve,
    Dashes,
    Look,
    Panel,
    draw_curves,
    draw_paths,
    ink_of,
    key_line,
)
from validation.report.palette import spell_name
from validation.report.report import Report
from validation.report.scene_robots import Track
from validation.simulator.description import with_robot
from validation.simulator.terrain import FLAT, Terrain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_STRETCH = 36.0
"""Length of the part of a long run over which velocities are shown [s]."""
COMMAND_LOOK: Look = {
    "color": "0.5",
    "linewidth": 1.0,
    "drawstyle": "steps-post",
    "zorder": 1.8,
    "gid": "command",
}
"""Line of the commands that drove the robots."""
MARKERS = {
    "mujoco": "o",
    "improved": "s",
    "coulomb": "^",
    "linear": "D",
    "kinematic": "v",
    "four_wheel": "p",
    "ode": "P",
    "drake": "X",
}
_DASHES = {
    "improved": (0.0, (6.0, 1.5)),
    "coulomb": (0.0, (1.5, 1.0)),
    "linear": (0.0, (7.0, 1.5, 1.5, 1.5)),
    "kinematic": (0.0, (3.0, 1.2)),
    "four_wheel": (0.0, (9.0, 1.2)),
}
GivenCommands = Sequence[tuple[FloatArray, FloatArray]]
"""(N,) instants [s] and (N, 2) commanded speeds and yaw rates [m/s, rad/s] of each piece."""
_VELOCITIES = {"Speed v_x [m/s]": 0, "Yaw rate [rad/s]": 2}
"""Panels of velocities, and the columns of twists that they show."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DrivenRobots(Report, ABC):
    """The report on robots of one profile that were driven beside a reference."""

    endings = ("png", "rrd")
    reference_look: ClassVar[Look] = {"linewidth": BROAD, "zorder": 2.0}
    """How the reference's line differs from a robot's."""
    dashes: ClassVar[Mapping[str, Dashes]] = _DASHES
    """Dashes of the lines of plants; others are solid."""
    longest_shown: ClassVar[float] = 60.0
    """Runs longer than this show velocities over a part only [s]: more would be a smear."""
    profile: Profile
    """Profile that gave the parameters."""
    seed: int = 0
    """Seed of noise and disturbance."""
    terrain: Terrain = FLAT
    """The ground that the MuJoCo robot stood on."""

    @abstractmethod
    def motions(self) -> Mapping[str, Sequence[Trajectory]]:
        """Return the motions of each plant, piece by piece."""

    @abstractmethod
    def tracks(self) -> list[Track]:
        """Return what is drawn: the reference, and then the other robots."""

    @abstractmethod
    def commanded(self) -> GivenCommands:
        """Return (N,) instants [s] and (N, 2) commanded speeds and yaw rates [m/s, rad/s].

        There is a pair for each piece, and none where wheel rates or several laws drive.
        """

    def motion(self, plant: str, piece: int = 0) -> Trajectory:
        """Return how a plant moved: its `t`, `xy`, `yaw`, `twist`, `wheels` and `channels`.

        Args:
            plant: name of the plant.
            piece: number of the part of a log that has gaps.

        Raises:
            ValueError: it was not driven.
        """
        motions = self.motions()
        require_one_of(plant, motions, f"no plant '{plant}' was driven")
        return motions[plant][piece]

    @property
    def profile_label(self) -> str:
        """Name of the profile, and of the robot where the profile's name does not contain it."""
        return with_robot(self.profile.name, self.profile.robot.name)

    # --- panels ---

    @cached_property
    def drawn(self) -> Sequence[Track]:
        """The tracks, made once."""
        return self.tracks()

    @property
    def span(self) -> tuple[float, float]:
        """The time from the first to the last sample of the reference [s]."""
        pieces = self.drawn[0].pieces
        return float(pieces[0].t[0]), float(pieces[-1].t[-1])

    @cached_property
    def shown_span(self) -> tuple[float, float]:
        """The span over which velocities are shown [s]: the liveliest of the longest piece."""
        start, stop = self.span
        if stop - start <= self.longest_shown:
            return start, stop
        longest = max(self.drawn[0].pieces, key=lambda piece: piece.t[-1] - piece.t[0])
        t = longest.t
        steps = np.diff(longest.pose, axis=0, prepend=longest.pose[:1])
        way = np.cumsum(np.abs(steps).sum(axis=1))
        begins = np.arange(t[0], max(t[-1] - _STRETCH, t[0] + 0.5), 1.0)
        ways = np.interp(begins + _STRETCH, t, way) - np.interp(begins, t, way)
        begin = min(begins[np.argmax(ways)], stop - _STRETCH)
        return begin, begin + _STRETCH

    @cached_property
    def time_axis(self) -> Document:
        """The axis of the span over which velocities are shown."""
        begin, end = self.span
        low, high = self.shown_span
        label = "time [s]"
        if begin:
            label += f" after {begin:.1f} s of the log"
        if (low, high) != (begin, end):
            label += f", part of {end - begin:.0f} s"
        return {"xlim": (low - begin, max(high - begin, 0.5)), "xlabel": label}

    def look_of(self, track: Track) -> Document:
        """Return the properties of a motion's line."""
        look = {
            "color": ink_of(track.name),
            "linestyle": self.dashes.get(track.name, "solid"),
            "linewidth": NARROW,
            "zorder": 2.5,
            "gid": track.name,
        }
        return {**look, **self.reference_look} if track is self.drawn[0] else look

    def curves_of(
        self, track: Track, values: Callable[[Trajectory], FloatArray], **look: Any
    ) -> list[Curve]:
        """Return a quantity of a motion over the span of velocities, piece by piece.

        `look` may differ from the motion's.
        """
        low, high = self.shown_span
        curves = list[Curve]()
        for piece in track.pieces:
            k = (piece.t >= low) & (piece.t <= high)
            own = {**self.look_of(track), **look}
            curves.append((piece.t[k] - self.span[0], values(piece)[k], own))
            look["label"] = ""  # one entry of a legend
        return curves

    def velocity_panels(self) -> list[Panel]:
        """Return the panels of speed and yaw rate, with the commands if they are velocities."""
        ending = " and command" if self.commanded() else ""
        panels = list[Panel]()
        for k, (title, column) in enumerate(_VELOCITIES.items()):
            panels.append(partial(self._draw_velocity, title + ending, column, k))
        return panels

    def _draw_velocity(self, title: str, column: int, command: int, ax: Axes) -> None:
        curves = []
        for track in self.drawn:
            curves += self.curves_of(track, lambda piece: piece.twist[:, column])
        for t, values in self.commanded():
            curves.append((t - self.span[0], values[:, command], COMMAND_LOOK))
        draw_curves(curves, 0.1, ax, title=title, **self.time_axis)

    def draw_whole_paths(self, smallest: float, ax: Axes) -> None:
        """Draw the paths as they were driven, in a panel of at least `smallest` [m]."""
        curves = [(*track.pose.T[:2], self.look_of(track)) for track in self.drawn]
        draw_paths(curves, {track.name: track.pose[-1] for track in self.drawn}, smallest, ax)
        ax.set(title="Paths [m] (ring: start)", xlabel="x [m]", ylabel="y [m]")

    def legend(self, about: Mapping[str, str], marked: bool = False) -> list[Line2D]:
        """Return the only legend, with words on each motion; robots may have markers."""
        legend = []
        for track in self.drawn:
            has_marker = marked and track is not self.drawn[0]
            marker = MARKERS.get(track.name, "o") if has_marker else ""
            label = f"{spell_name(track.name)}\n{about[track.name]}"
            legend.append(key_line(label, marker=marker, **self.look_of(track)))
        if self.commanded():
            legend.append(key_line("command\nas given", **COMMAND_LOOK))
        return legend
