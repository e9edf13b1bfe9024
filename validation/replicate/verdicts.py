"""Verdicts: whether our numbers agree with the printed ones, how much that says, and known reasons.

The rules are here, each stated once. `verdicts.toml` beside this module declares what each row is
evidence of, what words of the thesis are taken to mean, and the known reasons, each with the page
of docs/ that shows it. A difference without a known reason is called unexplained.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Literal, NamedTuple, get_args

import numpy as np

from ssmr.parameters import Scale

FACTOR = 1.5
"""Greatest ratio of two distances that agree."""
RATIO_REACH = 0.01
"""Greatest difference of two ratios of lengths that agree [1]."""
SPREADS = 2.0
"""Numbers of a search agree within this many standard deviations, or standard errors, of ours."""
TOO_WIDE = 0.5
"""Share of a search's range [1]: a number whose interval of `SPREADS` to either side covers more
tells nothing."""
AT_BOUND = 0.05
"""Share of a search's range [1]: a number, ours or the printed one, that is so near to an end tells
where the end is."""
UNCONVERGED = "its fit did not converge"
"""Beginning of the obstacle to comparing what rests on a fit from which more can be reached."""
_ROUNDING = 1.0 + 1e-9
"""Factor of all limits, for rounding."""

Rule = Literal["distance", "ratio", "spread", "words", "none"]
"""Rule by which two numbers are compared. `distance` compares by their ratio, `ratio` by their
difference because one is perfect, `spread` by the uncertainty of ours. `words` is for what the
thesis says in words: ours must lie within what they are taken to mean. `none` compares nothing and
shows the number for the record."""
RULE_OF: Mapping[str, Rule] = {"d_rms_m": "distance", "d_haus_m": "distance", "d_ratio": "ratio"}
"""Rules of the metrics of a path, whatever table they stand in."""
Status = Literal["agrees", "agrees if", "not told apart", "nearer", "differs", "not compared"]
"""`not told apart`: ours is so uncertain that agreement would say nothing. `nearer`: it differs,
but a distance of ours is smaller than the printed one. `agrees if`: a row that does not agree as
printed, but in every number under one supposition about what the thesis does not print."""
STATUSES: tuple[Status, ...] = get_args(Status)
_WORSE = ("not compared", "agrees", "not told apart", "nearer", "differs")
Evidence = Literal["independent", "fitted", "recovered", "duplicate", "impossible"]
"""Classes of evidence of a row that agrees. `independent`: nothing of ours was fitted to it.
`fitted`: it rests on an assumption, or on numbers chosen with it in view. `recovered`: what was put
in comes out. `duplicate`: it repeats a row. `impossible`: the thesis or this project has no number,
or the path is unknown."""
EVIDENCE: tuple[Evidence, ...] = get_args(Evidence)
UNEXPLAINED = "unexplained"
"""Reason of a difference for which no reason is known."""


SUPPOSED_ON = "tracking.md"


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
    supposed: Pair | None = None
    """The printed number beside ours under a supposition about what the thesis does not print; None
    where nothing is supposed."""
    supposition: str = ""
    """Words that say what is supposed, equal for all numbers of a row: a report puts them behind
    "it agrees if". The page `SUPPOSED_ON` of docs/ shows why."""
    bounds: Sequence[float] = ()
    """Ends of the range in which ours was searched; empty for a number that was not."""
    scale: Scale = "linear"
    """Scale of that range."""
    printed_bounds: Sequence[float] = ()
    """Ends of the range in which the thesis searched."""

    @property
    def is_given(self) -> bool:
        """Return whether the thesis gives it, in numbers or in words."""
        return self.published is not None or self.rule == "words"


Rows = Mapping[str, Mapping[str, Pair]]
"""A table of the thesis beside ours: by row and metric, which are named as in `published.toml`."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An entry of `verdicts.toml`: a criterion of rows, or a reason why numbers differ.

    A criterion has `evidence` and `within`, a reason the fields that follow these.
    """

    tables: Sequence[str]
    """Numbers of the tables that it is about."""
    rows: Sequence[str] = ()
    """Names of the rows, empty for all; one that ends in `*` means all that begin so."""
    metrics: Sequence[str] = ()
    """Names of the metrics, empty for all."""
    evidence: Evidence = "impossible"
    """Class of evidence that the rows' agreement would be."""
    within: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Least and greatest value by metric that words of the thesis are taken to mean."""
    text: str = ""
    """Reason in words, without a full stop."""
    see: str = ""
    """Page of docs/ that shows it, perhaps with the number of an erratum: `errata.md, 30`."""
    when: Sequence[Status] = ()
    """Verdicts that it explains, empty for all."""
    comparable: bool = True
    """Whether the numbers can still be compared."""

    def concerns(self, table: str, row: str, metric: str = "") -> bool:
        """Return whether it is about this number, or about this row."""
        if table not in self.tables or (self.metrics and metric not in self.metrics):
            return False
        return not self.rows or any(fnmatchcase(row, name) for name in self.rows)


class Verdict(NamedTuple):
    """The verdict on a number, or on a row of numbers."""

    status: Status
    """Verdict in a word."""
    reason: str = ""
    """Reason why it differs or cannot be compared; empty if it agrees."""
    see: str = ""
    """Page of docs/ that shows it."""


class JudgedRow(NamedTuple):
    """A row of a table with its verdicts."""

    table: str
    """Number of the table."""
    name: str
    """Name of the row."""
    pairs: Mapping[str, Pair]
    """Its numbers by metric."""
    verdicts: Mapping[str, Verdict]
    """The verdicts on them."""
    whole: Verdict
    """The verdict on the row."""
    criterion: Entry
    """The kind of evidence that a row is."""

    @property
    def is_printed(self) -> bool:
        """Whether the thesis has it, though its numbers may be lost; others are for the record."""
        return any(
            pair.is_given or self.verdicts[metric].see for metric, pair in self.pairs.items()
        )


@cache
def entries_of(kind: Literal["criterion", "reason"]) -> tuple[Entry, ...]:
    """Return the entries of a kind; the first that fits is the one that counts."""
    file = resources.files("validation.replicate") / "verdicts.toml"
    declared = tomllib.loads(file.read_text(encoding="utf-8"))
    return tuple(Entry(**entry) for entry in declared[kind])


def criterion_of(table: str, row: str) -> Entry:
    """The criterion of a row; without a declaration, that of a number that the thesis lacks."""
    matching = (c for c in entries_of("criterion") if c.concerns(table, row))
    return next(matching, Entry(tables=(table,), rows=(row,)))


def _share_of_range(value: float, bounds: Sequence[float], scale: Scale = "linear") -> float:
    """Return where a number lies in its search's range, from 0 to 1 on the scale of the search."""
    ends = np.array([*bounds, value])
    if scale == "log":
        ends = np.log(np.maximum(ends, np.finfo(float).tiny))
    lower, upper, place = ends.tolist()
    return (place - lower) / (upper - lower)


def at_bound(value: float | None, bounds: Sequence[float], scale: Scale = "linear") -> bool:
    """Whether a number lies at an end of its search's range; never without one, or outside it."""
    if value is None or not bounds:
        return False
    share = _share_of_range(value, bounds, scale)
    inside = min(share, 1.0 - share)
    return 1.0 - _ROUNDING <= inside <= AT_BOUND


def _compare_numbers(pair: Pair, within: Sequence[float] = ()) -> Status:
    """Return the verdict on two numbers that can be compared; `within` are the limits of words."""
    ours = pair.ours
    assert ours is not None
    reach = SPREADS * (pair.spread or 0.0) * _ROUNDING
    low, high = within or (pair.published, pair.published)
    assert low is not None
    assert high is not None
    apart = max(low - ours, ours - high, 0.0)
    agrees = apart == 0.0
    if pair.rule == "spread":
        agrees = apart <= reach
        if pair.bounds:
            ends = (
                _share_of_range(x, pair.bounds, pair.scale) for x in (ours - reach, ours + reach)
            )
            least, most = np.clip(list(ends), 0.0, 1.0)
            if most - least > TOO_WIDE:
                return "not told apart"
    elif pair.rule == "ratio":
        agrees = apart <= RATIO_REACH * _ROUNDING
    elif pair.rule == "distance":
        least, most = sorted((abs(ours), abs(low)))
        agrees = most <= FACTOR * least * _ROUNDING
    if agrees:
        return "agrees"
    if apart <= reach:
        return "not told apart"
    if pair.rule == "distance" and ours < low:
        return "nearer"
    return "differs"


def judge_number(
    table: str, row: str, metric: str, pair: Pair, known: Sequence[Entry] | None = None
) -> Verdict:
    """Return the verdict on one number of ours.

    Reasons are `known` or, if not given, those of `verdicts.toml`.
    """
    every = entries_of("reason") if known is None else known
    about = [reason for reason in every if reason.concerns(table, row, metric)]
    obstacle = _find_obstacle(pair, about)
    if obstacle is not None:
        return obstacle
    status = _compare_numbers(pair, criterion_of(table, row).within.get(metric, ()))
    if status == "agrees":
        return Verdict(status)
    if status == "not told apart":
        return Verdict(status, "ours is too uncertain")
    for reason in about:
        if not reason.when or status in reason.when:
            return Verdict(status, reason.text, reason.see)
    return Verdict(status, UNEXPLAINED)


def _find_obstacle(pair: Pair, about: Sequence[Entry]) -> Verdict | None:
    """Return the verdict on a number that cannot be compared; None for one that can be."""
    text = pair.obstacle
    see = ""
    if not text:
        lost = next((reason for reason in about if not reason.comparable), None)
        if lost is not None:
            text = lost.text
            see = lost.see
        elif not pair.is_given:
            text = "the thesis prints no number"
        elif pair.rule == "none" or pair.ours is None:
            text = "shown for the record"
        elif at_bound(pair.ours, pair.bounds, pair.scale):
            text = "ours lies at a bound of its search"
        elif at_bound(pair.published, pair.printed_bounds):
            text = "the printed number lies at a bound of its search"
    return Verdict("not compared", text, see) if text else None


def judge_row(pairs: Mapping[str, Pair], verdicts: Mapping[str, Verdict]) -> Verdict:
    """Return the verdict on a row from those on its numbers by metric: that of its worst number.

    Only the numbers which the thesis gives count; where it gives none, those that are lost; else
    all. Numbers that cannot be compared count only if none can.
    """
    given = {m: v for m, v in verdicts.items() if pairs[m].is_given and pairs[m].rule != "none"}
    counted = given or {m: v for m, v in verdicts.items() if v.see} or verdicts
    judged = {m: v for m, v in counted.items() if v.status != "not compared"} or counted
    worst = max((v.status for v in judged.values()), key=_WORSE.index)
    supposition = pairs[next(iter(judged))].supposition
    if supposition and worst in _WORSE[2:] and all(_agrees_if(pairs[m]) for m in judged):
        return Verdict("agrees if", f"it agrees if {supposition}", SUPPOSED_ON)
    texts = dict.fromkeys(v.reason for v in judged.values() if v.reason)
    pages = dict.fromkeys(v.see for v in judged.values() if v.see)
    return Verdict(worst, "; ".join(texts), "; ".join(pages))


def _agrees_if(pair: Pair) -> bool:
    """Whether our number agrees under its supposition."""
    return pair.supposed is not None and _compare_numbers(pair.supposed) == "agrees"


def judged_rows(tables: Mapping[str, Rows]) -> list[JudgedRow]:
    """Return every row of some tables with its verdicts."""
    judged = []
    for number, rows in tables.items():
        for name, pairs in rows.items():
            verdicts = {m: judge_number(number, name, m, pair) for m, pair in pairs.items()}
            whole = judge_row(pairs, verdicts)
            row = JudgedRow(number, name, pairs, verdicts, whole, criterion_of(number, name))
            judged.append(row)
    return judged
