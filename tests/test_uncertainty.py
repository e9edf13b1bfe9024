"""Standard errors and intervals of fits: they hold the truth, however long errors hang together."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from ssmr.search.space import Parameter, ParameterSpace
from ssmr.types import FloatArray
from validation.identify.problem import IGNORANCE, Day, FitProblem
from validation.identify.refine import Remembered, descend_from
from validation.identify.uncertainty import estimate_uncertainty

SECONDS = 60.0
PERIOD = 0.1
T = np.arange(0.0, SECONDS, PERIOD)
DRAWS = 200


def hanging_together(rng: np.random.Generator, seconds: float, count: int = len(T)) -> FloatArray:
    """Return (count,) errors of size 1 whose correlation falls by e within so many seconds.

    White if 0.
    """
    keep = np.exp(-PERIOD / seconds) if seconds > 0.0 else 0.0
    noise = rng.normal(size=count)
    out = np.empty(count)
    out[0] = noise[0]
    for i in range(1, count):
        out[i] = keep * out[i - 1] + np.sqrt(1.0 - keep**2) * noise[i]
    return out


class Wave:
    """A constant and a slow wave in errors: least squares finds both numbers in one step."""

    space = ParameterSpace((Parameter("level", "m", 0.0, 1.0), Parameter("height", "m", 0.0, 1.0)))
    shape = np.column_stack([np.ones(len(T)), np.sin(2.0 * np.pi * T / 7.0)])
    blocks = np.floor(T)

    def __init__(self, noise: FloatArray, robust: bool) -> None:
        self.robust = robust
        self.cheap = False
        self.dear = False
        self.pulls = 0
        self.spread = np.full(2, np.inf)
        self.days: list[Day] = []
        self.seen = self.shape @ [0.4, 0.6] + noise

    other_tyres: Wave | None = None

    def with_other_tyres(self) -> Wave | None:
        """Return what it would be on other tyres; most have none."""
        return self.other_tyres

    def residuals(self, points: FloatArray, workers: int) -> FloatArray:
        """Return (S, K) errors of (S, 2) points."""
        return points @ self.shape.T - self.seen


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize(("seconds", "least"), [(0.0, 0.91), (0.5, 0.91), (2.0, 0.87)])
def test_intervals_hold_the_truth(seconds: float, least: float, robust: bool) -> None:
    """95 % intervals hold it in about 95 % of cases.

    A little less where errors hang together for a thirtieth of the data. Of 200 draws the share
    itself is known to 0.015 (one standard deviation).
    """
    held = np.zeros((DRAWS, 2))
    for seed in range(DRAWS):
        problem = Wave(0.02 * hanging_together(np.random.default_rng(seed), seconds), robust)
        driven = Remembered()
        end, _ = descend_from(problem, np.array([0.5, 0.5]), driven, 1, lambda: None)
        interval = estimate_uncertainty(cast("FitProblem", problem), end, 1, driven).interval
        held[seed] = (interval[:, 0] <= [0.4, 0.6]) & ([0.4, 0.6] <= interval[:, 1])
    assert np.all(held.mean(axis=0) >= least)
    assert np.all(held.mean(axis=0) <= 0.995)


@pytest.mark.parametrize(("column", "each"), [(0.0, 1.0), (1.0, np.sqrt(0.5))])
def test_what_no_error_sees_stays_as_unknown_as_the_bounds_leave_it(
    column: float, each: float
) -> None:
    """A number that moves nothing, or of two that only their sum moves the difference."""
    problem = Wave(0.02 * np.random.default_rng(2).normal(size=len(T)), robust=False)
    problem.shape = np.column_stack([np.ones(len(T)), np.full(len(T), column)])
    problem.seen = problem.shape @ [0.4, 0.6] + problem.seen - Wave.shape @ [0.4, 0.6]
    end = np.linalg.lstsq(problem.shape, problem.seen)[0]
    sure = estimate_uncertainty(cast("FitProblem", problem), end)
    assert sure.share[1] == pytest.approx(each * IGNORANCE, rel=0.01)
    seen = np.array([1.0, column])
    known = seen @ (sure.correlation * np.outer(sure.share, sure.share)) @ seen
    assert np.sqrt(known) < 0.01 * IGNORANCE


def test_each_part_is_left_out_by_a_step_to_the_optimum_of_the_others() -> None:
    """A level that differs in the last quarter.

    Where errors are linear, the step goes to the fit of the other quarters.
    """
    problem = Wave(
        0.1 * (T >= 0.75 * SECONDS) + 0.02 * np.random.default_rng(1).normal(size=len(T)),
        robust=False,
    )
    end, _ = descend_from(problem, np.array([0.5, 0.5]), driven := Remembered(), 1, lambda: None)
    quarter = np.floor(4.0 * T / SECONDS)
    for k, point in enumerate(
        estimate_uncertainty(cast("FitProblem", problem), end, 1, driven).without
    ):
        rest = quarter != k
        assert point == pytest.approx(
            np.linalg.lstsq(problem.shape[rest], problem.seen[rest])[0], abs=1e-4
        )


def test_what_is_foreseen_at_a_start_is_what_is_found_at_the_end() -> None:
    """Where errors are linear, a guess that counts as an error weighs the same at both.

    The way to the end is none of what tyres of another shape would change.
    """
    noise = 0.02 * np.random.default_rng(3).normal(size=len(T))
    problem = Wave(noise, robust=True)
    problem.other_tyres = Wave(noise + 0.03, robust=True)
    asked = cast("FitProblem", problem)
    end, _ = descend_from(asked, np.array([0.9, 0.1]), driven := Remembered(), 1, lambda: None)
    found = estimate_uncertainty(asked, end, 1, driven).share
    start = np.array([0.9, 0.1])
    foreseen = estimate_uncertainty(asked, start, foreseen=True).share
    assert found[0] == pytest.approx(0.03, rel=0.05)
    assert foreseen == pytest.approx(found, rel=0.05)
