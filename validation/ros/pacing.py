"""Real time: absolute deadlines on a monotonic clock, and what was due at them.

A loop that sleeps for its period drifts by whatever its work takes; one that sleeps until the start plus so many periods
does not. The clock and the sleep are given, so that tests need neither.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ssmr.types import FloatArray

EDGE = 1.0
"""A run's first and last so many seconds are held against each other [s]."""


def instants(rates: Mapping[str, float], dt: float) -> Iterator[tuple[int, tuple[str, ...]]]:
    """When what is due, for ever.

    The k-th sample of a rate f is due with the first step at or after k/f, k = 1, 2, ...: a rate whose period is no whole
    number of steps is kept on average, to the step.

    Args:
        rates: samples a second [Hz] by name.
        dt: step [s].

    Yields:
        The number of a step, and the names that are due with it; steps increase.

    Raises:
        ValueError: a rate that is not positive, or more than one sample a step.
    """
    for name, rate in rates.items():
        if not 0.0 < rate <= (1.0 + 1e-9) / dt:
            raise ValueError(f"{name}: {rate} Hz is not between 0 and one sample a step of {dt} s")
    steps = {
        name: 1 / (Fraction(rate).limit_denominator(10**6) * Fraction(dt).limit_denominator(10**9))
        for name, rate in rates.items()
    }
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
    """How well a loop kept its deadlines."""

    duration: float
    """From the start to the last deadline [s]."""
    error: float
    """How much longer the run took than it should have [s], see `drift`."""
    late_median: float
    """Lateness of a wake-up: median [s]."""
    late_p95: float
    """95th percentile [s]."""
    late_max: float
    """Greatest [s]."""

    def text(self) -> str:
        """In one line."""
        return (
            f"{self.duration:.2f} s at real time: pacing error {1e3 * self.error:+.3f} ms; wake-ups late by "
            f"{1e3 * self.late_median:.2f} ms (median), {1e3 * self.late_p95:.2f} (95 %), {1e3 * self.late_max:.2f} (most)"
        )


def drift(t: FloatArray, late: FloatArray) -> float:
    """What adds up over a run, whatever single wake-ups do: least lateness of its last second less that of its first [s].

    A busy machine makes many wake-ups late and leaves some in time; a loop that falls behind has none in time.

    Args:
        t: (M,) instants, increasing [s].
        late: (M,) how late each was [s].
    """
    return float(late[t >= t[-1] - EDGE].min() - late[t <= t[0] + EDGE].min())


class Pacer:
    """Waits for instants that are counted from one start."""

    def __init__(self, clock: Callable[[], float], sleep: Callable[[float], object]) -> None:
        """Start now.

        Args:
            clock: monotonic time [s].
            sleep: waits for some time [s], or a little longer.
        """
        self._clock, self._sleep = clock, sleep
        self.start = clock()
        self._deadlines, self._late = array("d"), array("d")

    def wait(self, instant: float) -> float:
        """Sleep until `instant` [s] after the start; do not sleep where that has passed.

        Returns:
            How late it is [s].
        """
        deadline = self.start + instant
        while (left := deadline - self._clock()) > 0.0:
            self._sleep(left)
        late = self._clock() - deadline
        self._deadlines.append(instant)
        self._late.append(late)
        return late

    def pace(self) -> Pace:
        """How well it went so far.

        Raises:
            ValueError: nothing was waited for yet.
        """
        if not self._late:
            raise ValueError("nothing was waited for yet")
        t, late = np.array(self._deadlines), np.array(self._late)
        median, p95 = map(float, np.percentile(late, [50.0, 95.0]))
        return Pace(float(t[-1]), drift(t, late), median, p95, float(late.max()))
