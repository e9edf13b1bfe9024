"""Real time: absolute deadlines on a monotonic clock, and the samples that are due at each.

A loop that sleeps for its period drifts by the duration of its work; one that sleeps until absolute deadlines does not.
Clock and sleep are arguments, so that tests need neither.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ssmr.types import FloatArray

EDGE = 1.0
"""Length of the beginning and of the end of a run that are compared for drift [s]."""


def instants(rates: Mapping[str, float], dt: float) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield, without end, the steps at which samples are due.

    The k-th sample of a rate f is due with the first step at or after k/f, k = 1, 2, ... So a rate whose period is no whole
    number of steps is kept on average, to the step. Rates are in Hz, `dt` in seconds.

    Yields:
        The number of a step and the names that are due with it; steps increase.

    Raises:
        ValueError: a rate is not positive, or more than one sample a step.
    """
    for name, rate in rates.items():
        if not 0.0 < rate <= (1.0 + 1e-9) / dt:
            raise ValueError(f"{name}: {rate} Hz is not between 0 and one sample a step of {dt} s")
    step_time = Fraction(dt).limit_denominator(10**9)
    steps = {name: 1 / (Fraction(rate).limit_denominator(10**6) * step_time) for name, rate in rates.items()}
    count = dict.fromkeys(rates, 1)
    while True:
        due = {name: math.ceil(count[name] * steps[name]) for name in rates}
        step = min(due.values())
        names = tuple(name for name in rates if due[name] == step)
        for name in names:
            count[name] += 1
        yield step, names


@dataclass(frozen=True)
class Pace:
    """Lateness of a loop with deadlines."""

    duration: float
    """Time from the start to the last deadline [s]."""
    error: float
    """Time by which the run took longer than it should have [s]: its `drift`, and the time that was dropped."""
    late_median: float
    """Median lateness of a wake-up [s]."""
    late_p95: float
    """95th percentile of the lateness [s]."""
    late_max: float
    """Greatest lateness [s]."""
    dropped: float = 0.0
    """Time that was given up because the loop was too late to catch up [s]."""

    def text(self) -> str:
        """Return this as one line."""
        return (
            f"{self.duration:.2f} s at real time: pacing error {1e3 * self.error:+.3f} ms; wake-ups late by "
            f"{1e3 * self.late_median:.2f} ms (median), {1e3 * self.late_p95:.2f} (95 %), {1e3 * self.late_max:.2f} (most)"
        ) + (f"; {self.dropped:.2f} s of it dropped" if self.dropped else "")


def drift(t: FloatArray, late: FloatArray) -> float:
    """Return the drift of a run [s]: the least lateness of its last second minus that of its first.

    On a busy machine many wake-ups are late but some are in time; a loop that falls behind has none in time. Instants `t`
    and their lateness are (M,) [s].
    """
    return float(late[t >= t[-1] - EDGE].min() - late[t <= t[0] + EDGE].min())


class Excerpt:
    """Numbers of a stream without end, in limited memory: every k-th is kept, and k doubles when there are too many."""

    def __init__(self, most: int = 1 << 15) -> None:
        """Begin without numbers, and keep at most `most`."""
        self.kept = array("d")
        self.count = 0
        """Number of all numbers."""
        self._most, self._every = most, 1

    def append(self, number: float) -> None:
        """Take the next number."""
        if self.count % self._every == 0:
            self.kept.append(number)
            if len(self.kept) >= self._most:
                self.kept, self._every = self.kept[::2], 2 * self._every
        self.count += 1


class Pacer:
    """Waits for instants counted from one start, and catches up after lateness, unless that is too much."""

    def __init__(self, clock: Callable[[], float], sleep: Callable[[float], object], most_behind: float = math.inf) -> None:
        """Start now.

        Args:
            clock: function that returns monotonic time [s].
            sleep: function that waits for some time [s] or a little longer.
            most_behind: lateness that is caught up with [s]; a greater one is dropped, so that time does not run fast for
                long after a stall.
        """
        self._clock, self._sleep, self._most = clock, sleep, most_behind
        self.start = clock()
        self.dropped = 0.0
        """Time that was dropped [s]."""
        self._late, self._most_late = Excerpt(), -math.inf
        self._first: tuple[float, float] | None = None  # the first instant, and the least lateness of the first second
        self._recent: deque[tuple[float, float]] = deque()

    def wait(self, instant: float) -> float:
        """Sleep until `instant` [s] after the start, unless that has passed, and return the lateness [s]."""
        deadline = self.start + instant
        while (left := deadline - self._clock()) > 0.0:
            self._sleep(left)
        late = self._clock() - deadline
        self._late.append(late)
        self._most_late = max(self._most_late, late)
        begin, least = self._first or (instant, late)
        self._first = begin, min(least, late) if instant <= begin + EDGE else least
        self._recent.append((instant, late))
        while self._recent[0][0] < instant - EDGE:
            self._recent.popleft()
        if late > self._most:
            self.start += late
            self.dropped += late
        return late

    def pace(self) -> Pace:
        """Return the lateness so far.

        Raises:
            ValueError: nothing was waited for yet.
        """
        if self._first is None:
            raise ValueError("nothing was waited for yet")
        median, p95 = map(float, np.percentile(self._late.kept, [50.0, 95.0]))
        drifted = min(late for _, late in self._recent) - self._first[1]
        return Pace(self._recent[-1][0], drifted + self.dropped, median, p95, self._most_late, self.dropped)
