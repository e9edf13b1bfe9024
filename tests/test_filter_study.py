"""Dead reckoning: drift of known errors, and a study that repeats."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssmr.control.references import circle, line
from ssmr.types import Trajectory
from tests.conftest import ROUNDOFF
from validation.plants.profile import Profile
from validation.report.report import Report
from validation.study.filter import FilterStudy, drift_of, drive_missions

SMALL = FilterStudy(seeds=3, seed=5, timestep=0.005, frictions=(0.4,))
MISSIONS = {"circle": circle(0.5, turns=0.5), "line": line(0.5, length=4.0)}


def arc(length: float, curvature: float, n: int = 1201) -> Trajectory:
    """A path of constant curvature [1/m], driven at 1 m/s."""
    s = np.linspace(0.0, length, n)
    yaw = curvature * s
    xy = np.column_stack([np.sin(yaw), 1.0 - np.cos(yaw)]) / curvature if curvature else np.column_stack([s, 0.0 * s])
    twist = np.tile([1.0, 0.0, curvature], (n, 1))
    return Trajectory(s, np.column_stack([xy, yaw]), twist, np.zeros((n, 2)))


@pytest.fixture(scope="module")
def small(lab: Profile) -> Report:
    return drive_missions([lab], MISSIONS, SMALL)


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


def rows_of(study: Report, reference: str) -> dict[str, Any]:
    """The drift of each filter on a reference, on the profile's own ground."""
    rows = (row for row in study.tables[0].rows if row["reference"] == reference and row["surface"] == "thesis-lab")
    return {row["filter"]: row for row in rows}


def test_sensors_explain_the_drift(small: Report) -> None:
    f = rows_of(small, "circle")
    assert f["wheels + gyro"]["yaw_share"] < f["wheels"]["yaw_share"]
    assert f["radius known"]["position_share"] < f["wheels + gyro"]["position_share"]
    assert f["biased gyro"]["end_yaw_rad"] < -0.05
    assert f["commissioned"]["position_share"] < 0.7 * f["wheels + gyro"]["position_share"]
    assert f["commissioned, biased"]["position_share"] < 0.7 * f["biased gyro"]["position_share"]
    assert f["commissioned, biased"]["yaw_share"] == pytest.approx(f["commissioned"]["yaw_share"], rel=0.1)
    assert f["commissioned"]["yaw_share"] < 0.005


def test_a_study_repeats_whatever_the_workers(small: Report, lab: Profile) -> None:
    again = drive_missions([lab], MISSIONS, replace(SMALL, workers=1))
    assert again.as_dict() == small.as_dict()
    different = drive_missions([lab], {"circle": MISSIONS["circle"]}, replace(SMALL, seed=6, frictions=()))
    assert different.tables[1].rows[0] == small.tables[1].rows[0], "the same drive, other noise"
    assert rows_of(different, "circle")["wheels"] != rows_of(small, "circle")["wheels"]
