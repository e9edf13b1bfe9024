"""`python -m validation.recordings` as its user runs it: what it writes, what others make of that, and what it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from scipy.optimize import least_squares

from ssmr.geometry import align_rigidly, quat_wxyz_to_yaw
from tests.bag_factory import circle, poses_at, write
from tests.conftest import data_folder
from validation.bench.reckoning import integrated, reckon
from validation.bench.simulated_logs import SensorFaults, open_log, simulated_log
from validation.files.csv_logs import read_csv, write_csv
from validation.files.faults import find_rest, unbiased
from validation.files.formats import log_path, read_log
from validation.files.log import POSE_COLUMNS, ReadOptions
from validation.files.offsets import estimate_offsets
from validation.plants.profile import load_profile
from validation.recordings import convert, info

ROOT = Path(__file__).resolve().parents[1]
PARKING_LOT = data_folder() / "husky_parking_lot" / "test1.bag"
STAMP = 1e-6
"""As in test_bags: nanoseconds of Unix time."""


def run(*args: object) -> subprocess.CompletedProcess[str]:
    """`python -m validation.recordings ARGS` as a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "validation.recordings", *map(str, args)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=300,
    )


def drive_csv(folder: Path, n: int = 200, period: float = 0.05) -> Path:
    """A recording with every known column and a channel."""
    t = period * np.arange(n)
    names = ("cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z", "x", "y", "yaw", "battery")
    columns = {name: np.sin((k + 1) * 0.3 * t) for k, name in enumerate(names)}
    path = folder / "drive.csv"
    write_csv({"t": t, **columns}, path)
    return path


# ------------------------------------------------------------------------------------------- what it writes
def test_info_and_convert_as_processes(tmp_path: Path) -> None:
    bag = write(tmp_path, "ros1", circle)
    told = run("info", bag)
    assert told.returncode == 0, told.stderr
    for words in ("/husky_velocity_controller/odom", "Odometry", "20.0", "not read", "latitude", "wheels"):
        assert words in told.stdout
    out = tmp_path / "folder" / "drive.csv"
    done = run("convert", bag, "--out", out, "--from", 1, "--until", 2, "--rate", 50)
    assert done.returncode == 0, done.stderr
    recording = read_csv(out)
    assert np.median(np.diff(recording.t)) == pytest.approx(0.02)
    assert recording.t[0] >= 1.0
    assert recording.t[-1] <= 2.0
    assert sorted(p.name for p in out.parent.iterdir()) == ["drive.csv"]


def test_a_csv_comes_back_through_a_bag(tmp_path: Path) -> None:
    source = drive_csv(tmp_path)
    before = read_csv(source).columns
    for name in ("drive.mcap", "drive.bag"):
        bag, back = tmp_path / name, tmp_path / f"back {name}.csv"
        convert(source).write(bag)
        convert(bag).write(back)
        after = read_csv(back).columns
        assert set(after) == set(before)
        for column, values in after.items():
            np.testing.assert_allclose(values, before[column], atol=STAMP)


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rate=st.one_of(st.none(), st.floats(5.0, 60.0)), align=st.booleans(), until=st.one_of(st.none(), st.floats(3.0, 9.0)))
def test_convert_is_idempotent(
    tmp_path_factory: pytest.TempPathFactory, rate: float | None, align: bool, until: float | None
) -> None:
    folder = tmp_path_factory.mktemp("twice")
    source, once, twice = drive_csv(folder), folder / "once.csv", folder / "twice.csv"
    convert(source, rate=rate, align=align, until=until).write(once)
    convert(once, align=align, until=until).write(twice)
    assert twice.read_bytes() == once.read_bytes()


def test_evo_reads_the_trajectory(tmp_path: Path) -> None:
    source, out = drive_csv(tmp_path), tmp_path / "drive.tum"
    convert(source).write(out)
    recording, trajectory = read_csv(source), file_interface.read_tum_trajectory_file(str(out))
    pose = recording.table(POSE_COLUMNS)
    assert trajectory.check()[0]
    np.testing.assert_allclose(trajectory.timestamps, recording.t, atol=1e-9)
    np.testing.assert_allclose(trajectory.positions_xyz[:, :2], pose[:, :2], atol=1e-9)
    yaw = np.unwrap(quat_wxyz_to_yaw(trajectory.orientations_quat_wxyz))
    np.testing.assert_allclose(yaw, pose[:, 2], atol=1e-8)  # nine digits of a half angle's sine


def test_any_reader_of_ros_2_reads_the_mcap(tmp_path: Path) -> None:
    source, out = drive_csv(tmp_path), tmp_path / "drive.mcap"
    convert(source).write(out)
    recording = read_csv(source)
    with AnyReader([out]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        read = [(c.topic, ns, reader.deserialize(raw, c.msgtype)) for c, ns, raw in reader.messages()]
    assert kinds == {
        "/cmd_vel": "geometry_msgs/msg/TwistStamped",
        "/joint_states": "sensor_msgs/msg/JointState",
        "/imu/data": "sensor_msgs/msg/Imu",
        "/pose": "geometry_msgs/msg/PoseStamped",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/battery": "std_msgs/msg/Float64",
        "/recording/columns": "std_msgs/msg/String",
    }
    assert [ns for _, ns, _ in read] == sorted(ns for _, ns, _ in read)
    battery = [m.data for topic, _, m in read if topic == "/battery"]
    np.testing.assert_array_equal(battery, recording.columns["battery"])
    rates = [list(m.velocity) for topic, _, m in read if topic == "/joint_states"]
    np.testing.assert_array_equal(np.array(rates)[:, 0], recording.columns["enc_left"])
    x = [m.pose.position.x for topic, _, m in read if topic == "/pose"]
    np.testing.assert_array_equal(x, recording.columns["x"])


def test_odometry_without_another_pose_comes_back_as_the_pose(tmp_path: Path) -> None:
    bag, mcap = write(tmp_path, "ros1", circle), tmp_path / "again.mcap"
    convert(bag, topics={"pose": "none"}).write(mcap)
    first, again = (open_log(p, ReadOptions({"pose": "none"})).columns for p in (bag, mcap))
    assert set(again) == set(first)
    for column, values in again.items():
        np.testing.assert_allclose(values, first[column], atol=STAMP)


# ------------------------------------------------------------------------------------------- a simulated log
def test_a_simulated_log_shows_its_faults() -> None:
    faults, profile = SensorFaults(), load_profile("husky-tile")
    log = simulated_log("varied@kinematic", profile, 3)
    late = {o.late: o.seconds for o in estimate_offsets(log)}
    assert late["pose_yaw"] == pytest.approx(faults.pose_late, abs=0.004)
    rest = find_rest(log)
    assert rest is not None
    assert rest.bias == pytest.approx(faults.gyro_bias, abs=4.0 * rest.std / np.sqrt(rest.seconds * 50.0))
    again = simulated_log("varied@kinematic", profile, 3).columns
    assert all(np.array_equal(values, again[name]) for name, values in log.columns.items())
    with pytest.raises(ValueError, match="there are: traj1, traj2, traj3, traj4, varied, each with @"):
        simulated_log("varied@gazebo", profile, 3)


# ------------------------------------------------------------------------------------------- what it refuses
def test_info_tells_of_a_clock_that_jumps_and_goes_on(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap", lambda make: poses_at(make, jump=30.0))
    found = info(bag)
    assert "/pose: the clock jumps once: +30.000 s after 1.000 s" in found.table()
    assert "stamps bag takes the times of writing" in found.log.left_out[0]


# ------------------------------------------------------------------------------------------- a real Husky
@pytest.mark.skipif(not PARKING_LOT.is_file(), reason=f"no recording {PARKING_LOT}")
def test_on_the_parking_lot_the_filter_is_nearer_the_gps_than_gyro_heading_alone() -> None:
    log = open_log(PARKING_LOT)
    found, rest, whole = reckon(log), find_rest(log), reckon(unbiased(log))
    assert found is not None
    assert rest is not None
    assert whole is not None
    rms = {row.name: row.rms for row in found.rows}
    assert rms["odometry's own pose"] == pytest.approx(7.0, abs=0.05)  # as published beside the recording
    assert rms["filter, bias learned at rest"] < rms["filter of wheels and gyro"] < rms["wheels' speed, gyro's heading"]
    assert rms["filter, bias learned at rest"] < 3.0
    assert found.rows[0].length == pytest.approx(359.0, abs=1.0)
    assert abs(rest.bias) < 1e-3
    assert whole.rows[3].rms == pytest.approx(rms["filter, bias learned at rest"], abs=0.01)  # taken out before, or by it


@pytest.mark.skipif(not PARKING_LOT.is_file(), reason=f"no recording {PARKING_LOT}")
def test_no_constant_bias_and_scale_bring_the_parking_lot_near_its_gps() -> None:
    """Fitted to the GPS itself they leave 2.4 m: the receiver's own error, which no dead reckoning gets below."""
    log = open_log(PARKING_LOT)
    gps, imu, odom = (log.groups[name] for name in ("gps", "imu", "odom"))
    points = gps.table(("gps_east", "gps_north"))

    def away(corrections: np.ndarray) -> np.ndarray:
        gyro = {"gyro_z": imu.columns["gyro_z"] - 1e-3 * corrections[0]}
        speeds = {**odom.columns, "odom_v": odom.columns["odom_v"] * corrections[1]}
        groups = {"imu": replace(imu, columns=gyro), "odom": replace(odom, columns=speeds)}
        track = integrated(replace(log, groups=groups))
        assert track is not None
        there = np.column_stack([np.interp(gps.t, track[0], column) for column in track[1].T])
        return np.asarray(align_rigidly(there, points) - points).ravel()

    best = least_squares(away, [0.0, 1.0])
    assert np.sqrt(2.0 * best.cost / len(points)) == pytest.approx(2.44, abs=0.05)
    assert 0.96 < best.x[1] < 0.985  # the wheels are 2 to 3 % fast


def test_the_sample_is_what_the_robot_drives(tmp_path: Path) -> None:
    """All columns are rounded to 1e-4 at most; contacts may differ by a little more on another processor."""
    made = tmp_path / "made.csv"
    assert run("convert", "varied@mujoco", "--profile", "husky-tile", "--rate", 20, "--out", made).returncode == 0
    ours, theirs = read_log("sample"), read_log(made)
    assert ours.columns.keys() == theirs.columns.keys()
    assert ours.t == pytest.approx(theirs.t, abs=1e-3)
    for name, values in theirs.columns.items():
        assert ours.columns[name] == pytest.approx(values, abs=1e-3, nan_ok=True), name


def test_a_file_of_that_name_comes_before_the_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert log_path("sample").is_file()
    (tmp_path / "sample").mkdir()
    assert log_path("sample") == Path("sample")
