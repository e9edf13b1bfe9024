"""What mechanics says of a robot without any simulation: loads, the torque of a turn on the spot, and where tyres touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.types import FloatArray
from validation.simulator.description import WHEELS, Robot

WEIGHT_PER_KG = 9.81
"""Weight of a kilogram [N]."""


def whole_com(robot: Robot) -> tuple[float, float, float]:
    """Return the centre of mass of the whole robot, wheels included, in the base frame [m]."""
    share = robot.base_mass / robot.masses.total
    x, y, z = robot.masses.com
    return share * x, share * y, share * z + (1.0 - share) * robot.geometry.axle_height


def load_shares(robot: Robot) -> FloatArray:
    """Return the (4,) wheel loads over the weight [1] on equal springs and level ground, in the order of `WHEELS`.

    A negative one says that the robot would fall over that wheel's opposite.
    """
    x, y, _ = whole_com(robot)
    shares: FloatArray = 0.25 * (
        1.0 + x * FRONT / (0.5 * robot.geometry.wheelbase) + y * LEFT / (0.5 * robot.geometry.track)
    )
    return shares


@dataclass(frozen=True)
class SpotTurn:
    """A slow turn on the spot by mechanics."""

    turn: SkidTurn
    """Motion for rims that roll at 1 m/s."""
    side_torque: float
    """Torque of either side on ground of friction 1, without losses [N m]."""


def spot_turn(robot: Robot) -> SpotTurn | None:
    """Return the quasi-static turn on the spot of a robot; None where its wheels do not carry it.

    What the tyres of loads N and slips s dissipate, mu N |s| each, the two sides have to give. The forces along the robot
    cancel, so both give half of it: r mu sum(N |s|) / 2 is the torque of a side whose rims roll at 1 m/s. For a centre of
    mass in the middle that is r mu (m g / 2) L / D with the diagonal D (docs/physics.md).
    """
    shares = load_shares(robot)
    if shares.min() < 0.0:
        return None
    g, (x, y, _) = robot.geometry, whole_com(robot)
    turn = turn_on_the_spot(g.wheelbase, g.track, x, y)
    along = turn.forward - turn.yaw_rate * 0.5 * g.track * LEFT + LEFT
    across = turn.across + turn.yaw_rate * 0.5 * g.wheelbase * FRONT
    loads = shares * robot.masses.total * WEIGHT_PER_KG
    return SpotTurn(turn, 0.5 * g.wheel_radius * float(loads @ np.hypot(along, across)))


def tyre_hull_overlap(robot: Robot) -> dict[str, tuple[float, float]]:
    """Return how deep the tyres reach into the hull, by wheel: (across, along or up) [m]; positive both where they overlap.

    A tyre is a cylinder, the hull a box. Where they are apart, the gap is the greater one of both numbers' negatives.
    """
    g = robot.geometry
    half = 0.5 * np.array(g.body_size)
    centre, found = np.array(g.body_centre), {}
    for wheel, front, left in zip(WHEELS, FRONT, LEFT, strict=True):
        middle = np.array([0.5 * front * g.wheelbase, 0.5 * left * g.track, g.axle_height])
        away = np.abs(middle - centre) - half
        from_side = float(np.hypot(max(away[0], 0.0), max(away[2], 0.0)))
        found[wheel] = (0.5 * g.wheel_width - float(away[1]), g.wheel_radius - from_side)
    return found


def robot_outline(robot: Robot) -> FloatArray:
    """Return the (2, 3) lowest and highest coordinates of hull and tyres in the base frame [m]."""
    g = robot.geometry
    centre, half = np.array(g.body_centre), 0.5 * np.array(g.body_size)
    reach = np.array([0.5 * g.wheelbase + g.wheel_radius, 0.5 * (g.track + g.wheel_width), g.wheel_radius])
    wheels = np.array([0.0, 0.0, g.axle_height])
    return np.array([np.minimum(centre - half, wheels - reach), np.maximum(centre + half, wheels + reach)])


def spreads(robot: Robot) -> FloatArray:
    """Return the (3,) mean squared distances of the base's mass from its centre along x, y and z [m2].

    They follow from the moments of inertia; a negative one says that no body has these.
    """
    inertia = np.array(robot.masses.inertia)
    found: FloatArray = (0.5 * inertia.sum() - inertia) / robot.base_mass
    return found
