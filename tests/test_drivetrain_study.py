"""The study of a drive train finds the numbers that synthetic logs were made with, and says what each log is."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.conftest import data_folder
from tests.drive_train_logs import (
    EFFICIENCY,
    FRICTION,
    HEAT,
    INERTIA,
    LAW,
    LOSS_TORQUES,
    LOSSES,
    RHO,
    SLIP,
    TORQUE,
    in_the_air,
    on_grass,
    warthog_on_grass,
)
from validation.files.log import Log
from validation.study.drivetrain import DriveTrainOptions, DriveTrainStudy, study_drivetrain
from validation.study.drivetrain.evidence import rate_evidence
from validation.study.drivetrain.logs import drive_log
from validation.study.drivetrain.samples import steady_windows, window_means

UP, GRASS, WARTHOG = in_the_air(), on_grass(), warthog_on_grass()
SHORT = DriveTrainOptions(UP, GRASS, resamples=3)
DATA = data_folder()
LOGS = {
    name: DATA / name / f"{name}_train.csv" for name in ("husky_wheels_up", "husky_wet_grass", "husky_tile", "warthog_grass")
}
"""Recordings of real robots."""


@pytest.fixture(scope="module")
def husky() -> DriveTrainStudy:
    return study_drivetrain(SHORT)


@pytest.fixture(scope="module")
def warthog() -> DriveTrainStudy:
    return study_drivetrain(DriveTrainOptions(ground=WARTHOG, mass=470.0, resamples=3))


def found(study: DriveTrainStudy, name: str) -> float:
    return study.parameters()[name].value


@pytest.mark.parametrize(
    ("name", "true", "within"),
    [
        ("friction_current", FRICTION, 0.03),
        ("loss_left", LOSSES[0], 0.08),
        ("loss_right", LOSSES[1], 0.08),
        ("slip_scale", SLIP, 0.08),
        ("rho", RHO, 0.1),
        ("inertia_current", INERTIA, 0.12),
        ("driver_gain", LAW.gain, 0.005),
        ("driver_half_track", LAW.half_track, 0.02),
        ("driver_yaw_rate_limit", LAW.yaw_rate_limit, 0.02),
        ("driver_acceleration", LAW.acceleration, 0.08),
        ("driver_yaw_acceleration", LAW.yaw_acceleration, 0.05),
    ],
)
def test_known_numbers_of_a_husky_are_found(husky: DriveTrainStudy, name: str, true: float, within: float) -> None:
    """Shares that noise and messages every 0.15 s leave of some 30 commands; about three standard errors."""
    assert found(husky, name) == pytest.approx(true, rel=within)


def test_a_command_takes_effect_when_it_does(husky: DriveTrainStudy) -> None:
    """Dead time and lag can stand in for each other; their sum is known to a quarter of the log's period."""
    together = found(husky, "driver_dead_time") + found(husky, "driver_lag")
    assert together == pytest.approx(LAW.dead_time + LAW.lag, abs=0.0125)


def test_a_husky_is_seen_for_what_it_is(husky: DriveTrainStudy) -> None:
    document = husky.as_dict()
    assert (document["current_is"], document["wheel_rates_are"]) == ("motor", "set points")
    assert document["robot"]["name"] == "husky"
    assert document["current_r2"] > 0.97
    assert 0.9 < document["current_r2_samples"] < document["current_r2"]
    assert document["wheel_rate_rms_rad_s"] < 0.06  # a step of the set points
    assert document["yaw_rate"]["gain"] == pytest.approx(1.0, abs=0.02)
    r2 = {e["rule"]: e["r2"] for e in document["evidence"]["currents"]}
    assert max(r2, key=r2.__getitem__) == "the motors', shown while the bridge drives"
    sag = document["evidence"]["battery_sag"]
    assert sag["by_power"] > sag["by_currents"] + 0.1
    assert "friction_torque" not in document["parameters"]
    assert any("torque constant" in sentence for sentence in document["unknown"])


@pytest.mark.parametrize(
    ("name", "true", "within"),
    [
        ("friction_torque", TORQUE, 0.04),
        ("loss_torque_left", LOSS_TORQUES[0], 0.15),
        ("loss_torque_right", LOSS_TORQUES[1], 0.15),
        ("slip_scale", SLIP, 0.08),
        ("heat", HEAT, 0.12),
        ("efficiency", EFFICIENCY, 0.05),
        ("friction", TORQUE / (0.5 * 470.0 * 9.81 * 0.3), 0.04),
    ],
)
def test_power_fixes_the_torques_of_a_warthog(warthog: DriveTrainStudy, name: str, true: float, within: float) -> None:
    assert found(warthog, name) == pytest.approx(true, rel=within)


def test_a_warthog_is_seen_for_what_it_is(warthog: DriveTrainStudy) -> None:
    document = warthog.as_dict()
    assert (document["current_is"], document["wheel_rates_are"]) == ("battery", "measured")
    assert document["robot"]["name"] == "warthog"
    assert document["evidence"]["samples"]["kind"] == "values"
    assert "friction_current" not in document["parameters"]
    assert warthog.inertia is None
    assert "driver_yaw_rate_limit" not in document["parameters"]  # no command reaches it


def test_a_torque_constant_makes_torques_of_currents(husky: DriveTrainStudy) -> None:
    scaled = replace(husky, options=replace(SHORT, torque_constant=2.5)).parameters()
    plain = husky.parameters()
    for name, over in (("friction_torque", "friction_current"), ("rotor_inertia", "inertia_current")):
        assert scaled[name].value == pytest.approx(2.5 * plain[over].value)
        assert scaled[name].standard_error == pytest.approx(2.5 * plain[over].standard_error)
    lever = 0.5 * 73.3 * 9.81 * 0.154616  # husky-tile: mass and rolling radius
    assert scaled["friction"].value == pytest.approx(scaled["friction_torque"].value / lever)


def test_the_robot_can_be_named_and_its_guess_is_said(husky: DriveTrainStudy, warthog: DriveTrainStudy) -> None:
    assert "battery of 24 V" in husky.notes()[0]
    assert "warthog" in warthog.notes()[0]
    assert (warthog.chassis.mass, warthog.chassis.geometry.radius) == (470.0, 0.3)
    named = study_drivetrain(DriveTrainOptions(ground=WARTHOG, robot="warthog", mass=235.0, resamples=2))
    assert not any("No robot was named" in note for note in named.notes())
    assert found(named, "friction") == pytest.approx(2.0 * found(warthog, "friction"))
    with pytest.raises(ValueError, match="of the robot husky, not of warthog"):
        study_drivetrain(DriveTrainOptions(ground=WARTHOG, robot="warthog", profile="husky-tile"))


def test_a_study_repeats(husky: DriveTrainStudy) -> None:
    assert study_drivetrain(SHORT).as_dict() == husky.as_dict()
    other = study_drivetrain(replace(SHORT, seed=1)).parameters()
    assert other["slip_scale"].value == husky.parameters()["slip_scale"].value
    assert other["slip_scale"].standard_error != husky.parameters()["slip_scale"].standard_error


def test_logs_that_are_held_out_judge_and_are_not_fitted(husky: DriveTrainStudy) -> None:
    judges = (in_the_air(5, 12, "up2"), on_grass(6, 14, "grass2"))
    judged = study_drivetrain(replace(SHORT, held_out=judges))
    document = judged.as_dict()
    for name in ("friction_current", "slip_scale", "inertia_current", "driver_gain"):
        assert found(judged, name) == pytest.approx(found(husky, name), rel=1e-3)  # the whole of each log, as without judges
    assert document["evidence"]["samples"]["held_out"] > 20
    assert [s["name"] for s in document["evidence"]["commands"]] == ["up", "up2", "grass"]
    assert document["wheel_rate_rms_rad_s"] == document["evidence"]["commands"][1]["rms"]
    slippery = study_drivetrain(replace(SHORT, held_out=(on_grass(6, 14, "other", slip=0.6),)))
    assert slippery.as_dict()["current_r2"] < document["current_r2"] - 0.05


def test_each_log_alone_tells_its_share() -> None:
    up = study_drivetrain(DriveTrainOptions(UP, resamples=2))
    assert up.friction is None
    assert up.inertia is not None
    assert found(up, "inertia_current") == pytest.approx(INERTIA, rel=0.12)
    grass = study_drivetrain(DriveTrainOptions(ground=GRASS, resamples=2))
    assert grass.driver is not None
    assert grass.inertia is None
    assert found(grass, "friction_current") == pytest.approx(FRICTION, rel=0.03)
    for study in (up, grass):
        json.dumps(study.as_dict(), allow_nan=False)
        assert study.table()


# ------------------------------------------------------------------------------------------------- evidence on its own


def changed(recording: Log, **columns: Any) -> Log:
    """The recording with other columns; None leaves one out."""
    kept = {"t": recording.t, **recording.columns, **columns}
    return Log.of_columns(recording.path, {n: a for n, a in kept.items() if a is not None})


def test_rates_with_noise_are_measured_and_steps_are_set_points() -> None:
    log = drive_log(GRASS)
    assert rate_evidence(log).rates_are == "set points"
    assert rate_evidence(log).step == pytest.approx(0.01 / 0.1651, rel=1e-3)
    noise = np.random.default_rng(0).normal(0.0, 0.05, log.rates.shape)
    noisy = rate_evidence(replace(log, rates=log.rates + noise))
    assert (noisy.rates_are, noisy.step) == ("measured", None)
    assert noisy.scatter == pytest.approx(0.05, rel=0.1)
    assert "measured" in noisy.sentence()
    silent = rate_evidence(replace(log, commands=None))
    assert math.isnan(silent.scatter)
    assert silent.rates_are == "set points"  # by its steps


def test_steady_windows_are_steady_and_without_their_beginning() -> None:
    log = drive_log(GRASS)
    windows = steady_windows(log)
    assert len(windows) == pytest.approx(40, abs=6)
    for window in windows:
        assert np.ptp(log.rates[:, window], axis=1).max() < 0.13
        assert 1.0 <= np.ptp(log.t[window]) <= 5.1
    assert sum(w.astype(int) for w in windows).max() == 1  # they do not overlap
    assert len(window_means(log)) == 2 * len(windows)


def test_a_jump_of_the_localiser_hides_the_yaw_rate_of_its_window() -> None:
    yaw = GRASS.columns["yaw"].copy()
    middle = int(np.searchsorted(GRASS.t, 3.0 + 6.0 * 10 + 4.0))
    yaw[middle:] += 1.0
    before, after = (np.isfinite(window_means(drive_log(r)).yaw_rate).sum() for r in (GRASS, changed(GRASS, yaw=yaw)))
    assert before - after == 2  # both sides of one window


# ------------------------------------------------------------------------------------------------- real robots


def real(*names: str) -> list[str]:
    missing = [name for name in names if not LOGS[name].is_file()]
    if missing:
        pytest.skip(f"{', '.join(missing)}: no recording in {DATA}")
    return [str(LOGS[name]) for name in names]


def test_a_real_husky_is_what_the_page_says() -> None:
    """docs/drivetrain.md; the numbers do not depend on the resamples, their errors do."""
    up, grass = real("husky_wheels_up", "husky_wet_grass")
    document = study_drivetrain(DriveTrainOptions(up, grass, resamples=2)).as_dict()
    assert (document["current_is"], document["wheel_rates_are"]) == ("motor", "set points")
    assert document["wheel_rate_rms_rad_s"] == pytest.approx(0.169, abs=0.006)
    assert document["current_r2"] == pytest.approx(0.96, abs=0.01)
    assert document["current_r2_samples"] == pytest.approx(0.91, abs=0.01)
    assert document["yaw_rate"]["gain"] == pytest.approx(1.018, abs=0.003)
    values = {name: number["value"] for name, number in document["parameters"].items()}
    assert values["friction_current"] == pytest.approx(12.45, abs=0.1)
    assert values["slip_scale"] == pytest.approx(0.080, abs=0.002)
    assert values["inertia_current"] == pytest.approx(0.22, abs=0.02)
    inertia = document["inertia"]
    assert inertia["speed_ups"][0] < values["inertia_current"] < inertia["reversals"][0]


def test_a_real_warthog_is_what_the_page_says() -> None:
    (grass,) = real("warthog_grass")
    document = study_drivetrain(DriveTrainOptions(ground=grass, resamples=2)).as_dict()
    assert (document["current_is"], document["wheel_rates_are"]) == ("battery", "measured")
    assert document["current_r2"] == pytest.approx(0.97, abs=0.01)
    assert document["yaw_rate"]["gain"] == pytest.approx(1.036, abs=0.005)
    assert document["parameters"]["friction_torque"]["value"] == pytest.approx(473.0, abs=4.0)
    assert document["wheel_rate_rms_rad_s"] is None  # most of the time somebody drove by joystick


def test_tile_has_measured_rates() -> None:
    (tile,) = real("husky_tile")
    study = study_drivetrain(DriveTrainOptions(tile, resamples=2))
    document = study.as_dict()
    assert document["wheel_rates_are"] == "measured"
    assert document["wheel_rate_rms_rad_s"] == pytest.approx(0.114, abs=0.004)
    assert study.inertia is None
