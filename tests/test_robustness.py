"""Robustness: the numbers of a study mean what they say, and every controller meets the same."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any, get_type_hints

import numpy as np
import pytest

from ssmr.control.loop import ClosedRun
from ssmr.control.references import circle, line
from ssmr.control.tick import LOG_COLUMNS, LOST
from tests.conftest import ROUNDOFF, exit_status
from validation.bench.gains import FIELDS, GainsError, GainSet, load_gains
from validation.bench.loops import make_controller, make_robot, run_robots
from validation.bench.mismatch import NOMINAL, single_mismatches
from validation.plants.profile import Profile
from validation.simulator.plant import MujocoPlant
from validation.study.__main__ import PROGRAM
from validation.study.catalogue import STUDIES, Study
from validation.study.result import StudyResult
from validation.study.robustness import Robustness, RobustnessOptions, study_robustness
from validation.study.robustness.cases import draw_cases
from validation.study.robustness.outcomes import RunErrors, driven_again, errors_of, health_of

MISSION = line(0.75, length=3.6)
"""So long that a robot that stands still is lost."""
SMALL = RobustnessOptions(reference=MISSION, runs=18, seeds=1, seed=3, timestep=0.005)


def gains_of(**controllers: str) -> dict[str, GainSet]:
    return {name: load_gains(name, gains) for name, gains in controllers.items()}


def hopeless() -> GainSet:
    """A PID that stands still."""
    return GainSet("pid", "hopeless", dict.fromkeys(FIELDS["pid"], 0.0))


@pytest.fixture(scope="module")
def small(lab: Profile) -> Robustness:
    chosen = {"pid": hopeless(), **gains_of(lqr="manual")}
    return study_robustness(replace(SMALL, profile=lab, gains=chosen))


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
        RobustnessOptions(runs=61, seeds=4)


def test_a_study_counts_its_failures(small: Robustness) -> None:
    document = small.as_dict()
    for name, tested in small.controllers.items():
        grid = [o for c, o in zip(small.cases, tested.errors, strict=True) if c.kind == "drawn"]
        assert document["controllers"][name]["failure_rate"] == sum(o.failed(0.5) for o in grid) / len(grid)
        assert len(tested.errors) == len(small.cases) == 18
    assert document["controllers"]["pid"]["failure_rate"] == 1.0
    assert document["controllers"]["lqr"]["failure_rate"] == 0.0


def test_documents_are_finite_also_with_lost_runs(small: Robustness) -> None:
    assert any(o.lost_at_s is not None for o in small.controllers["pid"].errors)
    document = small.as_dict()
    assert document["schema"] == "ssmr.study/1"
    assert document["study"] == "robustness"
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["controllers"]["lqr"]["runs"][0]["lost_at_s"] is None
    assert all(word not in "\n".join(small.report()) for word in ("nan", "inf "))


def test_controllers_meet_the_same_and_alone_or_together_means_the_same(lab: Profile, small: Robustness) -> None:
    alone = study_robustness(replace(SMALL, profile=lab, gains=gains_of(lqr="manual")), workers=1)
    assert alone.cases == small.cases
    assert alone.controllers["lqr"].errors == small.controllers["lqr"].errors


def test_another_seed_is_another_study(lab: Profile, small: Robustness) -> None:
    found = study_robustness(replace(SMALL, profile=lab, gains=gains_of(lqr="manual"), seed=4))
    assert found.controllers["lqr"].errors != small.controllers["lqr"].errors


def test_health_is_that_of_the_run_itself(lab: Profile) -> None:
    waypoints, law = circle(0.5, turns=0.25), make_controller(lab, load_gains("lqr", "manual"))
    robot, loop = make_robot(lab, "mujoco"), SMALL.loop()
    assert isinstance(robot.body, MujocoPlant)
    (run,) = run_robots([robot], [law], [loop], waypoints, [5])
    motion = driven_again(run, waypoints, robot, loop, 5)
    shared = motion.pose[:: round(loop.position_period / robot.body.dt)]
    assert np.abs(shared - run.columns("x", "y", "yaw")[: len(shared)]).max() < ROUNDOFF
    assert health_of(run, waypoints, robot, loop, 5).ok


def test_gains_fall_back_to_defaults_and_say_so() -> None:
    few = replace(SMALL, controllers=("pid", "smc"), gains=("published",), runs=17)
    found = study_robustness(few)
    assert [runs.gains.name for runs in found.controllers.values()] == ["pid-published", "smc-default"]
    assert [note for note in found.notes() if "defaults" in note] == ["smc has no gains 'published'; its defaults are used."]
    assert found.heading().startswith("profile thesis-lab, ")
    with pytest.raises(GainsError, match="there are"):
        study_robustness(replace(few, gains=("pubished",)))


def test_the_picture_has_every_controller(small: Robustness) -> None:
    figure = small.figure()
    drawn = {line.get_gid() for ax in figure.axes for line in ax.get_lines()}
    assert {"pid", "lqr", "pid lost"} <= drawn
    labels = [[tick.get_text() for tick in ax.get_yticklabels()] for ax in figure.axes]
    assert [NOMINAL, *(m.label for m in small.single)] in labels


def run_program(*arguments: str) -> int:
    """Exit status of the program, in this process."""
    return exit_status(PROGRAM, *arguments)


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.name)
def test_a_declaration_leads_to_options_a_function_and_a_result(study: Study) -> None:
    assert study.options().__class__ is study.options
    result = get_type_hints(study.run)["return"]
    assert issubclass(result, StudyResult)
    assert (result.study, study.question[-1]) == (study.name, "?")
