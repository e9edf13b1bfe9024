"""The simulated robot behind its sensors, and the gate of its commands."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.robot.sensors import SensorModel
from ssmr.types import State
from tests.conftest import EXACT
from validation.plants.profile import Profile, make_plant
from validation.ros.robot import BASE_TIMEOUT, STAND_STILL, CommandGate, SimulatedRobot
from validation.simulator.plant import MujocoPlant

STEPS = 10  # of 2 ms: 50 Hz


@pytest.fixture(scope="module")
def plant(lab: Profile) -> MujocoPlant:
    return cast(MujocoPlant, make_plant(lab, "mujoco"))


def driven(robot: SimulatedRobot, seconds: float, command: tuple[float, float]) -> SimulatedRobot:
    for _ in range(round(seconds / (STEPS * robot.dt))):
        robot.advance(STEPS, command)
        robot.sense()
    return robot


def test_the_robot_is_the_plant(plant: MujocoPlant) -> None:
    state = plant.reset(State(1.0, 2.0, 0.5))
    for _ in range(100):
        state = plant.step((0.3, 0.2), plant.dt)
    robot = driven(SimulatedRobot(plant, State(1.0, 2.0, 0.5)), 0.2, (0.3, 0.2))
    assert robot.state == state
    assert robot.time == pytest.approx(0.2)


def test_seeds_decide_noise(plant: MujocoPlant) -> None:
    def end(seed: int) -> np.ndarray:
        robot = driven(SimulatedRobot(plant, seed=seed), 1.0, (0.3, 0.2))
        return np.concatenate(
            [robot.pose, robot.filtered_odometry()[0], robot.wheel_odometry()[0], robot.imu()[0]]
        )

    assert np.max(np.abs(end(1) - end(1))) == EXACT
    first = end(1)
    second = end(2)
    np.testing.assert_array_equal(first[:3], second[:3])
    assert np.all(first[3:6] != second[3:6])


def test_filter_and_wheels_begin_at_their_own_origin_and_the_gyro_keeps_the_heading(
    plant: MujocoPlant,
) -> None:
    robot = SimulatedRobot(plant, State(3.0, 4.0, 1.0), noise=False)
    np.testing.assert_array_equal(robot.filtered_odometry()[0], 0.0)
    driven(robot, 2.0, (0.3, 0.0))
    way = math.hypot(*(robot.pose[:2] - (3.0, 4.0)))
    believed = robot.filtered_odometry()[0]
    # the driver's radius is 3 % more than the wheels roll
    assert believed[0] == pytest.approx(way, rel=0.05)
    assert robot.wheel_odometry()[0][0] == pytest.approx(believed[0], rel=0.02)
    driven(robot, 4.0, (0.0, 0.4))
    assert robot.filtered_odometry()[0][2] == pytest.approx(robot.state.yaw - 1.0, rel=0.01)


def test_the_imu_feels_gravity_and_the_turn_with_the_noise_of_its_variance(
    plant: MujocoPlant,
) -> None:
    robot = driven(SimulatedRobot(plant, noise=False), 1.0, (0.0, 0.0))
    rates, forces, _ = robot.imu()
    np.testing.assert_allclose(forces, [0.0, 0.0, 9.81], atol=0.05)
    np.testing.assert_allclose(rates, 0.0, atol=1e-3)
    driven(robot, 2.0, (0.0, 0.5))
    assert robot.imu()[0][2] == robot.state.yaw_rate
    robot = SimulatedRobot(plant)
    gyro = []
    for _ in range(800):
        robot.advance(1, (0.0, 0.0))
        robot.sense()
        gyro.append(robot.imu()[0])
    # 5 sigma of 800 samples
    np.testing.assert_allclose(np.var(gyro, axis=0), SensorModel().variance_gyro, rtol=0.25)


# --- the gate of commands ---


def test_an_emergency_stop_comes_at_once_and_lets_nobody_in() -> None:
    gate = CommandGate("/cmd_vel", lambda text: None)
    gate.offer((0.2, 0.1), 0.0)
    gate.emergency_stop(True)
    assert gate.command(0.0) == STAND_STILL
    gate.offer((0.2, 0.1), 0.1)
    assert gate.command(0.1) == STAND_STILL
    gate.emergency_stop(False)
    assert gate.command(0.15) == STAND_STILL, "what was commanded before a stop is void after it"
    gate.offer((0.2, 0.1), 0.2)
    assert gate.command(0.2) == (0.2, 0.1)


@given(st.lists(st.floats(0.0, 0.6), min_size=1, max_size=60))
def test_the_last_command_counts_until_it_is_too_old(pauses: list[float]) -> None:
    gate = CommandGate("/cmd_vel", lambda text: None)
    now = 0.0
    assert gate.command(0.0) == STAND_STILL, "a robot that nobody commands stands"
    for k, pause in enumerate(pauses):
        gate.offer((0.001 * k, 0.0), now)
        assert gate.command(now) == (0.001 * k, 0.0)
        assert gate.command(now + pause) == (
            (0.001 * k, 0.0) if now + pause - now <= BASE_TIMEOUT else STAND_STILL
        )
        now += pause
