"""`python -m validation.ros sim|control`: the MuJoCo Husky on a ROS 1 graph, and controllers for whatever robot is there."""

from __future__ import annotations

import logging
import math
import signal
import time
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal, cast

import tyro

from ssmr.types import State
from validation import cli, store
from validation.plants.profile import load, make_plant
from validation.robots.plant import MujocoPlant
from validation.ros import control as ros_control
from validation.ros import sim as ros_sim
from validation.ros.commands import CommandGate
from validation.ros.pilot import Pilot, PilotSettings
from validation.ros.port import Port
from validation.ros.robot import SensorSettings, SimulatedRobot, warm_up
from validation.track.gains import load_gains
from validation.track.report import track_notes, track_tables
from validation.track.result import TrackResult
from validation.track.run import DEFAULT_SPEED, NAMED, default_gains, write
from validation.track.tracking import make_controller, rate_within, reference_of
from validation.track.waypoint_files import open_reference

_logger = logging.getLogger("validation.ros")


def sim(
    *,
    profile: str = "thesis-lab",
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    duration: float = math.inf,
    no_noise: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    disturbance: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    wall_time: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    seed: int = 0,
) -> None:
    """Put the MuJoCo Husky on the graph, in real time, until Ctrl-C.

    It listens to /joy_teleop/cmd_vel, /twist_marker_server/cmd_vel, /move_base/cmd_vel and /cmd_vel, and publishes
    /odometry/filtered, /husky_velocity_controller/odom, /imu/data, /vrpn_client_node/husky/pose, /tf and /clock.

    Args:
        profile: Name of a shipped profile or path of a TOML file.
        start: Where the robot stands in the tracking system's frame: x [m], y [m], yaw [rad].
        duration: End by yourself after so much time [s].
        no_noise: Encoders and gyro without noise.
        disturbance: Push the robot's yaw at random (Sec. 3.4.5).
        wall_time: Stamp with the wall's time and leave /use_sim_time alone; else time begins at 0 and /use_sim_time is set.
        seed: Seed of noise and disturbance.
    """
    with cli.mistakes_are_users():
        if seed < 0 or not duration > 0.0 or not all(map(math.isfinite, start)):
            raise cli.UserError(
                f"--seed {seed} must not be negative, --duration {duration:g} positive, --start {start} finite"
            )
        chosen = load(profile)
    settings = SensorSettings(noise=not no_noise, disturbance=disturbance, seed=seed)
    port = _open("husky_simulation")
    try:
        with cli.mistakes_are_users():
            plant = cast(MujocoPlant, make_plant(chosen, "mujoco"))
        warm_up(SimulatedRobot(plant, settings))
        robot = SimulatedRobot(plant, settings, State(*start))
        if not wall_time:
            port.set_parameter(ros_sim.SIM_TIME_PARAMETER, True)
        ros_sim.connect_simulation(port)
        node = ros_sim.SimNode(port, robot, CommandGate(), stamp_offset=time.time() if wall_time else 0.0)
        _logger.info("the Husky of profile %s stands at x %g m, y %g m, yaw %g rad; Ctrl-C ends", profile, *start)
        try:
            node.run(duration)
        finally:
            for line in node.report.lines():
                _logger.info(line)
    finally:
        port.close("the simulation has ended")


def control(
    controller: Annotated[Literal["pid", "lqr", "lqr-scheduled", "smc"], tyro.conf.Positional],
    reference: Annotated[str, tyro.conf.Positional],
    /,
    *,
    speed: float | None = None,
    profile: str = "thesis-lab",
    gains: str | None = None,
    odometry: str = ros_control.Topics.odometry,
    pose: str = ros_control.Topics.pose,
    command: str = ros_control.Topics.command,
    feedback: Literal["odometry", "pose"] = "odometry",
    absolute: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    v_limit: float = PilotSettings.v_limit,
    w_limit: float = PilotSettings.w_limit,
    lookahead: float = 0.0,
    patience: float = ros_control.START_PATIENCE,
    out: Path | None = None,
) -> None:
    """Drive whatever robot answers on a Husky's topics along a reference: the simulated one, or the real one.

    It starts when feedback comes steadily from a robot that stands. It stops the robot at the reference's end, on Ctrl-C, on
    any error, when feedback is older than 0.5 s, when the master is gone, and when the robot is 3 m from its target. Writes
    track.json and track.png, judged by the tracking system's pose where there is one, else by the odometry's.

    Args:
        controller: pid and lqr are the thesis'; lqr-scheduled (linearised about the operating speed) and smc (sliding mode)
            go beyond it.
        reference: line, circle, sine, generic, or a file of waypoints (.csv, .xlsx: x, y[, t]).
        speed: Mean speed between waypoints [m/s]; 0.25 for named references. A file with times needs none, and a speed
            replaces them.
        profile: Name of a shipped profile or path of a TOML file; model-based laws are designed on it.
        gains: published, manual (lqr), tuned, or the path of a TOML file; published where the thesis has any, else tuned.
        odometry: Topic of nav_msgs/Odometry: speeds, and the pose unless --feedback pose.
        pose: Topic of geometry_msgs/PoseStamped: a tracking system's.
        command: Topic of geometry_msgs/Twist on which the robot listens.
        feedback: Whether the law sees the odometry's pose or the tracking system's.
        absolute: Waypoints are places in the feedback's frame; else the reference begins where the robot stands.
        v_limit: Greatest speed ever commanded [m/s].
        w_limit: Greatest yaw rate ever commanded [rad/s].
        lookahead: Distance at which the robot keeps behind its target [m] (Sec. 4.5).
        patience: How long to wait for the robot [s].
        out: Folder for the results; runs/ros/CONTROLLER-REFERENCE if not given.
    """
    with cli.mistakes_are_users():
        chosen, wanted = load(profile), load_gains(controller, gains or default_gains(controller))
        law = make_controller(chosen, wanted)
        label, waypoints = open_reference(reference, DEFAULT_SPEED if speed is None and reference in NAMED else speed)
        settings = PilotSettings(v_limit=v_limit, w_limit=w_limit, lookahead=lookahead, absolute=absolute)
        if not patience > 0.0:
            raise cli.UserError(f"--patience {patience:g} s must be positive")
        pilot = Pilot(law, waypoints, settings)
    folder = cli.output_folder(out or Path("runs") / "ros" / f"{controller}-{Path(reference).stem}")
    topics = ros_control.Topics(odometry, pose, command, feedback == "pose")
    port = _open("husky_control")
    try:
        ros_control.connect_control(port, topics)
        node = ros_control.ControlNode(port, pilot, topics, patience=patience)
        node.run()
    finally:
        port.close("the controller has ended")
    run = pilot.run()
    metrics = rate_within(run, waypoints, math.inf, v_limit, w_limit)
    options = {
        "feedback": f"{feedback} by ROS",
        "judged_by": pose if pilot.tracked else odometry,
        "lookahead_m": lookahead,
        "v_max_m_s": v_limit,
        "w_max_rad_s": w_limit,
        "velocity_period_s": settings.period,
    }
    result = TrackResult(
        law.name, wanted.name, dict(wanted.values), label, waypoints.speed, "ros", chosen.name, 0, run,
        reference_of(run, waypoints), metrics, node.drove, options, store.versions(),
    )  # fmt: skip
    cli.report(track_tables([result]), track_notes([result]), write([result], folder, recording=False))


def _open(name: str) -> Port:
    """A port; from now on SIGTERM ends a node as Ctrl-C does.

    Raises:
        UserError: no rospy, or no master.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGINT, interrupt)
    with cli.mistakes_are_users():
        return Port(name)


def program() -> Any:
    """What parses the command line: one subcommand a node."""
    return (
        Annotated[Any, tyro.conf.subcommand(name="sim", constructor=sim)]
        | Annotated[Any, tyro.conf.subcommand(name="control", constructor=control)]
    )


if __name__ == "__main__":
    cli.run(program(), "python -m validation.ros")
