"""Mechanics of a robot's numbers, without a simulation, and which of them are guesses."""

from __future__ import annotations

import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.types import FloatArray
from validation.simulator.calibration import contact_half_width
from validation.simulator.description import GRAVITY, Robot, Vector3

_MEASURABLE = (
    "geometry.wheelbase",
    "geometry.track",
    "geometry.wheel_radius",
    "geometry.wheel_width",
    "geometry.body_size",
    "mass.total",
    "mass.wheel",
    "mass.wheel_inertia",
    "mass.com",
    "mass.inertia",
    "simulation.friction",
    "simulation.gain",
    "simulation.armature",
    "drive.torque_limit",
)
"""Numbers of a robot that one can measure or look up, `section.key`."""


def whole_com(robot: Robot) -> Vector3:
    """Return the centre of mass of the whole robot, wheels included, in the base frame [m]."""
    share = robot.base_mass / robot.mass
    x, y, z = robot.com
    return share * x, share * y, share * z + (1.0 - share) * robot.axle_height


def resting_shares(wheelbase: float, track: float, x: float, y: float) -> FloatArray:
    """Return the (4,) wheel loads over the weight [1] on equal springs and level ground.

    The weight is x ahead and y to the left of the middle [m]. A negative share says that the robot
    would fall over that wheel's opposite.
    """
    ahead = x * FRONT / (0.5 * wheelbase)
    aside = y * LEFT / (0.5 * track)
    return 0.25 * (1.0 + ahead + aside)


def load_shares(robot: Robot) -> FloatArray:
    """Return the (4,) wheel loads over the weight [1] on equal springs and level ground.

    They are in the order of `WHEELS`. A negative one says that the robot would fall over that
    wheel's opposite.
    """
    x, y, _ = whole_com(robot)
    return resting_shares(robot.wheelbase, robot.track, x, y)


def spot_turn(robot: Robot) -> SkidTurn | None:
    """Return a robot's quasi-static turn on the spot; None where its wheels do not carry it."""
    if load_shares(robot).min() < 0.0:
        return None
    x, y, _ = whole_com(robot)
    half_width = contact_half_width(robot, robot.wheel_shape)
    return turn_on_the_spot(robot.wheelbase, robot.track, x, y, half_width=half_width)


def turning_torque(robot: Robot, turn: SkidTurn) -> float:
    """Return the torque of a side in a turn on the spot on ground of friction 1 [N m], no losses.

    What the tyres of loads N and slips s dissipate, mu N |s| each, the two sides have to give. The
    forces along the robot cancel, so both give half of it: r mu sum(N |s|) / 2 is the torque of a
    side whose rims roll at 1 m/s. For a centre of mass in the middle that is r mu (m g / 2) L / D
    with the diagonal D (docs/physics.md).
    """
    return 0.5 * robot.wheel_radius * robot.mass * GRAVITY * turn.slip


def robot_outline(robot: Robot) -> FloatArray:
    """Return the (2, 3) lowest and highest coordinates of hull and tyres in the base frame [m]."""
    centre = np.array(robot.body_centre)
    half = 0.5 * np.array(robot.body_size)
    axles = np.array([0.0, 0.0, robot.axle_height])
    ahead = 0.5 * robot.wheelbase + robot.wheel_radius
    aside = 0.5 * (robot.track + robot.wheel_width)
    reach = np.array([ahead, aside, robot.wheel_radius])
    lowest = np.minimum(centre - half, axles - reach)
    highest = np.maximum(centre + half, axles + reach)
    return np.array([lowest, highest])


def guessed_numbers(robot: Robot) -> list[str]:
    """Return the numbers of body, wheels and motors that nobody has measured or published.

    Each is a key `section.name`.
    """
    return [key for key in _MEASURABLE if robot.source(key)[0] == "assumed"]
