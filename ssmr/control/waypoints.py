"""What a trajectory tracking controller is told to follow: waypoints in time, the target among them, the errors to it.

The target moves: it is interpolated between waypoints each time a controller asks (Sec. 4.1.1, Alg. 5), so the errors of
Eq. 4.1 and 4.2 do not jump from waypoint to waypoint. Mission time is zero at the first waypoint. SI units and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ssmr._jit import jit
from ssmr.types import FloatArray, State, Trajectory, frozen_array

ALPHA_SWITCH = 0.4
"""A target farther than this is first approached: the error of heading is zero there [m]; Sec. 4.1.2."""
SAME_PLACE = 1e-9
"""Neighbouring waypoints no farther apart than this are one point, and give no heading [m]."""
SAME_TIME = 1e-9
"""Neighbouring waypoints no later than this are at one time, and give no speed [s]."""
LARGEST = 1e12
"""A coordinate [m] or time [s] beyond this is none of a robot: doubles lie 0.1 mm apart there."""


class Fault(NamedTuple):
    """Why no trajectory goes through a point."""

    row: int
    """Which point, from 0."""
    column: str | None
    """`t`, `x` or `y`; None where it is the point as a whole."""
    what: str
    """What is wrong, and what would be right."""


def find_fault(t: FloatArray, xy: FloatArray) -> Fault | None:
    """A point that makes (N,) times [s] and (N, 2) places [m] no trajectory; None where there is none."""
    for column, values, unit in (("x", xy[:, 0], "m"), ("y", xy[:, 1], "m"), ("t", t, "s")):
        bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
        if len(bad):
            what = f"{column} is {values[bad[0]]:g}, wanted a finite number [{unit}] no larger than {LARGEST:g}"
            return Fault(int(bad[0]), column, what)
    still = np.flatnonzero(_lengths(xy) <= SAME_PLACE)
    if len(still):
        k = int(still[0]) + 1
        x, y = xy[k]
        what = f"it is where the one before is, at ({x:.6g}, {y:.6g}) m, so there is no heading; leave out one of the two"
        return Fault(k, None, what)
    back = np.flatnonzero(np.diff(t) <= SAME_TIME)
    if len(back):
        k = int(back[0]) + 1
        return Fault(k, "t", f"time must increase, but {t[k]:.12g} s follows {t[k - 1]:.12g} s")
    return None


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Places to be at, each at its time; checked, copied and read-only."""

    t: FloatArray
    """(N,) strictly increasing, from any start [s]; N at least 2."""
    xy: FloatArray
    """(N, 2) places in the world [m]; no two neighbours are the same."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: fewer than two points, lengths that differ, numbers that are not finite, neighbours at one place or
                time, or time that goes back; the message counts waypoints from 1.
        """
        t, xy = np.asarray(self.t, dtype=np.float64), _places(self.xy)
        if t.shape != (len(xy),):
            raise ValueError(f"{len(xy)} waypoints need as many times, got an array of shape {t.shape}")
        fault = find_fault(t, xy)
        if fault is not None:
            raise ValueError(f"waypoint {fault.row + 1}: {fault.what}")
        object.__setattr__(self, "t", frozen_array(t, "t", (None,)))
        object.__setattr__(self, "xy", frozen_array(xy, "xy", (None, 2)))

    @classmethod
    def from_path(cls, xy: ArrayLike, speed: float) -> Waypoints:
        """Times for a path, so that the mean speed on each segment is `speed` (Alg. 5, lines 2-7).

        Args:
            xy: (N, 2) places [m].
            speed: reference speed [m/s].

        Raises:
            ValueError: a speed that is not positive and finite, or places that are no path.
        """
        if not (math.isfinite(speed) and speed > 0.0):
            raise ValueError(f"the reference speed must be positive and finite, got {speed} m/s")
        places = _places(xy)
        with np.errstate(all="ignore"):  # what overflows here is found, and named, below
            t = np.concatenate([[0.0], np.cumsum(_lengths(places) / speed)])
        return cls(t, places)

    def __len__(self) -> int:
        """How many waypoints there are, N."""
        return len(self.t)

    @property
    def length(self) -> float:
        """Length of all segments [m]."""
        return float(np.sum(_lengths(self.xy)))

    @property
    def duration(self) -> float:
        """Time from the first waypoint to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def speed(self) -> float:
        """Average speed [m/s]."""
        return self.length / self.duration

    @property
    def headings(self) -> FloatArray:
        """(N - 1,) angle phi of each segment to the world's x axis, unwrapped [rad] (Alg. 5, lines 8-10)."""
        steps = np.diff(self.xy, axis=0)
        return np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))

    @property
    def start(self) -> State:
        """At rest at the first waypoint, facing along the first segment."""
        return State(float(self.xy[0, 0]), float(self.xy[0, 1]), float(self.headings[0]))

    def packed(self) -> FloatArray:
        """(N, 7) one row a waypoint, for the compiled loops.

        The columns: mission time t [s], x [m], y [m], heading phi of the segment that begins here [rad, unwrapped], arc
        length s so far [m], reference speed v_ref of that segment [m/s], reference yaw rate w_ref at the waypoint [rad/s].
        w_ref is the change of heading from the middle of one segment to the middle of the next over the time between;
        it is zero at both ends, where one of the two is missing, so that its integral, linear between waypoints, is the
        whole change of heading. The last row keeps the last phi; v_ref is zero there: the target stands still.
        """
        t = self.t - self.t[0]
        steps, lengths, phi = np.diff(t), _lengths(self.xy), self.headings
        middles = t[:-1] + 0.5 * steps
        table = np.zeros((len(t), 7))
        table[:, 0], table[:, 1:3] = t, self.xy
        table[:-1, 3], table[-1, 3] = phi, phi[-1]
        table[1:, 4] = np.cumsum(lengths)
        table[:-1, 5] = lengths / steps
        table[1:-1, 6] = np.diff(phi) / np.diff(middles)
        return table

    def trajectory(self, dt: float) -> Trajectory:
        """What the target does, every `dt` [s] of mission time and at the end: pose (x, y, phi), twist (v_ref, 0, w_ref).

        Raises:
            ValueError: the period is not positive and finite.
        """
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"the sample period must be positive and finite, got {dt} s")
        n = max(1, math.ceil((self.duration - SAME_TIME) / dt))
        t = np.append(np.arange(n) * dt, self.duration)
        rows = _sampled(self.packed(), t)
        still = np.zeros((len(t), 2))
        twist = np.column_stack([rows[:, 3], still[:, 0], rows[:, 4]])
        return Trajectory(t, rows[:, :3], twist, still)


def _places(xy: ArrayLike) -> FloatArray:
    """(N, 2) places, at least two of them."""
    places = np.asarray(xy, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2:
        raise ValueError(f"waypoints have shape {places.shape}, wanted Nx2")
    if len(places) < 2:
        raise ValueError(f"a trajectory needs at least two waypoints, got {len(places)}")
    return places


def _lengths(xy: FloatArray) -> FloatArray:
    """(N - 1,) length of each segment [m]."""
    steps = np.diff(xy, axis=0)
    return np.hypot(steps[:, 0], steps[:, 1])


@jit
def target(table: FloatArray, t: float, index: int) -> tuple[float, float, float, float, float, int]:
    """Where to be at mission time `t` [s] (Alg. 5, lines 11-21).

    Args:
        table: `Waypoints.packed`.
        t: before zero the target waits at the first waypoint, after the end at the last.
        index: the segment of the last call, 0 at first. As time only advances the next one is at most a few further.

    Returns:
        x, y [m] and v_ref [m/s], w_ref [rad/s] of the target, linear in time; phi [rad] of its segment; the segment.
    """
    last = table.shape[0] - 1
    k = min(max(index, 0), last - 1)
    while k < last - 1 and t >= table[k + 1, 0]:
        k += 1
    while k > 0 and t < table[k, 0]:
        k -= 1
    if t < 0.0:
        return table[0, 1], table[0, 2], table[0, 3], 0.0, 0.0, k
    if t >= table[last, 0]:
        return table[last, 1], table[last, 2], table[last, 3], 0.0, 0.0, k
    f = (t - table[k, 0]) / (table[k + 1, 0] - table[k, 0])
    x = table[k, 1] + f * (table[k + 1, 1] - table[k, 1])
    y = table[k, 2] + f * (table[k + 1, 2] - table[k, 2])
    w = table[k, 6] + f * (table[k + 1, 6] - table[k, 6])
    return x, y, table[k, 3], table[k, 5], w, k


@jit
def _sampled(table: FloatArray, t: FloatArray) -> FloatArray:
    """(M, 5) x, y, phi, v_ref, w_ref of the target at (M,) mission times that increase [s]."""
    rows = np.empty((t.shape[0], 5))
    k = 0
    for i in range(t.shape[0]):
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4], k = target(table, t[i], k)
    return rows


@jit
def _wrapped(angle: float) -> float:
    """`ssmr.geometry.wrap_angle` of one angle."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@jit
def position_errors(
    x: float, y: float, yaw: float, x_t: float, y_t: float, phi: float, switch: float
) -> tuple[float, float, float]:
    """The three errors of a robot at (x, y, yaw) to a target at (x_t, y_t) on a segment of heading phi (Eq. 4.1, 4.2).

    rho is the distance, beta by atan2 the direction to the target as the robot sees it. e_y = rho sin(beta) is the target's
    offset to the left, and e_rho = rho cos(beta) how far ahead it is, negative where it lies behind. The thesis prints e_rho
    = rho: a robot beside or ahead of its target would then be driven further away, and with the published gains is
    (docs/errata.md). On the reference the two are the same. e_alpha = phi - yaw, in (-pi, pi]; the thesis prints alpha =
    theta - phi, which a positive gain would drive away from zero. It is zero where the target is farther than `switch`.

    Args:
        x: of the robot's reference point [m].
        y: the same [m].
        yaw: the robot's heading [rad].
        x_t: of the target [m].
        y_t: the same [m].
        phi: heading of the target's segment [rad].
        switch: distance beyond which heading does not matter yet [m]; `ALPHA_SWITCH`.

    Returns:
        e_rho [m], e_y [m], e_alpha [rad].
    """
    dx, dy = x_t - x, y_t - y
    rho = math.hypot(dx, dy)
    beta = math.atan2(dy, dx) - yaw
    e_alpha = _wrapped(phi - yaw) if rho <= switch else 0.0
    return rho * math.cos(beta), rho * math.sin(beta), e_alpha
