"""The columns of a log: their units and groups, and what names of sources and joints say."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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
        return k, f"{values[k]:g}, wanted a finite number [{self.unit}]"


_RPM = "rpm, ticks or degrees per second"
_DEGREES = "degrees per second"
_CURRENT = Column("A", "channels", 1e100, 1000.0, "mA")
_VOLTAGE = Column("V", "channels", 1e100, 200.0, "mV")
_TORQUE = Column("N m", "channels", 1e100, 1e4, "N mm")
COLUMNS: Mapping[str, Column] = MappingProxyType(
    {
        **dict.fromkeys(("x", "y"), Column("m", "pose", 1e8)),
        "yaw": Column("rad", "pose", 1e7),
        **dict.fromkeys(("enc_left", "enc_right"), Column("rad/s", "wheels", 1e8, 100.0, _RPM)),
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

_PREFIXES = {
    "": 1.0,
    "n|nano": 1e-9,
    "u|µ|μ|micro": 1e-6,
    "m|milli": 1e-3,
    "c|centi": 1e-2,
    "k|kilo": 1e3,
}
_ROOTS: Mapping[str, tuple[str, float]] = {
    "s|secs?|seconds?": ("s", 1.0),
    "min|minutes?": ("s", 60.0),
    "h|hrs?|hours?": ("s", 3600.0),
    "rads?|radians?": ("rad", 1.0),
    "degs?|degrees?|°|º": ("rad", math.pi / 180.0),
    "turns?|revs?|revolutions?|rotations?": ("rad", 2.0 * math.pi),
    "ticks?|counts?|pulses?": ("ticks", 1.0),
    "m|met(er|re)s?": ("m", 1.0),
    "ft|foot|feet": ("m", 0.3048),
    "in|inch|inches": ("m", 0.0254),
    "mi|miles?": ("m", 1609.344),
    "g": ("m/s²", 9.80665),
    "a|amps?|amperes?": ("A", 1.0),
    "v|volts?": ("V", 1.0),
    "newtonmetre": ("N m", 1.0),
}
"""Words and signs of units, in lower case: the unit in `COLUMNS` that they lead to, and the factor
to it. Ticks are those of an encoder."""
_SHORT = {"rpm": "rev/min", "rps": "rev/s", "dps": "deg/s", "mps": "m/s", "kmh": "km/h"}
_SHORT |= {"mph": "mile/h", "kph": "km/h", "m/s2": "m/s/s", "": ""}


@cache
def parse_unit(text: str) -> tuple[str, float] | None:
    """Return what a unit in words or signs leads to, and the factor to that; None for no unit.

    That is a unit of `COLUMNS` as `rad/s`, or `ticks` or `ticks/s`; nothing for a number.
    """
    plain = re.sub(r"^(m?)N[ ·*.]?m$", r"\1newtonmetre", text.strip(" []()")).lower()
    plain = re.sub(r"(?<![a-z])per(?![a-z])", "/", plain)
    plain = re.sub(r"[ .·*_]*(?<![a-z])(s|sec|min|h)(\^|\*\*)?(-1|⁻¹)$", r"/\1", plain)
    plain = re.sub(r"[ .·*_]*(?<![a-z])s(\^|\*\*)?(-2|⁻²)$", "/s/s", plain)
    plain = re.sub(r"[ _^]*/[ _^]*|[ _]+", "/", plain).replace("²", "2").replace("^", "")
    root, *times = _SHORT.get(plain, plain).split("/")
    if root in ("", "-", "1") and not times:
        return "", 1.0
    found = _root_of(root)
    for time in times:
        divisor = _root_of(time)
        if found is None or divisor is None or divisor[0] != "s":
            return None
        found = f"{found[0]}/s", found[1] / divisor[1]
    return None if found is None else (found[0].replace("/s/s", "/s²"), found[1])


def _root_of(word: str) -> tuple[str, float] | None:
    """Return what a unit without a division leads to, and the factor; None for no unit."""
    for prefix, size in _PREFIXES.items():
        for root, (base, factor) in _ROOTS.items():
            if re.fullmatch(f"({prefix})({root})", word):
                return base, size * factor
    return None


_LISTED = (
    *("ms", "us", "ns", "min", "deg", "turns", "deg/s", "rpm", "rad/min", "mm", "cm", "km", "ft"),
    *("in", "km/h", "mm/s", "cm/s", "m/min", "ft/s", "mph"),
)
UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {unit: found for unit in _LISTED if (found := parse_unit(unit))}
)
"""Units that loggers write: the unit in `COLUMNS` of the same quantity, and the factor to it."""


def column_of(name: str) -> Column:
    """Return the properties of a column."""
    return COLUMNS.get(name, _ANY_COLUMN)


def is_column_name(name: str) -> bool:
    """Return whether a file's header can hold this name and give it back."""
    return bool(name) and name.isprintable() and name == name.strip()


def unit_factor(
    name: str, unit: str, radius: float | None = None, ticks: float | None = None
) -> tuple[float, str]:
    """Return the factor from a unit to that of a column, and its unit; a ValueError lists units.

    Wheels may also tell positions, which lead to `rad`.

    Args:
        name: the column.
        unit: its unit in words or signs; that of the column if empty.
        radius: radius of the wheels [m], for those whose rim is measured; None where nobody knows.
        ticks: number of an encoder's ticks in a turn of a wheel; None where nobody knows.
    """
    ours = "s" if name == "t" else column_of(name).unit
    base, factor = parse_unit(unit) or (unit, 1.0)
    if base in ("", ours):
        return factor, ours
    if name in COMMAND_COLUMNS["wheels"]:
        way = base.removesuffix("/s")
        if way == "m" and radius is None:
            raise ValueError(
                f"{name} in {unit} needs the radius of the wheels; name the robot by --robot"
            )
        if way == "ticks" and not ticks:
            raise ValueError("ticks need their number in a turn of the wheel: --ticks-per-turn N")
        sizes = {"rad": 1.0, "m": 1.0 / (radius or 1.0), "ticks": 2.0 * math.pi / (ticks or 1.0)}
        if way in sizes:
            return factor * sizes[way], base.replace(way, "rad", 1)
    units = [ours, *(u for u, (of, _) in UNITS.items() if of == ours)]
    raise ValueError(f"{name} cannot be in '{unit}'; its units are {', '.join(units)}")


_EQUATOR = 6378137.0
"""Semi-major axis of the WGS 84 ellipsoid [m]."""
_ECCENTRICITY = 0.0818191908426215
"""First eccentricity of the WGS 84 ellipsoid [1]."""


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


def count_on(values: FloatArray, whole: float) -> tuple[FloatArray, float]:
    """Return (M,) positions without the jumps of a counter that wraps, and its range; 0 for none.

    The range is what makes the steps at the jumps like those beside them; of all that do so within
    the roughness of the steps, the roundest number of `whole` is taken.
    """
    steps = np.diff(values)
    span = float(np.ptp(values))
    jump = np.abs(steps) > 0.5 * span
    if not np.any(jump) or np.all(jump):
        return values, 0.0
    at = np.arange(len(steps))
    smooth = np.interp(at, at[~jump], steps[~jump])
    size = float(np.median(np.abs(steps - smooth)[jump])) / whole
    error = float(np.percentile(np.abs(np.diff(smooth)), 95.0)) / whole + 1e-9 * size
    rounded = [2.0 ** round(math.log2(size))]
    rounded += [round(size, digits) for digits in range(-round(math.log10(size)), 9)]
    able = (each for each in rounded if abs(each - size) <= error and each * whole > span)
    size = next(able, 0.0) * whole
    if not size:
        return values, 0.0
    on = np.unwrap(values, period=size)
    rough, after = (float(np.abs(np.diff(each, 2)).sum()) for each in (values, on))
    return (on, size) if after < 0.5 * rough else (values, 0.0)


def to_local(latitude: ArrayLike, longitude: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return (M,) metres east and north of the first known of (M,) positions [deg].

    The plane touches the ellipsoid there. The result is good to some centimetres within a
    kilometre: terms of second order in the distance over the radius are left out. Beyond the poles
    there are no metres, but NaN.
    """
    degrees = np.asarray(latitude, dtype=np.float64)
    lat = np.radians(np.where(np.abs(degrees) <= 90.0, degrees, math.nan))
    lon = np.asarray(longitude, dtype=np.float64)
    first = np.argmax(np.isfinite(lat + lon))
    flat = 1.0 - _ECCENTRICITY**2 * math.sin(lat[first]) ** 2
    # radii of curvature
    meridian = _EQUATOR * (1.0 - _ECCENTRICITY**2) / flat**1.5
    transverse = _EQUATOR / math.sqrt(flat)
    # differences of longitude, also across the date line
    turned = np.radians(np.mod(lon - lon[first] + 180.0, 360.0) - 180.0)
    return transverse * math.cos(lat[first]) * turned, meridian * (lat - lat[first])


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
