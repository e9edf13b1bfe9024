"""Verdicts: whether a number of ours agrees with the printed one, and the known reasons where it does not.

The rules are here, each stated once. The known reasons are in ``verdicts.toml`` beside this module, each with the page of
docs/ that shows it. A difference without a known reason is called unexplained.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from typing import Any, Literal, get_args

_SCHEMA = "ssmr.verdicts/1"
FACTOR = 1.5
"""Greatest ratio of two distances that agree."""
RATIO_REACH = 0.01
"""Greatest difference of two ratios of lengths that agree [1]."""
SPREADS = 2.0
"""Numbers agree within this many standard deviations, or standard errors, of ours."""
ROUNDING = 1e-9
"""Relative tolerance of the limits, for rounding."""

Rule = Literal["distance", "ratio", "spread", "at_least", "none"]
"""Rule by which two numbers are compared. `distance` compares by their ratio, `ratio` by their difference because one is
perfect, `spread` by the uncertainty of ours. `at_least` is for numbers that the thesis calls large in words: ours must reach
`beside["at_least"]`. `none` compares nothing and shows the number for the record."""
Status = Literal["agrees", "agrees if", "nearer", "differs", "not compared"]
"""`nearer`: it differs, but a distance of ours is smaller than the printed one. `agrees if`: a row that does not agree as
printed, but agrees in every number under one supposition about what the thesis does not print."""
STATUSES: tuple[Status, ...] = get_args(Status)

RULES: Mapping[Rule, str] = {
    "distance": f"a distance agrees within a factor of {FACTOR:g} either way; a smaller one is called nearer",
    "ratio": f"a ratio of lengths agrees within {RATIO_REACH:g}",
    "spread": f"a parameter or a gain agrees within {SPREADS:g} standard errors, or standard deviations over seeds",
    "at_least": "what the thesis says in words agrees if ours is at least what the words are taken to mean",
}
"""The rules in words."""
RULE_OF: Mapping[str, Rule] = {"d_rms_m": "distance", "d_haus_m": "distance", "d_ratio": "ratio"}
"""Rules of the metrics of a path, whatever table they stand in."""


def rules_in_words() -> str:
    """Return what the verdicts mean, in sentences, for every report that shows them."""
    return (
        "; ".join(RULES.values()).capitalize() + ". Where ours has a spread, distances and ratios within two standard "
        "deviations agree too, since the thesis prints a single run. A row gets the verdict of its worst number. A row that "
        "does not agree as printed, but in all its numbers under one supposition about what the thesis does not print, is "
        "called agrees if; the supposition stands below."
    )


@dataclass(frozen=True)
class Supposed:
    """A number of ours under a supposition about what the thesis does not print."""

    value: float
    """The number."""
    spread: float | None
    """Its standard deviation; None if it is not known."""
    text: str
    """The supposition in words, without a full stop; it ends a sentence that begins with "it agrees if"."""
    see: str = ""
    """Page of docs/ that shows it."""


@dataclass(frozen=True)
class Pair:
    """A printed number beside ours."""

    published: float | None
    """Number of the thesis; None if it has none."""
    ours: float | None
    """Number of this project; None if there is none to compare."""
    rule: Rule
    """Rule that compares them."""
    unit: str = "1"
    """Unit of both."""
    spread: float | None = None
    """Standard error or standard deviation of ours; None if it is not known."""
    beside: Mapping[str, float] = field(default_factory=dict)
    """Further numbers of ours by name, for the record."""
    obstacle: str = ""
    """Reason found by the run why they cannot be compared; empty if they can."""
    supposed: Supposed | None = None
    """Our number under a supposition, the same for all numbers of a row; None if there is none."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown rule, or a number that is not finite."""
        if self.rule not in get_args(Rule):
            raise ValueError(f"unknown rule '{self.rule}'; there are: {', '.join(get_args(Rule))}")
        under = () if self.supposed is None else (self.supposed.value, self.supposed.spread)
        for number in (self.published, self.ours, self.spread, *under, *self.beside.values()):
            if number is not None and not math.isfinite(number):
                raise ValueError(f"{number} is no number to compare; None says that there is none")


@dataclass(frozen=True)
class Reason:
    """A known reason why numbers differ, or cannot be compared."""

    tables: tuple[str, ...]
    """Numbers of the tables that it is about."""
    text: str
    """Reason in words, without a full stop."""
    see: str
    """Page of docs/ that shows it, perhaps with the number of an erratum: `errata.md, 30`."""
    rows: tuple[str, ...] = ()
    """Names of the rows that it is about, empty for all; one that ends in `*` means all that begin so."""
    metrics: tuple[str, ...] = ()
    """Names of the metrics that it is about, empty for all."""
    when: tuple[Status, ...] = ()
    """Verdicts that it explains, empty for all."""
    comparable: bool = True
    """Whether the numbers can still be compared."""

    def concerns(self, table: str, row: str, metric: str) -> bool:
        """Return whether it is about this number."""
        named = any(row == r or (r.endswith("*") and row.startswith(r[:-1])) for r in self.rows)
        return table in self.tables and (named or not self.rows) and (metric in self.metrics or not self.metrics)


@dataclass(frozen=True)
class Verdict:
    """The verdict on one number."""

    status: Status
    """Verdict in a word."""
    reason: str = ""
    """Reason why it differs or cannot be compared; empty if it agrees."""
    see: str = ""
    """Page of docs/ that shows it."""


UNEXPLAINED = "unexplained"
"""Reason of a difference for which no reason is known."""


@cache
def reasons() -> tuple[Reason, ...]:
    """Return all known reasons; the first that fits is the one that counts.

    Raises:
        ValueError: the file has another schema than this module reads.
    """
    data = tomllib.loads(resources.files("validation.thesis").joinpath("verdicts.toml").read_text(encoding="utf-8"))
    if data.get("schema") != _SCHEMA:
        raise ValueError(f"verdicts.toml has schema {data.get('schema')!r}, expected {_SCHEMA!r}")
    entries: list[dict[str, Any]] = [
        {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()} for entry in data["reason"]
    ]
    return tuple(Reason(**entry) for entry in entries)


def agrees(pair: Pair) -> bool:
    """Return whether two numbers that can be compared agree by their rule."""
    assert pair.ours is not None
    if pair.rule == "at_least":
        return pair.ours >= pair.beside["at_least"]
    assert pair.published is not None
    apart = abs(pair.ours - pair.published)
    if pair.spread is not None and apart <= SPREADS * pair.spread * (1.0 + ROUNDING):
        return True
    if pair.rule == "ratio":
        return apart <= RATIO_REACH * (1.0 + ROUNDING)
    if pair.rule == "distance":
        low, high = sorted((abs(pair.ours), abs(pair.published)))
        return high <= FACTOR * low * (1.0 + ROUNDING)
    return apart == 0.0


def judge(table: str, row: str, metric: str, pair: Pair, known: Sequence[Reason] | None = None) -> Verdict:
    """Return the verdict on one number of ours, with the `known` reasons or, if not given, those of `verdicts.toml`."""
    about = [r for r in (reasons() if known is None else known) if r.concerns(table, row, metric)]
    if pair.obstacle:
        return Verdict("not compared", pair.obstacle)
    for reason in about:
        if not reason.comparable:
            return Verdict("not compared", reason.text, reason.see)
    if pair.published is None and pair.rule != "at_least":
        return Verdict("not compared", "the thesis prints no number")
    if pair.rule == "none" or pair.ours is None:
        return Verdict("not compared", "shown for the record")
    if agrees(pair):
        return Verdict("agrees")
    nearer = pair.rule == "distance" and pair.published is not None and pair.ours < pair.published
    status: Status = "nearer" if nearer else "differs"
    found = next((r for r in about if not r.when or status in r.when), None)
    return Verdict(status, found.text, found.see) if found else Verdict(status, UNEXPLAINED)


@dataclass(frozen=True)
class RowVerdict:
    """The verdict on a row of numbers."""

    status: Status
    """Verdict of its worst number. Numbers that cannot be compared count only if none can."""
    because: tuple[tuple[tuple[str, ...], Verdict], ...]
    """Reasons, each with the metrics that it is about; with no metrics if it is about all."""

    @property
    def reason(self) -> str:
        """All reasons in words, each with its metrics."""
        about = (", ".join(map(short, metrics)) + ": " if metrics else "" for metrics, _ in self.because)
        return "; ".join(which + v.reason for which, (_, v) in zip(about, self.because, strict=True))

    @property
    def see(self) -> str:
        """All pages of docs/ that show the reasons."""
        return "; ".join(dict.fromkeys(v.see for _, v in self.because if v.see))


def of_row(verdicts: Mapping[str, Verdict]) -> RowVerdict:
    """Return the verdict on a row from those on its numbers by metric, at least one."""
    judged = {m: v for m, v in verdicts.items() if v.status != "not compared"} or verdicts
    order: tuple[Status, ...] = ("not compared", "agrees", "nearer", "differs")
    worst = max((v.status for v in judged.values()), key=order.index)
    found: dict[tuple[str, str], list[str]] = {}
    for metric, v in judged.items():
        if v.reason:
            found.setdefault((v.reason, v.see), []).append(metric)
    because = tuple(
        (() if len(metrics) == len(judged) else tuple(metrics), judged[metrics[0]]) for metrics in found.values()
    )
    return RowVerdict(worst, because)


def is_told(pair: Pair) -> bool:
    """Return whether the thesis gives it, in numbers or in words."""
    return pair.published is not None or pair.rule == "at_least"


def judge_rows(table: str, rows: Mapping[str, Mapping[str, Pair]]) -> dict[str, dict[str, Verdict]]:
    """Return the verdict on every number of a table, by row and metric."""
    return {row: {m: judge(table, row, m, pair) for m, pair in pairs.items()} for row, pairs in rows.items()}


def row_verdict(pairs: Mapping[str, Pair], verdicts: Mapping[str, Verdict]) -> RowVerdict:
    """Return the verdict on a row.

    It is that of the numbers which the thesis gives; where it gives none, of those that are lost; else of all.
    """
    printed = {m: v for m, v in verdicts.items() if is_told(pairs[m]) and pairs[m].rule != "none"}
    found = of_row(printed or {m: v for m, v in verdicts.items() if v.see} or dict(verdicts))
    compared = [pairs[m] for m, v in printed.items() if v.status != "not compared"]
    under = [replace(p, ours=p.supposed.value, spread=p.supposed.spread) for p in compared if p.supposed is not None]
    if found.status in ("nearer", "differs") and len(under) == len(compared) and all(map(agrees, under)):
        supposed = compared[0].supposed
        assert supposed is not None
        return RowVerdict("agrees if", (((), Verdict("agrees if", f"it agrees if {supposed.text}", supposed.see)),))
    return found


def short(metric: str) -> str:
    """Return a metric's name without the suffix of its unit."""
    for suffix in ("_m", "_s", "_percent", "_1"):
        if metric.endswith(suffix):
            return metric.removesuffix(suffix)
    return metric
