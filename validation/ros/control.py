"""The node that drives whatever robot answers on a Husky's topics along a reference, and stops it when in doubt."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ssmr.errors import SsmrError
from validation.ros import messages as msg
from validation.ros.commands import STILL, Twist
from validation.ros.messages import Seen
from validation.ros.pilot import FRESH, Phase, Pilot, StoppedError
from validation.ros.sim import Channel

log = logging.getLogger(__name__)

START_PATIENCE = 30.0
"""So long a robot is waited for [s]."""
STOP_TIME = 0.5
"""For so long it is told to stand [s]: ten times at 20 Hz."""
SLACK = 0.004
"""By how much the velocity loop comes after the position loop's first message [s]: later ones have a little time to come."""


@dataclass(frozen=True)
class Topics:
    """Where robot and tracking system speak, and where the robot listens."""

    odometry: str = "/odometry/filtered"
    """nav_msgs/Odometry: speeds, and the pose unless `law_by_pose`."""
    pose: str = "/vrpn_client_node/husky/pose"
    """geometry_msgs/PoseStamped of a tracking system: what the drive is judged by, where it is there."""
    command: str = "/cmd_vel"
    """geometry_msgs/Twist."""
    law_by_pose: bool = False
    """Let the law see the tracking system's pose in the place of the odometry's."""


class ControlNode:
    """The loop: messages to the pilot as they come, commands at their instants."""

    def __init__(
        self,
        port: Channel,
        pilot: Pilot,
        topics: Topics,
        *,
        clock: Callable[[], float] = time.monotonic,
        patience: float = START_PATIENCE,
    ) -> None:
        """Hold everything ready; see `connect` for the port's topics.

        Args:
            port: an open port.
            pilot: who drives.
            topics: where.
            clock: monotonic time [s]; the one that arrivals are counted by.
            patience: how long to wait for a robot to drive [s].
        """
        self._port, self._pilot, self._topics, self._clock, self._patience = port, pilot, topics, clock, patience
        self._speeds: Seen | None = None
        self.drove = 0.0
        """How long the robot was driven [s]."""
        self._speeds_at = -math.inf

    def run(self) -> None:
        """Wait for the robot, drive it, and stop it, however this ends.

        Raises:
            StoppedError: no robot came, or it had to be stopped.
            KeyboardInterrupt: as it comes, once the robot was told to stand.
        """
        self._wait()  # until then the robot is somebody else's: nothing is sent
        log.info("driving")
        began = self._clock()
        try:
            self._drive()
            log.info("arrived: the robot is stopped")
        except SsmrError as error:
            log.error("the robot is stopped: %s", error)
            raise
        except KeyboardInterrupt:
            log.warning("interrupted: the robot is stopped")
            raise
        finally:
            self.drove = self._clock() - began
            self._stop()

    def _wait(self) -> None:
        """Until somebody listens, and the pilot is content."""
        until, told = self._clock() + self._patience, ""
        log.info("waiting for the robot on %s", self._topics.odometry)
        while self._pilot.phase is Phase.WAITING:
            heard = self._port.listeners(self._topics.command) > 0
            why = self._pilot.why_waiting if heard else f"nobody listens to {self._topics.command}"
            if self._clock() > until:
                raise StoppedError(f"no robot to drive after {self._patience:g} s: {why}")
            if heard:
                self._take(0.1)
            else:
                self._port.receive(0.1)  # what comes meanwhile is old when it counts
            if why != told and self._clock() > until - self._patience + 1.0:
                told = why
                log.info("still waiting: %s", told)

    def _drive(self) -> None:
        """Messages as they come, commands at absolute deadlines."""
        period, start, k = self._pilot.settings.period, self._clock() + min(SLACK, 0.1 * self._pilot.settings.period), 0
        while self._pilot.phase is Phase.DRIVING:
            left = start + k * period - self._clock()
            if left > 0.0:
                self._take(left)
                continue
            self._require_master()
            self._send(self._pilot.command(self._clock()))
            k = max(
                k + 1, math.floor((self._clock() - start) / period)
            )  # a deadline that was slept through is not made up for

    def _require_master(self) -> None:
        if self._port.master_gone.is_set():
            raise StoppedError(f"the ROS master at {self._port.master} is gone")

    def _take(self, timeout: float) -> None:
        """At most one message, waited for at most `timeout` [s]."""
        got = self._port.receive(timeout)
        if got is None:
            return
        try:
            if got.topic == self._topics.odometry:
                self._speeds, self._speeds_at = msg.read_odometry(got.message), got.arrival
                if not self._topics.law_by_pose:
                    self._pilot.see(self._speeds, got.arrival)
            elif got.topic == self._topics.pose:
                self._take_pose(msg.read_pose_stamped(got.message), got.arrival)
        except ValueError as error:
            log.warning("%s: %s; ignored", got.topic, error)  # and stale, if it goes on

    def _take_pose(self, seen: Seen, arrival: float) -> None:
        self._pilot.track(seen)
        if self._topics.law_by_pose and self._speeds is not None and arrival - self._speeds_at <= FRESH:
            self._pilot.see(seen._replace(v=self._speeds.v, w=self._speeds.w), arrival)

    def _send(self, command: Twist) -> None:
        self._port.send(self._topics.command, lambda m: msg.fill_twist(m, *command))

    def _stop(self) -> None:
        """Tell the robot to stand, and again for a while, even if interrupted meanwhile."""
        until, period = self._clock() + STOP_TIME, self._pilot.settings.period
        while self._clock() < until:
            self._send(STILL)
            next_at = self._clock() + period
            while (left := next_at - self._clock()) > 0.0:
                self._take_last(left)

    def _take_last(self, timeout: float) -> None:
        """What still comes is the tracking system's, for the record."""
        got = self._port.receive(timeout)
        if got is not None and got.topic == self._topics.pose:
            try:
                self._pilot.track(msg.read_pose_stamped(got.message))
            except ValueError:
                return


def connect(port: Any, topics: Topics) -> None:
    """Make the controller's topics on a port."""
    port.advertise(topics.command, "geometry_msgs/Twist")
    port.listen(topics.odometry, "nav_msgs/Odometry")
    port.listen(topics.pose, "geometry_msgs/PoseStamped")
