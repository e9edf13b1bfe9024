"""Contacts that give way, set points and currents: limits, symmetries, cases made by hand."""

from __future__ import annotations

import math
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.robot.drive import wheel_references
from ssmr.robot.drivetrain import (
    CREEP,
    _quasi_static_twist,
    battery_current,
    bridge_reading,
    grip_share,
    side_forces,
)
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import Commands, FloatArray, State
from tests.conftest import ROUNDOFF
from tests.robots import TRACK, WHEELBASE
from validation.identify.driver import driven_rates

HUSKY = Vehicle(wheel_radius=0.1651, half_track=0.5 * TRACK, a=0.5 * WHEELBASE, b=0.5 * WHEELBASE)
SOLVED = 1e-9
"""Forces over friction limits that a Newton step of 1e-12 m/s leaves, with slip scales from 0.01
on."""
DT = 0.01
LAW = {
    "dead_time": 0.1,
    "gain": 1.05,
    "half_track": 0.29,
    "yaw_rate_limit": 1.0,
    "acceleration": 2.0,
    "yaw_acceleration": 1.9,
    "lag": 1e-6,
}
UP = Drive(v_max=1.0, command_radius=0.1651)

rates = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0)).map(
    lambda pair: np.array(pair)[:, None]
)
scales = st.floats(0.01, 0.8)


def balance(w: FloatArray, twist: FloatArray, scale: float) -> FloatArray:
    """Force ahead and moment of the sides, over the friction limit, computed from scratch."""
    out = np.zeros(3)
    for x in (HUSKY.a, -HUSKY.a):
        for side, y in ((0, HUSKY.half_track), (1, -HUSKY.half_track)):
            rim = HUSKY.wheel_radius * w[side, 0]
            v = np.array([rim - twist[0, 0] + twist[2, 0] * y, -twist[1, 0] - twist[2, 0] * x])
            speed = math.hypot(*v)
            force = (
                np.zeros(2)
                if speed == 0.0
                else 0.5 * grip_share(speed / (abs(rim) + CREEP), scale) * v / speed
            )
            out += [force[0], force[1], (x * force[1] - y * force[0]) / HUSKY.half_track]
    return out


@given(slip=st.floats(0.0, 100.0), scale=scales)
def test_grip_grows_from_nothing_to_the_limit(slip: float, scale: float) -> None:
    assert grip_share(0.0, scale) == 0.0
    assert 0.0 <= grip_share(slip, scale) <= 1.0
    assert grip_share(2.0 * slip, scale) >= grip_share(slip, scale)
    assert grip_share(scale, scale) == pytest.approx(1.0 - math.exp(-1.0), rel=ROUNDOFF)


@given(w=rates, scale=scales)
def test_the_steady_motion_balances_all_forces(w: FloatArray, scale: float) -> None:
    assert np.abs(balance(w, _quasi_static_twist(w, HUSKY, scale), scale)).max() < SOLVED


@given(w=rates, scale=scales)
def test_mirror_and_reversal(w: FloatArray, scale: float) -> None:
    twist, mirrored, back = (_quasi_static_twist(x, HUSKY, scale) for x in (w, w[::-1], -w))
    assert np.allclose(mirrored, twist * [[1.0], [-1.0], [-1.0]], atol=1e-7)
    assert np.allclose(back, -twist, atol=1e-7)
    forces = side_forces(w, HUSKY, scale)
    assert np.allclose(side_forces(w[::-1], HUSKY, scale), forces[::-1], atol=1e-6)
    assert np.abs(forces).max() <= 1.0


@pytest.mark.parametrize("half_base", [0.1, 0.256, 0.5])
def test_a_turn_on_the_spot_is_coulombs_whatever_the_scale(half_base: float) -> None:
    """All four contacts slip alike there, so the law drops out.

    The closed form is 1 + (a / b)^2 for any scale.
    """
    geometry = Vehicle(wheel_radius=0.1651, half_track=0.2854, a=half_base, b=half_base)
    for scale in (1e-5, 0.08, 0.5):
        rate = _quasi_static_twist(np.array([[-2.0], [2.0]]), geometry, scale)[2, 0]
        multiplier = geometry.wheel_radius * 2.0 / (geometry.half_track * rate)
        assert multiplier == pytest.approx(1.0 + (half_base / geometry.half_track) ** 2, rel=1e-9)


currents = st.floats(-30.0, 30.0)


@given(current=currents, rate=st.floats(-6.0, 6.0), ripple=st.floats(0.0, 3.0))
def test_a_reading_knows_no_direction(current: float, rate: float, ripple: float) -> None:
    one, other = (
        bridge_reading(np.array(s * current), np.array(s * rate), 0.15, ripple, 0.3)
        for s in (1.0, -1.0)
    )
    if rate != 0.0:
        assert one == pytest.approx(other, rel=1e-12)
    assert one >= 0.0


@pytest.mark.parametrize(
    ("current", "rate", "reads"),
    [
        (8.0, 2.0, 8.0),
        (-8.0, -2.0, 8.0),
        (-8.0, 2.0, 0.3),
        (-20.0, 2.0, 20.0),
        (8.0, -2.0, 0.3),
        (0.0, 2.0, 0.3),
    ],
)
def test_a_reading_is_the_current_while_the_bridge_drives(
    current: float, rate: float, reads: float
) -> None:
    """At 2 rad/s and 0.15 rad/s per A, a braking current below 13.3 A feeds the battery.

    There I (w + rho I) < 0.
    """
    sharp = bridge_reading(np.array(current), np.array(rate), 0.15, 0.0, 0.3)
    assert sharp == reads
    if abs(current) > 5.0:
        assert bridge_reading(np.array(current), np.array(rate), 0.15, 1.0, 0.3) == pytest.approx(
            reads, abs=1e-3
        )


@given(current=st.floats(-15.0, 15.0), rate=st.floats(0.1, 4.0))
def test_a_mean_reading_is_that_of_a_current_that_ripples(current: float, rate: float) -> None:
    draws = current + 1.2 * np.random.default_rng(0).standard_normal(40_000)
    seen = np.where(draws * (rate + 0.15 * draws) > 0.0, np.abs(draws), 0.3).mean()
    # 40 000 draws
    assert bridge_reading(np.array(current), np.array(rate), 0.15, 1.2, 0.3) == pytest.approx(
        seen, abs=0.12
    )


@given(torque=st.floats(-500.0, 500.0), rate=st.floats(-6.0, 6.0))
def test_a_lossless_battery_gives_what_the_wheels_take(torque: float, rate: float) -> None:
    drawn = battery_current(np.array(torque), np.array(rate), np.array(48.0), 0.0, 1.0)
    assert drawn * 48.0 == pytest.approx(torque * rate, rel=ROUNDOFF, abs=1e-9)
    lossy = battery_current(np.array(torque), np.array(rate), np.array(48.0), 1e-3, 0.9)
    assert lossy >= drawn - 1e-9


def test_a_driver_is_the_drive_of_the_plants() -> None:
    """Without the shared limit, the law is that of `ssmr.robot.drive`, to a step."""
    rng = np.random.default_rng(3)
    commands = np.repeat(rng.uniform([-0.4, -0.8], [0.4, 0.8], (20, 2)), 300, axis=0)
    law = {**LAW, "gain": 1.0, "lag": 0.05}
    drive = Drive(
        delay_v=0.1,
        delay_w=0.1,
        hold=DT,
        w_max=1.0,
        command_half_track=0.29,
        acceleration_v=2.0,
        acceleration_w=1.9,
        wheel_lag=0.05,
    )
    commanded = wheel_references(Commands(DT, commands), drive, DT, State()) * drive.command_radius
    free = replace(UP, v_max=10.0, command_radius=drive.command_radius)
    late = round(law["dead_time"] / DT)
    made = driven_rates(commands, DT, law, free).T * drive.command_radius
    assert np.allclose(made[:-late], commanded[late:], atol=1e-12)


def test_a_driver_keeps_its_limits() -> None:
    commands = np.tile([0.9, 3.0], (400, 1))
    made = driven_rates(commands, DT, LAW, UP).T * UP.command_radius
    assert np.abs(made).max() == pytest.approx(1.0, rel=ROUNDOFF)
    left, right = made[-1]
    wanted = 1.05 * 0.9 - 0.29, 1.05 * 0.9 + 0.29  # the yaw rate is limited to 1
    assert left / right == pytest.approx(wanted[0] / wanted[1], rel=ROUNDOFF)
    slow = driven_rates(np.tile([0.4, 0.0], (400, 1)), DT, LAW, UP).T * UP.command_radius
    assert np.diff(slow[:, 0]).max() <= 1.05 * LAW["acceleration"] * DT + 1e-12
    assert slow[-1] == pytest.approx([0.42, 0.42], rel=ROUNDOFF)


def test_mujocos_contacts_push_by_sliding_speed_and_not_by_slip() -> None:
    """At half the wheel rates MuJoCo's contacts push half as much (docs/drivetrain.md).

    Those of the law push nearly as much.
    """
    tables = runpy.run_path(
        str(Path(__file__).resolve().parents[1] / "docs" / "make_drivetrain_tables.py")
    )
    mujoco, _ = tables["mujoco_shares"](tables["CURVE"], 0.5)
    law = tables["law_shares"](tables["CURVE"], 0.08)
    assert mujoco[1] == pytest.approx([0.334, 0.167], abs=0.005)
    assert law[1] == pytest.approx([0.345, 0.335], abs=0.005)
