"""Least squares with errors from blocks: a line through data whose errors hang together."""

from __future__ import annotations

import numpy as np
import pytest

from ssmr.types import FloatArray
from validation.identify.blocks import FitNumbers, fit_in_blocks

BLOCKS, ROWS = 30, 12
LINE = {"offset": (1.0, -9.0, 9.0), "slope": (1.0, -9.0, 9.0)}


def test_a_standard_error_is_the_scatter_of_many_fits() -> None:
    """A block has one draw and a small noise: it is one observation and not twelve."""
    rng = np.random.default_rng(0)
    block = np.repeat(np.arange(BLOCKS, dtype=np.float64), ROWS)
    found, claimed = list[float](), list[float]()
    for _ in range(200):
        x = np.repeat(rng.uniform(-1.0, 1.0, BLOCKS), ROWS)
        y = (
            0.5
            + 2.0 * x
            + np.repeat(rng.normal(0.0, 0.1, BLOCKS), ROWS)
            + rng.normal(0.0, 0.02, len(x))
        )

        def off(n: FitNumbers, x: FloatArray = x, y: FloatArray = y) -> FloatArray:
            return n["offset"] + n["slope"] * x - y

        slope, error = fit_in_blocks(off, LINE, block, 1.0)["slope"]
        found.append(slope)
        claimed.append(error)
    assert np.mean(found) == pytest.approx(2.0, abs=0.01)
    # 200 draws know a scatter to 5 %
    assert np.mean(claimed) == pytest.approx(np.std(found), rel=0.15)


def test_what_is_silent_or_held_by_a_bound_has_no_error() -> None:
    x = np.linspace(-1.0, 1.0, 40)
    numbers = {"slope": (1.0, 0.1, 1.5), "silent": (0.7, 0.0, 1.0)}
    fit = fit_in_blocks(
        lambda n: n["slope"] * x - 2.0 * x, numbers, np.repeat(np.arange(4.0), 10), 1.0
    )
    assert fit["slope"][0] == pytest.approx(1.5, abs=1e-6)
    assert {name: pair[1] for name, pair in fit.items()} == {"slope": 0.0, "silent": 0.0}
