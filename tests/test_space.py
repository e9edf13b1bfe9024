"""The unit cube and what it stands for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.search.space import Parameter, ParameterSpace
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
