"""`python -m validation.recordings` as its user runs it.

What it writes, what others make of that, and what it refuses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.bag_factory import circle, write
from tests.conftest import data_folder, exit_status
from validation.experiment.sources import open_source
from validation.files.csv_logs import read_csv
from validation.files.formats import SHIPPED_LOGS, log_path, read_log
from validation.recordings import PROGRAM


# ------------------------------------------------------------------------------------------- what
# it writes
def test_info_and_convert_as_they_are_called(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = str(write(tmp_path, "ros1", circle()))
    assert exit_status(PROGRAM, "info", bag) == 0
    reported = capsys.readouterr().out
    for words in (
        "/husky_velocity_controller/odom",
        "Odometry",
        "20.0",
        "not read",
        "latitude",
        "wheels",
    ):
        assert words in reported
    out = tmp_path / "folder" / "drive.csv"
    assert (
        exit_status(
            PROGRAM, "convert", bag, "--out", str(out), *"--from 1 --until 2 --rate 50".split()
        )
        == 0
    )
    recording = read_csv(out)
    assert np.median(np.diff(recording.t)) == pytest.approx(0.02)
    assert recording.t[0] >= 1.0
    assert recording.t[-1] <= 2.0
    assert sorted(p.name for p in out.parent.iterdir()) == ["drive.csv"]


@pytest.mark.parametrize(
    ("name", "of", "begin"), [("husky", "husky_tile", 530.0), ("warthog", "warthog_grass", 200.0)]
)
def test_the_real_logs_are_excerpts_of_what_their_readme_says(
    name: str, of: str, begin: float
) -> None:
    excerpt = read_log(name)
    whole = data_folder() / of / f"{of}_train.csv"
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
def test_a_shipped_log_comes_before_a_file_of_its_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clone of this project may be called husky, and the README says `compare husky`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()
    assert log_path(name).is_file()
    assert log_path(f"./{name}") == Path(name)
