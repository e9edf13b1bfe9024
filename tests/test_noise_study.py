"""The study of noise: its filter against the definition, known noise found again, and what logs may look like."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ssmr.robot.sensors import SensorModel
from tests.conftest import ROUNDOFF, data_folder
from validation.bench.simulated_logs import SensorFaults
from validation.files.log import Group
from validation.study.noise import HighPass, NoiseOptions, NoiseStudy, study_noise
from validation.study.noise.filtering import ATTENUATION, PASSBAND, STEEPNESS, estimate_noise
from validation.study.noise.run import noise_of

DECIBEL = 10.0 ** (-ATTENUATION / 20.0)
WHOLE = np.arange(0.0, 60.0, 0.02)
"""A minute at 50 Hz [s]."""


def motion(t: np.ndarray) -> np.ndarray:
    """A robot's path in one coordinate: half a metre a second, and a weave as in trajectory 1."""
    return 0.5 * t + 0.3 * np.sin(2.0 * np.pi * 0.5 * t)


def study(columns: dict[str, np.ndarray], t: np.ndarray = WHOLE, passband: float | None = None) -> NoiseStudy:
    return noise_of({"imu": Group("a test", t, columns)}, "a test", NoiseOptions(passband=passband))


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
        assert found.robust == pytest.approx(std**2, rel=0.4)
    assert abs(np.mean(off)) < 3.0 / np.sqrt(40)
    assert 0.7 < np.std(off) < 1.35  # 3 standard errors of a deviation from 40 draws
    assert np.mean(kept) == pytest.approx(filter.kept, rel=0.03)  # what the thesis does is too small by the lost share
    assert filter.kept < 0.9


def test_the_noise_of_a_simulated_log_is_that_of_its_sensors() -> None:
    """The encoders, the gyro and the localiser of a drive, each at its own rate; the motion is MuJoCo's."""
    found, sensors, pose = study_noise(NoiseOptions("traj4@mujoco", seed=3)), SensorModel(), SensorFaults()
    known = {"enc_left": sensors.variance_encoder, "enc_right": sensors.variance_encoder, "gyro_z": sensors.variance_gyro,
             "x": pose.pose_std**2, "y": pose.pose_std**2, "yaw": pose.yaw_std**2}  # fmt: skip
    assert [s.name for s in found.signals] == list(known)
    for s in found.signals:
        assert abs(s.estimate.white - known[s.name]) < 4.0 * s.estimate.error, s.name
        assert s.remarks == ()
    assert found.signal("x").filter.rate == pytest.approx(125.0)


# --------------------------------------------------------------------------------------------------------------------- logs


def test_a_slow_signal_has_a_lower_passband_and_the_notes_say_so() -> None:
    t = np.arange(0.0, 120.0, 0.05)
    found = study({"a": motion(t) + np.random.default_rng(1).normal(0.0, 0.01, len(t))}, t)
    assert found.signals[0].filter.passband == pytest.approx(5.0)
    assert "too slow" in found.notes()[0]
    assert abs(found.signals[0].estimate.white - 1e-4) < 4.0 * found.signals[0].estimate.error
    with pytest.raises(ValueError, match="more than 22"):
        study({"a": motion(t) + 0.01 * np.sin(40.0 * t)}, t, passband=10.0)


def test_nothing_bridges_a_gap_and_repeated_samples_count_once() -> None:
    """The value jumps over each gap, and every sample is logged twice: both would be noise if they were not seen."""
    noise = np.random.default_rng(2).normal(0.0, 0.01, len(WHOLE))
    gaps = 5.0 * np.floor(WHOLE / 10.0)
    t, values = WHOLE + gaps, motion(WHOLE) + noise + 7.0 * gaps
    logged = np.sort(np.concatenate([t, t + 0.01]))
    found = study({"x": np.repeat(values, 2), "y": np.repeat(values, 2), "yaw": np.repeat(values, 2)}, logged)
    signal_x = found.signal("x")
    assert signal_x.filter.rate == pytest.approx(50.0, rel=1e-6)
    assert abs(signal_x.estimate.white - 1e-4) < 4.0 * signal_x.estimate.error
    assert signal_x.estimate.samples == len(WHOLE) - 6 * (len(signal_x.filter.taps) - 1)


def test_what_stands_still_or_is_a_set_point_has_no_estimate() -> None:
    steps = np.floor(WHOLE / 4.0)
    found = study(
        {"a": motion(WHOLE) + np.random.default_rng(3).normal(0.0, 0.1, len(WHOLE)), "set": steps, "dead": 0 * steps}
    )
    assert [s.name for s in found.signals] == ["a"]
    assert found.left_out["dead"] == "it never changes"
    assert set(found.left_out) == {"set", "dead"}
    with pytest.raises(ValueError, match="it never changes"):
        found.signal("dead")
    with pytest.raises(ValueError, match="no such column"):
        found.signal("none")


@pytest.mark.skipif(not (data_folder() / "husky_parking_lot" / "test1.bag").is_file(), reason="the recording is not here")
def test_the_positions_of_a_real_husky_are_as_noisy_as_it_is_fast() -> None:
    """Odometry in a bag: what looks like noise of x and y is mostly the stamps' jitter times the speed, and alternates."""
    found = study_noise(NoiseOptions(str(data_folder() / "husky_parking_lot" / "test1.bag")))
    x, y, gyro = (found.signal(name) for name in ("x", "y", "gyro_z"))
    assert x.tilt < 0.3
    assert y.tilt < 0.3
    assert 0.003 < x.std / 1.0 < 0.03  # some ten milliseconds at 1 m/s
    assert gyro.filter.passband == PASSBAND
    assert gyro.filter.rate == pytest.approx(30.0, rel=0.01)
