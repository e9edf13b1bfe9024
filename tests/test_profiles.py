"""Profiles: shipped ones load and say where they are from.

Bad ones are refused by file, section and key.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssmr.types import Commands, State
from validation.compare import compare
from validation.descriptions.loading import load_robot
from validation.experiment.sources import Piece
from validation.plants.kind import OneByOne
from validation.plants.profile import (
    PLANTS,
    Pace,
    bare_profile,
    load_profile,
    make_plant,
    shipped_profiles,
)
from validation.simulator.physics import SHIPPED

HEAD = 'schema = "ssmr.profile/1"\nname = "mine"\n'


@pytest.mark.parametrize("name", shipped_profiles())
def test_a_shipped_profile_loads_drives_and_has_provenance(name: str) -> None:
    profile = load_profile(name)
    assert profile.name == name
    assert profile.description
    assert set(profile.plants) == set(PLANTS)
    for plant in PLANTS:
        make_plant(profile, plant)
        assert profile.provenance[plant]["source"]
    assert profile.fitted_at is not None


def test_the_lab_profile_has_the_published_models() -> None:
    lab = load_profile("thesis-lab")
    empty = type(load_profile("thesis-lab").plants["improved"].parameters)()
    assert lab.plants["improved"].parameters == empty


def test_a_plant_s_origin_is_told_where_the_scenario_s_distance_is_known(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        HEAD
        + "[provenance]\nlinear = 'a book'\n"
        + "[provenance.coulomb]\nd_rms_m = 0.1\n"
        + "[provenance.improved]\nsource = 'log'\nd_rms_m = {traj1 = 0.002, traj2 = 'far'}\n"
    )
    profile = load_profile(str(path))
    told = ["improved was fitted to log; its d_rms from there: 2.0 mm on traj1."]
    plants = ("mujoco", "linear", "coulomb", "improved")
    assert profile.origins(plants, "traj1") == told
    assert profile.origins(plants, "traj3") == []


def test_what_a_plant_says_overrides_what_all_have(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        HEAD
        + "[vehicle]\nmass = 50\n[drive]\ndelay_v = 0.1\nacceleration_v = inf\n"
        + "[plants.improved.localiser]\ntracked_x = 0.1\ntracked_y = -0.2\n"
        + "[plants.improved.drive]\ndelay_v = 0.3\n"
    )
    profile = load_profile(str(path))
    assert profile.plants["coulomb"].drive.delay_v == 0.1
    assert profile.plants["improved"].drive.delay_v == 0.3
    assert profile.plants["improved"].vehicle.mass == 50.0
    assert profile.plants["improved"].localiser.point == (0.1, -0.2)
    assert math.isinf(profile.plants["coulomb"].drive.acceleration_v)
    assert profile.as_dict()["coulomb"]["drive"]["acceleration_v"] is None  # JSON has no infinity


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("name = 'x'", "schema is None, wanted 'ssmr.profile/1'"),
        (HEAD + "[vehicel]\n", "the top level has unknown keys vehicel; there are: .*vehicle"),
        (HEAD + "[plants.gazebo]\n", "plants has unknown keys gazebo; there are: .*mujoco"),
        (
            HEAD + "[plants.improved.parameters]\nmu = 1\n",
            r"plants.improved.parameters has unknown keys mu; there are: gain, mu_d",
        ),
        (HEAD + "[drive]\ndelay_v = 'long'\n", "drive.delay_v is 'long', wanted a number"),
        (HEAD + "[drive]\ndelay_v = -1\n", r"\[drive\] Drive.delay_v = -1.0 lies outside"),
        (HEAD + "[drive]\ndelay_v = true\n", "wanted a number"),
        (
            HEAD + "[plants.mujoco.parameters]\nwheel_shape = 'box'\n",
            "unknown wheel shape 'box'; there are: ellipsoid",
        ),
        (HEAD + "plants = 3\n", "plants is 3, wanted a table"),
        (HEAD + "[plants.mujoco.bands]\nwheels = 3\n", "bands.wheels is 3, wanted a table"),
        (HEAD + "[plants.mujoco.bands.wheels]\nyaw_noise = 0\n", "Band.yaw_noise = 0.0 lies"),
        ("this is no TOML", "profile .*mine.toml"),
    ],
)
def test_a_bad_profile_is_refused(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(match=what):
        load_profile(str(path))


def test_bands_of_an_earlier_version_are_none(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    old = "way_walk = 0.02\nbend_walk = 0.01\nbend_scale = 0.002\nreach_yaw = 2.0\n"
    path.write_text(HEAD + "[plants.mujoco.bands.wheels]\n" + old)
    assert not load_profile(str(path)).plants["mujoco"].bands


def test_an_unknown_profile_or_plant_lists_the_known() -> None:
    with pytest.raises(match=r"no profile 'nosuch'; there are: .*thesis-lab"):
        load_profile("nosuch")
    with pytest.raises(match="unknown plant 'gazebo'; there are: mujoco"):
        make_plant(load_profile("thesis-lab"), "gazebo")


def test_a_saved_profile_loads_again(tmp_path: Path) -> None:
    lab = load_profile("thesis-lab")
    again = load_profile(lab.save(tmp_path / "mine.toml"))
    assert again.plants == lab.plants
    assert (again.provenance, again.fitted_at) == (lab.provenance, lab.fitted_at)


def test_what_is_clearly_faster_than_the_fit_is_told_with_both_numbers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    on = np.arange(100) < 50
    pace = Pace.of(2.0 * on, -0.5 * on)
    assert (pace.speed, pace.lateral_acceleration) == (2.0, 1.0)
    lab = load_profile("thesis-lab")
    assert replace(lab, fitted_at=Pace(1.05, 1.0)).too_fast(pace, "it") == []
    (message,) = replace(lab, fitted_at=Pace(0.9, 1.0)).too_fast(pace, "it")
    assert re.search(r"2 m/s .* 0\.9 m/s", message)
    comparison = compare("husky", replace(lab, fitted_at=Pace(0.1, 0.1)), plants=("kinematic",))
    assert "fitted at 0.1 m/s" in comparison.notes()[0]
    assert comparison.notes()[0] in capsys.readouterr().err


def test_numbers_that_do_not_go_together_are_the_profiles_and_a_fault_of_code_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A compiled call that fails can raise a ValueError too.

    Blaming the profile would hide its cause.
    """
    profile = bare_profile(load_robot("husky"))
    mujoco = profile.section("mujoco")
    heavy = replace(mujoco, parameters=replace(mujoco.parameters, yaw_inertia=1e4))
    with pytest.raises(match="plant mujoco: yaw_inertia 10000 kg m2"):
        make_plant(replace(profile, plants={"mujoco": heavy}), "mujoco")

    def fail(*given: object) -> None:
        raise ValueError("signal only works in main thread of the main interpreter")

    monkeypatch.setattr("validation.plants.planar.PlanarPlant", fail)
    with pytest.raises(ValueError, match="signal only works") as caught:
        make_plant(profile, "kinematic")
    assert type(caught.value) is ValueError
    piece = Piece(Commands(0.05, np.zeros((1, 2))), State(), None, None)
    with pytest.raises(ValueError, match="signal only works"):
        OneByOne(fail, [mujoco], SHIPPED).motions([0], piece, 0.05)
