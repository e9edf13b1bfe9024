"""A robot's description -> files of other programs: URDF, SDF, MJCF, ros2_control and nav2.

URDF and SDF have plain shapes, four wheels and the IMU's frame. Products of inertia are 0, as in a
robot's file.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from xml.sax.saxutils import quoteattr  # nosec B406 # it writes, and reads nothing

from ssmr.robot.vehicle import Drive
from validation.simulator.calibration import Calibration
from validation.simulator.checking import robot_outline
from validation.simulator.description import WHEELS, Robot
from validation.simulator.model import adjust_model, on_ground, pair_with_ground
from validation.simulator.motors import set_motors

_ENDLESS = 1e16
"""Limit of a joint that turns without end, as SDFormat has it [rad]."""
SETTLING = 1.5
"""Time in which the slips of an exported robot's motors settle, in its time steps [1]. The plant's
settle in one, which is exact; these move a path by a hundredth of a millimetre, and the file will
do for steps of up to two and a half of its own, where the plant's would diverge beyond two."""
_LYING = (0.5 * math.pi, 0.0, 0.0)
"""Roll, pitch and yaw of a cylinder whose axis is that of a wheel [rad]."""


def _element_text(tag: str, *inside: str, **attributes: str) -> str:
    """Return the text of an XML element."""
    opened = tag
    for name, value in attributes.items():
        opened += f" {name}={quoteattr(value)}"
    if not inside:
        return f"<{opened}/>\n"
    return f"<{opened}>{''.join(inside)}</{tag}>\n"


_MISSED = 5.0
_COMMANDED_S = 0.05
"""Number of missing commands after which a robot is to stop [1], and the usual time between two
[s], where the driver does not read them more rarely."""
_DIFF_DRIVE = """\
# With wheel_separation_multiplier on it the robot turns as it is commanded. What a profile knows of
# the driver of before (command_half_track, command_radius) no longer holds: log a drive with these
# numbers, and calibrate from it. Put your controller's name in place of diff_drive_controller.
diff_drive_controller:
  ros__parameters:
"""
"""Beginning of the parameters of ros2_control's controller."""
_NAV2 = """\
# Limits and dead times of commands for nav2, by SOURCE.
# Load it behind your own parameters: the last value of a name counts. What is not known is left to
# nav2. The robot turns as it is commanded where its driver has the numbers of `robots export --to
# diff-drive`. MPPI knows ax_max, ax_min and az_max from Jazzy on, model_delay_* from Lyrical on.
controller_server:
  ros__parameters:
    FollowPath:
      vx_max: {v_max}  #
      vx_min: -{v_max}  #
      wz_max: {w_max}  #
      ax_max: {acceleration_v}  #
      ax_min: -{acceleration_v}  #
      az_max: {acceleration_w}  #
      model_delay_vx: {delay_v}  # with wheel_lag and half of command_ramp;
      model_delay_wz: {delay_w}  # with wheel_lag and half of command_ramp;
velocity_smoother:
  ros__parameters:
    max_velocity: [{v_max}, 0.0, {w_max}]  #
    min_velocity: [-{v_max}, 0.0, -{w_max}]  #
    max_accel: [{acceleration_v}, 0.0, {acceleration_w}]  #
    max_decel: [-{acceleration_v}, 0.0, -{acceleration_w}]  #
local_costmap:
  local_costmap:
    ros__parameters:
      footprint: "FOOTPRINT"
global_costmap:
  global_costmap:
    ros__parameters:
      footprint: "FOOTPRINT"
"""
"""Parameters of nav2, with the driver's numbers by their names."""


def urdf_text(robot: Robot) -> str:
    """Return a robot's URDF, in SI units.

    The hull and its inertia stand in a link `chassis_link`, fixed to the base, because programs
    that read URDFs refuse inertia in the first link. Wheels have links like `front_left_wheel_link`
    and the robot's `wheel_joints`.
    """
    e = _element_text

    def link(
        name: str, mass: float, com: Iterable[float], moments: Iterable[float], *shape: str
    ) -> str:
        ixx, iyy, izz = map(repr, moments)
        inertia = e("inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)
        inertial = e(
            "inertial", e("origin", xyz=_numbers_text(com)), e("mass", value=repr(mass)), inertia
        )
        return e("link", inertial, e("visual", *shape), e("collision", *shape), name=name)

    def joint(name: str, kind: str, child: str, at: Iterable[float], *axis: str) -> str:
        ends = e("parent", link="base_link"), e("child", link=child)
        return e("joint", *ends, e("origin", xyz=_numbers_text(at)), *axis, name=name, type=kind)

    origin = (0.0, 0.0, 0.0)
    hull = (
        e("origin", xyz=_numbers_text(robot.body_centre)),
        e("geometry", e("box", size=_numbers_text(robot.body_size))),
    )
    drum = e("cylinder", radius=repr(robot.wheel_radius), length=repr(robot.wheel_width))
    tyre = e("origin", xyz="0 0 0", rpy=_numbers_text(_LYING)), e("geometry", drum)
    axis = e("axis", xyz="0 1 0")
    parts = [
        e("link", name="base_link"),
        link("chassis_link", robot.base_mass, robot.com, robot.inertia, *hull),
        joint("chassis_joint", "fixed", "chassis_link", origin),
        e("link", name="imu_link"),
        joint("imu_joint", "fixed", "imu_link", robot.imu),
    ]
    for wheel, own, place in zip(WHEELS, robot.wheel_joints, robot.wheel_places, strict=True):
        name = f"{wheel}_wheel_link"
        parts.append(link(name, robot.wheel_mass, origin, robot.wheel_moments, *tyre))
        parts.append(joint(own, "continuous", name, place, axis))
    return e("robot", *parts, name=robot.name)


def sdf_text(robot: Robot) -> str:
    """Return a robot's SDF model, in SI units, which stands with its tyres on the plane z = 0.

    Tyres are cylinders with the robot's friction in both directions and without `fdir1`. A joint's
    effort is limited to half of that of a side's motors. SDF has no element for belts, rotors and
    speed loops: those are left out.
    """
    mu = repr(robot.friction)
    e = _element_text

    def link(
        name: str,
        pose: str,
        mass: float,
        com: Iterable[float],
        moments: Iterable[float],
        shapes: str,
    ) -> str:
        inertia = ""
        for key, moment in zip(("ixx", "iyy", "izz"), moments, strict=True):
            inertia += e(key, repr(moment))
        centre = e("pose", f"{_numbers_text(com)} 0 0 0")
        inertial = e("inertial", centre, e("mass", repr(mass)), e("inertia", inertia))
        return e("link", pose, inertial, shapes, name=name)

    def seen_and_hit(name: str, shape: str, surface: str = "") -> str:
        seen = e("visual", shape, name=f"{name}_visual")
        return seen + e("collision", shape, surface, name=f"{name}_collision")

    box = e("box", e("size", _numbers_text(robot.body_size)))
    hull = e("pose", f"{_numbers_text(robot.body_centre)} 0 0 0") + e("geometry", box)
    drum = e(
        "cylinder", e("radius", repr(robot.wheel_radius)), e("length", repr(robot.wheel_width))
    )
    tyre = e("pose", f"0 0 0 {_numbers_text(_LYING)}") + e("geometry", drum)
    grip = e("surface", e("friction", e("ode", e("mu", mu), e("mu2", mu))))
    limits = e("lower", repr(-_ENDLESS)) + e("upper", repr(_ENDLESS))
    if math.isfinite(robot.drive.torque_limit):
        limits += e("effort", repr(0.5 * robot.drive.torque_limit))
    axis = e("axis", e("xyz", "0 1 0"), e("limit", limits))
    imu = e("pose", f"{_numbers_text(robot.imu)} 0 0 0")
    parts = [
        e("pose", f"0 0 {robot.base_height!r} 0 0 0"),
        link(
            "base_link",
            "",
            robot.base_mass,
            robot.com,
            robot.inertia,
            seen_and_hit("base_link", hull),
        ),
        e("frame", imu, name="imu_link", attached_to="base_link"),
    ]
    for wheel, own, place in zip(WHEELS, robot.wheel_joints, robot.wheel_places, strict=True):
        pose = e("pose", f"{_numbers_text(place)} 0 0 0", relative_to="base_link")
        name = f"{wheel}_wheel_link"
        shapes = seen_and_hit(name, tyre, grip)
        parts.append(
            link(name, pose, robot.wheel_mass, (0.0, 0.0, 0.0), robot.wheel_moments, shapes)
        )
        ends = e("parent", "base_link"), e("child", name)
        parts.append(e("joint", *ends, axis, name=own, type="revolute"))
    return e("sdf", e("model", *parts, name=robot.name), version="1.7")


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
        size = _numbers_text(model.geom(f"{wheel}_tire").size)
        text = re.sub(rf'(<geom name="{wheel}_tire"[^>]* size=)"[^"]*"', rf'\1"{size}"', text)
    return text


def diff_drive_yaml(
    robot: Robot,
    multiplier: float,
    left: float = 1.0,
    right: float = 1.0,
    errors: Mapping[str, float] = MappingProxyType({}),
    drive: Drive | None = None,
    variances: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> str:
    """Return parameters of ros2_control's `diff_drive_controller`; the robot turns as commanded.

    The controller asks the sides for the rates (v -+ multiplier separation / 2 omega) / (left or
    right radius).

    Args:
        robot: the robot.
        multiplier: distance of the sides' centres of rotation over the track [1].
        left: way of the left wheels over their turn and radius [1].
        right: the same of the right wheels [1].
        errors: standard errors of these numbers, by the names of the file.
        drive: the driver, whose limits the controller gets; the robot's if not given.
        variances: of the odometry in x, y, z, roll, pitch and yaw, by the names of the file.
    """
    drive = drive or robot.drive
    joints = robot.wheel_joints
    values: dict[str, object] = {
        "left_wheel_names": json.dumps(joints[0::2]),
        "right_wheel_names": json.dumps(joints[1::2]),
        "wheel_separation": robot.track,
        "wheel_separation_multiplier": multiplier,
        "wheel_radius": robot.wheel_radius,
        "left_wheel_radius_multiplier": left,
        "right_wheel_radius_multiplier": right,
    }
    for axis, *limits in (
        ("linear.x", drive.v_max, drive.acceleration_v),
        ("angular.z", drive.w_max, drive.acceleration_w),
    ):
        for what, most in zip(("velocity", "acceleration"), limits, strict=True):
            if math.isfinite(most):
                values[f"{axis}.has_{what}_limits"] = "true"
                values[f"{axis}.max_{what}"] = most
                values[f"{axis}.min_{what}"] = -most
    values["cmd_vel_timeout"] = _MISSED * max(drive.hold, _COMMANDED_S)
    for name, diagonal in variances.items():
        values[name] = f"[{', '.join(f'{variance:.3e}' for variance in diagonal)}]"
    text = _DIFF_DRIVE
    for name, value in values.items():
        # 1.0, for ROS takes 1 for no float
        words = _plain_number(value) if isinstance(value, float) else value
        text += f"    {name}: {words}"
        text += f"  # standard error {errors[name]:.2g}\n" if name in errors else "\n"
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
    origins = {}
    for name, value in asdict(drive).items():
        origins[name] = "of the profile"
        if value == getattr(robot.drive, name):
            origins[name] = robot.source(f"drive.{name}")[0]
        if name in errors:
            origins[name] = f"standard error {errors[name]:.2g}"
    late = 0.5 * drive.command_ramp + drive.wheel_lag
    numbers = {name: _plain_number(value) for name, value in asdict(drive.later(late)).items()}
    (x, y, _), (ahead, left, _) = robot_outline(robot).round(4).tolist()
    corners = [[ahead, left], [ahead, y], [x, y], [x, left]]
    text = ""
    for row in _NAV2.splitlines():
        names = [name for name in numbers if name in row]
        if math.isfinite(sum(numbers[name] for name in names)):
            beside = "; ".join(f"{name}: {origins[name]}" for name in names)
            text += f"{row.format(**numbers)} {beside}".rstrip() + "\n"
    return text.replace("SOURCE", source).replace("FOOTPRINT", str(corners))


def _plain_number(value: float) -> float:
    """Return a number with the digits that a file of parameters has."""
    return float(f"{value:.7g}")


def _numbers_text(numbers: Iterable[float]) -> str:
    """Return the text of numbers, with all their digits."""
    return " ".join(repr(float(number)) for number in numbers)
