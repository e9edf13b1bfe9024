"""Recordings: what is refused and how it is said, what survives a round trip, and where time has gaps."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.geometry import rotate_body_to_world
from ssmr.parameters import described
from ssmr.types import FloatArray
from validation.logs.limits import USUAL, LogLimits
from validation.logs.recording import RECORDING_COLUMNS, TIME_ROUNDOFF, Recording, RecordingError, is_channel_name
from validation.logs.recording_csv import read_csv, write_csv

EXACT_FIT = 1e-9
"""A least-squares fit of noise-free poses: rounding of 1e-16 over a span of half a second, with room to spare."""
HEADER = "t,cmd_v,cmd_w,x,y,yaw\n"


def on_file(folder: Path, text: str | bytes, name: str = "drive.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


def ticks(n: int, step: float, start: float = 0.0) -> FloatArray:
    return np.asarray(start + step * np.arange(n), dtype=np.float64)


def timed(t: list[float], **columns: list[float]) -> Recording:
    """A recording with these times and, unless given, commands of zero."""
    return Recording("drive", np.array(t), {n: np.array(v) for n, v in (columns or {"cmd_v": [0.0] * len(t)}).items()})


def driven(t: FloatArray, twist: tuple[float, float, float], start: tuple[float, float, float]) -> dict[str, FloatArray]:
    """Pose columns of a robot that keeps its body twist (v_x, v_y, yaw rate not zero) from `start` on, in closed form."""
    v_x, v_y, rate = twist
    turn = rate * (t - t[0])
    body = (
        np.stack([v_x * np.sin(turn) - v_y * (1.0 - np.cos(turn)), v_x * (1.0 - np.cos(turn)) + v_y * np.sin(turn)], -1)
        / rate
    )
    x, y = rotate_body_to_world(body, start[2]).T
    return {"x": start[0] + x, "y": start[1] + y, "yaw": start[2] + turn}


# ---------------------------------------------------------------------------------------------------------- bad files

BAD_FILES: dict[str, tuple[str | bytes, int | None, str | None, str]] = {
    "empty": ("", None, None, "empty; a recording begins with a header line"),
    "header alone": (HEADER, None, None, "no samples after the header; a recording needs at least two"),
    "no time": ("cmd_v,cmd_w\n0,0\n1,1\n", 1, None, "no column t among 'cmd_v', 'cmd_w'"),
    "nothing known": ("t,foo,bar\n0,1,2\n1,1,2\n", 1, None, "no known column among 't', 'foo', 'bar'"),
    "same name twice": ("t,x,foo, x\n0,0,0,0\n1,0,0,0\n", 1, "x", "twice"),
    "name with a control character": ("t,x,a\tb\n0,0,0\n1,0,0\n", 1, "number 3", r"'a\tb' names no column"),
    "text for a number": (HEADER + "0,0,0,0,0,0\n1,0,abc,0,0,0\n", 3, "cmd_w", "'abc', wanted a finite number [rad/s]"),
    "text too long to show": (HEADER + f"0,{'a' * 10_000},0,0,0,0\n", 2, "cmd_v", "aaa...', wanted"),
    "nan": (HEADER + "0,0,0,0,0,0\n0.1,nan,0,0,0,0\n0.2,0,0,0,0,0\n", 3, "cmd_v", "'nan'"),
    "text among numbers of a channel": ("t,x,note\n0,0,1\n1,0,hm\n2,0,3\n", 3, "note", "'hm', wanted a finite number"),
    "time stands": (HEADER + "0,0,0,0,0,0\n1,0,0,0,0,0\n1,0,0,0,0,0\n", 4, "t", "increase, but 1 s follows 1 s"),
    "time turns back": (HEADER + "0,0,0,0,0,0\n\n-1,0,0,0,0,0\n", 4, "t", "increase, but -1 s follows 0 s"),
    "too few fields": (HEADER + "0,0,0,0,0,0\n1,0,0\n", 3, None, "3 fields, wanted 6 as in the header"),
    "quote never closed": (HEADER + '0,0,0,0,0,0\n1,"0,0,0,0,0\n2,0,0,0,0,0\n', 3, None, "no CSV"),
    "line counted past a quoted line break": ('t,x,note\n0,0,"a\nb"\n1,?,c\n', 4, "x", "'?'"),
    "binary": (b"\x00\x01\x02\xff", 1, None, "not UTF-8; wanted a CSV file"),
    "NUL byte": (HEADER + "0,0,0,0,0,0\n1,0,\0,0,0,0\n", 3, None, "a NUL byte; wanted a CSV file"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file_says_what_and_where_in_one_line(tmp_path: Path, case: str) -> None:
    text, line, column, what = BAD_FILES[case]
    path = on_file(tmp_path, text)
    with pytest.raises(RecordingError) as caught:
        read_csv(path)
    error, message = caught.value, str(caught.value)
    assert (error.path, error.line, error.column) == (path, line, column)
    assert what in message
    assert str(path) in message
    assert line is None or f"line {line}" in message
    assert column is None or f"column {column}:" in message
    assert len(message.splitlines()) == 1
    assert len(message) < 500 + len(str(path))


# --------------------------------------------------------------------------------------------------------- good files


def test_mark_line_endings_blank_lines_and_spaces_are_fine(tmp_path: Path) -> None:
    r = read_csv(on_file(tmp_path, "\ufefft, x ,y,yaw,acc_x\r\n0, 1,2,3,4\r\n\r\n0.5,5,6,7,8\r\n\r\n  \r\n\r\n"))
    assert r.name == "drive"
    assert r.t.tolist() == [0.0, 0.5]
    assert {n: a.tolist() for n, a in r.columns.items()} == {"x": [1.0, 5.0], "y": [2.0, 6.0], "yaw": [3.0, 7.0]}
    assert {n: a.tolist() for n, a in r.channels.items()} == {"acc_x": [4.0, 8.0]}
    assert (r.has_pose, r.has_commands, r.has_wheels) == (True, False, False)


@pytest.mark.parametrize(
    ("cells", "line", "what"),
    [
        (("a", "b", "c"), 2, "text"),
        (("a", "", "c"), 2, "text"),
        (("1", "nan", "3"), 3, "no finite number"),
        (("1", "2", "-inf"), 4, "no finite number"),
        (("1", "", "3"), 3, "no finite number"),
        (("", "", ""), 2, "no finite number"),
    ],
)
def test_unusable_channels_are_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cells: tuple[str, ...], line: int, what: str
) -> None:
    path = on_file(tmp_path, "t,x,note,acc_x\n" + "".join(f"{k},0,{cell},{k}\n" for k, cell in enumerate(cells)))
    with caplog.at_level(logging.WARNING, logger="validation.logs"):
        r = read_csv(path)
    assert list(r.channels) == ["acc_x"]
    assert [m.getMessage() for m in caplog.records] == [
        f"{path}, line {line}, column note: there is {what}; the channel is left out"
    ]


def test_recording_is_frozen() -> None:
    source = np.array([0.0, 1.0, 2.0])
    r = Recording("drive", source, {"x": source, "y": source, "yaw": source}, {"a": source})
    source[0] = 9.0
    segment = r.segments()[0]
    for array in (r.t, r.columns["x"], r.channels["a"], r.pose, segment.t, segment.pose, r.table(("x", "y"))):
        assert array.ravel()[0] == 0.0
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@given(data=st.data(), n=st.integers(2, 12))
def test_round_trip_is_bit_identical(data: st.DataObject, n: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    finite = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=n, max_size=n)
    moment = st.floats(-1e9, 1e9).map(lambda v: v + 0.0)  # 0.0 and -0.0 are one instant
    names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1).filter(is_channel_name)
    t = sorted(data.draw(st.lists(moment, min_size=n, max_size=n, unique=True)))
    columns = data.draw(st.dictionaries(st.sampled_from(list(RECORDING_COLUMNS)), finite, min_size=1))
    channels = data.draw(
        st.dictionaries(names.filter(lambda s: s != "t" and s not in RECORDING_COLUMNS), finite, max_size=3)
    )
    path = tmp_path_factory.mktemp("round") / "drive.csv"
    written = Recording.from_columns("drive", {"t": t, **columns, **channels})
    write_csv(written, path)
    got = read_csv(path, limits=USUAL.changed(dict.fromkeys(described(LogLimits), math.inf)))
    assert got.t.tobytes() == written.t.tobytes()
    assert {k: a.tobytes() for k, a in got.columns.items()} == {k: a.tobytes() for k, a in written.columns.items()}
    assert {k: a.tobytes() for k, a in got.channels.items()} == {k: a.tobytes() for k, a in written.channels.items()}
    assert [*got.columns, *got.channels] == [*written.columns, *written.channels]


# ------------------------------------------------------------------------------------------------- gaps, cuts, columns


def test_one_dropped_sample_is_tolerated_two_are_a_gap() -> None:
    r = timed([0.0, 0.1, 0.3, 0.4, 0.7, 0.8, 0.9, 1.5, 2.0, 2.1])
    assert r.period == pytest.approx(0.1)
    assert [(s.start, s.stop) for s in r.segments()] == [(0, 4), (4, 7), (8, 10)]  # the sample at 1.5 s stands alone
    assert [s.t.tolist() for s in r.segments()][1] == [0.7, 0.8, 0.9]


@given(steps=st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=40), factor=st.floats(1.0, 5.0))
def test_segments_span_no_gap_and_lose_only_lone_samples(steps: list[float], factor: float) -> None:
    t = np.cumsum([0.0, *steps])
    r = Recording("drive", t, {"x": t}, gap_factor=factor)
    limit = factor * r.period + TIME_ROUNDOFF
    inside = np.zeros(len(t), dtype=bool)
    for s in r.segments():
        assert len(s) == len(s.t) >= 2
        assert np.all(np.diff(s.t) <= limit)
        assert not inside[s.start : s.stop].any()
        inside[s.start : s.stop] = True
    step = np.concatenate([[np.inf], np.diff(t), [np.inf]])
    assert np.array_equal(inside, (step[:-1] <= limit) | (step[1:] <= limit))


def test_cut_keeps_both_ends_and_moves_no_gap() -> None:
    r = Recording("drive", np.array([0.0, 1.0, 2.0, 6.0, 7.0]), {"x": np.arange(5.0)}, {"a": np.arange(5.0)}, gap_factor=3.0)
    part = r.cut(1.0, 6.0)
    assert part.t.tolist() == [1.0, 2.0, 6.0]
    assert part.columns["x"].tolist() == part.channels["a"].tolist() == [1.0, 2.0, 3.0]
    assert (part.name, part.gap_factor, part.period) == (r.name, r.gap_factor, r.period)
    assert [s.t.tolist() for s in part.segments()] == [[1.0, 2.0]]  # by its own median step there would be no gap
    assert r.cut(None, 1.5).t.tolist() == [0.0, 1.0]
    assert r.cut(5.9).t.tolist() == [6.0, 7.0]
    assert r.cut().t.tolist() == r.t.tolist()
    with pytest.raises(ValueError, match="nothing but gaps between 2 and 6 s"):
        r.cut(2.0, 6.0).segments()


def test_yaw_is_unwrapped_in_the_pose_alone() -> None:
    r = timed([0.0, 1.0, 2.0], x=[0.0] * 3, y=[0.0] * 3, yaw=[3.0, -3.0, -2.0])
    np.testing.assert_allclose(r.pose[:, 2], [3.0, 2.0 * math.pi - 3.0, 2.0 * math.pi - 2.0], rtol=1e-15)
    assert r.columns["yaw"].tolist() == [3.0, -3.0, -2.0]


# --------------------------------------------------------------------------------------------------- commands and poses


def test_zero_order_hold() -> None:
    r = timed([10.0, 10.1, 10.25, 10.3 + 4e-7, 10.4], cmd_v=[1.0, 2.0, 3.0, 4.0, 5.0], cmd_w=[-1.0, -2.0, -3.0, -4.0, -5.0])
    c = r.segments()[0].commands("twist", 0.1)
    assert (c.kind, c.dt) == ("twist", 0.1)
    assert c.values.tolist() == [[1.0, -1.0], [2.0, -2.0], [2.0, -2.0], [4.0, -4.0]]  # the last sample ends the motion
    fine = r.segments()[0].commands("twist", 0.05)
    assert fine.values[:, 0].tolist() == [1.0, 1.0, 2.0, 2.0, 2.0, 3.0, 4.0, 4.0]
    assert r.segments()[0].commands("twist", 5.0).values.tolist() == [[1.0, -1.0]]
    for period in (0.0, -0.1, math.nan, math.inf):
        with pytest.raises(ValueError, match="period must be positive"):
            r.segments()[0].commands("twist", period)


def test_measured_wheel_rates_go_on_between_samples() -> None:
    """A rate that rises steadily is not late, though it is refreshed at half the log's rate."""
    t = np.arange(41) * 0.05
    logged = np.floor(np.arange(41) / 2) * 0.1  # the time of the last refresh
    c = timed(list(t), enc_left=list(3.0 * logged), enc_right=list(-2.0 * logged)).segments()[0].commands("wheels", 0.01)
    middle = (np.arange(c.n) + 0.5) * 0.01
    np.testing.assert_allclose(c.values, np.outer(middle, [3.0, -2.0]), atol=1e-12)


def test_sides_that_are_refreshed_in_turn_are_interpolated_one_by_one() -> None:
    """A side is not measured anew when the other one is: Warthogs log each side four times a second, 0.1 s apart."""
    t = np.arange(101) * 0.05
    refreshed_at = [np.maximum(np.floor((np.arange(101) - k) / 5) * 5 + k, 0) * 0.05 for k in (0, 2)]
    rates = {"enc_left": list(3.0 * refreshed_at[0]), "enc_right": list(1.0 - 2.0 * refreshed_at[1])}
    c = timed(list(t), **rates).segments()[0].commands("wheels", 0.01)
    middle = (np.arange(c.n) + 0.5) * 0.01
    ends = (middle > 0.1) & (middle < 4.8)  # until the last sample that is new to a side
    truth = np.column_stack([3.0 * middle, 1.0 - 2.0 * middle])
    np.testing.assert_allclose(c.values[ends], truth[ends], atol=1e-12)


def test_a_wheel_that_held_its_rate_did_not_creep() -> None:
    """A constant stretch stays constant until one refresh before the jump that ends it."""
    t = np.arange(61) * 0.05
    rate = np.where(t < 2.0 - 1e-9, 1.0 + 0.01 * (np.floor(np.arange(61) / 2) % 2) * (t < 0.5), 5.0)
    c = timed(list(t), enc_left=list(rate), enc_right=list(rate)).segments()[0].commands("wheels", 0.01)
    middle = (np.arange(c.n) + 0.5) * 0.01
    held = (middle > 0.7) & (middle < 1.9)
    assert np.ptp(c.values[held]) == 0.0
    assert np.all(c.values[middle > 2.0] == 5.0)


@given(n=st.integers(1, 400), substeps=st.integers(1, 20), start=st.floats(0.0, 1e5))
def test_a_uniform_log_is_held_sample_by_sample(n: int, substeps: int, start: float) -> None:
    t = ticks(n + 1, 0.05, start)
    v = np.arange(n + 1.0)
    segment = Recording("drive", t, {"cmd_v": v, "cmd_w": -v}).segments()[0]
    assert segment.commands("twist", 0.05 / substeps).values[:, 0].tolist() == np.repeat(v[:-1], substeps).tolist()


def test_fresh_poses() -> None:
    t = ticks(20, 0.1)
    x = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 2.0, *[2.0] * 12, 3.0, 3.0])
    yaw = np.array([0.0] * 4 + [1.0] * 16)  # a turn on the spot, at the fifth sample
    fresh = Recording("drive", t, {"x": x, "y": 0.0 * x, "yaw": yaw}).segments()[0].fresh
    assert np.flatnonzero(fresh).tolist() == [0, 2, 4, 5, 16, 17, 18]  # still since 0.5 s, so from 1.6 s on all count


@pytest.mark.parametrize("twist", [(0.4, 0.0, 1e-9), (0.4, -0.1, 1.5), (-0.3, 0.2, -2.0)])
@pytest.mark.parametrize("repeat", [1, 2, 5])
def test_initial_state_recovers_a_constant_twist(twist: tuple[float, float, float], repeat: int) -> None:
    t = ticks(40, 0.05, 100.0)
    rows = np.arange(40) // repeat * repeat  # a localiser slower than the log: its pose is logged `repeat` times
    pose = {n: a[rows] for n, a in driven(t, twist, (3.0, -2.0, 3.0)).items()}
    wrapped = np.angle(np.exp(1j * pose["yaw"]))
    state = Recording("drive", t, {**pose, "yaw": wrapped, "enc_left": t, "enc_right": -t}).segments()[0].initial_state()
    assert (state.x, state.y, state.wheel_left, state.wheel_right) == (3.0, -2.0, 100.0, -100.0)
    assert state.yaw == pytest.approx(3.0)
    # a twist of 1e-9 rad/s makes the closed form above lose digits: 1e-16 / 1e-9 of a metre
    np.testing.assert_allclose(
        (state.v_x, state.v_y, state.yaw_rate), twist, atol=EXACT_FIT if abs(twist[2]) > 1e-6 else 1e-6
    )


def test_initial_state_does_not_look_past_half_a_second_or_a_gap() -> None:
    t = np.concatenate([ticks(12, 0.1), ticks(3, 0.1, 5.0)])
    x = np.where(t <= 0.55, 0.2 * t, 50.0 - t)
    r = Recording("drive", t, {"x": x, "y": 0.0 * x, "yaw": 0.0 * x})
    first, second = (s.initial_state() for s in r.segments())
    assert first.v_x == pytest.approx(0.2, abs=EXACT_FIT)
    assert second.v_x == pytest.approx(-1.0, abs=EXACT_FIT)
    assert first.wheel_left == first.wheel_right == 0.0


@pytest.mark.parametrize("n", [2, 100])
def test_initial_state_of_a_robot_at_rest(n: int) -> None:
    r = Recording("drive", ticks(n, 0.05), {k: np.ones(n) for k in ("x", "y", "yaw")})
    state = r.segments()[0].initial_state()
    assert (state.x, state.v_x, state.v_y, state.yaw_rate) == (1.0, 0.0, 0.0, 0.0)
