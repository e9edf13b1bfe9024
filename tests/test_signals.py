"""Logs on one clock: what resampling, smoothing, cutting and aligning keep, which offsets of time and rests are found."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssmr.estimation.settings import learning
from ssmr.geometry import align_rigidly, compose, relative, rotate_body_to_world
from ssmr.types import FloatArray
from tests.conftest import EXACT, ROUNDOFF
from validation.logs.dead_reckoning import filtered_motion, reckon, with_filter
from validation.logs.groups import Group, aligned, groups_of, merge, smoothed
from validation.logs.offsets import estimate_offsets, synchronised
from validation.logs.recording import POSE_COLUMNS, Recording
from validation.logs.rest import STOCK, find_rest, unbiased

LOG = Path("drive.bag")
KNOWN_SHIFT = 2e-3
"""A shift is found to within this [s], a fifth of the period that yaw rates are correlated on."""


def weaving(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Yaw [rad] and yaw rate [rad/s] of a robot that weaves, never twice alike, after 5 s of standing."""
    s = np.maximum(t - 5.0, 0.0)
    yaw = 0.8 * (1.0 - np.cos(0.7 * s)) + 0.3 * (1.0 - np.cos(1.9 * s))
    return yaw, 0.56 * np.sin(0.7 * s) + 0.57 * np.sin(1.9 * s)


def log(late: float = 0.0, bias: float = 0.0, noise: float = 0.0) -> dict[str, Group]:
    """A weaving robot of 0.5 m/s: gyro at 50 Hz, wheels at 20 Hz, poses at 30 Hz that are stamped `late` [s]."""
    rng = np.random.default_rng(4)
    fast, slow, seen = np.arange(0.0, 40.0, 0.02), np.arange(0.003, 40.0, 0.05), np.arange(0.007, 40.0, 1.0 / 30.0)
    yaw, _ = weaving(seen)
    fine = np.arange(0.0, 40.0, 1e-3)
    steps = 0.5e-3 * (fine >= 5.0) * np.stack([np.cos(weaving(fine)[0]), np.sin(weaving(fine)[0])])
    xy = [np.interp(seen, fine, np.cumsum(a)) for a in steps]
    gyro = weaving(fast)[1] + bias + noise * rng.standard_normal(len(fast))
    v, w = 0.5 * (slow >= 5.0), weaving(slow)[1]
    return {
        "odom": Group("/odom", slow, {"odom_v": v, "odom_w": 0.6 * w}),
        "imu": Group("/imu", fast, {"gyro_z": gyro}),
        "pose": Group(
            "/pose", seen + late, {"x": xy[0], "y": xy[1], "yaw": yaw + noise * rng.standard_normal(len(yaw)) / 10}
        ),
    }


# ------------------------------------------------------------------------------------------- offsets of time
@settings(max_examples=20)
@given(late=st.floats(-0.6, 0.6))
def test_a_known_shift_is_found_to_a_fraction_of_a_sample_and_taken_out(late: float) -> None:
    groups = log(late, noise=0.01)
    found = {o.late: o for o in estimate_offsets(groups)}
    assert found["pose_yaw"].seconds == pytest.approx(late, abs=KNOWN_SHIFT)
    assert found["pose_yaw"].behind == "imu"
    assert abs(found["odom"].seconds) < KNOWN_SHIFT
    again = {o.late: o.seconds for o in estimate_offsets(synchronised(groups, found.values()))}
    assert abs(again["pose_yaw"]) < KNOWN_SHIFT


def test_commands_lead_and_are_never_shifted() -> None:
    groups = log()
    t = np.arange(0.0, 40.0, 0.05)
    groups["cmd"] = Group("/cmd_vel", t, {"cmd_v": np.full(len(t), 0.5), "cmd_w": weaving(t + 0.3)[1]})
    offsets = estimate_offsets(groups)
    # a held command is half a period late on the whole, so it leads by that less
    assert next(o.seconds for o in offsets if o.late == "cmd") == pytest.approx(-0.3 + 0.025, abs=KNOWN_SHIFT)
    np.testing.assert_array_equal(synchronised(groups, offsets)["cmd"].t, t)


def test_what_is_not_alike_has_no_offset() -> None:
    groups = log()
    rng = np.random.default_rng(1)
    noise = replace(groups["odom"], columns={"odom_v": np.zeros(800), "odom_w": rng.standard_normal(800)})
    still = replace(groups["pose"], columns={name: np.zeros(len(groups["pose"].t)) for name in POSE_COLUMNS})
    assert estimate_offsets({"imu": groups["imu"], "odom": noise, "pose": still}) == []
    assert estimate_offsets({"odom": groups["odom"]}) == []


def test_gaps_do_not_spoil_an_offset() -> None:
    groups = log(0.1)
    keep = (groups["pose"].t < 12.0) | (groups["pose"].t > 20.0)
    pose = groups["pose"]
    groups["pose"] = replace(pose, t=pose.t[keep], columns={n: a[keep] for n, a in pose.columns.items()})
    assert next(o.seconds for o in estimate_offsets(groups) if o.late == "pose_yaw") == pytest.approx(0.1, abs=KNOWN_SHIFT)


# ------------------------------------------------------------------------------------------- rest
@settings(max_examples=20)
@given(bias=st.floats(-0.05, 0.05))
def test_the_bias_at_rest_is_found_and_taken_out(bias: float) -> None:
    groups = log(bias=bias)
    rest = find_rest(groups)
    assert rest is not None
    assert rest.bias == pytest.approx(bias, abs=ROUNDOFF)
    assert (
        3.5 < rest.seconds < 5.0
    )  # of five; half a second before the motion, and what the average sees of it, do not count
    cleared = find_rest(unbiased(LOG, groups))
    assert cleared is not None
    assert cleared.bias == pytest.approx(0.0, abs=ROUNDOFF)


# ------------------------------------------------------------------------------------------- smoothing
@given(st.floats(-5.0, 5.0), st.floats(0.01, 0.5), st.lists(st.floats(0.01, 0.3), min_size=2, max_size=60))
def test_smoothing_keeps_constants_and_never_overshoots(level: float, sigma: float, steps: list[float]) -> None:
    t = np.cumsum(steps)
    np.testing.assert_allclose(smoothed(t, np.full(len(t), level), sigma), level, rtol=ROUNDOFF, atol=ROUNDOFF)
    jagged = np.where(np.arange(len(t)) % 2, 1.0, -1.0)
    assert np.all(np.abs(smoothed(t, jagged, sigma)) <= 1.0 + ROUNDOFF)


def test_smoothing_of_noise_has_the_variance_that_theory_says() -> None:
    """White noise of variance 1 and period h, under a Gaussian of sigma >> h, keeps the variance h/(2 sqrt(pi) sigma)."""
    rng = np.random.default_rng(2)
    t = np.arange(20_000) * 0.01
    left = smoothed(t, rng.standard_normal(len(t)), 0.1)[100:-100]
    assert np.var(left) == pytest.approx(0.01 / (2.0 * math.sqrt(math.pi) * 0.1), rel=0.05)  # 2800 independent samples


def test_smoothing_does_not_reach_over_a_gap() -> None:
    t = np.concatenate([np.arange(10) * 0.1, 1.5 + np.arange(10) * 0.1])
    values = np.where(t < 1.2, 0.0, 1.0)
    np.testing.assert_array_equal(smoothed(t, values, 1.0, 0.25), values)


# ------------------------------------------------------------------------------------------- one clock
def test_groups_with_one_clock_keep_every_bit() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.05, 0.06, 50))
    columns = {name: rng.standard_normal(50) for name in ("t", "cmd_v", "cmd_w", "x", "y", "gyro_z", "odd")}
    recording = Recording.from_columns("drive", {**columns, "t": t, "yaw": 0.1 * rng.standard_normal(50)})
    merged = merge(LOG, groups_of(recording, "drive.csv"))
    np.testing.assert_array_equal(merged.t, t)
    for name, values in {**recording.columns, **recording.channels}.items():
        np.testing.assert_array_equal({**merged.columns, **merged.channels}[name], values)


def test_resampling_meets_a_line_exactly_and_spans_what_all_groups_have() -> None:
    a, b = np.arange(0.0, 10.0, 0.13), np.arange(1.0, 12.0, 0.07)
    groups = {"imu": Group("/imu", a, {"gyro_z": 0.3 * a}), "gps": Group("/fix", b, {"gps_east": 2.0 * b})}
    merged = merge(LOG, groups, 25.0)
    assert merged.t[0] == 1.0
    assert merged.t[-1] == pytest.approx(a[-1], abs=0.04)
    np.testing.assert_allclose(np.diff(merged.t), 0.04, rtol=1e-9)
    np.testing.assert_allclose(merged.columns["gyro_z"], 0.3 * merged.t, rtol=1e-9)
    np.testing.assert_allclose(merged.channels["gps_east"], 2.0 * merged.t, rtol=1e-9)


# ------------------------------------------------------------------------------------------- frames
poses = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.0, 3.0))


@settings(max_examples=20)
@given(poses)
def test_aligned_poses_do_not_depend_on_the_frame(moved: tuple[float, float, float]) -> None:
    columns = log()["pose"].columns
    there = compose(np.array(moved), np.column_stack([columns[n] for n in POSE_COLUMNS]))
    one, other = aligned(columns), aligned(dict(zip(POSE_COLUMNS, there.T, strict=True)))
    for name in POSE_COLUMNS:
        np.testing.assert_allclose(one[name], other[name], atol=1e-12 * 100.0)  # of 50 m
        assert one[name][0] == EXACT
    twice = aligned(one)
    for name in POSE_COLUMNS:
        np.testing.assert_array_equal(twice[name], one[name])


@given(poses)
def test_rigid_alignment_undoes_a_motion(moved: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(5)
    points = rng.standard_normal((30, 2))
    there = rotate_body_to_world(points, moved[2]) + np.array(moved[:2])
    np.testing.assert_allclose(align_rigidly(points, there), there, atol=1e-12 * 100.0)


@given(st.floats(-0.3, 0.3), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_no_other_rigid_motion_is_nearer(turn: float, x: float, y: float) -> None:
    rng = np.random.default_rng(6)
    points, onto = rng.standard_normal((30, 2)), rng.standard_normal((30, 2))
    best = align_rigidly(points, onto)
    other = rotate_body_to_world(best, turn) + np.array([x, y])
    assert np.sum((best - onto) ** 2) <= np.sum((other - onto) ** 2) + ROUNDOFF


# ------------------------------------------------------------------------------------------- dead reckoning
def test_the_filter_with_the_bias_learned_is_nearest() -> None:
    groups = log(bias=0.02)
    found = reckon(groups)
    assert found is not None
    rms = {row.name: row.rms for row in found.rows}
    assert found.truth == "/pose (pose)"
    assert rms["filter, bias learned at rest"] < 0.05 < rms["wheels' speed, gyro's heading"]
    assert rms["filter, bias learned at rest"] < rms["filter of wheels"]
    assert found.rows[0].length == pytest.approx(17.5, rel=0.01)


def test_gps_corrects_the_scales_the_bias_and_the_frame() -> None:
    """Positions of a receiver in a frame that is turned by 2 rad: the filter's pose lies in it, nearer than they do."""
    groups = log(bias=0.02)
    pose, rng = groups["pose"], np.random.default_rng(4)
    t = pose.t[::20]
    true = rotate_body_to_world(np.column_stack([pose.columns["x"], pose.columns["y"]]), 2.0) + np.array([100.0, -50.0])
    east, north = (true[::20] + 0.3 * rng.standard_normal((len(t), 2))).T
    gps = Group("/fix", t, {"gps_east": east, "gps_north": north})
    motion = filtered_motion({**groups, "gps": gps}, settings=learning(STOCK), gps_std=0.3)
    assert motion is not None
    there = np.column_stack([np.interp(pose.t, motion.t, column) for column in motion.xy.T])
    late = pose.t > 0.5 * pose.t[-1]
    assert np.sqrt(np.mean(np.sum((there - true)[late] ** 2, axis=1))) < 0.3
    assert motion.channels["constants"][-1, 0] == pytest.approx(0.02, abs=4.0 * motion.channels["constants_std"][-1, 0])


def test_the_filter_replaces_the_pose_and_keeps_the_old_one() -> None:
    found = with_filter(log())
    assert found is not None
    merged = merge(LOG, found)
    assert {"pose_x", "pose_y", "pose_yaw", "odom_v"} <= set(merged.channels)
    motion = filtered_motion(log())
    assert motion is not None
    away = relative(motion.pose[-1], np.array([merged.columns[n][-1] for n in POSE_COLUMNS]))
    assert np.all(np.abs(away) < 0.05)  # the merged one ends up to two periods earlier: 1 cm, and as much a turn
    assert with_filter({"imu": log()["imu"]}) is None
    assert reckon({"imu": log()["imu"]}) is None
