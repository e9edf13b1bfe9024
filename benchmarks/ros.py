"""Measure rates and delays of the ROS nodes on a real graph: `python -m benchmarks.ros [--ros 2] [--only rates]`.

It starts the nodes as a user would, as processes; of ROS 1 also a roscore of its own on a free port. What it says was seen
from outside: by a third node that listens and commands, on one monotonic clock.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from rich.table import Table

from benchmarks.rows import MissingError, optional
from ssmr.control.loop import LoopSettings
from ssmr.estimation.sensing import SensorModel
from ssmr.types import State
from validation import cli, store
from validation.plants.filters import odometry_of
from validation.plants.profile import load_profile, make_plant
from validation.ros import messages as msg
from validation.ros.commands import BASE_TIMEOUT
from validation.ros.graph import Graph
from validation.ros.inbox import Received
from validation.ros.pacing import EDGE, Pacer, drift
from validation.ros.port import Port
from validation.ros.ros1 import SIM_TIME_PARAMETER, Ros1Port, load_rospy, message_class, set_pose_service
from validation.ros.run import open_port
from validation.ros.sim import FILTERED_TOPIC, MESSAGE_TYPES, POSE_TOPIC, PUBLISH_RATES, SET_POSE_TOPIC
from validation.simulator.plant import MujocoPlant
from validation.track.gains import load_gains
from validation.track.loops import make_controller, make_robot, rate, run_robots
from validation.track.waypoint_files import open_reference

COMMAND = "/cmd_vel"
JOYSTICK = "/joy_teleop/cmd_vel"
MESSAGES = "/messages"
"""Topic of a sender that has no robot."""
SPEED = 0.25
"""At which the robot is driven [m/s]."""
SLOW = 0.01
"""A robot slower than this stands, as the tracking system sees it [m/s]."""
MOVED = 2e-4
"""So far it has moved when it moves, seen by the tracking system [m]."""
PROFILE = "thesis-lab"


@dataclass(frozen=True)
class Finding:
    """One number, and what was asked of it."""

    what: str
    value: float
    unit: str
    asked: str
    """Empty where it is only for the record."""
    ok: bool = True


def at_most(what: str, value: float, unit: str, limit: float) -> Finding:
    """A finding whose size must not pass a limit."""
    return Finding(what, float(value), unit, f"<= {limit:g}", bool(abs(value) <= limit))


# --- processes ---


def free_port() -> int:
    """A TCP port of loopback that nobody uses."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


@contextlib.contextmanager
def process(command: Sequence[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process with its output in a file; interrupted at the end, and killed if that does not help."""
    with log.open("wb") as out:
        running = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        yield running
    finally:
        finish(running)


def finish(running: subprocess.Popen[bytes]) -> int:
    """End a process and wait for it; its exit status."""
    for number, patience in ((signal.SIGINT, 10.0), (signal.SIGKILL, 5.0)):
        if running.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(running.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                running.wait(patience)
    return running.wait()


def said(log: Path) -> str:
    """What a process has said so far, in one line."""
    return " ".join(log.read_text(encoding="utf-8", errors="replace").split())


def wait_until(true: Callable[[], bool], what: str, patience: float = 30.0) -> None:
    """Look ten times a second.

    Raises:
        UserError: it never came true.
    """
    until = time.monotonic() + patience
    while not true():
        if time.monotonic() > until:
            raise cli.UserError(f"{what}: waited {patience:g} s in vain")
        time.sleep(0.1)


# --- the third node ---


class Watcher:
    """Listens to the robot and commands it. Topics have the names of ROS 1 here, whichever ROS it is."""

    port: Port

    def __init__(self, folder: Path, graph: Graph | None = None) -> None:
        """Join a graph; of ROS 1 a master is started for it."""
        self.folder, self.graph = folder, graph or Graph()
        self._usual = {self.graph.topic(topic, "husky"): topic for topic in MESSAGE_TYPES}
        self._stack = contextlib.ExitStack()
        self.options: tuple[str, ...] = ()
        if self.graph.ros == 2:
            self.options = ("--ros", "2", "--domain", str(self.graph.domain))
            self._join()
        else:
            self._start_master()

    def _start_master(self) -> None:
        if shutil.which("roscore") is None:
            raise MissingError("there is no roscore; on Debian 12: apt-get install --no-install-recommends ros-core")
        port, folder = free_port(), self.folder
        os.environ.update(
            ROS_MASTER_URI=f"http://127.0.0.1:{port}",
            ROS_IP="127.0.0.1",
            ROS_HOME=str(folder),
            ROS_LOG_DIR=str(folder / "log"),
        )
        os.environ.pop("ROS_HOSTNAME", None)
        self._stack.enter_context(process(["roscore", "-p", str(port)], folder / "roscore.log"))
        try:
            wait_until(lambda: answers(port), "the master")
            time.sleep(1.0)  # rosout comes after the master
            self._join()
        except BaseException:
            self._stack.close()
            raise

    def _join(self) -> None:
        with cli.mistakes_are_users():  # without rospy or cyclonedds
            self.port = open_port("watcher", self.graph)
        self.port.advertise(COMMAND, "geometry_msgs/Twist")
        self.port.advertise(JOYSTICK, "geometry_msgs/Twist")
        for name, topic in self._usual.items():
            self.port.listen(name, MESSAGE_TYPES[topic])

    def close(self) -> None:
        """Leave, and end the master."""
        self.port.close("measured")
        self._stack.close()

    @contextlib.contextmanager
    def sim(self, *options: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
        """The simulation, once it is heard and hears; its process and what it says."""
        log = self.folder / f"sim{time.monotonic_ns()}.log"
        command = [sys.executable, "-m", "validation.ros", "sim", "--profile", PROFILE, *self.options, *options]
        with process(command, log) as running:

            def ready() -> bool:
                if running.poll() is not None:
                    raise cli.UserError(f"the simulation ended: {said(log)}")
                return self.port.receive(0.01) is not None and self.port.listeners(COMMAND) > 0

            wait_until(ready, "the simulation")
            self.hear(0.5)
            yield running, log

    def hear(self, seconds: float) -> list[Received]:
        """Everything that comes."""
        got, until = [], time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            if (one := self.port.receive(left)) is not None:
                got.append(one._replace(topic=self._usual.get(one.topic, one.topic)))
        return got

    def drive(self, v: float, w: float, seconds: float, topic: str = COMMAND) -> tuple[list[Received], float]:
        """Command at 20 Hz; everything that came meanwhile, and when the last command was sent."""
        got: list[Received] = []
        pacer = Pacer(time.monotonic, lambda left: got.extend(self.hear(left)))
        last = pacer.start
        for k in range(max(1, round(20.0 * seconds))):
            pacer.wait(0.05 * k)
            self.port.send(topic, lambda m: msg.fill_twist(m, v, w))
            last = time.monotonic()
        return got, last


def answers(port: int) -> bool:
    """Whether somebody listens there."""
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def stamp_of(got: Received) -> float:
    """Of any of the messages [s]."""
    message = got.message
    if hasattr(message, "clock"):
        return msg.get_stamp(message.clock)
    header = message.transforms[0].header if hasattr(message, "transforms") else message.header
    return msg.get_stamp(header.stamp)


def positions(got: Sequence[Received]) -> tuple[np.ndarray, np.ndarray]:
    """(M,) arrivals [s] and (M, 2) places [m] of the tracking system's poses."""
    poses = [(g.arrival, g.message.pose.position.x, g.message.pose.position.y) for g in got if g.topic == POSE_TOPIC]
    table = np.array(poses).reshape(-1, 3)
    return table[:, 0], table[:, 1:]


def rest_time(got: Sequence[Received]) -> float:
    """When the robot came to rest, as the tracking system saw it, by arrival [s]; NaN if it still moves.

    Raises:
        ValueError: nothing was seen.
    """
    t, xy = positions(got)
    if len(t) < 20:
        raise ValueError("the tracking system fell silent")
    speed = np.hypot(*(xy[6:] - xy[:-6]).T) / (6.0 / PUBLISH_RATES[POSE_TOPIC])  # over 50 ms of simulated time
    moving = np.flatnonzero(speed > SLOW)
    if len(moving) == len(speed) or (len(moving) and moving[-1] == len(speed) - 1):
        return math.nan
    return float(t[moving[-1] + 3]) if len(moving) else float(t[0])


# --- what is measured ---


def measure_rates(watcher: Watcher, seconds: float) -> list[Finding]:
    """Rates and pacing, by stamps against arrivals."""
    with watcher.sim() as (_, log):
        got = watcher.hear(seconds + 0.1)
        found = []
        for topic, wanted in PUBLISH_RATES.items():
            mine = [g for g in got if g.topic == topic]
            arrivals = np.array([g.arrival for g in mine])
            stamps = np.array([stamp_of(g) for g in mine])
            kept = (len(mine) - 1) / (arrivals[-1] - arrivals[0])
            found.append(at_most(f"{topic}: {kept:.2f} Hz for {wanted:g}, off by", 100.0 * (kept / wanted - 1.0), "%", 1.0))
            lost = round((stamps[-1] - stamps[0]) * wanted) + 1 - len(mine)
            found.append(Finding(f"{topic}: messages lost of {len(mine)}", float(lost), "", "0", bool(lost == 0)))
            if topic == POSE_TOPIC:
                late, what = arrivals - stamps, f"pacing error over {arrivals[-1] - arrivals[0]:.0f} s, seen from outside"
                found.append(at_most(what, 1e3 * drift(stamps, late), "ms", 1.0))
                spread = late - np.median(late)
                for name, q in (("95 %", 95.0), ("99 %", 99.0), ("most", 100.0)):
                    found.append(
                        Finding(f"arrivals later than their median: {name}", 1e3 * float(np.percentile(spread, q)), "ms", "")
                    )
    if watcher.graph.ros == 1:
        left = load_rospy().get_param(SIM_TIME_PARAMETER, None)
        found.append(yes("the simulation has left the graph as it was", left is None))
    tail = said(log)
    found.append(at_most("pacing error, as the node says", float(tail.split("pacing error ")[1].split(" ms")[0]), "ms", 1.0))
    return found


def lab_robot() -> MujocoPlant:
    """The robot, without ROS."""
    return cast(MujocoPlant, make_plant(load_profile(PROFILE), "mujoco"))


def modelled_latency() -> float:
    """From a command to motion that is seen, in the process: dead time, wheel lag, and the way until it shows [s]."""
    plant = lab_robot()
    start, n = plant.reset(State()), 0
    while True:
        state = plant.step((SPEED, 0.0), plant.dt)
        n += 1
        if abs(state.x - start.x) > MOVED:
            return n * plant.dt


def measure_latency(watcher: Watcher, trials: int) -> list[Finding]:
    """From sending a command to seeing the robot move."""
    waits, rng, modelled = [], np.random.default_rng(0), modelled_latency()
    with watcher.sim("--no-noise"):
        for k in range(trials):
            wait_until(lambda: speed_of(watcher.hear(0.2), 0.15) < 1e-4, "rest")
            for seconds in (0.6, 5.0):  # a machine that is busy for half a second shows it in the figures
                xy = positions(watcher.hear(0.1 + 0.05 * rng.random()))[1][-1]  # at any phase of the robot's 20 Hz
                sent = time.monotonic()
                t, way = positions(watcher.drive(SPEED if k % 2 == 0 else -SPEED, 0.0, seconds)[0])
                moved = np.hypot(*(way - xy).T) > MOVED
                if moved.any():
                    break
            else:
                raise cli.UserError("the robot did not move within 5 s: this machine is too busy to measure on")
            waits.append(float(t[np.argmax(moved)] - sent))
    beyond = 1e3 * (np.array(waits) - modelled)
    median, p95 = np.percentile(beyond, [50.0, 95.0])
    return [
        Finding("command to motion: median", 1e3 * float(np.median(waits)), "ms", ""),
        Finding("of which the profile's model: dead time, lag, first 0.2 mm", 1e3 * modelled, "ms", ""),
        at_most("the rest (ROS, the robot's 20 Hz, tracking at 120 Hz): median", float(median), "ms", 50.0),
        Finding("the same: 95 %", float(p95), "ms", ""),
        Finding("the same: least", float(beyond.min()), "ms", ""),
    ]  # fmt: skip


def through_ros(watcher: Watcher, *options: str) -> float:
    """d_rms of PID on the circle [m] through ROS, judged by the tracking system.

    A machine that stalls for half a second has the controller stop the robot, as it should; then it is tried again, twice.
    """
    for _ in range(2):
        try:
            return drive_circle(watcher, *options)
        except StalledError as error:
            cli.warn(str(error))
    return drive_circle(watcher, *options)


class StalledError(cli.UserError):
    """This machine left the controller without feedback."""


def drive_circle(watcher: Watcher, *options: str) -> float:
    """One drive of `through_ros`."""
    with watcher.sim(*options):
        out, log = watcher.folder / f"track{time.monotonic_ns()}", watcher.folder / "control.log"
        drive = ("control", "pid", "circle", "--profile", PROFILE, "--out", str(out))
        command = [sys.executable, "-m", "validation.ros", *drive, *watcher.options]
        with process(command, log) as running:
            while running.poll() is None:
                watcher.hear(0.5)
            if running.returncode:
                kind = StalledError if "no feedback for" in said(log) else cli.UserError
                raise kind(f"the controller failed: {said(log)}")
    document = json.loads((out / "track.json").read_text(encoding="utf-8"))
    if document["options"]["judged_by"] != watcher.graph.topic(POSE_TOPIC, "husky"):
        raise cli.UserError("the tracking system did not see the drive")
    return float(document["metrics"]["d_rms_m"])


def in_process(seeds: Sequence[int], *, noise: bool) -> list[float]:
    """The same without ROS: one clock, filter and position loop at 50 Hz, commands at 20 Hz [m]."""
    profile = load_profile(PROFILE)
    robot, law = make_robot(profile, "mujoco"), make_controller(profile, load_gains("pid", "published"))
    _, waypoints = open_reference("circle", SPEED)
    settings = LoopSettings(
        "ekf", filter=odometry_of(robot.drive), disturbance=False, position_period=1.0 / PUBLISH_RATES[FILTERED_TOPIC]
    )
    if not noise:
        settings = replace(settings, sensors=SensorModel(0.0, 0.0))
    runs = run_robots([robot] * len(seeds), [law] * len(seeds), [settings] * len(seeds), waypoints, list(seeds))
    return [rate(run, waypoints, robot)["d_rms_m"] for run in runs]


def measure_circle(watcher: Watcher, repeats: int) -> list[Finding]:
    """PID on the circle: without noise, where both are one number, and with it."""
    (alone,) = in_process([0], noise=False)
    ros = through_ros(watcher, "--no-noise")
    found = [
        Finding("circle, no noise, in the process: d_rms", 1e3 * alone, "mm", ""),
        Finding("circle, no noise, through ROS: d_rms", 1e3 * ros, "mm", ""),
        at_most("off by", 100.0 * (ros / alone - 1.0), "%", 10.0),
    ]
    if repeats:
        many = in_process(range(20), noise=True)
        noisy = [through_ros(watcher, "--seed", str(k)) for k in range(repeats)]
        found += [
            Finding("circle, noise, in the process: mean d_rms of 20 seeds", 1e3 * float(np.mean(many)), "mm", ""),
            Finding("its standard deviation", 1e3 * float(np.std(many)), "mm", ""),
            Finding(f"circle, noise, through ROS: mean d_rms of {repeats}", 1e3 * float(np.mean(noisy)), "mm", ""),
            at_most("off by", 100.0 * float(np.mean(noisy) / np.mean(many) - 1.0), "%", 10.0),
        ]
    return found


def modelled_stop() -> float:
    """What the profile's robot needs from being told to stand until it does: dead time, lag and braking [s]."""
    plant = lab_robot()
    plant.reset(State())
    for _ in range(round(3.0 / plant.dt)):
        plant.step((SPEED, 0.0), plant.dt)
    n = 1
    while abs(plant.step((0.0, 0.0), plant.dt).v_x) > SLOW:
        n += 1
    return n * plant.dt


def stopping(what: str, rest: float) -> list[Finding]:
    """A robot at rest so long [s] after `what`: all of it, and without what it takes from a word to rest."""
    model = modelled_stop()
    return [
        Finding(f"{what}: at rest from {SPEED} m/s after", rest, "s", ""),
        Finding("of which the profile's robot: dead time, lag, braking", model, "s", ""),
        Finding("so it was told to stand within", rest - model, "s", "<= 0.5", bool(rest - model <= 0.5)),
    ]


def yes(what: str, true: bool) -> Finding:
    """Something that is so."""
    return Finding(what, float(true), "", "1", bool(true))


def check_set_pose(watcher: Watcher) -> list[Finding]:
    """The filter's pose by service, while the robot stays where it is."""
    rospy = load_rospy()
    kind = set_pose_service()
    rospy.wait_for_service(SET_POSE_TOPIC, 5.0)
    call = rospy.ServiceProxy(SET_POSE_TOPIC, kind)
    wanted = message_class("geometry_msgs/PoseWithCovarianceStamped")()
    wanted.header.frame_id = msg.ODOM
    msg.set_pose(wanted.pose.pose, 3.0, -2.0, 1.0)
    call(wanted)
    got = watcher.hear(0.2)
    seen = msg.read_odometry([g for g in got if g.topic == FILTERED_TOPIC][-1].message)
    true = msg.read_pose_stamped([g for g in got if g.topic == POSE_TOPIC][-1].message)
    wanted.header.frame_id = "map"
    try:
        call(wanted)
        fault = ""
    except rospy.ServiceException as error:
        fault = str(error)
    off = float(np.hypot(seen.x - 3.0, seen.y + 2.0) + abs(seen.yaw - 1.0))
    return [
        at_most("set_pose: the filter is off by", 1e3 * off, "mm, mrad", 20.0),  # it drifts on: 1 cm in 1 s and more
        at_most("set_pose: the robot moved by", 1e3 * float(np.hypot(true.x, true.y)), "mm", 1.0),
        yes("set_pose in another frame is refused", msg.ODOM in fault),
    ]


def check_priority(watcher: Watcher, log: Path) -> list[Finding]:
    """The joystick goes before /cmd_vel, and /cmd_vel comes back when it is silent."""
    watcher.drive(0.2, 0.0, 0.5)
    got, pacer = [], Pacer(time.monotonic, lambda left: got.extend(watcher.hear(left)))
    for k in range(30):  # both talk, and the joystick says: stand
        pacer.wait(0.05 * k)
        watcher.port.send(JOYSTICK, lambda m: msg.fill_twist(m, 0.0, 0.0))
        watcher.port.send(COMMAND, lambda m: msg.fill_twist(m, 0.2, 0.0))
    held = speed_of(got, 0.2)
    back = speed_of(watcher.drive(0.2, 0.0, 1.5)[0], 0.2)
    said_so = f"{JOYSTICK} commands now, in place of {COMMAND}" in said(log)
    return [
        Finding("joystick says stand, /cmd_vel says 0.2 m/s: speed", held, "m/s", f"<= {SLOW}", abs(held) <= SLOW),
        Finding("joystick silent: speed", back, "m/s", "0.17 to 0.22", 0.17 <= back <= 0.22),
        yes("the change of hands was said", said_so),
    ]


def speed_of(got: Sequence[Received], seconds: float) -> float:
    """Mean speed over the last `seconds` of the tracking system's stamps [m/s]; infinite where it says nothing."""
    poses = [g for g in got if g.topic == POSE_TOPIC]
    if len(poses) < 2:
        return math.inf  # not seen
    stamps, xy = np.array([stamp_of(g) for g in poses]), positions(poses)[1]
    first = int(np.searchsorted(stamps, stamps[-1] - seconds))
    return float(np.hypot(*(xy[-1] - xy[first])) / (stamps[-1] - stamps[first]))


def check_silence(watcher: Watcher, log: Path) -> list[Finding]:
    """A command stream that ends; again, up to three times in all, where this machine stalled meanwhile."""
    found: list[Finding] = []
    for _ in range(3):
        last = watcher.drive(SPEED, 0.0, 1.5)[1]
        found = stopping("stream silent", rest_time(watcher.hear(1.4)) - last)
        if all(f.ok for f in found):
            break
    return [*found, yes("silence was said", f"nothing on {COMMAND} for {BASE_TIMEOUT:g} s: the robot brakes" in said(log))]


def check_master(watcher: Watcher, simulation: subprocess.Popen[bytes], log: Path) -> list[Finding]:
    """The master ends, and commands go on all the same; last of all, for nobody comes back from that."""
    watcher.drive(SPEED, 0.0, 1.2)
    gone = time.monotonic()
    os.kill(cast(Ros1Port, watcher.port).master_pid, signal.SIGKILL)
    got, _ = watcher.drive(SPEED, 0.0, 1.5)
    status = simulation.wait(20.0)
    return [
        *stopping("master gone, commands going on", rest_time(got) - gone),
        yes("the simulation said so", "is gone" in said(log) and "the robot stands" in said(log)),
        yes("and ended with status 1", status == 1),
    ]


def measure_behaviour(watcher: Watcher) -> list[Finding]:
    """Measure what a robot does when it is told where it is, by one, by two, by nobody any more, and without a master.

    ROS 2 has neither the service nor a master.
    """
    with watcher.sim() as (simulation, log):
        if watcher.graph.ros == 2:
            return [*check_priority(watcher, log), *check_silence(watcher, log)]
        return [
            *check_set_pose(watcher),
            *check_priority(watcher, log),
            *check_silence(watcher, log),
            *check_master(watcher, simulation, log),
        ]


def measure_orphans(watcher: Watcher) -> list[Finding]:
    """What controller and robot do together when they have lost their master."""
    log = watcher.folder / "orphan.log"
    command = [sys.executable, "-m", "validation.ros", "control", "pid", "circle", "--out", str(watcher.folder / "gone")]
    with watcher.sim() as (simulation, _), process(command, log) as controller:
        wait_until(lambda: len(watcher.hear(0.1)) > 0 and "driving" in said(log), "the controller")
        watcher.hear(2.0)
        gone = time.monotonic()
        os.kill(cast(Ros1Port, watcher.port).master_pid, signal.SIGKILL)
        got = watcher.hear(1.6)
        statuses = [p.wait(20.0) for p in (simulation, controller)]
    return [
        *stopping("master gone, under a controller", rest_time(got) - gone),
        yes("the controller said so", "is gone" in said(log)),
        yes("both ended with status 1", statuses == [1, 1]),
    ]


def send_messages(ros: int, domain: int, count: int) -> None:
    """Send odometry at 100 Hz, stamped with the time of sending, and print the processor time of one message [ms]."""
    port = open_port("sender", Graph(ros, domain))
    port.advertise(MESSAGES, "nav_msgs/Odometry")
    wait_until(lambda: port.listeners(MESSAGES) > 0, "the reader")
    time.sleep(0.5)
    pose, spread, began = np.zeros(3), np.eye(3), time.process_time()
    for _ in range(count):
        port.send(MESSAGES, lambda m: msg.fill_odometry(m, time.time(), pose, (0.1, 0.2), spread, spread))
        time.sleep(0.01)
    print(1e3 * (time.process_time() - began) / count)
    time.sleep(1.0)
    port.close("sent")


def measure_messages(watcher: Watcher, count: int) -> list[Finding]:
    """Time that an odometry needs from one process to another, and what the processor does for it on both sides."""
    late: list[float] = []

    def read(message: Any) -> None:
        now = time.time()
        late.append(now - msg.read_odometry(message).stamp)

    watcher.port.listen(MESSAGES, "nav_msgs/Odometry", read, 32)
    log, graph = watcher.folder / "sender.log", watcher.graph
    code = f"from benchmarks.ros import send_messages; send_messages({graph.ros}, {graph.domain}, {count})"
    with process([sys.executable, "-c", code], log) as running:
        wait_until(lambda: bool(late) or running.poll() is not None, "the first message")
        began, first = time.process_time(), len(late)
        running.wait(10.0 + 0.1 * count)
    spent = 1e3 * (time.process_time() - began) / max(1, len(late) - first)
    least, median, p95 = 1e3 * np.percentile(late, [0.0, 50.0, 95.0])
    return [
        Finding(f"odometries lost of {count}", float(count - len(late)), "", "0", len(late) == count),
        Finding("from process to process: least", float(least), "ms", ""),
        Finding("median", float(median), "ms", ""),
        Finding("95 %", float(p95), "ms", ""),
        Finding("processor time of a message, sender", float(said(log).split()[-1]), "ms", ""),
        Finding("reader", spent, "ms", ""),
    ]


def measure_memory(watcher: Watcher, minutes: float) -> list[Finding]:
    """Memory and share of a core of a simulation that drives in circles, and what comes of its messages."""
    samples: list[tuple[float, float, float]] = []
    counts: Counter[str] = Counter()
    with watcher.sim() as (simulation, _):
        began = time.monotonic()
        while (past := time.monotonic() - began) < 60.0 * minutes:
            counts.update(got.topic for got in watcher.drive(SPEED, 0.2, 5.0)[0])
            fields = Path(f"/proc/{simulation.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
            ticks = int(fields[11]) + int(fields[12])
            samples.append((past, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 2**20, ticks / os.sysconf("SC_CLK_TCK")))
    t, memory, processor = np.array(samples).T
    settled = t >= 0.2 * t[-1]
    growth = float(np.polyfit(t[settled], memory[settled], 1)[0]) if np.count_nonzero(settled) > 2 else math.nan
    return [
        Finding(f"memory of the simulation after {t[0]:.0f} s", float(memory[0]), "MiB", ""),
        Finding(f"after {t[-1] / 60.0:.1f} min", float(memory[-1]), "MiB", ""),
        Finding("growth over the last four fifths", 3600.0 * growth, "MiB/h", ""),
        Finding("processor time over time", 100.0 * float(np.ptp(processor) / max(np.ptp(t), 1e-9)), "% of a core", ""),
        Finding("messages heard meanwhile", float(counts.total()), "", ""),
    ]


NAMES = ("messages", "rates", "latency", "circle", "behaviour", "memory", "orphans")
"""What can be measured."""
LAST = ("behaviour", "orphans")
"""What ends the master: one of them a run."""


def measure(names: Sequence[str], seconds: float, trials: int, repeats: int, minutes: float, graph: Graph) -> list[Finding]:
    """Measure, one after the other, on one graph.

    Raises:
        UserError: no ROS, or something does not come up.
    """
    calls: dict[str, Callable[[Watcher], list[Finding]]] = {
        "messages": lambda w: measure_messages(w, round(50.0 * seconds)),
        "rates": lambda w: measure_rates(w, seconds),
        "latency": lambda w: measure_latency(w, trials),
        "circle": lambda w: measure_circle(w, repeats),
        "behaviour": measure_behaviour,
        "memory": lambda w: measure_memory(w, minutes),
        "orphans": measure_orphans,
    }
    with tempfile.TemporaryDirectory() as folder:
        watcher = Watcher(Path(folder), graph)
        try:
            return [finding for name in NAMES if name in names for finding in calls[name](watcher)]
        finally:
            watcher.close()


def main(
    out: Path = Path("runs/benchmarks/ros.json"),
    only: str = "messages,rates,latency,circle,behaviour",
    ros: Literal[1, 2] = 1,
    seconds: float = 30.0,
    trials: int = 30,
    repeats: int = 5,
    minutes: float = 5.0,
    quick: bool = False,
) -> None:
    """Measure the ROS nodes; print what was found and write it as JSON.

    Args:
        out: Where the JSON goes.
        only: Which of messages, rates, latency, circle, memory, and behaviour or orphans; these two end ROS 1's master.
        ros: Version of ROS.
        seconds: How long rates are counted [s].
        trials: Commands whose latency is taken.
        repeats: Drives on the circle with noise.
        minutes: How long memory is watched.
        quick: Count rates only, and briefly: a check that everything runs.
    """
    names = tuple(name.strip() for name in only.split(",") if name.strip())
    if not names or not set(names) <= set(NAMES):
        raise cli.UserError(f"--only {only}: there are {', '.join(NAMES)}")
    if all(name in names for name in LAST):
        raise cli.UserError(f"{' and '.join(LAST)} both end the master; measure one a run")
    if ros == 2 and "orphans" in names:
        raise cli.UserError("ROS 2 has no master that could leave orphans")
    if not seconds >= 2.0 * EDGE or trials < 1 or repeats < 0:
        raise cli.UserError(f"--seconds must be at least {2 * EDGE:g}, --trials positive, --repeats not negative")
    if quick:
        names, seconds = ("rates",), 2.0 * EDGE
    graph = Graph(ros, 1 + os.getpid() % 100) if ros == 2 else Graph()  # a domain that is likely to be nobody else's
    found = optional(quick, lambda: measure(names, seconds, trials, repeats, minutes, graph)) or []
    table: Any = Table(title="benchmarks/ros")
    for column in ("what", "value", "unit", "asked", ""):
        table.add_column(column, justify="right" if column == "value" else "left")
    for f in found:
        table.add_row(f.what, f"{f.value:.4g}", f.unit, f.asked, "" if not f.asked else "ok" if f.ok else "FALLS SHORT")
    cli.report_console().print(table)
    cli.output_folder(out.parent)
    document = {"schema": "ssmr.benchmark/1", "load": os.getloadavg()[0], "rows": [vars(f) for f in found]}
    store.write_json(out, store.plain({**document, "versions": store.versions()}))


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.ros")
