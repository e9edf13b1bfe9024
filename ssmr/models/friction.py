"""The friction laws of the thesis as functions of numbers. Each returns what resists, with the sign that opposes motion.

Coulomb (Eq. 2.18) and improved dry friction (Eq. 2.29-2.31) for the nonlinear models, hyperviscous (Eq. 2.33-2.40) for the
linear one.
"""

from __future__ import annotations

import math

from ssmr._jit import jit


@jit
def sign(x):
    """-1, 0 or 1."""
    if x > 0.0:
        return 1.0
    if x < 0.0:
        return -1.0
    return 0.0


@jit
def coulomb(coefficient, load, v):
    """Friction force [N] of a load [N] at sliding speed v, to be subtracted: mu N sgn(v) (Eq. 2.18 with N_i for mg)."""
    return coefficient * load * sign(v)


@jit
def improved(active, static, dynamic, v):
    """Friction force or torque to be ADDED to the active one (Eq. 2.29, with -FDJ sgn(v) where -FDJ is printed).

    Args:
        active: force or torque that friction opposes.
        static: FSJ, greatest stiction.
        dynamic: FDJ, friction in motion.
        v: velocity, exactly 0 at standstill.
    """
    if v == 0.0:
        if abs(active) <= static:
            return -active
        return -sign(active) * static
    return -sign(v) * dynamic


@jit
def stop_at_zero_crossing(v_next, v):
    """Zero-crossing detection (Eq. 2.31): a velocity that changed sign within a step stops at 0.

    Strictly less than zero: with `<=`, as printed, a robot at rest would never start.
    """
    if v_next < 0.0 < v or v < 0.0 < v_next:  # not v_next * v < 0: a product of tiny numbers is 0
        return 0.0
    return v_next


@jit
def hyperviscous(coefficient, load, v):
    """Friction force [N] of the linear model, to be subtracted: N K v (Eq. 2.40)."""
    return load * coefficient * v


@jit
def smoothed_sign(x, steepness):
    """(2/pi) arctan(k_s x), the arctangent in place of the signum (Eq. 2.33)."""
    return 2.0 / math.pi * math.atan(steepness * x)


def hyperviscous_coefficient(steepness: float, friction: float) -> float:
    """K = (2/pi) k_s mu [s/m]: slope at rest of the smoothed Coulomb law (Eq. 2.39, 2.40)."""
    return 2.0 / math.pi * steepness * friction
