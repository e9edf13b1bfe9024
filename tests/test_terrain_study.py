"""The study of terrain: what it varies, that errors grow with it, and what it writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from validation import store
from validation.plants.profile import Profile
from validation.study.terrain import TerrainAxes, TerrainOptions, TerrainStudy, study_terrain
from validation.study.terrain.findings import AXES, PLANAR, TrackerErrors
from validation.study.terrain.run import manoeuvre, model_errors

FEW = TerrainAxes(
    speeds=(0.5,), slopes=tuple(math.radians(degrees) for degrees in (0.0, 2.0, 4.0, 6.0)), heights=(0.0, 0.004),
    lost=(0.0,), directions=(0.0,), controllers=(),
)  # fmt: skip
SMALL = TerrainOptions(seeds=1, axes=FEW)


@pytest.fixture(scope="module")
def small(lab: Profile) -> TerrainStudy:
    return study_terrain(replace(SMALL, profile=lab), workers=2)


def test_it_does_not_depend_on_the_workers(lab: Profile, small: TerrainStudy) -> None:
    alone = study_terrain(replace(SMALL, profile=lab), workers=1)
    assert alone.models == small.models


def test_every_axis_begins_where_the_thesis_is(small: TerrainStudy) -> None:
    for plant in PLANAR:
        first = [small.line(axis, plant)[0] for axis in AXES]
        assert len({p.position_m for p in first}) == 1
        assert len({p.d_rms_m for p in first}) == 1


def test_errors_grow_with_the_slope_as_the_drift_does(small: TerrainStudy) -> None:
    """A robot that turns on a slope slides in proportion to the slope, beside which the error on level ground is lost."""
    level, *steep = (p.position_m or math.nan for p in small.line("slope", "improved"))
    assert np.diff(steep, 2) == pytest.approx(0.0, abs=0.15 * level)
    assert steep[-1] > 5.0 * level
    rough = small.line("roughness", "improved")
    assert (rough[1].position_m or 0.0) > 2.0 * (rough[0].position_m or 0.0)


def test_where_an_error_doubles_is_between_the_values_around_it(small: TerrainStudy) -> None:
    at = small.doubled_at("slope", "improved")
    assert at is not None
    assert 0.0 < at < math.radians(3.0)
    assert small.doubled_at("speed", "improved") is None
    assert small.doubled_at("friction", "improved") is None


def test_quasi_static_loads_explain_a_ramp_better_than_static_ones(small: TerrainStudy) -> None:
    for run in small.loads:
        _, static, quasi = run.errors(small.static)
        assert quasi < (0.7 if run.terrain.kind == "flat" else 0.5) * static


def test_a_husky_that_does_not_come_through_is_counted_not_averaged(small: TerrainStudy) -> None:
    motion = small.loads[0].motion
    (point,) = model_errors("slope", 0.1, [None, None], {"improved": [motion]}, 6.0)
    assert (point.position_m, point.failed) == (None, 2)
    (point,) = model_errors("slope", 0.1, [motion, None], {"improved": [motion, motion]}, 6.0)
    assert (point.position_m, point.failed) == (0.0, 1)


def test_it_is_drawn_and_written_without_gaps(small: TerrainStudy) -> None:
    lost = replace(
        small, trackers=(TrackerErrors("slope", 0.0, "lqr", 0.03, 0), TrackerErrors("slope", 0.1, "lqr", None, 2))
    )
    for found in (small, lost):
        figure = found.figure()
        drawn = {line.get_gid() for ax in figure.axes for line in ax.lines}
        assert set(PLANAR) <= drawn
        document = found.as_dict()
        json.dumps(document, allow_nan=False)
        assert document["schema"] == "ssmr.study/1"
        assert any("roughness" in line for line in found.report())


@pytest.mark.parametrize(("values", "words"), [({"seeds": 0}, "seeds"), ({"horizon": 30.0}, "20 s")])
def test_options_are_checked(values: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TerrainOptions(**values)  # type: ignore[arg-type]


def test_every_axis_needs_values() -> None:
    with pytest.raises(ValueError, match="slope"):
        TerrainAxes(slopes=())


def test_the_manoeuvre_has_no_jolts() -> None:
    values = manoeuvre().values
    assert np.abs(np.diff(values[:, 1])).max() < 0.05
    assert store.plain(values.max()) == 0.8
