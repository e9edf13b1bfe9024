"""What the columns of foreign tables mean, by their names: those of ROS, PlotJuggler and evo."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from validation.files.circular import trust_in
from validation.files.log import COMMAND_COLUMNS, RECORDED, column_of
from validation.files.topics import side_of

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
_WHEEL = re.compile(r"veloc|vel$|rate|speed|wheel|rad_s|enc|motor|^[frmb][lr]$|^[lr][frmb]$")
"""Parts of the names of columns of wheels."""
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
    plain = {name: _plain(name) for name in header}
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
    """Return the rates of wheels by the sides that their names say; of both sides, or none."""
    found = {}
    for ours, side in zip(COMMAND_COLUMNS["wheels"], ("left", "right"), strict=True):
        members = [n for n in header if side_of(_parted(n)) == side and _WHEEL.search(plain[n])]
        rates = [n for n in members if not re.search(r"pos|tick|angle|effort|current", plain[n])]
        if rates and ours not in header:
            found[ours] = ("+".join(rates), "")
    return found if len(found) == 2 else {}


def _plain(name: str) -> str:
    return name.strip("/").replace("/", ".").lower()


def _parted(name: str) -> str:
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
