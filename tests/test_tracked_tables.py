"""The thesis' tables of chapter 4: honest verdicts, and nothing left out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssmr.types import Trajectory
from validation.bench.gains import load_gains
from validation.bench.loops import make_controller
from validation.plants.profile import Profile
from validation.replicate.tracked import (
    ALL_LOST,
    K_11,
    K_33,
    PATH_RATE_HZ,
    TABLE_METRICS,
    TableEntry,
    supposed_gains,
    supposed_path,
    tracked_tables,
)
from validation.thesis.verdicts import FACTOR, RATIO_REACH


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


def test_a_lost_print_is_said(few: list[TableEntry]) -> None:
    verdict = few[3].verdict
    assert (verdict.status, "lost" in verdict.reason) == ("not compared", True)
    assert few[3].mean["d_rms_m"] > 0.0


@pytest.mark.parametrize("comparison", ["reference_vs_simulated", "simulated_vs_real"])
def test_every_metric_is_judged_in_both_directions(few: list[TableEntry], comparison: Any) -> None:
    entry = replace(few[1], comparison=comparison, deviation={m: 0.0 for m in TABLE_METRICS}, supposed={})
    printed = entry.printed
    assert replace(entry, mean=printed).verdict.status == "agrees"
    for metric in ("d_rms_m", "d_haus_m"):
        for factor, status in ((FACTOR, "agrees"), (FACTOR + 0.01, "differs"), (1.0 / (FACTOR + 0.01), "nearer")):
            assert replace(entry, mean={**printed, metric: factor * printed[metric]}).verdict.status == status
    for change in (-RATIO_REACH, RATIO_REACH):
        ratio = printed["d_ratio"] + 1.01 * change
        assert replace(entry, mean={**printed, "d_ratio": ratio}).verdict.status == "differs"
    lost = replace(entry, mean={}).verdict
    assert (lost.status, lost.reason) == ("not compared", ALL_LOST)


def test_a_supposition_is_said_and_judged_by_the_whole_row(few: list[TableEntry]) -> None:
    entry = few[1]
    far = replace(entry, mean={**entry.printed, "d_rms_m": 9.0}, deviation={m: 0.0 for m in TABLE_METRICS})
    assert entry.supposed
    as_printed = {m: replace(s, value=entry.printed[m], spread=None) for m, s in entry.supposed.items()}
    found = replace(far, supposed=as_printed).verdict
    assert found.status == "agrees if"
    assert found.reason.startswith("it agrees if the simulated path was logged at 20 Hz")
    one_off = {**as_printed, "d_haus_m": replace(as_printed["d_haus_m"], value=9.0)}
    assert replace(far, supposed=one_off).verdict.status == "differs"
    assert replace(far, supposed=as_printed, mean=entry.printed).verdict.status == "agrees", "no supposition is needed"


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
