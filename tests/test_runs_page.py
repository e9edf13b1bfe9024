"""The page on every log has what its script finds."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from tests.conftest import data_folder
from validation.descriptions.loading import load_robot
from validation.plants.profile import bare_profile

DOCS = Path(__file__).resolve().parents[1] / "docs"
LOG = "warthog_grass_2"


def test_a_log_on_the_page_has_the_errors_of_its_calibration(tmp_path: Path) -> None:
    file = data_folder() / "drive_runs" / f"{LOG}_train.csv"
    if not file.is_file():
        pytest.skip(f"{LOG}: no recording in {data_folder()}")
    script = runpy.run_path(str(DOCS / "make_runs_tables.py"))
    bare = bare_profile(load_robot("warthog"))
    script["calibrate_log"](LOG, file, bare, ("kinematic",), tmp_path / script["OWN"])
    ((label, _, *cells),) = script["error_lines"](tmp_path)
    text = (DOCS / "tile.md").read_text(encoding="utf-8")
    (written,) = re.findall(rf"^\| {label} \| kinematic \|(.*)\|$", text, re.MULTILINE)
    ours, page = (re.findall(r"[\d.]+", words) for words in (" ".join(cells), written))
    # another processor may round the last digit in another way
    assert [*map(float, ours)] == pytest.approx([*map(float, page)], abs=0.0011)
