"""Friction, losses and torques from motor currents.

Where the wheels turn steadily the robot does not accelerate, and so its motion and the share of the
friction that each side overcomes follow from the wheel rates alone. The torque of a side over the
torque constant is

    I = A F + loss sgn(w),    A = mu N r / K,

with F the side's force over its friction limit. What a log shows of I depends on where the current
is measured; power, which a battery's current measures, knows no torque constant, and then the same
numbers are torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ssmr.robot.drivetrain import (
    battery_current,
    battery_torque,
    bridge_reading,
    side_forces,
)
from ssmr.robot.vehicle import Vehicle
from ssmr.types import FloatArray
from validation.experiment.sources import RECORDING, Source
from validation.identify.blocks import Estimate, FitNumbers, fit_in_blocks, values_of
from validation.identify.motor_logs import (
    Chassis,
    DriveLog,
    MotorSamples,
    Sensor,
    log_of_motions,
    sensor_of,
    steady_samples,
)

COULOMB_SCALE = 1e-4
"""Slip scale of a contact that is a Coulomb one as far as any current shows [1]."""
_BLOCK = 6.0  # currents within so much time hang together [s]: as long as a command usually is
_LEAST_SAMPLES = 10  # currents that a rule is fitted to, or judged by
_CLEARLY = 3.0  # a current so many ripples above an idle bridge's is one of a bridge that drives
_NO_CONSTANT = (
    "its currents are the motors', and no torque constant is known, so they tell no torques; "
    "give --torque-constant, or torque_constant in [drive] of the robot's file"
)
# residuals beyond this share of the currents' standard deviation count less than their square
_ROBUST = 0.3


_SIDES = {
    "friction": (1.0, 0.02, 10.0),
    "loss_left": (0.1, -1.0, 2.0),
    "loss_right": (0.1, -1.0, 2.0),
}
_GIVING = {**_SIDES, "slip_scale": (0.09, 0.01, 0.8)}
_Bounds = Mapping[str, tuple[float, float, float]]
_READING_RULES: Mapping[str, tuple[str, _Bounds]] = {
    "the motors', Coulomb contacts": ("motor", _SIDES),
    "the motors', contacts that give way": ("motor", _GIVING),
    "the motors', shown while the bridge drives": (
        "motor",
        {**_GIVING, "rho": (0.145, 0.03, 0.5)},
    ),
    "the battery's": (
        "battery",
        {**_GIVING, "heat": (0.003, 0.0, 0.1), "efficiency": (0.9, 0.4, 1.0)},
    ),
}
"""Every rule that a log is tried against, an assumption about the tyres and about what a log shows
of the motors' currents, by its name in tables: whose current it is, `motor` or `battery`; and the
start, least and greatest value of what is fitted, by name, those of `_SIDES` in units of the
currents' scale. The third is for sensors without a sign."""


def _side_currents(numbers: FitNumbers, rates: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return (2, n) currents [A] that a rule's numbers need for (2, n) wheel rates [rad/s]."""
    known, inverse = np.unique(rates.round(4), axis=1, return_inverse=True)
    effort = side_forces(known, vehicle, numbers.get("slip_scale", COULOMB_SCALE))
    loss = np.array([[numbers["loss_left"]], [numbers["loss_right"]]])
    return np.asarray(numbers["friction"] * effort[:, inverse.ravel()] + loss * np.sign(rates))


def _predicted(
    numbers: FitNumbers, some: MotorSamples, sensor: Sensor, vehicle: Vehicle
) -> FloatArray:
    """Return (2, n) readings that the numbers of a rule predict [A]."""
    current = _side_currents(numbers, some.rates, vehicle)
    if "rho" in numbers:
        return bridge_reading(current, some.rates, numbers["rho"], sensor.ripple, sensor.idle)
    if "heat" in numbers:
        loss = (numbers["heat"], numbers["efficiency"])
        drawn = battery_current(current, some.rates, some.voltages, *loss)
        return drawn if sensor.signed else np.maximum(drawn, 0.0)
    forward: FloatArray = current * np.sign(some.rates)
    return forward if sensor.signed else np.abs(forward)


def _fit_rule(rule: str, some: MotorSamples, sensor: Sensor, vehicle: Vehicle) -> Estimate:
    """Return the numbers of a rule that predict the samples best; outliers count less."""
    kind, bounds = _READING_RULES[rule]
    known = np.isfinite(some.currents)
    currents = some.currents[known]
    unit = float(np.percentile(np.abs(currents), 90))
    if kind == "battery":
        unit *= float(np.median(some.voltages) / np.percentile(np.abs(some.rates[known]), 75))
    numbers = dict(bounds)
    for name in _SIDES:
        start, low, high = numbers[name]
        numbers[name] = (unit * start, unit * low, unit * high)

    def residuals(x: FitNumbers) -> FloatArray:
        return _predicted(x, some, sensor, vehicle)[known] - currents

    blocks = np.broadcast_to(some.t // _BLOCK, known.shape)[known]
    size = _ROBUST * max(float(np.std(currents)), 1e-6)
    return fit_in_blocks(residuals, numbers, blocks, size)


class CurrentFit(NamedTuple):
    """Numbers from currents on the ground, by the rule that explains held-out ones best."""

    sensor: Sensor  # what the log shows of its sensor
    found: Estimate  # the rule's numbers, from the whole log
    best: Mapping[str, Any]  # the row of the rule
    # rows: share of the variance of the currents that each rule explains
    scores: list[Mapping[str, Any]]
    shown: Sequence[tuple[FloatArray, FloatArray]]
    """Measured and predicted currents [A], of what was fitted and of what was held out."""


def fit_currents(log: DriveLog, held_out: Sequence[DriveLog], chassis: Chassis) -> CurrentFit:
    """Return friction, losses and slip scale from currents, and the rule that these follow.

    Logs that are held out judge the rules; if there are none, rules fitted to the log's first part
    are judged on its rest.

    Raises:
        ValueError: a log has no currents, or too little steady driving.
    """
    sensor = sensor_of(log)
    vehicle = chassis.vehicle
    first, *others = (log, *held_out) if held_out else log.divided()
    fitted = steady_samples(first)[1]
    rows, judged = (_joined(parts) for parts in zip(*map(steady_samples, others), strict=True))
    for name, some in ((f"what is fitted of {log.name}", fitted), ("what is held out", judged)):
        count = len(np.unique(some.currents[np.isfinite(some.currents)]))
        if count < _LEAST_SAMPLES:
            raise ValueError(
                f"{name} has {count} different currents in steady driving, "
                f"wanted {_LEAST_SAMPLES} or more"
            )
    parts = {
        "fitted": fitted,
        "held_out": judged,
        "samples": rows if sensor.kind == "windows" else judged,
    }
    tried = list[tuple[FitNumbers, dict[str, Any]]]()
    for rule, (kind, bounds) in _READING_RULES.items():
        if not (sensor.signed and "rho" in bounds):
            own = values_of(_fit_rule(rule, fitted, sensor, vehicle))
            explained = {
                part: _explained(own, some, sensor, vehicle) for part, some in parts.items()
            }
            tried.append((own, {"rule": rule, "kind": kind, **explained}))
    own, best = max(tried, key=lambda one: one[1]["held_out"])
    found = _fit_rule(best["rule"], steady_samples(log)[1], sensor, vehicle)
    shown = [(some.currents, _predicted(own, some, sensor, vehicle)) for some in (fitted, judged)]
    return CurrentFit(sensor, found, best, [row for _, row in tried], shown)


def _explained(numbers: FitNumbers, some: MotorSamples, sensor: Sensor, vehicle: Vehicle) -> float:
    """Return the share of the currents' variance that the numbers of a rule explain, R^2."""
    off = _predicted(numbers, some, sensor, vehicle) - some.currents
    return float(1.0 - np.nanmean(off**2) / np.nanvar(some.currents))


def _joined(parts: Sequence[MotorSamples]) -> MotorSamples:
    return MotorSamples(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def _torques_of(
    log: DriveLog, chassis: Chassis, constant: float, own_loss: float
) -> tuple[FloatArray | None, str]:
    """Return (M, 2) torques of both motors [N m], and a sentence on where they come from.

    They are NaN where the log hides them: they are known in steady driving, where nothing
    accelerates, of sides that turn, and not where a sensor without a sign shows nothing. What such
    a sensor shows of an inner wheel may drive or brake it: the rule that explains the currents
    decides. There are none of motors' currents without a constant.

    Args:
        log: a log with currents.
        chassis: nominal numbers of the robot.
        constant: torque of a side's wheels per ampere of its motor [N m/A]; 0 where it is unknown.
        own_loss: what the losses that the currents show are replaced by [N m]: that of a side of
            the
            plant which the torques are compared with.

    Raises:
        ValueError: the log has no currents, or too little steady driving.
    """
    fit = fit_currents(log, [], chassis)
    x = values_of(fit.found)
    battery = fit.best["kind"] == "battery"
    if battery and log.voltages is None:
        raise ValueError("they are the battery's, and without its voltage power is unknown")
    if not battery and constant <= 0.0:
        return None, _NO_CONSTANT
    some = steady_samples(log)[0]
    current = some.currents
    if not fit.sensor.signed:
        shows = current > fit.sensor.idle + _CLEARLY * fit.sensor.ripple
        current = np.where(shows, current, np.nan)
    scale = 1.0 if battery else constant
    forward = np.where(log.rates < 0.0, -1.0, 1.0)
    ahead = scale * current
    if battery:
        ahead = battery_torque(
            current * some.voltages, np.abs(log.rates), x["heat"], x["efficiency"]
        )
    elif not fit.sensor.signed:
        ahead *= forward * np.sign(_side_currents(x, log.rates, chassis.vehicle))
    loss = scale * np.array([x["loss_left"], x["loss_right"]])
    torques = forward * (ahead - loss[:, None] + own_loss)
    how = "the battery's power" if battery else f"the motors' currents and {constant:g} N m/A"
    said = (
        f"torques come from {how}, less losses of {loss[0]:.3g} N m (left) and "
        f"{loss[1]:.3g} N m (right) in steady driving; a scale that is off by a share makes "
        "friction wrong by that share, which its standard error does not cover"
    )
    return np.ascontiguousarray(torques.T), said


def with_torques(source: Source, chassis: Chassis, constant: float, own_loss: float) -> Source:
    """Return a source with the torques that the currents of its log tell.

    What was found, or why nothing was, stands among its remarks. Logs without currents stay as
    they are, and so do scenarios.

    Args:
        source: a source of a fit.
        chassis: nominal numbers of the robot.
        constant: torque of a side's wheels per ampere of its motor [N m/A]; 0 where it is unknown.
        own_loss: loss of a side of the plant that is fitted, see `_torques_of`.
    """
    log = log_of_motions(source.title, source.truth)
    if source.reference != RECORDING or log is None:
        return source
    pieces = source.pieces
    try:
        torques, said = _torques_of(log, chassis, constant, own_loss)
        if torques is not None:
            ends = np.cumsum([len(motion.t) for motion in source.truth])[:-1]
            parts = zip(pieces, np.split(torques, ends), strict=True)
            pieces = tuple(replace(piece, torques=part) for piece, part in parts)
    except ValueError as error:
        said = f"its currents tell no torques, because {error}"
    remarks = (*source.remarks, f"{source.title}: {said}")
    return replace(source, pieces=pieces, remarks=remarks)
