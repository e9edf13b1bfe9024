"""Paths that a robot can follow, made from waypoints: their laws."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from ssmr.control.feasible import (
    DEVIATION,
    MotionLimits,
    _path_times,
    make_feasible,
    require_manoeuvres,
)
from ssmr.control.laws import LAWS
from ssmr.control.references import circle, eight, stop_and_go
from ssmr.control.waypoints import Waypoints, step_lengths
from ssmr.types import FloatArray

LIMITS = MotionLimits(speed=0.9, yaw_rate=0.8, acceleration=1.5, yaw_acceleration=0.85)
FREE = MotionLimits(*(math.inf,) * 4)
SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]])
CELLS = ((1, 0, 20), (1, 1, 12), (0, 1, 20), (1, 1, 3), (1, 0, 3), (1, 1, 4), (1, 0, 16))


def along(corners: ArrayLike, spacing: float) -> FloatArray:
    """Return corners with waypoints between them, at most so far apart [m]."""
    places = np.asarray(corners, dtype=np.float64)
    pieces = [places[:1]]
    for a, b in itertools.pairwise(places):
        count = max(1, round(math.hypot(*(b - a)) / spacing))
        pieces.append(np.linspace(a, b, count + 1)[1:])
    return np.concatenate(pieces)


def grid_path() -> FloatArray:
    """Return the path of a planner on cells of 5 cm, each a neighbour of the last."""
    steps = [(x, y) for x, y, count in CELLS for _ in range(count)]
    return 0.05 * np.cumulative_sum(np.array(steps, dtype=np.float64), axis=0, include_initial=True)


def distances(places: FloatArray, line: FloatArray) -> FloatArray:
    """Return the distance of each place from a polyline [m]."""
    ways = np.diff(line, axis=0)
    offsets = places[:, None] - line[:-1]
    share = np.sum(offsets * ways, axis=2) / np.sum(ways**2, axis=1)
    nearest = offsets - np.clip(share, 0.0, 1.0)[:, :, None] * ways
    return np.asarray(np.hypot(nearest[:, :, 0], nearest[:, :, 1]).min(axis=1))


PATHS = {
    "square": SQUARE,
    "zigzag": np.array([[0.0, 0.0], [1.0, 0.4], [0.6, 1.0], [1.6, 1.1], [2.0, 0.2]]),
    "grid": grid_path(),
    "star": np.array([[0.0, 0.0], [2.0, 0.0], [0.4, 1.2], [1.0, -0.7], [1.6, 1.2]]),
}


@pytest.mark.parametrize("name", PATHS)
def test_path_and_polyline_are_nowhere_farther_apart_than_stated(name: str) -> None:
    corners = PATHS[name]
    path = make_feasible(Waypoints.from_path(corners, 0.4), LIMITS).xy
    assert distances(path, corners).max() <= DEVIATION
    assert distances(along(corners, 0.01), path).max() <= DEVIATION
    assert np.array_equal(path[0], corners[0])
    assert path[-1] == pytest.approx(corners[-1], abs=1e-12)


@pytest.mark.parametrize("name", PATHS)
def test_every_limit_is_kept_at_every_point(name: str) -> None:
    path = make_feasible(Waypoints.from_path(PATHS[name], 0.4), LIMITS)
    speeds = path.segment_speeds
    middles = 0.5 * (path.t[1:] + path.t[:-1])
    yaw_rates = np.diff(path.headings) / np.diff(middles)
    assert speeds.max() <= 0.4 * (1.0 + 1e-9)
    assert np.abs(np.diff(speeds) / np.diff(middles)).max() <= 1.01 * LIMITS.acceleration
    assert np.abs(yaw_rates).max() <= 1.01 * LIMITS.yaw_rate
    slopes = np.diff(yaw_rates) / np.diff(path.t[1:-1])
    # the curvature of the star's corners changes much within a step of a millimetre
    assert np.abs(slopes).max() <= (1.07 if name == "star" else 1.03) * LIMITS.yaw_acceleration


def test_times_keep_the_yaw_acceleration_on_a_curve_that_is_known() -> None:
    """On a clothoid curvature is k s: the yaw rate's slope is k v^2 + k s a, by hand."""
    k = 1.2
    s = np.linspace(0.0, 4.0, 4001)
    headings = 0.5 * k * (0.5 * (s[1:] + s[:-1])) ** 2
    steps = np.diff(s)[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
    places = np.cumulative_sum(steps, axis=0, include_initial=True)
    t = _path_times(places, np.full(len(s) - 1, 0.6), LIMITS, at_rest=True)
    v = np.diff(s) / np.diff(t)
    middle = 0.5 * (t[1:] + t[:-1])
    w = k * 0.5 * (s[1:] + s[:-1]) * v
    slope = np.diff(w) / np.diff(middle)
    a = np.diff(v) / np.diff(middle)
    assert v.max() == pytest.approx(0.6, rel=1e-3)
    assert np.abs(w).max() <= LIMITS.yaw_rate * 1.001
    assert np.abs(slope).max() <= LIMITS.yaw_acceleration * 1.01
    assert np.abs(a).max() <= LIMITS.acceleration * 1.01
    # at every point one of the limits is reached: nothing is faster
    near = np.stack(
        [
            v[1:] / 0.6,
            np.abs(w[1:]) / LIMITS.yaw_rate,
            np.abs(a) / LIMITS.acceleration,
            np.abs(slope) / LIMITS.yaw_acceleration,
        ]
    )
    assert np.quantile(near.max(axis=0), 0.02) > 0.97


def test_curvature_is_continuous_where_a_corner_was() -> None:
    path = make_feasible(Waypoints.from_path(SQUARE[:3], 0.4), LIMITS).xy
    ways = np.diff(path, axis=0)
    headings = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    curvature = np.diff(headings) / step_lengths(path)[1:]
    assert 8.0 < curvature.max() < 16.0
    assert np.abs(np.diff(curvature)).max() < 0.2 * curvature.max()
    assert np.sum(np.diff(np.sign(np.diff(np.round(curvature, 6)))) != 0) <= 4  # up once, down once


@pytest.mark.parametrize("spacing", [1.0, 0.5, 0.2, 0.1, 0.05, 0.02])
@pytest.mark.parametrize("name", ["square", "zigzag"])
def test_the_spacing_of_waypoints_does_not_count(name: str, spacing: float) -> None:
    coarse = make_feasible(Waypoints.from_path(PATHS[name], 0.4), LIMITS)
    fine = make_feasible(Waypoints.from_path(along(PATHS[name], spacing), 0.4), LIMITS)
    assert fine.duration == pytest.approx(coarse.duration, rel=1e-3)
    assert np.abs(fine.xy - coarse.xy).max() < 1e-3


@pytest.mark.parametrize("name", PATHS)
def test_a_turned_mirrored_or_reversed_path_is_driven_alike(name: str) -> None:
    corners = PATHS[name]
    path = make_feasible(Waypoints.from_path(corners, 0.4), LIMITS)
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, s], [-s, c]])
    turned = make_feasible(Waypoints.from_path(corners @ turn + 3.0, 0.4), LIMITS)
    assert turned.duration == pytest.approx(path.duration, rel=1e-6)
    assert turned.xy == pytest.approx(path.xy @ turn + 3.0, abs=1e-6)
    mirrored = make_feasible(Waypoints.from_path(corners * (1.0, -1.0), 0.4), LIMITS)
    assert mirrored.duration == pytest.approx(path.duration, rel=1e-9)
    back = make_feasible(Waypoints.from_path(corners[::-1], 0.4), LIMITS)
    assert back.duration == pytest.approx(path.duration, rel=5e-3)
    assert back.xy[::-1] == pytest.approx(path.xy, abs=5e-3)


def test_a_path_that_was_feasible_stays_within_millimetres() -> None:
    asked = eight(0.3)
    path = make_feasible(asked, LIMITS, at_rest=False)
    assert distances(path.xy, asked.xy).max() < 0.003
    assert path.duration == pytest.approx(asked.duration, rel=0.01)


def test_without_limits_only_the_corners_change() -> None:
    asked = Waypoints.from_path(SQUARE, 0.4)
    path = make_feasible(asked, FREE, at_rest=False)
    assert path.speed == pytest.approx(0.4, rel=1e-3)


def test_noise_of_waypoints_does_not_slow_a_path() -> None:
    asked = circle(0.4)
    rng = np.random.default_rng(3)
    noisy = Waypoints.from_path(asked.xy + 0.005 * rng.standard_normal(asked.xy.shape), 0.4)
    path = make_feasible(noisy, LIMITS)
    assert path.speed > 0.93 * 0.4
    assert distances(path.xy, asked.xy).max() < DEVIATION


def test_a_planners_path_is_driven_nearly_as_fast_as_asked() -> None:
    asked = Waypoints.from_path(grid_path(), 0.4)
    assert asked.length / make_feasible(asked, LIMITS).duration > 0.33


def test_waits_stay_and_every_leg_begins_and_ends_at_rest() -> None:
    asked = stop_and_go(0.5, leg=1.5, wait=2.0, legs=3)
    path = make_feasible(asked, LIMITS)
    waits = np.diff(path.t)[~path.moving]
    assert waits == pytest.approx([2.0] * 3)
    one_leg = 1.5 / 0.5 + 0.5 / LIMITS.acceleration
    assert path.duration == pytest.approx(3 * (one_leg + 2.0), rel=1e-3)
    speeds = path.segment_speeds
    before = speeds[:-1][~path.moving[1:]]
    assert before.max() < 0.2


@pytest.mark.parametrize(
    ("corners", "number"),
    [
        ([[0.0, 0.0], [1.0, 0.0], [0.2, 0.0]], 2),
        ([[0.0, 0.0], [1.0, 0.0], [2.0, 0.5], [1.1, 0.0]], 3),
        ([[0.0, 0.0], [0.5, 0.0], [1.5, 0.0], [1.5, 0.02], [0.0, 0.02]], 3),
    ],
)
def test_a_path_that_turns_back_turns_on_the_spot_at_its_waypoint(
    corners: list[list[float]], number: int
) -> None:
    path = make_feasible(Waypoints.from_path(corners, 0.4), LIMITS)
    place = corners[number - 1]
    standing = path.xy[1:][~path.moving]
    assert standing == pytest.approx(np.broadcast_to(place, standing.shape), abs=1e-12)
    assert distances(path.xy, np.array(corners)).max() <= DEVIATION
    law = replace(LAWS["pid"], manoeuvres=())
    x, y = place
    with pytest.raises(
        ValueError, match=rf"waypoint {number}: .* turn on the spot at \({x:g}, {y:g}\) m"
    ):
        require_manoeuvres(Waypoints.from_path(corners, 0.4), law)


@pytest.mark.parametrize("wait", [0.5, 20.0])
@pytest.mark.parametrize("turn", [-3.0, -0.4, 0.05, 1.6, 3.1])
@pytest.mark.parametrize("limits", [LIMITS, FREE])
def test_a_turn_on_the_spot_keeps_its_limits(
    turn: float, wait: float, limits: MotionLimits
) -> None:
    ahead = [math.cos(turn), math.sin(turn)]
    t = [0.0, 3.0, 3.0 + wait, 6.0 + wait]
    path = make_feasible(Waypoints(t, [[-1.0, 0.0], [0.0, 0.0], [0.0, 0.0], ahead]), limits)
    assert path.yaw is not None
    still = np.flatnonzero(~path.moving)
    first, last = still[0], still[-1] + 1
    assert path.yaw[last] - path.yaw[first] == pytest.approx(turn, abs=1e-9)
    assert path.t[last] - path.t[first] >= wait - 1e-9
    rates = np.diff(path.yaw) / np.diff(path.t)
    middles = 0.5 * (path.t[1:] + path.t[:-1])
    slopes = np.diff(rates) / np.diff(middles)
    assert np.abs(rates[first:last]).max() <= limits.yaw_rate * 1.001
    assert np.abs(slopes[first : last - 1]).max() <= limits.yaw_acceleration * 1.001
    # it turns after it has settled, and is no slower than it must be
    turning = path.t[1:][np.abs(rates) > 1e-6]
    turning = turning[(turning > path.t[first]) & (turning <= path.t[last])]
    if limits is LIMITS:
        fastest = 2.0 * math.sqrt(abs(turn) / limits.yaw_acceleration)
        fastest = max(fastest, abs(turn) / limits.yaw_rate + limits.yaw_rate / 0.85)
        assert turning[-1] - turning[0] <= fastest + 0.02


@pytest.mark.parametrize("name", ["square", "zigzag", "grid"])
def test_a_path_driven_backwards_has_the_places_and_times_of_forwards(name: str) -> None:
    corners = along(PATHS[name], 0.2)
    ways = np.diff(corners, axis=0)
    yaw = np.arctan2(ways[:, 1], ways[:, 0])
    forwards = make_feasible(Waypoints.from_path(corners, 0.4, np.append(yaw[0], yaw)), LIMITS)
    yaw += math.pi
    backwards = make_feasible(Waypoints.from_path(corners, 0.4, np.append(yaw[0], yaw)), LIMITS)
    assert np.array_equal(backwards.t, forwards.t)
    assert np.array_equal(backwards.xy, forwards.xy)
    ahead = forwards.course()
    back = backwards.course()
    assert np.array_equal(back["v"], -ahead["v"])
    assert back["w"] == pytest.approx(ahead["w"], abs=1e-9)
    assert np.cos(back["heading"] - ahead["heading"]) == pytest.approx(-1.0)
    assert make_feasible(backwards, LIMITS).backwards.all()
