"""State filters by name, and in TOML files: the thesis', one for a robot that nobody has commissioned, or a user's own."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w

from ssmr.estimation.settings import EkfSettings, learning
from ssmr.parameters import described
from ssmr.robot.vehicle import Drive
from validation import store
from validation.files import reading

SCHEMA = "ssmr.filter/1"
THESIS, LEARNING = "thesis", "learning"
"""Names of the filters of every robot: the lab's, and one that doubts the driver's numbers and learns what it can."""


@dataclass(frozen=True)
class StateFilter:
    """A state filter of one robot."""

    name: str
    """Name in results."""
    settings: EkfSettings
    """Its assumptions about the robot and its sensors."""

    def as_dict(self) -> dict[str, Any]:
        """Return the name and the settings."""
        return {"name": self.name, **asdict(self.settings)}

    def sentence(self) -> str:
        """Return what a filter that learns knows of its robot at the start, and how sure of it it is."""
        s = self.settings
        return (
            f"the filter begins with wheel scales of {s.scale_left:.3f} and {s.scale_right:.3f} (± {s.scale_std:.3g}), "
            f"a turning ratio of {s.turning:.3g} (± {s.turning_std:.2g}), a middle of turning {s.slide:+.3f} m behind and "
            f"{s.shift:+.3f} m to the left (± {s.centre_std:.2g} m), and a gyro's bias of {s.bias:.3g} "
            f"(± {s.bias_std:.2g} rad/s)."
        )

    def save(self, path: str | Path) -> Path:
        """Write the filter as a TOML file that `load_filter` reads, and return its path."""
        target, settings = Path(path), {k: float(v) for k, v in asdict(self.settings).items()}
        store.write_text(target, tomli_w.dumps(store.encodable({"schema": SCHEMA, "name": self.name, "filter": settings})))
        return target


def odometry_of(drive: Drive) -> EkfSettings:
    """Return the thesis' filter, whose wheel odometry is the driver's own."""
    return EkfSettings(radius=drive.command_radius, half_track=drive.command_half_track)


def load_filter(name_or_path: str | Path, odometry: EkfSettings, others: Sequence[str] = ()) -> StateFilter:
    """Return a state filter.

    Args:
        name_or_path: `thesis` or `learning`, or the path of a TOML file, such as track writes beside its results.
        odometry: wheel radius and half-track of the robot's driver, and what a file does not name.
        others: further names of filters, for the message.

    Raises:
        ValueError: there is no such filter, or its file says something that cannot be.
    """
    name = str(name_or_path)
    if name in (THESIS, LEARNING):
        return StateFilter(name, odometry if name == THESIS else learning(odometry))
    if not os.path.exists(name):
        raise ValueError(
            f"no filter '{name}'; there are: {', '.join((THESIS, LEARNING, *others))}; or give the path of a TOML file"
        )
    document = reading.read_toml(name)
    try:
        return _parse(document, odometry)
    except ValueError as error:
        raise ValueError(f"filter {name}: {error}") from error


def _parse(document: Mapping[str, Any], odometry: EkfSettings) -> StateFilter:
    if document.get("schema") != SCHEMA:
        raise ValueError(f"schema is {reprlib.repr(document.get('schema'))}, wanted '{SCHEMA}'")
    reading.require_known(document, ("schema", "name", "filter"), "the top level")
    name, values = document.get("name"), document.get("filter")
    if not isinstance(name, str) or not isinstance(values, dict):
        raise ValueError("a filter has a name, which is text, and a table [filter]")
    reading.require_known(values, described(EkfSettings), "[filter]")
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"[filter] {key} is {reprlib.repr(value)}, wanted a number")
    return StateFilter(name, replace(odometry, **{key: float(value) for key, value in values.items()}))
