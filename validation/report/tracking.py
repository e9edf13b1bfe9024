"""The report on robots that followed a reference: tables, sentences, JSON and recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ssmr.control.loop import ClosedRun
from ssmr.control.waypoints import ALPHA_SWITCH, step_lengths
from ssmr.errors import SsmrError
from ssmr.estimation.settings import EkfSettings
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
from validation.output import Document, one_line, shortened
from validation.plants.profile import Profile
from validation.report.columns import REAL_TIME, declare
from validation.report.drawing import how_driven
from validation.report.palette import BLACK, GREY, WHITE, mix
from validation.report.report import Report
from validation.report.scene_robots import Series, Track, bright
from validation.report.table import Row, Table
from validation.report.track_panels import draw_track, error_units, longest_target
from validation.simulator.description import with_robot
from validation.simulator.terrain import FLAT, Terrain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MUCH_SATURATED = 0.05
"""Share of time at its limits above which a robot follows these rather than its controller."""
_UNSETTLED = 0.5
"""A speed whose RMS differs from the reference's by a greater share is pointed out."""
declare(*TRACK_METRICS.values())


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Tracked(Report):
    """Robots that followed one reference under one controller; the first is the report's own."""

    program = "track"
    endings = ("png", "rrd")
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
    profile: Profile
    """The profile that gave the plants' parameters."""
    seed: int = 0
    """Seed of noise and disturbance."""
    terrain: Terrain = FLAT
    """Ground of a MuJoCo robot."""
    filter: EkfSettings | None = None
    """State filter whose estimate the controller saw, if it saw one."""
    remarks: Sequence[str] = ()
    """Sentences on what was known before the run."""
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
    def profile_label(self) -> str:
        """Name of the profile, and of the robot where the first does not tell the second."""
        return with_robot(self.profile.name, self.profile.robot.name)

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

    def motion(self, plant: str) -> Trajectory:
        """Return how a plant moved: its `t`, `xy`, `yaw`, `twist`, `wheels` and `channels`.

        Raises:
            ValueError: it was not driven.
        """
        motions = {r.plant: r.run.motion for r in self.robots}
        if plant not in motions:
            raise ValueError(f"no plant '{plant}' was driven; there are: {', '.join(motions)}")
        return motions[plant]

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
        path = list[Row]()
        loop = list[Row]()
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
        notes = [*super().notes(), *self.remarks]
        for r in self.robots:
            notes += _striking(r)
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

    def figure(self) -> Figure:
        """Draw paths, velocities and errors, see `draw_track`."""
        gains = " · ".join(f"{name} {value:.4g}" for name, value in self.gain_values.items())
        words = [f"seed {self.seed}"]
        if "feedback" in self.options:
            words.append(f"feedback {self.options['feedback']}")
        foot = how_driven(self.profile_label, self.terrain, words, self.versions)
        name = shortened(self.gains_name, 40)
        return draw_track(self.robots, self.title, f"gains {name}: {gains}", foot)

    def record(self, path: Path) -> None:
        """Write robots, moving target and signals as a rerun recording, whole or not at all.

        Raises:
            OSError: the file cannot be written.
            RuntimeError: rerun is switched off by `RERUN=off`.
        """
        from validation.report.scene import Scene, write_scene

        motions = {r.plant: r.run.motion for r in self.robots}
        motions["reference"] = longest_target(self.robots)
        *tracks, target = (
            Track(name, (motion,), None, terrain=self.terrain, robot=self.profile.robot)
            for name, motion in motions.items()
        )
        scene = Scene(
            program=self.program,
            title=f"{self.title}, profile {self.profile_label}",
            tracks=tracks,
            report=self.to_markdown(),
            plots=_plots(self.robots),
            target=target,
        )
        write_scene(scene, path)


def _striking(r: Followed) -> list[str]:
    """Return sentences on where a robot was worst, and on numbers that are striking."""
    notes = []
    m = r.metrics
    if r.run.lost:
        notes.append(
            f"{r.plant} was {lost_text(r.run)}: its numbers cover only the time before that."
        )
    if worst := _worst(r.run, r.target):
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
    beyond = float(np.mean(far)) if len(far) else 0.0
    if beyond > 0.0:
        notes.append(
            f"{r.plant}: the target was farther than {ALPHA_SWITCH:g} m "
            f"for {max(beyond, 0.001):.1%} of the time, "
            "where errors of heading count as zero."
        )
    return notes


def _worst(run: ClosedRun, target: Trajectory) -> str:
    """Return where a robot was farthest from the path of its target; empty for no path."""
    from scipy.spatial import KDTree

    if len(target) < 2:
        return ""
    places = run.columns("x", "y")
    distances, nearest = KDTree(target.xy).query(places)
    k = int(np.argmax(distances))
    along = float(np.sum(step_lengths(target.xy[: int(nearest[k]) + 1])))
    x, y = places[k]
    return (
        f"farthest from its path, {1e3 * distances[k]:.0f} mm, at t = {run.t[k]:.1f} s, "
        f"{along:.1f} m along it, at ({x:.2f}, {y:.2f}) m"
    )


def _plots(robots: Sequence[Followed]) -> dict[str, Series]:
    """Return velocities, wanted and commanded, and errors over time, by entity."""
    plots = dict[str, Series]()
    target = longest_target(robots)
    units = error_units(robots)
    signals = (("speed", "m/s", 0, "u_ref", "v_cmd"), ("yaw_rate", "rad/s", 2, "w_ref", "w_cmd"))
    for quantity, unit, column, *columns in signals:
        values = target.twist[:-1, column]
        plots[f"{quantity}/reference"] = Series(["reference"], unit, [GREY], target.t[:-1], values)
        for r in robots:
            ink = bright(r.plant)
            inks = [mix(ink, WHITE, 0.5), mix(ink, BLACK, 0.3)]
            names = [f"{r.plant} request", f"{r.plant} command"]
            both = r.run.columns(*columns)
            plots[f"{quantity}/{r.plant}_wanted"] = Series(
                names, unit, inks, r.run.t, both, held=True
            )
    for r in robots:
        for error, of_error in units.items():
            values = of_error.scale * r.run.column(error)
            plots[f"{error}/{r.plant}"] = Series(
                [r.plant], of_error.symbol, [bright(r.plant)], r.run.t, values
            )
    return plots
