"""The study of runs.

Plants are fitted on the first half of a log and judged on the second, and a broken study goes on.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.test_several_logs import BODY, DAYS, drive
from validation.plants.profile import load_profile
from validation.study import runs
from validation.study.runs import study_runs
from validation.study.runs_tables import BOTH, ON, OTHERS, OWN, worth

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
    "interval_score_90_position",
    "interval_score_90_yaw",
    "interval_score_90_yaw_gyro",
    "yaw_gyro_median_rad",
    "heading_judge",
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


def test_other_logs_of_one_body_predict_as_well_as_its_own(tmp_path: Path) -> None:
    """A second half does not know from which of one body's days the numbers came."""
    logs = [drive(tmp_path, f"day{k}", {**BODY, **DAYS[k]}, k) for k in (0, 3)]
    report = study_runs(
        tuple(map(str, logs)), robot="husky", plants=("kinematic",), out=tmp_path / "out"
    )
    rows = [row for row in report.document()["rows_by_robot"] if row["horizon_s"] == 6.0]
    assert [row["log"] for row in rows] == ["day0"] * 4 + ["day3"] * 4
    for fitted_to in (OWN, OTHERS, ON, BOTH):
        errors = [row["position_median_m"] for row in rows if row["fitted_to"] == fitted_to]
        # noise of 5 mm at both ends of a window is 9 mm in the median, and the localiser's
        # lateness is the other day's
        assert max(errors) < (0.06 if fitted_to in (OTHERS, ON) else 0.02), fitted_to
    assert f"Fitted to {OTHERS}" in report.to_markdown()


def test_the_worth_of_other_logs_is_a_geometric_mean() -> None:
    rows = []
    for log, own, other in (("a", 0.1, 0.05), ("b", 0.2, 0.1), ("c", 1.0, 2.0), ("d", 0.4, 0.2)):
        for fitted_to, error in ((OWN, own), (OTHERS, other)):
            row = {"log": log, "fitted_to": fitted_to, "horizon_s": 6.0}
            rows.append({**row, "position_median_m": error})
    told = worth(rows, OTHERS)
    # logarithms of the ratios to the base of two are -1, -1, 1 and -1
    assert "has 0.71 of the position error" in told
    assert "(0.31–1.60 with 90 %)" in told
    assert "of 4 logs, of which 3 are better" in told


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
