"""How long work tells its caller how far it is: a callback, so that nothing here knows of terminals."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Progress(NamedTuple):
    """How far a long computation is."""

    done: float
    """How many of its steps are finished; a fraction where a step is under way."""
    total: float
    """How many steps there are."""
    text: str
    """What is under way, in a few words: `traj4, mujoco`, or `cost 0.0031`."""


Report = Callable[[Progress], object]
"""A callback that takes each `Progress` as it happens. It is called from one thread at a time."""


def silent(progress: Progress) -> None:
    """Ignore `progress`: the report of those who do not ask for one."""
