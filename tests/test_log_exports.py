"""Logs that are written: nothing is lost silently, what was written is read back, and no file is written over unasked."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from ssmr.geometry import quat_wxyz_to_yaw
from tests.bag_factory import circle, write
from tests.conftest import exit_status
from validation.files.formats import FORMATS, read_log, write_log
from validation.files.log import POSE_COLUMNS, RECORDED, Group, Log, ReadOptions, is_column_name
from validation.recordings import PROGRAM, convert

STAMP = 1.1e-6
"""Seconds of Unix time have 0.24 microseconds in a double, and on a common clock instants within 1e-6 s are the same."""
SPECIAL = ("pose", "cmd vel", "cmd_vel", "ü", "é", "odom_v", "odom_w", "odom_x", "odom_y", "odom_yaw", "gps_east",
           "gps_north", "/pose", "a/b", "2nd", "_", "imu/data", "tf", "\u202eevil", "[/red]", "x" * 300)  # fmt: skip
ODOMETRY = {"odom_v", "odom_w", "odom_x", "odom_y", "odom_yaw"}
ENDINGS = [ending for f in FORMATS if f.read is not None and f.write is not None for ending in f.endings]


@st.composite
def logs(draw: st.DrawFn) -> Log:
    """Any log: names of any kind, stamps before, around and long after zero."""
    n = draw(st.integers(2, 6))
    names = st.one_of(st.sampled_from(SPECIAL), st.text(min_size=1, max_size=8)).filter(is_column_name)
    known = draw(st.sets(st.sampled_from(sorted(RECORDED)), min_size=1))
    others = draw(st.sets(names.filter(lambda s: s != "t"), max_size=6))
    start = draw(st.sampled_from([0.0, 5.0, -3.0, 1.7e9, -1.7e9, 2.0**31 - 1.0, 3.9e9]))
    steps = draw(st.lists(st.floats(0.001, 2.0), min_size=n - 1, max_size=n - 1))
    values = st.floats(-1.5, 1.5, width=32).filter(lambda v: v == 0.0 or abs(v) > 1e-30)
    columns = {name: draw(st.lists(values, min_size=n, max_size=n)) for name in sorted(known | others)}
    return Log.of_columns("nowhere.csv", {"t": start + np.cumsum([0.0, *steps]), **columns})


EVERY_NAME = {name: [0.0, 0.1 * k] for k, name in enumerate(n for n in SPECIAL if is_column_name(n))}


@pytest.mark.parametrize("ending", ENDINGS)
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(made=logs())
@example(Log.of_columns("nowhere.csv", {"t": [0.0, 1.0], "x": [1.0, 2.0], **EVERY_NAME}))
def test_what_was_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, ending: str, made: Log) -> None:
    """From a bag with those characters in a column's name that a topic's can have."""
    assume(not made.has(ODOMETRY) or "pose" in made.groups)  # else odometry is the pose
    path = tmp_path_factory.mktemp("exports") / f"drive{ending}"
    try:
        write_log(made, path)
    except ValueError as refused:
        assert re.search("do not fit|would be written as topic", str(refused))  # noqa: PT017
        return
    again = read_log(path)
    names = {n if ending == ".csv" else re.sub(r"[^A-Za-z0-9_/]", "_", n): n for n in made.columns}
    assert set(again.columns) == set(names)
    for name, values in again.columns.items():
        np.testing.assert_allclose(values, made.columns[names[name]], rtol=0.0, atol=0.0 if ending == ".csv" else 1e-12)
    for group in again.groups.values():
        np.testing.assert_allclose(group.t - again.t[0], made.t - made.t[0], atol=STAMP)


def test_odometry_without_another_pose_comes_back_as_the_pose(tmp_path: Path) -> None:
    bag, mcap, options = write(tmp_path, "ros1", circle()), tmp_path / "again.mcap", ReadOptions({"pose": "none"})
    convert(bag, topics={"pose": "none"}).write(mcap)
    first, again = (read_log(p, options).columns for p in (bag, mcap))
    assert set(again) == set(first) > set(POSE_COLUMNS)
    for column, values in again.items():
        np.testing.assert_allclose(values, first[column], atol=STAMP)


def test_viewers_get_the_frame_of_the_body(tmp_path: Path) -> None:
    """It lies where the pose is, or else odometry, and adds no column; all stamps of the file increase."""
    n, path = 5, tmp_path / "drive.mcap"
    turn, gyro = np.linspace(0.0, 1.0, n), {"gyro_z": np.ones(n)}
    odometry = {"odom_v": np.ones(n), "odom_w": np.zeros(n), "odom_x": np.arange(n), "odom_y": 0.0 * turn, "odom_yaw": turn}
    pose = {"x": np.arange(n), "y": np.full(n, 2.0), "yaw": turn}
    for columns, wanted in (({**pose, **odometry}, n), (pose, n), (gyro | odometry, n), (gyro, 0)):
        write_log(Log.of_columns("nowhere.csv", {"t": 0.1 * np.arange(n), **columns}), path)
        with AnyReader([path]) as reader:
            read = [(c.topic, ns, reader.deserialize(raw, c.msgtype)) for c, ns, raw in reader.messages()]
        assert [ns for _, ns, _ in read] == sorted(ns for _, ns, _ in read)
        frames = [m.transforms[0] for topic, _, m in read if topic == "/tf"]
        parent, names = ("map", list(pose)) if "x" in columns else ("odom", list(odometry)[2:])
        assert len(frames) == wanted
        for k, frame in enumerate(frames):
            assert (frame.header.frame_id, frame.child_frame_id) == (parent, "base_link")
            rotation, place = frame.transform.rotation, frame.transform.translation
            found = (place.x, place.y, 2.0 * math.atan2(rotation.z, rotation.w))
            assert found == pytest.approx([columns[name][k] for name in names])
        if "x" in columns or "odom_x" not in columns:
            assert set(read_log(path).columns) == set(columns)


def test_stamps_are_kept_where_they_are_unix_time(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for start, first in ((1.7e9, 1.7e9), (0.0, 1e9), (-40.0, 1e9 - 40.0)):
        write_log(Log.of_columns("nowhere.csv", {"t": start + 0.1 * np.arange(9), "x": np.zeros(9)}), path)
        with AnyReader([path]) as reader:
            assert reader.start_time == round(first) * 10**9
    path.unlink()
    for t, said in (([0.0, 3.0e9], r"0 to 3e\+09 s do not fit"), ([0.0, 1e-10, 1.0], "closer together than the nanosecond")):
        log = Log(Path("nowhere.csv"), {"pose": Group("far", np.array(t), {"x": np.zeros(len(t))})})
        with pytest.raises(ValueError, match=said):
            write_log(log, path)
    assert not list(tmp_path.iterdir())


def test_evo_reads_the_trajectory(tmp_path: Path) -> None:
    convert("sample").write(tmp_path / "drive.tum")
    log, trajectory = read_log("sample"), file_interface.read_tum_trajectory_file(str(tmp_path / "drive.tum"))
    assert trajectory.check()[0]
    pose = log.table(POSE_COLUMNS)
    np.testing.assert_allclose(trajectory.timestamps, log.t, atol=1e-9)
    np.testing.assert_allclose(trajectory.positions_xyz[:, :2], pose[:, :2], atol=1e-9)
    yaw = np.unwrap(quat_wxyz_to_yaw(trajectory.orientations_quat_wxyz))
    np.testing.assert_allclose(yaw, pose[:, 2], atol=1e-8)  # nine digits of a half angle's sine


# ----------------------------------------------------------------------------------------------- targets
def status(*arguments: object) -> int:
    """The exit status of `recordings ARGUMENTS`."""
    return exit_status(PROGRAM, *map(str, arguments))


def test_no_target_is_its_source_or_a_part_of_it(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap", circle()).parent
    before = {p: p.read_bytes() for p in bag.iterdir()}
    part = next(bag.glob("*.mcap"))
    (tmp_path / "part.mcap").symlink_to(part)
    for source, target in ((bag, tmp_path / "part.mcap"), (bag, part), (part, part), (tmp_path / "part.mcap", part)):
        with pytest.raises(ValueError, match=r"the log itself, or a part of it"):
            convert(source).write(target)
        assert status("convert", source, "--out", target, "--overwrite") == 2
    assert {p: p.read_bytes() for p in bag.iterdir()} == before


def test_a_file_that_somebody_else_wrote_is_replaced_only_if_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (("convert", "sample", "--out", "mine.csv"), ("info", "sample", "--json", "mine.csv")):
        Path("mine.csv").write_text("precious")
        assert status(*arguments) == 2
        assert "mine.csv: there is such a file already" in capsys.readouterr().err
        assert Path("mine.csv").read_text() == "precious"
        assert status(*arguments, "--overwrite") == 0
        assert Path("mine.csv").read_text() != "precious"
    for _ in range(2):  # its own findings, and the file that nobody named, are replaced
        assert status("info", "sample", "--json", "info.json") == status("convert", "sample") == 0
