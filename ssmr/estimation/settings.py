"""The state of an extended Kalman filter, and what it assumes about the robot and its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ssmr.parameters import check_parameters, parameter
from ssmr.types import FloatArray

X, Y, YAW, V, W, BIAS, LEFT, RIGHT, TURNING, SHIFT, SLIDE = range(11)
"""Places in the filter's state of x [m], y [m], yaw [rad], v [m/s], omega [rad/s], the gyro's bias [rad/s], the scales of
the left and of the right wheels [1], the turning ratio [1], the shift and the slide [m]."""
NEUTRAL = (0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
"""The constants of a robot whose gyro shows 0 at rest and whose wheels roll as the odometry assumes."""


class Belief(NamedTuple):
    """Everything that a filter remembers: the state it believes in, and how sure of it it is."""

    mean: FloatArray
    """(n,) x [m], y [m], yaw [rad], v [m/s], omega [rad/s]; n is 5, or 11 for a filter that learns."""
    covariance: FloatArray
    """(n, n) covariance of these, symmetric."""


class SeenPose(NamedTuple):
    """A pose that something else than wheels and gyro measured."""

    x: float
    """Position of the measured point [m]; NaN if there is none."""
    y: float
    """Position of the measured point [m]; NaN if there is none."""
    yaw: float
    """Yaw of the robot [rad]; NaN for a receiver that measures only positions."""
    variance: float
    """Variance of x and of y [m2]."""
    variance_yaw: float
    """Variance of the yaw [rad2]."""
    ahead: float = 0.0
    """Place of the measured point, ahead of the reference point [m]."""
    left: float = 0.0
    """Place of the measured point, to the left of the reference point [m]."""


NO_POSE = SeenPose(math.nan, math.nan, math.nan, math.inf, math.inf)
"""Template for `named_like`."""


class Aside(NamedTuple):
    """These fields hold what a log tells the filter besides wheels and gyro."""

    still: NDArray[np.bool_]
    """(M,) True where the robot stood."""
    poses: FloatArray
    """(N, 8) instants [s], not decreasing, at which poses were true, and the fields of `SeenPose`."""


STANDING = 1e-4
"""Standard deviation of the speed [m/s] and of the yaw rate [rad/s] of a robot that stands."""


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
    slip_along: float
    slip_across: float
    slip_turn: float
    bias_walk: float
    gate: float


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
    slip_along: float = parameter(0.0, unit="m", low=0.0, high=1e6)
    """Variance of slip along the robot for each metre that a side's wheels roll [m2/m]. Unlike `process_position`, it is
    none for a robot that stands."""
    slip_across: float = parameter(0.0, unit="m", low=0.0, high=1e6)
    """Variance of slip across the robot for each metre that a side's wheels roll [m2/m]."""
    slip_turn: float = parameter(0.0, unit="rad2/m", low=0.0, high=1e6)
    """Variance of the error of the wheels' yaw for each metre that a side's wheels roll [rad2/m], besides that of the noise,
    `variance_wheel_yaw_rate`. Unlike that one, it does not depend on how often the wheels are read."""
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
    gate: float = parameter(1.0, unit="1", low=0.0, high=1.0, open_low=True)
    """Probability with which a good measurement is used [1]: one whose squared innovation is beyond this quantile of its
    chi-squared distribution is left out. 1 uses all."""

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

    def packed(self) -> FilterNumbers:
        """Return what the kernels need."""
        named = [float(getattr(self, name)) for name in FilterNumbers._fields]
        return FilterNumbers(*named)._replace(gate=float(ndtri(0.5 + 0.5 * self.gate)) ** 2)
