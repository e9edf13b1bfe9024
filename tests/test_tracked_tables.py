"""The thesis' tables of chapter 4: honest verdicts, and nothing left out."""

from __future__ import annotations

import numpy as np
import pytest

from ssmr.types import Trajectory
from validation.bench.gains import load_gains
from validation.bench.loops import make_controller
from validation.plants.profile import Profile
from validation.replicate.tracked import (
    K_11,
    K_33,
    PATH_RATE_HZ,
    TableEntry,
    supposed_gains,
    supposed_path,
    tracked_tables,
)


@pytest.fixture(scope="module")
def few(lab: Profile) -> list[TableEntry]:
    return list(tracked_tables(lab, 4, ("4.5", "4.6", "4.13", "4.27")))


def test_the_line_comes_out_as_printed(few: list[TableEntry]) -> None:
    """The two rows whose geometry and gains are certain: gap at the end and length, within what four seeds spread."""
    for entry in few[:2]:
        assert entry.verdict.status in ("agrees", "agrees if")
        assert entry.mean["d_haus_m"] == pytest.approx(entry.printed["d_haus_m"], rel=0.2)
        assert entry.mean["d_ratio"] == pytest.approx(entry.printed["d_ratio"], abs=1e-3)
        assert entry.lost == 0


def test_the_husky_is_as_near_the_prediction_as_the_real_one(few: list[TableEntry]) -> None:
    entry = few[2]
    assert entry.comparison == "simulated_vs_real"
    assert entry.mean["d_rms_m"] <= entry.printed["d_rms_m"]


def test_the_supposed_gains_are_those_of_the_regulator(lab: Profile) -> None:
    k = np.reshape(make_controller(lab, supposed_gains(load_gains("lqr", "manual"))).packed()[:8], (2, 4))
    assert (k[0, 0], k[1, 2]) == pytest.approx((K_11, K_33), rel=1e-6)
    assert abs(k[[0, 1], [1, 3]]).max() < 0.1, "hardly any feedback of rates"


def test_the_supposed_path_has_its_rate_and_both_ends() -> None:
    t = np.arange(0, 1001) * 0.008
    pose = np.column_stack([t, 0.0 * t, 0.0 * t])
    sampled = supposed_path(Trajectory(t, pose, pose, pose[:, :2]))
    assert (sampled.t[0], sampled.t[-1]) == (t[0], t[-1])
    assert np.all(np.diff(sampled.t[:-1]) >= 1.0 / PATH_RATE_HZ - 0.008)
    assert len(sampled.t) == pytest.approx(8.0 * PATH_RATE_HZ, abs=2)
