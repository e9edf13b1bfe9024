"""One result for every program: it prints, draws and saves itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from validation import store
from validation.progress import Report as Progressing
from validation.progress import silent
from validation.report.columns import legend
from validation.report.result import Result
from validation.report.table import Table
from validation.report.tables import Grid, option_text, report_markdown

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from validation.report.tracks import Track

FINISHED, INTERRUPTED = "finished", "interrupted"
"""How a program can end."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Report(Result):
    """What a program found. A program that gives more than this to Python derives from it and adds fields."""

    program: str  # type: ignore[misc]  # a class variable of results that are no reports yet
    """Name of the program and of its files: `compare` for compare.json, compare.png and compare.rrd."""
    title: str
    """What was done, in one line."""
    tables: Sequence[Table]
    """Tables, the most important one first."""
    document: Mapping[str, Any]
    """What the JSON file holds before its tables: the schema, and what was asked for and found."""
    draw: Callable[[Any], Figure] | None = None
    """Function of the report that draws its picture; None where it has none."""
    sentences: Sequence[str] = ()
    """Sentences below the tables."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """How it was made, by name."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Versions of this project, Python and the packages that decide numbers."""
    record: Callable[[Any, Path], object] | None = None
    """Function of the report and a path that writes its rerun recording; None where it has none."""
    tracks: Callable[[Any], Sequence[Track]] | None = None
    """Function of the report that gives its robots in motion, for a video; None where there are none."""
    status: str = FINISHED
    """`finished`, or `interrupted`: then it holds what was finished before, and no more."""
    failure: Exception | None = None
    """What went wrong although there is something to show, such as a lost robot: the program then fails after it saved."""
    alarms: Sequence[str] = ()
    """Sentences that the command line says on standard error, too."""
    has_text: bool = False
    """Whether the markdown text is one of the files."""

    def grids(self) -> Sequence[Grid]:
        """Return its tables as they are written; tables without rows are left out."""
        return [table.grid() for table in self.tables if table.rows]

    def notes(self) -> Sequence[str]:
        """Return the sentences that stand below its tables; the first says where it was interrupted."""
        early = ["It was interrupted; only what was finished before is here."] if self.status == INTERRUPTED else []
        return [*early, *self.sentences]

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
        raise ValueError(f"there is no table '{title}'; there are: {', '.join(table.title for table in self.tables)}")

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
        made = {name: value for name, value in self.options.items() if value is not None}
        facts = {"options": made, "versions": self.versions}
        keys = dict.fromkeys(key for table in self.tables for key in table.keys)
        return report_markdown(self.title, facts, self.grids(), self.notes(), [f"- {line}" for line in legend(keys)])

    def report(self) -> Sequence[str]:
        """Return the lines of its markdown file; none where it writes none."""
        return self.markdown().splitlines() if self.has_text else ()

    def write_recording(self, path: Path) -> bool:
        """Write its rerun recording to `path`; return False where it has none."""
        if self.record is None:
            return False
        self.record(self, path)
        return True

    def write_video(self, path: Path, progress: Progressing = silent) -> None:
        """Write its robots in motion as a video, see `validation.report.video.write_video`.

        Raises:
            ValueError: nothing of it moves.
        """
        from validation.report.video import write_video

        if self.tracks is None:
            raise ValueError(f"nothing moves in a report of {self.program}")
        write_video(self.tracks(self), path, self.title, progress)

    def as_dict(self) -> dict[str, Any]:
        """Return what its JSON file holds: plain values, no NaN."""
        tables = {table.title: list(table.rows) for table in self.tables if table.rows}
        whole = {
            **self.document,
            "notes": list(self.notes()),
            "options": dict(self.options),
            "versions": dict(self.versions),
        }
        return dict(store.plain({"tables": tables, "status": self.status, **whole}))

    @property
    def made_by(self) -> str:
        """How it was made, in one line for the footer of a picture."""
        used = [f"{name} {self.versions[name]}" for name in ("ssmr-testbed", "mujoco") if name in self.versions]
        chosen = [f"{name} {option_text(value)}" for name, value in self.options.items() if value not in (None, False, ())]
        return " · ".join([*chosen, *used])
