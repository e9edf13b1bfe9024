"""Repeat everything that the thesis reports, with a verdict for each row: `python -m validation.replicate`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

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
from validation.report.drawing import draw_section, inset, put_together, side_by_side, text_row
from validation.report.palette import VERDICT_INKS
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Table, markdown_table
from validation.thesis.verdicts import (
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

ALL_SECTIONS: tuple[Section, ...] = (NOISE_SECTION, *MODEL_SECTIONS, GAZEBO_SECTION, *CONTROL_SECTIONS)
"""Every section, in the order of the report."""


@dataclass(frozen=True)
class Replicate(cli.Common):
    """Options of `replicate`."""

    quick: cli.Flag = False
    """Use reduced budgets, which take under three minutes."""
    only: Annotated[cli.Names, cli.option(default="all")] = ()
    """Sections or tables to run, such as 3.9,4.5 or noise. A wrong name lists all sections."""
    seed: cli.Seed = 1


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
        """Return the page: what the verdicts mean, how many rows have which, and every chapter."""
        lines = [self.lead, "", *markdown_table(self.tables[0].grid())]
        lines += [line for chapter in self.chapters for line in chapter.markdown()]
        return "\n".join([*lines, "", "![Verdicts by section, and tracked references](replicate.png)", "", self.made_by, ""])


@cli.program(Replicate)
def replicate(o: Replicate) -> Replication:
    """Repeat everything that the thesis reports, with a verdict for each row.

    Writes replicate.json, replicate.md and replicate.png. Ctrl-C keeps what is finished.

    Raises:
        SsmrError: a section failed.
        ValueError: `only` names what no section answers for.
    """
    sections, findings, status = chosen_sections(ALL_SECTIONS, o.only), dict[str, Findings](), FINISHED
    for section in sections:
        try:
            findings[section.key] = section.run(_task(o, section.key, len(findings), len(sections)))
        except KeyboardInterrupt:
            if not findings:
                raise
            status = INTERRUPTED
            break
    chapters = [chapter_of(section, findings[section.key]) for section in sections if section.key in findings]
    tables = {number: rows for each in findings.values() for number, rows in each.tables.items()}
    verdicts = {number: judged(number, rows) for number, rows in tables.items()}
    counts = [_tally(each.tables, verdicts) for each in findings.values()]
    summary = [
        {"section": c.title, **{s: sum(n for (_, status), n in count.items() if status == s) for s in STATUSES}}
        for c, count in zip(chapters, counts, strict=True)
        if count
    ]
    every = sum(counts, Counter[tuple[Evidence, Status]]())
    by_evidence: list[dict[str, Any]] = [{"evidence": e, **{s: every[e, s] for s in STATUSES}} for e in EVIDENCE]
    total: dict[str, int] = {s: sum(every[e, s] for e in EVIDENCE) for s in STATUSES}
    unexplained = _unexplained(tables, verdicts)
    return Replication(
        program="replicate",
        title="The thesis' results beside this project's",
        tables=[
            Table("Rows that the thesis has, by what their agreement says", [*by_evidence, {"evidence": "all", **total}]),
            Table("The same by section", summary),
            *(table for chapter in chapters for table in chapter.tables),
        ],
        sentences=[f"Unexplained: {', '.join(unexplained)}."] if unexplained else [],
        document={
            "schema": "ssmr.replicate/1",
            "quick": o.quick,
            "seed": o.seed,
            "tables": {n: _as_dict(n, tables[n], verdicts[n]) for n in sorted(tables, key=order_of)},
            "verdicts": total,
            "evidence": {row["evidence"]: {s: row[s] for s in STATUSES} for row in by_evidence},
        },
        options={"quick": o.quick, "only": o.only, "seed": o.seed},
        draw=_draw,
        has_text=True,
        status=status,
        findings=findings,
        chapters=chapters,
        lead=_lead(o.quick, findings, unexplained, every),
    )


_Verdicts = Mapping[str, Mapping[str, tuple[Mapping[str, Verdict], Verdict]]]


def _task(o: Replicate, key: str, done: int, total: int) -> Task:
    """Return what a section needs; its progress moves that of the whole."""

    def tell(now: Progress) -> None:
        o.progress(Progress(done + now.done / max(now.total, 1e-9), total, f"{key}, {now.text}"))

    tell(Progress(0.0, 1.0, "begun"))
    return Task(QUICK if o.quick else Budget(), o.seed, o.workers, tell)


def _tally(tables: Mapping[str, Rows], verdicts: _Verdicts) -> Counter[tuple[Evidence, Status]]:
    """Return how many of the rows that the thesis has are evidence of what, with which verdict."""
    return Counter(
        (criterion_of(number, row).evidence, whole.status)
        for number, rows in tables.items()
        for row, (each, whole) in verdicts[number].items()
        if is_printed(rows[row], each)
    )


def _unexplained(tables: Mapping[str, Rows], verdicts: _Verdicts) -> list[str]:
    """Return the rows that differ without a known reason, such as `4.5 line_0.25`."""
    return [
        f"{number} {row}"
        for number in tables
        for row, (each, whole) in verdicts[number].items()
        if whole.status != "agrees if" and any(v.reason == UNEXPLAINED for v in each.values())
    ]


def _lead(quick: bool, findings: Container[str], unexplained: Sequence[str], every: Counter[tuple[Evidence, Status]]) -> str:
    missing = [s.key for s in ALL_SECTIONS if s.key not in findings]
    status = {s: sum(every[e, s] for e in EVIDENCE) for s in STATUSES}
    agreeing = {e: every[e, "agrees"] + every[e, "agrees if"] for e in EVIDENCE}
    words: dict[str, Any] = {
        "quick": " It was made with `--quick`: fewer generations and seeds, so less can be concluded." if quick else "",
        "unexplained": f"Unexplained: {', '.join(unexplained)}." if unexplained else "Every difference has a known reason.",
        "missing": f"Left out: {', '.join(missing)}." if missing else "",
        "rows": every.total(), "agree": sum(agreeing.values()), "under": status["agrees if"],
        "differ": status["differs"] + status["nearer"], "vague": status["not told apart"], "lost": status["not compared"],
        **{str(e): n for e, n in agreeing.items()},
        "factor": FACTOR, "reach": RATIO_REACH, "spreads": SPREADS, "wide": TOO_WIDE, "end": AT_BOUND,
    }  # fmt: skip
    return template("lead").format_map(words).strip()


def _as_dict(number: str, rows: Rows, verdicts: Mapping[str, tuple[Mapping[str, Verdict], Verdict]]) -> dict[str, Any]:
    declared = {row: criterion_of(number, row) for row in rows}
    return {
        "rows": {
            row: {m: _entry(p, verdicts[row][0][m], declared[row].within.get(m)) for m, p in pairs.items()}
            for row, pairs in rows.items()
        },
        "verdicts": {row: _words(whole) | {"evidence": declared[row].evidence} for row, (_, whole) in verdicts.items()},
    }


def _words(verdict: Verdict) -> dict[str, str]:
    return {"verdict": verdict.status, "reason": verdict.reason, "see": verdict.see}


def _entry(pair: Pair, verdict: Verdict, within: Sequence[float] | None) -> dict[str, Any]:
    entry: dict[str, Any] = {"published": pair.published, "ours": pair.ours, "unit": pair.unit, "spread": pair.spread}
    entry |= {**pair.beside, **({"within": list(within)} if within else {})}
    if pair.bounds:
        entry["bounds"] = list(pair.bounds)
    if (under := pair.supposed) is not None:
        entry |= {"supposed": under.value, "supposed_spread": under.spread, "if": under.text}
    return entry | _words(verdict)


def _draw(result: Replication) -> Figure:
    """Return the number of rows by section and verdict, and below it the pictures of the sections."""
    rows = list(result.tables[1].rows)

    def bars(ax: Axes) -> None:
        left = [0.0] * len(rows)
        for status in STATUSES:
            ax.barh(range(len(rows)), [r[status] for r in rows], left=left, color=VERDICT_INKS[status], label=status)
            left = [start + r[status] for start, r in zip(left, rows, strict=True)]
        inset(ax, left=3.2)
        ax.set_yticks(range(len(rows)), [r["section"] for r in rows])
        ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="rows that the thesis prints")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(STATUSES), frameon=False)

    heading = text_row(0.35, partial(draw_section, result.title))
    panels = [row for findings in result.findings.values() for row in findings.panels]
    return put_together([heading, side_by_side(1.1 + 0.3 * len(rows), [bars]), *panels])
