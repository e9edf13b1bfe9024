"""A new robot's file as text: the numbers that are known, and where each is from."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from ssmr.parameters import described
from validation import store
from validation.simulator.checking import spot_turn
from validation.simulator.description import SCHEMA, SECTIONS, Robot, parse_robot, shipped_robots
from validation.words import one_line

SURE_FRICTION = 1.0
"""Friction of ground on which motors whose torque nobody knows are taken to turn the robot on the spot [1]."""
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
_HEADING = (
    "What this file does not say is estimated; `python -m validation.robots check` shows it. Measure a number, write it "
    "into its section, and say in [sources] where it is from."
)


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


def draft_robot(name: str, known: Mapping[str, float]) -> RobotDraft:
    """Return the file of a robot of which a tape measure and a scale know a few numbers.

    Args:
        name: its name.
        known: numbers by `section.key` [SI]: at least wheelbase, track, radius and width of the wheels, and the mass.

    Raises:
        ValueError: the name is taken or cannot be one, or a number cannot be.
    """
    entries = [Entry(key, float(value), "measured: given to `new`") for key, value in known.items()]
    entries.append(Entry("geometry.link", "belt", "assumed: as most such robots"))
    remarks = ("estimated from the size: com, inertia and wheels of [mass], the hull, gain and armature", *_TO_DO)
    return drafted(name, "", entries, remarks)


def drafted(name: str, description: str, entries: Sequence[Entry], remarks: Sequence[str]) -> RobotDraft:
    """Return the file of a new robot; where no entry says a torque limit, one is added that surely turns it on the spot.

    Args:
        name: its name.
        description: where it is from; may be empty.
        entries: its numbers.
        remarks: what was estimated or guessed.

    Raises:
        ValueError: the name is taken, or the entries say something that cannot be; the message names section and key.
    """
    if name in shipped_robots():
        raise ValueError(f"name '{one_line(name)}' belongs to a robot that comes with the package; take another")
    document = _document(name, description, entries)
    robot = parse_robot(document)
    spot = spot_turn(robot)
    if "drive.torque_limit" not in robot.said and spot is not None:
        torque = float(f"{0.5 * SURE_FRICTION * spot.side_torque:.3g}")
        source = f"assumed: enough to turn on the spot on ground of friction {SURE_FRICTION:g}"
        document = _document(name, description, [*entries, Entry("drive.torque_limit", torque, source)])
        robot = parse_robot(document)
    heading = "".join(f"# {line}\n" for line in textwrap.wrap(_HEADING, 120))
    return RobotDraft(robot, heading + tomli_w.dumps(store.encodable(document)), remarks)


def _document(name: str, description: str, entries: Sequence[Entry]) -> dict[str, Any]:
    """Return what the file says, as TOML has it; numbers have nine digits."""
    sections: dict[str, dict[str, Any]] = {}
    for entry in entries:
        section, _, key = entry.key.partition(".")
        sections.setdefault(section, {})[key] = _rounded(entry.value)
    texts = {"name": name, "description": one_line(description)} if description else {"name": name}
    return {"schema": SCHEMA, **texts, **sections, "sources": {entry.key: one_line(entry.source) for entry in entries}}


def _rounded(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return float(f"{value:.9g}") if isinstance(value, float | int) else [_rounded(v) for v in value]
