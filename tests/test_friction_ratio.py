"""Tyres with two frictions: a log tells their ratio, and nothing else of the robot gets worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssmr.types import TORQUES, Commands, FloatArray, State
from tests.robot_measures import creep
from validation import load_robot
from validation.engines.ode import OdeBody
from validation.engines.plant import EnginePlant
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.fit import Fit, fit, run_fit
from validation.plants.profile import bare_profile
from validation.plants.searchable import with_values
from validation.plants.table import plant_kind
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import closed_form, measure_spin, spin_on_spot

WARTHOG = bare_profile(load_robot("warthog"))
BODY = WARTHOG.section("mujoco")
RATIOS = (0.92, 1.0, 1.1)


def drive_log(path: Path, ratio: float) -> Path:
    """Write 60 s of a Warthog whose tyres have this ratio, in bends of many widths."""
    true = with_values("mujoco", BODY, ["friction_ratio", "wheel_radius"], [ratio, 0.29])
    rng = np.random.default_rng(2)
    t = 0.05 * np.arange(1200)
    periods = rng.uniform(0.2, 0.6, (2, 6))
    phases = rng.uniform(0.0, 6.0, (2, 6))

    def rates(at: FloatArray) -> FloatArray:
        """Return (M, 2) wheel rates [rad/s]."""
        v, w = np.sin(at[:, None, None] * periods + phases).sum(axis=2).T
        return np.column_stack([1.0 + 0.6 * (v - w), 1.0 + 0.6 * (v + w)])

    plant = MujocoPlant(true.parameters, true.drive)
    motion = plant.run(Commands(0.05, rates(t + 0.025), "wheels"), State(), 0.05)
    pose = motion.pose[:-1] + rng.normal(0.0, (0.005, 0.005, 0.003), (1200, 3))
    left, right = rates(t).T
    columns = {"t": t, "enc_left": left, "enc_right": right}
    columns |= dict(zip(("x", "y", "yaw"), pose.T, strict=True))
    write_csv(Log.of_columns("log", columns), path)
    return path


@pytest.mark.parametrize("ratio", [0.92, pytest.param(1.1, marks=pytest.mark.slow)])
def test_a_log_tells_the_ratio_while_the_weight_stays_where_the_file_has_it(
    ratio: float, tmp_path: Path
) -> None:
    log = drive_log(tmp_path / "log.csv", ratio)
    told = run_fit(Fit("mujoco", log, WARTHOG, input="wheels", search="lsq"), lambda warning: None)
    found = {p.name: p for p in told.parameters}
    assert "com_x" not in found
    p = found["friction_ratio"]
    assert p.standard_error is not None
    assert p.standard_error < 0.01
    assert abs(p.value - ratio) < 3.0 * p.standard_error
    assert told.plant.parameters.com_x == BODY.parameters.com_x


@pytest.mark.parametrize("ratio", RATIOS)
def test_a_turn_takes_what_the_closed_form_says_and_no_more_torque(ratio: float) -> None:
    numbers = replace(BODY.parameters, friction_ratio=ratio)
    motion = spin_on_spot(MujocoPlant(numbers, BODY.drive))
    turn = closed_form(numbers)
    assert measure_spin(motion, numbers)["multiplier"] == pytest.approx(turn.multiplier, rel=0.005)
    torque = np.abs(motion.channels[TORQUES][motion.t > 10.0]).mean()
    weight = 9.81 * numbers.mass
    assert torque < 0.5 * max(1.0, ratio) * numbers.friction * weight * numbers.wheel_radius


@pytest.mark.parametrize("ratio", RATIOS)
def test_a_robot_on_a_slope_creeps_no_more_than_with_one_friction(ratio: float) -> None:
    one = replace(BODY.parameters, wheel_shape="ellipsoid")
    two = replace(BODY.parameters, friction_ratio=ratio)
    assert creep(two) < 1.02 * creep(one)


def test_only_capsules_in_mujoco_have_a_ratio_to_be_fitted() -> None:
    numbers = replace(BODY.parameters, friction_ratio=0.92)
    with pytest.raises(ValueError, match=r"friction_ratio 0\.92: .* one friction in ode.* mujoco"):
        EnginePlant("ode", OdeBody, numbers, BODY.drive)
    other = bare_profile(load_robot("husky")).section("mujoco")
    for name, section in {"ode": BODY, "mujoco": other}.items():
        assert plant_kind(name).held(section.parameters) == ("friction_ratio",)


def test_a_ratio_that_tyres_cannot_have_is_refused_and_not_searched(tmp_path: Path) -> None:
    log = drive_log(tmp_path / "log.csv", 1.0)
    with pytest.raises(ValueError, match=r"friction_ratio: .* needs wheel_shape 'capsule'"):
        fit("mujoco", log, robot="husky", input="wheels", free=("friction_ratio",))
