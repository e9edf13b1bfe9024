"""A replication as JSON, and as a document of chapters that is written as markdown or as one HTML page."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from validation import store
from validation.evidence import Effort, Findings, Picture, Section, Settings, Table
from validation.fit_report import number_text, unit_text
from validation.profiles import PLANTS
from validation.tables import NOTHING, Cell, Grid, Unit, markdown_table
from validation.verdicts import RULES, STATUSES, Pair, RowVerdict, Verdict, judge, of_row, short

SCHEMA = "ssmr.replicate/1"
TITLE = "The thesis' results beside this project's"
MILLIMETRES, RATIO = Unit("mm", 1e3, 1), Unit("", 1.0, 4)
GENERATED = "Written by `python -m validation.replicate`, never by hand."


@dataclass(frozen=True)
class Part:
    """A table with its caption and the reasons that its verdicts point to."""

    caption: str
    grid: Grid
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chapter:
    """What stands under a heading."""

    key: str
    """Of its section; its anchor."""
    title: str
    notes: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True)
class Document:
    """The whole report."""

    title: str
    lead: tuple[str, ...]
    """Paragraphs before the chapters."""
    summary: Grid
    """Verdicts by table of contents."""
    chapters: tuple[Chapter, ...]
    foot: str
    """How it was made."""


Found = Sequence[tuple[Section, Findings, Effort]]
"""What was found, in the order of the report."""


# ----------------------------------------------------------------------------------------------------------------- verdicts


def verdicts_of(number: str, table: Table) -> dict[str, dict[str, Verdict]]:
    """Of every number of a table, by row and metric."""
    return {row: {m: judge(number, row, m, pair) for m, pair in pairs.items()} for row, pairs in table.rows.items()}


def row_verdict(pairs: Mapping[str, Pair], verdicts: Mapping[str, Verdict]) -> RowVerdict:
    """Of a row: over what the thesis tells to be judged; where that is nothing, over what is lost; else over all."""
    printed = {m: v for m, v in verdicts.items() if is_told(pairs[m]) and pairs[m].rule != "none"}
    return of_row(printed or {m: v for m, v in verdicts.items() if v.see} or dict(verdicts))


def tally(findings: Findings) -> Counter[str]:
    """How many rows that the thesis prints have which verdict."""
    count: Counter[str] = Counter()
    for number, table in findings.tables.items():
        verdicts = verdicts_of(number, table)
        for row, pairs in table.rows.items():
            if is_printed(number, row, pairs):
                count[row_verdict(pairs, verdicts[row]).status] += 1
    return count


def is_told(pair: Pair) -> bool:
    """Whether the thesis has it, in numbers or in words."""
    return pair.published is not None or pair.rule == "at_least"


def is_printed(number: str, row: str, pairs: Mapping[str, Pair]) -> bool:
    """Whether the thesis has such a row, lost ones among them."""
    return any(is_told(p) or judge(number, row, m, p).see for m, p in pairs.items())


# --------------------------------------------------------------------------------------------------------------------- JSON


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


# -------------------------------------------------------------------------------------------------------------------- tables


class _Reasons:
    """Reasons of a part, numbered as they come up."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def number(self, verdict: Verdict) -> int:
        """Of the verdict's reason."""
        text = f"{verdict.reason[0].upper()}{verdict.reason[1:]}{f' (docs/{verdict.see})' if verdict.see else ''}."
        if text not in self.texts:
            self.texts.append(text)
        return self.texts.index(text) + 1

    def cell(self, verdict: RowVerdict) -> Cell:
        """The verdict's word and its reason, `differs [1]`; where numbers have different ones, `differs: d_rms [1], …`."""
        parts = [f"{', '.join(map(short, metrics))} [{self.number(v)}]".strip() for metrics, v in verdict.because]
        colon = ":" if any(metrics for metrics, _ in verdict.because) else ""
        return Cell(f"{verdict.status}{colon} {', '.join(parts)}".strip())


def _metric_text(metric: str, value: float | None, unit: str) -> str:
    """A number without its unit, a length in millimetres."""
    if value is None:
        return NOTHING
    if metric.endswith("ratio"):
        return RATIO.text(value)
    if unit == "m":
        return MILLIMETRES.text(value)
    decimals = {"%": 2, "s": 3}.get(unit)
    return number_text(value) if decimals is None else f"{value:.{decimals}f}"


def _printed_text(metric: str, pair: Pair) -> str:
    """What the thesis prints, or what its words are taken to mean."""
    if pair.rule == "at_least":
        return f"≥ {pair.beside['at_least']:g}"
    return _metric_text(metric, pair.published, pair.unit)


def _spread_text(metric: str, pair: Pair) -> str:
    """Ours with its spread."""
    own = _metric_text(metric, pair.ours, pair.unit)
    if pair.ours is None or pair.spread is None:
        return own
    return f"{own} ± {_metric_text(metric, pair.spread, pair.unit)}"


def wide_grid(tables: Mapping[str, Table]) -> tuple[Grid, tuple[str, ...]]:
    """Tables whose rows share their metrics: a row each, printed and ours side by side, and the verdict.

    Returns:
        The grid, and the reasons that its verdicts are numbered by.
    """
    metrics = list(dict.fromkeys(m for t in tables.values() for pairs in t.rows.values() for m in pairs))
    pairs_of = [pairs for t in tables.values() for pairs in t.rows.values()]
    shown = {m: next(p[m] for p in pairs_of if m in p) for m in metrics}
    printed = {m for m in metrics if any(m in p and is_told(p[m]) for p in pairs_of)}
    beside = {m: [n for n in ("mujoco",) if any(m in p and n in p[m].beside for p in pairs_of)] for m in metrics}
    several = len(tables) > 1
    header: list[tuple[str, str]] = [("Tab.", "")] * several + [("row", ""), ("verdict", "")]
    for m in metrics:
        unit = "mm" if shown[m].unit == "m" else unit_text(shown[m].unit)
        name = short(m).replace("_", " ") if m.endswith(("_s", "_percent")) else short(m)
        header += [(f"{name} printed", unit)] if m in printed else []
        header += [("ours" if m in printed else name, unit), *((n, unit) for n in beside[m])]
    reasons, groups = _Reasons(), []
    for number, table in tables.items():
        verdicts, rows = verdicts_of(number, table), []
        for row, pairs in table.rows.items():
            cells = [Cell(number)] * several + [Cell(row.replace("_", " ")), reasons.cell(row_verdict(pairs, verdicts[row]))]
            for m in metrics:
                pair = pairs.get(m, Pair(None, None, "none"))
                cells += [Cell(_printed_text(m, pair))] if m in printed else []
                cells.append(Cell(_spread_text(m, pair)))
                cells += [Cell(_metric_text(m, pair.beside.get(name), pair.unit)) for name in beside[m]]
            rows.append(tuple(cells))
        groups.append(tuple(rows))
    if all(len(group) == 1 for group in groups):
        groups = [tuple(row for group in groups for row in group)]
    return Grid(tuple(header), tuple(groups), left=2 + several), tuple(reasons.texts)


def tall_grid(table: Table, number: str, metric: str) -> tuple[Grid, tuple[str, ...]]:
    """A table of parameters or gains: one number a row, each in its own unit, with what stands beside it."""
    names = list(
        dict.fromkeys(n for pairs in table.rows.values() for n in pairs[metric].beside if n not in ("lower", "upper"))
    )
    others = list(dict.fromkeys(m for pairs in table.rows.values() for m in pairs if m != metric))
    searched = any("lower" in pairs[metric].beside for pairs in table.rows.values())
    header = [("row", ""), ("unit", ""), ("verdict", ""), ("printed", ""), ("ours", "")]
    header += (
        [("searched", "")] * searched + [(n.replace("_", " "), "") for n in names] + [(f"{m} printed", "") for m in others]
    )
    verdicts, reasons, rows = verdicts_of(number, table), _Reasons(), []
    for row, pairs in table.rows.items():
        pair = pairs[metric]
        cells = [Cell(row), Cell(pair.unit), reasons.cell(row_verdict(pairs, {metric: verdicts[row][metric]}))]
        cells += [Cell(NOTHING if pair.published is None else f"{pair.published:g}"), Cell(_with_error(pair))]
        if searched:
            known = "lower" in pair.beside
            cells.append(Cell(f"{pair.beside['lower']:g} to {pair.beside['upper']:g}" if known else NOTHING))
        cells += [Cell(number_text(pair.beside[n]) if n in pair.beside else NOTHING) for n in names]
        for m in others:
            value = pairs[m].published if m in pairs else None
            cells.append(Cell(NOTHING if value is None else f"{value:g}"))
        rows.append(tuple(cells))
    return Grid(tuple(header), (tuple(rows),), left=3), tuple(reasons.texts)


def _with_error(pair: Pair) -> str:
    """`0.523 ± 0.004`: the spread decides how many digits both have."""
    if pair.ours is None:
        return NOTHING
    if pair.spread is None or not pair.spread > 0.0:
        return number_text(pair.ours)
    decimals = max(0, 1 - math.floor(math.log10(pair.spread)))
    return f"{pair.ours:.{decimals}f} ± {pair.spread:.{decimals}f}"


WIDE: Mapping[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "tables": (
        ("PID, reference against simulated", tuple(f"4.{i}" for i in range(5, 13))),
        ("PID, simulated against real", tuple(f"4.{i}" for i in range(13, 20))),
        ("LQR, reference against simulated", tuple(f"4.{i}" for i in range(22, 30))),
        ("LQR, simulated against real", tuple(f"4.{i}" for i in range(30, 37))),
    ),
}
"""Tables of a section that are shown as one, by section."""


def parts_of(section: Section, findings: Findings) -> tuple[Part, ...]:
    """A section's tables as they are shown."""
    parts, done = [], set[str]()
    for caption, numbers in WIDE.get(section.key, ()):
        some = {n: findings.tables[n] for n in numbers if n in findings.tables}
        if some:
            parts.append(Part(f"Tab. {numbers[0]}–{numbers[-1]}. {caption}", *wide_grid(some)))
            done |= set(some)
    for number, table in findings.tables.items():
        if number not in done:
            where = f"Tab. {number}" if number[0].isdigit() else number
            parts.append(Part(f"{where}. {table.caption}", *_laid_out(number, table)))
    parts += [Part(caption, grid) for caption, grid in findings.grids.items()]
    return tuple(parts)


def _laid_out(number: str, table: Table) -> tuple[Grid, tuple[str, ...]]:
    """One table: tall where a metric's unit changes from row to row, a number a line where each row has its own metric."""
    units: dict[str, set[str]] = {}
    for pairs in table.rows.values():
        for metric, pair in pairs.items():
            units.setdefault(metric, set()).add(pair.unit)
    if any(len(u) > 1 for u in units.values()):
        return tall_grid(table, number, next(iter(units)))
    if len(units) > 1 and all(len(pairs) == 1 for pairs in table.rows.values()):
        return _mixed(table, number)
    return wide_grid({number: table})


def _mixed(table: Table, number: str) -> tuple[Grid, tuple[str, ...]]:
    """Rows with one number each, of different metrics."""
    header = (
        ("row", ""),
        ("what", ""),
        ("unit", ""),
        ("verdict", ""),
        ("printed", ""),
        ("ours", ""),
        ("printed over ours", ""),
    )
    reasons, rows = _Reasons(), []
    for row, pairs in table.rows.items():
        for m, pair in pairs.items():
            over = pair.beside.get("published_over_ours")
            rows.append(
                (
                    Cell(row),
                    Cell(short(m).replace("_", " ")),
                    Cell(pair.unit),
                    reasons.cell(of_row({m: judge(number, row, m, pair)})),
                    Cell(NOTHING if pair.published is None else f"{pair.published:g}"),
                    Cell(_with_error(pair)),
                    Cell(NOTHING if over is None else f"{over:.0f}"),
                )
            )
    return Grid(header, (tuple(rows),), left=4), tuple(reasons.texts)


# ----------------------------------------------------------------------------------------------------------------- document


def document_of(found: Found, settings: Settings, missing: Sequence[Section] = ()) -> Document:
    """The report.

    Args:
        found: what the sections found.
        settings: they ran with.
        missing: sections that were not asked for.
    """
    chapters = tuple(
        Chapter(section.key, _title(section), findings.notes, parts_of(section, findings), findings.pictures)
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
        "Verdicts. " + "; ".join(f"{text}" for text in RULES.values()).capitalize() + ". Where ours has a spread, "
        "distances and ratios within two standard deviations agree too, since what is printed is a single run. A row "
        "is judged by its worst number. Reasons stand below each table, with the page of docs/ that shows them; "
        "without a known reason a difference is called unexplained.",
    ]
    if missing:
        lead.append(f"Left out (--only): {', '.join(s.title for s in missing)}.")
    wall, cpu = (sum(getattr(e, name) for _, _, e in found) for name in ("wall_s", "cpu_s"))
    versions = ", ".join(f"{k} {v}" for k, v in store.versions().items())
    foot = f"All sections together took {wall / 60:.1f} minutes, {cpu / 60:.1f} of processor time. Versions: {versions}."
    return Document(TITLE, tuple(lead), _summary(found, total), chapters, foot)


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
