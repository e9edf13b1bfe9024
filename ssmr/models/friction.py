"""The dry-friction laws of the thesis as functions of numbers: Coulomb (Eq. 2.18) and improved (Eq. 2.29-2.31).

The linear model's hyperviscous friction, N K v with K = (2/pi) k_s mu, is the slope at rest of a Coulomb law whose signum is
an arctangent of steepness k_s (Eq. 2.33-2.40); it is part of that model's matrices.
"""

from __future__ import annotations

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
