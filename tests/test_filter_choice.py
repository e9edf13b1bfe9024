"""The state filter that a user chooses: by name, from a file, or commissioned; in closed loops and on the robot over ROS."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from ssmr.control.references import circle
from ssmr.estimation.settings import BIAS, EkfSettings
from ssmr.robot.sensors import SensorModel
from tests.conftest import data_folder
from validation.bench.loops import chosen_filter
from validation.plants.profile import Profile, load_profile, make_plant
from validation.recordings import commission, convert, info
from validation.ros.robot import SimulatedRobot
from validation.simulator.plant import MujocoPlant
from validation.track import track

STOCK = EkfSettings()
TILE = data_folder() / "husky_tile" / "husky_tile_train.csv"


@pytest.fixture(scope="module")
def tile() -> Profile:
    return load_profile("husky-tile")


def test_a_commissioned_filter_finds_the_way_where_the_thesis_filter_does_not(tile: Profile, tmp_path: Path) -> None:
    """With a biased gyro and tyres that roll on less than the driver believes; the file of a run is that run's filter."""
    runs = {}
    for name in ("thesis", "commissioned", str(tmp_path / "filter.toml")):
        runs[name] = track("lqr-scheduled", circle(speed=0.25), profile=tile, feedback="ekf", filter=name, gyro_bias=0.0156)
        if name == "commissioned":
            written = runs[name].save(tmp_path, recording=False)
            assert tmp_path / "filter.toml" in written
            document = json.loads((tmp_path / "track.json").read_text(encoding="utf-8"))
    thesis, knows, again = (r.metrics["d_rms_m"] for r in runs.values())
    assert knows < 0.3 * thesis
    assert again == knows
    assert document["filter"]["name"] == "commissioned"
    assert document["filter"]["scale_right"] > document["filter"]["scale_left"] > 1.0
    assert document["options"]["gyro_bias_rad_s"] == 0.0156
    assert "turning ratio" in runs["commissioned"].table()
    assert "filter thesis" in runs["thesis"].table()
    assert "turning ratio" not in runs["thesis"].table()


def test_a_robot_over_ros_has_the_filter_that_is_asked_for(tile: Profile) -> None:
    plant = cast(MujocoPlant, make_plant(tile, "mujoco"))
    biased, off = SensorModel(gyro_bias=0.0156), {}
    for name in ("thesis", "learning"):
        used = chosen_filter(name, tile, "mujoco").settings
        robot = SimulatedRobot(plant, sensors=biased, filter=used)
        assert name == "thesis" or robot.filter.bias == pytest.approx(0.0156, abs=4.0 * robot.filter.bias_std) != used.bias
        assert robot.filter.bias_std < 0.0005  # it has stood, or knows of no bias
        for k in range(1000):
            robot.advance(10, (0.3, 0.8 * math.sin(k / 150.0)))
            robot.sense()
        pose, twist, covariance, _ = robot.filtered_odometry()
        off[name] = math.hypot(*(pose - robot.pose)[:2])
        claimed = (pose - robot.pose) @ np.linalg.solve(covariance, pose - robot.pose)
        assert (claimed < 15.0) == (name == "learning")  # chi-squared of 3: 15 is at 99.8 %
        assert twist[0] == pytest.approx(robot.state.v_x, rel=0.1)
        learned = robot.belief.mean[BIAS:].copy()
        robot.place(np.array([5.0, 6.0, 0.7]))
        again, still, told, _ = robot.filtered_odometry()
        np.testing.assert_array_equal(again, [5.0, 6.0, 0.7])
        np.testing.assert_array_equal(told, np.zeros((3, 3)))
        assert still == (0.0, 0.0)
        np.testing.assert_array_equal(robot.belief.mean[BIAS:], learned)
    assert off["learning"] < 0.7 * off["thesis"]
    assert len(learned) == 6


@pytest.mark.skipif(not TILE.is_file(), reason=f"no recording {TILE}")
def test_a_filter_that_half_a_log_commissioned_reckons_the_other_half(tmp_path: Path) -> None:
    halves = [tmp_path / "first.csv", tmp_path / "second.csv"]
    convert(TILE, sync=True, until=325.0).write(halves[0])
    convert(TILE, sync=True, start=325.0).write(halves[1])
    made = commission(halves[0]).filter
    assert made is not None
    assert made.settings.bias == pytest.approx(-0.0156, abs=0.001)  # as the recording's own page has it
    assert 1.7 < made.settings.turning < 2.2
    reckoning = info(halves[1], filter=made.save(tmp_path / "tile.toml")).reckoning
    assert reckoning is not None
    rms = {row.name: row.rms for row in reckoning.rows}
    assert rms["filter 'first'"] < 0.2 * rms["filter, bias learned at rest"]
