"""Dead reckoning: drift of known errors, and a study that repeats."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ssmr.control.references import circle, line
from ssmr.types import Trajectory
from tests.conftest import ROUNDOFF
from validation.plants.profile import Profile
from validation.study.filter import FilterOptions, FilterStudy
from validation.study.filter.findings import drift_of, filter_variants, grounds_of
from validation.study.filter.run import drive_missions

SMALL = FilterOptions(seeds=3, seed=5, timestep=0.005, plants=("linear",), feedbacks=("truth",), runs=4)
MISSIONS = {"circle": circle(0.5, turns=0.5), "line": line(0.5, length=4.0)}


def arc(length: float, curvature: float, n: int = 1201) -> Trajectory:
    """A path of constant curvature [1/m], driven at 1 m/s."""
    s = np.linspace(0.0, length, n)
    yaw = curvature * s
    xy = np.column_stack([np.sin(yaw), 1.0 - np.cos(yaw)]) / curvature if curvature else np.column_stack([s, 0.0 * s])
    twist = np.tile([1.0, 0.0, curvature], (n, 1))
    return Trajectory(s, np.column_stack([xy, yaw]), twist, np.zeros((n, 2)))


@pytest.fixture(scope="module")
def small(lab: Profile) -> FilterStudy:
    return drive_missions(grounds_of([lab], [0.4]), MISSIONS, SMALL)


def test_the_truth_has_no_drift() -> None:
    drift = drift_of(arc(7.0, 0.5), arc(7.0, 0.5))
    assert (drift.position, drift.yaw, drift.end, drift.end_yaw) == (0.0, 0.0, 0.0, 0.0)


def test_an_error_of_scale_is_its_share_of_the_distance() -> None:
    drift = drift_of(arc(6.06, 0.0), arc(6.0, 0.0))
    assert drift.position == pytest.approx(0.01, rel=1e-6)  # the stretches end on samples 5 mm apart
    assert drift.end == pytest.approx(0.01, rel=ROUNDOFF)
    assert math.isnan(drift.yaw)


def test_yaw_drift_is_its_share_of_what_was_turned_also_on_a_path_that_closes() -> None:
    truth = arc(4.0 * math.pi, 0.5)  # a full circle
    believed = Trajectory(truth.t, truth.pose * [1.0, 1.0, 1.1], truth.twist, truth.wheels)
    drift = drift_of(believed, truth)
    assert drift.yaw == pytest.approx(0.1, rel=1e-6)
    assert drift.end_yaw == pytest.approx(0.2 * math.pi, rel=ROUNDOFF)
    assert drift.end == pytest.approx(0.0, abs=1e-9)


def test_the_filter_has_the_drivers_numbers(lab: Profile) -> None:
    (ground,) = grounds_of([lab], [])
    section = lab.plants["mujoco"]
    for variant in filter_variants()[:4]:
        settings = ground.filter_settings(variant)
        known = section.parameters.wheel_radius if variant.radius_known else section.drive.command_radius
        assert (settings.radius, settings.half_track) == (known, section.drive.command_half_track)


def test_sensors_explain_the_drift(small: FilterStudy) -> None:
    for drive in small.drives:
        if drive.reference == "circle":
            f = drive.filters
            assert f["wheels + gyro"].mean("yaw") < f["wheels"].mean("yaw")
            assert f["radius known"].mean("position") < f["wheels + gyro"].mean("position")
            assert f["biased gyro"].mean("end_yaw") < -0.05
            assert f["commissioned"].mean("position") < 0.7 * f["wheels + gyro"].mean("position")
            assert f["commissioned, biased"].mean("position") < 0.7 * f["biased gyro"].mean("position")
            assert f["commissioned, biased"].mean("yaw") == pytest.approx(f["commissioned"].mean("yaw"), rel=0.1)
            assert f["commissioned"].mean("yaw") < 0.005


def test_a_study_repeats_whatever_the_workers(small: FilterStudy, lab: Profile) -> None:
    again = drive_missions(grounds_of([lab], [0.4]), MISSIONS, SMALL, workers=1)
    assert again.as_dict() == small.as_dict()
    first, other = small.drives[0], replace(SMALL, seed=6)
    different = drive_missions(grounds_of([lab], []), {"circle": MISSIONS["circle"]}, other)
    assert different.drives[0].distance == first.distance  # the same drive, other noise
    assert different.drives[0].filters["wheels"].drifts != first.filters["wheels"].drifts
