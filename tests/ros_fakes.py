"""A node without DDS for tests, with its own clock, given messages and a record of sent ones."""

from __future__ import annotations

from bisect import bisect_right, insort
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from validation.ros import messages as msg
from validation.ros.dds import Graph, Node, _Subscription


def message(values: Any) -> Any:
    """A message that came, of fields as they are sent."""
    if isinstance(values, Mapping):
        return SimpleNamespace(**{name: message(value) for name, value in values.items()})
    return [message(value) for value in values] if isinstance(values, list) else values


def odometry(
    stamp: float, x: float = 0.0, v: float = 0.0, y: float = 0.0, yaw: float = 0.0, w: float = 0.0
) -> Any:
    """An odometry, on the x axis unless told otherwise."""
    return message(msg.odometry_message(stamp, np.array([x, y, yaw]), (v, w), np.eye(3), np.eye(3)))


def twist(v: float, w: float = 0.0) -> Any:
    """A command."""
    return message(msg.twist_message(v, w))


class FakeClock:
    """Time that passes when somebody sleeps, and a little more than asked for.

    It begins at 100 s.
    """

    def __init__(self, overshoot: float = 0.0) -> None:
        self.now = 100.0
        self.overshoot = overshoot

    def __call__(self) -> float:
        """What time it is [s]."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds + self.overshoot


class FakeNode(Node):
    """A node whose incoming messages are planned, and whose outgoing ones are kept."""

    def __init__(self, clock: FakeClock | None = None) -> None:
        self.clock = clock or FakeClock()
        self.sleep = self.clock.sleep
        self.graph = Graph()
        self._subscriptions = {}
        self._logged_at = {}
        self.coming: list[tuple[float, str, Any]] = []
        self.sent: list[tuple[str, float, Any]] = []
        self.robot_at = 0.0
        self.closed = False
        self.on_publish: Callable[[str], None] = lambda topic: None

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Nothing is to be opened."""

    def publish(self, topic: str, values: msg.Fields) -> None:
        """Keep a message."""
        self.sent.append((topic, self.clock(), message(values)))
        self.on_publish(topic)

    def subscribers(self, topic: str) -> int:
        """One, once the robot is there."""
        return int(self.clock() >= 100.0 + self.robot_at)

    def subscribe(
        self,
        topic: str,
        kind: str,
        read: Callable[[Any], Any],
        depth: int = 1,
        *,
        latch: bool = False,
    ) -> None:
        """As the real one does."""
        self._subscriptions[topic] = _Subscription(read, depth)

    def plan(self, topic: str, arrival: float, came: Any) -> None:
        """Let a message come at `arrival` [s] after the clock's beginning."""
        insort(self.coming, (100.0 + arrival, topic, came), key=lambda c: c[0])

    def _take(self, timeout: float) -> list[tuple[str, Any]]:
        until = self.clock() + timeout
        if not self.coming or self.coming[0][0] > self.clock():
            self.clock.now = min(self.coming[0][0], until) if self.coming else until
        count = bisect_right(self.coming, self.clock(), key=lambda c: c[0])
        came = self.coming[:count]
        self.coming = self.coming[count:]
        return [
            (topic, message)
            for topic, subscription in self._subscriptions.items()
            for message in [m for _, name, m in came if name == topic][-subscription.depth :]
        ]

    def of(self, topic: str) -> list[tuple[float, Any]]:
        """Times [s] and messages sent on a topic."""
        return [(t - 100.0, m) for name, t, m in self.sent if name == topic]

    def close(self) -> None:
        """Leave nothing."""
        self.closed = True


class RobotNode(FakeNode):
    """A node with a robot behind it.

    It follows commands one dead time later, and its odometry comes at 50 Hz.
    """

    def __init__(self, command: str, dead_time: float = 0.2, late: float = 0.0) -> None:
        super().__init__()
        self.command = command
        self.dead_time = dead_time
        self.late = late
        self.tracking = ""
        self.ways: list[list[float]] = []
        self.silent_from = np.inf
        self.blocked: Callable[[float], bool] = lambda t: False
        self.jumped: Callable[[float], float] = lambda t: 0.0
        self.pose = np.zeros(3)
        self.speeds = np.zeros(2)
        self.tick = 0

    def _take(self, timeout: float) -> list[tuple[str, Any]]:
        while 0.02 * self.tick <= min(self.clock() + timeout - 100.0, self.silent_from):
            t = 0.02 * self.tick
            heard = (
                m
                for name, at, m in reversed(self.sent)
                if name == self.command and at - 100.0 <= t - self.dead_time
            )
            reported = next(heard, None)
            wanted = np.array(
                msg.STAND_STILL if reported is None or self.blocked(t) else msg.read_twist(reported)
            )
            self.speeds = self.speeds + 0.3 * (wanted - self.speeds)
            (v, w), yaw = self.speeds.tolist(), self.pose[2]
            self.pose = self.pose + 0.02 * np.array([v * np.cos(yaw), v * np.sin(yaw), w])
            x, y, yaw = self.pose.tolist()
            self.ways.append([x, y])
            if self.tracking:
                there = msg.pose_message(t + 1.0, "world", self.pose + np.array([5.0, 0.0, 0.0]))
                self.plan(self.tracking, t + self.late, message(there))
            self.plan(
                msg.FILTERED_TOPIC,
                t + self.late,
                odometry(t + 1.0, x + self.jumped(t), v, y, yaw, w),
            )
            self.tick += 1
        return super()._take(timeout)
