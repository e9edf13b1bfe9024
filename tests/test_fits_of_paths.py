"""Fits of planar models to paths: their search, and what turns of one amplitude cannot tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.types import FloatArray
from validation.fit import Fitted, fit
from validation.identify.problem import FitProblem
from validation.identify.refine import simplex_end
from validation.plants.profile import Profile
from validation.plants.searchable import find_number, with_values

TWO = "traj4@coulomb,traj2@coulomb"
ONE = "traj4@coulomb"
FREE = ("mu_c", "effective_half_track", "delay")


def values_of(fitted: Fitted) -> dict[str, float]:
    return {p.name: p.value for p in fitted.parameters}


def with_friction(lab: Profile, friction: float) -> Profile:
    """The lab's profile with another friction in turns of the Coulomb model."""
    section = with_values("coulomb", lab.section("coulomb"), ["mu_c"], [friction])
    return Profile(lab.name, lab.description, {**lab.plants, "coulomb": section}, {})


@pytest.mark.parametrize("start", [[0.9, 0.1, 0.5], [0.0, 1.0, 1.0], [0.5, 0.5, 0.5]])
def test_simplices_find_the_least_of_a_cost_without_derivatives(start: list[float]) -> None:
    """A greatest error has an edge at its optimum, here one that runs across all axes."""
    wanted = np.array([0.3, 0.62, 1.0])
    slopes = np.array([[1.0, -2.0, 0.3], [4.0, 1.0, 1.0], [-1.0, 0.5, 3.0]])
    rated: list[FloatArray] = []

    def cost_at(point: FloatArray) -> float:
        rated.append(point)
        return float(1.0 + np.abs(slopes @ (point - wanted)).max())

    end = simplex_end(cost_at, np.array(start))
    assert np.abs(end - wanted).max() < 0.01
    assert np.min(rated) >= 0.0
    assert np.max(rated) <= 1.0


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_every_seed_ends_where_two_amplitudes_came_from(lab: Profile, seed: int) -> None:
    """By the path alone, from the default bounds; nobody said where to begin."""
    friction = 0.045
    truth = with_friction(lab, friction)
    fitted = fit("coulomb", TWO, truth, free=FREE, seed=seed)
    assert fitted.document()["search"] == "descents"
    found = values_of(fitted)
    assert found["mu_c"] == pytest.approx(friction, abs=0.001)
    track = find_number("coulomb", "effective_half_track", truth.robot)
    assert found["effective_half_track"] == pytest.approx(
        track.read(truth.section("coulomb")), abs=0.001
    )
    assert fitted.together.metrics["d_rms_m"] < 2e-4


def test_one_amplitude_holds_the_friction_of_turns_and_says_so(lab: Profile) -> None:
    def fitted(to: str, **more: Any) -> tuple[set[str], str]:
        result = fit("coulomb", to, lab, search="jde", population=8, generations=1, **more)
        return {*values_of(result)}, " ".join(result.notes())

    one, said = fitted(ONE)
    assert "mu_c" not in one
    assert "mu_c is held at 0.0254: turns of one amplitude" in said
    for asked in ({"free": ("mu_c", "delay")}, {"bounds": {"mu_c": (0.0, 0.1)}}):
        names, said = fitted(ONE, **asked)
        assert "mu_c" in names
        assert "is held" not in said
    several, said = fitted(TWO)
    assert several == {*one, "mu_c"}
    assert "held" not in said


def test_a_model_without_such_a_friction_says_that_amplitudes_are_too_many() -> None:
    def said(model: str) -> str:
        short: dict[str, Any] = {"population": 8, "generations": 1}
        return " ".join(fit(model, f"traj4@{model},traj2@{model}", **short).notes())

    assert "linear has no free friction that takes a constant off the yaw rate" in said("linear")
    assert "constant off the yaw rate" not in said("improved")


def test_sizes_of_a_population_choose_differential_evolution(lab: Profile) -> None:
    for sizes in ({"population": 6}, {"generations": 1}):
        small = {"population": 6, "generations": 1} if "generations" in sizes else sizes
        result = fit("kinematic", "traj4@kinematic", lab, free=("alpha_l",), **small)
        assert result.document()["search"] == "jde"
        assert result.course.by_stage == {"jde": result.course.evaluations, "lsq": 0, "simplex": 0}


def test_an_interrupted_search_goes_on_to_the_same_end(
    lab: Profile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is interrupted in least squares, whose ends are rated by the cost, then in a simplex."""
    quick: dict[str, Any] = {"free": ("effective_half_track", "delay"), "seed": 2}
    whole = fit("coulomb", ONE, lab, **quick)
    real = FitProblem.costs
    calls = []

    def cut(self: FitProblem, *arguments: Any, **more: Any) -> FloatArray:
        calls.append(0)
        if len(calls) in (3, 63):
            raise KeyboardInterrupt
        return real(self, *arguments, **more)

    monkeypatch.setattr(FitProblem, "costs", cut)
    for resume in (False, True):
        part = fit("coulomb", ONE, lab, out=tmp_path, resume=resume, **quick)
        assert part.status == "interrupted"
        assert part.course.evaluations < whole.course.evaluations
    assert part.course.by_stage["simplex"] > 0
    rest = fit("coulomb", ONE, lab, out=tmp_path, resume=True, **quick)
    assert rest.course.by_stage == whole.course.by_stage
    assert rest.cost == whole.cost
    assert values_of(rest) == values_of(whole)
