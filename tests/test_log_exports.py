"""Logs that are written: nothing is lost silently, what was written is read back, and no source is written over."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from tests.bag_factory import Maker, Message, circle, write
from validation.logs.formats import FORMATS, losses, read_log, write_log
from validation.logs.log import Log
from validation.logs.recording import RECORDING_COLUMNS, Recording, RecordingError, is_channel_name
from validation.recordings import convert

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


@pytest.mark.parametrize("ending", [".mcap", ".bag"])
def test_stamps_are_kept_where_they_are_unix_time(tmp_path: Path, ending: str) -> None:
    for start, first in ((1.7e9, 1.7e9), (0.0, 1e9), (-40.0, 1e9 - 40.0)):
        made = Recording.from_columns("drive", {"t": start + 0.1 * np.arange(9), "x": np.zeros(9)})
        write_log(Log.of_recording(Path("nowhere.csv"), made), tmp_path / f"a{ending}")
        with AnyReader([tmp_path / f"a{ending}"]) as reader:
            assert reader.start_time == round(first) * 10**9


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
TARGETS = {
    "in the folder": ("drive", "drive/drive.mcap"),
    "deeper": ("drive", "drive/new/a.csv"),
    "through a link": ("drive", "other/a.csv"),
    "through dots": ("drive", "nowhere/../drive/a.csv"),
    "from a link": ("other", "drive/a.csv"),
    "a link to a part": ("drive", "link.mcap"),
    "a hard link to a part": ("drive", "hard.mcap"),
    "beside the file": ("drive/drive.mcap", "drive/drive_1.mcap"),
    "the file itself": ("drive/drive.mcap", "drive/drive.mcap"),
    "a link to the file": ("link.mcap", "drive/drive.mcap"),
    "a loop": ("drive", "loop/a.csv"),
}
"""Source and target, beside the folder of a bag that is called drive."""


@pytest.mark.parametrize("place", TARGETS)
def test_no_target_in_equal_to_or_linked_to_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    bag = write(tmp_path, "mcap", circle).parent
    (tmp_path / "other").symlink_to(bag)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "link.mcap").symlink_to(bag / "drive.mcap")
    os.link(bag / "drive.mcap", tmp_path / "hard.mcap")
    source, target = (tmp_path / name for name in TARGETS[place])
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
