"""Repeat what the thesis reports, with a verdict for each row: `python -m validation.replicate`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation import cli
from validation.progress import Progress
from validation.replicate.chapters import (
    QUICK,
    Budget,
    Chapter,
    Findings,
    Section,
    Task,
    chapter_of,
    chosen_sections,
    is_printed,
    judged,
    order_of,
    template,
)
from validation.replicate.control import CONTROL_SECTIONS
from validation.replicate.gazebo import GAZEBO_SECTION
from validation.replicate.lab import NOISE_SECTION
from validation.replicate.models import MODEL_SECTIONS
from validation.replicate.verdicts import (
    AT_BOUND,
    EVIDENCE,
    FACTOR,
    RATIO_REACH,
    SPREADS,
    STATUSES,
    TOO_WIDE,
    UNEXPLAINED,
    Evidence,
    Pair,
    Rows,
    Status,
    Verdict,
    criterion_of,
)
from validation.report.drawing import draw_section, inset, put_together, side_by_side, text_row
from validation.report.palette import VERDICT_INKS
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Row, Table, markdown_table

ALL_SECTIONS: tuple[Section, ...] = (
    NOISE_SECTION,
    *MODEL_SECTIONS,
    GAZEBO_SECTION,
    *CONTROL_SECTIONS,
)
"""Every section, in the order of the report."""


@dataclass(frozen=True)
class Replicate(cli.Common):
    """Options of `replicate`."""

    quick: bool = False
    """Use reduced budgets, which take under three minutes."""
    only: tuple[str, ...] = ()
    """Sections or tables to run, such as 3.9,4.5 or noise; all if not given. A wrong name lists
    all sections."""
    seed: int = 1
    """Seed of everything random. Equal seeds give equal results."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Replication(Report):
    """Every table of the thesis beside ours, with verdicts."""

    findings: Mapping[str, Findings]
    """Findings by section, in the order of the report."""
    chapters: Sequence[Chapter]
    """The same as the report shows it."""
    lead: str
    """Markdown that stands before the chapters."""

    def markdown(self) -> str:
        """Return the page: the meaning of the verdicts, their counts, and every chapter."""
        lines = [self.lead, "", *markdown_table(self.tables[0].grid())]
        for chapter in self.chapters:
            lines += chapter.markdown()
        lines += ["", "![Verdicts by section, and tracked references](replicate.png)"]
        lines += ["", self.made_by, ""]
        return "\n".join(lines)


@cli.program(Replicate)
def replicate(o: Replicate) -> Replication:
    """Repeat everything that the thesis reports, with a verdict for each row.

    Writes replicate.json, replicate.md and replicate.png. Ctrl-C keeps what is finished.

    Raises:
        SsmrError: a section failed.
        ValueError: `only` names what no section answers for.
    """
    sections = chosen_sections(ALL_SECTIONS, o.only)
    findings = _run_sections(o, sections)
    chapters = []
    tables = dict[str, Rows]()
    for section in sections[: len(findings)]:
        chapters.append(chapter_of(section, findings[section.key]))
        tables |= findings[section.key].tables
    verdicts = {number: judged(number, rows) for number, rows in tables.items()}
    every = _Counts()
    summary = list[Row]()
    for chapter, each in zip(chapters, findings.values(), strict=True):
        counts = _tally(each.tables, verdicts)
        every += counts
        if counts:
            summary.append({"section": chapter.title, **_by_status(counts)})
    by_evidence = {str(e): {str(s): every[e, s] for s in STATUSES} for e in EVIDENCE}
    total = _by_status(every)
    unexplained = _unexplained(tables, verdicts)
    evidence_rows: list[Row] = [{"evidence": e, **counts} for e, counts in by_evidence.items()]
    evidence_rows.append({"evidence": "all", **total})
    result_tables = [
        Table("Rows that the thesis has, by what their agreement says", evidence_rows),
        Table("The same by section", summary),
    ]
    for chapter in chapters:
        result_tables += chapter.tables
    numbers = sorted(tables, key=order_of)
    document = {
        "schema": "ssmr.replicate/1",
        "quick": o.quick,
        "seed": o.seed,
        "tables": {n: _as_dict(n, tables[n], verdicts[n]) for n in numbers},
        "verdicts": total,
        "evidence": by_evidence,
    }
    return Replication(
        program="replicate",
        title="The thesis' results beside this project's",
        tables=result_tables,
        sentences=[f"Unexplained: {', '.join(unexplained)}."] if unexplained else [],
        document=document,
        options={"quick": o.quick, "only": o.only, "seed": o.seed},
        draw=_draw,
        has_text=True,
        status=FINISHED if len(findings) == len(sections) else INTERRUPTED,
        findings=findings,
        chapters=chapters,
        lead=_lead(o.quick, findings, unexplained, every),
    )


_RowVerdicts = Mapping[str, tuple[Mapping[str, Verdict], Verdict]]
"""By row the verdicts on its numbers by metric, and that on the whole row."""
_Counts = Counter[tuple[Evidence, Status]]


def _run_sections(o: Replicate, sections: Sequence[Section]) -> dict[str, Findings]:
    """Return the findings by section; an interrupt leaves out those that are not finished."""
    findings = dict[str, Findings]()
    for section in sections:
        try:
            task = _task(o, section.key, len(findings), len(sections))
            findings[section.key] = section.run(task)
        except KeyboardInterrupt:
            if not findings:
                raise
            break
    return findings


def _task(o: Replicate, key: str, done: int, total: int) -> Task:
    """Return the inputs of a section, whose progress moves that of the whole."""

    def report_progress(now: Progress) -> None:
        share = now.done / max(now.total, 1e-9)
        o.progress(Progress(done + share, total, f"{key}, {now.text}"))

    report_progress(Progress(0.0, 1.0, "begun"))
    return Task(QUICK if o.quick else Budget(), o.seed, o.workers, report_progress)


def _tally(tables: Mapping[str, Rows], verdicts: Mapping[str, _RowVerdicts]) -> _Counts:
    """Return how many rows of the thesis have which class of evidence and verdict."""
    counts = _Counts()
    for number, rows in tables.items():
        for row, (each, whole) in verdicts[number].items():
            if is_printed(rows[row], each):
                counts[criterion_of(number, row).evidence, whole.status] += 1
    return counts


def _by_status(counts: _Counts) -> dict[str, int]:
    return {status: sum(counts[e, status] for e in EVIDENCE) for status in STATUSES}


def _unexplained(tables: Iterable[str], verdicts: Mapping[str, _RowVerdicts]) -> list[str]:
    """Return the rows that differ without a known reason, such as `4.5 line_0.25`."""
    names = []
    for number in tables:
        for row, (each, whole) in verdicts[number].items():
            reasons = {verdict.reason for verdict in each.values()}
            if whole.status != "agrees if" and UNEXPLAINED in reasons:
                names.append(f"{number} {row}")
    return names


def _lead(quick: bool, findings: Container[str], unexplained: Sequence[str], every: _Counts) -> str:
    missing = [s.key for s in ALL_SECTIONS if s.key not in findings]
    status = _by_status(every)
    agreeing = {e: every[e, "agrees"] + every[e, "agrees if"] for e in EVIDENCE}
    haste = ""
    if quick:
        haste = (
            " It was made with `--quick`: fewer generations and seeds, so less can be concluded."
        )
    explained = "Every difference has a known reason."
    if unexplained:
        explained = f"Unexplained: {', '.join(unexplained)}."
    words: dict[str, Any] = {
        "quick": haste,
        "unexplained": explained,
        "missing": f"Left out: {', '.join(missing)}." if missing else "",
        "rows": every.total(),
        "agree": sum(agreeing.values()),
        "under": status["agrees if"],
        "differ": status["differs"] + status["nearer"],
        "vague": status["not told apart"],
        "lost": status["not compared"],
        **{str(e): n for e, n in agreeing.items()},
        "factor": FACTOR,
        "reach": RATIO_REACH,
        "spreads": SPREADS,
        "wide": TOO_WIDE,
        "end": AT_BOUND,
    }
    return template("lead").format_map(words).strip()


def _as_dict(number: str, rows: Rows, verdicts: _RowVerdicts) -> dict[str, Any]:
    entries: dict[str, dict[str, Any]] = {}
    whole_rows = {}
    for row, pairs in rows.items():
        each, whole = verdicts[row]
        criterion = criterion_of(number, row)
        limits = criterion.within
        entries[row] = {m: _entry(pair, each[m], limits.get(m)) for m, pair in pairs.items()}
        whole_rows[row] = _verdict_entry(whole) | {"evidence": criterion.evidence}
    return {"rows": entries, "verdicts": whole_rows}


def _verdict_entry(verdict: Verdict) -> dict[str, str]:
    return {"verdict": verdict.status, "reason": verdict.reason, "see": verdict.see}


def _entry(pair: Pair, verdict: Verdict, within: Sequence[float] | None) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "published": pair.published,
        "ours": pair.ours,
        "unit": pair.unit,
        "spread": pair.spread,
        **pair.beside,
    }
    if within:
        entry["within"] = list(within)
    if pair.bounds:
        entry["bounds"] = list(pair.bounds)
    if (under := pair.supposed) is not None:
        entry |= {"supposed": under.value, "supposed_spread": under.spread, "if": under.text}
    return entry | _verdict_entry(verdict)


def _draw(result: Replication) -> Figure:
    """The number of rows by section and verdict, and below it the pictures of the sections."""
    rows = list(result.tables[1].rows)

    def bars(ax: Axes) -> None:
        places = range(len(rows))
        left = np.zeros(len(rows))
        for status in STATUSES:
            counts = [row[status] for row in rows]
            ax.barh(places, counts, left=left, color=VERDICT_INKS[status], label=status)
            left += counts
        inset(ax, left=3.2)
        ax.set_yticks(places, [row["section"] for row in rows])
        ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="rows that the thesis prints")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(STATUSES), frameon=False)

    heading = text_row(0.35, partial(draw_section, result.title))
    panels = [row for findings in result.findings.values() for row in findings.panels]
    return put_together([heading, side_by_side(1.1 + 0.3 * len(rows), [bars]), *panels])
