"""What enters as a log: regular files within limits, in seconds; and limits that are documented and can be raised."""

from __future__ import annotations

import math
import os
import re
import socket
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.parameters import described
from tests.bag_factory import poses_at, write
from validation.bench.waypoint_files import WaypointError, read_waypoints
from validation.logs.csv_table import read_csv_table
from validation.logs.formats import read_log, read_recording
from validation.logs.groups import Group
from validation.logs.limits import USUAL, LogLimits, find_time_fault
from validation.logs.recording import RecordingError
from validation.logs.recording_csv import read_csv
from validation.motion.sources import open_source
from validation.recordings import info

DOCS = Path(__file__).resolve().parents[1] / "docs" / "logs.md"


def drive(folder: Path, t: np.ndarray, columns: dict[str, np.ndarray] | None = None) -> Path:
    """A recording as a text file, whatever its numbers are."""
    columns = columns or {"x": np.zeros(len(t))}
    path = folder / "drive.csv"
    rows = zip(t.tolist(), *(c.tolist() for c in columns.values()), strict=True)
    path.write_text("\n".join([",".join(["t", *columns]), *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return path


# --------------------------------------------------------------------------------------------------- regular files only
def pipe(path: Path) -> None:
    os.mkfifo(path)


def link_to_zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


def local_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


@pytest.mark.parametrize("kind", [pipe, link_to_zero, local_socket])
@pytest.mark.parametrize("name", ["a.csv", "a.bag", "a.mcap", "folder", "way.csv"])
def test_what_is_no_file_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Callable[[Path], None], name: str
) -> None:
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = Path(name)
    if name == "folder":
        path.mkdir()
        kind(path / "metadata.yaml")
    else:
        kind(path)
    began = time.perf_counter()
    with pytest.raises((RecordingError, WaypointError), match=r"a (pipe|device|socket)|cannot be read \(No such device"):
        read_waypoints(path, 0.25) if name == "way.csv" else read_log(path)
    assert time.perf_counter() - began < 5.0


# --------------------------------------------------------------------------------------------------- sizes
def test_sizes_are_limited_before_anything_is_held(tmp_path: Path) -> None:
    huge = tmp_path / "huge.csv"
    with huge.open("wb") as file:
        file.truncate(10**12)  # a hole, which takes no space
    with pytest.raises(RecordingError, match=r"more than the 500 MB allowed \(limit table_size\)"):
        read_csv(huge)
    wide = tmp_path / "wide.csv"
    wide.write_text("t," + ",".join(f"x{k}" for k in range(20_000)) + "\n")
    with pytest.raises(RecordingError, match=r"line 1: there are 20001 columns, but the limit columns is 1000"):
        read_csv(wide)
    wide.write_text("t,x\n0" + "," * 300_000)
    with pytest.raises(RecordingError, match=r"line 2: there are 300000 commas, but the limit columns is 1000"):
        read_csv(wide)
    path = drive(tmp_path, np.arange(100.0))
    for limits, line in (({"samples": 50}, 52), ({"cells": 150}, 77)):
        with pytest.raises(RecordingError, match=f"line {line}: there are too many rows: the limit {next(iter(limits))} is"):
            read_csv(path, limits=USUAL.changed(limits))
    bag = write(tmp_path, "mcap", poses_at)
    with pytest.raises(RecordingError, match=r"too many messages or topics: the limit samples is 7"):
        read_recording(bag, USUAL.changed({"samples": 7}))
    with pytest.raises(RecordingError, match=r"more than the 100 bytes allowed \(limit bag_size\)"):
        read_recording(bag, USUAL.changed({"bag_size": 1e-4}))


@given(st.integers(1, 40), st.integers(1, 9), st.integers(1, 30))
def test_a_table_is_the_same_in_whatever_pieces_it_is_read(rows: int, width: int, at_once: int) -> None:
    values = np.arange(rows * width, dtype=np.float64).reshape(rows, width)
    text = "\n".join([",".join(f"c{k}" for k in range(width)), *(",".join(map(repr, r)) for r in values.tolist())])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("validation.logs.csv_table._AT_ONCE", at_once)
        patch.setattr("validation.logs.csv_table.read_regular", lambda *_: text.encode())
        table = read_csv_table(Path("table.csv"), RecordingError)
    got = [table.numbers(k, f"c{k}", {}) for k in range(width)]
    np.testing.assert_array_equal(np.column_stack([g for g in got if g is not None]), values)
    assert list(table.lines) == list(range(2, rows + 2))


# --------------------------------------------------------------------------------------------------- time
T = 0.05 * np.arange(1200)


@pytest.mark.parametrize(
    ("t", "line", "said"),
    [
        (
            T * 1e9,
            2,
            "the median step is 5e+07 s, but the limit period is 5 s; t looks like nanoseconds: divide it by 1e+09",
        ),
        (T * 1e6, 2, "t looks like microseconds: divide it by 1e+06"),
        (T * 1e3, 2, "t looks like milliseconds: divide it by 1000"),
        ((1.7e9 + T) * 1e9, 2, "t looks like nanoseconds"),
        ((1.7e9 + T) * 1e3, 2, "t looks like milliseconds"),
        (T * 1e300, 2, "the median step is 5e+298 s"),
        (T * 1e-300, 2, "the median step is 5e-302 s, but the limit rate is 100000 Hz"),
        (np.append(T, 1e9), 1202, "time jumps from 59.95 to 1e+09 s, but the limit gap is 3600 s"),
        (np.append(T, 1e5), 1202, "time jumps from 59.95 to 100000 s"),
        (np.append(T, 1e300), 1202, "there is 1e+300 s, but the limit stamp is 4.3e+09 s"),
        (np.append(-1e9, T), 3, "time jumps from -1e+09 to 0 s"),
        (np.sort(np.append(T, 5e-324)), 3, "the step from the sample before is 4.94e-324 s"),
        (4.0 * np.arange(250_000), 250_001, "the log spans 999996 s, but the limit span is 864000 s"),
    ],
)
def test_what_is_no_time_in_seconds_is_refused_with_its_line(tmp_path: Path, t: np.ndarray, line: int, said: str) -> None:
    with pytest.raises(RecordingError) as refused:
        read_csv(drive(tmp_path, t))
    assert (refused.value.line, refused.value.column) == (line, "t")
    assert said in str(refused.value)


@pytest.mark.parametrize("start", [0.0, -40.0, 1.7e9, -1e9, 4.2e9])
@pytest.mark.parametrize("period", [1e-4, 0.02, 1.0])
def test_any_usual_time_is_fine(start: float, period: float) -> None:
    t = start + period * np.arange(500)
    assert find_time_fault(t, USUAL) is None


@pytest.mark.parametrize("t", [(-1e308, -1e308), (1e308, -1e308, 1e308), (-1.7e308, 1.7e308)])
def test_stamps_too_large_to_be_added_are_one_fault(t: tuple[float, ...]) -> None:
    with np.errstate(all="raise"):
        assert find_time_fault(np.array(t), USUAL) is not None


def test_gaps_are_found_at_once_as_one_by_one() -> None:
    rng = np.random.default_rng(7)
    group = Group("g", np.cumsum(rng.choice([0.1, 0.1, 0.1, 1.0, 3.0], 300)), {})
    t = np.sort(np.concatenate([rng.uniform(0.0, group.t[-1] + 1.0, 2000), group.t, group.t + 1e-6, group.t - 1e-6]))
    for margin, least in ((0.0, 0.0), (1e-6, 0.0), (1e-6, 2.0)):
        slow = np.zeros(len(t), dtype=bool)
        for start, stop in group.gaps():
            slow |= (t > start + margin) & (t < stop - margin) & (stop - start > least)
        np.testing.assert_array_equal(group.in_gaps(t, margin, least), slow)


# --------------------------------------------------------------------------------------------------- numbers
@pytest.mark.parametrize("value", [1e308, -1e308, 1e200])
@pytest.mark.parametrize("name", ["cmd_v", "cmd_w", "enc_left", "gyro_z", "x", "yaw"])
def test_numbers_that_cannot_be_are_refused_with_line_and_column(tmp_path: Path, name: str, value: float) -> None:
    values = np.zeros(1200)
    values[700] = value
    path = drive(tmp_path, T, {name: values})
    for read in (read_csv, info, lambda p: open_source(str(p))):
        with pytest.raises(RecordingError, match=r"there is .* but the limit") as refused:
            read(path)
        assert (refused.value.line, refused.value.column) == (702, name)


# --------------------------------------------------------------------------------------------------- the limits themselves


def test_every_limit_is_documented_with_its_default() -> None:
    section = DOCS.read_text(encoding="utf-8").partition("## Limits")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \|([^|]+)\|([^|]*)\|", section, re.MULTILINE)
    documented = {name: (float(value.replace(" ", "")), unit.strip()) for name, value, unit in rows}
    declared = {name: (d.default, "" if d.unit == "1" else d.unit) for name, d in described(LogLimits).items()}
    assert documented == declared
    assert all(math.isfinite(d.default) for d in described(LogLimits).values())
