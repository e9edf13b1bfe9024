"""The study of a drive train finds the numbers of synthetic logs, and says what each log is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
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
from validation.identify.driver import rate_evidence
from validation.identify.motor_logs import UNKNOWN, _steady_windows, drive_log, steady_samples
from validation.report.report import Report
from validation.study.drivetrain import study_drivetrain

UP, GRASS, WARTHOG = in_the_air(), on_grass(), warthog_on_grass()
SHORT: dict[str, Any] = {"recording": UP, "ground": GRASS}
HEAVY: dict[str, Any] = {"ground": WARTHOG, "robot": "warthog", "mass": 470.0}
DATA = data_folder()


@pytest.fixture(scope="module")
def husky() -> Report:
    return study_drivetrain(**SHORT)


@pytest.fixture(scope="module")
def warthog() -> Report:
    return study_drivetrain(**HEAVY)


def numbers(study: Report, what: str = "value") -> dict[str, float]:
    return {row["number"]: row[what] for row in study.tables()[0].rows}


KNOWN = {
    "friction_current": (FRICTION, 0.03),
    "loss_left": (LOSSES[0], 0.08),
    "loss_right": (LOSSES[1], 0.08),
    "slip_scale": (SLIP, 0.08),
    "rho": (RHO, 0.1),
    "inertia_current": (INERTIA, 0.12),
    "driver_gain": (LAW["gain"], 0.005),
    "driver_half_track": (LAW["half_track"], 0.02),
    "driver_yaw_rate_limit": (LAW["yaw_rate_limit"], 0.02),
    "driver_acceleration": (LAW["acceleration"], 0.08),
    "driver_yaw_acceleration": (LAW["yaw_acceleration"], 0.05),
}
"""True numbers of a Husky's logs, and the greatest relative error of each: about three standard
errors of 30 commands with noise and messages every 0.15 s."""
KNOWN_BY_POWER = {
    "friction_torque": (TORQUE, 0.04),
    "loss_torque_left": (LOSS_TORQUES[0], 0.15), "loss_torque_right": (LOSS_TORQUES[1], 0.15),
    "slip_scale": (SLIP, 0.08), "heat": (HEAT, 0.12), "efficiency": (EFFICIENCY, 0.05),
    "friction": (TORQUE / (0.5 * 470.0 * 9.81 * 0.3), 0.04),
}  # fmt: skip


def test_known_numbers_of_a_husky_are_found(husky: Report) -> None:
    measured = numbers(husky)
    for name, (true, within) in KNOWN.items():
        assert measured[name] == pytest.approx(true, rel=within), name
    # dead time and lag can stand in for each other; their sum is known to a quarter of the log's
    # period
    assert measured["driver_dead_time"] + measured["driver_lag"] == pytest.approx(
        LAW["dead_time"] + LAW["lag"], abs=0.0125
    )


def test_a_husky_is_seen_for_what_it_is(husky: Report) -> None:
    document = husky.as_dict()
    assert (document["current_is"], document["wheel_rates_are"], document["robot"]["name"]) == (
        "motor",
        "set points",
        "husky",
    )
    assert document["current_r2"] > 0.97
    assert 0.9 < document["current_r2_samples"] < document["current_r2"]
    assert document["wheel_rate_rms_rad_s"] < 0.06  # a step of the set points
    r2 = {row["rule"]: row["held_out"] for row in husky.tables()[2].rows}
    assert max(r2, key=r2.__getitem__) == "the motors', shown while the bridge drives"
    assert "friction_torque" not in document["parameters"]
    assert "taken for those of a husky" in husky.notes()[0]


def test_power_fixes_the_torques_of_a_warthog(warthog: Report) -> None:
    document = warthog.as_dict()
    measured = numbers(warthog)
    for name, (true, within) in KNOWN_BY_POWER.items():
        assert measured[name] == pytest.approx(true, rel=within), name
    assert (document["current_is"], document["wheel_rates_are"], document["samples"]["kind"]) == (
        "battery",
        "measured",
        "values",
    )
    assert document["inertia"] is None
    # no command reaches that limit
    assert not {"friction_current", "driver_yaw_rate_limit"} & set(measured)
    light = study_drivetrain(**{**HEAVY, "mass": 235.0})
    assert numbers(light)["friction"] == pytest.approx(2.0 * measured["friction"])


def test_a_torque_constant_makes_torques_of_currents(husky: Report) -> None:
    scaled = study_drivetrain(**SHORT, torque_constant=2.5)
    for what in ("value", "standard_error"):
        one = numbers(scaled, what)
        other = numbers(husky, what)
        for name, over in (
            ("friction_torque", "friction_current"),
            ("rotor_inertia", "inertia_current"),
        ):
            assert one[name] == pytest.approx(2.5 * other[over])
    lever = 0.5 * 73.3 * 9.81 * 0.154616  # husky-tile: mass and rolling radius
    assert numbers(scaled)["friction"] == pytest.approx(numbers(scaled)["friction_torque"] / lever)


def test_logs_that_are_held_out_judge_and_are_not_fitted(husky: Report) -> None:
    judged = study_drivetrain(
        **SHORT, held_out=(in_the_air(5, 12, "up2"), on_grass(6, 14, "grass2"))
    )
    for name in ("friction_current", "slip_scale", "inertia_current", "driver_gain"):
        # the whole of each log, as without
        assert numbers(judged)[name] == pytest.approx(numbers(husky)[name], rel=1e-3)
    scores = judged.tables()[1].rows
    assert [row["log"] for row in scores] == ["up", "up2", "grass"]
    assert judged.as_dict()["wheel_rate_rms_rad_s"] == pytest.approx(scores[1]["rms_rad_s"])
    slippery = study_drivetrain(**SHORT, held_out=(on_grass(6, 14, "other", slip=0.6),))
    assert slippery.as_dict()["current_r2"] < judged.as_dict()["current_r2"] - 0.05


def test_each_log_alone_tells_its_share() -> None:
    up = study_drivetrain(recording=UP)
    assert up.as_dict()["current_is"] is None
    assert numbers(up)["inertia_current"] == pytest.approx(INERTIA, rel=0.12)
    grass = study_drivetrain(ground=GRASS)
    assert grass.as_dict()["inertia"] is None
    assert {"driver_gain", "friction_current"} <= set(numbers(grass))


def test_rates_with_noise_are_measured_and_steps_are_set_points() -> None:
    log = drive_log(GRASS)
    assert rate_evidence(log)["wheel_rates_are"] == "set points"
    assert rate_evidence(log)["step_rad_s"] == pytest.approx(0.01 / 0.1651, rel=1e-3)
    noise = np.random.default_rng(0).normal(0.0, 0.05, log.rates.shape)
    noisy = rate_evidence(replace(log, rates=log.rates + noise))
    assert (noisy["wheel_rates_are"], noisy["step_rad_s"]) == ("measured", None)
    assert noisy["scatter_rad_s"] == pytest.approx(0.05, rel=0.1)
    silent = rate_evidence(replace(log, commands=UNKNOWN))
    assert math.isnan(silent["scatter_rad_s"])
    assert silent["wheel_rates_are"] == "set points"  # by its steps


def test_steady_windows_are_steady_and_without_their_beginning() -> None:
    log = drive_log(GRASS)
    windows = _steady_windows(log)
    assert len(windows) == pytest.approx(40, abs=6)
    for window in windows:
        assert np.ptp(log.rates[:, window], axis=1).max() < 0.13
        assert 1.0 <= np.ptp(log.t[window]) <= 5.1
    assert all(one.stop <= other.start for one, other in pairwise(windows))
    samples, means = steady_samples(log)
    assert len(means.t) == len(windows)
    assert np.isfinite(samples.currents).sum() <= 2 * sum(w.stop - w.start for w in windows)


def real(name: str) -> str:
    path = DATA / name / f"{name}_train.csv"
    if not path.is_file():
        pytest.skip(f"{name}: no recording in {DATA}")
    return str(path)


def test_a_real_warthog_and_tile_are_what_the_page_says() -> None:
    """docs/drivetrain.md; a golden case has the Husky."""
    document = study_drivetrain(ground=real("warthog_grass"), robot="warthog").as_dict()
    assert (document["current_is"], document["wheel_rates_are"]) == ("battery", "measured")
    assert document["current_r2"] == pytest.approx(0.97, abs=0.01)
    assert document["parameters"]["friction_torque"]["value"] == pytest.approx(473.0, abs=4.0)
    assert document["wheel_rate_rms_rad_s"] is None  # most of the time somebody drove by joystick
    tile = study_drivetrain(recording=real("husky_tile")).as_dict()
    assert (tile["wheel_rates_are"], tile["inertia"]) == ("measured", None)
    assert tile["wheel_rate_rms_rad_s"] == pytest.approx(0.114, abs=0.004)
