"""Fits of a drive train to logs: the driver, friction and losses, and the inertia of what turns.

The driver makes set points, or the measured rates, of held commands (`ssmr.robot.drivetrain.rim_speeds`).

Friction: where the wheels turn steadily the robot does not accelerate, and so its motion and the share of the friction that
each side overcomes follow from the wheel rates alone. The torque of a side over the torque constant is

    I = A F + loss sgn(w),    A = mu N r / K,

with F the side's force over its friction limit. What a log shows of I depends on where the current is measured; power, which
a battery's current measures, knows no torque constant, and then the same numbers are torques.

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
from scipy.optimize import least_squares, minimize

from ssmr.robot.drivetrain import (
    SetPointLaw,
    SkidGeometry,
    battery_current,
    bridge_reading,
    quasi_static_twist,
    rim_speeds,
    side_forces,
)
from ssmr.types import FloatArray, IndexArray
from validation.study.drivetrain_logs import (
    HELD,
    Chassis,
    CurrentSamples,
    DriveLog,
    Sensor,
    current_samples,
    held_commands,
    message_ages,
    rate_evidence,
    require_currents,
    sampled_in_windows,
    sensor_of,
    window_samples,
)

LEAST_COMMANDS = 8
"""Fewest held commands that seven numbers are fitted to."""
COULOMB_SCALE = 1e-4
"""Slip scale of a contact that is a Coulomb one as far as any current shows [1]."""
_LEAST_SAMPLES = 10  # currents that a rule is fitted to, or judged by
_GRID = 0.01  # period on which the driver is computed [s]
_EVALUATIONS, _AGAIN = 800, 250  # of the first search for a driver, and of each search on resampled commands
# First steps of a search: shares of the driver's numbers, and least steps in their units.
_SIMPLEX_SHARE = np.array([0.15, 0.02, 0.02, 0.05, 0.2, 0.2, 0.15])
_SIMPLEX_LEAST = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.03])
_SHOWN = 45.0  # length of the stretch in the picture [s]
_ROBUST = 0.3  # residuals beyond this share of the currents' standard deviation count less than their square
_BEFORE, _AFTER = 0.1, 1.8  # the charge of a transient is taken from so long before its command to so long after it [s]
_STEADY_BEFORE, _STEADY = 0.8, 0.2  # rates have to be steady for so long before a command [s], within so much [rad/s]
_LEAST_CHANGE, _LEAST_TRANSIENTS = 0.3, 5  # rates that change by less tell nothing [rad/s]; fewest transients
_FINE, _OUTLIER = 0.005, 0.6  # period of predicted currents [s]; charges further off count less than their square [A s]
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
        rates = rim_speeds(self.commands, _GRID, law, chassis.speed_limit)[self.seen].T / chassis.command_radius
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
    return _CommandLog(log, held, rate_evidence(log).step_rad_s, commands, np.clip(seen, 0, len(grid) - 1))


def _fit_law(
    case: _CommandLog, chassis: Chassis, weights: FloatArray | None = None, start: SetPointLaw | None = None
) -> SetPointLaw:
    """Return the driver that predicts best, in the mean square over held commands; each counts once without weights."""
    begin = np.array(_settled(case, chassis) if start is None else start)
    simplex = np.vstack([begin, begin + np.diag(np.maximum(_SIMPLEX_SHARE * begin, _SIMPLEX_LEAST))])
    many = np.ones(len(case.held)) if weights is None else weights

    def cost(x: FloatArray) -> float:
        return math.sqrt(float(np.average(case.errors(SetPointLaw(*np.abs(x)), chassis), weights=many)))

    most = _EVALUATIONS if start is None else _AGAIN
    options = {"maxfev": most, "initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-6}
    return SetPointLaw(*np.abs(minimize(cost, begin, method="Nelder-Mead", options=options).x).tolist())


def _settled(case: _CommandLog, chassis: Chassis) -> SetPointLaw:
    """Return a driver with gain, half-track and saturation from the ends of the held commands, and usual times."""
    assert case.log.commands is not None
    ends = [stop - 1 for _, stop in case.held]
    (v, w), (left, right) = case.log.commands[:, ends], chassis.command_radius * case.log.rates[:, ends]
    free = np.maximum(np.abs(left), np.abs(right)) < 0.98 * chassis.speed_limit
    middle, turning = 0.5 * (left + right), 0.5 * (right - left)
    gain = float((v * middle)[free].sum() / max((v[free] ** 2).sum(), 1e-9))
    slow = free & (np.abs(w) <= np.median(np.abs(w)))
    half_track = max(float((w * turning)[slow].sum() / max((w[slow] ** 2).sum(), 1e-9)), 0.05)
    return SetPointLaw(0.15, gain, half_track, float(np.abs(turning).max()) / half_track, 2.0, 2.0, 0.04)


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
    log: DriveLog, held_out: Sequence[DriveLog], others: Sequence[DriveLog], chassis: Chassis, seed: int, resamples: int
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
        judged, cases = law, [(log.name, False, whole), *((x.name, True, _command_log(x, 1)) for x in held_out)]
    else:
        first, last = (_command_log(part, LEAST_COMMANDS // 2)._replace(step=whole.step) for part in log.divided())
        judged = _fit_law(first, chassis)
        cases = [(f"{log.name}, first two thirds", False, first), (f"{log.name}, last third", True, last)]
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


# ------------------------------------------------------------------------------------------------------ friction


class _ReadingRule(NamedTuple):
    """An assumption about the tyres, and about what a log shows of the motors' currents."""

    name: str  # name in tables
    kind: str  # whose current it is: `motor` or `battery`
    numbers: Mapping[str, tuple[float, float, float]]
    """Start, least and greatest value of what is fitted, by name; those of `_SIDES` in units of the currents' scale."""


_SIDES = {"friction": (1.0, 0.02, 10.0), "loss_left": (0.1, -1.0, 2.0), "loss_right": (0.1, -1.0, 2.0)}
_GIVING = {**_SIDES, "slip_scale": (0.09, 0.01, 0.8)}
_READING_RULES = (
    _ReadingRule("the motors', Coulomb contacts", "motor", _SIDES),
    _ReadingRule("the motors', contacts that give way", "motor", _GIVING),
    _ReadingRule("the motors', shown while the bridge drives", "motor", {**_GIVING, "rho": (0.145, 0.03, 0.5)}),
    _ReadingRule("the battery's", "battery", {**_GIVING, "heat": (0.003, 0.0, 0.1), "efficiency": (0.9, 0.4, 1.0)}),
)
"""Every rule that a log is tried against. The third is for sensors without a sign."""


def _predicted(numbers: Mapping[str, float], s: CurrentSamples, sensor: Sensor, geometry: SkidGeometry) -> FloatArray:
    """Return (n,) readings that the numbers of a rule predict [A]."""
    scale = numbers.get("slip_scale", COULOMB_SCALE)
    rates, inverse = np.unique(s.rates.round(4), axis=1, return_inverse=True)
    forces = side_forces(rates, quasi_static_twist(rates, geometry, scale), geometry, scale)
    effort = forces[s.side, inverse.ravel()]  # force of each sample's side over its friction limit
    loss = np.where(s.side == 0, numbers["loss_left"], numbers["loss_right"])
    current: FloatArray = numbers["friction"] * effort + loss * np.sign(s.rate)
    if "rho" in numbers:
        return bridge_reading(current, s.rate, numbers["rho"], sensor.ripple, sensor.idle)
    if "heat" in numbers:
        drawn = battery_current(current, s.rate, s.voltage, numbers["heat"], numbers["efficiency"])
        return drawn if sensor.signed else np.maximum(drawn, 0.0)
    forward: FloatArray = current * np.sign(s.rate)
    return forward if sensor.signed else np.abs(forward)


def _fit_rule(
    rule: _ReadingRule,
    samples: CurrentSamples,
    sensor: Sensor,
    geometry: SkidGeometry,
    start: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Return the numbers of a rule that predict the samples best: least squares, in which outliers count less."""
    unit = float(np.percentile(np.abs(samples.current), 90))
    if rule.kind == "battery":
        unit *= float(np.median(samples.voltage) / np.percentile(np.abs(samples.rate), 75))
    scale = np.array([[unit if name in _SIDES else 1.0] for name in rule.numbers])
    typical, low, high = (np.array(list(rule.numbers.values())) * scale).T
    begin = typical if start is None else np.clip([start[name] for name in rule.numbers], low, high)

    def residuals(x: FloatArray) -> FloatArray:
        named = dict(zip(rule.numbers, x.tolist(), strict=True))
        return _predicted(named, samples, sensor, geometry) - samples.current

    solution = least_squares(
        residuals, begin, bounds=(low, high), x_scale=typical, loss="soft_l1", diff_step=1e-3, max_nfev=40,
        f_scale=_ROBUST * max(float(np.std(samples.current)), 1e-6),
    )  # fmt: skip
    return dict(zip(rule.numbers, solution.x.tolist(), strict=True))


class CurrentFit(NamedTuple):
    """Numbers from currents on the ground, under the rule that explains most of what was held out."""

    log: str  # name of the log
    sensor: Sensor  # what the log shows of its sensor
    kind: str  # whose currents they are: `motor` or `battery`
    scores: list[dict[str, Any]]  # rows: share of the variance of the currents that each rule explains
    best: Mapping[str, Any]  # the row of the rule
    numbers: Mapping[str, float]  # the rule's numbers, from the whole log
    errors: Mapping[str, float]  # their standard errors, from resampled blocks
    shown: Sequence[tuple[FloatArray, FloatArray]]
    """Measured and predicted currents [A], of what was fitted and of what was held out."""


def fit_currents(log: DriveLog, held_out: Sequence[DriveLog], chassis: Chassis, seed: int, resamples: int) -> CurrentFit:
    """Return friction, losses and slip scale from the currents of a log, and the rule that these follow.

    Logs that are held out judge the rules; if there are none, rules fitted to the log's first part are judged on its rest.
    The bootstrap draws blocks `resamples` times.

    Raises:
        ValueError: a log has no currents, or too little steady driving.
    """
    whole, sensor, geometry = current_samples(log), sensor_of(log), chassis.geometry
    first, *others = (log, *held_out) if held_out else log.divided()
    fitted, judged = current_samples(first), _joined([current_samples(x) for x in others])
    rows = _joined([window_samples(x, means=False) for x in others]) if sampled_in_windows(log) else judged
    for name, samples in ((f"what is fitted of {log.name}", fitted), ("what is held out", judged)):
        if (count := len(np.unique(samples.current))) < _LEAST_SAMPLES:
            raise ValueError(f"{name} has {count} different currents in steady driving, wanted {_LEAST_SAMPLES} or more")
    scores, best, rule, numbers = list[dict[str, Any]](), dict[str, Any](), _READING_RULES[0], dict[str, float]()
    for candidate in _READING_RULES:
        if sensor.signed and "rho" in candidate.numbers:
            continue
        own = _fit_rule(candidate, fitted, sensor, geometry)
        row: dict[str, Any] = {"rule": candidate.name, "kind": candidate.kind}
        for part, some in (("fitted", fitted), ("held_out", judged), ("samples", rows)):
            off = _predicted(own, some, sensor, geometry) - some.current
            row[part] = float(1.0 - np.mean(off**2) / np.var(some.current))  # R^2
        scores.append(row)
        if not best or row["held_out"] > best["held_out"]:
            best, rule, numbers = row, candidate, own
    shown = [(s.current, _predicted(numbers, s, sensor, geometry)) for s in (fitted, judged)]
    final = numbers if held_out else _fit_rule(rule, whole, sensor, geometry, numbers)
    rng = np.random.default_rng([seed, 2])
    drawn = [_fit_rule(rule, whole.resampled(rng), sensor, geometry, final) for _ in range(resamples)]
    errors = {name: float(np.std([d[name] for d in drawn])) for name in final}
    return CurrentFit(log.name, sensor, rule.kind, scores, best, final, errors, shown)


def _joined(parts: Sequence[CurrentSamples]) -> CurrentSamples:
    columns: list[Any] = [np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)]
    return CurrentSamples(*columns)


# ------------------------------------------------------------------------------------------------------- inertia


class _Transient(NamedTuple):
    """One side's change of speed after one command."""

    command: int  # number of the command
    way: str  # `reversals` if the wheels change their direction, `speed_ups` if they only speed up
    off: FloatArray  # charge predicted for each J / K tried, with that of the losses, less the charge that passed [A s]


class InertiaFit(NamedTuple):
    """J / K, and what it was found from."""

    value: float  # mean of the two estimates [A s^2/rad]
    standard_error: float  # half the difference of the two, and their resampled errors, together [A s^2/rad]
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
            draws = [[members[k] for k in rng.integers(0, len(members), len(members))] for _ in range(resamples)]
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
        before, after = (t > -_STEADY_BEFORE) & (t <= 0.0), (t > _AFTER) & (np.arange(len(t)) < stop)
        inside = (t >= -_BEFORE) & (t <= _AFTER)
        if before.sum() < 8 or after.sum() < 8 or np.ptp(log.rates[:, before], axis=1).max() > _STEADY:
            continue
        fine = np.linspace(t[inside][0], t[inside][-1], round((t[inside][-1] - t[inside][0]) / _FINE) + 1)
        grid = np.arange(-10.0, float(fine[-1]) + 2.0 * _FINE, _FINE)  # the last command was held for long before
        commands = np.where(grid[:, None] < 0.0, log.commands[:, max(start - 1, 0)], log.commands[:, start])
        rims = rim_speeds(commands, _FINE, law, chassis.speed_limit) / chassis.command_radius
        rates = np.stack([np.interp(fine, grid + _FINE, column) for column in rims.T])
        for side, current in enumerate(currents):
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
            read = [bridge_reading(loss + x * slope, rates[side], rho, 0.0) for x in _INERTIAS]
            predicted: FloatArray = np.trapezoid(np.array(read) + offset, fine, axis=1)
            passed = float(np.trapezoid(current[inside], t[inside]))
            transients.append(_Transient(number, "reversals" if reversal else "speed_ups", predicted - passed))
    return transients


def _least(costs: FloatArray) -> float:
    """Return the J / K whose costs add up to least: the lowest point of the parabola through the least three."""
    total = costs.sum(axis=1)
    k = int(np.clip(np.argmin(total), 1, len(_INERTIAS) - 2))
    low, middle, high = total[k - 1 : k + 2]
    curvature = low - 2.0 * middle + high
    shift = 0.5 * (low - high) / curvature if curvature > 0.0 else 0.0
    return float(_INERTIAS[k] + np.clip(shift, -1.0, 1.0) * (_INERTIAS[1] - _INERTIAS[0]))
