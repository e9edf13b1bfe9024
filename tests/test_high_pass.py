"""The high-pass filter of Sec. 3.4.4 against its definition, and known noise found again."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ssmr.robot.sensors import SensorModel
from tests.conftest import ROUNDOFF
from validation.bench.logs import POSE_STD, YAW_STD, open_log
from validation.replicate.high_pass import ATTENUATION, PASSBAND, STEEPNESS, HighPass, estimate_noise

DECIBEL = 10.0 ** (-ATTENUATION / 20.0)


def motion(t: np.ndarray) -> np.ndarray:
    """A robot's path in one coordinate: half a metre a second, and a weave as in trajectory 1."""
    return 0.5 * t + 0.3 * np.sin(2.0 * np.pi * 0.5 * t)


# ------------------------------------------------------------------------------------------------------------------- filter


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0, 125.0, 1000.0])
def test_the_filter_is_that_of_the_thesis(rate: float) -> None:
    """60 dB below the transition, all of what is above it, and no delay."""
    taps = HighPass(rate, exact=False).taps
    assert np.array_equal(taps, taps[::-1])
    f, gain = signal.freqz(taps, worN=1 << 14, fs=rate)
    assert (
        np.abs(gain[f <= STEEPNESS * PASSBAND]).max() <= 1.12 * DECIBEL
    )  # Kaiser's order is an estimate, good to a decibel
    assert np.abs(np.abs(gain[f >= PASSBAND]) - 1.0).max() <= 2.0 * DECIBEL


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0])
def test_constants_and_ramps_are_taken_away_exactly_and_by_the_thesis_filter_nearly(rate: float) -> None:
    exact, printed = HighPass(rate), HighPass(rate, exact=False)
    ramp = 3.0 + 10.0 * np.linspace(0.0, 1.0, 2000)
    assert np.abs(exact(ramp)).max() < ROUNDOFF * 1e2
    left = printed(ramp)
    assert 1e-6 < np.abs(left).max() <= 13.0 * 1.12 * DECIBEL  # some of the motion is in the thesis' noise
    f, gain = signal.freqz(exact.taps, worN=1 << 14, fs=rate)
    assert np.abs(np.abs(gain[f >= PASSBAND]) - 1.0).max() <= 2.0 * DECIBEL


@pytest.mark.parametrize(("rate", "passband"), [(50.0, 10.0), (120.0, 10.0), (20.0, 5.0)])
def test_the_share_that_is_kept_is_the_part_of_the_band_above(rate: float, passband: float) -> None:
    """Parseval: the sum of the squared taps is the mean squared gain; the transition's middle is the band's edge."""
    filter = HighPass(rate, passband)
    _, gain = signal.freqz(filter.taps, worN=1 << 15, fs=rate, include_nyquist=True)
    assert filter.kept == pytest.approx(np.trapezoid(np.abs(gain) ** 2, dx=1.0 / (len(gain) - 1)), rel=1e-6)
    edge = passband * (1.0 - 0.5 * (1.0 - STEEPNESS))
    assert filter.kept == pytest.approx(1.0 - edge / (0.5 * rate), abs=0.015)


def test_a_filter_that_would_leave_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"more than 22\.2.* samples a second, got 20"):
        HighPass(20.0)
    with pytest.raises(ValueError, match="samples without a gap"):
        HighPass(50.0)(np.zeros(20))


# -------------------------------------------------------------------------------------------------------------- known noise


@pytest.mark.parametrize("rate", [25.0, 50.0, 120.0])
def test_white_noise_on_a_smooth_motion_is_found_again_within_its_error(rate: float) -> None:
    """Over 40 draws the errors are those that are stated: mean 0 and deviation 1 in units of the standard error."""
    t, std, filter = np.arange(0.0, 30.0, 1.0 / rate), 0.003, HighPass(rate)
    off, kept = [], []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0.0, std, len(t))
        found = estimate_noise([motion(t) + noise], filter)
        off.append((found.white - std**2) / found.error)
        kept.append(found.variance / std**2)
    assert abs(np.mean(off)) < 3.0 / np.sqrt(40)
    assert 0.7 < np.std(off) < 1.35  # 3 standard errors of a deviation from 40 draws
    assert np.mean(kept) == pytest.approx(filter.kept, rel=0.03)  # what the thesis does is too small by the lost share
    assert filter.kept < 0.9


def test_the_noise_of_a_simulated_log_is_that_of_its_sensors() -> None:
    """The encoders, the gyro and the localiser of a drive, each at its own rate; the motion is MuJoCo's."""
    sensors = SensorModel()
    known = {"enc_left": sensors.variance_encoder, "enc_right": sensors.variance_encoder, "gyro_z": sensors.variance_gyro,
             "x": POSE_STD**2, "y": POSE_STD**2, "yaw": YAW_STD**2}  # fmt: skip
    for group in open_log("traj4@mujoco", seed=3).groups.values():
        rate = 1.0 / float(np.mean(np.diff(group.t)))
        for name in known.keys() & group.columns.keys():
            found = estimate_noise([group.columns[name]], HighPass(rate))
            assert abs(found.white - known.pop(name)) < 4.0 * found.error, name
    assert not known
