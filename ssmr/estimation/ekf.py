"""Extended Kalman filter that estimates the pose and the velocities of a robot from wheel encoders and gyro (Sec. 3.1.3).

The state is (x, y, yaw, v, omega) of the reference point, with yaw unwrapped. As in the stock filter of a Husky (the ROS
package robot_localization, `two_d_mode`), both velocities are constant except for white accelerations, and every measurement
is linear: v and omega as the driver's odometry computes them from the wheels (Eq. 2.9), and omega from the gyro. Nothing
measures the pose, so its uncertainty only grows. The lateral speed is taken to be 0.

A filter's state is a `Belief`, whose two arrays the kernels update in place. They allocate nothing, so that they run as well
inside other compiled loops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ssmr._jit import jit
from ssmr.estimation.sensing import SensorLog, SensorSample
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import body_rates
from ssmr.types import FloatArray, State, Trajectory, frozen_array

X, Y, YAW, V, W = range(5)
"""Places of x [m], y [m], yaw [rad], v [m/s] and omega [rad/s] in the filter's state."""


class Belief(NamedTuple):
    """Everything that a filter remembers: the state it believes in, and how sure of it it is."""

    mean: FloatArray
    """(5,) x [m], y [m], yaw [rad], v [m/s], omega [rad/s]."""
    covariance: FloatArray
    """(5, 5) covariance of these, symmetric."""


class FilterNumbers(NamedTuple):
    """The fields of `EkfSettings`, for the kernels."""

    radius: float
    half_track: float
    process_position: float
    process_yaw: float
    process_v: float
    process_yaw_rate: float
    variance_v: float
    variance_wheel_yaw_rate: float
    variance_gyro: float


@dataclass(frozen=True)
class EkfSettings:
    """Assumptions of the filter about the robot and its sensors.

    The wheels of a skidding robot tell its yaw rate only through `half_track`. Unless that is the effective one, they
    overstate it, by a factor of 1.8 on tile. By default the gyro is therefore trusted, and the wheels' yaw rate has the
    large variance that the stock driver claims. Both are fused, as on a stock Husky; the wheels count a thousandth of the
    gyro.
    """

    radius: float = parameter(0.1651, unit="m", low=0.0, high=1e6, open_low=True)
    """Wheel radius of the odometry [m]; the driver's."""
    half_track: float = parameter(0.275, unit="m", low=0.0, high=1e6, open_low=True)
    """Half-track of the odometry, half of (separation x multiplier) [m]; the driver's, which assumes no slip."""
    process_position: float = parameter(1e-4, unit="m2/s", low=0.0, high=1e6)
    """Spectral density of slip in x and in y [m2/s]: 1 cm after 1 s, 4.5 cm after 20 s. It is isotropic, so that no frame is
    preferred."""
    process_yaw: float = parameter(1e-6, unit="rad2/s", low=0.0, high=1e6)
    """Spectral density of yaw errors besides the gyro's noise [rad2/s]: 1 mrad after 1 s."""
    process_v: float = parameter(0.025, unit="m2/s3", low=0.0, high=1e6)
    """Spectral density of white acceleration [m2/s3], from the stock filter; 0.7 m/s2 over each command of 0.05 s."""
    process_yaw_rate: float = parameter(0.02, unit="rad2/s3", low=0.0, high=1e6)
    """Spectral density of white yaw acceleration [rad2/s3], from the stock filter; 0.6 rad/s2 over each command. Trajectory
    4 has 0.83 rms, and the robot's limit is 6."""
    variance_v: float = parameter(5.0115e-05, unit="m2/s2", low=0.0, open_low=True)
    """Variance of the wheels' v [m2/s2]; Tab. 3.4. The table was measured on the filter's output, which at 50 Hz and with
    the densities above has 0.85 of its input's variance."""
    variance_wheel_yaw_rate: float = parameter(0.03, unit="rad2/s2", low=0.0, open_low=True)
    """Variance of the wheels' yaw rate [rad2/s2]; from the maker's driver. It stands for slip, not for noise; if it is
    infinite, the wheels' yaw rate is not used."""
    variance_gyro: float = parameter(3.5298e-05, unit="rad2/s2", low=0.0, open_low=True)
    """Variance of the gyro's yaw rate [rad2/s2]; Tab. 3.4, of the filter's output as well."""

    def __post_init__(self) -> None:
        """Check the ranges; ValueError for a length or variance that is not positive, or a negative or infinite density."""
        check_parameters(self)

    def packed(self) -> FilterNumbers:
        """Return the fields for the kernels."""
        return FilterNumbers(*(float(getattr(self, f.name)) for f in fields(self)))


@jit
def predict(belief: Belief, dt: float, numbers: FilterNumbers) -> None:
    """Let time pass, in place: P <- F P F' + Q.

    The pose follows the midpoint rule, whose exact Jacobian is

        F = | 1  0  turn_x  along_x  half turn_x |
            | 0  1  turn_y  along_y  half turn_y |
            | 0  0    1        0         dt      |
            | 0  0    0        1          0      |
            | 0  0    0        0          1      |

    The process noise is white in continuous time, so that the covariance does not depend on how a straight path is cut into
    steps: Q is the integral of f(s) q f(s)' over the step, where an error of yaw, v or omega that is s old has moved the
    pose along its column f(s) of the Jacobian.

    The duration `dt` [s] is not negative.
    """
    m, p = belief
    v, w, half = m[V], m[W], 0.5 * dt
    heading = m[YAW] + half * w
    along_x, along_y = dt * math.cos(heading), dt * math.sin(heading)  # derivatives by v
    turn_x, turn_y = -v * along_y, v * along_x  # derivatives by yaw
    m[X] += v * along_x
    m[Y] += v * along_y
    m[YAW] += dt * w
    for j in range(5):  # P <- F P, column by column
        swing = p[YAW, j] + half * p[W, j]
        p[X, j] += turn_x * swing + along_x * p[V, j]
        p[Y, j] += turn_y * swing + along_y * p[V, j]
        p[YAW, j] += dt * p[W, j]
    for i in range(5):  # P <- P F', row by row
        swing = p[i, YAW] + half * p[i, W]
        p[i, X] += turn_x * swing + along_x * p[i, V]
        p[i, Y] += turn_y * swing + along_y * p[i, V]
        p[i, YAW] += dt * p[i, W]
    slip, q_yaw = dt * numbers.process_position, dt * numbers.process_yaw
    q_v, q_w = dt * numbers.process_v, dt * numbers.process_yaw_rate
    q_turn = q_yaw / 3.0 + q_w * dt * dt / 20.0
    x_yaw, x_w = 0.5 * q_yaw + q_w * dt * dt / 8.0, q_w * dt / 6.0
    for i in range(1, 5):  # F P F' is symmetric; the upper triangle is kept
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


@jit
def _add(p: FloatArray, i: int, j: int, value: float) -> None:
    """Add to an element of a symmetric matrix and to its mirror image."""
    p[i, j] += value
    p[j, i] += value


@jit
def update(belief: Belief, j: int, value: float, variance: float) -> None:
    """Take in one measurement of one state, in place; a NaN or a measurement of infinite variance changes nothing.

    With the gain K = P H'/S, S = H P H' + R, this is the mean m + K (z - H m) and Joseph's form of the covariance, (I - K
    H) P (I - K H)' + K R K'. Where H picks state j, the last terms of that form cancel in all rows and columns but the
    j-th, whose factor 1 - K_j is R/S: no difference of like numbers is left there, so the variance stays positive.

    Args:
        belief: the mean m and the covariance P.
        j: place of the measured state.
        value: the measurement z, in the state's unit.
        variance: variance of its noise, R > 0.
    """
    if math.isnan(value) or variance == math.inf:
        return
    m, p = belief
    column = (p[j, 0], p[j, 1], p[j, 2], p[j, 3], p[j, 4])  # P H'
    total = column[j] + variance  # S
    keep, step = variance / total, (value - m[j]) / total
    for i in range(5):
        m[i] += column[i] * step
        gain = column[i] / total
        for k in range(i, 5):
            if i == j:
                left = column[k] * keep
            elif k == j:
                left = column[i] * keep
            else:
                left = p[i, k] - gain * column[k]
            p[i, k] = left
            p[k, i] = left


@jit
def filter_step(belief: Belief, sample: SensorSample, dt: float, numbers: FilterNumbers) -> None:
    """Take in one sample of the robot's sensors, in place: let `dt` [s] pass, then use wheels and gyro.

    The wheels' v and yaw rate are used one after the other: sum and difference of two equally noisy wheels have independent
    noise. The sample is NaN where a sensor gave nothing.
    """
    predict(belief, dt, numbers)
    v, w = body_rates(sample.left, sample.right, numbers.half_track, numbers.radius)
    update(belief, V, v, numbers.variance_v)
    update(belief, W, w, numbers.variance_wheel_yaw_rate)
    update(belief, W, sample.gyro, numbers.variance_gyro)


@jit
def filter_log(log: SensorLog, numbers: FilterNumbers, belief: Belief, out: FloatArray) -> None:
    """Filter a `SensorLog`, in place; write (M, 8) `out`: the mean and the standard deviations of x, y and yaw."""
    for k in range(len(log.t)):
        sample = SensorSample(log.left[k], log.right[k], log.gyro[k])
        filter_step(belief, sample, log.t[k] - log.t[max(k - 1, 0)], numbers)
        for i in range(5):
            out[k, i] = belief.mean[i]
        for i in range(3):
            out[k, 5 + i] = math.sqrt(belief.covariance[i, i])


def initial_belief(state: State, std: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0)) -> Belief:
    """Return the belief of a filter that starts; its arrays are writable.

    Args:
        state: the robot's state as the filter believes it; lateral speed and wheels are not part of it.
        std: standard deviations of x, y [m], yaw [rad], v [m/s], omega [rad/s]. The lab's filter was set to its start
            (Sec. 4.2), so the default is 0.

    Raises:
        ValueError: a standard deviation that is negative, or a number that is not finite.
    """
    mean = frozen_array([state.x, state.y, state.yaw, state.v_x, state.yaw_rate], "the filter's start", (5,))
    deviations = frozen_array(std, "the start's standard deviations", (5,))
    if np.any(deviations < 0.0):
        raise ValueError(f"a standard deviation must not be negative, got {tuple(std)}")
    return Belief(mean.copy(), np.diag(np.square(deviations)))


def run_ekf(
    t: ArrayLike,
    left: ArrayLike,
    right: ArrayLike,
    gyro: ArrayLike | None,
    settings: EkfSettings,
    start: State,
    start_std: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
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

    Returns:
        The estimate after each sample, with lateral speed 0 and the wheels as measured. Channel `pose_std` is (M, 3), the
        standard deviations of x, y [m] and yaw [rad].

    Raises:
        ValueError: lengths differ, time does not increase, or a number other than a missing gyro sample is not finite.
    """
    times = increasing(t)
    wheels = np.column_stack([frozen_array(a, name, (len(times),)) for a, name in ((left, "left"), (right, "right"))])
    turning = np.full(len(times), np.nan) if gyro is None else np.array(gyro, dtype=np.float64)
    frozen_array(np.where(np.isnan(turning), 0.0, turning), "gyro", (len(times),))
    out = np.empty((len(times), 8))
    belief = initial_belief(start, start_std)
    filter_log(SensorLog(times, wheels[:, 0].copy(), wheels[:, 1].copy(), turning), settings.packed(), belief, out)
    twist = np.column_stack([out[:, V], np.zeros(len(times)), out[:, W]])
    return Trajectory(times, out[:, :3], twist, wheels, {"pose_std": out[:, 5:]})


def increasing(t: ArrayLike) -> FloatArray:
    """Return (M,) instants as a read-only array.

    Raises:
        ValueError: they do not increase, or are not finite.
    """
    times = frozen_array(t, "t", (None,))
    if np.any(np.diff(times) <= 0.0):
        raise ValueError(f"t must increase; it does not after sample {int(np.argmax(np.diff(times) <= 0.0))}")
    return times
