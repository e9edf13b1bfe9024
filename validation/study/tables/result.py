"""The result of a tables study: its tables, its picture and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from validation.show.tables import NOTHING, Cell, Grid
from validation.study.result import StudyResult
from validation.study.tables.findings import TABLE_CAPTIONS, TABLE_METRICS, TableComparison, TableEntries

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ControlTables(TableEntries, StudyResult):
    """The thesis' tables of tracked references, printed beside what this project gets."""

    study = "tables"
    title = "Tables of tracked references"

    def grids(self) -> list[Grid]:
        """Return printed and own numbers by table, for both comparisons."""
        return [self._grid(comparison) for comparison in TABLE_CAPTIONS]

    def notes(self) -> list[str]:
        """Return what the numbers are means of."""
        return [f"Means over {self.seeds} seeds, profile {self.profile}; ± is the standard deviation over seeds."]

    def figure(self) -> Figure:
        """Return the picture of the study, drawn anew."""
        from validation.study.tables.figure import draw_tables

        return draw_tables(self)

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
