"""Extended Kalman filter that estimates the pose and the velocities of a robot from wheel encoders and gyro (Sec. 3.1.3).

The state is (x, y, yaw, v, omega) of the reference point, with yaw unwrapped. As in the stock filter of a Husky (the ROS
package robot_localization, `two_d_mode`), both velocities are constant except for white accelerations, and every measurement
is linear: v and omega as the driver's odometry computes them from the wheels (Eq. 2.9), and omega from the gyro. Nothing
measures the pose, so its uncertainty only grows. The lateral speed is taken to be 0. This is the thesis' filter, which the
default settings are.

A filter that learns has six states more, the constants of `EkfSettings.constants`. With constants that are neutral and known
it is the thesis' filter.

A filter's state is a `Belief`, whose two arrays the kernels update in place. With five states they allocate nothing, so that
they run as well inside other compiled loops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr._jit import jit, jit_alone, source
from ssmr.estimation.settings import (
    BIAS,
    LEFT,
    RIGHT,
    SHIFT,
    SLIDE,
    STANDING,
    TURNING,
    YAW,
    Belief,
    EkfSettings,
    V,
    W,
    X,
    Y,
)
from ssmr.robot.drive import body_rates
from ssmr.robot.sensors import SensorLog, SensorSample
from ssmr.types import FloatArray, State, Trajectory, frozen_array, increasing_times


@jit
def weighed(weights: FloatArray, values: FloatArray) -> float:
    """Return the sum of the states' values from v on, each times its weight."""
    total = 0.0
    for i in range(V, len(weights)):
        total += float(weights[i] * values[i])
    return total


@jit
def forward_speed(m: FloatArray, h: float, row: FloatArray) -> float:
    """Return the forward speed [m/s] of the mean of a filter that learns; write its derivative by the state into `row`.

    The state v is the odometry's, k (v - y omega) + d h c omega / k, with k the mean of both scales, d half of right less
    left, y the shift, c the turning ratio and h the driver's half-track. What the wheels say of it is then linear. Were the
    true speed a state, a product of two unknowns would be measured, and the filter would believe that it learns k.
    """
    both, uneven = 0.5 * (m[LEFT] + m[RIGHT]), 0.5 * (m[RIGHT] - m[LEFT])
    turned = h * m[TURNING] * m[W] / both
    by_both, by_uneven = (2.0 * uneven * turned / both - m[V] / both) / both, -turned / both
    row[:] = 0.0
    row[V], row[TURNING] = 1.0 / both, -uneven * h * m[W] / (both * both)
    row[W], row[SHIFT] = m[SHIFT] - uneven * h * m[TURNING] / (both * both), m[W]
    row[LEFT], row[RIGHT] = 0.5 * (by_both - by_uneven), 0.5 * (by_both + by_uneven)
    return float((m[V] - uneven * turned) / both + m[SHIFT] * m[W])


@jit
def wheel_yaw_rate(m: FloatArray, h: float, row: FloatArray) -> float:
    """Return the yaw rate [rad/s] that the odometry should show by the mean of a filter that learns.

    This is d (v - y omega) / h + c omega; see `forward_speed`. Its derivative is written into `row`.
    """
    uneven = 0.5 * (m[RIGHT] - m[LEFT]) / h
    ahead = forward_speed(m, h, row) - m[SHIFT] * m[W]
    row[W] -= m[SHIFT]
    row[SHIFT] = 0.0
    for i in range(V, len(row)):
        row[i] *= uneven
    row[W] += m[TURNING]
    row[TURNING] += m[W]
    row[LEFT] -= 0.5 * ahead / h
    row[RIGHT] += 0.5 * ahead / h
    return float(uneven * ahead + m[TURNING] * m[W])


@jit
def predict(belief: Belief, dt: float, numbers: Any) -> None:
    """Let time pass, in place: P <- F P F' + Q.

    The pose follows the midpoint rule, whose exact Jacobian is

        F = | 1  0  turn_x  along_x  half turn_x |
            | 0  1  turn_y  along_y  half turn_y |
            | 0  0    1        0         dt      |
            | 0  0    0        1          0      |
            | 0  0    0        0          1      |

    A filter that learns moves at its `forward_speed`, and across itself at slide times omega.
    The process noise is white in continuous time, so that the covariance does not depend on how a straight path is cut into
    steps: Q is the integral of f(s) q f(s)' over the step, where an error of yaw, v or omega that is s old has moved the
    pose along its column f(s) of the Jacobian. The duration `dt` [s] is not negative.
    """
    m, p = belief
    n = len(m)
    w, half = m[W], 0.5 * dt
    if n > BIAS:
        forward = np.empty(n)  # derivative of the forward speed by the state
        v, slide = forward_speed(m, numbers.half_track, forward), m[SLIDE]
    else:
        v, slide = m[V], 0.0
    rolled = abs(v) + numbers.half_track * abs(w)  # by the faster side's wheels, per second
    heading = m[YAW] + half * w
    along_x, along_y = dt * math.cos(heading), dt * math.sin(heading)  # derivatives by v
    turn_x, turn_y = -v * along_y - slide * w * along_x, v * along_x - slide * w * along_y  # derivatives by yaw
    m[X] += turn_y
    m[Y] -= turn_x
    m[YAW] += dt * w
    if n > BIAS:
        p[BIAS, BIAS] += dt * numbers.bias_walk
    for j in range(n):  # P <- F P, column by column
        swing = p[YAW, j] + half * p[W, j]
        ahead, across = p[V, j], 0.0
        if n > BIAS:
            ahead, across = weighed(forward, p[:, j]), slide * p[W, j] + w * p[SLIDE, j]
        p[X, j] += turn_x * swing + along_x * ahead - along_y * across
        p[Y, j] += turn_y * swing + along_y * ahead + along_x * across
        p[YAW, j] += dt * p[W, j]
    for i in range(n):  # P <- P F', row by row
        swing = p[i, YAW] + half * p[i, W]
        ahead, across = p[i, V], 0.0
        if n > BIAS:
            ahead, across = weighed(forward, p[i]), slide * p[i, W] + w * p[i, SLIDE]
        p[i, X] += turn_x * swing + along_x * ahead - along_y * across
        p[i, Y] += turn_y * swing + along_y * ahead + along_x * across
        p[i, YAW] += dt * p[i, W]
    slip, q_yaw = dt * numbers.process_position, dt * numbers.process_yaw
    q_v, q_w = dt * numbers.process_v, dt * numbers.process_yaw_rate
    q_turn = q_yaw / 3.0 + q_w * dt * dt / 20.0
    x_yaw, x_w = 0.5 * q_yaw + q_w * dt * dt / 8.0, q_w * dt / 6.0
    for i in range(1, n):  # F P F' is symmetric; the upper triangle is kept
        for j in range(i):
            p[i, j] = p[j, i]
    p[X, X] += slip + q_turn * turn_x * turn_x + q_v / 3.0 * along_x * along_x
    p[Y, Y] += slip + q_turn * turn_y * turn_y + q_v / 3.0 * along_y * along_y
    p[YAW, YAW] += q_yaw + q_w * dt * dt / 3.0
    p[V, V] += q_v
    p[W, W] += q_w
    _add(p, X, Y, q_turn * turn_x * turn_y + q_v / 3.0 * along_x * along_y)
    _add(p, X, YAW, x_yaw * turn_x)
    _add(p, Y, YAW, x_yaw * turn_y)
    _add(p, X, V, 0.5 * q_v * along_x)
    _add(p, Y, V, 0.5 * q_v * along_y)
    _add(p, X, W, x_w * turn_x)
    _add(p, Y, W, x_w * turn_y)
    _add(p, YAW, W, half * q_w)
    ahead, across = rolled * numbers.slip_along, rolled * numbers.slip_across
    if ahead + across > 0.0 and dt > 0.0:
        p[X, X] += (ahead * along_x * along_x + across * along_y * along_y) / dt
        p[Y, Y] += (ahead * along_y * along_y + across * along_x * along_x) / dt
        _add(p, X, Y, (ahead - across) * along_x * along_y / dt)


@jit
def _add(p: FloatArray, i: int, j: int, value: float) -> None:
    """Add to an element of a symmetric matrix and to its mirror image."""
    p[i, j] += value
    p[j, i] += value


@jit
def update(belief: Belief, j: int, value: float, variance: float) -> None:
    """Take in one measurement of state `j`, in place; a NaN or a measurement of infinite variance changes nothing.

    With the gain K = P H'/S, S = H P H' + R, this is the mean m + K (z - H m) and Joseph's form of the covariance, (I - K
    H) P (I - K H)' + K R K'. Where H picks state j, the last terms of that form cancel in all rows and columns but the
    j-th, whose factor 1 - K_j is R/S: no difference of like numbers is left there, so the variance stays positive.
    """
    if math.isnan(value) or variance == math.inf:
        return
    m, p = belief
    total = p[j, j] + variance  # S
    keep, step = variance / total, (value - m[j]) / total
    n = len(m)
    for i in range(n):
        m[i] += p[j, i] * step
        gain = p[j, i] / total
        for k in range(i, n):
            if i != j and k != j:
                left = p[i, k] - gain * p[j, k]
                p[i, k] = left
                p[k, i] = left
    for k in range(n):  # row and column j, which the others needed as they were
        p[j, k] *= keep
        p[k, j] = p[j, k]


@jit
def update_row(belief: Belief, row: FloatArray, residual: float, variance: float) -> None:
    """Take in one measurement of a sum of states, in place, as `update`; the turning ratio stays as uncertain as it was.

    It is a state that is only considered (Schmidt's filter), since learning it cannot be trusted: it multiplies a yaw rate
    as noisy as the gyro, and where slip hides all slow differences, that noise would pull the ratio towards 0.

    The (n,) `row` is H, the derivative of the measurement by the state, and `residual` the measurement less what the mean
    says that it is. The other arguments are those of `update`.
    """
    if math.isnan(residual) or variance == math.inf:
        return
    m, p = belief
    n = len(m)
    column, total = np.empty(n), variance
    for i in range(n):
        column[i] = 0.0
        for k in range(n):
            column[i] += p[i, k] * row[k]
        total += row[i] * column[i]
    step = residual / total
    for i in range(n):
        if i != TURNING:  # no other filter has a state in this place
            m[i] += column[i] * step
        gain = column[i] / total
        for k in range(i, n):
            if i != TURNING or k != TURNING:
                left = p[i, k] - gain * column[k]
                p[i, k] = left
                p[k, i] = left


@jit_alone
def filter_step(belief: Belief, sample: SensorSample, dt: float, numbers: Any) -> None:
    """Take in one sample of the robot's sensors, in place: let `dt` [s] pass, then use wheels and gyro.

    The wheels' v and yaw rate are used one after the other: sum and difference of two equally noisy wheels have independent
    noise. The sample is NaN where a sensor gave nothing.
    """
    m = belief.mean
    predict(belief, dt, numbers)
    v, w = body_rates(sample.left, sample.right, numbers.half_track, numbers.radius)
    variance_w = numbers.variance_wheel_yaw_rate
    if numbers.slip_turn > 0.0:  # a yaw error of this variance, spread over the time since the last sample
        rolled = abs(m[V]) + numbers.half_track * abs(m[W])
        variance_w += rolled * numbers.slip_turn / dt if dt > 0.0 else math.inf
    if len(m) <= BIAS:
        update(belief, V, v, numbers.variance_v)
        update(belief, W, w, variance_w)
        update(belief, W, sample.gyro, numbers.variance_gyro)
        return
    row = np.zeros(len(m))
    row[W], row[BIAS] = 1.0, 1.0
    update_row(belief, row, sample.gyro - m[W] - m[BIAS], numbers.variance_gyro)
    row[:] = 0.0
    row[V] = 1.0
    update_row(belief, row, v - m[V], numbers.variance_v)
    shown = wheel_yaw_rate(m, numbers.half_track, row)
    update_row(belief, row, w - shown, variance_w)


@jit_alone
def speed(m: FloatArray, numbers: Any) -> float:
    """Return the forward speed of the reference point [m/s] that a filter believes in."""
    if len(m) <= BIAS:
        return float(m[V])
    return forward_speed(m, numbers.half_track, np.empty(len(m)))


@jit
def stand(belief: Belief) -> None:
    """Tell the filter, in place, that the robot stands: then the gyro shows its bias."""
    for j in (V, W):
        row = np.zeros(len(belief.mean))
        row[j] = 1.0
        update_row(belief, row, -belief.mean[j], STANDING**2)


@jit_alone
def filter_log(log: SensorLog, still: NDArray[np.bool_], numbers: Any, belief: Belief, out: FloatArray) -> None:
    """Filter a `SensorLog`, in place; the robot is known to stand at samples that are `still`, (M,).

    `out` (M, 2 n + 9) is written: the mean, with the forward speed in the place of v, its standard deviations, and the
    covariance of the pose.
    """
    n, now = len(belief.mean), log.t[0]
    for k in range(len(log.t)):
        filter_step(belief, SensorSample(log.left[k], log.right[k], log.gyro[k]), log.t[k] - now, numbers)
        now = log.t[k]
        if still[k]:
            stand(belief)
        out[k, :n], out[k, n : 2 * n] = belief.mean, np.sqrt(np.diag(belief.covariance))
        out[k, V] = speed(belief.mean, numbers)
        out[k, 2 * n :] = np.ravel(belief.covariance[:3, :3])


def initial_belief(state: State, std: Sequence[float] = (0.0,) * 5, settings: EkfSettings | None = None) -> Belief:
    """Return the belief of a filter that starts; its arrays are writable.

    `std` are standard deviations of x, y [m], yaw [rad], v [m/s], omega [rad/s]; the lab's filter was set to its start
    (Sec. 4.2), so the default is 0. `settings` are those of a filter that learns; without them it has five states.

    Raises:
        ValueError: a standard deviation that is negative, or a number that is not finite.
    """
    mean = frozen_array([state.x, state.y, state.yaw, state.v_x, state.yaw_rate], "the filter's start", (5,))
    deviations = frozen_array(std, "the start's standard deviations", (5,))
    if np.any(deviations < 0.0):
        raise ValueError(f"a standard deviation must not be negative, got {tuple(std)}")
    if settings is not None:
        mean, deviations = np.append(mean, settings.constants), np.append(deviations, settings.constants_std)
        row = np.zeros(len(mean))
        rest = source(forward_speed)(np.where(np.arange(len(mean)) == V, 0.0, mean), settings.half_track, row)
        mean[V] = (mean[V] - rest) / row[V]  # the odometry's
    return Belief(mean.copy(), np.diag(np.square(deviations)))


def run_ekf(
    t: ArrayLike,
    left: ArrayLike,
    right: ArrayLike,
    gyro: ArrayLike | None,
    settings: EkfSettings,
    start: State,
    start_std: Sequence[float] = (0.0,) * 5,
    still: ArrayLike | None = None,
) -> Trajectory:
    """Filter a whole log.

    Args:
        t: (M,) instants of the samples [s]; they may be irregular.
        left: (M,) rate of the left wheels [rad/s].
        right: (M,) rate of the right wheels [rad/s].
        gyro: (M,) yaw rate [rad/s], NaN where there was no sample; `None` for a robot without a gyro.
        settings: assumptions about robot and sensors.
        start: state of the robot at the first instant, whose sample is used as well.
        start_std: standard deviations of that state, see `initial_belief`.
        still: (M,) True for samples at which the robot is known to stand; there the gyro shows its bias.

    Returns:
        The estimate after each sample, with the wheels as measured. Channels are `pose_std` (M, 3) and its square's whole
        `pose_covariance` (M, 3, 3). A filter that learns adds `constants` and `constants_std`, (M, 6).

    Raises:
        ValueError: lengths differ, time does not increase, or a number other than a missing gyro sample is not finite.
    """
    times = increasing_times(t)
    wheels = np.column_stack([frozen_array(a, name, (len(times),)) for a, name in ((left, "left"), (right, "right"))])
    turning = np.full(len(times), np.nan) if gyro is None else np.array(gyro, dtype=np.float64)
    frozen_array(np.where(np.isnan(turning), 0.0, turning), "gyro", (len(times),))
    standing = np.zeros(len(times), dtype=np.bool_) if still is None else np.array(still, dtype=np.bool_)
    if standing.shape != times.shape:
        raise ValueError(f"still has shape {standing.shape}, wanted {times.shape}")
    belief = initial_belief(start, start_std, settings if settings.learns else None)
    n = len(belief.mean)
    out = np.empty((len(times), 2 * n + 9))
    log = SensorLog(times, wheels[:, 0].copy(), wheels[:, 1].copy(), turning)
    filter_log(log, standing, settings.packed(), belief, out)
    mean, std, covariance = np.split(out, [n, 2 * n], axis=1)
    channels = {"pose_std": std[:, :3], "pose_covariance": covariance.reshape(-1, 3, 3)}
    lateral = np.zeros(len(times))
    if settings.learns:
        channels |= {"constants": mean[:, BIAS:], "constants_std": std[:, BIAS:]}
        lateral = mean[:, SLIDE] * mean[:, W]
    return Trajectory(times, mean[:, :3], np.column_stack([mean[:, V], lateral, mean[:, W]]), wheels, channels)
