"""The nodes' loops on a port that is none: no ROS, no waiting."""

from __future__ import annotations

import logging
import math
from typing import Any, cast

import numpy as np
import pytest

from tests.ros_fakes import FakeClock, FakePort, make
from tests.test_ros_pilot import BEND, law
from validation.plants.profile import Profile, make_plant
from validation.ros import messages as msg
from validation.ros.commands import LOCK_TOPIC, CommandGate
from validation.ros.control import STOP_TIME, ControlNode, RobotTopics, connect_control
from validation.ros.pilot import Phase, Pilot, PilotSettings, StoppedError
from validation.ros.robot import SensorSettings, SimulatedRobot
from validation.ros.sim import (
    FILTERED_TOPIC,
    PLACE_TOPIC,
    POSE_TOPIC,
    PUBLISH_RATES,
    SET_POSE_TOPIC,
    TF_TOPIC,
    WHEELS_TOPIC,
    SimNode,
    connect_simulation,
)
from validation.simulator.plant import MujocoPlant

COMMAND = "/cmd_vel"


def twist(v: float, w: float = 0.0) -> Any:
    message = make("geometry_msgs/Twist")
    msg.fill_twist(message, v, w)
    return message


@pytest.fixture(scope="module")
def plant(lab: Profile) -> MujocoPlant:
    return cast(MujocoPlant, make_plant(lab, "mujoco"))


def simulation(plant: MujocoPlant, overshoot: float = 0.0) -> tuple[SimNode, FakePort]:
    clock = FakeClock(overshoot)
    port = FakePort(clock)
    connect_simulation(port)
    robot = SimulatedRobot(plant, SensorSettings(noise=False))
    return SimNode(port, robot, CommandGate(), clock=clock, sleep=clock.sleep), port


def speeds(port: FakePort) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [s] and speeds [m/s] by the tracking system."""
    seen = [msg.read_pose_stamped(m) for _, m in port.of(POSE_TOPIC)]
    t, xy = np.array([s.stamp for s in seen]), np.array([(s.x, s.y) for s in seen])
    return t[1:], np.hypot(*np.diff(xy, axis=0).T) / np.diff(t)


def test_every_topic_comes_at_its_rate_and_its_instants(plant: MujocoPlant) -> None:
    node, port = simulation(plant, overshoot=3e-4)
    node.run(2.0)
    assert port.counts() == {
        "/tf_static": 1,
        "/robot_description": 1,
        **{topic: round(2.0 * f) for topic, f in PUBLISH_RATES.items()},
    }
    stamps = np.array([msg.get_stamp(m.header.stamp) for _, m in port.of(POSE_TOPIC)])
    assert np.all((stamps - np.arange(1, 241) / 120.0 >= -1e-9) & (stamps - np.arange(1, 241) / 120.0 < plant.dt))
    sent = np.array([t for t, _ in port.of(POSE_TOPIC)])
    assert np.all((sent - stamps >= 0.0) & (sent - stamps < 1e-3))
    assert node.report.pace is not None
    assert abs(node.report.pace.error) < 1e-4
    assert "/clock 100.00 Hz" in node.report.lines()[1]


def test_odometry_and_tf_say_the_same(plant: MujocoPlant) -> None:
    node, port = simulation(plant)
    port.plan(COMMAND, 0.0, twist(0.3, 0.3))
    node.run(1.0)
    (_, tf), (_, odometry) = port.of(TF_TOPIC)[-1], port.of(FILTERED_TOPIC)[-1]
    (placed,) = tf.transforms
    assert placed.transform.translation.x == odometry.pose.pose.position.x
    assert placed.transform.rotation.z == odometry.pose.pose.orientation.z
    assert placed.header.stamp == odometry.header.stamp
    assert port.of(WHEELS_TOPIC)[-1][1].child_frame_id == "base_link"


def test_a_stream_that_falls_silent_stops_the_robot_and_it_is_said(
    plant: MujocoPlant, caplog: pytest.LogCaptureFixture
) -> None:
    node, port = simulation(plant)
    for k in range(30):
        port.plan(COMMAND, 0.05 * k, twist(0.25))
    with caplog.at_level(logging.INFO, "validation"):
        node.run(3.0)
    t, v = speeds(port)
    assert v[np.searchsorted(t, 1.6)] > 0.2
    last, drive = 1.45, plant.drive
    told = last + 0.25 + drive.hold  # as late as its own 20 Hz reads it
    rest = told + drive.delay_v + 0.25 / drive.acceleration_v + 5 * drive.wheel_lag
    assert np.all(v[t > rest] < 0.01)
    assert rest - last < 0.5 + drive.delay_v + 0.25 / drive.acceleration_v
    assert "nothing on /cmd_vel for 0.25 s: the robot brakes" in caplog.text
    assert "the robot stands" in caplog.text


def test_an_emergency_stop_holds_until_it_is_released(plant: MujocoPlant) -> None:
    node, port = simulation(plant)
    for k in range(100):
        port.plan(COMMAND, 0.05 * k, twist(0.25))
    for at, locked in ((1.0, True), (3.0, False)):
        stop = make("std_msgs/Bool")
        stop.data = locked
        port.plan(LOCK_TOPIC, at, stop)
    node.run(4.9)
    t, v = speeds(port)
    assert np.all(v[(t > 2.0) & (t < 3.0)] < 0.01)
    assert np.all(v[(t > 0.8) & (t < 1.0)] > 0.2)
    assert np.all(v[t > 4.0] > 0.2)


def test_set_pose_moves_the_filter(plant: MujocoPlant, caplog: pytest.LogCaptureFixture) -> None:
    node, port = simulation(plant)
    for k, (frame, w) in enumerate((("map", 1.0), ("odom", math.nan), ("/odom", math.cos(0.25)))):
        wanted = make("geometry_msgs/PoseWithCovarianceStamped")
        msg.set_pose(wanted.pose.pose, 1.0, 2.0, 0.5)
        wanted.header.frame_id, wanted.pose.pose.orientation.w = frame, w
        port.plan(SET_POSE_TOPIC, 0.02 * k, wanted)
    with caplog.at_level(logging.WARNING, "validation"):
        node.run(0.1)
    seen = msg.read_odometry(port.of(FILTERED_TOPIC)[-1][1])
    assert (seen.x, seen.y, seen.yaw) == pytest.approx((1.0, 2.0, 0.5), abs=1e-3)
    assert port.inbox.tally.refused[SET_POSE_TOPIC] == 2
    assert "a pose in the frame 'map'" in caplog.text


def test_the_pose_estimate_of_rviz_puts_the_robot_there(plant: MujocoPlant, caplog: pytest.LogCaptureFixture) -> None:
    node, port = simulation(plant)
    for at, frame in ((0.5, "odom"), (0.6, "map")):
        wanted = make("geometry_msgs/PoseWithCovarianceStamped")
        wanted.header.frame_id = frame
        msg.set_pose(wanted.pose.pose, 4.0 * at, 1.0, 0.3)
        port.plan(PLACE_TOPIC, at, wanted)
    for k in range(10):
        port.plan(COMMAND, 0.05 * k, twist(0.5))
    with caplog.at_level(logging.INFO, "validation"):
        node.run(1.0)
    for topic, read in (
        (FILTERED_TOPIC, msg.read_odometry),
        (WHEELS_TOPIC, msg.read_odometry),
        (POSE_TOPIC, msg.read_pose_stamped),
    ):
        sent = [read(m) for _, m in port.of(topic)]
        assert np.all(np.diff([s.stamp for s in sent]) > 0.0)
        assert (sent[-1].x, sent[-1].y, sent[-1].yaw) == pytest.approx((2.0, 1.0, 0.3), abs=0.15)
    assert "the robot was put to x 2.000 m" in caplog.text
    assert "a pose in the frame 'map'" in caplog.text


def test_a_machine_that_is_too_slow_is_said_once(plant: MujocoPlant, caplog: pytest.LogCaptureFixture) -> None:
    node, port = simulation(plant)
    ordinary = port.send

    def slow(topic: str, fill: Any) -> None:
        port.clock.now += 0.05 if topic == POSE_TOPIC and 100.2 < port.clock() < 100.5 else 0.0
        ordinary(topic, fill)

    port.send = slow  # type: ignore[method-assign]
    with caplog.at_level(logging.INFO, "validation"):
        node.run(2.0)
    assert caplog.text.count("behind real time") == 1
    assert caplog.text.count("at real time again") == 1


# --- the controller ---


def controller(
    lab: Profile, *, topics: RobotTopics | None = None, patience: float = 5.0
) -> tuple[ControlNode, FakePort, Pilot]:
    clock = FakeClock()
    port = FakePort(clock)
    pilot = Pilot(law(lab), BEND, PilotSettings())
    connect_control(port, topics or RobotTopics())
    return ControlNode(port, pilot, topics or RobotTopics(), clock=clock, patience=patience), port, pilot


def odometry(t: float, x: float = 0.0, v: float = 0.0) -> Any:
    message = make("nav_msgs/Odometry")
    msg.fill_odometry(message, t, np.array([x, 0.0, 0.0]), (v, 0.0), np.eye(3), np.eye(3))
    return message


def commands(port: FakePort) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and (M, 2) commands that were sent."""
    sent = port.of(COMMAND)
    return np.array([t for t, _ in sent]), np.array([msg.read_twist(m) for _, m in sent])


def speak(port: FakePort, until: float, begin: float = 0.0) -> None:
    for k in range(round((until - begin) * 50)):
        t = begin + 0.02 * k
        port.plan(FILTERED_TOPIC, t, odometry(t + 1.0, 0.2 * t))


def test_commands_come_at_20_hz_and_end_in_a_stop(lab: Profile) -> None:
    node, port, pilot = controller(lab)
    speak(port, 10.0)
    node.run()
    assert pilot.phase is Phase.ARRIVED
    t, sent = commands(port)
    driving = t < t[-1] - STOP_TIME - 0.05
    assert np.count_nonzero(driving) >= 20.0 * BEND.duration - 2
    np.testing.assert_allclose(np.diff(t[driving]), 0.05, atol=1e-9)
    assert np.all(sent[t >= t[-1] - STOP_TIME + 0.06] == 0.0)
    assert np.count_nonzero(np.all(sent == 0.0, axis=1)) >= 9


def test_a_feedback_that_falls_silent_stops_the_robot(lab: Profile, caplog: pytest.LogCaptureFixture) -> None:
    node, port, _ = controller(lab)
    speak(port, 2.0)
    with caplog.at_level(logging.INFO, "validation"), pytest.raises(StoppedError, match="no feedback"):
        node.run()
    t, sent = commands(port)
    first_stop = t[np.flatnonzero(np.any(sent != 0.0, axis=1))[-1] + 1]
    assert 2.4 < first_stop < 1.98 + 0.5 + 0.051
    assert "the robot is stopped: no feedback" in caplog.text


def test_feedback_that_is_not_finite_is_called_so_and_not_missing(lab: Profile, caplog: pytest.LogCaptureFixture) -> None:
    node, port, _ = controller(lab)
    speak(port, 1.0)
    for k in range(100):
        port.plan(FILTERED_TOPIC, 1.0 + 0.02 * k, odometry(2.0 + 0.02 * k, math.nan))
    why = r"no feedback that can be used for 0\.5\d s: \d\d messages on \S+ were refused, .*position\.x is nan"
    with caplog.at_level(logging.INFO, "validation"), pytest.raises(StoppedError, match=why):
        node.run()
    assert "messages refused: /platform/odom/filtered" in caplog.text


def test_a_robot_whose_feedback_cannot_be_used_is_not_waited_for_as_silent(lab: Profile) -> None:
    node, port, _ = controller(lab, patience=2.0)
    for k in range(200):
        port.plan(FILTERED_TOPIC, 0.02 * k, odometry(2.0 + 0.02 * k, 1e300))
    why = r"no robot to drive after 2 s: \d+ messages on /platform/odom/filtered were refused, .* position\.x is 1e\+300"
    with pytest.raises(StoppedError, match=why):
        node.run()


def test_a_clock_that_is_set_back_stops_the_robot(lab: Profile) -> None:
    """As when the simulation is started anew: its stamps begin at zero again."""
    node, port, _ = controller(lab)
    speak(port, 1.0)
    for k in range(50):
        port.plan(FILTERED_TOPIC, 1.0 + 0.02 * k, odometry(0.02 * k))
    with pytest.raises(StoppedError, match=r"the stamps of the feedback jumped by -1\.98"):
        node.run()
    assert np.all(commands(port)[1][-9:] == 0.0)


def test_ctrl_c_stops_the_robot(lab: Profile) -> None:
    node, port, _ = controller(lab)
    speak(port, 10.0)
    ordinary = port.send

    def interrupted(topic: str, fill: Any) -> None:
        if port.clock() > 101.0 and not any(t > 1.0 for t, _ in port.of(COMMAND)):
            ordinary(topic, fill)
            raise KeyboardInterrupt
        ordinary(topic, fill)

    port.send = interrupted  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        node.run()
    t, sent = commands(port)
    assert np.all(sent[t > 1.06] == 0.0)
    assert np.count_nonzero(t > 1.06) >= 9


def test_no_robot_no_drive(lab: Profile) -> None:
    node, port, _ = controller(lab, patience=2.0)
    with pytest.raises(StoppedError, match="no robot to drive after 2 s: no feedback yet"):
        node.run()
    assert port.sent == [], "a robot that was not driven is not stopped either: somebody else may drive it"


def test_nobody_is_driven_who_does_not_listen(lab: Profile) -> None:
    node, port, pilot = controller(lab)
    speak(port, 10.0)
    port.robot_at = 101.0
    node.run()
    assert 1.0 <= commands(port)[0][0] < 1.2
    assert pilot.phase is Phase.ARRIVED


def test_the_law_may_see_the_tracking_systems_pose(lab: Profile) -> None:
    node, port, pilot = controller(lab, topics=RobotTopics(law_by_pose=True))
    for k in range(150):
        t = 0.02 * k
        port.plan(FILTERED_TOPIC, t, odometry(t + 1.0, 99.0))
        seen = make("geometry_msgs/PoseStamped")
        msg.fill_pose_stamped(seen, t + 1.0, "world", np.array([5.0 + 0.1 * t, 0.0, 0.0]))
        port.plan(POSE_TOPIC, t + 0.005, seen)
    with pytest.raises(StoppedError, match="no feedback"):
        node.run()
    run = pilot.run()
    start = BEND.start
    way = run.columns("seen_x", "seen_y")[-1] - (start.x, start.y)
    assert math.hypot(*way) == pytest.approx(0.1 * run.t[-1], rel=1e-6)
    assert pilot.tracked
