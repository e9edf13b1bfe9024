"""The table of controllers, and the one place where the compiled loops choose between them.

To add a controller, write a file with its gains and kernels that ends in a `Law`, and add a line to
`LAWS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from ssmr._jit import jit, jit_alone, python_source
from ssmr.control import lqr, mpc, pid
from ssmr.control.law import Command, Gains, Law, Matrix, Memory, Observation
from ssmr.control.mission import PythonController
from ssmr.control.waypoints import Errors, Target
from ssmr.parameters import describe_parameters, require_one_of
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray

_PLAIN = {law.name: law for law in (pid.LAW, lqr.LAW, lqr.SCHEDULED_LAW)}
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
    a: Matrix
    """(4, 4) of the linear model (Eq. 2.46) that model-based laws are designed on."""
    b: Matrix
    """(4, 2) of the linear model."""
    drive: Drive = field(default_factory=Drive)
    """The driver between command and wheels, as the controller knows it."""
    predictor: bool = False
    """True if the law acts on the state one dead time ahead."""

    @property
    def name(self) -> str:
        """Name of the law, one of `CONTROLLERS`."""
        plain = PLAIN_CONTROLLERS[self.number]
        return plain + PREDICTOR if self.predictor else plain

    @property
    def manoeuvres(self) -> tuple[str, ...]:
        """Manoeuvres beside bends that the law can follow, as `Law.manoeuvres` declares them."""
        return LAWS[self.name].manoeuvres

    @property
    def number(self) -> int:
        """Place of the law in `PLAIN_CONTROLLERS`, by which the compiled loops know it."""
        kinds = [law.gains for law in _PLAIN.values()]
        return kinds.index(type(self.gains))

    def on(self, drive: Drive) -> Controller:
        """Return the same controller with knowledge of another driver."""
        return replace(self, drive=drive)

    def packed(self) -> FloatArray:
        """Return the gains as a row for the compiled loops, read-only.

        Raises:
            ValueError: no regulator exists for these weights.
        """
        return _gain_row(self.gains, self.a, self.b)

    def position_step(
        self, memory: Memory, errors: Errors, target: Target, seen: Observation, dt: float
    ) -> Memory:
        """Return the memory after one step of the position loop, `dt` [s] after the last."""
        now = (memory, errors, target, seen, dt)
        return position_step_alone(self.number, self.packed(), *now)

    def velocity_step(self, memory: Memory, seen: Observation, dt: float) -> tuple[Memory, Command]:
        """Return memory and command after a step of the velocity loop, `dt` [s] after the last."""
        return velocity_step_alone(self.number, self.packed(), memory, seen, dt)


AnyController = Controller | PythonController
"""A compiled law, or a controller that is a Python object."""


@lru_cache(maxsize=4096)
def _gain_row(gains: Gains, a: Matrix, b: Matrix) -> FloatArray:
    """Return `Controller.packed`; cached, because a law drives many references.

    So its regulator is solved only once.
    """
    row = gains.packed(np.array(a), np.array(b))
    row.setflags(write=False)
    return row


def make_gains(controller: str, values: Mapping[str, float]) -> Gains:
    """The gains of a controller from numbers by name; a gain that is not given has its default.

    Raises:
        ValueError: an unknown controller or name, or numbers that the law refuses.
    """
    require_one_of(controller, LAWS, f"unknown controller '{controller}'")
    kind = LAWS[controller].gains
    names = describe_parameters(kind)
    for name in values:
        require_one_of(name, names, f"{controller} has no gain '{name}'")
    return kind(**values)


def _choose_step(steps: Sequence[Callable[..., Any]]) -> Callable[..., Any]:
    """Return a compiled `(law, row, *arguments)` that calls the step of law number `law`.

    numba cannot index a tuple of functions: each law compares its number, and hands any other
    number to the laws before.
    """
    number = len(steps) - 1
    step = steps[number]
    others = _choose_step(steps[:number]) if number > 0 else None

    @jit
    def choose(law: int, row: FloatArray, *arguments: Any) -> Any:
        if others is None or law == number:
            return step(row, *arguments)
        return others(law, row, *arguments)

    return choose


_chosen_position_step: Callable[..., Memory] = _choose_step(
    [law.position_step for law in _PLAIN.values() if law.position_step]
)


@jit
def position_step(law: int, row: FloatArray, memory: Memory, *now: Any) -> Memory:
    """Return the memory of law number `law` with the gains `row` after a position step.

    `now` is errors, target, seen and dt, see `Law.position_step`. What integrals of position errors
    hold is the speed and the turn of the target, so they are zero where it stands.
    """
    before = memory
    if now[1].v == 0.0:
        before = Memory(
            i_rho=0.0,
            i_y=0.0,
            i_alpha=0.0,
            i_u=memory.i_u,
            i_w=memory.i_w,
            u_ref=memory.u_ref,
            w_ref=memory.w_ref,
        )
    return _chosen_position_step(law, row, before, *now)


velocity_step: Callable[..., tuple[Memory, Command]] = _choose_step(
    [law.velocity_step for law in _PLAIN.values()]
)
"""Compiled `(law, row, memory, seen, dt)`, see `Law.velocity_step`."""
# what Python calls is kept on disk
position_step_alone = jit_alone(python_source(position_step))
velocity_step_alone = jit_alone(python_source(velocity_step))


def design_controller(
    name: str, values: Mapping[str, float], a: FloatArray, b: FloatArray, drive: Drive | None = None
) -> AnyController:
    """Return one of `CONTROLLERS` with gains by name, designed on a linear model.

    The model is (4, 4) `a` and (4, 2) `b` of Eq. 2.46. Gains that are not given have their
    defaults. `drive` is the driver between command and wheels as the controller knows it, the
    thesis' one if not given.

    Raises:
        ValueError: an unknown controller or gain, or gains that the law refuses.
    """
    gains = make_gains(name, values)
    rows_a = tuple(map(tuple, np.asarray(a).tolist()))
    rows_b = tuple(map(tuple, np.asarray(b).tolist()))
    driver = drive or Drive()
    declared = LAWS[name]
    if declared.make is not None:
        make = partial(declared.make, gains)
        return PythonController(name, make, rows_a, rows_b, driver, declared.manoeuvres)
    law = Controller(gains, rows_a, rows_b, driver, name.endswith(PREDICTOR))
    law.packed()
    return law
