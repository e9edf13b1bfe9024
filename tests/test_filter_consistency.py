"""A commissioned filter is as sure of its pose as it may be: chi-squared bands on shipped robots."""

from __future__ import annotations

import numpy as np
import pytest

from ssmr.control.loop import Feedback
from validation.plants.profile import load_profile
from validation.study.filter.doubt import chi_squared_band, doubt_of

LEAST_INSIDE = 8 / 9
"""Share of the nine instants whose mean must be inside the band: one in twenty is outside by chance."""


def test_the_band_is_that_of_chi_squared_numbers() -> None:
    means = np.random.default_rng(1).chisquare(3, (20000, 16)).mean(axis=1)
    low, high = chi_squared_band(3, 16)
    assert np.mean((means > low) & (means < high)) == pytest.approx(0.95, abs=0.008)  # 5 standard errors


@pytest.mark.parametrize(
    ("profile", "plant", "feedback", "nis_inside"),
    [
        ("thesis-lab", "linear", "noisy", 0.93),
        ("thesis-lab", "kinematic", "noisy", 0.93),
        ("husky-tile", "improved", "ekf", 0.93),
        pytest.param("husky-tile", "mujoco", "noisy", 0.8, marks=pytest.mark.slow),
    ],
)
def test_the_errors_of_the_pose_are_of_the_size_that_is_claimed(
    profile: str, plant: str, feedback: Feedback, nis_inside: float
) -> None:
    """MuJoCo's slip is no Gauss-Markov process, so that fewer means of its innovations are inside their band."""
    found = doubt_of(load_profile(profile), plant, feedback)
    low, high = found.band
    mean = found.nees.mean(axis=0)
    assert mean.shape == (9,)
    assert np.mean((mean > low) & (mean < high)) >= LEAST_INSIDE
    assert found.nis_share >= nis_inside


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["thesis-lab", "thesis-printed", "husky-tile", "husky-wet-grass", "warthog-grass"])
@pytest.mark.parametrize("plant", ["linear", "kinematic", "coulomb", "improved"])
@pytest.mark.parametrize("feedback", ["truth", "noisy", "ekf"])
def test_on_every_planar_model_the_filter_is_as_sure_as_it_may_be(
    profile: str, plant: str, feedback: Feedback, request: pytest.FixtureRequest
) -> None:
    found = doubt_of(load_profile(profile), plant, feedback)
    low, high = found.band
    mean = found.nees.mean(axis=0)
    assert np.isfinite(mean).all()
    assert found.nis_share >= 0.93
    if (profile, plant, feedback) == ("husky-tile", "coulomb", "ekf"):  # from here on, so that it excuses nothing else
        reason = "two of nine means are just above the band"
        request.applymarker(pytest.mark.xfail(reason=reason, strict=True, raises=AssertionError))
    assert np.mean((mean > low) & (mean < high)) >= LEAST_INSIDE
