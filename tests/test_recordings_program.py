"""`python -m validation.recordings` as its user runs it: what it writes, what others make of that, and what it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.bag_factory import circle, write
from tests.conftest import data_folder
from validation.bench.sources import open_source
from validation.files.csv_logs import read_csv
from validation.files.formats import SHIPPED_LOGS, log_path, read_log

ROOT = Path(__file__).resolve().parents[1]


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


# ------------------------------------------------------------------------------------------- what it writes
def test_info_and_convert_as_processes(tmp_path: Path) -> None:
    bag = write(tmp_path, "ros1", circle())
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


@pytest.mark.parametrize(("name", "of", "begin"), [("husky", "husky_tile", 530.0), ("warthog", "warthog_grass", 200.0)])
def test_the_real_logs_are_excerpts_of_what_their_readme_says(name: str, of: str, begin: float) -> None:
    excerpt, whole = read_log(name), data_folder() / of / f"{of}_train.csv"
    assert excerpt.t[0] == 0.0
    assert excerpt.t[-1] <= 60.0
    assert open_source(name, "wheels").reference == "recording"
    if not whole.is_file():
        pytest.skip(f"no recording {of} in {data_folder()}")
    source = read_log(whole)
    rows = np.searchsorted(source.t, excerpt.t + begin - 1e-3)
    assert source.t[rows] - begin == pytest.approx(excerpt.t, abs=1e-3)
    for column, values in excerpt.columns.items():
        assert np.array_equal(values, source.columns[column][rows]), column


@pytest.mark.parametrize("name", SHIPPED_LOGS)
def test_a_file_of_that_name_comes_before_the_shipped_log(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert log_path(name).is_file()
    (tmp_path / name).mkdir()
    assert log_path(name) == Path(name)
