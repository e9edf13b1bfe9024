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
from typing import Literal, NamedTuple

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
    DriveLog,
    Sensor,
    log_of_motions,
    sensor_of,
    steady_samples,
)
from validation.output import Document
from validation.plants.kind import PlantProfile

COULOMB_SCALE = 1e-4
"""Slip scale of a contact that is a Coulomb one as far as any current shows [1]."""
_BLOCK = 6.0  # currents within so much time hang together [s]: as long as a command usually is
_LEAST_SAMPLES = 10  # currents that a rule is fitted to, or judged by
_CLEARLY = 3.0  # a current so many ripples above an idle bridge's is one of a bridge that drives
_NO_CONSTANT = (
    "its currents are the motors', and no torque constant is known, so they tell no torques; "
    "give --torque-constant, or torque_constant in [drive] of the robot's file"
)
_LEAST_R2 = 0.8  # share of the variance of currents that a drive train on tyres explains, at least
_SURE = 3.0  # a loss so many standard errors below 0 is negative
_SLIDING = 0.5  # share of the friction that wheels push with where they slide, at least
_SAID = {"driving": "a wheel", "axle": "one forward", "against the axle": "one backward"}
# residuals beyond this share of the currents' standard deviation count less than their square
_ROBUST = 0.3


Sign = Literal["driving", "axle", "against the axle"]
"""Where a current or a torque with a sign is positive: where it drives a wheel, whichever way that
turns; or where it drives it forward, or backward."""
_SIDES = {
    "friction": (1.0, 0.02, 10.0),
    "loss_left": (0.1, -1.0, 2.0),
    "loss_right": (0.1, -1.0, 2.0),
}
_GIVING = {**_SIDES, "slip_scale": (0.09, 0.01, 0.8)}
_Bounds = Mapping[str, tuple[float, float, float]]
_READING_RULES: Mapping[str, tuple[str, Sign, _Bounds]] = {
    "the motors', Coulomb contacts": ("motor", "driving", _SIDES),
    "the motors', contacts that give way": ("motor", "driving", _GIVING),
    "the motors', shown while the bridge drives": (
        "motor",
        "driving",
        {**_GIVING, "rho": (0.145, 0.03, 0.5)},
    ),
    "the battery's": (
        "battery",
        "driving",
        {**_GIVING, "heat": (0.003, 0.0, 0.1), "efficiency": (0.9, 0.4, 1.0)},
    ),
    "with the axle's sign, Coulomb contacts": ("motor", "axle", _SIDES),
    "with the axle's sign, contacts that give way": ("motor", "axle", _GIVING),
    "against the axle, Coulomb contacts": ("motor", "against the axle", _SIDES),
}
"""Every rule that a log is tried against, an assumption about the tyres and about what a log shows
of the motors' currents, by its name in tables: whose current it is, `motor` or `battery`; its sign;
and the start, least and greatest value of what is fitted, by name, those of `_SIDES` in units of
the currents' scale. The third is for sensors without a sign, the last ones for others."""


def _side_currents(numbers: FitNumbers, rates: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return (2, n) currents [A] that a rule's numbers need for (2, n) wheel rates [rad/s]."""
    known, inverse = np.unique(rates.round(4), axis=1, return_inverse=True)
    effort = side_forces(known, vehicle, numbers.get("slip_scale", COULOMB_SCALE))
    loss = np.array([[numbers["loss_left"]], [numbers["loss_right"]]])
    return numbers["friction"] * effort[:, inverse.ravel()] + loss * np.sign(rates)


def _is_able(rule: str, sensor: Sensor, unit: str) -> bool:
    """Return whether a log of such a sensor and unit may follow a rule."""
    kind, sign, bounds = _READING_RULES[rule]
    if unit != "A" and kind == "battery":
        return False
    return "rho" not in bounds if sensor.signed else sign == "driving"


def _predict_currents(
    rule: str, numbers: FitNumbers, some: DriveLog, sensor: Sensor, vehicle: Vehicle
) -> FloatArray:
    """Return (2, n) readings that the numbers of a rule predict [A]."""
    current = _side_currents(numbers, some.rates, vehicle)
    if "rho" in numbers:
        return bridge_reading(current, some.rates, numbers["rho"], sensor.ripple, sensor.idle)
    if "heat" in numbers:
        loss = (numbers["heat"], numbers["efficiency"])
        drawn = battery_current(current, some.rates, some.voltages, *loss)
        return drawn if sensor.signed else np.maximum(drawn, 0.0)
    if not sensor.signed:
        return np.abs(current)
    return current * _drive_direction(_READING_RULES[rule][1], some.rates)


def _drive_direction(sign: Sign, rates: FloatArray) -> FloatArray:
    """Return 1 where what a log shows drives a wheel forward if it is positive, and else -1."""
    if sign == "driving":
        return np.where(rates < 0.0, -1.0, 1.0)
    return np.full_like(rates, 1.0 if sign == "axle" else -1.0)


def _fit_rule(rule: str, some: DriveLog, sensor: Sensor, vehicle: Vehicle) -> Estimate:
    """Return the numbers of a rule that predict the samples best; outliers count less."""
    kind, _, bounds = _READING_RULES[rule]
    known = np.isfinite(some.currents)
    currents = some.currents[known]
    unit = np.percentile(np.abs(currents), 90)
    if kind == "battery":
        unit *= float(np.median(some.voltages) / np.percentile(np.abs(some.rates[known]), 75))
    numbers = dict(bounds)
    for name in _SIDES:
        start, low, high = numbers[name]
        numbers[name] = (unit * start, unit * low, unit * high)

    def residuals(x: FitNumbers) -> FloatArray:
        return _predict_currents(rule, x, some, sensor, vehicle)[known] - currents

    blocks = np.broadcast_to(some.t // _BLOCK, known.shape)[known]
    size = _ROBUST * max(float(np.std(currents)), 1e-6)
    return fit_in_blocks(residuals, numbers, blocks, size)


class CurrentFit(NamedTuple):
    """Numbers from currents on the ground, by the rule that explains held-out ones best."""

    sensor: Sensor  # what the log shows of its sensor
    found: Estimate  # the rule's numbers, from the whole log
    best: Document  # the row of the rule
    # rows: share of the variance of the currents that each rule explains
    scores: list[Document]
    shown: Sequence[tuple[FloatArray, FloatArray]]
    """Measured and predicted currents [A], of what was fitted and of what was held out."""
    sign: Sign  # that of the log


def fit_currents(log: DriveLog, held_out: Sequence[DriveLog], chassis: PlantProfile) -> CurrentFit:
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
    rows, judged = (
        _join_samples(parts) for parts in zip(*map(steady_samples, others), strict=True)
    )
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
    tried = list[tuple[FitNumbers, Document]]()
    for rule, (kind, _, _) in _READING_RULES.items():
        if _is_able(rule, sensor, log.unit):
            own = values_of(_fit_rule(rule, fitted, sensor, vehicle))
            explained = {
                part: _explained_share(rule, own, some, sensor, vehicle)
                for part, some in parts.items()
            }
            tried.append((own, {"rule": rule, "kind": kind, **explained}))
    own, best = max(tried, key=lambda one: one[1]["held_out"])
    rule = best["rule"]
    found = _fit_rule(rule, steady_samples(log)[1], sensor, vehicle)
    shown = []
    for some in (fitted, judged):
        shown.append((some.currents, _predict_currents(rule, own, some, sensor, vehicle)))
    sign = _READING_RULES[rule][1]
    return CurrentFit(sensor, found, best, [row for _, row in tried], shown, sign)


def _explained_share(
    rule: str, numbers: FitNumbers, some: DriveLog, sensor: Sensor, vehicle: Vehicle
) -> float:
    """Return the share of the currents' variance that the numbers of a rule explain, R^2."""
    off = _predict_currents(rule, numbers, some, sensor, vehicle) - some.currents
    return float(1.0 - np.nanmean(off**2) / np.nanvar(some.currents))


def _join_samples(parts: Sequence[DriveLog]) -> DriveLog:
    """Return the samples of several logs as those of one."""
    names = ("t", "rates", "currents", "voltages")
    joined: Document = {n: np.concatenate([getattr(p, n) for p in parts], axis=-1) for n in names}
    return replace(parts[0], **joined)


def _torques_of(
    log: DriveLog, chassis: PlantProfile, constant: float, own_loss: float
) -> tuple[FloatArray | None, str]:
    """Return (M, 2) torques of both motors [N m], and a sentence on where they come from.

    They are NaN where the log hides them: they are known in steady driving, where nothing
    accelerates, of sides that turn, and not where a sensor without a sign shows nothing. What such
    a sensor shows of an inner wheel may drive or brake it: the rule that explains the currents
    decides. There are none of motors' currents without a constant. Torques of a log count where
    wheels slide: straight on, a Coulomb contact gives what the last digit of a rate asks for.

    Args:
        log: a log with currents.
        chassis: nominal numbers of the robot.
        constant: torque of a side's wheels per ampere of its motor [N m/A]; 0 where it is unknown.
        own_loss: what the losses that the currents show are replaced by [N m]: that of a side of
            the plant which the torques are compared with.

    Raises:
        ValueError: the log has neither currents nor torques, too little steady driving, or such
            that friction and losses do not explain.
    """
    fit = fit_currents(log, [], chassis)
    x = values_of(fit.found)
    battery = fit.best["kind"] == "battery"
    constant = constant if log.unit == "A" else 1.0
    _refuse_unexplained(fit)
    if battery and not log.voltages.size:
        raise ValueError("they are the battery's, and without its voltage power is unknown")
    if not battery and constant <= 0.0:
        return None, _NO_CONSTANT
    some = steady_samples(log)[0]
    current = some.currents
    if log.unit != "A":
        push = side_forces(log.rates, chassis.vehicle, COULOMB_SCALE)
        current = np.where(np.abs(push) > _SLIDING, current, np.nan)
    elif not fit.sensor.signed:
        shows = current > fit.sensor.idle + _CLEARLY * fit.sensor.ripple
        current = np.where(shows, current, np.nan)
    scale = 1.0 if battery else constant
    forward = _drive_direction("driving", log.rates)
    ahead = scale * current * forward * _drive_direction(fit.sign, log.rates)
    if battery:
        ahead = battery_torque(
            current * some.voltages, np.abs(log.rates), x["heat"], x["efficiency"]
        )
    elif not fit.sensor.signed:
        ahead *= forward * np.sign(_side_currents(x, log.rates, chassis.vehicle))
    loss = scale * np.array([x["loss_left"], x["loss_right"]])
    torques = forward * (ahead - loss[:, None] + own_loss)
    how = "the battery's power" if battery else f"the motors' currents and {constant:g} N m/A"
    if log.unit != "A":
        how = "the log's torques"
    if fit.sensor.signed and fit.sign != ("driving" if log.unit == "A" else "axle"):
        how += f", which are positive where they drive {_SAID[fit.sign]}"
    said = (
        f"torques come from {how}, less losses of {loss[0]:.3g} N m (left) and "
        f"{loss[1]:.3g} N m (right) in steady driving; a scale that is off by a share makes "
        "friction wrong by that share, which its standard error does not cover"
    )
    return np.ascontiguousarray(torques.T), said


def _refuse_unexplained(fit: CurrentFit) -> None:
    """Raise a ValueError that says why currents or torques are none of a drive train on tyres."""
    explained = fit.best["held_out"]
    if explained < _LEAST_R2:
        raise ValueError(
            f"friction and losses explain {max(explained, 0.0):.2f} of their variance in steady "
            f"driving, wanted {_LEAST_R2:g} or more, with either sign"
        )
    for side in ("left", "right"):
        loss, error = fit.found[f"loss_{side}"]
        if loss + _SURE * error < 0.0:
            raise ValueError(f"on the {side} they would need a negative loss, {loss:.3g}")


def with_torques(source: Source, chassis: PlantProfile, constant: float, own_loss: float) -> Source:
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
        what = "currents tell no torques" if log.unit == "A" else "torques tell no friction"
        said = f"its {what}, because {error}"
    remarks = (*source.remarks, f"{source.title}: {said}")
    return replace(source, pieces=pieces, remarks=remarks)
