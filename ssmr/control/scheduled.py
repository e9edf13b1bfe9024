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
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import jit
from ssmr.control.law import Gains, Law, Memory, Observation
from ssmr.control.lqr import V_LIMIT, clamp_integral, regulator_gain, saturated_command
from ssmr.control.waypoints import Errors, Target
from ssmr.parameters import parameter
from ssmr.types import FloatArray

OPERATING_SPEEDS = tuple(float(v) for v in np.linspace(0.1, 1.0, 10))
"""Operating speeds for which gains are computed [m/s]; they are interpolated between, and held below the first."""


@dataclass(frozen=True)
class ScheduledGains(Gains):
    """Weights of the regulator, equal at all speeds; no regulator exists where one of the open bounds is reached."""

    q_x: float = parameter(4.0, unit="1/m2", low=0.0, high=1e6, open_low=True, search=(0.01, 100.0))
    """Weight of the error along the body."""
    q_v: float = parameter(0.1, unit="s2/m2", low=0.0, high=1e6, search=(0.0, 10.0))
    """Weight of the error of speed."""
    q_y: float = parameter(40.0, unit="1/m2", low=0.0, high=1e6, open_low=True, search=(0.01, 100.0))
    """Weight of the error across the body."""
    q_alpha: float = parameter(4.0, unit="1/rad2", low=0.0, high=1e6, open_low=True, search=(0.01, 100.0))
    """Weight of the heading error."""
    q_w: float = parameter(0.1, unit="s2/rad2", low=0.0, high=1e6, search=(0.0, 10.0))
    """Weight of the error of yaw rate."""
    r_v: float = parameter(1.0, unit="s2/m2", low=0.0, high=1e6, open_low=True, search=(0.05, 10.0))
    """Weight of the speed command."""
    r_w: float = parameter(1.0, unit="s2/rad2", low=0.0, high=1e6, open_low=True, search=(0.05, 10.0))
    """Weight of the yaw-rate command."""
    k_i_rho: float = parameter(0.01, unit="1/s", low=0.0, high=1e6, search=(0.0, 0.5))
    """Integral action on the error along the body."""

    def packed(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return K_Irho, the steady gains of speed and yaw rate, then five gains for each operating speed, (53,)."""
        along_a, along_b = np.array([[0.0, -1.0], [0.0, a[1, 1]]]), np.array([[0.0], [b[1, 0]]])
        along = regulator_gain(along_a, along_b, [self.q_x, self.q_v], [self.r_v])[0]
        rows = []
        for speed in OPERATING_SPEEDS:
            across_a = np.array([[0.0, speed, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, a[3, 3]]])
            across_b = np.array([[0.0], [0.0], [b[3, 1]]])
            across = regulator_gain(across_a, across_b, [self.q_y, self.q_alpha, self.q_w], [self.r_w])[0]
            rows.append([*along, *across])
        return np.array([self.k_i_rho, -a[1, 1] / b[1, 0], -a[3, 3] / b[3, 1], *np.ravel(rows)], dtype=np.float64)


class ScheduledNumbers(NamedTuple):
    """The regulator at every operating speed."""

    k_i_rho: float
    steady_v: float
    """Speed command that holds a speed of 1 m/s [1]."""
    steady_w: float
    """Yaw-rate command that holds a yaw rate of 1 rad/s [1]."""
    table: FloatArray
    """(10, 5) gains of e_rho, v, e_y, e_alpha and omega, one row for each operating speed."""


class SpeedGains(NamedTuple):
    """The regulator at one speed."""

    x: float
    v: float
    y: float
    alpha: float
    w: float


@jit
def unpack(row: FloatArray) -> ScheduledNumbers:
    """Return the named numbers of a packed row."""
    return ScheduledNumbers(row[0], row[1], row[2], row[3:53].reshape(10, 5))


@jit
def gains_at(table: FloatArray, speed: float) -> SpeedGains:
    """Return the gains at a reference speed [m/s], linear between the operating speeds."""
    spacing = (1.0 - 0.1) / 9.0
    place = min(max((abs(speed) - 0.1) / spacing, 0.0), 9.0)
    low = min(int(place), 8)
    share = place - low
    a, b = table[low], table[low + 1]
    return SpeedGains(
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        a[3] + share * (b[3] - a[3]),
        a[4] + share * (b[4] - a[4]),
    )


@jit
def regulate_at_speed(gains: Any, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float) -> Memory:
    """Return the memory after a step: the next integral of e_rho and the command v [m/s], omega [rad/s]."""
    k = gains_at(gains.table, target.v)
    v = gains.steady_v * target.v - k.x * (errors.rho + memory.i_rho) - k.v * (seen.v - target.v)
    w = gains.steady_w * target.w - k.y * errors.y - k.alpha * errors.alpha - k.w * (seen.w - target.w)
    return saturated_command(memory, clamp_integral(errors.rho, memory.i_rho, v, V_LIMIT, gains.k_i_rho, dt), v, w)


LAW = Law(
    "lqr-scheduled",
    ScheduledGains,
    unpack,
    regulate_at_speed,
    searched=("q_x", "q_y", "q_alpha", "q_v", "q_w", "r_w"),
    colour="#009e73",
)
