"""The result of a study of dead reckoning: its tables, its picture and its files."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from ssmr.types import FloatArray
from validation.bench.commissioning import TRACKER
from validation.report.tables import NOTHING, Cell, Grid
from validation.study.filter.doubt import Doubt
from validation.study.filter.findings import (
    DRIFT_STRETCH,
    FilterGround,
    FilterOptions,
    FilterVariant,
    GroundDrive,
    VariantDrift,
    filter_variants,
)
from validation.study.result import StudyResult


@dataclass(frozen=True, eq=False)
class FilterStudy(StudyResult):
    """Drift of dead reckoning by ground, reference and sensors."""

    study = "filter"
    title = "Dead reckoning"
    grounds: tuple[FilterGround, ...]
    """Robots on their grounds."""
    references: tuple[str, ...]
    """Names of the references."""
    speed: float
    """Speed of the references [m/s]."""
    options: FilterOptions
    """Options of the study."""
    drives: tuple[GroundDrive, ...]
    """Drives by reference, then by ground."""
    doubts: tuple[Doubt, ...] = ()
    """Errors of the pose beside what filters claim, by profile, plant and feedback."""

    def heading(self) -> str:
        """Return what was driven, in one line."""
        o = self.options
        return f"{', '.join(self.references)} at {self.speed:.3g} m/s, {o.seeds} seeds from {o.seed}"

    def grids(self) -> list[Grid]:
        """Return the drift of the position and of the yaw, a drive a row, a filter a column, and how sure filters may be."""
        return [
            self._drift_grid(
                "position",
                f"Position, {self.heading()}",
                f"Error of the relative position over stretches of {DRIFT_STRETCH:g} m, in percent of their length; "
                "mean and standard deviation over seeds.",
            ),
            self._drift_grid(
                "yaw",
                "Yaw",
                "Error of the relative yaw over the same stretches, in percent of what the robot turned in them. "
                f"The biased gyro shows {self.options.bias:+g} rad/s at rest.",
            ),
            *([self._doubt_grid()] if self.doubts else []),
        ]

    def findings(self) -> dict[str, Any]:
        """Return settings, grounds, filters and the drift of every drive."""
        o = self.options
        drives = [
            {
                "reference": d.reference,
                "surface": d.surface,
                "distance_m": d.distance,
                "turned_rad": d.turned,
                "slide_ratio": d.slide,
                "filters": {
                    name: {
                        "position_drift_ratio": {"mean": r.mean("position"), "std": r.std("position")},
                        "yaw_drift_ratio": {"mean": r.mean("yaw"), "std": r.std("yaw")},
                        "end_position_ratio": {"mean": r.mean("end"), "std": r.std("end")},
                        "end_yaw_rad": {"mean": r.mean("end_yaw"), "std": r.std("end_yaw")},
                        "error_m": r.errors.mean(axis=0).tolist(),
                    }
                    for name, r in d.filters.items()
                },
            }
            for d in self.drives
        ]
        grounds = {
            ground.name: {
                "profile": ground.profile.name,
                "robot": ground.profile.robot.name,
                "friction": ground.friction,
                "filter": asdict(ground.filter_settings(FilterVariant("wheels + gyro"))),
                "parameters": ground.profile.as_dict()["mujoco"],
            }
            for ground in self.grounds
        }
        return {
            "profile": ", ".join(dict.fromkeys(ground.profile.name for ground in self.grounds)),
            "references": list(self.references),
            "speed_m_s": self.speed,
            "seed": o.seed,
            "options": {"seeds": o.seeds, "bias": o.bias, "stands": o.stands, "timestep": o.timestep},
            "window_m": DRIFT_STRETCH,
            "tracker": TRACKER,
            "doubts": [
                {
                    **dict(zip(("profile", "plant", "feedback"), d.case, strict=True)),
                    "t": d.t.tolist(),
                    "band": list(d.band),
                    **{name: getattr(d, name).mean(axis=0).tolist() for name in ("nees", "thesis", "thesis_biased")},
                    "inside": d.inside,
                    "nis_inside": d.nis_share,
                    "filter": asdict(d.settings),
                }
                for d in self.doubts
            ],
            "variants": [asdict(v) for v in filter_variants(o.bias)],
            "drives": drives,
            "surfaces": grounds,
        }

    def _doubt_grid(self) -> Grid:
        """Return the table of normalised squared errors of the pose."""
        header = (
            ("profile", ""), ("plant", ""), ("feedback", ""), ("thesis", "NEES"), ("thesis, biased", "NEES"),
            ("commissioned", "NEES"), ("inside", ""), ("wheels' NIS inside", ""),
        )  # fmt: skip
        rows = [
            (
                *map(Cell, d.case),
                *(Cell(_range(e)) for e in (d.thesis, d.thesis_biased, d.nees)),
                Cell(f"{round(d.inside * len(d.t))} of {len(d.t)}"),
                Cell(f"{d.nis_share:.2f}"),
            )
            for d in self.doubts
        ]
        groups = tuple(tuple(r for r, d in zip(rows, self.doubts, strict=True) if d.case[0] == name) for name in
                       dict.fromkeys(d.case[0] for d in self.doubts))  # fmt: skip
        low, high = self.doubts[0].band
        caption = (
            f"Normalised squared error of the pose on a sine at 0.25 m/s, mean over {self.options.runs} robots, least to "
            f"greatest at {len(self.doubts[0].t)} instants. It should be 3; 95 % of such means lie between {low:.2f} and "
            f"{high:.2f}. The commissioned filter meets robots and gyros that differ from what it was told."
        )
        return Grid(header, groups, 3, "How sure the filter is", caption)

    def _drift_grid(self, name: str, title: str, caption: str) -> Grid:
        """Return the table of a field of `Drift` in percent."""
        header = (("reference", ""), ("surface", ""), *((v.name, "%") for v in filter_variants()))
        groups = [
            tuple(
                (Cell(d.reference), Cell(d.surface), *(Cell(_percent(r, name)) for r in d.filters.values()))
                for d in self.drives
                if d.reference == reference
            )
            for reference in self.references
        ]
        return Grid(header, tuple(groups), 2, title, caption)


def _range(found: FloatArray) -> str:
    """Return the least and the greatest mean over the rows."""
    mean = found.mean(axis=0)
    return "–".join(f"{m:.1f}" if m < 9.95 else f"{m:.0f}" for m in (mean.min(), mean.max()))


def _percent(drift: VariantDrift, name: str) -> str:
    mean, std = 100.0 * drift.mean(name), 100.0 * drift.std(name)
    return f"{mean:.2f} ± {std:.2f}" if math.isfinite(mean) else NOTHING
