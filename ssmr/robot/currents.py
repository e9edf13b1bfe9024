"""What a robot's log shows of the currents in its motors.

A motor's current I is its torque over the torque constant. With a wheel rate w, its voltage is proportional to w + rho I,
where rho is the resistance over the voltage constant. Two kinds of sensors are met:

- a sensor in the motor's bridge that only sees the current while the bridge drives, I (w + rho I) > 0, and has no sign;
- a sensor at the battery, which shows the electrical power over the battery's voltage, negative while braking feeds it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ssmr.types import FloatArray

_SHARP = 1e-6
"""A current that ripples by less does not ripple [A]."""


def bridge_reading(current: FloatArray, rate: FloatArray, rho: float, ripple: float, idle: float = 0.0) -> FloatArray:
    """Return the mean reading of a sensor that sees |I| only while the bridge drives, and `idle` else.

    The current ripples about its mean, so that near the rule's edges it is read now and then.

    Args:
        current: (...) mean motor currents, of any sign [A].
        rate: (...) wheel rates [rad/s].
        rho: resistance over voltage constant: the rate that an ampere costs [rad/s per A], positive.
        ripple: standard deviation of the current about its mean [A]; 0 for none.
        idle: mean reading while the bridge does not drive [A].
    """
    forward = np.where(rate < 0.0, -1.0, 1.0) * current  # positive if it drives the wheel on
    regenerating = -np.abs(rate) / rho  # from here to zero the wheel drives the motor
    ahead, share_ahead = _beyond(forward, 0.0 * regenerating, ripple)
    back, share_back = _beyond(-forward, -regenerating, ripple)
    return ahead + back + idle * (1.0 - share_ahead - share_back)


def battery_current(torque: FloatArray, rate: FloatArray, voltage: FloatArray, heat: float, efficiency: float) -> FloatArray:
    """Return the current that a side draws from the battery, negative where it feeds the battery [A].

    Args:
        torque: (...) torques at the wheels [N m].
        rate: (...) wheel rates [rad/s].
        voltage: (...) voltages of the battery [V].
        heat: resistance over the square of the torque constant: power lost as heat over the torque's square [W/(N m)^2].
        efficiency: share of the power that passes the gear, either way [1].
    """
    power = torque * rate
    drawn: FloatArray = (np.where(power > 0.0, power / efficiency, power * efficiency) + heat * torque**2) / voltage
    return drawn


def _beyond(mean: FloatArray, edge: FloatArray, ripple: float) -> tuple[FloatArray, FloatArray]:
    """Return, of a normal law, the mean with nothing in place of what lies below an edge, and the share above it."""
    if ripple < _SHARP:
        share = np.where(mean > edge, 1.0, 0.0)
        return mean * share, share
    u = np.clip((mean - edge) / ripple, -30.0, 30.0)
    share = ndtr(u)
    return mean * share + ripple * np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi), share
