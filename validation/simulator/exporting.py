"""A robot's description -> files of other programs: URDF, SDF, MJCF, ros2_control and nav2.

URDF and SDF have plain shapes, four wheels and the IMU's frame. Products of inertia are 0, as in a
robot's file.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from xml.sax.saxutils import quoteattr  # nosec B406 # it writes, and reads nothing

from ssmr.robot.vehicle import Drive
from validation.simulator.calibration import Calibration
from validation.simulator.checking import robot_outline
from validation.simulator.description import WHEELS, Robot
from validation.simulator.model import adjust_model, on_ground, pair_with_ground
from validation.simulator.motors import set_motors

SETTLING = 1.5
"""Time in which the slips of an exported robot's motors settle, in its time steps [1]. The plant's
settle in one, which is exact; these move a path by a hundredth of a millimetre, and the file will
do for steps of up to two and a half of its own, where the plant's would diverge beyond two."""
_URDF = """\
<robot name={name}>
  <link name="base_link"/>
  <link name="chassis_link">
    <inertial>
      <origin xyz="{robot.com[0]} {robot.com[1]} {robot.com[2]}"/>
      <mass value="{robot.base_mass}"/>
      <inertia ixx="{robot.inertia[0]}" iyy="{robot.inertia[1]}" izz="{robot.inertia[2]}"
               ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual>
      <origin xyz="{robot.body_centre[0]} {robot.body_centre[1]} {robot.body_centre[2]}"/>
      <geometry>
        <box size="{robot.body_size[0]} {robot.body_size[1]} {robot.body_size[2]}"/>
      </geometry>
    </visual>
    <collision>
      <origin xyz="{robot.body_centre[0]} {robot.body_centre[1]} {robot.body_centre[2]}"/>
      <geometry>
        <box size="{robot.body_size[0]} {robot.body_size[1]} {robot.body_size[2]}"/>
      </geometry>
    </collision>
  </link>
  <joint name="chassis_joint" type="fixed">
    <parent link="base_link"/>
    <child link="chassis_link"/>
  </joint>
  <link name="imu_link"/>
  <joint name="imu_joint" type="fixed">
    <parent link="base_link"/>
    <child link="imu_link"/>
    <origin xyz="{robot.imu[0]} {robot.imu[1]} {robot.imu[2]}"/>
  </joint>
{wheels}</robot>
"""
_URDF_WHEEL = """\
  <link name="{wheel}_wheel_link">
    <inertial>
      <mass value="{robot.wheel_mass}"/>
      <inertia ixx="{moments[0]}" iyy="{moments[1]}" izz="{moments[2]}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual>
      <origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="{robot.wheel_radius}" length="{robot.wheel_width}"/></geometry>
    </visual>
    <collision>
      <origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="{robot.wheel_radius}" length="{robot.wheel_width}"/></geometry>
    </collision>
  </link>
  <joint name={joint} type="continuous">
    <parent link="base_link"/>
    <child link="{wheel}_wheel_link"/>
    <origin xyz="{place[0]} {place[1]} {place[2]}"/>
    <axis xyz="0 1 0"/>
  </joint>
"""
_SDF = """\
<sdf version="1.7">
  <model name={name}>
    <pose>0 0 {robot.base_height} 0 0 0</pose>
    <link name="base_link">
      <inertial>
        <pose>{robot.com[0]} {robot.com[1]} {robot.com[2]} 0 0 0</pose>
        <mass>{robot.base_mass}</mass>
        <inertia>
          <ixx>{robot.inertia[0]}</ixx>
          <iyy>{robot.inertia[1]}</iyy>
          <izz>{robot.inertia[2]}</izz>
        </inertia>
      </inertial>
      <visual name="base_link_visual">
        <pose>{robot.body_centre[0]} {robot.body_centre[1]} {robot.body_centre[2]} 0 0 0</pose>
        <geometry><box>
          <size>{robot.body_size[0]} {robot.body_size[1]} {robot.body_size[2]}</size>
        </box></geometry>
      </visual>
      <collision name="base_link_collision">
        <pose>{robot.body_centre[0]} {robot.body_centre[1]} {robot.body_centre[2]} 0 0 0</pose>
        <geometry><box>
          <size>{robot.body_size[0]} {robot.body_size[1]} {robot.body_size[2]}</size>
        </box></geometry>
      </collision>
    </link>
    <frame name="imu_link" attached_to="base_link">
      <pose>{robot.imu[0]} {robot.imu[1]} {robot.imu[2]} 0 0 0</pose>
    </frame>
{wheels}  </model>
</sdf>
"""
_SDF_WHEEL = """\
    <link name="{wheel}_wheel_link">
      <pose relative_to="base_link">{place[0]} {place[1]} {place[2]} 0 0 0</pose>
      <inertial>
        <mass>{robot.wheel_mass}</mass>
        <inertia>
          <ixx>{moments[0]}</ixx>
          <iyy>{moments[1]}</iyy>
          <izz>{moments[2]}</izz>
        </inertia>
      </inertial>
      <visual name="{wheel}_wheel_link_visual">
        <pose>0 0 0 1.5707963267948966 0 0</pose>
        <geometry>
          <cylinder>
            <radius>{robot.wheel_radius}</radius>
            <length>{robot.wheel_width}</length>
          </cylinder>
        </geometry>
      </visual>
      <collision name="{wheel}_wheel_link_collision">
        <pose>0 0 0 1.5707963267948966 0 0</pose>
        <geometry>
          <cylinder>
            <radius>{robot.wheel_radius}</radius>
            <length>{robot.wheel_width}</length>
          </cylinder>
        </geometry>
        <surface>
          <friction><ode><mu>{robot.friction}</mu><mu2>{robot.friction}</mu2></ode></friction>
        </surface>
      </collision>
    </link>
    <joint name={joint} type="revolute">
      <parent>base_link</parent>
      <child>{wheel}_wheel_link</child>
      <axis>
        <xyz>0 1 0</xyz>
        <limit>
          <lower>-1e16</lower>
          <upper>1e16</upper>
          {effort}
        </limit>
      </axis>
    </joint>
"""
_MISSED = 5.0
_COMMANDED_S = 0.05
"""Number of missing commands after which a robot is to stop [1], and the usual time between two
[s], where the driver does not read them more rarely."""
_DIFF_DRIVE = """\
# wheel_separation_multiplier is by how wheels that rolled turned the robot; fitted numbers have a
# standard error beside them. The robot turns as it is commanded as far as its wheels reach the
# rates that this asks of them: motors that droop under load turn it less. What a profile knows of
# the driver of before (command_half_track, command_radius) no longer holds: log a drive with these
# numbers, and calibrate from it. Put your controller's name in place of diff_drive_controller.
diff_drive_controller:
  ros__parameters:
    left_wheel_names: {left_names}
    right_wheel_names: {right_names}
    wheel_separation: {wheel_separation}
    wheel_separation_multiplier: {wheel_separation_multiplier}
    wheel_radius: {wheel_radius}
    left_wheel_radius_multiplier: {left_wheel_radius_multiplier}
    right_wheel_radius_multiplier: {right_wheel_radius_multiplier}
    linear.x.has_velocity_limits: true  # v_max of the driver
    linear.x.max_velocity: {v_max}
    linear.x.min_velocity: -{v_max}
    linear.x.has_acceleration_limits: true  # acceleration_v of the driver
    linear.x.max_acceleration: {acceleration_v}
    linear.x.min_acceleration: -{acceleration_v}
    angular.z.has_velocity_limits: true  # w_max of the driver
    angular.z.max_velocity: {w_max}
    angular.z.min_velocity: -{w_max}
    angular.z.has_acceleration_limits: true  # acceleration_w of the driver
    angular.z.max_acceleration: {acceleration_w}
    angular.z.min_acceleration: -{acceleration_w}
    cmd_vel_timeout: {cmd_vel_timeout}
"""
"""Parameters of ros2_control's controller."""
_NAV2 = """\
# Limits and dead times of commands for nav2, by {source}.
# Load it behind your own parameters: the last value of a name counts. What is not known is left to
# nav2. The driver is to have the numbers of `robots export --to diff-drive`. MPPI knows ax_max,
# ax_min and az_max from Jazzy on, model_delay_* from Lyrical on.
controller_server:
  ros__parameters:
    FollowPath:
      vx_max: {v_max}
      vx_min: -{v_max}
      wz_max: {w_max}
      ax_max: {acceleration_v}
      ax_min: -{acceleration_v}
      az_max: {acceleration_w}
      model_delay_vx: {delay_v}  # with wheel_lag and half of command_ramp
      model_delay_wz: {delay_w}  # with wheel_lag and half of command_ramp
velocity_smoother:
  ros__parameters:
    max_velocity: [{v_max}, 0.0, {w_max}]
    min_velocity: [-{v_max}, 0.0, -{w_max}]
    max_accel: [{acceleration_v}, 0.0, {acceleration_w}]
    max_decel: [-{acceleration_v}, 0.0, -{acceleration_w}]
local_costmap:
  local_costmap:
    ros__parameters:
      footprint: "{footprint}"
global_costmap:
  global_costmap:
    ros__parameters:
      footprint: "{footprint}"
"""
"""Parameters of nav2, with the driver's numbers by their names."""


def urdf_text(robot: Robot) -> str:
    """Return a robot's URDF, in SI units.

    The hull and its inertia stand in a link `chassis_link`, fixed to the base, because programs
    that read URDFs refuse inertia in the first link. Wheels have links like `front_left_wheel_link`
    and the robot's `wheel_joints`.
    """
    return _description_text(_URDF, _URDF_WHEEL, robot)


def sdf_text(robot: Robot) -> str:
    """Return a robot's SDF model, in SI units, which stands with its tyres on the plane z = 0.

    Tyres are cylinders with the robot's friction in both directions and without `fdir1`. A joint's
    effort is limited to half of that of a side's motors. SDF has no element for belts, rotors and
    speed loops: those are left out.
    """
    most = 0.5 * robot.drive.torque_limit
    effort = f"<effort>{most}</effort>" if math.isfinite(most) else ""
    return _description_text(_SDF, _SDF_WHEEL, robot, effort)


def _description_text(whole: str, each: str, robot: Robot, effort: str = "") -> str:
    """Return the templates of a description and of each wheel in it, with a robot's numbers."""
    wheels = ""
    for wheel, joint, place in zip(WHEELS, robot.wheel_joints, robot.wheel_places, strict=True):
        wheels += each.format(
            robot=robot,
            wheel=wheel,
            joint=quoteattr(joint),
            place=place,
            moments=robot.wheel_moments,
            effort=effort,
        )
    return whole.format(robot=robot, name=quoteattr(robot.name), wheels=wheels)


def mjcf_text(calibration: Calibration, drive: Drive) -> str:
    """Return a calibrated robot on level ground as an MJCF that needs nothing but MuJoCo.

    It has the looks and sensors of the simulated robot, and moves as that does: both have MuJoCo's
    own actuators alone, whose inputs are wheel rates. Delay, ramps and limits of commands act
    before these rates, and are not in it.

    Args:
        calibration: the robot's numbers.
        drive: its motors.

    Raises:
        ValueError: numbers that do not go together.
    """
    spec = on_ground(calibration.robot, calibration.wheel_shape)
    if calibration.friction_ratio != 1.0:
        pair_with_ground(spec)
    model = spec.compile()
    adjust_model(model, calibration, drive)
    longest = set_motors(model, calibration, drive, settling=SETTLING)
    spec.copy_back(model)  # nearly all numbers, but not whether a limit counts, and no settings
    for joint in spec.joints:
        joint.actfrclimited = model.jnt_actfrclimited[joint.id]
        joint.actfrcrange = model.jnt_actfrcrange[joint.id]
    for actuator in spec.actuators:
        actuator.forcelimited = model.actuator_forcelimited[actuator.id]
    for name in ("timestep", "integrator", "solver", "iterations", "tolerance", "disableflags"):
        setattr(spec.option, name, getattr(model.opt, name))
    spec.comment = (
        "Inputs of actuators are wheel rates [rad/s]. Written for a time step of "
        f"{1e3 * calibration.timestep:.3g} ms; it will do for any up to {1e3 * longest:.2g} ms."
    )
    text = str(spec.to_xml())
    # MuJoCo writes six digits, which is half a micrometre of radius and 25 of a path
    for wheel in WHEELS:
        size = " ".join(map(repr, model.geom(f"{wheel}_tire").size.tolist()))
        text = re.sub(rf'(<geom name="{wheel}_tire"[^>]* size=)"[^"]*"', rf'\1"{size}"', text)
    return text


def diff_drive_yaml(
    robot: Robot,
    drive: Drive,
    multiplier: float,
    radii: tuple[float, float],
    errors: Mapping[str, float],
    fitted: Mapping[str, float],
    variances: Mapping[str, Sequence[float]],
) -> str:
    """Return parameters of ros2_control's `diff_drive_controller`; the robot turns as commanded.

    The controller asks the sides for the rates (v -+ multiplier separation / 2 omega) / (left or
    right radius).

    Args:
        robot: the robot.
        drive: the driver, whose limits the controller gets.
        multiplier: distance of the sides' centres of rotation over the track [1].
        radii: way of the left wheels over their turn and radius, and the same of the right [1].
        errors: standard errors of these numbers, by the names of the file.
        fitted: standard errors of the driver's numbers that were fitted, by their names.
        variances: of the odometry in x, y, z, roll, pitch and yaw, by the names of the file.
    """
    joints = robot.wheel_joints
    numbers = asdict(drive) | {
        "wheel_separation": robot.track,
        "wheel_separation_multiplier": multiplier,
        "wheel_radius": robot.wheel_radius,
        "left_wheel_radius_multiplier": radii[0],
        "right_wheel_radius_multiplier": radii[1],
        "cmd_vel_timeout": _MISSED * max(drive.hold, _COMMANDED_S),
    }
    remarks = _drive_origins(robot, drive, fitted)
    remarks |= {name: f"standard error {error:.2g}" for name, error in errors.items()}
    names = {"left_names": json.dumps(joints[0::2]), "right_names": json.dumps(joints[1::2])}
    text = _fill_rows(_DIFF_DRIVE, numbers, remarks, **names)
    for name, diagonal in variances.items():
        text += f"    {name}: [{', '.join(f'{variance:.3e}' for variance in diagonal)}]\n"
    return text


def nav2_yaml(robot: Robot, drive: Drive, errors: Mapping[str, float], source: str) -> str:
    """Return parameters of nav2: limits of MPPI and of the velocity smoother, and the footprint.

    MPPI's robot does as it is commanded after a dead time and within its accelerations, so half of
    the driver's ramp and the lag of its wheels count as dead time.

    Args:
        robot: the robot.
        drive: its driver.
        errors: standard errors of the driver's numbers that were fitted, by their names.
        source: what the numbers are of.
    """
    origins = _drive_origins(robot, drive, errors)
    numbers = asdict(drive.later(0.5 * drive.command_ramp + drive.wheel_lag))
    (x, y, _), (ahead, left, _) = robot_outline(robot).round(4).tolist()
    corners = [[ahead, left], [ahead, y], [x, y], [x, left]]
    return _fill_rows(_NAV2, numbers, origins, source=source, footprint=str(corners))


def _drive_origins(robot: Robot, drive: Drive, errors: Mapping[str, float]) -> dict[str, str]:
    """Return where each number of a driver is from: a fit, the profile or the robot's file."""
    origins = {}
    for name, value in asdict(drive).items():
        origin = "of the profile"
        if value == getattr(robot.drive, name):
            origin, _ = robot.source(f"drive.{name}")
        if name in errors:
            origin = f"standard error {errors[name]:.2g}"
        origins[name] = f"{name}: {origin}"
    return origins


def _fill_rows(
    template: str, numbers: Mapping[str, float], remarks: Mapping[str, str], **texts: str
) -> str:
    """Return the rows of a template in which no number is named that is infinite, so not known.

    Behind a row that is no comment stand the remarks on the numbers that it names.
    """
    rounded = {name: float(f"{value:.7g}") for name, value in numbers.items()}
    text = ""
    for row in template.splitlines():
        if math.isfinite(sum(rounded[name] for name in rounded if name in row)):
            named = [] if row[0] == "#" else [name for name in remarks if name in row]
            beside = "; ".join(remarks[name] for name in named)
            mark = "; " if "#" in row else "  # "
            text += row.format(**rounded, **texts) + (mark + beside) * bool(beside) + "\n"
    return text
