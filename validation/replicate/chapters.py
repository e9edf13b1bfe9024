"""The chapters of a replication: tables, and sentences from `templates/*.md`.

A template begins with the chapter's title, `# TITLE`, and a line `## NUMBER: CAPTION` for each
table; `4.5–4.12` shows several tables of the thesis as one. The rest are sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray
from validation.output import Document, Progressing, markdown_text
from validation.replicate.verdicts import JudgedRow, Rows, judged_rows
from validation.report.columns import Unit, ending_of
from validation.report.drawing import PanelRow
from validation.report.report import INTERRUPTED, Report
from validation.report.table import Row, Table, markdown_table
from validation.sweep import Measure, Variant, sweep


class Task(NamedTuple):
    """Inputs of a section: how much it searches and repeats, and what it works with."""

    seed: int
    """First seed of its searches."""
    workers: int | str | None
    """Threads, a scheduler's address, or None for all processors; no result depends on it."""
    progress: Progressing
    """Callback for its progress."""
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


QUICK: Mapping[str, Any] = {
    "fit": (20, 25),
    "tune": (20, 12),
    "searches": 1,
    "draws": 2,
    "starts": 1,
}
"""Fields of a `Task` that takes less: the whole is under three minutes then."""


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

    @cached_property
    def rows(self) -> list[JudgedRow]:
        """Return every row of the tables with its verdicts."""
        return judged_rows(self.tables)


Sections = Mapping[str, tuple[Sequence[str], Callable[[Task], Findings]]]
"""Parts of the replication that run by themselves, by their names on the command line, which begin
with those of their templates: the numbers of the tables of the thesis that each answers for, and
the function that finds them."""


def chosen_sections(sections: Sections, names: Sequence[str]) -> Sections:
    """The sections with these keys or tables, in their own order; all of them if none is named.

    Raises:
        ValueError: an unknown name; the message lists the keys.
    """
    for name in names:
        if not any(name == key or name in tables for key, (tables, _) in sections.items()):
            keys = ", ".join(sections)
            raise ValueError(
                f"'{name}' in only is no section ({keys}) and no table of one of them, such as 3.9"
            )
    if not names:
        return sections
    return {k: s for k, s in sections.items() if not {k, *s[0]}.isdisjoint(names)}


def read_template(name: str) -> str:
    """Return the text of a template, whose places wait for numbers."""
    file = resources.files("validation.replicate") / f"templates/{name}.md"
    return file.read_text(encoding="utf-8")


Chapter = tuple[str, Sequence[Table], str]
"""A section as the report shows it: its heading with the numbers of its tables, the tables of the
thesis beside ours and then others, and sentences as markdown."""


def chapter_lines(chapter: Chapter) -> list[str]:
    """Return a chapter as lines of markdown."""
    title, tables, text = chapter
    lines = ["", f"## {title}", ""]
    for table in tables:
        lines += [f"**{markdown_text(table.title)}**", "", *markdown_table(table), ""]
        lines += [f"- {markdown_text(line)}" for line in table.caption.splitlines()]
        if table.caption:
            lines.append("")
    return [*lines, *text.splitlines()]


def chapter_of(key: str, numbers: Sequence[str], findings: Findings) -> Chapter:
    """Return the findings of a section, which answers for tables of these numbers, as a chapter."""
    filled = read_template(key.partition("-")[0]).format_map(dict(findings.words))
    title, *lines = filled.strip().splitlines()
    tables = []
    sentences = []
    for line in lines:
        if not line.startswith("## "):
            sentences.append(line)
            continue
        shown, _, caption = line.removeprefix("## ").partition(": ")
        first, _, last = shown.partition("–")
        lower = order_of(first)
        upper = order_of(last or first)
        rows = [row for row in findings.rows if lower <= order_of(row.table) <= upper]
        tables.append(_side_by_side(f"{_table_name(shown)}. {caption}", rows))
    text = "\n".join(sentences).strip()
    where = ", ".join(map(_table_name, numbers))
    if len(numbers) > 2:
        where = f"{_table_name(numbers[0])}–{numbers[-1]}"
    return f"{title.removeprefix('# ')} ({where})", [*tables, *findings.more], text


def standard_deviation(values: Sequence[float] | FloatArray) -> float | None:
    """Return the standard deviation of some numbers; None of a single one."""
    if len(values) > 1:
        return float(np.std(values, ddof=1))
    return None


def unit_of_metric(metric: str) -> str:
    """Return the unit of a metric of a path."""
    return "m" if metric.endswith("_m") else "1"


def finished_results(report: Report) -> Document:
    """Return a search's results as its JSON file has them; Ctrl-C in it is one here."""
    found = report.as_dict()
    if found["status"] == INTERRUPTED:
        raise KeyboardInterrupt
    return found


def swept_rows(
    variants: Mapping[str, Variant], measure: Measure[Variant], task: Task
) -> Sequence[Row]:
    """Return what is measured of each variant, in their order; Ctrl-C in a sweep is one here.

    Raises:
        SsmrError: a measure failed.
    """
    swept = sweep(variants, {"run": measure}, workers=task.workers, progress=task.progress)
    if swept.status == INTERRUPTED:
        raise KeyboardInterrupt
    if swept.notes:
        raise SsmrError(" ".join(swept.notes))
    return swept.rows


def _table_name(number: str) -> str:
    """The name of a table, such as `Tab. 3.9`; a section or figure without one keeps its own."""
    if number[0].isdigit():
        return f"Tab. {number}"
    return number


def order_of(number: str) -> tuple[int, ...]:
    """Return a sort key that puts tables by number, and sections and figures after them."""
    if number[0].isdigit():
        return tuple(map(int, number.split(".")))
    return (99, *map(ord, number))


def _side_by_side(title: str, rows: Sequence[JudgedRow]) -> Table:
    """Rows of the thesis as one table: printed numbers beside ours, and below them the reasons.

    A row has all its metrics side by side where each metric has one unit; else each number has a
    row, with its unit.
    """
    units: dict[str, set[str]] = {}
    for row in rows:
        for metric, pair in row.pairs.items():
            units.setdefault(metric, set()).add(pair.unit)
    wide = max(len(row.pairs) for row in rows) > 1 and all(len(u) == 1 for u in units.values())
    several = len({row.table for row in rows}) > 1
    lines = []
    names_by_reason = dict[str, list[str]]()
    for row in rows:
        head = {"Tab.": row.table} if several else {}
        evidence = row.criterion.evidence if row.is_printed else None
        if row.is_printed and row.whole.reason:
            names_by_reason.setdefault(_verdict_reason(row), []).append(head.get("Tab.", row.name))
        verdict = {"verdict": row.whole.status, "evidence": evidence}
        if wide:
            line = {**head, "row": row.name.replace("_", " "), **verdict}
            for metric in row.pairs:
                line |= _metric_columns(row, metric)
            lines.append(line)
            continue
        for metric, pair in row.pairs.items():
            what = {"what": metric.replace("_", " ")} if len(units) > 1 else {}
            if len(row.pairs) > 1:
                verdict["verdict"] = row.verdicts[metric].status
            columns = _number_columns(row, metric)
            lines.append({**head, "row": row.name, **what, "unit": pair.unit, **verdict, **columns})
    used = {key for line in lines for key, value in line.items() if value is not None}
    headings = {key: key.removesuffix(ending_of(key)) for key in used} if wide else {}
    ratios = {key: Unit("", 1.0, 4, significant=5) for key in used if "_ratio" in key}
    kept = [{k: v for k, v in line.items() if k in used} for line in lines]
    caption = "\n".join(f"{', '.join(names)}: {why}." for why, names in names_by_reason.items())
    return Table(title, kept, caption, units=ratios, headings=headings)


def _verdict_reason(row: JudgedRow) -> str:
    """Return why a row has its verdict, and the page of docs/ that shows it."""
    source = f" (docs/{row.whole.see})" if row.whole.see else ""
    return f"{row.whole.reason}{source}"


def _number_columns(row: JudgedRow, metric: str) -> Document:
    """Columns of one number of a row."""
    pair = row.pairs[metric]
    limits = zip(("least", "most"), row.criterion.within.get(metric, ()), strict=False)
    columns = {
        "printed": pair.published,
        **dict(limits),
        "ours": pair.ours,
        "spread": pair.spread,
        "supposed": None if pair.supposed is None else pair.supposed.ours,
        **pair.beside,
    }
    return {name.replace("_", " "): value for name, value in columns.items()}


def _metric_columns(row: JudgedRow, metric: str) -> Row:
    """The same, named after the metric; a spread makes a number an interval to both sides."""
    pair = row.pairs[metric]
    columns = _number_columns(row, metric)
    columns["ours"] = _printed_interval(pair.ours, columns.pop("spread"))
    if pair.supposed is not None:
        columns["supposed"] = _printed_interval(pair.supposed.ours, pair.supposed.spread)
    ending = ending_of(metric)
    stem = metric.removesuffix(ending)
    return {f"{stem} {name}{ending}": value for name, value in columns.items()}


def _printed_interval(
    value: float | None, spread: float | None
) -> float | tuple[float, float, float] | None:
    if value is None or spread is None:
        return value
    return (value, value - spread, value + spread)
