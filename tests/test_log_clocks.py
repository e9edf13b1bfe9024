"""Logs on one clock: what resampling and cutting keep, and rests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssmr.types import FloatArray
from tests.conftest import ROUNDOFF
from validation.files.clocks import on_one_clock
from validation.files.inspection import Inspected, unbiased
from validation.files.log import Group, Log
from validation.files.reading import FileError


def weaving(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Yaw [rad] and yaw rate [rad/s] of a robot that weaves irregularly after 5 s at rest."""
    s = np.maximum(t - 5.0, 0.0)
    yaw = 0.8 * (1.0 - np.cos(0.7 * s)) + 0.3 * (1.0 - np.cos(1.9 * s))
    return yaw, 0.56 * np.sin(0.7 * s) + 0.57 * np.sin(1.9 * s)


def made(bias: float = 0.0, **groups: Group) -> Log:
    """A weaving robot of 0.5 m/s: gyro at 50 Hz, wheels at 20 Hz, poses at 30 Hz."""
    fast = np.arange(0.0, 40.0, 0.02)
    slow = np.arange(0.003, 40.0, 0.05)
    seen = np.arange(0.007, 40.0, 1.0 / 30.0)
    fine = np.arange(0.0, 40.0, 1e-3)
    steps = 0.5e-3 * (fine >= 5.0) * np.stack([np.cos(weaving(fine)[0]), np.sin(weaving(fine)[0])])
    x, y = (np.interp(seen, fine, np.cumsum(a)) for a in steps)
    own = {
        "odom": Group(
            "/odom", slow, {"odom_v": 0.5 * (slow >= 5.0), "odom_w": 0.6 * weaving(slow)[1]}
        ),
        "imu": Group("/imu", fast, {"gyro_z": weaving(fast)[1] + bias}),
        "pose": Group("/pose", seen, {"x": x, "y": y, "yaw": weaving(seen)[0]}),
    }
    return Log(Path("drive.bag"), {**own, **groups})


# ------------------------------------------------------------------------------------------- rest
@settings(max_examples=20)
@given(bias=st.floats(-0.05, 0.05))
def test_the_bias_at_rest_is_found_and_taken_out(bias: float) -> None:
    log = made(bias)
    rest = Inspected(log).rest
    assert rest is not None
    assert rest["bias"] == pytest.approx(bias, abs=ROUNDOFF)
    # of five; half a second before the motion, and what the mean sees of it, do not count
    assert 3.5 < rest["seconds"] < 5.0
    cleared = Inspected(unbiased(log, rest)).rest
    assert cleared is not None
    assert cleared["bias"] == pytest.approx(0.0, abs=ROUNDOFF)
    assert Inspected(log.cut(6.0)).rest is None
    with pytest.raises(FileError, match="wheels that stand for 2 s"):
        unbiased(log.cut(6.0), None)


# ------------------------------------------------------------------------------------------- one
# clock
def test_resampling_meets_a_line_exactly_and_spans_what_all_groups_have() -> None:
    a = np.arange(0.0, 10.0, 0.13)
    b = np.arange(1.0, 12.0, 0.07)
    groups = {
        "imu": Group("/imu", a, {"gyro_z": 0.3 * a}),
        "gps": Group("/fix", b, {"gps_east": 2.0 * b}),
    }
    log = Log(Path("drive.bag"), groups).on_one_clock(25.0)
    assert log.t[0] == 1.0
    assert log.t[-1] == pytest.approx(a[-1], abs=0.04)
    np.testing.assert_allclose(np.diff(log.t), 0.04, rtol=1e-9)
    np.testing.assert_allclose(log.columns["gyro_z"], 0.3 * log.t, rtol=1e-9)
    np.testing.assert_allclose(log.columns["gps_east"], 2.0 * log.t, rtol=1e-9)


@settings(max_examples=60)
@given(
    shift=st.floats(-2e9, 2e9).map(lambda s: round(s, 3)),
    late=st.floats(0.0, 0.3),
    seed=st.integers(0, 9),
)
def test_shifting_the_clock_of_the_stamps_moves_no_topic_against_another(
    shift: float, late: float, seed: int
) -> None:
    """By whole seconds or by a fraction; commands without stamps go along, however late others are.

    What has been measured of the clocks is subtracted, and nothing is rounded to what is usual.
    """
    rng = np.random.default_rng(seed)
    epoch = 1_700_000_000_000_000_000
    measured = epoch + np.arange(0, 20_000_000_000, 40_000_000)
    lateness = np.rint(1e9 * (0.001 + late * rng.random(len(measured)) ** 3)).astype(np.int64)
    # the least late of the topics tells the difference of the clocks
    hardly = np.full(len(measured), 2_000_000)

    def on_clock(moved: int) -> list[FloatArray]:
        stamps = [
            (measured + lateness, measured + moved),
            (measured + hardly, measured + moved),
            (measured + 5_000_000, np.zeros_like(measured)),
        ]
        timed, _ = on_one_clock(["/odom", "/joint_states", "/cmd_vel"], stamps)
        first = int(timed[0].ns[0])
        return [(topic.ns - first).astype(np.float64) * 1e-9 for topic in timed]

    here = on_clock(0)
    there = on_clock(round(shift * 1000.0) * 1_000_000)
    for ours, theirs in zip(here, there, strict=True):
        assert np.abs(ours - theirs).max() < 1e-5
    # commands are late by their own writing, less the least that was seen
    assert np.abs(here[2] - here[1]).max() < 0.01


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (
            1e9,
            "too many samples, for the limit samples is 1e.07; ask for a lower rate",
        ),
        (1e-3, "do not overlap"),
    ],
)
def test_rates_that_make_no_log_are_refused(rate: float, message: str) -> None:
    with pytest.raises(FileError, match=message):
        made().on_one_clock(rate)
