"""The node that drives a robot along a reference, and stops it when in doubt."""

from __future__ import annotations

import logging
import math
import select
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from ssmr.control.law import Observation
from ssmr.control.loop import VELOCITY_PERIOD
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.types import FloatArray
from validation import cli
from validation.experiment.loops import (
    chosen_controller,
    make_robot,
    open_path,
)
from validation.experiment.tracked import Followed
from validation.experiment.waypoint_files import DEFAULT_SPEED, frame_of_waypoints
from validation.plants.profile import choose_profile
from validation.report.report import INTERRUPTED
from validation.report.tracking import Tracked
from validation.ros import messages as msg
from validation.ros.dds import Graph, Node
from validation.ros.follower import FRESH, PathFollower, StoppedError
from validation.ros.watch import LATE

_logger = logging.getLogger(__name__)

_ARRIVED = "arrived"
"""Status of a drive that came to its reference's end."""
STOP_TIME = 0.5
"""Time for which the robot is commanded to stand at the end [s]."""
_SLACK = 0.004
"""Delay of the velocity loop behind the first message of the position loop [s], so that later
messages may be a bit late."""
_FEEDBACK_KEPT = 16
_POSES_KEPT = 32
"""Messages of odometry and of a tracking system that wait for the loop: as many as may come in a
quarter of a second."""
_TRANSFORMS_KEPT = 100
"""Messages of transforms that wait for the loop: several nodes send them."""
_ODOMETRY = "nav_msgs/msg/Odometry"
_TOPICS = {
    "odometry": msg.FILTERED_TOPIC,
    "command": "/cmd_vel",
    "stop": msg.STOP_TOPIC,
    "wheels": msg.WHEELS_TOPIC,
    "imu": msg.IMU_TOPIC,
}
"""Topics of a Clearpath robot, by the options that name others."""


@dataclass(frozen=True)
class Control(Graph):
    """Options of `control`."""

    controller: tyro.conf.Positional[str]
    """Controller: pid and lqr are the thesis'; lqr-scheduled is linearised about the operating
    speed. With +predictor behind its name a law acts on the state one dead time ahead; mpc plans
    ahead. FILE.py:NAME is a class of your own, which is run."""
    reference: tyro.conf.Positional[str]
    """Reference: line, circle, sine, generic, a file of waypoints (.csv: x, y[, t][, yaw]
    [, frame]), or the topic of a nav_msgs/Path (/NAME), whose first path is driven."""
    speed: float | None = None
    """Greatest speed [m/s]. A file then is a path without times: its corners are rounded and
    driven as fast as the robot can. Named references have 0.25 m/s if it is not given."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    frame: str = ""
    """Frame of the reference, such as map or odom, where its places are and near whose beginning
    the robot has to stand; that of the file or of the path if not given. A reference without one
    begins at the robot's pose."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab, and for
    another --robot the numbers of its file."""
    gains: str | None = None
    """Gains: published, manual (lqr), tuned, or the path of a TOML file; those of validation.track
    if not given."""
    odometry: str = ""
    """Topic of nav_msgs/Odometry: speeds, and the pose unless --feedback pose; the robot's filter
    if not given."""
    pose: str = ""
    """Topic of a tracking system's geometry_msgs/PoseStamped, or of a localiser's
    PoseWithCovarianceStamped, by which the drive is judged if it is there; /vrpn_mocap/ROBOT/pose
    if not given."""
    command: str = ""
    """Topic of geometry_msgs/Twist or TwistStamped on which the robot listens; cmd_vel if not
    given."""
    stop: str = ""
    """Topic of std_msgs/Bool that says whether the emergency stop is on; the Husky's if not
    given."""
    restart: Literal["confirm", "auto"] = "confirm"
    """Way in which a held robot goes on: when somebody confirms it, by true on the topic
    /platform/confirm_restart or by Enter in this terminal, or by itself."""
    wheels: str = ""
    """Topic of nav_msgs/Odometry by the wheels alone, which are compared with the commands;
    /platform/odom if not given."""
    imu: str = ""
    """Topic of sensor_msgs/Imu, whose gyro is compared with the wheels; /sensors/imu_0/data if not
    given."""
    feedback: Literal["odometry", "pose"] = "odometry"
    """Pose that the controller sees: the odometry's or the tracking system's."""
    v_limit: float | None = None
    """Greatest speed ever commanded [m/s], 1.2 times the path's if not given; the robot's own limit
    if that is less."""
    w_limit: float = 1.0
    """Greatest yaw rate ever commanded [rad/s]; the robot's own limit if that is less."""
    lookahead: float = 0.0
    """Distance that the robot keeps behind its target (Sec. 4.5) [m]."""
    patience: float = 30.0
    """Time for which a robot is waited for, before the drive and under its emergency stop [s]."""
    out: cli.AnyPath = None
    """Folder for the files; runs/ros/CONTROLLER-REFERENCE if not given."""
    overwrite: bool = False
    """Replace files that are there already."""
    config: cli.AnyPath = None
    """JSON file of a run of this program: its options hold where no others are given."""


class ControlNode:
    """The node's loop: states go to the follower as they come, commands out at their instants."""

    def __init__(self, node: Node, follower: PathFollower, options: Control) -> None:
        """Open the topics of the options, which all have names; nothing is sent yet."""
        self._node = node
        self._follower = follower
        self._options = o = options
        self._clock = node.clock
        self._speeds = msg.STAND_STILL
        self._speeds_at = -math.inf
        self._last_held = ""
        self._warned_late = False
        self._tree = msg.FrameTree()
        self._frames: list[str] = []
        self.drove = 0.0
        """Time for which the robot was driven [s]."""
        node.advertise(o.command, "geometry_msgs/msg/Twist")
        node.subscribe(o.odometry, _ODOMETRY, self._read_odometry, _FEEDBACK_KEPT)
        node.subscribe(o.stop, "std_msgs/msg/Bool", lambda m: bool(m.data), msg.STOPS_KEPT)
        node.subscribe(o.pose, "geometry_msgs/msg/PoseStamped", msg.read_pose, _POSES_KEPT)
        # what follows is taken as it is read
        self._restart = o.topic(msg.RESTART_TOPIC)
        node.subscribe(self._restart, "std_msgs/msg/Bool", lambda m: follower.confirm(bool(m.data)))
        if o.wheels != o.odometry:
            node.subscribe(
                o.wheels,
                _ODOMETRY,
                lambda m: follower.supervisor.take_wheels(*msg.read_wheels(m)),
                _FEEDBACK_KEPT,
            )
        node.subscribe(
            o.imu,
            "sensor_msgs/msg/Imu",
            lambda m: follower.supervisor.take_gyro(*msg.read_gyro(m)),
            _FEEDBACK_KEPT,
        )
        for name in ("/tf", "/tf_static") if o.frame else ():
            node.subscribe(
                o.topic(name),
                "tf2_msgs/msg/TFMessage",
                lambda m: self._tree.take(msg.read_transforms(m)),
                _TRANSFORMS_KEPT,
                latch=True,
            )

    def run(self) -> None:
        """Wait for the robot, drive it, and stop it, however the drive ends.

        Raises:
            StoppedError: no robot came, or it had to be stopped.
            KeyboardInterrupt: the user interrupted; the robot was commanded to stand before.
        """
        self._wait()  # until then the robot is somebody else's: nothing is sent
        _logger.info("driving")
        began = self._clock()
        try:
            self._drive()
            _logger.info("arrived: the robot is stopped")
        except SsmrError as error:
            _logger.error("the robot is stopped: %s", error)
            raise StoppedError(str(error)) from error
        except KeyboardInterrupt:
            _logger.warning("interrupted: the robot is stopped")
            raise
        finally:
            self.drove = self._clock() - began
            self._stand_still()

    def _stand_still(self) -> None:
        """Command the robot to stand for `STOP_TIME`, and go on recording its pose."""
        until = self._clock() + STOP_TIME
        while (now := self._clock()) < until:
            self._node.publish(self._options.command, msg.twist_message(*msg.STAND_STILL))
            while (left := now + VELOCITY_PERIOD - self._clock()) > 0.0:
                for topic, value in self._node.receive(left):
                    if topic == self._options.pose:
                        self._follower.track(*value[:2])

    def _wait(self) -> None:
        began = self._clock()
        logged = ""
        o = self._options
        _logger.info("waiting for the robot on %s", o.odometry)
        while self._follower.phase == "waiting":
            heard = self._node.subscribers(o.command) > 0
            why = f"nobody listens to {o.command}"
            if heard:
                why = self._refusals() or self._follower.why_waiting
            if self._clock() > began + o.patience:
                raise StoppedError(f"no robot to drive after {o.patience:g} s: {why}")
            messages = self._node.receive(0.1)
            if heard:  # a message that comes before is old when it counts
                self._take(messages)
            if why != logged and self._clock() > began + 1.0:
                logged = why
                self._node.say("waiting", f"still waiting: {why}", logging.INFO)

    def _refusals(self) -> str:
        """What is wrong with feedback that comes and cannot be used; empty where nothing is."""
        o = self._options
        topics = (o.pose, o.odometry) if o.feedback == "pose" else (o.odometry,)
        return "; ".join(filter(None, map(self._node.refusals, topics)))

    def _drive(self) -> None:
        """Take messages as they come, and send commands at absolute deadlines."""
        start = self._clock() + _SLACK
        k = 0
        while self._follower.phase == "driving":
            if (left := start + k * VELOCITY_PERIOD - self._clock()) > 0.0:
                self._take(self._node.receive(left))
                continue
            if self._follower.held and _enter_was_pressed():
                self._follower.confirm()
            command = self._follower.command(self._clock(), self._refusals())
            self._log_changes()
            self._node.publish(self._options.command, msg.twist_message(*command))
            passed = math.floor((self._clock() - start) / VELOCITY_PERIOD)
            k = max(k + 1, passed)  # no deadline that was slept through is made up for

    def _log_changes(self) -> None:
        """Warn when the robot is held or goes on, and once when feedback is late."""
        follower = self._follower
        if follower.held != self._last_held:
            self._last_held = follower.held
            if follower.held:
                _logger.warning("the robot is held: %s", follower.held)
                if self._options.restart == "confirm":
                    _logger.warning("it goes on by Enter, or by true on %s", self._restart)
            else:
                _logger.warning("the robot goes on")
        if follower.late > LATE and not self._warned_late:
            self._warned_late = True
            _logger.warning("%s", _late_sentence(follower.late))

    def _take(self, messages: Sequence[tuple[str, Any]]) -> None:
        o = self._options
        for topic, value in messages:
            if topic == o.stop:
                self._follower.take_stop(value)
            elif topic == o.pose:
                self._take_pose(*value)
            elif topic == o.odometry and o.feedback == "odometry":
                self._follow(*value)

    def _read_odometry(self, message: Any) -> tuple[float, Observation, str]:
        """Read odometry; a ValueError says that it is of other frames than that before."""
        stamp, seen, *frames = msg.read_odometry(message)
        self._frames = self._frames or frames
        if frames != self._frames:
            raise ValueError(f"its frames are {frames}, and were {self._frames}")
        self._speeds = (seen.v, seen.w)
        self._speeds_at = self._clock()
        return stamp, seen, frames[0]

    def _take_pose(self, stamp: float, seen: Observation, frame: str) -> None:
        """Take a pose of a tracking system or of a localiser."""
        o = self._options
        if not self._follower.track(stamp, seen):
            text = f"{o.pose}: stamp {stamp:.3f} s does not go on from those before"
            self._node.say("tracked", text)
        if o.feedback == "pose" and self._clock() - self._speeds_at <= FRESH:
            v, w = self._speeds
            self._follow(stamp, seen._replace(v=v, w=w), frame)

    def _follow(self, stamp: float, seen: Observation, frame: str) -> None:
        """Let the follower have a state, and know where its frame is."""
        if self._options.frame:
            try:
                self._follower.place_feedback(self._tree.pose_in(self._options.frame, frame))
            except ValueError as error:
                self._follower.unplaced = str(error)
        self._follower.update(stamp, seen, self._clock())


def _enter_was_pressed() -> bool:
    """Return whether somebody pressed Enter in this program's terminal, if it has one."""
    stdin = sys.stdin
    if stdin is None or stdin.closed or not stdin.isatty():
        return False
    try:
        ready, _, _ = select.select([stdin], [], [], 0.0)
    except (OSError, ValueError):  # Windows waits for sockets alone
        return False
    return bool(ready and stdin.readline())


def _late_sentence(late: float) -> str:
    """Return a sentence about feedback that is late by some time [s]."""
    return (
        f"the robot answers {late:.2f} s later than its profile says: "
        "its odometry is late, or its dead time is longer; "
        "mpc and laws with a predictor have learnt it, others overshoot"
    )


def control(options: Control) -> Tracked:
    """Drive a robot along a reference: the simulated one or a real one.

    It starts when feedback comes steadily from a robot that stands, near the beginning of its path
    if that has a frame.

    The robot is stopped where it rests at the reference's end, on Ctrl-C, and on any error; when
    feedback is older than 0.5 s or five messages, or when its signals contradict each other: the
    pose its speeds, speeds and wheels the commands, wheels the gyro.

    The robot is held while the emergency stop is on, and where no motion is seen though it is told
    to move. It goes on by a confirmation, with at most 1.2 times the path's speed until the target
    is within 50 mm.

    Writes track.json and track.png, also of a drive that was stopped.

    The tracking system's pose judges the drive, else the odometry's.

    Raises:
        ValueError: an option that cannot be; cyclonedds is missing, or the network interface is not
            there.
        StoppedError, KeyboardInterrupt: the drive ended before the robot had gone anywhere.
    """
    profile = choose_profile(options.profile, options.robot, "thesis-lab")
    robot = profile.robot.name
    o = _with_topics(options, robot)
    law, gains = chosen_controller(o.controller, profile, o.gains)
    robots = [make_robot(profile, "mujoco")]
    o, path = _find_frame(o)
    reference, waypoints, remarks = open_path(path, o.speed, robots, law)
    for remark in [*remarks, *profile.unfitted(["mujoco"])]:
        _logger.info("%s", remark)
    law = law.on(robots[0].drive)
    follower = PathFollower(
        law,
        waypoints,
        v_limit=o.v_limit,
        w_limit=o.w_limit,
        lookahead=o.lookahead,
        patience=o.patience,
        auto_restart=o.restart == "auto",
        framed=bool(o.frame),
    )
    status = _ARRIVED
    why = ""
    try:
        with closing(Node(f"{msg.ros_name(robot)}_control", o)) as node:
            loop = ControlNode(node, follower, o)
            loop.run()
    except (KeyboardInterrupt, StoppedError) as error:
        if not follower.has_run:
            raise
        status = INTERRUPTED
        if isinstance(error, StoppedError):
            status = "stopped"
            why = str(error)
    waypoints = follower.waypoints
    conditions = {
        "feedback": f"{o.feedback} by ROS",
        "frame": o.frame,
        "judged_by": o.pose if follower.tracked else o.odometry,
        "lookahead_m": o.lookahead,
        "v_max_m_s": follower.v_limit,
        "w_max_rad_s": follower.w_limit,
        "velocity_period_s": VELOCITY_PERIOD,
        "held_s": follower.held_time,
        "late_s": follower.late,
    }
    return Tracked.of(
        [Followed.of("ros", follower.run(), waypoints, conditions, loop.drove)],
        law.name,
        reference,
        waypoints.speed,
        gains=gains,
        profile=profile,
        remarks=[*remarks, *_drive_remarks(follower, status)],
        stopped_because=why,
        status=status,
        failure=StoppedError(why) if why else None,
    )


def _find_frame(o: Control) -> tuple[Control, str | Waypoints]:
    """Return options with the frame of the reference, and its name or the path that came.

    Raises:
        ValueError: a file of waypoints cannot be read, or is not in the frame of the options.
        StoppedError: no path came.
    """
    path = Path(o.reference)
    reference: str | Waypoints = o.reference
    if not o.reference.startswith("/") or path.suffix or path.exists():
        frame = frame_of_waypoints(o.reference)
    else:
        with closing(Node("path", o)) as node:
            node.subscribe(o.reference, "nav_msgs/msg/Path", msg.read_path, latch=True)
            until = node.clock() + o.patience
            while not (came := node.receive(0.1)):
                if node.clock() >= until:
                    why = node.refusals(o.reference) or "nothing came, and there is no such file"
                    raise StoppedError(f"no path on {o.reference} for {o.patience:g} s: {why}")
        frame, poses = came[0][1]
        o = replace(o, speed=o.speed or DEFAULT_SPEED)
        reference = _waypoints_of(poses)
    if o.frame and frame not in ("", o.frame):
        raise ValueError(f"{o.reference} is in the frame {frame}, and --frame is {o.frame}")
    return replace(o, frame=o.frame or frame), reference


def _waypoints_of(poses: FloatArray) -> Waypoints:
    """Return (N, 3) poses as a path, driven backwards where they face against it.

    Orientations that lie across it, or are one but for the goal's, are of a planner that plans
    none: then it is driven forwards.
    """
    planned = len(np.unique(poses[:-1, 2])) > 1
    try:
        return Waypoints.from_path(poses[:, :2], DEFAULT_SPEED, poses[:, 2] if planned else None)
    except ValueError:
        return Waypoints.from_path(poses[:, :2], DEFAULT_SPEED)


def _with_topics(options: Control, robot: str) -> Control:
    """Return options whose topics are named, by default those of a Clearpath robot.

    Raises:
        ValueError: a patience that is not positive.
    """
    if not options.patience > 0.0:
        raise ValueError(f"--patience {options.patience:g} s must be positive")
    named: dict[str, Any] = {}
    for name, topic in _TOPICS.items():
        named[name] = getattr(options, name) or options.topic(topic)
    return replace(options, pose=options.pose or msg.tracking_topic(robot), **named)


def _drive_remarks(follower: PathFollower, status: str) -> list[str]:
    """Return sentences on a drive that ended before its reference, waited, or was late."""
    remarks = []
    if status != _ARRIVED:
        remarks.append(
            f"The drive ended before the reference did ({status}): "
            "its path is compared with the whole reference, and "
            "the errors to the moving target cover the time until then."
        )
    if follower.held_time:
        remarks.append(f"The robot was held for {follower.held_time:.1f} s; that time is left out.")
    if follower.late > LATE:
        remarks.append(f"Warning: {_late_sentence(follower.late)}.")
    return remarks
