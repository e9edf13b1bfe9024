"""The study of terrain: what it varies, that errors grow with it, and what it writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.test_robustness import run_program
from validation import store
from validation.plants.profile import Profile
from validation.study.terrain import run as study
from validation.study.terrain.figure import draw_terrain
from validation.study.terrain.run import AXES, PLANAR, Followed, TerrainSettings, TerrainStudy

SMALL = TerrainSettings(
    speeds=(0.5,), slopes=(0.0, math.radians(3.0), math.radians(6.0)), heights=(0.0, 0.004), lost=(0.0,),
    directions=(0.0,), seeds=1, controllers=(),
)  # fmt: skip


@pytest.fixture(scope="module")
def small(lab: Profile) -> TerrainStudy:
    return study.study_terrain(lab, SMALL, workers=2)


def test_it_does_not_depend_on_the_workers(lab: Profile, small: TerrainStudy) -> None:
    alone = study.study_terrain(lab, SMALL, workers=1)
    assert alone.points == small.points


def test_every_axis_begins_where_the_thesis_is(small: TerrainStudy) -> None:
    for plant in PLANAR:
        first = [small.line(axis, plant)[0] for axis in AXES]
        assert len({p.position_m for p in first}) == 1
        assert len({p.d_rms_m for p in first}) == 1


def test_errors_grow_with_the_slope_as_the_drift_does(small: TerrainStudy) -> None:
    """A robot that turns on a slope slides in proportion to the slope; roughness only adds."""
    level, low, high = (p.position_m for p in small.line("slope", "improved"))
    assert level is not None
    assert low is not None
    assert high is not None
    assert (high - level) / (low - level) == pytest.approx(2.0, rel=0.25)
    rough = small.line("roughness", "improved")
    assert (rough[1].position_m or 0.0) > 2.0 * (rough[0].position_m or 0.0)


def test_where_an_error_doubles_is_between_the_values_around_it(small: TerrainStudy) -> None:
    at = study.doubled_at(small, "slope", "improved")
    assert at is not None
    assert 0.0 < at < math.radians(3.0)
    assert study.doubled_at(small, "speed", "improved") is None
    assert study.doubled_at(small, "friction", "improved") is None


def test_quasi_static_loads_explain_a_ramp_better_than_static_ones(small: TerrainStudy) -> None:
    for ride in small.rides:
        _, static, quasi = study.load_errors(ride, small.static)
        assert quasi < (0.7 if ride.terrain.kind == "flat" else 0.5) * static


def test_a_husky_that_does_not_come_through_is_counted_not_averaged(lab: Profile, small: TerrainStudy) -> None:
    motion = small.rides[0].motion
    (point,) = study._points("slope", 0.1, [None, None], {"improved": [motion]}, SMALL)
    assert (point.position_m, point.failed) == (None, 2)
    (point,) = study._points("slope", 0.1, [motion, None], {"improved": [motion, motion]}, SMALL)
    assert (point.position_m, point.failed) == (0.0, 1)


def test_it_is_drawn_and_written_without_gaps(small: TerrainStudy) -> None:
    lost = replace(small, followed=(Followed("slope", 0.0, "lqr", 0.03, 0), Followed("slope", 0.1, "lqr", None, 2)))
    for found in (small, lost):
        figure = draw_terrain(found)
        drawn = {line.get_gid() for ax in figure.axes for line in ax.lines}
        assert set(PLANAR) <= drawn
        document = study.as_document(found)
        json.dumps(document, allow_nan=False)
        assert document["schema"] == study.SCHEMA
        assert any("roughness" in line for line in study.markdown(found))


@pytest.mark.parametrize(
    ("values", "words"), [({"seeds": 0}, "seeds"), ({"horizon": 30.0}, "20 s"), ({"slopes": ()}, "slope")]
)
def test_settings_are_checked(values: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TerrainSettings(**values)  # type: ignore[arg-type]


def test_the_program_refuses_before_it_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_program("terrain", "--horizon", "30", "--out", str(tmp_path / "x")) == 2
    assert "20 s" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_the_manoeuvre_has_no_jolts() -> None:
    values = study.manoeuvre().values
    assert np.abs(np.diff(values[:, 1])).max() < 0.05
    assert store.plain(values.max()) == 0.8
