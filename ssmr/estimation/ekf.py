"""Extended Kalman filter of a robot's pose and velocities, from wheel encoders and gyro.

It is that of Sec. 3.1.3. The state is (x, y, yaw, v, omega) of the reference point, with yaw
unwrapped. As in the stock filter of a Husky (the ROS package robot_localization, `two_d_mode`),
both velocities are constant except for white accelerations, and every measurement is linear: v and
omega as the driver's odometry computes them from the wheels (Eq. 2.9), and omega from the gyro.
Nothing measures the pose, so its uncertainty only grows. The lateral speed is taken to be 0. This
is the thesis' filter, which the default settings are.

A filter's state is a `Belief`, whose two arrays the kernels update in place. They allocate nothing,
so that they run as well inside other compiled loops.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ssmr._jit import jit, jit_alone
from ssmr.estimation.settings import YAW, Belief, EkfSettings, V, W, X, Y
from ssmr.robot.drive import body_rates
from ssmr.robot.sensors import SensorLog
from ssmr.types import FloatArray, State, Trajectory, frozen_array, increasing_times


@jit
def predict_belief(belief: Belief, dt: float, numbers: Any) -> None:
    """Let time pass, in place: P <- F P F' + Q.

    The pose follows the midpoint rule, whose exact Jacobian is

        F = | 1  0  turn_x  along_x  half turn_x |
            | 0  1  turn_y  along_y  half turn_y |
            | 0  0    1        0         dt      |
            | 0  0    0        1          0      |
            | 0  0    0        0          1      |

    The process noise is white in continuous time, so that the covariance does not depend on how a
    straight path is cut into steps: Q is the integral of f(s) q f(s)' over the step, where an error
    of yaw, v or omega that is s old has moved the pose along its column f(s) of the Jacobian. The
    duration `dt` [s] is not negative.
    """
    m, p = belief
    n = len(m)
    v = m[V]
    w = m[W]
    half = 0.5 * dt
    heading = m[YAW] + half * w
    along_x = dt * math.cos(heading)  # derivatives by v
    along_y = dt * math.sin(heading)
    turn_x = -v * along_y  # derivatives by yaw
    turn_y = v * along_x
    m[X] += turn_y
    m[Y] -= turn_x
    m[YAW] += dt * w
    for j in range(n):  # P <- F P, column by column
        swing = p[YAW, j] + half * p[W, j]
        ahead = p[V, j]
        p[X, j] += turn_x * swing + along_x * ahead
        p[Y, j] += turn_y * swing + along_y * ahead
        p[YAW, j] += dt * p[W, j]
    for i in range(n):  # P <- P F', row by row
        swing = p[i, YAW] + half * p[i, W]
        ahead = p[i, V]
        p[i, X] += turn_x * swing + along_x * ahead
        p[i, Y] += turn_y * swing + along_y * ahead
        p[i, YAW] += dt * p[i, W]
    _add_process_noise(p, along_x, along_y, turn_x, turn_y, dt=dt, numbers=numbers)
    for i in range(1, n):  # both are symmetric; the upper triangle is kept
        for j in range(i):
            p[i, j] = p[j, i]


@jit
def _add_process_noise(
    p: FloatArray,
    along_x: float,
    along_y: float,
    turn_x: float,
    turn_y: float,
    dt: float,
    numbers: Any,
) -> None:
    """Add the upper triangle of Q of one step to the covariance, see `predict_belief`."""
    q_slip = dt * numbers.process_position
    q_yaw = dt * numbers.process_yaw
    q_v = dt * numbers.process_v
    q_w = dt * numbers.process_yaw_rate
    q_turn = q_yaw / 3.0 + q_w * dt * dt / 20.0
    q_along = q_v / 3.0
    turn_yaw = 0.5 * q_yaw + q_w * dt * dt / 8.0
    turn_w = q_w * dt / 6.0
    p[X, X] += q_slip + q_turn * turn_x * turn_x + q_along * along_x * along_x
    p[Y, Y] += q_slip + q_turn * turn_y * turn_y + q_along * along_y * along_y
    p[YAW, YAW] += q_yaw + q_w * dt * dt / 3.0
    p[V, V] += q_v
    p[W, W] += q_w
    p[X, Y] += q_turn * turn_x * turn_y + q_along * along_x * along_y
    p[X, YAW] += turn_yaw * turn_x
    p[Y, YAW] += turn_yaw * turn_y
    p[X, V] += 0.5 * q_v * along_x
    p[Y, V] += 0.5 * q_v * along_y
    p[X, W] += turn_w * turn_x
    p[Y, W] += turn_w * turn_y
    p[YAW, W] += 0.5 * dt * q_w


@jit
def update_belief(belief: Belief, j: int, value: float, variance: float) -> None:
    """Take in one measurement of state `j`, in place.

    A NaN or a measurement of infinite variance changes nothing. With the gain K = P H'/S, S = H P
    H' + R, this is the mean m + K (z - H m) and Joseph's form of the covariance, (I - K H) P (I - K
    H)' + K R K'. Where H picks state j, the last terms of that form cancel in all rows and columns
    but the j-th, whose factor 1 - K_j is R/S: no difference of like numbers is left there, so the
    variance stays positive.
    """
    if math.isnan(value) or variance == math.inf:
        return
    m, p = belief
    n = len(m)
    total = p[j, j] + variance  # S
    step = (value - m[j]) / total
    for i in range(n):
        m[i] += p[j, i] * step
        gain = p[j, i] / total
        for k in range(i, n):
            if i != j and k != j:
                left = p[i, k] - gain * p[j, k]
                p[i, k] = left
                p[k, i] = left
    keep = variance / total
    for k in range(n):  # row and column j, which the others needed as they were
        p[j, k] *= keep
        p[k, j] = p[j, k]


@jit_alone
def filter_step(belief: Belief, sample: SensorLog, dt: float, numbers: Any) -> None:
    """Let `dt` [s] pass, then take in one sample of wheels and gyro, in place.

    The wheels' v and yaw rate are used one after the other: sum and difference of two equally noisy
    wheels have independent noise. The sample is NaN where a sensor gave nothing.
    """
    predict_belief(belief, dt, numbers)
    v, w = body_rates(sample.left, sample.right, numbers.half_track, numbers.radius)
    update_belief(belief, V, v, numbers.variance_v)
    update_belief(belief, W, w, numbers.variance_wheel_yaw_rate)
    update_belief(belief, W, sample.gyro - numbers.gyro_bias, numbers.variance_gyro)


@jit_alone
def _filter_log(log: SensorLog, numbers: Any, belief: Belief, out: FloatArray) -> None:
    """Filter a `SensorLog`, in place.

    `out` (M, 19) is written: the mean, its standard deviations, and the covariance of the pose.
    """
    mean, covariance = belief
    n = len(mean)
    now = log.t[0]
    for k in range(len(log.t)):
        sample = SensorLog(log.t[k], log.left[k], log.right[k], log.gyro[k])
        filter_step(belief, sample, log.t[k] - now, numbers)
        now = log.t[k]
        row = out[k]
        for i in range(n):
            row[i] = mean[i]
            row[n + i] = np.sqrt(covariance[i, i])
        for i in range(9):
            row[2 * n + i] = covariance[i // 3, i % 3]


def initial_belief(state: State) -> Belief:
    """Return the first belief of a filter that is sure of its state, as the lab's was (Sec. 4.2).

    Its arrays are writable. A ValueError refuses numbers that are not finite.
    """
    numbers = [state.x, state.y, state.yaw, state.v_x, state.yaw_rate]
    mean = frozen_array(numbers, "the filter's start", (5,))
    return mean.copy(), np.zeros((5, 5))


def run_ekf(
    log: SensorLog, settings: EkfSettings, start: State, standing: float = 0.0
) -> Trajectory:
    """Filter a whole log.

    Args:
        log: readings at instants that may be irregular; NaN where the gyro gave nothing.
        settings: assumptions about robot and sensors.
        start: state of the robot at the first instant, whose sample is used as well.
        standing: time for which the robot stands at the log's beginning [s]. Unless it is 0, the
            gyro's mean reading in it is the bias, whatever `settings` say.

    Returns:
        The estimate after each sample, with the wheels as measured. Channels are `pose_std` (M, 3)
        and its square's whole `pose_covariance` (M, 3, 3).

    Raises:
        ValueError: lengths differ, time does not increase, a number other than a missing gyro
            sample is not finite, or the gyro gave nothing while the robot stood.
    """
    times = increasing_times(log.t)
    count = (len(times),)
    left = frozen_array(log.left, "left", count)
    right = frozen_array(log.right, "right", count)
    gyro = np.array(log.gyro, dtype=np.float64)
    frozen_array(np.where(np.isnan(gyro), 0.0, gyro), "gyro", count)
    if standing > 0.0:
        at_rest = gyro[times < times[0] + standing]
        if np.isnan(at_rest).all():
            raise ValueError(f"the gyro gave nothing in the {standing:g} s of rest")
        settings = replace(settings, gyro_bias=float(np.nanmean(at_rest)))
    belief = initial_belief(start)
    n = len(belief[0])
    out = np.empty((len(times), 2 * n + 9))
    _filter_log(SensorLog(times, left, right, gyro), settings.packed(), belief, out)
    mean, std, covariance = np.split(out, [n, 2 * n], axis=1)
    channels = {"pose_std": std[:, :3], "pose_covariance": covariance.reshape(-1, 3, 3)}
    twist = np.zeros((len(times), 3))
    twist[:, [0, 2]] = mean[:, [V, W]]
    return Trajectory(times, mean[:, :3], twist, np.column_stack([left, right]), channels)
