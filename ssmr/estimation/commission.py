"""Commissioning of a state filter: constants of the robot and the size of its slip, from drives whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssmr.estimation.sensing import SensorModel
from ssmr.estimation.settings import EkfSettings
from ssmr.types import FloatArray, Trajectory

_STRETCHES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Durations over which slip is summed [s]. The worst counts: slip that lasts as long as a curve adds up over the curve."""
PROCESS = 0.1
"""Spectral density of white acceleration [m2/s3] and of yaw acceleration [rad2/s3] of a filter that is commissioned: 1.4
m/s2 or rad/s2 over each command of 0.05 s. With less, the way of a start is lost while the filter hesitates to believe it;
with more, it doubts what happens between two samples."""


BIAS_STD, SCALE_STD, TURNING_SHARE, CENTRE_STD = 0.0156, 0.02, 0.1, 0.01
"""Standard deviations by which robots differ from the one that was commissioned: bias of the gyro [rad/s], scale of each
side's wheels [1], turning ratio over itself [1], and middle of turning [m] in both directions."""


def commission(drives: Sequence[Trajectory], settings: EkfSettings, sensors: SensorModel | None = None) -> EkfSettings:
    """Return a filter that knows a robot's constants, from drives with turns to both sides.

    The wheels of a side roll at k (v - y omega), with y = shift +- half-track, so that two linear regressions of the wheels'
    rates on the true v and omega give both scales, the turning ratio and the shift; a third, of the lateral speed on omega,
    gives the slide. What these leave is slip: white, with the variance per metre that its sum has over the worst of several
    durations.

    Args:
        drives: true motions of the robot's reference point and the true rates of its wheels.
        settings: wheel radius and half-track of the driver, and all that is not found here.
        sensors: noise of encoders and gyro; `SensorModel()` if not given.

    Returns:
        The settings with constants and their doubts, slip, process noise and variances.

    Raises:
        ValueError: the drives do not turn, or do not move.
    """
    noise, r, h = sensors or SensorModel(), settings.radius, settings.half_track
    v, lateral, w = np.concatenate([d.twist for d in drives]).T
    if not (np.any(w) and np.any(v)):
        raise ValueError("commissioning needs drives that move and turn")
    shown = r * np.concatenate([d.wheels for d in drives])
    (left, left_w), (right, right_w) = np.linalg.lstsq(np.column_stack([v, w]), shown)[0].T
    both, uneven = 0.5 * (left + right), 0.5 * (right - left)
    turning, shift = 0.5 * both * (right_w / right - left_w / left) / h, -0.5 * (left_w / left + right_w / right)
    slide = float(lateral @ w / (w @ w))
    slips = []
    for d in drives:
        (one, other), ahead = r * d.wheels.T, d.twist[:, 0] - shift * d.twist[:, 2]
        along = (0.5 * (one + other) - uneven * h * turning / both * d.twist[:, 2]) / both - ahead
        across = d.twist[:, 1] - slide * d.twist[:, 2]
        turn = 0.5 * (other - one) / h - uneven / h * ahead - turning * d.twist[:, 2]
        slips.append(np.stack([along, across, turn]))
    ways = [np.abs(d.twist[:, 0]) + h * np.abs(d.twist[:, 2]) for d in drives]
    speed_variance = 0.5 * r * r * noise.variance_encoder
    return replace(
        settings,
        process_position=0.0, process_yaw=0.0, process_v=PROCESS, process_yaw_rate=PROCESS,
        variance_v=speed_variance, variance_wheel_yaw_rate=speed_variance / (h * h), variance_gyro=noise.variance_gyro,
        slip_along=_slip_per_metre(drives, [s[0] for s in slips], ways),
        slip_across=_slip_per_metre(drives, [s[1] for s in slips], ways),
        slip_turn=_slip_per_metre(drives, [s[2] for s in slips], ways),
        scale_left=float(left), scale_right=float(right), turning=float(turning), shift=float(shift), slide=slide,
        bias_std=BIAS_STD, scale_std=SCALE_STD, turning_std=TURNING_SHARE * float(turning), centre_std=CENTRE_STD,
    )  # fmt: skip


def learning(settings: EkfSettings, sensors: SensorModel | None = None) -> EkfSettings:
    """Return a filter for a robot that nobody has commissioned: it doubts the driver's numbers, and learns what it can.

    The doubts are round numbers of the size of what `commission` finds of the shipped robots in MuJoCo, set by eye: scales
    that are 5 % wrong, turning ratios up to twice the driver's, a middle of turning 5 cm from the reference point. The bias
    is that of data sheets of small gyros: 1 degree/s at start-up, which a real Husky's 0.0156 rad/s is within, and a walk of
    18 degrees/h after 1000 s. `settings` and `sensors` are as for `commission`.
    """
    noise, r, h = sensors or SensorModel(), settings.radius, settings.half_track
    speed_variance = 0.5 * r * r * noise.variance_encoder
    return replace(
        settings,
        process_position=0.0, process_yaw=0.0, process_v=PROCESS, process_yaw_rate=PROCESS,
        variance_v=speed_variance, variance_wheel_yaw_rate=speed_variance / (h * h), variance_gyro=noise.variance_gyro,
        slip_along=1e-4, slip_across=1e-4, slip_turn=0.02,
        bias_std=0.02, bias_walk=8e-12, scale_std=0.05, turning_std=0.6, centre_std=0.05,
    )  # fmt: skip


def stood(settings: EkfSettings, gyro: FloatArray) -> EkfSettings:
    """Return a filter that has learned its gyro's bias at rest, where it is all that the gyro shows besides its noise.

    On the way only the wheels tell of the bias, and their slip hides it: what the filter believes at the start it believes
    for the whole drive. It should therefore not start with one reading of the gyro.

    Args:
        settings: the filter before; if it has no doubt of the bias, it stays as it is.
        gyro: (N,) yaw rates that the gyro showed while the robot stood [rad/s].
    """
    prior, noise = settings.bias_std**2, settings.variance_gyro
    total = len(gyro) * prior + noise
    bias = settings.bias + prior / total * float(np.sum(gyro - settings.bias))
    return replace(settings, bias=bias, bias_std=math.sqrt(prior * noise / total))


def _slip_per_metre(drives: Sequence[Trajectory], slips: Sequence[FloatArray], ways: Sequence[FloatArray]) -> float:
    """Return the variance of slip per metre that a side's wheels roll, over the worst of several durations."""
    worst = 0.0
    for duration in _STRETCHES:
        off, far = 0.0, 0.0
        for d, slip, way in zip(drives, slips, ways, strict=True):
            n = round(duration / float(np.median(np.diff(d.t))))
            sums = [np.cumulative_sum(np.diff(d.t) * a[1:], include_initial=True) for a in (slip, way)]
            off, far = (
                off + float(np.sum((sums[0][n:] - sums[0][:-n]) ** 2)),
                far + float(np.sum(sums[1][n:] - sums[1][:-n])),
            )
        worst = max(worst, off / far) if far > 0.0 else worst
    return worst
