"""The high-pass filter of Sec. 3.4.4 against its definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tests.conftest import ROUNDOFF
from validation.replicate.lab import high_pass, variance_above
from validation.thesis.published import value

PASSBAND = value("text", "noise_highpass_frequency")
EDGE = PASSBAND * (1.0 - 0.5 * (1.0 - value("text", "noise_highpass_steepness")))
DECIBEL = 10.0 ** (-value("text", "noise_highpass_attenuation") / 20.0)


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0, 1000.0])
def test_the_filter_passes_what_is_above_its_transition_and_keeps_that_part_of_the_band(rate: float) -> None:
    """Parseval: the sum of the squared taps is the mean squared gain; the transition's middle is the band's edge."""
    taps = high_pass(rate)
    assert np.array_equal(taps, taps[::-1])
    f, gain = signal.freqz(taps, worN=1 << 14, fs=rate)
    assert np.abs(np.abs(gain[f >= PASSBAND]) - 1.0).max() <= 2.0 * DECIBEL
    assert np.square(taps).sum() == pytest.approx(1.0 - EDGE / (0.5 * rate), abs=0.015)


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0])
def test_ramps_are_taken_away_and_white_noise_leaves_its_share(rate: float) -> None:
    t = np.arange(0.0, 400.0, 1.0 / rate)
    ramp, noise = 3.0 + 0.5 * t, np.random.default_rng(1).normal(0.0, 0.003, len(t))
    assert variance_above(ramp, rate) < (1e2 * ROUNDOFF * np.ptp(ramp)) ** 2
    weave = 0.3 * np.sin(2.0 * np.pi * 0.5 * t)  # as in trajectory 1
    share = np.square(high_pass(rate)).sum()
    assert variance_above(ramp + weave + noise, rate) == pytest.approx(share * 0.003**2, rel=0.05)
