"""What the header of a foreign table means: units in its names, and columns by their words.

A name is a few words, however they are joined: `cmd_vel.linear.x`, `/imu/angular_velocity/z`,
`encoderLeft (m)`, `time_ms`. The last word for a kind of quantity counts, words for its source say
whose it is, and whatever else stands there is taken for the name of a topic.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from ssmr.types import MOTOR_COLUMNS, TORQUES
from validation.files.columns import (
    COLUMNS,
    COMMAND_COLUMNS,
    POSE_COLUMNS,
    WHEEL_SIDES,
    parse_unit,
    side_of,
    trust_in,
)

Columns = dict[str, tuple[str, str]]
"""By our name, the name of a column there, or names between plus signs, and the unit."""
_KINDS = {
    "time": "t ts time timestamp stamp sec secs seconds date datetime epoch",
    "position": "pos position pose translation location p",
    "turned": "orientation rotation quat quaternion q",
    "heading": "yaw heading theta psi",
    "speed": "linear lin speed v",
    "rate": "angular ang omega gyro gyroscope w",
    "change": "vel velocity rate dot",
}
"""Words for kinds of quantities; those for a change belong to the kind that stands before them."""
_SOURCES = {
    "cmd": "cmd cmds command commands commanded setpoint target goal ref reference desired",
    "odom": "odom odometry",
    "imu": "imu gyro gyroscope",
    "twist": "twist",
}
"""Words for sources."""
_OTHERS = frozenset(
    "b bias cov covariance std var sigma err error offset delta delay duration min max mag magnetic"
    " acc accel acceleration force torque effort roll pitch joint".split()
)
"""Words of columns that are none of ours, whatever else stands in their names."""
_MESSAGE = frozenset("field twist linear angular x z".split())
"""Words of the fields of a message that is a command."""
_AXES = ("x", "y", "z")


def _by_word(words_by_class: Mapping[str, str]) -> dict[str, str]:
    """Return the class of each word."""
    classes = dict[str, str]()
    for name, words in words_by_class.items():
        classes |= dict.fromkeys(words.split(), name)
    return classes


_KIND_OF = _by_word(_KINDS)
_SOURCE_OF = _by_word(_SOURCES)
_WORDS = re.compile(
    "|".join(sorted({*_KIND_OF, *_SOURCE_OF, *_OTHERS, *_AXES}, key=len, reverse=True))
)
_WHEEL = re.compile(
    r"veloc|vel$|rate|speed|omega|rpm|wheel|rad_s|enc|tick|motor|effort|torque"
    r"|^[frmb][lr]$|^[lr][frmb]$"
)
"""Parts of the names of columns of wheels."""
_RATE = re.compile(r"vel|rate|speed|omega")
"""Parts of the names of those that are surely rates."""
_NO_RATE = re.compile(r"pos|tick|angle|current|volt|power|pwm|duty|temp|err|acc")
"""Parts of the names of other columns of wheels whose unit does not show."""
_KINDS_OF_WHEELS = {
    **dict.fromkeys(("", "rad/s", "m/s", "ticks/s"), "rates"),
    **dict.fromkeys(("rad", "m", "ticks"), "positions"),
}
"""Kinds of the columns of wheels by their units."""
_WHEELS = COMMAND_COLUMNS["wheels"]
_BRACKET = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
_STAMP = "sec nanosec _ "
_POSE = "position.x position.y position.z "
_TURN = "orientation.x orientation.y orientation.z orientation.w "
_GYRO = "angular_velocity.x angular_velocity.y angular_velocity.z "
_TWIST = "{0}linear.x {0}linear.y {0}linear.z {0}angular.x {0}angular.y {0}angular.z "
_COVARIANCE = 36 * "_ "
_MESSAGES = (
    _STAMP + _TWIST.format(""),
    _STAMP + _POSE + _TURN,
    _STAMP + _TURN + 9 * "_ " + _GYRO + 21 * "_ ",
    _STAMP + _POSE + _TURN + _COVARIANCE,
    _STAMP + "_ " + _POSE + _TURN + _COVARIANCE + _TWIST.format("twist.twist.") + _COVARIANCE,
)
_ECHOED = {len(names): names for names in (message.split() for message in _MESSAGES)}
"""Names of the columns that `ros2 topic echo --csv` writes without a header, by their number: of
TwistStamped, PoseStamped, Imu, PoseWithCovarianceStamped and Odometry."""


def name_echoed(joints: Sequence[str], width: int) -> list[str]:
    """Return the names of so many columns without a header, nothing for those of no use to us.

    The list is empty for no known message. Several `joints` behind its stamp are a message of them.
    """
    if len(joints) < 2:
        return [name.strip("_") for name in _ECHOED.get(width, ())]
    each = (f"{joint}.{part}" for part in ("position", "velocity", "effort") for joint in joints)
    return ["sec", "nanosec", "", *("" for _ in joints), *each][:width]


def without_unit(name: str) -> tuple[str, str]:
    """Return a name as a header has it, such as `yaw [deg]`, without its unit, and the unit."""
    found = _BRACKET.search(name)
    plain = _BRACKET.sub("", name).strip().lstrip("#%").strip()
    return plain, found[1].strip() if found else ""


def split_words(name: str) -> list[str]:
    """Return the words of a name in lower case; those that are joined are taken apart if known."""
    spaced = re.sub(r"(?<=[a-z][a-z])(?=[A-Z])", "_", name).lower()
    words = []
    for word in re.findall(r"[^\W\d_]+|\d+|°", spaced):
        parts = _WORDS.findall(word)
        words += parts if "".join(parts) == word else [word]
    return words


def _meaning_of(words: Sequence[str]) -> str:
    """Return our name of a column, by the words of its name; nothing for none of ours."""
    joined = "_".join(words)
    if joined == "t" or joined in COLUMNS:
        return joined
    kinds = [_KIND_OF[word] for word in words if word in _KIND_OF]
    sources = [_SOURCE_OF[word] for word in words if word in _SOURCE_OF]
    if not kinds or not _OTHERS.isdisjoint(words) or _is_part_of_turn(words):
        return ""
    axis = next((word for word in reversed(words) if word in _AXES), "")
    *before, kind = kinds
    if kind == "change" and before:
        kind = before[-1]
    if kind == "heading" and {"change", "rate"} & {*before, kinds[-1]}:
        kind = "rate"
    if kind in ("speed", "rate", "change"):
        axes = {"speed": ("", "x"), "change": ("x",), "rate": ("", "z")}[kind]
        if side_of(joined) or axis not in axes:
            return ""
        return _motion_by(sources, words, "w" if kind == "rate" else "v")
    if "cmd" in sources:
        return ""
    if kind == "position" or words == ["t", axis]:
        return axis if axis in POSE_COLUMNS else ""
    return {"time": "t", "heading": "yaw"}.get(kind, "") if not axis else ""


def _motion_by(sources: Sequence[str], words: Sequence[str], letter: str) -> str:
    """Return our column of a speed `v` or a yaw rate `w` by its sources; nothing if none shows."""
    if "cmd" in sources:
        return f"cmd_{letter}"
    if "odom" in sources or sources.count("twist") == 2:
        return f"odom_{letter}"
    changes = any(_KIND_OF.get(word) == "change" for word in words)
    if letter == "w" and ("imu" in sources or changes):
        return "gyro_z"
    return f"cmd_{letter}" if _MESSAGE.issuperset(words) and len(words) > 1 else ""


def _is_part_of_turn(words: Sequence[str]) -> bool:
    """Return whether these are the words of an axis of a quaternion."""
    return words[-1] in (*_AXES, "w") and any(_KIND_OF.get(word) == "turned" for word in words)


def _with_unit(name: str) -> Iterator[tuple[list[str], str]]:
    """Yield the words of a name and the unit that its end, or a bracket, may be; none at last."""
    plain, unit = without_unit(name)
    words = split_words(plain)
    if not unit:
        for length in (3, 2, 1):
            text = "_".join(words[-length:])
            if length < len(words) and parse_unit(text):
                yield words[:-length], text
    yield words, unit


# ------------------------------------------------------------------------------------------ headers
def taken_by_name(header: Sequence[str]) -> Columns:
    """Return the columns of a table that their names explain; those with our names are not listed.

    Of several the one from the most independent source is taken, then the shortest name.
    """
    able: dict[str, list[tuple[str, str]]] = {}
    parts: dict[str, dict[str, str]] = {}
    foreign = [name for name in header if name != "t" and name not in COLUMNS]
    for name in foreign:
        meanings = ((_meaning_of(words), unit) for words, unit in _with_unit(name))
        ours, unit = next((each for each in meanings if each[0]), ("", ""))
        if ours not in ("", *header):
            able.setdefault(ours, []).append((name, unit))
        *stem, last = split_words(without_unit(name)[0]) or [""]
        parts.setdefault("_".join(stem), {})[last] = name
    found = {}
    for ours, columns in able.items():
        found[ours] = min(columns, key=lambda each: (trust_in(each[0]), len(split_words(each[0]))))
    joined = _joined_columns(parts, found.get("x", ("", ""))[0])
    if "t" in header:
        joined.pop("t", None)
    if "yaw" in (*header, *found):
        joined.pop("yaw", None)
    found |= joined
    return _name_wheels(foreign, {*header, *found}) | found


def _joined_columns(parts: Mapping[str, Mapping[str, str]], x: str) -> Columns:
    """Return a time in whole seconds and nanoseconds, and a yaw of the four of a quaternion.

    The columns are given by the beginning of their names, and the last word. Of several quaternions
    the one of the topic of the column `x` is taken.
    """
    found = Columns()
    whole = []
    for stem, ends in parts.items():
        seconds = [name for last, name in ends.items() if re.fullmatch("secs?", last)]
        rest = [name for last, name in ends.items() if re.fullmatch("n(ano)?secs?", last)]
        if seconds and rest:
            found.setdefault("t", (f"{seconds[0]}+{rest[0]}", ""))
        if {*ends} >= {*"xyzw"} and _is_part_of_turn([*stem.split("_"), "w"]):
            whole.append(ends)
    if whole:
        topic = x.split("/")[1] if x.startswith("/") else ""
        four = max(whole, key=lambda four: topic in four["x"])
        found["yaw"] = "+".join(four[axis] for axis in "xyzw"), ""
    return found


def _name_wheels(header: Sequence[str], there: set[str]) -> Columns:
    """Return rates and torques of wheels by the sides that their names say; of both, or none.

    Where no rates are, positions are taken if their unit shows.
    """
    members: dict[str, list[str]] = {}
    units = {}
    for name in header:
        words = split_words(without_unit(name)[0])
        joined = "_".join(words)
        unit = next(unit for _, unit in _with_unit(name))
        units[name] = unit or ("rad/s" if _RATE.search(joined) else "")
        base = (parse_unit(unit) or (unit, 1.0))[0]
        is_wheel = _WHEEL.search(joined) or base.endswith("/s")
        if not is_wheel or any(_SOURCE_OF.get(word) == "cmd" for word in words):
            continue
        kind = _KINDS_OF_WHEELS.get(base, "other")
        if re.search("effort|torque", joined):
            kind = "torques"
        elif not base and _NO_RATE.search(joined):
            kind = "other"
        members.setdefault(kind + side_of(joined), []).append(name)
    found = Columns()
    for names, kinds in ((_WHEELS, ("positions", "rates")), (MOTOR_COLUMNS[TORQUES], ("torques",))):
        for kind in kinds:
            sides = [members.get(kind + side, []) for side in WHEEL_SIDES]
            if all(sides) and there.isdisjoint(names):
                for ours, side in zip(names, sides, strict=True):
                    found[ours] = ("+".join(side), units[side[0]])
    return found


def as_option(columns: Mapping[str, tuple[str, str]]) -> str:
    """Return columns as `--columns` takes them."""
    parts = []
    for ours, (theirs, unit) in columns.items():
        parts.append(f"{ours}={theirs}:{unit}" if unit else f"{ours}={theirs}")
    return ",".join(parts)
