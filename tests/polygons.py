"""A turn on the spot where a polygon fixed to the ground limits friction (docs/why_drift.md)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import linprog

from ssmr.robot.ground import FRONT, LEFT, SkidTurn

Limit = Literal["diamond", "square"]
"""Limit of friction over load: `diamond` is MuJoCo's |f_1| + |f_2| <= mu, `square` is ODE's |f_1|,
|f_2| <= mu."""


def polygonal_turn(
    limit: Limit, heading: float, wheelbase: float, track: float, x: float = 0.0, y: float = 0.0
) -> SkidTurn:
    """Return the turn where a polygon fixed to the ground limits friction, instead of a circle.

    Args:
        limit: kind of polygon; a square is a diamond turned by 45 degrees, and greater, of which
            the motion knows nothing.
        heading: yaw of the robot in the polygon's axes [rad].
        wheelbase: distance of the axles [m].
        track: distance of the sides [m].
        x: distance of the centre of mass ahead of the middle between the axles [m].
        y: distance of the centre of mass to the left of that middle [m].

    Returns:
        One of the motions of least dissipation: a polygon may leave the motion across free
        (docs/why_drift.md).
    """
    place_x = 0.5 * wheelbase * FRONT
    place_y = 0.5 * track * LEFT
    n = 4
    load = 0.25 * (1.0 + x * FRONT / (0.5 * wheelbase) + y * LEFT / (0.5 * track))  # equal springs
    if limit == "square":
        heading -= 0.25 * np.pi
    cos = np.cos(heading)
    sin = np.sin(heading)
    # A diamond dissipates load * max(|s_1|, |s_2|): least t with -t <= s_k <= t. Columns: v_x, v_y,
    # rate, t of every tyre.
    ones = np.ones(n)
    zeros = np.zeros(n)
    along = np.column_stack([ones, zeros, -place_y]), -LEFT
    across = np.column_stack([zeros, ones, place_x]), zeros
    rows = []
    bounds = []
    for p, q in ((cos, -sin), (sin, cos)):
        matrix = p * along[0] + q * across[0]
        offset = p * along[1] + q * across[1]
        for sign in (1.0, -1.0):
            rows.append(np.hstack([sign * matrix, -np.eye(n)]))
            bounds.append(sign * offset)
    cost = np.concatenate([np.zeros(3), load])
    solution = linprog(
        cost, np.vstack(rows), np.concatenate(bounds), bounds=[(None, None)] * 3 + [(0.0, None)] * n
    )
    v_x, v_y, rate = (float(value) for value in solution.x[:3])
    return SkidTurn(v_x, v_y, rate if rate > 1e-9 else 0.0, track, float(solution.fun))
