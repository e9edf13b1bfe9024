"""Inertia over torque constant, J / K, from the charge that passes while wheels in the air change their speed.

The current of a side is I = c sgn(w) + (J / K) dw/dt, so that speeding up from w_0 to w_1 takes the charge
(J / K) (w_1 - w_0) above that of the losses c, whatever the current does meanwhile: a sensor that is read a few times a
second, at any moments, has the integral right on average. Braking hardly shows, because the bridge then does not drive.

Speed-ups of one sign need no more than that. Reversals, which are half a braking, need the rule of what is read. The two are
estimated apart, and how far apart they lie counts as uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ssmr.robot.drivetrain import SetPointLaw, bridge_reading, rim_speeds
from ssmr.types import FloatArray
from validation.study.drivetrain.evidence import held_commands
from validation.study.drivetrain.logs import Chassis, DriveLog

_BEFORE, _AFTER = 0.1, 1.8
"""The charge of a transient is taken from so long before its command to so long after it [s]."""
_STEADY_BEFORE = 0.8
"""Wheel rates have to be steady for so long before a command [s]."""
_LEAST_CHANGE = 0.3
"""Rates that change by less tell nothing [rad/s]."""
_STEADY = 0.2
"""Rates that differ by less are the same one [rad/s]."""
_FINE = 0.005
"""Period on which predicted currents are integrated [s]."""
INERTIA_GRID = np.linspace(0.0, 1.2, 49)
"""Values of J / K that are tried [A s^2/rad]; the best is found between them by a parabola."""
_OUTLIER = 0.6
"""Charges that are further off count less than their square [A s]."""


LEAST_TRANSIENTS = 5
"""Fewest speed-ups, or reversals, that an estimate is made from."""


class Transient(NamedTuple):
    """One side's change of speed after one command."""

    command: int
    """Number of the command."""
    reversal: bool
    """True if the wheels change their direction, false if they only speed up."""
    change: float
    """Rate after less rate before, counted in the direction of the rate after [rad/s]."""
    measured: float
    """Charge that passed [A s]."""
    predicted: FloatArray
    """Charge for each J / K tried, that of the losses included [A s]; the first is for no inertia."""


@dataclass(frozen=True, eq=False)
class InertiaFit:
    """J / K, and what it was found from."""

    log: str
    """Name of the log."""
    value: float
    """Mean of the two estimates [A s^2/rad]."""
    standard_error: float
    """Half the difference of the two, and their resampled errors, together [A s^2/rad]."""
    speed_ups: tuple[float, float] | None
    """Estimate from speed-ups of one sign, and its standard error [A s^2/rad]; None where they are too few."""
    reversals: tuple[float, float] | None
    """Estimate from reversals, and its standard error [A s^2/rad]; None where they are too few."""
    transients: tuple[Transient, ...]


def fit_inertia(
    log: DriveLog, law: SetPointLaw, chassis: Chassis, rho: float, rng: np.random.Generator, draws: int
) -> InertiaFit | None:
    """Return J / K from a log whose wheels are in the air; None where too few transients are fit for it.

    Args:
        log: the log; its currents are taken for the motors'.
        law: the driver, which says how fast the wheels change speed.
        chassis: the robot.
        rho: resistance over voltage constant [rad/s per A].
        rng: generator for the bootstrap over commands.
        draws: number of its draws.
    """
    found = transients(log, law, chassis, rho)
    estimates: dict[bool, tuple[float, float]] = {}
    for reversal in (False, True):
        some = [x for x in found if x.reversal == reversal]
        if len(some) >= LEAST_TRANSIENTS:
            commands, costs = np.array([x.command for x in some]), _costs(some)
            members = [np.flatnonzero(commands == c) for c in np.unique(commands)]
            drawn = [
                _least(costs[:, np.concatenate([members[k] for k in rng.integers(0, len(members), len(members))])])
                for _ in range(draws)
            ]
            estimates[reversal] = _least(costs), float(np.std(drawn))
    if not estimates:
        return None
    values, errors = np.array(list(estimates.values())).T
    apart = float(np.ptp(values)) / 2.0
    error = math.hypot(apart, float(np.sqrt(np.sum(errors**2))) / len(errors))
    return InertiaFit(log.name, float(values.mean()), error, estimates.get(False), estimates.get(True), tuple(found))


def transients(log: DriveLog, law: SetPointLaw, chassis: Chassis, rho: float) -> list[Transient]:
    """Return the speed-ups and reversals of a log."""
    assert log.currents is not None
    assert log.commands is not None
    standing = np.abs(log.rates).sum(axis=0) < 1e-6
    offset = float(np.median(log.currents[:, standing])) if standing.any() else 0.0
    found = []
    for number, (start, stop) in enumerate(held_commands(log)):
        t = log.t - log.t[start]
        before, after = (t > -_STEADY_BEFORE) & (t <= 0.0), (t > _AFTER) & (np.arange(len(t)) < stop)
        inside = (t >= -_BEFORE) & (t <= _AFTER)
        if before.sum() < 8 or after.sum() < 8 or np.ptp(log.rates[:, before], axis=1).max() > _STEADY:
            continue
        fine = np.linspace(t[inside][0], t[inside][-1], round((t[inside][-1] - t[inside][0]) / _FINE) + 1)
        rates = _rates_at(fine, log.commands[:, max(start - 1, 0)], log.commands[:, start], law, chassis)
        for side, current in enumerate(log.currents):
            first, final = float(log.rates[side, before].mean()), float(np.median(log.rates[side, after]))
            reversal, change = first * final < 0.0, abs(final - first)
            other = abs(rates[side, 0] - first) > _STEADY or abs(rates[side, -1] - final) > _STEADY
            if other or change < _LEAST_CHANGE or not (reversal or abs(final) > abs(first)):
                continue
            losses = [max(float(np.median(current[k])) - offset, 0.0) for k in (before, after)]
            done = np.clip((rates[side] - first) / (final - first), 0.0, 1.0)
            share = np.where(rates[side] * final < 0.0, 0.0, 1.0) if reversal else done
            loss = (losses[0] + share * (losses[1] - losses[0])) * np.sign(rates[side])
            slope = np.gradient(rates[side], fine)
            read = [bridge_reading(loss + x * slope, rates[side], rho, 0.0) for x in INERTIA_GRID]
            predicted: FloatArray = np.trapezoid(np.array(read) + offset, fine, axis=1)
            measured = float(np.trapezoid(current[inside], t[inside]))
            found.append(Transient(number, reversal, change, measured, predicted))
    return found


def _rates_at(t: FloatArray, before: FloatArray, command: FloatArray, law: SetPointLaw, chassis: Chassis) -> FloatArray:
    """Return (2, n) wheel rates at times after a command [rad/s], which follows another one that was held for long."""
    lead = 10.0
    grid = np.arange(-lead, float(t[-1]) + 2.0 * _FINE, _FINE)
    commands = np.where(grid[:, None] < 0.0, before, command)
    rates = rim_speeds(commands, _FINE, law, chassis.speed_limit) / chassis.command_radius
    return np.stack([np.interp(t, grid + _FINE, column) for column in rates.T])


def _costs(some: Sequence[Transient]) -> FloatArray:
    """Return (len(INERTIA_GRID), n) how badly each J / K explains each transient; outliers count less than their square."""
    off = np.stack([x.predicted - x.measured for x in some], axis=1) / _OUTLIER
    return np.sqrt(1.0 + off**2) - 1.0


def _least(costs: FloatArray) -> float:
    """Return the J / K whose costs add up to least: the lowest point of the parabola through the least three."""
    total = costs.sum(axis=1)
    k = int(np.clip(np.argmin(total), 1, len(INERTIA_GRID) - 2))
    low, middle, high = total[k - 1 : k + 2]
    curvature = low - 2.0 * middle + high
    shift = 0.5 * (low - high) / curvature if curvature > 0.0 else 0.0
    return float(INERTIA_GRID[k] + np.clip(shift, -1.0, 1.0) * (INERTIA_GRID[1] - INERTIA_GRID[0]))
