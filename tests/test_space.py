"""The unit cube and what it stands for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.search.space import BOUND_SHARE, Parameter, ParameterSpace
from tests.conftest import ROUNDOFF

SPACE = ParameterSpace((Parameter("mu", "1", 0.1, 0.9), Parameter("gain", "N m s/rad", 10.0, 1000.0, "log")))


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
def test_there_and_back(point: list[float]) -> None:
    assert SPACE.points(SPACE.values(point)) == pytest.approx(np.array(point), abs=ROUNDOFF)


def test_corners_are_the_bounds_and_the_middle_is_a_mean() -> None:
    assert SPACE.values(np.zeros(2)) == pytest.approx(SPACE.lower, rel=ROUNDOFF)
    assert SPACE.values(np.ones(2)) == pytest.approx(SPACE.upper, rel=ROUNDOFF)
    assert SPACE.values(np.full(2, 0.5)) == pytest.approx([0.5, 100.0])  # arithmetic, geometric


def test_slopes_are_derivatives() -> None:
    x, h = np.array([0.3, 0.7]), 1e-6
    numeric = (SPACE.values(x + h) - SPACE.values(x - h)) / (2 * h)
    assert SPACE.slopes(x) == pytest.approx(numeric, rel=1e-6)


def test_bounds_are_told() -> None:
    points = np.array([[0.0, 0.5], [1.0 - 0.5 * BOUND_SHARE, 1.0], [0.01, 0.99]])
    assert SPACE.at_bound(points).tolist() == [[True, False], [True, True], [False, False]]


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Parameter("mu", "1", 0.9, 0.1), "bounds of mu are 0.9 and 0.1"),
        (lambda: Parameter("mu", "1", 0.5, 0.5), "lower must be less"),
        (lambda: Parameter("mu", "1", 0.0, float("inf")), "bounds of mu.*finite"),
        (lambda: Parameter("gain", "1", 0.0, 5.0, "log"), "logarithmic"),
        (lambda: ParameterSpace(()), "got: none"),
        (lambda: ParameterSpace((SPACE.parameters[0], SPACE.parameters[0])), "names of their own"),
        (lambda: SPACE.points([0.05, 100.0]), "mu = 0.05 lies outside its bounds, 0.1 to 0.9"),
        (lambda: SPACE.points([0.5, float("nan")]), "gain = nan"),
    ],
)
def test_mistakes_are_named(make, what: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=what):
        make()
