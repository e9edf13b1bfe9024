"""Threads of our own: shares of a population, also without a safe threading layer."""

from __future__ import annotations

from typing import Any

import numba
import pytest

from ssmr._jit import share_among_threads
from validation.fit import fit
from validation.tune import tune


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


def test_no_search_starts_a_threading_layer_of_numba() -> None:
    """The layer without OpenMP and TBB ends the process when two threads call it at once."""
    few: dict[str, Any] = {"profile": "thesis-lab", "population": 8, "generations": 1, "workers": 2}
    fit("mujoco", to="traj4@improved", search="jde", free=("friction",), **few)
    tune("lqr", "line", **few)
    with pytest.raises(ValueError, match="not initialized"):
        numba.threading_layer()
