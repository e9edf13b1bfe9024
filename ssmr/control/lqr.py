"""Linear quadratic regulators on the linear model, with constant and with scheduled gains.

The first is that of the thesis (Sec. 4.4.2, Fig. 4.26).
Both are one loop with integral action on e_rho. The gain K of u = -K x belongs to the model of
Eq. 2.46 with Q and R diagonal; e_rho with its integral stands for the error of x, e_theta = K_alpha
e_alpha + K_y e_y for that of theta, and the speeds are fed back as they are.

The gain-scheduled one, which the thesis leaves as future work, linearises the error dynamics about
the operating speed. The errors in the body frame of a robot that follows a target moving at (v_r,
omega_r), about v = v_r, omega = omega_r:

    d e_rho / dt   = v_r cos e_alpha - v + omega e_y      ~ -(v - v_r)
    d e_y / dt     = v_r sin e_alpha - omega e_rho        ~ v_r e_alpha
    d e_alpha / dt = omega_r - omega

with speed and yaw rate by the linear model (Eq. 2.46). The lateral part depends on v_r: at rest e_y
is out of reach, and one gain for all speeds is either sluggish or nervous. K_y and K_alpha, set by
hand in the thesis, come out of the Riccati equation. Backwards, -e_y stands for e_y: then the
equations are those of the same speed forwards. Feedforward holds (v_r, omega_r) where the errors
are zero; an integral of e_rho takes what the model leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr._jit import jit
from ssmr.control.law import REVERSAL, SPOT_TURN, Gains, Law, Memory, Observation
from ssmr.control.waypoints import Errors, Target
from ssmr.parameters import parameter
from ssmr.types import FloatArray

V_LIMIT = 1.0
"""Saturation of the linear velocity command [m/s]; "the vehicle maximum input limits"
(Sec. 4.4.2)."""
W_LIMIT = 2.0
"""Saturation of the yaw-rate command [rad/s]."""


@dataclass(frozen=True)
class LqrGains(Gains):
    """Weights and the gains set beside them.

    Defaults and search bounds are those of Tab. 4.21, optimised column. R must be positive, and so
    must be Q for position and heading: no regulator exists otherwise.
    """

    q_x: float = parameter(4.06, unit="1/m2", low=0.0, high=1e6, open_low=True, search=(2.0, 5.0))
    """Q_11, weight of the error of position."""
    q_v: float = parameter(0.02, unit="s2/m2", low=0.0, high=1e6, search=(0.0, 0.05))
    """Q_22, weight of speed."""
    q_yaw: float = parameter(
        10.48, unit="1/rad2", low=0.0, high=1e6, open_low=True, search=(5.0, 15.0)
    )
    """Q_33, weight of the error of heading."""
    q_w: float = parameter(0.0, unit="s2/rad2", low=0.0, high=1e6, search=(0.0, 0.1))
    """Q_44, weight of yaw rate."""
    r_v: float = parameter(0.44, unit="s2/m2", low=0.0, high=1e6, open_low=True, search=(0.3, 0.7))
    """R_11, weight of the speed command."""
    r_w: float = parameter(
        0.76, unit="s2/rad2", low=0.0, high=1e6, open_low=True, search=(0.4, 0.9)
    )
    """R_22, weight of the yaw-rate command."""
    k_alpha: float = parameter(1.0, unit="1", low=0.0, high=1e6, search=(0.0, 3.0))
    """K_alpha, weight of e_alpha in e_theta."""
    k_y: float = parameter(0.9, unit="rad/m", low=0.0, high=1e6, search=(0.0, 3.0))
    """K_y, weight of e_y in e_theta."""
    k_i_rho: float = parameter(0.01, unit="1/s", low=0.0, high=1e6, search=(0.0, 0.5))
    """K_Irho, integral action on e_rho."""

    def packed(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return K row by row, K_alpha, K_y and K_Irho, (11,)."""
        q = [self.q_x, self.q_v, self.q_yaw, self.q_w]
        k = _regulator_gain(a, b, q, [self.r_v, self.r_w])
        others = (self.k_alpha, self.k_y, self.k_i_rho)
        return np.array([*k.ravel(), *others], dtype=np.float64)


def _regulator_gain(a: FloatArray, b: FloatArray, q: list[float], r: list[float]) -> FloatArray:
    """(m, n) K of the optimal u = -K x for a model (n, n) `a`, (n, m) `b`, diagonal weights.

    Raises:
        ValueError: no regulator exists.
    """
    import control  # here: it takes two seconds, which a help text need not wait for

    try:
        k, _, _ = control.lqr(a, b, np.diag(q), np.diag(r))
    except (np.linalg.LinAlgError, control.ControlArgument) as error:
        raise ValueError(f"no regulator for these weights: {error}") from error
    return np.asarray(k, dtype=np.float64)


@jit
def _clamp_integral(
    error: float, integral: float, out: float, limit: float, k_i: float, dt: float
) -> float:
    """Return the integral after a step with clamping (Fig. 4.8).

    It stops while the output is at its limit and both have the same sign.
    """
    if abs(out) > limit and integral * error > 0.0:
        return integral
    return integral + k_i * error * dt


@jit
def saturated_command(memory: Memory, i_rho: float, v: float, w: float) -> Memory:
    """Return the memory of a law of one rate with its next integral and its limited command."""
    v = min(max(v, -V_LIMIT), V_LIMIT)
    w = min(max(w, -W_LIMIT), W_LIMIT)
    return Memory(
        i_rho=i_rho,
        i_y=memory.i_y,
        i_alpha=memory.i_alpha,
        i_u=memory.i_u,
        i_w=memory.i_w,
        u_ref=v,
        w_ref=w,
    )


@jit
def _regulate_errors(
    row: FloatArray, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float
) -> Memory:
    """Return the memory after a step: integral of e_rho, command v [m/s] and omega [rad/s]."""
    # rows of K: what the speed and the yaw-rate command take of x, v, theta and omega
    k_v = row[0:4]
    k_w = row[4:8]
    k_alpha = row[8]
    k_y = row[9]
    k_i_rho = row[10]
    x = errors.rho + memory.i_rho
    theta = k_alpha * errors.alpha + k_y * errors.y
    v = k_v[0] * x - k_v[1] * seen.v
    v += k_v[2] * theta
    v -= k_v[3] * seen.w
    w = k_w[0] * x - k_w[1] * seen.v
    w += k_w[2] * theta
    w -= k_w[3] * seen.w
    i_rho = _clamp_integral(errors.rho, memory.i_rho, v, V_LIMIT, k_i_rho, dt)
    return saturated_command(memory, i_rho, v, w)


LAW = Law(
    "lqr",
    LqrGains,
    _regulate_errors,
    searched=("q_x", "q_v", "q_yaw", "q_w", "r_v", "r_w"),
    generations=300,
    k_u=50.0,
    manoeuvres=(SPOT_TURN,),
)


OPERATING_SPEEDS = tuple(float(v) for v in np.linspace(0.1, 1.0, 10))
"""Operating speeds for which gains are computed [m/s]; they are interpolated between, and held
below the first."""


@dataclass(frozen=True)
class ScheduledGains(Gains):
    """Weights of the regulator, equal at all speeds.

    No regulator exists where one of the open bounds is reached.
    """

    q_x: float = parameter(4.0, unit="1/m2", low=0.0, high=1e6, open_low=True, search=(0.01, 100.0))
    """Weight of the error along the body."""
    q_v: float = parameter(0.1, unit="s2/m2", low=0.0, high=1e6, search=(0.0, 10.0))
    """Weight of the error of speed."""
    q_y: float = parameter(
        40.0, unit="1/m2", low=0.0, high=1e6, open_low=True, search=(0.01, 100.0)
    )
    """Weight of the error across the body."""
    q_alpha: float = parameter(
        4.0, unit="1/rad2", low=0.0, high=1e6, open_low=True, search=(0.01, 100.0)
    )
    """Weight of the heading error."""
    q_w: float = parameter(0.1, unit="s2/rad2", low=0.0, high=1e6, search=(0.0, 10.0))
    """Weight of the error of yaw rate."""
    r_v: float = parameter(1.0, unit="s2/m2", low=0.0, high=1e6, open_low=True, search=(0.05, 10.0))
    """Weight of the speed command."""
    r_w: float = parameter(
        1.0, unit="s2/rad2", low=0.0, high=1e6, open_low=True, search=(0.05, 10.0)
    )
    """Weight of the yaw-rate command."""
    k_i_rho: float = parameter(0.01, unit="1/s", low=0.0, high=1e6, search=(0.0, 0.5))
    """Integral action on the error along the body."""

    def packed(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return (53,) K_Irho, the steady gains, then five gains for each operating speed."""
        rate_v = a[1, 1]
        rate_w = a[3, 3]
        push_v = b[1, 0]
        push_w = b[3, 1]
        along_a = np.array([[0.0, -1.0], [0.0, rate_v]])
        along_b = np.array([[0.0], [push_v]])
        along = _regulator_gain(along_a, along_b, [self.q_x, self.q_v], [self.r_v])[0]
        across_b = np.array([[0.0], [0.0], [push_w]])
        across_q = [self.q_y, self.q_alpha, self.q_w]
        rows = []
        for speed in OPERATING_SPEEDS:
            across_a = np.array([[0.0, speed, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, rate_w]])
            across = _regulator_gain(across_a, across_b, across_q, [self.r_w])[0]
            rows.append([*along, *across])
        steady = (-rate_v / push_v, -rate_w / push_w)
        return np.array([self.k_i_rho, *steady, *np.ravel(rows)], dtype=np.float64)


@jit
def _gain_at(table: FloatArray, speed: float, column: int) -> float:
    """Return one gain at a reference speed [m/s], linear between the operating speeds."""
    spacing = (1.0 - 0.1) / 9.0
    place = (abs(speed) - 0.1) / spacing
    place = min(max(place, 0.0), 9.0)
    low = min(int(place), 8)
    gain = table[low, column]
    next_gain = table[low + 1, column]
    return float(gain + (place - low) * (next_gain - gain))


@jit
def _regulate_at_speed(
    row: FloatArray, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float
) -> Memory:
    """Return the memory after a step: integral of e_rho, command v [m/s] and omega [rad/s]."""
    k_i_rho = row[0]
    steady_v = row[1]  # speed command that holds a speed of 1 m/s [1]
    steady_w = row[2]  # yaw-rate command that holds a yaw rate of 1 rad/s [1]
    k = row[3:53].reshape(10, 5)  # of e_rho, v, e_y, e_alpha, omega at the operating speeds
    speed = target.v
    along = (errors.rho + memory.i_rho, seen.v - speed)
    offset = -errors.y if speed < 0.0 else errors.y
    across = (offset, errors.alpha, seen.w - target.w)
    v = steady_v * speed
    w = steady_w * target.w
    # numba compiles a function once for each literal number that it is called with
    for i in range(2):
        v -= _gain_at(k, speed, i) * along[i]
    for i in range(3):
        w -= _gain_at(k, speed, 2 + i) * across[i]
    i_rho = _clamp_integral(errors.rho, memory.i_rho, v, V_LIMIT, k_i_rho, dt)
    return saturated_command(memory, i_rho, v, w)


SCHEDULED_LAW = Law(
    "lqr-scheduled",
    ScheduledGains,
    _regulate_at_speed,
    searched=("q_x", "q_y", "q_alpha", "q_v", "q_w", "r_w"),
    manoeuvres=(REVERSAL, SPOT_TURN),
)
