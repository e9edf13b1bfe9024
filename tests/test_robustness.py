"""Robustness: the numbers of a study mean what they say, and every controller meets the same."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from ssmr.control.loop import ClosedRun
from ssmr.control.references import line
from ssmr.control.tick import LOG_COLUMNS, LOST
from tests.conftest import ROUNDOFF, exit_status
from validation.bench.gains import FIELDS, GainsError, GainSet, load_gains
from validation.bench.mismatch import single_mismatches
from validation.plants.profile import Profile
from validation.report.report import Report
from validation.study.__main__ import PROGRAM
from validation.study.robustness import RobustnessStudy, RunErrors, draw_cases, errors_of, study_robustness

MISSION = line(0.75, length=3.6)
"""So long that a robot that stands still is lost."""
SMALL: dict[str, Any] = {"reference": MISSION, "runs": 18, "seeds": 1, "seed": 3, "timestep": 0.005}


def gains_of(**controllers: str) -> dict[str, GainSet]:
    return {name: load_gains(name, gains) for name, gains in controllers.items()}


def hopeless() -> GainSet:
    """A PID that stands still."""
    return GainSet("pid", "hopeless", dict.fromkeys(FIELDS["pid"], 0.0))


@pytest.fixture(scope="module")
def small(lab: Profile) -> Report:
    chosen = {"pid": hopeless(), **gains_of(lqr="manual")}
    return study_robustness(**SMALL, profile=lab, gains=chosen)


def test_a_run_fails_by_being_lost_or_far_off() -> None:
    outcomes = [RunErrors(0.1, 0.2, None), RunErrors(0.1, 0.2, 3.0), RunErrors(0.6, 0.1, None), RunErrors(0.1, 0.6, None)]
    assert [o.failed(0.5) for o in outcomes] == [False, True, True, True]


def test_what_a_lost_robot_did_not_drive_counts_as_lost() -> None:
    waypoints, ticks = line(0.5, length=1.0), 201
    table = np.zeros((21, len(LOG_COLUMNS)))
    table[:, LOG_COLUMNS.index("e_rho")] = 1.0
    table[-1, LOG_COLUMNS.index("x")] = 1e60  # where it was seen last says nothing
    run = ClosedRun(0.01 * np.arange(21), table, True)
    robot: Any = type("Robot", (), {"limits": {}})
    outcome = errors_of(run, waypoints, robot, ticks)
    assert outcome.lost_at_s == pytest.approx(0.2)
    assert outcome.e_rho_rms_m == pytest.approx(math.sqrt((20.0 + 181.0 * LOST**2) / 201.0), rel=ROUNDOFF)
    assert 0.3 < outcome.d_rms_m < 1.0  # of a metre of which none was driven: 1 / sqrt(3)
    at_once = errors_of(ClosedRun(run.t[:1], table[-1:], True), waypoints, robot, ticks)
    assert (at_once.d_rms_m, at_once.e_rho_rms_m) == (LOST, LOST)


def test_cases_are_those_asked_for(lab: Profile) -> None:
    cases = draw_cases(120, 3, 7, lab.robot)
    singles = 3 * (1 + len(single_mismatches(lab.robot)))
    assert len(cases) == 120
    assert [c.kind for c in cases].count("nominal") == 3
    assert {c.seed for c in cases[:singles]} == {7, 8, 9}
    drawn = [c.mismatch for c in cases[singles:]]
    assert len(set(drawn)) == len(drawn) == 120 - singles
    assert len({c.seed for c in cases[singles:]} | {7, 8, 9}) == len(drawn) + 3
    assert cases == draw_cases(120, 3, 7, lab.robot)
    assert cases != draw_cases(120, 3, 8, lab.robot)


def test_too_few_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        RobustnessStudy(runs=61, seeds=4)


def test_a_study_counts_its_failures(small: Report) -> None:
    (pid, lqr), alone = (table.rows for table in small.tables)
    document = small.as_dict()
    drawn = [k for k, case in enumerate(document["cases"]) if case["kind"] == "drawn"]
    assert len(document["runs"]["pid"]) == len(document["cases"]) == 18
    assert (pid["failed"], lqr["failed"]) == (len(drawn), 0)
    assert pid["d_rms_worst_m"] == max(document["runs"]["pid"][k]["d_rms_m"] for k in drawn)
    assert all(row["failed"] == "pid 1/1" for row in alone)


def test_documents_are_finite_also_with_lost_runs(small: Report) -> None:
    document = small.as_dict()
    assert any(run["lost_at_s"] is not None for run in document["runs"]["pid"])
    assert document["runs"]["lqr"][0]["lost_at_s"] is None
    assert (document["schema"], document["study"]) == ("ssmr.study/1", "robustness")
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert all(word not in "\n".join(small.report()) for word in ("nan", "inf "))


def test_controllers_meet_the_same_and_alone_or_together_means_the_same(lab: Profile, small: Report) -> None:
    alone = study_robustness(**SMALL, profile=lab, gains=gains_of(lqr="manual"), workers=1).as_dict()
    assert alone["cases"] == small.as_dict()["cases"]
    assert alone["runs"]["lqr"] == small.as_dict()["runs"]["lqr"]


def test_gains_fall_back_to_defaults_and_say_so() -> None:
    few = {**SMALL, "controllers": ("pid", "smc"), "runs": 17}
    found = study_robustness(**few, gains=("published",))
    assert [row["gains"] for row in found.tables[0].rows] == ["pid-published", "smc-default"]
    assert found.notes() == ["smc has no gains 'published'; its defaults are used."]
    assert "profile thesis-lab, " in found.title
    with pytest.raises(GainsError, match="there are"):
        study_robustness(**few, gains=("pubished",))


def run_program(*arguments: str) -> int:
    """Exit status of the program, in this process."""
    return exit_status(PROGRAM, *arguments)
