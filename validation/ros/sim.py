"""The node that puts the MuJoCo Husky where the real one stood: its topics, at their rates, in real time."""

from __future__ import annotations

import logging
import math
import threading
import time
from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ssmr.errors import SsmrError
from validation.ros import messages as msg
from validation.ros.commands import LOCK_TOPIC, SOURCES, STILL, CommandGate, Twist
from validation.ros.pacing import Pace, Pacer, instants
from validation.ros.robot import SENSOR_RATE, SimulatedRobot

log = logging.getLogger(__name__)

FILTERED = "/odometry/filtered"
WHEELS = "/husky_velocity_controller/odom"
IMU = "/imu/data"
POSE = "/vrpn_client_node/husky/pose"
TF = "/tf"
TF_STATIC = "/tf_static"
CLOCK = "/clock"
SET_POSE = "/set_pose"
SIM_TIME = "/use_sim_time"

KINDS = {
    FILTERED: "nav_msgs/Odometry",
    WHEELS: "nav_msgs/Odometry",
    IMU: "sensor_msgs/Imu",
    POSE: "geometry_msgs/PoseStamped",
    TF: "tf2_msgs/TFMessage",
    CLOCK: "rosgraph_msgs/Clock",
}
"""What is published, by topic."""
RATES = {CLOCK: 100.0, FILTERED: SENSOR_RATE, WHEELS: SENSOR_RATE, IMU: SENSOR_RATE, TF: SENSOR_RATE, POSE: 120.0}
"""How often [Hz]: Tab. 3.5, Sec. 4.2; a tracking system's 120."""
IMU_AT = (0.19, 0.0, 0.149)
"""Where the IMU sits in the base [m]; models/husky.xml."""
BEHIND = 0.1
"""A simulation so late is not at real time any more, and says so [s]."""
REST_PATIENCE = 5.0
"""So long a robot that does not come to rest is waited for [s]."""
LEAVE_AFTER = 2.0
"""So long the master must have been gone before the node leaves [s]: a busy one may come back, and listeners see the robot
stand."""


class Channel(Protocol):
    """What a node wants of its port."""

    master_gone: threading.Event
    """Set while the master does not answer."""

    @property
    def master(self) -> str:
        """Where it is, or was."""
        ...

    def make(self, kind: str) -> Any:
        """An empty message of `package/Type`."""
        ...

    def send(self, topic: str, fill: Callable[[Any], None]) -> None:
        """Send a message that `fill` has filled."""
        ...

    def receive(self, timeout: float = 0.0) -> Any:
        """The next message (topic, arrival, message), waited for at most `timeout` [s]; None where none came."""
        ...

    def listeners(self, topic: str) -> int:
        """How many listen to a topic that is sent on."""
        ...

    def call(self) -> Any:
        """The next call of set_pose (request, answer); None where there is none."""
        ...


class MasterGoneError(SsmrError):
    """The master does not answer any more; the robot was stopped."""


@dataclass
class SimReport:
    """What a simulation has to say at its end."""

    pace: Pace | None = None
    """None where it ended before it began."""
    sent: Counter[str] = field(default_factory=Counter)
    """Messages by topic."""
    waits: array[float] = field(default_factory=lambda: array("d"))
    """From each command's arrival to the first physics step that can feel it [s]."""
    simulated: float = 0.0
    """[s]"""

    def lines(self) -> list[str]:
        """In plain words."""
        if self.pace is None or self.simulated <= 0.0:
            return ["nothing was simulated"]
        rates = ", ".join(f"{topic} {n / self.simulated:.2f} Hz" for topic, n in sorted(self.sent.items()))
        found = [self.pace.text(), f"rates: {rates}"]
        if self.waits:
            median, p95 = 1e3 * np.percentile(self.waits, [50.0, 95.0])
            found.append(f"commands: {len(self.waits)}, taken up {median:.1f} ms after they came (median), {p95:.1f} (95 %)")
        return found


class SimNode:
    """The loop: commands in, physics on, sensors out, each at its instant."""

    def __init__(
        self,
        port: Channel,
        robot: SimulatedRobot,
        gate: CommandGate,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        stamp_offset: float = 0.0,
    ) -> None:
        """Hold everything ready.

        Args:
            port: an open port whose topics are made, see `connect`.
            robot: the robot.
            gate: who may command it.
            clock: monotonic time [s]; the one that arrivals are counted by.
            sleep: waits [s].
            stamp_offset: what simulated time is stamped as zero [s]; not zero where stamps are to be the wall's.
        """
        self._port, self._robot, self._gate = port, robot, gate
        self._clock, self._sleep, self._offset = clock, sleep, stamp_offset
        self._senders: dict[str, Callable[[Any], None]] = {
            FILTERED: lambda m: msg.fill_odometry(m, self._stamp, *robot.believed()),
            WHEELS: lambda m: msg.fill_odometry(m, self._stamp, *robot.wheels()),
            IMU: lambda m: msg.fill_imu(m, self._stamp, *robot.imu()),
            POSE: lambda m: msg.fill_pose_stamped(m, self._stamp, msg.WORLD, robot.pose),
            CLOCK: lambda m: msg.set_stamp(m.clock, self._stamp),
        }
        self.report = SimReport()
        self._told_late = False
        self._braking_since: float | None = None
        self._gone_at: float | None = None

    @property
    def _stamp(self) -> float:
        return self._robot.time + self._offset

    def run(self, duration: float = math.inf) -> None:
        """Simulate for `duration` [s]; the report is complete however this ends.

        Raises:
            MasterGoneError: the master is gone; the robot stands.
            DivergedError: the simulator gave up.
            KeyboardInterrupt: as it comes.
        """
        robot, pacer = self._robot, Pacer(self._clock, self._sleep)
        try:
            for step, due in instants(RATES, robot.dt):
                if step * robot.dt > duration + 1e-9:
                    return
                self._take_in()
                command = self._gate.command(self._clock())
                for line in self._gate.news():
                    log.info("%.2f s: %s", robot.time, line)
                robot.advance(step - robot.steps, command)
                if any(topic in due for topic in (FILTERED, WHEELS, IMU, TF)):
                    robot.sense()
                self._watch(pacer.wait(robot.time))
                self._send(due)
                self._tell_rest(command)
                self._leave()
        finally:
            self.report.simulated = robot.time
            if robot.steps:
                self.report.pace = pacer.pace()

    def _take_in(self) -> None:
        """Everything that has come: commands, locks, poses for the filter."""
        now = self._clock()
        while (got := self._port.receive()) is not None:
            if got.topic == LOCK_TOPIC:
                self._gate.lock(bool(got.message.data))
            elif got.topic == SET_POSE:
                fault = self._set_pose(got.message)
                if fault:
                    log.warning("%s: %s", SET_POSE, fault)
            elif self._gate.offer(got.topic, msg.read_twist(got.message), got.arrival):
                self.report.waits.append(now - got.arrival)
        while (call := self._port.call()) is not None:
            call.answer(self._set_pose(call.request.pose))

    def _set_pose(self, message: Any) -> str:
        """Tell the filter where it is; what is wrong with that, or nothing."""
        frame = message.header.frame_id.lstrip("/")
        if frame not in ("", msg.ODOM):
            return f"a pose in the frame '{frame}'; the filter's is '{msg.ODOM}'"
        try:
            at = message.pose.pose.position
            pose = np.array([at.x, at.y, msg.get_yaw(message.pose.pose.orientation)])
            self._robot.set_pose(pose, msg.planar_covariance(message.pose.covariance))
        except ValueError as error:
            return str(error)
        log.info("%.2f s: the filter was set to x %.3f m, y %.3f m, yaw %.3f rad", self._robot.time, *pose)
        return ""

    def _send(self, due: tuple[str, ...]) -> None:
        for topic in due:
            if topic == TF:
                self._port.send(TF, self._fill_tf)
            else:
                self._port.send(topic, self._senders[topic])
            self.report.sent[topic] += 1

    def _fill_tf(self, message: Any) -> None:
        x, y, yaw = map(float, self._robot.believed()[0])
        placed = self._port.make("geometry_msgs/TransformStamped")
        msg.fill_transform(placed, self._stamp, (msg.ODOM, msg.BASE), (x, y, 0.0), yaw)
        message.transforms = [placed]

    def _watch(self, late: float) -> None:
        """Say once when time runs away, and once when it is caught up with."""
        if late > BEHIND and not self._told_late:
            log.warning("%.2f s: %.2f s behind real time: this machine is too slow, or busy", self._robot.time, late)
            self._told_late = True
        elif late < 0.1 * BEHIND and self._told_late:
            log.info("%.2f s: at real time again", self._robot.time)
            self._told_late = False

    def _tell_rest(self, command: Twist) -> None:
        """Say when a robot that was told to stand does."""
        now = self._robot.time
        if command != STILL:
            self._braking_since = None if self._robot.resting else now
        elif self._braking_since is not None and self._robot.resting:
            log.info("%.2f s: the robot stands, %.2f s after it was told to", now, now - self._braking_since)
            self._braking_since = None

    def _leave(self) -> None:
        """Stop while the master is gone, and leave where it does not come back."""
        now, master = self._robot.time, self._port.master
        if not self._port.master_gone.is_set():
            if self._gone_at is not None:
                self._gate.lock(False, f"the ROS master at {master} is there again")
                self._gone_at = None
            return
        if self._gone_at is None:
            self._gone_at = now
            self._gate.lock(True, f"the ROS master at {master} is gone")
        stands = self._robot.resting
        if now > self._gone_at + (LEAVE_AFTER if stands else REST_PATIENCE):
            raise MasterGoneError(
                f"the ROS master at {master} is gone; the robot {'stands' if stands else 'does NOT stand'}"
            )


def connect(port: Any) -> None:
    """Make the simulated Husky's topics and service on a port."""
    for topic, kind in KINDS.items():
        port.advertise(topic, kind)
    port.advertise(TF_STATIC, "tf2_msgs/TFMessage", latch=True)

    mount = port.make("geometry_msgs/TransformStamped")
    msg.fill_transform(mount, 0.0, (msg.BASE, msg.IMU), IMU_AT, 0.0)
    port.send(TF_STATIC, lambda message: setattr(message, "transforms", [mount]))
    for source in SOURCES:
        port.listen(source.topic, "geometry_msgs/Twist")
    port.listen(LOCK_TOPIC, "std_msgs/Bool")
    port.listen(SET_POSE, "geometry_msgs/PoseWithCovarianceStamped")
    port.serve_set_pose(SET_POSE)
