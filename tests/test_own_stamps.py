"""Logs whose wheels and commands have other stamps than their poses: no sample of them is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssmr.robot.drive import wheel_rates
from ssmr.types import FloatArray
from tests.bag_factory import Message, joints, pose_stamped, write
from validation.descriptions.loading import load_robot
from validation.experiment.sources import RECORDING_GRID, open_source
from validation.files.formats import read_log
from validation.files.log import Group, Log
from validation.fit import fit
from validation.plants.profile import bare_profile

SECONDS = 60.0
HALF_TRACK = 0.5
RADIUS = 0.165
LATE = 0.04
"""Lateness of the poses of the bag [s]."""
FINE = 1e-3
"""Step to which the motion of the bag is known [s]."""
SIDES = ("left", "right")


def motion(t: FloatArray) -> FloatArray:
    """(M, 5) speed, yaw rate, x, y, yaw at instants t of a robot that rolls without slip.

    The midpoint rule integrates them.
    """
    middle = np.arange(-1.0, SECONDS + 1.0, FINE) + 0.5 * FINE
    v = 0.45 + 0.25 * np.sin(0.9 * middle) * np.sin(0.23 * middle)
    w = 0.5 * np.sin(0.7 * middle + 1.0) + 0.3 * np.sin(1.9 * middle) + 0.2 * np.sin(4.3 * middle)
    yaw = FINE * np.cumsum(w)
    heading = yaw - 0.5 * FINE * w
    x = FINE * np.cumsum(v * np.cos(heading))
    y = FINE * np.cumsum(v * np.sin(heading))
    rates = [np.interp(t, middle, rate) for rate in (v, w)]
    places = [np.interp(t, middle + 0.5 * FINE, place) for place in (x, y, yaw)]
    return np.column_stack([*rates, *places])


def bag_of_a_known_motion(folder: Path, noise: float) -> Path:
    """A bag with wheels at 100 Hz and poses at 10 Hz, which are late.

    `noise` is that of the poses in m and rad, and a tenth of that of the wheels in rad/s.
    """
    rng = np.random.default_rng(0)
    messages = list[Message]()
    at_wheels = np.arange(0.0037, SECONDS, 0.01)
    v, w = motion(at_wheels)[:, :2].T
    sides = np.column_stack(wheel_rates(v, w, HALF_TRACK, RADIUS))
    sides += 10.0 * noise * rng.standard_normal(sides.shape)
    for t, (left, right) in zip(at_wheels.tolist(), sides.tolist(), strict=True):
        rates = {"front_left_wheel": left, "front_right_wheel": right}
        messages.append(("/joint_states", t, joints(t, rates)))
    seen = np.arange(0.0, SECONDS, 0.1)
    poses = motion(seen - LATE)[:, 2:] + noise * rng.standard_normal((len(seen), 3))
    for t, pose in zip(seen.tolist(), poses.tolist(), strict=True):
        messages.append(("/pose", t, pose_stamped(t, *pose)))
    return write(folder, "ros1", sorted(messages, key=lambda message: message[1]))


def test_a_slow_localiser_costs_no_sample_of_the_wheels(tmp_path: Path) -> None:
    path = bag_of_a_known_motion(tmp_path, noise=0.01)
    (piece,) = open_source(str(path), "wheels").pieces
    (joint_states,) = [topic for topic in read_log(path).topics if topic.role == "wheels"]
    assert piece.t is not None
    assert joint_states.columns is not None
    assert np.diff(piece.t) == pytest.approx(0.1)
    middles = piece.t[0] + (np.arange(piece.commands.n) + 0.5) * RECORDING_GRID
    for k, side in enumerate(SIDES):
        wanted = np.interp(middles, joint_states.t, joint_states.columns[f"enc_{side}"])
        assert piece.commands.values[:, k] == pytest.approx(wanted, abs=1e-9)


def test_commands_begin_at_their_own_stamps_and_end_half_a_second_after_the_last() -> None:
    seen = np.arange(0.0, 4.0, 0.1)
    commanded = np.arange(0.53, 2.0, 0.05)
    pose = {"x": 0.01 * seen, "y": 0.0 * seen, "yaw": 0.0 * seen}
    command = {"cmd_v": 1.0 + np.arange(len(commanded)), "cmd_w": 0.0 * commanded}
    groups = {"pose": Group("/pose", seen, pose), "cmd": Group("/cmd_vel", commanded, command)}
    (piece,) = open_source(Log(Path("drive.bag"), groups)).pieces
    begun = RECORDING_GRID * np.flatnonzero(np.diff(piece.commands.values[:, 0], prepend=0.0))
    assert begun[:-1] == pytest.approx(commanded)
    assert begun[-1] == pytest.approx(commanded[-1] + 0.5 + RECORDING_GRID)


def test_the_lateness_of_a_known_motion_is_found(tmp_path: Path) -> None:
    path = bag_of_a_known_motion(tmp_path, noise=0.0001)
    profile = bare_profile(load_robot("husky"))
    found = fit("kinematic", str(path), profile, input="wheels", search="lsq").as_dict()
    for name in ("position_late", "yaw_late"):
        number = found["parameters"][name]
        error = abs(number["value"] - LATE)
        assert error < 3.0 * number["standard_error"]
        assert error < 0.0002
