"""The study of runs.

Plants are fitted on the first half of a log and judged on the second, and a broken study goes on.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from validation.plants.profile import load_profile
from validation.study import runs
from validation.study.runs import study_runs

COLUMNS = {
    "log",
    "plant",
    "horizon_s",
    "position_median_m",
    "yaw_median_rad",
    "position_low_m",
    "position_high_m",
    "coverage_90_position",
    "coverage_90_yaw",
    "coverage_90_yaw_gyro",
    "yaw_gyro_median_rad",
    "n",
}


def test_a_log_is_fitted_judged_and_not_fitted_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = study_runs(("husky",), plants=("kinematic",), out=tmp_path)
    report.save(tmp_path)
    rows = json.loads((tmp_path / "study.json").read_text())["rows"]
    assert {frozenset(row) for row in rows} == {frozenset(COLUMNS)}
    assert [row["horizon_s"] for row in rows][:2] == [2.0, 6.0]
    assert all(
        row["position_low_m"] <= row["position_median_m"] <= row["position_high_m"] for row in rows
    )
    errors = [row["position_median_m"] for row in rows]
    assert 0.0 < errors[0] < errors[1] < 0.2
    assert np.mean([row["coverage_90_position"] for row in rows]) > 0.6
    assert "wheels" in load_profile(tmp_path / "husky.toml").plants["kinematic"].bands
    monkeypatch.setattr(runs, "fit", None)
    again = study_runs(("husky",), plants=("kinematic",), out=tmp_path)
    assert again.document()["rows"] == report.document()["rows"]
    assert 0.8 < again.document()["numbers"]["husky"]["kinematic"]["alpha_l"] < 1.05


@pytest.mark.parametrize(
    ("logs", "plants", "message"),
    [
        ((), ("kinematic",), "no log is named"),
        (("husky",), ("carriage",), "unknown plant 'carriage'"),
        (("husky@ox",), ("kinematic",), "ox"),
        (("husky", "husky"), ("kinematic",), "two logs have the name husky"),
    ],
)
def test_mistakes_are_named(
    logs: tuple[str, ...], plants: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        study_runs(logs, plants=plants, out=tmp_path)
