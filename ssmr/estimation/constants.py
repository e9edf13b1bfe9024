"""A filter that learns turns its constants into the speed at which the robot moves, and into what the wheels should show."""

from __future__ import annotations

from ssmr._jit import jit
from ssmr.estimation.settings import LEFT, RIGHT, SHIFT, TURNING, V, W
from ssmr.types import FloatArray


@jit
def weighed(weights: FloatArray, values: FloatArray) -> float:
    """Return the sum of the states' values from v on, each times its weight."""
    total = 0.0
    for i in range(V, len(weights)):
        total += float(weights[i] * values[i])
    return total


@jit
def forward_speed(m: FloatArray, h: float, row: FloatArray) -> float:
    """Return the forward speed [m/s] of the mean of a filter that learns; write its derivative by the state into `row`.

    The state v is the odometry's, k (v - y omega) + d h c omega / k, with k the mean of both scales, d half of right less
    left, y the shift, c the turning ratio and h the driver's half-track. What the wheels say of it is then linear. Were the
    true speed a state, a product of two unknowns would be measured, and the filter would believe that it learns k.
    """
    both, uneven = 0.5 * (m[LEFT] + m[RIGHT]), 0.5 * (m[RIGHT] - m[LEFT])
    turned = h * m[TURNING] * m[W] / both
    by_both, by_uneven = (2.0 * uneven * turned / both - m[V] / both) / both, -turned / both
    row[:] = 0.0
    row[V], row[TURNING] = 1.0 / both, -uneven * h * m[W] / (both * both)
    row[W], row[SHIFT] = m[SHIFT] - uneven * h * m[TURNING] / (both * both), m[W]
    row[LEFT], row[RIGHT] = 0.5 * (by_both - by_uneven), 0.5 * (by_both + by_uneven)
    return float((m[V] - uneven * turned) / both + m[SHIFT] * m[W])


@jit
def wheel_yaw_rate(m: FloatArray, h: float, row: FloatArray) -> float:
    """Return the yaw rate [rad/s] that the odometry should show by the mean of a filter that learns.

    This is d (v - y omega) / h + c omega; see `forward_speed`. Its derivative is written into `row`.
    """
    uneven = 0.5 * (m[RIGHT] - m[LEFT]) / h
    ahead = forward_speed(m, h, row) - m[SHIFT] * m[W]
    row[W] -= m[SHIFT]
    row[SHIFT] = 0.0
    for i in range(V, len(row)):
        row[i] *= uneven
    row[W] += m[TURNING]
    row[TURNING] += m[W]
    row[LEFT] -= 0.5 * ahead / h
    row[RIGHT] += 0.5 * ahead / h
    return float(uneven * ahead + m[TURNING] * m[W])
