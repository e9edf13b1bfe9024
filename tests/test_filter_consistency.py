"""A commissioned filter is as sure of its pose as it may be: chi-squared bands on shipped robots."""

from __future__ import annotations

import numpy as np
import pytest

from ssmr.control.loop import Feedback, LoopSettings
from ssmr.control.references import eight
from validation.bench.commissioning import TRACKER
from validation.bench.gains import DEFAULT, load_gains
from validation.bench.loops import make_controller, make_robot, run_robots
from validation.plants.profile import load_profile
from validation.study.filter import chi_squared_band, consistency_of

LEAST_INSIDE = 8 / 9
"""Share of the nine instants whose mean must be inside the band: one in twenty is outside by chance."""
ALL_FEEDBACKS = pytest.mark.parametrize("feedback", ["truth", "noisy", "ekf"])
ALL_PROFILES = pytest.mark.parametrize(
    "profile", ["thesis-lab", "thesis-printed", "husky-tile", "husky-wet-grass", "warthog-grass"]
)


def test_the_band_is_that_of_chi_squared_numbers() -> None:
    means = np.random.default_rng(1).chisquare(3, (20000, 16)).mean(axis=1)
    low, high = chi_squared_band(3, 16)
    assert np.mean((means > low) & (means < high)) == pytest.approx(0.95, abs=0.008)  # 5 standard errors


@pytest.mark.parametrize(
    ("profile", "plant", "feedback"),
    [("thesis-lab", "linear", "noisy"), ("thesis-lab", "kinematic", "noisy"), ("husky-tile", "improved", "ekf")],
)
def test_the_errors_of_the_pose_are_of_the_size_that_is_claimed(profile: str, plant: str, feedback: Feedback) -> None:
    found = consistency_of(load_profile(profile), plant, feedback)
    assert len(found.t) == 9
    assert found.inside >= LEAST_INSIDE
    assert found.nis_inside >= 0.93
    assert np.all(found.thesis_biased.mean(axis=0)[-3:] > 100.0)  # the thesis' filter on the same drives


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["thesis-lab", "husky-tile", "warthog-grass"])
def test_slip_in_turns_is_hardly_a_function_of_the_motion(profile: str) -> None:
    """So no turning ratio that the filter could know beforehand would bring the wheels' NIS into its band on tyres."""
    chosen = load_profile(profile)
    robot, law = make_robot(chosen, "mujoco"), make_controller(chosen, load_gains(TRACKER, DEFAULT))
    (run,) = run_robots([robot], [law], [LoopSettings("truth")], eight(0.25), [1000])
    (v, _, w), wheels = run.motion.twist.T, run.motion.wheels
    left = []
    for known in ([v, w], [v, w, v * v, v * w, w * w, w * abs(w), v * v * w, v * w * w, w**3]):
        known_of = np.column_stack(known)
        shown = wheels[:, 1] - wheels[:, 0]
        left.append(np.std(shown - known_of @ np.linalg.lstsq(known_of, shown)[0]))
    print(f"slip that polynomials leave of what a constant ratio leaves: {left[1] / left[0]:.2f}")
    assert 0.75 < left[1] / left[0] < 1.0


@pytest.mark.slow
@ALL_PROFILES
@pytest.mark.parametrize("plant", ["linear", "kinematic", "coulomb", "improved"])
@ALL_FEEDBACKS
def test_on_every_planar_model_the_filter_is_as_sure_as_it_may_be(profile: str, plant: str, feedback: Feedback) -> None:
    found = consistency_of(load_profile(profile), plant, feedback)
    assert found.inside >= LEAST_INSIDE
    assert found.nis_inside >= 0.93


@pytest.mark.slow
@ALL_PROFILES
@pytest.mark.parametrize("plant", ["four_wheel", "mujoco"])
@ALL_FEEDBACKS
def test_on_tyres_the_filter_is_not_too_sure(profile: str, plant: str, feedback: Feedback) -> None:
    """Slip counts as white noise that is as strong as its slowest part; so the filter may doubt too much, as on grass."""
    found = consistency_of(load_profile(profile), plant, feedback)
    low, high = found.band
    mean = found.nees.mean(axis=0)
    assert np.mean(mean < high) >= LEAST_INSIDE
    assert mean.min() > 0.5 * low
