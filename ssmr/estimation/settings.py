"""Settings of the extended Kalman filter: its assumptions about the robot and its sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssmr.parameters import check_parameters, pack_numbers, parameter
from ssmr.types import FloatArray

X, Y, YAW, V, W = range(5)
"""Places in the filter's state of x [m], y [m], yaw [rad], v [m/s], omega [rad/s]."""


Belief = tuple[FloatArray, FloatArray]
"""Everything that a filter remembers: the (5,) state that it believes in, x [m], y [m], yaw [rad],
v [m/s] and omega [rad/s], and the (5, 5) covariance of these, symmetric."""


@dataclass(frozen=True)
class EkfSettings:
    """Assumptions of the filter about robot and sensors; the defaults are the thesis' filter.

    The wheels of a skidding robot tell its yaw rate only through `half_track`. Unless that is the
    effective one, they overstate it, by a factor of 1.8 on tile. By default the gyro is therefore
    trusted, and the wheels' yaw rate has the large variance that the stock driver claims. Both are
    fused, as on a stock Husky; the wheels count a thousandth of the gyro.
    """

    radius: float = parameter(0.1651, unit="m", low=0.0, high=1e6, open_low=True)
    """Wheel radius of the odometry [m]; the driver's."""
    half_track: float = parameter(0.275, unit="m", low=0.0, high=1e6, open_low=True)
    """Half-track of the odometry, half of (separation x multiplier) [m]; the driver's, which
    assumes no slip."""
    process_position: float = parameter(1e-4, unit="m2/s", low=0.0, high=1e6)
    """Spectral density of slip in x and in y [m2/s]: 1 cm after 1 s, 4.5 cm after 20 s."""
    process_yaw: float = parameter(1e-6, unit="rad2/s", low=0.0, high=1e6)
    """Spectral density of yaw errors besides the gyro's noise [rad2/s]: 1 mrad after 1 s."""
    process_v: float = parameter(0.025, unit="m2/s3", low=0.0, high=1e6)
    """Spectral density of white acceleration [m2/s3], from the stock filter; 0.7 m/s2 over each
    command of 0.05 s."""
    process_yaw_rate: float = parameter(0.02, unit="rad2/s3", low=0.0, high=1e6)
    """Spectral density of white yaw acceleration [rad2/s3], from the stock filter; 0.6 rad/s2 over
    each command."""
    variance_v: float = parameter(5.0115e-05, unit="m2/s2", low=0.0, open_low=True)
    """Variance of the wheels' v [m2/s2]; Tab. 3.4. The table was measured on the filter's output,
    which at 50 Hz and with the densities above has 0.85 of its input's variance."""
    variance_wheel_yaw_rate: float = parameter(0.03, unit="rad2/s2", low=0.0, open_low=True)
    """Variance of the wheels' yaw rate [rad2/s2]; from the maker's driver. It stands for slip, not
    for noise; if it is infinite, the wheels' yaw rate is not used."""
    variance_gyro: float = parameter(3.5298e-05, unit="rad2/s2", low=0.0, open_low=True)
    """Variance of the gyro's yaw rate [rad2/s2]; Tab. 3.4, of the filter's output as well."""
    gyro_bias: float = parameter(0.0, unit="rad/s", low=-1e6, high=1e6)
    """Reading of the gyro at rest [rad/s], which is taken off its readings."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a length or variance is not positive, or a density negative or infinite.
        """
        check_parameters(self)

    def packed(self) -> Any:
        """Return the settings as a named tuple for the kernels."""
        return pack_numbers(self)


NO_NUMBERS = pack_numbers(EkfSettings())
"""Template for `named_like`."""
