"""Logs that are written: nothing is lost silently, what was written is read back, and no source is written over."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from tests.bag_factory import Maker, Message, circle, write
from validation.logs.formats import FORMATS, losses, read_log, write_log
from validation.logs.groups import Group
from validation.logs.log import Log
from validation.logs.recording import RECORDING_COLUMNS, Recording, RecordingError, is_channel_name
from validation.recordings import ConvertSettings, convert

STAMP = 1.1e-6
"""Seconds of Unix time have 0.24 microseconds in a double, and on a common clock instants within 1e-6 s are the same."""
SPECIAL = ("pose", "cmd vel", "cmd_vel", "ü", "é", "u", "odom_v", "odom_w", "odom_x", "odom_y", "odom_yaw", "gps_east",
           "gps_north", "/pose", "a/b", "a_b", "2nd", "_", "\N{GREEK SMALL LETTER MU}", "imu/data", "recording/columns",
           "tf", "\u202eevil", "[/red]", "x" * 300, "x" * 301, "value", "pose_2")  # fmt: skip
ENDINGS = [ending for f in FORMATS if f.read is not None and f.write is not None for ending in f.endings]


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """Any recording: names of any kind, stamps before, around and long after zero."""
    n = draw(st.integers(2, 6))
    names = st.one_of(st.sampled_from(SPECIAL), st.text(min_size=1, max_size=8)).filter(is_channel_name)
    known = draw(st.sets(st.sampled_from(sorted(RECORDING_COLUMNS)), min_size=1))
    channels = draw(st.sets(names.filter(lambda s: s != "t" and s not in RECORDING_COLUMNS), max_size=6))
    start = draw(st.sampled_from([0.0, 5.0, -3.0, 1.7e9, -1.7e9, 2.0**31 - 1.0, 3.9e9]))
    steps = draw(st.lists(st.floats(0.001, 2.0), min_size=n - 1, max_size=n - 1))
    values = st.floats(-90.0, 90.0, width=32).filter(lambda v: v == 0.0 or abs(v) > 1e-30)
    columns = {name: draw(st.lists(values, min_size=n, max_size=n)) for name in sorted(known | channels)}
    return Recording.from_columns("drive", {"t": start + np.cumsum([0.0, *steps]), **columns})


@pytest.mark.parametrize("ending", ENDINGS)
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(made=recordings())
@example(Recording.from_columns("drive", {"t": [0.0, 1.0], "x": [1.0, 2.0], **{name: [0.0, k] for k, name in enumerate(
    name for name in SPECIAL if is_channel_name(name))}}))  # fmt: skip
def test_what_was_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, ending: str, made: Recording) -> None:
    path = tmp_path_factory.mktemp("exports") / f"drive{ending}"
    log = Log.of_recording(Path("nowhere.csv"), made)
    try:
        told = losses(log, path)
    except ValueError as refused:
        assert "do not fit" in str(refused)  # noqa: PT017
        return
    write_log(log, path)
    before = made.all_columns()
    again = read_log(path)
    got = again.recording().all_columns()
    if ending == ".csv":
        assert {n: a.tobytes() for n, a in got.items()} == {n: a.tobytes() for n, a in before.items()}
        return
    assert set(got) == set(before)
    assert any("under others" in text for text in told) == any(n not in topics_of(path) for n in made.channels)
    there = {n: a for group in again.groups.values() for n, a in group.columns.items()}
    for name, values in there.items():
        turned = np.remainder(values - before[name] + math.pi, 2.0 * math.pi) - math.pi if name.endswith("yaw") else 0.0
        np.testing.assert_allclose(turned if name.endswith("yaw") else values - before[name], 0.0, atol=1e-12)
    for group in again.groups.values():
        np.testing.assert_allclose(group.t, before["t"] - before["t"][0], atol=STAMP)


def topics_of(path: Path) -> set[str]:
    with AnyReader([path]) as reader:
        return {c.topic.removeprefix("/") for c in reader.connections if c.msgtype == "std_msgs/msg/Float64"}


def test_viewers_get_the_frame_of_the_body(tmp_path: Path) -> None:
    """It lies where the pose is, or else odometry, and adds no column."""
    n, path = 5, tmp_path / "drive.mcap"
    gyro = {"gyro_z": np.ones(n)}
    odometry = {
        "odom_v": np.ones(n),
        "odom_w": np.zeros(n),
        "odom_x": np.arange(n),
        "odom_y": np.zeros(n),
        "odom_yaw": np.ones(n),
    }
    pose = {"x": np.arange(n), "y": np.full(n, 2.0), "yaw": np.linspace(0.0, 1.0, n)}
    both, one = {"/tf": n, "/tf_static": 1}, {"/tf": n}
    for columns, wanted in (({**pose, **odometry}, both), (pose, one), (gyro | odometry, one), (gyro, {})):
        source = Recording.from_columns("drive", {"t": 0.1 * np.arange(n), **columns})
        write_log(Log.of_recording(Path("nowhere.csv"), source), path)
        with AnyReader([path]) as reader:
            counts = {c.topic: c.msgcount for c in reader.connections if c.topic.startswith("/tf")}
            assert counts == wanted
            read = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
        frames = [m.transforms[0] for topic, m in read if topic == "/tf"]
        assert {(f.header.frame_id, f.child_frame_id) for f in frames} <= {
            ("map" if "x" in columns else "odom", "base_link")
        }
        for k, frame in enumerate(frames):
            x, y, yaw = (
                columns[name][k] for name in (("x", "y", "yaw") if "x" in columns else ("odom_x", "odom_y", "odom_yaw"))
            )
            turned = frame.transform.rotation
            assert (frame.transform.translation.x, frame.transform.translation.y) == (x, y)
            assert 2.0 * math.atan2(turned.z, turned.w) == pytest.approx(yaw)
        assert set(read_log(path).recording().all_columns()) == set(source.all_columns())


def test_beside_a_bag_lies_a_layout_of_its_topics(tmp_path: Path) -> None:
    """In Foxglove's form: a tree of panels, each with its settings; what they show is in the bag."""
    convert("sample", target=tmp_path / "drive.mcap", robot="jackal").save(tmp_path / "drive.mcap")
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
    for start, first in ((1.7e9, 1.7e9), (0.0, 1e9), (-40.0, 1e9 - 40.0)):
        made = Recording.from_columns("drive", {"t": start + 0.1 * np.arange(9), "x": np.zeros(9)})
        write_log(Log.of_recording(Path("nowhere.csv"), made), tmp_path / f"a{ending}")
        with AnyReader([tmp_path / f"a{ending}"]) as reader:
            assert reader.start_time == round(first) * 10**9


def test_stamps_that_no_bag_holds_are_refused_in_one_line(tmp_path: Path) -> None:
    groups = {"pose": Group("far", np.array([0.0, 3.0e9]), {"x": np.zeros(2)})}
    log = Log(Path("nowhere.csv"), groups)
    for check in (losses, write_log):
        with pytest.raises(ValueError, match=r"0 to 3e\+09 s do not fit into a.mcap, whose stamps end after 2147483648 s"):
            check(log, tmp_path / "a.mcap")
    near = Log(Path("nowhere.csv"), {"pose": Group("near", np.array([0.0, 1e-10, 1.0]), {"x": np.zeros(3)})})
    with pytest.raises(ValueError, match="closer together than the nanosecond"):
        write_log(near, tmp_path / "a.bag")
    assert not list(tmp_path.iterdir())


def test_what_a_trajectory_does_not_hold_is_said(tmp_path: Path) -> None:
    source = tmp_path / "drive.csv"
    source.write_text("t,x,y,yaw,battery\n0,0,0,0,1\n1,0,0,0,2\n")
    assert convert(source, target=tmp_path / "a.tum").notes()[-1].endswith("and not: 'battery'")
    assert len(convert(source, target=tmp_path / "a.mcap").notes()) == len(convert(source).notes()) == 1


def test_a_filtered_pose_takes_no_channels_name(tmp_path: Path) -> None:
    source = tmp_path / "drive.csv"
    rows = "".join(f"{0.1 * k},0,0,0,1,1,7\n" for k in range(50))
    source.write_text(f"t,x,y,yaw,enc_left,enc_right,pose_x\n{rows}")
    with pytest.raises(ValueError, match="has a column 'pose_x' already"):
        convert(source, ConvertSettings(ekf=True))


@pytest.mark.parametrize(
    "said",
    [
        '{"/a": ["channels", ["t"]]}',
        '{"/a": ["channels", ["\\u001b[31m"]]}',
        '{"/a": ["pose", []]}',
        '{"/a": "ab"}',
        '{"/a": 1}',
        "[1",
        "[" * 9000,
    ],
)
def test_a_map_of_columns_that_lies_is_refused(tmp_path: Path, said: str) -> None:
    def lying(make: Maker) -> list[Message]:
        numbers = [("/a", 0.1 * k, make("std_msgs/Float64", data=float(k))) for k in range(9)]
        return [("/recording/columns", 0.0, make("std_msgs/String", data=said)), *numbers]

    with pytest.raises(RecordingError) as refused:
        read_log(write(tmp_path, "mcap", lying))
    assert str(refused.value).isprintable()


# ----------------------------------------------------------------------------------------------- targets
def into_the_folder(bag: Path) -> tuple[Path, Path]:
    return bag, bag / "drive.mcap"


def deeper(bag: Path) -> tuple[Path, Path]:
    return bag, bag / "new" / "a.csv"


def through_a_link(bag: Path) -> tuple[Path, Path]:
    (bag.parent / "other").symlink_to(bag)
    return bag, bag.parent / "other" / "a.csv"


def through_dots(bag: Path) -> tuple[Path, Path]:
    return bag, bag.parent / "nowhere" / ".." / bag.name / "a.csv"


def from_a_link(bag: Path) -> tuple[Path, Path]:
    (bag.parent / "other").symlink_to(bag)
    return bag.parent / "other", bag / "a.csv"


def a_link_to_a_part(bag: Path) -> tuple[Path, Path]:
    (bag.parent / "a.mcap").symlink_to(bag / "drive.mcap")
    return bag, bag.parent / "a.mcap"


def a_hard_link_to_a_part(bag: Path) -> tuple[Path, Path]:
    os.link(bag / "drive.mcap", bag.parent / "a.mcap")
    return bag, bag.parent / "a.mcap"


def beside_the_file(bag: Path) -> tuple[Path, Path]:
    return bag / "drive.mcap", bag / "drive_1.mcap"


def the_file_itself(bag: Path) -> tuple[Path, Path]:
    return bag / "drive.mcap", bag / "drive.mcap"


def a_link_to_the_file(bag: Path) -> tuple[Path, Path]:
    (bag.parent / "a.mcap").symlink_to(bag / "drive.mcap")
    return bag.parent / "a.mcap", bag / "drive.mcap"


def a_loop(bag: Path) -> tuple[Path, Path]:
    (bag.parent / "loop").symlink_to(bag.parent / "loop")
    return bag, bag.parent / "loop" / "a.csv"


TARGETS = (into_the_folder, deeper, through_a_link, through_dots, from_a_link, a_link_to_a_part, a_hard_link_to_a_part,
           beside_the_file, the_file_itself, a_link_to_the_file, a_loop)  # fmt: skip


@pytest.mark.parametrize("place", TARGETS)
def test_no_target_in_equal_to_or_linked_to_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: Callable[[Path], tuple[Path, Path]]
) -> None:
    bag = write(tmp_path, "mcap", circle).parent
    source, target = place(bag)
    before = {p: p.read_bytes() for p in bag.iterdir()}
    done = convert(source)
    with pytest.raises(ValueError, match=r"lies in the bag|link to a part of the bag|the log itself|cannot be seen"):
        done.save(target)
    monkeypatch.setattr("validation.recordings.run.read_log", lambda *_: pytest.fail("work was done first"))
    with pytest.raises(ValueError, match=r"lies in the bag|link to a part of the bag|the log itself|cannot be seen"):
        convert(source, target=target)
    assert {p: p.read_bytes() for p in bag.iterdir()} == before


def test_a_target_beside_the_source_is_fine(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap", circle).parent
    for name in ("drive.csv", "drive.mcap", "drive2/drive.mcap"):
        assert convert(bag, target=tmp_path / name).save(tmp_path / name).is_file()
        convert(bag, target=tmp_path / name).save(tmp_path / name)  # and again, over what was written
