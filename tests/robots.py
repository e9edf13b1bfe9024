"""Robots that tests drive: the thesis' Husky with changed numbers, and random robots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
from hypothesis import strategies as st

from validation import load_robot
from validation.plants.kind import PlantProfile
from validation.simulator.calibration import Calibration
from validation.simulator.composing import compose_robot
from validation.simulator.model import set_calibration
from validation.simulator.motors import set_motors

HUSKY = load_robot("husky")
WHEELBASE = HUSKY.wheelbase
TRACK = HUSKY.track
SAME_PATH = 1e-4
SAME_LOADS = 5e-3
"""Greatest distance between the paths of two settings of physics [m], and greatest root mean square
difference of a wheel's load over its load at rest [1]."""


def husky(**changes: Any) -> Calibration:
    """Return the Husky's numbers with some changed."""
    return Calibration.of(HUSKY, **changes)


def scaled(document: dict[str, Any], length: float, mass: float) -> dict[str, Any]:
    """Return the file of a geometrically similar robot: lengths and masses times factors."""

    def times(section: dict[str, Any], factors: dict[str, float], usual: float) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key, value in section.items():
            factor = factors.get(key, usual)
            many = isinstance(value, list)
            out[key] = (
                [factor * v for v in value]
                if many
                else value
                if isinstance(value, str)
                else factor * value
            )
        return out

    inertia = mass * length**2
    masses = {"com": length, "inertia": inertia, "wheel_inertia": inertia}
    return {
        **document,
        "geometry": times(document["geometry"], {}, length),
        "mass": times(document["mass"], masses, mass),
    }


def drawn_document(
    between: Callable[[float, float], float],
    one_of: Callable[[Sequence[str]], Any],
    off_the_middle: float = 0.25,
) -> dict[str, Any]:
    """Return the file of a random robot.

    It has 8 to 800 kg, wheels of 0.05 to 0.35 m, any tyres and links.

    Args:
        between: draws a number between two.
        one_of: draws one of several words.
        off_the_middle: greatest distance of the centre of mass from the middle, over half the
            wheelbase and half the track [1].
    """
    radius = 0.05 * 7.0 ** between(0.0, 1.0)
    total = 8.0 * 100.0 ** between(0.0, 1.0)
    wheelbase = radius * between(2.1, 4.5)
    track = wheelbase / between(0.5, 1.6)
    width = min(radius * between(0.2, 1.0), 0.5 * track)
    wheel = total * between(0.008, 0.06)
    size = [wheelbase + radius * between(0.2, 2.0), track - width, track * between(0.2, 0.8)]
    # A box of the size of the hull, whose mass lies nearer to its middle or farther out along each
    # axis.
    x, y, z = ((total - 4.0 * wheel) * s * s / 12.0 * between(0.5, 2.0) for s in size)
    height = max(0.6 * radius, track * between(0.15, 0.6))
    com = [0.5 * between(-off_the_middle, off_the_middle) * length for length in (wheelbase, track)]
    return {
        "schema": "ssmr.robot/1",
        "name": "drawn",
        "geometry": {
            "wheelbase": wheelbase,
            "track": track,
            "wheel_radius": radius,
            "wheel_width": width,
            "body_size": size,
            "link": str(one_of(["belt", "none"])),
        },
        "mass": {
            "total": total,
            "wheel": wheel,
            "com": [*com, height - radius],
            "inertia": [y + z, x + z, x + y],
        },
        "simulation": {
            "friction": between(0.2, 1.0),
            "wheel_shape": str(one_of(["ellipsoid", "cylinder", "capsule"])),
        },
    }


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    """Draw what the file of a robot says (`drawn_document`)."""

    def between(low: float, high: float) -> float:
        return low + (high - low) * draw(st.floats(0.0, 1.0, width=16))

    return drawn_document(between, lambda words: draw(st.sampled_from(list(words))))


def former_model(section: PlantProfile) -> mujoco.MjModel:
    """Return version 1.0's robot, with its looks, all sensors, islands, and Newton's method."""
    robot = section.parameters.robot
    spec = compose_robot(robot)
    spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], condim=3
    )
    model = spec.compile()
    set_calibration(model, section.parameters)
    set_motors(model, section.parameters, section.drive)
    return model
