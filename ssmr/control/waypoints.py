"""Waypoints in time, the moving target between them, and the errors of a robot to it.

The target moves: it is interpolated between waypoints each time a controller asks (Sec. 4.1.1,
Alg. 5), so the errors of Eq. 4.1 and 4.2 do not jump from waypoint to waypoint. Mission time is
zero at the first waypoint. SI units and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr._jit import jit_alone, write_numbers
from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray, State, Trajectory, frozen_array

ALPHA_SWITCH = 0.4
"""A target farther than this is first approached: the error of heading is zero there [m];
Sec. 4.1.2."""
_SAME_PLACE = 1e-9
"""Neighbouring waypoints no farther apart than this are one place, where the target waits [m]."""
_SAME_TIME = 1e-9
"""Neighbouring waypoints no later than this are at one time, and give no speed [s]."""
TURNS_BACK = math.cos(math.radians(75.0))
"""A way does not go along a direction in which this share of it, or less, lies [1]."""
_BRAKING_STEPS = 20
_LARGEST_NUMBER = 1e12
"""Greatest coordinate [m] or time [s] that is believed: doubles lie 0.1 mm apart there."""


_COURSE = np.dtype([(name, np.float64) for name in ("t", "x", "y", "heading", "v", "w")])
"""One waypoint as the kernels take it, in mission time: t [s], zero at the first waypoint; place x,
y [m]; phi, the robot's heading on the segment that begins here [rad, unwrapped], at the end that on
the segment before; v_ref, speed on the segment that begins here [m/s], negative where it is driven
backwards, zero at the end and where the target waits; w_ref, yaw rate at the waypoint [rad/s], zero
at both ends and where a wait begins or ends."""


class Target(NamedTuple):
    """The moving target at one instant."""

    x: float  # [m]
    y: float  # [m]
    heading: float  # phi, the robot's heading on its segment [rad]
    v: float  # v_ref [m/s], negative backwards
    w: float  # w_ref [rad/s]
    segment: int  # number of the segment, from 0; the next search begins there


class Errors(NamedTuple):
    """The errors of a robot to its target (Eq. 4.1, 4.2)."""

    rho: float  # e_rho, how far ahead the target is [m]; negative where it lies behind
    y: float  # e_y, offset of the target to the left [m]
    alpha: float  # e_alpha, heading of the target's segment less the robot's [rad]


def find_fault(
    t: FloatArray | None, xy: FloatArray, yaw: FloatArray | None = None
) -> tuple[int, str | None, str] | None:
    """Return the first point at which times, places and yaws are no trajectory.

    They are (N,) [s], (N, 2) [m] and (N,) [rad]; times and yaws need not be given.
    It is None if there is no fault; else the number of the point, from 0, `t`, `x`, `y` or `yaw`,
    or None where it is the point as a whole, and a sentence that says what is wrong and what would
    be right. Without times, neighbours at one place are a fault too, unless their yaws differ: a
    speed gives them no time to wait.
    """
    x, y = xy.T
    columns = (("x", x, "m"), ("y", y, "m"), ("t", t, "s"), ("yaw", yaw, "rad"))
    for column, values, unit in columns:
        if values is None:
            continue
        bad = np.flatnonzero(~(np.abs(values) <= _LARGEST_NUMBER))
        if len(bad):
            k = int(bad[0])
            right = f"a finite number [{unit}] no larger than {_LARGEST_NUMBER:g}"
            return k, column, f"{column} is {values[k]:g}, wanted {right}"
    moving = step_lengths(xy) > _SAME_PLACE
    if yaw is not None:
        across = moving & (np.abs(_shares_forwards(xy, yaw)) < TURNS_BACK)
        if np.any(across):
            k = int(np.argmax(across)) + 1
            what = "the robot drives along its yaw or against it, and this lies across its way"
            return k, "yaw", f"{what}; to turn on the spot, name a place twice, with two yaws"
    standing = ~moving if yaw is None else ~moving & (np.diff(yaw) == 0.0)
    if t is None and np.any(standing):
        k = int(np.argmax(standing)) + 1
        cure = "give times, to wait, or leave out one of them"
        place = f"({x[k]:.6g}, {y[k]:.6g}) m"
        return k, None, f"it is where the one before is, at {place}; {cure}"
    if t is not None and not np.all(late := np.diff(t) > _SAME_TIME):
        k = int(np.argmin(late)) + 1
        return k, "t", f"time must increase, but {t[k]:.12g} s follows {t[k - 1]:.12g} s"
    if not np.any(moving):
        what = "no waypoint is away from the first, so there is no heading; name a second place"
        return len(xy) - 1, None, what
    return None


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Places to be at, each at its time; checked, copied and read-only.

    Neighbours at one place are a wait: the target stands there from the time of the first to that
    of the second, and keeps the heading that it came with (before the first move, the heading with
    which it leaves). With yaws it has that of the second.
    """

    t: FloatArray
    """(N,) strictly increasing, from any start [s]; N at least 2."""
    xy: FloatArray
    """(N, 2) places in the world [m], not all of them the same."""
    yaw: FloatArray | None = None
    """(N,) where the robot faces [rad]. It drives backwards to a place whose yaw, and that of the
    place before, lie against the way. None: it drives forwards everywhere."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: fewer than two points, lengths that differ, numbers that are not finite, one
                place only, time that does not increase, or a yaw across the way; the message counts
                waypoints from 1.
        """
        t = np.asarray(self.t, dtype=np.float64)
        xy = _check_places(self.xy)
        if t.shape != (len(xy),):
            raise ValueError(
                f"{len(xy)} waypoints need as many times, got an array of shape {t.shape}"
            )
        yaw = None if self.yaw is None else frozen_array(self.yaw, "yaw", (len(xy),))
        _refuse_fault(find_fault(t, xy, yaw))
        object.__setattr__(self, "t", frozen_array(t, "t", (None,)))
        object.__setattr__(self, "xy", frozen_array(xy, "xy", (None, 2)))
        object.__setattr__(self, "yaw", yaw)

    @classmethod
    def from_path(cls, xy: ArrayLike, speed: float, yaw: ArrayLike | None = None) -> Waypoints:
        """Give (N, 2) places [m] the times of a mean speed [m/s] on each segment.

        See Alg. 5, lines 2-7. Turns on the spot, by (N,) `yaw` [rad], have 1 rad/s.

        Raises:
            ValueError: a speed that is not positive and finite, places that are no path,
                neighbours at one place of one yaw, or a yaw across the way.
        """
        places = _check_places(xy)
        yaws = None if yaw is None else frozen_array(yaw, "yaw", (len(places),))
        _refuse_fault(find_fault(None, places, yaws))
        waits = np.zeros(len(places) - 1)
        if yaws is not None:
            turns = np.abs(wrap_angle(np.diff(yaws)))
            waits = np.where(step_lengths(places) > _SAME_PLACE, 0.0, turns)
        return cls._with_times(places, speed, waits, yaws)

    @classmethod
    def _with_times(
        cls, places: FloatArray, speed: float, waits: FloatArray, yaw: FloatArray | None
    ) -> Waypoints:
        """Return places with the times of a speed [m/s] and of (N - 1,) `waits` [s] in addition."""
        if not (math.isfinite(speed) and speed > 0.0):
            raise ValueError(f"the reference speed must be positive and finite, got {speed} m/s")
        # The check of the times finds and names an overflow.
        with np.errstate(all="ignore"):
            t = np.cumulative_sum(step_lengths(places) / speed + waits, include_initial=True)
        return cls(t, places, yaw)

    def at_speed(self, speed: float) -> Waypoints:
        """Return the same path at a mean speed [m/s] on each segment; its waits stay as they are.

        Raises:
            ValueError: a speed that is not positive and finite.
        """
        waits = np.where(self.moving, 0.0, np.diff(self.t))
        return self._with_times(self.xy, speed, waits, self.yaw)

    def braked(self, braking: float) -> Waypoints:
        """Return the same way, whose target comes to rest at its end by a constant braking [m/s2].

        It begins to brake at most half the way before.
        """
        speed = float(self.segment_speeds[-1])
        left = min(0.5 * speed**2 / braking, 0.5 * self.length)
        if left < _SAME_PLACE:
            return self
        along = np.cumulative_sum(self.lengths, include_initial=True)
        before = along < self.length - left - 1e-3 * left
        share = np.linspace(1.0, 0.0, _BRAKING_STEPS + 1)  # of the time that is left
        places = self.length - left * share**2
        if (
            self.lengths[-1] < left / 5.0
        ):  # corners between waypoints would turn the target in jumps
            places = np.append(places[0], along[along > places[0] + 1e-3 * left])
            share = np.sqrt(np.clip((self.length - places) / left, 0.0, 1.0))
        xy = np.column_stack([np.interp(places, along, self.xy[:, k]) for k in (0, 1)])
        begin = np.interp(self.length - left, along, self.t)
        t = begin + 2.0 * left / speed * (1.0 - share)
        yaw = self.yaw
        if yaw is not None:
            arrived = np.searchsorted(along, places).clip(max=len(yaw) - 1)
            yaw = np.append(yaw[before], yaw[arrived])
        return Waypoints(np.append(self.t[before], t), np.vstack([self.xy[before], xy]), yaw)

    def __len__(self) -> int:
        """Return the number of waypoints, N."""
        return len(self.t)

    @property
    def lengths(self) -> FloatArray:
        """(N - 1,) length of each segment [m]."""
        return step_lengths(self.xy)

    @property
    def length(self) -> float:
        """Length of all segments [m]."""
        return float(np.sum(self.lengths))

    @property
    def duration(self) -> float:
        """Time from the first waypoint to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(N - 1,) whether the target moves on each segment; it waits on the others."""
        return np.asarray(self.lengths > _SAME_PLACE)

    @property
    def speed(self) -> float:
        """Average speed while the target moves [m/s]."""
        moving = self.moving
        if np.all(moving):
            return self.length / self.duration
        return self.length / float(np.sum(np.diff(self.t)[moving]))

    @property
    def rms_speed(self) -> float:
        """Root mean square of the target's speed over the whole time [m/s]; waits count as zero."""
        mean_square = np.average(self.segment_speeds**2, weights=np.diff(self.t))
        return math.sqrt(float(mean_square))

    @property
    def headings(self) -> FloatArray:
        """(N - 1,) the robot's angle phi on each segment to the world's x axis, unwrapped [rad].

        See Alg. 5, lines 8-10. A wait has the heading of the last move before it, or before the
        first move of that move; with yaws, that of the waypoint at its end.
        """
        moves = np.flatnonzero(self.moving)
        steps = np.diff(self.xy, axis=0)[moves]
        angles: FloatArray = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        latest = np.cumsum(self.moving) - 1  # the move from which each segment takes its heading
        headings: FloatArray = angles[np.clip(latest, 0, None)]
        if self.yaw is None:
            return headings
        faced = np.where(self.backwards, headings + math.pi, headings)
        return np.unwrap(np.where(self.moving, faced, self.yaw[1:]))

    @property
    def backwards(self) -> NDArray[np.bool_]:
        """(N - 1,) whether the robot drives backwards on each segment."""
        if self.yaw is None:
            return np.zeros(len(self) - 1, dtype=np.bool_)
        return self.moving & (_shares_forwards(self.xy, self.yaw) < 0.0)

    @property
    def start(self) -> State:
        """State of a robot that rests at the first waypoint and faces as on the first segment.

        Where it first turns on the spot, it has the yaw of the first waypoint.
        """
        x, y = map(float, self.xy[0])
        if self.yaw is not None and not self.moving[0]:
            return State(x, y, float(self.yaw[0]))
        return State(x, y, float(self.headings[0]))

    @property
    def segment_speeds(self) -> FloatArray:
        """(N - 1,) reference speed v_ref of each segment [m/s], zero where the target waits."""
        durations = np.diff(self.t - self.t[0])
        return np.where(self.moving, self.lengths / durations, 0.0)

    def course(self) -> NDArray[np.void]:
        """Return (N,) the waypoints as the kernels take them; see `_COURSE` for the fields of each.

        w_ref is the change of heading from the middle of one segment to the middle of the next over
        the time between. It is zero at both ends, where one of the two is missing, so that its
        integral, linear between waypoints, is the whole change of heading. It is also zero where a
        wait begins or ends: a target that leaves in another direction than it came turns at once,
        as at a corner. Within a turn on the spot, of waypoints at one place, it is as on the way.
        """
        t = self.t - self.t[0]
        headings = self.headings
        middles = t[:-1] + 0.5 * np.diff(t)
        on_the_way = self.moving[:-1] == self.moving[1:]
        course = np.zeros(len(t), _COURSE)
        course["t"] = t
        course["x"] = self.xy[:, 0]
        course["y"] = self.xy[:, 1]
        course["heading"] = np.append(headings, headings[-1])
        course["v"][:-1] = np.where(self.backwards, -1.0, 1.0) * self.segment_speeds
        rates = np.diff(headings) / np.diff(middles)
        course["w"][1:-1] = np.where(on_the_way, rates, 0.0)
        return course

    def trajectory(self, dt: float) -> Trajectory:
        """Return the target's motion every `dt` [s] and at the end.

        The pose is (x, y, phi) and the twist (v_ref, 0, w_ref).

        Raises:
            ValueError: the period is not positive and finite.
        """
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"the sample period must be positive and finite, got {dt} s")
        n = max(1, math.ceil((self.duration - _SAME_TIME) / dt))
        t = np.append(np.arange(n) * dt, self.duration)
        rows = targets_at(self.course(), t)
        twist = np.zeros((len(t), 3))
        twist[:, [0, 2]] = rows[:, 3:]
        return Trajectory(t, rows[:, :3], twist, np.zeros((len(t), 2)))


def _check_places(xy: ArrayLike) -> FloatArray:
    """Return (N, 2) places, at least two of them."""
    places = np.asarray(xy, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2:
        raise ValueError(f"waypoints have shape {places.shape}, wanted Nx2")
    if len(places) < 2:
        raise ValueError(f"a trajectory needs at least two waypoints, got {len(places)}")
    return places


def _refuse_fault(fault: tuple[int, str | None, str] | None) -> None:
    if fault is not None:
        row, _, what = fault
        raise ValueError(f"waypoint {row + 1}: {what}")


def _shares_forwards(xy: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return (N - 1,) the mean cosine between the way to a place and the yaws at both its ends."""
    steps = np.diff(xy, axis=0)
    ways = np.arctan2(steps[:, 1], steps[:, 0])
    return np.asarray(0.5 * (np.cos(yaw[:-1] - ways) + np.cos(yaw[1:] - ways)))


def step_lengths(xy: FloatArray) -> FloatArray:
    """Return the (N - 1,) distances between (N, 2) places that follow each other [m]."""
    steps = np.diff(xy, axis=0)
    return np.hypot(steps[:, 0], steps[:, 1])


@jit_alone
def target_at(course: Any, t: float, segment: int) -> Target:
    """Return the `Target` at a mission time (Alg. 5, lines 11-21).

    Its place and twist are linear in time. Before `t` = 0 [s] the target waits at the first
    waypoint of `Waypoints.course()`, after the end at the last. The search begins at `segment`,
    that of the last call, 0 at first: as time only advances the next one is at most a few further.
    """
    last = len(course) - 1
    k = min(max(segment, 0), last - 1)
    while k < last - 1 and t >= course[k + 1].t:
        k += 1
    while k > 0 and t < course[k].t:
        k -= 1
    if t < 0.0:
        start = course[0]
        return Target(start.x, start.y, start.heading, 0.0, 0.0, k)
    end = course[last]
    if t >= end.t:
        return Target(end.x, end.y, end.heading, 0.0, 0.0, k)
    a = course[k]
    b = course[k + 1]
    f = (t - a.t) / (b.t - a.t)
    x = a.x + f * (b.x - a.x)
    y = a.y + f * (b.y - a.y)
    w = a.w + f * (b.w - a.w)
    return Target(x, y, a.heading, a.v, w, k)


@jit_alone
def targets_at(course: Any, t: FloatArray) -> FloatArray:
    """Return (M, 5) x, y, phi, v_ref, w_ref of the target at (M,) increasing mission times [s]."""
    rows = np.empty((len(t), 5))
    segment = 0
    for i in range(len(t)):
        aim = target_at(course, t[i], segment)
        segment = aim.segment
        write_numbers(rows[i], 0, 1, (aim.x, aim.y, aim.heading, aim.v, aim.w))
    return rows


@jit_alone
def position_errors(seen: Any, aim: Target, switch: float) -> Errors:
    """Return the three errors of a robot `seen` at x, y, yaw to its target (Eq. 4.1, 4.2).

    rho is the distance, beta by atan2 the direction to the target as the robot sees it. e_y = rho
    sin(beta) is the target's offset to the left, and e_rho = rho cos(beta) how far ahead it is,
    negative where it lies behind. The thesis prints e_rho = rho: a robot beside or ahead of its
    target would then be driven further away, and with the published gains is (docs/errata.md). On
    the reference the two agree. e_alpha = phi - yaw, in (-pi, pi]; the thesis prints alpha = theta
    - phi, which a positive gain would drive away from zero. It is zero where the target is farther
    than `switch` [m].
    """
    dx = aim.x - seen.x
    dy = aim.y - seen.y
    rho = math.hypot(dx, dy)
    beta = math.atan2(dy, dx) - seen.yaw
    alpha = 0.0
    if rho <= switch:
        turn = aim.heading - seen.yaw
        alpha = math.pi - (math.pi - turn) % (2.0 * math.pi)
    return Errors(rho * math.cos(beta), rho * math.sin(beta), alpha)
