"""The thesis' tables of chapter 4, and the shipped gains on all references: honest verdicts, and nothing left out."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from tests.conftest import EXACT
from validation.plants.profile import Profile
from validation.study.gains import GainsOptions, study_gains
from validation.study.gains.run import GAIN_SPEEDS
from validation.study.tables import ControlTables, TablesOptions, study_tables
from validation.thesis.verdicts import FACTOR
from validation.track.gains import names
from validation.track.waypoint_files import SAMPLES


@pytest.fixture(scope="module")
def few(lab: Profile) -> ControlTables:
    return study_tables(TablesOptions(lab, 4, ("4.5", "4.6", "4.13", "4.27")))


def test_the_line_comes_out_as_printed(few: ControlTables) -> None:
    """The two rows whose geometry and gains are certain: gap at the end and length, within what four seeds spread."""
    for entry in few.entries[:2]:
        assert entry.verdict == "agrees"
        assert entry.mean["d_haus_m"] == pytest.approx(entry.printed["d_haus_m"], rel=0.2)
        assert entry.mean["d_ratio"] == pytest.approx(entry.printed["d_ratio"], abs=1e-3)
        assert entry.lost == 0


def test_the_husky_is_as_near_the_prediction_as_the_real_one(few: ControlTables) -> None:
    entry = few.entries[2]
    assert entry.comparison == "simulated_vs_real"
    assert entry.mean["d_rms_m"] <= entry.printed["d_rms_m"]


def test_a_lost_print_is_said(few: ControlTables) -> None:
    assert few.entries[3].verdict == "print lost"
    assert few.entries[3].mean["d_rms_m"] > 0.0


def test_verdicts_are_earned(few: ControlTables) -> None:
    entry = few.entries[0]
    printed = entry.printed["d_rms_m"]
    for factor, verdict in ((FACTOR - 0.01, "agrees"), (FACTOR + 0.01, "differs")):
        assert replace(entry, mean={**entry.mean, "d_rms_m": factor * printed}).verdict == verdict
    strict = replace(entry, comparison="simulated_vs_real", mean={**entry.mean, "d_rms_m": 1.01 * printed})
    assert strict.verdict == "differs"
    assert replace(strict, suspect="a copy").verdict == "print is suspect"
    assert replace(strict, reference="generic").verdict == "other geometry"
    assert replace(entry, mean={}).verdict == "lost the reference"


def test_documents_and_tables_hold_every_row(few: ControlTables) -> None:
    document = json.loads(json.dumps(few.as_dict(), allow_nan=False))
    assert list(document["tables"]) == [e.table for e in few.entries]
    text = "\n".join(few.report())
    assert all(f"| {e.table} |" in text for e in few.entries)
    assert len(few.figure().axes) >= 2


def test_every_shipped_set_is_driven_along_every_reference(lab: Profile) -> None:
    study = study_gains(GainsOptions(lab, ("kinematic",), 1, 5))
    assert set(study.sets) == set(names())
    assert len(study.scores) == len(names()) * len(SAMPLES) * len(GAIN_SPEEDS)
    again = study_gains(GainsOptions(lab, ("kinematic",), 1, 5), workers=1)
    for a, b in zip(study.scores, again.scores, strict=True):
        assert (a.cost is None) == (b.cost is None)
        if a.cost is not None and b.cost is not None:
            assert abs(a.cost - b.cost) == EXACT
            assert math.isfinite(a.cost)
    document = json.loads(json.dumps(study.as_dict(), allow_nan=False))
    assert len(document["scores"]) == len(study.scores)
    for table in study.grids():
        assert "kinematic" in table.title
        assert sum(cell.best for row in table.groups[0] for cell in row) >= len(SAMPLES)
    assert len(study.figure().axes) >= 2
