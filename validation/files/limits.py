"""Limits of logs: a log beyond them is damaged, hostile or in other units than it should be."""

from __future__ import annotations

import math
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
_PLAUSIBLE = math.log(1000.0)
"""Logarithm of the greatest ratio of a step to `_USUAL_PERIOD` that a unit is recognised by."""
_COARSE = 1e6
"""Time from which numbers of 32 bits have steps of a sixteenth of a second or more [s]."""
_UNITS = {"seconds": 1.0, "milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


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


def find_time_fault(t: FloatArray, limits: LogLimits) -> tuple[int, str] | None:
    """Return row and sentence of the fault of (M,) finite stamps [s], M at least 2, if any."""
    # steps that are infinite are beyond every limit
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(t)
        span = float(t[-1] - t[0])
        usual = float(np.median(steps))
    back = np.flatnonzero(steps <= 0.0)
    if len(back):
        k = int(back[0])
        what = f"time must increase, but {t[k + 1]:.16g} s follows {t[k]:.16g} s"
        with np.errstate(over="ignore"):
            single = t.astype(np.float32).astype(np.float64)
        if abs(t[k]) > _COARSE and np.array_equal(single, t):
            what += ": t has lost its fraction, for these are 32-bit floats; write it in full"
        return k + 1, what
    median = f"the median step is {usual:.6g} s"
    if usual > limits.period:
        return (0, f"{median}, but {limits.says('period')}{_other_unit(usual)}")
    if usual * limits.rate < 1.0:
        return (0, f"{median}, but {limits.says('rate')}; wanted t in seconds")
    short = int(np.argmin(steps))
    long = int(np.argmax(steps))
    if steps[short] * limits.rate < _BUNCHED:
        return (
            short + 1,
            f"the step from the sample before is {steps[short]:.3g} s, but {limits.says('rate')}",
        )
    if steps[long] > limits.gap:
        return (
            long + 1,
            f"time jumps from {t[long]:.16g} to {t[long + 1]:.16g} s, "
            f"but {limits.says('gap')}: cut the log there",
        )
    if span > limits.span:
        return (
            len(t) - 1,
            f"the log spans {span:.6g} s, but {limits.says('span')}{_other_unit(usual)}",
        )
    return None


def _other_unit(step: float) -> str:
    """Return the end of a sentence on the unit of a step; nothing if it looks like seconds."""
    away = {name: abs(math.log(step / factor / _USUAL_PERIOD)) for name, factor in _UNITS.items()}
    name = min(away, key=lambda unit: away[unit])
    if name == "seconds" or away[name] >= _PLAUSIBLE:
        return ""
    return f"; t looks like {name}: divide it by {_UNITS[name]:g}"
