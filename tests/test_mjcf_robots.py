"""A hand-made MJCF is a robot by itself: its numbers are read from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import State
from tests.conftest import EXACT
from tests.robots import HUSKY, husky
from validation import load_robot
from validation.compare import compare
from validation.plants.profile import bare_profile
from validation.simulator.calibration import Calibration
from validation.simulator.model import robot_model
from validation.simulator.plant import MujocoPlant


def test_husky_xml_alone_has_the_numbers_of_the_huskys_file() -> None:
    assert HUSKY.mjcf_path is not None
    read = load_robot(HUSKY.mjcf_path)
    for name in ("wheelbase", "track", "wheel_radius", "wheel_width", "axle_height", "link"):
        assert getattr(read.geometry, name) == getattr(HUSKY.geometry, name), name
    for name in ("total", "wheel", "wheel_inertia", "com", "inertia"):
        assert np.allclose(getattr(read.masses, name), getattr(HUSKY.masses, name), rtol=1e-9, atol=EXACT), name
    assert read.simulation == HUSKY.simulation
    assert read.drive.torque_limit == HUSKY.drive.torque_limit
    commands = TRAJECTORIES["traj4"].commands()
    one, other = (MujocoPlant(c, HUSKY.drive).run(commands, State(), 0.05) for c in (husky(), Calibration.of(read)))
    assert np.abs(one.pose - other.pose).max() < 1e-9


def test_a_hand_made_robot_drives(tmp_path: Path) -> None:
    assert HUSKY.mjcf_path is not None
    text = HUSKY.mjcf_path.read_text(encoding="utf-8").replace('mass="62.752"', 'mass="82.752"')
    (tmp_path / "my robot.xml").write_text(text, encoding="utf-8")
    robot = load_robot(tmp_path / "my robot.xml")
    assert robot.name == "my-robot"
    assert robot.masses.total == pytest.approx(93.3)
    assert robot_model(Calibration.of(robot)).body_subtreemass[1] == pytest.approx(93.3)
    result = compare("traj1", bare_profile(robot), plants=("mujoco",))
    assert result.robot.name == "my-robot"
