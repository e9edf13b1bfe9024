"""Every number of a robot, with its unit, its grade and its source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

from ssmr.parameters import described
from ssmr.robot.vehicle import Drive, Vehicle
from validation.simulator.description import Geometry, Masses, Robot, Simulation

SECTION_KINDS: Mapping[str, type] = MappingProxyType(
    {"geometry": Geometry, "mass": Masses, "drive": Drive, "simulation": Simulation, "vehicle": Vehicle}
)
"""The sections of a robot's file, and the dataclass that each fills."""
_UNITS_OF_LISTS = {
    "body_size": "m",
    "body_centre": "m",
    "imu": "m",
    "com": "m",
    "wheel_inertia": "kg m2",
    "inertia": "kg m2",
}
_ALWAYS = {"drive.torque_limit", "drive.v_max", "drive.w_max", "drive.command_half_track"}
"""Numbers of the drive that are shown even where the file does not say them."""

RobotValue = float | str | tuple[float, ...]


@dataclass(frozen=True)
class RobotNumber:
    """One number of a robot, or a few that belong together."""

    key: str
    """Section and name, such as `geometry.track`."""
    value: RobotValue
    """Value in SI units."""
    unit: str
    """Unit; empty for a word."""
    grade: str
    """measured, datasheet, published, fitted or assumed."""
    source: str
    """Where it comes from."""

    def text(self) -> str:
        """Return the value as it is written, without its unit."""
        if isinstance(self.value, str):
            return self.value
        some = self.value if isinstance(self.value, tuple) else (self.value,)
        return ", ".join("∞" if math.isinf(v) else f"{v:.5g}" for v in some)


def unit_of_key(kind: type, name: str) -> str:
    """Return the unit of a field of one of the dataclasses of `SECTION_KINDS`; empty for a word."""
    declared = described(kind)
    return declared[name].unit if name in declared else _UNITS_OF_LISTS.get(name, "")


def robot_numbers(robot: Robot) -> tuple[RobotNumber, ...]:
    """Return geometry, masses and tyres of a robot, and what its file says of its drive and its planar models."""
    parts = {"geometry": robot.geometry, "mass": robot.masses, "drive": robot.drive}
    parts |= {"simulation": robot.simulation, "vehicle": robot.vehicle}
    found = []
    for section, kind in SECTION_KINDS.items():
        for f in fields(kind):
            key = f"{section}.{f.name}"
            if section in ("drive", "vehicle") and key not in robot.said and key not in _ALWAYS:
                continue
            grade, source = robot.source(key)
            value = getattr(parts[section], f.name)
            if key not in robot.said and f.name in _CHOSEN:
                source = "usual; the file does not say it"
            elif isinstance(value, float) and math.isinf(value):
                source = "none is given"
            found.append(RobotNumber(key, value, unit_of_key(kind, f.name), grade, source))
    return tuple(found)


_CHOSEN = {"link", "friction", "wheel_shape", "axle_height"}
"""Keys whose default is no estimate from other numbers."""
