"""Cascade of PI blocks (Sec. 4.3.2, Fig. 4.9) from position errors to commands.

The position loop (Tab. 4.1) turns e_rho into u_ref and e_y and e_alpha into omega_ref; the velocity
loop (Tab. 4.2) adds a feedforward to two more blocks. Each block is discrete, P plus a
forward-Euler integral, with clamping anti-windup (Fig. 4.8) where it has an output limit. The
published search bounds are those of Tab. 4.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr._jit import jit, named_like
from ssmr.control.law import SPOT_TURN, Command, Gains, Law, Memory, Observation
from ssmr.control.waypoints import Errors, Target
from ssmr.parameters import pack_numbers, parameter
from ssmr.types import FloatArray

_U_REF_LIMIT = 1.0
"""Saturation of the rho-PID's output [m/s]; Tab. 4.1. The other blocks have none."""


@dataclass(frozen=True)
class PidGains(Gains):
    """Gains of the five PI blocks and the feedforwards, as published (Tab. 4.4) by default."""

    k_p_u: float = parameter(0.037, unit="1", low=0.0, high=1e6, search=(0.0, 2.0))
    """u-PID, proportional."""
    k_i_u: float = parameter(0.477, unit="1/s", low=0.0, high=1e6, search=(0.0, 2.0))
    """u-PID, integral."""
    k_p_w: float = parameter(0.650, unit="1", low=0.0, high=1e6, search=(0.0, 2.0))
    """omega-PID, proportional."""
    k_i_w: float = parameter(0.548, unit="1/s", low=0.0, high=1e6, search=(0.0, 2.0))
    """omega-PID, integral."""
    ff_u: float = parameter(1.0, unit="1", low=0.0, high=1e6, search=(0.0, 2.0))
    """Feedforward of u_ref."""
    ff_w: float = parameter(0.0, unit="1", low=0.0, high=1e6, search=(0.0, 2.0))
    """Feedforward of omega_ref."""
    k_p_rho: float = parameter(2.836, unit="1/s", low=0.0, high=1e6, search=(0.0, 6.0))
    """rho-PID, proportional."""
    k_i_rho: float = parameter(0.115, unit="1/s2", low=0.0, high=1e6, search=(0.0, 2.0))
    """rho-PID, integral."""
    k_p_y: float = parameter(5.983, unit="rad/(m s)", low=0.0, high=1e6, search=(0.0, 6.0))
    """y-PID, proportional."""
    k_i_y: float = parameter(1.971, unit="rad/(m s2)", low=0.0, high=1e6, search=(0.0, 2.0))
    """y-PID, integral."""
    k_p_alpha: float = parameter(4.507, unit="1/s", low=0.0, high=1e6, search=(0.0, 6.0))
    """alpha-PID, proportional."""
    k_i_alpha: float = parameter(5.276e-4, unit="1/s2", low=0.0, high=1e6, search=(0.0, 2.0))
    """alpha-PID, integral."""


_GAINS = pack_numbers(PidGains())
"""Template for `named_like`."""


@jit
def _pi_block(
    error: float, integral: float, k_p: float, k_i: float, limit: float, dt: float
) -> tuple[float, float]:
    """Return output and integral of one PI block with clamping anti-windup (Fig. 4.8).

    Integration stops while P + I exceeds the limit and integral and error have the same sign.
    """
    out = k_p * error + integral
    saturated = min(max(out, -limit), limit)
    if abs(out) > limit and integral * error > 0.0:
        return saturated, integral
    return saturated, integral + k_i * error * dt


@jit
def _position_loop(
    row: FloatArray, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float
) -> Memory:
    """Return the memory after a step of Tab. 4.1: integrals, u_ref [m/s] and omega_ref [rad/s]."""
    gains = named_like(_GAINS, row)
    k_p = gains.k_p_rho
    k_i = gains.k_i_rho
    u_ref, i_rho = _pi_block(errors.rho, memory.i_rho, k_p, k_i, _U_REF_LIMIT, dt)
    w_y, i_y = _pi_block(errors.y, memory.i_y, gains.k_p_y, gains.k_i_y, np.inf, dt)
    k_p = gains.k_p_alpha
    k_i = gains.k_i_alpha
    w_alpha, i_alpha = _pi_block(errors.alpha, memory.i_alpha, k_p, k_i, np.inf, dt)
    return Memory(
        i_rho=i_rho,
        i_y=i_y,
        i_alpha=i_alpha,
        i_u=memory.i_u,
        i_w=memory.i_w,
        u_ref=u_ref,
        w_ref=w_y + w_alpha,
    )


@jit
def _velocity_loop(
    row: FloatArray, memory: Memory, seen: Observation, dt: float
) -> tuple[Memory, Command]:
    """Return the memory and the command after a step of Tab. 4.2."""
    gains = named_like(_GAINS, row)
    u_ref = memory.u_ref
    w_ref = memory.w_ref
    error_u = u_ref - seen.v
    error_w = w_ref - seen.w
    u, i_u = _pi_block(error_u, memory.i_u, gains.k_p_u, gains.k_i_u, np.inf, dt)
    w, i_w = _pi_block(error_w, memory.i_w, gains.k_p_w, gains.k_i_w, np.inf, dt)
    after = Memory(
        i_rho=memory.i_rho,
        i_y=memory.i_y,
        i_alpha=memory.i_alpha,
        i_u=i_u,
        i_w=i_w,
        u_ref=u_ref,
        w_ref=w_ref,
    )
    return after, Command(u + gains.ff_u * u_ref, w + gains.ff_w * w_ref)


LAW = Law(
    "pid",
    PidGains,
    _position_loop,
    searched=(
        *("k_p_rho", "k_p_y", "k_p_alpha", "k_i_rho", "k_i_y", "k_i_alpha"),
        *("k_p_u", "k_i_u", "k_p_w", "k_i_w"),
    ),
    velocity_step=_velocity_loop,
    population=100,
    manoeuvres=(SPOT_TURN,),
)
