"""A new robot's file as text, with unit and grade beside each number, and the estimates as lines to fill in."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssmr.parameters import described
from validation import store
from validation.simulator.checking import spot_turn
from validation.simulator.description import SCHEMA, SECTIONS, Robot, parse_robot, shipped_robots
from validation.words import one_line

SURE_FRICTION = 1.0
"""Friction of ground on which motors whose torque nobody knows are taken to turn the robot on the spot [1]."""
_REMARK_COLUMN = 34
"""Where remarks beside numbers begin."""
_ESTIMATED = (
    "mass.wheel", "mass.wheel_inertia", "mass.com", "mass.inertia", "geometry.body_size", "geometry.body_centre",
    "simulation.gain", "simulation.armature", "simulation.friction",
)  # fmt: skip
"""Numbers that are shown as remarks where the file does not say them."""
_UNITS_OF_LISTS = dict.fromkeys(("body_size", "body_centre", "imu", "com"), "m")
_UNITS_OF_LISTS |= dict.fromkeys(("wheel_inertia", "inertia"), "kg m2")
_TO_DO = (
    "next: weigh each of the four wheels while the robot stands on them: the loads give com x and y; lift one end by a "
    "known height and weigh again for z",
    "next: measure the hull between the tyres (body_size, body_centre) for pictures and for the estimate of inertia",
    "next: drive a metre and count the wheels' turns: wheel_radius is the distance over 2 pi turns",
    "next: drag the robot sideways with a spring scale: friction is force over weight; then turn it on the spot and "
    "read the motors' currents",
)
"""What to measure after the five numbers, the most important first."""


@dataclass(frozen=True)
class Entry:
    """A number or word of a new robot's file."""

    key: str
    """Section and name, such as `geometry.track`."""
    value: float | str | Sequence[float]
    """Value in SI units."""
    source: str
    """`GRADE: where it is from`."""


@dataclass(frozen=True, eq=False)
class RobotDraft:
    """A new robot's file, before it is written."""

    robot: Robot
    """The robot that the file describes."""
    text: str
    """What the file says."""
    remarks: Sequence[str]
    """What was estimated or guessed, and what to do next."""

    def save(self, path: str | Path) -> Path:
        """Write the file, whole or not at all; return its path.

        Raises:
            ValueError: there is something of that name already.
            OSError: the file cannot be written.
        """
        target = Path(path)
        if target.exists() or target.is_symlink():
            raise ValueError(f"{path}: there is such a file already, and it is not overwritten; name another")
        target.parent.mkdir(parents=True, exist_ok=True)
        store.write_text(target, self.text)
        return target


def unit_of_key(key: str) -> str:
    """Return the unit of a number of a robot's file, `section.key`; empty for a word."""
    section, _, name = key.partition(".")
    declared = described(SECTIONS[section])
    return declared[name].unit if name in declared else _UNITS_OF_LISTS.get(name, "")


def require_free_name(name: str) -> None:
    """Refuse the name of a robot that comes with the package: a name would mean two robots.

    Raises:
        ValueError: it is one.
    """
    if name in shipped_robots():
        raise ValueError(f"name '{one_line(name)}' belongs to a robot that comes with the package; take another")


def draft_robot(name: str, known: Mapping[str, float]) -> RobotDraft:
    """Return the file of a robot of which a tape measure and a scale know a few numbers.

    Args:
        name: its name.
        known: numbers by `section.key` [SI]: at least wheelbase, track, radius and width of the wheels, and the mass.

    Raises:
        ValueError: the name is taken or cannot be one, or a number cannot be.
    """
    require_free_name(name)
    entries = [Entry(key, float(value), "measured: given to `new`") for key, value in known.items()]
    entries.append(Entry("geometry.link", "belt", "assumed: as most such robots"))
    heading = (
        f"The robot {name}. The numbers below were given to `python -m validation.robots new`; lines that begin with # are "
        "estimates from them. To replace one, measure it, take the # away, and say in [sources] where it is from.",
    )
    remarks = ("estimated from the size: com, inertia and wheels of [mass], the hull, gain and armature", *_TO_DO)
    return drafted({"name": name}, entries, remarks, heading)


def drafted(
    texts: Mapping[str, str], entries: Sequence[Entry], remarks: Sequence[str], heading: Sequence[str]
) -> RobotDraft:
    """Return the file of a new robot; where no entry says a torque limit, one is added that surely turns it on the spot.

    Args:
        texts: its name and, if known, title and description.
        entries: its numbers, a section after the other.
        remarks: what was estimated or guessed.
        heading: remarks at the top of the file.

    Raises:
        ValueError: the entries say something that cannot be; the message names section and key.
    """
    known = {key: one_line(value) for key, value in texts.items() if value}
    robot, numbers = _described(known, entries), list(entries)
    spot = spot_turn(robot)
    if "drive.torque_limit" not in robot.said and spot is not None:
        torque = float(f"{0.5 * SURE_FRICTION * spot.side_torque:.3g}")
        source = f"assumed: enough to turn on the spot on ground of friction {SURE_FRICTION:g}"
        numbers.append(Entry("drive.torque_limit", torque, source))
        robot = _described(known, numbers)
    lines = [f"# {line}" for words in heading for line in textwrap.wrap(one_line(words), 120)]
    lines += [f"{key} = {_text(value)}" for key, value in {"schema": SCHEMA, **known}.items()]
    parts = {"geometry": robot.geometry, "mass": robot.masses, "drive": robot.drive, "simulation": robot.simulation}
    for section, part in parts.items():
        lines += ["", f"[{section}]"]
        for entry in (e for e in numbers if e.key.startswith(f"{section}.")):
            lines.append(_with_unit(entry.key, _rounded(entry.value, 9), entry.source.partition(":")[0]))
        for key in _ESTIMATED:
            if key.startswith(f"{section}.") and key not in robot.said:
                lines.append("# " + _with_unit(key, _rounded(getattr(part, key.partition(".")[2]), 4), "estimated"))
    lines += ["", "[sources]", *(f"{json.dumps(e.key)} = {_text(one_line(e.source))}" for e in numbers)]
    return RobotDraft(robot, "\n".join(lines) + "\n", remarks)


def _described(texts: Mapping[str, str], entries: Sequence[Entry]) -> Robot:
    sections: dict[str, dict[str, Any]] = {}
    for entry in entries:
        section, _, name = entry.key.partition(".")
        sections.setdefault(section, {})[name] = _rounded(entry.value, 9)
    sources = {entry.key: one_line(entry.source) for entry in entries}
    return parse_robot({"schema": SCHEMA, **texts, **sections, "sources": sources})


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, str):
        return value
    return float(f"{value:.{digits}g}") if isinstance(value, float | int) else [_rounded(v, digits) for v in value]


def _text(value: object) -> str:
    return json.dumps(store.encodable(value), ensure_ascii=False)  # which is TOML, too


def _with_unit(key: str, value: object, grade: str) -> str:
    """Return the line of a number with its unit and its grade beside it."""
    unit = unit_of_key(key)
    line = f"{key.partition('.')[2]} = {_text(value)}"
    return f"{line:<{_REMARK_COLUMN}}  # {f'[{unit}]; ' if unit not in ('', '1') else ''}{grade}"
