"""The state filter that a user chooses: by name, from a file, or commissioned."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ssmr.control.references import circle
from ssmr.estimation.settings import EkfSettings
from tests.conftest import data_folder
from validation.plants.profile import Profile, load_profile
from validation.recordings import commission, convert, info
from validation.track import track

STOCK = EkfSettings()
TILE = data_folder() / "husky_tile" / "husky_tile_train.csv"


@pytest.fixture(scope="module")
def tile() -> Profile:
    return load_profile("husky-tile")


def test_a_commissioned_filter_finds_the_way_where_the_thesis_filter_does_not(tile: Profile, tmp_path: Path) -> None:
    """With a biased gyro and tyres that roll on less than the driver believes; the file of a run is that run's filter."""
    runs = {}
    for name in ("thesis", "commissioned", str(tmp_path / "filter.toml")):
        runs[name] = track("lqr-scheduled", circle(speed=0.25), profile=tile, feedback="ekf", filter=name, gyro_bias=0.0156)
        if name == "commissioned":
            written = runs[name].save(tmp_path, recording=False)
            assert tmp_path / "filter.toml" in written
            document = json.loads((tmp_path / "track.json").read_text(encoding="utf-8"))
    thesis, knows, again = (r.metrics["d_rms_m"] for r in runs.values())
    assert knows < 0.3 * thesis
    assert again == knows
    assert document["filter"]["name"] == "commissioned"
    assert document["filter"]["scale_right"] > document["filter"]["scale_left"] > 1.0
    assert document["options"]["gyro_bias_rad_s"] == 0.0156
    assert "turning ratio" in runs["commissioned"].table()
    assert "filter thesis" in runs["thesis"].table()
    assert "turning ratio" not in runs["thesis"].table()


@pytest.mark.skipif(not TILE.is_file(), reason=f"no recording {TILE}")
def test_a_filter_that_half_a_log_commissioned_reckons_the_other_half(tmp_path: Path) -> None:
    halves = [tmp_path / "first.csv", tmp_path / "second.csv"]
    convert(TILE, sync=True, until=325.0).write(halves[0])
    convert(TILE, sync=True, start=325.0).write(halves[1])
    made = commission(halves[0]).filter
    assert made is not None
    assert made.settings.bias == pytest.approx(-0.0156, abs=0.001)  # as the recording's own page has it
    assert 1.7 < made.settings.turning < 2.2
    reckoning = info(halves[1], filter=made.save(tmp_path / "tile.toml")).reckoning
    assert reckoning is not None
    rms = {row.name: row.rms for row in reckoning.rows}
    assert rms["filter 'first'"] < 0.2 * rms["filter, bias learned at rest"]
