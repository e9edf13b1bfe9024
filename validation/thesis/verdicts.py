"""Verdicts: whether a number of ours agrees with the printed one, and the known reasons where it does not.

The rules are here, each stated once. The known reasons are in ``verdicts.toml`` beside this module, each with the page of
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
Status = Literal["agrees", "nearer", "differs", "not compared"]
"""`nearer`: it differs, but a distance of ours is smaller than the printed one."""
STATUSES: tuple[Status, ...] = get_args(Status)

RULES: Mapping[Rule, str] = {
    "distance": f"a distance agrees within a factor of {FACTOR:g} either way; a smaller one is called nearer",
    "ratio": f"a ratio of lengths agrees within {RATIO_REACH:g}",
    "spread": f"a parameter or a gain agrees within {SPREADS:g} standard errors, or standard deviations over seeds",
    "at_least": "what the thesis says in words agrees if ours is at least what the words are taken to mean",
}
"""The rules in words. Where ours has a spread, distances and ratios within two standard deviations agree too, since the
thesis prints a single run."""


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

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown rule, or a number that is not finite."""
        if self.rule not in get_args(Rule):
            raise ValueError(f"unknown rule '{self.rule}'; there are: {', '.join(get_args(Rule))}")
        for number in (self.published, self.ours, self.spread, *self.beside.values()):
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


def short(metric: str) -> str:
    """Return a metric's name without the suffix of its unit."""
    for suffix in ("_m", "_s", "_percent", "_1"):
        if metric.endswith(suffix):
            return metric.removesuffix(suffix)
    return metric
