"""Sliding-mode control, the thesis' planned third controller, on the same errors and the same velocity loop.

Two surfaces in the error coordinates of the body frame:

    s_x = e_rho                            u_ref     = v_r cos e_alpha + k_x s_x + eta_x sat(s_x / phi_x)
    s_a = e_alpha + atan(lambda e_y)       omega_ref = omega_r + lambda v_r sin e_alpha / (1 + (lambda e_y)^2)
                                                       + k_a s_a + eta_a sat(s_a / phi_a)

On s_a = 0 the robot heads for the path at atan(lambda e_y), so e_y dies out over 1 / lambda of way whatever the speed. The
first terms are the equivalent control, k s the proportional reaching law, and eta sat(s / phi) the switching term, whose
boundary layer phi keeps it from chattering (J.-J. Slotine, W. Li, Applied Nonlinear Control, 1991, Sec. 7.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ssmr._jit import jit
from ssmr.control.law import Law, Memory, Observation, reader
from ssmr.control.pid import U_REF_LIMIT, VelocityGains, velocity_loop
from ssmr.control.waypoints import Errors, Target
from ssmr.parameters import packed, parameter


@dataclass(frozen=True)
class SmcGains(VelocityGains):
    """Surfaces, reaching laws, boundary layers, and the velocity loop's gains."""

    k_x: float = parameter(1.0, unit="1/s", low=0.0, high=1e6, search=(0.0, 6.0))
    """Reaching rate along the body."""
    eta_x: float = parameter(0.05, unit="m/s", low=0.0, high=1e6, search=(0.0, 0.5))
    """Switching term along the body."""
    phi_x: float = parameter(0.05, unit="m", low=0.0, high=1e6, open_low=True, search=(0.005, 0.5))
    """Boundary layer along the body."""
    slope: float = parameter(2.0, unit="rad/m", low=0.0, high=1e6, search=(0.2, 10.0))
    """lambda, slope of the surface at the path."""
    k_a: float = parameter(2.0, unit="1/s", low=0.0, high=1e6, search=(0.0, 10.0))
    """Reaching rate of the turning surface."""
    eta_a: float = parameter(0.2, unit="rad/s", low=0.0, high=1e6, search=(0.0, 2.0))
    """Switching term of the turning surface."""
    phi_a: float = parameter(0.2, unit="rad", low=0.0, high=1e6, open_low=True, search=(0.02, 1.0))
    """Boundary layer of the turning surface."""
    ff_w: float = parameter(1.0, unit="1", low=0.0, high=1e6, search=(0.0, 2.0))
    """Feedforward of omega_ref."""


@jit
def saturation(s: float, layer: float) -> float:
    """Return sat(s / layer), within -1 and 1."""
    return min(max(s / layer, -1.0), 1.0)


@jit
def slide(gains: Any, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float) -> Memory:
    """Return the memory after a step: u_ref [m/s] and omega_ref [rad/s] for the velocity loop."""
    u_ref = target.v * np.cos(errors.alpha) + gains.k_x * errors.rho + gains.eta_x * saturation(errors.rho, gains.phi_x)
    bent = gains.slope * errors.y
    surface = errors.alpha + np.arctan(bent)
    turn = target.w + gains.slope * target.v * np.sin(errors.alpha) / (1.0 + bent * bent)
    turn += gains.k_a * surface + gains.eta_a * saturation(surface, gains.phi_a)
    u_ref = min(max(u_ref, -U_REF_LIMIT), U_REF_LIMIT)
    return Memory(memory.i_rho, memory.i_y, memory.i_alpha, memory.i_u, memory.i_w, u_ref, turn)


LAW = Law(
    "smc",
    SmcGains,
    reader(packed(SmcGains())),
    slide,
    searched=("k_x", "eta_x", "phi_x", "slope", "k_a", "eta_a", "phi_a"),
    velocity_step=velocity_loop,
    population=100,
)
