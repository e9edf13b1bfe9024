"""Gain-scheduled LQR: the error dynamics linearised about the operating speed, which the thesis leaves as future work.

Errors in the body frame of a robot that follows a target moving at (v_r, omega_r), about v = v_r, omega = omega_r:

    d e_rho / dt   = v_r cos e_alpha - v + omega e_y      ~ -(v - v_r)
    d e_y / dt     = v_r sin e_alpha - omega e_rho        ~ v_r e_alpha
    d e_alpha / dt = omega_r - omega

with speed and yaw rate by the linear model (Eq. 2.46). The lateral part depends on v_r: at rest e_y is out of reach, and
one gain for all speeds is either sluggish or nervous. K_y and K_alpha, set by hand in the thesis, come out of the Riccati
equation. Feedforward holds (v_r, omega_r) where the errors are zero; an integral of e_rho takes what the model leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np

from ssmr._jit import jit
from ssmr.control.lqr import V_LIMIT, W_LIMIT, clamp_integral
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray

SPEEDS = tuple(float(v) for v in np.linspace(0.1, 1.0, 10))
"""Operating speeds for which gains are computed [m/s]; between them they are interpolated, below the first it holds."""
_HEAD = 3  # numbers in front of the table
_ROW = 5


@dataclass(frozen=True)
class ScheduledGains:
    """Weights of the regulator, the same at all speeds."""

    q_x: float = 4.0
    """Of the error along the body [1/m2]."""
    q_v: float = 0.1
    """Of the error of speed [s2/m2]."""
    q_y: float = 40.0
    """Of the error across [1/m2]."""
    q_alpha: float = 4.0
    """Of the heading error [1/rad2]."""
    q_w: float = 0.1
    """Of the error of yaw rate [s2/rad2]."""
    r_v: float = 1.0
    """Of the speed command [s2/m2]."""
    r_w: float = 1.0
    """Of the yaw-rate command [s2/rad2]."""
    k_i_rho: float = 0.01
    """Integral action on the error along the body [1/s]."""

    def __post_init__(self) -> None:
        """Refuse weights for which no regulator exists."""
        for name in self.__dataclass_fields__:
            require_in_range(self, name, 0.0, 1e6, open_low=name in ("q_x", "q_y", "q_alpha", "r_v", "r_w"))

    def packed(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(53,) for the compiled loops: K_Irho, steady gains of speed and yaw rate, then five gains for each speed.

        Args:
            a: (4, 4) of Eq. 2.46.
            b: (4, 2) of Eq. 2.46.

        Raises:
            ValueError: no regulator exists for this model.
        """
        along_a, along_b = np.array([[0.0, -1.0], [0.0, a[1, 1]]]), np.array([[0.0], [b[1, 0]]])
        try:
            k_x, k_v = _gain(along_a, along_b, [self.q_x, self.q_v], self.r_v)
            rows = []
            for speed in SPEEDS:
                across_a = np.array([[0.0, speed, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, a[3, 3]]])
                across_b = np.array([[0.0], [0.0], [b[3, 1]]])
                rows.append([k_x, k_v, *_gain(across_a, across_b, [self.q_y, self.q_alpha, self.q_w], self.r_w)])
        except (np.linalg.LinAlgError, control.ControlArgument) as error:
            raise ValueError(f"no regulator for these weights: {error}") from error
        return np.array([self.k_i_rho, -a[1, 1] / b[1, 0], -a[3, 3] / b[3, 1], *np.ravel(rows)], dtype=np.float64)


def _gain(a: FloatArray, b: FloatArray, q: list[float], r: float) -> list[float]:
    """K of u = -K x for one input and diagonal weights."""
    k, _, _ = control.lqr(a, b, np.diag(q), np.array([[r]]))
    return [float(x) for x in np.asarray(k)[0]]


@jit
def regulate(gains, memory, e_rho, e_y, e_alpha, v_ref, w_ref, v, w, dt):
    """One step: memory with the next integral and the command; arguments as in `lqr.regulate`, with the target's twist."""
    spacing = (1.0 - 0.1) / 9.0
    place = min(max((abs(v_ref) - 0.1) / spacing, 0.0), 9.0)
    low = min(int(place), 8)
    share = place - low
    i, j = _HEAD + _ROW * low, _HEAD + _ROW * (low + 1)
    k_x = gains[i] + share * (gains[j] - gains[i])
    k_v = gains[i + 1] + share * (gains[j + 1] - gains[i + 1])
    k_y = gains[i + 2] + share * (gains[j + 2] - gains[i + 2])
    k_alpha = gains[i + 3] + share * (gains[j + 3] - gains[i + 3])
    k_w = gains[i + 4] + share * (gains[j + 4] - gains[i + 4])
    v_cmd = gains[1] * v_ref - k_x * (e_rho + memory[0]) - k_v * (v - v_ref)
    w_cmd = gains[2] * w_ref - k_y * e_y - k_alpha * e_alpha - k_w * (w - w_ref)
    integral = clamp_integral(e_rho, memory[0], v_cmd, V_LIMIT, gains[0], dt)
    v_cmd, w_cmd = min(max(v_cmd, -V_LIMIT), V_LIMIT), min(max(w_cmd, -W_LIMIT), W_LIMIT)
    return integral, memory[1], memory[2], memory[3], memory[4], v_cmd, w_cmd, memory[7]
