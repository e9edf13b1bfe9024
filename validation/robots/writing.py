"""A robot's file as text, with a remark beside each number and the estimates as lines to fill in."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import tomli_w

from validation import store
from validation.files import reading
from validation.robots.numbers import SECTION_KINDS, unit_of_key
from validation.simulator.description import SCHEMA, Robot, parse_robot
from validation.words import one_line

_REMARK_COLUMN = 34
"""Where remarks beside numbers begin."""
_DIGITS = 9
"""Significant digits of numbers that were computed."""
_ESTIMATED = (
    "mass.wheel", "mass.wheel_inertia", "mass.com", "mass.inertia", "geometry.body_size", "geometry.body_centre",
    "simulation.gain", "simulation.armature", "simulation.friction",
)  # fmt: skip
"""Numbers that are shown as remarks where the file does not say them."""


@dataclass
class RobotDraft:
    """A robot's file in the making: what is known of each number, in the order of the file."""

    name: str
    """Name of the robot."""
    title: str = ""
    """Name for people."""
    description: str = ""
    """One sentence."""
    heading: tuple[str, ...] = ()
    """Remarks at the top of the file."""
    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Numbers by section and key, as `parse_robot` reads them."""
    remarks: dict[str, str] = field(default_factory=dict)
    """A few words beside a number, by `section.key`."""
    sources: dict[str, str] = field(default_factory=dict)
    """`GRADE: source` of each number, by `section.key`."""

    def say(self, key: str, value: Any, source: str, remark: str = "") -> None:
        """Set the number `section.key`, with its grade and source."""
        section, _, name = key.partition(".")
        self.sections.setdefault(section, {})[name] = _rounded(value)
        self.sources[key] = one_line(source)
        if remark:
            self.remarks[key] = one_line(remark)

    def document(self) -> dict[str, Any]:
        """Return the draft as `parse_robot` reads it."""
        texts = {"name": self.name, "title": self.title, "description": self.description}
        known = {key: one_line(value) for key, value in texts.items() if value}
        return {"schema": SCHEMA, **known, **self.sections, "sources": self.sources}


def _rounded(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_rounded(v) for v in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def drafted_text(draft: RobotDraft) -> tuple[Robot, str]:
    """Return the robot that a draft describes, and its file's text.

    Raises:
        ValueError: the draft says something that cannot be; the message names section and key.
    """
    robot = parse_robot(draft.document())
    text = _written(draft, robot)
    again = parse_robot(reading.parse_toml(text, draft.name))
    assert again == robot, "the file does not say what was meant"
    return robot, text


def _line(key: str, value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"{key} = [{', '.join(map(_plain, value))}]"
    return tomli_w.dumps(store.encodable({key: value})).strip()


def _plain(value: float) -> str:
    return tomli_w.dumps({"v": float(value)}).strip().removeprefix("v = ")


def _written(draft: RobotDraft, robot: Robot) -> str:
    lines = [f"# {line}" for words in draft.heading for line in textwrap.wrap(one_line(words), 120)]
    lines += [_line("schema", SCHEMA)]
    lines += [_line(key, value) for key, value in draft.document().items() if isinstance(value, str) and key != "schema"]
    parts: Mapping[str, Any] = MappingProxyType(
        {"geometry": robot.geometry, "mass": robot.masses, "drive": robot.drive, "simulation": robot.simulation}
    )
    for section, part in parts.items():
        kind = SECTION_KINDS[section]
        lines += ["", f"[{section}]"]
        for name, value in draft.sections.get(section, {}).items():
            key = f"{section}.{name}"
            unit = unit_of_key(kind, name)
            words = "; ".join(filter(None, (f"[{unit}]" if unit not in ("", "1") else "", draft.remarks.get(key, ""))))
            line = _line(name, value)
            lines.append(f"{line:<{_REMARK_COLUMN}}  # {words}" if words else line)
        for key in _ESTIMATED:
            of, _, name = key.partition(".")
            if of == section and key not in robot.said:
                unit = unit_of_key(kind, name)
                value = getattr(part, name)
                line = f"# {_line(name, _short(value))}"
                lines.append(f"{line:<{_REMARK_COLUMN}}  # {f'[{unit}]; ' if unit != '1' else ''}estimated")
    lines += ["", "[sources]", *(_source_line(key, words) for key, words in draft.sources.items())]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _source_line(key: str, words: str) -> str:
    return f'"{key}" = {_line("v", words).removeprefix("v = ")}'


def _short(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_short(v) for v in value]
    return float(f"{value:.4g}")
