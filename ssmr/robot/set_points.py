"""What the driver of a real skid-steering robot makes of a command before its motors see it.

The command is taken after a dead time; the yaw rate saturates; both speeds move towards it no faster than their limits; they
become speeds of the two sides, which are scaled down together where one is faster than the robot may be; a lag follows.
`ssmr.robot.drive` is the same chain as part of a simulated robot, without the common limit of the two sides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssmr._jit import jit_alone
from ssmr.robot.drive import ramp, saturate
from ssmr.types import FloatArray


class SetPointLaw(NamedTuple):
    """The numbers of a driver that turns commands into rim speeds."""

    dead_time: float
    """Time from a command to its effect [s]."""
    gain: float
    """Rim speed over commanded speed when driving straight [1]."""
    half_track: float
    """Difference of a side's rim speed from the middle's, over the commanded yaw rate [m]."""
    yaw_rate_limit: float
    """Greatest yaw rate that is obeyed [rad/s]."""
    acceleration: float
    """Greatest rate of change of the commanded speed [m/s^2]."""
    yaw_acceleration: float
    """Greatest rate of change of the commanded yaw rate [rad/s^2]."""
    lag: float
    """Time constant with which the rims follow [s]."""


def rim_speeds(commands: FloatArray, dt: float, law: SetPointLaw, speed_limit: float) -> FloatArray:
    """Return the rim speeds that a driver asks for.

    Args:
        commands: (n, 2) speeds [m/s] and yaw rates [rad/s], each held for `dt`; before the first nothing moves.
        dt: period of the commands [s].
        law: the driver.
        speed_limit: greatest rim speed [m/s].

    Returns:
        (n, 2) speeds of the left and the right rims [m/s], at the end of each period.
    """
    out = np.empty_like(commands)
    _fill(np.ascontiguousarray(commands, dtype=np.float64), dt, SetPointLaw(*map(float, law)), speed_limit, out)
    return out


@jit_alone
def _fill(commands: FloatArray, dt: float, law: SetPointLaw, speed_limit: float, out: FloatArray) -> None:
    v, w, left, right = 0.0, 0.0, 0.0, 0.0
    share = 1.0 - math.exp(-dt / law.lag) if law.lag > 0.0 else 1.0
    late = law.dead_time / dt
    whole = math.floor(late)
    part = late - whole  # share of a period in which the command before still holds
    for k in range(len(commands)):
        now, before = k - whole, k - whole - 1
        for piece in range(2):
            source, span = (before, part) if piece == 0 else (now, 1.0 - part)
            wanted_v = commands[source, 0] if source >= 0 else 0.0
            wanted_w = saturate(commands[source, 1], law.yaw_rate_limit) if source >= 0 else 0.0
            v = ramp(v, law.gain * wanted_v, law.gain * law.acceleration * dt * span)
            w = ramp(w, wanted_w, law.yaw_acceleration * dt * span)
        wanted_left, wanted_right = v - law.half_track * w, v + law.half_track * w
        fastest = max(abs(wanted_left), abs(wanted_right))
        scale = speed_limit / fastest if fastest > speed_limit else 1.0
        left += share * (scale * wanted_left - left)
        right += share * (scale * wanted_right - right)
        out[k, 0], out[k, 1] = left, right
