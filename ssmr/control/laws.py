"""The laws by name, and the one place where the compiled loops choose between them.

A law is two pure functions of packed gains and a memory of eight numbers: `position_step`, at the rate of the position
loop, and `velocity_step`, which gives the command at the rate at which the robot reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from ssmr._jit import jit
from ssmr.control import lqr, pid, scheduled, smc
from ssmr.types import FloatArray

Gains = pid.PidGains | lqr.LqrGains | scheduled.ScheduledGains | smc.SmcGains

GAINS: Mapping[str, type[Gains]] = {
    "pid": pid.PidGains,
    "lqr": lqr.LqrGains,
    "lqr-scheduled": scheduled.ScheduledGains,
    "smc": smc.SmcGains,
}
"""By controller. The order is the number by which the compiled loops know a law."""
CONTROLLERS = tuple(GAINS)
"""Names of the controllers."""
MEMORY = 8
"""Numbers that a law remembers."""


@dataclass(frozen=True)
class Controller:
    """A trajectory tracker: everything that defines the law, and no memory."""

    gains: Gains
    """Which law, and its gains."""
    a: tuple[tuple[float, ...], ...]
    """(4, 4) of the linear model (Eq. 2.46) that model-based laws are designed on."""
    b: tuple[tuple[float, ...], ...]
    """(4, 2) of the same."""

    @property
    def name(self) -> str:
        """`pid`, `lqr`, `lqr-scheduled` or `smc`."""
        return CONTROLLERS[self.number]

    @property
    def number(self) -> int:
        """By which the compiled loops know the law."""
        return list(GAINS.values()).index(type(self.gains))

    def packed(self) -> FloatArray:
        """Gains for the compiled loops, read-only.

        Raises:
            ValueError: no regulator exists for these weights.
        """
        return _packed(self)


@lru_cache(maxsize=4096)
def _packed(law: Controller) -> FloatArray:
    """`Controller.packed`, read-only: a law is packed for every reference that it drives, and its regulator solved once."""
    if isinstance(law.gains, lqr.LqrGains | scheduled.ScheduledGains):
        gains = law.gains.packed(np.array(law.a), np.array(law.b))
    else:
        gains = law.gains.packed()
    gains.setflags(write=False)
    return gains


def make_gains(controller: str, values: Mapping[str, float]) -> Gains:
    """The gains of a controller from numbers by name; what is not given has its default.

    Raises:
        ValueError: an unknown controller or name, or numbers that the law refuses.
    """
    if controller not in GAINS:
        raise ValueError(f"unknown controller '{controller}'; there are: {', '.join(CONTROLLERS)}")
    kind = GAINS[controller]
    names = [f.name for f in fields(kind)]
    for name in values:
        if name not in names:
            raise ValueError(f"{controller} has no gain '{name}'; there are: {', '.join(names)}")
    return kind(**values)


@jit
def position_step(law, gains, memory, e_rho, e_y, e_alpha, v_ref, w_ref, v, w, dt):
    """One step of the position loop: the memory after it."""
    if law == 0:
        return pid.position_loop(gains, memory, e_rho, e_y, e_alpha, dt)
    if law == 1:
        return lqr.regulate(gains, memory, e_rho, e_y, e_alpha, v, w, dt)
    if law == 2:
        return scheduled.regulate(gains, memory, e_rho, e_y, e_alpha, v_ref, w_ref, v, w, dt)
    return smc.slide(gains, memory, e_rho, e_y, e_alpha, v_ref, w_ref)


@jit
def velocity_step(law, gains, memory, v, w, dt):
    """One step of the velocity loop: the memory after it, v_cmd [m/s] and omega_cmd [rad/s]."""
    if law == 0:
        return pid.velocity_loop(gains, 6, memory, v, w, dt)
    if law == 3:
        return pid.velocity_loop(gains, smc.VELOCITY_LOOP, memory, v, w, dt)
    return memory, memory[5], memory[6]
