"""Every command as it is meant, undisturbed: what is tried on it later works at all, and all compiled code is there."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

from tests.faults import files
from tests.faults.doors import process
from tests.faults.judge import Outcome
from tests.faults.pool import Part
from tests.faults.programs import LONG, USUAL


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are: one of each."""
    return dict.fromkeys(USUAL, 1)


_EXPECTED = {"ros sim": (0, 2), "ros control": (1, 2)}
"""Statuses of nodes: without cyclonedds they are refused, and there is no robot to control."""


def run(name: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Run a command; only where its budget is none at all it is refused."""
    work = folder / "work"
    files.lay_out(work)
    argv = [f"validation.{name.split()[0]}", *USUAL[name].argv()]
    out = process(" ".join(argv), argv, work, timeout=900.0)
    return out, _EXPECTED.get(name, (2,) if name in LONG else (0,))


PART = Part(plan, run, patience=1000.0)
