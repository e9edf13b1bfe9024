"""The forces of wheels that turn steadily, and how sensors show the currents of their motors.

A Coulomb contact pushes with all of its friction as soon as it slides at all. A tyre on grass
deforms and shears the ground: its force grows with slip, which is sliding speed over rolling speed,

    f = mu N (1 - exp(-s / s_0)),    s = |v| / (|r w| + v_c),

and reaches the friction limit only where s is several times s_0. As s_0 goes to zero this is
Coulomb's law.

A motor's current I is its torque over the torque constant. With a wheel rate w, its voltage is
proportional to w + rho I, where rho is the resistance over the voltage constant. Two kinds of
sensors are met:

- a sensor in the motor's bridge that only sees the current while the bridge drives, I (w + rho I) >
  0,
  and has no sign;
- a sensor at the battery, which shows the electrical power over the battery's voltage, negative
  while
  braking feeds it.
"""

from __future__ import annotations

import numpy as np

from ssmr.robot.vehicle import Vehicle
from ssmr.types import FloatArray

CREEP = 0.02
"""v_c: rolling speed that is added, so that slip has a meaning at standstill [m/s]."""
_STEPS = 100  # steps towards a steady motion; with slip scales up to 0.8 fifty reach rounding
_STILL = 1e-9  # wheels that slide by less, over their scale, do not slide
_SHARP, _NOTHING = 1e-12, 1e-9  # least ripple, and what lies beyond an edge by less lies on it [A]


def grip_share(slip: FloatArray | float, scale: float) -> FloatArray:
    """Return the share of the friction limit at which a contact pushes, from 0 to almost 1.

    Args:
        slip: sliding speed over rolling speed [1], not negative.
        scale: s_0, the slip at which the share is 1 - 1/e [1].
    """
    return -np.expm1(-np.asarray(slip) / scale)


def side_forces(rates: FloatArray, vehicle: Vehicle, scale: float) -> FloatArray:
    """Return (2, n) forward forces of the left and right wheels in steady motion [1].

    They are shares of mu N of a side. The arguments are those of `_quasi_static_twist`.
    """
    twist = _quasi_static_twist(rates, vehicle, scale)
    ahead, pull = _sliding_speeds(rates, twist, vehicle, scale)
    return ahead * pull


def _quasi_static_twist(rates: FloatArray, vehicle: Vehicle, scale: float) -> FloatArray:
    """Return (3, n) forward speed, speed to the left [m/s], yaw rate [rad/s] of steady motions.

    A force of slip has a potential over the sliding velocity that is convex. A robot that does not
    accelerate moves such that the sum of the four is least, so there is one such motion. Front and
    rear wheels of a side slide alike but for the sign across, so it has no speed to the left. It is
    found by springs in place of the contacts, each as stiff as its force over its sliding speed:
    the motion that balances them comes nearer in every step, because the forces soften with speed.

    Args:
        rates: (2, n) steady rates of the left and right wheels [rad/s].
        vehicle: sizes of the robot, whose weight is in the middle.
        scale: s_0 of `grip_share` [1].

    Raises:
        ValueError: the scale is not positive.
    """
    if not scale > 0.0:
        raise ValueError(f"the slip scale must be positive, got {scale}")
    rim = vehicle.wheel_radius * rates
    track = 2.0 * vehicle.half_track
    spin = (rim[1] - rim[0]) / track  # without any slip
    still = np.zeros_like(spin)
    twist = np.stack([rim.mean(axis=0), still, 0.5 * spin])
    for _ in range(_STEPS):
        _, pull = _sliding_speeds(rates, twist, vehicle, scale)
        both = pull.sum(axis=0)
        turning = track**2 * pull.prod(axis=0) / both  # one side pulls the other round ...
        resisting = vehicle.a**2 * both  # ... and all four slide across
        yaw_rate = spin * turning / (turning + resisting)
        lever = vehicle.half_track * np.stack([yaw_rate, -yaw_rate])
        ahead = (pull * (rim + lever)).sum(axis=0) / both
        before = twist
        twist = np.stack([ahead, still, yaw_rate])
        if np.array_equal(twist, before):
            break
    return twist


def _sliding_speeds(
    rates: FloatArray, twist: FloatArray, vehicle: Vehicle, scale: float
) -> tuple[FloatArray, FloatArray]:
    """Return (2, n) speeds at which both rims slide ahead, and their force over sliding speed."""
    lever = vehicle.half_track * np.stack([twist[2], -twist[2]])
    rim = vehicle.wheel_radius * rates
    ahead = rim - twist[0] + lever
    gives = scale * (np.abs(rim) + CREEP)
    slide = np.hypot(ahead, vehicle.a * twist[2])
    slip = np.maximum(slide / gives, _STILL)
    return ahead, grip_share(slip, 1.0) / (slip * gives)


def bridge_reading(
    current: FloatArray, rate: FloatArray, rho: float, ripple: float, idle: float = 0.0
) -> FloatArray:
    """Return the mean reading of a sensor that sees |I| only while the bridge drives [A].

    It is `idle` [A] else. The current ripples about its mean with the standard deviation `ripple`
    [A], so that near the rule's edges it is read now and then. Currents [A] and wheel rates
    [rad/s] have any sign and shape (...); `rho` is the resistance over the voltage constant: the
    rate that an ampere costs [rad/s per A].
    """
    forward = np.where(rate < 0.0, -1.0, 1.0) * current  # positive if it drives the wheel
    braking = np.abs(rate) / rho  # up to this the wheel drives the motor
    ahead, share_ahead = _mean_above_edge(forward, np.zeros_like(braking), ripple)
    back, share_back = _mean_above_edge(-forward, braking, ripple)
    return ahead + back + idle * (1.0 - share_ahead - share_back)


def _mean_above_edge(
    mean: FloatArray, edge: FloatArray, ripple: float
) -> tuple[FloatArray, FloatArray]:
    """Return the mean of a normal law above an edge, times its share, and that share."""
    from scipy.special import ndtr  # here: it takes long to import

    u = np.clip((mean - edge - _NOTHING) / max(ripple, _SHARP), -30.0, 30.0)
    share = ndtr(u)
    density = np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)
    return mean * share + ripple * density, share


def battery_current(
    torque: FloatArray, rate: FloatArray, voltage: FloatArray, heat: float, efficiency: float
) -> FloatArray:
    """Return the current that a side draws from the battery, negative where it feeds it [A].

    Torques at the wheels [N m], wheel rates [rad/s] and the battery's voltages [V] are arrays
    (...). `heat` is the resistance over the square of the torque constant: power lost as heat over
    the torque's square [W/(N m)^2]; `efficiency` is the share of the power that passes the gear,
    either way [1].
    """
    power = torque * rate
    passed = np.where(power > 0.0, power / efficiency, power * efficiency)
    return (passed + heat * torque**2) / voltage


def battery_torque(
    power: FloatArray, rate: FloatArray, heat: float, efficiency: float
) -> FloatArray:
    """Return the torque in the direction of the rate [N m]: the inverse of `battery_current`.

    `power` is what a side draws [W], `rate` the size of its wheels' rate [rad/s], both (...); see
    `battery_current` for the rest. Where no torque feeds so much back, it is the one that feeds
    most.
    """
    passed = rate * np.where(power > 0.0, 1.0 / efficiency, efficiency)
    root = np.sqrt(np.maximum(passed**2 + 4.0 * heat * power, 0.0))
    return 2.0 * power / np.maximum(passed + root, 1e-12)
