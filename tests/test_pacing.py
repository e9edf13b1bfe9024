"""Deadlines and what is due at them, with a clock that is no clock."""

from __future__ import annotations

from collections import Counter
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.ros_fakes import FakeClock
from validation.ros.pacing import Excerpt, Pacer, drift, instants


@given(st.dictionaries(st.sampled_from("abc"), st.sampled_from([7.0, 20.0, 50.0, 100.0, 120.0, 333.3, 500.0]), min_size=1))
def test_rates_are_kept_to_the_step(rates: dict[str, float]) -> None:
    dt, seen, last = 0.002, Counter[str](), 0
    for step, names in islice(instants(rates, dt), 400):
        assert step > last
        last = step
        seen.update(names)
        for name, rate in rates.items():
            assert seen[name] == int(step * dt * rate + 1e-9), "neither early nor more than a step late"


def test_a_sleep_that_overshoots_does_not_add_up() -> None:
    clock = FakeClock(overshoot=0.001)
    pacer = Pacer(clock, clock.sleep)
    for k in range(3000):
        pacer.wait(0.01 * k)
        clock.now += 0.004  # work
    pace = pacer.pace()
    assert clock.now - pacer.start == pytest.approx(29.99 + 0.001 + 0.004, abs=1e-9)
    assert abs(pace.error) < 0.001 + 1e-9, "the first wait does not sleep, and does not overshoot"
    assert pace.late_median == pytest.approx(0.001, abs=1e-9)


def test_a_loop_that_is_too_slow_is_found_out() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, clock.sleep)
    for k in range(1000):
        pacer.wait(0.01 * k)
        clock.now += 0.0101
    assert pacer.pace().error == pytest.approx(0.0001 * (1000 - 100), rel=0.02)


def test_lateness_beyond_the_limit_is_dropped_and_owned_up_to() -> None:
    """A loop that stalls for 2 s does not run fast afterwards: its time has lost them."""
    clock = FakeClock()
    pacer = Pacer(clock, clock.sleep, most_behind=0.5)
    late = []
    for k in range(300):
        late.append(pacer.wait(0.01 * k))
        clock.now += 2.0 if k == 50 else 0.001
    assert max(late) == pytest.approx(1.99)
    assert late[52:] == [0.0] * len(late[52:]), "the first deadline after the stall is late, the next ones are not"
    assert pacer.dropped == pytest.approx(1.99)
    assert clock.now - 0.001 == pytest.approx(100.0 + 2.99 + 1.99)
    assert pacer.pace().error == pytest.approx(1.99)
    assert "1.99 s of it dropped" in pacer.pace().text()


def test_a_long_run_takes_no_more_memory_and_says_the_same() -> None:
    """Instants come without end; what is kept of them does not grow, and still is a fair excerpt."""
    numbers = np.random.default_rng(0).exponential(size=100_000)
    excerpt = Excerpt(most=1024)
    for number in numbers:
        excerpt.append(float(number))
        assert len(excerpt.kept) < 1024
    assert excerpt.count == len(numbers)
    np.testing.assert_array_equal(excerpt.kept, numbers[::128])


def test_the_drift_of_a_pacer_is_that_of_all_its_instants() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, clock.sleep)
    rng = np.random.default_rng(1)
    t = 0.01 * np.arange(500)
    late = []
    for instant in t:
        late.append(pacer.wait(float(instant)))
        clock.now += float(rng.exponential(0.012))
    assert pacer.pace().error == pytest.approx(drift(t, np.array(late)), abs=1e-12)
    assert pacer.pace().late_max == max(late)
