"""A drive train turns commands into set points, motor currents and the slip of tyres that give way.

A Coulomb contact pushes with all of its friction as soon as it slides at all. A tyre on grass deforms and shears the ground:
its force grows with slip, which is sliding speed over rolling speed,

    f = mu N (1 - exp(-s / s_0)),    s = |v| / (|r w| + v_c),

and reaches the friction limit only where s is several times s_0. As s_0 goes to zero this is Coulomb's law. The force of a
contact has a potential, Phi(v) = mu N (|v| - c (1 - exp(-|v| / c))) with c = s_0 (|r w| + v_c), which is convex. So a robot
that does not accelerate moves such that the sum of the four is least. There is only one such motion, and Newton's method
finds it from anywhere.

A motor's current I is its torque over the torque constant. With a wheel rate w, its voltage is proportional to w + rho I,
where rho is the resistance over the voltage constant. Two kinds of sensors are met:

- a sensor in the motor's bridge that only sees the current while the bridge drives, I (w + rho I) > 0, and has no sign;
- a sensor at the battery, which shows the electrical power over the battery's voltage, negative while braking feeds it.

The driver of a real robot takes a command after a dead time; the yaw rate saturates; both speeds move towards it no faster
than their limits; they become speeds of the two sides, which are scaled down together where one is faster than the robot may
be; a lag follows. `ssmr.robot.drive` is the same chain as part of a simulated robot, without the common limit of the two
sides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from ssmr._jit import jit_alone
from ssmr.robot.drive import ramp, saturate
from ssmr.types import FloatArray

CREEP = 0.02
"""v_c: rolling speed that is added, so that slip has a meaning at standstill [m/s]."""
_MOST_STEPS, _HALVINGS = 60, 30
_FORCE_ERROR, _ROUNDOFF = 1e-11, 4e-16
"""Errors of forces, over their limits, that are too small to matter, and of speeds that are rounding."""


class SkidGeometry(NamedTuple):
    """Four equal wheels, symmetric about the centre of mass."""

    radius: float  # rolling radius of the wheels [m]
    half_track: float  # half the distance of left and right wheels [m]
    half_base: float  # half the distance of the axles [m]


def grip(slip: FloatArray | float, scale: float) -> FloatArray:
    """Return the share of the friction limit at which a contact pushes, from 0 without slip to almost 1.

    Args:
        slip: sliding speed over rolling speed [1], not negative.
        scale: s_0, the slip at which the share is 1 - 1/e [1].
    """
    return -np.expm1(-np.asarray(slip) / scale)


def side_forces(rates: FloatArray, twist: FloatArray, geometry: SkidGeometry, scale: float) -> FloatArray:
    """Return (2, n) forward forces of the left and the right wheels, over mu N of a side [1].

    `rates` are (2, n) wheel rates [rad/s]; `twist` is (3, n) forward speed, speed to the left [m/s] and yaw rate [rad/s] of
    the middle between the wheels; `scale` is s_0 of `grip` [1].
    """
    sliding, yielding, _ = _slides(rates, twist, geometry, scale)
    speed = np.hypot(*sliding)
    force = sliding[0] * _force_over_speed(speed, yielding)
    forces: FloatArray = force[:2] + force[2:]
    return forces


def quasi_static_twist(rates: FloatArray, geometry: SkidGeometry, scale: float) -> FloatArray:
    """Return (3, n) forward speed, speed to the left [m/s] and yaw rate [rad/s] at which a robot does not accelerate.

    Its wheels turn steadily at (2, n) `rates`, left and right [rad/s]; `scale` is s_0 of `grip` [1].

    Raises:
        ValueError: the scale is not positive.
    """
    if not scale > 0.0:
        raise ValueError(f"the slip scale must be positive, got {scale}")
    _, half_track, half_base = geometry
    length = np.array([1.0, 1.0, np.hypot(half_track, half_base)])  # makes a yaw rate a speed
    spin = geometry.radius * (rates[1] - rates[0]) / (2.0 * half_track)
    twist = np.stack([geometry.radius * rates.mean(axis=0), np.zeros(rates.shape[1]), 0.5 * spin])
    value = _potential(rates, twist, geometry, scale)
    exact = _FORCE_ERROR * scale * (geometry.radius * np.abs(rates).min(axis=0) + CREEP)
    moving = np.arange(rates.shape[1])  # the motions that are still sought
    for _ in range(_MOST_STEPS):
        slope, curvature = _slope_and_curvature(rates[:, moving], twist[:, moving], geometry, scale)
        slope, curvature = slope / length[:, None], curvature / (length[:, None] * length)
        trace = np.trace(curvature, axis1=1, axis2=2)[:, None, None]  # rank 2 where all contacts slide one way
        step = -np.linalg.solve(curvature + 1e-9 * trace * np.eye(3), slope.T[:, :, None])[:, :, 0].T
        size = np.abs(step).max(axis=0)
        converged = size < np.maximum(exact[moving], _ROUNDOFF * (1.0 + np.abs(twist[:2, moving]).max(axis=0)))
        moving, slope, step = moving[~converged], slope[:, ~converged], step[:, ~converged]
        if not len(moving):
            break
        gain, share = (slope * step).sum(axis=0), np.ones(len(moving))
        for _ in range(_HALVINGS):
            trial = twist[:, moving] + share * step / length[:, None]
            new = _potential(rates[:, moving], trial, geometry, scale)
            worse = new > value[moving] + 1e-4 * share * gain + 1e-14 * (1.0 + value[moving])
            if not worse.any():
                break
            share[worse] *= 0.5
        twist[:, moving], value[moving] = np.where(worse, twist[:, moving], trial), np.where(worse, value[moving], new)
        moving = moving[~worse]  # nothing is lower any more, to rounding
    return twist


def _slides(
    rates: FloatArray, twist: FloatArray, geometry: SkidGeometry, scale: float
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Return (2, 4, n) sliding velocities of the rims over the ground, (4, n) their scales c, and the wheels' places."""
    radius, half_track, half_base = geometry
    x = half_base * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    y = half_track * np.array([1.0, -1.0, 1.0, -1.0])[:, None]
    rolling = radius * rates[[0, 1, 0, 1]]
    sliding = np.stack([rolling - (twist[0] - twist[2] * y), -(twist[1] + twist[2] * x)])
    return sliding, scale * (np.abs(rolling) + CREEP), (x, y)


def _force_over_speed(speed: FloatArray, yielding: FloatArray) -> FloatArray:
    """Return force over sliding speed, for wheels with half of a side's load [s/m]; without sliding it is finite."""
    still = speed < 1e-9 * yielding
    moving = np.where(still, yielding, speed)
    return np.where(still, 0.5 / yielding, 0.5 * grip(moving / yielding, 1.0) / moving)


def _potential(rates: FloatArray, twist: FloatArray, geometry: SkidGeometry, scale: float) -> FloatArray:
    """Return (n,) the sum of the contacts' potentials, over mu N of a side [m/s]."""
    sliding, yielding, _ = _slides(rates, twist, geometry, scale)
    speed = np.hypot(*sliding)
    total: FloatArray = (0.5 * (speed - yielding * grip(speed / yielding, 1.0))).sum(axis=0)
    return total


def _slope_and_curvature(
    rates: FloatArray, twist: FloatArray, geometry: SkidGeometry, scale: float
) -> tuple[FloatArray, FloatArray]:
    """Return the potential's (3, n) slope and (n, 3, 3) curvature over the twist."""
    sliding, yielding, (x, y) = _slides(rates, twist, geometry, scale)
    speed = np.hypot(*sliding)
    across = _force_over_speed(speed, yielding)  # stiffness across the slide; along it:
    along = 0.5 * np.exp(-speed / yielding) / yielding
    still = speed < 1e-9 * yielding
    direction = sliding / np.where(still, 1.0, speed)
    one, none = np.ones_like(speed), np.zeros_like(speed)
    arms = np.stack([np.stack([-one, none, one * y]), np.stack([none, -one, -one * x])])  # d sliding / d twist
    stiffness = across * np.eye(2)[:, :, None, None] + (along - across) * direction[:, None] * direction[None]
    slope = np.einsum("dkin,din->kn", arms, sliding * across)
    curvature = np.einsum("dkin,dein,elin->nkl", arms, stiffness, arms)
    return slope, curvature


_SHARP = 1e-6
"""A current that ripples by less does not ripple [A]."""


def bridge_reading(current: FloatArray, rate: FloatArray, rho: float, ripple: float, idle: float = 0.0) -> FloatArray:
    """Return the mean reading of a sensor that sees |I| only while the bridge drives, and `idle` [A] else.

    The current ripples about its mean with the standard deviation `ripple` [A], so that near the rule's edges it is read now
    and then. Currents [A] and wheel rates [rad/s] have any sign and shape (...); `rho` is the resistance over the voltage
    constant: the rate that an ampere costs [rad/s per A], positive.
    """
    forward = np.where(rate < 0.0, -1.0, 1.0) * current  # positive if it drives the wheel on
    regenerating = -np.abs(rate) / rho  # from here to zero the wheel drives the motor
    ahead, share_ahead = _beyond(forward, 0.0 * regenerating, ripple)
    back, share_back = _beyond(-forward, -regenerating, ripple)
    return ahead + back + idle * (1.0 - share_ahead - share_back)


def battery_current(torque: FloatArray, rate: FloatArray, voltage: FloatArray, heat: float, efficiency: float) -> FloatArray:
    """Return the current that a side draws from the battery, negative where it feeds the battery [A].

    Torques at the wheels [N m], wheel rates [rad/s] and the battery's voltages [V] are arrays (...). `heat` is the
    resistance over the square of the torque constant: power lost as heat over the torque's square [W/(N m)^2]; `efficiency`
    is the share of the power that passes the gear, either way [1].
    """
    power = torque * rate
    drawn: FloatArray = (np.where(power > 0.0, power / efficiency, power * efficiency) + heat * torque**2) / voltage
    return drawn


def battery_torque(power: FloatArray, rate: FloatArray, heat: float, efficiency: float) -> FloatArray:
    """Return the torque in the direction of the rate [N m]: the inverse of `battery_current`.

    `power` is what a side draws [W], `rate` the size of its wheels' rate [rad/s], both (...); see
    `battery_current` for the rest. Where no torque feeds so much back, it is the one that feeds
    most.
    """
    passed = rate * np.where(power > 0.0, 1.0 / efficiency, efficiency)
    root = np.sqrt(np.maximum(passed**2 + 4.0 * heat * power, 0.0))
    torque: FloatArray = 2.0 * power / np.maximum(passed + root, 1e-12)
    return torque


def _beyond(mean: FloatArray, edge: FloatArray, ripple: float) -> tuple[FloatArray, FloatArray]:
    """Return, of a normal law, the mean with nothing in place of what lies below an edge, and the share above it."""
    if ripple < _SHARP:
        share = np.where(mean > edge, 1.0, 0.0)
        return mean * share, share
    u = np.clip((mean - edge) / ripple, -30.0, 30.0)
    share = ndtr(u)
    return mean * share + ripple * np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi), share


class SetPointLaw(NamedTuple):
    """The numbers of a driver that turns commands into rim speeds."""

    dead_time: float  # time from a command to its effect [s]
    gain: float  # rim speed over commanded speed when driving straight [1]
    half_track: float  # difference of a side's rim speed from the middle's, over the commanded yaw rate [m]
    yaw_rate_limit: float  # greatest yaw rate that is obeyed [rad/s]
    acceleration: float  # greatest rate of change of the commanded speed [m/s^2]
    yaw_acceleration: float  # greatest rate of change of the commanded yaw rate [rad/s^2]
    lag: float  # time constant with which the rims follow [s]


def rim_speeds(commands: FloatArray, dt: float, law: SetPointLaw, speed_limit: float) -> FloatArray:
    """Return (n, 2) speeds of the left and the right rims [m/s] that a driver asks for, at the end of each period.

    Commands are (n, 2) speeds [m/s] and yaw rates [rad/s], each held for `dt` [s]; before the first nothing moves. No rim is
    faster than `speed_limit` [m/s].
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
