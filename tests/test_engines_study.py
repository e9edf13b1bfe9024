"""The study of engines: its measures against closed forms, engines that are missing, and its files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import installed_plant
from validation.engines.body import EngineMissingError
from validation.motion.driving import drive
from validation.motion.sources import open_source
from validation.plants.profile import Profile, make_plant
from validation.plants.table import SECOND_OPINIONS
from validation.study.engines import EnginesOptions, EnginesStudy, bench, study_engines
from validation.study.engines.bench import EngineBench
from validation.study.engines.run import try_engines
from validation.study.engines.variants import ENGINE_VARIANTS, ENGINES, EngineVariant, chosen_engines

NAMES = {v.key: v for v in ENGINE_VARIANTS}
SHIPPED, BEST = NAMES["mujoco: as shipped"], NAMES["ode: best: emulated cone, exact solver"]


@pytest.fixture
def short(lab: Profile, monkeypatch: pytest.MonkeyPatch) -> EngineBench:
    """A bench whose turns are short, with the first six seconds of trajectory 4 for the two trajectories that it has."""
    monkeypatch.setattr(bench, "_SPIN_TIME", 6.0)
    monkeypatch.setattr(bench, "SCENARIOS", names := ("traj3", "traj4"))
    whole = open_source("traj4").pieces[0]
    piece = replace(whole, commands=replace(whole.commands, values=whole.commands.values[:120]))
    improved = drive(make_plant(lab, "improved"), piece, lab.plants["improved"].localiser, 0.01)
    return EngineBench(lab, dict.fromkeys(names, improved), dict.fromkeys(names, piece))


def measured(short: EngineBench, *variants: EngineVariant) -> EnginesStudy:
    for v in variants:
        if v.group in SECOND_OPINIONS:
            installed_plant(short.lab, v.group)
    return try_engines(short, variants)


def test_measures_of_the_shipped_robot_are_those_of_the_closed_forms(short: EngineBench) -> None:
    (tried,) = measured(short, SHIPPED).tried
    m = tried.measures
    assert m.multiplier == pytest.approx(m.multiplier_expected, rel=1e-2)
    assert m.multiplier_expected == pytest.approx(1.8046, abs=1e-4)
    assert (m.wander_m, m.wander_expected_m) == (pytest.approx(0.0, abs=1e-4), pytest.approx(0.0, abs=1e-6))
    assert m.slide_ratio == pytest.approx(1.0, abs=0.05)
    assert abs(m.slide_aside_rad or 0.0) < 0.02
    assert abs(m.energy_error or 0.0) < 0.03
    assert (m.lifted_share, m.gave_up_share) == (0.0, 0.0)
    assert (m.creep_m_s or 0.0) < 5e-4
    assert not tried.failures


def test_ode_with_the_best_settings_is_as_good(short: EngineBench) -> None:
    (tried,) = measured(short, BEST).tried
    m = tried.measures
    assert m.multiplier == pytest.approx(m.multiplier_expected, rel=5e-3)
    assert (m.multiplier_high or 9.9) - (m.multiplier_low or 0.0) < 5e-3
    assert m.slide_ratio == pytest.approx(1.0, abs=0.02)
    assert abs(m.energy_error or 0.0) < 0.02
    assert m.gave_up_share == 0.0
    assert (m.creep_m_s or 0.0) < 1e-5
    assert np.mean(list(m.d_rms_m.values())) < 0.03


def test_gazebo_s_husky_wanders_and_a_cone_with_the_centre_in_the_middle_does_not(short: EngineBench) -> None:
    """The maker's centre of mass alone makes the middle circle a point; the rest of the wandering is friction's law."""
    found = measured(short, NAMES["ode: Gazebo's Husky"], NAMES["ode: Gazebo's Husky, emulated cone, centred"]).tried
    gazebo, cured = (t.measures for t in found)
    assert (gazebo.wander_m or 0.0) > (gazebo.wander_expected_m or 9.9)
    assert (gazebo.multiplier_high or 0.0) > 1.5 * (gazebo.multiplier_low or 9.9)
    assert (cured.wander_m or 9.9) < 1e-3
    assert cured.multiplier == pytest.approx(cured.multiplier_expected, rel=5e-3)


def test_a_missing_engine_is_left_out_and_said(short: EngineBench, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(self: EngineVariant, *numbers: object, **more: object) -> None:
        raise EngineMissingError("ODE is missing: fetch it")

    whole = EngineVariant.plant
    monkeypatch.setattr(EngineVariant, "plant", lambda v, *a, **k: (missing if v.group == "ode" else whole)(v, *a, **k))
    study = try_engines(short, (SHIPPED, BEST))
    assert [t.variant.key for t in study.tried] == [SHIPPED.key]
    assert "ODE is missing: fetch it." in study.notes()
    with pytest.raises(EngineMissingError, match="fetch it"):
        try_engines(short, (BEST,))


def test_its_files_hold_settings_and_measures_and_the_picture_has_a_line_for_each_variant(
    short: EngineBench, tmp_path: Path
) -> None:
    study = measured(short, SHIPPED, NAMES["mujoco: its own defaults"])
    study.save(tmp_path)
    document = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert (document["schema"], document["status"]) == ("ssmr.study.engines/1", "finished")
    first, second = document["variants"]
    assert second["settings"]["cone"] == "pyramidal"
    assert first["timestep_s"] == short.lab.plants["mujoco"].parameters.timestep
    assert len(first["multiplier_by_heading"]) == bench.BINS
    assert "| as shipped |" in (tmp_path / "study.md").read_text(encoding="utf-8")
    names = {line.get_gid() for ax in study.figure().axes for line in ax.get_lines()}
    assert {f"heading {t.variant.key}" for t in study.tried} <= names


def test_a_robot_that_never_turns_has_no_multiplier_by_heading(short: EngineBench) -> None:
    (tried,) = measured(short, NAMES["ode: Gazebo's Husky, square along the chassis"]).tried
    assert np.isnan(tried.by_heading).any()
    assert tried.measures.wander_m is not None
    assert tried.measures.wander_m > 1.0  # it drives straight at the rim speed of its heavier side


def test_options_are_checked() -> None:
    assert {v.group for v in chosen_engines(())} == set(ENGINES)
    assert {v.group for v in chosen_engines(("drake",))} == {"drake"}
    with pytest.raises(ValueError, match="unknown engine 'bullet' in engines; there are: mujoco, ode, drake"):
        EnginesOptions(("bullet",))
    with pytest.raises(ValueError, match="name one as recording"):
        EnginesOptions(start=500.0)
    with pytest.raises(ValueError, match="is a scenario"):
        study_engines(EnginesOptions(("mujoco",), recording="traj1"))
    assert len({v.key for v in ENGINE_VARIANTS}) == len(ENGINE_VARIANTS)
