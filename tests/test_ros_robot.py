"""The simulated robot behind its sensors."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest

from ssmr.robot.sensors import SensorModel
from ssmr.types import State
from tests.conftest import EXACT
from validation.plants.profile import Profile, make_plant
from validation.ros.robot import SensorSettings, SimulatedRobot
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
    robot = driven(SimulatedRobot(plant, SensorSettings(), State(1.0, 2.0, 0.5)), 0.2, (0.3, 0.2))
    assert robot.state == state
    assert robot.time == pytest.approx(0.2)


def test_seeds_decide_noise_and_pushes(plant: MujocoPlant) -> None:
    def end(seed: int, disturbance: bool) -> np.ndarray:
        robot = driven(SimulatedRobot(plant, SensorSettings(disturbance=disturbance, seed=seed)), 1.0, (0.3, 0.2))
        return np.concatenate([robot.pose, robot.believed()[0], robot.wheels()[0], robot.imu()[0]])

    assert np.max(np.abs(end(1, True) - end(1, True))) == EXACT
    first, second = end(1, False), end(2, False)
    np.testing.assert_array_equal(first[:3], second[:3])
    assert np.all(first[3:6] != second[3:6])
    assert np.any(end(1, True)[:3] != first[:3])


def test_filter_and_wheels_begin_at_their_own_origin(plant: MujocoPlant) -> None:
    robot = SimulatedRobot(plant, SensorSettings(noise=False), State(3.0, 4.0, 1.0))
    np.testing.assert_array_equal(robot.believed()[0], 0.0)
    driven(robot, 2.0, (0.3, 0.0))
    way = math.hypot(*(robot.pose[:2] - (3.0, 4.0)))
    assert robot.believed()[0][0] == pytest.approx(way, rel=0.05)  # the driver's radius is 3 % more than the wheels roll
    assert robot.wheels()[0][0] == pytest.approx(robot.believed()[0][0], rel=0.02)


def test_the_gyro_keeps_the_heading(plant: MujocoPlant) -> None:
    robot = driven(SimulatedRobot(plant, SensorSettings(noise=False)), 4.0, (0.0, 0.4))
    assert robot.believed()[0][2] == pytest.approx(robot.state.yaw, rel=0.01)


def test_set_pose_moves_the_belief_and_not_the_robot(plant: MujocoPlant) -> None:
    robot = driven(SimulatedRobot(plant, SensorSettings(noise=False)), 1.0, (0.3, 0.1))
    before, covariance = robot.state, np.diag([0.1, 0.2, 0.3])
    robot.set_pose(np.array([5.0, 6.0, 0.7]), covariance)
    pose, twist, claimed, _ = robot.believed()
    np.testing.assert_array_equal(pose, [5.0, 6.0, 0.7])
    np.testing.assert_array_equal(claimed, covariance)
    assert twist == (0.0, 0.0)
    assert robot.state == before
    with pytest.raises(ValueError, match="finite"):
        robot.set_pose(np.array([math.nan, 0.0, 0.0]), covariance)


def test_a_robot_is_put_where_odom_says_and_rests_there(plant: MujocoPlant) -> None:
    robot = driven(SimulatedRobot(plant, SensorSettings(noise=False), State(1.0, 2.0, math.pi / 2.0)), 1.0, (0.5, 0.3))
    time, asked = robot.time, np.array([3.0, 0.5, -0.2])
    robot.place(asked)
    assert robot.resting
    assert robot.time == time
    np.testing.assert_allclose(robot.pose, [0.5, 5.0, math.pi / 2.0 - 0.2], atol=1e-6)
    for pose in (robot.believed()[0], robot.wheels()[0]):
        np.testing.assert_array_equal(pose, asked)
    driven(robot, 0.5, (0.0, 0.0))  # nothing is left of the drive before
    np.testing.assert_allclose(robot.pose, [0.5, 5.0, math.pi / 2.0 - 0.2], atol=1e-3)
    for pose, twist, *_ in (robot.believed(), robot.wheels()):
        np.testing.assert_allclose(pose, asked, atol=1e-3)
        np.testing.assert_allclose(twist, 0.0, atol=1e-3)


def test_the_filters_covariance_is_the_one_that_is_told(plant: MujocoPlant) -> None:
    robot = driven(SimulatedRobot(plant, SensorSettings()), 1.0, (0.3, 0.1))
    mean, covariance = robot.belief
    _, twist, pose_cov, twist_cov = robot.believed()
    np.testing.assert_array_equal(pose_cov, covariance[:3, :3])
    assert twist == tuple(mean[3:])
    np.testing.assert_array_equal(twist_cov[np.ix_((0, 2), (0, 2))], covariance[3:, 3:])


def test_the_imu_feels_gravity_at_rest_and_the_turn(plant: MujocoPlant) -> None:
    robot = driven(SimulatedRobot(plant, SensorSettings(noise=False)), 1.0, (0.0, 0.0))
    rates, forces, _ = robot.imu()
    np.testing.assert_allclose(forces, [0.0, 0.0, 9.81], atol=0.05)
    np.testing.assert_allclose(rates, 0.0, atol=1e-3)
    assert robot.resting
    driven(robot, 2.0, (0.0, 0.5))
    assert robot.imu()[0][2] == robot.state.yaw_rate
    assert not robot.resting


def test_the_noise_has_its_variance(plant: MujocoPlant) -> None:
    robot, gyro = SimulatedRobot(plant, SensorSettings()), []
    for _ in range(800):
        robot.advance(1, (0.0, 0.0))
        robot.sense()
        gyro.append(robot.imu()[0])
    found = np.var(np.array(gyro), axis=0)
    np.testing.assert_allclose(found, SensorModel().variance_gyro, rtol=0.25)  # 5 sigma of 800 samples
