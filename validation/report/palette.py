"""One colour for each plant and controller, the same in every picture, plot and recording.

Pictures also spell names as people write them: MuJoCo for `mujoco`.

Each is declared with its plant or law. The hues shipped are those of Okabe and Ito, which people
with any of the common colour blindnesses tell apart; they differ in lightness too, so most survive
a grey print.
"""

from __future__ import annotations

import re

from validation.plants.table import is_plant, plant_kind

Rgb = tuple[int, int, int]

BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)
GREY: Rgb = (128, 128, 128)
"""Colour of a name that declares none."""
_REFERENCES = {
    "recording": (32, 32, 36),  # near-black: what really happened
    "truth": (64, 64, 72),  # a plant's motion that the same plant is fitted to
}


def plant_colour(name: str) -> Rgb:
    """The colour of a plant as it declares it, of `recording` or `truth`; grey for others."""
    if not is_plant(name):
        return _REFERENCES.get(name, GREY)
    red, green, blue = bytes.fromhex(plant_kind(name).colour.removeprefix("#"))
    return red, green, blue


_SPELT = {
    "mujoco": "MuJoCo",
    "coulomb": "Coulomb",
    "four_wheel": "four tyres",
    "drake": "Drake",
    "ode": "ODE",
    "pid": "PID",
    "lqr": "LQR",
    "mpc": "MPC",
}
"""Plants and controllers whose names in words are not those of commands and files."""


def spell_name(name: str) -> str:
    """Return a name as a person would write it: MuJoCo, LQR tuned, husky unnamed."""
    return re.sub(r"\b\w+\b", lambda word: _SPELT.get(word[0], word[0]), name).replace("_", " ")


def mix_colours(a: Rgb, b: Rgb, share: float) -> Rgb:
    """Colour `a` with `share` of it (0 to 1) replaced by `b`."""
    red, green, blue = (round(x + share * (y - x)) for x, y in zip(a, b, strict=True))
    return red, green, blue


VERDICT_INKS = {
    "agrees": "#5fb894",
    "agrees if": "#b5d98f",
    "not told apart": "#d9cf8a",
    "nearer": "#7fb0e6",
    "differs": "#e8935c",
    "not compared": "#c8c8ce",
}
"""Colours of the verdicts, as on the page of a replication but a little darker."""
