"""What the robot's driver makes of commands: the set points, or the measured rates, that follow them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ssmr.robot.drivetrain import SetPointLaw, rim_speeds
from ssmr.types import FloatArray, IndexArray
from validation.study.drivetrain.evidence import HELD, HeldCommand, RateEvidence, held_commands, rate_evidence
from validation.study.drivetrain.logs import Chassis, DriveLog, Resampling

_GRID = 0.01
"""Period on which the driver is computed [s]."""
_TOGETHER = 0.8
"""Share of the changes of rates with which a current or voltage has to change, if one message holds all of them."""
_OLDEST = 1.4
"""A message is taken to come at the latest after so many usual periods, also where nothing changes."""
_EVALUATIONS, _AGAIN = 800, 250
"""Evaluations of the first search, and of each search on resampled commands."""


class ObeyedLog(NamedTuple):
    """A log with the commands that count, and how its rates are written."""

    log: DriveLog
    held: list[HeldCommand]
    step: float | None
    """Step to which rates are cut [rad/s]; None for measured ones."""
    commands: FloatArray
    """(n, 2) commands, every `_GRID` seconds from the first sample on."""
    seen: IndexArray
    """(M,) number of the period at whose end the rates of a sample were taken."""


def obeyed_log(log: DriveLog, evidence: RateEvidence) -> ObeyedLog:
    """Return a log with the commands that are held; the evidence says whether its rates are cut to steps."""
    assert log.commands is not None
    grid = np.arange(log.t[0], log.t[-1], _GRID)
    commands = log.commands[:, np.searchsorted(log.t, grid, side="right") - 1].T
    seen = np.searchsorted(grid + _GRID, log.t - message_ages(log), side="right") - 1
    held = held_commands(log)
    return ObeyedLog(log, held, evidence.step, np.ascontiguousarray(commands), np.clip(seen, 0, len(grid) - 1))


def message_ages(log: DriveLog) -> FloatArray:
    """Return (M,) how old the rates of each sample are [s]; zeros where the log does not tell.

    A robot that sends rates, currents and voltages in one message repeats all of them in its log until the next message. A
    change of a current or voltage then tells that the rates are new too, which the rates themselves need not tell.
    """
    others = [a for a in (log.currents, log.voltages) if a is not None]
    none = np.zeros(len(log.t))
    if not others:
        return none
    new = np.any(np.diff(np.concatenate(others), axis=1) != 0.0, axis=0)
    moved = np.any(np.diff(log.rates, axis=1) != 0.0, axis=0)
    if not moved.any() or new[moved].mean() < _TOGETHER:
        return none
    sent = np.concatenate([[True], new])
    last = log.t[np.maximum.accumulate(np.where(sent, np.arange(len(log.t)), 0))]
    row = float(np.median(np.diff(log.t)))  # a message came, on average, half a row before the first row that shows it
    return np.minimum(log.t - last, _OLDEST * float(np.median(np.diff(log.t[sent])))) + 0.5 * row


def predicted_rates(case: ObeyedLog, law: SetPointLaw, chassis: Chassis) -> FloatArray:
    """Return (2, M) wheel rates that a driver makes of a log's commands [rad/s]."""
    speeds = rim_speeds(case.commands, _GRID, law, chassis.speed_limit)
    rates = speeds[case.seen].T / chassis.command_radius
    if case.step is not None:
        rates = np.trunc(rates / case.step + 1e-9 * np.sign(rates)) * case.step
    return rates


def command_errors(case: ObeyedLog, law: SetPointLaw, chassis: Chassis) -> FloatArray:
    """Return (n,) mean square errors of the wheel rates, one for each held command [(rad/s)^2]."""
    off = (predicted_rates(case, law, chassis) - case.log.rates) ** 2
    return np.array([off[:, start:stop].mean() for start, stop in case.held])


def fit_law(
    case: ObeyedLog, chassis: Chassis, weights: FloatArray | None = None, start: SetPointLaw | None = None
) -> SetPointLaw:
    """Return the driver that predicts a log's wheel rates best, in the mean square over its held commands.

    Args:
        case: the log.
        chassis: the robot.
        weights: (n,) how often each command counts; each once if not given.
        start: where the search begins; at what the settled parts of the commands say if not given.
    """
    begin = np.array(_settled(case, chassis) if start is None else start)
    simplex = np.vstack([begin, begin + np.diag(np.maximum(_SIMPLEX_SHARE * begin, _SIMPLEX_LEAST))])
    many = np.ones(len(case.held)) if weights is None else weights

    def cost(x: FloatArray) -> float:
        return math.sqrt(float(np.average(command_errors(case, SetPointLaw(*np.abs(x)), chassis), weights=many)))

    most = _EVALUATIONS if start is None else _AGAIN
    found = minimize(
        cost, begin, method="Nelder-Mead", options={"maxfev": most, "initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-6}
    )
    return SetPointLaw(*np.abs(found.x).tolist())


_SHOWN = 45.0
"""Length of the stretch in the picture [s]."""
LEAST_COMMANDS = 8
"""Fewest held commands that seven numbers are fitted to."""
_SIMPLEX_SHARE = np.array([0.15, 0.02, 0.02, 0.05, 0.2, 0.2, 0.15])
_SIMPLEX_LEAST = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.03])
"""First steps of a search: shares of the numbers, and least steps in their units."""
_OWN_TIMES = np.arange(0.0, 0.4, 0.01)
"""Dead times that each command is tried with [s]."""


class RateScore(NamedTuple):
    """Errors of the predicted wheel rates on a part of a log."""

    name: str
    """Name of the log and of the part."""
    held_out: bool
    """True if the driver was not fitted to it."""
    commands: int
    """Number of its held commands."""
    rms: float
    """Root mean square of the errors of both sides' rates after these commands [rad/s]."""
    own_time_rms: float
    """What is left if every command has a dead time of its own [rad/s]: what only the log's timing costs is left out."""


@dataclass(frozen=True, eq=False)
class RateFit:
    """The driver of a robot, as commands and wheel rates tell."""

    log: str
    """Name of the log that it was fitted to."""
    law: SetPointLaw
    """Driver fitted to all of the log."""
    errors: SetPointLaw
    """Standard errors of its numbers, from resampled commands."""
    limit_reached: bool
    """True if some command asked for more than the greatest yaw rate; if not, that number says nothing."""
    scores: tuple[RateScore, ...]
    """Errors on each part; on the log's own last third, where it is held out, of a driver fitted to the rest."""
    shown: tuple[FloatArray, FloatArray, FloatArray]
    """A stretch that was held out: (M,) time [s], (2, M) wheel rates as logged and as predicted [rad/s]."""

    @property
    def rms(self) -> float:
        """Root mean square error on all that was held out [rad/s]."""
        held = [s for s in self.scores if s.held_out and s.commands]
        return math.sqrt(sum(s.commands * s.rms**2 for s in held) / sum(s.commands for s in held))


def score_rates(name: str, case: ObeyedLog, law: SetPointLaw, chassis: Chassis, held_out: bool) -> RateScore:
    """Return the errors of a driver on a log."""
    alone = command_errors(case, law, chassis)
    timed = [command_errors(case, law._replace(dead_time=float(x)), chassis) for x in _OWN_TIMES]
    least = np.min([alone, *timed], axis=0)
    return RateScore(name, held_out, len(alone), math.sqrt(alone.mean()), math.sqrt(least.mean()))


def law_errors(case: ObeyedLog, law: SetPointLaw, chassis: Chassis, resampling: Resampling) -> SetPointLaw:
    """Return the standard errors of a driver's numbers: their scatter over fits to resampled commands."""
    n, drawn = len(case.held), []
    for _ in range(resampling.draws):
        weights = np.bincount(resampling.rng.integers(0, n, n), minlength=n).astype(np.float64)
        drawn.append(fit_law(case, chassis, weights, law))
        resampling.tick()
    return SetPointLaw(*np.std(drawn, axis=0).tolist())


def identify_driver(
    log: DriveLog, held_out: Sequence[DriveLog], others: Sequence[DriveLog], chassis: Chassis, resampling: Resampling
) -> RateFit:
    """Return what a driver makes of commands, fitted to one log and judged on others.

    Args:
        log: the log to fit to.
        held_out: logs of the same kind; if there are none, a driver fitted to the log's first part is judged on its rest.
        others: logs of another kind, on which it is tried too.
        chassis: the robot.
        resampling: the bootstrap over commands.

    Raises:
        ValueError: too few commands were held and obeyed.
    """
    evidence = rate_evidence(log)
    whole = _with_commands(log, evidence, 2 * LEAST_COMMANDS if not held_out else LEAST_COMMANDS)
    law = fit_law(whole, chassis)
    resampling.tick()
    if held_out:
        judged = law
        fitted, parts = whole, [(x.name, _with_commands(x, rate_evidence(x), 1)) for x in held_out]
    else:
        first, last = (obeyed_log(part, evidence) for part in log.divided())
        if min(len(first.held), len(last.held)) < LEAST_COMMANDS // 2:
            raise ValueError(f"the commands of {log.name} lie too unevenly to hold a part of it out; name logs as held_out")
        judged, fitted, parts = fit_law(first, chassis), first, [(f"{log.name}, last third", last)]
    name = log.name if held_out else f"{log.name}, first two thirds"
    scores = [score_rates(name, fitted, judged, chassis, held_out=False)]
    scores += [score_rates(name, case, judged, chassis, held_out=True) for name, case in parts]
    more = [(x.name, obeyed_log(x, rate_evidence(x))) for x in others if x.commands is not None]
    scores += [score_rates(name, case, judged, chassis, held_out=False) for name, case in more if case.held]
    resampling.tick()
    errors = law_errors(whole, law, chassis, resampling)
    case = parts[0][1]
    rates = predicted_rates(case, judged, chassis)
    begin = case.held[0].start
    stretch = slice(max(begin - 20, 0), int(np.searchsorted(case.log.t, case.log.t[begin] + _SHOWN)))
    shown = case.log.t[stretch], case.log.rates[:, stretch], rates[:, stretch]
    reached = float(np.abs(whole.commands[:, 1]).max()) > 1.01 * law.yaw_rate_limit
    return RateFit(log.name, law, errors, reached, tuple(scores), shown)


def _with_commands(log: DriveLog, evidence: RateEvidence, least: int) -> ObeyedLog:
    """Return a log with its held commands.

    Raises:
        ValueError: there are fewer than `least`.
    """
    held = len(held_commands(log))
    if held < least:
        raise ValueError(
            f"{log.name} has {held} commands (cmd_v, cmd_w) that were held for {HELD:g} s and obeyed; "
            f"to tell what the driver makes of them takes {least} or more"
        )
    return obeyed_log(log, evidence)


def _settled(case: ObeyedLog, chassis: Chassis) -> SetPointLaw:
    """Return a driver with gain, half-track and saturation from the ends of the held commands, and usual times."""
    log = case.log
    assert log.commands is not None
    ends = [stop - 1 for _, stop in case.held]
    (v, w), (left, right) = log.commands[:, ends], chassis.command_radius * log.rates[:, ends]
    free = np.maximum(np.abs(left), np.abs(right)) < 0.98 * chassis.speed_limit
    middle, turning = 0.5 * (left + right), 0.5 * (right - left)
    gain = float((v * middle)[free].sum() / max((v[free] ** 2).sum(), 1e-9))
    slow = free & (np.abs(w) <= np.median(np.abs(w)))
    half_track = max(float((w * turning)[slow].sum() / max((w[slow] ** 2).sum(), 1e-9)), 0.05)
    return SetPointLaw(0.15, gain, half_track, float(np.abs(turning).max()) / half_track, 2.0, 2.0, 0.04)
