"""ROS: floods of messages, nonsense among them, at both nodes; they stay quick, say little, and the robot stops.

Each flood comes twice: over a real master, where there is one, and over a port and a clock that are none.
"""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests import ros_floods
from tests.faults.doors import Broken, call
from tests.faults.judge import Outcome
from tests.faults.pool import Part

MOST = {"without ROS": (40, 0.51), "over a master": (100, 3.0)}
"""Lines that a node may write in two seconds of nonsense, and time from an emergency stop until the robot stands [s]; over
a master, on a machine that has other work."""


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many floods there are: one of each kind in each way."""
    there = shutil.which("roscore") is not None
    fakes = [f"{kind}, without ROS" for kind in ros_floods.KINDS if kind not in ("quiet", "truncated")]
    return dict.fromkeys([*fakes, *([f"{kind}, over a master" for kind in ros_floods.KINDS] if there else [])], 1)


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Flood a node."""
    name, _, way = kind.partition(", ")
    rate = 100.0 if name == "truncated" else rng.choice((500.0, 1000.0, 2000.0))
    lines, stop = MOST[way]

    def see() -> None:
        found = (ros_floods.flood_without_ros if "without" in way else ros_floods.flood)(name, rate, 2.0)
        if found.errors:
            raise Broken("traceback", "; ".join(found.errors))
        if found.lines > lines:
            raise Broken("unclear line", f"{found.lines} lines")
        if found.stop_s > stop:
            raise Broken("hang", f"the robot stood {found.stop_s:.2f} s after it was told to")
        if found.exit_status not in (0, 1, 130):
            raise Broken("false status", f"status {found.exit_status}")

    return call(f"{kind}, {rate:g} messages a second", see, limit=300.0), (0,)


PART = Part(plan, run, patience=600.0)
