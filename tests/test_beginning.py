"""Fits of a body on wheels to logs begin at the kinematic fit, and hold a friction nobody tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssmr.robot.ground import turn_on_the_spot
from ssmr.types import Commands, FloatArray, State
from tests.test_several_logs import drive as kinematic_drive
from validation.calibrate import calibrate
from validation.descriptions.loading import load_robot
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.fit import Fitted, fit
from validation.identify.beginning import _weight_for_turn
from validation.plants.profile import bare_profile
from validation.plants.searchable import with_values
from validation.plants.table import plant_kind
from validation.simulator.physics import SHIPPED
from validation.simulator.terrain import FLAT

HUSKY = load_robot("husky")
BARE = bare_profile(HUSKY)
TRUTH = {"friction": 0.55, "com_x": -0.04, "com_y": 0.01, "wheel_radius": 0.16, "yaw_late": 0.1}


@pytest.mark.parametrize("place", [0.03, 0.06, 0.08])
def test_the_weight_is_found_from_the_turn_that_it_makes(place: float) -> None:
    turn = turn_on_the_spot(HUSKY.wheelbase, HUSKY.track, place)
    x, icr = _weight_for_turn(HUSKY, 2.0 / turn.yaw_rate)
    assert x == pytest.approx(place, abs=1e-4)
    assert icr == pytest.approx(-turn.across / turn.yaw_rate, abs=1e-4)


def test_beyond_what_any_weight_makes_it_lies_in_the_middle_or_at_an_axle() -> None:
    assert _weight_for_turn(HUSKY, 4.0 * HUSKY.track)[0] == 0.0
    x, icr = _weight_for_turn(HUSKY, 0.9 * HUSKY.track)
    # a robot on one axle turns around it
    assert 0.0 < x < icr == pytest.approx(0.5 * HUSKY.wheelbase, abs=1e-4)


def drive(path: Path, speed: float) -> Path:
    """Write a log of four tyres whose sides roll at up to about this speed [m/s]."""
    section = with_values("four_wheel", BARE.section("four_wheel"), list(TRUTH), TRUTH.values())
    rng = np.random.default_rng(1)
    t = 0.01 * np.arange(6000)
    periods = rng.uniform(0.2, 0.6, (2, 6))
    phases = rng.uniform(0.0, 6.0, (2, 6))

    def rates(at: FloatArray) -> FloatArray:
        """Return (M, 2) wheel rates [rad/s]."""
        v, w = np.sin(at[:, None, None] * periods + phases).sum(axis=2).T
        return speed / 0.16 * np.column_stack([0.5 + 0.15 * (v - w), 0.5 + 0.15 * (v + w)])

    plant = plant_kind("four_wheel").build(section, FLAT, SHIPPED)
    motion = plant.run(Commands(0.01, rates(t + 0.005), "wheels"), State(), 0.01)
    t = t[::5]
    pose = section.localiser.logged_poses(motion.pose, 0.01, t)
    pose = pose + rng.normal(0.0, (0.005, 0.005, 0.003), pose.shape)
    left, right = rates(t).T
    columns = {"t": t, "enc_left": left, "enc_right": right}
    columns |= dict(zip(("x", "y", "yaw"), pose.T, strict=True))
    write_csv(Log.of_columns("log", columns), path)
    return path


def fitted(log: Path) -> Fitted:
    return fit("four_wheel", log, profile=BARE, input="wheels", search="lsq")


def test_a_slow_log_does_not_tell_friction_and_the_fit_says_so(tmp_path: Path) -> None:
    slow = fitted(drive(tmp_path / "slow.csv", 0.3))
    assert "friction" not in [p.name for p in slow.parameters]
    assert slow.plant.parameters.friction == BARE.section("four_wheel").parameters.friction
    assert [note for note in slow.notes() if note.startswith("friction is held at 0.3:")]
    # weight ahead of the middle would make nearly the same turns, and err by more
    assert slow.plant.parameters.com_x == pytest.approx(TRUTH["com_x"], abs=0.005)
    # noise of 5 mm and 3 mrad at both ends of a window
    errors = slow.together.overlapping[6.0]
    assert errors.position_median_m < 0.015
    assert errors.yaw_median_rad < 0.004


def test_a_fast_log_tells_friction(tmp_path: Path) -> None:
    fast = fitted(drive(tmp_path / "fast.csv", 2.0))
    friction = next(p for p in fast.parameters if p.name == "friction")
    assert friction.standard_error is not None
    assert friction.value == pytest.approx(TRUTH["friction"], abs=3.0 * friction.standard_error)
    assert friction.standard_error < 0.1
    assert not [note for note in fast.notes() if "is held at" in note]


@pytest.mark.usefixtures("one_start")
def test_a_body_that_cannot_turn_as_the_robot_does_is_named(tmp_path: Path) -> None:
    """No body on four tyres turns more easily than its wheels would without skidding."""
    numbers = {"alpha_l": 0.95, "alpha_r": 0.95, "y_l": 0.21, "y_r": -0.21}
    log = kinematic_drive(tmp_path, "easy", numbers, 1)
    plants = ("kinematic", "four_wheel")
    judge = kinematic_drive(tmp_path, "judge", numbers, 2)
    report = calibrate(log, robot="husky", plants=plants, held_out=judge, trust=True)
    lead = "four_wheel driven by measured wheel rates: headings are worse than those of kinematic"
    (note,) = [note for note in report.notes() if note.startswith(lead)]
    turns = float(note.partition("it turns ")[2].split()[0])
    assert 0.5 < turns < 0.98
