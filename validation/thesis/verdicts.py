"""When a number of ours agrees with a printed one, and what is known about those that do not.

The rules are here, each stated once; the known reasons are in ``verdicts.toml`` beside this module, each with the page of
docs/ that shows it. A difference without a known reason is called unexplained.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Literal, get_args

SCHEMA = "ssmr.verdicts/1"
FACTOR = 1.5
"""Distances within this factor of each other, either way, agree."""
RATIO_REACH = 0.01
"""Ratios of lengths within this of each other agree [1]."""
SPREADS = 2.0
"""So many standard deviations, or standard errors, of ours agree too, where they are known."""
ROUNDING = 1e-9
"""Relative; what is no more than this beyond a limit is at it."""

Rule = Literal["distance", "ratio", "spread", "at_least", "none"]
"""`distance`: positive, the smaller the nearer. `ratio`: one is perfect. `spread`: a parameter, a gain, a change, which only
its own uncertainty can judge. `at_least`: the thesis says in words that it is large, and `beside["at_least"]` is what that
is taken to mean. `none`: shown for the record."""
Status = Literal["agrees", "nearer", "differs", "not compared"]
"""`nearer`: it differs, to the better: a distance of ours is smaller than the printed one."""
STATUSES: tuple[Status, ...] = get_args(Status)

RULES: Mapping[Rule, str] = {
    "distance": f"a distance agrees within a factor of {FACTOR:g} either way; a smaller one is called nearer",
    "ratio": f"a ratio of lengths agrees within {RATIO_REACH:g}",
    "spread": f"a parameter or a gain agrees within {SPREADS:g} standard errors, or standard deviations over seeds",
    "at_least": "what the thesis says in words agrees if ours is at least what the words are taken to mean",
}
"""The rules in words. Where ours has a spread, distances and ratios within two standard deviations agree too: what is
printed is a single run."""


@dataclass(frozen=True)
class Pair:
    """A printed number beside ours."""

    published: float | None
    """None where the thesis has none."""
    ours: float | None
    """None where there is none to compare."""
    rule: Rule
    """How they are judged."""
    unit: str = "1"
    """Of both."""
    spread: float | None = None
    """Standard error or standard deviation of ours; None where it is not known."""
    beside: Mapping[str, float] = field(default_factory=dict)
    """More numbers of ours, for the record, by name."""
    obstacle: str = ""
    """Why they cannot be compared, as the run itself found; empty where they can."""

    def __post_init__(self) -> None:
        """Check.

        Raises:
            ValueError: an unknown rule, or a number that is not finite.
        """
        if self.rule not in get_args(Rule):
            raise ValueError(f"unknown rule '{self.rule}'; there are: {', '.join(get_args(Rule))}")
        for number in (self.published, self.ours, self.spread, *self.beside.values()):
            if number is not None and not math.isfinite(number):
                raise ValueError(f"{number} is no number to compare; None says that there is none")


@dataclass(frozen=True)
class Reason:
    """What is known about numbers that differ, or cannot be compared."""

    tables: tuple[str, ...]
    """Numbers of tables it is about."""
    text: str
    """In words, without a full stop."""
    see: str
    """Page of docs/ that shows it, perhaps with the number of an erratum: `errata.md, 30`."""
    rows: tuple[str, ...] = ()
    """Only these rows; empty for all. One that ends in `*` means all that begin so."""
    metrics: tuple[str, ...] = ()
    """Only these metrics; empty for all."""
    when: tuple[Status, ...] = ()
    """Only for these verdicts; empty for all."""
    comparable: bool = True
    """Whether the numbers can be compared in spite of it."""

    def concerns(self, table: str, row: str, metric: str) -> bool:
        """Whether it is about this number."""
        named = any(row == r or (r.endswith("*") and row.startswith(r[:-1])) for r in self.rows)
        return table in self.tables and (named or not self.rows) and (metric in self.metrics or not self.metrics)


@dataclass(frozen=True)
class Verdict:
    """How a number of ours, or a row of them, stands to the print."""

    status: Status
    """In a word."""
    reason: str = ""
    """Why it differs or cannot be compared; empty where it agrees."""
    see: str = ""
    """Page of docs/ that shows it."""


UNEXPLAINED = "unexplained"
"""Said where no reason is known."""


@cache
def reasons() -> tuple[Reason, ...]:
    """All known reasons, in the order in which they are asked.

    Raises:
        ValueError: the file is of another schema than this module reads.
    """
    data = tomllib.loads(resources.files("validation.thesis").joinpath("verdicts.toml").read_text(encoding="utf-8"))
    if data.get("schema") != SCHEMA:
        raise ValueError(f"verdicts.toml has schema {data.get('schema')!r}, expected {SCHEMA!r}")
    return tuple(map(_reason, data["reason"]))


def _reason(entry: Mapping[str, Any]) -> Reason:
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
    return Reason(**values)


def agrees(pair: Pair) -> bool:
    """Whether two numbers that can be compared agree, by the pair's rule."""
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
    """How one number of ours stands to the print.

    Args:
        table: the table's number.
        row: of the table.
        metric: of the row.
        pair: the numbers.
        known: reasons to look among; all of `verdicts.toml` if not given.
    """
    about = [r for r in (reasons() if known is None else known) if r.concerns(table, row, metric)]
    barred = next((Verdict("not compared", r.text, r.see) for r in about if not r.comparable), None)
    if pair.obstacle:
        return Verdict("not compared", pair.obstacle)
    if barred is not None:
        return barred
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
    """How a row of numbers stands to the print."""

    status: Status
    """That of its worst number; what cannot be compared decides only where nothing can."""
    because: tuple[tuple[tuple[str, ...], Verdict], ...]
    """Its reasons, each with the metrics that it is about: none where it is about all of them."""

    @property
    def reason(self) -> str:
        """All reasons in words, each with its metrics."""
        about = (", ".join(map(short, metrics)) + ": " if metrics else "" for metrics, _ in self.because)
        return "; ".join(which + v.reason for which, (_, v) in zip(about, self.because, strict=True))

    @property
    def see(self) -> str:
        """All pages of docs/ that show them."""
        return "; ".join(dict.fromkeys(v.see for _, v in self.because if v.see))


def of_row(verdicts: Mapping[str, Verdict]) -> RowVerdict:
    """The verdict on a row.

    Args:
        verdicts: on its numbers, by metric; at least one.
    """
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


def short(metric: str) -> str:
    """A metric's name without its unit's suffix."""
    for suffix in ("_m", "_s", "_percent", "_1"):
        if metric.endswith(suffix):
            return metric.removesuffix(suffix)
    return metric
