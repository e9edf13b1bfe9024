"""One result for every program: it prints, draws and saves itself."""

from __future__ import annotations

import base64
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from validation import output
from validation.output import Document, code_span, each_line, markdown_text, one_line, shorten_text
from validation.report.columns import column_legend
from validation.report.table import Table, draw_section, html_of, image_html, text_tables

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from validation.report.drawing import PanelRow


Writers = dict[str, Callable[[Path], object]]
"""Functions that write files at a path, by the name of the file."""
_log = logging.getLogger(__name__)
_LONGEST = 200
"""Greatest length of an error's text in a warning."""
FINISHED = "finished"
"""How a program ended: it did all its work."""
INTERRUPTED = "interrupted"
"""How a program ended: by Ctrl-C, with a part of its work."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Report:
    """Result of a program.

    Each program derives its own, with what it found as fields, and says by methods what its tables,
    notes, files and pictures are.
    """

    program: ClassVar[str]
    """Name of the program and of its files: `compare` for compare.json, compare.png and
    compare.rrd."""
    endings: ClassVar[Sequence[str]] = ("png",)
    """Files beside its JSON file: `png` for its picture, `md` for its text, `rrd` for its rerun
    recording."""
    title: str
    """Work of the program, in one line."""
    options: Document = field(default_factory=dict)
    """Options that it was made with, by name, as its text and its picture say them."""
    config: Document = field(default_factory=dict)
    """Program and options of the call, from which `--config` repeats it."""
    versions: Mapping[str, str] = field(default_factory=output.list_versions)
    """Versions of this project, Python and the packages that decide numbers."""
    status: str = FINISHED
    """`finished`, or `interrupted`: then it holds only the work before that."""
    failure: Exception | None = None
    """Failure although there is something to show, such as a lost robot: the program then fails
    after it saved."""

    shown: Sequence[Table] = ()
    """Tables, the most important one first."""
    about: Document = field(default_factory=dict)
    """Values that its JSON file has besides tables and notes."""
    panels: Sequence[PanelRow] = ()
    """Panels of its picture, row by row."""
    remarks: Sequence[str] = ()
    """Sentences on what was known before it, and on what its user has to know."""

    def tables(self) -> Sequence[Table]:
        """Return its tables, the most important one first; those without rows are not shown."""
        return self.shown

    def notes(self) -> list[str]:
        """Return the sentences below its tables; the first says that it was interrupted."""
        notes = [*map(one_line, self.remarks)]
        if self.status == INTERRUPTED:
            notes.insert(0, "It was interrupted; only what was finished before is here.")
        return notes

    def verdict(self) -> str:
        """Return what it found in one sentence or two, which stand before everything else."""
        return ""

    def document(self) -> Document:
        """Return what its JSON file has besides tables and notes: the schema and results."""
        return self.about

    def figure(self) -> Figure:
        """Return its picture, drawn anew.

        Raises:
            ValueError: it has none.
        """
        from validation.report.drawing import draw_page

        if "png" not in self.endings:
            raise ValueError(f"a report of {self.program} has no picture")
        return draw_page(self.title, self.panels, notes=self.notes(), foot=self.made_by)

    def record(self, path: Path) -> None:
        """Write its rerun recording, whole or not at all.

        Raises:
            OSError: the file cannot be written.
            RuntimeError: rerun is switched off by `RERUN=off`.
            ValueError: it has none.
        """
        raise ValueError(f"a report of {self.program} has no recording")

    def table(self, width: int = 110) -> str:
        """Return its tables and notes as text of at most `width` columns."""
        return text_tables(self.tables(), self.notes(), width, self.verdict())

    def frame(self, title: str | None = None) -> pandas.DataFrame:
        """Return a table, by default the first one, as a data frame of pandas, in SI units.

        Raises:
            ValueError: there is no such table.
        """
        import pandas

        tables = self.tables()
        for table in tables:
            if title in (None, table.title):
                return pandas.DataFrame(list(table.rows))
        titles = ", ".join(table.title for table in tables)
        raise ValueError(f"there is no table '{title}'; there are: {titles}")

    def to_markdown(self) -> str:
        """Return all of it as GitHub-flavoured markdown.

        That is its options and versions, tables, notes, and the meanings of the columns.
        """
        tables = [table for table in self.tables() if table.rows]
        lines = [f"# {markdown_text(self.title)}", ""]
        if verdict := self.verdict():
            lines += [f"**{markdown_text(verdict)}**", ""]
        for name, values in (("options", self.options), ("versions", self.versions)):
            given = [f"{one_line(k)} {_option_text(v)}" for k, v in values.items() if v is not None]
            lines.append(f"- {name}: {code_span(', '.join(given) or 'none')}")
        for table in tables:
            lines += ["", *draw_section(table)]
        if notes := self.notes():
            lines += ["", "## Notes", "", *(f"- {markdown_text(note)}" for note in notes)]
        keys = chain.from_iterable(table.keys for table in tables)
        if meanings := column_legend(dict.fromkeys(keys)):
            lines += ["", "## What the metrics mean", ""]
            lines += [f"- {meaning}" for meaning in meanings]
        return "\n".join(lines) + "\n"

    def __repr__(self) -> str:
        """Return what it is in a line."""
        return f"<{self.program}: {self.title}; table() and figure() show it>"

    def _repr_html_(self) -> str:
        return self._repr_mimebundle_()["text/html"]

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        """Return its text with its picture below, and the picture for what shows no HTML."""
        shown = {"text/html": html_of(self.to_markdown())}
        png = self._draw_png("the picture") if "png" in self.endings else None
        if png is not None:
            shown["image/png"] = base64.b64encode(png).decode()
            shown["text/html"] += image_html(png, self.title)
        return shown

    def files(self) -> Writers:
        """Return writers of the files beside its JSON file, by name."""
        writers = {"png": self._save_picture, "md": self._save_text, "rrd": self.record}
        return {f"{self.program}.{ending}": writers[ending] for ending in self.endings}

    def _save_text(self, path: Path) -> None:
        output.write_text(path, each_line(self.to_markdown()))

    def save_picture(self, path: str | Path, *, plain: bool = False) -> None:
        """Write its picture alone, whole or not at all, as a paper wants it.

        Args:
            path: the file; its ending says what it becomes: .png, .pdf or .svg.
            plain: whether its title, notes and foot are left out, and the rest is as wide as two
                columns of a journal, with letters of 7 points or more.

        Raises:
            OSError: the file cannot be written.
            ValueError: it has no picture, or the ending is another one.
        """
        from validation.report.picture import write_picture

        write_picture(self.figure(), Path(path), plain)

    def _save_picture(self, path: Path) -> None:
        png = self._draw_png(str(path))
        if png is None:
            path.unlink(missing_ok=True)  # an older one would show other numbers
        else:
            output.write_atomic(path, lambda beside: beside.write_bytes(png))

    def _draw_png(self, name: str) -> bytes | None:
        """Return its picture; None, with a warning, where numbers are beyond all measure."""
        from validation.report.picture import png_of

        try:
            return png_of(self.figure())
        except (ValueError, ArithmeticError, MemoryError) as error:
            why = shorten_text(error, _LONGEST)
            _log.warning("%s cannot be drawn (%s); the numbers are kept", name, why)
            return None

    def save(
        self, folder: str | Path, *, recording: bool = True, picture: bool = True
    ) -> list[Path]:
        """Write its JSON file, which names the files that follow, and then these.

        Each is written whole or not at all. The numbers are there before anything is drawn, and a
        program that was killed between two files knows that all are its own.

        Args:
            folder: where to; it is made if it is missing.
            recording: whether to write the rerun recording too.
            picture: whether to write its picture too.

        Returns:
            The paths of the written files.

        Raises:
            OSError: the folder cannot be made or written.
        """
        place = output.make_folder(Path(folder))
        writers = self.files()
        for ending, wanted in (("rrd", recording), ("png", picture)):
            if not wanted:
                writers.pop(f"{self.program}.{ending}", None)
        document = place / f"{self.program}.json"
        output.write_json(document, {**self.as_dict(), "files": list(writers)})
        # drawing may take long or fail; the numbers are safe by now
        for name, write in writers.items():
            output.return_memory()
            write(place / name)
        return [path for path in (document, *map(place.joinpath, writers)) if path.exists()]

    def as_dict(self) -> Document:
        """Return its JSON file without the names of the other files: plain values, no NaN."""
        document = {
            "tables": {table.title: list(table.rows) for table in self.tables() if table.rows},
            "status": self.status,
            "conclusion": self.verdict(),
            **self.document(),
            "notes": self.notes(),
            "options": self.options,
            "config": self.config,
            "versions": self.versions,
        }
        return dict(output.plain_value(document))

    @property
    def made_by(self) -> str:
        """Options and versions that it was made with, in one line for the footer of a picture."""
        words = []
        for name, value in self.options.items():
            if value not in (None, False, ()):
                words.append(f"{name} {_option_text(value)}")
        for name in ("ssmr-testbed", "mujoco"):
            if name in self.versions:
                words.append(f"{name} {self.versions[name]}")
        return " · ".join(words)


def _option_text(value: object) -> str:
    """Return an option as it is written; several values, such as horizons, are joined by commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ",".join(map(_option_text, value))
    return f"{value:g}" if isinstance(value, float) else one_line(value)
