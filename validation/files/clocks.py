"""One clock for a bag: the stamps of its messages, or the times of writing brought onto them.

A message has two stamps: the header's, when it was measured, and the bag's, when it was written.
Headers count wherever the topics that have them share a clock, whatever its origin and its rate: a
simulation's runs slower than the time of writing. What has no stamps is brought onto that clock.
"""

from __future__ import annotations

import math
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
_FROZEN = "the stamps of all messages are equal"
_PROMPT = 98.0
"""Percentile of a topic's stamps less its times of writing that stands for the difference of the
two clocks: writing is never early, and single stamps may be wrong."""
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
    def least_late(self) -> float:
        """How far the stamps are ahead of writing where that was hardly late [s]."""
        return float(np.percentile(self.ahead, _PROMPT))

    @property
    def rate(self) -> float:
        """Seconds of the clock in a second of writing; one jump does not matter."""
        apart = max(1, len(self.written) // _PAIRS)
        spans = np.maximum(self.written[apart:] - self.written[:-apart], 1)
        steps = self.header[apart:] - self.header[:-apart]
        return float(np.median(steps / spans)) if len(spans) else 1.0

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
    without = {k: why for k, (_, header) in enumerate(stamps) if (why := _why_not(header))}
    clocks = {}
    for k, (written, header) in enumerate(stamps):
        if k not in without:
            clocks[k] = _Clock(written[header != 0], header[header != 0])
    sharing = {}
    for k, clock in clocks.items():
        sharing[k] = [j for j, other in clocks.items() if clock.is_shared(other)]

    def rank(k: int) -> tuple[bool, int, int, int]:
        ahead = abs(float(np.median(clocks[k].ahead)))
        return not clocks[k].jumps, len(sharing[k]), -round(ahead), len(clocks[k].header)

    lead = max(clocks, key=rank, default=-1)
    if lead < 0 or not _believed(clocks[lead], len(sharing[lead])):
        jumps = "the clock of the messages jumps"
        told = [without.get(k, jumps) for k in range(len(stamps))]
        return [_written(w, w, what) for (w, _), what in zip(stamps, told, strict=True)], ""
    first = clocks[lead]
    # that of the clocks themselves: each topic is written late in its own way, and none early
    ahead = max(clocks[k].least_late for k in sharing[lead])
    sentence = ""
    if abs(first.rate - 1.0) * float(np.ptp(first.written)) * 1e-9 > _SAME_CLOCK:
        sentence = (
            f"the stamps of {', '.join(names[k] for k in sharing[lead])} share a clock that runs "
            f"{first.rate:.4g} times as fast as the time of writing, as a simulation's does: it "
            "counts, and what has no stamps is brought onto it"
        )
    timed = []
    for k, (written, header) in enumerate(stamps):
        if k in without:
            timed.append(_written(written, _bring_onto(written, first, ahead), without[k]))
        elif k in sharing[lead] and first.goes_with(clocks[k]):
            timed.append(Timed(header != 0, clocks[k].header))
        else:
            timed.append(_corrected(names[k], header != 0, clocks[k], first))
    return timed, sentence


def _why_not(header: Stamps) -> str:
    """Return why stamps, 0 for none, are no clock; empty where they may be one."""
    has = header[header != 0]
    if 2 * len(has) <= len(header):
        return _NO_STAMPS
    return _FROZEN if len(has) > 1 and not np.ptp(has) else ""


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

    A clock that keeps its distance is `ahead` of writing by that many seconds.
    """
    if np.ptp(np.percentile(clock.ahead, (2.0, 98.0))) < _STEADY:
        # so that late writing of that topic moves nothing
        whole = math.floor(ahead)
        return at + whole * 1_000_000_000 + round((ahead - whole) * 1e9)
    x = (clock.written - clock.written[0]).astype(np.float64)
    y = np.maximum.accumulate(clock.header - clock.header[0]).astype(np.float64)
    t = (at - clock.written[0]).astype(np.float64)
    beyond = t - np.clip(t, x[0], x[-1])
    return clock.header[0] + np.rint(np.interp(t, x, y) + clock.rate * beyond).astype(np.int64)


def _corrected(name: str, kept: BoolArray, clock: _Clock, first: _Clock) -> Timed:
    """Return a topic of another clock: with its own stamps if only the origins differ."""
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
    return Timed(
        kept, _bring_onto(clock.written, first, first.least_late), remark, f"{name}: {remark}"
    )
