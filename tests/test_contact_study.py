"""The study of physics settings: what its measures mean, and that it repeats."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ssmr.robot.skid_turn import turn_on_the_spot
from ssmr.types import Commands, State
from tests.robots import SAME_PATH, TRACK, WHEELBASE
from tests.test_robustness import run_program
from validation.logs.recording import Recording
from validation.motion.driving import drive
from validation.motion.sources import Piece, source_of
from validation.plants.profile import Profile
from validation.simulator.calibration import Calibration
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SPIN_LEAD
from validation.study.contact import ContactStudy
from validation.study.contact import bench as bench_module
from validation.study.contact.bench import Bench, Measures, make_bench, make_variant
from validation.study.contact.figure import badness
from validation.study.contact.result import MEASURE_COLUMNS
from validation.study.contact.run import try_variants
from validation.study.contact.variants import BASELINE, PhysicsVariant, chosen_variants, physics_variants

BY_KEY = {v.key: v for v in physics_variants()}
PYRAMIDAL = BY_KEY["cone: pyramidal"]
DEFAULT = BY_KEY["solimp: MuJoCo's default"]
HOPELESS = PhysicsVariant("hopeless", "no step", changes={"timestep": 0.003})
"""A step that the drive's periods are no multiple of."""
FORM_ERROR = 0.01
"""Of the multiplier: wheels that skid are pressed in less than those that roll (docs/physics.md)."""


@pytest.fixture(scope="module")
def bench(lab: Profile) -> Bench:
    return make_bench(lab)


@pytest.fixture(scope="module")
def small(bench: Bench) -> ContactStudy:
    return try_variants(bench, [BASELINE, PYRAMIDAL, DEFAULT, HOPELESS], workers=2, timed=False)


def of(small: ContactStudy, variant: PhysicsVariant) -> Measures:
    return next(o.measures for o in small.tried if o.variant == variant)


def known(value: float | None) -> float:
    assert value is not None
    return value


def test_what_is_shipped_is_right_in_everything(small: ContactStudy) -> None:
    for column in MEASURE_COLUMNS:
        bad = badness(column, column.value(of(small, BASELINE)))
        assert bad is None or bad == 0.0, column.name
    assert abs(known(of(small, BASELINE).multiplier_error)) < FORM_ERROR


def test_pyramids_know_the_worlds_axes_and_do_not_converge(small: ContactStudy) -> None:
    shipped, pyramidal = of(small, BASELINE), of(small, PYRAMIDAL)
    assert known(pyramidal.turned_ground_m) > 0.1  # rounding decides on which of its paths the robot ends: 0.36 to 1.2 m
    assert known(shipped.turned_ground_m) < SAME_PATH  # a solver's tolerance
    assert known(pyramidal.halving_m) > 10.0 * known(shipped.halving_m)
    assert known(pyramidal.ripple) > 0.3


def test_default_contact_lifts_wheels(small: ContactStudy) -> None:
    assert known(of(small, DEFAULT).lifted_share) > 0.2
    assert known(of(small, BASELINE).lifted_share) == 0.0


def test_tyres_roll_with_the_profiles_radius_whatever_the_contact(small: ContactStudy, lab: Profile) -> None:
    """Under a harder contact the same tyre is larger by what it is pressed in less, and only the first drive notices."""
    found = of(small, DEFAULT)
    assert known(found.rolling_radius_error) == pytest.approx(0.5 * 0.0025 / 0.16, rel=0.1)
    plant = make_variant(DEFAULT, lab.plants["mujoco"])
    excess = bench_module.rolling_radius(plant)[0] - plant.calibration.wheel_radius
    mended = replace(plant.calibration, wheel_radius=plant.calibration.wheel_radius - excess)
    again = MujocoPlant(mended, plant.drive, settings=DEFAULT.settings)
    assert bench_module.rolling_radius(again)[0] == pytest.approx(plant.calibration.wheel_radius, rel=1e-4)


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
    plant = make_variant(PhysicsVariant("own", "closed form", settings, changes), lab.plants["mujoco"])
    found = bench_module.measure_spin(bench_module.spin(plant, 20.0), plant.calibration)
    assert found["multiplier"] == pytest.approx(found["multiplier_expected"], rel=error)
    assert abs(found["multiplier_expected"] - 1.0 - (0.512 / TRACK) ** 2) > 0.02
    assert found["ripple"] < 1e-3


def test_a_robot_heavier_on_the_right_circles_about_its_closed_forms_centre(lab: Profile) -> None:
    plant = make_variant(BY_KEY["centre of mass: maker's, now"], lab.plants["mujoco"])
    made = bench_module.spin(plant, 24.0)
    calibration: Calibration = plant.calibration
    share = (calibration.mass - 4 * 2.637) / calibration.mass
    x, y = turn_on_the_spot(WHEELBASE, TRACK, share * calibration.com_x, share * calibration.com_y).centre
    found = bench_module.measure_spin(made, calibration)
    assert found["wander_m"] == pytest.approx(2.0 * np.hypot(x, y), rel=0.05)
    assert found["drift_m"] < 0.002  # it is back after a turn
    assert made.motion.twist[made.motion.t > SPIN_LEAD, 0].min() > 0.0


def test_the_sideways_drift_is_shown_and_cured(lab: Profile) -> None:
    """Hard pyramids and the maker's centre of mass: a metre off; each cure takes some of it, all of them take it all."""
    steps = ["as it is", "and an elliptic cone", "and soft contact", "and the centre in the middle"]
    wander = []
    for step in steps:
        plant = make_variant(BY_KEY[f"near ODE, maker's centre: {step}"], lab.plants["mujoco"])
        wander.append(bench_module.measure_spin(bench_module.spin(plant, 26.0), plant.calibration)["wander_m"])
    assert wander[0] > 0.8
    assert all(b < 0.8 * a for a, b in pairwise(wander))
    assert wander[-1] < 1e-3


def test_few_asymmetric_iterations_make_a_straight_drive_veer(lab: Profile) -> None:
    veers = []
    for name in ("PGS, 5 iterations", "PGS, 50 iterations"):
        plant = make_variant(BY_KEY[f"solver: {name}"], lab.plants["mujoco"])
        veers.append(abs(bench_module.rolling_radius(plant)[1]))
    assert veers[0] > 1e-3
    assert veers[1] < 1e-4


def test_creep_falls_as_one_over_impratio(lab: Profile) -> None:
    found = []
    for ratio in (1.0, 10.0):
        plant = make_variant(PhysicsVariant("impratio", "", PhysicsSettings(impratio=ratio)), lab.plants["mujoco"])
        gravity = np.array(plant.model.opt.gravity)
        found.append(bench_module.creep(plant))
        assert np.array_equal(plant.model.opt.gravity, gravity)
    assert found[0] / found[1] == pytest.approx(10.0, rel=0.02)


def test_what_cannot_be_driven_says_why_and_leaves_nulls(small: ContactStudy) -> None:
    document = small.as_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert (document["schema"], document["study"], document["baseline"]) == (
        "ssmr.study.contact/1", "contact", "shipped: as shipped",
    )  # fmt: skip
    hopeless = document["variants"][-1]
    assert hopeless["multiplier"] is None
    assert "0.003" in hopeless["failures"]["straight drive"]
    assert any("0.003" in line for line in small.report())
    assert small.notes()[0].startswith("hopeless: no step")
    for variant in document["variants"][:3]:
        assert variant["failures"] == {}
        assert set(variant["d_rms_m"]) == {"improved", "coulomb", "linear"}
        assert set(variant["d_rms_m"]["linear"]) == {"traj1", "traj2", "traj3", "traj4"}
        assert variant["recording_position_m"] is None


def test_a_study_repeats_whatever_the_workers(small: ContactStudy, bench: Bench) -> None:
    again = try_variants(bench, [PYRAMIDAL], workers=1, timed=False)
    assert again.as_dict()["variants"] == small.as_dict()["variants"][1:2]


def test_d_rms_is_the_comparisons(small: ContactStudy, bench: Bench, lab: Profile) -> None:
    """Against the profile's own record of how near it comes."""
    record = lab.provenance["mujoco"]["d_rms_m"]
    found = of(small, BASELINE).d_rms_m["improved"]
    assert {name: pytest.approx(value, abs=2e-4) for name, value in record.items()} == dict(found)
    motion = drive(make_variant(BASELINE, bench.lab), bench.scenarios["traj4"], bench.lab.localiser, bench_module.SAMPLE)
    assert motion.pose[0] == pytest.approx([State().x, State().y, State().yaw], abs=1e-12)


def test_a_recording_is_judged_from_its_wheel_rates(lab: Profile) -> None:
    """A recording that the same robot made: as shipped it repeats it, with its weight elsewhere it does not."""
    section = lab.plants["mujoco"]
    commands = Commands(0.05, np.tile([0.4, 0.5], (400, 1)))
    piece = Piece(commands, State(), None, None)
    made = drive(make_variant(BASELINE, section), piece, section.localiser, 0.05)
    names, columns = ("t", "enc_left", "enc_right", "x", "y", "yaw"), np.column_stack([made.t, made.wheels, made.pose])
    recording = Recording.from_columns("made", dict(zip(names, columns.T, strict=True)))
    with_recording = make_bench(lab, lab, source_of(recording, "made", "wheels"))
    shipped, elsewhere = (
        try_variants(with_recording, [v], timed=False).tried[0].measures
        for v in (BASELINE, BY_KEY["centre of mass: maker's, now"])
    )
    assert known(shipped.recording_position_m) < 0.02
    assert known(shipped.recording_yaw_rad) < 0.02
    assert known(elsewhere.recording_position_m) > 0.05
    with pytest.raises(ValueError, match="6 s without a gap"):
        make_bench(lab, lab, source_of(recording.cut(None, 4.0), "short", "wheels"))


def test_every_variant_has_a_name_of_its_own_and_can_be_made(lab: Profile) -> None:
    assert len(BY_KEY) == len(physics_variants())
    assert chosen_variants(["wheels"]) == (BASELINE, BY_KEY["wheels: capsule"], BY_KEY["wheels: cylinder"])
    for variant in physics_variants():
        calibration = variant.calibration(lab.plants["mujoco"].parameters)
        assert (variant.changes or variant.settings != PhysicsSettings()) or variant == BASELINE
        assert calibration.mass == lab.plants["mujoco"].parameters.mass


def test_the_picture_has_every_number(small: ContactStudy) -> None:
    written = {text.get_gid(): text.get_text() for ax in small.figure().axes for text in ax.texts}
    for outcome in small.tried:
        for column in small.columns():
            assert written[f"{outcome.variant.key}, {column.name}"] == column.text(outcome.measures)


def test_the_program_writes_everything(tmp_path: Path) -> None:
    assert run_program("contact", "--only", "wheels", "--out", str(tmp_path)) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"study.json", "study.png", "study.md"}
    document = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert [v["group"] for v in document["variants"]] == ["shipped", "wheels", "wheels"]
    assert all(1e-6 < v["cost_s"] < 1e-2 for v in document["variants"])
