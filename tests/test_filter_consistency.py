"""A commissioned filter is as sure of its pose as it may be: chi-squared bands on shipped robots."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.special import chdtri

from ssmr.control.loop import Feedback, LoopSettings
from ssmr.control.references import sine
from ssmr.estimation.ekf import run_ekf
from ssmr.estimation.settings import EkfSettings, zeroed
from ssmr.robot.sensors import SensorModel, gyro_at_rest, simulate_sensors
from ssmr.types import FloatArray, State, Trajectory
from validation.bench.gains import DEFAULT, load_gains
from validation.bench.loops import TRACKER, commissioned, make_controller, make_robot, run_robots
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile, load_profile

_SPEED, _EVERY, _RATE = 0.25, 4.0, 125.0
"""Speed of the judged drives [m/s], period of the instants at which they are judged [s], and of the sensors [Hz]."""
LEAST_INSIDE = 8 / 9
"""Share of the nine instants whose mean must be inside the band: one in twenty is outside by chance."""
ALL_FEEDBACKS = pytest.mark.parametrize("feedback", ["truth", "noisy", "ekf"])
ALL_PROFILES = pytest.mark.parametrize(
    "profile", ["thesis-lab", "thesis-printed", "husky-tile", "husky-wet-grass", "warthog-grass"]
)


class Consistency(NamedTuple):
    """Errors of a filter's pose in units of what it claims, over many runs."""

    t: FloatArray  # (K,) instants [s]
    nees: FloatArray
    """(runs, K) normalised squared errors of the pose, which should be chi-squared with 3 degrees of freedom."""
    thesis: FloatArray  # (runs, K) those of the thesis' filter, with a gyro that has no bias
    thesis_biased: FloatArray  # (runs, K) those of the thesis' filter, with the gyro of `nees`

    @property
    def band(self) -> tuple[float, float]:
        """Where 95 % of the means of `nees` over the runs should lie."""
        return chi_squared_band(3, len(self.nees))

    @property
    def inside(self) -> float:
        """Share of the instants at which the mean of `nees` over the runs lies within `band`."""
        return _share_within(self.nees, self.band)


def chi_squared_band(degrees: int, runs: int) -> tuple[float, float]:
    """Return the band in which 95 % of the means of `runs` independent chi-squared numbers lie."""
    low, high = (float(chdtri(degrees * runs, p)) / runs for p in (0.975, 0.025))
    return low, high


def _share_within(found: FloatArray, band: tuple[float, float]) -> float:
    mean = found.mean(axis=0)
    return float(np.mean((mean > band[0]) & (mean < band[1])))


def consistency_of(profile: Profile, plant: str, feedback: Feedback = "noisy", runs: int = 16, seed: int = 0) -> Consistency:
    """Commission a filter on one reference, and judge it on another, on robots that differ as it says that they may.

    A scheduled LQR drives the eight twice, from which the filter gets its constants and the size of its slip, then the sine,
    with other seeds, pushed as in Sec. 3.4.5. Each run begins with constants that are off by draws of its uncertainties.
    """
    robot, controller = make_robot(profile, plant), make_controller(profile, load_gains(TRACKER, DEFAULT))
    loop, settings = LoopSettings(feedback, filter=odometry_of(robot.drive)), commissioned(profile, plant, feedback)
    found = run_robots([robot] * runs, [controller] * runs, [loop] * runs, sine(_SPEED), range(seed, seed + runs))
    driven = [run.require_kept(f"{plant} of {profile.name}").motion for run in found]
    each = [_judge(truth, settings, np.random.default_rng([seed, k])) for k, truth in enumerate(driven)]
    t, *others = (np.array(column) for column in zip(*each, strict=True))
    return Consistency(t[0], *others)


def _judge(truth: Trajectory, settings: EkfSettings, rng: np.random.Generator) -> tuple[FloatArray, ...]:
    """Return the fields of a `Consistency` for one run."""
    bias, left, right, turning, shift, slide = rng.standard_normal(6)
    begins = replace(
        settings,
        scale_left=settings.scale_left + settings.scale_std * left,
        scale_right=settings.scale_right + settings.scale_std * right,
        turning=settings.turning + settings.turning_std * turning,
        shift=settings.shift + settings.centre_std * shift,
        slide=settings.slide + settings.centre_std * slide,
    )
    (x, y, yaw), (v, _, w) = truth.pose[0].tolist(), truth.twist[0].tolist()
    shown = settings.bias_std * float(bias)
    sensors = SensorModel(gyro_bias=shown)
    log = simulate_sensors(truth, rng, sensors, _RATE)
    begins = zeroed(begins, gyro_at_rest(sensors.packed(), rng))
    at = np.searchsorted(log.t, np.arange(_EVERY, log.t[-1], _EVERY) - 1e-9)
    thesis, found = EkfSettings(radius=settings.radius, half_track=settings.half_track), list[FloatArray]()
    for filter, read in ((begins, log), (thesis, log._replace(gyro=log.gyro - shown)), (thesis, log)):
        got = run_ekf(*read, filter, State(x, y, yaw, v_x=v, yaw_rate=w))
        error = got.pose[at] - truth.pose[np.searchsorted(truth.t, log.t[at] - 1e-9)]
        covariance = got.channels["pose_covariance"][at]
        found.append(np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]))
    return log.t[at], *found


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
    assert np.all(found.thesis_biased.mean(axis=0)[-3:] > 100.0)  # the thesis' filter on the same drives


@pytest.mark.slow
@ALL_PROFILES
@pytest.mark.parametrize("plant", ["linear", "kinematic", "coulomb", "improved"])
@ALL_FEEDBACKS
def test_on_every_planar_model_the_filter_is_as_sure_as_it_may_be(profile: str, plant: str, feedback: Feedback) -> None:
    found = consistency_of(load_profile(profile), plant, feedback)
    assert found.inside >= LEAST_INSIDE


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
