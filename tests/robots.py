"""Robots that tests drive: the Husky of the thesis, with any of its numbers changed."""

from __future__ import annotations

from typing import Any

from validation import load_robot
from validation.simulator.calibration import Calibration

HUSKY = load_robot("husky")
WHEELBASE, TRACK = HUSKY.geometry.wheelbase, HUSKY.geometry.track


def husky(**changes: Any) -> Calibration:
    """Return the Husky's numbers with some changed."""
    return Calibration.of(HUSKY, **changes)
