"""Drivers of known numbers come back, or what commands hardly tell is held and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssmr.simulation import PlanarPlant
from ssmr.types import Commands, State
from tests.test_several_logs import BARE
from validation.calibrate import Calibrated, calibrate
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.plants.planar import _model_of
from validation.plants.searchable import with_values

pytestmark = pytest.mark.usefixtures("one_start")


def drive_steps(path: Path, driver: dict[str, float], seed: int, rows: int = 1800) -> Path:
    """Write rows at 20 Hz of a robot with this driver, whose commands are held for 1 to 3 s.

    Poses have 5 mm and 3 mrad of noise, wheel rates 0.02 rad/s.
    """
    names = [*driver, "position_late", "yaw_late"]
    values = [*driver.values(), 0.05, 0.05]
    true = with_values("kinematic", BARE.plants["kinematic"], names, values)
    rng = np.random.default_rng(seed)
    held = rng.integers(20, 60, 60)
    steps = rng.uniform((-0.36, -1.2), (0.9, 1.2), (60, 2))
    commands = np.repeat(np.repeat(steps, held, axis=0)[:rows], 5, axis=0)
    motion = PlanarPlant(_model_of(true)).run(Commands(0.01, commands, "twist"), State(), 0.01)
    t = 0.05 * np.arange(rows, dtype=np.float64)
    pose = true.localiser.logged_poses(motion.pose, 0.01, t)
    pose = pose + rng.normal(0.0, (0.005, 0.005, 0.003), pose.shape)
    wheels = motion.wheels[:-1:5] + rng.normal(0.0, 0.02, (rows, 2))
    columns = {"t": t}
    for name, table in (("cmd_v cmd_w", commands[::5]), ("enc_left enc_right", wheels)):
        columns |= dict(zip(name.split(), table.T, strict=True))
    columns |= dict(zip(("x", "y", "yaw"), pose.T, strict=True))
    write_csv(Log.of_columns("steps", columns), path)
    return path


def calibrated(log: Path, driver: dict[str, float]) -> Calibrated:
    """Return a calibration that half a minute of the same robot judges, so that it has one fit."""
    judge = drive_steps(log.with_name("judge.csv"), driver, 3, 600)
    return calibrate(log, profile=BARE, plants=("kinematic",), held_out=judge, trust=True)


GRID = (
    {"acceleration_v": 1.5, "acceleration_w": 3.0, "wheel_lag": 0.0, "delay": 0.1},
    {"acceleration_v": 0.8, "acceleration_w": 1.5, "wheel_lag": 0.1, "delay": 0.2},
    {"acceleration_v": 5.0, "acceleration_w": 3.0, "wheel_lag": 0.2, "delay": 0.1},
)


@pytest.mark.parametrize("driver", GRID)
def test_a_driver_comes_back_or_is_held_and_said(driver: dict[str, float], tmp_path: Path) -> None:
    """Column, note and profile say one thing of each number."""
    log = drive_steps(tmp_path / "steps.csv", driver, 1)
    report = calibrated(log, driver)
    fit = report.fits[1]
    found = {p.name: p for p in fit.parameters}
    profile = report.profile.plants["kinematic"].drive
    notes = " ".join(fit.notes())
    for name, value in driver.items():
        written = getattr(profile, "delay_v" if name == "delay" else name)
        if name not in found:
            assert f"{name} is held at" in notes
            assert written == getattr(BARE.plants["kinematic"].drive, name)
            continue
        p = found[name]
        assert p.warning == ""
        assert f"hardly determine {name}:" not in notes
        assert written == p.value
        assert p.standard_error is not None
        # a valley that two delays share is wider than its middle says
        assert p.value == pytest.approx(value, abs=3.0 * p.standard_error + 0.01 * value), name
    late = sum(found[name].value for name in ("delay", "wheel_lag") if name in found)
    assert late == pytest.approx(driver["delay"] + driver["wheel_lag"], abs=0.01)


def test_a_limit_that_no_command_reaches_is_not_written(tmp_path: Path) -> None:
    """Steps are obeyed at once: any greater acceleration makes the same log."""
    log = drive_steps(tmp_path / "steps.csv", {"delay": 0.1}, 2)
    report = calibrated(log, {"delay": 0.1})
    found = {p.name: p for p in report.fits[1].parameters}
    drive = report.profile.plants["kinematic"].drive
    for name in ("acceleration_v", "acceleration_w"):
        assert name not in found or found[name].value > 20.0
        assert getattr(drive, name) > 20.0
    assert not any(p.at_bound or p.untold for p in found.values())
