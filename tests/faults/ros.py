"""ROS: floods of messages and malformed ones, through the nodes' own loops."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

from tests.faults.judge import Outcome
from tests.faults.pool import Part


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are."""
    return {}


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Send a node what no robot sends."""
    raise NotImplementedError


PART = Part(plan, run)
