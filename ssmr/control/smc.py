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

from dataclasses import astuple, dataclass

import numpy as np

from ssmr._jit import jit
from ssmr.control.pid import U_REF_LIMIT
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray

VELOCITY_LOOP = 7
"""Where the velocity loop's gains begin in the packed ones."""


@dataclass(frozen=True)
class SmcGains:
    """Surfaces, reaching laws, boundary layers, and the velocity loop's gains."""

    k_x: float = 1.0
    """Reaching rate along the body [1/s]."""
    eta_x: float = 0.05
    """Switching term along the body [m/s]."""
    phi_x: float = 0.05
    """Boundary layer along the body [m]."""
    slope: float = 2.0
    """lambda, slope of the surface at the path [rad/m]."""
    k_a: float = 2.0
    """Reaching rate of the turning surface [1/s]."""
    eta_a: float = 0.2
    """Switching term of the turning surface [rad/s]."""
    phi_a: float = 0.2
    """Boundary layer of the turning surface [rad]."""
    k_p_u: float = 0.037
    """u-PID, proportional [1]; this and the next five as `PidGains`."""
    k_i_u: float = 0.477
    """u-PID, integral [1/s]."""
    k_p_w: float = 0.650
    """omega-PID, proportional [1]."""
    k_i_w: float = 0.548
    """omega-PID, integral [1/s]."""
    ff_u: float = 1.0
    """Feedforward of u_ref [1]."""
    ff_w: float = 1.0
    """Feedforward of omega_ref [1]."""

    def __post_init__(self) -> None:
        """Refuse what is negative or not finite, and boundary layers of no width."""
        for name in self.__dataclass_fields__:
            require_in_range(self, name, 0.0, 1e6, open_low=name in ("phi_x", "phi_a"))

    def packed(self) -> FloatArray:
        """(13,) for the compiled loops."""
        return np.array(astuple(self), dtype=np.float64)


@jit
def slide(gains, memory, e_rho, e_y, e_alpha, v_ref, w_ref):
    """One step: memory with u_ref [m/s] and omega_ref [rad/s]; arguments as in `scheduled.regulate`."""
    u_ref = v_ref * np.cos(e_alpha) + gains[0] * e_rho + gains[1] * min(max(e_rho / gains[2], -1.0), 1.0)
    bent = gains[3] * e_y
    surface = e_alpha + np.arctan(bent)
    turn = w_ref + gains[3] * v_ref * np.sin(e_alpha) / (1.0 + bent * bent)
    turn += gains[4] * surface + gains[5] * min(max(surface / gains[6], -1.0), 1.0)
    u_ref = min(max(u_ref, -U_REF_LIMIT), U_REF_LIMIT)
    return memory[0], memory[1], memory[2], memory[3], memory[4], u_ref, turn, memory[7]
