"""The base of every program's result: it prints, draws and saves itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from validation import store
from validation.report.tables import Grid, each_line, markdown, markdown_table, text_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Result(ABC):
    """A finding of one program, with one way to show it on each medium.

    A room's result derives from this, is a frozen dataclass, and says what is in its tables, its picture and its file.
    """

    program: ClassVar[str]
    """Name of the files: `compare` for compare.json, compare.png and compare.rrd."""

    @abstractmethod
    def grids(self) -> Sequence[Grid]:
        """Return its tables, the most important one first."""

    @abstractmethod
    def figure(self) -> Figure:
        """Return its picture, drawn anew."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """Return what its JSON file holds: plain values, no NaN, with seed, options and versions."""

    def notes(self) -> Sequence[str]:
        """Return the sentences that stand below its tables."""
        return ()

    def report(self) -> Sequence[str]:
        """Return the lines of its markdown report; none where this kind of result has no report."""
        return ()

    def write_recording(self, path: Path) -> bool:
        """Write its rerun recording to `path`; return False where this kind of result has none."""
        return False

    def table(self, width: int = 110) -> str:
        """Return its tables and notes as text of at most `width` columns."""
        return text_tables(self.grids(), self.notes(), width)

    def save(self, folder: str | Path, *, recording: bool = True) -> list[Path]:
        """Write its picture, report, recording and, last, its JSON file; each is written whole or not at all.

        The JSON file is written even where one of the others cannot be made.

        Args:
            folder: where to; it is made if it is missing.
            recording: whether to write the rerun recording too.

        Returns:
            The paths of what was written.

        Raises:
            OSError: the folder cannot be made or written.
        """
        from validation.report.drawing import save_figure

        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        picture, text, film, document = (place / f"{self.program}.{ending}" for ending in ("png", "md", "rrd", "json"))
        try:
            save_figure(self.figure(), picture)
            written = [picture]
            if report := each_line("\n".join(self.report())):
                store.write_text(text, report)
                written.append(text)
            if recording and self.write_recording(film):
                written.append(film)
        finally:  # hours of work are not lost with a picture
            store.write_json(document, self.as_dict())
        return [*written, document]

    def _repr_markdown_(self) -> str:
        """Return its tables as a notebook shows them."""
        blocks = ["\n".join([f"**{markdown(grid.title)}**", "", *markdown_table(grid)]) for grid in self.grids()]
        return "\n\n".join([*blocks, *map(markdown, self.notes())])
