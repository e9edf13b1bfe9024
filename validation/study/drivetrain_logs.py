"""Commands that a log holds, and evidence whether its wheel rates are measured or set points."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from ssmr.types import FloatArray
from validation.identify.motor_logs import DriveLog
from validation.report.table import Row

HELD = 5.0
_RESPONSE_S = 0.5
_USED = 5.9
"""A command counts if it is held so long and the wheels' rates change so soon after it; so much of
it is used [s]."""
_LATE = 2.0  # wheel rates have settled so long after a command [s]
_NO_SCATTER = 1e-6  # standard deviation of a rate that is logged again and again [rad/s]: rounding
_FINEST_STEP = 0.01
_OFF_STEP = 0.02
"""Least step of wheel rates that is no rounding of the log [rad/s], and how far rates may lie off
its multiples [steps]."""


def held_commands(log: DriveLog) -> list[slice]:
    """Return the samples of each command but zero that was held for `HELD` and at once obeyed."""
    if log.commands is None:
        return []
    new = np.any(np.diff(log.commands, axis=1) != 0.0, axis=0)
    held = list[slice]()
    for first, stop in pairwise([0, *(np.flatnonzero(new) + 1).tolist(), len(log.t)]):
        t = log.t[first:stop] - log.t[first]
        if not log.commands[:, first].any() or t[-1] < HELD or np.diff(t).max() > _RESPONSE_S:
            continue
        moved = np.any(np.diff(log.rates[:, first:stop], axis=1) != 0.0, axis=0)
        if moved[t[1:] < _RESPONSE_S].any():
            held.append(slice(first, first + int(np.searchsorted(t, _USED))))
    return held


def rate_evidence(log: DriveLog) -> Row:
    """Return what a log says on whether its wheel rates were measured.

    Set points never change under a command that is held (`scatter_rad_s`, the median standard
    deviation of a settled rate [rad/s]; NaN without such a command) or only come in steps
    (`step_rad_s`).
    """
    held = held_commands(log)
    late = [log.rates[:, span][:, log.t[span] > log.t[span.start] + _LATE] for span in held]
    scatter = float(np.median([rates.std(axis=1) for rates in late])) if late else math.nan
    step = rate_step(log.rates)
    return {
        "log": log.name,
        "commands": len(held),
        "scatter_rad_s": scatter,
        "step_rad_s": step,
        "wheel_rates_are": "measured"
        if step is None and not scatter < _NO_SCATTER
        else "set points",
    }


def rate_step(rates: FloatArray) -> float | None:
    """Return the step of which all (2, M) rates are multiples; None if it is not worth mention."""
    sizes = np.unique(np.abs(rates).round(4))
    apart = np.diff(sizes)
    apart = apart[apart > 0.5 * _FINEST_STEP]
    if len(apart) < 2:
        return None
    step = float(np.median(apart[apart < 1.5 * apart.min()]))
    for _ in range(3):  # sharper with every whole number of steps
        whole = np.round(sizes / step)
        step = float((sizes @ whole) / (whole @ whole))
    off = np.abs(sizes / step - np.round(sizes / step))
    return step if step > _FINEST_STEP and np.mean(off < _OFF_STEP) > 0.99 else None
