"""How a robot's tyres change from log to log: a row for each, and a sentence where one changed.

Tyres lose air and wear, and ground gives way: the way that a side's wheels roll in a turn, by the
kinematic fit to a log alone, says so long before anybody sees it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ssmr.metrics.paired import SIGNIFICANCE, correct_by_holm
from validation.report.columns import Unit
from validation.report.table import Table

_REPEATS = 0.008
"""Robust standard deviation of rolling radii between halves of public logs [1]: what changes within
a log is no change of tyres."""
_CHANGES = {
    "wheel_radius_left": ("the left wheels roll", "shorter", "farther"),
    "wheel_radius_right": ("the right wheels roll", "shorter", "farther"),
    "right_over_left": ("the right wheels, beside the left ones, roll", "shorter", "farther"),
    "icr_distance": ("the robot turns as if its track were", "narrower", "wider"),
}
"""Words for a change of each number, for less and for more."""


def tyre_row(
    log: str,
    numbers: Mapping[str, float],
    error_of: Callable[[Mapping[str, float]], float],
    radius: float,
) -> dict[str, Any]:
    """Return rolling radii of both sides, their ratio and the distance of the sides' centres.

    Args:
        log: name of the log.
        numbers: what a kinematic fit found in it alone, by name.
        error_of: function that returns the standard error of a weighted sum of these.
        radius: radius of the wheels that shares are of [m].
    """
    left = numbers["alpha_l"]
    ratio = numbers["alpha_r"] / left
    values = (radius * left, radius * ratio * left, ratio, numbers["y_l"] - numbers["y_r"])
    weights = (
        {"alpha_l": radius},
        {"alpha_r": radius},
        {"alpha_r": 1.0 / left, "alpha_l": -ratio / left},
        {"y_l": 1.0, "y_r": -1.0},
    )
    errors = dict(zip(_CHANGES, map(error_of, weights), strict=True))
    return {"log": log, **dict(zip(_CHANGES, values, strict=True)), "standard_errors": errors}


def change_sentences(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each number of a log that differs from the first log's beyond chance.

    Chances are corrected for the number of comparisons.
    """
    chances = []
    sentences = []
    for row in rows[1:]:
        first = rows[0]
        for key, (lead, *words) in _CHANGES.items():
            change = row[key] / first[key] - 1.0
            parts = [each["standard_errors"][key] / each[key] for each in (row, first)]
            error = math.hypot(*parts, _REPEATS)
            chances.append(math.erfc(abs(change) / error / math.sqrt(2.0)))
            sentences.append(
                f"On {row['log']} {lead} {100.0 * abs(change):.1f} ± {100.0 * error:.1f} % "
                f"{words[change > 0.0]} than on {first['log']}"
            )
    adjusted = correct_by_holm(chances).tolist()
    return [said for said, p in zip(sentences, adjusted, strict=True) if p < SIGNIFICANCE]


def tyre_tables(rows: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return a table of what logs tell of the tyres, if there are any."""
    shown = []
    for row in rows:
        cells: dict[str, Any] = {"log": row["log"]}
        for key, error in row["standard_errors"].items():
            cells[key] = (row[key], row[key] - 2.0 * error, row[key] + 2.0 * error)
        shown.append(cells)
    units = {key: Unit("1" if key == "right_over_left" else "m", 1.0, 3) for key in _CHANGES}
    title = "Tyres by each log alone, with two standard errors"
    return [Table(title, shown, units=units)] * bool(shown)
