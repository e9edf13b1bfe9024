"""Sensors with noise and bias, and a seeded yaw disturbance (Sec. 3.4.4-3.4.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import jit, python_source
from ssmr.parameters import check_parameters, numbers_of, pack_numbers, parameter, require_in_range
from ssmr.robot.drive import Sides
from ssmr.types import FloatArray, IndexArray, Trajectory

SAMPLE_RATES_HZ = {"tracking": 120.0, "ekf": 50.0, "command": 20.0}
"""Tab. 3.5. The table's sample times (0.008, 0.020, 0.050 s) are rounded; Sec. 4.2 runs the filter
at 120 Hz."""


@dataclass(frozen=True)
class SensorNoise:
    """Variances of the state filter's output (Tab. 3.4)."""

    v_x: float = 5.0115e-05
    """Variance of the forward speed [m2/s2]."""
    yaw_rate: float = 3.5298e-05
    """Variance of the yaw rate [rad2/s2]."""
    x: float = 8.8786e-06
    """Variance of x [m2]."""
    y: float = 7.9259e-12
    """Variance of y [m2]; measured while y was not excited, so too small for a turning robot."""
    yaw: float = 1.2941e-08
    """Variance of yaw [rad2]; measured while yaw was not excited."""

    def __post_init__(self) -> None:
        """Check that no variance is negative."""
        for name in ("v_x", "yaw_rate", "x", "y", "yaw"):
            require_in_range(self, name, 0.0, 1e6)


def measure(
    trajectory: Trajectory,
    noise: SensorNoise,
    rng: np.random.Generator,
    rate: float = SAMPLE_RATES_HZ["ekf"],
) -> Trajectory:
    """Return the motion as the robot's state filter would report it: sampled, held and noisy.

    `rng` draws white noise with the variances of `noise` anew at every sample of the filter, `rate`
    a second [Hz]; between them the last value is held (zero-order hold, Sec. 3.4.6). Stamps,
    lateral speed, wheels and channels stay as they were.
    """
    tick = _sample_periods(trajectory.t, rate)
    source = np.searchsorted(tick, tick, side="left")  # the first sample of each tick
    draws = rng.standard_normal((tick[-1] + 1, 5))[tick]
    deviations = np.sqrt([noise.x, noise.y, noise.yaw, noise.v_x, noise.yaw_rate])
    pose = trajectory.pose[source] + draws[:, :3] * deviations[:3]
    twist = trajectory.twist[source].copy()
    twist[:, [0, 2]] += draws[:, 3:] * deviations[3:]
    return Trajectory(trajectory.t, pose, twist, trajectory.wheels, trajectory.channels)


def _sample_periods(t: FloatArray, rate: float) -> IndexArray:
    """Return the number of the sample period, at a rate [Hz], of each of (M,) instants [s]."""
    if not rate > 0.0:
        raise ValueError(f"the sample rate must be positive, got {rate} Hz")
    return np.asarray(np.floor((t - t[0]) * rate + 1e-9), dtype=np.intp)


YAW_DISTURBANCE_VARIANCE = 25.0
"""Variance of the disturbing yaw acceleration [rad2/s4]; Sec. 3.4.5."""
_PUSH_TIME = 0.1
"""Time for which each draw is held [s]. The thesis does not say; this is the default of Simulink's
random number block."""


def yaw_disturbance(duration: float, dt: float, rng: np.random.Generator) -> FloatArray:
    """Return (n,) disturbing yaw accelerations [rad/s2] of a run's physics steps (Sec. 3.4.5).

    The run lasts `duration` [s], with steps `dt` [s]. `rng` draws white noise, which is held. The
    draws do not depend on `dt`, so all plants of one run feel the same disturbance.
    """
    count = math.ceil(duration / _PUSH_TIME - 1e-9) + 1
    draws = math.sqrt(YAW_DISTURBANCE_VARIANCE) * rng.standard_normal(count)
    step = np.arange(round(duration / dt))
    draw = np.floor(step * dt / _PUSH_TIME + 1e-9).astype(int)
    return np.asarray(draws[draw])


class SensorLog(NamedTuple):
    """Readings of the sensors: numbers of one instant, or arrays of M for `run_ekf`.

    They are NaN for a sensor that gave nothing.
    """

    t: Any  # instant [s]
    left: Any  # rate of the left wheels [rad/s]
    right: Any  # rate of the right wheels [rad/s]
    gyro: Any  # yaw rate [rad/s]


@dataclass(frozen=True)
class SensorModel:
    """Noise of encoders and gyro.

    The encoders' resolution (78 000 ticks/m, Sec. 3.1.3: 0.6 mm/s at 50 Hz) is a tenth of their
    noise, and left out.
    """

    variance_encoder: float = parameter(0.003677, unit="rad2/s2", low=0.0, high=1e6)
    """Variance of each side's wheel rate [rad2/s2]: 2/r2 of v's variance in Tab. 3.4, which the
    mean of both sides then has."""
    variance_gyro: float = parameter(3.5298e-05, unit="rad2/s2", low=0.0, high=1e6)
    """Variance of the yaw rate [rad2/s2]; Tab. 3.4."""
    gyro_bias: float = parameter(0.0, unit="rad/s", low=-1e6, high=1e6)
    """Reading of the gyro at rest [rad/s]. A real Husky's on tile is -0.0156."""

    def __post_init__(self) -> None:
        """Check the ranges; ValueError for a negative variance, or a number that is not finite."""
        check_parameters(self)


SensorNumbers = numbers_of(SensorModel)


@jit
def sense_rates(
    t: float, wheels: Sides, yaw_rate: float, draws: tuple[float, float, float], noise: Any
) -> SensorLog:
    """Return the readings of encoders and gyro for true rates of wheels and body [rad/s] at `t`.

    `draws` are three standard normal numbers, for left, right and gyro, which the caller draws;
    `noise` is a packed `SensorModel`.
    """
    of_wheels = math.sqrt(noise.variance_encoder)
    return SensorLog(
        t,
        wheels.left + of_wheels * draws[0],
        wheels.right + of_wheels * draws[1],
        yaw_rate + math.sqrt(noise.variance_gyro) * draws[2] + noise.gyro_bias,
    )


def simulate_sensors(
    trajectory: Trajectory,
    rng: np.random.Generator,
    model: SensorModel | None = None,
    rate: float = SAMPLE_RATES_HZ["ekf"],
) -> SensorLog:
    """Return the readings of a robot's sensors along a motion; by default of a `SensorModel()`.

    There are `rate` samples a second [Hz]; for each `rng` draws three numbers. Each is the first
    state of the motion in its period, with that state's own instant, so a motion whose samples do
    not divide the period gives irregular ones.

    Raises:
        ValueError: a rate that is not positive.
    """
    tick = _sample_periods(trajectory.t, rate)
    first = np.unique(tick, return_index=True)[1]
    wheels = Sides(*trajectory.wheels[first].T)
    yaw_rate = trajectory.twist[first, 2]
    draws = rng.standard_normal((len(first), 3)).T
    errors = pack_numbers(model or SensorModel())
    on_arrays: Any = python_source(sense_rates)
    log: SensorLog = on_arrays(trajectory.t[first], wheels, yaw_rate, draws, errors)
    return log
