"""The node that drives a robot on the topics of Clearpath's robots along a reference, and stops it when in doubt."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from ssmr.errors import SsmrError
from validation.ros import messages as msg
from validation.ros.commands import STAND_STILL, Twist
from validation.ros.inbox import Received
from validation.ros.messages import Seen
from validation.ros.pilot import FRESH, Phase, Pilot, StoppedError
from validation.ros.port import Port

_logger = logging.getLogger(__name__)

START_PATIENCE = 30.0
"""Time for which a robot is waited for [s]."""
STOP_TIME = 0.5
"""Time for which the robot is told to stand [s]: ten commands at 20 Hz."""
_FEEDBACK_KEPT = 32
"""Messages of the odometry that wait for the loop: more than come within the age at which they are too old."""
_POSES_KEPT = 128
"""Poses of a tracking system that wait, about a second of them: they judge the drive."""
SLACK = 0.004
"""Delay of the velocity loop behind the first message of the position loop [s], so that later messages may be a bit late."""


@dataclass(frozen=True)
class RobotTopics:
    """Topics of robot and tracking system."""

    odometry: str = "/platform/odom/filtered"
    """Topic of nav_msgs/Odometry: speeds, and the pose unless `law_by_pose`."""
    pose: str = "/vrpn_mocap/husky/pose"
    """Topic of a tracking system's geometry_msgs/PoseStamped, by which the drive is judged if it is there."""
    command: str = "/cmd_vel"
    """Topic of geometry_msgs/Twist, on which the robot listens."""
    law_by_pose: bool = False
    """Let the controller see the tracking system's pose in place of the odometry's."""


class ControlNode:
    """The loop of the node: messages go to the pilot as they come, commands to the robot at their instants."""

    def __init__(
        self,
        port: Port,
        pilot: Pilot,
        topics: RobotTopics,
        *,
        clock: Callable[[], float] = time.monotonic,
        patience: float = START_PATIENCE,
    ) -> None:
        """Prepare the loop; nothing is sent yet.

        Args:
            port: an open port with the topics of `connect_control`.
            pilot: the tracker.
            topics: names of the topics.
            clock: function that returns monotonic time [s], the one in which arrivals are given.
            patience: time for which a robot to drive is waited for [s].
        """
        self._port, self._pilot, self._topics, self._clock, self._patience = port, pilot, topics, clock, patience
        self._speeds: Seen | None = None
        self._feedback = topics.pose if topics.law_by_pose else topics.odometry
        self.drove = 0.0
        """Time for which the robot was driven [s]."""
        self._speeds_at = -math.inf

    def run(self) -> None:
        """Wait for the robot, drive it, and stop it, however the drive ends.

        Raises:
            StoppedError: no robot came, or it had to be stopped.
            KeyboardInterrupt: the user interrupted; the robot was told to stand before.
        """
        try:
            self._wait()  # until then the robot is somebody else's: nothing is sent
            self._drive_and_stop()
        finally:
            for line in self._port.inbox.tally.lines():
                self._port.notices.add(line, line, logging.INFO)
            self._tell(all_of_them=True)

    def _tell(self, *, all_of_them: bool = False) -> None:
        self._port.notices.tell(_logger, self._clock(), all_of_them=all_of_them)

    def _drive_and_stop(self) -> None:
        _logger.info("driving")
        began = self._clock()
        try:
            self._drive()
            _logger.info("arrived: the robot is stopped")
        except SsmrError as error:
            _logger.error("the robot is stopped: %s", error)
            raise
        except KeyboardInterrupt:
            _logger.warning("interrupted: the robot is stopped")
            raise
        finally:
            self.drove = self._clock() - began
            self._stop()

    def _wait(self) -> None:
        """Wait until the robot listens and the pilot is ready to drive."""
        until, told = self._clock() + self._patience, ""
        _logger.info("waiting for the robot on %s", self._topics.odometry)
        while self._pilot.phase is Phase.WAITING:
            heard = self._port.listeners(self._topics.command) > 0
            why = self._why_waiting() if heard else f"nobody listens to {self._topics.command}"
            if self._clock() > until:
                raise StoppedError(f"no robot to drive after {self._patience:g} s: {why}")
            got = self._port.receive(0.1)
            if heard:
                self._take(got)
            self._tell()  # what comes before somebody listens is old when it counts
            if why != told and self._clock() > until - self._patience + 1.0:
                told = why
                self._port.notices.add("waiting", f"still waiting: {told}", logging.INFO)

    def _why_waiting(self) -> str:
        return self._refused() or self._pilot.why_waiting

    def _refused(self) -> str:
        """Return what is wrong with feedback that comes and cannot be used; empty where nothing is."""
        found = [self._port.inbox.refusals(topic) for topic in dict.fromkeys((self._feedback, self._topics.odometry))]
        return "; ".join(filter(None, found))

    def _drive(self) -> None:
        """Take messages as they come, and send commands at absolute deadlines."""
        period, start, k = self._pilot.settings.period, self._clock() + min(SLACK, 0.1 * self._pilot.settings.period), 0
        while self._pilot.phase is Phase.DRIVING:
            left = start + k * period - self._clock()
            if left > 0.0:
                self._take(self._port.receive(left))
                continue
            self._send(self._pilot.command(self._clock(), self._refused()))
            self._tell()
            # a deadline that was slept through is not made up for
            k = max(k + 1, math.floor((self._clock() - start) / period))

    def _take(self, got: Received | None) -> None:
        """Give a message to the pilot."""
        if got is None:
            return
        seen: Seen = got.message
        if got.topic == self._topics.odometry:
            self._speeds, self._speeds_at = seen, got.arrival
            if not self._topics.law_by_pose:
                self._pilot.see(seen, got.arrival)
        elif got.topic == self._topics.pose:
            if not self._pilot.track(seen):
                self._port.notices.add("tracked", f"{got.topic}: stamp {seen.stamp:.3f} s does not go on from those before")
            if self._topics.law_by_pose and self._speeds is not None and got.arrival - self._speeds_at <= FRESH:
                self._pilot.see(seen._replace(v=self._speeds.v, w=self._speeds.w), got.arrival)

    def _send(self, command: Twist) -> None:
        self._port.send(self._topics.command, lambda m: msg.fill_twist(m, *command))

    def _stop(self) -> None:
        """Tell the robot to stand for a while, even if interrupted meanwhile."""
        until, period = self._clock() + STOP_TIME, self._pilot.settings.period
        while self._clock() < until:
            self._send(STAND_STILL)
            next_at = self._clock() + period
            while (left := next_at - self._clock()) > 0.0:
                got = self._port.receive(left)
                if got is not None and got.topic == self._topics.pose:  # for the record
                    self._pilot.track(got.message)


def connect_control(port: Port, topics: RobotTopics) -> None:
    """Make the controller's topics on a port."""
    port.advertise(topics.command, "geometry_msgs/Twist")
    port.listen(topics.odometry, "nav_msgs/Odometry", msg.read_odometry, _FEEDBACK_KEPT)
    port.listen(topics.pose, "geometry_msgs/PoseStamped", msg.read_pose_stamped, _POSES_KEPT)
