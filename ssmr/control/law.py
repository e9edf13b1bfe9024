"""A controller's declaration, and the values that its kernels take and return."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import jit
from ssmr.parameters import check_parameters
from ssmr.types import FloatArray

REVERSAL = "drive backwards"
SPOT_TURN = "turn on the spot"
"""Manoeuvres that not every law can follow."""

Matrix = tuple[tuple[float, ...], ...]
"""Rows of a matrix, immutable."""


class Observation(NamedTuple):
    """The robot's pose and velocities as its controller sees them."""

    x: float
    y: float
    yaw: float
    v: float
    w: float


class Command(NamedTuple):
    """Speed [m/s] and yaw rate [rad/s] that the controller commands."""

    v: float
    w: float


class Memory(NamedTuple):
    """The numbers that a law carries from one step to the next; all are zero at the start."""

    i_rho: float  # integral of the distance to the target
    i_y: float  # integral of the offset to the left
    i_alpha: float  # integral of the heading error
    i_u: float  # integral of the speed error
    i_w: float  # integral of the yaw rate error
    u_ref: float  # speed that the position loop asks for [m/s]; see `hold_memory`
    w_ref: float  # yaw rate that the position loop asks for [rad/s]; see `hold_memory`


EMPTY_MEMORY = Memory(*(0.0,) * len(Memory._fields))
"""Memory of a law that has not run yet."""


class Gains:
    """Base of the gains of every law.

    They are a frozen dataclass whose fields are declared by `ssmr.parameters.parameter`.
    """

    def __post_init__(self) -> None:
        """Raise a ValueError that names a gain outside its declared range."""
        check_parameters(self)

    def packed(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return the numbers for the kernels as one row; by default the gains in their order.

        (4, 4) `a` and (4, 2) `b` of the linear model (Eq. 2.46) are for laws that are designed on
        it.

        Raises:
            ValueError: no law exists for these gains.
        """
        del a, b
        return np.array(list(vars(self).values()), dtype=np.float64)


@jit
def hold_memory(
    row: FloatArray, memory: Memory, seen: Observation, dt: float
) -> tuple[Memory, Command]:
    """Return the memory unchanged and the position loop's output as the command.

    This is the velocity loop of a law of one rate.
    """
    return memory, Command(memory.u_ref, memory.w_ref)


@dataclass(frozen=True)
class Law:
    """Everything that the rest of the project needs to know of a controller."""

    name: str
    """Name of the controller."""
    gains: type[Gains]
    """Dataclass of the gains, which declares default, unit, range and search bounds of each."""
    position_step: Callable[..., Memory] | None = None
    """Kernel `(row, memory, errors, target, seen, dt)` of the position loop; returns the next
    memory. `row` begins with the numbers of `Gains.packed`. A law that is a Python object (`make`)
    has none."""
    searched: tuple[str, ...] = ()
    """Gains that a tuning searches by default, in the order of its search space."""
    make: Callable[..., Any] | None = None
    """Function of gains and a `ssmr.control.mission.Mission` that makes the object, for a law that
    is a Python object."""
    velocity_step: Callable[..., tuple[Memory, Command]] = hold_memory
    """Kernel `(row, memory, seen, dt)` of the velocity loop; returns the next memory and the
    command."""
    manoeuvres: tuple[str, ...] = ()
    """`REVERSAL` and `SPOT_TURN`, if it can follow a path with them."""
    population: int = 50
    """Default number of candidates in a generation of a tuning."""
    generations: int = 150
    """Default number of generations of a tuning."""
    k_u: float = 0.0
    """Weight of |1 - u_RMS| in the cost of a tuning (Tab. 4.20)."""
