"""Progress of long work.

A callback tells the caller how far the work is, so that no library knows of terminals.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Progress(NamedTuple):
    """Progress of a long computation."""

    done: float
    """Number of finished steps; with a fraction while a step is under way."""
    total: float
    """Number of all steps."""
    text: str
    """The step under way in a few words, such as `traj4, mujoco` or `cost 0.0031`."""


Progressing = Callable[[Progress], object]
"""A callback that takes each `Progress` as it happens. It is called from one thread at a time."""


def silent(progress: Progress) -> None:
    """Ignore `progress`; the default where nobody asks for reports."""
