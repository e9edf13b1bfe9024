"""Extended Kalman filter of a robot's wheel encoders and gyro (Sec. 3.1.3): where it thinks it is, and how sure it is.

The state is (x, y, yaw, v, omega) of the reference point, yaw unwrapped. As in the stock filter of a Husky (the ROS package
robot_localization, `two_d_mode`) both velocities stay as they are but for white accelerations, and every measurement is
linear: v and omega as the driver's own odometry has them from the wheels (Eq. 2.9), omega from the gyro. Nothing measures
the pose, so its uncertainty only grows; lateral speed is taken to be 0.

All that a filter remembers is one float array, its `memory`, (30,): the mean, then the 5 x 5 covariance by rows. The kernels
update it in place, allocate nothing, and run as well inside other compiled loops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ssmr._jit import jit, source
from ssmr.parameters import require_in_range
from ssmr.robot.drive import body_rates
from ssmr.robot.sensors import SAMPLE_RATES_HZ
from ssmr.types import FloatArray, State, Trajectory, frozen_array

MEMORY = 30
"""Numbers in a filter's memory: x [m], y [m], yaw [rad], v [m/s], omega [rad/s], and their covariance by rows."""


@dataclass(frozen=True)
class EkfSettings:
    """What the filter believes of the robot and of its sensors.

    A skidding robot's wheels know its yaw rate only through `half_track`. Unless that is the effective one, they overstate
    it, by 1.8 on tile; so by default the gyro is trusted, and the wheels' yaw rate has the large variance that the stock
    driver claims for it. Both are fused, as on a stock Husky, the wheels with a weight of a thousandth of the gyro's.
    """

    radius: float = 0.1651
    """Wheel radius of the odometry [m]; as the driver's."""
    half_track: float = 0.275
    """Half-track of the odometry, half of (separation x multiplier) [m]; as the driver's, that is: no slip."""
    process_position: float = 1e-4
    """Spectral density of what slip adds to x and to y [m2/s]: 1 cm after 1 s, 4.5 cm after 20 s. Isotropic, so that no
    frame is preferred."""
    process_yaw: float = 1e-6
    """The same of yaw [rad2/s]: 1 mrad after 1 s, for what a gyro errs besides its noise."""
    process_v: float = 0.025
    """Spectral density of white acceleration [m2/s3]; stock filter. As much as 0.7 m/s2, drawn anew every 0.05 s command."""
    process_yaw_rate: float = 0.02
    """Spectral density of white yaw acceleration [rad2/s3]; stock filter. As much as 0.6 rad/s2 a command; trajectory 4 has
    0.83 rms, and the robot's limit is 6."""
    variance_v: float = 5.0115e-05
    """Of the wheels' v [m2/s2]; Tab. 3.4. That was measured on the filter's output, which at 50 Hz and with the densities
    above has 0.85 of its input's variance."""
    variance_wheel_yaw_rate: float = 0.03
    """Of the wheels' yaw rate [rad2/s2]; the maker's driver. It stands for slip, not for noise; infinite: not used."""
    variance_gyro: float = 3.5298e-05
    """Of the gyro's yaw rate [rad2/s2]; Tab. 3.4, of the filter's output as well."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a length or a variance that is not positive, a negative or infinite density.
        """
        for f in fields(self):
            if f.name.startswith("process"):
                require_in_range(self, f.name, 0.0, 1e6)
            else:
                high = math.inf if f.name.startswith("variance") else 1e6
                require_in_range(self, f.name, 0.0, high, open_low=True)

    def packed(self) -> FloatArray:
        """(9,) the fields in their order, for the compiled loops."""
        return np.array([getattr(self, f.name) for f in fields(self)], dtype=np.float64)


@jit
def predict(memory, dt, process):
    """Let time pass, in place: midpoint rule for the pose, its exact Jacobian for the covariance.

    The noise is white in continuous time, so that the covariance does not depend on how a straight way is cut into steps: an
    error of yaw, v or omega that is t old moves x and y along its own column of the Jacobian, as t or, of omega, as t^2.

    Args:
        memory: (30,) the filter's memory.
        dt: how long [s], not negative.
        process: spectral densities of x and of y [m2/s], yaw [rad2/s], v [m2/s3] and omega [rad2/s3].
    """
    v, w, half = memory[3], memory[4], 0.5 * dt
    heading = memory[2] + half * w
    along_x, along_y = dt * math.cos(heading), dt * math.sin(heading)  # of v
    turn_x, turn_y = -v * along_y, v * along_x  # of yaw; half a dt of it of omega
    memory[0] += v * along_x
    memory[1] += v * along_y
    memory[2] += dt * w
    for k in range(5, 10):  # F P, a column at a time
        swing = memory[k + 10] + half * memory[k + 20]
        memory[k] += turn_x * swing + along_x * memory[k + 15]
        memory[k + 5] += turn_y * swing + along_y * memory[k + 15]
        memory[k + 10] += dt * memory[k + 20]
    for k in range(5, 30, 5):  # (F P) F', a row at a time
        swing = memory[k + 2] + half * memory[k + 4]
        memory[k] += turn_x * swing + along_x * memory[k + 3]
        memory[k + 1] += turn_y * swing + along_y * memory[k + 3]
        memory[k + 2] += dt * memory[k + 4]
    for i in range(1, 5):
        for j in range(i):
            memory[5 + 5 * i + j] = memory[5 + 5 * j + i]
    slip, q_yaw, q_v, q_w = dt * process[0], dt * process[1], dt * process[2], dt * process[3]
    q_turn = q_yaw / 3.0 + q_w * dt * dt / 20.0
    xy = q_turn * turn_x * turn_y + q_v / 3.0 * along_x * along_y
    x_yaw, x_w = 0.5 * q_yaw + q_w * dt * dt / 8.0, q_w * dt / 6.0
    memory[5] += slip + q_turn * turn_x * turn_x + q_v / 3.0 * along_x * along_x
    memory[11] += slip + q_turn * turn_y * turn_y + q_v / 3.0 * along_y * along_y
    memory[17] += q_yaw + q_w * dt * dt / 3.0
    memory[23] += q_v
    memory[29] += q_w
    _add(memory, 6, 10, xy)
    _add(memory, 7, 15, x_yaw * turn_x)
    _add(memory, 12, 16, x_yaw * turn_y)
    _add(memory, 8, 20, 0.5 * q_v * along_x)
    _add(memory, 13, 21, 0.5 * q_v * along_y)
    _add(memory, 9, 25, x_w * turn_x)
    _add(memory, 14, 26, x_w * turn_y)
    _add(memory, 19, 27, half * q_w)


@jit
def _add(memory, above, below, value):
    """Add to an element of the covariance and to its mirror image."""
    memory[above] += value
    memory[below] += value


@jit
def update(memory, index, value, variance):
    """Take in one measurement of one state, in place; of a value that is NaN or a variance that is infinite, nothing.

    Joseph's form, (I - K H) P (I - K H)' + K R K'. Where H picks state j its last terms cancel in all rows and columns but
    the j-th, whose factor 1 - K_j is R/S: nothing is left there to cancel, so the variance stays positive.

    Args:
        memory: (30,) the filter's memory.
        index: which state, j: 0 x, 1 y, 2 yaw, 3 v, 4 omega.
        value: what was measured, in the state's unit.
        variance: of its noise, R > 0.
    """
    if math.isnan(value) or variance == math.inf:
        return
    row = 5 + 5 * index
    p = (memory[row], memory[row + 1], memory[row + 2], memory[row + 3], memory[row + 4])
    total = p[index] + variance  # S
    keep, step = variance / total, (value - memory[index]) / total
    for i in range(5):
        memory[i] += p[i] * step
        gain = p[i] / total
        for j in range(i, 5):
            if i == index:
                left = p[j] * keep
            elif j == index:
                left = p[i] * keep
            else:
                left = memory[5 + 5 * i + j] - gain * p[j]
            memory[5 + 5 * i + j] = left
            memory[5 + 5 * j + i] = left


@jit
def update_wheels(memory, v, w, var_v, var_w):
    """Take in the wheels' v [m/s] and yaw rate [rad/s], in place.

    One after the other: a sum and a difference of two wheels that are equally noisy have independent noise.
    """
    update(memory, 3, v, var_v)
    update(memory, 4, w, var_w)


@jit
def update_gyro(memory, w, var):
    """Take in the gyro's yaw rate [rad/s], in place; NaN: there is none."""
    update(memory, 4, w, var)


@jit
def filter_step(memory, left, right, gyro, dt, numbers):
    """One sample of the robot's sensors, in place: let `dt` pass, then take in wheels and gyro.

    Args:
        memory: (30,) the filter's memory.
        left: rate of the left wheels [rad/s]; NaN: no encoders.
        right: rate of the right wheels [rad/s].
        gyro: yaw rate [rad/s]; NaN: none.
        dt: time since the last sample [s].
        numbers: `EkfSettings.packed()`, as an array or a tuple.
    """
    predict(memory, dt, (numbers[2], numbers[3], numbers[4], numbers[5]))
    v, w = body_rates(left, right, numbers[1], numbers[0])
    update_wheels(memory, v, w, numbers[6], numbers[7])
    update_gyro(memory, gyro, numbers[8])


@jit
def run_filter(t, left, right, gyro, numbers, memory, out):
    """Filter a whole log, in place; writes (M, 8) `out`: the mean and the standard deviations of x, y and yaw."""
    for k in range(len(t)):
        filter_step(memory, left[k], right[k], gyro[k], t[k] - t[max(k - 1, 0)], numbers)
        for i in range(5):
            out[k, i] = memory[i]
        for i in range(3):
            out[k, 5 + i] = math.sqrt(memory[5 + 6 * i])


@dataclass(frozen=True)
class BiasSettings:
    """What is believed of a gyro's bias."""

    start_std: float = 0.02
    """Standard deviation at switch-on [rad/s]: 1 degree/s, as makers' sheets of small gyros have it. A real Husky's on tile
    had -0.0156."""
    walk: float = 8e-12
    """Spectral density of its random walk [rad2/s3]: 18 degrees/h after 1000 s, the in-run stability on such sheets."""
    variance: float = 3.5298e-05
    """Of a gyro sample at rest [rad2/s2]; Tab. 3.4, as the filter's."""

    def __post_init__(self) -> None:
        """Check; ValueError for a deviation or a density that is negative, a variance that is not positive."""
        require_in_range(self, "start_std", 0.0, 1e6)
        require_in_range(self, "walk", 0.0, 1e6)
        require_in_range(self, "variance", 0.0, 1e6, open_low=True)


@jit
def run_bias(t, gyro, still, start_variance, walk, variance, out):
    """Learn a gyro's bias over a whole log, in place; writes (M, 2) `out`: the bias after each sample and its variance."""
    bias, p = 0.0, start_variance
    for k in range(len(t)):
        p += walk * (t[k] - t[max(k - 1, 0)])
        if still[k]:
            total = p + variance
            bias += p / total * (gyro[k] - bias)
            p *= variance / total
        out[k, 0], out[k, 1] = bias, p


def learn_bias(t: ArrayLike, gyro: ArrayLike, still: ArrayLike, settings: BiasSettings | None = None) -> FloatArray:
    """What a gyro's bias is, as far as was known at each instant.

    A robot that stands turns at zero, so each sample is then a measurement of the bias, gyro = b + noise, and b walks at
    random: db = sqrt(walk) dW. Nothing else tells of it: while the robot moves, the wheels' yaw rate is off by an unknown
    slip. So the Kalman filter of b is a scalar one, beside that of the pose; what it says is to be taken off the gyro.

    Args:
        t: (M,) instants of the samples [s], increasing.
        gyro: (M,) yaw rate as shown [rad/s].
        still: (M,) bool, whether the robot stood.
        settings: prior, walk and noise; `BiasSettings()` if not given.

    Returns:
        (M, 2): the bias after each sample [rad/s], 0 before the first rest, and its standard deviation [rad/s].

    Raises:
        ValueError: lengths differ, time does not increase, or a number is not finite.
    """
    s = settings or BiasSettings()
    times = _increasing(t)
    shown = frozen_array(gyro, "gyro", (len(times),))
    stood = np.array(still, dtype=np.bool_)
    if stood.shape != times.shape:
        raise ValueError(f"still has shape {stood.shape}, wanted {times.shape}")
    out = np.empty((len(times), 2))
    run_bias(times, shown, stood, s.start_std**2, s.walk, s.variance, out)
    out[:, 1] = np.sqrt(out[:, 1])
    return out


def _increasing(t: ArrayLike) -> FloatArray:
    times = frozen_array(t, "t", (None,))
    if np.any(np.diff(times) <= 0.0):
        raise ValueError(f"t must increase; it does not after sample {int(np.argmax(np.diff(times) <= 0.0))}")
    return times


def initial_memory(state: State, std: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0)) -> FloatArray:
    """The memory of a filter that starts.

    Args:
        state: where it believes the robot to be, and how it moves; lateral speed and wheels are not part of it.
        std: how sure it is: standard deviations of x, y [m], yaw [rad], v [m/s], omega [rad/s]. The lab's filter was set to
            its start (Sec. 4.2), so 0 by default.

    Returns:
        (30,) memory, writable.

    Raises:
        ValueError: a standard deviation that is negative, or a number that is not finite.
    """
    memory = np.zeros(MEMORY)
    memory[:5] = frozen_array([state.x, state.y, state.yaw, state.v_x, state.yaw_rate], "the filter's start", (5,))
    deviations = frozen_array(std, "the start's standard deviations", (5,))
    if np.any(deviations < 0.0):
        raise ValueError(f"a standard deviation must not be negative, got {tuple(std)}")
    memory[5::6] = np.square(deviations)
    return memory


def covariance(memory: FloatArray) -> FloatArray:
    """(5, 5) covariance of a memory, a view of it."""
    return memory[5:].reshape(5, 5)


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
        t: (M,) instants of the samples [s], as irregular as they are.
        left: (M,) rate of the left wheels [rad/s].
        right: (M,) rate of the right wheels [rad/s].
        gyro: (M,) yaw rate [rad/s], NaN where there was no sample; `None` for a robot without one.
        settings: what the filter believes of robot and sensors.
        start: where the robot was at the first instant, whose sample is taken in as well.
        start_std: how sure that is, see `initial_memory`.

    Returns:
        The filter's opinion after each sample; lateral speed 0, the wheels as measured. Channel `pose_std`, (M, 3): its
        standard deviations of x, y [m] and yaw [rad].

    Raises:
        ValueError: lengths differ, time does not increase, or a number other than a missing gyro sample is not finite.
    """
    times = _increasing(t)
    wheels = np.column_stack([frozen_array(a, name, (len(times),)) for a, name in ((left, "left"), (right, "right"))])
    turning = np.full(len(times), np.nan) if gyro is None else np.array(gyro, dtype=np.float64)
    frozen_array(np.where(np.isnan(turning), 0.0, turning), "gyro", (len(times),))
    out = np.empty((len(times), 8))
    memory = initial_memory(start, start_std)
    run_filter(times, wheels[:, 0].copy(), wheels[:, 1].copy(), turning, settings.packed(), memory, out)
    twist = np.column_stack([out[:, 3], np.zeros(len(times)), out[:, 4]])
    return Trajectory(times, out[:, :3], twist, wheels, {"pose_std": out[:, 5:]})


@dataclass(frozen=True)
class SensorModel:
    """Noise of encoders and gyro.

    The encoders' resolution (78 000 ticks/m, Sec. 3.1.3: 0.6 mm/s at 50 Hz) is a tenth of their noise, and left out.
    """

    variance_encoder: float = 0.003677
    """Of each side's wheel rate [rad2/s2]: 2/r2 of v's variance of Tab. 3.4, so that the mean of both sides has that."""
    variance_gyro: float = 3.5298e-05
    """Of the yaw rate [rad2/s2]; Tab. 3.4."""
    gyro_bias: float = 0.0
    """What the gyro shows at rest [rad/s]; the filter does not know it. A real Husky's on tile has -0.0156."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a negative variance, or a number that is not finite.
        """
        for name in ("variance_encoder", "variance_gyro"):
            require_in_range(self, name, 0.0, 1e6)
        require_in_range(self, "gyro_bias", -1e6, 1e6)

    def packed(self) -> tuple[float, float, float]:
        """Standard deviations of encoders and gyro [rad/s] and the gyro's bias [rad/s], for the compiled loops."""
        return math.sqrt(self.variance_encoder), math.sqrt(self.variance_gyro), self.gyro_bias


class SensorLog(NamedTuple):
    """What sensors have shown, M samples of it, in the order `run_ekf` takes it."""

    t: FloatArray
    """(M,) [s]."""
    left: FloatArray
    """(M,) rate of the left wheels [rad/s]."""
    right: FloatArray
    """(M,) rate of the right wheels [rad/s]."""
    gyro: FloatArray
    """(M,) yaw rate [rad/s]."""


@jit
def sense(left, right, yaw_rate, draws, numbers):
    """What encoders and gyro show of true rates [rad/s].

    Args:
        left: rate of the left wheels [rad/s].
        right: rate of the right wheels [rad/s].
        yaw_rate: of the body [rad/s].
        draws: three standard normal numbers, of left, right and gyro: the randomness is the caller's.
        numbers: `SensorModel.packed()`.

    Returns:
        Left and right wheel rate and the gyro's yaw rate [rad/s].
    """
    return left + numbers[0] * draws[0], right + numbers[0] * draws[1], yaw_rate + numbers[1] * draws[2] + numbers[2]


def simulate_sensors(
    trajectory: Trajectory,
    rng: np.random.Generator,
    model: SensorModel | None = None,
    rate: float = SAMPLE_RATES_HZ["ekf"],
) -> SensorLog:
    """What the robot's sensors would have shown of a motion.

    Args:
        trajectory: the true motion.
        rng: the generator that draws the noise, three numbers a sample.
        model: the sensors; `SensorModel()` if not given.
        rate: samples a second [Hz]. Each is the first state of the motion in its period, with that state's own instant, so
            a motion whose samples do not divide the period gives irregular ones.

    Returns:
        The samples, in the order `run_ekf` takes them.

    Raises:
        ValueError: a rate that is not positive.
    """
    if not rate > 0.0:
        raise ValueError(f"the sample rate must be positive, got {rate} Hz")
    tick = np.floor((trajectory.t - trajectory.t[0]) * rate + 1e-9).astype(int)
    first = np.unique(tick, return_index=True)[1]
    (left, right), yaw_rate = trajectory.wheels[first].T, trajectory.twist[first, 2]
    draws = rng.standard_normal((len(first), 3)).T
    return SensorLog(trajectory.t[first], *source(sense)(left, right, yaw_rate, draws, (model or SensorModel()).packed()))
