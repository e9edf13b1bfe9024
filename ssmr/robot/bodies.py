"""Robots that advance together, and the plants that are stepped as one of them.

Everything that moves when commanded is a body among bodies: a population of candidates, the robots
of many closed loops, the episodes of learning, and the one robot that a plant steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ssmr.errors import DivergedError
from ssmr.robot.drive import Driver, whole_steps
from ssmr.robot.vehicle import Drive
from ssmr.types import ChannelColumns, CommandKind, Commands, FloatArray, State, Trajectory


class Bodies(Protocol):
    """S robots, each with its own physics."""

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots whose physics failed when they last advanced."""
        ...

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.types.Motion`."""
        ...

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take the robots through n physics steps.

        They get (S, n, 2) wheel-rate references [rad/s] and (S, n) yaw accelerations [rad/s2].
        """
        ...


class BodyPlant:
    """The stepwise half of a `Plant`: a driver, and a body that is a population of one."""

    name: str
    """Name of the plant."""
    dt: float
    """Physics step [s]."""
    drive: Drive
    """Saturation, delays and conversions between command and wheels."""
    channels: Callable[[CommandKind], ChannelColumns]
    """Function of the kind of commands that returns the columns of channels behind a `State`'s; of
    plants whose runs come in parts."""
    run_parts: Callable[..., Iterator[FloatArray]]
    """Function that yields the (m, k) samples of a `run` part by part, from the same arguments, so
    that hours of them need not be held at once; of plants whose runs come in parts."""
    _driver: Driver | None = None

    def make_bodies(self, plants: Sequence[Any], state: State, workers: int = 1) -> Bodies:
        """Return bodies in a state that move as these plants do, several of which may be one.

        They share `workers` threads where that is quicker; the motion does not depend on it.
        """
        raise NotImplementedError

    def reset(self, state: State) -> State:
        """Start from `state` with empty delay lines; nothing of former runs is kept.

        Returns:
            The state in which the robot is: what follows from the rest of it is not taken over.
        """
        driver = Driver(self.drive, self.dt, state)
        self._bodies = self.make_bodies([self], state)
        self._driver = driver
        return self._read()

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Hold a twist command for `dt` [s]; a plant that was not reset begins at the origin.

        Raises:
            DivergedError: the physics failed.
        """
        if self._driver is None:
            self.reset(State())
        assert self._driver is not None  # by `reset`
        references = self._driver.references(command, whole_steps(dt, self.dt, "the step"))
        pushes = np.full((1, len(references)), float(yaw_acceleration))
        self._bodies.advance(references[None], pushes)
        if self._bodies.gave_up[0]:
            raise DivergedError(f"{self.name} gave up: no finite state", state=self._now)
        return self._read()

    def run(
        self,
        commands: Commands,
        state: State,
        sample_dt: float,
        disturbance: FloatArray | None = None,
    ) -> Trajectory:
        """Drive `commands` at once, see `ssmr.types.Plant`.

        Raises:
            DivergedError: the physics failed.
            ValueError: periods that are no whole number of steps, or disturbances that are not one
                a step.
        """
        table = np.vstack(list(self.run_parts(commands, state, sample_dt, disturbance)))
        return Trajectory.of_table(sample_dt, table, self.channels(commands.kind))

    def _read(self) -> State:
        self._now = State(*self._bodies.states()[0, :8].tolist())
        return self._now
