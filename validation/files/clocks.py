"""One clock for a bag: the stamps of its messages, or the times of writing brought onto them.

A message has two stamps: the header's, when it was measured, and the bag's, when it was written.
Headers count wherever the topics that have them share a clock, whatever its origin and its rate: a
simulation's runs slower than the time of writing. What has no stamps is brought onto that clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.files.signals import BoolArray

_SAME_CLOCK = 1.0
"""Difference of two topics' stamps, each less the times of writing, below which they share a clock
[s]: writing is late by less."""
_STEADY = 0.5
"""Change of such a difference below which only the clocks' origins differ [s]."""
_LATE_SHARE = 0.1
"""Share of messages that may be written that late, as those are that are kept for later [1]."""
_NO_STAMPS = "the messages have no stamps"
_FROZEN = "the stamps of the messages stand still"
_PROMPT = 98.0
"""Percentile of stamps, less their times of writing, that stands for the difference of the two
clocks: writing is never early, and single stamps may be wrong."""
_PAIRS = 4
"""Pairs of samples that are this part of a topic apart tell the rate of its clock."""

Stamps = NDArray[np.int64]
"""(M,) stamps [ns]."""


class Timed(NamedTuple):
    """The messages of a topic on the clock of their bag."""

    kept: BoolArray
    """(N,) which messages count: of a topic with stamps, those that have one."""
    ns: Stamps
    """(M,) stamps of the messages that count [ns]."""
    remark: str = ""
    """Why these are not the messages' own stamps; empty where they are."""
    fault: str = ""
    """Sentence on a clock that is not that of the other topics."""


class _Clock(NamedTuple):
    """The stamps of a topic's messages, and when they were written, M of them [ns]."""

    written: Stamps
    header: Stamps

    @property
    def ahead(self) -> FloatArray:
        """(M,) times by which the stamps are ahead of writing [s]."""
        return (self.header - self.written).astype(np.float64) * 1e-9

    def ahead_at(self, written: Stamps) -> FloatArray:
        """Return the (K,) times by which they are ahead at other times of writing [s]."""
        origin = self.written[0]
        at = (written - origin).astype(np.float64)
        return np.interp(at, (self.written - origin).astype(np.float64), self.ahead)

    @property
    def rate(self) -> float:
        """Seconds of the clock in a second of writing; one jump does not matter."""
        apart = max(1, len(self.written) // _PAIRS)
        spans = np.maximum(self.written[apart:] - self.written[:-apart], 1)
        steps = self.header[apart:] - self.header[:-apart]
        return float(np.median(steps / spans)) if len(spans) else 1.0

    @property
    def steady_rate(self) -> float:
        """The rate by the messages of either half that were written least late."""
        if len(self.header) < 2:
            return self.rate
        since = (self.written - self.written[0]).astype(np.float64)
        off = self.header - self.header[0] - self.rate * since
        ends = [np.percentile(half, _PROMPT) for half in np.array_split(off, 2)]
        middles = [np.mean(half) for half in np.array_split(since, 2)]
        return self.rate + float(np.diff(ends)[0] / max(np.diff(middles)[0], 1.0))

    def on_line(self, written: Stamps) -> Stamps:
        """Return the (K,) stamps at other times of writing, at a constant rate from the first."""
        since = (written - self.written[0]).astype(np.float64)
        return self.header[0] + np.rint(self.steady_rate * since).astype(np.int64)

    def above_line(self, *others: _Clock) -> FloatArray:
        """Return how far the stamps of topics lie above that line, least and most [s].

        Single stamps may be wrong, and do not count.
        """
        off = [other.header - self.on_line(other.written) for other in others]
        return np.percentile(np.concatenate(off) * 1e-9, (100.0 - _PROMPT, _PROMPT))

    @property
    def jumps(self) -> bool:
        """True if it jumps; a message that is only written late does not."""
        steps = np.diff(self.header) - self.rate * np.diff(self.written)
        return float(np.max(np.abs(steps), initial=0.0)) * 1e-9 >= _SAME_CLOCK

    def is_shared(self, other: _Clock) -> bool:
        """Return whether another topic has the same clock while both were written."""
        inside = (other.written >= self.written[0]) & (other.written <= self.written[-1])
        if not np.any(inside):
            inside[:] = True
        apart = other.ahead[inside] - self.ahead_at(other.written[inside])
        return float(np.median(np.abs(apart))) < _SAME_CLOCK

    def goes_with(self, other: _Clock) -> bool:
        """Return whether another topic's clock stays with it; single messages may be late."""
        apart = other.ahead - self.ahead_at(other.written)
        return bool(np.mean(np.abs(apart - np.median(apart)) > _SAME_CLOCK) < _LATE_SHARE)


def on_one_clock(
    names: Sequence[str], stamps: Sequence[tuple[Stamps, Stamps]]
) -> tuple[list[Timed], str]:
    """Return the topics of a bag on one clock, and a sentence on that clock if it is unusual.

    Args:
        names: names of the topics.
        stamps: of each topic the (N,) times of writing and the (N,) stamps of its messages, 0 for
            none [ns].
    """
    clocks, without = _clocks_of(stamps)
    sharing = {}
    for k, clock in clocks.items():
        sharing[k] = [j for j, other in clocks.items() if clock.is_shared(other)]

    def rank(k: int) -> tuple[bool, int, float, int]:
        # of all that share the clock, so that its origin does not choose among them
        ahead = min(abs(float(np.median(clocks[j].ahead))) for j in sharing[k])
        return not clocks[k].jumps, len(sharing[k]), -ahead, len(clocks[k].header)

    lead = max(clocks, key=rank, default=-1)
    if lead < 0 or not _believed(clocks[lead], len(sharing[lead])):
        jumps = "the clock of the messages jumps"
        told = [without.get(k, jumps) for k in range(len(stamps))]
        return [_written(w, w, what) for (w, _), what in zip(stamps, told, strict=True)], ""
    first = clocks[lead]
    # each topic is written late in its own way, and none early
    ahead = float(first.above_line(*(clocks[k] for k in sharing[lead]))[1])
    sentence = ""
    if abs(first.rate - 1.0) * float(np.ptp(first.written)) * 1e-9 > _SAME_CLOCK:
        sentence = (
            f"the stamps of {', '.join(names[k] for k in sharing[lead])} share a clock that runs "
            f"{first.rate:.4g} times as fast as the time of writing, as a simulation's does: it "
            "counts, and what has no stamps is brought onto it"
        )
    timed = []
    for k, (written, header) in enumerate(stamps):
        brought = _bring_onto(written, first, ahead)
        if k in without:
            timed.append(_written(written, brought, without[k]))
        elif k in sharing[lead] and first.goes_with(clocks[k]):
            timed.append(Timed(header != 0, clocks[k].header))
        else:
            timed.append(_correct_clock(names[k], header != 0, clocks[k], first, brought))
    return timed, sentence


def _clocks_of(
    stamps: Sequence[tuple[Stamps, Stamps]],
) -> tuple[dict[int, _Clock], dict[int, str]]:
    """Return the clocks of the topics that have one, and why the others have none, by topic."""
    clocks = {}
    without = {}
    for k, (written, header) in enumerate(stamps):
        has = header != 0
        clock = _Clock(written[has], header[has])
        if 2 * np.count_nonzero(has) <= len(has):
            without[k] = _NO_STAMPS
        elif clock.rate <= 0.0:
            without[k] = _FROZEN
        else:
            clocks[k] = clock
    return clocks, without


def _written(written: Stamps, ns: Stamps, remark: str) -> Timed:
    """Return a topic whose messages all count, at stamps that are not their own."""
    return Timed(np.ones(len(written), dtype=bool), ns, remark)


def _believed(clock: _Clock, sharing: int) -> bool:
    """Return whether a clock counts that so many topics share: it may pause, but not go back."""
    if sharing > 1:
        return float(np.min(np.diff(clock.header), initial=0.0)) * 1e-9 > -_SAME_CLOCK
    return not clock.jumps


def _bring_onto(at: Stamps, clock: _Clock, ahead: float) -> Stamps:
    """Return the (K,) stamps by another topic's clock of what was written `at`.

    Where that clock keeps its rate, the stamps are `ahead` of its line by that many seconds.
    """
    if np.ptp(clock.above_line(clock)) < _STEADY:
        # so that late writing of that topic moves nothing
        return clock.on_line(at) + round(ahead * 1e9)
    x = (clock.written - clock.written[0]).astype(np.float64)
    y = np.maximum.accumulate(clock.header - clock.header[0]).astype(np.float64)
    t = (at - clock.written[0]).astype(np.float64)
    beyond = t - np.clip(t, x[0], x[-1])
    return clock.header[0] + np.rint(np.interp(t, x, y) + clock.rate * beyond).astype(np.int64)


def _correct_clock(
    name: str, kept: BoolArray, clock: _Clock, first: _Clock, brought: Stamps
) -> Timed:
    """Return a topic of another clock: with its own stamps if only the origins differ.

    Otherwise it has those that were `brought` onto the first clock.
    """
    others = first.ahead_at(clock.written)
    difference = clock.ahead - others
    usual = float(np.median(difference))
    steady = np.ptp(np.percentile(difference, (2.0, 98.0))) < _STEADY
    if steady and first.goes_with(clock):
        way = "ahead of" if usual > 0.0 else "behind"
        fault = (
            f"the stamps of {name} are {abs(usual):.4g} s {way} those of the other topics: header "
            f"less time of writing is {np.median(clock.ahead) + 0.0:.3f} s, elsewhere "
            f"{np.median(others) + 0.0:.3f} s; the difference was taken out"
        )
        return Timed(kept, clock.header - round(usual * 1e9), fault=fault)
    remark = "the messages' clock jumps, or runs at another rate than that of the other topics"
    return Timed(kept, brought[kept], remark, f"{name}: {remark}")
