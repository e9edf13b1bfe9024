"""The chapters of a replication: tables, and sentences from `templates/*.md`.

A template begins with the chapter's title, `# TITLE`, and a line `## NUMBER: CAPTION` for each
table; `4.5–4.12` shows several tables of the thesis as one. The rest are sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.progress import Progressing
from validation.replicate.verdicts import Pair, Rows, Verdict, criterion_of, judge, judge_row
from validation.report.columns import Unit, ending_of
from validation.report.drawing import PanelRow
from validation.report.table import Row, Table, markdown_table
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
    """The sections with these keys or tables, in their own order; all of them if none is named.

    Raises:
        ValueError: an unknown name; the message lists the keys.
    """
    for name in names:
        if not any(name == section.key or name in section.tables for section in sections):
            keys = ", ".join(section.key for section in sections)
            raise ValueError(
                f"'{name}' in only is no section ({keys}) and no table of one of them, such as 3.9"
            )
    if not names:
        return list(sections)
    return [s for s in sections if not {s.key, *s.tables}.isdisjoint(names)]


def template(name: str) -> str:
    """Return the text of a template, whose places wait for numbers."""
    file = resources.files("validation.replicate") / f"templates/{name}.md"
    return file.read_text(encoding="utf-8")


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
            lines += [f"- {markdown(line)}" for line in grid.caption.splitlines()]
            if grid.caption:
                lines.append("")
        return [*lines, *self.text.splitlines()]


def chapter_of(section: Section, findings: Findings) -> Chapter:
    """Return the findings of a section as a chapter."""
    filled = template(section.key.partition("-")[0]).format_map(dict(findings.words))
    title, *lines = filled.strip().splitlines()
    tables = []
    sentences = []
    for line in lines:
        if not line.startswith("## "):
            sentences.append(line)
            continue
        numbers, _, caption = line.removeprefix("## ").partition(": ")
        heading = f"{named(numbers)}. {caption}"
        tables.append(_side_by_side(heading, _tables_between(numbers, findings.tables)))
    text = "\n".join(sentences).strip()
    where = ", ".join(map(named, section.tables))
    if len(section.tables) > 2:
        where = f"{named(section.tables[0])}–{section.tables[-1]}"
    return Chapter(f"{title.removeprefix('# ')} ({where})", [*tables, *findings.more], text)


def _tables_between(numbers: str, tables: Mapping[str, Rows]) -> dict[str, Rows]:
    """The table of a number, or those of a range such as `4.5–4.12`."""
    first, _, last = numbers.partition("–")
    lower = order_of(first)
    upper = order_of(last or first)
    return {n: rows for n, rows in tables.items() if lower <= order_of(n) <= upper}


def deviation(values: Sequence[float] | FloatArray) -> float | None:
    """Return the standard deviation of some numbers; None of a single one."""
    if len(values) > 1:
        return float(np.std(values, ddof=1))
    return None


def named(number: str) -> str:
    """The name of a table, such as `Tab. 3.9`; a section or figure without one keeps its own."""
    if number[0].isdigit():
        return f"Tab. {number}"
    return number


def order_of(number: str) -> tuple[int, ...]:
    """Return a sort key that puts tables by number, and sections and figures after them."""
    if number[0].isdigit():
        return tuple(map(int, number.split(".")))
    return (99, *map(ord, number))


def judged(number: str, rows: Rows) -> dict[str, tuple[dict[str, Verdict], Verdict]]:
    """Return by row the verdicts on its numbers by metric, and that on the whole row."""
    judgements = {}
    for row, pairs in rows.items():
        verdicts = {metric: judge(number, row, metric, pair) for metric, pair in pairs.items()}
        judgements[row] = (verdicts, judge_row(pairs, verdicts))
    return judgements


def is_printed(pairs: Mapping[str, Pair], verdicts: Mapping[str, Verdict]) -> bool:
    """Whether the thesis has a row, though its numbers may be lost; others are for the record."""
    return any(pair.is_given or verdicts[metric].see for metric, pair in pairs.items())


def _side_by_side(title: str, tables: Mapping[str, Rows]) -> Table:
    """Tables of the thesis as one: printed numbers beside ours, and below them the reasons.

    A row has all its metrics side by side where each metric has one unit; else each number has a
    row, with its unit.
    """
    every = [pairs for rows in tables.values() for pairs in rows.values()]
    units: dict[str, set[str]] = {}
    for pairs in every:
        for metric, pair in pairs.items():
            units.setdefault(metric, set()).add(pair.unit)
    wide = max(map(len, every)) > 1 and all(len(u) == 1 for u in units.values())
    lines = list[Row]()
    rows_by_source = dict[tuple[str, str], list[str]]()
    for number, rows in tables.items():
        for row, (verdicts, whole) in judged(number, rows).items():
            pairs = rows[row]
            head = {"Tab.": number} if len(tables) > 1 else {}
            criterion = criterion_of(number, row)
            evidence = None
            if is_printed(pairs, verdicts):
                evidence = criterion.evidence
                source = (whole.reason, whole.see)
                rows_by_source.setdefault(source, []).append(head.get("Tab.", row))
            line: dict[str, Any]
            if wide:
                name = row.replace("_", " ")
                line = {**head, "row": name, "verdict": whole.status, "evidence": evidence}
                for metric, pair in pairs.items():
                    line |= _metric_columns(metric, pair, criterion.within.get(metric))
                lines.append(line)
                continue
            for metric, pair in pairs.items():
                line = {**head, "row": row}
                if len(units) > 1:
                    line["what"] = metric.replace("_", " ")
                status = whole.status if len(pairs) == 1 else verdicts[metric].status
                line |= {"unit": pair.unit, "verdict": status, "evidence": evidence}
                line |= _pair_columns(pair, criterion.within.get(metric))
                lines.append(line)
    used = {key for line in lines for key, value in line.items() if value is not None}
    headings = {key: key.removesuffix(ending_of(key)) for key in used} if wide else {}
    ratios = {key: Unit("", 1.0, 4, significant=5) for key in used if "_ratio" in key}
    kept = [{k: v for k, v in line.items() if k in used} for line in lines]
    return Table(title, kept, _caption(rows_by_source), units=ratios, headings=headings)


def _caption(rows_by_source: Mapping[tuple[str, str], Sequence[str]]) -> str:
    """Return a line for each reason, from names of rows by reason and page of docs/."""
    lines = []
    for (reason, page), names in rows_by_source.items():
        if reason:
            source = f" (docs/{page})" if page else ""
            lines.append(f"{', '.join(names)}: {reason}{source}.")
    return "\n".join(lines)


def _metric_columns(metric: str, pair: Pair, within: Sequence[float] | None) -> Row:
    """Columns named after the metric; a spread makes a number an interval to both sides."""
    ending = ending_of(metric)
    supposed = pair.supposed
    columns = {
        "printed": pair.published,
        **_limit_columns(within),
        "ours": _interval(pair.ours, pair.spread),
        **pair.beside,
        "supposed": None if supposed is None else _interval(supposed.value, supposed.spread),
    }
    stem = metric.removesuffix(ending)
    return {f"{stem} {name.replace('_', ' ')}{ending}": value for name, value in columns.items()}


def _interval(
    value: float | None, spread: float | None
) -> float | tuple[float, float, float] | None:
    if value is None or spread is None:
        return value
    return (value, value - spread, value + spread)


def _pair_columns(pair: Pair, within: Sequence[float] | None) -> Row:
    supposed = None if pair.supposed is None else pair.supposed.value
    columns = {
        "printed": pair.published,
        **_limit_columns(within),
        "ours": pair.ours,
        "spread": pair.spread,
        "supposed": supposed,
        **pair.beside,
    }
    return {name.replace("_", " "): value for name, value in columns.items()}


def _limit_columns(within: Sequence[float] | None) -> Row:
    if within is None:
        return {}
    return {"least": within[0], "most": within[1]}
