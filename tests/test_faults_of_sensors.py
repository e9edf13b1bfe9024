"""Damaged encoders and a tracker that swings: each by its law, and in the programs that switch them on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ssmr.control.loop import LoopSettings
from ssmr.control.references import circle
from ssmr.robot.sensors import SensorModel, simulate_sensors
from ssmr.types import Trajectory
from validation.track import track

T = np.arange(0.0, 20.0, 0.008)


def test_damaged_encoders_show_their_share_of_the_rate_and_the_noise_stays() -> None:
    rates = np.column_stack([3.0 + np.sin(T), 3.0 - np.sin(T)])
    motion = Trajectory(T, np.zeros((len(T), 3)), np.zeros((len(T), 3)), rates)
    sound, damaged = (
        simulate_sensors(motion, np.random.default_rng(1), SensorModel(missed_left=share, missed_right=2.0 * share))
        for share in (0.0, 0.1)
    )
    at = np.searchsorted(T, sound.t - 1e-9)
    assert sound.left - damaged.left == pytest.approx(0.1 * rates[at, 0], rel=1e-9)
    assert sound.right - damaged.right == pytest.approx(0.2 * rates[at, 1], rel=1e-9)
    assert np.array_equal(sound.gyro, damaged.gyro)
    with pytest.raises(ValueError, match="missed_left"):
        SensorModel(missed_left=1.1)


def test_a_robot_with_damaged_encoders_drives_farther_than_it_believes(tmp_path: Path) -> None:
    """Both sides miss a twentieth: the filter's speed is a twentieth too small, and so is the way that it believes in."""
    result = track(
        "pid", circle(speed=0.5), gains="published", feedback="ekf", no_disturbance=True, missed_ticks=(0.05, 0.05)
    )
    run = result.robots[0].run
    late = run.t > 5.0
    assert np.mean(run.column("seen_v")[late] / run.column("v_x")[late]) == pytest.approx(0.95, abs=0.005)
    result.save(tmp_path, recording=False)
    assert json.loads((tmp_path / "track.json").read_text(encoding="utf-8"))["options"]["missed_ticks"] == [0.05, 0.05]
    with pytest.raises(ValueError, match="missed_ticks needs the feedback ekf"):
        track("pid", "circle", missed_ticks=(0.05, 0.0))
    assert LoopSettings(sensors=SensorModel(missed_left=0.2)).deviations() == LoopSettings().deviations()
