"""What enters as a log: regular files within limits, in seconds.

And limits that are documented and can be raised.
"""

from __future__ import annotations

import math
import os
import re
import time
from pathlib import Path

import numpy as np
import pytest

from ssmr.parameters import describe_parameters
from tests import bag_factory as make
from tests.bag_factory import poses_at, write
from tests.conftest import exit_status
from validation.experiment.sources import open_source
from validation.files import formats
from validation.files.csv_logs import read_csv
from validation.files.formats import LogFormat, read_log
from validation.files.limits import USUAL, LogLimits, find_time_fault
from validation.files.log import Log, ReadOptions
from validation.files.reading import FileError
from validation.recordings import PROGRAM, info

DOCS = Path(__file__).resolve().parents[1] / "docs" / "logs.md"


def drive(folder: Path, t: np.ndarray, columns: dict[str, np.ndarray] | None = None) -> Path:
    """A recording as a text file, whatever its numbers are."""
    columns = columns or {"x": np.zeros(len(t))}
    path = folder / "drive.csv"
    rows = zip(t.tolist(), *(c.tolist() for c in columns.values()), strict=True)
    path.write_text(
        "\n".join([",".join(["t", *columns]), *(",".join(map(repr, row)) for row in rows)]) + "\n"
    )
    return path


# --------------------------------------------------------------------------------------------------
# files and sizes
@pytest.mark.parametrize("name", ["a.csv", "a.bag", "a.mcap", "folder"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "folder":
        path.mkdir()
    os.mkfifo(path / "metadata.yaml" if name == "folder" else path)
    began = time.perf_counter()
    with pytest.raises(FileError, match="a pipe"):
        read_log(path)
    assert time.perf_counter() - began < 5.0


def test_sizes_are_limited_before_anything_is_held(tmp_path: Path) -> None:
    huge = tmp_path / "huge.csv"
    with huge.open("wb") as file:
        file.truncate(10**12)  # a hole, which takes no space
    with pytest.raises(FileError, match=r"more than the 500 MB allowed \(limit table_size\)"):
        read_csv(huge)
    path = drive(tmp_path, np.arange(100.0))
    with pytest.raises(FileError, match="line 52: there are too many rows: the limit samples is"):
        read_csv(path, ReadOptions(limits=USUAL.changed({"samples": 50})))
    bag = write(tmp_path, "mcap", poses_at())
    with pytest.raises(FileError, match=r"too many messages: the limit samples is 7"):
        read_log(bag, ReadOptions(limits=USUAL.changed({"samples": 7})))


# --------------------------------------------------------------------------------------------------
# time
T = 0.05 * np.arange(1200)


@pytest.mark.parametrize(
    ("t", "line", "message"),
    [
        (
            T * 1e9,
            2,
            "the median step is 5e+07 s, but the limit period is 5 s; t looks like nanoseconds: "
            "--columns t=t:ns",
        ),
        (T * 1e6, 2, "t looks like microseconds: --columns t=t:us"),
        ((1.7e9 + T) * 1e3, 2, "t looks like milliseconds: --columns t=t:ms"),
        (T * 1e300, 2, "the median step is 5e+298 s"),
        (T * 1e-300, 2, "the median step is 5e-302 s, but the limit rate is 100000 Hz"),
        (
            np.append(T, 1e9),
            1202,
            "time jumps from 59.95 to 1000000000 s, but the limit gap is 3600 s",
        ),
        (np.append(T, 1e300), 1202, "time jumps from 59.95 to 1e+300 s"),
        (np.append(-1e9, T), 3, "time jumps from -1000000000 to 0 s"),
        (np.sort(np.append(T, 5e-324)), 3, "the step from the sample before is 4.94e-324 s"),
        (
            4.0 * np.arange(250_000),
            250_001,
            "the log spans 999996 s, but the limit span is 864000 s",
        ),
    ],
)
def test_what_is_no_time_in_seconds_is_refused_with_its_line(
    tmp_path: Path, t: np.ndarray, line: int, message: str
) -> None:
    with pytest.raises(FileError) as refused:
        read_csv(drive(tmp_path, t))
    assert (refused.value.line, refused.value.column) == (line, "t")
    assert message in str(refused.value)


@pytest.mark.parametrize("t", [(-1e308, -1e308), (1e308, -1e308, 1e308), (-1.7e308, 1.7e308)])
def test_stamps_too_large_to_be_added_are_one_fault(t: tuple[float, ...]) -> None:
    with np.errstate(all="raise"):
        assert find_time_fault(np.array(t), USUAL) is not None


# --------------------------------------------------------------------------------------------------
# numbers
@pytest.mark.parametrize("name", ["cmd_v", "cmd_w", "enc_left", "gyro_z", "x", "yaw"])
def test_numbers_that_cannot_be_are_refused_with_line_and_column(tmp_path: Path, name: str) -> None:
    path = drive(tmp_path, T, {name: np.where(np.arange(1200) == 700, -1e200, 0.0)})
    for read in (read_csv, info, lambda p: open_source(str(p))):
        with pytest.raises(FileError, match=r"there is -1e\+200 .*, more than") as refused:
            read(path)
        assert (refused.value.line, refused.value.column) == (702, name)


def test_channels_that_cannot_be_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    odd = np.where(np.arange(1200) == 700, 1e308, 0.0)
    path = drive(
        tmp_path,
        T,
        {"x": np.sin(T), "odom_v": odd, "odom_w": odd, "battery": odd, "acc": 1e30 * (odd > 0.0)},
    )
    assert list(read_csv(path).groups["channels"].columns) == ["acc"]
    assert (
        "line 702, column odom_v: there is 1e+308 m/s, more than 100; the column is left out"
        in caplog.text
    )


def test_numbers_of_a_bag_that_cannot_be_are_refused_with_topic_and_time(tmp_path: Path) -> None:
    value = 1e200
    far = [
        (topic, 0.1 * k, message)
        for k in range(20)
        for topic, message in (
            ("/pose", make.pose_stamped(0.1 * k, value)),
            ("/odom", make.odometry(0.1 * k, (0.0, 0.0, 0.0), value, 0.0)),
            ("/imu", make.imu(0.1 * k, (0.0, 0.0, value), (value, value, -value))),
            ("/joints", make.joints(0.1 * k, {"left_wheel": value * k, "right_wheel": -value})),
            ("/fix", make.fix(0.1 * k, value, -value * k)),
        )
    ]
    bag = write(tmp_path, "mcap", far)
    with pytest.raises(FileError, match=r"/odom, 0.000 s: odom_v is 1e\+200 m/s, more than 100;"):
        read_log(bag)
    stray = write(tmp_path, "ros1", [*poses_at(), ("/pose", 1e6, make.pose_stamped(1e6, 0.0))])
    with pytest.raises(
        FileError, match=r"/pose, sample 21: time jumps from 1.9 to 1000000 s, but the limit gap"
    ):
        read_log(stray)


@pytest.mark.parametrize(
    ("t", "x", "message"),
    [
        (T, 1e9 * T, "drive.odd, 0.150 s: x is 1.5e+08 m, more than 1e+08"),
        (1e9 * T, T, "drive.odd, sample 1: the median step is 5e+07 s"),
    ],
)
def test_a_new_format_keeps_to_the_limits_without_a_word_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, t: np.ndarray, x: np.ndarray, message: str
) -> None:
    def read(path: Path, options: ReadOptions, radius: float | None) -> Log:
        return Log.of_columns(path, {"t": t, "x": x}, options.limits)

    monkeypatch.setattr(formats, "FORMATS", (LogFormat((".odd",), read=read),))
    (tmp_path / "drive.odd").touch()
    with pytest.raises(FileError) as refused:
        read_log(tmp_path / "drive.odd")
    assert message in str(refused.value)


# --------------------------------------------------------------------------------------------------
# the limits themselves
def test_limits_can_be_raised_by_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(drive(tmp_path, 10.0 * np.arange(100)))
    assert exit_status(PROGRAM, "info", path) == 2
    assert "the limit period is 5 s" in capsys.readouterr().err
    assert exit_status(PROGRAM, "info", path, "--limits", "period=20") == 0
    with pytest.raises(ValueError, match="span"):
        LogLimits(span=0.0)


def test_every_limit_is_documented_with_its_default() -> None:
    section = DOCS.read_text(encoding="utf-8").partition("## Limits")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \|([^|]+)\|([^|]*)\|", section, re.MULTILINE)
    documented = {name: (float(value.replace(" ", "")), unit.strip()) for name, value, unit in rows}
    declared = {
        name: (d.default, "" if d.unit == "1" else d.unit)
        for name, d in describe_parameters(LogLimits).items()
    }
    assert documented == declared
    assert all(math.isfinite(d.default) for d in describe_parameters(LogLimits).values())
