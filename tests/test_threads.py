"""Threads of our own: shares of a population, on a machine with no threading layer that bears them as well."""

from __future__ import annotations

import pytest

from ssmr._jit import share_among_threads


@pytest.mark.parametrize(("count", "workers"), [(0, 2), (1, 2), (7, 1), (7, 3), (100, 4)])
def test_shares_are_consecutive_and_leave_nothing_out(count: int, workers: int) -> None:
    done: list[tuple[int, int]] = []
    share_among_threads(lambda first, last: done.append((first, last)), count, workers)
    assert [i for first, last in sorted(done) for i in range(first, last)] == list(range(count))


def test_what_goes_wrong_in_a_thread_is_raised() -> None:
    def work(first: int, last: int) -> None:
        raise ValueError("no such candidate")

    with pytest.raises(ValueError, match="no such candidate"):
        share_among_threads(work, 8, 2)
