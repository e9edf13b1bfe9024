"""The ground that a simulated robot stands on: level, or a ramp. The planar models know none of it.

On the command line a terrain is `flat`, `ramp:SLOPE` or `ramp:slope_deg=5,toward_deg=90`. In here
units are SI.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ssmr.geometry import rotate_world_to_body
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray
from validation.output import shorten_text

_USAGE = "flat, ramp:slope_deg=NUMBER,toward_deg=0"
"""The forms in which terrains are written."""
_RAMP = re.compile(r"ramp:(?:slope_deg=)?([^,=]+)(?:,toward_deg=([^,=]+))?")


@dataclass(frozen=True)
class Terrain:
    """Shape of the ground."""

    slope: float = 0.0
    """Slope of a ramp, 0 on level ground [rad]. Positions on it are along its surface."""
    toward: float = 0.0
    """The heading in which a ramp rises [rad]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        require_in_range(self, "slope", 0.0, math.radians(45.0))
        require_in_range(self, "toward", -1e3, 1e3)

    @property
    def level(self) -> bool:
        """Whether the ground is level."""
        return self.slope == 0.0

    def gravity(self, g: float) -> FloatArray:
        """Return (3,) gravity [m/s2] along the axes of the ground."""
        down = -g * math.cos(self.slope)
        along = g * math.sin(self.slope)
        x = -along * math.cos(self.toward)
        y = -along * math.sin(self.toward)
        return np.array([x, y, down])

    def gravity_in_body(self, yaw: FloatArray, g: float) -> FloatArray:
        """Return (M, 3) gravity [m/s2] along the axes of a robot with (M,) headings."""
        world = self.gravity(g)
        along = rotate_world_to_body(world[:2], yaw)
        return np.column_stack([along, np.full(len(yaw), world[2])])

    @property
    def spec(self) -> str:
        """Text of the terrain that `parse_terrain` reads back."""
        if self.level:
            return "flat"
        toward = math.degrees(self.toward)
        return f"ramp:slope_deg={math.degrees(self.slope):.12g},toward_deg={toward:.12g}"

    @property
    def words(self) -> str:
        """Description of the terrain for titles."""
        if self.level:
            return "level ground"
        return (
            f"a ramp of {math.degrees(self.slope):g}° "
            f"that rises toward {math.degrees(self.toward):g}°"
        )


FLAT = Terrain()
"""Level ground."""


def parse_terrain(text: str) -> Terrain:
    """Return the terrain that a text such as `ramp:5` describes.

    Raises:
        ValueError: it is not understood, or a number is outside its range; the message says what
            would be right.
    """
    if text == "flat":
        return FLAT
    ramp = _RAMP.fullmatch(text)
    try:
        if ramp is None:
            raise ValueError(f"wanted {_USAGE}")
        slope, toward = (math.radians(float(degrees or 0.0)) for degrees in ramp.groups())
        return Terrain(slope, toward)
    except ValueError as error:
        raise ValueError(
            f"terrain '{shorten_text(text, 60)}' is not understood: {error}"
        ) from error
