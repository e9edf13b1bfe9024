"""The chapters of a replication: tables, and sentences, which stand in `templates/*.md` with places for numbers.

A template begins with the chapter's title, `# TITLE`, and a line `## NUMBER: CAPTION` for each table; `4.5–4.12` shows
several tables of the thesis as one. The rest are sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, NamedTuple

from validation.progress import Progressing
from validation.report.columns import Unit, ending_of
from validation.report.drawing import PanelRow
from validation.report.table import Row, Table, markdown_table
from validation.thesis.verdicts import Pair, Rows, Verdict, criterion_of, judge, judge_row
from validation.words import markdown


class Budget(NamedTuple):
    """Amount of searching and repeating."""

    fit: tuple[int, int] = (50, 300)
    """Candidates and greatest number of generations of a fit (Tab. 3.7, 3.10, 3.13)."""
    tune: tuple[int, int] | None = None
    """The same of a tuning; None for those of Tab. 4.3 and 4.20."""
    searches: int = 3
    """Searches for each controller's gains."""
    draws: int = 10
    """Draws of noise and disturbance for each row."""
    starts: int = 16
    """Starts of each run in ODE."""


QUICK = Budget((20, 25), (20, 12), 1, 2, 1)
"""Reduced budgets, which take under three minutes."""


class Task(NamedTuple):
    """Inputs of a section."""

    budget: Budget
    """Amount of computing that it may do."""
    seed: int
    """First seed of its searches."""
    workers: int | None
    """Number of threads, None for all processors; no result depends on it."""
    progress: Progressing
    """Callback for its progress."""


@dataclass(frozen=True, eq=False)
class Findings:
    """Results of a section."""

    tables: Mapping[str, Rows]
    """Tables by their number in the thesis, or by its section or figure where it has no table."""
    words: Mapping[str, Any] = field(default_factory=dict)
    """Numbers and words for the places in the chapter's template."""
    more: Sequence[Table] = ()
    """Tables without a counterpart in the thesis."""
    panels: Sequence[PanelRow] = ()
    """Rows of the picture."""


class Section(NamedTuple):
    """A part of the replication that runs by itself and answers for some tables of the thesis."""

    key: str
    """Name on the command line, which begins with that of its template."""
    tables: Sequence[str]
    """Numbers of its tables."""
    run: Callable[[Task], Findings]
    """Function that finds them."""


def chosen_sections(sections: Sequence[Section], names: Sequence[str]) -> list[Section]:
    """Return the sections with these keys or tables, in their own order, all without any; a ValueError lists the keys."""
    for name in names:
        if not any(name == s.key or name in s.tables for s in sections):
            known = ", ".join(s.key for s in sections)
            raise ValueError(f"'{name}' in only is no section ({known}) and no table of one of them, such as 3.9")
    return [s for s in sections if not names or s.key in names or any(t in names for t in s.tables)]


def template(name: str) -> str:
    """Return the text of a template, whose places wait for numbers."""
    return resources.files("validation.replicate").joinpath(f"templates/{name}.md").read_text(encoding="utf-8")


class Chapter(NamedTuple):
    """A section as the report shows it."""

    title: str
    """Heading, with the numbers of its tables."""
    tables: Sequence[Table]
    """Tables of the thesis beside ours, then others."""
    text: str
    """Sentences, as markdown."""

    def markdown(self) -> list[str]:
        """Return the chapter as lines of markdown."""
        lines = ["", f"## {self.title}", ""]
        for table in self.tables:
            grid = table.grid()
            lines += [f"**{markdown(grid.title)}**", "", *markdown_table(grid), ""]
            lines += [f"- {markdown(line)}" for line in grid.caption.splitlines()] + [""] * bool(grid.caption)
        return [*lines, *self.text.splitlines()]


def chapter_of(section: Section, findings: Findings) -> Chapter:
    """Return what a section found as a chapter."""
    title, *lines = template(section.key.partition("-")[0]).format_map(dict(findings.words)).strip().splitlines()
    tables = []
    for line in lines:
        if line.startswith("## "):
            numbers, _, caption = line.removeprefix("## ").partition(": ")
            first, _, last = numbers.partition("–")
            shown = [n for n in findings.tables if order_of(first) <= order_of(n) <= order_of(last or first)]
            tables.append(_side_by_side(f"{named(numbers)}. {caption}", {n: findings.tables[n] for n in shown}))
    text = "\n".join(line for line in lines if not line.startswith("## ")).strip()
    several = [named(t) for t in section.tables]
    where = f"{several[0]}–{section.tables[-1]}" if len(several) > 2 else ", ".join(several)
    return Chapter(f"{title.removeprefix('# ')} ({where})", [*tables, *findings.more], text)


def named(number: str) -> str:
    """Return the name of a table, such as `Tab. 3.9`, or of what stands in place of one."""
    return f"Tab. {number}" if number[0].isdigit() else number


def order_of(number: str) -> tuple[int, ...]:
    """Return a sort key that puts tables by number, and after them what has no number."""
    return tuple(map(int, number.split("."))) if number[0].isdigit() else (99, *map(ord, number))


def judged(number: str, rows: Rows) -> dict[str, tuple[dict[str, Verdict], Verdict]]:
    """Return by row the verdicts on its numbers by metric, and that on the whole row."""
    verdicts_of_rows = {row: {m: judge(number, row, m, pair) for m, pair in pairs.items()} for row, pairs in rows.items()}
    return {row: (verdicts, judge_row(rows[row], verdicts)) for row, verdicts in verdicts_of_rows.items()}


def is_printed(pairs: Mapping[str, Pair], verdicts: Mapping[str, Verdict]) -> bool:
    """Return whether the thesis has a row, though its numbers may be lost; the others are shown for the record."""
    return any(pair.is_given or verdicts[metric].see for metric, pair in pairs.items())


def _side_by_side(title: str, tables: Mapping[str, Rows]) -> Table:
    """Return tables of the thesis as one, with printed and own numbers side by side and the reasons of the verdicts below.

    A row has all its metrics side by side where each metric has one unit; else each number has a row, with its unit.
    """
    every = [pairs for rows in tables.values() for pairs in rows.values()]
    units = {m: {pairs[m].unit for pairs in every if m in pairs} for pairs in every for m in pairs}
    wide = max(map(len, every)) > 1 and all(len(u) == 1 for u in units.values())
    lines, why = list[Row](), dict[tuple[str, str], list[str]]()
    for number, rows in tables.items():
        for row, (verdicts, whole) in judged(number, rows).items():
            head, criterion = {"Tab.": number} if len(tables) > 1 else {}, criterion_of(number, row)
            kind = criterion.evidence if is_printed(rows[row], verdicts) else None
            if kind is not None:
                why.setdefault((whole.reason, whole.see), []).append(head.get("Tab.", row))
            if wide:
                numbers = {k: v for m, p in rows[row].items() for k, v in _wide(m, p, criterion.within.get(m)).items()}
                lines.append({**head, "row": row.replace("_", " "), "verdict": whole.status, "evidence": kind, **numbers})
            else:
                for metric, pair in rows[row].items():
                    head |= {"row": row} | ({"what": metric.replace("_", " ")} if len(units) > 1 else {})
                    status = whole.status if len(rows[row]) == 1 else verdicts[metric].status
                    shown = _tall(pair, criterion.within.get(metric))
                    lines.append({**head, "unit": pair.unit, "verdict": status, "evidence": kind, **shown})
    captions = [
        f"{', '.join(names)}: {reason}{f' (docs/{see})' if see else ''}." for (reason, see), names in why.items() if reason
    ]
    used = {key for line in lines for key, value in line.items() if value is not None}
    headings = {key: key.removesuffix(ending_of(key)) for key in used} if wide else {}
    ratios = {key: Unit("", 1.0, 4, significant=5) for key in used if "_ratio" in key}
    kept = [{k: v for k, v in line.items() if k in used} for line in lines]
    return Table(title, kept, "\n".join(captions), units=ratios, headings=headings)


def _wide(metric: str, pair: Pair, within: Sequence[float] | None) -> Row:
    """Return columns named after the metric; a number with a spread has an interval of one such to either side."""
    ending = ending_of(metric)
    supposed = pair.supposed
    columns = {
        "printed": pair.published,
        **_words(within),
        "ours": _interval(pair.ours, pair.spread),
        **pair.beside,
        "supposed": None if supposed is None else _interval(supposed.value, supposed.spread),
    }
    stem = metric.removesuffix(ending)
    return {f"{stem} {name.replace('_', ' ')}{ending}": value for name, value in columns.items()}


def _interval(value: float | None, spread: float | None) -> float | tuple[float, float, float] | None:
    return value if value is None or spread is None else (value, value - spread, value + spread)


def _tall(pair: Pair, within: Sequence[float] | None) -> Row:
    supposed = None if pair.supposed is None else pair.supposed.value
    numbers = {"ours": pair.ours, "spread": pair.spread, "supposed": supposed, **pair.beside}
    return {
        name.replace("_", " "): value for name, value in {"printed": pair.published, **_words(within), **numbers}.items()
    }


def _words(within: Sequence[float] | None) -> Row:
    return {} if within is None else {"least": within[0], "most": within[1]}
