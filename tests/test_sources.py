"""Logs as sources: commands on a grid, the state at the start, windows without jumps."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.geometry import integrate_rates, rotate_body_to_world
from ssmr.metrics.declared import Metrics
from ssmr.metrics.windows import horizon_windows, overlapping_windows
from ssmr.types import FloatArray
from tests.test_log_faults import drive, with_jumps
from validation.experiment.gyro import find_gyro_judge
from validation.experiment.scores import score_windows, standing_sentences
from validation.experiment.sources import (
    WindowCut,
    commands_on_grid,
    open_source,
)
from validation.files.log import Log

EXACT_FIT = 1e-9
"""A least-squares fit of noise-free poses: rounding of 1e-16 over a span of half a second, with
room to spare."""


def ticks(n: int, step: float, start: float = 0.0) -> FloatArray:
    return np.asarray(start + step * np.arange(n), dtype=np.float64)


def driven(
    t: FloatArray, twist: tuple[float, float, float], start: tuple[float, float, float]
) -> dict[str, FloatArray]:
    """Pose columns of a robot with a constant body twist from `start` on, in closed form.

    The twist is (v_x, v_y, yaw rate), with a yaw rate that is not zero.
    """
    v_x, v_y, rate = twist
    turn = rate * (t - t[0])
    body = np.stack(
        [
            v_x * np.sin(turn) - v_y * (1.0 - np.cos(turn)),
            v_x * (1.0 - np.cos(turn)) + v_y * np.sin(turn),
        ],
        -1,
    )
    x, y = rotate_body_to_world(body / rate, start[2]).T
    return {"x": start[0] + x, "y": start[1] + y, "yaw": start[2] + turn}


# --------------------------------------------------------------------------------------------------
# commands and poses
def test_zero_order_hold() -> None:
    t = np.array([10.0, 10.1, 10.25, 10.3 + 4e-7, 10.4])
    v = np.arange(1.0, 6.0)
    inputs = np.column_stack([v, -v])
    made = commands_on_grid(t, inputs, "twist", 0.1)
    assert (made.kind, made.dt) == ("twist", 0.1)
    # the last sample ends the motion
    assert made.values.tolist() == [[1.0, -1.0], [2.0, -2.0], [2.0, -2.0], [4.0, -4.0]]
    assert commands_on_grid(t, inputs, "twist", 0.05).values[:, 0].tolist() == [
        1.0,
        1.0,
        2.0,
        2.0,
        2.0,
        3.0,
        4.0,
        4.0,
    ]
    assert commands_on_grid(t, inputs, "twist", 5.0).values.tolist() == [[1.0, -1.0]]


@given(n=st.integers(1, 400), substeps=st.integers(1, 20), start=st.floats(0.0, 1e5))
def test_a_uniform_log_is_held_sample_by_sample(n: int, substeps: int, start: float) -> None:
    v = np.arange(n + 1.0)
    made = commands_on_grid(
        ticks(n + 1, 0.05, start), np.column_stack([v, -v]), "twist", 0.05 / substeps
    )
    assert made.values[:, 0].tolist() == np.repeat(v[:-1], substeps).tolist()


def test_sides_that_are_refreshed_in_turn_are_interpolated_one_by_one() -> None:
    """Rates go on between samples, and a side is not measured anew when the other one is.

    Warthogs log them in turn.
    """
    left, right = (np.maximum(np.floor((np.arange(101) - k) / 5) * 5 + k, 0) * 0.05 for k in (0, 2))
    made = commands_on_grid(
        ticks(101, 0.05), np.column_stack([3.0 * left, 1.0 - 2.0 * right]), "wheels", 0.01
    )
    middle = (np.arange(made.n) + 0.5) * 0.01
    ends = (middle > 0.1) & (middle < 4.8)  # until the last sample that is new to a side
    truth = np.column_stack([3.0 * middle, 1.0 - 2.0 * middle])
    np.testing.assert_allclose(made.values[ends], truth[ends], atol=1e-12)


@pytest.mark.parametrize("twist", [(0.4, 0.0, 1e-9), (0.4, -0.1, 1.5), (-0.3, 0.2, -2.0)])
@pytest.mark.parametrize("repeat", [1, 2, 5])
def test_a_source_begins_with_the_twist_of_its_first_poses(
    twist: tuple[float, float, float], repeat: int
) -> None:
    t = ticks(40, 0.05, 100.0)
    # a localiser slower than the log: its pose is logged `repeat` times
    rows = np.arange(40) // repeat * repeat
    pose = {n: a[rows] for n, a in driven(t, twist, (3.0, -2.0, 3.0)).items()}
    wrapped = np.angle(np.exp(1j * pose["yaw"]))
    log = Log.of_columns(
        "drive.csv", {"t": t, **pose, "yaw": wrapped, "enc_left": t, "enc_right": -t}
    )
    state = open_source(log, "wheels").pieces[0].start
    assert (state.x, state.y, state.wheel_left, state.wheel_right) == (3.0, -2.0, 100.0, -100.0)
    assert state.yaw == pytest.approx(3.0)
    # a twist of 1e-9 rad/s makes the closed form above lose digits: 1e-16 / 1e-9 of a metre
    loss = EXACT_FIT if abs(twist[2]) > 1e-6 else 1e-6
    np.testing.assert_allclose((state.v_x, state.v_y, state.yaw_rate), twist, atol=loss)


def test_the_beginning_does_not_look_past_half_a_second_or_a_gap() -> None:
    t = np.concatenate([ticks(12, 0.1), ticks(3, 0.1, 5.0)])
    x = np.where(t <= 0.55, 0.2 * t, 50.0 - t)
    log = Log.of_columns(
        "drive.csv", {"t": t, "x": x, **dict.fromkeys(("y", "yaw", "cmd_v", "cmd_w"), 0.0 * x)}
    )
    first, second = (piece.start for piece in open_source(log).pieces)
    assert first.v_x == pytest.approx(0.2, abs=EXACT_FIT)
    assert second.v_x == pytest.approx(-1.0, abs=EXACT_FIT)
    assert first.wheel_left == first.wheel_right == 0.0


def test_the_odometrys_speeds_stand_for_commands_that_were_not_recorded() -> None:
    t = 0.1 * np.arange(50)
    columns = {
        "t": t,
        "x": 0.5 * t,
        "y": 0.0 * t,
        "yaw": 0.0 * t,
        "odom_v": 0.5 + 0.01 * t,
        "odom_w": 0.02 * t,
    }
    source = open_source(Log.of_columns("bag.csv", columns))
    speeds = np.column_stack([columns["odom_v"], columns["odom_w"]])
    assert np.array_equal(source.pieces[0].commands.values[::10], speeds[:-1])
    # another one says that there is no window of 6 s
    assert sum("the odometry's speeds" in warning for warning in source.warnings) == 1
    own = open_source(Log.of_columns("bag.csv", {**columns, "cmd_v": 0.0 * t, "cmd_w": 0.0 * t}))
    assert not own.pieces[0].commands.values.any()
    assert not any("odometry" in warning for warning in own.warnings)
    with pytest.raises(ValueError, match="no column cmd_v, cmd_w"):
        open_source(Log.of_columns("bag.csv", {n: a for n, a in columns.items() if n != "odom_w"}))


# --------------------------------------------------------------------------------------------------
# windows
@pytest.mark.parametrize("cut", [horizon_windows, overlapping_windows])
def test_windows_span_no_jump(cut: WindowCut) -> None:
    columns = drive()
    at = [7.3, 20.0, 20.1, 41.5]
    sound, jumped = (
        open_source(Log.of_columns("log.csv", c)).pieces[0]
        for c in (columns, with_jumps(columns, dict.fromkeys(at, 1.0)))
    )
    for horizon in (2.0, 6.0):
        whole = sound.windows(cut, sound.t, horizon)
        np.testing.assert_array_equal(whole, cut(sound.t, horizon, sound.fresh))
        starts, ends = jumped.windows(cut, jumped.t, horizon)
        assert len(starts) > 0.5 * len(whole[0])
        assert not any(np.any((jumped.t[starts] < a) & (jumped.t[ends] >= a)) for a in at)


@pytest.mark.parametrize("wheels", [True, False])
def test_windows_without_motion_are_counted(wheels: bool) -> None:
    """The robot stands for the last half; commands tell that where a log has no wheel rates."""
    columns = drive()
    stands = columns["t"] >= 30.0
    for name in ("cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z"):
        columns[name] = np.where(stands, 0.0, columns[name])
    for name in ("x", "y", "yaw"):
        columns[name] = np.where(stands, columns[name][600], columns[name])
    kept = columns if wheels else {n: v for n, v in columns.items() if not n.startswith("enc")}
    source, sound = (open_source(Log.of_columns("log.csv", c)) for c in (kept, drive()))
    (message,) = standing_sentences(source, 6.0)
    share = float(re.search(r"throughout (\d+) % of the windows of 6 s", message)[1])
    assert share == pytest.approx(2400.0 / 54.0, abs=5.0)
    assert standing_sentences(source, 100.0) == standing_sentences(sound, 6.0) == []
    piece = source.pieces[0]
    reference = source.pieces[0].reference
    away = replace(
        reference, pose=reference.pose + np.where(piece.t > 32.0, 0.1 * piece.t, 0.0)[:, None]
    )
    errors = score_windows(Metrics(), source.pieces, [away], (6.0,)).horizons[6.0]
    cut = horizon_windows(piece.t, 6.0, piece.fresh)
    assert errors.n in (5, 6)
    assert (errors.n_standing, errors.position_median_m) == (len(cut[0]) - errors.n, 0.0)


# --------------------------------------------------------------------------------------------------
# judges of heading
@pytest.mark.parametrize("stalls", [True, False])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_gyro_judges_headings_whatever_its_sign_and_bias(sign: float, stalls: bool) -> None:
    """The gyro, 0.2 s before the wheels' clock, is right even where the localiser stalls."""
    columns = drive(120.0)
    rate = np.roll(columns["gyro_z"], -4)
    late = columns["t"] - 0.5 * (1.0 + np.sin(columns["t"]))  # it stalls and catches up
    pose = (
        {n: np.interp(late, columns["t"], columns[n]) for n in ("x", "y", "yaw")} if stalls else {}
    )
    source = open_source(
        Log.of_columns("log.csv", {**columns, **pose, "gyro_z": sign * rate + 0.02})
    )
    judge = find_gyro_judge(source)
    assert judge.first == stalls
    reported = source.pieces[0].reference
    t = columns["t"]
    right = np.interp(t - 0.3, t, integrate_rates(t, columns["cmd_w"]))
    reported = replace(reported, pose=np.column_stack([reported.pose[:, :2], right]))
    by_gyro, by_pose = (
        score_windows(Metrics(), pieces, [reported], (6.0,)).windows[6.0].yaw
        for pieces in (judge.judging(source, 0.3), source.pieces)
    )
    assert np.median(by_gyro) < 0.01 < np.median(by_pose)


def test_a_gyro_that_shows_something_else_judges_nothing() -> None:
    columns = drive()
    noise = np.random.default_rng(1).standard_normal(len(columns["t"]))
    for wrong in ({"gyro_z": noise}, {"gyro_z": 0.0 * noise}):
        source = open_source(Log.of_columns("log.csv", {**columns, **wrong}))
        assert find_gyro_judge(source) is None


def test_pieces_of_a_log_with_many_gaps_hold_no_table_each() -> None:
    columns = drive()
    gaps = 10.0 * np.floor(np.arange(len(columns["t"])) / 40.0)
    source = open_source(Log.of_columns("log.csv", {**columns, "t": columns["t"] + gaps}))
    assert len(source.pieces) > 20
    for name in ("fresh", "moves"):
        parts = [getattr(piece, name) for piece in source.pieces]
        held = {id(part.base): part.base.nbytes for part in parts}
        assert sum(held.values()) <= len(columns["t"])
