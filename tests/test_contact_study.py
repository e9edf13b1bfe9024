"""The study of physics settings: what its measures mean, and that it repeats."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ssmr.scenarios import TRAJECTORIES
from tests.conftest import installed_plant
from tests.robots import SAME_PATH, TRACK
from validation.compare import compare
from validation.experiment.runs import drive_piece
from validation.experiment.sources import open_source
from validation.plants.profile import Profile
from validation.report.report import Report
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import measure_spin, spin_on_spot
from validation.study import contact as study
from validation.study.contact import (
    BASELINE,
    CONTACT_DRIVES,
    CONTACT_MEASURES,
    Setting,
    Trial,
    all_settings,
    balanced_robot,
    chosen_settings,
    creep_speed,
    make_trials,
    rolling_radius,
    study_contact,
)

EVERY = all_settings()
PYRAMIDAL = "cone: pyramidal"
DEFAULT = "impedance: MuJoCo's default"
HOPELESS = "hopeless: no step"
"""A step that the drive's periods are no multiple of."""
FORM_ERROR = 0.01
"""Greatest relative error of the multiplier: wheels that skid are pressed in less than rolling ones
(docs/physics.md)."""


@pytest.fixture(scope="module")
def trials(lab: Profile) -> dict[str, Trial]:
    return make_trials(lab, EVERY)


@pytest.fixture(scope="module")
def small(lab: Profile) -> Report:
    """Four settings, one of which cannot be driven."""
    some = {name: EVERY[name] for name in (BASELINE, PYRAMIDAL, DEFAULT)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            study,
            "chosen_settings",
            lambda *_: {**some, HOPELESS: Setting(SHIPPED, {"timestep": 0.003})},
        )
        return study_contact(profile=lab, workers=2)


def of(small: Report, name: str) -> dict[str, Any]:
    return {
        k: v
        for table in small.tables()
        for row in table.rows
        if row["variant"] == name
        for k, v in row.items()
    }


def measured(trials: dict[str, Trial], name: str) -> dict[str, Any]:
    """Return the measures that every drive finds of a setting."""
    return {"variant": name} | {
        k: v for take in CONTACT_DRIVES.values() for k, v in take(trials[name]).items()
    }


GOOD = {
    "ripple_share": 0.01,
    "lifted_share": 0.005,
    "glide_share": 0.02,
    "wander_m": 0.01,
    "drift_m": 0.001,
    "off_closed_form_share": FORM_ERROR,
    "veer_share": 0.001,
    "creep_m_s": 1e-4,
    "surge_share": 0.02,
    "ground_turned_m": 0.005,
    "step_halved_m": 0.01,
    "to_improved_m": 0.025,
    "to_coulomb_m": 0.035,
    "to_linear_m": 0.025,
}
"""Greatest sizes of measures of a robot that drives as mechanics says [SI]."""


def test_what_is_shipped_is_right_in_everything(small: Report) -> None:
    result = of(small, BASELINE)
    for column, most in GOOD.items():
        assert abs(result[column]) <= most, column


def test_pyramids_know_the_worlds_axes_and_do_not_converge(small: Report) -> None:
    shipped = of(small, BASELINE)
    pyramidal = of(small, PYRAMIDAL)
    # rounding decides on which of its paths the robot ends: 0.36 to 1.2 m
    assert pyramidal["ground_turned_m"] > 0.1
    assert shipped["ground_turned_m"] < SAME_PATH  # a solver's tolerance
    assert pyramidal["step_halved_m"] > 10.0 * shipped["step_halved_m"]
    assert pyramidal["ripple_share"] > 0.3


def test_default_contact_lifts_wheels(small: Report) -> None:
    assert of(small, DEFAULT)["lifted_share"] > 0.2
    assert of(small, BASELINE)["lifted_share"] == 0.0


def test_tyres_roll_with_the_profiles_radius_whatever_the_contact(lab: Profile) -> None:
    """Under a harder contact the same tyre is larger, and only the first drive notices.

    It is larger by what it is pressed in less.
    """
    plant = EVERY[DEFAULT].plant(balanced_robot(lab.plants["mujoco"]))
    excess = rolling_radius(plant)[0] - plant.calibration.wheel_radius
    assert excess / plant.calibration.wheel_radius == pytest.approx(0.5 * 0.0025 / 0.16, rel=0.1)
    again = EVERY[DEFAULT].plant(balanced_robot(lab.plants["mujoco"]), -excess)
    assert rolling_radius(again)[0] == pytest.approx(plant.calibration.wheel_radius, rel=1e-4)


@pytest.mark.parametrize(
    ("changes", "settings", "error"),
    [
        ({"wheel_shape": "capsule", "friction_ratio": 1.24}, PhysicsSettings(), FORM_ERROR),
        ({"com_x": -0.00065, "com_y": -0.085}, PhysicsSettings(), FORM_ERROR),
        ({"com_x": -0.04, "com_y": 0.03}, PhysicsSettings(), FORM_ERROR),
        ({"wheel_shape": "cylinder"}, PhysicsSettings(impratio=10.0), FORM_ERROR),
    ],
)
def test_each_robot_has_its_own_closed_form(
    lab: Profile, changes: dict[str, float | str], settings: PhysicsSettings, error: float
) -> None:
    plant = Setting(settings, changes).plant(balanced_robot(lab.plants["mujoco"]))
    result = measure_spin(spin_on_spot(plant, 20.0), plant.calibration)
    assert result["multiplier"] == pytest.approx(result["multiplier_expected"], rel=error)
    assert abs(result["multiplier_expected"] - 1.0 - (0.512 / TRACK) ** 2) > 0.02
    assert result["ripple"] < 1e-3


def test_the_sideways_drift_is_shown_and_cured(lab: Profile) -> None:
    """Hard pyramids and the maker's centre of mass: a metre off.

    Each cure takes some of it, all of them take it all.
    """
    steps = [
        "maker's centre",
        "also elliptic cone",
        "also soft contact",
        "also centre in the middle",
    ]
    wander = []
    for step in steps:
        plant = EVERY[f"near ODE: {step}"].plant(balanced_robot(lab.plants["mujoco"]))
        wander.append(measure_spin(spin_on_spot(plant, 26.0), plant.calibration)["wander_m"])
    assert wander[0] > 0.8
    assert all(b < 0.8 * a for a, b in pairwise(wander))
    assert wander[-1] < 1e-3


def test_few_asymmetric_iterations_make_a_straight_drive_veer(lab: Profile) -> None:
    veers = [
        abs(
            rolling_radius(EVERY[f"solver: PGS, {n}"].plant(balanced_robot(lab.plants["mujoco"])))[
                1
            ]
        )
        for n in ("1 sweep", "50 sweeps")
    ]
    assert veers[0] > 1e-3
    assert veers[1] < 1e-4


def test_creep_falls_as_one_over_impratio(lab: Profile) -> None:
    rows = []
    for ratio in (1.0, 10.0):
        plant = Setting(PhysicsSettings(impratio=ratio), {}).plant(
            balanced_robot(lab.plants["mujoco"])
        )
        assert isinstance(plant, MujocoPlant)
        gravity = np.array(plant.model.opt.gravity)
        rows.append(creep_speed(plant))
        assert np.array_equal(plant.model.opt.gravity, gravity)
    assert rows[0] / rows[1] == pytest.approx(10.0, rel=0.02)


def test_what_cannot_be_driven_says_why(small: Report) -> None:
    document = small.as_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert (document["schema"], document["study"]) == ("ssmr.study.contact/2", "contact")
    assert set(document["tables"]) == set(CONTACT_MEASURES)
    assert all(
        note.startswith("hopeless: no step: ") and "0.003" in note for note in document["notes"]
    )
    assert any("0.003" in line for line in small.to_markdown().splitlines())
    assert of(small, HOPELESS) == {"variant": HOPELESS}
    columns = {column for some in CONTACT_MEASURES.values() for column in some}
    for name in (BASELINE, PYRAMIDAL, DEFAULT):
        assert columns <= set(of(small, name))


def test_a_study_repeats_alone_or_beside_others(small: Report, trials: dict[str, Trial]) -> None:
    assert measured(trials, PYRAMIDAL) == of(small, PYRAMIDAL)


def test_d_rms_is_the_comparisons(small: Report, lab: Profile) -> None:
    """The study and compare drive the same robot, so they find the same distance."""
    profile = replace(lab, plants={**lab.plants, "mujoco": balanced_robot(lab.section("mujoco"))})
    distances = []
    for name in TRAJECTORIES:
        compared = compare(name, profile, ("mujoco",), "improved")
        distances.append(compared.scores["mujoco"].metrics["d_rms_m"])
    assert of(small, BASELINE)["to_improved_m"] == pytest.approx(np.mean(distances), abs=2e-4)


def test_every_setting_can_be_made(lab: Profile) -> None:
    assert list(chosen_settings(["time step"])) == [BASELINE, "time step: 5 ms"]
    for name, setting in chosen_settings(()).items():
        assert isinstance(setting.plant(balanced_robot(lab.plants["mujoco"])), MujocoPlant)
        assert setting.robot or setting.physics != SHIPPED or name == BASELINE


@pytest.mark.slow  # four simulations of 8 s
def test_gazebo_s_husky_does_not_come_round_and_a_cone_with_the_centre_in_the_middle_does(
    lab: Profile, trials: dict[str, Trial]
) -> None:
    """The maker's centre of mass alone makes the middle circle a point.

    That the robot sticks is friction's law.
    """
    installed_plant(lab, "ode")
    gazebo, cone, cured, best = (
        trials[f"ode: {name}"].spot()
        for name in (
            "Gazebo's Husky",
            "Gazebo's Husky, emulated cone",
            "Gazebo's Husky, emulated cone, centred",
            "best, emulated cone, exact solver",
        )
    )
    assert gazebo["multiplier"] is None
    assert cone["wander_m"] == pytest.approx(0.314, abs=0.02)
    for right in (cured, best):
        assert right["wander_m"] < 1e-3
        assert abs(right["off_closed_form_share"]) < FORM_ERROR


@pytest.mark.slow
def test_hard_contact_and_the_quick_solver_do_not_converge_where_the_turn_is_right(
    lab: Profile,
) -> None:
    """Half the step moves the end of trajectory 4; a soft contact and the exact solver hold it."""
    installed_plant(lab, "ode")
    piece = open_source("traj4").pieces[0]
    section = lab.section("mujoco")
    moved = []
    for name in (
        "ode: Gazebo's Husky, emulated cone, centred",
        "ode: best, emulated cone, exact solver",
    ):
        plants = [EVERY[name].plant(section, steps=steps) for steps in (1.0, 2.0)]
        ends = [drive_piece(plant, piece, section.localiser, 0.01).xy[-1] for plant in plants]
        moved.append(float(np.hypot(*(ends[1] - ends[0]))))
    assert moved[0] > 0.005 > 0.001 > moved[1]
