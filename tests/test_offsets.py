"""Delays of a log's wheels, positions and headings: recovered, and taken out one by one."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssmr.estimation.settings import EkfSettings
from ssmr.robot.drive import wheel_rates
from validation.files.inspection import Inspected
from validation.files.log import Group, Log
from validation.files.offsets import Offset, estimate_offsets, lateness_of_first, take_out_offsets
from validation.files.sensors import Signals

SECONDS = 120.0
FEW_MS = 0.004
"""Error of an offset that is excused if its standard error is smaller still [s]: a twelfth of a
sample."""


def motion(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Speed, yaw rate, x, y and yaw at instants t, of a robot with changing speed and turn."""
    fine = np.arange(-2.0, SECONDS + 2.0, 1e-3)
    v = 0.3 + 0.3 * np.sin(0.9 * fine) * np.sin(0.23 * fine)
    w = 0.5 * np.sin(0.7 * fine + 1.0) + 0.3 * np.sin(1.3 * fine)
    yaw = 1e-3 * np.cumsum(w)
    x = 1e-3 * np.cumsum(v * np.cos(yaw))
    y = 1e-3 * np.cumsum(v * np.sin(yaw))
    return tuple(np.interp(t, fine, a) for a in (v, w, x, y, yaw))


def made(wheels: float, position: float, yaw: float, seed: int = 0) -> Log:
    """A noisy log whose sensors are late by so much [s].

    It has 20 Hz, and poses of 10 Hz that are logged twice.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 0.05)
    seen = np.repeat(t[::2], 2)[: len(t)]

    def noisy(values: np.ndarray, std: float, every: int = 1) -> np.ndarray:
        return values + std * np.repeat(rng.standard_normal(-(-len(t) // every)), every)[: len(t)]

    v, w = motion(t - wheels)[:2]
    left, right = wheel_rates(v, w, EkfSettings.half_track, EkfSettings.radius)
    x, y = motion(seen - position)[2:4]
    pose = {
        "x": noisy(x, 0.007, 2),
        "y": noisy(y, 0.007, 2),
        "yaw": noisy(motion(seen - yaw)[4], 0.01, 2),
    }
    groups = {
        "pose": Group("log", t, pose),
        "wheels": Group("log", t, {"enc_left": noisy(left, 0.05), "enc_right": noisy(right, 0.05)}),
    }
    gyro = {"imu": Group("log", t, {"gyro_z": noisy(motion(t)[1], 0.02)})}
    return Log(Path("log.csv"), {**groups, **gyro})


def found_in(log: Log) -> dict[str, Offset]:
    return {offset.late: offset for offset in Inspected(log).offsets}


def error_beyond(offset: Offset, true: float) -> bool:
    assert offset.standard_error is not None
    return abs(offset.seconds - true) > max(2.0 * offset.standard_error, FEW_MS)


@pytest.mark.parametrize(
    ("wheels", "position", "yaw"), [(0.2, 0.1, 0.22), (0.0, 0.15, -0.05), (-0.1, -0.1, 0.3)]
)
def test_each_delay_is_recovered(wheels: float, position: float, yaw: float) -> None:
    measured = found_in(made(wheels, position, yaw))
    for name, true in (("wheels", wheels), ("position", position), ("pose_yaw", yaw)):
        assert measured[name].behind == "imu"
        assert not error_beyond(measured[name], true), measured[name]
        assert measured[name].standard_error < 0.02


def with_group(log: Log, name: str, columns: dict[str, np.ndarray]) -> Log:
    return replace(log, groups={**log.groups, name: replace(log.groups[name], columns=columns)})


def test_standard_errors_are_as_large_as_the_errors() -> None:
    errors = []
    rows = []
    for seed in range(8):
        measured = found_in(made(0.0, 0.1, 0.2, seed))
        errors.append([measured["position"].seconds - 0.1, measured["pose_yaw"].seconds - 0.2])
        rows.append([measured["position"].standard_error, measured["pose_yaw"].standard_error])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(rows), axis=0))
    # eight draws: a standard deviation is known to a quarter
    assert np.all((ratio > 0.3) & (ratio < 2.0)), ratio


def test_jumps_of_the_localiser_move_no_offset() -> None:
    log = made(0.2, 0.1, 0.22)
    t = log.t
    columns = log.groups["pose"].columns
    jumps = sum(3.0 * (t >= at) for at in (20.0, 33.0, 71.0))
    lost = (t >= 50.0) & (t < 52.0)  # for two seconds it looks somewhere else
    jumped = {**columns, "x": columns["x"] + jumps, "yaw": columns["yaw"] - 0.8 * lost}
    measured = found_in(with_group(log, "pose", jumped))
    assert not error_beyond(measured["position"], 0.1)
    assert not error_beyond(measured["pose_yaw"], 0.22)


def test_sync_takes_each_delay_out() -> None:
    log = made(0.2, 0.1, 0.22)
    offsets = [
        Offset(name, "imu", s, 1.0)
        for name, s in (("wheels", 0.2), ("position", 0.1), ("pose_yaw", 0.22))
    ]
    after = take_out_offsets(Signals(log), offsets)
    pose = after.groups["pose"]
    x, y, yaw = motion(pose.t)[2:]
    for name, true, noise in (("x", x, 0.007), ("y", y, 0.007), ("yaw", yaw, 0.01)):
        assert np.sqrt(np.mean((pose.columns[name] - true) ** 2)) < 1.1 * noise
    assert len(pose.t) > len(log.t) - 10
    assert all(abs(offset.seconds) < 2.0 * FEW_MS for offset in Inspected(after).offsets)


@pytest.mark.parametrize("late", [0.0, 0.8, 2.0])
def test_a_late_gyro_leaves_commands_the_delay_of_the_robot(late: float) -> None:
    """Commands of 0.3 s before the motion, in a log whose gyro alone is late."""
    log = made(0.0, 0.05, 0.05)
    t = log.groups["wheels"].t
    v, w = motion(t + 0.3)[:2]
    gyro = log.groups["imu"]
    groups = {
        **log.groups,
        "imu": replace(gyro, t=t + late),
        "cmd": Group("log", t, {"cmd_v": v, "cmd_w": w}),
    }
    log = replace(log, groups=groups)
    offsets = estimate_offsets(Signals(log))
    follows = -{o.late: o.seconds for o in offsets}["cmd"] - lateness_of_first(offsets)
    assert follows == pytest.approx(0.3, abs=0.06)
    after = found_in(take_out_offsets(Signals(log), offsets))
    assert after["cmd"].seconds == pytest.approx(-follows, abs=0.02)
    assert after["wheels"].seconds == pytest.approx(0.0, abs=0.02)


def test_a_heading_is_not_taken_out_of_a_gap() -> None:
    log = made(0.0, 0.0, 0.3)
    pose = log.groups["pose"].where((log.t < 40.0) | (log.t > 45.0))
    offsets = [Offset("pose_yaw", "imu", 0.3, 1.0), Offset("position", "imu", 0.0, 1.0)]
    cut = Signals(replace(log, groups={**log.groups, "pose": pose}))
    after = take_out_offsets(cut, offsets).groups["pose"]
    assert not np.any((after.t > 39.75) & (after.t < 45.0))
    assert np.abs(after.columns["yaw"] - motion(after.t)[4]).max() < 0.06  # five times the noise


def test_delays_in_a_long_log_take_little_memory() -> None:
    t = np.arange(0.0, 4000.0, 0.1)
    rates = np.sin(0.3 * t + np.sin(0.05 * t))
    signals = Signals(
        Log.of_columns("log.csv", {"t": t, "gyro_z": rates, "cmd_v": rates, "cmd_w": rates})
    )
    assert len(estimate_offsets(signals)) == 1
    tracemalloc.start()
    estimate_offsets(signals)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    one = 8.0 * t[-1] / 0.01  # a rate at the instants at which two are correlated [bytes]
    assert most < 10.0 * one, "powers of all blocks were held at once"
