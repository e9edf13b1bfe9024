"""Robots that followed a reference: a result that prints, draws and saves itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ssmr.metrics.declared import Metrics
from validation import store
from validation.progress import Report, silent
from validation.report.result import Result
from validation.report.tables import Grid
from validation.track.data import TrackedRobot
from validation.track.table import headline, require_comparable, track_grids, track_notes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "ssmr.track/1"


@dataclass(frozen=True, eq=False)
class TrackResult(Result):
    """One robot or several that followed one reference under one controller; the first one is the result's own."""

    robots: tuple[TrackedRobot, ...]
    """The robots, each another plant."""
    remarks: tuple[str, ...] = field(default=(), kw_only=True)
    """Sentences on what was known before the run: gains of another profile, a reference that asks for too much."""

    program: ClassVar[str] = "track"

    def __post_init__(self) -> None:
        """Raise a ValueError for none or too many robots, different references or speeds, or one plant twice."""
        require_comparable(self.robots)

    @property
    def metrics(self) -> Metrics:
        """Metrics of the first robot by name, such as `metrics["d_rms_m"]`."""
        return self.robots[0].metrics

    def robot(self, plant: str) -> TrackedRobot:
        """Return the robot that was this plant.

        Raises:
            ValueError: there is none; the message lists the plants.
        """
        for robot in self.robots:
            if robot.plant == plant:
                return robot
        raise ValueError(f"no robot was the plant '{plant}'; there are: {', '.join(r.plant for r in self.robots)}")

    def require_kept(self) -> None:
        """Do nothing if every robot came to the end of its reference.

        Raises:
            LostError: one was lost; the message says which, when and where.
        """
        for r in self.robots:
            r.run.require_kept(f"{r.controller} on {r.reference} with the plant {r.plant}")

    def grids(self) -> Sequence[Grid]:
        """Return two tables: how well the path was followed, and the errors that the controller saw."""
        return track_grids(self.robots)

    def notes(self) -> Sequence[str]:
        """Return sentences on losses, saturation and other things that the tables do not say."""
        return [*self.remarks, *track_notes(self.robots)]

    def figure(self) -> Figure:
        """Return the picture: paths, velocities and errors."""
        from validation.track.figure import draw_track

        return draw_track(self.robots)

    def write_recording(self, path: Path) -> bool:
        """Write track.rrd to `path`: the robots, the moving target and time series."""
        from validation.track.rerun import write_track_rerun

        write_track_rerun(self.robots, path)
        return True

    def save(self, folder: str | Path, *, recording: bool = True) -> list[Path]:
        """Write its files as every result, and filter.toml if the first robot had a filter that learns; return their paths.

        Raises:
            OSError: the folder cannot be made or written.
        """
        used, place = self.robots[0].filter, store.make_folder(Path(folder))
        own = [used.save(place / "filter.toml")] if used is not None and used.settings.learns else []
        return [*own, *super().save(folder, recording=recording)]

    def write_video(self, path: Path, progress: Report = silent) -> None:
        """Write the robots and the target in motion as a video; see `validation.report.video.write_video`."""
        from validation.report.video import write_video
        from validation.track.rerun import followed_tracks

        write_video(followed_tracks(self.robots), path, headline(self.robots[0]), progress)

    def as_dict(self) -> dict[str, Any]:
        """Return what track.json holds: the first robot, and the others under `beside`, by plant."""
        first, *others = self.robots
        own = first.as_dict()
        document = {
            "schema": SCHEMA,
            "controller": first.controller,
            "reference": first.reference,
            "speed_m_s": first.speed,
            "plant": first.plant,
            "profile": first.profile,
            "robot": first.body.name,
            "gains_name": first.gains_name,
            "gains": dict(first.gains),
            "seed": first.seed,
            "metrics": {**{name: own.pop(name) for name in first.metrics}, "lost": first.run.lost},
            **own,
            "notes": list(self.notes()),
            "options": dict(first.options),
            "versions": dict(first.versions),
        }
        if first.filter is not None:
            document["filter"] = first.filter.as_dict()
        if others:
            document["beside"] = {r.plant: r.as_dict() for r in others}
        plain: dict[str, Any] = store.plain(document)
        return plain
