"""The study of terrain: what it varies, that errors grow with it, and what it writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import State
from validation.plants.profile import Profile, make_plant
from validation.report.report import Report
from validation.study.terrain import AXES, PLANAR, AxisName, TerrainStudy, doubled_at, model_errors, study_terrain

SMALL: dict[str, Any] = {
    "speed": (0.5,), "slope": tuple(math.radians(degrees) for degrees in (0.0, 2.0, 4.0, 6.0)),
    "directions": (0.0,), "controllers": (),
}  # fmt: skip


@pytest.fixture(scope="module")
def small(lab: Profile) -> Report:
    return study_terrain(profile=lab, workers=2, **SMALL)


def line(study: Report, axis: AxisName) -> list[float]:
    """The improved model's position errors along an axis [m]."""
    return [row["improved_m"] for row in study.tables[list(AXES).index(axis)].rows]


def test_it_does_not_depend_on_the_workers(lab: Profile, small: Report) -> None:
    alone = study_terrain(profile=lab, workers=1, **SMALL)
    assert [table.rows for table in alone.tables] == [table.rows for table in small.tables]


def test_every_axis_begins_where_the_thesis_is(small: Report) -> None:
    firsts = [small.tables[k].rows[0] for k in range(len(AXES))]
    for plant in PLANAR:
        assert len({(row[f"{plant}_m"], row[f"{plant}_yaw_rad"]) for row in firsts}) == 1


def test_errors_grow_with_the_slope_as_the_drift_does(small: Report) -> None:
    """A robot that turns on a slope slides in proportion to the slope, beside which the error on level ground is lost."""
    level, *steep = line(small, "slope")
    assert np.diff(steep, 2) == pytest.approx(0.0, abs=0.15 * level)
    assert steep[-1] > 5.0 * level


def test_where_an_error_doubles_is_between_the_values_around_it(small: Report) -> None:
    found = small.as_dict()["doubled_at"]["improved"]
    assert 0.0 < found["slope"] < math.radians(3.0)
    assert found["speed"] is None
    rows = [{"value": value, "improved_m": error} for value, error in ((0.0, 1.0), (1.0, 1.5), (2.0, 2.5))]
    assert doubled_at("slope", "improved", rows) == pytest.approx(1.5)


def test_a_husky_that_does_not_come_through_is_counted_not_averaged(lab: Profile) -> None:
    motion = make_plant(lab, "improved").run(TRAJECTORIES["traj4"].commands(), State(), 0.01)
    found = model_errors([None, None], {"improved": [motion]}, 6.0)
    assert (found["improved_m"], found["failed"]) == (None, 2)
    found = model_errors([motion, None], {"improved": [motion, motion]}, 6.0)
    assert (found["improved_m"], found["failed"]) == (0.0, 1)


def test_it_is_drawn_and_written_without_gaps(small: Report) -> None:
    tracked = [
        replace(t, rows=[{**r, "lqr_tracks_m": None if r["value"] else 0.03, "lqr_lost": 2} for r in t.rows])
        for t in small.tables[: len(AXES)]
    ]
    lost = replace(small, tables=[*tracked, *small.tables[len(AXES) :]])
    for found in (small, lost):
        drawn = {line.get_gid() for ax in found.figure().axes for line in ax.lines}
        assert set(PLANAR) <= drawn
        document = found.as_dict()
        json.dumps(document, allow_nan=False)
        assert document["schema"] == "ssmr.study/1"


def test_options_are_checked() -> None:
    with pytest.raises(ValueError, match="20 s"):
        TerrainStudy(horizon=30.0)
