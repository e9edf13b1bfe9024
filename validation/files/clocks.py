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


def on_one_clock(
    names: Sequence[str], stamps: Sequence[tuple[Stamps, Stamps]]
) -> tuple[list[Timed], str]:
    """Return the topics of a bag on one clock, and a sentence on that clock if it is unusual.

    Args:
        names: names of the topics.
        stamps: of each topic the (N,) times of writing and the (N,) stamps of its messages, 0 for
            none [ns].
    """
    stamped = {}
    for k, (written, header) in enumerate(stamps):
        has = header != 0
        if 2 * np.count_nonzero(has) > len(has):
            stamped[k] = written[has], header[has]
    sharing = {}
    for k, one in stamped.items():
        sharing[k] = [j for j, other in stamped.items() if _differ(one, other) < _SAME_CLOCK]

    def rank(k: int) -> tuple[bool, int, int, int]:
        written, header = stamped[k]
        ahead = abs(float(np.median(header - written))) * 1e-9
        return not _jumps(*stamped[k]), len(sharing[k]), -round(ahead), len(header)

    lead = max(stamped, key=rank, default=-1)
    if lead < 0 or not _believed(*stamped[lead], len(sharing[lead])):
        timed = [_as_written(k, written, k in stamped) for k, (written, _) in enumerate(stamps)]
        return timed, ""
    clock = stamped[lead]
    rate = _rate(*clock)
    sentence = ""
    if abs(rate - 1.0) * float(np.ptp(clock[0])) * 1e-9 > _SAME_CLOCK:
        sentence = (
            f"the stamps of {', '.join(names[k] for k in sharing[lead])} share a clock that runs "
            f"{rate:.4g} times as fast as the time of writing, as a simulation's does: it counts, "
            "and what has no stamps is brought onto it"
        )
    timed = []
    for k, (written, header) in enumerate(stamps):
        if k not in stamped:
            remark = "the messages have no stamps"
            all_of_them = np.ones(len(written), dtype=bool)
            timed.append(Timed(all_of_them, _brought(written, *clock), remark))
        elif k in sharing[lead] and _goes_with(clock, *stamped[k]):
            timed.append(Timed(header != 0, stamped[k][1]))
        else:
            timed.append(_corrected(names[k], header != 0, stamped[k], clock))
    return timed, sentence


def _as_written(k: int, written: Stamps, stamped: bool) -> Timed:
    remark = "the clock of the messages jumps" if stamped else "the messages have no stamps"
    return Timed(np.ones(len(written), dtype=bool), written, remark)


def _ahead(written: Stamps, header: Stamps, at: Stamps) -> FloatArray:
    """Return the (K,) seconds by which a topic's stamps are ahead of the times of writing `at`."""
    origin = written[0]
    ahead = (header - written).astype(np.float64) * 1e-9
    return np.interp((at - origin).astype(np.float64), (written - origin).astype(np.float64), ahead)


def _differ(one: tuple[Stamps, Stamps], other: tuple[Stamps, Stamps]) -> float:
    """Return the median difference of two topics' clocks while both were written [s]."""
    written, header = other
    inside = (written >= one[0][0]) & (written <= one[0][-1])
    if not np.any(inside):
        inside[:] = True
    ahead = (header - written)[inside].astype(np.float64) * 1e-9
    return float(np.median(np.abs(ahead - _ahead(*one, written[inside]))))


def _rate(written: Stamps, header: Stamps) -> float:
    """Return the seconds of a topic's clock in a second of writing; one jump does not matter."""
    apart = max(1, len(written) // _PAIRS)
    spans = np.maximum(written[apart:] - written[:-apart], 1)
    return float(np.median((header[apart:] - header[:-apart]) / spans)) if len(spans) else 1.0


def _jumps(written: Stamps, header: Stamps) -> bool:
    """Return whether a topic's clock jumps; a message that is only written late does not."""
    steps = np.diff(header) - _rate(written, header) * np.diff(written)
    return float(np.max(np.abs(steps), initial=0.0)) * 1e-9 >= _SAME_CLOCK


def _believed(written: Stamps, header: Stamps, sharing: int) -> bool:
    """Return whether a clock counts that so many topics share: it may pause, but not go back."""
    if sharing > 1:
        return float(np.min(np.diff(header), initial=0.0)) * 1e-9 > -_SAME_CLOCK
    return not _jumps(written, header)


def _goes_with(clock: tuple[Stamps, Stamps], written: Stamps, header: Stamps) -> bool:
    """Return whether a topic's clock stays with another one; single messages may be late."""
    ahead = (header - written).astype(np.float64) * 1e-9 - _ahead(*clock, written)
    off = np.abs(ahead - np.median(ahead)) > _SAME_CLOCK
    return bool(np.mean(off) < _LATE_SHARE)


def _brought(at: Stamps, written: Stamps, header: Stamps) -> Stamps:
    """Return the (K,) stamps by another topic's clock of what was written `at`."""
    ahead = (header - written).astype(np.float64) * 1e-9
    usual = float(np.median(ahead))
    if np.ptp(np.percentile(ahead, (2.0, 98.0))) < _STEADY:
        # so that late writing of that topic moves nothing
        return at + round(usual) * 1_000_000_000
    origin = written[0]
    x = (written - origin).astype(np.float64)
    y = np.maximum.accumulate(header - header[0]).astype(np.float64)
    rate = _rate(written, header)
    t = (at - origin).astype(np.float64)
    inside = np.clip(t, x[0], x[-1])
    return header[0] + np.rint(np.interp(inside, x, y) + rate * (t - inside)).astype(np.int64)


def _corrected(
    name: str, kept: BoolArray, stamps: tuple[Stamps, Stamps], clock: tuple[Stamps, Stamps]
) -> Timed:
    """Return a topic of another clock: with its own stamps if only the origins differ."""
    written, header = stamps
    ahead = (header - written).astype(np.float64) * 1e-9
    others = _ahead(*clock, written)
    difference = ahead - others
    usual = float(np.median(difference))
    if np.ptp(np.percentile(difference, (2.0, 98.0))) < _STEADY and _goes_with(clock, *stamps):
        way = "ahead of" if usual > 0.0 else "behind"
        fault = (
            f"the stamps of {name} are {abs(usual):.4g} s {way} those of the other topics: header "
            f"less time of writing is {_seconds(ahead)}, elsewhere {_seconds(others)}; "
            "the difference was taken out"
        )
        return Timed(kept, header - round(usual * 1e9), fault=fault)
    remark = "the messages' clock jumps, or runs at another rate than that of the other topics"
    return Timed(kept, _brought(written, *clock), remark, f"{name}: {remark}")


def _seconds(ahead: FloatArray) -> str:
    return f"{float(np.median(ahead)) + 0.0:.3f} s"
