"""A gyro's bias, learned whenever the robot stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr._jit import jit
from ssmr.estimation.ekf import increasing
from ssmr.parameters import check_parameters, parameter
from ssmr.types import FloatArray, frozen_array


@dataclass(frozen=True)
class BiasSettings:
    """Assumptions about a gyro's bias."""

    start_std: float = parameter(0.02, unit="rad/s", low=0.0, high=1e6)
    """Standard deviation at start-up [rad/s]: 1 degree/s, as in data sheets of small gyros. A real Husky's on tile had
    -0.0156."""
    walk: float = parameter(8e-12, unit="rad2/s3", low=0.0, high=1e6)
    """Spectral density of its random walk [rad2/s3]: 18 degrees/h after 1000 s, the in-run stability in such data sheets."""
    variance: float = parameter(3.5298e-05, unit="rad2/s2", low=0.0, high=1e6, open_low=True)
    """Variance of a gyro sample at rest [rad2/s2]; Tab. 3.4, as the filter's."""

    def __post_init__(self) -> None:
        """Check the ranges; ValueError for a negative deviation or density, or a variance that is not positive."""
        check_parameters(self)


@jit
def _learn(
    t: FloatArray, gyro: FloatArray, still: NDArray[np.bool_], prior: tuple[float, float, float], out: FloatArray
) -> None:
    """Run the scalar Kalman filter of the bias; write (M, 2) `out`: the bias after each sample and its variance.

    `prior` is the variance at start-up, the density of the walk and the variance of a sample.
    """
    bias, (p, walk, variance) = 0.0, prior
    for k in range(len(t)):
        p += walk * (t[k] - t[max(k - 1, 0)])
        if still[k]:
            total = p + variance
            bias += p / total * (gyro[k] - bias)
            p *= variance / total
        out[k, 0], out[k, 1] = bias, p


def learn_bias(t: ArrayLike, gyro: ArrayLike, still: ArrayLike, settings: BiasSettings | None = None) -> FloatArray:
    """Estimate a gyro's bias at each instant, from the samples up to then.

    A robot that stands does not turn, so each sample is then a measurement of the bias, gyro = b + noise, and b is a random
    walk: db = sqrt(walk) dW. Nothing else measures it: while the robot moves, the wheels' yaw rate is off by an unknown
    slip. The Kalman filter of b is therefore a scalar one beside that of the pose; subtract its estimate from the gyro.

    Args:
        t: (M,) instants of the samples [s], increasing.
        gyro: (M,) yaw rate as shown [rad/s].
        still: (M,) bool, True where the robot stood.
        settings: prior, walk and noise; `BiasSettings()` if not given.

    Returns:
        (M, 2) the bias after each sample [rad/s], 0 before the first rest, and its standard deviation [rad/s].

    Raises:
        ValueError: lengths differ, time does not increase, or a number is not finite.
    """
    s = settings or BiasSettings()
    times = increasing(t)
    shown = frozen_array(gyro, "gyro", (len(times),))
    stood = np.array(still, dtype=np.bool_)
    if stood.shape != times.shape:
        raise ValueError(f"still has shape {stood.shape}, wanted {times.shape}")
    out = np.empty((len(times), 2))
    _learn(times, shown, stood, (float(s.start_std**2), float(s.walk), float(s.variance)), out)
    out[:, 1] = np.sqrt(out[:, 1])
    return out
