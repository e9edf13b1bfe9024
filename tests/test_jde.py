"""The unit cube and differential evolution.

Formulas by hand, impossible events, repetition, stop rules and convergence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from ssmr.search import jde
from ssmr.search.jde import (
    Jde,
    JdeSettings,
    _binomial_mask,
    _distinct_partners,
    _mutate_population,
    _repair_donors,
    adapt_settings,
    trial_replaces_parent,
)
from ssmr.search.space import Parameter, ParameterSpace
from ssmr.types import FloatArray
from tests.conftest import ROUNDOFF

Objective = Callable[[FloatArray], FloatArray]
SHORT = JdeSettings(population=12, generations=15, patience=16)


def sphere(x: FloatArray) -> FloatArray:
    return np.sum((x - 0.3) ** 2, axis=1)


def finish(search: Jde, objective: Objective = sphere) -> Jde:
    while not search.finished:
        search.tell(objective(search.ask()))
    return search


def same(a: Jde, b: Jde) -> bool:
    one = a.state()
    other = b.state()
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k]) for k in one)


def saved(state: Mapping[str, Any]) -> dict[str, Any]:
    """Through a file without pickle."""
    buffer = BytesIO()
    np.savez(buffer, allow_pickle=False, **state)
    buffer.seek(0)
    with np.load(buffer, allow_pickle=False) as loaded:
        return dict(loaded)


# --- formulas
# --------------------------------------------------------------------------------------------------


def test_the_defaults_are_table_3_7() -> None:
    assert (jde.F_INIT, jde.F_BOUNDS, jde.CR_INIT, jde.CR_BOUNDS) == (
        0.75,
        (0.1, 0.9),
        0.8,
        (0.0, 1.0),
    )
    assert (jde.TAU, jde.PARTNERS, JdeSettings.slope) == (0.1, 4, 0.2)
    assert (JdeSettings.df, JdeSettings.population, JdeSettings.generations) == (1e-3, 50, 300)


def test_f_is_drawn_anew_descends_or_stays_at_its_least() -> None:
    """At generation 151 of 300 the descent is 0.2 * 150 / 300 = 0.1."""
    f = np.array([0.75, 0.75, 0.75, 0.105])
    draws = np.array([[0.0, 0.0999, 0.1, 0.5], [0.0, 0.5, 0.5, 0.5]])
    adapted = adapt_settings(f, draws, (0.1, 0.9), 0.2 * (151 - 1) / 300)
    assert adapted == pytest.approx([0.1, 0.5, 0.675, 0.1], rel=ROUNDOFF)


def test_the_descent_follows_the_generations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials that never win, tau 0: F of generation ng is F_init (1 - slp (ng - 1) / ng_max)."""
    monkeypatch.setattr(jde, "TAU", 0.0)
    search = Jde(2, SHORT, 1)
    search.tell(sphere(search.ask()))
    for ng in range(1, 16):
        search.ask()
        share = 1.0 - 0.2 * (ng - 1) / 15
        state = search.state()
        assert state["trial_f"] == pytest.approx(np.full(12, 0.75 * share), rel=ROUNDOFF)
        assert state["trial_cr"] == pytest.approx(np.full(12, 0.8 * share), rel=ROUNDOFF)
        search.tell(np.full(12, 1e9))


def test_mutation_by_hand() -> None:
    population = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0], [4.0, 8.0], [8.0, 16.0]])
    before = population.copy()
    donors = _mutate_population(
        population, np.array([7.0, 9.0]), np.array([0.5]), np.array([[1], [2], [3], [4]])
    )
    assert np.array_equal(
        donors, [[7.0 + 0.5 * (1 - 2) + 0.5 * (4 - 8), 9.0 + 0.5 * (2 - 4) + 0.5 * (8 - 16)]]
    )
    assert np.array_equal(population, before)


def test_repair_by_hand() -> None:
    donors = np.array([[-0.5, 0.25, 1.5], [0.0, 1.0, -1e-9]])
    assert np.array_equal(
        _repair_donors(donors, np.array([0.5, 0.5, 0.75])), [[0.25, 0.25, 0.875], [0.0, 1.0, 0.375]]
    )


def test_binomial_crossover_by_hand() -> None:
    draws = np.array([[0.1, 0.5, 0.9], [0.1, 0.5, 0.9], [0.0, 0.0, 0.0], [0.99, 0.99, 0.99]])
    mask = _binomial_mask(np.array([0.5, 0.6, 0.0, 1.0]), draws, np.array([2, 0, 1, 0]))
    assert np.array_equal(mask, np.array([[1, 0, 1], [1, 1, 0], [0, 1, 0], [1, 1, 1]], dtype=bool))


def test_selection_by_hand() -> None:
    parents = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, np.inf, np.inf, np.inf])
    trials = np.array([0.5, 1.0, 1.5, np.nan, np.inf, -np.inf, 5.0, np.inf, np.nan])
    assert np.flatnonzero(trial_replaces_parent(trials, parents)).tolist() == [0, 1, 6]


# --- distinct indices
# --------------------------------------------------------------------------------------------------


def greedy(draws: FloatArray) -> list[list[int]]:
    """The slow obvious version: draw from the list of those that are left."""
    rows = []
    for i in range(draws.shape[1]):
        left = [j for j in range(draws.shape[1]) if j != i]
        rows.append([left.pop(int(u * len(left))) for u in draws[:, i]])
    return np.array(rows).T.tolist()


@given(st.integers(0, 2**32), st.integers(2, 30), st.data())
def test_partners_are_distinct_and_as_drawn_one_by_one(
    seed: int, size: int, data: st.DataObject
) -> None:
    k = data.draw(st.integers(1, min(4, size - 1)))
    draws = np.random.default_rng(seed).random((k, size))
    partners = _distinct_partners(draws)
    assert partners.tolist() == greedy(draws)
    assert all(len({i, *column}) == k + 1 for i, column in enumerate(partners.T.tolist()))
    assert partners.min() >= 0
    assert partners.max() < size


# --- what never happens
# --------------------------------------------------------------------------------------------------


@effort(max_examples=40)
@given(st.integers(0, 2**63 - 1), st.integers(1, 7))
def test_points_stay_in_the_cube_and_f_and_cr_in_their_bounds(seed: int, n: int) -> None:
    """Also where the optimum lies in a corner, outside."""
    search = Jde(n, SHORT, seed)
    while not search.finished:
        points = search.ask()
        assert points.shape == (12, n)
        assert points.min() >= 0.0
        assert points.max() <= 1.0
        state = search.state()
        assert np.all((state["trial_f"] >= 0.1) & (state["trial_f"] <= 0.9))
        assert np.all((state["trial_cr"] >= 0.0) & (state["trial_cr"] <= 1.0))
        search.tell(np.sum(points * np.where(np.arange(n) % 2, 1.0, -1.0), axis=1))
    assert np.all(np.diff(search.history) <= 0.0)


@effort(max_examples=40)
@given(st.integers(0, 2**32), st.floats(0.0, 0.9))
def test_costs_that_are_no_numbers_are_never_selected(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    known = set()
    search = Jde(3, SHORT, seed)
    while not search.finished:
        points = search.ask()
        costs = np.where(
            rng.random(12) < share, rng.choice([np.nan, np.inf, -np.inf], 12), sphere(points)
        )
        known |= {tuple(p) for p in points[np.isfinite(costs)]}
        search.tell(costs)
        held = np.isfinite(search.costs)
        assert all(tuple(p) in known for p in search.population[held])
        assert np.array_equal(search.costs[held], sphere(search.population[held]))
        assert search.best_cost == search.costs.min()


def test_trials_that_win_bring_their_f_and_cr() -> None:
    search = Jde(3, SHORT, 2)
    search.ask()
    search.tell(np.full(12, 1.0))
    points = search.ask()
    before = search.state()
    won = np.arange(12) % 3 == 0
    search.tell(np.where(won, 1.0, 1.1))
    after = search.state()
    for parent, trial in (("f", "trial_f"), ("cr", "trial_cr")):
        assert np.array_equal(after[parent], np.where(won, before[trial], before[parent]))
    assert np.array_equal(
        search.population, np.where(won[:, np.newaxis], points, before["population"])
    )


# --- repetition
# --------------------------------------------------------------------------------------------------


def test_equal_seeds_give_equal_searches_and_others_do_not() -> None:
    a, b, c = (finish(Jde(4, SHORT, seed)) for seed in (3, 3, 4))
    assert same(a, b)
    assert not np.array_equal(a.population, c.population)


def test_a_restored_search_goes_on_bit_for_bit() -> None:
    settings = SHORT
    whole = finish(Jde(4, settings, 9))
    for stop in range(16):
        for commanded in (False, True):
            search = Jde(4, settings, 9)
            for _ in range(stop):
                search.tell(sphere(search.ask()))
            if commanded:
                search.ask()
            restored = Jde.restore(saved(search.state()))
            assert restored.settings == settings
            assert same(restored, search)
            assert restored.generation == search.generation
            assert np.array_equal(restored.best, search.best)
            assert same(finish(restored), whole)
    finished = Jde.restore(saved(whole.state()))
    assert finished.finished == whole.finished == "generations"


# --- stop rules
# --------------------------------------------------------------------------------------------------


def searched(settings: JdeSettings, costs: list[float]) -> Jde:
    """A search that hears the same cost for all, generation by generation."""
    search = Jde(2, settings, 0)
    for cost in costs:
        assert search.finished == ""
        search.ask()
        search.tell(np.full(settings.population, cost))
    return search


def test_it_stops_after_the_generations() -> None:
    search = finish(Jde(2, SHORT, 0))
    assert (search.finished, search.generation, search.evaluations, len(search.history)) == (
        "generations",
        15,
        16 * 12,
        16,
    )
    with pytest.raises(ValueError, match="finished"):
        search.ask()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_it_stops_when_the_cost_no_longer_improves(sign: float) -> None:
    """A tenth, of the size the cost had two generations before."""
    rule = replace(SHORT, df=0.1, patience=2)
    base = 100.0 * sign
    assert searched(rule, [base, base - 8.0, base - 11.0]).finished == ""
    assert searched(rule, [base, base - 8.0, base - 10.0]).finished == "improvement"
    assert searched(replace(rule, patience=1), [base, base - 8.0]).finished == "improvement"
    assert searched(rule, [np.inf, np.inf, np.inf, base]).finished == "", (
        "nothing known then, nothing to compare"
    )


# --- it finds what is there
# -----------------------------------------------------------------------------------------------


def test_start_points_are_in_the_first_population() -> None:
    start = np.array([[0.25, 0.5], [1.0, 0.0]])
    points = Jde(2, SHORT, 0, start).ask()
    drawn = Jde(2, SHORT, 0).ask()
    assert np.array_equal(points[:2], start)
    assert np.array_equal(points[2:], drawn[2:])


def test_sphere() -> None:
    assert finish(Jde(5, JdeSettings(30, 300, df=0.0), 1)).best_cost < 1e-8


# --- the unit cube and what it stands for ---

SPACE = ParameterSpace(
    (Parameter("mu", "1", 0.1, 0.9), Parameter("gain", "N m s/rad", 10.0, 1000.0, "log"))
)


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
def test_there_and_back(point: list[float]) -> None:
    assert SPACE.points(SPACE.values(point)) == pytest.approx(np.array(point), abs=ROUNDOFF)


def test_corners_are_the_bounds_and_the_middle_is_a_mean() -> None:
    assert SPACE.values(np.zeros(2)) == pytest.approx(SPACE.lower, rel=ROUNDOFF)
    assert SPACE.values(np.ones(2)) == pytest.approx(SPACE.upper, rel=ROUNDOFF)
    assert SPACE.values(np.full(2, 0.5)) == pytest.approx([0.5, 100.0])  # arithmetic, geometric


def test_slopes_are_derivatives() -> None:
    x = np.array([0.3, 0.7])
    h = 1e-6
    numeric = (SPACE.values(x + h) - SPACE.values(x - h)) / (2 * h)
    assert SPACE.slopes(x) == pytest.approx(numeric, rel=1e-6)
