"""The friction laws of the thesis, and the force of a tyre of brushes, as functions of numbers.

The laws of the thesis are Coulomb friction (Eq. 2.18), which is `sign_of` times friction and load,
its smooth form with an arctangent (Eq. 2.33-2.35), and the improved dry friction (Eq. 2.29-2.31).
The arctangent's line about rest, called hyperviscous (Eq. 2.39, 2.40), is the friction of the
linear model, which has it in its matrices.

The force of a tyre grows with slip until all of its contact slides, and it needs some way to build
up: the brush model with a parabolic pressure (H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed.
2012, Ch. 3.2). Where the stiffness differs along and across the wheel, the part of the contact that
grips pulls as the brushes are bent, and the part that slides pulls against the slip (J. Svendenius,
M. Gafvert, "A brush-model based semi-empirical tire-model for combined slips", SAE 2004-01-1064).
The slip that this law sees is the bend of the brushes over the relaxation length, which rolling
lets fade and sliding over the ground renews (Pacejka, Ch. 7 and 8); so a wheel that stands holds
like a spring, and no speed stands in a denominator. docs/four_wheel.md derives all of this.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ssmr._jit import jit


@jit
def sign_of(x: float) -> float:
    """Return -1, 0 or 1."""
    if x > 0.0:
        return 1.0
    if x < 0.0:
        return -1.0
    return 0.0


@jit
def improved_friction(active: float, static: float, dynamic: float, v: float) -> float:
    """Return the friction force or torque to be ADDED to the active one.

    Eq. 2.29, with -FDJ sgn(v) where -FDJ is printed. It is that of the time that follows: a force
    that stiction cannot hold at standstill moves the body at once, and FDJ resists it. FSJ would be
    the friction of one instant, and of a whole step that begins there.

    Args:
        active: force or torque that friction opposes.
        static: FSJ, the greatest stiction.
        dynamic: FDJ, the friction in motion.
        v: velocity, exactly 0 at standstill.
    """
    if v == 0.0 and abs(active) <= static:
        return -active
    way = active if v == 0.0 else v
    return dynamic if way < 0.0 else -dynamic


@jit
def stop_at_zero_crossing(v_next: float, v: float) -> float:
    """Return v_next, or 0 where the velocity changed sign within the step.

    This is zero-crossing detection (Eq. 2.31). Strictly less than zero: with `<=`, as printed, a
    robot at rest would never start.
    """
    if v_next < 0.0 < v or v < 0.0 < v_next:  # not v_next * v < 0: a product of tiny numbers is 0
        return 0.0
    return v_next


class Tyre(NamedTuple):
    """Numbers of a tyre, for compiled functions."""

    friction: float  # mu [1]
    along: float  # C_x, longitudinal force over load and slip at little slip [1]
    across: float  # C_y, likewise across [1]
    relaxation: float  # sigma, way in which the force builds up [m]
    damping: float  # time by which the slip velocity leads in the bend of a wheel that stands [s]


class AlongAcross(NamedTuple):
    """A vector along and across a wheel."""

    x: float
    y: float


@jit
def _bent_share(slip: AlongAcross, tyre: Tyre) -> float:
    """Return z, the share of the contact that slides [1]; 1 and more where all of it does."""
    return math.hypot(tyre.along * slip.x, tyre.across * slip.y) / (3.0 * tyre.friction)


@jit
def tyre_force(slip: AlongAcross, load: float, tyre: Tyre) -> AlongAcross:
    """Return the force of the ground on a tyre [N] of a load [N].

    `slip` is sliding over rolling speed [1]. The size of the force never exceeds friction times
    load, and it never points along the slip.
    """
    size = math.hypot(slip.x, slip.y)
    if size == 0.0:
        return AlongAcross(0.0, 0.0)
    z = min(_bent_share(slip, tyre), 1.0)
    gripping = (1.0 - z) * (1.0 - z)
    sliding = tyre.friction * z * z * (3.0 - 2.0 * z) / size
    along = gripping * tyre.along + sliding
    across = gripping * tyre.across + sliding
    return AlongAcross(-load * along * slip.x, -load * across * slip.y)


@jit
def _limit_slip(slip: AlongAcross, tyre: Tyre) -> AlongAcross:
    """Return a slip shortened to the greatest at which a part of the contact grips.

    Brushes bend no further.
    """
    z = _bent_share(slip, tyre)
    return AlongAcross(slip.x / z, slip.y / z) if z > 1.0 else slip


@jit
def bend_brushes(
    slip: AlongAcross, sliding: AlongAcross, rolling: float, dt: float, tyre: Tyre
) -> AlongAcross:
    """Return the bend of the brushes over the relaxation length after a step `dt` [s].

    It is exact for constant speeds: `slip` is the bend at the start [1], `sliding` the velocity of
    the rim over the ground where they touch, `rolling` the speed of the rim about the axle [m/s].
    """
    # rate at which rolling replaces bent brushes by straight ones [1/s]
    rate = abs(rolling) / tyre.relaxation
    fading = -math.expm1(-rate * dt)
    lasting = fading / rate if rate * dt > 1e-9 else dt
    grown = lasting * (1.0 - rate * _damping_time(rate, tyre)) / tyre.relaxation
    kept = 1.0 - fading
    x = kept * slip.x + grown * sliding.x
    y = kept * slip.y + grown * sliding.y
    return _limit_slip(AlongAcross(x, y), tyre)


@jit
def _damping_time(rate: float, tyre: Tyre) -> float:
    """Return the time by which the slip velocity leads [s].

    Fast rolling leaves no time for damping.
    """
    return tyre.damping if rate * tyre.damping < 1.0 else 1.0 / rate


@jit
def felt_slip(slip: AlongAcross, sliding: AlongAcross, rolling: float, tyre: Tyre) -> AlongAcross:
    """Return the slip that the force belongs to [1]: the bend and its damping.

    In steady rolling it is sliding over rolling speed, whatever the damping.
    """
    lead = _damping_time(abs(rolling) / tyre.relaxation, tyre) / tyre.relaxation
    return AlongAcross(slip.x + lead * sliding.x, slip.y + lead * sliding.y)


@jit
def steady_bend(sliding: AlongAcross, rolling: float, tyre: Tyre) -> AlongAcross:
    """Return the bend in steady motion [1].

    That of a wheel that slides without rolling is the greatest.
    """
    speed = math.hypot(sliding.x, sliding.y)
    if speed == 0.0:
        return AlongAcross(0.0, 0.0)
    stretch = 1.0 / max(abs(rolling), 1e-9 * speed)
    lead = _damping_time(abs(rolling) / tyre.relaxation, tyre) / tyre.relaxation
    steady = stretch - lead
    return _limit_slip(AlongAcross(steady * sliding.x, steady * sliding.y), tyre)
