"""Join a graph of ROS 2 as the simulated robot, or as the controller of a robot."""

from __future__ import annotations

import logging
import math
import time
from typing import cast

from ssmr.types import State
from validation import store
from validation.bench.gains import GainSet
from validation.bench.tracked import TrackedRobot, reference_of, track_metrics
from validation.plants.profile import Profile, make_plant
from validation.report.tracking import Tracked
from validation.ros.commands import STAND_STILL, CommandGate, ros_name
from validation.ros.control import START_PATIENCE, ControlNode, RobotTopics, connect_control
from validation.ros.graph import Graph
from validation.ros.pilot import Pilot, StoppedError
from validation.ros.port import Port
from validation.ros.result import DriveStatus, drive_report
from validation.ros.robot import SensorSettings, SimulatedRobot
from validation.ros.ros2 import Ros2Port
from validation.ros.sim import SimNode, SimReport, connect_simulation
from validation.simulator.plant import MujocoPlant

_logger = logging.getLogger(__name__)


def open_port(name: str, graph: Graph) -> Port:
    """Return a port of a new node on a graph.

    Raises:
        NoGraphError: cyclonedds is missing, or the network interface is not there.
    """
    return Ros2Port(name, graph)


def simulate_robot(
    profile: Profile,
    start: State | None = None,
    duration: float = math.inf,
    sensors: SensorSettings | None = None,
    *,
    wall_time: bool = False,
    graph: Graph | None = None,
) -> SimReport:
    """Put the simulated robot on the graph, in real time, until `duration` [s] is over or the user interrupts.

    Args:
        profile: parameters of the robot.
        start: pose in the tracking system's frame; the origin if not given.
        duration: time after which to end [s].
        sensors: noise of the sensors, disturbance and seed.
        wall_time: stamp with the wall's time; else time begins at 0.
        graph: what to join; domain 0 if not given.

    Raises:
        NoGraphError: cyclonedds is missing, or the network interface is not there.
    """
    settings, state = sensors or SensorSettings(), start or State()
    port = open_port(f"{ros_name(profile.robot.name)}_simulation", graph or Graph())
    try:
        plant = cast(MujocoPlant, make_plant(profile, "mujoco"))
        compiled = SimulatedRobot(plant, settings)  # compiles the kernels, and is not used afterwards
        compiled.advance(1, STAND_STILL)
        compiled.sense()
        robot = SimulatedRobot(plant, settings, state)
        connect_simulation(port, profile.robot)
        node = SimNode(port, robot, CommandGate(port.graph.sources), stamp_offset=time.time() if wall_time else 0.0)
        said = "the robot of profile %s stands at x %g m, y %g m, yaw %g rad; Ctrl-C ends"
        _logger.info(said, profile.name, state.x, state.y, state.yaw)
        try:
            node.run(duration)
        finally:
            for line in node.report.lines():
                _logger.info(line)
        return node.report
    finally:
        port.close()


def control_robot(
    pilot: Pilot,
    gains: GainSet | None,
    profile: Profile,
    reference: str,
    topics: RobotTopics,
    patience: float = START_PATIENCE,
    graph: Graph | None = None,
) -> Tracked:
    """Drive a robot on the graph along the pilot's reference, and stop it at the end, in doubt, and on any error.

    Args:
        pilot: the tracker.
        gains: gains of its controller, for the result; None for a user's own.
        profile: the profile that the controller was designed on, for the result.
        reference: name of the reference, for the result.
        topics: topics of the robot and of a tracking system.
        patience: time for which a robot is waited for [s].
        graph: what to join; domain 0 if not given.

    Returns:
        The drive as far as it came. `status` says how it ended: the robot arrived, the user interrupted, or the robot
        had to be stopped.

    Raises:
        NoGraphError: cyclonedds is missing, or the network interface is not there.
        StoppedError: no robot came, or it had to be stopped before it had gone anywhere.
        KeyboardInterrupt: the user interrupted before the robot had gone anywhere.
    """
    port = open_port(f"{ros_name(profile.robot.name)}_control", graph or Graph())
    status, why = DriveStatus.ARRIVED, ""
    try:
        connect_control(port, topics)
        node = ControlNode(port, pilot, topics, patience=patience)
        try:
            node.run()
        except KeyboardInterrupt:
            if not pilot.has_run:
                raise
            status = DriveStatus.INTERRUPTED
        except StoppedError as error:
            if not pilot.has_run:
                raise
            status, why = DriveStatus.STOPPED, str(error)
    finally:
        port.close()
    run, waypoints, s = pilot.run(), pilot.waypoints, pilot.settings
    options = {
        "feedback": f"{'pose' if topics.law_by_pose else 'odometry'} by ROS",
        "judged_by": topics.pose if pilot.tracked else topics.odometry,
        "lookahead_m": s.lookahead,
        "v_max_m_s": s.v_limit,
        "w_max_rad_s": s.w_limit,
        "velocity_period_s": s.period,
    }
    name, values = (gains.name, dict(gains.values)) if gains else ("none", {})
    robot = TrackedRobot(
        pilot.name, name, values, reference, waypoints.speed, "ros", profile.name, 0, run,
        reference_of(run, waypoints), track_metrics(run, waypoints, options), node.drove, options,
        store.versions(), body=profile.robot,
    )  # fmt: skip
    return drive_report(robot, status, why)
