"""One result for every program: it prints, draws and saves itself."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from validation import store
from validation.report.columns import legend
from validation.report.table import Grid, Table, markdown_table, text_tables
from validation.words import code_span, each_line, markdown, one_line, shortened

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


_log = logging.getLogger(__name__)
_LONGEST = 200  # greatest length of what a warning says of an error
FINISHED = "finished"
INTERRUPTED = "interrupted"
"""Ends that a program can have."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Report:
    """Result of a program. A program that gives more than this to Python derives from it and adds fields."""

    program: str
    """Name of the program and of its files: `compare` for compare.json, compare.png and
    compare.rrd."""
    title: str
    """One line that says what was done."""
    tables: Sequence[Table]
    """Tables, the most important one first."""
    document: Mapping[str, Any]
    """Part of the JSON file before its tables: the schema, options and results."""
    draw: Callable[[Any], Figure] | None = None
    """Function of the report that draws its picture; None where it has none."""
    sentences: Sequence[str] = ()
    """Sentences below the tables."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options that it was made with, by name."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Versions of this project, Python and the packages that decide numbers."""
    record: Callable[[Any, Path], object] | None = None
    """Function of the report and a path that writes its rerun recording; None where it has none."""
    status: str = FINISHED
    """`finished`, or `interrupted`: then it holds what was finished before, and no more."""
    failure: Exception | None = None
    """Failure although there is something to show, such as a lost robot: the program then fails
    after it saved."""
    alarms: Sequence[str] = ()
    """Sentences that the command line says on standard error, too."""
    has_text: bool = False
    """Whether the markdown text is one of the files."""

    def grids(self) -> Sequence[Grid]:
        """Return its tables as they are written; tables without rows are left out."""
        return [table.grid() for table in self.tables if table.rows]

    def notes(self) -> Sequence[str]:
        """Return the sentences that stand below its tables; the first says where it was interrupted."""
        early = (
            ["It was interrupted; only what was finished before is here."]
            if self.status == INTERRUPTED
            else []
        )
        return [*early, *self.sentences]

    def table(self, width: int = 110) -> str:
        """Return its tables and notes as text of at most `width` columns."""
        return text_tables(self.grids(), self.notes(), width)

    def frame(self, title: str | None = None) -> pandas.DataFrame:
        """Return the table of that title, by default the first one, as a data frame of pandas, in SI units.

        Raises:
            ImportError: pandas is not installed.
            ValueError: there is no such table.
        """
        import pandas

        for table in self.tables:
            if title in (None, table.title):
                return pandas.DataFrame(list(table.rows))
        raise ValueError(
            f"there is no table '{title}'; there are: {', '.join(table.title for table in self.tables)}"
        )

    def figure(self) -> Figure:
        """Return its picture, drawn anew.

        Raises:
            ValueError: it has none.
        """
        if self.draw is None:
            raise ValueError(f"a report of {self.program} has no picture")
        return self.draw(self)

    def markdown(self) -> str:
        """Return all of it as GitHub-flavoured markdown: how it was made, tables, notes, and what the columns mean."""
        lines = [f"# {markdown(self.title)}", ""]
        for name, values in (("options", self.options), ("versions", self.versions)):
            made = ", ".join(
                f"{one_line(k)} {option_text(v)}" for k, v in values.items() if v is not None
            )
            lines.append(f"- {name}: {code_span(made or 'none')}")
        for grid in self.grids():
            lines += ["", f"## {markdown(grid.title)}", "", *markdown_table(grid)]
            lines += ["", markdown(grid.caption)] if grid.caption else []
        lines += (
            ["", "## Notes", "", *(f"- {markdown(note)}" for note in self.notes())]
            if self.notes()
            else []
        )
        meanings = [
            f"- {line}"
            for line in legend(dict.fromkeys(key for table in self.tables for key in table.keys))
        ]
        return (
            "\n".join(
                [*lines, *(["", "## What the metrics mean", "", *meanings] if meanings else [])]
            )
            + "\n"
        )

    def files(self, recording: bool) -> dict[str, Callable[[Path], object]]:
        """Return functions that write the files beside its JSON file, by name: its picture, text and recording."""
        writers = dict[str, Callable[[Path], object]]()
        if self.draw is not None:
            writers[f"{self.program}.png"] = self._save_picture
        if self.has_text:
            writers[f"{self.program}.md"] = lambda path: store.write_text(
                path, each_line(self.markdown())
            )
        if recording and self.record is not None:
            writers[f"{self.program}.rrd"] = partial(self.record, self)
        return writers

    def _save_picture(self, path: Path) -> None:
        """Write its picture; a warning says that numbers beyond all measure cannot be drawn."""
        from validation.report.drawing import save_figure

        try:
            save_figure(self.figure(), path)
        except (ValueError, ArithmeticError, MemoryError) as error:  # which are in the other files
            path.unlink(missing_ok=True)  # an older one would show other numbers
            _log.warning(
                "%s cannot be drawn (%s); the numbers are written", path, shortened(error, _LONGEST)
            )

    def save(self, folder: str | Path, *, recording: bool = True) -> list[Path]:
        """Write its JSON file, which names the files that follow, and then these; each is written whole or not at all.

        The numbers are there before anything is drawn, and a program that was killed between two
        files knows that all are its own.

        Args:
            folder: where to; it is made if it is missing.
            recording: whether to write the rerun recording too.

        Returns:
            The paths of what was written.

        Raises:
            OSError: the folder cannot be made or written.
        """
        place = store.make_folder(Path(folder))
        writers = self.files(recording)
        document = place / f"{self.program}.json"
        store.write_json(document, {**self.as_dict(), "files": list(writers)})
        for name, write in writers.items():
            write(place / name)
        return [path for path in (document, *map(place.joinpath, writers)) if path.exists()]

    def as_dict(self) -> dict[str, Any]:
        """Return what its JSON file holds besides the names of the other files: plain values, no NaN."""
        tables = {table.title: list(table.rows) for table in self.tables if table.rows}
        made = {
            "notes": list(self.notes()),
            "options": dict(self.options),
            "versions": dict(self.versions),
        }
        return dict(store.plain({"tables": tables, "status": self.status, **self.document, **made}))

    @property
    def made_by(self) -> str:
        """Options and versions that it was made with, in one line for the footer of a picture."""
        used = [
            f"{name} {self.versions[name]}"
            for name in ("ssmr-testbed", "mujoco")
            if name in self.versions
        ]
        chosen = [
            f"{name} {option_text(value)}"
            for name, value in self.options.items()
            if value not in (None, False, ())
        ]
        return " · ".join([*chosen, *used])

    def _repr_markdown_(self) -> str:
        blocks = [
            "\n".join([f"**{markdown(grid.title)}**", "", *markdown_table(grid)])
            for grid in self.grids()
        ]
        return "\n\n".join([*blocks, *map(markdown, self.notes())])


def option_text(value: object) -> str:
    """Return an option as it is written; several values, such as horizons, are joined by commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ",".join(map(option_text, value))
    return f"{value:g}" if isinstance(value, float) else one_line(value)
