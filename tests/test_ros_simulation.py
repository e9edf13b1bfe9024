"""The loop of the simulated robot on a node without DDS and on a clock of its own: no waiting."""

from __future__ import annotations

import logging
import math
from collections import Counter
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.ros_fakes import FakeClock, FakeNode, message, twist
from validation.plants.profile import Profile, make_plant
from validation.ros import messages as msg
from validation.ros.messages import STOP_TOPIC
from validation.ros.robot import BASE_TIMEOUT, SimulatedRobot
from validation.ros.simulation import SimulationNode, is_due
from validation.simulator.plant import MujocoPlant

COMMAND = "/cmd_vel"
POSE = msg.tracking_topic("husky")


@given(st.sampled_from([7.0, 20.0, 50.0, 100.0, 120.0, 333.3, 500.0]))
def test_rates_are_kept_to_the_step(rate: float) -> None:
    dt = 0.002
    seen = 0
    for step in range(1, 2000):
        seen += is_due(step, rate, dt)
        assert seen == int(step * dt * rate + 1e-9), "neither early nor more than a step late"


@pytest.fixture(scope="module")
def plant(lab: Profile) -> MujocoPlant:
    return cast(MujocoPlant, make_plant(lab, "mujoco"))


def simulation(plant: MujocoPlant, overshoot: float = 0.0) -> tuple[SimulationNode, FakeNode]:
    node = FakeNode(FakeClock(overshoot))
    robot = SimulatedRobot(plant, noise=False)
    return SimulationNode(node, robot), node


def speeds(node: FakeNode) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [s] and speeds [m/s] by the tracking system."""
    t, xy = np.array(
        [(stamp, (s.x, s.y)) for stamp, s, _ in (msg.read_pose(m) for _, m in node.of(POSE))],
        dtype=object,
    ).T
    t = t.astype(float)
    xy = np.array(xy.tolist())
    return t[1:], np.hypot(*np.diff(xy, axis=0).T) / np.diff(t)


@pytest.mark.parametrize(("stall", "dropped"), [(1.5, 0.0), (3.0, 3.0)])
def test_lateness_is_caught_up_with_or_dropped(
    plant: MujocoPlant, stall: float, dropped: float
) -> None:
    """A simulation that stalls for longer than the limit does not run fast afterwards.

    Its time has lost the stall.
    """
    loop, node = simulation(plant)
    stalls = iter([0.0] * 50 + [stall])
    receive = node.receive
    clock = node.clock

    def stalled(*now: Any) -> Any:
        clock.sleep(next(stalls, 0.0))
        return receive(*now)

    node.receive = stalled  # type: ignore[method-assign]
    loop.run(2.0)
    assert clock.now == pytest.approx(102.0 + dropped, abs=0.01)
    late = np.array([t - msg.read_pose(m)[0] for t, m in node.of(POSE)])
    assert late.max() == pytest.approx(stall, abs=0.01)
    assert late[-1] == pytest.approx(dropped, abs=0.01)


def test_every_topic_comes_at_its_rate_and_its_instants(plant: MujocoPlant) -> None:
    loop, node = simulation(plant, overshoot=3e-4)
    loop.run(2.0)
    sensors = (
        "/platform/odom/filtered",
        "/platform/odom",
        "/sensors/imu_0/data",
        "/platform/joint_states",
        "/tf",
    )
    assert Counter(topic for topic, *_ in node.sent) == {
        "/tf_static": 1,
        "/robot_description": 1,
        "/clock": 200,
        POSE: 240,
        **dict.fromkeys(sensors, 100),
    }
    stamps = np.array([msg.read_pose(m)[0] for _, m in node.of(POSE)])
    assert np.all(
        (stamps - np.arange(1, 241) / 120.0 >= -1e-9)
        & (stamps - np.arange(1, 241) / 120.0 < plant.dt)
    )
    sent = np.array([t for t, _ in node.of(POSE)])
    assert np.all((sent - stamps >= 0.0) & (sent - stamps < 1e-3))
    (joints,) = {tuple(m.name) for _, m in node.of("/platform/joint_states")}
    assert joints[0] == "front_left_wheel_joint"


def test_a_stream_that_falls_silent_stops_the_robot(
    plant: MujocoPlant, caplog: pytest.LogCaptureFixture
) -> None:
    loop, node = simulation(plant)
    for k in range(30):
        node.plan(COMMAND, 0.05 * k, twist(0.25))
    with caplog.at_level(logging.INFO, "validation"):
        loop.run(3.0)
    t, v = speeds(node)
    assert v[np.searchsorted(t, 1.6)] > 0.2
    drive = plant.drive
    braking = 1.45 + BASE_TIMEOUT + drive.hold  # as late as its own 20 Hz reads it
    rest = braking + drive.delay_v + 0.25 / drive.acceleration_v + 5 * drive.wheel_lag
    assert np.all(v[t > rest] < 0.01)
    assert "nothing on /cmd_vel for 0.25 s: the robot brakes" in caplog.text


def test_an_emergency_stop_holds_until_it_is_released(plant: MujocoPlant) -> None:
    loop, node = simulation(plant)
    for k in range(100):
        node.plan(COMMAND, 0.05 * k, twist(0.25))
    for at, stop in ((1.0, True), (3.0, False)):
        node.plan(STOP_TOPIC, at, message({"data": stop}))
    loop.run(4.9)
    t, v = speeds(node)
    assert np.all(v[(t > 2.0) & (t < 3.0)] < 0.01)
    assert np.all(v[((t > 0.8) & (t < 1.0)) | (t > 4.0)] > 0.2)


FLOODS = {
    "commands": twist(0.25),
    "commands of NaN": twist(math.nan),
    "huge commands": twist(1e300, -1e300),
}


@pytest.mark.parametrize("name", FLOODS)
def test_a_flood_is_a_few_lines_and_the_stop_comes_all_the_same(
    name: str, plant: MujocoPlant, caplog: pytest.LogCaptureFixture
) -> None:
    loop, node = simulation(plant)
    node.coming = [(100.0 + 1e-3 * k, COMMAND, FLOODS[name]) for k in range(3000)]
    for k in range(40):
        node.plan(COMMAND, 0.05 * k, twist(0.25))
    node.plan(STOP_TOPIC, 1.5, message({"data": True}))
    with caplog.at_level(logging.INFO, "validation"):
        loop.run(2.5)
    t, v = speeds(node)
    assert np.all(v[(t > 1.0) & (t < 1.5)] > 0.2)
    assert np.all(v[t > 2.05] < 0.01)
    assert t[-1] == pytest.approx(node.of(POSE)[-1][0], abs=1e-3), "its clock is the wall's"
    assert len(caplog.records) <= 10
    assert all(
        record.getMessage().isprintable() and len(record.getMessage()) < 400
        for record in caplog.records
    )
