"""A replication as JSON, and as a document of chapters that is written as markdown or as one HTML page."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from validation import store
from validation.plants.profile import PLANTS
from validation.replicate.evidence import Effort, Findings, Picture, Section, Settings
from validation.replicate.tables import REMARKS, Part, is_printed, parts_of, row_verdict, verdicts_of
from validation.show.tables import Cell, Grid, markdown_table
from validation.thesis.verdicts import RULES, STATUSES, UNEXPLAINED, Pair, RowVerdict, Verdict, short

SCHEMA = "ssmr.replicate/1"
TITLE = "The thesis' results beside this project's"
GENERATED = "Written by `python -m validation.replicate`, never by hand."


@dataclass(frozen=True)
class Chapter:
    """What stands under a heading."""

    key: str
    """Of its section; its anchor."""
    title: str
    """Its heading."""
    notes: tuple[str, ...] = ()
    """Sentences, below the tables."""
    parts: tuple[Part, ...] = ()
    """Its tables."""
    pictures: tuple[Picture, ...] = ()
    """In the end."""


@dataclass(frozen=True)
class Document:
    """The whole report."""

    title: str
    """Its name."""
    lead: tuple[str, ...]
    """Paragraphs before the chapters."""
    summary: Grid
    """Verdicts by table of contents."""
    chapters: tuple[Chapter, ...]
    foot: str
    """How it was made."""


Found = Sequence[tuple[Section, Findings, Effort]]
"""What was found, in the order of the report."""


def tally(findings: Findings) -> Counter[str]:
    """How many rows that the thesis prints have which verdict."""
    count: Counter[str] = Counter()
    for number, table in findings.tables.items():
        verdicts = verdicts_of(number, table)
        for row, pairs in table.rows.items():
            if is_printed(number, row, pairs):
                count[row_verdict(pairs, verdicts[row]).status] += 1
    return count


# --------------------------------------------------------------------------------------------------------------------- JSON


def unexplained(found: Found) -> list[str]:
    """Numbers that differ without a known reason: `Tab. 4.5 d_rms`."""
    out = []
    for _, findings, _ in found:
        for number, table in findings.tables.items():
            several = len(table.rows) > 1
            for row, verdicts in verdicts_of(number, table).items():
                names = [short(m) for m, v in verdicts.items() if v.reason == UNEXPLAINED]
                if names:
                    out.append(" ".join([f"Tab. {number}", *([row.replace("_", " ")] * several), ", ".join(names)]))
    return out


def as_json(found: Found, settings: Settings) -> dict[str, Any]:
    """replicate.json."""
    tables: dict[str, Any] = {}
    for _, findings, _ in found:
        for number, table in findings.tables.items():
            verdicts = verdicts_of(number, table)
            tables[number] = {
                "caption": table.caption,
                "rows": {
                    row: {m: _entry(p, verdicts[row][m]) for m, p in pairs.items()} for row, pairs in table.rows.items()
                },
                "verdicts": {row: _as_words(row_verdict(pairs, verdicts[row])) for row, pairs in table.rows.items()},
            }
    document = {
        "schema": SCHEMA,
        "quick": settings.quick,
        "settings": {k: v for k, v in vars(settings).items() if k != "recording"} | {"recording": bool(settings.recording)},
        "rules": dict(RULES),
        "versions": store.versions(),
        "tables": dict(sorted(tables.items(), key=lambda item: order_of(item[0]))),
        "verdicts": {s: sum(tally(f)[s] for _, f, _ in found) for s in STATUSES},
        "sections": {section.key: {**vars(effort), "numbers": findings.numbers} for section, findings, effort in found},
    }
    plain = store.plain(document)
    assert isinstance(plain, dict)
    return plain


def _as_words(verdict: RowVerdict) -> dict[str, str]:
    return {"verdict": verdict.status, "reason": verdict.reason, "see": verdict.see}


def order_of(number: str) -> tuple[int, ...]:
    """Tables by number, what has none after them."""
    parts = number.split(".")
    return tuple(map(int, parts)) if all(p.isdigit() for p in parts) else (99, *map(ord, number))


def _entry(pair: Pair, verdict: Verdict) -> dict[str, Any]:
    entry: dict[str, Any] = {"published": pair.published, "ours": pair.ours, "unit": pair.unit, "spread": pair.spread}
    entry |= {f"ours_{name}" if name in PLANTS else name: value for name, value in pair.beside.items()}
    return entry | {"verdict": verdict.status, "reason": verdict.reason, "see": verdict.see}


# ----------------------------------------------------------------------------------------------------------------- document


def document_of(found: Found, settings: Settings, missing: Sequence[Section] = ()) -> Document:
    """The report.

    Args:
        found: what the sections found.
        settings: they ran with.
        missing: sections that were not asked for.
    """
    chapters = tuple(
        Chapter(section.key, _title(section), _notes(section, findings), parts_of(section, findings), findings.pictures)
        for section, findings, _ in found
    )
    total = Counter[str]()
    for _, findings, _ in found:
        total += tally(findings)
    lead = [
        GENERATED
        + (" With `--quick`: searches and seeds are reduced, and so is what can be said." if settings.quick else ""),
        "Every table of the thesis that reports a result, with what this project gets for it. The thesis' robot is not "
        "at hand: where it stood stands the MuJoCo Husky of profile thesis-lab, so distances between simulation and "
        "reality are those of another reality.",
        "Verdicts. " + "; ".join(RULES.values()).capitalize() + ". Where ours has a spread, "
        "distances and ratios within two standard deviations agree too, since what is printed is a single run. A row "
        "is judged by its worst number. Reasons stand below each table, with the page of docs/ that shows them; "
        "without a known reason a difference is called unexplained.",
    ]
    open_ = unexplained(found)
    if open_:
        lead.append(f"Unexplained: {'; '.join(open_)}.")
    if missing:
        lead.append(f"Left out (--only): {', '.join(s.title for s in missing)}.")
    wall, cpu = (sum(getattr(e, name) for _, _, e in found) for name in ("wall_s", "cpu_s"))
    versions = ", ".join(f"{k} {v}" for k, v in store.versions().items())
    foot = f"All sections together took {wall / 60:.1f} minutes, {cpu / 60:.1f} of processor time. Versions: {versions}."
    return Document(TITLE, tuple(lead), _summary(found, total), chapters, foot)


def _notes(section: Section, findings: Findings) -> tuple[str, ...]:
    remark = REMARKS.get(section.key)
    return findings.notes if remark is None else (*findings.notes, remark)


def _title(section: Section) -> str:
    tables = section.tables
    if not tables:
        return section.title
    numbers = [t if not t[0].isdigit() else f"Tab. {t}" for t in tables]
    return f"{section.title} ({numbers[0]}–{tables[-1]})" if len(tables) > 2 else f"{section.title} ({', '.join(numbers)})"


def _summary(found: Found, total: Counter[str]) -> Grid:
    header = (("section", ""), *((status, "rows") for status in STATUSES))
    rows = [
        (Cell(_title(section)), *(Cell(str(count[s])) for s in STATUSES))
        for section, findings, _ in found
        if (count := tally(findings))
    ]
    return Grid(header, (tuple(rows), ((Cell("all"), *(Cell(str(total[s])) for s in STATUSES)),)), left=1)


def markdown(document: Document, figures: str, docs: str | None = None) -> str:
    """The report as GitHub-flavoured markdown.

    Args:
        document: the report.
        figures: where pictures lie, as seen from the file.
        docs: where the pages of docs/ lie, as seen from the file, empty for beside it; None if they are not to be linked.
    """
    lines = [f"# {document.title}", ""]
    for paragraph in document.lead:
        lines += [paragraph, ""]
    lines += markdown_table(document.summary)
    for chapter in document.chapters:
        lines += ["", f"## {chapter.title}", ""]
        for part in chapter.parts:
            lines += [f"**{part.caption}**", "", *markdown_table(part.grid), ""]
            lines += [f"{k}. {text}" for k, text in enumerate(part.reasons, 1)]
            lines += [""] * bool(part.reasons)
        lines += [f"- {note}" for note in chapter.notes]
        for picture in chapter.pictures:
            lines += ["", f"![{picture.caption}]({figures}{picture.file})"]
    lines += ["", document.foot]
    text = "\n".join(lines) + "\n"
    return text if docs is None else linked(text, docs)


def linked(text: str, docs: str) -> str:
    """The text with the pages of docs/ that it names as links."""
    return re.sub(r"(?<![\w/\[])(?<!\]\()docs/(\w+\.md)", lambda m: f"[{m[1]}]({docs}{m[1]})", text)
