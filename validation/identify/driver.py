"""What a robot's driver makes of commands, and the inertia of what turns with its wheels.

The driver is that of the plants (`ssmr.robot.drive`), which a gain and a limit that both sides
share are added to. It makes set points, or the measured rates, of held commands. Its numbers, as
`FitNumbers`: `dead_time` from a command to its effect [s], `gain` of rim speed over commanded speed
when driving straight [1], `half_track`, the difference of a side's rim speed from the middle's over
the commanded yaw rate [m], `yaw_rate_limit` [rad/s], `acceleration` [m/s^2], `yaw_acceleration`
[rad/s^2], and `lag`, the time constant with which the rims follow [s].

Inertia: in the air the current of a side is I = c sgn(w) + (J / K) dw/dt, so that speeding up from
w_0 to w_1 takes the charge (J / K) (w_1 - w_0) above that of the losses c, whatever the current
does meanwhile: a sensor that is read a few times a second has the integral right on average.
Braking needs besides the rule of what is read. Transients that reverse a side have an estimate of
their own, and how far it lies from that of the others counts as uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from ssmr.robot.drive import wheel_references
from ssmr.robot.drivetrain import bridge_reading
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State
from validation.files.signals import refreshed
from validation.identify.blocks import Estimate, FitNumbers, fit_in_blocks, values_of
from validation.identify.motor_logs import DriveLog, require_currents
from validation.output import Document
from validation.plants.kind import PlantProfile

LEAST_COMMANDS = 8
"""Fewest held commands that seven numbers are fitted to."""
_HELD = 5.0
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
_GRID = 0.01  # period on which the driver is computed [s]
_LARGE = 10.0  # size of an error that counts less than its square [rad/s]: none
# the charge of a transient is taken from so long before its command to so long after it [s]
_BEFORE = 0.1
_AFTER = 1.8
# period of predicted currents [s]; charges further off count less than their square [A s]
_FINE = 0.005
_OUTLIER = 0.6
_LEAST_TRANSIENTS = 5  # fewest that tell an inertia


def driven_rates(commands: FloatArray, dt: float, law: FitNumbers, own: Drive) -> FloatArray:
    """Return (2, n) wheel rates [rad/s] that a driver asks for at the end of each period.

    The dead time is left out. No rim is faster than `v_max`: where one would be, both
    sides are slowed by the same share.

    Args:
        commands: (n, 2) speeds [m/s] and yaw rates [rad/s], each held for `dt` [s]; before them
            all stands.
        dt: see above.
        law: numbers of the driver.
        own: the robot's driver, whose command radius and greatest speed count.
    """
    drive = Drive(
        v_max=math.inf,
        w_max=law["yaw_rate_limit"],
        delay_v=0.0,
        delay_w=0.0,
        hold=dt,
        command_half_track=law["half_track"] / law["gain"],
        command_radius=own.command_radius / law["gain"],
        acceleration_v=law["acceleration"],
        acceleration_w=law["yaw_acceleration"],
    )
    wanted = wheel_references(Commands(dt, commands), drive, dt, State()).T
    fastest = own.command_radius * np.abs(wanted).max(axis=0)
    stays = math.exp(-dt / law["lag"])
    limited = wanted / np.maximum(fastest / own.v_max, 1.0)
    return lfilter([1.0 - stays], [1.0, -stays], limited)


# ---------------------------------------------------------------------- commands of a log


def held_commands(log: DriveLog) -> list[slice]:
    """Return the samples of each command but zero that was held long enough and at once obeyed."""
    if not log.commands.size:
        return []
    new = np.any(np.diff(log.commands, axis=1) != 0.0, axis=0)
    held = []
    for first, stop in pairwise([0, *(np.flatnonzero(new) + 1).tolist(), len(log.t)]):
        t = log.t[first:stop] - log.t[first]
        if not log.commands[:, first].any() or t[-1] < _HELD or np.diff(t).max() > _RESPONSE_S:
            continue
        moved = np.any(np.diff(log.rates[:, first:stop], axis=1) != 0.0, axis=0)
        if moved[t[1:] < _RESPONSE_S].any():
            held.append(slice(first, first + np.searchsorted(t, _USED)))
    return held


def rate_evidence(log: DriveLog) -> Document:
    """Return what a log says on whether its wheel rates were measured, as a row of a table.

    Set points never change under a command that is held (`scatter_rad_s`, the median standard
    deviation of a settled rate [rad/s]; NaN without such a command) or only come in steps
    (`step_rad_s`).
    """
    held = held_commands(log)
    late = [log.rates[:, span][:, log.t[span] > log.t[span.start] + _LATE] for span in held]
    scatter = np.median([rates.std(axis=1) for rates in late]) if late else math.nan
    step = _rate_step(log.rates)
    return {
        "log": log.name,
        "commands": len(held),
        "scatter_rad_s": scatter,
        "step_rad_s": step,
        "wheel_rates_are": "measured"
        if step is None and not scatter < _NO_SCATTER
        else "set points",
    }


def _rate_step(rates: FloatArray) -> float | None:
    """Return the step of which all (2, M) rates are multiples; None if it is not worth mention."""
    sizes = np.unique(np.abs(rates).round(4))
    apart = np.diff(sizes)
    apart = apart[apart > 0.5 * _FINEST_STEP]
    if len(apart) < 2:
        return None
    step = np.median(apart[apart < 1.5 * apart.min()])
    for _ in range(3):  # sharper with every whole number of steps
        whole = np.round(sizes / step)
        step = (sizes @ whole) / (whole @ whole)
    off = np.abs(sizes / step - np.round(sizes / step))
    return step if step > _FINEST_STEP and np.mean(off < _OFF_STEP) > 0.99 else None


def _message_ages(log: DriveLog) -> FloatArray:
    """Return (M,) how old the rates of each sample are [s]; zeros where every row is new.

    A robot that sends rates, currents and voltages in one message repeats all of them in its log
    until the next message. A change of a current or voltage then tells that the rates are new too,
    which the rates themselves need not tell.
    """
    values = [pair for pair in (log.rates, log.currents, log.voltages) if pair.size]
    new = refreshed(log.t, np.concatenate(values).T)
    sent = log.t[new]
    row, period = (np.median(np.diff(t)) for t in (log.t, sent))
    if len(values) == 1 or period < 1.5 * row:
        return np.zeros(len(log.t))
    # a message came, on average, half a row before the first row that shows it
    return log.t - sent[np.cumsum(new) - 1] + 0.5 * row


# ---------------------------------------------------------------------- driver


class CommandLog:
    """A log with the commands that count, and how its rates are written."""

    def __init__(self, log: DriveLog, chassis: PlantProfile, least: int = 0) -> None:
        """Take a log; a ValueError says that fewer commands than `least` were held and obeyed."""
        held = held_commands(log)
        if not log.commands.size or len(held) < least:
            raise ValueError(
                f"{log.name} has {len(held)} commands (cmd_v, cmd_w) that were held for "
                f"{_HELD:g} s and obeyed; "
                f"to tell what the driver makes of them takes {least} or more"
            )
        self.log = log
        self.chassis = chassis
        self.starts = log.t[[span.start for span in held]]
        self.rows = np.concatenate([np.arange(span.start, span.stop) for span in held])
        self.commands = log.commands.T
        self.step = _rate_step(log.rates) or 1e-9  # measured rates come in steps of rounding
        self.measured = log.t - _message_ages(log)

    def rates(self, law: FitNumbers, t: FloatArray) -> FloatArray:
        """Return (2, ...) wheel rates [rad/s] that a driver makes of the commands at times [s]."""
        grid = np.arange(self.log.t[0], self.log.t[-1], _GRID)
        rows = np.searchsorted(self.log.t, grid + 0.5 * _GRID, side="right") - 1
        rates = driven_rates(self.commands[rows], _GRID, law, self.chassis.drive)
        late = t - law["dead_time"]
        return np.stack([np.interp(late, grid + _GRID, side, left=0.0) for side in rates])

    def logged(self, law: FitNumbers) -> FloatArray:
        """Return (2, M) wheel rates as they would be logged, cut to whole steps [rad/s]."""
        steps = self.rates(law, self.measured) / self.step
        return np.trunc(steps + 1e-9 * np.sign(steps)) * self.step

    def square(self, law: FitNumbers) -> float:
        """Return the mean square error under held commands [(rad/s)^2]."""
        off = self.logged(law) - self.log.rates
        return float(np.mean(off[:, self.rows] ** 2))

    def fit(self) -> Estimate:
        """Return the driver that predicts the rates under held commands best."""
        t = self.measured[self.rows]

        def residuals(x: FitNumbers) -> FloatArray:
            rates = self.rates(x, t)
            # what is cut off is half a step on average; steps themselves have no slopes
            cut = 0.5 * self.step * np.clip(rates / self.step, -1.0, 1.0)
            return (rates - cut - self.log.rates[:, self.rows]).ravel()

        fastest_turn = np.abs(self.commands[:, 1]).max()
        numbers = {
            "dead_time": (0.15, 0.0, 2.0),
            "gain": (1.0, 0.2, 5.0),
            "half_track": (self.chassis.vehicle.half_track, 0.02, 5.0),
            "yaw_rate_limit": (max(0.8 * fastest_turn, 0.1), 0.05, 50.0),
            "acceleration": (2.0, 0.05, 50.0),
            "yaw_acceleration": (2.0, 0.05, 50.0),
            "lag": (0.04, 0.001, 2.0),
        }
        command = np.searchsorted(self.starts, self.log.t[self.rows], side="right")
        return fit_in_blocks(residuals, numbers, np.tile(command, 2), _LARGE)


class DriverFit(NamedTuple):
    """The driver of a robot, as commands and wheel rates tell."""

    whole: CommandLog  # the log that it was fitted to
    found: Estimate  # numbers of the driver, from all of the log
    scores: list[Document]
    """Rows: errors on each part; on the log's own last third, where it is held out, of a driver
    fitted to the rest."""
    rms: float  # root mean square error on all that was held out [rad/s]
    shown: tuple[FloatArray, FloatArray, FloatArray]
    """The held-out part: (M,) time [s], (2, M) wheel rates as logged and as predicted [rad/s]."""


def fit_driver(
    log: DriveLog, held_out: Sequence[DriveLog], others: Sequence[DriveLog], chassis: PlantProfile
) -> DriverFit:
    """Return what a driver makes of commands, fitted to one log and judged on others.

    Logs of the same kind that are held out judge it; if there are none, a driver fitted to the
    log's first part is judged on its rest. It is tried too on `others`, of another kind.

    Raises:
        ValueError: too few commands were held and obeyed.
    """
    fitted = whole = CommandLog(log, chassis, LEAST_COMMANDS if held_out else 2 * LEAST_COMMANDS)
    found = whole.fit()
    law = values_of(found)
    judges = [CommandLog(other, chassis, 1) for other in held_out]
    if not held_out:
        fitted, *judges = (CommandLog(part, chassis, LEAST_COMMANDS // 2) for part in log.divided())
        law = values_of(fitted.fit())
    tried = [CommandLog(other, chassis) for other in others if held_commands(other)]
    scores = []
    for case in (fitted, *judges, *tried):
        score = {"log": case.log.name, "held_out": case in judges, "commands": len(case.starts)}
        scores.append({**score, "rms_rad_s": math.sqrt(case.square(law))})
    squares = [case.square(law) for case in judges]
    rms = math.sqrt(np.average(squares, weights=[len(case.starts) for case in judges]))
    first = judges[0]
    return DriverFit(whole, found, scores, rms, (first.log.t, first.log.rates, first.logged(law)))


# ---------------------------------------------------------------------- inertia


def fit_inertia(driver: DriverFit, rho: float) -> tuple[FloatArray, Document] | None:
    """Return J / K from the driver's log, wheels in the air, and what it was found from.

    The currents are taken for the motors'. How fast the wheels change speed is what the driver
    says; `rho` is the motors' resistance over voltage constant [rad/s per A].

    Returns:
        The (2,) mean of two estimates and its standard error, half their difference and theirs [A
        s^2/rad]; and the estimates, from transients `one_way` and from `reversals`, each with its
        standard error, and the number `n` of both. None where too few transients tell it.
    """
    log = driver.whole.log
    currents = require_currents(log)
    standing = np.abs(log.rates).sum(axis=0) < 1e-6
    idle = np.median(currents[:, standing]) if standing.any() else 0.0
    times = driver.whole.starts[:, None] + np.arange(-_BEFORE, _AFTER, _FINE)
    rates = driver.whole.rates(values_of(driver.found), times)
    slopes = np.gradient(rates, _FINE, axis=2)
    read = np.stack([np.interp(times, log.t, current) for current in currents])
    charge = np.trapezoid(read - idle, dx=_FINE, axis=2)
    reverses = rates[..., 0] * rates[..., -1] < 0.0
    if min(reverses.sum(), (~reverses).sum()) < _LEAST_TRANSIENTS:
        return None

    def residuals(x: FitNumbers) -> FloatArray:
        losses = np.reshape([x["left"], x["right"]], (2, 1, 1)) * np.sign(rates)
        inertia = np.where(reverses, x["reversals"], x["one_way"])[..., None]
        shown = bridge_reading(losses + inertia * slopes, rates, rho, 0.0)
        return (np.trapezoid(shown, dx=_FINE, axis=2) - charge).ravel()

    inertia = (0.2, 0.0, 1.2)
    loss = (0.3, 0.0, 5.0)
    numbers = {"one_way": inertia, "reversals": inertia, "left": loss, "right": loss}
    found = fit_in_blocks(residuals, numbers, np.tile(np.arange(len(times)), 2), _OUTLIER)
    one = found["one_way"]
    other = found["reversals"]
    error = 0.5 * math.hypot(one[0] - other[0], one[1], other[1])
    estimates = {"one_way": tuple(one), "reversals": tuple(other), "n": reverses.size}
    return np.array([0.5 * (one[0] + other[0]), error]), estimates
