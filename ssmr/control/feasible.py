"""A path that a robot can follow, from waypoints as a planner or a person draws them.

Waypoints joined by straight lines say where to go, but no robot turns at a corner: the curvature is
infinite there. The path is their polyline p(s), smoothed over its arc length s by a kernel k_h, the
cubic B-spline that ends at +-h:

    r(s) = integral k_h(u) p(s + u) du,      r''(s) = sum over corners of (d_i+1 - d_i) k_h(s_i - s)

with d the directions of the segments. So curvature and its first derivative are continuous; each
corner becomes a curve whose curvature rises and falls once; and as the polyline alone counts, the
spacing of the waypoints does not. A turn by the angle a leaves its corner by (7/30) h sin(a/2).
h is one number for a path: the curve stays within `DEVIATION` of
the polyline, and h is no longer than the speed needs.

The speed is the fastest one for which speed, yaw rate, acceleration and yaw acceleration keep their
limits. With x = v^2 and a = x' / 2 these are linear in x and a at each place,

    |kappa| v <= w,   |a| <= A,   |kappa' x + kappa a| <= B,

so a pass from the end finds the greatest x from which the rest can be driven, and a pass from the
start takes the most of it (H. Pham, Q.-C. Pham, IEEE Trans. Robot. 34, 2018).

A path has several legs, each smoothed alone, where it turns back, waits, or goes on backwards or
forwards. Between two of them the robot turns on the spot, as fast as the limits let it.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit_alone
from ssmr.control.law import REVERSAL, SPOT_TURN, Law
from ssmr.control.laws import LAWS, AnyController
from ssmr.control.waypoints import TURNS_BACK, Waypoints, step_lengths
from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray

DEVIATION = 0.05
"""Greatest distance between the path and the straight lines between its waypoints [m]."""
_WIDEST = 0.5
"""Greatest h, half of the kernel's length [m]: gentle corners need no more."""
_STEP = 0.001
"""Arc length of the polyline from waypoint to waypoint of a feasible path [m]."""
_MOST = 100_000
"""Greatest number of them: the steps of a longer path are longer."""
_TURN_AT_STOP = math.radians(30.0)
"""Greatest turn on the spot that every law can follow [rad]: corners of paths are as sharp."""
_TURN_STEP = 0.01
"""Time between the waypoints of a turn on the spot [s]."""
_SETTLING = 2.0
"""Wait before it, in which a robot comes to its place: no wheel moves it there from aside [s]."""
_NO_TURN = 1e-6
"""Angle that is no turn [rad]."""
_STRAIGHT = 1e-9
"""Curvature [1/m] and its slope [1/m^2] below which nothing is limited."""
_AS_FAST = 0.999
"""A narrower kernel is taken if its mean speed is at least this share of the widest one's."""


class MotionLimits(NamedTuple):
    """The greatest motion of a robot; infinite where there is no limit."""

    speed: float  # [m/s]
    yaw_rate: float  # [rad/s]
    acceleration: float  # [m/s^2]
    yaw_acceleration: float  # [rad/s^2]


_PathLeg = tuple[NDArray[np.intp], float, float]
"""A part of a path without a stop: the numbers of its waypoints, a lone one where the path ends at
rest; and the wait [s] and the turn on the spot, to the left [rad], that come before it."""


def _split_path(waypoints: Waypoints) -> list[_PathLeg]:
    """Return the legs of a path, each as far as it goes on without a stop."""
    legs = []
    headings = waypoints.headings
    heading = waypoints.start.yaw
    pause = turn = 0.0
    senses = np.where(waypoints.backwards, -1, waypoints.moving)
    changes = np.flatnonzero(np.diff(senses)) + 1
    for run in np.split(np.arange(len(senses)), changes):
        leg = np.append(run, run[-1] + 1)
        if not senses[run[0]]:
            pause = float(waypoints.t[leg[-1]] - waypoints.t[leg[0]])
            if waypoints.yaw is not None:
                turn = float(np.unwrap([heading, *waypoints.yaw[leg]])[-1]) - heading
            continue
        for part in _split_leg(waypoints, leg):
            turn += float(wrap_angle(headings[part[0]] - heading - turn))
            legs.append((part, pause, turn))
            pause = turn = 0.0
            heading = float(headings[part[-1] - 1])
    if pause > 0.0:
        legs.append((leg[-1:], pause, turn))
    return legs


def require_manoeuvres(waypoints: Waypoints, law: Law | AnyController) -> set[str]:
    """Return the manoeuvres of a path; refuse one that the law is not declared to follow.

    Raises:
        ValueError: the law cannot; the message says where, and which laws can.
    """
    found = dict[str, int]()
    for leg, _, turn in _split_path(waypoints):
        first = int(leg[0])
        if abs(turn) > _TURN_AT_STOP:
            found.setdefault(SPOT_TURN, first)
        if len(leg) > 1 and waypoints.backwards[first]:
            found.setdefault(REVERSAL, first)
    for manoeuvre, k in found.items():
        if manoeuvre not in law.manoeuvres:
            x, y = waypoints.xy[k]
            able = ", ".join(name for name, known in LAWS.items() if manoeuvre in known.manoeuvres)
            raise ValueError(
                f"waypoint {k + 1}: the path asks the robot to {manoeuvre} at "
                f"({x:.6g}, {y:.6g}) m, which {law.name} cannot do; these can: {able}"
            )
    return set(found)


def make_feasible(waypoints: Waypoints, limits: MotionLimits, at_rest: bool = True) -> Waypoints:
    """Return a path near these waypoints that keeps the limits, and is never faster than they are.

    Waits stay as long as they are, or as a turn on the spot takes. With `at_rest` each leg begins
    and ends at rest; without, at any speed.
    """
    return _join_legs(waypoints, limits, lambda leg: _leg_samples(waypoints, leg, limits, at_rest))


def turn_in_waits(waypoints: Waypoints, limits: MotionLimits) -> Waypoints:
    """Return a reference whose target turns on the spot within the limits, and not at once.

    Its legs stay as they are. Waits stay as long as they are, or as a turn takes.
    """
    t = waypoints.t
    return _join_legs(waypoints, limits, lambda leg: (t[leg] - t[leg[0]], waypoints.xy[leg]))


def _join_legs(
    waypoints: Waypoints,
    limits: MotionLimits,
    sample_leg: Callable[[NDArray[np.intp]], tuple[FloatArray, FloatArray]],
) -> Waypoints:
    """Return legs, as `sample_leg` gives times and places of each, with the turns between them."""
    times = [np.zeros(1)]
    places = [waypoints.xy[:1]]
    yaws = [np.array([waypoints.start.yaw])]
    for leg, pause, turn in _split_path(waypoints):
        t, angles = _turn_samples(turn, limits)
        if pause > t[-1]:
            t = np.append(t, pause)
            angles = np.append(angles, angles[-1])
        if len(t) > 1:
            times.append(times[-1][-1] + t[1:])
            places.append(np.repeat(places[-1][-1:], len(t) - 1, axis=0))
            yaws.append(yaws[-1][-1] + angles[1:])
        if len(leg) > 1:
            t, xy = sample_leg(leg)
            times.append(times[-1][-1] + t[1:])
            places.append(xy[1:])
            dx, dy = np.diff(xy, axis=0).T
            turned_round = math.pi * waypoints.backwards[leg[0]]
            yaws.append(np.arctan2(dy, dx) + turned_round)
    return Waypoints(np.concatenate(times), np.concatenate(places), np.concatenate(yaws))


def _turn_samples(turn: float, limits: MotionLimits) -> tuple[FloatArray, FloatArray]:
    """Return (M,) times [s] and angles [rad], from zero, of a turn on the spot."""
    size = abs(turn)
    if size < _NO_TURN:
        return np.zeros(1), np.zeros(1)
    rate = min(limits.yaw_rate, math.sqrt(size * limits.yaw_acceleration), size / _TURN_STEP)
    duration = size / rate + rate / limits.yaw_acceleration
    t = np.linspace(0.0, duration, math.ceil(duration / _TURN_STEP) + 1)
    middles = 0.5 * (t[1:] + t[:-1])
    ramps = limits.yaw_acceleration * np.minimum(middles, duration - middles)
    angles = np.cumulative_sum(np.minimum(ramps, rate), include_initial=True)
    return np.append(0.0, _SETTLING + t), np.append(0.0, angles * (turn / angles[-1]))


class _Line(NamedTuple):
    """Samples of the polyline through the waypoints of a leg."""

    s: FloatArray  # (M,) arc lengths [m]
    along: FloatArray  # those of the waypoints
    xy: FloatArray  # (M, 2) places [m]
    widths: range  # of kernels, in samples
    widest: int  # the first of them that leaves the line by more than it may


def _sample_line(waypoints: Waypoints, leg: NDArray[np.intp]) -> _Line:
    corners = waypoints.xy[leg]
    along = np.cumulative_sum(waypoints.lengths[leg[:-1]], include_initial=True)
    length = float(along[-1])
    steps = length / max(_STEP, length / _MOST)
    count = max(2, math.ceil(steps - 1e-6))  # rounding adds no step
    s = np.linspace(0.0, length, count + 1)
    line = np.column_stack([np.interp(s, along, corners[:, 0]), np.interp(s, along, corners[:, 1])])
    # a kernel of four boxes of m samples ends at 2 (m - 1) of them
    widths = range(1, 2 + min(round(0.5 * _WIDEST / s[1]), count // 2))

    def too_far(m: int) -> bool:
        off = _smooth_line(line, m) - line
        return bool(np.max(np.hypot(off[:, 0], off[:, 1])) > DEVIATION)

    return _Line(s, along, line, widths, bisect_left(widths, True, key=too_far))


def _split_leg(waypoints: Waypoints, leg: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the parts of a leg, divided where the smoothed path turns back.

    It advances by less than `TURNS_BACK` of the polyline there: at a lone corner the share is
    cos(a / 2), so this is a turn by more than 150 degrees.
    """
    line = _sample_line(waypoints, leg)
    lengths = step_lengths(_smooth_line(line.xy, line.widest))
    k = int(np.argmin(lengths))
    if len(leg) < 3 or lengths[k] >= TURNS_BACK * line.s[1]:
        return [leg]
    corner = 1 + int(np.argmin(np.abs(line.along[1:-1] - line.s[k])))
    return [*_split_leg(waypoints, leg[: corner + 1]), *_split_leg(waypoints, leg[corner:])]


def _leg_samples(
    waypoints: Waypoints, leg: NDArray[np.intp], limits: MotionLimits, at_rest: bool
) -> tuple[FloatArray, FloatArray]:
    """Return times [s], from zero, and (M, 2) places [m] of waypoints `leg` without a wait."""
    s, along, line, widths, widest = _sample_line(waypoints, leg)
    segments = np.searchsorted(along[1:-1], 0.5 * (s[1:] + s[:-1]))
    speeds = np.minimum(waypoints.segment_speeds[leg[:-1]], limits.speed)[segments]

    def timed(m: int) -> tuple[FloatArray, FloatArray, float]:
        path = _smooth_line(line, m)
        t = _path_times(path, speeds, limits, at_rest)
        return t, path, float(np.sum(step_lengths(path)) / t[-1])

    enough = _AS_FAST * timed(widest)[2]
    narrow = bisect_left(widths[: widest - 1], True, key=lambda m: timed(m)[2] >= enough)
    return timed(widths[narrow])[:2]


def _smooth_line(line: FloatArray, m: int) -> FloatArray:
    """Return (N, 2) samples of a line after four means over `m` of them; the ends stay."""
    box = np.full(m, 1.0 / m)
    pair = np.convolve(box, box)
    kernel = np.convolve(pair, pair)
    h = 2 * (m - 1)
    # turned about its ends the line goes on as it came
    before = 2.0 * line[0] - line[h:0:-1]
    after = 2.0 * line[-1] - line[-2 : -h - 2 : -1]
    whole = np.concatenate([before, line, after])
    return np.column_stack([np.convolve(whole[:, c], kernel, "valid") for c in (0, 1)])


def _path_times(
    path: FloatArray, speeds: FloatArray, limits: MotionLimits, at_rest: bool
) -> FloatArray:
    """Return (N,) times [s], from zero, of the fastest motion along a path that keeps the limits.

    Args:
        path: (N, 2) dense places [m], at least three.
        speeds: (N - 1,) greatest speed from each place to the next [m/s].
        limits: of the motion.
        at_rest: whether the motion begins and ends at rest.
    """
    steps = step_lengths(path)
    ways = np.diff(path, axis=0)
    turns = np.diff(np.unwrap(np.arctan2(ways[:, 1], ways[:, 0])))
    curvature = np.zeros(len(path))
    curvature[1:-1] = turns / (0.5 * (steps[1:] + steps[:-1]))
    most = np.append(speeds, speeds[-1])
    most[1:] = np.minimum(most[1:], speeds)
    most = np.minimum(most, limits.yaw_rate / np.maximum(np.abs(curvature), _STRAIGHT))
    if at_rest:
        most[[0, -1]] = 0.0
    # kappa' x + kappa a in the middle of a step, by x where it begins and kappa where it ends
    bends = np.maximum(np.abs(curvature[1:]), _STRAIGHT)
    slopes = np.diff(curvature) / steps * np.where(curvature[1:] < 0.0, -1.0, 1.0)
    squares = most**2
    _slow_down(squares, bends, slopes, steps, limits.acceleration, limits.yaw_acceleration)
    speed = np.sqrt(squares)
    times = 2.0 * steps / (speed[1:] + speed[:-1])
    return np.cumulative_sum(times, include_initial=True)


@jit_alone
def _slow_down(
    x: FloatArray,
    bends: FloatArray,
    slopes: FloatArray,
    steps: FloatArray,
    a_most: float,
    b_most: float,
) -> None:
    """Lower (N,) squares of speeds `x` [m^2/s^2] until the accelerations keep their limits.

    Args:
        x: the greatest ones at each place; the outcome is written there.
        bends: (N - 1,) size of the curvature at the end of each step [1/m].
        slopes: (N - 1,) growth of that size over each step [1/m^2].
        steps: (N - 1,) lengths [m].
        a_most: greatest acceleration [m/s^2].
        b_most: greatest yaw acceleration [rad/s^2].
    """
    n = len(steps)
    for i in range(n - 1, -1, -1):
        k = bends[i]
        c = slopes[i]
        step = 2.0 * steps[i]
        # braking, and the yaw acceleration at some acceleration within the limits
        best = min(x[i], x[i + 1] + step * a_most)
        best = min(best, (b_most + k * a_most) / max(abs(c), _STRAIGHT))
        # the yaw acceleration while braking to the next place, and to rest
        if k > step * c:
            best = min(best, (k * x[i + 1] + step * b_most) / (k - step * c))
        if step * c > k:
            best = min(best, step * b_most / (step * c - k))
        x[i] = best
    for i in range(n):
        a = min(a_most, (b_most - slopes[i] * x[i]) / bends[i])
        after = x[i] + 2.0 * steps[i] * a
        x[i + 1] = min(x[i + 1], max(after, 0.0))  # below zero by rounding alone
