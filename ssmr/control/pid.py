"""Cascade of PI blocks (Sec. 4.3.2, Fig. 4.9): position errors to reference velocities, these to commands.

The position loop (Tab. 4.1) turns e_rho into u_ref and e_y and e_alpha into omega_ref; the velocity loop (Tab. 4.2) adds a
feedforward to two more blocks. Each block is discrete, P plus a forward-Euler integral, with clamping anti-windup
(Fig. 4.8) where it has an output limit.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from ssmr._jit import jit
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray

U_REF_LIMIT = 1.0
"""Saturation of the rho-PID's output [m/s]; Tab. 4.1. The other blocks have none."""


@dataclass(frozen=True)
class PidGains:
    """Gains of the five PI blocks and of the feedforwards; the defaults are the published ones (Tab. 4.4)."""

    k_p_rho: float = 2.836
    """rho-PID, proportional [1/s]."""
    k_i_rho: float = 0.115
    """rho-PID, integral [1/s2]."""
    k_p_y: float = 5.983
    """y-PID, proportional [rad/(m s)]."""
    k_i_y: float = 1.971
    """y-PID, integral [rad/(m s2)]."""
    k_p_alpha: float = 4.507
    """alpha-PID, proportional [1/s]."""
    k_i_alpha: float = 5.276e-4
    """alpha-PID, integral [1/s2]."""
    k_p_u: float = 0.037
    """u-PID, proportional [1]."""
    k_i_u: float = 0.477
    """u-PID, integral [1/s]."""
    k_p_w: float = 0.650
    """omega-PID, proportional [1]."""
    k_i_w: float = 0.548
    """omega-PID, integral [1/s]."""
    ff_u: float = 1.0
    """Feedforward of u_ref [1]."""
    ff_w: float = 0.0
    """Feedforward of omega_ref [1]."""

    def __post_init__(self) -> None:
        """Refuse gains that are negative or not finite."""
        for name in self.__dataclass_fields__:
            require_in_range(self, name, 0.0, 1e6)

    def packed(self) -> FloatArray:
        """(12,) for the compiled loops."""
        return np.array(astuple(self), dtype=np.float64)


@jit
def pi_block(error, integral, k_p, k_i, limit, dt):
    """One PI block with clamping anti-windup (Fig. 4.8): returns output and integral.

    Integration stops while P + I exceeds the limit and integral and error have the same sign.
    """
    out = k_p * error + integral
    if abs(out) > limit and integral * error > 0.0:
        return min(max(out, -limit), limit), integral
    return min(max(out, -limit), limit), integral + k_i * error * dt


@jit
def position_loop(gains, memory, e_rho, e_y, e_alpha, dt):
    """Tab. 4.1: memory with the next integrals and u_ref [m/s], omega_ref [rad/s].

    Args:
        gains: `PidGains.packed`.
        memory: integrals of rho, y, alpha, u, omega; u_ref; omega_ref; one number that this law does not use.
        e_rho: distance to the target, less the look-ahead [m].
        e_y: to the left [m].
        e_alpha: heading error [rad].
        dt: period of the loop [s].
    """
    u_ref, i_rho = pi_block(e_rho, memory[0], gains[0], gains[1], U_REF_LIMIT, dt)
    w_y, i_y = pi_block(e_y, memory[1], gains[2], gains[3], np.inf, dt)
    w_alpha, i_alpha = pi_block(e_alpha, memory[2], gains[4], gains[5], np.inf, dt)
    return i_rho, i_y, i_alpha, memory[3], memory[4], u_ref, w_y + w_alpha, memory[7]


@jit
def velocity_loop(gains, offset, memory, v, w, dt):
    """Tab. 4.2: memory with the next integrals, and the command u_cmd [m/s], omega_cmd [rad/s].

    Args:
        gains: holds K_Pu, K_Iu, K_Pomega, K_Iomega, FF_u, FF_omega from `offset` on.
        offset: where they begin.
        memory: as in `position_loop`.
        v: measured speed [m/s].
        w: measured yaw rate [rad/s].
        dt: period of the loop [s].
    """
    u_ref, w_ref = memory[5], memory[6]
    u, i_u = pi_block(u_ref - v, memory[3], gains[offset], gains[offset + 1], np.inf, dt)
    turn, i_w = pi_block(w_ref - w, memory[4], gains[offset + 2], gains[offset + 3], np.inf, dt)
    held = (memory[0], memory[1], memory[2], i_u, i_w, u_ref, w_ref, memory[7])
    return held, u + gains[offset + 4] * u_ref, turn + gains[offset + 5] * w_ref
