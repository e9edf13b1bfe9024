"""One colour for each plant, the same in every picture, plot and recording.

The hues are those of Okabe and Ito, which people with any of the common colour blindnesses tell apart; they differ in
lightness too, so most survive a grey print.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

Rgb = tuple[int, int, int]

PALETTE: Mapping[str, Rgb] = MappingProxyType(
    {
        "mujoco": (230, 159, 0),  # amber: the Husky is yellow
        "improved": (0, 114, 178),  # blue
        "coulomb": (213, 94, 0),  # vermilion
        "linear": (0, 158, 115),  # green
        "kinematic": (204, 121, 167),  # purple
        "recording": (32, 32, 36),  # near-black: what really happened
        "truth": (64, 64, 72),  # a plant's motion that the same plant is fitted to
    }
)
"""Red, green, blue, 0-255, by the name of the plant, `recording` or `truth`."""

CONTROLLER_PALETTE: Mapping[str, Rgb] = MappingProxyType(
    {"pid": (213, 94, 0), "lqr": (0, 114, 178), "lqr-scheduled": (0, 158, 115), "smc": (204, 121, 167)}
)
"""Red, green, blue, 0-255, by the name of the controller; others are grey."""


def colour(name: str) -> Rgb:
    """The colour of a plant; mid-grey for a name that has none."""
    return PALETTE.get(name, (128, 128, 128))


def mix(a: Rgb, b: Rgb, share: float) -> Rgb:
    """Colour `a` with `share` of it (0 to 1) replaced by `b`."""
    red, green, blue = (round(x + share * (y - x)) for x, y in zip(a, b, strict=True))
    return red, green, blue
