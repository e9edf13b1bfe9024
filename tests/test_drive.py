"""Between command and wheel, on cases made by hand.

They test saturation, hold, delay, acceleration limits, kinematics and lag.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.robot.drive import Driver, body_rates, wheel_rates, wheel_references
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, State
from tests.conftest import EXACT

DT = 0.001
PLAIN = Drive(delay_v=0.0, delay_w=0.0)


@given(v=st.floats(-2, 2), w=st.floats(-3, 3), c=st.floats(0.1, 1.0), r=st.floats(0.05, 0.5))
def test_wheel_and_body_rates_are_inverse(v: float, w: float, c: float, r: float) -> None:
    back = body_rates(*wheel_rates(v, w, c, r), c, r)
    assert np.allclose(back, [v, w], atol=1e-12)


@pytest.mark.parametrize(("delay_v", "delay_w"), [(0.22, 0.22), (0.1, 0.3), (0.0, 0.05)])
def test_each_command_has_its_own_delay(delay_v: float, delay_w: float) -> None:
    drive = replace(PLAIN, delay_v=delay_v, delay_w=delay_w)
    references = wheel_references(Commands(0.05, np.tile([0.5, 0.4], (20, 1))), drive, DT, State())
    speed, turn = body_rates(
        references[:, 0], references[:, 1], drive.command_half_track, drive.command_radius
    )
    assert np.argmax(speed > 0.0) == round(delay_v / DT)
    assert np.argmax(np.abs(turn) > 1e-12) == round(delay_w / DT)


def test_acceleration_limits_hold_for_each_velocity_from_where_it_is() -> None:
    """V and omega each ramp at their own rate, from what the turning wheels amount to."""
    drive = replace(PLAIN, acceleration_v=0.5, acceleration_w=2.0)
    began = State(wheel_left=1.0, wheel_right=1.0)
    references = wheel_references(Commands(0.05, np.tile([0.5, 1.0], (40, 1))), drive, DT, began)
    v, w = body_rates(
        references[:, 0], references[:, 1], drive.command_half_track, drive.command_radius
    )
    t = DT * (1.0 + np.arange(len(v)))
    assert v == pytest.approx(np.minimum(drive.command_radius + 0.5 * t, 0.5))
    assert w == pytest.approx(np.minimum(2.0 * t, 1.0), abs=1e-12)


def test_the_lag_is_first_order() -> None:
    """A step of the reference is approached exponentially, exactly at every step of the physics."""
    drive = replace(PLAIN, wheel_lag=0.2)
    references = wheel_references(Commands(0.05, np.tile([0.5, 0.0], (20, 1))), drive, DT, State())
    t = DT * (1.0 + np.arange(len(references)))
    assert references[:, 0] == pytest.approx(0.5 / drive.command_radius * (1.0 - np.exp(-t / 0.2)))


def test_measured_wheel_rates_pass_as_they_are() -> None:
    rates = Commands(0.05, [[3.0, -20.0], [4.0, 20.0]], "wheels")
    references = wheel_references(
        rates, replace(PLAIN, acceleration_v=0.1, wheel_lag=0.5, delay_v=1.0), DT, State()
    )
    assert np.array_equal(references, np.repeat(rates.values, 50, axis=0))


@pytest.mark.parametrize("ramp", [0.004, 0.02, 0.05])
def test_a_ramp_is_the_mean_of_the_held_commands_over_its_time(ramp: float) -> None:
    drive = replace(PLAIN, command_ramp=ramp, delay_v=0.1, delay_w=0.03)
    rng = np.random.default_rng(2)
    commands = Commands(0.05, rng.uniform(-0.9, 0.9, (30, 2)), before=(0.2, -0.1))
    held = wheel_references(commands, replace(drive, command_ramp=0.0), DT, State())
    ramped = wheel_references(commands, drive, DT, State())
    n = round(ramp / DT)
    first = np.array([[0.2 + 0.1 * 0.275, 0.2 - 0.1 * 0.275]]) / drive.command_radius
    padded = np.vstack([np.repeat(first, n - 1, axis=0), held])
    assert ramped == pytest.approx(
        np.lib.stride_tricks.sliding_window_view(padded, n, axis=0).mean(axis=2), abs=1e-12
    )


@pytest.mark.parametrize("chunk", [0.001, 0.01, 0.05, 0.2])
@pytest.mark.parametrize(
    "drive",
    [
        Drive(),
        Drive(
            delay_v=0.013,
            delay_w=0.4,
            acceleration_w=5.0,
            wheel_lag=0.1,
            hold=0.02,
            command_ramp=0.02,
        ),
    ],
)
def test_stepping_is_the_whole_run(drive: Drive, chunk: float) -> None:
    """A driver of one command at a time, at any period, equals the precomputed references."""
    rng = np.random.default_rng(1)
    commands = Commands(0.2, rng.uniform(-2, 2, (25, 2)))
    whole = wheel_references(commands, drive, DT, State())
    driver = Driver(drive, DT, State())
    steps = round(chunk / DT)
    parts = [
        driver.references(tuple(commands.values[k * steps // 200]), steps)
        for k in range(len(whole) // steps)
    ]
    assert np.abs(np.vstack(parts) - whole).max() == EXACT
