"""Logs that are written.

Nothing is lost silently, all is read back, and no file is written over unasked.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ssmr.geometry import quat_wxyz_to_yaw
from tests.bag_factory import circle, write
from tests.conftest import exit_status
from validation.files.columns import POSE_COLUMNS, RECORDED, is_column_name
from validation.files.formats import read_log, write_log
from validation.files.log import Log
from validation.recordings import PROGRAM, convert

SPECIAL = (
    "pose",
    "cmd vel",
    "cmd_vel",
    "ü",
    "é",
    "odom_v",
    "odom_w",
    "odom_x",
    "odom_y",
    "odom_yaw",
    "gps_east",
    "gps_north",
    "/pose",
    "a/b",
    "2nd",
    "_",
    "imu/data",
    "tf",
    "\u202eevil",
    "[/red]",
    "x" * 300,
)


@st.composite
def logs(draw: st.DrawFn) -> Log:
    """Any log: names of any kind, stamps before, around and long after zero."""
    n = draw(st.integers(2, 6))
    names = st.one_of(st.sampled_from(SPECIAL), st.text(min_size=1, max_size=8)).filter(
        is_column_name
    )
    known = draw(st.sets(st.sampled_from(sorted(RECORDED)), min_size=1))
    others = draw(st.sets(names.filter(lambda s: s != "t"), max_size=6))
    start = draw(st.sampled_from([0.0, 5.0, -3.0, 1.7e9, -1.7e9, 2.0**31 - 1.0, 3.9e9]))
    steps = draw(st.lists(st.floats(0.001, 2.0), min_size=n - 1, max_size=n - 1))
    values = st.floats(-1.5, 1.5, width=32).filter(lambda v: v == 0.0 or abs(v) > 1e-30)
    columns = {
        name: draw(st.lists(values, min_size=n, max_size=n)) for name in sorted(known | others)
    }
    return Log.of_columns("nowhere.csv", {"t": start + np.cumsum([0.0, *steps]), **columns})


EVERY_NAME = {
    name: [0.0, 0.1 * k] for k, name in enumerate(n for n in SPECIAL if is_column_name(n))
}


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(made=logs())
@example(Log.of_columns("nowhere.csv", {"t": [0.0, 1.0], "x": [1.0, 2.0], **EVERY_NAME}))
def test_what_was_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, made: Log) -> None:
    path = tmp_path_factory.mktemp("exports") / "drive.csv"
    write_log(made, path)
    again = read_log(path)
    assert set(again.columns) == set(made.columns)
    np.testing.assert_array_equal(again.t, made.t)
    for name, values in again.columns.items():
        np.testing.assert_array_equal(values, made.columns[name])


def test_evo_reads_the_trajectory(tmp_path: Path) -> None:
    convert("sample").write(tmp_path / "drive.tum")
    log = read_log("sample")
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "drive.tum"))
    assert trajectory.check()[0]
    pose = log.table(POSE_COLUMNS)
    np.testing.assert_allclose(trajectory.timestamps, log.t, atol=1e-9)
    np.testing.assert_allclose(trajectory.positions_xyz[:, :2], pose[:, :2], atol=1e-9)
    yaw = np.unwrap(quat_wxyz_to_yaw(trajectory.orientations_quat_wxyz))
    np.testing.assert_allclose(yaw, pose[:, 2], atol=1e-8)  # nine digits of a half angle's sine


# -----------------------------------------------------------------------------------------------
# targets
def status(*arguments: object) -> int:
    """The exit status of `recordings ARGUMENTS`."""
    return exit_status(PROGRAM, *map(str, arguments))


def test_no_target_is_its_source_or_a_part_of_it(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap", circle()).parent
    before = {p: p.read_bytes() for p in bag.iterdir()}
    part = next(bag.glob("*.mcap"))
    (tmp_path / "part.mcap").symlink_to(part)
    for source, target in (
        (bag, tmp_path / "part.mcap"),
        (bag, part),
        (part, part),
        (tmp_path / "part.mcap", part),
    ):
        with pytest.raises(ValueError, match=r"the log itself, or a part of it"):
            convert(source).write(target)
        assert status("convert", source, "--out", target, "--overwrite") == 2
    assert {p: p.read_bytes() for p in bag.iterdir()} == before


def test_a_file_that_somebody_else_wrote_is_replaced_only_if_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (
        ("convert", "sample", "--out", "mine.csv"),
        ("info", "sample", "--json", "mine.csv"),
    ):
        Path("mine.csv").write_text("precious")
        assert status(*arguments) == 2
        assert "mine.csv: there is such a file already" in capsys.readouterr().err
        assert Path("mine.csv").read_text() == "precious"
        assert status(*arguments, "--overwrite") == 0
        assert Path("mine.csv").read_text() != "precious"
    for _ in range(2):  # its own findings, and the file that nobody named, are replaced
        assert status("info", "sample", "--json", "info.json") == status("convert", "sample") == 0


def test_a_picture_that_somebody_else_drew_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("info.png").write_text("precious")
    assert status("info", "sample", "--out", ".") == 2
    assert Path("info.png").read_text() == "precious"
    assert status("info", "sample", "--out", ".", "--overwrite") == 0
    assert Path("info.png").read_bytes().startswith(b"\x89PNG")
    assert status("info", "sample", "--out", ".") == 0  # its own
