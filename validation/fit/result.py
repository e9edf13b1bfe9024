"""The result of a fit, which prints, draws and saves itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from validation.fit.data import FitData
from validation.fit.table import fit_grids, fit_notes
from validation.report.result import Result
from validation.report.tables import Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, kw_only=True)
class FitResult(FitData, Result):
    """A plant's fitted parameters, their uncertainty, and how well they predict motion; see `FitData` for its fields."""

    program = "fit"

    def grids(self) -> Sequence[Grid]:
        """Return the parameters, the scores on each source, and median errors by horizon where there are recordings."""
        return fit_grids(self)

    def notes(self) -> Sequence[str]:
        """Return what the tables do not say, sentence by sentence."""
        return fit_notes(self)

    def figure(self) -> Figure:
        """Return the fit as one picture."""
        from validation.fit.figure import fit_figure

        return fit_figure(self)

    def write_recording(self, path: Path) -> bool:
        """Write the fit as a rerun recording."""
        from validation.fit.rerun import write_fit_recording

        write_fit_recording(self, path)
        return True

    def save(self, folder: str | Path, *, recording: bool = False) -> list[Path]:
        """Write profile.toml, fit.png, fit.rrd if `recording` is true, and, last, fit.json; return their paths.

        Raises:
            OSError: the folder cannot be made or written.
        """
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        self.profile.save(place / "profile.toml")
        return [place / "profile.toml", *super().save(place, recording=recording)]
