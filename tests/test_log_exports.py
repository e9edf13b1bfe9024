"""Logs that are written: nothing is lost silently, what was written is read back, and no source is written over."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from tests.bag_factory import Maker, Message, circle, write
from validation.files.bags import read_topics
from validation.files.formats import FORMATS, losses, read_log, write_log
from validation.files.log import RECORDED, Group, Log, ReadOptions, is_column_name
from validation.files.reading import FileError
from validation.recordings import convert

STAMP = 1.1e-6
"""Seconds of Unix time have 0.24 microseconds in a double, and on a common clock instants within 1e-6 s are the same."""
SPECIAL = ("pose", "cmd vel", "cmd_vel", "ü", "é", "u", "odom_v", "odom_w", "odom_x", "odom_y", "odom_yaw", "gps_east",
           "gps_north", "/pose", "a/b", "a_b", "2nd", "_", "\N{GREEK SMALL LETTER MU}", "imu/data", "recording/columns",
           "tf", "\u202eevil", "[/red]", "x" * 300, "x" * 301, "value", "pose_2")  # fmt: skip
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
    path = tmp_path_factory.mktemp("exports") / f"drive{ending}"
    try:
        said = losses(made, path)
    except ValueError as refused:
        assert "do not fit" in str(refused)  # noqa: PT017
        return
    write_log(made, path)
    again = read_log(path)
    assert set(again.columns) == set(made.columns)
    for name, values in again.columns.items():
        np.testing.assert_allclose(values, made.columns[name], rtol=0.0, atol=0.0 if ending == ".csv" else 1e-12)
    for group in again.groups.values():
        np.testing.assert_allclose(group.t - again.t[0], made.t - made.t[0], atol=STAMP)
    if ending != ".csv":
        with AnyReader([path]) as reader:
            topics = {c.topic.removeprefix("/") for c in reader.connections if c.msgtype == "std_msgs/msg/Float64"}
        alone = {columns[0] for _, columns in read_topics(path, ReadOptions())[1].values() if len(columns) == 1}
        assert bool(said) == any(name not in topics for name in alone - {"gyro_z"})


def test_viewers_get_the_frame_of_the_body(tmp_path: Path) -> None:
    """It lies where the pose is, or else odometry, and adds no column."""
    n, path = 5, tmp_path / "drive.mcap"
    turn, gyro = np.linspace(0.0, 1.0, n), {"gyro_z": np.ones(n)}
    odometry = {"odom_v": np.ones(n), "odom_w": np.zeros(n), "odom_x": np.arange(n), "odom_y": 0.0 * turn, "odom_yaw": turn}
    pose = {"x": np.arange(n), "y": np.full(n, 2.0), "yaw": turn}
    both, one = {"/tf": n, "/tf_static": 1}, {"/tf": n}
    for columns, wanted in (({**pose, **odometry}, both), (pose, one), (gyro | odometry, one), (gyro, {})):
        write_log(Log.of_columns("nowhere.csv", {"t": 0.1 * np.arange(n), **columns}), path)
        with AnyReader([path]) as reader:
            assert {c.topic: c.msgcount for c in reader.connections if c.topic.startswith("/tf")} == wanted
            read = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
        frames, parent, names = [m.transforms[0] for topic, m in read if topic == "/tf"], "odom", list(odometry)[2:]
        if "x" in columns:
            parent, names = "map", list(pose)
        for k, frame in enumerate(frames):
            assert (frame.header.frame_id, frame.child_frame_id) == (parent, "base_link")
            rotation, place = frame.transform.rotation, frame.transform.translation
            found = (place.x, place.y, 2.0 * math.atan2(rotation.z, rotation.w))
            assert found == pytest.approx([columns[name][k] for name in names])
        assert set(read_log(path).columns) == set(columns)


def test_beside_a_bag_lies_a_layout_of_its_topics(tmp_path: Path) -> None:
    """In Foxglove's form: a tree of panels, each with its settings; what they show is in the bag."""
    convert("sample", robot="jackal").write(tmp_path / "drive.mcap")
    layout = json.loads((tmp_path / "drive.foxglove.json").read_text(encoding="utf-8"))
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}

    def panels(tree: object) -> list[str]:
        if isinstance(tree, str):
            return [tree]
        assert isinstance(tree, dict)
        assert tree["direction"] in ("row", "column")
        return [*panels(tree["first"]), *panels(tree["second"])]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    with AnyReader([tmp_path / "drive.mcap"]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        (said,) = [
            reader.deserialize(raw, c.msgtype).data for c, _, raw in reader.messages() if c.topic == "/robot_description"
        ]
    assert 'name="jackal"' in said
    settings = layout["configById"].values()
    shown = [path["value"].partition(".")[0] for panel in settings for path in panel.get("paths", ())]
    shown += [topic for panel in settings for topic in panel.get("topics", ())]
    assert set(shown) - set(kinds) <= {"/odom"}, "the sample has no odometry of its own"
    assert layout["configById"]["3D!robot"]["followTf"] == "base_link"


@pytest.mark.parametrize("ending", [".mcap", ".bag"])
def test_stamps_are_kept_where_they_are_unix_time(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
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


def test_what_a_trajectory_does_not_hold_is_said(tmp_path: Path) -> None:
    source = tmp_path / "drive.csv"
    source.write_text("t,x,y,yaw,battery\n0,0,0,0,1\n1,0,0,0,2\n")
    assert convert(source, out=tmp_path / "a.tum").notes()[-1].endswith("and not: 'battery'")
    assert len(convert(source, out=tmp_path / "a.mcap").notes()) == len(convert(source).notes()) == 1


def test_a_filtered_pose_takes_no_channels_name(tmp_path: Path) -> None:
    source = tmp_path / "drive.csv"
    rows = "".join(f"{0.1 * k},0,0,0,1,1,7\n" for k in range(50))
    source.write_text(f"t,x,y,yaw,enc_left,enc_right,pose_x\n{rows}")
    with pytest.raises(ValueError, match="has a column 'pose_x' already"):
        convert(source, ekf=True)


@pytest.mark.parametrize(
    "said",
    [
        '{"/a": ["channels", ["t"]]}',
        '{"/a": ["channels", ["\\u001b[31m"]]}',
        '{"/a": ["pose", []]}',
        '{"/a": 1}',
        "[1",
        "[" * 9000,
    ],
)
def test_a_map_of_columns_that_lies_is_refused(tmp_path: Path, said: str) -> None:
    def lying(make: Maker) -> list[Message]:
        numbers = [("/a", 0.1 * k, make("std_msgs/Float64", data=float(k))) for k in range(9)]
        return [("/recording/columns", 0.0, make("std_msgs/String", data=said)), *numbers]

    with pytest.raises(FileError) as refused:
        read_log(write(tmp_path, "mcap", lying))
    assert str(refused.value).isprintable()


# ----------------------------------------------------------------------------------------------- targets
def test_no_target_is_its_source_or_lies_in_it(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap", circle).parent
    before = {p: p.read_bytes() for p in bag.iterdir()}
    (tmp_path / "other").symlink_to(bag)
    (tmp_path / "part.mcap").symlink_to(bag / "drive.mcap")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for source, target in (
        (bag, bag / "new" / "a.csv"),
        (bag, tmp_path / "other" / "a.csv"),
        (bag, tmp_path / "nowhere" / ".." / bag.name / "a.csv"),
        (tmp_path / "other", bag / "a.csv"),
        (bag, tmp_path / "part.mcap"),
        (bag / "drive.mcap", bag / "drive_1.mcap"),
        (bag / "drive.mcap", bag / "drive.mcap"),
        (tmp_path / "part.mcap", bag / "drive.mcap"),
        (bag, tmp_path / "loop" / "a.csv"),
    ):
        for refused in (lambda: convert(source, out=target), lambda: convert(source).write(target)):  # noqa: B023
            with pytest.raises(ValueError, match=r"lies in the bag|the log itself|cannot be seen"):
                refused()
    assert {p: p.read_bytes() for p in bag.iterdir()} == before


def test_a_target_beside_the_source_is_fine(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap", circle).parent
    for name in ("drive.csv", "drive.mcap", "drive2/drive.mcap"):
        convert(bag, out=tmp_path / name).write(tmp_path / name)
        convert(bag, out=tmp_path / name).write(tmp_path / name)  # and again, over what was written
        assert (tmp_path / name).is_file()
