"""The command line `python -m validation.ros sim|control`."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal

import tyro

from ssmr.robot.sensors import SensorModel
from ssmr.types import State
from validation import cli
from validation.bench.commissioning import chosen_filter
from validation.bench.loops import chosen_controller
from validation.bench.waypoint_files import open_reference
from validation.plants.profile import choose_profile
from validation.ros.control import START_PATIENCE, RobotTopics
from validation.ros.graph import Graph
from validation.ros.pilot import Pilot, PilotSettings, StoppedError
from validation.ros.port import NoGraphError
from validation.ros.result import DriveStatus
from validation.ros.robot import SensorSettings
from validation.ros.run import control_robot, simulate_robot
from validation.words import file_name, shortened

_STOPPING = 60.0
"""Longest time for which signals are ignored after the first one, or after the end of a drive [s]: the robot is being
stopped, and the drive saved, which takes three seconds and, on a busy machine, more than ten."""


@dataclass(frozen=True)
class GraphOptions:
    """The graph to join."""

    ros: Annotated[str, cli.option(metavar="2")] = "2"
    """Version of ROS; there is 2 alone, with the extra `ros2`."""
    domain: Annotated[int | None, cli.option(metavar="N", default="ROS_DOMAIN_ID, or 0")] = None
    """Domain."""
    namespace: Annotated[str, cli.option(metavar="NAME", default="none")] = ""
    """Namespace of the robot, such as a200_0000."""
    interface: Annotated[str, cli.option(metavar="NAME|ADDRESS", default="loopback, or what CYCLONEDDS_URI says")] = ""
    """Network interface."""

    def graph(self) -> Graph:
        """Return the graph.

        Raises:
            ValueError: another ROS than 2, a domain that is no number, or what `Graph` refuses.
        """
        if self.ros != "2":
            raise cli.UserError(
                f"--ros {shortened(self.ros, 20)}: nodes of ROS 1 are gone (tag 1.7 keeps them); there is ROS 2"
            )
        domain = self.domain
        if domain is None:
            told = os.environ.get("ROS_DOMAIN_ID", "") or "0"
            if not (told.isascii() and told.isdigit()):
                raise cli.UserError("ROS_DOMAIN_ID is set, and is no whole number")
            domain = int(told[:9])
        return Graph(domain, self.namespace.strip("/"), self.interface)


@dataclass(frozen=True)
class SimOptions:
    """The options of `sim`."""

    robot: cli.RobotName = None
    profile: Annotated[str | None, cli.profile_option("thesis-lab")] = None
    start: Annotated[tuple[float, float, float], cli.option(metavar="X Y YAW", default="the origin")] = (0.0, 0.0, 0.0)
    """Pose of the robot in the tracking system's frame [m, m, rad]."""
    duration: Annotated[float, cli.option(metavar="SECONDS", default="until Ctrl-C")] = math.inf
    """Time after which to end."""
    no_noise: cli.Flag = False
    """Simulate encoders and gyro without noise."""
    disturbance: cli.Flag = False
    """Push the robot's yaw at random (Sec. 3.4.5)."""
    wall_time: cli.Flag = False
    """Stamp with the wall's time; else time begins at 0."""
    filter: Annotated[str, cli.option(metavar="thesis|commissioned|learning|FILE.toml")] = "thesis"
    """State filter on the robot, as in validation.track."""
    gyro_bias: Annotated[float, cli.option(metavar="RAD/S")] = 0.0
    """Reading of the gyro at rest, of which no filter is told; one that learns has listened for 5 s before the start."""
    seed: cli.Seed = 0
    graph: GraphOptions = field(default_factory=GraphOptions)


@dataclass(frozen=True)
class TopicOptions:
    """Topics of the robot and of a tracking system."""

    odometry: Annotated[str | None, cli.option(metavar="TOPIC", default="the robot's filter")] = None
    """Topic of nav_msgs/Odometry: speeds, and the pose unless --feedback pose."""
    pose: Annotated[str | None, cli.option(metavar="TOPIC", default="/vrpn_mocap/ROBOT/pose")] = None
    """Topic of a tracking system's geometry_msgs/PoseStamped."""
    command: Annotated[str | None, cli.option(metavar="TOPIC", default="cmd_vel")] = None
    """Topic of geometry_msgs/Twist or TwistStamped on which the robot listens."""
    feedback: Annotated[Literal["odometry", "pose"], cli.option()] = "odometry"
    """Pose that the controller sees: the odometry's or the tracking system's."""


@dataclass(frozen=True)
class DriveOptions:
    """Limits of the drive."""

    absolute: cli.Flag = False
    """Take waypoints as places in the feedback's frame; else the reference begins at the robot's pose."""
    v_limit: Annotated[cli.Number, cli.option(metavar="M/S", default="1, or the robot's own limit where that is less")] = (
        None
    )
    """Greatest speed ever commanded."""
    w_limit: Annotated[cli.Number, cli.option(metavar="RAD/S", default="1, or the robot's limit if less")] = None
    """Greatest yaw rate ever commanded."""
    lookahead: Annotated[float, cli.option(metavar="METRES")] = 0.0
    """Distance that the robot keeps behind its target (Sec. 4.5)."""
    patience: Annotated[float, cli.option(metavar="SECONDS")] = START_PATIENCE
    """Time for which a robot is waited for."""


@dataclass(frozen=True)
class ControlOptions:
    """The options of `control`."""

    controller: Annotated[str, tyro.conf.Positional, cli.option(metavar="CONTROLLER")]
    """Controller: pid and lqr are the thesis'; lqr-scheduled (linearised about the operating speed) and smc (sliding
    mode) go beyond it. With +predictor behind its name a law acts on the state one dead time ahead; mpc plans ahead."""
    reference: Annotated[str | None, tyro.conf.Positional, cli.option(metavar="REFERENCE", default="none")] = None
    """Reference: line, circle, sine, generic, or a file of waypoints (.csv: x, y[, t])."""
    speed: Annotated[cli.Number, cli.option(metavar="M/S", default="0.25 for named references, a file's own times")] = None
    """Mean speed between waypoints; it replaces the times of a file."""
    robot: cli.RobotName = None
    profile: Annotated[str | None, cli.profile_option("thesis-lab")] = None
    own: Annotated[str | None, cli.option("controller", metavar="FILE.py:NAME", default="none")] = None
    """A controller of your own, in the place of CONTROLLER: a class in a Python file, which is run."""
    gains: Annotated[
        str | None, cli.option(metavar="NAME|PATH", default="published where the thesis has any, else tuned")
    ] = None
    """Gains: published, manual (lqr), tuned, or the path of a TOML file."""
    topics: TopicOptions = field(default_factory=TopicOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)
    graph: GraphOptions = field(default_factory=GraphOptions)
    out: Annotated[Path | None, cli.out_option("runs/ros/CONTROLLER-REFERENCE")] = None


def sim(options: SimOptions) -> None:
    """Put a MuJoCo robot on a ROS 2 graph, in real time, until Ctrl-C.

    Its topics are those of a Clearpath robot of its name; docs/ros.md lists them.
    """
    o = options
    with cli.mistakes_are_users():
        if not o.duration > 0.0 or not all(map(math.isfinite, o.start)):
            raise cli.UserError(f"--duration {o.duration:g} must be positive, --start {o.start} finite")
        chosen = choose_profile(o.profile, o.robot, "thesis-lab")
        graph = o.graph.graph()
        used = chosen_filter(o.filter, chosen, "mujoco")
        model = SensorModel(gyro_bias=o.gyro_bias)
        sensors = SensorSettings(not o.no_noise, model, o.disturbance, o.seed, used.settings)
    with _on_a_graph():
        simulate_robot(chosen, State(*o.start), o.duration, sensors, wall_time=o.wall_time, graph=graph)


def control(options: ControlOptions) -> None:
    """Drive a robot along a reference: the simulated one or a real one.

    It starts when feedback comes steadily from a robot that stands.

    The robot is stopped
    - at the reference's end, on Ctrl-C, and on any error;
    - when feedback is older than 0.5 s;
    - when it is 3 m from its target.

    Writes track.json and track.png, also of a drive that was stopped.

    The tracking system's pose judges the drive, else the odometry's.
    """
    o, drive = options, options.drive
    with cli.mistakes_are_users():
        controller, reference = cli.controller_and_reference(o.controller, o.reference, o.own)
        chosen = choose_profile(o.profile, o.robot, "thesis-lab")
        law, wanted = chosen_controller(controller, chosen, o.gains)
        label, waypoints = open_reference(reference, o.speed)
        own = chosen.robot.drive
        settings = PilotSettings(
            v_limit=min(PilotSettings.v_limit, own.v_max) if drive.v_limit is None else drive.v_limit,
            w_limit=min(PilotSettings.w_limit, own.w_max) if drive.w_limit is None else drive.w_limit,
            lookahead=drive.lookahead,
            absolute=drive.absolute,
        )
        if not drive.patience > 0.0:
            raise cli.UserError(f"--patience {drive.patience:g} s must be positive")
        pilot = Pilot(law.on(chosen.plants["mujoco"].drive), waypoints, settings)
        graph, told, usual = o.graph.graph(), o.topics, RobotTopics()
        topics = RobotTopics(
            told.odometry or graph.topic(usual.odometry, chosen.robot.name),
            told.pose or graph.topic(usual.pose, chosen.robot.name),
            told.command or graph.topic(usual.command, chosen.robot.name),
            told.feedback == "pose",
        )
        folder = cli.output_folder(o.out or Path("runs") / "ros" / file_name(f"{law.name}-{label}"))
    with _on_a_graph() as interrupt:
        result = control_robot(pilot, wanted, chosen, label, topics, drive.patience, graph)
        interrupt.wait_a_while()
    cli.report_result(result, result.save(folder, recording=False))
    if result.status == DriveStatus.INTERRUPTED:
        raise KeyboardInterrupt
    if result.status != DriveStatus.ARRIVED:
        raise StoppedError(str(result.document["stopped_because"]))


class _Interrupt:
    """Handler of the signals that end a node: the first one interrupts, and those within the next minute do not."""

    def __init__(self) -> None:
        self._deaf_until = -math.inf
        self._end: dict[int, Callable[[int, FrameType | None], object]] = {}
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            before = signal.getsignal(number)
            if callable(before):
                self._end[number] = before
            elif number == signal.SIGINT:  # a shell without job control has programs in the background ignore it
                self._end[number] = signal.default_int_handler
            if number in self._end:
                signal.signal(number, self)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if time.monotonic() > self._deaf_until:
            self.wait_a_while()
            self._end[number](number, frame)

    def wait_a_while(self) -> None:
        """Ignore signals for a while: the robot is being stopped, or the drive is being saved."""
        self._deaf_until = time.monotonic() + _STOPPING


@contextlib.contextmanager
def _on_a_graph() -> Iterator[_Interrupt]:
    """Let signals end a node once; a graph that is not there is a mistake of the user."""
    try:
        yield _Interrupt()
    except NoGraphError as error:
        raise cli.UserError(str(error)) from error


PROGRAM: Mapping[str, Callable[[Any], None]] = {"sim": sim, "control": control}

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.ros")
