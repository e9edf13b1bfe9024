"""jDE finds the friction of a MuJoCo robot from motion and torques; the path hardly tells it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.robot.drivetrain import (
    battery_current,
    battery_torque,
    side_forces,
)
from ssmr.types import Commands, State
from tests.conftest import ROUNDOFF
from tests.drive_train_logs import (
    FRICTION,
    RIPPLE,
    SLIP,
    on_grass,
    random_drive,
    warthog_on_grass,
)
from tests.drive_train_logs import HUSKY as HUSKY_CHASSIS
from tests.drive_train_logs import TORQUE as TORQUE_LIMIT
from tests.drive_train_logs import WARTHOG as WARTHOG_CHASSIS
from tests.recovery import HYBRID, JDE, LEAST_SQUARES, TORQUE, drawn, noisy_target, recover
from validation.descriptions.loading import load_robot
from validation.experiment.sources import Piece, Source
from validation.fit import fit
from validation.identify.currents import COULOMB_SCALE, _torques_of
from validation.identify.motor_logs import UNKNOWN, DriveLog, drive_log, loss_of
from validation.identify.objective import (
    FitCost,
    Objective,
    TorqueRater,
    make_raters,
    torque_errors,
    usual_torque_weight,
)
from validation.identify.problem import FitProblem
from validation.plants.kind import CAUSES, GROUND_TORQUES, TORQUES
from validation.plants.profile import Profile, load_profile, make_plant
from validation.plants.searchable import make_space
from validation.plants.table import plant_kind

CLOSE = 0.03
"""Greatest error of a friction that counts as found [1]."""
DRAWS = 20


def test_torques_tell_friction_and_the_path_hardly_does() -> None:
    """One robot, from the profile's numbers: 0.57 for a profile that says 0.5."""
    both = recover(3, LEAST_SQUARES)
    path = recover(3, LEAST_SQUARES, torque_weight=0.0)
    assert abs(both.off["friction"]) < CLOSE
    assert abs(both.off["friction"]) < 3.0 * both.errors["friction"]
    assert path.errors["friction"] > 5.0 * both.errors["friction"]
    told = "The path hardly tells friction"
    assert any(note.startswith(told) for note in path.notes)
    assert not any(note.startswith(told) for note in both.notes)


@pytest.mark.slow
def test_jde_finds_the_friction_of_nineteen_robots_of_twenty() -> None:
    """From default bounds, with noise on poses and torques.

    The hybrid search does it in less time.
    """
    every = [(recover(seed, JDE), recover(seed, HYBRID)) for seed in range(DRAWS)]
    for found in zip(*every, strict=True):
        close = [abs(one.off["friction"]) <= CLOSE for one in found]
        sure = [abs(one.off["friction"]) <= 3.0 * one.errors["friction"] for one in found]
        assert np.count_nonzero(np.logical_and(close, sure)) >= DRAWS - 1
    jde, hybrid = (sum(one.seconds for one in found) for found in zip(*every, strict=True))
    assert hybrid < jde


@pytest.mark.slow
def test_a_hybrid_whose_candidates_crowd_in_a_corner_finds_friction() -> None:
    """With this seed all good candidates have their weight far ahead, where the descent goes on."""
    found = fit("mujoco", "traj4@mujoco", profile="thesis-lab", seed=0)
    assert found.cost < 1e-4
    assert not any(number.at_bound for number in found.parameters)
    friction = next(number for number in found.parameters if number.name == "friction")
    assert friction.value == pytest.approx(0.7, abs=1e-3)


def test_a_fit_of_a_body_frees_causes_only() -> None:
    for name in ("mujoco", "four_wheel"):
        assert plant_kind(name).free["scenario"] == CAUSES
    assert "tracked_x" not in CAUSES


@pytest.fixture(scope="module")
def target() -> Source:
    return noisy_target(drawn(0), 0)


def raters(
    objective: Objective, pieces: Sequence[Piece], weight: float = 0.01
) -> list[TorqueRater | None]:
    """The raters of torques of some pieces."""
    cost = FitCost(objective, torque_weight=weight)
    source = Source("pieces", tuple(pieces), "mujoco", 0.01)
    return [rater.torques for rater in make_raters(cost, [source])]


def test_the_error_of_torques_is_what_it_says(target: Source) -> None:
    """A constant error of e is an RMS of e, and costs what as many centimetres do."""
    known = target.pieces[0].torques
    assert known is not None
    (rater,) = raters("sync", target.pieces)
    assert rater is not None
    off = known + np.array([3.0, -3.0])
    assert rater.cost(off[None])[0] == pytest.approx(0.03, rel=ROUNDOFF)
    assert (rater.residuals(off[None]) ** 2).sum() == pytest.approx(0.03**2, rel=ROUNDOFF)
    noise = torque_errors(target.pieces, target.truth)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(TORQUE, rel=0.05)  # 2 500 samples


def test_torques_that_nobody_knows_do_not_count(target: Source) -> None:
    """Samples without truth change no cost, and share no block with others."""
    (piece,) = target.pieces
    known = piece.torques
    assert known is not None
    half = len(known) // 2
    partly = known.copy()
    partly[half:, 0] = np.nan
    partly[:, 1] = np.nan
    stamped = replace(piece, t=target.truth[0].t, torques=partly)
    (rater,) = raters("horizon", [stamped])
    assert rater is not None
    off = known + 2.0
    wild = off.copy()
    wild[half:, 0] = 1e3
    wild[:, 1] = -1e3
    assert rater.cost(off[None])[0] == rater.cost(wild[None])[0] == pytest.approx(0.02)
    assert rater.residuals(wild[None]).shape == (1, len(rater.blocks))
    nobody = replace(piece, torques=np.full_like(known, np.nan))
    assert raters("sync", [nobody, piece])[0] is None
    assert raters("sync", [piece], 0.0) == [None]


def test_planar_torques_are_not_believed(target: Source) -> None:
    """A planar model's torques are numbers of its fit, so it is fitted by its path."""
    assert not plant_kind("improved").torques
    assert TORQUES in target.truth[0].channels
    (rater,) = make_raters(FitCost("sync", torque_weight=0.01), [target])
    assert rater.torques is not None
    assert set(rater.torques.blocks) <= set(rater.pose_blocks)


def test_torques_weigh_by_the_robot_and_only_where_friction_is_free(target: Source) -> None:
    """A friction that is held is nothing that torques could tell, and would distort the body."""
    lab = load_profile("thesis-lab").section("mujoco")
    for free, told in ((("friction", "com_x"), True), (("com_x",), False)):
        space = make_space("mujoco", free, {}, lab.robot)
        problem = FitProblem("mujoco", lab, space, [target], FitCost("sync"))
        assert problem.torques == told
    warthog = load_robot("warthog")
    forces = [robot.mass * robot.wheel_radius for robot in (lab.robot, warthog)]
    weights = [usual_torque_weight(robot) for robot in (lab.robot, warthog)]
    assert weights[0] * forces[0] == pytest.approx(weights[1] * forces[1])
    assert weights[0] == pytest.approx(0.01, rel=0.05)


# ------------------------------------------------------------------------- torques of a real log


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_given_wheels_take_the_torque_of_the_same_wheels_that_a_motor_turns(
    lab: Profile, noise: float
) -> None:
    """In a steady bend, less what gear and rolling take, also where measured rates scatter.

    The contact is 0.2 % farther from the axle than the rolling radius.
    """
    plant = make_plant(lab, "mujoco")
    driven = plant.run(Commands(0.05, np.tile([0.4, 0.6], (120, 1))), State(), 0.01)
    rates = driven.wheels[-1]
    loss = loss_of(lab.section("mujoco")) * np.sign(rates)
    wanted = driven.channels[TORQUES][-200:].mean(axis=0) - loss
    scatter = noise * np.random.default_rng(0).normal(size=(120, 2))
    told = Commands(0.05, rates + scatter, "wheels")
    start = State(0.0, 0.0, 0.0, *driven.twist[-1], *rates)
    seen = plant.run(told, start, 0.01).channels[GROUND_TORQUES][-300:].mean(axis=0)
    assert seen == pytest.approx(wanted, rel=0.003 if noise == 0.0 else 0.02)


def test_given_wheels_push_the_robot_by_newtons_law(lab: Profile) -> None:
    """At 4 rad/s² a side takes m r² / 2 of it, and nothing of the armature that prescribes it."""
    plant = make_plant(lab, "mujoco")
    body = lab.section("mujoco").parameters
    rates = 0.04 * np.arange(200)[:, None] * np.ones((1, 2))
    motion = plant.run(Commands(0.01, rates, "wheels"), State(), plant.dt)
    torque = motion.channels[GROUND_TORQUES][200:].mean(axis=0)
    assert torque == pytest.approx(0.5 * body.mass * 4.0 * body.wheel_radius**2, rel=0.01)


@given(torque=st.floats(-300.0, 300.0), rate=st.floats(0.1, 6.0), heat=st.floats(0.0, 0.005))
def test_power_tells_the_torque(torque: float, rate: float, heat: float) -> None:
    """Where the battery's current falls with braking torque, its inverse gives that torque back."""
    eta = 0.9
    if torque < 0.0 and 2.0 * heat * -torque > 0.99 * eta * rate:
        return  # more braking would feed less back: two torques draw the same
    power = battery_current(np.array(torque), np.array(rate), np.array(48.0), heat, eta) * 48.0
    back = battery_torque(power, np.array(rate), heat, eta)
    assert back == pytest.approx(torque, rel=1e-9, abs=1e-6)


def test_currents_of_a_synthetic_log_are_its_torques() -> None:
    """A Husky's log, sensor without a sign: where it shows something, it is the ground's torque."""
    log = drive_log(on_grass())
    constant = 2.5
    torques, said = _torques_of(log, HUSKY_CHASSIS, constant, 0.0)
    assert torques is not None
    assert "motors' currents" in said
    known = np.isfinite(torques)
    assert 0.1 < known.mean() < 0.9
    true = constant * FRICTION * side_forces(log.rates, HUSKY_CHASSIS.vehicle, SLIP).T
    scale = (torques[known] @ true[known]) / (true[known] @ true[known])
    assert scale == pytest.approx(1.0, abs=0.04)  # as well as friction and losses are known
    assert np.std(torques[known] - true[known]) < 1.3 * constant * RIPPLE
    none, said = _torques_of(log, HUSKY_CHASSIS, 0.0, 0.0)
    assert none is None
    assert "--torque-constant" in said


def signed_log(unit: Literal["A", "N m"], sign: str, loss: float = 3.0) -> DriveLog:
    """Return a log of a Husky whose torques, or currents of 1 A/(N m), have a sign of some kind."""
    motion = random_drive(5, 40, HUSKY_CHASSIS, most=0.5)
    rates = motion.rates[:, ::5]
    torques = 30.0 * side_forces(rates, HUSKY_CHASSIS.vehicle, COULOMB_SCALE)
    torques += loss * np.sign(rates)
    rng = np.random.default_rng(6)
    torques += 0.6 * rng.standard_normal(torques.shape)
    if sign != "axle":
        torques *= np.where(rates < 0.0, -1.0, 1.0) if sign == "driving" else -1.0
    return DriveLog("signed", motion.t[::5], rates, UNKNOWN, torques, UNKNOWN, True, unit)


@pytest.mark.parametrize(
    ("unit", "sign"),
    [
        ("N m", "axle"),
        ("A", "driving"),
        ("N m", "against the axle"),
        pytest.param("A", "axle", marks=pytest.mark.slow),
        pytest.param("N m", "driving", marks=pytest.mark.slow),
        pytest.param("A", "against the axle", marks=pytest.mark.slow),
    ],
)
def test_a_torque_is_the_same_whatever_its_sign_means(unit: Literal["A", "N m"], sign: str) -> None:
    """Where wheels slide it is that of the ground with the sign of the axle, and losses are off."""
    log = signed_log(unit, sign)
    torques, said = _torques_of(log, HUSKY_CHASSIS, 1.0, 0.0)
    assert torques is not None
    assert "battery" not in said
    known = np.isfinite(torques).all(axis=1)
    assert known.mean() > 0.3
    push = 30.0 * side_forces(log.rates, HUSKY_CHASSIS.vehicle, COULOMB_SCALE).T
    off = torques[known] - push[known]
    assert np.abs(off.mean(axis=0)).max() < 0.3
    assert np.std(off) < 1.0


def test_torques_that_are_none_of_a_drive_train_are_refused_with_the_reason() -> None:
    log = signed_log("N m", "axle")
    assert log.currents is not None
    other = replace(log, currents=np.random.default_rng(1).standard_normal(log.currents.shape))
    with pytest.raises(ValueError, match=r"explain 0\.\d\d of their variance.*wanted 0\.8"):
        _torques_of(other, HUSKY_CHASSIS, 0.0, 0.0)
    with pytest.raises(ValueError, match=r"on the left they would need a negative loss, -3"):
        _torques_of(signed_log("N m", "axle", -3.0), HUSKY_CHASSIS, 0.0, 0.0)


def test_a_battery_needs_no_constant() -> None:
    log = drive_log(warthog_on_grass())
    torques, said = _torques_of(log, WARTHOG_CHASSIS, 0.0, 0.0)
    assert torques is not None
    assert "the battery's power" in said
    true = TORQUE_LIMIT * side_forces(log.rates, WARTHOG_CHASSIS.vehicle, SLIP).T
    known = np.isfinite(torques)
    assert np.median(np.abs(torques[known] - true[known])) < 0.08 * TORQUE_LIMIT
