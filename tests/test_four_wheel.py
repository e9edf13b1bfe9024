"""The robot on four tyres: laws of its tyres, loads, wheels and motion, each against mechanics."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ssmr.control.laws import Controller, make_gains
from ssmr.control.loop import LoopSettings, run_loop
from ssmr.control.population import run_bodies
from ssmr.control.references import circle
from ssmr.geometry import wrap_angle
from ssmr.models.four_wheel import STATE_NUMBERS, _spread_load, body_of, four_wheels
from ssmr.models.four_wheel_plant import (
    FOUR_WHEEL_DT,
    FourWheelBodies,
    FourWheelPlant,
)
from ssmr.models.friction import (
    AlongAcross,
    Tyre,
    _bent_share,
    bend_brushes,
    felt_slip,
    steady_bend,
    tyre_force,
)
from ssmr.robot.ground import LoadModel
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, State, Trajectory
from tests.conftest import DERIVATIVE, ROUNDOFF
from tests.robots import HUSKY
from validation.plants.planar import tyred_defaults

P = tyred_defaults(HUSKY)
WEIGHT = P.mass * 9.81
STRONG = replace(HUSKY.drive, torque_limit=100.0, delay_v=0.0, delay_w=0.0)
"""A drive that neither waits nor gives up."""
EIGHT_TIMES_G = Tyre(0.6, 9.0, 5.0, 0.08, 0.006)

slips = st.builds(AlongAcross, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
tyres = st.builds(
    Tyre,
    *(
        st.floats(a, b)
        for a, b in ((0.05, 2.0), (1.0, 60.0), (1.0, 60.0), (0.01, 1.0), (0.0, 0.05))
    ),
)


def plant(drive: Drive = STRONG, dt: float = FOUR_WHEEL_DT, **changes: Any) -> FourWheelPlant:
    return FourWheelPlant(replace(P, **changes), drive, dt)


def held(v: float, w: float, seconds: float) -> Commands:
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)))


def forces(motion: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    return (
        motion.channels["force_x_N"],
        motion.channels["force_y_N"],
        motion.channels["wheel_load_N"],
    )


# ------------------------------------------------------------------------------- the tyre


# below the least normal numbers rounding is coarse
@given(slips, tyres, st.just(0.0) | st.floats(1e-6, 2000.0))
def test_a_tyre_stays_within_the_friction_circle_and_never_pushes_along_its_slip(
    slip: AlongAcross, tyre: Tyre, load: float
) -> None:
    force = tyre_force(slip, load, tyre)
    assert math.hypot(*force) <= tyre.friction * load * (1.0 + ROUNDOFF)
    assert force.x * slip.x + force.y * slip.y <= 0.0
    back = tyre_force(AlongAcross(-slip.x, -slip.y), load, tyre)
    assert (back.x, back.y) == (-force.x, -force.y)


def test_a_tyre_is_as_stiff_as_its_numbers_say_and_slides_against_its_slip() -> None:
    tyre = EIGHT_TIMES_G
    little = 1e-7
    assert tyre_force(AlongAcross(little, 0.0), 100.0, tyre).x == pytest.approx(
        -900.0 * little, rel=DERIVATIVE
    )
    assert tyre_force(AlongAcross(0.0, little), 100.0, tyre).y == pytest.approx(
        -500.0 * little, rel=DERIVATIVE
    )
    force = tyre_force(AlongAcross(0.3, -0.4), 100.0, tyre)
    assert (force.x, force.y) == pytest.approx((-36.0, 48.0), rel=ROUNDOFF)


def test_the_force_of_equal_stiffness_is_the_brush_law_of_a_parabolic_pressure() -> None:
    """Integrate the brushes one by one.

    Each is bent by slip times its way from the leading edge, until it slides.
    """
    tyre = EIGHT_TIMES_G._replace(across=9.0)
    load = 180.0
    slip = np.array([0.06, 0.08])
    at = (np.arange(20000) + 0.5) / 20000  # way from the leading edge over the contact's length
    pressure = 6.0 * load * at * (1.0 - at)
    wanted = 2.0 * tyre.along * load * at * np.hypot(*slip)  # whose mean over the contact is C N s
    total = np.minimum(wanted, tyre.friction * pressure).mean()
    # of the sum
    assert math.hypot(*tyre_force(AlongAcross(*slip), load, tyre)) == pytest.approx(total, rel=1e-6)


@given(tyres, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.05, 3.0))
def test_in_steady_rolling_slip_is_sliding_over_rolling_speed(
    tyre: Tyre, x: float, y: float, rolling: float
) -> None:
    # where all of the contact slides, it bends no further
    assume(_bent_share(AlongAcross(0.01 * x, 0.01 * y), tyre) < 1.0)
    sliding = AlongAcross(0.01 * x * rolling, 0.01 * y * rolling)
    slip = AlongAcross(0.0, 0.0)
    for _ in range(200):
        slip = bend_brushes(slip, sliding, rolling, 0.1 * tyre.relaxation / rolling, tyre)
    # e^-20 is left
    assert felt_slip(slip, sliding, rolling, tyre) == pytest.approx((0.01 * x, 0.01 * y), abs=1e-10)
    assert steady_bend(sliding, rolling, tyre) == pytest.approx(tuple(slip), abs=1e-10)


def test_a_force_builds_up_over_the_relaxation_length() -> None:
    tyre = EIGHT_TIMES_G._replace(damping=0.0)
    slip = AlongAcross(0.0, 0.0)
    for _ in range(7):
        slip = bend_brushes(slip, AlongAcross(0.0, 0.005), 0.5, tyre.relaxation / 0.5 / 7.0, tyre)
    assert slip.y == pytest.approx(0.01 * (1.0 - math.exp(-1.0)), rel=ROUNDOFF)


# ------------------------------------------------------------------------------- loads


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9))
def test_loads_carry_the_weight_and_its_moments_even_on_three_wheels(
    ahead: float, aside: float
) -> None:
    robot = four_wheels(P, STRONG, 0.001)
    body = body_of(np.zeros(STATE_NUMBERS))
    body.shift[:] = ahead, aside
    _spread_load(body, robot)
    assert body.load.sum() == pytest.approx(WEIGHT, rel=ROUNDOFF)
    assert body.load.min() >= 0.0
    assert body.load @ [1.0, 1.0, -1.0, -1.0] == pytest.approx(ahead * WEIGHT, abs=1e-9)  # of 719 N
    assert body.load @ [1.0, -1.0, 1.0, -1.0] == pytest.approx(aside * WEIGHT, abs=1e-9)


def test_loads_are_those_of_quasi_static_load_transfer() -> None:
    motion = plant(friction=0.8, com_x=0.03, com_y=-0.02, load_lag=0.0).run(
        held(0.8, 0.6, 4.0), State(), 0.001
    )
    formula = LoadModel(
        P.mass, 0.03, -0.02, P.com_height, P.wheelbase, 2.0 * P.half_track, 4.0 * P.wheel_inertia
    )
    along = formula.along(motion, np.tile([0.0, 0.0, -9.81], (len(motion), 1)), P.wheel_radius)
    after = motion.t > 0.5
    moved = np.ptp(along[motion.t > 0.1], axis=0).max()
    # it differentiates over 0.1 s
    assert np.abs(motion.channels["wheel_load_N"] - along)[after].max() < 0.02 * moved
    assert np.abs(motion.channels["wheel_load_N"].sum(axis=1) - WEIGHT).max() <= ROUNDOFF * WEIGHT


# ------------------------------------------------------------------------------- motion


def test_wild_commands_never_leave_the_friction_circle() -> None:
    wild = Commands(0.05, np.random.default_rng(4).uniform(-3.0, 3.0, (100, 2)))
    along, across, load = forces(plant(friction=0.7).run(wild, State(), 0.001))
    assert np.max(np.hypot(along, across) - 0.7 * load) <= ROUNDOFF * WEIGHT
    assert np.max(np.hypot(along, across) / np.maximum(load, 1.0)) > 0.699


def energy(motion: Trajectory) -> FloatArray:
    (u, v, w), spin = motion.twist.T, P.armature + P.wheel_inertia
    return np.asarray(
        0.5 * P.mass * (u**2 + v**2)
        + 0.5 * P.yaw_inertia * w**2
        + spin * (motion.wheels**2).sum(axis=1)
    )


@pytest.mark.parametrize(
    "changes",
    [{}, {"stiffness_x": 30.0, "relaxation": 0.2, "friction": 0.8}, {"tyre_damping": 0.0}],
)
def test_the_ground_takes_energy_and_gives_none(changes: dict[str, float]) -> None:
    """The motors give at least the energy that the body has: the rest bends tyres or is lost."""
    wild = Commands(0.05, np.random.default_rng(5).uniform(-1.5, 1.5, (100, 2)))
    motion = plant(**changes).run(wild, State(), 0.001)
    rates = 0.5 * (motion.wheels[1:] + motion.wheels[:-1])
    given_ = np.cumsum((motion.channels["torque_N_m"][1:] * rates).sum(axis=1)) * 0.001
    lost = given_ - energy(motion)[1:]
    assert lost.min() > -1e-3 * lost[-1]  # of the steps' error
    assert lost[-1] > 10.0


def test_a_robot_at_rest_holds_below_the_limit_and_gives_way_above_it() -> None:
    """A yaw moment on locked wheels: tyres hold mu m g times their distance from the middle."""
    locked = replace(STRONG, gear_loss=1e3)
    limit = P.friction * WEIGHT * math.hypot(0.5 * P.wheelbase, P.half_track) / P.yaw_inertia
    for share, moves in ((0.9, False), (1.1, True)):
        push = share * limit * np.minimum(np.arange(10000) / 1000.0, 1.0)
        motion = plant(locked).run(held(0.0, 0.0, 10.0), State(), 0.01, push)
        crept = abs(float(motion.yaw[-1] - motion.yaw[-200]))
        assert crept > 0.5 if moves else crept <= 1e-6  # tyres near their limit swing for seconds
        assert moves or 0.0 < motion.yaw[-1] < 0.05


def test_steps_converge_and_a_millisecond_is_fine_enough() -> None:
    commands = TRAJECTORIES["traj4"].commands()
    ends = {
        dt: plant(HUSKY.drive, dt).run(commands, State(), 0.05).pose[-1]
        for dt in (0.001, 0.0005, 0.00025, 0.0000625)
    }
    errors = [np.hypot(*(ends[dt] - ends[0.0000625])[:2]) for dt in (0.001, 0.0005, 0.00025)]
    assert errors[0] < 1e-3
    assert errors[0] > 1.7 * errors[1] > 1.7**2 * errors[2]  # at least almost first order


@pytest.mark.parametrize(
    "changes",
    [{"stiffness_x": 1000.0, "relaxation": 0.05}, {"armature": 1e-6, "wheel_inertia": 1e-4}],
)
def test_stiff_tyres_and_light_wheels_are_stable_at_a_millisecond(
    changes: dict[str, float],
) -> None:
    motion, fine = (
        plant(dt=dt, **changes).run(held(0.5, 0.4, 4.0), State(), 0.05) for dt in (0.001, 0.00025)
    )
    assert np.abs(motion.pose - fine.pose).max() < 2e-3
    assert np.abs(np.diff(motion.twist[40:, 2])).max() < 1e-3


def test_a_robot_four_times_as_large_does_the_same_in_twice_the_time() -> None:
    """Froude: lengths k, masses k^3, times sqrt(k); torques are weight times length."""
    k = 4.0
    t = 2.0
    p = replace(
        P, com_x=0.03, rolling_resistance=0.02, radius_difference=0.004, strength_difference=0.2
    )
    lengths = (
        "wheelbase",
        "half_track",
        "wheel_radius",
        "com_x",
        "com_y",
        "com_height",
        "radius_difference",
    )
    inertias = ("yaw_inertia", "armature", "wheel_inertia")
    large = replace(
        p,
        mass=p.mass * k**3,
        gain=p.gain * k**4 * t,
        **{name: getattr(p, name) * k for name in lengths},
        **{name: getattr(p, name) * k**5 for name in inertias},
    )
    drive = replace(STRONG, torque_limit=8.0, integral_gain=50.0, dc_stiffness=400.0, delay_v=0.05)
    larger = replace(
        drive,
        torque_limit=8.0 * k**4,
        integral_gain=50.0 * k**4,
        dc_stiffness=400.0 * k**4 * t,
        delay_v=0.05 * t,
        hold=0.1,
        command_half_track=drive.command_half_track * k,
        command_radius=drive.command_radius * k,
        v_max=drive.v_max * t,
        w_max=drive.w_max / t,
    )
    values = np.random.default_rng(6).uniform([-0.8, -1.0], [0.8, 1.0], (40, 2))
    one = FourWheelPlant(p, drive, 0.001).run(Commands(0.05, values), State(), 0.01)
    other = FourWheelPlant(large, larger, 0.002).run(
        Commands(0.1, values * [t, 1.0 / t]), State(), 0.02
    )
    # rounding, over two thousand steps
    assert np.abs(other.pose - one.pose * [k, k, 1.0]).max() < 1e-9
    assert np.abs(other.channels["wheel_load_N"] - k**3 * one.channels["wheel_load_N"]).max() < 1e-5


def test_unlike_sides_veer_to_the_weaker_and_to_the_smaller() -> None:
    """A stronger left motor droops less, and a larger left tyre rolls farther.

    Both turn the robot to the right.
    """
    for changes in (
        {"strength_difference": 0.3, "rolling_resistance": 0.1},
        {"radius_difference": 0.005},
    ):
        assert plant(**changes).run(held(0.5, 0.0, 6.0), State(), 0.05).yaw[-1] < -0.005
    assert plant(rolling_resistance=0.1).run(held(0.5, 0.0, 6.0), State(), 0.05).yaw[
        -1
    ] == pytest.approx(0.0, abs=1e-9)


def test_wheels_with_motors_of_their_own_turn_at_their_own_rates() -> None:
    """With the centre of mass ahead, front wheels pull harder at equal rates.

    Without belts they are slower then.
    """
    uneven = [plant(link=link, com_x=0.1, friction=0.6) for link in ("belt", "none")]
    belt, free = (made.run(held(0.0, 0.6, 4.0), State(), 0.05) for made in uneven)
    assert np.abs(belt.twist[-1] - free.twist[-1]).max() > 1e-4
    middle = [
        plant(link=link).run(held(0.5, 0.0, 4.0), State(), 0.05).pose for link in ("belt", "none")
    ]
    assert np.abs(middle[0] - middle[1]).max() < 0.01


# ------------------------------------------------------------------------------- as a plant


def test_closed_loops_equal_the_slow_loop() -> None:
    law = Controller(make_gains("pid", {}), ((0.0,) * 4,) * 4, ((0.0,) * 2,) * 4)
    around = LoopSettings()
    way = circle(0.5, 1.0, 0.3)
    robot = FourWheelPlant(P, HUSKY.drive)
    fast = run_bodies(
        lambda state: FourWheelBodies([robot] * 2, state),
        [robot.drive] * 2, FOUR_WHEEL_DT, [law] * 2, [around] * 2, way, [3, 4],
    )  # fmt: skip
    slow = run_loop(robot, law, way, around, 3)
    assert np.abs(fast[0].table[:, :8] - slow.table[:, :8]).max() <= 1e-12
    assert np.abs(fast[0].table[:, 8:10]).max() > 1.0
    assert np.abs(wrap_angle(fast[1].table[:, 2] - fast[0].table[:, 2])).max() > 1e-3
