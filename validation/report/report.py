"""One result for every program: it prints, draws and saves itself."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
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
_LONGEST = 200
"""Greatest length of an error's text in a warning."""
FINISHED = "finished"
"""How a program ended: it did all its work."""
INTERRUPTED = "interrupted"
"""How a program ended: by Ctrl-C, with a part of its work."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Report:
    """Result of a program.

    A program that gives more than this to Python derives from it and adds fields.
    """

    program: str
    """Name of the program and of its files: `compare` for compare.json, compare.png and
    compare.rrd."""
    title: str
    """Work of the program, in one line."""
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
    """`finished`, or `interrupted`: then it holds only the work before that."""
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
        """Return the sentences below its tables; the first says that it was interrupted."""
        notes = list(self.sentences)
        if self.status == INTERRUPTED:
            notes.insert(0, "It was interrupted; only what was finished before is here.")
        return notes

    def table(self, width: int = 110) -> str:
        """Return its tables and notes as text of at most `width` columns."""
        return text_tables(self.grids(), self.notes(), width)

    def frame(self, title: str | None = None) -> pandas.DataFrame:
        """Return a table, by default the first one, as a data frame of pandas, in SI units.

        Raises:
            ImportError: pandas is not installed.
            ValueError: there is no such table.
        """
        import pandas

        for table in self.tables:
            if title in (None, table.title):
                return pandas.DataFrame(list(table.rows))
        titles = ", ".join(table.title for table in self.tables)
        raise ValueError(f"there is no table '{title}'; there are: {titles}")

    def figure(self) -> Figure:
        """Return its picture, drawn anew.

        Raises:
            ValueError: it has none.
        """
        if self.draw is None:
            raise ValueError(f"a report of {self.program} has no picture")
        return self.draw(self)

    def markdown(self) -> str:
        """Return all of it as GitHub-flavoured markdown.

        That is its options and versions, tables, notes, and the meanings of the columns.
        """
        lines = [f"# {markdown(self.title)}", ""]
        for name, values in (("options", self.options), ("versions", self.versions)):
            given = [f"{one_line(k)} {option_text(v)}" for k, v in values.items() if v is not None]
            lines.append(f"- {name}: {code_span(', '.join(given) or 'none')}")
        for grid in self.grids():
            lines += ["", f"## {markdown(grid.title)}", "", *markdown_table(grid)]
            if grid.caption:
                lines += ["", markdown(grid.caption)]
        if notes := self.notes():
            lines += ["", "## Notes", "", *(f"- {markdown(note)}" for note in notes)]
        keys = chain.from_iterable(table.keys for table in self.tables)
        if meanings := legend(dict.fromkeys(keys)):
            lines += ["", "## What the metrics mean", ""]
            lines += [f"- {meaning}" for meaning in meanings]
        return "\n".join(lines) + "\n"

    def files(self, recording: bool) -> dict[str, Callable[[Path], object]]:
        """Return writers of the files beside its JSON file, by name.

        These are its picture, text and recording.
        """
        writers: dict[str, Callable[[Path], object]] = {}
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
        """Write its JSON file, which names the files that follow, and then these.

        Each is written whole or not at all. The numbers are there before anything is drawn, and a
        program that was killed between two files knows that all are its own.

        Args:
            folder: where to; it is made if it is missing.
            recording: whether to write the rerun recording too.

        Returns:
            The paths of the written files.

        Raises:
            OSError: the folder cannot be made or written.
        """
        place = store.make_folder(Path(folder))
        writers = self.files(recording)
        document = place / f"{self.program}.json"
        store.write_json(document, {**self.as_dict(), "files": list(writers)})
        # drawing may take long or fail; the numbers are safe by now
        for name, write in writers.items():
            write(place / name)
        return [path for path in (document, *map(place.joinpath, writers)) if path.exists()]

    def as_dict(self) -> dict[str, Any]:
        """Return its JSON file without the names of the other files: plain values, no NaN."""
        document = {
            "tables": {table.title: list(table.rows) for table in self.tables if table.rows},
            "status": self.status,
            **self.document,
            "notes": self.notes(),
            "options": self.options,
            "versions": self.versions,
        }
        return dict(store.plain(document))

    @property
    def made_by(self) -> str:
        """Options and versions that it was made with, in one line for the footer of a picture."""
        words = []
        for name, value in self.options.items():
            if value not in (None, False, ()):
                words.append(f"{name} {option_text(value)}")
        for name in ("ssmr-testbed", "mujoco"):
            if name in self.versions:
                words.append(f"{name} {self.versions[name]}")
        return " · ".join(words)

    def _repr_markdown_(self) -> str:
        blocks = []
        for grid in self.grids():
            lines = [f"**{markdown(grid.title)}**", "", *markdown_table(grid)]
            blocks.append("\n".join(lines))
        return "\n\n".join([*blocks, *map(markdown, self.notes())])


def option_text(value: object) -> str:
    """Return an option as it is written; several values, such as horizons, are joined by commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ",".join(map(option_text, value))
    return f"{value:g}" if isinstance(value, float) else one_line(value)
