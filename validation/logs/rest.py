"""Times at which the robot stands, by its wheels, and the bias that its gyro shows then."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import source
from ssmr.estimation.settings import EkfSettings
from ssmr.robot.drive import body_rates
from ssmr.types import FloatArray
from validation.logs.groups import Group, Groups
from validation.logs.recording import TIME_ROUNDOFF, RecordingError

_REST_V = 0.01
"""A robot stands if its wheels' speed, averaged over `2 _REST_MARGIN`, is below this [m/s]; noisy encoders show a third."""
_REST_W = 0.02
"""A robot stands if its wheels' yaw rate, averaged likewise, is below this [rad/s]."""
_REST_MARGIN = 0.5
"""Samples that lie nearer to a motion than this do not count as rest [s]: odometry may be late."""
REST_LEAST = 2.0
"""Shortest total rest from which a bias is taken [s]."""
WHEELS_MEAN_S = 0.25
"""Time before and after an instant over which wheel rates are averaged, against the noise of encoders [s]."""
WHEELS_TURN = 0.1
"""Wheel rate above which a wheel turns [rad/s]: 16 mm/s of a Husky, well above the noise of means of encoders."""
ASKS_FOR_MOTION = 0.01
"""Size of a command above which it asks for motion [m/s, rad/s]."""


@dataclass(frozen=True)
class Rest:
    """Readings of a gyro while the wheels stand."""

    bias: float
    """Mean of the readings [rad/s]."""
    std: float
    """Standard deviation of single readings [rad/s]."""
    seconds: float
    """Total time at rest [s]."""


STOCK = EkfSettings()
"""The state filter of a stock Husky, whose wheel radius and half-track convert encoders of a robot that nobody named."""


def wheel_twist(groups: Groups, settings: EkfSettings = STOCK) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return (M,) stamps [s], v [m/s] and yaw rate [rad/s] from encoders or else odometry; None without either.

    Encoders are converted with the radius and half-track of a state filter's settings.
    """
    for name, (a, b) in (("wheels", ("enc_left", "enc_right")), ("odom", ("odom_v", "odom_w"))):
        group = groups.get(name)
        if group is not None and a in group.columns and b in group.columns:
            first, second = group.columns[a], group.columns[b]
            if name == "wheels":
                first, second = source(body_rates)(first, second, settings.half_track, settings.radius)
            return group.t, first, second
    return None


def moving_mean(t: FloatArray, values: FloatArray, half: float) -> FloatArray:
    """Return the (M,) means of the values whose stamps lie within `half` [s] of each of the (M,) stamps."""
    low, high = np.searchsorted(t, t - half - TIME_ROUNDOFF), np.searchsorted(t, t + half + TIME_ROUNDOFF)
    sums = np.cumulative_sum(values, include_initial=True)
    return np.asarray((sums[high] - sums[low]) / (high - low))


def standing(groups: Groups, t: FloatArray) -> NDArray[np.bool_]:
    """Return (N,) whether the robot stood at instants `t` [s], by its wheels; False throughout where there are none."""
    wheels = wheel_twist(groups)
    if wheels is None:
        return np.zeros(len(t), dtype=bool)
    stamps, v, w = wheels
    mean = [moving_mean(stamps, a, _REST_MARGIN) for a in (v, w)]
    moving = stamps[(np.abs(mean[0]) > _REST_V) | (np.abs(mean[1]) > _REST_W)]
    at = np.concatenate([[-math.inf], moving, [math.inf]])
    after = np.searchsorted(at, t, side="right")
    margin = np.minimum(t - at[after - 1], at[np.minimum(after, len(at) - 1)] - t)
    return (margin > _REST_MARGIN) & (t >= stamps[0]) & (t <= stamps[-1])


def find_rest(groups: Groups) -> Rest | None:
    """Return the gyro's readings at rest; None without a gyro, or where the wheels stand for less than `REST_LEAST`."""
    if "imu" not in groups:
        return None
    imu = groups["imu"]
    still = standing(groups, imu.t)
    seconds = float(np.count_nonzero(still)) * imu.period
    if seconds < REST_LEAST:
        return None
    shown = imu.columns["gyro_z"][still]
    return Rest(float(np.mean(shown)), float(np.std(shown)), seconds)


def unbiased(path: Path, groups: Groups) -> dict[str, Group]:
    """Return the groups of the log at `path` with the gyro's mean at rest taken out.

    Raises:
        RecordingError: that mean is unknown.
    """
    rest = find_rest(groups)
    if rest is None:
        raise RecordingError(path, f"unbias needs a gyro, and wheels that stand for {REST_LEAST:g} s in all")
    imu = groups["imu"]
    return {**groups, "imu": replace(imu, columns={"gyro_z": imu.columns["gyro_z"] - rest.bias})}
