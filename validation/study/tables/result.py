"""The result of a tables study: each table of tracked references, with the printed and our numbers.

Reference against simulated: the improved model with noise and disturbance, as in the thesis' simulations. Simulated against
real: the MuJoCo robot takes the place of the real robot, with the lab's noise and, as in the lab, without disturbance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ssmr.parameters import require_within
from validation.plants.profile import Profile
from validation.show.tables import NOTHING, Cell, Grid
from validation.simulator.description import Robot
from validation.study.result import MOST_RUNS, StudyResult
from validation.thesis.verdicts import RULE_OF, Pair, RowVerdict, Supposed, judge_rows, row_verdict, rules_in_words, short

CONTROL_TABLES = tuple(f"4.{i}" for i in (*range(5, 20), *range(22, 37)))
"""Numbers of the tables of single references; 4.37 and 4.38 repeat them."""
TABLE_METRICS = tuple(RULE_OF)
"""Metrics of each row."""
ALL_LOST = "every seed lost the reference"
"""Reason why a row without any number of ours cannot be compared."""

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
    supposed: Mapping[str, Supposed] = field(default_factory=dict)
    """Numbers by metric under the supposition for this table, see `SUPPOSITIONS`; empty if there is none."""

    @property
    def row(self) -> str:
        """Name of the row, as the thesis' tables of several references call it."""
        return f"{self.reference}_{self.speed:.2f}"

    @property
    def pairs(self) -> Mapping[str, Pair]:
        """Printed and own numbers by metric, ready to be judged."""
        return {
            metric: Pair(
                self.printed.get(metric),
                self.mean.get(metric),
                rule,
                "m" if metric.endswith("_m") else "1",
                self.deviation.get(metric) if self.n > 1 else None,
                {"mujoco": self.mujoco[metric]} if metric in self.mujoco else {},
                "" if self.mean else ALL_LOST,
                self.supposed.get(metric),
            )
            for metric, rule in RULE_OF.items()
        }

    @property
    def verdict(self) -> RowVerdict:
        """Verdict on the row, by the rules that a replication has too."""
        return row_verdict(self.pairs, judge_rows(self.table, {self.row: self.pairs})[self.row])


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
        """Return what the numbers are means of, the rules, and why rows do not agree."""
        means = f"Means over {self.seeds} seeds, {self.of_profile(self.profile)}; ± is the standard deviation over seeds."
        because = dict[str, list[str]]()
        for e in self.entries:
            if e.verdict.reason:
                because.setdefault(e.verdict.reason, []).append(e.table)
        return [means, f"Verdicts. {rules_in_words()}", *(f"{', '.join(t)}: {reason}." for reason, t in because.items())]

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
                    "verdict": e.verdict.status,
                    "reason": e.verdict.reason,
                    "see": e.verdict.see,
                    "lost": e.lost,
                    "printed": dict(e.printed),
                    "ours": dict(e.mean),
                    "deviation": dict(e.deviation),
                    "mujoco": dict(e.mujoco),
                    "supposed": {m: {"value": v.value, "deviation": v.spread} for m, v in e.supposed.items()},
                }
                for e in self.entries
            },
        }

    def _grid(self, comparison: TableComparison) -> Grid:
        rows = []
        for e in self.entries:
            if e.comparison == comparison:
                about = [short(m) for m in TABLE_METRICS if any(m in metrics for metrics, _ in e.verdict.because)]
                verdict = e.verdict.status + (f": {', '.join(about)}" if about else "")
                texts = [e.table, e.controller, f"{e.reference} {e.speed:g}", verdict]
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
