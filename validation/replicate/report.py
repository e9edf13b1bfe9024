"""A replication as a document of chapters, which is written as markdown or as one HTML page."""

from __future__ import annotations

import base64
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from markdown_it import MarkdownIt

from validation import store
from validation.replicate.evidence import Answer, Findings, Picture, ReplicationSettings, Section
from validation.replicate.keeping import picture_bytes
from validation.replicate.tables import Part, is_printed, parts_of
from validation.report.tables import Cell, Grid, markdown_table
from validation.thesis.verdicts import STATUSES, UNEXPLAINED, judge_rows, row_verdict, rules_in_words, short
from validation.words import markdown, one_line

_TITLE = "The thesis' results beside this project's"
_GENERATED = "Written by `python -m validation.replicate`, never by hand."


@dataclass(frozen=True)
class Chapter:
    """One section of a replication, as the report shows it."""

    key: str
    """Key of its section, and anchor of its heading."""
    title: str
    """Heading."""
    notes: tuple[str, ...] = ()
    """Sentences below the tables."""
    parts: tuple[Part, ...] = ()
    """Tables."""
    pictures: tuple[Picture, ...] = ()
    """Pictures, at the end."""


@dataclass(frozen=True)
class Document:
    """The whole report."""

    title: str
    """Heading of the report."""
    lead: tuple[str, ...]
    """Paragraphs before the chapters."""
    summary: Grid
    """Number of rows by section and verdict."""
    chapters: tuple[Chapter, ...]
    """Sections, in order."""
    foot: str
    """Duration and versions."""


def tally(findings: Findings) -> Counter[str]:
    """Return how many of the rows that the thesis prints have which verdict."""
    count: Counter[str] = Counter()
    for number, table in findings.tables.items():
        verdicts = judge_rows(number, table.rows)
        for row, pairs in table.rows.items():
            if is_printed(number, row, pairs):
                count[row_verdict(pairs, verdicts[row]).status] += 1
    return count


def unexplained(answers: Sequence[Answer]) -> list[str]:
    """Return the numbers that differ without a known reason, such as `Tab. 4.5 d_rms`."""
    out = []
    for answer in answers:
        for number, table in answer.findings.tables.items():
            several = len(table.rows) > 1
            for row, verdicts in judge_rows(number, table.rows).items():
                row_agrees = row_verdict(table.rows[row], verdicts).status == "agrees if"
                names = [short(m) for m, v in verdicts.items() if v.reason == UNEXPLAINED and not row_agrees]
                if names:
                    out.append(" ".join([f"Tab. {number}", *([row.replace("_", " ")] * several), ", ".join(names)]))
    return out


def document_of(answers: Sequence[Answer], settings: ReplicationSettings, left_out: Sequence[str] = ()) -> Document:
    """Return the report.

    Args:
        answers: findings of the sections.
        settings: settings that they ran with.
        left_out: titles of sections that were not asked for.
    """
    chapters = []
    for section, findings, _, _ in answers:
        parts = parts_of(section, findings)
        chapters.append(Chapter(section.key, _title(section), findings.notes, parts, findings.pictures))
    lead = [
        _GENERATED
        + (" It was made with `--quick`: fewer generations and seeds, so less can be concluded." if settings.quick else ""),
        "Every table of the thesis that reports a result, with what this project gets for it. The thesis' robot is not "
        "available. The MuJoCo Husky of profile thesis-lab takes its place, so our distances between simulation and "
        "robot are distances between two simulations.",
        f"Verdicts. {rules_in_words()} Reasons stand below each table, with the page of docs/ that shows them; "
        "a difference without a known reason is called unexplained.",
    ]
    if open_ := unexplained(answers):
        lead.append(f"Unexplained: {'; '.join(open_)}.")
    if left_out:
        lead.append(f"Left out (--only): {', '.join(left_out)}.")
    wall, cpu = (sum(getattr(a, name) for a in answers) for name in ("wall_s", "cpu_s"))
    versions = ", ".join(f"{k} {v}" for k, v in store.versions().items())
    foot = f"All sections together took {wall / 60:.1f} minutes, {cpu / 60:.1f} of processor time. Versions: {versions}."
    return Document(_TITLE, tuple(lead), _summary(answers), tuple(chapters), foot)


def _title(section: Section) -> str:
    tables = section.tables
    if not tables:
        return section.title
    numbers = [t if not t[0].isdigit() else f"Tab. {t}" for t in tables]
    return f"{section.title} ({numbers[0]}–{tables[-1]})" if len(tables) > 2 else f"{section.title} ({', '.join(numbers)})"


def _summary(answers: Sequence[Answer]) -> Grid:
    header = (("section", ""), *((status, "rows") for status in STATUSES))
    counts = {_title(a.section): tally(a.findings) for a in answers}
    counts = {title: count for title, count in counts.items() if count}
    total = sum(counts.values(), Counter[str]())
    groups = [
        tuple((Cell(title), *(Cell(str(count[s])) for s in STATUSES)) for title, count in part.items())
        for part in (counts, {"all": total})
    ]
    return Grid(header, tuple(groups), 1, _TITLE, "Number of rows that the thesis prints, by verdict.")


def document_markdown(document: Document, figures: str, docs: str | None = None) -> str:
    """Return the report as GitHub-flavoured markdown.

    Args:
        document: the report.
        figures: path of the pictures, as seen from the file.
        docs: path of the pages of docs/, as seen from the file, empty for the same folder; None to leave them unlinked.
    """
    lines = [f"# {markdown(document.title)}", ""]
    for paragraph in document.lead:
        lines += [markdown(paragraph), ""]
    lines += markdown_table(document.summary)
    for chapter in document.chapters:
        lines += ["", f"## {markdown(chapter.title)}", ""]
        for part in chapter.parts:
            lines += [f"**{markdown(part.caption)}**", "", *markdown_table(part.grid), ""]
            lines += [f"{k}. {markdown(text)}" for k, text in enumerate(part.reasons, 1)]
            lines += [""] * bool(part.reasons)
        lines += [f"- {markdown(note)}" for note in chapter.notes]
        for picture in chapter.pictures:
            lines += ["", f"![{markdown(picture.caption)}]({figures}{picture.file})"]
    lines += ["", markdown(document.foot)]
    text = "\n".join(lines) + "\n"
    return text if docs is None else linked(text, docs)


def linked(text: str, docs: str) -> str:
    """Return a text in which the pages of docs/ that it names are links."""
    return re.sub(r"(?<![\w/\[])(?<!\]\()docs/(\w+\.md)", lambda m: f"[{m[1]}]({docs}{m[1]})", text)


def document_html(document: Document, figures: Path) -> str:
    """Return the report's markdown as one HTML page that contains its pictures and styles, and loads nothing.

    Args:
        document: the report; its foreign texts stay text.
        figures: folder of its pictures.

    Raises:
        SsmrError: a picture is missing, or lies elsewhere.
    """
    parser = MarkdownIt("commonmark", {"html": False, "xhtmlOut": False}).enable("table")
    tokens = parser.parse(document_markdown(document, ""))
    inner = [child for token in tokens for child in token.children or ()]
    for picture in (token for token in inner if token.type == "image"):
        data = base64.b64encode(picture_bytes(figures, str(picture.attrs["src"]))).decode("ascii")
        picture.attrs["src"] = f"data:image/png;base64,{data}"
    headings = [token for token in tokens if token.type == "heading_open" and token.tag == "h2"]
    for heading, chapter in zip(headings, document.chapters, strict=True):
        heading.attrs["id"] = chapter.key
    links = "\n".join(f"- [{markdown(c.title)}](#{c.key})" for c in document.chapters)
    body = parser.renderer.render(tokens, parser.options, {})
    body = body.replace("<table>", '<div class="scroll"><table>').replace("</table>", "</table></div>")
    body = re.sub(r'(<img [^>]*alt="([^"]*)"[^>]*>)', r"\1<br><small>\2</small>", body)
    body = re.sub(rf"(<td[^>]*>)({'|'.join(STATUSES)})(?=</td>| \[|: )", _marked, body)
    page = files("validation.replicate").joinpath("templates/replicate.html").read_text(encoding="utf-8")
    return Template(page).substitute(title=escape(one_line(document.title)), chapters=parser.render(links), body=body)


def _marked(cell: re.Match[str]) -> str:
    return f'{cell[1]}<span class="{cell[2].replace(" ", "-")}">{cell[2]}</span>'
