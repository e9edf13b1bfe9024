"""The result of a tables study: each table of tracked references, with the printed and our numbers.

Reference against simulated: the improved model with noise and disturbance, as in the thesis' simulations. Simulated against
real: the MuJoCo robot takes the place of the real robot, with the lab's noise and, as in the lab, without disturbance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from ssmr.parameters import require_within
from validation.plants.profile import Profile
from validation.show.tables import NOTHING, Cell, Grid
from validation.simulator.description import Robot
from validation.study.result import MOST_RUNS, StudyResult
from validation.thesis.verdicts import FACTOR

CONTROL_TABLES = tuple(f"4.{i}" for i in (*range(5, 20), *range(22, 37)))
"""Numbers of the tables of single references; 4.37 and 4.38 repeat them."""
TABLE_METRICS = ("d_rms_m", "d_haus_m", "d_ratio")
"""Metrics of each row. Reference against simulated: a d_rms of at most `FACTOR` times the printed one agrees."""
_KNOWN = ("line", "circle")
"""References whose geometry the thesis gives."""

TableComparison = Literal["reference_vs_simulated", "simulated_vs_real"]


@dataclass(frozen=True)
class TablesOptions:
    """Options of the study of tables."""

    profile: str | Profile | None = None
    """Robot of both plants: name of a shipped profile, or path of a TOML file."""
    seeds: int = 10
    """Number of draws of noise and disturbance for each row."""
    numbers: tuple[str, ...] = CONTROL_TABLES
    """Numbers of the tables to make."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for no seeds, or an unknown table."""
        require_within(self, ("seeds",), 1, MOST_RUNS, whole=True)
        unknown = [number for number in self.numbers if number not in CONTROL_TABLES]
        if unknown:
            raise ValueError(f"numbers {', '.join(unknown)} are no tables of tracked references; there are 4.5 to 4.36")


@dataclass(frozen=True)
class TableEntry:
    """The row of one table."""

    table: str
    """Number of the table."""
    comparison: TableComparison
    """Which motions are compared."""
    controller: str
    """`pid` or `lqr`."""
    gains: str
    """Name of the gain set."""
    reference: str
    """Name of the reference."""
    speed: float
    """Speed along the reference [m/s]."""
    printed: Mapping[str, float]
    """Printed numbers by metric; empty if the table is lost."""
    suspect: str
    """Reason why the print cannot be right; empty if there is none."""
    mean: Mapping[str, float]
    """Means by metric over the seeds that kept the reference; empty if none did."""
    deviation: Mapping[str, float]
    """Standard deviations by metric over the seeds that kept the reference."""
    lost: int
    """Number of seeds that lost the reference."""
    n: int
    """Number of seeds."""
    mujoco: Mapping[str, float]
    """Reference against simulated: means by metric of the MuJoCo robot, without disturbance; else empty."""

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        if not self.printed:
            return "print lost"
        if not self.mean:
            return "lost the reference"
        limit = self.printed["d_rms_m"] * (FACTOR if self.comparison == "reference_vs_simulated" else 1.0)
        if self.mean["d_rms_m"] <= limit:
            return "agrees"
        if self.suspect:
            return "print is suspect"
        return "differs" if self.reference in _KNOWN else "other geometry"


TABLE_CAPTIONS: Mapping[TableComparison, str] = {
    "reference_vs_simulated": "Reference against simulated: the improved model, with noise and disturbance",
    "simulated_vs_real": "Simulated against real: the improved model against the MuJoCo robot",
}
"""Titles by comparison."""


@dataclass(frozen=True)
class ControlTables(StudyResult):
    """The thesis' tables of tracked references, printed beside what this project gets."""

    study = "tables"
    title = "Tables of tracked references"
    profile: str
    """Name of the profile."""
    seeds: int
    """Number of draws of noise and disturbance for each row."""
    entries: tuple[TableEntry, ...]
    """Rows, in the order of the thesis."""

    def heading(self) -> str:
        """Return what was studied, in one line."""
        return f"{self.of_profile(self.profile)}, {self.seeds} seeds for each row"

    def grids(self) -> list[Grid]:
        """Return printed and own numbers by table, for both comparisons."""
        return [self._grid(comparison) for comparison in TABLE_CAPTIONS]

    def notes(self) -> list[str]:
        """Return what the numbers are means of."""
        return [f"Means over {self.seeds} seeds, {self.of_profile(self.profile)}; ± is the standard deviation over seeds."]

    def findings(self) -> dict[str, Any]:
        """Return printed and own numbers of each table, with verdicts."""
        return {
            "profile": self.profile,
            "seeds": self.seeds,
            "tables": {
                e.table: {
                    "comparison": e.comparison,
                    "controller": e.controller,
                    "gains": e.gains,
                    "reference": e.reference,
                    "speed_m_s": e.speed,
                    "verdict": e.verdict,
                    "note": e.suspect,
                    "lost": e.lost,
                    "printed": dict(e.printed),
                    "ours": dict(e.mean),
                    "deviation": dict(e.deviation),
                    "mujoco": dict(e.mujoco),
                }
                for e in self.entries
            },
        }

    def _grid(self, comparison: TableComparison) -> Grid:
        rows = []
        for e in self.entries:
            if e.comparison == comparison:
                texts = [e.table, e.controller, f"{e.reference} {e.speed:g}", e.verdict]
                for name in TABLE_METRICS:
                    spread = f" ± {1e3 * e.deviation['d_rms_m']:.1f}" if e.deviation and name == "d_rms_m" else ""
                    texts += [_text(e.printed, name), _text(e.mean, name) + spread]
                rows.append(tuple(map(Cell, texts)))
        header = (
            *(("Tab.", ""), ("law", ""), ("reference", ""), ("verdict", "")),
            *(("d_rms printed", "mm"), ("ours", "mm"), ("d_haus printed", "mm"), ("ours", "mm")),
            *(("d_ratio printed", ""), ("ours", "")),
        )
        return Grid(header, (tuple(rows),), 4, TABLE_CAPTIONS[comparison])


def _text(values: Mapping[str, float], name: str) -> str:
    if name not in values:
        return NOTHING
    return f"{values[name]:.4f}" if name == "d_ratio" else f"{1e3 * values[name]:.1f}"
