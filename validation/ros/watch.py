"""What a follower notices from message to message, and how it limits and keeps a drive."""

from __future__ import annotations

import math

import numpy as np

from ssmr.control.loop import ClosedRun
from ssmr.control.predictor import LATE_FEEDBACK, PredictorModel
from ssmr.types import FloatArray
from validation.ros.messages import Twist

LATE = 0.15
"""Lateness of the robot's answers that is worth a warning [s]: half of it is what robots take to
speed up."""
JUMP = 0.3
"""Least distance between two poses beyond what the speed explains that is a jump [m]."""
ASTRAY = 0.5
"""Greatest distance from the target, beyond the look-ahead [m]."""
GENTLE = 1.2
"""Greatest share of the path's greatest speed and yaw rate at which a robot moves that has just
obeyed again, until its target is `_NEAR` [1]."""
BRAKING = 0.5
"""Braking of the target at its end [m/s2]."""
_STEP = 0.8
"""Change of a message's age that is lateness, over the time since the last one [1]."""
_TAKEN_OVER = 60.0
"""Time constant with which lateness that lasts is left to the predictor to learn [s]."""
STRANGE_FOR = 0.4
"""Time for which a robot may move otherwise than by its commands [s]."""
_STEADY = 0.1
"""Longest time between messages that count as steady [s]."""
_DIFFERENCE = 0.08
"""Difference of speeds that noise and pushes explain [m/s]."""
_SHARE = 0.2
"""Share of the expected speed that tyres and motors explain beyond it [1]."""


class Watch:
    """What a follower notices from message to message."""

    def __init__(self) -> None:
        """Begin without a message."""
        self.lateness = 0.0
        """Time by which messages come later than they did [s]."""
        self._age = 0.0
        self._last = math.nan
        self._strange = 0.0

    def message(self, age: float, dt: float) -> None:
        """Take the `age` of a message that came `dt` after the last by its stamp [s].

        A step of the age is lateness. Where it grows bit by bit the sender's clock is slow, as on a
        busy machine.
        """
        step = age - self._age
        self._age = age
        late = self.lateness * math.exp(-max(dt, 0.0) / _TAKEN_OVER)
        if abs(step) > _STEP * dt:
            late += step
        self.lateness = min(max(late, 0.0), LATE_FEEDBACK)

    def is_strange(self, stamp: float, moves: float, expected: float, difference: float) -> bool:
        """Return whether the robot has moved otherwise than by its commands for `STRANGE_FOR`.

        At time `stamp` [s] it `moves` at a speed [m/s] where another was `expected`; the two differ
        by `difference`, which counts their directions.
        """
        passed = stamp - self._last
        self._last = stamp
        if moves <= _DIFFERENCE or difference <= _DIFFERENCE + _SHARE * expected:
            self._strange = 0.0
        elif passed < _STEADY:  # after a silence it is not known for how long
            self._strange += passed
        return self._strange > STRANGE_FOR


def limited_motion(command: Twist, most: Twist, model: PredictorModel) -> Twist:
    """Return a command whose lasting speed and yaw rate by the linear model keep within limits.

    Both become less by one share, so that the bend stays.
    """
    v, w = command
    lasting_v = max(abs(v) * model.push_v / model.rate_v, 1e-9)
    lasting_w = max(abs(w) * model.push_w / model.rate_w, 1e-9)
    share = min(1.0, most[0] / lasting_v, most[1] / lasting_w)
    return share * v, share * w


def even_run(
    times: FloatArray, rows: FloatArray, seen_at: FloatArray, motion: FloatArray
) -> ClosedRun:
    """Return a drive at even instants: (N, 26) `rows` at their times [s], the newest of each.

    Its (M, 3) poses are those of `motion`, seen at (M,) times [s].
    """
    period = float(np.median(np.diff(times)))
    count = int(times[-1] / period + 1e-6) + 1
    t = period * np.arange(count, dtype=np.float64)
    before = np.searchsorted(times, t + 1e-9, side="right") - 1
    table: FloatArray = rows[before]
    for k in range(3):
        table[:, k] = np.interp(t, seen_at, motion[:, k])
    return ClosedRun(t, table, lost=False)
