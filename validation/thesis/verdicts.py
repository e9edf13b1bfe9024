"""Verdicts: whether a number of ours agrees with the printed one, and the known reasons where it does not.

The rules are here, each stated once. The known reasons are in `verdicts.toml` beside this module, each with the page of
docs/ that shows it. A difference without a known reason is called unexplained.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from typing import Literal, NamedTuple, get_args

FACTOR = 1.5
"""Greatest ratio of two distances that agree."""
RATIO_REACH = 0.01
"""Greatest difference of two ratios of lengths that agree [1]."""
SPREADS = 2.0
"""Numbers agree within this many standard deviations, or standard errors, of ours."""
_ROUNDING = 1.0 + 1e-9
"""Factor of all limits, for rounding."""

Rule = Literal["distance", "ratio", "spread", "at_least", "none"]
"""Rule by which two numbers are compared. `distance` compares by their ratio, `ratio` by their difference because one is
perfect, `spread` by the uncertainty of ours. `at_least` is for numbers that the thesis calls large in words: ours must reach
`beside["at_least"]`. `none` compares nothing and shows the number for the record."""
RULE_OF: Mapping[str, Rule] = {"d_rms_m": "distance", "d_haus_m": "distance", "d_ratio": "ratio"}
"""Rules of the metrics of a path, whatever table they stand in."""
Status = Literal["agrees", "agrees if", "nearer", "differs", "not compared"]
"""`nearer`: it differs, but a distance of ours is smaller than the printed one. `agrees if`: a row that does not agree as
printed, but agrees in every number under one supposition about what the thesis does not print."""
STATUSES: tuple[Status, ...] = get_args(Status)
_WORSE: tuple[Status, ...] = ("not compared", "agrees", "nearer", "differs")
UNEXPLAINED = "unexplained"
"""Reason of a difference for which no reason is known."""


class Supposed(NamedTuple):
    """A number of ours under a supposition about what the thesis does not print."""

    value: float
    """The number."""
    spread: float | None
    """Its standard deviation; None if it is not known."""
    text: str
    """The supposition in words, without a full stop; it ends a sentence that begins with "it agrees if"."""
    see: str
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

    @property
    def is_given(self) -> bool:
        """Return whether the thesis gives it, in numbers or in words."""
        return self.published is not None or self.rule == "at_least"


Rows = Mapping[str, Mapping[str, Pair]]
"""A table of the thesis beside ours: by row and metric, which are named as in `published.toml`."""


@dataclass(frozen=True)
class Reason:
    """A known reason why numbers differ or cannot be compared, see `verdicts.toml`."""

    tables: Sequence[str]
    """Numbers of the tables that it is about."""
    text: str
    """Reason in words, without a full stop."""
    see: str
    """Page of docs/ that shows it, perhaps with the number of an erratum: `errata.md, 30`."""
    rows: Sequence[str] = ()
    """Names of the rows that it is about, empty for all; one that ends in `*` means all that begin so."""
    metrics: Sequence[str] = ()
    """Names of the metrics that it is about, empty for all."""
    when: Sequence[Status] = ()
    """Verdicts that it explains, empty for all."""
    comparable: bool = True
    """Whether the numbers can still be compared."""

    def concerns(self, table: str, row: str, metric: str) -> bool:
        """Return whether it is about this number."""
        named = any(row == r or (r.endswith("*") and row.startswith(r[:-1])) for r in self.rows)
        return table in self.tables and (named or not self.rows) and (metric in self.metrics or not self.metrics)


class Verdict(NamedTuple):
    """The verdict on a number, or on a row of numbers."""

    status: Status
    """Verdict in a word."""
    reason: str = ""
    """Reason why it differs or cannot be compared; empty if it agrees."""
    see: str = ""
    """Page of docs/ that shows it."""


@cache
def reasons() -> tuple[Reason, ...]:
    """Return all known reasons; the first that fits is the one that counts."""
    text = resources.files("validation.thesis").joinpath("verdicts.toml").read_text(encoding="utf-8")
    return tuple(Reason(**entry) for entry in tomllib.loads(text)["reason"])


def agrees(pair: Pair) -> bool:
    """Return whether two numbers that can be compared agree by their rule."""
    assert pair.ours is not None
    if pair.rule == "at_least":
        return pair.ours >= pair.beside["at_least"]
    assert pair.published is not None
    apart = abs(pair.ours - pair.published)
    if pair.spread is not None and apart <= SPREADS * pair.spread * _ROUNDING:
        return True
    if pair.rule == "ratio":
        return apart <= RATIO_REACH * _ROUNDING
    if pair.rule == "distance":
        low, high = sorted((abs(pair.ours), abs(pair.published)))
        return high <= FACTOR * low * _ROUNDING
    return apart == 0.0


def judge(table: str, row: str, metric: str, pair: Pair, known: Sequence[Reason] | None = None) -> Verdict:
    """Return the verdict on one number of ours, with the `known` reasons or, if not given, those of `verdicts.toml`."""
    about = [r for r in (reasons() if known is None else known) if r.concerns(table, row, metric)]
    if pair.obstacle:
        return Verdict("not compared", pair.obstacle)
    for reason in about:
        if not reason.comparable:
            return Verdict("not compared", reason.text, reason.see)
    if not pair.is_given:
        return Verdict("not compared", "the thesis prints no number")
    if pair.rule == "none" or pair.ours is None:
        return Verdict("not compared", "shown for the record")
    if agrees(pair):
        return Verdict("agrees")
    nearer = pair.rule == "distance" and pair.published is not None and pair.ours < pair.published
    status: Status = "nearer" if nearer else "differs"
    found = next((r for r in about if not r.when or status in r.when), None)
    return Verdict(status, found.text, found.see) if found else Verdict(status, UNEXPLAINED)


def judge_row(pairs: Mapping[str, Pair], verdicts: Mapping[str, Verdict]) -> Verdict:
    """Return the verdict on a row from those on its numbers by metric: that of its worst number.

    Only the numbers which the thesis gives count; where it gives none, those that are lost; else all. Numbers that cannot be
    compared count only if none can.
    """
    given = {m: v for m, v in verdicts.items() if pairs[m].is_given and pairs[m].rule != "none"}
    counted = given or {m: v for m, v in verdicts.items() if v.see} or verdicts
    judged = {m: v for m, v in counted.items() if v.status != "not compared"} or counted
    worst = max((v.status for v in judged.values()), key=_WORSE.index)
    compared = [pairs[m] for m in given if m in judged and verdicts[m].status != "not compared"]
    under = [replace(p, ours=p.supposed.value, spread=p.supposed.spread) for p in compared if p.supposed is not None]
    if worst in ("nearer", "differs") and len(under) == len(compared) and all(map(agrees, under)):
        supposed = compared[0].supposed
        assert supposed is not None
        return Verdict("agrees if", f"it agrees if {supposed.text}", supposed.see)
    texts, pages = (dict.fromkeys(filter(None, column)) for column in zip(*(v[1:] for v in judged.values()), strict=True))
    return Verdict(worst, "; ".join(texts), "; ".join(pages))
