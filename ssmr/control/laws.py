"""The table of controllers, and the one place where the compiled loops choose between them.

To add a controller, write a file with its gains and kernels that ends in a `Law`, and add a line to
`LAWS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from ssmr._jit import jit
from ssmr.control import lqr, mpc, pid
from ssmr.control.law import Command, Gains, Law, Memory, Observation
from ssmr.control.mission import PythonController
from ssmr.control.waypoints import Errors, Target
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray

_PLAIN = {law.name: law for law in (
    pid.LAW,
    lqr.LAW,
    lqr.SCHEDULED_LAW,
)}  # fmt: skip
PREDICTOR = "+predictor"
"""Ending of the name of a law that acts on the state one dead time ahead."""
PLAIN_CONTROLLERS = tuple(_PLAIN)
"""Names of the compiled laws without a predictor. The order is the number by which the compiled
loops know a law."""
_PREDICTING = {
    name + PREDICTOR: replace(law, name=name + PREDICTOR) for name, law in _PLAIN.items()
}
LAWS: Mapping[str, Law] = MappingProxyType(_PLAIN | _PREDICTING | {mpc.LAW.name: mpc.LAW})
"""Declarations by name: the compiled laws, each of them behind a predictor, and those that are
Python objects."""
CONTROLLERS = tuple(LAWS)
"""Names of the controllers."""


@dataclass(frozen=True)
class Controller:
    """A trajectory tracker: everything that defines the law, and no memory."""

    gains: Gains
    """Gains; their type says which law it is."""
    a: tuple[tuple[float, ...], ...]
    """(4, 4) of the linear model (Eq. 2.46) that model-based laws are designed on."""
    b: tuple[tuple[float, ...], ...]
    """(4, 2) of the linear model."""
    drive: Drive = field(default_factory=Drive)
    """The driver between command and wheels, as the controller knows it."""
    predictor: bool = False
    """True if the law acts on the state one dead time ahead."""

    @property
    def name(self) -> str:
        """Name of the law, one of `CONTROLLERS`."""
        return PLAIN_CONTROLLERS[self.number] + (PREDICTOR if self.predictor else "")

    @property
    def number(self) -> int:
        """Place of the law in `PLAIN_CONTROLLERS`, by which the compiled loops know it."""
        return [law.gains for law in _PLAIN.values()].index(type(self.gains))

    def on(self, drive: Drive) -> Controller:
        """Return the same controller with knowledge of another driver."""
        return replace(self, drive=drive)

    def packed(self) -> FloatArray:
        """Return the gains as a row for the compiled loops, read-only.

        Raises:
            ValueError: no regulator exists for these weights.
        """
        return _packed(self.gains, self.a, self.b)

    def position_step(
        self, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float
    ) -> Memory:
        """Return the memory after one step of the position loop, `dt` [s] after the last."""
        return position_step(self.number, self.packed(), memory, errors, target, seen, dt)

    def velocity_step(self, memory: Memory, seen: Observation, dt: float) -> tuple[Memory, Command]:
        """Return the memory and the command after one step of the velocity loop, `dt` [s] after the last."""
        return velocity_step(self.number, self.packed(), memory, seen, dt)


AnyController = Controller | PythonController
"""A compiled law, or a controller that is a Python object."""


@lru_cache(maxsize=4096)
def _packed(
    gains: Gains, a: tuple[tuple[float, ...], ...], b: tuple[tuple[float, ...], ...]
) -> FloatArray:
    """Return `Controller.packed`; cached, because a law drives many references and its regulator is solved only once."""
    row = gains.packed(np.array(a), np.array(b))
    row.setflags(write=False)
    return row


def make_gains(controller: str, values: Mapping[str, float]) -> Gains:
    """The gains of a controller from numbers by name; a gain that is not given has its default.

    Raises:
        ValueError: an unknown controller or name, or numbers that the law refuses.
    """
    if controller not in LAWS:
        raise ValueError(f"unknown controller '{controller}'; there are: {', '.join(CONTROLLERS)}")
    kind = LAWS[controller].gains
    names = [f.name for f in fields(kind)]
    for name in values:
        if name not in names:
            raise ValueError(f"{controller} has no gain '{name}'; there are: {', '.join(names)}")
    return kind(**values)


def _choice(steps: Sequence[tuple[Callable[..., Any], Callable[..., Any]]]) -> Callable[..., Any]:
    """Return a compiled `(law, row, *arguments)` that unpacks the row and calls the step of law number `law`.

    numba cannot index a tuple of functions: each law compares its number, and hands what is not its
    own to the laws before.
    """
    (unpack, step), number, others = (
        steps[-1],
        len(steps) - 1,
        _choice(steps[:-1]) if len(steps) > 1 else None,
    )

    @jit
    def choose(law: int, row: FloatArray, *arguments: Any) -> Any:
        if others is None or law == number:
            return step(unpack(row), *arguments)
        return others(law, row, *arguments)

    return choose


_POSITION = _choice(
    [(law.unpack, law.position_step) for law in _PLAIN.values() if law.unpack and law.position_step]
)
_VELOCITY = _choice([(law.unpack, law.velocity_step) for law in _PLAIN.values() if law.unpack])


@jit
def position_step(
    law: int,
    row: FloatArray,
    memory: Memory,
    errors: Errors,
    target: Target,
    seen: Observation,
    dt: float,
) -> Memory:
    """Return the memory of law number `law` with gains `row` after a step of its position loop."""
    after: Memory = _POSITION(law, row, memory, errors, target, seen, dt)
    return after


@jit
def velocity_step(
    law: int, row: FloatArray, memory: Memory, seen: Observation, dt: float
) -> tuple[Memory, Command]:
    """Return the memory and the command of law number `law` with gains `row` after a step of its velocity loop."""
    after: tuple[Memory, Command] = _VELOCITY(law, row, memory, seen, dt)
    return after


def design(
    name: str, values: Mapping[str, float], a: FloatArray, b: FloatArray, drive: Drive | None = None
) -> AnyController:
    """Return one of `CONTROLLERS` with gains by name on a linear model, (4, 4) `a` and (4, 2) `b` of Eq. 2.46.

    Gains that are not given have their defaults. `drive` is the driver between command and wheels
    as the controller knows it, the thesis' one if not given.

    Raises:
        ValueError: an unknown controller or gain, or gains that the law refuses.
    """
    gains, known = make_gains(name, values), drive or Drive()
    model = tuple(map(tuple, np.asarray(a).tolist())), tuple(map(tuple, np.asarray(b).tolist()))
    make = LAWS[name].make
    if make is not None:
        return PythonController(name, partial(make, gains), *model, known)
    law = Controller(gains, *model, known, name.endswith(PREDICTOR))
    law.packed()
    return law
