"""Floods of messages at the ROS nodes, on a port that is none and on a clock of its own: `flood_without_ros(...)`.

What is returned was seen from outside: the lines that the node wrote, how fast its clock went, and when the robot stood.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, cast

ANGRY = re.compile(r"Traceback|^\s*File \"|\x1b\[(?!\d*(;\d+)*m)")
"""Found in what a node wrote: a traceback, or an escape sequence that is no colour."""
KINDS = (
    "quiet",
    "nan",
    "huge",
    "commands",
    "joystick",
    "lock",
    "set_pose",
    "foreign",
    "odometry",
    "nan_odometry",
)
"""The floods; `quiet` is none, to compare with. The last two are for the controller, the others for the simulation."""
SENT_TO_CONTROLLER = KINDS[-2:]


class FloodCounts(NamedTuple):
    """Findings of one flood."""

    kind: str
    rate: float
    """Messages a second that were asked for."""
    sent: int
    """Messages that were sent."""
    lines: int
    """Lines that the node wrote."""
    stop_s: float
    """Time from the emergency stop (the controller: from Ctrl-C) until the robot stood, by the wall clock [s]."""
    clock_ratio: float
    """Simulated time over the wall's during the flood."""
    gap_s: float
    """Longest time between two commands of the controller [s]; NaN for a flood of the simulation."""
    errors: tuple[str, ...]
    """Lines with tracebacks or escape sequences."""


def flood_without_ros(kind: str, rate: float = 1000.0, seconds: float = 2.0) -> FloodCounts:
    """Flood a node on a port that is none, on a clock of its own: quick, and no load on this machine.

    Times are the artificial clock's: they say that the stop comes when it should, and not that this machine is quick enough.

    Args:
        kind: one of `KINDS`.
        rate: messages a second.
        seconds: length of the flood before the stop [s].
    """
    from tests.ros_fakes import make

    at = [1.0]  # when the message that is being made comes [s]
    topic, _, message = _messages(kind, lambda: (at[0] + 1.0, 0.25 * at[0], 0.0, 0.0), make)
    written = _Lines()
    logger = logging.getLogger("validation.ros")
    level = logger.level
    logger.addHandler(written)
    logger.setLevel(logging.INFO)
    try:
        run = _control_on_fakes if kind in SENT_TO_CONTROLLER else _simulate_on_fakes
        bad = []
        for k in range(round(rate * (seconds + 1.0)) if kind != "quiet" else 0):
            at[0] = 1.0 + k / rate
            bad.append((topic, at[0], message(k)))
        stop, ratio, gap = run(bad, 1.0 + seconds)
        stop = math.nan if kind == "lock" else stop
    finally:
        logger.removeHandler(written)
        logger.setLevel(level)
    angry = tuple(line for line in written.lines if ANGRY.search(line))
    return FloodCounts(kind, rate, len(bad), len(written.lines), stop, ratio, gap, angry)


class _Lines(logging.Handler):
    """Keeps what a node writes."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the lines of a record."""
        self.lines += record.getMessage().splitlines()


def _simulate_on_fakes(bad: Sequence[tuple[str, float, Any]], stop_at: float) -> tuple[float, float, float]:
    """Flood the simulation; return the time from the emergency stop to rest, the clock's ratio, and NaN."""
    import numpy as np

    from tests.ros_fakes import FakeClock, FakePort, make
    from validation.plants.profile import load_profile, make_plant
    from validation.ros import messages as msg
    from validation.ros.commands import LOCK_TOPIC, CommandGate
    from validation.ros.robot import SensorSettings, SimulatedRobot
    from validation.ros.sim import POSE_TOPIC, SimNode, connect_simulation

    clock = FakeClock()
    port = FakePort(clock)
    connect_simulation(port)
    msg.fill_twist(drive := make("geometry_msgs/Twist"), 0.25, 0.0)
    for k in range(round(20.0 * (stop_at + 2.0))):
        port.plan("/cmd_vel", 0.05 * k, drive)
    lock = make("std_msgs/Bool")
    lock.data = True
    port.plan(LOCK_TOPIC, stop_at, lock)
    for message in bad:
        port.plan(*message)
    robot = SimulatedRobot(cast(Any, make_plant(load_profile("thesis-lab"), "mujoco")), SensorSettings(noise=False))
    SimNode(port, robot, CommandGate(), clock=clock, sleep=clock.sleep).run(stop_at + 1.0)
    seen = [msg.read_pose_stamped(m) for _, m in port.of(POSE_TOPIC)]
    t, xy = np.array([s.stamp for s in seen]), np.array([(s.x, s.y) for s in seen])
    moving = np.flatnonzero(np.hypot(*np.diff(xy, axis=0).T) / np.diff(t) > 0.01)
    sent = [at for at, _ in port.of(POSE_TOPIC)]
    return float(t[moving[-1] + 1]) - stop_at, float((t[-1] - t[0]) / (sent[-1] - sent[0])), math.nan


def _control_on_fakes(bad: Sequence[tuple[str, float, Any]], stop_at: float) -> tuple[float, float, float]:
    """Flood the controller; return the time from Ctrl-C to the first command to stand, 1, and the longest gap."""
    import numpy as np

    from ssmr.control.waypoints import Waypoints
    from tests.ros_fakes import FakeClock, FakePort, make
    from validation.plants.profile import load_profile
    from validation.ros import messages as msg
    from validation.ros.control import ControlNode, RobotTopics, connect_control
    from validation.ros.pilot import Pilot, PilotSettings
    from validation.track import load_gains, make_controller

    clock, topics = FakeClock(), RobotTopics()
    port = FakePort(clock)
    connect_control(port, topics)
    for k in range(round(50.0 * (stop_at + 1.0))):
        t = 0.02 * k
        message = make("nav_msgs/Odometry")
        msg.fill_odometry(message, t + 1.0, np.array([0.25 * t, 0.0, 0.0]), (0.0, 0.0), np.eye(3), np.eye(3))
        port.plan(topics.odometry, t, message)
    for topic, at, message in bad:
        port.plan(topic, at, message)
    ordinary = port.send

    def interrupted(topic: str, fill: Callable[[Any], None]) -> None:
        ordinary(topic, fill)
        if clock() >= 100.0 + stop_at and not stopped:
            stopped.append(clock() - 100.0)
            raise KeyboardInterrupt

    stopped: list[float] = []
    port.send = interrupted  # type: ignore[method-assign]
    waypoints = Waypoints.from_path(np.array([[0.25 * k, 0.0] for k in range(40)]), 0.25)
    pilot = Pilot(make_controller(load_profile("thesis-lab"), load_gains("pid")), waypoints, PilotSettings())
    with contextlib.suppress(KeyboardInterrupt):
        ControlNode(port, pilot, topics, clock=clock).run()
    sent = port.of(topics.command)
    stands = [t for t, m in sent if t > stopped[0] and msg.read_twist(m) == (0.0, 0.0)]
    times = [t for t, _ in sent]
    return stands[0] - stopped[0], 1.0, max(b - a for a, b in pairwise(times))


# --- what is sent ---


def _messages(
    kind: str, now: Callable[[], tuple[float, float, float, float]], new: Callable[[str], Any]
) -> tuple[str, str, Callable[[int], Any]]:
    """Return topic, type, and the function that makes the k-th message.

    `now` returns stamp, x, y and yaw of the robot, `new` an empty message of a type.
    """
    import numpy as np

    from validation.ros import messages as msg

    def twist(v: float, w: float = 0.0) -> Callable[[int], Any]:
        made = new("geometry_msgs/Twist")
        msg.fill_twist(made, v, w)
        return lambda k: made

    def lock(k: int) -> Any:
        (made := new("std_msgs/Bool")).data = k % 2 == 0
        return made

    def pose(x: float, frame: str) -> Callable[[int], Any]:
        made = new("geometry_msgs/PoseWithCovarianceStamped")
        msg.set_pose(made.pose.pose, x, 0.0, 0.0)
        made.header.frame_id = frame
        return lambda k: made

    def odometry(broken: bool) -> Callable[[int], Any]:
        def make(k: int) -> Any:
            made = new("nav_msgs/Odometry")
            stamp, x, y, yaw = now()
            at = np.array([math.nan if broken else x, y, yaw])
            msg.fill_odometry(made, stamp, at, (0.2, 0.0), np.eye(3), np.eye(3))
            return made

        return make

    twists, poses = "geometry_msgs/Twist", "geometry_msgs/PoseWithCovarianceStamped"
    return {
        "quiet": ("/cmd_vel", twists, twist(0.0)),
        "nan": ("/cmd_vel", twists, twist(math.nan)),
        "huge": ("/cmd_vel", twists, twist(1e300, -1e300)),
        "commands": ("/cmd_vel", twists, twist(0.25)),
        "joystick": ("/joy_teleop/cmd_vel", twists, twist(0.25)),
        "lock": ("/platform/emergency_stop", "std_msgs/Bool", lock),
        "set_pose": ("/set_pose", poses, pose(1e300, "odom")),
        "foreign": ("/set_pose", poses, pose(0.0, "m\x1b[31map\x07\n" + 200 * "x")),
        "odometry": ("/platform/odom/filtered", "nav_msgs/Odometry", odometry(False)),
        "nan_odometry": ("/platform/odom/filtered", "nav_msgs/Odometry", odometry(True)),
    }[kind]
