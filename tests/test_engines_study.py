"""The study of engines: its measures against closed forms, engines that are missing, and its files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import installed_plant
from validation.bench.sources import drive, open_source
from validation.engines.body import EngineMissingError
from validation.plants.profile import Profile, make_plant
from validation.plants.table import SECOND_OPINIONS
from validation.progress import silent
from validation.report.report import Report
from validation.study import engines as study
from validation.study.engines import (
    ENGINE_SETTINGS,
    ENGINES,
    EngineBench,
    EngineSetting,
    EnginesStudy,
    chosen_engines,
    study_engines,
    try_engines,
)

SHIPPED, BEST = "mujoco: as shipped", "ode: best, emulated cone, exact solver"


@pytest.fixture
def short(lab: Profile, monkeypatch: pytest.MonkeyPatch) -> EngineBench:
    """A bench whose turns are short, with the first six seconds of trajectory 4 for the two trajectories that it has."""
    monkeypatch.setattr(study, "_SPIN_TIME", 6.0)
    whole = open_source("traj4").pieces[0]
    piece = replace(whole, commands=replace(whole.commands, values=whole.commands.values[:120]))
    improved = drive(make_plant(lab, "improved"), piece, lab.plants["improved"].localiser, 0.01)
    return EngineBench(lab, dict.fromkeys(("traj3", "traj4"), improved), dict.fromkeys(("traj3", "traj4"), piece))


def tried(short: EngineBench, *names: str) -> Report:
    for name in names:
        if (engine := name.partition(":")[0]) in SECOND_OPINIONS:
            installed_plant(short.lab, engine)
    return try_engines(short, {name: ENGINE_SETTINGS[name] for name in names}, silent)


def measured(found: Report, name: str) -> dict[str, Any]:
    return {k: v for table in found.tables for row in table.rows if row["variant"] == name for k, v in row.items()}


def test_measures_of_the_shipped_robot_are_those_of_the_closed_forms(short: EngineBench) -> None:
    found = tried(short, SHIPPED)
    m = measured(found, SHIPPED)
    assert m["multiplier"] == pytest.approx(m["cone"], rel=1e-2)
    assert m["cone"] == pytest.approx(1.8046, abs=1e-4)
    assert (m["wander_m"], m["cone's_wander_m"]) == (pytest.approx(0.0, abs=1e-4), pytest.approx(0.0, abs=1e-6))
    assert m["slide"] == pytest.approx(1.0, abs=0.05)
    assert (m["lifted_share"], m["gave_up_share"]) == (0.0, 0.0)
    assert m["creep_m_s"] < 5e-4
    assert len(found.sentences) == 2  # what holds of every study: no Gazebo, no cone of ODE's own


def test_ode_with_the_best_settings_is_as_good(short: EngineBench) -> None:
    m = measured(tried(short, BEST), BEST)
    assert m["multiplier"] == pytest.approx(m["cone"], rel=5e-3)
    assert m["most"] - m["least"] < 5e-3
    assert m["slide"] == pytest.approx(1.0, abs=0.02)
    assert m["gave_up_share"] == 0.0
    assert m["creep_m_s"] < 1e-5
    assert np.mean([m["traj3_m"], m["traj4_m"]]) < 0.03


def test_gazebo_s_husky_wanders_and_a_cone_with_the_centre_in_the_middle_does_not(short: EngineBench) -> None:
    """The maker's centre of mass alone makes the middle circle a point; the rest of the wandering is friction's law."""
    names = ("ode: Gazebo's Husky", "ode: Gazebo's Husky, emulated cone, centred")
    found = tried(short, *names)
    gazebo, cured = (measured(found, name) for name in names)
    assert gazebo["wander_m"] > gazebo["cone's_wander_m"]
    assert gazebo["most"] > 1.5 * gazebo["least"]
    assert cured["wander_m"] < 1e-3
    assert cured["multiplier"] == pytest.approx(cured["cone"], rel=5e-3)


def test_a_missing_engine_is_left_out_and_said(short: EngineBench, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(self: EngineSetting, *numbers: object, **more: object) -> None:
        raise EngineMissingError("ODE is missing: fetch it")

    whole, some = EngineSetting.plant, {name: ENGINE_SETTINGS[name] for name in (SHIPPED, BEST)}
    monkeypatch.setattr(EngineSetting, "plant", lambda v, *a, **k: (missing if v.engine == "ode" else whole)(v, *a, **k))
    found = try_engines(short, some, silent)
    assert [row["variant"] for row in found.tables[0].rows] == [SHIPPED]
    assert "ODE is missing: fetch it." in found.notes()
    with pytest.raises(EngineMissingError, match="fetch it"):
        try_engines(short, {BEST: some[BEST]}, silent)


def test_its_files_hold_settings_and_measures_and_the_picture_has_a_line_for_each_setting(
    short: EngineBench, tmp_path: Path
) -> None:
    found = tried(short, SHIPPED, "mujoco: its own defaults")
    found.save(tmp_path)
    document = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert (document["schema"], document["status"]) == ("ssmr.study.engines/2", "finished")
    assert document["changes"]["mujoco: its own defaults"]["cone"] == "pyramidal"
    names = [SHIPPED, "mujoco: its own defaults"]
    assert [row["variant"] for rows in document["tables"].values() for row in rows] == 2 * names
    assert "| mujoco: as shipped |" in (tmp_path / "study.md").read_text(encoding="utf-8")
    every = {name: np.full(study.BINS, np.nan) for name in ENGINE_SETTINGS}
    lines = [line for ax in study._draw(every, found).axes for line in ax.get_lines()]
    assert [line.get_gid() for line in lines] == list(every)
    looks = {(str(line.get_color()), str(line.get_linestyle()), str(line._dash_pattern)) for line in lines}
    assert len(looks) == len(lines)


def test_options_are_checked() -> None:
    assert {v.engine for v in chosen_engines(()).values()} == set(ENGINES)
    assert {v.engine for v in chosen_engines(("drake",)).values()} == {"drake"}
    with pytest.raises(ValueError, match="unknown engine 'bullet' in engines; there are: mujoco, ode, drake"):
        EnginesStudy(engines=("bullet",))
    with pytest.raises(ValueError, match="name one as recording"):
        EnginesStudy(start=500.0)
    with pytest.raises(ValueError, match="is a scenario"):
        study_engines(engines=("mujoco",), recording="traj1")
