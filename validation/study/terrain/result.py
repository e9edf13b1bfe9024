"""The result of a terrain study: its tables, its picture and its files."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

from ssmr.types import FloatArray
from validation.report.tables import NOTHING, Cell, Grid
from validation.study.result import StudyResult
from validation.study.terrain.findings import (
    AXES,
    BASE,
    PLANAR,
    TRACKED,
    AxisName,
    LoadRun,
    ModelErrors,
    TerrainOptions,
    TrackerErrors,
)


@dataclass(frozen=True, eq=False)
class TerrainStudy(StudyResult):
    """The errors of planar models and trackers as speed, slope, roughness and loss of grip grow."""

    study = "terrain"
    title = "Terrain"
    profile: str
    """Name of the profile."""
    options: TerrainOptions
    """Options of the study."""
    models: tuple[ModelErrors, ...]
    """Errors of the planar models, by axis, value and plant."""
    trackers: tuple[TrackerErrors, ...]
    """Errors of the trackers, by axis, value and controller."""
    loads: tuple[LoadRun, ...]
    """Wheel loads of the manoeuvre on level ground and on a ramp."""
    static: FloatArray
    """(4,) static wheel loads (Eq. 2.17) [N]."""

    def line(self, axis: AxisName, plant: str) -> list[ModelErrors]:
        """Return a planar model's errors along an axis."""
        return [e for e in self.models if e.axis == axis and e.plant == plant]

    def doubled_at(self, axis: AxisName, plant: str) -> float | None:
        """Return the value at which a model's position error is twice that under the thesis' conditions [SI].

        It is interpolated linearly between the driven values; None where the error stays below that on the whole axis.
        """
        line = [e for e in self.line(axis, plant) if e.position_m is not None and e.value >= BASE[axis]]
        for before, after in itertools.pairwise(line):
            assert before.position_m is not None
            assert after.position_m is not None
            limit = 2.0 * float(line[0].position_m or 0.0)
            if after.position_m > limit:
                share = (limit - before.position_m) / (after.position_m - before.position_m)
                return before.value + max(share, 0.0) * (after.value - before.value)
        return None

    def heading(self) -> str:
        """Return what was driven, in one line."""
        return (
            f"{self.of_profile(self.profile)}; trajectories 1-4 without feedback, windows of {self.options.horizon:g} s; "
            f"reference {TRACKED} tracked"
        )

    def grids(self) -> list[Grid]:
        """Return errors along each axis, the values at which they double, and the errors of load formulas."""
        return [*(self._axis_grid(axis) for axis in AXES), self._doubled_grid(), self._load_grid()]

    def findings(self) -> dict[str, Any]:
        """Return settings, errors without and with feedback, doubling values and load errors."""
        o = self.options
        names = ("spread_N", "static_rms_N", "quasi_static_rms_N")
        return {
            "profile": self.profile,
            "settings": {**vars(o.axes), "seeds": o.seeds, "seed": o.seed, "horizon": o.horizon},
            "open_loop": [vars(e) for e in self.models],
            "doubled_at": {axis: {plant: self.doubled_at(axis, plant) for plant in PLANAR} for axis in AXES},
            "closed_loop": [vars(e) for e in self.trackers],
            "wheel_loads": {run.terrain.spec: dict(zip(names, run.errors(self.static), strict=True)) for run in self.loads},
        }

    def _axis_grid(self, axis: AxisName) -> Grid:
        """Return errors along an axis: of planar models after the horizon, and of trackers."""
        name, unit, scale = AXES[axis]
        header = [(axis if axis != "friction" else "lost", unit), *((plant, "mm") for plant in PLANAR)]
        header += [(f"{plant} yaw", "deg") for plant in PLANAR]
        header += [(f"{c} tracks", "mm") for c in self.options.axes.controllers]
        rows = []
        for value in self.options.axes.values(axis):
            errors = [e for plant in PLANAR for e in self.line(axis, plant) if e.value == value]
            if not errors:
                continue  # the study was interrupted before
            texts = [f"{scale * value:g}", *(_text(e.position_m, 1e3, 0) for e in errors)]
            texts += [_text(e.yaw_rad, 180.0 / math.pi, 1) for e in errors]
            texts += [
                _text(e.d_rms_m, 1e3, 0) + (f" ({e.lost} lost)" if e.lost else "")
                for e in self.trackers
                if (e.axis, e.value) == (axis, value)
            ]
            rows.append(tuple(map(Cell, texts)))
        title = f"Errors by {name}"
        if axis == next(iter(AXES)):
            title += f", {self.of_profile(self.profile)}"
        return Grid(tuple(header), (tuple(rows),), 1, title)

    def _doubled_grid(self) -> Grid:
        header = [("error doubled at", ""), *((axis, unit) for axis, (_, unit, _) in AXES.items())]
        rows = []
        for plant in PLANAR:
            found = [(axis, self.doubled_at(axis, plant)) for axis in AXES]
            cells = [NOTHING if at is None else f"{AXES[axis][2] * at:.2g}" for axis, at in found]
            rows.append((Cell(plant), *map(Cell, cells)))
        return Grid(tuple(header), (tuple(rows),), 1, "Values at which a planar model's position error has doubled")

    def _load_grid(self) -> Grid:
        rows = [
            (Cell(run.terrain.words), *(Cell(f"{newtons:.1f}") for newtons in run.errors(self.static))) for run in self.loads
        ]
        header = (("manoeuvre on", ""), ("about their mean", "N"), ("from static loads", "N"), ("from quasi-static", "N"))
        return Grid(header, (tuple(rows),), 1, "Wheel loads: rms of simulated loads about their mean and from two formulas")


def _text(value: float | None, scale: float, digits: int) -> str:
    return NOTHING if value is None else f"{scale * value:.{digits}f}"
