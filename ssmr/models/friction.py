"""The friction laws of the thesis as functions of numbers.

They are Coulomb friction (Eq. 2.18), its smooth form with an arctangent (Eq. 2.33-2.38), the line of that about rest, called
hyperviscous (Eq. 2.39, 2.40), and the improved dry friction (Eq. 2.29-2.31). The linear model has the hyperviscous law in
its matrices, with the coefficients K = (2/pi) k_s mu as free parameters.
"""

from __future__ import annotations

import math

from ssmr._jit import jit


@jit
def sign(x: float) -> float:
    """Return -1, 0 or 1."""
    if x > 0.0:
        return 1.0
    if x < 0.0:
        return -1.0
    return 0.0


@jit
def coulomb_friction(coefficient: float, load: float, v: float) -> float:
    """Return the friction force [N] of a load [N] at sliding speed v, to be subtracted: mu N sgn(v) (Eq. 2.18)."""
    return coefficient * load * sign(v)


@jit
def arctangent_friction(coefficient: float, load: float, v: float, steepness: float) -> float:
    """Return the friction force [N] with sgn(v) as (2/pi) arctan(k_s v), to be subtracted (Eq. 2.33, 2.35).

    It tends to `coulomb_friction` as the steepness k_s [s/m] grows (Eq. 2.34). It has no stiction: its force at rest is 0.
    """
    return coefficient * load * (2.0 / math.pi) * math.atan(steepness * v)


@jit
def arctangent_slope(coefficient: float, load: float, v: float, steepness: float) -> float:
    """Return the derivative of `arctangent_friction` with respect to v [N s/m] (Eq. 2.38)."""
    return coefficient * load * (2.0 / math.pi) * steepness / (1.0 + (steepness * v) * (steepness * v))


@jit
def hyperviscous_friction(coefficient: float, load: float, v: float, steepness: float) -> float:
    """Return the force of the arctangent's line about rest [N], to be subtracted: (2/pi) k_s mu N v (Eq. 2.39)."""
    return arctangent_slope(coefficient, load, 0.0, steepness) * v


@jit
def implied_steepness(viscous: float, coefficient: float) -> float:
    """Return the k_s [s/m] at which a hyperviscous coefficient [s/m] is the slope of Coulomb friction at rest (Eq. 2.40)."""
    return 0.5 * math.pi * viscous / coefficient


@jit
def improved_friction(active: float, static: float, dynamic: float, v: float) -> float:
    """Return the friction force or torque to be ADDED to the active one (Eq. 2.29, with -FDJ sgn(v) where -FDJ is printed).

    Args:
        active: force or torque that friction opposes.
        static: FSJ, the greatest stiction.
        dynamic: FDJ, the friction in motion.
        v: velocity, exactly 0 at standstill.
    """
    if v == 0.0:
        if abs(active) <= static:
            return -active
        return -sign(active) * static
    return -sign(v) * dynamic


@jit
def stop_at_zero_crossing(v_next: float, v: float) -> float:
    """Return v_next, or 0 where the velocity changed sign within the step: zero-crossing detection (Eq. 2.31).

    Strictly less than zero: with `<=`, as printed, a robot at rest would never start.
    """
    if v_next < 0.0 < v or v < 0.0 < v_next:  # not v_next * v < 0: a product of tiny numbers is 0
        return 0.0
    return v_next
