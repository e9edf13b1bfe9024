"""The result of a replication: its summary, its report as markdown and HTML, and replicate.json."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from os.path import realpath
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation import store
from validation.plants.profile import PLANTS
from validation.replicate.evidence import FIGURE_FOLDER, Answer, ReplicationSettings
from validation.replicate.keeping import picture_bytes
from validation.replicate.report import Document, document_html, document_markdown, document_of, tally
from validation.report.drawing import draw_section, inset, put_together, side_by_side, text_row
from validation.report.palette import VERDICT_INKS
from validation.report.result import Result
from validation.report.tables import Grid
from validation.thesis.verdicts import RULES, STATUSES, Pair, RowVerdict, Verdict, judge_rows, row_verdict

_SCHEMA = "ssmr.replicate/1"


@dataclass(frozen=True, eq=False)
class Replication(Result):
    """Every table of the thesis beside ours, with verdicts."""

    program = "replicate"
    settings: ReplicationSettings
    """Settings of the sections."""
    folder: Path
    """Folder in which the sections and their pictures are kept."""
    answers: tuple[Answer, ...]
    """Findings of the sections, in the order of the report."""
    left_out: tuple[str, ...] = ()
    """Titles of the sections that were not asked for."""

    @cached_property
    def document(self) -> Document:
        """The report in chapters."""
        return document_of(self.answers, self.settings, self.left_out)

    def grids(self) -> Sequence[Grid]:
        """Return how many rows of each section have which verdict."""
        return (self.document.summary,)

    def figure(self) -> Figure:
        """Return the number of rows by section and verdict, drawn anew."""
        summary = self.document.summary
        height = 0.8 + 0.3 * sum(map(len, summary.groups))
        heading = text_row(0.35, partial(draw_section, summary.title))
        return put_together([heading, side_by_side(height, [partial(_draw_bars, summary)])])

    def as_dict(self) -> dict[str, Any]:
        """Return what replicate.json holds."""
        tables: dict[str, Any] = {}
        for answer in self.answers:
            for number, table in answer.findings.tables.items():
                verdicts = judge_rows(number, table.rows)
                tables[number] = {
                    "caption": table.caption,
                    "rows": {
                        row: {m: _as_entry(p, verdicts[row][m]) for m, p in pairs.items()}
                        for row, pairs in table.rows.items()
                    },
                    "verdicts": {row: _as_words(row_verdict(pairs, verdicts[row])) for row, pairs in table.rows.items()},
                }
        counted = sum((tally(a.findings) for a in self.answers), Counter[str]())
        settings = vars(self.settings) | {"recording": bool(self.settings.recording)}
        document = {
            "schema": _SCHEMA,
            "quick": self.settings.quick,
            "settings": settings,
            "rules": dict(RULES),
            "versions": store.versions(),
            "tables": dict(sorted(tables.items(), key=lambda item: order_of(item[0]))),
            "verdicts": {s: counted[s] for s in STATUSES},
            "sections": {
                a.section.key: {"wall_s": a.wall_s, "cpu_s": a.cpu_s, "numbers": a.findings.numbers} for a in self.answers
            },
        }
        return dict(store.plain(document))

    def save(self, folder: str | Path, *, recording: bool = True) -> list[Path]:
        """Write replicate.html, replicate.md and, last, replicate.json; each is written whole or not at all.

        Args:
            folder: where to; the pictures are copied there too if they are kept elsewhere.
            recording: without effect, since a replication has no rerun recording.

        Raises:
            OSError: the folder cannot be made or written.
            SsmrError: a picture is missing.
        """
        place, figures = Path(folder), self.folder / FIGURE_FOLDER
        if realpath(place) != realpath(self.folder):
            self._copy_pictures(place / FIGURE_FOLDER, "")
        page, text, numbers = (place / f"replicate.{ending}" for ending in ("html", "md", "json"))
        store.write_text(page, document_html(self.document, figures))
        store.write_text(text, document_markdown(self.document, f"{FIGURE_FOLDER}/"))
        store.write_json(numbers, self.as_dict())
        return [page, text, numbers]

    def publish(self, path: Path) -> Path:
        """Write the report as a page of docs/, with its pictures as `img/NAME-*.png` beside it; return the page.

        Raises:
            OSError: the folder cannot be made or written.
            SsmrError: a picture is missing.
            ValueError: `path` does not end in .md.
        """
        require_markdown(path)
        self._copy_pictures(path.parent / "img", f"{path.stem}-")
        store.write_text(path, document_markdown(self.document, f"img/{path.stem}-", ""))
        return path

    def _copy_pictures(self, images: Path, prefix: str) -> None:
        images.mkdir(parents=True, exist_ok=True)
        for picture in (p for chapter in self.document.chapters for p in chapter.pictures):
            data = picture_bytes(self.folder / FIGURE_FOLDER, picture.file)
            store.write_atomic(images / f"{prefix}{picture.file}", partial(Path.write_bytes, data=data))


def _draw_bars(summary: Grid, ax: Axes) -> None:
    rows = [row for group in summary.groups for row in group]
    left = [0.0] * len(rows)
    for column, (status, _) in enumerate(summary.header[1:], 1):
        counts = [float(row[column].text) for row in rows]
        ax.barh(range(len(rows)), counts, left=left, color=VERDICT_INKS[status], label=status)
        left = [start + count for start, count in zip(left, counts, strict=True)]
    inset(ax, left=3.2)
    ax.set_yticks(range(len(rows)), [row[0].text for row in rows], fontsize=9.0)
    ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="rows that the thesis prints")
    ax.legend(loc="lower right", frameon=False)


def require_markdown(path: Path) -> None:
    """Refuse a page that is no markdown file.

    Raises:
        ValueError: the path does not end in .md.
    """
    if path.suffix != ".md":
        raise ValueError(f"docs {path} is no markdown file; name one such as docs/results.md")


def order_of(number: str) -> tuple[int, ...]:
    """Return a sort key that puts tables by number, and after them what has no number."""
    return tuple(map(int, number.split("."))) if re.fullmatch(r"\d+(\.\d+)*", number) else (99, *map(ord, number))


def _as_words(verdict: RowVerdict | Verdict) -> dict[str, str]:
    return {"verdict": verdict.status, "reason": verdict.reason, "see": verdict.see}


def _as_entry(pair: Pair, verdict: Verdict) -> dict[str, Any]:
    entry: dict[str, Any] = {"published": pair.published, "ours": pair.ours, "unit": pair.unit, "spread": pair.spread}
    entry |= {f"ours_{name}" if name in PLANTS else name: value for name, value in pair.beside.items()}
    if pair.supposed is not None:
        entry |= {"supposed": pair.supposed.value, "supposed_spread": pair.supposed.spread, "if": pair.supposed.text}
    return entry | _as_words(verdict)
