"""The ground that a simulated robot stands on: level, a ramp, or rough. The planar models know none of it.

On the command line a terrain is `KIND`, `KIND:NUMBER` or `KIND:KEY=NUMBER,...`: `ramp:5`, `rough:height_mm=5,seed=3`. Units
are in the keys there; in here they are SI.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np

from ssmr.geometry import rotate_world_to_body, shift_reference
from ssmr.parameters import MOST_SEED, require_in_range, require_within
from ssmr.types import FloatArray
from validation.words import shortened

if TYPE_CHECKING:
    from ssmr.robot.ground import Surface

Kind = Literal["flat", "ramp", "rough"]

PERIOD = 40.0
"""Rough ground repeats itself after so much in x and y [m]: farther than most runs go."""
CELLS_A_LENGTH = 5.0
"""Heights over one correlation length; a spline through them keeps all but a ten-thousandth of the ground's power."""


@dataclass(frozen=True)
class Terrain:
    """Shape and friction of the ground; a field has effect only for its kind of ground."""

    kind: Kind = "flat"
    """Kind of ground."""
    slope: float = 0.0
    """Slope of a ramp [rad]. Positions on it are along its surface."""
    toward: float = 0.0
    """The heading in which a ramp rises [rad]."""
    height: float = 0.0
    """Root mean square height of rough ground about its mean [m]."""
    length: float = 0.3
    """Correlation length of rough ground [m]: its autocorrelation is exp(-(distance/length)^2)."""
    seed: int = 0
    """Seed of rough ground."""

    def __post_init__(self) -> None:
        """Check kind and ranges."""
        if self.kind not in KINDS:
            raise ValueError(f"unknown terrain '{self.kind}'; there are: {', '.join(KINDS)}")
        require_in_range(self, "slope", 0.0, math.radians(45.0))
        require_in_range(self, "height", 0.0, 0.2)
        require_in_range(self, "length", 0.1, 10.0)
        require_in_range(self, "toward", -1e3, 1e3)
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)

    @property
    def even(self) -> bool:
        """Whether the ground is level and without bumps, so that wheel loads on it must be smooth."""
        return self.kind == "flat"

    @property
    def level(self) -> bool:
        """Whether the ground is one level plane."""
        return self.kind in ("flat", "ramp") and self.slope == 0.0

    @property
    def curvature(self) -> float:
        """Root mean square curvature of rough ground along a line [1/m]: that of its autocorrelation's fourth derivative."""
        return math.sqrt(12.0) * self.height / self.length**2

    def require_room(self, wheel_radius: float) -> None:
        """Refuse ground that is curved so tightly that a wheel of this radius [m] would touch it in two places.

        Raises:
            ValueError: it is.
        """
        if self.kind == "rough" and 3.0 * self.curvature * wheel_radius > 1.0:
            raise ValueError(
                f"{self.words} is curved as tightly as a wheel of {1e3 * wheel_radius:.0f} mm, which would touch it in two "
                "places at once; ask for less height or a longer correlation length"
            )

    def gravity(self, g: float) -> FloatArray:
        """Return (3,) gravity [m/s2] along the axes of the ground."""
        if self.kind != "ramp":
            return np.array([0.0, 0.0, -g])
        along = g * math.sin(self.slope)
        return np.array([-along * math.cos(self.toward), -along * math.sin(self.toward), -g * math.cos(self.slope)])

    def gravity_in_body(self, yaw: FloatArray, g: float) -> FloatArray:
        """Return (M, 3) gravity [m/s2] in the axes of a robot that stands flat on the ground with (M,) headings."""
        world = self.gravity(g)
        return np.column_stack([rotate_world_to_body(world[:2], yaw), np.full(len(yaw), world[2])])

    @cached_property
    def surface(self) -> Surface:
        """Rough ground: white noise through a Gaussian filter of standard deviation length / 2, scaled to `height`."""
        from scipy import ndimage  # slow to import, like the compiled surface; only rough ground needs them

        from ssmr.robot.ground import Surface

        n = round(PERIOD * CELLS_A_LENGTH / self.length)
        noise = np.random.default_rng(self.seed).standard_normal((n, n))
        smooth = ndimage.gaussian_filter(noise, 0.5 * CELLS_A_LENGTH, mode="wrap")
        smooth -= smooth.mean()
        return Surface(smooth * (self.height / np.sqrt(np.mean(smooth**2))), PERIOD / n, -0.5 * PERIOD)

    def height_at(self, xy: FloatArray) -> FloatArray:
        """Return the (M,) height [m] of the ground at (M, 2) positions [m]."""
        return self.surface.at(xy)[:, 0] if self.kind == "rough" else np.zeros(len(xy))

    def lie(self, pose: FloatArray, wheelbase: float, track: float) -> FloatArray:
        """Return (M, 3) height [m], roll and pitch [rad] of the plane nearest to the ground under a robot's wheels.

        Args:
            pose: (M, 3) poses of the middle between the axles.
            wheelbase: distance of the axles [m].
            track: distance of the sides [m].
        """
        if self.kind != "rough":
            return np.zeros_like(pose)
        front_left, front_right, rear_left, rear_right = (
            self.height_at(shift_reference(pose, (x, y))[:, :2])
            for x in (0.5 * wheelbase, -0.5 * wheelbase)
            for y in (0.5 * track, -0.5 * track)
        )
        height = 0.25 * (front_left + front_right + rear_left + rear_right)
        ahead = 0.5 * (front_left + front_right - rear_left - rear_right) / wheelbase
        aside = 0.5 * (front_left - front_right + rear_left - rear_right) / track
        return np.column_stack([height, np.arctan(aside), -np.arctan(ahead)])

    @property
    def spec(self) -> str:
        """Text of the terrain that `parse_terrain` reads back."""
        keys = _KEYS[self.kind].items()
        given = ",".join(f"{key}={getattr(self, name) / unit:.12g}" for key, (name, unit) in keys)
        return f"{self.kind}:{given}" if given else self.kind

    @property
    def words(self) -> str:
        """Description of the terrain for titles."""
        return {
            "flat": "level ground",
            "ramp": f"a ramp of {math.degrees(self.slope):g}° that rises toward {math.degrees(self.toward):g}°",
            "rough": f"rough ground of {1e3 * self.height:g} mm rms, correlation length {1e3 * self.length:g} mm",
        }[self.kind]


_DEGREE, _MILLI = math.pi / 180.0, 1e-3
_KEYS: Mapping[str, Mapping[str, tuple[str, float]]] = MappingProxyType(
    {
        "flat": {},
        "ramp": {"slope_deg": ("slope", _DEGREE), "toward_deg": ("toward", _DEGREE)},
        "rough": {"height_mm": ("height", _MILLI), "length_mm": ("length", _MILLI), "seed": ("seed", 1)},
    }
)
"""The keys of each kind on the command line, with the field that each sets and its unit in SI; the first may be left out."""

KINDS = tuple(_KEYS)
"""All kinds."""

FLAT = Terrain()


def parse_terrain(text: str) -> Terrain:
    """Return the terrain that a text such as `ramp:5` describes.

    Raises:
        ValueError: an unknown kind or key, no number, or one outside its range; the message says what would be right.
    """
    kind, _, rest = text.partition(":")
    said = shortened(text, 60)
    if kind not in KINDS:
        raise ValueError(f"unknown terrain '{said}'; there are: {', '.join(map(usage, KINDS))}")
    keys, values = _KEYS[kind], dict[str, float]()
    for position, part in enumerate(filter(None, map(str.strip, rest.split(",")))):
        key, equals, number = part.rpartition("=")
        name, unit = keys.get(key.strip() if equals else next(iter(keys), "") if position == 0 else "", ("", 1.0))
        try:
            if not name or name in values:
                raise ValueError
            values[name] = unit * (int(number) if name == "seed" else float(number))
        except ValueError:
            raise ValueError(f"terrain '{said}': '{shortened(part, 60)}' is not understood; wanted {usage(kind)}") from None
    if keys and next(iter(keys.values()))[0] not in values:
        raise ValueError(f"terrain '{said}' says too little; wanted {usage(kind)}")
    try:
        return Terrain(kind, **values)  # type: ignore[arg-type]  # names and kinds are those of _KEYS
    except ValueError as error:
        raise ValueError(f"terrain '{said}': {error}") from error


def usage(kind: str) -> str:
    """Return the form in which a kind of terrain is written."""
    if not _KEYS[kind]:
        return kind
    first, *others = _KEYS[kind].items()
    more = [f"{key}={getattr(FLAT, name) / unit:g}" for key, (name, unit) in others]
    return f"{kind}:{','.join([f'{first[0]}=NUMBER', *more])}"
