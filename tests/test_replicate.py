"""The replication: every table of the thesis has its rows, verdicts and simple checks."""

from __future__ import annotations

import inspect
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from ssmr.types import Trajectory
from tests.conftest import ROUNDOFF, exit_status, installed_plant
from validation.engines.body import EngineMissingError
from validation.experiment.gains import FIELDS, load_gains
from validation.experiment.loops import make_controller
from validation.output import Progress, ignore_progress
from validation.plants.profile import Profile
from validation.replicate import gazebo, published, replicate
from validation.replicate.chapters import (
    QUICK,
    Findings,
    Task,
    chapter_lines,
    chapter_of,
    chosen_sections,
    read_template,
)
from validation.replicate.control import (
    CONTROL_TABLES,
    K_11,
    K_33,
    PATH_RATE_HZ,
    TUNED_TABLES,
    supposed_gains,
    supposed_path,
    track_tables,
)
from validation.replicate.lab import high_pass, variance_above
from validation.replicate.models import alternating_samples
from validation.replicate.published import printed_value
from validation.replicate.run import ALL_SECTIONS, Replication
from validation.replicate.verdicts import EVIDENCE, STATUSES

PLACES = {f"Sec. {n}" for n in ("3.7", "4.5, motors")} | {"Fig. 3.33"}
WANTED = PLACES | {*"3.4 3.8 3.9 3.11 3.12 3.14 3.15 4.4 4.21 4.37".split(), *CONTROL_TABLES}
SMALL = {**QUICK, "fit": (8, 3), "draws": 1}
TASK = Task(1, 2, ignore_progress, **SMALL)


# --------------------------------------------------------------------------------------------------
# the program


def test_every_table_of_the_thesis_has_one_section_that_answers_for_it() -> None:
    answered = [number for numbers, _ in ALL_SECTIONS.values() for number in numbers]
    assert len(answered) == len(set(answered))
    assert set(answered) == WANTED


def test_sections_are_chosen_by_key_and_by_table_in_their_own_order() -> None:
    assert list(chosen_sections(ALL_SECTIONS, ("4.9", "noise", "3.9"))) == [
        "noise",
        "fit-coulomb",
        "tables",
    ]
    with pytest.raises(ValueError, match=r"'5\.1' in only is no section"):
        replicate(only=("noise", "5.1"))


def test_every_template_has_a_caption_for_each_of_its_tables() -> None:
    for key, (numbers, _) in ALL_SECTIONS.items():
        text = read_template(key.partition("-")[0]).splitlines()
        headings = [line[3:].partition(": ")[0] for line in text if line.startswith("## ")]
        spans = [h.split("–") for h in headings if not h.startswith("{")]
        shown = {t for span in spans for t in span}
        assert len(headings) == len(numbers) or shown <= set(numbers), key


def test_files_hold_every_number_beside_ours_with_a_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("validation.replicate.run.QUICK", SMALL)
    report = replicate(quick=True, only=("3.9",), workers=2)
    assert [p.name for p in report.save(tmp_path)] == [
        "replicate.json",
        "replicate.png",
        "replicate.md",
    ]
    document = json.loads((tmp_path / "replicate.json").read_text(encoding="utf-8"))
    assert (document["schema"], document["quick"]) == ("ssmr.replicate/1", True)
    assert list(document["tables"]) == ["3.8", "3.9"]
    for number, table in document["tables"].items():
        for row, metrics in table["rows"].items():
            assert table["verdicts"][row]["verdict"] in STATUSES
            assert table["verdicts"][row]["evidence"] in EVIDENCE
            for metric, pair in metrics.items():
                assert {"published", "ours"} <= set(pair)
                assert pair["verdict"] == "agrees" or pair["reason"], (number, row, metric)
    for row, printed in published.printed_table("3.9")["rows"].items():
        assert {
            m: document["tables"]["3.9"]["rows"][row][m]["published"] for m in printed
        } == printed
    assert (
        document["tables"]["3.8"]["rows"]["tau_max_wheel_N_m"]["value"]["verdict"] == "not compared"
    )
    assert sum(document["verdicts"].values()) == 6 + 4
    assert document["verdicts"] == {
        s: sum(some[s] for some in document["evidence"].values()) for s in STATUSES
    }
    text = (tmp_path / "replicate.md").read_text(encoding="utf-8")
    assert all(f"| {row} |" in text for row in published.printed_table("3.8")["rows"])
    assert "{" not in text


def test_help_has_every_option_and_what_it_means() -> None:
    for option in inspect.signature(replicate).parameters:
        assert re.search(rf"^    {option}: \w", replicate.__doc__, re.MULTILINE), option


def test_an_interrupt_keeps_the_sections_that_are_finished() -> None:
    def stop(now: Progress) -> None:
        if "accelerations" in now.text:
            raise KeyboardInterrupt

    report = replicate(quick=True, only=("noise", "accelerations"), progress=stop)
    assert report.status == "interrupted"
    assert list(report.findings) == ["noise"]
    with pytest.raises(KeyboardInterrupt):
        replicate(quick=True, only=("accelerations",), progress=stop)
    assert exit_status(replicate, "--only", "5.1") == 2


# --------------------------------------------------------------------------------------------------
# numbers


def test_the_noise_of_the_simulated_lab_is_found_by_the_procedure_of_the_thesis() -> None:
    """White noise of the printed variances leaves the share that the filter lets pass.

    Wrong stamps are noise of X alone.
    """
    measured = ALL_SECTIONS["noise"][1](TASK._replace(draws=3))
    for name, pairs in measured.tables["3.4"].items():
        pair = pairs["variance"]
        assert pair.ours is not None
        assert pair.beside["of what is simulated"] == pytest.approx(
            0.623 * (pair.published or 0.0), rel=0.15
        ), name
        assert (pair.beside["with jitter"] > 100.0 * pair.ours) == (name == "X")
    assert np.square(high_pass(50.0)).sum() == pytest.approx(0.623, abs=0.001)


def test_alternations_are_samples_of_another_sign_than_both_neighbours() -> None:
    assert alternating_samples(np.array([1.0, -1.0, 1.0, -1.0, -1.0, 2.0])) == 2
    assert alternating_samples(np.sin(np.linspace(0.0, 20.0, 500))) == 0


def test_every_searched_gain_of_the_thesis_is_one_of_ours() -> None:
    for controller, number in TUNED_TABLES.items():
        assert {row["ours"] for row in published.printed_table(number)["rows"].values()} == {
            *FIELDS[controller]
        }


# --------------------------------------------------------------------------------------------------
# tracked references


def test_the_line_comes_out_as_printed_and_the_husky_as_near_the_prediction_as_the_real_robot() -> (
    None
):
    """Tab. 4.5 and 4.6 have certain geometry and gains.

    Gap at the end and length agree within the spread of four seeds.
    """
    tables = track_tables(("4.5", "4.6", "4.13"), TASK._replace(draws=4))
    for number in ("4.5", "4.6"):
        ((_, pairs),) = tables[number].items()
        assert pairs["d_haus_m"].ours == pytest.approx(pairs["d_haus_m"].published, rel=0.2)
        assert pairs["d_ratio"].ours == pytest.approx(pairs["d_ratio"].published, abs=1e-3)
        assert pairs["d_ratio"].spread is not None
    real = tables["4.13"]["line_0.25"]["d_rms_m"]
    assert (real.ours or math.inf) <= (real.published or 0.0)


def test_the_supposed_gains_are_those_of_the_regulator(lab: Profile) -> None:
    k = np.reshape(
        make_controller(lab, supposed_gains(load_gains("lqr", "manual"))).packed()[:8], (2, 4)
    )
    assert (k[0, 0], k[1, 2]) == pytest.approx((K_11, K_33), rel=1e-6)
    assert abs(k[[0, 1], [1, 3]]).max() < 0.1, "hardly any feedback of rates"


def test_the_supposed_path_has_its_rate_and_both_ends() -> None:
    t = np.arange(0, 1001) * 0.008
    pose = np.column_stack([t, 0.0 * t, 0.0 * t])
    sampled = supposed_path(Trajectory(t, pose, pose, pose[:, :2]))
    assert (sampled.t[0], sampled.t[-1]) == (t[0], t[-1])
    assert np.all(np.diff(sampled.t[:-1]) >= 1.0 / PATH_RATE_HZ - 0.008)
    assert len(sampled.t) == pytest.approx(8.0 * PATH_RATE_HZ, abs=2)


# --------------------------------------------------------------------------------------------------
# Gazebo


def test_a_robot_that_turns_as_its_wheels_ask_never_drives_straight() -> None:
    """Half of the hard turns without any yaw rate is half of them, and soft turns do not count."""
    commanded = np.array([1.0, 1.0, -1.0, -1.0, 0.1, 0.1])
    wheels = np.column_stack([3.0 - commanded, 3.0 + commanded])
    for share, kept in ((0.0, np.ones(6)), (0.5, np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0]))):
        twist = np.column_stack([np.ones(6), np.zeros(6), 0.4 * commanded * kept])
        motion = Trajectory(0.1 * np.arange(6), np.zeros((6, 3)), twist, wheels)
        assert gazebo.straight_share(motion, 0.57 * commanded) == pytest.approx(share)


def test_sixteen_starts_differ_a_little_and_one_is_the_thesis_own() -> None:
    assert gazebo.start_states(1) == [(0.0, 0.001)]
    yaw, step = np.array(gazebo.start_states(16)).T
    assert len({*yaw}) == len({*step}) == 16
    assert (yaw.min(), yaw.max(), abs(yaw.sum())) == pytest.approx((-0.035, 0.035, 0.0), abs=1e-12)
    assert np.abs(step - 0.001).max() < 0.0002
    assert 0.05 / step == pytest.approx(np.round(0.05 / step))


def test_without_ode_the_section_on_gazebo_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing() -> None:
        raise EngineMissingError("install it")

    monkeypatch.setattr(gazebo, "load_ode", missing)
    numbers, run = ALL_SECTIONS["gazebo"]
    measured: Findings = run(TASK)
    assert {row["straight_share"].obstacle for row in measured.tables["Sec. 3.7"].values()} == {
        "install it"
    }
    assert "install it" in "\n".join(chapter_lines(chapter_of("gazebo", numbers, measured)))


@pytest.mark.slow
def test_gazebo_s_pyramid_along_the_worlds_axes_is_as_fast_as_the_thesis_saw_and_never_turns(
    lab: Profile,
) -> None:
    """Sec. 3.7 describes a run that turns, and ours does not.

    So the lost direction is a conjecture (docs/why_drift.md).
    """
    installed_plant(lab, "ode")
    measured = gazebo.drive_trajectory_3("pyramid", "world", gazebo.start_states(1)[0])
    assert 40.0 < measured["speed_excess"] < 50.0
    assert measured["turning_share"] < 0.01
    assert measured["opposite_share"] < 0.02


# --- the high-pass filter of Sec. 3.4.4 against its definition ---

PASSBAND = printed_value("text", "noise_highpass_frequency")
EDGE = PASSBAND * (1.0 - 0.5 * (1.0 - printed_value("text", "noise_highpass_steepness")))
DECIBEL = 10.0 ** (-printed_value("text", "noise_highpass_attenuation") / 20.0)


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0, 1000.0])
def test_the_filter_passes_what_is_above_its_transition_and_keeps_that_part_of_the_band(
    rate: float,
) -> None:
    """Parseval: the sum of the squared taps is the mean squared gain.

    The transition's middle is the band's edge.
    """
    taps = high_pass(rate)
    assert np.array_equal(taps, taps[::-1])
    f, gain = signal.freqz(taps, worN=1 << 14, fs=rate)
    assert np.abs(np.abs(gain[f >= PASSBAND]) - 1.0).max() <= 2.0 * DECIBEL
    assert np.square(taps).sum() == pytest.approx(1.0 - EDGE / (0.5 * rate), abs=0.015)


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0])
def test_ramps_are_taken_away_and_white_noise_leaves_its_share(rate: float) -> None:
    t = np.arange(0.0, 400.0, 1.0 / rate)
    ramp = 3.0 + 0.5 * t
    noise = np.random.default_rng(1).normal(0.0, 0.003, len(t))
    assert variance_above(ramp, rate) < (1e2 * ROUNDOFF * np.ptp(ramp)) ** 2
    weave = 0.3 * np.sin(2.0 * np.pi * 0.5 * t)  # as in trajectory 1
    share = np.square(high_pass(rate)).sum()
    assert variance_above(ramp + weave + noise, rate) == pytest.approx(share * 0.003**2, rel=0.05)


# --------------------------------------------------------------------------------------------------
# fits that did not converge


def test_a_fit_that_leaves_more_to_reach_agrees_with_nothing() -> None:
    """A population of five in a single generation ends anywhere; so does a distance that it has."""
    key = "fit-linear"
    found = ALL_SECTIONS[key][1](Task(0, 1, ignore_progress, fit=(5, 1)))
    assert {row.whole.status for row in found.rows} == {"not compared"}
    report = Replication(title="", options={"quick": False}, findings={key: found}, chapters=[])
    assert report.unconverged == ["3.14", "3.15"]
    assert any("did not converge: tables 3.14, 3.15" in note for note in report.notes())
