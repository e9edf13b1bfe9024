"""A robot's description -> what other programs read: a URDF, an SDF model, a calibrated MJCF, numbers of ros2_control.

URDF and SDF have plain shapes, four wheels and the IMU's frame. Products of inertia are 0, as in a robot's file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from xml.sax.saxutils import quoteattr  # nosec B406 # it writes, and reads nothing

from ssmr.robot.vehicle import Drive
from validation.simulator.calibration import Calibration
from validation.simulator.description import SIDES, WHEELS, Robot
from validation.simulator.model import adjust, on_ground, pair_with_ground
from validation.simulator.motors import add_windings

_ENDLESS = 1e16
"""Limit of a joint that turns without end, as SDFormat has it [rad]."""
_LYING = (0.5 * math.pi, 0.0, 0.0)
"""Roll, pitch and yaw of a cylinder whose axis is that of a wheel [rad]."""


def urdf_text(robot: Robot, joints: Mapping[str, str], base: str = "base_link", imu: str = "imu_link") -> str:
    """Return a robot's URDF, in SI units.

    The hull and its inertia stand in a link `chassis_link`, fixed to the base, because programs that read URDFs refuse
    inertia in the first link.

    Args:
        robot: the robot.
        joints: names of the wheels' joints, by wheel; a link has its joint's name with `_link` in the place of `_joint`.
        base: name of the base's link.
        imu: name of the IMU's link.
    """
    g, m = robot.geometry, robot.masses
    across, spin = m.wheel_inertia

    def link(name: str, mass: float, com: Iterable[float], moments: Iterable[float], shape: str) -> str:
        ixx, iyy, izz = map(repr, moments)
        return f"""
  <link name={quoteattr(name)}>
    <inertial>
      <origin xyz="{_row(com)}"/>
      <mass value="{mass!r}"/>
      <inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/>
    </inertial>
    <visual>{shape}</visual>
    <collision>{shape}</collision>
  </link>"""

    def joint(name: str, kind: str, child: str, at: Iterable[float], axis: str = "") -> str:
        return f"""
  <joint name={quoteattr(name)} type="{kind}">
    <parent link={quoteattr(base)}/>
    <child link={quoteattr(child)}/>
    <origin xyz="{_row(at)}"/>{axis}
  </joint>"""

    hull = f'<origin xyz="{_row(g.body_centre)}"/><geometry><box size="{_row(g.body_size)}"/></geometry>'
    tyre = f'<cylinder radius="{g.wheel_radius!r}" length="{g.wheel_width!r}"/>'
    tyre = f'<origin xyz="0 0 0" rpy="{_row(_LYING)}"/><geometry>{tyre}</geometry>'
    parts = [f"\n  <link name={quoteattr(base)}/>", link("chassis_link", robot.base_mass, m.com, m.inertia, hull)]
    parts += [joint("chassis_joint", "fixed", "chassis_link", (0.0, 0.0, 0.0))]
    parts += [f"\n  <link name={quoteattr(imu)}/>", joint("imu_joint", "fixed", imu, g.imu)]
    for wheel, place in wheel_places(robot).items():
        name = f"{joints[wheel].removesuffix('_joint')}_link"
        parts.append(link(name, m.wheel, (0.0, 0.0, 0.0), (across, spin, across), tyre))
        parts.append(joint(joints[wheel], "continuous", name, place, '\n    <axis xyz="0 1 0"/>'))
    return f'<robot name="{robot.name}">{"".join(parts)}\n</robot>'


def sdf_text(robot: Robot) -> str:
    """Return a robot's SDF model, in SI units, which stands with its tyres on the plane z = 0.

    Tyres are cylinders with the robot's friction in both directions and without `fdir1`. A joint's effort is limited to half
    of what a side's motors give. SDF has no word for belts, rotors and speed loops: those are left out.
    """
    g, m, mu = robot.geometry, robot.masses, robot.simulation.friction
    across, spin = m.wheel_inertia
    torque = robot.drive.torque_limit
    effort = f"<effort>{0.5 * torque!r}</effort>" if math.isfinite(torque) else ""

    def link(
        name: str, pose: str, mass: float, com: Iterable[float], moments: Iterable[float], shape: str, surface: str
    ) -> str:
        ixx, iyy, izz = map(repr, moments)
        return f"""
    <link name="{name}">{pose}
      <inertial>
        <pose>{_row(com)} 0 0 0</pose>
        <mass>{mass!r}</mass>
        <inertia><ixx>{ixx}</ixx><iyy>{iyy}</iyy><izz>{izz}</izz></inertia>
      </inertial>
      <visual name="{name}_visual">{shape}</visual>
      <collision name="{name}_collision">{shape}{surface}</collision>
    </link>"""

    hull = f"<pose>{_row(g.body_centre)} 0 0 0</pose><geometry><box><size>{_row(g.body_size)}</size></box></geometry>"
    tyre = f"<cylinder><radius>{g.wheel_radius!r}</radius><length>{g.wheel_width!r}</length></cylinder>"
    tyre = f"<pose>0 0 0 {_row(_LYING)}</pose><geometry>{tyre}</geometry>"
    grip = f"<surface><friction><ode><mu>{mu!r}</mu><mu2>{mu!r}</mu2></ode></friction></surface>"
    wheels = ""
    for wheel, place in wheel_places(robot).items():
        pose, name = f'<pose relative_to="base_link">{_row(place)} 0 0 0</pose>', f"{wheel}_wheel_link"
        wheels += link(name, pose, m.wheel, (0.0, 0.0, 0.0), (across, spin, across), tyre, grip)
        wheels += f"""
    <joint name="{wheel}_wheel_joint" type="revolute">
      <parent>base_link</parent>
      <child>{wheel}_wheel_link</child>
      <axis>
        <xyz>0 1 0</xyz>
        <limit><lower>{-_ENDLESS!r}</lower><upper>{_ENDLESS!r}</upper>{effort}</limit>
      </axis>
    </joint>"""
    return f"""<sdf version="1.7">
  <model name="{robot.name}">
    <pose>0 0 {g.base_height!r} 0 0 0</pose>{link("base_link", "", robot.base_mass, m.com, m.inertia, hull, "")}
    <frame name="imu_link" attached_to="base_link"><pose>{_row(g.imu)} 0 0 0</pose></frame>{wheels}
  </model>
</sdf>"""


def mjcf_text(calibration: Calibration, drive: Drive) -> str:
    """Return a calibrated robot on level ground as an MJCF that needs nothing but MuJoCo.

    It has the looks, motors and sensors of the simulated robot, and drives its path to a tenth of a millimetre: numbers have
    six digits. But MuJoCo's own actuators wind their integral part up where a motor stays at its limit. Delay, ramps and
    limits of commands act before the wheels' rates, and are not in it.

    Args:
        calibration: the robot's numbers.
        drive: its motors.

    Raises:
        ValueError: numbers that do not go together.
    """
    spec = on_ground(calibration.robot, calibration.wheel_shape)
    if drive.integral_gain > 0.0:
        add_windings(spec, calibration.robot, drive)
    if calibration.friction_ratio != 1.0:
        pair_with_ground(spec)
    model = spec.compile()
    adjust(model, calibration, drive)
    spec.copy_back(model)  # all numbers, but not whether a limit counts
    for actuator in spec.actuators:
        actuator.forcelimited = drive.integral_gain == 0.0 and math.isfinite(drive.torque_limit)
    spec.comment = "Inputs of actuators are wheel rates [rad/s]."
    return str(spec.to_xml())


def diff_drive_yaml(
    robot: Robot, multiplier: float, left: float = 1.0, right: float = 1.0, joints: Mapping[str, str] | None = None
) -> str:
    """Return the parameters of ros2_control's `diff_drive_controller`, with which a robot turns as it is told.

    The controller asks the sides for the rates (v -+ multiplier separation / 2 omega) / (left or right radius).

    Args:
        robot: the robot.
        multiplier: distance of the sides' centres of rotation over the track [1].
        left: way of the left wheels over their turn and radius [1].
        right: the same of the right wheels [1].
        joints: names of the wheels' joints, by wheel; those of `urdf_text` for the shipped robots if not given.
    """
    g, drive = robot.geometry, robot.drive
    named = joints or {wheel: f"{wheel}_wheel_joint" for wheel in WHEELS}
    lines = [f"{s}_wheel_names: [{', '.join(json.dumps(named[w]) for w in WHEELS if w.endswith(s))}]" for s in SIDES]
    numbers = {"wheel_separation": g.track, "wheel_separation_multiplier": multiplier, "wheel_radius": g.wheel_radius}
    numbers |= {"left_wheel_radius_multiplier": left, "right_wheel_radius_multiplier": right}
    for axis, most in (("linear.x", drive.v_max), ("angular.z", drive.w_max)):
        if math.isfinite(most):
            numbers |= {f"{axis}.max_velocity": most, f"{axis}.min_velocity": -most}
    lines += [f"{name}: {float(f'{number:.7g}')!r}" for name, number in numbers.items()]  # 1.0: ROS takes 1 for no float
    return "diff_drive_controller:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in lines)


def wheel_places(robot: Robot) -> dict[str, tuple[float, float, float]]:
    """Return the middles of the wheels in the base frame [m], by wheel."""
    g = robot.geometry
    x, y = 0.5 * g.wheelbase, 0.5 * g.track
    return {w: (x if "front" in w else -x, y if "left" in w else -y, g.axle_height) for w in WHEELS}


def _row(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
