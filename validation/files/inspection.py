"""The inspection of a log: what it shows by itself, found once, where it is opened."""

from __future__ import annotations

from dataclasses import dataclass

from validation.files.faults import Faults, Rest, find_faults, find_rest
from validation.files.log import Log
from validation.files.offsets import Offset, estimate_offsets


@dataclass(frozen=True, eq=False)
class Inspected:
    """A log, and what it shows by itself."""

    log: Log
    """The log that was looked at."""
    faults: Faults
    """Its faults."""
    offsets: tuple[Offset, ...]
    """Delays between its signals."""
    rest: Rest | None
    """The gyro's readings while the robot stands; None without any."""


def inspect(log: Log, radius: float | None = None) -> Inspected:
    """Look at a log; `radius` is that of the robot's wheels [m], None where it is unknown."""
    return Inspected(log, find_faults(log, radius), tuple(estimate_offsets(log)), find_rest(log))
