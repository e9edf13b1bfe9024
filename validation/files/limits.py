"""Limits of logs: a log beyond them is damaged, hostile or in other units than it should be."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssmr.parameters import check_parameters, describe_parameters, parameter
from ssmr.types import FloatArray

_BUNCHED = 1e-4
"""Shortest single step of time, in periods of the limit `rate`: messages come in bunches, but a
step must not underflow."""
_USUAL_PERIOD = 0.02
"""Period of a usual log [s]: time in another unit is recognised by the factor that brings its steps
near to this."""
_UNITS = {1: ("milliseconds", "ms"), 2: ("microseconds", "us"), 3: ("nanoseconds", "ns")}


def _limit(default: float, unit: str) -> Any:
    return parameter(default, unit=unit, low=0.0, open_low=True)


@dataclass(frozen=True)
class LogLimits:
    """The greatest sizes that a log may have; each can be raised, to infinity if need be.

    Raises:
        ValueError: a limit that is not positive.
    """

    table_size: float = _limit(500.0, "MB")
    """Size of a CSV file, which is read whole; bags are read message by message."""
    samples: float = _limit(1e7, "1")
    """Number of rows, of messages that are read, and of instants of a common clock."""
    span: float = _limit(864_000.0, "s")
    """Time from the first sample to the last."""
    gap: float = _limit(3600.0, "s")
    """Longest step of time."""
    period: float = _limit(5.0, "s")
    """Median step of time."""
    rate: float = _limit(1e5, "Hz")
    """Samples a second, by the median step."""

    def __post_init__(self) -> None:
        """Check that all are positive."""
        check_parameters(self)

    def changed(self, values: Mapping[str, float]) -> LogLimits:
        """Return the limits with other values, by name.

        Raises:
            ValueError: there is no limit of that name, or a value is not positive.
        """
        limits = describe_parameters(LogLimits)
        for name in values:
            if name not in limits:
                raise ValueError(f"unknown limit '{name}'; there are: {', '.join(limits)}")
        return replace(self, **values)

    def says(self, name: str) -> str:
        """Return the words for a limit in messages: `the limit span is 864000 s`."""
        unit = describe_parameters(LogLimits)[name].unit
        words = f"the limit {name} is {getattr(self, name):g}"
        return words if unit == "1" else f"{words} {unit}"

    def bytes_of(self, name: str) -> int:
        """Return a limit that is given in MB, in bytes."""
        return int(min(1e6 * float(getattr(self, name)), 2.0**62))


USUAL = LogLimits()
"""The limits of logs for which nobody asked for others."""


def find_time_fault(t: FloatArray, limits: LogLimits, name: str = "") -> tuple[int, str] | None:
    """Return row and sentence of the fault of (M,) finite stamps [s], M at least 2, if any.

    The stamps have that `name` in a table, for `--columns`; none where that option means another.
    """
    # steps that are infinite are beyond every limit
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(t)
        span = float(t[-1] - t[0])
        usual = float(np.median(steps))
    stays = np.flatnonzero(steps <= 0.0)
    if len(stays):
        turns = stays[steps[stays] < 0.0]
        k = int(np.append(turns, stays)[0])
        what = (
            f"time must increase, but {t[k + 1]:.16g} s follows {t[k]:.16g} s: "
            f"{len(turns) or len(stays)} of {len(t)} rows "
        )
        if len(turns):
            return k + 1, f"{what}go back, this one by {-steps[k]:.6g} s"
        lost = "; t has lost its fraction, as in whole seconds or 32 bits: write it in full"
        return k + 1, f"{what}repeat the stamp before with other numbers" + lost * np.array_equal(
            np.rint(t), t
        )
    long = int(np.argmax(steps))
    jump = f"time jumps from {t[long]:.16g} to {t[long + 1]:.16g} s"
    median = f"the median step is {usual:.6g} s"
    near = f"the step from the sample before is {np.min(steps):.3g} s"
    thousands = round(math.log(np.clip(usual, 1e-99, 1e99) / _USUAL_PERIOD, 1000.0))
    looks = ""
    if thousands in _UNITS:
        words, unit = _UNITS[thousands]
        looks = f"; t looks like {words}"
        looks += f": --columns {shlex.quote(f't={name}:{unit}')}" if name else ""
    # in the order in which they explain one another
    for is_beyond, row, what, limit, advice in (
        (usual > limits.period, 0, median, "period", looks),
        (usual * limits.rate < 1.0, 0, median, "rate", "; wanted t in seconds"),
        (np.min(steps) * limits.rate < _BUNCHED, int(np.argmin(steps)) + 1, near, "rate", ""),
        (steps[long] > limits.gap, long + 1, jump, "gap", ": cut the log there"),
        (span > limits.span, len(t) - 1, f"the log spans {span:.6g} s", "span", looks),
    ):
        if is_beyond:
            return row, f"{what}, but {limits.says(limit)}{advice}"
    return None
