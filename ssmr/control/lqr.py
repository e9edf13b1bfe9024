"""Linear quadratic regulator on the linear model (Sec. 4.4.2, Fig. 4.26): one loop, integral action on e_rho.

The gain K of u = -K x belongs to the model of Eq. 2.46 with Q and R diagonal; e_rho with its integral stands for the error
of x, e_theta = K_alpha e_alpha + K_y e_y for that of theta, and the speeds are fed back as they are.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import control
import numpy as np

from ssmr._jit import jit
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray

V_LIMIT = 1.0
"""Saturation of the linear velocity command [m/s]; "the vehicle maximum input limits" (Sec. 4.4.2)."""
W_LIMIT = 2.0
"""Saturation of the yaw-rate command [rad/s]."""


@dataclass(frozen=True)
class LqrGains:
    """Weights and the gains set beside them; the defaults are those of the optimised column of Tab. 4.21."""

    q_x: float = 4.06
    """Q_11, of the error of position [1/m2]."""
    q_v: float = 0.02
    """Q_22, of speed [s2/m2]."""
    q_yaw: float = 10.48
    """Q_33, of the error of heading [1/rad2]."""
    q_w: float = 0.0
    """Q_44, of yaw rate [s2/rad2]."""
    r_v: float = 0.44
    """R_11, of the speed command [s2/m2]."""
    r_w: float = 0.76
    """R_22, of the yaw-rate command [s2/rad2]."""
    k_alpha: float = 1.0
    """K_alpha, weight of e_alpha in e_theta [1]."""
    k_y: float = 0.9
    """K_y, weight of e_y in e_theta [rad/m]."""
    k_i_rho: float = 0.01
    """K_Irho, integral action on e_rho [1/s]."""

    def __post_init__(self) -> None:
        """Refuse weights for which no regulator exists: R positive; Q not negative, of position and heading positive."""
        for name in self.__dataclass_fields__:
            require_in_range(self, name, 0.0, 1e6, open_low=name in ("q_x", "q_yaw", "r_v", "r_w"))

    def packed(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(11,) for the compiled loops: K row by row, K_alpha, K_y, K_Irho.

        Args:
            a: (4, 4) of Eq. 2.46.
            b: (4, 2) of Eq. 2.46.

        Raises:
            ValueError: no regulator exists for this model.
        """
        q = np.diag([self.q_x, self.q_v, self.q_yaw, self.q_w])
        try:
            k, _, _ = control.lqr(a, b, q, np.diag([self.r_v, self.r_w]))
        except (np.linalg.LinAlgError, control.ControlArgument) as error:
            raise ValueError(f"no regulator for these weights: {error}") from error
        return np.array([*np.asarray(k).ravel(), *astuple(self)[6:]], dtype=np.float64)


@jit
def clamp_integral(error, integral, out, limit, k_i, dt):
    """The integral after a step; it stops while the output is at its limit and both have the same sign (Fig. 4.8)."""
    if abs(out) > limit and integral * error > 0.0:
        return integral
    return integral + k_i * error * dt


@jit
def regulate(gains, memory, e_rho, e_y, e_alpha, v, w, dt):
    """One step: memory with the next integral and the command, v_cmd [m/s] and omega_cmd [rad/s].

    Args:
        gains: `LqrGains.packed`.
        memory: integral of e_rho; four numbers not used; the command; one number not used.
        e_rho: distance to the target, less the look-ahead [m].
        e_y: to the left [m].
        e_alpha: heading error [rad].
        v: measured speed [m/s].
        w: measured yaw rate [rad/s].
        dt: period of the loop [s].
    """
    x, theta = e_rho + memory[0], gains[8] * e_alpha + gains[9] * e_y
    v_cmd = gains[0] * x - gains[1] * v + gains[2] * theta - gains[3] * w
    w_cmd = gains[4] * x - gains[5] * v + gains[6] * theta - gains[7] * w
    integral = clamp_integral(e_rho, memory[0], v_cmd, V_LIMIT, gains[10], dt)
    v_cmd, w_cmd = min(max(v_cmd, -V_LIMIT), V_LIMIT), min(max(w_cmd, -W_LIMIT), W_LIMIT)
    return integral, memory[1], memory[2], memory[3], memory[4], v_cmd, w_cmd, memory[7]
