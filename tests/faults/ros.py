"""ROS: floods of messages, nonsense among them, at both nodes; they stay quick, say little, and the robot stops.

Port and clock are none, so that a flood takes seconds.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

from tests import ros_floods
from tests.faults.doors import Broken, call
from tests.faults.judge import Outcome
from tests.faults.pool import Part

MOST_LINES, MOST_S = 40, 0.51
"""Lines that a node may write in two seconds of nonsense, and time from an emergency stop until the robot stands [s]."""


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many floods there are: one of each kind."""
    return dict.fromkeys((kind for kind in ros_floods.KINDS if kind != "quiet"), 1)


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Flood a node."""
    rate = rng.choice((500.0, 1000.0, 2000.0))

    def see() -> None:
        found = ros_floods.flood_without_ros(kind, rate, 2.0)
        if found.errors:
            raise Broken("traceback", "; ".join(found.errors))
        if found.lines > MOST_LINES:
            raise Broken("unclear line", f"{found.lines} lines")
        if found.stop_s > MOST_S:
            raise Broken("hang", f"the robot stood {found.stop_s:.2f} s after it was told to")

    return call(f"{kind}, {rate:g} messages a second", see, limit=300.0), (0,)


PART = Part(plan, run, patience=600.0)
