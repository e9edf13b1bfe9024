"""Friction, losses and torques from motor currents.

Where the wheels turn steadily the robot does not accelerate, and so its motion and the share of the friction that
each side overcomes follow from the wheel rates alone. The torque of a side over the torque constant is

    I = A F + loss sgn(w),    A = mu N r / K,

with F the side's force over its friction limit. What a log shows of I depends on where the current is measured; power, which
a battery's current measures, knows no torque constant, and then the same numbers are torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ssmr.robot.drivetrain import (
    SkidGeometry,
    battery_current,
    battery_torque,
    bridge_reading,
    quasi_static_twist,
    side_forces,
)
from ssmr.types import FloatArray
from validation.bench.sources import RECORDING
from validation.identify.motor_logs import (
    Chassis,
    CurrentSamples,
    DriveLog,
    Sensor,
    current_samples,
    log_of_motions,
    sampled_in_windows,
    sensor_of,
    steady_currents,
    window_samples,
)
from validation.identify.objective import FitTarget

COULOMB_SCALE = 1e-4
"""Slip scale of a contact that is a Coulomb one as far as any current shows [1]."""
_LEAST_SAMPLES = 10  # currents that a rule is fitted to, or judged by
_CLEARLY = 3.0  # a current so many ripples above an idle bridge's is one of a bridge that drives
_NO_CONSTANT = (
    "its currents are the motors', and no torque constant is known, so they tell no torques; "
    "give --torque-constant, or torque_constant in [drive] of the robot's file"
)
_ROBUST = 0.3  # residuals beyond this share of the currents' standard deviation count less than their square


class _ReadingRule(NamedTuple):
    """An assumption about the tyres, and about what a log shows of the motors' currents."""

    name: str  # name in tables
    kind: str  # whose current it is: `motor` or `battery`
    numbers: Mapping[str, tuple[float, float, float]]
    """Start, least and greatest value of what is fitted, by name; those of `_SIDES` in units of the currents' scale."""


_SIDES = {
    "friction": (1.0, 0.02, 10.0),
    "loss_left": (0.1, -1.0, 2.0),
    "loss_right": (0.1, -1.0, 2.0),
}
_GIVING = {**_SIDES, "slip_scale": (0.09, 0.01, 0.8)}
_READING_RULES = (
    _ReadingRule("the motors', Coulomb contacts", "motor", _SIDES),
    _ReadingRule("the motors', contacts that give way", "motor", _GIVING),
    _ReadingRule(
        "the motors', shown while the bridge drives",
        "motor",
        {**_GIVING, "rho": (0.145, 0.03, 0.5)},
    ),
    _ReadingRule(
        "the battery's",
        "battery",
        {**_GIVING, "heat": (0.003, 0.0, 0.1), "efficiency": (0.9, 0.4, 1.0)},
    ),
)
"""Every rule that a log is tried against. The third is for sensors without a sign."""


def _side_currents(
    numbers: Mapping[str, float], rates: FloatArray, geometry: SkidGeometry
) -> FloatArray:
    """Return (2, n) currents of both sides [A] that a rule's numbers need for (2, n) rates [rad/s]."""
    scale = numbers.get("slip_scale", COULOMB_SCALE)
    known, inverse = np.unique(rates.round(4), axis=1, return_inverse=True)
    twist = quasi_static_twist(known, geometry, scale)
    effort = side_forces(known, twist, geometry, scale)[:, inverse.ravel()]
    loss = np.array([[numbers["loss_left"]], [numbers["loss_right"]]])
    return np.asarray(numbers["friction"] * effort + loss * np.sign(rates))


def _predicted(
    numbers: Mapping[str, float], s: CurrentSamples, sensor: Sensor, geometry: SkidGeometry
) -> FloatArray:
    """Return (n,) readings that the numbers of a rule predict [A]."""
    every = _side_currents(numbers, s.rates, geometry)
    current: FloatArray = np.take_along_axis(every, s.side[None], axis=0)[0]
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
    scores: list[
        dict[str, Any]
    ]  # rows: share of the variance of the currents that each rule explains
    best: Mapping[str, Any]  # the row of the rule
    numbers: Mapping[str, float]  # the rule's numbers, from the whole log
    errors: Mapping[str, float]  # their standard errors, from resampled blocks
    shown: Sequence[tuple[FloatArray, FloatArray]]
    """Measured and predicted currents [A], of what was fitted and of what was held out."""


def fit_currents(
    log: DriveLog, held_out: Sequence[DriveLog], chassis: Chassis, seed: int, resamples: int
) -> CurrentFit:
    """Return friction, losses and slip scale from the currents of a log, and the rule that these follow.

    Logs that are held out judge the rules; if there are none, rules fitted to the log's first part are judged on its rest.
    The bootstrap draws blocks `resamples` times.

    Raises:
        ValueError: a log has no currents, or too little steady driving.
    """
    whole, sensor, geometry = current_samples(log), sensor_of(log), chassis.geometry
    first, *others = (log, *held_out) if held_out else log.divided()
    fitted, judged = current_samples(first), _joined([current_samples(x) for x in others])
    rows = (
        _joined([window_samples(x, means=False) for x in others])
        if sampled_in_windows(log)
        else judged
    )
    for name, samples in ((f"what is fitted of {log.name}", fitted), ("what is held out", judged)):
        if (count := len(np.unique(samples.current))) < _LEAST_SAMPLES:
            raise ValueError(
                f"{name} has {count} different currents in steady driving, wanted {_LEAST_SAMPLES} or more"
            )
    scores, best, rule, numbers = (
        list[dict[str, Any]](),
        dict[str, Any](),
        _READING_RULES[0],
        dict[str, float](),
    )
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
    drawn = [
        _fit_rule(rule, whole.resampled(rng), sensor, geometry, final) for _ in range(resamples)
    ]
    errors = {name: float(np.std([d[name] for d in drawn])) for name in final if drawn}
    return CurrentFit(log.name, sensor, rule.kind, scores, best, final, errors, shown)


class Torques(NamedTuple):
    """What turns a log's currents into torques at its wheels."""

    found: CurrentFit
    """Losses, and what the currents are."""
    constant: float
    """Torque of a side's wheels per ampere of its motor [N m/A]; 1 for the battery's currents."""
    geometry: SkidGeometry
    """Rolling radius and half distances of the wheels."""

    @classmethod
    def of(cls, log: DriveLog, chassis: Chassis, constant: float) -> Torques | None:
        """Return what a log tells; None where its currents are the motors' and no constant is known.

        Raises:
            ValueError: it has no currents, or too little steady driving.
        """
        found = fit_currents(log, [], chassis, 0, 0)
        if found.kind == "battery":
            if log.voltages is None:
                raise ValueError("they are the battery's, and without its voltage power is unknown")
            return cls(found, 1.0, chassis.geometry)
        return cls(found, constant, chassis.geometry) if constant > 0.0 else None

    def along(self, log: DriveLog, own_loss: float) -> FloatArray:
        """Return (M, 2) torques of the left and right motors [N m]; NaN where the log hides them.

        They are known in steady driving, where nothing accelerates, of sides that turn, and not
        where a sensor without a sign shows nothing. What such a sensor shows of an inner wheel may
        drive or brake it: the rule that explains the currents decides. The losses that the currents
        show are replaced by `own_loss` [N m], that of a side of the plant which the torques are
        compared with.
        """
        current = steady_currents(log)
        forward = np.where(log.rates < 0.0, -1.0, 1.0)
        n = self.found.numbers
        sensor = self.found.sensor
        if not sensor.signed:
            current[~(current > sensor.idle + _CLEARLY * sensor.ripple)] = np.nan
        if self.found.kind == "battery":
            assert log.voltages is not None
            power = current * np.where(log.voltages > 1.0, log.voltages, np.nan)
            ahead = battery_torque(power, np.abs(log.rates), n["heat"], n["efficiency"])
        elif sensor.signed:
            ahead = self.constant * current
        else:
            known = np.isfinite(current).any(axis=0)
            needed = _side_currents(n, log.rates[:, known], self.geometry)
            current[:, known] *= np.sign(needed)
            ahead = self.constant * forward * current
        loss = self.constant * np.array([[n["loss_left"]], [n["loss_right"]]])
        return np.ascontiguousarray((forward * (ahead - loss + own_loss)).T)

    def sentence(self, name: str) -> str:
        """Return a sentence on where the torques of a log come from."""
        n = self.found.numbers
        left = self.constant * n["loss_left"]
        right = self.constant * n["loss_right"]
        how = "the battery's power"
        if self.found.kind == "motor":
            how = f"the motors' currents and {self.constant:g} N m/A"
        return (
            f"{name}: torques come from {how}, less losses of {left:.3g} N m (left) and "
            f"{right:.3g} N m (right) in steady driving; a scale that is off by a share makes "
            "friction wrong by that share, which its standard error does not cover"
        )


def with_torques(
    targets: Sequence[FitTarget], chassis: Chassis, constant: float, own_loss: float
) -> tuple[FitTarget, ...]:
    """Return targets with the torques that the currents of their logs tell.

    What was found, or why nothing was, stands among the warnings of their sources. Logs without
    currents stay as they are, and so do scenarios.

    Args:
        targets: targets of a fit.
        chassis: nominal numbers of the robot.
        constant: torque of a side's wheels per ampere of its motor [N m/A]; 0 where it is unknown.
        own_loss: loss of a side of the plant that is fitted, see `Torques.along`.
    """
    out = list[FitTarget]()
    for target in targets:
        name = target.source.title
        log = None
        if target.source.reference == RECORDING:
            log = log_of_motions(name, target.truth)
        if log is None:
            out.append(target)
            continue
        ends = np.cumsum([len(motion.t) for motion in target.truth])[:-1]
        known = None
        try:
            told = Torques.of(log, chassis, constant)
            if told is None:
                said = f"{name}: {_NO_CONSTANT}"
            else:
                said = told.sentence(name)
                known = tuple(np.split(told.along(log, own_loss), ends))
        except ValueError as error:
            said = f"{name}: its currents tell no torques, because {error}"
        source = replace(target.source, warnings=(*target.source.warnings, said))
        out.append(replace(target, source=source, torques=known))
    return tuple(out)


def _joined(parts: Sequence[CurrentSamples]) -> CurrentSamples:
    columns: list[Any] = [np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)]
    return CurrentSamples(*columns)
