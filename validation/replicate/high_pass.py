"""The high-pass filter of Sec. 3.4.4, and how noisy a signal is by what it leaves.

The thesis uses Matlab's `highpass` with a passband from 10 Hz, a steepness of 0.85 and 60 dB of attenuation, and takes the
variance. Such a filter takes away the noise below its passband too, so the variance of white noise comes out too small by
the share of the band that is lost; and 60 dB of attenuation leave up to a thousandth of the motion itself. Here the share
is known and can be put back, and constants and ramps are taken away exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import signal

from ssmr.types import FloatArray, frozen_array

PASSBAND, STEEPNESS, ATTENUATION = 10.0, 0.85, 60.0
"""The thesis' filter: begin of the passband [Hz], steepness of the transition [1], attenuation of the stopband [dB]."""
_HIGHEST = 0.9  # begin of a passband over half the sample rate; above that, nothing would be left to measure
_LEAST_LEFT = 20  # samples behind a filter from which a variance is taken
_ROUNDING = 1e-9  # noise below this share of a signal's range is rounding


@dataclass(frozen=True, eq=False)
class HighPass:
    """A symmetric high-pass filter for samples at one rate."""

    rate: float
    """Samples a second [Hz]."""
    passband: float = PASSBAND
    """Begin of the passband [Hz]."""
    exact: bool = True
    """Whether constants and ramps are taken away exactly. Otherwise the filter is the thesis', 60 dB below its passband."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a passband that does not begin between zero and nine tenths of half the sample rate."""
        if not 0.0 < self.passband <= _HIGHEST * self.rate / 2.0:
            least = 2.0 * self.passband / _HIGHEST
            raise ValueError(
                f"a passband from {self.passband:g} Hz needs more than {least:g} samples a second, got {self.rate:.4g}"
            )

    @cached_property
    def taps(self) -> FloatArray:
        """(K,) coefficients, K odd, symmetric: the Kaiser window's design, of the least order for the attenuation.

        The transition is as wide as Matlab makes it: (1 - steepness) of the passband's begin, below it.
        """
        width = (1.0 - STEEPNESS) * self.passband
        count, beta = signal.kaiserord(ATTENUATION, width / (self.rate / 2.0))
        count += 1 - count % 2
        taps = signal.firwin(count, self.passband - width / 2.0, window=("kaiser", beta), pass_zero=False, fs=self.rate)
        if self.exact:
            window = np.kaiser(count, beta)
            taps = taps - window * (taps.sum() / window.sum())
        return frozen_array(taps, "taps", (None,))

    @property
    def kept(self) -> float:
        """Share of the variance of white noise that passes [1]."""
        return float(np.sum(np.square(self.taps)))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return (M - K + 1,) what passes of (M,) samples; the ends, where the filter sees only part, are left out.

        Raises:
            ValueError: there are fewer samples than the filter has coefficients.
        """
        if len(values) < len(self.taps):
            raise ValueError(f"the filter needs {len(self.taps)} samples without a gap, got {len(values)}")
        return np.asarray(signal.fftconvolve(values - values.mean(), self.taps, "valid") + values.mean() * self.taps.sum())


class NoiseEstimate(NamedTuple):
    """The noise of one signal."""

    variance: float  # variance of what passes, as the thesis takes it [unit²]
    white: float  # variance of white noise that would leave as much [unit²]
    error: float  # standard error of `white` if the noise is white and Gaussian [unit²]


def estimate_noise(pieces: Sequence[FloatArray], filter: HighPass) -> NoiseEstimate:
    """Return the noise of a signal in pieces without a gap; pieces that are too short are left out.

    Args:
        pieces: (M,) samples each, at the filter's rate.
        filter: the high-pass filter.

    Raises:
        ValueError: too little is left.
    """
    passed = [filter(piece) for piece in pieces if len(piece) >= len(filter.taps)]
    left = np.concatenate(passed) if passed else np.empty(0)
    if len(left) < _LEAST_LEFT:
        raise ValueError(f"{len(left)} samples are left behind the filter, wanted {_LEAST_LEFT}")
    variance = float(np.var(left, ddof=1))
    if variance <= (_ROUNDING * max(float(np.ptp(piece)) for piece in pieces)) ** 2:
        raise ValueError("it shows no noise")
    white = variance / filter.kept
    correlation = np.correlate(filter.taps, filter.taps, "full") / filter.kept
    together = float(np.sum(np.square(correlation)))  # so many filtered samples count as one
    return NoiseEstimate(variance, white, white * math.sqrt(2.0 * together / len(left)))
