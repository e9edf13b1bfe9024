"""What the columns of a log mean, by their names: ours, and those of ROS, PlotJuggler and evo."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ssmr.types import MOTOR_COLUMNS, TORQUES, CommandKind, FloatArray


# ------------------------------------------------------------------------------------------ ours
class Column(NamedTuple):
    """Properties of a column that is known by its name."""

    unit: str
    group: str
    """Group of the columns that are sampled together with it."""
    most: float
    """Size from which its numbers are damaged, or in another unit."""
    usual: float = math.inf
    """Greatest size that it has on a ground robot."""
    others: str = ""
    """Units that it may be in where it is larger."""
    message: str = ""
    """Type of the messages of bags that have it, for a channel whose topic has the group's name as
    its role; empty for columns that are made otherwise."""
    field: str = ""
    """Its field in such a message, such as `voltage`."""

    def fault(self, values: FloatArray) -> tuple[int, str] | None:
        """Return the index of the first impossible one of (M,) values, and its fault, if any."""
        beyond = np.flatnonzero(~(np.abs(values) <= self.most))
        if not len(beyond):
            return None
        k = int(beyond[0])
        number = f"{values[k]:g} {self.unit}".strip()
        if math.isfinite(values[k]):
            return k, f"{number}, more than {self.most:g}"
        return k, f"{number}, wanted a finite number [{self.unit}]"


_RPM = "rpm, ticks or degrees per second"
_DEGREES = "degrees per second"
_CURRENT = Column("A", "channels", 1e100, 1000.0, "mA")
_VOLTAGE = Column("V", "channels", 1e100, 200.0, "mV")
_TORQUE = Column("N m", "channels", 1e100, 1e4, "N mm")
COLUMNS: Mapping[str, Column] = MappingProxyType(
    {
        **dict.fromkeys(("x", "y"), Column("m", "pose", 1e8)),
        "yaw": Column("rad", "pose", 1e7),
        **dict.fromkeys(("enc_left", "enc_right"), Column("rad/s", "wheels", 1e4, 100.0, _RPM)),
        "odom_v": Column("m/s", "odom", 100.0, 10.0, "mm/s or km/h"),
        "odom_w": Column("rad/s", "odom", 1000.0, 15.0, _DEGREES),
        **dict.fromkeys(("odom_x", "odom_y"), Column("m", "odom", 1e8)),
        "odom_yaw": Column("rad", "odom", 1e7),
        "gyro_z": Column("rad/s", "imu", 1000.0, 15.0, _DEGREES),
        **dict.fromkeys(("gps_east", "gps_north"), Column("m", "gps", 1e8)),
        "cmd_v": Column("m/s", "cmd", 100.0, 10.0, "mm/s or km/h"),
        "cmd_w": Column("rad/s", "cmd", 1000.0, 15.0, _DEGREES),
        **dict.fromkeys(("acc_x", "acc_y", "acc_z"), Column("m/s²", "channels", 1e5, 160.0, "mg")),
        **dict.fromkeys(("current_left", "current_right"), _CURRENT),
        **dict.fromkeys(("voltage_left", "voltage_right"), _VOLTAGE),
        "battery": Column(
            "V", "battery", 1e5, message="sensor_msgs/msg/BatteryState", field="voltage"
        ),
        **dict.fromkeys(MOTOR_COLUMNS[TORQUES], _TORQUE),
    }
)
"""Columns whose meaning is known. Their first group that a log has sets its rate, unless a rate is
asked for."""
BESIDE_MOTION: Mapping[str, Mapping[str, Column]] = MappingProxyType(
    {
        group: {
            name: column
            for name, column in COLUMNS.items()
            if column.message and column.group == group
        }
        for group in dict.fromkeys(each.group for each in COLUMNS.values() if each.message)
    }
)
"""Columns of each group that comes from messages of one type. Such a group tells no motion, and so
neither its beginning nor its gaps cut the log."""
_ANY_COLUMN = Column("", "channels", 1e100)
"""Any other column."""
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        group: tuple(name for name, column in COLUMNS.items() if column.group == group)
        for group in dict.fromkeys(column.group for column in COLUMNS.values())
    }
)
"""Names of the groups, and the known columns of each."""
RECORDED = ("cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z", "x", "y", "yaw")
"""Columns of a robot's motion: a log on one clock has at least one of them."""
NO_COLUMN = f"there is none of the columns {', '.join(RECORDED)}"
POSE_COLUMNS = ("x", "y", "yaw")
COMMAND_COLUMNS: Mapping[CommandKind, tuple[str, str]] = MappingProxyType(
    {"twist": ("cmd_v", "cmd_w"), "wheels": ("enc_left", "enc_right")}
)
"""The two columns that drive a plant, by kind of command."""

UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "ms": ("s", 1e-3),
        "us": ("s", 1e-6),
        "ns": ("s", 1e-9),
        "min": ("s", 60.0),
        "deg": ("rad", math.pi / 180.0),
        "turns": ("rad", 2.0 * math.pi),
        "deg/s": ("rad/s", math.pi / 180.0),
        "rpm": ("rad/s", math.pi / 30.0),
        "rad/min": ("rad/s", 1.0 / 60.0),
        "mm": ("m", 1e-3),
        "cm": ("m", 1e-2),
        "km": ("m", 1e3),
        "ft": ("m", 0.3048),
        "in": ("m", 0.0254),
        "km/h": ("m/s", 1.0 / 3.6),
        "mm/s": ("m/s", 1e-3),
        "cm/s": ("m/s", 1e-2),
        "m/min": ("m/s", 1.0 / 60.0),
        "ft/s": ("m/s", 0.3048),
        "mph": ("m/s", 0.44704),
    }
)
"""Units that loggers write: the unit in `COLUMNS` of the same quantity, and the factor to it."""

POSITIONS: Mapping[str, float] = MappingProxyType(
    {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi}
)
"""Units of the positions of wheels, and the angle of each [rad]; ticks are another."""


def column_of(name: str) -> Column:
    """Return the properties of a column."""
    return COLUMNS.get(name, _ANY_COLUMN)


def is_column_name(name: str) -> bool:
    """Return whether a file's header can hold this name and give it back."""
    return bool(name) and name.isprintable() and name == name.strip()


def unit_factor(name: str, unit: str, radius: float | None) -> float:
    """Return the factor from a unit to that of a column; a ValueError lists the units.

    Wheels whose speed is that of their rim have a `radius` [m], None where nobody knows it.
    """
    column_unit = "s" if name == "t" else column_of(name).unit
    base, factor = UNITS.get(unit, (unit, 1.0))
    if base == column_unit or not unit:
        return factor
    if name in COMMAND_COLUMNS["wheels"] and base == "m/s":
        if radius is None:
            raise ValueError(
                f"{name} in {unit} needs the radius of the wheels; name the robot by --robot"
            )
        return factor / radius
    units = [column_unit, *(u for u, (of, _) in UNITS.items() if of == column_unit)]
    raise ValueError(f"{name} cannot be in '{unit}'; its units are {', '.join(units)}")


def unwrapped(angles: FloatArray) -> FloatArray:
    """Return (M,) angles without jumps by a turn, of 2 pi, or of 360 if they are in degrees."""
    # degrees are a fault that is named later
    steps = np.abs(np.diff(angles))
    if np.any((steps > 300.0) & (steps < 361.0)):
        return np.unwrap(angles, period=360.0)
    far = steps[steps > math.pi]
    if np.ptp(angles) > 4.0 * math.pi and np.any((far < 5.0) | (far > 7.0)):
        return angles
    return np.unwrap(angles)


# ------------------------------------------------------------------------------------------ sources
_KINDS_OF_SOURCES = (
    r"mocap|motion_capture|vicon|vrpn|optitrack|qualisys|natnet|leica|ground_?truth|p3d",
    r"amcl|slam|_lio|lio_|loam|icp|lidar|laser|scan|cartographer|hector|ndt|locali[sz]|rtk|rtab"
    r"|visual|camera|zed|vio|/tf:(map|world)",
    r"filtered|ekf|ukf|fused",
    r"controller|wheel|diff_drive|odom",
)
"""Parts of the names of poses' sources, the most independent of wheels first."""


def trust_in(source: str) -> int:
    """Return how little a source of poses is trusted by its name: 0 for the truth, 4 for wheels.

    A source whose name says nothing has 2.
    """
    ranks = (0, 1, 3, 4)
    if source.startswith("/"):
        for rank, parts in zip(ranks, _KINDS_OF_SOURCES, strict=True):
            if re.search(parts, source.lower()):
                return rank
    return 2


_NO_WHEELS = re.compile(
    r"cast|steer|swivel|arm|gripper|finger|shoulder|elbow|wrist|head|pan|tilt|lift|camera|torso"
)
"""Parts of the names of joints that drive nothing."""
WHEEL_SIDES = {
    "left": re.compile(r"left|(^|[^a-z])(l|[frbm]l|l[frbm])([^a-z]|$)"),
    "right": re.compile(r"right|(^|[^a-z])(r|[fbm]r|rr|r[fbm])([^a-z]|$)"),
}
"""Sides that the names of joints say: `front_left`, `wheel_FL_joint`, `rr`."""


def side_of(name: str) -> str:
    """Return the side that the name of a joint says; nothing for none, or for no wheel."""
    plain = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
    if _NO_WHEELS.search(plain):
        return ""
    sides = [side for side, pattern in WHEEL_SIDES.items() if pattern.search(plain)]
    return sides[0] if len(sides) == 1 else ""


# ------------------------------------------------------------------------------------------ foreign
Columns = Mapping[str, tuple[str, str]]
"""By our name, the name of a column there, or names between plus signs, and the unit."""
_NAMES: Mapping[str, str] = {
    "t": r"(^|\.)header\.stamp$|^(%|__|#)?(t|time|timestamp|stamp|rosbagtimestamp)$",
    "x": r"(position|translation)\.x$|^p_rs_r_x$|^(pos|p|pose)_?x$",
    "y": r"(position|translation)\.y$|^p_rs_r_y$|^(pos|p|pose)_?y$",
    "yaw": r"(^|[._])(yaw|heading|theta|psi)$",
    "gyro_z": r"angular_velocity\.z$|^gyro\.?z$",
    "cmd_v": r"cmd[^.]*\.(twist\.)?linear\.x$|^(field\.)?(twist\.)?linear\.x$",
    "cmd_w": r"cmd[^.]*\.(twist\.)?angular\.z$|^(field\.)?(twist\.)?angular\.z$",
    "odom_v": r"twist\.twist\.linear\.x$",
    "odom_w": r"twist\.twist\.angular\.z$",
}
"""By our name, what the names of such columns match, in lower case and with points for slashes."""
_QUATERNION = r"(orientation|rotation|quat|quaternion)[._]{0}$|^q_rs_{0}(_?\[\])?$|^q[._]?{0}$"
_WHEEL = re.compile(
    r"veloc|vel$|rate|speed|wheel|rad_s|enc|motor|effort|torque|^[frmb][lr]$|^[lr][frmb]$"
)
"""Parts of the names of columns of wheels."""
_NO_RATE = re.compile(r"pos|tick|angle|effort|torque|current")
_NO_TORQUE = re.compile(r"^(?!.*(effort|torque))")
"""What the names of other columns of wheels match."""
_UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
_POSE = ("position.x", "position.y", "position.z")
_TURN = tuple(f"orientation.{axis}" for axis in "xyzw")
_STAMP = ("sec", "nanosec", "frame_id")
_RATES = tuple(f"{kind}.{axis}" for kind in ("linear", "angular") for axis in "xyz")
_BLANKS = ("",) * 36
_POSED = (*_STAMP, *_POSE, *_TURN)
_INERTIAL = ("", *(f"angular_velocity.{axis}" for axis in "xyz"))
ECHOED: Mapping[int, Sequence[str]] = {
    9: (*_STAMP, *_RATES),
    10: _POSED,
    40: (*_STAMP, *_TURN, *_BLANKS[:8], *_INERTIAL, *_BLANKS[:9], *("",) * 12),
    46: (*_POSED, *_BLANKS),
    89: (
        *(*_STAMP, "child", *_POSE, *_TURN, *_BLANKS),
        *(*(f"twist.twist.{name}" for name in _RATES), *_BLANKS),
    ),
}
"""Names of the columns that `ros2 topic echo --csv` writes without a header, by their number: of
TwistStamped, PoseStamped, Imu, PoseWithCovarianceStamped and Odometry."""


def without_unit(name: str) -> tuple[str, str]:
    """Return a name as a header has it, such as `yaw [deg]`, without its unit, and the unit."""
    found = _UNIT.search(name)
    plain = _UNIT.sub("", name).strip().removeprefix("#").strip()
    return plain, found[1].strip() if found else ""


def taken_by_name(header: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return the columns of a table that their names explain; those with our names are not listed.

    Of several the one from the most independent source is taken.
    """
    plain = {name: _plain_name(name) for name in header}
    # odom_yaw, say, is a column of ours, and no yaw of a pose
    foreign = [name for name in header if column_of(name).group == "channels"]
    found = {}
    for ours, pattern in _NAMES.items():
        able = [name for name in foreign if re.search(pattern, plain[name])]
        if ours not in header and able:
            found[ours] = (min(able, key=trust_in), "")
    found |= _clock_of_parts(header, plain)
    if "yaw" not in (*header, *found):
        axes = list(_quaternion(header, plain, found.get("x", ("", ""))[0]))
        if len(axes) == 4:
            found["yaw"] = ("+".join(axes), "")
    return found | _wheels(header, plain)


def _clock_of_parts(header: Sequence[str], plain: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return a time in whole seconds and nanoseconds, where there is one."""
    if "t" not in header:
        seconds = [name for name in header if re.search(r"(^|\.)secs?$", plain[name])]
        parts = [name for name in header if re.search(r"(^|\.)n(ano)?secs?$", plain[name])]
        if seconds and parts:
            return {"t": (f"{seconds[0]}+{parts[0]}", "")}
    return {}


def _wheels(header: Sequence[str], plain: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return rates and torques of wheels by the sides that their names say; of both, or none."""
    found = dict[str, tuple[str, str]]()
    pairs = {COMMAND_COLUMNS["wheels"]: _NO_RATE, MOTOR_COLUMNS[TORQUES]: _NO_TORQUE}
    for names, others in pairs.items():
        own = {}
        for ours, side in zip(names, WHEEL_SIDES, strict=True):
            members = [
                n for n in header if side_of(_split_name(n)) == side and _WHEEL.search(plain[n])
            ]
            kept = [n for n in members if not others.search(plain[n])]
            if kept and ours not in header:
                own[ours] = ("+".join(kept), "")
        if len(own) == 2:
            found |= own
    return found


def _plain_name(name: str) -> str:
    return name.strip("/").replace("/", ".").lower()


def _split_name(name: str) -> str:
    return re.sub(r"[./]", "_", name)


def _quaternion(header: Sequence[str], plain: Mapping[str, str], x: str) -> Iterator[str]:
    """Yield the columns of a quaternion, x first, of the topic that the column `x` comes from."""
    topic = x.split("/")[1] if x.startswith("/") else ""
    for axis in "xyzw":
        pattern = _QUATERNION.format(axis)
        able = [n for n in header if re.search(pattern, plain[n]) and topic in n]
        yield from able[:1]


def has_other_names(header: Sequence[str]) -> bool:
    """Return whether a table has no time and motion by our names."""
    return "t" not in header or not any(name in RECORDED for name in header)


def as_option(columns: Columns) -> str:
    """Return columns as `--columns` takes them."""
    parts = []
    for ours, (theirs, unit) in columns.items():
        parts.append(f"{ours}={theirs}:{unit}" if unit else f"{ours}={theirs}")
    return ",".join(parts)
