"""The result of a tuning, which prints, draws and saves itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from validation import store
from validation.bench.gains import dump_gains
from validation.report.result import Result
from validation.report.tables import Grid
from validation.tune.data import TuneData
from validation.tune.table import robots_dict, runs_dict, tune_grids, tune_notes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, kw_only=True)
class TuneResult(TuneData, Result):
    """Tuned gains, and how they follow references beside the gains of before; see `TuneData` for its fields."""

    program = "tune"

    def grids(self) -> Sequence[Grid]:
        """Return the gains within their bounds, and the tuned gains beside those of before on each reference."""
        return tune_grids(self)

    def notes(self) -> Sequence[str]:
        """Return what the tables do not say, sentence by sentence."""
        return tune_notes(self)

    def figure(self) -> Figure:
        """Return the tuning as one picture."""
        from validation.tune.figure import tune_figure

        return tune_figure(self)

    def save(self, folder: str | Path, *, recording: bool = False) -> list[Path]:
        """Write gains.toml, tune.png and, last, tune.json; return their paths.

        Raises:
            OSError: the folder cannot be made or written.
        """
        path = Path(folder) / "gains.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = dump_gains(self.gain_set)
        store.write_text(path, text)
        return [path, *super().save(folder, recording=recording)]

    def as_dict(self) -> dict[str, Any]:
        """Return what tune.json holds: null stands for every number that is not finite, as the cost of a lost reference."""
        document = {
            "schema": "ssmr.tune/1",
            "controller": self.controller,
            "source": self.source,
            **self.shared_dict(),
            "notes": list(self.notes()),
            "baseline": self.baseline_name,
            "baseline_cost": self.baseline_cost,
            "worse_than_start": self.worse_than_start,
            "shipped": self.shipped_name,
            "shipped_cost": self.shipped_cost,
            "gains": dict(self.gains),
            **robots_dict(self),
            "train": runs_dict(self.train),
            "held_out": runs_dict(self.held_out),
        }
        found: dict[str, Any] = store.plain(document)
        return found
