"""A filter on a robot, to which poses come late: it goes back to when they were true, and repeats what it has seen since."""

from __future__ import annotations

from bisect import bisect_right

from ssmr.estimation.ekf import filter_step, initial_belief, predict, see_pose
from ssmr.estimation.sensing import SensorSample
from ssmr.estimation.settings import Belief, EkfSettings, SeenPose
from ssmr.types import State

_Input = SensorSample | SeenPose


class FilterHistory:
    """A filter that takes in samples as they come, and poses of a localiser or satellite receiver that come late.

    It remembers what it believed and what came in during the last `memory` seconds. The result is the belief that a filter
    would have to which everything had come in its order: see `ssmr.estimation.ekf.run_ekf`.
    """

    def __init__(self, settings: EkfSettings, start: State, t: float = 0.0, memory: float = 2.0) -> None:
        """Start at an instant `t` [s] in a known state; poses that are later than `memory` [s] are refused."""
        self._numbers, self._memory = settings.packed(), memory
        self._times = [t]
        self._inputs: list[_Input | None] = [None]
        self._beliefs = [initial_belief(start, settings=settings if settings.learns else None)]

    @property
    def belief(self) -> Belief:
        """The belief after everything that came in."""
        return self._beliefs[-1]

    def sense(self, t: float, sample: SensorSample) -> None:
        """Take in what encoders and gyro show at an instant [s].

        Raises:
            ValueError: an instant before one that the filter has seen, farther back than its memory reaches.
        """
        self._insert(t, sample)

    def see(self, t: float, pose: SeenPose) -> None:
        """Take in a pose by the instant [s] at which it was true, not the one at which it came.

        Raises:
            ValueError: an instant farther back than the filter's memory reaches.
        """
        self._insert(t, pose)

    def _insert(self, t: float, what: _Input) -> None:
        at = bisect_right(self._times, t)
        if at == 0:
            raise ValueError(f"instant {t:g} s lies before {self._times[0]:g} s, where the filter's memory begins")
        self._times.insert(at, t)
        self._inputs.insert(at, what)
        del self._beliefs[at:]
        for k in range(at, len(self._times)):
            self._beliefs.append(self._next(k))
        spare = bisect_right(self._times, self._times[-1] - self._memory) - 1
        for old in (self._times, self._inputs, self._beliefs):
            del old[: max(spare, 0)]

    def _next(self, k: int) -> Belief:
        """Return the belief after the k-th input, from that before it."""
        before, what, dt = self._beliefs[k - 1], self._inputs[k], self._times[k] - self._times[k - 1]
        belief = Belief(before.mean.copy(), before.covariance.copy())
        if isinstance(what, SensorSample):
            filter_step(belief, what, dt, self._numbers)
        elif isinstance(what, SeenPose):
            predict(belief, dt, self._numbers)
            see_pose(belief, what, self._numbers.gate)
        return belief
