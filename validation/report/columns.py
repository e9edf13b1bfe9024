"""Columns of tables: heading, unit, digits and meaning of a value by the name of its key.

A key ends with its unit (`d_rms_m`, `yaw_median_rad`, `mass_kg`), so most columns need no
declaration. A declared one, a `ssmr.metrics.declared.Metric`, has a heading of its own, a direction
that is better, and a sentence for the legend.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ssmr.metrics.declared import METRICS, SIGNALS, Metric

NOTHING = "–"
"""Text for a number that is missing or not finite."""


@dataclass(frozen=True)
class Unit:
    """Unit and digits of the numbers of one quantity in one table."""

    symbol: str
    """Symbol of the unit, which stands in brackets."""
    scale: float
    """Number of these units in one SI unit."""
    decimals: int
    """Digits after the point."""
    significant: int = 0
    """Significant digits to round to first; 0 for no such rounding."""

    def text(self, value: float) -> str:
        """Return a number in SI as it is written, without its unit."""
        if not math.isfinite(value):
            return NOTHING
        scaled = value * self.scale
        if self.significant > 0:
            scaled = float(f"{scaled:.{self.significant}g}")
        text = f"{scaled:.{self.decimals}f}"
        if float(text) == 0.0:
            return text.removeprefix("-")
        return text


METRES = Unit("m", 1.0, 3)
MILLIMETRES = Unit("mm", 1e3, 1)
DEGREES = Unit("deg", 180.0 / math.pi, 2)
_PERCENT = Unit("%", 100.0, 1)
_ENDINGS = {
    "_m_s2": Unit("m/s²", 1.0, 2),
    "_rad_s2": Unit("rad/s²", 1.0, 2),
    "_m_s": Unit("m/s", 1.0, 2),
    "_rad_s": Unit("rad/s", 1.0, 3),
    "_N_m": Unit("N m", 1.0, 1),
    "_m": METRES,
    "_rad": DEGREES,
    "_kg": Unit("kg", 1.0, 1),
    "_N": Unit("N", 1.0, 0),
    "_A": Unit("A", 1.0, 2),
    "_V": Unit("V", 1.0, 2),
    "_W": Unit("W", 1.0, 1),
    "_Hz": Unit("Hz", 1.0, 1),
    "_us": Unit("µs", 1e6, 1),
    "_ms": Unit("ms", 1e3, 2),
    "_s": Unit("s", 1.0, 2),
    "_share": _PERCENT,
    "_fraction": _PERCENT,
}
"""Units by the ending of a key, longer endings first; a key of `_us` or `_ms` holds seconds, as all
values are SI."""
_LABELS = {"plant": "simulation"}
"""Headings of columns whose keys say it in another word."""
_PLAIN = Unit("", 1.0, 3, significant=4)

REAL_TIME = Metric(
    "real_time_factor",
    "real time",
    "×",
    "high",
    "simulated time over the time of one processor that it took, without compiling; "
    "above 1 the simulation is faster than the clock",
)
DECLARED: dict[str, Metric] = {**METRICS, **SIGNALS, REAL_TIME.name: REAL_TIME}
"""Columns with a declaration, by key."""


def declare(*columns: Metric) -> None:
    """Declare the heading, unit, direction and meaning of columns, each beside what computes it."""
    DECLARED.update({column.name: column for column in columns})


def length_unit(values: Iterable[float]) -> Unit:
    """Return millimetres for lengths [m] that all stay below a metre, else metres."""
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    if largest >= 1.0:
        return METRES
    return Unit("mm", 1e3, 3 if 1e-6 <= largest < 0.001 else 1)


def ending_of(key: str) -> str:
    """Return the unit at the end of a key, with its underscore; empty where there is none."""
    return next((ending for ending in _ENDINGS if key.endswith(ending)), "")


def heading_of(key: str) -> str:
    """Return the heading of a column without its unit; a dotted key has those of its parts."""
    *parts, last = key.split(".")
    label = _LABELS.get(last) or last.removesuffix(ending_of(last)).replace("_", " ")
    if last in DECLARED:
        label = DECLARED[last].label
    return " ".join([*parts, label])


def unit_of(key: str, values: Sequence[float], lengths: Sequence[float] = ()) -> Unit:
    """Return how to write a column.

    Args:
        key: its key.
        values: its numbers [SI].
        lengths: all lengths of the table [m]; all have one unit.
    """
    key = key.rpartition(".")[2]
    if is_length(key):
        return length_unit(lengths)
    kind = DECLARED[key].unit if key in DECLARED else None
    if kind not in ("1", "1/s²", "×"):
        return _ENDINGS.get(ending_of(key), _PLAIN)
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    if kind == "1":
        return Unit("1", 1.0, 4 if largest < 100.0 else 2)
    if kind == "1/s²":
        return Unit("1/s²", 1.0, 1)
    return Unit("×", 1.0, 0 if largest >= 100.0 else 2, significant=3)


def is_length(key: str) -> bool:
    """Return whether a column holds lengths [m]."""
    if key in DECLARED:
        return DECLARED[key].unit == "m"
    return ending_of(key) == "_m"


def column_legend(keys: Iterable[str]) -> list[str]:
    """Return one sentence for each declared column of these keys."""
    return [f"{DECLARED[key].label}: {DECLARED[key].meaning}." for key in keys if key in DECLARED]
