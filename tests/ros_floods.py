"""Floods of messages at the ROS nodes, on a real master: `flood(...)`, or `python -m tests.ros_floods witness nan 1000 4 2`.

Every flood has a master, a node, a sender and (asked for) processes that take all of a processor, each a process of its own.
What is returned was seen from outside: the lines that the node wrote, how fast its clock went, and when the robot stood.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

ROOT = Path(__file__).resolve().parents[1]
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
    "truncated",
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
    exit_status: int
    """Exit status of the flooded node after SIGINT."""


def flood(kind: str, rate: float = 1000.0, seconds: float = 4.0, hogs: int = 0) -> FloodCounts:
    """Flood the simulation (or, with `odometry` and `nan_odometry`, the controller) with `rate` messages a second.

    Args:
        kind: one of `KINDS`.
        rate: messages a second.
        seconds: length of the flood before the stop [s].
        hogs: processes that do nothing but compute.

    Raises:
        RuntimeError: something did not come up; the message is what it said.
    """
    command = [sys.executable, "-m", "tests.ros_floods", "witness", kind, str(rate), str(seconds), str(hogs)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0 + 3.0 * seconds, check=False, cwd=ROOT)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    found = json.loads(done.stdout.strip().splitlines()[-1])
    return FloodCounts(**{**found, "errors": tuple(found["errors"])})


def flood_without_ros(kind: str, rate: float = 1000.0, seconds: float = 2.0) -> FloodCounts:
    """Flood a node on a port that is none, on a clock of its own: quick, and no load on this machine.

    The arguments are those of `flood`; there is no `truncated` one. Times are the artificial clock's: they say that the stop
    comes when it should, and not that this machine is quick enough.
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
    return FloodCounts(kind, rate, len(bad), len(written.lines), stop, ratio, gap, angry, 0)


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
        "lock": ("/e_stop", "std_msgs/Bool", lock),
        "set_pose": ("/set_pose", poses, pose(1e300, "odom")),
        "foreign": ("/set_pose", poses, pose(0.0, "m\x1b[31map\x07\n" + 200 * "x")),
        "truncated": ("/cmd_vel", twists, twist(0.25)),
        "odometry": ("/odometry/filtered", "nav_msgs/Odometry", odometry(False)),
        "nan_odometry": ("/odometry/filtered", "nav_msgs/Odometry", odometry(True)),
    }[kind]


def _send(kind: str, rate: float, seconds: float) -> int:
    """Send a flood in bunches of 5 ms; return the number of messages."""
    from validation.ros import messages as msg
    from validation.ros.ros1 import load_rospy, message_class
    from validation.ros.sim import POSE_TOPIC

    rospy = load_rospy()
    rospy.init_node("flood", anonymous=True, disable_rosout=True, disable_signals=True)
    latest = [0.0, 0.0, 0.0, 0.0]

    def keep(message: Any) -> None:
        seen = msg.read_pose_stamped(message)
        latest[:] = [seen.stamp, seen.x, seen.y, seen.yaw]

    topic, name, make = _messages(kind, lambda: (latest[0], latest[1], latest[2], latest[3]), lambda t: message_class(t)())
    if kind in SENT_TO_CONTROLLER:
        rospy.Subscriber(POSE_TOPIC, message_class("geometry_msgs/PoseStamped"), keep, queue_size=1)
    if kind == "truncated":
        made = message_class(name)
        made = type("Cut", (made,), {"serialize": lambda self, buff: buff.write(b"\x00" * 11)})
        cut = made()
        publisher, make = rospy.Publisher(topic, made, queue_size=1000), lambda k: cut
    else:
        publisher = rospy.Publisher(topic, message_class(name), queue_size=1000)
    until = time.monotonic() + 10.0
    while publisher.get_num_connections() == 0 and time.monotonic() < until:
        time.sleep(0.02)
    began, sent = time.monotonic(), 0
    while (past := time.monotonic() - began) < seconds:
        while sent < rate * past:
            publisher.publish(make(sent))
            sent += 1
        time.sleep(0.005)
    return sent


# --- who looks on ---


def _witness(kind: str, rate: float, seconds: float, hogs: int) -> FloodCounts:
    from benchmarks.ros import POSE_TOPIC, Watcher, finish, process, rest_time, stamp_of, wait_until

    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        watcher = Watcher(Path(folder))
        stack.callback(watcher.close)
        running, log = stack.enter_context(watcher.sim("--no-noise"))
        watcher.port.advertise("/e_stop", "std_msgs/Bool")
        watcher.port.listen("/cmd_vel", "geometry_msgs/Twist")
        controlled, flooded = kind in SENT_TO_CONTROLLER, running
        if controlled:
            log = Path(folder) / "control.log"
            command = [sys.executable, "-m", "validation.ros", "control", "pid", "line", "--speed", "0.25"]
            flooded = stack.enter_context(process([*command, "--out", str(Path(folder) / "out")], log))
            wait_until(lambda: bool(watcher.hear(0.1)) and "driving" in log.read_text(), "the controller")
            got = watcher.hear(1.0)
        else:
            got, _ = watcher.drive(0.25, 0.0, 1.0)
        for k in range(hogs):
            stack.enter_context(process([sys.executable, "-c", "while True: pass"], Path(folder) / f"hog{k}.log"))
        sender = None
        if kind != "quiet":
            command = [sys.executable, "-m", "tests.ros_floods", "send", kind, str(rate), str(seconds + 4.5)]
            sent_log = Path(folder) / "sent.log"
            sender = stack.enter_context(process(command, sent_log))
            early, _ = _go_on(watcher, controlled, 1.5)
            got += early
        got, _ = _go_on(watcher, controlled, seconds)
        if controlled:
            stopped = time.monotonic()
            os.kill(flooded.pid, signal.SIGINT)
            after = watcher.hear(4.0)
        else:
            stopped = time.monotonic()
            watcher.port.send("/e_stop", lambda m: setattr(m, "data", True))
            after, _ = _go_on(watcher, controlled, 4.0)
        poses = [g for g in got if g.topic == POSE_TOPIC]
        ratio = (stamp_of(poses[-1]) - stamp_of(poses[0])) / (poses[-1].arrival - poses[0].arrival)
        commands = [g.arrival for g in got if g.topic == "/cmd_vel"]
        gap = max((b - a for a, b in pairwise(commands)), default=math.inf) if controlled else math.nan
        try:
            rest = math.nan if kind == "lock" else rest_time(after) - stopped
        except ValueError:  # it sent next to nothing
            rest = math.inf
        sent = 0
        if sender is not None:
            sender.wait(20.0)
            sent = int(sent_log.read_text().split()[-1])
        status = finish(flooded)
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        angry = tuple(line for line in lines if ANGRY.search(line))[:20]
        if os.environ.get("FLOOD_SHOW"):
            print("\n".join(lines[-60:]), file=sys.stderr)
        return FloodCounts(kind, rate, sent, len(lines), rest, ratio, gap, angry, status)


def _go_on(watcher: Any, controlled: bool, seconds: float) -> tuple[list[Any], float]:
    """Drive on, or let the controller do so, and return what was heard."""
    return (watcher.hear(seconds), 0.0) if controlled else watcher.drive(0.25, 0.0, seconds)


def main(arguments: Sequence[str]) -> None:
    """Run as the witness or as the sender, and print what was found."""
    role, kind, rate, seconds, *hogs = arguments
    if role == "send":
        print(_send(kind, float(rate), float(seconds)))
    else:
        print(json.dumps(_witness(kind, float(rate), float(seconds), int(hogs[0]))._asdict()))


if __name__ == "__main__":
    main(sys.argv[1:])
