"""Fits of a drive train to logs: the driver, and the inertia of what turns.

The driver makes set points, or the measured rates, of held commands (`ssmr.robot.drivetrain.rim_speeds`).

Inertia: in the air the current of a side is I = c sgn(w) + (J / K) dw/dt, so that speeding up from w_0 to w_1 takes the
charge (J / K) (w_1 - w_0) above that of the losses c, whatever the current does meanwhile: a sensor that is read a few times
a second has the integral right on average. Reversals, which are half a braking, need besides the rule of what is read. The
two kinds are estimated apart, and how far apart they lie counts as uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from ssmr.robot.drivetrain import SetPointLaw, bridge_reading, rim_speeds
from ssmr.types import FloatArray, IndexArray
from validation.identify.motor_logs import Chassis, DriveLog, require_currents
from validation.study.drivetrain_logs import HELD, held_commands, message_ages, rate_evidence

LEAST_COMMANDS = 8
"""Fewest held commands that seven numbers are fitted to."""
_GRID = 0.01  # period on which the driver is computed [s]
_EVALUATIONS, _AGAIN = (
    800,
    250,
)  # of the first search for a driver, and of each search on resampled commands
# First steps of a search: shares of the driver's numbers, and least steps in their units.
_SIMPLEX_SHARE = np.array([0.15, 0.02, 0.02, 0.05, 0.2, 0.2, 0.15])
_SIMPLEX_LEAST = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.03])
_SHOWN = 45.0  # length of the stretch in the picture [s]
_BEFORE, _AFTER = (
    0.1,
    1.8,
)  # the charge of a transient is taken from so long before its command to so long after it [s]
_STEADY_BEFORE, _STEADY = (
    0.8,
    0.2,
)  # rates have to be steady for so long before a command [s], within so much [rad/s]
_LEAST_CHANGE, _LEAST_TRANSIENTS = (
    0.3,
    5,
)  # rates that change by less tell nothing [rad/s]; fewest transients
_FINE, _OUTLIER = (
    0.005,
    0.6,
)  # period of predicted currents [s]; charges further off count less than their square [A s]
_INERTIAS = np.linspace(0.0, 1.2, 49)  # values of J / K that are tried [A s^2/rad]


# -------------------------------------------------------------------------------------------------------- driver


class _CommandLog(NamedTuple):
    """A log with the commands that count, and how its rates are written."""

    log: DriveLog  # the log
    held: list[tuple[int, int]]  # first sample of each held command, and the one behind its last
    step: float | None  # step to which rates are cut [rad/s]; None for measured ones
    commands: FloatArray  # (n, 2) commands, every `_GRID` seconds from the first sample on
    seen: IndexArray  # (M,) number of the period at whose end the rates of a sample were taken

    def predicted(self, law: SetPointLaw, chassis: Chassis) -> FloatArray:
        """Return (2, M) wheel rates that a driver makes of the commands [rad/s]."""
        rates = (
            rim_speeds(self.commands, _GRID, law, chassis.speed_limit)[self.seen].T
            / chassis.command_radius
        )
        if self.step is not None:
            rates = np.trunc(rates / self.step + 1e-9 * np.sign(rates)) * self.step
        return rates

    def errors(self, law: SetPointLaw, chassis: Chassis) -> FloatArray:
        """Return (n,) mean square errors of the wheel rates, one for each held command [(rad/s)^2]."""
        off = (self.predicted(law, chassis) - self.log.rates) ** 2
        return np.array([off[:, start:stop].mean() for start, stop in self.held])


def _command_log(log: DriveLog, least: int = 0) -> _CommandLog:
    """Return a log with the commands that are held; a ValueError says that they are fewer than `least`."""
    held = held_commands(log)
    if log.commands is None or len(held) < least:
        raise ValueError(
            f"{log.name} has {len(held)} commands (cmd_v, cmd_w) that were held for {HELD:g} s and obeyed; "
            f"to tell what the driver makes of them takes {least} or more"
        )
    grid = np.arange(log.t[0], log.t[-1], _GRID)
    commands = log.commands[:, np.searchsorted(log.t, grid, side="right") - 1].T
    seen = np.searchsorted(grid + _GRID, log.t - message_ages(log), side="right") - 1
    commands = np.ascontiguousarray(commands)
    return _CommandLog(
        log, held, rate_evidence(log).step_rad_s, commands, np.clip(seen, 0, len(grid) - 1)
    )


def _fit_law(
    case: _CommandLog,
    chassis: Chassis,
    weights: FloatArray | None = None,
    start: SetPointLaw | None = None,
) -> SetPointLaw:
    """Return the driver that predicts best, in the mean square over held commands; each counts once without weights."""
    begin = np.array(_settled(case, chassis) if start is None else start)
    simplex = np.vstack(
        [begin, begin + np.diag(np.maximum(_SIMPLEX_SHARE * begin, _SIMPLEX_LEAST))]
    )
    many = np.ones(len(case.held)) if weights is None else weights

    def cost(x: FloatArray) -> float:
        return math.sqrt(
            float(np.average(case.errors(SetPointLaw(*np.abs(x)), chassis), weights=many))
        )

    most = _EVALUATIONS if start is None else _AGAIN
    options = {"maxfev": most, "initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-6}
    return SetPointLaw(
        *np.abs(minimize(cost, begin, method="Nelder-Mead", options=options).x).tolist()
    )


def _settled(case: _CommandLog, chassis: Chassis) -> SetPointLaw:
    """Return a driver with gain, half-track and saturation from the ends of the held commands, and usual times."""
    assert case.log.commands is not None
    ends = [stop - 1 for _, stop in case.held]
    (v, w), (left, right) = (
        case.log.commands[:, ends],
        chassis.command_radius * case.log.rates[:, ends],
    )
    free = np.maximum(np.abs(left), np.abs(right)) < 0.98 * chassis.speed_limit
    middle, turning = 0.5 * (left + right), 0.5 * (right - left)
    gain = float((v * middle)[free].sum() / max((v[free] ** 2).sum(), 1e-9))
    slow = free & (np.abs(w) <= np.median(np.abs(w)))
    half_track = max(float((w * turning)[slow].sum() / max((w[slow] ** 2).sum(), 1e-9)), 0.05)
    return SetPointLaw(
        0.15, gain, half_track, float(np.abs(turning).max()) / half_track, 2.0, 2.0, 0.04
    )


class DriverFit(NamedTuple):
    """The driver of a robot, as commands and wheel rates tell."""

    log: str  # name of the log that it was fitted to
    law: SetPointLaw  # driver fitted to all of the log
    errors: SetPointLaw  # standard errors of its numbers, from resampled commands
    limit_reached: bool  # whether some command asked for more than the greatest yaw rate, which is unknown if not
    scores: list[dict[str, Any]]
    """Rows: errors on each part; on the log's own last third, where it is held out, of a driver fitted to the rest."""
    rms: float  # root mean square error on all that was held out [rad/s]
    shown: tuple[FloatArray, FloatArray, FloatArray]
    """A stretch that was held out: (M,) time [s], (2, M) wheel rates as logged and as predicted [rad/s]."""


def fit_driver(
    log: DriveLog,
    held_out: Sequence[DriveLog],
    others: Sequence[DriveLog],
    chassis: Chassis,
    seed: int,
    resamples: int,
) -> DriverFit:
    """Return what a driver makes of commands, fitted to one log and judged on others.

    Logs of the same kind that are held out judge it; if there are none, a driver fitted to the log's first part is judged on
    its rest. It is tried too on `others`, of another kind. The bootstrap draws commands `resamples` times.

    Raises:
        ValueError: too few commands were held and obeyed.
    """
    whole = _command_log(log, LEAST_COMMANDS if held_out else 2 * LEAST_COMMANDS)
    law = _fit_law(whole, chassis)
    if held_out:
        judged, cases = (
            law,
            [(log.name, False, whole), *((x.name, True, _command_log(x, 1)) for x in held_out)],
        )
    else:
        first, last = (
            _command_log(part, LEAST_COMMANDS // 2)._replace(step=whole.step)
            for part in log.divided()
        )
        judged = _fit_law(first, chassis)
        cases = [
            (f"{log.name}, first two thirds", False, first),
            (f"{log.name}, last third", True, last),
        ]
    case = cases[1][2]
    cases += [(x.name, False, _command_log(x)) for x in others if held_commands(x)]
    scores, square, count = list[dict[str, Any]](), 0.0, 0
    for name, out, some in cases:
        rms = math.sqrt(some.errors(judged, chassis).mean())
        scores.append({"log": name, "held_out": out, "commands": len(some.held), "rms_rad_s": rms})
        if out:
            square, count = square + len(some.held) * rms**2, count + len(some.held)
    rng, n, drawn = np.random.default_rng([seed, 1]), len(whole.held), []
    for _ in range(resamples):
        weights = np.bincount(rng.integers(0, n, n), minlength=n).astype(np.float64)
        drawn.append(_fit_law(whole, chassis, weights, law))
    t, begin = case.log.t, case.held[0][0]
    stretch = slice(max(begin - 20, 0), int(np.searchsorted(t, t[begin] + _SHOWN)))
    shown = t[stretch], case.log.rates[:, stretch], case.predicted(judged, chassis)[:, stretch]
    reached = float(np.abs(whole.commands[:, 1]).max()) > 1.01 * law.yaw_rate_limit
    errors = SetPointLaw(*np.std(drawn, axis=0).tolist())
    return DriverFit(log.name, law, errors, reached, scores, math.sqrt(square / count), shown)


# ------------------------------------------------------------------------------------------------------- inertia


class _Transient(NamedTuple):
    """One side's change of speed after one command."""

    command: int  # number of the command
    way: str  # `reversals` if the wheels change their direction, `speed_ups` if they only speed up
    off: FloatArray  # charge predicted for each J / K tried, with that of the losses, less the charge that passed [A s]


class InertiaFit(NamedTuple):
    """J / K, and what it was found from."""

    value: float  # mean of the two estimates [A s^2/rad]
    standard_error: (
        float  # half the difference of the two, and their resampled errors, together [A s^2/rad]
    )
    estimates: Mapping[str, tuple[float, float]]
    """Estimate and its standard error from `speed_ups` of one sign and from `reversals`, where these are enough."""
    n: int  # number of transients


def fit_inertia(
    log: DriveLog, law: SetPointLaw, chassis: Chassis, rho: float, seed: int, resamples: int
) -> InertiaFit | None:
    """Return J / K from a log whose wheels are in the air; None where too few transients are fit for it.

    The currents are taken for the motors'. How fast the wheels change speed is what the driver `law` says; `rho` is the
    motors' resistance over voltage constant [rad/s per A].
    """
    rng, transients = np.random.default_rng([seed, 3]), _transients(log, law, chassis, rho)
    estimates: dict[str, tuple[float, float]] = {}
    for name in ("speed_ups", "reversals"):
        some = [x for x in transients if x.way == name]
        if len(some) >= _LEAST_TRANSIENTS:
            off = np.stack([x.off for x in some], axis=1) / _OUTLIER
            commands, costs = np.array([x.command for x in some]), np.sqrt(1.0 + off**2) - 1.0
            members = [np.flatnonzero(commands == c) for c in np.unique(commands)]
            draws = [
                [members[k] for k in rng.integers(0, len(members), len(members))]
                for _ in range(resamples)
            ]
            error = float(np.std([_least(costs[:, np.concatenate(draw)]) for draw in draws]))
            estimates[name] = _least(costs), error
    if not estimates:
        return None
    values, errors = np.array(list(estimates.values())).T
    error = math.hypot(float(np.ptp(values)) / 2.0, float(np.sqrt(np.sum(errors**2))) / len(errors))
    return InertiaFit(float(values.mean()), error, estimates, len(transients))


def _transients(log: DriveLog, law: SetPointLaw, chassis: Chassis, rho: float) -> list[_Transient]:
    """Return the speed-ups and reversals of a log with commands and currents."""
    currents = require_currents(log)
    assert log.commands is not None
    standing = np.abs(log.rates).sum(axis=0) < 1e-6
    offset = float(np.median(currents[:, standing])) if standing.any() else 0.0
    transients = []
    for number, (start, stop) in enumerate(held_commands(log)):
        t = log.t - log.t[start]
        before, after = (
            (t > -_STEADY_BEFORE) & (t <= 0.0),
            (t > _AFTER) & (np.arange(len(t)) < stop),
        )
        inside = (t >= -_BEFORE) & (t <= _AFTER)
        if (
            before.sum() < 8
            or after.sum() < 8
            or np.ptp(log.rates[:, before], axis=1).max() > _STEADY
        ):
            continue
        fine = np.linspace(
            t[inside][0], t[inside][-1], round((t[inside][-1] - t[inside][0]) / _FINE) + 1
        )
        grid = np.arange(
            -10.0, float(fine[-1]) + 2.0 * _FINE, _FINE
        )  # the last command was held for long before
        commands = np.where(
            grid[:, None] < 0.0, log.commands[:, max(start - 1, 0)], log.commands[:, start]
        )
        rims = rim_speeds(commands, _FINE, law, chassis.speed_limit) / chassis.command_radius
        rates = np.stack([np.interp(fine, grid + _FINE, column) for column in rims.T])
        for side, current in enumerate(currents):
            first, final = (
                float(log.rates[side, before].mean()),
                float(np.median(log.rates[side, after])),
            )
            reversal, change = first * final < 0.0, abs(final - first)
            other = abs(rates[side, 0] - first) > _STEADY or abs(rates[side, -1] - final) > _STEADY
            if other or change < _LEAST_CHANGE or not (reversal or abs(final) > abs(first)):
                continue
            losses = [max(float(np.median(current[k])) - offset, 0.0) for k in (before, after)]
            done = np.clip((rates[side] - first) / (final - first), 0.0, 1.0)
            share = np.where(rates[side] * final < 0.0, 0.0, 1.0) if reversal else done
            loss = (losses[0] + share * (losses[1] - losses[0])) * np.sign(rates[side])
            slope = np.gradient(rates[side], fine)
            read = [bridge_reading(loss + x * slope, rates[side], rho, 0.0) for x in _INERTIAS]
            predicted: FloatArray = np.trapezoid(np.array(read) + offset, fine, axis=1)
            passed = float(np.trapezoid(current[inside], t[inside]))
            transients.append(
                _Transient(number, "reversals" if reversal else "speed_ups", predicted - passed)
            )
    return transients


def _least(costs: FloatArray) -> float:
    """Return the J / K whose costs add up to least: the lowest point of the parabola through the least three."""
    total = costs.sum(axis=1)
    k = int(np.clip(np.argmin(total), 1, len(_INERTIAS) - 2))
    low, middle, high = total[k - 1 : k + 2]
    curvature = low - 2.0 * middle + high
    shift = 0.5 * (low - high) / curvature if curvature > 0.0 else 0.0
    return float(_INERTIAS[k] + np.clip(shift, -1.0, 1.0) * (_INERTIAS[1] - _INERTIAS[0]))
