"""Robustness: the numbers of a study mean what they say, and every controller meets the same."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.loop import ClosedRun
from ssmr.control.references import circle, line
from ssmr.control.tick import LOG_COLUMNS, LOST
from tests.conftest import ROUNDOFF
from validation import cli
from validation.plants.profile import Profile
from validation.robots.plant import MujocoPlant
from validation.study.__main__ import program
from validation.study.robustness import run as study
from validation.study.robustness.figure import draw_robustness
from validation.study.robustness.run import Mismatch, Outcome, Robustness, RobustnessSettings
from validation.track.gains import FIELDS, GainsError, GainSet, load_gains

SMALL = RobustnessSettings(runs=14, seeds=1, seed=3, timestep=0.005)
MISSION = line(0.75, length=3.6)
"""So long that who stands still is lost."""


def gains_of(**controllers: str) -> dict[str, GainSet]:
    return {name: load_gains(name, gains) for name, gains in controllers.items()}


def hopeless() -> GainSet:
    """A PID that stands still."""
    return GainSet("pid", "hopeless", dict.fromkeys(FIELDS["pid"], 0.0))


@pytest.fixture(scope="module")
def small(lab: Profile) -> Robustness:
    chosen = {"pid": hopeless(), **gains_of(lqr="manual")}
    return study.study_robustness(lab, chosen, "line", MISSION, SMALL)


def test_cvar_is_the_mean_of_the_worse_half() -> None:
    assert study.cvar([1.0, 4.0, 2.0, 3.0]) == 3.5
    assert study.cvar([5.0]) == 5.0


def test_cvar_counts_a_part_of_a_value_as_a_part() -> None:
    assert study.cvar([1.0, 2.0, 3.0]) == pytest.approx((3.0 + 0.5 * 2.0) / 1.5, rel=ROUNDOFF)
    assert study.cvar([1.0, 2.0, 3.0, 4.0], 0.9) == pytest.approx(4.0, rel=ROUNDOFF)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.floats(0.0, 0.99))
def test_cvar_lies_between_mean_and_worst(values: list[float], level: float) -> None:
    slack = 1e-9  # of sums of up to 40 numbers as great as 1e3
    assert np.mean(values) - slack <= study.cvar(values, level) <= max(values) + slack
    assert study.cvar(values, 0.0) == pytest.approx(np.mean(values), rel=ROUNDOFF, abs=slack)


@pytest.mark.parametrize(("values", "level"), [([], 0.5), ([1.0], 1.0), ([1.0], -0.1)])
def test_cvar_refuses_what_has_no_tail(values: list[float], level: float) -> None:
    with pytest.raises(ValueError, match="level"):
        study.cvar(values, level)


def test_spread_of_known_numbers() -> None:
    found = study.spread([1.0, 2.0, 3.0, 6.0])
    assert (found.mean, found.cvar, found.worst) == (3.0, 4.5, 6.0)
    assert found.std == pytest.approx(math.sqrt(14.0 / 3.0), rel=ROUNDOFF)
    assert study.spread([2.0]).std == 0.0


def test_a_run_fails_by_being_lost_or_far_off() -> None:
    outcomes = [Outcome(0.1, 0.2, None), Outcome(0.1, 0.2, 3.0), Outcome(0.6, 0.1, None), Outcome(0.1, 0.6, None)]
    assert [o.failed(0.5) for o in outcomes] == [False, True, True, True]


def test_what_a_lost_robot_did_not_drive_counts_as_lost() -> None:
    waypoints, ticks = line(0.5, length=1.0), 201
    table = np.zeros((21, len(LOG_COLUMNS)))
    table[:, LOG_COLUMNS.index("e_rho")] = 1.0
    table[-1, LOG_COLUMNS.index("x")] = 1e60  # where it was seen last says nothing
    run = ClosedRun(0.01 * np.arange(21), table, True)
    robot: Any = type("Robot", (), {"side_limit": 1.0, "drive": type("Drive", (), {"v_max": 1.0, "w_max": 1.0})})
    outcome = study.outcome_of(run, waypoints, robot, ticks)
    assert outcome.lost_at_s == pytest.approx(0.2)
    assert outcome.e_rho_rms_m == pytest.approx(math.sqrt((20.0 + 181.0 * LOST**2) / 201.0), rel=ROUNDOFF)
    assert 0.3 < outcome.d_rms_m < 1.0  # of a metre of which none was driven: 1 / sqrt(3)
    at_once = study.outcome_of(ClosedRun(run.t[:1], table[-1:], True), waypoints, robot, ticks)
    assert (at_once.d_rms_m, at_once.e_rho_rms_m) == (LOST, LOST)


def test_every_level_alone_and_the_full_grid() -> None:
    assert len(study.alone()) == sum(len(levels) - 1 for levels in study.LEVELS.values())
    assert len(set(study.full_grid())) == math.prod(map(len, study.LEVELS.values()))
    assert all(m in study.full_grid() for m in (Mismatch(), *study.alone()))
    assert len({m.label for m in study.full_grid()}) == len(study.full_grid())


def test_cases_are_those_asked_for() -> None:
    cases = study.make_cases(120, 3, 7)
    singles = 3 * (1 + len(study.alone()))
    assert len(cases) == 120
    assert [c.kind for c in cases].count("nominal") == 3
    assert {c.seed for c in cases[:singles]} == {7, 8, 9}
    sample = [c.mismatch for c in cases[singles:]]
    assert len(set(sample)) == len(sample) == 120 - singles
    assert len({c.seed for c in cases[singles:]} | {7, 8, 9}) == len(sample) + 3
    assert cases == study.make_cases(120, 3, 7)
    assert cases != study.make_cases(120, 3, 8)


def test_a_sample_greater_than_the_grid_begins_it_anew() -> None:
    sample = [c.mismatch for c in study.make_cases(11 + 2 * len(study.full_grid()), 1, 0) if c.kind == "grid"]
    assert all(sample.count(m) == 2 for m in set(sample))


def test_too_few_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        RobustnessSettings(runs=45, seeds=4)


def test_mismatches_become_the_robots(lab: Profile) -> None:
    section = lab.plants["mujoco"]
    p, drive = section.parameters, section.drive
    body = study.mismatched(lab, Mismatch(1.3, -0.05, 0.05, 0.1, 2.0, 0.8), 0.005, 100.0).body
    assert isinstance(body, MujocoPlant)
    c = body.calibration
    assert (c.friction, c.com_x, c.com_y, c.timestep) == (1.3 * p.friction, p.com_x - 0.05, p.com_y + 0.05, 0.005)
    assert (body.drive.delay_v, body.drive.delay_w) == (drive.delay_v + 0.1, drive.delay_w + 0.1)
    assert body.drive.torque_limit == 80.0
    noise = SMALL.loop(Mismatch(noise=2.0)).deviations() / SMALL.loop(Mismatch()).deviations().clip(1e-300)
    assert noise[:8] == pytest.approx(math.sqrt(2.0), rel=ROUNDOFF)


def test_delays_do_not_become_negative(lab: Profile) -> None:
    assert study.mismatched(lab, Mismatch(delay=-5.0), 0.005, 1.0).drive.delay_v == 0.0


def test_the_reference_takes_less_torque_than_the_profile_allows(lab: Profile) -> None:
    needed = study.torque_needed(lab, circle(0.5, turns=0.1), 0.002)
    assert 1.0 < needed < 0.8 * lab.plants["mujoco"].drive.torque_limit


def test_a_study_counts_its_failures(small: Robustness) -> None:
    document = study.as_document(small)
    for name, tested in small.tested.items():
        grid = [o for c, o in zip(small.cases, tested.outcomes, strict=True) if c.kind == "grid"]
        assert document["controllers"][name]["failure_rate"] == sum(o.failed(0.5) for o in grid) / len(grid)
        assert len(tested.outcomes) == len(small.cases) == 14
    assert document["controllers"]["pid"]["failure_rate"] == 1.0
    assert document["controllers"]["lqr"]["failure_rate"] == 0.0


def test_documents_are_finite_also_with_lost_runs(small: Robustness) -> None:
    assert any(o.lost_at_s is not None for o in small.tested["pid"].outcomes)
    document = study.as_document(small)
    assert document["schema"] == "ssmr.study/1"
    assert document["study"] == "robustness"
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["controllers"]["lqr"]["runs"][0]["lost_at_s"] is None
    assert all(word not in "\n".join(study.markdown(small)) for word in ("nan", "inf "))


def test_controllers_meet_the_same_and_alone_or_together_means_the_same(lab: Profile, small: Robustness) -> None:
    alone = study.study_robustness(
        lab, gains_of(lqr="manual"), "line", MISSION, SMALL, workers=1
    )  # one thread instead of all, too
    assert alone.cases == small.cases
    assert alone.tested["lqr"].outcomes == small.tested["lqr"].outcomes
    assert alone.torque == small.torque


def test_another_seed_is_another_study(lab: Profile, small: Robustness) -> None:
    other = RobustnessSettings(runs=14, seeds=1, seed=4, timestep=0.005)
    found = study.study_robustness(lab, gains_of(lqr="manual"), "line", MISSION, other)
    assert found.tested["lqr"].outcomes != small.tested["lqr"].outcomes


def test_health_is_that_of_the_run_itself(lab: Profile) -> None:
    waypoints, law = circle(0.5, turns=0.25), study.make_controller(lab, load_gains("lqr", "manual"))
    robot, loop = study.mismatched(lab, Mismatch(), 0.002, math.inf), SMALL.loop(Mismatch())
    assert isinstance(robot.body, MujocoPlant)
    (run,) = study.run_robots([robot], [law], [loop], waypoints, [5])
    motion = study.driven_again(run, waypoints, robot, loop, 5)
    shared = motion.pose[:: round(loop.position_period / robot.body.dt)]
    assert np.abs(shared - run.columns("x", "y", "yaw")[: len(shared)]).max() < ROUNDOFF
    assert study.health_of(run, waypoints, robot, loop, 5).ok


def test_gains_fall_back_to_defaults_and_say_so() -> None:
    chosen, remarks = study.choose_gains(("pid", "smc"), "published")
    assert (chosen["pid"].name, chosen["smc"].name) == ("pid-published", "smc-default")
    assert len(remarks) == 1
    assert "smc" in remarks[0]
    assert study.choose_gains(("pid",), "default")[1] == []
    with pytest.raises(GainsError, match="there are"):
        study.choose_gains(("pid",), "pubished")


def test_the_picture_has_every_controller(small: Robustness) -> None:
    figure = draw_robustness(small)
    drawn = {line.get_gid() for ax in figure.axes for line in ax.get_lines()}
    assert {"pid", "lqr", "pid lost"} <= drawn
    labels = [tick.get_text() for tick in figure.axes[5].get_yticklabels()]
    assert labels == [study.NOMINAL, *(m.label for m in study.alone())]


def run_program(*arguments: str) -> int:
    """Exit status of the program, in this process: starting another takes longer than what it does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["study", *arguments])
        try:
            cli.run(program(), "python -m validation.study")
        except SystemExit as left:
            return int(left.code or 0)
    return 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("--controllers", "pdi"),
        ("--gains", "pubished"),
        ("--reference", "nowhere.csv"),
        ("--runs", "10"),
        ("--timestep", "0.003"),
        ("--speed", "9"),
        ("--bound", "-1"),
        ("--seed", "-1"),
    ],
    ids=lambda a: a[0],
)
def test_mistakes_are_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, str]
) -> None:
    assert run_program("robustness", *arguments, "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert said[0].startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_the_program_writes_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "short.csv", tmp_path / "out"
    path.write_text("x,y\n0,0\n0.5,0\n0.8,0.1\n", encoding="utf-8")
    asked = ("--controllers", "lqr", "--reference", str(path), "--runs", "13", "--seeds", "1", "--timestep", "0.005")
    assert run_program("robustness", *asked, "--out", str(out)) == 0
    assert {p.name for p in out.iterdir()} == {"study.json", "study.png", "study.md"}
    assert "lqr" in capsys.readouterr().out
    document = json.loads((out / "study.json").read_text(encoding="utf-8"))
    assert len(document["controllers"]["lqr"]["runs"]) == 13
    assert "| lqr |" in (out / "study.md").read_text(encoding="utf-8")
