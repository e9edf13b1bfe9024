"""Repeat what the thesis reports, with a verdict for each row: `python -m validation.replicate`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation import cli
from validation.output import Document, Progress
from validation.replicate.chapters import (
    QUICK,
    Chapter,
    Findings,
    Sections,
    Task,
    chapter_lines,
    chapter_of,
    chosen_sections,
    order_of,
    read_template,
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
    UNCONVERGED,
    UNEXPLAINED,
    Evidence,
    JudgedRow,
    Status,
    Verdict,
)
from validation.report.drawing import PanelRow, draw_page
from validation.report.palette import VERDICT_INKS
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Table, markdown_table

ALL_SECTIONS: Sections = {
    **NOISE_SECTION,
    **MODEL_SECTIONS,
    **GAZEBO_SECTION,
    **CONTROL_SECTIONS,
}
"""Every section, in the order of the report."""


@dataclass(frozen=True)
class Replicate(cli.Common):
    """Options of `replicate`."""

    quick: bool = False
    """Use reduced budgets, which take under three minutes: to see that all runs, for fits do not
    converge and are not compared."""
    only: Sequence[str] = ()
    """Sections or tables to run, such as 3.9,4.5 or noise; all if not given. A wrong name lists
    all sections."""


_Counts = Counter[tuple[Evidence, Status]]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Replication(Report):
    """Every table of the thesis beside ours, with verdicts."""

    program = "replicate"
    endings = ("png", "md")
    findings: Mapping[str, Findings]
    """Findings by section, in the order of the report."""
    chapters: Sequence[Chapter]
    """The same as the report shows it."""

    @property
    def rows(self) -> list[JudgedRow]:
        """All rows with their verdicts."""
        return list(chain.from_iterable(each.rows for each in self.findings.values()))

    @property
    def unexplained(self) -> list[str]:
        """Rows that differ without a known reason, such as `4.5 line_0.25`."""
        return [f"{row.table} {row.name}" for row in self.rows if _is_unexplained(row)]

    @property
    def unconverged(self) -> list[str]:
        """Tables that rest on a fit which did not converge, such as `3.9`."""
        tables = dict[str, None]()
        for row in self.rows:
            if any(v.reason.startswith(UNCONVERGED) for v in row.verdicts.values()):
                tables[row.table] = None
        return list(tables)

    @property
    def by_evidence(self) -> dict[str, dict[str, int]]:
        """Number of the thesis' rows by evidence and verdict."""
        counts = _count_verdicts(self.rows)
        return {str(e): {str(s): counts[e, s] for s in STATUSES} for e in EVIDENCE}

    def tables(self) -> list[Table]:
        """Return the verdicts by evidence and by section, and the tables of all chapters."""
        by_evidence = [{"evidence": e, **n} for e, n in self.by_evidence.items()]
        by_evidence.append({"evidence": "all", **_by_status(_count_verdicts(self.rows))})
        by_section = []
        shown = list[Table]()
        for (title, tables, _), each in zip(self.chapters, self.findings.values(), strict=True):
            shown += tables
            if some := _count_verdicts(each.rows):
                by_section.append({"section": title, **_by_status(some)})
        return [
            Table("Rows that the thesis has, by what their agreement says", by_evidence),
            Table("The same by section", by_section),
            *shown,
        ]

    def notes(self) -> list[str]:
        """Return a sentence on the rows that differ without a known reason."""
        notes = super().notes()
        if self.unexplained:
            notes.append(f"Unexplained: {', '.join(self.unexplained)}.")
        if self.unconverged:
            tables = ", ".join(self.unconverged)
            notes.append(f"Not compared, because fits did not converge: tables {tables}.")
        return notes

    def document(self) -> Document:
        """Return what replicate.json has besides its notes."""
        return {
            "schema": "ssmr.replicate/1",
            "quick": self.options["quick"],
            "seed": self.options["seed"],
            "tables": _tables_of(self.rows),
            "verdicts": _by_status(_count_verdicts(self.rows)),
            "evidence": self.by_evidence,
        }

    def to_markdown(self) -> str:
        """Return the page: the meaning of the verdicts, their counts, and every chapter."""
        counts = _count_verdicts(self.rows)
        lead = _leading_text(self.options, self.findings, self.unexplained, counts)
        lines = [lead, "", *markdown_table(self.tables()[0])]
        for chapter in self.chapters:
            lines += chapter_lines(chapter)
        lines += ["", "![Verdicts by section, and tracked references](replicate.png)"]
        lines += ["", self.made_by, ""]
        return "\n".join(lines)

    def figure(self) -> Figure:
        """Draw the rows by section and verdict, and below them the pictures of the sections."""
        rows = list(self.tables()[1].rows)

        def bars(ax: Axes) -> None:
            places = range(len(rows))
            left = np.zeros(len(rows))
            for status in STATUSES:
                counts = [row[status] for row in rows]
                ax.barh(places, counts, left=left, color=VERDICT_INKS[status], label=status)
                left += counts
            ax.set_yticks(places, [row["section"] for row in rows])
            ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="rows that the thesis prints")
            ax.legend(
                loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(STATUSES), frameon=False
            )

        first = PanelRow(1.1 + 0.3 * len(rows), [bars])
        others = chain.from_iterable(each.panels for each in self.findings.values())
        return draw_page(self.title, [first, *others], foot=self.made_by)


@cli.make_program(Replicate)
def replicate(o: Replicate) -> Replication:
    """Repeat everything that the thesis reports, with a verdict for each row.

    Writes replicate.json, replicate.md and replicate.png. Ctrl-C keeps what is finished.

    Raises:
        SsmrError: a section failed.
        ValueError: `only` names what no section answers for.
    """
    sections = chosen_sections(ALL_SECTIONS, o.only)
    findings = _run_sections(o, sections)
    return Replication(
        title="The thesis' results beside this project's",
        options={"quick": o.quick, "only": o.only, "seed": o.seed},
        status=FINISHED if len(findings) == len(sections) else INTERRUPTED,
        findings=findings,
        chapters=[chapter_of(key, sections[key][0], found) for key, found in findings.items()],
    )


def _run_sections(o: Replicate, sections: Sections) -> dict[str, Findings]:
    """Return the findings by section; an interrupt leaves out those that are not finished."""
    findings = dict[str, Findings]()
    for key, (_, run) in sections.items():
        try:
            findings[key] = run(_make_task(o, key, len(findings), len(sections)))
        except KeyboardInterrupt:
            if not findings:
                raise
            break
    return findings


def _make_task(o: Replicate, key: str, done: int, total: int) -> Task:
    """Return the inputs of a section, whose progress moves that of the whole."""

    def report_progress(now: Progress) -> None:
        share = now.done / max(now.total, 1e-9)
        o.progress(Progress(done + share, total, f"{key}, {now.text}"))

    report_progress(Progress(0.0, 1.0, "begun"))
    task = Task(o.seed, o.workers, report_progress)
    return task._replace(**QUICK) if o.quick else task


def _count_verdicts(rows: Sequence[JudgedRow]) -> _Counts:
    """Return how many of the rows that the thesis has are of which evidence and verdict."""
    return Counter((row.criterion.evidence, row.whole.status) for row in rows if row.is_printed)


def _by_status(counts: _Counts) -> dict[str, int]:
    return {status: sum(counts[e, status] for e in EVIDENCE) for status in STATUSES}


def _is_unexplained(row: JudgedRow) -> bool:
    """Whether a row differs without a known reason."""
    reasons = {verdict.reason for verdict in row.verdicts.values()}
    return row.whole.status != "agrees if" and UNEXPLAINED in reasons


def _leading_text(
    options: Document, findings: Mapping[str, Findings], unexplained: Sequence[str], counts: _Counts
) -> str:
    """Return the page's beginning: what the verdicts mean, and how many rows have which."""
    missing = [key for key in ALL_SECTIONS if key not in findings]
    status = _by_status(counts)
    agreeing = {str(e): counts[e, "agrees"] + counts[e, "agrees if"] for e in EVIDENCE}
    explained = "Every difference has a known reason."
    if unexplained:
        explained = f"Unexplained: {', '.join(unexplained)}."
    haste = " It was made with `--quick`: fewer generations and seeds, so less can be concluded."
    words = {
        "quick": haste if options["quick"] else "",
        "seed": options["seed"],
        "unexplained": explained,
        "missing": f"Left out: {', '.join(missing)}." if missing else "",
        "rows": counts.total(),
        "agree": sum(agreeing.values()),
        "under": status["agrees if"],
        "differ": status["differs"] + status["nearer"],
        "vague": status["not told apart"],
        "lost": status["not compared"],
        **agreeing,
        "factor": FACTOR,
        "reach": RATIO_REACH,
        "spreads": SPREADS,
        "wide": TOO_WIDE,
        "end": AT_BOUND,
    }
    return read_template("lead").format_map(words).strip()


def _tables_of(rows: Sequence[JudgedRow]) -> Document:
    """Return the tables by number as replicate.json has them."""
    tables: Document = {}
    for row in sorted(rows, key=lambda row: order_of(row.table)):
        table = tables.setdefault(row.table, {"rows": {}, "verdicts": {}})
        table["rows"][row.name] = {metric: _row_entry(row, metric) for metric in row.pairs}
        table["verdicts"][row.name] = {
            **_verdict_entry(row.whole),
            "evidence": row.criterion.evidence,
        }
    return tables


def _verdict_entry(verdict: Verdict) -> dict[str, str]:
    return {"verdict": verdict.status, "reason": verdict.reason, "see": verdict.see}


def _row_entry(row: JudgedRow, metric: str) -> Document:
    pair = row.pairs[metric]
    entry: Document = {
        "published": pair.published,
        "ours": pair.ours,
        "unit": pair.unit,
        "spread": pair.spread,
        **pair.beside,
    }
    ranges = {"within": row.criterion.within.get(metric, ()), "bounds": pair.bounds}
    entry |= {name: list(ends) for name, ends in ranges.items() if ends}
    if (under := pair.supposed) is not None:
        entry |= {
            "supposed": under.ours,
            "supposed_spread": under.spread,
            "if": pair.supposition,
        }
    return entry | _verdict_entry(row.verdicts[metric])
