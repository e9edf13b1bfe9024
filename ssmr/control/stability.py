"""Stability of the PID cascade around the linear model: which gains let errors die away (Sec. 4.3.3).

About straight driving at a constant speed behind a target that moves with it, the linear model (Eq. 2.46) and the cascade
without its limits fall into two linear loops: distance to the target and speed, and offset, heading and yaw rate. Both are
sampled: the position loop and the velocity loop tick at periods of their own, commands are held in between and reach the
wheels after a dead time. Over a time that is a whole number of both periods the errors are multiplied by a matrix. The loop
is stable if no eigenvalue of that matrix lies outside the unit circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.linalg import expm

from ssmr.control.loop import POSITION_PERIOD, VELOCITY_PERIOD
from ssmr.control.pid import PidGains
from ssmr.types import FloatArray

Axis = Literal["along", "across"]
_TICK = 1e-3
"""Times are whole numbers of this [s]."""
_NEUTRAL = 1e-7
"""An eigenvalue this near 1 belongs to something that keeps its value [1]."""
_FINE, _BISECTIONS = 60, 30
"""Steps of the search for the first unstable gain, and halvings of the step in which it lies."""


@dataclass(frozen=True)
class CascadeLoop:
    """One of the two linear loops of a robot that follows a straight line."""

    axis: Axis
    """`along`: distance and speed; `across`: offset, heading and yaw rate."""
    decay: float
    """Rate at which the speed, or the yaw rate, falls without a command [1/s]: -A_22 or -A_44 of Eq. 2.46."""
    thrust: float
    """Acceleration per unit of its command [1/s]: B_21 or B_42 of Eq. 2.46."""
    speed: float = 0.5
    """Speed of the target [m/s]."""
    lag: float = 0.0
    """Distance by which the robot is behind its target [m]: a turned robot sees such a target to the side."""
    dead_time: float = 0.22
    """Dead time of a command [s]; Tab. 3.8."""
    position_period: float = POSITION_PERIOD
    """Period of the position loop [s]."""
    velocity_period: float = VELOCITY_PERIOD
    """Period of the velocity loop and of commands [s]."""

    @property
    def _body(self) -> int:
        """Number of the body's states: x, v; or y, yaw, yaw rate."""
        return 2 if self.axis == "along" else 3

    @cached_property
    def _ticks(self) -> tuple[int, int, int, int]:
        """Periods of both loops, dead time and common period in ticks of `_TICK`."""
        position, velocity, dead = (
            max(round(t / _TICK), 0) for t in (self.position_period, self.velocity_period, self.dead_time)
        )
        return position, velocity, dead, math.lcm(position, velocity)

    @cached_property
    def _layout(self) -> tuple[int, int, int]:
        """Number of integrals, place of the reference velocity, and number of states.

        Behind the reference come the velocity as it was last seen, and the commands, the newest first.
        """
        integrals = 2 if self.axis == "along" else 3
        place = self._body + integrals
        return integrals, place, place + 3 + -(-self._ticks[2] // self._ticks[1])

    @cached_property
    def _events(self) -> list[tuple[bool, bool, FloatArray]]:
        """Events of a common period: whether either loop ticks, and how the states flow on until the next event."""
        position, velocity, dead, whole = self._ticks
        times = sorted(
            {
                *range(0, whole, position),
                *range(0, whole, velocity),
                *((k + dead) % whole for k in range(0, whole, velocity)),
            }
        )
        events, flows = [], dict[tuple[int, int], FloatArray]()
        for k, until in zip(times, [*times[1:], whole], strict=True):
            age = k // velocity - (k - dead) // velocity  # commands since the one that acts
            if (until - k, age) not in flows:
                flows[until - k, age] = self._flow((until - k) * _TICK, age)
            events.append((k % position == 0, k % velocity == 0, flows[until - k, age]))
        return events

    def _flow(self, duration: float, age: int) -> FloatArray:
        """Return the matrix by which the states advance while the command that is `age` commands old acts."""
        _, place, n = self._layout
        rate = np.zeros((n, n))
        last = self._body - 1
        rate[last, last], rate[last, place + 2 + age] = -self.decay, self.thrust
        rate[last - 1, last] = 1.0
        if self.axis == "across":
            rate[0, 1] = self.speed
        return np.asarray(expm(rate * duration))

    def _position_tick(self, gains: PidGains) -> FloatArray:
        """Return the matrix of a tick of the position loop (Tab. 4.1), with errors that are those of the body, negative."""
        _, place, n = self._layout
        tick = np.eye(n)
        tick[place : place + 2] = 0.0
        tick[place + 1, self._body - 1] = 1.0
        blocks = {
            "along": ((0, gains.k_p_rho, gains.k_i_rho),),
            "across": ((0, gains.k_p_y, gains.k_i_y), (1, gains.k_p_alpha, gains.k_i_alpha)),
        }
        for k, (state, proportional, integral) in enumerate(blocks[self.axis]):
            own = self._body + k
            tick[place, state], tick[place, own] = -proportional, 1.0
            tick[own, state] = -integral * self.position_period
        if self.axis == "across":
            tick[place, 1] -= gains.k_p_y * self.lag
            tick[self._body, 1] -= gains.k_i_y * self.lag * self.position_period
        return tick

    def _velocity_tick(self, gains: PidGains) -> FloatArray:
        """Return the matrix of a tick of the velocity loop (Tab. 4.2): a new command, the older ones one place further."""
        integrals, place, n = self._layout
        p, i, forward = (
            (gains.k_p_u, gains.k_i_u, gains.ff_u) if self.axis == "along" else (gains.k_p_w, gains.k_i_w, gains.ff_w)
        )
        seen, own = place + 1, self._body + integrals - 1
        tick = np.eye(n)
        tick[place + 2 :] = 0.0
        tick[place + 2, [place, seen, own]] = p + forward, -p, 1.0
        for k in range(place + 3, n):
            tick[k, k - 1] = 1.0
        tick[own, [place, seen]] += np.array([i, -i]) * self.velocity_period
        return tick

    def matrix(self, gains: PidGains) -> FloatArray:
        """Return the (n, n) matrix by which the errors are multiplied over the common period of both loops."""
        whole, position, velocity = np.eye(self._layout[2]), self._position_tick(gains), self._velocity_tick(gains)
        for ticks_position, ticks_velocity, flow in self._events:
            for ticks, tick in ((ticks_position, position), (ticks_velocity, velocity)):
                whole = tick @ whole if ticks else whole
            whole = flow @ whole
        return whole

    def growth(self, gains: PidGains) -> float:
        """Return the rate at which the slowest error grows [1/s]; negative for a stable loop.

        What neither grows nor fades is left out: an integral whose gain is zero, or the difference of two integrals of which
        the sum counts.
        """
        eigenvalues = np.linalg.eigvals(self.matrix(gains))
        largest = float(np.abs(eigenvalues[np.abs(eigenvalues - 1.0) > _NEUTRAL]).max(initial=0.0))
        return math.log(max(largest, 1e-300)) / (self._ticks[3] * _TICK)


def gain_range(loop: CascadeLoop, gains: PidGains, name: str, most: float) -> tuple[float, float] | None:
    """Return the first range of one gain from 0 on in which no error grows while the other gains stay.

    Its second end is `most`, the greatest gain to look at, where no greater gain up to there makes errors grow. None if they
    grow everywhere.
    """

    def stable(gain: float) -> bool:
        return loop.growth(replace(gains, **{name: gain})) < 0.0

    def edge(inside: float, outside: float) -> float:
        for _ in range(_BISECTIONS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if stable(middle) else (inside, middle)
        return inside

    steps = (most * np.linspace(0.0, 1.0, _FINE + 1) ** 2).tolist()  # finer near zero
    seen = [stable(gain) for gain in steps]
    if not any(seen):
        return None
    first = seen.index(True)
    low = 0.0 if first == 0 else edge(steps[first], steps[first - 1])
    if all(seen[first:]):
        return low, most
    after = seen.index(False, first)
    return low, edge(steps[after - 1], steps[after])
