"""The report on robots that followed a reference: tables, sentences, JSON and recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ssmr.control.loop import ClosedRun
from ssmr.control.waypoints import ALPHA_SWITCH, step_lengths
from ssmr.errors import SsmrError
from ssmr.estimation.settings import EkfSettings
from ssmr.geometry import relative_pose, wrap_angle
from ssmr.metrics.declared import Metrics
from ssmr.types import Trajectory
from validation.experiment.gains import GainSet
from validation.experiment.tracked import (
    OF_THE_LOOP,
    OF_THE_PATH,
    TRACK_METRICS,
    Followed,
    lost_text,
)
from validation.output import Document, one_line, shorten_text
from validation.report.columns import DEGREES, REAL_TIME, Unit, declare, length_unit
from validation.report.drawing import (
    ALARM,
    REFERENCE_LOOK,
    Dashes,
    PanelRow,
    draw_curves,
    draw_page,
    how_driven,
)
from validation.report.driven import DrivenRobots, GivenCommands
from validation.report.palette import BLACK, GREY, WHITE, mix_colours
from validation.report.scene_robots import Plots, Series, Track, bright_colour
from validation.report.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MUCH_SATURATED = 0.05
"""Share of time at its limits above which a robot follows these rather than its controller."""
_UNSETTLED = 0.5
"""A speed whose RMS differs from the reference's by a greater share is pointed out."""
_ERRORS = {
    "e_rho": "how far ahead the target is",
    "e_y": "its offset to the left",
    "e_alpha": "its heading",
}
"""Errors to the moving target, by the columns of the log."""
_SIGNALS = {
    "speed": ("m/s", 0, "u_ref", "v_cmd"),
    "yaw_rate": ("rad/s", 2, "w_ref", "w_cmd"),
}
"""Velocities: unit, column of a twist, and columns of the log, requested and commanded."""
_WIDE = 2.6
"""A reference wider than so many times its height has a row of its own [1]."""
declare(*TRACK_METRICS.values())


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Tracked(DrivenRobots):
    """Robots that followed one reference under one controller; the first is the report's own."""

    program = "track"
    reference_look = REFERENCE_LOOK
    dashes: ClassVar[Mapping[str, Dashes]] = {}
    longest_shown = math.inf
    robots: tuple[Followed, ...]
    """The robots, each another plant."""
    controller: str
    """Name of the controller."""
    gains: GainSet | None
    """Its gains; None for a controller of the user's own."""
    reference: str
    """Name or path of the reference, as the user gave it."""
    speed: float
    """Mean speed of the reference [m/s]."""
    filter: EkfSettings | None = None
    """State filter whose estimate the controller saw, if it saw one."""
    stopped_because: str | None = None
    """Reason why a robot on ROS was stopped, empty where it arrived; None for a simulation."""

    @classmethod
    def of(
        cls, robots: Sequence[Followed], controller: str, reference: str, speed: float, **more: Any
    ) -> Tracked:
        """Return the report on robots that followed one reference; `more` are other fields."""
        name = Path(one_line(reference)).name
        about: Document = {
            "title": f"{controller} follows {name} at {speed:.3g} m/s",
            "options": robots[0].options,
            "failure": None,
        }
        for r in robots:
            try:
                r.run.require_complete(f"{controller} on {reference} with the plant {r.plant}")
            except SsmrError as error:
                about["failure"] = about["failure"] or error
        about |= {"controller": controller, "reference": reference, "speed": speed}
        return cls(robots=tuple(robots), **(about | more))

    @property
    def gains_name(self) -> str:
        """Name or file of the gain set."""
        return "none" if self.gains is None else self.gains.name

    @property
    def gain_values(self) -> dict[str, float]:
        """Gains by name."""
        return {} if self.gains is None else dict(self.gains.values)

    @property
    def metrics(self) -> Metrics:
        """Metrics of the first robot by name, such as `metrics["d_rms_m"]`."""
        return self.robots[0].metrics

    def motions(self) -> Mapping[str, Sequence[Trajectory]]:
        """Return the motion of each plant."""
        return {r.plant: [r.run.motion] for r in self.robots}

    def require_complete(self) -> None:
        """Do nothing if every robot came to the end of its reference.

        Raises:
            LostError: one was lost; the message says which, when and where.
        """
        if self.failure is not None:
            raise self.failure

    def tables(self) -> list[Table]:
        """Return the metrics of the paths, and of the errors to the moving target."""
        caption = f"gains {one_line(self.gains_name)} · seed {self.seed}"
        if (feedback := self.options.get("feedback")) is not None:
            caption += f" · feedback {one_line(feedback)}"
        if self.filter is not None:
            caption += " · the thesis' filter"
        # a law without a predictor learns no dead time
        known = {name for r in self.robots for name, x in r.metrics.items() if math.isfinite(x)}
        measured = [name for name in OF_THE_LOOP if name in known]
        path = []
        loop = []
        for r in self.robots:
            label = f"{r.plant} (lost)" if r.run.lost else r.plant
            undeclared = [name for name in r.metrics if name not in TRACK_METRICS]
            of_the_path = {name: r.metrics[name] for name in (*OF_THE_PATH, *undeclared)}
            path.append({"plant": label, **of_the_path})
            of_the_loop = {name: r.metrics[name] for name in measured}
            loop.append({"plant": label, **of_the_loop, REAL_TIME.name: r.real_time_factor})
        return [
            Table(f"{self.title} · profile {one_line(self.profile_label)}", path),
            Table("Errors to the moving target", loop, caption),
        ]

    def document(self) -> Document:
        """Return the first robot as track.json has it, and the others under `beside`, by plant."""
        first, *others = self.robots
        fields = first.as_dict()
        metrics = {name: fields.pop(name) for name in first.metrics}
        document = {
            "schema": "ssmr.track/1",
            "controller": self.controller,
            "reference": self.reference,
            "speed_m_s": self.speed,
            "plant": first.plant,
            "profile": self.profile.name,
            "robot": self.profile.robot.name,
            "gains_name": self.gains_name,
            "gains": self.gain_values,
            "seed": self.seed,
            "metrics": {**metrics, "lost": first.run.lost},
            **fields,
        }
        if self.filter is not None:
            document["filter"] = {"name": "thesis", **asdict(self.filter)}
        if others:
            document["beside"] = {r.plant: r.as_dict() for r in others}
        if self.stopped_because is not None:
            document["stopped_because"] = self.stopped_because
        return document

    def notes(self) -> list[str]:
        """Return the remarks, and sentences on striking numbers in the tables."""
        notes = super().notes()
        for r in self.robots:
            notes += _striking_sentences(r)
        x, y, yaw = self.options.get("start", (0.0, 0.0, 0.0))
        if x or y or yaw:
            notes.append(
                f"The robot begins {math.hypot(x, y):.3g} m from the start of the reference "
                f"and turned by {math.degrees(yaw):.3g} degrees."
            )
        if (lookahead := self.options.get("lookahead_m", 0.0)) > 0.0:
            notes.append(
                f"The robot keeps {lookahead:g} m behind its target by intention: "
                "e_rho should become that, not zero."
            )
        return notes

    def tracks(self) -> list[Track]:
        """Return the target that was followed for the longest time, and the robots."""
        target = max((robot.target for robot in self.robots), key=len)
        # at its last sample it stands
        twist = target.twist[np.minimum(np.arange(len(target)), max(len(target) - 2, 0))]
        motions = {"reference": Trajectory(target.t, target.pose, twist, target.wheels)}
        motions |= {r.plant: r.run.motion for r in self.robots}
        tracks = []
        for name, motion in motions.items():
            track = Track(name, (motion,), terrain=self.terrain, robot=self.profile.robot)
            tracks.append(track)
        return tracks

    def commanded(self) -> GivenCommands:
        """Return the commands to a single robot."""
        if len(self.robots) > 1:
            return []
        return [(r.run.t, r.run.columns("v_cmd", "w_cmd")) for r in self.robots]

    def figure(self) -> Figure:
        """Draw paths, velocities and the true errors to the moving target, 1600 px wide."""
        gains = " · ".join(f"{name} {value:.4g}" for name, value in self.gain_values.items())
        words = [f"seed {self.seed}"]
        if "feedback" in self.options:
            words.append(f"feedback {self.options['feedback']}")
        lost = [r for r in self.robots if r.run.lost]
        notes = [f"{r.plant} was {lost_text(r.run)}" for r in lost]
        if gains:
            notes.append(f"gains {shorten_text(self.gains_name, 40)}: {gains}")
        names = [r.plant for r in self.robots]
        heading = f"{self.title} · {f'{len(names)} simulations' if names[1:] else names[0]}"
        if lost:
            heading += f" · LOST: {', '.join(r.plant for r in lost)}"
        unit = length_unit([r.metrics["d_rms_m"] for r in self.robots])
        about = {self.drawn[0].name: ""}
        for r in self.robots:
            about[r.plant] = f"d_rms {unit.text(r.metrics['d_rms_m'])} {unit.symbol}"
        paths = partial(self.draw_whole_paths, 0.6)
        speeds = self.velocity_panels()
        errors = []
        for name, of_error in self._error_units().items():
            errors.append(partial(self._draw_error, name, of_error))
        places = np.concatenate([track.pose[:, :2] for track in self.drawn])
        width, height = np.ptp(places, axis=0) + 0.3
        rows = [PanelRow(3.6, [paths, *speeds], (0.3, 0.35, 0.35))]
        if width > _WIDE * height:
            tall = np.clip(12.0 * height / width + 0.75, 1.5, 2.25)
            rows = [PanelRow(tall, [paths]), PanelRow(2.0, speeds)]
        return draw_page(
            shorten_text(heading, 100),
            [*rows, PanelRow(2.0, errors)],
            legend=self.legend(about),
            notes=notes,
            foot=how_driven(self.profile_label, self.terrain, words, self.versions),
            ink=ALARM if lost else "0.0",
        )

    def _error_units(self) -> dict[str, Unit]:
        """Return the units of the errors to the moving target, by column."""
        reach = [np.abs(r.run.columns("e_rho", "e_y")).max() for r in self.robots if len(r.run.t)]
        length = length_unit([max(reach, default=0.0)])
        return dict(zip(_ERRORS, (length, length, DEGREES), strict=True))

    def _draw_error(self, name: str, unit: Unit, ax: Axes) -> None:
        """Draw an error of the robots themselves, not of what they see, and what it should be."""
        goal = float(self.options.get("lookahead_m", 0.0)) if name == "e_rho" else 0.0
        begin = np.array(self.time_axis["xlim"])
        curves = [(begin, np.full(2, goal * unit.scale), REFERENCE_LOOK)]
        for track, r in zip(self.drawn[1:], self.robots, strict=True):
            aim = r.run.columns("target_x", "target_y", "target_yaw")
            x, y, yaw = relative_pose(r.run.columns("x", "y", "yaw"), aim).T
            near = np.hypot(x, y) <= ALPHA_SWITCH
            errors = {"e_rho": x, "e_y": y, "e_alpha": np.where(near, wrap_angle(yaw), 0.0)}
            curves.append((r.run.t, unit.scale * errors[name], self.look_of(track)))
        title = f"{name}: {_ERRORS[name]} [{unit.symbol}]"
        least = 1.0 if unit is DEGREES else 0.01 * unit.scale
        draw_curves(curves, least, ax, title=title, **self.time_axis)

    def record(self, path: Path) -> None:
        """Write robots, moving target and signals, see `Report.record`."""
        from validation.report.scene import write_scene  # here: rerun may be missing

        target, *tracks = self.tracks()
        title = f"{self.title}, profile {self.profile_label}"
        write_scene(self, title, tracks, self._time_plots(target.pieces[0]), path, target)

    def _time_plots(self, target: Trajectory) -> Plots:
        """Return velocities, wanted and commanded, and errors over time, by entity."""
        plots = {}
        for quantity, (unit, column, *columns) in _SIGNALS.items():
            aim = Series(["reference"], unit, [GREY], target.t, target.twist[:, column])
            plots[f"{quantity}/reference"] = aim
            for r in self.robots:
                ink = bright_colour(r.plant)
                inks = [mix_colours(ink, WHITE, 0.5), mix_colours(ink, BLACK, 0.3)]
                names = [f"{r.plant} request", f"{r.plant} command"]
                both = r.run.columns(*columns)
                wanted = Series(names, unit, inks, r.run.t, both, held=True)
                plots[f"{quantity}/{r.plant}_wanted"] = wanted
        for r in self.robots:
            for error, of_error in self._error_units().items():
                values = of_error.scale * r.run.column(error)
                inks = [bright_colour(r.plant)]
                series = Series([r.plant], of_error.symbol, inks, r.run.t, values)
                plots[f"{error}/{r.plant}"] = series
        return plots


def _striking_sentences(r: Followed) -> list[str]:
    """Return sentences on where a robot was worst, and on numbers that are striking."""
    notes = []
    m = r.metrics
    if r.run.lost:
        notes.append(
            f"{r.plant} was {lost_text(r.run)}: its numbers cover only the time before that."
        )
    if worst := _worst_place(r.run, r.target):
        notes.append(f"{r.plant} was {worst}.")
    if m["saturated_fraction"] > _MUCH_SATURATED:
        notes.append(
            f"{r.plant}: a torque or the command was at its limit "
            f"{m['saturated_fraction']:.0%} of the time."
        )
    if not r.run.lost and abs(m["u_rms_ratio"] - 1.0) > _UNSETTLED:
        notes.append(
            f"{r.plant}: its speed was {m['u_rms_ratio']:.2f} times "
            "that of the reference, by root mean square."
        )
    far = np.abs(r.run.column("e_rho")) > ALPHA_SWITCH
    beyond = np.mean(far) if len(far) else 0.0
    if beyond > 0.0:
        notes.append(
            f"{r.plant}: the target was farther than {ALPHA_SWITCH:g} m "
            f"for {max(beyond, 0.001):.1%} of the time, "
            "where errors of heading count as zero."
        )
    return notes


def _worst_place(run: ClosedRun, target: Trajectory) -> str:
    """Return where a robot was farthest from the path of its target; empty for no path."""
    from scipy.spatial import KDTree

    if len(target) < 2:
        return ""
    places = run.columns("x", "y")
    distances, nearest = KDTree(target.xy).query(places)
    k = np.argmax(distances)
    along = np.sum(step_lengths(target.xy[: nearest[k] + 1]))
    x, y = places[k]
    return (
        f"farthest from its path, {1e3 * distances[k]:.0f} mm, at t = {run.t[k]:.1f} s, "
        f"{along:.1f} m along it, at ({x:.2f}, {y:.2f}) m"
    )
