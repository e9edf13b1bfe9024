"""Every sensor of a log tells the same motion, whatever its stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssmr.geometry import integrate_rates
from ssmr.robot.drive import wheel_rates
from ssmr.types import FloatArray
from validation.files.log import Group, Log
from validation.files.motion import ENCODERS, STOCK
from validation.files.sensors import Signals

SECONDS = 60.0
PERIODS = {"imu": 0.01, "wheels": 0.04, "odom": 0.05, "cmd": 0.1, "pose": 0.1}
CURVED = 2e-3
"""Error of a rate between samples that are 0.1 s apart: its second derivative, at most 0.15, times
a square of that over eight, with room for a side that is logged in turn."""


def speed(t: FloatArray) -> FloatArray:
    return np.asarray(0.5 + 0.3 * np.sin(0.7 * t))


def yaw_rate(t: FloatArray) -> FloatArray:
    return np.asarray(0.4 * np.cos(0.5 * t))


def signals(repeats: int = 1) -> Signals:
    """Signals of a motion without slip, each sensor at stamps of its own.

    Each sample is logged `repeats` times, and the sides of the wheels are measured in turn.
    """
    fine = np.linspace(0.0, SECONDS, 60_001)
    heading = integrate_rates(fine, yaw_rate(fine))
    path = {
        "x": integrate_rates(fine, speed(fine) * np.cos(heading)),
        "y": integrate_rates(fine, speed(fine) * np.sin(heading)),
        "yaw": heading,
    }
    groups = {}
    for name, period in PERIODS.items():
        rows = np.arange(int(SECONDS / period))
        t = period * rows
        at = period * (rows // repeats * repeats)
        between = repeats // 2
        turned = period * np.maximum((rows - between) // repeats * repeats + between, 0)
        left, _ = wheel_rates(speed(at), yaw_rate(at), STOCK.half_track, STOCK.radius)
        _, right = wheel_rates(speed(turned), yaw_rate(turned), STOCK.half_track, STOCK.radius)
        columns = {
            "imu": {"gyro_z": yaw_rate(at)},
            "wheels": {"enc_left": left, "enc_right": right},
            "odom": {"odom_v": speed(at), "odom_w": yaw_rate(at)},
            "cmd": {"cmd_v": speed(at), "cmd_w": yaw_rate(at)},
            "pose": {axis: np.interp(at, fine, values) for axis, values in path.items()},
        }
        groups[name] = Group(name, t, columns[name])
    return Signals(Log(Path("log.csv"), groups))


def test_every_sensor_tells_the_same_motion() -> None:
    table = signals()
    assert list(table.told) == ["imu", "wheels", "odom", "cmd"]
    for name, told in table.told.items():
        np.testing.assert_allclose(told.turn, yaw_rate(told.t), atol=1e-12)
        if name == "imu":
            assert told.speed is None
        else:
            np.testing.assert_allclose(told.speed, speed(told.t), atol=1e-12)
    means = table.means
    turn = STOCK.radius * (means["enc_right"] - means["enc_left"]) / (2.0 * STOCK.half_track)
    for other in (turn, means["gyro_z"], means["odom_w"]):
        np.testing.assert_allclose(other, means["yaw"], atol=CURVED)
    # commands are held, and so half a sample late
    np.testing.assert_allclose(means["cmd_w"], means["yaw"], atol=0.02)
    np.testing.assert_allclose(table.along, means["odom_v"], atol=0.02)


@pytest.mark.parametrize("name", ["imu", "wheels", "odom"])
def test_a_sample_that_is_logged_again_makes_no_rate_late(name: str) -> None:
    """Nor do sides of wheels that are measured in turn make a turn that the robot never took."""
    told = signals(repeats=2).told[name]
    inside = (told.t > 0.5) & (told.t < SECONDS - 0.5)
    np.testing.assert_allclose(told.turn[inside], yaw_rate(told.t[inside]), atol=CURVED)


def test_a_log_without_a_column_tells_the_rest() -> None:
    left = signals().without(["enc_left", "odom_w", "x"])
    assert list(left.told) == ["imu", "cmd"]
    assert left.poses is None
    assert left.as_logged("wheels", "odom") is None
    assert left.as_logged("wheels", "cmd") is not None


@pytest.mark.parametrize("w", [0.0, 0.5, 2.0, 3.0])
def test_a_pose_tells_the_way_of_the_wheels_however_quickly_the_robot_turns(w: float) -> None:
    """The chord of a turn is shorter than its arc: by a third at 3 rad/s in a second."""
    t = 0.05 * np.arange(int(SECONDS / 0.05))
    v = 0.4
    heading = w * t
    wheels = dict(zip(ENCODERS, wheel_rates(v, w, STOCK.half_track, STOCK.radius), strict=True))
    pose = {
        "x": integrate_rates(t, v * np.cos(heading)),
        "y": integrate_rates(t, v * np.sin(heading)),
        "yaw": heading,
    }
    groups = {
        "wheels": Group(
            "wheels", t, {side: np.full(len(t), rate) for side, rate in wheels.items()}
        ),
        "pose": Group("pose", t, pose),
    }
    told = Signals(Log(Path("log.csv"), groups)).along
    np.testing.assert_allclose(told, v, rtol=0.005)
