"""What stands for ROS in tests without it: messages with the fields of the real ones, a clock, and a port."""

from __future__ import annotations

from bisect import insort
from collections import Counter, deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from validation.ros.graph import Graph
from validation.ros.inbox import Inbox, Notices, Received
from validation.ros.port import Port


def _stamp() -> SimpleNamespace:
    return SimpleNamespace(sec=0, nanosec=0)


def _vector() -> SimpleNamespace:
    return SimpleNamespace(x=0.0, y=0.0, z=0.0)


def _quaternion() -> SimpleNamespace:
    return SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)


def _pose() -> SimpleNamespace:
    return SimpleNamespace(position=_vector(), orientation=_quaternion())


def _twist() -> SimpleNamespace:
    return SimpleNamespace(linear=_vector(), angular=_vector())


def _header() -> SimpleNamespace:
    return SimpleNamespace(stamp=_stamp(), frame_id="", seq=0)


def _with_covariance(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**fields, covariance=[0.0] * 36)


MAKERS: dict[str, Callable[[], SimpleNamespace]] = {
    "geometry_msgs/Twist": _twist,
    "geometry_msgs/PoseStamped": lambda: SimpleNamespace(header=_header(), pose=_pose()),
    "geometry_msgs/PoseWithCovarianceStamped": lambda: SimpleNamespace(
        header=_header(), pose=_with_covariance(pose=_pose())
    ),
    "geometry_msgs/TransformStamped": lambda: SimpleNamespace(
        header=_header(), child_frame_id="", transform=SimpleNamespace(translation=_vector(), rotation=_quaternion())
    ),
    "nav_msgs/Odometry": lambda: SimpleNamespace(
        header=_header(), child_frame_id="", pose=_with_covariance(pose=_pose()), twist=_with_covariance(twist=_twist())
    ),
    "sensor_msgs/Imu": lambda: SimpleNamespace(
        header=_header(), orientation=_quaternion(), orientation_covariance=[0.0] * 9, angular_velocity=_vector(),
        angular_velocity_covariance=[0.0] * 9, linear_acceleration=_vector(), linear_acceleration_covariance=[0.0] * 9,
    ),
    "tf2_msgs/TFMessage": lambda: SimpleNamespace(transforms=[]),
    "rosgraph_msgs/Clock": lambda: SimpleNamespace(clock=_stamp()),
    "std_msgs/String": lambda: SimpleNamespace(data=""),
    "sensor_msgs/JointState": lambda: SimpleNamespace(header=_header(), name=[], position=[], velocity=[], effort=[]),
    "std_msgs/Bool": lambda: SimpleNamespace(data=False),
}  # fmt: skip


def make(kind: str) -> Any:
    """An empty message."""
    return MAKERS[kind]()


class FakeClock:
    """Time that passes when somebody sleeps, and a little more than asked for."""

    def __init__(self, overshoot: float = 0.0) -> None:
        self.now, self.overshoot = 100.0, overshoot

    def __call__(self) -> float:
        """What time it is [s]."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds + self.overshoot


class FakePort(Port):
    """A port whose incoming messages are known beforehand, and whose outgoing ones are kept."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock, self.kinds = clock, dict[str, str]()
        self.graph = Graph()
        self.notices = Notices()
        self.inbox = Inbox(self.notices, lambda: self._arriving)
        self._arriving = clock()
        self.coming: deque[tuple[str, float, Any]] = deque()
        self.sent: list[tuple[str, float, Any]] = []
        self.robot_at = 0.0
        self.closed = False

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Note a topic's type."""
        self.kinds[topic] = kind

    def listen(self, topic: str, kind: str, read: Callable[[Any], Any] = lambda m: m, depth: int | None = None) -> None:
        """As the real one does."""
        self.inbox.open(topic, read, depth)

    def make(self, kind: str) -> Any:
        """An empty message."""
        return make(kind)

    def send(self, topic: str, fill: Callable[[Any], None]) -> None:
        """Keep a message."""
        message = make(self.kinds[topic])
        fill(message)
        self.sent.append((topic, self.clock(), message))

    def plan(self, topic: str, arrival: float, message: Any) -> None:
        """Let a message come at `arrival` [s] after the clock's beginning."""
        insort(self.coming, (topic, 100.0 + arrival, message), key=lambda c: c[1])

    def _deliver(self, until: float) -> None:
        """Let come what comes until then."""
        while self.coming and self.coming[0][1] <= until:
            topic, self._arriving, message = self.coming.popleft()
            self.inbox.put(topic, message)

    def receive(self, timeout: float = 0.0) -> Received | None:
        """The next message that has come until then."""
        until = self.clock() + timeout
        self._deliver(self.clock())
        while (got := self.inbox.get()) is None and self.coming and self.coming[0][1] <= until:
            self.clock.now = self.coming[0][1]
            self._deliver(self.clock.now)
        if got is None:
            self.clock.now = until
        return got

    def drain(self) -> Iterator[Received]:
        """What has come so far."""
        self._deliver(self.clock())
        return self.inbox.drain()

    def listeners(self, topic: str) -> int:
        """One, once the robot is there."""
        return int(self.clock() >= self.robot_at)

    def close(self) -> None:
        """Leave nothing."""
        self.closed = True

    def counts(self) -> Counter[str]:
        """How many were sent, by topic."""
        return Counter(topic for topic, _, _ in self.sent)

    def of(self, topic: str) -> list[tuple[float, Any]]:
        """Times [s] and messages sent on a topic."""
        return [(t - 100.0, m) for name, t, m in self.sent if name == topic]
