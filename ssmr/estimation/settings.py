"""What an extended Kalman filter assumes about the robot and its sensors, and how drives with a known truth tell it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ssmr.parameters import check_parameters, packed, parameter
from ssmr.robot.sensors import SensorModel
from ssmr.types import FloatArray, Trajectory

X, Y, YAW, V, W, BIAS, LEFT, RIGHT, TURNING, SHIFT, SLIDE = range(11)
"""Places in the filter's state of x [m], y [m], yaw [rad], v [m/s], omega [rad/s], the gyro's bias [rad/s], the scales of
the left and of the right wheels [1], the turning ratio [1], the shift and the slide [m]."""
NEUTRAL = (0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
"""The constants of a robot whose gyro shows 0 at rest and whose wheels roll as the odometry assumes."""


class Belief(NamedTuple):
    """Everything that a filter remembers: the state it believes in, and how sure of it it is."""

    mean: FloatArray  # (n,) x [m], y [m], yaw [rad], v [m/s], omega [rad/s]; n is 5, or 11 for a filter that learns
    covariance: FloatArray  # (n, n) covariance of these, symmetric


STANDING = 1e-4
"""Standard deviation of the speed [m/s] and of the yaw rate [rad/s] of a robot that stands."""


@dataclass(frozen=True)
class EkfSettings:
    """Assumptions of the filter about the robot and its sensors. The defaults are the thesis' filter.

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
    """Spectral density of slip in x and in y [m2/s]: 1 cm after 1 s, 4.5 cm after 20 s."""
    process_yaw: float = parameter(1e-6, unit="rad2/s", low=0.0, high=1e6)
    """Spectral density of yaw errors besides the gyro's noise [rad2/s]: 1 mrad after 1 s."""
    process_v: float = parameter(0.025, unit="m2/s3", low=0.0, high=1e6)
    """Spectral density of white acceleration [m2/s3], from the stock filter; 0.7 m/s2 over each command of 0.05 s."""
    process_yaw_rate: float = parameter(0.02, unit="rad2/s3", low=0.0, high=1e6)
    """Spectral density of white yaw acceleration [rad2/s3], from the stock filter; 0.6 rad/s2 over each command."""
    variance_v: float = parameter(5.0115e-05, unit="m2/s2", low=0.0, open_low=True)
    """Variance of the wheels' v [m2/s2]; Tab. 3.4. The table was measured on the filter's output, which at 50 Hz and with
    the densities above has 0.85 of its input's variance."""
    variance_wheel_yaw_rate: float = parameter(0.03, unit="rad2/s2", low=0.0, open_low=True)
    """Variance of the wheels' yaw rate [rad2/s2]; from the maker's driver. It stands for slip, not for noise; if it is
    infinite, the wheels' yaw rate is not used."""
    variance_gyro: float = parameter(3.5298e-05, unit="rad2/s2", low=0.0, open_low=True)
    """Variance of the gyro's yaw rate [rad2/s2]; Tab. 3.4, of the filter's output as well."""
    slip_along: float = parameter(0.0, unit="m", low=0.0, high=1e6)
    """Variance of slip along the robot for each metre that a side's wheels roll [m2/m]. Unlike `process_position`, it is
    none for a robot that stands."""
    slip_across: float = parameter(0.0, unit="m", low=0.0, high=1e6)
    """Variance of slip across the robot for each metre that a side's wheels roll [m2/m]."""
    slip_turn: float = parameter(0.0, unit="rad2/m", low=0.0, high=1e6)
    """Variance of the error of the wheels' yaw for each metre that a side rolls [rad2/m], besides that of the noise."""
    bias: float = parameter(0.0, unit="rad/s", low=-1e6, high=1e6)
    """Reading of the gyro at rest, as the filter believes at start-up [rad/s]."""
    bias_std: float = parameter(0.0, unit="rad/s", low=0.0, high=1e6)
    """Standard deviation of the gyro's bias at start-up [rad/s]; 0 if it is known to be none."""
    bias_walk: float = parameter(0.0, unit="rad2/s3", low=0.0, high=1e6)
    """Spectral density of the bias' random walk [rad2/s3]."""
    scale_left: float = parameter(1.0, unit="1", low=0.0, high=1e6, open_low=True)
    """Scale of the left wheels at start-up [1]: the rate that they show over the rate at which they would roll."""
    scale_right: float = parameter(1.0, unit="1", low=0.0, high=1e6, open_low=True)
    """Scale of the right wheels at start-up [1]."""
    scale_std: float = parameter(0.0, unit="1", low=0.0, high=1e6)
    """Standard deviation of each of the two scales at start-up [1]."""
    turning: float = parameter(1.0, unit="1", low=0.0, high=1e6, open_low=True)
    """Turning ratio at start-up [1]: the yaw rate of the odometry over the robot's, for wheels of equal scales."""
    turning_std: float = parameter(0.0, unit="1", low=0.0, high=1e6)
    """Standard deviation of the turning ratio [1]; the filter takes it into account and does not learn the ratio."""
    shift: float = parameter(0.0, unit="m", low=-1e6, high=1e6)
    """Forward speed of the reference point, less that of the wheels, over the yaw rate at start-up [m]: how far to the right
    of the middle about which the robot turns that point is."""
    slide: float = parameter(0.0, unit="m", low=-1e6, high=1e6)
    """Lateral speed of the reference point over the yaw rate at start-up [m]: how far ahead of the middle about which the
    robot turns that point is."""
    centre_std: float = parameter(0.0, unit="m", low=0.0, high=1e6)
    """Standard deviation of shift and slide at start-up [m]."""

    def __post_init__(self) -> None:
        """Check the ranges; ValueError for a length or variance that is not positive, or a negative or infinite density."""
        check_parameters(self)

    @property
    def constants(self) -> tuple[float, ...]:
        """The constants that the filter begins with, in the order of its states.

        These are the gyro's bias [rad/s], the scales of the left and of the right wheels [1], the turning ratio [1], the
        shift and the slide [m].
        """
        return self.bias, self.scale_left, self.scale_right, self.turning, self.shift, self.slide

    @property
    def constants_std(self) -> tuple[float, ...]:
        """Standard deviations of `constants` at start-up."""
        return self.bias_std, self.scale_std, self.scale_std, self.turning_std, self.centre_std, self.centre_std

    @property
    def learns(self) -> bool:
        """True if the filter has states for the constants: they are uncertain, or not those of the odometry."""
        return any(self.constants_std) or self.constants != NEUTRAL

    def packed(self) -> Any:
        """Return the settings as a named tuple for the kernels."""
        return packed(self)


NO_NUMBERS = packed(EkfSettings())
"""Template for `named_like`."""

_STRETCHES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Durations over which slip is summed [s]. The worst counts: slip that lasts as long as a curve adds up over the curve."""
PROCESS = 0.1
"""Spectral density of white acceleration [m2/s3] and of yaw acceleration [rad2/s3] of a filter that is commissioned: 1.4
m/s2 or rad/s2 over each command of 0.05 s. With less, the way of a start is lost while the filter hesitates to believe it;
with more, it doubts what happens between two samples."""


BIAS_STD, SCALE_STD, TURNING_SHARE, CENTRE_STD = 0.0156, 0.02, 0.1, 0.01
"""Standard deviations by which robots differ from the one that was commissioned: bias of the gyro [rad/s], scale of each
side's wheels [1], turning ratio over itself [1], and middle of turning [m] in both directions."""


def commission(drives: Sequence[Trajectory], settings: EkfSettings) -> EkfSettings:
    """Return a filter that knows a robot's constants, from drives with turns to both sides.

    The wheels of a side roll at k (v - y omega), with y = shift +- half-track, so that two linear regressions of the wheels'
    rates on the true v and omega give both scales, the turning ratio and the shift; a third, of the lateral speed on omega,
    gives the slide. What these leave is slip: white, with the variance per metre that its sum has over the worst of several
    durations.

    `drives` are true motions of the robot's reference point with the true rates of its wheels; `settings` has wheel radius
    and half-track of the driver, and all that is not found here.

    Raises:
        ValueError: the drives do not turn, or do not move.
    """
    r, h = settings.radius, settings.half_track
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
    return replace(
        _with_noise(settings),
        slip_along=_slip_per_metre(drives, [s[0] for s in slips], ways),
        slip_across=_slip_per_metre(drives, [s[1] for s in slips], ways),
        slip_turn=_slip_per_metre(drives, [s[2] for s in slips], ways),
        scale_left=float(left), scale_right=float(right), turning=float(turning), shift=float(shift), slide=slide,
        bias_std=BIAS_STD, scale_std=SCALE_STD, turning_std=TURNING_SHARE * float(turning), centre_std=CENTRE_STD,
    )  # fmt: skip


def learning(settings: EkfSettings) -> EkfSettings:
    """Return a filter for a robot that nobody has commissioned: it doubts the driver's numbers, and learns what it can.

    The doubts are round numbers of the size of what `commission` finds of the shipped robots in MuJoCo, set by eye: scales
    that are 5 % wrong, turning ratios up to twice the driver's, a middle of turning 5 cm from the reference point. The bias
    is that of data sheets of small gyros: 1 degree/s at start-up, which a real Husky's 0.0156 rad/s is within, and a walk of
    18 degrees/h after 1000 s.
    """
    return replace(
        _with_noise(settings),
        slip_along=1e-4, slip_across=1e-4, slip_turn=0.02,
        bias_std=0.02, bias_walk=8e-12, scale_std=0.05, turning_std=0.6, centre_std=0.05,
    )  # fmt: skip


def _with_noise(settings: EkfSettings) -> EkfSettings:
    """Return a filter whose variances are those of a `SensorModel`, and whose process noise is slip alone."""
    noise, h = SensorModel(), settings.half_track
    variance = 0.5 * settings.radius**2 * noise.variance_encoder
    return replace(
        settings,
        process_position=0.0, process_yaw=0.0, process_v=PROCESS, process_yaw_rate=PROCESS,
        variance_v=variance, variance_wheel_yaw_rate=variance / (h * h), variance_gyro=noise.variance_gyro,
    )  # fmt: skip


def zeroed(settings: EkfSettings, gyro: FloatArray) -> EkfSettings:
    """Return a filter that has learned its gyro's bias at rest, where it is all that the gyro shows besides its noise.

    On the way only the wheels tell of the bias, and their slip hides it: what the filter believes at the start it believes
    for the whole drive. `gyro` are (N,) yaw rates shown while the robot stood [rad/s]; a filter that is sure stays as it is.
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
