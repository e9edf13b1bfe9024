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

from ssmr.estimation.settings import learning
from ssmr.geometry import align_rigidly, quat_wxyz_to_yaw
from tests.conftest import data_folder
from validation.logs.dead_reckoning import filtered_motion, integrated, reckon
from validation.logs.formats import read_recording
from validation.logs.offsets import estimate_offsets
from validation.logs.recording import Recording
from validation.logs.recording_csv import read_csv, write_csv
from validation.logs.rest import STOCK, find_rest, unbiased
from validation.plants.profile import load_profile
from validation.recordings import ConvertSettings, convert, open_log
from validation.recordings.simulated_log import LogSettings, simulated_log

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


def columns_of(recording: Recording) -> dict[str, np.ndarray]:
    return {**recording.columns, **recording.channels}


# ------------------------------------------------------------------------------------------- what it writes


def test_a_csv_comes_back_through_a_bag(tmp_path: Path) -> None:
    source = drive_csv(tmp_path)
    before = columns_of(read_csv(source))
    for name in ("drive.mcap", "drive.bag"):
        bag, back = tmp_path / name, tmp_path / f"back {name}.csv"
        convert(source).save(bag)
        convert(bag).save(back)
        after = columns_of(read_csv(back))
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
    convert(source, ConvertSettings(rate, align=align, stop=until)).save(once)
    convert(once, ConvertSettings(align=align, stop=until)).save(twice)
    assert twice.read_bytes() == once.read_bytes()


def test_evo_reads_the_trajectory(tmp_path: Path) -> None:
    source, out = drive_csv(tmp_path), tmp_path / "drive.tum"
    convert(source).save(out)
    recording, trajectory = read_csv(source), file_interface.read_tum_trajectory_file(str(out))
    assert trajectory.check()[0]
    np.testing.assert_allclose(trajectory.timestamps, recording.t, atol=1e-9)
    np.testing.assert_allclose(trajectory.positions_xyz[:, :2], recording.pose[:, :2], atol=1e-9)
    yaw = np.unwrap(quat_wxyz_to_yaw(trajectory.orientations_quat_wxyz))
    np.testing.assert_allclose(yaw, recording.pose[:, 2], atol=1e-8)  # nine digits of a half angle's sine


def test_any_reader_of_ros_2_reads_the_mcap(tmp_path: Path) -> None:
    source, out = drive_csv(tmp_path), tmp_path / "drive.mcap"
    convert(source).save(out)
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
    np.testing.assert_array_equal(battery, recording.channels["battery"])
    rates = [list(m.velocity) for topic, _, m in read if topic == "/joint_states"]
    np.testing.assert_array_equal(np.array(rates)[:, 0], recording.columns["enc_left"])
    x = [m.pose.position.x for topic, _, m in read if topic == "/pose"]
    np.testing.assert_array_equal(x, recording.columns["x"])


# ------------------------------------------------------------------------------------------- a simulated log
def test_a_simulated_log_shows_its_faults(tmp_path: Path) -> None:
    faults = LogSettings()
    profile = load_profile("husky-tile")
    groups = simulated_log("varied@kinematic", profile, 3)
    late = {o.late: o.seconds for o in estimate_offsets(groups)}
    assert late["pose_yaw"] == pytest.approx(faults.pose_late, abs=0.004)
    rest = find_rest(groups)
    assert rest is not None
    assert rest.bias == pytest.approx(faults.gyro_bias, abs=4.0 * rest.std / np.sqrt(rest.seconds * 50.0))
    again = simulated_log("varied@kinematic", profile, 3)
    assert all(np.array_equal(a, again[n].columns[c]) for n, g in groups.items() for c, a in g.columns.items())
    with pytest.raises(ValueError, match="there are: traj1, traj2, traj3, traj4, varied, each with @"):
        simulated_log("varied@gazebo", profile, 3)


# ------------------------------------------------------------------------------------------- a real Husky
@pytest.mark.skipif(not PARKING_LOT.is_file(), reason=f"no recording {PARKING_LOT}")
def test_on_the_parking_lot_the_filter_is_nearer_the_gps_than_gyro_heading_alone() -> None:
    groups = open_log(PARKING_LOT).groups
    found = reckon(groups)
    assert found is not None
    rms = {row.name: row.rms for row in found.rows}
    assert rms["odometry's own pose"] == pytest.approx(7.0, abs=0.05)  # as published beside the recording
    assert rms["filter, bias learned at rest"] < rms["filter of wheels and gyro"] < rms["wheels' speed, gyro's heading"]
    assert rms["filter, bias learned at rest"] < 3.0
    assert found.rows[0].length == pytest.approx(359.0, abs=1.0)
    rest = find_rest(groups)
    assert rest is not None
    assert abs(rest.bias) < 1e-3
    whole = reckon(unbiased(PARKING_LOT, groups))
    assert whole is not None
    assert whole.rows[3].rms == pytest.approx(rms["filter, bias learned at rest"], abs=0.01)  # taken out before, or by it
    learns = reckon(groups, more={"learning": learning(STOCK)})
    assert learns is not None
    assert learns.rows[-1].rms < 1.01 * rms["filter, bias learned at rest"]
    assert learns.rows[-1].length == pytest.approx(359.0, abs=1.0)  # what it learns on the way moves no pose by a jump


@pytest.mark.skipif(not PARKING_LOT.is_file(), reason=f"no recording {PARKING_LOT}")
def test_between_gps_positions_the_learning_filter_does_not_run_away() -> None:
    """Every second minute of positions is kept from both filters, which are judged there, without alignment."""
    groups = open_log(PARKING_LOT).groups
    gps = groups["gps"]
    away = gps.t // 60.0 % 2.0 == 1.0
    told = replace(gps, t=gps.t[~away], columns={name: column[~away] for name, column in gps.columns.items()})
    found = {}
    for name, used, std in (("thesis", STOCK, 2.5), ("learning", learning(STOCK), 2.5), ("doubts", learning(STOCK), 40.0)):
        motion = filtered_motion({**groups, "gps": told}, settings=used, gps_std=std)
        assert motion is not None
        there = [np.interp(gps.t, motion.t, column) for column in motion.xy.T]
        off = np.hypot(*(there - np.array([gps.columns["gps_east"], gps.columns["gps_north"]])))
        found[name] = [float(np.sqrt(np.mean(off[part] ** 2))) for part in (away, ~away)]
    print(f"rms distance [m] where positions were kept from it, and where it had them: {found}")
    assert found["learning"][0] < 1.1 * found["thesis"][0] < 6.0
    assert found["learning"][1] < found["thesis"][1]
    assert found["doubts"][0] < 0.9 * found["learning"][0]  # the receiver wanders, which is no noise


@pytest.mark.skipif(not PARKING_LOT.is_file(), reason=f"no recording {PARKING_LOT}")
def test_no_constant_bias_and_scale_bring_the_parking_lot_near_its_gps() -> None:
    """Fitted to the GPS itself they leave 2.4 m: the receiver's own error, which no dead reckoning gets below."""
    groups = open_log(PARKING_LOT).groups
    gps = np.column_stack([groups["gps"].columns[name] for name in ("gps_east", "gps_north")])

    def away(corrections: np.ndarray) -> np.ndarray:
        imu, odom = groups["imu"], groups["odom"]
        track = integrated(
            {
                "imu": replace(imu, columns={"gyro_z": imu.columns["gyro_z"] - 1e-3 * corrections[0]}),
                "odom": replace(odom, columns={**odom.columns, "odom_v": odom.columns["odom_v"] * corrections[1]}),
            }
        )
        assert track is not None
        there = np.column_stack([np.interp(groups["gps"].t, track.t, track.columns[name]) for name in ("x", "y")])
        return np.asarray(align_rigidly(there, gps) - gps).ravel()

    best = least_squares(away, [0.0, 1.0])
    assert np.sqrt(2.0 * best.cost / len(gps)) == pytest.approx(2.44, abs=0.05)
    assert 0.96 < best.x[1] < 0.985  # the wheels are 2 to 3 % fast


def test_the_sample_is_what_the_robot_drives(tmp_path: Path) -> None:
    """All columns are rounded to 1e-4 at most; contacts may differ by a little more on another processor."""
    made = tmp_path / "made.csv"
    assert run("convert", "varied@mujoco", "--profile", "husky-tile", "--rate", 20, "--out", made).returncode == 0
    ours, theirs = read_recording("sample"), read_recording(made)
    assert ours.columns.keys() == theirs.columns.keys()
    assert ours.t == pytest.approx(theirs.t, abs=1e-3)
    for name, values in theirs.columns.items():
        assert ours.columns[name] == pytest.approx(values, abs=1e-3, nan_ok=True), name
