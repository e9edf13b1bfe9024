"""Measures of a robot that follows a reference: how far off the path it came, and how much its commands cost."""

from __future__ import annotations

import math

import numpy as np

from ssmr._jit import jit_alone
from ssmr.types import FloatArray


@jit_alone
def cross_track_max(xy: FloatArray, path: FloatArray, along: FloatArray, aims: FloatArray, reach: float) -> float:
    """Return the greatest distance of a robot from the path beside its target [m]; zero where there are no samples.

    The path is the polyline of the waypoints. Of a path that crosses itself only the part near the target counts, so a robot
    that drives on another branch is not on its way.

    Args:
        xy: (M, 2) or wider, places of the robot [m].
        path: (N, 2) waypoints [m].
        along: (N,) length of the path up to each waypoint [m].
        aims: (M,) length of the path up to the target of each sample, never decreasing [m].
        reach: length of the path before and behind the target that is searched [m].
    """
    greatest, first, last = 0.0, 0, len(path) - 2
    for i in range(len(xy)):
        while first < last and along[first + 1] < aims[i] - reach:
            first += 1
        least, k = math.inf, first
        while k <= last and (along[k] <= aims[i] + reach or k == first):
            step_x, step_y = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
            off_x, off_y = xy[i, 0] - path[k, 0], xy[i, 1] - path[k, 1]
            square = step_x * step_x + step_y * step_y
            share = min(max((off_x * step_x + off_y * step_y) / square, 0.0), 1.0) if square > 0.0 else 0.0
            least = min(least, (off_x - share * step_x) ** 2 + (off_y - share * step_y) ** 2)
            k += 1
        greatest = max(greatest, least)
    return math.sqrt(greatest)


def command_measures(shares: FloatArray, period: float) -> tuple[float, float]:
    """Return effort [1] and jerk [1/s2] of a row of commands.

    The effort is the root mean square of the commands as shares of their limits; the jerk is that of their second derivative
    in time, by differences: zero for commands that grow evenly. Both add the squares of the two parts of a command.

    Args:
        shares: (K, 2) commands as shares of the limits of speed and yaw rate.
        period: time between commands [s].
    """
    if len(shares) == 0:
        return math.nan, math.nan
    bends = np.diff(shares, 2, axis=0) / period**2
    jerk = math.sqrt(float(np.mean(np.sum(bends**2, axis=1)))) if len(bends) else 0.0
    return math.sqrt(float(np.mean(np.sum(shares**2, axis=1)))), jerk
