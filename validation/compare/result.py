"""A comparison that prints, draws and saves itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from validation.compare.data import ComparisonData, PlantResult
from validation.compare.table import alike_plants, comparison_grids, comparison_notes
from validation.progress import Report, silent
from validation.show.result import Result
from validation.show.tables import Grid
from validation.simulator.description import WHEELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SCHEMA = "ssmr.compare/1"


@dataclass(frozen=True, eq=False)
class Comparison(ComparisonData, Result):
    """Every plant against the reference on one source, ready to be shown and saved as compare.json, .png and .rrd."""

    program: ClassVar[str] = "compare"

    def grids(self) -> Sequence[Grid]:
        """Return the tables: on a recording the errors after each horizon first; then the metrics; then wheel loads."""
        return comparison_grids(self)

    def notes(self) -> Sequence[str]:
        """Return sentences on what is wrong with a recording and what it cannot tell apart."""
        return comparison_notes(self)

    def figure(self) -> Figure:
        """Return the picture: paths, errors, velocities and wheel loads."""
        from validation.compare.figure import comparison_figure

        return comparison_figure(self)

    def write_recording(self, path: Path) -> bool:
        """Write compare.rrd to `path`: the robots in 3-D, their paths and time series."""
        from validation.compare.rerun import write_recording
        from validation.compare.table import comparison_markdown

        write_recording(self, path, comparison_markdown(self))
        return True

    def write_video(self, path: Path, progress: Report = silent) -> None:
        """Write the robots in motion as a video; see `validation.show.video.write_video`."""
        from validation.compare.rerun import compared_tracks
        from validation.show.video import write_video

        write_video(compared_tracks(self), path, f"{self.source}, {self.profile_label}", progress)

    def as_dict(self) -> dict[str, Any]:
        """Return what compare.json holds."""
        return {
            "schema": _SCHEMA,
            "source": self.source,
            "profile": self.profile,
            "robot": self.robot.name,
            "reference": self.reference_name,
            "seed": self.seed,
            "options": dict(self.options),
            "notes": comparison_notes(self),
            "alike": alike_plants(self),
            "versions": dict(self.versions),
            "plants": {name: _plant_entry(result) for name, result in self.plants.items()},
            "parameters": {name: dict(result.parameters) for name, result in self.plants.items()},
        }


def _plant_entry(result: PlantResult) -> dict[str, Any]:
    entry: dict[str, Any] = {**result.metrics, "wall_s": result.wall_s, "real_time_factor": result.real_time_factor}
    if result.horizons:
        entry["horizons"] = {f"{h:g}": asdict(errors) for h, errors in result.horizons.items()}
        for horizon, overlapping in result.overlapping.items():
            entry["horizons"].setdefault(f"{horizon:g}", {})["overlapping"] = asdict(overlapping)
    if result.health is not None:
        entry["health"] = result.health.as_dict()
    if result.loads is not None:
        entry["wheel_loads"] = {"wheels": WHEELS, **asdict(result.loads)}
    return entry
