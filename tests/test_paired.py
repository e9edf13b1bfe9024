"""The paired test finds steady differences, and names chance what is chance."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from ssmr.metrics.paired import SIGNIFICANCE, chance_of_difference, correct_by_holm
from ssmr.metrics.windows import WindowErrors
from ssmr.types import FloatArray
from tests.test_windows import moving_sums
from validation.report.motions import indistinguishable_pairs

TIMES = np.arange(300.0)


def drawn(seed: int, n: int = 300) -> FloatArray:
    return moving_sums(np.random.default_rng(seed), n, 6)


def test_a_steady_difference_is_seen_and_has_no_direction() -> None:
    hard = drawn(1)
    assert chance_of_difference(hard, 1.2 * hard, TIMES, 6.0) < 0.01
    assert chance_of_difference(1.2 * hard, hard, TIMES, 6.0) < 0.01
    assert chance_of_difference(hard, hard, TIMES, 6.0) == 1.0
    assert chance_of_difference(hard, 1.2 * hard, TIMES, 100.0) == 1.0, "too few blocks"
    with pytest.raises(ValueError, match="errors"):
        chance_of_difference(hard, hard[:10], TIMES, 6.0)


def test_neighbours_that_share_data_count_once() -> None:
    """The test tells few equally good candidates apart.

    A test of single windows would tell many apart by chance.
    """
    pairs = [(drawn(2 * k), drawn(2 * k + 1)) for k in range(40)]
    blocks, single = (
        sum(chance_of_difference(a, b, TIMES, s) < SIGNIFICANCE for a, b in pairs)
        for s in (6.0, 0.5)
    )
    assert blocks <= 6 < single


def test_of_many_pairs_none_is_told_apart_by_their_number() -> None:
    """Six equally good candidates have 15 pairs.

    Uncorrected, some differ by chance in most recordings.
    """
    plain = raised = 0
    for seed in range(5):
        some = [drawn(100 * seed + k) for k in range(6)]
        plain += (
            min(chance_of_difference(a, b, TIMES, 6.0) for a, b in itertools.combinations(some, 2))
            < SIGNIFICANCE
        )
        windows = [WindowErrors(6.0, np.abs(errors), np.abs(errors)) for errors in some]
        plants = {str(k): SimpleNamespace(windows={6.0: w}) for k, w in enumerate(windows)}
        raised += bool(indistinguishable_pairs(plants)["better"]["position"])  # type: ignore[arg-type, index]
    assert raised <= 1 < 2 < plain


def test_holms_rule() -> None:
    assert correct_by_holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert correct_by_holm([0.6, 0.9]) == pytest.approx([1.0, 1.0])
    assert len(correct_by_holm([])) == 0
