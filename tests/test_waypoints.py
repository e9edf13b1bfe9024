"""Waypoints: what is refused, the moving target, and the errors of a robot to it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from ssmr.control.law import Observation
from ssmr.control.waypoints import ALPHA_SWITCH, Target, Waypoints, position_errors, target_at
from ssmr.geometry import rotate_body_to_world, rotate_world_to_body, wrap_angle
from ssmr.types import FloatArray
from tests.conftest import EXACT, ROUNDOFF

FRAME = 1e-9
"""Moving the frame by some metres rounds coordinates to 1e-15 m, and angles of centimetres to
1e-13."""

coordinates = st.floats(-5.0, 5.0)
angles = st.floats(-10.0, 10.0)
steps = st.tuples(st.floats(0.05, 2.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)).filter(
    lambda s: math.hypot(s[1], s[2]) > 1e-3
)
paths = st.lists(steps, min_size=1, max_size=12)


def wander(moves: list[tuple[float, float, float]], t0: float = 0.0) -> Waypoints:
    """Waypoints from the origin by steps (dt, dx, dy)."""
    table = np.cumsum(np.array([(t0, 0.0, 0.0), *moves]), axis=0)
    return Waypoints(table[:, 0], table[:, 1:])


def at(waypoints: Waypoints, t: float) -> tuple[float, ...]:
    """x, y, phi, v_ref, w_ref of the target at a mission time."""
    return tuple(target_at(waypoints.course(), t, 0)[:5])


# --------------------------------------------------------------------------------------------------
# what is refused


def test_waits_keep_the_heading_and_stand_still() -> None:
    """Before the first move the target has the heading with which it leaves.

    After that, the one that it came with.
    """
    xy = np.array([[0, 0], [0, 0], [0, 1], [0, 1], [0, 1], [1, 1], [1, 1]], dtype=float)
    waypoints = Waypoints(np.array([5.0, 7.0, 8.0, 9.0, 10.0, 12.0, 13.0]), xy)
    up = 0.5 * math.pi
    assert np.array_equal(waypoints.headings, [up, up, up, up, 0.0, 0.0])
    assert np.array_equal(waypoints.segment_speeds, [0.0, 1.0, 0.0, 0.0, 0.5, 0.0])
    assert np.array_equal(waypoints.course()["w"], np.zeros(7))
    assert waypoints.start.yaw == up
    assert waypoints.speed == pytest.approx(2.0 / 3.0, rel=ROUNDOFF)
    assert waypoints.rms_speed == pytest.approx(math.sqrt((1.0 + 0.25 * 2.0) / 8.0), rel=ROUNDOFF)
    for t, expected in (
        (1.0, (0.0, 0.0, up, 0.0, 0.0)),
        (4.5, (0.0, 1.0, up, 0.0, 0.0)),
        (6.0, (0.5, 1.0, 0.0, 0.5, 0.0)),
    ):
        assert at(waypoints, t) == expected
    motion = waypoints.trajectory(0.1)
    assert np.all(np.isfinite(motion.pose))
    assert np.all(np.isfinite(motion.twist))


@given(paths, st.lists(st.floats(0.01, 3.0), min_size=1, max_size=5), st.data())
def test_a_wait_shifts_what_comes_after_it(
    moves: list[tuple[float, float, float]], waits: list[float], data: st.DataObject
) -> None:
    """Places, headings and speeds are those of the same path without its waits, each wait later."""
    plain = wander(moves)
    t = list(plain.t)
    xy = plain.xy.tolist()
    later = []
    for wait in waits:
        k = data.draw(st.integers(0, len(t) - 1))
        later.append((t[k], wait))
        t[k + 1 : k + 1] = [t[k]]
        xy[k + 1 : k + 1] = [xy[k]]
        t[k + 1 :] = [s + wait for s in t[k + 1 :]]
    waypoints = Waypoints(np.array(t), np.array(xy))
    assert np.array_equal(waypoints.headings[waypoints.moving], plain.headings)
    assert waypoints.length == pytest.approx(plain.length, rel=1e-9)
    assert waypoints.duration == pytest.approx(plain.duration + sum(waits), rel=1e-9)
    assert waypoints.speed == pytest.approx(plain.speed, rel=1e-6)
    assert np.all(np.isfinite(waypoints.course()["w"]))


@given(paths, st.floats(0.05, 2.0))
def test_a_speed_replaces_times_but_no_waits(
    moves: list[tuple[float, float, float]], speed: float
) -> None:
    plain = wander(moves)
    waiting = Waypoints(
        np.append(plain.t, plain.t[-1] + 2.5), np.vstack([plain.xy, plain.xy[-1:]])
    ).at_speed(speed)
    assert np.allclose(waiting.t[:-1], Waypoints.from_path(plain.xy, speed).t, rtol=ROUNDOFF)
    assert waiting.t[-1] - waiting.t[-2] == pytest.approx(2.5, rel=1e-9)


# --------------------------------------------------------------------------------------------------
# what they are


@given(paths, st.floats(0.05, 2.0))
def test_a_reference_speed_is_that_of_every_segment(
    moves: list[tuple[float, float, float]], speed: float
) -> None:
    waypoints = Waypoints.from_path(wander(moves).xy, speed)
    assert np.allclose(
        waypoints.segment_speeds, speed, rtol=1e-9
    )  # a segment's times are differences of sums ten thousand times as long
    assert waypoints.speed == pytest.approx(speed, rel=ROUNDOFF)
    assert waypoints.duration == pytest.approx(waypoints.length / speed, rel=ROUNDOFF)


@given(paths, st.floats(-1e3, 1e3))
def test_the_table_agrees_with_the_path(moves: list[tuple[float, float, float]], t0: float) -> None:
    waypoints = wander(moves, t0)
    course = waypoints.course()
    assert len(course) == len(waypoints)
    assert np.array_equal(course["t"], waypoints.t - waypoints.t[0])
    assert np.array_equal(np.column_stack([course["x"], course["y"]]), waypoints.xy)
    assert waypoints.lengths.sum() == pytest.approx(waypoints.length, rel=ROUNDOFF)
    phi = course["heading"][:-1]
    along = waypoints.lengths[:, None] * np.column_stack([np.cos(phi), np.sin(phi)])
    assert np.allclose(along, np.diff(waypoints.xy, axis=0), atol=1e-11)
    assert np.allclose(course["v"][:-1] * np.diff(course["t"]), waypoints.lengths, rtol=ROUNDOFF)
    assert course["heading"][-1] == phi[-1]
    assert course["v"][-1] == course["w"][-1] == course["w"][0] == 0.0
    for place, t in zip(waypoints.xy, course["t"], strict=True):
        assert at(waypoints, float(t))[:2] == tuple(place)
    assert np.all(np.abs(np.diff(waypoints.headings)) <= math.pi)


@given(paths)
def test_the_integral_of_the_reference_yaw_rate_is_the_change_of_heading(
    moves: list[tuple[float, float, float]],
) -> None:
    course = wander(moves).course()
    turned = np.trapezoid(course["w"], course["t"])
    assert turned == pytest.approx(course["heading"][-1] - course["heading"][0], abs=1e-9)


@given(paths)
def test_it_starts_at_rest_facing_the_second_waypoint(
    moves: list[tuple[float, float, float]],
) -> None:
    waypoints = wander(moves)
    start = waypoints.start
    assert (start.v_x, start.v_y, start.yaw_rate, start.wheel_left, start.wheel_right) == (0.0,) * 5
    ahead = rotate_world_to_body(waypoints.xy[1] - (start.x, start.y), start.yaw)
    assert ahead[0] > 0.0
    assert abs(ahead[1]) < 1e-12


# --------------------------------------------------------------------------------------------------
# the target


@given(
    st.floats(-3.0, 3.0),
    st.floats(0.1, 3.0),
    st.lists(st.floats(0.05, 1.0), min_size=2, max_size=9),
    st.floats(0, 1),
)
def test_interpolation_is_exact_on_a_linear_motion(
    v_x: float, v_y: float, gaps: list[float], share: float
) -> None:
    t = np.concatenate([[0.0], np.cumsum(gaps)])
    waypoints = Waypoints(t + 100.0, np.column_stack([v_x * t, v_y * t]))
    now = share * waypoints.duration
    x, y, phi, v, w = at(waypoints, now)
    # times of 100 s round to 1e-14 s, gaps are 0.05 s
    assert np.allclose((x, y), (v_x * now, v_y * now), atol=1e-10)
    if now < waypoints.duration:
        assert v == pytest.approx(math.hypot(v_x, v_y), rel=1e-9)
    assert phi == pytest.approx(math.atan2(v_y, v_x), abs=1e-9)
    assert abs(w) < 1e-9


@given(paths)
def test_the_target_waits_at_both_ends(moves: list[tuple[float, float, float]]) -> None:
    waypoints = wander(moves)
    for t, k in ((-1.0, 0), (-1e-12, 0), (waypoints.duration, -1), (waypoints.duration + 1.0, -1)):
        x, y, phi, v, w = at(waypoints, t)
        assert (x, y, phi) == (*waypoints.xy[k], waypoints.headings[k])
        assert v == w == 0.0


@given(paths, st.lists(st.floats(-0.5, 1.5), min_size=1, max_size=20), st.integers(-3, 99))
def test_the_hint_changes_nothing_but_the_way(
    moves: list[tuple[float, float, float]], shares: list[float], hint: int
) -> None:
    """Whatever segment the search begins at, also where time goes back.

    The segment holds the time.
    """
    waypoints = wander(moves)
    course = waypoints.course()
    k = hint
    for share in shares:
        t = share * waypoints.duration
        *measured, k = target_at(course, t, k)
        assert tuple(measured) == at(waypoints, t)
        assert 0 <= k < len(moves)
        assert course["t"][k] <= max(t, 0.0)
        assert k == len(moves) - 1 or t < course["t"][k + 1]


@given(paths, st.floats(0.01, 1.0))
def test_the_reference_trajectory_is_the_target_sampled(
    moves: list[tuple[float, float, float]], dt: float
) -> None:
    waypoints = wander(moves, 7.0)
    reference = waypoints.trajectory(dt)
    assert reference.t[0] == 0.0
    assert reference.t[-1] == waypoints.duration
    assert np.allclose(np.diff(reference.t)[:-1], dt, rtol=1e-9)
    assert np.diff(reference.t)[-1] <= dt * (1.0 + 1e-6)
    for k in (0, len(reference) // 2, len(reference) - 1):
        pose = reference.pose[k]
        twist = reference.twist[k]
        assert (*pose, twist[0], twist[2]) == at(waypoints, float(reference.t[k]))
    assert not np.any(reference.twist[:, 1])
    assert not np.any(reference.wheels)
    for period in (0.0, -0.1, math.nan, math.inf):
        with pytest.raises(ValueError, match="sample period"):
            waypoints.trajectory(period)


# --------------------------------------------------------------------------------------------------
# position errors


def errors(pose: ArrayLike, goal: ArrayLike, switch: float = ALPHA_SWITCH) -> FloatArray:
    seen = Observation(*map(float, pose), 0.0, 0.0)  # type: ignore[arg-type]
    aim = Target(*map(float, goal), 0.0, 0.0, 0)  # type: ignore[arg-type]
    return np.array(position_errors(seen, aim, switch))


poses = st.tuples(coordinates, coordinates, angles)


@given(poses, poses)
def test_errors_are_those_of_the_figure(pose: tuple[float, ...], goal: tuple[float, ...]) -> None:
    """Distance and bearing put together from the offset in body coordinates, without any angle."""
    ahead, left = rotate_world_to_body(np.subtract(goal[:2], pose[:2]), pose[2])
    assume(abs(ahead) > 1e-9)
    e_rho, e_y, e_alpha = errors(pose, goal)
    assert e_y == pytest.approx(left, abs=FRAME)
    assert e_rho == pytest.approx(ahead, abs=FRAME)
    rho = math.hypot(ahead, left)
    assume(abs(rho - ALPHA_SWITCH) > FRAME)
    assert e_alpha == pytest.approx(
        wrap_angle(goal[2] - pose[2]) if rho < ALPHA_SWITCH else 0.0, abs=EXACT
    )


@given(poses, poses, poses)
def test_errors_do_not_depend_on_the_frame(
    pose: tuple[float, ...], goal: tuple[float, ...], frame: tuple[float, ...]
) -> None:
    moved = [
        (*(np.array(frame[:2]) + rotate_body_to_world(np.array(p[:2]), frame[2])), p[2] + frame[2])
        for p in (pose, goal)
    ]
    before = errors(pose, goal)
    assume(abs(rotate_world_to_body(np.subtract(goal[:2], pose[:2]), pose[2])[0]) > 1e-9)
    assume(abs(abs(before[0]) - ALPHA_SWITCH) > FRAME)
    after = errors(*moved)
    assert np.allclose(after[:2], before[:2], atol=FRAME)
    assert abs(wrap_angle(after[2] - before[2])) < FRAME
