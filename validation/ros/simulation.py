"""The node that simulates a robot with MuJoCo: its topics, at their rates, in real time."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import cast

import numpy as np

from ssmr.parameters import MOST_SEED, require_within
from ssmr.types import State
from validation import cli
from validation.plants.profile import choose_profile, make_plant
from validation.ros import messages as msg
from validation.ros.dds import Graph, Node
from validation.ros.robot import SENSOR_RATE, CommandGate, SimulatedRobot
from validation.simulator.description import WHEELS
from validation.simulator.exporting import urdf_text
from validation.simulator.plant import MujocoPlant

_logger = logging.getLogger(__name__)

_BEHIND = 0.1
"""Lateness from which the simulation reports that it is not at real time [s]."""
_MOST_BEHIND = 2.0
"""Lateness that is caught up with [s], as after the stalls of a busy machine; a greater one is
dropped. After a long time on too slow a machine, the simulation would otherwise run fast for as
long, once the machine has time again."""


@dataclass(frozen=True)
class Sim(Graph):
    """Options of `sim`."""

    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab, and for
    another --robot the numbers of its file."""
    start: tuple[float, float, float] | list[float] | str = (0.0, 0.0, 0.0)
    """Pose of the robot in the tracking system's frame [m, m, rad]."""
    duration: float = math.inf
    """Time after which to end [s]; it runs until Ctrl-C if not given."""
    no_noise: bool = False
    """Simulate encoders and gyro without noise."""
    seed: int = 0
    """Seed of everything random. Equal seeds give equal results."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a seed that cannot be."""
        super().__post_init__()
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)


def is_due(step: int, rate: float, dt: float) -> bool:
    """Whether a sample of a rate [Hz] is due with a step of `dt` [s]: the first at or after k/rate.

    So a rate whose period is no whole number of steps is kept on average, to the step.
    """
    return math.floor(step * dt * rate + 1e-9) > math.floor((step - 1) * dt * rate + 1e-9)


class SimulationNode:
    """The node's loop: takes commands, advances the physics and sends sensor messages on time."""

    def __init__(self, node: Node, robot: SimulatedRobot) -> None:
        """Open the robot's topics and describe it."""
        self._node = node
        self._robot = robot
        self._clock = node.clock
        self._topics: dict[str, tuple[float, Callable[[float], msg.Fields]]] = {}
        """Rate of each topic [Hz] (Tab. 3.5, Sec. 4.2), and the message of a stamp [s]."""
        self._command = node.graph.topic("/cmd_vel")
        self._stop = node.graph.topic(msg.STOP_TOPIC)
        self._gate = CommandGate(self._command, self._say)
        self._advertise()
        self._describe()
        node.subscribe(self._command, "geometry_msgs/msg/Twist", msg.read_twist)
        node.subscribe(self._stop, "std_msgs/msg/Bool", lambda m: bool(m.data), msg.STOPS_KEPT)

    def _advertise(self) -> None:
        """Open the topics that are sent at a rate."""
        robot = self._robot
        joint_names = [f"{wheel}_wheel_joint" for wheel in WHEELS]
        odom_to_base = (msg.ODOM, msg.BASE)
        topics: tuple[tuple[str, str, float, Callable[[float], msg.Fields]], ...] = (
            ("/clock", "rosgraph_msgs/msg/Clock", 100.0, msg.clock_message),
            (
                msg.FILTERED_TOPIC,
                "nav_msgs/msg/Odometry",
                SENSOR_RATE,
                lambda t: msg.odometry_message(t, *robot.filtered_odometry()),
            ),
            (
                "/platform/odom",
                "nav_msgs/msg/Odometry",
                SENSOR_RATE,
                lambda t: msg.odometry_message(t, *robot.wheel_odometry()),
            ),
            (
                "/sensors/imu_0/data",
                "sensor_msgs/msg/Imu",
                SENSOR_RATE,
                lambda t: msg.imu_message(t, *robot.imu()),
            ),
            (
                "/platform/joint_states",
                "sensor_msgs/msg/JointState",
                SENSOR_RATE,
                lambda t: msg.joint_message(t, joint_names, *robot.joints()),
            ),
            (
                "/tf",
                "tf2_msgs/msg/TFMessage",
                SENSOR_RATE,
                lambda t: msg.transform_message(t, odom_to_base, robot.filtered_odometry()[0]),
            ),
            (
                msg.tracking_topic(robot.description.name),
                "geometry_msgs/msg/PoseStamped",
                120.0,
                lambda t: msg.pose_message(t, msg.WORLD, robot.pose),
            ),
        )
        for name, kind, rate, message in topics:
            topic = self._node.graph.topic(name)
            self._node.advertise(topic, kind)
            self._topics[topic] = rate, message

    def _describe(self) -> None:
        """Send the robot's description and the place of its IMU, for late joiners too."""
        robot = self._robot.description
        x, y, z = robot.imu
        mount = msg.transform_message(0.0, (msg.BASE, msg.IMU), np.array([x, y, 0.0]), z)
        description = {"data": urdf_text(robot)}
        for name, kind, message in (
            ("/tf_static", "tf2_msgs/msg/TFMessage", mount),
            ("/robot_description", "std_msgs/msg/String", description),
        ):
            topic = self._node.graph.topic(name)
            self._node.advertise(topic, kind, latch=True)
            self._node.publish(topic, message)

    def run(self, duration: float = math.inf) -> None:
        """Simulate for `duration` [s]; a DivergedError says that the simulator gave up."""
        robot = self._robot
        node = self._node
        start = self._clock()
        for step in itertools.count(1):
            if step * robot.dt > duration + 1e-9:
                return
            due = [name for name, (rate, _) in self._topics.items() if is_due(step, rate, robot.dt)]
            if not due:
                continue
            self._receive_commands()
            robot.advance(step - robot.steps, self._gate.command(self._clock()))
            if is_due(step, SENSOR_RATE, robot.dt):
                robot.sense()
            deadline = start + robot.time
            while (left := deadline - self._clock()) > 0.0:
                self._node.sleep(left)
            late = -left
            if late > _MOST_BEHIND:
                start += late
            if late > _BEHIND:
                text = f"{late:.2f} s behind real time: this machine is too slow, or busy"
                self._say(text, "late", logging.WARNING)
            for name in due:
                _, message = self._topics[name]
                node.publish(name, message(robot.time))

    def _receive_commands(self) -> None:
        for topic, value in self._node.receive():
            if topic == self._stop:
                self._gate.emergency_stop(value)
            else:
                self._gate.offer(value, self._clock())

    def _say(self, text: str, kind: str = "", level: int = logging.INFO) -> None:
        self._node.say(kind or text, f"{self._robot.time:.2f} s: {text}", level)


def sim(options: Sim) -> None:
    """Put a MuJoCo robot on a ROS 2 graph, in real time, until Ctrl-C.

    Its topics are those of a Clearpath robot of its name; docs/ros.md lists them.

    Raises:
        ValueError: an option that cannot be; cyclonedds is missing, or the network interface is not
            there.
        DivergedError: the simulator gave up.
    """
    o = options
    o.domain_number()
    start = cli.read_value(o.start)
    if not o.duration > 0.0 or not all(map(math.isfinite, start)):
        raise ValueError(f"--duration {o.duration:g} must be positive, --start {start} finite")
    profile = choose_profile(o.profile, o.robot, "thesis-lab")
    plant = cast(MujocoPlant, make_plant(profile, "mujoco"))
    robot = SimulatedRobot(plant, State(*start), noise=not o.no_noise, seed=o.seed)
    with closing(Node(f"{msg.ros_name(profile.robot.name)}_simulation", o)) as node:
        simulation = SimulationNode(node, robot)
        _logger.info(
            "the robot %s stands at x %g m, y %g m, yaw %g rad; Ctrl-C ends",
            profile.robot.name,
            *start,
        )
        simulation.run(o.duration)
