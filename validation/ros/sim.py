"""The node that simulates a robot with MuJoCo: its topics, at their rates, in real time."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ssmr.types import FloatArray
from validation.ros import messages as msg
from validation.ros.commands import LOCK_TOPIC, STAND_STILL, CommandGate, Twist
from validation.ros.inbox import Tally
from validation.ros.pacing import Excerpt, Pace, Pacer, instants
from validation.ros.port import Port
from validation.ros.robot import SENSOR_RATE, SimulatedRobot
from validation.simulator.description import WHEELS, Robot, load_robot
from validation.simulator.urdf_writing import urdf_text

_logger = logging.getLogger(__name__)

FILTERED_TOPIC = "/platform/odom/filtered"
WHEELS_TOPIC = "/platform/odom"
"""Topic of wheel odometry."""
_IMU_TOPIC = "/sensors/imu_0/data"
POSE_TOPIC = "/vrpn_mocap/husky/pose"
"""Topic of the tracking system for the usual robot; `Graph.topic` has those of others."""
TF_TOPIC = "/tf"
_TF_STATIC_TOPIC = "/tf_static"
_CLOCK_TOPIC = "/clock"
SET_POSE_TOPIC = "/set_pose"
PLACE_TOPIC = "/initialpose"
"""Topic of RViz' 2D Pose Estimate."""
_DESCRIPTION_TOPIC = "/robot_description"
_JOINT_TOPIC = "/platform/joint_states"

MESSAGE_TYPES = {
    FILTERED_TOPIC: "nav_msgs/Odometry",
    WHEELS_TOPIC: "nav_msgs/Odometry",
    _IMU_TOPIC: "sensor_msgs/Imu",
    _JOINT_TOPIC: "sensor_msgs/JointState",
    POSE_TOPIC: "geometry_msgs/PoseStamped",
    TF_TOPIC: "tf2_msgs/TFMessage",
    _CLOCK_TOPIC: "rosgraph_msgs/Clock",
}
"""Message type of each topic that is published at a rate."""
_SENSOR_TOPICS = (FILTERED_TOPIC, WHEELS_TOPIC, _IMU_TOPIC, _JOINT_TOPIC, TF_TOPIC)
PUBLISH_RATES = {_CLOCK_TOPIC: 100.0, **dict.fromkeys(_SENSOR_TOPICS, SENSOR_RATE), POSE_TOPIC: 120.0}
"""Rate of each topic [Hz]: Tab. 3.5, Sec. 4.2; 120 Hz for the tracking system."""
_BEHIND = 0.1
"""Lateness from which the simulation reports that it is not at real time [s]."""
_MOST_BEHIND = 2.0
"""Lateness that is caught up with [s], as after the stalls of a busy machine; a greater one is dropped. After a long time on
too slow a machine, the simulation would otherwise run fast for as long, once the machine has time again."""
_LOCKS_KEPT = 32
"""Messages of the lock that wait for the loop: none of them may be lost that locks. Of other topics the last one counts."""


@dataclass
class SimReport:
    """Report of a simulation."""

    pace: Pace | None = None
    """Lateness of its loop; None if nothing was simulated."""
    sent: Counter[str] = field(default_factory=Counter)
    """Number of messages by topic."""
    waits: Excerpt = field(default_factory=Excerpt)
    """Time from each command's arrival to the first physics step that uses it [s]."""
    simulated: float = 0.0
    """Time simulated [s]."""
    tally: Tally = field(default_factory=Tally)
    """Numbers of messages that came."""

    def lines(self) -> list[str]:
        """Return the report as sentences."""
        if self.pace is None or self.simulated <= 0.0:
            return ["nothing was simulated"]
        rates = ", ".join(f"{topic} {n / self.simulated:.2f} Hz" for topic, n in sorted(self.sent.items()))
        found = [self.pace.text(), f"rates: {rates}"]
        if self.waits.count:
            median, p95 = 1e3 * np.percentile(self.waits.kept, [50.0, 95.0])
            found.append(
                f"commands: {self.waits.count}, taken up {median:.1f} ms after they came (median), {p95:.1f} (95 %)"
            )
        return found + self.tally.lines()


class SimNode:
    """The loop of the node: takes commands, advances the physics and sends sensor messages, each at its instant."""

    def __init__(
        self,
        port: Port,
        robot: SimulatedRobot,
        gate: CommandGate,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        stamp_offset: float = 0.0,
    ) -> None:
        """Prepare the loop.

        Args:
            port: an open port with the topics of `connect_simulation`.
            robot: the robot.
            gate: the choice of its command.
            clock: function that returns monotonic time [s], the one in which arrivals are given.
            sleep: function that waits [s].
            stamp_offset: stamp of simulated time zero [s]; not zero if stamps are to be wall time.
        """
        self._port, self._robot, self._gate = port, robot, gate
        topics = (*MESSAGE_TYPES, LOCK_TOPIC, SET_POSE_TOPIC, PLACE_TOPIC)
        self._names = {topic: port.graph.topic(topic, robot.description.name) for topic in topics}
        self._joints = [port.graph.joint(wheel) for wheel in WHEELS]
        self._clock, self._sleep, self._offset = clock, sleep, stamp_offset
        self._senders: dict[str, Callable[[Any], None]] = {
            FILTERED_TOPIC: lambda m: msg.fill_odometry(m, self._stamp, *robot.believed()),
            WHEELS_TOPIC: lambda m: msg.fill_odometry(m, self._stamp, *robot.wheels()),
            _IMU_TOPIC: lambda m: msg.fill_imu(m, self._stamp, *robot.imu()),
            _JOINT_TOPIC: lambda m: msg.fill_joints(m, self._stamp, self._joints, *robot.joints()),
            POSE_TOPIC: lambda m: msg.fill_pose_stamped(m, self._stamp, msg.WORLD, robot.pose),
            _CLOCK_TOPIC: lambda m: msg.set_stamp(m.clock, self._stamp),
            TF_TOPIC: self._fill_tf,
        }
        self.report = SimReport(tally=port.inbox.tally)
        self._pacer = Pacer(clock, sleep, _MOST_BEHIND)
        self._told_late = False
        self._braking_since: float | None = None

    @property
    def _stamp(self) -> float:
        passed = self._pacer.dropped if self._offset else 0.0  # the wall's time goes on while the robot's is dropped
        return self._robot.time + self._offset + passed

    def run(self, duration: float = math.inf) -> None:
        """Simulate for `duration` [s]; the report is complete however this ends.

        Raises:
            DivergedError: the simulator gave up.
            KeyboardInterrupt: the user interrupted.
        """
        port, robot = self._port, self._robot
        pacer = self._pacer = Pacer(self._clock, self._sleep, _MOST_BEHIND)
        try:
            for step, due in instants(PUBLISH_RATES, robot.dt):
                if step * robot.dt > duration + 1e-9:
                    return
                self._take_in()
                command = self._gate.command(self._clock())
                for line in self._gate.news():
                    self._say(line, line)
                robot.advance(step - robot.steps, command)
                if any(topic in due for topic in _SENSOR_TOPICS):
                    robot.sense()
                self._watch(pacer.wait(robot.time))
                for topic in due:
                    port.send(self._names[topic], self._senders[topic])
                    self.report.sent[self._names[topic]] += 1
                self._tell_rest(command)
                self._port.notices.tell(_logger, self._clock())
        finally:
            self._port.notices.tell(_logger, self._clock(), all_of_them=True)
            self.report.simulated = robot.time
            if robot.steps:
                self.report.pace = pacer.pace()

    def _say(self, kind: str, text: str, level: int = logging.INFO) -> None:
        self._port.notices.add(kind, f"{self._robot.time:.2f} s: {text}", level)

    def _take_in(self) -> None:
        """Take everything that has come: commands, locks, poses for the filter."""
        now = self._clock()
        for got in self._port.drain():
            if got.topic == self._names[LOCK_TOPIC]:
                self._gate.lock(got.message, got.topic)
            elif got.topic == self._names[SET_POSE_TOPIC]:
                self._set_pose(*got.message)
            elif got.topic == self._names[PLACE_TOPIC]:
                self._place(got.message[0])
            elif self._gate.offer(got.topic, got.message, got.arrival):
                self.report.waits.append(now - got.arrival)

    def _set_pose(self, pose: FloatArray, covariance: FloatArray) -> None:
        """Set the filter's (3,) pose [m, m, rad] with its (3, 3) covariance."""
        self._robot.set_pose(pose, covariance)
        self._say("set_pose", "the filter was set to x {:.3f} m, y {:.3f} m, yaw {:.3f} rad".format(*pose))

    def _place(self, pose: FloatArray) -> None:
        """Put the robot to rest at a (3,) pose [m, m, rad]."""
        self._robot.place(pose)
        self._say("place", "the robot was put to x {:.3f} m, y {:.3f} m, yaw {:.3f} rad of odom".format(*pose))

    def _fill_tf(self, message: Any) -> None:
        x, y, yaw = map(float, self._robot.believed()[0])
        placed = self._port.make("geometry_msgs/TransformStamped")
        msg.fill_transform(placed, self._stamp, (msg.ODOM, msg.BASE), (x, y, 0.0), yaw)
        message.transforms = [placed]

    def _watch(self, late: float) -> None:
        """Report once when the simulation falls behind, and once when it has caught up."""
        if late > _BEHIND and not self._told_late:
            self._say("late", f"{late:.2f} s behind real time: this machine is too slow, or busy", logging.WARNING)
            self._told_late = True
        elif late < 0.1 * _BEHIND and self._told_late:
            self._say("in time", "at real time again")
            self._told_late = False

    def _tell_rest(self, command: Twist) -> None:
        """Report when a robot that was told to stand does so."""
        now = self._robot.time
        if command != STAND_STILL:
            self._braking_since = None if self._robot.resting else now
        elif self._braking_since is not None and self._robot.resting:
            self._say("stands", f"the robot stands, {now - self._braking_since:.2f} s after it was told to")
            self._braking_since = None


def connect_simulation(port: Port, robot: Robot | None = None) -> None:
    """Open a simulated robot's topics on a port; a Husky's, if it is not given."""
    simulated = robot or load_robot()

    def name(topic: str) -> str:
        return port.graph.topic(topic, simulated.name)

    for topic, kind in MESSAGE_TYPES.items():
        port.advertise(name(topic), kind)
    mount = port.make("geometry_msgs/TransformStamped")
    msg.fill_transform(mount, 0.0, (msg.BASE, msg.IMU), simulated.geometry.imu, 0.0)
    port.advertise(name(_TF_STATIC_TOPIC), "tf2_msgs/TFMessage", latch=True)
    port.send(name(_TF_STATIC_TOPIC), lambda message: setattr(message, "transforms", [mount]))
    text = urdf_text(simulated, {wheel: port.graph.joint(wheel) for wheel in WHEELS}, msg.BASE, msg.IMU)
    port.advertise(name(_DESCRIPTION_TOPIC), "std_msgs/String", latch=True)
    port.send(name(_DESCRIPTION_TOPIC), lambda message: setattr(message, "data", text))
    for source in port.graph.sources:
        port.listen(source.topic, "geometry_msgs/Twist", msg.read_twist, 1)
    port.listen(name(LOCK_TOPIC), "std_msgs/Bool", msg.read_lock, _LOCKS_KEPT)
    port.listen(name(SET_POSE_TOPIC), "geometry_msgs/PoseWithCovarianceStamped", msg.read_set_pose, 1)
    port.listen(name(PLACE_TOPIC), "geometry_msgs/PoseWithCovarianceStamped", msg.read_set_pose, 1)
